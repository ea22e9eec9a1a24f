//! `courtyard`: four wings around a yard full of instanced foliage: small as a file, ten million triangles seen flat.

use super::builder::{Builder, glossy, lambert, metal};
use super::furniture::leaf_blade;
use super::math::{Place, Rng, sin_cos};
use super::shape::Shape;
use glam::{Affine2, Vec2, Vec3};

/// Half of the yard's side, and the wings' depth and height, metres.
const YARD: f32 = 20.0;
const DEPTH: f32 = 8.0;
const HEIGHT: f32 = 11.0;

pub(super) fn courtyard(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("courtyard");
    let mut rng = Rng::new(seed, 1);
    buildings(&mut b);
    ground(&mut b, detail, &mut rng);
    greenery(&mut b, detail, &mut rng);
    lamps(&mut b);
    b.sun(0.10, 0.13, Vec3::new(13.0, 11.4, 8.8));
    b.scene.sky = Vec3::new(0.75, 1.1, 1.7);
    b.camera(
        "gate",
        Vec3::new(-17.0, 1.7, 16.5),
        Vec3::new(4.0, 3.2, -6.0),
        62.0,
    );
    b.camera(
        "above",
        Vec3::new(-24.0, 22.0, 26.0),
        Vec3::new(2.0, 0.0, -2.0),
        50.0,
    );
    b.camera(
        "grass",
        Vec3::new(-8.5, 0.35, 9.5),
        Vec3::new(0.0, 1.2, 0.0),
        55.0,
    );
    b
}

fn buildings(b: &mut Builder) {
    let plaster = b.material(lambert("plaster", [0.72, 0.6, 0.45]));
    let stone = b.material(lambert("stone", [0.5, 0.47, 0.42]));
    let roof = b.material(lambert("roof tiles", [0.42, 0.16, 0.09]));
    let wood = b.material(glossy("painted wood", [0.12, 0.2, 0.17], 0.4));
    let room = b.material(lambert("dark room", [0.08, 0.075, 0.07]));
    let floors = 3;
    let storey = HEIGHT / floors as f32;
    // Wings along X reach over the corners; those along Z end inside of them.
    let (mut walls, mut bands, mut frames, mut roofs, mut rooms) = Default::default();
    for (side, along_x) in [(-1.0f32, true), (1.0, true), (-1.0, false), (1.0, false)] {
        let reach = if along_x { YARD + DEPTH } else { YARD + 0.3 };
        let base = if along_x { HEIGHT } else { HEIGHT - 0.02 };
        let mut holes = Vec::new();
        let bays = 9;
        for floor in 0..floors {
            for bay in 0..bays {
                let at = (bay as f32 - (bays - 1) as f32 / 2.0) * 4.2;
                let y = floor as f32 * storey;
                // A gate in the middle of each wing's ground floor, doors and windows elsewhere.
                holes.push(if floor == 0 && bay == bays / 2 {
                    ([at - 1.5, at + 1.5], [-2.0, 3.0])
                } else {
                    ([at - 0.65, at + 0.65], [y + 1.0, y + 2.9])
                });
            }
        }
        let inner = [YARD * side, YARD * side + 0.5 * side];
        let outer = [(YARD + DEPTH) * side, (YARD + DEPTH - 0.5) * side];
        for (k, [a, c]) in [inner, outer].into_iter().enumerate() {
            let (near, far) = (a.min(c), a.max(c));
            let top = base + 0.003 * k as f32;
            let (low, high) = if along_x {
                (Vec3::new(-reach, -0.2, near), Vec3::new(reach, top, far))
            } else {
                (Vec3::new(near, -0.2, -reach), Vec3::new(far, top, reach))
            };
            Shape::wall(&mut walls, low, high, along_x, &holes);
        }
        let face = |u: f32, y: f32, out: f32| {
            let w = (YARD - out) * side;
            if along_x {
                Vec3::new(u, y, w)
            } else {
                Vec3::new(w, y, u)
            }
        };
        let bar = |shape: &mut Shape, u: [f32; 2], y: [f32; 2], out: [f32; 2]| {
            let (a, c) = (face(u[0], y[0], out[0]), face(u[1], y[1], out[1]));
            shape.block(a.min(c), a.max(c), 1);
        };
        for &([from, to], [low, high]) in &holes {
            if low < 0.0 {
                continue;
            }
            bar(
                &mut bands,
                [from - 0.18, to + 0.18],
                [low - 0.14, low + 0.02],
                [-0.2, 0.16],
            );
            bar(
                &mut bands,
                [from - 0.12, to + 0.12],
                [high - 0.02, high + 0.16],
                [-0.2, 0.09],
            );
            bar(
                &mut frames,
                [from - 0.02, from + 0.06],
                [low, high],
                [-0.3, -0.2],
            );
            bar(
                &mut frames,
                [to - 0.06, to + 0.02],
                [low, high],
                [-0.3, -0.2],
            );
            let middle = (from + to) / 2.0;
            bar(
                &mut frames,
                [middle - 0.03, middle + 0.03],
                [low - 0.01, high + 0.01],
                [-0.29, -0.21],
            );
            for k in 1..4 {
                let y = low + (high - low) * k as f32 / 4.0;
                bar(
                    &mut frames,
                    [from, to],
                    [y - 0.015, y + 0.015],
                    [-0.28, -0.22],
                );
            }
            // Shutters folded open, with slats.
            for (edge, out) in [(from - 0.7, from - 0.06), (to + 0.06, to + 0.7)] {
                bar(&mut frames, [edge, edge + 0.05], [low, high], [-0.02, 0.07]);
                bar(&mut frames, [out - 0.05, out], [low, high], [-0.02, 0.07]);
                for k in 0..16 {
                    let y = low + (high - low) * (k as f32 + 0.1) / 16.0;
                    bar(
                        &mut frames,
                        [edge + 0.02, out - 0.02],
                        [y, y + 0.07],
                        [-0.01, 0.04],
                    );
                }
            }
        }
        for floor in 1..=floors {
            let y = floor as f32 * storey - 0.25;
            bar(
                &mut bands,
                [-YARD - 0.2, YARD + 0.2],
                [y, y + 0.22],
                [-0.1, 0.14],
            );
        }
        // A dark back wall behind the windows, and the roof: a prism that overhangs.
        let back = if along_x {
            (
                Vec3::new(-reach + 0.6, -0.1, 0.0),
                Vec3::new(reach - 0.6, base - 0.1, 0.0),
            )
        } else {
            (
                Vec3::new(0.0, -0.1, -YARD),
                Vec3::new(0.0, base - 0.1, YARD),
            )
        };
        let w = (YARD + 0.55 * DEPTH) * side;
        let at = |p: Vec3, d: f32| {
            if along_x {
                Vec3::new(p.x, p.y, w + d)
            } else {
                Vec3::new(w + d, p.y, p.z)
            }
        };
        let (low, high) = (at(back.0, -0.1), at(back.1, 0.1));
        // Open where the gate passes.
        Shape::wall(
            &mut rooms,
            low,
            high,
            along_x,
            &[([-1.5, 1.5], [-2.0, 3.0])],
        );
        prism(
            &mut roofs,
            side,
            along_x,
            reach + if along_x { 0.4 } else { 0.0 },
            base,
        );
    }
    b.add("walls", walls, plaster);
    b.add("stone bands", bands, stone);
    b.add("window frames and shutters", frames, wood);
    b.add("rooms", rooms, room);
    b.add("roofs", roofs, roof);
}

/// A gabled roof over one wing.
fn prism(roofs: &mut Shape, side: f32, along_x: bool, reach: f32, base: f32) {
    let (near, far) = (YARD - 0.5, YARD + DEPTH + 0.5);
    let (eaves, ridge) = (base - 0.1, base + 3.2 - if along_x { 0.0 } else { 0.05 });
    let corner = |u: f32, w: f32, y: f32| {
        if along_x {
            Vec3::new(u, y, w * side)
        } else {
            Vec3::new(w * side, y, u)
        }
    };
    let middle = (near + far) / 2.0;
    // Rows of tiles: each a little step, so that the roof is not one plane.
    let rows = 24;
    let mut profile = Vec::new();
    for k in 0..rows {
        let t = k as f32 / rows as f32;
        let y = eaves + (ridge - eaves) * t;
        profile.push((near + (middle - near) * t, y));
        profile.push((near + (middle - near) * t, y + 0.06));
    }
    profile.push((middle, ridge + 0.03));
    for k in (0..rows).rev() {
        let t = k as f32 / rows as f32;
        let y = eaves + (ridge - eaves) * t;
        profile.push((far - (far - middle) * t, y + 0.06));
        profile.push((far - (far - middle) * t, y));
    }
    let mut shape = Shape::default();
    let n = profile.len();
    for k in 0..n {
        let (a, c) = (profile[k], profile[(k + 1) % n]);
        let quad = [
            corner(-reach, a.0, a.1),
            corner(reach, a.0, a.1),
            corner(reach, c.0, c.1),
            corner(-reach, c.0, c.1),
        ];
        shape.flat_polygon(&quad);
    }
    for end in [-reach, reach] {
        // Gables: fans from the middle of the eaves.
        let foot = corner(end, middle, eaves);
        for pair in profile.windows(2) {
            let triangle = [
                foot,
                corner(end, pair[0].0, pair[0].1),
                corner(end, pair[1].0, pair[1].1),
            ];
            if end > 0.0 {
                shape.flat_polygon(&triangle);
            } else {
                shape.flat_polygon(&[triangle[0], triangle[2], triangle[1]]);
            }
        }
    }
    // The outline runs one way for all wings; two of the four come out inside out.
    let outwards = if along_x { side > 0.0 } else { side < 0.0 };
    let shape = if outwards { shape } else { shape.inverted() };
    roofs.add(&shape, &Place::HERE);
}

fn ground(b: &mut Builder, detail: f32, rng: &mut Rng) {
    let gravel = b.picture("gravel", 256, |x, y| {
        let hash =
            (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77)).wrapping_mul(0xc2b2_ae3d);
        let v = 120 + (hash >> 26) as u8;
        [v, v - 8, v - 22]
    });
    let mut sand = lambert("gravel", [1.0; 3]);
    sand.base_color_texture = Some(crate::TextureRef {
        transform: Affine2::from_scale(Vec2::splat(30.0)),
        ..gravel
    });
    let sand = b.material(sand);
    let mut plain = Shape::default();
    plain.block(Vec3::new(-90.0, -1.0, -90.0), Vec3::new(90.0, 0.0, 90.0), 1);
    b.add("ground", plain, sand);
    let soil = b.material(lambert("soil", [0.07, 0.05, 0.03]));
    let mut bed = Shape::default();
    for (x, z) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let corner = Vec3::new(3.0 * x, 0.0, 3.0 * z);
        let far = Vec3::new(15.5 * x, 0.0, 15.5 * z);
        bed.block(
            corner.min(far) - Vec3::Y * 0.1,
            corner.max(far) + Vec3::Y * 0.06,
            1,
        );
    }
    b.add("beds", bed, soil);

    // Cobbles along the walks: three stones, scattered.
    let stone = b.material(lambert("cobble", [0.34, 0.33, 0.31]));
    let cobbles: Vec<u32> = (0..3)
        .map(|k| {
            let mut shape = Shape::default();
            let half = Vec3::new(0.1 + 0.01 * k as f32, 0.06, 0.09);
            shape.rounded_box(half, 0.035, 1);
            b.mesh("cobble", shape, stone)
        })
        .collect();
    let mut places = vec![Vec::new(); cobbles.len()];
    let step = 0.24 / detail.sqrt().clamp(0.2, 3.0);
    let count = (5.0 / step) as i32;
    for along in 0..(2.0 * YARD / step) as i32 {
        for across in 0..count {
            let (u, w) = (
                along as f32 * step - YARD + 0.12,
                across as f32 * step - 2.4,
            );
            for (x, z) in [(u, w), (w, u)] {
                // The crossing is paved once.
                if x == w && u.abs() < 2.5 {
                    continue;
                }
                let scale = step / 0.24;
                let place = Place::at(x, rng.range(-0.035, -0.02) * scale, z)
                    .turned_y(rng.range(-0.03, 0.03) + 0.25 * rng.below(4) as f32)
                    .scaled(Vec3::splat(scale * rng.range(0.93, 1.08)));
                places[rng.below(3)].push(place);
            }
        }
    }
    for (mesh, places) in cobbles.into_iter().zip(places) {
        b.scatter("cobbles", &[mesh], &places);
    }
    let marble = b.material(glossy("marble", [0.74, 0.72, 0.68], 0.25));
    let water = b.material(metal("water", [0.35, 0.42, 0.45], 0.0));
    let mut fountain = Shape::default();
    let profile = [
        (0.0, 0.0),
        (2.1, 0.0),
        (2.1, 0.12),
        (1.95, 0.16),
        (1.95, 0.55),
        (2.05, 0.62),
        (1.75, 0.62),
        (1.75, 0.2),
        (0.4, 0.2),
        (0.25, 1.0),
        (0.3, 1.3),
        (1.0, 1.55),
        (1.05, 1.65),
        (0.95, 1.65),
        (0.3, 1.42),
        (0.12, 1.6),
        (0.1, 2.2),
        (0.4, 2.4),
        (0.36, 2.45),
        (0.0, 2.38),
    ];
    fountain.lathe(&profile, 96, false);
    b.add("fountain", fountain, marble);
    let mut pool = Shape::default();
    pool.lathe(&[(1.76, 0.5), (0.34, 0.5)], 96, false);
    b.add("water", pool, water);
}

fn greenery(b: &mut Builder, detail: f32, rng: &mut Rng) {
    let bark = b.material(lambert("bark", [0.16, 0.11, 0.075]));
    let leaf = b.material(glossy("tree leaf", [0.1, 0.24, 0.04], 0.5));
    let blade = b.material(glossy("grass", [0.12, 0.27, 0.035], 0.6));
    let ivy = b.material(glossy("ivy", [0.045, 0.14, 0.03], 0.45));
    let box_leaf = b.material(glossy("box", [0.05, 0.16, 0.03], 0.5));
    let petals = b.material(lambert("petals", [0.75, 0.12, 0.16]));

    let trees: Vec<Vec<u32>> = (0..4)
        .map(|_| {
            let (wood, crown) = tree(rng);
            b.model("tree", vec![(bark, wood), (leaf, crown)])
        })
        .collect();
    // A double row of trees, four squares of them.
    let rows = ((4.0 * detail.sqrt().clamp(0.5, 2.0)).round() as i32).max(1);
    let mut places = vec![Vec::new(); trees.len()];
    for (sx, sz) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        for i in 0..rows {
            for j in 0..rows {
                let at = |k: i32| 4.6 + 9.8 * (k as f32 + 0.5) / rows as f32;
                if rng.unit() < 0.25 {
                    continue;
                }
                let (x, z) = (at(i) + rng.range(-0.7, 0.7), at(j) + rng.range(-0.7, 0.7));
                let tall = rng.range(0.75, 1.15);
                let place = Place::at(sx * x, 0.0, sz * z)
                    .turned_y(rng.unit())
                    .scaled(Vec3::new(tall, tall * rng.range(0.9, 1.1), tall));
                places[rng.below(4)].push(place);
            }
        }
    }
    for (meshes, places) in trees.iter().zip(&places) {
        b.scatter("trees", meshes, places);
    }

    let tufts: Vec<u32> = (0..4)
        .map(|_| {
            let shape = tuft(rng);
            b.mesh("grass", shape, blade)
        })
        .collect();
    let mut places = vec![Vec::new(); tufts.len()];
    for _ in 0..(15_000.0 * detail) as usize {
        let mut at = || rng.range(3.15, 15.3);
        let (x, z) = (at(), at());
        let (sx, sz) = ([-1.0, 1.0][rng.below(2)], [-1.0, 1.0][rng.below(2)]);
        let place = Place::at(sx * x, 0.05, sz * z)
            .turned_y(rng.unit())
            .scaled(Vec3::splat(rng.range(0.6, 1.3)));
        places[rng.below(4)].push(place);
    }
    for (&mesh, places) in tufts.iter().zip(&places) {
        b.scatter("grass", &[mesh], places);
    }

    // Clipped hedges around the beds, and ivy that climbs the walls from random feet.
    let bushes: Vec<u32> = (0..2)
        .map(|_| {
            let shape = bush(rng, 0.3);
            b.mesh("hedge", shape, box_leaf)
        })
        .collect();
    let mut places = vec![Vec::new(); bushes.len()];
    let per_side = (42.0 * detail.sqrt()).round().max(4.0) as i32;
    for (sx, sz) in [(-1.0f32, -1.0f32), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        for k in 0..per_side {
            let t = 3.0 + 12.5 * (k as f32 + 0.5) / per_side as f32;
            for (x, z) in [(t, 3.1), (t, 15.4), (3.1, t), (15.4, t)] {
                let place = Place::at(sx * x, 0.3, sz * z)
                    .turned_y(rng.unit())
                    .scaled(Vec3::splat(rng.range(0.95, 1.1)));
                places[rng.below(2)].push(place);
            }
        }
    }
    for (&mesh, places) in bushes.iter().zip(&places) {
        b.scatter("hedges", &[mesh], places);
    }
    let ivy_mesh = b.mesh("ivy", bush(rng, 0.22), ivy);
    let mut places = Vec::new();
    for _ in 0..40 {
        let (mut u, side) = (rng.range(-18.0, 18.0), rng.below(4));
        let mut y = 0.1;
        for _ in 0..(14.0 * detail.sqrt()) as usize {
            let (x, z) = match side {
                0 => (u, -YARD + 0.05),
                1 => (u, YARD - 0.05),
                2 => (-YARD + 0.05, u),
                _ => (YARD - 0.05, u),
            };
            let flat = if side < 2 {
                Vec3::new(1.0, 1.0, 0.35)
            } else {
                Vec3::new(0.35, 1.0, 1.0)
            };
            places.push(Place::at(x, y, z).scaled(flat * rng.range(0.7, 1.4)));
            u += rng.range(-0.35, 0.35);
            y += rng.range(0.05, 0.4);
        }
    }
    b.scatter("ivy", &[ivy_mesh], &places);
    let mut flower = Shape::default();
    for k in 0..6 {
        let place = Place::at(0.0, 0.3, 0.0)
            .turned_y(k as f32 / 6.0)
            .turned_x(-0.08);
        flower.add(&leaf_blade(0.06, 3), &place);
    }
    let flower_mesh = b.mesh("flower", flower, petals);
    let places: Vec<Place> = (0..(1500.0 * detail) as usize)
        .map(|_| {
            let (x, z) = (rng.range(3.3, 15.2), rng.range(3.3, 15.2));
            let (sx, sz) = ([-1.0, 1.0][rng.below(2)], [-1.0, 1.0][rng.below(2)]);
            Place::at(sx * x, rng.range(-0.1, 0.1), sz * z).turned_y(rng.unit())
        })
        .collect();
    b.scatter("flowers", &[flower_mesh], &places);
}

/// Wood and leaves of a tree about 7 m tall.
fn tree(rng: &mut Rng) -> (Shape, Shape) {
    let (mut wood, mut crown) = (Shape::default(), Shape::default());
    let mut tips = vec![(
        Vec3::ZERO,
        Vec3::new(rng.range(-0.1, 0.1), 1.0, rng.range(-0.1, 0.1)),
        0.17f32,
        2.6f32,
        0,
    )];
    while let Some((start, direction, radius, length, level)) = tips.pop() {
        let steps = 6;
        let (mut p, mut d) = (start, direction.normalize());
        let mut path = vec![p];
        let mut radii = vec![radius];
        for k in 1..=steps {
            d = (d + rng.direction() * 0.12 + Vec3::Y * 0.05).normalize();
            p += d * (length / steps as f32);
            path.push(p);
            radii.push(radius * (1.0 - 0.5 * k as f32 / steps as f32));
        }
        wood.tube(&path, &radii, if level < 2 { 10 } else { 5 });
        if level < 4 {
            let children = if level == 0 { 5 } else { 4 };
            for k in 0..children {
                let spread = (d * 0.75 + rng.direction() * 0.8 + Vec3::Y * 0.15).normalize();
                let from = path[if k == 0 { steps } else { steps - 1 - k % 3 }];
                tips.push((from, spread, radius * 0.55, length * 0.62, level + 1));
            }
        }
        if level >= 3 {
            let leaves = if level == 4 { 8 } else { 3 };
            for _ in 0..leaves {
                let at = path[1 + rng.below(steps)] + rng.direction() * 0.05;
                let place = Place {
                    offset: at,
                    ..Place::HERE
                }
                .turned_y(rng.unit())
                .turned_x(rng.range(-0.1, 0.2));
                crown.add(&leaf_blade(rng.range(0.12, 0.22), 2), &place);
            }
        }
    }
    (wood, crown)
}

/// Blades of grass around a point.
fn tuft(rng: &mut Rng) -> Shape {
    let mut shape = Shape::default();
    for _ in 0..34 {
        let (s, c) = sin_cos(rng.unit());
        let (lean, tall) = (rng.range(0.02, 0.14), rng.range(0.1, 0.28));
        let root = Vec3::new(rng.range(-0.13, 0.13), 0.0, rng.range(-0.13, 0.13));
        let path = [
            root,
            root + Vec3::new(s * lean * 0.3, tall * 0.6, c * lean * 0.3),
            root + Vec3::new(s * lean, tall, c * lean),
        ];
        shape.tube(&path, &[0.004, 0.0032, 0.0], 3);
    }
    shape
}

/// A ball of leaves.
fn bush(rng: &mut Rng, radius: f32) -> Shape {
    let mut shape = Shape::default();
    for _ in 0..150 {
        let d = rng.direction();
        let place = Place {
            offset: d * radius * rng.range(0.75, 1.0),
            ..Place::HERE
        }
        .turned_y(rng.unit())
        .turned_x(rng.range(-0.2, 0.2));
        shape.add(&leaf_blade(rng.range(0.05, 0.09), 2), &place);
    }
    shape
}

fn lamps(b: &mut Builder) {
    let iron = b.material(metal("iron", [0.25, 0.25, 0.26], 0.5));
    let mut post = Shape::default();
    let profile = [
        (0.0, 0.0),
        (0.16, 0.0),
        (0.14, 0.3),
        (0.05, 0.4),
        (0.035, 3.2),
        (0.1, 3.3),
        (0.0, 3.3),
    ];
    post.lathe(&profile, 20, false);
    let mut hat = Shape::default();
    hat.lathe(&[(0.0, 3.72), (0.22, 3.72), (0.0, 3.95)], 20, false);
    post.add(&hat, &Place::HERE);
    for (x, z) in [(-0.14, -0.14), (0.14, -0.14), (-0.14, 0.14), (0.14, 0.14)] {
        post.tube(
            &[Vec3::new(x * 0.6, 3.28, z * 0.6), Vec3::new(x, 3.74, z)],
            &[0.008; 2],
            6,
        );
    }
    let mesh = b.mesh("lamp post", post, iron);
    for (x, z) in [
        (-2.8, -2.8),
        (2.8, -2.8),
        (-2.8, 2.8),
        (2.8, 2.8),
        (-16.2, 2.8),
        (16.2, -2.8),
    ] {
        b.put("lamp post", mesh, Place::at(x, 0.0, z));
        b.point_light("lamp", Vec3::new(x, 3.55, z), Vec3::new(9.0, 6.5, 3.8));
    }
}
