//! `hairball`: a ball of thin curved strands, the hard case for any ray tracer: everything overlaps everything.

use super::builder::{Builder, emitter, glossy, lambert};
use super::math::{Place, Rng};
use super::shape::Shape;
use glam::Vec3;

/// Strands and their segments at the default detail: 25,000 x 20 x 6 triangles.
const STRANDS: f32 = 25_000.0;
const SEGMENTS: usize = 20;

pub(super) fn hairball(detail: f32, seed: u64) -> Builder {
    let mut b = Builder::new("hairball");
    let colors = [
        [0.35, 0.16, 0.06],
        [0.5, 0.3, 0.12],
        [0.16, 0.07, 0.035],
        [0.6, 0.45, 0.25],
    ];
    let strands = (STRANDS * detail).round().max(1.0) as usize;
    for (k, color) in colors.into_iter().enumerate() {
        let hair = b.material(glossy(&format!("hair {k}"), color, 0.4));
        let mut shape = Shape::default();
        // Each strand has its own random numbers: more of them do not move those that there are.
        for i in (k..strands).step_by(colors.len()) {
            strand(&mut shape, &mut Rng::new(seed, 16 + i as u64));
        }
        let mut raised = Shape::default();
        raised.add(&shape, &Place::at(0.0, 1.02, 0.0));
        b.add(&format!("strands {k}"), raised, hair);
    }
    let floor = b.material(lambert("floor", [0.6, 0.6, 0.58]));
    let mut ground = Shape::default();
    ground.block(Vec3::new(-6.0, -0.1, -6.0), Vec3::new(6.0, 0.0, 6.0), 1);
    b.add("floor", ground, floor);
    let lamp = b.material(emitter("lamp", [16.0, 15.0, 13.0]));
    let mut panel = Shape::default();
    panel.rect(1, false, 4.0, [0.0, 1.5], [-2.5, -1.0], 1);
    b.add("lamp", panel, lamp);
    b.sun(0.15, 0.12, Vec3::new(3.0, 2.7, 2.2));
    b.scene.sky = Vec3::new(0.35, 0.45, 0.6);
    b.camera(
        "camera",
        Vec3::new(0.0, 1.5, 4.2),
        Vec3::new(0.0, 0.95, 0.0),
        38.0,
    );
    b.camera(
        "inside",
        Vec3::new(0.0, 1.25, 1.05),
        Vec3::new(0.0, 1.0, 0.0),
        70.0,
    );
    b
}

/// A three-sided tube that starts near the centre and wanders outwards, held inside the unit ball.
fn strand(shape: &mut Shape, rng: &mut Rng) {
    let mut direction = rng.direction();
    let mut p = direction * 0.1;
    let axis = rng.direction();
    let curl = rng.range(0.05, 0.35);
    let (length, radius) = (rng.range(0.07, 0.14), rng.range(0.0010, 0.0022));
    let mut path = Vec::with_capacity(SEGMENTS + 1);
    let mut radii = Vec::with_capacity(SEGMENTS + 1);
    for k in 0..=SEGMENTS {
        path.push(p);
        radii.push(radius * (1.0 - 0.6 * k as f32 / SEGMENTS as f32));
        // Turn around the strand's own axis, jitter, and bend back where the ball ends.
        let pull = p * (p.length_squared() * p.length_squared() * 0.9);
        let turn = axis.cross(direction) * curl + rng.direction() * 0.25 - pull;
        direction = (direction + turn).normalize_or(direction);
        p += direction * length;
        let far = p.length();
        if far > 1.0 {
            p /= far;
        }
    }
    shape.tube(&path, &radii, 3);
}
