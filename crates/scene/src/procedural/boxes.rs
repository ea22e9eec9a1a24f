//! Small closed-form scenes: `cornell` and `furnace`.

use super::builder::{Builder, emitter, lambert};
use super::math::Place;
use super::shape::Shape;
use glam::Vec3;

/// Half the width and the depth of the box, and its height, metres (the measured one was about 55 cm a side).
const HALF: f32 = 0.275;
const HEIGHT: f32 = 0.55;

/// The box of Goral et al. 1984 as everybody draws it since: red and green walls, two blocks, a lamp in the ceiling, in
/// metres, open towards +Z.
pub(super) fn cornell(detail: f32) -> Builder {
    let n = cells(detail);
    let mut b = Builder::new("cornell");
    let white = b.material(lambert("white", [0.73, 0.73, 0.73]));
    let red = b.material(lambert("red", [0.63, 0.065, 0.05]));
    let green = b.material(lambert("green", [0.14, 0.45, 0.091]));
    let lamp = b.material(emitter("lamp", [26.0, 19.0, 8.5]));
    let (x, y) = ([-HALF, HALF], [0.0, HEIGHT]);
    let mut shell = Shape::default();
    shell.rect(1, true, 0.0, x, x, n);
    shell.rect(1, false, HEIGHT, x, x, n);
    shell.rect(2, true, -HALF, x, y, n);
    b.add("floor, ceiling and back wall", shell, white);
    let mut left = Shape::default();
    left.rect(0, true, -HALF, y, x, n);
    b.add("left wall", left, red);
    let mut right = Shape::default();
    right.rect(0, false, HALF, y, x, n);
    b.add("right wall", right, green);
    let [tall, short] = blocks(n);
    b.add("tall block", tall, white);
    b.add("short block", short, white);
    let mut panel = Shape::default();
    // Half a millimetre below the ceiling, facing down.
    panel.rect(
        1,
        false,
        HEIGHT - 0.0005,
        [-0.0525, 0.0525],
        [-0.065, 0.065],
        n,
    );
    b.add("lamp", panel, lamp);
    b.camera(
        "camera",
        Vec3::new(0.0, 0.275, 1.075),
        Vec3::new(0.0, 0.275, 0.0),
        39.3,
    );
    b
}

/// A closed room where radiance is 1 everywhere: every surface reflects half and emits half, `L = 0.5 + 0.5 L`.
///
/// Shading is flat and nothing is specular, so the answer is exact for any path tracer, whatever stands in the room.
pub(super) fn furnace(detail: f32) -> Builder {
    let n = cells(detail);
    let mut b = Builder::new("furnace");
    let mut material = lambert("furnace", [0.5; 3]);
    material.emission = Vec3::splat(0.5);
    let material = b.material(material);
    let mut room = Shape::default();
    room.block(
        Vec3::new(-HALF, 0.0, -HALF),
        Vec3::new(HALF, HEIGHT, 5.0 * HALF),
        n,
    );
    let [tall, short] = blocks(n);
    let mut ball = Shape::default();
    ball.sphere(0.07, 4 * n + 8);
    let mut raised = Shape::default();
    raised.add(&ball, &Place::at(-0.05, 0.2, 0.22));
    for (name, mut shape) in [
        ("room", room.inverted()),
        ("tall block", tall),
        ("short block", short),
        ("ball", raised),
    ] {
        shape.normals.clear();
        b.add(name, shape, material);
    }
    b.camera(
        "camera",
        Vec3::new(0.0, 0.275, 1.075),
        Vec3::new(0.0, 0.275, 0.0),
        39.3,
    );
    b
}

/// Cells along the side of each of about 17 squares.
fn cells(detail: f32) -> u32 {
    (detail.sqrt().round() as u32).max(1)
}

/// A tall block at the back left and a low one at the front right; they stand a millimetre in the floor, so that no
/// faces coincide.
fn blocks(n: u32) -> [Shape; 2] {
    let block = |height: f32, place: Place| {
        let mut straight = Shape::default();
        straight.block(
            Vec3::new(-0.0825, -0.001, -0.0825),
            Vec3::new(0.0825, height, 0.0825),
            n,
        );
        let mut turned = Shape::default();
        turned.add(&straight, &place);
        turned
    };
    [
        block(0.33, Place::at(-0.092, 0.0, -0.078).turned_y(0.05)),
        block(0.165, Place::at(0.092, 0.0, 0.108).turned_y(-0.047)),
    ]
}
