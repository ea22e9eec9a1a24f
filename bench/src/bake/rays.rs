//! The other side: our own exact rays, with the same look-up of radiance and the same sums.

use super::subject::Subject;
use glam::{Vec2, Vec3};
use occlude_bake::atlas::Atlas;
use occlude_bake::bundle::Radiance;
use occlude_bake::sums::Sums;
use occlude_render::geometry::{Geometry, WorldTriangle};
use occlude_render::sampling::warp;
use occlude_testkit::random::Random;
use occlude_visibility::{Hit, Ray, offset_along_normal};

/// Points on baked surfaces, spread by texels, in their order.
pub struct Points(Vec<Point>);

struct Point {
    position: Vec3,
    normal: Vec3,
    texel: u32,
}

impl Points {
    pub fn new(subject: &Subject, atlas: &Atlas, count: usize) -> Self {
        let mut random = Random(1);
        let mut areas: Vec<f64> = Vec::new();
        let mut who = Vec::new();
        let mut sum = 0.0;
        for (instance, posed) in subject.pose.instances.iter().enumerate() {
            let triangles = subject.scene.meshes[posed.mesh as usize].triangles.len() as u32;
            for primitive in 0..triangles {
                if let Some((_, [a, b, c])) = atlas.triangle(instance as u32, primitive) {
                    sum += f64::from((b - a).perp_dot(c - a).abs());
                    areas.push(sum);
                    who.push((instance as u32, primitive));
                }
            }
        }
        let mut points: Vec<Point> = (0..count)
            .filter_map(|_| {
                let at = f64::from(random.unit()) * sum;
                let (instance, primitive) =
                    who[areas.partition_point(|&a| a <= at).min(who.len() - 1)];
                let b = warp::triangle(Vec2::new(random.unit(), random.unit()));
                let world = WorldTriangle::new(&subject.scene, &subject.pose, instance, primitive);
                let normal = world.front_cross().try_normalize()?;
                Some(Point {
                    position: offset_along_normal(world.point(b.x, b.y), normal, world.extent()),
                    normal,
                    texel: atlas.texel(instance, primitive, b.x, b.y)?,
                })
            })
            .collect();
        points.sort_by_key(|p| p.texel);
        Self(points)
    }

    /// One ray from each point; how many of them found a baked front. `along`: all the same way (from those that face it), otherwise
    /// distributed by the cosine.
    pub fn gather(
        &self,
        geometry: &Geometry,
        atlas: &Atlas,
        radiance: &Radiance,
        sums: &Sums,
        along: Option<Vec3>,
        seed: u64,
    ) -> u64 {
        let mut random = Random(seed);
        let (mut rays, mut whose) = (Vec::new(), Vec::new());
        let mut hits: Vec<Option<Hit>> = Vec::new();
        let mut found = 0;
        for points in self.0.chunks(4096) {
            rays.clear();
            whose.clear();
            for point in points {
                let direction = match along {
                    Some(along) if along.dot(point.normal) > 0.0 => along,
                    Some(_) => continue,
                    None => {
                        let (x, y) = warp::basis(point.normal);
                        let u = Vec2::new(random.unit(), random.unit());
                        let d = warp::cosine_hemisphere(u);
                        x * d.x + y * d.y + point.normal * d.z
                    }
                };
                rays.push(Ray::new(point.position, direction));
                whose.push(point.texel);
            }
            hits.clear();
            hits.resize(rays.len(), None);
            if along.is_some() {
                geometry.closest_coherent(&rays, &mut hits);
            } else {
                geometry.closest_batch(&rays, &mut hits);
            }
            for ((ray, hit), &texel) in rays.iter().zip(&hits).zip(&whose) {
                let Some(hit) = hit else { continue };
                let world =
                    WorldTriangle::new(geometry.scene, geometry.pose, hit.instance, hit.primitive);
                let front = world.front_cross().dot(ray.direction) < 0.0;
                let seen = atlas.texel(hit.instance, hit.primitive, hit.u, hit.v);
                if let (true, Some(seen)) = (front, seen) {
                    sums.add(texel, 1.0, radiance.get(seen));
                    found += 1;
                }
            }
        }
        found
    }
}
