//! What the sky has beside its lobes, for matt surfaces.
//!
//! Lobes lose what is narrow or has edges: a bright strip above the horizon becomes a broad glow. Sample points know what they see direction by direction, so
//! the difference of sky and lobes, averaged over cells of six degrees (no finer than the blocks of maps that it is multiplied with), is integrated over each point's map, and interpolated. With it diffuse light under shadows is that of the sky
//! itself, up to those cells. It may be negative.

use crate::light::{Environment, SkyLobes};
use glam::{Vec2, Vec3};
use occlude_visibility::field::{Hemisphere, MapBlock};
use rayon::prelude::*;

/// Cells along a side of the octahedron's square, and samples along a side of a cell.
const SIDE: usize = 32;
const SAMPLES: usize = 16;
/// A sun's light was taken out of cells so near to it, radians.
const SUN_REACH: f32 = 0.15;

/// Radiance of the sky minus that of its lobes and suns.
#[derive(Clone, Debug)]
pub(super) struct Rest {
    cells: Vec<Vec3>,
}

/// The direction of a point of `[-1, 1]^2` (not normalised: on the octahedron).
fn unfold(p: Vec2) -> Vec3 {
    let up = 1.0 - p.x.abs() - p.y.abs();
    if up >= 0.0 {
        Vec3::new(p.x, up, p.y)
    } else {
        let turned = (Vec2::ONE - Vec2::new(p.y.abs(), p.x.abs())) * sign(p);
        Vec3::new(turned.x, up, turned.y)
    }
}

fn sign(p: Vec2) -> Vec2 {
    Vec2::new(1.0_f32.copysign(p.x), 1.0_f32.copysign(p.y))
}

/// The cell of a direction.
#[inline]
fn cell(w: Vec3) -> usize {
    let p = Vec2::new(w.x, w.z) / (w.x.abs() + w.y.abs() + w.z.abs());
    let p = if w.y >= 0.0 {
        p
    } else {
        (Vec2::ONE - Vec2::new(p.y.abs(), p.x.abs())) * sign(p)
    };
    let index = |v: f32| (((v + 1.0) * (0.5 * SIDE as f32)) as usize).min(SIDE - 1);
    index(p.y) * SIDE + index(p.x)
}

impl Rest {
    pub(super) fn new(sky: &Environment, lobes: &SkyLobes) -> Self {
        let corner = |index: usize| Vec2::new((index % SIDE) as f32, (index / SIDE) as f32);
        let place = |index: usize, i: usize, samples: usize| {
            let step = 1.0 / samples as f32;
            let inside = Vec2::new((i % samples) as f32 + 0.5, (i / samples) as f32 + 0.5) * step;
            unfold((corner(index) + inside) * (2.0 / SIDE as f32) - Vec2::ONE)
        };
        let mut cells: Vec<Vec3> = (0..SIDE * SIDE)
            .into_par_iter()
            .map(|index| {
                // Means over solid angle: of dx dy on the octahedron it is 1 / r^3.
                let mean = |samples: usize, radiance: &dyn Fn(Vec3) -> Vec3| {
                    let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
                    for i in 0..samples * samples {
                        let v = place(index, i, samples);
                        let r = v.length();
                        sum += radiance(v / r) / (r * r * r);
                        weight += 1.0 / (r * r * r);
                    }
                    sum / weight
                };
                mean(SAMPLES, &|w| sky.radiance(w)) - mean(SAMPLES / 4, &|w| lobes.radiance(w))
            })
            .collect();
        let solid = |index: usize| {
            let r = place(index, 0, 1).length();
            (2.0 / SIDE as f32).powi(2) / (r * r * r)
        };
        for sun in &lobes.suns {
            // What the suns shine is asked by rays: it goes from where the sky is brighter than the lobes.
            let near: Vec<usize> = (0..cells.len())
                .filter(|&index| {
                    let w = place(index, 0, 1).normalize();
                    w.dot(sun.towards) > SUN_REACH.cos()
                })
                .collect();
            let above: Vec3 = (near.iter())
                .map(|&index| cells[index].max(Vec3::ZERO) * solid(index))
                .sum();
            let left = (Vec3::ONE - sun.irradiance / above.max(Vec3::splat(1e-12))).max(Vec3::ZERO);
            for index in near {
                let value = cells[index];
                cells[index] = value.max(Vec3::ZERO) * left + value.min(Vec3::ZERO);
            }
        }
        Self { cells }
    }

    /// Irradiance of a point by what is free of its map.
    pub(super) fn irradiance(&self, hemisphere: &Hemisphere, blocks: &[MapBlock]) -> Vec3 {
        let free = blocks.iter().filter(|block| block.free > 0.0);
        free.map(|block| {
            let w = hemisphere.to_world(block.direction);
            self.cells[cell(w)] * (block.weight * block.free)
        })
        .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::SkyFit;
    use occlude_image::Picture;
    use occlude_visibility::field::VisibilityMap;

    #[test]
    fn cells_hold_their_directions() {
        for index in 0..SIDE * SIDE {
            let p = Vec2::new((index % SIDE) as f32 + 0.5, (index / SIDE) as f32 + 0.5);
            let w = unfold(p * (2.0 / SIDE as f32) - Vec2::ONE).normalize();
            assert_eq!(cell(w), index);
        }
    }

    /// A sky with a sharp horizon: lobes and the rest together light a point that sees a window of it as the sky does.
    #[test]
    fn lobes_and_rest_are_the_sky() {
        let (width, height) = (256, 128);
        let radiance = |w: Vec3| {
            let band = if w.y.abs() < 0.12 { 4.0 } else { 0.3 };
            Vec3::new(band, 0.5 * band + 0.2 * w.x, 0.4)
        };
        let pixel = |i: u32| {
            let theta = std::f32::consts::PI * ((i / width) as f32 + 0.5) / height as f32;
            let phi = std::f32::consts::TAU * (((i % width) as f32 + 0.5) / width as f32 - 0.5);
            let (sin, cos) = theta.sin_cos();
            radiance(Vec3::new(sin * phi.cos(), cos, sin * phi.sin())).to_array()
        };
        let picture = Picture {
            width,
            height,
            pixels: (0..width * height).map(pixel).collect(),
        };
        let sky = Environment::from_picture(&picture, 0.0, 1.0);
        let lobes = sky.lobes(&SkyFit { lobes: 6, suns: 0 });
        let rest = Rest::new(&sky, &lobes);
        let h = Hemisphere::new(Vec3::new(0.9, 0.3, 0.2).normalize(), Vec3::Y);
        let window = |w: Vec3| w.dot(Vec3::new(0.95, -0.1, 0.25).normalize()) > 0.85;
        let map = VisibilityMap::from_fn(128, |local| window(h.to_world(local)));
        let (mut by_lobes, mut expected) = (0.0, 0.0);
        let n = 200_000;
        for i in 0..n {
            let y = (i as f32 + 0.5) / n as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - y * y).sqrt();
            let w = h.to_world(Vec3::new(r * cos, y, r * sin));
            if window(w) {
                by_lobes += f64::from(lobes.radiance(w).x * y);
                expected += f64::from(sky.radiance(w).x * y);
            }
        }
        let scale = std::f64::consts::TAU / f64::from(n);
        let found = by_lobes * scale + f64::from(rest.irradiance(&h, &map.blocks()).x);
        let (by_lobes, expected) = (by_lobes * scale, expected * scale);
        println!("{found} of {expected}, by lobes alone {by_lobes}");
        assert!(
            (by_lobes / expected - 1.0).abs() > 0.1,
            "lobes alone are good enough"
        );
        assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    }
}
