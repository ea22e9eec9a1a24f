//! What a direction will cost: maps of importance and of the number of surfaces along a line (sections 3 and 4.1-4.2 of the paper).
//!
//! Importance is the density of texels on a surface, texels per m² seen along the normal: independent of the direction, since the
//! cosine of the projection and that of the irradiance cancel. Every triangle marks *every* pixel that it touches: a city's pixel is
//! metres wide, and what falls between pixel centres would get no line.
//!
//! The fragment map holds the expected number of surfaces that a line through the pixel meets. Triangles of a few pixels add the
//! share of the pixel that they cover, larger ones are sampled at pixel centres as in the paper; either way the map's mean is that
//! of the scene's projected area. Maps are integers, so that the order of triangles does not matter.

use super::frame::Frame;
use super::raster::{Isa, high, low, multiversion};
use super::triangles::{LANES, Triangles};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering::Relaxed};

/// Fragments are counted in parts of this size.
const FRACTION: f32 = 256.0;

/// Maps of counts at most: more threads than this wait for each other here.
const MOST_SHARES: u64 = 8;

/// Blocks of triangles that a thread takes at a time.
const BLOCKS_TOGETHER: usize = 256;

/// How the fragments of the analysis are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Counting {
    /// At pixel centres, as in the paper.
    Sampled,
    /// Small triangles by the area that they cover: without the noise of sampling.
    #[default]
    Area,
}

/// The two maps with their mipmaps; level 0 is the finest.
#[derive(Debug)]
pub(super) struct Maps {
    size: u32,
    importance_bits: Vec<AtomicU32>,
    /// Of each share of the triangles, [`FRACTION`]s.
    counts: Vec<Vec<u32>>,
    /// By level: largest importance, texels per m².
    pub importance: Vec<Vec<f32>>,
    /// By level: mean number of surfaces along a line.
    pub fragments: Vec<Vec<f32>>,
}

impl Maps {
    /// Empty maps, to be rendered by so many threads; `size` is a power of two.
    pub fn new(size: u32, threads: usize) -> Self {
        let count = (size * size) as usize;
        let shares = threads.clamp(1, MOST_SHARES as usize);
        let levels = || {
            (0..=size.ilog2())
                .map(|level| vec![0.0; count >> (2 * level)])
                .collect()
        };
        Self {
            size,
            importance_bits: (0..count).map(|_| AtomicU32::new(0)).collect(),
            counts: vec![vec![0; count]; shares],
            importance: levels(),
            fragments: levels(),
        }
    }

    /// Bytes of maps of `size` pixels along a side, for so many threads.
    pub fn bytes(size: u32, threads: u64) -> u64 {
        u64::from(size) * u64::from(size) * (15 + 4 * threads.clamp(1, MOST_SHARES))
    }

    /// Pixels along a side.
    pub fn size(&self) -> u32 {
        self.size
    }

    /// Renders all triangles into the finest level.
    pub fn render(&mut self, isa: Isa, triangles: &Triangles, frame: &Frame, counting: Counting) {
        self.importance_bits
            .par_chunks_mut(1 << 14)
            .for_each(|bits| bits.iter_mut().for_each(|x| *x.get_mut() = 0));
        let mut counts = std::mem::take(&mut self.counts);
        let maps = &*self;
        let blocks = triangles.blocks().len();
        let next = AtomicUsize::new(0);
        counts.par_iter_mut().with_max_len(1).for_each(|counts| {
            counts.fill(0);
            loop {
                let first = next.fetch_add(BLOCKS_TOGETHER, Relaxed);
                if first >= blocks {
                    break;
                }
                let blocks = first..blocks.min(first + BLOCKS_TOGETHER);
                render(isa, maps, triangles, frame, counting, blocks, counts);
            }
        });
        self.counts = counts;
    }

    fn mark(
        &self,
        x: [f32; 3],
        y: [f32; 3],
        importance: f32,
        counting: Counting,
        counts: &mut [u32],
    ) {
        let (x_low, x_high) = (x[0].min(x[1]).min(x[2]), x[0].max(x[1]).max(x[2]));
        let (y_low, y_high) = (y[0].min(y[1]).min(y[2]), y[0].max(y[1]).max(y[2]));
        let last = self.size as i32 - 1;
        let (column_0, column_1) = (x_low as i32, (x_high as i32).min(last));
        let (row_0, row_1) = (y_low as i32, (y_high as i32).min(last));
        let small = column_1 - column_0 <= 1 && row_1 - row_0 <= 1;
        let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
        if small {
            if importance > 0.0 {
                for row in row_0..=row_1 {
                    for column in column_0..=column_1 {
                        self.need(row * (last + 1) + column, importance);
                    }
                }
            }
            if counting == Counting::Area {
                // The whole area where the middle is: half a pixel off at most.
                let parts = (0.5 * area.abs() * FRACTION + chance(x, y)) as u32;
                if parts > 0 {
                    let pixel = middle(y).min(last) * (last + 1) + middle(x).min(last);
                    counts[pixel as usize] += parts;
                }
                return;
            }
        }
        self.mark_rows(
            x,
            y,
            [column_0, column_1, row_0, row_1],
            area,
            importance,
            small,
            counts,
        );
    }

    /// Marks row by row: importance where the triangle touches a pixel, fragments where it covers its centre.
    fn mark_rows(
        &self,
        x: [f32; 3],
        y: [f32; 3],
        [column_0, column_1, row_0, row_1]: [i32; 4],
        area: f32,
        importance: f32,
        marked: bool,
        counts: &mut [u32],
    ) {
        for row in row_0..=row_1 {
            let (top, bottom) = (row as f32, row as f32 + 1.0);
            let center = top + 0.5;
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            let (mut left, mut right) = (f32::INFINITY, f32::NEG_INFINITY);
            for k in 0..3 {
                let j = (k + 1) % 3;
                // The lower end first, so that two triangles find the same point on the edge that they share.
                let (p, q) = if y[k] <= y[j] { (k, j) } else { (j, k) };
                if y[p] > bottom || y[q] < top {
                    continue;
                }
                let slope = (x[q] - x[p]) / (y[q] - y[p]);
                let at = |line: f32| {
                    if line <= y[p] {
                        x[p]
                    } else if line >= y[q] {
                        x[q]
                    } else {
                        x[p] + slope * (line - y[p])
                    }
                };
                for end in [at(top), at(bottom)] {
                    (low, high) = (low.min(end), high.max(end));
                }
                if y[p] <= center && center < y[q] {
                    let end = at(center);
                    (left, right) = (left.min(end), right.max(end));
                }
            }
            let line = row * self.size as i32;
            if importance > 0.0 && !marked && low <= high {
                for column in (low as i32).max(column_0)..=(high as i32).min(column_1) {
                    self.need(line + column, importance);
                }
            }
            if area != 0.0 && left < right {
                let first = ((left - 0.5).ceil() as i32).max(column_0);
                let end = ((right - 0.5).ceil() as i32).min(column_1 + 1);
                for column in first..end {
                    counts[(line + column) as usize] += FRACTION as u32;
                }
            }
        }
    }

    #[inline]
    fn need(&self, pixel: i32, importance: f32) {
        // Bits of positive floats are ordered as the floats are. Most pixels know already: look before locking.
        let bits = importance.to_bits();
        let cell = &self.importance_bits[pixel as usize];
        if cell.load(Relaxed) < bits {
            cell.fetch_max(bits, Relaxed);
        }
    }

    /// Makes the mipmaps: of the importance the largest, of the fragments the mean.
    pub fn reduce(&mut self) {
        let bits = self.importance_bits.par_iter_mut();
        (&mut self.importance[0], bits)
            .into_par_iter()
            .with_min_len(1 << 14)
            .for_each(|(to, from)| *to = f32::from_bits(*from.get_mut()));
        let counts = &self.counts;
        self.fragments[0]
            .par_chunks_mut(1 << 14)
            .enumerate()
            .for_each(|(chunk, to)| {
                for (i, to) in to.iter_mut().enumerate() {
                    let pixel = (chunk << 14) + i;
                    let sum: u32 = counts.iter().map(|counts| counts[pixel]).sum();
                    *to = sum as f32 * (1.0 / FRACTION);
                }
            });
        for level in 1..self.importance.len() {
            let size = (self.size >> level) as usize;
            halve(&mut self.importance, level, size, |a, b, c, d| {
                a.max(b).max(c).max(d)
            });
            halve(&mut self.fragments, level, size, |a, b, c, d| {
                (a + b + c + d) * 0.25
            });
        }
    }
}

/// The pixel of a triangle's middle.
#[inline(always)]
fn middle(c: [f32; 3]) -> i32 {
    ((c[0] + c[1] + c[2]) * (1.0 / 3.0)) as i32
}

/// What decides whether parts are rounded up, or the many triangles below 1/512 pixel would vanish: in `[0, 1)`.
#[inline(always)]
fn chance(x: [f32; 3], y: [f32; 3]) -> f32 {
    let mixed = (x[0] * 61.8 + y[1] * 75.4).abs();
    mixed - mixed.trunc()
}

multiversion! {
    fn render(
        maps: &Maps,
        triangles: &Triangles,
        frame: &Frame,
        counting: Counting,
        blocks: Range<usize>,
        counts: &mut [u32],
    ) = render_lanes
}

/// Sixteen triangles that lie on fewer pixels than this, across and down, mark all of them at once; each counts where its middle is.
const NEAR: i32 = 4;

/// Blocks of sixteen triangles; those that lie on a few pixels mark them once for all.
#[inline(always)]
fn render_lanes(
    maps: &Maps,
    triangles: &Triangles,
    frame: &Frame,
    counting: Counting,
    blocks: Range<usize>,
    counts: &mut [u32],
) {
    let last = maps.size as i32 - 1;
    for number in blocks {
        let window = frame.window(&triangles.blocks()[number]);
        let first = number * LANES;
        let count = LANES.min(triangles.len() - first);
        let importance = &triangles.importance()[first..first + count];
        let (mut box_low, mut box_high) = ([0; 2], [0; 2]);
        for axis in 0..2 {
            let [a, b, c] = [3 * axis, 3 * axis + 1, 3 * axis + 2];
            let (mut lows, mut highs) = ([0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                // The lanes beyond the last triangle repeat it.
                let lane_of = if lane < count { lane } else { count - 1 };
                let (a, b, c) = (window[a][lane_of], window[b][lane_of], window[c][lane_of]);
                lows[lane] = low(a, low(b, c));
                highs[lane] = high(a, high(b, c));
            }
            for half in [8, 4, 2, 1] {
                for lane in 0..half {
                    lows[lane] = low(lows[lane], lows[lane + half]);
                    highs[lane] = high(highs[lane], highs[lane + half]);
                }
            }
            box_low[axis] = (lows[0] as i32).clamp(0, last);
            box_high[axis] = (highs[0] as i32).clamp(0, last);
        }
        let wide = (0..2).fold(0, |wide, axis| wide.max(box_high[axis] - box_low[axis]));
        if wide < NEAR && counting == Counting::Area {
            let need = importance.iter().fold(0.0, |a, &b| high(a, b));
            if need > 0.0 {
                for row in box_low[1]..=box_high[1] {
                    for column in box_low[0]..=box_high[0] {
                        maps.need(row * (last + 1) + column, need);
                    }
                }
            }
            let mut parts = [0.0; LANES];
            let mut pixels = [0; LANES];
            for lane in 0..LANES {
                let x = [window[0][lane], window[1][lane], window[2][lane]];
                let y = [window[3][lane], window[4][lane], window[5][lane]];
                let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
                parts[lane] = 0.5 * FRACTION * area.abs() + chance(x, y);
                pixels[lane] = middle(y).min(last) * (last + 1) + middle(x).min(last);
            }
            for lane in 0..count {
                let parts = parts[lane] as u32;
                if parts > 0 {
                    counts[pixels[lane] as usize] += parts;
                }
            }
            continue;
        }
        for lane in 0..count {
            let x = [window[0][lane], window[1][lane], window[2][lane]];
            let y = [window[3][lane], window[4][lane], window[5][lane]];
            maps.mark(x, y, importance[lane], counting, counts);
        }
    }
}

fn halve(
    levels: &mut [Vec<f32>],
    level: usize,
    size: usize,
    join: impl Fn(f32, f32, f32, f32) -> f32 + Sync,
) {
    let (finer, coarser) = levels.split_at_mut(level);
    let finer = &finer[level - 1];
    coarser[0]
        .par_chunks_mut(size)
        .enumerate()
        .with_min_len((1 << 14) / size)
        .for_each(|(row, to)| {
            let rows = &finer[4 * size * row..][..4 * size];
            for (column, to) in to.iter_mut().enumerate() {
                let at = |k: usize| rows[2 * column + k];
                *to = join(at(0), at(1), at(2 * size), at(2 * size + 1));
            }
        });
}
