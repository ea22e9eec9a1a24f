//! What a ray finds where it hits: position, normals, sides, and the material there.

use super::alpha::{base_color, interpolate, lookup};
use super::{Geometry, WorldTriangle};
use crate::bsdf::BsdfParameters;
use glam::{Mat3, Vec3, Vec4Swizzles};
use occlude_scene::{Material, Mesh, NormalMap};
use occlude_visibility::Hit;

/// A point on a surface, seen from one side.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// World-space position.
    pub position: Vec3,
    /// Unit geometric normal on the side that is seen.
    pub normal: Vec3,
    /// World from local shading frame: columns tangent, bitangent, shading normal. The shading normal lies on the side that
    /// is seen and is bent, where need be, so that the viewer is above it.
    pub world_from_local: Mat3,
    /// The front side is seen.
    pub front: bool,
    /// Largest absolute coordinate of the triangle: what rounding of `position` is relative to.
    pub extent: f32,
    /// The hit.
    pub hit: Hit,
    /// Shading normal on the front side, before it is bent towards a viewer.
    shading_front: Vec3,
    /// The same of the clear coat, where it has a normal of its own.
    coat_front: Option<Vec3>,
    /// The clear coat's normal in the local frame.
    coat_local: Vec3,
    mesh: &'a Mesh,
    material: &'a Material,
}

impl<'a> Surface<'a> {
    /// The surface at a hit, seen from `toward_eye` (unit vector from the hit to the viewer). `None` if the triangle has no
    /// area.
    pub fn new(geometry: &Geometry<'a>, hit: Hit, toward_eye: Vec3) -> Option<Self> {
        let (scene, pose) = (geometry.scene, geometry.pose);
        let posed = &pose.instances[hit.instance as usize];
        let mesh = &scene.meshes[posed.mesh as usize];
        let material = &scene.materials[mesh.material as usize];
        let triangle = WorldTriangle::new(scene, pose, hit.instance, hit.primitive);
        let front_normal = triangle.front_cross().try_normalize()?;
        let front = front_normal.dot(toward_eye) >= 0.0;
        let normal = if front { front_normal } else { -front_normal };

        let vertices = mesh.triangles[hit.primitive as usize];
        let normals = pose.normals(scene, hit.instance as usize);
        let normal_from_object = geometry.normal_from_object(hit.instance);
        let smooth = (!normals.is_empty())
            .then(|| {
                (normal_from_object * interpolate(normals, vertices, hit.u, hit.v)).try_normalize()
            })
            .flatten()
            .unwrap_or(front_normal);
        // Vertex normals that disagree with the winding are taken to mean the other side.
        let smooth = if smooth.dot(front_normal) < 0.0 {
            -smooth
        } else {
            smooth
        };

        let mut surface = Self {
            position: triangle.point(hit.u, hit.v),
            normal,
            world_from_local: Mat3::IDENTITY,
            front,
            extent: triangle.extent(),
            hit,
            shading_front: smooth,
            coat_front: None,
            coat_local: Vec3::Z,
            mesh,
            material,
        };
        if let Some(map) = &material.normal {
            surface.shading_front = surface
                .mapped_normal(geometry, map, &triangle, smooth)
                .unwrap_or(smooth);
        }
        // KHR_materials_clearcoat: without a map of its own the coat is smooth, whatever lies below.
        if material.clearcoat > 0.0 && material.clearcoat_normal != material.normal {
            let mapped = material
                .clearcoat_normal
                .as_ref()
                .and_then(|map| surface.mapped_normal(geometry, map, &triangle, smooth));
            surface.coat_front = Some(mapped.unwrap_or(smooth));
        }
        surface.orient(toward_eye);
        Some(surface)
    }

    /// The same point, seen from another direction.
    pub fn turned(&self, toward_eye: Vec3) -> Self {
        let mut turned = *self;
        let front_normal = if self.front {
            self.normal
        } else {
            -self.normal
        };
        turned.front = front_normal.dot(toward_eye) >= 0.0;
        turned.normal = if turned.front {
            front_normal
        } else {
            -front_normal
        };
        turned.orient(toward_eye);
        turned
    }

    /// Sets the shading frame for a viewer on the side of `normal`.
    fn orient(&mut self, toward_eye: Vec3) {
        let shading = if self.front {
            self.shading_front
        } else {
            -self.shading_front
        };
        let z = seen_from(shading, self.normal, toward_eye);
        let (x, y) = z.any_orthonormal_pair();
        self.world_from_local = Mat3::from_cols(x, y, z);
        if let Some(coat) = self.coat_front {
            let coat = if self.front { coat } else { -coat };
            let coat = mirroring_up(coat, self.normal, toward_eye);
            self.coat_local = (self.world_from_local.transpose() * coat).normalize();
        }
    }

    /// The normal that a normal map gives, on the front side. `None` where it is not defined.
    fn mapped_normal(
        &self,
        geometry: &Geometry,
        map: &NormalMap,
        triangle: &WorldTriangle,
        smooth: Vec3,
    ) -> Option<Vec3> {
        let Hit {
            u,
            v,
            primitive,
            instance,
            ..
        } = self.hit;
        let texel =
            lookup(geometry.scene, self.mesh, &map.texture, primitive, u, v).xyz() * 2.0 - 1.0;
        let local = Vec3::new(texel.x * map.scale, texel.y * map.scale, texel.z);
        // The mesh's tangents belong to the UV set of the base's map.
        let base_set = self.material.normal.map(|base| base.texture.uv_set);
        let tangents = if base_set.is_none_or(|set| set == map.texture.uv_set) {
            geometry.pose.tangents(geometry.scene, instance as usize)
        } else {
            &[]
        };
        let (tangent, sign) = if tangents.is_empty() {
            // Directions of growing u and v on the triangle.
            let set = if map.texture.uv_set == 0 {
                &self.mesh.uv0
            } else {
                &self.mesh.uv1
            };
            let [a, b, c] =
                self.mesh.triangles[primitive as usize].map(|i| set.get(i as usize).copied());
            let (a, b, c) = (a?, b?, c?);
            let (d1, d2) = (b - a, c - a);
            let [p0, p1, p2] = triangle.corners;
            let area = d1.perp_dot(d2);
            (
                (p1 - p0) * d2.y - (p2 - p0) * d1.y,
                if triangle.mirrored {
                    -area.signum()
                } else {
                    area.signum()
                },
            )
        } else {
            let tangent = interpolate(tangents, self.mesh.triangles[primitive as usize], u, v);
            let world_from_object = geometry.pose.instances[instance as usize].world_from_object;
            (
                world_from_object.transform_vector3(tangent.xyz()),
                tangent.w,
            )
        };
        let tangent = if tangents.is_empty() {
            tangent * sign
        } else {
            tangent
        };
        let tangent = (tangent - smooth * smooth.dot(tangent)).try_normalize()?;
        let handed = if tangents.is_empty() {
            sign
        } else {
            sign * if triangle.mirrored { -1.0 } else { 1.0 }
        };
        let bitangent = smooth.cross(tangent) * handed;
        (tangent * local.x + bitangent * local.y + smooth * local.z).try_normalize()
    }

    /// Whether a mirror (`across` 1) or clear glass (-1) leads the viewer of `turned`, the same point, to this one's: both see the same normals.
    pub fn mirrors_like(&self, turned: &Self, across: f32) -> bool {
        self.shading_normal() == turned.shading_normal() * across
            && (across < 0.0 || self.coat_local == turned.coat_local)
    }

    /// Material of the surface.
    pub fn material(&self) -> &'a Material {
        self.material
    }

    /// The unit shading normal.
    pub fn shading_normal(&self) -> Vec3 {
        self.world_from_local.z_axis
    }

    /// The clear coat's unit normal in the local frame, bent so that the viewer's mirror image is above the surface: z
    /// unless the coat has one of its own.
    pub fn coat_normal(&self) -> Vec3 {
        self.coat_local
    }

    /// Radiance that the surface emits towards the viewer, textures applied.
    pub fn emission(&self, geometry: &Geometry) -> Vec3 {
        let material = self.material;
        let Hit {
            u, v, primitive, ..
        } = self.hit;
        if material.unlit {
            return base_color(geometry.scene, material, self.mesh, primitive, u, v).xyz();
        }
        if material.emission == Vec3::ZERO || !(self.front || material.double_sided) {
            return Vec3::ZERO;
        }
        match &material.emission_texture {
            Some(texture) => {
                material.emission
                    * lookup(geometry.scene, self.mesh, texture, primitive, u, v).xyz()
            }
            None => material.emission,
        }
    }

    /// Parameters of the surface's scattering, textures applied.
    pub fn bsdf_parameters(&self, geometry: &Geometry) -> BsdfParameters {
        let material = self.material;
        let Hit {
            u, v, primitive, ..
        } = self.hit;
        let value = |texture: &Option<occlude_scene::TextureRef>| {
            texture
                .as_ref()
                .map(|t| lookup(geometry.scene, self.mesh, t, primitive, u, v))
        };
        let (mut metallic, mut roughness) = (material.metallic, material.roughness);
        if let Some(texel) = value(&material.metallic_roughness_texture) {
            (metallic, roughness) = (metallic * texel.z, roughness * texel.y);
        }
        let scaled = |factor: f32, texture, channel: usize| {
            if factor == 0.0 {
                0.0
            } else {
                factor * value(texture).map_or(1.0, |texel| texel[channel])
            }
        };
        let tinted =
            |factor: Vec3, texture| factor * value(texture).map_or(Vec3::ONE, |texel| texel.xyz());
        BsdfParameters {
            base_color: base_color(geometry.scene, material, self.mesh, primitive, u, v).xyz(),
            metallic,
            roughness,
            ior: material.ior,
            specular: scaled(material.specular, &material.specular_texture, 3),
            specular_color: tinted(material.specular_color, &material.specular_color_texture),
            transmission: scaled(material.transmission, &material.transmission_texture, 0),
            thin: material.volume.is_none_or(|volume| volume.thickness == 0.0),
            entering: self.front,
            clearcoat: scaled(material.clearcoat, &material.clearcoat_texture, 0),
            clearcoat_roughness: scaled(
                material.clearcoat_roughness,
                &material.clearcoat_roughness_texture,
                1,
            ),
            coat_normal: self.coat_local,
            sheen_color: tinted(material.sheen_color, &material.sheen_color_texture),
            sheen_roughness: scaled(
                material.sheen_roughness,
                &material.sheen_roughness_texture,
                3,
            ),
        }
    }
}

/// Bends a shading normal towards the geometric normal just far enough that `toward_eye` is above it: a viewer who sees
/// the surface must not look at its shading from behind.
fn seen_from(shading: Vec3, normal: Vec3, toward_eye: Vec3) -> Vec3 {
    const LEAST_COS: f32 = 1e-3;
    if shading.dot(toward_eye) >= LEAST_COS {
        return shading;
    }
    // Remove what points away from the viewer, then lean towards them by the least cosine.
    let level = shading - toward_eye * shading.dot(toward_eye);
    level
        .try_normalize()
        .map_or(normal, |level| (level + toward_eye * LEAST_COS).normalize())
}

/// Bends a coat's normal just far enough that it mirrors `toward_eye` to a direction above the surface, as light does that would
/// have bounced there twice: a smooth coat whose mirror image lies within the body would be black. (The reflected direction is
/// lifted, the normal follows from it: Keller et al. 2017, "The Iray Light Transport Simulation and Rendering System", section A.3.)
fn mirroring_up(coat: Vec3, normal: Vec3, toward_eye: Vec3) -> Vec3 {
    const LEAST_HEIGHT: f32 = 0.01;
    let least = LEAST_HEIGHT.min(toward_eye.dot(normal).abs());
    let mirrored = 2.0 * coat.dot(toward_eye) * coat - toward_eye;
    let height = mirrored.dot(normal);
    if height >= least && coat.dot(toward_eye) > 0.0 {
        return coat;
    }
    let lifted = (mirrored + normal * (least - height).max(0.0)).normalize();
    (lifted + toward_eye).try_normalize().unwrap_or(normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coats_mirror_to_directions_above_the_surface() {
        for i in 0..10_000_u32 {
            let turn = |k: f32| (i as f32 * k).fract() - 0.5;
            let eye =
                Vec3::new(turn(0.618), 0.5 * (turn(0.7548) + 0.501), turn(0.5698)).normalize();
            let coat = Vec3::new(turn(0.819) * 3.0, 0.3, turn(0.671) * 3.0).normalize();
            let bent = mirroring_up(coat, Vec3::Y, eye);
            let mirrored = 2.0 * bent.dot(eye) * bent - eye;
            assert!(
                bent.is_normalized() && bent.dot(eye) > 0.0 && mirrored.y > 0.0,
                "{eye} {coat} -> {bent}"
            );
            let free = 2.0 * coat.dot(eye) * coat - eye;
            assert!(bent == coat || free.y < 0.01 || coat.dot(eye) <= 0.0);
        }
    }

    #[test]
    fn bent_normals_face_the_viewer() {
        let eye = Vec3::new(0.9, 0.1, 0.0).normalize();
        for shading in [
            Vec3::Y,
            Vec3::new(-0.8, 0.6, 0.0),
            Vec3::new(-1.0, 0.0, 0.0),
            -eye,
        ] {
            let bent = seen_from(shading, Vec3::Y, eye);
            assert!(
                bent.dot(eye) > 0.0 && (bent.length() - 1.0).abs() < 1e-5,
                "{shading} -> {bent}"
            );
        }
        assert_eq!(seen_from(Vec3::Y, Vec3::Y, eye), Vec3::Y);
    }
}
