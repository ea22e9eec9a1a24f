//! A [`Bsdf`] taken apart: lobes that are followed, and lobes that are connected.
//!
//! Renderers with many fixed lights (instant radiosity) connect surface points to all of them. That works where a lobe is
//! broad; a mirror would see none of the lights, a narrow lobe would show each of them as a spot. So the sum of lobes
//! is cut in two, either of which is a `Bsdf` of its own: values add up to those of the whole.
//!
//! The broad part has a closed form that suits vector units, [`Broad`]: the cosine lobe below the reflecting layer,
//! whose directional albedo is a polynomial here, and a rough GGX reflection.

use super::albedo::Polynomials;
use super::{Bsdf, Cover, Pick, Wall};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Lobes of at least this perceptual roughness count as broad: the peak of a rougher one is below 4 times the value of a white Lambert
/// surface, so that a light among hundreds stays invisible in it.
pub const BROAD_ROUGHNESS: f32 = 0.4;

/// The same as GGX alpha.
const BROAD_ALPHA: f32 = BROAD_ROUGHNESS * BROAD_ROUGHNESS;

/// The two parts of a [`Bsdf`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct SplitBsdf {
    /// Mirrors, narrow reflections, everything transmitted.
    pub(crate) sharp: Option<Bsdf>,
    /// The share of the sharp part in the estimated albedo.
    pub(crate) sharp_share: f32,
    /// Broad reflections.
    pub(crate) broad: Option<Bsdf>,
}

/// The broad part of an unlayered surface in closed form: with `c` the cosine of `wi`, `h` the half vector and `t = sqrt(c)`,
/// `f cos = (constant + by_a A(t) + by_b B(t)) c + (f0 (1 - w) + f90 w) D G2 / (4 cos wo)`, `w` Schlick's weight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Broad {
    /// The cosine lobe, 1/π included.
    pub(crate) constant: Vec3,
    pub(crate) by_a: Vec3,
    pub(crate) by_b: Vec3,
    pub(crate) albedo: Polynomials,
    /// The GGX lobe; black if there is none.
    pub(crate) f0: Vec3,
    pub(crate) f90: f32,
    pub(crate) alpha2: f32,
    /// `smith_root` of `wo`.
    pub(crate) root_o: f32,
}

impl Bsdf {
    /// Takes the sum of lobes apart. Either part is `None` if it scatters nothing.
    pub(crate) fn split(&self) -> SplitBsdf {
        if self.lambert {
            return SplitBsdf {
                sharp: None,
                sharp_share: 0.0,
                broad: Some(*self),
            };
        }
        let pick = &self.pick;
        let narrow = self.wall != Wall::Opaque || self.delta || self.alpha < BROAD_ALPHA;
        let narrow_coat = self
            .layers
            .is_some_and(|l| l.coat_delta || l.coat_alpha < BROAD_ALPHA);
        let keep = |here: bool, p: f32| if here { p } else { 0.0 };
        let sharp = Pick {
            cosine: 0.0,
            specular: keep(narrow, pick.specular),
            below: pick.below,
            pass: pick.pass,
            coat: keep(narrow_coat, pick.coat),
            sheen: 0.0,
        };
        let broad = Pick {
            cosine: pick.cosine,
            specular: keep(!narrow, pick.specular),
            below: 0.0,
            pass: 0.0,
            coat: keep(!narrow_coat, pick.coat),
            sheen: pick.sheen,
        };
        let sharp_share = sharp.sum();
        let sharp_albedo = self.sharp_albedo(&sharp);
        SplitBsdf {
            sharp: self.part(&sharp, sharp_albedo),
            sharp_share,
            broad: self.part(&broad, (self.albedo - sharp_albedo).max(Vec3::ZERO)),
        }
    }

    /// The lobes of `pick`, picked in the same proportions.
    fn part(&self, pick: &Pick, albedo: Vec3) -> Option<Self> {
        let sum = pick.sum();
        (sum > 0.0).then(|| Self {
            pick: Pick {
                cosine: pick.cosine / sum,
                specular: pick.specular / sum,
                below: pick.below / sum,
                pass: pick.pass / sum,
                coat: pick.coat / sum,
                sheen: pick.sheen / sum,
            },
            albedo,
            ..*self
        })
    }

    /// What the lobes of `sharp` reflect or transmit towards `wo`; of transmitting walls by the share of picks.
    fn sharp_albedo(&self, sharp: &Pick) -> Vec3 {
        if self.wall != Wall::Opaque || sharp.pass > 0.0 {
            return self.albedo * sharp.sum();
        }
        let mut albedo = Vec3::ZERO;
        if sharp.specular > 0.0 {
            let e = self.row.at(self.cos_o);
            let dim = match (&self.layers, self.cover) {
                (Some(layers), Cover::Near) => layers.through_o,
                _ => 1.0,
            };
            albedo += (self.f0 * e.a + Vec3::splat(self.f90) * e.b) * dim;
        }
        if sharp.coat > 0.0
            && let Some(layers) = &self.layers
        {
            albedo += Vec3::splat(layers.coat_albedo_o());
        }
        albedo.min(self.albedo)
    }

    /// Base colour, if there is nothing but Lambert's lobe.
    pub(crate) fn lambert(&self) -> Option<Vec3> {
        self.lambert.then_some(self.diffuse)
    }

    /// The closed form of a broad part; `None` if it has layers or a rough boundary, which have none.
    pub(crate) fn broad(&self) -> Option<Broad> {
        if self.layers.is_some()
            || self.bounced.is_some()
            || self.wall != Wall::Opaque && self.pick.specular > 0.0
        {
            return None;
        }
        let cosine = if self.pick.cosine > 0.0 {
            FRAC_1_PI
        } else {
            0.0
        };
        let (diffuse, multiple) = (self.diffuse * cosine, self.multiple * cosine);
        // Without the lobe any roughness will do that keeps the numbers finite.
        let (specular, alpha, root_o) = if self.pick.specular > 0.0 {
            (1.0, self.alpha, self.root_o)
        } else {
            (0.0, 1.0, 1.0)
        };
        let [t0, ta, tb] = if self.lambert {
            [1.0, 0.0, 0.0]
        } else {
            self.through
        };
        // The little that several bounces on a narrow lobe's microsurface add leaves along the surface: too sharp a peak for a
        // polynomial, so its mean stands for it.
        let (multiple, evenly) = if self.alpha >= BROAD_ALPHA || self.lambert {
            (multiple, Vec3::ZERO)
        } else {
            (Vec3::ZERO, multiple * self.row.mean().lost())
        };
        Some(Broad {
            constant: diffuse * t0 + multiple + evenly,
            by_a: diffuse * ta - multiple,
            by_b: diffuse * tb - multiple,
            albedo: self.row.polynomials(),
            f0: self.f0 * specular,
            f90: self.f90 * specular,
            alpha2: alpha * alpha,
            root_o,
        })
    }
}

impl Pick {
    fn sum(&self) -> f32 {
        self.cosine + self.specular + self.below + self.pass + self.coat + self.sheen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::BsdfParameters;
    use crate::bsdf::microfacet::{g2_over_4cos_o, half_vector, schlick_weight, smith_root};

    fn directions() -> impl Iterator<Item = (Vec3, Vec3)> {
        let on_sphere = |i: u32, k: f32| {
            let z = ((i as f32 + 0.5) * 0.618_034 * k).fract();
            let (sin, cos) = ((i as f32) * 2.399_963 * k).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * cos, r * sin, z)
        };
        (0..200).map(move |i| (on_sphere(i, 1.0), on_sphere(i, 1.7)))
    }

    fn materials() -> Vec<BsdfParameters> {
        let base = BsdfParameters {
            base_color: Vec3::new(0.8, 0.5, 0.2),
            ..BsdfParameters::default()
        };
        let mut all = vec![base];
        for roughness in [0.0, 0.2, 0.39, 0.41, 0.55, 0.8, 1.0] {
            for metallic in [0.0, 0.4, 1.0] {
                for (transmission, thin) in [(0.0, true), (0.5, true), (0.5, false)] {
                    for (clearcoat, clearcoat_roughness) in [(0.0, 0.0), (1.0, 0.0), (0.7, 0.6)] {
                        all.push(BsdfParameters {
                            roughness,
                            metallic,
                            transmission,
                            thin,
                            clearcoat,
                            clearcoat_roughness,
                            ..base
                        });
                    }
                }
            }
        }
        all
    }

    #[test]
    fn parts_add_up() {
        for parameters in materials() {
            for (wo, wi) in directions() {
                let whole = Bsdf::new(&parameters, wo);
                let split = whole.split();
                for wi in [wi, -wi] {
                    let value = |part: Option<Bsdf>| part.map_or(Vec3::ZERO, |p| p.eval(wo, wi).0);
                    let sum = value(split.sharp) + value(split.broad);
                    let expected = whole.eval(wo, wi).0;
                    assert!(
                        (sum - expected).abs().max_element()
                            <= 1e-5 * (1.0 + expected.max_element()),
                        "{parameters:?} {wo} {wi}: {sum}, not {expected}"
                    );
                }
                let albedo = |part: Option<Bsdf>| part.map_or(Vec3::ZERO, |p| p.albedo());
                let sum = albedo(split.sharp) + albedo(split.broad);
                assert!((sum - whole.albedo()).abs().max_element() < 1e-4);
            }
        }
    }

    /// The closed form against the lobes themselves: within 2 % of what a white surface would show, and 3 % of the value; beside
    /// narrow lobes, where the mean stands for a peak along the surface, within a tenth of a white surface that is lit from above.
    #[test]
    fn closed_form_is_close() {
        let mut worst = 0.0_f32;
        for parameters in materials() {
            for (wo, wi) in directions() {
                let Some(part) = Bsdf::new(&parameters, wo).split().broad else {
                    continue;
                };
                let Some(broad) = part.broad() else { continue };
                let expected = part.eval(wo, wi).0;
                let [a, b] = broad.albedo.at(wi.z.sqrt());
                let (cos_h, d) = half_vector(broad.alpha2.sqrt(), wo + wi);
                let root_i = smith_root(broad.alpha2.sqrt(), wi.z);
                let lobe = d * g2_over_4cos_o(wo.z, broad.root_o, wi.z, root_i);
                let w = schlick_weight(cos_h);
                let found = (broad.constant + broad.by_a * a + broad.by_b * b) * wi.z
                    + (broad.f0 * (1.0 - w) + Vec3::splat(broad.f90 * w)) * lobe;
                let error = (found - expected).abs().max_element();
                let bound = if parameters.roughness < 0.4 {
                    0.1 * FRAC_1_PI
                } else {
                    0.02 * wi.z * FRAC_1_PI + 0.03 * expected.max_element()
                };
                worst = worst.max(error / bound);
                assert!(
                    error <= bound,
                    "{parameters:?} {wo} {wi}: {found}, not {expected}"
                );
            }
        }
        println!("worst error over its bound: {worst}");
    }
}
