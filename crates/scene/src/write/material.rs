//! Materials with their extensions, textures, samplers and pictures.

use super::buffer::{Buffers, Use};
use super::{Extensions, WriteError, number, vector};
use crate::{
    AlphaMode, Filter, Image, Material, NormalMap, Sampler, Scene, Texels, TextureRef, Wrap,
};
use glam::{Affine2, Vec3};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Map, Value, json};

/// Collects the parts of a glTF object that differ from their defaults.
struct Object<'a> {
    json: Map<String, Value>,
    extensions: &'a mut Extensions,
}

impl<'a> Object<'a> {
    fn new(extensions: &'a mut Extensions) -> Self {
        Self {
            json: Map::new(),
            extensions,
        }
    }

    fn factor(&mut self, key: &str, value: f32, default: f32) {
        if value != default {
            self.json.insert(key.into(), number(value));
        }
    }

    fn color(&mut self, key: &str, value: Vec3, default: Vec3) {
        if value != default {
            self.json.insert(key.into(), vector(&value.to_array()));
        }
    }

    fn texture(&mut self, key: &str, texture: Option<TextureRef>) {
        if let Some(texture) = texture {
            self.json
                .insert(key.into(), texture_info(&texture, self.extensions));
        }
    }

    fn normal(&mut self, key: &str, normal: Option<NormalMap>) {
        if let Some(normal) = normal {
            let mut info = texture_info(&normal.texture, self.extensions);
            if normal.scale != 1.0 {
                info["scale"] = number(normal.scale);
            }
            self.json.insert(key.into(), info);
        }
    }
}

/// One glTF material.
pub(super) fn write(material: &Material, extensions: &mut Extensions) -> Value {
    let m = material;
    let mut pbr = Object::new(extensions);
    if m.base_color != glam::Vec4::ONE {
        pbr.json
            .insert("baseColorFactor".into(), vector(&m.base_color.to_array()));
    }
    pbr.texture("baseColorTexture", m.base_color_texture);
    pbr.factor("metallicFactor", m.metallic, 1.0);
    pbr.factor("roughnessFactor", m.roughness, 1.0);
    pbr.texture("metallicRoughnessTexture", m.metallic_roughness_texture);
    let pbr = pbr.json;

    let attached = attached(m, extensions);
    let mut top = Object::new(extensions);
    if !m.name.is_empty() {
        top.json.insert("name".into(), m.name.as_str().into());
    }
    if !pbr.is_empty() {
        top.json.insert("pbrMetallicRoughness".into(), pbr.into());
    }
    top.normal("normalTexture", m.normal);
    // The factor must stay within 1; KHR_materials_emissive_strength carries the rest.
    let strength = m.emission.max_element().max(1.0);
    top.color("emissiveFactor", m.emission / strength, Vec3::ZERO);
    top.texture("emissiveTexture", m.emission_texture);
    match m.alpha_mode {
        AlphaMode::Opaque => {}
        AlphaMode::Mask { cutoff } => {
            top.json.insert("alphaMode".into(), "MASK".into());
            top.factor("alphaCutoff", cutoff, 0.5);
        }
        AlphaMode::Blend => {
            top.json.insert("alphaMode".into(), "BLEND".into());
        }
    }
    if m.double_sided {
        top.json.insert("doubleSided".into(), true.into());
    }
    if !attached.is_empty() {
        top.json.insert("extensions".into(), attached.into());
    }
    Value::Object(top.json)
}

/// The material's extensions: those whose values are not the defaults.
fn attached(m: &Material, extensions: &mut Extensions) -> Map<String, Value> {
    let mut all = Map::new();
    let mut keep = |name: &'static str, object: Object<'_>, always: bool| {
        let Object { json, extensions } = object;
        if always || !json.is_empty() {
            extensions.used.insert(name);
            all.insert(name.into(), json.into());
        }
    };
    let mut o = Object::new(extensions);
    o.factor("emissiveStrength", m.emission.max_element().max(1.0), 1.0);
    keep("KHR_materials_emissive_strength", o, false);
    keep("KHR_materials_unlit", Object::new(extensions), m.unlit);

    let mut o = Object::new(extensions);
    o.factor("ior", m.ior, 1.5);
    keep("KHR_materials_ior", o, false);

    let mut o = Object::new(extensions);
    o.factor("transmissionFactor", m.transmission, 0.0);
    o.texture("transmissionTexture", m.transmission_texture);
    keep("KHR_materials_transmission", o, false);

    if let Some(volume) = m.volume {
        let mut o = Object::new(extensions);
        o.factor("thicknessFactor", volume.thickness, 0.0);
        // JSON has no infinity: without the key, nothing is absorbed.
        if volume.attenuation_distance.is_finite() {
            o.factor(
                "attenuationDistance",
                volume.attenuation_distance,
                f32::INFINITY,
            );
        }
        o.color("attenuationColor", volume.attenuation_color, Vec3::ONE);
        keep("KHR_materials_volume", o, true);
    }
    let mut o = Object::new(extensions);
    o.factor("specularFactor", m.specular, 1.0);
    o.texture("specularTexture", m.specular_texture);
    o.color("specularColorFactor", m.specular_color, Vec3::ONE);
    o.texture("specularColorTexture", m.specular_color_texture);
    keep("KHR_materials_specular", o, false);

    let mut o = Object::new(extensions);
    o.factor("clearcoatFactor", m.clearcoat, 0.0);
    o.texture("clearcoatTexture", m.clearcoat_texture);
    o.factor("clearcoatRoughnessFactor", m.clearcoat_roughness, 0.0);
    o.texture("clearcoatRoughnessTexture", m.clearcoat_roughness_texture);
    o.normal("clearcoatNormalTexture", m.clearcoat_normal);
    keep("KHR_materials_clearcoat", o, false);

    let mut o = Object::new(extensions);
    o.color("sheenColorFactor", m.sheen_color, Vec3::ZERO);
    o.texture("sheenColorTexture", m.sheen_color_texture);
    o.factor("sheenRoughnessFactor", m.sheen_roughness, 0.0);
    o.texture("sheenRoughnessTexture", m.sheen_roughness_texture);
    keep("KHR_materials_sheen", o, false);
    all
}

fn texture_info(texture: &TextureRef, extensions: &mut Extensions) -> Value {
    let mut info = json!({"index": texture.texture});
    if texture.uv_set != 0 {
        info["texCoord"] = texture.uv_set.into();
    }
    if texture.transform != Affine2::IDENTITY {
        extensions.used.insert("KHR_texture_transform");
        info["extensions"] = json!({"KHR_texture_transform": texture_transform(texture.transform)});
    }
    info
}

/// `KHR_texture_transform` is translation * rotation * scale, the rotation counterclockwise in a space whose v points
/// down: `u' = u cos + v sin`, `v' = v cos - u sin`.
fn texture_transform(transform: Affine2) -> Value {
    let (x, y) = (transform.matrix2.x_axis, transform.matrix2.y_axis);
    let mut json = json!({"offset": vector(&transform.translation.to_array())});
    let rotation = (-x.y).atan2(x.x);
    if rotation != 0.0 {
        json["rotation"] = number(rotation);
    }
    let sign = if x.perp_dot(y) < 0.0 { -1.0 } else { 1.0 };
    json["scale"] = vector(&[x.length(), sign * y.length()]);
    json
}

/// Textures and samplers; equal samplers are listed once.
pub(super) fn textures(scene: &Scene) -> (Vec<Value>, Vec<Value>) {
    let mut samplers: Vec<Sampler> = Vec::new();
    let textures = scene
        .textures
        .iter()
        .map(|texture| {
            let known = samplers.iter().position(|s| *s == texture.sampler);
            let sampler = known.unwrap_or_else(|| {
                samplers.push(texture.sampler);
                samplers.len() - 1
            });
            json!({"source": texture.image, "sampler": sampler})
        })
        .collect();
    (textures, samplers.iter().map(sampler).collect())
}

fn sampler(sampler: &Sampler) -> Value {
    let wrap = |wrap| match wrap {
        Wrap::Repeat => 10497,
        Wrap::Mirror => 33648,
        Wrap::Clamp => 33071,
    };
    let filter = match sampler.filter {
        Filter::Nearest => 9728,
        Filter::Linear => 9729,
    };
    json!({"wrapS": wrap(sampler.wrap_u), "wrapT": wrap(sampler.wrap_v), "magFilter": filter})
}

/// All pictures as PNG in buffer views.
pub(super) fn images(scene: &Scene, buffers: &mut Buffers<'_>) -> Result<Vec<Value>, WriteError> {
    scene
        .images
        .iter()
        .map(|image| {
            let bytes = png(image).map_err(|why| WriteError::Image {
                name: image.name.clone(),
                why: why.to_string(),
            })?;
            let view = buffers.view(bytes.into(), Use::Other);
            let mut json = json!({"bufferView": view, "mimeType": "image/png"});
            if !image.name.is_empty() {
                json["name"] = image.name.as_str().into();
            }
            Ok(json)
        })
        .collect()
}

/// PNG without an alpha channel where alpha is 1 everywhere.
fn png(image: &Image) -> Result<Vec<u8>, image::ImageError> {
    let mut out = Vec::new();
    let (bytes, color): (Vec<u8>, _) = match &image.texels {
        Texels::Rgba8(texels) if texels.iter().all(|t| t[3] == u8::MAX) => (
            texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect(),
            ExtendedColorType::Rgb8,
        ),
        Texels::Rgba8(texels) => (texels.as_flattened().to_vec(), ExtendedColorType::Rgba8),
        // The encoder takes 16-bit samples in the machine's byte order.
        Texels::Rgba16(texels) if texels.iter().all(|t| t[3] == u16::MAX) => (
            texels
                .iter()
                .flat_map(|t| [t[0], t[1], t[2]])
                .flat_map(u16::to_ne_bytes)
                .collect(),
            ExtendedColorType::Rgb16,
        ),
        Texels::Rgba16(texels) => (
            texels
                .as_flattened()
                .iter()
                .flat_map(|t| t.to_ne_bytes())
                .collect(),
            ExtendedColorType::Rgba16,
        ),
    };
    PngEncoder::new(&mut out).write_image(&bytes, image.width, image.height, color)?;
    Ok(out)
}
