//! `occlude inspect`: what is in a scene.

use crate::context::Context;
use crate::error::CliError;
use crate::stats::SceneCounts;
use clap::Args;
use glam::Vec3;
use occlude_scene::{LightKind, Pose, Projection, Scene, Texels};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

/// Options of `occlude inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Scene: .glb, .gltf or .obj
    pub scene: PathBuf,

    /// Scene of the file, by name or by index from 0 [default: the file's own choice]
    #[arg(long, value_name = "NAME|INDEX")]
    pub gltf_scene: Option<String>,

    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs `occlude inspect`.
pub fn run(args: &InspectArgs, context: &mut Context) -> Result<(), CliError> {
    let limit = context.common.memory;
    let scene = context.phase("load", |_| {
        Scene::load(&args.scene, args.gltf_scene.as_deref(), limit)
    })?;
    let report = context.phase("inspect", |_| Report::of(&scene));
    context.stats.scene = Some(scene.name.clone());
    context.stats.scene_counts = Some(report.counts);
    context.progress.finish();
    context.warn_all(&scene.warnings);
    if report.counts.triangles == 0 {
        context.warn(format_args!(
            "no triangles, nothing can be rendered: {}",
            args.scene.display()
        ));
    }
    let text = if args.json {
        format!("{:#}\n", report.json(&scene))
    } else {
        report.text(&scene)
    };
    let mut stdout = std::io::stdout().lock();
    stdout
        .write_all(text.as_bytes())
        .and_then(|()| stdout.flush())
        .or_else(|error| {
            if error.kind() == std::io::ErrorKind::BrokenPipe {
                Ok(())
            } else {
                Err(error)
            }
        })
        .map_err(|error| CliError::failed("cannot write", "stdout", error))
}

/// Counts triangles, instances and lights (punctual ones and emissive triangles).
pub fn counts(scene: &Scene) -> SceneCounts {
    let triangles = |mesh: u32| {
        scene
            .meshes
            .get(mesh as usize)
            .map_or(0, |m| m.triangles.len() as u64)
    };
    SceneCounts {
        triangles: scene.instances.iter().map(|i| triangles(i.mesh)).sum(),
        unique_triangles: scene.meshes.iter().map(|m| m.triangles.len() as u64).sum(),
        instances: scene.instances.len() as u64,
        lights: scene.lights.len() as u64 + emissive_triangles(scene),
    }
}

fn emissive_triangles(scene: &Scene) -> u64 {
    let shines = |mesh: &&occlude_scene::Mesh| {
        let material = scene.materials.get(mesh.material as usize);
        material.is_some_and(|material| material.emission.max_element() > 0.0)
    };
    let meshes = scene
        .instances
        .iter()
        .filter_map(|i| scene.meshes.get(i.mesh as usize));
    meshes
        .filter(shines)
        .map(|mesh| mesh.triangles.len() as u64)
        .sum()
}

struct Report {
    counts: SceneCounts,
    emissive_triangles: u64,
    bounds: Option<(Vec3, Vec3)>,
    geometry_bytes: u64,
    texture_bytes: u64,
}

impl Report {
    fn of(scene: &Scene) -> Self {
        Self {
            counts: counts(scene),
            emissive_triangles: emissive_triangles(scene),
            bounds: bounds(scene, &Pose::at(scene, 0.0)),
            geometry_bytes: geometry_bytes(scene),
            texture_bytes: scene.images.iter().map(texel_bytes).sum(),
        }
    }

    fn text(&self, scene: &Scene) -> String {
        let mut out = String::new();
        let mut row = |name: &str, value: String| {
            let _ = writeln!(out, "{name:<12} {value}");
        };
        let contents = &scene.contents;
        row("file", scene.path.display().to_string());
        if !contents.generator.is_empty() {
            row("generator", contents.generator.clone());
        }
        if contents.scenes.len() > 1 {
            let names: Vec<String> = (contents.scenes.iter().enumerate())
                .map(|(i, name)| {
                    format!(
                        "{}{i} {}",
                        if i == contents.scene { "*" } else { "" },
                        quoted(name)
                    )
                })
                .collect();
            row("scenes", names.join(", "));
        }
        row(
            "meshes",
            format!(
                "{} ({} triangles)",
                grouped(scene.meshes.len() as u64),
                grouped(self.counts.unique_triangles)
            ),
        );
        row(
            "instances",
            format!(
                "{} ({} triangles)",
                grouped(self.counts.instances),
                grouped(self.counts.triangles)
            ),
        );
        row("nodes", grouped(scene.nodes.len() as u64));
        row("materials", grouped(scene.materials.len() as u64));
        row(
            "textures",
            format!(
                "{} ({} images, {})",
                scene.textures.len(),
                scene.images.len(),
                human_bytes(self.texture_bytes)
            ),
        );
        row(
            "lights",
            format!(
                "{} punctual, {} emissive triangles",
                scene.lights.len(),
                grouped(self.emissive_triangles)
            ),
        );
        for light in &scene.lights {
            row(
                "",
                format!(
                    "{} {} {}",
                    kind(&light.kind),
                    quoted(&light.name),
                    triple(light.intensity)
                ),
            );
        }
        if scene.sky != Vec3::ZERO {
            row("sky", triple(scene.sky));
        }
        row("cameras", scene.cameras.len().to_string());
        for (index, camera) in scene.cameras.iter().enumerate() {
            let projection = match camera.projection {
                Projection::Perspective { yfov } => {
                    format!("perspective, {:.1} degrees high", yfov.to_degrees())
                }
                Projection::Orthographic { ymag } => format!("orthographic, {} m high", 2.0 * ymag),
            };
            row("", format!("{index} {} {projection}", quoted(&camera.name)));
        }
        row("animations", contents.animations.len().to_string());
        for (name, seconds) in &contents.animations {
            row("", format!("{} {seconds} s", quoted(name)));
        }
        if !contents.extensions_used.is_empty() {
            row("extensions", contents.extensions_used.join(", "));
        }
        if !contents.extensions_ignored.is_empty() {
            row("ignored", contents.extensions_ignored.join(", "));
        }
        match self.bounds {
            Some((min, max)) => row(
                "bounds",
                format!(
                    "{} to {} m, size {}",
                    triple(min),
                    triple(max),
                    triple(max - min)
                ),
            ),
            None => row("bounds", "empty".to_owned()),
        }
        row(
            "memory",
            format!(
                "{} geometry, {} textures",
                human_bytes(self.geometry_bytes),
                human_bytes(self.texture_bytes)
            ),
        );
        row("warnings", scene.warnings.len().to_string());
        out
    }

    fn json(&self, scene: &Scene) -> Value {
        let contents = &scene.contents;
        let lights: Vec<Value> = (scene.lights.iter())
            .map(|light| json!({"name": light.name, "kind": kind(&light.kind), "intensity": light.intensity.to_array()}))
            .collect();
        let cameras: Vec<Value> = (scene.cameras.iter())
            .map(|camera| match camera.projection {
                Projection::Perspective { yfov } => {
                    json!({"name": camera.name, "kind": "perspective", "yfov_degrees": yfov.to_degrees()})
                }
                Projection::Orthographic { ymag } => json!({"name": camera.name, "kind": "orthographic", "ymag": ymag}),
            })
            .collect();
        let animations: Vec<Value> = contents
            .animations
            .iter()
            .map(|(name, seconds)| json!({"name": name, "seconds": seconds}))
            .collect();
        let warnings: Vec<Value> = scene
            .warnings
            .iter()
            .map(|w| json!({"what": w.what, "where": w.place}))
            .collect();
        json!({
            "schema": 1,
            "file": scene.path.display().to_string(),
            "name": scene.name,
            "generator": contents.generator,
            "scenes": contents.scenes,
            "scene": contents.scene,
            "meshes": scene.meshes.len(),
            "triangles": self.counts.triangles,
            "unique_triangles": self.counts.unique_triangles,
            "instances": self.counts.instances,
            "nodes": scene.nodes.len(),
            "materials": scene.materials.len(),
            "textures": scene.textures.len(),
            "images": scene.images.len(),
            "lights": lights,
            "emissive_triangles": self.emissive_triangles,
            "sky": scene.sky.to_array(),
            "cameras": cameras,
            "animations": animations,
            "extensions_used": contents.extensions_used,
            "extensions_ignored": contents.extensions_ignored,
            "bounds": self.bounds.map(|(min, max)| json!({"min": min.to_array(), "max": max.to_array()})),
            "memory": {"geometry_bytes": self.geometry_bytes, "texture_bytes": self.texture_bytes},
            "warnings": warnings,
        })
    }
}

/// World-space box of everything.
pub fn bounds(scene: &Scene, pose: &Pose) -> Option<(Vec3, Vec3)> {
    let mut bounds: Option<(Vec3, Vec3)> = None;
    for (index, instance) in pose.instances.iter().enumerate() {
        for &position in pose.positions(scene, index) {
            let point = instance.world_from_object.transform_point3(position);
            let (min, max) = bounds.unwrap_or((point, point));
            bounds = Some((min.min(point), max.max(point)));
        }
    }
    bounds
}

fn geometry_bytes(scene: &Scene) -> u64 {
    let bytes = |mesh: &occlude_scene::Mesh| {
        let floats = 3 * (mesh.positions.len() + mesh.normals.len())
            + 4 * (mesh.tangents.len() + mesh.colors.len())
            + 2 * (mesh.uv0.len() + mesh.uv1.len());
        let morphs: usize = (mesh.morph_targets.iter())
            .map(|t| 3 * (t.positions.len() + t.normals.len() + t.tangents.len()))
            .sum();
        let skin = mesh
            .skinning
            .as_ref()
            .map_or(0, |s| 8 * s.joints.len() + 16 * s.weights.len());
        (4 * (floats + morphs) + skin + 12 * mesh.triangles.len()) as u64
    };
    scene.meshes.iter().map(bytes).sum()
}

fn texel_bytes(image: &occlude_scene::Image) -> u64 {
    match &image.texels {
        Texels::Rgba8(texels) => 4 * texels.len() as u64,
        Texels::Rgba16(texels) => 8 * texels.len() as u64,
    }
}

fn kind(kind: &LightKind) -> &'static str {
    match kind {
        LightKind::Directional { .. } => "directional",
        LightKind::Point => "point",
        LightKind::Spot { .. } => "spot",
    }
}

/// Names come from files: control characters and quotes are escaped.
fn quoted(name: &str) -> String {
    format!("{name:?}")
}

fn triple(v: Vec3) -> String {
    format!("({:.4}, {:.4}, {:.4})", v.x, v.y, v.z)
}

/// `1,234,567`
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `12.3 MiB`
fn human_bytes(bytes: u64) -> String {
    indicatif::HumanBytes(bytes).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped() {
        assert_eq!(
            [0, 999, 1000, 1234567].map(grouped),
            ["0", "999", "1,000", "1,234,567"]
        );
    }
}
