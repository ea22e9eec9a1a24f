//! Options of `occlude render`, and what must hold before any work.

use super::field::FieldArgs;
use super::records::{self, RecordsOptions};
use super::strategy::{self, GuaranteeName, Strategy};
use crate::error::CliError;
use crate::output;
use crate::picture::{Aov, aovs};
use crate::sky::SkyArgs;
use crate::values::{self, Frames, Look as CameraLook, Renewal, Shard, Size};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use occlude_image::{Format, ToneMap};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Samples a pixel when nothing else says when to stop.
pub const DEFAULT_SAMPLES: u32 = 64;

/// Vertical field of view, degrees, of cameras that the user describes.
const DEFAULT_FOV: f32 = 40.0;

/// Virtual lights at most.
const MAX_VPLS: u32 = 1 << 20;

/// Samples a pixel at most.
const MAX_SAMPLES: u32 = 1 << 24;

/// Options of `occlude render`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  occlude render sponza.glb -o sponza.png
  occlude render room.glb -o room.exr -o room.png --samples 256 --size 1920x1080
  occlude render statue.obj --environment sky.hdr --time-limit 30s -o statue.png
  occlude render walk.glb --frames 0..95 --fps 24 -o walk_####.png
  occlude render sponza.glb --camera-path tour.json --integrator instant-radiosity --visibility quantized -o tour_####.png
  occlude render big.glb -o part1.exr --shard 1/4    (then: occlude merge part*.exr -o big.exr)")]
pub struct RenderArgs {
    /// Scene: .glb, .gltf or .obj
    pub scene: PathBuf,

    /// Picture to write, by its ending: .exr and .hdr hold scene-linear Rec. 709 radiance, .png is exposed and tone
    /// mapped (see --tonemap). May be given several times. Of frames, #### becomes the number [default: the scene's name with
    /// .png, in this folder]
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

    /// Also write what visibility records look like: PREFIX-importance.png, -utility, -correlation and -positions. Of frames, #### in
    /// the prefix becomes the number
    #[arg(long, value_name = "PREFIX", help_heading = "Output")]
    pub record_views: Option<PathBuf>,

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

    /// Cameras of frames, as JSON: [{"frame": 0, "eye": [0, 1, 2], "target": [0, 0, 0], "fov": DEG}, ...], linear between these keys,
    /// held before and after; "fov" and "up" may be left out. {"interpolation": "smooth", "keys": [...]} passes through
    /// the keys without corners
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["camera", "camera_look", "time"], help_heading = "View")]
    pub camera_path: Option<PathBuf>,

    /// Vertical field of view of --camera-look, and of --camera-path where it says nothing, in degrees [default: 40]
    #[arg(long, value_name = "DEG", value_parser = values::field_of_view, allow_negative_numbers = true, help_heading = "View")]
    pub fov: Option<f32>,

    /// Render frames FIRST to LAST, both included, at times frame / --fps, each into a file of its own; a run that was cut off
    /// goes on behind its last whole frame with --resume [default: one picture, or all keys of --camera-path]
    #[arg(
        long,
        value_name = "FIRST..LAST",
        conflicts_with = "time",
        help_heading = "View"
    )]
    pub frames: Option<Frames>,

    /// Frames a second of the file's animations
    #[arg(long, value_name = "N", default_value = "24", value_parser = values::positive, allow_negative_numbers = true, help_heading = "View")]
    pub fps: f32,

    /// Scene of the file, by name or by index from 0 [default: the file's own choice]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "View")]
    pub gltf_scene: Option<String>,

    /// Moment of the file's animations in seconds
    #[arg(long, value_name = "T", default_value = "0", value_parser = values::number, allow_hyphen_values = true, help_heading = "View")]
    pub time: f32,

    /// How samples spread around a pixel's centre
    #[arg(long, value_enum, default_value_t = Filter::Box, help_heading = "View")]
    pub filter: Filter,

    #[command(flatten)]
    pub sky: SkyArgs,

    /// path: all light paths; bidirectional: the same from both ends, for caustics and light that comes by detours; direct: light that comes straight from lights; instant-radiosity: many virtual lights, no noise in diffuse rooms; field: direct light of a sky without noise, from visibility at few points; ao: ambient occlusion, white surfaces in an even sky; baked: surfaces in the light maps that occlude bake has written beside the scene
    #[arg(long, value_enum, default_value_t = Integrator::Path, help_heading = "Work")]
    pub integrator: Integrator,

    /// exact: trace every shadow ray; occluder: try the last blocker first (the picture is the same);
    /// quantized[:NAME=VALUE,...]: one ray for each pair of patches. Its options: error (reach of errors in samples across;
    /// error-point, error-direction, error-area, error-sky by kind of light), refine=auto|off|LEVELS, share=tile|thread|all|frames
    /// (tile: the same bytes at any number of threads; frames: those, too, and frames know what earlier ones have learnt), table=SIZE, normals, slab, resolution-step,
    /// digest=separable|lcg|lcg-xorshift. Suns and lamps without extent are traced exactly where there are 256 virtual lights or more for each of them,
    /// unless error-point, error-direction or error say otherwise. Saves time where all pixels ask about the same lights (instant-radiosity); with other integrators
    /// it saves rays, and seldom time.
    /// records[:NAME=VALUE,...] (with --integrator instant-radiosity): distance maps answer. Their options: count=4000 (at most), resolution=128,
    /// place=auto|lights|paths (lights: one on each virtual light, if there are enough; paths: near lights, placed along paths from the camera and refined; auto: lights,
    /// unless a further option speaks of paths), for paths initial=N (at first, by default as many as the work is worth, or all of a count that is given), alpha=0.6 (0: records go where visibility changes, 1: where they are used), steps=auto|N (of refinement before the first
    /// pass), pace=1 (after each), frame-steps=32 (before each further frame), select=nearest|probable, lookup=snap|plane|march,
    /// near=auto|off|on|LENGTH (auto: questions shorter than records are apart are traced;
    /// on, LENGTH: and short rays at both ends, in units of what a record is uncertain by)
    #[arg(long, value_name = "STRATEGY", value_parser = strategy::strategy, default_value = "exact", help_heading = "Work")]
    pub visibility: Strategy,

    /// What quantized visibility promises; records know unbiased alone
    #[arg(long, value_enum, help_heading = "Work")]
    pub guarantee: Option<GuaranteeName>,

    /// With --integrator path: records[:NAME=VALUE,...] find where paths go on instead of rays, from=1|2 (the first or the second scattering
    /// event) on; further options as for --visibility records, with resolution=64 (a preview: surfaces in the records are matt, errors are as
    /// large as texels)
    #[arg(long, value_name = "ANSWER", value_parser = records::secondary, help_heading = "Work")]
    pub secondary: Option<RecordsOptions>,

    /// Samples a pixel [default: 64, or unlimited with --time-limit or --noise]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)), allow_negative_numbers = true, help_heading = "Work")]
    pub samples: Option<u32>,

    /// Stop after this time of rendering, such as 30s or 2m (whole passes: it may take a little longer)
    #[arg(long, value_name = "TIME", value_parser = values::duration, help_heading = "Work")]
    pub time_limit: Option<Duration>,

    /// Stop when the mean relative standard error of the pixels is below this, such as 0.02
    #[arg(long, value_name = "T", value_parser = values::positive, allow_negative_numbers = true, help_heading = "Work")]
    pub noise: Option<f32>,

    /// Scattering events on a path at most: 0 sees emitters only, 1 adds direct light, 2 one indirect bounce
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(0..=65_535), allow_negative_numbers = true, help_heading = "Work")]
    pub max_depth: u32,

    /// Make every surface Lambert with its base colour: for comparison with other renderers
    #[arg(long, help_heading = "Work")]
    pub diffuse_only: bool,

    /// Blur glossy surfaces where they are seen by way of a rough one: far fewer fireflies, but soft caustics (biased)
    #[arg(long, help_heading = "Work")]
    pub regularize: bool,

    /// Virtual lights of --integrator instant-radiosity
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_VPLS)), allow_negative_numbers = true, help_heading = "Work")]
    pub vpls: u32,

    /// Bound on cos cos / distance^2 between a virtual light and what it lights, per square metre; inf: none
    /// [default: by the distances between the lights]
    #[arg(long, value_name = "G", value_parser = values::bound, allow_negative_numbers = true, help_heading = "Work")]
    pub clamp: Option<f32>,

    /// Gather what the bound takes away by short paths: slower and with some noise, but no darkened corners
    #[arg(long, help_heading = "Work")]
    pub compensate: bool,

    /// With --frames: blocks of 16 virtual lights that are drawn anew for every frame, or all. The others stay while nothing but
    /// the camera moves [default: 1 with quantized visibility, else all]
    #[arg(
        long,
        value_name = "N|all",
        allow_negative_numbers = true,
        help_heading = "Work"
    )]
    pub renew_vpls: Option<Renewal>,

    /// What --integrator field knows its points by
    #[command(flatten)]
    pub field: FieldArgs,

    /// Several frames in any case, by default the whole animation.
    #[arg(skip)]
    pub animate: bool,

    /// Where sample points come from
    #[arg(long, value_enum, default_value_t = Sampler::Sobol, help_heading = "Work")]
    pub sampler: Sampler,

    /// How a light is chosen: all alike, by power, or by a tree over place and power (for many lights)
    #[arg(long, value_enum, default_value_t = Lights::Tree, help_heading = "Work")]
    pub lights: Lights,

    /// Reach of --integrator ao in metres [default: unlimited]
    #[arg(long, value_name = "M", value_parser = values::positive, allow_negative_numbers = true, help_heading = "Work")]
    pub ao_distance: Option<f32>,

    /// Where unfinished work is kept [default: the first output's name with .checkpoint]; removed when the work is done
    #[arg(long, value_name = "FILE", help_heading = "Work")]
    pub checkpoint: Option<PathBuf>,

    /// Continue from the checkpoint if there is one; the end is the same to the byte
    #[arg(long, help_heading = "Work")]
    pub resume: bool,

    /// Do part I of N (I from 0) of the samples and write a mergeable part instead of a picture: see occlude merge. With --frames:
    /// do part I of N of the frames, whole. Records must stay as they are before the first pass then: on lights, or pace=0
    #[arg(long, value_name = "I/N", help_heading = "Work")]
    pub shard: Option<Shard>,
}

impl RenderArgs {
    /// Refuses what cannot work before anything is read or written.
    pub fn check(&mut self, memory: Option<u64>) -> Result<(), CliError> {
        if self.denoise {
            return Err(CliError::input(
                "not built in yet",
                "--denoise",
                "render more samples, or denoise the EXR (with --aov albedo,normal) in another program",
            ));
        }
        if self.integrator == Integrator::Baked && (self.is_sequence() || self.shard.is_some()) {
            return Err(CliError::input(
                "light maps are shown in single pictures",
                "--integrator",
                "leave out --frames, --camera-path and --shard",
            ));
        }
        if self.regularize && self.integrator == Integrator::Bidirectional {
            return Err(CliError::input(
                "no blur for bidirectional paths",
                "--regularize",
                "leave it out: light paths find caustics sharp",
            ));
        }
        if self.fov.is_some() && self.camera_look.is_none() && self.camera_path.is_none() {
            return Err(CliError::input(
                "no camera of its own to apply it to",
                "--fov",
                "it belongs to --camera-look or --camera-path",
            ));
        }
        if self.output.is_empty() {
            let mut name = self
                .scene
                .file_stem()
                .unwrap_or("picture".as_ref())
                .to_owned();
            name.push(if self.is_sequence() {
                "_####.png"
            } else {
                ".png"
            });
            self.output.push(name.into());
        }
        std::fs::metadata(&self.scene)
            .and_then(|data| {
                if data.is_dir() {
                    Err(std::io::ErrorKind::IsADirectory.into())
                } else {
                    Ok(())
                }
            })
            .map_err(|error| CliError::read(&self.scene, &error))?;
        let formats = self
            .output
            .iter()
            .map(|path| output::check_picture(path))
            .collect::<Result<Vec<_>, _>>()?;
        if !self.aov.is_empty() && !formats.contains(&Format::Exr) {
            return Err(CliError::input(
                "no .exr output",
                "--aov",
                "layers need one: add -o FILE.exr",
            ));
        }
        if self.integrator == Integrator::Field {
            self.field.check(memory)?;
            if self.shard.is_some() {
                return Err(CliError::input(
                    "parts would not add up to the picture of one machine: points follow from the whole picture and from frames before",
                    "--shard",
                    "use another --integrator, or other --frames on each machine",
                ));
            }
            if self.visibility != Strategy::Exact {
                return Err(CliError::input(
                    "fields of visibility ask nobody else",
                    "--visibility",
                    "leave it out, or use another --integrator",
                ));
            }
        }
        self.check_visibility()?;
        if self.shard.is_some() {
            let frames = self.is_sequence();
            if !frames && (self.time_limit.is_some() || self.noise.is_some()) {
                return Err(CliError::input(
                    "shards need a fixed number of samples",
                    "--shard",
                    "use --samples without --time-limit and --noise",
                ));
            }
            let records = self.records();
            let lights = self.secondary.is_none().then_some(self.vpls);
            let fixed = !frames && records.is_some_and(|records| records.are_fixed(lights));
            if (self.remembers() || records.is_some()) && !fixed {
                return Err(CliError::input(
                    "parts would not add up to the picture of one machine: remembered answers depend on what was asked before",
                    "--shard",
                    if records.is_some() && !frames {
                        "keep the records as they are before the first pass: add pace=0 to their options"
                    } else {
                        "use --visibility exact or occluder"
                    },
                ));
            }
            if !frames && self.output.len() != 1 {
                return Err(CliError::input(
                    "a shard writes one part",
                    "--shard",
                    "give exactly one -o FILE",
                ));
            }
        }
        let files = [
            Some(&self.scene),
            self.sky.environment.as_ref(),
            self.camera_path.as_ref(),
        ];
        let inputs: Vec<&Path> = files.into_iter().flatten().map(PathBuf::as_path).collect();
        let checkpoint = self.checkpoint_path();
        let mut outputs: Vec<&Path> = self.output.iter().map(PathBuf::as_path).collect();
        outputs.push(&checkpoint);
        output::check(&checkpoint)?;
        output::check_distinct(&outputs, &inputs)
    }

    /// Refuses strategies and promises that do not go together.
    fn check_visibility(&self) -> Result<(), CliError> {
        let records = matches!(self.visibility, Strategy::Records(_));
        if records && self.integrator != Integrator::InstantRadiosity {
            return Err(CliError::input(
                "records answer for virtual lights, and there are none",
                "--visibility records",
                "add --integrator instant-radiosity, or use --secondary records with --integrator path",
            ));
        }
        if self.secondary.is_some() && self.integrator != Integrator::Path {
            return Err(CliError::input(
                "nothing to answer",
                "--secondary",
                "it belongs to --integrator path",
            ));
        }
        if self.record_views.is_some() && !records && self.secondary.is_none() {
            return Err(CliError::input(
                "no records to look at",
                "--record-views",
                "add --visibility records or --secondary records",
            ));
        }
        let Some(guarantee) = self.guarantee else {
            return Ok(());
        };
        if self.secondary.is_some() && guarantee != GuaranteeName::Bounded {
            return Err(CliError::input(
                "what a ray meets cannot be guessed and corrected: a record's answer to a ray question is biased",
                "--guarantee with --secondary",
                "leave one of them out",
            ));
        }
        match self.visibility {
            Strategy::Quantized(_) => Ok(()),
            Strategy::Records(_) if guarantee == GuaranteeName::Unbiased => Ok(()),
            Strategy::Records(_) => Err(CliError::input(
                "records know no bound of their errors",
                "--guarantee",
                "use unbiased, or leave it out",
            )),
            _ => Err(CliError::input(
                "nothing to guarantee",
                "--guarantee",
                "it belongs to --visibility quantized or records",
            )),
        }
    }

    /// How much is rendered, in so many pictures.
    pub fn extent(&self, pictures: u32) -> records::Extent {
        records::Extent {
            size: [self.size.width, self.size.height],
            samples: self.known_samples(),
            pictures,
            vpls: self.vpls,
        }
    }

    /// What was said about records, if there are any.
    fn records(&self) -> Option<&RecordsOptions> {
        match &self.visibility {
            Strategy::Records(options) => Some(options),
            _ => self.secondary.as_ref(),
        }
    }

    /// Whether answers depend on what was asked before.
    pub fn remembers(&self) -> bool {
        matches!(
            self.visibility,
            Strategy::Quantized(_) | Strategy::Records(_)
        )
    }

    /// Several pictures, or one that has a frame's number.
    pub fn is_sequence(&self) -> bool {
        self.frames.is_some() || self.camera_path.is_some() || self.animate
    }

    /// Vertical field of view where nothing else says, radians.
    pub fn field_of_view(&self) -> f32 {
        self.fov.unwrap_or(DEFAULT_FOV).to_radians()
    }

    /// Where unfinished work is kept.
    pub fn checkpoint_path(&self) -> PathBuf {
        self.checkpoint.clone().unwrap_or_else(|| {
            let mut name = self
                .output
                .first()
                .map(|path| path.clone().into_os_string())
                .unwrap_or_default();
            name.push(".checkpoint");
            name.into()
        })
    }

    pub fn records_features(&self) -> bool {
        aovs(&self.aov).needs_features()
    }

    /// Samples a pixel of the whole work, if the user has said how many, or time and noise do not decide.
    pub fn known_samples(&self) -> Option<u32> {
        let total = self.total_samples();
        (total < MAX_SAMPLES).then_some(total)
    }

    /// Samples a pixel of the whole work, shards together.
    pub fn total_samples(&self) -> u32 {
        let open_ended = self.time_limit.is_some() || self.noise.is_some();
        self.samples.unwrap_or(match self.integrator {
            // Without noise: edges alone take more, by themselves.
            Integrator::Field => 1,
            _ if open_ended => MAX_SAMPLES,
            _ => DEFAULT_SAMPLES,
        })
    }
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
    /// All light paths up to --max-depth, from camera and lights
    Bidirectional,
    /// Direct light alone
    Direct,
    /// Ambient occlusion
    Ao,
    /// Many virtual lights
    #[value(name = "instant-radiosity")]
    InstantRadiosity,
    /// Direct light by fields of visibility
    Field,
    /// Light maps that lie beside the scene
    Baked,
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
