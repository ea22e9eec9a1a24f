//! One thread's conversation with a strategy, for embedders.

use crate::{
    Epoch, EyeSample, ManyLights, Query, SharedLight, Tracer, Visibility, VisibilityStats,
};

/// A tracer, a strategy and the state of one worker, held together: the short way in for embedders.
///
/// Make one for each thread and keep it as long as the scene stands still. Integrators that manage workers themselves use
/// [`Visibility`] directly; both ways give the same answers.
pub struct Session<'a, T: Tracer, V: Visibility<T>> {
    tracer: &'a T,
    strategy: &'a V,
    worker: V::Worker,
}

impl<'a, T: Tracer, V: Visibility<T>> Session<'a, T, V> {
    /// A conversation with `strategy` about the world of `tracer`.
    pub fn new(tracer: &'a T, strategy: &'a V) -> Self {
        let worker = strategy.worker();
        Self {
            tracer,
            strategy,
            worker,
        }
    }

    /// Says which tile of which pass the next questions come from; see [`Visibility::begin`].
    pub fn begin(&mut self, epoch: Epoch) {
        self.strategy.begin(&mut self.worker, epoch);
    }

    /// Answers a batch; see [`Visibility::answer`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn answer(&mut self, queries: &[Query], answers: &mut [f32]) {
        self.strategy
            .answer(self.tracer, &mut self.worker, queries, answers);
    }

    /// Answers what many eyes ask about the same lights; see [`Visibility::answer_many`].
    pub fn answer_many(
        &mut self,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        self.strategy
            .answer_many(self.tracer, &mut self.worker, eyes, lights, asker);
    }

    /// Answers one question. Batches are faster.
    pub fn visibility(&mut self, query: &Query) -> f32 {
        let mut answer = [0.0];
        self.answer(std::slice::from_ref(query), &mut answer);
        answer[0]
    }

    /// What has been asked and traced so far.
    pub fn stats(&self) -> VisibilityStats {
        self.strategy.stats(&self.worker)
    }
}
