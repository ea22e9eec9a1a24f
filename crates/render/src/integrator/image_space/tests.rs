//! Image-space paths with exact answers are paths.

use super::*;
use crate::camera::{PixelFilter, View};
use crate::film::Film;
use crate::integrator::{
    AtRest, Integrator, RenderSettings, SAMPLES_TOGETHER, Sequence, records_state,
};
use crate::job::Job;
use crate::light::{LightSelection, Lights};
use crate::sampling::SamplerKind;
use occlude_bvh::BuildOptions;
use occlude_scene::{Pose, Scene, procedural};
use occlude_visibility::Exact;
use occlude_visibility::records::{DistanceTracer, Seen};

/// [`super::advance`] with rays in place of records.
pub(super) fn advance_exactly(world: &World, limits: PathLimits, scratch: &mut path::Scratch) {
    let geometry = world.geometry;
    for index in std::mem::take(&mut scratch.cached) {
        loop {
            let path = &mut scratch.paths[index as usize];
            let ray = path.ray;
            let (mut seen, mut site) = ([Seen::NOTHING], [None]);
            geometry.surfaces(&[ray], &mut seen);
            geometry.sites(&[ray], &mut site);
            path.leaving = None;
            let ([seen], [Some(site)]) = (seen, site) else {
                path::add_environment(world, path, false);
                break;
            };
            if seen.trace {
                scratch.alive.push(index);
                break;
            }
            let surface = CachedSurface {
                position: site.position,
                normal: seen.normal,
                albedo: seen.albedo,
                footprint: 2.0 * site.origin.distance(site.position),
            };
            let (queries, pending) = (&mut scratch.queries, &mut scratch.pending);
            let mut ask = |_: &Path, query: Query, _: SegmentEnd, contribution: Vec3, _: f32| {
                queries.push(query);
                pending.push(Pending {
                    path: index,
                    contribution,
                });
            };
            let ends = path.depth >= limits.max_depth;
            if ends || scatter(world, path, &surface, &mut ask).is_none() {
                break;
            }
        }
    }
}

/// Sum and sum of squares of the pixels' mean luminance over independent pictures.
fn means(scene: &Scene, secondary: impl Fn() -> Option<Secondary>, pictures: u64) -> Vec<[f64; 2]> {
    let pose = Pose::at(scene, 0.0);
    let geometry = Geometry::new(scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(scene, &pose, None, LightSelection::Tree);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let view = View::of_camera(scene, &pose, 0, SIZE, SIZE);
    let mut sums = vec![[0.0; 2]; (SIZE / BLOCK * (SIZE / BLOCK)) as usize];
    for seed in 0..pictures {
        let settings = RenderSettings {
            integrator: Integrator::Path(PathLimits::new(5)),
            sampler: SamplerKind::Independent,
            filter: PixelFilter::Box,
            seed,
            samples: 0..16,
            time_limit: None,
            noise: None,
        };
        let mut film = Film::new(SIZE, SIZE, false);
        let mut sequence = Sequence {
            secondary: secondary(),
            ..Sequence::default()
        };
        sequence.render(
            &world,
            &view,
            &Exact,
            &settings,
            &mut film,
            &Job::new(),
            &mut |_| (),
        );
        let picture = film.develop();
        for (at, sums) in sums.iter_mut().enumerate() {
            let columns = (SIZE / BLOCK) as usize;
            let (bx, by) = (at % columns, at / columns);
            let mut mean = 0.0;
            for k in 0..(BLOCK * BLOCK) as usize {
                let (x, y) = (
                    bx * BLOCK as usize + k % BLOCK as usize,
                    by * BLOCK as usize + k / BLOCK as usize,
                );
                let pixel = picture.radiance[y * SIZE as usize + x];
                mean += f64::from(pixel[0] + pixel[1] + pixel[2]);
            }
            mean /= f64::from(BLOCK * BLOCK);
            sums[0] += mean;
            sums[1] += mean * mean;
        }
    }
    sums
}

const SIZE: u32 = 32;
const BLOCK: u32 = 8;

/// A z-test for each of 16 blocks, false alarms below 1e-4 altogether.
#[test]
fn with_exact_answers_pictures_are_those_of_path_tracing() {
    let mut scene = procedural::build(procedural::Name::Cornell, None, 0);
    for material in &mut scene.materials {
        *material = material.diffuse_only();
    }
    let pictures = 48;
    let plain = means(&scene, || None, pictures);
    for from in [1, 2] {
        let other = means(&scene, || Some(Secondary::exact(from)), pictures);
        for (block, (a, b)) in plain.iter().zip(&other).enumerate() {
            let n = pictures as f64;
            let variance = |s: &[f64; 2]| (s[1] / n - (s[0] / n).powi(2)) / (n - 1.0);
            let z = (a[0] - b[0]) / n / (variance(a) + variance(b)).sqrt();
            assert!(z.abs() < 4.8, "from {from}, block {block}: z = {z}");
        }
    }
}

/// Records see the room from a little beside: the picture keeps its light.
#[test]
fn records_keep_the_light_of_a_room() {
    let mut scene = procedural::build(procedural::Name::Cornell, None, 0);
    for material in &mut scene.materials {
        *material = material.diffuse_only();
    }
    let plain = means(&scene, || None, 2);
    let points = || scene.meshes.iter().flat_map(|mesh| &mesh.positions);
    let low = points().fold(Vec3::MAX, |low, &p| low.min(p));
    let bounds = [low, points().fold(Vec3::MIN, |high, &p| high.max(p))];
    let records = || {
        let settings = RecordSettings {
            capacity: 300,
            resolution: 64,
            scene: bounds,
            ..RecordSettings::default()
        };
        Some(Secondary::new(settings, 1).unwrap())
    };
    let other = means(&scene, records, 2);
    let sum = |sums: &[[f64; 2]]| sums.iter().map(|s| s[0]).sum::<f64>();
    let energy = sum(&other) / sum(&plain) - 1.0;
    assert!(energy.abs() < 0.05, "{energy}");
}

/// Cancelled right after a pass, when the records have learnt from it already: that must not happen twice.
#[test]
fn a_pass_is_learnt_from_once() {
    let scene = procedural::build(procedural::Name::Cornell, None, 0);
    let pose = Pose::at(&scene, 0.0);
    let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let view = View::of_camera(&scene, &pose, 0, SIZE, SIZE);
    let settings = RenderSettings {
        integrator: Integrator::Path(PathLimits::new(5)),
        sampler: SamplerKind::Independent,
        filter: PixelFilter::Box,
        seed: 3,
        samples: 0..3 * SAMPLES_TOGETHER,
        time_limit: None,
        noise: None,
    };
    let sequence = || {
        let records = RecordSettings {
            capacity: 40,
            resolution: 16,
            pace: 5,
            scene: [Vec3::splat(-1.0), Vec3::splat(2.0)],
            ..RecordSettings::default()
        };
        Sequence::with_secondary(Secondary::new(records, 1).unwrap())
    };
    let render = |sequence: &mut Sequence, film: &mut Film, passes: u32| {
        let job = Job::new();
        let mut left = passes;
        let mut at_rest = |_: &AtRest| {
            left -= 1;
            if left == 0 {
                job.cancel();
            }
        };
        sequence.render(&world, &view, &Exact, &settings, film, &job, &mut at_rest);
    };
    let mut whole = Film::new(SIZE, SIZE, false);
    render(&mut sequence(), &mut whole, u32::MAX);
    let mut film = Film::new(SIZE, SIZE, false);
    let mut first = sequence();
    render(&mut first, &mut film, 2);
    assert_eq!(film.min_samples(), SAMPLES_TOGETHER);
    let state = records_state(&Exact, first.secondary.as_ref());
    let mut second = sequence();
    (second.restore_records(&world, &Exact, &settings, &film, &state)).unwrap();
    render(&mut second, &mut film, u32::MAX);
    assert!(film.develop().radiance == whole.develop().radiance);
}
