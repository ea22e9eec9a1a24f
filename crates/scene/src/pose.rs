//! Where everything is at one time.

use crate::motion::unit_quaternion;
use crate::{Channel, LightKind, Mesh, RestTransform, RestWeights, Scene, Skin, Skinning, Target};
use glam::{Affine3A, Mat3A, Mat4, Vec3, Vec4};
use rayon::prelude::*;

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
    pub tangents: Vec<Vec4>,
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

/// Where the nodes are at one time, without the vertices that hang on them.
pub(crate) struct Joints {
    pub(crate) world_from_node: Vec<Affine3A>,
    pub(crate) weights: Vec<RestWeights>,
}

impl Joints {
    pub(crate) fn at(scene: &Scene, time: f32) -> Self {
        let mut rest = scene.motion.rest.clone();
        let mut weights = scene.motion.weights.clone();
        for channel in scene.motion.clips.iter().flat_map(|c| &c.channels) {
            apply(channel, time, &mut rest, &mut weights);
        }

        let mut moved = rest.iter().peekable();
        let mut world_from_node: Vec<Affine3A> = Vec::with_capacity(scene.nodes.len());
        for (i, node) in scene.nodes.iter().enumerate() {
            let parent_from_node = match moved.next_if(|r| r.node as usize == i) {
                Some(rest) => rest.parent_from_node(),
                None => node.parent_from_node,
            };
            world_from_node.push(match node.parent {
                Some(parent) => world_from_node[parent as usize] * parent_from_node,
                None => parent_from_node,
            });
        }
        Self {
            world_from_node,
            weights,
        }
    }
}

impl Pose {
    /// The scene at `time` (seconds): all animations of the file played together, held before their first and after
    /// their last key.
    pub fn at(scene: &Scene, time: f32) -> Self {
        let Joints {
            world_from_node,
            weights,
        } = Joints::at(scene, time);
        let mut instances: Vec<PosedInstance> = Vec::with_capacity(scene.instances.len());
        let mut deforming = Vec::new();
        for (i, instance) in scene.instances.iter().enumerate() {
            let weights = weights_of(&weights, instance.node);
            let deforms = instance.skin.is_some() || weights.iter().any(|&w| w != 0.0);
            let world_from_object = match instance.skin {
                Some(_) => Affine3A::IDENTITY,
                None => world_from_node[instance.node as usize] * instance.node_from_object,
            };
            instances.push(PosedInstance {
                mesh: instance.mesh,
                node: instance.node,
                world_from_object,
                deformed: deforms.then_some(deforming.len() as u32),
            });
            if deforms {
                deforming.push((i, weights));
            }
        }
        let deformed = deforming
            .into_par_iter()
            .map(|(i, weights)| {
                let instance = &scene.instances[i];
                let mesh = &scene.meshes[instance.mesh as usize];
                let skin = instance.skin.map(|s| &scene.skins[s as usize]);
                deform(mesh, weights, skin, &world_from_node)
            })
            .collect();

        let lights = scene
            .lights
            .iter()
            .map(|light| {
                let world_from_light = world_from_node[light.node as usize];
                PosedLight {
                    position: world_from_light.translation.into(),
                    direction: (-Vec3::from(world_from_light.matrix3.z_axis))
                        .try_normalize()
                        .unwrap_or(Vec3::NEG_Z),
                    intensity: light.intensity,
                    kind: light.kind,
                }
            })
            .collect();
        Self {
            time,
            world_from_node,
            instances,
            deformed,
            lights,
        }
    }

    /// Where a camera stands and how it is turned, without the scale of its node: columns X right, Y up, Z backwards.
    pub fn camera_world(&self, scene: &Scene, camera: usize) -> Affine3A {
        let world_from_node = self.world_from_node[scene.cameras[camera].node as usize];
        let [_, up, back] = [
            world_from_node.matrix3.x_axis,
            world_from_node.matrix3.y_axis,
            world_from_node.matrix3.z_axis,
        ];
        let back = Vec3::from(back).try_normalize().unwrap_or(Vec3::Z);
        let right = Vec3::from(up).cross(back).try_normalize();
        let right = right.unwrap_or_else(|| back.any_orthonormal_vector());
        Affine3A::from_cols(
            right.into(),
            back.cross(right).into(),
            back.into(),
            world_from_node.translation,
        )
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

    /// Vertex tangents of an instance, in its object space; empty unless the material has a normal map.
    pub fn tangents<'a>(&'a self, scene: &'a Scene, instance: usize) -> &'a [Vec4] {
        let posed = &self.instances[instance];
        match posed.deformed {
            Some(d) => &self.deformed[d as usize].tangents,
            None => &scene.meshes[posed.mesh as usize].tangents,
        }
    }
}

/// Sets what one channel moves.
fn apply(channel: &Channel, time: f32, rest: &mut [RestTransform], weights: &mut [RestWeights]) {
    if channel.target == Target::Weights {
        if let Ok(i) = weights.binary_search_by_key(&channel.node, |w| w.node)
            && weights[i].weights.len() == channel.width
        {
            channel.sample(time, &mut weights[i].weights);
        }
        return;
    }
    let Ok(i) = rest.binary_search_by_key(&channel.node, |r| r.node) else {
        return;
    };
    let mut value = [0.0; 4];
    if channel.width > value.len() {
        return;
    }
    channel.sample(time, &mut value[..channel.width]);
    match channel.target {
        Target::Translation => rest[i].translation = Vec4::from(value).truncate(),
        Target::Rotation => rest[i].rotation = unit_quaternion(value.into()),
        Target::Scale => rest[i].scale = Vec4::from(value).truncate(),
        Target::Weights => {}
    }
}

pub(crate) fn weights_of(weights: &[RestWeights], node: u32) -> &[f32] {
    match weights.binary_search_by_key(&node, |w| w.node) {
        Ok(i) => &weights[i].weights,
        Err(_) => &[],
    }
}

/// Morphs, then skins.
fn deform(mesh: &Mesh, weights: &[f32], skin: Option<&Skin>, world: &[Affine3A]) -> Deformed {
    let mut out = Deformed {
        positions: mesh.positions.clone(),
        normals: mesh.normals.clone(),
        tangents: mesh.tangents.clone(),
    };
    for (target, &weight) in mesh.morph_targets.iter().zip(weights) {
        if weight == 0.0 {
            continue;
        }
        let add = |to: &mut [Vec3], by: &[Vec3]| {
            to.par_iter_mut()
                .zip(by)
                .for_each(|(to, by)| *to += *by * weight);
        };
        add(&mut out.positions, &target.positions);
        add(&mut out.normals, &target.normals);
        for (to, by) in out.tangents.iter_mut().zip(&target.tangents) {
            *to += by.extend(0.0) * weight;
        }
    }
    if let (Some(skin), Some(skinning)) = (skin, &mesh.skinning) {
        let joints: Vec<Mat4> = skin
            .joints
            .iter()
            .zip(&skin.joint_from_object)
            .map(|(&joint, &joint_from_object)| {
                Mat4::from(world[joint as usize]) * joint_from_object
            })
            .collect();
        skin_vertices(&mut out, skinning, &joints);
    }
    let unit = |v: Vec3, fallback: Vec3| v.try_normalize().unwrap_or(fallback);
    let normals = out.normals.par_iter_mut().zip(&mesh.normals);
    normals.for_each(|(n, &rest)| *n = unit(*n, rest));
    let tangents = out.tangents.par_iter_mut().zip(&mesh.tangents);
    tangents.for_each(|(t, rest)| *t = unit(t.truncate(), rest.truncate()).extend(t.w));
    out
}

/// Linear blend skinning into world space.
fn skin_vertices(out: &mut Deformed, skinning: &Skinning, world_from_object: &[Mat4]) {
    let blended = |i: usize| {
        let (joints, weights) = (skinning.joints[i], skinning.weights[i]);
        let matrix = |k: usize| world_from_object[joints[k] as usize] * weights[k];
        Affine3A::from_mat4(matrix(0) + matrix(1) + matrix(2) + matrix(3))
    };
    let Deformed {
        positions,
        normals,
        tangents,
    } = out;
    let positions = positions.par_iter_mut().enumerate();
    positions.for_each(|(i, p)| *p = blended(i).transform_point3(*p));
    normals.par_iter_mut().enumerate().for_each(|(i, n)| {
        // The cofactor matrix: the inverse transpose up to a factor, and defined for singular matrices too.
        let m = blended(i).matrix3;
        let cofactor = Mat3A::from_cols(
            m.y_axis.cross(m.z_axis),
            m.z_axis.cross(m.x_axis),
            m.x_axis.cross(m.y_axis),
        );
        let mirror = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
        *n = cofactor * *n * mirror;
    });
    tangents.par_iter_mut().enumerate().for_each(|(i, t)| {
        let m = blended(i).matrix3;
        let mirror = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
        *t = (m * t.truncate()).extend(t.w * mirror);
    });
}
