//! A moving camera in a scene that stands still: what memory of earlier frames saves, and whether it flickers.
//!
//! Three sides go along the same way with the same virtual lights (a few blocks are renewed a frame): exact rays, a fresh cache for
//! every frame, and one that is kept.

use super::quality::quality;
use super::shot::{Stage, Task, instant_radiosity, picture};
use super::subject::Subject;
use super::{Plan, percent};
use crate::common::{Report, Row, Setting, median, process_seconds};
use glam::Vec3;
use occlude_image::Picture;
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{RenderSettings, Sequence, World};
use occlude_render::job::Job;
use occlude_render::sampling::SamplerKind;
use occlude_visibility::quantized::{Guarantee, Share};
use occlude_visibility::{Exact, Visibility};
use std::time::Instant;

const FRAMES: u32 = 60;
/// Rays are compared, and frames a second counted, after this many frames.
const SETTLED: u32 = 10;
/// Every so many frames, pictures are compared with exact ones; two neighbours each, for flicker.
const COMPARED: u32 = 15;

const TITLE: &str = "Walkthrough: 640x400, one sample, 256 virtual lights";
const HEADER: &[&str] = &[
    "scene",
    "memory",
    "questions a frame",
    "rays a frame",
    "s a frame",
    "processor s a frame",
    "FLIP",
    "energy change",
    "FLIP between frames",
    "of exact frames",
];

/// One side on its way.
struct Side<V> {
    visibility: V,
    sequence: Sequence,
    frames: Vec<Frame>,
}

struct Frame {
    seconds: f64,
    cpu_seconds: f64,
    queries: u64,
    traced: u64,
}

impl<V> Side<V> {
    fn new(visibility: V) -> Self {
        Self {
            visibility,
            sequence: Sequence::renewing(1),
            frames: Vec::new(),
        }
    }

    fn go<'a>(&mut self, stage: &Stage<'a>, task: &Task, view: &View) -> Picture
    where
        V: Visibility<Geometry<'a>>,
    {
        let world = World {
            geometry: stage.geometry,
            lights: stage.lights,
        };
        let settings = RenderSettings {
            integrator: task.integrator,
            sampler: SamplerKind::default(),
            filter: PixelFilter::Box,
            seed: task.seed,
            samples: 0..task.samples,
            time_limit: None,
            noise: None,
        };
        let mut film = Film::new(view.width(), view.height(), false);
        let (start, cpu) = (Instant::now(), process_seconds());
        let report = self.sequence.render(
            &world,
            view,
            &self.visibility,
            &settings,
            &mut film,
            &Job::new(),
            &mut |_| (),
        );
        self.visibility.next_picture();
        self.frames.push(Frame {
            seconds: start.elapsed().as_secs_f64(),
            cpu_seconds: process_seconds() - cpu,
            queries: report.visibility.queries,
            traced: report.visibility.traced,
        });
        picture(&film)
    }

    fn settled(&self, of: impl Fn(&Frame) -> f64) -> f64 {
        let settled = self.frames.iter().skip(SETTLED as usize);
        median(&settled.map(of).collect::<Vec<_>>()).0
    }
}

/// Errors of one kind of memory, summed over frames.
#[derive(Default)]
struct Errors {
    flip: f64,
    energy: f64,
    count: f64,
    between: f64,
    exact_between: f64,
    pairs: f64,
}

/// A walk of five metres that turns a little: through the hall of `sponza`.
fn view(frame: u32, [width, height]: [u32; 2]) -> Option<View> {
    let t = frame as f32 / FRAMES as f32;
    let eye = Vec3::new(-10.0, 1.7, -0.6).lerp(Vec3::new(-5.0, 2.0, 0.2), t);
    let target = Vec3::new(0.0, 2.6, -0.6).lerp(Vec3::new(3.0, 3.2, 1.6), t * t);
    View::look_at(eye, target, 60f32.to_radians(), width, height)
}

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let frames = if setting.quick { 14 } else { FRAMES };
    let task = Task {
        integrator: instant_radiosity(subject.max_depth, 256),
        size: if setting.quick { [96, 60] } else { [640, 400] },
        samples: 1,
        seed: plan.seed,
        single_passes: false,
    };
    let cache = |share, table| {
        stage.quantized(&task, Guarantee::Bounded, |settings| {
            settings.share = share;
            settings.table_bytes = table;
        })
    };
    let mut exact = Side::new(Exact);
    let mut fresh = Side::new(cache(Share::Tile, 4 << 20));
    let mut kept = Side::new(cache(Share::Frames, 256 << 20));
    let mut errors = [Errors::default(), Errors::default()];
    let mut before: Option<[Picture; 3]> = None;
    for frame in 0..frames {
        let Some(view) = view(frame, task.size) else {
            return report.note("walkthrough: no view".to_owned());
        };
        let pictures = [fresh.go(stage, &task, &view), kept.go(stage, &task, &view)];
        // The exact side takes part where it is looked at; its virtual lights must not miss a frame.
        let compared = frame % COMPARED < 2;
        let truth = exact.go(stage, &task, &view);
        let [a, b] = pictures;
        let all = [a, b, truth];
        if compared {
            for (side, errors) in errors.iter_mut().enumerate() {
                if let Ok(found) = quality(&all[side], &all[2]) {
                    errors.flip += found.flip;
                    errors.energy += found.energy;
                    errors.count += 1.0;
                }
                if let (Some(before), 1) = (&before, frame % COMPARED) {
                    let between = |i: usize| quality(&all[i], &before[i]).map_or(0.0, |q| q.flip);
                    errors.between += between(side);
                    errors.exact_between += between(2);
                    errors.pairs += 1.0;
                }
            }
        }
        before = Some(all);
    }
    for (name, errors, frames) in [
        ("fresh", &errors[0], Summary::of(&fresh)),
        ("kept", &errors[1], Summary::of(&kept)),
    ] {
        report.table(
            TITLE,
            HEADER,
            vec![
                subject.name.into(),
                name.into(),
                super::short(frames.queries),
                super::short(frames.traced),
                format!("{:.3}", frames.seconds),
                format!("{:.3}", frames.cpu_seconds),
                format!("{:.4}", errors.flip / errors.count),
                percent(errors.energy / errors.count),
                format!("{:.4}", errors.between / errors.pairs),
                format!("{:.4}", errors.exact_between / errors.pairs),
            ],
        );
        for (what, value) in [
            ("seconds", frames.seconds),
            ("cpu_seconds", frames.cpu_seconds),
            ("traced", frames.traced),
        ] {
            report.raw(&format!(
                "walkthrough,{},1,{name},,{what},{value:.6},1",
                subject.name
            ));
        }
    }
    let (fresh, kept) = (Summary::of(&fresh), Summary::of(&kept));
    let mut row = |name: &str, value: f64, unit: &str, bar: f64| {
        report.row(Row {
            name: name.into(),
            scene: subject.name.into(),
            value,
            unit: unit.into(),
            baseline: None,
            ratio: None,
            spread: None,
            bar: Some(format!(">= {bar}")),
            holds: Some(value >= bar),
        });
    };
    row(
        "walkthrough, rays of a fresh cache over those of a kept one",
        fresh.traced / kept.traced,
        "times fewer",
        3.0,
    );
    row(
        "walkthrough, frames a second",
        1.0 / kept.seconds,
        "1/s",
        5.0,
    );
}

/// Medians over the settled frames.
struct Summary {
    seconds: f64,
    cpu_seconds: f64,
    queries: f64,
    traced: f64,
}

impl Summary {
    fn of<V>(side: &Side<V>) -> Self {
        Self {
            seconds: side.settled(|frame| frame.seconds),
            cpu_seconds: side.settled(|frame| frame.cpu_seconds),
            queries: side.settled(|frame| frame.queries as f64),
            traced: side.settled(|frame| frame.traced as f64),
        }
    }
}
