//! Spots that send out far more than the rest: what a lamp lights a hand's breadth away, a patch of sun in a dark room.
//!
//! A few hundred parallel lines through a texel meet a small spot or miss it; what they then say about its light is wrong by its
//! whole share, and wrong alike for all texels that look along the same lines: blotches, where paths have fireflies. So light is
//! divided. What texels reflect of the *direct* light beyond a bound, some times the mean, does not go along lines: a round of its own gathers it
//! by rays that are aimed at the spots, each picked in about proportion to what it could give ([`Patches`]), as direct light is. Lines carry the
//! rest. The division is exact, so nothing is lost and the mean stays what it was; only noise changes.
//!
//! Light that has been reflected more often is divided, too, as every round of lines gathers all reflections of the direct light anew: the part of
//! the spots is gathered once and added to the result of each.
//!
//! No paper; gathering virtual area lights apart from the rest is as old as final gathering with importance (Jensen 1995). Wrong tool where
//! nothing is bright: then there are no spots and the round ends at once. A spot that touches the texel that asks (a corner) is noisy, as the
//! distance is squared.

use super::{Bake, Round};
use crate::gather::{SurfaceSample, luminance, surface_at};
use crate::state::Before;
use crate::texel::Band;
use glam::{Vec2, Vec3};
use occlude_render::geometry::WorldTriangle;
use occlude_render::light::{Patch, Patches};
use occlude_render::sampling::{Sampler, SamplerKind};
use occlude_visibility::{Ray, Tracer, offset_along_normal};
use rayon::prelude::*;

/// Spots at most: with more the bound is raised.
const MOST_SPOTS: u64 = 1 << 16;

/// A smaller share of what is reflected than this is left to lines.
const LEAST_SHARE: f64 = 0.01;

/// Rows that are looked at together.
const ROWS: u32 = 32;

/// A side that sends out more than the bound.
#[derive(Clone, Copy, Debug)]
struct Spot {
    /// Its texel: which band, and which texel of that.
    band: u32,
    texel: u32,
    back: bool,
    /// What it sends out beyond the bound, W/(m² sr).
    radiance: Vec3,
}

/// All spots.
#[derive(Debug)]
pub(super) struct Spots {
    bands: Vec<Band>,
    spots: Vec<Spot>,
    patches: Patches,
}

/// Bytes that spots hold at most, of so many sides.
pub(crate) fn bytes(sides: u32) -> u64 {
    const TEXEL: usize = 64;
    MOST_SPOTS.min(u64::from(sides)) * (size_of::<Spot>() + TEXEL + Patches::BYTES) as u64
}

impl Bake<'_> {
    /// The radiance beyond which what a side sends out of the direct light is a spot's; infinite if there are none.
    pub(super) fn bound(&self, before: &Before) -> f32 {
        let times = self.settings.spots;
        if !times.is_finite() || self.albedo.is_empty() {
            return f32::INFINITY;
        }
        // Of every part by itself and then in order, so that threads do not show.
        let sums = |of: &(dyn Fn(f32) -> f64 + Sync)| {
            let mut sum = 0.0;
            for range in self.stretches() {
                let starts: Vec<u32> = range.clone().step_by(4096).collect();
                let parts = starts.into_par_iter().map(|start| {
                    let sides = start..range.end.min(start + 4096);
                    sides.map(|side| of(self.sent(before, side))).sum::<f64>()
                });
                let parts: Vec<f64> = parts.collect();
                sum += parts.iter().sum::<f64>();
                before.release();
                self.albedo.release();
            }
            sum
        };
        let all = sums(&|sent| f64::from(sent));
        // The square of the mean root: what the sun shines on outside says little about the rooms.
        let roots = sums(&|sent| f64::from(sent).sqrt());
        let lit = sums(&|sent| if sent > 0.0 { 1.0 } else { 0.0 });
        if lit == 0.0 {
            return f32::INFINITY;
        }
        let mut bound = (f64::from(times) * (roots / lit).powi(2)) as f32;
        while sums(&|sent| if sent > bound { 1.0 } else { 0.0 }) > MOST_SPOTS as f64 {
            bound *= 2.0;
        }
        let beyond = sums(&|sent| f64::from((sent - bound).max(0.0)));
        if beyond < LEAST_SHARE * all {
            f32::INFINITY
        } else {
            bound
        }
    }

    /// The largest channel of what a texel's front or back sends out of the direct light.
    fn sent(&self, before: &Before, side: u32) -> f32 {
        if self.has_texel(side) {
            self.of_direct(before, side).max_element()
        } else {
            0.0
        }
    }

    /// Whether a side is a texel's: stand-ins have none.
    fn has_texel(&self, side: u32) -> bool {
        let sides = self.subject.sides();
        sides.is_some_and(|sides| sides.front_of(side) < sides.texels())
    }

    /// What a side sends out of the direct light beyond the bound.
    pub(super) fn beyond(&self, before: &Before, side: u32) -> Vec3 {
        if before.bound == f32::INFINITY || !self.has_texel(side) {
            return Vec3::ZERO;
        }
        let sent = self.of_direct(before, side);
        let largest = sent.max_element();
        if largest > before.bound {
            sent * (1.0 - before.bound / largest)
        } else {
            Vec3::ZERO
        }
    }

    /// Finds the spots.
    pub(super) fn spots(&self, before: &Before) -> Spots {
        let texels = self.subject.texels;
        let mut found: Vec<(Band, Vec<Spot>, Vec<Patch>)> = Vec::new();
        if before.bound < f32::INFINITY {
            let rows: Vec<_> = texels.bands(ROWS).collect();
            // As many at a time as may be in memory.
            for rows in rows.chunks(64) {
                let some = rows.par_iter().map(|(page, rows)| {
                    let size = texels.atlas.pages[*page as usize];
                    let numbers = size.texel(0, rows.start)..size.texel(0, rows.end);
                    let is_bright = |texel: u32| {
                        self.sides_of(texel)
                            .any(|side| self.beyond(before, side) != Vec3::ZERO)
                    };
                    if !numbers.clone().any(is_bright) {
                        return Default::default();
                    }
                    let band = texels.band(*page, rows.clone());
                    let band = band.filtered(|fragments| is_bright(fragments[0].texel));
                    self.spots_of(before, band)
                });
                found.par_extend(some.filter(|(_, spots, _)| !spots.is_empty()));
                before.release();
                self.albedo.release();
            }
        }
        let mut all = Spots {
            bands: Vec::new(),
            spots: Vec::new(),
            patches: Patches::new(&[]),
        };
        let mut patches = Vec::new();
        for (number, (band, spots, here)) in found.into_iter().enumerate() {
            all.bands.push(band);
            let band = number as u32;
            all.spots
                .extend(spots.iter().map(|&spot| Spot { band, ..spot }));
            patches.extend(here);
        }
        all.patches = Patches::new(&patches);
        all
    }

    /// A texel's front, and its back if that matters.
    fn sides_of(&self, texel: u32) -> impl Iterator<Item = u32> {
        let back = self.subject.sides().and_then(|sides| sides.back_of(texel));
        std::iter::once(texel).chain(back)
    }

    fn spots_of(&self, before: &Before, band: Band) -> (Band, Vec<Spot>, Vec<Patch>) {
        let texels = self.subject.texels;
        let (mut spots, mut patches) = (Vec::new(), Vec::new());
        for i in 0..band.len() {
            let area = texels.world_area(&band, i);
            let corners = texels.world_corners(&band, i);
            let low = corners.iter().fold(Vec3::INFINITY, |low, c| low.min(*c));
            let high = corners
                .iter()
                .fold(Vec3::NEG_INFINITY, |high, c| high.max(*c));
            let normals: Vec<Vec3> = band
                .fragments(i)
                .iter()
                .map(|f| {
                    let world =
                        WorldTriangle::new(texels.scene, texels.pose, f.instance, f.primitive);
                    texels.normal(&world, f.instance, f.primitive)
                })
                .collect();
            let sum: Vec3 = normals.iter().sum();
            let (axis, spread) = match sum.try_normalize() {
                Some(axis) => {
                    let angles = normals.iter().map(|normal| normal.angle_between(axis));
                    (axis, angles.fold(0.0, f32::max))
                }
                None => (Vec3::Z, std::f32::consts::PI),
            };
            for side in self.sides_of(band.texel(i)) {
                let radiance = self.beyond(before, side);
                let intensity = luminance(radiance) * area;
                if !(intensity > 0.0 && intensity.is_finite() && low.is_finite()) {
                    continue;
                }
                let back = side != band.texel(i);
                spots.push(Spot {
                    band: 0,
                    texel: i as u32,
                    back,
                    radiance,
                });
                patches.push(Patch {
                    center: 0.5 * (low + high),
                    radius: 0.5 * low.distance(high) * (1.0 + 1e-4),
                    normal: if back { -axis } else { axis },
                    spread,
                    intensity,
                });
            }
        }
        (band, spots, patches)
    }

    /// What arrives from spots at some samples, W/m²; their first moments are appended to `moments`. Returns the number of rays.
    pub(super) fn gather_spots(
        &self,
        round: Round,
        spots: &Spots,
        samples: &[SurfaceSample],
        irradiance: &mut [Vec3],
        moments: &mut Vec<Vec3>,
    ) -> u64 {
        let settings = self.path_settings(round);
        let geometry = self.subject.world.geometry;
        let texels = self.subject.texels;
        irradiance.fill(Vec3::ZERO);
        let (mut rays, mut whose) = (Vec::new(), Vec::new());
        for (number, sample) in samples.iter().enumerate() {
            let Some(to) = surface_at(geometry, sample.point, sample.back) else {
                continue;
            };
            let mut sampler = Sampler::new(
                SamplerKind::Sobol,
                settings.seed,
                [sample.side, 0x7370_6f74],
                sample.number,
            );
            let [u, v, pick, _] = sampler.next();
            let place = Vec2::new(u, v);
            let picked = spots.patches.pick(to.position, to.normal, pick, place);
            let Some((spot, probability)) = picked else {
                continue;
            };
            let spot = spots.spots[spot];
            let band = &spots.bands[spot.band as usize];
            let hit = texels.sample(band, spot.texel as usize, place);
            let turned = texels.atlas.is_turned(hit.instance, hit.primitive);
            let Some(from) = surface_at(geometry, hit, turned != spot.back) else {
                continue;
            };
            let between = from.position - to.position;
            let distance2 = between.length_squared();
            let direction = between / distance2.sqrt();
            let cosines =
                to.normal.dot(direction).max(0.0) * (-from.normal.dot(direction)).max(0.0);
            let area = texels.sampled_area(band, spot.texel as usize, hit);
            let light = spot.radiance * (cosines * area / (distance2 * probability));
            if cosines > 0.0 && light.is_finite() {
                let start = offset_along_normal(to.position, to.normal, to.extent);
                let end = offset_along_normal(from.position, from.normal, from.extent);
                rays.push(Ray::between(start, end));
                whose.push((number, light, direction));
            }
        }
        let mut occluded = vec![false; rays.len()];
        geometry.occluded_batch(&rays, &mut occluded);
        let first = moments.len();
        if settings.directional {
            moments.resize(first + samples.len(), Vec3::ZERO);
        }
        for (k, &(number, light, direction)) in whose.iter().enumerate() {
            if occluded[k] {
                continue;
            }
            let tint = if geometry.has_panes() {
                geometry.pane_transmittance(&rays[k])
            } else {
                Vec3::ONE
            };
            irradiance[number] += light * tint;
            if settings.directional {
                moments[first + number] += direction * luminance(light * tint);
            }
        }
        rays.len() as u64
    }
}

impl Spots {
    /// Nothing is that bright.
    pub fn is_empty(&self) -> bool {
        self.spots.is_empty()
    }
}
