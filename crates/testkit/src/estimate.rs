//! Means with their uncertainty, and whether two of them may be the same.

use crate::distribution::student_two_sided;

/// A share of a value that counts as rounding: 2^-18, a few dozen roundings of `f32`. Two results that differ by less are
/// equal, even if their samples show no variance at all.
pub const ROUNDING: f64 = 1.0 / (1 << 18) as f64;

/// A mean of independent samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Variance of the mean (that of one sample, divided by their number).
    pub variance: f64,
    /// Number of samples; infinite if mean and variance are known.
    pub samples: f64,
}

impl Estimate {
    /// The estimate of independent samples (Welford's sums). At least two.
    pub fn of(samples: impl IntoIterator<Item = f64>) -> Self {
        let (mut n, mut mean, mut squares) = (0.0, 0.0, 0.0);
        for x in samples {
            n += 1.0;
            let before = x - mean;
            mean += before / n;
            squares += before * (x - mean);
        }
        assert!(n >= 2.0, "a variance needs two samples");
        Self {
            mean,
            variance: squares / (n - 1.0) / n,
            samples: n,
        }
    }

    /// A value known exactly.
    pub fn exact(mean: f64) -> Self {
        Self {
            mean,
            variance: 0.0,
            samples: f64::INFINITY,
        }
    }

    /// Probability that two estimates of one value differ at least as much as these do: Welch's t-test, two-sided, with the
    /// degrees of freedom of Welch and Satterthwaite. Against an [`exact`](Self::exact) value it is Student's.
    ///
    /// The samples must be roughly normal, or many: sparse bright ones (fireflies) that were not met yet leave mean and
    /// variance both too small and raise false alarms.
    pub fn same(&self, other: &Self) -> f64 {
        let difference = (self.mean - other.mean).abs();
        if difference.is_nan() {
            return 0.0;
        }
        if difference <= ROUNDING * self.mean.abs().max(other.mean.abs()) {
            return 1.0;
        }
        let variance = self.variance + other.variance;
        if variance.is_nan() || variance <= 0.0 {
            return 0.0;
        }
        let share = |e: &Self| (e.variance / variance).powi(2) / (e.samples - 1.0);
        let degrees = 1.0 / (share(self) + share(other));
        // Beyond this Student's distribution is the normal one to six digits.
        student_two_sided(difference / variance.sqrt(), degrees.min(1e7))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Student's sleep data (Biometrika 1908) as in the manual of R's `t.test`: t = -1.8608, 17.776 degrees of freedom,
    /// p = 0.07939.
    #[test]
    fn equals_a_worked_example() {
        let a = [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0];
        let b = [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4];
        let p = Estimate::of(a).same(&Estimate::of(b));
        assert!((p - 0.07939).abs() < 5e-6, "{p}");
    }

    /// Under the null hypothesis p is uniform: 5 % of tests lie below 0.05.
    #[test]
    fn false_alarms_are_as_rare_as_stated() {
        let mut state = 1u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut normal = || {
            let radius = (-2.0 * (1.0 - uniform()).ln()).sqrt();
            radius * (std::f64::consts::TAU * uniform()).cos()
        };
        let mut low = [0u32; 2];
        for _ in 0..20_000 {
            let a = Estimate::of((0..8).map(|_| normal()));
            let b = Estimate::of((0..5).map(|_| 3.0 * normal()));
            low[0] += u32::from(a.same(&Estimate::exact(0.0)) < 0.05);
            low[1] += u32::from(a.same(&b) < 0.05);
        }
        for alarms in low {
            assert!(
                (850..1150).contains(&alarms),
                "{alarms} of 20000, expected 1000"
            );
        }
    }

    #[test]
    fn finds_differences_and_ignores_rounding() {
        let one = Estimate::of((0..1000).map(|i| 1.0 + f64::from(i % 10) * 0.01));
        assert!(one.same(&Estimate::exact(1.1)) < 1e-9);
        assert_eq!(Estimate::exact(1.0).same(&Estimate::exact(1.0 + 1e-7)), 1.0);
        assert_eq!(Estimate::exact(1.0).same(&Estimate::exact(1.001)), 0.0);
        assert_eq!(Estimate::exact(0.0).same(&Estimate::exact(0.0)), 1.0);
        assert_eq!(Estimate::exact(f64::NAN).same(&one), 0.0);
    }
}
