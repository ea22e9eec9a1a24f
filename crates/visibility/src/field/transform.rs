//! The exact distance transform on the hemisphere, in time proportional to the texels.
//!
//! The boundary of a map is the set of **midpoints between neighbouring texels that differ**, and the horizon. Neither side of an
//! edge owns it, so that the distance passes through 0 there, where distances to the centres of unlike texels would jump by
//! a texel. (That is the correction by half the local spacing; one transform serves both signs.)
//!
//! The horizon has a closed form: a direction at height `y` is `asin y` away from it. The midpoints lie on rows of equal `theta`:
//! those between columns on the rows of texel centres, those between rows on the lines in between. First, along every
//! such **parallel**, the nearest midpoint of each column: its distance `d` in `phi`. Then, for each column, along the **meridian**:
//! the midpoint of row `i`, at polar angle `t_i` and `d_i` to the side, is away from polar angle `t` by
//!
//! `cos D_i(t) = cos t cos t_i + sin t sin t_i cos d_i = sin t (a_i x + b_i)`, `x = cot t`, `a_i = cos t_i`, `b_i = sin t_i cos d_i`.
//!
//! For fixed `t` the factor `sin t > 0` is common: the nearest row is the **topmost of the lines** `a_i x + b_i`. Their slopes fall from
//! row to row, so the topmost line moves on as `x` falls with growing `t`: a row between two others looks among the lines between theirs
//! ([`scan_meridians`]; divide and conquer, a logarithm more than the envelope of Meijster et al. 2000, but many columns at a time and without
//! branches, which is several times faster up to 1024 texels). Parallels must come first: on a meridian the nearest row is
//! decided by one number a row, `d_i`, only because the distance in `phi` orders points of one parallel for every observer.
//! Scanning meridians first is wrong by up to 0.63 rad.

use super::distance::DistanceField;
use super::hemisphere::{Grid, acos};
use super::map::VisibilityMap;

/// Columns that pass through the nearest cache together.
const STRIP: usize = 16;

/// Transforms maps; keeps its scratch space from one to the next.
#[derive(Debug, Default)]
pub struct DistanceTransform {
    /// The rows that have midpoints.
    parallels: Vec<Parallel>,
    /// Their columns, row after row.
    edges: Vec<u16>,
    /// `b` of those rows: strip after strip of columns, row after row.
    heights: Vec<f32>,
    row: Vec<f32>,
    /// Cosines of the distances of a strip, row after row.
    cosines: Vec<f32>,
    /// `a` of the rows.
    slopes: Vec<f32>,
    /// Of every row, numbered from 1, the first and the last line that is topmost for some column of the strip.
    bounds: Vec<[u16; 2]>,
}

/// A row of texel centres, or the line behind one, that midpoints lie on.
#[derive(Clone, Copy, Debug)]
struct Parallel {
    row: u16,
    between: bool,
    /// Where its columns end.
    end: u32,
    /// `a`.
    slope: f32,
}

/// Appends the columns whose bits are set.
#[inline]
fn push_bits(words: impl Iterator<Item = u64>, columns: &mut Vec<u16>) {
    for (index, mut word) in words.enumerate() {
        while word != 0 {
            columns.push((index * 64) as u16 + word.trailing_zeros() as u16);
            word &= word - 1;
        }
    }
}

impl DistanceTransform {
    /// The signed distances of a map: positive where it is free.
    pub fn transform(&mut self, map: &VisibilityMap) -> DistanceField {
        let mut field = DistanceField::default();
        self.transform_into(map, &mut field);
        field
    }

    /// [`transform`](Self::transform) into a field that is there already.
    pub fn transform_into(&mut self, map: &VisibilityMap, field: &mut DistanceField) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512bw")
            && std::arch::is_x86_feature_detected!("avx512dq")
            && std::arch::is_x86_feature_detected!("avx512vl")
        {
            // SAFETY: the machine has the instructions.
            return unsafe { self.transform_avx512(map, field) };
        } else if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the machine has the instructions.
            return unsafe { self.transform_avx2(map, field) };
        }
        self.transform_by(map, field);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn transform_avx512(&mut self, map: &VisibilityMap, field: &mut DistanceField) {
        self.transform_by(map, field);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn transform_avx2(&mut self, map: &VisibilityMap, field: &mut DistanceField) {
        self.transform_by(map, field);
    }

    #[inline(always)]
    fn transform_by(&mut self, map: &VisibilityMap, field: &mut DistanceField) {
        let grid = Grid::of(map.side());
        let side = grid.side;
        self.find_midpoints(map, grid);
        self.scan_parallels(grid);
        let rows = self.parallels.len();
        self.cosines.clear();
        self.cosines.resize(side * STRIP, -1.0);
        self.bounds.clear();
        self.bounds.resize(side + 1, [0; 2]);
        self.slopes.clear();
        self.slopes.extend(self.parallels.iter().map(|p| p.slope));
        let values = field.values_mut(map.side());
        for strip in 0..side / STRIP {
            if rows > 0 {
                let heights = &self.heights[strip * rows * STRIP..][..rows * STRIP];
                let (bounds, out) = (&mut self.bounds, &mut self.cosines);
                scan_meridians(grid, &self.slopes, heights, bounds, out);
            }
            finish(map, grid, strip, &self.cosines, values);
        }
    }

    fn find_midpoints(&mut self, map: &VisibilityMap, grid: &Grid) {
        let last = grid.side - 1;
        let edges = &mut self.edges;
        edges.clear();
        self.parallels.clear();
        for row in 0..grid.side {
            let words = map.row(row);
            // Between columns: bit k differs from bit k + 1. The last column has none behind it.
            let before = edges.len();
            push_bits(
                words.iter().enumerate().map(|(i, word)| {
                    let (next, inside) = match words.get(i + 1) {
                        Some(next) => (next << 63, u64::MAX),
                        None => (0, (1 << (last % 64)) - 1),
                    };
                    (word ^ (word >> 1 | next)) & inside
                }),
                edges,
            );
            if edges.len() > before {
                self.parallels.push(Parallel {
                    row: row as u16,
                    between: false,
                    end: edges.len() as u32,
                    slope: grid.cos[row],
                });
            }
            if row < last {
                let before = edges.len();
                let below = map.row(row + 1);
                push_bits(words.iter().zip(below).map(|(a, b)| a ^ b), edges);
                if edges.len() > before {
                    self.parallels.push(Parallel {
                        row: row as u16,
                        between: true,
                        end: edges.len() as u32,
                        slope: grid.cos_between[row],
                    });
                }
            }
        }
    }

    /// Fills the heights.
    #[inline(always)]
    fn scan_parallels(&mut self, grid: &Grid) {
        let rows = self.parallels.len();
        self.heights.resize(rows * grid.side, 0.0);
        self.row.resize(grid.side, 0.0);
        let mut start = 0;
        for (index, parallel) in self.parallels.iter().enumerate() {
            let row = usize::from(parallel.row);
            let (sin, cosines) = if parallel.between {
                (grid.sin_between[row], &grid.cos_whole)
            } else {
                (grid.sin[row], &grid.cos_half)
            };
            let edges = &self.edges[start..parallel.end as usize];
            start = parallel.end as usize;
            fill_parallel(edges, parallel.between, sin, cosines, &mut self.row);
            for (strip, values) in self.row.chunks_exact(STRIP).enumerate() {
                let at = (strip * rows + index) * STRIP;
                self.heights[at..at + STRIP].copy_from_slice(values);
            }
        }
    }
}

/// The horizon, signs and angles of a strip.
#[inline(always)]
fn finish(map: &VisibilityMap, grid: &Grid, strip: usize, cosines: &[f32], values: &mut [i16]) {
    let first = strip * STRIP;
    for (row, cosines) in cosines.chunks_exact(STRIP).enumerate() {
        let bits = (map.row(row)[first / 64] >> (first % 64)) as u32;
        let out = &mut values[row * grid.side + first..][..STRIP];
        let horizons = &grid.horizon[row * grid.side + first..][..STRIP];
        for column in 0..STRIP {
            let edge = acos(cosines[column]);
            let horizon = horizons[column];
            let sign = (bits >> column & 1) as f32;
            let free = if horizon < edge { horizon } else { edge };
            // Without a branch: it is left to vector units.
            out[column] = DistanceField::encode(sign * (free + edge) - edge);
        }
    }
}

/// `sin * cos(distance in phi to the nearest midpoint)` for every column. A midpoint `e` lies on column `e`, or, if not `between` rows,
/// half a column behind it.
#[inline(always)]
fn fill_parallel(edges: &[u16], between: bool, sin: f32, cosines: &[f32], row: &mut [f32]) {
    let side = row.len();
    let mut from = 0;
    for (k, &edge) in edges.iter().enumerate() {
        let edge = usize::from(edge);
        // Columns up to the middle between this midpoint and the next are nearest to this one.
        let to = match edges.get(k + 1) {
            Some(&next) => (edge + usize::from(next) + usize::from(!between)) / 2 + 1,
            None => side,
        };
        // cos_whole[k] is of k - side columns; cos_half[k] of k - side + 1/2, even in the distance.
        let offset = if between { side } else { side - 1 };
        let start = from + offset - edge;
        let source = &cosines[start..start + (to - from)];
        for (value, cos) in row[from..to].iter_mut().zip(source) {
            *value = sin * cos;
        }
        from = to;
    }
}

/// For every row of a strip the topmost of its lines: cosines of the distances. `heights` and `out` hold [`STRIP`] columns a row.
///
/// Slopes fall from line to line, so that the topmost line's number grows with the row: rows in the middle of known ones look between those
/// lines alone. Columns of a strip share their bounds, which costs little, since neighbours have nearly the same.
#[inline(always)]
fn scan_meridians(
    grid: &Grid,
    slopes: &[f32],
    heights: &[f32],
    bounds: &mut [[u16; 2]],
    out: &mut [f32],
) {
    let side = grid.side;
    let last = slopes.len() - 1;
    let mut step = side;
    while step > 0 {
        // Rows at odd multiples of the step, numbered from 1, lie between rows that are known.
        let mut row = step;
        while row <= side {
            let from = if row > step {
                usize::from(bounds[row - step][0])
            } else {
                0
            };
            let to = if row + step <= side {
                usize::from(bounds[row + step][1])
            } else {
                last
            };
            let (sin, cos) = (grid.sin[row - 1], grid.cos[row - 1]);
            let mut best = [-2.0_f32; STRIP];
            // A number is kept as a float: one select does for both.
            let mut which = [0.0_f32; STRIP];
            let lines = slopes[from..=to]
                .iter()
                .zip(heights[from * STRIP..].chunks_exact(STRIP));
            for (number, (slope, heights)) in (from..).zip(lines) {
                let (base, number) = (slope * cos, number as f32);
                for k in 0..STRIP {
                    let value = base + heights[k] * sin;
                    let better = value > best[k];
                    best[k] = if better { value } else { best[k] };
                    which[k] = if better { number } else { which[k] };
                }
            }
            out[(row - 1) * STRIP..row * STRIP].copy_from_slice(&best);
            if step > 1 {
                bounds[row] = least_and_largest(&which);
            }
            row += 2 * step;
        }
        step /= 2;
    }
}

/// Of whole numbers that fit 16 bits.
#[inline(always)]
fn least_and_largest(numbers: &[f32; STRIP]) -> [u16; 2] {
    const HALF: usize = STRIP / 2;
    let (mut low, mut high) = ([0.0_f32; HALF], [0.0_f32; HALF]);
    for k in 0..HALF {
        let (a, b) = (numbers[k], numbers[k + HALF]);
        low[k] = if a < b { a } else { b };
        high[k] = if a > b { a } else { b };
    }
    let least = low.iter().fold(f32::MAX, |a, &b| if b < a { b } else { a });
    let largest = high.iter().fold(0.0, |a, &b| if b > a { b } else { a });
    [least as u16, largest as u16]
}
