//! Rays, time and error against the error reach `C_E`, with and without anti-aliasing (Popov 2013, Fig. 7).

use super::plot::{Curve, Plot};
use super::quality::quality;
use super::shot::{Stage, Task, interleave, reach};
use super::subject::Subject;
use super::{Plan, fixed, percent};
use crate::common::{Report, Setting};
use occlude_visibility::Exact;
use occlude_visibility::quantized::Guarantee;

const TITLE: &str = "Against the error reach C_E";
const HEADER: &[&str] = &[
    "scene",
    "samples",
    "C_E",
    "rays /",
    "faster",
    "FLIP",
    "worst block",
    "energy change",
];

/// Diagrams, and whether their values cover magnitudes.
const DIAGRAMS: [(&str, bool); 4] = [
    ("times fewer rays", true),
    ("times faster", false),
    ("mean FLIP", false),
    ("energy change, %", false),
];

/// The curves of all scenes so far, by diagram.
#[derive(Default)]
pub struct Curves {
    curves: [Vec<Curve>; 4],
}

impl Curves {
    pub fn run(
        &mut self,
        setting: &Setting,
        plan: &Plan,
        report: &mut Report,
        subject: &Subject,
        stage: &Stage,
    ) {
        let reaches: &[f32] = if setting.quick {
            &[4.0, 14.0, 40.0]
        } else {
            &[4.0, 8.0, 14.0, 20.0, 28.0, 40.0]
        };
        for samples in [9, 1] {
            let task = Task {
                integrator: subject.integrator(setting),
                size: plan.part(2),
                samples,
                seed: plan.seed,
                single_passes: false,
            };
            let mut exact = None;
            let mut curves = DIAGRAMS.map(|_| Curve {
                name: subject.name.into(),
                points: Vec::new(),
                dashed: samples == 1,
            });
            for &error in reaches {
                let cache = || {
                    stage.quantized(&task, Guarantee::Bounded, |settings| {
                        settings.error = reach(error, subject.max_depth == 1);
                    })
                };
                // The exact side once more at each point, unless that takes long: its time is what all points share.
                let (fresh, cached) = match &exact {
                    None => {
                        let (exact, cached) = interleave(
                            1,
                            || stage.shoot(&Exact, &task),
                            || stage.shoot(&cache(), &task),
                        );
                        (Some(exact), cached)
                    }
                    Some(_) => {
                        let cached = stage.shoot(&cache(), &task);
                        (None, super::shot::Series(vec![cached]))
                    }
                };
                let exact = exact.get_or_insert_with(|| fresh.expect("the first point has it"));
                let (e, c) = (exact.last(), cached.last());
                let quality = match quality(&c.picture, &e.picture) {
                    Ok(quality) => quality,
                    Err(why) => return report.note(format!("{}: {why}", subject.name)),
                };
                let faster = e.seconds / c.seconds;
                let values = [c.reduction(), faster, quality.flip, 100.0 * quality.energy];
                for ((curve, value), (what, _)) in curves.iter_mut().zip(values).zip(DIAGRAMS) {
                    curve.points.push((f64::from(error), value));
                    report.raw(&format!(
                        "curves,{},{samples},C_E={error},,{},{value:.6},1",
                        subject.name,
                        what.replace(',', ";")
                    ));
                }
                report.table(
                    TITLE,
                    HEADER,
                    vec![
                        subject.name.into(),
                        samples.to_string(),
                        error.to_string(),
                        fixed(c.reduction()),
                        fixed(faster),
                        format!("{:.4}", quality.flip),
                        format!("{:.3}", quality.flip_block),
                        percent(quality.energy),
                    ],
                );
            }
            for (all, curve) in self.curves.iter_mut().zip(curves) {
                all.push(curve);
            }
            self.draw(setting, report);
        }
    }

    fn draw(&self, setting: &Setting, report: &mut Report) {
        let diagrams = DIAGRAMS.iter().zip(&self.curves);
        let svgs: Vec<String> = diagrams
            .map(|(&(title, log_y), curves)| {
                let plot = Plot {
                    title,
                    x: "C_E, samples across",
                    log_x: false,
                    log_y,
                    curves,
                };
                plot.svg()
            })
            .collect();
        for (svg, name) in svgs.iter().zip(["rays", "speedup", "flip", "energy"]) {
            let path = setting.out.join(format!("curve-{name}.svg"));
            if let Err(error) = std::fs::write(&path, svg) {
                report.note(format!("{}: {error}", path.display()));
            }
        }
        report.figure(
            "Against C_E: 9 samples a pixel (solid) and 1 (dashed). Where scenes have other lights too, points and exact \
             directions keep their default reach",
            svgs.concat(),
        );
    }
}
