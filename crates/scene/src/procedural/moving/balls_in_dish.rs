//! `balls-in-dish`: two balls roll in a dish and meet. 30,000 vertices. Their course is a simulation, kept as keys.

use super::super::builder::{Builder, glossy, metal};
use super::super::shape::Shape;
use super::{Noise, RATE, roughness_texel, smooth, steps};
use crate::{Material, Target};
use glam::{Affine3A, Vec3, vec3};

const SECONDS: f32 = 5.0;
/// Radius of the hollow, of its rim and of a ball, metres; the hollow's lowest point.
const HOLLOW: f32 = 2.0;
const RIM: f32 = 1.0;
const BALL: f32 = 0.18;
const LOWEST: f32 = 0.06;
/// Simulated steps a key.
const STEPS: u32 = 40;

pub(in super::super) fn balls_in_dish(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("balls-in-dish");
    b.scene.sky = Vec3::splat(0.6);
    let glaze = glaze(&mut b, seed);
    let table = table(&mut b, seed);
    let balls = [
        b.material(glossy("red ball", [0.55, 0.05, 0.04], 0.25)),
        b.material(metal("brass ball", [0.85, 0.62, 0.3], 0.32)),
    ];
    let mut dish = Shape::default();
    dish.lathe(&profile(steps(83, detail)), steps(180, detail), true);
    b.add("dish", dish, glaze);
    let mut ground = Shape::default();
    let cells = steps(72, detail);
    ground.rect(1, true, 0.0, [-2.2, 2.2], [-2.2, 2.2], cells);
    b.add("table", ground, table);

    let courses = simulate();
    for (k, (material, course)) in balls.into_iter().zip(courses).enumerate() {
        let mut shape = Shape::default();
        shape.sphere(BALL, steps(96, detail));
        let mesh = b.mesh(&format!("ball {k}"), shape, material);
        let node = b.node(
            &format!("ball {k}"),
            Affine3A::from_translation(course[0].place),
        );
        b.place_on(mesh, node);
        let at = |time: f32| &course[(time * RATE).round() as usize];
        b.keys(node, Target::Translation, SECONDS, |time| {
            at(time).place.to_array()
        });
        b.keys(node, Target::Rotation, SECONDS, |time| at(time).turn);
    }
    b.camera("camera", vec3(0.0, 1.9, 2.5), vec3(0.0, 0.12, 0.05), 40.0);
    b.camera("low", vec3(2.0, 0.75, 1.5), vec3(0.0, 0.15, 0.0), 38.0);
    b
}

/// Outline of the dish from the middle of its foot around the rim to its lowest inner point.
fn profile(rows: u32) -> Vec<(f32, f32)> {
    let height = |r: f32| LOWEST + HOLLOW - (HOLLOW * HOLLOW - r * r).sqrt();
    let below = (rows / 3).max(2);
    let above = rows - below;
    let mut points: Vec<(f32, f32)> = (0..below)
        .map(|i| {
            let r = (RIM + 0.04) * i as f32 / below as f32;
            (r, 0.004 + (height(r) - LOWEST) * smooth(0.35, 0.75, r))
        })
        .collect();
    points.push((RIM + 0.05, height(RIM) - 0.01));
    points.push((RIM + 0.03, height(RIM) + 0.02));
    points.extend((0..above).map(|i| {
        let r = RIM * (1.0 - i as f32 / (above - 1) as f32);
        (r, height(r))
    }));
    points
}

/// A ball at one time.
#[derive(Clone, Copy)]
struct State {
    place: Vec3,
    velocity: Vec3,
    turn: [f32; 4],
}

/// Both balls at every key: solid spheres that roll without slipping (five sevenths of the acceleration of a slide) and
/// bounce off each other. Additions, products, quotients and roots alone: the same bits everywhere.
fn simulate() -> [Vec<State>; 2] {
    let centre = vec3(0.0, LOWEST + HOLLOW, 0.0);
    let track = HOLLOW - BALL;
    let start = |x: f32, z: f32, velocity: Vec3| {
        let y = centre.y - (track * track - x * x - z * z).sqrt();
        State {
            place: vec3(x, y, z),
            velocity,
            turn: [0.0, 0.0, 0.0, 1.0],
        }
    };
    let mut balls = [
        start(-0.66, 0.1, vec3(0.0, 0.0, 0.2)),
        start(0.55, -0.2, vec3(0.2, 0.0, -0.4)),
    ];
    let mut courses = [vec![balls[0]], vec![balls[1]]];
    let dt = 1.0 / (RATE * STEPS as f32);
    let keys = (SECONDS * RATE).round() as u32;
    for _ in 0..keys {
        for _ in 0..STEPS {
            for ball in &mut balls {
                let normal = (centre - ball.place) / track;
                let gravity = vec3(0.0, -9.81, 0.0);
                let along = gravity - normal * gravity.dot(normal);
                ball.velocity += along * (5.0 / 7.0 * dt);
                ball.velocity *= 1.0 - 0.05 * dt;
                ball.place += ball.velocity * dt;
                // Back onto the track.
                let out = ball.place - centre;
                let unit = out / out.dot(out).sqrt();
                ball.place = centre + unit * track;
                ball.velocity -= unit * ball.velocity.dot(unit);
                let spin = (-unit).cross(ball.velocity) / BALL;
                ball.turn = turned(ball.turn, spin * dt);
            }
            let apart = balls[1].place - balls[0].place;
            let distance = apart.dot(apart).sqrt();
            if distance < 2.0 * BALL {
                let unit = apart / distance;
                let closing = (balls[0].velocity - balls[1].velocity).dot(unit);
                if closing > 0.0 {
                    balls[0].velocity -= unit * closing;
                    balls[1].velocity += unit * closing;
                }
            }
        }
        for (course, ball) in courses.iter_mut().zip(&balls) {
            course.push(*ball);
        }
    }
    courses
}

/// A quaternion after a small turn in world space.
fn turned([x, y, z, w]: [f32; 4], turn: Vec3) -> [f32; 4] {
    let h = turn * 0.5;
    let moved = [
        x + h.x * w + h.y * z - h.z * y,
        y + h.y * w + h.z * x - h.x * z,
        z + h.z * w + h.x * y - h.y * x,
        w - h.x * x - h.y * y - h.z * z,
    ];
    let length = moved.iter().map(|v| v * v).sum::<f32>().sqrt();
    moved.map(|v| v / length)
}

/// Glazed stoneware: rings, some polished.
fn glaze(b: &mut Builder, seed: u64) -> u32 {
    const SIDE: u32 = 256;
    let noise = Noise::new(16, seed, 1);
    let value = move |x: u32, y: u32| {
        let (u, v) = (x as f32 / SIDE as f32, y as f32 / SIDE as f32);
        (noise.at(u, v), (y / 16).is_multiple_of(2))
    };
    let color = b.picture("glaze", SIDE, |x, y| {
        let (noise, ring) = value(x, y);
        let base = if ring {
            [70.0, 110.0, 140.0]
        } else {
            [190.0, 186.0, 170.0]
        };
        base.map(|c: f32| (c * (0.85 + 0.15 * noise)) as u8)
    });
    let roughness = b.data_picture("glaze roughness", SIDE, |x, y| {
        let (noise, ring) = value(x, y);
        roughness_texel(if ring { 0.2 } else { 0.4 } + 0.15 * noise)
    });
    b.material(Material {
        base_color_texture: Some(color),
        metallic_roughness_texture: Some(roughness),
        ..glossy("glaze", [1.0; 3], 1.0)
    })
}

/// A varnished board.
fn table(b: &mut Builder, seed: u64) -> u32 {
    const SIDE: u32 = 256;
    let noise = Noise::new(12, seed, 2);
    let grain = move |x: u32, y: u32| {
        let (u, v) = (x as f32 / SIDE as f32, y as f32 / SIDE as f32);
        let bend = noise.at(u, v);
        super::sin(9.0 * v + 0.8 * bend) * 0.5 + 0.5
    };
    let color = b.picture("board", SIDE, |x, y| {
        let grain = grain(x, y);
        [
            120.0 + 40.0 * grain,
            82.0 + 30.0 * grain,
            50.0 + 20.0 * grain,
        ]
        .map(|c| c as u8)
    });
    let roughness = b.data_picture("board roughness", SIDE, |x, y| {
        roughness_texel(0.45 + 0.25 * grain(x, y))
    });
    b.material(Material {
        base_color_texture: Some(color),
        metallic_roughness_texture: Some(roughness),
        double_sided: true,
        ..glossy("board", [1.0; 3], 1.0)
    })
}
