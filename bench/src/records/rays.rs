//! Ray questions: rates on one core, and whole frames of image-space paths.

use super::stage::{Measured, bounces, placed, settings};
use super::{Plan, reasons};
use crate::common::{Report, Row, Setting, median, thread_seconds};
use crate::quantized::figure;
use crate::quantized::quality::quality;
use crate::quantized::shot::{Shot, Stage, Task, interleave};
use crate::quantized::{fixed, percent};
use glam::Vec3;
use occlude_render::integrator::{Integrator, PathLimits, Secondary};
use occlude_visibility::records::{
    Cache, DistanceTracer, Nearby, RayAnswer, RecordSettings, RecordsReader, Seen, Site,
};
use occlude_visibility::{Exact, Ray};

/// Secondary rays that are worth a record, as the command has it.
const RAYS_A_RECORD: f64 = 4e4;

/// Texels along the side of maps for paths, as the command has it.
const PATH_RESOLUTION: u32 = 64;

/// Questions that look into their records together, as the integrator has it.
const TOGETHER: usize = 64;

/// Processor seconds of answering all questions by records, and the share that records had no answer to.
fn by_records(cache: &Cache, reader: &mut RecordsReader, rays: &[(Site, Vec3)]) -> (f64, f64) {
    let began = thread_seconds();
    let mut unknown = 0usize;
    let mut sum = 0.0;
    for rays in rays.chunks(TOGETHER) {
        let mut nearby = [Nearby::NOBODY; TOGETHER];
        let mut aims = [None; TOGETHER];
        let mut texels = [0; TOGETHER];
        let places = std::array::from_fn::<_, TOGETHER, _>(|k| {
            let site = rays[k.min(rays.len() - 1)].0;
            (site.position, site.normal)
        });
        cache.nearby_many(&places[..rays.len()], &mut nearby);
        for (k, (&(_, direction), aim)) in rays.iter().zip(&mut aims).enumerate() {
            let random = (k as f32 * 0.618).fract();
            *aim = (cache.aim(reader, &nearby[k], direction, random, 1.0)).ok();
        }
        for (aim, texel) in aims.iter().zip(&mut texels) {
            if let Some(aim) = aim {
                *texel = cache.fetch(aim);
            }
        }
        for ((&(site, direction), aim), &texel) in rays.iter().zip(&aims).zip(&texels) {
            let answer = aim
                .as_ref()
                .map(|aim| cache.look(aim, texel, site.position, direction));
            match answer {
                Some(RayAnswer::Surface(surface)) => sum += surface.position.x + surface.albedo.x,
                Some(RayAnswer::Sky) => {}
                Some(RayAnswer::Unknown(_)) | None => unknown += 1,
            }
        }
    }
    std::hint::black_box(sum);
    (thread_seconds() - began, unknown as f64 / rays.len() as f64)
}

pub fn run(
    setting: &Setting,
    plan: &Plan,
    report: &mut Report,
    measured: &Measured,
    stage: &Stage,
) {
    let name = measured.subject.name;
    let count = if setting.quick { 1 << 14 } else { 1 << 18 };
    let rays = bounces(stage, plan, count);
    // As coarse as the command has them for paths, and as the paper has them.
    for resolution in [PATH_RESOLUTION, 128] {
        rates(plan, report, measured, stage, &rays, resolution);
    }

    let task = Task {
        integrator: Integrator::Path(PathLimits::new(8)),
        size: plan.half(),
        samples: 4 * plan.samples,
        seed: plan.seed,
        single_passes: false,
    };
    // As many as the command has: a record for so many rays.
    let paths = f64::from(task.size[0] * task.size[1] * task.samples);
    let count = (2.0 * paths / RAYS_A_RECORD).max(128.0) as u32;
    for from in [1, 2] {
        let records = || {
            let settings = RecordSettings {
                capacity: plan.count,
                initial: count,
                steps: count / 4,
                resolution: PATH_RESOLUTION,
                ..settings(stage, plan, true)
            };
            Secondary::new(settings, from).expect("legal settings")
        };
        let mut prepared = Vec::new();
        let (exact, cached) = interleave(
            plan.repetitions.min(2),
            || stage.shoot(&Exact, &task),
            || {
                let (shot, _, seconds) = stage.shoot_secondary(records(), &task);
                prepared.push(seconds);
                shot
            },
        );
        let (e, c) = (exact.last(), cached.last());
        let Ok(q) = quality(&c.picture, &e.picture) else {
            continue;
        };
        let mean = |shot: &Shot| {
            let sum: f32 = shot.picture.pixels.iter().flatten().sum();
            f64::from(sum)
        };
        let (te, tc) = (exact.seconds().0, cached.seconds().0);
        let ready = median(&prepared).0;
        report.table(
            "Image-space path tracing (Figs. 1 and 8)",
            &[
                "scene",
                "from",
                "exact s",
                "records s",
                "of it filling",
                "frame",
                "without filling",
                "rays asked",
                "traced",
                "of these: no record, below, unknown, near",
                "energy",
                "FLIP",
            ],
            vec![
                name.into(),
                from.to_string(),
                fixed(te),
                fixed(tc),
                fixed(ready),
                format!("x{}", fixed(te / tc)),
                format!("x{}", fixed(te / (tc - ready).max(1e-9))),
                c.report.secondary.asked.to_string(),
                percent(c.report.secondary.traced as f64 / c.report.secondary.asked.max(1) as f64),
                reasons(&c.report.secondary.unanswered),
                percent(mean(c) / mean(e) - 1.0),
                format!("{:.4}", q.flip),
            ],
        );
        let label = format!("{name}-from{from}");
        let shown = (label.as_str(), task.samples);
        if let Err(error) = figure::show(setting, report, shown, e, c, &q) {
            report.note(format!("{name}: {error}"));
        }
    }
    upkeep(plan, report, name, stage);
}

/// Millions of questions a second on one core, exact and by records, in turn.
fn rates(
    plan: &Plan,
    report: &mut Report,
    measured: &Measured,
    stage: &Stage,
    rays: &[(Site, Vec3)],
    resolution: u32,
) {
    let name = measured.subject.name;
    let settings = RecordSettings {
        resolution,
        ..settings(stage, plan, true)
    };
    let cache = placed(stage, plan, settings);
    if rays.is_empty() || cache.is_empty() {
        return report.note(format!("{name}: nothing to ask"));
    }
    let mut reader = RecordsReader::default();
    cache.begin_reading(&mut reader);
    // What a worker learns of the records near its places, once for many passes.
    by_records(&cache, &mut reader, rays);
    let traced: Vec<Ray> = rays
        .iter()
        .map(|(site, d)| Ray::new(site.origin, *d))
        .collect();
    let mut hits = vec![None; traced.len()];
    let mut seen = vec![Seen::NOTHING; traced.len()];
    let mut unknown = 0.0;
    let [mut exact, mut surfaces, mut cached] = [const { Vec::new() }; 3];
    for k in 0..plan.repetitions.max(3) {
        let mut rate = |what: &str, rates: &mut Vec<f64>, seconds: f64| {
            let rate = rays.len() as f64 / seconds / 1e6;
            report.raw(&format!(
                "rays,{name},{k},{what} {resolution},{rate},Mrays/s"
            ));
            rates.push(rate);
        };
        let began = thread_seconds();
        for (rays, hits) in traced.chunks(1024).zip(hits.chunks_mut(1024)) {
            stage.geometry.closest_batch(rays, hits);
        }
        rate("exact", &mut exact, thread_seconds() - began);
        let began = thread_seconds();
        for (rays, seen) in traced.chunks(1024).zip(seen.chunks_mut(1024)) {
            stage.geometry.surfaces(rays, seen);
        }
        rate(
            "exact with normal and albedo",
            &mut surfaces,
            thread_seconds() - began,
        );
        let (seconds, share) = by_records(&cache, &mut reader, rays);
        rate("records", &mut cached, seconds);
        unknown = share;
    }
    let ((e, _), (s, _), (c, spread)) = (median(&exact), median(&surfaces), median(&cached));
    report.row(Row {
        name: format!("secondary rays by records, {resolution} texels"),
        scene: name.into(),
        value: c,
        unit: "Mrays/s, a core".into(),
        baseline: Some(e),
        ratio: Some(c / e),
        spread: Some(spread),
        bar: measured.rays_bar.map(|bar| format!(">= {bar} x")),
        holds: measured.rays_bar.map(|bar| c / e >= bar),
    });
    report.note(format!(
        "{name}, {resolution} texels: records have no answer to {} of the rays; against exact rays that find normal and albedo, too, as records do, {} Mrays/s: x{}",
        percent(unknown),
        fixed(s),
        fixed(c / s),
    ));
}

/// What all the records there may be take between passes, one step included.
fn upkeep(plan: &Plan, report: &mut Report, name: &str, stage: &Stage) {
    let task = Task {
        integrator: Integrator::Path(PathLimits::new(8)),
        size: plan.size,
        samples: plan.samples,
        seed: plan.seed,
        single_passes: false,
    };
    let records = RecordSettings {
        resolution: PATH_RESOLUTION,
        pace: 1,
        ..settings(stage, plan, true)
    };
    let secondary = Secondary::new(records, 1).expect("legal settings");
    let (shot, secondary, ready) = stage.shoot_secondary(secondary, &task);
    let made = secondary.report().records;
    let (steps, upkeep) = (made.steps.steps, made.upkeep.as_secs_f64());
    // `ready` counts all steps.
    let frame = shot.seconds - ready + made.steps.total().as_secs_f64();
    report.row(Row {
        name: format!("upkeep of {} records in {steps} passes", made.count),
        scene: name.into(),
        value: 100.0 * upkeep / frame,
        unit: format!("% of {} s (paper: 0.36)", fixed(frame)),
        baseline: None,
        ratio: None,
        spread: None,
        bar: Some("<= 0.4, a step a pass".into()),
        holds: Some(upkeep <= 4e-3 * frame && steps > 0),
    });
}
