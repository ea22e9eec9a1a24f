//! Worlds and questions that several test programs share.
#![allow(dead_code)]

use glam::Vec3;
use occlude_visibility::{Endpoint, LightEnd, Query, Ray, Tracer, Visibility};

/// A world of spheres that names its blockers. `lazy` leaves out the test of single blockers, as closures do.
pub struct Spheres {
    pub spheres: Vec<(Vec3, f32)>,
    pub lazy: bool,
}

impl Spheres {
    fn hits(&self, i: u32, ray: &Ray) -> bool {
        let (centre, radius) = self.spheres[i as usize];
        let t = (centre - ray.origin).dot(ray.direction) / ray.direction.length_squared();
        ray.at(t.clamp(ray.t_min, ray.t_max)).distance(centre) < radius
    }
}

impl Tracer for Spheres {
    type Blocker = u32;

    fn blocker(&self, ray: &Ray) -> Option<u32> {
        (0..self.spheres.len() as u32).find(|&i| self.hits(i, ray))
    }

    fn blocks(&self, blocker: u32, ray: &Ray) -> bool {
        !self.lazy && self.hits(blocker, ray)
    }
}

/// Uniform numbers in [0, 1) (splitmix64).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 40) as f32 / (1 << 24) as f32
    }

    pub fn vector(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }

    pub fn world(&mut self, spheres: usize, radius: f32, scale: f32) -> Spheres {
        Spheres {
            spheres: (0..spheres)
                .map(|_| (self.vector() * scale, self.next() * radius * scale))
                .collect(),
            lazy: false,
        }
    }

    /// Rows of neighbouring eyes on a floor, each asking about every kind of light end.
    pub fn questions(&mut self, scale: f32) -> Vec<Query> {
        let points: Vec<Vec3> = (0..3).map(|_| self.vector() * scale).collect();
        let suns: Vec<Vec3> = (0..2).map(|_| self.vector().normalize()).collect();
        let mut queries = Vec::new();
        for i in 0..64 * 64 {
            let position = Vec3::new(
                (i % 64) as f32 / 32.0 - 1.0,
                -1.0,
                (i / 64) as f32 / 32.0 - 1.0,
            ) * scale;
            let eye = Endpoint::new(position, Vec3::Y, 32.0 / scale);
            for &light in &points {
                queries.push(Query::new(
                    eye,
                    LightEnd::Point(light),
                    Ray::between(position, light),
                ));
            }
            for &sun in &suns {
                queries.push(Query::new(
                    eye,
                    LightEnd::Direction(sun),
                    Ray::new(position, sun),
                ));
            }
            let lamp = Vec3::new(self.next() * 0.3, 1.0, self.next() * 0.3) * scale;
            let end = LightEnd::Surface(Endpoint::new(lamp, -Vec3::Y, 11.0));
            queries.push(Query::new(eye, end, Ray::between(position, lamp)));
            let direction = (self.vector() + Vec3::Y).normalize();
            let end = LightEnd::SolidAngle {
                direction,
                density: 0.16,
            };
            queries.push(Query::new(eye, end, Ray::new(position, direction)));
        }
        queries
    }
}

pub fn ask<T: Tracer, V: Visibility<T>>(
    strategy: &V,
    tracer: &T,
    worker: &mut V::Worker,
    queries: &[Query],
) -> Vec<f32> {
    let mut answers = vec![f32::NAN; queries.len()];
    strategy.answer(tracer, worker, queries, &mut answers);
    answers
}
