//! Materials, with the extensions that [`Material`] has room for.

use super::document as json;
use super::images::Textures;
use crate::{AlphaMode, Material, NormalMap, SceneError, Volume, Warning};
use glam::{Vec3, Vec4};

/// Translates one material.
pub(super) fn material(
    entry: &json::Material,
    index: usize,
    textures: &mut Textures,
) -> Result<Material, SceneError> {
    let place = match entry.name.as_str() {
        "" => format!("material {index}"),
        name => format!("material {index} ({name})"),
    };
    let pbr = &entry.pbr_metallic_roughness;
    let extensions = &entry.extensions;
    let mut texture = |info: &Option<json::TextureInfo>, srgb: bool| {
        textures.reference(info.as_ref(), srgb, &place)
    };
    let mut m = Material {
        name: entry.name.clone(),
        base_color: Vec4::from(pbr.base_color_factor),
        base_color_texture: texture(&pbr.base_color_texture, true)?,
        metallic: pbr.metallic_factor,
        roughness: pbr.roughness_factor,
        metallic_roughness_texture: texture(&pbr.metallic_roughness_texture, false)?,
        emission: Vec3::from(entry.emissive_factor),
        emission_texture: texture(&entry.emissive_texture, true)?,
        alpha_mode: match entry.alpha_mode.as_str() {
            "MASK" => AlphaMode::Mask {
                cutoff: entry.alpha_cutoff,
            },
            "BLEND" => AlphaMode::Blend,
            _ => AlphaMode::Opaque,
        },
        double_sided: entry.double_sided,
        unlit: extensions.unlit.is_some(),
        ..Material::default()
    };
    if let Some(info) = &entry.normal_texture {
        m.normal = textures
            .reference(Some(info), false, &place)?
            .map(|texture| NormalMap {
                texture,
                scale: info.scale,
            });
    }
    let mut texture = |info: &Option<json::TextureInfo>, srgb: bool| {
        textures.reference(info.as_ref(), srgb, &place)
    };
    if let Some(e) = &extensions.emissive_strength {
        m.emission *= e.emissive_strength;
    }
    if let Some(e) = &extensions.ior {
        m.ior = e.ior;
    }
    if let Some(e) = &extensions.transmission {
        m.transmission = e.transmission_factor;
        m.transmission_texture = texture(&e.transmission_texture, false)?;
    }
    if let Some(e) = &extensions.volume {
        m.volume = Some(Volume {
            thickness: e.thickness_factor,
            attenuation_distance: e.attenuation_distance.unwrap_or(f32::INFINITY),
            attenuation_color: Vec3::from(e.attenuation_color),
        });
    }
    if let Some(e) = &extensions.specular {
        m.specular = e.specular_factor;
        m.specular_texture = texture(&e.specular_texture, false)?;
        m.specular_color = Vec3::from(e.specular_color_factor);
        m.specular_color_texture = texture(&e.specular_color_texture, true)?;
    }
    if let Some(e) = &extensions.sheen {
        m.sheen_color = Vec3::from(e.sheen_color_factor);
        m.sheen_color_texture = texture(&e.sheen_color_texture, true)?;
        m.sheen_roughness = e.sheen_roughness_factor;
        m.sheen_roughness_texture = texture(&e.sheen_roughness_texture, false)?;
    }
    if let Some(e) = &extensions.clearcoat {
        m.clearcoat = e.clearcoat_factor;
        m.clearcoat_texture = texture(&e.clearcoat_texture, false)?;
        m.clearcoat_roughness = e.clearcoat_roughness_factor;
        m.clearcoat_roughness_texture = texture(&e.clearcoat_roughness_texture, false)?;
        if let Some(info) = &e.clearcoat_normal_texture {
            m.clearcoat_normal = textures
                .reference(Some(info), false, &place)?
                .map(|texture| NormalMap {
                    texture,
                    scale: info.scale,
                });
        }
    }
    if bring_into_range(&mut m) {
        textures
            .warnings
            .push(Warning::new(&place, "factors out of range were clamped"));
    }
    Ok(m)
}

/// Holds every factor to what it may be, so that shading never meets a negative or infinite one. True if one was not.
fn bring_into_range(m: &mut Material) -> bool {
    let mut changed = false;
    let mut hold = |v: &mut f32, low: f32, high: f32| {
        let held = if v.is_nan() { low } else { v.clamp(low, high) };
        changed |= held != *v;
        *v = held;
    };
    let unit = [
        &mut m.metallic,
        &mut m.roughness,
        &mut m.transmission,
        &mut m.specular,
        &mut m.clearcoat,
        &mut m.clearcoat_roughness,
        &mut m.sheen_roughness,
    ];
    let colors = m
        .base_color
        .as_mut()
        .iter_mut()
        .chain(m.sheen_color.as_mut());
    for v in colors.chain(unit) {
        hold(v, 0.0, 1.0);
    }
    for v in [&mut m.emission, &mut m.specular_color] {
        for v in v.as_mut() {
            hold(v, 0.0, f32::MAX);
        }
    }
    // The extension gives 0 a meaning of its own (full reflection); otherwise nothing is below vacuum.
    if m.ior != 0.0 {
        hold(&mut m.ior, 1.0, f32::MAX);
    }
    if let Some(volume) = &mut m.volume {
        hold(&mut volume.thickness, 0.0, f32::MAX);
        hold(
            &mut volume.attenuation_distance,
            f32::MIN_POSITIVE,
            f32::INFINITY,
        );
        for v in volume.attenuation_color.as_mut() {
            hold(v, 0.0, 1.0);
        }
    }
    for normal in [&mut m.normal, &mut m.clearcoat_normal]
        .into_iter()
        .flatten()
    {
        hold(&mut normal.scale, -f32::MAX, f32::MAX);
    }
    if let AlphaMode::Mask { cutoff } = &mut m.alpha_mode {
        // Above 1 is legal: nothing is left of the surface.
        hold(cutoff, 0.0, f32::MAX);
    }
    changed
}
