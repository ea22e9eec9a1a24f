//! What leaves the lights: densities against histograms, flux against closed forms.

use super::*;
use crate::light::tests::{Random, punctual, scene_of, square};
use crate::light::{Environment, LightSelection};
use occlude_image::Picture;
use occlude_scene::LightKind;
use occlude_testkit::chi2::{SphereGrid, chi2_test};
use occlude_testkit::distribution::sidak;
use occlude_testkit::estimate::Estimate;

/// Probability that one of these tests fails although the program is right, each.
const FALSE_ALARM: f64 = 1e-4;

/// A sky with a bright patch, which is turned so that rows are no symmetry.
fn sky() -> Environment {
    let (width, height) = (16, 8);
    let pixels = (0..width * height)
        .map(|i| {
            [if i == 37 {
                40.0
            } else {
                0.2 + (i % 5) as f32 * 0.1
            }; 3]
        })
        .collect();
    let picture = Picture {
        width,
        height,
        pixels,
    };
    Environment::from_picture(&picture, 0.7, 1.0)
}

/// One light of every kind, each alone, with the power that it emits in grey.
fn cases() -> Vec<(&'static str, Scene, Pose, Option<Environment>, f64)> {
    let box_of = |emission, double_sided| {
        let triangles = square(
            Vec3::new(1.0, 2.0, 0.5),
            Vec3::new(0.3, -1.0, 0.2).normalize(),
            0.5,
        );
        scene_of(vec![(triangles, emission, double_sided)])
    };
    let pi = std::f64::consts::PI;
    // Half the diagonal of the box around the square.
    let disk = |scene: &Scene, pose: &Pose| {
        let (_, radius) = bounding_sphere(scene, pose);
        pi * f64::from(radius).powi(2) * 1.0001f64.powi(2)
    };
    let mut cases = Vec::new();
    let (scene, pose) = box_of(Vec3::splat(2.0), false);
    cases.push(("one side", scene, pose, None, 2.0 * pi));
    let (scene, pose) = box_of(Vec3::splat(2.0), true);
    cases.push(("two sides", scene, pose, None, 4.0 * pi));
    let lamp = |kind, intensity: f32| {
        let (scene, mut pose) = box_of(Vec3::ZERO, false);
        let direction = Vec3::new(0.4, -0.8, 0.3).normalize();
        pose.lights
            .push(punctual(kind, Vec3::splat(intensity), Vec3::ONE, direction));
        (scene, pose)
    };
    let (scene, pose) = lamp(LightKind::Point, 3.0);
    cases.push(("point", scene, pose, None, 12.0 * pi));
    let (inner_angle, outer_angle) = (0.3f32, 0.9f32);
    let (scene, pose) = lamp(
        LightKind::Spot {
            inner_angle,
            outer_angle,
        },
        3.0,
    );
    let (inner, outer) = (f64::from(inner_angle).cos(), f64::from(outer_angle).cos());
    let spot = 3.0 * 2.0 * pi * ((1.0 - inner) + (inner - outer) / 3.0);
    cases.push(("spot", scene, pose, None, spot));
    for (name, angular_diameter) in [("direction", 0.0), ("sun", 0.4)] {
        let (scene, pose) = lamp(LightKind::Directional { angular_diameter }, 3.0);
        // Irradiance on a facing surface is the flux through a disk across the middle of the sun, not across each of its rays.
        let radius = f64::from(0.5 * angular_diameter);
        let slant = if radius > 0.0 {
            2.0 * (1.0 - radius.cos()) / radius.sin().powi(2)
        } else {
            1.0
        };
        let power = 3.0 * slant * disk(&scene, &pose);
        cases.push((name, scene, pose, None, power));
    }
    let (scene, pose) = box_of(Vec3::ZERO, false);
    let power = f64::from(sky().integral().x) * disk(&scene, &pose);
    cases.push(("sky", scene, pose, Some(sky()), power));
    cases
}

fn emitted(case: usize) -> (&'static str, Lights, Emission, Scene, f64) {
    let (name, scene, pose, environment, power) = cases().swap_remove(case);
    let lights = Lights::new(&scene, &pose, environment, LightSelection::Tree);
    let emission = Emission::new(&lights, &scene, &pose);
    (name, lights, emission, scene, power)
}

fn sample(
    emission: &Emission,
    lights: &Lights,
    scene: &Scene,
    random: &mut Random,
) -> Option<Emitted> {
    let pick = random.unit();
    emission.sample(lights, scene, pick, random.pair(), random.pair())
}

#[test]
fn flux_is_the_power_of_the_light() {
    for case in 0..cases().len() {
        let (name, lights, emission, scene, power) = emitted(case);
        let mut random = Random(case as u64);
        let flux = Estimate::of((0..20_000).map(|_| {
            let emitted = sample(&emission, &lights, &scene, &mut random);
            emitted.map_or(0.0, |emitted| f64::from(emitted.flux.x))
        }));
        let expected = Estimate::exact(power);
        // The bounding sphere and the lights are in single precision.
        let close = (flux.mean / power - 1.0).abs() < 1e-3;
        assert!(
            close || flux.same(&expected) > sidak(FALSE_ALARM, 7),
            "{name}: {flux:?} {power}"
        );
    }
}

/// Directions of a light at a place: histogram against `spread`; of the sky: against `start`.
#[test]
fn directions_have_the_density_that_is_stated() {
    let pole = Vec3::new(0.4, -0.8, 0.3).normalize().as_dvec3().to_array();
    for case in 0..cases().len() {
        let (name, lights, emission, scene, _) = emitted(case);
        if name == "direction" {
            continue;
        }
        let grid = SphereGrid {
            pole,
            concentration: if name == "sun" { 3 } else { 1 },
            ..SphereGrid::default()
        };
        let mut random = Random(50 + case as u64);
        let origin = sample(&emission, &lights, &scene, &mut random)
            .unwrap()
            .origin;
        let sky = matches!(origin, Origin::Sky(_));
        let flip = if sky { -1.0 } else { 1.0 };
        let result = grid.test(
            40_000,
            &mut |_| {
                let direction = sample(&emission, &lights, &scene, &mut random)?
                    .ray
                    .direction;
                Some(direction.as_dvec3().to_array())
            },
            &mut |direction| {
                let direction = Vec3::from_array(direction.map(|x| x as f32));
                if sky {
                    let towards = Origin::Sky(direction * flip);
                    return f64::from(emission.density(&lights, towards, direction).start);
                }
                // Both triangles of the square have the same density.
                f64::from(emission.density(&lights, origin, direction).spread)
            },
        );
        assert!(result.p > sidak(FALSE_ALARM, 6), "{name}: {result:?}");
    }
}

/// Points: even over emitters and over the disk across directions, whose rays cover the scene.
#[test]
fn places_have_the_density_that_is_stated() {
    for case in 0..cases().len() {
        let (name, lights, emission, scene, _) = emitted(case);
        let mut random = Random(90 + case as u64);
        let (bins, n) = (12usize, 20_000u32);
        let mut counts = vec![0.0; bins * bins];
        for _ in 0..n {
            let Some(emitted) = sample(&emission, &lights, &scene, &mut random) else {
                continue;
            };
            let place = match emitted.origin {
                Origin::Surface { position, .. } => {
                    // The square's own coordinates.
                    let t = lights.emitters.triangles[0].facet;
                    let (s, u) = (t.edge1, t.edge2 - t.edge1);
                    let from = position - t.origin;
                    Vec2::new(
                        from.dot(s) / s.length_squared(),
                        from.dot(u) / u.length_squared(),
                    )
                }
                Origin::Direction(_) | Origin::Sky(_) => {
                    let towards = -emitted.ray.direction;
                    let from = emitted.ray.origin - emission.centre - towards * emission.radius;
                    let (s, t) = warp::basis(towards);
                    let disk = Vec2::new(from.dot(s), from.dot(t)) / emission.radius;
                    assert!(from.dot(towards).abs() < 1e-4 && disk.length() < 1.0 + 1e-4);
                    // Radius squared and angle of a uniform point are uniform.
                    Vec2::new(disk.length_squared(), disk.to_angle() / (2.0 * PI) + 0.5)
                }
                Origin::Point(_) => {
                    assert_eq!(emitted.ray.origin, Vec3::ONE);
                    continue;
                }
            };
            let bin = |x: f32| ((x * bins as f32) as usize).min(bins - 1);
            counts[bin(place.y) * bins + bin(place.x)] += 1.0;
        }
        if counts.iter().sum::<f64>() == 0.0 {
            continue;
        }
        let expected = vec![f64::from(n) / (bins * bins) as f64; bins * bins];
        let result = chi2_test(&counts, &expected);
        assert!(result.p > sidak(FALSE_ALARM, 5), "{name}: {result:?}");
    }
}

/// With all kinds together, lights are picked as stated, and each ray states the density of being found again.
#[test]
fn picks_follow_the_stated_probabilities() {
    let mut pose = Pose::default();
    let mut scene = Scene::default();
    for (case, (_, part, posed, ..)) in cases().into_iter().enumerate() {
        if case == 0 {
            (scene, pose) = (part, posed);
        } else {
            pose.lights.extend(posed.lights);
        }
    }
    // A second sun, so strong that without a limit nothing else would be picked.
    let kind = LightKind::Directional {
        angular_diameter: 0.0,
    };
    pose.lights
        .push(punctual(kind, Vec3::splat(300.0), Vec3::ONE, Vec3::NEG_Y));
    let lights = Lights::new(&scene, &pose, Some(sky()), LightSelection::Tree);
    let emission = Emission::new(&lights, &scene, &pose);
    let sum: f32 = (0..lights.len()).map(|light| emission.pmf(light)).sum();
    assert!((sum - 1.0).abs() < 1e-5);
    let near: f32 = (0..lights.first_direction()).map(|l| emission.pmf(l)).sum();
    assert!((near - 0.5).abs() < 1e-4, "{near}");
    let kinds = |origin: Origin| match origin {
        Origin::Point(light) | Origin::Direction(light) | Origin::Surface { light, .. } => light,
        Origin::Sky(_) => lights.first_sun(),
    };
    let mut random = Random(3);
    let n = 40_000;
    let mut counts = vec![0.0; lights.first_sun() + 1];
    for _ in 0..n {
        if let Some(emitted) = sample(&emission, &lights, &scene, &mut random) {
            counts[kinds(emitted.origin)] += 1.0;
            let density = emission.density(&lights, emitted.origin, emitted.ray.direction);
            assert_eq!(density, emitted.density);
        }
    }
    let mut expected: Vec<f64> = (0..lights.first_sun())
        .map(|light| f64::from(emission.pmf(light)) * f64::from(n))
        .collect();
    expected.push(f64::from(n) - expected.iter().sum::<f64>());
    let result = chi2_test(&counts, &expected);
    assert!(result.p > FALSE_ALARM, "{result:?} {counts:?} {expected:?}");
}

/// The density of light sampling over the sphere of directions from a point, turned into that of origins, is what
/// [`Lights::sample`] reports for its own samples.
#[test]
fn connections_state_the_density_of_light_sampling() {
    let (scene, mut pose) = scene_of(vec![(
        square(Vec3::new(0.2, 1.0, 0.0), Vec3::NEG_Y, 0.7),
        Vec3::ONE,
        true,
    )]);
    for kind in [
        LightKind::Point,
        LightKind::Directional {
            angular_diameter: 0.0,
        },
    ] {
        pose.lights.push(punctual(
            kind,
            Vec3::ONE,
            Vec3::new(1.0, 2.0, 0.0),
            Vec3::NEG_Y,
        ));
    }
    let lights = Lights::new(&scene, &pose, Some(sky()), LightSelection::Tree);
    let mut random = Random(8);
    for _ in 0..4000 {
        let position = random.direction() * 3.0 * random.unit();
        let normal = random.direction();
        let (pick, u) = (random.unit(), random.pair());
        let Some(sample) = lights.sample(&scene, position, normal, pick, u) else {
            continue;
        };
        let found = lights.connection_density(position, normal, Origin::of_sample(&sample));
        let stated = match sample.end {
            LightEnd::Surface(end) => end.density,
            _ => sample.pdf,
        };
        assert!((found / stated - 1.0).abs() < 5e-3, "{found} {sample:?}");
    }
}
