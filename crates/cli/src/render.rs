//! `occlude render`: a scene becomes a picture.

use crate::context::Context;
use crate::error::CliError;
use crate::inspect::{bounds, counts};
use crate::picture::{Aov, Finish, aovs};
use crate::values::{self, Look as CameraLook, Shard, Size, Sun};
use crate::{VERSION, merge, output, signals, stats};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use glam::{Affine3A, Quat, Vec3};
use occlude_bvh::BuildOptions;
use occlude_image::{Depth, Encoding, Format, Limits, Look, Picture, ToneMap};
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{self, RenderSettings, StoppedBy, World, render};
use occlude_render::light::{self, Environment, LightSelection};
use occlude_render::sampling::SamplerKind;
use occlude_render::work::{Work, shard_samples};
use occlude_scene::{Light, LightKind, Node, Pose, Scene};
use occlude_visibility::{Exact, Occluder, Visibility};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Samples a pixel when nothing else says when to stop.
const DEFAULT_SAMPLES: u32 = 64;

/// Samples a pixel at most.
const MAX_SAMPLES: u32 = 1 << 24;

/// How often unfinished work is saved.
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(60);

/// How wide the sun is, seen from the earth.
const SUN_DIAMETER_DEGREES: f32 = 0.53;

/// Options of `occlude render`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  occlude render sponza.glb -o sponza.png
  occlude render room.glb -o room.exr -o room.png --samples 256 --size 1920x1080
  occlude render statue.obj --environment sky.hdr --time-limit 30s -o statue.png
  occlude render big.glb -o part1.exr --shard 1/4    (then: occlude merge part*.exr -o big.exr)")]
pub struct RenderArgs {
    /// Scene: .glb, .gltf or .obj
    pub scene: PathBuf,

    /// Picture to write, by its ending: .exr and .hdr hold scene-linear Rec. 709 radiance, .png is exposed and tone
    /// mapped (see --tonemap). May be given several times [default: the scene's name with .png, in this folder]
    #[arg(short, long = "output", value_name = "FILE", help_heading = "Output")]
    pub output: Vec<PathBuf>,

    /// Further layers in every .exr output: albedo, normal (world space), depth (metres), variance (of the pixel's luminance)
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "LIST",
        help_heading = "Output"
    )]
    pub aov: Vec<Aov>,

    /// Exposure of .png outputs in stops: +1 doubles the brightness
    #[arg(long, value_name = "EV", default_value = "0", value_parser = values::number, allow_hyphen_values = true, help_heading = "Output")]
    pub exposure: f32,

    /// How .png outputs turn radiance into display colours
    #[arg(long, value_name = "NAME", default_value = ToneMap::default().name(), value_parser = tone_maps(), help_heading = "Output")]
    pub tonemap: ToneMap,

    /// Store .exr outputs with 16 bits a channel [default: 32]
    #[arg(long, help_heading = "Output")]
    pub half: bool,

    /// Not built in yet: refused
    #[arg(long, help_heading = "Output")]
    pub denoise: bool,

    /// Width and height in pixels; the vertical field of view is kept
    #[arg(
        long,
        value_name = "WxH",
        default_value = "1280x720",
        help_heading = "View"
    )]
    pub size: Size,

    /// Camera of the file, by name or by index from 0 [default: the first; a file without cameras is framed whole]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "View")]
    pub camera: Option<String>,

    /// Own camera: eye and target in metres
    #[arg(
        long,
        value_name = "EX,EY,EZ,TX,TY,TZ",
        allow_hyphen_values = true,
        conflicts_with = "camera",
        help_heading = "View"
    )]
    pub camera_look: Option<CameraLook>,

    /// Vertical field of view of --camera-look in degrees
    #[arg(long, value_name = "DEG", default_value = "40", value_parser = values::field_of_view, requires = "camera_look", help_heading = "View")]
    pub fov: f32,

    /// Scene of the file, by name or by index from 0 [default: the file's own choice]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "View")]
    pub gltf_scene: Option<String>,

    /// Moment of the file's animations in seconds
    #[arg(long, value_name = "T", default_value = "0", value_parser = values::number, allow_hyphen_values = true, help_heading = "View")]
    pub time: f32,

    /// How samples spread around a pixel's centre
    #[arg(long, value_enum, default_value_t = Filter::Box, help_heading = "View")]
    pub filter: Filter,

    /// Latitude-longitude sky (.hdr, .exr): row 0 is up, the middle column lies along +X
    #[arg(long, value_name = "FILE", help_heading = "Light")]
    pub environment: Option<PathBuf>,

    /// Turn the sky about +Y, degrees, counterclockwise seen from above
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = values::number, allow_hyphen_values = true, help_heading = "Light")]
    pub environment_rotation: f32,

    /// Factor on the sky's radiance
    #[arg(long, value_name = "X", default_value = "1", value_parser = values::not_negative, help_heading = "Light")]
    pub environment_scale: f32,

    /// Add a sun: azimuth (from +X towards +Z) and elevation in degrees, and its irradiance on a facing surface
    /// [default: pi, which a white surface shows as radiance 1]
    #[arg(
        long,
        value_name = "AZ,EL[,IRRADIANCE]",
        allow_hyphen_values = true,
        help_heading = "Light"
    )]
    pub sun: Option<Sun>,

    /// path: all light paths; direct: light that comes straight from lights; ao: ambient occlusion, white surfaces in an even sky
    #[arg(long, value_enum, default_value_t = Integrator::Path, help_heading = "Work")]
    pub integrator: Integrator,

    /// exact: trace every shadow ray; occluder: try the last blocker first (the picture is the same)
    #[arg(long, value_enum, default_value_t = Strategy::Exact, help_heading = "Work")]
    pub visibility: Strategy,

    /// Samples a pixel [default: 64, or unlimited with --time-limit or --noise]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)), allow_negative_numbers = true, help_heading = "Work")]
    pub samples: Option<u32>,

    /// Stop after this time of rendering, such as 30s or 2m (whole passes: it may take a little longer)
    #[arg(long, value_name = "TIME", value_parser = values::duration, help_heading = "Work")]
    pub time_limit: Option<Duration>,

    /// Stop when the mean relative standard error of the pixels is below this, such as 0.02
    #[arg(long, value_name = "T", value_parser = values::positive, help_heading = "Work")]
    pub noise: Option<f32>,

    /// Scattering events on a path at most: 0 sees emitters only, 1 adds direct light, 2 one indirect bounce
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(0..=65_535), allow_negative_numbers = true, help_heading = "Work")]
    pub max_depth: u32,

    /// Where sample points come from
    #[arg(long, value_enum, default_value_t = Sampler::Sobol, help_heading = "Work")]
    pub sampler: Sampler,

    /// How a light is chosen: all alike, by power, or by a tree over place and power (for many lights)
    #[arg(long, value_enum, default_value_t = Lights::Tree, help_heading = "Work")]
    pub lights: Lights,

    /// Reach of --integrator ao in metres [default: unlimited]
    #[arg(long, value_name = "M", value_parser = values::positive, help_heading = "Work")]
    pub ao_distance: Option<f32>,

    /// Where unfinished work is kept [default: the first output's name with .checkpoint]; removed when the work is done
    #[arg(long, value_name = "FILE", help_heading = "Work")]
    pub checkpoint: Option<PathBuf>,

    /// Continue from the checkpoint if there is one; the end is the same to the byte
    #[arg(long, help_heading = "Work")]
    pub resume: bool,

    /// Do part I of N (I from 0) of the samples and write a mergeable part instead of a picture: see occlude merge
    #[arg(long, value_name = "I/N", help_heading = "Work")]
    pub shard: Option<Shard>,
}

fn tone_maps() -> impl TypedValueParser<Value = ToneMap> {
    let values = ToneMap::ALL.map(|map| PossibleValue::new(map.name()).help(map.title()));
    PossibleValuesParser::new(values).try_map(|text| text.parse::<ToneMap>())
}

/// What is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "lower")]
pub enum Integrator {
    /// All light paths up to --max-depth
    Path,
    /// Direct light alone
    Direct,
    /// Ambient occlusion
    Ao,
}

/// How visibility questions are answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Strategy {
    /// A ray for every question
    Exact,
    /// The last blocker first, then a ray: same answers
    Occluder,
}

/// Reconstruction filters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Filter {
    /// The mean over the pixel's square
    Box,
    /// A tent of one pixel's radius
    Tent,
    /// A Gaussian of half a pixel's deviation, cut at 1.5 pixels
    Gaussian,
}

/// Sample sequences.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Sampler {
    /// Owen-scrambled Sobol points
    Sobol,
    /// Independent random numbers
    Independent,
}

/// Light selection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Lights {
    /// All lights alike
    Uniform,
    /// In proportion to power
    Power,
    /// A tree over place, direction and power
    Tree,
}

/// Runs `occlude render`.
pub fn run(mut args: RenderArgs, context: &mut Context) -> Result<(), CliError> {
    check(&mut args)?;
    let (scene, sky) = context.phase("load", |context| load(&args, context))?;
    let pose = Pose::at(&scene, args.time);
    let view = view(&args, &scene, &pose)?;
    let film_bytes = Film::bytes(args.size.width, args.size.height, records_features(&args));
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
    let (geometry, lights) =
        context.phase("build", |_| build(&args, &scene, &pose, sky.as_ref()))?;
    let mut counts = counts(&scene);
    counts.lights = lights.len() as u64;
    context.stats.scene_counts = Some(counts);
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
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    match args.visibility {
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
        fingerprint: fingerprint(args, world.geometry, view, sky, &settings),
        total: total_samples(args),
        samples: settings.samples.clone(),
        notes: finish.notes(),
    };
    let checkpoint = checkpoint_path(args);
    let mut film = match resume(args, &checkpoint, &part)? {
        Some(film) => {
            context.progress.note(&format!(
                "going on from {}: {} samples a pixel",
                checkpoint.display(),
                film.min_samples()
            ));
            film
        }
        None => Film::new(args.size.width, args.size.height, records_features(args)),
    };
    context.progress.expect(args.time_limit);
    signals::graceful();
    let save = |film: &Film| output::write(&checkpoint, |mut out| part.write(film, &mut out));
    let mut saved = Instant::now();
    let report = context.phase("work", |context| {
        let mut at_rest = |film: &Film| {
            // A checkpoint that cannot be written now is tried again later, and reported at the end.
            if saved.elapsed() >= CHECKPOINT_PERIOD {
                let _ = save(film);
                saved = Instant::now();
            }
        };
        render(
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
    context.stats.work = Some(stats::Work {
        samples_per_pixel: done,
        stopped_by: report.stopped_by.name(),
        rays: stats::Rays {
            primary: report.rays.primary,
            secondary: report.rays.secondary,
            shadow: report.visibility.traced,
            fill: report.visibility.fill,
        },
        visibility: stats::Visibility {
            strategy: visibility.name().to_owned(),
            class: visibility.class().name(),
            queries: report.visibility.queries,
            answered: report.visibility.answered,
            traced: report.visibility.traced,
            refined: report.visibility.refined,
            bytes: visibility.bytes(),
        },
    });
    if film.dropped() > 0 {
        context.warn(format_args!(
            "{} samples were not finite and count as black: please report the scene",
            film.dropped()
        ));
    }
    let cancelled = report.stopped_by == StoppedBy::Cancel;
    context.phase("write", |_| match (cancelled, args.shard) {
        (true, Some(_)) => save(&film),
        (true, None) => save(&film).and(finish.write(&film, &args.output)),
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

/// Refuses what cannot work before anything is read or written.
fn check(args: &mut RenderArgs) -> Result<(), CliError> {
    if args.denoise {
        return Err(CliError::input(
            "not built in yet",
            "--denoise",
            "render more samples, or denoise the EXR (with --aov albedo,normal) in another program",
        ));
    }
    if args.output.is_empty() {
        let name = args.scene.file_stem().unwrap_or("picture".as_ref());
        args.output.push(Path::new(name).with_extension("png"));
    }
    std::fs::metadata(&args.scene)
        .and_then(|data| {
            if data.is_dir() {
                Err(std::io::ErrorKind::IsADirectory.into())
            } else {
                Ok(())
            }
        })
        .map_err(|error| CliError::read(&args.scene, &error))?;
    let formats = args
        .output
        .iter()
        .map(|path| output::check_picture(path))
        .collect::<Result<Vec<_>, _>>()?;
    if !args.aov.is_empty() && !formats.contains(&Format::Exr) {
        return Err(CliError::input(
            "no .exr output",
            "--aov",
            "layers need one: add -o FILE.exr",
        ));
    }
    if args.shard.is_some() {
        if args.time_limit.is_some() || args.noise.is_some() {
            return Err(CliError::input(
                "shards need a fixed number of samples",
                "--shard",
                "use --samples without --time-limit and --noise",
            ));
        }
        if args.output.len() != 1 {
            return Err(CliError::input(
                "a shard writes one part",
                "--shard",
                "give exactly one -o FILE",
            ));
        }
    }
    let inputs: Vec<&Path> = [Some(&args.scene), args.environment.as_ref()]
        .into_iter()
        .flatten()
        .map(PathBuf::as_path)
        .collect();
    let checkpoint = checkpoint_path(args);
    let mut outputs: Vec<&Path> = args.output.iter().map(PathBuf::as_path).collect();
    outputs.push(&checkpoint);
    output::check(&checkpoint)?;
    output::check_distinct(&outputs, &inputs)
}

/// Where unfinished work is kept.
fn checkpoint_path(args: &RenderArgs) -> PathBuf {
    args.checkpoint.clone().unwrap_or_else(|| {
        let mut name = args
            .output
            .first()
            .map(|path| path.clone().into_os_string())
            .unwrap_or_default();
        name.push(".checkpoint");
        name.into()
    })
}

fn load(args: &RenderArgs, context: &mut Context) -> Result<(Scene, Option<Picture>), CliError> {
    let sky = match &args.environment {
        Some(path) => Some(load_sky(path, context)?),
        None => None,
    };
    let mut scene = Scene::load(
        &args.scene,
        args.gltf_scene.as_deref(),
        context.common.memory,
    )?;
    context.stats.scene = Some(scene.name.clone());
    context.warn_all(&scene.warnings);
    if counts(&scene).triangles == 0 {
        return Err(CliError::input(
            "nothing to render",
            args.scene.display(),
            "the scene holds no triangles: choose another with --gltf-scene or export its meshes",
        ));
    }
    if let Some(sun) = &args.sun {
        add_sun(&mut scene, sun);
    }
    Ok((scene, sky))
}

fn load_sky(path: &Path, context: &Context) -> Result<Picture, CliError> {
    let limits = context
        .common
        .memory
        .map_or_else(Limits::default, |max_bytes| Limits { max_bytes });
    let opened = occlude_image::read(path, &limits)?;
    if opened.repaired > 0 {
        context.warn(format_args!(
            "{} pixels were not finite and count as black: {}",
            opened.repaired,
            path.display()
        ));
    }
    if opened.encoding == Encoding::Display {
        context.warn(format_args!(
            "a PNG holds display colours, bright lights are lost: {}: better use .hdr or .exr",
            path.display()
        ));
    }
    Ok(opened.picture)
}

/// Adds a directional light and the node that turns it.
fn add_sun(scene: &mut Scene, sun: &Sun) {
    let node = scene.nodes.len() as u32;
    // Lights shine along -Z of their node, so its +Z points to the sun.
    let rotation = Quat::from_rotation_arc(Vec3::Z, sun.towards());
    scene.nodes.push(Node {
        name: "sun".to_owned(),
        parent: None,
        parent_from_node: Affine3A::from_quat(rotation),
    });
    scene.lights.push(Light {
        name: "sun".to_owned(),
        node,
        intensity: Vec3::splat(sun.irradiance),
        kind: LightKind::Directional {
            angular_diameter: SUN_DIAMETER_DEGREES.to_radians(),
        },
    });
}

fn build<'a>(
    args: &RenderArgs,
    scene: &'a Scene,
    pose: &'a Pose,
    sky: Option<&Picture>,
) -> Result<(Geometry<'a>, light::Lights), CliError> {
    let geometry = Geometry::new(scene, pose, &BuildOptions::default())
        .map_err(|error| CliError::input("cannot trace the scene", args.scene.display(), error))?;
    let rotation = args.environment_rotation.to_radians();
    let environment =
        sky.map(|sky| Environment::from_picture(sky, rotation, args.environment_scale));
    let selection = match args.lights {
        Lights::Uniform => LightSelection::Uniform,
        Lights::Power => LightSelection::Power,
        Lights::Tree => LightSelection::Tree,
    };
    Ok((
        geometry,
        light::Lights::new(scene, pose, environment, selection),
    ))
}

/// The camera: asked for, the file's first, or one that frames everything.
fn view(args: &RenderArgs, scene: &Scene, pose: &Pose) -> Result<View, CliError> {
    let Size { width, height } = args.size;
    if let Some(look) = &args.camera_look {
        return View::look_at(look.eye, look.target, args.fov.to_radians(), width, height)
            .ok_or_else(|| {
                CliError::input(
                    "no such view",
                    "--camera-look",
                    "eye and target must be apart and not too far from the origin",
                )
            });
    }
    let index = match &args.camera {
        Some(wanted) => Some(find_camera(wanted, scene, &args.scene)?),
        None => (!scene.cameras.is_empty()).then_some(0),
    };
    match (index, bounds(scene, pose)) {
        (Some(index), _) => Ok(View::of_camera(scene, pose, index, width, height)),
        (None, Some((min, max))) => Ok(View::framing(min, max, width, height)),
        (None, None) => Err(CliError::input(
            "nothing to look at",
            args.scene.display(),
            "the scene is empty",
        )),
    }
}

fn find_camera(wanted: &str, scene: &Scene, path: &Path) -> Result<usize, CliError> {
    let named = |camera: &occlude_scene::Camera| {
        let node = scene
            .nodes
            .get(camera.node as usize)
            .map(|node| node.name.as_str());
        camera.name == wanted || node == Some(wanted)
    };
    let by_index = || {
        wanted
            .parse()
            .ok()
            .filter(|&index: &usize| index < scene.cameras.len())
    };
    scene
        .cameras
        .iter()
        .position(named)
        .or_else(by_index)
        .ok_or_else(|| {
            let names: Vec<String> = scene
                .cameras
                .iter()
                .take(8)
                .enumerate()
                .map(|(i, c)| format!("{i} {:?}", c.name))
                .collect();
            let cure = if names.is_empty() {
                "the file has none: use --camera-look".to_owned()
            } else {
                format!("the file has {}", names.join(", "))
            };
            CliError::input(format_args!("no camera {wanted:?}"), path.display(), cure)
        })
}

fn records_features(args: &RenderArgs) -> bool {
    aovs(&args.aov).needs_features()
}

/// Samples a pixel of the whole work, shards together.
fn total_samples(args: &RenderArgs) -> u32 {
    let open_ended = args.time_limit.is_some() || args.noise.is_some();
    args.samples.unwrap_or(if open_ended {
        MAX_SAMPLES
    } else {
        DEFAULT_SAMPLES
    })
}

fn settings(args: &RenderArgs, seed: u64) -> RenderSettings {
    let total = total_samples(args);
    RenderSettings {
        integrator: match args.integrator {
            Integrator::Path => integrator::Integrator::Path {
                max_depth: args.max_depth,
            },
            Integrator::Direct => integrator::Integrator::Path {
                max_depth: args.max_depth.min(1),
            },
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
    geometry: &Geometry,
    view: &View,
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
            records_features(args),
            args.environment_rotation,
            args.environment_scale
        )
    );
    let mut hash = occlude_scene::fingerprint(geometry.scene, geometry.pose);
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

/// The film of the checkpoint, if `--resume` was given and there is one.
fn resume(args: &RenderArgs, checkpoint: &Path, part: &Work) -> Result<Option<Film>, CliError> {
    if !args.resume || !checkpoint.exists() {
        return Ok(None);
    }
    let (film, work) = merge::read(checkpoint)?;
    let same_film = (film.width(), film.height(), film.has_features())
        == (args.size.width, args.size.height, records_features(args));
    if !same_film || work.fingerprint != part.fingerprint || work.samples != part.samples {
        return Err(CliError::input(
            "the checkpoint belongs to another work (scene, view, size, seed, settings or program version differ)",
            checkpoint.display(),
            "repeat its command line, or leave out --resume to start anew",
        ));
    }
    Ok(Some(film))
}
