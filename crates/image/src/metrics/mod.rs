//! How far a picture is from its reference.
//!
//! [`compare`] computes everything that `occlude compare` reports, in linear light unless said otherwise:
//!
//! | key | meaning |
//! |---|---|
//! | `mse` | mean over pixels and channels of `(a - b)^2` |
//! | `relmse` | mean of `(a - b)^2 / (b^2 + 0.01)` after dividing both by the mean of `b` over all channels |
//! | `psnr` | `10 log10(peak^2 / mse)` in dB; peak is 1 for display pictures (PNG), the largest value of `b` otherwise |
//! | `ssim` | mean structural similarity (Wang et al. 2004) of sRGB-coded luminance; scene-linear pictures are exposed first so that the mean luminance of `b` is 0.18 |
//! | `flip` | mean FLIP: [`flip::ldr`] if either picture is for display, [`flip::hdr`] otherwise |
//! | `energy_change` | `sum abs(a - b) / sum b`, after Popov et al., "Adaptive Quantization Visibility Caching", section 5 |
//! | `mean_a`, `mean_b` | means of each channel |
//!
//! What has no finite value (`psnr` of equal pictures, `energy_change` against black) is infinite here and `null` in
//! JSON. `relmse` against a black reference divides by 1.
//!
//! None of these is a significance test: for noise against noise use the z-test on stored variance.

mod flicker;
pub mod flip;
mod ssim;

use serde::Serialize;

pub use flicker::{Flicker, flicker};
pub use ssim::ssim;

use crate::{Encoding, ImageError, Picture, picture::luminance, srgb_encode};

/// What `occlude compare --json` prints. See the [module](self) for each number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Mean squared error.
    pub mse: f64,
    /// Relative mean squared error.
    pub relmse: f64,
    /// Peak signal-to-noise ratio, dB.
    pub psnr: f64,
    /// Structural similarity, 1 for equal pictures.
    pub ssim: f64,
    /// Mean FLIP error in `[0, 1]`.
    pub flip: f64,
    /// Absolute difference relative to the reference's sum.
    pub energy_change: f64,
    /// Mean of each channel of the first picture.
    pub mean_a: [f64; 3],
    /// Mean of each channel of the reference.
    pub mean_b: [f64; 3],
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// All numbers, and FLIP for every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// The numbers.
    pub numbers: Comparison,
    /// FLIP error of every pixel, row by row.
    pub flip_map: Vec<f32>,
}

/// Compares `a` with the reference `b`. `encoding` is [`Encoding::Display`] if either came from a display format.
///
/// # Errors
/// [`ImageError::SizeMismatch`]; [`ImageError::Inconsistent`] for empty pictures.
pub fn compare(a: &Picture, b: &Picture, encoding: Encoding) -> Result<Compared, ImageError> {
    a.same_size(b)?;
    if a.pixels.is_empty() {
        return Err(ImageError::Inconsistent(
            "there are no pixels to compare".to_owned(),
        ));
    }
    let flip_map = match encoding {
        Encoding::Display => flip::ldr(a, b, flip::DEFAULT_PPD)?,
        Encoding::SceneLinear => flip::hdr(a, b, flip::DEFAULT_PPD)?,
    };
    let mse = mse(a, b)?;
    let peak = match encoding {
        Encoding::Display => 1.0,
        Encoding::SceneLinear => b
            .pixels
            .iter()
            .flatten()
            .fold(0.0, |m: f64, &v| m.max(f64::from(v))),
    };
    let (coded_a, coded_b) = (
        coded_luminance(a, b, encoding),
        coded_luminance(b, b, encoding),
    );
    let numbers = Comparison {
        mse,
        relmse: relmse(a, b)?,
        psnr: psnr(mse, peak),
        ssim: ssim(&coded_a, &coded_b, a.width as usize, a.height as usize),
        flip: mean(&flip_map),
        energy_change: energy_change(a, b)?,
        mean_a: a.mean(),
        mean_b: b.mean(),
        width: a.width,
        height: a.height,
    };
    Ok(Compared { numbers, flip_map })
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64
}

/// Pairs of values of all pixels and channels.
fn pairs<'a>(a: &'a Picture, b: &'a Picture) -> impl Iterator<Item = (f64, f64)> + 'a {
    let values = |p: &'a Picture| p.pixels.iter().flatten().map(|&v| f64::from(v));
    values(a).zip(values(b))
}

/// Mean over pixels and channels of the squared difference.
///
/// # Errors
/// [`ImageError::SizeMismatch`].
pub fn mse(a: &Picture, b: &Picture) -> Result<f64, ImageError> {
    a.same_size(b)?;
    let count = (3 * a.pixels.len()).max(1) as f64;
    Ok(pairs(a, b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / count)
}

/// Mean of `(a - b)^2 / (b^2 + 0.01)` after dividing both by the mean of `b`, so that exposure does not matter.
///
/// # Errors
/// [`ImageError::SizeMismatch`].
pub fn relmse(a: &Picture, b: &Picture) -> Result<f64, ImageError> {
    a.same_size(b)?;
    let mean = b.mean().iter().sum::<f64>() / 3.0;
    let scale = if mean > 0.0 { 1.0 / mean } else { 1.0 };
    let count = (3 * a.pixels.len()).max(1) as f64;
    let of = |(a, b): (f64, f64)| {
        let (a, b) = (a * scale, b * scale);
        (a - b) * (a - b) / (b * b + 1e-2)
    };
    Ok(pairs(a, b).map(of).sum::<f64>() / count)
}

/// `10 log10(peak^2 / mse)`, in dB; infinite for no error.
pub fn psnr(mse: f64, peak: f64) -> f64 {
    10.0 * (peak * peak / mse).log10()
}

/// `sum abs(a - b) / sum b`. 0 for two black pictures.
///
/// # Errors
/// [`ImageError::SizeMismatch`].
pub fn energy_change(a: &Picture, b: &Picture) -> Result<f64, ImageError> {
    a.same_size(b)?;
    let difference: f64 = pairs(a, b).map(|(a, b)| (a - b).abs()).sum();
    let sum: f64 = pairs(a, b).map(|(_, b)| b).sum();
    Ok(if difference == 0.0 {
        0.0
    } else {
        difference / sum.abs()
    })
}

/// Stops that bring the mean luminance of a picture to middle grey, 0.18; 0 for a black one.
pub fn middle_grey_exposure(picture: &Picture) -> f32 {
    let mean = mean(
        &picture
            .pixels
            .iter()
            .map(|&p| luminance(p))
            .collect::<Vec<_>>(),
    );
    if mean > 0.0 {
        (0.18 / mean).log2() as f32
    } else {
        0.0
    }
}

/// Luminance in `[0, 1]` with the sRGB curve, as SSIM wants it: near to perceptually uniform.
fn coded_luminance(picture: &Picture, reference: &Picture, encoding: Encoding) -> Vec<f64> {
    let scale = match encoding {
        Encoding::Display => 1.0,
        Encoding::SceneLinear => middle_grey_exposure(reference).exp2(),
    };
    picture
        .pixels
        .iter()
        .map(|&p| f64::from(srgb_encode((luminance(p) * scale).clamp(0.0, 1.0))))
        .collect()
}

#[cfg(test)]
mod tests;
