//! Whether triangles laid flat lie on each other.

use glam::{DVec2, Vec2};

/// Side of the finest grid that is looked at.
const MOST_CELLS: f64 = 2048.0;
/// Steps a cell: corners snap to these, so that neighbours agree about their edge.
const STEPS: f64 = 256.0;

/// Whether two of the triangles cover the same place, by at least a cell of a grid with `cells_per_unit` cells a unit (fewer for
/// large charts). Triangles that share an edge or a corner do not.
pub(super) fn overlaps(
    corners: impl Iterator<Item = [Vec2; 3]> + Clone,
    cells_per_unit: f32,
) -> bool {
    overlap_of(corners, cells_per_unit).is_some()
}

/// The number of the first triangle that lies on one before it.
pub(crate) fn overlap_of(
    corners: impl Iterator<Item = [Vec2; 3]> + Clone,
    cells_per_unit: f32,
) -> Option<usize> {
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for corner in corners.clone().flatten() {
        low = low.min(corner.as_dvec2());
        high = high.max(corner.as_dvec2());
    }
    let size = high - low;
    if !size.is_finite() || size.min_element() <= 0.0 {
        return None;
    }
    let scale = f64::from(cells_per_unit).min(MOST_CELLS / size.max_element());
    let cells = (size * scale).ceil().as_usizevec2() + 1;
    let mut taken = vec![0_u64; (cells.x * cells.y).div_ceil(64)];
    for (number, triangle) in corners.enumerate() {
        let points = triangle.map(|c| ((c.as_dvec2() - low) * scale * STEPS).round().as_i64vec2());
        let collides = each_covered_cell(points, |x, y| {
            let cell = y as usize * cells.x + x as usize;
            let bit = 1 << (cell % 64);
            let word = &mut taken[cell / 64];
            let before = *word & bit != 0;
            *word |= bit;
            before
        });
        if collides {
            return Some(number);
        }
    }
    None
}

/// Calls `visit` for every cell whose centre a triangle covers, by a rule that gives each point of an edge to one of its two
/// triangles. Stops, with `true`, when it returns `true`.
fn each_covered_cell(mut p: [glam::I64Vec2; 3], mut visit: impl FnMut(i64, i64) -> bool) -> bool {
    let steps = STEPS as i64;
    let area = (p[1] - p[0]).perp_dot(p[2] - p[0]);
    if area == 0 {
        return false;
    }
    if area < 0 {
        p.swap(1, 2);
    }
    let low = p[0].min(p[1]).min(p[2]) / steps;
    let high = p[0].max(p[1]).max(p[2]) / steps;
    // Inside is where each edge's cross product is positive, or zero on edges that own their points.
    let bias = |a: glam::I64Vec2, b: glam::I64Vec2| {
        let d = b - a;
        i64::from(!(d.y > 0 || (d.y == 0 && d.x < 0)))
    };
    let edges = [(p[0], p[1]), (p[1], p[2]), (p[2], p[0])].map(|(a, b)| (a, b - a, bias(a, b)));
    for y in low.y..=high.y {
        for x in low.x..=high.x {
            let centre = glam::I64Vec2::new(x, y) * steps + steps / 2;
            let inside = edges
                .iter()
                .all(|&(a, d, bias)| d.perp_dot(centre - a) >= bias);
            if inside && visit(x, y) {
                return true;
            }
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::vec2;

    #[test]
    fn a_fan_does_not_overlap_and_a_fold_does() {
        let centre = vec2(0.37, 0.81);
        let rim: Vec<Vec2> = (0..9)
            .map(|i| centre + Vec2::from_angle(i as f32 * 0.7))
            .collect();
        // Nine spokes of 0.7 rad: 0.6 rad more than once around.
        let fan = rim.windows(2).map(|w| [centre, w[0], w[1]]);
        assert!(!overlaps(fan.clone(), 100.0));
        let more = fan.chain([[centre, rim[8], centre + Vec2::from_angle(6.3)]]);
        assert!(overlaps(more, 100.0));
        let mirrored = [
            [vec2(0., 0.), vec2(1., 0.), vec2(0., 1.)],
            [vec2(1., 0.), vec2(0., 0.), vec2(0.1, 0.9)],
        ];
        assert!(overlaps(mirrored.into_iter(), 50.0));
    }
}
