//! Image-space path tracing: from some scattering event on, visibility records say where paths go (Ulbrich 2013, section 4.2).
//!
//! A path that has scattered often enough asks a record near its vertex what lies along its direction, takes normal and albedo from there
//! and goes on inside the cache; light samples at its vertices ask records, too. Surfaces in the cache scatter like Lambert
//! surfaces that reflect as much.
//!
//! Where records have nothing to say a ray is traced: along lobes narrower than about a hundred texels ([`SHARPEST`]), towards surfaces that
//! cannot be kept (mirrors, glass, unlit ones), where no record stands near. Such paths come back to the cache behind their next rough
//! vertex.
//!
//! A texel does not know which lamp it shows. So light samples find all lamps where the direction sampled for the path belongs to
//! records, with a weight of 1, and the path counts none; the sky is weighed as ever. What a direction belongs to is told by its density
//! alone, so that the weights of the two ways add up to 1: with records that answer exactly, and Lambert surfaces, pictures are
//! those of path tracing on average. (Tested.)

use super::path::{
    self, Leaving, Path, Pending, ROULETTE_AFTER, SETS_PER_SEGMENT, Scattering, power_heuristic,
};
use super::{PathLimits, World};
use crate::geometry::Geometry;
use crate::sampling::warp;
use glam::{Vec2, Vec3};
use occlude_visibility::records::{
    Aim, Cache, CachedSurface, Nearby, RayAnswer, RecordSettings, RecordsError, RecordsReader,
    RecordsReport, Scout, SegmentAim, SegmentEnd,
};
use occlude_visibility::two_part::{Ball, TwoPartTracer};
use occlude_visibility::{
    Endpoint, LightEnd, Query, Ray, Reason, Tracer, Unanswered, VisibilityStats,
};
use std::f32::consts::FRAC_1_PI;

/// Density per steradian of the sharpest directions that records are asked about: a lobe of so high a density is about 0.05 sr
/// wide, a hundred texels at 128 texels across.
pub(super) const SHARPEST: f32 = 20.0;

/// Vertices that look into their records together.
const TOGETHER: usize = 64;

/// Records that say where paths go on.
#[derive(Debug)]
pub struct Secondary {
    answers: Answers,
    from: u32,
}

#[derive(Debug)]
enum Answers {
    Records(Box<Cache>),
    /// Rays say it, in the form in which records would: for tests.
    #[cfg(test)]
    Exact,
}

/// What image-space paths asked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageSpaceReport {
    /// The records.
    pub records: RecordsReport,
    /// Mean of the records' importance, and its variance.
    pub importance: (f64, f64),
}

impl Secondary {
    /// Records without a place yet, to be asked from scattering event `from` (1: the first) on.
    pub fn new(settings: RecordSettings, from: u32) -> Result<Self, RecordsError> {
        let settings = RecordSettings {
            surfaces: true,
            ..settings
        };
        Cache::new(settings).map(|cache| Self {
            answers: Answers::Records(Box::new(cache)),
            from: from.max(1),
        })
    }

    #[cfg(test)]
    pub(super) fn exact(from: u32) -> Self {
        Self {
            answers: Answers::Exact,
            from,
        }
    }

    pub(super) fn from(&self) -> u32 {
        self.from
    }

    /// The records.
    pub fn cache(&self) -> Option<&Cache> {
        match &self.answers {
            Answers::Records(cache) => Some(cache),
            #[cfg(test)]
            Answers::Exact => None,
        }
    }

    /// The records, to change between pictures.
    pub fn cache_mut(&mut self) -> Option<&mut Cache> {
        match &mut self.answers {
            Answers::Records(cache) => Some(cache),
            #[cfg(test)]
            Answers::Exact => None,
        }
    }

    /// What the records hold and did.
    pub fn report(&self) -> ImageSpaceReport {
        self.cache()
            .map_or_else(ImageSpaceReport::default, |cache| ImageSpaceReport {
                records: cache.report(),
                importance: cache.importance_spread(),
            })
    }

    /// To be called when something has moved that was in the balls `before`.
    pub fn moved(&mut self, geometry: &Geometry, before: &[Ball]) {
        if let Some(cache) = self.cache_mut() {
            cache.moved(geometry, before, geometry.moving());
        }
    }

    pub(super) fn prepare(&mut self, geometry: &Geometry, scout: &mut dyn Scout) {
        let Some(cache) = self.cache_mut() else {
            return;
        };
        if cache.take_restored() {
            return;
        }
        let steps = if cache.is_empty() {
            cache.place_initial(geometry, scout);
            cache.settings().steps
        } else {
            cache.settings().steps_per_picture
        };
        let count = 4 * cache.len();
        cache.refine_before(geometry, steps, &mut |sites| scout.draw(count, sites));
    }

    pub(super) fn pass_done(&mut self, geometry: &Geometry) {
        if let Some(cache) = self.cache_mut() {
            cache.pass_done(geometry);
        }
    }

    pub(super) fn begin(&self, scratch: &mut Scratch) {
        if let Some(cache) = self.cache() {
            cache.begin_reading(&mut scratch.reader);
        }
    }

    pub(super) fn end(&self, scratch: &mut Scratch) {
        if let Some(cache) = self.cache() {
            cache.end_reading(&mut scratch.reader);
        }
    }
}

/// A path inside the cache: its next look, and what its vertex has asked.
#[derive(Clone, Copy, Debug)]
struct Look {
    path: u32,
    aim: Aim,
    position: Vec3,
}

/// A path that leaves a surface: the one where it enters the cache, or one that it met there.
#[derive(Clone, Copy, Debug)]
enum Vertex {
    /// Its way goes on along its ray; the number chooses who is asked.
    Entry(u32, f32),
    /// It asks for light there, and scatters.
    Inside(u32, CachedSurface),
}

/// A light sample that waits for its answer.
#[derive(Clone, Copy, Debug)]
struct Asked {
    path: u32,
    aim: Result<SegmentAim, Reason>,
    query: Query,
    contribution: Vec3,
}

/// Buffers and counters of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    reader: RecordsReader,
    looks: Vec<Look>,
    next: Vec<Look>,
    vertices: Vec<Vertex>,
    /// Where these lie, and who answers there.
    places: Vec<(Vec3, Vec3)>,
    nearby: Vec<Nearby>,
    asked: Vec<Asked>,
    rays: Vec<Ray>,
    occluded: Vec<bool>,
    queries: u64,
    answered: u64,
    traced: u64,
    unanswered: Unanswered,
    pub(super) counts: SecondaryRays,
}

/// What became of the rays that records were asked about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SecondaryRays {
    /// Rays that records were asked about.
    pub asked: u64,
    /// Those among them that were traced after all.
    pub traced: u64,
    /// Why; those apart that short rays in front of them led to.
    pub unanswered: Unanswered,
}

impl SecondaryRays {
    /// Adds the counters of another worker.
    pub fn add(&mut self, other: &Self) {
        self.asked += other.asked;
        self.traced += other.traced;
        self.unanswered.add(&other.unanswered);
    }
}

impl Scratch {
    /// Before vertices are collected that go through the same steps together.
    fn begin_vertices(&mut self) {
        self.vertices.clear();
        self.places.clear();
        self.asked.clear();
    }

    /// Light samples at vertices in the cache; those that no record answered are counted where they are traced.
    pub(super) fn stats(&self) -> VisibilityStats {
        VisibilityStats {
            queries: self.queries,
            answered: self.answered,
            traced: self.traced,
            unanswered: self.unanswered,
            ..VisibilityStats::default()
        }
    }
}

/// Goes on with the paths in `scratch.cached` until they end or must be traced: those come back in `scratch.alive`. Questions that no
/// record answers are added to `scratch.queries`.
pub(super) fn advance(
    world: &World,
    limits: PathLimits,
    secondary: &Secondary,
    scratch: &mut path::Scratch,
    space: &mut Scratch,
) {
    #[cfg(test)]
    if matches!(secondary.answers, Answers::Exact) {
        return tests::advance_exactly(world, limits, scratch);
    }
    let Some(cache) = secondary.cache() else {
        return;
    };
    let cached = std::mem::take(&mut scratch.cached);
    for cached in cached.chunks(TOGETHER) {
        space.begin_vertices();
        for &index in cached {
            let path = &mut scratch.paths[index as usize];
            if let Some(Leaving { normal, random }) = path.leaving.take() {
                space.vertices.push(Vertex::Entry(index, random));
                space.places.push((path.ray.origin, normal));
            }
        }
        leave(world, cache, scratch, space);
    }
    scratch.cached = cached;
    while !space.next.is_empty() {
        std::mem::swap(&mut space.looks, &mut space.next);
        space.next.clear();
        near_field(world, cache, scratch, space);
        let looks = std::mem::take(&mut space.looks);
        for looks in looks.chunks(TOGETHER) {
            let mut texels = [0; TOGETHER];
            // One loop that only reads memory: the reads wait for each other's arrival in parallel.
            for (look, texel) in looks.iter().zip(&mut texels) {
                *texel = cache.fetch(&look.aim);
            }
            space.begin_vertices();
            for (look, &texel) in looks.iter().zip(&texels) {
                arrive(world, limits, cache, scratch, space, look, texel);
            }
            leave(world, cache, scratch, space);
            settle(world.geometry, cache, scratch, space);
        }
        space.looks = looks;
    }
}

/// Decides whom a path asks where it goes on; if nobody, a ray.
fn look(
    cache: &Cache,
    scratch: &mut path::Scratch,
    space: &mut Scratch,
    index: u32,
    nearby: &Nearby,
    random: f32,
) {
    let path = &scratch.paths[index as usize];
    let weight = 1.0 / path.depth.max(1) as f32;
    let direction = path.ray.direction;
    space.counts.asked += 1;
    match cache.aim(&mut space.reader, nearby, direction, random, weight) {
        Ok(aim) => space.next.push(Look {
            path: index,
            aim,
            position: path.ray.origin,
        }),
        Err(reason) => {
            space.counts.traced += 1;
            space.counts.unanswered.count(reason);
            scratch.alive.push(index);
        }
    }
}

/// Traces paths whose way begins right in front of something.
fn near_field(world: &World, cache: &Cache, scratch: &mut path::Scratch, space: &mut Scratch) {
    let near = cache.settings().near;
    if near == 0.0 {
        return;
    }
    space.rays.clear();
    for look in &space.looks {
        let ray = scratch.paths[look.path as usize].ray;
        space.rays.push(Ray {
            t_max: near * cache.parallax(&look.aim, look.position),
            ..ray
        });
    }
    space.occluded.clear();
    space.occluded.resize(space.rays.len(), false);
    (world.geometry).occluded_batch(&space.rays, &mut space.occluded);
    space.traced += space.rays.len() as u64;
    let mut occluded = space.occluded.iter();
    space.looks.retain(|look| {
        let blocked = occluded.next().is_some_and(|&occluded| occluded);
        if blocked {
            space.counts.traced += 1;
            scratch.alive.push(look.path);
        }
        !blocked
    });
}

/// A path learns what it sees.
fn arrive(
    world: &World,
    limits: PathLimits,
    cache: &Cache,
    scratch: &mut path::Scratch,
    space: &mut Scratch,
    look: &Look,
    texel: u64,
) {
    let path = &mut scratch.paths[look.path as usize];
    let direction = path.ray.direction;
    let surface = match cache.look(&look.aim, texel, look.position, direction) {
        RayAnswer::Unknown(reason) => {
            space.counts.traced += 1;
            space.counts.unanswered.count(reason);
            return scratch.alive.push(look.path);
        }
        RayAnswer::Sky => {
            if world.geometry.has_panes() {
                path.throughput *= world.geometry.pane_transmittance(&path.ray);
            }
            return path::add_environment(world, path, false);
        }
        RayAnswer::Surface(surface) => surface,
    };
    if path.depth >= limits.max_depth {
        return;
    }
    if world.geometry.has_panes() {
        let way = Ray::between(path.ray.origin, surface.position);
        path.throughput *= world.geometry.pane_transmittance(&way);
    }
    space.vertices.push(Vertex::Inside(look.path, surface));
    space.places.push((surface.position, surface.normal));
}

/// Paths find out who answers where they are, ask for light there, and choose whom they ask where they go on.
fn leave(world: &World, cache: &Cache, scratch: &mut path::Scratch, space: &mut Scratch) {
    let (vertices, mut nearby) = (
        std::mem::take(&mut space.vertices),
        std::mem::take(&mut space.nearby),
    );
    nearby.resize(vertices.len(), Nearby::NOBODY);
    cache.nearby_many(&space.places, &mut nearby);
    for (vertex, nearby) in vertices.iter().zip(&nearby) {
        let (index, random) = match *vertex {
            Vertex::Entry(index, random) => (index, Some(random)),
            Vertex::Inside(index, surface) => {
                let mut ask = |path: &Path, query, end, contribution, random| {
                    let weight = 1.0 / (path.depth + 1) as f32;
                    let from = surface.position;
                    let reader = &mut space.reader;
                    space.asked.push(Asked {
                        path: index,
                        aim: cache.aim_segment(reader, nearby, from, end, random, weight),
                        query,
                        contribution,
                    });
                };
                let path = &mut scratch.paths[index as usize];
                (index, scatter(world, path, &surface, &mut ask))
            }
        };
        if let Some(random) = random {
            look(cache, scratch, space, index, nearby, random);
        }
    }
    (space.vertices, space.nearby) = (vertices, nearby);
}

/// A vertex that scatters like a Lambert surface: asks for light, and turns the path. If it goes on, returns a random number for the
/// choice of who is to be asked.
fn scatter(
    world: &World,
    path: &mut Path,
    surface: &CachedSurface,
    ask: &mut impl FnMut(&Path, Query, SegmentEnd, Vec3, f32),
) -> Option<f32> {
    let (normal, albedo) = (surface.normal, surface.albedo);
    path.sampler
        .jump(1 + (path.depth + path.panes) * SETS_PER_SEGMENT);
    let [u, v, pick, roulette] = path.sampler.next();
    let [s, t, _, random] = path.sampler.next();
    // Off the surface, as far as its place is uncertain.
    let origin = surface.position + normal * (0.5 * surface.footprint);
    let scene = world.geometry.scene;
    let light = (world.lights).sample(scene, surface.position, normal, pick, Vec2::new(u, v));
    if let Some(light) = light {
        let cosine = light.wi.dot(normal);
        if cosine > 0.0 {
            let weight = if light.delta || light.target.is_some() {
                1.0
            } else {
                power_heuristic(light.pdf, cosine * FRAC_1_PI)
            };
            let brought = path.throughput * albedo * light.radiance;
            let contribution = brought * (cosine * FRAC_1_PI * weight / light.pdf);
            if contribution != Vec3::ZERO && contribution.is_finite() {
                let end = match (light.target, light.end) {
                    (_, LightEnd::Surface(end)) => SegmentEnd::Surface(end.position, end.normal),
                    (Some(target), _) => SegmentEnd::Point(target),
                    (None, _) => SegmentEnd::Direction(light.wi),
                };
                let ray = match light.target {
                    Some(target) => Ray::between(origin, target),
                    None => Ray::new(origin, light.wi),
                };
                let eye = Endpoint::new(surface.position, normal, f32::INFINITY);
                let query = Query {
                    importance: contribution.element_sum(),
                    ..Query::new(eye, light.end, ray)
                };
                ask(path, query, end, contribution, random);
            }
        }
    }
    path.depth += 1;
    let local = warp::cosine_hemisphere(Vec2::new(s, t));
    // The frame of path tracing: with the same random numbers paths stay near those that rays would find.
    let (x, y) = normal.any_orthonormal_pair();
    let direction = (x * local.x + y * local.y + normal * local.z).normalize();
    path.last = Some(Scattering {
        position: surface.position,
        light_normal: normal,
        pdf: local.z * FRAC_1_PI,
    });
    path.found = true;
    path.throughput *= albedo;
    if path.depth >= ROULETTE_AFTER {
        let survival = (path.throughput.max_element() * path.squeezed)
            .min(1.0)
            .sqrt();
        if roulette >= survival {
            return None;
        }
        path.throughput /= survival;
    }
    if path.throughput.max_element() <= 0.0 || !path.throughput.is_finite() {
        return None;
    }
    path.ray = Ray::new(origin, direction);
    (local.z > 0.0).then_some(random)
}

/// Adds what light samples bring, by their records; the others are asked of the visibility strategy.
fn settle(geometry: &Geometry, cache: &Cache, scratch: &mut path::Scratch, space: &mut Scratch) {
    let near = cache.settings().near;
    for asked in space.asked.chunks(TOGETHER) {
        let mut texels = [0; TOGETHER];
        for (asked, texel) in asked.iter().zip(&mut texels) {
            if let Ok(segment) = &asked.aim {
                *texel = cache.fetch(&segment.aim);
            }
        }
        for (asked, &texel) in asked.iter().zip(&texels) {
            let answer = (asked.aim.as_ref())
                .map_err(|&reason| reason)
                .and_then(|segment| cache.sees(segment, texel));
            let mut seen = match answer {
                Ok(seen) => seen,
                Err(reason) => {
                    space.unanswered.count(reason);
                    scratch.queries.push(asked.query);
                    scratch.pending.push(Pending {
                        path: asked.path,
                        contribution: asked.contribution,
                    });
                    continue;
                }
            };
            space.queries += 1;
            if let (true, true, Ok(segment)) = (near > 0.0, seen, &asked.aim) {
                let ray = asked.query.ray;
                let place = asked.query.eye.position;
                let reach = near * cache.parallax(&segment.aim, place) / ray.direction.length();
                let stretch = Ray {
                    t_max: reach.min(ray.t_max),
                    ..ray
                };
                seen = !geometry.occluded(&stretch);
                space.traced += 1;
            } else {
                space.answered += 1;
            }
            if seen {
                let tint = if geometry.has_panes() {
                    geometry.pane_transmittance(&asked.query.ray)
                } else {
                    Vec3::ONE
                };
                let path = &mut scratch.paths[asked.path as usize];
                path.radiance += asked.contribution * tint;
            }
        }
    }
}

#[cfg(test)]
mod tests;
