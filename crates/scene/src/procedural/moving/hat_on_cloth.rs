//! `hat-on-cloth`: a hat that deforms on a piece of cloth in the wind; both shine unevenly. 21,000 vertices.

use super::super::builder::{Builder, glossy};
use super::super::shape::Shape;
use super::hat::{brim, hat, three_fold, two_fold};
use super::{Noise, bump, cos, deform, morph, roughness_texel, sin, steps};
use crate::{Material, Target};
use glam::{Affine3A, Vec3, vec3};

const SECONDS: f32 = 4.0;
/// Half of the cloth's side, metres.
const HALF: f32 = 1.1;
/// How far the brim bends down with weight 1.
const FLAP: f32 = 0.12;

pub(in super::super) fn hat_on_cloth(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("hat-on-cloth");
    b.scene.sky = Vec3::splat(0.6);
    let cloth_material = cloth_material(&mut b, seed);
    let leather = leather(&mut b, seed);

    let mut cloth = Shape::default();
    let cells = steps(108, detail);
    cloth.rect(1, true, 0.0, [-HALF, HALF], [-HALF, HALF], cells);
    deform(&mut cloth, |p| {
        let folds = 0.05 * sin(1.1 * p.x + 0.5 * p.z) + 0.035 * sin(1.7 * p.z - 0.6 * p.x + 0.2);
        p + Vec3::Y * folds * loose(p)
    });
    let wave = |turns: fn(Vec3) -> f32, amplitude: f32| {
        move |p: Vec3| p + Vec3::Y * amplitude * sin(turns(p)) * loose(p)
    };
    let targets = vec![
        morph(&cloth, wave(|p| 0.9 * p.x - 0.3 * p.z, 0.06)),
        morph(&cloth, wave(|p| 0.9 * p.x - 0.3 * p.z + 0.25, 0.06)),
        morph(&cloth, wave(|p| 1.3 * p.z + 0.8 * p.x, 0.03)),
        morph(&cloth, wave(|p| 1.3 * p.z + 0.8 * p.x + 0.25, 0.03)),
    ];
    let mesh = b.mesh("cloth", cloth, cloth_material);
    b.scene.meshes[mesh as usize].morph_targets = targets;
    let node = b.node("cloth", Affine3A::IDENTITY);
    b.place_on(mesh, node);
    // Two waves that travel: each a pair of standing ones.
    b.keys(node, Target::Weights, SECONDS, |time| {
        let (slow, fast) = (time / 2.0, time);
        [cos(slow), -sin(slow), cos(fast), -sin(fast)]
    });

    let shape = hat(steps(120, detail), steps(75, detail));
    let targets = vec![
        morph(&shape, |p| p + Vec3::Y * FLAP * brim(p) * two_fold(p)),
        morph(&shape, |p| p + Vec3::Y * 0.07 * brim(p) * three_fold(p)),
        morph(&shape, |p| {
            let wide = 1.0 + 0.5 * bump((p.y - 0.17) / 0.2) * bump(brim(p));
            vec3(p.x * wide, p.y * 0.72, p.z * wide)
        }),
        morph(&shape, |p| {
            p + vec3(0.9, 0.0, 0.4) * p.y.max(0.0) * p.y.max(0.0)
        }),
    ];
    let mesh = b.mesh("hat", shape, leather);
    b.scene.meshes[mesh as usize].morph_targets = targets;
    let node = b.node("hat", Affine3A::IDENTITY);
    b.place_on(mesh, node);
    let flap = |time: f32| 0.5 - 0.5 * cos(time / SECONDS);
    let ripple = |time: f32| 0.8 * sin(time / SECONDS) * sin(time / SECONDS * 2.0);
    b.keys(node, Target::Weights, SECONDS, |time| {
        let squash = bump((time - 0.75 * SECONDS) / 0.8);
        [
            flap(time),
            ripple(time),
            squash,
            0.6 * sin(time / SECONDS * 2.0),
        ]
    });
    // It stands on what it bends down.
    b.keys(node, Target::Translation, SECONDS, |time| {
        let lowest = 0.06 + FLAP * flap(time) + 0.05 * ripple(time).abs();
        [0.0, 0.02 + lowest, 0.0]
    });

    b.camera("camera", vec3(0.7, 1.35, 1.9), vec3(0.0, 0.1, 0.05), 40.0);
    b.camera("low", vec3(-1.6, 0.45, 1.2), vec3(0.0, 0.15, 0.0), 38.0);
    b
}

/// How far the wind lifts the cloth: not under the hat.
fn loose(p: Vec3) -> f32 {
    let radius = (p.x * p.x + p.z * p.z).sqrt();
    1.0 - bump(radius / 0.95)
}

/// Satin with a woven pattern: the threads of the pattern are matt.
fn cloth_material(b: &mut Builder, seed: u64) -> u32 {
    const SIDE: u32 = 256;
    let noise = Noise::new(24, seed, 1);
    let pattern = move |x: u32, y: u32| {
        let (u, v) = (x as f32 / SIDE as f32, y as f32 / SIDE as f32);
        let diamonds = sin(5.0 * u + 5.0 * v) * sin(5.0 * u - 5.0 * v);
        (diamonds > 0.12, noise.at(u, v))
    };
    let color = b.picture("cloth", SIDE, |x, y| {
        let (motif, noise) = pattern(x, y);
        let base = if motif {
            [170.0, 42.0, 38.0]
        } else {
            [196.0, 178.0, 140.0]
        };
        base.map(|c: f32| (c * (0.85 + 0.15 * noise)) as u8)
    });
    let roughness = b.data_picture("cloth roughness", SIDE, |x, y| {
        let (motif, noise) = pattern(x, y);
        roughness_texel(if motif { 0.28 } else { 0.55 } + 0.12 * noise)
    });
    b.material(Material {
        base_color_texture: Some(color),
        metallic_roughness_texture: Some(roughness),
        double_sided: true,
        ..glossy("cloth", [1.0; 3], 1.0)
    })
}

/// Worn leather.
fn leather(b: &mut Builder, seed: u64) -> u32 {
    const SIDE: u32 = 256;
    let (coarse, fine) = (Noise::new(9, seed, 2), Noise::new(48, seed, 3));
    let worn = move |x: u32, y: u32| {
        let (u, v) = (x as f32 / SIDE as f32, y as f32 / SIDE as f32);
        (0.65 * coarse.at(u, v) + 0.35 * fine.at(u, v)).clamp(0.0, 1.0)
    };
    let color = b.picture("leather", SIDE, |x, y| {
        let worn = worn(x, y);
        [92.0 + 60.0 * worn, 54.0 + 42.0 * worn, 28.0 + 26.0 * worn].map(|c| c as u8)
    });
    let roughness = b.data_picture("leather roughness", SIDE, |x, y| {
        roughness_texel(0.25 + 0.45 * worn(x, y))
    });
    b.material(Material {
        base_color_texture: Some(color),
        metallic_roughness_texture: Some(roughness),
        ..glossy("leather", [1.0; 3], 1.0)
    })
}
