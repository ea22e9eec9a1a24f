//! Triangles of light: what of a cosine or a glossy lobe they fill, nothing in the way.
//!
//! Irradiance is Lambert's formula (Arvo 1994 has it for clipped polygons). For a spherical Gaussian the inner of two integrals about its axis has a closed form, `(1 - exp(l (cos t - 1))) / l` up to an
//! angle `t`, so that one along the outline is left; on an edge, an arc of a great circle, `t` is smooth in the azimuth, and few Gauss points do.
//!
//! What lies below the horizon is cut away. Wrong tool for curved lamps other than by many triangles, and for broad lobes, where a lamp may as well be a lobe itself.

use super::math::{asin, exp};
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// What of a triangle, its corners relative to the point, is above the horizon: a polygon and its number of corners.
fn above(corners: [Vec3; 3], normal: Vec3) -> ([Vec3; 4], usize) {
    let heights = corners.map(|corner| corner.dot(normal));
    let mut above = [Vec3::ZERO; 4];
    let mut count = 0;
    for k in 0..3 {
        let next = (k + 1) % 3;
        if heights[k] > 0.0 {
            above[count] = corners[k];
            count += 1;
        }
        if (heights[k] > 0.0) != (heights[next] > 0.0) {
            let t = heights[k] / (heights[k] - heights[next]);
            above[count] = corners[k].lerp(corners[next], t);
            count += 1;
        }
    }
    (above, if count < 3 { 0 } else { count })
}

/// Irradiance of a triangle with radiance 1.
pub(super) fn irradiance(corners: [Vec3; 3], normal: Vec3) -> f32 {
    let (above, count) = above(corners, normal);
    let mut sum = 0.0;
    for k in 0..count {
        let (a, b) = (above[k], above[(k + 1) % count]);
        let cross = a.cross(b);
        let sine = cross.length();
        if sine > 0.0 {
            let angle = FRAC_PI_2 - asin(a.dot(b) / (a.length() * b.length()).max(1e-30));
            sum += angle * cross.dot(normal) / sine;
        }
    }
    0.5 * sum.abs()
}

/// Gauss-Legendre nodes and weights on `[-1, 1]`, the positive half.
const NODES: [(f32, f32); 3] = [
    (0.238_619_2, 0.467_913_93),
    (0.661_209_4, 0.360_761_57),
    (0.932_469_5, 0.171_324_49),
];

/// The integral of a lobe of amplitude 1 over a triangle; the axis lies above the horizon.
pub(super) fn in_lobe(corners: [Vec3; 3], normal: Vec3, axis: Vec3, sharpness: f32) -> f32 {
    let (above, count) = above(corners, normal);
    if count == 0 {
        return 0.0;
    }
    let (s, t) = axis.any_orthonormal_pair();
    let local = above.map(|p| Vec3::new(p.dot(s), p.dot(t), p.dot(axis)));
    let mut sum = 0.0;
    for k in 0..count {
        let (a, b) = (local[k], local[(k + 1) % count]);
        let turn = (a.x * b.y - a.y * b.x).atan2(a.x * b.x + a.y * b.y);
        if turn == 0.0 {
            continue;
        }
        let m = a.cross(b);
        let middle = a.y.atan2(a.x) + 0.5 * turn;
        let up = m.z.signum();
        let filled = |azimuth: f32| {
            let (sin, cos) = azimuth.sin_cos();
            let q = m.x * cos + m.y * sin;
            let cos_t = -up * q / (q * q + m.z * m.z).max(1e-30).sqrt();
            1.0 - exp(sharpness * (cos_t - 1.0))
        };
        let mean: f32 = NODES
            .iter()
            .map(|&(x, weight)| {
                let off = 0.5 * turn * x;
                weight * (filled(middle - off) + filled(middle + off))
            })
            .sum();
        sum += 0.5 * turn * mean;
    }
    sum.abs() / sharpness
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against sums over small triangles: the lobe's middle inside, on an edge, outside; the horizon in the way; lobes broad and narrow.
    #[test]
    fn lobes_are_what_quadrature_says() {
        let corners = [
            Vec3::new(-0.5, 1.2, -0.4),
            Vec3::new(0.7, 1.0, -0.3),
            Vec3::new(0.1, 1.4, 0.6),
        ];
        let middle = corners.iter().sum::<Vec3>() / 3.0;
        let edge = (corners[0] + corners[1]) * 0.5;
        let away = Vec3::new(0.9, 1.0, 0.9);
        for normal in [Vec3::Y, Vec3::new(1.0, 0.1, 0.0).normalize()] {
            for axis in [middle, edge, away, corners[2]] {
                let axis = axis.normalize();
                for sharpness in [2.0, 12.0, 80.0, 600.0] {
                    let n = 700;
                    let mut expected = 0.0_f64;
                    let [a, b, c] = corners;
                    let area = (b - a).cross(c - a) * (0.5 / (n * n) as f32);
                    for i in 0..n {
                        for j in 0..2 * (n - i) - 1 {
                            // Middles of the small triangles, those that point up and those that point down.
                            let (u, v) = (i as f32, (j / 2) as f32);
                            let third = if j % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
                            let (u, v) = ((u + third) / n as f32, (v + third) / n as f32);
                            let p = a + (b - a) * u + (c - a) * v;
                            let r = p.length();
                            let w = p / r;
                            if w.dot(normal) > 0.0 {
                                let solid = area.dot(w).abs() / (r * r);
                                let value = (sharpness * (axis.dot(w) - 1.0)).exp() * solid;
                                expected += f64::from(value);
                            }
                        }
                    }
                    let found = f64::from(in_lobe(corners, normal, axis, sharpness));
                    let whole = f64::from(std::f32::consts::TAU / sharpness);
                    let error = (found - expected).abs() / whole;
                    assert!(error < 4e-3, "{axis} {sharpness}: {found} {expected}");
                }
            }
        }
    }
}
