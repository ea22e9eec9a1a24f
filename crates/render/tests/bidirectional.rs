//! Bidirectional path tracing: against the path tracer, against closed forms, and against itself.

mod support;

use occlude_render::camera::PixelFilter;
use occlude_render::film::Film;
use occlude_render::integrator::{BidirectionalLimits, Integrator, PathLimits, Techniques};
use occlude_render::light::LightSelection;
use occlude_render::sampling::SamplerKind;
use occlude_scene::{Projection, Scene};
use occlude_testkit::picture::Picture;
use support::{Setup, cornell, film, furnace, picture, scenes, white_box_in_white_sky};

/// Probability that one of these tests fails although the program is right, each.
const FALSE_ALARM: f64 = 1e-4;

fn all(max_depth: u32) -> Integrator {
    Integrator::Bidirectional(BidirectionalLimits::new(max_depth))
}

fn only(max_depth: u32, light: u32, camera: u32) -> Integrator {
    Integrator::Bidirectional(BidirectionalLimits {
        max_depth,
        techniques: Techniques::Only { light, camera },
    })
}

fn grey(radiance: f64) -> Picture {
    Picture::constant(16, 16, &[radiance; 3])
}

/// Pixels, blocks and the whole picture are the same.
fn same(scene: &Scene, a: &Setup, b: &Setup, name: &str) {
    let (found, expected) = (picture(scene, a, 12), picture(scene, b, 12));
    let whole = (found.blocks(16), expected.blocks(16));
    found.assert_same(&expected, FALSE_ALARM, name);
    whole
        .0
        .assert_same(&whole.1, FALSE_ALARM, &format!("{name}-mean"));
}

fn equals_path_tracing(scene: &Scene, max_depth: u32, samples: [u32; 2], name: &str) {
    let setup = |integrator, samples, seed| Setup {
        integrator,
        samples,
        seed,
        ..Setup::default()
    };
    let path = setup(
        Integrator::Path(PathLimits::new(max_depth)),
        samples[1],
        500,
    );
    same(scene, &setup(all(max_depth), samples[0], 0), &path, name);
}

#[test]
fn equals_path_tracing_in_the_cornell_box() {
    for max_depth in [0, 1, 6] {
        let name = format!("bidirectional-cornell-{max_depth}");
        equals_path_tracing(&cornell(), max_depth, [32, 64], &name);
    }
}

#[test]
fn equals_path_tracing_through_glass_and_mirrors() {
    equals_path_tracing(&scenes::caustics(), 6, [32, 256], "bidirectional-caustics");
}

#[test]
fn equals_path_tracing_under_all_kinds_of_lights() {
    let near = Projection::Perspective { yfov: 0.7 };
    let far = Projection::Orthographic { ymag: 1.5 };
    for (projection, name) in [(near, "near"), (far, "far")] {
        let name = format!("bidirectional-lights-{name}");
        equals_path_tracing(&scenes::lights(projection), 4, [32, 64], &name);
    }
}

#[test]
fn equals_path_tracing_behind_panes_and_cloth() {
    equals_path_tracing(&scenes::windows(), 4, [32, 128], "bidirectional-windows");
}

/// Base colour and emission are both one half, so that `n` scattering events bring `1 - 2^-(n+1)`.
#[test]
fn closed_room_has_its_radiance() {
    let scene = furnace();
    for sampler in [SamplerKind::Sobol, SamplerKind::Independent] {
        for (max_depth, selection) in [
            (0, LightSelection::Tree),
            (1, LightSelection::Power),
            (2, LightSelection::Uniform),
            (5, LightSelection::Tree),
        ] {
            let setup = Setup {
                integrator: all(max_depth),
                sampler,
                selection,
                ..Setup::default()
            };
            let expected = 1.0 - 0.5f64.powi(max_depth as i32 + 1);
            let name = format!("bidirectional-furnace-{sampler:?}-{max_depth}");
            picture(&scene, &setup, 12).assert_same(&grey(expected), FALSE_ALARM, &name);
        }
    }
}

/// Light that falls anywhere is spread by the pixel filter, up to the edge of the picture and over it.
#[test]
fn light_tracing_fills_every_filter() {
    let scene = furnace();
    for filter in [PixelFilter::Box, PixelFilter::Tent, PixelFilter::Gaussian] {
        for (integrator, expected) in [(only(2, 3, 1), 0.125), (all(2), 0.875)] {
            let setup = Setup {
                integrator,
                filter,
                ..Setup::default()
            };
            let name = format!("bidirectional-{filter:?}-{expected}");
            picture(&scene, &setup, 12).assert_same(&grey(expected), FALSE_ALARM, &name);
        }
    }
}

#[test]
fn white_box_under_white_sky_is_white() {
    let setup = Setup {
        integrator: all(1000),
        ..Setup::default()
    };
    let scene = white_box_in_white_sky();
    picture(&scene, &setup, 12).assert_same(&grey(1.0), FALSE_ALARM, "bidirectional-white-box");
}

/// Each strategy that can find all paths of a length finds what the path tracer finds of that length: unweighted.
#[test]
fn every_strategy_alone_finds_all_light_of_its_path_length() {
    let scene = scenes::apart();
    let setup = |integrator, samples, seed| Setup {
        integrator,
        samples,
        seed,
        ..Setup::default()
    };
    for events in 1..=3u32 {
        // Light sampling is the reference: the path tracer has it too, and `equals_path_tracing` tests it.
        let reference = setup(only(events, 1, events + 1), 24, 900);
        for light in (0..=events + 1).filter(|&light| light != 1) {
            // Hits by chance are rare: with few samples a pixel's mean is far from normal, and the test wrong.
            let samples = if light == 0 { 192 } else { 24 };
            let found = setup(only(events, light, events + 2 - light), samples, 0);
            let name = format!("strategy-{light}-{}", events + 2 - light);
            same(&scene, &found, &reference, &name);
        }
    }
}

fn bytes(film: &Film) -> Vec<u8> {
    let mut bytes = Vec::new();
    film.write(&0, &[], &mut bytes).unwrap();
    bytes
}

#[test]
fn threads_strategies_and_shards_give_equal_bytes() {
    let scene = scenes::caustics();
    let setup = Setup {
        integrator: all(5),
        size: (40, 33),
        samples: 9,
        ..Setup::default()
    };
    let (whole, report) = film(&scene, &setup);
    assert_eq!(report.visibility.traced, report.visibility.queries);
    for (occluder, threads) in [(false, 1), (true, 2), (true, 3)] {
        let other = Setup {
            occluder,
            threads,
            ..setup
        };
        assert!(bytes(&film(&scene, &other).0) == bytes(&whole));
    }
    let parts = [(0, 4), (4, 9)].map(|(first, samples)| {
        let part = Setup {
            first,
            samples,
            ..setup
        };
        film(&scene, &part).0
    });
    let [mut merged, second] = parts;
    merged.merge(&second);
    assert!(bytes(&merged) == bytes(&whole));
    assert!(bytes(&film(&scene, &Setup { seed: 1, ..setup }).0) != bytes(&whole));
}
