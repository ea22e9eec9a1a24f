//! Ray questions: rates on one core, and whole frames of image-space paths.

use super::Plan;
use super::stage::{Measured, bounces, placed, settings};
use crate::common::{Report, Row, Setting, median, thread_seconds};
use crate::quantized::figure;
use crate::quantized::quality::quality;
use crate::quantized::shot::{Shot, Stage, Task, interleave};
use crate::quantized::{fixed, percent};
use glam::Vec3;
use occlude_render::integrator::{Integrator, PathLimits, Secondary};
use occlude_visibility::records::{Cache, RayAnswer, RecordSettings, RecordsReader, Site};
use occlude_visibility::{Exact, Ray};

/// Questions that look into their records together, as the integrator has it.
const TOGETHER: usize = 64;

/// Processor seconds of answering all questions by records, and the share that records had no answer to.
fn by_records(cache: &Cache, reader: &mut RecordsReader, rays: &[(Site, Vec3)]) -> (f64, f64) {
    let began = thread_seconds();
    let mut unknown = 0usize;
    let mut sum = 0.0;
    for rays in rays.chunks(TOGETHER) {
        let mut aims = [None; TOGETHER];
        let mut texels = [0; TOGETHER];
        for (k, (&(site, direction), aim)) in rays.iter().zip(&mut aims).enumerate() {
            let nearby = cache.nearby(site.position, site.normal);
            let random = (k as f32 * 0.618).fract();
            *aim = cache.aim(reader, &nearby, direction, random, 1.0);
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
                Some(RayAnswer::Unknown) | None => unknown += 1,
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
    let cache = placed(stage, plan, settings(stage, plan, true));
    if rays.is_empty() || cache.is_empty() {
        return report.note(format!("{name}: nothing to ask"));
    }
    let mut reader = RecordsReader::default();
    cache.begin_reading(&mut reader);
    // What a worker learns of the records near its places, once for many passes.
    by_records(&cache, &mut reader, &rays);
    let traced: Vec<Ray> = rays
        .iter()
        .map(|(site, d)| Ray::new(site.origin, *d))
        .collect();
    let mut hits = vec![None; traced.len()];
    let (mut exact, mut cached, mut unknown) = (Vec::new(), Vec::new(), 0.0);
    for k in 0..plan.repetitions.max(3) {
        let began = thread_seconds();
        for (rays, hits) in traced.chunks(1024).zip(hits.chunks_mut(1024)) {
            stage.geometry.closest_batch(rays, hits);
        }
        exact.push(rays.len() as f64 / (thread_seconds() - began) / 1e6);
        let (seconds, share) = by_records(&cache, &mut reader, &rays);
        cached.push(rays.len() as f64 / seconds / 1e6);
        unknown = share;
        for (what, all) in [("exact", &exact), ("records", &cached)] {
            report.raw(&format!("rays,{name},{k},{what},{},Mrays/s", all[k]));
        }
    }
    let ((e, _), (c, spread)) = (median(&exact), median(&cached));
    report.row(Row {
        name: "secondary rays by records".into(),
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
        "{name}: records have no answer to {} of the rays",
        percent(unknown)
    ));
    drop(cache);

    let task = Task {
        integrator: Integrator::Path(PathLimits::new(8)),
        size: plan.half(),
        samples: plan.samples,
        seed: plan.seed,
        single_passes: false,
    };
    for from in [1, 2] {
        // As many as pay, and as coarse as the command has them for paths.
        let records = || {
            let settings = RecordSettings {
                capacity: plan.count / 8,
                steps: plan.count / 32,
                resolution: 64,
                ..settings(stage, plan, true)
            };
            Secondary::new(settings, from).expect("legal settings")
        };
        let mut kept: Option<Secondary> = None;
        let mut prepared = Vec::new();
        let (exact, cached) = interleave(
            plan.repetitions.min(2),
            || stage.shoot(&Exact, &task),
            || {
                let (shot, secondary, seconds) = stage.shoot_secondary(records(), &task);
                prepared.push(seconds);
                kept = Some(secondary);
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
        let steps = kept.and_then(|s| s.cache().map(|cache| cache.report().steps));
        let upkeep = steps.map_or(0.0, |s| s.total().as_secs_f64() / s.steps.max(1) as f64);
        let passes = 1.0 + (f64::from(plan.samples) - 1.0) / 4.0;
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
                "energy",
                "FLIP",
                "step a pass",
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
                percent(mean(c) / mean(e) - 1.0),
                fixed(q.flip),
                percent(upkeep * passes / (tc - ready).max(1e-9)),
            ],
        );
        let label = format!("{name}-from{from}");
        let shown = (label.as_str(), plan.samples);
        if let Err(error) = figure::show(setting, report, shown, e, c, &q) {
            report.note(format!("{name}: {error}"));
        }
    }
}
