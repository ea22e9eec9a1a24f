//! One rendering: a stage, a strategy, and what came of it.

use crate::common::{median, process_seconds};
use occlude_image::Picture;
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{
    InstantRadiosity, Integrator, RenderReport, RenderSettings, Secondary, Sequence, World, render,
};
use occlude_render::job::Job;
use occlude_render::light::Lights;
use occlude_render::sampling::SamplerKind;
use occlude_visibility::quantized::{
    Asks, BoundingSphere, ErrorReach, Guarantee, Quantized, QuantizedSettings, Workload,
};
use occlude_visibility::{Exact, Visibility};
use std::time::{Duration, Instant};

/// A scene ready to be rendered.
pub struct Stage<'a> {
    pub geometry: &'a Geometry<'a>,
    pub lights: &'a Lights,
    /// The view in a size.
    pub view: &'a (dyn Fn([u32; 2]) -> View + Sync),
    pub bounds: BoundingSphere,
    /// Point and spot lights, and those in one exact direction.
    pub points: usize,
    pub directions: usize,
}

/// What is rendered.
#[derive(Clone, Copy)]
pub struct Task {
    pub integrator: Integrator,
    pub size: [u32; 2],
    pub samples: u32,
    pub seed: u64,
    /// One sample a pass, instead of as many as fit.
    pub single_passes: bool,
}

/// What one rendering gave and took.
pub struct Shot {
    pub picture: Picture,
    /// Wall clock and processor seconds, preparation of lights and tables included.
    pub seconds: f64,
    pub cpu_seconds: f64,
    pub report: RenderReport,
}

impl Shot {
    /// Share of the clock of all threads that they were at work: below 1 where there was nothing to do, or other programs ran.
    pub fn busy(&self) -> f64 {
        let clock = self.seconds * rayon::current_num_threads() as f64;
        (self.cpu_seconds / clock).min(1.0)
    }

    /// Questions a ray.
    pub fn reduction(&self) -> f64 {
        let stats = &self.report.visibility;
        stats.queries as f64 / stats.traced.max(1) as f64
    }
}

pub fn picture(film: &Film) -> Picture {
    Picture {
        width: film.width(),
        height: film.height(),
        pixels: film.develop().radiance,
    }
}

impl<'a> Stage<'a> {
    pub fn shoot<V: Visibility<Geometry<'a>>>(&self, visibility: &V, task: &Task) -> Shot {
        self.watch(visibility, task, &mut |_| ())
    }

    /// Paths that records show the way; also gives the records and the seconds that they took to be placed and refined before the first pass.
    pub fn shoot_secondary(&self, secondary: Secondary, task: &Task) -> (Shot, Secondary, f64) {
        let world = World {
            geometry: self.geometry,
            lights: self.lights,
        };
        let view = (self.view)(task.size);
        let settings = self.settings(task);
        let mut film = Film::new(view.width(), view.height(), false);
        let (start, cpu) = (Instant::now(), process_seconds());
        let mut sequence = Sequence::with_secondary(secondary);
        let report = sequence.render(
            &world,
            &view,
            &Exact,
            &settings,
            &mut film,
            &Job::new(),
            &mut |_| (),
        );
        let shot = Shot {
            seconds: start.elapsed().as_secs_f64(),
            cpu_seconds: process_seconds() - cpu,
            picture: picture(&film),
            report,
        };
        let secondary = sequence.secondary.expect("given above");
        let made = secondary.report().records;
        let seconds = made.initial.as_secs_f64() + made.steps.total().as_secs_f64();
        (shot, secondary, seconds)
    }

    fn settings(&self, task: &Task) -> RenderSettings {
        RenderSettings {
            integrator: task.integrator,
            sampler: SamplerKind::default(),
            filter: PixelFilter::Box,
            seed: task.seed,
            samples: 0..task.samples,
            // Where time is limited, instant radiosity goes sample by sample.
            time_limit: task.single_passes.then_some(Duration::from_secs(1 << 24)),
            noise: None,
        }
    }

    /// The same; `at_rest` sees the film after every pass.
    pub fn watch<V: Visibility<Geometry<'a>>>(
        &self,
        visibility: &V,
        task: &Task,
        at_rest: &mut dyn FnMut(&Film),
    ) -> Shot {
        let world = World {
            geometry: self.geometry,
            lights: self.lights,
        };
        let view = (self.view)(task.size);
        let settings = self.settings(task);
        let mut film = Film::new(view.width(), view.height(), false);
        let (start, cpu) = (Instant::now(), process_seconds());
        let report = render(
            &world,
            &view,
            visibility,
            &settings,
            &mut film,
            &Job::new(),
            &mut |rest| at_rest(rest.film),
        );
        Shot {
            seconds: start.elapsed().as_secs_f64(),
            cpu_seconds: process_seconds() - cpu,
            picture: picture(&film),
            report,
        }
    }

    /// Quantized visibility as the command line sets it up, for an integrator and a number of samples; `change` may differ.
    pub fn quantized(
        &self,
        task: &Task,
        guarantee: Guarantee,
        change: impl FnOnce(&mut QuantizedSettings),
    ) -> Quantized {
        let mut settings = Workload {
            asks: match task.integrator {
                Integrator::InstantRadiosity(_) => Asks::Many,
                Integrator::Bidirectional(_) => Asks::Pairs,
                _ => Asks::Single,
            },
            guarantee,
            sequence: false,
            samples_per_pixel: Some(task.samples),
            pixels: u64::from(task.size[0]) * u64::from(task.size[1]),
            points: self.points,
            directions: self.directions,
            virtual_lights: match task.integrator {
                Integrator::InstantRadiosity(radiosity) if radiosity.max_depth > 1 => {
                    radiosity.vpls
                }
                _ => 0,
            },
            seed: task.seed,
        }
        .settings();
        change(&mut settings);
        Quantized::new(settings, self.bounds).expect("legal settings")
    }
}

/// Instant radiosity at the command line's defaults.
pub fn instant_radiosity(max_depth: u32, vpls: u32) -> Integrator {
    Integrator::InstantRadiosity(InstantRadiosity {
        max_depth,
        vpls,
        clamp: None,
        compensate: false,
    })
}

/// An error reach in which points and exact directions keep theirs unless they are all there is, as the paper's curves do.
pub fn reach(error: f32, delta_alone: bool) -> ErrorReach {
    let usual = ErrorReach::default();
    if delta_alone {
        ErrorReach::all(error)
    } else {
        ErrorReach {
            point: usual.point,
            direction: usual.direction,
            ..ErrorReach::all(error)
        }
    }
}

/// Renders both ways in turn (exact, cached, cached, exact, ...), `repetitions` times each.
pub fn interleave(
    repetitions: usize,
    mut exact: impl FnMut() -> Shot,
    mut cached: impl FnMut() -> Shot,
) -> (Series, Series) {
    let (mut exacts, mut cacheds) = (Vec::new(), Vec::new());
    for repetition in 0..repetitions {
        if repetition % 2 == 0 {
            exacts.push(exact());
            cacheds.push(cached());
        } else {
            cacheds.push(cached());
            exacts.push(exact());
        }
    }
    (Series(exacts), Series(cacheds))
}

/// Repetitions of one rendering; at least one.
pub struct Series(pub Vec<Shot>);

impl Series {
    pub fn last(&self) -> &Shot {
        self.0.last().expect("at least one repetition")
    }

    /// Median of the wall clock and spread.
    pub fn seconds(&self) -> (f64, f64) {
        median(&self.0.iter().map(|shot| shot.seconds).collect::<Vec<_>>())
    }
    /// Median of processor seconds: other programs disturb it less.
    pub fn cpu_seconds(&self) -> f64 {
        let all: Vec<f64> = self.0.iter().map(|shot| shot.cpu_seconds).collect();
        median(&all).0
    }
}
