//! Directions above a surface as a square of texels.
//!
//! `theta` in `[0, pi]` is the angle from a pole *in the tangent plane*, `phi` in `[0, pi]` the angle around it, with the surface's normal
//! at `theta = phi = pi / 2`: `w = (sin t cos p, sin t sin p, cos t)` in the axes side, normal, pole. Nothing wraps, and
//! the square's rim is the horizon.

use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::OnceLock;

/// Smallest and largest number of texels along a side of a map.
pub(super) const SIDES: std::ops::RangeInclusive<u32> = 16..=1024;

/// The axes of a hemisphere of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hemisphere {
    /// Unit vector in the tangent plane, across the pole.
    pub side: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Unit vector in the tangent plane: where `theta` is 0.
    pub pole: Vec3,
}

impl Hemisphere {
    /// The hemisphere about a unit normal whose pole lies as close to `along` as may be.
    pub fn new(normal: Vec3, along: Vec3) -> Self {
        let level = along - normal * along.dot(normal);
        // A direction too close to the normal says nothing about the pole.
        let pole = if level.length_squared() > 1e-6 * along.length_squared() {
            level.normalize()
        } else {
            normal.any_orthonormal_vector()
        };
        Self {
            side: normal.cross(pole),
            normal,
            pole,
        }
    }

    /// The direction of a texel's centre in the axes side, normal, pole. `side` is a power of two from 16 to 1024.
    pub fn texel(side: u32, row: usize, column: usize) -> Vec3 {
        Grid::of(side).direction(row, column)
    }

    /// From world space to the axes side, normal, pole.
    #[inline]
    pub fn to_local(&self, w: Vec3) -> Vec3 {
        Vec3::new(self.side.dot(w), self.normal.dot(w), self.pole.dot(w))
    }

    /// From the axes side, normal, pole to world space.
    #[inline]
    pub fn to_world(&self, w: Vec3) -> Vec3 {
        self.side * w.x + self.normal * w.y + self.pole * w.z
    }
}

/// The arc cosine of a number that is clamped to `[-1, 1]`, wrong by less than 1e-6: a polynomial (Abramowitz & Stegun 1964, 4.4.46) that vector units
/// evaluate as they stand.
#[inline(always)]
pub fn acos(x: f32) -> f32 {
    const C: [f32; 8] = [
        FRAC_PI_2,
        -0.214_598_8,
        0.088_978_99,
        -0.050_174_305,
        0.030_891_88,
        -0.017_088_126,
        0.006_670_09,
        -0.001_262_491_1,
    ];
    let a = x.abs();
    let a = if a < 1.0 { a } else { 1.0 };
    let mut p = C[7];
    for c in C[..7].iter().rev() {
        p = p * a + c;
    }
    let r = (1.0 - a).sqrt() * p;
    // Mirrored at a right angle for negative numbers, without a branch.
    FRAC_PI_2 - (FRAC_PI_2 - r).copysign(x)
}

/// `(theta, phi)` of a local unit vector; below the horizon `phi` leaves `[0, pi]` on the nearer side.
#[inline]
pub(super) fn angles(local: Vec3) -> (f32, f32) {
    let theta = acos(local.z);
    let level = (local.x * local.x + local.y * local.y).sqrt();
    let phi = acos(local.x / level.max(f32::MIN_POSITIVE));
    let phi = match (local.y < 0.0, local.x < 0.0) {
        (false, _) => phi,
        (true, false) => -phi,
        (true, true) => 2.0 * PI - phi,
    };
    (theta, phi)
}

/// Sines and cosines of the texel centres of a map.
#[derive(Debug)]
pub(super) struct Grid {
    /// Texels along a side.
    pub(super) side: usize,
    /// Of the centres `(i + 0.5) pi / side`, for `theta` and `phi` alike.
    pub(super) sin: Vec<f32>,
    pub(super) cos: Vec<f32>,
    /// Of the lines between them, `(i + 1) pi / side`.
    pub(super) sin_between: Vec<f32>,
    pub(super) cos_between: Vec<f32>,
    /// `cos(k pi / side)` at `k + side`, for `k` from `-side` to `side`.
    pub(super) cos_whole: Vec<f32>,
    /// `cos((k + 0.5) pi / side)` at `k + side`.
    pub(super) cos_half: Vec<f32>,
    /// Angle of every texel's centre to the horizon, row after row.
    pub(super) horizon: Vec<f32>,
}

impl Grid {
    fn new(side: usize) -> Self {
        let spacing = std::f64::consts::PI / side as f64;
        let table = |count: usize, from: f64, f: fn(f64) -> f64| {
            (0..count)
                .map(|i| f((i as f64 + from) * spacing) as f32)
                .collect()
        };
        let half_turn = side as f64;
        let centre = |i: usize| ((i as f64 + 0.5) * spacing).sin();
        let heights = (0..side * side).map(|i| centre(i / side) * centre(i % side));
        Self {
            side,
            sin: table(side, 0.5, f64::sin),
            cos: table(side, 0.5, f64::cos),
            sin_between: table(side - 1, 1.0, f64::sin),
            cos_between: table(side - 1, 1.0, f64::cos),
            cos_whole: table(2 * side + 1, -half_turn, f64::cos),
            cos_half: table(2 * side + 1, 0.5 - half_turn, f64::cos),
            horizon: heights.map(|h| h.asin() as f32).collect(),
        }
    }

    /// The tables of maps with `side` texels along a side, a power of two within [`SIDES`].
    pub(super) fn of(side: u32) -> &'static Self {
        static GRIDS: [OnceLock<Grid>; 11] = [const { OnceLock::new() }; 11];
        let slot = side.trailing_zeros() as usize;
        GRIDS[slot].get_or_init(|| Self::new(1 << slot))
    }

    /// The local direction of a texel's centre.
    #[inline]
    pub(super) fn direction(&self, row: usize, column: usize) -> Vec3 {
        let sin = self.sin[row];
        Vec3::new(
            sin * self.cos[column],
            sin * self.sin[column],
            self.cos[row],
        )
    }

    /// The texel that a local direction above the horizon falls into: row, column.
    #[inline]
    pub(super) fn texel(&self, local: Vec3) -> (usize, usize) {
        let (theta, phi) = angles(local);
        let scale = self.side as f32 / PI;
        let index = |angle: f32| ((angle * scale) as usize).min(self.side - 1);
        (index(theta), index(phi))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axes_are_right_handed_and_local_is_inverse() {
        let normal = Vec3::new(0.3, 0.8, -0.5).normalize();
        for along in [Vec3::X, normal, Vec3::ZERO, Vec3::new(-2.0, 0.1, 0.4)] {
            let h = Hemisphere::new(normal, along);
            assert!((h.side.cross(h.normal) - h.pole).length() < 1e-5);
            let w = Vec3::new(0.1, -0.7, 0.7);
            assert!((h.to_world(h.to_local(w)) - w).length() < 1e-5);
        }
    }

    #[test]
    fn the_polynomial_is_the_arc_cosine() {
        for i in -20_000..=20_000 {
            let x = f64::from(i) / 20_000.0;
            let error = f64::from(acos(x as f32)) - f64::from(x as f32).acos();
            assert!(error.abs() < 1e-6, "{x}: {error}");
        }
    }

    #[test]
    fn texels_hold_their_centres() {
        for side in [16, 64, 256] {
            let grid = Grid::of(side);
            for row in 0..side as usize {
                for column in 0..side as usize {
                    assert_eq!(grid.texel(grid.direction(row, column)), (row, column));
                }
            }
        }
    }

    #[test]
    fn solid_angles_add_up_to_the_hemisphere() {
        let grid = Grid::of(64);
        let cell = (PI / 64.0).powi(2);
        let sum: f32 = grid.sin.iter().map(|sin| sin * cell * 64.0).sum();
        assert!((sum - 2.0 * PI).abs() < 1e-3);
    }

    #[test]
    fn the_horizon_is_the_rim() {
        let grid = Grid::of(32);
        let flat = Vec3::new(0.6, 1e-6, 0.8);
        assert_eq!(grid.texel(flat).1, 0);
        assert_eq!(grid.texel(Vec3::new(-flat.x, flat.y, flat.z)).1, 31);
        let (_, below) = angles(Vec3::new(0.6, -0.1, 0.8));
        assert!(below < 0.0 && below > -0.5);
    }
}
