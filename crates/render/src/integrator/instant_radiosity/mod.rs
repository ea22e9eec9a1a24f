//! Instant radiosity: the picture is lit by many virtual lights, which all eye samples share.
//!
//! Keller 1997, in the form of the second renderer of Popov et al. 2013 (section 4.2): eye paths in the manner of Whitted are kept
//! as deep deferred samples of a tile (`eye`), virtual lights are the vertices of light paths, drawn by what they bring to the
//! picture (`vpl`), and everything is shaded by blocks of 16 lights (`shade`) while
//! [`Visibility::answer_many`] answers who sees whom. Direct light: all point, spot and directional lights through the same path
//! (many of them: one drawn by the light tree); one light sample an eye sample on emissive surfaces and suns; [`SKY_SAMPLES`]
//! directions of the sky, which all eye samples share.
//!
//! Virtual lights and sky samples are one fixed set for the whole job: a pure function of the seed. More samples a pixel smooth
//! edges and noise; what the set gets wrong stays, and only more virtual lights mend it. Averaged over seeds, the picture
//! is that of the path tracer, apart from what is bounded and left out:
//!
//! * the geometry term of a virtual light is bounded ([`InstantRadiosity::clamp`]); what that takes away is measured, and
//!   gathered again by short paths on demand (Kollig & Keller 2004), see `gather`;
//! * virtual lights scatter like Lambert surfaces (`vpl`);
//! * light that reaches the first rough surface by way of a mirror or glass is seen only if a light path left it there as
//!   a virtual light, which lights others but not its own surface: direct caustics are missing.
//!
//! The wrong tool for caustics and for scenes of glossy metal; the right one for a fast look at diffuse rooms.

mod eye;
mod gather;
mod pool;
mod shade;
mod vpl;

use super::{RenderSettings, Sequence, Unit, Worker, World};
use crate::camera::View;
use crate::film::{FilmTile, FixedSum};
use crate::geometry::Geometry;
use crate::light::{DeltaLight, Lights};
use crate::sampling::Sampler;
use eye::{Harvest, Walk};
use glam::{Vec2, Vec3};
use occlude_visibility::{Class, LightEnd, SharedLight, Visibility, order};
pub(super) use pool::Pool;
use shade::{Asker, Kind, LightList, Packs, Panes};
use std::sync::{Mutex, PoisonError};

/// Width and height of a tile, pixels.
pub(super) const TILE: u32 = 32;

/// Samples a pixel that a tile takes together, at most: their questions answer each other.
pub(super) const SAMPLES_TOGETHER: u32 = 16;

/// Directions of the sky that all eye samples ask about (Popov 2013, section 5).
const SKY_SAMPLES: u32 = 256;

/// Lights without extent that all eye samples ask about; of more, each draws one.
const MOST_SHARED: usize = 256;

/// Eye samples along the side of a cluster that the asking order prepares for (Popov 2013, section 4.3, `C_E`).
const CLUSTER: f32 = 14.0;

/// What instant radiosity may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstantRadiosity {
    /// Most scattering events on a path: 0 sees emitters only, 1 adds direct light.
    pub max_depth: u32,
    /// Virtual lights; those drawn twice become one.
    pub vpls: u32,
    /// Bound on the geometry term `cos cos / d^2` of a virtual light, per square metre; may be infinite. `None` chooses one by
    /// the distances between the lights.
    pub clamp: Option<f32>,
    /// Gathers what the bound takes away by short paths.
    pub compensate: bool,
}

/// What became of a rendering by instant radiosity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstantRadiosityReport {
    /// Virtual lights.
    pub vpls: u32,
    /// Those among them that the picture before did not have.
    pub renewed: u32,
    /// The bound on the geometry term that was used, per square metre.
    pub clamp: f32,
    /// What the bound took away, as a share of the picture's sum with it.
    pub clamped_energy: f64,
}

/// What all tiles share.
pub(super) struct Prepared {
    settings: InstantRadiosity,
    /// Emissive surfaces and suns.
    areas: Lights,
    /// Lights without extent, if there are too many to ask about all.
    picked: Option<Lights>,
    /// Shared lights: points, directions, sky samples.
    direct: Vec<LightList>,
    vpls: LightList,
    /// Virtual lights, and those that the picture before did not have.
    count: u32,
    renewed: u32,
    clamp: f32,
    /// Rays traced in preparation.
    pub(super) rays: u64,
    /// Sum of the film, and of what the clamp took from it.
    sums: Mutex<[FixedSum; 2]>,
}

impl Prepared {
    pub(super) fn new(
        world: &World,
        view: &View,
        settings: &RenderSettings,
        wanted: InstantRadiosity,
        sequence: &mut Sequence,
    ) -> Self {
        let Geometry { scene, pose, .. } = world.geometry;
        let deltas: Vec<DeltaLight> = world.lights.deltas().collect();
        let many = deltas.len() > MOST_SHARED;
        let mut direct = Vec::new();
        if !many {
            direct.extend(shared_deltas(&deltas));
        }
        direct.extend(sky(world.lights, settings));
        direct.retain(|list| !list.is_empty());
        let mut prepared = Self {
            settings: wanted,
            areas: world.lights.areas(scene, pose),
            picked: many.then(|| world.lights.without_extent(scene, pose)),
            direct,
            vpls: LightList::new(Kind::Patch),
            count: 0,
            renewed: 0,
            clamp: f32::INFINITY,
            rays: 0,
            sums: Mutex::new([FixedSum::default(); 2]),
        };
        if wanted.max_depth > 1 && wanted.vpls > 0 {
            let (pool, renew) = (&mut sequence.virtual_lights, sequence.renew);
            let lights = pool::next(pool, renew, world, view, settings, &prepared);
            (prepared.count, prepared.renewed) = (lights.count, lights.renewed);
            (prepared.vpls, prepared.clamp, prepared.rays) =
                (lights.list, lights.clamp, lights.rays);
        }
        prepared
    }

    /// The virtual lights, as visibility strategies know them.
    pub(super) fn virtual_lights(&self) -> &[SharedLight] {
        &self.vpls.shared
    }

    /// What virtual lights bring to surface points: where rays end, normal, and radiance times area of each; and the bound on the geometry term.
    pub(super) fn patches(&self) -> (impl Iterator<Item = (Vec3, Vec3, Vec3)>, f32) {
        (self.vpls.patches(), self.clamp)
    }

    fn compensates(&self) -> bool {
        self.settings.compensate && self.clamp.is_finite()
    }

    pub(super) fn report(&self) -> InstantRadiosityReport {
        let [sum, clamped] = *self.sums.lock().unwrap_or_else(PoisonError::into_inner);
        let (sum, clamped) = (sum.value(), clamped.value());
        InstantRadiosityReport {
            vpls: self.count,
            renewed: self.renewed,
            clamp: self.clamp,
            clamped_energy: if sum > 0.0 { clamped / sum } else { 0.0 },
        }
    }
}

/// Lists of the lights without extent.
fn shared_deltas(deltas: &[DeltaLight]) -> [LightList; 2] {
    let mut points = LightList::new(Kind::Point);
    let mut directions = LightList::new(Kind::Direction);
    for light in deltas {
        match *light {
            DeltaLight::Point {
                position,
                intensity,
                cone,
            } => {
                let shared = SharedLight {
                    end: LightEnd::Point(position),
                    target: Some(position),
                    connections: 1.0,
                };
                points.push_point(shared, position, intensity, cone);
            }
            DeltaLight::Direction {
                towards,
                irradiance,
            } => {
                let shared = SharedLight {
                    end: LightEnd::Direction(towards),
                    target: None,
                    connections: 1.0,
                };
                directions.push_direction(shared, towards, irradiance);
            }
        }
    }
    [points, directions]
}

/// Directions of the sky, in proportion to its brightness.
fn sky(lights: &Lights, settings: &RenderSettings) -> Option<LightList> {
    /// Tells these numbers from those of pixels.
    const STREAM: u64 = 0x736b_7973_6b79_736b;
    let sky = lights.sky()?;
    let mut list = LightList::new(Kind::Direction);
    let mut drawn: Vec<(Vec3, f32)> = (0..SKY_SAMPLES)
        .filter_map(|i| {
            let seed = settings.seed ^ STREAM;
            let mut sampler = Sampler::new(settings.sampler, seed, [u32::MAX; 2], i);
            let [u, v, ..] = sampler.next();
            let direction = sky.sample(Vec3::ZERO, Vec2::new(u, v))?;
            let density = sky.pdf(Vec3::ZERO, direction);
            (density > 0.0 && density.is_finite()).then_some((direction, density))
        })
        .collect();
    drawn.sort_by_key(|(direction, _)| vpl::morton((*direction + 1.0) * 0.5));
    for (direction, density) in drawn {
        let shared = SharedLight {
            end: LightEnd::SolidAngle { direction, density },
            target: None,
            connections: SKY_SAMPLES as f32,
        };
        let irradiance = sky.radiance(direction) / (density * SKY_SAMPLES as f32);
        list.push_direction(shared, direction, irradiance);
    }
    Some(list)
}

/// Buffers that a worker keeps from tile to tile.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    harvest: Harvest,
    places: Vec<[u32; 2]>,
    radiance: Vec<Vec3>,
    answers: Vec<f32>,
    packs: Packs,
    order: Order,
}

/// The order of a tile's samples; most tiles are alike.
#[derive(Debug, Default)]
struct Order {
    /// Width and height of the lattice, and samples on it.
    size: [u32; 3],
    places: Vec<[u32; 2]>,
}

impl Order {
    /// See [`order::progressive`].
    fn of(&mut self, size: [u32; 3]) -> &[[u32; 2]] {
        if self.size != size {
            let [width, height, samples] = size;
            let first = samples as f32 / (CLUSTER * CLUSTER);
            self.size = size;
            self.places = order::progressive(width, height, first);
        }
        &self.places
    }
}

/// Renders the samples of a unit into its tile.
pub(super) fn render_unit<'a, V: Visibility<Geometry<'a>>>(
    world: &World<'a>,
    view: &View,
    visibility: &V,
    settings: &RenderSettings,
    prepared: &Prepared,
    unit: &Unit,
    worker: &mut Worker<V::Worker>,
    tile: &mut FilmTile,
) {
    let scratch = &mut worker.instant_radiosity;
    let samples = unit.samples.len() as u32;
    let mut starts: Vec<_> = unit.starts(settings).map(Some).collect();
    scratch.harvest.walks.clear();
    scratch.places.clear();
    // Samples of a pixel stand on a small lattice of their own, so that the order runs over pixels and samples alike.
    let columns = (samples as f32).sqrt().ceil() as u32;
    let rows = samples.div_ceil(columns.max(1));
    let lattice = [
        unit.width * columns,
        unit.height * rows,
        starts.len() as u32,
    ];
    for &[x, y] in scratch.order.of(lattice) {
        let sample = y % rows * columns + x % columns;
        let pixel = y / rows * unit.width + x / columns;
        if sample >= samples {
            continue;
        }
        let Some(start) = starts[(pixel * samples + sample) as usize].take() else {
            continue;
        };
        let camera = view.ray(start.point);
        scratch.places.push([start.x, start.y]);
        scratch
            .harvest
            .walks
            .push(Walk::new(&camera, start.sampler));
    }
    let harvest = &mut scratch.harvest;
    harvest.shares_singles = visibility.class() == Class::Consistent;
    harvest.gather(world, prepared);
    worker.rays.primary += harvest.walks.len() as u64;
    worker.rays.secondary += harvest.secondary;

    visibility.begin(&mut worker.visibility, unit.epoch());
    scratch.radiance.clear();
    scratch.radiance.resize(harvest.walks.len(), Vec3::ZERO);
    let mut clamped = 0.0;
    let packs = &mut scratch.packs;
    packs.gather(&harvest.eyes, &harvest.scatterers);
    for lights in prepared.direct.iter().chain([&prepared.vpls]) {
        let mut asker = Asker {
            lights,
            eyes: &harvest.eyes,
            scatterers: &harvest.scatterers,
            clamp: prepared.clamp,
            panes: Panes::new(world.geometry, lights, packs, &harvest.ends),
            packs,
            clamped: 0.0,
        };
        visibility.answer_many(
            world.geometry,
            &mut worker.visibility,
            &harvest.ends,
            &lights.shared,
            &mut asker,
        );
        clamped += asker.clamped;
    }
    packs.settle(&harvest.eyes, &mut scratch.radiance);
    scratch.answers.clear();
    scratch.answers.resize(harvest.queries.len(), 0.0);
    visibility.answer(
        world.geometry,
        &mut worker.visibility,
        &harvest.queries,
        &mut scratch.answers,
    );
    harvest.settle(world.geometry, &scratch.answers);
    if prepared.compensates() {
        worker.rays.secondary += gather::compensate(
            world,
            view,
            visibility,
            prepared.settings.max_depth,
            prepared.clamp,
            harvest,
            &mut worker.visibility,
            &mut worker.path,
            &mut scratch.radiance,
        );
    }

    let mut sum = 0.0;
    for ((walk, &brought), &[x, y]) in harvest
        .walks
        .iter()
        .zip(&scratch.radiance)
        .zip(&scratch.places)
    {
        let radiance = walk.radiance + brought;
        if radiance.is_finite() {
            sum += f64::from(radiance.element_sum());
        }
        tile.add(x, y, radiance, Some(&walk.features));
    }
    let mut sums = prepared.sums.lock().unwrap_or_else(PoisonError::into_inner);
    sums[0].add(sum);
    sums[1].add(clamped);
}
