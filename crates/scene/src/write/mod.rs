//! Writes a scene as binary glTF 2.0.
//!
//! Nodes keep their indices (instances that cannot share a node are put into children added behind them), materials and
//! textures keep theirs. Many instances of one mesh under one node become `EXT_mesh_gpu_instancing`. Vertex data is
//! streamed from the scene's own arrays, so writing needs little memory beside the scene.
//!
//! Not for round trips of foreign files: what the scene model does not hold (names of images in other formats, custom
//! extras, unused objects) is gone, and pictures become PNG.

mod animation;
mod buffer;
mod lit;
mod material;
mod mesh;
mod node;

use crate::{Scene, SceneError};
use buffer::Buffers;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::PathBuf;

pub use lit::{LitNode, Unfolding, WrittenNode, write_lit_glb};

/// Why a scene could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The destination refused.
    #[error("cannot write: {0}")]
    Io(#[from] std::io::Error),
    /// A picture could not be encoded as PNG.
    #[error("cannot encode image {name}: {why}")]
    Image {
        /// Name of the image.
        name: String,
        /// What the encoder said.
        why: String,
    },
    /// The source file cannot be read again.
    #[error(transparent)]
    Source(#[from] SceneError),
    /// The source file is not the one that the scene was loaded from.
    #[error("the scene's file has changed: {}: start again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// GLB holds at most 4 GiB.
    #[error("the scene needs {bytes} bytes, GLB holds at most 4294967295")]
    TooLarge {
        /// Size of the file that would be needed.
        bytes: u64,
    },
}

/// Names of the extensions that the file uses and those that a reader must know.
#[derive(Default)]
struct Extensions {
    used: BTreeSet<&'static str>,
    required: BTreeSet<&'static str>,
}

/// Writes `scene` as GLB 2.0. The same scene gives the same bytes.
///
/// Hand it a buffered writer; it is flushed at the end.
pub fn write_glb(scene: &Scene, out: &mut impl Write) -> Result<(), WriteError> {
    let mut buffers = Buffers::default();
    let mut extensions = Extensions::default();
    let mut root = Map::new();

    let nodes = node::write(scene, &mut buffers, &mut extensions);
    let animations = animation::write(scene, &nodes.morphing, &mut buffers);
    let images = material::images(scene, &mut buffers)?;
    let (textures, samplers) = material::textures(scene);
    let materials: Vec<Value> = scene
        .materials
        .iter()
        .map(|m| material::write(m, &mut extensions))
        .collect();

    root.insert(
        "asset".into(),
        json!({"version": "2.0", "generator": "occlude"}),
    );
    let mut main = Map::new();
    if !scene.name.is_empty() {
        main.insert("name".into(), scene.name.as_str().into());
    }
    if !nodes.roots.is_empty() {
        main.insert("nodes".into(), nodes.roots.into());
    }
    if scene.sky != glam::Vec3::ZERO {
        main.insert(
            "extras".into(),
            json!({"sky": vector(&scene.sky.to_array())}),
        );
    }
    root.insert("scene".into(), 0.into());
    root.insert("scenes".into(), json!([main]));
    if !nodes.lights.is_empty() {
        root.insert(
            "extensions".into(),
            json!({"KHR_lights_punctual": {"lights": nodes.lights}}),
        );
    }
    let bytes = buffers.length;
    let (views, accessors, chunks) = buffers.finish();
    for (key, list) in [
        ("nodes", nodes.nodes),
        ("meshes", nodes.meshes),
        ("skins", nodes.skins),
        ("animations", animations),
        ("cameras", nodes.cameras),
        ("materials", materials),
        ("textures", textures),
        ("samplers", samplers),
        ("images", images),
        ("bufferViews", views),
        ("accessors", accessors),
    ] {
        if !list.is_empty() {
            root.insert(key.into(), list.into());
        }
    }
    if bytes > 0 {
        root.insert("buffers".into(), json!([{"byteLength": bytes}]));
    }
    for (key, names) in [
        ("extensionsUsed", &extensions.used),
        ("extensionsRequired", &extensions.required),
    ] {
        if !names.is_empty() {
            root.insert(key.into(), names.iter().copied().collect());
        }
    }
    container(&Value::Object(root), bytes, &chunks, out)
}

/// GLB: a header, a JSON chunk and a binary chunk, all little-endian and padded to 4 bytes (glTF 2.0, section 4).
pub(crate) fn container(
    root: &Value,
    bytes: u64,
    chunks: &[std::borrow::Cow<'_, [u8]>],
    out: &mut impl Write,
) -> Result<(), WriteError> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary = if bytes > 0 { 8 + bytes } else { 0 };
    let total = 12 + 8 + text.len() as u64 + binary;
    let total = u32::try_from(total).map_err(|_| WriteError::TooLarge { bytes: total })?;
    out.write_all(b"glTF")?;
    out.write_all(&2u32.to_le_bytes())?;
    out.write_all(&total.to_le_bytes())?;
    out.write_all(&(text.len() as u32).to_le_bytes())?;
    out.write_all(b"JSON")?;
    out.write_all(&text)?;
    if bytes > 0 {
        out.write_all(&(bytes as u32).to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        for chunk in chunks {
            out.write_all(chunk)?;
            out.write_all(&[0; 3][..chunk.len().next_multiple_of(4) - chunk.len()])?;
        }
    }
    Ok(out.flush()?)
}

/// A number in the fewest digits that give the same `f32` back.
fn number(x: f32) -> Value {
    x.to_string()
        .parse::<f64>()
        .map_or(Value::Null, Value::from)
}

fn vector(v: &[f32]) -> Value {
    v.iter().map(|&x| number(x)).collect()
}
