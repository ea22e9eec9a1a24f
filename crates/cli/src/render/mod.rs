//! `occlude render`: a scene becomes a picture.

mod animate;
mod args;
mod baked;
mod camera_path;
mod field;
mod film;
mod records;
mod sequence;
mod setup;
mod strategy;

pub use animate::run as animate;
pub use args::RenderArgs;

use crate::context::Context;
use crate::error::CliError;
use crate::inspect::{bounds, counts};
use crate::picture::Finish;
use crate::values::Size;
use crate::{VERSION, merge, output, signals, stats};
use args::{Filter, Integrator, Sampler};
use occlude_image::{Depth, Look, Picture};
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{
    self, AtRest, BidirectionalLimits, InstantRadiosity, PathLimits, RenderReport, RenderSettings,
    Secondary, Sequence, StoppedBy, World,
};
use occlude_render::light::Lights;
use occlude_render::sampling::SamplerKind;
use occlude_render::work::{Work, shard_samples};
use occlude_scene::{LightKind, Pose, Scene};
use occlude_visibility::quantized::{Asks, BoundingSphere, Quantized, Share, Workload};
use occlude_visibility::records::{Records, RecordsReport};
use occlude_visibility::{Class, Exact, Occluder, Visibility};
use setup::{build, load, view};
use std::path::Path;
use std::time::{Duration, Instant};
use strategy::{GuaranteeName, QuantizedOptions, Strategy};

/// How often unfinished work is saved.
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(60);

/// Runs `occlude render`.
pub fn run(mut args: RenderArgs, context: &mut Context) -> Result<(), CliError> {
    args.check(context.common.memory)?;
    if args.is_sequence() {
        return sequence::run(args, context).map(drop);
    }
    check_memory(&args, context)?;
    let (scene, sky) = context.phase("load", |context| load(&args, context))?;
    let pose = Pose::at(&scene, args.time);
    let view = view(&args, &scene, &pose)?;
    let (geometry, lights) =
        context.phase("build", |_| build(&args, &scene, &pose, sky.as_ref()))?;
    let mut counts = counts(&scene);
    counts.lights = lights.len() as u64;
    context.stats.scene_counts = Some(counts);
    if args.integrator == Integrator::Baked {
        let filter = settings(&args, context.common.seed).filter;
        let look = finish(&args, &scene, context.common.seed).look;
        return baked::run(&args, context, &geometry, &lights, &view, filter, look);
    }
    check_light(&args, &scene, &lights)?;
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    match &args.visibility {
        Strategy::Quantized(options) => {
            let quantized = quantized(&args, options, false, context, &scene, &pose)?;
            work(&args, context, &world, &view, sky.as_ref(), &quantized)
        }
        Strategy::Records(options) => {
            let extent = args.extent(1);
            let records = options.strategy(args.guarantee, context, &scene, &pose, &extent)?;
            work(&args, context, &world, &view, sky.as_ref(), &records)
        }
        Strategy::Exact => work(&args, context, &world, &view, sky.as_ref(), &Exact),
        Strategy::Occluder => work(
            &args,
            context,
            &world,
            &view,
            sky.as_ref(),
            &Occluder::default(),
        ),
    }
}

/// The film must fit.
fn check_memory(args: &RenderArgs, context: &Context) -> Result<(), CliError> {
    let Size { width, height } = args.size;
    let mut film_bytes = Film::bytes(width, height, args.records_features());
    if args.integrator == Integrator::Bidirectional {
        film_bytes = film_bytes.saturating_add(Film::splat_bytes(width, height));
    }
    if context
        .common
        .memory
        .is_some_and(|limit| film_bytes > limit)
    {
        return Err(CliError::input(
            format_args!("the film alone needs {film_bytes} bytes"),
            format_args!("--size {}", args.size),
            "raise --memory or lower --size",
        ));
    }
    Ok(())
}

/// A picture without light is a mistake.
fn check_light(args: &RenderArgs, scene: &Scene, lights: &Lights) -> Result<(), CliError> {
    if lights.is_empty()
        && args.integrator != Integrator::Ao
        && !scene.materials.iter().any(|m| m.unlit)
    {
        return Err(CliError::input(
            "no light",
            args.scene.display(),
            "add --environment FILE or --sun AZ,EL (such as --sun 45,45), or use --integrator ao",
        ));
    }
    Ok(())
}

/// The cache that `--visibility quantized` asks for; `frames`: for several pictures.
fn quantized(
    args: &RenderArgs,
    options: &QuantizedOptions,
    frames: bool,
    context: &Context,
    scene: &Scene,
    pose: &Pose,
) -> Result<Quantized, CliError> {
    let asks = match args.integrator {
        Integrator::Path
        | Integrator::Direct
        | Integrator::Ao
        | Integrator::Field
        | Integrator::Baked => Asks::Single,
        Integrator::Bidirectional => Asks::Pairs,
        Integrator::InstantRadiosity => Asks::Many,
    };
    let directions = (scene.lights.iter())
        .filter(|light| matches!(light.kind, LightKind::Directional { .. }))
        .count();
    let settings = options.settings(&Workload {
        asks,
        guarantee: args.guarantee.unwrap_or(GuaranteeName::Bounded).into(),
        sequence: frames,
        samples_per_pixel: args.known_samples(),
        pixels: u64::from(args.size.width) * u64::from(args.size.height),
        points: scene.lights.len() - directions,
        directions,
        virtual_lights: if args.max_depth > 1 { args.vpls } else { 0 },
        seed: context.common.seed,
    });
    let copies = match settings.share {
        Share::All | Share::Frames => 1,
        Share::Tile | Share::Thread => rayon::current_num_threads() as u64,
    };
    let kinds = match settings.share {
        Share::Tile | Share::Frames => 1,
        Share::Thread | Share::All => 1 + u64::from(asks == Asks::Many),
    };
    let bytes = (settings.table_bytes as u64).saturating_mul(copies * kinds);
    if let Some(limit) = context.common.memory
        && bytes > limit
    {
        return Err(CliError::input(
            format_args!("the tables alone take {bytes} bytes"),
            "--visibility",
            "raise --memory or add :table=SIZE",
        ));
    }
    let (min, max) = bounds(scene, pose).unwrap_or_default();
    Quantized::new(settings, BoundingSphere::around(min, max))
        .map_err(|error| CliError::input(error, "--visibility", "see occlude render --help"))
}

/// Renders, and writes what became of it.
fn work<'a, V: Visibility<Geometry<'a>>>(
    args: &RenderArgs,
    context: &mut Context,
    world: &World<'a>,
    view: &View,
    sky: Option<&Picture>,
    visibility: &V,
) -> Result<(), CliError> {
    let settings = settings(args, context.common.seed);
    let finish = finish(args, world.geometry.scene, context.common.seed);
    let part = Work {
        fingerprint: fingerprint(
            args,
            world.geometry.scene,
            world.geometry.pose,
            view,
            sky,
            &settings,
        ),
        total: args.total_samples(),
        samples: settings.samples.clone(),
        notes: finish.notes(),
    };
    let checkpoint = args.checkpoint_path();
    let mut sequence = Sequence::default();
    if let Some(options) = &args.secondary {
        let (scene, pose) = (world.geometry.scene, world.geometry.pose);
        sequence.secondary = Some(options.secondary(context, scene, pose, &args.extent(1))?);
    }
    let mut film = match resume(args, &checkpoint, &part)? {
        Some((film, state)) => {
            context.progress.note(&format!(
                "going on from {}: {} samples a pixel",
                checkpoint.display(),
                film.min_samples()
            ));
            (sequence.restore_records(world, visibility, &settings, &film, &state)).map_err(
                |error| {
                    let cure = "leave out --resume to start anew";
                    CliError::input(error, checkpoint.display(), cure)
                },
            )?;
            film
        }
        None => Film::new(args.size.width, args.size.height, args.records_features()),
    };
    context.progress.expect(args.time_limit);
    signals::graceful();
    let save = |film: &Film, secondary: Option<&Secondary>| {
        let state = integrator::records_state(visibility, secondary);
        output::write(&checkpoint, |mut out| {
            part.write_checkpoint(film, &state, &mut out)
        })
    };
    let mut saved = Instant::now();
    if args.integrator == Integrator::Field {
        sequence.set_sky(
            args.field
                .sky(&args.sky, sky, world.geometry.scene, context),
        );
    }
    let report = context.phase("work", |context| {
        let mut at_rest = |rest: &AtRest| {
            // A checkpoint that cannot be written now is tried again later, and reported at the end.
            if saved.elapsed() >= CHECKPOINT_PERIOD {
                let _ = save(rest.film, rest.secondary);
                saved = Instant::now();
            }
        };
        sequence.render(
            world,
            view,
            visibility,
            &settings,
            &mut film,
            &context.job,
            &mut at_rest,
        )
    });
    context.progress.finish();
    let done = film.min_samples();
    let (strategy, bytes) = match &report.field {
        Some(field) => (("field", Class::Biased), field.bytes),
        None => ((visibility.name(), visibility.class()), visibility.bytes()),
    };
    let records = visibility.records().map(|records| records.cache().report());
    let stats = work_stats(done, &report, strategy, bytes, records, &sequence);
    warn_of_no_records(context, &stats);
    context.stats.work = Some(stats);
    if let Some(prefix) = &args.record_views {
        write_views(
            prefix,
            visibility.records(),
            &sequence,
            world.geometry,
            view,
        )?;
    }
    if args.integrator == Integrator::Field {
        let same = |prefix: &Path| prefix.to_owned();
        (args.field).write_views(same, &sequence, world.geometry, view)?;
    }
    if film.dropped() > 0 {
        context.warn(format_args!(
            "{} samples were not finite and count as black: please report the scene",
            film.dropped()
        ));
    }
    let cancelled = report.stopped_by == StoppedBy::Cancel;
    let save = || save(&film, sequence.secondary.as_ref());
    context.phase("write", |_| match (cancelled, args.shard) {
        (true, Some(_)) => save(),
        (true, None) => save().and(finish.write(&film, &args.output)),
        (false, Some(_)) => output::write(&args.output[0], |mut out| part.write(&film, &mut out)),
        (false, None) => finish.write(&film, &args.output),
    })?;
    if cancelled {
        let what = format!(
            "{done} of {} samples a pixel are done: {}",
            settings.samples.len(),
            checkpoint.display()
        );
        return Err(CliError::Cancelled(format!(
            "{what}: go on with the same command and --resume"
        )));
    }
    // Finished: what the checkpoint holds is in the outputs now.
    let _ = std::fs::remove_file(&checkpoint);
    let names: Vec<String> = args
        .output
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    context.progress.note(&format!(
        "{}: {done} samples a pixel in {:.1} s",
        names.join(", "),
        context.stats.seconds.work
    ));
    Ok(())
}

/// What `--stats` says about rendering.
fn work_stats(
    samples_per_pixel: u32,
    report: &RenderReport,
    (strategy, class): (&str, Class),
    bytes: u64,
    records: Option<RecordsReport>,
    sequence: &Sequence,
) -> stats::Work {
    let visibility = report.visibility.clone();
    let secondary = (sequence.secondary.as_ref()).map(|secondary| secondary.report().records);
    let class = if secondary.is_some() {
        Class::Biased
    } else {
        class
    };
    let fills = [records, secondary];
    let fill: u64 = fills.iter().flatten().map(|report| report.fill_rays).sum();
    let rays = secondary.map(|_| report.secondary);
    let virtual_lights = report.instant_radiosity;
    let records = secondary.or(records);
    let records = records.map(|report| records::statistics(&report, rays, &visibility));
    stats::Work {
        samples_per_pixel,
        stopped_by: report.stopped_by.name(),
        rays: stats::Rays {
            primary: report.rays.primary,
            secondary: report.rays.secondary,
            shadow: visibility.traced,
            fill: visibility.fill + fill,
        },
        field: report.field.map(|field| stats::Field::of(&field)),
        visibility: stats::Visibility {
            strategy: strategy.to_owned(),
            class: class.name(),
            queries: visibility.queries,
            answered: visibility.answered,
            traced: visibility.traced,
            refined: visibility.refined,
            overwritten: visibility.overwritten,
            bytes: bytes.max(secondary.map_or(0, |report| report.peak_bytes)),
        },
        records,
        vpls: virtual_lights.map(|ir| ir.vpls),
        clamp: (virtual_lights.map(|ir| ir.clamp)).filter(|clamp| clamp.is_finite()),
        clamped_energy: virtual_lights.map(|ir| ir.clamped_energy),
    }
}

/// See [`records::write_views`].
fn write_views(
    prefix: &Path,
    records: Option<&Records>,
    sequence: &Sequence,
    geometry: &Geometry,
    view: &View,
) -> Result<(), CliError> {
    let own = (sequence.secondary.as_ref()).and_then(|secondary| secondary.cache());
    let shared = records.map(Records::cache);
    match own.or(shared.as_deref()) {
        Some(cache) => records::write_views(prefix, cache, geometry, view),
        None => Ok(()),
    }
}

/// A camera that sees nothing leaves records without a place.
fn warn_of_no_records(context: &mut Context, stats: &stats::Work) {
    if stats.records.is_some_and(|records| records.count == 0) {
        context.warn(format_args!(
            "no place for records: no path from the camera meets a rough surface, so everything was traced"
        ));
    }
}

fn settings(args: &RenderArgs, seed: u64) -> RenderSettings {
    let total = args.total_samples();
    RenderSettings {
        integrator: match args.integrator {
            Integrator::Path => integrator::Integrator::Path(PathLimits {
                max_depth: args.max_depth,
                regularize: args.regularize,
            }),
            Integrator::Bidirectional => {
                integrator::Integrator::Bidirectional(BidirectionalLimits::new(args.max_depth))
            }
            Integrator::Direct | Integrator::Baked => {
                integrator::Integrator::Path(PathLimits::new(args.max_depth.min(1)))
            }
            Integrator::InstantRadiosity => {
                integrator::Integrator::InstantRadiosity(InstantRadiosity {
                    max_depth: args.max_depth,
                    vpls: args.vpls,
                    clamp: args.clamp,
                    compensate: args.compensate,
                })
            }
            Integrator::Field => integrator::Integrator::Field(args.field.settings()),
            Integrator::Ao => integrator::Integrator::AmbientOcclusion {
                distance: args.ao_distance.unwrap_or(f32::INFINITY),
            },
        },
        sampler: match args.sampler {
            Sampler::Sobol => SamplerKind::Sobol,
            Sampler::Independent => SamplerKind::Independent,
        },
        filter: match args.filter {
            Filter::Box => PixelFilter::Box,
            Filter::Tent => PixelFilter::Tent,
            Filter::Gaussian => PixelFilter::Gaussian,
        },
        seed,
        samples: args.shard.map_or(0..total, |shard| {
            shard_samples(total, shard.index, shard.count)
        }),
        time_limit: args.time_limit,
        noise: args.noise.map(f64::from),
    }
}

fn finish(args: &RenderArgs, scene: &Scene, seed: u64) -> Finish {
    let name = |value: &dyn std::fmt::Debug| format!("{value:?}").to_lowercase();
    Finish {
        aov: args.aov.clone(),
        depth: if args.half { Depth::Half } else { Depth::Float },
        look: Look {
            tone_map: args.tonemap,
            exposure_ev: args.exposure,
        },
        about: vec![
            ("scene".to_owned(), scene.name.clone()),
            ("seed".to_owned(), seed.to_string()),
            ("integrator".to_owned(), name(&args.integrator)),
            ("maxDepth".to_owned(), args.max_depth.to_string()),
        ],
    }
}

/// A number for everything that the picture depends on, the number of samples apart.
fn fingerprint(
    args: &RenderArgs,
    scene: &Scene,
    pose: &Pose,
    view: &impl std::fmt::Debug,
    sky: Option<&Picture>,
    settings: &RenderSettings,
) -> u64 {
    let text = format!(
        "{:?}",
        (
            VERSION,
            view,
            settings.integrator,
            settings.sampler,
            settings.filter,
            settings.seed,
            args.lights,
            args.records_features(),
            (&args.visibility, &args.secondary),
            args.guarantee,
            args.sky.environment_rotation,
            args.sky.environment_scale
        )
    );
    let mut hash = occlude_scene::fingerprint(scene, pose);
    // FNV-1a: tells works apart, not forgers.
    let mut byte = |byte: u8| hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    text.bytes().for_each(&mut byte);
    if let Some(sky) = sky {
        sky.pixels
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes())
            .for_each(&mut byte);
    }
    hash
}

/// Film and state of the checkpoint, if `--resume` was given and there is one.
fn resume(
    args: &RenderArgs,
    checkpoint: &Path,
    part: &Work,
) -> Result<Option<(Film, Vec<u8>)>, CliError> {
    if !args.resume || !checkpoint.exists() {
        return Ok(None);
    }
    let (film, work, state) = merge::read_checkpoint(checkpoint)?;
    let same_film = (film.width(), film.height(), film.has_features())
        == (args.size.width, args.size.height, args.records_features());
    if !same_film || work.fingerprint != part.fingerprint || work.samples != part.samples {
        return Err(CliError::input(
            "the checkpoint belongs to another work (scene, view, size, seed, settings or program version differ)",
            checkpoint.display(),
            "repeat its command line, or leave out --resume to start anew",
        ));
    }
    Ok(Some((film, state)))
}
