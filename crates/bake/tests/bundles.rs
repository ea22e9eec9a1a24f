//! Ray bundles against closed forms.

mod support;

use glam::{Vec2, Vec3};
use occlude_bake::bundle::{self, Directions, Radiance, Settings, Stats, Triangles};
use occlude_bake::gather::{Gatherer, Part, PathSettings, SurfaceSample, placement};
use occlude_bake::sums::Sums;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::Pose;
use occlude_testkit::estimate::Estimate;
use occlude_visibility::Hit;
use std::f32::consts::PI;
use support::{Build, matt, texels};

/// Densities 100:1 and more.
const UNLIKE: [[u32; 2]; 6] = [[3, 5], [40, 30], [10, 10], [64, 2], [1, 1], [25, 25]];

fn settings() -> Settings {
    Settings {
        analysis: 64,
        lines: 16,
        nodes: 2_000,
        ..Settings::default()
    }
}

fn gather(
    triangles: &Triangles,
    light: impl Fn(u32) -> Vec3 + Sync,
    sky: Option<bundle::Sky>,
    round: u32,
    count: u32,
    settings: &Settings,
) -> (Sums, Stats) {
    let directions = Directions { seed: 1, round };
    gather_along(triangles, light, sky, &directions, count, settings)
}

fn gather_along(
    triangles: &Triangles,
    light: impl Fn(u32) -> Vec3 + Sync,
    sky: Option<bundle::Sky>,
    directions: &Directions,
    count: u32,
    settings: &Settings,
) -> (Sums, Stats) {
    let sides = triangles.sides().count();
    let brightest = (0..sides).fold(0.0_f32, |m, side| m.max(light(side).max_element()));
    let brightest = brightest.max(sky.map_or(0.0, |sky| sky(Vec3::Y).max_element()));
    let sums = Sums::new(sides, bundle::unit(brightest, count));
    let radiance = Radiance::new(sides, brightest, light);
    let stats = bundle::gather(
        triangles,
        &radiance,
        sky,
        directions,
        0..count,
        settings,
        &Job::new(),
        &sums,
    );
    assert_eq!(stats.directions, u64::from(count));
    (sums, stats)
}

#[test]
fn the_furnace_is_the_sum_of_its_bounces() {
    let (emission, albedo, bounces) = (0.5_f32, 0.5_f32, 3);
    let mut build = Build::default();
    let (low, high) = (Vec3::new(-1.0, 0.0, -2.0), Vec3::new(2.0, 1.5, 1.0));
    build.room(low, high, UNLIKE, &matt(albedo));
    build.rectangle(
        Vec3::new(0.3, 0.5, -0.5),
        Vec3::X * 0.3,
        Vec3::new(0.0, 0.2, 0.2),
        None,
        matt(albedo),
    );
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let mut triangles = Triangles::new(scene, &pose, &atlas);
    triangles.find_backs(0, &settings(), &Job::new());
    // Of the six walls nobody sees the backs; those of the two free triangles are one run.
    assert_eq!(
        triangles.sides().count() - triangles.sides().fronts_count(),
        64
    );
    let sides = triangles.sides().count() as usize;
    let mut total = vec![Vec3::ZERO; sides];
    let mut light = vec![Vec3::splat(emission); sides];
    for round in 0..=bounces {
        let (sums, _) = gather(
            &triangles,
            |s| light[s as usize],
            None,
            round,
            64,
            &settings(),
        );
        for side in 0..sides {
            let arrived = sums.irradiance(side as u32).unwrap_or(Vec3::ZERO);
            total[side] += arrived;
            light[side] = arrived * (albedo / PI);
        }
    }
    let expected = PI * emission * (1.0 - albedo.powi(bounces as i32 + 1)) / (1.0 - albedo);
    let mut seen = 0;
    for instance in 0..6 {
        for (texel, _) in texels(&atlas, instance) {
            let got = total[texel as usize];
            seen += u32::from(got != Vec3::ZERO);
            // Each round rounds radiance by 0.2 % at most.
            let off = (got / expected - 1.0).abs().max_element();
            assert!(got == Vec3::ZERO || off < 4e-3, "{instance} {texel}: {got}");
        }
    }
    let all: u32 = UNLIKE.iter().map(|t| t[0] * t[1]).sum();
    assert!(
        seen >= all - 2,
        "{seen} of {all} texels got lines in every round"
    );
}

/// Irradiance at a point from a rectangle of radiance 1 that is wholly above its horizon (Lambert 1760).
fn from_rectangle(at: Vec3, normal: Vec3, center: Vec3, a: Vec3, b: Vec3) -> f32 {
    let corners = [-a - b, a - b, a + b, b - a].map(|c| (center + c - at).normalize());
    let edge = |k: usize| {
        let (p, q) = (corners[k], corners[(k + 1) % 4]);
        let cross = p.cross(q);
        cross.length().atan2(p.dot(q)) * cross.normalize_or_zero().dot(normal)
    };
    0.5 * (0..4).map(edge).sum::<f32>().abs()
}

#[test]
fn a_half_lit_box_across_unlike_tiles() {
    let mut build = Build::default();
    let (low, high) = (Vec3::ZERO, Vec3::new(3.0, 2.0, 2.5));
    build.room(low, high, UNLIKE, &matt(0.5));
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let triangles = Triangles::new(scene, &pose, &atlas);
    let lamp = 3;
    let lit: Vec<u32> = texels(&atlas, lamp).iter().map(|t| t.0).collect();
    let light = |side: u32| Vec3::splat(f32::from(u8::from(lit.contains(&side))));
    let (count, seeds) = (200, 10);
    let runs: Vec<Sums> = (0..seeds)
        .map(|seed| {
            let directions = Directions { seed, round: 0 };
            let (sums, stats) =
                gather_along(&triangles, light, None, &directions, count, &settings());
            assert!(
                stats.tiles > 10 * u64::from(count),
                "tiles are to differ: {stats:?}"
            );
            sums
        })
        .collect();
    let corners = |instance: usize| {
        let p = &scene.meshes[instance].positions;
        let (a, b) = ((p[1] - p[0]) * 0.5, (p[3] - p[0]) * 0.5);
        (p[0] + a + b, a, b)
    };
    let (center, a, b) = corners(lamp);
    for instance in (0..6).filter(|&i| i != lamp) {
        let (c, u, v) = corners(instance);
        let normal = u.cross(v).normalize();
        let list = texels(&atlas, instance);
        let size = atlas.layouts[instance].pieces[0].as_vec2();
        let mut means = vec![0.0; runs.len()];
        let (mut expected, mut square) = (0.0, 0.0);
        let share = 1.0 / list.len() as f64;
        for &(texel, place) in &list {
            // The mean over the texel: its middle, or more points where texels are large.
            let fine = (24.0 / size.min_element()).clamp(1.0, 16.0) as u32;
            let mut exact = 0.0;
            for i in 0..fine * fine {
                let inside = Vec2::new((i % fine) as f32, (i / fine) as f32) + 0.5;
                let place = place + (inside / fine as f32 - 0.5) / size;
                let at = c + u * (2.0 * place.x - 1.0) + v * (2.0 * place.y - 1.0);
                exact += f64::from(from_rectangle(at, normal, center, a, b));
            }
            exact /= f64::from(fine * fine);
            let mut all = 0.0;
            for (mean, sums) in means.iter_mut().zip(&runs) {
                let got = f64::from(sums.irradiance(texel).unwrap().x);
                *mean += got * share;
                all += got / runs.len() as f64;
            }
            expected += exact * share;
            square += (all - exact).powi(2) * share;
        }
        let n = runs.len() as f64;
        let mean = means.iter().sum::<f64>() / n;
        let variance = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let error = (variance / n).sqrt();
        println!(
            "wall {instance}: {mean} +- {error}, {expected}, rms {}",
            square.sqrt()
        );
        // Student's t with 9 degrees: beyond 4.8 in one of 1000 cases; five walls.
        assert!(
            (mean - expected).abs() < 4.8 * error && error < 0.006 * expected,
            "wall {instance}: mean {mean} +- {error}, expected {expected}"
        );
        assert!(
            square.sqrt() < 0.06 * expected,
            "wall {instance}: {}",
            square.sqrt()
        );
    }
}

#[test]
fn the_sky_comes_in_at_open_ends() {
    let mut build = Build::default();
    build.rectangle(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X, Some([8, 8]), matt(0.5));
    // Sees the other's back, and is as bright as the sky that it hides from it.
    build.rectangle(
        Vec3::Y * -2.0,
        Vec3::Z * 2.0,
        Vec3::X,
        Some([8, 8]),
        matt(0.5),
    );
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let mut triangles = Triangles::new(scene, &pose, &atlas);
    // Bright above, dark below: the front gets pi, the back a tenth.
    let sky = |towards: Vec3| Vec3::splat(if towards.y > 0.0 { 1.0 } else { 0.1 });
    let looker: Vec<u32> = texels(&atlas, 1).iter().map(|t| t.0).collect();
    let light = |side: u32| Vec3::splat(if looker.contains(&side) { 0.1 } else { 0.0 });
    assert_eq!(triangles.sides().back_of(11), None);
    triangles.find_backs(0, &settings(), &Job::new());
    let (sums, _) = gather(&triangles, light, Some(&sky), 0, 200, &settings());
    let mut backs = 0;
    for (texel, _) in texels(&atlas, 0) {
        let got = sums.irradiance(texel).unwrap().x;
        assert!((got / PI - 1.0).abs() < 2e-3, "{got}");
        let Some(back) = triangles.sides().back_of(texel) else {
            continue;
        };
        backs += 1;
        assert_eq!(triangles.sides().front_of(back), texel);
        let got = sums.irradiance(back).unwrap().x;
        assert!((got / (0.1 * PI) - 1.0).abs() < 4e-3, "{got}");
    }
    // Runs of 64 along rows of the page: those that hold these texels alone are seen by several lines each.
    assert_eq!(backs, 64);
}

#[test]
fn moments_say_where_light_comes_from() {
    let mut build = Build::default();
    build.rectangle(
        Vec3::ZERO,
        Vec3::Z * 2.0,
        Vec3::X * 2.0,
        Some([4, 4]),
        matt(0.5),
    );
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let triangles = Triangles::new(scene, &pose, &atlas);
    let sky = |towards: Vec3| Vec3::splat(f32::from(u8::from(towards.x > 0.0)));
    let sides = triangles.sides().count();
    let list = texels(&atlas, 0);
    // Directions are shared by all texels: only other seeds are independent.
    let run = |seed: u64| {
        let sums = Sums::new(sides, bundle::unit(1.0, 100)).with_moments(atlas.texels());
        bundle::gather(
            &triangles,
            &Radiance::new(sides, 1.0, |_| Vec3::ZERO),
            Some(&sky),
            &Directions { seed, round: 0 },
            0..100,
            &settings(),
            &Job::new(),
            &sums,
        );
        let moment = |(texel, _): &(u32, Vec2)| sums.moments()?.irradiance(*texel);
        let light = |(texel, _): &(u32, Vec2)| sums.irradiance(*texel);
        let count = list.len() as f32;
        let moment = list.iter().filter_map(moment).sum::<Vec3>() / count;
        let light = list.iter().filter_map(light).sum::<Vec3>() / count;
        moment.extend(light.x)
    };
    let runs: Vec<glam::Vec4> = (0..20).map(run).collect();
    // Half of an even sky: half its moment along the normal, 2/3 across; half its irradiance.
    for (k, expected) in [2.0 / 3.0, PI / 3.0, 0.0, 0.5 * PI].into_iter().enumerate() {
        let got = Estimate::of(runs.iter().map(|run| f64::from(run[k])));
        let error = got.variance.sqrt();
        // One false alarm in a thousand runs; an error of a fiftieth would be found.
        let p = got.same(&Estimate::exact(f64::from(expected)));
        assert!(
            p > 1e-3 / 4.0 && error < 0.01,
            "{k}: {} +- {error}, expected {expected}",
            got.mean
        );
    }
}

#[test]
fn blended_sheets_let_their_share_pass_and_mirrored_fronts_stay_fronts() {
    let mut build = Build::default();
    build.rectangle(
        Vec3::ZERO,
        Vec3::Z * 2.0,
        Vec3::X * 2.0,
        Some([8, 8]),
        matt(0.5),
    );
    let sheet = occlude_scene::Material {
        base_color: glam::Vec4::new(0.5, 0.5, 0.5, 0.3),
        alpha_mode: occlude_scene::AlphaMode::Blend,
        ..matt(0.5)
    };
    build.rectangle(Vec3::Y * 0.05, Vec3::Z * 2.0, Vec3::X * 2.0, None, sheet);
    // Its front is up as it stands, and down once it is mirrored.
    build.rectangle(
        Vec3::Y * -50.0,
        Vec3::Z * 2.0,
        Vec3::X * 2.0,
        Some([2, 2]),
        matt(0.5),
    );
    let (mut scene, atlas) = (build.scene.clone(), build.atlas());
    scene.instances[2].node_from_object = glam::Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let pose = Pose::at(&scene, 0.0);
    let triangles = Triangles::new(&scene, &pose, &atlas);
    let sky = |towards: Vec3| Vec3::splat(if towards.y > 0.0 { 1.0 } else { 0.1 });
    let (sums, _) = gather(&triangles, |_| Vec3::ZERO, Some(&sky), 0, 600, &settings());
    let mean = |instance: usize, inner: bool| {
        let list = texels(&atlas, instance);
        let list = list
            .iter()
            .filter(|t| !inner || (t.1 - 0.5).abs().max_element() < 0.3);
        let all: Vec<f32> = list.map(|t| sums.irradiance(t.0).unwrap().x).collect();
        all.iter().sum::<f32>() / all.len() as f32
    };
    // Three in ten lines end at the sheet, which is black here.
    let floor = mean(0, true);
    assert!((floor / (0.7 * PI) - 1.0).abs() < 0.015, "{floor}");
    let mirrored = mean(2, false);
    let upright = occlude_render::geometry::WorldTriangle::new(&scene, &pose, 2, 0)
        .front_cross()
        .y
        > 0.0;
    let expected = if upright { PI } else { 0.1 * PI };
    assert!(
        (mirrored / expected - 1.0).abs() < 0.02,
        "{mirrored} {expected}"
    );
}

#[test]
fn memory_layouts_and_lists_leave_no_trace() {
    let mut build = Build::default();
    build.room(Vec3::ZERO, Vec3::ONE, UNLIKE, &matt(0.5));
    for k in 0..30 {
        let at = Vec3::new(0.5, 0.03 * k as f32 + 0.02, 0.5);
        let turn = k as f32 * 0.7;
        let a = Vec3::new(turn.cos(), 0.2, turn.sin()) * 0.2;
        build.rectangle(at, a, a.cross(Vec3::Y), None, matt(0.3));
    }
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let mut triangles = Triangles::new(scene, &pose, &atlas);
    triangles.find_backs(0, &settings(), &Job::new());
    let light = |side: u32| Vec3::new(0.1, 0.5, 0.3) * (side % 7) as f32;
    // Tiles as for many nodes, done with hardly any: alpha makes the prediction too good.
    let run = |layout: bundle::Layout, nodes: u32, entries: u32| {
        let settings = Settings {
            layout,
            nodes,
            alpha: 2000.0 / nodes as f32,
            entries,
            ..settings()
        };
        let (sums, stats) = gather(&triangles, light, None, 0, 20, &settings);
        assert_eq!(stats.overflow_left, 0);
        let mut bytes = Vec::new();
        sums.write(&mut bytes).unwrap();
        (bytes, stats)
    };
    use bundle::Layout::{LinkedList, ScanScatter};
    let (expected, easy) = run(ScanScatter, 200_000, 1 << 20);
    assert_eq!(easy.overflow_detected, 0);
    for (layout, nodes, entries) in [
        (LinkedList, 200_000, 1 << 20),
        (LinkedList, 300, 1 << 20),
        (ScanScatter, 200, 1 << 20),
        // A single line may hold more than the buffer.
        (LinkedList, 4, 1 << 20),
        (ScanScatter, 200_000, 20),
    ] {
        let (bytes, stats) = run(layout, nodes, entries);
        assert_eq!(
            (stats.fragments, stats.pairs, stats.lines),
            (easy.fragments, easy.pairs, easy.lines),
            "{layout:?} {nodes}"
        );
        assert_eq!(
            stats.overflow_detected > 0,
            nodes < 1000,
            "{layout:?} {nodes}: {stats:?}"
        );
        assert!(bytes == expected, "{layout:?} {nodes} {entries}");
    }
    let dropping = Settings {
        layout: LinkedList,
        nodes: 300,
        alpha: 2000.0 / 300.0,
        recover: false,
        ..settings()
    };
    let (_, stats) = gather(&triangles, light, None, 0, 20, &dropping);
    assert_eq!(stats.fragments + stats.overflow_left, easy.fragments);
    assert!(stats.overflow_left > 0);
}

#[test]
fn energy_does_not_depend_on_the_memory_limit() {
    let mut build = Build::default();
    build.room(Vec3::ZERO, Vec3::new(3.0, 2.0, 2.5), UNLIKE, &matt(0.5));
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let triangles = Triangles::new(scene, &pose, &atlas);
    let lit: Vec<u32> = texels(&atlas, 3).iter().map(|t| t.0).collect();
    let light = |side: u32| Vec3::splat(f32::from(u8::from(lit.contains(&side))));
    let energies = [100, 2000, 1_000_000].map(|nodes| {
        let settings = Settings {
            nodes,
            ..settings()
        };
        let (sums, stats) = gather(&triangles, light, None, 0, 600, &settings);
        let all = (0..6).flat_map(|i| texels(&atlas, i));
        let sum: f32 = all.filter_map(|t| sums.irradiance(t.0)).map(|e| e.x).sum();
        (sum, stats.tiles)
    });
    assert!(
        energies[0].1 > 4 * energies[2].1,
        "tiles are to differ: {energies:?}"
    );
    for (energy, _) in energies {
        assert!((energy / energies[0].0 - 1.0).abs() < 4e-3, "{energies:?}");
    }
}

#[test]
fn threads_shards_and_order_leave_no_trace() {
    let mut build = Build::default();
    build.room(Vec3::ZERO, Vec3::ONE, UNLIKE, &matt(0.5));
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let triangles = Triangles::new(scene, &pose, &atlas);
    let sides = triangles.sides().count();
    let light = |side: u32| Vec3::new(0.1, 0.5, 0.3) * (side % 7) as f32;
    let run = |threads: usize, parts: &[std::ops::Range<u32>]| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let radiance = Radiance::new(sides, 3.0, light);
            let mut all = Sums::new(sides, bundle::unit(3.0, 12));
            for part in parts {
                let sums = Sums::new(sides, bundle::unit(3.0, 12));
                let directions = Directions { seed: 4, round: 1 };
                bundle::gather(
                    &triangles,
                    &radiance,
                    None,
                    &directions,
                    part.clone(),
                    &settings(),
                    &Job::new(),
                    &sums,
                );
                all.merge(&sums).unwrap();
            }
            let mut bytes = Vec::new();
            all.write(&mut bytes).unwrap();
            bytes
        })
    };
    let one = run(1, &[0..5, 5..12]);
    assert!(one == run(3, &[0..5, 5..12]), "threads");
    assert!(one == run(2, &[7..12, 0..3, 3..7]), "shards");
}

#[test]
fn bundles_agree_with_paths() {
    let (emission, albedo, bounces) = (Vec3::new(1.0, 0.5, 0.2), 0.6, 2);
    let mut build = Build::default();
    let walls = [[6, 8], [8, 12], [10, 4], [4, 6], [8, 8], [5, 5]];
    build.room(Vec3::ZERO, Vec3::new(2.0, 1.5, 1.8), walls, &matt(albedo));
    let lamp = occlude_scene::Material {
        emission,
        ..matt(albedo)
    };
    build.rectangle(
        Vec3::new(0.6, 1.3, 0.7),
        Vec3::X * 0.3,
        Vec3::Z * 0.4,
        Some([2, 2]),
        lamp,
    );
    // A leaf that stands in the way, seen from both sides.
    build.rectangle(
        Vec3::new(1.2, 0.5, 0.9),
        Vec3::new(0.3, 0.0, 0.3),
        Vec3::Y * 0.4,
        Some([8, 8]),
        matt(albedo),
    );
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let mut triangles = Triangles::new(scene, &pose, &atlas);
    triangles.find_backs(0, &settings(), &Job::new());
    let geometry = Geometry::new(scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(scene, &pose, None, LightSelection::Tree);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let sides = triangles.sides().count() as usize;
    let emits: Vec<u32> = texels(&atlas, 6).iter().map(|t| t.0).collect();
    // Blocks of texels: means over them, by seed.
    let list: Vec<Vec<u32>> = (0..8)
        .flat_map(|i| {
            let all: Vec<u32> = texels(&atlas, i).iter().map(|t| t.0).collect();
            let blocks: Vec<Vec<u32>> = all.chunks(16).map(<[u32]>::to_vec).collect();
            blocks
        })
        .collect();
    let (seeds, count) = (8, 250);
    let by_bundles: Vec<Vec<Vec3>> = (0..seeds)
        .map(|seed| {
            let mut total = vec![Vec3::ZERO; sides];
            let mut light = vec![Vec3::ZERO; sides];
            emits.iter().for_each(|&t| light[t as usize] = emission);
            for round in 0..=bounces {
                let directions = Directions { seed, round };
                let (sums, _) = gather_along(
                    &triangles,
                    |s| light[s as usize],
                    None,
                    &directions,
                    count,
                    &settings(),
                );
                for side in 0..sides {
                    let arrived = sums.irradiance(side as u32).unwrap_or(Vec3::ZERO);
                    total[side] += arrived;
                    light[side] = arrived * (albedo / PI);
                }
            }
            total
        })
        .collect();
    let by_paths: Vec<Vec<Vec3>> = (0..seeds)
        .map(|seed| {
            let settings = PathSettings {
                part: Part::All,
                bounces,
                luminous: true,
                reach: f32::INFINITY,
                seed,
                directional: false,
            };
            let mut samples = Vec::new();
            let each = 64;
            for instance in 0..8 {
                let size = atlas.layouts[instance].pieces[0].as_vec2();
                for (texel, middle) in texels(&atlas, instance) {
                    for number in 0..each {
                        let p = middle + (placement(seed, texel, number) - 0.5) / size;
                        let (primitive, u, v) = if p.x >= p.y {
                            (0, p.x - p.y, p.y)
                        } else {
                            (1, p.x, p.y - p.x)
                        };
                        samples.push(SurfaceSample {
                            point: Hit {
                                t: 0.0,
                                u,
                                v,
                                instance: instance as u32,
                                primitive,
                            },
                            number,
                            side: texel,
                            back: false,
                        });
                    }
                }
            }
            let mut irradiance = vec![Vec3::ZERO; samples.len()];
            let mut gatherer = Gatherer::default();
            gatherer.gather(&world, &settings, &samples, &mut irradiance);
            let mut total = vec![Vec3::ZERO; sides];
            for (sample, e) in samples.iter().zip(irradiance) {
                total[sample.side as usize] += e / each as f32;
            }
            total
        })
        .collect();
    let mut worst: f64 = 1.0;
    for block in &list {
        for channel in 0..3 {
            let estimate = |runs: &[Vec<Vec3>]| {
                Estimate::of(runs.iter().map(|run| {
                    let sum: f32 = block.iter().map(|&t| run[t as usize][channel]).sum();
                    f64::from(sum / block.len() as f32)
                }))
            };
            let (a, b) = (estimate(&by_bundles), estimate(&by_paths));
            let p = a.same(&b);
            assert!(
                (a.mean / b.mean - 1.0).abs() < 0.1,
                "bundles {} paths {}",
                a.mean,
                b.mean
            );
            worst = worst.min(p);
        }
    }
    println!("least probability {worst} of {} blocks", list.len());
    // Welch's test; Bonferroni over blocks and channels at one false alarm in a thousand runs.
    assert!(worst > 1e-3 / (3 * list.len()) as f64, "{worst}");
    let mean = |runs: &[Vec<Vec3>]| -> f32 {
        let of =
            |run: &Vec<Vec3>| -> f32 { list.iter().flatten().map(|&t| run[t as usize].x).sum() };
        runs.iter().map(of).sum()
    };
    let ratio = mean(&by_bundles) / mean(&by_paths);
    println!("energy {ratio}");
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}

#[test]
fn lines_pass_through_the_holes_of_masks() {
    let mut build = Build::default();
    build.rectangle(
        Vec3::ZERO,
        Vec3::Z * 2.0,
        Vec3::X * 2.0,
        Some([16, 16]),
        matt(0.5),
    );
    // A picture of two texels: the left one is a hole.
    let mask = occlude_scene::Material {
        base_color_texture: Some(occlude_scene::TextureRef {
            texture: 0,
            uv_set: 0,
            transform: glam::Affine2::IDENTITY,
        }),
        alpha_mode: occlude_scene::AlphaMode::Mask { cutoff: 0.5 },
        ..matt(0.5)
    };
    build.rectangle(Vec3::Y * 0.02, Vec3::Z * 2.0, Vec3::X * 2.0, None, mask);
    let nearest = occlude_scene::Sampler {
        filter: occlude_scene::Filter::Nearest,
        ..occlude_scene::Sampler::default()
    };
    build.scene.images.push(occlude_scene::Image {
        name: String::new(),
        width: 2,
        height: 1,
        texels: occlude_scene::Texels::Rgba8(vec![[255, 255, 255, 0], [255; 4]]),
    });
    build.scene.textures.push(occlude_scene::Texture {
        image: 0,
        sampler: nearest,
        srgb: true,
    });
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let mut triangles = Triangles::new(scene, &pose, &atlas);
    triangles.find_backs(0, &settings(), &Job::new());
    let sky = |towards: Vec3| Vec3::splat(f32::from(u8::from(towards.y > 0.0)));
    let (sums, _) = gather(&triangles, |_| Vec3::ZERO, Some(&sky), 0, 400, &settings());
    let mean = |open: bool| {
        let list = texels(&atlas, 0);
        // Away from the hole's rim and the sheet's.
        let list = list.iter().filter(|(_, at)| {
            (at.y - 0.5).abs() < 0.4 && (at.x - if open { 0.25 } else { 0.75 }).abs() < 0.15
        });
        let all: Vec<f32> = list.map(|t| sums.irradiance(t.0).unwrap().x).collect();
        all.iter().sum::<f32>() / all.len() as f32
    };
    assert!((mean(true) / PI - 1.0).abs() < 0.02, "{}", mean(true));
    assert!(mean(false) < 0.02, "{}", mean(false));
}

#[test]
fn tiny_charts_do_not_cost_lines_for_all_behind_them() {
    // A room whose walls have 16 texels a metre, and a screw in it of a square millimetre with as many texels as a wall of a square metre.
    let mut build = Build::default();
    build.room(Vec3::ZERO, Vec3::ONE, [[16, 16]; 6], &matt(0.5));
    let plain = build.atlas();
    let small = Vec3::new(5e-4, 0.0, 0.0);
    build.rectangle(
        Vec3::splat(0.5),
        small,
        Vec3::new(0.0, 5e-4, 0.0),
        Some([16, 16]),
        matt(0.5),
    );
    let mut atlas = build.atlas();
    for layout in &mut atlas.layouts {
        layout.texels_per_metre = 16.0;
    }
    let pose = Pose::at(&build.scene, 0.0);
    let lines = |atlas: &occlude_bake::atlas::Atlas, settings: &Settings| {
        let triangles = Triangles::new(&build.scene, &pose, atlas);
        let lit = |_| Vec3::ONE;
        let (sums, stats) = gather(&triangles, lit, None, 0, 200, settings);
        (sums, stats.lines as f64 / 200.0)
    };
    let (_, without) = lines(&plain, &settings());
    let (sums, with) = lines(&atlas, &settings());
    assert!(with < 2.0 * without, "{with} lines instead of {without}");
    // Fewer lines are no bias: everything sees radiance 1 everywhere.
    for (texel, _) in (0..7).flat_map(|i| texels(&atlas, i)) {
        let Some(got) = sums.irradiance(texel) else {
            continue;
        };
        assert!(
            (got / PI - 1.0).abs().max_element() < 4e-3,
            "{texel}: {got}"
        );
    }
}
