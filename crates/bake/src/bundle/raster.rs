//! Which lines a triangle covers, and at what depth and texel.
//!
//! Rows of lines are cut with the edges. An edge is always reckoned from its lower end, so that the two triangles that
//! share it find the same crossing to the bit: a line that passes a closed surface meets it exactly once, and nothing leaks. A line on an
//! edge belongs to the triangle on its right, a row through a vertex to the triangle above.

use super::fragments::{ALONG, Fragment, Fragments, fragment};
use super::triangles::Lot;
use glam::{Vec2, Vec3};

/// A triangle among the lines of a rectangle: line (i, j) is at (i, j), the rectangle starts at (0, 0).
pub(super) struct Projected {
    /// Columns, rows, depth.
    pub corners: [Vec3; 3],
    /// Places in the light map, texels.
    pub chart: [Vec2; 3],
    pub lot: Lot,
}

/// What varies linearly over a triangle.
#[derive(Clone, Copy)]
struct Plane {
    at: f32,
    x: f32,
    y: f32,
    low: f32,
    high: f32,
}

impl Plane {
    /// Through the values at the corners; the determinant is twice the area.
    #[inline(always)]
    fn new(corners: &[Vec3; 3], values: [f32; 3], per_area: f32) -> Self {
        let [a, b, c] = corners;
        let (d1, d2) = (values[1] - values[0], values[2] - values[0]);
        let x = (d1 * (c.y - a.y) - d2 * (b.y - a.y)) * per_area;
        let y = (d2 * (b.x - a.x) - d1 * (c.x - a.x)) * per_area;
        Self {
            at: values[0] - x * a.x - y * a.y,
            x,
            y,
            low: values[0].min(values[1]).min(values[2]),
            high: values[0].max(values[1]).max(values[2]),
        }
    }

    /// Slivers extrapolate wildly between their corners: the value stays within those of the corners.
    #[inline(always)]
    fn value(&self, x: f32, y: f32) -> f32 {
        (self.at + self.x * x + self.y * y)
            .max(self.low)
            .min(self.high)
    }
}

/// Puts the fragments of a triangle on `width` x `height` lines. `covers` is asked about every one: column, row.
#[inline(always)]
pub(super) fn scan(
    triangle: &Projected,
    [width, height]: [u32; 2],
    fragments: &mut impl Fragments,
    covers: impl Fn(f32, f32, f32) -> bool,
) {
    let corners = &triangle.corners;
    let [p, q, r] = corners;
    let area = (q.x - p.x) * (r.y - p.y) - (r.x - p.x) * (q.y - p.y);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    // From the lowest row to the highest.
    let order = |a: &Vec3, b: &Vec3| (a.y, a.x) <= (b.y, b.x);
    let (mut a, mut b, mut c) = (p, q, r);
    if !order(a, b) {
        (a, b) = (b, a);
    }
    if !order(b, c) {
        (b, c) = (c, b);
    }
    if !order(a, b) {
        (a, b) = (b, a);
    }
    let first = a.y.ceil().max(0.0);
    let last = (c.y.ceil() - 1.0).min(height as f32 - 1.0);
    if first > last {
        return;
    }
    let slope = |from: &Vec3, to: &Vec3| (to.x - from.x) / (to.y - from.y);
    let (long, lower, upper) = (slope(a, c), slope(a, b), slope(b, c));
    // The middle corner is left of the long edge.
    let left = (b.x - a.x) * (c.y - a.y) < (c.x - a.x) * (b.y - a.y);

    let per_area = 1.0 / area;
    let depth = Plane::new(corners, corners.map(|c| c.z), per_area);
    let column = Plane::new(corners, triangle.chart.map(|c| c.x), per_area);
    let row = Plane::new(corners, triangle.chart.map(|c| c.y), per_area);
    // A corner on a texel's far border belongs to the texel before it.
    let last_of = |plane: &Plane| ((plane.high.ceil() - 1.0).max(plane.low.floor())) as u32;
    let (last_column, last_row) = (last_of(&column), last_of(&row));
    let along = if area > 0.0 { ALONG } else { 0 };
    for j in first as u32..=last as u32 {
        let y = j as f32;
        let far = a.x + long * (y - a.y);
        let near = if y < b.y {
            a.x + lower * (y - a.y)
        } else {
            b.x + upper * (y - b.y)
        };
        let (start, end) = if left { (near, far) } else { (far, near) };
        let start = start.ceil().max(0.0);
        let end = end.ceil().min(width as f32);
        if start >= end {
            continue;
        }
        for i in start as u32..end as u32 {
            let x = i as f32;
            let z = depth.value(x, y);
            if !covers(x, y, z) {
                continue;
            }
            let u = (column.value(x, y) as u32).min(last_column);
            let v = (row.value(x, y) as u32).min(last_row);
            let front = triangle.lot.first + v * triangle.lot.stride + u;
            fragments.put((j * width + i) as usize, fragment(z, front | along));
        }
    }
}

/// Sorts by depth. Most lines meet few surfaces.
#[inline(always)]
pub(super) fn sort(fragments: &mut [Fragment]) {
    if fragments.len() > 24 {
        fragments.sort_unstable();
        return;
    }
    for i in 1..fragments.len() {
        let fragment = fragments[i];
        let mut j = i;
        while j > 0 && fragments[j - 1] > fragment {
            fragments[j] = fragments[j - 1];
            j -= 1;
        }
        fragments[j] = fragment;
    }
}
