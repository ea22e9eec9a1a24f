//! Between sample points: which of them speak for a shading point, and how much.
//!
//! Eq. 8 weighs points by one over their geometric distance, Eq. 6. As printed the weights do not reach 0 where the search ends, so
//! that points pop in and out, and they let the far side of a cloth speak. Here a weight falls to 0 at the point's radius, and points
//! that face away have none. The distance out of the surface's plane counts more than that within it: what a table top
//! sees says nothing about the floor below.

use glam::Vec3;

/// How much more a step out of the plane counts than one within it.
const OUT_OF_PLANE: f32 = 6.0;

/// The geometric distance of surface points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// Weight of positions, per metre: 0.1 to 0.5 over the scene's size in the paper. Must not change within a sequence of pictures.
    pub per_metre: f32,
}

impl Metric {
    /// Eq. 6: `alpha |x - y| + sqrt(2 - 2 n.m)`, with steps out of either plane counted more. Infinite for points that face away from each other.
    #[inline]
    pub fn distance(&self, x: Vec3, n: Vec3, y: Vec3, m: Vec3) -> f32 {
        let alike = n.dot(m);
        if alike <= 0.0 {
            return f32::INFINITY;
        }
        let step = y - x;
        let out = 0.5 * (step.dot(n).abs() + step.dot(m).abs());
        let turn = (2.0 - 2.0 * alike).max(0.0).sqrt();
        self.per_metre * (step.length() + (OUT_OF_PLANE - 1.0) * out) + turn
    }
}

/// The weight of a sample point at a distance, of one whose radius of influence is given: 0 from there on, and growing without corners
/// towards the point. Finite even at the point itself.
#[inline]
pub fn weight(distance: f32, radius: f32) -> f32 {
    // A point of its own is worth as much as one within a hundredth of the radius.
    let ratio = distance.max(0.01 * radius);
    if ratio < radius {
        let w = radius / ratio - 1.0;
        w * w
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const METRIC: Metric = Metric { per_metre: 0.5 };

    #[test]
    fn far_sides_of_cloth_are_infinitely_far() {
        let d = METRIC.distance(
            Vec3::ZERO,
            Vec3::Y,
            Vec3::new(0.0, -0.001, 0.0),
            Vec3::NEG_Y,
        );
        assert_eq!(d, f32::INFINITY);
        assert_eq!(weight(d, 1.0), 0.0);
    }

    #[test]
    fn planes_below_are_farther_than_neighbours() {
        let beside = METRIC.distance(Vec3::ZERO, Vec3::Y, Vec3::X, Vec3::Y);
        let below = METRIC.distance(Vec3::ZERO, Vec3::Y, Vec3::NEG_Y, Vec3::Y);
        assert_eq!(beside, 0.5);
        assert!(below > 4.0 * beside);
    }

    #[test]
    fn the_distance_is_symmetric() {
        let (x, n) = (
            Vec3::new(0.1, 0.2, 0.3),
            Vec3::new(0.1, 1.0, 0.2).normalize(),
        );
        let (y, m) = (
            Vec3::new(0.4, 0.1, 0.0),
            Vec3::new(-0.2, 1.0, 0.1).normalize(),
        );
        let (a, b) = (METRIC.distance(x, n, y, m), METRIC.distance(y, m, x, n));
        assert!((a - b).abs() < 1e-6);
    }

    #[test]
    fn weights_fall_to_nothing_at_the_radius_without_a_step() {
        let mut last = weight(0.0, 2.0);
        assert!(last.is_finite());
        for i in 1..=400 {
            let w = weight(i as f32 * 0.005, 2.0);
            assert!(w <= last);
            last = w;
        }
        assert_eq!(last, 0.0);
        assert!(weight(1.999, 2.0) < 1e-5);
    }
}
