//! Clips: keys of nodes and of morph weights.

use super::buffer::Buffers;
use super::node::Morphing;
use crate::{Channel, Clip, Interpolation, Scene, Target};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// All clips that move something.
pub(super) fn write<'a>(
    scene: &'a Scene,
    morphing: &Morphing,
    buffers: &mut Buffers<'a>,
) -> Vec<Value> {
    // Channels often share their times.
    let mut times: BTreeMap<Vec<u32>, usize> = BTreeMap::new();
    (scene.motion.clips.iter())
        .filter_map(|clip| write_clip(clip, morphing, buffers, &mut times))
        .collect()
}

fn write_clip<'a>(
    clip: &'a Clip,
    morphing: &Morphing,
    buffers: &mut Buffers<'a>,
    times: &mut BTreeMap<Vec<u32>, usize>,
) -> Option<Value> {
    let mut samplers = Vec::new();
    let mut channels = Vec::new();
    for channel in &clip.channels {
        let bits: Vec<u32> = channel.times.iter().map(|t| t.to_bits()).collect();
        let mut add = |node: usize, path: &str, kind: &str, width: usize, values: Vec<f32>| {
            let input = *times
                .entry(bits.clone())
                .or_insert_with(|| buffers.times(&channel.times));
            let output = buffers.floats(values, kind, width);
            let interpolation = match channel.interpolation {
                Interpolation::Step => "STEP",
                Interpolation::Linear => "LINEAR",
                Interpolation::CubicSpline => "CUBICSPLINE",
            };
            let sampler = json!({"input": input, "output": output, "interpolation": interpolation});
            let target = json!({"node": node, "path": path});
            channels.push(json!({"sampler": samplers.len(), "target": target}));
            samplers.push(sampler);
        };
        let node = channel.node as usize;
        match channel.target {
            Target::Translation => add(node, "translation", "VEC3", 3, channel.values.clone()),
            Target::Rotation => add(node, "rotation", "VEC4", 4, channel.values.clone()),
            Target::Scale => add(node, "scale", "VEC3", 3, channel.values.clone()),
            Target::Weights => {
                for &(node, count) in morphing.get(&channel.node).into_iter().flatten() {
                    add(node, "weights", "SCALAR", 1, weights(channel, count));
                }
            }
        }
    }
    if channels.is_empty() {
        return None;
    }
    let mut json = json!({"samplers": samplers, "channels": channels});
    if !clip.name.is_empty() {
        json["name"] = clip.name.as_str().into();
    }
    Some(json)
}

/// The first `count` weights of each key: meshes under one node may have fewer targets than the node has weights.
fn weights(channel: &Channel, count: usize) -> Vec<f32> {
    (channel.values.chunks_exact(channel.width))
        .flat_map(|key| (0..count).map(|i| key.get(i).copied().unwrap_or(0.0)))
        .collect()
}
