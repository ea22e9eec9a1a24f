//! From options and files to what is baked.

use super::args::{UnwrapName, WorkArgs};
use crate::cache::{self, Cache};
use crate::context::Context;
use crate::error::CliError;
use occlude_bake::atlas::{self, Atlas, AtlasError, AtlasSettings, Built, UnwrapKind, density};
use occlude_bake::rounds::GatherKind;
use occlude_bake::sky;
use occlude_image::Picture;
use occlude_render::light::Environment;
use occlude_scene::{Material, Pose, Scene};

/// What the files say.
pub struct Loaded {
    pub scene: Scene,
    /// The sky's picture.
    pub picture: Option<Picture>,
}

/// The sky, by who finds its light.
pub struct Sky {
    /// Rays: to be given to the lights. Never `None`, so that nothing else takes its place.
    pub asked: Option<Environment>,
    /// Bundles, and the largest channel.
    pub even: Option<(Environment, f32)>,
    /// Rays that are not aimed at lights may meet light.
    pub luminous: bool,
}

impl Loaded {
    pub fn load(work: &WorkArgs, context: &mut Context) -> Result<Self, CliError> {
        let picture = work.sky.load(context)?;
        let mut scene = Scene::load(
            &work.scene,
            work.gltf_scene.as_deref(),
            context.common.memory,
        )?;
        context.stats.scene = Some(scene.name.clone());
        context.warn_all(&scene.warnings);
        if crate::inspect::counts(&scene).triangles == 0 {
            return Err(CliError::input(
                "nothing to bake",
                work.scene.display(),
                "the scene holds no triangles: choose another with --gltf-scene or export its meshes",
            ));
        }
        work.sky.add_sun(&mut scene);
        Ok(Self { scene, picture })
    }

    /// Light maps know Lambert surfaces alone. Returns the materials as they were.
    pub fn make_lambert(&mut self) -> Vec<Material> {
        let lambert = self
            .scene
            .materials
            .iter()
            .map(Material::diffuse_only)
            .collect();
        std::mem::replace(&mut self.scene.materials, lambert)
    }

    /// Splits the sky for bundles; rays alone take it whole.
    pub fn sky(&self, work: &WorkArgs, kind: GatherKind) -> Sky {
        let shining = |material: &Material| material.unlit || material.emission != glam::Vec3::ZERO;
        let shines = self.scene.materials.iter().any(shining);
        let is_lit = |sky: &Option<Environment>| sky.as_ref().is_some_and(|sky| !sky.is_black());
        if kind == GatherKind::Path {
            let whole = work.sky.environment(self.picture.as_ref());
            let asked = Some(whole.unwrap_or_else(|| Environment::constant(self.scene.sky)));
            return Sky {
                luminous: shines || is_lit(&asked),
                asked,
                even: None,
            };
        }
        let parts = match &self.picture {
            Some(picture) => {
                let rotation = work.sky.environment_rotation.to_radians();
                sky::split(picture, rotation, work.sky.environment_scale)
            }
            None => sky::constant(self.scene.sky),
        };
        let black = || Environment::constant(glam::Vec3::ZERO);
        Sky {
            luminous: shines || is_lit(&parts.bright),
            asked: Some(parts.bright.unwrap_or_else(black)),
            even: parts.even,
        }
    }
}

/// Lays out what is baked.
pub fn atlas(
    work: &WorkArgs,
    loaded: &Loaded,
    pose: &Pose,
    context: &Context,
) -> Result<Built, CliError> {
    let scene = &loaded.scene;
    let mut densities = density::densities(scene, pose, work.texels_per_metre);
    if !work.select.is_empty() {
        let chosen = selected(work, scene)?;
        for (density, instance) in densities.iter_mut().zip(&scene.instances) {
            if !chosen[instance.node as usize] {
                *density = None;
            }
        }
    }
    let settings = AtlasSettings {
        page_size: work.pages_max,
        padding: work.padding,
        unwrap: match work.unwrap {
            UnwrapName::Projection => UnwrapKind::Projection,
            UnwrapName::Conformal => UnwrapKind::Conformal,
        },
        kept: match &work.cache {
            Some(Cache(folder)) => folder.clone(),
            None => cache::default_folder(),
        },
        use_given: true,
    };
    let built =
        atlas::build(scene, pose, &densities, &settings, &context.job).map_err(|error| {
            let help = match error {
                AtlasError::Nothing => {
                    "skinned and morphed meshes, unlit and invisible ones, and those with texelsPerMetre 0 are not baked: give it something else"
                }
                _ => "lower --texels-per-metre or raise --pages-max",
            };
            CliError::input(error, work.scene.display(), help)
        })?;
    for problem in &built.problems {
        context.warn(format_args!("{}: {}", problem.mesh, problem.what));
    }
    Ok(built)
}

/// The nodes that `--select` names, and everything below them.
fn selected(work: &WorkArgs, scene: &Scene) -> Result<Vec<bool>, CliError> {
    let mut chosen = vec![false; scene.nodes.len()];
    for wanted in &work.select {
        let mut found = false;
        for (number, node) in scene.nodes.iter().enumerate() {
            let file = scene.contents.file_nodes.get(number);
            if node.name == *wanted || file.is_some_and(|file| wanted.parse() == Ok(*file)) {
                chosen[number] = true;
                found = true;
            }
        }
        if !found {
            return Err(CliError::input(
                format_args!("no node {wanted:?}"),
                "--select",
                "see their names with occlude inspect",
            ));
        }
    }
    // Parents stand before their children.
    for number in 0..scene.nodes.len() {
        if let Some(parent) = scene.nodes[number].parent {
            chosen[number] |= chosen[parent as usize];
        }
    }
    Ok(chosen)
}

/// Name and texels of every node that has some, most first.
pub fn objects(loaded: &Loaded, atlas: &Atlas) -> Vec<(String, u64)> {
    let scene = &loaded.scene;
    let mut of_node = vec![0_u64; scene.nodes.len()];
    for (instance, placement) in scene.instances.iter().zip(&atlas.placements) {
        let Some(placement) = placement else { continue };
        let pieces = &atlas.layouts[placement.layout as usize].pieces;
        let texels = pieces
            .iter()
            .map(|size| u64::from(size.x) * u64::from(size.y));
        of_node[instance.node as usize] += texels.sum::<u64>();
    }
    let name = |node: usize| match scene.nodes[node].name.as_str() {
        "" => format!(
            "node {}",
            scene
                .contents
                .file_nodes
                .get(node)
                .copied()
                .unwrap_or(node as u32)
        ),
        name => name.to_owned(),
    };
    let mut objects: Vec<_> = (0..of_node.len())
        .filter(|&node| of_node[node] > 0)
        .map(|node| (name(node), of_node[node]))
        .collect();
    objects.sort_by_key(|(_, texels)| std::cmp::Reverse(*texels));
    objects
}
