//! Cut-outs and coverage: which hits count.

use glam::{Vec2, Vec3, Vec4};
use occlude_scene::{AlphaMode, Material, Mesh, Pose, Scene, TextureRef};
use occlude_visibility::{Hit, Ray};

/// Whether hits of a mesh must be asked one by one: its alpha may let rays pass.
pub fn is_filtered(scene: &Scene, mesh: &Mesh) -> bool {
    let material = &scene.materials[mesh.material as usize];
    let varies = material.base_color_texture.is_some() || !mesh.colors.is_empty();
    match material.alpha_mode {
        AlphaMode::Opaque => false,
        AlphaMode::Mask { cutoff } => varies || material.base_color.w < cutoff,
        AlphaMode::Blend => varies || material.base_color.w < 1.0,
    }
}

/// Whether a hit on a filtered mesh stops the ray.
///
/// Blended surfaces stop it with probability alpha. The decision is a hash of the ray and the triangle, so that whoever
/// asks again about the same ray gets the same answer.
pub(super) fn accepts(scene: &Scene, mesh: &Mesh, ray: &Ray, hit: &Hit) -> bool {
    let material = &scene.materials[mesh.material as usize];
    let alpha = || base_color(scene, material, mesh, hit.primitive, hit.u, hit.v).w;
    match material.alpha_mode {
        AlphaMode::Opaque => true,
        AlphaMode::Mask { cutoff } => alpha() >= cutoff,
        AlphaMode::Blend => uniform_of(ray, hit) < alpha(),
    }
}

/// Whether a point of an instance's triangle is there for light that meets it: barycentric weights `u`, `v` of the second and third
/// vertex; `chance` in [0, 1) decides where the material is blended.
///
/// # Panics
/// If an index is out of range.
pub fn covers(
    scene: &Scene,
    pose: &Pose,
    instance: u32,
    primitive: u32,
    u: f32,
    v: f32,
    chance: f32,
) -> bool {
    let mesh = &scene.meshes[pose.instances[instance as usize].mesh as usize];
    let material = &scene.materials[mesh.material as usize];
    let alpha = || base_color(scene, material, mesh, primitive, u, v).w;
    match material.alpha_mode {
        AlphaMode::Opaque => true,
        AlphaMode::Mask { cutoff } => alpha() >= cutoff,
        AlphaMode::Blend => chance < alpha(),
    }
}

/// Interpolates a per-vertex array.
#[inline]
pub(super) fn interpolate<T>(values: &[T], triangle: [u32; 3], u: f32, v: f32) -> T
where
    T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
{
    let [a, b, c] = triangle;
    values[a as usize] * (1.0 - u - v) + values[b as usize] * u + values[c as usize] * v
}

/// The UV of a texture at a point of a triangle: (0, 0) if the mesh lacks the set.
pub(super) fn uv(mesh: &Mesh, texture: &TextureRef, primitive: u32, u: f32, v: f32) -> Vec2 {
    let set = if texture.uv_set == 0 {
        &mesh.uv0
    } else {
        &mesh.uv1
    };
    let plain = if set.is_empty() {
        Vec2::ZERO
    } else {
        interpolate(set, mesh.triangles[primitive as usize], u, v)
    };
    texture.transform.transform_point2(plain)
}

/// A texture's value at a point of a triangle.
pub(super) fn lookup(
    scene: &Scene,
    mesh: &Mesh,
    texture: &TextureRef,
    primitive: u32,
    u: f32,
    v: f32,
) -> Vec4 {
    let at = uv(mesh, texture, primitive, u, v);
    scene.textures[texture.texture as usize].sample(&scene.images, at.to_array())
}

/// Base colour and alpha: factor x texture x vertex colour.
pub(super) fn base_color(
    scene: &Scene,
    material: &Material,
    mesh: &Mesh,
    primitive: u32,
    u: f32,
    v: f32,
) -> Vec4 {
    let mut color = material.base_color;
    if let Some(texture) = &material.base_color_texture {
        color *= lookup(scene, mesh, texture, primitive, u, v);
    }
    if !mesh.colors.is_empty() {
        color *= interpolate(&mesh.colors, mesh.triangles[primitive as usize], u, v);
    }
    color
}

/// Lambert albedo of a surface of which everything that shines is left out ([`Material::diffuse_only`]): base colour, black if unlit.
pub fn diffuse_albedo(scene: &Scene, mesh: &Mesh, primitive: u32, u: f32, v: f32) -> Vec3 {
    let material = &scene.materials[mesh.material as usize];
    match material.unlit {
        true => Vec3::ZERO,
        false => base_color(scene, material, mesh, primitive, u, v).truncate(),
    }
}

/// Radiance that leaves the front side of a surface by itself.
pub fn front_emission(scene: &Scene, mesh: &Mesh, primitive: u32, u: f32, v: f32) -> Vec3 {
    let material = &scene.materials[mesh.material as usize];
    match &material.emission_texture {
        _ if material.unlit => base_color(scene, material, mesh, primitive, u, v).truncate(),
        Some(texture) if material.emission != Vec3::ZERO => {
            material.emission * lookup(scene, mesh, texture, primitive, u, v).truncate()
        }
        _ => material.emission,
    }
}

/// A number in [0, 1) that depends on the ray and the triangle alone.
fn uniform_of(ray: &Ray, hit: &Hit) -> f32 {
    let mut state = u64::from(hit.instance) << 32 | u64::from(hit.primitive);
    let words = [
        ray.origin.x,
        ray.origin.y,
        ray.origin.z,
        ray.direction.x,
        ray.direction.y,
        ray.direction.z,
    ];
    for pair in words.chunks_exact(2) {
        let word = u64::from(pair[0].to_bits()) << 32 | u64::from(pair[1].to_bits());
        // The finaliser of SplitMix64 (Steele et al. 2014) between words.
        state = (state ^ word).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state = (state ^ state >> 29).wrapping_mul(0x94d0_49bb_1331_11eb);
        state ^= state >> 32;
    }
    (state >> 40) as f32 / (1u64 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashed_numbers_are_uniform_over_rays_and_triangles() {
        let n = 40_000u32;
        let mut bins = [0u32; 16];
        for i in 0..n {
            let ray = Ray::new(
                Vec3::new(0.0, 1.0, 0.0),
                Vec3::new(i as f32 * 1e-5, -1.0, 0.3),
            );
            let hit = Hit {
                t: 1.0,
                u: 0.0,
                v: 0.0,
                instance: 1,
                primitive: i % 2,
            };
            bins[(uniform_of(&ray, &hit) * 16.0) as usize] += 1;
        }
        // Each bin holds 2500 +- 48; six sigma.
        assert!(
            bins.iter().all(|&b| (f64::from(b) - 2500.0).abs() < 290.0),
            "{bins:?}"
        );
    }
}
