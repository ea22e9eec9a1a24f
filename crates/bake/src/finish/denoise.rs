//! Smoothing what noise is left: non-local means (Buades, Coll & Morel 2005) inside of each chart.
//!
//! Patches are compared relative to the noise that the light map itself shows: its standard deviation is estimated by the median of absolute
//! differences of a Laplacian, block by block. Texels of other charts, and invalid ones, take no part, so borders of charts and of validity stay.
//!
//! Class: biased; details weaker than the noise go. Wrong for maps that are converged already: leave it off.

use super::{Canvas, LEAST_VALIDITY};
use glam::Vec3;
use rayon::prelude::*;

/// How texels around are searched for like ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenoiseSettings {
    /// Reach of the search in texels. Higher: smoother, slower (with the square). Default 6.
    pub reach: u32,
    /// Half the side of patches that are compared, texels. Default 1.
    pub patch: u32,
    /// Differences up to this many standard deviations of the noise count as noise. Default 1.5.
    pub strength: f32,
}

impl Default for DenoiseSettings {
    fn default() -> Self {
        Self {
            reach: 6,
            patch: 1,
            strength: 1.5,
        }
    }
}

/// Side of the blocks for which noise is estimated.
const BLOCK: usize = 32;

/// Smooths a page.
pub fn denoise(canvas: &mut Canvas, settings: &DenoiseSettings) {
    let noise = Noise::of(canvas);
    let (width, reach, patch) = (
        canvas.width as i64,
        i64::from(settings.reach),
        i64::from(settings.patch),
    );
    let height = i64::from(canvas.height);
    let source = &*canvas;
    let usable = |i: usize| source.charts[i] != 0 && source.validity[i] >= LEAST_VALIDITY;
    let index = |x: i64, y: i64| {
        (x >= 0 && y >= 0 && x < width && y < height).then(|| (y * width + x) as usize)
    };
    let smooth = |i: usize| {
        if !usable(i) {
            return source.values[i];
        }
        let chart = source.charts[i];
        let (x, y) = (i as i64 % width, i as i64 / width);
        let variance = Vec3::from(noise.at(i)) * settings.strength;
        let variance = (variance * variance).max(Vec3::splat(1e-20));
        let (mut sum, mut total) = (Vec3::ZERO, 0.0_f32);
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let Some(j) =
                    index(x + dx, y + dy).filter(|&j| source.charts[j] == chart && usable(j))
                else {
                    continue;
                };
                let (mut distance, mut count) = (0.0, 0.0_f32);
                for py in -patch..=patch {
                    for px in -patch..=patch {
                        let (Some(a), Some(b)) =
                            (index(x + px, y + py), index(x + dx + px, y + dy + py))
                        else {
                            continue;
                        };
                        if source.charts[a] != chart || source.charts[b] != chart {
                            continue;
                        }
                        let d = Vec3::from(source.values[a]) - Vec3::from(source.values[b]);
                        distance += (d * d / variance).element_sum();
                        count += 3.0;
                    }
                }
                // Two noisy patches differ by twice the variance.
                let excess = (distance / count.max(1.0) - 2.0).max(0.0);
                let weight = (-excess).exp();
                sum += weight * Vec3::from(source.values[j]);
                total += weight;
            }
        }
        (sum / total).to_array()
    };
    canvas.values = (0..source.values.len())
        .into_par_iter()
        .map(smooth)
        .collect();
}

/// Standard deviations of the noise by block.
struct Noise {
    width: usize,
    blocks: Vec<[f32; 3]>,
    across: usize,
}

impl Noise {
    fn of(canvas: &Canvas) -> Self {
        let (width, height) = (canvas.width as usize, canvas.height as usize);
        let (across, down) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        let of_block = |b: usize| {
            let (left, top) = (b % across * BLOCK, b / across * BLOCK);
            let mut found: [Vec<f32>; 3] = Default::default();
            for y in top.max(1)..(top + BLOCK).min(height.saturating_sub(1)) {
                for x in left.max(1)..(left + BLOCK).min(width.saturating_sub(1)) {
                    let i = y * width + x;
                    let around = [i - 1, i + 1, i - width, i + width];
                    let chart = canvas.charts[i];
                    if chart == 0 || around.iter().any(|&n| canvas.charts[n] != chart) {
                        continue;
                    }
                    for (c, found) in found.iter_mut().enumerate() {
                        let mean = around.iter().map(|&n| canvas.values[n][c]).sum::<f32>() / 4.0;
                        // The difference has 5/4 of the variance of a texel.
                        found.push((canvas.values[i][c] - mean).abs() * 0.894_427_2);
                    }
                }
            }
            found.map(|mut values| {
                let middle = values.len() / 2;
                match values.is_empty() {
                    true => 0.0,
                    // Of a normal distribution the median of absolute values is 0.6745 standard deviations.
                    false => *values.select_nth_unstable_by(middle, f32::total_cmp).1 / 0.6745,
                }
            })
        };
        let blocks = (0..across * down).into_par_iter().map(of_block).collect();
        Self {
            width,
            blocks,
            across,
        }
    }

    fn at(&self, i: usize) -> [f32; 3] {
        let (x, y) = (i % self.width, i / self.width);
        self.blocks[y / BLOCK * self.across + x / BLOCK]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_testkit::random::Random;

    #[test]
    fn noise_goes_edges_and_charts_stay() {
        let (w, h) = (96, 64);
        let mut random = Random(4);
        let mut canvas = Canvas {
            width: w,
            height: h,
            ..Canvas::default()
        };
        let mut clean = Vec::new();
        for y in 0..h {
            for x in 0..w {
                // Two charts side by side; a shadow's edge across the first.
                canvas.charts.push(1 + u32::from(x >= 48));
                let value = match (x < 48, y < 30) {
                    (true, true) => 1.0,
                    (true, false) => 0.3,
                    _ => 3.0,
                };
                let noise: f32 = (0..4).map(|_| random.unit() - 0.5).sum::<f32>() * 0.173;
                clean.push(value);
                canvas.values.push([value + noise; 3]);
                canvas.validity.push(1.0);
            }
        }
        let error = |canvas: &Canvas| {
            canvas
                .values
                .iter()
                .zip(&clean)
                .map(|(v, c)| (v[0] - c).powi(2))
                .sum::<f32>()
                / clean.len() as f32
        };
        let before = error(&canvas);
        denoise(&mut canvas, &DenoiseSettings::default());
        let after = error(&canvas);
        assert!(after < 0.08 * before, "{before} -> {after}");
        let worst = canvas
            .values
            .iter()
            .zip(&clean)
            .map(|(v, c)| (v[0] - c).abs())
            .fold(0.0, f32::max);
        assert!(worst < 0.25, "{worst}");
    }
}
