//! The unbiased guarantee: how many rays it saves, and what it adds to the variance.
//!
//! Direct light, several seeds a side. Variances of blocks are compared in two ways: of each block's mean over the seeds (as a
//! viewer of a downscaled picture sees it; noisy with few seeds), and of its pixels, pooled.

use super::quality::blocks;
use super::shot::{Stage, Task};
use super::subject::Subject;
use super::{Plan, fixed};
use crate::common::{Report, Row, Setting};
use occlude_image::Picture;
use occlude_render::integrator::{Integrator, PathLimits};
use occlude_visibility::Exact;
use occlude_visibility::quantized::Guarantee;

const FEWER_RAYS: f64 = 10.0;
const MORE_VARIANCE: f64 = 1.2;

const TITLE: &str = "Unbiased: direct light";
const HEADER: &[&str] = &[
    "scene",
    "samples",
    "seeds a side",
    "rays /",
    "faster",
    "pixel variance, median of blocks",
    "pixel variance, 95 % of blocks",
    "block variance, median",
    "block variance, 95 %",
    "largest t of blocks",
];

pub fn run(setting: &Setting, plan: &Plan, report: &mut Report, subject: &Subject, stage: &Stage) {
    let (seeds, samples) = if setting.quick { (4, 4) } else { (16, 16) };
    let size = if setting.quick {
        [64, 64]
    } else {
        plan.size.map(|side| side.min(256))
    };
    let task = |seed| Task {
        integrator: Integrator::Path(PathLimits::new(1)),
        size,
        samples,
        seed,
        single_passes: false,
    };
    let (mut exact, mut cached) = (Moments::new(size), Moments::new(size));
    let (mut queries, mut traced, mut seconds) = (0, 0, [0.0; 2]);
    for seed in 0..seeds {
        let shot = stage.shoot(&Exact, &task(seed));
        seconds[0] += shot.seconds;
        exact.add(&shot.picture);
        let task = task(1000 + seed);
        let strategy = stage.quantized(&task, Guarantee::Unbiased, |_| ());
        let shot = stage.shoot(&strategy, &task);
        seconds[1] += shot.seconds;
        cached.add(&shot.picture);
        queries += shot.report.visibility.queries;
        traced += shot.report.visibility.traced;
    }
    let reduction = queries as f64 / traced.max(1) as f64;
    let ratios = |a: Vec<f64>, b: Vec<f64>| {
        // Blocks that no light reaches vary on neither side.
        let least = 1e-9 * b.iter().copied().fold(0.0, f64::max);
        let pairs = a.into_iter().zip(b).filter(|&(_, b)| b > least);
        let mut ratios: Vec<f64> = pairs.map(|(a, b)| a / b).collect();
        ratios.sort_by(f64::total_cmp);
        let at = |share: f64| match ratios.len() {
            0 => f64::NAN,
            n => ratios[((n - 1) as f64 * share).round() as usize],
        };
        [at(0.5), at(0.95)]
    };
    let [pixel, pixel_95] = ratios(cached.pixel_variances(), exact.pixel_variances());
    let [block, block_95] = ratios(cached.block_variances(), exact.block_variances());
    report.table(
        TITLE,
        HEADER,
        vec![
            subject.name.into(),
            samples.to_string(),
            seeds.to_string(),
            fixed(reduction),
            fixed(seconds[0] / seconds[1]),
            fixed(pixel),
            fixed(pixel_95),
            fixed(block),
            fixed(block_95),
            fixed(cached.largest_t(&exact)),
        ],
    );
    for (what, value) in [
        ("reduction", reduction),
        ("pixel_variance", pixel),
        ("pixel_variance_95", pixel_95),
        ("block_variance", block),
        ("block_variance_95", block_95),
    ] {
        report.raw(&format!(
            "unbiased,{},{samples},cached,,{what},{value:.6},1",
            subject.name
        ));
    }
    let mut row = |name: &str, value: f64, bar: String, holds: bool| {
        report.row(Row {
            name: name.into(),
            scene: subject.name.into(),
            value,
            unit: "times".into(),
            baseline: None,
            ratio: None,
            spread: None,
            bar: Some(bar),
            holds: Some(holds),
        });
    };
    row(
        "unbiased, fewer rays",
        reduction,
        format!(">= {FEWER_RAYS}"),
        reduction >= FEWER_RAYS,
    );
    for (name, value) in [
        ("unbiased, variance, median block", pixel),
        ("unbiased, variance, 95 % of blocks", pixel_95),
    ] {
        row(
            name,
            value,
            format!("<= {MORE_VARIANCE}"),
            value <= MORE_VARIANCE,
        );
    }
}

/// Sums over the pictures of one side.
struct Moments {
    size: [u32; 2],
    count: f64,
    /// Of luminances: sum and sum of squares, of pixels and of blocks.
    pixels: Vec<[f64; 2]>,
    blocks: Vec<[f64; 2]>,
}

impl Moments {
    fn new(size: [u32; 2]) -> Self {
        let pixels = vec![[0.0; 2]; (size[0] * size[1]) as usize];
        Self {
            size,
            count: 0.0,
            pixels,
            blocks: Vec::new(),
        }
    }

    fn add(&mut self, picture: &Picture) {
        let [width, height] = self.size;
        let luminance: Vec<f32> = picture
            .pixels
            .iter()
            .map(|c| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2])
            .collect();
        self.count += 1.0;
        let means = blocks(&luminance, width, height);
        self.blocks.resize(means.len(), [0.0; 2]);
        let pixels = self
            .pixels
            .iter_mut()
            .zip(luminance.iter().map(|&v| f64::from(v)));
        let blocks = self
            .blocks
            .iter_mut()
            .zip(means.iter().map(|(_, mean)| *mean));
        for (sums, value) in pixels.chain(blocks) {
            sums[0] += value;
            sums[1] += value * value;
        }
    }

    fn variance(&self, [sum, squares]: [f64; 2]) -> f64 {
        ((squares - sum * sum / self.count) / (self.count - 1.0)).max(0.0)
    }

    /// The mean variance of a pixel, block by block.
    fn pixel_variances(&self) -> Vec<f64> {
        let [width, height] = self.size;
        let variances: Vec<f32> = self
            .pixels
            .iter()
            .map(|&p| self.variance(p) as f32)
            .collect();
        let means = blocks(&variances, width, height);
        means.into_iter().map(|(_, mean)| mean).collect()
    }

    fn block_variances(&self) -> Vec<f64> {
        self.blocks.iter().map(|&b| self.variance(b)).collect()
    }

    /// Welch's t of the block that differs most in the mean.
    fn largest_t(&self, other: &Self) -> f64 {
        let pairs = self.blocks.iter().zip(&other.blocks);
        pairs
            .map(|(a, b)| {
                let error = self.variance(*a) / self.count + other.variance(*b) / other.count;
                let difference = a[0] / self.count - b[0] / other.count;
                if error > 0.0 {
                    difference.abs() / error.sqrt()
                } else {
                    0.0
                }
            })
            .fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::super::quality::BLOCK;
    use super::*;

    #[test]
    fn variances_are_those_of_the_numbers() {
        let mut moments = Moments::new([BLOCK, BLOCK]);
        for value in [1.0, 2.0, 3.0, 4.0] {
            let pixels = vec![[value; 3]; (BLOCK * BLOCK) as usize];
            moments.add(&Picture::from_pixels(BLOCK, BLOCK, pixels).unwrap());
        }
        for variance in [moments.pixel_variances()[0], moments.block_variances()[0]] {
            assert!((variance - 5.0 / 3.0).abs() < 1e-4, "{variance}");
        }
        assert_eq!(moments.largest_t(&moments), 0.0);
    }
}
