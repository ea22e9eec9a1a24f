//! What the bounded geometry term leaves out, gathered by short paths.
//!
//! Kollig & Keller, "Illumination in the Presence of Weak Singularities" (2004): the clamped term `min(G, b)` and the rest
//! `G - min(G, b) = G max(0, 1 - b / G)` together are the whole. The rest is not zero only near the eye sample: a ray of the
//! length `sqrt(cos / b)` at most, drawn by the surface's scattering, finds the surface there, and a path goes on from it. The
//! bound is the same at every place, so that the split is a function of the two points alone.

use super::eye::Harvest;
use crate::bsdf::Bsdf;
use crate::camera::View;
use crate::geometry::{Geometry, Surface, is_pane};
use crate::integrator::{PathLimits, World, path};
use crate::sampling::Sampler;
use glam::{Mat3, Vec2, Vec3};
use occlude_visibility::{Endpoint, Query, Ray, Visibility, offset_along_normal};

/// The first dimension set that is used here: behind those of eye paths.
const FIRST_SET: u32 = 1 << 16;

/// An eye sample that may look around.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub(super) bsdf: Bsdf,
    pub(super) world_from_local: Mat3,
    pub(super) wo: Vec3,
    pub(super) throughput: Vec3,
    pub(super) sampler: Sampler,
    /// Scattering events, this one included.
    pub(super) events: u32,
    /// Number of the eye sample.
    pub(super) eye: u32,
}

/// Adds what the bound `clamp` took away to `radiance`, by camera sample; returns the rays traced.
pub(super) fn compensate<'a, V: Visibility<Geometry<'a>>>(
    world: &World<'a>,
    view: &View,
    visibility: &V,
    max_depth: u32,
    clamp: f32,
    harvest: &Harvest,
    worker: &mut V::Worker,
    scratch: &mut path::Scratch,
    radiance: &mut [Vec3],
) -> u64 {
    let geometry = world.geometry;
    let mut rays = 0;
    let (mut queries, mut pending) = (Vec::new(), Vec::new());
    scratch.start(view);
    for start in &harvest.starts {
        let eye = &harvest.eyes[start.eye as usize];
        let mut sampler = start.sampler;
        sampler.jump(FIRST_SET + start.events * 3);
        let [u, v, lobe, pick] = sampler.next();
        let Some(sample) = start.bsdf.sample(start.wo, lobe, Vec2::new(u, v)) else {
            continue;
        };
        let direction = (start.world_from_local * sample.wi).normalize();
        if sample.wi.z <= 0.0 || direction.dot(eye.normal) <= 0.0 {
            continue;
        }
        let mut ray = Ray {
            t_max: (sample.wi.z / clamp).sqrt(),
            ..Ray::new(harvest.ends[start.eye as usize].origin, direction)
        };
        let mut throughput = start.throughput * sample.weight;
        // The first surface that is no pane.
        let surface = loop {
            rays += 1;
            let mut hits = [None];
            geometry.closest_batch(&[ray], &mut hits);
            let [Some(hit)] = hits else { break None };
            let Some(surface) = Surface::new(geometry, hit, -direction) else {
                break None;
            };
            if !is_pane(surface.material()) {
                break Some(surface);
            }
            let wo = surface.world_from_local.transpose() * -direction;
            let pane = Bsdf::new(&surface.bsdf_parameters(geometry), wo);
            throughput *= pane.straight_transmittance(wo);
            if throughput.max_element() <= 0.0 {
                break None;
            }
            ray.t_min = hit.t;
        };
        let Some(surface) = surface.filter(|s| !s.material().unlit) else {
            continue;
        };
        let distance2 = surface.position.distance_squared(eye.position);
        let term = sample.wi.z * -direction.dot(surface.normal) / distance2;
        if term <= clamp || !term.is_finite() {
            continue;
        }
        throughput *= 1.0 - clamp / term;
        let local_from_world = surface.world_from_local.transpose();
        let wo = local_from_world * -direction;
        let parameters = surface.bsdf_parameters(geometry);
        // Virtual lights stand for the broad lobes alone.
        let Some(bsdf) = Bsdf::new(&parameters, wo).split().broad else {
            continue;
        };
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let light_normal = surface.shading_normal();
        let [u, v, lobe, _] = sampler.next();
        let light = world.lights.sample(
            geometry.scene,
            surface.position,
            light_normal,
            pick,
            Vec2::new(u, v),
        );
        if let Some(light) = light {
            let wi = local_from_world * light.wi;
            if wi.z > 0.0 && light.wi.dot(surface.normal) > 0.0 {
                let (value, pdf) = bsdf.eval(wo, wi);
                let weight = if light.delta {
                    1.0
                } else {
                    path::power_heuristic(light.pdf, pdf)
                };
                let brought = throughput * value * light.radiance * (weight / light.pdf);
                if brought != Vec3::ZERO && brought.is_finite() {
                    let ray = match light.target {
                        Some(target) => Ray::between(origin, target),
                        None => Ray::new(origin, light.wi),
                    };
                    let density = sample.pdf * -direction.dot(surface.normal) / distance2;
                    let end = Endpoint::new(surface.position, surface.normal, density);
                    let connections = if light.delta { light.pdf } else { 1.0 };
                    queries.push(Query {
                        connections,
                        importance: brought.element_sum(),
                        ..Query::new(end, light.end, ray)
                    });
                    pending.push((eye.sample, brought));
                }
            }
        }
        let [u, v, ..] = sampler.next();
        let Some(next) = bsdf.sample(wo, lobe, Vec2::new(u, v)) else {
            continue;
        };
        let direction = (surface.world_from_local * next.wi).normalize();
        let throughput = throughput * next.weight;
        let useful = throughput.is_finite() && throughput.max_element() > 0.0;
        if useful && next.wi.z > 0.0 && direction.dot(surface.normal) > 0.0 {
            let last = path::Scattering {
                position: surface.position,
                light_normal,
                pdf: next.pdf,
            };
            let ray = Ray::new(origin, direction);
            scratch.push(
                ray,
                throughput,
                start.sampler,
                start.events + 1,
                last,
                eye.sample,
            );
        }
    }
    let mut answers = vec![0.0; queries.len()];
    visibility.answer(geometry, worker, &queries, &mut answers);
    for ((&(sample, brought), &answer), query) in pending.iter().zip(&answers).zip(&queries) {
        if answer != 0.0 {
            let tint = if geometry.has_panes() {
                geometry.pane_transmittance(&query.ray)
            } else {
                Vec3::ONE
            };
            radiance[sample as usize] += brought * tint * answer;
        }
    }
    rays += scratch.finish(world, PathLimits::new(max_depth), visibility, worker);
    for (sample, brought) in scratch.brought() {
        radiance[sample as usize] += brought;
    }
    rays
}
