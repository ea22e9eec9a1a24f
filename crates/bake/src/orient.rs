//! Which side of two-sided surfaces a light map holds.
//!
//! A light map has one value for a point of a surface, whichever side one looks at. One-sided materials are seen from their front, the side
//! from which vertices run counter-clockwise. Two-sided ones (`doubleSided`) often come from programs in which winding means
//! nothing: half of the walls of a flat then turn their front to the masonry, and a tap its to the water. So every chart
//! of a two-sided material is turned over if its front is not what people see:
//!
//! 1. the scene's cameras see its back at least four times as often as its front; of what they do not see, if
//! 2. less than a thousandth of the light at the back arrives at the front, or
//! 3. less than a tenth of it does, and what the front looks at is less than a quarter as far away as what the back does.
//!
//! No paper. Rays that leave the scene say nothing about distance: the void behind an outer wall is no room.
//!
//! Invariants: whole charts are turned, so no texel mixes sides; nothing but `Layout::turned` changes, so files keep their
//! winding; the result depends on scene, lights and seed alone.
//!
//! Class: a guess. The wrong tool for single sheets that are seen from both sides in different light (a curtain, a wall between two rooms
//! without thickness): one side's light shows on both, and only geometry with two sides helps. Where cameras were left at odd places, one
//! should say which side is meant.

use crate::atlas::{Atlas, Layout};
use crate::gather::{Gatherer, PathSettings, SurfaceSample, surface_at};
use glam::Vec2;
use occlude_render::camera::View;
use occlude_render::geometry::WorldTriangle;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::sampling::warp;
use occlude_visibility::{Hit, Ray, offset_along_normal};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Lines of sight of the cameras that must meet a chart, and how many times more of them its back than its front.
const SEEN: u32 = 4;

/// Lines of sight of a camera, across and down, and cameras at most.
const SIGHT: [u32; 2] = [320, 240];
const CAMERAS: usize = 16;

/// Light on the front, as a share of that on the back, that counts as none: what leaks through cracks.
const NONE: f32 = 1e-3;

/// Share that counts as little.
const LITTLE: f32 = 0.1;

/// Share of the distance to what the back sees that counts as near.
const NEAR: f32 = 0.25;

/// Points of a chart at the first look, and where that shows a darker front.
const FIRST_LOOK: u32 = 8;
const SECOND_LOOK: u32 = 64;

/// Turns charts of two-sided materials over where their back is what people see. Returns how many. `settings`: how light is to be gathered. O(charts).
pub fn turn_over(atlas: &mut Atlas, world: &World, settings: &PathSettings, job: &Job) -> u64 {
    let geometry = world.geometry;
    // The first place of every layout stands for all.
    let mut users: BTreeMap<u32, u32> = BTreeMap::new();
    for (instance, placement) in atlas.placements.iter().enumerate() {
        if let Some(placement) = placement {
            users.entry(placement.layout).or_insert(instance as u32);
        }
    }
    let seen = seen(atlas, world);
    let mut turned = 0;
    for (number, instance) in users {
        let layout = &mut atlas.layouts[number as usize];
        let mesh = &geometry.scene.meshes[layout.mesh as usize];
        if !geometry.scene.materials[mesh.material as usize].double_sided {
            continue;
        }
        let charts = charts(layout);
        let side = |chart: usize| number << 20 ^ chart as u32;
        let flags: Vec<bool> = charts
            .par_iter()
            .enumerate()
            .map_init(Gatherer::default, |gatherer, (chart, triangles)| {
                if let Some(&[front, back]) = seen.get(&(number, chart as u32))
                    && front + back >= SEEN
                {
                    return back >= SEEN * front.max(1);
                }
                !job.is_cancelled()
                    && is_turned(
                        world,
                        settings,
                        gatherer,
                        (instance, side(chart)),
                        triangles,
                    )
            })
            .collect();
        turned += flags.iter().filter(|&&turned| turned).count() as u64;
        if flags.contains(&true) {
            layout.turned = flags;
        }
    }
    turned
}

/// By layout and chart: lines of sight of the cameras that meet its front, and its back.
fn seen(atlas: &Atlas, world: &World) -> BTreeMap<(u32, u32), [u32; 2]> {
    let (scene, pose) = (world.geometry.scene, world.geometry.pose);
    let mut seen: BTreeMap<(u32, u32), [u32; 2]> = BTreeMap::new();
    let [width, height] = SIGHT;
    for camera in 0..scene.cameras.len().min(CAMERAS) {
        let view = View::of_camera(scene, pose, camera, width, height);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let rays: Vec<Ray> = pixels
            .map(|(x, y)| view.ray(Vec2::new(x as f32, y as f32) + 0.5).ray)
            .collect();
        let mut hits = vec![None; rays.len()];
        let chunks = rays.par_chunks(width as usize);
        chunks
            .zip(hits.par_chunks_mut(width as usize))
            .for_each(|(rays, hits)| world.geometry.closest_batch(rays, hits));
        for (ray, hit) in rays.iter().zip(&hits) {
            let Some(hit) = hit else { continue };
            let Some(placement) = atlas.placements[hit.instance as usize] else {
                continue;
            };
            let chart = atlas.layouts[placement.layout as usize].charts[hit.primitive as usize];
            let triangle = WorldTriangle::new(scene, pose, hit.instance, hit.primitive);
            let back = triangle.front_cross().dot(ray.direction) > 0.0;
            seen.entry((placement.layout, chart)).or_default()[usize::from(back)] += 1;
        }
    }
    seen
}

/// The triangles of every chart.
fn charts(layout: &Layout) -> Vec<Vec<u32>> {
    let with_chart = layout.charts.iter().filter(|&&c| c != Layout::NO_CHART);
    let count = with_chart.max().map_or(0, |&last| last as usize + 1);
    let mut charts = vec![Vec::new(); count];
    for (primitive, &chart) in layout.charts.iter().enumerate() {
        if chart != Layout::NO_CHART {
            charts[chart as usize].push(primitive as u32);
        }
    }
    charts
}

/// What one side of a chart gets and sees.
struct Look {
    /// Mean irradiance, largest channel.
    light: f32,
    /// Median distance to what is seen, 0 for what never ends.
    distance: f32,
}

fn is_turned(
    world: &World,
    settings: &PathSettings,
    gatherer: &mut Gatherer,
    (instance, key): (u32, u32),
    triangles: &[u32],
) -> bool {
    let (scene, pose) = (world.geometry.scene, world.geometry.pose);
    let mut ends = Vec::with_capacity(triangles.len());
    let mut area = 0.0_f64;
    for &primitive in triangles {
        let world = WorldTriangle::new(scene, pose, instance, primitive);
        area += f64::from(world.front_cross().length());
        ends.push(area);
    }
    if area <= 0.0 {
        return false;
    }
    let point = |number: u32| {
        // R2 (Roberts 2018), and the golden ratio for the triangle.
        let n = f64::from(number) + 0.5;
        let triangle = ends.partition_point(|&end| end <= (n * 0.618_033_988_75).fract() * area);
        let at = warp::triangle(Vec2::new(
            (n * 0.754_877_666).fract() as f32,
            (n * 0.569_840_291).fract() as f32,
        ));
        Hit {
            t: 0.0,
            u: at.x,
            v: at.y,
            instance,
            primitive: triangles[triangle.min(triangles.len() - 1)],
        }
    };
    let mut look = |count: u32, back: bool| {
        let samples: Vec<SurfaceSample> = (0..count)
            .map(|number| SurfaceSample {
                point: point(number),
                side: key,
                number,
                back,
            })
            .collect();
        let mut light = vec![glam::Vec3::ZERO; samples.len()];
        gatherer.gather(world, settings, &samples, &mut light);
        let mut rays = Vec::with_capacity(samples.len());
        for sample in &samples {
            if let Some(surface) = surface_at(world.geometry, sample.point, back) {
                let (x, y) = warp::basis(surface.normal);
                let n = f64::from(sample.number) + 0.5;
                let random = Vec2::new(
                    (n * 0.569_840_291).fract() as f32,
                    (n / f64::from(count)) as f32,
                );
                let local = warp::cosine_hemisphere(random);
                let direction = x * local.x + y * local.y + surface.normal * local.z;
                let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
                rays.push(Ray::new(origin, direction.normalize()));
            }
        }
        let mut hits = vec![None; rays.len()];
        world.geometry.closest_batch(&rays, &mut hits);
        let mut distances: Vec<f32> = hits.iter().map(|hit| hit.map_or(0.0, |h| h.t)).collect();
        distances.sort_by(f32::total_cmp);
        let sum = light.iter().copied().sum::<glam::Vec3>();
        Look {
            light: sum.max_element() / count as f32,
            distance: distances.get(distances.len() / 2).copied().unwrap_or(0.0),
        }
    };
    let dark = |front: &Look, back: &Look| front.light < LITTLE * back.light;
    if !dark(&look(FIRST_LOOK, false), &look(FIRST_LOOK, true)) {
        return false;
    }
    let (front, back) = (look(SECOND_LOOK, false), look(SECOND_LOOK, true));
    front.light < NONE * back.light || dark(&front, &back) && front.distance < NEAR * back.distance
}
