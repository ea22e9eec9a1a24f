//! What is done to gathered light before it is written: invalid texels are filled, noise is smoothed, seams are closed, gutters are
//! filled.
//!
//! The order matters: [`Canvas::fill_invalid`], [`adopt`](orphans::adopt), [`denoise`](denoise::denoise), [`Canvas::dilate`], [`stitch`](seams::stitch). Nothing but
//! stitching mixes charts, so light does not leak from one to another.

pub mod denoise;
pub mod orphans;
pub mod seams;

use crate::texel::{Fragment, Texels};
use rayon::prelude::*;

/// A page while it is finished.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Canvas {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Values, row by row.
    pub values: Vec<[f32; 3]>,
    /// The chart that a texel belongs to, counted through the page from 1; 0: none.
    pub charts: Vec<u32>,
    /// How far a texel's value can be trusted, 0 to 1.
    pub validity: Vec<f32>,
}

/// Texels below this are not used.
pub const LEAST_VALIDITY: f32 = 0.5;

/// Rows that are rasterized at a time.
const ROWS: u32 = 32;

impl Canvas {
    /// Bytes of a texel.
    pub const BYTES_PER_TEXEL: u64 = 20;

    /// A page with the charts of its texels; all values 0 and valid.
    pub fn new(texels: &Texels, page: u32) -> Self {
        let size = texels.atlas.pages[page as usize];
        let count = size.texels() as usize;
        let mut canvas = Self {
            width: size.width,
            height: size.height,
            values: vec![[0.0; 3]; count],
            charts: vec![0; count],
            validity: vec![1.0; count],
        };
        let first = texels.first_charts(page);
        let row_texels = (size.width * ROWS) as usize;
        canvas
            .charts
            .par_chunks_mut(row_texels)
            .enumerate()
            .for_each(|(k, rows)| {
                let top = k as u32 * ROWS;
                let band = texels.band(page, top..(top + ROWS).min(size.height));
                for i in 0..band.len() {
                    // The chart with most of the texel has it.
                    let fragments = band.fragments(i);
                    let larger = |a: Fragment, b: &Fragment| if b.area > a.area { *b } else { a };
                    let most = fragments.iter().fold(fragments[0], larger);
                    let local = band.texel(i) - size.texel(0, top);
                    let chart = texels.chart(most.instance, most.primitive);
                    if let (Some(chart), Some(&first)) = (
                        chart,
                        first.get(&(most.instance, texels.piece(most.instance, most.primitive))),
                    ) {
                        rows[local as usize] = first + chart + 1;
                    }
                }
            });
        canvas
    }

    /// Marks texels as invalid of which less than `least` is covered, if a neighbour of the same chart has four times as much: what few lines
    /// have met is worth less than what their neighbours know.
    pub fn distrust_rims(&mut self, texels: &Texels, page: u32, least: f32) {
        let size = texels.atlas.pages[page as usize];
        let mut coverage = vec![0.0_f32; self.charts.len()];
        coverage
            .par_chunks_mut((size.width * ROWS) as usize)
            .enumerate()
            .for_each(|(k, rows)| {
                let top = k as u32 * ROWS;
                let band = texels.band(page, top..(top + ROWS).min(size.height));
                for i in 0..band.len() {
                    let area = band.fragments(i).iter().map(|f| f.area).sum();
                    rows[(band.texel(i) - size.texel(0, top)) as usize] = area;
                }
            });
        let poor: Vec<usize> = (0..self.charts.len())
            .into_par_iter()
            .filter(|&i| self.charts[i] != 0 && coverage[i] < least)
            .filter(|&i| {
                self.neighbours(i).any(|n| {
                    self.charts[n] == self.charts[i]
                        && self.validity[n] >= LEAST_VALIDITY
                        && coverage[n] >= (4.0 * coverage[i]).max(least)
                })
            })
            .collect();
        for i in poor {
            self.validity[i] = 0.0;
        }
    }

    /// Indices of the up to eight neighbours of a texel.
    fn neighbours(&self, i: usize) -> impl Iterator<Item = usize> + use<> {
        let (w, h) = (self.width as i64, self.height as i64);
        let (x, y) = (i as i64 % w, i as i64 / w);
        const AROUND: [(i64, i64); 8] = [
            (-1, -1),
            (0, -1),
            (1, -1),
            (-1, 0),
            (1, 0),
            (-1, 1),
            (0, 1),
            (1, 1),
        ];
        AROUND.into_iter().filter_map(move |(dx, dy)| {
            let (x, y) = (x + dx, y + dy);
            (x >= 0 && y >= 0 && x < w && y < h).then_some((y * w + x) as usize)
        })
    }

    /// Gives invalid texels the mean of their valid neighbours of the same chart, from the border inwards. A chart without a valid texel stays as it is.
    /// Returns how many were filled.
    pub fn fill_invalid(&mut self) -> u64 {
        let mut open: Vec<usize> = (0..self.values.len())
            .filter(|&i| self.charts[i] != 0 && self.validity[i] < LEAST_VALIDITY)
            .collect();
        let mut known: Vec<bool> = self
            .charts
            .iter()
            .zip(&self.validity)
            .map(|(&c, &v)| c != 0 && v >= LEAST_VALIDITY)
            .collect();
        let mut filled = 0;
        while !open.is_empty() {
            let found: Vec<(usize, [f32; 3])> = open
                .par_iter()
                .filter_map(|&i| {
                    self.mean_around(i, |n| known[n] && self.charts[n] == self.charts[i])
                        .map(|v| (i, v))
                })
                .collect();
            if found.is_empty() {
                break;
            }
            filled += found.len() as u64;
            for (i, value) in found {
                self.values[i] = value;
                known[i] = true;
            }
            open.retain(|&i| !known[i]);
        }
        filled
    }

    fn mean_around(&self, i: usize, counts: impl Fn(usize) -> bool) -> Option<[f32; 3]> {
        let (mut sum, mut number) = ([0.0_f32; 3], 0.0);
        for n in self.neighbours(i).filter(|&n| counts(n)) {
            (0..3).for_each(|c| sum[c] += self.values[n][c]);
            number += 1.0;
        }
        (number > 0.0).then(|| sum.map(|s| s / number))
    }

    /// Fills texels around charts, `rings` deep, with the mean of what is beside them. Charts themselves stay.
    pub fn dilate(&mut self, rings: u32) {
        let mut known: Vec<bool> = self.charts.iter().map(|&c| c != 0).collect();
        let mut border: Vec<usize> = (0..known.len())
            .into_par_iter()
            .filter(|&i| !known[i] && self.neighbours(i).any(|n| known[n]))
            .collect();
        for _ in 0..rings {
            let found: Vec<(usize, [f32; 3])> = border
                .par_iter()
                .filter_map(|&i| self.mean_around(i, |n| known[n]).map(|v| (i, v)))
                .collect();
            for &(i, value) in &found {
                self.values[i] = value;
                known[i] = true;
            }
            border = found
                .iter()
                .flat_map(|&(i, _)| self.neighbours(i))
                .filter(|&n| !known[n])
                .collect();
            border.sort_unstable();
            border.dedup();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two charts of 3 by 3 texels, two apart, on a page of 10 by 5; the middle of the first is invalid.
    fn canvas() -> Canvas {
        let mut canvas = Canvas {
            width: 10,
            height: 5,
            values: vec![[0.0; 3]; 50],
            charts: vec![0; 50],
            validity: vec![1.0; 50],
        };
        for y in 1..4 {
            for x in 0..3 {
                let (a, b) = (y * 10 + 1 + x, y * 10 + 6 + x);
                (canvas.charts[a], canvas.charts[b]) = (1, 2);
                (canvas.values[a], canvas.values[b]) = ([1.0; 3], [5.0; 3]);
            }
        }
        canvas.validity[22] = 0.0;
        canvas.values[22] = [-7.0; 3];
        canvas
    }

    #[test]
    fn invalid_texels_take_their_own_charts_values() {
        let mut canvas = canvas();
        assert_eq!(canvas.fill_invalid(), 1);
        assert_eq!(canvas.values[22], [1.0; 3]);
        // A chart of which nothing is valid keeps what it has.
        canvas.validity.fill(0.0);
        let before = canvas.clone();
        assert_eq!(canvas.fill_invalid(), 0);
        assert_eq!(canvas, before);
    }

    #[test]
    fn dilation_fills_gutters_and_leaves_charts() {
        let mut canvas = canvas();
        canvas.fill_invalid();
        let before = canvas.clone();
        canvas.dilate(1);
        for i in 0..50 {
            let expected = match i % 10 {
                _ if before.charts[i] != 0 => before.values[i],
                0..=4 => [1.0; 3],
                _ => [5.0; 3],
            };
            assert_eq!(canvas.values[i], expected, "texel {i}");
        }
    }
}
