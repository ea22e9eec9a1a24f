//! Refinement, step by step (Ulbrich 2013, sections 3.2, 3.3 and 5).

use super::cache::{Cache, PathSite, Slot};
use super::correlation;
use super::map::{self, DistanceTracer, Map, Site, Stand};
use super::neighbours::{self, NEIGHBOURS, NOBODY, enter};
use crate::Ray;
use crate::wide::Machine;
use glam::Vec2;
use std::sync::atomic::AtomicU64;
use std::time::{Duration, Instant};

/// Candidates for a new place, and places on the disk that are tried for them (section 5).
const CANDIDATES: usize = 10;
const TRIES: usize = 50;

/// Times that the disk of candidates grows before a step gives up.
const MOST_GROWTH: u32 = 4;

/// Share of the records that may move between two pilot batches.
const MOVED_PER_PILOT: u32 = 32;

/// How long the parts of refinement steps took: Table 1 of the paper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Steps taken, those that found no place included.
    pub steps: u64,
    /// Steps that found a place.
    pub placed: u64,
    /// Finding the least and the most important record.
    pub find: Duration,
    /// Choosing the new place.
    pub place: Duration,
    /// Updating the search tree.
    pub tree: Duration,
    /// Marking old neighbours and finding new ones.
    pub neighbours: Duration,
    /// Tracing the map.
    pub fill: Duration,
    /// Correlation with the neighbours.
    pub correlation: Duration,
}

impl StepTimes {
    /// All parts together.
    pub fn total(&self) -> Duration {
        self.find + self.place + self.tree + self.neighbours + self.fill + self.correlation
    }
}

struct Clock(Instant);

impl Clock {
    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        now - std::mem::replace(&mut self.0, now)
    }
}

impl Cache {
    /// Share of directions in which `a` sees what `b` sees, too (section 3.2).
    pub(super) fn agreement(&self, a: u32, b: u32) -> f32 {
        let record = |id: u32| (&self.stands[id as usize], self.map(id));
        correlation::agreement(Machine::detect(), &self.layout, record(a), record(b))
    }

    /// Importance of every record (Eq. 1), with `u_max` over all.
    pub(super) fn importance(&self, slot: &Slot, most: f32) -> f32 {
        let mu = if most > 0.0 { slot.utility / most } else { 0.0 };
        let alpha = self.settings.alpha;
        (1.0 - slot.correlation()) * (1.0 - alpha) + mu * alpha
    }

    pub(super) fn most_used(&self) -> f32 {
        self.slots
            .iter()
            .fold(0.0, |most, slot| most.max(slot.utility))
    }

    /// Takes `steps` steps, with pilot batches by `pilot` now and then.
    pub fn refine_before<T: DistanceTracer>(
        &mut self,
        tracer: &T,
        steps: u32,
        pilot: &mut dyn FnMut(&mut Vec<PathSite>),
    ) {
        let mut sites = Vec::new();
        for step in 0..steps {
            if step % (self.len() as u32 / MOVED_PER_PILOT).max(1) == 0 {
                sites.clear();
                pilot(&mut sites);
                self.pilot(&sites);
            }
            self.refine(tracer);
        }
        self.unserved.clear();
        self.freshen();
    }

    /// Learns from a pass: takes over what it has used ([`Self::end_pass`]), and takes [`RecordSettings::pace`](super::RecordSettings::pace) steps.
    pub fn pass_done<T: DistanceTracer>(&mut self, tracer: &T) {
        let began = Instant::now();
        self.passes += 1;
        self.end_pass();
        self.refine_after(tracer, self.settings.pace);
        self.report.upkeep += began.elapsed();
    }

    /// Takes `steps` steps behind a pass.
    pub fn refine_after<T: DistanceTracer>(&mut self, tracer: &T, steps: u32) {
        for _ in 0..steps {
            self.refine(tracer);
        }
        self.freshen();
    }

    /// One step (section 3.3): a new record near the most important one, in place of the least important one if there is no room. Before
    /// that, beyond the paper, places that nobody answers for get one: steps around records would hardly ever come there.
    /// Returns whether a place was found.
    pub fn refine<T: DistanceTracer>(&mut self, tracer: &T) -> bool {
        if !self.can_improve() {
            return false;
        }
        let mut times = self.report.steps;
        times.steps += 1;
        let mut clock = Clock(Instant::now());
        let most = self.most_used();
        let full = self.len() >= self.settings.capacity as usize;
        let (mut least, mut highest) = (0, 0);
        let mut bounds = [f32::INFINITY, f32::NEG_INFINITY];
        for (id, slot) in self.slots.iter().enumerate() {
            let importance = self.importance(slot, most);
            if importance < bounds[0] {
                (least, bounds[0]) = (id as u32, importance);
            }
            if importance > bounds[1] {
                (highest, bounds[1]) = (id as u32, importance);
            }
        }
        times.find += clock.lap();
        let removed = full.then_some(least);
        let unserved = self.unserved_place();
        let place = if unserved.is_some() {
            unserved
        } else if removed == Some(highest) {
            None
        } else {
            self.new_place(tracer, highest, removed)
        };
        times.place += clock.lap();
        if let Some(stand) = place {
            let settings = &self.settings;
            let (surfaces, threads) = (settings.surfaces, settings.threads);
            let map = map::fill(tracer, &self.layout, &stand, surfaces, threads);
            self.report.fill_rays += self.layout.texels.len() as u64;
            times.fill += clock.lap();
            if map::is_blind(&map, &self.layout, self.blind_within()) {
                self.report.blind += 1;
            } else {
                times.placed += 1;
                let utility = if unserved.is_some() {
                    let sum: f32 = self.slots.iter().map(|slot| slot.utility).sum();
                    sum / self.len() as f32
                } else {
                    // Two share from now on what one was asked. Whole, the guess would draw the next record here, too, until somebody
                    // asks.
                    let utility = 0.5 * self.slots[highest as usize].utility;
                    self.slots[highest as usize].utility = utility;
                    utility
                };
                self.replace(removed, stand, map, utility, &mut times, &mut clock);
            }
        }
        let placed = times.placed > self.report.steps.placed;
        self.report.steps = times;
        placed
    }

    fn replace(
        &mut self,
        removed: Option<u32>,
        stand: Stand,
        map: Map,
        utility: f32,
        times: &mut StepTimes,
        clock: &mut Clock,
    ) {
        let old = removed.map(|id| self.stands[id as usize].site.position);
        let id = match removed.zip(old) {
            Some((id, old)) => {
                self.index.remove(id, old);
                self.index.insert(id, stand.site.position);
                self.stands[id as usize] = stand;
                self.slots[id as usize] = Slot::new(map, utility);
                self.uses[id as usize] = AtomicU64::new(0);
                id
            }
            None => {
                self.push(stand, Slot::new(map, utility));
                self.len() as u32 - 1
            }
        };
        self.changed(old, Some(stand.site.position));
        times.tree += clock.lap();

        // Who was linked to the old record looks for others.
        let mut touched: Vec<u32> = Vec::new();
        if removed.is_some() {
            for (other, slot) in self.slots.iter_mut().enumerate() {
                if let Some(k) = slot.links.iter().position(|link| link.0 == id) {
                    slot.agreement[k] = f32::NAN;
                    slot.links[k].0 = NOBODY;
                    touched.push(other as u32);
                }
            }
        }
        for &other in &touched {
            self.link(other);
        }
        self.link(id);
        // Who stands near the new record may prefer it.
        let near: Vec<u32> = (self.index.nearest(stand.site.position))
            .map(|(other, _)| other)
            .filter(|&other| other != id)
            .take(2 * NEIGHBOURS)
            .collect();
        for other in near {
            let there = &self.stands[other as usize].site;
            let slot = &mut self.slots[other as usize];
            if slot.links.iter().any(|link| link.0 == id) {
                continue;
            }
            let offset = stand.site.position - there.position;
            let falloff = self.settings.falloff;
            let (normal, new) = (there.normal, stand.site.normal);
            let w = neighbours::weight(falloff, normal, new, offset, slot.d_max);
            let before = slot.links;
            if enter(&mut slot.links, (id, w)) {
                let old = slot.agreement;
                for k in 0..NEIGHBOURS {
                    let known = before.iter().position(|link| link.0 == slot.links[k].0);
                    slot.agreement[k] = known.map_or(f32::NAN, |k| old[k]);
                }
                touched.push(other);
            }
        }
        times.neighbours += clock.lap();
        touched.push(id);
        for other in touched {
            self.correlate(other);
        }
        times.correlation += clock.lap();
    }

    /// A place that was asked for and that no record answers for.
    fn unserved_place(&mut self) -> Option<Stand> {
        while !self.unserved.is_empty() {
            let any = self.random.next() as usize % self.unserved.len();
            let site = self.unserved.swap_remove(any);
            if self.nearby(site.position, site.normal).ids[0] == NOBODY {
                return Some(Stand::new(site));
            }
        }
        None
    }

    /// A place near record `j` that is unlike those that have records (section 3.3, with the numbers of section 5). Record `gone` does
    /// not count.
    fn new_place<T: DistanceTracer>(
        &mut self,
        tracer: &T,
        j: u32,
        gone: Option<u32>,
    ) -> Option<Stand> {
        let around = self.stands[j as usize];
        let links = self.slots[j as usize].links;
        let distance = |id: u32| {
            let there = self.stands[id as usize].site.position;
            there.distance(around.site.position)
        };
        let known = links.iter().filter(|link| link.0 != NOBODY);
        let mut farthest = known.map(|link| distance(link.0)).fold(0.0, f32::max);
        if farthest.is_nan() || farthest <= 0.0 {
            farthest = self.spacing;
        }
        // The middle of the map: how far it is to what hangs above.
        let half = self.layout.resolution / 2;
        let above = self.map(j).code(half * self.layout.resolution + half);
        let room = 0.5 * self.layout.scale.decode(above);
        let mut required = CANDIDATES;
        let mut candidates = Vec::new();
        let mut rays = Vec::with_capacity(TRIES);
        let mut sites = [None; TRIES];
        for _ in 0..=MOST_GROWTH {
            let lift = (0.25 * farthest).min(room);
            rays.clear();
            for _ in 0..TRIES {
                let (radius, turn) = (self.random.unit().sqrt(), self.random.unit());
                let at = Vec2::from_angle(std::f32::consts::TAU * turn) * (0.7 * farthest * radius);
                let start = around.site.origin + around.world(at.extend(lift));
                rays.push(Ray {
                    t_max: 1.25 * farthest,
                    ..Ray::new(start, -around.site.normal)
                });
            }
            tracer.sites(&rays, &mut sites);
            self.report.place_rays += TRIES as u64;
            candidates.extend(sites.iter().flatten().copied());
            candidates.retain(|site| site.position.is_finite() && site.normal.is_normalized());
            if candidates.len() >= required {
                candidates.truncate(required);
                break;
            }
            farthest *= 2.0;
            required = (required / 2).max(1);
        }
        let strangeness = |site: &Site| {
            let stand = Stand::new(*site);
            let gone = gone.unwrap_or(NOBODY);
            let (links, _) = neighbours::links(
                &self.index,
                &self.stands,
                self.settings.falloff,
                &stand,
                gone,
            );
            links[0].1
        };
        let rated = candidates.iter().map(|site| (strangeness(site), site));
        let best = rated.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Stand::new(*best.1))
    }
}
