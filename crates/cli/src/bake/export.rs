//! What a bake leaves: light maps, previews, the scene with its second UV set, the manifest, the viewer's page.

use super::Setup;
use super::args::{BakeArgs, EngineName};
use crate::error::CliError;
use crate::output;
use glam::Vec3;
use occlude_bake::rounds::Bake;
use occlude_bake::state::State;
use occlude_image::{Depth, Layers, Look, Picture};
use serde_json::json;
use std::f32::consts::FRAC_1_PI;

/// The viewer's page, made from crates/cli/view.
const VIEW: &str = include_str!("../../view/view.html");

/// Writes the output folder.
pub fn write(args: &BakeArgs, setup: &Setup, bake: &Bake, state: &State) -> Result<(), CliError> {
    let folder = &args.output;
    std::fs::create_dir_all(folder)
        .map_err(|error| CliError::failed("cannot make the folder", folder.display(), error))?;
    let (quantity, factor) = match args.engine {
        EngineName::Three => ("irradiance", 1.0),
        EngineName::Bevy | EngineName::Godot | EngineName::Blender => ("irradiance/pi", FRAC_1_PI),
    };
    let mut pages = Vec::new();
    for (number, page) in setup.built.atlas.pages.iter().enumerate() {
        let pixels = (0..page.texels())
            .map(|k| {
                let light = bake.irradiance(state, page.first_texel + k);
                (light.unwrap_or(Vec3::ZERO) * factor).to_array()
            })
            .collect();
        let picture = Picture {
            width: page.width,
            height: page.height,
            pixels,
        };
        let layers = Layers::from_picture(&picture, Depth::Half);
        let name = format!("lightmap_{number:03}.exr");
        occlude_image::write_layers(&folder.join(&name), &layers, Look::default())?;
        let preview = folder.join(format!("lightmap_{number:03}.png"));
        occlude_image::write(&preview, &picture, Look::default())?;
        pages.push(json!({"file": name, "width": page.width, "height": page.height}));
    }
    let manifest = json!({
        "schema": 1,
        "scene": setup.loaded.scene.name,
        "quantity": quantity,
        "engine": format!("{:?}", args.engine).to_lowercase(),
        "pages": pages,
        "nodes": [],
    });
    output::write(&folder.join("manifest.json"), |out| {
        out.write_all(serde_json::to_string_pretty(&manifest)?.as_bytes())
    })?;
    output::write(&folder.join("view.html"), |out| {
        out.write_all(VIEW.as_bytes())
    })?;
    Ok(())
}
