//! Filling a map, and a refinement step by its parts: Table 1.

use super::Plan;
use super::stage::{SUBJECTS, placed, settings, walks};
use crate::common::{Report, Row, median, thread_seconds};
use crate::quantized::fixed;
use crate::quantized::shot::Stage;
use occlude_visibility::records::Scout;

/// Steps that are timed.
const STEPS: u32 = 100;

/// What the paper gives for the parts, milliseconds (bedroom, 790 thousand triangles, 4000 records, GPU).
const PAPER: [f64; 6] = [0.042, 0.044, 0.711, 0.164, 19.843, 0.035];

pub fn run(plan: &Plan, report: &mut Report, name: &str, stage: &Stage) {
    let mut cache = placed(stage, plan, settings(stage, plan, false));
    if cache.is_empty() {
        return report.note(format!("{name}: no place for records"));
    }
    let views = cache.views();
    let sites: Vec<_> = views
        .iter()
        .step_by(views.len().div_ceil(100))
        .map(|v| v.site)
        .collect();
    let mut times = Vec::new();
    for (k, &site) in sites.iter().enumerate() {
        let began = thread_seconds();
        let seen = cache.measure_fill(stage.geometry, site);
        let ms = (thread_seconds() - began) * 1e3;
        assert!(seen.is_finite());
        report.raw(&format!("fill,{name},{k},map,{ms},ms"));
        times.push(ms);
    }
    let (fill, spread) = median(&times);
    let bar = SUBJECTS
        .iter()
        .find(|s| s.subject.name == name)
        .and_then(|s| s.fill_bar);
    report.row(Row {
        name: "fill a 128x128 record".into(),
        scene: name.into(),
        value: fill,
        unit: "ms, one core".into(),
        baseline: Some(PAPER[4]),
        ratio: Some(fill / PAPER[4]),
        spread: Some(spread),
        bar: bar.map(|bar| format!("<= {bar}")),
        holds: bar.map(|bar| fill <= bar),
    });
    let mut walks = walks(stage, plan);
    let count = 4 * cache.len();
    let mut pilots = Vec::new();
    walks.draw(count, &mut pilots);
    cache.pilot(&pilots);
    let before = cache.report();
    for _ in 0..STEPS {
        cache.refine(stage.geometry);
    }
    let after = cache.report();
    let steps = (after.steps.steps - before.steps.steps).max(1) as f64;
    let placed = (after.steps.placed - before.steps.placed).max(1) as f64;
    let ms =
        |a: std::time::Duration, b: std::time::Duration, n: f64| (a - b).as_secs_f64() * 1e3 / n;
    let (a, b) = (after.steps, before.steps);
    let parts = [
        ("find records i and j", ms(a.find, b.find, steps)),
        ("place record k", ms(a.place, b.place, steps)),
        ("update the search tree", ms(a.tree, b.tree, placed)),
        (
            "mark and find neighbours",
            ms(a.neighbours, b.neighbours, placed),
        ),
        ("fill the map", ms(a.fill, b.fill, placed)),
        ("correlation", ms(a.correlation, b.correlation, placed)),
    ];
    for ((what, ms), paper) in parts.iter().zip(PAPER) {
        report.raw(&format!("fill,{name},0,{what},{ms},ms"));
        report.table(
            "A refinement step (Table 1), milliseconds of the clock; the map by all threads",
            &["scene", "records", "operation", "ms", "paper's ms (GPU)"],
            vec![
                name.into(),
                cache.len().to_string(),
                (*what).into(),
                format!("{ms:.4}"),
                format!("{paper}"),
            ],
        );
    }
    let rest: f64 = parts.iter().map(|part| part.1).sum::<f64>() - parts[4].1;
    let step = fill + rest;
    report.row(Row {
        name: "refinement step".into(),
        scene: name.into(),
        value: step,
        unit: "ms, one core".into(),
        baseline: Some(fill),
        ratio: Some(step / fill),
        spread: None,
        bar: Some("<= 1.2 x fill".into()),
        holds: Some(step <= 1.2 * fill),
    });
    report.note(format!(
        "{name}: a step that found a place: {} of {STEPS}",
        fixed(placed)
    ));
}
