//! How surfaces scatter light: glTF 2.0 metallic-roughness with ior, specular, transmission, volume (its boundary), clearcoat and sheen.
//!
//! Directions are unit vectors in the local frame of the surface: z is the shading normal on the side of `wo`, so `wo.z > 0`.
//! `wo` points to where light goes (the eye), `wi` to where it comes from. Values are radiance per irradiance, already times `|cos wi|`.
//!
//! A material is the sum of these lobes, each with its share (`m` metallic, `t` transmission):
//!
//! * diffuse `(1-m)(1-t)`: base colour / π below the specular layer, `(1-E(wo)) (1-E(wi)) / (1-mean E)` of it (Kulla & Conty 2017);
//!   with `specular` 0 exactly base colour / π;
//! * GGX reflection with Smith's height-correlated shadowing and Schlick's Fresnel term (glTF 2.0, appendix B); several bounces on the
//!   microsurface are added as a cosine lobe (Kulla & Conty), so a white metal reflects all light at every roughness;
//! * thin wall `(1-m) t`: reflects as a sheet, `2R/(1+R)`; the rest passes straight on when smooth, blurred by a mirrored GGX lobe
//!   when rough, multiplied by the base colour once;
//! * boundary of a body `(1-m) t`: Walter et al. 2007 with the exact Fresnel equations; radiance is squeezed by `1/eta²`
//!   ([`BsdfSample::eta2`]); the base colour tints each crossing; several bounces are added as cosine lobes on both sides, see `boundary`;
//! * clear coat and sheen on top, see `layers`.
//!
//! Everything is reciprocal (`f(wo,wi) = f(wi,wo)`, across a boundary over the squared index) and gains no light; perceptual
//! roughness below 0.0316 is an exact mirror. Not modelled: anisotropy, iridescence, dispersion.

mod albedo;
mod boundary;
mod layers;
mod microfacet;
mod reflection;
mod scatter;
mod setup;
mod split;

pub(crate) use albedo::COEFFICIENTS;
use albedo::Row;
use boundary::Bounced;
use glam::{Vec2, Vec3};
use layers::Layers;
use microfacet::GRAZING;
pub(crate) use reflection::Gloss;
pub use split::BROAD_ROUGHNESS;
pub(crate) use split::Broad;
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
    /// Unit normal of the clear coat in the local frame, above which `wo` is; z if it is that of the base.
    pub coat_normal: Vec3,
    /// Sheen colour.
    pub sheen_color: Vec3,
    /// Perceptual roughness of the sheen.
    pub sheen_roughness: f32,
}

impl BsdfParameters {
    /// Whether light from below the horizon of the shading normal counts: what is transmitted, and what a coat with a normal of its own reflects.
    pub fn reaches_below(&self) -> bool {
        self.transmission > 0.0 || (self.clearcoat > 0.0 && self.coat_normal != Vec3::Z)
    }
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
            coat_normal: Vec3::Z,
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
    /// Cosine lobe on the far side of a thin wall: the same for transmitted light.
    below: Vec3,
    /// `1 - E(wi)` of the dielectric layer is `through[0] + through[1] A + through[2] B`.
    through: [f32; 3],
    row: Row,
    alpha: f32,
    /// Cosine of `wo`.
    cos_o: f32,
    /// `smith_root` of `wo`.
    root_o: f32,
    /// `G1(wo) / (4 wo.z)`: density of a reflected visible normal over `D`.
    half_visible: f32,
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
    /// Rough thick wall: light that bounced several times.
    bounced: Option<Bounced>,
    /// Light that passes straight through an index-matched boundary.
    pass: Vec3,
    layers: Option<Layers>,
    /// How layers stand to the base: see [`Cover`].
    cover: Cover,
    pick: Pick,
    albedo: Vec3,
}

/// Whether a surface of this perceptual roughness is treated as perfectly smooth: it mirrors exactly.
pub fn is_smooth(roughness: f32) -> bool {
    roughness * roughness < microfacet::ALPHA_DELTA
}

/// On which side of a boundary the layers are.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cover {
    /// On the side of `wo`: light that is reflected or transmitted goes through them.
    Near,
    /// On the far side, `wo` being inside of a body: only transmitted light goes through them.
    Far,
}

/// Probabilities of the lobes; they sum to 1, or are all 0 where nothing is scattered.
#[derive(Clone, Copy, Debug, Default)]
struct Pick {
    cosine: f32,
    specular: f32,
    below: f32,
    pass: f32,
    coat: f32,
    sheen: f32,
}

impl Bsdf {
    /// `(f * |cos|, pdf)` of all lobes that are not delta.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if self.lambert {
            let cos = wi.z.max(0.0) * FRAC_1_PI;
            return (self.diffuse * cos, cos);
        }
        if wi.z >= GRAZING {
            self.eval_above(wo, wi)
        } else if wi.z <= -GRAZING {
            self.eval_below(wo, wi)
        } else {
            (Vec3::ZERO, 0.0)
        }
    }

    /// Samples a direction. `None`: the path ends.
    ///
    /// `lobe` and `u` are independent numbers in `[0, 1)`; `u` deserves the better stratified pair.
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

    /// Whether the surface may scatter light between `wo` and `wi` (local), `wi` lying `above` the geometric surface as `wo` does, or not: both
    /// normals must agree on the side, or light would leak through the surface. Only a coat with a normal of its own reflects
    /// to directions below the base's.
    #[inline]
    pub fn connects(&self, wi: Vec3, above: bool) -> bool {
        if above {
            wi.z > 0.0 || self.coat_below().is_some_and(|l| l.above_coat(wi))
        } else {
            wi.z < 0.0 && self.coat_below().is_none()
        }
    }

    /// Light that goes straight through towards `wo` without a change of direction, by colour: the mean of `weight` over the samples
    /// that [passed](BsdfSample::passed), all others counted as black.
    pub fn straight_transmittance(&self, wo: Vec3) -> Vec3 {
        let window = self.wall == Wall::Thin && self.delta && self.pick.specular > 0.0;
        let facet = if window {
            self.facet(wo.z).transmit
        } else {
            Vec3::ZERO
        };
        (self.pass + facet) * self.dim_transmission(wo, -wo)
    }

    /// Whether every lobe is delta (then light sampling is pointless).
    #[inline]
    pub fn is_delta(&self) -> bool {
        let smooth_base = self.delta || self.pick.specular <= 0.0;
        let smooth_coat = self.pick.coat <= 0.0 || self.layers.is_none_or(|l| l.coat_delta);
        !self.lambert
            && self.pick.cosine + self.pick.below + self.pick.sheen <= 0.0
            && smooth_base
            && smooth_coat
    }

    /// Estimate of the share of light that leaves again towards `wo`, all lobes: for roulette, denoising guides and VPLs.
    #[inline]
    pub fn albedo(&self) -> Vec3 {
        self.albedo
    }
}

/// Into `[0, 1]`; NaN becomes 0.
fn unit(x: f32) -> f32 {
    if x > 0.0 { x.min(1.0) } else { 0.0 }
}

fn unit_color(c: Vec3) -> Vec3 {
    Vec3::new(unit(c.x), unit(c.y), unit(c.z))
}
