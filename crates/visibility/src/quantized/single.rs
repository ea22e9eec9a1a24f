//! Single questions: Algorithms 1 and 2 of the paper, a batch at a time.
//!
//! A batch goes level by level: all its questions are looked up; unknown clusters are traced together, each once; the
//! answers are stored; then questions whose neighbours disagree go on to the next level. Apart from the order of events
//! inside a batch this is Algorithm 2: neighbours that the batch itself has traced count as present.

use super::key::Cell;
use super::table::{Memory, WordTable};
use super::{Clustered, Decisions, Guarantee, Quantized, QuantizedWorker};
use crate::{Query, Ray, Tracer, VisibilityStats};

/// How often an answer is checked by a ray ([`Guarantee::Unbiased`]), by the number of neighbours that are known, at the first
/// level and at finer ones: in proportion to the root of how often such answers were found to be wrong, which makes the
/// variance least for a number of rays. A question of twice the average importance is checked twice as often.
const CHECKED: [[f32; 5]; 2] = [
    [0.20, 0.18, 0.09, 0.075, 0.03],
    [0.60, 0.40, 0.27, 0.165, 0.09],
];

/// How often the first question of a cluster that has the average importance is traced ([`Guarantee::Unbiased`]): others are
/// answered by a guess, right on average too.
const TRACED: f32 = 1.0;

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    clustered: Vec<Option<Clustered>>,
    /// Relative to the mean of the batch; empty unless the guarantee asks for it.
    importance: Vec<f32>,
    active: Vec<u32>,
    next: Vec<u32>,
    /// Cells and digests of the active questions, and what memory holds of them.
    keys: Vec<Option<(Cell, u64)>>,
    memories: Vec<Option<Memory>>,
    misses: Vec<Miss>,
    order: Vec<u32>,
    visible: Vec<bool>,
    found: Vec<Found>,
    /// Digests of the neighbours of what was found, where they matter, and what memory holds of them.
    around: Vec<Option<[u64; 4]>>,
    surroundings: Vec<Option<Surroundings>>,
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
    /// Of a ray that was left to chance: the answer without it, and the chance. Else any, and 1.
    guess: f32,
    probability: f32,
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
    scratch.weigh(strategy, queries);
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
        look_up(strategy, table, scratch, level, decisions, answers);
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
fn look_up(
    strategy: &Quantized,
    table: &WordTable,
    scratch: &mut Scratch,
    level: u32,
    decisions: &mut Decisions,
    answers: &mut [f32],
) {
    let salt = decisions.salt;
    let unbiased = strategy.settings.guarantee == Guarantee::Unbiased;
    scratch.misses.clear();
    scratch.found.clear();
    scratch.pending.clear(scratch.active.len());
    // Keys first, then nothing but loads: a large table's words are far away, and many are waited for at once.
    scratch.keys.clear();
    for &query in &scratch.active {
        scratch
            .keys
            .push(scratch.clustered[query as usize].as_ref().map(|clustered| {
                let cell = strategy.eye_cell(clustered, level);
                (cell, strategy.digest(&cell, clustered, salt))
            }));
    }
    scratch.memories.clear();
    for key in &scratch.keys {
        scratch
            .memories
            .push(key.and_then(|(_, digest)| table.get(digest)));
    }
    for ((&query, key), &memory) in scratch
        .active
        .iter()
        .zip(&scratch.keys)
        .zip(&scratch.memories)
    {
        let (Some((cell, digest)), Some(clustered)) = (*key, &scratch.clustered[query as usize])
        else {
            scratch.misses.push(Miss {
                query,
                digest: None,
                light: 0,
                guess: 0.0,
                probability: 1.0,
            });
            continue;
        };
        let value = if let Some(memory) = memory {
            Value::Known(memory)
        } else if let Some(miss) = scratch.pending.find(digest) {
            Value::Awaited(miss)
        } else {
            let (mut guess, mut probability) = (0.0, 1.0);
            if unbiased {
                probability = (TRACED * scratch.importance[query as usize]).min(1.0);
                let digest = |cell: Cell| strategy.digest(&cell, clustered, salt);
                guess = Surroundings::of(table, cell.neighbours().map(digest)).guess();
                if !decisions.decide(probability) {
                    answers[query as usize] = guess;
                    continue;
                }
            }
            let next = scratch.misses.len() as u32;
            scratch.pending.insert(digest, next);
            scratch.misses.push(Miss {
                query,
                digest: Some(digest),
                light: clustered.light_half,
                guess,
                probability,
            });
            continue;
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
        let exact = if occluded { 0.0 } else { 1.0 };
        answers[miss.query as usize] = if miss.probability < 1.0 {
            miss.guess + (exact - miss.guess) / miss.probability
        } else {
            exact
        };
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
    let clustered = &scratch.clustered;
    let is_last = |query: u32| {
        clustered[query as usize]
            .as_ref()
            .is_none_or(|clustered| level + 1 >= clustered.levels)
    };
    // As above: digests first, then nothing but loads.
    scratch.around.clear();
    scratch.around.extend(scratch.found.iter().map(|found| {
        let contested = matches!(found.value, Value::Known(memory) if memory.contested);
        let matters = !contested && (unbiased || !is_last(found.query));
        let clustered = clustered[found.query as usize].as_ref()?;
        matters.then(|| {
            let digest = |cell: Cell| strategy.digest(&cell, clustered, decisions.salt);
            found.cell.neighbours().map(digest)
        })
    }));
    scratch.surroundings.clear();
    scratch.surroundings.extend(
        (scratch.around.iter())
            .map(|around| around.map(|digests| Surroundings::of(table, digests))),
    );
    for (found, &around) in scratch.found.iter().zip(&scratch.surroundings) {
        let &Found {
            query,
            digest,
            value,
            ..
        } = found;
        let Memory { visible, contested } = match value {
            Value::Known(memory) => memory,
            Value::Awaited(miss) => Memory {
                visible: scratch.visible[miss as usize],
                contested: false,
            },
        };
        let last = is_last(query);
        let agree = !contested && around.is_none_or(|around| around.agree(visible));
        if !agree && !last {
            scratch.next.push(query);
            continue;
        }
        answers[query as usize] = if visible { 1.0 } else { 0.0 };
        if unbiased {
            let probability = match around {
                Some(around) if agree => {
                    let often = CHECKED[usize::from(level > 0)][around.known as usize];
                    (often * scratch.importance[query as usize]).min(1.0)
                }
                _ => 1.0,
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

impl Scratch {
    /// Importances relative to their mean.
    fn weigh(&mut self, strategy: &Quantized, queries: &[Query]) {
        self.importance.clear();
        if strategy.settings.guarantee != Guarantee::Unbiased {
            return;
        }
        let usable = |x: f32| if x.is_finite() && x > 0.0 { x } else { 0.0 };
        let sum: f64 = queries
            .iter()
            .map(|query| f64::from(usable(query.importance)))
            .sum();
        let per_mean = if sum > 0.0 {
            (queries.len() as f64 / sum) as f32
        } else {
            0.0
        };
        self.importance.extend(
            queries
                .iter()
                .map(|query| usable(query.importance) * per_mean),
        );
    }
}

/// What is known of a cell's neighbours.
#[derive(Clone, Copy, Debug, Default)]
struct Surroundings {
    known: u32,
    visible: u32,
}

impl Surroundings {
    fn of(table: &WordTable, neighbours: [u64; 4]) -> Self {
        let mut around = Self::default();
        for memory in neighbours
            .map(|digest| table.get(digest))
            .into_iter()
            .flatten()
        {
            around.known += 1;
            around.visible += u32::from(memory.visible);
        }
        around
    }

    /// Whether no neighbour is known to differ.
    fn agree(self, visible: bool) -> bool {
        self.visible == if visible { self.known } else { 0 }
    }

    /// The answer that is likely: of nothing known an open view, so that there is no noise where nothing blocks.
    fn guess(self) -> f32 {
        if self.known == 0 {
            1.0
        } else {
            self.visible as f32 / self.known as f32
        }
    }
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

    fn slot(&self, digest: u64) -> usize {
        let mask = self.slots.len() - 1;
        let mut place = (digest >> 32) as usize & mask;
        while self.slots[place].1 != Self::EMPTY && self.slots[place].0 != digest {
            place = (place + 1) & mask;
        }
        place
    }

    /// The number of the digest.
    fn find(&self, digest: u64) -> Option<u32> {
        let (_, number) = self.slots[self.slot(digest)];
        (number != Self::EMPTY).then_some(number)
    }

    /// Gives a digest that is not there a number.
    fn insert(&mut self, digest: u64, number: u32) {
        let slot = self.slot(digest);
        self.slots[slot] = (digest, number);
    }
}
