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
    /// The integral over the sphere of a lobe with amplitude 1; the whole sphere for sharpness 0.
    #[inline]
    pub fn unit_integral(sharpness: f32) -> f32 {
        let sharpness = sharpness.max(1e-6);
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

/// Sharpness of the first row of the table: a power of two. Four rows, evenly spaced, lead to twice that, four more to twice that again.
const FIRST: f32 = 0.125;
const OCTAVES: usize = 17;
const ROWS: usize = 4 * OCTAVES + 1;
/// Distances of a row; odd, so that 0 is one of them.
const COLUMNS: usize = 65;
/// A row ends this many widths away from the centre, or at a right angle.
const WIDTHS: f32 = 4.5;
/// Numbers of the table, rounded up to a power of two: an index needs a mask and no test.
const SIZE: usize = (ROWS * COLUMNS).next_power_of_two();

/// The share of a spherical Gaussian that lies on one side of a great circle, by its distance from the centre: the *hemisphere
/// approximation* of visibility (Wang et al. 2009). What is beyond the nearest edge counts as free as the centre is.
///
/// Exact for half-planes; too dark beside thin occluders, whose far edge it does not know, and too bright in slits.
#[derive(Clone, Copy, Debug)]
pub struct VisibleShare {
    table: &'static [f32; SIZE],
}

static TABLE: LazyLock<Box<[f32; SIZE]>> = LazyLock::new(|| {
    let mut table = Box::new([0.0; SIZE]);
    for (row, values) in table.chunks_exact_mut(COLUMNS).take(ROWS).enumerate() {
        let quarter = FIRST * (1u32 << (row / 4)) as f32 * 0.25;
        build(quarter * (4 + row % 4) as f32, values);
    }
    table
});

impl VisibleShare {
    /// The table that all share.
    pub fn new() -> Self {
        Self { table: &TABLE }
    }

    /// The share of a lobe that is visible if the nearest edge of visibility is this far from its centre (radians), positive where
    /// the centre is free. Sharpness below 1/8 or above 16 384 is taken for these.
    #[inline(always)]
    pub fn at(&self, distance: f32, sharpness: f32) -> f32 {
        let sharpness = sharpness.clamp(FIRST, FIRST * (1u32 << OCTAVES) as f32 * 0.999);
        // Exponent and first two bits of the mantissa are the row, the others lie between rows.
        let above = sharpness.to_bits() - FIRST.to_bits();
        let (row, t) = (
            above >> 21,
            (above & 0x1f_ffff) as f32 / (1u32 << 21) as f32,
        );
        let half = (COLUMNS / 2) as f32;
        let x = (distance * scale_of(sharpness) + half).clamp(0.0, 2.0 * half - 1e-3);
        let column = truncate(x);
        let u = x - column as f32;
        let at = row as usize * COLUMNS + column as usize;
        let along = |at: usize| {
            let (a, b) = (
                self.table[at & (SIZE - 1)],
                self.table[(at + 1) & (SIZE - 1)],
            );
            a + (b - a) * u
        };
        let (lower, upper) = (along(at), along(at + COLUMNS));
        lower + (upper - lower) * t
    }

    /// [`at`](Self::at) for eight lobes.
    #[inline(always)]
    pub fn at_eight(&self, distance: &[f32; 8], sharpness: &[f32; 8]) -> [f32; 8] {
        std::array::from_fn(|k| self.at(distance[k], sharpness[k]))
    }
}

impl Default for VisibleShare {
    fn default() -> Self {
        Self::new()
    }
}

/// The whole part of a number from 0 to 2^22, without a conversion that checks its range. At whole numbers it may be one less.
#[inline(always)]
pub(super) fn truncate(x: f32) -> u32 {
    const MAGIC: f32 = (1u32 << 23) as f32;
    let x = x - 0.5;
    let x = if x > 0.0 { x } else { 0.0 };
    (x + MAGIC).to_bits() & 0x7f_ffff
}

/// Columns a radian of lobes of some sharpness.
#[inline(always)]
fn scale_of(sharpness: f32) -> f32 {
    const HALF: f32 = (COLUMNS / 2) as f32;
    (HALF / WIDTHS * sharpness.sqrt()).max(HALF / FRAC_PI_2)
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
fn build(sharpness: f32, values: &mut [f32]) {
    const POINTS: u32 = 512;
    let lambda = f64::from(sharpness);
    let scale = scale_of(sharpness);
    let half = std::f64::consts::FRAC_PI_2;
    for (i, value) in values.iter_mut().enumerate() {
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
        *value = (free / (free + blocked)) as f32;
    }
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
        let table = VisibleShare::new();
        for sharpness in [0.125, 0.4, 1.0, 3.0, 17.0, 60.0, 500.0] {
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
                let error = f64::from(table.at(distance, sharpness)) - free / all;
                assert!(error.abs() < 4e-3, "{sharpness} {distance}: {error}");
            }
        }
    }

    #[test]
    fn shares_grow_from_nothing_to_all() {
        let table = VisibleShare::new();
        for sharpness in [0.0, 0.1, 1.0, 50.0, 9_999.0, 1e9] {
            let mut last = -1e-6;
            for i in -100..=100 {
                let share = table.at(i as f32 * 0.04, sharpness);
                assert!((0.0..=1.0).contains(&share) && share >= last - 1e-6);
                last = share;
            }
            assert!((table.at(0.0, sharpness) - 0.5).abs() < 1e-3);
        }
    }
}
