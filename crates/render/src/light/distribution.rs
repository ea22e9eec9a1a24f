//! Discrete distributions in fixed point: what is picked and the probability that is reported agree to the last bit.
//!
//! Masses are whole multiples of one unit, `1 / (2^32 - 1)`, and sum to exactly 1. Picking inverts the cumulative
//! distribution, which keeps neighbouring random numbers neighbours (an alias table would destroy the stratification of
//! Sobol points); a guide table with one entry per outcome starts the search (Chen & Asau 1974), so that the cost of
//! picking does not grow with the table.

/// A distribution over `0..len`.
#[derive(Clone, Debug, Default)]
pub(super) struct Distribution {
    /// Mass in front of each outcome, in units.
    before: Vec<u32>,
    guide: Vec<u32>,
}

/// All mass, in units.
const ALL: u32 = u32::MAX;

/// A random number in `[0, 1)` as a place in `0..ALL`.
pub(super) fn place(u: f32) -> u32 {
    (u * 4_294_967_296.0) as u32
}

/// A mass as a probability.
pub(super) fn probability(mass: u32) -> f32 {
    (f64::from(mass) / f64::from(ALL)) as f32
}

impl Distribution {
    /// Masses in proportion to `weights`, which are finite and not negative. `None` if all are zero (or there is none).
    ///
    /// An outcome of non-zero weight has non-zero mass, however small its share; an outcome of zero weight has none.
    pub(super) fn new(weights: &[f32]) -> Option<Self> {
        let mut before = vec![0; weights.len()];
        let mut guide = vec![0; weights.len()];
        fill(weights, &mut before, &mut guide).then_some(Self { before, guide })
    }

    /// The outcome at a place in `0..ALL`.
    pub(super) fn pick(&self, place: u32) -> usize {
        pick(&self.before, &self.guide, place).0
    }

    /// The outcome at a place, and how far into it the place lies, in `[0, 1)`.
    pub(super) fn pick_inside(&self, place: u32) -> (usize, f32) {
        pick(&self.before, &self.guide, place)
    }

    /// The probability of an outcome.
    pub(super) fn pmf(&self, outcome: usize) -> f32 {
        probability(mass(&self.before, outcome))
    }
}

/// Writes cumulative masses and guide table of `weights` into slices of the same length. `false` if all weights are zero.
pub(super) fn fill(weights: &[f32], before: &mut [u32], guide: &mut [u32]) -> bool {
    let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    if !(total > 0.0 && total.is_finite()) {
        return false;
    }
    let lit = weights.iter().filter(|w| **w > 0.0).count();
    // One unit is set aside for every outcome that can happen; the rest is shared out in proportion.
    let scale = (f64::from(ALL) - lit as f64) / total;
    let (mut sum, mut reserved) = (0.0_f64, 0.0_f64);
    for (slot, &w) in before.iter_mut().zip(weights) {
        *slot = ((sum * scale).floor() + reserved) as u32;
        if w > 0.0 {
            sum += f64::from(w);
            reserved += 1.0;
        }
    }
    // Rounding may leave the outcomes behind the last lit one a few units short of the end.
    let last_lit = weights.iter().rposition(|w| *w > 0.0).unwrap_or(0);
    before[last_lit + 1..].fill(ALL);
    let buckets = before.len() as u64;
    let mut outcome = 0;
    for (bucket, slot) in guide.iter_mut().enumerate() {
        let first_place = ((bucket as u64) << 32).div_ceil(buckets) as u32;
        while outcome + 1 < before.len() && before[outcome + 1] <= first_place {
            outcome += 1;
        }
        *slot = outcome as u32;
    }
    true
}

/// The outcome at `place`, and how far into it the place lies, in `[0, 1)`.
pub(super) fn pick(before: &[u32], guide: &[u32], place: u32) -> (usize, f32) {
    let place = place.min(ALL - 1);
    let bucket = ((u64::from(place) * guide.len() as u64) >> 32) as usize;
    let first = guide[bucket] as usize;
    let last = guide
        .get(bucket + 1)
        .map_or(before.len() - 1, |&g| g as usize);
    let outcome = first + before[first + 1..=last].partition_point(|&b| b <= place);
    let inside = (place - before[outcome]) as f32 / mass(before, outcome) as f32;
    (outcome, inside.min(1.0 - f32::EPSILON / 2.0))
}

/// The mass of an outcome, in units.
pub(super) fn mass(before: &[u32], outcome: usize) -> u32 {
    before.get(outcome + 1).unwrap_or(&ALL) - before[outcome]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masses_follow_weights_and_sum_to_one() {
        let weights = [0.0, 1.0, 0.0, 3.0, 1e-30, 4.0, 0.0];
        let d = Distribution::new(&weights).unwrap();
        let sum: u64 = (0..weights.len())
            .map(|i| u64::from(mass(&d.before, i)))
            .sum();
        assert_eq!(sum, u64::from(ALL));
        for (i, w) in weights.iter().enumerate() {
            assert!((d.pmf(i) - w / 8.0).abs() < 1e-8);
            assert_eq!(d.pmf(i) > 0.0, *w > 0.0);
        }
    }

    #[test]
    fn every_place_is_found() {
        // A table with long runs of nothing, a giant and many dwarfs: every boundary is picked exactly.
        let weights: Vec<f32> = (0..1000)
            .map(|i| match i {
                517 => 1e6,
                i if i % 7 < 4 => 0.0,
                i => i as f32,
            })
            .collect();
        let d = Distribution::new(&weights).unwrap();
        for i in 0..weights.len() {
            let m = mass(&d.before, i);
            if m > 0 {
                assert_eq!(d.pick(d.before[i]), i);
                assert_eq!(d.pick(d.before[i] + m - 1), i);
            }
        }
        assert_eq!(d.pick(u32::MAX), d.pick(u32::MAX - 1));
    }

    #[test]
    fn nothing_and_one() {
        assert!(Distribution::new(&[]).is_none());
        assert!(Distribution::new(&[0.0, 0.0]).is_none());
        let one = Distribution::new(&[0.0, 5.0, 0.0]).unwrap();
        assert_eq!(one.pmf(1), 1.0);
        assert_eq!((one.pick(0), one.pick(u32::MAX)), (1, 1));
    }
}
