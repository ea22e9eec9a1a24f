//! How surfaces scatter light.
//!
//! Directions are unit vectors in the local frame of the surface: z is the shading normal on the side of `wo`, so `wo.z > 0`.
//! `wo` points to where light goes (the eye), `wi` to where it comes from.

use glam::{Vec2, Vec3};

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
}

/// A closed set of lobes, set up for one surface point and one `wo`.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    parameters: BsdfParameters,
}

impl Bsdf {
    /// Sets up the lobes.
    pub fn new(parameters: &BsdfParameters, wo: Vec3) -> Self {
        let _ = wo;
        Self {
            parameters: *parameters,
        }
    }

    /// `(f * |cos|, pdf)` of all lobes that are not delta.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let _ = (wo, wi, self.parameters);
        todo!()
    }

    /// Samples a direction. `None`: the path ends.
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let _ = (wo, lobe, u);
        todo!()
    }

    /// Whether every lobe is delta (then light sampling is pointless).
    pub fn is_delta(&self) -> bool {
        todo!()
    }

    /// Estimate of the share of light that leaves again towards `wo`, all lobes: for roulette, denoising guides and VPLs.
    pub fn albedo(&self) -> Vec3 {
        todo!()
    }
}
