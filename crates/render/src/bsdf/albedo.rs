//! Directional albedo of the GGX lobe: how much of the light that leaves towards `wo` a single bounce on the microsurface explains.
//!
//! For Schlick's Fresnel term the albedo is linear, `E(mu) = f0 A(mu) + f90 B(mu)`, with
//! `A = ∫ f cos (1 - (1-c)^5)`, `B = ∫ f cos (1-c)^5` for a perfect mirror's lobe `f` (`c` = cosine at the microfacet). Both are tabulated
//! over the root of the cosine and over perceptual roughness by a midpoint rule over visible normals, once per process (some milliseconds),
//! and read bilinearly. `1 - A - B` is what the single-bounce model loses; the cosine averages
//! serve the energy compensation of Kulla & Conty 2017 (and Turquin 2019 for what the table holds).
//!
//! The table is off by less than 0.01, and by less than 0.05 below a cosine of 0.02 (test `table_matches_quadrature`).

use super::layers::{SHEEN_ROUGHNESS_MIN, charlie};
use super::microfacet::{
    g1_over_2cos, g2_over_4cos_o, reflect, sample_visible_normal, schlick_weight, smith_root,
};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;
use std::sync::LazyLock;

/// Nodes along each axis.
const NODES: usize = 32;
/// Points per axis of the midpoint rule.
const POINTS: u32 = 32;

/// Albedo of a lobe whose Fresnel term is 1: `a` where Schlick's weight is 0, `b` where it is 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Split {
    pub a: f32,
    pub b: f32,
}

impl Split {
    #[inline]
    fn lerp(self, other: Self, t: f32) -> Self {
        Self {
            a: self.a + (other.a - self.a) * t,
            b: self.b + (other.b - self.b) * t,
        }
    }

    /// A perfect mirror.
    #[inline]
    pub fn mirror(cos: f32) -> Self {
        let b = schlick_weight(cos);
        Self { a: 1.0 - b, b }
    }

    /// Share of light that a single bounce does not explain.
    #[inline]
    pub fn lost(self) -> f32 {
        (1.0 - self.a - self.b).max(0.0)
    }
}

struct Table {
    /// By the root of the cosine, then by roughness, so that a look-up reads two pairs of neighbours.
    columns: [[Split; NODES]; NODES],
    /// Cosine-weighted mean by roughness.
    means: [Split; NODES],
}

static TABLE: LazyLock<Box<Table>> = LazyLock::new(Table::build);

impl Table {
    fn build() -> Box<Self> {
        let mut table = Box::new(Self {
            columns: [[Split::default(); NODES]; NODES],
            means: [Split::default(); NODES],
        });
        for r in 0..NODES {
            let roughness = r as f32 / (NODES - 1) as f32;
            let row: [Split; NODES] = std::array::from_fn(|m| {
                let root = m as f32 / (NODES - 1) as f32;
                integrate(roughness * roughness, root * root, POINTS)
            });
            for (column, node) in table.columns.iter_mut().zip(row) {
                column[r] = node;
            }
            table.means[r] = mean_of(&row);
        }
        table
    }
}

/// `2 ∫ E(mu) mu dmu` of the piecewise linear function that the table stands for; with `t = sqrt(mu)` that is `4 ∫ E t³ dt`.
fn mean_of(row: &[Split; NODES]) -> Split {
    let steps = 32 * (NODES - 1);
    let (mut a, mut b, mut norm) = (0.0_f64, 0.0_f64, 0.0_f64);
    for i in 0..steps {
        let t = (i as f32 + 0.5) / steps as f32;
        let e = along(row, t);
        let weight = f64::from(t).powi(3);
        a += weight * f64::from(e.a);
        b += weight * f64::from(e.b);
        norm += weight;
    }
    Split {
        a: (a / norm) as f32,
        b: (b / norm) as f32,
    }
}

/// Linear interpolation at `t` in `[0, 1]`.
#[inline]
fn along(row: &[Split; NODES], t: f32) -> Split {
    let x = t * (NODES - 1) as f32;
    let i = (x as usize).min(NODES - 2);
    row[i].lerp(row[i + 1], x - i as f32)
}

/// The albedo by a midpoint rule of `points²` visible normals: the reference that the table is made from.
pub(super) fn integrate(alpha: f32, mu: f32, points: u32) -> Split {
    if alpha == 0.0 {
        return Split::mirror(mu);
    }
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
    let root_o = smith_root(alpha, mu);
    let (mut a, mut b) = (0.0_f64, 0.0_f64);
    for i in 0..points {
        for j in 0..points {
            let u = Vec2::new(i as f32 + 0.5, j as f32 + 0.5) / points as f32;
            let h = sample_visible_normal(alpha, wo, u);
            let wi = reflect(wo, h);
            if wi.z > 0.0 {
                let root_i = smith_root(alpha, wi.z);
                // f cos / pdf of visible normals = G2 / G1.
                let weight =
                    2.0 * g2_over_4cos_o(mu, root_o, wi.z, root_i) / g1_over_2cos(mu, root_o);
                let s = schlick_weight(wo.dot(h));
                a += f64::from(weight * (1.0 - s));
                b += f64::from(weight * s);
            }
        }
    }
    let n = f64::from(points * points);
    Split {
        a: (a / n) as f32,
        b: (b / n) as f32,
    }
}

/// The albedo of one roughness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// Index of the lower of two neighbouring rows; [`MIRROR`] for a perfect mirror.
    index: u32,
    fraction: f32,
}

/// Stands for a perfect mirror, whose albedo needs no table.
const MIRROR: u32 = u32::MAX;

impl Row {
    /// The row of a perfect mirror.
    pub const MIRROR: Self = Self {
        index: MIRROR,
        fraction: 0.0,
    };

    /// The row of a perceptual roughness in `[0, 1]`.
    #[inline]
    pub fn new(roughness: f32) -> Self {
        let x = roughness * (NODES - 1) as f32;
        let index = (x as u32).min(NODES as u32 - 2);
        Self {
            index,
            fraction: x - index as f32,
        }
    }

    /// Albedo towards a cosine in `[0, 1]`.
    #[inline]
    pub fn at(self, cos: f32) -> Split {
        if self.index == MIRROR {
            return Split::mirror(cos);
        }
        let table = &**TABLE;
        let x = cos.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f32;
        let i = (x as usize).min(NODES - 2);
        let k = (self.index as usize).min(NODES - 2);
        let (lower, upper) = (&table.columns[i], &table.columns[i + 1]);
        let t = x - i as f32;
        lower[k]
            .lerp(upper[k], t)
            .lerp(lower[k + 1].lerp(upper[k + 1], t), self.fraction)
    }

    /// Cosine-weighted mean over the hemisphere.
    #[inline]
    pub fn mean(self) -> Split {
        if self.index == MIRROR {
            return Split {
                a: 20.0 / 21.0,
                b: 1.0 / 21.0,
            };
        }
        let k = (self.index as usize).min(NODES - 2);
        TABLE.means[k].lerp(TABLE.means[k + 1], self.fraction)
    }
}

/// Coefficients of [`Polynomials`].
pub(crate) const COEFFICIENTS: usize = 7;

/// Directional albedo of one roughness as polynomials in the root of the cosine: for vector units, which read tables badly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Polynomials {
    /// `A`, lowest power first.
    pub(crate) a: [f32; COEFFICIENTS],
    /// `B`.
    pub(crate) b: [f32; COEFFICIENTS],
}

impl Polynomials {
    /// `[A, B]` at the root of a cosine: the plain form of what vector loops compute.
    #[cfg(test)]
    pub(crate) fn at(&self, root: f32) -> [f32; 2] {
        [&self.a, &self.b].map(|c| c.iter().rev().fold(0.0, |sum, c| sum * root + c))
    }

    fn lerp(&self, other: &Self, t: f32) -> Self {
        let lerp = |a: [f32; COEFFICIENTS], b: [f32; COEFFICIENTS]| {
            std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
        };
        Self {
            a: lerp(self.a, other.a),
            b: lerp(self.b, other.b),
        }
    }

    /// Least squares over the cosine's root, by its normal equations in Legendre's basis (which keeps them well conditioned).
    fn fit(albedo: impl Fn(f32) -> Split) -> Self {
        const POINTS: usize = 256;
        let basis = |x: f64| {
            let mut p = [1.0, x, 0.0, 0.0, 0.0, 0.0, 0.0];
            for n in 1..COEFFICIENTS - 1 {
                let k = n as f64;
                p[n + 1] = ((2.0 * k + 1.0) * x * p[n] - k * p[n - 1]) / (k + 1.0);
            }
            p
        };
        // Legendre's polynomials are orthogonal: by Gauss' nodes they would be so exactly, by midpoints nearly; projection suffices.
        let mut sums = [[0.0_f64; COEFFICIENTS]; 2];
        for i in 0..POINTS {
            let t = (i as f64 + 0.5) / POINTS as f64;
            let e = albedo((t * t) as f32);
            let p = basis(2.0 * t - 1.0);
            for n in 0..COEFFICIENTS {
                let weight = (2 * n + 1) as f64 / POINTS as f64;
                sums[0][n] += f64::from(e.a) * p[n] * weight;
                sums[1][n] += f64::from(e.b) * p[n] * weight;
            }
        }
        // Back to powers of t: the polynomials of 2t - 1, multiplied out.
        let mut powers = [[0.0_f64; COEFFICIENTS]; COEFFICIENTS];
        powers[0][0] = 1.0;
        powers[1][0] = -1.0;
        powers[1][1] = 2.0;
        for n in 1..COEFFICIENTS - 1 {
            let k = n as f64;
            for i in 0..COEFFICIENTS {
                let shifted = if i > 0 { 2.0 * powers[n][i - 1] } else { 0.0 } - powers[n][i];
                powers[n + 1][i] = ((2.0 * k + 1.0) * shifted - k * powers[n - 1][i]) / (k + 1.0);
            }
        }
        let expand = |sums: &[f64; COEFFICIENTS]| {
            std::array::from_fn(|i| {
                (0..COEFFICIENTS)
                    .map(|n| sums[n] * powers[n][i])
                    .sum::<f64>() as f32
            })
        };
        Self {
            a: expand(&sums[0]),
            b: expand(&sums[1]),
        }
    }
}

/// By roughness; the last one is a perfect mirror's.
static POLYNOMIALS: LazyLock<Vec<Polynomials>> = LazyLock::new(|| {
    let rows = (0..NODES).map(|r| {
        let row = Row {
            index: (r as u32).min(NODES as u32 - 2),
            fraction: if r == NODES - 1 { 1.0 } else { 0.0 },
        };
        Polynomials::fit(|cos| row.at(cos))
    });
    rows.chain([Polynomials::fit(Split::mirror)]).collect()
});

impl Row {
    /// The row as polynomials.
    pub(super) fn polynomials(self) -> Polynomials {
        if self.index == MIRROR {
            return POLYNOMIALS[NODES];
        }
        let k = (self.index as usize).min(NODES - 2);
        POLYNOMIALS[k].lerp(&POLYNOMIALS[k + 1], self.fraction)
    }
}

/// Nodes along each axis of the sheen's table.
const SHEEN_NODES: usize = 24;

/// Directional albedo of a white sheen, by roughness, then by the root of the cosine. Built when a sheen is first met.
static SHEEN: LazyLock<Box<[[f32; SHEEN_NODES]; SHEEN_NODES]>> = LazyLock::new(|| {
    let mut table = Box::new([[0.0; SHEEN_NODES]; SHEEN_NODES]);
    for (r, row) in table.iter_mut().enumerate() {
        let roughness =
            SHEEN_ROUGHNESS_MIN + (1.0 - SHEEN_ROUGHNESS_MIN) * r as f32 / (SHEEN_NODES - 1) as f32;
        for (m, node) in row.iter_mut().enumerate() {
            let root = m as f32 / (SHEEN_NODES - 1) as f32;
            *node = integrate_sheen(roughness, root * root, 32);
        }
    }
    table
});

/// Directional albedo of a white sheen by a midpoint rule of `points²` directions.
pub(super) fn integrate_sheen(roughness: f32, mu: f32, points: u32) -> f32 {
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
    let mut sum = 0.0_f64;
    for i in 0..points {
        for j in 0..points {
            // Symmetric in azimuth: half of the circle is enough. Nodes crowd towards the horizon, where the lobe is.
            let t = (i as f32 + 0.5) / points as f32;
            let z = t * t * t;
            let (sin, cos) = (PI * (j as f32 + 0.5) / points as f32).sin_cos();
            let r = (1.0 - z * z).max(0.0).sqrt();
            let wi = Vec3::new(r * cos, r * sin, z);
            let value = charlie(roughness, wo, wi, (wo + wi).normalize_or_zero());
            sum += f64::from(value * z * 3.0 * t * t);
        }
    }
    (sum / f64::from(points * points)) as f32 * 2.0 * PI
}

/// Directional albedo of a white sheen. Above 1 for smooth sheen at grazing angles: the caller has to scale that down.
pub(super) fn sheen_albedo(roughness: f32, cos: f32) -> f32 {
    let table = &**SHEEN;
    let cell = |x: f32| {
        let x = x * (SHEEN_NODES - 1) as f32;
        let i = (x as usize).min(SHEEN_NODES - 2);
        (i, x - i as f32)
    };
    let (i, s) = cell(cos.clamp(0.0, 1.0).sqrt());
    let (k, t) =
        cell(((roughness - SHEEN_ROUGHNESS_MIN) / (1.0 - SHEEN_ROUGHNESS_MIN)).clamp(0.0, 1.0));
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    lerp(
        lerp(table[k][i], table[k][i + 1], s),
        lerp(table[k + 1][i], table[k + 1][i + 1], s),
        t,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_matches_quadrature() {
        let mut worst = (0.0_f32, 0.0, 0.0);
        for roughness in [0.05, 0.13, 0.27, 0.44, 0.61, 0.79, 0.97] {
            for mu in [0.003, 0.02, 0.07, 0.18, 0.33, 0.56, 0.77, 0.99] {
                let table = Row::new(roughness).at(mu);
                let exact = integrate(roughness * roughness, mu, 200);
                let error = (table.a + table.b - exact.a - exact.b)
                    .abs()
                    .max((table.b - exact.b).abs());
                // Smooth and seen along the surface the albedo bends faster than the table's nodes lie.
                let bound = if mu < 0.02 { 0.05 } else { 0.01 };
                assert!(
                    error < bound,
                    "roughness {roughness}, cosine {mu}: off by {error}"
                );
                if mu >= 0.02 && error > worst.0 {
                    worst = (error, roughness, mu);
                }
            }
        }
        println!("worst error from cosine 0.02 on (error, roughness, cosine): {worst:?}");
    }

    #[test]
    fn sheen_table_is_close() {
        for roughness in [0.1, 0.17, 0.3, 0.52, 0.9] {
            for mu in [0.01, 0.06, 0.2, 0.5, 0.95] {
                let (table, exact) = (
                    sheen_albedo(roughness, mu),
                    integrate_sheen(roughness, mu, 300),
                );
                assert!(
                    table > 0.93 * exact - 0.01 && table < exact * 1.1 + 0.01,
                    "roughness {roughness}, cosine {mu}: {table}, not {exact}"
                );
            }
        }
    }
}
