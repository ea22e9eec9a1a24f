//! Whole pictures: against brute force, and against themselves with other means.

mod support;

use occlude_render::integrator::{Integrator, PathLimits};
use occlude_render::light::LightSelection;
use occlude_render::sampling::SamplerKind;
use occlude_scene::Scene;
use occlude_testkit::estimate::Estimate;
use occlude_testkit::picture::Picture;
use support::{Setup, brute, cornell, film, furnace, picture};

const FALSE_ALARM: f64 = 1e-4;

/// Stored references: name, scene, scattering events. Made by `make_references`, see there.
fn references() -> Vec<(&'static str, Scene, u32)> {
    let mut sky = cornell();
    sky.sky = glam::Vec3::new(0.5, 0.7, 1.0);
    vec![
        ("cornell-direct", cornell(), 1),
        ("cornell-indirect", cornell(), 6),
        ("cornell-sky", sky, 3),
    ]
}

const REFERENCE_SIZE: (u32, u32) = (16, 16);
const REFERENCE_SAMPLES: u32 = 100_000;

/// Renders the references again: `cargo test --release -p occlude-render --test pictures -- --ignored` (minutes).
#[test]
#[ignore = "writes into the source tree; run it when a reference scene changes"]
fn make_references() {
    for (name, scene, max_depth) in references() {
        let (mean, variance) = brute::render(&scene, REFERENCE_SIZE, REFERENCE_SAMPLES, max_depth);
        brute::store(name, &mean, &variance);
    }
}

#[test]
fn path_tracer_agrees_with_stored_brute_force() {
    for (name, scene, max_depth) in references() {
        let reference = brute::load(name, REFERENCE_SIZE, REFERENCE_SAMPLES);
        for selection in [LightSelection::Uniform, LightSelection::Tree] {
            let integrator = Integrator::Path(PathLimits::new(max_depth));
            let setup = Setup {
                integrator,
                selection,
                size: REFERENCE_SIZE,
                samples: 64,
                ..Setup::default()
            };
            let found = picture(&scene, &setup, 12);
            let name = format!("{name}-{selection:?}");
            found.assert_same(&reference, FALSE_ALARM, &name);
            whole(&found).assert_same(&whole(&reference), FALSE_ALARM, &format!("{name}-mean"));
        }
    }
}

/// The mean over the picture: finds small errors that are everywhere.
fn whole(picture: &Picture) -> Picture {
    picture.blocks(REFERENCE_SIZE.0 as usize)
}

/// The test above can fail: a lamp two percent brighter is found out.
#[test]
fn stored_references_find_small_errors() {
    let (name, mut scene, max_depth) = references().swap_remove(1);
    for material in &mut scene.materials {
        material.emission *= 1.02;
    }
    let reference = brute::load(name, REFERENCE_SIZE, REFERENCE_SAMPLES);
    let integrator = Integrator::Path(PathLimits::new(max_depth));
    let setup = Setup {
        integrator,
        size: REFERENCE_SIZE,
        samples: 64,
        ..Setup::default()
    };
    assert!(
        whole(&picture(&scene, &setup, 12))
            .test(&whole(&reference), FALSE_ALARM)
            .is_err()
    );
}

#[test]
fn samplers_agree() {
    let scene = cornell();
    let integrator = Integrator::Path(PathLimits::new(4));
    let setup = |sampler| Setup {
        integrator,
        sampler,
        samples: 64,
        ..Setup::default()
    };
    let independent = picture(
        &scene,
        &Setup {
            seed: 1000,
            ..setup(SamplerKind::Independent)
        },
        12,
    );
    picture(&scene, &setup(SamplerKind::Sobol), 12).assert_same(
        &independent,
        FALSE_ALARM,
        "samplers",
    );
}

/// Strategies that claim to be exact, and numbers of threads, leave no trace: equal bytes.
#[test]
fn exact_strategies_and_threads_give_equal_bytes() {
    for scene in [cornell(), furnace()] {
        let integrators = [
            Integrator::Path(PathLimits::new(6)),
            Integrator::AmbientOcclusion { distance: 0.2 },
        ];
        for integrator in integrators {
            let setup = Setup {
                integrator,
                size: (40, 33),
                samples: 9,
                ..Setup::default()
            };
            let (expected, report) = film(&scene, &setup);
            assert_eq!(report.visibility.traced, report.visibility.queries);
            for (occluder, threads) in [(false, 1), (true, 1), (true, 2), (true, 3)] {
                let (film, report) = film(
                    &scene,
                    &Setup {
                        occluder,
                        threads,
                        ..setup
                    },
                );
                assert!(
                    film == expected,
                    "{integrator:?}, occluder {occluder}, {threads} threads"
                );
                let stats = report.visibility;
                assert_eq!(stats.queries, stats.answered + stats.traced);
                assert!(!occluder || stats.answered > 0);
            }
            assert!(
                film(&scene, &Setup { seed: 1, ..setup }).0 != expected,
                "the seed does nothing"
            );
        }
    }
}

/// The variance that the film reports is the variance that other seeds show (independent samples: Sobol points do better).
#[test]
fn film_knows_its_variance() {
    let scene = cornell();
    let integrator = Integrator::Path(PathLimits::new(3));
    let runs: Vec<_> = (0..48)
        .map(|seed| {
            let sampler = SamplerKind::Independent;
            film(
                &scene,
                &Setup {
                    seed,
                    integrator,
                    sampler,
                    samples: 16,
                    ..Setup::default()
                },
            )
            .0
            .develop()
        })
        .collect();
    let luminance = |p: [f32; 3]| f64::from(0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]);
    let difference = |pixel: usize| {
        let seen = Estimate::of(runs.iter().map(|run| luminance(run.radiance[pixel])));
        let said = Estimate::of(runs.iter().map(|run| f64::from(run.variance[pixel])));
        let scale = said.mean.max(f64::MIN_POSITIVE);
        (seen.variance * seen.samples - said.mean) / scale
    };
    // Pixels that see the lamp alone vary not at all, and so tell nothing.
    let noisy = (0..256).filter(|&pixel| runs.iter().all(|run| run.variance[pixel] > 0.0));
    let mean = Estimate::of(noisy.map(difference));
    assert!(mean.samples > 100.0);
    assert!(
        mean.same(&Estimate::exact(0.0)) > FALSE_ALARM && mean.variance.sqrt() < 0.05,
        "{mean:?}"
    );
}
