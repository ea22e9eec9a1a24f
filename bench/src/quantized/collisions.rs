//! How often the digests of different pairs of patches are alike, against what random numbers would do.
//!
//! Among `n` random numbers of `b` bits there are `n^2 / 2^(b+1)` pairs of equal ones on average (the birthday bound).

use super::measured::{Measured, Recording};
use super::shot::{Stage, Task, instant_radiosity};
use super::subject::Subject;
use super::{Plan, fixed, short};
use crate::common::{Report, Row, Setting};
use occlude_render::integrator::{Integrator, PathLimits};
use occlude_visibility::quantized::{Digest, Guarantee, PatchPair, Quantized};
use occlude_visibility::{BLOCK, Exact};
use std::collections::HashSet;

const TITLE: &str = "Equal digests among different pairs of patches";
const HEADER: &[&str] = &[
    "scene",
    "digest",
    "pairs",
    "64 bits: equal",
    "expected",
    "place (upper 32 bits): equal",
    "expected",
    "tag (lower 30 bits): equal",
    "expected",
];

/// Bits of a digest that a table keeps beside an answer.
const TAG: u64 = (1 << 30) - 1;

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let most = if setting.quick { 200_000 } else { 4_000_000 };
    let record = |integrator| {
        let task = Task {
            integrator,
            size: plan.part(2),
            samples: 1,
            seed: plan.seed,
            single_passes: false,
        };
        let recorder = Measured::recording(&Exact, most);
        stage.shoot(&recorder, &task);
        (task, recorder.into_recording())
    };
    let (task, shared) = record(instant_radiosity(subject.max_depth, subject.vpls(setting)));
    let (_, single) = record(Integrator::Path(PathLimits::new(subject.max_depth)));
    for digest in [Digest::Separable, Digest::LcgXorshift, Digest::Lcg] {
        let strategy = stage.quantized(&task, Guarantee::Bounded, |settings| {
            settings.digest = digest;
        });
        let mut pairs = HashSet::new();
        for recording in [&shared, &single] {
            collect(&strategy, recording, &mut pairs);
        }
        let n = pairs.len();
        let equal = |part: &dyn Fn(u64) -> u64| {
            let distinct: HashSet<u64> = pairs.iter().map(|pair| part(pair.digest)).collect();
            n - distinct.len()
        };
        let expected = |bits: i32| (n as f64).powi(2) * 0.5f64.powi(bits + 1);
        let [whole, place, tag] = [equal(&|d| d), equal(&|d| d >> 32), equal(&|d| d & TAG)];
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                format!("{digest:?}"),
                short(n as f64),
                whole.to_string(),
                format!("{:.1e}", expected(64)),
                place.to_string(),
                fixed(expected(32)),
                tag.to_string(),
                fixed(expected(30)),
            ],
        );
        report.raw(&format!(
            "collisions,{},1,{digest:?},,place,{place},1\ncollisions,{0},1,{digest:?},,tag,{tag},1",
            subject.name
        ));
        if digest == Digest::default() {
            // Five deviations of a Poisson number.
            let most = |mean: f64| mean + 5.0 * mean.sqrt() + 1.0;
            let holds = whole == 0
                && (place as f64) < most(expected(32))
                && (tag as f64) < most(expected(30));
            report.row(Row {
                name: format!("collisions of places, {digest:?}"),
                scene: subject.name.into(),
                value: place as f64,
                unit: format!("of {n} pairs"),
                baseline: Some(expected(32)),
                ratio: Some(place as f64 / expected(32)),
                spread: None,
                bar: Some("birthday bound + 5 deviations".into()),
                holds: Some(holds),
            });
        }
    }
}

/// The different pairs of patches that some questions fall into, at the first level and at the next.
fn collect(strategy: &Quantized, recording: &Recording, pairs: &mut HashSet<PatchPair>) {
    let mut add = |query: &occlude_visibility::Query, epoch| {
        for level in 0..2 {
            pairs.extend(strategy.patches(query, epoch, level));
        }
    };
    for (epoch, queries) in &recording.single {
        for query in queries {
            add(query, *epoch);
        }
    }
    for call in &recording.many {
        for (block, lights) in call.lights.chunks(BLOCK).enumerate() {
            for (eye, &mask) in call.eyes.iter().zip(&call.wanted[block]) {
                let asked = lights
                    .iter()
                    .enumerate()
                    .filter(|(l, _)| mask >> l & 1 != 0);
                for (_, light) in asked {
                    add(&light.query(eye), call.epoch);
                }
            }
        }
    }
}
