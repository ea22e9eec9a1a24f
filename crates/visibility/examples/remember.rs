//! Remembers the shadows of a foreign ray tracer: spheres, intersected analytically, lit by a hundred lamps.
use glam::{Vec3, vec3};
use occlude_visibility::quantized::{BoundingSphere, Quantized};
use occlude_visibility::{EveryLight, EyeSample, Ray, Session, SharedLight, order};

/// Lights 256 x 256 places of a floor, and prints how many rays that takes.
pub fn main() {
    let spheres = [(vec3(0.0, 1.0, 0.0), 1.0), (vec3(2.0, 0.5, 1.0), 0.5)];
    let tracer = |ray: &Ray| {
        spheres.iter().any(|&(centre, radius)| {
            let t = (centre - ray.origin).dot(ray.direction) / ray.direction.length_squared();
            ray.at(t.clamp(ray.t_min, ray.t_max)).distance(centre) < radius
        })
    };
    let (centre, radius) = (Vec3::ZERO, 12.0);
    let strategy = Quantized::new(Default::default(), BoundingSphere { centre, radius });
    let strategy = strategy.expect("the default settings are legal");
    let mut session = Session::new(&tracer, &strategy);
    let eyes: Vec<EyeSample> = order::progressive(256, 256, 4096.0)
        .iter()
        .map(|&[x, z]| vec3(x as f32 - 127.5, 0.0, z as f32 - 127.5) / 32.0)
        .map(|place| EyeSample::new(place, Vec3::Y, 1024.0))
        .collect();
    let lamps: Vec<SharedLight> = (0..100)
        .map(|i| vec3((i % 10) as f32 - 5.0, 6.0, (i / 10) as f32 - 5.0))
        .map(SharedLight::point)
        .collect();
    let mut lit = vec![0.0; eyes.len()];
    let sum = |eye: usize, _lamp: usize, visibility: f32| lit[eye] += visibility;
    session.answer_many(&eyes, &lamps, &mut EveryLight(lamps.len(), sum));
    let (asked, traced) = (session.stats().queries, session.stats().traced);
    println!("{asked} questions, {traced} rays");
    assert!(asked > 10 * traced && lit.iter().any(|&lit| lit < 50.0));
}
