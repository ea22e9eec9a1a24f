//! Rays, time and error against everything else that may be chosen: orientations (`C_N`), slabs (`C_Z`), steps of resolution (`C_R`),
//! refinement (Popov 2013, Fig. 3), and the size of a shared table.

use super::quality::quality;
use super::shot::{Stage, Task};
use super::subject::Subject;
use super::{Plan, fixed, percent};
use crate::common::{Report, Setting};
use occlude_visibility::Exact;
use occlude_visibility::quantized::{Guarantee, QuantizedSettings, Refine, Share};

const TITLE: &str = "Other choices, 9 samples";
const HEADER: &[&str] = &[
    "scene",
    "choice",
    "rays /",
    "seconds",
    "exact s",
    "FLIP",
    "FLIP 99 %",
    "worst block",
    "energy change",
];

type Change = Box<dyn Fn(&mut QuantizedSettings)>;

/// Names and what they change.
fn choices(quick: bool) -> Vec<(String, Change)> {
    let mut all: Vec<(String, Change)> = vec![("defaults".into(), Box::new(|_| ()))];
    let mut add = |name: String, change: Change| all.push((name, change));
    for n in [2u32, 4, 8, 16, 32] {
        add(format!("C_N {n}"), Box::new(move |s| s.normals = n));
    }
    for z in [2f32, 4.0, 8.0, 16.0, 32.0] {
        add(format!("C_Z {z}"), Box::new(move |s| s.slab = z));
    }
    for r in [1.1f32, 1.2, 1.5, 2.0, 2.5] {
        add(format!("C_R {r}"), Box::new(move |s| s.resolution_step = r));
    }
    add(
        "not refined (Fig. 3)".into(),
        Box::new(|s| s.refine = Refine::Levels(1)),
    );
    for shift in [16, 20, 24, 28] {
        let change = move |s: &mut QuantizedSettings| {
            s.share = Share::All;
            s.table_bytes = 1 << shift;
        };
        let name = format!("one table, {} KiB", 1u32 << (shift - 10));
        add(name, Box::new(change));
    }
    if quick {
        all.retain(|(name, _)| ["defaults", "C_N 4", "C_Z 4"].contains(&name.as_str()));
    }
    all
}

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let task = Task {
        integrator: subject.integrator(setting),
        size: plan.part(2),
        samples: 9,
        seed: plan.seed,
        single_passes: false,
    };
    let exact = stage.shoot(&Exact, &task);
    for (name, change) in choices(setting.quick) {
        let cached = stage.shoot(&stage.quantized(&task, Guarantee::Bounded, change), &task);
        let quality = match quality(&cached.picture, &exact.picture) {
            Ok(quality) => quality,
            Err(why) => return report.note(format!("{}: {why}", subject.name)),
        };
        for (what, value) in [
            ("reduction", cached.reduction()),
            ("cached_s", cached.seconds),
            ("exact_s", exact.seconds),
            ("flip", quality.flip),
        ] {
            report.raw(&format!(
                "sweeps,{},9,{name},,{what},{value:.6},",
                subject.name
            ));
        }
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                name,
                fixed(cached.reduction()),
                fixed(cached.seconds),
                fixed(exact.seconds),
                format!("{:.4}", quality.flip),
                format!("{:.3}", quality.flip_99),
                format!("{:.3}", quality.flip_block),
                percent(quality.energy),
            ],
        );
    }
}
