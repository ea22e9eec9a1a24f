//! Instant radiosity: a map a virtual light, three records a light, exact rays (Figs. 6 and 7).

use super::per_light::{self, map_per_light};
use super::stage::{Measured, Random, settings, walks};
use super::{Plan, reasons};
use crate::common::{Report, Row, Setting, median, thread_seconds};
use crate::quantized::figure;
use crate::quantized::quality::quality;
use crate::quantized::shot::{Shot, Stage, Task, instant_radiosity, interleave};
use crate::quantized::{fixed, percent};
use glam::Vec2;
use occlude_visibility::records::{
    DistanceTracer, PathSite, Placement, RecordSettings, Records, Scout,
};
use occlude_visibility::{
    BLOCK, Correction, Endpoint, Exact, EyeSample, LightEnd, ManyLights, Session, SharedLight,
    Visibility,
};

pub fn run(
    setting: &Setting,
    plan: &Plan,
    report: &mut Report,
    measured: &Measured,
    stage: &Stage,
) {
    let name = measured.subject.name;
    if let Some(bound) = costs(setting, plan, report, name, stage) {
        per_light::frames(plan, report, name, stage, bound);
    }
    // What the command does, in its own resolution and in others; and what the paper does, along paths with as many records as pay: filling 4000
    // takes longer than tracing the frame.
    let usual = settings(stage, plan, false);
    for resolution in [usual.resolution, 64, 256] {
        let on_lights = RecordSettings {
            placement: Placement::Lights,
            resolution,
            ..usual.clone()
        };
        frames(setting, plan, report, measured, stage, &on_lights);
    }
    let along_paths = RecordSettings {
        capacity: plan.count / 4,
        steps: plan.count / 16,
        ..usual
    };
    frames(setting, plan, report, measured, stage, &along_paths);
}

/// Eyes that ask together.
const TILE: usize = 1024;

/// Eyes of some tiles, and lights at the vertices of paths.
struct Questions {
    eyes: Vec<EyeSample>,
    lights: Vec<SharedLight>,
    /// Who asks about whom, tile by tile: see [`Facing`].
    sets: Vec<Vec<Vec<u16>>>,
    asked: u64,
    /// Questions of all pixels about a light.
    of_a_light: f64,
}

/// Eyes of a tile that ask about the lights that they face and that face them, as the integrator does: sets of lights, an eye at a
/// time, block after block.
struct Facing<'q> {
    sets: &'q [Vec<u16>],
    seen: f32,
}

impl ManyLights for Facing<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        wanted.copy_from_slice(&self.sets[block]);
    }

    fn take(&mut self, _: usize, visible: &[u16], corrections: &[Correction]) {
        self.seen += visible
            .iter()
            .map(|set| set.count_ones() as f32)
            .sum::<f32>();
        self.seen += corrections.iter().map(|one| one.amount).sum::<f32>();
    }
}

/// Whether light can go from one to the other.
fn faces(eye: &Endpoint, light: &SharedLight) -> bool {
    let LightEnd::Surface(there) = light.end else {
        return false;
    };
    let way = there.position - eye.position;
    eye.normal.dot(way) > 0.0 && there.normal.dot(way) < 0.0
}

fn questions(setting: &Setting, plan: &Plan, stage: &Stage) -> Questions {
    let mut random = Random(9);
    let view = (stage.view)(plan.size);
    let tiles = if setting.quick { 2 } else { 8 };
    let mut rays = Vec::new();
    for _ in 0..tiles {
        let corner = Vec2::new(random.unit(), random.unit())
            * Vec2::new(plan.size[0] as f32 - 32.0, plan.size[1] as f32 - 32.0);
        for k in 0..1024 {
            let at = corner + Vec2::new((k % 32) as f32 + 0.5, (k / 32) as f32 + 0.5);
            rays.push(view.ray(at).ray);
        }
    }
    let mut sites = vec![None; rays.len()];
    stage.geometry.sites(&rays, &mut sites);
    let eyes: Vec<EyeSample> = (sites.iter().flatten())
        .map(|site| EyeSample {
            end: Endpoint::new(site.position, site.normal, 1.0),
            origin: site.origin,
        })
        .collect();
    let mut vertices = Vec::new();
    walks(stage, plan).draw(1024, &mut vertices);
    let lights: Vec<SharedLight> = (vertices.iter())
        .map(|place| {
            let end = Endpoint::new(place.site.position, place.site.normal, 1.0);
            SharedLight {
                end: LightEnd::Surface(end),
                target: Some(place.site.origin),
                connections: 256.0,
            }
        })
        .take(256)
        .collect();
    let set = |eye: &EyeSample, lights: &[SharedLight]| {
        let wanted = |(l, light)| u16::from(faces(&eye.end, light)) << l;
        lights
            .iter()
            .enumerate()
            .map(wanted)
            .fold(0, |all, one| all | one)
    };
    let of_block = |eyes: &[EyeSample], lights| eyes.iter().map(|eye| set(eye, lights)).collect();
    let of_tile = |eyes| {
        lights
            .chunks(BLOCK)
            .map(|lights| of_block(eyes, lights))
            .collect()
    };
    let sets: Vec<Vec<Vec<u16>>> = eyes.chunks(TILE).map(of_tile).collect();
    let asked = sets
        .iter()
        .flatten()
        .flatten()
        .map(|set| u64::from(set.count_ones()))
        .sum();
    let pixels = f64::from(plan.size[0] * plan.size[1]);
    Questions {
        of_a_light: pixels * asked as f64 / (rays.len() * lights.len()).max(1) as f64,
        eyes,
        lights,
        sets,
        asked,
    }
}

/// Nanoseconds a question, one core.
fn nanoseconds<'a, V: Visibility<occlude_render::geometry::Geometry<'a>>>(
    stage: &Stage<'a>,
    visibility: &V,
    questions: &Questions,
    repetitions: usize,
) -> f64 {
    let mut session = Session::new(stage.geometry, visibility);
    let mut times = Vec::new();
    for _ in 0..=repetitions {
        let mut seen = 0.0;
        let began = thread_seconds();
        for (eyes, sets) in questions.eyes.chunks(TILE).zip(&questions.sets) {
            let mut facing = Facing { sets, seen: 0.0 };
            session.answer_many(eyes, &questions.lights, &mut facing);
            seen += facing.seen;
        }
        times.push((thread_seconds() - began) * 1e9 / questions.asked as f64);
        std::hint::black_box(seen);
    }
    // The first finds out which records answer.
    median(&times[1..]).0
}

/// The bound on what three records can gain over a map a light.
fn costs(
    setting: &Setting,
    plan: &Plan,
    report: &mut Report,
    name: &str,
    stage: &Stage,
) -> Option<f64> {
    let questions = questions(setting, plan, stage);
    if questions.of_a_light == 0.0 {
        report.note(format!("{name}: nothing to ask"));
        return None;
    }
    let one = map_per_light(stage, plan, questions.lights.len() as u32);
    one.prepare(stage.geometry, &questions.lights, &mut walks(stage, plan));
    let three = Records::new(RecordSettings {
        pace: 0,
        ..settings(stage, plan, false)
    })
    .expect("legal settings");
    three.prepare(stage.geometry, &[], &mut walks(stage, plan));
    let mut fills = Vec::new();
    for place in PathSite::on_lights(&questions.lights).iter().step_by(8) {
        let began = thread_seconds();
        std::hint::black_box(three.cache().measure_fill(stage.geometry, place.site));
        fills.push((thread_seconds() - began) * 1e9);
    }
    let fill = median(&fills).0;
    let repetitions = plan.repetitions.max(3);
    let exact = nanoseconds(stage, &Exact, &questions, repetitions);
    let c1 = nanoseconds(stage, &one, &questions, repetitions);
    let c3 = nanoseconds(stage, &three, &questions, repetitions);
    let asked = questions.of_a_light;
    let bound = (fill + asked * c1) / (asked * c3);
    report.raw(&format!("instant,{name},0,exact,{exact},ns"));
    report.raw(&format!("instant,{name},0,c1,{c1},ns"));
    report.raw(&format!("instant,{name},0,c3,{c3},ns"));
    report.table(
        "Costs of a question, one core: a map a virtual light against three records (a sample a pixel; paper's gain: 36x in San Miguel, 7x in Sibenik, whose fills were slow)",
        &[
            "scene", "questions T", "fill F, ms", "one map c1, ns", "three records c3, ns", "exact ray, ns", "bound (F + T c1)/(T c3)",
            "exact / c3",
        ],
        vec![
            name.into(),
            format!("{asked:.0}"),
            fixed(fill / 1e6),
            fixed(c1),
            fixed(c3),
            fixed(exact),
            fixed(bound),
            fixed(exact / c3),
        ],
    );
    Some(bound)
}

fn frames(
    setting: &Setting,
    plan: &Plan,
    report: &mut Report,
    measured: &Measured,
    stage: &Stage,
    settings: &RecordSettings,
) {
    let placed = match settings.placement {
        Placement::Lights => "on lights",
        Placement::Paths => "along paths",
    };
    let name = measured.subject.name;
    let task = Task {
        integrator: instant_radiosity(8, plan.vpls),
        size: plan.size,
        samples: if setting.quick { 1 } else { 4 },
        seed: plan.seed,
        single_passes: false,
    };
    let mut last = None;
    let (exact, cached) = interleave(
        plan.repetitions.min(2),
        || stage.shoot(&Exact, &task),
        || {
            let records = Records::new(settings.clone()).expect("legal settings");
            let shot = stage.shoot(&records, &task);
            let made = records.cache().report();
            last = Some(made.initial.as_secs_f64() + made.steps.total().as_secs_f64());
            shot
        },
    );
    let (e, c) = (exact.last(), cached.last());
    let Ok(q) = quality(&c.picture, &e.picture) else {
        return;
    };
    let (te, tc) = (exact.seconds().0, cached.seconds().0);
    let sum = |shot: &Shot| f64::from(shot.picture.pixels.iter().flatten().sum::<f32>());
    let ready = last.unwrap_or_default();
    let whole = te / tc;
    report.row(Row {
        name: format!(
            "instant radiosity, records {placed}, {} texels",
            settings.resolution
        ),
        scene: name.into(),
        value: tc,
        unit: "s".into(),
        baseline: Some(te),
        ratio: Some(whole),
        spread: Some(cached.seconds().1),
        bar: (measured.instant_bar).map(|bar| format!(">= {bar} x at FLIP <= 0.03")),
        holds: (measured.instant_bar).map(|bar| whole >= bar && q.flip <= 0.03),
    });
    report.table(
        "Instant radiosity against exact coherent rays",
        &[
            "scene",
            "records",
            "texels",
            "vpls",
            "samples",
            "exact s",
            "records s",
            "of it filling",
            "frame",
            "without filling",
            "traced",
            "of these: no record, below, unknown, near",
            "energy change",
            "FLIP",
            "relMSE",
        ],
        vec![
            name.into(),
            placed.into(),
            settings.resolution.to_string(),
            plan.vpls.to_string(),
            task.samples.to_string(),
            fixed(te),
            fixed(tc),
            fixed(ready),
            format!("x{}", fixed(whole)),
            format!("x{}", fixed(te / (tc - ready).max(1e-9))),
            percent(c.report.visibility.traced as f64 / c.report.visibility.queries as f64),
            reasons(&c.report.visibility.unanswered),
            percent(sum(c) / sum(e) - 1.0),
            format!("{:.4}", q.flip),
            format!("{:.2e}", q.relmse),
        ],
    );
    let label = format!(
        "{name}-{}-{}",
        placed.replace(' ', "-"),
        settings.resolution
    );
    let shown = (label.as_str(), task.samples);
    if let Err(error) = figure::show(setting, report, shown, e, c, &q) {
        report.note(format!("{name}: {error}"));
    }
}
