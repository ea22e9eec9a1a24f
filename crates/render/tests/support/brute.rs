//! A path tracer that is too simple to be wrong: every triangle tried for every ray, in double precision, directions by the
//! cosine, no light sampling, no roulette, no hierarchy, its own random numbers. Lambert surfaces alone; emission leaves the
//! front (and the back, if double-sided).

use glam::{DVec3, Vec2};
use occlude_render::camera::View;
use occlude_scene::{Pose, Scene};
use occlude_testkit::picture::Picture;

struct Triangle {
    corners: [DVec3; 3],
    normal: DVec3,
    albedo: DVec3,
    emission: DVec3,
    double_sided: bool,
}

struct Random(u64);

impl Random {
    /// Uniform in [0, 1): splitmix64.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn triangles(scene: &Scene, pose: &Pose) -> Vec<Triangle> {
    let mut all = Vec::new();
    for (i, instance) in pose.instances.iter().enumerate() {
        let mesh = &scene.meshes[instance.mesh as usize];
        let material = &scene.materials[mesh.material as usize];
        for &indices in &mesh.triangles {
            let corner = |v: u32| {
                let p = pose.positions(scene, i)[v as usize];
                instance.world_from_object.transform_point3(p).as_dvec3()
            };
            let corners = indices.map(corner);
            let normal = (corners[1] - corners[0])
                .cross(corners[2] - corners[0])
                .normalize();
            all.push(Triangle {
                corners,
                normal,
                albedo: material.base_color.truncate().as_dvec3(),
                emission: material.emission.as_dvec3(),
                double_sided: material.double_sided,
            });
        }
    }
    all
}

/// The nearest triangle that the ray meets, and where. Starts are on surfaces: `from` is the triangle that is left.
fn nearest(
    triangles: &[Triangle],
    origin: DVec3,
    direction: DVec3,
    from: Option<usize>,
) -> Option<(usize, DVec3)> {
    let mut best = (f64::INFINITY, None);
    for (i, triangle) in triangles.iter().enumerate() {
        if Some(i) == from {
            continue;
        }
        let [a, b, c] = triangle.corners;
        let (e1, e2) = (b - a, c - a);
        let p = direction.cross(e2);
        let determinant = e1.dot(p);
        if determinant == 0.0 {
            continue;
        }
        let s = origin - a;
        let u = s.dot(p) / determinant;
        let q = s.cross(e1);
        let v = direction.dot(q) / determinant;
        let t = e2.dot(q) / determinant;
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 1e-9 && t < best.0 {
            best = (t, Some(i));
        }
    }
    best.1.map(|i| (i, origin + direction * best.0))
}

/// Radiance along one random path with at most `max_depth` scattering events.
fn radiance(
    scene: &Scene,
    triangles: &[Triangle],
    start: (DVec3, DVec3),
    max_depth: u32,
    random: &mut Random,
) -> DVec3 {
    let (mut origin, mut direction) = start;
    let (mut throughput, mut sum, mut from) = (DVec3::ONE, DVec3::ZERO, None);
    for depth in 0..=max_depth {
        let Some((i, point)) = nearest(triangles, origin, direction, from) else {
            return sum + throughput * scene.sky.as_dvec3();
        };
        let triangle = &triangles[i];
        let front = triangle.normal.dot(direction) < 0.0;
        if front || triangle.double_sided {
            sum += throughput * triangle.emission;
        }
        if depth == max_depth {
            break;
        }
        throughput *= triangle.albedo;
        // A point of the unit sphere, added to the normal, has the cosine's density.
        let normal = if front {
            triangle.normal
        } else {
            -triangle.normal
        };
        let z = 2.0 * random.next() - 1.0;
        let (sin, cos) = (std::f64::consts::TAU * random.next()).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        direction = (normal + DVec3::new(ring * cos, ring * sin, z)).normalize();
        (origin, from) = (point, Some(i));
    }
    sum
}

/// The scene's first camera by brute force: mean and variance of the mean of every pixel.
pub fn render(
    scene: &Scene,
    size: (u32, u32),
    samples: u32,
    max_depth: u32,
) -> (Vec<f32>, Vec<f32>) {
    let pose = Pose::at(scene, 0.0);
    let triangles = triangles(scene, &pose);
    let view = View::of_camera(scene, &pose, 0, size.0, size.1);
    let (mut mean, mut variance) = (Vec::new(), Vec::new());
    for y in 0..size.1 {
        for x in 0..size.0 {
            let mut random = Random(u64::from(y) << 32 | u64::from(x) << 16);
            let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
            for _ in 0..samples {
                let point = Vec2::new(
                    x as f32 + random.next() as f32,
                    y as f32 + random.next() as f32,
                );
                let ray = view.ray(point).ray;
                let start = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
                let value = radiance(scene, &triangles, start, max_depth, &mut random);
                sum += value;
                squares += value * value;
            }
            let n = f64::from(samples);
            let m = sum / n;
            mean.extend(m.as_vec3().to_array());
            variance.extend(((squares / n - m * m) / (n - 1.0)).as_vec3().to_array());
        }
    }
    (mean, variance)
}

/// Where a stored reference lies.
fn path(name: &str) -> std::path::PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/references")
        .join(name)
        .with_extension("f32")
}

/// Stores mean and variance as little-endian numbers, one after the other.
pub fn store(name: &str, mean: &[f32], variance: &[f32]) {
    let bytes: Vec<u8> = mean
        .iter()
        .chain(variance)
        .flat_map(|v| v.to_le_bytes())
        .collect();
    std::fs::write(path(name), bytes).unwrap();
}

/// A stored reference of `samples` samples a pixel.
pub fn load(name: &str, size: (u32, u32), samples: u32) -> Picture {
    let bytes = std::fs::read(path(name)).unwrap();
    let values: Vec<f32> = bytes
        .as_chunks()
        .0
        .iter()
        .map(|&b| f32::from_le_bytes(b))
        .collect();
    let (mean, variance) = values.split_at(values.len() / 2);
    Picture::from_variance(
        size.0 as usize,
        size.1 as usize,
        3,
        mean,
        variance,
        f64::from(samples),
    )
}
