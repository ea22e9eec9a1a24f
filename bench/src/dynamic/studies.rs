//! What packing, time and refits do: memory, flicker, builds.

use super::frames::errors;
use super::stage::{Reel, Shot, Stage, as_environment};
use crate::common::{Report, Row, Setting, median};
use occlude_bvh::BuildOptions;
use occlude_image::Picture;
use occlude_image::metrics::{flicker as flicker_of, relmse};
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{Field, Integrator};
use occlude_scene::procedural::Name;
use occlude_visibility::field::Hemisphere;
use occlude_visibility::{Ray, Tracer};
use std::time::Instant;

const SKY: &str = "kiara_1_dawn_1k.hdr";

pub fn of_paper(setting: &Setting) -> impl Iterator<Item = Stage> + '_ {
    [Name::HatOnCloth, Name::BallsInDish, Name::WalkingHat]
        .into_iter()
        .filter_map(|name| Stage::procedural(setting, name, SKY))
}

pub fn size(setting: &Setting) -> [u32; 2] {
    setting.size.unwrap_or(if setting.quick {
        [160, 120]
    } else {
        [640, 480]
    })
}

pub fn row(
    report: &mut Report,
    name: String,
    scene: &str,
    value: f64,
    unit: &str,
    bar: Option<(&str, bool)>,
) {
    report.row(Row {
        name,
        scene: scene.into(),
        value,
        unit: unit.into(),
        baseline: None,
        ratio: None,
        spread: None,
        bar: bar.map(|(bar, _)| bar.into()),
        holds: bar.map(|(_, holds)| holds),
    });
}

/// Bytes a point against error: packed fields, and their cheap rivals.
pub fn memory(setting: &Setting, report: &mut Report) {
    let title = "Memory of fields (frame 30), error against 128x128 fields as they are";
    let header = [
        "scene",
        "fields",
        "bytes a point",
        "relMSE",
        "FLIP",
        "s a frame",
        "bar",
    ];
    let whole = Field::default();
    let ways = [
        ("128x128, 16 bits", whole),
        (
            "128x128, packed",
            Field {
                packed: true,
                ..whole
            },
        ),
        (
            "64x64, 16 bits",
            Field {
                resolution: 64,
                ..whole
            },
        ),
    ];
    for stage in of_paper(setting) {
        let (size, lobes) = (size(setting), stage.lobes());
        let sky = as_environment(&lobes);
        let mut reference: Option<Picture> = None;
        for (name, field) in ways {
            let mut reel = Reel::under(&lobes);
            let work = (Integrator::Field(field), 1, 0);
            // The same frame again: all maps anew, but points are where they should be.
            let shots: Vec<Shot> = (0..4)
                .map(|_| stage.shoot(30, size, &sky, &mut reel, work))
                .collect();
            let first = &shots[0];
            let known = first.report.field.unwrap_or_default();
            let bytes = known.bytes as f64 / known.all_points.max(1) as f64;
            let times: Vec<f64> = shots[1..].iter().map(|shot| shot.seconds).collect();
            let reference = reference.get_or_insert_with(|| first.picture.clone());
            let error = relmse(&first.picture, reference).unwrap_or(f64::NAN);
            let (flip, _) = errors(&first.picture, reference);
            let bar = (name.ends_with("packed")).then_some((
                "<= 8192 B at relMSE <= 1e-3",
                bytes <= 8192.0 && error <= 1e-3,
            ));
            report.table(
                title,
                &header,
                vec![
                    stage.name.into(),
                    name.into(),
                    format!("{bytes:.0}"),
                    format!("{error:.2e}"),
                    format!("{flip:.4}"),
                    format!("{:.3}", median(&times).0),
                    bar.map_or(String::new(), |(bar, holds)| {
                        format!("{bar}: {}", if holds { "holds" } else { "missed" })
                    }),
                ],
            );
            row(
                report,
                format!("bytes a point, {name}"),
                stage.name,
                bytes,
                "B",
                bar,
            );
            row(
                report,
                format!("relMSE, {name}"),
                stage.name,
                error,
                "",
                None,
            );
            if name.ends_with("16 bits") && field.resolution == 128 {
                // The rival that keeps maps alone transforms a point's map whenever a tile row comes to it again: once a row of tiles that it reaches, were
                // the fields of one row kept.
                let again = known.transform / known.points.max(1) as f64;
                report.table(
                    title,
                    &header,
                    vec![
                        stage.name.into(),
                        "transformed again at each use".into(),
                        "2048".into(),
                        "0".into(),
                        "0".into(),
                        format!("{:.0} us more a use of a point", again * 1e6),
                        String::new(),
                    ],
                );
            }
        }
    }
}

/// Flicker of a sequence against the path-traced one.
pub fn flicker(setting: &Setting, report: &mut Report) {
    let title = "Flicker: mean FLIP between a frame and the one before";
    let header = [
        "scene", "frames", "fields", "paths", "excess", "inserted", "erased",
    ];
    let size = setting.size.unwrap_or([160, 120]);
    let frames = if setting.quick { 6 } else { 12 };
    for stage in of_paper(setting) {
        let lobes = stage.lobes();
        let sky = as_environment(&lobes);
        let mut reel = Reel::under(&lobes);
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let (mut inserted, mut erased) = (0, 0);
        for frame in 24..24 + frames {
            let work = (Integrator::Field(Field::default()), 1, 0);
            let shot = stage.shoot(frame, size, &sky, &mut reel, work);
            let known = shot.report.field.unwrap_or_default();
            if frame > 24 {
                (inserted, erased) = (inserted + known.inserted, erased + known.erased);
            }
            ours.push(shot.picture);
            let samples = if setting.quick { 128 } else { 512 };
            theirs.push(stage.traced(frame, size, &lobes, samples));
        }
        let Ok(found) = flicker_of(&ours, &theirs) else {
            continue;
        };
        report.table(
            title,
            &header,
            vec![
                stage.name.into(),
                frames.to_string(),
                format!("{:.4}", found.test),
                format!("{:.4}", found.reference),
                format!("{:+.4}", found.excess),
                inserted.to_string(),
                erased.to_string(),
            ],
        );
        row(
            report,
            "flicker beyond the reference's".into(),
            stage.name,
            found.excess,
            "FLIP",
            None,
        );
    }
}

/// Refits against builds, frame after frame of one sequence.
pub fn builds(setting: &Setting, report: &mut Report) {
    let title = "Hierarchies from frame to frame: built, and refitted ever since the first frame";
    let header = [
        "scene",
        "frame",
        "build ms",
        "refit ms",
        "rays when built ns",
        "rays when refitted ns",
        "slower",
    ];
    for stage in of_paper(setting) {
        let mut kept = None;
        let frames = [0, 1, 2, 4, 8, 16, 32, 64];
        for frame in frames {
            let pose = stage.pose(frame);
            let options = BuildOptions {
                whole_triangles: true,
                keep_degenerate: true,
                ..BuildOptions::default()
            };
            let start = Instant::now();
            let built = Geometry::new(&stage.scene, &pose, &options).expect("triangles");
            let build = start.elapsed().as_secs_f64();
            let start = Instant::now();
            let refitted = Geometry::refitted(kept.take(), &stage.scene, &pose).expect("triangles");
            let refit = start.elapsed().as_secs_f64();
            let points = stage.points(&built, &pose, 64);
            let time = |geometry: &Geometry| {
                let times: Vec<f64> = (0..5)
                    .map(|_| {
                        let start = Instant::now();
                        let mut count = 0;
                        let mut blocked = [false; 256];
                        for &(place, normal) in &points {
                            let axes = Hemisphere::new(normal, glam::Vec3::X);
                            let rays: Vec<_> = (0..256)
                                .map(|i| {
                                    let local = Hemisphere::texel(16, i / 16, i % 16);
                                    Ray::new(place, axes.to_world(local))
                                })
                                .collect();
                            blocked.fill(false);
                            geometry.occluded_batch(&rays, &mut blocked);
                            count += rays.len();
                        }
                        start.elapsed().as_secs_f64() * 1e9 / count as f64
                    })
                    .collect();
                median(&times).0
            };
            let (fresh, worn) = (time(&built), time(&refitted));
            report.table(
                title,
                &header,
                vec![
                    stage.name.into(),
                    frame.to_string(),
                    format!("{:.1}", build * 1e3),
                    format!("{:.1}", refit * 1e3),
                    format!("{fresh:.0}"),
                    format!("{worn:.0}"),
                    format!("{:+.0} %", (worn / fresh - 1.0) * 100.0),
                ],
            );
            row(
                report,
                format!("rays after refits to frame {frame}"),
                stage.name,
                worn / fresh,
                "of built",
                None,
            );
            row(
                report,
                format!("refit to frame {frame}"),
                stage.name,
                refit * 1e3,
                "ms",
                None,
            );
            kept = Some(refitted.into_hierarchies());
        }
    }
}
