//! Options of `occlude bake` and `occlude plan`, and what must hold before any work.

use crate::cache::{self, Cache};
use crate::error::CliError;
use crate::output;
use crate::sky::SkyArgs;
use crate::values::{self, Shard};
use clap::{Args, ValueEnum};
use occlude_bake::store::Store;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Texels a side of a page at most: larger ones no graphics card takes.
const MAX_PAGE: u32 = 16_384;

/// Directions at most.
const MAX_DIRECTIONS: u32 = 1 << 24;

/// Directions when nothing else says when to stop.
const DEFAULT_DIRECTIONS: u32 = 1024;

/// What is baked and how well: `bake` and `plan` share it.
#[derive(Debug, Clone, Args)]
pub struct WorkArgs {
    /// Scene: .glb, .gltf or .obj
    pub scene: PathBuf,

    /// Texels along a metre of surface; more: sharper shadows, larger maps. A node's or mesh's extras.texelsPerMetre
    /// overrides it
    #[arg(long, value_name = "D", default_value = "16", value_parser = values::positive, allow_negative_numbers = true, help_heading = "Maps")]
    pub texels_per_metre: f32,

    /// Texels a side of a page at most; further pages are added as they are needed
    #[arg(long, value_name = "SIZE", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..=i64::from(MAX_PAGE)), allow_negative_numbers = true, help_heading = "Maps")]
    pub pages_max: u32,

    /// Texels between charts; more: room for mip maps, larger maps
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64), allow_negative_numbers = true, help_heading = "Maps")]
    pub padding: u32,

    /// projection: charts of triangles that face alike, a second for a million triangles; conformal: fewer charts on curved things, a minute
    /// for as many
    #[arg(long, value_enum, default_value_t = UnwrapName::Projection, help_heading = "Maps")]
    pub unwrap: UnwrapName,

    /// Folder in which conformal charts are kept for later runs, or off [default: occlude in the user's cache folder]
    #[arg(long, value_name = "DIR|off", value_parser = cache::parse, help_heading = "Maps")]
    pub cache: Option<Cache>,

    /// Which side of two-sided materials is baked; auto: the one that people see, by light and distance, as winding is often
    /// arbitrary; front: the one that the winding says
    #[arg(long, value_enum, default_value_t = SidesName::Auto, help_heading = "Maps")]
    pub sides: SidesName,

    /// Bake only these nodes, by name or by index in the file; the others still block and reflect light
    #[arg(
        long,
        value_name = "NODE,...",
        value_delimiter = ',',
        help_heading = "Maps"
    )]
    pub select: Vec<String>,

    /// Scene of the file, by name or by index from 0 [default: the file's own choice]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "Maps")]
    pub gltf_scene: Option<String>,

    /// Moment of the file's animations in seconds
    #[arg(long, value_name = "T", default_value = "0", value_parser = values::number, allow_hyphen_values = true, help_heading = "Maps")]
    pub time: f32,

    #[command(flatten)]
    pub sky: SkyArgs,

    /// all: everything that arrives; direct: what comes straight from lights and sky; indirect: what has been reflected; ao:
    /// what an even white sky would bring, whatever the lights
    #[arg(long, value_enum, default_value_t = LightPart::All, help_heading = "Light")]
    pub light: LightPart,

    /// Reflections on the way from a light to the map: 0 is direct light alone
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=1000), allow_negative_numbers = true, help_heading = "Light")]
    pub bounces: u32,

    /// Reach of --light ao in metres [default: unlimited]
    #[arg(long, value_name = "M", value_parser = values::positive, allow_negative_numbers = true, help_heading = "Light")]
    pub ao_distance: Option<f32>,

    /// Where light comes from, for normal maps, in four more channels of the maps (see docs/baking.md); sh1: irradiance for any normal; dominant: the
    /// direction of most light
    #[arg(long, value_enum, default_value_t = DirectionalName::None, help_heading = "Light")]
    pub directional: DirectionalName,

    /// bundles: parallel rays through the whole scene, direction by direction; path: paths from every texel; auto: what takes less time by
    /// the plan's estimate
    #[arg(long, value_enum, default_value_t = GatherName::Auto, help_heading = "Work")]
    pub gather: GatherName,

    /// Directions of bundles a bounce, or paths a texel [default: 1024, or unlimited with --noise or --time-limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_DIRECTIONS)), allow_negative_numbers = true, help_heading = "Work")]
    pub directions: Option<u32>,

    /// Stop when the mean relative standard error of the texels is below this, such as 0.02
    #[arg(long, value_name = "T", value_parser = values::positive, allow_negative_numbers = true, help_heading = "Work")]
    pub noise: Option<f32>,

    /// Stop after this time of gathering, such as 30s or 2m (whole passes: it may take a little longer)
    #[arg(long, value_name = "TIME", value_parser = values::duration, help_heading = "Work")]
    pub time_limit: Option<Duration>,

    /// Keep what is gathered in files in this folder instead of memory, for light maps that are larger than that; the result is the same.
    /// Some 60 bytes a texel, and by bundles up to 130 more
    #[arg(long, value_name = "DIR", help_heading = "Work")]
    pub scratch: Option<PathBuf>,
}

/// Options of `occlude bake`.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:
  occlude bake room.glb -o room_baked                 (then open room_baked/view.html)
  occlude bake town.glb -o town --texels-per-metre 8 --memory 2GiB --noise 0.02
  occlude bake room.glb -o room --engine bevy --denoise
  occlude bake room.glb -o part0 --shard 0/2          (then: occlude merge part0 part1 -o ...: see docs/baking.md)")]
pub struct BakeArgs {
    #[command(flatten)]
    pub work: WorkArgs,

    /// Folder for scene.glb, light maps, previews, manifest.json and view.html; with --shard the part's file
    #[arg(short, long = "output", value_name = "DIR", required = true)]
    pub output: PathBuf,

    /// Who reads the maps: decides whether they hold irradiance (three) or irradiance / pi (bevy, godot, blender)
    #[arg(long, value_enum, default_value_t = EngineName::Three, help_heading = "Output")]
    pub engine: EngineName,

    /// Smooth the noise that is left, within charts alone; the unsmoothed map stays in the EXR's raw layer
    #[arg(long, help_heading = "Output")]
    pub denoise: bool,

    /// Where unfinished work is kept [default: the output's name with .checkpoint]; removed when the work is done
    #[arg(long, value_name = "FILE", help_heading = "Work")]
    pub checkpoint: Option<PathBuf>,

    /// Continue from the checkpoint if there is one; the end is the same to the byte
    #[arg(long, help_heading = "Work")]
    pub resume: bool,

    /// Do part I of N (I from 0) of the next round and write a mergeable part instead of maps: see occlude merge
    #[arg(long, value_name = "I/N", help_heading = "Work")]
    pub shard: Option<Shard>,

    /// Rounds that are done already: what occlude merge made of the parts of the last one
    #[arg(long, value_name = "FILE", help_heading = "Work")]
    pub after: Option<PathBuf>,
}

/// Options of `occlude plan`.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:
  occlude plan room.glb --texels-per-metre 32 --json")]
pub struct PlanArgs {
    #[command(flatten)]
    pub work: WorkArgs,

    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// `--directional`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DirectionalName {
    /// Nothing
    None,
    /// Irradiance as a linear function of the normal
    Sh1,
    /// The direction that most light comes from
    Dominant,
}

/// `--sides`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SidesName {
    /// The side that is seen
    Auto,
    /// The front
    Front,
}

/// `--unwrap`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UnwrapName {
    /// By the direction of triangles
    Projection,
    /// Least squares conformal maps
    Conformal,
}

/// `--light`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LightPart {
    /// Everything
    All,
    /// Straight from lights
    Direct,
    /// Reflected
    Indirect,
    /// Ambient occlusion
    Ao,
}

/// `--gather`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GatherName {
    /// Whatever is faster
    Auto,
    /// Ray bundles
    Bundles,
    /// Path tracing
    Path,
}

/// `--engine`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineName {
    /// three.js
    Three,
    /// Bevy
    Bevy,
    /// Godot
    Godot,
    /// Blender
    Blender,
}

impl WorkArgs {
    /// Refuses what cannot work before anything is read.
    pub fn check(&self) -> Result<(), CliError> {
        std::fs::metadata(&self.scene)
            .and_then(|data| {
                if data.is_dir() {
                    Err(std::io::ErrorKind::IsADirectory.into())
                } else {
                    Ok(())
                }
            })
            .map_err(|error| CliError::read(&self.scene, &error))?;
        if let Some(folder) = self.scratch.as_deref().filter(|folder| !folder.is_dir()) {
            return Err(CliError::input(
                "no such folder",
                folder.display(),
                "make it, or name another with --scratch",
            ));
        }
        Ok(())
    }

    /// Where what is gathered is kept meanwhile.
    pub fn store(&self) -> Store {
        self.scratch
            .clone()
            .map_or_else(Store::memory, Store::folder)
    }

    /// What to say when that fails.
    pub fn scratch_failed(&self, error: &std::io::Error) -> CliError {
        let folder = self.scratch.as_deref().unwrap_or(Path::new("--scratch"));
        CliError::failed(
            format_args!("cannot keep what is gathered: {error}"),
            folder.display(),
            "make room, or name another folder with --scratch",
        )
    }

    /// Directions of the whole work.
    pub fn total_directions(&self) -> u32 {
        let open_ended = self.time_limit.is_some() || self.noise.is_some();
        self.directions.unwrap_or(if open_ended {
            MAX_DIRECTIONS
        } else {
            DEFAULT_DIRECTIONS
        })
    }
}

impl BakeArgs {
    /// Refuses what cannot work before anything is read or written.
    pub fn check(&self) -> Result<(), CliError> {
        self.work.check()?;
        let checkpoint = self.checkpoint_path();
        if self.shard.is_some() {
            if self.work.time_limit.is_some() || self.work.noise.is_some() {
                return Err(CliError::input(
                    "shards need a fixed number of directions",
                    "--shard",
                    "use --directions without --time-limit and --noise",
                ));
            }
            output::check(&self.output)?;
        } else {
            check_folder(&self.output)?;
        }
        output::check(&checkpoint)?;
        let inputs: Vec<&Path> = [
            Some(&self.work.scene),
            self.work.sky.environment.as_ref(),
            self.after.as_ref(),
        ]
        .into_iter()
        .flatten()
        .map(PathBuf::as_path)
        .collect();
        output::check_distinct(&[&self.output, &checkpoint], &inputs)
    }

    /// Which share of how many is done.
    pub fn share(&self) -> (u32, u32) {
        self.shard
            .map_or((0, 1), |shard| (shard.index, shard.count))
    }

    /// Where unfinished work is kept.
    pub fn checkpoint_path(&self) -> PathBuf {
        self.checkpoint.clone().unwrap_or_else(|| {
            // "out/" and "out" are the same folder.
            let mut name: std::ffi::OsString = self.output.components().collect::<PathBuf>().into();
            name.push(".checkpoint");
            name.into()
        })
    }
}

/// Finds out whether files can be written into a folder, which may not exist yet.
fn check_folder(path: &Path) -> Result<(), CliError> {
    match std::fs::metadata(path) {
        Ok(data) if data.is_dir() => output::check(&path.join("manifest.json")),
        Ok(_) => Err(CliError::input(
            "a file is in the way",
            path.display(),
            "name a folder",
        )),
        Err(_) => output::check(path),
    }
}
