//! Random triangles and rays, and the brute-force oracle.
#![allow(dead_code)]

use glam::{Affine3A, DVec3, Quat, Vec3};
use occlude_bvh::{Accel, BuildOptions, InstanceInput, MeshInput, Simd};
pub use occlude_testkit::random::Random;
use occlude_visibility::{Hit, Ray};

/// A random rotation, translation and mirroring scale.
pub fn transform(random: &mut Random) -> Affine3A {
    let scale = Vec3::new(
        0.3 + random.unit(),
        0.3 + random.unit(),
        -0.3 - random.unit(),
    );
    let rotation = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
    Affine3A::from_scale_rotation_translation(scale, rotation, random.point() * 3.0)
}

/// A mesh that owns its arrays.
#[derive(Clone, Debug, Default)]
pub struct Soup {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub filtered: bool,
}

impl Soup {
    pub fn random(random: &mut Random, triangles: usize, size: f32) -> Self {
        let mut soup = Self::default();
        for _ in 0..triangles {
            let c = random.point();
            // Sizes over three decades.
            let s = size * 10f32.powf(-3.0 * random.unit());
            soup.push([0; 3].map(|_| c + random.point() * s));
        }
        soup
    }

    pub fn push(&mut self, corners: [Vec3; 3]) {
        let first = self.positions.len() as u32;
        self.positions.extend(corners);
        self.triangles.push([first, first + 1, first + 2]);
    }

    /// A closed sphere with shared vertices.
    pub fn sphere(rings: usize, segments: usize) -> Self {
        let mut soup = Self::default();
        let at = |i: usize, j: usize| {
            let (theta, phi) = (
                std::f32::consts::PI * i as f32 / rings as f32,
                std::f32::consts::TAU * (j % segments) as f32 / segments as f32,
            );
            match i {
                0 => Vec3::Y,
                i if i == rings => Vec3::NEG_Y,
                _ => Vec3::new(
                    theta.sin() * phi.cos(),
                    theta.cos(),
                    theta.sin() * phi.sin(),
                ),
            }
        };
        for i in 0..rings {
            for j in 0..segments {
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                if i + 1 < rings {
                    soup.push([a, b, c]);
                }
                if i > 0 {
                    soup.push([a, c, d]);
                }
            }
        }
        soup
    }

    pub fn map(mut self, f: impl Fn(Vec3) -> Vec3) -> Self {
        self.positions.iter_mut().for_each(|p| *p = f(*p));
        self
    }

    pub fn input(&self) -> MeshInput<'_> {
        MeshInput {
            positions: &self.positions,
            triangles: &self.triangles,
            filtered: self.filtered,
        }
    }

    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    pub fn accel(&self, options: &BuildOptions) -> Accel {
        let accel = Accel::build(&[self.input()], &[identity()], options).unwrap();
        accel.validate().unwrap();
        accel
    }
}

pub fn identity() -> InstanceInput {
    InstanceInput {
        mesh: 0,
        world_from_object: Affine3A::IDENTITY,
    }
}

pub fn watertight() -> BuildOptions {
    BuildOptions {
        watertight: true,
        ..Default::default()
    }
}

/// One hit of the oracle: where, and by how much (relative) the ray clears the nearest edge or end; near 0 is a matter of
/// rounding.
#[derive(Clone, Copy, Debug)]
pub struct Exact {
    pub t: f64,
    pub u: f64,
    pub v: f64,
    pub margin: f64,
}

/// Ray against triangle in double precision. Misses by less than `margin` count as hits with a negative margin.
pub fn exact(ray: &Ray, corners: [Vec3; 3], margin: f64) -> Option<Exact> {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let p = d.cross(e2);
    let det = e1.dot(p);
    if det == 0.0 {
        return None;
    }
    let s = o - a;
    let u = s.dot(p) / det;
    let q = s.cross(e1);
    let v = d.dot(q) / det;
    let t = e2.dot(q) / det;
    // How far rounding to f32 can move the barycentrics: coordinates against the triangle's projected size.
    let reach = s.length().max(e1.length()).max(e2.length()) + o.abs().max_element() * 1e-3;
    let sharp = det.abs() / (d.length() * e1.length().max(e2.length()));
    let rounding = (reach / sharp).max(1.0) * margin;
    let inside = u.min(v).min(1.0 - u - v);
    let (near, far) = (t - f64::from(ray.t_min), f64::from(ray.t_max) - t);
    let ends = near.min(far) / (t.abs() + reach / d.length());
    let clear = (inside / rounding).min(ends / margin);
    (clear > -1.0).then_some(Exact {
        t,
        u,
        v,
        margin: clear,
    })
}

/// All triangles, one by one, in double precision: the nearest certain hit, and whether a doubtful one is about as near.
pub fn brute_force(ray: &Ray, soup: &Soup) -> (Option<(usize, Exact)>, bool) {
    let all: Vec<(usize, Exact)> = (0..soup.triangles.len())
        .filter_map(|k| Some((k, exact(ray, soup.corners(k), 1e-5)?)))
        .collect();
    let nearest = all
        .iter()
        .filter(|(_, h)| h.margin > 1.0)
        .min_by(|a, b| a.1.t.total_cmp(&b.1.t))
        .copied();
    let limit = nearest.map_or(f64::INFINITY, |(_, h)| h.t * (1.0 + 1e-4));
    let doubtful = all.iter().any(|(_, h)| h.margin <= 1.0 && h.t <= limit);
    (nearest, doubtful)
}

/// Asserts that a hit is the oracle's, as far as the oracle is certain. Returns whether it was.
pub fn agrees(ray: &Ray, soup: &Soup, hit: Option<&Hit>) -> bool {
    let (nearest, doubtful) = brute_force(ray, soup);
    match (nearest, hit) {
        (None, None) => true,
        (Some((k, exact)), Some(hit)) => {
            let scale = soup.corners(hit.primitive as usize)[0]
                .abs()
                .max(ray.origin.abs())
                .max_element();
            let close = |t: f64| {
                (f64::from(hit.t) - t).abs()
                    <= 1e-4 * t.abs() + 1e-5 * f64::from(scale / ray.direction.length())
            };
            if doubtful {
                return f64::from(hit.t) <= exact.t * (1.0 + 1e-4) + 1e-5 * f64::from(scale);
            }
            assert!(
                close(exact.t),
                "{ray:?}: {hit:?}, but the oracle says {k} {exact:?}"
            );
            true
        }
        (Some(_), None) | (None, Some(_)) if doubtful => true,
        (nearest, hit) => panic!("{ray:?}: {hit:?}, but the oracle says {nearest:?}"),
    }
}

/// Rays of all kinds through the unit cube: free, axis-parallel, segments, with ends.
pub fn rays(random: &mut Random, count: usize) -> Vec<Ray> {
    (0..count)
        .map(|k| {
            let origin = random.point() * 2.0;
            let mut ray = Ray::new(origin, random.direction());
            match k % 6 {
                0 => ray.direction = (random.point() - origin) * 0.01,
                1 => {
                    let axis = random.below(3);
                    ray.direction = Vec3::ZERO;
                    ray.direction[axis] = if random.unit() < 0.5 { 1.0 } else { -2.0 };
                    ray.origin = random.point();
                    ray.origin[axis] *= 4.0;
                }
                2 => ray = Ray::between(origin, random.point()),
                3 => {
                    ray.t_min = random.unit();
                    ray.t_max = ray.t_min + random.unit();
                }
                4 => ray.direction[random.below(3)] = 0.0,
                _ => {}
            }
            ray
        })
        .collect()
}

/// Rays that pass through the inside of some triangle.
pub fn aimed(random: &mut Random, soup: &Soup, count: usize) -> Vec<Ray> {
    (0..count)
        .map(|_| {
            let [a, b, c] = soup.corners(random.below(soup.triangles.len()));
            let (u, v) = (random.unit(), random.unit());
            let (u, v) = if u + v > 1.0 {
                (1.0 - u, 1.0 - v)
            } else {
                (u, v)
            };
            let target = a + (b - a) * u + (c - a) * v;
            let origin = random.point() * 3.0;
            Ray::new(origin, target - origin)
        })
        .collect()
}

/// The same structure with each kind of instructions.
pub fn each_simd(accel: &Accel) -> Vec<Accel> {
    [Simd::Portable, Simd::Avx2, Simd::Neon]
        .into_iter()
        .filter_map(|simd| {
            let mut accel = accel.clone();
            accel.set_simd(simd).then_some(accel)
        })
        .collect()
}

/// To double precision and back is exact.
pub fn widen(p: Vec3) -> DVec3 {
    p.as_dvec3()
}
