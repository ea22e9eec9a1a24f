//! Evaluation and sampling of the lobes of a [`Bsdf`].
//!
//! One lobe is picked in proportion to its estimated albedo; the density of a direction is that of all lobes that could have made
//! it (one-sample balance heuristic), so that weights stay near the albedo. The GGX lobe draws a visible normal first and then
//! reflects or transmits there in proportion to what the facet does.

use super::albedo::Row;
use super::layers::Layers;
use super::microfacet::{
    GRAZING, fresnel_dielectric, g1_over_2cos, g2_over_4cos_o, ggx_d, half_vector, reflect,
    refract, sample_visible_normal, schlick_weight, smith_root,
};
use super::{Bsdf, BsdfSample, Cover, Wall};
use crate::sampling::warp::{self, UNIFORM_HEMISPHERE_PDF};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Reflectance and transmittance of one microfacet.
pub(super) struct Facet {
    pub reflect: Vec3,
    pub transmit: Vec3,
    /// Probability that the sampler reflects there.
    pub pick_reflect: f32,
    /// Cosine of the refracted direction.
    cos_t: f32,
}

impl Bsdf {
    /// Fresnel's split at a microfacet that `wo` meets at cosine `cos`.
    #[inline]
    pub(super) fn facet(&self, cos: f32) -> Facet {
        let weight = schlick_weight(cos);
        let schlick = self.f0 + (Vec3::splat(self.f90) - self.f0) * weight;
        let (reflect, share, cos_t) = match self.wall {
            Wall::Opaque => {
                return Facet {
                    reflect: schlick,
                    transmit: Vec3::ZERO,
                    pick_reflect: 1.0,
                    cos_t: 0.0,
                };
            }
            Wall::Thin => (
                schlick,
                1.0 - (self.sheet[0] + (self.sheet[1] - self.sheet[0]) * weight),
                0.0,
            ),
            Wall::Thick => match fresnel_dielectric(cos, self.eta) {
                // Total reflection is complete, whatever the reflection's colour.
                (_, 0.0) => (schlick + self.glass[1], 0.0, 0.0),
                (f, cos_t) => (
                    schlick + self.glass[0] * f,
                    1.0 - f * self.glass_scale,
                    cos_t,
                ),
            },
        };
        let transmit = self.tint * share.max(0.0);
        let (r, t) = (reflect.max_element(), transmit.max_element());
        Facet {
            reflect,
            transmit,
            pick_reflect: if t > 0.0 { r / (r + t) } else { 1.0 },
            cos_t,
        }
    }

    /// All lobes on the side of `wo`.
    pub(super) fn eval_above(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let mut value = Vec3::ZERO;
        let mut bounced = Vec3::ZERO;
        let mut pdf = 0.0;
        if self.pick.cosine > 0.0 {
            let cos = wi.z * FRAC_1_PI;
            let e = self.row.at(wi.z);
            let through = self.through[0] + self.through[1] * e.a + self.through[2] * e.b;
            value += (self.diffuse * through + self.multiple * e.lost()) * cos;
            pdf += self.pick.cosine * cos;
            if let Some(b) = &self.bounced {
                bounced = b.reflected * (b.lost_above(wi.z) * cos);
            }
        }
        if let Some(layers) = &self.layers
            && self.cover == Cover::Near
        {
            // The cosine lobe takes the normalised product (the rest of it is in `diffuse` and `multiple`), the others the minimum.
            value *= layers.through(wi);
            let (specular, p) = self.eval_specular(wo, wi);
            value += (specular + bounced) * layers.dim(wi);
            pdf += p;
            if self.pick.coat > 0.0 && !layers.coat_delta {
                let (coat, p) = layers.eval_coat(wo, wi);
                value += Vec3::splat(coat);
                pdf += self.pick.coat * p;
            }
            if self.pick.sheen > 0.0 {
                value += layers.eval_sheen(wo, wi);
                pdf += self.pick.sheen * UNIFORM_HEMISPHERE_PDF;
            }
            return (value, pdf);
        }
        let (specular, p) = self.eval_specular(wo, wi);
        (value + bounced + specular, pdf + p)
    }

    /// The reflecting GGX lobe of the base.
    #[inline]
    fn eval_specular(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if self.pick.specular <= 0.0 || self.delta {
            return (Vec3::ZERO, 0.0);
        }
        let (cos_h, d) = half_vector(self.alpha, wo + wi);
        let facet = self.facet(cos_h);
        let root_i = smith_root(self.alpha, wi.z);
        let value = facet.reflect * (d * g2_over_4cos_o(wo.z, self.root_o, wi.z, root_i));
        (
            value,
            self.pick.specular * facet.pick_reflect * d * self.half_visible,
        )
    }

    /// All lobes on the far side.
    pub(super) fn eval_below(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let none = (Vec3::ZERO, 0.0);
        if self.wall == Wall::Opaque {
            let Some(layers) = self.coat_below() else {
                return none;
            };
            if layers.coat_delta {
                return none;
            }
            let (coat, pdf) = layers.eval_coat(wo, wi);
            return (Vec3::splat(coat), self.pick.coat * pdf);
        }
        if self.delta || self.pick.specular <= 0.0 {
            return none;
        }
        let (value, pdf) = match self.wall {
            Wall::Opaque => none,
            Wall::Thin => {
                let mirrored = Vec3::new(wi.x, wi.y, -wi.z);
                let (cos_h, d) = half_vector(self.alpha, wo + mirrored);
                let facet = self.facet(cos_h);
                let root_i = smith_root(self.alpha, mirrored.z);
                let lobe = d * g2_over_4cos_o(wo.z, self.root_o, mirrored.z, root_i);
                let p = self.pick.specular * (1.0 - facet.pick_reflect) * d * self.half_visible;
                let cos = mirrored.z * FRAC_1_PI;
                let lost = self.row.at(mirrored.z).lost();
                (
                    facet.transmit * lobe + self.below * (lost * cos),
                    p + self.pick.below * cos,
                )
            }
            Wall::Thick => {
                let (value, pdf) = self.eval_refraction(wo, wi);
                match &self.bounced {
                    Some(b) => {
                        let cos = -wi.z * FRAC_1_PI;
                        (
                            value + b.transmitted * (b.lost_below(-wi.z) * cos),
                            pdf + self.pick.below * cos,
                        )
                    }
                    None => (value, pdf),
                }
            }
        };
        (value * self.dim_transmission(wo, wi), pdf)
    }

    /// Walter 2007, eq. 16 and 21 with `wo` on the near side.
    fn eval_refraction(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let h = (wo + self.eta * wi).normalize_or_zero();
        let h = if h.z < 0.0 { -h } else { h };
        let (cos_o, cos_i) = (wo.dot(h), wi.dot(h));
        if cos_o <= 0.0 || cos_i >= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let facet = self.facet(cos_o);
        let denominator = cos_o + self.eta * cos_i;
        let jacobian = -cos_i / (denominator * denominator);
        if !jacobian.is_finite() {
            return (Vec3::ZERO, 0.0);
        }
        // Visible normals: G1(wo) D (wo·h) / wo.z.
        let visible = 4.0 * self.half_visible * ggx_d(self.alpha, h) * cos_o;
        let g1_i = 2.0 * -wi.z * g1_over_2cos(-wi.z, smith_root(self.alpha, wi.z));
        let pdf = self.pick.specular
            * (1.0 - facet.pick_reflect)
            * visible
            * jacobian
            * self.eta
            * self.eta;
        (facet.transmit * (visible * jacobian * g1_i), pdf)
    }

    /// What the layers leave of light that crosses the wall from `wi` to `wo`.
    pub(super) fn dim_transmission(&self, wo: Vec3, wi: Vec3) -> f32 {
        match (&self.layers, self.wall, self.cover) {
            (None, ..) => 1.0,
            (Some(l), Wall::Thick, Cover::Near) => l.through(wo),
            (Some(l), Wall::Thick, Cover::Far) => l.through(-wi),
            (Some(l), ..) => l.dim(-wi),
        }
    }

    /// The layers, if their coat reflects to directions below the base's horizon too: a coat with a normal of its own, over an opaque base.
    pub(super) fn coat_below(&self) -> Option<&Layers> {
        let layers = self.layers.as_ref()?;
        (self.wall == Wall::Opaque && self.pick.coat > 0.0 && layers.tilted()).then_some(layers)
    }

    pub(super) fn sample_lobes(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let pick = &self.pick;
        let mut rest = lobe;
        let wi = if rest < pick.cosine {
            warp::cosine_hemisphere(u)
        } else {
            rest -= pick.cosine;
            if rest < pick.specular {
                if self.delta {
                    return self.sample_delta(wo, rest / pick.specular);
                }
                self.sample_specular(wo, rest / pick.specular, u)?
            } else {
                rest -= pick.specular;
                if rest < pick.below {
                    let wi = warp::cosine_hemisphere(u);
                    Vec3::new(wi.x, wi.y, -wi.z)
                } else if rest - pick.below < pick.pass {
                    let weight = self.pass * (self.dim_transmission(wo, -wo) / pick.pass);
                    return Some(BsdfSample {
                        wi: -wo,
                        weight,
                        pdf: pick.pass,
                        delta: true,
                        passed: true,
                        eta2: 1.0,
                    });
                } else {
                    return self.sample_layers(wo, rest - pick.below - pick.pass, u);
                }
            }
        };
        self.finish(wo, wi)
    }

    /// Value and density of a direction that one of the rough lobes has drawn.
    #[inline]
    fn finish(&self, wo: Vec3, wi: Vec3) -> Option<BsdfSample> {
        let (value, pdf) = self.eval(wo, wi);
        if !(pdf > 0.0 && pdf < f32::INFINITY) {
            return None;
        }
        let refracted = wi.z < 0.0 && self.wall == Wall::Thick;
        let eta2 = if refracted { self.eta * self.eta } else { 1.0 };
        Some(BsdfSample {
            wi,
            weight: value / pdf,
            pdf,
            delta: false,
            passed: false,
            eta2,
        })
    }

    /// A direction of the base's rough GGX lobe, reflected or transmitted.
    #[inline]
    fn sample_specular(&self, wo: Vec3, choice: f32, u: Vec2) -> Option<Vec3> {
        let h = sample_visible_normal(self.alpha, wo, u);
        if self.wall == Wall::Opaque {
            let wi = reflect(wo, h);
            return (wi.z > 0.0).then_some(wi);
        }
        let cos = wo.dot(h);
        let facet = self.facet(cos);
        if choice < facet.pick_reflect {
            let wi = reflect(wo, h);
            return (wi.z > 0.0).then_some(wi);
        }
        let wi = if self.wall == Wall::Thick {
            refract(wo, h, cos, facet.cos_t, self.eta).normalize_or_zero()
        } else {
            let wi = reflect(wo, h);
            Vec3::new(wi.x, wi.y, -wi.z)
        };
        (wi.z < 0.0).then_some(wi)
    }

    /// The smooth base: mirror or clear glass.
    fn sample_delta(&self, wo: Vec3, choice: f32) -> Option<BsdfSample> {
        let facet = self.facet(wo.z);
        let exact = |wi: Vec3, value: Vec3, pick: f32, passed: bool, eta2: f32| {
            let pdf = self.pick.specular * pick;
            (pdf > 0.0).then(|| BsdfSample {
                wi,
                weight: value / (pdf * eta2),
                pdf,
                delta: true,
                passed,
                eta2,
            })
        };
        if choice < facet.pick_reflect {
            let wi = Vec3::new(-wo.x, -wo.y, wo.z);
            let dim = match (&self.layers, self.cover) {
                (Some(layers), Cover::Near) => layers.dim(wi),
                _ => 1.0,
            };
            return exact(wi, facet.reflect * dim, facet.pick_reflect, false, 1.0);
        }
        let thick = self.wall == Wall::Thick;
        let (wi, eta2) = if thick {
            (
                refract(wo, Vec3::Z, wo.z, facet.cos_t, self.eta).normalize_or_zero(),
                self.eta * self.eta,
            )
        } else {
            (-wo, 1.0)
        };
        exact(
            wi,
            facet.transmit * self.dim_transmission(wo, wi),
            1.0 - facet.pick_reflect,
            !thick,
            eta2,
        )
    }

    fn sample_layers(&self, wo: Vec3, rest: f32, u: Vec2) -> Option<BsdfSample> {
        let layers = self.layers.as_ref()?;
        if rest < self.pick.coat {
            let wi = layers.sample_coat(wo, u)?;
            if wi.z < GRAZING && self.coat_below().is_none() {
                return None;
            }
            if layers.coat_delta {
                let weight = Vec3::splat(layers.coat_mirror() / self.pick.coat);
                return Some(BsdfSample {
                    wi,
                    weight,
                    pdf: self.pick.coat,
                    delta: true,
                    passed: false,
                    eta2: 1.0,
                });
            }
            return self.finish(wo, wi);
        }
        if self.pick.sheen > 0.0 {
            self.finish(wo, warp::uniform_hemisphere(u))
        } else {
            None
        }
    }

    /// Means over the hemisphere, cosine-weighted, of what the layers make of the two parts of the cosine lobe:
    /// `(mean of (1 - E) T / mean of (1 - E), mean of lost T / mean of lost)`, by Gauss' rule of 6 points.
    pub(super) fn mean_dimming(&self, row: Row, layers: &Layers) -> (f32, f32) {
        const NODES: [(f32, f32); 6] = [
            (0.033_765_24, 0.085_662_25),
            (0.169_395_3, 0.180_380_79),
            (0.380_690_4, 0.233_956_97),
            (0.619_309_6, 0.233_956_97),
            (0.830_604_7, 0.180_380_79),
            (0.966_234_76, 0.085_662_25),
        ];
        let mut sums = [0.0_f32; 4];
        for (mu, weight) in NODES {
            let w = weight * mu;
            let e = row.at(mu);
            let t = layers.mean_through(mu);
            let through = self.through[0] + self.through[1] * e.a + self.through[2] * e.b;
            for (sum, term) in sums
                .iter_mut()
                .zip([through * t, through, e.lost() * t, e.lost()])
            {
                *sum += w * term;
            }
        }
        let ratio = |a: f32, b: f32| if b > 0.0 { a / b } else { 1.0 };
        (ratio(sums[0], sums[1]), ratio(sums[2], sums[3]))
    }
}
