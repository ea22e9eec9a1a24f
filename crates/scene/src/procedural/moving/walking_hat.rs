//! `walking-hat`: a man with a hat walks over tiles that shine unevenly. 32,000 vertices, skinned.

use super::super::builder::{Builder, glossy, lambert};
use super::super::math::Place;
use super::super::shape::Shape;
use super::hat::hat;
use super::{Noise, cos, roughness_texel, sin, smooth, steps, turn_x, turn_y};
use crate::{Material, Skin, Skinning, Target};
use glam::{Affine3A, Mat4, Vec3, Vec4, vec3};

const SECONDS: f32 = 4.0;
/// Metres a second, and double steps a second.
const SPEED: f32 = 0.95;
const PACE: f32 = 0.85;

/// Joints: name, parent, place in the bind pose. The man faces +Z.
const JOINTS: [(&str, usize, [f32; 3]); 13] = [
    ("hips", 0, [0.0, 0.95, 0.0]),
    ("chest", 0, [0.0, 1.12, 0.0]),
    ("head", 1, [0.0, 1.54, 0.0]),
    ("left thigh", 0, [0.1, 0.92, 0.0]),
    ("left shin", 3, [0.1, 0.5, 0.0]),
    ("left foot", 4, [0.1, 0.09, 0.0]),
    ("right thigh", 0, [-0.1, 0.92, 0.0]),
    ("right shin", 6, [-0.1, 0.5, 0.0]),
    ("right foot", 7, [-0.1, 0.09, 0.0]),
    ("left arm", 1, [0.2, 1.42, 0.0]),
    ("left forearm", 9, [0.25, 1.14, 0.0]),
    ("right arm", 1, [-0.2, 1.42, 0.0]),
    ("right forearm", 11, [-0.25, 1.14, 0.0]),
];
const HIPS: usize = 0;
const CHEST: usize = 1;
const HEAD: usize = 2;

/// Vertices and the joints that move each.
#[derive(Default)]
struct Part {
    shape: Shape,
    joints: Vec<[u16; 4]>,
    weights: Vec<Vec4>,
}

impl Part {
    /// Adds vertices that a chain of joints moves: between two of them the weight changes from `bends[k] + width` down to `bends[k] - width` metres
    /// above the ground.
    fn add(&mut self, shape: &Shape, chain: &[usize], bends: &[f32], width: f32) {
        self.shape.add(shape, &Place::HERE);
        for p in &shape.positions {
            let mut joints = [0; 4];
            let mut weights = [0.0; 4];
            let mut rest = 1.0;
            for (k, &joint) in chain.iter().enumerate() {
                let passed = match bends.get(k) {
                    Some(bend) => 1.0 - smooth(bend - width, bend + width, p.y),
                    None => 0.0,
                };
                joints[k] = joint as u16;
                weights[k] = rest * (1.0 - passed);
                rest *= passed;
            }
            self.joints.push(joints);
            self.weights.push(Vec4::from_array(weights));
        }
    }

    fn rigid(&mut self, shape: &Shape, joint: usize) {
        self.add(shape, &[joint], &[], 1.0);
    }
}

pub(in super::super) fn walking_hat(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("walking-hat");
    b.scene.sky = Vec3::splat(0.6);
    let tiles = tiles(&mut b, seed);
    let mut ground = Shape::default();
    ground.rect(1, true, 0.0, [-3.0, 3.0], [-3.0, 3.0], steps(56, detail));
    b.add("ground", ground, tiles);

    let man = b.node("man", Affine3A::IDENTITY);
    let joints = skeleton(&mut b, man);
    b.scene.skins.push(Skin {
        joints: joints.to_vec(),
        joint_from_object: JOINTS
            .iter()
            .map(|(_, _, place)| Mat4::from_translation(-Vec3::from_array(*place)))
            .collect(),
    });
    let [shirt, trousers, skin] = figure(detail);
    for (name, color, part) in [
        ("shirt", [0.62, 0.6, 0.52], shirt),
        ("trousers", [0.1, 0.14, 0.26], trousers),
        ("skin", [0.6, 0.36, 0.24], skin),
    ] {
        let material = b.material(lambert(name, color));
        let mesh = b.mesh(name, part.shape, material);
        b.scene.meshes[mesh as usize].skinning = Some(Skinning {
            joints: part.joints,
            weights: part.weights,
        });
        b.place_skinned(mesh, man, 0);
    }
    let felt = b.material(lambert("felt", [0.22, 0.13, 0.07]));
    let mut worn = Shape::default();
    let hat = hat(steps(120, detail), steps(75, detail));
    worn.add(&hat, &Place::at(0.0, 0.16, 0.01).scaled(Vec3::splat(0.46)));
    let mesh = b.mesh("hat", worn, felt);
    let node = b.node_below("hat", joints[HEAD], Affine3A::IDENTITY);
    b.place_on(mesh, node);

    walk(&mut b, &joints);
    b.camera("camera", vec3(0.9, 1.5, 4.3), vec3(0.0, 0.8, 0.0), 38.0);
    b.camera("high", vec3(-2.4, 2.6, 2.6), vec3(0.0, 0.7, 0.0), 38.0);
    b
}

/// Nodes of the joints below the man's.
fn skeleton(b: &mut Builder, man: u32) -> [u32; 13] {
    let mut nodes = [man; 13];
    for (k, (name, parent, place)) in JOINTS.iter().enumerate() {
        let (above, origin) = if k == HIPS {
            (man, Vec3::ZERO)
        } else {
            (nodes[*parent], Vec3::from_array(JOINTS[*parent].2))
        };
        let offset = Vec3::from_array(*place) - origin;
        nodes[k] = b.node_below(name, above, Affine3A::from_translation(offset));
    }
    nodes
}

/// Shirt, trousers and skin in the bind pose.
fn figure(detail: f32) -> [Part; 3] {
    let [mut shirt, mut trousers, mut skin] = [(); 3].map(|()| Part::default());
    let mut torso = Shape::default();
    let outline = [
        (0.0, 0.86),
        (0.12, 0.88),
        (0.16, 0.98),
        (0.145, 1.1),
        (0.18, 1.3),
        (0.185, 1.4),
        (0.12, 1.47),
        (0.06, 1.5),
        (0.055, 1.56),
        (0.0, 1.58),
    ];
    torso.lathe(&curve(&outline, steps(49, detail)), steps(96, detail), true);
    super::deform(&mut torso, |p| vec3(1.12 * p.x, p.y, 0.68 * p.z));
    shirt.add(&torso, &[CHEST, HIPS], &[1.1], 0.1);
    for side in 0..2_usize {
        let x = if side == 0 { 1.0 } else { -1.0 };
        let (thigh, arm) = (3 + 3 * side, 9 + 2 * side);
        let leg = tube(
            &[
                (vec3(0.085 * x, 0.97, 0.0), 0.088),
                (vec3(0.1 * x, 0.8, 0.0), 0.092),
                (vec3(0.1 * x, 0.5, 0.005), 0.058),
                (vec3(0.1 * x, 0.35, -0.01), 0.058),
                (vec3(0.1 * x, 0.1, 0.0), 0.05),
                (vec3(0.1 * x, 0.065, 0.005), 0.034),
            ],
            steps(64, detail),
            steps(40, detail),
        );
        trousers.add(&leg, &[thigh, thigh + 1, thigh + 2], &[0.5, 0.1], 0.06);
        let mut foot = Shape::default();
        foot.sphere(1.0, steps(48, detail));
        let place = Place::at(0.1 * x, 0.045, 0.06).scaled(vec3(0.05, 0.045, 0.13));
        trousers.shape_rigid(&foot, place, thigh + 2);
        let sleeve = tube(
            &[
                (vec3(0.1 * x, 1.42, 0.0), 0.03),
                (vec3(0.2 * x, 1.38, 0.0), 0.055),
                (vec3(0.235 * x, 1.27, 0.0), 0.052),
                (vec3(0.25 * x, 1.14, 0.0), 0.043),
                (vec3(0.265 * x, 0.9, 0.03), 0.033),
            ],
            steps(50, detail),
            steps(32, detail),
        );
        shirt.add(&sleeve, &[CHEST, arm, arm + 1], &[1.43, 1.14], 0.05);
        let mut hand = Shape::default();
        hand.sphere(1.0, steps(40, detail));
        let place = Place::at(0.267 * x, 0.85, 0.035).scaled(vec3(0.032, 0.075, 0.048));
        skin.shape_rigid(&hand, place, arm + 1);
    }
    let mut head = Shape::default();
    head.sphere(1.0, steps(64, detail));
    let place = Place::at(0.0, 1.66, 0.01).scaled(vec3(0.088, 0.125, 0.105));
    skin.shape_rigid(&head, place, HEAD);
    [shirt, trousers, skin]
}

impl Part {
    fn shape_rigid(&mut self, shape: &Shape, place: Place, joint: usize) {
        let mut placed = Shape::default();
        placed.add(shape, &place);
        self.rigid(&placed, joint);
    }
}

/// A smooth course through points: Catmull and Rom 1974, `rows + 1` points.
fn course<const N: usize>(points: &[[f32; N]], rows: u32) -> Vec<[f32; N]> {
    let last = points.len() - 1;
    (0..=rows)
        .map(|row| {
            let x = last as f32 * row as f32 / rows as f32;
            let k = (x as usize).min(last - 1);
            let t = x - k as f32;
            let at = |i: usize| points[i.clamp(1, last + 1) - 1];
            let (a, b, c, d) = (at(k), at(k + 1), at(k + 2), at(k + 3));
            std::array::from_fn(|i| {
                let slope = (0.5 * (c[i] - a[i]), 0.5 * (d[i] - b[i]));
                let (t2, t3) = (t * t, t * t * t);
                b[i] * (2.0 * t3 - 3.0 * t2 + 1.0)
                    + slope.0 * (t3 - 2.0 * t2 + t)
                    + c[i] * (3.0 * t2 - 2.0 * t3)
                    + slope.1 * (t3 - t2)
            })
        })
        .collect()
}

/// A profile for a lathe: only its ends may lie on the axis.
fn curve(points: &[(f32, f32)], rows: u32) -> Vec<(f32, f32)> {
    let points: Vec<[f32; 2]> = points.iter().map(|&(r, y)| [r, y]).collect();
    let mut out: Vec<(f32, f32)> = (course(&points, rows).iter())
        .map(|&[r, y]| (r.max(1e-3), y))
        .collect();
    let last = out.len() - 1;
    (out[0].0, out[last].0) = (0.0, 0.0);
    out
}

/// Open at both ends, which lie in other parts.
fn tube(points: &[(Vec3, f32)], rows: u32, sides: u32) -> Shape {
    let points: Vec<[f32; 4]> = points.iter().map(|(p, r)| [p.x, p.y, p.z, *r]).collect();
    let course = course(&points, rows);
    let path: Vec<Vec3> = course.iter().map(|c| vec3(c[0], c[1], c[2])).collect();
    let radii: Vec<f32> = course.iter().map(|c| c[3]).collect();
    let mut shape = Shape::default();
    shape.tube(&path, &radii, sides);
    shape.normals = super::normals(&shape.positions, &shape.triangles);
    shape
}

/// Angles of one leg at a phase, in turns: thigh (forwards is negative), knee (backwards is positive).
fn leg(phase: f32) -> (f32, f32) {
    let swing = -0.075 * sin(phase);
    let lift = cos(phase).max(0.0);
    (swing, 0.012 + 0.15 * lift * lift)
}

fn walk(b: &mut Builder, joints: &[u32; 13]) {
    let phase = |time: f32| time * PACE;
    let length = (0.42, 0.41);
    // The lower foot stands on the ground.
    let drop = move |phase: f32| {
        let (thigh, knee) = leg(phase);
        length.0 * cos(thigh) + length.1 * cos(thigh + knee)
    };
    let origin = Vec3::from_array(JOINTS[HIPS].2);
    let hip_above_thigh = origin.y - JOINTS[3].2[1];
    let hips = joints[HIPS];
    b.keys(hips, Target::Translation, SECONDS, |time| {
        let reach = drop(phase(time)).max(drop(phase(time) + 0.5));
        let along = (time - 0.5 * SECONDS) * SPEED;
        [
            along,
            hip_above_thigh + reach + 0.09,
            0.3 * sin(time / SECONDS),
        ]
    });
    // He faces the way he goes, +X.
    b.keys(hips, Target::Rotation, SECONDS, |time| {
        turn_y(0.25 + 0.012 * sin(phase(time)))
    });
    b.keys(joints[CHEST], Target::Rotation, SECONDS, |time| {
        product(turn_y(-0.025 * sin(phase(time))), turn_x(0.008))
    });
    b.keys(joints[HEAD], Target::Rotation, SECONDS, |time| {
        turn_y(0.06 * sin(time / SECONDS * 2.0))
    });
    for side in 0..2 {
        let shift = 0.5 * side as f32;
        let at = move |time: f32| leg(phase(time) + shift);
        let thigh = 3 + 3 * side;
        b.keys(joints[thigh], Target::Rotation, SECONDS, |t| {
            turn_x(at(t).0)
        });
        b.keys(joints[thigh + 1], Target::Rotation, SECONDS, |t| {
            turn_x(at(t).1)
        });
        b.keys(joints[thigh + 2], Target::Rotation, SECONDS, |t| {
            turn_x(-0.8 * (at(t).0 + at(t).1))
        });
        let arm = 9 + 2 * side;
        b.keys(joints[arm], Target::Rotation, SECONDS, |t| {
            turn_x(0.06 * sin(phase(t) + shift))
        });
        b.keys(joints[arm + 1], Target::Rotation, SECONDS, |t| {
            turn_x(-0.05 + 0.03 * sin(phase(t) + shift))
        });
    }
}

/// The second turn first.
fn product([ax, ay, az, aw]: [f32; 4], [bx, by, bz, bw]: [f32; 4]) -> [f32; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// Tiles, polished and worn.
fn tiles(b: &mut Builder, seed: u64) -> u32 {
    const SIDE: u32 = 512;
    const TILES: u32 = 12;
    let (coarse, fine) = (Noise::new(10, seed, 1), Noise::new(64, seed, 2));
    let value = move |x: u32, y: u32| {
        let (u, v) = (x as f32 / SIDE as f32, y as f32 / SIDE as f32);
        let tile = (x * TILES / SIDE + y * TILES / SIDE) % 2;
        let inside = |x: u32| (x * TILES) % SIDE >= 2 * TILES;
        let joint = !(inside(x) && inside(y));
        (tile, joint, 0.6 * coarse.at(u, v) + 0.4 * fine.at(u, v))
    };
    let color = b.picture("tiles", SIDE, |x, y| {
        let (tile, joint, worn) = value(x, y);
        let base = match (joint, tile) {
            (true, _) => [88.0, 84.0, 78.0],
            (false, 0) => [178.0, 168.0, 150.0],
            (false, _) => [120.0, 92.0, 74.0],
        };
        base.map(|c: f32| (c * (0.85 + 0.2 * worn)) as u8)
    });
    let roughness = b.data_picture("tile roughness", SIDE, |x, y| {
        let (tile, joint, worn) = value(x, y);
        let base = match (joint, tile) {
            (true, _) => 0.75,
            (false, 0) => 0.2,
            (false, _) => 0.32,
        };
        roughness_texel(base + 0.3 * worn)
    });
    b.material(Material {
        base_color_texture: Some(color),
        metallic_roughness_texture: Some(roughness),
        double_sided: true,
        ..glossy("tiles", [1.0; 3], 1.0)
    })
}
