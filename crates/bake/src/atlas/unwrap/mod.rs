//! Cutting a surface into charts, pieces that can be laid flat.
//!
//! [`Projection`] is the default: charts grow over triangles that face alike and are projected along their mean normal. A million
//! triangles a second, with a stretch of at most 1.5 or so. [`Conformal`] leaves it to the crate `uvunwrap` (least squares conformal maps
//! and as-rigid-as-possible refinement): fewer charts with less distortion on curved things, at a hundredth of the speed.

mod conformal;
mod kept;
mod overlap;
mod projection;
mod topology;

pub(crate) use overlap::overlap_of;
pub(crate) use topology::neighbours;

pub use conformal::Conformal;
pub use kept::Kept;
pub use projection::Projection;

use glam::{Vec2, Vec3};

/// What is to be laid flat.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Vertices, in metres of the world (any rotation of it).
    pub positions: &'a [Vec3],
    /// Vertex indices.
    pub triangles: &'a [[u32; 3]],
    /// Texels a metre: what is smaller than a texel is not worth a chart of its own.
    pub texels_per_metre: f32,
}

/// A surface laid flat, chart by chart; charts do not know of each other's place yet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Charts {
    /// The chart of every triangle; [`Layout::NO_CHART`](super::Layout::NO_CHART) if it has no area.
    pub of: Vec<u32>,
    /// The corners of every triangle in its chart, metres.
    pub corners: Vec<[Vec2; 3]>,
    /// Number of charts.
    pub count: u32,
}

/// Why a surface cannot be laid flat.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnwrapError {
    /// No triangle has an area.
    #[error("no triangle has an area")]
    NoArea,
    /// The library said so.
    #[error("{0}")]
    Library(String),
}

/// A way to cut surfaces into charts.
pub trait Unwrap: Sync {
    /// Cuts and flattens. No two triangles of a chart overlap by more than a part of a texel. The same surface gives the same charts.
    ///
    /// # Errors
    /// [`UnwrapError`] if nothing can be laid flat.
    fn charts(&self, surface: &Surface) -> Result<Charts, UnwrapError>;
}

/// Twice the area times the unit normal of a triangle, zero if it has no useful area.
pub(super) fn cross(positions: &[Vec3], triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|i| positions[i as usize]);
    let (u, v) = (b - a, c - a);
    let cross = u.cross(v);
    // A triangle thinner than the rounding of its own edges is a line.
    let longest = u
        .length_squared()
        .max(v.length_squared())
        .max((c - b).length_squared());
    if cross.is_finite() && cross.length() > 1e-6 * longest {
        cross
    } else {
        Vec3::ZERO
    }
}
