//! Triangles against the squares of texels.

use glam::Vec2;
use std::ops::Range;

/// A convex polygon of at most seven corners: a triangle cut by a square.
#[derive(Clone, Copy, Debug, Default)]
pub struct Polygon {
    points: [Vec2; 8],
    count: usize,
}

impl Polygon {
    fn triangle(corners: [Vec2; 3]) -> Self {
        let mut polygon = Self::default();
        polygon.points[..3].copy_from_slice(&corners);
        polygon.count = 3;
        polygon
    }

    /// What the texel at column `x`, row `y` holds of a triangle.
    pub fn of_texel(corners: [Vec2; 3], x: u32, y: u32) -> Self {
        let (x, y) = (x as f32, y as f32);
        Self::triangle(corners).row(y).column(x)
    }

    fn row(&self, y: f32) -> Self {
        self.cut(|p| p.y - y).cut(|p| y + 1.0 - p.y)
    }

    fn column(&self, x: f32) -> Self {
        self.cut(|p| p.x - x).cut(|p| x + 1.0 - p.x)
    }

    /// Keeps where `inside` (a linear function) is not negative (Sutherland & Hodgman 1974).
    fn cut(&self, inside: impl Fn(Vec2) -> f32) -> Self {
        let mut out = Self::default();
        for i in 0..self.count {
            let (p, q) = (self.points[i], self.points[(i + 1) % self.count]);
            let (a, b) = (inside(p), inside(q));
            if a >= 0.0 {
                out.push(p);
            }
            if (a >= 0.0) != (b >= 0.0) {
                out.push(p + (q - p) * (a / (a - b)));
            }
        }
        out
    }

    fn push(&mut self, p: Vec2) {
        // Rounding could make one corner more than there are in theory.
        if self.count < self.points.len() {
            self.points[self.count] = p;
            self.count += 1;
        }
    }

    /// The corners.
    pub fn points(&self) -> &[Vec2] {
        &self.points[..self.count]
    }

    /// Triangles of a fan, with their areas.
    fn fan(&self) -> impl Iterator<Item = (f32, [Vec2; 3])> + '_ {
        let points = self.points();
        (2..points.len()).map(|i| {
            let t = [points[0], points[i - 1], points[i]];
            (0.5 * (t[1] - t[0]).perp_dot(t[2] - t[0]).abs(), t)
        })
    }

    /// Its area.
    pub fn area(&self) -> f32 {
        self.fan().map(|(area, _)| area).sum()
    }

    /// Its centre of mass; the mean of the corners if it has no area; `None` if it has no corners.
    pub fn centroid(&self) -> Option<Vec2> {
        let (mut sum, mut weight) = (Vec2::ZERO, 0.0);
        for (area, [a, b, c]) in self.fan() {
            sum += (a + b + c) * (area / 3.0);
            weight += area;
        }
        if weight > 1e-12 {
            return Some(sum / weight);
        }
        let points = self.points();
        (!points.is_empty()).then(|| points.iter().sum::<Vec2>() / points.len() as f32)
    }

    /// A point uniformly inside, from two numbers in `[0, 1)`.
    pub fn sample(&self, random: Vec2) -> Option<Vec2> {
        let mut target = random.x * self.area();
        for (area, [a, b, c]) in self.fan() {
            if target < area {
                // Turk 1990, "Generating random points in triangles": the root makes it uniform.
                let root = (target / area).sqrt();
                return Some(a + ((b - a) * (1.0 - random.y) + (c - a) * random.y) * root);
            }
            target -= area;
        }
        self.centroid()
    }

    /// Whether a point lies inside or on the border.
    pub fn contains(&self, p: Vec2) -> bool {
        let points = self.points();
        let side = |i: usize| {
            let (a, b) = (points[i], points[(i + 1) % points.len()]);
            (b - a).perp_dot(p - a)
        };
        points.len() >= 3
            && ((0..points.len()).all(|i| side(i) >= -1e-6)
                || (0..points.len()).all(|i| side(i) <= 1e-6))
    }
}

/// Calls `found` with every texel (column, row) in `rows` that a triangle touches by more than a border, and the area that it takes there. A
/// triangle without area is found in the texels that its line runs through.
pub(crate) fn cover(corners: [Vec2; 3], rows: Range<u32>, mut found: impl FnMut(u32, u32, f32)) {
    /// Less than this of a texel is a border that was touched, in square texels for each texel of the triangle's length.
    const TOUCH: f32 = 1e-5;
    let low = corners[0].min(corners[1]).min(corners[2]);
    let high = corners[0].max(corners[1]).max(corners[2]);
    let y_range =
        (low.y.max(0.0) as u32).max(rows.start)..(high.y.max(0.0) as u32 + 1).min(rows.end);
    let whole = Polygon::triangle(corners);
    let has_area = whole.area() > 1e-4;
    for y in y_range {
        let strip = whole.row(y as f32);
        let points = strip.points();
        if points.is_empty() {
            continue;
        }
        let (left, right) = points
            .iter()
            .fold((f32::MAX, f32::MIN), |(l, r), p| (l.min(p.x), r.max(p.x)));
        for x in left.max(0.0) as u32..=right.max(0.0) as u32 {
            let cell = strip.column(x as f32);
            let area = cell.area();
            if area > TOUCH || (!has_area && !cell.points().is_empty()) {
                found(x, y, area);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::vec2;
    use occlude_testkit::random::Random;

    #[test]
    fn cells_sum_to_the_triangle() {
        let mut random = Random(3);
        for _ in 0..500 {
            let corners = [(); 3].map(|()| random.pair() * 9.0);
            let mut sum = 0.0;
            cover(corners, 0..9, |_, _, area| sum += area);
            let area = 0.5
                * (corners[1] - corners[0])
                    .perp_dot(corners[2] - corners[0])
                    .abs();
            assert!((sum - area).abs() < 1e-3, "{sum} {area}");
            // Bands find the same.
            let mut by_band = 0.0;
            for y in 0..9 {
                cover(corners, y..y + 1, |_, _, area| by_band += area);
            }
            assert!((sum - by_band).abs() < 1e-4);
        }
    }

    #[test]
    fn nothing_is_too_small_to_be_found() {
        let mut found = Vec::new();
        let speck = [vec2(3.2, 4.7), vec2(3.2001, 4.7), vec2(3.2, 4.7001)];
        cover(speck, 0..9, |x, y, _| found.push((x, y)));
        cover([vec2(1.5, 1.5); 3], 0..9, |x, y, _| found.push((x, y)));
        assert_eq!(found, [(3, 4), (1, 1)]);
    }

    #[test]
    fn samples_are_uniform_inside() {
        let polygon = Polygon::of_texel([vec2(0.1, 0.0), vec2(3.0, 0.7), vec2(0.2, 2.0)], 0, 0);
        let mut random = Random(9);
        let (mut mean, n) = (Vec2::ZERO, 20_000);
        for _ in 0..n {
            let p = polygon.sample(random.pair()).unwrap();
            assert!(polygon.contains(p) && p.cmple(Vec2::ONE).all());
            mean += p / n as f32;
        }
        // A standard error of 0.3 / sqrt(20000) = 0.002 a coordinate; five of them.
        assert!(mean.distance(polygon.centroid().unwrap()) < 0.011, "{mean}");
    }
}
