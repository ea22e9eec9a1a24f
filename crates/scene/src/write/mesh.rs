//! Primitives: the scene's meshes, each with one material.

use super::buffer::{Buffers, FLOAT, UNSIGNED_INT, UNSIGNED_SHORT, Use};
use crate::{Mesh, MorphTarget};
use serde_json::{Map, Value, json};
use std::borrow::Cow::{Borrowed, Owned};

/// One glTF primitive.
pub(super) fn primitive<'a>(mesh: &'a Mesh, buffers: &mut Buffers<'a>) -> Value {
    let mut attributes = Map::new();
    attributes.insert("POSITION".into(), buffers.positions(&mesh.positions).into());
    let mut add = |name: &str, accessor: usize| attributes.insert(name.into(), accessor.into());
    if !mesh.normals.is_empty() {
        add(
            "NORMAL",
            buffers.array(Borrowed(&mesh.normals), FLOAT, "VEC3", Use::Vertices),
        );
    }
    if !mesh.tangents.is_empty() {
        add(
            "TANGENT",
            buffers.array(Borrowed(&mesh.tangents), FLOAT, "VEC4", Use::Vertices),
        );
    }
    if !mesh.uv0.is_empty() {
        add(
            "TEXCOORD_0",
            buffers.array(Borrowed(&mesh.uv0), FLOAT, "VEC2", Use::Vertices),
        );
    }
    if !mesh.uv1.is_empty() {
        add(
            "TEXCOORD_1",
            buffers.array(Borrowed(&mesh.uv1), FLOAT, "VEC2", Use::Vertices),
        );
    }
    if !mesh.colors.is_empty() {
        add(
            "COLOR_0",
            buffers.array(Borrowed(&mesh.colors), FLOAT, "VEC4", Use::Vertices),
        );
    }
    if let Some(skinning) = &mesh.skinning {
        add(
            "JOINTS_0",
            buffers.array(
                Borrowed(&skinning.joints),
                UNSIGNED_SHORT,
                "VEC4",
                Use::Vertices,
            ),
        );
        add(
            "WEIGHTS_0",
            buffers.array(Borrowed(&skinning.weights), FLOAT, "VEC4", Use::Vertices),
        );
    }
    // 65535 restarts strips and may not be an index.
    let indices = if mesh.positions.len() < usize::from(u16::MAX) {
        let short: Vec<[u16; 3]> = mesh.triangles.iter().map(|t| t.map(|i| i as u16)).collect();
        buffers.triangles(Owned(short), UNSIGNED_SHORT)
    } else {
        buffers.triangles(Borrowed(mesh.triangles.as_slice()), UNSIGNED_INT)
    };
    let mut primitive =
        json!({"attributes": attributes, "indices": indices, "material": mesh.material});
    if !mesh.morph_targets.is_empty() {
        primitive["targets"] = mesh
            .morph_targets
            .iter()
            .map(|target| morph_target(target, buffers))
            .collect();
    }
    primitive
}

fn morph_target<'a>(target: &'a MorphTarget, buffers: &mut Buffers<'a>) -> Value {
    let mut attributes = Map::new();
    if !target.positions.is_empty() {
        attributes.insert(
            "POSITION".into(),
            buffers.positions(&target.positions).into(),
        );
    }
    for (name, data) in [("NORMAL", &target.normals), ("TANGENT", &target.tangents)] {
        if !data.is_empty() {
            let accessor = buffers.array(Borrowed(data.as_slice()), FLOAT, "VEC3", Use::Vertices);
            attributes.insert(name.into(), accessor.into());
        }
    }
    Value::Object(attributes)
}
