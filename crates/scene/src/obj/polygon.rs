//! Polygons become triangles: a fan where the polygon is convex, ear clipping (Meisters 1975) where it is not.

use glam::{DVec2, Vec3};

/// Above this many corners, concave polygons are fanned as well: clipping takes cubic time at worst.
const MOST_CORNERS: usize = 256;

/// Triangles as indices into `corners`, turned as the polygon is. It may be non-planar; the projection along its mean
/// normal decides. Crossing outlines give some triangulation.
pub(super) fn triangulate(corners: &[Vec3], out: &mut Vec<[usize; 3]>) {
    out.clear();
    let n = corners.len();
    let fan = |out: &mut Vec<[usize; 3]>| out.extend((2..n).map(|i| [0, i - 1, i]));
    if n <= 3 || n > MOST_CORNERS {
        return fan(out);
    }
    let flat = flatten(corners);
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[b]);
    if (0..n).all(|i| turn(i, (i + 1) % n, (i + 2) % n) >= 0.0) {
        return fan(out);
    }
    let mut left: Vec<usize> = (0..n).collect();
    while left.len() > 3 {
        let k = left.len();
        let ear = (0..k).find(|&i| {
            let [a, b, c] = [left[(i + k - 1) % k], left[i], left[(i + 1) % k]];
            turn(a, b, c) > 0.0
                && left.iter().all(|&p| {
                    [a, b, c].contains(&p)
                        || [a, b, c].iter().any(|&q| flat[p] == flat[q])
                        || turn(a, b, p) < 0.0
                        || turn(b, c, p) < 0.0
                        || turn(c, a, p) < 0.0
                })
        });
        // Without an ear the outline crosses itself: cut anything, so that this ends.
        let i = ear.unwrap_or(0);
        out.push([left[(i + k - 1) % k], left[i], left[(i + 1) % k]]);
        left.remove(i);
    }
    out.push([left[0], left[1], left[2]]);
}

/// Projects along the axis that is nearest to the polygon's normal (Newell's sum), so that it turns counterclockwise.
fn flatten(corners: &[Vec3]) -> Vec<DVec2> {
    let points: Vec<_> = corners.iter().map(|p| p.as_dvec3()).collect();
    let normal: glam::DVec3 = (0..points.len())
        .map(|i| (points[i] - points[0]).cross(points[(i + 1) % points.len()] - points[0]))
        .sum();
    let axis = normal.abs().max_position();
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    points
        .iter()
        .map(|p| {
            if normal[axis] < 0.0 {
                DVec2::new(p[b], p[a])
            } else {
                DVec2::new(p[a], p[b])
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[Vec3], triangles: &[[usize; 3]]) -> (Vec3, f32) {
        let mut sum = (Vec3::ZERO, 0.0);
        for &[a, b, c] in triangles {
            let n = (corners[b] - corners[a]).cross(corners[c] - corners[a]) / 2.0;
            sum.0 += n;
            sum.1 += n.length();
        }
        sum
    }

    #[test]
    fn concave_polygons_keep_their_area() {
        // A comb: a fan from any corner would leave the outline.
        let mut comb = Vec::new();
        for i in 0..8 {
            let x = i as f32;
            comb.extend([Vec3::new(x, 0.0, 0.0), Vec3::new(x + 0.5, -3.0, 0.0)]);
        }
        comb.extend([Vec3::new(8.0, 1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)]);
        for reverse in [false, true] {
            let mut corners = comb.clone();
            if reverse {
                corners.reverse();
            }
            for shift in 0..corners.len() {
                corners.rotate_left(shift);
                let mut out = Vec::new();
                triangulate(&corners, &mut out);
                assert_eq!(out.len(), corners.len() - 2);
                let (vector, scalar) = area(&corners, &out);
                // All triangles turn the same way exactly if the areas add up.
                assert!(
                    (vector.length() - scalar).abs() < 1e-4,
                    "shift {shift}: {vector} {scalar}"
                );
                assert_eq!(vector.z < 0.0, reverse);
            }
        }
    }

    #[test]
    fn nonsense_ends() {
        let mut out = Vec::new();
        triangulate(&[Vec3::ZERO; 200], &mut out);
        assert_eq!(out.len(), 198);
        let star: Vec<_> = (0..200u32)
            .map(|i| {
                let hash = |k: u32| (i.wrapping_mul(k) >> 16) as f32;
                Vec3::new(
                    hash(2_654_435_761),
                    hash(2_246_822_519),
                    hash(3_266_489_917),
                )
            })
            .collect();
        triangulate(&star, &mut out);
        assert_eq!(out.len(), 198);
    }
}
