//! Scenes with a UV set for light maps.

use super::{WriteError, write_glb};
use crate::gltf::rewrite;
use crate::{Instance, Mesh, Node, Scene};
use glam::{Affine3A, Vec2};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

/// A mesh (or a part of it) laid out flat.
pub struct Unfolding<'a> {
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    /// The UVs of a triangle's corners; `None`: another unfolding has the triangle.
    pub uv: UvOf<'a>,
}

/// The UVs of a triangle's corners, by the number of the triangle.
type UvOf<'a> = Box<dyn Fn(u32) -> Option<[Vec2; 3]> + Sync + 'a>;

/// What hangs on a node at one place, lit by one rectangle of one page. A node may have several.
#[derive(Clone, Debug, PartialEq)]
pub struct LitNode {
    /// Index into [`Scene::nodes`].
    pub node: u32,
    /// Which of the node's places it is (`EXT_mesh_gpu_instancing`); otherwise 0.
    pub occurrence: u32,
    /// Indices of the unfoldings that are shown, one for a mesh of the node.
    pub unfoldings: Vec<u32>,
    /// Number of the page, scale x and y, offset x and y: for instances, which have no extras.
    pub rectangle: [f32; 5],
    /// Becomes `extras.lightmap` of the node.
    pub extras: serde_json::Value,
}

/// Where a [`LitNode`] is in the written file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WrittenNode {
    /// Index of the node.
    pub node: u32,
    /// Which of its instances, if the node has `EXT_mesh_gpu_instancing`.
    pub instance: Option<u32>,
}

/// Writes a scene as GLB 2.0 with `TEXCOORD_1` from `unfoldings`; says where each of `nodes` came to be.
///
/// A scene that came from a glTF file is that file again, edited: all its attributes, extras and extensions survive. Other scenes are written by
/// [`write_glb`]. Memory: the source file, and the written vertices.
///
/// # Errors
/// [`WriteError`].
pub fn write_lit_glb(
    scene: &Scene,
    unfoldings: &[Unfolding],
    nodes: &[LitNode],
    out: &mut impl Write,
) -> Result<Vec<WrittenNode>, WriteError> {
    let extension = scene
        .path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    if ["gltf", "glb"].contains(&extension.as_str()) {
        return rewrite::write(scene, unfoldings, nodes, out);
    }
    let mut lit = Scene {
        instances: Vec::new(),
        meshes: unfoldings
            .iter()
            .map(|u| split(&scene.meshes[u.mesh as usize], u))
            .collect(),
        ..scene.clone()
    };
    let mut shown: BTreeSet<(u32, u32)> = BTreeSet::new();
    let mut written = Vec::with_capacity(nodes.len());
    for (i, node) in nodes.iter().enumerate() {
        // A node of its own for every block but the first of a node.
        let first = i == 0
            || nodes[..i]
                .iter()
                .rev()
                .take_while(|n| n.node == node.node)
                .count()
                == 0;
        let target = if first {
            node.node
        } else {
            lit.nodes.push(Node {
                name: scene.nodes[node.node as usize].name.clone(),
                parent: Some(node.node),
                parent_from_node: Affine3A::IDENTITY,
            });
            lit.nodes.len() as u32 - 1
        };
        for &u in &node.unfoldings {
            let mesh = unfoldings[u as usize].mesh;
            shown.insert((node.node, mesh));
            let places = scene
                .instances
                .iter()
                .filter(|i| i.node == node.node && i.mesh == mesh);
            if let Some(place) = places.clone().nth(node.occurrence as usize) {
                lit.instances.push(Instance {
                    mesh: u,
                    node: target,
                    ..*place
                });
            }
        }
        written.push(WrittenNode {
            node: target,
            instance: None,
        });
    }
    // What is not lit stays as it is.
    let mut copies: BTreeMap<u32, u32> = BTreeMap::new();
    for instance in scene
        .instances
        .iter()
        .filter(|i| !shown.contains(&(i.node, i.mesh)))
    {
        let copy = *copies.entry(instance.mesh).or_insert_with(|| {
            lit.meshes
                .push(scene.meshes[instance.mesh as usize].clone());
            lit.meshes.len() as u32 - 1
        });
        lit.instances.push(Instance {
            mesh: copy,
            ..*instance
        });
    }
    write_glb(&lit, out)?;
    Ok(written)
}

/// A mesh with the UVs of an unfolding; vertices are split where they differ.
fn split(mesh: &Mesh, unfolding: &Unfolding) -> Mesh {
    let split = rewrite::split(&mesh.triangles, &*unfolding.uv);
    fn pick<T: Copy>(values: &[T], vertices: &[u32]) -> Vec<T> {
        if values.is_empty() {
            Vec::new()
        } else {
            vertices.iter().map(|&v| values[v as usize]).collect()
        }
    }
    let vertices = &split.vertices;
    Mesh {
        name: mesh.name.clone(),
        positions: pick(&mesh.positions, vertices),
        normals: pick(&mesh.normals, vertices),
        tangents: pick(&mesh.tangents, vertices),
        uv0: pick(&mesh.uv0, vertices),
        colors: pick(&mesh.colors, vertices),
        uv1: split.uv,
        triangles: split.triangles,
        material: mesh.material,
        skinning: mesh.skinning.clone(),
        morph_targets: mesh.morph_targets.clone(),
    }
}
