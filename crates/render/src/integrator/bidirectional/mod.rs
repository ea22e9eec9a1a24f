//! Bidirectional path tracing.
//!
//! One path starts at the camera and one at a light for every sample (Lafortune & Willems 1993; Veach & Guibas 1994; Veach 1997, chapter 10).
//! Every vertex of one is connected to every vertex of the other; besides, camera paths hit emitters (`s = 0`) and ask lights (`s = 1`, with
//! the sampling of the path tracer), and light paths are seen by the camera (`t = 1`). Each path of light is found by many of these
//! strategies, which are combined by the power heuristic over all of them (see `weight`).
//!
//! Work proceeds as everywhere: about a thousand light paths advance together, then the camera paths of the same samples; all visibility
//! questions of a pass are asked at once, those of one eye end next to each other. Surfaces are evaluated as the path tracer does, so
//! that both have the same expectation: both normals must agree on a side, clear panes are passed without an event and tint connections,
//! blended surfaces decide by chance.
//!
//! The wrong tool for open scenes under a sky (most light paths miss what the camera sees) and for scenes with very many lights of which each
//! place sees few; and light that is seen by way of a mirror and had come by way of a mirror is found by hits alone, as in the path
//! tracer.

mod connect;
mod vertex;
mod walk;
mod weight;

use super::{RenderSettings, Unit, Worker, World};
use crate::camera::{PixelFilter, View};
use crate::film::{Features, FilmTile, Splat};
use crate::geometry::{Geometry, is_pane};
use crate::light::Emission;
use connect::{Connection, Stage};
use glam::{Vec2, Vec3};
use occlude_visibility::{Hit, Query, Ray, Visibility};
use vertex::{NONE, Vertex};
use walk::Walk;

/// What bidirectional path tracing may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BidirectionalLimits {
    /// Most scattering events on a path: 0 sees emitters only, 1 adds direct light.
    pub max_depth: u32,
    /// Which strategies take part.
    pub techniques: Techniques,
}

impl BidirectionalLimits {
    /// All strategies, for paths of at most `max_depth` scattering events.
    pub fn new(max_depth: u32) -> Self {
        Self {
            max_depth,
            techniques: Techniques::All,
        }
    }
}

/// Strategies of bidirectional path tracing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Techniques {
    /// All, each path weighted by how well each of them finds it.
    #[default]
    All,
    /// One alone, without weights: the picture of all light that it can find. To look at, and to test.
    Only {
        /// Vertices from the light, the point on the light included.
        light: u32,
        /// Vertices from the camera, the camera included.
        camera: u32,
    },
}

impl Techniques {
    /// The weight of a strategy: computed if all take part.
    fn weigh(self, light: u32, camera: u32, weight: impl FnOnce() -> f32) -> f32 {
        match self {
            Self::All => weight(),
            only => f32::from(u8::from(only == Self::Only { light, camera })),
        }
    }
}

/// The first dimension set of light paths: beyond all that camera paths use.
const LIGHT_SETS: u32 = 1 << 24;

/// Dimension sets in which a light path starts.
const EMISSION_SETS: u32 = 2;

/// Dimension sets that one segment of a camera path uses.
const SETS_PER_SEGMENT: u32 = 2;

/// Where a connection's light goes.
#[derive(Clone, Copy, Debug)]
enum Target {
    /// To a sample of the unit.
    Sample(u32),
    /// To a point of the picture.
    Picture(Vec2),
}

#[derive(Clone, Copy, Debug)]
struct Pending {
    target: Target,
    contribution: Vec3,
}

/// A sample of a pixel and what it has gathered.
#[derive(Clone, Copy, Debug)]
struct Gathered {
    x: u32,
    y: u32,
    radiance: Vec3,
    features: Features,
}

/// Buffers that a worker keeps from tile to tile.
#[derive(Debug, Default)]
pub(super) struct Scratch<'a> {
    samples: Vec<Gathered>,
    walks: Vec<Walk>,
    light_walks: Vec<Walk>,
    alive: Vec<u32>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    /// Vertices of all light paths.
    vertices: Vec<Vertex<'a>>,
    queries: Vec<Query>,
    pending: Vec<Pending>,
    answers: Vec<f32>,
    /// Light on its way to other places of the picture.
    pub(super) splats: Vec<Splat>,
}

/// Renders the samples of a unit into its tile; what falls elsewhere is left in the scratch space's `splats`.
pub(super) fn render_unit<'a, V: Visibility<Geometry<'a>>>(
    world: &World<'a>,
    view: &View,
    visibility: &V,
    settings: &RenderSettings,
    (limits, emission): (BidirectionalLimits, &Emission),
    unit: &Unit,
    worker: &mut Worker<'a, V::Worker>,
    tile: &mut FilmTile,
) {
    let stage = Stage {
        world,
        view,
        filter: settings.filter,
        emission,
        samples: view.width() as f32 * view.height() as f32,
        max_depth: limits.max_depth,
        techniques: limits.techniques,
    };
    let scratch = &mut worker.bidirectional;
    scratch.samples.clear();
    scratch.walks.clear();
    scratch.light_walks.clear();
    scratch.alive.clear();
    scratch.vertices.clear();
    scratch.splats.clear();
    for start in unit.starts(settings) {
        let camera = view.ray(start.point);
        scratch
            .walks
            .push(Walk::from_camera(&camera, start.sampler, stage.samples));
        scratch.samples.push(Gathered {
            x: start.x,
            y: start.y,
            radiance: Vec3::ZERO,
            features: Features::default(),
        });
    }
    visibility.begin(&mut worker.visibility, unit.epoch());
    let mut answer = |scratch: &mut Scratch<'a>| {
        scratch.answers.clear();
        scratch.answers.resize(scratch.queries.len(), 0.0);
        let (queries, answers) = (&scratch.queries, &mut scratch.answers);
        visibility.answer(world.geometry, &mut worker.visibility, queries, answers);
        collect(&stage, scratch);
    };

    // A light path of no scattering event is found by the camera alone.
    if limits.max_depth > 0 {
        start_light_paths(&stage, scratch);
    }
    while !scratch.alive.is_empty() {
        worker.rays.secondary += scratch.alive.len() as u64;
        extend(
            world.geometry,
            &scratch.light_walks,
            &scratch.alive,
            &mut scratch.rays,
            &mut scratch.hits,
        );
        shade_light_paths(&stage, scratch);
        answer(scratch);
    }

    scratch.alive.extend(0..scratch.walks.len() as u32);
    let mut first = true;
    while !scratch.alive.is_empty() {
        let count = scratch.alive.len() as u64;
        if first {
            worker.rays.primary += count;
        } else {
            worker.rays.secondary += count;
        }
        extend(
            world.geometry,
            &scratch.walks,
            &scratch.alive,
            &mut scratch.rays,
            &mut scratch.hits,
        );
        shade_camera_paths(&stage, first, scratch);
        answer(scratch);
        first = false;
    }
    for sample in &scratch.samples {
        tile.add(sample.x, sample.y, sample.radiance, Some(&sample.features));
    }
}

/// Starts one light path a sample; those that start are alive.
fn start_light_paths(stage: &Stage, scratch: &mut Scratch) {
    let (lights, scene) = (stage.world.lights, stage.world.geometry.scene);
    for (index, walk) in (0..).zip(&scratch.walks) {
        let mut sampler = walk.sampler;
        sampler.jump(LIGHT_SETS);
        let [a, b, pick, _] = sampler.next();
        let [c, d, ..] = sampler.next();
        let (place, turn) = (Vec2::new(a, b), Vec2::new(c, d));
        let emitted = stage.emission.sample(lights, scene, pick, place, turn);
        // A path that does not start keeps its place in the list, dead from the beginning.
        scratch.light_walks.push(match &emitted {
            Some(emitted) => Walk::from_light(emitted, sampler),
            None => *walk,
        });
        if emitted.is_some() {
            scratch.alive.push(index);
        }
    }
}

/// Finds what every living path hits.
fn extend(
    geometry: &Geometry,
    walks: &[Walk],
    alive: &[u32],
    rays: &mut Vec<Ray>,
    hits: &mut Vec<Option<Hit>>,
) {
    rays.clear();
    rays.extend(alive.iter().map(|&i| walks[i as usize].ray));
    hits.clear();
    hits.resize(rays.len(), None);
    geometry.closest_batch(rays, hits);
}

/// Keeps the paths that `goes_on` says go on.
fn retain(
    alive: &mut Vec<u32>,
    hits: &[Option<Hit>],
    mut goes_on: impl FnMut(u32, Option<Hit>) -> bool,
) {
    let mut hits = hits.iter();
    alive.retain(|&index| goes_on(index, hits.next().copied().flatten()));
}

/// Makes vertices of all hits of light paths, shows them to the camera, and goes on.
fn shade_light_paths<'a>(stage: &Stage<'_, 'a>, scratch: &mut Scratch<'a>) {
    let Scratch {
        light_walks,
        alive,
        hits,
        vertices,
        queries,
        pending,
        ..
    } = scratch;
    queries.clear();
    pending.clear();
    let (geometry, lights) = (stage.world.geometry, stage.world.lights);
    retain(alive, hits, |index, hit| {
        let walk = &mut light_walks[index as usize];
        let vertex = hit
            .and_then(|hit| walk.arrive(geometry, hit))
            .filter(|surface| !surface.material().unlit)
            .and_then(|surface| walk.vertex(geometry, lights, surface));
        let Some(vertex) = vertex else {
            return false;
        };
        let number = vertices.len() as u32;
        vertices.push(vertex);
        walk.link = number;
        if !vertex.facing.bsdf.is_delta()
            && let Some((point, connection)) = stage.show(&vertex)
        {
            queries.push(connection.query);
            pending.push(Pending {
                target: Target::Picture(point),
                contribution: connection.contribution,
            });
        }
        walk.sampler
            .jump(LIGHT_SETS + EMISSION_SETS + walk.depth + walk.panes);
        let numbers = walk.sampler.next();
        // A vertex beyond that no event is left for would be of no use.
        walk.depart(lights, &vertex, stage.max_depth - 1, numbers)
    });
}

/// Shades all hits of camera paths: adds emission, connects to lights and light paths, and goes on.
fn shade_camera_paths(stage: &Stage, first: bool, scratch: &mut Scratch) {
    let Scratch {
        samples,
        walks,
        light_walks,
        alive,
        hits,
        vertices,
        queries,
        pending,
        ..
    } = scratch;
    queries.clear();
    pending.clear();
    retain(alive, hits, |index, hit| {
        let (walk, sample) = (&mut walks[index as usize], &mut samples[index as usize]);
        let Some(hit) = hit else {
            let radiance = stage.world.lights.environment(walk.ray.direction);
            if first {
                sample.features.albedo = radiance.clamp(Vec3::ZERO, Vec3::ONE);
            }
            if radiance != Vec3::ZERO {
                sample.radiance += walk.throughput * radiance * stage.hit_sky(walk);
            }
            return false;
        };
        // Light paths that never started have no vertices.
        let newest = light_walks
            .get(index as usize)
            .map_or(NONE, |walk| walk.link);
        let mut connect = |connection: Connection| {
            queries.push(connection.query);
            pending.push(Pending {
                target: Target::Sample(index),
                contribution: connection.contribution,
            });
        };
        shade_hit(
            stage,
            first,
            walk,
            sample,
            hit,
            vertices,
            newest,
            &mut connect,
        )
    });
}

/// Shades one hit of a camera path; returns whether it goes on.
fn shade_hit(
    stage: &Stage,
    first: bool,
    walk: &mut Walk,
    sample: &mut Gathered,
    hit: Hit,
    vertices: &[Vertex],
    newest: u32,
    connect: &mut impl FnMut(Connection),
) -> bool {
    let (geometry, lights) = (stage.world.geometry, stage.world.lights);
    let Some(surface) = walk.arrive(geometry, hit) else {
        return false;
    };
    let emission = surface.emission(geometry);
    if emission != Vec3::ZERO {
        sample.radiance += walk.throughput * emission * stage.hit_surface(walk, &surface);
    }
    if first {
        sample.features = Features {
            albedo: emission.min(Vec3::ONE),
            normal: surface.shading_normal(),
            depth: hit.t,
        };
    }
    if surface.material().unlit {
        return false;
    }
    let Some(vertex) = walk.vertex(geometry, lights, surface) else {
        return false;
    };
    if first {
        sample.features.albedo = vertex.facing.bsdf.albedo();
    }
    let scatters = walk.depth < stage.max_depth;
    if !scatters && !is_pane(surface.material()) {
        return false;
    }
    walk.sampler
        .jump(1 + (walk.depth + walk.panes) * SETS_PER_SEGMENT);
    // The best stratified pair of a set goes to what matters most.
    let [u, v, pick, roulette] = walk.sampler.next();
    if scatters && !vertex.facing.bsdf.is_delta() {
        if let Some(connection) = stage.next_event(&vertex, pick, Vec2::new(u, v)) {
            connect(connection);
        }
        let mut number = newest;
        while let Some(light) = vertices.get(number as usize) {
            number = light.link;
            let fits = vertex.depth + light.depth + 2 <= stage.max_depth;
            if fits
                && !light.facing.bsdf.is_delta()
                && let Some(connection) = stage.join(&vertex, light)
            {
                connect(connection);
            }
        }
    }
    let [u, v, lobe, _] = walk.sampler.next();
    walk.depart(lights, &vertex, stage.max_depth, [u, v, lobe, roulette])
}

/// Adds what the visibility answers let through.
fn collect(stage: &Stage, scratch: &mut Scratch) {
    let geometry = stage.world.geometry;
    let asked = scratch.pending.iter().zip(&scratch.queries);
    for ((pending, query), &answer) in asked.zip(&scratch.answers) {
        if answer == 0.0 {
            continue;
        }
        let mut light = pending.contribution * answer;
        if geometry.has_panes() {
            light *= geometry.pane_transmittance(&query.ray);
        }
        match pending.target {
            Target::Sample(index) => scratch.samples[index as usize].radiance += light,
            Target::Picture(point) => {
                splat(stage.filter, stage.view, point, light, &mut scratch.splats);
            }
        }
    }
}

/// Spreads light that arrives at a point of the picture over the pixels whose filter reaches it.
fn splat(filter: PixelFilter, view: &View, point: Vec2, radiance: Vec3, splats: &mut Vec<Splat>) {
    let reach = filter.radius().ceil() as i64 - i64::from(filter == PixelFilter::Box);
    let (column, row) = (point.x.floor() as i64, point.y.floor() as i64);
    let inside = |i: i64, size: u32| u32::try_from(i).ok().filter(|&i| i < size);
    for y in (row - reach..=row + reach).filter_map(|y| inside(y, view.height())) {
        for x in (column - reach..=column + reach).filter_map(|x| inside(x, view.width())) {
            let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let share = match filter {
                PixelFilter::Box => 1.0,
                _ => filter.density(point - centre),
            };
            if share > 0.0 {
                splats.push(Splat {
                    x,
                    y,
                    radiance: radiance * share,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests;
