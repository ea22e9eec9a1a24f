//! What MTL means in glTF's material model.
//!
//! * `Kd` alone is exactly Lambert: no specular reflection at all.
//! * `Ks` becomes the reflectance at normal incidence of a dielectric coat over `Kd`; `Ns` its roughness by
//!   `alpha = sqrt(2 / (Ns + 2))` (Walter et al. 2007, the Phong exponent that resembles Beckmann).
//! * `illum` 3, 5 and 8 mirror perfectly; with an (almost) black `Kd` they are metals of colour `Ks`.
//! * `illum` 4, 6, 7 and 9 transmit: `Tf` in full, or `1 - d` where there is no `Tf`. A closed mesh refracts with `Ni` and
//!   filters half at each surface; anything else is a thin pane.
//! * `d` (or `1 - Tr`, where `d` is absent) and `map_d` are coverage: BLEND, or MASK if the map is all or nothing.

use super::maps::Maps;
use super::mtl::Entry;
use crate::{AlphaMode, Material, NormalMap, SceneError, Volume};
use glam::Vec3;

/// The material of an entry. `closed`: all its meshes enclose volumes.
pub(super) fn material(
    name: &str,
    entry: &Entry,
    closed: bool,
    maps: &mut Maps<'_>,
) -> Result<Material, SceneError> {
    let has_color = entry.map_diffuse.is_some();
    // With a texture and without Kd the texture stands alone; without both, the usual grey.
    let diffuse = entry
        .diffuse
        .unwrap_or(Vec3::splat(if has_color { 1.0 } else { 0.8 }));
    let diffuse = diffuse.clamp(Vec3::ZERO, Vec3::ONE);
    let opacity = entry
        .dissolve
        .or(entry.transparency.map(|t| 1.0 - t))
        .unwrap_or(1.0);
    let opacity = if opacity.is_finite() {
        opacity.clamp(0.0, 1.0)
    } else {
        1.0
    };
    let mut m = Material {
        name: name.to_owned(),
        base_color: diffuse.extend(1.0),
        metallic: 0.0,
        roughness: 1.0,
        specular: 0.0,
        ..Material::default()
    };
    let ior = entry.ior.filter(|n| (1.0..=4.0).contains(n));
    let transmits = transmission(entry, opacity);
    if let Some(filter) = transmits {
        m.transmission = filter.share;
        m.base_color = if closed {
            filter.color.map(f32::sqrt)
        } else {
            filter.color
        }
        .extend(1.0);
        m.specular = 1.0;
        m.roughness = 0.0;
        m.ior = ior.unwrap_or(1.5);
        if closed {
            m.volume = Some(Volume {
                thickness: 1.0,
                attenuation_distance: f32::INFINITY,
                attenuation_color: Vec3::ONE,
            });
        }
    } else {
        shine(entry, diffuse, ior, &mut m);
    }
    physical(entry, &mut m);

    // An emission map without Ke would be multiplied with black; exporters mean white.
    let emission = entry
        .emission
        .filter(|e| *e != Vec3::ZERO || entry.map_emission.is_none());
    let emission = emission.unwrap_or(if entry.map_emission.is_some() {
        Vec3::ONE
    } else {
        Vec3::ZERO
    });
    m.emission = emission.max(Vec3::ZERO);
    if let Some(map) = &entry.map_emission {
        m.emission_texture = Some(maps.plain(map, true)?);
    }
    if transmits.is_none() {
        m.base_color.w = opacity;
        if opacity < 1.0 {
            m.alpha_mode = AlphaMode::Blend;
        }
    }
    if let Some(alpha) = &entry.map_alpha {
        let (texture, binary) = maps.with_alpha(entry.map_diffuse.as_ref(), alpha)?;
        m.base_color_texture = Some(texture);
        m.alpha_mode = if binary && m.base_color.w == 1.0 {
            AlphaMode::Mask { cutoff: 0.5 }
        } else {
            AlphaMode::Blend
        };
    } else if let Some(map) = &entry.map_diffuse {
        m.base_color_texture = Some(maps.plain(map, true)?);
    }
    let bump = match (&entry.map_normal, &entry.map_bump) {
        (Some(normal), _) => Some(maps.plain(normal, false)?),
        (None, Some(heights)) => Some(maps.normals(heights)?),
        (None, None) => None,
    };
    m.normal = bump.map(|texture| NormalMap {
        texture,
        scale: 1.0,
    });
    Ok(m)
}

#[derive(Clone, Copy)]
struct Transmitted {
    share: f32,
    color: Vec3,
}

fn transmission(entry: &Entry, opacity: f32) -> Option<Transmitted> {
    if !matches!(entry.illum, Some(4 | 6 | 7 | 9)) {
        return None;
    }
    let (share, color) = match entry.filter {
        Some(filter) => (1.0, filter),
        None => (1.0 - opacity, entry.diffuse.unwrap_or(Vec3::ONE)),
    };
    let color = color.clamp(Vec3::ZERO, Vec3::ONE);
    (share > 0.0).then_some(Transmitted { share, color })
}

/// Specular reflection of opaque materials.
fn shine(entry: &Entry, diffuse: Vec3, ior: Option<f32>, m: &mut Material) {
    let specular = entry
        .specular
        .unwrap_or(Vec3::ZERO)
        .clamp(Vec3::ZERO, Vec3::ONE);
    // illum 0 and 1 have no highlights.
    if specular == Vec3::ZERO || matches!(entry.illum, Some(0 | 1)) {
        return;
    }
    let mirror = matches!(entry.illum, Some(3 | 5 | 8));
    let exponent = entry.exponent.unwrap_or(10.0).max(0.0);
    m.roughness = if mirror {
        0.0
    } else {
        (2.0 / (exponent + 2.0)).sqrt().sqrt()
    };
    if diffuse.max_element() < 0.1 * specular.max_element() {
        m.metallic = 1.0;
        m.base_color = specular.extend(1.0);
        return;
    }
    m.specular = 1.0;
    m.ior = ior.filter(|n| *n > 1.0).unwrap_or(1.5);
    let normal_incidence = ((m.ior - 1.0) / (m.ior + 1.0)).powi(2);
    m.specular_color = specular / normal_incidence;
}

/// The PBR statements, where there are any, override what was guessed.
fn physical(entry: &Entry, m: &mut Material) {
    if entry.roughness.is_none() && entry.metallic.is_none() {
        return;
    }
    m.roughness = entry.roughness.unwrap_or(0.5).clamp(0.0, 1.0);
    m.metallic = entry.metallic.unwrap_or(0.0).clamp(0.0, 1.0);
    m.specular = 1.0;
    m.specular_color = Vec3::ONE;
    m.clearcoat = entry.clearcoat.unwrap_or(0.0).clamp(0.0, 1.0);
    m.clearcoat_roughness = entry.clearcoat_roughness.unwrap_or(0.0).clamp(0.0, 1.0);
}
