//! `dynamic`: fields of visibility on moving scenes under a sky (Wang et al. 2013).
//!
//! Topics: `transform` (time by resolution), `maps` (rays and wrong texels of adaptive maps), `frames` (Table 1), `monte-carlo` (time to equal FLIP against
//! path tracing with multiple importance sampling, and the error against the true sky), `passes` (Figs. 4 and 5), `grid` (Fig. 6), `raster` (Fig. 7), `memory`, `flicker`,
//! `causes` (of error) and `builds` (refits against builds).

mod figures;
mod frames;
mod maps;
mod raster;
mod stage;
mod studies;

use crate::common::{Report, Setting};

/// Runs the suite.
pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new(
        "Fields of visibility on moving scenes",
        "topic,scene,what,value,unit",
    );
    report.live(&setting.out);
    if setting.wants_topic("transform") {
        maps::transforms(setting, &mut report);
    }
    if setting.wants_topic("maps") {
        maps::adaptive(setting, &mut report);
    }
    if setting.wants_topic("frames") {
        frames::table(setting, &mut report);
    }
    if setting.wants_topic("monte-carlo") {
        frames::monte_carlo(setting, &mut report);
    }
    for (topic, study) in [
        ("passes", figures::passes as fn(&Setting, &mut Report)),
        ("grid", figures::grid),
        ("memory", studies::memory),
        ("flicker", studies::flicker),
        ("causes", figures::causes),
        ("builds", studies::builds),
        ("raster", raster::compare),
    ] {
        if setting.wants_topic(topic) {
            study(setting, &mut report);
        }
    }
    report
}
