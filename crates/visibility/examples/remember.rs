//! Remembers the shadows of a foreign ray tracer: spheres, intersected analytically, lit by a hundred lamps.
use glam::{Vec3, vec3};
use occlude_visibility::quantized::{BoundingSphere, Quantized, QuantizedSettings};
use occlude_visibility::{
    Correction, Endpoint, EyeSample, LightEnd, ManyLights, Ray, Session, SharedLight, order,
};

const SPHERES: [(Vec3, f32); 2] = [(vec3(0.0, 1.0, 0.0), 1.0), (vec3(2.0, 0.5, 1.0), 0.5)];

/// Every eye asks about every lamp, and adds up what it sees.
struct Floor(Vec<f32>);

impl ManyLights for Floor {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        wanted.fill(if block < 6 { 0xffff } else { 0xf }); // 100 lamps: 6 blocks of 16, and 4
    }
    fn take(&mut self, _: usize, visible: &[u16], _: &[Correction]) {
        for (sum, visible) in self.0.iter_mut().zip(visible) {
            *sum += visible.count_ones() as f32;
        }
    }
}

/// Prints how many rays the shadows of 100 lamps on 256 x 256 places of a floor take.
pub fn main() {
    let tracer = |ray: &Ray| {
        SPHERES.iter().any(|&(centre, radius)| {
            let t = (centre - ray.origin).dot(ray.direction) / ray.direction.length_squared();
            ray.at(t.clamp(ray.t_min, ray.t_max)).distance(centre) < radius
        })
    };
    let bounds = BoundingSphere {
        centre: Vec3::ZERO,
        radius: 12.0,
    };
    let strategy = Quantized::new(QuantizedSettings::default(), bounds).expect("legal settings");
    let mut session = Session::new(&tracer, &strategy);
    let eyes: Vec<EyeSample> = order::progressive(256, 256, 4096.0)
        .iter()
        .map(|&[x, z]| {
            let origin = vec3(x as f32 - 127.5, 0.0, z as f32 - 127.5) / 32.0;
            EyeSample {
                end: Endpoint::new(origin, Vec3::Y, 1024.0),
                origin,
            }
        })
        .collect();
    let lamp = |i: i32| {
        let target = vec3((i % 10) as f32 - 5.0, 6.0, (i / 10) as f32 - 5.0);
        SharedLight {
            end: LightEnd::Point(target),
            target: Some(target),
            connections: 1.0,
        }
    };
    let lamps: Vec<SharedLight> = (0..100).map(lamp).collect();
    let mut floor = Floor(vec![0.0; eyes.len()]);
    session.answer_many(&eyes, &lamps, &mut floor);
    let stats = session.stats();
    let reduction = stats.queries as f64 / stats.traced as f64;
    println!(
        "{} questions, {} rays: {reduction:.1} times fewer",
        stats.queries, stats.traced
    );
    assert!(reduction > 10.0 && floor.0.iter().any(|&lit| lit < 50.0));
}
