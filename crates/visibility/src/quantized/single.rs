//! Single questions: Algorithms 1 and 2 of the paper, a batch at a time.
//!
//! A batch goes level by level: all its questions are looked up; unknown clusters are traced together, each once; the
//! answers are stored; then questions whose neighbours disagree go on to the next level. Apart from the order of events
//! inside a batch this is Algorithm 2: neighbours that the batch itself has traced count as present.

use super::key::Cell;
use super::table::{Memory, WordTable};
use super::{Clustered, Decisions, Guarantee, Quantized, QuantizedWorker};
use crate::{Query, Ray, Tracer, VisibilityStats};

/// Share of answers that are checked by a ray where memory has no reason for doubt ([`Guarantee::Unbiased`]).
const CHECKED: f32 = 1.0 / 24.0;
/// The same once an answer had to be refined: near an edge.
const CHECKED_AT_EDGES: f32 = 1.0 / 4.0;

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    clustered: Vec<Option<Clustered>>,
    active: Vec<u32>,
    next: Vec<u32>,
    misses: Vec<Miss>,
    order: Vec<u32>,
    visible: Vec<bool>,
    found: Vec<Found>,
    checks: Vec<Check>,
    pending: Pending,
    rays: Vec<Ray>,
    occluded: Vec<bool>,
}

/// A question whose cluster nobody has traced yet.
#[derive(Clone, Copy, Debug)]
struct Miss {
    query: u32,
    /// `None`: traced exactly, not remembered.
    digest: Option<u64>,
    /// What rays are sorted by before they are traced.
    light: u64,
}

/// A question whose cluster is known, or will be when the misses are traced.
#[derive(Clone, Copy, Debug)]
struct Found {
    query: u32,
    cell: Cell,
    digest: u64,
    value: Value,
}

#[derive(Clone, Copy, Debug)]
enum Value {
    Known(Memory),
    /// The answer to be of this digest's miss.
    Awaited(u32),
}

/// An answer that a ray will check.
#[derive(Clone, Copy, Debug)]
struct Check {
    query: u32,
    digest: u64,
    cached: bool,
    probability: f32,
}

/// Answers a batch.
pub(super) fn answer<T: Tracer>(
    strategy: &Quantized,
    tracer: &T,
    worker: &mut QuantizedWorker,
    queries: &[Query],
    answers: &mut [f32],
) {
    let QuantizedWorker {
        own,
        epoch,
        decisions,
        single: scratch,
        stats,
        held,
        ..
    } = worker;
    let table = strategy.words(own, held);
    stats.queries += queries.len() as u64;
    scratch.clustered.clear();
    scratch
        .clustered
        .extend(queries.iter().map(|query| strategy.cluster(query, *epoch)));
    scratch.active.clear();
    scratch.active.extend(0..queries.len() as u32);
    scratch.checks.clear();

    let traced = stats.traced;
    let mut level = 0;
    while !scratch.active.is_empty() {
        look_up(strategy, table, scratch, level, decisions.salt);
        trace(tracer, scratch, queries, answers, table, stats);
        refine(strategy, table, scratch, level, decisions, answers, stats);
        std::mem::swap(&mut scratch.active, &mut scratch.next);
        level += 1;
    }
    check(tracer, scratch, queries, answers, table, stats);
    // A refined question may miss at one level only, and a checked one has not missed: each traced at most one ray.
    stats.answered += queries.len() as u64 - (stats.traced - traced);
}

/// Algorithm 1, lines 2 and 3: the key of every active question at this level, and whether its cluster is known.
fn look_up(strategy: &Quantized, table: &WordTable, scratch: &mut Scratch, level: u32, salt: u64) {
    scratch.misses.clear();
    scratch.found.clear();
    scratch.pending.clear(scratch.active.len());
    for &query in &scratch.active {
        let Some(clustered) = &scratch.clustered[query as usize] else {
            scratch.misses.push(Miss {
                query,
                digest: None,
                light: 0,
            });
            continue;
        };
        let cell = strategy.eye_cell(clustered, level);
        let digest = strategy.digest(&cell, clustered, salt);
        let next = scratch.misses.len() as u32;
        let value = match table.get(digest) {
            Some(memory) => Value::Known(memory),
            None => match scratch.pending.find_or_insert(digest, next) {
                Some(miss) => Value::Awaited(miss),
                None => {
                    scratch.misses.push(Miss {
                        query,
                        digest: Some(digest),
                        light: clustered.light_half,
                    });
                    continue;
                }
            },
        };
        scratch.found.push(Found {
            query,
            cell,
            digest,
            value,
        });
    }
}

/// Algorithm 1, lines 4 to 7: the first question of an unknown cluster stands for all. Rays go out light by light, since
/// those towards one light are coherent.
fn trace<T: Tracer>(
    tracer: &T,
    scratch: &mut Scratch,
    queries: &[Query],
    answers: &mut [f32],
    table: &WordTable,
    stats: &mut VisibilityStats,
) {
    let Scratch {
        misses,
        order,
        rays,
        occluded,
        visible,
        ..
    } = scratch;
    order.clear();
    order.extend(0..misses.len() as u32);
    order.sort_by_key(|&miss| misses[miss as usize].light);
    rays.clear();
    rays.extend(
        order
            .iter()
            .map(|&miss| queries[misses[miss as usize].query as usize].ray),
    );
    occluded.clear();
    occluded.resize(rays.len(), false);
    tracer.occluded_batch(rays, occluded);
    visible.clear();
    visible.resize(misses.len(), false);
    for (&number, &occluded) in order.iter().zip(occluded.iter()) {
        let miss = misses[number as usize];
        visible[number as usize] = !occluded;
        answers[miss.query as usize] = if occluded { 0.0 } else { 1.0 };
        if let Some(digest) = miss.digest {
            let memory = Memory {
                visible: !occluded,
                contested: false,
            };
            stats.overwritten += u64::from(table.put(digest, memory));
        }
    }
    stats.traced += misses.len() as u64;
}

/// Algorithm 2, lines 9 to 14: a question whose four neighbours along the surface agree, or are unknown, has its answer;
/// the others go on to cells of half the size.
fn refine(
    strategy: &Quantized,
    table: &WordTable,
    scratch: &mut Scratch,
    level: u32,
    decisions: &mut Decisions,
    answers: &mut [f32],
    stats: &mut VisibilityStats,
) {
    scratch.next.clear();
    let unbiased = strategy.settings.guarantee == Guarantee::Unbiased;
    for &Found {
        query,
        cell,
        digest,
        value,
    } in &scratch.found
    {
        let Some(clustered) = &scratch.clustered[query as usize] else {
            continue;
        };
        let Memory { visible, contested } = match value {
            Value::Known(memory) => memory,
            Value::Awaited(miss) => Memory {
                visible: scratch.visible[miss as usize],
                contested: false,
            },
        };
        let last = level + 1 >= clustered.levels;
        let look_around = !last || unbiased;
        let agree = !contested
            && (!look_around
                || cell.neighbours().iter().all(|neighbour| {
                    let digest = strategy.digest(neighbour, clustered, decisions.salt);
                    table
                        .get(digest)
                        .is_none_or(|other| other.visible == visible)
                }));
        if !agree && !last {
            scratch.next.push(query);
            continue;
        }
        answers[query as usize] = if visible { 1.0 } else { 0.0 };
        if unbiased {
            let probability = match (agree, level) {
                (false, _) => 1.0,
                (true, 0) => CHECKED,
                (true, _) => CHECKED_AT_EDGES,
            };
            if decisions.decide(probability) {
                scratch.checks.push(Check {
                    query,
                    digest,
                    cached: visible,
                    probability,
                });
            }
        }
    }
    let refined = scratch.next.len() as u64;
    if refined > 0 {
        let level = level as usize;
        if stats.refined.len() <= level {
            stats.refined.resize(level + 1, 0);
        }
        stats.refined[level] += refined;
    }
}

/// Traces the chosen answers, and corrects them so that the mean is right: `V' = Vc + (V - Vc) [u < p] / p`, where neither
/// `Vc` nor `p` depends on `u`. Where a ray and memory differ, memory is contested from then on: later questions refine there,
/// and are checked more often.
fn check<T: Tracer>(
    tracer: &T,
    scratch: &mut Scratch,
    queries: &[Query],
    answers: &mut [f32],
    table: &WordTable,
    stats: &mut VisibilityStats,
) {
    let Scratch {
        checks,
        rays,
        occluded,
        ..
    } = scratch;
    rays.clear();
    rays.extend(checks.iter().map(|check| queries[check.query as usize].ray));
    occluded.clear();
    occluded.resize(rays.len(), false);
    tracer.occluded_batch(rays, occluded);
    for (check, &occluded) in checks.iter().zip(occluded.iter()) {
        let [cached, exact] = [check.cached, !occluded].map(|v| if v { 1.0 } else { 0.0 });
        answers[check.query as usize] = cached + (exact - cached) / check.probability;
        if cached != exact {
            let memory = Memory {
                visible: check.cached,
                contested: true,
            };
            stats.overwritten += u64::from(table.put(check.digest, memory));
        }
    }
    stats.traced += checks.len() as u64;
}

/// Which clusters the batch has missed already: open addressing, half empty.
#[derive(Debug, Default)]
struct Pending {
    slots: Vec<(u64, u32)>,
}

impl Pending {
    const EMPTY: u32 = u32::MAX;

    /// Makes room for `count` clusters.
    fn clear(&mut self, count: usize) {
        self.slots.clear();
        self.slots
            .resize((2 * count).next_power_of_two(), (0, Self::EMPTY));
    }

    /// The number that the digest has, or `None` if it is new and now has `number`.
    fn find_or_insert(&mut self, digest: u64, number: u32) -> Option<u32> {
        let mask = self.slots.len() - 1;
        let mut place = (digest >> 32) as usize & mask;
        loop {
            let slot = &mut self.slots[place];
            if slot.1 == Self::EMPTY {
                *slot = (digest, number);
                return None;
            }
            if slot.0 == digest {
                return Some(slot.1);
            }
            place = (place + 1) & mask;
        }
    }
}
