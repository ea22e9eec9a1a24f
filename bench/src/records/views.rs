//! What the cache looks like: Voronoi cells by importance (Fig. 4), utility, correlation, and the records.

use super::Plan;
use super::stage::{placed, settings, walks};
use crate::common::{Report, Setting};
use crate::quantized::shot::Stage;
use occlude_image::{Look, ToneMap};
use occlude_render::views::{RecordColour, draw};
use occlude_visibility::records::{RecordSettings, Scout};

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, name: &str, stage: &Stage) {
    let mut cache = placed(
        stage,
        plan,
        RecordSettings {
            capacity: plan.count / 4,
            ..settings(stage, plan, false)
        },
    );
    let mut scout = walks(stage, plan);
    let asked = 4 * cache.len();
    let view = (stage.view)(plan.half());
    let mut html = String::new();
    for steps in [0, plan.count / 2] {
        cache.refine_before(stage.geometry, steps, &mut |sites| scout.draw(asked, sites));
        let mut pilots = Vec::new();
        scout.draw(asked, &mut pilots);
        cache.pilot(&pilots);
        for colour in RecordColour::ALL {
            let picture = draw(&cache, stage.geometry, &view, colour);
            let file = format!("{name}-{}-{steps}.png", colour.name());
            let look = Look {
                tone_map: ToneMap::None,
                exposure_ev: 0.0,
            };
            if let Err(error) = occlude_image::write(&setting.out.join(&file), &picture, look) {
                report.note(format!("{file}: {error}"));
            }
            html += &format!(
                "<img src=\"{file}\" alt=\"{name}, {}, {steps} steps\"> ",
                colour.name()
            );
        }
        html += "<br>";
    }
    report.figure(
        &format!(
            "{name}: cells of records by importance, utility and correlation (dark: low, bright: high; records white), before and after {} steps",
            plan.count / 2
        ),
        html,
    );
}
