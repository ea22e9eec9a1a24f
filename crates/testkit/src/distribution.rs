//! Quantiles and tails of the normal, Student and chi-square distributions.
//!
//! Thin names over `statrs`, with the arguments that tests have at hand.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal, StudentsT};

/// The value that a standard normal variable exceeds with probability `tail`.
///
/// # Panics
/// If `tail` is not in (0, 1).
pub fn normal_quantile(tail: f64) -> f64 {
    assert!(tail > 0.0 && tail < 1.0, "tail {tail}");
    -Normal::standard().inverse_cdf(tail)
}

/// Probability that a standard normal variable lies farther from 0 than `z`, on either side.
pub fn normal_two_sided(z: f64) -> f64 {
    2.0 * Normal::standard().sf(z.abs())
}

/// Probability that a Student variable lies farther from 0 than `t`, on either side.
///
/// # Panics
/// If `degrees` is not positive.
pub fn student_two_sided(t: f64, degrees: f64) -> f64 {
    let student = StudentsT::new(0.0, 1.0, degrees).expect("positive degrees of freedom");
    2.0 * student.sf(t.abs())
}

/// Probability that a chi-square variable exceeds `x`.
///
/// # Panics
/// If `degrees` is not positive.
pub fn chi_square_tail(x: f64, degrees: f64) -> f64 {
    ChiSquared::new(degrees)
        .expect("positive degrees of freedom")
        .sf(x)
}

/// The value that a chi-square variable exceeds with probability `tail`.
///
/// # Panics
/// If `degrees` is not positive or `tail` not in (0, 1).
pub fn chi_square_quantile(tail: f64, degrees: f64) -> f64 {
    assert!(tail > 0.0 && tail < 1.0, "tail {tail}");
    ChiSquared::new(degrees)
        .expect("positive degrees of freedom")
        .inverse_cdf(1.0 - tail)
}

/// The rate of false alarms that each of `tests` independent tests may have, so that all together have `significance`:
/// `1 - (1 - significance)^(1/tests)` (Šidák 1967).
pub fn sidak(significance: f64, tests: usize) -> f64 {
    -f64::exp_m1(f64::ln_1p(-significance) / tests as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-6 * b.abs(), "{a} is not {b}");
    }

    /// Table values: NIST/SEMATECH e-Handbook of Statistical Methods, section 1.3.6.7, to the digits printed there.
    #[test]
    fn equals_printed_tables() {
        for (tail, z) in [
            (0.05, 1.644854),
            (0.025, 1.959964),
            (0.001, 3.090232),
            (1e-6, 4.753424),
        ] {
            near(normal_quantile(tail), z);
            assert!((normal_two_sided(z) / (2.0 * tail) - 1.0).abs() < 1e-5);
        }
        for (degrees, t) in [(1.0, 12.706), (5.0, 2.571), (30.0, 2.042)] {
            assert!(
                (student_two_sided(t, degrees) - 0.05).abs() < 5e-5,
                "{degrees} degrees"
            );
        }
        for (degrees, x) in [(1.0, 3.841), (10.0, 18.307), (100.0, 124.342)] {
            assert!(
                (chi_square_tail(x, degrees) - 0.05).abs() < 5e-5,
                "{degrees} degrees"
            );
            assert!(
                (chi_square_quantile(0.05, degrees) - x).abs() < 1e-3,
                "{degrees} degrees"
            );
        }
    }

    #[test]
    fn tails_stay_accurate_far_out() {
        // Abramowitz and Stegun, table 26.2: -log10 Q(10) = 23.11805.
        near(-(normal_two_sided(10.0) / 2.0).log10(), 23.118053);
        assert!(student_two_sided(8.0, 1e7) > 0.0);
    }

    #[test]
    fn sidak_corrects() {
        near(sidak(0.01, 1), 0.01);
        near(sidak(1e-9, 1000), 1e-12);
        let each = sidak(0.01, 500);
        near(1.0 - (1.0 - each).powi(500), 0.01);
    }
}
