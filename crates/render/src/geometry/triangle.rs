//! One triangle of a posed scene, in the world.

use glam::Vec3;
use occlude_scene::{Pose, Scene};

/// A triangle of an instance, moved into the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldTriangle {
    /// Corners in the order of the file; a hit's `u` and `v` weigh the second and the third.
    pub corners: [Vec3; 3],
    /// The instance is mirrored (negative determinant): the file's counter-clockwise winding has become clockwise.
    pub mirrored: bool,
}

impl WorldTriangle {
    /// Fetches triangle `primitive` of `instance`.
    ///
    /// # Panics
    /// If either index is out of range.
    pub fn new(scene: &Scene, pose: &Pose, instance: u32, primitive: u32) -> Self {
        let posed = &pose.instances[instance as usize];
        let mesh = &scene.meshes[posed.mesh as usize];
        let positions = pose.positions(scene, instance as usize);
        let world_from_object = posed.world_from_object;
        let corner = |vertex: u32| world_from_object.transform_point3(positions[vertex as usize]);
        let [a, b, c] = mesh.triangles[primitive as usize];
        let corners = [corner(a), corner(b), corner(c)];
        Self {
            corners,
            mirrored: world_from_object.matrix3.determinant() < 0.0,
        }
    }

    /// Twice the area times the unit normal of the front side: the side from which the file's vertices run
    /// counter-clockwise in object space (glTF 2.0, section 3.7.2.1).
    pub fn front_cross(&self) -> Vec3 {
        let [a, b, c] = self.corners;
        let cross = (b - a).cross(c - a);
        if self.mirrored { -cross } else { cross }
    }

    /// The point with barycentric weights `1 - u - v`, `u`, `v`.
    pub fn point(&self, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.corners;
        a + (b - a) * u + (c - a) * v
    }

    /// The largest absolute coordinate: what rounding of points on the triangle is relative to.
    pub fn extent(&self) -> f32 {
        let [a, b, c] = self.corners;
        a.abs().max(b.abs()).max(c.abs()).max_element()
    }
}
