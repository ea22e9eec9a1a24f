//! Reads Wavefront OBJ with MTL materials.
//!
//! One mesh for each object or group and material. Faces without normals shade flat, smoothing groups or not. Polygons
//! are fanned if convex, clipped ear by ear if not. Vertex colours (`v x y z r g b`) are linear. Bump maps become normal
//! maps at load. Triangles that coincide with an earlier one of their mesh are dropped. What makes no sense is left out,
//! counted and reported; nothing is read outside of the file's folder.
//!
//! Not read: free-form curves and surfaces, lines, points, reflection maps, displacement. There are no cameras and no
//! lights in OBJ; emission comes from `Ke` and leaves the front alone.

mod geometry;
mod maps;
mod mtl;
mod polygon;
mod surface;
mod text;

use crate::input::{Budget, leaves_folder, read_file};
use crate::{Instance, Material, Node, Scene, SceneError, Warning};
use geometry::{Geometry, is_closed};
use glam::Affine3A;
use maps::Maps;
use mtl::{Entry, Library};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Loads an OBJ file and the MTL files and pictures that it names.
pub(crate) fn load(path: &Path, memory_limit: Option<u64>) -> Result<Scene, SceneError> {
    let mut budget = Budget::new(path, memory_limit);
    let bytes = read_file(path, &mut budget)?;
    let mut warn = Counted::default();
    let geometry = geometry::parse(&bytes, &mut warn, &mut budget)?;
    drop(bytes);
    let file = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let mut scene = Scene {
        name: file.clone(),
        path: path.to_path_buf(),
        ..Scene::default()
    };
    warn.report(&file, &mut scene.warnings);
    let library = libraries(&geometry, path, &mut budget, &mut scene.warnings)?;
    assemble(geometry, &library, path, &mut budget, &mut scene)?;
    Ok(scene)
}

/// Reads every material file that there is.
fn libraries(
    geometry: &Geometry,
    path: &Path,
    budget: &mut Budget,
    warnings: &mut Vec<Warning>,
) -> Result<Library, SceneError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut library = Library::default();
    let mut seen = Vec::new();
    for statement in &geometry.libraries {
        // One name that may contain spaces, or several names.
        let whole = beside(folder, statement).is_ok_and(|p| p.is_file());
        let names: Vec<&str> = if whole {
            vec![statement]
        } else {
            statement.split_whitespace().collect()
        };
        for name in names {
            if seen.contains(&name) {
                continue;
            }
            seen.push(name);
            match read_beside(folder, name, budget)? {
                Ok(bytes) => {
                    let mut warn = Counted::default();
                    library.read(&bytes, &mut warn);
                    warn.report(name, warnings);
                }
                Err(why) => warnings.push(warning(name, &format!("material file ignored: {why}"))),
            }
        }
    }
    Ok(library)
}

/// Puts materials, meshes and instances into the scene.
fn assemble(
    geometry: Geometry,
    library: &Library,
    path: &Path,
    budget: &mut Budget,
    scene: &mut Scene,
) -> Result<(), SceneError> {
    let parts: Vec<_> = geometry
        .parts
        .into_iter()
        .filter(|p| !p.mesh.triangles.is_empty())
        .collect();
    // Glass refracts where everything made of it is closed.
    let mut closed: BTreeMap<Option<&str>, bool> = BTreeMap::new();
    for part in &parts {
        let all = closed.entry(part.material.as_deref()).or_insert(true);
        *all = *all && is_closed(&part.mesh);
    }
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    let mut maps = Maps::new(&folder, budget);
    let mut material_of: BTreeMap<Option<&str>, u32> = BTreeMap::new();
    for name in &library.names {
        let key = Some(name.as_str());
        let closed = closed.get(&key).copied().unwrap_or(false);
        let entry = &library.entries[name];
        material_of.insert(key, scene.materials.len() as u32);
        scene
            .materials
            .push(surface::material(name, entry, closed, &mut maps)?);
    }
    let mut node_of: BTreeMap<String, u32> = BTreeMap::new();
    for part in &parts {
        let key = part.material.as_deref();
        if let std::collections::btree_map::Entry::Vacant(vacant) = material_of.entry(key) {
            if let Some(name) = key {
                let what = format!("material {name} is not defined, grey is used");
                maps.warnings.push(warning("", &what));
            }
            vacant.insert(scene.materials.len() as u32);
            let name = key.unwrap_or_default();
            scene.materials.push(surface::material(
                name,
                &Entry::default(),
                false,
                &mut maps,
            )?);
        }
    }
    let materials: Vec<u32> = parts
        .iter()
        .map(|p| material_of[&p.material.as_deref()])
        .collect();
    for (part, material) in parts.into_iter().zip(materials) {
        let node = *node_of
            .entry(part.object.clone())
            .or_insert_with_key(|name| {
                scene.nodes.push(Node {
                    name: name.clone(),
                    parent: None,
                    parent_from_node: Affine3A::IDENTITY,
                });
                scene.nodes.len() as u32 - 1
            });
        let name = match (part.object.as_str(), part.material.as_deref()) {
            ("", material) => material.unwrap_or_default().to_owned(),
            (object, _) => object.to_owned(),
        };
        let mut mesh = part.into_mesh();
        mesh.name = name;
        mesh.material = material;
        let mesh_index = scene.meshes.len() as u32;
        scene.meshes.push(mesh);
        scene.instances.push(Instance {
            mesh: mesh_index,
            node,
            node_from_object: Affine3A::IDENTITY,
            skin: None,
        });
    }
    scene.images = maps.images;
    scene.textures = maps.textures;
    scene.warnings.extend(maps.warnings);
    without_uv(scene);
    Ok(())
}

/// Textures on a mesh without coordinates: say so once for each material.
fn without_uv(scene: &mut Scene) {
    let textured = |m: &Material| m.base_color_texture.or(m.emission_texture).is_some();
    let mut named = Vec::new();
    for mesh in scene.meshes.iter().filter(|m| m.uv0.is_empty()) {
        let material = &scene.materials[mesh.material as usize];
        if textured(material) && !named.contains(&mesh.material) {
            named.push(mesh.material);
            let what = format!(
                "material {} has textures, but the mesh no texture coordinates",
                material.name
            );
            scene.warnings.push(warning(&mesh.name, &what));
        }
    }
}

/// The bytes of a file named in another, or why there are none; an error only where the memory limit ends the whole load.
fn read_beside(
    folder: &Path,
    name: &str,
    budget: &mut Budget,
) -> Result<Result<Vec<u8>, String>, SceneError> {
    match beside(folder, name).map(|file| read_file(&file, budget)) {
        Ok(Ok(bytes)) => Ok(Ok(bytes)),
        Ok(Err(SceneError::Read { source, .. })) => Ok(Err(source.to_string())),
        Ok(Err(other)) => Err(other),
        Err(why) => Ok(Err(why)),
    }
}

/// The path of a file named in another, which must lie in the same folder or below. Absolute names, as exporters on other
/// machines leave them, are looked up by their last part.
fn beside(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let name = name.replace('\\', "/");
    if name.is_empty() || name.contains('\0') {
        return Err("not a file name".into());
    }
    if name.starts_with('/') || name.get(1..3) == Some(":/") {
        return beside(folder, name.rsplit('/').next().unwrap_or_default());
    }
    if leaves_folder(&name) {
        return Err("outside of the folder of the scene".into());
    }
    Ok(folder.join(name))
}

/// A warning fit for one line, whatever the file says.
fn warning(place: &str, what: &str) -> Warning {
    let line = |text: &str| {
        text.chars()
            .take(160)
            .map(|c| if c.is_control() { ' ' } else { c })
            .collect::<String>()
    };
    Warning {
        place: line(place),
        what: line(what),
    }
}

/// Complaints, each kind once with its count and first line.
#[derive(Default)]
struct Counted {
    /// Kinds in order of appearance: text, count, first line.
    kinds: Vec<(String, u64, usize)>,
}

impl Counted {
    fn add(&mut self, what: &str, line: usize) {
        // Kinds are few, but some name a keyword of the file: beyond a few dozen they are one kind.
        const MOST: usize = 40;
        let what = if self.kinds.len() < MOST {
            what
        } else {
            "more of this sort, ignored"
        };
        match self.kinds.iter_mut().find(|kind| kind.0 == what) {
            Some(kind) => kind.1 += 1,
            None => self.kinds.push((what.to_owned(), 1, line)),
        }
    }

    fn report(self, file: &str, warnings: &mut Vec<Warning>) {
        for (what, count, line) in self.kinds {
            let what = if count == 1 {
                format!("{what} (line {line})")
            } else {
                format!("{what} ({count} times, first in line {line})")
            };
            warnings.push(warning(file, &what));
        }
    }
}

#[cfg(test)]
mod tests;
