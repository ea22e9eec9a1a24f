//! The consistent guarantee: the error falls without a floor as passes are added, and rays stay few.

use super::measured::Measured;
use super::plot::{Curve, Plot};
use super::shot::{Stage, Task, instant_radiosity, picture};
use super::subject::Subject;
use super::{Plan, fixed};
use crate::common::{Report, Row, Setting};
use occlude_image::Picture;
use occlude_image::metrics::relmse;
use occlude_visibility::Exact;
use occlude_visibility::quantized::Guarantee;

/// How many times fewer rays the last passes must take.
const BAR: f64 = 20.0;

const TITLE: &str = "Consistent: passes of one sample a pixel";
const HEADER: &[&str] = &[
    "scene",
    "passes",
    "relMSE against exact, same samples",
    "of bounded",
    "relMSE against all passes, exact",
    "exact itself",
    "rays / so far",
    "rays / since the former row",
];

/// What a side shows after some passes.
struct Stop {
    passes: u32,
    picture: Picture,
    queries: u64,
    traced: u64,
}

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let passes = if setting.quick { 16 } else { 256 };
    let vpls = if setting.quick { 16 } else { 64 };
    let task = Task {
        integrator: instant_radiosity(subject.max_depth, vpls),
        size: if setting.quick {
            [48, 36]
        } else {
            plan.size.map(|side| side / 4)
        },
        samples: passes,
        seed: plan.seed,
        single_passes: true,
    };
    let cache = |guarantee| stage.quantized(&task, guarantee, |_| ());
    let exact = watch(stage, &Exact, &task);
    let cached = watch(stage, &cache(Guarantee::Consistent), &task);
    let bounded = watch(stage, &cache(Guarantee::Bounded), &task);
    let Some(truth) = exact.last() else {
        return report.note(format!("{}: no passes", subject.name));
    };
    let curve = |name: &str| Curve {
        name: name.into(),
        points: Vec::new(),
        dashed: false,
    };
    let mut curves = [
        curve("consistent"),
        curve("bounded"),
        curve("exact, to all passes"),
    ];
    let mut rays = curve("consistent");
    let (mut queries, mut traced) = (0, 0);
    let mut errors = Vec::new();
    let mut last = f64::NAN;
    for ((e, c), b) in exact.iter().zip(&cached).zip(&bounded) {
        let error = |a: &Picture, b: &Picture| relmse(a, b).unwrap_or(f64::NAN);
        let own = error(&c.picture, &e.picture);
        let of_bounded = error(&b.picture, &e.picture);
        let noise = error(&e.picture, &truth.picture);
        let so_far = c.queries as f64 / c.traced.max(1) as f64;
        last = (c.queries - queries) as f64 / (c.traced - traced).max(1) as f64;
        (queries, traced) = (c.queries, c.traced);
        let scientific = |v: f64| format!("{v:.2e}");
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                c.passes.to_string(),
                scientific(own),
                scientific(of_bounded),
                scientific(error(&c.picture, &truth.picture)),
                scientific(noise),
                fixed(so_far),
                fixed(last),
            ],
        );
        for (what, value) in [
            ("relmse", own),
            ("relmse_bounded", of_bounded),
            ("reduction", last),
        ] {
            report.raw(&format!(
                "consistent,{},{},cached,,{what},{value:.6e},1",
                subject.name, c.passes
            ));
        }
        let x = f64::from(c.passes);
        for (curve, value) in curves.iter_mut().zip([own, of_bounded, noise]) {
            curve.points.push((x, value));
        }
        rays.points.push((x, last));
        errors.push(own);
    }
    let svgs = [
        Plot {
            title: "relMSE against exact with the same samples",
            x: "passes",
            log_x: true,
            log_y: true,
            curves: &curves,
        },
        Plot {
            title: "times fewer rays, of the passes up to here",
            x: "passes",
            log_x: true,
            log_y: true,
            curves: &[rays],
        },
    ]
    .map(|plot| plot.svg());
    let path = setting.out.join(format!("consistent-{}.svg", subject.name));
    if let Err(error) = std::fs::write(&path, &svgs[0]) {
        report.note(format!("{}: {error}", path.display()));
    }
    report.figure(
        &format!(
            "{}: error and rays over the passes of the consistent guarantee",
            subject.name
        ),
        svgs.concat(),
    );
    let mut row = |name: &str, value: f64, unit: &str, bar: String, holds: bool| {
        report.row(Row {
            name: name.into(),
            scene: subject.name.into(),
            value,
            unit: unit.into(),
            baseline: None,
            ratio: None,
            spread: None,
            bar: Some(bar),
            holds: Some(holds),
        });
    };
    row(
        &format!("consistent, rays of the last passes, of {passes}"),
        last,
        "times fewer",
        format!(">= {BAR}"),
        last >= BAR,
    );
    if let [.., before, end] = errors[..] {
        row(
            "consistent, error, last doubling of the passes",
            end / before,
            "",
            "< 1".into(),
            end < before,
        );
    }
}

/// Renders pass by pass and keeps what there is at powers of two.
fn watch<'a, V>(stage: &Stage<'a>, strategy: &V, task: &Task) -> Vec<Stop>
where
    V: occlude_visibility::Visibility<
            super::measured::Clocked<occlude_render::geometry::Geometry<'a>>,
        >,
{
    let measured = Measured::new(strategy);
    let mut stops = Vec::new();
    stage.watch(&measured, task, &mut |film| {
        let passes = film.min_samples();
        if passes.is_power_of_two() {
            let all = measured.ledger().all();
            stops.push(Stop {
                passes,
                picture: picture(film),
                queries: all.queries,
                traced: all.traced,
            });
        }
    });
    stops
}
