//! Small glTF documents made on the spot.

// Every test program takes what it needs.
#![allow(dead_code)]

use occlude_scene::{Scene, SceneError};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

pub const U8: u32 = 5121;
pub const U16: u32 = 5123;
pub const U32: u32 = 5125;
pub const F32: u32 = 5126;

/// A glTF document that grows.
#[derive(Clone, Debug)]
pub struct Document {
    pub json: Value,
    pub bytes: Vec<u8>,
}

impl Document {
    pub fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"},
            "accessors": [], "bufferViews": [], "meshes": [], "nodes": [],
            "scenes": [{}], "scene": 0,
        });
        Self {
            json,
            bytes: Vec::new(),
        }
    }

    /// Appends to a list of the document and gives the index.
    pub fn push(&mut self, list: &str, entry: Value) -> usize {
        if self.json[list].is_null() {
            self.json[list] = json!([]);
        }
        let list = self.json[list].as_array_mut().unwrap();
        list.push(entry);
        list.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        self.push(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}),
        )
    }

    pub fn accessor(&mut self, bytes: &[u8], component: u32, shape: &str, count: usize) -> usize {
        let view = self.view(bytes);
        let entry =
            json!({"bufferView": view, "componentType": component, "type": shape, "count": count});
        self.push("accessors", entry)
    }

    pub fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let shape = ["SCALAR", "SCALAR", "VEC2", "VEC3", "VEC4"]
            .get(N)
            .copied()
            .unwrap_or("MAT4");
        let bytes: Vec<u8> = values
            .as_flattened()
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        self.accessor(&bytes, F32, shape, values.len())
    }

    pub fn indices(&mut self, values: &[u32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, U32, "SCALAR", values.len())
    }

    /// A mesh of one primitive.
    pub fn mesh(&mut self, primitive: Value) -> usize {
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    /// A node at the root of the scene.
    pub fn node(&mut self, node: Value) -> usize {
        let index = self.push("nodes", node);
        let nodes = &mut self.json["scenes"][0]["nodes"];
        if nodes.is_null() {
            *nodes = json!([]);
        }
        nodes.as_array_mut().unwrap().push(index.into());
        index
    }

    /// One triangle (0,0,0), (1,0,0), (0,1,0) as a mesh.
    pub fn triangle(&mut self) -> usize {
        let position = self.floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        self.mesh(json!({"attributes": {"POSITION": position}}))
    }

    /// The document as GLB.
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bytes.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut out = b"glTF".to_vec();
        let words = |out: &mut Vec<u8>, words: [u32; 2]| {
            out.extend(words.iter().flat_map(|w| w.to_le_bytes()));
        };
        words(&mut out, [2, (12 + 8 + text.len() + 8 + bin.len()) as u32]);
        words(&mut out, [text.len() as u32, 0x4e4f_534a]);
        out.extend(text);
        words(&mut out, [bin.len() as u32, 0x004e_4942]);
        out.extend(bin);
        out
    }

    pub fn load(&self) -> Result<Scene, SceneError> {
        load(&self.glb(), "glb")
    }
}

/// A file that goes away again.
pub struct Temporary(pub PathBuf);

impl Temporary {
    pub fn new(bytes: &[u8], extension: &str) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("occlude-scene-{}-{number}.{extension}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, bytes).unwrap();
        Self(path)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

pub fn load(bytes: &[u8], extension: &str) -> Result<Scene, SceneError> {
    Scene::load(&Temporary::new(bytes, extension).0, None, None)
}
