//! Pictures with an uncertainty in every pixel, and a test that two of them show the same.
//!
//! The test of Mitsuba 3's `test_renders.py`, made stricter: every pixel and channel is compared by Welch's t-test, the
//! rates of false alarms of all of them are corrected after Šidák, and not one may fail. A second look at blocks of pixels
//! finds structured differences that hide in the noise of single pixels.

use crate::distribution::sidak;
use crate::estimate::Estimate;
use crate::golden;
use std::fmt;

/// A picture of estimates.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    channels: usize,
    pixels: Vec<Estimate>,
}

impl Picture {
    /// From independent renderings (other seeds) of one picture: row by row from the top, channels interleaved.
    /// At least two; eight or more make a sharp test.
    ///
    /// # Panics
    /// If the renderings do not all have `width * height * channels` values.
    pub fn from_runs(width: usize, height: usize, channels: usize, runs: &[Vec<f32>]) -> Self {
        assert!(
            runs.iter()
                .all(|run| run.len() == width * height * channels)
        );
        let pixels = (0..width * height * channels)
            .map(|i| Estimate::of(runs.iter().map(|run| f64::from(run[i]))));
        Self {
            width,
            height,
            channels,
            pixels: pixels.collect(),
        }
    }

    /// From the mean and the variance of the mean of `samples` samples a pixel.
    ///
    /// # Panics
    /// If the slices do not have `width * height * channels` values.
    pub fn from_variance(
        width: usize,
        height: usize,
        channels: usize,
        mean: &[f32],
        variance: &[f32],
        samples: f64,
    ) -> Self {
        assert!(mean.len() == width * height * channels && mean.len() == variance.len());
        let estimate = |(&m, &v): (&f32, &f32)| Estimate {
            mean: f64::from(m),
            variance: f64::from(v),
            samples,
        };
        Self {
            width,
            height,
            channels,
            pixels: mean.iter().zip(variance).map(estimate).collect(),
        }
    }

    /// A picture that is known exactly, the same in every pixel.
    pub fn constant(width: usize, height: usize, colour: &[f64]) -> Self {
        let pixels = (0..width * height).flat_map(|_| colour.iter().map(|&c| Estimate::exact(c)));
        Self {
            width,
            height,
            channels: colour.len(),
            pixels: pixels.collect(),
        }
    }

    /// Means over blocks of `side` x `side` pixels (smaller at the right and lower edge); pixels count as independent.
    pub fn blocks(&self, side: usize) -> Self {
        let (width, height) = (self.width.div_ceil(side), self.height.div_ceil(side));
        let mut sums = vec![(0.0, 0.0, 0.0, 0.0f64); width * height * self.channels];
        for (i, e) in self.pixels.iter().enumerate() {
            let (pixel, channel) = (i / self.channels, i % self.channels);
            let block = pixel / self.width / side * width + pixel % self.width / side;
            let sum = &mut sums[block * self.channels + channel];
            sum.0 += 1.0;
            sum.1 += e.mean;
            sum.2 += e.variance;
            // Welch and Satterthwaite's degrees of freedom of a sum.
            sum.3 += e.variance * e.variance / (e.samples - 1.0);
        }
        let estimate = |&(n, mean, variance, shares): &(f64, f64, f64, f64)| Estimate {
            mean: mean / n,
            variance: variance / (n * n),
            samples: if shares > 0.0 {
                variance * variance / shares + 1.0
            } else {
                f64::INFINITY
            },
        };
        Self {
            width,
            height,
            channels: self.channels,
            pixels: sums.iter().map(estimate).collect(),
        }
    }

    /// The estimates, row by row from the top, channels interleaved.
    pub fn pixels(&self) -> &[Estimate] {
        &self.pixels
    }

    /// Whether both pictures may show the same. `significance` is the probability that the whole test fails although they
    /// do; half of it goes to single pixels, half to blocks of 8 x 8.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn test(&self, other: &Self, significance: f64) -> Result<(), Difference> {
        self.compare(other, significance / 2.0, 1)?;
        self.blocks(8)
            .compare(&other.blocks(8), significance / 2.0, 8)
    }

    fn compare(&self, other: &Self, significance: f64, side: usize) -> Result<(), Difference> {
        let shape = |p: &Self| (p.width, p.height, p.channels);
        assert_eq!(shape(self), shape(other), "sizes differ");
        let limit = sidak(significance, self.pixels.len());
        let probability: Vec<f64> = self
            .pixels
            .iter()
            .zip(&other.pixels)
            .map(|(a, b)| a.same(b))
            .collect();
        let failed = probability.iter().filter(|&&p| p < limit).count();
        if failed == 0 {
            return Ok(());
        }
        let worst = (0..probability.len())
            .min_by(|&a, &b| probability[a].total_cmp(&probability[b]))
            .unwrap_or(0);
        let pixel = worst / self.channels;
        Err(Difference {
            side,
            failed,
            tests: probability.len(),
            place: (
                pixel % self.width * side,
                pixel / self.width * side,
                worst % self.channels,
            ),
            probability: probability[worst],
            limit,
            found: self.pixels[worst],
            expected: other.pixels[worst],
        })
    }

    /// Panics if the pictures differ; see [`Picture::test`]. Evidence is written as `name.png` into the folder for
    /// temporary files of the test: found, expected, and the difference in standard deviations (grey is 0, red more, blue
    /// less; full colour is 5).
    ///
    /// # Panics
    /// If the pictures differ.
    pub fn assert_same(&self, expected: &Self, significance: f64, name: &str) {
        if let Err(difference) = self.test(expected, significance) {
            let evidence = golden::write_evidence(name, self, expected);
            panic!("{name}: {difference}; {evidence}");
        }
    }

    pub(crate) fn size(&self) -> (usize, usize, usize) {
        (self.width, self.height, self.channels)
    }
}

/// Where and how much two pictures differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Side of the blocks that were compared, pixels.
    pub side: usize,
    /// Values that differ.
    pub failed: usize,
    /// Values compared.
    pub tests: usize,
    /// Column, row (of pixels) and channel of the worst.
    pub place: (usize, usize, usize),
    /// Probability of a difference as large as the worst, were both the same.
    pub probability: f64,
    /// The probability below which a value counts as different.
    pub limit: f64,
    /// The first picture there.
    pub found: Estimate,
    /// The second picture there.
    pub expected: Estimate,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (x, y, channel) = self.place;
        write!(
            f,
            "{} of {} values differ (blocks of {} pixels), worst at column {x}, row {y}, channel {channel}: {:.6} +- {:.6}, \
             expected {:.6} +- {:.6}, probability {:.1e}, limit {:.1e}",
            self.failed,
            self.tests,
            self.side,
            self.found.mean,
            self.found.variance.sqrt(),
            self.expected.mean,
            self.expected.variance.sqrt(),
            self.probability,
            self.limit
        )
    }
}

impl std::error::Error for Difference {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Renderings of a gradient with uniform noise.
    fn runs(count: usize, seed: u64, bias: impl Fn(usize) -> f32) -> Vec<Vec<f32>> {
        let mut state = seed;
        let mut noise = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        let value = |i: usize, noise: f32| i as f32 * 1e-4 + bias(i) + 0.2 * noise;
        (0..count)
            .map(|_| (0..32 * 16 * 3).map(|i| value(i, noise())).collect())
            .collect()
    }

    fn picture(seed: u64, bias: impl Fn(usize) -> f32) -> Picture {
        Picture::from_runs(32, 16, 3, &runs(12, seed, bias))
    }

    #[test]
    fn equal_pictures_pass_as_often_as_stated() {
        let passed = (0..100).filter(|&s| {
            picture(2 * s + 1, |_| 0.0)
                .test(&picture(2 * s + 2, |_| 0.0), 0.05)
                .is_ok()
        });
        // Binomial(100, 0.95): at least 87 with probability 0.9985. Uniform noise is close to normal, not equal.
        assert!(passed.count() >= 87);
    }

    #[test]
    fn finds_one_wrong_pixel_and_a_faint_wrong_region() {
        let pixel = picture(1, |i| if i == 700 { 0.5 } else { 0.0 })
            .test(&picture(2, |_| 0.0), 1e-3)
            .unwrap_err();
        assert_eq!(
            (pixel.side, pixel.place, pixel.failed),
            (1, (700 / 3 % 32, 700 / 96, 700 % 3), 1)
        );
        let region = picture(1, |i| if i < 800 { 0.02 } else { 0.0 })
            .test(&picture(2, |_| 0.0), 1e-3)
            .unwrap_err();
        assert_eq!(region.side, 8);
    }

    #[test]
    fn exact_pictures_compare_exactly() {
        let grey = Picture::constant(9, 9, &[0.5, 0.5]);
        assert!(grey.test(&grey, 1e-3).is_ok());
        let wrong = grey
            .test(&Picture::constant(9, 9, &[0.5, 0.501]), 1e-3)
            .unwrap_err();
        assert_eq!((wrong.failed, wrong.probability), (81, 0.0));
        let nan = Picture::constant(9, 9, &[f64::NAN, 0.5]);
        assert!(nan.test(&grey, 1e-3).is_err());
    }

    #[test]
    fn blocks_average_also_at_the_edge() {
        let picture =
            Picture::from_variance(3, 1, 1, &[1.0, 3.0, 8.0], &[0.5, 1.5, 0.25], 10.0).blocks(2);
        let [a, b] = [picture.pixels()[0], picture.pixels()[1]];
        assert_eq!(
            (a.mean, a.variance, b.mean, b.variance, b.samples),
            (2.0, 0.5, 8.0, 0.25, 10.0)
        );
        assert!((a.samples - (4.0 / (2.5 / 9.0) + 1.0)).abs() < 1e-9);
    }
}
