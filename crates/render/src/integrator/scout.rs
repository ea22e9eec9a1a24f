//! Paths from the camera that ask for nothing: where records will be needed (Ulbrich 2013, section 3.1).

use super::{Integrator, RenderSettings, World};
use crate::bsdf::Bsdf;
use crate::camera::View;
use crate::geometry::{Surface, is_pane, site_of};
use crate::sampling::Sampler;
use glam::{Vec2, Vec3};
use occlude_visibility::records::{PathSite, Scout};
use occlude_visibility::{Hit, Ray, offset_along_normal};

/// Tells these numbers from those of pixels.
const STREAM: u64 = 0x7363_6f75_7473_2121;

/// Scattering events at most.
const MOST_EVENTS: u32 = 8;

/// Surfaces that a path may meet, panes included.
const MOST_SURFACES: u32 = 16;

/// Draws the vertices of paths from the camera.
pub(super) struct CameraPaths<'w, 'a> {
    world: &'w World<'a>,
    view: &'w View,
    settings: &'w RenderSettings,
    most_events: u32,
    drawn: u32,
}

struct Walk {
    ray: Ray,
    sampler: Sampler,
    throughput: f32,
    events: u32,
}

impl<'w, 'a> CameraPaths<'w, 'a> {
    pub(super) fn new(world: &'w World<'a>, view: &'w View, settings: &'w RenderSettings) -> Self {
        let most = match settings.integrator {
            Integrator::Path(limits) => limits.max_depth,
            Integrator::InstantRadiosity(wanted) => wanted.max_depth,
            Integrator::Bidirectional(_)
            | Integrator::AmbientOcclusion { .. }
            | Integrator::Field(_) => MOST_EVENTS,
        };
        Self {
            world,
            view,
            settings,
            most_events: most.clamp(1, MOST_EVENTS),
            drawn: 0,
        }
    }

    /// A vertex of a path; returns whether the path goes on.
    fn meet(&self, walk: &mut Walk, hit: Hit, sites: &mut Vec<PathSite>) -> bool {
        let geometry = self.world.geometry;
        let toward_eye = -walk.ray.direction;
        let Some(surface) = Surface::new(geometry, hit, toward_eye) else {
            return false;
        };
        if surface.material().unlit {
            return false;
        }
        let parameters = surface.bsdf_parameters(geometry);
        let wo = surface.world_from_local.transpose() * toward_eye;
        let bsdf = Bsdf::new(&parameters, wo);
        let pane = is_pane(surface.material());
        if !bsdf.is_delta() && !pane {
            walk.events += 1;
            sites.push(PathSite {
                site: site_of(&surface),
                weight: 1.0 / walk.events as f32,
            });
        }
        let [u, v, lobe, roulette] = walk.sampler.next();
        let Some(sample) = bsdf.sample(wo, lobe, Vec2::new(u, v)) else {
            return false;
        };
        walk.throughput *= sample.weight.max_element();
        let survival = walk.throughput.clamp(0.0, 1.0).sqrt();
        if walk.events >= self.most_events || roulette >= survival {
            return false;
        }
        walk.throughput /= survival;
        let direction = (surface.world_from_local * sample.wi).normalize();
        let side = direction.dot(surface.normal).signum();
        let normal = surface.normal * side;
        let origin = offset_along_normal(surface.position, normal, surface.extent);
        walk.ray = Ray::new(origin, direction);
        direction.is_finite()
    }
}

impl Scout for CameraPaths<'_, '_> {
    fn draw(&mut self, count: usize, sites: &mut Vec<PathSite>) {
        // Paths have about two or three vertices.
        let paths = (count / 2).max(1);
        let size = Vec2::new(self.view.width() as f32, self.view.height() as f32);
        let seed = self.settings.seed ^ STREAM;
        let mut walks: Vec<Walk> = (0..paths)
            .map(|k| {
                let number = self.drawn + k as u32;
                let mut sampler = Sampler::new(self.settings.sampler, seed, [u32::MAX; 2], number);
                let [u, v, ..] = sampler.next();
                Walk {
                    ray: self.view.ray(Vec2::new(u, v) * size).ray,
                    sampler,
                    throughput: 1.0,
                    events: 0,
                }
            })
            .collect();
        self.drawn = self.drawn.wrapping_add(paths as u32);
        let mut rays = Vec::new();
        let mut hits = Vec::new();
        for _ in 0..MOST_SURFACES {
            rays.clear();
            rays.extend(walks.iter().map(|walk| walk.ray));
            hits.clear();
            hits.resize(rays.len(), None);
            self.world.geometry.closest_batch(&rays, &mut hits);
            let mut hit = hits.iter();
            walks.retain_mut(|walk| match hit.next() {
                Some(&Some(hit)) => self.meet(walk, hit, sites),
                _ => false,
            });
            if walks.is_empty() {
                break;
            }
        }
        let finite =
            |place: &PathSite| place.site.position.is_finite() && place.site.normal != Vec3::ZERO;
        sites.retain(finite);
    }
}
