//! What a bake leaves: light maps, previews, the scene with its second UV set, the manifest, the viewer's page.

use super::args::{BakeArgs, DirectionalName, EngineName};
use super::setup::Setup;
use crate::context::Context;
use crate::error::CliError;
use crate::output;
use glam::Vec3;
use occlude_bake::export::directional::Directional;
use occlude_bake::export::{self, Engine, ExportError, ExportSettings, Insides, Light};
use occlude_bake::finish::denoise::DenoiseSettings;
use occlude_bake::rounds::Bake;
use occlude_bake::state::State;
use occlude_bake::texel::Texels;
use occlude_bake::texel::validity::Solids;
use occlude_render::job::Job;
use occlude_scene::Scene;

/// The viewer's page, made from crates/cli/view.
const VIEW: &str = include_str!("../../view/view.html");

/// Texels around charts that are filled at least; as many as the atlas keeps them apart if that is more.
const DILATE: u32 = 4;

/// The light of a bake that is done.
struct Gathered<'a> {
    bake: &'a Bake<'a>,
    state: &'a State,
}

impl Light for Gathered<'_> {
    fn irradiance(&self, texel: u32) -> [f32; 3] {
        let light = self.bake.irradiance(self.state, texel);
        light.unwrap_or(Vec3::ZERO).to_array()
    }

    fn least_coverage(&self) -> f32 {
        self.bake.least_coverage(self.state)
    }

    fn moment(&self, texel: u32) -> [f32; 3] {
        self.bake.moment(self.state, texel).to_array()
    }

    fn rest(&self) {
        self.state.release();
    }

    fn is_known(&self, texel: u32) -> bool {
        self.bake.irradiance(self.state, texel).is_some()
    }
}

/// Writes the output folder.
pub fn write(
    args: &BakeArgs,
    setup: &Setup,
    bake: &Bake,
    state: &State,
    context: &Context,
) -> Result<(), CliError> {
    let folder = &args.output;
    std::fs::create_dir_all(folder)
        .map_err(|error| CliError::failed("cannot make the folder", folder.display(), error))?;
    let _ = std::fs::remove_file(folder.join(FINGERPRINT));
    let settings = ExportSettings {
        engine: match args.engine {
            EngineName::Three => Engine::Three,
            EngineName::Bevy => Engine::Bevy,
            EngineName::Godot => Engine::Godot,
            EngineName::Blender => Engine::Blender,
        },
        denoise: args.denoise.then(DenoiseSettings::default),
        dilate: DILATE.max(args.work.padding),
        stitch: true,
        directional: match args.work.directional {
            DirectionalName::None => Directional::None,
            DirectionalName::Sh1 => Directional::Sh1,
            DirectionalName::Dominant => Directional::Dominant,
        },
    };
    let solids = Solids::of(&setup.loaded.scene);
    let insides = Insides {
        geometry: setup.geometry,
        solids: &solids,
    };
    let spare = (context.common.memory)
        .map(|limit| limit.saturating_sub(crate::stats::resident_memory()) / 2);
    let nodes = write_scene(args, setup)?;
    // Cancelling now would only lose what is done: the rest is a matter of seconds.
    let exported = export::write(
        folder,
        setup.texels,
        &Gathered { bake, state },
        Some(insides),
        &nodes,
        &settings,
        spare,
        &Job::new(),
    )
    .map_err(|error| failed(error, args))?;
    output::write(&folder.join("view.html"), |out| {
        out.write_all(VIEW.as_bytes())
    })?;
    // Last: it says that all the rest is there.
    let done = fingerprint(args, setup);
    output::write(&folder.join(FINGERPRINT), |out| {
        out.write_all(done.as_bytes())
    })?;
    if exported.adopted > 0 {
        context.progress.note(&format!(
            "{} texels of charts that are too small take the light of what is near",
            exported.adopted
        ));
    }
    if exported.filled > 0 {
        context.progress.note(&format!(
            "{} texels lie inside of something and take the light of their neighbours",
            exported.filled
        ));
    }
    Ok(())
}

/// File that says what a folder holds the bake of.
const FINGERPRINT: &str = "fingerprint";

/// Tells outputs apart, not only what was gathered for them.
fn fingerprint(args: &BakeArgs, setup: &Setup) -> String {
    let open_ended = (args.work.time_limit, args.work.noise);
    let text = format!(
        "{:?}",
        (args.engine, args.denoise, args.work.directional, open_ended)
    );
    format!("{:016x} {text}\n", setup.fingerprint)
}

/// Whether the folder holds this bake already.
pub fn is_up_to_date(args: &BakeArgs, setup: &Setup) -> bool {
    let before = std::fs::read_to_string(args.output.join(FINGERPRINT));
    before.is_ok_and(|before| before == fingerprint(args, setup))
        && args.output.join("manifest.json").is_file()
        && args.output.join("scene.glb").is_file()
}

/// The scene with its second UV set; files that are no glTF are written from the scene itself, with the materials that it had.
fn write_scene(
    args: &BakeArgs,
    setup: &Setup,
) -> Result<Vec<occlude_scene::WrittenNode>, CliError> {
    let written = if setup.is_gltf() {
        export::write_scene(&args.output, setup.texels)
    } else {
        let scene = Scene {
            materials: setup.originals.to_vec(),
            ..setup.loaded.scene.clone()
        };
        let texels = Texels::new(&scene, setup.pose, &setup.built.atlas);
        export::write_scene(&args.output, &texels)
    };
    written.map_err(|error| failed(error, args))
}

fn failed(error: ExportError, args: &BakeArgs) -> CliError {
    match error {
        ExportError::Image(error) => error.into(),
        error => CliError::failed(error, args.output.display(), "nothing else was changed"),
    }
}
