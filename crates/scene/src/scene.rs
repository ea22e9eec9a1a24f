//! The immutable scene.

use crate::{
    Camera, Image, Light, Material, Mesh, Motion, SceneError, Texture, Warning, gltf, obj,
};
use glam::{Affine3A, Mat4};
use std::path::{Path, PathBuf};

/// A node of the hierarchy. Parents stand before their children.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Name; may be empty.
    pub name: String,
    /// Index of the parent, smaller than the node's own; `None` at a root.
    pub parent: Option<u32>,
    /// Rest transform.
    pub parent_from_node: Affine3A,
}

/// A mesh somewhere in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    /// Index into [`Scene::nodes`].
    pub node: u32,
    /// For `EXT_mesh_gpu_instancing`: this instance's own transform below the node; otherwise the identity.
    pub node_from_object: Affine3A,
    /// Index into [`Scene::skins`]; the mesh then has `skinning` and the node's own transform is ignored.
    pub skin: Option<u32>,
}

/// Joints of a skinned mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skin {
    /// Nodes.
    pub joints: Vec<u32>,
    /// Brings vertices into each joint's space.
    pub joint_from_object: Vec<Mat4>,
}

/// Everything that a file describes; made by a loader, validated once, never changed.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// File name without its folder.
    pub name: String,
    /// The file it came from; empty for procedural scenes.
    pub path: PathBuf,
    /// Nodes, parents first.
    pub nodes: Vec<Node>,
    /// Unique meshes.
    pub meshes: Vec<Mesh>,
    /// Where meshes are.
    pub instances: Vec<Instance>,
    /// Skins.
    pub skins: Vec<Skin>,
    /// Materials, at least one if there is a mesh.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Decoded images.
    pub images: Vec<Image>,
    /// Punctual lights.
    pub lights: Vec<Light>,
    /// Cameras, in file order.
    pub cameras: Vec<Camera>,
    /// What moves by itself.
    pub motion: Motion,
    /// Constant environment radiance of the file (`extras.sky`), black by default.
    pub sky: glam::Vec3,
    /// Nodes whose (or whose mesh's) `extras.texelsPerMetre` asks for another density in light maps than the scene's, in ascending order, and that
    /// density: finite, at least 0.
    pub texel_densities: Vec<(u32, f32)>,
    /// What the file holds beyond what is drawn, for reports.
    pub contents: Contents,
    /// What was repaired or ignored.
    pub warnings: Vec<Warning>,
}

/// Facts about the file for `inspect`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contents {
    /// Extensions that the file uses and the loader understands.
    pub extensions_used: Vec<String>,
    /// Extensions that the file uses and the loader ignores.
    pub extensions_ignored: Vec<String>,
    /// Names of the file's scenes and which was taken.
    pub scenes: Vec<String>,
    /// The scene that was taken.
    pub scene: usize,
    /// Names and lengths of animations, seconds.
    pub animations: Vec<(String, f32)>,
    /// For each of [`Scene::nodes`] its index in the file.
    pub file_nodes: Vec<u32>,
    /// For each of [`Scene::meshes`] its mesh in the file, and the primitive of that mesh.
    pub file_meshes: Vec<[u32; 2]>,
    /// Program that wrote the file.
    pub generator: String,
}

impl Scene {
    /// Loads a scene by its file name: `.gltf`, `.glb` or `.obj`.
    ///
    /// `gltf_scene` picks one of the file's scenes by name or index. `memory_limit` (bytes) bounds what loading allocates.
    pub fn load(
        path: &Path,
        gltf_scene: Option<&str>,
        memory_limit: Option<u64>,
    ) -> Result<Self, SceneError> {
        let extension = path
            .extension()
            .unwrap_or_default()
            .to_string_lossy()
            .to_lowercase();
        match extension.as_str() {
            "gltf" | "glb" => gltf::load(path, gltf_scene, memory_limit),
            "obj" => obj::load(path, memory_limit)?.validate(),
            _ => {
                // A missing file is the better complaint than an unknown kind of file.
                std::fs::metadata(path).map_err(|source| SceneError::Read {
                    path: path.to_path_buf(),
                    source,
                })?;
                let what = match extension.as_str() {
                    "" => "a scene without a file name extension".to_string(),
                    other => format!("scene files of type .{other} are not supported"),
                };
                Err(SceneError::invalid(
                    path,
                    "",
                    &what,
                    "convert it to .glb, .gltf or .obj",
                ))
            }
        }
    }
}
