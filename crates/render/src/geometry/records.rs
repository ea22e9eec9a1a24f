//! What records see: the scene as [`DistanceTracer`].
//!
//! Panes block nothing and are left out, as for every visibility question.

use super::{Geometry, Surface, is_pane};
use crate::bsdf::Bsdf;
use glam::Vec3;
use occlude_visibility::records::{DistanceTracer, Seen, Site};
use occlude_visibility::{Hit, Ray, offset_along_normal};

/// Rays that are traced together.
const BATCH: usize = 256;

/// Share of scattering by lobes narrower than texels, from which on a surface is not kept as an albedo.
const MOSTLY_SHARP: f32 = 0.5;

/// Neighbours that may look alike.
const ALIKE: usize = 8;

/// How much farther one of two neighbours on the same mesh may be seen than the other, so that they look alike.
const SLANT: f32 = 1.05;

/// Whether two rays that run alike meet what looks alike.
fn are_alike(a: Option<Hit>, b: Option<Hit>) -> bool {
    let (Some(a), Some(b)) = (a, b) else {
        return false;
    };
    a.instance == b.instance
        && (a.primitive == b.primitive || a.t < b.t * SLANT && b.t < a.t * SLANT)
}

impl Geometry<'_> {
    fn seen(&self, ray: &Ray, hit: Option<Hit>) -> Seen {
        let Some(hit) = hit else {
            return Seen::NOTHING;
        };
        let toward_eye = -ray.direction;
        let Some(surface) = Surface::new(self, hit, toward_eye) else {
            return Seen {
                distance: hit.t,
                normal: toward_eye,
                albedo: Vec3::ZERO,
                trace: false,
            };
        };
        let parameters = surface.bsdf_parameters(self);
        let wo = surface.world_from_local.transpose() * toward_eye;
        let bsdf = Bsdf::new(&parameters, wo);
        let material = surface.material();
        let sharp = || bsdf.is_delta() || bsdf.split().sharp_share > MOSTLY_SHARP;
        Seen {
            distance: hit.t,
            normal: surface.normal,
            albedo: bsdf.albedo(),
            trace: material.unlit || is_pane(material) || parameters.reaches_below() || sharp(),
        }
    }
}

impl DistanceTracer for Geometry<'_> {
    fn distances(&self, rays: &[Ray], distances: &mut [f32]) {
        let mut hits = [None; BATCH];
        for (rays, distances) in rays.chunks(BATCH).zip(distances.chunks_mut(BATCH)) {
            let hits = &mut hits[..rays.len()];
            self.closest_blockers(rays, hits);
            for (distance, hit) in distances.iter_mut().zip(hits) {
                *distance = hit.map_or(f32::INFINITY, |hit| hit.t);
            }
        }
    }

    fn surfaces(&self, rays: &[Ray], seen: &mut [Seen]) {
        let mut hits = [None; BATCH];
        for (rays, seen) in rays.chunks(BATCH).zip(seen.chunks_mut(BATCH)) {
            let hits = &mut hits[..rays.len()];
            self.closest_blockers(rays, hits);
            for k in 0..rays.len() {
                self.prefetch(hits, k);
                // Of a group of neighbours, those that meet the same thing at about the same place look alike: reading normals and
                // textures takes several times as long as tracing.
                let group = k - k % ALIKE;
                let like = (group..k)
                    .rev()
                    .find(|&other| are_alike(hits[k], hits[other]));
                seen[k] = match (like, hits[k]) {
                    (Some(other), Some(hit)) => Seen {
                        distance: hit.t,
                        ..seen[other]
                    },
                    _ => self.seen(&rays[k], hits[k]),
                };
            }
        }
    }

    fn sites(&self, rays: &[Ray], sites: &mut [Option<Site>]) {
        let mut hits = vec![None; rays.len()];
        self.closest_blockers(rays, &mut hits);
        for ((ray, hit), site) in rays.iter().zip(hits).zip(sites) {
            let surface = hit.and_then(|hit| Surface::new(self, hit, -ray.direction));
            *site = surface.map(|surface| site_of(&surface));
        }
    }
}

/// The place of a surface.
pub(crate) fn site_of(surface: &Surface) -> Site {
    Site {
        position: surface.position,
        normal: surface.normal,
        origin: offset_along_normal(surface.position, surface.normal, surface.extent),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_bvh::BuildOptions;
    use occlude_scene::{Pose, procedural};
    use occlude_visibility::Tracer;

    #[test]
    fn distances_are_those_of_blockers() {
        let scene = procedural::build(procedural::Name::Apartment, None, 0);
        let pose = Pose::at(&scene, 0.0);
        let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
        // As the texels of a map: neighbours run alike.
        let rays: Vec<Ray> = (0..2048_u32)
            .map(|i| {
                let (block, k) = (i / 8, i % 8);
                let (x, y) = (4 * (block % 16) + k % 4, 2 * (block / 16) + k / 4);
                let direction = Vec3::new(x as f32 - 31.5, y as f32 - 15.5, -30.0);
                Ray::new(Vec3::new(0.5, 1.4, 0.5), direction.normalize())
            })
            .collect();
        let mut distances = vec![0.0; rays.len()];
        geometry.distances(&rays, &mut distances);
        let mut seen = vec![Seen::NOTHING; rays.len()];
        geometry.surfaces(&rays, &mut seen);
        for ((ray, distance), seen) in rays.iter().zip(distances).zip(seen) {
            assert_eq!(seen.distance, distance);
            let before = Ray {
                t_max: distance * 0.9999,
                ..*ray
            };
            assert!(!geometry.occluded(&before));
            if distance.is_finite() {
                let beyond = Ray {
                    t_max: distance * 1.0001,
                    ..*ray
                };
                assert!(geometry.occluded(&beyond));
                assert!(seen.normal.dot(ray.direction) <= 0.1);
            }
        }
    }
}
