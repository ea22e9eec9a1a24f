//! Virtual lights: where light paths meet surfaces, chosen by what they bring to the picture.
//!
//! Keller, "Instant Radiosity" (1997): every vertex of a light path becomes a light that sends on what its surface
//! scatters. Segovia et al., "Bidirectional Instant Radiosity" (2006): many candidates are made, what each brings to the picture
//! is estimated with a few eye samples and exact visibility, and the lights are drawn from the candidates in that
//! proportion, so that every light that remains gives the picture about as much. The estimate steers the choice only; weights
//! make up for it, and a fifth of the choice follows the light's flux alone, so that no light is out of reach: the expected
//! picture does not depend on it.
//!
//! A virtual light is Lambert about the geometric normal, with the albedo of the surface's broad lobes; narrow lobes and glass
//! are followed, so that light paths leave caustics behind. Wrong tool where surfaces gloss: their highlights are not passed on.

use super::eye::{Harvest, Walk};
use super::shade::{Eye, LightList, Scatter, patch_on_lambert};
use super::{InstantRadiosity, Prepared};
use crate::bsdf::Bsdf;
use crate::camera::View;
use crate::geometry::{Surface, is_pane};
use crate::integrator::{RenderSettings, World, path};
use crate::light::Emission;
use crate::sampling::Sampler;
use glam::{Vec2, Vec3};
use occlude_visibility::{
    Endpoint, EyeSample, LightEnd, Ray, SharedLight, Tracer, offset_along_normal,
};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// Light paths for every virtual light that is wanted, at least and at most.
const PATHS_PER_LIGHT: usize = 4;
const MOST_PATHS_PER_LIGHT: usize = 32;

/// Eye samples by which candidates are judged, at most, and the rays that this may take.
const MOST_PILOTS: usize = 256;
const PILOT_RAYS: usize = 2 << 20;

/// Share of the choice that follows flux alone.
const DEFENSIVE: f64 = 0.2;

/// See [`default_clamp`], steradians.
const MOST_SOLID_ANGLE: f32 = 0.25;

/// Tells the numbers of light paths from those of pixels.
const STREAM: u64 = 0x6c69_6768_7470_6174;

/// A vertex of a light path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) position: Vec3,
    /// Geometric normal, on the side that is lit.
    pub(super) normal: Vec3,
    /// The position, moved off the surface.
    pub(super) target: Vec3,
    /// Radiance times area that leaves to any direction above.
    pub(super) colour: Vec3,
    /// Expected number of such vertices, all paths together, per square metre.
    pub(super) density: f32,
    /// Scattering events of the path, this one included.
    pub(super) events: u32,
}

/// A candidate that was drawn: its colour is weighed by the probability of that, its density counts lights of its kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn {
    pub(super) light: Candidate,
    /// Place on the Morton curve.
    pub(super) code: u64,
}

/// Virtual lights, and what making them took.
pub(super) struct Made {
    pub(super) drawn: Vec<Drawn>,
    pub(super) curve: Curve,
    /// Bound on the geometry term.
    pub(super) clamp: f32,
    /// Light paths that candidates were taken from.
    pub(super) paths: usize,
    /// Rays traced.
    pub(super) rays: u64,
}

/// Makes the virtual lights of a job. `prepared` holds everything else.
///
/// A small trial with numbers of its own finds out how many light paths it takes until enough candidates matter to the
/// picture: one in four in a room, one in fifty where the sun shines on a roof and the camera is below.
pub(super) fn make(
    world: &World,
    view: &View,
    settings: &RenderSettings,
    prepared: &Prepared,
    stream: u32,
) -> Made {
    let wanted = &prepared.settings;
    let count = wanted.vpls as usize;
    let trial = attempt(world, view, settings, prepared, count, stream + 1);
    let total: f64 = trial.brought.iter().sum();
    let squares: f64 = trial.brought.iter().map(|b| b * b).sum();
    let useful = if squares > 0.0 {
        total * total / squares
    } else {
        0.0
    };
    let factor = 2.0 * count as f64 / useful.max(1.0);
    let factor = (factor.ceil() as usize).clamp(PATHS_PER_LIGHT, MOST_PATHS_PER_LIGHT);
    let paths = count * factor;
    let made = attempt(world, view, settings, prepared, paths, stream);
    let curve = Curve::around(&made.candidates);
    let order = curve.order(&made.candidates);
    let share = f64::from(wanted.vpls);
    let offset = offset(settings, stream);
    let drawn = choose(
        &made.candidates,
        &made.brought,
        &order,
        wanted.vpls,
        share,
        offset,
    );
    let positions: Vec<Vec3> = drawn.iter().map(|drawn| drawn.light.position).collect();
    let clamp = bound(wanted, &positions);
    Made {
        drawn,
        curve,
        clamp,
        paths,
        rays: trial.rays + made.rays,
    }
}

/// A random number for systematic sampling.
pub(super) fn offset(settings: &RenderSettings, stream: u32) -> f32 {
    Sampler::new(
        crate::sampling::SamplerKind::Independent,
        settings.seed ^ STREAM,
        [0, u32::MAX],
        stream,
    )
    .next()[0]
}

/// Candidates, and what each brings to the picture.
struct Attempt {
    candidates: Vec<Candidate>,
    brought: Vec<f64>,
    rays: u64,
}

fn attempt(
    world: &World,
    view: &View,
    settings: &RenderSettings,
    prepared: &Prepared,
    paths: usize,
    stream: u32,
) -> Attempt {
    let wanted = &prepared.settings;
    let (candidates, mut rays) = candidates(world, settings, wanted, paths, stream);
    let (pilots, walked) = pilots(
        world,
        view,
        settings,
        prepared,
        (PILOT_RAYS / candidates.len().max(1)).clamp(16, MOST_PILOTS),
    );
    let step = (candidates.len() / wanted.vpls.max(1) as usize).max(1);
    let some: Vec<Vec3> = candidates
        .iter()
        .step_by(step)
        .map(|candidate| candidate.position)
        .collect();
    let (brought, asked) = judge(world, &candidates, &pilots, bound(wanted, &some));
    rays += walked + asked;
    Attempt {
        candidates,
        brought,
        rays,
    }
}

fn bound(wanted: &InstantRadiosity, points: &[Vec3]) -> f32 {
    wanted.clamp.unwrap_or_else(|| default_clamp(points))
}

/// A bound on the geometry term without a scale of its own: with `r` the typical distance between neighbouring virtual
/// lights, a light stands for an area of about `4 r^2`, and the bound lets it act as if it filled [`MOST_SOLID_ANGLE`].
fn default_clamp(points: &[Vec3]) -> f32 {
    const ASKERS: usize = 512;
    let step = points.len().div_ceil(ASKERS).max(1);
    let mut nearest: Vec<f32> = (0..points.len())
        .into_par_iter()
        .step_by(step)
        .map(|i| {
            let others = points.iter().enumerate().filter(|(k, _)| *k != i);
            others
                .map(|(_, p)| p.distance_squared(points[i]))
                .fold(f32::INFINITY, f32::min)
        })
        .filter(|distance2| *distance2 > 0.0 && distance2.is_finite())
        .collect();
    nearest.sort_unstable_by(f32::total_cmp);
    match nearest.get(nearest.len() / 2) {
        Some(distance2) => MOST_SOLID_ANGLE / (4.0 * distance2),
        None => f32::INFINITY,
    }
}

/// All vertices of all light paths, in the order of the paths.
pub(super) fn candidates(
    world: &World,
    settings: &RenderSettings,
    wanted: &InstantRadiosity,
    paths: usize,
    stream: u32,
) -> (Vec<Candidate>, u64) {
    let emission = Emission::new(world.lights, world.geometry.scene, world.geometry.pose);
    let parts: Vec<(Vec<Candidate>, u64)> = (0..paths)
        .into_par_iter()
        .fold_chunks(
            256,
            Default::default,
            |(mut vertices, mut rays): (Vec<_>, u64), path| {
                let sampler = Sampler::new(
                    settings.sampler,
                    settings.seed ^ STREAM,
                    [u32::MAX, u32::MAX - stream],
                    path as u32,
                );
                rays += walk(
                    world,
                    &emission,
                    sampler,
                    wanted,
                    paths as f32,
                    &mut vertices,
                );
                (vertices, rays)
            },
        )
        .collect();
    let rays = parts.iter().map(|part| part.1).sum();
    (parts.into_iter().flat_map(|part| part.0).collect(), rays)
}

/// Goes one light path; returns the rays traced.
fn walk(
    world: &World,
    emission: &Emission,
    mut sampler: Sampler,
    wanted: &InstantRadiosity,
    paths: f32,
    vertices: &mut Vec<Candidate>,
) -> u64 {
    let geometry = world.geometry;
    let [x, y, pick, _] = sampler.next();
    let [u, v, ..] = sampler.next();
    let place = Vec2::new(x, y);
    let Some(start) = emission.sample(world.lights, geometry.scene, pick, place, Vec2::new(u, v))
    else {
        return 0;
    };
    let mut ray = start.ray;
    let mut flux = start.flux / paths;
    let mut absorption = Vec3::ZERO;
    // Density of the last step per steradian (or per area across, if parallel), and the probability of having continued.
    let mut density = start.density.spread;
    let mut parallel = start.density.parallel;
    let mut travelled = 0.0;
    let (mut events, mut panes, mut rays) = (0, 0, 0);
    while events + 1 < wanted.max_depth {
        rays += 1;
        let mut hits = [None];
        geometry.closest_batch(&[ray], &mut hits);
        let [Some(hit)] = hits else { break };
        let back = -ray.direction;
        let Some(surface) = Surface::new(geometry, hit, back) else {
            break;
        };
        if surface.material().unlit {
            break;
        }
        if absorption != Vec3::ZERO {
            flux *= (-absorption * hit.t).exp();
        }
        let local_from_world = surface.world_from_local.transpose();
        let wo = local_from_world * back;
        let parameters = surface.bsdf_parameters(geometry);
        let bsdf = Bsdf::new(&parameters, wo);
        let cosine = back.dot(surface.normal);
        if cosine <= 0.0 {
            break;
        }
        travelled += hit.t;
        let spread = if parallel { 1.0 } else { travelled * travelled };
        let area_density = density * cosine / spread;
        // Light that arrives is spread by the geometric cosine, materials count the shading cosine (Veach 1997, section 5.3).
        let bent = wo.z / cosine;
        let is_pane = is_pane(surface.material());
        if let Some(broad) = bsdf.split().broad {
            let colour = flux * broad.albedo() * (bent * FRAC_1_PI);
            let density = paths * area_density;
            let useful = colour.is_finite()
                && colour.max_element() > 0.0
                && density > 0.0
                && density.is_finite();
            if useful {
                vertices.push(Candidate {
                    position: surface.position,
                    normal: surface.normal,
                    target: offset_along_normal(surface.position, surface.normal, surface.extent),
                    colour,
                    density,
                    events: events + 1,
                });
            }
        }
        let [u, v, lobe, roulette] = sampler.next();
        let Some(sample) = bsdf.sample(wo, lobe, Vec2::new(u, v)) else {
            break;
        };
        let direction = (surface.world_from_local * sample.wi).normalize();
        let side = direction.dot(surface.normal);
        if side * sample.wi.z <= 0.0 {
            break;
        }
        let mut weight = sample.weight * sample.eta2;
        if sample.passed && is_pane {
            panes += 1;
            if panes > path::MOST_PANES {
                break;
            }
        } else {
            events += 1;
            // The adjoint of shading normals: geometric over shading cosine of the way on. A mirror has the same shading cosine on
            // both ways, by its own normal, which a coat may have apart from the base.
            weight *= if sample.delta && side > 0.0 {
                side / cosine
            } else {
                bent * side.abs() / sample.wi.z.abs()
            };
            if side < 0.0 {
                absorption = path::absorption_behind(&surface).unwrap_or(absorption);
            }
        }
        let survival = weight.max_element().min(1.0);
        if roulette >= survival || !weight.is_finite() {
            break;
        }
        flux *= weight / survival;
        if sample.delta {
            density *= sample.pdf * survival;
        } else {
            (density, parallel, travelled) = (sample.pdf * survival, false, 0.0);
        }
        let origin = offset_along_normal(
            surface.position,
            surface.normal * side.signum(),
            surface.extent,
        );
        ray = Ray::new(origin, direction);
    }
    rays
}

/// A few eye samples all over the picture.
pub(super) fn pilots(
    world: &World,
    view: &View,
    settings: &RenderSettings,
    prepared: &Prepared,
    count: usize,
) -> (Vec<(Eye, EyeSample)>, u64) {
    let mut harvest = Harvest::default();
    harvest.walks.extend((0..count).map(|i| {
        // The R2 sequence (Roberts 2018).
        let at = Vec2::new(
            (0.5 + 0.754_877_7 * i as f32).fract() * view.width() as f32,
            (0.5 + 0.569_840_3 * i as f32).fract() * view.height() as f32,
        );
        let sampler = Sampler::new(
            settings.sampler,
            settings.seed ^ STREAM,
            [u32::MAX, 0],
            i as u32,
        );
        Walk::new(&view.ray(at), sampler)
    }));
    harvest.gather(world, prepared);
    // Judged as if Lambert with the share of light that they pass on: good enough to tell useful lights from useless ones.
    let eyes = harvest.eyes.iter().map(|eye| Eye {
        scatter: Scatter::Lambert,
        ..*eye
    });
    let pilots = eyes.zip(harvest.ends.iter().copied()).collect();
    (pilots, harvest.secondary + count as u64)
}

/// What each candidate brings to the pilots, all channels together, and the rays that it took to know.
pub(super) fn judge(
    world: &World,
    candidates: &[Candidate],
    pilots: &[(Eye, EyeSample)],
    clamp: f32,
) -> (Vec<f64>, u64) {
    let judged: Vec<(f64, u64)> = candidates
        .par_iter()
        .with_min_len(16)
        .map(|light| {
            let (mut rays, mut values) = (Vec::new(), Vec::new());
            for (eye, end) in pilots {
                let value = patch_on_lambert(
                    eye,
                    light.position,
                    light.normal,
                    light.colour,
                    light.events,
                    clamp,
                )
                .element_sum();
                if value > 0.0 && value.is_finite() {
                    rays.push(Ray::between(end.origin, light.target));
                    values.push(value);
                }
            }
            let mut occluded = vec![false; rays.len()];
            world.geometry.occluded_batch(&rays, &mut occluded);
            let seen = values
                .iter()
                .zip(&occluded)
                .filter(|(_, occluded)| !**occluded);
            (
                seen.map(|(value, _)| f64::from(*value)).sum(),
                rays.len() as u64,
            )
        })
        .collect();
    let rays = judged.iter().map(|one| one.1).sum();
    (judged.into_iter().map(|one| one.0).collect(), rays)
}

/// The Morton curve through a cube in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Curve {
    low: Vec3,
    size: f32,
}

impl Curve {
    fn around(candidates: &[Candidate]) -> Self {
        let (low, high) = candidates.iter().fold(
            (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY)),
            |(low, high), light| (low.min(light.position), high.max(light.position)),
        );
        let size = (high - low).max_element().max(f32::MIN_POSITIVE);
        Self { low, size }
    }

    /// Places and numbers of candidates along the curve.
    pub(super) fn order(&self, candidates: &[Candidate]) -> Vec<(u64, u32)> {
        let code = |light: &Candidate| morton((light.position - self.low) / self.size);
        let mut order: Vec<(u64, u32)> = candidates
            .iter()
            .enumerate()
            .map(|(i, light)| (code(light), i as u32))
            .collect();
        order.sort_unstable();
        order
    }
}

/// Draws `count` of the candidates in `order` in proportion to what they bring; one that is drawn several times becomes one
/// brighter light. Candidates are ordered along the Morton curve, so that neighbours share a block and a single random
/// `offset` (systematic sampling) spreads the lights evenly. All techniques and places together draw `all` lights.
pub(super) fn choose(
    candidates: &[Candidate],
    brought: &[f64],
    order: &[(u64, u32)],
    count: u32,
    all: f64,
    offset: f32,
) -> Vec<Drawn> {
    let mut chosen = Vec::new();
    let flux = |i: usize| f64::from(candidates[i].colour.element_sum());
    // Summed by number: sums of a whole set do not depend on the place of the curve.
    let mut numbers: Vec<usize> = order.iter().map(|&(_, i)| i as usize).collect();
    numbers.sort_unstable();
    let all_brought: f64 = numbers.iter().map(|&i| brought[i]).sum();
    let all_flux: f64 = numbers.iter().map(|&i| flux(i)).sum();
    if all_flux <= 0.0 || !all_flux.is_finite() {
        return chosen;
    }
    let defensive = if all_brought > 0.0 { DEFENSIVE } else { 1.0 };
    let probability = |i: usize| {
        let judged = if all_brought > 0.0 {
            brought[i] / all_brought
        } else {
            0.0
        };
        (1.0 - defensive) * judged + defensive * flux(i) / all_flux
    };
    let n = f64::from(count);
    let mut before = 0.0;
    for &(code, i) in order {
        let i = i as usize;
        let p = probability(i);
        let picks = (before + p) * n + 1.0 - f64::from(offset);
        let drawn = picks.floor() - (before * n + 1.0 - f64::from(offset)).floor();
        before += p;
        if drawn < 1.0 {
            continue;
        }
        let weight = (drawn / (n * p)) as f32;
        let mut light = candidates[i];
        light.colour *= weight;
        light.density = (f64::from(light.density) * p * (n / all)) as f32;
        chosen.push(Drawn { light, code });
    }
    chosen
}

/// Adds a light to a list, of which `all` lights are drawn.
pub(super) fn push(lights: &mut LightList, light: &Candidate, all: u32) {
    let end = Endpoint::new(light.position, light.normal, light.density);
    lights.push_patch(
        SharedLight {
            end: LightEnd::Surface(end),
            target: Some(light.target),
            connections: all as f32,
        },
        light.position,
        light.normal,
        light.colour,
        light.events,
    );
}

/// Place on the Morton curve through the unit cube, 21 bits a side.
pub(super) fn morton(p: Vec3) -> u64 {
    let spread = |x: f32| {
        let mut x = (x.clamp(0.0, 1.0) * 2_097_151.0) as u64;
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
}
