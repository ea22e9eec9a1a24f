//! Does refinement pay? Error and spread of the importance over steps, by alpha (Figs. 5 and 10).

use super::Plan;
use super::stage::{settings, walks};
use crate::common::{Report, Row, Setting};
use crate::quantized::fixed;
use crate::quantized::plot::{Curve, Plot};
use crate::quantized::quality::quality;
use crate::quantized::shot::{Stage, Task, instant_radiosity};
use occlude_visibility::Exact;
use occlude_visibility::records::{Cache, RecordSettings, Records, Scout};

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, name: &str, stage: &Stage) {
    let task = Task {
        integrator: instant_radiosity(8, plan.vpls / 4),
        size: plan.half(),
        samples: 1,
        seed: plan.seed,
        single_passes: false,
    };
    let exact = stage.shoot(&Exact, &task);
    let count = plan.count / 4;
    let mut curves = Vec::new();
    let mut halves = (f64::NAN, f64::NAN);
    for alpha in [0.0, 0.5, 1.0] {
        let mut points = Vec::new();
        for steps in [0, 250, 500, 1000, 2000] {
            if setting.quick && steps > 250 || steps == 0 && alpha != 0.5 {
                continue;
            }
            let records = Records::new(RecordSettings {
                capacity: count,
                steps,
                alpha,
                ..settings(stage, plan, false)
            })
            .expect("legal settings");
            let shot = stage.shoot(&records, &task);
            let Ok(q) = quality(&shot.picture, &exact.picture) else {
                continue;
            };
            let (mean, variance) = records.cache().importance_spread();
            report.table(
                "Instant radiosity over refinement steps (Figs. 5 and 10)",
                &[
                    "scene",
                    "records",
                    "alpha",
                    "steps",
                    "relMSE",
                    "FLIP",
                    "mean gamma",
                    "variance",
                    "coefficient of variation",
                ],
                vec![
                    name.into(),
                    count.to_string(),
                    alpha.to_string(),
                    steps.to_string(),
                    format!("{:.3e}", q.relmse),
                    format!("{:.4}", q.flip),
                    fixed(mean),
                    format!("{variance:.4}"),
                    fixed(variance.sqrt() / mean),
                ],
            );
            report.raw(&format!(
                "refinement,{name},0,relmse alpha {alpha} steps {steps},{},",
                q.relmse
            ));
            points.push((f64::from(steps), q.relmse));
            if alpha == 0.5 {
                if steps == 0 {
                    halves.0 = q.relmse;
                }
                halves.1 = q.relmse;
            }
        }
        curves.push(Curve {
            name: format!("alpha {alpha}"),
            points,
            dashed: false,
        });
    }
    report.row(Row {
        name: "relMSE after the most steps".into(),
        scene: name.into(),
        value: halves.1,
        unit: String::new(),
        baseline: Some(halves.0),
        ratio: Some(halves.1 / halves.0),
        spread: None,
        bar: Some("<= 0.5 x initial".into()),
        holds: Some(halves.1 <= 0.5 * halves.0),
    });
    let plot = Plot {
        title: &format!("{name}: instant radiosity, {count} records"),
        x: "refinement steps",
        log_x: false,
        log_y: true,
        curves: &curves,
    };
    report.figure(&format!("{name}: relMSE over refinement steps"), plot.svg());

    // Path-like use, spread over steps: the camera stands still.
    let mut cache = Cache::new(RecordSettings {
        capacity: count,
        ..settings(stage, plan, false)
    })
    .expect("legal settings");
    let mut scout = walks(stage, plan);
    cache.place_initial(stage.geometry, &mut scout);
    let asked = 4 * cache.len();
    let mut points = Vec::new();
    let mut done = 0;
    let rounds = if setting.quick { 3 } else { 16 };
    for _ in 0..=rounds {
        let mut pilots = Vec::new();
        scout.draw(asked, &mut pilots);
        cache.pilot(&pilots);
        let (mean, variance) = cache.importance_spread();
        points.push((f64::from(done), variance.sqrt() / mean));
        cache.refine_before(stage.geometry, 125, &mut |sites| scout.draw(asked, sites));
        done += 125;
    }
    let curves = [Curve {
        name: "still camera".into(),
        points,
        dashed: false,
    }];
    let plot = Plot {
        title: &format!("{name}: coefficient of variation of gamma"),
        x: "refinement steps",
        log_x: false,
        log_y: false,
        curves: &curves,
    };
    report.figure(
        &format!("{name}: spread of the importance (Fig. 5)"),
        plot.svg(),
    );
}
