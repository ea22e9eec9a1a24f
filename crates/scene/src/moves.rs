//! Which instances move in a sequence of pictures.

use crate::pose::{Joints, weights_of};
use crate::{Instance, Scene};
use glam::Affine3A;

/// Which of [`Scene::instances`] are not in the same place, and of the same shape, at all of these times (seconds). Takes the
/// time of posing all nodes once a time; no vertex is touched.
pub fn moving_instances(scene: &Scene, times: impl IntoIterator<Item = f32>) -> Vec<bool> {
    let mut moving = vec![false; scene.instances.len()];
    if scene.motion.clips.is_empty() {
        return moving;
    }
    let mut times = times.into_iter();
    let Some(first) = times.next() else {
        return moving;
    };
    let first = Joints::at(scene, first);
    for time in times {
        let now = Joints::at(scene, time);
        for (moving, instance) in moving.iter_mut().zip(&scene.instances) {
            *moving |= differs(scene, instance, &first, &now);
        }
    }
    moving
}

fn differs(scene: &Scene, instance: &Instance, a: &Joints, b: &Joints) -> bool {
    let node = |node: u32| {
        let bits = |joints: &Joints| bits(&joints.world_from_node[node as usize]);
        bits(a) != bits(b)
    };
    let placed = match instance.skin {
        Some(skin) => (scene.skins[skin as usize].joints.iter()).any(|&joint| node(joint)),
        None => node(instance.node),
    };
    placed || weights_of(&a.weights, instance.node) != weights_of(&b.weights, instance.node)
}

/// Equal bits make equal pictures; `==` would not see that 0 became -0.
fn bits(transform: &Affine3A) -> [u32; 12] {
    transform.to_cols_array().map(f32::to_bits)
}
