//! Quantized visibility: any two ends that fall into the same pair of patches share one ray.
//!
//! Popov, Georgiev, Slusallek, Dachsbacher 2013, "Adaptive quantization visibility caching". The ends of a question are
//! quantized to cells of virtual grids that follow the surface's orientation, of a size that the sampling density sets
//! (so that errors have one size on the screen); the pair of cells is a key; the first question of a key is traced, later
//! ones get its answer. Where the answers of neighbouring cells differ, a shadow edge is near, and the question is asked
//! again with cells of half the size (Algorithm 2).
//!
//! Two ways to ask, one meaning:
//!
//! * single questions ([`Visibility::answer`]) go through one hash table, a word of 32 bits a key;
//! * many lights ([`Visibility::answer_many`]) first number the cells of all eyes, and then keep the answers of 16 lights
//!   in one word of a small array, without hashing: a look-up with its neighbours costs less than a nanosecond a question.
//!   Such lights have no patches: they come back as they are, so their exact place is their half of the key.
//!   A hash table of blocks behind it remembers for other tiles and passes, if [`Share`] says so.
//!
//! | [`Guarantee`] | answers | costs |
//! |---|---|---|
//! | `Bounded` | right but for patches of about `C_E` samples across at shadow edges | the fewest rays |
//! | `Unbiased` | right on average; noise where memory errs | a ray for a share of all questions, more at edges |
//! | `Consistent` | error falls to 0 over the passes of a job | patches shrink, so rays grow slowly |
//!
//! Two additions to the paper's search for neighbours and its sizes: an edge is also looked for in the layers above and below and in the next
//! resolutions, where tilted and bent surfaces go on; and consistent jobs shrink both ends by Eq. 6 with all connections so far.
//!
//! Wrong tool: where every question is about a new pair (few samples, no shared lights), where rays are nearly free (a box
//! of ten triangles), and in fine hair, where patches hold few samples. Questions whose eye has no finite positive density
//! (a camera's pinhole) or no normal are traced exactly.

mod digest;
mod inspect;
mod key;
mod many;
mod past;
mod settings;
mod single;
mod table;
mod workload;

#[cfg(test)]
mod tests;

pub use digest::Digest;
pub use inspect::PatchPair;
pub use key::BoundingSphere;
pub use settings::{
    ErrorReach, Guarantee, Pairing, QuantizedError, QuantizedSettings, Refine, Share,
};
pub use workload::{Asks, Workload};

use crate::stats::{Footprint, Held};
use crate::{
    Class, Endpoint, Epoch, EyeSample, LightEnd, ManyLights, Query, SharedLight, Tracer,
    Visibility, VisibilityStats,
};
use digest::mix;
use glam::Vec3;
use key::{Cell, Grids, LightKey, nearest_power_of_two};
use past::Past;
use std::sync::OnceLock;
use table::{BlockTable, WordTable};

/// Patches that a light with extent is cut into at least. Where an eye sample asks about one point of a lamp, Eqs. 7 and 9 make
/// the whole lamp one patch, and each patch of a penumbra black or white.
const LEAST_PATCHES: f32 = 16.0;

/// Areas of both ends of a consistent job shrink with this power of the passes. By Eq. 6 with all connections so far it is 1/2: a pair of
/// patches keeps its number of questions. With 1, as many eye samples in a patch as ever, pairs would grow faster than questions, and rays
/// with them; measured at 256 passes: 1/2 has 31 times fewer rays and 2.2 times the relMSE of 2/3, which has 13 times fewer.
const CONSISTENT: f32 = 0.5;

/// Bytes of a worker's own table where the memory of a sequence is apart.
const OWN_BYTES: usize = 4 << 20;

/// Answers from quantized ends. See the [module's description](self).
#[derive(Debug)]
pub struct Quantized {
    settings: QuantizedSettings,
    grids: Grids,
    /// The tables of [`Share::All`], made when first needed.
    shared: Tables,
    /// What earlier pictures have learnt ([`Share::Frames`]).
    past: Past,
    past_held: Option<Held>,
    /// Number of the picture in its sequence.
    picture: u64,
    footprint: Footprint,
}

/// The hash tables of one worker, or of all. Each is made when first needed: most jobs ask in one of the two ways.
#[derive(Debug, Default)]
struct Tables {
    words: OnceLock<WordTable>,
    blocks: OnceLock<BlockTable>,
}

/// Memory, scratch space and counters of one worker of [`Quantized`].
#[derive(Debug)]
pub struct QuantizedWorker {
    own: Tables,
    epoch: Epoch,
    decisions: Decisions,
    single: single::Scratch,
    many: many::Scratch,
    stats: VisibilityStats,
    held: Vec<Held>,
}

/// What an epoch sets apart: its keys and its random decisions.
#[derive(Clone, Copy, Debug, Default)]
struct Decisions {
    /// Part of every digest: sets apart what must not be shared.
    salt: u64,
    state: u64,
}

impl Decisions {
    /// 64 random bits (splitmix64: Steele et al. 2014, "Fast splittable pseudorandom number generators").
    fn random(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.state ^ self.state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ x >> 31
    }

    /// True with this probability.
    fn decide(&mut self, probability: f32) -> bool {
        probability >= 1.0 || (self.random() >> 40) as f32 * (1.0 / (1 << 24) as f32) < probability
    }
}

/// Which patch a question's ends lie in, up to refinement.
#[derive(Clone, Copy, Debug)]
struct Clustered {
    /// Orientation of the eye's grid.
    orientation: u32,
    position: Vec3,
    /// Its resolution at level 0, before Eq. 8.
    resolution: f32,
    light: LightKey,
    light_half: u64,
    /// Levels of refinement, the first included.
    levels: u32,
}

impl Quantized {
    /// A strategy for the world inside `bounds`.
    ///
    /// # Errors
    /// If a setting is outside its range, or the bounds are not finite.
    pub fn new(
        settings: QuantizedSettings,
        bounds: BoundingSphere,
    ) -> Result<Self, QuantizedError> {
        settings.check()?;
        if !(bounds.centre.is_finite() && bounds.radius.is_finite() && bounds.radius > 0.0) {
            return Err(QuantizedError::Bounds);
        }
        let grids = Grids::new(
            bounds,
            settings.normals,
            settings.slab,
            settings.resolution_step,
        );
        Ok(Self {
            settings,
            grids,
            shared: Tables::default(),
            past: Past::default(),
            past_held: None,
            picture: 0,
            footprint: Footprint::default(),
        })
    }

    /// The settings in use.
    pub fn settings(&self) -> &QuantizedSettings {
        &self.settings
    }

    /// Share of the words of the tables shared by all that hold an answer, 0 to 1; `None` without such tables.
    pub fn load(&self) -> Option<f64> {
        let words = self.shared.words.get().map(WordTable::load);
        let blocks = self.shared.blocks.get().map(BlockTable::load);
        words.into_iter().chain(blocks).reduce(f64::max)
    }

    /// The error reach of a kind of light end (`C_E`), samples.
    fn error(&self, light: &LightEnd) -> f32 {
        match light {
            LightEnd::Point(_) => self.settings.error.point,
            LightEnd::Direction(_) => self.settings.error.direction,
            LightEnd::Surface(_) => self.settings.error.area,
            LightEnd::SolidAngle { .. } => self.settings.error.sky,
        }
    }

    /// How many samples a pixel the densities of eyes and of lights stand for: as many as remember together. Both ends'
    /// patches shrink in a consistent job.
    fn passes(&self, epoch: Epoch) -> (f32, f32) {
        let now = epoch.samples.max(1);
        match (self.settings.guarantee, self.settings.share) {
            (Guarantee::Consistent, _) => {
                let so_far = epoch.pass as f32 + now as f32;
                let density = so_far.powf(CONSISTENT);
                // Those of lights grow in steps of four, all at once: lights that changed one by one would take the answers of
                // their block along.
                (density, (2.0 * (0.5 * density.log2()).round()).exp2())
            }
            (_, Share::Tile | Share::Frames) => (now as f32, 1.0),
            (_, Share::Thread | Share::All) => {
                (self.settings.samples_per_pixel.max(now) as f32, 1.0)
            }
        }
    }

    /// The key of a light end whose patch holds one sample of its technique (Eqs. 7 and 9).
    fn light_key(&self, light: &LightEnd, connections: f32, passes: f32) -> Option<LightKey> {
        let least = match self.settings.guarantee {
            // What a whole lamp's answer gets wrong comes back as noise, and not as blotches.
            Guarantee::Unbiased => 1.0,
            Guarantee::Bounded | Guarantee::Consistent => LEAST_PATCHES,
        };
        match light {
            LightEnd::Point(position) => {
                Some(LightKey::Point(position.to_array().map(f32::to_bits)))
            }
            LightEnd::Direction(direction) => {
                Some(LightKey::Direction(direction.to_array().map(f32::to_bits)))
            }
            LightEnd::Surface(end) => {
                let resolution = self
                    .grids
                    .resolution(known(end.density * connections.max(least))? * passes);
                self.surface_key(end, self.grids.quantize_light(resolution))
            }
            LightEnd::SolidAngle { direction, density } => {
                let density = known(density * connections.max(least))? * passes;
                Some(self.grids.solid_angle(*direction, density))
            }
        }
    }

    fn surface_key(&self, end: &Endpoint, resolution: u32) -> Option<LightKey> {
        let orientation = self.grids.orientation(end.normal)?;
        let cell = self.grids.cell(end.position, orientation, resolution);
        Some(LightKey::Surface(cell))
    }

    /// The patches of a question; `None` if it must be traced exactly.
    fn cluster(&self, query: &Query, epoch: Epoch) -> Option<Clustered> {
        let error = self.error(&query.light);
        if error == 0.0 {
            return None;
        }
        let (eye_passes, light_passes) = self.passes(epoch);
        let density = known(query.eye.density)? * eye_passes;
        let orientation = self.grids.orientation(query.eye.normal)?;
        let levels = self.settings.levels(error, eye_passes);
        if let (Pairing::Both, LightEnd::Surface(light)) = (self.settings.pairing, &query.light) {
            let pair = density * known(light.density * query.connections)? / (error * error);
            let resolution = self.grids.pair_resolution(pair);
            // Densities of path vertices differ far more than sizes should: in steps of two, as all light patches.
            let resolution = self.grids.quantize_light(resolution) as f32;
            let light = self.surface_key(light, resolution as u32)?;
            return Some(Clustered {
                orientation,
                position: query.eye.position,
                resolution,
                light,
                light_half: light.half(),
                levels,
            });
        }
        let picked = match query.light {
            // Lights without a density: the probability of the pick thins out the eyes that ask.
            LightEnd::Point(_) | LightEnd::Direction(_) => {
                nearest_power_of_two(known(query.connections)?.sqrt())
            }
            LightEnd::Surface(_) | LightEnd::SolidAngle { .. } => 1.0,
        };
        let light = self.light_key(&query.light, query.connections, light_passes)?;
        Some(Clustered {
            orientation,
            position: query.eye.position,
            resolution: self.grids.resolution(density) * picked / error,
            light,
            light_half: light.half(),
            levels,
        })
    }

    /// The cell of the eye at a level of refinement: each halves `C_E`.
    fn eye_cell(&self, clustered: &Clustered, level: u32) -> Cell {
        let resolution = clustered.resolution * (1u32 << level.min(31)) as f32;
        let resolution = self.grids.quantize(resolution);
        self.grids
            .cell(clustered.position, clustered.orientation, resolution)
    }

    /// The digest of an eye's cell and the light of a question.
    fn digest(&self, eye: &Cell, clustered: &Clustered, salt: u64) -> u64 {
        match self.settings.digest {
            Digest::Separable => mix(eye.half(), clustered.light_half ^ salt),
            digest => digest.pair(eye, &clustered.light, salt),
        }
    }

    fn words<'a>(&'a self, worker: &'a Tables, held: &mut Vec<Held>) -> &'a WordTable {
        let (tables, bytes) = match self.settings.share {
            Share::All => (&self.shared, self.settings.table_bytes),
            Share::Tile | Share::Thread => (worker, self.settings.table_bytes),
            // The size is that of what pictures share.
            Share::Frames => (worker, self.settings.table_bytes.min(OWN_BYTES)),
        };
        tables.words.get_or_init(|| {
            let table = WordTable::new(bytes);
            held.push(self.footprint.hold(table.bytes()));
            table
        })
    }

    /// The table of blocks behind the arrays of a tile; none if tiles remember for themselves.
    fn blocks<'a>(&'a self, worker: &'a Tables, held: &mut Vec<Held>) -> Option<&'a BlockTable> {
        let tables = match self.settings.share {
            Share::Tile | Share::Frames => return None,
            Share::Thread => worker,
            Share::All => &self.shared,
        };
        Some(tables.blocks.get_or_init(|| {
            let table = BlockTable::new(self.settings.table_bytes);
            held.push(self.footprint.hold(table.bytes()));
            table
        }))
    }
}

impl Quantized {
    /// The memory of earlier pictures, if there is to be one.
    fn past(&self) -> Option<&Past> {
        (self.settings.share == Share::Frames).then_some(&self.past)
    }
}

/// A density that patches can be sized by.
fn known(density: f32) -> Option<f32> {
    (density.is_finite() && density > 0.0).then_some(density)
}

impl<T: Tracer> Visibility<T> for Quantized {
    type Worker = QuantizedWorker;

    fn name(&self) -> &'static str {
        "quantized"
    }

    fn class(&self) -> Class {
        self.settings.guarantee.class()
    }

    fn worker(&self) -> QuantizedWorker {
        QuantizedWorker {
            own: Tables::default(),
            epoch: Epoch::default(),
            decisions: Decisions::default(),
            single: single::Scratch::default(),
            many: many::Scratch::default(),
            stats: VisibilityStats::default(),
            held: Vec::new(),
        }
    }

    fn begin(&self, worker: &mut QuantizedWorker, epoch: Epoch) {
        let number = u64::from(epoch.pass) << 32 | u64::from(epoch.tile);
        worker.epoch = epoch;
        worker.many.calls = 0;
        worker.decisions.state = match self.picture {
            0 => mix(self.settings.seed, number),
            // Decisions of another picture must not depend on what these have left in memory.
            picture => mix(mix(self.settings.seed, number), picture),
        };
        worker.decisions.salt = match self.settings.share {
            Share::Tile => mix(1, number),
            // Workers come and go with pictures; what they remember for themselves ends with the tile, too.
            Share::Frames => mix(mix(1, number), self.picture),
            Share::Thread | Share::All => 0,
        };
    }

    fn answer(
        &self,
        tracer: &T,
        worker: &mut QuantizedWorker,
        queries: &[Query],
        answers: &mut [f32],
    ) {
        assert_eq!(queries.len(), answers.len());
        single::answer(self, tracer, worker, queries, answers);
    }

    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut QuantizedWorker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        many::answer(self, tracer, worker, eyes, lights, asker);
    }

    fn next_picture(&mut self) {
        self.picture += 1;
        if self.settings.share == Share::Frames {
            self.past.turn(self.settings.table_bytes);
            self.past_held = None;
            self.past_held = Some(self.footprint.hold(self.past.bytes()));
        }
    }

    fn forget(&mut self) {
        self.shared = Tables::default();
        self.past.clear();
        self.past_held = None;
    }

    fn stats(&self, worker: &QuantizedWorker) -> VisibilityStats {
        worker.stats.clone()
    }

    fn bytes(&self) -> u64 {
        self.footprint.peak()
    }
}
