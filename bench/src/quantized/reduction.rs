//! Fewer rays, less time, at which error: a row for each scene and number of samples.

use super::figure;
use super::measured::{self, Measured, Part};
use super::quality::quality;
use super::shot::{Shot, Stage, Task, interleave};
use super::subject::Subject;
use super::{Plan, fixed, percent, short};
use crate::common::{Report, Row, Setting};
use occlude_render::geometry::Geometry;
use occlude_render::integrator::Integrator;
use occlude_visibility::quantized::Guarantee;
use occlude_visibility::{Exact, Visibility};
use std::cell::Cell;

/// Mean FLIP that still counts as the same picture.
const SAME: f64 = 0.02;
/// Share of the bound that is to be reached.
const OF_THE_BOUND: f64 = 0.6;

const TITLE: &str = "Rays, time and error against exact visibility with the same samples";
const HEADER: &[&str] = &[
    "scene",
    "samples",
    "questions",
    "rays exact",
    "rays cached",
    "rays /",
    "exact s",
    "cached s",
    "faster",
    "spread",
    "faster, processor time",
    "cores at work",
    "FLIP",
    "FLIP 99 %",
    "worst block",
    "energy change",
    "refined by level",
    "ns query",
    "ns miss",
    "ns ray, coherent",
    "ns shading",
    "shading-only limit",
    "frame without rays",
    "bound",
    "of the bound",
    "bound if memory were free",
];

/// What goes into the parts of renderings, summed over them.
#[derive(Default)]
struct Clocked {
    part: Cell<Part>,
    cpu_seconds: Cell<f64>,
}

impl Clocked {
    fn shoot<'a, V: Visibility<Geometry<'a>> + Visibility<measured::Clocked<Geometry<'a>>>>(
        &self,
        stage: &Stage<'a>,
        visibility: &V,
        task: &Task,
    ) -> Shot {
        let measured = Measured::new(visibility);
        let shot = stage.shoot(&measured, task);
        let mut part = self.part.get();
        part.add(&measured.ledger().all().scaled(shot.busy()));
        self.part.set(part);
        self.cpu_seconds
            .set(self.cpu_seconds.get() + shot.cpu_seconds);
        shot
    }
}

/// Measures a scene; shows its pictures if they are wanted.
pub fn run(
    setting: &Setting,
    plan: &Plan,
    report: &mut Report,
    subject: &Subject,
    stage: &Stage,
    pictures: bool,
) {
    let samples = plan.samples.clone();
    for (index, &samples) in samples.iter().enumerate() {
        let task = Task {
            integrator: subject.integrator(setting),
            size: plan.size,
            samples,
            seed: plan.seed,
            single_passes: false,
        };
        let cache = || stage.quantized(&task, Guarantee::Bounded, |_| ());
        let (exact_parts, cached_parts) = (Clocked::default(), Clocked::default());
        let clocked_exact = || exact_parts.shoot(stage, &Exact, &task);
        let clocked_cached = || cached_parts.shoot(stage, &cache(), &task);
        let (exact, cached) = if matches!(task.integrator, Integrator::InstantRadiosity(_)) {
            // Questions come by the thousand, so that the clocks cost nothing that can be measured.
            interleave(plan.repetitions, clocked_exact, clocked_cached)
        } else {
            let plain = interleave(
                plan.repetitions,
                || stage.shoot(&Exact, &task),
                || stage.shoot(&cache(), &task),
            );
            clocked_exact();
            clocked_cached();
            plain
        };
        let (e, c) = (exact_parts.part.get(), cached_parts.part.get());

        let (exact_stats, cached_stats) = (
            &exact.last().report.visibility,
            &cached.last().report.visibility,
        );
        if exact_stats.queries != cached_stats.queries {
            report.note(format!(
                "{}: exact asks {} questions, cached {}: these are different pictures",
                subject.name, exact_stats.queries, cached_stats.queries
            ));
        }
        for (side, series) in [("exact", &exact), ("cached", &cached)] {
            for (repetition, shot) in series.0.iter().enumerate() {
                for (what, value) in [("wall", shot.seconds), ("cpu", shot.cpu_seconds)] {
                    report.raw(&format!(
                        "reduction,{},{samples},{side},{repetition},{what},{value:.4},s",
                        subject.name
                    ));
                }
            }
        }
        let quality = match quality(&cached.last().picture, &exact.last().picture) {
            Ok(quality) => quality,
            Err(why) => return report.note(format!("{}: {why}", subject.name)),
        };
        let reduction = cached.last().reduction();
        let (exact_s, exact_spread) = exact.seconds();
        let (cached_s, cached_spread) = cached.seconds();
        let faster = exact_s / cached_s;
        let (shade, ray) = (e.shading_ns(), e.ray_ns());
        let (query, miss) = (c.query_ns(), c.ray_ns());
        // Paths shade outside of the clocked calls: there is no bound by these costs then.
        let shade = if shade > 0.0 { shade } else { f64::NAN };
        let bound = (shade + ray) / (shade + query + miss / reduction);
        let exact_cpu = exact_parts.cpu_seconds.get();
        let without_rays = exact_cpu / (exact_cpu - e.rays).max(1e-9);
        // Costs are processor time, so this is too: other programs disturb it less than the clock.
        let faster_cpu = exact.cpu_seconds() / cached.cpu_seconds();
        let busy = exact.last().busy().min(cached.last().busy());
        let of_the_bound = faster_cpu / bound;
        // What a memory that costs nothing, and misses as coherent as all rays, would allow.
        let free_memory = (shade + ray) / (shade + ray / reduction);
        let refined: Vec<String> = cached_stats
            .refined
            .iter()
            .map(|&n| percent(n as f64 / cached_stats.queries as f64))
            .collect();
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                samples.to_string(),
                short(cached_stats.queries as f64),
                short(exact_stats.traced as f64),
                short(cached_stats.traced as f64),
                fixed(reduction),
                fixed(exact_s),
                fixed(cached_s),
                fixed(faster),
                format!("{:.2}", exact_spread.max(cached_spread)),
                fixed(faster_cpu),
                percent(busy),
                format!("{:.4}", quality.flip),
                format!("{:.3}", quality.flip_99),
                format!("{:.3}", quality.flip_block),
                percent(quality.energy),
                refined.join(" "),
                fixed(query),
                fixed(miss),
                fixed(ray),
                fixed(shade),
                fixed((shade + ray) / shade),
                fixed(without_rays),
                fixed(bound),
                percent(of_the_bound),
                fixed(free_memory),
            ],
        );
        for (what, value, unit) in [
            ("queries", cached_stats.queries as f64, "1"),
            ("traced", cached_stats.traced as f64, "1"),
            ("flip", quality.flip, "1"),
            ("flip_99", quality.flip_99, "1"),
            ("flip_block", quality.flip_block, "1"),
            ("energy_change", quality.energy, "1"),
            ("ssim", quality.ssim, "1"),
            ("relmse", quality.relmse, "1"),
            ("query", query, "ns"),
            ("miss", miss, "ns"),
            ("ray", ray, "ns"),
            ("shading", shade, "ns"),
            ("bound", bound, "1"),
            ("bound_free_memory", free_memory, "1"),
        ] {
            report.raw(&format!(
                "reduction,{},{samples},cached,,{what},{value:.6},{unit}",
                subject.name
            ));
        }
        let same = quality.flip <= SAME;
        let mut row = |name: &str, value: f64, unit: &str, bar: Option<String>, holds: bool| {
            report.row(Row {
                name: format!("{name}, {samples} samples"),
                scene: subject.name.into(),
                value,
                unit: unit.into(),
                baseline: None,
                ratio: None,
                spread: None,
                holds: bar.is_some().then_some(holds),
                bar,
            });
        };
        let at = format!("at FLIP <= {SAME}");
        let [rays, speed] = subject.bars;
        row(
            "ray reduction",
            reduction,
            "times fewer",
            rays.map(|bar| format!(">= {bar} {at}")),
            same && rays.is_some_and(|bar| reduction >= bar),
        );
        row(
            "speedup",
            faster,
            "times faster",
            speed.map(|bar| format!(">= {bar} {at}")),
            same && speed.is_some_and(|bar| faster >= bar),
        );
        row(
            "share of the bound",
            of_the_bound,
            "",
            subject
                .bars
                .iter()
                .any(Option::is_some)
                .then(|| format!(">= {OF_THE_BOUND}")),
            of_the_bound >= OF_THE_BOUND,
        );
        row("FLIP", quality.flip, "", Some(format!("<= {SAME}")), same);
        if pictures
            && index == 0
            && let Err(why) = figure::show(
                setting,
                report,
                (subject.name, samples),
                exact.last(),
                cached.last(),
                &quality,
            )
        {
            report.note(why);
        }
        report.save();
    }
}
