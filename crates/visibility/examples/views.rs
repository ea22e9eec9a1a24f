//! Draws what a cache does: which patches pixels fall into, how often answers were refined, and which share of them was traced.
//!
//! `cargo run --release -p occlude-visibility --example views -- FOLDER` writes three pictures of the shadows of two spheres.
use glam::{Vec3, vec3};
use occlude_visibility::quantized::{
    BoundingSphere, ErrorReach, Quantized, QuantizedSettings, Share,
};
use occlude_visibility::{Endpoint, Epoch, LightEnd, Query, Ray, Session, order};
use std::path::Path;

const SIDE: u32 = 256;

/// A false colour for any number: distinct for neighbours.
fn colour(number: u64) -> [u8; 3] {
    let mixed = number.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes();
    [mixed[0] | 0x20, mixed[1] | 0x20, mixed[2] | 0x20]
}

/// From black over red and yellow to white.
fn heat(share: f64) -> [u8; 3] {
    [0.0, 1.0, 2.0].map(|from| (255.0 * (3.0 * share - from).clamp(0.0, 1.0)) as u8)
}

/// Writes the pictures `patches.ppm`, `refined.ppm` and `traced.ppm`; returns how bright each is on average.
pub fn draw(folder: &Path) -> std::io::Result<[f64; 3]> {
    let spheres = [(vec3(0.0, 1.0, 0.0), 1.0), (vec3(2.0, 0.5, 1.0), 0.5)];
    let tracer = |ray: &Ray| {
        spheres.iter().any(|&(centre, radius)| {
            let t = (centre - ray.origin).dot(ray.direction) / ray.direction.length_squared();
            ray.at(t.clamp(ray.t_min, ray.t_max)).distance(centre) < radius
        })
    };
    let settings = QuantizedSettings {
        error: ErrorReach::all(8.0),
        // The cache must outlive the questions of a pixel.
        share: Share::Thread,
        ..Default::default()
    };
    let (centre, radius) = (Vec3::ZERO, 12.0);
    let strategy = Quantized::new(settings, BoundingSphere { centre, radius });
    let strategy = strategy.expect("legal settings");
    let mut session = Session::new(&tracer, &strategy);
    let lamps: Vec<Vec3> = (0..25)
        .map(|i| vec3((i % 5) as f32 - 2.0, 6.0, (i / 5) as f32 - 2.0))
        .collect();
    let mut pictures = [(); 3].map(|()| vec![[0u8; 3]; (SIDE * SIDE) as usize]);
    for [x, y] in order::progressive(SIDE, SIDE, 1024.0) {
        let place = vec3(x as f32 - 127.5, 0.0, y as f32 - 127.5) / 32.0;
        let eye = Endpoint::new(place, Vec3::Y, 1024.0);
        let ask = |&lamp: &Vec3| Query::new(eye, LightEnd::Point(lamp), Ray::between(place, lamp));
        let queries: Vec<Query> = lamps.iter().map(ask).collect();
        // What a pixel costs is what the counters grow by.
        let before = session.stats();
        session.answer(&queries, &mut vec![0.0; queries.len()]);
        let after = session.stats();
        let refined =
            |stats: &occlude_visibility::VisibilityStats| stats.refined.iter().sum::<u64>();
        let share = |count: u64| count as f64 / queries.len() as f64;
        let patch = strategy.patches(&queries[0], Epoch::default(), 0);
        let pixel = (y * SIDE + x) as usize;
        pictures[0][pixel] = patch.map_or([0; 3], |patch| colour(patch.digest));
        pictures[1][pixel] = heat(share(refined(&after) - refined(&before)));
        pictures[2][pixel] = heat(share(after.traced - before.traced));
    }
    std::fs::create_dir_all(folder)?;
    for (name, picture) in ["patches", "refined", "traced"].iter().zip(&pictures) {
        let header = format!("P6 {SIDE} {SIDE} 255\n").into_bytes();
        let pixels = picture.iter().flatten().copied();
        let bytes: Vec<u8> = header.into_iter().chain(pixels).collect();
        std::fs::write(folder.join(name).with_extension("ppm"), bytes)?;
    }
    Ok(pictures.map(|picture| {
        let sum: f64 = picture.iter().flatten().map(|&v| f64::from(v)).sum();
        sum / (3.0 * picture.len() as f64)
    }))
}

#[allow(dead_code, reason = "the test draws without it")]
fn main() -> std::io::Result<()> {
    let folder = std::env::args().nth(1).unwrap_or("target/views".into());
    draw(Path::new(&folder))?;
    println!("written to {folder}");
    Ok(())
}
