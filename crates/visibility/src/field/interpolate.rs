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
    #[inline(always)]
    pub fn distance(&self, x: Vec3, n: Vec3, y: Vec3, m: Vec3) -> f32 {
        let alike = n.dot(m);
        let step = y - x;
        let out = 0.5 * (step.dot(n).abs() + step.dot(m).abs());
        let turn = (2.0 - 2.0 * alike).max(0.0).sqrt();
        let distance = self.per_metre * (step.length() + (OUT_OF_PLANE - 1.0) * out) + turn;
        if alike > 0.0 { distance } else { f32::INFINITY }
    }
}

/// Surface points by component, for many distances at a time.
#[derive(Clone, Debug, Default)]
pub struct Sites {
    position: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
}

impl Sites {
    /// Adds a point with its unit normal.
    pub fn push(&mut self, position: Vec3, normal: Vec3) {
        for (axis, value) in position.to_array().into_iter().enumerate() {
            self.position[axis].push(value);
        }
        for (axis, value) in normal.to_array().into_iter().enumerate() {
            self.normal[axis].push(value);
        }
    }

    /// Forgets all points.
    pub fn clear(&mut self) {
        self.position.iter_mut().for_each(Vec::clear);
        self.normal.iter_mut().for_each(Vec::clear);
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.position[0].len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Metric {
    /// [`distance`](Self::distance) from one point to many.
    pub fn distances(&self, x: Vec3, n: Vec3, others: &Sites, out: &mut Vec<f32>) {
        out.clear();
        out.resize(others.len(), 0.0);
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the machine has the instructions.
            return unsafe { self.distances_avx2(x, n, others, out) };
        }
        self.all_distances(x, n, others, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn distances_avx2(&self, x: Vec3, n: Vec3, others: &Sites, out: &mut [f32]) {
        self.all_distances(x, n, others, out);
    }

    #[inline(always)]
    fn all_distances(&self, x: Vec3, n: Vec3, others: &Sites, out: &mut [f32]) {
        let count = out.len();
        let [px, py, pz] = others.position.each_ref().map(|column| &column[..count]);
        let [nx, ny, nz] = others.normal.each_ref().map(|column| &column[..count]);
        for k in 0..count {
            let y = Vec3::new(px[k], py[k], pz[k]);
            out[k] = self.distance(x, n, y, Vec3::new(nx[k], ny[k], nz[k]));
        }
    }
}

/// The weight of a sample point at a distance, of one whose radius of influence is given: 0 from there on, and growing without corners
/// towards the point, where it is finite. Nearer than a third of the radius points count by their distances, not by their radii.
#[inline(always)]
pub fn weight(distance: f32, radius: f32) -> f32 {
    let rest = (1.0 - distance / radius).max(0.0);
    let blunt = 0.3 * radius;
    rest * rest / (distance * distance + blunt * blunt)
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
    fn many_distances_are_one_by_one() {
        let mut sites = Sites::default();
        let place = |k: f32| {
            (
                Vec3::new(k.sin(), k * 0.01, k.cos()),
                Vec3::new(k.cos(), 1.0, -0.3).normalize(),
            )
        };
        (0..37).for_each(|k| {
            let (y, m) = place(k as f32);
            sites.push(y, m);
        });
        let (x, n) = place(3.5);
        let mut out = Vec::new();
        METRIC.distances(x, n, &sites, &mut out);
        for (k, found) in out.iter().enumerate() {
            let (y, m) = place(k as f32);
            assert_eq!(*found, METRIC.distance(x, n, y, m));
        }
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
        assert_eq!(weight(f32::INFINITY, 2.0), 0.0);
    }
}
