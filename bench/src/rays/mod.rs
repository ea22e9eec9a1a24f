//! Rays per second, build time and memory, against Embree 4 in the same process.
//!
//! Every engine replays the same rays; repetitions of all engines alternate; rates are rays per second of thread CPU time,
//! so that programs beside this one disturb little. Single rays: one call a ray on both sides. Coherent: one light a
//! 64 x 64 tile, our batches against Embree's 16-ray packets or single rays, whichever is better.

mod embree;
mod scene;
mod sets;

use crate::common::{
    Report, Row, Setting, geometric_mean, median, process_seconds, thread_seconds,
};
use embree::{Embree, EmbreeScene, Quality};
use occlude_bvh::{Accel, BuildOptions, InstanceInput, MeshInput, NoFilter};
use occlude_visibility::Ray;
use scene::Soup;
use sets::{Question, Set};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

const SCENES: [&str; 5] = [
    "sponza",
    "bedroom",
    "victorian_house",
    "sintel_hair",
    "courtyard",
];
/// Rays that a thread takes at a time.
const CHUNK: usize = 4096;

/// Something that traces, in one way.
struct Engine<'a> {
    name: &'static str,
    closest: Option<Closest<'a>>,
    occluded: Occluded<'a>,
}

/// Whether anything blocks each ray.
type Occluded<'a> = Box<dyn Fn(&[Ray], &mut [bool]) + Sync + 'a>;

/// Distances of the nearest hits.
type Closest<'a> = Box<dyn Fn(&[Ray], &mut [f32]) + Sync + 'a>;

fn ours<'a>(name: &'static str, accel: &'a Accel) -> Engine<'a> {
    Engine {
        name,
        closest: Some(Box::new(|rays, out| {
            for (ray, out) in rays.iter().zip(out) {
                *out = accel
                    .closest(ray, &NoFilter)
                    .map_or(f32::INFINITY, |hit| hit.t);
            }
        })),
        occluded: Box::new(|rays, out| {
            for (ray, out) in rays.iter().zip(out) {
                *out = accel.occluded(ray, &NoFilter);
            }
        }),
    }
}

fn theirs<'a>(name: &'static str, scene: &'a EmbreeScene) -> Engine<'a> {
    Engine {
        name,
        closest: Some(Box::new(|rays, out| scene.closest(rays, out))),
        occluded: Box::new(|rays, out| scene.occluded(rays, out)),
    }
}

/// Answers of one run, to be compared.
#[derive(Default)]
struct Answers {
    t: Vec<f32>,
    occluded: Vec<bool>,
}

/// Runs a set once; returns the summed CPU seconds of the threads.
fn replay(engine: &Engine, set: &Set, threads: usize, answers: &mut Answers) -> f64 {
    let n = set.rays.len();
    let busy = AtomicU64::new(0);
    let next = AtomicUsize::new(0);
    answers.t.resize(n, 0.0);
    answers.occluded.resize(n, false);
    let t: Vec<_> = answers
        .t
        .chunks_mut(CHUNK)
        .map(std::sync::Mutex::new)
        .collect();
    let occluded: Vec<_> = answers
        .occluded
        .chunks_mut(CHUNK)
        .map(std::sync::Mutex::new)
        .collect();
    let work = || {
        let start = thread_seconds();
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            let Some(rays) = set.rays.chunks(CHUNK).nth(k) else {
                break;
            };
            match (&engine.closest, set.question) {
                (Some(closest), Question::Closest) => {
                    closest(rays, &mut t[k].lock().expect("not poisoned"))
                }
                _ => (engine.occluded)(rays, &mut occluded[k].lock().expect("not poisoned")),
            }
        }
        busy.fetch_add(((thread_seconds() - start) * 1e9) as u64, Ordering::Relaxed);
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(work);
        }
        work();
    });
    busy.into_inner() as f64 * 1e-9
}

/// Rates of one engine on one set.
struct Rate {
    /// Rays per CPU second of one thread.
    median: f64,
    spread: f64,
}

struct Measured {
    scene: String,
    /// `[set][engine][threads - 1]`.
    rates: Vec<(&'static str, EngineRates)>,
}

/// Each engine's rates by number of threads less one.
type EngineRates = Vec<(&'static str, Vec<Rate>)>;

impl Measured {
    fn rate(&self, set: &str, engine: &str, threads: usize) -> Option<&Rate> {
        let (_, engines) = self.rates.iter().find(|(name, _)| *name == set)?;
        let (_, rates) = engines.iter().find(|(name, _)| *name == engine)?;
        rates.get(threads - 1)
    }

    /// The best of several engines.
    fn best(&self, set: &str, engines: &[&str], threads: usize) -> Option<f64> {
        engines
            .iter()
            .filter_map(|e| Some(self.rate(set, e, threads)?.median))
            .max_by(f64::total_cmp)
    }
}

pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new(
        "Rays against Embree",
        "scene,set,engine,threads,repetition,rays,cpu_seconds",
    );
    let embree = match Embree::open() {
        Ok(embree) => Some(embree),
        Err(error) => {
            report.note(format!(
                "SKIPPED: Embree's columns: {error} (bench/README.md says how to get it)"
            ));
            None
        }
    };
    let mut all = Vec::new();
    for name in SCENES {
        if !setting.wants(name) || setting.quick && name == "courtyard" {
            continue;
        }
        match scene::load(setting, name) {
            Ok(soup) => all.extend(measure(&soup, embree, setting, &mut report)),
            Err(error) => report.note(format!("SKIPPED: {name}: {error}")),
        }
    }
    conclude(&all, &mut report);
    report
}

/// Builds and traces one scene.
fn measure(
    soup: &Soup,
    embree: Option<Embree>,
    setting: &Setting,
    report: &mut Report,
) -> Option<Measured> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mesh = MeshInput {
        positions: &soup.positions,
        triangles: &soup.triangles,
        filtered: false,
    };
    let instance = InstanceInput {
        mesh: 0,
        world_from_object: glam::Affine3A::IDENTITY,
    };
    let triangles = soup.triangles.len() as f64;
    let builds = if setting.quick || triangles > 5e6 {
        1
    } else {
        3
    };
    let (mut our_times, mut medium_times, mut high_times) = (Vec::new(), Vec::new(), Vec::new());
    let (mut accel, mut medium, mut high) = (None, None, None);
    for _ in 0..builds {
        drop(accel.take());
        let start = process_seconds();
        let built = Accel::build(&[mesh], &[instance], &BuildOptions::default());
        our_times.push(process_seconds() - start);
        accel = built.ok();
        if let Some(embree) = embree {
            for (scene, times, quality) in [
                (&mut medium, &mut medium_times, Quality::Medium),
                (&mut high, &mut high_times, Quality::High),
            ] {
                if quality == Quality::High && !times.is_empty() {
                    continue;
                }
                drop(scene.take());
                let built = embree.build(&soup.positions, &soup.triangles, quality, false, threads);
                times.push(built.build_seconds);
                *scene = Some(built);
            }
        }
    }
    let accel = accel?;
    let stats = accel.stats();
    let (build, spread) = median(&our_times);
    let baseline = (!medium_times.is_empty()).then(|| median(&medium_times).0);
    report.row(Row {
        name: "build, CPU time".into(),
        scene: soup.name.clone(),
        value: build,
        unit: "s".into(),
        baseline,
        ratio: baseline.map(|b| build / b),
        spread: Some(spread),
        bar: baseline.map(|_| "<= 1.5".into()),
        holds: baseline.map(|b| build <= 1.5 * b),
    });
    let bytes = stats.bytes as f64 / triangles;
    let theirs_bytes = medium.as_ref().map(|m| m.bytes as f64 / triangles);
    report.row(Row {
        name: "memory".into(),
        scene: soup.name.clone(),
        value: bytes,
        unit: "B/triangle".into(),
        baseline: theirs_bytes,
        ratio: theirs_bytes.map(|b| bytes / b),
        spread: None,
        bar: Some("<= 70 B".into()),
        holds: Some(bytes <= 70.0),
    });
    report.note(format!(
        "{}: {triangles} triangles, {:.3} times as many in leaves, cost {:.1}, depth {}, {:.2} a block{}",
        soup.name,
        stats.references as f64 / triangles,
        stats.cost,
        stats.depth,
        stats.references as f64 / stats.blocks as f64,
        high_times.first().map_or_else(String::new, |t| format!(
            "; Embree's high quality takes {t:.2} CPU s to build"
        )),
    ));
    let size = if setting.quick { 256 } else { 512 };
    let Some(sets) = sets::make(soup, &accel, size) else {
        report.note(format!("SKIPPED: {}: the camera sees nothing", soup.name));
        return None;
    };
    // What the watertight test costs, against Embree's robust mode, on the first scene.
    let tight = (soup.name == SCENES[0]).then(|| {
        let options = BuildOptions {
            watertight: true,
            ..Default::default()
        };
        let accel = Accel::build(&[mesh], &[instance], &options).ok();
        let robust = embree.map(|e| {
            e.build(
                &soup.positions,
                &soup.triangles,
                Quality::Medium,
                true,
                threads,
            )
        });
        (accel, robust)
    });
    let mut engines = vec![
        ours("ours", &accel),
        Engine {
            name: "ours-batch",
            closest: None,
            occluded: Box::new(|rays, out| accel.occluded_batch(rays, out, &NoFilter)),
        },
    ];
    if let (Some(medium), Some(high)) = (&medium, &high) {
        engines.push(theirs("embree-medium", medium));
        engines.push(theirs("embree-high", high));
        for (name, scene) in [("embree-medium-16", medium), ("embree-high-16", high)] {
            engines.push(Engine {
                name,
                closest: None,
                occluded: Box::new(|rays, out| scene.occluded_packets(rays, out)),
            });
        }
    }
    if let Some((Some(accel), robust)) = &tight {
        engines.push(ours("ours-watertight", accel));
        engines.extend(robust.as_ref().map(|scene| theirs("embree-robust", scene)));
    }
    Some(trace(
        &soup.name,
        &engines,
        &sets,
        threads.min(2),
        setting,
        report,
    ))
}

/// Replays all sets on all engines, interleaved.
fn trace(
    scene: &str,
    engines: &[Engine],
    sets: &[Set],
    threads: usize,
    setting: &Setting,
    report: &mut Report,
) -> Measured {
    let repetitions = if setting.quick { 3 } else { 7 };
    let mut rates = Vec::new();
    for set in sets {
        let mut seconds = vec![vec![Vec::new(); threads]; engines.len()];
        let mut reference: Option<Answers> = None;
        for repetition in 0..=repetitions {
            for threads in 1..=threads {
                for (k, engine) in engines.iter().enumerate() {
                    if engine.closest.is_none() && set.question == Question::Closest {
                        continue;
                    }
                    let mut answers = Answers::default();
                    let time = replay(engine, set, threads, &mut answers);
                    if repetition == 0 {
                        // Warms up and checks.
                        match &reference {
                            None => reference = Some(answers),
                            Some(reference) => {
                                compare(scene, set, engine.name, reference, &answers, report)
                            }
                        }
                        continue;
                    }
                    seconds[k][threads - 1].push(time);
                    report.raw(&format!(
                        "{scene},{},{},{threads},{repetition},{},{time:.6}",
                        set.name,
                        engine.name,
                        set.rays.len(),
                    ));
                }
            }
        }
        let rate = |times: &Vec<f64>| {
            let (seconds, spread) = median(times);
            Rate {
                median: set.rays.len() as f64 / seconds,
                spread,
            }
        };
        let measured = engines.iter().zip(&seconds);
        let measured = measured.filter(|(_, times)| !times[0].is_empty());
        rates.push((
            set.name,
            measured
                .map(|(e, times)| (e.name, times.iter().map(rate).collect()))
                .collect(),
        ));
    }
    Measured {
        scene: scene.into(),
        rates,
    }
}

/// Counts rays on which an engine says something else than ours.
fn compare(
    scene: &str,
    set: &Set,
    engine: &str,
    ours: &Answers,
    theirs: &Answers,
    report: &mut Report,
) {
    let differ = match set.question {
        Question::Closest => ours
            .t
            .iter()
            .zip(&theirs.t)
            .filter(|&(&a, &b)| {
                a != b
                    && (a - b).abs().partial_cmp(&(1e-3 * a.min(b)))
                        != Some(std::cmp::Ordering::Less)
            })
            .count(),
        Question::Any => ours
            .occluded
            .iter()
            .zip(&theirs.occluded)
            .filter(|(a, b)| a != b)
            .count(),
    };
    if differ * 10_000 > set.rays.len() {
        report.note(format!(
            "{scene} {}: {engine} differs on {differ} of {} rays",
            set.name,
            set.rays.len()
        ));
    }
}

const EMBREE_SINGLE: [&str; 2] = ["embree-medium", "embree-high"];
const EMBREE_ANY: [&str; 4] = [
    "embree-medium",
    "embree-high",
    "embree-medium-16",
    "embree-high-16",
];

/// Rows of rates, and the bars.
fn conclude(all: &[Measured], report: &mut Report) {
    let (mut single, mut coherent) = (Vec::new(), Vec::new());
    for m in all {
        for (set, engines) in &m.rates {
            for (engine, rates) in engines {
                let ours_batch = *engine == "ours-batch";
                let baseline = match *engine {
                    "ours" => m.best(set, &EMBREE_SINGLE, 1),
                    "ours-batch" => m.best(set, &EMBREE_ANY, 1),
                    "ours-watertight" => m.rate(set, "embree-robust", 1).map(|r| r.median),
                    _ => None,
                };
                let ratio = baseline.map(|b| rates[0].median / b);
                let barred = ours_batch && *set == "coherent";
                if barred {
                    coherent.extend(ratio);
                }
                report.row(Row {
                    name: format!("{set}, {engine}"),
                    scene: m.scene.clone(),
                    value: rates[0].median * 1e-6,
                    unit: "Mray/s".into(),
                    baseline: baseline.map(|b| b * 1e-6),
                    ratio,
                    spread: Some(rates[0].spread),
                    bar: (barred && ratio.is_some()).then(|| ">= 1.0".into()),
                    holds: ratio.filter(|_| barred).map(|r| r >= 1.0),
                });
            }
        }
        let ratio =
            |set: &str| Some(m.rate(set, "ours", 1)?.median / m.best(set, &EMBREE_SINGLE, 1)?);
        if let (Some(bounce), Some(shuffled)) = (ratio("bounce"), ratio("shuffled")) {
            let mean = (bounce * shuffled).sqrt();
            single.push(mean);
            report.row(bar("single incoherent rays", &m.scene, mean, 1.0));
        }
        let scaling = |set: &str| {
            let rates = [m.rate(set, "ours", 1)?, m.rate(set, "ours", 2)?];
            Some(2.0 * rates[1].median / rates[0].median)
        };
        let scalings: Vec<f64> = m.rates.iter().filter_map(|(set, _)| scaling(set)).collect();
        if !scalings.is_empty() {
            report.row(bar(
                "1 to 2 threads, all sets",
                &m.scene,
                geometric_mean(scalings),
                1.9,
            ));
        }
    }
    if !single.is_empty() {
        report.row(bar(
            "single incoherent rays, mean",
            "all",
            geometric_mean(single),
            1.15,
        ));
        report.row(bar(
            "coherent any-hit, mean",
            "all",
            geometric_mean(coherent),
            1.0,
        ));
    }
}

fn bar(name: &str, scene: &str, ratio: f64, least: f64) -> Row {
    Row {
        name: name.into(),
        scene: scene.into(),
        value: ratio,
        unit: "x".into(),
        baseline: None,
        ratio: None,
        spread: None,
        bar: Some(format!(">= {least}")),
        holds: Some(ratio >= least),
    }
}
