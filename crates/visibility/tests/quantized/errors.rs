//! Where answers may be wrong, and where not.

use crate::common::{Random, Spheres, ask};
use crate::{SIDE, all, ask_many, exact, floor, lights, single, stats, strategy, worker};
use glam::{Quat, Vec3};
use occlude_visibility::quantized::{ErrorReach, Guarantee, QuantizedSettings, Refine, Share};
use occlude_visibility::{Epoch, EyeSample, SharedLight, Visibility};

#[test]
fn no_error_allowed_is_exact() {
    let mut random = Random(1);
    let world = random.world(12, 0.3, 1.0);
    let lights = lights(&mut random);
    let (_, eyes) = floor(100.0);
    let eyes = &eyes[..4000];
    let expected = exact(&world, eyes, &lights);
    for guarantee in [
        Guarantee::Bounded,
        Guarantee::Unbiased,
        Guarantee::Consistent,
    ] {
        let strategy = strategy(QuantizedSettings {
            error: ErrorReach::all(0.0),
            guarantee,
            ..Default::default()
        });
        let mut worker = worker(&strategy);
        let found = ask_many(&strategy, &world, &mut worker, eyes, &lights, &all);
        assert_eq!(found, expected);
        let found = ask(&strategy, &world, &mut worker, &single(eyes, &lights));
        assert_eq!(found, expected.concat());
        let stats = stats(&strategy, &worker);
        assert_eq!(stats.queries, 2 * (eyes.len() * lights.len()) as u64);
        assert_eq!((stats.traced, stats.answered), (stats.queries, 0));
    }
}

/// Where all see the light, or nobody does, one answer is as good as another: no error at any size of patches.
#[test]
fn uniform_visibility_has_no_error() {
    let mut random = Random(2);
    let lights = lights(&mut random);
    let (_, eyes) = floor(10.0);
    let free = Spheres {
        spheres: vec![],
        lazy: false,
    };
    let shut = Spheres {
        spheres: vec![(Vec3::ZERO, 5.0)],
        lazy: false,
    };
    for error in [0.7, 3.0, 14.0, 100.0, 60000.0] {
        for share in [Share::Tile, Share::Thread, Share::All] {
            for guarantee in [
                Guarantee::Bounded,
                Guarantee::Unbiased,
                Guarantee::Consistent,
            ] {
                let strategy = strategy(QuantizedSettings {
                    error: ErrorReach::all(error),
                    share,
                    guarantee,
                    ..Default::default()
                });
                for (pass, (world, answer)) in [(&free, 1.0), (&shut, 0.0)].into_iter().enumerate()
                {
                    // Shared tables outlive an epoch, so another world needs another strategy then.
                    if share != Share::Tile && pass == 1 {
                        continue;
                    }
                    let mut worker = worker(&strategy);
                    let epoch = Epoch {
                        pass: pass as u32,
                        ..Epoch::default()
                    };
                    Visibility::<Spheres>::begin(&strategy, &mut worker, epoch);
                    let many = ask_many(&strategy, world, &mut worker, &eyes, &lights, &all);
                    assert!(
                        many.iter().flatten().all(|&a| a == answer),
                        "{error} {share:?}"
                    );
                    let questions = single(&eyes[..2000], &lights);
                    let one_by_one = ask(&strategy, world, &mut worker, &questions);
                    assert!(one_by_one.iter().all(|&a| a == answer));
                }
            }
        }
    }
}

/// Wrong answers lie near a true edge of the light's shadow: within 1.6 error reaches, whatever
/// the way of asking, and far fewer rays are traced.
#[test]
fn errors_reach_no_farther_than_promised() {
    let mut random = Random(3);
    let world = random.world(12, 0.3, 1.0);
    let lights = lights(&mut random);
    for error in [3.0, 8.0] {
        let (places, eyes) = floor((SIDE * SIDE) as f32 / (error * error));
        let expected = exact(&world, &eyes, &lights);
        let mut unrefined = [0.0; 2];
        for refine in [Refine::Levels(1), Refine::Auto] {
            let strategy = strategy(QuantizedSettings {
                error: ErrorReach::all(error),
                refine,
                ..Default::default()
            });
            let mut many_worker = worker(&strategy);
            let many = ask_many(&strategy, &world, &mut many_worker, &eyes, &lights, &all);
            let mut single_worker = worker(&strategy);
            let mut flat = Vec::new();
            for questions in single(&eyes, &lights).chunks(1500) {
                flat.extend(ask(&strategy, &world, &mut single_worker, questions));
            }
            let flat: Vec<Vec<f32>> = flat.chunks(lights.len()).map(<[f32]>::to_vec).collect();
            for (i, (way, answers, worker)) in [
                ("many", &many, &many_worker),
                ("single", &flat, &single_worker),
            ]
            .into_iter()
            .enumerate()
            {
                // Of lights that all eyes share, and of those without extent, the light's end is exact; the patches of others add to the reach of errors.
                let exact_ends = if way == "many" { lights.len() } else { 5 };
                for l in 0..exact_ends {
                    let far = far_errors(&places, answers, &expected, l, 1.6 * error + 1.0);
                    assert_eq!(far, 0, "light {l}, {way}, error {error}, {refine:?}");
                }
                // Refinement is for eyes: it shows where the light's end is exact.
                let wrong = answers
                    .iter()
                    .zip(&expected)
                    .map(|(a, b)| (0..exact_ends).filter(|&l| a[l] != b[l]).count())
                    .sum::<usize>();
                let share = wrong as f64 / (eyes.len() * exact_ends) as f64;
                let stats = stats(&strategy, worker);
                assert_eq!(stats.queries, (eyes.len() * lights.len()) as u64);
                assert_eq!(stats.queries, stats.answered + stats.traced);
                let reduction = stats.queries as f64 / stats.traced as f64;
                println!(
                    "error {error} {refine:?} {way}: {:.2} % wrong, {reduction:.1} times fewer rays, refined {:?}",
                    100.0 * share,
                    stats.refined
                );
                match refine {
                    Refine::Auto => assert!(share < 0.7 * unrefined[i], "{share}"),
                    Refine::Levels(_) => unrefined[i] = share,
                }
                // Shared lights do not answer for each other: more rays than where their patches do.
                let least = match (refine, way) {
                    (Refine::Auto, "many") => 0.28,
                    (Refine::Auto, _) => 0.35,
                    (Refine::Levels(_), _) => 0.6,
                };
                assert!(reduction > least * f64::from(error * error), "{reduction}");
            }
        }
    }
}

/// Surfaces that are not along their grid's axes are refined as well as those that are: a tilted world has hardly more wrong answers.
#[test]
fn tilted_worlds_are_refined_too() {
    let mut random = Random(18);
    let world = random.world(12, 0.3, 1.0);
    let points: Vec<Vec3> = (0..16).map(|_| random.vector() * 0.5 + Vec3::Y).collect();
    let error = 8.0;
    let (_, eyes) = floor((SIDE * SIDE) as f32 / (error * error));
    let shares = [0.0, 0.08, 0.3, 0.7].map(|angle| {
        let turn = Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), angle);
        let world = Spheres {
            spheres: (world.spheres.iter())
                .map(|&(centre, radius)| (turn * centre, radius))
                .collect(),
            lazy: world.lazy,
        };
        let eyes: Vec<EyeSample> = eyes
            .iter()
            .map(|eye| EyeSample::new(turn * eye.origin, turn * Vec3::Y, eye.end.density))
            .collect();
        let lights: Vec<_> = points
            .iter()
            .map(|&p| SharedLight::point(turn * p))
            .collect();
        let expected = exact(&world, &eyes, &lights).concat();
        let strategy = strategy(QuantizedSettings {
            error: ErrorReach::all(error),
            ..Default::default()
        });
        let found = ask_many(
            &strategy,
            &world,
            &mut worker(&strategy),
            &eyes,
            &lights,
            &all,
        );
        let pairs = found.concat().into_iter().zip(expected);
        let wrong = pairs.filter(|(a, b)| a != b).count();
        wrong as f64 / (eyes.len() * lights.len()) as f64
    });
    println!("wrong share by tilt: {shares:?}");
    assert!(
        shares.iter().all(|&share| share < 1.3 * shares[0]),
        "{shares:?}"
    );
}

/// Counts wrong answers about light `l` that have no true edge of its shadow within `reach` eyes.
fn far_errors(
    places: &[[u32; 2]],
    answers: &[Vec<f32>],
    expected: &[Vec<f32>],
    l: usize,
    reach: f32,
) -> usize {
    let mut truth = vec![0.0; SIDE * SIDE];
    for (&[x, y], expected) in places.iter().zip(expected) {
        truth[y as usize * SIDE + x as usize] = expected[l];
    }
    let r = reach.ceil() as i32;
    let near_edge = |x: u32, y: u32, value: f32| {
        (-r..=r).any(|dy| {
            (-r..=r).any(|dx| {
                let (x, y) = (x as i32 + dx, y as i32 + dy);
                let inside = (0..SIDE as i32).contains(&x) && (0..SIDE as i32).contains(&y);
                inside
                    && (dx * dx + dy * dy) as f32 <= reach * reach
                    && truth[y as usize * SIDE + x as usize] != value
            })
        })
    };
    places
        .iter()
        .zip(answers.iter().zip(expected))
        .filter(|(place, (answers, expected))| {
            answers[l] != expected[l] && !near_edge(place[0], place[1], expected[l])
        })
        .count()
}
