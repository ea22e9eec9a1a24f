//! A clock around a strategy: what goes into rays, into shading, and into the memory itself.
//!
//! [`Measured`] stands between the integrator and any strategy. It times each call, the tracer's batches inside it, and the
//! integrator's own part of many-light questions (which is the shading); what is left is the strategy's own cost. Times are
//! those of one thread each and add up over threads.

use occlude_visibility::{
    Class, Correction, Epoch, EyeSample, ManyLights, Query, Ray, SharedLight, Tracer, Visibility,
    VisibilityStats,
};
use std::cell::Cell;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

thread_local! {
    /// Seconds that this thread has spent in the tracer.
    static TRACING: Cell<f64> = const { Cell::new(0.0) };
}

/// A tracer whose time is taken.
#[repr(transparent)]
pub struct Clocked<T>(T);

impl<T> Clocked<T> {
    /// The same tracer, timed.
    pub fn of(tracer: &T) -> &Self {
        // SAFETY: `Clocked<T>` is a transparent wrapper of `T`: same layout, same lifetime.
        unsafe { &*std::ptr::from_ref(tracer).cast::<Self>() }
    }
}

fn clocked<R>(work: impl FnOnce() -> R) -> R {
    let start = Instant::now();
    let result = work();
    TRACING.set(TRACING.get() + start.elapsed().as_secs_f64());
    result
}

impl<T: Tracer> Tracer for Clocked<T> {
    type Blocker = T::Blocker;

    fn blocker(&self, ray: &Ray) -> Option<T::Blocker> {
        clocked(|| self.0.blocker(ray))
    }

    fn blocks(&self, blocker: T::Blocker, ray: &Ray) -> bool {
        clocked(|| self.0.blocks(blocker, ray))
    }

    fn occluded(&self, ray: &Ray) -> bool {
        clocked(|| self.0.occluded(ray))
    }

    fn blocker_batch(&self, rays: &[Ray], blockers: &mut [Option<T::Blocker>]) {
        clocked(|| self.0.blocker_batch(rays, blockers));
    }

    fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        clocked(|| self.0.occluded_batch(rays, occluded));
    }
}

/// Questions of one form, and the thread seconds that they took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Part {
    pub queries: u64,
    pub traced: u64,
    /// Everything inside the call.
    pub total: f64,
    /// Of that, in the tracer.
    pub rays: f64,
    /// Of that, in the integrator: shading.
    pub shading: f64,
}

impl Part {
    pub fn add(&mut self, other: &Self) {
        self.queries += other.queries;
        self.traced += other.traced;
        self.total += other.total;
        self.rays += other.rays;
        self.shading += other.shading;
    }

    /// The same with all times multiplied: by the share of the clock that the processor was really at work, where other
    /// programs took the rest.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            total: self.total * factor,
            rays: self.rays * factor,
            shading: self.shading * factor,
            ..self
        }
    }

    /// Nanoseconds of the strategy itself, a question.
    pub fn query_ns(&self) -> f64 {
        1e9 * (self.total - self.rays - self.shading) / self.queries as f64
    }

    /// Nanoseconds a traced ray.
    pub fn ray_ns(&self) -> f64 {
        1e9 * self.rays / self.traced as f64
    }

    /// Nanoseconds of shading, a question.
    pub fn shading_ns(&self) -> f64 {
        1e9 * self.shading / self.queries as f64
    }
}

/// What was measured so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ledger {
    /// Through [`Visibility::answer_many`].
    pub many: Part,
    /// Through [`Visibility::answer`].
    pub single: Part,
}

impl Ledger {
    /// Both forms together.
    pub fn all(&self) -> Part {
        let mut all = self.many;
        all.add(&self.single);
        all
    }
}

/// One call of [`Visibility::answer_many`], to be repeated.
pub struct ManyCall {
    pub epoch: Epoch,
    pub eyes: Vec<EyeSample>,
    pub lights: Vec<SharedLight>,
    /// Block by block, eye by eye.
    pub wanted: Vec<Vec<u16>>,
}

impl ManyCall {
    pub fn questions(&self) -> u64 {
        let masks = self.wanted.iter().flatten();
        masks.map(|mask| u64::from(mask.count_ones())).sum()
    }
}

/// What was asked.
#[derive(Default)]
pub struct Recording {
    pub many: Vec<ManyCall>,
    pub single: Vec<(Epoch, Vec<Query>)>,
    many_questions: u64,
    single_questions: u64,
}

/// A strategy whose parts are timed.
pub struct Measured<'v, V> {
    inner: &'v V,
    ledger: Mutex<Ledger>,
    recording: Option<(Mutex<Recording>, u64)>,
}

/// A worker of [`Measured`].
pub struct MeasuredWorker<W> {
    inner: W,
    epoch: Epoch,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'v, V> Measured<'v, V> {
    pub fn new(inner: &'v V) -> Self {
        Self {
            inner,
            ledger: Mutex::default(),
            recording: None,
        }
    }

    /// Keeps what is asked too, until about `most` questions of either form are there.
    pub fn recording(inner: &'v V, most: u64) -> Self {
        Self {
            recording: Some((Mutex::default(), most)),
            ..Self::new(inner)
        }
    }

    pub fn ledger(&self) -> Ledger {
        *lock(&self.ledger)
    }

    /// What was asked.
    pub fn into_recording(self) -> Recording {
        self.recording.map_or_else(Recording::default, |(r, _)| {
            r.into_inner().unwrap_or_else(PoisonError::into_inner)
        })
    }
}

/// Takes the time of whoever asks, and notes which answers were wanted.
struct ClockedAsker<'a> {
    inner: &'a mut dyn ManyLights,
    seconds: f64,
    wanted: Option<Vec<Vec<u16>>>,
}

impl ManyLights for ClockedAsker<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        let start = Instant::now();
        self.inner.wanted(block, wanted);
        self.seconds += start.elapsed().as_secs_f64();
        if let Some(masks) = &mut self.wanted {
            masks.push(wanted.to_vec());
        }
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        let start = Instant::now();
        self.inner.take(block, visible, corrections);
        self.seconds += start.elapsed().as_secs_f64();
    }
}

impl<T: Tracer, V: Visibility<Clocked<T>>> Visibility<T> for Measured<'_, V> {
    type Worker = MeasuredWorker<V::Worker>;

    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn class(&self) -> Class {
        self.inner.class()
    }

    fn worker(&self) -> Self::Worker {
        MeasuredWorker {
            inner: self.inner.worker(),
            epoch: Epoch::default(),
        }
    }

    fn begin(&self, worker: &mut Self::Worker, epoch: Epoch) {
        worker.epoch = epoch;
        self.inner.begin(&mut worker.inner, epoch);
    }

    fn answer(
        &self,
        tracer: &T,
        worker: &mut Self::Worker,
        queries: &[Query],
        answers: &mut [f32],
    ) {
        if let Some((recording, most)) = &self.recording {
            let mut recording = lock(recording);
            if recording.single_questions < *most && !queries.is_empty() {
                recording.single_questions += queries.len() as u64;
                recording.single.push((worker.epoch, queries.to_vec()));
            }
        }
        let before = self.inner.stats(&worker.inner);
        let (start, traced) = (Instant::now(), TRACING.get());
        self.inner
            .answer(Clocked::of(tracer), &mut worker.inner, queries, answers);
        let part = Part {
            total: start.elapsed().as_secs_f64(),
            rays: TRACING.get() - traced,
            ..counted(&before, &self.inner.stats(&worker.inner))
        };
        lock(&self.ledger).single.add(&part);
    }

    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut Self::Worker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        let wants_more =
            |(recording, most): &(Mutex<Recording>, u64)| lock(recording).many_questions < *most;
        let mut asker = ClockedAsker {
            inner: asker,
            seconds: 0.0,
            wanted: self
                .recording
                .as_ref()
                .is_some_and(wants_more)
                .then(Vec::new),
        };
        let before = self.inner.stats(&worker.inner);
        let (start, traced) = (Instant::now(), TRACING.get());
        self.inner.answer_many(
            Clocked::of(tracer),
            &mut worker.inner,
            eyes,
            lights,
            &mut asker,
        );
        let part = Part {
            total: start.elapsed().as_secs_f64(),
            rays: TRACING.get() - traced,
            shading: asker.seconds,
            ..counted(&before, &self.inner.stats(&worker.inner))
        };
        lock(&self.ledger).many.add(&part);
        if let (Some((recording, _)), Some(wanted)) = (&self.recording, asker.wanted) {
            let call = ManyCall {
                epoch: worker.epoch,
                eyes: eyes.to_vec(),
                lights: lights.to_vec(),
                wanted,
            };
            let mut recording = lock(recording);
            recording.many_questions += call.questions();
            recording.many.push(call);
        }
    }

    fn stats(&self, worker: &Self::Worker) -> VisibilityStats {
        self.inner.stats(&worker.inner)
    }

    fn bytes(&self) -> u64 {
        self.inner.bytes()
    }
}

fn counted(before: &VisibilityStats, after: &VisibilityStats) -> Part {
    Part {
        queries: after.queries - before.queries,
        traced: after.traced - before.traced,
        ..Part::default()
    }
}

/// Asks a recorded call again; answers go nowhere.
pub struct Replay<'a>(pub &'a ManyCall);

impl ManyLights for Replay<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        wanted.copy_from_slice(&self.0.wanted[block]);
    }

    fn take(&mut self, _: usize, visible: &[u16], _: &[Correction]) {
        std::hint::black_box(visible);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use occlude_visibility::{BLOCK, Endpoint, Exact, LightEnd};

    struct Sum(u32);

    impl ManyLights for Sum {
        fn wanted(&mut self, _: usize, wanted: &mut [u16]) {
            wanted.fill(0b11);
        }

        fn take(&mut self, _: usize, visible: &[u16], _: &[Correction]) {
            self.0 += visible.iter().map(|v| v.count_ones()).sum::<u32>();
        }
    }

    /// The clock changes no answer, counts what was asked, and what it records is what was asked.
    #[test]
    fn measuring_changes_nothing() {
        let tracer = |ray: &Ray| {
            std::thread::sleep(std::time::Duration::from_micros(200));
            ray.at(0.5).x > 0.0
        };
        let eyes: Vec<EyeSample> = [-1.0, 1.0, -2.0]
            .map(|x| EyeSample {
                end: Endpoint::new(Vec3::new(x, 0.0, 0.0), Vec3::Y, 1.0),
                origin: Vec3::new(x, 0.0, 0.0),
            })
            .to_vec();
        let light = |x: f32| SharedLight {
            end: LightEnd::Point(Vec3::new(x, 1.0, 0.0)),
            target: None,
            connections: 1.0,
        };
        let lights = [light(0.0), light(0.1)];
        assert!(lights.len() <= BLOCK);
        let measured = Measured::recording(&Exact, 100);
        let mut worker = MeasuredWorker {
            inner: Default::default(),
            epoch: Epoch::default(),
        };
        let mut sum = Sum(0);
        measured.answer_many(&tracer, &mut worker, &eyes, &lights, &mut sum);
        assert_eq!(sum.0, 4);
        let part = measured.ledger().many;
        assert_eq!((part.queries, part.traced), (6, 6));
        assert!(part.rays >= 1.2e-3 && part.rays <= part.total);
        let recording = measured.into_recording();
        assert_eq!(recording.many[0].questions(), 6);
        assert_eq!(recording.many[0].eyes, eyes);
    }
}
