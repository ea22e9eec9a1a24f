//! Exact visibility: every question is a ray.

use crate::{
    BLOCK, Class, EyeSample, ManyLights, Query, Ray, SharedLight, Tracer, Visibility,
    VisibilityStats,
};

/// Traces every query. The baseline that every other strategy is measured against.
#[derive(Clone, Copy, Debug, Default)]
pub struct Exact;

/// Scratch space and counters of one worker of [`Exact`].
#[derive(Debug, Default)]
pub struct ExactWorker {
    rays: Vec<Ray>,
    occluded: Vec<bool>,
    askers: Vec<u32>,
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

    /// Traces light by light: the rays of neighbouring eyes towards one light are the most coherent ones.
    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut ExactWorker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        let mut wanted = vec![0u16; eyes.len()];
        let mut visible = vec![0u16; eyes.len()];
        for (block, lights) in lights.chunks(BLOCK).enumerate() {
            wanted.fill(0);
            asker.wanted(block, &mut wanted);
            visible.fill(0);
            for (l, light) in lights.iter().enumerate() {
                worker.rays.clear();
                worker.askers.clear();
                for (e, eye) in eyes.iter().enumerate() {
                    if wanted[e] >> l & 1 != 0 {
                        worker.askers.push(e as u32);
                        worker.rays.push(light.ray_from(eye.origin));
                    }
                }
                worker.occluded.clear();
                worker.occluded.resize(worker.rays.len(), false);
                tracer.occluded_batch(&worker.rays, &mut worker.occluded);
                for (&e, &occluded) in worker.askers.iter().zip(&worker.occluded) {
                    visible[e as usize] |= u16::from(!occluded) << l;
                }
                worker.stats.queries += worker.rays.len() as u64;
                worker.stats.traced += worker.rays.len() as u64;
            }
            asker.take(block, &visible, &[]);
        }
    }

    fn stats(&self, worker: &ExactWorker) -> VisibilityStats {
        worker.stats.clone()
    }
}
