//! Animation clips.

use super::accessor::Shape;
use super::document as json;
use super::hierarchy::{self, Hierarchy, node_place};
use super::source::Source;
use crate::input::Budget;
use crate::{
    Channel, Clip, Interpolation, Motion, RestTransform, RestWeights, SceneError, Target, Warning,
};
use std::collections::BTreeMap;

const RE_EXPORT: &str = "export the file again";

/// Reads all clips, and the rest state of what they move.
pub(super) fn motion(
    source: &Source,
    hierarchy: &Hierarchy,
    budget: &mut Budget,
    warnings: &mut Vec<Warning>,
) -> Result<Motion, SceneError> {
    let mut motion = Motion {
        weights: rest_weights(source, hierarchy, budget)?,
        ..Motion::default()
    };
    let mut rest: BTreeMap<u32, RestTransform> = BTreeMap::new();
    for (i, animation) in source.document.animations.iter().enumerate() {
        let place = match animation.name.as_str() {
            "" => format!("animation {i}"),
            name => format!("animation {i} ({name})"),
        };
        let mut clip = Clip {
            name: animation.name.clone(),
            ..Clip::default()
        };
        for (k, channel) in animation.channels.iter().enumerate() {
            let place = format!("{place}, channel {k}");
            let reader = Reader {
                source,
                hierarchy,
                place: &place,
            };
            match reader.channel(animation, channel, &motion.weights, budget)? {
                Found::Channel(channel) => {
                    clip.length = clip
                        .length
                        .max(channel.times.last().copied().unwrap_or(0.0));
                    if channel.target != Target::Weights {
                        let file = hierarchy.file_index[channel.node as usize] as usize;
                        if let Some(found) = hierarchy::rest(&source.document.nodes[file]) {
                            let node = channel.node;
                            rest.insert(node, RestTransform { node, ..found });
                        }
                    }
                    clip.channels.push(channel);
                }
                Found::Ignored(why) => warnings.push(Warning::new(&place, &why)),
                Found::Nothing => {}
            }
        }
        motion.clips.push(clip);
    }
    motion.rest = rest.into_values().collect();
    Ok(motion)
}

/// The weights that morph targets have before any animation.
fn rest_weights(
    source: &Source,
    hierarchy: &Hierarchy,
    budget: &mut Budget,
) -> Result<Vec<RestWeights>, SceneError> {
    let mut out = Vec::new();
    for (node, _, entry) in hierarchy.in_file_order(source) {
        let Some(mesh) = entry
            .mesh
            .and_then(|m| source.document.meshes.get(m as usize))
        else {
            continue;
        };
        let targets = mesh
            .primitives
            .iter()
            .map(|p| p.targets.len())
            .max()
            .unwrap_or(0);
        if targets == 0 {
            continue;
        }
        budget.reserve(4 * targets as u64)?;
        let mut weights = entry
            .weights
            .as_ref()
            .or(mesh.weights.as_ref())
            .cloned()
            .unwrap_or_default();
        weights.resize(targets, 0.0);
        for w in &mut weights {
            *w = if w.is_finite() { *w } else { 0.0 };
        }
        out.push(RestWeights { node, weights });
    }
    out.sort_by_key(|w| w.node);
    Ok(out)
}

enum Found {
    Channel(Channel),
    /// Reason for a warning.
    Ignored(String),
    Nothing,
}

struct Reader<'a> {
    source: &'a Source,
    hierarchy: &'a Hierarchy,
    place: &'a str,
}

impl Reader<'_> {
    fn channel(
        &self,
        animation: &json::Animation,
        channel: &json::Channel,
        rest_weights: &[RestWeights],
        budget: &mut Budget,
    ) -> Result<Found, SceneError> {
        let source = self.source;
        let fault = |what: String| Err(source.fault(self.place, &what, RE_EXPORT));
        let target = match channel.target.path.as_str() {
            "translation" => Target::Translation,
            "rotation" => Target::Rotation,
            "scale" => Target::Scale,
            "weights" => Target::Weights,
            other => return Ok(Found::Ignored(format!("animation of {other:?} is ignored"))),
        };
        let Some(file_node) = channel.target.node else {
            return Ok(Found::Ignored(
                "a channel without a node is ignored".to_string(),
            ));
        };
        let Some(&node) = self.hierarchy.ours.get(file_node as usize) else {
            return fault(format!("refers to node {file_node}, which does not exist"));
        };
        let Some(sampler) = animation.samplers.get(channel.sampler as usize) else {
            return fault(format!(
                "refers to sampler {}, which does not exist",
                channel.sampler
            ));
        };
        let width = match target {
            Target::Translation | Target::Scale => 3,
            Target::Rotation => 4,
            Target::Weights => match rest_weights.binary_search_by_key(&node, |w| w.node) {
                Ok(i) => rest_weights[i].weights.len(),
                Err(_) => return Ok(Found::Nothing),
            },
        };
        let has_matrix = source.document.nodes[file_node as usize].matrix.is_some();
        if has_matrix && target != Target::Weights {
            let what = format!(
                "{} has a matrix: it is not animated",
                node_place(source, file_node as usize)
            );
            return Ok(Found::Ignored(what));
        }
        let interpolation = match sampler.interpolation.as_str() {
            "" | "LINEAR" => Interpolation::Linear,
            "STEP" => Interpolation::Step,
            "CUBICSPLINE" => Interpolation::CubicSpline,
            other => return fault(format!("interpolation {other:?} is unknown")),
        };

        let input = source.accessor(sampler.input, self.place, &[Shape::Scalar])?;
        let shape = match width {
            3 if target != Target::Weights => Shape::Vec3,
            4 if target != Target::Weights => Shape::Vec4,
            _ => Shape::Scalar,
        };
        let output = source.accessor(sampler.output, self.place, &[shape])?;
        let parts = if interpolation == Interpolation::CubicSpline {
            3
        } else {
            1
        };
        let per_key = parts * if shape == Shape::Scalar { width } else { 1 };
        if input.count.checked_mul(per_key) != Some(output.count) {
            return fault(format!("{} keys but {} values", input.count, output.count));
        }
        if input.count == 0 {
            return Ok(Found::Nothing);
        }
        budget.reserve(4 * (input.count as u64 + (output.count * 4) as u64))?;
        let times = input.floats(|[t]: [f32; 1]| t);
        let values = match shape {
            Shape::Vec3 => output.floats(|v: [f32; 3]| v).into_flattened(),
            Shape::Vec4 => output.floats(|v: [f32; 4]| v).into_flattened(),
            _ => output.floats(|[v]: [f32; 1]| v),
        };
        if !times.iter().all(|t| t.is_finite()) || !times.is_sorted() {
            return fault("key times do not ascend".to_string());
        }
        if !values.iter().all(|v| v.is_finite()) {
            return Ok(Found::Ignored(
                "values that are not finite: the channel is ignored".to_string(),
            ));
        }
        Ok(Found::Channel(Channel {
            node,
            target,
            interpolation,
            times,
            values,
            width,
        }))
    }
}
