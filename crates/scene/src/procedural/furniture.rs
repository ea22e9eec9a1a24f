//! Things that stand in rooms. Each is a list of shapes with their materials, around the origin, standing on `y = 0`,
//! facing +Z. Parts reach into each other a little: no faces coincide.

use super::math::{Place, Rng, sin_cos};
use super::shape::Shape;
use glam::Vec3;

/// Shapes with their materials.
pub(super) type Model = Vec<(u32, Shape)>;

/// How finely round things are divided: 1 is the default.
#[derive(Clone, Copy)]
pub(super) struct Fineness(pub f32);

impl Fineness {
    /// A number of segments.
    pub fn of(self, segments: u32) -> u32 {
        ((segments as f32 * self.0).round() as u32).clamp(3, 4096)
    }

    /// A number of steps around an edge.
    pub fn edge(self, steps: u32) -> u32 {
        ((steps as f32 * self.0).round() as u32).clamp(1, 256)
    }
}

fn cushion(shape: &mut Shape, half: [f32; 3], radius: f32, n: u32, place: Place) {
    let mut part = Shape::default();
    part.rounded_box(Vec3::from(half), radius, n);
    shape.add(&part, &place);
}

fn turned(shape: &mut Shape, profile: &[(f32, f32)], segments: u32, smooth: bool, place: Place) {
    let mut part = Shape::default();
    part.lathe(profile, segments, smooth);
    shape.add(&part, &place);
}

/// A table with turned legs.
pub(super) fn table(f: Fineness, [width, height, depth]: [f32; 3], top: u32, leg: u32) -> Model {
    let (mut board, mut legs) = (Shape::default(), Shape::default());
    let half = [width / 2.0, 0.02, depth / 2.0];
    cushion(
        &mut board,
        half,
        0.012,
        f.edge(3),
        Place::at(0.0, height - 0.02, 0.0),
    );
    let profile = [
        (0.0, 0.0),
        (0.022, 0.0),
        (0.02, 0.05),
        (0.026, 0.12),
        (0.02, 0.2),
        (0.032, height * 0.7),
        (0.034, height - 0.03),
        (0.0, height - 0.03),
    ];
    for (x, z) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let place = Place::at(x * (width / 2.0 - 0.08), 0.0, z * (depth / 2.0 - 0.08));
        turned(&mut legs, &profile, f.of(20), false, place);
    }
    vec![(top, board), (leg, legs)]
}

/// A dining chair.
pub(super) fn chair(f: Fineness, wood: u32, cloth: u32) -> Model {
    let (mut frame, mut soft) = (Shape::default(), Shape::default());
    cushion(
        &mut soft,
        [0.21, 0.03, 0.2],
        0.028,
        f.edge(4),
        Place::at(0.0, 0.45, 0.0),
    );
    for (x, z, top) in [
        (-0.18, 0.17, 0.44),
        (0.18, 0.17, 0.44),
        (-0.18, -0.18, 0.95),
        (0.18, -0.18, 0.95),
    ] {
        let lean = if top > 0.5 { -0.08 } else { 0.0 };
        let path = [
            Vec3::new(x * 1.1, 0.0, z * 1.05),
            Vec3::new(x, 0.43, z),
            Vec3::new(x, (0.43 + top) / 2.0 + 0.02, z + lean / 2.0),
            Vec3::new(x, top, z + lean),
        ];
        frame.tube(&path, &[0.014, 0.018, 0.017, 0.0], f.of(12));
    }
    for k in 0..4 {
        let y = 0.6 + 0.09 * k as f32;
        let back = -0.18 - 0.08 * (y - 0.43) / 0.52 - 0.004;
        cushion(
            &mut frame,
            [0.18, 0.025, 0.009],
            0.008,
            f.edge(2),
            Place::at(0.0, y, back),
        );
    }
    vec![(wood, frame), (cloth, soft)]
}

/// A swivel chair on five castors.
pub(super) fn office_chair(f: Fineness, cloth: u32, steel: u32) -> Model {
    let (mut soft, mut hard) = (Shape::default(), Shape::default());
    cushion(
        &mut soft,
        [0.24, 0.045, 0.23],
        0.044,
        f.edge(6),
        Place::at(0.0, 0.48, 0.0),
    );
    let back = Place::at(0.0, 0.86, -0.25).turned_x(-0.025);
    cushion(&mut soft, [0.22, 0.3, 0.03], 0.029, f.edge(6), back);
    for x in [-0.27, 0.27] {
        cushion(
            &mut soft,
            [0.03, 0.015, 0.14],
            0.014,
            f.edge(3),
            Place::at(x, 0.68, 0.02),
        );
        let path = [
            Vec3::new(x * 0.8, 0.46, 0.0),
            Vec3::new(x, 0.5, 0.0),
            Vec3::new(x, 0.675, 0.0),
        ];
        hard.tube(&path, &[0.012; 3], f.of(10));
    }
    let path = [
        Vec3::new(0.0, 0.45, -0.1),
        Vec3::new(0.0, 0.46, -0.28),
        Vec3::new(0.0, 0.75, -0.275),
    ];
    hard.tube(&path, &[0.02; 3], f.of(10));
    let column = [
        (0.0, 0.07),
        (0.04, 0.08),
        (0.035, 0.2),
        (0.022, 0.21),
        (0.022, 0.45),
        (0.0, 0.45),
    ];
    turned(&mut hard, &column, f.of(20), false, Place::HERE);
    for k in 0..5 {
        let (s, c) = sin_cos(k as f32 / 5.0);
        let arm = [
            Vec3::new(0.0, 0.12, 0.0),
            Vec3::new(0.15 * s, 0.11, 0.15 * c),
            Vec3::new(0.3 * s, 0.07, 0.3 * c),
        ];
        hard.tube(&arm, &[0.028, 0.024, 0.016], f.of(10));
        let mut wheel = Shape::default();
        wheel.sphere(0.032, f.of(14));
        hard.add(&wheel, &Place::at(0.3 * s, 0.032, 0.3 * c));
    }
    vec![(cloth, soft), (steel, hard)]
}

/// A sofa for `seats` people, with pillows.
pub(super) fn sofa(f: Fineness, seats: u32, cloth: u32, pillow: u32, wood: u32) -> Model {
    let (mut body, mut pillows, mut feet) = (Shape::default(), Shape::default(), Shape::default());
    let half = 0.36 * seats as f32;
    let n = f.edge(5);
    cushion(
        &mut body,
        [half + 0.12, 0.13, 0.44],
        0.05,
        n,
        Place::at(0.0, 0.23, 0.0),
    );
    for side in [-1.0, 1.0] {
        cushion(
            &mut body,
            [0.1, 0.28, 0.45],
            0.06,
            n,
            Place::at(side * (half + 0.1), 0.36, 0.0),
        );
        let pillow_place = Place::at(side * (half - 0.2), 0.66, -0.06)
            .turned_y(-side * 0.05)
            .turned_x(-0.06);
        cushion(&mut pillows, [0.22, 0.22, 0.08], 0.079, n, pillow_place);
        for z in [-0.36, 0.36] {
            let leg = [(0.0, 0.0), (0.02, 0.0), (0.028, 0.12), (0.0, 0.12)];
            turned(
                &mut feet,
                &leg,
                f.of(14),
                false,
                Place::at(side * half, 0.0, z),
            );
        }
    }
    for k in 0..seats {
        let x = (k as f32 + 0.5) * 2.0 * half / seats as f32 - half;
        let w = half / seats as f32 - 0.008;
        cushion(
            &mut body,
            [w, 0.085, 0.36],
            0.06,
            n,
            Place::at(x, 0.42, 0.07),
        );
        let back = Place::at(x, 0.66, -0.32).turned_x(-0.025);
        cushion(&mut body, [w, 0.24, 0.1], 0.08, n, back);
    }
    vec![(cloth, body), (pillow, pillows), (wood, feet)]
}

/// A double bed whose duvet lies in folds; the head is at -Z.
pub(super) fn bed(f: Fineness, wood: u32, sheet: u32, duvet: u32) -> Model {
    let (mut frame, mut linen, mut cover) = (Shape::default(), Shape::default(), Shape::default());
    let n = f.edge(4);
    cushion(
        &mut frame,
        [0.86, 0.12, 1.05],
        0.02,
        n,
        Place::at(0.0, 0.2, 0.0),
    );
    cushion(
        &mut frame,
        [0.9, 0.5, 0.035],
        0.03,
        n,
        Place::at(0.0, 0.52, -1.07),
    );
    for (x, z) in [(-0.8, -0.95), (0.8, -0.95), (-0.8, 0.95), (0.8, 0.95)] {
        let leg = [(0.0, 0.0), (0.03, 0.0), (0.03, 0.12), (0.0, 0.12)];
        turned(&mut frame, &leg, f.of(12), false, Place::at(x, 0.0, z));
    }
    cushion(
        &mut linen,
        [0.82, 0.12, 1.0],
        0.06,
        n,
        Place::at(0.0, 0.4, 0.0),
    );
    for x in [-0.4, 0.4] {
        let place = Place::at(x, 0.58, -0.72).turned_x(0.03);
        cushion(&mut linen, [0.34, 0.08, 0.22], 0.079, f.edge(6), place);
    }
    // A rounded box pushed into folds, thicker than they are deep.
    let first = cover.positions.len();
    cushion(
        &mut cover,
        [0.9, 0.07, 0.72],
        0.06,
        f.edge(28),
        Place::at(0.0, 0.53, 0.3),
    );
    for p in &mut cover.positions[first..] {
        let folds = sin_cos(p.x * 0.9 + p.z * 0.4).0 * sin_cos(p.z * 1.3 - p.x * 0.5).0;
        p.y += 0.022 * folds + 0.008 * sin_cos(p.x * 3.1 + p.z * 2.3).0;
    }
    vec![(wood, frame), (sheet, linen), (duvet, cover)]
}

/// Shelves with books in a few colours.
pub(super) fn bookshelf(
    f: Fineness,
    [width, height]: [f32; 2],
    wood: u32,
    bindings: &[u32],
    rng: &mut Rng,
) -> Model {
    let _ = f;
    let depth = 0.15;
    let mut frame = Shape::default();
    frame.block(
        Vec3::new(-width / 2.0, 0.0, -depth),
        Vec3::new(-width / 2.0 + 0.03, height, depth),
        1,
    );
    frame.block(
        Vec3::new(width / 2.0 - 0.03, 0.0, -depth),
        Vec3::new(width / 2.0, height, depth),
        1,
    );
    frame.block(
        Vec3::new(-width / 2.0 + 0.01, 0.01, -depth + 0.002),
        Vec3::new(width / 2.0 - 0.01, height - 0.01, -depth + 0.012),
        1,
    );
    let mut books: Vec<Shape> = vec![Shape::default(); bindings.len()];
    let shelves = ((height / 0.34) as u32).max(1);
    for k in 0..=shelves {
        let y = 0.03 + k as f32 * (height - 0.06) / shelves as f32;
        frame.block(
            Vec3::new(-width / 2.0 + 0.02, y - 0.012, -depth + 0.005),
            Vec3::new(width / 2.0 - 0.02, y + 0.012, depth - 0.004),
            1,
        );
        let mut x = -width / 2.0 + 0.04;
        while k < shelves && x < width / 2.0 - 0.1 {
            if rng.unit() < 0.06 {
                x += rng.range(0.05, 0.2);
                continue;
            }
            let (thick, tall, deep) = (
                rng.range(0.014, 0.05),
                rng.range(0.17, 0.27),
                rng.range(0.11, 0.17),
            );
            let low = Vec3::new(x, y + 0.0125, -depth + 0.02);
            let high = low + Vec3::new(thick, tall, deep);
            if high.x < width / 2.0 - 0.035 && !books.is_empty() {
                let which = rng.below(books.len());
                books[which].block(low, high, 1);
            }
            x = high.x + 0.0015;
        }
    }
    let mut model = vec![(wood, frame)];
    model.extend(bindings.iter().copied().zip(books));
    model
}

/// A plant in a pot: stems that bend outwards, each with pairs of leaves.
pub(super) fn plant(
    f: Fineness,
    height: f32,
    pot: u32,
    leaf: u32,
    soil: u32,
    rng: &mut Rng,
) -> Model {
    let (mut vessel, mut green, mut earth) = (Shape::default(), Shape::default(), Shape::default());
    let profile = [
        (0.0, 0.0),
        (0.11, 0.0),
        (0.15, 0.3),
        (0.165, 0.3),
        (0.165, 0.33),
        (0.14, 0.33),
        (0.135, 0.25),
    ];
    vessel.lathe(&profile, f.of(40), false);
    earth.lathe(&[(0.1365, 0.27), (0.0, 0.275)], f.of(40), true);
    for _ in 0..f.of(16) {
        let (s, c) = sin_cos(rng.unit());
        let (bend, tall) = (rng.range(0.1, 0.45) * height, rng.range(0.6, 1.0) * height);
        let at = |t: f32| {
            Vec3::new(
                s * bend * t * t,
                0.25 + tall * t * (1.0 - 0.25 * t),
                c * bend * t * t,
            )
        };
        let path: Vec<Vec3> = (0..=10).map(|k| at(k as f32 / 10.0)).collect();
        let radii: Vec<f32> = (0..=10).map(|k| 0.006 * (1.0 - k as f32 / 10.0)).collect();
        green.tube(&path, &radii, 6);
        for k in 3..22 {
            let p = at(k as f32 / 22.0);
            let place = Place {
                offset: p,
                ..Place::HERE
            }
            .turned_y(rng.unit())
            .turned_x(rng.range(-0.02, 0.12));
            green.add(&leaf_blade(rng.range(0.1, 0.2) * height.sqrt(), 5), &place);
        }
    }
    vec![(pot, vessel), (leaf, green), (soil, earth)]
}

/// A thin closed leaf along +Z, `length` long, bent downwards.
pub(super) fn leaf_blade(length: f32, steps: u32) -> Shape {
    let mut top = Shape::default();
    let thick = length * 0.004;
    let row = |t: f32| {
        let width = length * 0.9 * t * (1.0 - t) * (1.0 - 0.4 * t) + length * 0.004;
        let (y, z) = (-0.35 * length * t * t, length * t);
        (width, y, z)
    };
    for k in 0..=steps {
        let (width, y, z) = row(k as f32 / steps as f32);
        let normal = Vec3::new(0.0, 1.0, 0.7 * k as f32 / steps as f32).normalize();
        for (x, lift) in [(-width, 0.15 * width), (0.0, 0.0), (width, 0.15 * width)] {
            top.positions.push(Vec3::new(x, y + lift + thick, z));
            top.normals.push(normal);
            top.uv.push(glam::Vec2::new(x / length + 0.5, z / length));
        }
    }
    for k in 0..steps {
        for i in 0..2 {
            let a = k * 3 + i;
            top.triangles
                .extend([[a, a + 3, a + 1], [a + 1, a + 3, a + 4]]);
        }
    }
    let mut leaf = top.clone();
    let mut below = top.inverted();
    for p in &mut below.positions {
        p.y -= 2.0 * thick;
    }
    leaf.add(&below, &Place::HERE);
    leaf
}

/// A vessel of revolution with an inside; `shape` goes from 0 (bowl) to 1 (bottle).
pub(super) fn vase(f: Fineness, height: f32, radius: f32, shape: f32, material: u32) -> Model {
    let steps = f.of(24);
    let outline = |t: f32| {
        let belly = sin_cos(0.06 + t * (0.36 + 0.08 * shape)).0;
        let bowl = (0.15 + t).sqrt() * 0.93;
        radius * (belly * shape + bowl * (1.0 - shape)).max(0.12)
    };
    let mut profile = vec![(0.0, 0.0)];
    profile.extend((0..=steps).map(|k| {
        let t = k as f32 / steps as f32;
        (outline(t), t * height)
    }));
    let wall = 0.04 * radius + 0.001;
    profile.extend((1..=steps).rev().map(|k| {
        let t = k as f32 / steps as f32;
        ((outline(t) - wall).max(0.002), t * height - 0.0005)
    }));
    profile.push((0.0, height / steps as f32));
    let mut vessel = Shape::default();
    vessel.lathe(&profile, f.of(48), true);
    vec![(material, vessel)]
}

/// A curtain in folds, `width` times `height`, hanging from its top at `y = height`.
pub(super) fn curtain(f: Fineness, width: f32, height: f32, cloth: u32, phase: f32) -> Model {
    let (columns, rows) = (f.of(90), f.of(14));
    let thick = 0.002;
    let mut front = Shape::default();
    for j in 0..=rows {
        for i in 0..=columns {
            let (s, t) = (i as f32 / columns as f32, j as f32 / rows as f32);
            let sway = 0.018 + 0.02 * (1.0 - t);
            let turns = phase + s * width * 7.0 + 0.05 * sin_cos(t * 0.7 + phase).0;
            let (sin, cos) = sin_cos(turns);
            let slope = sway * cos * 7.0 * std::f32::consts::TAU;
            front
                .positions
                .push(Vec3::new((s - 0.5) * width, t * height, sway * sin + thick));
            front.normals.push(Vec3::new(-slope, 0.0, 1.0).normalize());
            front.uv.push(glam::Vec2::new(s, 1.0 - t));
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let a = j * (columns + 1) + i;
            let (b, c, d) = (a + 1, a + columns + 2, a + columns + 1);
            front.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let mut both = front.clone();
    let mut back = front.inverted();
    for p in &mut back.positions {
        p.z -= 2.0 * thick;
    }
    both.add(&back, &Place::HERE);
    vec![(cloth, both)]
}

/// A lamp shade, open above and below, on a stand; the light belongs at `height - 0.13`.
pub(super) fn standing_lamp(f: Fineness, height: f32, shade: u32, metal: u32) -> Model {
    let (mut cloth, mut stand) = (Shape::default(), Shape::default());
    let r = 0.1 + 0.05 * height;
    let low = height - 0.28;
    let profile = [
        (r, low),
        (0.7 * r, height),
        (0.7 * r - 0.004, height),
        (r - 0.004, low),
        (r, low),
    ];
    cloth.lathe(&profile, f.of(48), false);
    let foot = 0.08 + 0.05 * height;
    let profile = [
        (0.0, 0.0),
        (foot, 0.0),
        (foot, 0.015),
        (0.012, 0.025),
        (0.009, low + 0.05),
        (0.0, low + 0.05),
    ];
    stand.lathe(&profile, f.of(32), false);
    vec![(shade, cloth), (metal, stand)]
}

/// A shade that hangs `drop` below the ceiling at `y = 0`; the light belongs at `-drop - 0.02`.
pub(super) fn pendant(f: Fineness, drop: f32, shade: u32, metal: u32) -> Model {
    let (mut bell, mut cord) = (Shape::default(), Shape::default());
    let outer: Vec<(f32, f32)> = (0..=12)
        .map(|k| {
            let t = k as f32 / 12.0;
            (
                0.17 * sin_cos((1.0 - t) * 0.22 + 0.01).0,
                -drop - 0.06 + 0.2 * t,
            )
        })
        .collect();
    let mut profile: Vec<(f32, f32)> = outer.clone();
    profile.extend(
        outer
            .iter()
            .rev()
            .map(|&(r, y)| ((r - 0.004).max(0.004), y - 0.002)),
    );
    bell.lathe(&profile, f.of(48), true);
    cord.cylinder(0.004, drop - 0.12, 8);
    let mut hung = Shape::default();
    hung.add(&cord, &Place::at(0.0, -drop + 0.12, 0.0));
    let mut rose = Shape::default();
    rose.cylinder(0.045, 0.03, f.of(24));
    hung.add(&rose, &Place::at(0.0, -0.029, 0.0));
    vec![(shade, bell), (metal, hung)]
}

/// A shallow dish under the ceiling at `y = 0`; the light belongs at -0.12.
pub(super) fn ceiling_lamp(f: Fineness, metal: u32) -> Model {
    let mut dish = Shape::default();
    let profile = [
        (0.0, -0.05),
        (0.12, -0.05),
        (0.17, -0.035),
        (0.18, 0.005),
        (0.0, 0.005),
    ];
    dish.lathe(&profile, f.of(40), false);
    vec![(metal, dish)]
}
