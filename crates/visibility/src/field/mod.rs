//! Visibility as a field of angular distances: what a point sees in *every* direction, so that light from a whole sky can be asked about.
//!
//! Wang, Pan, Han, Chen, Bao 2013, "Parallel and adaptive visibility sampling for rendering dynamic scenes with spatially-varying reflectance". A few
//! points on the surfaces get a map of the directions that are free ([`MapSampler`]: one bit a texel, rays at its boundaries alone),
//! turned into the signed angle to the nearest boundary ([`DistanceTransform`], exact and linear in the texels). Distances can be
//! interpolated where bits cannot: between two points a shadow edge moves instead of fading. Light and reflection are
//! spherical Gaussians ([`SphericalGaussian`]), and what of one is visible follows from the distance at its centre ([`VisibleShare`]), of a
//! broad one from harmonics ([`BroadShare`]), or from an integral over cells of the field ([`visible_integral`]).
//!
//! * [`Hemisphere`]: the directions above a point as a square, [`VisibilityMap`], [`DistanceField`];
//! * [`harmonics`] and [`visibility_error`]: where points are needed (Eq. 7);
//! * [`Metric`] and [`weight`]: which points speak for a place (Eqs. 6 and 8).
//!
//! Wrong tool: light from near by (a map does not know how far its occluders are; trace rays to lamps), mirrors (a texel is 1.4 degrees wide
//! at 128 texels), and points that are used once (a map costs a thousand rays or more).

mod broad;
mod cells;
mod distance;
mod gaussian;
mod harmonics;
mod hemisphere;
mod interpolate;
mod map;
mod sample;
mod transform;

#[cfg(test)]
mod tests;

pub use broad::{BroadShare, bands_at_eight};
pub use cells::{Distances, Weight, visible_integral};
pub use distance::DistanceField;
pub use gaussian::{SphericalGaussian, VisibleShare};
pub use harmonics::{Harmonics, harmonics, visibility_error};
pub use hemisphere::{Hemisphere, acos};
pub use interpolate::{Metric, Sites, weight};
pub use map::{MapBlock, VisibilityMap};
pub use sample::{Hint, MapSampler, MapSampling};
pub use transform::DistanceTransform;
