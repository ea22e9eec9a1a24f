//! Ray bundles against closed forms.

mod support;

use glam::{Vec2, Vec3};
use occlude_bake::bundle::{self, Directions, Radiance, Settings, Stats, Triangles};
use occlude_bake::sums::Sums;
use occlude_render::job::Job;
use occlude_scene::Pose;
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
    let sides = triangles.sides().count();
    let brightest = (0..sides).fold(0.0_f32, |m, side| m.max(light(side).max_element()));
    let brightest = brightest.max(sky.map_or(0.0, |sky| sky(Vec3::Y).max_element()));
    let sums = Sums::new(sides, bundle::unit(brightest, count));
    let radiance = Radiance::new(sides, brightest, light);
    let directions = Directions { seed: 1, round };
    let stats = bundle::gather(
        triangles,
        &radiance,
        sky,
        &directions,
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
    let triangles = Triangles::new(scene, &pose, &atlas);
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
    let count = 1500;
    let (sums, stats) = gather(&triangles, light, None, 0, count, &settings());
    assert!(
        stats.tiles > 10 * u64::from(count),
        "tiles are to differ: {stats:?}"
    );
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
        let (mut mean, mut expected, mut square) = (0.0, 0.0, 0.0);
        for &(texel, place) in &list {
            let got = sums.irradiance(texel).unwrap().x;
            // The mean over the texel: its middle, or more points where texels are large.
            let fine = (24.0 / size.min_element()).clamp(1.0, 16.0) as u32;
            let mut exact = 0.0;
            for i in 0..fine * fine {
                let inside = Vec2::new((i % fine) as f32, (i / fine) as f32) + 0.5;
                let place = place + (inside / fine as f32 - 0.5) / size;
                let at = c + u * (2.0 * place.x - 1.0) + v * (2.0 * place.y - 1.0);
                exact += from_rectangle(at, normal, center, a, b) / (fine * fine) as f32;
            }
            mean += got / list.len() as f32;
            expected += exact / list.len() as f32;
            square += (got - exact).powi(2) / list.len() as f32;
        }
        println!("wall {instance}: {mean} {expected} rms {}", square.sqrt());
        assert!(
            (mean / expected - 1.0).abs() < 0.006,
            "wall {instance}: mean {mean}, expected {expected}"
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
    build.rectangle(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X, Some([8, 4]), matt(0.5));
    let (scene, atlas) = (&build.scene, build.atlas());
    let pose = Pose::at(scene, 0.0);
    let triangles = Triangles::new(scene, &pose, &atlas);
    // Bright above, dark below: the front gets pi, the back a tenth.
    let sky = |towards: Vec3| Vec3::splat(if towards.y > 0.0 { 1.0 } else { 0.1 });
    let (sums, _) = gather(&triangles, |_| Vec3::ZERO, Some(&sky), 0, 200, &settings());
    for (texel, _) in texels(&atlas, 0) {
        let got = sums.irradiance(texel).unwrap().x;
        assert!((got / PI - 1.0).abs() < 2e-3, "{got}");
        let back = triangles.sides().back_of(texel).unwrap();
        assert_eq!(triangles.sides().front_of(back), texel);
        let got = sums.irradiance(back).unwrap().x;
        assert!((got / (0.1 * PI) - 1.0).abs() < 4e-3, "{got}");
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
