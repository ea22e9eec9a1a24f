//! Remembers the shadows of a triangle mesh: plates between a floor and a hundred lamps.
use glam::{Affine3A, Vec3, vec3};
use occlude_bvh::{Accel, InstanceInput, MeshInput, NoFilter};
use occlude_visibility::quantized::{BoundingSphere, Quantized};
use occlude_visibility::{EveryLight, EyeSample, Ray, Session, SharedLight, order};

/// Lights 256 x 256 places of a floor, and prints how many rays that takes.
pub fn main() {
    let plate = MeshInput {
        positions: &[vec3(-0.4, 0.0, -0.4), vec3(0.4, 0.2, 0.0), Vec3::Z * 0.5],
        triangles: &[[0, 1, 2]],
        filtered: false,
    };
    let place =
        |i: u32| Affine3A::from_translation(vec3((i % 3) as f32 - 1.0, 0.5, i as f32 - 4.0));
    let instance = |i| InstanceInput {
        mesh: 0,
        world_from_object: place(i),
    };
    let plates: Vec<InstanceInput> = (0..9).map(instance).collect();
    let accel = Accel::build(&[plate], &plates, &Default::default()).expect("legal meshes");
    let tracer = |ray: &Ray| accel.occluded(ray, &NoFilter);
    let (centre, radius) = (Vec3::ZERO, 12.0);
    let strategy = Quantized::new(Default::default(), BoundingSphere { centre, radius }).unwrap();
    let mut session = Session::new(&tracer, &strategy);
    let eyes: Vec<EyeSample> = order::progressive(512, 512, 16384.0)
        .iter()
        .map(|&[x, z]| vec3(x as f32 - 255.5, 0.0, z as f32 - 255.5) / 64.0)
        .map(|place| EyeSample::new(place, Vec3::Y, 4096.0))
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
    assert!(asked > 10 * traced && lit.iter().any(|&lit| lit < 90.0));
}
