//! `many-lights`: a store house with 10,000 small lights between its racks; from any point only a few matter.

use super::builder::{Builder, emitter, lambert, metal};
use super::math::{Place, Rng};
use super::shape::Shape;
use glam::{Vec3, vec3};

/// Point lights, and bulbs with a surface.
const POINTS: usize = 9_600;
const BULBS: usize = 400;

pub(super) fn many_lights(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("many-lights");
    let mut rng = Rng::new(seed, 1);
    let plaster = b.material(lambert("plaster", [0.6, 0.6, 0.58]));
    let floor = b.material(lambert("floor", [0.35, 0.34, 0.33]));
    let steel = b.material(metal("rack", [0.3, 0.32, 0.36], 0.4));
    let boxes = [
        b.material(lambert("cardboard", [0.45, 0.3, 0.16])),
        b.material(lambert("blue crate", [0.06, 0.13, 0.35])),
        b.material(lambert("white crate", [0.7, 0.7, 0.68])),
    ];
    let glow = [
        b.material(emitter("warm bulb", [60.0, 34.0, 12.0])),
        b.material(emitter("cold bulb", [16.0, 30.0, 60.0])),
    ];
    let (x, y, z) = (30.0, 7.0, 20.0);
    let mut hall = Shape::default();
    hall.wall(
        vec3(-x - 0.5, -0.1, -z - 0.3),
        vec3(x + 0.5, y + 0.1, -z),
        true,
        &[],
    );
    hall.wall(
        vec3(-x - 0.5, -0.1, z),
        vec3(x + 0.5, y + 0.11, z + 0.3),
        true,
        &[],
    );
    hall.wall(
        vec3(-x - 0.3, -0.1, -z - 0.1),
        vec3(-x, y + 0.12, z + 0.1),
        false,
        &[],
    );
    hall.wall(
        vec3(x, -0.1, -z - 0.1),
        vec3(x + 0.3, y + 0.13, z + 0.1),
        false,
        &[],
    );
    hall.block(
        vec3(-x - 0.6, y, -z - 0.6),
        vec3(x + 0.6, y + 0.3, z + 0.6),
        1,
    );
    b.add("walls and ceiling", hall, plaster);
    let mut ground = Shape::default();
    ground.block(
        vec3(-x - 0.6, -0.3, -z - 0.6),
        vec3(x + 0.6, 0.0, z + 0.6),
        1,
    );
    b.add("floor", ground, floor);

    // Racks along X; aisles of 2 m between them.
    let (mut rack, mut goods) = (Shape::default(), vec![Shape::default(); boxes.len()]);
    let rows = 10;
    let middle = |row: usize| -z + 2.5 + 3.9 * row as f32;
    for row in 0..rows {
        let w = middle(row);
        for bay in 0..=18 {
            let u = -27.0 + 3.0 * bay as f32;
            for side in [-0.75, 0.75] {
                rack.block(
                    vec3(u - 0.05, -0.05, w + side - 0.05),
                    vec3(u + 0.05, 5.6, w + side + 0.05),
                    1,
                );
            }
        }
        for level in 0..4 {
            let h = 0.15 + 1.45 * level as f32;
            rack.block(
                vec3(-27.06, h - 0.04, w - 0.79),
                vec3(27.06, h, w + 0.79),
                1,
            );
            let mut u = -26.8;
            while u < 26.0 {
                let wide = rng.range(0.4, 1.3);
                let kind = rng.below(boxes.len() + 1);
                if let Some(shape) = goods.get_mut(kind) {
                    let mut crate_ = Shape::default();
                    let half = vec3(wide / 2.0, rng.range(0.15, 0.6), rng.range(0.3, 0.68));
                    crate_.rounded_box(half, 0.02, (detail.sqrt().round() as u32).clamp(1, 64));
                    shape.add(&crate_, &Place::at(u + wide / 2.0, h + half.y + 0.001, w));
                }
                u += wide + 0.1;
            }
        }
    }
    b.add("racks", rack, steel);
    for (shape, material) in goods.into_iter().zip(boxes) {
        b.add("goods", shape, material);
    }
    // Lights hang in the aisles and stick to the racks' edges. Their powers span three decades.
    let at = |rng: &mut Rng| {
        let row = rng.below(rows + 1);
        let w = if row == 0 {
            -z + 0.8
        } else {
            middle(row - 1) + rng.range(0.9, 2.9)
        };
        vec3(rng.range(-29.5, 29.5), rng.range(0.3, 6.6), w.min(z - 0.3))
    };
    for _ in 0..POINTS {
        let position = at(&mut rng);
        let power = 0.03 * (1.0 + 60.0 * rng.unit() * rng.unit() * rng.unit() * rng.unit());
        let hue = rng.unit();
        let color = vec3(1.0, 0.45 + 0.4 * hue, 0.15 + 0.75 * hue * hue);
        b.point_light("", position, color * power);
    }
    let mut bulb = Shape::default();
    bulb.sphere(0.03, 10);
    let bulbs = glow.map(|material| b.mesh("bulb", bulb.clone(), material));
    let mut places = [Vec::new(), Vec::new()];
    for _ in 0..BULBS {
        let p = at(&mut rng);
        places[rng.below(2)].push(Place {
            offset: p,
            ..Place::HERE
        });
    }
    for (mesh, places) in bulbs.into_iter().zip(places) {
        b.scatter("bulbs", &[mesh], &places);
    }
    b.camera(
        "above the racks",
        vec3(-28.0, 6.3, 17.5),
        vec3(8.0, 0.5, -6.0),
        62.0,
    );
    b.camera(
        "aisle",
        vec3(-29.0, 1.7, -3.35),
        Vec3::new(0.0, 2.0, -3.35),
        62.0,
    );
    b
}
