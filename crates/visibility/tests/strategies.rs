//! Exact strategies answer alike, whatever was asked before, and their counters add up.

mod common;

use common::{Random, Spheres, ask};
use glam::Vec3;
use occlude_visibility::{Class, Endpoint, Exact, LightEnd, Occluder, Query, Ray, Visibility};

#[test]
fn occluder_equals_exact() {
    for seed in 0..6 {
        let mut random = Random(seed);
        let scale = [1.0, 1e-5, 1e5][seed as usize % 3];
        let world = random.world(20, 0.3, scale);
        let queries = random.questions(scale);
        let exact = ask(
            &Exact,
            &world,
            &mut Visibility::<Spheres>::worker(&Exact),
            &queries,
        );
        assert!(exact.contains(&0.0) && exact.contains(&1.0));
        for slots in [1, 64, 4096] {
            let strategy = Occluder::with_slots(slots);
            let mut worker = Visibility::<Spheres>::worker(&strategy);
            assert_eq!(
                ask(&strategy, &world, &mut worker, &queries),
                exact,
                "{slots} slots, scale {scale}"
            );
            let stats = Visibility::<Spheres>::stats(&strategy, &worker);
            assert_eq!(stats.queries, queries.len() as u64);
            assert_eq!(stats.queries, stats.answered + stats.traced);
        }
    }
}

/// Memory of one world, and of other batch sizes, does no harm in another.
#[test]
fn workers_may_be_reused() {
    let mut random = Random(7);
    let strategy = Occluder::default();
    let mut worker = Visibility::<Spheres>::worker(&strategy);
    for size in [1, 7, 64, 65, 100_000] {
        let world = random.world(30, 0.4, 1.0);
        let queries = random.questions(1.0);
        let exact = ask(
            &Exact,
            &world,
            &mut Visibility::<Spheres>::worker(&Exact),
            &queries,
        );
        let answers: Vec<f32> = queries
            .chunks(size)
            .flat_map(|chunk| ask(&strategy, &world, &mut worker, chunk))
            .collect();
        assert_eq!(answers, exact, "batches of {size}");
    }
}

/// Not only right but useful: most blocked rays of a big blocker are never traced, and none of a lit world is tested.
#[test]
fn memory_answers_most_blocked_questions() {
    let queries = Random(9).questions(1.0);
    let count = |world: &Spheres| {
        let strategy = Occluder::default();
        let mut worker = Visibility::<Spheres>::worker(&strategy);
        let answers = ask(&strategy, world, &mut worker, &queries);
        let blocked = answers.iter().filter(|&&a| a == 0.0).count() as f64;
        (
            blocked,
            Visibility::<Spheres>::stats(&strategy, &worker).answered as f64,
        )
    };
    let lid = Spheres {
        spheres: vec![(Vec3::ZERO, 0.99)],
        lazy: false,
    };
    let (blocked, answered) = count(&lid);
    assert!(
        blocked > 0.3 * queries.len() as f64 && answered > 0.7 * blocked,
        "{answered} of {blocked}"
    );
    let (blocked, answered) = count(&Spheres {
        spheres: vec![],
        lazy: false,
    });
    assert_eq!((blocked, answered), (0.0, 0.0));
    let (blocked, answered) = count(&Spheres { lazy: true, ..lid });
    assert!(blocked > 0.0 && answered == 0.0);
}

/// Positions and directions that are not finite, or zero, fall into some bin.
#[test]
fn odd_numbers_do_no_harm() {
    let world = Random(1).world(5, 0.5, 1.0);
    let odd = [
        0.0,
        -0.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN_POSITIVE,
    ];
    let mut queries = Vec::new();
    for x in odd {
        for y in odd {
            let (position, other) = (Vec3::new(x, y, 0.0), Vec3::new(y, 0.0, x));
            let eye = Endpoint::new(position, Vec3::Y, x);
            let solid_angle = LightEnd::SolidAngle {
                direction: other,
                density: y,
            };
            let surface = LightEnd::Surface(Endpoint::new(other, other, y));
            for light in [
                LightEnd::Point(other),
                LightEnd::Direction(other),
                surface,
                solid_angle,
            ] {
                queries.push(Query::new(eye, light, Ray::between(position, other)));
            }
        }
    }
    let strategy = Occluder::default();
    let mut worker = Visibility::<Spheres>::worker(&strategy);
    let exact = ask(
        &Exact,
        &world,
        &mut Visibility::<Spheres>::worker(&Exact),
        &queries,
    );
    assert_eq!(ask(&strategy, &world, &mut worker, &queries), exact);
}

#[test]
fn strategies_say_what_they_are() {
    let occluder = Occluder::with_slots(100);
    assert_eq!(Visibility::<Spheres>::name(&occluder), "occluder");
    assert_eq!(Visibility::<Spheres>::class(&occluder), Class::Exact);
    assert_eq!(Visibility::<Spheres>::class(&Exact).name(), "exact");
    assert_eq!(Visibility::<Spheres>::bytes(&occluder), 0);
    let workers: Vec<_> = (0..2)
        .map(|_| Visibility::<Spheres>::worker(&occluder))
        .collect();
    drop(workers);
    let bytes = Visibility::<Spheres>::bytes(&occluder);
    assert!((2 * 128 * 8..=2 * 128 * 32).contains(&bytes), "{bytes}");
}
