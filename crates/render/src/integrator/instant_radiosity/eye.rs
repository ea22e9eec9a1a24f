//! Eye paths in the manner of Whitted (1980): mirrors and glass are followed, everything else is kept to be shaded later.
//!
//! A camera sample becomes a walk. Where it meets a surface, the broad part of the scattering (see [`Bsdf::split`]) becomes an
//! eye sample; the sharp part is followed by one direction of its own, if there is no broad part always, else with a
//! probability of the root of its share: one walk stays one walk, so the number of eye samples (what shading and caches pay
//! for) hardly grows with depth, and no branch is left out on average. A full tree of reflections and refractions would double at
//! every pane of glass. Where Fresnel splits, reflection or refraction is picked in proportion.
//!
//! A sharp but rough lobe asks one light sample at its surface, weighed against the direction that is followed, as a
//! path tracer does.

use super::Prepared;
use super::gather::Start;
use super::shade::{Closed, Eye, Layered, Scatter, Scatterers};
use crate::bsdf::Bsdf;
use crate::camera::CameraRay;
use crate::film::Features;
use crate::geometry::{Geometry, Surface, is_pane};
use crate::integrator::{World, path};
use crate::light::{LightSample, Lights};
use crate::sampling::Sampler;
use glam::{Vec2, Vec3};
use occlude_visibility::{Endpoint, EyeSample, Hit, Query, Ray, offset_along_normal};
use std::f32::consts::FRAC_1_PI;

/// Dimension sets that one segment of a walk uses.
const SETS_PER_SEGMENT: u32 = 3;

/// A camera sample on its way.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    ray: Ray,
    throughput: Vec3,
    pub(super) radiance: Vec3,
    sampler: Sampler,
    /// Scattering events so far.
    depth: u32,
    /// Panes passed so far.
    panes: u32,
    /// The last scattering event, if its direction could have been found by light sampling.
    last: Option<path::Scattering>,
    /// Eye samples (one a pixel) per steradian around the ray, or per square metre across it, if `parallel`.
    density: f32,
    parallel: bool,
    /// Length of the way from the camera to the ray's origin.
    travelled: f32,
    /// See [`path`]: what refraction took from the throughput only to give it back.
    squeezed: f32,
    absorption: Vec3,
    pub(super) features: Features,
}

impl Walk {
    /// A walk that starts with a camera ray.
    pub(super) fn new(camera: &CameraRay, sampler: Sampler) -> Self {
        Self {
            ray: camera.ray,
            throughput: Vec3::ONE,
            radiance: Vec3::ZERO,
            sampler,
            depth: 0,
            panes: 0,
            last: None,
            density: camera.pixel_density,
            parallel: camera.parallel,
            travelled: 0.0,
            squeezed: 1.0,
            absorption: Vec3::ZERO,
            features: Features::default(),
        }
    }
}

/// What walks leave behind for shading, and scratch space.
#[derive(Debug, Default)]
pub(super) struct Harvest {
    pub(super) walks: Vec<Walk>,
    pub(super) eyes: Vec<Eye>,
    /// The visibility strategies' view of `eyes`.
    pub(super) ends: Vec<EyeSample>,
    pub(super) scatterers: Scatterers,
    /// Questions about single light samples, who asks, and what a free view brings.
    pub(super) queries: Vec<Query>,
    pub(super) pending: Vec<(u32, Vec3)>,
    /// Where [`gather`](super::gather) starts.
    pub(super) starts: Vec<Start>,
    /// Questions about single light samples may be answered from memory.
    pub(super) shares_singles: bool,
    /// Rays beyond the first of each walk.
    pub(super) secondary: u64,
    alive: Vec<u32>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
}

impl Harvest {
    fn clear(&mut self) {
        self.eyes.clear();
        self.ends.clear();
        self.scatterers.closed.clear();
        self.scatterers.layered.clear();
        self.queries.clear();
        self.pending.clear();
        self.starts.clear();
        self.secondary = 0;
    }

    /// Goes all walks to their ends.
    pub(super) fn gather(&mut self, world: &World, prepared: &Prepared) {
        self.clear();
        self.alive.clear();
        self.alive.extend(0..self.walks.len() as u32);
        let mut first = true;
        while !self.alive.is_empty() {
            if !first {
                self.secondary += self.alive.len() as u64;
            }
            self.rays.clear();
            self.rays
                .extend(self.alive.iter().map(|&i| self.walks[i as usize].ray));
            self.hits.clear();
            self.hits.resize(self.rays.len(), None);
            world.geometry.closest_batch(&self.rays, &mut self.hits);
            let mut kept = 0;
            for k in 0..self.alive.len() {
                let index = self.alive[k];
                world.geometry.prefetch(&self.hits, k);
                let goes_on = match self.hits[k] {
                    Some(hit) => self.meet(world, prepared, index, hit, first),
                    None => {
                        self.escape(world, index, first);
                        false
                    }
                };
                if goes_on {
                    self.alive[kept] = index;
                    kept += 1;
                }
            }
            self.alive.truncate(kept);
            first = false;
        }
    }

    fn escape(&mut self, world: &World, index: u32, first: bool) {
        let walk = &mut self.walks[index as usize];
        let direction = walk.ray.direction;
        let radiance = world.lights.environment(direction);
        if first {
            walk.features.albedo = radiance.clamp(Vec3::ZERO, Vec3::ONE);
        }
        if radiance != Vec3::ZERO {
            let weight = walk.last.map_or(1.0, |last| {
                let pdf = world
                    .lights
                    .pdf_environment(last.position, last.light_normal, direction);
                path::power_heuristic(last.pdf, pdf)
            });
            walk.radiance += walk.throughput * radiance * weight;
        }
    }

    /// A walk meets a surface; returns whether it goes on.
    fn meet(
        &mut self,
        world: &World,
        prepared: &Prepared,
        index: u32,
        hit: Hit,
        first: bool,
    ) -> bool {
        let geometry = world.geometry;
        let walk = &mut self.walks[index as usize];
        let toward_eye = -walk.ray.direction;
        let Some(surface) = Surface::new(geometry, hit, toward_eye) else {
            return false;
        };
        if walk.absorption != Vec3::ZERO {
            walk.throughput *= (-walk.absorption * hit.t).exp();
        }
        let emission = surface.emission(geometry);
        if emission != Vec3::ZERO {
            let weight = path::weight_of_hit(world.lights, walk.last, hit, surface.position);
            walk.radiance += walk.throughput * emission * weight;
        }
        if surface.material().unlit {
            if first {
                walk.features = Features {
                    albedo: emission.min(Vec3::ONE),
                    normal: surface.shading_normal(),
                    depth: hit.t,
                };
            }
            return false;
        }
        let is_pane = is_pane(surface.material());
        let parameters = surface.bsdf_parameters(geometry);
        let local_from_world = surface.world_from_local.transpose();
        let wo = local_from_world * toward_eye;
        let bsdf = Bsdf::new(&parameters, wo);
        if first {
            walk.features = Features {
                albedo: bsdf.albedo(),
                normal: surface.shading_normal(),
                depth: hit.t,
            };
        }
        let max_depth = prepared.settings.max_depth;
        if walk.depth >= max_depth && !is_pane {
            return false;
        }
        walk.sampler
            .jump(1 + (walk.depth + walk.panes) * SETS_PER_SEGMENT);
        let [u, v, pick, choice] = walk.sampler.next();
        let distance = walk.travelled + hit.t;
        let spread = if walk.parallel {
            1.0
        } else {
            distance * distance
        };
        let density = walk.density * toward_eye.dot(surface.normal).abs() / spread;
        let split = bsdf.split();

        if let Some(broad) = split.broad
            && walk.depth < max_depth
        {
            let normal = surface.shading_normal();
            let weight = walk.throughput;
            let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
            let end = Endpoint::new(surface.position, surface.normal, density);
            let sample = |lights: &Lights, pick: f32, u: f32, v: f32| {
                lights.sample(
                    geometry.scene,
                    surface.position,
                    normal,
                    pick,
                    Vec2::new(u, v),
                )
            };
            let mut samples = [None, None];
            if !prepared.areas.is_empty() {
                samples[0] = sample(&prepared.areas, pick, u, v);
            }
            if let Some(deltas) = &prepared.picked {
                let [u, v, pick, _] = walk.sampler.next();
                samples[1] = sample(deltas, pick, u, v);
            }
            for light in samples.into_iter().flatten() {
                let wi = local_from_world * light.wi;
                if light.wi.dot(surface.normal) > 0.0 && wi.z > 0.0 {
                    let value = broad.eval(wo, wi).0 * light.radiance / light.pdf;
                    let connections = if light.delta { light.pdf } else { 1.0 };
                    self.ask(index, weight * value, end, origin, &light, connections);
                }
            }
            let (scatter, weight) = self.scatter(&broad, wo, local_from_world, toward_eye, weight);
            let walk = &self.walks[index as usize];
            if prepared.compensates() && walk.depth + 1 < max_depth {
                self.starts.push(Start {
                    bsdf: broad,
                    world_from_local: surface.world_from_local,
                    wo,
                    throughput: walk.throughput,
                    sampler: walk.sampler,
                    events: walk.depth + 1,
                    eye: self.eyes.len() as u32,
                });
            }
            self.eyes.push(Eye {
                position: surface.position,
                normal: surface.normal,
                shading_normal: normal,
                weight,
                events_left: (max_depth - walk.depth - 1) as f32,
                scatter,
                sample: index,
            });
            self.ends.push(EyeSample { end, origin });
        }

        let Some(sharp) = split.sharp else {
            return false;
        };
        let follow = if split.broad.is_some() {
            split.sharp_share.sqrt()
        } else {
            1.0
        };
        if choice >= follow {
            return false;
        }
        let walk = &mut self.walks[index as usize];
        walk.throughput /= follow;
        walk.density *= follow;
        walk.sampler
            .jump(3 + (walk.depth + walk.panes) * SETS_PER_SEGMENT);
        let [u2, v2, lobe, roulette] = walk.sampler.next();

        let light_normal = if parameters.transmission > 0.0 {
            Vec3::ZERO
        } else {
            surface.shading_normal()
        };
        if !sharp.is_delta() && walk.depth < max_depth {
            let light = world.lights.sample(
                geometry.scene,
                surface.position,
                light_normal,
                pick,
                Vec2::new(u, v),
            );
            if let Some(light) = light {
                let wi = local_from_world * light.wi;
                let side = light.wi.dot(surface.normal);
                if side * wi.z > 0.0 {
                    let (value, pdf) = sharp.eval(wo, wi);
                    let weight = if light.delta {
                        1.0
                    } else {
                        path::power_heuristic(light.pdf, pdf)
                    };
                    let brought = walk.throughput * value * light.radiance * (weight / light.pdf);
                    let normal = surface.normal * side.signum();
                    let origin = offset_along_normal(surface.position, normal, surface.extent);
                    let end = Endpoint::new(surface.position, normal, density * follow);
                    let connections = if light.delta { light.pdf } else { 1.0 };
                    self.ask(index, brought, end, origin, &light, connections);
                }
            }
        }
        let walk = &mut self.walks[index as usize];
        let Some(sample) = sharp.sample(wo, lobe, Vec2::new(u2, v2)) else {
            return false;
        };
        let direction = (surface.world_from_local * sample.wi).normalize();
        let side = direction.dot(surface.normal);
        if side * sample.wi.z <= 0.0 {
            return false;
        }
        walk.travelled = distance;
        let passed = sample.passed && is_pane;
        if sample.delta {
            // Mirrors keep the spread of the rays; what a choice drops is missing behind it.
            walk.density *= sample.pdf;
        }
        if passed {
            walk.panes += 1;
            if walk.panes > path::MOST_PANES {
                return false;
            }
        } else {
            walk.depth += 1;
            if walk.depth > max_depth {
                return false;
            }
            walk.last = (!sample.delta).then_some(path::Scattering {
                position: surface.position,
                light_normal,
                pdf: sample.pdf,
            });
            if side < 0.0 {
                walk.absorption = path::absorption_behind(&surface).unwrap_or(walk.absorption);
            }
        }
        walk.throughput *= sample.weight;
        walk.squeezed *= sample.eta2;
        if !passed && walk.depth >= path::ROULETTE_AFTER {
            let survival = (walk.throughput.max_element() * walk.squeezed).min(1.0);
            if roulette >= survival {
                return false;
            }
            walk.throughput /= survival;
            walk.density *= survival;
        }
        if walk.throughput.max_element() <= 0.0 || !walk.throughput.is_finite() {
            return false;
        }
        let origin = offset_along_normal(
            surface.position,
            surface.normal * side.signum(),
            surface.extent,
        );
        walk.ray = Ray::new(origin, direction);
        true
    }

    /// Asks about one light sample.
    fn ask(
        &mut self,
        walk: u32,
        brought: Vec3,
        end: Endpoint,
        origin: Vec3,
        light: &LightSample,
        connections: f32,
    ) {
        if brought == Vec3::ZERO || !brought.is_finite() {
            return;
        }
        let ray = match light.target {
            Some(target) => Ray::between(origin, target),
            None => Ray::new(origin, light.wi),
        };
        // One sample stands for a whole lamp. Shared by a patch of eyes, its answer would turn penumbras into blotches; and next
        // to the questions about shared lights, rays for these are few. So each is a question of its own, unless patches shrink from pass
        // to pass.
        let density = if self.shares_singles {
            end.density
        } else {
            f32::INFINITY
        };
        let end = Endpoint { density, ..end };
        self.queries.push(Query {
            connections,
            importance: brought.element_sum(),
            ..Query::new(end, light.end, ray)
        });
        self.pending.push((walk, brought));
    }

    /// The form in which an eye sample's scattering is kept, and its weight.
    fn scatter(
        &mut self,
        bsdf: &Bsdf,
        wo: Vec3,
        local_from_world: glam::Mat3,
        toward_eye: Vec3,
        weight: Vec3,
    ) -> (Scatter, Vec3) {
        if let Some(colour) = bsdf.lambert() {
            return (Scatter::Lambert, weight * colour * FRAC_1_PI);
        }
        let scatter = match bsdf.broad() {
            Some(broad) => {
                self.scatterers.closed.push(Closed {
                    broad,
                    wo: toward_eye,
                    cos_o: wo.z,
                });
                Scatter::Closed(self.scatterers.closed.len() as u32 - 1)
            }
            None => {
                self.scatterers.layered.push(Layered {
                    bsdf: *bsdf,
                    local_from_world,
                    wo,
                });
                Scatter::Layered(self.scatterers.layered.len() as u32 - 1)
            }
        };
        (scatter, weight)
    }

    /// Adds what the answers let through to the walks.
    pub(super) fn settle(&mut self, geometry: &Geometry, answers: &[f32]) {
        for ((&(walk, brought), &answer), query) in
            self.pending.iter().zip(answers).zip(&self.queries)
        {
            if answer != 0.0 {
                let tint = if geometry.has_panes() {
                    geometry.pane_transmittance(&query.ray)
                } else {
                    Vec3::ONE
                };
                self.walks[walk as usize].radiance += brought * tint * answer;
            }
        }
    }
}
