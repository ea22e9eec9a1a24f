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
}

impl VisibilityStats {
    /// Adds the counters of another worker.
    pub fn add(&mut self, other: &Self) {
        self.queries += other.queries;
        self.answered += other.answered;
        self.traced += other.traced;
        self.fill += other.fill;
        self.overwritten += other.overwritten;
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
