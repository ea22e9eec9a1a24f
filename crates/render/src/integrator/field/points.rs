//! Sample points: where visibility is known, and where it should be.
//!
//! Points ride on the surfaces, a triangle and a place on it each. Which are wanted follows from what pixels show. Wang et al. 2013, section 4.3, with corrections:
//! the error of a point is that of interpolating it from its neighbours *without it* (Eqs. 7 and 8), relative to what it sees; new points lie between it and each neighbour
//! that sees otherwise, on the surface that the picture shows there; of points that the others make up for, the smallest errors go first and no
//! two neighbours at once.
//!
//! Weights fall to 0 at a point's radius, which follows from the distances of its neighbours. In a sequence radii and the strength of new and leaving points change
//! little by little, so that nothing pops.

use super::super::instant_radiosity::Prepared;
use super::eyes::{Eye, Eyes};
use super::lamps::{Distances, Lamps, Window};
use super::rest::Rest;
use super::{Field, sky::Sky};
use crate::camera::View;
use crate::geometry::{Geometry, Place, Spot};
use glam::Vec3;
use occlude_visibility::field::{
    DistanceField, DistanceTransform, Harmonics, Hemisphere, Hint, MapSampler, MapSampling, Metric,
    Sites, VisibilityMap, harmonics, visibility_error,
};
use occlude_visibility::{Ray, Tracer, offset_along_normal};
use rayon::prelude::*;

/// Neighbours that a point is compared with.
const NEIGHBOURS: usize = 8;
/// The neighbour whose distance sets the radius, from 0, and the factor.
const RADIUS_FROM: usize = 4;
const RADIUS_FACTOR: f32 = 1.25;
/// Frames that a new point takes to full strength, or an old one to none.
const FADE: f32 = 4.0;
/// Share of the way to its wanted radius that a point goes in a frame.
const RADIUS_STEP: f32 = 0.35;
/// Frames in a row that a point must be superfluous before it goes.
const PATIENCE: u8 = 4;
/// Frames without use after which a point goes.
const FORGET: u16 = 48;
/// Points that are closer than so many pixels get none between them.
const LEAST_PIXELS: f32 = 5.0;
/// A point that has a map takes hints from a neighbour in every so-manieth frame: what is slim and new is found by one and told to the others.
const HINT_EVERY: usize = 4;
/// A new point keeps this share of the pair's distance from all others.
const SEPARATION: f32 = 0.35;

/// A surface point and what it sees.
#[derive(Clone, Debug)]
pub(super) struct Point {
    pub(super) place: Place,
    pub(super) spot: Spot,
    pub(super) hemisphere: Hemisphere,
    pub(super) map: VisibilityMap,
    pub(super) field: DistanceField,
    pub(super) harmonics: Harmonics,
    /// What of the sky's lobes arrives, see [`Sky::seen_from`].
    pub(super) seen: Vec<f32>,
    /// Of light that comes from near by, see [`Near`].
    pub(super) near: Near,
    /// How far edges of visibility are from the middles of lamps, see [`Lamps::look`].
    pub(super) lamps: Distances,
    /// Where its influence ends, in terms of [`Metric`].
    pub(super) radius: f32,
    /// From 0, new or about to go, to 1.
    pub(super) strength: f32,
    /// Error of interpolating it from its neighbours, relative.
    pub(super) error: f32,
    neighbours: Vec<(u32, f32)>,
    dying: bool,
    calm: u8,
    idle: u16,
    /// Pixels may need it in this frame.
    pub(super) needed: bool,
    /// The map is of this frame.
    traced: bool,
    /// The field is of the map.
    transformed: bool,
}

/// What lobes do not know, interpolated between points like what is seen of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Near {
    /// Irradiance after one bounce, W/m^2.
    pub(super) bounced: Vec3,
    /// Irradiance by what the sky has beside its lobes, see [`Rest`].
    pub(super) rest: Vec3,
    /// Share of the cosine-weighted directions that something close by blocks.
    pub(super) blocked: f32,
}

impl Near {
    /// `self` plus `weight` times another.
    pub(super) fn add(&mut self, other: &Self, weight: f32) {
        self.bounced += other.bounced * weight;
        self.rest += other.rest * weight;
        self.blocked += other.blocked * weight;
    }
}

/// All sample points of a sequence.
#[derive(Clone, Debug)]
pub(super) struct Points {
    pub(super) list: Vec<Point>,
    pub(super) metric: Metric,
    sites: Sites,
    frame: usize,
}

/// When points are adapted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Round {
    /// In the first frame, where nothing can flicker: points are inserted round after round, and erased once at the end.
    First {
        /// The last one.
        last: bool,
    },
    /// In a frame after others.
    Later,
}

/// What an adaptation did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Changes {
    pub(super) inserted: u32,
    pub(super) erased: u32,
}

impl Point {
    fn new(place: Place, spot: Spot, strength: f32) -> Self {
        Self {
            place,
            spot,
            hemisphere: Hemisphere::new(spot.normal, spot.along),
            map: VisibilityMap::default(),
            field: DistanceField::default(),
            harmonics: Harmonics::default(),
            seen: Vec::new(),
            near: Near::default(),
            lamps: Distances::default(),
            radius: 0.0,
            strength,
            error: 0.0,
            neighbours: Vec::new(),
            dying: false,
            calm: 0,
            idle: 0,
            needed: false,
            traced: false,
            transformed: false,
        }
    }

    fn has_map(&self) -> bool {
        self.map.side() > 0
    }

    /// Bytes of map and field.
    pub(super) fn bytes(&self) -> usize {
        self.map.bytes() + self.field.bytes()
    }
}

impl Points {
    pub(super) fn new(metric: Metric) -> Self {
        Self {
            list: Vec::new(),
            metric,
            sites: Sites::default(),
            frame: 0,
        }
    }

    /// Adds points at full strength.
    pub(super) fn start(&mut self, eyes: impl Iterator<Item = (Place, Spot)>) {
        self.list
            .extend(eyes.map(|(place, spot)| Point::new(place, spot, 1.0)));
    }

    /// A frame begins: points move with their surfaces; those whose triangles have no area any more go.
    pub(super) fn ride(&mut self, geometry: &Geometry) {
        let spots: Vec<Option<Spot>> = (self.list.par_iter())
            .map(|point| point.place.spot(geometry))
            .collect();
        let mut spots = spots.into_iter();
        self.list.retain_mut(|point| match spots.next().flatten() {
            Some(spot) => {
                point.spot = spot;
                point.hemisphere = Hemisphere::new(spot.normal, spot.along);
                point.traced = false;
                point.strength = if point.dying {
                    point.strength - 1.0 / FADE
                } else {
                    (point.strength + 1.0 / FADE).min(1.0)
                };
                point.strength > 0.0 && point.idle < FORGET
            }
            None => false,
        });
    }

    /// Finds neighbours and from them radii; `step` is the share of the way that radii go.
    pub(super) fn measure(&mut self, first: bool) {
        self.sites.clear();
        for point in &self.list {
            self.sites.push(point.spot.position, point.spot.normal);
        }
        let (metric, sites) = (self.metric, &self.sites);
        let near: Vec<Vec<(u32, f32)>> = (0..self.list.len())
            .into_par_iter()
            .with_min_len(16)
            .map_init(Vec::new, |distances, i| {
                let spot = &self.list[i].spot;
                metric.distances(spot.position, spot.normal, sites, distances);
                nearest(distances, i)
            })
            .collect();
        for (point, near) in self.list.iter_mut().zip(near) {
            let wanted = match near.get(RADIUS_FROM).or(near.last()) {
                Some(&(_, distance)) => RADIUS_FACTOR * distance,
                None => 1.0,
            };
            let wanted = wanted.clamp(1e-6, 2.0);
            point.radius = if point.radius == 0.0 || first {
                wanted
            } else {
                point.radius + (wanted - point.radius) * RADIUS_STEP
            };
            point.neighbours = near;
        }
    }

    /// Marks the points that some pixel may need.
    pub(super) fn mark_needed(&mut self, eyes: &Eyes) {
        let reach = Reach::new(self, |_| true);
        let flags: Vec<std::sync::atomic::AtomicBool> =
            (0..self.list.len()).map(|_| false.into()).collect();
        eyes.tiles
            .par_iter()
            .filter(|tile| !tile.is_empty())
            .for_each_init(Vec::new, |ids, tile| {
                reach.around(tile.centre, tile.radius, ids);
                for &id in ids.iter() {
                    flags[id as usize].store(true, std::sync::atomic::Ordering::Relaxed);
                }
            });
        for (point, flag) in self.list.iter_mut().zip(flags) {
            point.needed = flag.into_inner();
        }
    }

    /// A frame ends: counts how long points were of no use.
    pub(super) fn age(&mut self) {
        self.frame += 1;
        for point in &mut self.list {
            point.idle = if point.needed { 0 } else { point.idle + 1 };
        }
    }

    /// Traces the maps of needed points that are not of this frame. Returns points and rays.
    pub(super) fn trace(&mut self, geometry: &Geometry, sampling: MapSampling) -> (u64, u64) {
        let list = &self.list;
        let waiting: Vec<usize> = (0..list.len())
            .filter(|&i| list[i].needed && !list[i].traced)
            .collect();
        let results: Vec<(VisibilityMap, Harmonics, u64)> = (waiting.par_iter())
            .map_init(MapSampler::default, |sampler, &i| {
                let point = &list[i];
                let known = point.map.side() == sampling.resolution;
                let wanted = match known {
                    true => usize::from((i + self.frame).is_multiple_of(HINT_EVERY)),
                    false => 2,
                };
                let others = point.neighbours.iter().map(|&(k, _)| &list[k as usize]);
                let others = others.filter(|other| other.has_map()).take(wanted);
                let hints: Vec<Hint> = others.map(hint).collect();
                let spot = &point.spot;
                let origin = offset_along_normal(spot.position, spot.flat, spot.extent);
                let before = sampler.traced();
                let axes = &point.hemisphere;
                let map = if known {
                    sampler.sample_again(geometry, origin, axes, sampling, &point.map, &hints)
                } else {
                    sampler.sample(geometry, origin, axes, sampling, &hints)
                };
                let harmonics = harmonics(&map, &point.hemisphere);
                (map, harmonics, sampler.traced() - before)
            })
            .collect();
        let mut rays = 0;
        for (&i, (map, harmonics, traced)) in waiting.iter().zip(results) {
            let point = &mut self.list[i];
            point.transformed &= point.map == map;
            point.map = map;
            point.harmonics = harmonics;
            point.traced = true;
            rays += traced;
        }
        (waiting.len() as u64, rays)
    }

    /// Transforms the maps that have changed; packs the fields if so wanted.
    pub(super) fn transform(&mut self, packed: bool) {
        self.list
            .par_iter_mut()
            .filter(|point| point.needed && !point.transformed)
            .for_each_init(Default::default, |(transform, whole), point| {
                let (transform, whole): (&mut DistanceTransform, &mut DistanceField) =
                    (transform, whole);
                if packed {
                    transform.transform_into(&point.map, whole);
                    point.field = whole.packed();
                } else {
                    transform.transform_into(&point.map, &mut point.field);
                }
                point.transformed = true;
            });
    }

    /// What of the sky arrives at every needed point.
    pub(super) fn look_at(&mut self, sky: &Sky, rest: Option<&Rest>) {
        self.list
            .par_iter_mut()
            .filter(|point| point.needed)
            .for_each(|point| {
                let Point {
                    hemisphere,
                    map,
                    field,
                    seen,
                    near,
                    ..
                } = point;
                let blocks = map.blocks();
                sky.seen_from(hemisphere, &blocks, |w| field.at(hemisphere, w), seen);
                near.rest =
                    rest.map_or(Vec3::ZERO, |rest| rest.irradiance(hemisphere, map, &blocks));
            });
    }

    /// Looks at the lamps from every needed point. Returns the rays.
    pub(super) fn look_at_lamps(&mut self, geometry: &Geometry, lamps: &Lamps) -> u64 {
        let needed = self.list.par_iter_mut().filter(|point| point.needed);
        needed
            .map_init(Window::default, |window, point| {
                let spot = &point.spot;
                let origin = offset_along_normal(spot.position, spot.flat, spot.extent);
                lamps.look(geometry, origin, spot.normal, window, &mut point.lamps)
            })
            .sum()
    }

    /// Light that virtual lights bring to every needed point, each by an exact ray. Returns the rays.
    pub(super) fn gather(&mut self, geometry: &Geometry, bounce: &Prepared) -> u64 {
        let (patches, most) = bounce.patches();
        let patches: Vec<(Vec3, Vec3, Vec3)> = patches.collect();
        let needed = self.list.par_iter_mut().filter(|point| point.needed);
        let buffers = || (Vec::new(), Vec::new(), Vec::new());
        needed
            .map_init(buffers, |(rays, light, blocked), point| {
                let spot = &point.spot;
                let origin = offset_along_normal(spot.position, spot.flat, spot.extent);
                rays.clear();
                light.clear();
                for &(target, normal, colour) in &patches {
                    let step = target - spot.position;
                    let square = step.length_squared().max(1e-12);
                    let cosines = step.dot(spot.normal).max(0.0) * -step.dot(normal).min(0.0);
                    let geometric = (cosines / (square * square)).min(most);
                    if geometric > 0.0 {
                        rays.push(Ray::between(origin, target));
                        light.push(colour * geometric);
                    }
                }
                blocked.clear();
                blocked.resize(rays.len(), false);
                geometry.occluded_batch(rays, blocked);
                let free = light
                    .iter()
                    .zip(&*blocked)
                    .filter(|(_, blocked)| !**blocked);
                point.near.bounced = free.map(|(light, _)| *light).sum();
                rays.len() as u64
            })
            .sum()
    }

    /// How far contact rays go, metres: half the usual reach of a point.
    pub(super) fn contact_reach(&self) -> f32 {
        let mut radii: Vec<f32> = (self.list.iter())
            .filter(|point| point.needed)
            .map(|point| point.radius)
            .collect();
        radii.sort_by(f32::total_cmp);
        let usual = radii.get(radii.len() / 2).copied().unwrap_or(0.0);
        0.5 * usual / self.metric.per_metre
    }

    /// What close by blocks every needed point. Returns the rays.
    pub(super) fn touch(&mut self, geometry: &Geometry, reach: f32) -> u64 {
        /// Rays a point: their error is shared by all pixels around.
        const RAYS: u32 = 64;
        let needed = self.list.par_iter_mut().filter(|point| point.needed);
        needed
            .map_init(Contact::default, |contact, point| {
                let spot = &point.spot;
                let origin = offset_along_normal(spot.position, spot.flat, spot.extent);
                point.near.blocked =
                    contact.blocked(geometry, origin, spot.normal, reach, RAYS, 0.0);
                u64::from(RAYS)
            })
            .sum()
    }

    /// Inserts and erases points.
    pub(super) fn adapt(
        &mut self,
        geometry: &Geometry,
        view: &View,
        eyes: &Eyes,
        settings: &Field,
        round: Round,
    ) -> Changes {
        let errors: Vec<Option<f32>> = (0..self.list.len())
            .into_par_iter()
            .map(|i| self.error_of(i))
            .collect();
        for (point, error) in self.list.iter_mut().zip(&errors) {
            if let Some(error) = error {
                point.error = *error;
                point.calm = if *error < settings.erase_below && !point.dying {
                    point.calm.saturating_add(1)
                } else {
                    0
                };
            }
        }
        let wanted = self.wanted(geometry, view, eyes, settings);
        let erased = match round {
            Round::First { last: false } => 0,
            _ => self.erase(&errors, settings, matches!(round, Round::First { .. })),
        };
        let mut inserted = 0;
        let strength = match round {
            Round::First { .. } => 1.0,
            Round::Later => 1.0 / FADE,
        };
        let mut distances = Vec::new();
        let room = (settings.most_points as usize).saturating_sub(self.list.len());
        for (place, spot, separation) in wanted {
            if inserted as usize >= room {
                break;
            }
            self.metric
                .distances(spot.position, spot.normal, &self.sites, &mut distances);
            if distances.iter().all(|&d| d > separation) {
                self.sites.push(spot.position, spot.normal);
                self.list.push(Point::new(place, spot, strength));
                inserted += 1;
            }
        }
        Changes { inserted, erased }
    }

    /// The error of interpolating a point from its neighbours; `None` if it or they are not known.
    fn error_of(&self, i: usize) -> Option<f32> {
        let point = &self.list[i];
        if !point.traced {
            return None;
        }
        let known = (point.neighbours.iter())
            .filter(|(k, _)| self.list[*k as usize].traced && !self.list[*k as usize].dying);
        let end = 1.2 * point.neighbours.last()?.1;
        let (mut mean, mut sum) = (Harmonics::default(), 0.0);
        for &(k, distance) in known {
            let w = 1.0 / distance.max(0.01 * end) - 1.0 / end;
            let w = (w * end).powi(2);
            sum += w;
            for (mean, c) in mean.iter_mut().zip(self.list[k as usize].harmonics) {
                *mean += c * w;
            }
        }
        (sum > 0.0).then(|| visibility_error(&point.harmonics, &mean.map(|c| c / sum)))
    }

    /// Places for new points, with the distance that they should keep from others: between points that see otherwise, and where no point reaches.
    fn wanted(
        &self,
        geometry: &Geometry,
        view: &View,
        eyes: &Eyes,
        settings: &Field,
    ) -> Vec<(Place, Spot, f32)> {
        let between: Vec<Vec<(Place, Spot, f32)>> = (0..self.list.len())
            .into_par_iter()
            .map(|i| {
                let point = &self.list[i];
                if !point.traced || point.dying || point.error <= settings.insert_above {
                    return Vec::new();
                }
                let pairs = point.neighbours.iter().filter_map(|&(k, distance)| {
                    let other = &self.list[k as usize];
                    let unlike = other.traced
                        && visibility_error(&point.harmonics, &other.harmonics)
                            > settings.insert_above;
                    if !unlike {
                        return None;
                    }
                    let middle = (point.spot.position + other.spot.position) * 0.5;
                    let normal = (point.spot.normal + other.spot.normal).try_normalize()?;
                    let seen = view.project(middle)?;
                    let eye = eyes.at(seen.point)?;
                    let pixel = 1.0 / seen.density.sqrt();
                    let apart = (point.spot.position - other.spot.position).length();
                    if apart < LEAST_PIXELS * pixel {
                        return None;
                    }
                    let off = self
                        .metric
                        .distance(middle, normal, eye.position, eye.normal);
                    if off > 0.5 * distance {
                        return None;
                    }
                    let (place, spot) = place_of(geometry, eye)?;
                    Some((place, spot, SEPARATION * distance))
                });
                pairs.collect()
            })
            .collect();
        let mut wanted: Vec<_> = between.into_iter().flatten().collect();
        let reach = Reach::new(self, |_| true);
        let mut radii: Vec<f32> = self.list.iter().map(|point| point.radius).collect();
        radii.sort_by(f32::total_cmp);
        let usual = radii.get(radii.len() / 2).copied().unwrap_or(0.1);
        let uncovered: Vec<Option<(Place, Spot, f32)>> = eyes
            .tiles
            .par_iter()
            .filter(|tile| !tile.is_empty())
            .map_init(Vec::new, |ids, tile| {
                reach.around(tile.centre, tile.radius, ids);
                let bare = |eye: &&Eye| {
                    ids.iter().all(|&id| {
                        let point = &self.list[id as usize];
                        let (position, normal) = (point.spot.position, point.spot.normal);
                        let d = self
                            .metric
                            .distance(eye.position, eye.normal, position, normal);
                        point.dying || d >= point.radius
                    })
                };
                let eye = tile.eyes.iter().step_by(3).flatten().find(bare)?;
                let (place, spot) = place_of(geometry, eye)?;
                Some((place, spot, 0.5 * usual))
            })
            .collect();
        wanted.extend(uncovered.into_iter().flatten());
        wanted
    }

    /// Erases points that their neighbours make up for, the smallest errors first, never two neighbours at once.
    fn erase(&mut self, errors: &[Option<f32>], settings: &Field, still: bool) -> u32 {
        let patience = if still { 1 } else { PATIENCE };
        let mut candidates: Vec<(f32, usize)> = (errors.iter().enumerate())
            .filter_map(|(i, error)| {
                let point = &self.list[i];
                let error = (*error)?;
                let ready = error < settings.erase_below
                    && point.calm >= patience
                    && point.neighbours.len() > RADIUS_FROM;
                (ready && !point.dying).then_some((error, i))
            })
            .collect();
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut kept = vec![false; self.list.len()];
        let mut gone = 0;
        for (_, i) in candidates {
            let point = &self.list[i];
            let near = || point.neighbours.iter().map(|(k, _)| *k as usize);
            if kept[i] || near().any(|k| self.list[k].dying) {
                continue;
            }
            near().for_each(|k| kept[k] = true);
            self.list[i].dying = true;
            gone += 1;
        }
        if still && gone > 0 {
            // Numbers of neighbours are found anew before they are used again.
            self.list.retain(|point| !point.dying);
            self.sites.clear();
            for point in &self.list {
                self.sites.push(point.spot.position, point.spot.normal);
            }
        }
        gone
    }

    /// Bytes of maps and fields.
    pub(super) fn bytes(&self) -> u64 {
        self.list.iter().map(|point| point.bytes() as u64).sum()
    }
}

/// Short rays about a normal.
#[derive(Debug, Default)]
pub(super) struct Contact {
    rays: Vec<Ray>,
    blocked: Vec<bool>,
}

impl Contact {
    /// Share of the cosine-weighted directions that are blocked within `reach`, by `count` rays; `turn` in turns rotates their pattern.
    pub(super) fn blocked(
        &mut self,
        geometry: &Geometry,
        origin: Vec3,
        normal: Vec3,
        reach: f32,
        count: u32,
        turn: f32,
    ) -> f32 {
        let (s, t) = normal.any_orthonormal_pair();
        self.rays.clear();
        self.rays.extend((0..count).map(|k| {
            // A Fibonacci spiral, even in the projected hemisphere.
            let square = (k as f32 + 0.5) / count as f32;
            let angle = (0.618_034 * k as f32 + turn).fract() * std::f32::consts::TAU;
            let (sin, cos) = angle.sin_cos();
            let r = square.sqrt();
            let w = (s * cos + t * sin) * r + normal * (1.0 - square).sqrt();
            Ray {
                t_max: reach,
                ..Ray::new(origin, w)
            }
        }));
        self.blocked.clear();
        self.blocked.resize(count as usize, false);
        geometry.occluded_batch(&self.rays, &mut self.blocked);
        self.blocked.iter().filter(|blocked| **blocked).count() as f32 / count.max(1) as f32
    }
}

fn hint(point: &Point) -> Hint<'_> {
    Hint {
        map: &point.map,
        hemisphere: point.hemisphere,
    }
}

/// The place that a pixel shows.
pub(super) fn place_of(geometry: &Geometry, eye: &Eye) -> Option<(Place, Spot)> {
    // The normal is on the side of the viewer: as a direction towards them it finds the side again.
    Place::of_hit(geometry, &eye.hit, eye.normal)
}

/// The nearest others by distance.
fn nearest(distances: &[f32], own: usize) -> Vec<(u32, f32)> {
    let mut near: Vec<(u32, f32)> = Vec::with_capacity(NEIGHBOURS + 1);
    let mut farthest = f32::INFINITY;
    for (k, &d) in distances.iter().enumerate() {
        if d < farthest && k != own {
            let at = near.partition_point(|&(_, other)| other <= d);
            near.insert(at, (k as u32, d));
            near.truncate(NEIGHBOURS);
            if near.len() == NEIGHBOURS {
                farthest = near[NEIGHBOURS - 1].1;
            }
        }
    }
    near
}

/// Points that are looked at together.
const GROUP: usize = 16;

/// Points and how far in space they reach, for balls that ask who reaches them.
#[derive(Debug)]
pub(super) struct Reach {
    /// Positions and how far they reach, in the order of a curve through space.
    columns: [Vec<f32>; 4],
    ids: Vec<u32>,
    /// Balls that hold [`GROUP`] points each, as far as they reach.
    groups: Vec<(Vec3, f32)>,
}

impl Reach {
    pub(super) fn new(points: &Points, wanted: impl Fn(&Point) -> bool) -> Self {
        let wanted: Vec<u32> = (points.list.iter().enumerate())
            .filter(|(_, point)| wanted(point))
            .map(|(id, _)| id as u32)
            .collect();
        let place = |id: u32| points.list[id as usize].spot.position;
        let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        for &id in &wanted {
            (low, high) = (low.min(place(id)), high.max(place(id)));
        }
        let scale = 255.0 / (high - low).max_element().max(1e-20);
        let mut keyed: Vec<(u32, u32)> = (wanted.iter())
            .map(|&id| (along_curve((place(id) - low) * scale), id))
            .collect();
        keyed.sort_unstable();
        let mut reach = Self {
            columns: Default::default(),
            ids: keyed.iter().map(|&(_, id)| id).collect(),
            groups: Vec::new(),
        };
        let metres = |id: u32| points.list[id as usize].radius / points.metric.per_metre;
        for &id in &reach.ids {
            let Vec3 { x, y, z } = place(id);
            for (column, value) in reach.columns.iter_mut().zip([x, y, z, metres(id)]) {
                column.push(value);
            }
        }
        for group in reach.ids.chunks(GROUP) {
            let middle = group.iter().map(|&id| place(id)).sum::<Vec3>() / group.len() as f32;
            let far = group
                .iter()
                .map(|&id| place(id).distance(middle) + metres(id));
            // A hair more, for rounding.
            let radius = far.fold(0.0, f32::max) * 1.0001;
            reach.groups.push((middle, radius));
        }
        reach
    }

    /// The points whose reach meets a ball, in an order of their own that is always the same.
    pub(super) fn around(&self, centre: Vec3, radius: f32, out: &mut Vec<u32>) {
        out.clear();
        find(self, centre, radius, out);
    }
}

/// The place of a point of `[0, 256)^3` on the Morton curve.
fn along_curve(p: Vec3) -> u32 {
    p.to_array().iter().enumerate().fold(0, |code, (axis, &v)| {
        let cell = (v as u32).min(255);
        (0..8).fold(code, |code, bit| {
            code | (cell >> bit & 1) << (3 * bit + axis as u32)
        })
    })
}

super::math::wide! {
fn find(reach: &Reach, centre: Vec3, radius: f32, out: &mut Vec<u32>) {
    let count = reach.ids.len();
    let [x, y, z, r] = reach.columns.each_ref().map(|column| &column[..count]);
    for (group, &(middle, far)) in reach.groups.iter().enumerate() {
        let sum = far + radius;
        if middle.distance_squared(centre) >= sum * sum {
            continue;
        }
        let start = group * GROUP;
        let end = (start + GROUP).min(count);
        let mut meets = [false; GROUP];
        for k in start..end {
            let (dx, dy, dz) = (x[k] - centre.x, y[k] - centre.y, z[k] - centre.z);
            let sum = r[k] + radius;
            meets[k - start] = dx * dx + dy * dy + dz * dz < sum * sum;
        }
        for (k, meets) in meets[..end - start].iter().enumerate() {
            if *meets {
                out.push(reach.ids[start + k]);
            }
        }
    }
}
}
