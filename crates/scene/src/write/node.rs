//! Nodes and what hangs on them: meshes, instances, skins, lights and cameras.

use super::buffer::{Buffers, FLOAT, Use};
use super::{Extensions, mesh, number, vector};
use crate::{Camera, Instance, Light, LightKind, Projection, Scene, Skin};
use glam::{Affine3A, DAffine3, Quat, Vec3};
use serde_json::{Map, Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// By node of the scene: the nodes of the file that carry its morphing meshes, and how many targets those have.
pub(super) type Morphing = BTreeMap<u32, Vec<(usize, usize)>>;

/// The parts of the file that nodes refer to.
pub(super) struct Nodes {
    pub morphing: Morphing,
    pub nodes: Vec<Value>,
    pub roots: Vec<usize>,
    pub meshes: Vec<Value>,
    pub skins: Vec<Value>,
    pub lights: Vec<Value>,
    pub cameras: Vec<Value>,
}

pub(super) fn write<'a>(
    scene: &'a Scene,
    buffers: &mut Buffers<'a>,
    extensions: &mut Extensions,
) -> Nodes {
    let skins = scene.skins.iter().map(|s| skin(s, buffers)).collect();
    let mut tree = Tree {
        scene,
        buffers,
        extensions,
        nodes: Vec::new(),
        children: Vec::new(),
        meshes: Vec::new(),
        mesh_of: BTreeMap::new(),
        primitives: BTreeMap::new(),
        morphing: Morphing::new(),
    };
    let mut rest = scene.motion.rest.iter().peekable();
    let mut roots = Vec::new();
    for (index, node) in scene.nodes.iter().enumerate() {
        // What moves has no matrix: the file's own numbers are kept.
        let mut json = match rest.next_if(|rest| rest.node as usize == index) {
            Some(rest) => parts(rest.translation, rest.rotation, rest.scale),
            None => transform(node.parent_from_node),
        };
        if !node.name.is_empty() {
            json.insert("name".into(), node.name.as_str().into());
        }
        tree.nodes.push(json);
        tree.children.push(Vec::new());
        match node.parent {
            Some(parent) => tree.children[parent as usize].push(index),
            None => roots.push(index),
        }
    }
    let mut on_node: BTreeMap<u32, Vec<&Instance>> = BTreeMap::new();
    for instance in &scene.instances {
        on_node.entry(instance.node).or_default().push(instance);
    }
    for (node, instances) in on_node {
        tree.instances(node as usize, &instances);
    }
    for (index, light) in scene.lights.iter().enumerate() {
        // Lights are the only extension objects that can be there already beside instancing, which has nodes of its own
        // when a light shares its node.
        let slot = tree.slot(light.node as usize, "extensions");
        let reference = json!({"KHR_lights_punctual": {"light": index}});
        tree.nodes[slot].insert("extensions".into(), reference);
        tree.extensions.used.insert("KHR_lights_punctual");
    }
    for (index, camera) in scene.cameras.iter().enumerate() {
        let slot = tree.slot(camera.node as usize, "camera");
        tree.nodes[slot].insert("camera".into(), index.into());
    }
    for (node, list) in tree.nodes.iter_mut().zip(tree.children) {
        if !list.is_empty() {
            node.insert("children".into(), list.into());
        }
    }
    Nodes {
        morphing: tree.morphing,
        nodes: tree.nodes.into_iter().map(Value::Object).collect(),
        roots,
        meshes: tree.meshes,
        skins,
        lights: scene.lights.iter().map(punctual).collect(),
        cameras: scene.cameras.iter().map(projection).collect(),
    }
}

struct Tree<'a, 'b> {
    scene: &'a Scene,
    buffers: &'b mut Buffers<'a>,
    extensions: &'b mut Extensions,
    nodes: Vec<Map<String, Value>>,
    children: Vec<Vec<usize>>,
    meshes: Vec<Value>,
    /// glTF meshes by the scene's meshes that are their primitives.
    mesh_of: BTreeMap<Vec<u32>, usize>,
    /// Primitives by scene mesh: vertex data is stored once.
    primitives: BTreeMap<u32, Value>,
    morphing: Morphing,
}

/// Bits of the transforms of all instances of a mesh under one node, their skin and how many morph targets they have (primitives of a mesh have
/// equally many).
type Places = (Option<u32>, usize, Vec<[u32; 12]>);

impl Tree<'_, '_> {
    /// The node itself, or a new child of it where `key` is taken.
    fn slot(&mut self, node: usize, key: &str) -> usize {
        if self.nodes[node].contains_key(key) {
            self.child(node, Map::new())
        } else {
            node
        }
    }

    fn child(&mut self, parent: usize, json: Map<String, Value>) -> usize {
        self.nodes.push(json);
        self.children.push(Vec::new());
        self.children[parent].push(self.nodes.len() - 1);
        self.nodes.len() - 1
    }

    /// Hangs all instances of one node on it: meshes at the same places together, one glTF node for each set of places.
    fn instances(&mut self, node: usize, instances: &[&Instance]) {
        let mut places_of: BTreeMap<u32, Places> = BTreeMap::new();
        for i in instances {
            let (skin, targets, places) = places_of.entry(i.mesh).or_default();
            *skin = i.skin;
            *targets = self.scene.meshes[i.mesh as usize].morph_targets.len();
            places.push(i.node_from_object.to_cols_array().map(f32::to_bits));
        }
        let mut meshes_at: BTreeMap<Places, Vec<u32>> = BTreeMap::new();
        for (mesh, places) in places_of {
            let m = &self.scene.meshes[mesh as usize];
            if !m.positions.is_empty() && !m.triangles.is_empty() {
                meshes_at.entry(places).or_default().push(mesh);
            }
        }
        for ((skin, targets, places), meshes) in meshes_at {
            let mesh = self.mesh(meshes);
            let places: Vec<Affine3A> = places
                .iter()
                .map(|p| Affine3A::from_cols_array(&p.map(f32::from_bits)))
                .collect();
            let parts: Option<Vec<_>> = places.iter().map(|&p| decompose(p)).collect();
            match (places.as_slice(), parts) {
                ([one], _) if *one == Affine3A::IDENTITY => {
                    let slot = self.slot(node, "mesh");
                    self.hang(slot, node, mesh, (skin, targets));
                }
                ([_, _, ..], Some(parts)) => {
                    let slot = if self.nodes[node].contains_key("mesh") {
                        self.child(node, Map::new())
                    } else {
                        node
                    };
                    self.hang(slot, node, mesh, (skin, targets));
                    self.instancing(slot, &parts);
                }
                _ => {
                    for &place in &places {
                        let slot = self.child(node, transform(place));
                        self.hang(slot, node, mesh, (skin, targets));
                    }
                }
            }
        }
    }

    /// Hangs a mesh of the scene's node `of` on a node of the file.
    fn hang(&mut self, node: usize, of: usize, mesh: usize, moved: (Option<u32>, usize)) {
        let (skin, targets) = moved;
        self.nodes[node].insert("mesh".into(), mesh.into());
        if let Some(skin) = skin {
            self.nodes[node].insert("skin".into(), skin.into());
        }
        if targets == 0 {
            return;
        }
        let of = of as u32;
        self.morphing.entry(of).or_default().push((node, targets));
        let rest = &self.scene.motion.weights;
        if let Ok(index) = rest.binary_search_by_key(&of, |rest| rest.node) {
            let mut weights = rest[index].weights.clone();
            weights.resize(targets, 0.0);
            self.nodes[node].insert("weights".into(), vector(&weights));
        }
    }

    fn instancing(&mut self, node: usize, places: &[(Vec3, Quat, Vec3)]) {
        self.extensions.used.insert("EXT_mesh_gpu_instancing");
        self.extensions.required.insert("EXT_mesh_gpu_instancing");
        let mut attributes = Map::new();
        let mut add = |name: &str, kind: &str, data: Vec<f32>, width: usize| {
            let accessor = self.buffers.floats(data, kind, width);
            attributes.insert(name.into(), accessor.into());
        };
        add(
            "TRANSLATION",
            "VEC3",
            places.iter().flat_map(|p| p.0.to_array()).collect(),
            3,
        );
        if places.iter().any(|p| p.1 != Quat::IDENTITY) {
            add(
                "ROTATION",
                "VEC4",
                places.iter().flat_map(|p| p.1.to_array()).collect(),
                4,
            );
        }
        if places.iter().any(|p| p.2 != Vec3::ONE) {
            add(
                "SCALE",
                "VEC3",
                places.iter().flat_map(|p| p.2.to_array()).collect(),
                3,
            );
        }
        let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
        self.nodes[node].insert("extensions".into(), extension);
    }

    /// The glTF mesh whose primitives are these meshes.
    fn mesh(&mut self, meshes: Vec<u32>) -> usize {
        if let Some(&known) = self.mesh_of.get(&meshes) {
            return known;
        }
        let list: Vec<Value> = meshes
            .iter()
            .map(|&m| {
                let mesh = &self.scene.meshes[m as usize];
                let make = || mesh::primitive(mesh, self.buffers);
                self.primitives.entry(m).or_insert_with(make).clone()
            })
            .collect();
        let first = &self.scene.meshes[meshes[0] as usize];
        let mut json = json!({"primitives": list});
        if !first.name.is_empty() {
            json["name"] = first.name.as_str().into();
        }
        self.meshes.push(json);
        self.mesh_of.insert(meshes, self.meshes.len() - 1);
        self.meshes.len() - 1
    }
}

/// Translation, rotation and scale, if the transform is no more than that. A shear is not.
///
/// In f64, where glam computes in the same order on every machine.
fn decompose(t: Affine3A) -> Option<(Vec3, Quat, Vec3)> {
    if t.matrix3 == glam::Mat3A::IDENTITY {
        return Some((t.translation.into(), Quat::IDENTITY, Vec3::ONE));
    }
    let exact = DAffine3::from_cols_array(&t.to_cols_array().map(f64::from));
    let (scale, rotation, _) = exact.to_scale_rotation_translation();
    if !(rotation.is_finite() && scale.is_finite()) {
        return None;
    }
    let rotation = rotation.normalize();
    let back = DAffine3::from_scale_rotation_translation(scale, rotation, exact.translation);
    // A few units in the last place of the largest entry.
    let tolerance = 8.0 * f64::from(f32::EPSILON) * scale.abs().max_element();
    back.matrix3
        .abs_diff_eq(exact.matrix3, tolerance)
        .then(|| (t.translation.into(), rotation.as_quat(), scale.as_vec3()))
}

fn transform(t: Affine3A) -> Map<String, Value> {
    if t == Affine3A::IDENTITY {
        return Map::new();
    }
    match decompose(t) {
        Some((translation, rotation, scale)) => parts(translation, rotation, scale),
        None => {
            let matrix = glam::Mat4::from(t).to_cols_array();
            Map::from_iter([("matrix".to_owned(), vector(&matrix))])
        }
    }
}

fn parts(translation: Vec3, rotation: Quat, scale: Vec3) -> Map<String, Value> {
    let mut json = Map::new();
    if translation != Vec3::ZERO {
        json.insert("translation".into(), vector(&translation.to_array()));
    }
    if rotation != Quat::IDENTITY {
        json.insert("rotation".into(), vector(&rotation.to_array()));
    }
    if scale != Vec3::ONE {
        json.insert("scale".into(), vector(&scale.to_array()));
    }
    json
}

fn skin<'a>(skin: &'a Skin, buffers: &mut Buffers<'a>) -> Value {
    let matrices = Cow::Borrowed(skin.joint_from_object.as_slice());
    let accessor = buffers.array(matrices, FLOAT, "MAT4", Use::Other);
    json!({"joints": skin.joints, "inverseBindMatrices": accessor})
}

/// Colour and intensity: the largest channel becomes 1.
fn punctual(light: &Light) -> Value {
    let strongest = light.intensity.max_element();
    let (color, intensity) = if strongest > 0.0 {
        ((light.intensity / strongest).max(Vec3::ZERO), strongest)
    } else {
        (Vec3::ONE, 0.0)
    };
    let mut json = json!({"color": vector(&color.to_array()), "intensity": number(intensity)});
    if !light.name.is_empty() {
        json["name"] = light.name.as_str().into();
    }
    match light.kind {
        LightKind::Directional { angular_diameter } => {
            json["type"] = "directional".into();
            if angular_diameter > 0.0 {
                json["extras"] = json!({"angular_diameter": number(angular_diameter)});
            }
        }
        LightKind::Point => json["type"] = "point".into(),
        LightKind::Spot {
            inner_angle,
            outer_angle,
        } => {
            json["type"] = "spot".into();
            json["spot"] = json!({
                "innerConeAngle": number(inner_angle),
                "outerConeAngle": number(outer_angle),
            });
        }
    }
    json
}

fn projection(camera: &Camera) -> Value {
    let mut json = match camera.projection {
        Projection::Perspective { yfov } => json!({
            "type": "perspective",
            "perspective": {"yfov": number(yfov), "znear": 0.01},
        }),
        Projection::Orthographic { ymag } => json!({
            "type": "orthographic",
            "orthographic": {"xmag": number(ymag), "ymag": number(ymag), "znear": 0.0, "zfar": 10000.0},
        }),
    };
    if !camera.name.is_empty() {
        json["name"] = camera.name.as_str().into();
    }
    json
}
