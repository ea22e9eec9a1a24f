//! Exact visibility that tries the last blocker first.
//!
//! Neighbouring shadow rays towards one light tend to be stopped by the same triangle. A small table, one for each worker,
//! remembers the triangle that stopped the last ray of a *bin* (a light and a range of lines towards it) and tests that
//! one triangle before tracing: the shadow cache of Radiance's `srcobstr.c` (Ward), older still as Haines and Greenberg's
//! light buffer (1986). A remembered blocker only counts if [`Tracer::blocks`] confirms it for the very ray in question, so
//! answers equal those of [`Exact`](crate::Exact) bit for bit, whatever the table holds.
//!
//! Bins by the kind of light end:
//!
//! * point: the light and the direction from it to the eye: what blocks near the light blocks for every eye behind it;
//! * direction: the light and the eye's place across it;
//! * surface: a cell of the light's surface and the direction from it to the eye;
//! * solid angle: a cell of directions and the eye's place across its centre.
//!
//! A bin whose ray went free forgets its blocker: lit places then pay for a table look-up only, not for a triangle test.
//!
//! Measured on path tracing with 8 scattering events, 256 x 256 pixels, 9 samples: of all questions memory answers 38 % in
//! `sponza` (one sun, half of all blocked rays; time 0.9 to 1.1 of `Exact`), 15 to 23 % in `apartment` (thousands of point
//! lights) and 8 % in `white_room` (large area lights; both take 1.2 times as long as `Exact`). So it pays where rays are
//! dear and lights are few and small, or with a slow tracer. Larger tables answer more and take longer.
//!
//! Wrong tool: where most questions find light (nothing to remember), for incoherent questions about large lights, and for
//! tracers that cannot name their blockers (a closure), where it costs a little more than `Exact` and saves nothing.

use crate::stats::{Footprint, Held};
use crate::{Class, LightEnd, Query, Ray, Tracer, Visibility, VisibilityStats};
use glam::{Vec2, Vec3};

/// Bins along each side of the octahedral map of directions around a point light.
const POINT_BINS: f32 = 8.0;
/// The same around a cell of an emitting surface.
const SURFACE_BINS: f32 = 8.0;
/// Bins along each side of the octahedral map of sky directions.
const SKY_BINS: f32 = 8.0;
/// Cells across the extent of all eyes seen so far, for lights of a direction.
const DIRECTION_CELLS: f32 = 64.0;
/// Cells across the same extent, for sky directions and for positions on emitting surfaces.
const AREA_CELLS: f32 = 8.0;
/// Questions looked up together before their misses are traced together. Small enough that a batch learns from itself.
const CHUNK: usize = 64;

/// Remembers the last blocker of each light and range of lines, and tests it first. Answers equal [`Exact`](crate::Exact)'s.
#[derive(Debug)]
pub struct Occluder {
    slots: usize,
    footprint: Footprint,
}

impl Occluder {
    /// A strategy whose workers remember `slots` blockers each (rounded up to a power of two, at least 1).
    ///
    /// More remember longer; fewer stay in a nearer processor cache. Default: 4096 (64 to 96 KiB a worker).
    pub fn with_slots(slots: usize) -> Self {
        Self {
            slots: slots.clamp(1, 1 << 24).next_power_of_two(),
            footprint: Footprint::default(),
        }
    }
}

impl Default for Occluder {
    fn default() -> Self {
        Self::with_slots(4096)
    }
}

/// Memory, scratch space and counters of one worker of [`Occluder`].
#[derive(Debug)]
pub struct OccluderWorker<B> {
    slots: Vec<Slot<B>>,
    eyes: Extent,
    rays: Vec<Ray>,
    missed: Vec<Missed>,
    blockers: Vec<Option<B>>,
    stats: VisibilityStats,
    _held: Held,
}

#[derive(Clone, Copy, Debug)]
struct Slot<B> {
    tag: u32,
    blocker: Option<B>,
}

/// A question that memory did not answer: its place in the chunk and its bin.
#[derive(Clone, Copy, Debug)]
struct Missed {
    query: usize,
    bin: u64,
}

impl<B: Copy> OccluderWorker<B> {
    fn recall(&self, bin: u64) -> Option<B> {
        let slot = &self.slots[bin as usize & (self.slots.len() - 1)];
        slot.blocker.filter(|_| slot.tag == (bin >> 32) as u32)
    }

    fn remember(&mut self, bin: u64, blocker: Option<B>) {
        let mask = self.slots.len() - 1;
        let slot = &mut self.slots[bin as usize & mask];
        let tag = (bin >> 32) as u32;
        // A free ray clears its own bin, but not the bin of others that shares the slot.
        if blocker.is_some() || slot.tag == tag {
            *slot = Slot { tag, blocker };
        }
    }
}

impl<T: Tracer> Visibility<T> for Occluder {
    type Worker = OccluderWorker<T::Blocker>;

    fn name(&self) -> &'static str {
        "occluder"
    }

    fn class(&self) -> Class {
        Class::Exact
    }

    fn worker(&self) -> Self::Worker {
        let empty = Slot {
            tag: 0,
            blocker: None,
        };
        OccluderWorker {
            slots: vec![empty; self.slots],
            eyes: Extent::default(),
            rays: Vec::with_capacity(CHUNK),
            missed: Vec::with_capacity(CHUNK),
            blockers: Vec::with_capacity(CHUNK),
            stats: VisibilityStats::default(),
            _held: self
                .footprint
                .hold(self.slots * size_of::<Slot<T::Blocker>>()),
        }
    }

    fn answer(
        &self,
        tracer: &T,
        worker: &mut Self::Worker,
        queries: &[Query],
        answers: &mut [f32],
    ) {
        assert_eq!(queries.len(), answers.len());
        for (queries, answers) in queries.chunks(CHUNK).zip(answers.chunks_mut(CHUNK)) {
            worker.rays.clear();
            worker.missed.clear();
            for (i, query) in queries.iter().enumerate() {
                let bin = bin(query, &mut worker.eyes);
                if worker
                    .recall(bin)
                    .is_some_and(|b| tracer.blocks(b, &query.ray))
                {
                    answers[i] = 0.0;
                } else {
                    worker.rays.push(query.ray);
                    worker.missed.push(Missed { query: i, bin });
                }
            }
            worker.blockers.clear();
            worker.blockers.resize(worker.rays.len(), None);
            tracer.blocker_batch(&worker.rays, &mut worker.blockers);
            for i in 0..worker.missed.len() {
                let (missed, blocker) = (worker.missed[i], worker.blockers[i]);
                answers[missed.query] = if blocker.is_some() { 0.0 } else { 1.0 };
                worker.remember(missed.bin, blocker);
            }
            worker.stats.queries += queries.len() as u64;
            worker.stats.traced += worker.missed.len() as u64;
            worker.stats.answered += (queries.len() - worker.missed.len()) as u64;
        }
    }

    fn stats(&self, worker: &Self::Worker) -> VisibilityStats {
        worker.stats.clone()
    }

    fn bytes(&self) -> u64 {
        self.footprint.peak()
    }
}

/// The largest side of the box around all eyes seen, as a power of two: the unit of position cells. It grows a few times
/// at the start of a job and then stands still.
#[derive(Clone, Copy, Debug)]
struct Extent {
    min: Vec3,
    max: Vec3,
    side: f32,
}

impl Default for Extent {
    fn default() -> Self {
        Self {
            min: Vec3::INFINITY,
            max: Vec3::NEG_INFINITY,
            side: 1.0,
        }
    }
}

impl Extent {
    fn include(&mut self, eye: Vec3) {
        let (min, max) = (self.min.min(eye), self.max.max(eye));
        if min != self.min || max != self.max {
            (self.min, self.max) = (min, max);
            let side = (max - min).max_element();
            if side.is_normal() {
                // Rounded down to a power of two: the box may creep without moving every cell.
                self.side = f32::from_bits(side.to_bits() & 0x7f80_0000);
            }
        }
    }
}

/// The bin that a question falls into: 32 bits of slot and 32 bits of tag.
fn bin(query: &Query, eyes: &mut Extent) -> u64 {
    let eye = query.eye.position;
    eyes.include(eye);
    match query.light {
        LightEnd::Point(light) => square(hash3(1, light), octahedral(eye - light) * POINT_BINS),
        LightEnd::Direction(direction) => across(
            hash3(2, direction),
            direction,
            eye,
            eyes.side / DIRECTION_CELLS,
        ),
        LightEnd::Surface(light) => {
            let patch = (light.position * (AREA_CELLS / eyes.side)).floor();
            square(
                hash3(3, patch),
                octahedral(eye - light.position) * SURFACE_BINS,
            )
        }
        LightEnd::SolidAngle { direction, .. } => {
            let place = (octahedral(direction) * SKY_BINS).floor();
            let centre = octahedral_inverse((place + 0.5) / SKY_BINS);
            across(square(4, place), centre, eye, eyes.side / AREA_CELLS)
        }
    }
}

/// Adds the cell of `eye` in the plane across `direction`.
fn across(hash: u64, direction: Vec3, eye: Vec3, side: f32) -> u64 {
    let (a, b) = direction.any_orthonormal_pair();
    square(hash, Vec2::new(eye.dot(a), eye.dot(b)) / side)
}

/// Adds the cell of a point in the plane.
fn square(hash: u64, point: Vec2) -> u64 {
    mix(mix(hash, cell(point.x)), cell(point.y))
}

/// Direction (of any length) to the unit square: the octahedral map of Cigolle et al. 2014, "A survey of efficient
/// representations for independent unit vectors", section 3.
fn octahedral(d: Vec3) -> Vec2 {
    let p = d.truncate() / (d.x.abs() + d.y.abs() + d.z.abs());
    let p = if d.z < 0.0 { fold(p) } else { p };
    p * 0.5 + 0.5
}

/// The unit vector at a place of the unit square.
fn octahedral_inverse(square: Vec2) -> Vec3 {
    let p = square * 2.0 - 1.0;
    let z = 1.0 - p.x.abs() - p.y.abs();
    let p = if z < 0.0 { fold(p) } else { p };
    p.extend(z).normalize()
}

/// Mirrors the lower half of the octahedron about the diagonals.
fn fold(p: Vec2) -> Vec2 {
    Vec2::new(
        (1.0 - p.y.abs()).copysign(p.x),
        (1.0 - p.x.abs()).copysign(p.y),
    )
}

/// The bits of the cell that a coordinate lies in. Saturates, and NaN is a cell like any other.
fn cell(x: f32) -> u64 {
    x.floor() as i64 as u64
}

fn hash3(kind: u64, v: Vec3) -> u64 {
    let xy = u64::from(v.x.to_bits()) | u64::from(v.y.to_bits()) << 32;
    mix(mix(kind, xy), u64::from(v.z.to_bits()))
}

/// Mixes one more word into a hash: a multiplication folded onto itself, so that every bit reaches every other.
fn mix(hash: u64, word: u64) -> u64 {
    let product =
        u128::from(hash ^ 0x9e37_79b9_7f4a_7c15) * u128::from(word ^ 0xd6e8_feb8_6659_fd93);
    product as u64 ^ (product >> 64) as u64
}
