//! What the sky has beside its lobes.
//!
//! Lobes lose what is narrow or has edges: a bright strip above the horizon becomes a broad glow. The difference of sky and lobes, which may be negative, is
//! added in two ways.
//!
//! For matt surfaces: sample points know what they see direction by direction, so the difference, averaged over texels of one and a half degrees at edges of
//! visibility and three elsewhere, is integrated over each point's map, and interpolated. Diffuse light under shadows is then that of the sky itself, up to those texels.
//!
//! For glossy ones: the difference under a lobe of reflected directions, nothing in the way, comes from squares that were smoothed by lobes of some sharpnesses (as
//! prefiltered skies of games are: McAllister et al. 2002). What is visible of it is the share of the whole lobe that is ([`VisibleShare`]): unlike each
//! product of lobes, which asks about itself. Exact where nothing is in the way and for lobes that are wholly hidden or free; wrong where an edge runs between
//! what is brighter and what is darker than the lobes. Wrong tool for mirrors, which show the sky itself.
//!
//! [`VisibleShare`]: occlude_visibility::field::VisibleShare

use super::math::exp;
use super::octahedron::{Octahedron, Smooth};
use crate::light::{Environment, SkyLobes};
use glam::Vec3;
use occlude_visibility::field::{Hemisphere, MapBlock, VisibilityMap};

/// Texels along a side of the finest square (less than half a degree each), and of those that matt surfaces are lit with: at edges, and away from them.
const FINEST: usize = 512;
const MATT: [usize; 2] = [128, 64];
/// A sun's light was taken out of texels so near to it, radians.
const SUN_REACH: f32 = 0.15;
/// Sharpness of the smoothed squares, as powers of two, and what the finest one stands for as it is.
const SMOOTHED: [u32; 5] = [10, 8, 6, 4, 2];
const FINEST_STANDS_FOR: f32 = 14.0;

/// Radiance of the sky minus that of its lobes and suns.
#[derive(Clone, Debug)]
pub(super) struct Rest {
    /// Means over texels, by [`MATT`].
    cells: [Octahedron; MATT.len()],
    finest: Smooth,
    /// By [`SMOOTHED`].
    smoothed: [Smooth; SMOOTHED.len()],
}

impl Rest {
    pub(super) fn new(sky: &Environment, lobes: &SkyLobes) -> Self {
        let mut rest = Octahedron::from_fn(FINEST, |w| sky.radiance(w) - lobes.radiance(w));
        for sun in &lobes.suns {
            // What the suns shine is asked by rays: it goes from where the sky is brighter than the lobes.
            let (mut near, mut above) = (Vec::new(), Vec3::ZERO);
            for index in 0..rest.texels.len() {
                let (w, solid) = rest.texel(index);
                if w.dot(sun.towards) > SUN_REACH.cos() {
                    near.push(index);
                    above += rest.texels[index].max(Vec3::ZERO) * solid;
                }
            }
            let left = (Vec3::ONE - sun.irradiance / above.max(Vec3::splat(1e-12))).max(Vec3::ZERO);
            for index in near {
                let value = &mut rest.texels[index];
                *value = value.max(Vec3::ZERO) * left + value.min(Vec3::ZERO);
            }
        }
        let finest = rest.as_it_is();
        let mut cells: [Octahedron; MATT.len()] = Default::default();
        let smoothed = SMOOTHED.map(|power| {
            rest = rest.halved();
            if let Some(k) = MATT.iter().position(|&side| side == rest.side()) {
                cells[k] = rest.clone();
            }
            rest.smoothed((1u32 << power) as f32)
        });
        Self {
            cells,
            finest,
            smoothed,
        }
    }

    /// The integral of the rest times a lobe of amplitude 1, nothing in the way. Lobes broader than the broadest square see next to nothing of what lobes
    /// of the sky have missed: what they see fades.
    pub(super) fn in_lobe(&self, axis: Vec3, sharpness: f32) -> Vec3 {
        const BROADEST: f32 = SMOOTHED[SMOOTHED.len() - 1] as f32;
        let power = sharpness.max(1e-3).log2();
        let smooth = |k: usize| self.smoothed[k].at(axis);
        const SHARPEST: f32 = SMOOTHED[0] as f32;
        let mean = if power >= SHARPEST {
            let t = ((power - SHARPEST) / (FINEST_STANDS_FOR - SHARPEST)).min(1.0);
            smooth(0).lerp(self.finest.at(axis), t)
        } else if power > BROADEST {
            let place = (SHARPEST - power) * 0.5;
            let k = (place as usize).min(SMOOTHED.len() - 2);
            smooth(k).lerp(smooth(k + 1), place - k as f32)
        } else {
            smooth(SMOOTHED.len() - 1) * (power - BROADEST).exp2()
        };
        let whole = std::f32::consts::TAU * (1.0 - exp(-2.0 * sharpness)) / sharpness;
        Vec3::from(mean) * whole
    }

    /// Irradiance of a point by what is free of its map, whose blocks are given too: blocks with an edge texel by texel, the others by quarters.
    pub(super) fn irradiance(
        &self,
        hemisphere: &Hemisphere,
        map: &VisibilityMap,
        blocks: &[MapBlock],
    ) -> Vec3 {
        /// Parts of a block along a side at most: of 128 texels each one.
        const MOST: usize = 4;
        let across = (blocks.len() as f32).sqrt() as usize;
        let size = map.side() as usize / across;
        let mut sum = Vec3::ZERO;
        let lit = blocks.iter().enumerate();
        for (number, block) in lit.filter(|(_, block)| block.free > 0.0) {
            let edge = block.free < 1.0;
            let cells = if edge { &self.cells[0] } else { &self.cells[1] };
            let parts = size.min(if edge { MOST } else { 2 });
            let side = across * parts;
            let area = (std::f32::consts::PI / side as f32).powi(2);
            // Of the part's texels one speaks: the others differ in maps that are finer than the sky's texels.
            let step = size / parts;
            let (top, left) = (number / across * parts, number % across * parts);
            for row in top..top + parts {
                for column in left..left + parts {
                    if !edge || map.get(row * step, column * step) {
                        let local = Hemisphere::texel(side as u32, row, column);
                        let sine = (1.0 - local.z * local.z).sqrt();
                        let w = hemisphere.to_world(local);
                        sum += cells.texels[cells.index(w)] * (sine * local.y * area);
                    }
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::SkyFit;
    use occlude_image::Picture;

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
        let found = by_lobes * scale + f64::from(rest.irradiance(&h, &map, &map.blocks()).x);
        let (by_lobes, expected) = (by_lobes * scale, expected * scale);
        println!("{found} of {expected}, by lobes alone {by_lobes}");
        assert!(
            (by_lobes / expected - 1.0).abs() > 0.1,
            "lobes alone are good enough"
        );
        assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    }
}
