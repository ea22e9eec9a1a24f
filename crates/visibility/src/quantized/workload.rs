//! Settings for a piece of work: what was measured to suit who asks, and how often.
//!
//! [`QuantizedSettings`] says *what* a cache does; this says *whom* it serves. The choices follow Popov 2013, section 5, which gives ranges by
//! kind of light, and this project's own sweeps of them. The wrong tool for a job whose questions are unlike those of a
//! renderer: there set the fields of [`QuantizedSettings`] one by one.

use super::settings::{ErrorReach, Guarantee, Pairing, QuantizedSettings, Share};

/// How many questions one light end is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asks {
    /// One light a vertex, picked at random: path tracing with light samples.
    Single,
    /// Pairs of path vertices, each met once: bidirectional path tracing.
    Pairs,
    /// The same lights by every eye: instant radiosity.
    Many,
}

/// What settings depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workload {
    /// Who asks.
    pub asks: Asks,
    /// What answers may be trusted for.
    pub guarantee: Guarantee,
    /// Several pictures are made, one after the other.
    pub sequence: bool,
    /// Samples a pixel of a picture, if they are known.
    pub samples_per_pixel: Option<u32>,
    /// Pixels of a picture.
    pub pixels: u64,
    /// Point and spot lights of the scene.
    pub points: usize,
    /// Lights of the scene in one exact direction.
    pub directions: usize,
    /// Virtual lights.
    pub virtual_lights: u32,
    /// Seed of the checks of [`Guarantee::Unbiased`].
    pub seed: u64,
}

/// How many virtual lights there must be for each light without extent, if those are to be traced exactly: their hard shadows are what one sees
/// first, and then their rays are few. In sponza (one sun, 256 virtual lights) that costs a tenth more rays and takes the squared error down from
/// 1.5 to 0.0008.
const LONE: u64 = 256;

/// From how many point lights on errors of each may reach farther.
const MANY_POINTS: usize = 16;

/// Samples a pixel that are expected where nobody knows them.
const EXPECTED_SAMPLES: u32 = 1024;

/// Bytes of the smallest table, which fits the second cache of a core, and of the largest.
const TABLE_BYTES: [usize; 2] = [4 << 20, 256 << 20];

/// Bytes of a word of a table of single questions. One word an eye sample suffices: patches hold several questions, but a path asks at each of
/// its vertices.
const WORD_BYTES: u64 = 4;

impl Workload {
    /// The settings.
    ///
    /// ```
    /// use occlude_visibility::quantized::{Asks, Guarantee, Share, Workload};
    /// let work = Workload {
    ///     asks: Asks::Many,
    ///     guarantee: Guarantee::Bounded,
    ///     sequence: false,
    ///     samples_per_pixel: Some(9),
    ///     pixels: 1280 * 800,
    ///     points: 96,
    ///     directions: 0,
    ///     virtual_lights: 1024,
    ///     seed: 0,
    /// };
    /// let settings = work.settings();
    /// // Of many lights each brings little: errors of 4 pixels, which are 12 samples wide.
    /// assert_eq!((settings.error.point, settings.share), (12.0, Share::Tile));
    /// ```
    pub fn settings(&self) -> QuantizedSettings {
        let usual = QuantizedSettings::default();
        // What path vertices see of each other is met once and blurred by all that follows: rough patches share more.
        let (normals, slab, resolution_step, pairing) = match self.asks {
            Asks::Pairs => (2, 2.0, 2.0, Pairing::Both),
            Asks::Single | Asks::Many => (
                usual.normals,
                usual.slab,
                usual.resolution_step,
                Pairing::Eye,
            ),
        };
        let share = self.share();
        QuantizedSettings {
            error: self.error(),
            normals,
            slab,
            resolution_step,
            table_bytes: self.table_bytes(share),
            share,
            guarantee: self.guarantee,
            pairing,
            samples_per_pixel: self.samples_per_pixel.unwrap_or(1),
            seed: self.seed,
            ..usual
        }
    }

    fn error(&self) -> ErrorReach {
        let usual = ErrorReach::default();
        match (self.asks, self.guarantee) {
            // Where checks mend errors on average, larger patches cost less than they err.
            (Asks::Single, Guarantee::Unbiased) => ErrorReach {
                point: 14.0,
                direction: 14.0,
                area: 40.0,
                sky: 40.0,
            },
            (Asks::Many, _) if self.has_lone_lights() => ErrorReach {
                point: 0.0,
                direction: 0.0,
                ..usual
            },
            // A hard shadow shows every error, but of many each brings little: about four pixels then.
            (Asks::Many, _) if self.points >= MANY_POINTS => {
                let together = self.samples_per_pixel.unwrap_or(1).min(16) as f32;
                ErrorReach {
                    point: (usual.point * together.sqrt()).min(usual.area),
                    ..usual
                }
            }
            _ => usual,
        }
    }

    fn has_lone_lights(&self) -> bool {
        let without_extent = self.points.saturating_add(self.directions) as u64;
        without_extent.saturating_mul(LONE) <= u64::from(self.virtual_lights)
    }

    /// Tiles remember enough for themselves where they ask about the same lights in every pixel.
    fn share(&self) -> Share {
        match (self.asks, self.guarantee) {
            (Asks::Many, Guarantee::Bounded | Guarantee::Unbiased) if self.sequence => {
                Share::Frames
            }
            (Asks::Many, Guarantee::Bounded | Guarantee::Unbiased) => Share::Tile,
            _ => Share::All,
        }
    }

    /// Bytes of a table for those who remember together. One that is larger than what it has to hold is far from the processor for nothing.
    pub fn table_bytes(&self, share: Share) -> usize {
        let [least, most] = TABLE_BYTES;
        match share {
            Share::Tile | Share::Thread => least,
            Share::All if self.asks != Asks::Many => {
                let samples = u64::from(self.samples_per_pixel.unwrap_or(EXPECTED_SAMPLES));
                let words = samples.saturating_mul(self.pixels).min(1 << 40);
                let bytes = words.next_power_of_two() * WORD_BYTES;
                bytes.clamp(least as u64, most as u64) as usize
            }
            Share::All | Share::Frames => most,
        }
    }
}
