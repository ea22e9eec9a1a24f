//! What a bake will take, before it begins: bytes and seconds; and which way of gathering is the faster one.
//!
//! Bytes are counted from the sizes of everything that grows with the work. Seconds come from doing a little of each round and
//! extrapolating, so they are those of the machine at hand. The choice between bundles and paths must not depend on a clock (the same
//! command must give the same bytes, a checkpoint must fit the command that goes on from it, and all machines of a bake must choose alike), so it
//! is made from counts ([`Bake::price`]): rays of sample paths, triangles and fragments of a sample direction, each at the price that it had on
//! the machine where the prices were measured. Only their ratios matter.

use crate::bundle::{self, BACKS_DIRECTIONS, BACKS_FACTOR, Directions, Radiance};
use crate::export::FINISHING_BYTES_PER_TEXEL;
use crate::gather::Gatherer;
use crate::rounds::{Bake, GatherKind, Light, Round, RoundKind, bytes_of_spots};
use crate::store::{STRETCH, Spill, Store, WINDOWS};
use crate::sums::Sums;
use glam::Vec3;
use occlude_render::job::Job;
use rayon::prelude::*;
use std::io;
use std::time::Instant;

/// Bytes that a bake will hold beside the scene, its hierarchy and its atlas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// While it gathers, without the buffers of bundles.
    pub gathering: u64,
    /// Buffers of bundles as set.
    pub buffers: u64,
    /// While light maps are finished and written.
    pub writing: u64,
}

impl Memory {
    /// With buffers as they are set.
    pub fn peak(&self) -> u64 {
        (self.gathering + self.buffers).max(self.writing)
    }
}

/// What a little of the work took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Seconds of every round, on this machine now.
    pub rounds: Vec<f64>,
    /// Rays of all rounds.
    pub rays: f64,
}

impl Estimate {
    /// Seconds of gathering.
    pub fn seconds(&self) -> f64 {
        self.rounds.iter().sum()
    }
}

/// Samples that are tried.
const TRIED: usize = 1 << 17;

/// Directions that are tried: for their fragments, and at most, and for about so long.
const COUNTED: u32 = 2;
const MOST_TRIED: u32 = 18;
const TRIED_SECONDS: f64 = 0.4;

/// Prices on the reference machine, nanoseconds of one of two busy cores: a scattered ray with its shading in a scene of one
/// triangle, and what each doubling of the triangles adds.
const RAY: f64 = 150.0;
const RAY_PER_DOUBLING: f64 = 25.0;
/// A triangle of a direction, and a fragment with its exchange.
const TRIANGLE: f64 = 95.0;
const FRAGMENT: f64 = 40.0;
/// A pixel of the analysis, with its mipmaps and the clearing of both.
const ANALYSIS_PIXEL: f64 = 12.0;

/// Backs that matter, as a share of fronts, before they are known: between none and nearly all.
const BACKS_SHARE: f64 = 0.5;

/// Where there are spots, their round costs about as much as direct light; where there are none, nothing.
const SPOTS_SHARE: f64 = 0.5;

impl Bake<'_> {
    /// What will be held. `scene_file`: bytes of the file that the scene came from, which is read again when the scene is written.
    pub fn memory(&self, scene_file: u64) -> Memory {
        let sides = u64::from(self.sides());
        let map = size_of::<Vec3>() as u64 * sides;
        let units = (0..self.rounds().len() as u32).map(|round| self.units_of(round));
        // What is in memory, beside what may be on disk.
        let fixed =
            4 * u64::from(units.max().unwrap_or(0)) + crate::noise::Noise::bytes(self.sides());
        let state = Sums::bytes(self.sides());
        let has = |kind| self.rounds().iter().any(|round| round.kind == kind);
        let texels = u64::from(self.subject.texels.atlas.texels());
        let moments = if self.settings.directional {
            texels * (size_of::<crate::sums::Sum>() + size_of::<Vec3>()) as u64
        } else {
            0
        };
        let maps = if has(RoundKind::Reflected) || has(RoundKind::Sky) {
            2 * map
        } else {
            0
        } + if has(RoundKind::Spots) { map } else { 0 };
        let (radiance, albedo) = self.subject.triangles.map_or((0, 0), |triangles| {
            let fronts = triangles.sides().fronts_count();
            (Radiance::bytes(self.sides()), 6 * u64::from(fronts))
        });
        let threads = rayon::current_num_threads() as u64;
        let largest = self
            .subject
            .texels
            .atlas
            .pages
            .iter()
            .map(|page| page.texels());
        let largest = u64::from(largest.max().unwrap_or(0));
        let all = state + maps + moments;
        let spots = if has(RoundKind::Spots) {
            bytes_of_spots(self.sides())
        } else {
            0
        };
        let kept = fixed + self.tiny.bytes() + spots;
        let (gathering, writing) = if self.store.is_on_disk() {
            // A stretch of everything; a window of the sums; what waits for it. A page while it is written.
            let share = |part: u64| all * part / u64::from(self.sides().max(1));
            let page = share(largest);
            let stretch = share(2 * u64::from(STRETCH)) + 6 * u64::from(STRETCH);
            let spills = if radiance > 0 { 2 * Spill::BYTES } else { 0 };
            let window = state / WINDOWS as u64;
            (kept + stretch + spills + window, kept + page)
        } else {
            (kept + all + albedo, kept + all)
        };
        Memory {
            gathering: gathering + radiance + threads * WORKER_BYTES,
            buffers: self.buffers(&self.settings.bundles),
            writing: writing
                + (largest * WRITING_BYTES_PER_TEXEL).max(scene_file * SCENE_FILE_COPIES),
        }
    }

    fn buffers(&self, settings: &bundle::Settings) -> u64 {
        let threads = rayon::current_num_threads() as u64;
        let triangles = self.subject.triangles;
        triangles.map_or(0, |t| settings.bytes(t.len() as u64, threads))
    }

    /// The least limit that the work keeps within. `all` makes what the whole process holds out of what this work does. (The larger the
    /// limit, the larger the buffers that [`bundle::Settings::for_limit`] takes: the least limit that its own buffers fit is found by iteration,
    /// each step of which adds less than a tenth of the one before.)
    pub fn floor(&self, memory: &Memory, all: impl Fn(u64) -> u64) -> u64 {
        let mut limit = 0;
        loop {
            let settings = bundle::Settings::for_limit(limit);
            let held = memory.gathering + self.buffers(&settings);
            let next = all(held.max(memory.writing));
            if next <= limit {
                return limit;
            }
            limit = next;
        }
    }

    /// Bytes of a texel while light is gathered in rounds, and by paths alone: what every bake of so many texels holds in memory at least.
    pub fn least_bytes_per_texel(gather: GatherKind, store: &Store) -> u64 {
        let sums = size_of::<crate::sums::Sum>() as u64;
        match (gather, store.is_on_disk()) {
            // The light of two maps, radiance, albedo.
            (GatherKind::Bundles, false) => sums + 2 * size_of::<Vec3>() as u64 + 4 + 6,
            (GatherKind::Path, false) => sums,
            (GatherKind::Bundles, true) => 4,
            (GatherKind::Path, true) => 0,
        }
    }

    /// Does a little of every round.
    ///
    /// # Errors
    /// The store has no room, or fails.
    pub fn estimate(&self, job: &Job) -> io::Result<Estimate> {
        let mut estimate = Estimate::default();
        let mut direction = None;
        for &round in self.rounds() {
            let (seconds, rays) = match round.kind {
                RoundKind::Paths | RoundKind::Direct => self.try_samples(round),
                // Whether there are any is known when direct light is.
                RoundKind::Spots => {
                    let (seconds, rays) = self.try_samples(round);
                    (SPOTS_SHARE * seconds, SPOTS_SHARE * rays)
                }
                RoundKind::Sky | RoundKind::Reflected => {
                    let seconds = match direction {
                        Some(known) => known,
                        None => *direction.insert(self.try_bundles(MOST_TRIED, job)?.0),
                    };
                    (seconds * f64::from(round.total), 0.0)
                }
            };
            estimate.rounds.push(seconds);
            estimate.rays += rays;
        }
        Ok(estimate)
    }

    /// What the work costs at the prices of the reference machine, seconds, from counts alone: the same on every machine. By bundles that includes finding
    /// backs, which need not be known.
    ///
    /// # Errors
    /// As [`Bake::estimate`].
    pub fn price(&self, job: &Job) -> io::Result<f64> {
        let geometry = self.subject.world.geometry;
        let meshes = geometry.pose.instances.iter().map(|posed| posed.mesh);
        let triangles: usize = meshes
            .map(|mesh| geometry.scene.meshes[mesh as usize].triangles.len())
            .sum();
        let ray = RAY + RAY_PER_DOUBLING * (triangles.max(1) as f64).log2();
        let backs = match self.subject.triangles {
            Some(triangles) if triangles.sides().has_backs() => 1.0,
            Some(_) => 1.0 + BACKS_SHARE,
            None => 1.0,
        };
        let through = triangles as f64 * TRIANGLE
            + f64::from(self.settings.bundles.analysis).powi(2) * ANALYSIS_PIXEL;
        let mut fragments = None;
        let mut price = 0.0;
        for &round in self.rounds() {
            price += match round.kind {
                RoundKind::Paths => self.try_samples(round).1 * ray,
                RoundKind::Direct => self.try_samples(round).1 * backs * ray,
                RoundKind::Spots => SPOTS_SHARE * self.try_samples(round).1 * backs * ray,
                RoundKind::Sky | RoundKind::Reflected => {
                    let fragments = match fragments {
                        Some(known) => known,
                        None => {
                            let count = self.try_bundles(COUNTED, job)?.1;
                            price += f64::from(BACKS_DIRECTIONS)
                                * (through + count * f64::from(BACKS_FACTOR) * FRAGMENT);
                            *fragments.insert(count)
                        }
                    };
                    let direction = through + fragments * FRAGMENT + self.tiny.rays() * ray;
                    direction * f64::from(round.total)
                }
            };
        }
        Ok(price * 0.5e-9)
    }

    /// Seconds and rays of a round of samples.
    fn try_samples(&self, round: Round) -> (f64, f64) {
        let settings = self.path_settings(round);
        let all: u64 = self.patches.iter().map(|patch| self.texels_of(patch)).sum();
        // Few samples of many patches: light differs from place to place.
        let wanted = TRIED as u64 / u64::from(round.total.min(2));
        let step = (all / wanted.max(1)).clamp(1, self.patches.len().max(1) as u64) as usize;
        let chosen: Vec<_> = self.patches.iter().step_by(step).collect();
        let tried: u64 = chosen.iter().map(|patch| self.texels_of(patch)).sum();
        let numbers = 0..round.total.min(2);
        let run = |numbers: &std::ops::Range<u32>| -> u64 {
            chosen
                .par_iter()
                .map(|patch| {
                    let mut gatherer = Gatherer::default();
                    let mut samples = Vec::new();
                    self.place(patch, numbers, &settings, &mut samples);
                    let mut irradiance = vec![Vec3::ZERO; samples.len()];
                    let batches = samples.chunks(2048).zip(irradiance.chunks_mut(2048));
                    for (samples, irradiance) in batches {
                        gatherer.gather(&self.subject.world, &settings, samples, irradiance);
                    }
                    gatherer.secondary + gatherer.shadow
                })
                .sum()
        };
        let began = Instant::now();
        let rays = run(&numbers);
        let scale = all as f64 / tried.max(1) as f64 * f64::from(round.total)
            / f64::from(numbers.end.max(1));
        (began.elapsed().as_secs_f64() * scale, rays as f64 * scale)
    }

    /// Seconds and fragments of one direction. Seconds come from as many directions as it takes to know them, `most` at most, fragments always from the
    /// same.
    fn try_bundles(&self, most: u32, job: &Job) -> io::Result<(f64, f64)> {
        let Some(triangles) = self.subject.triangles else {
            return Ok((0.0, 0.0));
        };
        let radiance = Radiance::new(self.sides(), 1.0, |_| Vec3::ONE);
        let unit = bundle::unit(1.0, MOST_TRIED);
        let sums = Sums::new_in(&self.store, self.sides(), unit, 0)?;
        let directions = Directions {
            seed: self.settings.seed,
            round: u32::MAX,
        };
        let light = Light {
            triangles,
            radiance: &radiance,
            sky: None,
        };
        let gather = |range: std::ops::Range<u32>| {
            self.gather_tiny(&light, u32::MAX, range.clone(), &sums);
            bundle::gather(
                triangles,
                &radiance,
                None,
                &directions,
                range,
                &self.settings.bundles,
                job,
                &sums,
            )
        };
        // The first touches all memory.
        let counted = gather(0..COUNTED);
        let fragments = counted.fragments as f64 / (counted.directions as f64).max(1.0);
        let (mut next, mut seconds) = (COUNTED, 0.0);
        while next < most && seconds < TRIED_SECONDS && !job.is_cancelled() {
            let began = Instant::now();
            gather(next..next + COUNTED);
            next += COUNTED;
            seconds += began.elapsed().as_secs_f64();
        }
        sums.check()?;
        Ok((seconds / f64::from((next - COUNTED).max(1)), fragments))
    }
}

/// Batches of samples and their rays, a thread.
const WORKER_BYTES: u64 = 8 << 20;

/// A page while it is finished and encoded.
const WRITING_BYTES_PER_TEXEL: u64 = FINISHING_BYTES_PER_TEXEL + 16;

/// The file, its parts decoded, and the file that is written.
const SCENE_FILE_COPIES: u64 = 3;
