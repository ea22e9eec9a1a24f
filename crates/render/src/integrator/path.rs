//! Path tracing with next-event estimation.
//!
//! At every scattering event one light is sampled and one direction of the surface; what both could find is weighted by
//! the power heuristic (Veach 1997, section 9.2). Paths end by Russian roulette on the root of their throughput. Clear panes and
//! cut-outs are passed without an event, so that light behind windows is found by light sampling too.
//!
//! The wrong tool where light comes only through small holes or by way of caustics: such paths are found by chance alone.

use super::image_space::{self, Secondary};
use super::{PathLimits, RenderSettings, Unit, Worker, World};
use crate::bsdf::Bsdf;
use crate::camera::View;
use crate::film::{Features, FilmTile};
use crate::geometry::{Geometry, Surface, is_pane};
use crate::light::Lights;
use crate::sampling::Sampler;
use glam::{Vec2, Vec3};
use occlude_visibility::{Endpoint, Hit, Query, Ray, Visibility, offset_along_normal};

/// Panes that a path may pass beside its scattering events, before it is given up.
pub(super) const MOST_PANES: u32 = 64;

/// Scattering events after which roulette may end a path.
pub(super) const ROULETTE_AFTER: u32 = 2;

/// Least perceptual roughness of what a regularized path sees after a scattering event that was not a mirror. Such paths
/// find caustics so rarely that each find is a firefly; the blur brings the finds together.
const REGULARIZED_ROUGHNESS: f32 = 0.5;

/// Dimension sets that one segment of a path uses.
pub(super) const SETS_PER_SEGMENT: u32 = 2;

/// A path on its way.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) ray: Ray,
    pub(super) throughput: Vec3,
    pub(super) radiance: Vec3,
    pub(super) sampler: Sampler,
    x: u32,
    y: u32,
    /// Scattering events so far.
    pub(super) depth: u32,
    /// Panes passed so far.
    pub(super) panes: u32,
    /// The last scattering event, for weighing what its direction finds against light sampling. `None` at the camera and
    /// after mirrors, which light sampling cannot find.
    pub(super) last: Option<Scattering>,
    /// Records are to say where the ray goes.
    pub(super) leaving: Option<Leaving>,
    /// Light sampling at the last event has found the surfaces that shine along the ray already, with a weight of 1.
    pub(super) found: bool,
    /// Density per steradian around the ray (per square metre across it, if `parallel`) of all paths of the picture, one a
    /// pixel: with the way since, the area density of what it hits.
    direction_density: f32,
    /// The rays come from an orthographic camera and do not spread.
    parallel: bool,
    /// Square metres a path of the picture where the direction was chosen: see [`arriving_density`]. 0 at the camera.
    region: f32,
    /// Length of the way from where the direction was chosen to the ray's origin.
    travelled: f32,
    /// Product of the squared ratios of refractive index: what refraction took from `throughput` only to give it back when
    /// the path leaves the body. Roulette looks at the throughput without it.
    pub(super) squeezed: f32,
    /// Some event so far was not a mirror.
    blurred: bool,
    /// Absorption per metre of what the ray is in.
    absorption: Vec3,
    features: Features,
}

/// How a ray leaves a scattering event behind which records say where it goes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaving {
    /// The geometric normal on the side that the ray leaves.
    pub(super) normal: Vec3,
    /// A random number for the choice of a record, that no other decision of the path uses.
    pub(super) random: f32,
}

/// A scattering event that light sampling could have found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scattering {
    pub(super) position: Vec3,
    /// What light sampling used there.
    pub(super) light_normal: Vec3,
    /// Density of the direction per steradian.
    pub(super) pdf: f32,
}

/// What a light sample brings, once its visibility is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pending {
    pub(super) path: u32,
    pub(super) contribution: Vec3,
}

/// Buffers that a worker keeps from tile to tile.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    pub(super) paths: Vec<Path>,
    pub(super) alive: Vec<u32>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    pub(super) queries: Vec<Query>,
    pub(super) pending: Vec<Pending>,
    answers: Vec<f32>,
    /// Paths whose next vertex records are to find.
    pub(super) cached: Vec<u32>,
    /// Paths of the picture, one a pixel.
    pixels: f32,
}

/// Renders the samples of a unit into its tile.
pub(super) fn render_unit<'a, V: Visibility<Geometry<'a>>>(
    world: &World<'a>,
    view: &View,
    visibility: &V,
    settings: &RenderSettings,
    limits: PathLimits,
    secondary: Option<&Secondary>,
    unit: &Unit,
    worker: &mut Worker<V::Worker>,
    tile: &mut FilmTile,
) {
    let scratch = &mut worker.path;
    scratch.start(view);
    scratch.paths.extend(unit.starts(settings).map(|start| {
        let camera = view.ray(start.point);
        Path {
            ray: camera.ray,
            throughput: Vec3::ONE,
            radiance: Vec3::ZERO,
            sampler: start.sampler,
            x: start.x,
            y: start.y,
            depth: 0,
            panes: 0,
            last: None,
            leaving: None,
            found: false,
            direction_density: camera.pixel_density,
            parallel: camera.parallel,
            region: 0.0,
            travelled: 0.0,
            squeezed: 1.0,
            blurred: false,
            absorption: Vec3::ZERO,
            features: Features::default(),
        }
    }));
    scratch.alive.clear();
    scratch.alive.extend(0..scratch.paths.len() as u32);
    worker.rays.primary += scratch.alive.len() as u64;

    let mut first = true;
    let from = secondary.map(Secondary::from);
    if let Some(secondary) = secondary {
        secondary.begin(&mut worker.image_space);
    }
    visibility.begin(&mut worker.visibility, unit.epoch());
    while !scratch.alive.is_empty() {
        if !first {
            worker.rays.secondary += scratch.alive.len() as u64;
        }
        extend(world.geometry, scratch);
        shade(world, limits, first, from, scratch);
        if let Some(secondary) = secondary {
            image_space::advance(world, limits, secondary, scratch, &mut worker.image_space);
        }
        scratch.answers.clear();
        scratch.answers.resize(scratch.queries.len(), 0.0);
        visibility.answer(
            world.geometry,
            &mut worker.visibility,
            &scratch.queries,
            &mut scratch.answers,
        );
        collect(world.geometry, scratch);
        first = false;
    }
    if let Some(secondary) = secondary {
        secondary.end(&mut worker.image_space);
    }
    for path in &scratch.paths {
        tile.add(path.x, path.y, path.radiance, Some(&path.features));
    }
}

impl Scratch {
    /// Forgets all paths, and takes others of a picture seen by `view`.
    pub(super) fn start(&mut self, view: &View) {
        self.pixels = view.width() as f32 * view.height() as f32;
        self.paths.clear();
        self.alive.clear();
    }

    /// Adds a path that somebody else has begun and that leaves its last, not mirror-like scattering event along `ray`.
    pub(super) fn push(
        &mut self,
        ray: Ray,
        throughput: Vec3,
        sampler: Sampler,
        depth: u32,
        last: Scattering,
        owner: u32,
    ) {
        self.alive.push(self.paths.len() as u32);
        self.paths.push(Path {
            ray,
            throughput,
            radiance: Vec3::ZERO,
            sampler,
            x: owner,
            y: 0,
            depth,
            panes: 0,
            last: Some(last),
            leaving: None,
            found: false,
            direction_density: last.pdf * self.pixels,
            parallel: false,
            region: 0.0,
            travelled: 0.0,
            squeezed: 1.0,
            blurred: true,
            absorption: Vec3::ZERO,
            features: Features::default(),
        });
    }

    /// Goes all paths to their ends; returns the rays traced.
    pub(super) fn finish<'a, V: Visibility<Geometry<'a>>>(
        &mut self,
        world: &World<'a>,
        limits: PathLimits,
        visibility: &V,
        worker: &mut V::Worker,
    ) -> u64 {
        let mut rays = 0;
        while !self.alive.is_empty() {
            rays += self.alive.len() as u64;
            extend(world.geometry, self);
            shade(world, limits, false, None, self);
            self.answers.clear();
            self.answers.resize(self.queries.len(), 0.0);
            visibility.answer(world.geometry, worker, &self.queries, &mut self.answers);
            collect(world.geometry, self);
        }
        rays
    }

    /// The owners of the paths and what the paths brought.
    pub(super) fn brought(&self) -> impl Iterator<Item = (u32, Vec3)> {
        self.paths.iter().map(|path| (path.x, path.radiance))
    }
}

/// Finds what every living path hits.
fn extend(geometry: &Geometry, scratch: &mut Scratch) {
    scratch.rays.clear();
    scratch
        .rays
        .extend(scratch.alive.iter().map(|&i| scratch.paths[i as usize].ray));
    scratch.hits.clear();
    scratch.hits.resize(scratch.rays.len(), None);
    geometry.closest_batch(&scratch.rays, &mut scratch.hits);
}

/// Shades all hits: adds emission, asks for light, goes on in a new direction or ends the path.
///
/// `from`: scattering events after which records find where paths go on.
fn shade(world: &World, limits: PathLimits, first: bool, from: Option<u32>, scratch: &mut Scratch) {
    scratch.queries.clear();
    scratch.pending.clear();
    scratch.cached.clear();
    let Scratch {
        paths,
        alive,
        hits,
        queries,
        pending,
        cached,
        pixels,
        ..
    } = scratch;
    let pixels = *pixels;
    let mut kept = 0;
    for k in 0..alive.len() {
        world.geometry.prefetch(hits, k);
        let index = alive[k];
        let path = &mut paths[index as usize];
        let goes_on = match hits[k] {
            None => {
                add_environment(world, path, first);
                false
            }
            Some(hit) => shade_hit(
                world,
                limits,
                first,
                from,
                pixels,
                path,
                hit,
                |query, contribution| {
                    queries.push(query);
                    pending.push(Pending {
                        path: index,
                        contribution,
                    });
                },
            ),
        };
        if goes_on && path.leaving.is_some() {
            cached.push(index);
        } else if goes_on {
            alive[kept] = index;
            kept += 1;
        }
    }
    alive.truncate(kept);
}

/// Adds what the visibility answers let through.
fn collect(geometry: &Geometry, scratch: &mut Scratch) {
    for ((pending, &answer), query) in scratch
        .pending
        .iter()
        .zip(&scratch.answers)
        .zip(&scratch.queries)
    {
        if answer != 0.0 {
            let tint = if geometry.has_panes() {
                geometry.pane_transmittance(&query.ray)
            } else {
                Vec3::ONE
            };
            scratch.paths[pending.path as usize].radiance += pending.contribution * tint * answer;
        }
    }
}

/// Weight of an emitter that a direction has hit at `position`, against light sampling from the last scattering event.
pub(super) fn weight_of_hit(
    lights: &Lights,
    last: Option<Scattering>,
    hit: Hit,
    position: Vec3,
) -> f32 {
    last.map_or(1.0, |last| {
        let pdf = lights.pdf_surface(
            last.position,
            last.light_normal,
            hit.instance,
            hit.primitive,
            position,
        );
        power_heuristic(last.pdf, pdf)
    })
}

/// Weight of a technique with density `a` against another with density `b` (power heuristic, beta 2).
pub(super) fn power_heuristic(a: f32, b: f32) -> f32 {
    if a.is_infinite() {
        return 1.0;
    }
    let ratio = b / a;
    1.0 / (1.0 + ratio * ratio)
}

pub(super) fn add_environment(world: &World, path: &mut Path, first: bool) {
    let direction = path.ray.direction;
    let radiance = world.lights.environment(direction);
    if first {
        path.features.albedo = radiance.clamp(Vec3::ZERO, Vec3::ONE);
    }
    if radiance == Vec3::ZERO {
        return;
    }
    let weight = path.last.map_or(1.0, |last| {
        power_heuristic(
            last.pdf,
            world
                .lights
                .pdf_environment(last.position, last.light_normal, direction),
        )
    });
    path.radiance += path.throughput * radiance * weight;
}

/// Paths per square metre where paths arrive that are spread over `region` square metres a path where they come from, and that
/// would arrive with `density` if they all came from one point. A direction's density alone would tell of the few paths that share
/// this one's last vertex, most of all near corners; what a cache's patch holds are those of the neighbourhood. (The exact
/// density is an integral over it; that areas add up is a bound by its two extremes.)
pub(super) fn arriving_density(density: f32, region: f32) -> f32 {
    density / (1.0 + density * region)
}

/// Shades one hit; returns whether the path goes on. `ask` takes visibility questions and what they bring.
fn shade_hit(
    world: &World,
    limits: PathLimits,
    first: bool,
    from: Option<u32>,
    pixels: f32,
    path: &mut Path,
    hit: Hit,
    ask: impl FnOnce(Query, Vec3),
) -> bool {
    let geometry = world.geometry;
    let toward_eye = -path.ray.direction;
    let Some(surface) = Surface::new(geometry, hit, toward_eye) else {
        return false;
    };
    if path.absorption != Vec3::ZERO {
        path.throughput *= (-path.absorption * hit.t).exp();
    }

    let emission = surface.emission(geometry);
    if emission != Vec3::ZERO && (!path.found || surface.material().unlit) {
        let weight = weight_of_hit(world.lights, path.last, hit, surface.position);
        path.radiance += path.throughput * emission * weight;
    }
    if surface.material().unlit {
        if first {
            path.features = Features {
                albedo: emission.min(Vec3::ONE),
                normal: surface.shading_normal(),
                depth: hit.t,
            };
        }
        return false;
    }

    let is_pane = is_pane(surface.material());
    if path.depth >= limits.max_depth && !is_pane && !first {
        return false;
    }
    let mut parameters = surface.bsdf_parameters(geometry);
    if limits.regularize && path.blurred && !is_pane {
        parameters.roughness = parameters.roughness.max(REGULARIZED_ROUGHNESS);
        parameters.clearcoat_roughness = parameters.clearcoat_roughness.max(REGULARIZED_ROUGHNESS);
    }
    let world_from_local = surface.world_from_local;
    let local_from_world = world_from_local.transpose();
    let wo = local_from_world * toward_eye;
    let bsdf = Bsdf::new(&parameters, wo);
    if first {
        path.features = Features {
            albedo: bsdf.albedo(),
            normal: surface.shading_normal(),
            depth: hit.t,
        };
    }
    if path.depth >= limits.max_depth && !is_pane {
        return false;
    }

    let segment = path.depth + path.panes;
    path.sampler.jump(1 + segment * SETS_PER_SEGMENT);
    // The best stratified pair of a set goes to what matters most.
    let [u, v, pick, roulette] = path.sampler.next();
    let distance = path.travelled + hit.t;
    let light_normal = if parameters.reaches_below() {
        Vec3::ZERO
    } else {
        surface.shading_normal()
    };

    // Records may find where the path goes on from here: not along lobes that are narrower than their texels.
    let by_records =
        |pdf: f32| from.is_some_and(|from| path.depth + 1 >= from) && pdf <= image_space::SHARPEST;
    if !bsdf.is_delta() && path.depth < limits.max_depth {
        let sample = world.lights.sample(
            geometry.scene,
            surface.position,
            light_normal,
            pick,
            Vec2::new(u, v),
        );
        if let Some(light) = sample {
            let wi = local_from_world * light.wi;
            let side = light.wi.dot(surface.normal);
            if bsdf.connects(wi, side > 0.0) {
                let (f_cos, pdf) = bsdf.eval(wo, wi);
                // Records do not know which lamp it is that they see: where they are asked, light sampling finds all lamps.
                let lamp = light.target.is_some();
                let weight = if light.delta || lamp && by_records(pdf) {
                    1.0
                } else {
                    power_heuristic(light.pdf, pdf)
                };
                let contribution = path.throughput * f_cos * light.radiance * (weight / light.pdf);
                if contribution != Vec3::ZERO && contribution.is_finite() {
                    let normal = surface.normal * side.signum();
                    let origin = offset_along_normal(surface.position, normal, surface.extent);
                    let ray = match light.target {
                        Some(target) => Ray::between(origin, target),
                        None => Ray::new(origin, light.wi),
                    };
                    let spread = if path.parallel {
                        1.0
                    } else {
                        distance * distance
                    };
                    let density = arriving_density(
                        path.direction_density * toward_eye.dot(surface.normal).abs() / spread,
                        path.region,
                    );
                    let eye = Endpoint::new(surface.position, normal, density);
                    // The densities of other ends hold the probability of the pick; exact ends have none to hold it.
                    let connections = if light.delta { light.pdf } else { 1.0 };
                    let query = Query {
                        connections,
                        importance: contribution.element_sum(),
                        ..Query::new(eye, light.end, ray)
                    };
                    ask(query, contribution);
                }
            }
        }
    }

    let [u, v, lobe, spare] = path.sampler.next();
    let Some(sample) = bsdf.sample(wo, lobe, Vec2::new(u, v)) else {
        return false;
    };
    let direction = (world_from_local * sample.wi).normalize();
    let side = direction.dot(surface.normal);
    if !bsdf.connects(sample.wi, side > 0.0) {
        return false;
    }
    // What passes anything but a pane counts as an event, since shadow rays do not pass it.
    let passed = sample.passed && is_pane;
    if !passed {
        path.found = !sample.delta && by_records(sample.pdf);
        path.leaving = path.found.then(|| Leaving {
            normal: surface.normal * side.signum(),
            random: spare,
        });
    }
    if passed {
        path.panes += 1;
        if path.panes > MOST_PANES {
            return false;
        }
        path.travelled = distance;
    } else {
        path.depth += 1;
        if path.depth > limits.max_depth {
            return false;
        }
        path.last = (!sample.delta).then_some(Scattering {
            position: surface.position,
            light_normal,
            pdf: sample.pdf,
        });
        if sample.delta {
            path.travelled = distance;
        } else {
            let spread = if path.parallel {
                1.0
            } else {
                distance * distance
            };
            let arriving = path.direction_density * toward_eye.dot(surface.normal).abs() / spread;
            path.region = 1.0 / arriving_density(arriving, path.region);
            path.travelled = 0.0;
            path.direction_density = sample.pdf * pixels;
            path.parallel = false;
            path.blurred = true;
        }
        if side < 0.0
            && let Some(absorption) = absorption_behind(&surface)
        {
            path.absorption = absorption;
        }
    }
    path.throughput *= sample.weight;
    path.squeezed *= sample.eta2;
    if !passed && path.depth >= ROULETTE_AFTER {
        // The root keeps paths longer than the throughput itself would: dark pixels, in which relative error counts, get
        // their light from long paths, and a survivor's weight grows less.
        let survival = (path.throughput.max_element() * path.squeezed)
            .min(1.0)
            .sqrt();
        if roulette >= survival {
            return false;
        }
        path.throughput /= survival;
    }
    if path.throughput.max_element() <= 0.0 || !path.throughput.is_finite() {
        return false;
    }
    let origin = offset_along_normal(
        surface.position,
        surface.normal * side.signum(),
        surface.extent,
    );
    path.ray = Ray::new(origin, direction);
    true
}

/// Absorption per metre behind the side of a surface that is seen; `None` if the surface says nothing about it.
pub(super) fn absorption_behind(surface: &Surface) -> Option<Vec3> {
    let volume = surface.material().volume?;
    let inside = surface.front && volume.attenuation_distance.is_finite();
    Some(if inside {
        -volume
            .attenuation_color
            .max(Vec3::splat(f32::MIN_POSITIVE))
            .map(f32::ln)
            / volume.attenuation_distance
    } else {
        Vec3::ZERO
    })
}
