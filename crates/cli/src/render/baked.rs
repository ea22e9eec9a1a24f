//! `--integrator baked`: a scene that `occlude bake` has written, in the light of its maps.

use super::args::RenderArgs;
use crate::context::Context;
use crate::error::CliError;
use glam::Vec2;
use occlude_bake::baked::{Baked, Place};
use occlude_image::{Attribute, Depth, Layers, Limits, Look, write_layers};
use occlude_render::camera::{PixelFilter, View};
use occlude_render::geometry::Geometry;
use occlude_render::light::Lights;
use occlude_scene::{Instance, Scene};
use serde::Deserialize;
use std::f32::consts::PI;
use std::path::Path;

/// What is read of manifest.json.
#[derive(Debug, Deserialize)]
struct Manifest {
    quantity: String,
    pages: Vec<Page>,
    nodes: Vec<Node>,
}

#[derive(Debug, Deserialize)]
struct Page {
    file: String,
}

#[derive(Debug, Deserialize)]
struct Node {
    node: u32,
    #[serde(default)]
    instance: Option<u32>,
    page: u32,
    scale: [f32; 2],
    offset: [f32; 2],
}

/// Renders and writes.
pub fn run(
    args: &RenderArgs,
    context: &mut Context,
    geometry: &Geometry,
    lights: &Lights,
    view: &View,
    filter: PixelFilter,
    look: Look,
) -> Result<(), CliError> {
    let baked = context.phase("load", |context| load(&args.scene, geometry.scene, context))?;
    let samples = args.known_samples().unwrap_or(super::args::DEFAULT_SAMPLES);
    let seed = context.common.seed;
    let picture = context.phase("work", |_| {
        let sky = |towards| lights.environment(towards);
        baked.picture(geometry, view, filter, samples, seed, sky)
    });
    let depth = if args.half { Depth::Half } else { Depth::Float };
    let mut layers = Layers::from_picture(&picture, depth);
    layers.describe("integrator", Attribute::Text("baked".to_owned()));
    context.phase("write", |_| {
        for output in &args.output {
            write_layers(output, &layers, look)?;
        }
        Ok(())
    })
}

/// Reads the light maps beside a scene, as irradiance.
fn load(scene_file: &Path, scene: &Scene, context: &Context) -> Result<Baked, CliError> {
    let folder = scene_file.parent().unwrap_or(Path::new(""));
    let path = folder.join("manifest.json");
    let text = std::fs::read(&path).map_err(|error| CliError::read(&path, &error))?;
    let manifest: Manifest = serde_json::from_slice(&text).map_err(|error| {
        CliError::input(
            format_args!("not a manifest of light maps ({error})"),
            path.display(),
            "give the scene.glb that occlude bake has written",
        )
    })?;
    let limits = context
        .common
        .memory
        .map_or_else(Limits::default, |max_bytes| Limits { max_bytes });
    let factor = match manifest.quantity.as_str() {
        "irradiance/pi" => PI,
        _ => 1.0,
    };
    let mut pages = Vec::new();
    for page in &manifest.pages {
        // A name, not a path: nothing outside of the folder is read.
        let name = Path::new(&page.file).file_name().unwrap_or_default();
        let picture = occlude_image::read(&folder.join(name), &limits)?.picture;
        pages.push(picture.map(|c| c.map(|v| v * factor)));
    }
    // The places of a node (EXT_mesh_gpu_instancing) come one after the other, each with all primitives of its mesh.
    let mut place = 0;
    let mut earlier: Option<&Instance> = None;
    let places = scene.instances.iter().map(|instance| {
        place = match earlier {
            Some(before) if before.node != instance.node => 0,
            Some(before) if before.node_from_object != instance.node_from_object => place + 1,
            _ => place,
        };
        earlier = Some(instance);
        let file = scene.contents.file_nodes.get(instance.node as usize)?;
        let node = manifest.nodes.iter().find(|node| {
            node.node == *file && node.instance.is_none_or(|wanted| wanted == place)
        })?;
        Some(Place {
            page: node.page,
            scale: Vec2::from(node.scale),
            offset: Vec2::from(node.offset),
        })
    });
    let places = places.collect();
    Ok(Baked { pages, places })
}
