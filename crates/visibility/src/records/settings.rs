//! What a user may choose, and what is legal.

use glam::Vec3;

/// Of the records near a place, which one answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Select {
    /// The one of the highest weight.
    Nearest,
    /// Three by their weights: a ray question goes to one of them, chosen with that probability; the answers to a segment are averaged.
    #[default]
    Probable,
}

/// How a record answers for a place that is not its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lookup {
    /// As if the ray started at the record (Ulbrich 2013, section 4).
    #[default]
    Snap,
    /// The same, but the ray that starts at the place is cut with the plane of what the record sees: where a surface goes on as flat as it
    /// is there the answer is as exact as distances are kept. Surfaces end, and planes go on behind others: so the record is asked once more
    /// whether it sees the plane at the point found. Segments are answered as by snapping.
    Plane,
    /// Step by step along the true ray, until it is behind what the record sees (section 6).
    March,
}

/// Where records stand that answer for virtual lights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Placement {
    /// Along paths from the camera, and where steps take them (Ulbrich 2013): however many lights there are.
    #[default]
    Paths,
    /// On the lights themselves, one on each, as long as there are no more lights than records: the map of a light's own place is asked by
    /// nobody else, so there is nothing to interpolate, nothing near that the light sees otherwise than its record, and nothing to
    /// refine. Else as `Paths`.
    Lights,
}

/// The function that tells which records belong together: Eq. 2 with one of two spatial terms, `x = d / d_max`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Falloff {
    /// As printed: `1 - x / (1 + 5 x)`, which falls to 5/6.
    Printed,
    /// Falls to 0 at `d_max`, fast at first: `max(0, 1 - 6 x / (1 + 5 x))` (the intent of Clarberg & Akenine-Möller 2008).
    #[default]
    ToZero,
}

/// What answers to segments may be trusted for. Answers to rays have no class but biased.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RecordGuarantee {
    /// None: errors are as large as records are coarse.
    #[default]
    Biased,
    /// Right on average: where records disagree a ray is traced, and some of the other answers are checked, and corrected by as much
    /// as checks are rare.
    Unbiased,
}

/// All choices of a [`Cache`](super::Cache). [`Default`] is meant to need no change but `scene` and `threads`.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordSettings {
    /// Records at most, 1 to 65534.
    pub capacity: u32,
    /// Records of the initial distribution; steps add others, up to the capacity.
    pub initial: u32,
    /// Texels along the side of a map, a power of two, 8 to 1024.
    pub resolution: u32,
    /// Where they stand.
    pub placement: Placement,
    /// Keep what is seen, too (normals and albedo), so that paths can go on inside the cache: 8 bytes a texel instead of 2.
    pub surfaces: bool,
    /// Weight of use against correlation in a record's importance, 0 to 1 (Eq. 1): at 0 records go where visibility changes, at 1
    /// where they are asked. The paper has 0.5; of 0.5 to 0.8, 0.6 was best or near the best in four rooms.
    pub alpha: f32,
    /// Refinement steps before the first pass.
    pub steps: u32,
    /// Refinement steps after every pass.
    pub pace: u32,
    /// Refinement steps before every further picture of a sequence.
    pub steps_per_picture: u32,
    /// Who answers.
    pub select: Select,
    /// How.
    pub lookup: Lookup,
    /// Questions about what is near are traced whole: segments shorter than this many times the distance between the light and its
    /// record, and rays that a record answers with a distance shorter than a quarter of that many times the one between the place and itself
    /// (an eighth with planes, but then those, too, whose plane is met far from where the record meets it). There the record sees
    /// something else than the place does. 0: none are.
    pub contact: f32,
    /// Length of the exact rays at either end, in units of what a record's answer is uncertain by there: the distance between
    /// the place and its record, or a texel's footprint. 0: none.
    pub near: f32,
    /// Which records belong together.
    pub falloff: Falloff,
    /// What answers to segments may be trusted for.
    pub guarantee: RecordGuarantee,
    /// Bytes that records may hold.
    pub memory: Option<u64>,
    /// Lower and upper corner of the scene.
    pub scene: [Vec3; 2],
    /// Threads that fill maps.
    pub threads: usize,
    /// Seed of all random decisions.
    pub seed: u64,
}

impl Default for RecordSettings {
    fn default() -> Self {
        Self {
            capacity: 4000,
            initial: u32::MAX,
            resolution: 128,
            placement: Placement::default(),
            surfaces: false,
            alpha: 0.6,
            steps: 0,
            pace: 1,
            steps_per_picture: 32,
            select: Select::default(),
            lookup: Lookup::default(),
            contact: 4.0,
            near: 0.0,
            falloff: Falloff::default(),
            guarantee: RecordGuarantee::default(),
            memory: None,
            scene: [Vec3::NEG_ONE, Vec3::ONE],
            threads: 1,
            seed: 0,
        }
    }
}

/// A choice that is not legal.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum RecordsError {
    /// No room for a record, or for more than can be numbered.
    Count(u32),
    /// A size of maps that is not a power of two from 8 to 1024.
    Resolution(u32),
    /// A weight outside 0 to 1.
    Alpha(f32),
    /// A length that is negative or not finite.
    Near(f32),
    /// The same of [`RecordSettings::contact`].
    Contact(f32),
    /// A scene that is empty or not finite.
    Scene,
    /// More records than the memory holds.
    Memory {
        /// Bytes that so many records take.
        bytes: u64,
        /// Bytes that they may take.
        limit: u64,
        /// The largest number of records that fits.
        fits: u64,
    },
}

impl std::fmt::Display for RecordsError {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Count(count) => write!(f, "count={count}: 1 to 65534 records are possible"),
            Self::Resolution(resolution) => write!(
                f,
                "resolution={resolution}: a power of two from 8 to 1024 is possible"
            ),
            Self::Alpha(alpha) => write!(f, "alpha={alpha}: 0 to 1 is possible"),
            Self::Near(near) => write!(f, "near={near}: a length of 0 or more is possible"),
            Self::Contact(contact) => {
                write!(f, "contact={contact}: a factor of 0 or more is possible")
            }
            Self::Scene => write!(
                f,
                "the scene has no size that records could have a place in"
            ),
            Self::Memory { bytes, limit, fits } => write!(
                f,
                "the records take {bytes} bytes of the {limit} that are allowed: count={fits} is the largest that fits"
            ),
        }
    }
}

impl std::error::Error for RecordsError {}

/// Bytes of bookkeeping a record, beside its texels.
pub(super) const BOOKKEEPING: u64 = 512 + super::cells::BYTES_A_RECORD;

impl RecordSettings {
    /// Bytes of one record.
    pub fn record_bytes(&self) -> u64 {
        let texels = u64::from(self.resolution) * u64::from(self.resolution);
        texels * if self.surfaces { 8 } else { 2 } + BOOKKEEPING
    }

    pub(super) fn check(&self) -> Result<(), RecordsError> {
        if !(1..=65534).contains(&self.capacity) {
            return Err(RecordsError::Count(self.capacity));
        }
        if !self.resolution.is_power_of_two() || !(8..=1024).contains(&self.resolution) {
            return Err(RecordsError::Resolution(self.resolution));
        }
        if !(0.0..=1.0).contains(&self.alpha) {
            return Err(RecordsError::Alpha(self.alpha));
        }
        if !(self.near >= 0.0 && self.near.is_finite()) {
            return Err(RecordsError::Near(self.near));
        }
        if !(self.contact >= 0.0 && self.contact.is_finite()) {
            return Err(RecordsError::Contact(self.contact));
        }
        let [low, high] = self.scene;
        if !low.is_finite() || !high.is_finite() || low.cmpgt(high).any() || low == high {
            return Err(RecordsError::Scene);
        }
        let bytes = u64::from(self.capacity) * self.record_bytes();
        if let Some(limit) = self.memory
            && bytes > limit
        {
            return Err(RecordsError::Memory {
                bytes,
                limit,
                fits: limit / self.record_bytes(),
            });
        }
        Ok(())
    }
}
