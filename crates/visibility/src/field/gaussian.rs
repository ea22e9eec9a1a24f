//! Spherical Gaussians, and how much of one an edge of visibility leaves.

use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

/// A lobe on the sphere: `amplitude * exp(sharpness * (axis . w - 1))` (Eq. 3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalGaussian {
    /// Unit vector to its centre.
    pub axis: Vec3,
    /// How narrow it is: its width in radians is about one over the root of this.
    pub sharpness: f32,
    /// Its value at the centre, by colour.
    pub amplitude: Vec3,
}

impl SphericalGaussian {
    /// The integral over the sphere of a lobe with amplitude 1.
    #[inline]
    pub fn unit_integral(sharpness: f32) -> f32 {
        2.0 * PI * -(-2.0 * sharpness).exp_m1() / sharpness
    }

    /// Its value in a direction.
    #[inline]
    pub fn at(&self, w: Vec3) -> Vec3 {
        self.amplitude * (self.sharpness * (self.axis.dot(w) - 1.0)).exp()
    }

    /// Its integral over the sphere.
    pub fn integral(&self) -> Vec3 {
        self.amplitude * Self::unit_integral(self.sharpness)
    }

    /// The product of two lobes, which is a lobe.
    #[inline]
    pub fn product(&self, other: &Self) -> Self {
        let sum = self.axis * self.sharpness + other.axis * other.sharpness;
        let sharpness = sum.length().max(f32::MIN_POSITIVE);
        let fall = (sharpness - self.sharpness - other.sharpness).exp();
        Self {
            axis: sum / sharpness,
            sharpness,
            amplitude: self.amplitude * other.amplitude * fall,
        }
    }
}

/// Sharpness of the first row of the table, and the factor from row to row.
const FIRST: f32 = 1.0;
const FACTOR: f32 = 1.5;
const ROWS: usize = 24;
/// Distances of a row; odd, so that 0 is one of them.
const COLUMNS: usize = 97;
/// A row ends this many widths away from the centre, or at a right angle.
const WIDTHS: f32 = 4.5;

/// The share of a spherical Gaussian that lies on one side of a great circle, by its distance from the centre: the *hemisphere
/// approximation* of visibility (Wang et al. 2009). What is beyond the nearest edge counts as free as the centre is.
///
/// Exact for half-planes; too dark beside thin occluders, whose far edge it does not know, and too bright in slits.
#[derive(Clone, Copy, Debug)]
pub struct VisibleShare {
    values: [f32; COLUMNS],
    /// Columns a radian.
    scale: f32,
}

static TABLE: LazyLock<Box<[VisibleShare; ROWS]>> = LazyLock::new(|| {
    Box::new(std::array::from_fn(|row| {
        build(FIRST * FACTOR.powi(row as i32))
    }))
});

impl VisibleShare {
    /// The shares of lobes of one sharpness (at least 1, at most 10 000: others are taken for these).
    pub fn of(sharpness: f32) -> Self {
        let x = (sharpness / FIRST).max(1.0).ln() / FACTOR.ln();
        let row = (x as usize).min(ROWS - 2);
        let t = (x - row as f32).clamp(0.0, 1.0);
        let (lower, upper) = (&TABLE[row], &TABLE[row + 1]);
        let scale = scale_of((sharpness / FIRST).clamp(1.0, FACTOR.powi(ROWS as i32 - 1)) * FIRST);
        Self {
            values: std::array::from_fn(|i| {
                lower.values[i] + (upper.values[i] - lower.values[i]) * t
            }),
            scale,
        }
    }

    /// The share that is visible if the nearest edge of visibility is this far from the centre, positive where the centre is free.
    #[inline]
    pub fn at(&self, distance: f32) -> f32 {
        let half = (COLUMNS / 2) as f32;
        let x = (distance * self.scale + half).clamp(0.0, 2.0 * half);
        let i = (x as usize).min(COLUMNS - 2);
        self.values[i] + (self.values[i + 1] - self.values[i]) * (x - i as f32)
    }
}

/// Columns a radian of lobes of some sharpness.
fn scale_of(sharpness: f32) -> f32 {
    (COLUMNS / 2) as f32 / (WIDTHS / sharpness.sqrt()).min(FRAC_PI_2)
}

/// `I0(x) exp(-x)`, the scaled modified Bessel function (Abramowitz & Stegun 1964, 9.8.1 and 9.8.2).
fn bessel(x: f64) -> f64 {
    let poly = |c: &[f64], t: f64| c.iter().rev().fold(0.0, |sum, c| sum * t + c);
    if x < 3.75 {
        let t = (x / 3.75).powi(2);
        poly(
            &[
                1.0, 3.5156229, 3.0899424, 1.2067492, 0.2659732, 0.0360768, 0.0045813,
            ],
            t,
        ) * (-x).exp()
    } else {
        poly(
            &[
                0.39894228,
                0.01328592,
                0.00225319,
                -0.00157565,
                0.00916281,
                -0.02057706,
                0.02635537,
                -0.01647633,
                0.00392377,
            ],
            3.75 / x,
        ) / x.sqrt()
    }
}

/// One row by quadrature. Along the normal of the circle's plane, at elevation `b` from it, the lobe's mass is
/// `exp(lambda (cos(b - D) - 1)) I0e(lambda cos D cos b) cos b db` up to a factor.
fn build(sharpness: f32) -> VisibleShare {
    const POINTS: u32 = 512;
    let lambda = f64::from(sharpness);
    let scale = scale_of(sharpness);
    let half = std::f64::consts::FRAC_PI_2;
    let values = std::array::from_fn(|i| {
        let distance = (i as f64 - (COLUMNS / 2) as f64) / f64::from(scale);
        let reach = 7.0 / lambda.sqrt();
        let mass = |from: f64, to: f64| {
            let (from, to) = (from.max(distance - reach), to.min(distance + reach));
            if to <= from {
                return 0.0;
            }
            let step = (to - from) / f64::from(POINTS);
            let density = |k: u32| {
                let b = from + (f64::from(k) + 0.5) * step;
                let cross = lambda * distance.cos() * b.cos();
                (lambda * ((b - distance).cos() - 1.0)).exp() * bessel(cross.max(0.0)) * b.cos()
            };
            (0..POINTS).map(density).sum::<f64>() * step
        };
        let (free, blocked) = (mass(0.0, half), mass(-half, 0.0));
        (free / (free + blocked)) as f32
    });
    VisibleShare { values, scale }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(n: u32) -> impl Iterator<Item = Vec3> {
        (0..n).map(move |i| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n);
            let a = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            Vec3::new((r * a.cos()) as f32, (r * a.sin()) as f32, z as f32)
        })
    }

    #[test]
    fn integrals_are_what_quadrature_says() {
        for sharpness in [0.3, 2.0, 30.0, 400.0] {
            let lobe = SphericalGaussian {
                axis: Vec3::new(0.48, 0.6, 0.64),
                sharpness,
                amplitude: Vec3::new(1.0, 2.0, 0.5),
            };
            let n = 400_000;
            let sum: f64 = sphere(n).map(|w| f64::from(lobe.at(w).x)).sum();
            let numeric = sum * 4.0 * std::f64::consts::PI / f64::from(n);
            assert!((f64::from(lobe.integral().x) / numeric - 1.0).abs() < 2e-3);
        }
    }

    #[test]
    fn products_are_lobes() {
        let a = SphericalGaussian {
            axis: Vec3::Y,
            sharpness: 40.0,
            amplitude: Vec3::ONE,
        };
        let b = SphericalGaussian {
            axis: Vec3::new(0.6, 0.8, 0.0),
            sharpness: 9.0,
            amplitude: Vec3::splat(2.0),
        };
        let product = a.product(&b);
        for w in sphere(500) {
            let expected = a.at(w) * b.at(w);
            assert!((product.at(w) - expected).length() <= 1e-4 * expected.length() + 1e-7);
        }
    }

    /// Shares against quadrature over directions.
    #[test]
    fn shares_are_what_quadrature_says() {
        let n = 300_000;
        for sharpness in [1.0, 3.0, 17.0, 60.0, 500.0] {
            let table = VisibleShare::of(sharpness);
            for distance in [-1.2_f32, -0.5, -0.1, 0.0, 0.03, 0.2, 0.7, 1.4] {
                let normal = Vec3::new(distance.cos(), 0.0, distance.sin());
                let (mut free, mut all) = (0.0_f64, 0.0_f64);
                for w in sphere(n) {
                    let value = f64::from((sharpness * (w.z - 1.0)).exp());
                    all += value;
                    if w.dot(normal) > 0.0 {
                        free += value;
                    }
                }
                let error = f64::from(table.at(distance)) - free / all;
                assert!(error.abs() < 4e-3, "{sharpness} {distance}: {error}");
            }
        }
    }

    #[test]
    fn shares_grow_from_nothing_to_all() {
        for sharpness in [0.1, 1.0, 50.0, 9_999.0, 1e9] {
            let table = VisibleShare::of(sharpness);
            let mut last = -1e-6;
            for i in -100..=100 {
                let share = table.at(i as f32 * 0.04);
                assert!((0.0..=1.0).contains(&share) && share >= last - 1e-6);
                last = share;
            }
            assert!((table.at(0.0) - 0.5).abs() < 1e-3);
        }
    }
}
