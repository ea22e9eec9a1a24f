//! The integral of a lobe over what is visible, by cells of the field (Eq. 5).
//!
//! The hemisphere's square is cut into a quadtree. A cell that is farther from every edge than it is wide is free or blocked as a whole;
//! others are cut, down to the texels, until the field within is as good as bilinear. There the boundary is the line where the
//! bilinear distance is 0: at each of a few `phi` the distance is linear in `theta`, and the part of the cell where it is positive is an
//! interval with closed ends. That covers all cases that a cell may be in: lit below the line, lit above, two lines (a saddle), and
//! lines that leave through the cell's top or bottom. (The print integrates below one line only.)
//!
//! Exact up to the field's texels and the quadrature, and a hundred times as slow as [`VisibleShare`](super::VisibleShare).

use super::distance::DistanceField;
use super::hemisphere::Hemisphere;
use glam::Vec3;
use std::f32::consts::PI;

/// Nodes and weights of Gauss' rule with three points on `[0, 1]`.
const GAUSS: [(f32, f32); 3] = [
    (0.112_701_67, 0.277_777_8),
    (0.5, 0.444_444_45),
    (0.887_298_35, 0.277_777_8),
];

/// What of a lobe is negligible, relative to its amplitude.
const NEGLIGIBLE: f32 = 1e-6;

/// Distances at the texels of a hemisphere: a [`DistanceField`], or one that is interpolated from several.
pub trait Distances {
    /// Texels along a side, a power of two.
    fn side(&self) -> u32;
    /// The distance at a texel's centre, radians.
    fn get(&self, row: usize, column: usize) -> f32;
}

impl Distances for DistanceField {
    fn side(&self) -> u32 {
        Self::side(self)
    }

    fn get(&self, row: usize, column: usize) -> f32 {
        Self::get(self, row, column)
    }
}

/// What a lobe is multiplied with before it is integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// Nothing.
    One,
    /// The cosine to the hemisphere's normal.
    Cosine,
}

/// The integral over the free directions of a lobe of amplitude 1 in world space, times the weight.
pub fn visible_integral(
    field: &impl Distances,
    hemisphere: &Hemisphere,
    axis: Vec3,
    sharpness: f32,
    weight: Weight,
) -> f32 {
    let cells = Cells {
        field,
        axis: hemisphere.to_local(axis),
        sharpness,
        finest: field.side(),
        cosine: weight == Weight::Cosine,
    };
    cells.integrate(0, 0, field.side())
}

struct Cells<'a, D> {
    field: &'a D,
    axis: Vec3,
    sharpness: f32,
    finest: u32,
    cosine: bool,
}

fn direction(theta: f32, phi: f32) -> Vec3 {
    let ((st, ct), (sp, cp)) = (theta.sin_cos(), phi.sin_cos());
    Vec3::new(st * cp, st * sp, ct)
}

impl<D: Distances> Cells<'_, D> {
    /// Of a cell with its first texel and its side in texels.
    fn integrate(&self, row: u32, column: u32, size: u32) -> f32 {
        let texel = PI / self.finest as f32;
        let (theta, phi) = (row as f32 * texel, column as f32 * texel);
        let width = size as f32 * texel;
        // No point of the cell is farther from its centre than half its diagonal, were it at the widest place.
        let reach = width * std::f32::consts::FRAC_1_SQRT_2;
        let centre = direction(theta + 0.5 * width, phi + 0.5 * width);
        let angle = self.axis.dot(centre).clamp(-1.0, 1.0).acos();
        let nearest = (angle - reach).max(0.0);
        if (self.sharpness * (nearest.cos() - 1.0)).exp() < NEGLIGIBLE {
            return 0.0;
        }
        let wide = width * self.sharpness.sqrt() > 0.7 || width > 0.3;
        if size == 1 {
            return self.texel(row, column);
        }
        // A texel more, since the field is known at texel centres.
        let half = size / 2;
        let distance = self
            .field
            .get((row + half) as usize, (column + half) as usize);
        if !wide && distance.abs() > reach + texel {
            return if distance > 0.0 {
                self.whole(theta, phi, width)
            } else {
                0.0
            };
        }
        if distance < -(reach + texel) {
            return 0.0;
        }
        [(0, 0), (0, half), (half, 0), (half, half)]
            .iter()
            .map(|(down, right)| self.integrate(row + down, column + right, half))
            .sum()
    }

    /// The lobe times its weight times `sin theta`.
    fn value(&self, theta: f32, phi: f32) -> f32 {
        let w = direction(theta, phi);
        let weight = if self.cosine { w.y.max(0.0) } else { 1.0 };
        (self.sharpness * (self.axis.dot(w) - 1.0)).exp() * weight * theta.sin()
    }

    fn whole(&self, theta: f32, phi: f32, width: f32) -> f32 {
        let mut sum = 0.0;
        for (x, wx) in GAUSS {
            for (y, wy) in GAUSS {
                sum += wx * wy * self.value(theta + y * width, phi + x * width);
            }
        }
        sum * width * width
    }

    /// One texel: the field at its corners is the mean of the centres around.
    fn texel(&self, row: u32, column: u32) -> f32 {
        let last = self.finest - 1;
        let corner = |row: u32, column: u32| {
            let rows = [row.saturating_sub(1), row.min(last)];
            let columns = [column.saturating_sub(1), column.min(last)];
            let mut sum = 0.0;
            for r in rows {
                for c in columns {
                    sum += self.field.get(r as usize, c as usize);
                }
            }
            0.25 * sum
        };
        let upper = [corner(row, column), corner(row, column + 1)];
        let lower = [corner(row + 1, column), corner(row + 1, column + 1)];
        let texel = PI / self.finest as f32;
        let (theta, phi) = (row as f32 * texel, column as f32 * texel);
        let mut sum = 0.0;
        for (x, weight) in GAUSS {
            let top = upper[0] + (upper[1] - upper[0]) * x;
            let bottom = lower[0] + (lower[1] - lower[0]) * x;
            let zero = if top == bottom {
                1.0
            } else {
                (top / (top - bottom)).clamp(0.0, 1.0)
            };
            let (from, to) = match (top > 0.0, bottom > 0.0) {
                (true, true) => (0.0, 1.0),
                (true, false) => (0.0, zero),
                (false, true) => (zero, 1.0),
                (false, false) => continue,
            };
            for (y, w) in GAUSS {
                let at = theta + (from + (to - from) * y) * texel;
                sum += weight * w * (to - from) * self.value(at, phi + x * texel);
            }
        }
        sum * texel * texel
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DistanceTransform, SphericalGaussian, VisibilityMap};
    use super::*;

    /// The same integral over the true region, by brute force.
    fn brute(
        hemisphere: &Hemisphere,
        free: impl Fn(Vec3) -> bool,
        axis: Vec3,
        sharpness: f32,
        weight: Weight,
    ) -> f64 {
        let n = 600_000_u32;
        let mut sum = 0.0;
        for i in 0..n {
            let y = (f64::from(i) + 0.5) / f64::from(n);
            let a = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - y * y).sqrt();
            let local = Vec3::new((r * a.cos()) as f32, y as f32, (r * a.sin()) as f32);
            if free(local) {
                let w = hemisphere.to_world(local);
                let weight = if weight == Weight::Cosine { y } else { 1.0 };
                sum += f64::from((sharpness * (axis.dot(w) - 1.0)).exp()) * weight;
            }
        }
        sum * 2.0 * std::f64::consts::PI / f64::from(n)
    }

    fn check(free: impl Fn(Vec3) -> bool + Copy, tolerance: f64) {
        let hemisphere = Hemisphere::new(Vec3::new(0.2, 0.9, 0.3).normalize(), Vec3::X);
        let field = DistanceTransform::default().transform(&VisibilityMap::from_fn(128, free));
        for axis in [
            Vec3::Y,
            Vec3::new(0.7, 0.7, 0.1),
            Vec3::new(-0.8, 0.3, 0.5),
            Vec3::new(0.1, 0.2, -0.9),
        ] {
            let axis = axis.normalize();
            for sharpness in [2.0, 25.0, 200.0] {
                for weight in [Weight::Cosine, Weight::One] {
                    let found = visible_integral(&field, &hemisphere, axis, sharpness, weight);
                    let expected = brute(&hemisphere, free, axis, sharpness, weight);
                    let scale = f64::from(SphericalGaussian::unit_integral(sharpness));
                    let error = (f64::from(found) - expected).abs() / scale;
                    assert!(
                        error < tolerance,
                        "{axis} {sharpness} {weight:?}: {found}, not {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn free_hemispheres() {
        check(|_| true, 0.01);
    }

    #[test]
    fn half_planes_either_way() {
        check(|w| w.x > 0.2 * w.z, 0.01);
        check(|w| w.x < 0.2 * w.z, 0.01);
        check(|w| w.z > 0.1, 0.01);
        check(|w| w.z < 0.1, 0.01);
    }

    /// Checkerboards and stripes: saddles, and lines that leave through tops and bottoms.
    #[test]
    fn saddles_and_stripes() {
        check(|w| (w.x > 0.1) ^ (w.z > -0.1), 0.015);
        check(|w| (w.x * 5.0).sin() * (w.z * 4.0).cos() > 0.1, 0.015);
    }

    #[test]
    fn nothing_free_is_nothing() {
        let field = DistanceTransform::default().transform(&VisibilityMap::new(64, false));
        let hemisphere = Hemisphere::new(Vec3::Y, Vec3::X);
        assert_eq!(
            visible_integral(&field, &hemisphere, Vec3::Y, 10.0, Weight::One),
            0.0
        );
    }
}
