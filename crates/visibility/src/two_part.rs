//! Memory in a world of which a part moves.
//!
//! Who sees whom past what stands still does not change from picture to picture; so that is what is remembered, and what moves
//! is traced: `visibility = remembered(still) and traced(moving)`. A moving object leaves no shadow behind, since no
//! memory ever held it, and its own surface may ask like any other: the answer is about two places and what stands between them.
//!
//! Most connections pass nowhere near what moves. Balls around the moving objects tell: first against all connections of a batch of
//! eyes with one light together, then one by one.
//!
//! The paper leaves moving geometry out (Popov 2013 clears its table); this is ours. The wrong tool where most of the world moves, or where
//! moving things are long and thin: their balls meet most connections, and each of those is traced.

use crate::many::bits;
use crate::quantized::{Quantized, QuantizedWorker};
use crate::{
    BLOCK, Class, Correction, Epoch, EyeSample, ManyLights, Query, Ray, SharedLight, Tracer,
    Visibility, VisibilityStats,
};
use glam::Vec3;

/// A tracer that knows which part of the world stands still. [`Tracer`]'s own methods are about both parts together.
pub trait TwoPartTracer: Tracer {
    /// As [`Tracer::occluded_batch`], by what stands still.
    fn occluded_by_still(&self, rays: &[Ray], occluded: &mut [bool]);

    /// Does anything that moves block the ray?
    fn occluded_by_moving(&self, ray: &Ray) -> bool;

    /// Balls that hold all that moves; best a few. None: nothing moves.
    fn moving(&self) -> &[Ball];
}

/// A ball that holds a moving object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Centre, world space.
    pub centre: Vec3,
    /// Radius, in units of the scene.
    pub radius: f32,
}

impl Ball {
    /// A ball around points, not the smallest; `None` around none.
    pub fn around(points: impl Iterator<Item = Vec3> + Clone) -> Option<Self> {
        let first = points.clone().next()?;
        let (low, high) = points.clone().fold((first, first), |(low, high), point| {
            (low.min(point), high.max(point))
        });
        let centre = 0.5 * low + 0.5 * high;
        let squared = points.fold(0.0, |most: f32, point| {
            most.max(point.distance_squared(centre))
        });
        Some(Self {
            centre,
            radius: squared.sqrt(),
        })
    }

    /// Whether a segment comes within `reach` of the ball, rounded towards yes.
    fn meets(&self, ray: &Ray, reach: f32) -> bool {
        let way = self.centre - ray.origin;
        let length2 = ray.direction.length_squared();
        let nearest = (way.dot(ray.direction) / length2).clamp(ray.t_min, ray.t_max);
        let distance2 = (ray.direction * nearest - way).length_squared();
        // Rounding is relative to the coordinates, which `way` and the radius are no larger than.
        let reach =
            (self.radius + reach) * 1.001 + 1e-5 * (ray.origin.abs().max_element() + way.length());
        // A segment of no length, say: better one ray too many than a shadow lost.
        distance2 <= reach * reach || distance2.is_nan()
    }
}

/// [`Quantized`] visibility where a part of the world moves. See the [module's description](self).
#[derive(Debug)]
pub struct TwoPart(
    /// What remembers the part that stands still.
    pub Quantized,
);

/// Memory, scratch space and counters of one worker of [`TwoPart`].
#[derive(Debug)]
pub struct TwoPartWorker {
    cached: QuantizedWorker,
    /// Rays against what moves.
    traced: u64,
}

/// The part of a world that stands still.
struct StillOnly<'t, T>(&'t T);

impl<T: TwoPartTracer> Tracer for StillOnly<'_, T> {
    type Blocker = ();

    fn blocker(&self, ray: &Ray) -> Option<()> {
        let mut occluded = [false];
        self.0.occluded_by_still(&[*ray], &mut occluded);
        occluded[0].then_some(())
    }

    fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.0.occluded_by_still(rays, occluded);
    }
}

/// Does what moves block the ray? Counts the rays that it takes to know.
fn is_met<T: TwoPartTracer>(tracer: &T, ray: &Ray, traced: &mut u64) -> bool {
    if !tracer.moving().iter().any(|ball| ball.meets(ray, 0.0)) {
        return false;
    }
    *traced += 1;
    tracer.occluded_by_moving(ray)
}

impl<T: TwoPartTracer> Visibility<T> for TwoPart {
    type Worker = TwoPartWorker;

    fn name(&self) -> &'static str {
        Visibility::<T>::name(&self.0)
    }

    fn class(&self) -> Class {
        Visibility::<T>::class(&self.0)
    }

    fn worker(&self) -> TwoPartWorker {
        TwoPartWorker {
            cached: Visibility::<T>::worker(&self.0),
            traced: 0,
        }
    }

    fn begin(&self, worker: &mut TwoPartWorker, epoch: Epoch) {
        Visibility::<T>::begin(&self.0, &mut worker.cached, epoch);
    }

    fn answer(
        &self,
        tracer: &T,
        worker: &mut TwoPartWorker,
        queries: &[Query],
        answers: &mut [f32],
    ) {
        let still = StillOnly(tracer);
        self.0.answer(&still, &mut worker.cached, queries, answers);
        for (query, answer) in queries.iter().zip(answers) {
            if *answer != 0.0 && is_met(tracer, &query.ray, &mut worker.traced) {
                *answer = 0.0;
            }
        }
    }

    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut TwoPartWorker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        let mut sieve = Sieve {
            tracer,
            eyes,
            around: Ball::around(eyes.iter().map(|eye| eye.origin)),
            lights,
            asker,
            traced: &mut worker.traced,
        };
        let still = StillOnly(tracer);
        (self.0).answer_many(&still, &mut worker.cached, eyes, lights, &mut sieve);
    }

    fn next_picture(&mut self) {
        Visibility::<T>::next_picture(&mut self.0);
    }

    fn forget(&mut self) {
        Visibility::<T>::forget(&mut self.0);
    }

    fn stats(&self, worker: &TwoPartWorker) -> VisibilityStats {
        let mut stats = Visibility::<T>::stats(&self.0, &worker.cached);
        stats.traced += worker.traced;
        stats.answered = stats.answered.saturating_sub(worker.traced);
        stats
    }

    fn bytes(&self) -> u64 {
        Visibility::<T>::bytes(&self.0)
    }
}

/// Stands between memory and asker, and takes out what is hidden by what moves.
struct Sieve<'s, T> {
    tracer: &'s T,
    eyes: &'s [EyeSample],
    /// Holds all eyes.
    around: Option<Ball>,
    lights: &'s [SharedLight],
    asker: &'s mut dyn ManyLights,
    traced: &'s mut u64,
}

impl<T: TwoPartTracer> ManyLights for Sieve<'_, T> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        self.asker.wanted(block, wanted);
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        let lights = self.lights.chunks(BLOCK).nth(block).unwrap_or(&[]);
        let moving = self.tracer.moving();
        // Lights whose connections come near what moves.
        let near = self.around.map_or(0, |around| {
            let near = |light: &SharedLight| {
                let ray = light.ray_from(around.centre);
                moving.iter().any(|ball| ball.meets(&ray, around.radius))
            };
            let lights = lights.iter().enumerate();
            lights.fold(0u16, |mask, (l, light)| mask | u16::from(near(light)) << l)
        });
        if near == 0 {
            return self.asker.take(block, visible, corrections);
        }
        let hidden = |eye: usize, l: usize, traced: &mut u64| {
            is_met(
                self.tracer,
                &lights[l].ray_from(self.eyes[eye].origin),
                traced,
            )
        };
        let mut visible = visible.to_vec();
        for (eye, visible) in visible.iter_mut().enumerate() {
            for l in bits(*visible & near) {
                *visible &= !(u16::from(hidden(eye, l, self.traced)) << l);
            }
        }
        // What is hidden is not seen: nothing to correct, whatever the memory.
        let kept: Vec<Correction> = (corrections.iter().copied())
            .filter(|one| !hidden(one.eye as usize, one.light as usize, self.traced))
            .collect();
        self.asker.take(block, &visible, &kept);
    }
}
