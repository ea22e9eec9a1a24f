//! Nearest and probable, snapping and marching (Fig. 9), near field, and the two spatial terms of Eq. 2.

use super::Plan;
use super::stage::{placed, settings, walks};
use crate::common::Report;
use crate::quantized::quality::quality;
use crate::quantized::shot::{Stage, Task, instant_radiosity};
use crate::quantized::{fixed, percent};
use occlude_render::integrator::{Integrator, PathLimits, Secondary};
use occlude_visibility::Exact;
use occlude_visibility::records::{Falloff, Lookup, RecordSettings, Records, Scout, Select};

pub fn run(plan: &Plan, report: &mut Report, name: &str, stage: &Stage) {
    let count = plan.count / 4;
    let instant = Task {
        integrator: instant_radiosity(8, plan.vpls / 4),
        size: plan.half(),
        samples: 1,
        seed: plan.seed,
        single_passes: false,
    };
    let path = Task {
        integrator: Integrator::Path(PathLimits::new(8)),
        samples: plan.samples.min(8),
        ..instant
    };
    let exact = [stage.shoot(&Exact, &instant), stage.shoot(&Exact, &path)];
    let modes = [
        (Select::Nearest, Lookup::Snap, 4.0, 0.0),
        (Select::Probable, Lookup::Snap, 4.0, 0.0),
        (Select::Nearest, Lookup::March, 4.0, 0.0),
        (Select::Probable, Lookup::March, 4.0, 0.0),
        (Select::Probable, Lookup::Plane, 4.0, 0.0),
        // Near field: nothing traced, and short rays at both ends.
        (Select::Probable, Lookup::Snap, 0.0, 0.0),
        (Select::Probable, Lookup::Snap, 4.0, 1.0),
    ];
    for (select, lookup, contact, near) in modes {
        let settings = || RecordSettings {
            capacity: count,
            select,
            lookup,
            contact,
            near,
            pace: 0,
            ..settings(stage, plan, false)
        };
        let records = Records::new(settings()).expect("legal settings");
        let mut shots = vec![(
            "instant radiosity",
            stage.shoot(&records, &instant),
            &exact[0],
        )];
        drop(records);
        let secondary = Secondary::new(settings(), 1).expect("legal settings");
        let (shot, ..) = stage.shoot_secondary(secondary, &path);
        shots.push(("paths", shot, &exact[1]));
        for (what, shot, exact) in shots {
            let Ok(q) = quality(&shot.picture, &exact.picture) else {
                continue;
            };
            let stats = &shot.report.visibility;
            report.table(
                &format!("Ways to ask (Fig. 9), {count} records, no refinement"),
                &[
                    "scene",
                    "integrator",
                    "select",
                    "lookup",
                    "contact",
                    "near",
                    "relMSE",
                    "FLIP",
                    "energy change",
                    "shadow rays traced",
                    "seconds",
                ],
                vec![
                    name.into(),
                    what.into(),
                    format!("{select:?}").to_lowercase(),
                    format!("{lookup:?}").to_lowercase(),
                    fixed(f64::from(contact)),
                    fixed(f64::from(near)),
                    format!("{:.3e}", q.relmse),
                    format!("{:.4}", q.flip),
                    percent(q.energy),
                    percent(stats.traced as f64 / stats.queries.max(1) as f64),
                    fixed(shot.seconds),
                ],
            );
        }
    }
    // How well does each form of Eq. 2 predict the measured correlation of the neighbours that it picks?
    for falloff in [Falloff::Printed, Falloff::ToZero] {
        let mut cache = placed(
            stage,
            plan,
            RecordSettings {
                capacity: count,
                falloff,
                ..settings(stage, plan, false)
            },
        );
        let mut pilots = Vec::new();
        walks(stage, plan).draw(1000, &mut pilots);
        cache.pilot(&pilots);
        let pairs = cache.predictions(falloff);
        let n = pairs.len().max(1) as f64;
        let mean = |f: &dyn Fn(&(f32, f32)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
        let (mw, mc) = (mean(&|p| f64::from(p.0)), mean(&|p| f64::from(p.1)));
        let cov = mean(&|p| (f64::from(p.0) - mw) * (f64::from(p.1) - mc));
        let vw = mean(&|p| (f64::from(p.0) - mw).powi(2));
        let vc = mean(&|p| (f64::from(p.1) - mc).powi(2));
        report.table(
            "Spatial term of Eq. 2: does the weight predict the correlation?",
            &[
                "scene",
                "term",
                "mean correlation of neighbours",
                "Pearson's r",
            ],
            vec![
                name.into(),
                format!("{falloff:?}"),
                fixed(mc),
                fixed(cov / (vw * vc).sqrt()),
            ],
        );
    }
}
