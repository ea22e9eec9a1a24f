//! Sampling a triangle by the solid angle that it covers.
//!
//! Arvo, "Stratified sampling of spherical triangles" (1995), in the form of half vectors without angles. The triangle
//! `(v0, v1, v2)` on the unit sphere covers the solid angle `W` with
//! `tan(W / 2) = D / (1 + v0.v1 + v1.v2 + v2.v0)`, `D = |det(v0, v1, v2)|` (van Oosterom & Strackee 1983, eq. 8). The vertex
//! `v2'` on the arc from `v0` to `v2` whose triangle `(v0, v1, v2')` covers a part `w` of it is the mirror image of `v0` at a
//! half vector `h = a v0 + b v2`. With `v2' = 2 (v0.h) h / h.h - v0` numerator and denominator share the factor
//! `2 (v0.h) / h.h`, and the formula above becomes
//! `tan(w / 2) = b D / (a (1 + v0.v1) + b (v0.v2 + v1.v2))`, so that
//! `a = D cos(w/2) - (v0.v2 + v1.v2) sin(w/2)` and `b = (1 + v0.v1) sin(w/2)`.
//! Heights above `v1` are then chosen by `1 - cos = u (1 - v1.v2')`, computed from chords, which does not cancel where the
//! triangle is small.
//!
//! Wrong tool for triangles that are far away compared with their size: uniform sampling by area is as good there and cheaper.

use glam::{Vec2, Vec3};

/// A triangle seen from a point: the corners' directions, made ready for sampling.
#[derive(Clone, Copy, Debug)]
pub(super) struct SphericalTriangle {
    corners: [Vec3; 3],
    /// Steradians.
    pub(super) solid_angle: f32,
    det: f32,
    g1: f32,
    g2: f32,
}

impl SphericalTriangle {
    /// `corner`, from the point to the first vertex, and the edges from there. `None` if the triangle covers no solid angle
    /// that could be sampled: seen edge-on, or touching the point.
    pub(super) fn new(corner: Vec3, edge1: Vec3, edge2: Vec3) -> Option<Self> {
        // In units of the distance to the first vertex, so that nothing under- or overflows at any scale.
        let scale = corner.length().recip();
        let (a, e1, e2) = (corner * scale, edge1 * scale, edge2 * scale);
        let (b, c) = (a + e1, a + e2);
        let (length_b, length_c) = (b.length(), c.length());
        let corners = [a, b / length_b, c / length_c];
        let [v0, v1, v2] = corners;
        // The determinant from edges, not from directions: those of a small triangle differ in their last bits only.
        let det = (a.dot(e1.cross(e2)) / (length_b * length_c)).abs();
        let (d01, d12, d20) = (v0.dot(v1), v1.dot(v2), v2.dot(v0));
        let solid_angle = 2.0 * det.atan2(1.0 + d01 + d12 + d20);
        (det > 0.0 && solid_angle > 0.0 && solid_angle.is_finite()).then_some(Self {
            corners,
            solid_angle,
            det,
            g1: d20 + d12,
            g2: 1.0 + d01,
        })
    }

    /// The direction at `u`, uniform in solid angle.
    pub(super) fn direction(&self, u: Vec2) -> Vec3 {
        let [v0, v1, v2] = self.corners;
        let (sin, cos) = (0.5 * self.solid_angle * u.x).sin_cos();
        let h = v0 * (self.det * cos - self.g1 * sin) + v2 * (self.g2 * sin);
        let h2 = h.length_squared();
        let moved = if h2 > 0.0 {
            h * (2.0 * v0.dot(h) / h2) - v0
        } else {
            v2
        };
        // 1 - cos of the whole arc from v1 is half of the squared chord.
        let arc = 0.5 * (moved - v1).length_squared();
        let m = u.y * arc;
        // The tangent at v1 towards `moved`.
        let tangent = (moved - v1) + v1 * arc;
        let length = tangent.length();
        if length > 0.0 {
            (v1 * (1.0 - m) + tangent * ((m * (2.0 - m)).sqrt() / length)).normalize()
        } else {
            v1
        }
    }

    /// The `u` at which [`SphericalTriangle::direction`] gives `wi`, a unit vector into the triangle.
    pub(super) fn invert(&self, wi: Vec3) -> Vec2 {
        let [v0, v1, v2] = self.corners;
        // Where the great circle through v1 and wi meets the arc from v0 to v2. Small differences instead of the corners
        // themselves, for the sake of small triangles.
        let plane = v1.cross(wi - v1);
        let (s0, s2) = (plane.dot(v0 - v1), plane.dot(v2 - v1));
        let between = s0 - s2;
        let t = if between != 0.0 {
            (s0 / between).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let chord = v0 + (v2 - v0) * t;
        let length = chord.length();
        let moved = chord / length;
        let det = self.det * t / length;
        let part = 2.0 * det.atan2(self.g2 + v1.dot(moved) + moved.dot(v0));
        let arc = (moved - v1).length_squared();
        let height = if arc > 0.0 {
            (wi - v1).length_squared() / arc
        } else {
            0.0
        };
        Vec2::new(
            (part / self.solid_angle).clamp(0.0, 1.0),
            height.clamp(0.0, 1.0),
        )
    }

    /// A bilinear density over `u` that follows the cosine with `normal`; uniform if `normal` is zero. `None` if the whole
    /// triangle lies below the horizon.
    pub(super) fn cosine_warp(&self, normal: Vec3) -> Option<Bilinear> {
        if normal == Vec3::ZERO {
            return Some(Bilinear::UNIFORM);
        }
        let cosines = self.corners.map(|v| v.dot(normal));
        let largest = cosines[0].max(cosines[1]).max(cosines[2]);
        if largest <= 0.0 {
            return None;
        }
        // Never far below the largest: the cosine at the corners says little about the middle of a large triangle.
        let [c0, c1, c2] = cosines.map(|c| c.max(0.1 * largest));
        Some(Bilinear::new(c1, c1, c0, c2))
    }
}

/// A density over the unit square that is bilinear between its values at the corners.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bilinear {
    /// Values at (0, 0), (1, 0), (0, 1) and (1, 1), scaled to mean 1.
    corners: [f32; 4],
}

impl Bilinear {
    const UNIFORM: Self = Self { corners: [1.0; 4] };

    fn new(v00: f32, v10: f32, v01: f32, v11: f32) -> Self {
        let scale = 4.0 / (v00 + v10 + v01 + v11);
        Self {
            corners: [v00 * scale, v10 * scale, v01 * scale, v11 * scale],
        }
    }

    pub(super) fn sample(&self, u: Vec2) -> Vec2 {
        let [v00, v10, v01, v11] = self.corners;
        let y = sample_linear(v00 + v10, v01 + v11, u.y);
        let x = sample_linear(v00 + (v01 - v00) * y, v10 + (v11 - v10) * y, u.x);
        Vec2::new(x, y)
    }

    pub(super) fn density(&self, p: Vec2) -> f32 {
        let [v00, v10, v01, v11] = self.corners;
        let low = v00 + (v10 - v00) * p.x;
        let high = v01 + (v11 - v01) * p.x;
        low + (high - low) * p.y
    }
}

/// Samples a density on `[0, 1]` that runs linearly from `a` to `b`, both positive.
fn sample_linear(a: f32, b: f32, u: f32) -> f32 {
    // The root of a x + (b - a) x^2 / 2 = u (a + b) / 2, in the form that does not cancel where a = b.
    let x = u * (a + b) / (a + (a * a + u * (b - a) * (b + a)).max(0.0).sqrt());
    x.min(1.0 - f32::EPSILON / 2.0)
}
