//! What a baked scene looks like: surfaces in the light of their maps, nothing else.
//!
//! Radiance of a surface is what it emits, plus base colour times irradiance / pi, irradiance read bilinearly from the light
//! map, as the engines do that the maps are for. For checking a bake, and what other programs show of it.
//!
//! The wrong tool for anything that light maps do not hold: mirrors, glass, and surfaces without a map are black but for their emission.

use glam::{Vec2, Vec3};
use occlude_image::Picture;
use occlude_render::camera::{PixelFilter, View};
use occlude_render::geometry::{Geometry, Surface};
use occlude_render::sampling::{Sampler, SamplerKind};
use occlude_visibility::Hit;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// Where the map of an instance is: page coordinates (0 to 1, v down) are `uv1 * scale + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Index into [`Baked::pages`].
    pub page: u32,
    /// Size of the unit square on the page.
    pub scale: Vec2,
    /// Its corner.
    pub offset: Vec2,
}

/// Light maps and who uses them.
#[derive(Clone, Debug, Default)]
pub struct Baked {
    /// Irradiance, W/m².
    pub pages: Vec<Picture>,
    /// By instance of the scene; `None`: no map.
    pub places: Vec<Option<Place>>,
}

/// Rows of pixels that one thread does at a time.
const ROWS: usize = 4;

impl Baked {
    /// Irradiance at a hit, W/m²; 0 without a map.
    pub fn irradiance(&self, geometry: &Geometry, hit: Hit) -> Vec3 {
        let place = self.places.get(hit.instance as usize).copied().flatten();
        let mesh = geometry.pose.instances[hit.instance as usize].mesh;
        let mesh = &geometry.scene.meshes[mesh as usize];
        let page = place.and_then(|place| self.pages.get(place.page as usize));
        let (Some(place), Some(page)) = (place, page) else {
            return Vec3::ZERO;
        };
        let corners = mesh.triangles[hit.primitive as usize].map(|i| mesh.uv1.get(i as usize));
        let [Some(&a), Some(&b), Some(&c)] = corners else {
            return Vec3::ZERO;
        };
        let uv = a + (b - a) * hit.u + (c - a) * hit.v;
        bilinear(page, uv * place.scale + place.offset)
    }

    /// Radiance that a surface point sends out.
    pub fn radiance(&self, geometry: &Geometry, surface: &Surface) -> Vec3 {
        let emission = surface.emission(geometry);
        if surface.material().unlit {
            return emission;
        }
        let albedo = surface.bsdf_parameters(geometry).base_color;
        emission + albedo * self.irradiance(geometry, surface.hit) * FRAC_1_PI
    }

    /// What a camera sees, `samples` a pixel. `background` is the radiance of the sky along unit vectors.
    pub fn picture(
        &self,
        geometry: &Geometry,
        view: &View,
        filter: PixelFilter,
        samples: u32,
        seed: u64,
        background: impl Fn(Vec3) -> Vec3 + Sync,
    ) -> Picture {
        let mut picture = Picture::new(view.width(), view.height());
        let width = view.width() as usize;
        let strips = picture.pixels.par_chunks_mut(width * ROWS).enumerate();
        strips.for_each(|(strip, pixels)| {
            let (mut rays, mut hits) = (Vec::new(), Vec::new());
            for (index, pixel) in pixels.iter_mut().enumerate() {
                let (x, y) = (
                    (index % width) as u32,
                    (strip * ROWS + index / width) as u32,
                );
                rays.clear();
                rays.extend((0..samples).map(|sample| {
                    let mut sampler = Sampler::new(SamplerKind::Sobol, seed, [x, y], sample);
                    let [u, v, ..] = sampler.next();
                    let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    view.ray(centre + filter.offset(Vec2::new(u, v))).ray
                }));
                hits.clear();
                hits.resize(rays.len(), None);
                geometry.closest_batch(&rays, &mut hits);
                let mut sum = Vec3::ZERO;
                for (ray, hit) in rays.iter().zip(&hits) {
                    let toward_eye = -ray.direction.normalize_or_zero();
                    let surface = hit.and_then(|hit| Surface::new(geometry, hit, toward_eye));
                    sum += match surface {
                        Some(surface) => self.radiance(geometry, &surface),
                        None => background(-toward_eye),
                    };
                }
                *pixel = (sum / samples.max(1) as f32).to_array();
            }
        });
        picture
    }
}

/// A page at a point, texel centres at (i + 0.5) / size, edges held.
fn bilinear(page: &Picture, at: Vec2) -> Vec3 {
    if page.width == 0 || page.height == 0 || !at.is_finite() {
        return Vec3::ZERO;
    }
    let last = Vec2::new(page.width as f32 - 1.0, page.height as f32 - 1.0);
    let at = (at * (last + 1.0) - 0.5).clamp(Vec2::ZERO, last);
    let (x, y) = (at.x as u32, at.y as u32);
    let f = at - Vec2::new(x as f32, y as f32);
    let texel = |x: u32, y: u32| {
        let value = page.get(x.min(page.width - 1), y.min(page.height - 1));
        Vec3::from(value.unwrap_or_default())
    };
    let row = |y: u32| texel(x, y).lerp(texel(x + 1, y), f.x);
    row(y).lerp(row(y + 1), f.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lookups_are_bilinear_between_texel_centres() {
        let page =
            Picture::from_pixels(2, 2, vec![[0.0; 3], [4.0; 3], [8.0; 3], [12.0; 3]]).unwrap();
        let at = |x: f32, y: f32| bilinear(&page, Vec2::new(x, y)).x;
        assert_eq!(at(0.25, 0.25), 0.0);
        assert_eq!(at(0.75, 0.75), 12.0);
        assert_eq!(at(0.5, 0.25), 2.0);
        assert_eq!(at(0.5, 0.5), 6.0);
        assert_eq!(at(-3.0, 9.0), 8.0);
        assert_eq!(at(f32::NAN, 0.0), 0.0);
    }
}
