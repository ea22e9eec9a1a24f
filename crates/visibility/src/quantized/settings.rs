//! What a user may choose, and what is legal.

use super::digest::Digest;
use super::table::is_there_memory;
use crate::Class;

/// How far an error may reach, in eye samples across (`C_E`), by kind of light end: answers are shared by patches that hold
/// about `C_E^2` eye samples. Higher: fewer rays, coarser shadows. 0 traces every question of that kind. At least 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorReach {
    /// Point and spot lights: one hard shadow each, errors show most.
    pub point: f32,
    /// Lights in one exact direction.
    pub direction: f32,
    /// Surfaces: area lights, virtual lights, path vertices.
    pub area: f32,
    /// Sampled directions of a sky.
    pub sky: f32,
}

impl ErrorReach {
    /// The same reach for every kind.
    pub fn all(samples: f32) -> Self {
        Self {
            point: samples,
            direction: samples,
            area: samples,
            sky: samples,
        }
    }
}

impl Default for ErrorReach {
    fn default() -> Self {
        Self {
            point: 4.0,
            direction: 4.0,
            area: 14.0,
            sky: 14.0,
        }
    }
}

/// How often a cluster whose neighbours disagree is halved (Popov 2013, section 3.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refine {
    /// `log2 C_E` levels; none where a cluster is no larger than a pixel (`C_E^2` samples a pixel or more), and none
    /// between pairs of surfaces ([`Pairing::Both`]).
    #[default]
    Auto,
    /// This many levels, 1 (no refinement: Algorithm 1) to 16.
    Levels(u32),
}

/// Who remembers together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Share {
    /// Every tile of every pass remembers for itself: the picture does not depend on the number of threads.
    #[default]
    Tile,
    /// Every thread remembers what it was asked. Depends on who does which tile.
    Thread,
    /// All threads remember together: the fewest rays. Depends on timing.
    All,
    /// Every tile remembers for itself, and knows what all tiles have learnt in earlier pictures of a sequence about lights
    /// that many eyes share (single questions are as with `Tile`). Does not depend on the number of threads.
    Frames,
}

/// What answers may be trusted for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Guarantee {
    /// Errors reach no farther than [`ErrorReach`] says: the paper's own.
    #[default]
    Bounded,
    /// Right on average: some answers are checked by a ray, and corrected by as much as the checks are rare.
    Unbiased,
    /// Patches at both ends shrink from pass to pass: progressive pictures converge to the exact one.
    Consistent,
}

impl Guarantee {
    pub(super) fn class(self) -> Class {
        match self {
            Self::Bounded => Class::Bounded,
            Self::Unbiased => Class::Unbiased,
            Self::Consistent => Class::Consistent,
        }
    }
}

/// How the error reach is split between the two ends of a pair of surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pairing {
    /// The eye's patch takes it all, the light's holds one sample (Eq. 7): where light ends are shared by many eyes.
    #[default]
    Eye,
    /// Both patches are of one size (Eq. 6): where both ends are met once, as in bidirectional path tracing.
    Both,
}

/// All choices of [`Quantized`](super::Quantized). [`Default`] is meant to need no change.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantizedSettings {
    /// Reach of errors.
    pub error: ErrorReach,
    /// Orientations of grids along each axis (`C_N`): even, 2 to 64. Higher follows curvature better and shares less.
    pub normals: u32,
    /// How much thinner than wide a voxel is (`C_Z`), 1 to 64. Higher tells parallel surfaces apart and shares less.
    pub slab: f32,
    /// Ratio of neighbouring resolutions (`C_R`), above 1 and up to 4.
    pub resolution_step: f32,
    /// Bytes of each table (of each worker's, unless shared by all): at least 64. Rounded down to a power of two. Single
    /// questions have one, and questions about many lights another, unless tiles remember for themselves.
    pub table_bytes: usize,
    /// Refinement at shadow edges.
    pub refine: Refine,
    /// Who remembers together.
    pub share: Share,
    /// The hash of keys of single questions; those about many lights need no hash a question.
    pub digest: Digest,
    /// What answers may be trusted for.
    pub guarantee: Guarantee,
    /// How pairs of surfaces are measured.
    pub pairing: Pairing,
    /// Samples a pixel of the whole job: what tables shared by all passes see.
    pub samples_per_pixel: u32,
    /// Seed of the checks of [`Guarantee::Unbiased`].
    pub seed: u64,
}

impl Default for QuantizedSettings {
    fn default() -> Self {
        Self {
            error: ErrorReach::default(),
            normals: 4,
            slab: 4.0,
            resolution_step: 1.2,
            table_bytes: 4 << 20,
            refine: Refine::default(),
            share: Share::default(),
            digest: Digest::default(),
            guarantee: Guarantee::default(),
            pairing: Pairing::default(),
            samples_per_pixel: 1,
            seed: 0,
        }
    }
}

/// A choice that is not legal.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum QuantizedError {
    /// An error reach is negative, not finite or above 65536.
    Error(f32),
    /// `normals` is odd or outside 2 to 64.
    Normals(u32),
    /// `slab` is outside 1 to 64.
    Slab(f32),
    /// `resolution_step` is not above 1 and at most 4.
    ResolutionStep(f32),
    /// The table is smaller than 64 bytes.
    TableBytes(usize),
    /// There is not enough memory for a table of that many bytes.
    Memory(usize),
    /// The number of levels is outside 1 to 16.
    Levels(u32),
    /// The bounding sphere is not finite or has no size.
    Bounds,
}

impl std::fmt::Display for QuantizedError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Error(value) => write!(f, "an error of {value} samples: must be 0 to 65536"),
            Self::Normals(value) => {
                write!(
                    f,
                    "{value} orientations: must be an even number from 2 to 64"
                )
            }
            Self::Slab(value) => write!(f, "a slab of {value}: must be 1 to 64"),
            Self::ResolutionStep(value) => {
                write!(
                    f,
                    "a resolution step of {value}: must be above 1 and at most 4"
                )
            }
            Self::TableBytes(value) => write!(f, "a table of {value} bytes: must be at least 64"),
            Self::Memory(value) => write!(f, "no memory for a table of {value} bytes"),
            Self::Levels(value) => write!(f, "{value} levels of refinement: must be 1 to 16"),
            Self::Bounds => write!(f, "the bounding sphere has no finite size"),
        }
    }
}

impl std::error::Error for QuantizedError {}

/// Side of the smallest patches that a consistent job refines to, pixels; half of it at most.
const FINEST: f32 = 0.25;

impl QuantizedSettings {
    pub(super) fn check(&self) -> Result<(), QuantizedError> {
        let ErrorReach {
            point,
            direction,
            area,
            sky,
        } = self.error;
        for error in [point, direction, area, sky] {
            if !(0.0..=65536.0).contains(&error) {
                return Err(QuantizedError::Error(error));
            }
        }
        if !(2..=64).contains(&self.normals) || !self.normals.is_multiple_of(2) {
            return Err(QuantizedError::Normals(self.normals));
        }
        if !(1.0..=64.0).contains(&self.slab) {
            return Err(QuantizedError::Slab(self.slab));
        }
        if !(self.resolution_step > 1.0 && self.resolution_step <= 4.0) {
            return Err(QuantizedError::ResolutionStep(self.resolution_step));
        }
        if self.table_bytes < 64 {
            return Err(QuantizedError::TableBytes(self.table_bytes));
        }
        if !is_there_memory(self.table_bytes) {
            return Err(QuantizedError::Memory(self.table_bytes));
        }
        match self.refine {
            Refine::Levels(levels) if !(1..=16).contains(&levels) => {
                Err(QuantizedError::Levels(levels))
            }
            _ => Ok(()),
        }
    }

    /// Levels that questions with this error reach may be refined to (`C_MSR`), the first included; `samples` of each pixel
    /// remember together.
    pub(super) fn levels(&self, error: f32, samples: f32) -> u32 {
        match self.refine {
            Refine::Levels(levels) => levels,
            Refine::Auto if self.pairing == Pairing::Both => 1,
            Refine::Auto => {
                let paper = (error.log2().ceil() as u32).clamp(1, 16);
                // Side of a patch, pixels.
                let side = error / samples.sqrt();
                if self.guarantee == Guarantee::Consistent {
                    // A consistent job goes on: its error must not jump where patches become smaller than pixels. So levels end
                    // one after the other, when the finest is far below a pixel.
                    let useful = (side / FINEST).log2().floor().clamp(0.0, 15.0) as u32 + 1;
                    useful.min(paper)
                } else if side <= 1.0 {
                    1
                } else {
                    paper
                }
            }
        }
    }
}
