//! Quantized visibility (Popov 2013): every table, curve and picture of it.
//!
//! Exact and cached visibility are measured in one process, in turn, on the same questions: the exact side is the fastest that
//! the renderer has (its rays are traced light by light, in batches), shading is the same code. Rows are written as they come:
//! a run that is cut off leaves what it has.
//!
//! | topic | what |
//! |---|---|
//! | `cost` | nanoseconds of a question, a ray and a light's shading, on one core |
//! | `reduction` | rays, seconds and error, beside what the costs allow |
//! | `curves` | the same against the error reach `C_E` |
//! | `pictures` | exact and cached, their difference, close-ups |
//! | `bidirectional` | rays, seconds and error of cached connections |
//! | `unbiased` | rays and variance |
//! | `consistent` | error against the number of passes |
//! | `shadow-maps` | cube and orthographic maps against the cache |
//! | `collisions` | of the digests, against the birthday bound |
//! | `sweeps` | rays and error against every other choice, tables among them |
//! | `order` | what the order of questions does (Figs. 3 and 4) |
//! | `walkthrough` | memory of earlier frames: rays, frames a second, flicker |

mod asking_order;
mod bidirectional;
mod collisions;
mod consistent;
mod cost;
mod curves;
pub mod figure;
mod measured;
pub mod plot;
pub mod quality;
mod reduction;
mod shadow_maps;
pub mod shot;
pub mod subject;
mod sweeps;
mod unbiased;
mod walkthrough;

use crate::common::{Report, Setting};
use subject::SUBJECTS;

/// The parts of the suite.
const TOPICS: &[&str] = &[
    "cost",
    "reduction",
    "curves",
    "pictures",
    "bidirectional",
    "unbiased",
    "consistent",
    "shadow-maps",
    "collisions",
    "sweeps",
    "order",
    "walkthrough",
];

/// How much is measured.
pub struct Plan {
    /// Of pictures in `reduction`; other topics take a part of it.
    size: [u32; 2],
    samples: Vec<u32>,
    repetitions: usize,
    seed: u64,
}

impl Plan {
    fn of(setting: &Setting) -> Self {
        let (size, samples, repetitions) = if setting.quick {
            ([128, 80], vec![4], 1)
        } else {
            ([1280, 800], vec![9, 16], 3)
        };
        Self {
            size: setting.size.unwrap_or(size),
            samples: if setting.samples.is_empty() {
                samples
            } else {
                setting.samples.clone()
            },
            repetitions: setting.repetitions.unwrap_or(repetitions).max(1),
            seed: 1,
        }
    }

    /// The size over `divisor`, at least 32 pixels a side.
    fn part(&self, divisor: u32) -> [u32; 2] {
        self.size.map(|side| (side / divisor).max(32))
    }
}

/// Measures and reports.
pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new(
        "Quantized visibility",
        "topic,scene,samples,side,repetition,what,value,unit",
    );
    report.live(&setting.out);
    report.unknown_topics(setting, TOPICS);
    let plan = Plan::of(setting);
    report.note(format!(
        "{} threads; pictures of {}x{} (curves and others: parts of it), {:?} samples a pixel, {} repetitions",
        rayon::current_num_threads(),
        plan.size[0],
        plan.size[1],
        plan.samples,
        plan.repetitions
    ));
    if setting.wants_topic("order") && setting.wants("floor") {
        asking_order::run(setting, &mut report);
    }
    let mut curves = curves::Curves::default();
    for subject in SUBJECTS {
        let topics = subject.wanted(setting);
        if topics.is_empty() || !setting.wants(subject.name) {
            continue;
        }
        subject.with_stage(setting, &mut report, |stage, report| {
            let wants = |topic: &str| topics.contains(&topic);
            if wants("reduction") || wants("pictures") {
                reduction::run(setting, &plan, report, subject, stage, wants("pictures"));
            }
            if wants("cost") {
                cost::run(setting, &plan, report, subject, stage);
            }
            if wants("collisions") {
                collisions::run(setting, &plan, report, subject, stage);
            }
            if wants("curves") {
                curves.run(setting, &plan, report, subject, stage);
            }
            if wants("bidirectional") {
                bidirectional::run(setting, &plan, report, subject, stage);
            }
            if wants("unbiased") {
                unbiased::run(setting, &plan, report, subject, stage);
            }
            if wants("consistent") {
                consistent::run(setting, &plan, report, subject, stage);
            }
            if wants("sweeps") {
                sweeps::run(setting, &plan, report, subject, stage);
            }
            if wants("walkthrough") {
                walkthrough::run(setting, &plan, report, subject, stage);
            }
            if wants("shadow-maps") {
                shadow_maps::run(setting, &plan, report, subject, stage);
            }
        });
    }
    report
}

/// Three significant digits or so.
pub fn fixed(value: f64) -> String {
    if !value.is_finite() {
        "-".to_owned()
    } else if value.abs() < 9.95 {
        format!("{value:.2}")
    } else if value.abs() < 99.5 {
        format!("{value:.1}")
    } else {
        format!("{value:.0}")
    }
}

/// With k, M or G.
fn short(value: f64) -> String {
    let (scale, unit) = match value {
        v if v >= 1e9 => (1e9, " G"),
        v if v >= 1e6 => (1e6, " M"),
        v if v >= 1e3 => (1e3, " k"),
        _ => (1.0, ""),
    };
    format!("{}{unit}", fixed(value / scale))
}

pub fn percent(share: f64) -> String {
    format!("{} %", fixed(100.0 * share))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!(fixed(2.3456), "2.35");
        assert_eq!(fixed(f64::NAN), "-");
        assert_eq!(short(2.55e9), "2.55 G");
        assert_eq!(percent(0.5), "50.0 %");
    }

    #[test]
    fn subjects_name_topics() {
        for subject in SUBJECTS {
            let all = subject.topics.iter().chain(subject.quick.0);
            for topic in all {
                assert!(TOPICS.contains(topic), "{}: {topic}", subject.name);
            }
        }
    }
}
