//! Signed angular distances over a hemisphere.

use super::gaussian::truncate;
use super::hemisphere::{Hemisphere, acos, angles};
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};

/// For each direction above a surface point the angle to the nearest edge of visibility: positive where the direction is free.
///
/// Angles are stored in 16 bits, evenly over `[-pi, pi]`: a step is 1e-4 rad everywhere, where a half float's would be 1e-3 at 1 rad, and
/// reading takes one multiplication on any processor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DistanceField {
    side: u32,
    values: Vec<i16>,
}

/// Radians of a step.
const STEP: f32 = PI / i16::MAX as f32;

impl DistanceField {
    #[inline(always)]
    pub(super) fn encode(distance: f32) -> i16 {
        // Adding a large number rounds and leaves the whole number in the lowest bits: no conversion that checks its range.
        const MAGIC: f32 = 12_582_912.0;
        (distance * (1.0 / STEP) + MAGIC).to_bits() as i16
    }

    /// Its numbers, row after row, once it has `side` texels along a side.
    pub(super) fn values_mut(&mut self, side: u32) -> &mut [i16] {
        self.side = side;
        self.values.resize(side as usize * side as usize, 0);
        &mut self.values
    }

    /// Texels along a side.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// Bytes that the distances take.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.values[..])
    }

    /// The distance at a texel's centre, radians.
    ///
    /// # Panics
    /// If it lies outside.
    #[inline]
    pub fn get(&self, row: usize, column: usize) -> f32 {
        f32::from(self.values[row * self.side as usize + column]) * STEP
    }

    /// The distance in a world-space direction, bilinear between texel centres.
    ///
    /// Below the horizon, where no light comes from, it goes on falling: by the angle to the horizon, below what the rim says.
    pub fn at(&self, hemisphere: &Hemisphere, w: Vec3) -> f32 {
        let local = hemisphere.to_local(w);
        if local.y < 0.0 {
            let below = local.y.max(-1.0).asin();
            let level = Vec3::new(local.x, 0.0, local.z);
            let rim = level.try_normalize().unwrap_or(Vec3::X);
            return self.inside(rim).min(0.0) + below;
        }
        self.inside(local)
    }

    /// [`at`](Self::at) for eight directions, given by component.
    #[inline(always)]
    pub fn at_eight(&self, hemisphere: &Hemisphere, w: &[[f32; 8]; 3]) -> [f32; 8] {
        let side = self.side as usize;
        let (scale, last) = (side as f32 / PI, (side - 1) as f32 - 1e-3);
        let along = |axis: Vec3| -> [f32; 8] {
            std::array::from_fn(|k| axis.x * w[0][k] + axis.y * w[1][k] + axis.z * w[2][k])
        };
        let (x, y, z) = (
            along(hemisphere.side),
            along(hemisphere.normal),
            along(hemisphere.pole),
        );
        let (mut rows, mut columns, mut below) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        for k in 0..8 {
            // Below the horizon the rim under the direction speaks. Without branches: vector units take eight at a time.
            let level = if y[k] > 0.0 { y[k] } else { 0.0 };
            let flat = x[k] * x[k] + level * level;
            let theta = acos(z[k] / (flat + z[k] * z[k] + 1e-24).sqrt());
            let phi = acos(x[k] / (flat + 1e-24).sqrt());
            below[k] = FRAC_PI_2 - acos(if y[k] < 0.0 { y[k] } else { 0.0 });
            let place = |angle: f32| {
                let x = angle * scale - 0.5;
                let x = if x > 0.0 { x } else { 0.0 };
                if x < last { x } else { last }
            };
            (rows[k], columns[k]) = (place(theta), place(phi));
        }
        let (mut at, mut u, mut v) = ([0_u32; 8], [0.0; 8], [0.0; 8]);
        for k in 0..8 {
            let (row, column) = (truncate(rows[k]), truncate(columns[k]));
            (v[k], u[k]) = (rows[k] - row as f32, columns[k] - column as f32);
            at[k] = row * self.side + column;
        }
        let upper = self.pairs(&at, 0);
        let lower = self.pairs(&at, side);
        let mut out = [0.0; 8];
        for k in 0..8 {
            let blend = |pair: u32| {
                let (a, b) = ((pair << 16) as i32 >> 16, pair as i32 >> 16);
                a as f32 + (b - a) as f32 * u[k]
            };
            let (upper, lower) = (blend(upper[k]), blend(lower[k]));
            let inside = (upper + (lower - upper) * v[k]) * STEP;
            let most = if below[k] < 0.0 { 0.0 } else { PI };
            let inside = if inside < most { inside } else { most };
            out[k] = inside + below[k];
        }
        out
    }

    /// The numbers at these places and after them, the first in the low half.
    #[inline(always)]
    fn pairs(&self, at: &[u32; 8], behind: usize) -> [u32; 8] {
        let values = &self.values[behind..];
        std::array::from_fn(|k| {
            let at = at[k] as usize;
            match values.get(at..at + 2) {
                Some(pair) => u32::from(pair[0] as u16) | u32::from(pair[1] as u16) << 16,
                None => 0,
            }
        })
    }

    fn inside(&self, local: Vec3) -> f32 {
        let side = self.side as usize;
        let (theta, phi) = angles(local);
        let scale = side as f32 / PI;
        let place = |angle: f32| {
            let x = (angle * scale - 0.5).clamp(0.0, (side - 1) as f32);
            let i = (x as usize).min(side - 2);
            (i, x - i as f32)
        };
        let ((row, y), (column, x)) = (place(theta), place(phi));
        let along = |row: usize| {
            let a = self.get(row, column);
            a + (self.get(row, column + 1) - a) * x
        };
        let (upper, lower) = (along(row), along(row + 1));
        upper + (lower - upper) * y
    }

    /// The distance of a direction at a height (sine of elevation) over an empty surface: the angle to the horizon.
    #[inline]
    pub fn of_horizon(height: f32) -> f32 {
        if height.abs() < 1.0 {
            height.asin()
        } else {
            FRAC_PI_2.copysign(height)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DistanceTransform, VisibilityMap};
    use super::*;

    #[test]
    fn eight_at_once_are_eight() {
        let h = Hemisphere::new(Vec3::new(0.5, 0.7, -0.2).normalize(), Vec3::X);
        let map = VisibilityMap::from_fn(64, |w| (w.x * 5.0).sin() + w.z > 0.2);
        let field = DistanceTransform::default().transform(&map);
        for i in 0..400 {
            let w: [Vec3; 8] = std::array::from_fn(|k| {
                let a = (i * 8 + k) as f32;
                let z = 1.0 - 2.0 * ((a + 0.5) / 3200.0);
                let r = (1.0 - z * z).sqrt();
                Vec3::new(r * (a * 2.4).cos(), r * (a * 2.4).sin(), z)
            });
            let columns = [w.map(|w| w.x), w.map(|w| w.y), w.map(|w| w.z)];
            let eight = field.at_eight(&h, &columns);
            for (w, got) in w.iter().zip(eight) {
                let one = field.at(&h, *w);
                assert!((one - got).abs() < 2e-4, "{w}: {one} {got}");
            }
        }
    }

    #[test]
    fn angles_survive_sixteen_bits() {
        for i in -1000..=1000 {
            let d = i as f32 * PI / 1000.0;
            assert!((f32::from(DistanceField::encode(d)) * STEP - d).abs() <= 0.51 * STEP);
        }
    }

    /// An empty hemisphere in a tilted frame: the angle to the horizon, above and below.
    #[test]
    fn of_an_empty_hemisphere_it_is_the_elevation() {
        let h = Hemisphere::new(Vec3::new(0.5, 0.7, -0.2).normalize(), Vec3::X);
        let field = DistanceTransform::default().transform(&VisibilityMap::new(64, true));
        for i in 0..500 {
            let a = i as f32 * 0.618_034;
            let z = 1.0 - 2.0 * ((i as f32 + 0.5) / 500.0);
            let r = (1.0 - z * z).sqrt();
            let w = Vec3::new(r * (a * 9.0).cos(), r * (a * 9.0).sin(), z);
            let error = field.at(&h, w) - DistanceField::of_horizon(h.normal.dot(w));
            // Half a texel at the rim, where there is no centre to interpolate from.
            assert!(error.abs() < 0.04, "{w}: {error}");
        }
    }
}
