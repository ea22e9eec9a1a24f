//! What engines need to know beside the pictures.

use super::{ExportSettings, rectangle};
use crate::texel::Texels;
use occlude_scene::WrittenNode;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// `manifest.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of this format: 1.
    pub schema: u32,
    /// The scene's file.
    pub scene: String,
    /// `irradiance` or `irradiance/pi`.
    pub quantity: String,
    /// Who reads it.
    pub engine: String,
    /// Unit of the values: W/m² (if light sources are in radiometric units).
    pub unit: String,
    /// How to come from UVs to a page.
    pub convention: String,
    /// Layer of the pages that says where light comes from: `sh1` or `dominant`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub directional: String,
    /// The light maps.
    pub pages: Vec<PageEntry>,
    /// What is lit by which part of them.
    pub nodes: Vec<NodeEntry>,
}

/// A light map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PageEntry {
    /// File name.
    pub file: String,
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A node of `scene.glb` and its rectangle on a page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeEntry {
    /// Index of the node.
    pub node: u32,
    /// Which of its instances, for `EXT_mesh_gpu_instancing`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<u32>,
    /// Name of the node.
    pub name: String,
    /// Name of a mesh that hangs there.
    pub mesh: String,
    /// Index of the page.
    pub page: u32,
    /// `uv1 * scale + offset` is the place on the page.
    pub scale: [f32; 2],
    /// See `scale`.
    pub offset: [f32; 2],
    /// Texels of the rectangle.
    pub texels: u64,
}

impl Manifest {
    pub(super) fn new(
        texels: &Texels,
        written: &[WrittenNode],
        pages: Vec<PageEntry>,
        settings: &ExportSettings,
    ) -> Self {
        let (scene, atlas) = (texels.scene, texels.atlas);
        let mut mesh_of: BTreeMap<u32, &str> = BTreeMap::new();
        for placement in atlas.placements.iter().flatten() {
            let layout = &atlas.layouts[placement.layout as usize];
            for piece in 0..layout.pieces.len() as u32 {
                let block = atlas.rectangles[(placement.first_rectangle + piece) as usize].block;
                mesh_of
                    .entry(block)
                    .or_insert(&scene.meshes[layout.mesh as usize].name);
            }
        }
        let entry = |(i, block): (usize, &crate::atlas::Block)| {
            let (scale, offset) = rectangle(atlas, block);
            let written = written.get(i).copied().unwrap_or(WrittenNode {
                node: block.node,
                instance: None,
            });
            NodeEntry {
                node: written.node,
                instance: written.instance,
                name: scene.nodes[block.node as usize].name.clone(),
                mesh: mesh_of
                    .get(&(i as u32))
                    .copied()
                    .unwrap_or_default()
                    .to_string(),
                page: block.page,
                scale: scale.to_array(),
                offset: offset.to_array(),
                texels: u64::from(block.size.x) * u64::from(block.size.y),
            }
        };
        Self {
            schema: 1,
            scene: scene.name.clone(),
            quantity: settings.engine.quantity().0.into(),
            engine: settings.engine.name().into(),
            unit: "W/m2".into(),
            directional: settings.directional.name().into(),
            convention: "page uv = TEXCOORD_1 * scale + offset; uv (0, 0) is the top left corner; v runs down".into(),
            pages,
            nodes: atlas.blocks.iter().enumerate().map(entry).collect(),
        }
    }
}
