//! What a single bounce loses at the rough boundary of a body, and how that light is given back.
//!
//! Walter's refraction lets light go that meets the microsurface a second time. With `l(mu) = 1 - E(mu)`, `E` the albedo of
//! reflection and transmission together, and `L` its cosine mean, the lost light leaves by cosine lobes (Kulla & Conty 2017, "Revisiting
//! physically based shading at Imageworks", for dielectrics): from side `s` a share `b_s` on the other side, the rest on its own:
//!
//! `reflected (1-b_s) l_s(o) l_s(i) / (π L_s)`, `transmitted b_s l_s(o) l_t(i) / (π L_t)`, cosine left out.
//!
//! All that a direction loses comes back. Reciprocity across an index `n` wants `b_1 L_1 = n² b_2 L_2` (1 outside). Kulla & Conty
//! share by the mean Fresnel reflectance `F`, for which `1 - F_1 = n² (1 - F_2)`; here `b_1 = (1-F_1) min(1, L_2/L_1)` and
//! `b_2 = (1-F_2) min(1, L_1/L_2)`, which is reciprocal and never above 1.
//!
//! `l` is a table by side, index, roughness and cosine (72 KiB, off by less than 0.01, by less than 0.02 below a cosine of 0.05), made by the ignored test `make_table` and kept in `boundary.bin`: 16-bit
//! numbers, little-endian. A second number per node corrects for materials whose reflection is weakened. Wrong
//! tool for: where the light that bounced several times goes exactly (Heitz et al. 2016 walk on the microsurface).

use super::microfacet::fresnel_dielectric;
use glam::Vec3;
use std::sync::LazyLock;

/// Nodes by the root of the cosine, by roughness, and by [`place_of`] the index.
const COSINES: usize = 24;
const ROUGHNESSES: usize = 24;
const INDICES: usize = 16;

/// Below this mean loss no light is missed.
const NEGLIGIBLE_LOSS: f32 = 1e-4;

/// A node: the loss, and what weakened reflection adds to the albedo, per share that is taken from reflection.
type Node = [f32; 2];

struct Table {
    /// Outside first, then inside; by index, roughness, cosine.
    nodes: Vec<[Node; COSINES]>,
    /// Cosine means of the above.
    means: Vec<Node>,
}

static TABLE: LazyLock<Table> = LazyLock::new(|| {
    let numbers = include_bytes!("boundary.bin").as_chunks::<2>().0;
    let nodes: Vec<[Node; COSINES]> = numbers
        .chunks_exact(2 * COSINES)
        .map(|row| {
            std::array::from_fn(|m| {
                let number = |k: usize| f32::from(u16::from_le_bytes(row[2 * m + k])) / 65_535.0;
                [number(0), 2.0 * number(1) - 1.0]
            })
        })
        .collect();
    let means = nodes.iter().map(mean_of).collect();
    Table { nodes, means }
});

/// `2 ∫ f(mu) mu dmu` of the piecewise linear function in `t = sqrt(mu)`: `4 ∫ f t³ dt`.
fn mean_of(row: &[Node; COSINES]) -> Node {
    const STEPS: usize = 16;
    let mut sum = [0.0_f64; 2];
    let mut norm = 0.0_f64;
    for i in 0..STEPS * (COSINES - 1) {
        let x = (i as f32 + 0.5) / STEPS as f32;
        let weight = f64::from(x).powi(3);
        let value = along(row, x);
        norm += weight;
        for k in 0..2 {
            sum[k] += weight * f64::from(value[k]);
        }
    }
    sum.map(|s| (s / norm) as f32)
}

#[inline]
fn lerp(a: Node, b: Node, t: f32) -> Node {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}

/// Between nodes; `x` counts them.
#[inline]
fn along(row: &[Node; COSINES], x: f32) -> Node {
    let i = (x as usize).min(COSINES - 2);
    lerp(row[i], row[i + 1], x - i as f32)
}

/// `sqrt((n - 1) / (n + 1))`: nodes crowd where indices do.
fn place_of(index: f32) -> f32 {
    ((index - 1.0) / (index + 1.0)).sqrt()
}

/// Which side of the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Side {
    Outside,
    Inside,
}

impl Side {
    pub fn other(self) -> Self {
        match self {
            Self::Outside => Self::Inside,
            Self::Inside => Self::Outside,
        }
    }
}

/// One boundary: a place in the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Boundary {
    /// Lower of two neighbours, and how far to the upper.
    index: u8,
    roughness: u8,
    index_part: f32,
    roughness_part: f32,
    /// 1 - the strength of the reflection that is not total.
    weakened: f32,
}

impl Boundary {
    /// `index` at least 1, `roughness` and `strength` (of the reflection) in `[0, 1]`.
    pub fn new(index: f32, roughness: f32, strength: f32) -> Self {
        let cell = |x: f32, nodes: usize| {
            let x = x.clamp(0.0, 1.0) * (nodes - 1) as f32;
            let i = (x as usize).min(nodes - 2);
            (i as u8, x - i as f32)
        };
        let (index, index_part) = cell(place_of(index), INDICES);
        let (roughness, roughness_part) = cell(roughness, ROUGHNESSES);
        Self {
            index,
            roughness,
            index_part,
            roughness_part,
            weakened: 1.0 - strength,
        }
    }

    /// Bilinear, of what `node` finds in a row.
    #[inline]
    fn read(&self, side: Side, node: impl Fn(usize) -> Node) -> f32 {
        let first = if side == Side::Outside { 0 } else { INDICES };
        let row = (first + usize::from(self.index)) * ROUGHNESSES + usize::from(self.roughness);
        let pair = |row: usize| lerp(node(row), node(row + 1), self.roughness_part);
        let [lost, weakened] = lerp(pair(row), pair(row + ROUGHNESSES), self.index_part);
        (lost - self.weakened * weakened).clamp(0.0, 1.0)
    }

    /// Share of the light towards a cosine on one side that a single bounce does not explain.
    #[inline]
    pub fn lost(&self, side: Side, cos: f32) -> f32 {
        let table = &*TABLE;
        let x = cos.clamp(0.0, 1.0).sqrt() * (COSINES - 1) as f32;
        self.read(side, |row| along(&table.nodes[row], x))
    }

    /// Its cosine mean.
    pub fn mean_lost(&self, side: Side) -> f32 {
        let table = &*TABLE;
        self.read(side, |row| table.means[row])
    }
}

/// A rough boundary as one `wo` sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounced {
    boundary: Boundary,
    /// The side of `wo`.
    side: Side,
    /// Cosine lobe on the side of `wo`, all that depends on `wo` included; to be multiplied with the loss towards `wi`.
    pub reflected: Vec3,
    /// The same on the other side, the squeeze of refraction included.
    pub transmitted: Vec3,
    /// What the lobes bring towards `wo` in all, without that squeeze.
    pub reflected_albedo: Vec3,
    pub transmitted_albedo: Vec3,
}

impl Bounced {
    /// `reflection` is the colour of the reflection that is not total, `tint` that of transmission, `share` that of the boundary in the
    /// material, which both leave out. `None` if next to nothing is lost.
    pub fn new(
        boundary: Boundary,
        index: f32,
        side: Side,
        cos_o: f32,
        reflection: Vec3,
        tint: Vec3,
        share: f32,
    ) -> Option<Self> {
        let (own, other) = (boundary.mean_lost(side), boundary.mean_lost(side.other()));
        if own.min(other) < NEGLIGIBLE_LOSS {
            return None;
        }
        let index2 = index * index;
        let strength = 1.0 - boundary.weakened;
        let fresnel = mean_fresnel(index);
        // What a smooth boundary would reflect but for total reflection, and transmit, from this side.
        let (partial, through, squeeze) = match side {
            Side::Outside => (fresnel, 1.0 - strength * fresnel, index2),
            Side::Inside => (
                fresnel / index2,
                (1.0 - strength * fresnel) / index2,
                1.0 / index2,
            ),
        };
        let crossing = through * (other / own).min(1.0);
        let lost = boundary.lost(side, cos_o) * share;
        let rest = (1.0 - crossing - strength * partial).max(0.0);
        let reflected_albedo = (reflection * partial + Vec3::splat(rest)) * lost;
        let transmitted_albedo = tint * (crossing * lost);
        Some(Self {
            boundary,
            side,
            reflected: reflected_albedo / own,
            transmitted: transmitted_albedo / (other * squeeze),
            reflected_albedo,
            transmitted_albedo,
        })
    }

    /// Loss towards a direction on the side of `wo`.
    #[inline]
    pub fn lost_above(&self, cos: f32) -> f32 {
        self.boundary.lost(self.side, cos)
    }

    /// Loss towards a direction on the other side.
    #[inline]
    pub fn lost_below(&self, cos: f32) -> f32 {
        self.boundary.lost(self.side.other(), cos)
    }
}

/// Mean Fresnel reflectance from outside, cosine-weighted, of a smooth boundary (d'Eon & Irving 2011 give fits; this integrates).
pub(super) fn mean_fresnel(index: f32) -> f32 {
    /// Gauss' rule of 6 points on `[0, 1]`.
    const NODES: [(f32, f32); 6] = [
        (0.033_765_24, 0.085_662_25),
        (0.169_395_3, 0.180_380_79),
        (0.380_690_4, 0.233_956_97),
        (0.619_309_6, 0.233_956_97),
        (0.830_604_7, 0.180_380_79),
        (0.966_234_76, 0.085_662_25),
    ];
    NODES
        .iter()
        .map(|&(mu, weight)| 2.0 * mu * weight * fresnel_dielectric(mu, index).0)
        .sum::<f32>()
        .min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::microfacet::{
        g1_over_2cos, g2_over_4cos_o, reflect, refract, sample_visible_normal, smith_root,
    };
    use glam::Vec2;

    /// The last node stands for an infinite index.
    const LARGEST_INDEX: f32 = 1e4;

    /// The loss towards a cosine by a midpoint rule of `points²` visible normals, and what reflection's weakening changes: the reference
    /// that the table is made from. `eta` is the index of the far side over that of the near side.
    fn integrate(alpha: f32, mu: f32, eta: f32, points: u32) -> Node {
        let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
        let root_o = smith_root(alpha, mu);
        let (mut kept, mut weakened) = (0.0_f64, 0.0_f64);
        for i in 0..points {
            for j in 0..points {
                let u = Vec2::new(i as f32 + 0.5, j as f32 + 0.5) / points as f32;
                let h = sample_visible_normal(alpha, wo, u);
                let cos = wo.dot(h);
                let (f, cos_t) = fresnel_dielectric(cos, eta);
                let partial = if cos_t > 0.0 { f } else { 0.0 };
                let wi = reflect(wo, h);
                if wi.z > 0.0 {
                    let root_i = smith_root(alpha, wi.z);
                    let weight =
                        2.0 * g2_over_4cos_o(mu, root_o, wi.z, root_i) / g1_over_2cos(mu, root_o);
                    kept += f64::from(f * weight);
                    weakened -= f64::from(partial * weight);
                }
                if cos_t > 0.0 {
                    let wi = refract(wo, h, cos, cos_t, eta).normalize_or_zero();
                    if wi.z < 0.0 {
                        let weight = 2.0 * -wi.z * g1_over_2cos(-wi.z, smith_root(alpha, wi.z));
                        kept += f64::from((1.0 - f) * weight);
                        weakened += f64::from(f * weight);
                    }
                }
            }
        }
        let n = f64::from(points * points);
        [(1.0 - kept / n) as f32, (weakened / n) as f32]
    }

    fn eta(side: Side, index: f32) -> f32 {
        match side {
            Side::Outside => index,
            Side::Inside => 1.0 / index,
        }
    }

    #[test]
    #[ignore = "writes into the source tree; run it when the model or the grid changes"]
    fn make_table() {
        let mut bytes = Vec::new();
        for side in [Side::Outside, Side::Inside] {
            for n in 0..INDICES {
                let place = (n as f32 / (INDICES - 1) as f32).powi(2);
                let index = ((1.0 + place) / (1.0 - place)).min(LARGEST_INDEX);
                for r in 0..ROUGHNESSES {
                    let roughness = r as f32 / (ROUGHNESSES - 1) as f32;
                    for m in 0..COSINES {
                        let root = (m as f32 / (COSINES - 1) as f32).max(1e-3);
                        let node = if r == 0 {
                            [0.0; 2]
                        } else {
                            integrate(roughness * roughness, root * root, eta(side, index), 64)
                        };
                        for x in [node[0], 0.5 * (node[1] + 1.0)] {
                            let number = (x.clamp(0.0, 1.0) * 65_535.0).round() as u16;
                            bytes.extend(number.to_le_bytes());
                        }
                    }
                }
            }
        }
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/bsdf/boundary.bin");
        std::fs::write(path, bytes).unwrap();
    }

    #[test]
    fn table_matches_quadrature() {
        assert_eq!(TABLE.nodes.len(), 2 * INDICES * ROUGHNESSES);
        let mut worst = (0.0_f32, String::new());
        for side in [Side::Outside, Side::Inside] {
            for index in [1.1, 1.33, 1.5, 1.9, 2.4, 4.0] {
                for roughness in [0.1, 0.23, 0.36, 0.5, 0.61, 0.83, 1.0] {
                    for strength in [1.0, 0.3] {
                        let boundary = Boundary::new(index, roughness, strength);
                        for mu in [0.02, 0.07, 0.18, 0.33, 0.56, 0.77, 0.99] {
                            let [lost, weakened] =
                                integrate(roughness * roughness, mu, eta(side, index), 128);
                            let exact = lost - (1.0 - strength) * weakened;
                            let error = (boundary.lost(side, mu) - exact).abs();
                            let what = format!(
                                "{side:?} index {index} roughness {roughness} strength {strength} cosine {mu}: {} for {exact}",
                                boundary.lost(side, mu)
                            );
                            // Smooth and seen along the surface the loss bends faster than the nodes lie.
                            let bound = if mu < 0.05 { 0.02 } else { 0.01 };
                            assert!(error < bound, "{what}");
                            if error > worst.0 {
                                worst = (error, what);
                            }
                        }
                    }
                }
            }
        }
        println!("worst: {worst:?}");
    }

    #[test]
    fn mean_fresnel_obeys_the_law_of_both_sides() {
        // Both sides' means by a fine midpoint rule: 1 - F1 = n² (1 - F2).
        for index in [1.1_f32, 1.5, 2.4] {
            let mean = |eta: f32| {
                (0..100_000)
                    .map(|i| (f64::from(i) + 0.5) / 1e5)
                    .map(|mu| 2e-5 * mu * f64::from(fresnel_dielectric(mu as f32, eta).0))
                    .sum::<f64>()
            };
            let (outside, inside) = (mean(index), mean(1.0 / index));
            let n2 = f64::from(index * index);
            assert!(((1.0 - outside) - n2 * (1.0 - inside)).abs() < 1e-3);
            assert!((f64::from(mean_fresnel(index)) - outside).abs() < 2e-3);
        }
    }
}
