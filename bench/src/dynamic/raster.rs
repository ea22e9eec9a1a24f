//! Fig. 7: adaptive rays against rasterization of everything into the five sides of half a cube, the way of shadow maps.
//!
//! The rasterizer keeps one bit a pixel (a map does not ask how far), clips, rejects what lies outside of a side, and fills by edge functions, a row of 64
//! pixels at a time. One core each. A side has half as many pixels along it as the map has texels: about as many for the same directions.

use super::stage::Stage;
use crate::common::{Report, Row, Setting, median};
use glam::Vec3;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::{Geometry, WorldTriangle};
use occlude_scene::procedural::Name;
use occlude_visibility::field::{Hemisphere, MapSampler, MapSampling, VisibilityMap};
use occlude_visibility::{Ray, Tracer};
use std::time::Instant;

/// Nearer than this in front of a side is clipped, metres.
const NEAR: f32 = 1e-4;

/// Sides as axes right, up, forward in the frame side, normal, pole.
const SIDES: [[Vec3; 3]; 5] = [
    [Vec3::X, Vec3::Z, Vec3::Y],
    [Vec3::Z, Vec3::Y, Vec3::X],
    [Vec3::Z, Vec3::Y, Vec3::NEG_X],
    [Vec3::X, Vec3::Y, Vec3::Z],
    [Vec3::X, Vec3::Y, Vec3::NEG_Z],
];

struct HalfCube {
    pixels: usize,
    words: usize,
    /// A set bit is blocked; rows of words, side after side.
    bits: Vec<u64>,
}

impl HalfCube {
    fn new(pixels: usize) -> Self {
        let words = pixels.div_ceil(64);
        Self {
            pixels,
            words,
            bits: vec![0; SIDES.len() * pixels * words],
        }
    }

    fn draw(&mut self, triangles: &[[Vec3; 3]], origin: Vec3, axes: &Hemisphere) {
        self.bits.fill(0);
        for triangle in triangles {
            let local = triangle.map(|p| axes.to_local(p - origin));
            // Wholly below the horizon.
            if local.iter().all(|p| p.y <= 0.0) {
                continue;
            }
            for (side, &[right, up, forward]) in SIDES.iter().enumerate() {
                let view = local.map(|p| Vec3::new(p.dot(right), p.dot(up), p.dot(forward)));
                let outside = |f: fn(&Vec3) -> bool| view.iter().all(f);
                if outside(|p| p.z <= NEAR)
                    || outside(|p| p.x > p.z)
                    || outside(|p| -p.x > p.z)
                    || outside(|p| p.y > p.z)
                    || outside(|p| -p.y > p.z)
                    || side > 0 && outside(|p| p.y <= 0.0)
                {
                    continue;
                }
                self.clip(side, &view);
            }
        }
    }

    fn clip(&mut self, side: usize, view: &[Vec3; 3]) {
        let mut corners = [Vec3::ZERO; 4];
        let mut count = 0;
        for k in 0..3 {
            let (a, b) = (view[k], view[(k + 1) % 3]);
            if a.z > NEAR {
                corners[count] = a;
                count += 1;
            }
            if (a.z > NEAR) != (b.z > NEAR) {
                corners[count] = a.lerp(b, (NEAR - a.z) / (b.z - a.z));
                count += 1;
            }
        }
        let half = 0.5 * self.pixels as f32;
        let place = |p: Vec3| {
            [
                (p.x / p.z + 1.0) * half - 0.5,
                (p.y / p.z + 1.0) * half - 0.5,
            ]
        };
        for k in 2..count {
            self.fill(
                side,
                [place(corners[0]), place(corners[k - 1]), place(corners[k])],
            );
        }
    }

    fn fill(&mut self, side: usize, [a, b, c]: [[f32; 2]; 3]) {
        let last = self.pixels as f32 - 1.0;
        let low = |k: usize| a[k].min(b[k]).min(c[k]).ceil().max(0.0);
        let high = |k: usize| a[k].max(b[k]).max(c[k]).floor().min(last);
        let (x0, x1, y0, y1) = (low(0), high(0), low(1), high(1));
        if x0 > x1 || y0 > y1 || !(x0 + x1 + y0 + y1).is_finite() {
            return;
        }
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let sign = if area < 0.0 { -1.0 } else { 1.0 };
        let edges = [[a, b], [b, c], [c, a]];
        for y in y0 as usize..=y1 as usize {
            // Where each edge leaves the row: a span of pixels whose centres are inside of all.
            let (mut from, mut to) = (x0, x1);
            for [p, q] in edges {
                let (dx, dy) = ((q[0] - p[0]) * sign, (q[1] - p[1]) * sign);
                let off = dx * (y as f32 - p[1]);
                // off - dy (x - p.x) >= 0
                if dy > 0.0 {
                    to = to.min((off / dy + p[0]).floor());
                } else if dy < 0.0 {
                    from = from.max((off / dy + p[0]).ceil());
                } else if off < 0.0 {
                    to = -1.0;
                }
            }
            if from > to {
                continue;
            }
            let (from, to) = (from as usize, to as usize);
            let row = &mut self.bits[(side * self.pixels + y) * self.words..][..self.words];
            for (word, bits) in row.iter_mut().enumerate().take(to / 64 + 1).skip(from / 64) {
                let first = from.saturating_sub(word * 64);
                let end = (to - word * 64).min(63);
                *bits |= (u64::MAX << first) & (u64::MAX >> (63 - end));
            }
        }
    }

    fn is_free(&self, w: Vec3) -> bool {
        let a = w.abs();
        let side = if w.y >= a.x && w.y >= a.z {
            0
        } else if a.x >= a.z {
            if w.x > 0.0 { 1 } else { 2 }
        } else if w.z > 0.0 {
            3
        } else {
            4
        };
        let [right, up, forward] = SIDES[side];
        let scale = self.pixels as f32 * 0.5;
        let depth = w.dot(forward);
        let index = |v: f32| (((v / depth + 1.0) * scale) as usize).min(self.pixels - 1);
        let (x, y) = (index(w.dot(right)), index(w.dot(up)));
        self.bits[(side * self.pixels + y) * self.words + x / 64] >> (x % 64) & 1 == 0
    }
}

/// Microseconds a map and wrong texels, by resolution.
pub fn compare(setting: &Setting, report: &mut Report) {
    let title = "Maps by adaptive rays and by rasterization (Fig. 7), one core";
    let header = [
        "scene",
        "texels",
        "rays us",
        "raster us",
        "rays / raster",
        "wrong by rays",
        "wrong by raster",
    ];
    for name in [Name::HatOnCloth, Name::BallsInDish, Name::WalkingHat] {
        let Some(stage) = Stage::procedural(setting, name, "kiara_1_dawn_1k.hdr") else {
            continue;
        };
        let pose = stage.pose(30);
        let Ok(geometry) = Geometry::new(&stage.scene, &pose, &BuildOptions::default()) else {
            continue;
        };
        let triangles: Vec<[Vec3; 3]> = (pose.instances.iter().enumerate())
            .flat_map(|(instance, posed)| {
                let count = stage.scene.meshes[posed.mesh as usize].triangles.len();
                let (scene, pose) = (&stage.scene, &pose);
                (0..count).map(move |k| {
                    WorldTriangle::new(scene, pose, instance as u32, k as u32).corners
                })
            })
            .collect();
        let points = stage.points(&geometry, &pose, if setting.quick { 12 } else { 48 });
        for side in [64, 128, 256] {
            let sampling = MapSampling {
                start: 16,
                resolution: side,
            };
            let mut sampler = MapSampler::default();
            let mut cube = HalfCube::new(side as usize / 2);
            let (mut by_rays, mut by_raster) = (Vec::new(), Vec::new());
            let (mut wrong_rays, mut wrong_raster) = (0.0, 0.0);
            for &(place, normal) in &points {
                let axes = Hemisphere::new(normal, Vec3::X);
                let start = Instant::now();
                let rays = sampler.sample(&geometry, place, &axes, sampling, &[]);
                by_rays.push(start.elapsed().as_secs_f64() * 1e6);
                let start = Instant::now();
                cube.draw(&triangles, place, &axes);
                let raster = VisibilityMap::from_fn(side, |local| cube.is_free(local));
                by_raster.push(start.elapsed().as_secs_f64() * 1e6);
                let all = VisibilityMap::from_fn(side, |local| {
                    !geometry.occluded(&Ray::new(place, axes.to_world(local)))
                });
                wrong_rays += rays.difference(&all);
                wrong_raster += raster.difference(&all);
            }
            let count = points.len().max(1) as f32;
            let (rays, raster) = (median(&by_rays).0, median(&by_raster).0);
            report.table(
                title,
                &header,
                vec![
                    stage.name.into(),
                    side.to_string(),
                    format!("{rays:.0}"),
                    format!("{raster:.0}"),
                    format!("{:.2}", rays / raster),
                    format!("{:.3} %", wrong_rays / count * 100.0),
                    format!("{:.3} %", wrong_raster / count * 100.0),
                ],
            );
            report.row(Row {
                name: format!("map of {side} by rays"),
                scene: stage.name.into(),
                value: rays,
                unit: "us".into(),
                baseline: Some(raster),
                ratio: Some(raster / rays),
                spread: None,
                bar: None,
                holds: None,
            });
        }
    }
}
