//! How much of a broad lobe is visible, by spherical harmonics of what a point sees.
//!
//! The hemisphere approximation ([`VisibleShare`](super::VisibleShare)) knows the nearest edge alone: to a lobe that is broader than a window, the window is half of the world. But means under
//! broad lobes are what few harmonics say well: convolving with a lobe multiplies band `l` with `A_l`, where `A_0 = 1`, `A_1 = coth s - 1/s` and `A_(l+1) = A_(l-1) - (2l+1)/s A_l`
//! (ratios of modified spherical Bessel functions, `s` the sharpness; Ramamoorthi & Hanrahan 2001 for the product of bands).
//!
//! Wrong tool for narrow lobes, whose share the four bands blur: there the hemisphere approximation is better. [`BroadShare::trust`] goes from one to the other.

use super::harmonics::{Harmonics, basis};
use glam::Vec3;
use std::sync::LazyLock;

/// Up to the first sharpness harmonics speak alone, from the second on the nearest edge does.
const BLEND: [f32; 2] = [8.0, 24.0];

/// What each of the four bands says in a direction: their sum is the function that the harmonics stand for.
#[inline(always)]
pub fn bands_at_eight(harmonics: &Harmonics, w: &[[f32; 8]; 3]) -> [[f32; 8]; 4] {
    let mut bands = [[0.0; 8]; 4];
    for k in 0..8 {
        let values = basis(Vec3::new(w[0][k], w[1][k], w[2][k]));
        let mut products = [0.0; 16];
        for (product, (c, value)) in products.iter_mut().zip(harmonics.iter().zip(values)) {
            *product = c * value;
        }
        let sum = |from: usize, to: usize| products[from..to].iter().sum::<f32>();
        bands[0][k] = products[0];
        bands[1][k] = sum(1, 4);
        bands[2][k] = sum(4, 9);
        bands[3][k] = sum(9, 16);
    }
    bands
}

/// The table of `A_1` to `A_3`, so many steps a unit of sharpness, to the end of the blend.
const STEPS: usize = 8;
const SIZE: usize = STEPS * BLEND[1] as usize + 2;

static TABLE: LazyLock<[[f32; 3]; SIZE]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let s = i as f64 / STEPS as f64;
        if s < 0.05 {
            return [s / 3.0, s * s / 15.0, s * s * s / 105.0].map(|a| a as f32);
        }
        let a1 = 1.0 / s.tanh() - 1.0 / s;
        let a2 = 1.0 - 3.0 / s * a1;
        let a3 = a1 - 5.0 / s * a2;
        [a1, a2, a3].map(|a| a as f32)
    })
});

/// The visible share of spherical Gaussians that are too broad for [`VisibleShare`](super::VisibleShare).
#[derive(Clone, Copy, Debug)]
pub struct BroadShare {
    table: &'static [[f32; 3]; SIZE],
}

impl Default for BroadShare {
    fn default() -> Self {
        Self::new()
    }
}

impl BroadShare {
    /// The table that all share.
    pub fn new() -> Self {
        Self { table: &TABLE }
    }

    /// How much harmonics are to be trusted: 1 for broad lobes, 0 for narrow ones, even in between.
    #[inline(always)]
    pub fn trust(sharpness: f32) -> f32 {
        let t = (BLEND[1] - sharpness) * (1.0 / (BLEND[1] - BLEND[0]));
        let t = if t < 1.0 { t } else { 1.0 };
        if t > 0.0 { t } else { 0.0 }
    }

    /// The shares of eight lobes, from 0 to 1, by the [bands](bands_at_eight) in the directions of their axes. Sharpness beyond that of trust is taken for its end.
    #[inline(always)]
    pub fn at_eight(&self, bands: &[[f32; 8]; 4], sharpness: &[f32; 8]) -> [f32; 8] {
        std::array::from_fn(|k| {
            let x = (sharpness[k] * STEPS as f32).clamp(0.0, (SIZE - 2) as f32);
            let i = (x as usize).min(SIZE - 2);
            let t = x - i as f32;
            let (a, b) = (&self.table[i], &self.table[i + 1]);
            let factor = |l: usize| a[l] + (b[l] - a[l]) * t;
            let share = bands[0][k]
                + factor(0) * bands[1][k]
                + factor(1) * bands[2][k]
                + factor(2) * bands[3][k];
            share.clamp(0.0, 1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DistanceTransform, Hemisphere, VisibilityMap, VisibleShare, harmonics};
    use super::*;

    fn sphere(n: u32) -> impl Iterator<Item = Vec3> {
        (0..n).map(move |i| {
            let y = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - y * y).sqrt();
            Vec3::new(r * cos, y, r * sin)
        })
    }

    /// Both ways against quadrature, through windows and past edges: harmonics where they are trusted wholly are far better, and where both are mixed no worse.
    #[test]
    fn windows_are_no_half_spaces() {
        let h = Hemisphere::new(Vec3::new(0.2, 0.9, -0.3).normalize(), Vec3::X);
        let maps = [
            VisibilityMap::from_fn(128, |w| w.x.abs() < 0.3 && w.y > 0.5 && w.y < 0.8),
            VisibilityMap::from_fn(128, |w| w.x > 0.2),
            VisibilityMap::from_fn(128, |w| (w.x - 0.1).abs() > 0.06),
            VisibilityMap::from_fn(128, |w| (w.x * 7.0).sin() + (w.z * 6.0).cos() > 0.3),
        ];
        let (nearest, broad) = (VisibleShare::new(), BroadShare::new());
        for sharpness in [0.3, 2.0, 8.0, 12.0, 18.0, 30.0] {
            let (mut by_edge, mut by_bands, mut mixed, mut count) = (0.0, 0.0, 0.0, 0.0);
            for map in &maps {
                let known = harmonics(map, &h);
                let field = DistanceTransform::default().transform(map);
                for axis in sphere(61).filter(|axis| axis.dot(h.normal) > 0.1) {
                    let (mut free, mut all) = (0.0_f32, 0.0);
                    for w in sphere(4000) {
                        let value = (sharpness * (axis.dot(w) - 1.0)).exp();
                        all += value;
                        free += if map.is_free(&h, w) { value } else { 0.0 };
                    }
                    let truth = free / all;
                    let columns = axis.to_array().map(|v| [v; 8]);
                    let bands = bands_at_eight(&known, &columns);
                    let theirs = broad.at_eight(&bands, &[sharpness; 8])[0];
                    let edge = nearest.at(field.at(&h, axis), sharpness);
                    let trust = BroadShare::trust(sharpness);
                    by_edge += (edge - truth).powi(2);
                    by_bands += (theirs - truth).powi(2);
                    mixed += (edge + (theirs - edge) * trust - truth).powi(2);
                    count += 1.0;
                }
            }
            let root = |sum: f32| (sum / count).sqrt();
            let (by_edge, by_bands, mixed) = (root(by_edge), root(by_bands), root(mixed));
            println!(
                "{sharpness}: nearest edge {by_edge:.4}, bands {by_bands:.4}, mixed {mixed:.4}"
            );
            if sharpness <= BLEND[0] {
                assert!(mixed < 0.5 * by_edge && mixed < 0.04, "{sharpness}");
            }
            assert!(mixed < 1.01 * by_edge, "{sharpness}");
        }
    }
}
