//! Ambient occlusion: how open the hemisphere above each visible point is.
//!
//! The value is the share of the cosine-weighted hemisphere that nothing blocks within a distance, grey, one direction a
//! sample; where the camera sees nothing it is 1. Alpha is honoured, panes are looked through. A quick look at geometry
//! and at visibility strategies; not a measure of light.

use super::{RenderSettings, Unit, Worker, World};
use crate::camera::View;
use crate::film::{Features, FilmTile};
use crate::geometry::{Geometry, Surface};
use glam::Vec3;
use occlude_visibility::{Endpoint, LightEnd, Query, Ray, Visibility, offset_along_normal};

pub(super) fn render_unit<'a, V: Visibility<Geometry<'a>>>(
    world: &World<'a>,
    view: &View,
    visibility: &V,
    settings: &RenderSettings,
    distance: f32,
    unit: &Unit,
    worker: &mut Worker<V::Worker>,
    tile: &mut FilmTile,
) {
    let geometry = world.geometry;
    let mut starts: Vec<_> = unit.starts(settings).collect();
    let camera_rays: Vec<_> = starts.iter().map(|start| view.ray(start.point)).collect();
    let rays: Vec<Ray> = camera_rays.iter().map(|camera| camera.ray).collect();
    let mut hits = vec![None; rays.len()];
    geometry.closest_batch(&rays, &mut hits);
    worker.rays.primary += rays.len() as u64;

    let mut queries = Vec::with_capacity(rays.len());
    let mut asking = Vec::with_capacity(rays.len());
    let mut open = vec![1.0; rays.len()];
    let mut features = vec![Features::default(); rays.len()];
    for (i, (hit, start)) in hits.iter().zip(&mut starts).enumerate() {
        let Some(hit) = *hit else { continue };
        let Some(surface) = Surface::new(geometry, hit, -rays[i].direction) else {
            continue;
        };
        features[i] = Features {
            albedo: Vec3::ONE,
            normal: surface.shading_normal(),
            depth: hit.t,
        };
        let [u, v, ..] = start.sampler.next();
        let local = crate::sampling::warp::cosine_hemisphere(glam::Vec2::new(u, v));
        let direction = surface.world_from_local * local;
        if direction.dot(surface.normal) <= 0.0 {
            open[i] = 0.0;
            continue;
        }
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let density = camera_rays[i].density_at(hit.t, surface.normal);
        let eye = Endpoint::new(surface.position, surface.normal, density);
        let end = LightEnd::SolidAngle {
            direction,
            density: local.z * std::f32::consts::FRAC_1_PI,
        };
        queries.push(Query::new(
            eye,
            end,
            Ray {
                t_max: distance,
                ..Ray::new(origin, direction)
            },
        ));
        asking.push(i);
    }
    let mut answers = vec![0.0; queries.len()];
    visibility.begin(&mut worker.visibility, unit.epoch());
    visibility.answer(geometry, &mut worker.visibility, &queries, &mut answers);
    for (&i, &answer) in asking.iter().zip(&answers) {
        open[i] = answer;
    }
    for (i, start) in starts.iter().enumerate() {
        tile.add(start.x, start.y, Vec3::splat(open[i]), Some(&features[i]));
    }
}
