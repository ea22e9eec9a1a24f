//! From options and files to a world and a view.

use super::args::{Integrator, Lights, RenderArgs};
use crate::context::Context;
use crate::error::CliError;
use crate::inspect::{bounds, counts};
use crate::values::Size;
use occlude_bvh::BuildOptions;
use occlude_image::Picture;
use occlude_render::bsdf::BROAD_ROUGHNESS;
use occlude_render::camera::View;
use occlude_render::geometry::Geometry;
use occlude_render::light::{self, Environment, LightSelection};
use occlude_scene::{Pose, Scene};
use std::path::Path;

pub fn load(
    args: &RenderArgs,
    context: &mut Context,
) -> Result<(Scene, Option<Picture>), CliError> {
    let sky = args.sky.load(context)?;
    let mut scene = Scene::load(
        &args.scene,
        args.gltf_scene.as_deref(),
        context.common.memory,
    )?;
    context.stats.scene = Some(scene.name.clone());
    context.warn_all(&scene.warnings);
    if counts(&scene).triangles == 0 {
        return Err(CliError::input(
            "nothing to render",
            args.scene.display(),
            "the scene holds no triangles: choose another with --gltf-scene or export its meshes",
        ));
    }
    args.sky.add_sun(&mut scene);
    if args.diffuse_only {
        for material in &mut scene.materials {
            *material = material.diffuse_only();
        }
    }
    if args.integrator == Integrator::InstantRadiosity {
        let textured = scene.materials.iter().filter(|material| {
            let roughest = material
                .metallic_roughness_texture
                .map(|_| material.roughness);
            roughest.is_some_and(|roughness| roughness > BROAD_ROUGHNESS)
        });
        let count = textured.count();
        if count > 0 {
            context.progress.note(&format!(
                "{count} materials have textures of roughness: where it is below {BROAD_ROUGHNESS}, reflections are followed; where it is above, \
                 the shared lights shine on them"
            ));
        }
    }
    Ok((scene, sky))
}

pub fn build<'a>(
    args: &RenderArgs,
    scene: &'a Scene,
    pose: &'a Pose,
    sky: Option<&Picture>,
) -> Result<(Geometry<'a>, light::Lights), CliError> {
    let geometry = Geometry::new(scene, pose, &BuildOptions::default())
        .map_err(|error| CliError::input("cannot trace the scene", args.scene.display(), error))?;
    Ok((geometry, lights(args, scene, pose, sky)))
}

pub fn lights(
    args: &RenderArgs,
    scene: &Scene,
    pose: &Pose,
    sky: Option<&Picture>,
) -> light::Lights {
    lights_under(args, scene, pose, args.sky.environment(sky))
}

/// [`lights`] under a sky that is known.
pub fn lights_under(
    args: &RenderArgs,
    scene: &Scene,
    pose: &Pose,
    environment: Option<Environment>,
) -> light::Lights {
    let selection = match args.lights {
        Lights::Uniform => LightSelection::Uniform,
        Lights::Power => LightSelection::Power,
        Lights::Tree => LightSelection::Tree,
    };
    light::Lights::new(scene, pose, environment, selection)
}

/// The camera: asked for, the file's first, or one that frames everything.
pub fn view(args: &RenderArgs, scene: &Scene, pose: &Pose) -> Result<View, CliError> {
    let Size { width, height } = args.size;
    if let Some(look) = &args.camera_look {
        return View::look_at(look.eye, look.target, args.field_of_view(), width, height)
            .ok_or_else(|| {
                CliError::input(
                    "no such view",
                    "--camera-look",
                    "eye and target must be apart and not too far from the origin",
                )
            });
    }
    let index = match &args.camera {
        Some(wanted) => Some(find_camera(wanted, scene, &args.scene)?),
        None => (!scene.cameras.is_empty()).then_some(0),
    };
    match (index, bounds(scene, pose)) {
        (Some(index), _) => Ok(View::of_camera(scene, pose, index, width, height)),
        (None, Some((min, max))) => Ok(View::framing(min, max, width, height)),
        (None, None) => Err(CliError::input(
            "nothing to look at",
            args.scene.display(),
            "the scene is empty",
        )),
    }
}

fn find_camera(wanted: &str, scene: &Scene, path: &Path) -> Result<usize, CliError> {
    let named = |camera: &occlude_scene::Camera| {
        let node = scene
            .nodes
            .get(camera.node as usize)
            .map(|node| node.name.as_str());
        camera.name == wanted || node == Some(wanted)
    };
    let by_index = || {
        wanted
            .parse()
            .ok()
            .filter(|&index: &usize| index < scene.cameras.len())
    };
    scene
        .cameras
        .iter()
        .position(named)
        .or_else(by_index)
        .ok_or_else(|| {
            let names: Vec<String> = scene
                .cameras
                .iter()
                .take(8)
                .enumerate()
                .map(|(i, c)| format!("{i} {:?}", c.name))
                .collect();
            let cure = if names.is_empty() {
                "the file has none: use --camera-look".to_owned()
            } else {
                format!("the file has {}", names.join(", "))
            };
            CliError::input(format_args!("no camera {wanted:?}"), path.display(), cure)
        })
}
