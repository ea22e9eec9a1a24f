//! Shadow maps beside the cache (Popov 2013, section 5.4 and Fig. 8): cube maps for points, orthographic ones for directions.
//!
//! Plain maps, as in the paper: one depth a texel, one comparison a question, a bias by the texel's footprint on the surface
//! that asks. They are filled by coherent closest-hit rays, which is how this renderer sees from anywhere; a rasterizer would
//! fill them at another price, so filling and looking up stand apart in the table.

use super::measured::Measured;
use super::plot::{Curve, Plot};
use super::quality::quality;
use super::shot::{Shot, Stage, Task, instant_radiosity};
use super::subject::Subject;
use super::{Plan, fixed, percent};
use crate::common::{Report, Setting};
use glam::Vec3;
use occlude_render::geometry::Geometry;
use occlude_visibility::quantized::{BoundingSphere, ErrorReach, Guarantee};
use occlude_visibility::{
    BLOCK, Class, Endpoint, Exact, EyeSample, LightEnd, ManyLights, Query, Ray, SharedLight,
    Tracer, Visibility, VisibilityStats,
};
use rayon::prelude::*;
use std::collections::HashMap;
use std::time::Instant;

const TITLE: &str = "Shadow maps and the cache, lights without extent";
const HEADER: &[&str] = &[
    "scene",
    "samples",
    "how",
    "fill s",
    "frame s",
    "together s",
    "FLIP",
    "worst block",
    "energy change",
    "rays",
    "MB",
];

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let (sides, reaches): (&[u32], &[f32]) = if setting.quick {
        (&[64, 256], &[4.0, 14.0])
    } else {
        (&[128, 256, 512, 1024], &[4.0, 8.0, 14.0, 20.0])
    };
    let task = Task {
        integrator: instant_radiosity(subject.max_depth, 0),
        size: plan.size,
        samples: plan.samples[0],
        seed: plan.seed,
        single_passes: false,
    };
    // One question each of a tiny picture tells which lights there are.
    let recorder = Measured::recording(&Exact, u64::MAX);
    let tiny = Task {
        size: [16, 16],
        samples: 1,
        ..task
    };
    stage.shoot(&recorder, &tiny);
    let recording = recorder.into_recording();
    let mut lights: Vec<LightEnd> = Vec::new();
    for shared in recording.many.iter().flat_map(|call| &call.lights) {
        if !lights.contains(&shared.end) {
            lights.push(shared.end);
        }
    }
    let exact = stage.shoot(&Exact, &task);
    let mut curves = ["shadow maps", "cache"].map(|name| Curve {
        name: name.into(),
        points: Vec::new(),
        dashed: false,
    });
    let mut add = |report: &mut Report,
                   kind: usize,
                   how: String,
                   fill: f64,
                   rays: u64,
                   bytes: u64,
                   shot: &Shot| {
        let quality = match quality(&shot.picture, &exact.picture) {
            Ok(quality) => quality,
            Err(why) => return report.note(format!("{}: {why}", subject.name)),
        };
        let together = fill + shot.seconds;
        if kind < curves.len() {
            curves[kind].points.push((together, quality.flip));
        }
        report.raw(&format!(
            "shadow-maps,{},{},{how},,seconds,{together:.4},s\nshadow-maps,{0},{1},{how},,flip,{:.6},1",
            subject.name, task.samples, quality.flip
        ));
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                task.samples.to_string(),
                how,
                fixed(fill),
                fixed(shot.seconds),
                fixed(together),
                format!("{:.4}", quality.flip),
                format!("{:.3}", quality.flip_block),
                percent(quality.energy),
                super::short(rays as f64),
                fixed(bytes as f64 / 1e6),
            ],
        );
    };
    let traced = exact.report.visibility.traced;
    add(report, usize::MAX, "exact".into(), 0.0, traced, 0, &exact);
    for &side in sides {
        let start = Instant::now();
        let maps = ShadowMaps::new(stage.geometry, &lights, stage.bounds, side);
        let fill = start.elapsed().as_secs_f64();
        let shot = stage.shoot(&maps, &task);
        let how = format!("maps {side}");
        add(report, 0, how, fill, maps.rays(), maps.bytes(), &shot);
    }
    for &error in reaches {
        let strategy = stage.quantized(&task, Guarantee::Bounded, |settings| {
            settings.error = ErrorReach::all(error);
        });
        let shot = stage.shoot(&strategy, &task);
        let traced = shot.report.visibility.traced;
        let bytes = Visibility::<Geometry>::bytes(&strategy);
        let how = format!("cache C_E={error}");
        add(report, 1, how, 0.0, traced, bytes, &shot);
    }
    let svg = Plot {
        title: "mean FLIP against seconds, filling included",
        x: "seconds",
        log_x: true,
        log_y: true,
        curves: &curves,
    }
    .svg();
    report.figure(
        &format!(
            "{}: shadow maps of {sides:?} texels a side, the cache at C_E {reaches:?}",
            subject.name
        ),
        svg,
    );
}

/// Depths seen from all lights.
pub struct ShadowMaps {
    maps: HashMap<[u32; 4], Map>,
    side: u32,
}

/// What a light sees: six faces for a point, one for a direction.
struct Map {
    frame: Frame,
    depths: Vec<Vec<f32>>,
}

#[derive(Clone, Copy)]
enum Frame {
    Cube {
        centre: Vec3,
    },
    /// A square of `2 * radius` that starts `radius` before the middle; depth counts away from the light.
    Square {
        centre: Vec3,
        radius: f32,
        axes: [Vec3; 3],
    },
}

/// The axes of a cube's face: right, up, outwards.
fn face_axes(face: usize) -> [Vec3; 3] {
    let out = [
        Vec3::X,
        Vec3::NEG_X,
        Vec3::Y,
        Vec3::NEG_Y,
        Vec3::Z,
        Vec3::NEG_Z,
    ][face];
    let right = [Vec3::Y, Vec3::Y, Vec3::Z, Vec3::Z, Vec3::X, Vec3::X][face];
    [right, out.cross(right), out]
}

impl Frame {
    fn faces(&self) -> usize {
        match self {
            Self::Cube { .. } => 6,
            Self::Square { .. } => 1,
        }
    }

    /// The ray through a place of a face, both coordinates from -1 to 1; its parameter is the depth.
    fn ray(&self, face: usize, [u, v]: [f32; 2]) -> Ray {
        match *self {
            Self::Cube { centre } => {
                let [right, up, out] = face_axes(face);
                Ray::new(centre, out + right * u + up * v)
            }
            Self::Square {
                centre,
                radius,
                axes: [right, up, out],
            } => {
                let start = centre + (right * u + up * v - out) * radius;
                Ray::new(start, out)
            }
        }
    }

    /// Face, place from -1 to 1, depth, and half the width of the face at that depth.
    fn project(&self, point: Vec3) -> (usize, [f32; 2], f32, f32) {
        match *self {
            Self::Cube { centre } => {
                let way = point - centre;
                let a = way.abs();
                let axis = if a.x >= a.y && a.x >= a.z {
                    0
                } else if a.y >= a.z {
                    1
                } else {
                    2
                };
                let face = 2 * axis + usize::from(way[axis] < 0.0);
                let [right, up, out] = face_axes(face);
                let depth = way.dot(out);
                (
                    face,
                    [way.dot(right) / depth, way.dot(up) / depth],
                    depth,
                    depth,
                )
            }
            Self::Square {
                centre,
                radius,
                axes: [right, up, out],
            } => {
                let way = point - centre;
                let place = [way.dot(right) / radius, way.dot(up) / radius];
                (0, place, way.dot(out) + radius, radius)
            }
        }
    }
}

/// What identifies a light without extent.
fn key(light: &LightEnd) -> Option<[u32; 4]> {
    let (kind, Vec3 { x, y, z }) = match light {
        LightEnd::Point(position) => (0, *position),
        LightEnd::Direction(direction) => (1, *direction),
        LightEnd::Surface(_) | LightEnd::SolidAngle { .. } => return None,
    };
    Some([kind, x.to_bits(), y.to_bits(), z.to_bits()])
}

impl ShadowMaps {
    /// Maps of `side` x `side` texels a face, for all lights without extent.
    pub fn new(
        geometry: &Geometry,
        lights: &[LightEnd],
        bounds: BoundingSphere,
        side: u32,
    ) -> Self {
        let maps = lights.iter().filter_map(|light| {
            let frame = match *light {
                LightEnd::Point(centre) => Frame::Cube { centre },
                LightEnd::Direction(towards) => {
                    let (right, up) = towards.any_orthonormal_pair();
                    Frame::Square {
                        centre: bounds.centre,
                        radius: bounds.radius,
                        axes: [right, up, -towards],
                    }
                }
                LightEnd::Surface(_) | LightEnd::SolidAngle { .. } => return None,
            };
            let faces = (0..frame.faces()).into_par_iter();
            let depths = faces
                .map(|face| fill(geometry, &frame, face, side))
                .collect();
            Some((key(light)?, Map { frame, depths }))
        });
        Self {
            maps: maps.collect(),
            side,
        }
    }

    fn rays(&self) -> u64 {
        self.maps
            .values()
            .flat_map(|map| &map.depths)
            .map(|face| face.len() as u64)
            .sum()
    }

    fn bytes(&self) -> u64 {
        4 * self.rays()
    }

    /// Whether an eye sees a light; `None` for lights without a map.
    fn visible(&self, query: &Query) -> Option<bool> {
        let map = self.maps.get(&key(&query.light)?)?;
        Some(self.sees(map, &query.eye, query.ray.direction))
    }

    fn sees(&self, map: &Map, eye: &Endpoint, towards: Vec3) -> bool {
        let (face, place, depth, half) = map.frame.project(eye.position);
        let last = self.side - 1;
        let texel = |v: f32| ((0.5 * v + 0.5) * self.side as f32).clamp(0.0, last as f32) as u32;
        let [column, row] = place.map(texel);
        let seen = map.depths[face][(row * self.side + column) as usize];
        // Inside a texel a slanted surface's depth varies by the texel's width times the slope.
        let cosine = eye.normal.dot(towards.normalize_or_zero()).clamp(0.05, 1.0);
        let slope = (1.0 - cosine * cosine).sqrt() / cosine;
        let bias = 2.0 * half / self.side as f32 * (0.5 + slope);
        depth <= seen + bias
    }
}

/// Depths of one face, row by row.
fn fill(geometry: &Geometry, frame: &Frame, face: usize, side: u32) -> Vec<f32> {
    /// Side of the squares of rays that are traced together.
    const TOGETHER: u32 = 16;
    let mut depths = vec![f32::INFINITY; (side * side) as usize];
    let (mut rays, mut places, mut hits) = (Vec::new(), Vec::new(), Vec::new());
    for top in (0..side).step_by(TOGETHER as usize) {
        for left in (0..side).step_by(TOGETHER as usize) {
            rays.clear();
            places.clear();
            for y in top..(top + TOGETHER).min(side) {
                for x in left..(left + TOGETHER).min(side) {
                    let at = |i: u32| (i as f32 + 0.5) / side as f32 * 2.0 - 1.0;
                    rays.push(frame.ray(face, [at(x), at(y)]));
                    places.push((y * side + x) as usize);
                }
            }
            hits.clear();
            hits.resize(rays.len(), None);
            geometry.closest_batch(&rays, &mut hits);
            for ((ray, hit), &place) in rays.iter().zip(&hits).zip(&places) {
                depths[place] =
                    hit.map_or(f32::INFINITY, |hit| blocker_depth(geometry, ray, hit.t));
            }
        }
    }
    depths
}

/// The depth of the first blocker along a ray whose first surface lies at `depth`: panes let light pass.
fn blocker_depth(geometry: &Geometry, ray: &Ray, mut depth: f32) -> f32 {
    const MOST_PANES: usize = 16;
    if !geometry.has_panes() {
        return depth;
    }
    for _ in 0..MOST_PANES {
        let just_behind = Ray {
            t_max: depth * (1.0 + 1e-5),
            ..*ray
        };
        if geometry.occluded(&just_behind) {
            return depth;
        }
        let rest = Ray {
            t_min: depth,
            ..*ray
        };
        let mut hit = [None];
        geometry.closest_batch(&[rest], &mut hit);
        match hit[0] {
            Some(next) => depth = next.t,
            None => return f32::INFINITY,
        }
    }
    depth
}

impl<T: Tracer> Visibility<T> for ShadowMaps {
    type Worker = VisibilityStats;

    fn name(&self) -> &'static str {
        "shadow-maps"
    }

    fn class(&self) -> Class {
        Class::Biased
    }

    fn worker(&self) -> VisibilityStats {
        VisibilityStats::default()
    }

    fn answer(
        &self,
        tracer: &T,
        worker: &mut Self::Worker,
        queries: &[Query],
        answers: &mut [f32],
    ) {
        assert_eq!(queries.len(), answers.len());
        for (query, answer) in queries.iter().zip(answers) {
            worker.queries += 1;
            let visible = self.visible(query).unwrap_or_else(|| {
                worker.traced += 1;
                !tracer.occluded(&query.ray)
            });
            *answer = if visible { 1.0 } else { 0.0 };
        }
        worker.answered = worker.queries - worker.traced;
    }

    /// Light by light: one map after the other stays in the caches.
    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut Self::Worker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        let mut wanted = vec![0u16; eyes.len()];
        let mut seen = vec![0u16; eyes.len()];
        for (block, lights) in lights.chunks(BLOCK).enumerate() {
            wanted.fill(0);
            asker.wanted(block, &mut wanted);
            seen.fill(0);
            for (l, light) in lights.iter().enumerate() {
                let map = key(&light.end).and_then(|key| self.maps.get(&key));
                for ((eye, mask), seen) in eyes.iter().zip(&wanted).zip(&mut seen) {
                    if mask >> l & 1 == 0 {
                        continue;
                    }
                    worker.queries += 1;
                    let ray = light.ray_from(eye.origin);
                    let visible = match map {
                        Some(map) => self.sees(map, &eye.end, ray.direction),
                        None => {
                            worker.traced += 1;
                            !tracer.occluded(&ray)
                        }
                    };
                    *seen |= u16::from(visible) << l;
                }
            }
            asker.take(block, &seen, &[]);
        }
        worker.answered = worker.queries - worker.traced;
    }

    fn stats(&self, worker: &VisibilityStats) -> VisibilityStats {
        worker.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_bvh::BuildOptions;
    use occlude_scene::{Pose, procedural};

    /// Projecting the point that a ray reaches gives the ray's place, face and depth back.
    #[test]
    fn rays_and_projections_agree() {
        let (right, up) = Vec3::new(0.48, 0.6, 0.64).any_orthonormal_pair();
        let square = Frame::Square {
            centre: Vec3::new(1.0, 2.0, 3.0),
            radius: 5.0,
            axes: [right, up, Vec3::new(0.48, 0.6, 0.64)],
        };
        let cube = Frame::Cube {
            centre: Vec3::new(1.0, 2.0, 3.0),
        };
        for frame in [cube, square] {
            for face in 0..frame.faces() {
                let ray = frame.ray(face, [0.3, -0.7]);
                let (found, [u, v], depth, _) = frame.project(ray.at(4.0));
                assert_eq!(found, face);
                assert!(
                    (u - 0.3).abs() < 1e-5 && (v + 0.7).abs() < 1e-5 && (depth - 4.0).abs() < 1e-4
                );
            }
        }
    }

    /// In the Cornell box fine maps say what rays say, but for a thin rim around the shadows.
    #[test]
    fn fine_maps_agree_with_rays() {
        let scene = procedural::build(procedural::Name::Cornell, None, 0);
        let pose = Pose::at(&scene, 0.0);
        let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (index, instance) in pose.instances.iter().enumerate() {
            for &p in pose.positions(&scene, index) {
                let p = instance.world_from_object.transform_point3(p);
                (min, max) = (min.min(p), max.max(p));
            }
        }
        let bounds = BoundingSphere::around(min, max);
        let middle = 0.5 * (min + max);
        let light = middle + Vec3::new(0.1, 0.35, 0.05) * (max - min);
        let end = LightEnd::Point(light);
        let maps = ShadowMaps::new(&geometry, &[end], bounds, 256);
        let (mut wrong, mut shadowed, n) = (0, 0, 64);
        for i in 0..n * n {
            let at = |k: i32| (k as f32 + 0.5) / n as f32 * 0.8 + 0.1;
            let above = min + (max - min) * Vec3::new(at(i % n), 0.3, at(i / n));
            let mut hit = [None];
            let down = Ray::new(above, Vec3::NEG_Y);
            geometry.closest_batch(&[down], &mut hit);
            let Some(hit) = hit[0] else { continue };
            let position = down.at(hit.t) + Vec3::Y * 1e-4;
            let query = Query::new(
                Endpoint::new(position, Vec3::Y, 1.0),
                end,
                Ray::between(position, light),
            );
            let exact = !geometry.occluded(&query.ray);
            shadowed += usize::from(!exact);
            wrong += usize::from(maps.visible(&query) != Some(exact));
        }
        assert!(shadowed > 200, "{shadowed}");
        assert!(wrong < 160, "{wrong} of {}", n * n);
    }
}
