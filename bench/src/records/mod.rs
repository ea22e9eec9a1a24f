//! Visibility records (Ulbrich 2013): every table, curve and picture of them.
//!
//! Exact rays and records are measured in one process, in turn, on the same questions; the exact side is the fastest that the renderer has.
//!
//! | topic | what |
//! |---|---|
//! | `fill` | milliseconds of a map and of a refinement step by its parts (the paper's Table 1) |
//! | `rays` | ray questions a second on one core, exact and by records; whole frames by image-space paths (Figs. 1 and 8) |
//! | `instant` | a map a virtual light, three records and exact rays (Figs. 6 and 7) |
//! | `refinement` | error and spread of the importance over steps (Fig. 5), and over alpha (Fig. 10) |
//! | `modes` | nearest and probable, snapping and marching (Fig. 9), near field, both spatial terms of Eq. 2 |
//! | `views` | Voronoi cells by importance (Fig. 4), records, utility, correlation |

mod fill;
mod instant;
mod modes;
mod per_light;
mod rays;
mod refinement;
mod stage;
mod views;

use crate::common::{Report, Setting};
use crate::quantized::percent;
use occlude_visibility::Unanswered;
use stage::SUBJECTS;

const TOPICS: &[&str] = &["fill", "rays", "instant", "refinement", "modes", "views"];

/// How much is measured.
pub struct Plan {
    size: [u32; 2],
    samples: u32,
    repetitions: usize,
    /// Records at most.
    count: u32,
    vpls: u32,
    seed: u64,
}

impl Plan {
    fn of(setting: &Setting) -> Self {
        let quick = setting.quick;
        Self {
            size: setting
                .size
                .unwrap_or(if quick { [128, 80] } else { [640, 400] }),
            samples: setting
                .samples
                .first()
                .copied()
                .unwrap_or(if quick { 4 } else { 16 }),
            repetitions: setting.repetitions.unwrap_or(if quick { 1 } else { 3 }),
            count: if quick { 300 } else { 4000 },
            vpls: if quick { 64 } else { 1024 },
            seed: 1,
        }
    }

    /// The size over two.
    fn half(&self) -> [u32; 2] {
        self.size.map(|side| (side / 2).max(32))
    }
}

/// Measures and reports.
pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new(
        "Visibility records",
        "topic,scene,repetition,what,value,unit",
    );
    report.live(&setting.out);
    report.unknown_topics(setting, TOPICS);
    let plan = Plan::of(setting);
    report.note(format!(
        "{} threads; pictures of {}x{}, {} samples a pixel, {} records at most, {} virtual lights, {} repetitions",
        rayon::current_num_threads(),
        plan.size[0],
        plan.size[1],
        plan.samples,
        plan.count,
        plan.vpls,
        plan.repetitions
    ));
    for subject in SUBJECTS {
        let quick = subject.quick || !setting.quick;
        if !quick || !setting.wants(subject.subject.name) {
            continue;
        }
        subject
            .subject
            .with_stage(setting, &mut report, |stage, report| {
                let name = subject.subject.name;
                let wants =
                    |topic: &str| subject.topics.contains(&topic) && setting.wants_topic(topic);
                if wants("fill") {
                    fill::run(&plan, report, name, stage);
                }
                if wants("rays") {
                    rays::run(setting, &plan, report, subject, stage);
                }
                if wants("instant") {
                    instant::run(setting, &plan, report, subject, stage);
                }
                if wants("refinement") {
                    refinement::run(setting, &plan, report, name, stage);
                }
                if wants("modes") {
                    modes::run(&plan, report, name, stage);
                }
                if wants("views") {
                    views::run(setting, &plan, report, name, stage);
                }
            });
    }
    report
}

/// Shares of the reasons why records left questions to rays.
fn reasons(counts: &Unanswered) -> String {
    let share = |count: u64| percent(count as f64 / counts.total().max(1) as f64);
    let all = [
        counts.no_record,
        counts.below_horizon,
        counts.unknown,
        counts.too_near,
    ];
    all.map(share).join(", ")
}
