//! `--frames` and `--camera-path`: pictures one after the other, each into files of its own.
//!
//! What stands still is built once. Caches and virtual lights stay from frame to frame where that is right: while nothing but
//! the camera moves, or, where objects move, for the part of the world that does not.

use super::args::Integrator;
use super::camera_path::CameraPath;
use super::setup::{self, load, view};
use super::strategy::Strategy;
use super::{
    RenderArgs, check_light, check_memory, fingerprint, finish, quantized, settings,
    warn_of_no_records, work_stats, write_views,
};
use crate::context::Context;
use crate::error::CliError;
use crate::inspect::counts;
use crate::values::{Frames, Renewal};
use crate::{output, signals, stats};
use occlude_bvh::BuildOptions;
use occlude_image::Picture;
use occlude_render::film::Film;
use occlude_render::geometry::{Geometry, Still};
use occlude_render::integrator::{RenderReport, RenderSettings, Sequence, StoppedBy, World};
use occlude_render::light::Lights;
use occlude_render::work::shard_samples;
use occlude_scene::{Instance, Pose, Scene, moving_instances};
use occlude_visibility::two_part::{Ball, TwoPart, TwoPartTracer};
use occlude_visibility::{Class, Exact, Occluder, Visibility};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::thread::ScopedJoinHandle;
use std::time::Instant;

/// First line of the file that says which frames are done.
const DONE: &str = "occlude frames 1";

/// What all frames share.
struct Plan<'p> {
    args: &'p RenderArgs,
    scene: &'p Scene,
    sky: Option<Picture>,
    path: Option<CameraPath>,
    /// The frames of this run.
    frames: Vec<u32>,
    settings: RenderSettings,
    /// Which instances move.
    moving: Vec<bool>,
    /// Whether tables of lights are good for one frame alone.
    lights_move: bool,
    /// Keep what moves apart from what stands still.
    apart: bool,
    fingerprint: u64,
}

/// What has been made.
pub struct Done {
    /// The first output's files, frame by frame.
    pub pictures: Vec<PathBuf>,
    /// Frames a second.
    pub fps: f32,
}

/// Runs `occlude render` for frames, or `occlude animate`.
pub fn run(mut args: RenderArgs, context: &mut Context) -> Result<Done, CliError> {
    let path = match &args.camera_path {
        Some(file) => Some(CameraPath::read(file, args.field_of_view().to_degrees())?),
        None => None,
    };
    let known = match (args.frames, &path) {
        (Some(frames), _) => Some(frames),
        (None, Some(path)) => Some(path.frames()?),
        (None, None) => None,
    };
    if let Some(frames) = known {
        check_names(&args, frames)?;
    }
    check_memory(&args, context)?;
    let (scene, sky) = context.phase("load", |context| load(&args, context))?;
    if args.animate && path.is_none() {
        check_motion(&args, &scene, context)?;
    }
    let all = match known {
        Some(frames) => frames,
        None => whole_animation(&args, &scene)?,
    };
    check_names(&args, all)?;
    if let Some(path) = &path {
        for frame in all.first..=all.last {
            path.view(frame, args.size)?;
        }
    }
    // Frames are shared out whole.
    let shard = args.shard.take();
    let part = shard.map_or(0..all.count(), |shard| {
        shard_samples(all.count(), shard.index, shard.count)
    });
    let args = &args;
    let scene = &scene;
    let times = (all.first..=all.last).map(|frame| time(frame, args.fps));
    let moving = moving_instances(scene, times);
    let settings = settings(args, context.common.seed);
    let first = Pose::at(scene, time(all.first, args.fps));
    let what = (&path, args.fps, &scene.motion, args.renew_vpls);
    let plan = Plan {
        fingerprint: fingerprint(args, scene, &first, &what, sky.as_ref(), &settings),
        args,
        scene,
        sky,
        path,
        frames: part.map(|index| all.first + index).collect(),
        settings,
        apart: (args.remembers() || args.secondary.is_some()) && moving.contains(&true),
        lights_move: lights_move(args, scene, &moving),
        moving,
    };
    let done = Done {
        pictures: plan
            .frames
            .iter()
            .map(|&frame| name(&args.output[0], frame))
            .collect(),
        fps: args.fps,
    };
    match &args.visibility {
        Strategy::Quantized(options) => {
            let several = all.count() > 1;
            let cache = quantized(args, options, several, context, scene, &first)?;
            if plan.apart {
                plan.render(context, first, TwoPart(cache))
            } else {
                plan.render(context, first, cache)
            }
        }
        Strategy::Records(options) => {
            let extent = args.extent(all.count());
            let records = options.strategy(args.guarantee, context, scene, &first, &extent)?;
            plan.render(context, first, records)
        }
        Strategy::Exact => plan.render(context, first, Exact),
        Strategy::Occluder => plan.render(context, first, Occluder::default()),
    }?;
    Ok(done)
}

/// Something must move.
fn check_motion(args: &RenderArgs, scene: &Scene, context: &Context) -> Result<(), CliError> {
    let clips = &scene.motion.clips;
    if clips.iter().all(|clip| clip.channels.is_empty()) {
        let what = if clips.is_empty() {
            "no animation"
        } else {
            "animation without keyframes"
        };
        return Err(CliError::input(
            what,
            args.scene.display(),
            "export the scene with its animation, or move the camera with --camera-path",
        ));
    }
    if clips.iter().all(|clip| clip.length <= 0.0) {
        context.warn(format_args!(
            "the animation is 0 s long, nothing will move: {}",
            args.scene.display()
        ));
    }
    Ok(())
}

/// From the first key to the last one.
fn whole_animation(args: &RenderArgs, scene: &Scene) -> Result<Frames, CliError> {
    let clips = scene.motion.clips.iter();
    let seconds = clips.map(|clip| clip.length).fold(0.0, f32::max);
    // A hair more, for lengths that are a whole number of frames but for rounding.
    let last = (f64::from(seconds) * f64::from(args.fps) + 1e-3).floor();
    Frames::new(0, last.clamp(0.0, f64::from(u32::MAX)) as u32)
        .map_err(|error| CliError::input(error, "--frames", "say which frames you want"))
}

/// Whether something moves that lights are picked by.
fn lights_move(args: &RenderArgs, scene: &Scene, moving: &[bool]) -> bool {
    let shines = |instance: &Instance| {
        let mesh = &scene.meshes[instance.mesh as usize];
        scene.materials[mesh.material as usize].emission != glam::Vec3::ZERO
    };
    // Powers of suns and skies depend on the size of the scene.
    (args.lights == super::args::Lights::Power && moving.contains(&true))
        || (scene.instances.iter().zip(moving)).any(|(instance, moves)| *moves && shines(instance))
}

/// Seconds into the animation.
fn time(frame: u32, fps: f32) -> f32 {
    (f64::from(frame) / f64::from(fps)) as f32
}

/// Several frames need names that differ.
fn check_names(args: &RenderArgs, frames: Frames) -> Result<(), CliError> {
    for output in &args.output {
        let name = output.file_name().unwrap_or_default().to_string_lossy();
        if frames.count() > 1 && !name.contains('#') {
            return Err(CliError::input(
                format_args!("{} frames, and one name", frames.count()),
                output.display(),
                "put #### where the frame's number goes, such as -o frame_####.exr",
            ));
        }
        if frames.count() > 1 && name.trim_matches(|c| c != '#').contains(|c| c != '#') {
            return Err(CliError::input(
                "several places for the frame's number",
                output.display(),
                "keep one group of #",
            ));
        }
    }
    Ok(())
}

/// The name of a frame: the number takes the place of the #, with zeros in front so that it has as many digits at least.
fn name(output: &Path, frame: u32) -> PathBuf {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    let Some(start) = name.find('#') else {
        return output.to_owned();
    };
    let digits = name[start..].chars().take_while(|&c| c == '#').count();
    let (before, after) = (&name[..start], &name[start + digits..]);
    output.with_file_name(format!("{before}{frame:0digits$}{after}"))
}

impl Plan<'_> {
    fn names(&self, frame: u32) -> Vec<PathBuf> {
        let outputs = self.args.output.iter();
        outputs.map(|output| name(output, frame)).collect()
    }

    /// Renders frame after frame.
    fn render<V: for<'a> Visibility<Geometry<'a>>>(
        &self,
        context: &mut Context,
        mut pose: Pose,
        mut visibility: V,
    ) -> Result<(), CliError> {
        let args = self.args;
        let checkpoint = args.checkpoint_path();
        let mut done = self.done(&checkpoint)?;
        let done_at_start = done.clone();
        let remembers = args.remembers();
        let renewal = args.renew_vpls.unwrap_or(Renewal(remembers.then_some(1)));
        let mut sequence = renewal.0.map_or_else(Sequence::default, Sequence::renewing);
        if let Some(options) = &args.secondary {
            let extent = args.extent(self.frames.len() as u32);
            sequence.secondary = Some(options.secondary(context, self.scene, &pose, &extent)?);
        }
        // Where what moves was in the picture before.
        let mut before: Vec<Ball> = Vec::new();
        let options = BuildOptions::default();
        let still = context.phase("build", |_| {
            let nothing = vec![false; self.moving.len()];
            let moving = if self.apart { &self.moving } else { &nothing };
            Still::new(self.scene, &pose, moving, &options)
        });
        let still = still.map_err(|error| self.untraceable(error))?;
        let field = args.integrator == Integrator::Field;
        if field {
            sequence.set_sky(
                args.field
                    .sky(&args.sky, self.sky.as_ref(), self.scene, context),
            );
        }
        // Fields depend on the frames before: those that are done are gone through again.
        let replayed = |frame: &u32| {
            field
                && self
                    .frames
                    .iter()
                    .any(|other| other > frame && !done_at_start.contains(other))
        };
        let mut hierarchies = None;
        let environment = args.sky.environment(self.sky.as_ref());
        let mut lights: Option<Lights> = None;
        let mut total: Option<Total> = None;
        let finish = finish(args, self.scene, context.common.seed);
        let mut counts = counts(self.scene);
        context.progress.expect(args.time_limit);
        signals::graceful();
        let working_since = Instant::now();
        let mut cancelled = false;
        std::thread::scope(|scope| -> Result<(), CliError> {
            let mut writing = None;
            for &frame in &self.frames {
                let names = self.names(frame);
                let replay =
                    done_at_start.contains(&frame) && names.iter().all(|name| name.exists());
                if replay && !replayed(&frame) {
                    continue;
                }
                if context.job.is_cancelled() {
                    cancelled = true;
                    break;
                }
                let began = Instant::now();
                let geometry_moved = self.moving.contains(&true) && total.is_some();
                let now = time(frame, args.fps);
                if pose.time != now && !self.scene.motion.clips.is_empty() {
                    let before = std::mem::replace(&mut pose, Pose::at(self.scene, now));
                    if geometry_moved || before.lights != pose.lights {
                        sequence.world_moved();
                    }
                    if self.lights_move || before.lights != pose.lights {
                        lights = None;
                    }
                }
                let geometry = context.phase("build", |_| {
                    if lights.is_none() {
                        let sky = environment.clone();
                        lights = Some(setup::lights_under(args, self.scene, &pose, sky));
                    }
                    if field {
                        Geometry::after(hierarchies.take(), self.scene, &pose)
                    } else if self.apart || !self.moving.contains(&true) {
                        Geometry::in_sequence(self.scene, &pose, &still, &self.moving, &options)
                    } else {
                        Geometry::new(self.scene, &pose, &options)
                    }
                });
                let geometry = geometry.map_err(|error| self.untraceable(error))?;
                let Some(lights) = &lights else {
                    continue;
                };
                if geometry_moved {
                    visibility.moved(&geometry, &before, geometry.moving());
                    if let Some(secondary) = &mut sequence.secondary {
                        secondary.moved(&geometry, &before);
                    }
                }
                before = geometry.moving().to_vec();
                check_light(args, self.scene, lights)?;
                counts.lights = lights.len() as u64;
                context.stats.scene_counts = Some(counts);
                let view = match &self.path {
                    Some(path) => path.view(frame, args.size)?,
                    None => view(args, self.scene, &pose)?,
                };
                let build = began.elapsed().as_secs_f64();
                let world = World {
                    geometry: &geometry,
                    lights,
                };
                let mut film =
                    Film::new(args.size.width, args.size.height, args.records_features());
                let working = Instant::now();
                let report = context.phase("work", |context| {
                    let (job, settings) = (&context.job, &self.settings);
                    sequence.render(
                        &world,
                        &view,
                        &visibility,
                        settings,
                        &mut film,
                        job,
                        &mut |_| (),
                    )
                });
                let work = working.elapsed().as_secs_f64();
                total = Some(Total::add(total.take(), &report, &film));
                if report.stopped_by == StoppedBy::Cancel {
                    cancelled = true;
                    break;
                }
                visibility.next_picture();
                if replay {
                    hierarchies = Some(geometry.into_hierarchies());
                    continue;
                }
                // Written while the next frame is rendered.
                context.phase("write", |_| written(&mut writing, &mut done))?;
                self.save(&checkpoint, &done)?;
                let finish = &finish;
                writing = Some((frame, scope.spawn(move || finish.write(&film, &names))));
                if let Some(prefix) = &args.record_views {
                    let records = Visibility::<Geometry>::records(&visibility);
                    let prefix = name(prefix, frame);
                    write_views(&prefix, records, &sequence, &geometry, &view)?;
                }
                context.stats.frames.push(stats::Frame {
                    frame,
                    seconds: began.elapsed().as_secs_f64(),
                    build,
                    work,
                    queries: report.visibility.queries,
                    traced: report.visibility.traced,
                    vpls_renewed: report.instant_radiosity.map(|ir| ir.renewed),
                    field: self.parts(&report, build, work),
                });
                let whole = self.frames.iter().filter(|f| done.contains(f)).count();
                let left = (self.frames.len() - whole).saturating_sub(1);
                let rendered = context.stats.frames.len() as f64;
                let pace = working_since.elapsed().as_secs_f64() / rendered;
                context.progress.note(&format!(
                    "frame {frame}: {work:.2} s; {left} of {} to go, about {:.0} s",
                    self.frames.len(),
                    left as f64 * pace
                ));
            }
            context.phase("write", |_| written(&mut writing, &mut done))?;
            self.save(&checkpoint, &done)
        })?;
        context.progress.finish();
        if let Some(total) = &total {
            let (strategy, bytes) = match &total.report.field {
                Some(field) => (("field", Class::Biased), field.bytes),
                None => {
                    let strategy = Visibility::<Geometry>::name(&visibility);
                    let class = Visibility::<Geometry>::class(&visibility);
                    let bytes = Visibility::<Geometry>::bytes(&visibility);
                    ((strategy, class), bytes)
                }
            };
            let records = Visibility::<Geometry>::records(&visibility)
                .map(|records| records.cache().report());
            let (samples, report) = (total.samples, &total.report);
            let stats = work_stats(samples, report, strategy, bytes, records, &sequence);
            warn_of_no_records(context, &stats);
            context.stats.work = Some(stats);
            if total.dropped > 0 {
                context.warn(format_args!(
                    "{} samples were not finite and count as black: please report the scene",
                    total.dropped
                ));
            }
        }
        if cancelled {
            if let Some(work) = &mut context.stats.work {
                work.stopped_by = StoppedBy::Cancel.name();
            }
            let whole = (self.frames.iter())
                .filter(|frame| done.contains(frame))
                .count();
            return Err(CliError::Cancelled(format!(
                "{whole} of {} frames are done: {}: go on with the same command and --resume",
                self.frames.len(),
                checkpoint.display()
            )));
        }
        let _ = std::fs::remove_file(&checkpoint);
        Ok(())
    }

    /// Where a frame's time went.
    fn parts(&self, report: &RenderReport, build: f64, work: f64) -> Option<stats::Field> {
        let rays = report.rays.primary + report.rays.secondary + report.visibility.traced;
        match report.field {
            Some(field) => {
                let parts = stats::Field::of(&field);
                Some(stats::Field {
                    t_update: parts.t_update + build,
                    ..parts
                })
            }
            None => self.args.animate.then_some(stats::Field {
                t_update: build,
                t_integration: work,
                rays,
                ..stats::Field::default()
            }),
        }
    }

    fn untraceable(&self, error: impl std::fmt::Display) -> CliError {
        CliError::input("cannot trace the scene", self.args.scene.display(), error)
    }

    /// The frames that an earlier run has done, if `--resume` was given.
    fn done(&self, checkpoint: &Path) -> Result<BTreeSet<u32>, CliError> {
        if !self.args.resume || !checkpoint.exists() {
            return Ok(BTreeSet::new());
        }
        let text = std::fs::read_to_string(checkpoint)
            .map_err(|error| CliError::read(checkpoint, &error))?;
        let mut lines = text.lines();
        let same = lines.next() == Some(DONE)
            && lines.next() == Some(format!("{:016x}", self.fingerprint).as_str());
        if !same {
            return Err(CliError::input(
                "the checkpoint belongs to another work (scene, views, size, seed, settings or program version differ)",
                checkpoint.display(),
                "repeat its command line, or leave out --resume to start anew",
            ));
        }
        lines
            .map(|line| line.parse().ok())
            .collect::<Option<_>>()
            .ok_or_else(|| {
                let cure = "leave out --resume to start anew";
                CliError::input("a damaged checkpoint", checkpoint.display(), cure)
            })
    }

    fn save(&self, checkpoint: &Path, done: &BTreeSet<u32>) -> Result<(), CliError> {
        output::write(checkpoint, |out| {
            writeln!(out, "{DONE}\n{:016x}", self.fingerprint)?;
            done.iter().try_for_each(|frame| writeln!(out, "{frame}"))
        })
    }
}

/// Waits until the frame that is being written is on disk.
fn written(
    writing: &mut Option<(u32, ScopedJoinHandle<Result<(), CliError>>)>,
    done: &mut BTreeSet<u32>,
) -> Result<(), CliError> {
    let Some((frame, writer)) = writing.take() else {
        return Ok(());
    };
    match writer.join() {
        Ok(result) => result?,
        Err(panic) => std::panic::resume_unwind(panic),
    }
    done.insert(frame);
    Ok(())
}

/// Sums over the frames.
struct Total {
    report: RenderReport,
    samples: u32,
    dropped: u64,
}

impl Total {
    fn add(total: Option<Self>, report: &RenderReport, film: &Film) -> Self {
        let mut sum = report.clone();
        if let Some(before) = &total {
            sum.rays.primary += before.report.rays.primary;
            sum.rays.secondary += before.report.rays.secondary;
            sum.secondary.add(&before.report.secondary);
            sum.visibility.add(&before.report.visibility);
        }
        Self {
            report: sum,
            samples: film.min_samples(),
            dropped: film.dropped() + total.map_or(0, |before| before.dropped),
        }
    }
}
