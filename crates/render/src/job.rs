//! Everything that takes long is a job: it shows progress, can be cancelled, and knows its memory limit.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

/// Handle to a long operation, shared between the one who works and the one who watches.
///
/// Clones share their state.
#[derive(Clone, Debug, Default)]
pub struct Job {
    state: Arc<State>,
    /// Bytes that the job may hold; `None` is unlimited.
    pub memory_limit: Option<u64>,
}

#[derive(Debug, Default)]
struct State {
    cancelled: AtomicBool,
    phase: Mutex<&'static str>,
    done: AtomicU64,
    total: AtomicU64,
    rays: AtomicU64,
}

/// What a watcher sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// What is going on, such as `render`.
    pub phase: &'static str,
    /// Units of work done in this phase.
    pub done: u64,
    /// Units of work in this phase; 0 if not known.
    pub total: u64,
    /// Rays traced so far, all phases.
    pub rays: u64,
}

impl Job {
    /// A job without a memory limit.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks the job to stop soon, keeping what it has. May be called from a signal-handling thread.
    pub fn cancel(&self) {
        self.state.cancelled.store(true, Relaxed);
    }

    /// Whether somebody asked the job to stop.
    pub fn is_cancelled(&self) -> bool {
        self.state.cancelled.load(Relaxed)
    }

    /// Starts a phase of `total` units (0: not known).
    pub fn start_phase(&self, phase: &'static str, total: u64) {
        *self
            .state
            .phase
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = phase;
        self.state.done.store(0, Relaxed);
        self.state.total.store(total, Relaxed);
    }

    /// Counts `units` of work and the rays that they took.
    pub fn advance(&self, units: u64, rays: u64) {
        self.state.done.fetch_add(units, Relaxed);
        self.state.rays.fetch_add(rays, Relaxed);
    }

    /// What is going on now.
    pub fn progress(&self) -> Progress {
        Progress {
            phase: *self
                .state
                .phase
                .lock()
                .unwrap_or_else(PoisonError::into_inner),
            done: self.state.done.load(Relaxed),
            total: self.state.total.load(Relaxed),
            rays: self.state.rays.load(Relaxed),
        }
    }
}
