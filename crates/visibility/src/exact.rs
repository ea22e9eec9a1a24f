//! Exact visibility: every question is a ray.

use crate::{Class, Query, Ray, Tracer, Visibility, VisibilityStats};

/// Traces every query. The baseline that every other strategy is measured against.
#[derive(Clone, Copy, Debug, Default)]
pub struct Exact;

/// Scratch space and counters of one worker of [`Exact`].
#[derive(Debug, Default)]
pub struct ExactWorker {
    rays: Vec<Ray>,
    occluded: Vec<bool>,
    stats: VisibilityStats,
}

impl<T: Tracer> Visibility<T> for Exact {
    type Worker = ExactWorker;

    fn name(&self) -> &'static str {
        "exact"
    }

    fn class(&self) -> Class {
        Class::Exact
    }

    fn worker(&self) -> ExactWorker {
        ExactWorker::default()
    }

    fn answer(&self, tracer: &T, worker: &mut ExactWorker, queries: &[Query], answers: &mut [f32]) {
        assert_eq!(queries.len(), answers.len());
        worker.rays.clear();
        worker.rays.extend(queries.iter().map(|q| q.ray));
        worker.occluded.clear();
        worker.occluded.resize(queries.len(), false);
        tracer.occluded_batch(&worker.rays, &mut worker.occluded);
        for (answer, &occluded) in answers.iter_mut().zip(&worker.occluded) {
            *answer = if occluded { 0.0 } else { 1.0 };
        }
        worker.stats.queries += queries.len() as u64;
        worker.stats.traced += queries.len() as u64;
    }

    fn stats(&self, worker: &ExactWorker) -> VisibilityStats {
        worker.stats.clone()
    }
}
