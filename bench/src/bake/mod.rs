//! Ray bundles: exchanges against rays, triangle set-up, the paper's tables, and its scene size.

mod rays;
mod subject;
mod tiling;

use crate::common::{Report, Row, Setting, median, process_seconds};
use glam::Vec3;
use occlude_bake::atlas::Atlas;
use occlude_bake::bundle::{
    self, Counting, Directions, Layout, MOST_SHARE, Radiance, Settings, Stats, Triangles,
};
use occlude_bake::sums::Sums;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::job::Job;
use rays::Points;
use std::time::Instant;
use subject::Subject;

/// Scenes of the exchange rate, and how many times more than single rays are wanted.
const SCENES: [(&str, f64); 4] = [
    ("sponza", 25.0),
    ("bedroom", 10.0),
    ("victorian_house", 8.0),
    ("sintel_hair", 5.0),
];

/// Parts of the suite.
const TOPICS: &[&str] = &[
    "exchanges",
    "prediction",
    "sweeps",
    "tiling",
    "breakdown",
    "city",
];

pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new("Ray bundles", "topic,scene,repetition,name,value");
    report.live(&setting.out);
    report.unknown_topics(setting, TOPICS);
    if setting.wants_topic("exchanges") {
        exchanges(setting, &mut report);
    }
    if setting.wants_topic("prediction") {
        prediction(setting, &mut report);
    }
    if setting.wants_topic("sweeps") {
        sweeps(setting, &mut report);
    }
    if setting.wants_topic("tiling") {
        tiling::run(setting, &mut report);
    }
    if setting.wants_topic("breakdown") {
        breakdown(setting, &mut report);
    }
    if setting.wants_topic("city") {
        city(setting, &mut report);
    }
    report
}

/// A scene that is ready to be gathered.
struct Ready<'a> {
    subject: &'a Subject,
    atlas: &'a Atlas,
    triangles: Triangles<'a>,
    radiance: Radiance,
    sums: Sums,
}

impl<'a> Ready<'a> {
    /// `most_share`: charts up to so many times denser than asked for get lines; infinity: all.
    fn new(subject: &'a Subject, atlas: &'a Atlas, most_share: f32) -> Self {
        let mut triangles =
            Triangles::with_lines_for(&subject.scene, &subject.pose, atlas, most_share);
        triangles.find_backs(0, &Settings::default(), &Job::new());
        let sides = triangles.sides().count();
        // Patches of light: what is read must not be the same everywhere.
        let radiance = Radiance::new(sides, 1.0, |side| {
            Vec3::new(0.2, 0.5, 0.9) * (side / 640 % 5) as f32 * 0.2
        });
        Self {
            subject,
            atlas,
            triangles,
            radiance,
            sums: Sums::new(sides, bundle::unit(1.0, 1 << 16)),
        }
    }

    fn gather(&self, range: std::ops::Range<u32>, settings: &Settings) -> Stats {
        bundle::gather(
            &self.triangles,
            &self.radiance,
            None,
            &Directions { seed: 0, round: 0 },
            range,
            settings,
            &Job::new(),
            &self.sums,
        )
    }
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap_or_else(|error| panic!("no threads: {error}"))
}

fn ready_subject(setting: &Setting, report: &mut Report, name: &str) -> Option<Subject> {
    if !setting.wants(name) {
        return None;
    }
    subject::load(setting, name)
        .map_err(|error| report.note(format!("SKIPPED {name}: {error}")))
        .ok()
}

fn exchanges(setting: &Setting, report: &mut Report) {
    let repetitions = setting
        .repetitions
        .unwrap_or(if setting.quick { 3 } else { 5 });
    let texels = if setting.quick { 2.5e5 } else { 1e6 };
    let mut set_up = Vec::new();
    for (name, bar) in SCENES {
        let Some(subject) = ready_subject(setting, report, name) else {
            continue;
        };
        let atlas = match subject.atlas(texels) {
            Ok((atlas, _)) => atlas,
            Err(error) => {
                report.note(format!("SKIPPED {name}: {error}"));
                continue;
            }
        };
        // Every texel gets its line a direction, however tiny its chart: that is what single rays do, too.
        let ready = Ready::new(&subject, &atlas, f32::INFINITY);
        let geometry = match Geometry::new(&subject.scene, &subject.pose, &BuildOptions::default())
        {
            Ok(geometry) => geometry,
            Err(error) => {
                report.note(format!("SKIPPED {name}: {error}"));
                continue;
            }
        };
        let points = Points::new(&subject, &atlas, 200_000);
        let settings = Settings::default();
        let one = pool(1);
        let (mut single, mut coherent, mut bundled) = (Vec::new(), Vec::new(), Vec::new());
        let (mut listing, mut analysis) = (Vec::new(), Vec::new());
        let mut last = Stats::default();
        one.install(|| {
            ready.gather(0..1, &settings);
            for k in 0..repetitions as u32 {
                let clock = process_seconds();
                let found = points.gather(
                    &geometry,
                    &atlas,
                    &ready.radiance,
                    &ready.sums,
                    None,
                    u64::from(k),
                );
                single.push(found as f64 / (process_seconds() - clock));

                let clock = process_seconds();
                let stats = ready.gather(4 * k..4 * k + 4, &settings);
                bundled.push(stats.exchanges as f64 / (process_seconds() - clock));
                let per_triangle = 1e9 / (4 * ready.triangles.len()) as f64;
                listing.push(stats.seconds.listing * per_triangle);
                analysis.push(stats.seconds.analysis * per_triangle);
                last = stats;

                let clock = process_seconds();
                let directions = Directions { seed: 0, round: 1 };
                let mut found = 0;
                for d in 4 * k..4 * k + 2 {
                    let along = directions.along(d);
                    for along in [along, -along] {
                        found += points.gather(
                            &geometry,
                            &atlas,
                            &ready.radiance,
                            &ready.sums,
                            Some(along),
                            0,
                        );
                    }
                }
                coherent.push(found as f64 / (process_seconds() - clock));
            }
        });
        let (rays, rays_spread) = median(&single);
        let (together, together_spread) = median(&coherent);
        let (lines, spread) = median(&bundled);
        for (k, ((a, b), c)) in single.iter().zip(&coherent).zip(&bundled).enumerate() {
            report.raw(&format!("exchanges,{name},{k},rays,{a}"));
            report.raw(&format!("exchanges,{name},{k},coherent,{b}"));
            report.raw(&format!("exchanges,{name},{k},bundles,{c}"));
        }
        let mut row = |what: &str, baseline: f64, bar: Option<f64>| {
            report.row(Row {
                name: what.into(),
                scene: name.into(),
                value: lines / 1e6,
                unit: "M/s, 1 core".into(),
                baseline: Some(baseline / 1e6),
                ratio: Some(lines / baseline),
                spread: Some(spread),
                bar: bar.map(|bar| format!(">= {bar}")),
                holds: bar.map(|bar| lines / baseline >= bar),
            });
        };
        row("exchanges against cosine rays", rays, Some(bar));
        row("exchanges against coherent rays", together, None);
        let set = median(&listing).0;
        set_up.push(set);
        let s = last.seconds;
        let per = 1e9 / last.fragments as f64;
        report.table(
            "Exchanges",
            &[
                "scene",
                "texels",
                "triangles",
                "backs",
                "lines",
                "fragments",
                "exchanges a fragment",
                "M exchanges/s",
                "M rays/s",
                "M coherent rays/s",
                "against rays",
                "against coherent",
                "spread",
                "analysis ns/triangle",
                "set-up ns/triangle",
                "list+raster ns/fragment",
                "sort+exchange ns/fragment",
            ],
            vec![
                name.into(),
                atlas.texels().to_string(),
                ready.triangles.len().to_string(),
                (ready.triangles.sides().count() - ready.triangles.sides().fronts_count())
                    .to_string(),
                (last.lines / last.directions).to_string(),
                (last.fragments / last.directions).to_string(),
                format!("{:.2}", last.exchanges as f64 / last.fragments as f64),
                format!("{:.1}", lines / 1e6),
                format!("{:.2}", rays / 1e6),
                format!("{:.2}", together / 1e6),
                format!("{:.1}", lines / rays),
                format!("{:.1}", lines / together),
                format!("{rays_spread:.2}/{together_spread:.2}/{spread:.2}"),
                format!("{:.1}", median(&analysis).0),
                format!("{set:.1}"),
                format!("{:.1}", s.creation * per),
                format!("{:.1}", s.update * per),
            ],
        );
    }
    if !set_up.is_empty() {
        let (value, spread) = median(&set_up);
        report.row(Row {
            name: "triangle set-up".into(),
            scene: "median".into(),
            value,
            unit: "ns, 1 core".into(),
            baseline: None,
            ratio: None,
            spread: Some(spread),
            bar: Some("<= 8".into()),
            holds: Some(value <= 8.0),
        });
    }
}

/// The paper's Table 2, on linked lists: what the prediction costs and misses.
fn prediction(setting: &Setting, report: &mut Report) {
    let texels = if setting.quick { 5e5 } else { 8e6 };
    for name in ["city", "victorian_house", "sponza"] {
        let Some(subject) = ready_subject(setting, report, name) else {
            continue;
        };
        let Ok((atlas, _)) = subject.atlas(texels) else {
            continue;
        };
        let ready = Ready::new(&subject, &atlas, MOST_SHARE);
        for counting in [Counting::Sampled, Counting::Area] {
            for alpha in [0.9, 1.0] {
                let settings = Settings {
                    alpha,
                    counting,
                    layout: Layout::LinkedList,
                    // The paper's node for every line, at a size where tiles are bound by nodes.
                    lines: 512,
                    nodes: 400_000,
                    ..Settings::default()
                };
                let stats = ready.gather(0..if setting.quick { 4 } else { 12 }, &settings);
                report.table(
                    "Prediction (linked lists)",
                    &[
                        "scene",
                        "counting",
                        "alpha",
                        "tiles",
                        "splits",
                        "false alarms",
                        "overflowing tiles",
                        "dropped nodes",
                        "redone",
                        "left",
                    ],
                    vec![
                        name.into(),
                        format!("{counting:?}"),
                        alpha.to_string(),
                        (stats.tiles / stats.directions).to_string(),
                        (stats.splits / stats.directions).to_string(),
                        format!(
                            "{:.1} %",
                            100.0 * stats.false_alarms as f64 / stats.splits.max(1) as f64
                        ),
                        stats.overflow_detected.to_string(),
                        format!(
                            "{:.2e} %",
                            100.0 * stats.nodes_dropped as f64 / stats.fragments as f64
                        ),
                        format!("{:.2} %", 100.0 * stats.redo_share()),
                        stats.overflow_left.to_string(),
                    ],
                );
            }
        }
    }
}

/// The paper's Fig. 8 and 9: time and overflow against W and N.
fn sweeps(setting: &Setting, report: &mut Report) {
    for name in ["sponza", "victorian_house"] {
        let Some(subject) = ready_subject(setting, report, name) else {
            continue;
        };
        let Ok((atlas, _)) = subject.atlas(if setting.quick { 2.5e5 } else { 4e6 }) else {
            continue;
        };
        let ready = Ready::new(&subject, &atlas, MOST_SHARE);
        let mut lines_and_nodes: Vec<(u32, u32)> = [64, 128, 256, 512, 1024, 2048]
            .map(|w| (w, 5_000_000))
            .into();
        lines_and_nodes.extend([100_000, 300_000, 1_000_000, 20_000_000].map(|n| (1024, n)));
        for (lines, nodes) in lines_and_nodes {
            for layout in [Layout::ScanScatter, Layout::LinkedList] {
                let settings = Settings {
                    lines,
                    nodes,
                    layout,
                    ..Settings::default()
                };
                ready.gather(0..1, &settings);
                let clock = Instant::now();
                let stats = ready.gather(1..if setting.quick { 3 } else { 7 }, &settings);
                let seconds = clock.elapsed().as_secs_f64() / stats.directions as f64;
                report.raw(&format!(
                    "sweeps,{name},0,W{lines} N{nodes} {layout:?},{seconds}"
                ));
                report.table(
                    "Figures 8 and 9: W and N",
                    &[
                        "scene",
                        "W",
                        "N",
                        "layout",
                        "ms a direction",
                        "tiles",
                        "M lines",
                        "M fragments",
                        "dropped nodes",
                        "redone",
                    ],
                    vec![
                        name.into(),
                        lines.to_string(),
                        nodes.to_string(),
                        format!("{layout:?}"),
                        format!("{:.1}", seconds * 1e3),
                        (stats.tiles / stats.directions).to_string(),
                        format!("{:.2}", stats.lines as f64 / stats.directions as f64 / 1e6),
                        format!(
                            "{:.2}",
                            stats.fragments as f64 / stats.directions as f64 / 1e6
                        ),
                        format!(
                            "{:.2e} %",
                            100.0 * stats.nodes_dropped as f64 / stats.fragments as f64
                        ),
                        format!("{:.2} %", 100.0 * stats.redo_share()),
                    ],
                );
            }
        }
    }
}

/// A row of the paper's Table 1; `value`: seconds a direction.
fn table_1(report: &mut Report, scene: &str, what: &str, sum: &Stats, value: f64) {
    let n = sum.directions as f64;
    let ms = |x: f64| format!("{:.1}", x / n * 1e3);
    let overhead = sum.seconds.analysis + sum.seconds.mipmaps + sum.seconds.tiling;
    report.table(
        "Table 1: milliseconds a direction",
        &[
            "scene",
            "settings",
            "tiles",
            "M lines",
            "M fragments",
            "M exchanges",
            "analysis",
            "mipmaps",
            "tiling",
            "creation",
            "update",
            "all",
            "first three",
        ],
        vec![
            scene.into(),
            what.into(),
            format!("{:.0}", sum.tiles as f64 / n),
            format!("{:.1}", sum.lines as f64 / n / 1e6),
            format!("{:.1}", sum.fragments as f64 / n / 1e6),
            format!("{:.1}", sum.exchanges as f64 / n / 1e6),
            ms(sum.seconds.analysis),
            ms(sum.seconds.mipmaps),
            ms(sum.seconds.tiling),
            ms(sum.seconds.creation),
            ms(sum.seconds.update),
            format!("{:.0}", value * 1e3),
            format!("{:.1} %", 100.0 * overhead / sum.total_seconds()),
        ],
    );
}

/// The other columns of Table 1, for scenes like those of Fig. 7: an open hall (a), plants under a sky (b), a hall behind small holes (c).
fn breakdown(setting: &Setting, report: &mut Report) {
    for name in ["sponza", "pine_forest", "holes"] {
        let Some(subject) = ready_subject(setting, report, name) else {
            continue;
        };
        let Ok((atlas, _)) = subject.atlas(if setting.quick { 2.5e5 } else { 4e6 }) else {
            continue;
        };
        let ready = Ready::new(&subject, &atlas, MOST_SHARE);
        for (what, layout) in [
            ("scan and scatter", Layout::ScanScatter),
            ("linked lists", Layout::LinkedList),
        ] {
            let settings = Settings {
                layout,
                ..Settings::default()
            };
            ready.gather(0..1, &settings);
            let (mut sum, mut seconds) = (Stats::default(), Vec::new());
            for index in 1..if setting.quick { 4 } else { 9 } {
                let clock = Instant::now();
                sum += ready.gather(index..index + 1, &settings);
                seconds.push(clock.elapsed().as_secs_f64());
                report.raw(&format!(
                    "breakdown,{name},{index},{what},{}",
                    seconds[seconds.len() - 1]
                ));
            }
            table_1(report, name, what, &sum, median(&seconds).0);
        }
    }
}

/// The paper's scene size.
fn city(setting: &Setting, report: &mut Report) {
    let Some(subject) = ready_subject(setting, report, "city") else {
        return;
    };
    let clock = Instant::now();
    let (atlas, density) = match subject.atlas(if setting.quick { 2e6 } else { 46e6 }) {
        Ok(found) => found,
        Err(error) => return report.note(format!("SKIPPED city: {error}")),
    };
    report.note(format!(
        "city: {} texels, {density:.2} a metre in the middle, atlas in {:.1} s",
        atlas.texels(),
        clock.elapsed().as_secs_f64()
    ));
    let clock = Instant::now();
    let ready = Ready::new(&subject, &atlas, MOST_SHARE);
    report.note(format!(
        "city: {} triangles, {} backs, flattened and backs found in {:.1} s",
        ready
            .subject
            .scene
            .meshes
            .iter()
            .map(|m| m.triangles.len())
            .sum::<usize>(),
        ready.triangles.sides().count() - ready.triangles.sides().fronts_count(),
        clock.elapsed().as_secs_f64()
    ));
    assert_eq!(ready.atlas.texels(), atlas.texels());
    let directions = setting
        .samples
        .first()
        .copied()
        .unwrap_or(if setting.quick { 2 } else { 12 });
    for (what, settings) in [
        ("W = 1024, N = 5 M, scan and scatter", Settings::default()),
        (
            "W = 1024, N = 5 M, linked lists",
            Settings {
                layout: Layout::LinkedList,
                ..Settings::default()
            },
        ),
        (
            "W = 128, scan and scatter",
            Settings {
                lines: 128,
                ..Settings::default()
            },
        ),
    ] {
        let mut seconds = Vec::new();
        let mut sum = Stats::default();
        ready.gather(0..1, &settings);
        for index in 1..=directions {
            let clock = Instant::now();
            let stats = ready.gather(index..index + 1, &settings);
            seconds.push(clock.elapsed().as_secs_f64());
            report.raw(&format!(
                "city,{what},{index},seconds,{}",
                seconds[seconds.len() - 1]
            ));
            sum += stats;
        }
        let (value, spread) = median(&seconds);
        table_1(report, "city", what, &sum, value);
        report.row(Row {
            name: format!("city: seconds a direction, {what}"),
            scene: "city".into(),
            value,
            unit: "s, all cores".into(),
            baseline: Some(0.70),
            ratio: Some(value / 0.70),
            spread: Some(spread),
            bar: Some("<= 1.4".into()),
            holds: Some(value <= 1.4 && !setting.quick),
        });
    }
}
