//! What unbiased and consistent answers promise beyond bounded ones.

use crate::common::{Random, Spheres, ask};
use crate::{SIDE, all, ask_many, exact, floor, lights, single, stats, strategy, worker};
use occlude_visibility::quantized::{ErrorReach, Guarantee, Quantized, QuantizedSettings, Refine};
use occlude_visibility::{Epoch, Visibility, VisibilityStats};

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
