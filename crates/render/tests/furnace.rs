//! Scenes whose radiance is known in closed form, through every integrator, sampler, light selection and strategy.

mod support;

use occlude_render::integrator::{Integrator, PathLimits};
use occlude_render::light::LightSelection;
use occlude_render::sampling::SamplerKind;
use occlude_testkit::picture::Picture;
use support::{Setup, film, furnace, picture, white_box_in_white_sky};

/// Probability that one of these tests fails although the program is right, each.
const FALSE_ALARM: f64 = 1e-4;

fn grey(radiance: f64) -> Picture {
    Picture::constant(16, 16, &[radiance; 3])
}

/// Base colour and emission are both one half, so that `n` scattering events bring `1 - 2^-(n+1)`. The path tracer's
/// largest depth stands for infinity: what is missing is 2^-65.
#[test]
fn closed_room_has_its_radiance_at_every_depth() {
    let scene = furnace();
    for max_depth in [0, 1, 2, 5, 64] {
        let setup = Setup {
            integrator: Integrator::Path(PathLimits::new(max_depth)),
            ..Setup::default()
        };
        let expected = 1.0 - 0.5f64.powi(max_depth as i32 + 1);
        picture(&scene, &setup, 12).assert_same(
            &grey(expected),
            FALSE_ALARM,
            &format!("furnace-depth-{max_depth}"),
        );
    }
}

#[test]
fn closed_room_has_radiance_one_however_it_is_sampled() {
    let scene = furnace();
    for sampler in [SamplerKind::Sobol, SamplerKind::Independent] {
        for selection in [
            LightSelection::Uniform,
            LightSelection::Power,
            LightSelection::Tree,
        ] {
            for occluder in [false, true] {
                let setup = Setup {
                    sampler,
                    selection,
                    occluder,
                    ..Setup::default()
                };
                let name = format!("furnace-{sampler:?}-{selection:?}-{occluder}");
                picture(&scene, &setup, 10).assert_same(&grey(1.0), FALSE_ALARM, &name);
            }
        }
    }
}

/// Sky sampling, escape of paths and their weights: a white surface under a white sky is white.
#[test]
fn white_box_under_white_sky_is_white() {
    let scene = white_box_in_white_sky();
    for sampler in [SamplerKind::Sobol, SamplerKind::Independent] {
        for occluder in [false, true] {
            let integrator = Integrator::Path(PathLimits::new(1000));
            let setup = Setup {
                sampler,
                occluder,
                integrator,
                ..Setup::default()
            };
            let name = format!("white-box-{sampler:?}-{occluder}");
            picture(&scene, &setup, 12).assert_same(&grey(1.0), FALSE_ALARM, &name);
        }
    }
}

/// A closed room is dark to ambient occlusion that sees far, and open to one that sees not at all.
#[test]
fn ambient_occlusion_of_a_closed_room() {
    let scene = furnace();
    for (distance, expected) in [(f32::INFINITY, 0.0), (1e-6, 1.0)] {
        for occluder in [false, true] {
            let integrator = Integrator::AmbientOcclusion { distance };
            let setup = Setup {
                integrator,
                occluder,
                ..Setup::default()
            };
            let (film, _) = film(&scene, &setup);
            let values = film.develop().radiance.concat();
            let wrong = values
                .iter()
                .filter(|&&v| (f64::from(v) - expected).abs() > 1e-6)
                .count();
            // A hemisphere that touches another wall within a micrometre, or a ray through an edge.
            assert!(
                wrong <= values.len() / 200,
                "distance {distance}: {wrong} of {}",
                values.len()
            );
        }
    }
}
