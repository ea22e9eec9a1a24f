//! Emissive triangles: collected from a posed scene, sampled by area or by solid angle.

use super::facet::Facet;
use super::luminance;
use super::spherical::SphericalTriangle;
use crate::geometry::WorldTriangle;
use glam::{Vec2, Vec3};
use occlude_scene::{AlphaMode, Material, Mesh, Pose, Scene, TextureRef};
use rayon::prelude::*;

/// No light.
pub(super) const NONE: u32 = u32::MAX;

/// One emissive triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct EmissiveTriangle {
    pub(super) facet: Facet,
    /// Mean radiance over its area, what lets light pass deducted.
    pub(super) mean_radiance: Vec3,
    pub(super) mesh: u32,
    pub(super) primitive: u32,
    pub(super) double_sided: bool,
}

/// All emissive triangles, and which triangle of the scene is which of them.
#[derive(Debug, Default)]
pub(super) struct Emitters {
    pub(super) triangles: Vec<EmissiveTriangle>,
    /// By instance: where its triangles start in `light_of_triangle`, or [`NONE`].
    base_of_instance: Vec<u32>,
    /// Index into `triangles`, or [`NONE`].
    light_of_triangle: Vec<u32>,
}

/// A point on an emissive triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct EmitterSample {
    /// Unit vector towards it.
    pub(super) wi: Vec3,
    pub(super) barycentric: Vec2,
    /// Density per steradian.
    pub(super) pdf: f32,
    /// The same density per unit of area.
    pub(super) area_density: f32,
    /// Unit geometric normal on the side that the sample leaves.
    pub(super) normal: Vec3,
}

/// Radiance that a triangle of a mesh emits at a barycentric point on a side that emits.
///
/// What the material lets pass (its alpha) is not deducted.
fn emission(scene: &Scene, mesh: u32, primitive: u32, barycentric: Vec2) -> Vec3 {
    let mesh = &scene.meshes[mesh as usize];
    let material = &scene.materials[mesh.material as usize];
    material.emission
        * texel(
            scene,
            mesh,
            material.emission_texture.as_ref(),
            primitive,
            barycentric,
        )
        .truncate()
}

fn texel(
    scene: &Scene,
    mesh: &Mesh,
    texture: Option<&TextureRef>,
    primitive: u32,
    barycentric: Vec2,
) -> glam::Vec4 {
    let Some(reference) = texture else {
        return glam::Vec4::ONE;
    };
    let uvs = if reference.uv_set == 0 {
        &mesh.uv0
    } else {
        &mesh.uv1
    };
    let uv = if uvs.is_empty() {
        Vec2::ZERO
    } else {
        blend(uvs, mesh.triangles[primitive as usize], barycentric)
    };
    let uv = reference.transform.transform_point2(uv);
    scene.textures[reference.texture as usize].sample(&scene.images, uv.to_array())
}

fn blend<T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>>(
    values: &[T],
    corners: [u32; 3],
    barycentric: Vec2,
) -> T {
    let [a, b, c] = corners.map(|i| values[i as usize]);
    a * (1.0 - barycentric.x - barycentric.y) + b * barycentric.x + c * barycentric.y
}

/// The probability that a surface is there at all: 1 minus what its alpha lets pass.
fn coverage(
    scene: &Scene,
    mesh: &Mesh,
    material: &Material,
    primitive: u32,
    barycentric: Vec2,
) -> f32 {
    if material.alpha_mode == AlphaMode::Opaque {
        return 1.0;
    }
    let mut alpha = material.base_color.w
        * texel(
            scene,
            mesh,
            material.base_color_texture.as_ref(),
            primitive,
            barycentric,
        )
        .w;
    if !mesh.colors.is_empty() {
        alpha *= blend(
            &mesh.colors,
            mesh.triangles[primitive as usize],
            barycentric,
        )
        .w;
    }
    match material.alpha_mode {
        AlphaMode::Mask { cutoff } => f32::from(alpha >= cutoff),
        _ => alpha.clamp(0.0, 1.0),
    }
}

impl EmissiveTriangle {
    /// The unit normal on the side of `position`, or `None` if nothing is emitted there.
    fn side(&self, position: Vec3) -> Option<Vec3> {
        let height = self.facet.front.dot(position - self.facet.origin);
        if height > 0.0 {
            Some(self.facet.front)
        } else if height < 0.0 && self.double_sided {
            Some(-self.facet.front)
        } else {
            None
        }
    }

    /// Whether distances to all of the triangle are so alike that sampling by area is as good as by solid angle. The density
    /// of solid angle over area goes with the third power of the distance.
    fn is_far(&self, corner: Vec3) -> bool {
        const LONG: f32 = 0.1;
        let (e1, e2) = (self.facet.edge1, self.facet.edge2);
        let longest = e1
            .length_squared()
            .max(e2.length_squared())
            .max((e2 - e1).length_squared());
        longest < LONG * LONG * corner.length_squared()
    }

    /// Samples the triangle as seen from `position`; `normal` as in [`super::Lights::sample`].
    pub(super) fn sample(&self, position: Vec3, normal: Vec3, u: Vec2) -> Option<EmitterSample> {
        let side = self.side(position)?;
        let t = &self.facet;
        let corner = t.origin - position;
        if self.is_far(corner) {
            let barycentric = uniform_barycentric(u);
            let to = corner + (t.edge1 * barycentric.x + t.edge2 * barycentric.y);
            let distance = to.length();
            let wi = to / distance;
            let jacobian = -side.dot(wi) / (distance * distance);
            let area_density = 1.0 / t.area;
            let pdf = area_density / jacobian;
            return (jacobian > 0.0 && pdf.is_finite()).then_some(EmitterSample {
                wi,
                barycentric,
                pdf,
                area_density,
                normal: side,
            });
        }
        let seen = SphericalTriangle::new(corner, t.edge1, t.edge2)?;
        let warp = seen.cosine_warp(normal)?;
        let warped = warp.sample(u);
        let wi = seen.direction(warped);
        let pdf = warp.density(warped) / seen.solid_angle;
        let (barycentric, distance) = intersect_plane(corner, t.edge1, t.edge2, wi)?;
        let area_density = pdf * -side.dot(wi) / (distance * distance);
        (pdf > 0.0 && pdf.is_finite() && area_density > 0.0).then_some(EmitterSample {
            wi,
            barycentric,
            pdf,
            area_density,
            normal: side,
        })
    }

    /// Density per steradian with which [`EmissiveTriangle::sample`] finds the point `hit`.
    pub(super) fn pdf(&self, position: Vec3, normal: Vec3, hit: Vec3) -> f32 {
        let Some(side) = self.side(position) else {
            return 0.0;
        };
        let t = &self.facet;
        let corner = t.origin - position;
        let to = hit - position;
        let distance = to.length();
        let wi = to / distance;
        let pdf = if self.is_far(corner) {
            let cosine = -side.dot(wi);
            if cosine > 0.0 {
                distance * distance / (cosine * t.area)
            } else {
                0.0
            }
        } else {
            let Some(seen) = SphericalTriangle::new(corner, t.edge1, t.edge2) else {
                return 0.0;
            };
            let Some(warp) = seen.cosine_warp(normal) else {
                return 0.0;
            };
            warp.density(seen.invert(wi)) / seen.solid_angle
        };
        if pdf.is_finite() { pdf } else { 0.0 }
    }

    /// Radiance emitted at a sampled point, what lets light pass deducted.
    pub(super) fn radiance(&self, scene: &Scene, barycentric: Vec2) -> Vec3 {
        let mesh = &scene.meshes[self.mesh as usize];
        let material = &scene.materials[mesh.material as usize];
        if material.emission_texture.is_none() && material.alpha_mode == AlphaMode::Opaque {
            return material.emission;
        }
        emission(scene, self.mesh, self.primitive, barycentric)
            * coverage(scene, mesh, material, self.primitive, barycentric)
    }

    /// Emitted power, all colours together.
    pub(super) fn power(&self) -> f32 {
        let sides = if self.double_sided { 2.0 } else { 1.0 };
        luminance(self.mean_radiance) * self.facet.area * sides * std::f32::consts::PI
    }
}

impl Emitters {
    pub(super) fn new(scene: &Scene, pose: &Pose) -> Self {
        let mut emitters = Self::default();
        for (instance, posed) in pose.instances.iter().enumerate() {
            let mesh = &scene.meshes[posed.mesh as usize];
            let lit = scene
                .materials
                .get(mesh.material as usize)
                .is_some_and(emits);
            if !lit {
                emitters.base_of_instance.push(NONE);
                continue;
            }
            emitters
                .base_of_instance
                .push(emitters.light_of_triangle.len() as u32);
            let found: Vec<Option<EmissiveTriangle>> = (0..mesh.triangles.len())
                .into_par_iter()
                .with_min_len(256)
                .map(|primitive| emissive_triangle(scene, pose, instance, primitive))
                .collect();
            for triangle in found {
                emitters
                    .light_of_triangle
                    .push(triangle.map_or(NONE, |_| emitters.triangles.len() as u32));
                emitters.triangles.extend(triangle);
            }
        }
        emitters
    }

    /// The emissive triangle that a triangle of the scene is, if it is one.
    pub(super) fn find(&self, instance: u32, primitive: u32) -> Option<usize> {
        let base = *self.base_of_instance.get(instance as usize)?;
        if base == NONE {
            return None;
        }
        let light = *self
            .light_of_triangle
            .get(base as usize + primitive as usize)?;
        (light != NONE).then_some(light as usize)
    }
}

/// Unlit surfaces show their base colour and nothing else; they light nothing.
fn emits(material: &Material) -> bool {
    !material.unlit && material.emission.is_finite() && material.emission.max_element() > 0.0
}

fn emissive_triangle(
    scene: &Scene,
    pose: &Pose,
    instance: usize,
    primitive: usize,
) -> Option<EmissiveTriangle> {
    let facet = Facet::new(&WorldTriangle::new(
        scene,
        pose,
        instance as u32,
        primitive as u32,
    ))?;
    let mesh_index = pose.instances[instance].mesh;
    let material = &scene.materials[scene.meshes[mesh_index as usize].material as usize];
    let emissive = EmissiveTriangle {
        facet,
        mean_radiance: mean_radiance(scene, mesh_index, primitive as u32),
        mesh: mesh_index,
        primitive: primitive as u32,
        double_sided: material.double_sided,
    };
    let power = emissive.power();
    (power > 0.0 && power.is_finite()).then_some(emissive)
}

/// Mean over a triangle of what it emits, by a lattice of points about as dense as the texels. Where it falls between a few
/// lit texels and finds nothing, the triangle is no light: paths that hit it still see it.
fn mean_radiance(scene: &Scene, mesh_index: u32, primitive: u32) -> Vec3 {
    const MOST_POINTS: f32 = 1024.0;
    let mesh = &scene.meshes[mesh_index as usize];
    let material = &scene.materials[mesh.material as usize];
    let corners = mesh.triangles[primitive as usize];
    let base_color = material
        .base_color_texture
        .filter(|_| material.alpha_mode != AlphaMode::Opaque);
    let texels = material
        .emission_texture
        .iter()
        .chain(base_color.iter())
        .map(|reference| {
            let uvs = if reference.uv_set == 0 {
                &mesh.uv0
            } else {
                &mesh.uv1
            };
            if uvs.is_empty() {
                return 0.0;
            }
            let [a, b, c] = corners.map(|i| reference.transform.transform_point2(uvs[i as usize]));
            let image = &scene.images[scene.textures[reference.texture as usize].image as usize];
            // Of the rectangle around it: a triangle squeezed to a line in the texture has no area there.
            let size = a.max(b).max(c) - a.min(b).min(c);
            (1.0 + size.x * image.width as f32) * (1.0 + size.y * image.height as f32)
        })
        .fold(0.0, f32::max);
    let varies = material.emission_texture.is_some() || material.alpha_mode != AlphaMode::Opaque;
    let points = if varies {
        (2.0 * texels).clamp(8.0, MOST_POINTS) as u32
    } else {
        1
    };
    let mut sum = Vec3::ZERO;
    for i in 0..points {
        // The R2 sequence (Roberts 2018): evenly spread for any number of points.
        let u = Vec2::new(0.5 + 0.754_877_7 * i as f32, 0.5 + 0.569_840_3 * i as f32).fract_gl();
        let barycentric = uniform_barycentric(u);
        sum += emission(scene, mesh_index, primitive, barycentric)
            * coverage(scene, mesh, material, primitive, barycentric);
    }
    (sum / points as f32).max(Vec3::ZERO)
}

/// Uniform barycentric weights of the second and third vertex (Heitz 2019, "A low-distortion map between triangle and
/// square").
fn uniform_barycentric(u: Vec2) -> Vec2 {
    if u.y > u.x {
        let x = 0.5 * u.x;
        Vec2::new(x, u.y - x)
    } else {
        let y = 0.5 * u.y;
        Vec2::new(u.x - y, y)
    }
}

/// Where the ray from the origin along `direction` meets the plane of a triangle: barycentric weights, moved into the
/// triangle if rounding put them outside, and distance.
fn intersect_plane(corner: Vec3, edge1: Vec3, edge2: Vec3, direction: Vec3) -> Option<(Vec2, f32)> {
    let scale = corner.abs().max_element().recip();
    let (a, e1, e2) = (corner * scale, edge1 * scale, edge2 * scale);
    let p = direction.cross(e2);
    let det = e1.dot(p);
    if det == 0.0 {
        return None;
    }
    let u = (-a.dot(p) / det).clamp(0.0, 1.0);
    let v = (direction.dot(e1.cross(a)) / det).clamp(0.0, 1.0);
    let outside = (u + v).max(1.0);
    let barycentric = Vec2::new(u / outside, v / outside);
    let distance = (a + e1 * barycentric.x + e2 * barycentric.y).length() / scale;
    (barycentric.is_finite() && distance > 0.0).then_some((barycentric, distance))
}
