//! Quantized visibility against exact rays: what it promises, and that its counters add up.

#[path = "../common/mod.rs"]
mod common;
mod errors;
mod guarantees;
mod refusals;
mod sharing;

use common::{Random, Spheres};
use glam::Vec3;
use occlude_visibility::quantized::{BoundingSphere, Quantized, QuantizedSettings};
use occlude_visibility::{
    BLOCK, Correction, Endpoint, Exact, EyeSample, LightEnd, ManyLights, Query, SharedLight,
    Tracer, Visibility, VisibilityStats, order,
};

/// Eyes along each side of the floor, -1 to 1 in metres.
const SIDE: usize = 192;

fn strategy(settings: QuantizedSettings) -> Quantized {
    let bounds = BoundingSphere {
        centre: Vec3::ZERO,
        radius: 3f32.sqrt(),
    };
    Quantized::new(settings, bounds).unwrap()
}

/// A floor of eyes in asking order, with their places.
fn floor(first: f32) -> (Vec<[u32; 2]>, Vec<EyeSample>) {
    let places = order::progressive(SIDE as u32, SIDE as u32, first);
    let metres = 2.0 / SIDE as f32;
    let eyes = places
        .iter()
        .map(|&[x, y]| {
            let position = Vec3::new(
                (x as f32 + 0.5) * metres - 1.0,
                -1.0,
                (y as f32 + 0.5) * metres - 1.0,
            );
            EyeSample {
                end: Endpoint::new(position, Vec3::Y, 1.0 / (metres * metres)),
                origin: position,
            }
        })
        .collect();
    (places, eyes)
}

/// Points, directions, a lamp's samples and a sky's samples: 37 lights, so that blocks mix kinds and the last is not full.
fn lights(random: &mut Random) -> Vec<SharedLight> {
    let mut lights = Vec::new();
    let mut add = |end, target, connections| {
        lights.push(SharedLight {
            end,
            target,
            connections,
        })
    };
    for _ in 0..3 {
        let at = random.vector() * 0.5 + Vec3::Y;
        add(LightEnd::Point(at), Some(at), 1.0);
    }
    for _ in 0..2 {
        let towards = (random.vector() + 1.5 * Vec3::Y).normalize();
        add(LightEnd::Direction(towards), None, 1.0);
    }
    for _ in 0..16 {
        let at = Vec3::new(random.next() * 0.3, 1.0, random.next() * 0.3);
        let end = Endpoint::new(at, -Vec3::Y, 11.0);
        add(LightEnd::Surface(end), Some(at), 16.0);
    }
    for _ in 0..16 {
        let direction = (random.vector() + 1.2 * Vec3::Y).normalize();
        let density = 0.16;
        add(LightEnd::SolidAngle { direction, density }, None, 16.0);
    }
    lights
}

/// Asks about everything that `wants` and keeps the answers.
struct Everything<'a> {
    lights: usize,
    answers: Vec<Vec<f32>>,
    wants: &'a dyn Fn(usize, usize) -> bool,
}

impl ManyLights for Everything<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        for (eye, wanted) in wanted.iter_mut().enumerate() {
            assert_eq!(*wanted, 0);
            for l in 0..BLOCK.min(self.lights - block * BLOCK) {
                *wanted |= u16::from((self.wants)(eye, block * BLOCK + l)) << l;
            }
        }
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        let wants = self.wants;
        for (eye, visible) in visible.iter().enumerate() {
            for l in 0..BLOCK {
                let seen = visible >> l & 1 != 0;
                let light = block * BLOCK + l;
                if light < self.lights && wants(eye, light) {
                    self.answers[eye][light] = if seen { 1.0 } else { 0.0 };
                } else {
                    assert!(!seen);
                }
            }
        }
        for correction in corrections {
            let light = block * BLOCK + correction.light as usize;
            assert!(wants(correction.eye as usize, light));
            self.answers[correction.eye as usize][light] += correction.amount;
        }
    }
}

/// Answers of all eyes about all lights, NaN where not wanted.
fn ask_many<T: Tracer, V: Visibility<T>>(
    strategy: &V,
    tracer: &T,
    worker: &mut V::Worker,
    eyes: &[EyeSample],
    lights: &[SharedLight],
    wants: &dyn Fn(usize, usize) -> bool,
) -> Vec<Vec<f32>> {
    let mut asker = Everything {
        lights: lights.len(),
        answers: vec![vec![f32::NAN; lights.len()]; eyes.len()],
        wants,
    };
    strategy.answer_many(tracer, worker, eyes, lights, &mut asker);
    asker.answers
}

fn all(_: usize, _: usize) -> bool {
    true
}

/// The same questions one by one, eye by eye.
fn single(eyes: &[EyeSample], lights: &[SharedLight]) -> Vec<Query> {
    eyes.iter()
        .flat_map(|eye| lights.iter().map(|light| light.query(eye)))
        .collect()
}

fn worker(strategy: &Quantized) -> <Quantized as Visibility<Spheres>>::Worker {
    Visibility::<Spheres>::worker(strategy)
}

fn stats(
    strategy: &Quantized,
    worker: &<Quantized as Visibility<Spheres>>::Worker,
) -> VisibilityStats {
    Visibility::<Spheres>::stats(strategy, worker)
}

fn exact(world: &Spheres, eyes: &[EyeSample], lights: &[SharedLight]) -> Vec<Vec<f32>> {
    let mut worker = Visibility::<Spheres>::worker(&Exact);
    ask_many(&Exact, world, &mut worker, eyes, lights, &all)
}
