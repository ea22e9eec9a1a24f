//! Nodes: their order, what hangs on them, skins, cameras and lights.

use super::accessor::Shape;
use super::document as json;
use super::source::Source;
use crate::motion::unit_quaternion;
use crate::{Camera, Light, LightKind, Node, Projection, RestTransform, SceneError, Skin, Warning};
use glam::{Affine3A, Mat4, Quat, Vec3};

const RE_EXPORT: &str = "export the file again";

/// The file's nodes with parents before their children.
pub(super) struct Hierarchy {
    pub nodes: Vec<Node>,
    /// The file's index of each of ours.
    pub file_index: Vec<u32>,
    /// Our index of each of the file's.
    pub ours: Vec<u32>,
    /// Whether each of our nodes belongs to the scene that is loaded.
    pub present: Vec<bool>,
}

/// How messages call a node of the file.
pub(super) fn node_place(source: &Source, index: usize) -> String {
    match source.document.nodes.get(index).map(|n| n.name.as_str()) {
        None | Some("") => format!("node {index}"),
        Some(name) => format!("node {index} ({name})"),
    }
}

impl Hierarchy {
    /// Orders all nodes and marks those of scene `scene`. Iterative: files nest as deep as they like.
    pub fn new(source: &Source, scene: Option<usize>) -> Result<Self, SceneError> {
        const NONE: u32 = u32::MAX;
        let entries = &source.document.nodes;
        let mut parent = vec![NONE; entries.len()];
        for (i, node) in entries.iter().enumerate() {
            for &child in &node.children {
                let place = node_place(source, i);
                match parent.get_mut(child as usize) {
                    None => {
                        let what = format!("its child {child} does not exist");
                        return Err(source.fault(&place, &what, RE_EXPORT));
                    }
                    Some(known) if *known != NONE => {
                        let what = format!("its child {child} has another parent already");
                        return Err(source.fault(&place, &what, RE_EXPORT));
                    }
                    Some(slot) => *slot = i as u32,
                }
            }
        }
        // Every node has at most one parent, so what no root reaches lies on a cycle or below one.
        let mut order: Vec<u32> = (0..entries.len() as u32)
            .filter(|&i| parent[i as usize] == NONE)
            .collect();
        let mut done = 0;
        while let Some(&node) = order.get(done) {
            order.extend_from_slice(&entries[node as usize].children);
            done += 1;
        }
        if order.len() < entries.len() {
            let mut reached = vec![false; entries.len()];
            order.iter().for_each(|&i| reached[i as usize] = true);
            let lost = reached.iter().position(|&r| !r).unwrap_or(0);
            return Err(source.fault(
                &node_place(source, lost),
                "it is its own ancestor",
                RE_EXPORT,
            ));
        }
        // Files that are in order already keep their own.
        let sorted = parent
            .iter()
            .enumerate()
            .all(|(i, &p)| p == NONE || (p as usize) < i);
        if sorted {
            order = (0..entries.len() as u32).collect();
        }
        let mut ours = vec![0; entries.len()];
        for (i, &file) in order.iter().enumerate() {
            ours[file as usize] = i as u32;
        }

        let mut nodes = Vec::with_capacity(entries.len());
        for &file in &order {
            let entry = &entries[file as usize];
            let parent_from_node = rest(entry).map_or_else(
                || Affine3A::from_mat4(Mat4::from_cols_array(&entry.matrix.unwrap_or_default())),
                |rest| rest.parent_from_node(),
            );
            if !parent_from_node.is_finite() {
                let place = node_place(source, file as usize);
                return Err(source.fault(&place, "its transform is not finite", RE_EXPORT));
            }
            nodes.push(Node {
                name: entry.name.clone(),
                parent: Some(parent[file as usize])
                    .filter(|&p| p != NONE)
                    .map(|p| ours[p as usize]),
                parent_from_node,
            });
        }
        let present = present(source, scene, &nodes, &ours)?;
        Ok(Self {
            nodes,
            file_index: order,
            ours,
            present,
        })
    }

    /// Our nodes of the loaded scene with the file's entry, in the file's order.
    pub fn in_file_order<'a>(
        &'a self,
        source: &'a Source,
    ) -> impl Iterator<Item = (u32, usize, &'a json::Node)> {
        let entries = source.document.nodes.iter().enumerate();
        entries.filter_map(|(file, entry)| {
            let ours = self.ours[file];
            self.present[ours as usize].then_some((ours, file, entry))
        })
    }
}

fn present(
    source: &Source,
    scene: Option<usize>,
    nodes: &[Node],
    ours: &[u32],
) -> Result<Vec<bool>, SceneError> {
    let mut present = vec![scene.is_none(); nodes.len()];
    if let Some(scene) = scene {
        for &root in &source.document.scenes[scene].nodes {
            let Some(&root) = ours.get(root as usize) else {
                let what = format!("refers to node {root}, which does not exist");
                return Err(source.fault(&format!("scene {scene}"), &what, RE_EXPORT));
            };
            present[root as usize] = true;
        }
    }
    for (i, node) in nodes.iter().enumerate() {
        present[i] |= node.parent.is_some_and(|p| present[p as usize]);
    }
    Ok(present)
}

/// A node's translation, rotation and scale; `None` if it has a matrix.
pub(super) fn rest(entry: &json::Node) -> Option<RestTransform> {
    if entry.matrix.is_some() {
        return None;
    }
    Some(RestTransform {
        node: 0,
        translation: entry.translation.map_or(Vec3::ZERO, Vec3::from),
        rotation: entry
            .rotation
            .map_or(Quat::IDENTITY, |r| unit_quaternion(r.into())),
        scale: entry.scale.map_or(Vec3::ONE, Vec3::from),
    })
}

/// Reads a skin.
pub(super) fn skin(source: &Source, index: usize, ours: &[u32]) -> Result<Skin, SceneError> {
    let entry = &source.document.skins[index];
    let place = match entry.name.as_str() {
        "" => format!("skin {index}"),
        name => format!("skin {index} ({name})"),
    };
    let mut joints = Vec::with_capacity(entry.joints.len());
    for &joint in &entry.joints {
        match ours.get(joint as usize) {
            Some(&ours) => joints.push(ours),
            None => {
                let what = format!("refers to node {joint}, which does not exist");
                return Err(source.fault(&place, &what, RE_EXPORT));
            }
        }
    }
    let mut joint_from_object = match entry.inverse_bind_matrices {
        None => vec![Mat4::IDENTITY; joints.len()],
        Some(index) => {
            let accessor = source.accessor(index, &place, &[Shape::Mat4])?;
            if accessor.count < joints.len() {
                let what = format!("{} matrices for {} joints", accessor.count, joints.len());
                return Err(source.fault(&place, &what, RE_EXPORT));
            }
            accessor.floats(|m: [f32; 16]| {
                let m = Mat4::from_cols_array(&m);
                if m.is_finite() { m } else { Mat4::IDENTITY }
            })
        }
    };
    joint_from_object.truncate(joints.len());
    Ok(Skin {
        joints,
        joint_from_object,
    })
}

/// The camera on a node.
pub(super) fn camera(
    source: &Source,
    node: u32,
    place: &str,
    entry: &json::Node,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Camera>, SceneError> {
    let Some(index) = entry.camera else {
        return Ok(None);
    };
    let Some(camera) = source.document.cameras.get(index as usize) else {
        let what = format!("refers to camera {index}, which does not exist");
        return Err(source.fault(place, &what, RE_EXPORT));
    };
    let name = if entry.name.is_empty() {
        &camera.name
    } else {
        &entry.name
    };
    let projection = match (&camera.perspective, &camera.orthographic) {
        (Some(p), _) if p.yfov > 0.0 && p.yfov < std::f32::consts::PI => {
            Projection::Perspective { yfov: p.yfov }
        }
        (None, Some(o)) if o.ymag.is_finite() && o.ymag != 0.0 => {
            Projection::Orthographic { ymag: o.ymag.abs() }
        }
        _ => {
            warnings.push(Warning::new(
                place,
                "a camera without a usable projection is ignored",
            ));
            return Ok(None);
        }
    };
    Ok(Some(Camera {
        name: name.clone(),
        node,
        projection,
    }))
}

/// The light on a node.
pub(super) fn light(
    source: &Source,
    node: u32,
    place: &str,
    entry: &json::Node,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Light>, SceneError> {
    let Some(reference) = &entry.extensions.light else {
        return Ok(None);
    };
    let lights = source
        .document
        .extensions
        .lights
        .as_ref()
        .map_or(&[][..], |l| &l.lights);
    let Some(light) = lights.get(reference.light as usize) else {
        let what = format!("refers to light {}, which does not exist", reference.light);
        return Err(source.fault(place, &what, RE_EXPORT));
    };
    let name = if entry.name.is_empty() {
        &light.name
    } else {
        &entry.name
    };
    let intensity = Vec3::from(light.color) * light.intensity;
    if !intensity.is_finite() || intensity.min_element() < 0.0 {
        warnings.push(Warning::new(
            place,
            "a light of negative or infinite intensity is ignored",
        ));
        return Ok(None);
    }
    let kind = match light.kind.as_str() {
        "directional" => LightKind::Directional {
            angular_diameter: light
                .extras
                .as_ref()
                .and_then(|extras| extras.get("angular_diameter")?.as_f64())
                .filter(|angle| (0.0..=std::f64::consts::PI).contains(angle))
                .unwrap_or(0.0) as f32,
        },
        "point" => LightKind::Point,
        "spot" => {
            let (inner, outer) = match &light.spot {
                Some(spot) => (spot.inner_cone_angle, spot.outer_cone_angle),
                None => (0.0, std::f32::consts::FRAC_PI_4),
            };
            let outer_angle = if outer > 0.0 {
                outer.min(std::f32::consts::FRAC_PI_2)
            } else {
                0.0
            };
            let inner_angle = if inner > 0.0 {
                inner.min(outer_angle)
            } else {
                0.0
            };
            LightKind::Spot {
                inner_angle,
                outer_angle,
            }
        }
        other => {
            let what = format!("a light of unknown type {other:?} is ignored");
            warnings.push(Warning::new(place, &what));
            return Ok(None);
        }
    };
    Ok(Some(Light {
        name: name.clone(),
        node,
        intensity,
        kind,
    }))
}
