//! Materials: glTF 2.0 metallic-roughness with the extensions that renderers use.

use glam::{Affine2, Vec3, Vec4};

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into [`Scene::textures`](crate::Scene::textures).
    pub texture: u32,
    /// Which UV set, 0 or 1 (`KHR_texture_transform` may override the plain one).
    pub uv_set: u32,
    /// `KHR_texture_transform`: maps mesh UV to texture UV.
    pub transform: Affine2,
}

/// A tangent-space normal map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalMap {
    /// The texture; RGB hold the normal as `2 c - 1`.
    pub texture: TextureRef,
    /// Scale of x and y.
    pub scale: f32,
}

/// How alpha is read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Ignored.
    #[default]
    Opaque,
    /// The surface is there where alpha is at least the cutoff.
    Mask {
        /// The cutoff.
        cutoff: f32,
    },
    /// Light passes with probability 1 - alpha; passing is no scattering event.
    Blend,
}

/// `KHR_materials_volume`: what is inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// Thickness; 0 means thin-walled.
    pub thickness: f32,
    /// Mean distance that light travels before absorption, metres; infinite: no absorption.
    pub attenuation_distance: f32,
    /// Colour that white light has after that distance.
    pub attenuation_color: Vec3,
}

/// A surface material. Every factor is multiplied with its texture where there is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name; may be empty.
    pub name: String,
    /// Base colour (linear) and alpha.
    pub base_color: Vec4,
    /// sRGB, RGBA.
    pub base_color_texture: Option<TextureRef>,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness; microfacet alpha is its square.
    pub roughness: f32,
    /// B is metallic, G is roughness.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Normal map.
    pub normal: Option<NormalMap>,
    /// Emitted radiance, `emissive_strength` included.
    pub emission: Vec3,
    /// sRGB.
    pub emission_texture: Option<TextureRef>,
    /// How alpha is read.
    pub alpha_mode: AlphaMode,
    /// Emission leaves both sides. (Every surface blocks and reflects on both sides.)
    pub double_sided: bool,
    /// `KHR_materials_unlit`: base colour is shown as radiance, nothing is reflected.
    pub unlit: bool,
    /// `KHR_materials_ior`: index of refraction, default 1.5.
    pub ior: f32,
    /// `KHR_materials_transmission`: share of light that passes instead of being diffusely reflected.
    pub transmission: f32,
    /// R.
    pub transmission_texture: Option<TextureRef>,
    /// `KHR_materials_volume`; `None` is thin-walled.
    pub volume: Option<Volume>,
    /// `KHR_materials_specular`: strength, default 1.
    pub specular: f32,
    /// A.
    pub specular_texture: Option<TextureRef>,
    /// `KHR_materials_specular`: colour of the dielectric reflection at normal incidence, default 1.
    pub specular_color: Vec3,
    /// sRGB.
    pub specular_color_texture: Option<TextureRef>,
    /// `KHR_materials_clearcoat`: strength, default 0.
    pub clearcoat: f32,
    /// R.
    pub clearcoat_texture: Option<TextureRef>,
    /// Perceptual roughness of the clear coat.
    pub clearcoat_roughness: f32,
    /// G.
    pub clearcoat_roughness_texture: Option<TextureRef>,
    /// Normal map of the clear coat; without it the coat follows the unperturbed normal.
    pub clearcoat_normal: Option<NormalMap>,
    /// `KHR_materials_sheen`: colour, default black.
    pub sheen_color: Vec3,
    /// sRGB.
    pub sheen_color_texture: Option<TextureRef>,
    /// Perceptual roughness of the sheen.
    pub sheen_roughness: f32,
    /// A.
    pub sheen_roughness_texture: Option<TextureRef>,
}

impl Default for Material {
    /// glTF's default material: white, metallic 1, roughness 1.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal: None,
            emission: Vec3::ZERO,
            emission_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
            ior: 1.5,
            transmission: 0.0,
            transmission_texture: None,
            volume: None,
            specular: 1.0,
            specular_texture: None,
            specular_color: Vec3::ONE,
            specular_color_texture: None,
            clearcoat: 0.0,
            clearcoat_texture: None,
            clearcoat_roughness: 0.0,
            clearcoat_roughness_texture: None,
            clearcoat_normal: None,
            sheen_color: Vec3::ZERO,
            sheen_color_texture: None,
            sheen_roughness: 0.0,
            sheen_roughness_texture: None,
        }
    }
}

impl Material {
    /// The same surface as a Lambert one: base colour, alpha and emission stay, everything that shines goes. For
    /// comparing renderers, which agree on what Lambert means.
    pub fn diffuse_only(&self) -> Self {
        Self {
            name: self.name.clone(),
            base_color: self.base_color,
            base_color_texture: self.base_color_texture,
            metallic: 0.0,
            specular: 0.0,
            emission: self.emission,
            emission_texture: self.emission_texture,
            alpha_mode: self.alpha_mode,
            double_sided: self.double_sided,
            unlit: self.unlit,
            ..Self::default()
        }
    }
}
