//! Pearson's chi-square test of a histogram, and its use on `sample`/`pdf` pairs over the sphere.
//!
//! The histogram of what `sample` returns is compared with the integral of `pdf` over each bin. Everything that was not a direction of
//! the tested density (a sample that failed, a delta lobe) counts into one more bin, whose expectation is what the integral of `pdf` leaves:
//! so a density that integrates to the wrong total fails too. Bins that expect fewer than 5 are pooled (Cochran's rule). A run with fixed
//! seeds either fails always or never; [`sidak`](crate::distribution::sidak) gives the level for each of many tests so that all of them together
//! raise a false alarm with a chosen chance. Wrong tool for: densities with features far narrower than a bin and its
//! subdivisions (place the pole on the peak, and use a higher `concentration`).

use crate::distribution::chi_square_tail;

/// Smallest expectation of a bin that is tested by itself.
const MIN_EXPECTED: f64 = 5.0;

/// What a chi-square test found.
#[derive(Clone, Debug)]
pub struct Chi2 {
    /// Sum of `(observed - expected)² / expected`.
    pub statistic: f64,
    /// Degrees of freedom.
    pub degrees: usize,
    /// The chance of a statistic at least this large if the expectation is right.
    pub p: f64,
    /// The bins that contribute most: `(index, observed, expected)`; the pooled bin has index `usize::MAX`.
    pub worst: Vec<(usize, f64, f64)>,
}

/// Tests counts against expected counts, which should have the same sum.
///
/// A bin that expects nothing (or less than nothing, by rounding) but holds something makes `p` 0.
pub fn chi2_test(observed: &[f64], expected: &[f64]) -> Chi2 {
    assert_eq!(observed.len(), expected.len(), "one expectation a bin");
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]).then(a.cmp(&b)));
    let mut pool = (usize::MAX, 0.0, 0.0);
    let mut terms = Vec::new();
    for index in order {
        if expected[index] < MIN_EXPECTED || (pool.2 > 0.0 && pool.2 < MIN_EXPECTED) {
            pool.1 += observed[index];
            pool.2 += expected[index].max(0.0);
        } else {
            terms.push((index, observed[index], expected[index]));
        }
    }
    if pool.2 > 0.0 || pool.1 > 0.0 {
        terms.push(pool);
    }
    let part = |&(_, o, e): &(usize, f64, f64)| match (o == 0.0, e > 0.0) {
        (_, true) => (o - e).powi(2) / e,
        // A stray count in a pool whose expectation vanishes by rounding.
        (false, false) => f64::INFINITY,
        (true, false) => 0.0,
    };
    let statistic: f64 = terms.iter().map(part).sum();
    let degrees = terms.len().saturating_sub(1);
    let p = if degrees == 0 || !statistic.is_finite() {
        if statistic.is_finite() { 1.0 } else { 0.0 }
    } else {
        chi_square_tail(statistic, degrees as f64)
    };
    terms.sort_by(|a, b| part(b).total_cmp(&part(a)));
    terms.truncate(6);
    Chi2 {
        statistic,
        degrees,
        p: if p.is_nan() { 0.0 } else { p },
        worst: terms,
    }
}

/// Bins over the sphere: rings about a pole, each cut into equal azimuths.
#[derive(Clone, Copy, Debug)]
pub struct SphereGrid {
    /// Unit vector of the pole.
    pub pole: [f64; 3],
    /// Number of rings.
    pub rings: usize,
    /// Bins a ring.
    pub sectors: usize,
    /// Ring `t` in `[0, 1]` lies at `cos = 1 - 2 t^concentration`: 1 for equal areas, more to crowd the rings at the pole.
    pub concentration: i32,
}

impl Default for SphereGrid {
    fn default() -> Self {
        Self {
            pole: [0.0, 0.0, 1.0],
            rings: 24,
            sectors: 32,
            concentration: 1,
        }
    }
}

impl SphereGrid {
    fn frame(&self) -> [[f64; 3]; 3] {
        let z = self.pole;
        let helper = if z[0].abs() < 0.5 {
            [1.0, 0.0, 0.0]
        } else {
            [0.0, 1.0, 0.0]
        };
        let x = normalized(cross(helper, z));
        [x, cross(z, x), z]
    }

    fn bin(&self, direction: [f64; 3]) -> usize {
        let frame = self.frame();
        let [x, y, z] = frame.map(|axis| dot(axis, direction));
        // 1 - cos without cancellation near the pole.
        let one_minus = if z > 0.0 {
            (x * x + y * y) / (1.0 + z)
        } else {
            1.0 - z
        };
        let t = (0.5 * one_minus)
            .clamp(0.0, 1.0)
            .powf(1.0 / f64::from(self.concentration));
        let phi = y.atan2(x) / (2.0 * std::f64::consts::PI);
        let phi = if phi < 0.0 { phi + 1.0 } else { phi };
        let ring = ((t * self.rings as f64) as usize).min(self.rings - 1);
        let sector = ((phi * self.sectors as f64) as usize).min(self.sectors - 1);
        ring * self.sectors + sector
    }

    /// The density times the area element at grid coordinates in the unit square.
    fn integrand(
        &self,
        frame: &[[f64; 3]; 3],
        t: f64,
        phi: f64,
        pdf: &mut dyn FnMut([f64; 3]) -> f64,
    ) -> f64 {
        let k = self.concentration;
        let one_minus = 2.0 * t.powi(k);
        let sin = (one_minus * (2.0 - one_minus)).max(0.0).sqrt();
        let (s, c) = (2.0 * std::f64::consts::PI * phi).sin_cos();
        let local = [sin * c, sin * s, 1.0 - one_minus];
        let direction = std::array::from_fn(|i| (0..3).map(|a| frame[a][i] * local[a]).sum());
        let element = 2.0 * std::f64::consts::PI * 2.0 * f64::from(k) * t.powi(k - 1);
        pdf(direction) * element
    }

    /// Integral of the density over each bin, by a 3x3 Gauss rule that is subdivided where it disagrees with its quarters.
    pub fn integrate(&self, pdf: &mut dyn FnMut([f64; 3]) -> f64) -> Vec<f64> {
        let frame = self.frame();
        let mut f = |t: f64, phi: f64| self.integrand(&frame, t, phi, pdf);
        let (h, w) = (1.0 / self.rings as f64, 1.0 / self.sectors as f64);
        let tolerance = 2e-4 / (self.rings * self.sectors) as f64;
        let mut bins = Vec::with_capacity(self.rings * self.sectors);
        for ring in 0..self.rings {
            for sector in 0..self.sectors {
                let cell = [ring as f64 * h, sector as f64 * w, h, w];
                let whole = gauss(cell, &mut f);
                bins.push(subdivide(cell, whole, tolerance, 5, &mut f));
            }
        }
        bins
    }

    /// Tests `samples` draws against the density. `sample(i)` gives the i-th draw, `None` where it is no direction of this density.
    pub fn test(
        &self,
        samples: usize,
        sample: &mut dyn FnMut(usize) -> Option<[f64; 3]>,
        pdf: &mut dyn FnMut([f64; 3]) -> f64,
    ) -> Chi2 {
        let mut expected = self.integrate(pdf);
        let mut observed = vec![0.0; expected.len() + 1];
        for i in 0..samples {
            let bin = sample(i).map_or(expected.len(), |direction| self.bin(direction));
            observed[bin] += 1.0;
        }
        let total: f64 = expected.iter().sum();
        expected.push(1.0 - total);
        for e in &mut expected {
            *e *= samples as f64;
        }
        // The integral is known to about the tolerance of its bins: a rest below that is none, and an excess beyond it is an error.
        let rest = expected.len() - 1;
        if total > 1.0 + 2e-3 {
            return Chi2 {
                statistic: f64::INFINITY,
                degrees: 0,
                p: 0.0,
                worst: vec![(rest, observed[rest], expected[rest])],
            };
        }
        chi2_test(&observed, &expected)
    }
}

/// 3x3 Gauss-Legendre rule over `[t, phi, height, width]`.
fn gauss([t, phi, h, w]: [f64; 4], f: &mut dyn FnMut(f64, f64) -> f64) -> f64 {
    const NODES: [(f64, f64); 3] = [
        (0.112_701_665_379_258_3, 5.0 / 18.0),
        (0.5, 8.0 / 18.0),
        (0.887_298_334_620_741_7, 5.0 / 18.0),
    ];
    let mut sum = 0.0;
    for (x, wx) in NODES {
        for (y, wy) in NODES {
            sum += wx * wy * f(t + x * h, phi + y * w);
        }
    }
    sum * h * w
}

fn subdivide(
    cell: [f64; 4],
    whole: f64,
    tolerance: f64,
    depth: u32,
    f: &mut dyn FnMut(f64, f64) -> f64,
) -> f64 {
    let [t, phi, h, w] = cell;
    let (h, w) = (0.5 * h, 0.5 * w);
    let quarters = [
        [t, phi, h, w],
        [t + h, phi, h, w],
        [t, phi + w, h, w],
        [t + h, phi + w, h, w],
    ];
    let parts = quarters.map(|q| gauss(q, f));
    let sum: f64 = parts.iter().sum();
    if depth == 0 || (sum - whole).abs() <= tolerance.max(1e-3 * sum.abs()) {
        return sum;
    }
    quarters
        .into_iter()
        .zip(parts)
        .map(|(q, part)| subdivide(q, part, 0.5 * tolerance, depth - 1, f))
        .sum()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn normalized(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// SplitMix64 (Steele et al. 2014).
    fn random(i: usize, stream: u64) -> f64 {
        let mut x = (i as u64 * 16 + stream).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn cosine(i: usize) -> Option<[f64; 3]> {
        let (r, phi) = (random(i, 1).sqrt(), 2.0 * PI * random(i, 2));
        Some([r * phi.cos(), r * phi.sin(), (1.0 - r * r).sqrt()])
    }

    #[test]
    fn accepts_the_right_density_and_no_other() {
        for grid in [
            SphereGrid::default(),
            SphereGrid {
                pole: [0.6, 0.0, 0.8],
                concentration: 3,
                ..Default::default()
            },
        ] {
            let right = grid.test(200_000, &mut cosine, &mut |d| d[2].max(0.0) / PI);
            assert!(right.p > 1e-3, "{right:?}");
            // Up to 10 % too much at one side, nothing changed in the total.
            let skewed = grid.test(200_000, &mut cosine, &mut |d| {
                d[2].max(0.0) / PI * (1.0 + 0.1 * d[0])
            });
            assert!(skewed.p < 1e-6, "{skewed:?}");
            let scaled = grid.test(200_000, &mut cosine, &mut |d| 0.98 * d[2].max(0.0) / PI);
            assert!(scaled.p < 1e-6, "{scaled:?}");
            let uniform = grid.test(200_000, &mut cosine, &mut |_| 0.25 / PI);
            assert!(uniform.p < 1e-6, "{uniform:?}");
        }
    }

    #[test]
    fn p_is_uniform_under_the_null_hypothesis() {
        let mut below = 0;
        let runs = 400;
        for run in 0..runs {
            let mut observed = [0.0; 16];
            for i in 0..2000 {
                observed[(random(i + 2000 * run, 7) * 16.0) as usize] += 1.0;
            }
            below += i32::from(chi2_test(&observed, &[125.0; 16]).p < 0.1);
        }
        // 40 expected, standard deviation 6.
        assert!((16..=64).contains(&below), "{below} of {runs}");
    }

    #[test]
    fn an_impossible_count_is_fatal() {
        assert_eq!(chi2_test(&[100.0, 1.0], &[101.0, 0.0]).p, 0.0);
        assert!(chi2_test(&[101.0, 0.0], &[101.0, 0.0]).p > 0.99);
    }
}
