//! What a question costs on one core, beside the ray that it saves and the light that it shades.
//!
//! The questions are those of a real rendering, recorded and asked again on one thread: once with fresh memory, and once more
//! with a table that knows all answers, so that look-ups with refinement are all that is left.

use super::measured::{Clocked, ManyCall, Measured, Part, Replay};
use super::shot::{Stage, Task, instant_radiosity};
use super::subject::Subject;
use super::{Plan, fixed, short};
use crate::common::{Report, Row, Setting, median, thread_seconds};
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{Integrator, PathLimits};
use occlude_visibility::quantized::{Digest, Guarantee, Quantized, Share};
use occlude_visibility::{BLOCK, Epoch, Exact, Query, Tracer, Visibility};

/// What a cached question may cost at default settings, and where a large table knows all answers; nanoseconds.
const DEFAULT: f64 = 3.0;
const LARGE_TABLE: f64 = 12.0;

/// Bytes of the tables that are compared.
const TABLES: [usize; 2] = [4 << 20, 256 << 20];

const TITLE: &str = "Cost on one core, nanoseconds";
const HEADER: &[&str] = &["scene", "what", "ns", "spread", "questions", "rays traced"];

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let (most, repetitions) = if setting.quick {
        (4_000_000, 3)
    } else {
        (100_000_000, 5)
    };
    let task = Task {
        integrator: instant_radiosity(subject.max_depth, subject.vpls(setting)),
        size: plan.part(2),
        samples: 4,
        seed: plan.seed,
        single_passes: false,
    };
    // On one core, as all else here.
    let alone = match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool,
        Err(error) => return report.note(format!("SKIPPED cost: {error}")),
    };
    let recorder = Measured::recording(&Exact, most);
    alone.install(|| stage.shoot(&recorder, &task));
    let shading = recorder.ledger().many.shading_ns();
    let shared = recorder.into_recording();
    // Path tracing asks about one light a vertex.
    let recorder = Measured::recording(&Exact, most / 100);
    let paths = Task {
        integrator: Integrator::Path(PathLimits::new(subject.max_depth)),
        ..task
    };
    stage.shoot(&recorder, &paths);
    let single = recorder.into_recording().single;
    let mut cost = Cost {
        report,
        scene: subject.name,
        geometry: stage.geometry,
        repetitions,
    };
    cost.row("shading, a light, SIMD", &[shading], 0, 0, None);
    cost.rays(&shared.many);
    cost.many(stage, &task, &shared.many);
    let written = written(&shared.many, most / 100);
    cost.single(stage, &task, "the same questions one by one", &written);
    cost.single(stage, &paths, "of paths", &single);
}

struct Cost<'a, 'g> {
    report: &'a mut Report,
    scene: &'static str,
    geometry: &'a Geometry<'g>,
    repetitions: usize,
}

impl Cost<'_, '_> {
    fn row(&mut self, what: &str, ns: &[f64], questions: u64, traced: u64, bar: Option<f64>) {
        let (value, spread) = median(ns);
        for (repetition, ns) in ns.iter().enumerate() {
            self.report.raw(&format!(
                "cost,{},4,,{repetition},{},{ns:.4},ns",
                self.scene,
                what.replace(',', ";")
            ));
        }
        self.report.row(Row {
            name: what.into(),
            scene: self.scene.into(),
            value,
            unit: "ns".into(),
            baseline: None,
            ratio: None,
            spread: Some(spread),
            bar: bar.map(|bar| format!("<= {bar}")),
            holds: bar.map(|bar| value <= bar),
        });
        self.report.table(
            TITLE,
            HEADER,
            vec![
                self.scene.into(),
                what.into(),
                fixed(value),
                format!("{spread:.2}"),
                short(questions as f64),
                short(traced as f64),
            ],
        );
    }

    /// Rays one by one, and light by light in batches, as the exact side traces them.
    fn rays(&mut self, calls: &[ManyCall]) {
        const MOST: usize = 400_000;
        let mut rays = Vec::new();
        let mut few = Vec::new();
        for call in calls {
            if rays.len() > MOST {
                break;
            }
            few.push(call);
            for (block, lights) in call.lights.chunks(BLOCK).enumerate() {
                for (eye, &mask) in call.eyes.iter().zip(&call.wanted[block]) {
                    let asked = lights
                        .iter()
                        .enumerate()
                        .filter(|(l, _)| mask >> l & 1 != 0);
                    rays.extend(asked.map(|(_, light)| light.ray_from(eye.origin)));
                }
            }
        }
        rays.truncate(MOST);
        if rays.is_empty() {
            return;
        }
        let (mut single, mut coherent) = (Vec::new(), Vec::new());
        let mut traced = 0;
        for _ in 0..self.repetitions {
            let start = thread_seconds();
            let blocked = rays
                .iter()
                .filter(|ray| self.geometry.occluded(ray))
                .count();
            std::hint::black_box(blocked);
            single.push(1e9 * (thread_seconds() - start) / rays.len() as f64);
            let part = ask_many(&Exact, self.geometry, few.iter().copied());
            coherent.push(part.ray_ns());
            traced = part.traced;
        }
        let count = rays.len() as u64;
        self.row("shadow ray, one by one", &single, count, count, None);
        self.row(
            "shadow ray, light by light in batches",
            &coherent,
            traced,
            traced,
            None,
        );
    }

    /// Blocks of lights.
    fn many(&mut self, stage: &Stage, task: &Task, calls: &[ManyCall]) {
        let cache = |share, bytes| {
            stage.quantized(task, Guarantee::Bounded, |settings| {
                settings.share = share;
                settings.table_bytes = bytes;
            })
        };
        let (geometry, repetitions) = (self.geometry, self.repetitions);
        let mut ns = Vec::new();
        let mut last = Part::default();
        for _ in 0..self.repetitions {
            last = ask_many(&cache(Share::Tile, 64), self.geometry, calls.iter());
            ns.push(last.query_ns());
        }
        self.row(
            "question, blocks, a tile's arrays, first asked (default)",
            &ns,
            last.queries,
            last.traced,
            Some(DEFAULT),
        );
        for bytes in TABLES {
            let strategy = cache(Share::All, bytes);
            let size = bytes >> 20;
            let mut row = |when: &str, ns: &[f64], part: Part, bar| {
                let what = format!("question, blocks, shared table of {size} MiB, {when}");
                self.row(&what, ns, part.queries, part.traced, bar);
            };
            let fresh = ask_many(&strategy, geometry, calls.iter());
            row("first asked", &[fresh.query_ns()], fresh, None);
            let again = |of: &dyn Fn() -> Part| {
                let parts: Vec<Part> = (0..repetitions).map(|_| of()).collect();
                let ns: Vec<f64> = parts.iter().map(Part::query_ns).collect();
                (ns, parts[0])
            };
            let (ns, part) = again(&|| ask_again(&strategy, geometry, calls.iter()));
            row("each tile asked again at once", &ns, part, None);
            let (ns, part) = again(&|| ask_many(&strategy, geometry, calls.iter()));
            let bar = (bytes == TABLES[1]).then_some(LARGE_TABLE);
            row("the picture asked again", &ns, part, bar);
        }
    }

    /// One word a question.
    fn single(&mut self, stage: &Stage, task: &Task, what: &str, batches: &[(Epoch, Vec<Query>)]) {
        if batches.iter().all(|(_, queries)| queries.is_empty()) {
            return;
        }
        let others = [Digest::LcgXorshift, Digest::Lcg].map(|digest| (TABLES[0], digest));
        let ours = TABLES.map(|bytes| (bytes, Digest::Separable));
        for (bytes, digest) in ours.into_iter().chain(others) {
            let strategy = stage.quantized(task, Guarantee::Bounded, |settings| {
                settings.share = Share::All;
                settings.table_bytes = bytes;
                settings.digest = digest;
            });
            ask_single(&strategy, self.geometry, batches);
            let mut ns = Vec::new();
            let mut known = Part::default();
            for _ in 0..self.repetitions {
                known = ask_single(&strategy, self.geometry, batches);
                ns.push(known.query_ns());
            }
            let size = bytes >> 20;
            self.row(
                &format!("question, words, table of {size} MiB, known, {what}, {digest:?}"),
                &ns,
                known.queries,
                known.traced,
                None,
            );
        }
    }
}

/// Questions about blocks of lights written down one by one, as the default of `answer_many` does it; about `most`.
fn written(calls: &[ManyCall], most: u64) -> Vec<(Epoch, Vec<Query>)> {
    let mut batches = Vec::new();
    let mut count = 0;
    for call in calls {
        for (block, lights) in call.lights.chunks(BLOCK).enumerate() {
            if count >= most {
                return batches;
            }
            let mut queries = Vec::new();
            for (eye, &mask) in call.eyes.iter().zip(&call.wanted[block]) {
                let asked = lights
                    .iter()
                    .enumerate()
                    .filter(|(l, _)| mask >> l & 1 != 0);
                queries.extend(asked.map(|(_, light)| light.query(eye)));
            }
            count += queries.len() as u64;
            batches.push((call.epoch, queries));
        }
    }
    batches
}

/// Asks all recorded blocks again on this thread.
fn ask_many<'c, 'g, V>(
    strategy: &V,
    geometry: &Geometry<'g>,
    calls: impl Iterator<Item = &'c ManyCall>,
) -> Part
where
    V: Visibility<Clocked<Geometry<'g>>>,
{
    let measured = Measured::new(strategy);
    let mut worker = Visibility::<Geometry<'g>>::worker(&measured);
    for call in calls {
        Visibility::<Geometry<'g>>::begin(&measured, &mut worker, call.epoch);
        let mut replay = Replay(call);
        measured.answer_many(geometry, &mut worker, &call.eyes, &call.lights, &mut replay);
    }
    measured.ledger().many
}

/// Asks each recorded call twice, and measures the second time.
fn ask_again<'c, 'g>(
    strategy: &Quantized,
    geometry: &Geometry<'g>,
    calls: impl Iterator<Item = &'c ManyCall>,
) -> Part {
    let (first, second) = (Measured::new(strategy), Measured::new(strategy));
    let mut sides = [&first, &second].map(|measured| {
        let worker = Visibility::<Geometry<'g>>::worker(measured);
        (measured, worker)
    });
    for call in calls {
        for (measured, worker) in &mut sides {
            Visibility::<Geometry<'g>>::begin(*measured, worker, call.epoch);
            let mut replay = Replay(call);
            measured.answer_many(geometry, worker, &call.eyes, &call.lights, &mut replay);
        }
    }
    second.ledger().many
}

/// Asks all recorded batches again on this thread.
fn ask_single<'g>(
    strategy: &Quantized,
    geometry: &Geometry<'g>,
    batches: &[(Epoch, Vec<Query>)],
) -> Part {
    let measured = Measured::new(strategy);
    let mut worker = Visibility::<Geometry<'g>>::worker(&measured);
    let mut answers = Vec::new();
    for (epoch, queries) in batches {
        Visibility::<Geometry<'g>>::begin(&measured, &mut worker, *epoch);
        answers.clear();
        answers.resize(queries.len(), 0.0);
        measured.answer(geometry, &mut worker, queries, &mut answers);
    }
    measured.ledger().single
}
