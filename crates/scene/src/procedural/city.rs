//! `city`: 4.9 km of town with wildly uneven detail: a triangle of the plain is kilometres long, one of the statue on
//! the square a few millimetres. Nothing is instanced.

use super::builder::{Builder, glossy, lambert, metal};
use super::math::{Place, Rng, sin_cos};
use super::shape::Shape;
use glam::{Vec3, vec3};

/// Blocks along a side, and the metres from one to the next; streets take 16 of them.
const BLOCKS: i32 = 49;
const PITCH: f32 = 100.0;
const STREET: f32 = 16.0;

/// Everything of one material; flat, so corners are shared and there are no normals.
#[derive(Default)]
struct Solids(Shape);

impl Solids {
    /// A box, turned about +Y around its own middle.
    fn block(&mut self, low: Vec3, high: Vec3, turns: f32) {
        let first = self.corners(low, high, turns);
        for [a, b, c, d] in [
            [0, 4, 6, 2],
            [1, 3, 7, 5],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 2, 3, 1],
            [4, 5, 7, 6],
        ] {
            self.face(first, [a, b, c, d]);
        }
    }

    /// A gabled roof on a box's top, ridge along X.
    fn gable(&mut self, low: Vec3, high: Vec3, turns: f32) {
        let first = self.corners(low, high, turns);
        let lift = |shape: &mut Shape, to: u32, a: u32, b: u32| {
            let middle = (shape.positions[(first + a) as usize]
                + shape.positions[(first + b) as usize])
                / 2.0;
            shape.positions[(first + to) as usize] = middle;
        };
        // The two upper corners of each gable meet at its ridge: 2 and 6 on the left, 3 and 7 on the right.
        lift(&mut self.0, 2, 2, 6);
        lift(&mut self.0, 3, 3, 7);
        self.0.positions.truncate(first as usize + 6);
        for t in [[0, 4, 2], [1, 3, 5]] {
            self.0.triangles.push(t.map(|i: u32| first + i));
        }
        self.face(first, [0, 1, 5, 4]);
        self.face(first, [0, 2, 3, 1]);
        self.face(first, [4, 5, 3, 2]);
    }

    /// Corner `x + 2 y + 4 z`.
    fn corners(&mut self, low: Vec3, high: Vec3, turns: f32) -> u32 {
        let first = self.0.positions.len() as u32;
        let middle = (low + high) / 2.0;
        let (s, c) = if turns == 0.0 {
            (0.0, 1.0)
        } else {
            sin_cos(turns)
        };
        for k in 0..8 {
            let pick = |bit: u32, a: f32, b: f32| if k & bit == 0 { a } else { b };
            let (x, z) = (
                pick(1, low.x, high.x) - middle.x,
                pick(4, low.z, high.z) - middle.z,
            );
            self.0.positions.push(vec3(
                middle.x + c * x + s * z,
                pick(2, low.y, high.y),
                middle.z + c * z - s * x,
            ));
        }
        first
    }

    fn face(&mut self, first: u32, [a, b, c, d]: [u32; 4]) {
        let at = |i| first + i;
        self.0
            .triangles
            .extend([[at(a), at(b), at(c)], [at(a), at(c), at(d)]]);
    }

    /// A cone on `y`, closed below.
    fn cone(&mut self, foot: Vec3, radius: f32, height: f32, sides: u32) {
        let first = self.0.positions.len() as u32;
        self.0.positions.extend([foot + Vec3::Y * height, foot]);
        for i in 0..sides {
            let (s, c) = sin_cos(i as f32 / sides as f32);
            self.0
                .positions
                .push(foot + vec3(radius * s, 0.0, radius * c));
        }
        for i in 0..sides {
            let (a, b) = (first + 2 + i, first + 2 + (i + 1) % sides);
            self.0.triangles.extend([[a, b, first], [b, a, first + 1]]);
        }
    }
}

#[derive(Default)]
struct Town {
    concrete: Solids,
    brick: Solids,
    sand: Solids,
    glass: Solids,
    trim: Solids,
    roof: Solids,
    asphalt: Solids,
    leaf: Solids,
    paint: Solids,
}

pub(super) fn city(detail: f32, seed: u64) -> Builder {
    let mut town = Town::default();
    // As many windows as detail asks for; where there are too few triangles for all, small things go first.
    let fine = 0.64 * detail.sqrt();
    let share = detail.min(1.0);
    for i in 0..BLOCKS {
        for j in 0..BLOCKS {
            let mut rng = Rng::new(seed, (i * BLOCKS + j + 1) as u64);
            let at = |k: i32| (k as f32 - (BLOCKS - 1) as f32 / 2.0) * PITCH;
            let (x, z) = (at(i), at(j));
            let far = (x * x + z * z).sqrt();
            let centre = i == BLOCKS / 2 && j == BLOCKS / 2;
            let half = (PITCH - STREET) / 2.0;
            let kerb = if far < 1300.0 { 0.15 } else { 0.1 };
            town.sand.block(
                vec3(x - half, -0.5, z - half),
                vec3(x + half, kerb, z + half),
                0.0,
            );
            if !centre {
                match far {
                    _ if rng.unit() < 0.03 => park(&mut town, &mut rng, x, z, half, share),
                    ..560.0 => towers(&mut town, &mut rng, x, z, half, far, fine),
                    ..1300.0 => perimeter(&mut town, &mut rng, x, z, half, far, fine),
                    _ => houses(&mut town, &mut rng, x, z, half, share),
                }
            }
            street(&mut town, &mut rng, x, z, far, share);
        }
    }
    let mut b = Builder::new("city");
    let Town {
        concrete,
        brick,
        sand,
        glass,
        trim,
        roof,
        asphalt,
        leaf,
        paint,
    } = town;
    for (name, solids, material) in [
        (
            "concrete",
            concrete,
            lambert("concrete", [0.48, 0.47, 0.45]),
        ),
        ("brick", brick, lambert("brick", [0.4, 0.19, 0.12])),
        ("pavement", sand, lambert("pavement", [0.42, 0.4, 0.37])),
        (
            "windows",
            glass,
            glossy("window glass", [0.06, 0.08, 0.1], 0.05),
        ),
        ("trim", trim, lambert("trim", [0.68, 0.65, 0.6])),
        ("roofs", roof, lambert("roof", [0.3, 0.13, 0.09])),
        ("asphalt", asphalt, lambert("asphalt", [0.09, 0.09, 0.095])),
        ("trees", leaf, lambert("tree", [0.07, 0.16, 0.04])),
        ("cars", paint, glossy("car paint", [0.5, 0.04, 0.03], 0.2)),
    ] {
        let material = b.material(material);
        b.add(name, solids.0, material);
    }
    square(&mut b, fine);
    b.sun(0.09, 0.1, vec3(6.0, 5.2, 3.9));
    b.scene.sky = vec3(0.4, 0.56, 0.85);
    b.camera(
        "skyline",
        vec3(-900.0, 250.0, 1000.0),
        vec3(60.0, 60.0, 0.0),
        40.0,
    );
    b.camera("square", vec3(-13.0, 2.0, 20.0), vec3(0.0, 6.5, -4.0), 65.0);
    b.camera("statue", vec3(0.9, 5.6, 3.4), vec3(0.0, 5.3, 0.0), 35.0);
    b.camera(
        "suburb",
        vec3(2040.0, 14.0, 2075.0),
        vec3(1900.0, 3.0, 1890.0),
        55.0,
    );
    b
}

/// A tower every quarter of a block, windows all over.
fn towers(t: &mut Town, rng: &mut Rng, x: f32, z: f32, half: f32, far: f32, fine: f32) {
    for (sx, sz) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let (cx, cz) = (x + sx * half / 2.0, z + sz * half / 2.0);
        let (w, d) = (rng.range(11.0, 17.5), rng.range(11.0, 17.5));
        let height = (rng.range(35.0, 95.0) * (1.9 - far / 500.0)).max(28.0);
        let body = [&mut t.concrete, &mut t.brick, &mut t.trim];
        let which = rng.below(3);
        for (k, solids) in body.into_iter().enumerate() {
            if k == which {
                solids.block(vec3(cx - w, 0.0, cz - d), vec3(cx + w, height, cz + d), 0.0);
                let (pw, pd) = (w * rng.range(0.3, 0.7), d * rng.range(0.3, 0.7));
                let top = height + rng.range(3.0, 12.0);
                solids.block(
                    vec3(cx - pw, height - 1.0, cz - pd),
                    vec3(cx + pw, top, cz + pd),
                    0.0,
                );
            }
        }
        let floors = ((height - 5.0) / 3.6 * fine).max(1.0) as u32;
        let storey = (height - 5.0) / floors as f32;
        for side in 0..4 {
            let (across, out) = if side < 2 { (w, d) } else { (d, w) };
            let columns = (2.0 * across / 2.4 * fine).max(1.0) as u32;
            let bay = 2.0 * across / columns as f32;
            for floor in 0..floors {
                let y = 4.0 + storey * floor as f32;
                for column in 0..columns {
                    let u = -across + bay * (column as f32 + 0.5);
                    let sign = if side % 2 == 0 { 1.0 } else { -1.0 };
                    let (near, reach) = (sign * (out - 0.05), sign * (out + 0.04));
                    let (u0, u1) = (u - 0.34 * bay, u + 0.34 * bay);
                    let (w0, w1) = (near.min(reach), near.max(reach));
                    let (low, high) = if side < 2 {
                        (
                            vec3(cx + u0, y, cz + w0),
                            vec3(cx + u1, y + 0.66 * storey, cz + w1),
                        )
                    } else {
                        (
                            vec3(cx + w0, y, cz + u0),
                            vec3(cx + w1, y + 0.66 * storey, cz + u1),
                        )
                    };
                    t.glass.block(low, high, 0.0);
                }
            }
        }
        for floor in 0..floors {
            let y = 4.0 + storey * floor as f32 - 0.16 * storey;
            let grow = 0.12;
            t.trim.block(
                vec3(cx - w - grow, y - 0.1, cz - d - grow),
                vec3(cx + w + grow, y + 0.1, cz + d + grow),
                0.0,
            );
        }
    }
}

/// Houses of five floors around an inner yard; a band a floor.
fn perimeter(t: &mut Town, rng: &mut Rng, x: f32, z: f32, half: f32, far: f32, fine: f32) {
    let depth = 12.0;
    for side in 0..4 {
        let lots = 3 + rng.below(3);
        for lot in 0..lots {
            // Long sides own the corners.
            let reach = if side < 2 { half } else { half - depth };
            let cut = |k: usize| -reach + 2.0 * reach * k as f32 / lots as f32;
            let (u0, u1) = (cut(lot) + 0.02, cut(lot + 1) - 0.02);
            let sign = if side % 2 == 0 { 1.0 } else { -1.0 };
            let (a, c) = (
                sign * (half - depth + 0.03),
                sign * (half - rng.range(0.0, 0.8)),
            );
            let (w0, w1) = (a.min(c), a.max(c));
            let height = rng.range(11.0, 19.0) * (1.5 - far / 2600.0);
            let corners = |u0: f32, u1: f32, w0: f32, w1: f32, y0: f32, y1: f32| {
                if side < 2 {
                    (vec3(x + u0, y0, z + w0), vec3(x + u1, y1, z + w1))
                } else {
                    (vec3(x + w0, y0, z + u0), vec3(x + w1, y1, z + u1))
                }
            };
            let (low, high) = corners(u0, u1, w0, w1, 0.0, height);
            if rng.unit() < 0.5 {
                &mut t.brick
            } else {
                &mut t.concrete
            }
            .block(low, high, 0.0);
            let floors = (height / 3.2) as u32;
            for floor in 0..floors {
                let y = 1.0 + 3.2 * floor as f32;
                let windows = ((u1 - u0) / 2.6 * fine) as u32;
                let bay = (u1 - u0) / windows as f32;
                for k in 0..windows {
                    let u = u0 + bay * (k as f32 + 0.5);
                    let edge = if sign > 0.0 { w1 } else { w0 };
                    let (low, high) = corners(
                        u - 0.25 * bay,
                        u + 0.25 * bay,
                        edge - 0.06,
                        edge + 0.05,
                        y,
                        y + 1.7,
                    );
                    t.glass.block(low, high, 0.0);
                }
            }
            let (low, high) = corners(
                u0 - 0.1,
                u1 + 0.1,
                w0 - 0.3,
                w1 + 0.3,
                height - 0.3,
                height + 0.4,
            );
            t.trim.block(low, high, 0.0);
        }
    }
}

/// Detached houses with gardens.
fn houses(t: &mut Town, rng: &mut Rng, x: f32, z: f32, half: f32, share: f32) {
    for i in -1..=1 {
        for j in -1..=1 {
            let keep = rng.unit() < share.max(0.05);
            let (cx, cz) = (
                x + 27.0 * i as f32 + rng.range(-3.0, 3.0),
                z + 27.0 * j as f32 + rng.range(-3.0, 3.0),
            );
            let (w, d, h) = (
                rng.range(4.5, 7.0),
                rng.range(3.5, 5.5),
                rng.range(3.0, 6.2),
            );
            let turn = 0.25 * rng.below(4) as f32 + rng.range(-0.02, 0.02);
            let wall = rng.below(3);
            let (tall, off) = (rng.range(1.5, 3.0), rng.range(8.0, 11.0));
            if !keep {
                continue;
            }
            let solids = [&mut t.trim, &mut t.brick, &mut t.concrete]
                .into_iter()
                .nth(wall);
            if let Some(solids) = solids {
                solids.block(vec3(cx - w, 0.0, cz - d), vec3(cx + w, h, cz + d), turn);
            }
            t.roof.gable(
                vec3(cx - w - 0.4, h - 0.05, cz - d - 0.5),
                vec3(cx + w + 0.4, h + tall, cz + d + 0.5),
                turn,
            );
            t.glass.block(
                vec3(cx - 0.5 * w, 1.0, cz - d - 0.03),
                vec3(cx - 0.2 * w, 2.2, cz + d + 0.03),
                turn,
            );
            t.glass.block(
                vec3(cx + 0.2 * w, 1.0, cz - d - 0.031),
                vec3(cx + 0.5 * w, 2.2, cz + d + 0.031),
                turn,
            );
            let edge = half - 1.0;
            let tree = vec3(
                (cx + off).min(x + edge),
                1.2,
                (cz + 0.6 * off).min(z + edge),
            );
            t.leaf
                .cone(tree, rng.range(1.2, 2.4), rng.range(3.0, 7.0), 8);
            t.concrete
                .block(tree - vec3(0.2, 1.3, 0.2), tree + vec3(0.2, 0.3, 0.2), 0.0);
        }
    }
}

fn park(t: &mut Town, rng: &mut Rng, x: f32, z: f32, half: f32, share: f32) {
    for _ in 0..(90.0 * share) as u32 {
        let e = half - 4.0;
        let foot = vec3(x + rng.range(-e, e), 1.6, z + rng.range(-e, e));
        let (radius, height) = (rng.range(1.5, 3.0), rng.range(5.0, 12.0));
        t.leaf.cone(foot, radius, height, 12);
        t.leaf.cone(
            foot + Vec3::Y * (0.4 * height),
            0.7 * radius,
            0.8 * height,
            12,
        );
        t.concrete.block(
            foot - vec3(0.25, 1.7, 0.25),
            foot + vec3(0.25, 0.3, 0.25),
            0.0,
        );
    }
}

/// Cars along the kerbs and markings on the street to the east of a block.
fn street(t: &mut Town, rng: &mut Rng, x: f32, z: f32, far: f32, share: f32) {
    let middle = x + PITCH / 2.0;
    let dashes = if far < 1300.0 { 16 } else { 6 };
    for k in 0..dashes {
        let at = z - PITCH / 2.0 + PITCH * (k as f32 + 0.3) / dashes as f32;
        t.trim.block(
            vec3(middle - 0.08, -0.3, at),
            vec3(middle + 0.08, -0.185, at + 2.5),
            0.0,
        );
    }
    let cars = if far < 1300.0 { 12 } else { 3 };
    for _ in 0..cars {
        let at = z + rng.range(-40.0, 40.0);
        let lane = middle + if rng.unit() < 0.5 { -6.2 } else { 6.2 };
        if rng.unit() >= share {
            continue;
        }
        let (low, high) = (
            vec3(lane - 0.85, 0.05, at - 2.1),
            vec3(lane + 0.85, 0.72, at + 2.1),
        );
        let body = if rng.unit() < 0.3 {
            &mut t.paint
        } else {
            &mut t.trim
        };
        body.block(low, high, 0.0);
        t.glass.block(
            vec3(lane - 0.75, 0.7, at - 1.0),
            vec3(lane + 0.75, 1.35, at + 1.3),
            0.0,
        );
        for (wx, wz) in [(-0.8, -1.3), (0.8, -1.3), (-0.8, 1.3), (0.8, 1.3)] {
            let hub = vec3(lane + wx, 0.12, at + wz);
            t.asphalt
                .block(hub - vec3(0.1, 0.3, 0.3), hub + vec3(0.1, 0.3, 0.3), 0.0);
        }
    }
}

/// The plain, and the central square with its statue.
fn square(b: &mut Builder, fine: f32) {
    let asphalt = b.material(lambert("street", [0.085, 0.085, 0.09]));
    let mut plain = Shape::default();
    let e = PITCH * BLOCKS as f32 / 2.0;
    plain.block(vec3(-e, -3.0, -e), vec3(e, -0.2, e), 1);
    plain.normals.clear();
    b.add("plain", plain, asphalt);
    let stone = b.material(glossy("granite", [0.3, 0.29, 0.28], 0.3));
    let mut steps = Shape::default();
    for k in 0..6 {
        let (r, y) = (9.0 - 0.5 * k as f32, 0.1 + 0.16 * k as f32);
        let mut ring = Shape::default();
        ring.cylinder(r, 0.17, 96);
        steps.add(&ring, &Place::at(0.0, y, 0.0));
    }
    let mut foot = Shape::default();
    foot.lathe(
        &[
            (0.0, 0.9),
            (1.6, 0.9),
            (1.6, 1.3),
            (1.2, 1.5),
            (1.1, 3.6),
            (1.35, 3.8),
            (1.35, 4.0),
            (0.0, 4.0),
        ],
        96,
        false,
    );
    steps.add(&foot, &Place::HERE);
    b.add("steps", steps, stone);
    let bronze = b.material(metal("bronze", [0.55, 0.36, 0.2], 0.3));
    let mut statue = Shape::default();
    statue.sphere(1.3, (960.0 * fine).clamp(12.0, 4000.0) as u32);
    for (p, n) in statue.positions.iter_mut().zip(&mut statue.normals) {
        let q = *p;
        // Ridges in two scales; the normals follow by the gradient's tangential part, numerically.
        let height = |q: Vec3| {
            0.07 * sin_cos(q.y * 1.7 + 0.5 * sin_cos(q.x * 0.9).0).0
                + 0.012 * sin_cos(9.0 * (q.x + 0.7 * q.y)).0 * sin_cos(8.0 * (q.z - 0.4 * q.y)).0
        };
        let h = 1e-3;
        let slope = vec3(
            height(q + Vec3::X * h) - height(q - Vec3::X * h),
            height(q + Vec3::Y * h) - height(q - Vec3::Y * h),
            height(q + Vec3::Z * h) - height(q - Vec3::Z * h),
        ) / (2.0 * h);
        let radial = *n;
        *n = (radial - (slope - radial * slope.dot(radial))).normalize_or(radial);
        *p = q + radial * height(q);
    }
    let mut raised = Shape::default();
    raised.add(&statue, &Place::at(0.0, 5.25, 0.0));
    b.add("statue", raised, bronze);
    let lamp = b.material(metal("lamp post", [0.2, 0.2, 0.21], 0.5));
    let mut post = Shape::default();
    post.lathe(
        &[
            (0.0, 0.0),
            (0.2, 0.0),
            (0.08, 0.6),
            (0.05, 4.6),
            (0.25, 4.8),
            (0.0, 4.85),
        ],
        24,
        false,
    );
    let post = b.mesh("lamp post", post, lamp);
    for k in 0..12 {
        let (s, c) = sin_cos(k as f32 / 12.0);
        b.put("lamp post", post, Place::at(30.0 * s, 0.15, 30.0 * c));
        b.point_light(
            "street lamp",
            vec3(30.0 * s, 4.65, 30.0 * c),
            vec3(12.0, 9.0, 5.5),
        );
    }
}
