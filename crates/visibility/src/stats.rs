//! Counters, kept where the events happen.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// What a visibility strategy did. Ray reduction is `queries / traced`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibilityStats {
    /// Questions asked.
    pub queries: u64,
    /// Questions answered without tracing a full ray.
    pub answered: u64,
    /// Rays traced for the rest, refinement and duplicate misses included.
    pub traced: u64,
    /// Questions refined, by level.
    pub refined: Vec<u64>,
    /// Rays that filled records.
    pub fill: u64,
    /// Answers that gave way to others in a lossy table.
    pub overwritten: u64,
    /// Questions that records left to rays, by reason.
    pub unanswered: Unanswered,
}

/// Why records leave a question to a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// No record stands near and looks to the same side.
    NoRecord,
    /// What is asked about lies below the horizon of the records that stand near.
    BelowHorizon,
    /// They look there, but what they see cannot be kept or does not fit.
    Unknown,
    /// What is asked about is so near that they see something else than the place does.
    TooNear,
}

/// Questions that records left to rays, by [`Reason`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unanswered {
    /// [`Reason::NoRecord`].
    pub no_record: u64,
    /// [`Reason::BelowHorizon`].
    pub below_horizon: u64,
    /// [`Reason::Unknown`].
    pub unknown: u64,
    /// [`Reason::TooNear`].
    pub too_near: u64,
}

impl Unanswered {
    /// Counts a question.
    pub fn count(&mut self, reason: Reason) {
        *match reason {
            Reason::NoRecord => &mut self.no_record,
            Reason::BelowHorizon => &mut self.below_horizon,
            Reason::Unknown => &mut self.unknown,
            Reason::TooNear => &mut self.too_near,
        } += 1;
    }

    /// Adds the counters of another worker.
    pub fn add(&mut self, other: &Self) {
        self.no_record += other.no_record;
        self.below_horizon += other.below_horizon;
        self.unknown += other.unknown;
        self.too_near += other.too_near;
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        self.no_record + self.below_horizon + self.unknown + self.too_near
    }
}

impl VisibilityStats {
    /// Adds the counters of another worker.
    pub fn add(&mut self, other: &Self) {
        self.queries += other.queries;
        self.answered += other.answered;
        self.traced += other.traced;
        self.fill += other.fill;
        self.overwritten += other.overwritten;
        self.unanswered.add(&other.unanswered);
        if self.refined.len() < other.refined.len() {
            self.refined.resize(other.refined.len(), 0);
        }
        for (sum, n) in self.refined.iter_mut().zip(&other.refined) {
            *sum += n;
        }
    }
}

/// Bytes that the workers of one strategy hold together, now and at most.
#[derive(Clone, Debug, Default)]
pub(crate) struct Footprint(Arc<[AtomicU64; 2]>);

/// A worker's share of a [`Footprint`]; gives it back when dropped.
#[derive(Debug)]
pub(crate) struct Held {
    footprint: Footprint,
    bytes: u64,
}

impl Footprint {
    pub(crate) fn hold(&self, bytes: usize) -> Held {
        let bytes = bytes as u64;
        let [now, peak] = &*self.0;
        peak.fetch_max(now.fetch_add(bytes, Relaxed) + bytes, Relaxed);
        Held {
            footprint: self.clone(),
            bytes,
        }
    }

    pub(crate) fn peak(&self) -> u64 {
        self.0[1].load(Relaxed)
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.footprint.0[0].fetch_sub(self.bytes, Relaxed);
    }
}
