//! Light that arrives anywhere on the film: what paths from the lights bring to the camera.
//!
//! A sample of a pixel belongs to that pixel; a splat may fall on any. Every sample of every pixel traces one light path, and
//! its splats are sums of their own, divided by the number of light paths of the whole picture when the film is developed.
//! So tiles that are ahead of others (a time limit fell between them) do not show.
//!
//! Splats are rare and independent: the variance of their sum is the sum of their squares (Poisson's, up to a share of one
//! over the number of light paths).

use super::{FixedSum, LUMINANCE};
use glam::Vec3;

/// Light that a path from a light brought to a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Column of the pixel.
    pub x: u32,
    /// Row of the pixel, from the top.
    pub y: u32,
    /// Radiance if one light path a pixel is traced.
    pub radiance: Vec3,
}

/// Sums of one pixel's splats: red, green, blue, squared luminance.
pub(super) type SplatSums = [FixedSum; 4];

pub(super) fn add(sums: &mut SplatSums, radiance: Vec3) {
    let luminance = f64::from(LUMINANCE.dot(radiance));
    let [r, g, b] = radiance.to_array().map(f64::from);
    for (sum, term) in sums.iter_mut().zip([r, g, b, luminance * luminance]) {
        sum.add(term);
    }
}
