//! Embeds the visibility strategies around a foreign ray tracer: here two spheres, intersected analytically.
use glam::{Vec3, vec3};
use occlude_visibility::{Endpoint, LightEnd, Occluder, Query, Ray, Session};

const SPHERES: [(Vec3, f32); 2] = [(vec3(0.0, 1.0, 0.0), 1.0), (vec3(2.0, 0.5, 1.0), 0.5)];

/// Prints the shadows of two spheres.
pub fn main() {
    // Whatever answers "does anything block this segment?" is a tracer.
    let tracer = |ray: &Ray| {
        SPHERES.iter().any(|&(centre, radius)| {
            let t = (centre - ray.origin).dot(ray.direction) / ray.direction.length_squared();
            ray.at(t.clamp(ray.t_min, ray.t_max)).distance(centre) < radius
        })
    };
    // One strategy for all, one session for each thread.
    let strategy = Occluder::default();
    let mut session = Session::new(&tracer, &strategy);
    // Questions: points of a floor ask about a lamp, row by row.
    let lamp = vec3(1.0, 6.0, -1.0);
    for z in -12..=12 {
        let ask = |x: i32| {
            let eye = Endpoint::new(vec3(x as f32, 0.0, z as f32) * 0.25, Vec3::Y, 16.0);
            Query::new(eye, LightEnd::Point(lamp), Ray::between(eye.position, lamp))
        };
        let row: Vec<Query> = (-20..=20).map(ask).collect();
        let mut visible = vec![0.0; row.len()];
        session.answer(&row, &mut visible);
        println!(
            "{}",
            String::from_iter(visible.iter().map(|&v| if v > 0.5 { '.' } else { '#' }))
        );
    }
}
