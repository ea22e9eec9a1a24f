//! Ends and settings that cannot be used.

use crate::common::{Random, Spheres, ask};
use crate::{all, ask_many, exact, floor, lights, single, strategy, worker};
use glam::Vec3;
use occlude_visibility::quantized::{
    BoundingSphere, Digest, ErrorReach, Quantized, QuantizedError, QuantizedSettings, Refine,
};
use occlude_visibility::{Class, LightEnd, Visibility};

/// Ends without a usable density or normal are traced exactly, in both ways of asking; no number breaks anything.
#[test]
fn unusable_ends_are_traced() {
    let mut random = Random(10);
    let world = random.world(12, 0.3, 1.0);
    let mut lights = lights(&mut random);
    let (_, mut eyes) = floor(100.0);
    eyes.truncate(600);
    let strange = [0.0, -1.0, f32::NAN, f32::INFINITY, 1e38, 1e-38];
    for (i, eye) in eyes.iter_mut().enumerate() {
        match i % 3 {
            0 => eye.end.density = strange[i / 3 % strange.len()],
            1 => eye.end.normal = [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY][i / 3 % 3],
            _ => {}
        }
    }
    for error in [2.0, 30.0] {
        let strategy = strategy(QuantizedSettings {
            error: ErrorReach::all(error),
            ..Default::default()
        });
        let expected = exact(&world, &eyes, &lights);
        let mut worker = worker(&strategy);
        let many = ask_many(&strategy, &world, &mut worker, &eyes, &lights, &all);
        let flat = ask(&strategy, &world, &mut worker, &single(&eyes, &lights));
        for (i, eye) in eyes.iter().enumerate() {
            let usable = eye.end.density > 0.0 && eye.end.density.is_finite() && i % 3 != 1;
            if !usable {
                assert_eq!(many[i], expected[i]);
                assert_eq!(flat[i * lights.len()..(i + 1) * lights.len()], expected[i]);
            }
        }
    }
    for light in &mut lights {
        match &mut light.end {
            LightEnd::Surface(end) => end.density = f32::NAN,
            LightEnd::SolidAngle { density, .. } => *density = -1.0,
            LightEnd::Point(_) | LightEnd::Direction(_) => light.connections = f32::NAN,
        }
    }
    let strategy = strategy(QuantizedSettings::default());
    ask_many(
        &strategy,
        &world,
        &mut worker(&strategy),
        &eyes,
        &lights,
        &all,
    );
    ask(
        &strategy,
        &world,
        &mut worker(&strategy),
        &single(&eyes, &lights),
    );
    ask_many(
        &strategy,
        &world,
        &mut worker(&strategy),
        &[],
        &lights,
        &all,
    );
    ask_many(&strategy, &world, &mut worker(&strategy), &eyes, &[], &all);
    ask(&strategy, &world, &mut worker(&strategy), &[]);
}

#[test]
fn settings_out_of_range_are_refused() {
    let bounds = BoundingSphere {
        centre: Vec3::ZERO,
        radius: 1.0,
    };
    let refused = |change: &dyn Fn(&mut QuantizedSettings)| {
        let mut settings = QuantizedSettings::default();
        change(&mut settings);
        Quantized::new(settings, bounds).unwrap_err()
    };
    assert_eq!(
        refused(&|s| s.error.sky = -1.0),
        QuantizedError::Error(-1.0)
    );
    assert!(matches!(
        refused(&|s| s.error.point = f32::NAN),
        QuantizedError::Error(_)
    ));
    assert_eq!(refused(&|s| s.normals = 7), QuantizedError::Normals(7));
    assert_eq!(refused(&|s| s.slab = 0.0), QuantizedError::Slab(0.0));
    assert_eq!(
        refused(&|s| s.resolution_step = 1.0),
        QuantizedError::ResolutionStep(1.0)
    );
    assert_eq!(
        refused(&|s| s.table_bytes = 3),
        QuantizedError::TableBytes(3)
    );
    assert_eq!(
        refused(&|s| s.table_bytes = 1 << 60),
        QuantizedError::Memory(1 << 60)
    );
    assert_eq!(
        refused(&|s| s.refine = Refine::Levels(0)),
        QuantizedError::Levels(0)
    );
    let nowhere = BoundingSphere {
        centre: Vec3::NAN,
        radius: 1.0,
    };
    let settings = QuantizedSettings::default();
    assert_eq!(
        Quantized::new(settings.clone(), nowhere).unwrap_err(),
        QuantizedError::Bounds
    );
    let strategy = Quantized::new(settings, bounds).unwrap();
    assert_eq!(Visibility::<Spheres>::class(&strategy), Class::Bounded);
    assert_eq!(Digest::default(), Digest::Separable);
}
