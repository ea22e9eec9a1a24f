//! Directional albedo of the GGX lobe: how much of the light that leaves towards `wo` a single bounce on the microsurface explains.
//!
//! For Schlick's Fresnel term the albedo is linear, `E(mu) = f0 A(mu) + f90 B(mu)`, with
//! `A = ∫ f cos (1 - (1-c)^5)`, `B = ∫ f cos (1-c)^5` for a perfect mirror's lobe `f` (`c` = cosine at the microfacet). Both are tabulated
//! over the root of the cosine and over perceptual roughness by a midpoint rule over visible normals, once per process (some milliseconds),
//! and read bilinearly. `1 - A - B` is what the single-bounce model loses; the cosine averages
//! serve the energy compensation of Kulla & Conty 2017 (and Turquin 2019 for what the table holds).
//!
//! The table is off by less than 0.002 (test `table_matches_quadrature`).

use super::layers::{SHEEN_ROUGHNESS_MIN, charlie};
use super::microfacet::{
    g1_over_2cos, g2_over_4cos_cos, reflect, sample_visible_normal, schlick_weight, smith_root,
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
    /// By roughness, then by cosine.
    rows: [[Split; NODES]; NODES],
    /// Cosine-weighted mean of each row.
    means: [Split; NODES],
}

static TABLE: LazyLock<Box<Table>> = LazyLock::new(Table::build);

impl Table {
    fn build() -> Box<Self> {
        let mut table = Box::new(Self {
            rows: [[Split::default(); NODES]; NODES],
            means: [Split::default(); NODES],
        });
        for (r, (row, mean)) in table.rows.iter_mut().zip(&mut table.means).enumerate() {
            let roughness = r as f32 / (NODES - 1) as f32;
            for (m, node) in row.iter_mut().enumerate() {
                let root = m as f32 / (NODES - 1) as f32;
                *node = integrate(roughness * roughness, root * root, POINTS);
            }
            *mean = mean_of(row);
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
                let weight = 2.0 * wi.z * g2_over_4cos_cos(mu, root_o, wi.z, root_i)
                    / g1_over_2cos(mu, root_o);
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

/// Two neighbouring rows of the table: the albedo of one roughness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    index: u32,
    fraction: f32,
}

impl Row {
    /// The row of a perfect mirror.
    pub const ZERO: Self = Self {
        index: 0,
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
        let table = &**TABLE;
        let x = cos.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f32;
        let i = (x as usize).min(NODES - 2);
        let t = x - i as f32;
        let k = (self.index as usize).min(NODES - 2);
        let (lower, upper) = (&table.rows[k], &table.rows[k + 1]);
        lower[i]
            .lerp(lower[i + 1], t)
            .lerp(upper[i].lerp(upper[i + 1], t), self.fraction)
    }

    /// Cosine-weighted mean over the hemisphere.
    #[inline]
    pub fn mean(self) -> Split {
        let k = (self.index as usize).min(NODES - 2);
        TABLE.means[k].lerp(TABLE.means[k + 1], self.fraction)
    }
}

/// Nodes along each axis of the sheen's table.
const SHEEN_NODES: usize = 24;

/// Directional albedo of a white sheen, by roughness, then by the root of the cosine. Built when a sheen is first met.
static SHEEN: LazyLock<Box<[[f32; SHEEN_NODES]; SHEEN_NODES]>> = LazyLock::new(|| {
    let mut table = Box::new([[0.0; SHEEN_NODES]; SHEEN_NODES]);
    for (r, row) in table.iter_mut().enumerate() {
        let roughness = (r as f32 / (SHEEN_NODES - 1) as f32).max(SHEEN_ROUGHNESS_MIN);
        for (m, node) in row.iter_mut().enumerate() {
            let root = m as f32 / (SHEEN_NODES - 1) as f32;
            *node = integrate_sheen(roughness, root * root, 24);
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
            let z = t * t;
            let (sin, cos) = (PI * (j as f32 + 0.5) / points as f32).sin_cos();
            let r = (1.0 - z * z).max(0.0).sqrt();
            let wi = Vec3::new(r * cos, r * sin, z);
            let value = charlie(roughness, wo, wi, (wo + wi).normalize_or_zero());
            sum += f64::from(value * z * 2.0 * t);
        }
    }
    (sum / f64::from(points * points)) as f32 * 2.0 * PI
}

/// Directional albedo of a white sheen.
pub(super) fn sheen_albedo(roughness: f32, cos: f32) -> f32 {
    let table = &**SHEEN;
    let cell = |x: f32| {
        let x = x * (SHEEN_NODES - 1) as f32;
        let i = (x as usize).min(SHEEN_NODES - 2);
        (i, x - i as f32)
    };
    let (i, s) = cell(cos.clamp(0.0, 1.0).sqrt());
    let (k, t) = cell(roughness.clamp(0.0, 1.0));
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    lerp(
        lerp(table[k][i], table[k][i + 1], s),
        lerp(table[k + 1][i], table[k + 1][i + 1], s),
        t,
    )
    .min(1.0)
}
