//! Quantized visibility against exact rays: what it promises, and that its counters add up.

mod common;

use common::{Random, Spheres, ask};
use glam::{Quat, Vec3};
use occlude_visibility::quantized::{
    BoundingSphere, Digest, ErrorReach, Guarantee, Pairing, Quantized, QuantizedError,
    QuantizedSettings, Refine, Share,
};
use occlude_visibility::{
    BLOCK, Class, Correction, Endpoint, Epoch, Exact, EyeSample, LightEnd, ManyLights, Query,
    SharedLight, Tracer, Visibility, VisibilityStats, order,
};

/// Eyes along each side of the floor, -1 to 1 in metres.
const SIDE: usize = 192;

fn strategy(settings: QuantizedSettings) -> Quantized {
    let bounds = BoundingSphere {
        centre: Vec3::ZERO,
        radius: 3f32.sqrt(),
    };
    Quantized::new(settings, bounds).unwrap()
}

/// A floor of eyes in asking order, with their places.
fn floor(first: f32) -> (Vec<[u32; 2]>, Vec<EyeSample>) {
    let places = order::progressive(SIDE as u32, SIDE as u32, first);
    let metres = 2.0 / SIDE as f32;
    let eyes = places
        .iter()
        .map(|&[x, y]| {
            let position = Vec3::new(
                (x as f32 + 0.5) * metres - 1.0,
                -1.0,
                (y as f32 + 0.5) * metres - 1.0,
            );
            EyeSample {
                end: Endpoint::new(position, Vec3::Y, 1.0 / (metres * metres)),
                origin: position,
            }
        })
        .collect();
    (places, eyes)
}

/// Points, directions, a lamp's samples and a sky's samples: 37 lights, so that blocks mix kinds and the last is not full.
fn lights(random: &mut Random) -> Vec<SharedLight> {
    let mut lights = Vec::new();
    let mut add = |end, target, connections| {
        lights.push(SharedLight {
            end,
            target,
            connections,
        })
    };
    for _ in 0..3 {
        let at = random.vector() * 0.5 + Vec3::Y;
        add(LightEnd::Point(at), Some(at), 1.0);
    }
    for _ in 0..2 {
        let towards = (random.vector() + 1.5 * Vec3::Y).normalize();
        add(LightEnd::Direction(towards), None, 1.0);
    }
    for _ in 0..16 {
        let at = Vec3::new(random.next() * 0.3, 1.0, random.next() * 0.3);
        let end = Endpoint::new(at, -Vec3::Y, 11.0);
        add(LightEnd::Surface(end), Some(at), 16.0);
    }
    for _ in 0..16 {
        let direction = (random.vector() + 1.2 * Vec3::Y).normalize();
        let density = 0.16;
        add(LightEnd::SolidAngle { direction, density }, None, 16.0);
    }
    lights
}

/// Asks about everything that `wants` and keeps the answers.
struct Everything<'a> {
    lights: usize,
    answers: Vec<Vec<f32>>,
    wants: &'a dyn Fn(usize, usize) -> bool,
}

impl ManyLights for Everything<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        for (eye, wanted) in wanted.iter_mut().enumerate() {
            assert_eq!(*wanted, 0);
            for l in 0..BLOCK.min(self.lights - block * BLOCK) {
                *wanted |= u16::from((self.wants)(eye, block * BLOCK + l)) << l;
            }
        }
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        let wants = self.wants;
        for (eye, visible) in visible.iter().enumerate() {
            for l in 0..BLOCK {
                let seen = visible >> l & 1 != 0;
                let light = block * BLOCK + l;
                if light < self.lights && wants(eye, light) {
                    self.answers[eye][light] = if seen { 1.0 } else { 0.0 };
                } else {
                    assert!(!seen);
                }
            }
        }
        for correction in corrections {
            let light = block * BLOCK + correction.light as usize;
            assert!(wants(correction.eye as usize, light));
            self.answers[correction.eye as usize][light] += correction.amount;
        }
    }
}

/// Answers of all eyes about all lights, NaN where not wanted.
fn ask_many<T: Tracer, V: Visibility<T>>(
    strategy: &V,
    tracer: &T,
    worker: &mut V::Worker,
    eyes: &[EyeSample],
    lights: &[SharedLight],
    wants: &dyn Fn(usize, usize) -> bool,
) -> Vec<Vec<f32>> {
    let mut asker = Everything {
        lights: lights.len(),
        answers: vec![vec![f32::NAN; lights.len()]; eyes.len()],
        wants,
    };
    strategy.answer_many(tracer, worker, eyes, lights, &mut asker);
    asker.answers
}

fn all(_: usize, _: usize) -> bool {
    true
}

/// The same questions one by one, eye by eye.
fn single(eyes: &[EyeSample], lights: &[SharedLight]) -> Vec<Query> {
    eyes.iter()
        .flat_map(|eye| lights.iter().map(|light| light.query(eye)))
        .collect()
}

fn worker(strategy: &Quantized) -> <Quantized as Visibility<Spheres>>::Worker {
    Visibility::<Spheres>::worker(strategy)
}

fn stats(
    strategy: &Quantized,
    worker: &<Quantized as Visibility<Spheres>>::Worker,
) -> VisibilityStats {
    Visibility::<Spheres>::stats(strategy, worker)
}

fn exact(world: &Spheres, eyes: &[EyeSample], lights: &[SharedLight]) -> Vec<Vec<f32>> {
    let mut worker = Visibility::<Spheres>::worker(&Exact);
    ask_many(&Exact, world, &mut worker, eyes, lights, &all)
}

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

/// Over many seeds, each patch of floor receives what exact rays say: t-tests of 36 blocks and 4 kinds of light, with a
/// false alarm once in 1000 runs.
#[test]
fn unbiased_answers_are_right_on_average() {
    const RUNS: u64 = 32;
    let mut random = Random(5);
    let world = random.world(12, 0.3, 1.0);
    let lights = lights(&mut random);
    // The density says 10 samples a side; a quarter of them asks.
    let error = 20.0;
    let (places, eyes) = floor((SIDE * SIDE) as f32 / (error * error));
    // A sparse part of the floor, well spread.
    let (places, eyes) = (&places[..9000], &eyes[..9000]);
    let expected = exact(&world, eyes, &lights);
    let cell = |place: [u32; 2], l: usize| {
        let block = (place[1] as usize * 6 / SIDE) * 6 + place[0] as usize * 6 / SIDE;
        let kind = [3, 5, 21, 37].iter().position(|&end| l < end).unwrap();
        block * 4 + kind
    };
    let sums = |answers: &[Vec<f32>]| {
        let mut sums = vec![0.0; 36 * 4];
        for (&place, answers) in places.iter().zip(answers) {
            for (l, &answer) in answers.iter().enumerate() {
                sums[cell(place, l)] += f64::from(answer);
            }
        }
        sums
    };
    let truth = sums(&expected);
    for many in [true, false] {
        let mut runs = vec![Vec::new(); truth.len()];
        let mut biased = 0.0;
        let mut total = VisibilityStats::default();
        for seed in 0..RUNS {
            let make = |guarantee| {
                strategy(QuantizedSettings {
                    error: ErrorReach::all(error),
                    guarantee,
                    seed,
                    ..Default::default()
                })
            };
            let answer = |strategy: &Quantized| {
                let mut worker = worker(strategy);
                Visibility::<Spheres>::begin(strategy, &mut worker, Epoch::default());
                let answers = if many {
                    ask_many(strategy, &world, &mut worker, eyes, &lights, &all)
                } else {
                    let flat = ask(strategy, &world, &mut worker, &single(eyes, &lights));
                    flat.chunks(lights.len()).map(<[f32]>::to_vec).collect()
                };
                (answers, stats(strategy, &worker))
            };
            let (answers, stats) = answer(&make(Guarantee::Unbiased));
            total.add(&stats);
            for (runs, sum) in runs.iter_mut().zip(sums(&answers)) {
                runs.push(sum);
            }
            if seed == 0 {
                let (answers, _) = answer(&make(Guarantee::Bounded));
                biased = sums(&answers)
                    .iter()
                    .zip(&truth)
                    .map(|(a, b)| (a - b).abs())
                    .sum();
            }
        }
        let mut worst = 0.0f64;
        let mut tested = 0;
        for (runs, truth) in runs.iter().zip(&truth) {
            let n = runs.len() as f64;
            let mean = runs.iter().sum::<f64>() / n;
            let variance = runs.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
            tested += u32::from(variance > 0.0);
            // One wrong answer that is checked once in 32 runs may go unseen; its variance is 31.
            let variance = variance.max(31.0);
            worst = worst.max((mean - truth).abs() / (variance / n).sqrt());
        }
        let reduction = total.queries as f64 / total.traced as f64;
        println!(
            "many {many}: worst t {worst:.2} of {tested}, {reduction:.1} times fewer rays, bounded off by {biased}"
        );
        // Student, 31 degrees of freedom, two-sided 0.001 / 144.
        assert!(worst < 5.4, "t = {worst}");
        assert!(tested > 50 && biased > 0.0);
        assert!(reduction > 5.0, "{reduction}");
    }
}

/// Patches shrink from pass to pass at both ends: the share of wrong answers falls, and goes on falling. Their sides go with the
/// fourth root of the passes: fourfold passes leave 0.71 of the errors of one end.
#[test]
fn consistent_answers_converge() {
    let mut random = Random(6);
    let world = random.world(12, 0.3, 1.0);
    let lights = lights(&mut random);
    let error = 12.0;
    let (_, eyes) = floor((SIDE * SIDE) as f32 / (error * error));
    let expected = exact(&world, &eyes, &lights);
    let strategy = strategy(QuantizedSettings {
        error: ErrorReach::all(error),
        guarantee: Guarantee::Consistent,
        refine: Refine::Levels(1),
        ..Default::default()
    });
    let wrong = [0, 3, 15, 63, 255].map(|pass| {
        let mut worker = worker(&strategy);
        Visibility::<Spheres>::begin(
            &strategy,
            &mut worker,
            Epoch {
                pass,
                ..Epoch::default()
            },
        );
        let found = ask_many(&strategy, &world, &mut worker, &eyes, &lights, &all);
        let wrong = found
            .concat()
            .iter()
            .zip(expected.concat())
            .filter(|(a, b)| **a != *b)
            .count();
        wrong as f64 / (eyes.len() * lights.len()) as f64
    });
    println!("wrong share by pass: {wrong:?}");
    assert!(
        wrong.windows(2).all(|pair| pair[1] < 0.85 * pair[0]) && wrong[4] < 0.35 * wrong[0],
        "{wrong:?}"
    );
}

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
