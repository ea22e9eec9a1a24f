//! GGX reflections as spherical Gaussians.
//!
//! The distribution of microfacet normals is a sum of one to three lobes about the surface's normal, `D(h) = sum A_k exp(l_k (h.n - 1))`, fitted by
//! least squares for each alpha (one lobe loses the tails: see [`Fit::residual`]). A lobe of normals becomes a lobe of reflected directions about
//! the mirrored view (Wang et al. 2009): the half vector turns half as fast as the direction, `dh/di = 1 / (4 o.h)`, so its sharpness is
//! `l_k / (4 o.n)`. In place of Fresnel's term, shadowing and the cosine at the lobe's centre stands the lobe's exact albedo
//! in even light, so that nothing is lost at grazing angles, where the centre says little; and a part of rough reflections is matt ([`matt_share`]).
//!
//! Wrong tool for reflections along the surface, which are stretched where these lobes are round.

use occlude_visibility::field::{SphericalGaussian, VisibleShare};
use std::sync::LazyLock;

/// Lobes at most.
pub(super) const MOST: usize = 3;

/// A distribution as lobes: the share of each in the projected area, and its sharpness times alpha squared.
#[derive(Clone, Copy, Debug, Default)]
struct Fit {
    shares: [f32; MOST],
    sharpness: [f32; MOST],
    /// The part of the projected area that is in wrong places, 0 to 1.
    residual: f32,
}

/// Fits are made for so many alphas from 0 to 1.
const ALPHAS: usize = 17;

/// Nothing is fitted narrower than this: the shape no longer changes.
const LEAST_ALPHA: f64 = 0.02;

static FITS: LazyLock<[[Fit; ALPHAS]; MOST]> = LazyLock::new(|| {
    std::array::from_fn(|count| {
        std::array::from_fn(|i| fit((i as f64 / (ALPHAS - 1) as f64).max(LEAST_ALPHA), count + 1))
    })
});

/// A glossy lobe of reflected directions.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lobe {
    pub(super) sharpness: f32,
    /// What the integral of the lobe (with amplitude 1, over the directions above the surface) is multiplied with to reflect the lobe's
    /// share of an even light.
    pub(super) amplitude: f32,
}

/// The lobes of a GGX reflection of albedo 1 that is seen under a cosine, the mirrored view being the centre. `count` from 1 to 3.
pub(super) fn lobes(alpha: f32, cos_o: f32, count: usize) -> [Lobe; MOST] {
    let x = alpha.clamp(0.0, 1.0) * (ALPHAS - 1) as f32;
    let i = (x as usize).min(ALPHAS - 2);
    let t = x - i as f32;
    let fits = &FITS[count - 1];
    let alpha2 = (alpha * alpha).max(1e-7);
    let share = VisibleShare::new();
    // Mirrored, the view is as high above the horizon as it was.
    let height = cos_o.clamp(-1.0, 1.0).asin();
    std::array::from_fn(|k| {
        let lerp = |a: f32, b: f32| a + (b - a) * t;
        let part = lerp(fits[i].shares[k], fits[i + 1].shares[k]);
        if part <= 0.0 {
            return Lobe::default();
        }
        let of_normals = lerp(fits[i].sharpness[k], fits[i + 1].sharpness[k]) / alpha2;
        let sharpness = of_normals / (4.0 * cos_o.max(0.05));
        let above = SphericalGaussian::unit_integral(sharpness) * share.at(height, sharpness);
        Lobe {
            sharpness,
            amplitude: part / above,
        }
    })
}

/// Cosines of views that [`matt_share`] is known for: `(j + 1) / COSINES`.
const COSINES: usize = 10;
/// Below this alpha (its number among the fits) lobes are too narrow for the cosine to differ within them.
const FIRST_MATT: usize = 2;

static MATT: LazyLock<[[[f32; COSINES]; ALPHAS]; MOST]> = LazyLock::new(|| {
    std::array::from_fn(|count| {
        std::array::from_fn(|i| {
            if i < FIRST_MATT {
                return [0.0; COSINES];
            }
            let fit = &FITS[count][i];
            let alpha = i as f64 / (ALPHAS - 1) as f64;
            std::array::from_fn(|j| fit_matt(fit, alpha, (j + 1) as f64 / COSINES as f64))
        })
    })
});

/// The share of a GGX reflection that is better put into a cosine lobe about the normal. Shadowing and the cosine, which lobes leave out, push light that arrives along the surface out of
/// rough reflections: a good deal of them is matt. The share is that of least squares over directions.
pub(super) fn matt_share(alpha: f32, cos_o: f32, count: usize) -> f32 {
    let between = |x: f32, most: usize| {
        let i = (x as usize).min(most - 2);
        (i, x - i as f32)
    };
    let (i, t) = between(alpha.clamp(0.0, 1.0) * (ALPHAS - 1) as f32, ALPHAS);
    let x = (cos_o * COSINES as f32 - 1.0).clamp(0.0, (COSINES - 1) as f32);
    let (j, u) = between(x, COSINES);
    let along = |row: &[f32; COSINES]| row[j] + (row[j + 1] - row[j]) * u;
    let table = &MATT[count - 1];
    let (a, b) = (along(&table[i]), along(&table[i + 1]));
    a + (b - a) * t
}

fn fit_matt(fit: &Fit, alpha: f64, cos_o: f64) -> f32 {
    const STEPS: usize = 48;
    let smith = |c: f64| (-1.0 + (1.0 + alpha * alpha * (1.0 / (c * c) - 1.0)).sqrt()) / 2.0;
    let sin_o = (1.0 - cos_o * cos_o).sqrt();
    // Directions of equal solid angle over a quarter of the sphere: the other half is the same. The truth, each lobe, and the cosine lobe, all with sum 1.
    let mut columns = vec![[0.0; MOST + 2]; STEPS * STEPS];
    for (index, column) in columns.iter_mut().enumerate() {
        let z = ((index / STEPS) as f64 + 0.5) / STEPS as f64;
        let phi = ((index % STEPS) as f64 + 0.5) / STEPS as f64 * std::f64::consts::PI;
        let x = (1.0 - z * z).sqrt() * phi.cos();
        let (along, across) = (sin_o * x, cos_o * z);
        let h_z = (z + cos_o) / (2.0 * (1.0 + along + across)).max(1e-12).sqrt();
        let e = h_z * h_z * (alpha * alpha - 1.0) + 1.0;
        column[MOST] = 1.0 / (e * e * (1.0 + smith(z) + smith(cos_o)));
        column[MOST + 1] = z;
        for (value, &of_normals) in column.iter_mut().zip(&fit.sharpness) {
            let sharpness = f64::from(of_normals) / (alpha * alpha) / (4.0 * cos_o);
            *value = (sharpness * (across - along - 1.0)).exp();
        }
    }
    let mut sums = [0.0; MOST + 2];
    for column in &columns {
        sums.iter_mut().zip(column).for_each(|(sum, v)| *sum += v);
    }
    let (mut over, mut under) = (0.0, 0.0);
    for column in &columns {
        let lobes: f64 = (0..MOST)
            .map(|k| f64::from(fit.shares[k]) * column[k] / sums[k])
            .sum();
        let matt = column[MOST + 1] / sums[MOST + 1] - lobes;
        over += (column[MOST] / sums[MOST] - lobes) * matt;
        under += matt * matt;
    }
    (over / under).clamp(0.0, 1.0) as f32
}

/// The share of the reflection that a fit puts in wrong places.
pub(super) fn residual(alpha: f32, count: usize) -> f32 {
    let i = (alpha.clamp(0.0, 1.0) * (ALPHAS - 1) as f32).round() as usize;
    FITS[count - 1][i].residual
}

/// Nodes of the quadrature over `x = tan^2 / alpha^2`, evenly in `x / (1 + x)`, which is the share of the projected area.
const NODES: usize = 128;

fn fit(alpha: f64, count: usize) -> Fit {
    // GGX: the projected area within an angle is x / (1 + x), so nodes that are even in it carry equal area.
    let nodes: Vec<(f64, f64)> = (0..NODES)
        .map(|i| {
            let area = (i as f64 + 0.5) / NODES as f64;
            let tan2 = alpha * alpha * area / (1.0 - area);
            let cos = 1.0 / (1.0 + tan2).sqrt();
            let e = cos * cos * (alpha * alpha - 1.0) + 1.0;
            (cos, alpha * alpha / (std::f64::consts::PI * e * e))
        })
        .collect();
    // The error of a node is relative to D, as its area is: least squares of fit / D - 1.
    let solve = |sharpness: &[f64]| -> ([f64; MOST], f64) {
        let n = sharpness.len();
        let mut gram = [[0.0; MOST]; MOST];
        let mut right = [0.0; MOST];
        let values = |cos: f64, d: f64| -> [f64; MOST] {
            std::array::from_fn(|k| {
                if k < n {
                    (sharpness[k] * (cos - 1.0)).exp() / d
                } else {
                    0.0
                }
            })
        };
        for &(cos, d) in &nodes {
            let v = values(cos, d);
            for a in 0..n {
                right[a] += v[a];
                for b in 0..n {
                    gram[a][b] += v[a] * v[b];
                }
            }
        }
        let amplitude = solve_positive(&gram, &right, n);
        let error = nodes.iter().map(|&(cos, d)| {
            let v = values(cos, d);
            let sum: f64 = (0..n).map(|k| v[k] * amplitude[k]).sum();
            (sum - 1.0).powi(2)
        });
        (amplitude, error.sum::<f64>())
    };
    let mut best: Vec<f64> = [1.5, 0.4, 0.06][..count]
        .iter()
        .map(|s| s * 2.0 / (alpha * alpha))
        .collect();
    let mut least = solve(&best).1;
    let mut step = 2.0;
    while step > 1.01 {
        let mut better = false;
        for k in 0..count {
            for factor in [step, 1.0 / step] {
                let mut trial = best.clone();
                trial[k] *= factor;
                let error = solve(&trial).1;
                if error < least {
                    (best, least, better) = (trial, error, true);
                }
            }
        }
        if !better {
            step = f64::sqrt(step);
        }
    }
    let (amplitude, _) = solve(&best);
    // Projected area of a lobe: 2 pi times the integral of exp(l (c - 1)) c dc.
    let area = |l: f64| {
        let n = 400;
        (0..n)
            .map(|i| {
                let cos = (f64::from(i) + 0.5) / f64::from(n);
                (l * (cos - 1.0)).exp() * cos
            })
            .sum::<f64>()
            * std::f64::consts::TAU
            / f64::from(n)
    };
    let area = |l: f64| {
        if l > 50.0 {
            std::f64::consts::TAU / l * (1.0 - 1.0 / l)
        } else {
            area(l)
        }
    };
    let areas: Vec<f64> = (0..count).map(|k| amplitude[k] * area(best[k])).collect();
    let total: f64 = areas.iter().sum();
    let wrong: f64 = nodes
        .iter()
        .map(|&(cos, d)| {
            let sum: f64 = (0..count)
                .map(|k| amplitude[k] / total * (best[k] * (cos - 1.0)).exp())
                .sum();
            (sum / d - 1.0).abs()
        })
        .sum();
    let mut fit = Fit {
        residual: (0.5 * wrong / NODES as f64) as f32,
        ..Fit::default()
    };
    for k in 0..count {
        fit.shares[k] = (areas[k] / total) as f32;
        fit.sharpness[k] = (best[k] * alpha * alpha) as f32;
    }
    fit
}

/// The solution of a small symmetric system with what would be negative held at 0.
fn solve_positive(gram: &[[f64; MOST]; MOST], right: &[f64; MOST], n: usize) -> [f64; MOST] {
    let mut x = [0.0; MOST];
    // Coordinate descent: converges for any start, as the matrix is positive.
    for _ in 0..80 {
        for a in 0..n {
            let others: f64 = (0..n).filter(|b| *b != a).map(|b| gram[a][b] * x[b]).sum();
            x[a] = ((right[a] - others) / gram[a][a].max(1e-300)).max(0.0);
        }
    }
    x
}
