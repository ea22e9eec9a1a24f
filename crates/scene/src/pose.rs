//! Where everything is at one time.

use crate::{LightKind, Scene};
use glam::{Affine3A, Vec3};

/// A mesh instance at one time.
#[derive(Clone, Debug)]
pub struct PosedInstance {
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    /// Index into [`Scene::nodes`].
    pub node: u32,
    /// Its place in the world; the identity for skinned instances, whose `deformed` vertices are in world space.
    pub world_from_object: Affine3A,
    /// Index into [`Pose::deformed`] if skinning or morphing moved its vertices.
    pub deformed: Option<u32>,
}

/// Vertices moved by skinning and morphing; lengths as in the mesh.
#[derive(Clone, Debug, Default)]
pub struct Deformed {
    /// Positions.
    pub positions: Vec<Vec3>,
    /// Unit normals; empty if the mesh has none.
    pub normals: Vec<Vec3>,
    /// Unit tangents; empty if the mesh has none.
    pub tangents: Vec<glam::Vec4>,
}

/// A punctual light at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosedLight {
    /// World-space position.
    pub position: Vec3,
    /// Unit vector along which it shines.
    pub direction: Vec3,
    /// See [`Light::intensity`](crate::Light::intensity).
    pub intensity: Vec3,
    /// What kind it is.
    pub kind: LightKind,
}

/// Where everything is at one time.
#[derive(Clone, Debug, Default)]
pub struct Pose {
    /// Seconds.
    pub time: f32,
    /// World transform of every node.
    pub world_from_node: Vec<Affine3A>,
    /// As [`Scene::instances`].
    pub instances: Vec<PosedInstance>,
    /// Deformed vertices.
    pub deformed: Vec<Deformed>,
    /// As [`Scene::lights`].
    pub lights: Vec<PosedLight>,
}

impl Pose {
    /// The scene at `time` (seconds): all animations of the file played together, held before their first and after
    /// their last key.
    pub fn at(scene: &Scene, time: f32) -> Self {
        let _ = (scene, time);
        todo!("loader helper implements this")
    }

    /// Vertex positions of an instance, in its object space.
    pub fn positions<'a>(&'a self, scene: &'a Scene, instance: usize) -> &'a [Vec3] {
        let posed = &self.instances[instance];
        match posed.deformed {
            Some(d) => &self.deformed[d as usize].positions,
            None => &scene.meshes[posed.mesh as usize].positions,
        }
    }

    /// Vertex normals of an instance, in its object space; empty: shade flat.
    pub fn normals<'a>(&'a self, scene: &'a Scene, instance: usize) -> &'a [Vec3] {
        let posed = &self.instances[instance];
        match posed.deformed {
            Some(d) => &self.deformed[d as usize].normals,
            None => &scene.meshes[posed.mesh as usize].normals,
        }
    }

    /// Vertex tangents of an instance, in its object space; empty if the mesh has none.
    pub fn tangents<'a>(&'a self, scene: &'a Scene, instance: usize) -> &'a [glam::Vec4] {
        let posed = &self.instances[instance];
        match posed.deformed {
            Some(d) => &self.deformed[d as usize].tangents,
            None => &scene.meshes[posed.mesh as usize].tangents,
        }
    }
}
