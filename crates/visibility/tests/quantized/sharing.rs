//! Who answers for whom: lights, tiles, tables, pairs.

use crate::common::{Random, Spheres, ask};
use crate::{SIDE, all, ask_many, floor, lights, single, stats, strategy, worker};
use glam::Vec3;
use occlude_visibility::quantized::{ErrorReach, Guarantee, Pairing, QuantizedSettings, Share};
use occlude_visibility::{
    Endpoint, Epoch, Exact, EyeSample, LightEnd, Query, SharedLight, Visibility,
};

/// Directions of a sky and virtual lights are told apart however near they are to each other: they are answered as exact directions and points at the
/// same places are.
#[test]
fn shared_lights_do_not_answer_for_each_other() {
    let mut random = Random(9);
    let world = random.world(12, 0.3, 1.0);
    let (_, eyes) = floor((SIDE * SIDE) as f32 / (12.0 * 12.0));
    let sky: Vec<SharedLight> = (0..16)
        .map(|_| SharedLight {
            end: LightEnd::SolidAngle {
                direction: (random.vector() * 0.2 + Vec3::Y).normalize(),
                density: 1e-3,
            },
            target: None,
            connections: 1.0,
        })
        .collect();
    let patches: Vec<SharedLight> = (0..16)
        .map(|_| {
            let at = Vec3::new(random.next() * 0.3, 1.0, random.next() * 0.3);
            SharedLight {
                end: LightEnd::Surface(Endpoint::new(at, -Vec3::Y, 1e-3)),
                target: Some(at),
                connections: 1.0,
            }
        })
        .collect();
    let without_extent = |light: &SharedLight| SharedLight {
        end: match light.end {
            LightEnd::SolidAngle { direction, .. } => LightEnd::Direction(direction),
            LightEnd::Surface(end) => LightEnd::Point(end.position),
            other => other,
        },
        ..*light
    };
    for lights in [sky, patches] {
        let settings = QuantizedSettings {
            error: ErrorReach::all(12.0),
            ..Default::default()
        };
        let answer = |lights: &[SharedLight]| {
            let strategy = strategy(settings.clone());
            let mut worker = worker(&strategy);
            ask_many(&strategy, &world, &mut worker, &eyes, lights, &all)
        };
        let extended = answer(&lights);
        let exact: Vec<SharedLight> = lights.iter().map(without_extent).collect();
        assert_eq!(extended, answer(&exact));
        let seen = extended.concat().iter().filter(|&&v| v == 1.0).count();
        assert!(seen > 1000 && seen + 1000 < eyes.len() * lights.len());
    }
}

/// An epoch's answers depend on nothing that was asked in another, so they do not depend on who works on which tile.
#[test]
fn tiles_do_not_depend_on_history() {
    let mut random = Random(7);
    let world = random.world(12, 0.3, 1.0);
    let lights = lights(&mut random);
    let (_, eyes) = floor(300.0);
    for guarantee in [Guarantee::Bounded, Guarantee::Unbiased] {
        let strategy = strategy(QuantizedSettings {
            error: ErrorReach::all(9.0),
            guarantee,
            ..Default::default()
        });
        let epoch = |tile| Epoch {
            pass: 3,
            tile,
            ..Epoch::default()
        };
        let answer = |worker: &mut _, tile, eyes: &[EyeSample]| {
            Visibility::<Spheres>::begin(&strategy, worker, epoch(tile));
            let many = ask_many(&strategy, &world, worker, eyes, &lights, &all);
            let one_by_one = ask(&strategy, &world, worker, &single(&eyes[..800], &lights));
            (many, one_by_one)
        };
        let mut fresh = worker(&strategy);
        let alone = answer(&mut fresh, 5, &eyes[..9000]);
        let mut used = worker(&strategy);
        answer(&mut used, 4, &eyes[3000..]);
        assert!(answer(&mut used, 5, &eyes[..9000]) == alone);
    }
}

/// What one tile has asked, shared tables know in the next; lights that have not been there before start from nothing.
#[test]
fn shared_tables_remember() {
    let mut random = Random(8);
    let world = random.world(12, 0.3, 1.0);
    let lights = lights(&mut random);
    let (_, eyes) = floor(300.0);
    let traced = |share, lights: [&[SharedLight]; 2]| {
        let strategy = strategy(QuantizedSettings {
            error: ErrorReach::all(9.0),
            share,
            table_bytes: 32 << 20,
            ..Default::default()
        });
        let mut worker = worker(&strategy);
        let mut before = 0;
        let traced = [0, 1].map(|tile| {
            Visibility::<Spheres>::begin(
                &strategy,
                &mut worker,
                Epoch {
                    tile,
                    ..Epoch::default()
                },
            );
            let lights = lights[tile as usize];
            ask_many(&strategy, &world, &mut worker, &eyes, lights, &all);
            let now = stats(&strategy, &worker).traced;
            let traced = now - before;
            before = now;
            traced
        });
        assert!(Visibility::<Spheres>::bytes(&strategy) <= 32 << 20);
        assert_eq!(strategy.load().is_some(), share == Share::All);
        traced
    };
    let others: Vec<SharedLight> = lights
        .iter()
        .map(|light| {
            let mut light = *light;
            if let LightEnd::Point(at) = &mut light.end {
                at.y += 0.01;
            }
            light
        })
        .collect();
    for share in [Share::Thread, Share::All] {
        let [first, second] = traced(share, [&lights, &lights]);
        assert!(second * 8 < first, "{share:?}: {first}, then {second}");
        let [_, second] = traced(share, [&lights, &others]);
        assert!(second * 3 > first, "{share:?}: {first}, then {second}");
    }
    let [first, second] = traced(Share::Tile, [&lights, &lights]);
    assert_eq!(first, second);
}

/// Pairs of surfaces under Eq. 6: a path vertex at either end, each met once.
#[test]
fn pairs_share_rays() {
    let mut random = Random(9);
    let world = random.world(8, 0.25, 1.0);
    let count = 60_000;
    let queries: Vec<Query> = (0..count)
        .map(|_| {
            let eye = Vec3::new(random.next() * 2.0 - 1.0, -1.0, random.next() * 2.0 - 1.0);
            let light = Vec3::new(random.next() * 2.0 - 1.0, 1.0, random.next() * 2.0 - 1.0);
            let eye_end = Endpoint::new(eye, Vec3::Y, count as f32 / 4.0);
            let light_end = Endpoint::new(light, -Vec3::Y, 0.25);
            Query::new(
                eye_end,
                LightEnd::Surface(light_end),
                occlude_visibility::Ray::between(eye, light),
            )
        })
        .collect();
    let expected = ask(
        &Exact,
        &world,
        &mut Visibility::<Spheres>::worker(&Exact),
        &queries,
    );
    let strategy = strategy(QuantizedSettings {
        error: ErrorReach::all(4.0),
        pairing: Pairing::Both,
        share: Share::All,
        ..Default::default()
    });
    let mut worker = worker(&strategy);
    let mut found = Vec::new();
    for queries in queries.chunks(1000) {
        found.extend(ask(&strategy, &world, &mut worker, queries));
    }
    let stats = stats(&strategy, &worker);
    let reduction = stats.queries as f64 / stats.traced as f64;
    let wrong =
        found.iter().zip(&expected).filter(|(a, b)| a != b).count() as f64 / f64::from(count);
    let [mean, truth] = [&found, &expected].map(|a| a.iter().sum::<f32>() / count as f32);
    println!(
        "{reduction:.1} times fewer rays, {:.1} % wrong, mean {mean} of {truth}",
        100.0 * wrong
    );
    assert!(reduction > 6.0 && wrong < 0.2 && (mean - truth).abs() < 0.02);
    assert!(stats.refined.is_empty());
}
