//! Visibility records: a bounded number of distance maps, which move to where visibility changes and where they are asked.
//!
//! Ulbrich, Novák, Rehfeld, Dachsbacher 2013, "Progressive Visibility Caching for Fast Indirect Illumination". A record stands on a
//! surface and knows how far it is to what it sees, texel by texel of a paraboloid map (`paraboloid`, `map`). It answers for its
//! neighbourhood: *segments* ("do these two points see each other?", for virtual lights: `many`) and *rays* ("what does this
//! point see along that direction?", for paths: `rays`). Records near a place are found by Eq. 2 (`neighbours`, `cells`).
//!
//! Records start along camera paths and are refined step by step (`cache`, `refine`): the least important gives way to a new one near the
//! most important, where importance weighs how little a record agrees with its neighbours against how often it is used (Eq. 1).
//! The text of section 3.2 says of alpha the wrong way round what its formula says: here, as in the formula, 0 is correlation alone.
//!
//! Beyond the paper, records may stand on the virtual lights themselves ([`Placement::Lights`]): with no more lights than records that answers best,
//! and the cache is what a map a light would be.
//!
//! Invariants: never more records than [`RecordSettings::capacity`], hence never more bytes; records change between passes only; uses are
//! counted in whole numbers: so what is answered does not depend on threads.
//!
//! The wrong tool for direct light of small lamps (a shadow's edge is as coarse as a texel), for foliage seen close by, and where an
//! error must have a bound.

mod cache;
mod cells;
mod correlation;
mod kernel;
mod many;
mod map;
mod neighbours;
mod paraboloid;
mod ranking;
mod rays;
mod refine;
mod settings;
mod state;
mod views;

pub use cache::{Cache, PathSite, RecordsReport, Scout, WHOLE_USE};
pub use map::{DistanceTracer, Seen, Site};
pub use ranking::Nearby;
pub use rays::{Aim, CachedSurface, RayAnswer, RecordsReader, SegmentAim, SegmentEnd};
pub use refine::StepTimes;
pub use settings::{
    Falloff, Lookup, Placement, RecordGuarantee, RecordSettings, RecordsError, Select,
};
pub use state::StateError;
pub use views::RecordView;

use crate::two_part::Ball;
use crate::{
    Class, Exact, ExactWorker, EyeSample, LightEnd, ManyLights, Query, SharedLight, Visibility,
    VisibilityStats,
};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// The strategy for many virtual lights: records near a light answer for it; everything else is traced.
///
/// See the [module's description](self). Questions about points, directions, skies and single samples of lamps go to rays: they are direct
/// light, where an error shows most.
#[derive(Debug)]
pub struct Records {
    cache: RwLock<Cache>,
}

/// Places along camera paths, and the lights that will be asked about: beyond the paper, whose records find their way to the lights by
/// refinement alone. Lights that lie far from all camera paths would have no record near them.
struct WithLights<'s> {
    scout: &'s mut dyn Scout,
    lights: &'s [PathSite],
}

impl Scout for WithLights<'_> {
    fn draw(&mut self, count: usize, sites: &mut Vec<PathSite>) {
        self.scout.draw(count, sites);
    }

    fn asked(&mut self, sites: &mut Vec<PathSite>) {
        sites.extend(self.lights);
    }
}

/// Memory, scratch space and counters of one worker of [`Records`].
#[derive(Debug, Default)]
pub struct RecordsWorker {
    exact: ExactWorker,
    scratch: many::Scratch,
    stats: VisibilityStats,
}

impl Records {
    /// A cache without records yet: [`Visibility::prepare`] places them.
    pub fn new(settings: RecordSettings) -> Result<Self, RecordsError> {
        Cache::new(settings).map(|cache| Self {
            cache: RwLock::new(cache),
        })
    }

    /// The cache, to look at.
    pub fn cache(&self) -> RwLockReadGuard<'_, Cache> {
        self.cache.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// The cache, to change: between passes only.
    pub fn cache_mut(&self) -> RwLockWriteGuard<'_, Cache> {
        self.cache.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: DistanceTracer> Visibility<T> for Records {
    type Worker = RecordsWorker;

    fn name(&self) -> &'static str {
        "records"
    }

    fn class(&self) -> Class {
        match self.cache().settings().guarantee {
            RecordGuarantee::Biased => Class::Biased,
            RecordGuarantee::Unbiased => Class::Unbiased,
        }
    }

    fn worker(&self) -> RecordsWorker {
        RecordsWorker::default()
    }

    fn answer(
        &self,
        tracer: &T,
        worker: &mut RecordsWorker,
        queries: &[Query],
        answers: &mut [f32],
    ) {
        Exact.answer(tracer, &mut worker.exact, queries, answers);
    }

    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut RecordsWorker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        let on_surface = |light: &SharedLight| matches!(light.end, LightEnd::Surface(_));
        let cache = self.cache();
        if cache.is_empty() || eyes.is_empty() || !lights.iter().all(on_surface) {
            return Exact.answer_many(tracer, &mut worker.exact, eyes, lights, asker);
        }
        let RecordsWorker { scratch, stats, .. } = worker;
        many::answer(&cache, tracer, scratch, stats, eyes, lights, asker);
    }

    fn prepare(&self, tracer: &T, lights: &[SharedLight], scout: &mut dyn Scout) {
        let mut cache = self.cache_mut();
        let lights = PathSite::on_lights(lights);
        let fit = lights.len() <= cache.settings().capacity as usize;
        if cache.settings().placement == Placement::Lights && fit {
            cache.take_restored();
            return cache.stand_on(tracer, &lights);
        }
        if cache.take_restored() {
            return;
        }
        cache.leave_lights();
        let steps = if cache.is_empty() {
            let lights = &lights;
            cache.place_initial(tracer, &mut WithLights { scout, lights });
            cache.settings().steps
        } else {
            cache.settings().steps_per_picture
        };
        cache.refine_before(tracer, steps, &mut |sites| sites.extend(&lights));
    }

    fn moved(&self, tracer: &T, before: &[Ball], now: &[Ball]) {
        self.cache_mut().moved(tracer, before, now);
    }

    fn pass_done(&self, tracer: &T) {
        self.cache_mut().pass_done(tracer);
    }

    fn stats(&self, worker: &RecordsWorker) -> VisibilityStats {
        let mut stats = worker.stats.clone();
        stats.add(&Visibility::<T>::stats(&Exact, &worker.exact));
        stats.answered = stats.queries.saturating_sub(stats.traced);
        stats
    }

    fn bytes(&self) -> u64 {
        let RecordsReport { peak_bytes, .. } = self.cache().report();
        peak_bytes
    }

    fn records(&self) -> Option<&Records> {
        Some(self)
    }
}

#[cfg(test)]
mod tests;
