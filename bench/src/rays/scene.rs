//! The scenes as one flat soup of triangles.

use crate::common::Setting;
use glam::Vec3;
use occlude_scene::{Pose, Projection, Scene, procedural};

/// All triangles in world space, and a camera.
pub struct Soup {
    pub name: String,
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub eye: Vec3,
    pub target: Vec3,
    /// Vertical field of view, radians.
    pub yfov: f32,
}

/// Loads a scene file; the first camera looks, or one from outside if there is none.
pub fn load(setting: &Setting, name: &str) -> Result<Soup, String> {
    if name == "courtyard" {
        let scene = procedural::build(procedural::Name::Courtyard, None, 0);
        return Ok(flatten(name, &scene));
    }
    let path = setting.scenes.join(format!("{name}.glb"));
    if !path.exists() {
        return Err(format!("{} is not there", path.display()));
    }
    let scene = Scene::load(&path, None, None).map_err(|e| e.to_string())?;
    Ok(flatten(name, &scene))
}

/// Copies all instances into the world.
pub fn flatten(name: &str, scene: &Scene) -> Soup {
    let pose = Pose::at(scene, 0.0);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for (index, instance) in pose.instances.iter().enumerate() {
        let first = positions.len() as u32;
        let place = instance.world_from_object;
        let local = pose.positions(scene, index);
        positions.extend(local.iter().map(|&p| place.transform_point3(p)));
        let mesh = &scene.meshes[instance.mesh as usize];
        triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    let camera = scene
        .cameras
        .iter()
        .find_map(|camera| match camera.projection {
            Projection::Perspective { yfov } => {
                Some((pose.world_from_node[camera.node as usize], yfov))
            }
            Projection::Orthographic { .. } => None,
        });
    let (eye, target, yfov) = match camera {
        Some((place, yfov)) => {
            let eye = place.transform_point3(Vec3::ZERO);
            (eye, eye + place.transform_vector3(Vec3::NEG_Z), yfov)
        }
        None => {
            let (lower, upper) = positions
                .iter()
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, u), &p| {
                    (l.min(p), u.max(p))
                });
            let centre = (lower + upper) * 0.5;
            (
                centre + (upper - lower) * Vec3::new(0.3, 0.2, 1.0),
                centre,
                0.9,
            )
        }
    };
    Soup {
        name: name.into(),
        positions,
        triangles,
        eye,
        target,
        yfov,
    }
}
