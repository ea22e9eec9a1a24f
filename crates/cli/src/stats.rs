//! The `--stats` file: schema 1 of the contract. Keys may be added; none is renamed.

use crate::error::CliError;
use crate::output;
use occlude_bake::atlas::Atlas;
use occlude_bake::rounds::Report;
use occlude_bake::state::State;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// What one run of a command did and what it cost.
#[derive(Debug, Clone, Serialize)]
pub struct Stats {
    /// Version of this layout.
    pub schema: u32,
    /// `render`, `inspect`...
    pub command: &'static str,
    /// File name of the scene, without its folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Commit that the program was built from.
    pub commit: &'static str,
    /// `--seed`.
    pub seed: u64,
    /// Where it ran.
    pub machine: Machine,
    /// Wall-clock seconds.
    pub seconds: Seconds,
    /// What the scene holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene_counts: Option<SceneCounts>,
    /// Fields of visibility: what the lobes that stand for the sky lose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sky: Option<Sky>,
    /// What rendering did.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub work: Option<Work>,
    /// What baking did.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub bake: Option<Bake>,
    /// With `--frames`: one by one, those of this run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<Frame>,
    /// Memory of the whole process.
    pub memory: Memory,
}

/// The sky as lobes. Errors are root mean squares in units of the mean.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Sky {
    /// Spherical Gaussians.
    pub lobes: usize,
    /// Sources that are asked about by exact rays.
    pub suns: usize,
    /// Of radiance, suns left out.
    pub radiance_error: f32,
    /// Of unshadowed irradiance.
    pub irradiance_error: f32,
    /// The largest of unshadowed irradiance.
    pub irradiance_error_worst: f32,
}

/// The machine.
#[derive(Debug, Clone, Serialize)]
pub struct Machine {
    /// Name of the processor.
    pub cpu: String,
    /// Logical cores that this process may use.
    pub cores: usize,
    /// Threads that worked.
    pub threads: usize,
    /// Widest instructions that the processor offers: `avx512`, `avx2`, `sse2`, `neon`, `none`.
    pub simd: &'static str,
}

/// Where the time went. `total` is the whole process from its start; `work` is rendering alone.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Seconds {
    /// From the start of the process to this file.
    pub total: f64,
    /// Reading and decoding the scene and the environment.
    pub load: f64,
    /// Building the BVH and the light distributions.
    pub build: f64,
    /// Rendering.
    pub work: f64,
    /// Encoding and writing the outputs.
    pub write: f64,
    /// The same and finer, by name.
    pub phases: BTreeMap<&'static str, f64>,
}

/// Counts of the scene.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct SceneCounts {
    /// Every instance's triangles.
    pub triangles: u64,
    /// Triangles of the meshes, each counted once.
    pub unique_triangles: u64,
    /// Mesh instances.
    pub instances: u64,
    /// Lights: punctual lights, emissive triangles, the environment if it shines.
    pub lights: u64,
}

/// What rendering did.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Work {
    /// Samples of every pixel in the outputs.
    pub samples_per_pixel: u32,
    /// `samples`, `time`, `noise` or `cancel`.
    pub stopped_by: &'static str,
    /// Rays by kind.
    pub rays: Rays,
    /// What the visibility strategy did.
    pub visibility: Visibility,
    /// Instant radiosity: virtual lights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vpls: Option<u32>,
    /// Instant radiosity: the bound on the geometry term, per square metre; left out if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clamp: Option<f32>,
    /// Instant radiosity: what the bound took away, as a share of the picture's sum.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clamped_energy: Option<f64>,
    /// Fields of visibility: what they took.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field: Option<Field>,
    /// Visibility records.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub records: Option<Records>,
}

/// What fields of visibility took for one picture.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Field {
    /// Seconds for moving points and deciding where they should be.
    pub t_update: f64,
    /// Seconds for visibility maps.
    pub t_visibility: f64,
    /// Seconds for distance transforms.
    pub t_transform: f64,
    /// Seconds for lines of sight and shading.
    pub t_integration: f64,
    /// Points that the picture used.
    pub sample_points: u64,
    /// Rays for visibility maps.
    pub rays: u64,
    /// Pixels that see a surface.
    pub covered_pixels: u64,
    /// Bytes of maps and fields.
    pub bytes: u64,
}

impl Field {
    /// As the integrator reports it.
    pub fn of(report: &occlude_render::integrator::FieldReport) -> Self {
        Self {
            t_update: report.update,
            t_visibility: report.visibility,
            t_transform: report.transform,
            t_integration: report.integration,
            sample_points: report.points,
            rays: report.rays,
            covered_pixels: report.covered,
            bytes: report.bytes,
        }
    }
}

/// What baking did.
#[derive(Debug, Clone, Serialize)]
pub struct Bake {
    /// Texels of all pages, padding included.
    pub texels: u64,
    /// Directions of the last round, or paths a texel.
    pub directions: u32,
    /// Pages.
    pub pages: usize,
    /// `samples`, `time`, `noise` or `cancel`; `unchanged` if there was nothing to do.
    pub stopped_by: &'static str,
    /// Estimated mean relative standard error of the last round.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
    /// Rays by kind; what bundles find is not among them.
    pub rays: Rays,
    /// What bundles did.
    pub bundles: Bundles,
    /// Wall-clock seconds of a direction of bundles, or of a path of every texel.
    pub seconds_per_direction: f64,
    /// Wall-clock seconds by round.
    pub rounds: Vec<Round>,
}

/// One round of a bake.
#[derive(Debug, Clone, Serialize)]
pub struct Round {
    /// What it gathered.
    pub name: &'static str,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// What bundles did.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Bundles {
    /// Directions of all rounds.
    pub directions: u64,
    /// Surfaces on lines.
    pub fragments: u64,
    /// Segments whose ends look at each other.
    pub pairs: u64,
    /// Values that baked fronts got from fronts.
    pub exchanges: u64,
    /// Tiles.
    pub tiles: u64,
    /// Tiles that did not fit and were split and done again.
    pub overflow_detected: u64,
    /// Tiles that lost light in the result: always 0.
    pub overflow_left: u64,
    /// Fragments that found no place in a tile that was done again.
    pub nodes_dropped: u64,
    /// Tiles that were split.
    pub splits: u64,
    /// Split tiles that would have fitted.
    pub false_alarms: u64,
    /// Share of the time that went into tiles that were done again.
    pub redo_share: f64,
    /// Wall-clock seconds by phase.
    pub seconds: BundleSeconds,
}

/// Wall-clock seconds of bundles by phase.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct BundleSeconds {
    /// Maps of importance and of fragments.
    pub analysis: f64,
    /// Their mipmaps.
    pub mipmaps: f64,
    /// Cutting tiles.
    pub tiling: f64,
    /// Rasterizing.
    pub creation: f64,
    /// Sorting, exchange and sums.
    pub update: f64,
}

impl Bake {
    /// Of a run that found its work done.
    pub fn unchanged(atlas: &Atlas) -> Self {
        Self {
            texels: u64::from(atlas.texels()),
            directions: 0,
            pages: atlas.pages.len(),
            stopped_by: "unchanged",
            noise: None,
            rays: Rays::default(),
            bundles: Bundles::default(),
            seconds_per_direction: 0.0,
            rounds: Vec::new(),
        }
    }

    /// Of a run that has ended by `stopped_by`.
    pub fn new(atlas: &Atlas, report: &Report, state: &State, stopped_by: &'static str) -> Self {
        let b = &report.bundles;
        let last = report.seconds.last().map_or(0.0, |(_, seconds)| *seconds);
        Self {
            texels: u64::from(atlas.texels()),
            directions: state.min_done(),
            pages: atlas.pages.len(),
            stopped_by,
            noise: report.noise,
            rays: Rays {
                primary: 0,
                secondary: report.secondary,
                shadow: report.shadow,
                fill: 0,
            },
            bundles: Bundles {
                directions: b.directions,
                fragments: b.fragments,
                pairs: b.pairs,
                exchanges: b.exchanges,
                tiles: b.tiles,
                overflow_detected: b.overflow_detected,
                overflow_left: b.overflow_left,
                nodes_dropped: b.nodes_dropped,
                splits: b.splits,
                false_alarms: b.false_alarms,
                redo_share: b.redo_share(),
                seconds: BundleSeconds {
                    analysis: b.seconds.analysis,
                    mipmaps: b.seconds.mipmaps,
                    tiling: b.seconds.tiling,
                    creation: b.seconds.creation,
                    update: b.seconds.update,
                },
            },
            seconds_per_direction: if b.directions > 0 {
                b.total_seconds() / b.directions as f64
            } else {
                last / f64::from(state.min_done().max(1))
            },
            rounds: report
                .seconds
                .iter()
                .map(|&(name, seconds)| Round { name, seconds })
                .collect(),
        }
    }
}

/// Visibility records, and what they cost.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Records {
    /// Records at the end.
    pub count: u32,
    /// Records at most.
    pub capacity: u32,
    /// The most bytes that they held.
    pub bytes: u64,
    /// Refinement steps that moved or added a record.
    pub refinements: u64,
    /// Of a step, in the mean.
    pub milliseconds_per_refinement: f64,
    /// Of placing and filling the first records.
    pub initial_seconds: f64,
    /// Of what records did between passes, all together.
    pub upkeep_seconds: f64,
    /// Records traced again because something moved in front of them.
    pub refilled: u64,
    /// `--secondary`: rays that records were asked about.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rays_asked: Option<u64>,
    /// Those among them that were traced after all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rays_traced: Option<u64>,
    /// Why: rays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rays_unanswered: Option<Unanswered>,
    /// Why questions for visibility were traced.
    pub unanswered: Unanswered,
}

/// Questions that records left to rays, by reason.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Unanswered {
    /// No record stands near and looks to the same side.
    pub no_record: u64,
    /// What is asked about lies below the horizon of the records that stand near.
    pub below_horizon: u64,
    /// What they see there cannot be kept or does not fit.
    pub unknown: u64,
    /// What is asked about is too near.
    pub too_near: u64,
}

impl From<occlude_visibility::Unanswered> for Unanswered {
    fn from(counts: occlude_visibility::Unanswered) -> Self {
        Self {
            no_record: counts.no_record,
            below_horizon: counts.below_horizon,
            unknown: counts.unknown,
            too_near: counts.too_near,
        }
    }
}

/// One picture of a sequence.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Frame {
    /// Its number.
    pub frame: u32,
    /// Wall-clock seconds, from posing to written files.
    pub seconds: f64,
    /// Of these, posing and building hierarchies.
    pub build: f64,
    /// Rendering alone.
    pub work: f64,
    /// Visibility questions.
    pub queries: u64,
    /// Rays traced for them.
    pub traced: u64,
    /// Instant radiosity: virtual lights that the frame before did not have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vpls_renewed: Option<u32>,
    /// Fields of visibility: what they took.
    #[serde(flatten)]
    pub field: Option<Field>,
}

/// Rays by kind.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Rays {
    /// From the camera.
    pub primary: u64,
    /// From surfaces, in search of the next one.
    pub secondary: u64,
    /// Towards lights.
    pub shadow: u64,
    /// That filled records.
    pub fill: u64,
}

/// What the visibility strategy did. Ray reduction is `queries / traced`.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Visibility {
    /// `exact`, `occluder`...
    pub strategy: String,
    /// `exact`, `unbiased`, `consistent`, `bounded` or `biased`.
    pub class: &'static str,
    /// Questions that the integrator asked.
    pub queries: u64,
    /// Those that needed no ray.
    pub answered: u64,
    /// Rays traced for the rest.
    pub traced: u64,
    /// Questions refined, by level.
    pub refined: Vec<u64>,
    /// Answers that gave way to others in a lossy table.
    pub overwritten: u64,
    /// Memory that the strategy holds.
    pub bytes: u64,
}

/// Memory of the whole process.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Memory {
    /// Largest resident size so far.
    pub peak_bytes: u64,
    /// `--memory`.
    pub limit_bytes: Option<u64>,
}

/// The commit that the program was built from.
pub const COMMIT: &str = env!("OCCLUDE_COMMIT");

impl Stats {
    /// A record that holds what is known at the start.
    pub fn new(command: &'static str, seed: u64, threads: usize, limit_bytes: Option<u64>) -> Self {
        Self {
            schema: 1,
            command,
            scene: None,
            commit: COMMIT,
            seed,
            machine: Machine {
                cpu: cpu_name(),
                cores: std::thread::available_parallelism().map_or(1, |n| n.get()),
                threads,
                simd: simd(),
            },
            seconds: Seconds::default(),
            scene_counts: None,
            sky: None,
            work: None,
            bake: None,
            frames: Vec::new(),
            memory: Memory {
                peak_bytes: 0,
                limit_bytes,
            },
        }
    }

    /// Writes the file, with the time since `began` and the peak memory of this moment.
    pub fn write(&mut self, path: &Path, began: Instant) -> Result<(), CliError> {
        self.seconds.total = began.elapsed().as_secs_f64();
        self.memory.peak_bytes = peak_memory();
        let mut text = serde_json::to_vec_pretty(self)
            .map_err(|error| CliError::failed("cannot encode statistics", path.display(), error))?;
        text.push(b'\n');
        output::write(path, |out| out.write_all(&text))
    }
}

/// Resident size of this process now, in bytes; the largest so far where the system does not tell.
#[cfg(target_os = "linux")]
pub fn resident_memory() -> u64 {
    status_bytes("VmRSS:")
}

/// Resident size of this process now, in bytes; the largest so far where the system does not tell.
#[cfg(not(target_os = "linux"))]
pub fn resident_memory() -> u64 {
    peak_memory()
}

/// Largest resident size of this process so far, in bytes; 0 where the system does not tell.
#[cfg(target_os = "linux")]
pub fn peak_memory() -> u64 {
    status_bytes("VmHWM:")
}

/// A line of the process's status.
#[cfg(target_os = "linux")]
fn status_bytes(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(key));
    let kib = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

/// Largest resident size of this process so far, in bytes; 0 where the system does not tell.
#[cfg(all(unix, not(target_os = "linux")))]
pub fn peak_memory() -> u64 {
    let mut usage = std::mem::MaybeUninit::<libc::rusage>::zeroed();
    // SAFETY: the pointer is to a whole, writable `rusage`, which is all that getrusage asks for.
    let result = unsafe { libc::getrusage(libc::RUSAGE_SELF, usage.as_mut_ptr()) };
    if result != 0 {
        return 0;
    }
    // SAFETY: all-zero bytes are a valid `rusage` (integers alone), and getrusage has filled it.
    let peak = unsafe { usage.assume_init() }.ru_maxrss as u64;
    // Apple's systems count bytes, the others KiB.
    if cfg!(target_vendor = "apple") {
        peak
    } else {
        peak * 1024
    }
}

/// Largest resident size of this process so far, in bytes; 0 where the system does not tell.
#[cfg(not(unix))]
pub fn peak_memory() -> u64 {
    0
}

/// What the system calls the processor.
fn cpu_name() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let value = |key: &str| {
        let line = info.lines().find(|line| line.starts_with(key))?;
        line.split_once(':').map(|(_, name)| name.trim().to_owned())
    };
    value("model name")
        .or_else(|| value("Hardware"))
        .or_else(|| std::env::var("PROCESSOR_IDENTIFIER").ok())
        .unwrap_or_else(|| std::env::consts::ARCH.to_owned())
}

/// The widest instructions that this processor offers.
fn simd() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx512f") {
            "avx512"
        } else if std::arch::is_x86_feature_detected!("avx2") {
            "avx2"
        } else {
            "sse2"
        }
    }
    #[cfg(target_arch = "aarch64")]
    {
        "neon"
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    {
        "none"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_those_of_the_contract() {
        let mut stats = Stats::new("render", 7, 2, Some(1 << 30));
        stats.scene = Some("a.glb".into());
        stats.scene_counts = Some(SceneCounts::default());
        stats.work = Some(Work::default());
        let json = serde_json::to_value(&stats).unwrap();
        let keys = |value: &serde_json::Value| {
            let mut keys: Vec<String> = value.as_object().unwrap().keys().cloned().collect();
            keys.sort();
            keys.join(" ")
        };
        assert_eq!(
            keys(&json),
            "command commit machine memory rays samples_per_pixel scene scene_counts schema seconds seed stopped_by visibility"
        );
        assert_eq!(keys(&json["machine"]), "cores cpu simd threads");
        assert_eq!(keys(&json["seconds"]), "build load phases total work write");
        assert_eq!(
            keys(&json["scene_counts"]),
            "instances lights triangles unique_triangles"
        );
        assert_eq!(keys(&json["rays"]), "fill primary secondary shadow");
        assert_eq!(
            keys(&json["visibility"]),
            "answered bytes class overwritten queries refined strategy traced"
        );
        assert_eq!(keys(&json["memory"]), "limit_bytes peak_bytes");
    }

    #[test]
    fn peak_memory_sees_an_allocation() {
        let before = peak_memory();
        let block = vec![1u8; 256 << 20];
        assert!(block.iter().map(|&b| u64::from(b)).sum::<u64>() == 256 << 20);
        assert!(
            peak_memory() >= before.max(256 << 20),
            "{before} {}",
            peak_memory()
        );
    }
}
