//! Scenes that move, in the sizes of Wang et al. 2013, Table 1: a hat that deforms on cloth in the wind, balls that roll in a dish, a man with a hat
//! who walks. No lights of their own beside a grey sky: they are made to be put under a captured one.

mod balls_in_dish;
mod hat;
mod hat_on_cloth;
mod walking_hat;

pub(super) use balls_in_dish::balls_in_dish;
pub(super) use hat_on_cloth::hat_on_cloth;
pub(super) use walking_hat::walking_hat;

use super::builder::Builder;
use super::math::{Rng, sin_cos};
use super::shape::Shape;
use crate::{Channel, Clip, Interpolation, MorphTarget, RestTransform, RestWeights, Target};
use glam::{Quat, Vec3};
use std::collections::BTreeMap;

/// Keys a second.
const RATE: f32 = 24.0;

/// Steps of a grid at a detail that triangles are proportional to.
fn steps(at_detail_1: u32, detail: f32) -> u32 {
    (at_detail_1 as f32 * detail.sqrt()).round().max(3.0) as u32
}

/// 1 at 0, falling smoothly to 0 at 1.
fn bump(x: f32) -> f32 {
    let rest = (1.0 - x * x).max(0.0);
    rest * rest
}

/// From 0 at `from` smoothly to 1 at `to`.
fn smooth(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn sin(turns: f32) -> f32 {
    sin_cos(turns).0
}

fn cos(turns: f32) -> f32 {
    sin_cos(turns).1
}

/// A turn about +X.
fn turn_x(turns: f32) -> [f32; 4] {
    let (s, c) = sin_cos(0.5 * turns);
    [s, 0.0, 0.0, c]
}

/// A turn about +Y.
fn turn_y(turns: f32) -> [f32; 4] {
    let (s, c) = sin_cos(0.5 * turns);
    [0.0, s, 0.0, c]
}

/// Smooth normals; vertices at one place share theirs.
fn normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut sums: BTreeMap<[u32; 3], Vec3> = BTreeMap::new();
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i as usize]);
        let area = (b - a).cross(c - a);
        for p in [a, b, c] {
            *sums.entry(key(p)).or_default() += area;
        }
    }
    (positions.iter())
        .map(|&p| {
            let sum = sums.get(&key(p)).copied().unwrap_or_default();
            sum.normalize_or(Vec3::Y)
        })
        .collect()
}

/// Moves the vertices of a shape; normals follow.
fn deform(shape: &mut Shape, place: impl Fn(Vec3) -> Vec3) {
    for p in &mut shape.positions {
        *p = place(*p);
    }
    shape.normals = normals(&shape.positions, &shape.triangles);
}

/// What a shape becomes with weight 1.
fn morph(shape: &Shape, place: impl Fn(Vec3) -> Vec3) -> MorphTarget {
    let moved: Vec<Vec3> = shape.positions.iter().map(|&p| place(p)).collect();
    let turned = normals(&moved, &shape.triangles);
    let minus = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| *a - *b).collect();
    MorphTarget {
        positions: minus(&moved, &shape.positions),
        normals: minus(&turned, &shape.normals),
        tangents: Vec::new(),
    }
}

/// Texture values: smooth noise that repeats with the texture.
struct Noise {
    cells: usize,
    values: Vec<f32>,
}

impl Noise {
    fn new(cells: usize, seed: u64, stream: u64) -> Self {
        let mut rng = Rng::new(seed, stream);
        let values = (0..cells * cells).map(|_| rng.unit()).collect();
        Self { cells, values }
    }

    /// In `[0, 1)`; coordinates in turns of the texture.
    fn at(&self, u: f32, v: f32) -> f32 {
        let place = |x: f32| {
            let x = x * self.cells as f32;
            let cell = x.floor();
            let t = x - cell;
            ((cell as usize) % self.cells, t * t * (3.0 - 2.0 * t))
        };
        let ((i, s), (j, t)) = (place(u), place(v));
        let value =
            |i: usize, j: usize| self.values[(j % self.cells) * self.cells + i % self.cells];
        let low = value(i, j) + (value(i + 1, j) - value(i, j)) * s;
        let high = value(i, j + 1) + (value(i + 1, j + 1) - value(i, j + 1)) * s;
        low + (high - low) * t
    }
}

/// A texel of glTF's roughness texture: G is roughness, B is metallic.
fn roughness_texel(roughness: f32) -> [u8; 3] {
    [0, (roughness.clamp(0.0, 1.0) * 255.0).round() as u8, 0]
}

impl Builder {
    /// Keys of one property of a node from 0 to `seconds`, linear between them; the clip is the scene's first.
    fn keys<const N: usize>(
        &mut self,
        node: u32,
        target: Target,
        seconds: f32,
        value: impl Fn(f32) -> [f32; N],
    ) {
        let count = (seconds * RATE).round() as u32;
        let times: Vec<f32> = (0..=count).map(|k| k as f32 / RATE).collect();
        let values = times.iter().flat_map(|&time| value(time)).collect();
        let motion = &mut self.scene.motion;
        if motion.clips.is_empty() {
            let name = self.scene.name.clone();
            motion.clips.push(Clip {
                name,
                ..Clip::default()
            });
        }
        let clip = &mut motion.clips[0];
        clip.length = clip.length.max(seconds);
        clip.channels.push(Channel {
            node,
            target,
            interpolation: Interpolation::Linear,
            times,
            values,
            width: N,
        });
        if target == Target::Weights {
            let weights = vec![0.0; N];
            motion.weights.push(RestWeights { node, weights });
            motion.weights.sort_by_key(|rest| rest.node);
        } else if motion.rest.iter().all(|rest| rest.node != node) {
            let place = self.scene.nodes[node as usize].parent_from_node;
            motion.rest.push(RestTransform {
                node,
                translation: place.translation.into(),
                rotation: Quat::IDENTITY,
                scale: Vec3::ONE,
            });
            motion.rest.sort_by_key(|rest| rest.node);
        }
    }
}
