//! Direct light of a sky on moving, glossy surfaces without noise: visibility as distance fields at few points.
//!
//! Wang, Pan, Han, Chen, Bao 2013, "Parallel and adaptive visibility sampling for rendering dynamic scenes with spatially-varying reflectance". A frame goes
//! through these steps:
//!
//! 1. one line of sight a pixel ([`eyes`]);
//! 2. sample points ride to where their surfaces are, those that pixels need trace maps of what they see, and points are inserted or
//!    erased where maps change more or less than said ([`points`], [`start`]);
//! 3. maps become fields of distances, and what of the sky's lobes ([`sky`]) arrives at each point is taken from them;
//! 4. pixels interpolate between points; lobes of the sky meet lobes of the surface ([`gloss`], [`shade`]); pixels on edges get more samples.
//!
//! Emissive surfaces have maps of their own, which end before them ([`lamps`]). Lights without size and suns are asked by exact rays: a map does not know how far
//! its occluders are. The picture is that of
//! `--max-depth 1`, biased: by the fit of the sky, the resolution of maps, the distance of points and the hemisphere approximation.
//!
//! Wrong tool for indirect light, for transmission other than by clear panes (it is left out), and for mirrors (one exact ray each).

mod batch;
mod cells;
mod eyes;
mod gloss;
mod lamps;
mod lobe;
mod math;
mod octahedron;
mod points;
mod polygon;
mod rest;
mod shade;
mod sky;
mod start;
mod views;

#[cfg(test)]
mod tests;

use super::instant_radiosity::Prepared;
use super::{RayCounts, RenderReport, RenderSettings, StoppedBy, World};
use crate::camera::View;
use crate::film::Film;
use crate::job::Job;
use crate::light::{Lights, SkyFit, SkyLobes, SkySun};
use eyes::{Eyes, TILE};
use glam::{Vec2, Vec3};
use lamps::Lamps;
use occlude_visibility::VisibilityStats;
use occlude_visibility::field::{MapSampling, Metric};
use points::{Changes, Points, Reach, Round};
use rayon::prelude::*;
use rest::Rest;
use shade::{Counts, Scratch, Shaded, Shading, Spot};
use sky::Sky;
use std::time::Instant;

/// How fields of visibility are made and used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// Points are inserted next to one that its neighbours miss by more than this, relative (`E_v,max`). Lower: more points.
    pub insert_above: f32,
    /// Points that their neighbours make up for to this are erased (`E_v,min`). Lower than `insert_above`.
    pub erase_below: f32,
    /// Texels along a side of a map, a power of two from 16 to 1024.
    pub resolution: u32,
    /// Texels along a side that are traced first, all of them; at most `resolution`.
    pub start: u32,
    /// Sample points at most.
    pub most_points: u32,
    /// Rounds of insertion, in the first frame and in the others.
    pub rounds: [u32; 2],
    /// Lobes that a glossy reflection is made of, 1 to 3.
    pub gloss_lobes: u32,
    /// More samples of pixels that differ from a neighbour.
    pub edge_samples: u32,
    /// Rays a shading point for emissive surfaces and suns.
    pub light_samples: u32,
    /// Neighbouring pixels share distances where they may; otherwise each reads the fields by itself, which is slower and hardly more exact.
    pub shared: bool,
    /// Fields take an eighth of the bytes, see [`DistanceField::packed`](occlude_visibility::field::DistanceField::packed).
    pub packed: bool,
    /// What of a lobe is visible is integrated over cells of the field (Eq. 5) instead of taken from the distance at its centre: hundreds of times slower, every pixel by
    /// itself; a check of what the hemisphere approximation loses.
    pub cells: bool,
    /// Emissive surfaces are lobes behind maps of their own, if they are few; otherwise they are asked by exact rays.
    pub lamps: bool,
    /// Virtual lights for one bounce of diffuse light, gathered at the sample points; 0: none.
    pub bounce: u32,
    /// Short rays a pixel that find what blocks it close by and the points around it do not see; 0: none.
    pub contact: u32,
}

impl Default for Field {
    fn default() -> Self {
        Self {
            insert_above: 0.10,
            erase_below: 0.05,
            resolution: 128,
            start: 16,
            most_points: 8192,
            rounds: [6, 1],
            gloss_lobes: 2,
            edge_samples: 4,
            light_samples: 4,
            shared: true,
            packed: false,
            cells: false,
            lamps: true,
            bounce: 0,
            contact: 0,
        }
    }
}

impl Field {
    /// The share of a GGX reflection that its lobes put in wrong places, 0 to 1.
    pub fn gloss_residual(&self, alpha: f32) -> f32 {
        gloss::residual(alpha, self.gloss_lobes.clamp(1, 3) as usize)
    }
}

/// What a frame took and held.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldReport {
    /// Seconds for moving points and deciding where they should be.
    pub update: f64,
    /// Seconds for visibility maps.
    pub visibility: f64,
    /// Seconds for distance transforms.
    pub transform: f64,
    /// Seconds for lines of sight and shading.
    pub integration: f64,
    /// Points that the frame used.
    pub points: u64,
    /// Points of the sequence.
    pub all_points: u64,
    /// Points inserted and erased.
    pub inserted: u64,
    /// See `inserted`.
    pub erased: u64,
    /// Rays for maps.
    pub rays: u64,
    /// Bytes of maps and fields.
    pub bytes: u64,
    /// Pixels that see a surface.
    pub covered: u64,
}

/// A direction inside of a sun's disk, uniform in `u` and `v`.
fn towards_sun(sun: &SkySun, u: f32, v: f32) -> Vec3 {
    let (s, t) = sun.towards.any_orthonormal_pair();
    let (sin, cos) = (v * std::f32::consts::TAU).sin_cos();
    let r = sun.angular_radius * u.sqrt();
    (sun.towards + (s * cos + t * sin) * r).normalize()
}

/// Frames one after the other, and the points that live through them.
#[derive(Clone, Debug, Default)]
pub(super) struct Fields {
    points: Option<Points>,
    sky: Sky,
    lobes: Option<SkyLobes>,
    /// Of the sky that the last frame was under.
    rest: Option<Rest>,
}

/// Initial points for so many covered pixels.
const PIXELS_A_POINT: u32 = 256;
const FIRST_POINTS: std::ops::RangeInclusive<u32> = 48..=1024;
/// Weight of positions in the geometric distance, over the size of the scene.
const PER_SIZE: f32 = 2.0;

impl Fields {
    /// The sky's lobes, from now on.
    pub(super) fn set_sky(&mut self, lobes: SkyLobes) {
        self.sky = Sky::new(&lobes);
        self.rest = None;
        self.lobes = Some(lobes);
    }

    /// Renders a frame into a film that is empty.
    pub(super) fn render(
        &mut self,
        world: &World,
        view: &View,
        field: &Field,
        settings: &RenderSettings,
        bounce: Option<&Prepared>,
        film: &mut Film,
        job: &Job,
    ) -> RenderReport {
        if self.lobes.is_none() {
            let lobes =
                (world.lights.sky()).map(|environment| environment.lobes(&SkyFit::default()));
            self.set_sky(lobes.unwrap_or_default());
        }
        let mut report = FieldReport::default();
        let mut rays = RayCounts::default();
        let mut stats = VisibilityStats::default();
        job.start_phase("render", 4);
        let geometry = world.geometry;
        let mut clock = Clock(Instant::now());

        let eyes = Eyes::trace(geometry, view);
        rays.primary += eyes.rays;
        report.covered = eyes.covered.into();
        clock.add_to(&mut report.integration);

        let first = self.points.is_none();
        let points = self.points.get_or_insert_with(|| {
            let (_, radius) = crate::light::bounding_sphere(geometry.scene, geometry.pose);
            let size = if radius.is_finite() && radius > 0.0 {
                2.0 * radius
            } else {
                1.0
            };
            Points::new(Metric {
                per_metre: PER_SIZE / size,
            })
        });
        points.ride(geometry);
        if points.list.is_empty() {
            let count = eyes.covered / PIXELS_A_POINT;
            let count = count.clamp(*FIRST_POINTS.start(), *FIRST_POINTS.end());
            points.start(start::spread(geometry, &eyes, points.metric, count as usize).into_iter());
        }
        let sampling = MapSampling {
            start: field.start.min(field.resolution),
            resolution: field.resolution,
        };
        let rounds = field.rounds[usize::from(!first)];
        let mut cancelled = false;
        for round in 0..=rounds {
            points.measure(first);
            points.mark_needed(&eyes);
            clock.add_to(&mut report.update);
            let (traced, cost) = points.trace(geometry, sampling);
            report.rays += cost;
            stats.queries += traced * u64::from(field.resolution).pow(2);
            clock.add_to(&mut report.visibility);
            cancelled = job.is_cancelled();
            if round == rounds || cancelled {
                break;
            }
            let now = if first {
                Round::First {
                    last: round + 1 == rounds,
                }
            } else {
                Round::Later
            };
            let changes = points.adapt(geometry, view, &eyes, field, now);
            report.inserted += u64::from(changes.inserted);
            report.erased += u64::from(changes.erased);
            clock.add_to(&mut report.update);
            if changes == Changes::default() && !first {
                break;
            }
        }
        stats.traced = report.rays;
        stats.answered = stats.queries - stats.traced.min(stats.queries);
        job.advance(1, report.rays);
        if cancelled {
            return finish(StoppedBy::Cancel, rays, stats, report);
        }
        points.age();
        clock.add_to(&mut report.update);
        points.transform(field.packed);
        clock.add_to(&mut report.transform);
        job.advance(1, 0);
        if self.rest.is_none() && self.sky.len() > 0 {
            let lobes = self.lobes.as_ref();
            self.rest = (world.lights.sky().zip(lobes)).map(|(sky, lobes)| Rest::new(sky, lobes));
        }
        let rest = self.rest.as_ref();
        points.look_at(&self.sky, rest);
        if let Some(bounce) = bounce {
            rays.secondary += bounce.rays;
            let traced = points.gather(geometry, bounce);
            (stats.queries, stats.traced) = (stats.queries + traced, stats.traced + traced);
        }
        let contact = if field.contact > 0 {
            let reach = points.contact_reach();
            let traced = points.touch(geometry, reach);
            (stats.queries, stats.traced) = (stats.queries + traced, stats.traced + traced);
            reach
        } else {
            0.0
        };

        let (scene, pose) = (geometry.scene, geometry.pose);
        let exact = world.lights.without_extent(scene, pose);
        let lamps = if field.lamps {
            Lamps::new(world.lights.emissive().collect())
        } else {
            None
        };
        let areas = match &lamps {
            Some(_) => world.lights.suns(scene, pose),
            None => world.lights.areas(scene, pose),
        };
        let lamps = lamps.as_ref().filter(|lamps| lamps.len() > 0);
        if let Some(lamps) = lamps {
            let traced = points.look_at_lamps(geometry, lamps);
            report.rays += traced;
            (stats.queries, stats.traced) = (stats.queries + traced, stats.traced + traced);
            clock.add_to(&mut report.visibility);
        }
        let reach = Reach::new(points, |point| point.needed);
        let shading = Shading {
            world,
            view,
            settings: field,
            points,
            reach: &reach,
            sky: &self.sky,
            rest,
            lamps,
            areas: some_light(&areas),
            exact: some_light(&exact),
            seed: settings.seed,
            contact,
            near: rest.is_some() || bounce.is_some() || contact > 0.0,
        };
        let counts = shade(&shading, &eyes, settings, film);
        clock.add_to(&mut report.integration);
        rays.primary += counts.primary;
        stats.queries += counts.shadow;
        stats.traced += counts.shadow;
        report.points = points.list.iter().filter(|point| point.needed).count() as u64;
        report.all_points = points.list.len() as u64;
        report.bytes = points.bytes();
        job.advance(2, counts.primary + counts.shadow);
        finish(StoppedBy::Samples, rays, stats, report)
    }
}

fn some_light(lights: &Lights) -> Option<&Lights> {
    (!lights.is_empty()).then_some(lights)
}

fn finish(
    stopped_by: StoppedBy,
    rays: RayCounts,
    visibility: VisibilityStats,
    report: FieldReport,
) -> RenderReport {
    RenderReport {
        secondary: super::SecondaryRays::default(),
        stopped_by,
        rays,
        visibility,
        instant_radiosity: None,
        field: Some(report),
    }
}

/// Seconds since the last question.
struct Clock(Instant);

impl Clock {
    fn add_to(&mut self, sum: &mut f64) {
        let now = Instant::now();
        *sum += (now - self.0).as_secs_f64();
        self.0 = now;
    }
}

/// Shades all pixels, those on edges several times, into the film.
fn shade(shading: &Shading, eyes: &Eyes, settings: &RenderSettings, film: &mut Film) -> Counts {
    let (width, height) = (film.width(), film.height());
    let across = width.div_ceil(TILE);
    let middles: Vec<(Vec<Shaded>, Counts)> = (eyes.tiles.par_iter())
        .map_init(Scratch::default, |scratch, tile| {
            scratch.counts = Counts::default();
            let shaded = shading.tile(tile, scratch);
            (shaded, scratch.counts)
        })
        .collect();
    let at = |x: u32, y: u32| -> &Shaded {
        let index = (y / TILE * across + x / TILE) as usize;
        let tile = &eyes.tiles[index];
        &middles[index].0[((y - tile.y) * tile.width + x - tile.x) as usize]
    };
    let is_edge = |x: u32, y: u32| {
        let here = at(x, y);
        let xs = [x.saturating_sub(1), (x + 1).min(width - 1)];
        let ys = [y.saturating_sub(1), (y + 1).min(height - 1)];
        let beside = [(xs[0], y), (xs[1], y), (x, ys[0]), (x, ys[1])];
        beside.iter().any(|&(x, y)| differ(here, at(x, y)))
    };
    let samples = settings.samples.clone();
    let all = samples.end.saturating_sub(samples.start).max(1) - 1;
    let more: Vec<(Vec<(u16, Shaded)>, Counts)> = (eyes.tiles.par_iter())
        .map_init(Scratch::default, |scratch, tile| {
            scratch.counts = Counts::default();
            let (mut pixels, mut spots) = (Vec::new(), Vec::new());
            for i in 0..tile.width * tile.height {
                let (x, y) = (i % tile.width, i / tile.width);
                let edge = if is_edge(tile.x + x, tile.y + y) {
                    shading.settings.edge_samples
                } else {
                    0
                };
                for number in 1..=all.max(edge) {
                    let turn = |step: f32| (step * number as f32 + 0.5).fract();
                    let uv = Vec2::new(turn(0.754_877_7), turn(0.569_840_3));
                    let place = Vec2::new(x as f32, y as f32) + settings.filter.offset(uv);
                    pixels.push(i as u16);
                    spots.push(Spot {
                        x: place.x,
                        y: place.y,
                        seed: [tile.x + x, tile.y + y],
                        number,
                    });
                }
            }
            let shaded = shading.more(tile, &spots, scratch);
            let out = pixels.into_iter().zip(shaded).collect();
            (out, scratch.counts)
        })
        .collect();
    let dropped: u64 = (film.bands(TILE).into_par_iter().enumerate())
        .map(|(row, mut band)| {
            let tiles = row * across as usize..(row + 1) * across as usize;
            let mut dropped = 0;
            for index in tiles {
                let tile = &eyes.tiles[index];
                let firsts = middles[index].0.iter().enumerate();
                let firsts = firsts.map(|(i, s)| (i as u16, s));
                let rest = more[index].0.iter().map(|(i, s)| (*i, s));
                for (i, shaded) in firsts.chain(rest) {
                    let i = u32::from(i);
                    let (x, y) = (tile.x + i % tile.width, tile.y + i / tile.width);
                    let lost = band.add(x, y, shaded.radiance, Some(&shaded.features));
                    dropped += u64::from(lost);
                }
            }
            dropped
        })
        .sum();
    film.add_dropped(dropped);
    let mut counts = Counts::default();
    let all = middles.iter().map(|(_, counts)| counts);
    for part in all.chain(more.iter().map(|(_, counts)| counts)) {
        counts.primary += part.primary;
        counts.shadow += part.shadow;
    }
    counts
}

/// Whether an edge runs between two pixels.
fn differ(a: &Shaded, b: &Shaded) -> bool {
    let (fa, fb) = (&a.features, &b.features);
    if (fa.depth == 0.0) != (fb.depth == 0.0) {
        return true;
    }
    if fa.depth == 0.0 {
        return false;
    }
    let step = (fa.depth - fb.depth).abs() > 0.03 * fa.depth.min(fb.depth);
    let turned = fa.normal.dot(fb.normal) < 0.8;
    // Display values, roughly.
    let tone = |v: Vec3| {
        let l = v.element_sum() * (1.0 / 3.0);
        (l / (1.0 + l)).max(0.0).sqrt()
    };
    step || turned || (tone(a.radiance) - tone(b.radiance)).abs() > 0.08
}
