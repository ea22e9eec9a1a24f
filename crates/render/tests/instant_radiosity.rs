//! Instant radiosity against closed forms, stored brute force and the path tracer.

mod support;

use glam::Vec3;
use occlude_render::film::Film;
use occlude_render::integrator::{InstantRadiosity, Integrator, PathLimits};
use occlude_scene::{Light, LightKind, Node, Scene};
use occlude_testkit::picture::Picture;
use support::{Setup, brute, cornell, film, furnace, picture, white_box_in_white_sky};

/// Probability that one of these tests fails although the program is right, each.
const FALSE_ALARM: f64 = 1e-4;

fn instant(max_depth: u32, vpls: u32, clamp: Option<f32>, compensate: bool) -> Setup {
    Setup {
        integrator: Integrator::InstantRadiosity(InstantRadiosity {
            max_depth,
            vpls,
            clamp,
            compensate,
        }),
        samples: 8,
        ..Setup::default()
    }
}

fn path(max_depth: u32) -> Setup {
    Setup {
        integrator: Integrator::Path(PathLimits::new(max_depth)),
        samples: 64,
        seed: 1000,
        ..Setup::default()
    }
}

/// The mean over the picture: finds small errors that are everywhere.
fn whole(picture: &Picture) -> Picture {
    picture.blocks(16)
}

/// A Cornell box with every kind of light without extent.
fn lamps(count: usize) -> Scene {
    let mut scene = cornell();
    for material in &mut scene.materials {
        material.emission = Vec3::ZERO;
    }
    let bounds = scene.meshes.iter().flat_map(|m| &m.positions);
    let (low, high) = bounds.fold((Vec3::MAX, Vec3::MIN), |(l, h), &p| (l.min(p), h.max(p)));
    for i in 0..count {
        let x = (i as f32 + 0.5) / count as f32;
        let at = low + (high - low) * Vec3::new(0.1 + 0.8 * x, 0.8, 0.3 + 0.5 * (7.0 * x).fract());
        let kind = match i % 3 {
            0 => LightKind::Point,
            1 => LightKind::Spot {
                inner_angle: 0.4,
                outer_angle: 0.9,
            },
            _ => LightKind::Directional {
                angular_diameter: if i % 2 == 0 { 0.0 } else { 0.1 },
            },
        };
        let down =
            glam::Quat::from_rotation_arc(Vec3::NEG_Z, Vec3::new(0.3, -0.8, -0.5).normalize());
        scene.nodes.push(Node {
            name: String::new(),
            parent: None,
            parent_from_node: glam::Affine3A::from_rotation_translation(down, at),
        });
        scene.lights.push(Light {
            name: String::new(),
            node: scene.nodes.len() as u32 - 1,
            intensity: Vec3::new(1.0, 0.8, 0.5) / count as f32,
            kind,
        });
    }
    scene
}

/// Few lights without extent are shared by all eye samples, many are drawn by the light tree.
#[test]
fn direct_light_is_the_path_tracers() {
    let mut plastic = lamps(7);
    for material in &mut plastic.materials {
        (material.specular, material.roughness) = (1.0, 0.5);
    }
    let scenes = [
        ("cornell", cornell()),
        ("furnace", furnace()),
        ("sky", white_box_in_white_sky()),
        ("few-lamps", lamps(7)),
        ("many-lamps", lamps(300)),
        ("plastic", plastic),
    ];
    for (name, scene) in scenes {
        for max_depth in [0, 1] {
            let found = picture(&scene, &instant(max_depth, 64, None, false), 12);
            let same_samples = Setup {
                samples: 8,
                seed: 0,
                ..path(max_depth)
            };
            let expected = picture(&scene, &same_samples, 12);
            let name = format!("instant-direct-{name}-{max_depth}");
            whole(&found).assert_same(&whole(&expected), FALSE_ALARM, &format!("{name}-mean"));
            // The sky is one set of directions for the whole picture: its pixels err together.
            if name != "sky" {
                found.assert_same(&expected, FALSE_ALARM, &name);
            }
        }
    }
}

/// Base colour and emission are both one half, so that `n` scattering events bring `1 - 2^-(n+1)`.
#[test]
fn closed_room_has_its_radiance_at_every_depth() {
    let scene = furnace();
    for max_depth in [2, 3, 40] {
        let expected = 1.0 - 0.5f64.powi(max_depth as i32 + 1);
        let expected = Picture::constant(16, 16, &[expected; 3]);
        for (name, setup) in [
            (
                "unbounded",
                instant(max_depth, 512, Some(f32::INFINITY), false),
            ),
            ("compensated", instant(max_depth, 64, None, true)),
        ] {
            let name = format!("instant-furnace-{name}-{max_depth}");
            let found = picture(&scene, &setup, 16);
            whole(&found).assert_same(&whole(&expected), FALSE_ALARM, &name);
        }
    }
}

#[test]
fn agrees_with_stored_brute_force() {
    let mut sky = cornell();
    sky.sky = Vec3::new(0.5, 0.7, 1.0);
    for (name, scene, max_depth) in [
        ("cornell-direct", cornell(), 1),
        ("cornell-indirect", cornell(), 6),
        ("cornell-sky", sky, 3),
    ] {
        let reference = brute::load(name, (16, 16), 100_000);
        for (kind, setup) in [
            (
                "unbounded",
                instant(max_depth, 512, Some(f32::INFINITY), false),
            ),
            ("compensated", instant(max_depth, 128, None, true)),
        ] {
            let name = format!("instant-{name}-{kind}");
            let found = picture(&scene, &setup, 16);
            whole(&found).assert_same(&whole(&reference), FALSE_ALARM, &name);
        }
    }
}

/// The bound costs energy, the report says how much, and compensation brings it back.
#[test]
fn clamped_energy_is_reported_and_returned() {
    let scene = cornell();
    let sum = |film: &Film| {
        film.develop()
            .radiance
            .iter()
            .flatten()
            .map(|&v| f64::from(v))
            .sum::<f64>()
    };
    let clamp = Some(0.5);
    let (unbounded, report) = film(&scene, &instant(6, 256, Some(f32::INFINITY), false));
    let report = report.instant_radiosity.unwrap();
    assert!(report.vpls > 128 && report.vpls <= 256);
    assert_eq!(report.clamped_energy, 0.0);
    // The bound changes how lights are chosen, so energies agree on average over the choice only; what is taken does so exactly.
    let (bounded, report) = film(&scene, &instant(6, 256, clamp, false));
    let clamped = report.instant_radiosity.unwrap().clamped_energy;
    let missing = sum(&unbounded) / sum(&bounded) - 1.0;
    assert!(
        clamped > 0.01 && (missing - clamped).abs() < 0.3 * clamped + 0.01,
        "{clamped} clamped, {missing} missing"
    );
    let compensated = picture(&scene, &instant(6, 256, clamp, true), 12);
    let expected = brute::load("cornell-indirect", (16, 16), 100_000);
    whole(&compensated).assert_same(&whole(&expected), FALSE_ALARM, "instant-compensated");
}

/// Threads, parts and strategies that claim to be exact leave no trace: equal bytes.
#[test]
fn threads_parts_and_exact_strategies_give_equal_bytes() {
    let setup = Setup {
        size: (70, 45),
        samples: 20,
        ..instant(4, 100, None, true)
    };
    let scene = cornell();
    let (expected, report) = film(&scene, &setup);
    assert_eq!(report.visibility.traced, report.visibility.queries);
    for (occluder, threads) in [(false, 1), (true, 2), (false, 3)] {
        let (film, _) = film(
            &scene,
            &Setup {
                occluder,
                threads,
                ..setup
            },
        );
        assert!(film == expected, "occluder {occluder}, {threads} threads");
    }
    let (other, _) = film(&scene, &Setup { seed: 1, ..setup });
    assert!(other != expected, "the seed does nothing");
}
