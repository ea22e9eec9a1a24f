//! glTF 2.0: `.gltf` with its buffers and images, and `.glb`.
//!
//! Files are taken as hostile: every range is checked before it is read, nothing is allocated that a file merely claims,
//! nesting is walked without recursion, and URIs cannot leave the folder of the document. What a renderer can do without is
//! a [`Warning`]; what makes the picture wrong is a [`SceneError`].
//!
//! The whole file is held in memory while it is translated, and points and lines are not drawn.

mod accessor;
mod animation;
mod document;
mod draco;
mod geometry;
mod hierarchy;
mod images;
mod materials;
mod meshopt;
pub(crate) mod rewrite;
mod source;
mod tangents;

use crate::input::Budget;
use crate::{Contents, Instance, Material, Mesh, Pose, Scene, SceneError, Warning};
use accessor::Shape;
use glam::{Affine3A, Vec3};
use hierarchy::{Hierarchy, node_place};
use images::Textures;
use rayon::prelude::*;
use source::Source;
use std::path::Path;

const RE_EXPORT: &str = "export the file again";

/// Instances beyond this are taken for damage.
const MOST_INSTANCES: u64 = 1 << 24;

/// Extensions that this loader understands.
const SUPPORTED: [&str; 15] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Loads a `.gltf` or `.glb` file.
pub(crate) fn load(
    path: &Path,
    gltf_scene: Option<&str>,
    memory_limit: Option<u64>,
) -> Result<Scene, SceneError> {
    let mut budget = Budget::new(path, memory_limit);
    let mut source = Source::open(path, &mut budget)?;
    check_extensions(&source)?;
    source.decompress(&mut budget)?;
    let source = source;
    let chosen = choose_scene(&source, gltf_scene)?;
    let hierarchy = Hierarchy::new(&source, chosen)?;
    let mut warnings = Vec::new();

    let mut textures = Textures::new(&source);
    let plan = MeshPlan::new(&source, &hierarchy, &mut budget)?;
    let materials = plan.materials(&source, &mut textures)?;
    let (decoded, meshes) = rayon::join(
        || textures.decode(&mut budget),
        || plan.meshes(&source, &materials),
    );
    let (meshes, mesh_of, file_meshes) = meshes?.collect(&mut warnings);
    let pictures = decoded?;
    warnings.extend(pictures.warnings);

    let skins = (0..source.document.skins.len())
        .map(|i| hierarchy::skin(&source, i, &hierarchy.ours))
        .collect::<Result<Vec<_>, _>>()?;
    let mut scene = Scene {
        name: path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned(),
        path: path.to_path_buf(),
        meshes,
        skins,
        materials,
        textures: pictures.textures,
        images: pictures.images,
        sky: sky(&source, chosen, &mut warnings),
        contents: contents(&source, &hierarchy, chosen),
        ..Scene::default()
    };
    for (node, file, entry) in hierarchy.in_file_order(&source) {
        let place = node_place(&source, file);
        scene.cameras.extend(hierarchy::camera(
            &source,
            node,
            &place,
            entry,
            &mut warnings,
        )?);
        scene.lights.extend(hierarchy::light(
            &source,
            node,
            &place,
            entry,
            &mut warnings,
        )?);
        let made = instances(
            &source,
            &scene,
            node,
            &place,
            entry,
            &mesh_of,
            &mut warnings,
        )?;
        budget.reserve(made.len() as u64 * size_of::<Instance>() as u64)?;
        scene.instances.extend(made);
        if scene.instances.len() as u64 > MOST_INSTANCES {
            let what = format!("more than {MOST_INSTANCES} instances");
            return Err(source.fault(&place, &what, "merge meshes or split the scene"));
        }
    }
    scene.texel_densities = texel_densities(&source, &hierarchy, &mut warnings);
    scene.contents.file_meshes = file_meshes;
    scene.motion = animation::motion(&source, &hierarchy, &mut budget, &mut warnings)?;
    scene.contents.animations = scene
        .motion
        .clips
        .iter()
        .map(|c| (c.name.clone(), c.length))
        .collect();
    for name in &scene.contents.extensions_ignored {
        warnings.push(Warning::new("", &format!("extension {name} is ignored")));
    }
    scene.nodes = hierarchy.nodes;
    scene.warnings = warnings;
    drop_lost_instances(&mut scene);
    scene.validate()
}

fn is_supported(extension: &str) -> bool {
    SUPPORTED.contains(&extension)
}

fn check_extensions(source: &Source) -> Result<(), SceneError> {
    match source
        .document
        .extensions_required
        .iter()
        .find(|e| !is_supported(e))
    {
        None => Ok(()),
        Some(name) => {
            let cure = match name.as_str() {
                "KHR_texture_basisu" => "export textures as PNG, JPEG or WebP",
                "KHR_meshopt_compression" => {
                    "export with EXT_meshopt_compression or without compression"
                }
                _ => "export without it",
            };
            Err(SceneError::Extension {
                path: source.path.clone(),
                name: crate::error::one_line(name),
                cure: cure.to_string(),
            })
        }
    }
}

fn choose_scene(source: &Source, wanted: Option<&str>) -> Result<Option<usize>, SceneError> {
    let scenes = &source.document.scenes;
    let Some(wanted) = wanted else {
        let chosen = source.document.scene.unwrap_or(0) as usize;
        return match chosen < scenes.len() {
            true => Ok(Some(chosen)),
            // A file without scenes is a library of nodes: all of them are shown.
            false if source.document.scene.is_none() => Ok(None),
            false => {
                let what = format!("the default scene is {chosen}, there are {}", scenes.len());
                Err(source.fault("", &what, RE_EXPORT))
            }
        };
    };
    let by_name = scenes.iter().position(|s| s.name == wanted);
    let by_index = || wanted.parse().ok().filter(|&i: &usize| i < scenes.len());
    match by_name.or_else(by_index) {
        Some(chosen) => Ok(Some(chosen)),
        None => {
            let names: Vec<String> = scenes
                .iter()
                .enumerate()
                .map(|(i, s)| format!("{i} {:?}", s.name))
                .collect();
            let cure = crate::error::one_line(&format!("choose one of: {}", names.join(", ")));
            Err(source.fault("", &format!("there is no scene {wanted:?}"), &cure))
        }
    }
}

fn sky(source: &Source, scene: Option<usize>, warnings: &mut Vec<Warning>) -> Vec3 {
    let extras = scene.and_then(|s| source.document.scenes[s].extras.as_ref());
    let Some(sky) = extras.and_then(|e| e.get("sky")) else {
        return Vec3::ZERO;
    };
    match serde_json::from_value::<[f32; 3]>(sky.clone()).map(Vec3::from) {
        Ok(sky) if sky.is_finite() && sky.min_element() >= 0.0 => sky,
        _ => {
            warnings.push(Warning::new(
                "scene extras",
                "sky is not three radiances: it is ignored",
            ));
            Vec3::ZERO
        }
    }
}

/// What nodes, or else their meshes, ask for in `extras.texelsPerMetre`.
fn texel_densities(
    source: &Source,
    hierarchy: &Hierarchy,
    warnings: &mut Vec<Warning>,
) -> Vec<(u32, f32)> {
    let mut found = Vec::new();
    for (node, file, entry) in hierarchy.in_file_order(source) {
        let mesh = entry
            .mesh
            .and_then(|m| source.document.meshes.get(m as usize));
        let of =
            |extras: &Option<serde_json::Value>| extras.as_ref()?.get("texelsPerMetre").cloned();
        let Some(wanted) = of(&entry.extras).or_else(|| of(&mesh?.extras)) else {
            continue;
        };
        match wanted.as_f64().map(|d| d as f32) {
            Some(density) if density >= 0.0 && density.is_finite() => found.push((node, density)),
            _ => warnings.push(Warning::new(
                &node_place(source, file),
                "extras.texelsPerMetre is not a number of at least 0: it is ignored",
            )),
        }
    }
    found.sort_unstable_by_key(|&(node, _)| node);
    found
}

fn contents(source: &Source, hierarchy: &Hierarchy, scene: Option<usize>) -> Contents {
    let document = &source.document;
    let (used, ignored) = document
        .extensions_used
        .iter()
        .cloned()
        .partition(|e| is_supported(e));
    Contents {
        extensions_used: used,
        extensions_ignored: ignored,
        scenes: document.scenes.iter().map(|s| s.name.clone()).collect(),
        scene: scene.unwrap_or(0),
        file_nodes: hierarchy.file_index.clone(),
        generator: document.asset.generator.clone(),
        ..Contents::default()
    }
}

/// Which primitives and materials the scene uses.
struct MeshPlan {
    /// The file's mesh and primitive.
    primitives: Vec<(usize, usize)>,
    /// Our material of each of the file's; the last one is the default material.
    material_of: Vec<Option<u32>>,
}

impl MeshPlan {
    fn new(
        source: &Source,
        hierarchy: &Hierarchy,
        budget: &mut Budget,
    ) -> Result<Self, SceneError> {
        let document = &source.document;
        let mut used = vec![false; document.meshes.len()];
        for (_, file, entry) in hierarchy.in_file_order(source) {
            let Some(mesh) = entry.mesh else { continue };
            let Some(used) = used.get_mut(mesh as usize) else {
                let what = format!("refers to mesh {mesh}, which does not exist");
                return Err(source.fault(&node_place(source, file), &what, RE_EXPORT));
            };
            *used = true;
        }
        let default = document.materials.len();
        let mut material_used = vec![false; default + 1];
        let mut primitives = Vec::new();
        for (m, mesh) in document.meshes.iter().enumerate().filter(|&(m, _)| used[m]) {
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                let material = primitive.material.map_or(default, |m| m as usize);
                if material >= default && primitive.material.is_some() {
                    let what = format!("refers to material {material}, which does not exist");
                    return Err(source.fault(&mesh_place(source, m, p), &what, RE_EXPORT));
                }
                material_used[material] = true;
                budget.reserve(primitive_bytes(source, primitive))?;
                primitives.push((m, p));
            }
        }
        let mut next = 0;
        let number = |used: bool| {
            used.then(|| {
                next += 1;
                next - 1
            })
        };
        let material_of = material_used.into_iter().map(number).collect();
        Ok(Self {
            primitives,
            material_of,
        })
    }

    /// The materials that are used, in the file's order, the default one last.
    fn materials(
        &self,
        source: &Source,
        textures: &mut Textures,
    ) -> Result<Vec<Material>, SceneError> {
        let mut materials = Vec::new();
        for (i, _) in self
            .material_of
            .iter()
            .enumerate()
            .filter(|(_, ours)| ours.is_some())
        {
            materials.push(match source.document.materials.get(i) {
                Some(entry) => materials::material(entry, i, textures)?,
                None => Material::default(),
            });
        }
        Ok(materials)
    }

    fn meshes(&self, source: &Source, materials: &[Material]) -> Result<Built, SceneError> {
        let build = |&(m, p): &(usize, usize)| {
            let mesh = &source.document.meshes[m];
            let primitive = &mesh.primitives[p];
            let name = match mesh.primitives.len() {
                1 => mesh.name.clone(),
                _ => format!("{} {p}", mesh.name).trim_start().to_string(),
            };
            let file = primitive
                .material
                .map_or(self.material_of.len() - 1, |m| m as usize);
            let ours = self.material_of[file].unwrap_or(0);
            let place = mesh_place(source, m, p);
            geometry::primitive(
                source,
                primitive,
                &place,
                name,
                ours,
                &materials[ours as usize],
            )
        };
        let built: Vec<_> = self.primitives.par_iter().map(build).collect();
        let meshes = built.into_iter().collect::<Result<_, _>>()?;
        Ok(Built {
            meshes,
            of_file: self.primitives.clone(),
            file_meshes: source.document.meshes.len(),
        })
    }
}

fn mesh_place(source: &Source, mesh: usize, primitive: usize) -> String {
    let entry = &source.document.meshes[mesh];
    let name = match entry.name.as_str() {
        "" => format!("mesh {mesh}"),
        name => format!("mesh {mesh} ({name})"),
    };
    match entry.primitives.len() {
        1 => name,
        _ => format!("{name}, primitive {primitive}"),
    }
}

/// What a primitive will take in memory, at most.
fn primitive_bytes(source: &Source, primitive: &document::Primitive) -> u64 {
    let count = |accessor: &u32| {
        let claimed = source
            .document
            .accessors
            .get(*accessor as usize)
            .map_or(0, |a| a.count);
        // What is more than the file holds will be refused, unless it is compressed.
        let compressed = primitive.extensions.draco.is_some();
        if compressed {
            claimed.min(1 << 40)
        } else {
            claimed.min(source.total_bytes())
        }
    };
    let corners = match &primitive.indices {
        Some(indices) => count(indices),
        None => primitive.attributes.get("POSITION").map_or(0, count),
    };
    // Vertices that no corner names are dropped, so an array that many primitives share is not paid for by each.
    let vertices = |accessor: &u32| count(accessor).min(corners);
    let attributes = primitive.attributes.values().map(|a| 16 * vertices(a));
    let targets = primitive.targets.iter().flat_map(|t| t.values());
    let targets = targets.map(|a| 12 * vertices(a));
    let per_corner = if primitive.mode.unwrap_or(4) == 4 {
        8
    } else {
        16
    };
    attributes.chain(targets).sum::<u64>() + per_corner * corners
}

struct Built {
    meshes: Vec<(Option<Mesh>, Vec<Warning>)>,
    /// The file's mesh and primitive.
    of_file: Vec<(usize, usize)>,
    file_meshes: usize,
}

impl Built {
    /// Our meshes, those of them that each of the file's became, and the file's mesh and primitive behind each of ours.
    fn collect(self, warnings: &mut Vec<Warning>) -> (Vec<Mesh>, Vec<Vec<u32>>, Vec<[u32; 2]>) {
        let mut meshes = Vec::new();
        let mut file_meshes = Vec::new();
        let mut mesh_of = vec![Vec::new(); self.file_meshes];
        for ((mesh, found), (file, primitive)) in self.meshes.into_iter().zip(self.of_file) {
            warnings.extend(found);
            if let Some(mesh) = mesh {
                mesh_of[file].push(meshes.len() as u32);
                file_meshes.push([file as u32, primitive as u32]);
                meshes.push(mesh);
            }
        }
        (meshes, mesh_of, file_meshes)
    }
}

/// The instances that a node places.
fn instances(
    source: &Source,
    scene: &Scene,
    node: u32,
    place: &str,
    entry: &document::Node,
    mesh_of: &[Vec<u32>],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<Instance>, SceneError> {
    let Some(meshes) = entry.mesh.and_then(|m| mesh_of.get(m as usize)) else {
        return Ok(Vec::new());
    };
    if let Some(skin) = entry.skin.filter(|&s| s as usize >= scene.skins.len()) {
        let what = format!("refers to skin {skin}, which does not exist");
        return Err(source.fault(place, &what, RE_EXPORT));
    }
    let transforms = match &entry.extensions.instancing {
        None => vec![Affine3A::IDENTITY],
        Some(instancing) => instance_transforms(source, instancing, place)?,
    };
    let needed = transforms.len() as u64 * meshes.len() as u64;
    if needed > MOST_INSTANCES {
        let what = format!("{needed} instances");
        return Err(source.fault(place, &what, "merge meshes or split the scene"));
    }
    let mut out = Vec::with_capacity(needed as usize);
    for &mesh in meshes {
        let skinning = scene.meshes[mesh as usize].skinning.as_ref();
        let skin = entry.skin.filter(|_| skinning.is_some());
        if entry.skin.is_some() && skin.is_none() {
            let what = "a skin on a mesh without joints and weights is ignored";
            warnings.push(Warning::new(place, what));
        }
        if let (Some(skin), Some(skinning)) = (skin, skinning) {
            let joints = scene.skins[skin as usize].joints.len();
            let highest = skinning
                .joints
                .as_flattened()
                .iter()
                .copied()
                .max()
                .unwrap_or(0);
            if usize::from(highest) >= joints {
                let what = format!("joint {highest} is out of range, the skin has {joints}");
                return Err(source.fault(place, &what, RE_EXPORT));
            }
            let node_from_object = Affine3A::IDENTITY;
            out.push(Instance {
                mesh,
                node,
                node_from_object,
                skin: Some(skin),
            });
            continue;
        }
        let instance = |&node_from_object| Instance {
            mesh,
            node,
            node_from_object,
            skin: None,
        };
        out.extend(transforms.iter().map(instance));
    }
    Ok(out)
}

/// `EXT_mesh_gpu_instancing`: where each instance stands below its node.
fn instance_transforms(
    source: &Source,
    instancing: &document::Instancing,
    place: &str,
) -> Result<Vec<Affine3A>, SceneError> {
    let place = format!("{place}, EXT_mesh_gpu_instancing");
    let attribute = |name: &str, shape: Shape| {
        let index = instancing.attributes.get(name);
        index
            .map(|&i| source.accessor(i, &format!("{place}, {name}"), &[shape]))
            .transpose()
    };
    let translation = attribute("TRANSLATION", Shape::Vec3)?;
    let rotation = attribute("ROTATION", Shape::Vec4)?;
    let scale = attribute("SCALE", Shape::Vec3)?;
    let counts = [&translation, &rotation, &scale].map(|a| a.as_ref().map(|a| a.count));
    let Some(count) = counts.into_iter().flatten().next() else {
        return Ok(vec![Affine3A::IDENTITY]);
    };
    if counts.into_iter().flatten().any(|c| c != count) {
        return Err(source.fault(&place, "attributes differ in length", RE_EXPORT));
    }
    let vectors = |a: Option<accessor::Accessor>, default: Vec3| match a {
        Some(a) => a.floats(Vec3::from_array),
        None => vec![default; count],
    };
    let translation = vectors(translation, Vec3::ZERO);
    let scale = vectors(scale, Vec3::ONE);
    let rotation = match rotation {
        Some(a) => a.floats(|q: [f32; 4]| crate::motion::unit_quaternion(q.into())),
        None => vec![glam::Quat::IDENTITY; count],
    };
    let parts = translation.into_iter().zip(scale).zip(rotation);
    let transforms: Vec<Affine3A> = parts
        .map(|((t, s), r)| Affine3A::from_scale_rotation_translation(s, r, t))
        .collect();
    match transforms.iter().all(|t| t.is_finite()) {
        true => Ok(transforms),
        false => Err(source.fault(&place, "a transform is not finite", RE_EXPORT)),
    }
}

/// Drops instances that the product of finite transforms carries out of the range of floats.
fn drop_lost_instances(scene: &mut Scene) {
    let moving = std::mem::take(&mut scene.instances);
    let world_from_node = Pose::at(scene, 0.0).world_from_node;
    let before = moving.len();
    scene.instances = moving;
    scene.instances.retain(|instance| {
        let world = world_from_node[instance.node as usize] * instance.node_from_object;
        instance.skin.is_some() || world.is_finite()
    });
    let lost = before - scene.instances.len();
    if lost > 0 {
        let what = format!("{lost} instances whose world transform is not finite were dropped");
        scene.warnings.push(Warning::new("", &what));
    }
}
