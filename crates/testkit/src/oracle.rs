//! Rays against triangles by brute force, in double precision.
//!
//! Single-precision tests may decide otherwise where a ray passes within rounding of an edge, or a hit lies within rounding
//! of the end of the segment. The oracle therefore says for every ray how clear its answer is, and a test compares clear
//! ones only (and counts that they are most).

use glam::{DVec3, Vec3};
use occlude_visibility::Ray;

/// What the oracle knows about one ray and one triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OracleHit {
    /// Ray parameter.
    pub t: f64,
    /// Barycentric weights of the second and third vertex.
    pub u: f64,
    /// See `u`.
    pub v: f64,
    /// Index of the triangle.
    pub triangle: usize,
}

/// The answer about a ray and a set of triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// The nearest hit, clearly inside its triangle, with no unclear one before it.
    Hit(OracleHit),
    /// Nothing is hit, clearly.
    Free,
    /// Rounding decides.
    Unclear,
}

/// Relative distance from an edge, or from either end of the segment, within which an answer is unclear.
const MARGIN: f64 = 1e-4;

/// Meets a ray with one triangle, seen from both sides. `None` if rounding decides; `Some(None)` for a clear miss.
fn meet(ray: &Ray, triangle: [Vec3; 3]) -> Option<Option<(f64, f64, f64)>> {
    let [a, b, c] = triangle.map(|p| p.as_dvec3());
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    if ![a, b, c, origin, direction].iter().all(|p| p.is_finite()) {
        return Some(None);
    }
    let normal = (b - a).cross(c - a);
    let facing = normal.dot(direction);
    let scale = normal.length() * direction.length();
    if scale == 0.0 {
        // Neither a point nor a line of zero area is ever hit.
        return Some(None);
    }
    let t = normal.dot(a - origin) / facing;
    let point = origin + direction * t;
    let weight =
        |p: DVec3, q: DVec3| (q - p).cross(point - p).dot(normal) / normal.length_squared();
    let (u, v, w) = (weight(c, a), weight(a, b), weight(b, c));
    if facing.abs() <= MARGIN * scale {
        // Seen edge on. Far outside is a clear miss all the same.
        return if t.is_finite() && u.min(v).min(w) < -0.1 {
            Some(None)
        } else {
            None
        };
    }
    let (t_min, t_max) = (f64::from(ray.t_min), f64::from(ray.t_max));
    let size = (b - a).length().max((c - a).length()).max((c - b).length());
    let reach = MARGIN * (t.abs() + (size + origin.length()) / direction.length() * 1e-2);
    let inside = u.min(v).min(w);
    if inside < -MARGIN || t < t_min - reach || t > t_max + reach {
        return Some(None);
    }
    (inside > MARGIN && t > t_min + reach && t < t_max - reach).then_some(Some((t, u, v)))
}

/// The nearest hit of a ray among triangles, by trying all of them. NaN and infinite triangles are never hit.
pub fn nearest(ray: &Ray, triangles: &[[Vec3; 3]]) -> Verdict {
    let (mut best, mut unclear): (Option<OracleHit>, bool) = (None, false);
    for (i, &corners) in triangles.iter().enumerate() {
        match meet(ray, corners) {
            None => unclear = true,
            Some(Some((t, u, v))) if best.is_none_or(|b| t < b.t) => {
                best = Some(OracleHit {
                    t,
                    u,
                    v,
                    triangle: i,
                })
            }
            Some(_) => {}
        }
    }
    match best {
        // An unclear triangle may lie before the hit; rather than find out, the ray is given up.
        _ if unclear => Verdict::Unclear,
        Some(hit) => Verdict::Hit(hit),
        None => Verdict::Free,
    }
}

/// Whether anything blocks the ray; `None` if rounding decides. A clear hit decides whatever else is unclear.
pub fn occluded(ray: &Ray, triangles: &[[Vec3; 3]]) -> Option<bool> {
    let mut answer = Some(false);
    for &corners in triangles {
        match meet(ray, corners) {
            Some(Some(_)) => return Some(true),
            None => answer = None,
            Some(None) => {}
        }
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

    #[test]
    fn hits_inside_with_barycentrics() {
        let ray = Ray::new(Vec3::new(0.25, 0.5, 3.0), Vec3::new(0.0, 0.0, -2.0));
        let Verdict::Hit(hit) = nearest(&ray, &[TRIANGLE]) else {
            panic!("missed")
        };
        assert_eq!((hit.t, hit.u, hit.v, hit.triangle), (1.5, 0.25, 0.5, 0));
        let back = Ray::new(Vec3::new(0.25, 0.5, -3.0), Vec3::Z);
        assert!(matches!(nearest(&back, &[TRIANGLE]), Verdict::Hit(_)));
        assert_eq!(
            occluded(&Ray { t_max: 1.4, ..ray }, &[TRIANGLE]),
            Some(false)
        );
        assert_eq!(
            occluded(&Ray { t_min: 1.6, ..ray }, &[TRIANGLE]),
            Some(false)
        );
        assert_eq!(occluded(&Ray { t_max: 1.5, ..ray }, &[TRIANGLE]), None);
    }

    #[test]
    fn takes_the_nearest() {
        let triangles: Vec<[Vec3; 3]> = [3.0, 1.0, 2.0]
            .map(|z| TRIANGLE.map(|p| p + Vec3::Z * z))
            .to_vec();
        let ray = Ray::new(Vec3::new(0.2, 0.2, 0.0), Vec3::Z);
        let Verdict::Hit(hit) = nearest(&ray, &triangles) else {
            panic!("missed")
        };
        assert_eq!((hit.triangle, hit.t), (1, 1.0));
        assert_eq!(occluded(&ray, &triangles), Some(true));
    }

    #[test]
    fn gives_up_at_edges_and_ignores_nonsense() {
        let edge = Ray::new(Vec3::new(0.5, 0.0, 1.0), -Vec3::Z);
        assert_eq!(nearest(&edge, &[TRIANGLE]), Verdict::Unclear);
        let in_plane = Ray::new(Vec3::new(-1.0, 0.2, 0.0), Vec3::X);
        assert_eq!(nearest(&in_plane, &[TRIANGLE]), Verdict::Unclear);
        let flat = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0];
        let nan = [Vec3::NAN, Vec3::X, Vec3::Y];
        assert_eq!(nearest(&edge, &[flat, nan]), Verdict::Free);
        let beside = Ray::new(Vec3::new(5.0, 5.0, 1.0), -Vec3::Z);
        assert_eq!(nearest(&beside, &[TRIANGLE]), Verdict::Free);
    }
}
