//! A triangle as a light needs it: a corner, two edges, the front normal and the area.

use crate::geometry::WorldTriangle;
use glam::Vec3;

/// A triangle in world space with an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Facet {
    /// First vertex.
    pub(super) origin: Vec3,
    /// From the first vertex to the second.
    pub(super) edge1: Vec3,
    /// From the first vertex to the third.
    pub(super) edge2: Vec3,
    /// Unit geometric normal of the front side.
    pub(super) front: Vec3,
    pub(super) area: f32,
}

impl Facet {
    /// `None` if the triangle has no area or no place that can be computed with.
    pub(super) fn new(triangle: &WorldTriangle) -> Option<Self> {
        let [origin, b, c] = triangle.corners;
        let (edge1, edge2) = (b - origin, c - origin);
        // The cross product of edges shorter than 1e-19 would underflow, so they are scaled to unit size first.
        let size = edge1.abs().max(edge2.abs()).max_element();
        let cross = (edge1 / size).cross(edge2 / size);
        let double_area = cross.length();
        let winding = if triangle.mirrored { -1.0 } else { 1.0 };
        let front = cross * (winding / double_area);
        let area = 0.5 * double_area * size * size;
        (area > 0.0 && area.is_finite() && front.is_finite() && triangle.extent() < super::FARTHEST)
            .then_some(Self {
                origin,
                edge1,
                edge2,
                front,
                area,
            })
    }

    /// The point with these barycentric weights of the second and third vertex.
    pub(super) fn at(&self, u: f32, v: f32) -> Vec3 {
        self.origin + (self.edge1 * u + self.edge2 * v)
    }

    /// The largest absolute coordinate of the vertices: what rounding errors of points on the triangle are relative to.
    pub(super) fn extent(&self) -> f32 {
        let (b, c) = (self.origin + self.edge1, self.origin + self.edge2);
        self.origin.abs().max(b.abs()).max(c.abs()).max_element()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facet(scale: f32, mirrored: bool) -> Option<Facet> {
        Facet::new(&WorldTriangle {
            corners: [Vec3::ZERO, Vec3::X * scale, Vec3::Y * scale],
            mirrored,
        })
    }

    #[test]
    fn any_scale_either_winding() {
        for scale in [1e-18_f32, 1e-5, 1.0, 1e5, 1e15] {
            let plain = facet(scale, false).unwrap();
            assert_eq!(plain.front, Vec3::Z);
            assert!((plain.area / (0.5 * scale * scale) - 1.0).abs() < 1e-6);
            assert_eq!(facet(scale, true).unwrap().front, Vec3::NEG_Z);
        }
    }

    #[test]
    fn no_area_no_facet() {
        for corners in [
            [Vec3::ONE; 3],
            [Vec3::ZERO, Vec3::X, Vec3::X * 2.0],
            [Vec3::NAN, Vec3::X, Vec3::Y],
        ] {
            assert!(
                Facet::new(&WorldTriangle {
                    corners,
                    mirrored: false
                })
                .is_none()
            );
        }
        assert!(facet(f32::INFINITY, false).is_none());
    }
}
