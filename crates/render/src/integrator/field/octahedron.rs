//! Functions of direction on a square: the octahedron, unfolded (Engelhardt & Dachsbacher 2008).
//!
//! Texels of a square of side `n` have solid angles within a factor of 5 of each other, no direction is special, and finding the one
//! of a direction takes no trigonometry. Wrong tool for what must be exact: values are means over texels, or bilinear between them.

use super::math::{exp, wide};
use glam::{Vec2, Vec3, Vec3A};
use rayon::prelude::*;

/// The direction of a point of `[-1, 1]^2`, not normalised: on the octahedron.
fn unfold(p: Vec2) -> Vec3 {
    let up = 1.0 - p.x.abs() - p.y.abs();
    let p = if up >= 0.0 { p } else { over_the_edge(p) };
    Vec3::new(p.x, up, p.y)
}

/// The point of a direction.
#[inline]
fn fold(w: Vec3) -> Vec2 {
    let p = Vec2::new(w.x, w.z) / (w.x.abs() + w.y.abs() + w.z.abs());
    if w.y >= 0.0 { p } else { over_the_edge(p) }
}

/// The lower half lies in the corners of the square.
#[inline]
fn over_the_edge(p: Vec2) -> Vec2 {
    Vec2::new(
        (1.0 - p.y.abs()).copysign(p.x),
        (1.0 - p.x.abs()).copysign(p.y),
    )
}

/// The middle of a texel, not normalised.
fn middle(side: usize, index: usize) -> Vec3 {
    let corner = Vec2::new((index % side) as f32, (index / side) as f32);
    unfold((corner + 0.5) * (2.0 / side as f32) - Vec2::ONE)
}

/// Values by texel, row after row.
#[derive(Clone, Debug, Default)]
pub(super) struct Octahedron {
    side: usize,
    pub(super) texels: Vec<Vec3>,
}

impl Octahedron {
    /// From the value in the middle of every texel.
    pub(super) fn from_fn(side: usize, value: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        let texels = (0..side * side)
            .into_par_iter()
            .with_min_len(side)
            .map(|index| value(middle(side, index).normalize()));
        Self {
            side,
            texels: texels.collect(),
        }
    }

    /// Texels along a side.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// The unit vector to a texel's middle, and its solid angle: of `dx dy` on the octahedron it is `1 / r^3`.
    pub(super) fn texel(&self, index: usize) -> (Vec3, f32) {
        let v = middle(self.side, index);
        let r = v.length();
        (v / r, (2.0 / self.side as f32).powi(2) / (r * r * r))
    }

    /// The texel of a direction.
    #[inline]
    pub(super) fn index(&self, w: Vec3) -> usize {
        let half = 0.5 * self.side as f32;
        let place = |v: f32| (((v + 1.0) * half) as usize).min(self.side - 1);
        let p = fold(w);
        place(p.y) * self.side + place(p.x)
    }

    /// Half as many texels along a side, means over the solid angle of four each.
    pub(super) fn halved(&self) -> Self {
        let side = self.side / 2;
        let mean = |index: usize| {
            let first = index / side * 2 * self.side + index % side * 2;
            let four = [first, first + 1, first + self.side, first + self.side + 1];
            let (mut sum, mut all) = (Vec3::ZERO, 0.0);
            for at in four {
                let (_, solid) = self.texel(at);
                sum += self.texels[at] * solid;
                all += solid;
            }
            sum / all
        };
        Self {
            side,
            texels: (0..side * side).map(mean).collect(),
        }
    }

    /// Means under a spherical Gaussian about every texel's middle, ready to be read between texels. Takes time in proportion to the texels times those in a
    /// lobe.
    pub(super) fn smoothed(&self, sharpness: f32) -> Smooth {
        /// Where a lobe ends: there it has fallen to exp(-7).
        const EXPONENT: f32 = 7.0;
        let tiles = self.tiles();
        let reach = (1.0 - EXPONENT / sharpness).clamp(-1.0, 1.0).acos();
        let mean = |index: usize| {
            let (axis, _) = self.texel(index);
            let mut sum = [0.0; 4];
            for tile in &tiles {
                if axis.dot(tile.axis) > (reach + tile.radius).min(std::f32::consts::PI).cos() {
                    add_lobe(tile, axis, sharpness, &mut sum);
                }
            }
            Vec3::new(sum[0], sum[1], sum[2]) / sum[3].max(1e-30)
        };
        let texels: Vec<Vec3> = (0..self.side * self.side)
            .into_par_iter()
            .map(mean)
            .collect();
        Smooth::new(self.side, &texels)
    }

    /// As it is, ready to be read between texels.
    pub(super) fn as_it_is(&self) -> Smooth {
        Smooth::new(self.side, &self.texels)
    }

    fn tiles(&self) -> Vec<Tile> {
        let across = self.side.div_ceil(TILE);
        let tile = |number: usize| {
            let (top, left) = (number / across * TILE, number % across * TILE);
            let mut tile = Tile::default();
            for row in top..(top + TILE).min(self.side) {
                for column in left..(left + TILE).min(self.side) {
                    let index = row * self.side + column;
                    let k = (row - top) * TILE + column - left;
                    let (w, solid) = self.texel(index);
                    let value = self.texels[index] * solid;
                    for (lanes, number) in (tile.columns.iter_mut())
                        .zip([w.x, w.y, w.z, value.x, value.y, value.z, solid])
                    {
                        lanes[k] = number;
                    }
                    tile.axis += w;
                }
            }
            tile.axis = tile.axis.normalize_or(Vec3::Y);
            let [x, y, z, .., solid] = &tile.columns;
            for k in 0..TEXELS {
                if solid[k] > 0.0 {
                    let angle = tile.axis.angle_between(Vec3::new(x[k], y[k], z[k]));
                    tile.radius = tile.radius.max(angle);
                }
            }
            tile
        };
        (0..across * across).into_par_iter().map(tile).collect()
    }
}

/// Texels along a side of a tile, and in it.
const TILE: usize = 8;
const TEXELS: usize = TILE * TILE;

/// Neighbouring texels: directions, values times solid angles, and solid angles; and a cone that holds them.
#[derive(Clone, Debug)]
struct Tile {
    columns: [[f32; TEXELS]; 7],
    axis: Vec3,
    radius: f32,
}

impl Default for Tile {
    fn default() -> Self {
        Self {
            columns: [[0.0; TEXELS]; 7],
            axis: Vec3::ZERO,
            radius: 0.0,
        }
    }
}

wide! {
fn add_lobe(tile: &Tile, axis: Vec3, sharpness: f32, sum: &mut [f32; 4]) {
    let [x, y, z, r, g, b, solid] = &tile.columns;
    let mut sums = [[0.0_f32; TILE]; 4];
    for start in (0..TEXELS).step_by(TILE) {
        let mut values = [0.0; TILE];
        for (k, value) in (start..).zip(&mut values) {
            let cos = axis.x * x[k] + axis.y * y[k] + axis.z * z[k];
            *value = exp(sharpness * (cos - 1.0));
        }
        for (sums, column) in sums.iter_mut().zip([r, g, b, solid]) {
            let column = &column[start..start + TILE];
            for ((sum, value), v) in sums.iter_mut().zip(&values).zip(column) {
                *sum += value * v;
            }
        }
    }
    for (sum, lanes) in sum.iter_mut().zip(&sums) {
        *sum += lanes.iter().sum::<f32>();
    }
}
}

/// An [`Octahedron`] that is read bilinearly: with a border that repeats what lies beyond its edges.
#[derive(Clone, Debug, Default)]
pub(super) struct Smooth {
    side: usize,
    texels: Vec<Vec3A>,
}

impl Smooth {
    fn new(side: usize, texels: &[Vec3]) -> Self {
        let wide = side + 2;
        let last = side as isize - 1;
        let value = |index: usize| {
            let (mut x, mut y) = ((index % wide) as isize - 1, (index / wide) as isize - 1);
            // An edge of the square is glued to itself, turned about its middle.
            if x < 0 || x > last {
                (x, y) = (x.clamp(0, last), last - y);
            }
            if y < 0 || y > last {
                (x, y) = (last - x, y.clamp(0, last));
            }
            Vec3A::from(texels[(y * (last + 1) + x) as usize])
        };
        Self {
            side,
            texels: (0..wide * wide).map(value).collect(),
        }
    }

    /// The value in a direction, bilinear between texels' middles.
    #[inline]
    pub(super) fn at(&self, w: Vec3) -> Vec3A {
        let half = 0.5 * self.side as f32;
        // The border shifts texels by one, their middles lie at halves.
        let p = (fold(w) + Vec2::ONE) * half + Vec2::splat(0.5);
        let place = |v: f32| {
            let i = (v as usize).min(self.side);
            (i, v - i as f32)
        };
        let ((column, u), (row, v)) = (place(p.x), place(p.y));
        let wide = self.side + 2;
        let at = row * wide + column;
        let [upper, lower] = [at, at + wide].map(|at| {
            let two = &self.texels[at..at + 2];
            two[0] + (two[1] - two[0]) * u
        });
        upper + (lower - upper) * v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directions(count: u32) -> impl Iterator<Item = Vec3> {
        (0..count).map(move |i| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * cos, z, r * sin)
        })
    }

    #[test]
    fn texels_hold_their_directions_and_fill_the_sphere() {
        let square = Octahedron::from_fn(32, |w| w);
        let mut whole = 0.0;
        for index in 0..32 * 32 {
            let (w, solid) = square.texel(index);
            assert_eq!(square.index(w), index);
            whole += solid;
        }
        assert!((whole / (4.0 * std::f32::consts::PI) - 1.0).abs() < 2e-3);
        let half = square.halved();
        assert!((half.texels[half.index(Vec3::Y)] - Vec3::Y).length() < 0.2);
    }

    /// What is smooth is read back everywhere, across edges and corners too; where the octahedron folds, with an error in proportion to the texels.
    #[test]
    fn edges_are_glued_to_where_they_belong() {
        let value = |w: Vec3| Vec3::new(w.x, w.y, w.x * w.z);
        let edges = [
            Vec3::NEG_Y,
            Vec3::new(0.0, -1.0, 1e-4),
            Vec3::X,
            Vec3::NEG_Z,
        ];
        let worst = |side: usize| {
            let square = Octahedron::from_fn(side, value).as_it_is();
            directions(5000).chain(edges).fold(0.0, |worst: f32, w| {
                worst.max((Vec3::from(square.at(w)) - value(w)).abs().max_element())
            })
        };
        let (coarse, fine) = (worst(64), worst(256));
        println!("{coarse} {fine}");
        // Folds cost the first order: a quarter of the texel, a quarter of the error. Glued wrongly, errors stay as large as values.
        assert!(fine < 0.26 * coarse && coarse < 0.02);
    }

    /// Smoothing against quadrature over directions.
    #[test]
    fn means_are_what_quadrature_says() {
        let value = |w: Vec3| {
            let lit = w.x + 0.3 * w.y > 0.2;
            if lit {
                Vec3::ONE
            } else {
                Vec3::new(0.0, 0.5, 0.2)
            }
        };
        for (side, sharpness) in [(64, 4.0), (128, 60.0)] {
            // Texels are means over four middles each: the edge is not a staircase.
            let square = Octahedron::from_fn(2 * side, value).halved();
            let smooth = square.smoothed(sharpness);
            for axis in directions(23) {
                let (mut sum, mut all) = (Vec3::ZERO, 0.0);
                for w in directions(40_000) {
                    let weight = (sharpness * (axis.dot(w) - 1.0)).exp();
                    sum += value(w) * weight;
                    all += weight;
                }
                let error = (Vec3::from(smooth.at(axis)) - sum / all)
                    .abs()
                    .max_element();
                assert!(error < 0.012, "{sharpness} {axis}: {error}");
            }
        }
    }
}
