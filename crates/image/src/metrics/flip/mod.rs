//! FLIP: the difference that a viewer sees when two pictures are alternated in place.
//!
//! Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020 ([`ldr`]), and "Visualizing Errors in
//! Rendered High Dynamic Range Images", 2021 ([`hdr`]). Equation and section numbers below are those of the first
//! unless said otherwise. Agrees with the authors' `flip-evaluator` 1.7 to 1e-4 in the mean (tests).
//!
//! Own choices where that program stops with an error: against a black reference the exposures come from the other
//! picture, and where all luminances are equal one exposure is used.
//!
//! When it is the wrong tool: for bias below the eye's threshold, which it is made to ignore; use `relmse`.

mod color;
mod filter;

use rayon::prelude::*;

use self::color::{hunt_lab_from_linear, hyab, linear_from_ycxcz, ycxcz_from_linear};
use self::filter::{Features, Spatial};
use crate::picture::luminance;
use crate::{ImageError, Picture};

/// Pixels a degree of the viewer's eye: 0.7 m from a display 0.7 m wide with 3840 pixels, as in the authors' program.
pub const DEFAULT_PPD: f32 = 67.020_645;

/// Exponent of the colour difference (q_c).
const Q_COLOR: f32 = 0.7;
/// Where the compression of large colour differences starts (p_c), and what it maps to (p_t).
const P_COLOR: f32 = 0.4;
const P_TARGET: f32 = 0.95;
/// Exponent of the feature difference (q_f).
const Q_FEATURE: f32 = 0.5;

/// LDR-FLIP of every pixel, in `[0, 1]`, of pictures for display: linear light, here clipped to `[0, 1]`.
/// `pixels_per_degree` says how near the viewer is ([`DEFAULT_PPD`]); absurd values are clamped to `[1, 1000]`.
///
/// # Errors
/// [`ImageError::SizeMismatch`].
pub fn ldr(
    test: &Picture,
    reference: &Picture,
    pixels_per_degree: f32,
) -> Result<Vec<f32>, ImageError> {
    test.same_size(reference)?;
    Ok(Evaluator::new(reference, pixels_per_degree)
        .error(test, reference, |c| c.map(|v| v.clamp(0.0, 1.0))))
}

/// HDR-FLIP of every pixel, in `[0, 1]`, of scene-linear pictures: the largest LDR-FLIP over exposures that the
/// reference asks for, after an ACES-like tone map.
///
/// # Errors
/// [`ImageError::SizeMismatch`].
pub fn hdr(
    test: &Picture,
    reference: &Picture,
    pixels_per_degree: f32,
) -> Result<Vec<f32>, ImageError> {
    test.same_size(reference)?;
    let mut worst = vec![0.0f32; reference.pixels.len()];
    let range = exposures(reference).or_else(|| exposures(test));
    let Some((start, stop)) = range else {
        return Ok(worst);
    };
    let steps = if stop > start {
        ((stop - start).ceil() as usize).max(2)
    } else {
        1
    };
    let evaluator = Evaluator::new(reference, pixels_per_degree);
    for i in 0..steps {
        let ev = start + (stop - start) * i as f32 / (steps.max(2) - 1) as f32;
        let scale = ev.exp2();
        let error = evaluator.error(test, reference, |c| {
            c.map(|v| aces(v * scale).clamp(0.0, 1.0))
        });
        for (w, e) in worst.iter_mut().zip(error) {
            *w = w.max(e);
        }
    }
    Ok(worst)
}

/// Numerator and denominator of the tone map `(k0 x^2 + k1 x + k2) / (k3 x^2 + k4 x + k5)`: Narkowicz' ACES fit with
/// the exposure of 0.6 that it leaves out (2021, section 3.2).
const ACES: [f32; 6] = [
    0.6 * 0.6 * 2.51,
    0.6 * 0.03,
    0.0,
    0.6 * 0.6 * 2.43,
    0.6 * 0.59,
    0.14,
];

fn aces(x: f32) -> f32 {
    // The curve is flat long before its squares overflow.
    let x = if x > 0.0 { x.min(1e15) } else { 0.0 };
    (ACES[0] * x * x + ACES[1] * x + ACES[2]) / (ACES[3] * x * x + ACES[4] * x + ACES[5])
}

/// The exposures, in stops, at which the brightest and the median pixel are mapped to 0.85 (2021, section 3.1); `None`
/// if no pixel is bright.
fn exposures(reference: &Picture) -> Option<(f32, f32)> {
    const TARGET: f32 = 0.85;
    let mut luminances: Vec<f32> = reference.pixels.iter().map(|&p| luminance(p)).collect();
    luminances.sort_unstable_by(f32::total_cmp);
    let brightest = luminances.last().copied().filter(|l| *l > 0.0)?;
    // The authors' program keeps the median from 0 like this, and takes the upper one of an even count.
    let median = luminances[luminances.len() / 2].max(f32::EPSILON);
    let (a, b, c) = (
        ACES[0] - TARGET * ACES[3],
        ACES[1] - TARGET * ACES[4],
        ACES[2] - TARGET * ACES[5],
    );
    let half = -0.5 * b / a;
    let x = half + (half * half - c / a).sqrt();
    Some(((x / brightest).log2(), (x / median).log2()))
}

/// The pipeline of the 2020 paper (its figure 2) for one viewing distance and one size.
struct Evaluator {
    spatial: Spatial,
    features: Features,
    width: usize,
    /// The largest possible colour difference, from green to blue, to the power of q_c (eq. 11).
    largest: f32,
}

impl Evaluator {
    fn new(picture: &Picture, pixels_per_degree: f32) -> Self {
        let ppd = if pixels_per_degree.is_nan() {
            DEFAULT_PPD
        } else {
            pixels_per_degree.clamp(1.0, 1000.0)
        };
        let (green, blue) = (
            hunt_lab_from_linear([0.0, 1.0, 0.0]),
            hunt_lab_from_linear([0.0, 0.0, 1.0]),
        );
        Self {
            spatial: Spatial::new(ppd),
            features: Features::new(ppd),
            width: picture.width as usize,
            largest: hyab(green, blue).powf(Q_COLOR),
        }
    }

    /// The error of every pixel; `display` makes both pictures linear display light in `[0, 1]`.
    fn error(
        &self,
        test: &Picture,
        reference: &Picture,
        display: impl Fn([f32; 3]) -> [f32; 3] + Sync,
    ) -> Vec<f32> {
        let prepare = |p: &Picture| -> Vec<[f32; 3]> {
            p.pixels
                .par_iter()
                .map(|&c| ycxcz_from_linear(display(c)))
                .collect()
        };
        let (test, reference) = (prepare(test), prepare(reference));
        let perceived = |p: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let mut filtered = self.spatial.apply(p, self.width);
            filtered.par_iter_mut().for_each(|c| {
                *c = hunt_lab_from_linear(linear_from_ycxcz(*c).map(|v| v.clamp(0.0, 1.0)));
            });
            filtered
        };
        let colors = (perceived(&test), perceived(&reference));
        let features = (
            self.features.apply(&test, self.width),
            self.features.apply(&reference, self.width),
        );
        let each = colors
            .0
            .par_iter()
            .zip(&colors.1)
            .zip(features.0.par_iter().zip(&features.1));
        each.map(|((&a, &b), (&fa, &fb))| {
            // Eq. 21: colour difference to the power of 1 - feature difference.
            self.color_difference(a, b)
                .powf(1.0 - feature_difference(fa, fb))
        })
        .collect()
    }

    /// Eq. 10 and the redistribution of section 4.1.2.
    fn color_difference(&self, a: [f32; 3], b: [f32; 3]) -> f32 {
        let difference = hyab(a, b).powf(Q_COLOR);
        let knee = P_COLOR * self.largest;
        if difference < knee {
            P_TARGET / knee * difference
        } else {
            P_TARGET + (difference - knee) / (self.largest - knee) * (1.0 - P_TARGET)
        }
    }
}

/// Eq. 18 on the lengths of edge and point responses.
fn feature_difference([edge_a, point_a]: [f32; 2], [edge_b, point_b]: [f32; 2]) -> f32 {
    let largest = (edge_a - edge_b).abs().max((point_a - point_b).abs());
    (largest * std::f32::consts::FRAC_1_SQRT_2).powf(Q_FEATURE)
}
