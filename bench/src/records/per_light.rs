//! Against a map a virtual light (Figs. 6 and 7): what the paper compares with.
//!
//! With a map of its own a light is judged by one record that stands on it: filling costs `F`, a question `c1`. Three records of a cache that is
//! there already cost `c3`. For `T` questions a light that is a gain of `(F + T c1) / (T c3)` in lights of equal time, the bound; what
//! frames gain in fact is told by how much longer they take with more lights.

use super::Plan;
use super::stage::{settings, walks};
use crate::common::{Report, Row, median};
use crate::quantized::fixed;
use crate::quantized::quality::quality;
use crate::quantized::shot::{Shot, Stage, Task, instant_radiosity};
use occlude_visibility::Exact;
use occlude_visibility::records::{Placement, RecordSettings, Records};

/// A record on every virtual light, which answers for it alone: so many lights at most.
pub fn map_per_light(stage: &Stage, plan: &Plan, lights: u32) -> Records {
    let settings = RecordSettings {
        capacity: lights,
        placement: Placement::Lights,
        ..settings(stage, plan, false)
    };
    Records::new(settings).expect("legal settings")
}

/// Frames with few and many lights; `bound` by the costs of questions.
pub fn frames(plan: &Plan, report: &mut Report, name: &str, stage: &Stage, bound: f64) {
    let counts = [plan.vpls / 4, plan.vpls];
    let task = |vpls| Task {
        integrator: instant_radiosity(8, vpls),
        size: plan.size,
        samples: 1,
        seed: plan.seed,
        single_passes: false,
    };
    let cache = Records::new(RecordSettings {
        pace: 0,
        steps_per_picture: 0,
        ..settings(stage, plan, false)
    })
    .expect("legal settings");
    let mut scout = walks(stage, plan);
    (cache.cache_mut()).place_initial(stage.geometry, &mut scout);
    let exact = counts.map(|vpls| stage.shoot(&Exact, &task(vpls)));
    let (mut with_maps, mut with_cache) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
    let mut last: Option<[[Shot; 2]; 2]> = None;
    for _ in 0..plan.repetitions.clamp(2, 3) {
        let shots = [0, 1].map(|k| {
            let maps = map_per_light(stage, plan, counts[k]);
            let shots = [
                stage.shoot(&maps, &task(counts[k])),
                stage.shoot(&cache, &task(counts[k])),
            ];
            with_maps[k].push(shots[0].seconds);
            with_cache[k].push(shots[1].seconds);
            shots
        });
        last = Some(shots);
    }
    let Some(last) = last else { return };
    let seconds = |times: &[Vec<f64>; 2]| [median(&times[0]).0, median(&times[1]).0];
    let (maps, cached) = (seconds(&with_maps), seconds(&with_cache));
    let exact_seconds = [exact[0].seconds, exact[1].seconds];
    for (k, &count) in counts.iter().enumerate() {
        for (what, shot, seconds) in [
            ("exact rays", &exact[k], exact_seconds[k]),
            ("a map a light", &last[k][0], maps[k]),
            ("three records, there already", &last[k][1], cached[k]),
        ] {
            let Ok(q) = quality(&shot.picture, &exact[k].picture) else {
                continue;
            };
            report.table(
                "One sample a pixel, equal numbers of virtual lights (Figs. 6 and 7)",
                &[
                    "scene",
                    "lights",
                    "answers by",
                    "seconds",
                    "FLIP",
                    "relMSE",
                    "energy change",
                ],
                vec![
                    name.into(),
                    count.to_string(),
                    what.into(),
                    fixed(seconds),
                    format!("{:.4}", q.flip),
                    format!("{:.2e}", q.relmse),
                    crate::quantized::percent(q.energy),
                ],
            );
        }
    }
    let slope = |seconds: [f64; 2]| (seconds[1] - seconds[0]) / f64::from(counts[1] - counts[0]);
    let gain = slope(maps) / slope(cached);
    report.row(Row {
        name: "virtual lights in equal time, against a map each".into(),
        scene: name.into(),
        value: gain,
        unit: "x (paper: 36x San Miguel, 7x Sibenik)".into(),
        baseline: Some(bound),
        ratio: Some(gain / bound),
        spread: None,
        bar: Some(">= 0.8 x bound (F + T c1)/(T c3)".into()),
        holds: Some(gain >= 0.8 * bound),
    });
    report.note(format!(
        "{name}: a further light takes {} ms with a map of its own, {} ms by three records, {} ms by exact rays",
        fixed(1e3 * slope(maps)),
        fixed(1e3 * slope(cached)),
        fixed(1e3 * slope(exact_seconds)),
    ));
}
