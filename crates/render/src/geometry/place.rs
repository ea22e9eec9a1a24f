//! A place that rides on a posed surface: a triangle and where on it.

use super::alpha::interpolate;
use super::{Geometry, WorldTriangle};
use glam::Vec3;
use occlude_visibility::Hit;

/// A point of a triangle, and the side of it that counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) instance: u32,
    pub(crate) primitive: u32,
    /// Barycentric weights of the second and the third vertex.
    pub(crate) u: f32,
    pub(crate) v: f32,
    /// The front side.
    pub(crate) front: bool,
}

/// Where a [`Place`] is in a pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub(crate) position: Vec3,
    /// Unit interpolated vertex normal, without normal map, on the side that counts.
    pub(crate) normal: Vec3,
    /// Unit geometric normal on that side.
    pub(crate) flat: Vec3,
    /// A direction in the surface that turns with it.
    pub(crate) along: Vec3,
    /// Largest absolute coordinate of the triangle.
    pub(crate) extent: f32,
}

impl Place {
    /// The place of a hit, on the side that `toward_eye` sees; `None` if the triangle has no area.
    pub(crate) fn of_hit(geometry: &Geometry, hit: &Hit, toward_eye: Vec3) -> Option<(Self, Spot)> {
        let place = Self {
            instance: hit.instance,
            primitive: hit.primitive,
            u: hit.u,
            v: hit.v,
            front: true,
        };
        let spot = place.spot(geometry)?;
        if spot.flat.dot(toward_eye) >= 0.0 {
            return Some((place, spot));
        }
        let behind = Self {
            front: false,
            ..place
        };
        let turned = Spot {
            normal: -spot.normal,
            flat: -spot.flat,
            ..spot
        };
        Some((behind, turned))
    }

    /// Where it is; `None` if the triangle has no area.
    pub(crate) fn spot(&self, geometry: &Geometry) -> Option<Spot> {
        let (scene, pose) = (geometry.scene, geometry.pose);
        let triangle = WorldTriangle::new(scene, pose, self.instance, self.primitive);
        let flat = triangle.front_cross().try_normalize()?;
        let mesh = &scene.meshes[pose.instances[self.instance as usize].mesh as usize];
        let normals = pose.normals(scene, self.instance as usize);
        let smooth = if normals.is_empty() {
            flat
        } else {
            let corners = mesh.triangles[self.primitive as usize];
            let object = interpolate(normals, corners, self.u, self.v);
            let world = geometry.normal_from_object(self.instance) * object;
            let world = world.try_normalize().unwrap_or(flat);
            if world.dot(flat) < 0.0 { -world } else { world }
        };
        let side = if self.front { 1.0 } else { -1.0 };
        Some(Spot {
            position: triangle.point(self.u, self.v),
            normal: smooth * side,
            flat: flat * side,
            along: triangle.corners[1] - triangle.corners[0],
            extent: triangle.extent(),
        })
    }
}
