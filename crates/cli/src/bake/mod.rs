//! `occlude bake`: a scene becomes the same scene with light maps. `occlude plan`: what that would take.

mod args;
mod export;
mod subject;

pub use args::{BakeArgs, PlanArgs};

use crate::context::Context;
use crate::error::CliError;
use crate::{VERSION, output, signals, stats};
use args::{DirectionalName, GatherName, LightPart, SidesName, WorkArgs};
use occlude_bake::atlas::{Atlas, Built};
use occlude_bake::bundle::{self, Triangles};
use occlude_bake::gather::{Part, PathSettings};
use occlude_bake::orient;
use occlude_bake::plan::Estimate;
use occlude_bake::rounds::{
    Bake, Ended, GatherKind, MOST_COUNTED, Report, RoundKind, Settings, Stop, Subject,
};
use occlude_bake::state::{State, StateError, read_header};
use occlude_bake::texel::Texels;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{Material, Pose};
use serde_json::json;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use subject::Loaded;

/// Unfinished work is saved this long after the last time at the earliest.
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(1);

/// Saving takes at most one part in so many of the time.
const CHECKPOINT_SHARE: u32 = 30;

/// What a disk is taken to write in a second before the first checkpoint has shown it, bytes.
const DISK_SPEED: f64 = 2e8;

/// Runs `occlude bake`.
pub fn run(args: &BakeArgs, context: &mut Context) -> Result<(), CliError> {
    args.check()?;
    bake(args, context, &[])
}

/// A scene and everything that gathering needs.
struct Setup<'a> {
    loaded: &'a Loaded,
    /// Materials as they were.
    originals: &'a [Material],
    pose: &'a Pose,
    built: &'a Built,
    texels: &'a Texels<'a>,
    geometry: &'a Geometry<'a>,
    gather: GatherKind,
    fingerprint: u64,
    /// What it will take, if that has been asked for.
    estimate: Option<Estimate>,
    /// Bytes of the whole process: at least, and with the buffers as they are set.
    floor: u64,
    peak: u64,
}

impl Setup<'_> {
    /// The scene's file is glTF: it is edited, not written anew.
    fn is_gltf(&self) -> bool {
        let ending = self.loaded.scene.path.extension().unwrap_or_default();
        ["gltf", "glb"].contains(&ending.to_string_lossy().to_lowercase().as_str())
    }
}

/// Loads and lays out a scene, and hands it over. `estimated`: with an estimate of the time.
fn prepared<T>(
    work: &WorkArgs,
    context: &mut Context,
    estimated: bool,
    then: impl FnOnce(&Setup, &Bake, &mut Context) -> Result<T, CliError>,
) -> Result<T, CliError> {
    let mut loaded = context.phase("load", |context| Loaded::load(work, context))?;
    let originals = loaded.make_lambert();
    let pose = Pose::at(&loaded.scene, work.time);
    let mut built = context.phase("unwrap", |context| {
        subject::atlas(work, &loaded, &pose, context)
    })?;
    if let Some(limit) = context.common.memory {
        // What is sure to be too much is refused before hierarchies are built.
        let triangles = crate::inspect::counts(&loaded.scene).triangles;
        let kind = match work.gather {
            GatherName::Bundles => GatherKind::Bundles,
            GatherName::Auto | GatherName::Path => GatherKind::Path,
        };
        let least = stats::resident_memory()
            + triangles * LEAST_BYTES_PER_TRIANGLE
            + u64::from(built.atlas.texels()) * Bake::least_bytes_per_texel(kind);
        if least.max(stats::peak_memory()) > limit {
            return Err(too_little_memory(
                least.max(stats::peak_memory()),
                limit,
                work,
                &loaded,
                &built.atlas,
            ));
        }
    }
    let limit = context.common.memory;
    // The buffers of bundles while not all is there: half of what is left.
    let entries = |settings: &bundle::Settings| match limit {
        Some(limit) => {
            let left = limit.saturating_sub(stats::resident_memory()) / 2;
            settings.entries_within(left, rayon::current_num_threads() as u64)
        }
        None => settings.entries,
    };
    let (geometry, mut triangles) = context.phase("build", |context| {
        let geometry = Geometry::new(&loaded.scene, &pose, &BuildOptions::default())
            .map_err(|error| CliError::input("cannot trace", work.scene.display(), error))?;
        if work.sides == SidesName::Auto {
            turn_over(work, &loaded, &pose, &geometry, &mut built.atlas, context);
        }
        let mut triangles = (work.gather != GatherName::Path && work.light != LightPart::Ao)
            .then(|| Triangles::new(&loaded.scene, &pose, &built.atlas));
        if let Some(triangles) = &mut triangles {
            let mut settings = bundle_settings(&built.atlas, limit);
            settings.entries = entries(&settings);
            triangles.find_backs(context.common.seed, &settings, &context.job);
        }
        Ok::<_, CliError>((geometry, triangles))
    })?;
    let built = built;
    let texels = Texels::new(&loaded.scene, &pose, &built.atlas);
    let seed = context.common.seed;
    let choices: &[GatherKind] = match (work.gather, &triangles) {
        (GatherName::Path, _) | (_, None) => &[GatherKind::Path],
        (GatherName::Bundles, _) => &[GatherKind::Bundles],
        (GatherName::Auto, _) => &[GatherKind::Bundles, GatherKind::Path],
    };
    let mut best: Option<(GatherKind, Option<Estimate>)> = None;
    for &gather in choices {
        if choices.len() == 1 && !estimated {
            best = Some((gather, None));
            break;
        }
        let sky = loaded.sky(work, gather);
        let lights = Lights::new(&loaded.scene, &pose, sky.asked, LightSelection::Tree);
        let subject = Subject {
            world: World {
                geometry: &geometry,
                lights: &lights,
            },
            texels: &texels,
            triangles: triangles.as_ref().filter(|_| gather == GatherKind::Bundles),
            sky: sky.even.as_ref().map(|(sky, brightest)| (sky, *brightest)),
            luminous: sky.luminous,
        };
        let mut settings = settings(work, &built.atlas, gather, seed, limit);
        settings.bundles.entries = entries(&settings.bundles);
        let tried = Bake::new(subject, settings, 0, String::new());
        let job = context.job.clone();
        let estimate = context.phase("plan", |_| tried.estimate(&job));
        let better = best.as_ref().is_none_or(|(_, best)| {
            best.as_ref()
                .is_none_or(|best| estimate.priced < best.priced)
        });
        if better {
            best = Some((gather, Some(estimate)));
        }
    }
    let (gather, estimate) = best.unwrap_or((GatherKind::Path, None));
    if gather == GatherKind::Path {
        triangles = None;
    }
    let sky = loaded.sky(work, gather);
    let lights = Lights::new(&loaded.scene, &pose, sky.asked, LightSelection::Tree);
    context.stats.scene_counts = Some({
        let mut counts = crate::inspect::counts(&loaded.scene);
        counts.lights = lights.len() as u64;
        counts
    });
    if lights.is_empty() && sky.even.is_none() && work.light != LightPart::Ao {
        return Err(CliError::input(
            "no light",
            work.scene.display(),
            "add --environment FILE or --sun AZ,EL (such as --sun 45,45), or use --light ao",
        ));
    }
    let fingerprint = fingerprint(work, &loaded, &pose, &built.atlas, gather, context);
    let mut bake = Bake::new(
        Subject {
            world: World {
                geometry: &geometry,
                lights: &lights,
            },
            texels: &texels,
            triangles: triangles.as_ref(),
            sky: sky.even.as_ref().map(|(sky, brightest)| (sky, *brightest)),
            luminous: sky.luminous,
        },
        settings(work, &built.atlas, gather, seed, limit),
        fingerprint,
        notes()?,
    );
    let (now, so_far) = (stats::resident_memory(), stats::peak_memory());
    let memory = bake.memory(std::fs::metadata(&work.scene).map_or(0, |data| data.len()));
    let with = |more: u64| so_far.max(now + more + more / 16 + SLACK_BYTES);
    if let Some(limit) = limit {
        let left = limit.saturating_sub(now + memory.gathering + SLACK_BYTES);
        let settings = bundle_settings(&built.atlas, Some(limit));
        let entries = settings.entries_within(left / 17 * 16, rayon::current_num_threads() as u64);
        bake.limit_entries(entries);
    }
    let setup = Setup {
        loaded: &loaded,
        originals: &originals,
        pose: &pose,
        built: &built,
        texels: &texels,
        geometry: &geometry,
        gather,
        fingerprint,
        estimate,
        floor: bake.floor(&memory, with),
        peak: with(memory.peak()),
    };
    then(&setup, &bake, context)
}

/// Bakes the backs of two-sided surfaces whose fronts nobody sees.
fn turn_over(
    work: &WorkArgs,
    loaded: &Loaded,
    pose: &Pose,
    geometry: &Geometry,
    atlas: &mut Atlas,
    context: &Context,
) {
    /// Light that has been reflected more often than that decides nothing.
    const BOUNCES: u32 = 2;
    let sky = loaded.sky(work, GatherKind::Path);
    let lights = Lights::new(&loaded.scene, pose, sky.asked, LightSelection::Tree);
    let world = World {
        geometry,
        lights: &lights,
    };
    let settings = PathSettings {
        part: match work.light {
            LightPart::Ao => Part::Occlusion,
            _ => Part::All,
        },
        bounces: BOUNCES,
        luminous: sky.luminous,
        reach: f32::INFINITY,
        seed: context.common.seed,
        directional: false,
    };
    let turned = orient::turn_over(atlas, &world, &settings, &context.job);
    if turned > 0 {
        context.progress.note(&format!(
            "{turned} charts of two-sided surfaces show their back: that is baked (--sides front: not)"
        ));
    }
}

/// Hierarchy and flattened scene, a triangle.
const LEAST_BYTES_PER_TRIANGLE: u64 = 120;

/// Refuses work that needs at least `needed` bytes; says what density would fit, and who has most of the texels.
fn too_little_memory(
    needed: u64,
    limit: u64,
    work: &WorkArgs,
    loaded: &Loaded,
    atlas: &Atlas,
) -> CliError {
    // Texels go with the square of the density; the rest stays. Some more than what is missing: small charts do not shrink.
    let of_texels = u64::from(atlas.texels()) * Bake::least_bytes_per_texel(GatherKind::Bundles);
    let left = of_texels.saturating_sub(needed.saturating_sub(limit) * 5 / 4);
    let fits = work.texels_per_metre * (left as f32 / of_texels.max(1) as f32).sqrt();
    let largest = subject::objects(loaded, atlas).into_iter().next();
    let largest = largest.map_or(String::new(), |(name, texels)| {
        let share = 100.0 * texels as f64 / f64::from(atlas.texels().max(1));
        format!(" ({name} has {share:.0} % of the texels)")
    });
    let cure = if fits > 0.1 * work.texels_per_metre {
        format!("raise it, or lower --texels-per-metre to {fits:.2}{largest}")
    } else {
        format!("raise it: the scene itself takes most of that{largest}")
    };
    let needed = needed.div_ceil(1 << 20);
    CliError::input(
        format_args!("the work needs at least {needed} MiB"),
        "--memory",
        cure,
    )
}

/// What the process takes that nobody counts: stacks, buffers of files, gaps between allocations.
const SLACK_BYTES: u64 = 8 << 20;

/// Bakes; goes on from the finished `parts` of a round, if there are any.
pub fn bake(args: &BakeArgs, context: &mut Context, parts: &[PathBuf]) -> Result<(), CliError> {
    prepared(&args.work, context, false, |setup, bake, context| {
        if let Some(limit) = context.common.memory
            && setup.floor > limit
        {
            return Err(too_little_memory(
                setup.floor,
                limit,
                &args.work,
                setup.loaded,
                &setup.built.atlas,
            ));
        }
        gather(args, setup, bake, context, parts)
    })
}

/// Gathers what is left to gather, and writes what became of it.
fn gather(
    args: &BakeArgs,
    setup: &Setup,
    bake: &Bake,
    context: &mut Context,
    parts: &[PathBuf],
) -> Result<(), CliError> {
    let checkpoint = args.checkpoint_path();
    if parts.is_empty() && args.shard.is_none() && export::is_up_to_date(args, setup) {
        context.progress.note(&format!(
            "{}: nothing has changed since it was baked",
            args.output.display()
        ));
        context.stats.bake = Some(stats::Bake::unchanged(&setup.built.atlas));
        return Ok(());
    }
    let state = if parts.is_empty() {
        start(args, bake, setup.fingerprint, context)?
    } else {
        merge(bake, parts, setup.fingerprint)?
    };
    let mut report = Report::default();
    let mut saver = Saver::new(&checkpoint, &state);
    context.progress.expect(args.work.time_limit);
    signals::graceful();
    let (state, ended) = context.phase("work", |context| {
        rounds(
            args,
            bake,
            state,
            !parts.is_empty(),
            context,
            &mut report,
            &mut saver,
        )
    });
    context.progress.finish();
    let atlas = &setup.built.atlas;
    context.stats.bake = Some(stats::Bake::new(atlas, &report, &state, ended.name()));
    if ended == Ended::Cancel {
        saver.save(&state)?;
        return Err(CliError::Cancelled(format!(
            "round {} of {} is not finished: {}: go on with the same command and --resume",
            state.header.round + 1,
            state.header.rounds,
            checkpoint.display()
        )));
    }
    let whole =
        args.shard.is_none() && bake.is_last(&state) && (parts.is_empty() || state.is_complete());
    let (round, rounds) = (state.header.round, state.header.rounds);
    if whole {
        context.phase("write", |context| {
            export::write(args, setup, bake, &state, context)
        })?;
    } else {
        context.phase("write", |_| {
            output::write(&args.output, |out| state.write(out))
        })?;
    }
    if !parts.is_empty() {
        // After the last round there is none to do.
        let done = if whole { rounds } else { round };
        println!(
            "{}",
            json!({"finished": whole, "rounds_done": done, "rounds": rounds})
        );
    }
    let _ = std::fs::remove_file(&checkpoint);
    context.progress.note(&format!(
        "{}: {:.1} s of gathering",
        args.output.display(),
        context.stats.seconds.work
    ));
    let mut lost = setup.built.problems.iter().filter(|problem| problem.lost);
    match (lost.next(), lost.count()) {
        (Some(first), others) if whole => Err(CliError::failed(
            format_args!(
                "{} meshes have no light map, the others have theirs",
                others + 1
            ),
            &first.mesh,
            "give them a TEXCOORD_1, or repair them",
        )),
        _ => Ok(()),
    }
}

/// Runs `occlude plan`.
pub fn plan(args: &PlanArgs, context: &mut Context) -> Result<(), CliError> {
    args.work.check()?;
    prepared(&args.work, context, true, |setup, bake, context| {
        let planned = setup.estimate.clone().unwrap_or_default();
        let tried = context
            .stats
            .seconds
            .phases
            .get("plan")
            .copied()
            .unwrap_or(0.0);
        // A bake that chooses tries, too.
        let tried = if args.work.gather == GatherName::Auto {
            0.0
        } else {
            tried
        };
        let so_far = context.began().elapsed().as_secs_f64() - tried;
        let atlas = &setup.built.atlas;
        let texels = u64::from(atlas.texels());
        let writing = texels as f64 * SECONDS_PER_TEXEL_WRITTEN;
        let per_texel = bake.memory(0).gathering / u64::from(bake.sides().max(1));
        let objects = subject::objects(setup.loaded, atlas);
        let gather = match setup.gather {
            GatherKind::Path => "path",
            GatherKind::Bundles => "bundles",
        };
        let seconds = so_far + planned.seconds() + writing;
        let directions = bake.rounds().last().map_or(0, |round| round.total);
        if args.json {
            let objects: Vec<_> = objects
                .iter()
                .map(|(name, texels)| json!({"node": name, "texels": texels, "bytes": texels * per_texel}))
                .collect();
            let rounds: Vec<_> = bake
                .rounds()
                .iter()
                .zip(&planned.rounds)
                .map(|(round, seconds)| json!({"name": round.name, "items": round.total, "seconds": seconds}))
                .collect();
            let plan = json!({
                "texels": texels, "pages": atlas.pages.len(), "directions": directions, "gather": gather,
                "floor_bytes": setup.floor, "peak_bytes": setup.peak, "seconds": seconds, "rays": planned.rays,
                "rounds": rounds, "objects": objects,
            });
            println!("{plan:#}");
            return Ok(());
        }
        let mib = |bytes: u64| bytes.div_ceil(1 << 20);
        println!("texels      {texels} on {} pages", atlas.pages.len());
        println!("gather      {gather}, {directions} directions");
        println!(
            "memory      {} MiB; at least {} MiB",
            mib(setup.peak),
            mib(setup.floor)
        );
        println!("time        {seconds:.0} s on this machine");
        for (round, seconds) in bake.rounds().iter().zip(&planned.rounds) {
            println!("  {:<14}{} items, {seconds:.1} s", round.name, round.total);
        }
        println!("largest objects");
        for (name, texels) in objects.iter().take(LISTED_OBJECTS) {
            println!("  {texels:>10} texels  {name}");
        }
        Ok(())
    })
}

/// Finishing and encoding a texel.
const SECONDS_PER_TEXEL_WRITTEN: f64 = 0.5e-6;

/// Objects that `plan` lists for people.
const LISTED_OBJECTS: usize = 10;

/// Gathers until the end, or the end of a shard's part of its round. `merged`: the state is a whole round made of parts.
fn rounds(
    args: &BakeArgs,
    bake: &Bake,
    mut state: State,
    merged: bool,
    context: &Context,
    report: &mut Report,
    saver: &mut Saver,
) -> (State, Ended) {
    let share = args.share();
    if merged {
        if !bake.is_last(&state) {
            state = bake.next_round(state, share);
        }
        return (state, Ended::Samples);
    }
    let began = Instant::now();
    let mut stopped = Ended::Samples;
    loop {
        let stop = stop(&args.work, bake, &state, began);
        let mut at_rest = |state: &State| saver.rest(state);
        let ended = bake.run_round(&mut state, stop, &context.job, report, &mut at_rest);
        if ended != Ended::Samples {
            stopped = ended;
        }
        if ended == Ended::Cancel || args.shard.is_some() || bake.is_last(&state) {
            return (state, stopped);
        }
        state = bake.next_round(state, share);
        saver.rest(&state);
    }
}

/// When a round ends early. Of the time, earlier rounds take what the fixed numbers of items would give them.
fn stop(work: &WorkArgs, bake: &Bake, state: &State, began: Instant) -> Stop {
    let last = bake.is_last(state);
    let rest = bake.rounds().len() as u32 - state.header.round;
    let is_direct = bake.rounds()[state.header.round as usize].kind == RoundKind::Direct;
    Stop {
        time_limit: work.time_limit.map(|limit| {
            let left = limit.saturating_sub(began.elapsed());
            if last {
                left
            } else if is_direct {
                left / 4
            } else {
                left / (rest + 1)
            }
        }),
        // Independent errors add up by their squares; earlier ones are averaged before they show.
        noise: work
            .noise
            .map(f64::from)
            .map(|noise| match (last, is_direct) {
                (true, true) => noise,
                (true, false) => 0.85 * noise,
                (false, true) => 0.5 * noise,
                (false, false) => noise,
            }),
    }
}

/// The state to begin with: the checkpoint's, that of the rounds before, or an empty one.
fn start(
    args: &BakeArgs,
    bake: &Bake,
    fingerprint: u64,
    context: &Context,
) -> Result<State, CliError> {
    let share = args.share();
    let checkpoint = args.checkpoint_path();
    if args.resume && checkpoint.exists() {
        let state = read(bake, &checkpoint, fingerprint)?;
        let items = occlude_render::work::shard_samples(state.header.total, share.0, share.1);
        if state.header.items != items {
            return Err(CliError::input(
                "the checkpoint belongs to another shard",
                checkpoint.display(),
                "repeat its command line, or leave out --resume to start anew",
            ));
        }
        context.progress.note(&format!(
            "going on from {}: round {} of {}",
            checkpoint.display(),
            state.header.round + 1,
            state.header.rounds
        ));
        return Ok(state);
    }
    if let Some(after) = &args.after {
        let state = read(bake, after, fingerprint)?;
        if state.done.iter().any(|&done| done > 0) {
            return Err(CliError::input(
                "this is a part of a round, not what was made of all its parts",
                after.display(),
                "give what occlude merge wrote",
            ));
        }
        let State {
            header,
            direct,
            previous,
            direct_moments,
            ..
        } = state;
        return Ok(bake.begin(header.round, share, direct, previous, direct_moments));
    }
    Ok(bake.begin(0, share, Vec::new(), Vec::new(), Vec::new()))
}

/// All parts of a round together.
fn merge(bake: &Bake, parts: &[PathBuf], fingerprint: u64) -> Result<State, CliError> {
    let mut states = Vec::new();
    for path in parts {
        let state = read(bake, path, fingerprint)?;
        states.push((path, state));
    }
    let first = states.first().map(|(_, state)| state.header.clone());
    states.sort_by_key(|(_, state)| (state.header.items.start, state.header.items.end));
    let mut whole: Option<State> = None;
    for (path, state) in states {
        let refuse = |what: &str, cure: &str| Err(CliError::input(what, path.display(), cure));
        if first.as_ref().is_some_and(|first| {
            (first.round, first.total) != (state.header.round, state.header.total)
        }) {
            return refuse("a part of another round", "merge the parts of one round");
        }
        if !state.is_complete() {
            return refuse("an unfinished part", "finish it with --resume first");
        }
        let end = whole.as_ref().map_or(0, |whole| whole.header.items.end);
        if state.header.items.start < end {
            return refuse("a part that is given twice", "give each part once");
        }
        if state.header.items.start > end {
            return refuse(
                "the part before this one is missing",
                "give all parts I/N of the round",
            );
        }
        match &mut whole {
            None => whole = Some(state),
            Some(whole) => {
                whole.header.items.end = state.header.items.end;
                if whole.sums.merge(&state.sums).is_err() {
                    return refuse("a part of another work", "merge parts of one command line");
                }
            }
        }
    }
    let mut whole = whole.ok_or_else(|| CliError::input("no parts", "PARTS", "name some"))?;
    if whole.header.items.end != whole.header.total {
        return Err(CliError::input(
            "the last part is missing",
            "PARTS",
            "give all parts I/N of the round",
        ));
    }
    let total = whole.header.total;
    whole.done.fill(total);
    Ok(whole)
}

/// Reads a state that must belong to this work.
fn read(bake: &Bake, path: &Path, fingerprint: u64) -> Result<State, CliError> {
    let unreadable = |error: std::io::Error| CliError::read(path, &error);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    State::read(&mut file, fingerprint, bake.sides(), |round| {
        bake.units_of(round)
    })
    .map_err(|error| {
        let cure = match error {
            StateError::OtherWork => "repeat its command line, or start anew",
            _ => "it may be damaged: start anew",
        };
        CliError::input(error, path.display(), cure)
    })
}

/// Merges the parts of a round into the rounds so far, or, after the last round, into what one machine would have written.
pub fn merge_parts(
    line: Vec<String>,
    parts: &[PathBuf],
    output: &Path,
    context: &mut Context,
) -> Result<(), CliError> {
    let Some((mut args, common)) = crate::bake_command(line) else {
        return Err(CliError::input(
            "not a part of a bake by this version of the program",
            parts[0].display(),
            "give files written by occlude bake --shard",
        ));
    };
    (context.common.seed, context.common.memory) = (common.seed, common.memory);
    args.output = output.to_path_buf();
    (args.shard, args.after, args.checkpoint, args.resume) = (None, None, None, false);
    // Whether a file or a folder is written is known when the parts have been read.
    args.work.check()?;
    bake(&args, context, parts)
}

/// The command line that a part was made with, if the file is a part of a bake.
pub fn command_line_of(part: &Path) -> Option<Vec<String>> {
    let mut file = BufReader::new(File::open(part).ok()?);
    let header = read_header(&mut file).ok()?;
    serde_json::from_str(&header.notes).ok()
}

/// This command line, to travel with parts.
fn notes() -> Result<String, CliError> {
    let line: Vec<String> = std::env::args_os()
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect();
    serde_json::to_string(&line)
        .map_err(|error| CliError::failed("cannot encode the command line", "bake", error))
}

/// Saves unfinished work now and then.
struct Saver<'a> {
    path: &'a Path,
    saved: Instant,
    period: Duration,
}

impl<'a> Saver<'a> {
    fn new(path: &'a Path, state: &State) -> Self {
        let bytes = State::bytes(state.header.sides, state.header.units);
        let takes = Duration::from_secs_f64(bytes as f64 / DISK_SPEED);
        Self {
            path,
            saved: Instant::now(),
            period: CHECKPOINT_PERIOD.max(takes * CHECKPOINT_SHARE),
        }
    }

    fn save(&self, state: &State) -> Result<(), CliError> {
        output::write(self.path, |out| state.write(out))
    }

    /// A checkpoint that cannot be written now is tried again later.
    fn rest(&mut self, state: &State) {
        if self.saved.elapsed() < self.period {
            return;
        }
        let began = Instant::now();
        let _ = self.save(state);
        self.saved = Instant::now();
        self.period = CHECKPOINT_PERIOD.max(began.elapsed() * CHECKPOINT_SHARE);
    }
}

fn settings(
    work: &WorkArgs,
    atlas: &Atlas,
    gather: GatherKind,
    seed: u64,
    limit: Option<u64>,
) -> Settings {
    Settings {
        gather,
        part: match work.light {
            LightPart::All => Part::All,
            LightPart::Direct => Part::Direct,
            LightPart::Indirect => Part::Indirect,
            LightPart::Ao => Part::Occlusion,
        },
        bounces: work.bounces,
        directions: work.total_directions().min(MOST_COUNTED),
        reach: work.ao_distance.unwrap_or(f32::INFINITY),
        seed,
        directional: work.directional != DirectionalName::None,
        bundles: bundle_settings(atlas, limit),
    }
}

/// How bundles are cut into tiles: a matter of the texels and of the memory limit alone.
fn bundle_settings(atlas: &Atlas, limit: Option<u64>) -> bundle::Settings {
    let settings = limit.map_or_else(bundle::Settings::default, bundle::Settings::for_limit);
    // As many pixels as texels: a finer analysis costs more than what it knows is worth.
    let useful = (f64::from(atlas.texels()).sqrt() as u32).next_power_of_two();
    bundle::Settings {
        analysis: useful.max(LEAST_ANALYSIS).min(settings.analysis),
        ..settings
    }
}

/// Pixels along a side of the analysis of bundles at least.
const LEAST_ANALYSIS: u32 = 64;

/// A number for everything that the sums depend on.
fn fingerprint(
    work: &WorkArgs,
    loaded: &Loaded,
    pose: &Pose,
    atlas: &Atlas,
    gather: GatherKind,
    context: &Context,
) -> u64 {
    let text = format!(
        "{:?}",
        (
            VERSION,
            settings(
                work,
                atlas,
                gather,
                context.common.seed,
                context.common.memory
            ),
            work.texels_per_metre,
            (work.pages_max, work.padding, work.unwrap, work.sides),
            &work.select,
            work.sky.environment_rotation,
            work.sky.environment_scale,
        )
    );
    let mut hash = occlude_scene::fingerprint(&loaded.scene, pose);
    // FNV-1a: tells works apart, not forgers.
    let mut byte = |byte: u8| hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    text.bytes().for_each(&mut byte);
    if let Some(sky) = &loaded.picture {
        sky.pixels
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes())
            .for_each(&mut byte);
    }
    hash
}
