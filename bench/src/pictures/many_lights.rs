//! Many lights: which way of choosing a light has the least error after the same time.

use super::{Stage, Until, average, relative_error, show};
use crate::common::{Report, Row, Setting, median};
use occlude_bvh::BuildOptions;
use occlude_render::camera::View;
use occlude_render::geometry::Geometry;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{Pose, Scene, procedural};
use std::time::Duration;

/// Named as at the command line; power sampling is what the others are compared with.
const SELECTIONS: [(&str, LightSelection); 3] = [
    ("power", LightSelection::Power),
    ("tree", LightSelection::Tree),
    ("uniform", LightSelection::Uniform),
];

/// Measures and reports.
pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new(
        "Many lights: relMSE after equal time",
        "scene,max_depth,selection,repetition,samples,seconds,relmse,trimmed",
    );
    if setting.wants("apartment") {
        let path = setting.scenes.join("apartment.glb");
        match Scene::load(&path, Some("many_lights"), None) {
            Ok(scene) => measure(setting, &mut report, "apartment", &scene),
            Err(error) => report.note(format!("SKIPPED apartment: {error}")),
        }
    }
    if setting.wants("many-lights") {
        let scene = procedural::build(procedural::Name::ManyLights, None, 0);
        measure(setting, &mut report, "many-lights", &scene);
    }
    report
}

fn measure(setting: &Setting, report: &mut Report, name: &str, scene: &Scene) {
    let (size, repetitions, limit, reference_samples) = if setting.quick {
        (128, 3, 0.25, 64)
    } else {
        (256, 5, 2.0, 128)
    };
    let pose = Pose::at(scene, 0.0);
    let geometry = match Geometry::new(scene, &pose, &BuildOptions::default()) {
        Ok(geometry) => geometry,
        Err(error) => return report.note(format!("SKIPPED {name}: {error}")),
    };
    let stage = Stage {
        geometry: &geometry,
        view: View::of_camera(scene, &pose, 0, size, size),
    };
    let lights = SELECTIONS.map(|(_, how)| Lights::new(scene, &pose, None, how));
    report.note(format!("{name}: {} lights", lights[0].len()));
    for (max_depth, what) in [(1, "direct"), (7, "path")] {
        let references = stage.references(&lights[1], max_depth, reference_samples);
        let mut errors = [const { Vec::new() }; SELECTIONS.len()];
        for repetition in 1..=repetitions {
            for (i, lights) in lights.iter().enumerate() {
                let until = Until::Time(Duration::from_secs_f64(limit));
                let shot = stage.shoot(lights, max_depth, until, repetition);
                let (error, trimmed) = relative_error(&shot.picture, &references);
                report.raw(&format!(
                    "{name},{max_depth},{},{repetition},{},{:.4},{error:.6},{trimmed:.6}",
                    SELECTIONS[i].0, shot.samples, shot.seconds
                ));
                // Time is looked at between passes: what went over the limit is accounted for.
                errors[i].push(error * shot.seconds / limit);
                if repetition == repetitions {
                    let title = format!("{name}-{what}-{}", SELECTIONS[i].0);
                    if let Err(why) =
                        show(&setting.out, &title, &shot.picture, &average(&references))
                    {
                        report.note(why);
                    }
                }
            }
        }
        let (power, _) = median(&errors[0]);
        for (errors, (selection, _)) in errors.iter().zip(SELECTIONS) {
            let (value, spread) = median(errors);
            let bar = selection == "tree";
            report.row(Row {
                name: format!("{what}, {selection}"),
                scene: name.into(),
                value,
                unit: format!("relMSE, {limit} s"),
                baseline: Some(power),
                ratio: Some(value / power),
                spread: Some(spread),
                bar: bar.then(|| "< 1 of power".into()),
                holds: bar.then_some(value < power),
            });
        }
    }
}
