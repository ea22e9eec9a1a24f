//! `apartment`: six rooms with doors between them, furniture, windows to a sky and a sun, 24 lamps.

use super::builder::{Builder, glossy, lambert, metal};
use super::furniture::{self as kit, Fineness, Model};
use super::math::{Place, Rng, sin_cos};
use super::shape::Shape;
use glam::{Affine2, Vec2, Vec3};

const CEILING: f32 = 2.7;

struct Palette {
    wall: u32,
    floor: u32,
    tile: u32,
    wood: u32,
    dark_wood: u32,
    white: u32,
    linen: u32,
    grey_cloth: u32,
    ochre: u32,
    teal: u32,
    rug: u32,
    steel: u32,
    brass: u32,
    ceramic: u32,
    leaf: u32,
    soil: u32,
    mirror: u32,
    bindings: [u32; 5],
}

pub(super) fn apartment(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("apartment");
    let f = Fineness(detail.sqrt());
    let p = palette(&mut b, seed);
    shell(&mut b, &p);
    living_room(&mut b, &p, f, seed);
    kitchen(&mut b, &p, f, seed);
    bedroom(&mut b, &p, f, seed);
    study(&mut b, &p, f, seed);
    bath_and_hall(&mut b, &p, f, seed);
    b.sun(0.30, 0.085, Vec3::new(42.0, 36.0, 27.0));
    b.scene.sky = Vec3::new(3.2, 4.2, 6.0);
    b.camera(
        "living room",
        Vec3::new(0.45, 1.55, 4.95),
        Vec3::new(4.4, 1.05, 1.6),
        58.0,
    );
    b.camera(
        "kitchen",
        Vec3::new(7.0, 1.6, 3.6),
        Vec3::new(10.6, 1.0, 0.9),
        60.0,
    );
    b.camera(
        "bedroom",
        Vec3::new(4.1, 1.6, 8.6),
        Vec3::new(1.2, 0.8, 6.4),
        60.0,
    );
    b.camera(
        "study",
        Vec3::new(7.9, 1.6, 8.6),
        Vec3::new(10.6, 0.9, 6.3),
        60.0,
    );
    b.camera(
        "hall",
        Vec3::new(11.6, 1.6, 4.7),
        Vec3::new(6.0, 1.2, 4.7),
        60.0,
    );
    b
}

fn palette(b: &mut Builder, seed: u64) -> Palette {
    let mut rng = Rng::new(seed, 1);
    let mut boards = Vec::new();
    for _ in 0..64 {
        boards.push((rng.range(0.75, 1.1), rng.below(256) as u32));
    }
    let planks = b.picture("planks", 512, move |x, y| {
        // Eight boards side by side, each cut at its own place; grain along them.
        let board = (y / 64) as usize;
        let (_, cut) = boards[board];
        let along = (x + 2 * cut) % 512;
        let (tone, phase) = boards[8 + board * 2 + usize::from(along > 256)];
        let seam = y % 64 < 1 || along % 256 < 1;
        let grain = sin_cos(
            (y % 64) as f32 * 0.11 + 0.6 * sin_cos(x as f32 / 512.0 + phase as f32 / 99.0).0,
        )
        .0;
        let shade = tone * (1.0 + 0.06 * grain) * if seam { 0.45 } else { 1.0 };
        [172.0, 128.0, 86.0].map(|c: f32| (c * shade).clamp(0.0, 255.0) as u8)
    });
    let mut floor = glossy("oak floor", [1.0; 3], 0.35);
    floor.base_color_texture = Some(repeated(planks, 7.0));
    let tiles = b.picture("tiles", 128, |x, y| {
        let joint = x % 64 < 2 || y % 64 < 2;
        let dark = (x / 64 + y / 64) % 2 == 0;
        if joint {
            [150, 150, 145]
        } else if dark {
            [196, 200, 202]
        } else {
            [222, 224, 222]
        }
    });
    let mut tile = glossy("tiles", [1.0; 3], 0.2);
    tile.base_color_texture = Some(repeated(tiles, 20.0));
    let weave = b.picture("rug", 256, |x, y| {
        let border = x < 22 || y < 22 || x > 233 || y > 233;
        let diamond = ((x as i32 % 64 - 32).abs() + (y as i32 % 64 - 32).abs()) / 8 % 2 == 0;
        match (border, diamond) {
            (true, _) if (x / 6 + y / 6) % 2 == 0 => [94, 22, 26],
            (true, _) => [201, 178, 132],
            (_, true) => [128, 36, 34],
            _ => [36, 42, 78],
        }
    });
    let mut rug = lambert("rug", [1.0; 3]);
    rug.base_color_texture = Some(weave);
    let mut binding = |i: usize, c: [f32; 3]| b.material(glossy(&format!("binding {i}"), c, 0.5));
    let bindings = [
        binding(0, [0.32, 0.05, 0.04]),
        binding(1, [0.05, 0.11, 0.24]),
        binding(2, [0.08, 0.2, 0.1]),
        binding(3, [0.55, 0.46, 0.3]),
        binding(4, [0.62, 0.6, 0.55]),
    ];
    Palette {
        wall: b.material(lambert("wall", [0.78, 0.76, 0.72])),
        floor: b.material(floor),
        tile: b.material(tile),
        wood: b.material(glossy("walnut", [0.3, 0.17, 0.09], 0.4)),
        dark_wood: b.material(glossy("dark wood", [0.1, 0.055, 0.035], 0.35)),
        white: b.material(glossy("white paint", [0.8, 0.8, 0.78], 0.3)),
        linen: b.material(lambert("linen", [0.8, 0.77, 0.7])),
        grey_cloth: b.material(lambert("grey cloth", [0.23, 0.25, 0.28])),
        ochre: b.material(lambert("ochre cloth", [0.62, 0.36, 0.07])),
        teal: b.material(lambert("teal cloth", [0.05, 0.26, 0.28])),
        rug: b.material(rug),
        steel: b.material(metal("steel", [0.62, 0.62, 0.63], 0.25)),
        brass: b.material(metal("brass", [0.83, 0.62, 0.28], 0.25)),
        ceramic: b.material(glossy("ceramic", [0.78, 0.79, 0.77], 0.1)),
        leaf: b.material(glossy("leaf", [0.07, 0.21, 0.04], 0.4)),
        soil: b.material(lambert("soil", [0.05, 0.035, 0.025])),
        mirror: b.material(metal("mirror", [0.92, 0.93, 0.92], 0.0)),
        bindings,
    }
}

/// The same picture `times` over the unit square.
fn repeated(texture: crate::TextureRef, times: f32) -> crate::TextureRef {
    crate::TextureRef {
        transform: Affine2::from_scale(Vec2::splat(times)),
        ..texture
    }
}

/// Floors, ceiling and walls. Walls end inside of each other and inside the slabs; each top has its own height.
fn shell(b: &mut Builder, p: &Palette) {
    let door = |from: f32| ([from, from + 0.9], [-1.0, 2.05]);
    let window = |from: f32, to: f32, low: f32| ([from, to], [low, 2.35]);
    let mut walls = Shape::default();
    let mut wall =
        |low: [f32; 3], high: [f32; 3], along_x: bool, holes: &[([f32; 2], [f32; 2])]| {
            walls.wall(Vec3::from(low), Vec3::from(high), along_x, holes);
        };
    let (y, t) = (-0.05, CEILING);
    let south = [
        window(0.9, 2.9, 0.35),
        window(3.7, 5.7, 0.35),
        window(8.0, 10.6, 1.1),
    ];
    wall([-0.3, y, -0.25], [12.3, t + 0.05, 0.0], true, &south);
    let north = [
        window(1.2, 3.4, 0.8),
        window(5.6, 6.4, 1.6),
        window(8.8, 11.0, 0.8),
    ];
    wall([-0.3, y, 9.0], [12.3, t + 0.06, 9.25], true, &north);
    wall(
        [-0.25, y, -0.12],
        [0.0, t + 0.07, 9.12],
        false,
        &[window(1.4, 3.8, 0.8)],
    );
    wall(
        [12.0, y, -0.13],
        [12.25, t + 0.08, 9.13],
        false,
        &[window(1.4, 2.6, 1.1)],
    );
    wall(
        [6.44, y, -0.1],
        [6.56, t + 0.09, 5.5],
        false,
        &[([1.1, 2.7], [-1.0, 2.2]), door(4.3)],
    );
    wall([6.5, y, 3.94], [12.1, t + 0.1, 4.06], true, &[door(8.0)]);
    wall(
        [-0.1, y, 5.44],
        [12.11, t + 0.11, 5.56],
        true,
        &[door(3.2), door(6.6), door(9.0)],
    );
    wall([4.44, y, 5.5], [4.56, t + 0.12, 9.11], false, &[]);
    wall([7.54, y, 5.5], [7.66, t + 0.13, 9.1], false, &[]);
    let mut ceiling = Shape::default();
    ceiling.block(Vec3::new(-0.4, t, -0.4), Vec3::new(12.4, t + 0.3, 9.4), 1);
    b.add("walls", walls, p.wall);
    b.add("ceiling", ceiling, p.wall);
    let mut floor = Shape::default();
    floor.block(Vec3::new(-0.4, -0.3, -0.4), Vec3::new(12.4, 0.0, 9.4), 1);
    b.add("floor", floor, p.floor);
    // Tiles lie on the boards in kitchen and bath, up to the middle of the walls.
    let mut tiles = Shape::default();
    tiles.block(Vec3::new(6.5, -0.01, -0.1), Vec3::new(12.1, 0.006, 4.0), 1);
    tiles.block(Vec3::new(4.5, -0.01, 5.5), Vec3::new(7.6, 0.006, 9.1), 1);
    b.add("tiles", tiles, p.tile);

    let mut frames = Shape::default();
    for (x0, x1, low) in [(0.9, 2.9, 0.35), (3.7, 5.7, 0.35), (8.0, 10.6, 1.1)] {
        frame(
            &mut frames,
            Place::at(0.5 * (x0 + x1), low, -0.12),
            x1 - x0,
            2.35 - low,
        );
    }
    for (x0, x1, low) in [(1.2, 3.4, 0.8), (5.6, 6.4, 1.6), (8.8, 11.0, 0.8)] {
        frame(
            &mut frames,
            Place::at(0.5 * (x0 + x1), low, 9.12),
            x1 - x0,
            2.35 - low,
        );
    }
    for (x, z0, z1, low) in [(-0.12, 1.4, 3.8, 0.8), (12.12, 1.4, 2.6, 1.1)] {
        let place = Place::at(x, low, 0.5 * (z0 + z1)).turned_y(0.25);
        frame(&mut frames, place, z1 - z0, 2.35 - low);
    }
    b.add("window frames", frames, p.white);
    let mut doors = Shape::default();
    for (x, z, turn, open) in [
        (6.5, 5.2, 0.25, 0.2),
        (8.9, 4.0, 0.0, 0.19),
        (3.2, 5.5, 0.5, 0.22),
        (7.5, 5.5, 0.0, -0.13),
        (9.9, 5.5, 0.0, -0.21),
    ] {
        let hinge = Place::at(x, 0.01, z).turned_y(turn + open);
        let mut leaf = Shape::default();
        leaf.rounded_box(Vec3::new(0.43, 1.01, 0.02), 0.006, 2);
        let mut moved = Shape::default();
        moved.add(&leaf, &Place::at(-0.46, 1.02, 0.0));
        doors.add(&moved, &hinge);
    }
    b.add("doors", doors, p.white);
}

/// A window frame with a cross, `width` along X, standing at the middle of its lower edge. It reaches into the wall.
fn frame(shape: &mut Shape, place: Place, width: f32, height: f32) {
    let mut bars = Shape::default();
    let (w, h, r) = (width / 2.0, height, 0.03);
    bars.block(
        Vec3::new(-w - 0.02, -0.02, -r),
        Vec3::new(-w + 0.05, h + 0.02, r),
        1,
    );
    bars.block(
        Vec3::new(w - 0.05, -0.021, -r),
        Vec3::new(w + 0.02, h + 0.021, r),
        1,
    );
    bars.block(
        Vec3::new(-w, -0.022, -r * 0.9),
        Vec3::new(w, 0.05, r * 0.9),
        1,
    );
    bars.block(
        Vec3::new(-w, h - 0.05, -r * 0.9),
        Vec3::new(w, h + 0.022, r * 0.9),
        1,
    );
    bars.block(
        Vec3::new(-0.025, 0.01, -r * 0.7),
        Vec3::new(0.025, h - 0.01, r * 0.7),
        1,
    );
    bars.block(
        Vec3::new(-w + 0.01, 0.68 * h, -r * 0.6),
        Vec3::new(w - 0.01, 0.68 * h + 0.04, r * 0.6),
        1,
    );
    // The sill.
    bars.block(
        Vec3::new(-w - 0.05, -0.03, -0.17),
        Vec3::new(w + 0.05, 0.012, 0.17),
        1,
    );
    shape.add(&bars, &place);
}

fn put(b: &mut Builder, name: &str, model: Model, place: Place) {
    let meshes = b.model(name, model);
    b.place(name, &meshes, place);
}

const WARM: Vec3 = Vec3::new(1.0, 0.72, 0.43);

fn ceiling_light(b: &mut Builder, p: &Palette, f: Fineness, x: f32, z: f32, power: f32) {
    put(
        b,
        "ceiling lamp",
        kit::ceiling_lamp(f, p.brass),
        Place::at(x, CEILING, z),
    );
    b.point_light(
        "ceiling light",
        Vec3::new(x, CEILING - 0.14, z),
        WARM * power,
    );
}

fn standing_light(b: &mut Builder, p: &Palette, f: Fineness, at: [f32; 3], tall: f32, power: f32) {
    let place = Place::at(at[0], at[1], at[2]);
    put(
        b,
        "lamp",
        kit::standing_lamp(f, tall, p.linen, p.brass),
        place,
    );
    b.point_light(
        "lamp",
        Vec3::new(at[0], at[1] + tall - 0.13, at[2]),
        WARM * power,
    );
}

fn living_room(b: &mut Builder, p: &Palette, f: Fineness, seed: u64) {
    let mut rng = Rng::new(seed, 2);
    let mut carpet = Shape::default();
    carpet.block(
        Vec3::new(-1.5, -0.002, -1.05),
        Vec3::new(1.5, 0.014, 1.05),
        1,
    );
    put(b, "rug", vec![(p.rug, carpet)], Place::at(2.3, 0.0, 2.35));
    let sofa = kit::sofa(f, 3, p.grey_cloth, p.ochre, p.dark_wood);
    put(b, "sofa", sofa, Place::at(2.3, 0.0, 0.72));
    let armchair = b.model("armchair", kit::sofa(f, 1, p.teal, p.linen, p.dark_wood));
    b.place(
        "armchair",
        &armchair,
        Place::at(0.75, 0.0, 3.2).turned_y(0.31),
    );
    b.place(
        "armchair",
        &armchair,
        Place::at(3.95, 0.0, 2.9).turned_y(-0.3),
    );
    put(
        b,
        "coffee table",
        kit::table(f, [1.2, 0.4, 0.65], p.wood, p.dark_wood),
        Place::at(2.3, 0.012, 2.2),
    );
    put(
        b,
        "vase",
        kit::vase(f, 0.28, 0.07, 0.9, p.ceramic),
        Place::at(2.6, 0.412, 2.15),
    );
    put(
        b,
        "bowl",
        kit::vase(f, 0.08, 0.14, 0.0, p.brass),
        Place::at(2.05, 0.412, 2.25),
    );
    put(
        b,
        "book",
        stack(4, p, &mut rng).remove(0),
        Place::at(1.85, 0.412, 2.05).turned_y(0.07),
    );

    put(
        b,
        "dining table",
        kit::table(f, [0.95, 0.75, 1.9], p.wood, p.wood),
        Place::at(5.35, 0.0, 3.25),
    );
    let chair = b.model("chair", kit::chair(f, p.dark_wood, p.linen));
    for (x, turn) in [(4.72, 0.25), (5.98, -0.25)] {
        for k in 0..3 {
            let z = 2.65 + 0.6 * k as f32;
            let jitter = rng.range(-0.02, 0.02);
            b.place(
                "chair",
                &chair,
                Place::at(x, 0.0, z).turned_y(turn + jitter),
            );
        }
    }
    put(
        b,
        "fruit bowl",
        kit::vase(f, 0.1, 0.17, 0.0, p.ceramic),
        Place::at(5.35, 0.75, 3.25),
    );
    let mut fruit = Shape::default();
    fruit.sphere(0.042, f.of(28));
    let fruit = b.mesh("fruit", fruit, p.ochre);
    for k in 0..6 {
        let (s, c) = sin_cos(k as f32 / 5.0);
        let (r, y) = if k < 5 { (0.075, 0.80) } else { (0.0, 0.865) };
        b.put("fruit", fruit, Place::at(5.35 + r * s, y, 3.25 + r * c));
    }
    let shelf = kit::bookshelf(f, [1.9, 2.1], p.dark_wood, &p.bindings, &mut rng);
    put(
        b,
        "bookshelf",
        shelf,
        Place::at(0.17, 0.0, 4.55).turned_y(0.25),
    );
    for (x, z, h) in [(6.05, 0.45, 1.5), (0.42, 0.5, 1.1), (6.0, 5.05, 1.2)] {
        put(
            b,
            "plant",
            kit::plant(f, h, p.ceramic, p.leaf, p.soil, &mut rng),
            Place::at(x, 0.0, z),
        );
    }
    for (x0, x1) in [(0.9, 2.9), (3.7, 5.7)] {
        for (k, x) in [x0 - 0.12, x1 + 0.12].into_iter().enumerate() {
            let cloth = kit::curtain(f, 0.55, 2.5, p.linen, 0.37 * k as f32 + x);
            put(b, "curtain", cloth, Place::at(x, 0.03, 0.09));
        }
    }
    for (x, z) in [(1.4, 1.6), (3.3, 1.6), (1.4, 3.9), (3.3, 3.9)] {
        ceiling_light(b, p, f, x, z, 1.3);
    }
    for k in 0..3 {
        let z = 2.65 + 0.6 * k as f32;
        put(
            b,
            "pendant",
            kit::pendant(f, 0.95, p.teal, p.brass),
            Place::at(5.35, CEILING, z),
        );
        b.point_light("pendant", Vec3::new(5.35, CEILING - 0.99, z), WARM * 1.2);
    }
    standing_light(b, p, f, [0.5, 0.0, 1.5], 1.55, 2.0);
    put(
        b,
        "side table",
        kit::table(f, [0.4, 0.5, 0.4], p.wood, p.dark_wood),
        Place::at(4.0, 0.0, 0.6),
    );
    standing_light(b, p, f, [4.0, 0.5, 0.6], 0.5, 1.0);
    put(
        b,
        "console",
        kit::table(f, [1.2, 0.78, 0.35], p.dark_wood, p.dark_wood),
        Place::at(1.9, 0.0, 5.2),
    );
    standing_light(b, p, f, [1.5, 0.78, 5.2], 0.5, 0.8);
    put(
        b,
        "vase",
        kit::vase(f, 0.34, 0.1, 0.6, p.teal),
        Place::at(2.2, 0.78, 5.2),
    );
}

/// A pile of books, as one model in a list (so that a caller can take it apart).
fn stack(books: usize, p: &Palette, rng: &mut Rng) -> Vec<Model> {
    let mut model = Model::new();
    let mut y = 0.0;
    for k in 0..books {
        let mut book = Shape::default();
        let thick = rng.range(0.015, 0.035);
        book.rounded_box(Vec3::new(0.11, thick / 2.0, 0.08), 0.003, 1);
        let mut turned = Shape::default();
        turned.add(
            &book,
            &Place::at(0.0, y + thick / 2.0, 0.0).turned_y(rng.range(-0.04, 0.04)),
        );
        model.push((p.bindings[k % p.bindings.len()], turned));
        y += thick + 0.0005;
    }
    vec![model]
}

fn kitchen(b: &mut Builder, p: &Palette, f: Fineness, seed: u64) {
    let mut rng = Rng::new(seed, 3);
    let n = f.edge(3);
    let (mut fronts, mut tops, mut grips, mut carcass) = (
        Shape::default(),
        Shape::default(),
        Shape::default(),
        Shape::default(),
    );
    carcass.block(Vec3::new(7.6, 0.0, -0.05), Vec3::new(12.05, 0.86, 0.56), 1);
    for k in 0..7 {
        let x = 7.65 + 0.62 * k as f32;
        let mut front = Shape::default();
        front.rounded_box(Vec3::new(0.3, 0.37, 0.012), 0.006, n);
        fronts.add(&front, &Place::at(x + 0.31, 0.47, 0.57));
        let bar = [Vec3::new(x + 0.1, 0.8, 0.6), Vec3::new(x + 0.52, 0.8, 0.6)];
        grips.tube(&bar, &[0.006; 2], f.of(12));
        if !(1..=4).contains(&k) {
            let mut upper = Shape::default();
            upper.rounded_box(Vec3::new(0.3, 0.38, 0.17), 0.008, n);
            fronts.add(&upper, &Place::at(x + 0.31, 1.9, 0.165));
        }
    }
    let mut slab = Shape::default();
    slab.rounded_box(Vec3::new(2.26, 0.02, 0.32), 0.008, n);
    tops.add(&slab, &Place::at(9.84, 0.88, 0.27));
    b.add("kitchen carcass", carcass, p.dark_wood);
    b.add("kitchen fronts", fronts, p.white);
    b.add("worktop", tops, p.dark_wood);
    b.add("grips", grips, p.steel);
    let mut fridge = Shape::default();
    fridge.rounded_box(Vec3::new(0.33, 0.95, 0.33), 0.03, f.edge(6));
    put(
        b,
        "fridge",
        vec![(p.steel, fridge)],
        Place::at(7.05, 0.955, 0.4),
    );
    let tap = [
        Vec3::new(9.3, 0.88, 0.12),
        Vec3::new(9.3, 1.15, 0.12),
        Vec3::new(9.3, 1.22, 0.17),
        Vec3::new(9.3, 1.21, 0.26),
        Vec3::new(9.3, 1.16, 0.29),
    ];
    let mut pipe = Shape::default();
    pipe.tube(&tap, &[0.014; 5], f.of(20));
    b.add("tap", pipe, p.steel);
    for k in 0..6 {
        let x = 10.2 + 0.2 * k as f32;
        let (h, r) = (rng.range(0.14, 0.32), rng.range(0.04, 0.06));
        let material = [p.ceramic, p.teal, p.brass, p.ochre][rng.below(4)];
        put(
            b,
            "jar",
            kit::vase(f, h, r, rng.unit(), material),
            Place::at(x, 0.9, 0.16),
        );
    }
    put(
        b,
        "kitchen table",
        kit::table(f, [1.3, 0.75, 0.8], p.white, p.wood),
        Place::at(10.4, 0.0, 2.4),
    );
    let chair = b.model("kitchen chair", kit::chair(f, p.wood, p.teal));
    for (x, z, turn) in [
        (10.0, 1.85, 0.0),
        (10.8, 1.85, 0.02),
        (10.1, 2.98, 0.5),
        (10.8, 2.95, 0.47),
    ] {
        b.place("kitchen chair", &chair, Place::at(x, 0.0, z).turned_y(turn));
    }
    put(
        b,
        "bowl",
        kit::vase(f, 0.09, 0.15, 0.0, p.ochre),
        Place::at(10.4, 0.75, 2.4),
    );
    put(
        b,
        "plant",
        kit::plant(f, 0.5, p.ceramic, p.leaf, p.soil, &mut rng),
        Place::at(11.7, 0.9, 0.3),
    );
    put(
        b,
        "plant",
        kit::plant(f, 1.3, p.ceramic, p.leaf, p.soil, &mut rng),
        Place::at(11.6, 0.0, 3.5),
    );
    for x in [7.8, 9.3, 10.8] {
        ceiling_light(b, p, f, x, 2.2, 1.2);
    }
    for x in [7.96, 11.68] {
        b.point_light("under the cupboard", Vec3::new(x, 1.47, 0.25), WARM * 0.35);
    }
}

fn bedroom(b: &mut Builder, p: &Palette, f: Fineness, seed: u64) {
    let mut rng = Rng::new(seed, 4);
    let bed = kit::bed(f, p.wood, p.linen, p.teal);
    put(b, "bed", bed, Place::at(1.15, 0.0, 7.3).turned_y(0.25));
    for z in [6.05, 8.55] {
        put(
            b,
            "night table",
            kit::table(f, [0.4, 0.5, 0.4], p.wood, p.wood),
            Place::at(0.3, 0.0, z),
        );
        standing_light(b, p, f, [0.3, 0.5, z], 0.45, 0.8);
    }
    let mut wardrobe = Shape::default();
    for k in 0..3 {
        let mut door = Shape::default();
        door.rounded_box(Vec3::new(0.3, 1.1, 0.3), 0.01, f.edge(4));
        wardrobe.add(
            &door,
            &Place::at(0.0, 1.105, 0.605 * k as f32).turned_y(0.25),
        );
    }
    put(
        b,
        "wardrobe",
        vec![(p.white, wardrobe)],
        Place::at(4.1, 0.0, 7.2),
    );
    for (k, x) in [1.05, 3.5].into_iter().enumerate() {
        let cloth = kit::curtain(f, 0.6, 2.5, p.ochre, 0.21 * k as f32);
        put(b, "curtain", cloth, Place::at(x, 0.03, 8.9));
    }
    put(
        b,
        "plant",
        kit::plant(f, 1.0, p.ceramic, p.leaf, p.soil, &mut rng),
        Place::at(3.9, 0.0, 6.2),
    );
    ceiling_light(b, p, f, 2.3, 7.3, 1.6);
}

fn study(b: &mut Builder, p: &Palette, f: Fineness, seed: u64) {
    let mut rng = Rng::new(seed, 5);
    put(
        b,
        "desk",
        kit::table(f, [1.7, 0.74, 0.8], p.wood, p.steel),
        Place::at(10.3, 0.0, 8.3),
    );
    let chair = kit::office_chair(f, p.grey_cloth, p.steel);
    put(
        b,
        "office chair",
        chair,
        Place::at(10.3, 0.0, 7.55).turned_y(0.06),
    );
    standing_light(b, p, f, [10.95, 0.74, 8.5], 0.5, 0.9);
    put(
        b,
        "books",
        stack(7, p, &mut rng).remove(0),
        Place::at(9.7, 0.74, 8.45).turned_y(0.04),
    );
    let mut screen = Shape::default();
    screen.rounded_box(Vec3::new(0.3, 0.18, 0.012), 0.01, f.edge(3));
    let mut raised = Shape::default();
    raised.add(&screen, &Place::at(0.0, 0.3, 0.0).turned_x(0.02));
    let mut foot = Shape::default();
    foot.lathe(
        &[
            (0.0, 0.0),
            (0.11, 0.0),
            (0.1, 0.01),
            (0.015, 0.02),
            (0.012, 0.25),
            (0.0, 0.25),
        ],
        f.of(32),
        false,
    );
    put(
        b,
        "screen",
        vec![(p.dark_wood, raised), (p.steel, foot)],
        Place::at(10.3, 0.74, 8.55).turned_y(0.5),
    );
    for (x, z, turn) in [(11.83, 6.6, -0.25), (7.83, 6.6, 0.25)] {
        let shelf = kit::bookshelf(f, [1.8, 2.2], p.dark_wood, &p.bindings, &mut rng);
        put(b, "bookshelf", shelf, Place::at(x, 0.0, z).turned_y(turn));
    }
    put(
        b,
        "armchair",
        kit::sofa(f, 1, p.ochre, p.grey_cloth, p.wood),
        Place::at(8.5, 0.0, 8.2).turned_y(0.35),
    );
    put(
        b,
        "plant",
        kit::plant(f, 1.3, p.ceramic, p.leaf, p.soil, &mut rng),
        Place::at(11.6, 0.0, 8.6),
    );
    ceiling_light(b, p, f, 9.8, 7.2, 1.6);
}

fn bath_and_hall(b: &mut Builder, p: &Palette, f: Fineness, seed: u64) {
    let mut rng = Rng::new(seed, 6);
    let tub: Vec<(f32, f32)> = [
        (0.0, 0.0),
        (0.7, 0.0),
        (0.8, 0.08),
        (0.9, 0.5),
        (0.94, 0.56),
        (0.9, 0.58),
        (0.84, 0.55),
        (0.72, 0.16),
        (0.6, 0.1),
        (0.0, 0.09),
    ]
    .into();
    let mut round = Shape::default();
    round.lathe(&tub, f.of(96), true);
    let mut oval = Shape::default();
    oval.add(&round, &Place::HERE.scaled(Vec3::new(0.42, 1.0, 0.9)));
    put(
        b,
        "bath tub",
        vec![(p.ceramic, oval)],
        Place::at(5.05, 0.006, 8.0),
    );
    put(
        b,
        "basin table",
        kit::table(f, [0.8, 0.8, 0.45], p.white, p.wood),
        Place::at(7.2, 0.006, 8.2).turned_y(0.25),
    );
    put(
        b,
        "basin",
        kit::vase(f, 0.14, 0.2, 0.0, p.ceramic),
        Place::at(7.2, 0.806, 8.2),
    );
    let mut glass = Shape::default();
    glass.block(Vec3::new(7.53, 1.2, 7.8), Vec3::new(7.55, 2.0, 8.6), 1);
    b.add("mirror", glass, p.mirror);
    ceiling_light(b, p, f, 6.0, 7.2, 1.3);
    b.point_light("mirror light", Vec3::new(7.4, 2.1, 8.2), WARM * 0.5);
    for k in 0..5 {
        let (h, r) = (rng.range(0.08, 0.2), rng.range(0.025, 0.04));
        let place = Place::at(5.6 + 0.18 * k as f32, 1.612, 9.06);
        put(
            b,
            "bottle",
            kit::vase(f, h, r, 1.0, [p.teal, p.ochre, p.ceramic][k % 3]),
            place,
        );
    }
    for x in [7.6, 10.4] {
        ceiling_light(b, p, f, x, 4.75, 1.0);
    }
    put(
        b,
        "console",
        kit::table(f, [1.0, 0.8, 0.3], p.wood, p.dark_wood),
        Place::at(11.3, 0.0, 4.25),
    );
    put(
        b,
        "vase",
        kit::vase(f, 0.4, 0.12, 0.8, p.ochre),
        Place::at(11.3, 0.8, 4.25),
    );
}
