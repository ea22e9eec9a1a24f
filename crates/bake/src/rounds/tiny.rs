//! Texels of tiny charts, gathered by rays.
//!
//! No chart has less than a texel, so those of screws and slivers are up to millions of times denser than what was asked for. Lines dense enough
//! for them are dense for everything else on their way: 39 seconds a direction instead of 0.04 in one flat with 30,000 such texels. So
//! lines are as dense as charts of ordinary size need ([`Triangles`]), and tiny texels get, in every other direction,
//! a ray of their own: from a point of the texel along a cosine-distributed direction, as path tracing has it, which looks up the
//! same radiance that lines carry. A texel's terms all estimate the same mean, so they go into the same sums, rays with the greater weight.
//!
//! A ray is a pure function of seed, round, texel and number of the direction.

use super::Bake;
use crate::bundle::{Radiance, Sky, Triangles};
use crate::gather::{luminance, surface_at};
use crate::sums::Sums;
use crate::texel::Band;
use glam::{Vec2, Vec3};
use occlude_render::geometry::WorldTriangle;
use occlude_render::sampling::{Sampler, SamplerKind, warp};
use occlude_visibility::{Hit, Ray, offset_along_normal};
use rayon::prelude::*;
use std::ops::Range;

/// Rows that are looked at together.
const ROWS: u32 = 32;

/// Rays that are traced together.
const BATCH: usize = 4096;

/// The weight of a ray is that of so many lines as dense as the texels. The few lines that meet a tiny texel are heavy: they stand for
/// the area of ordinary ones.
const LINES_PER_RAY: f32 = 64.0;

/// The tiny texels of an atlas.
#[derive(Debug, Default)]
pub(crate) struct TinyTexels {
    bands: Vec<Band>,
    count: u64,
}

impl TinyTexels {
    /// Finds them. O(texels).
    pub fn find(subject: &super::Subject) -> Self {
        let Some(triangles) = subject.triangles.filter(|t| t.has_tiny()) else {
            return Self::default();
        };
        let rows: Vec<_> = subject.texels.bands(ROWS).collect();
        let bands: Vec<Band> = rows
            .into_par_iter()
            .map(|(page, rows)| {
                let band = subject.texels.band(page, rows);
                // What most of a texel belongs to decides.
                band.filtered(|fragments| {
                    let most = fragments.iter().max_by(|a, b| a.area.total_cmp(&b.area));
                    most.is_some_and(|f| triangles.is_tiny(f.instance, f.primitive))
                })
            })
            .filter(|band| !band.is_empty())
            .collect();
        let count = bands.iter().map(|band| band.len() as u64).sum();
        Self { bands, count }
    }

    /// Bytes that are held.
    pub fn bytes(&self) -> u64 {
        self.bands.iter().map(Band::bytes).sum()
    }

    /// Rays of a direction, on average.
    pub fn rays(&self) -> f64 {
        0.5 * self.count as f64
    }
}

/// What rays meet.
pub(crate) struct Light<'a> {
    pub triangles: &'a Triangles<'a>,
    pub radiance: &'a Radiance,
    pub sky: Option<Sky<'a>>,
}

impl Bake<'_> {
    /// Gathers a range of directions for tiny texels. Returns the number of rays.
    pub(crate) fn gather_tiny(
        &self,
        light: &Light,
        round: u32,
        range: Range<u32>,
        sums: &Sums,
    ) -> u64 {
        let rays = |band: &Band| {
            let mut rays = Rays::default();
            for i in 0..band.len() {
                let texel = band.texel(i);
                let weight = LINES_PER_RAY * self.subject.texels.world_area(band, i)
                    / light.triangles.largest_area();
                for direction in range.clone().filter(|d| (d ^ texel) & 1 == 0) {
                    let mut sampler = Sampler::new(
                        SamplerKind::Sobol,
                        self.settings.seed,
                        [texel, 0x7469_6e79 ^ round],
                        direction / 2,
                    );
                    let [u, v, x, y] = sampler.next();
                    let point = self.subject.texels.sample(band, i, Vec2::new(u, v));
                    self.ray(point, Vec2::new(x, y), (texel, weight), &mut rays);
                }
                if rays.rays.len() >= BATCH || i + 1 == band.len() {
                    self.trace(light, &mut rays, sums);
                }
            }
            sums.release();
            rays.count
        };
        self.tiny.bands.par_iter().map(rays).sum()
    }

    fn ray(&self, point: Hit, random: Vec2, whose: (u32, f32), rays: &mut Rays) {
        let geometry = self.subject.world.geometry;
        let atlas = self.subject.texels.atlas;
        let turned = atlas.is_turned(point.instance, point.primitive);
        let Some(surface) = surface_at(geometry, point, turned) else {
            return;
        };
        let (x, y) = warp::basis(surface.normal);
        let local = warp::cosine_hemisphere(random);
        let direction = (x * local.x + y * local.y + surface.normal * local.z).normalize();
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        rays.rays.push(Ray::new(origin, direction));
        rays.whose.push(whose);
    }

    fn trace(&self, light: &Light, rays: &mut Rays, sums: &Sums) {
        let geometry = self.subject.world.geometry;
        rays.hits.clear();
        rays.hits.resize(rays.rays.len(), None);
        geometry.closest_batch(&rays.rays, &mut rays.hits);
        rays.count += rays.rays.len() as u64;
        for ((ray, hit), &(texel, weight)) in rays.rays.iter().zip(&rays.hits).zip(&rays.whose) {
            let arrives = match hit {
                None => light.sky.map_or(Vec3::ZERO, |sky| sky(ray.direction)),
                Some(hit) => {
                    let (instance, primitive) = (hit.instance, hit.primitive);
                    let world =
                        WorldTriangle::new(geometry.scene, geometry.pose, instance, primitive);
                    let front = light.triangles.front_at(instance, primitive, hit.u, hit.v);
                    let normal = self.subject.texels.normal(&world, instance, primitive);
                    let side = if normal.dot(ray.direction) < 0.0 {
                        Some(front)
                    } else {
                        light.triangles.sides().back_of(front)
                    };
                    side.map_or(Vec3::ZERO, |side| light.radiance.get(side))
                }
            };
            let arrives = arrives.min(Vec3::splat(light.radiance.brightest()));
            sums.add(texel, weight, arrives);
            if let Some(moments) = sums.moments() {
                moments.add(texel, weight, ray.direction * luminance(arrives));
            }
        }
        rays.rays.clear();
        rays.whose.clear();
    }
}

/// Rays on their way.
#[derive(Default)]
struct Rays {
    rays: Vec<Ray>,
    /// Texel and weight.
    whose: Vec<(u32, f32)>,
    hits: Vec<Option<Hit>>,
    count: u64,
}
