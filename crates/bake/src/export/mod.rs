//! What a bake leaves in its folder: light maps (multi-layer EXR), previews, pictures of validity, the scene with its second UV set, the
//! manifest.
//!
//! | consumer | what its shader does with a texel | so the maps hold |
//! |---|---|---|
//! | three.js | adds it to irradiance, Lambert divides by pi | E |
//! | Bevy, Godot, Blender | multiplies it by base colour, no pi | E / pi |
//!
//! Page coordinates are `uv1 * scale + offset`, (0, 0) the corner of the top left texel. Everything is written beside its name and renamed
//! when whole, the manifest last: a folder with a new manifest holds new maps.

pub mod directional;
mod manifest;

pub use manifest::{Manifest, NodeEntry, PageEntry};

use crate::atlas::{Atlas, Block};
use crate::finish::denoise::{DenoiseSettings, denoise};
use crate::finish::orphans::adopt;
use crate::finish::seams::{Stitched, stitch};
use crate::finish::{Canvas, LEAST_VALIDITY};
use crate::texel::Texels;
use crate::texel::validity::{Solids, validity};
use directional::{Directional, directions};
use glam::Vec2;
use occlude_image::{
    Attribute, Depth, ImageError, Layers, ToneMap, write_atomically, write_exr_rows, write_png_rows,
};
use occlude_render::geometry::Geometry;
use occlude_render::job::Job;
use occlude_scene::{LitNode, Unfolding, WriteError, WrittenNode, write_lit_glb};
use serde_json::json;
use std::collections::BTreeMap;
use std::f32::consts::FRAC_1_PI;
use std::io::BufWriter;
use std::ops::Range;
use std::path::Path;

/// Who reads the maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// three.js.
    #[default]
    Three,
    /// Bevy.
    Bevy,
    /// Godot.
    Godot,
    /// Blender.
    Blender,
}

impl Engine {
    /// The name in the manifest.
    pub fn name(self) -> &'static str {
        match self {
            Self::Three => "three",
            Self::Bevy => "bevy",
            Self::Godot => "godot",
            Self::Blender => "blender",
        }
    }

    /// What maps hold, and by how much irradiance is multiplied for it.
    pub fn quantity(self) -> (&'static str, f32) {
        match self {
            Self::Three => ("irradiance", 1.0),
            Self::Bevy | Self::Godot | Self::Blender => ("irradiance/pi", FRAC_1_PI),
        }
    }
}

/// What becomes of gathered light on its way into files.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExportSettings {
    /// Who reads the maps.
    pub engine: Engine,
    /// Smooth the noise that is left.
    pub denoise: Option<DenoiseSettings>,
    /// Texels around charts that are filled. At least what the atlas's padding asks for.
    pub dilate: u32,
    /// Close seams.
    pub stitch: bool,
    /// Where light comes from, in layers of its own.
    pub directional: Directional,
}

/// How texels that are partly or wholly inside of something are found.
#[derive(Clone, Copy, Debug)]
pub struct Insides<'a> {
    /// What rays meet.
    pub geometry: &'a Geometry<'a>,
    /// What has an inside.
    pub solids: &'a Solids,
}

/// Light by texel, numbers counted through all pages.
pub trait Light: Sync {
    /// Irradiance, W/m². What is given for texels that nothing covers does not matter.
    fn irradiance(&self, texel: u32) -> [f32; 3];

    /// Whether the value means anything. Texels without are filled from their neighbours.
    fn is_known(&self, _texel: u32) -> bool {
        true
    }

    /// Texels of which less than this share is covered are known badly, if their neighbours have more.
    fn least_coverage(&self) -> f32 {
        0.0
    }

    /// A page has been read: what is on disk may leave memory until it is asked for again.
    fn rest(&self) {}

    /// First moment of the light ([`Bake::moment`](crate::rounds::Bake::moment)); for [`ExportSettings::directional`].
    fn moment(&self, _texel: u32) -> [f32; 3] {
        [0.0; 3]
    }
}

/// Why the output could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A picture or text could not be written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The scene could not be written.
    #[error("cannot write the scene: {}: {source}", path.display())]
    Scene {
        /// The file.
        path: std::path::PathBuf,
        /// Why.
        source: WriteError,
    },
    /// The job was cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// What was written.
#[derive(Clone, Debug, Default)]
pub struct Exported {
    /// The manifest.
    pub manifest: Manifest,
    /// Texels that took the values of valid neighbours.
    pub filled: u64,
    /// Texels of charts about which nothing is known, which took the light of what is near in the world.
    pub adopted: u64,
    /// Seams that were closed.
    pub stitched: Stitched,
}

/// Bytes that [`write()`] holds for each texel of the pages that are finished together.
pub const FINISHING_BYTES_PER_TEXEL: u64 = Canvas::BYTES_PER_TEXEL + 13;

/// Finishes and writes everything but the scene: maps, previews, manifest. Texels inside of solids are found and repaired if `insides` is given. Pages are finished together where seams across them are to be closed
/// and `memory` (bytes; `None`: no limit) allows; else one after the other, seams between pages then stay.
///
/// # Errors
/// [`ExportError`].
pub fn write(
    folder: &Path,
    texels: &Texels,
    light: &impl Light,
    insides: Option<Insides>,
    nodes: &[WrittenNode],
    settings: &ExportSettings,
    memory: Option<u64>,
    job: &Job,
) -> Result<Exported, ExportError> {
    let atlas = texels.atlas;
    let mut exported = Exported::default();
    let together = u64::from(atlas.texels()) * FINISHING_BYTES_PER_TEXEL;
    let pages: Vec<u32> = (0..atlas.pages.len() as u32).collect();
    let batch = match settings.stitch && memory.is_none_or(|limit| together <= limit) {
        true => pages.len().max(1),
        false => 1,
    };
    job.start_phase("finish", pages.len() as u64);
    let mut entries = Vec::with_capacity(pages.len());
    for batch in pages.chunks(batch) {
        let mut canvases: Vec<(u32, Canvas)> = Vec::with_capacity(batch.len());
        for &page in batch {
            if job.is_cancelled() {
                return Err(ExportError::Cancelled);
            }
            let mut canvas = Canvas::new(texels, page);
            let first = atlas.pages[page as usize].first_texel;
            if let Some(Insides { geometry, solids }) = insides {
                canvas.validity = validity(geometry, texels, solids, page);
            }
            for i in (0..canvas.values.len()).filter(|&i| canvas.charts[i] != 0) {
                let texel = first + i as u32;
                // What is inside gathered nothing: the rest stands for the texel.
                let share = canvas.validity[i];
                let scale = if share < LEAST_VALIDITY {
                    1.0
                } else {
                    1.0 / share
                };
                canvas.values[i] = light.irradiance(texel).map(|v| v * scale);
                if !light.is_known(texel) {
                    canvas.validity[i] = 0.0;
                }
            }
            light.rest();
            let least = light.least_coverage();
            if least > 0.0 {
                canvas.distrust_rims(texels, page, least);
            }
            exported.filled += canvas.fill_invalid();
            exported.adopted += adopt(texels, page, &mut canvas);
            if let Some(settings) = &settings.denoise {
                denoise(&mut canvas, settings);
            }
            canvas.dilate(settings.dilate);
            canvases.push((page, canvas));
        }
        if settings.stitch {
            let stitched = stitch(texels, &mut canvases, insides.map(|i| i.geometry));
            exported.stitched = merged(exported.stitched, stitched);
        }
        for (page, canvas) in canvases {
            entries.push(write_page(folder, texels, light, page, &canvas, settings)?);
            light.rest();
            job.advance(1, 0);
        }
    }
    exported.manifest = Manifest::new(texels, nodes, entries, settings);
    write_atomically(&folder.join("manifest.json"), |out| {
        serde_json::to_writer_pretty(&mut *out, &exported.manifest)?;
        out.write_all(b"\n")
    })?;
    Ok(exported)
}

fn merged(a: Stitched, b: Stitched) -> Stitched {
    let points = a.points + b.points;
    let mean = |x: f64, y: f64| {
        ((x * x * a.points as f64 + y * y * b.points as f64) / points.max(1) as f64).sqrt()
    };
    Stitched {
        points,
        before: mean(a.before, b.before),
        after: mean(a.after, b.after),
    }
}

fn write_page(
    folder: &Path,
    texels: &Texels,
    light: &impl Light,
    page: u32,
    canvas: &Canvas,
    settings: &ExportSettings,
) -> Result<PageEntry, ExportError> {
    let (quantity, factor) = settings.engine.quantity();
    let (width, height) = (canvas.width, canvas.height);
    let first = texels.atlas.pages[page as usize].first_texel;
    let stem = format!("lightmap_{page:03}");
    let direction = (settings.directional != Directional::None)
        .then(|| directions(texels, light, page, canvas, settings));
    let mut layers = Layers::new(width, height);
    for name in ["R", "G", "B", "raw.R", "raw.G", "raw.B", "validity.V"] {
        layers.push(name, Depth::Half, Vec::new());
    }
    if direction.is_some() {
        for c in ["X", "Y", "Z", "W"] {
            layers.push(
                &format!("{}.{c}", settings.directional.name()),
                Depth::Half,
                Vec::new(),
            );
        }
    }
    layers.describe("quantity", Attribute::Text(quantity.into()));
    layers.describe("engine", Attribute::Text(settings.engine.name().into()));
    let index = |rows: &Range<u32>| (rows.start * width) as usize..(rows.end * width) as usize;
    let file = format!("{stem}.exr");
    write_exr_rows(&folder.join(&file), &layers, |rows| {
        let range = index(&rows);
        let color = |of: &dyn Fn(usize) -> [f32; 3]| -> Vec<Vec<f32>> {
            let values: Vec<[f32; 3]> = range.clone().map(of).collect();
            (0..3)
                .map(|c| values.iter().map(|v| v[c] * factor).collect())
                .collect()
        };
        let covered = |i: usize| canvas.charts[i] != 0;
        let mut out = color(&|i| canvas.values[i]);
        out.extend(color(&|i| {
            if covered(i) {
                light.irradiance(first + i as u32)
            } else {
                [0.0; 3]
            }
        }));
        out.push(
            range
                .clone()
                .map(|i| if covered(i) { canvas.validity[i] } else { 0.0 })
                .collect(),
        );
        if let Some(direction) = &direction {
            out.extend((0..4).map(|c| range.clone().map(|i| direction[i][c]).collect()));
        }
        out
    })?;
    let tone_map = ToneMap::default();
    let text = |what: &str| {
        vec![
            ("Software".to_string(), "occlude".to_string()),
            ("Description".to_string(), what.to_string()),
        ]
    };
    // The radiance of a white surface, whatever the engine reads.
    let about = format!(
        "radiance of a white surface in this light; tone map {}",
        tone_map.name()
    );
    write_png_rows(
        &folder.join(format!("{stem}.png")),
        width,
        height,
        &text(&about),
        |rows| {
            let encode = |i: usize| tone_map.encode(canvas.values[i].map(|v| v * FRAC_1_PI), 0.0);
            index(&rows).flat_map(encode).collect()
        },
    )?;
    let about = "green: valid, red: invalid, black: not covered";
    write_png_rows(
        &folder.join(format!("{stem}_validity.png")),
        width,
        height,
        &text(about),
        |rows| {
            let encode = |i: usize| match (canvas.charts[i], canvas.validity[i]) {
                (0, _) => [0, 0, 0],
                (_, v) if v >= LEAST_VALIDITY => [0, (90.0 + 110.0 * v) as u8, 40],
                (_, v) => [220, (120.0 * v) as u8, 20],
            };
            index(&rows).flat_map(encode).collect()
        },
    )?;
    Ok(PageEntry {
        file,
        width,
        height,
    })
}

/// Scale and offset of a block on its page.
fn rectangle(atlas: &Atlas, block: &Block) -> (Vec2, Vec2) {
    let page = atlas.pages[block.page as usize];
    let size = Vec2::new(page.width as f32, page.height as f32);
    (block.size.as_vec2() / size, block.offset.as_vec2() / size)
}

/// A piece of a layout and its place in a block.
type PieceAt = (u32, [u32; 2]);

/// Writes `scene.glb`: the source with `TEXCOORD_1` on everything that is baked. Says where each of [`Atlas::blocks`] is in it.
///
/// # Errors
/// [`ExportError`].
pub fn write_scene(folder: &Path, texels: &Texels) -> Result<Vec<WrittenNode>, ExportError> {
    let atlas = texels.atlas;
    // Pieces that lie alike in blocks of one size share their vertices.
    let mut known: BTreeMap<(u32, [u32; 2], Vec<PieceAt>), u32> = BTreeMap::new();
    let mut unfoldings: Vec<Unfolding> = Vec::new();
    let mut nodes: Vec<LitNode> = atlas
        .blocks
        .iter()
        .map(|block| {
            let (scale, offset) = rectangle(atlas, block);
            LitNode {
                node: block.node,
                occurrence: block.occurrence,
                unfoldings: Vec::new(),
                rectangle: [block.page as f32, scale.x, scale.y, offset.x, offset.y],
                extras: json!({"page": block.page, "scale": scale.to_array(), "offset": offset.to_array()}),
            }
        })
        .collect();
    for placement in atlas.placements.iter().flatten() {
        let layout = &atlas.layouts[placement.layout as usize];
        let mut of_block: BTreeMap<u32, Vec<PieceAt>> = BTreeMap::new();
        for piece in 0..layout.pieces.len() as u32 {
            let r = atlas.rectangles[(placement.first_rectangle + piece) as usize];
            let within = r.offset - atlas.blocks[r.block as usize].offset;
            of_block
                .entry(r.block)
                .or_default()
                .push((piece, within.to_array()));
        }
        for (block, pieces) in of_block {
            let size = atlas.blocks[block as usize].size;
            let unfolding = *known
                .entry((placement.layout, size.to_array(), pieces.clone()))
                .or_insert_with(|| {
                    let size = size.as_vec2();
                    unfoldings.push(Unfolding {
                        mesh: layout.mesh,
                        uv: Box::new(move |t| {
                            let corners = *layout.corners.get(t as usize)?;
                            let &(_, at) = pieces.iter().find(|p| p.0 == layout.piece(t))?;
                            let at = Vec2::new(at[0] as f32, at[1] as f32);
                            Some(corners.map(|c| (c + at) / size))
                        }),
                    });
                    unfoldings.len() as u32 - 1
                });
            nodes[block as usize].unfoldings.push(unfolding);
        }
    }
    let path = folder.join("scene.glb");
    let mut written = Ok(Vec::new());
    write_atomically(&path, |out| {
        let mut out = BufWriter::with_capacity(1 << 16, out);
        written = write_lit_glb(texels.scene, &unfoldings, &nodes, &mut out);
        match &mut written {
            Ok(_) => Ok(()),
            Err(WriteError::Io(e)) => Err(std::io::Error::new(e.kind(), e.to_string())),
            Err(e) => Err(std::io::Error::other(e.to_string())),
        }
    })?;
    written.map_err(|source| ExportError::Scene { path, source })
}
