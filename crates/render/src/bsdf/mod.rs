//! How surfaces scatter light.
//!
//! Directions are unit vectors in the local frame of the surface: z is the shading normal on the side of `wo`, so `wo.z > 0`.
//! `wo` points to where light goes (the eye), `wi` to where it comes from.

mod albedo;
mod microfacet;
mod setup;

use albedo::Row;
use glam::{Vec2, Vec3};
use microfacet::{
    fresnel_dielectric, g1_over_2cos, g2_over_4cos_cos, ggx_d, reflect, refract,
    sample_visible_normal, schlick_weight, smith_root,
};
use std::f32::consts::FRAC_1_PI;

use crate::sampling::warp;

/// Material parameters at one surface point, textures applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfParameters {
    /// Linear base colour.
    pub base_color: Vec3,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness; microfacet alpha is its square.
    pub roughness: f32,
    /// Index of refraction of the inside.
    pub ior: f32,
    /// Strength of the dielectric reflection (scales F0 and F90).
    pub specular: f32,
    /// Colour of the dielectric reflection at normal incidence.
    pub specular_color: Vec3,
    /// Share of transmission in place of diffuse reflection.
    pub transmission: f32,
    /// Thin-walled: light passes straight through, without refraction.
    pub thin: bool,
    /// `wo` is outside of the object (its front side).
    pub entering: bool,
    /// Strength of the clear coat.
    pub clearcoat: f32,
    /// Perceptual roughness of the clear coat.
    pub clearcoat_roughness: f32,
    /// Sheen colour.
    pub sheen_color: Vec3,
    /// Perceptual roughness of the sheen.
    pub sheen_roughness: f32,
}

impl Default for BsdfParameters {
    /// A white dielectric of roughness 1 and index 1.5 without any extension's lobe.
    fn default() -> Self {
        Self {
            base_color: Vec3::ONE,
            metallic: 0.0,
            roughness: 1.0,
            ior: 1.5,
            specular: 1.0,
            specular_color: Vec3::ONE,
            transmission: 0.0,
            thin: true,
            entering: true,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
            sheen_color: Vec3::ZERO,
            sheen_roughness: 0.0,
        }
    }
}

/// What sampling a direction gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Where light comes from.
    pub wi: Vec3,
    /// `f * |cos| / pdf`.
    pub weight: Vec3,
    /// Density per steradian of all lobes together; for a delta lobe the probability of having picked it.
    pub pdf: f32,
    /// The direction is exact (mirror, clear glass): `eval` is 0 there.
    pub delta: bool,
    /// The light passed straight through a thin wall (no change of direction, no scattering event).
    pub passed: bool,
    /// Square of the index on the side of `wi` over that on the side of `wo`; 1 unless the light was refracted. Radiance is squeezed
    /// by refraction, so `weight` holds a factor `1 / eta2`: roulette should look at the throughput times the product of these.
    pub eta2: f32,
}

/// What the transmitted light does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wall {
    /// Nothing passes.
    Opaque,
    /// The wall has no thickness: light leaves in the direction it came in, or blurred about it.
    Thin,
    /// The boundary of a body: light is refracted.
    Thick,
}

/// A closed set of lobes, set up for one surface point and one `wo`.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    /// Nothing but `diffuse` is there: the fast path.
    lambert: bool,
    /// The base's GGX lobe is exact.
    delta: bool,
    wall: Wall,
    /// Cosine lobe: Lambert's part, all that depends on `wo` included, without 1/π.
    diffuse: Vec3,
    /// Cosine lobe: light that bounced several times on the microsurface (Kulla & Conty), likewise.
    multiple: Vec3,
    /// `1 - E(wi)` of the dielectric layer is `through[0] + through[1] A + through[2] B`.
    through: [f32; 3],
    row: Row,
    alpha: f32,
    /// Schlick reflectance of the GGX lobe at normal and at grazing incidence.
    f0: Vec3,
    f90: f32,
    /// Colour of transmitted light, its share of the material included.
    tint: Vec3,
    /// Thin wall: largest component of the sheet's Schlick reflectance.
    sheet: [f32; 2],
    /// Thick wall: what the exact Fresnel reflectance is multiplied with, partial and total, the share of the material included.
    glass: [Vec3; 2],
    /// Thick wall: largest component of the colour of the partial reflection.
    glass_scale: f32,
    /// Thick wall: index of the far side over the near side.
    eta: f32,
    /// Light that passes straight through an index-matched boundary.
    pass: Vec3,
    /// Probabilities of the lobes.
    pick_cosine: f32,
    pick_specular: f32,
    pick_pass: f32,
    albedo: Vec3,
}

/// Whether a surface of this perceptual roughness is treated as perfectly smooth: it mirrors exactly.
pub fn is_smooth(roughness: f32) -> bool {
    roughness * roughness < microfacet::ALPHA_DELTA
}

/// Reflectance and transmittance of one microfacet.
struct Facet {
    reflect: Vec3,
    transmit: Vec3,
    /// Probability that the sampler reflects there.
    pick_reflect: f32,
    /// Cosine of the refracted direction.
    cos_t: f32,
}

impl Bsdf {
    /// `(f * |cos|, pdf)` of all lobes that are not delta.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if self.lambert {
            let cos = wi.z.max(0.0) * FRAC_1_PI;
            return (self.diffuse * cos, cos);
        }
        if wi.z > 0.0 {
            self.eval_reflection(wo, wi)
        } else {
            self.eval_transmission(wo, wi)
        }
    }

    fn eval_reflection(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let mut value = Vec3::ZERO;
        let mut pdf = 0.0;
        if self.pick_cosine > 0.0 {
            let cos = wi.z * FRAC_1_PI;
            let e = self.row.at(wi.z);
            let through = self.through[0] + self.through[1] * e.a + self.through[2] * e.b;
            value += (self.diffuse * through + self.multiple * e.lost()) * cos;
            pdf += self.pick_cosine * cos;
        }
        if self.pick_specular > 0.0 && !self.delta {
            let h = (wo + wi).normalize_or_zero();
            let cos_h = wo.dot(h);
            let facet = self.facet(cos_h);
            let d = ggx_d(self.alpha, h);
            let root_o = smith_root(self.alpha, wo.z);
            let root_i = smith_root(self.alpha, wi.z);
            value += facet.reflect * (d * g2_over_4cos_cos(wo.z, root_o, wi.z, root_i) * wi.z);
            pdf += self.pick_specular * facet.pick_reflect * d * 0.5 * g1_over_2cos(wo.z, root_o);
        }
        (value, pdf)
    }

    fn eval_transmission(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let none = (Vec3::ZERO, 0.0);
        if self.delta || self.pick_specular <= 0.0 {
            return none;
        }
        match self.wall {
            Wall::Opaque => none,
            Wall::Thin => {
                let mirrored = Vec3::new(wi.x, wi.y, -wi.z);
                if mirrored.z <= 0.0 {
                    return none;
                }
                let h = (wo + mirrored).normalize_or_zero();
                let facet = self.facet(wo.dot(h));
                let d = ggx_d(self.alpha, h);
                let root_o = smith_root(self.alpha, wo.z);
                let root_i = smith_root(self.alpha, mirrored.z);
                let value = d * g2_over_4cos_cos(wo.z, root_o, mirrored.z, root_i) * mirrored.z;
                let pdf = self.pick_specular
                    * (1.0 - facet.pick_reflect)
                    * d
                    * 0.5
                    * g1_over_2cos(wo.z, root_o);
                (facet.transmit * value, pdf)
            }
            Wall::Thick => {
                // Walter 2007, eq. 16 and 21 with `wo` on the near side.
                let h = (wo + self.eta * wi).normalize_or_zero();
                let h = if h.z < 0.0 { -h } else { h };
                let (cos_o, cos_i) = (wo.dot(h), wi.dot(h));
                if cos_o <= 0.0 || cos_i >= 0.0 {
                    return none;
                }
                let facet = self.facet(cos_o);
                let denominator = cos_o + self.eta * cos_i;
                let jacobian = -cos_i / (denominator * denominator);
                if !jacobian.is_finite() {
                    return none;
                }
                // Visible normals: G1(wo) D (wo·h) / wo.z.
                let visible = 2.0
                    * g1_over_2cos(wo.z, smith_root(self.alpha, wo.z))
                    * ggx_d(self.alpha, h)
                    * cos_o;
                let g1_i = 2.0 * -wi.z * g1_over_2cos(-wi.z, smith_root(self.alpha, wi.z));
                let pdf = self.pick_specular
                    * (1.0 - facet.pick_reflect)
                    * visible
                    * jacobian
                    * self.eta
                    * self.eta;
                (facet.transmit * (visible * jacobian * g1_i), pdf)
            }
        }
    }

    /// Fresnel's split at a microfacet that `wo` meets at cosine `cos`.
    #[inline]
    fn facet(&self, cos: f32) -> Facet {
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

    /// Samples a direction. `None`: the path ends.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        if self.lambert {
            let wi = warp::cosine_hemisphere(u);
            let pdf = wi.z * FRAC_1_PI;
            return (pdf > 0.0).then_some(BsdfSample {
                wi,
                weight: self.diffuse,
                pdf,
                delta: false,
                passed: false,
                eta2: 1.0,
            });
        }
        self.sample_lobes(wo, lobe, u)
    }

    fn sample_lobes(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let total = self.pick_cosine + self.pick_specular + self.pick_pass;
        if total <= 0.0 {
            return None;
        }
        let wi = if lobe < self.pick_cosine {
            warp::cosine_hemisphere(u)
        } else if self.pick_pass > 0.0 && lobe >= self.pick_cosine + self.pick_specular {
            let weight = self.pass / self.pick_pass;
            return Some(BsdfSample {
                wi: -wo,
                weight,
                pdf: self.pick_pass,
                delta: true,
                passed: true,
                eta2: 1.0,
            });
        } else if self.pick_specular <= 0.0 {
            return None;
        } else {
            let rest = ((lobe - self.pick_cosine) / self.pick_specular).clamp(0.0, 1.0);
            let h = if self.delta {
                Vec3::Z
            } else {
                sample_visible_normal(self.alpha, wo, u)
            };
            let cos = wo.dot(h);
            let facet = self.facet(cos);
            let reflected = rest < facet.pick_reflect;
            if self.delta {
                return self.delta_sample(wo, &facet, reflected);
            }
            if reflected {
                let wi = reflect(wo, h);
                if wi.z <= 0.0 {
                    return None;
                }
                wi
            } else {
                let wi = match self.wall {
                    Wall::Thick => refract(wo, h, cos, facet.cos_t, self.eta).normalize_or_zero(),
                    _ => {
                        let wi = reflect(wo, h);
                        Vec3::new(wi.x, wi.y, -wi.z)
                    }
                };
                if wi.z >= 0.0 {
                    return None;
                }
                wi
            }
        };
        let (value, pdf) = self.eval(wo, wi);
        let refracted = wi.z < 0.0 && self.wall == Wall::Thick;
        (pdf > 0.0 && pdf.is_finite()).then(|| BsdfSample {
            wi,
            weight: value / pdf,
            pdf,
            delta: false,
            passed: false,
            eta2: if refracted { self.eta * self.eta } else { 1.0 },
        })
    }

    fn delta_sample(&self, wo: Vec3, facet: &Facet, reflected: bool) -> Option<BsdfSample> {
        let base = BsdfSample {
            wi: wo,
            weight: Vec3::ZERO,
            pdf: 0.0,
            delta: true,
            passed: false,
            eta2: 1.0,
        };
        if reflected {
            let pdf = self.pick_specular * facet.pick_reflect;
            let wi = Vec3::new(-wo.x, -wo.y, wo.z);
            return (pdf > 0.0).then(|| BsdfSample {
                wi,
                weight: facet.reflect / pdf,
                pdf,
                ..base
            });
        }
        let pdf = self.pick_specular * (1.0 - facet.pick_reflect);
        if pdf <= 0.0 {
            return None;
        }
        let weight = facet.transmit / pdf;
        Some(match self.wall {
            Wall::Thick => {
                let eta2 = self.eta * self.eta;
                let wi = refract(wo, Vec3::Z, wo.z, facet.cos_t, self.eta);
                BsdfSample {
                    wi,
                    weight: weight / eta2,
                    pdf,
                    eta2,
                    ..base
                }
            }
            _ => BsdfSample {
                wi: -wo,
                weight,
                pdf,
                passed: true,
                ..base
            },
        })
    }

    /// Light that goes straight through towards `wo` without a change of direction, by colour: the mean of `weight` over the samples
    /// that [passed](BsdfSample::passed), all others counted as black.
    pub fn straight_transmittance(&self, wo: Vec3) -> Vec3 {
        let window = self.wall == Wall::Thin && self.delta && self.pick_specular > 0.0;
        self.pass
            + if window {
                self.facet(wo.z).transmit
            } else {
                Vec3::ZERO
            }
    }

    /// Whether every lobe is delta (then light sampling is pointless).
    #[inline]
    pub fn is_delta(&self) -> bool {
        !self.lambert && self.pick_cosine <= 0.0 && (self.delta || self.pick_specular <= 0.0)
    }

    /// Estimate of the share of light that leaves again towards `wo`, all lobes: for roulette, denoising guides and VPLs.
    #[inline]
    pub fn albedo(&self) -> Vec3 {
        self.albedo
    }
}
