//! Sums that do not depend on the order of their terms.
//!
//! Floating-point addition is not associative, so a picture summed by another number of threads, or in another number
//! of shards, would differ in its last bits. Fixed-point sums are exact: any order gives the same bytes.

/// A sum in fixed point: 63 bits before the point, 64 behind.
///
/// Range about ±9.2e18, resolution 5.4e-20: radiance from starlight to the sun's disk keeps the 24 bits of an `f32`.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FixedSum(i128);

const ONE: f64 = 18_446_744_073_709_551_616.0;

impl FixedSum {
    /// Adds one finite term. Terms beyond the range saturate.
    pub fn add(&mut self, term: f64) {
        self.0 = self.0.saturating_add((term * ONE) as i128);
    }

    /// Adds another sum.
    pub fn merge(&mut self, other: Self) {
        self.0 = self.0.saturating_add(other.0);
    }

    /// The sum, rounded once.
    pub fn value(self) -> f64 {
        self.0 as f64 / ONE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_order_gives_the_same_sum() {
        let terms: Vec<f64> = (0..1000)
            .map(|i| (f64::from(i) * 0.37).sin() as f32 as f64 * 10f64.powi(i % 12 - 6))
            .collect();
        let mut forward = FixedSum::default();
        terms.iter().for_each(|&t| forward.add(t));
        let mut backward = FixedSum::default();
        let mut half = FixedSum::default();
        terms[500..].iter().rev().for_each(|&t| backward.add(t));
        terms[..500].iter().rev().for_each(|&t| half.add(t));
        backward.merge(half);
        assert_eq!(forward, backward);
        let exact: f64 = terms.iter().sum();
        assert!((forward.value() - exact).abs() < 1e-9 * exact.abs().max(1.0));
    }

    #[test]
    fn huge_terms_saturate() {
        let mut sum = FixedSum::default();
        sum.add(1e30);
        sum.add(1e30);
        assert!(sum.value() > 9e18);
    }
}
