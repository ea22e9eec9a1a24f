//! Does refinement pay? Error and spread of the importance over steps, by alpha (Figs. 5 and 10), against other placements.

use super::Plan;
use super::stage::{BlueNoise, settings, walks};
use crate::common::{Report, Row, Setting};
use crate::quantized::fixed;
use crate::quantized::plot::{Curve, Plot};
use crate::quantized::quality::quality;
use crate::quantized::shot::{Shot, Stage, Task, instant_radiosity};
use glam::Vec2;
use occlude_visibility::Exact;
use occlude_visibility::records::{Cache, RecordSettings, Records, Scout};

/// Weights of use: the paper's three (Fig. 10), and the default.
const ALPHAS: [f32; 4] = [0.6, 0.0, 0.5, 1.0];

/// How far the camera goes ahead at a time while records follow it (Fig. 5), in radii of the scene, if nothing stands in its way.
const STRIDE: f32 = 0.02;

/// Largest share of questions that rays may answer where errors of records are judged.
const MOST_BY_RAYS: f64 = 0.9;

/// What all pictures share.
struct Study<'s, 'a> {
    plan: &'s Plan,
    stage: &'s Stage<'a>,
    name: &'s str,
    task: Task,
    exact: Shot,
    count: u32,
}

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, name: &str, stage: &Stage) {
    let task = Task {
        integrator: instant_radiosity(8, plan.vpls / 4),
        size: plan.half(),
        samples: 1,
        seed: plan.seed,
        single_passes: false,
    };
    let study = Study {
        plan,
        stage,
        name,
        task,
        exact: stage.shoot(&Exact, &task),
        count: plan.count / 4,
    };
    let mut curves = Vec::new();
    let mut initial = f64::NAN;
    for alpha in ALPHAS {
        let usual = alpha == ALPHAS[0];
        let (mut points, mut by_rays) = (Vec::new(), 0.0);
        let steps: &[u32] = match (setting.quick, usual) {
            (true, true) => &[0, 250],
            (true, false) => &[250],
            (false, true) => &[0, 250, 500, 1000, 2000],
            (false, false) => &[500, 2000],
        };
        for &steps in steps {
            let records = Records::new(RecordSettings {
                capacity: study.count,
                steps,
                alpha,
                ..settings(stage, plan, false)
            })
            .expect("legal settings");
            let shot = study.shoot(report, &records, "camera paths, rejection", steps);
            let Some((error, traced)) = shot else {
                continue;
            };
            by_rays = traced;
            if steps == 0 {
                initial = error;
            }
            points.push((f64::from(steps), error));
        }
        if !usual {
            points.insert(0, (0.0, initial));
        }
        if usual && let Some(&(steps, last)) = points.last() {
            // Where rays answer nearly all, a small error says nothing about records.
            let says = by_rays <= MOST_BY_RAYS;
            if !says {
                report.note(format!(
                    "{name}: rays answered nearly everything, so the error over steps says nothing: more lights or pixels are needed"
                ));
            }
            report.row(Row {
                name: format!("relMSE after {steps} steps"),
                scene: name.into(),
                value: last,
                unit: String::new(),
                baseline: Some(initial),
                ratio: Some(last / initial),
                spread: None,
                bar: says.then(|| "<= 0.5 x initial".into()),
                holds: says.then_some(last <= 0.5 * initial),
            });
        }
        curves.push(Curve {
            name: format!("alpha {alpha}"),
            points,
            dashed: false,
        });
    }
    let blue = Records::new(RecordSettings {
        capacity: study.count,
        steps_per_picture: 0,
        ..settings(stage, plan, false)
    })
    .expect("legal settings");
    let mut scout = BlueNoise::new(&mut walks(stage, plan), study.count as usize);
    (blue.cache_mut()).place_initial(stage.geometry, &mut scout);
    if let Some((error, _)) = study.shoot(report, &blue, "blue noise", 0) {
        curves.push(Curve {
            name: "blue noise, no steps".into(),
            points: vec![(0.0, error), (2000.0, error)],
            dashed: true,
        });
    }
    let plot = Plot {
        title: &format!("{name}: instant radiosity, {} records", study.count),
        x: "refinement steps",
        log_x: false,
        log_y: true,
        curves: &curves,
    };
    report.figure(&format!("{name}: relMSE over refinement steps"), plot.svg());
    let rounds = if setting.quick { 3 } else { 16 };
    let curves = [
        study.spread(report, rounds, false),
        study.spread(report, rounds, true),
    ];
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

impl Study<'_, '_> {
    /// Renders by these records; a row of the table. The error, and the share of questions that rays answered.
    fn shoot(
        &self,
        report: &mut Report,
        records: &Records,
        placement: &str,
        steps: u32,
    ) -> Option<(f64, f64)> {
        let shot = self.stage.shoot(records, &self.task);
        let q = quality(&shot.picture, &self.exact.picture).ok()?;
        let (mean, variance) = records.cache().importance_spread();
        let alpha = records.cache().settings().alpha;
        let stats = &shot.report.visibility;
        let traced = stats.traced as f64 / stats.queries.max(1) as f64;
        report.table(
            "Instant radiosity over refinement steps (Figs. 5 and 10)",
            &[
                "scene",
                "records",
                "placed by",
                "alpha",
                "steps",
                "relMSE",
                "FLIP",
                "traced",
                "mean gamma",
                "variance",
                "coefficient of variation",
            ],
            vec![
                self.name.into(),
                records.cache().len().to_string(),
                placement.into(),
                alpha.to_string(),
                steps.to_string(),
                format!("{:.3e}", q.relmse),
                format!("{:.4}", q.flip),
                crate::quantized::percent(traced),
                fixed(mean),
                format!("{variance:.4}"),
                fixed(variance.sqrt() / mean),
            ],
        );
        report.raw(&format!(
            "refinement,{},0,relmse {placement} alpha {alpha} steps {steps},{},",
            self.name, q.relmse
        ));
        Some((q.relmse, traced))
    }

    /// Path-like use: spread of the importance over steps, while the camera stands still or moves a stride every 125 steps.
    fn spread(&self, report: &mut Report, rounds: u32, moving: bool) -> Curve {
        let mut cache = Cache::new(RecordSettings {
            capacity: self.count,
            ..settings(self.stage, self.plan, false)
        })
        .expect("legal settings");
        let mut scout = walks(self.stage, self.plan);
        cache.place_initial(self.stage.geometry, &mut scout);
        let asked = 4 * cache.len();
        let [width, height] = self.plan.size.map(|side| side as f32);
        let middle = (self.stage.view)(self.plan.size).ray(0.5 * Vec2::new(width, height));
        let ahead = middle.ray.direction.normalize();
        let what = if moving { "moving" } else { "still" };
        let mut points = Vec::new();
        for round in 0..=rounds {
            let mut pilots = Vec::new();
            scout.draw(asked, &mut pilots);
            cache.pilot(&pilots);
            let (mean, variance) = cache.importance_spread();
            let steps = 125 * round;
            points.push((f64::from(steps), variance.sqrt() / mean));
            report.raw(&format!(
                "refinement,{},0,{what} camera: coefficient of variation at {steps},{},",
                self.name,
                variance.sqrt() / mean
            ));
            if moving {
                scout.shift += STRIDE * self.stage.bounds.radius * ahead;
            }
            cache.refine_before(self.stage.geometry, 125, &mut |sites| {
                scout.draw(asked, sites);
            });
        }
        Curve {
            name: format!("{what} camera"),
            points,
            dashed: moving,
        }
    }
}
