//! Bidirectional path tracing with every connection through the cache (Popov 2013, section 4.2 and Fig. 5, top right).

use super::quality::quality;
use super::shot::{Stage, Task, interleave};
use super::subject::Subject;
use super::{Plan, fixed, percent, short};
use crate::common::{Report, Row, Setting};
use occlude_render::integrator::{BidirectionalLimits, Integrator};
use occlude_visibility::Exact;
use occlude_visibility::quantized::{ErrorReach, Guarantee};

const MAX_DEPTH: u32 = 6;
/// Where the paper has six times fewer rays.
const JUDGED: f32 = 12.0;
const BAR: f64 = 6.0;

const TITLE: &str = "Bidirectional path tracing";
const HEADER: &[&str] = &[
    "scene",
    "samples",
    "C_E",
    "questions",
    "rays /",
    "exact s",
    "cached s",
    "faster",
    "FLIP",
    "energy change",
    "mean",
];

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let (samples, reaches): (u32, &[f32]) = if setting.quick {
        (8, &[JUDGED])
    } else {
        (32, &[4.0, 8.0, JUDGED, 20.0, 28.0])
    };
    let task = Task {
        integrator: Integrator::Bidirectional(BidirectionalLimits::new(MAX_DEPTH)),
        size: plan.part(if setting.quick { 2 } else { 4 }),
        samples,
        seed: plan.seed,
        single_passes: false,
    };
    for &error in reaches {
        let cache = || {
            stage.quantized(&task, Guarantee::Bounded, |settings| {
                settings.error = ErrorReach::all(error);
            })
        };
        let repetitions = if error == JUDGED { plan.repetitions } else { 1 };
        let (exact, cached) = interleave(
            repetitions,
            || stage.shoot(&Exact, &task),
            || stage.shoot(&cache(), &task),
        );
        let (e, c) = (exact.last(), cached.last());
        let quality = match quality(&c.picture, &e.picture) {
            Ok(quality) => quality,
            Err(why) => return report.note(format!("{}: {why}", subject.name)),
        };
        let reduction = c.reduction();
        let ((exact_s, _), (cached_s, _)) = (exact.seconds(), cached.seconds());
        let mean = |picture: &occlude_image::Picture| picture.mean().iter().sum::<f64>();
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                samples.to_string(),
                error.to_string(),
                short(c.report.visibility.queries as f64),
                fixed(reduction),
                fixed(exact_s),
                fixed(cached_s),
                fixed(exact_s / cached_s),
                format!("{:.4}", quality.flip),
                percent(quality.energy),
                percent(mean(&c.picture) / mean(&e.picture) - 1.0),
            ],
        );
        for (what, value) in [
            ("reduction", reduction),
            ("exact_s", exact_s),
            ("cached_s", cached_s),
            ("flip", quality.flip),
        ] {
            report.raw(&format!(
                "bidirectional,{},{samples},C_E={error},,{what},{value:.6},",
                subject.name
            ));
        }
        if error == JUDGED {
            report.row(Row {
                name: format!("bidirectional, rays at C_E {error}"),
                scene: subject.name.into(),
                value: reduction,
                unit: "times fewer".into(),
                baseline: None,
                ratio: None,
                spread: None,
                bar: Some(format!(">= {BAR}")),
                holds: Some(reduction >= BAR),
            });
        }
    }
}
