//! `conference`: a meeting room without windows, lit by twelve emissive panels overhead.

use super::builder::{Builder, emitter, glossy, lambert, metal};
use super::furniture::{self as kit, Fineness};
use super::math::{Place, Rng};
use super::shape::Shape;
use glam::Vec3;

/// Half of the room's length (along X) and width, and its height.
const ROOM: [f32; 3] = [5.5, 3.6, 3.0];

pub(super) fn conference(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("conference");
    let f = Fineness(detail.sqrt());
    let mut rng = Rng::new(seed, 1);
    let white = b.material(lambert("plaster", [0.76, 0.75, 0.72]));
    let carpet = b.material(lambert("carpet", [0.12, 0.14, 0.19]));
    let walnut = b.material(glossy("walnut", [0.26, 0.13, 0.06], 0.25));
    let slat = b.material(glossy("oak slats", [0.5, 0.33, 0.18], 0.5));
    let leather = b.material(glossy("leather", [0.035, 0.033, 0.033], 0.4));
    let steel = b.material(metal("steel", [0.62, 0.62, 0.63], 0.2));
    let dark = b.material(glossy("black plastic", [0.02, 0.02, 0.022], 0.3));
    let ceramic = b.material(glossy("ceramic", [0.78, 0.77, 0.74], 0.12));
    let paper = b.material(lambert("paper", [0.8, 0.8, 0.78]));
    let leaf = b.material(glossy("leaf", [0.06, 0.19, 0.04], 0.4));
    let soil = b.material(lambert("soil", [0.05, 0.035, 0.025]));
    let picture = b.material(emitter("projection", [0.5, 0.75, 1.1]));
    let panel = b.material(emitter("panel", [11.0, 10.4, 9.4]));

    let [x, z, y] = ROOM;
    let mut room = Shape::default();
    let t = 0.2;
    room.wall(
        Vec3::new(-x - 0.3, -0.05, -z - t),
        Vec3::new(x + 0.3, y + 0.05, -z),
        true,
        &[],
    );
    let door = ([3.6, 4.6], [-1.0, 2.1]);
    room.wall(
        Vec3::new(-x - 0.3, -0.05, z),
        Vec3::new(x + 0.3, y + 0.06, z + t),
        true,
        &[door],
    );
    room.wall(
        Vec3::new(-x - t, -0.05, -z - 0.1),
        Vec3::new(-x, y + 0.07, z + 0.1),
        false,
        &[],
    );
    room.wall(
        Vec3::new(x, -0.05, -z - 0.1),
        Vec3::new(x + t, y + 0.08, z + 0.1),
        false,
        &[],
    );
    room.block(
        Vec3::new(-x - 0.4, y, -z - 0.4),
        Vec3::new(x + 0.4, y + 0.2, z + 0.4),
        1,
    );
    b.add("walls and ceiling", room, white);
    let mut floor = Shape::default();
    floor.block(
        Vec3::new(-x - 0.4, -0.2, -z - 0.4),
        Vec3::new(x + 0.4, 0.0, z + 0.4),
        1,
    );
    b.add("floor", floor, carpet);
    let mut leafs = Shape::default();
    leafs.block(
        Vec3::new(3.55, 0.005, z + 0.05),
        Vec3::new(4.65, 2.15, z + 0.1),
        1,
    );
    b.add("door", leafs, walnut);

    // Slats on the end wall and along the long ones.
    let mut slats = Shape::default();
    let count = f.of(110);
    for k in 0..count {
        let at = -z + 0.05 + (2.0 * z - 0.1) * (k as f32 + 0.5) / count as f32;
        let mut bar = Shape::default();
        bar.rounded_box(
            Vec3::new(0.025, 1.45, 0.3 * (2.0 * z) / count as f32),
            0.004,
            1,
        );
        slats.add(&bar, &Place::at(-x + 0.02, 1.48, at));
    }
    b.add("slats", slats, slat);
    let mut skirting = Shape::default();
    skirting.block(
        Vec3::new(-x - 0.01, -0.01, -z - 0.01),
        Vec3::new(x + 0.01, 0.09, -z + 0.015),
        1,
    );
    skirting.block(
        Vec3::new(-x - 0.02, -0.01, z - 0.015),
        Vec3::new(3.6, 0.09, z + 0.01),
        1,
    );
    b.add("skirting", skirting, walnut);

    // Panels hang a little below the ceiling: white boxes whose undersides glow.
    let (mut boxes, mut glow) = (Shape::default(), Shape::default());
    for i in 0..4 {
        for j in 0..3 {
            let (px, pz) = (-3.6 + 2.4 * i as f32, -2.1 + 2.1 * j as f32);
            boxes.block(
                Vec3::new(px - 0.63, y - 0.08, pz - 0.33),
                Vec3::new(px + 0.63, y - 0.03, pz + 0.33),
                1,
            );
            glow.rect(
                1,
                false,
                y - 0.081,
                [pz - 0.3, pz + 0.3],
                [px - 0.6, px + 0.6],
                1,
            );
            for (dx, dz) in [(-0.5, -0.25), (0.5, -0.25), (-0.5, 0.25), (0.5, 0.25)] {
                let mut rod = Shape::default();
                rod.cylinder(0.006, 0.06, 8);
                boxes.add(&rod, &Place::at(px + dx, y - 0.05, pz + dz));
            }
        }
    }
    b.add("panel boxes", boxes, white);
    b.add("panels", glow, panel);

    // An oval table of one thick board on two pedestals.
    let mut top = Shape::default();
    let outline = [
        (0.0, 0.7),
        (0.985, 0.7),
        (1.0, 0.712),
        (1.0, 0.738),
        (0.985, 0.75),
        (0.0, 0.75),
    ];
    top.lathe(&outline, f.of(160), false);
    let mut oval = Shape::default();
    oval.add(&top, &Place::HERE.scaled(Vec3::new(3.1, 1.0, 1.25)));
    b.add("table top", oval, walnut);
    let mut feet = Shape::default();
    for px in [-1.6, 1.6] {
        let mut foot = Shape::default();
        let profile = [
            (0.0, 0.0),
            (0.5, 0.0),
            (0.5, 0.02),
            (0.1, 0.06),
            (0.08, 0.6),
            (0.3, 0.705),
            (0.0, 0.71),
        ];
        foot.lathe(&profile, f.of(48), false);
        feet.add(&foot, &Place::at(px, 0.0, 0.0));
    }
    b.add("pedestals", feet, steel);

    let chair = b.model("chair", kit::office_chair(f, leather, steel));
    let laptop = b.model("laptop", laptop(f, dark, steel));
    let cup = b.model("cup", kit::vase(f, 0.09, 0.04, 0.1, ceramic));
    let sheet = {
        let mut shape = Shape::default();
        shape.block(
            Vec3::new(-0.105, 0.0, -0.148),
            Vec3::new(0.105, 0.0012, 0.148),
            1,
        );
        b.mesh("paper", shape, paper)
    };
    for side in [-1.0f32, 1.0] {
        for k in 0..6 {
            let px = -2.25 + 0.9 * k as f32;
            let bow = (1.0 - (px / 3.3) * (px / 3.3)).sqrt();
            let turn = if side > 0.0 { 0.5 } else { 0.0 };
            let wobble = rng.range(-0.05, 0.05);
            let pz = side * (1.25 * bow + 0.32);
            b.place(
                "chair",
                &chair,
                Place::at(px, 0.0, pz).turned_y(turn + wobble),
            );
            let edge = side * (1.25 * bow - 0.28);
            match rng.below(4) {
                0 | 1 => b.place(
                    "laptop",
                    &laptop,
                    Place::at(px, 0.7505, edge).turned_y(turn),
                ),
                _ => b.put(
                    "paper",
                    sheet,
                    Place::at(px, 0.7503, edge).turned_y(turn + wobble),
                ),
            }
            b.place(
                "cup",
                &cup,
                Place::at(px + 0.28, 0.7505, edge - side * 0.06),
            );
        }
    }
    for (px, turn) in [(-3.5, 0.25), (3.5, -0.25)] {
        b.place("chair", &chair, Place::at(px, 0.0, 0.0).turned_y(turn));
    }

    let mut frame = Shape::default();
    frame.rounded_box(Vec3::new(0.03, 0.72, 1.22), 0.02, f.edge(3));
    let mut hung = Shape::default();
    hung.add(&frame, &Place::at(x - 0.02, 1.65, 0.0));
    b.add("screen frame", hung, dark);
    let mut shown = Shape::default();
    shown.rect(0, false, x - 0.0505, [0.98, 2.32], [-1.18, 1.18], 1);
    b.add("screen", shown, picture);
    for (px, pz, h) in [(-5.0, 3.1, 1.7), (5.0, -3.1, 1.5), (-5.0, -3.1, 1.4)] {
        let plant = b.model("plant", kit::plant(f, h, ceramic, leaf, soil, &mut rng));
        b.place("plant", &plant, Place::at(px, 0.0, pz));
    }
    let mut board = kit::table(f, [2.2, 0.85, 0.45], walnut, steel);
    board.extend(
        kit::vase(f, 0.3, 0.09, 0.8, ceramic)
            .into_iter()
            .map(|(m, s)| {
                let mut raised = Shape::default();
                raised.add(&s, &Place::at(0.7, 0.8505, 0.0));
                (m, raised)
            }),
    );
    let sideboard = b.model("sideboard", board);
    b.place("sideboard", &sideboard, Place::at(0.5, 0.0, -3.33));
    b.camera(
        "overview",
        Vec3::new(-4.9, 1.9, 3.2),
        Vec3::new(0.9, 0.75, -0.5),
        58.0,
    );
    b.camera(
        "seat",
        Vec3::new(-3.3, 1.2, 0.0),
        Vec3::new(3.0, 1.0, 0.0),
        60.0,
    );
    b
}

fn laptop(f: Fineness, dark: u32, steel: u32) -> kit::Model {
    let (mut body, mut lid) = (Shape::default(), Shape::default());
    let mut slab = Shape::default();
    slab.rounded_box(Vec3::new(0.16, 0.008, 0.11), 0.006, f.edge(2));
    body.add(&slab, &Place::at(0.0, 0.0085, 0.0));
    for row in 0..5 {
        for column in 0..13 {
            let (x, z) = (-0.132 + 0.022 * column as f32, -0.06 + 0.02 * row as f32);
            lid.block(
                Vec3::new(x - 0.009, 0.015, z - 0.008),
                Vec3::new(x + 0.009, 0.0185, z + 0.008),
                1,
            );
        }
    }
    let mut screen = Shape::default();
    screen.rounded_box(Vec3::new(0.16, 0.105, 0.004), 0.0035, f.edge(2));
    lid.add(&screen, &Place::at(0.0, 0.118, 0.142).turned_x(0.05));
    // Hinged at the side away from the reader, who sits at -Z.
    vec![(steel, body), (dark, lid)]
}
