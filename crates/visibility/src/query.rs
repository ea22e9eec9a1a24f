//! Visibility questions and the strategies that answer them.

use crate::many::bits;
use crate::records::{Records, Scout};
use crate::two_part::Ball;
use crate::{BLOCK, Correction, EyeSample, ManyLights, Ray, SharedLight, Tracer, VisibilityStats};
use glam::Vec3;

/// The eye end of a question: a surface point that wants to know who sees it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Endpoint {
    /// World-space position.
    pub position: Vec3,
    /// Density of the sampling that put the point there, in samples per square unit (0: not known). At an eye end all eye
    /// paths of the picture count, taken once a pixel (`N_S P_e` in Popov 2013 for one sample a pixel); at a light end it is
    /// the probability density of one sample (`P_l`), the probability of having picked this light included. Infinite: no
    /// other question is like this one, and only a ray of its own answers it.
    pub density: f32,
    /// Unit geometric normal, on the side that the connection leaves.
    pub normal: Vec3,
    /// Padding, zero.
    pub reserved: u32,
}

impl Endpoint {
    /// An endpoint on a surface; see the fields.
    pub fn new(position: Vec3, normal: Vec3, density: f32) -> Self {
        Self {
            position,
            density,
            normal,
            reserved: 0,
        }
    }
}

/// The light end of a question: one of the four kinds of Popov 2013, section 4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightEnd {
    /// A point light (a spot too): the exact position is part of its identity.
    Point(Vec3),
    /// A light infinitely far away in one exact direction (unit vector towards the light).
    Direction(Vec3),
    /// A sample on a surface: an area light or a virtual light.
    Surface(Endpoint),
    /// A sampled direction of an environment: unit vector towards it, and its density per steradian.
    SolidAngle {
        /// Unit vector towards the light.
        direction: Vec3,
        /// Probability density of the sampling per steradian, the probability of having picked this light included.
        density: f32,
    },
}

/// One visibility question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Who asks.
    pub eye: Endpoint,
    /// Who is asked for.
    pub light: LightEnd,
    /// How many questions of this technique one eye sample asks on average (`N_P / N_S`). For a point or a direction, which
    /// have no density: times the probability of picking this light. Caches size their clusters by it; exact strategies
    /// ignore it.
    pub connections: f32,
    /// What an open view would bring, at least 0, in any unit that the questions of a batch share. Strategies that estimate
    /// ([`Class::Unbiased`]) spend their rays where it is large; others ignore it.
    pub importance: f32,
    /// The ray that answers the question exactly: already moved off the surfaces at either end.
    pub ray: Ray,
}

impl Query {
    /// A question that every eye sample asks once about this light ([`Query::connections`] is 1), as important as others.
    pub fn new(eye: Endpoint, light: LightEnd, ray: Ray) -> Self {
        Self {
            eye,
            light,
            connections: 1.0,
            importance: 1.0,
            ray,
        }
    }
}

/// The part of a job that questions belong to: one tile of one pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Epoch {
    /// Number of the pass's first sample of a pixel, from 0.
    pub pass: u32,
    /// Samples of a pixel that the pass takes, at least 1.
    pub samples: u32,
    /// Index of the tile (or of any other unit that one worker does alone), from 0.
    pub tile: u32,
}

impl Default for Epoch {
    /// The only pass and tile, of one sample a pixel.
    fn default() -> Self {
        Self {
            pass: 0,
            samples: 1,
            tile: 0,
        }
    }
}

/// What an answer may be trusted for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Equal to tracing every ray.
    Exact,
    /// Right on average: the expected answer is the exact one.
    Unbiased,
    /// Wrong by an amount that vanishes as samples are added.
    Consistent,
    /// Wrong by an amount whose extent the user has bounded.
    Bounded,
    /// Wrong by an amount without a stated bound.
    Biased,
}

impl Class {
    /// The name used in statistics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Unbiased => "unbiased",
            Self::Consistent => "consistent",
            Self::Bounded => "bounded",
            Self::Biased => "biased",
        }
    }
}

/// A strategy that answers visibility questions, shared by all workers of a job.
///
/// Integrators are generic over it, so that the choice is made once per job and never per query.
pub trait Visibility<T: Tracer>: Sync {
    /// What one worker keeps for itself while it asks: memory, scratch space, counters.
    type Worker: Send;

    /// The strategy's name in statistics, such as `exact`.
    fn name(&self) -> &'static str;

    /// What its answers may be trusted for.
    fn class(&self) -> Class;

    /// Makes the state of one worker.
    fn worker(&self) -> Self::Worker;

    /// Tells a worker which tile of which pass its next questions come from.
    ///
    /// Integrators call it before the first question of every tile. A strategy whose answers depend on what was asked
    /// before forgets here what another worker might not know, so that a picture does not depend on the number of threads;
    /// a strategy that sharpens from pass to pass reads the pass. Does nothing by default.
    fn begin(&self, worker: &mut Self::Worker, epoch: Epoch) {
        let _ = (worker, epoch);
    }

    /// Answers a batch: `answers[i]` estimates the visibility of `queries[i]`, 1 is visible, 0 is blocked.
    ///
    /// A batch is answered whole; no question stays pending between calls, so a strategy is free to trace its misses
    /// together, in any order, each only once. Larger batches (hundreds to thousands) trace faster. Ask questions of one
    /// eye end next to each other and neighbouring eye ends soon after: memories live from that.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn answer(&self, tracer: &T, worker: &mut Self::Worker, queries: &[Query], answers: &mut [f32]);

    /// Answers what many eyes ask about the same lights, block by block.
    ///
    /// Give neighbouring eyes soon after each other; lights that stand near each other belong into one block. Strategies
    /// that profit override this; by default every question is written out and goes through [`Visibility::answer`].
    fn answer_many(
        &self,
        tracer: &T,
        worker: &mut Self::Worker,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        asker: &mut dyn ManyLights,
    ) {
        let mut wanted = vec![0u16; eyes.len()];
        let mut visible = vec![0u16; eyes.len()];
        let mut corrections = Vec::new();
        let (mut queries, mut flat) = (Vec::new(), Vec::new());
        for (block, lights) in lights.chunks(BLOCK).enumerate() {
            wanted.fill(0);
            asker.wanted(block, &mut wanted);
            queries.clear();
            for (eye, &mask) in eyes.iter().zip(&wanted) {
                queries.extend(bits(mask).map(|l| lights[l].query(eye)));
            }
            flat.clear();
            flat.resize(queries.len(), 0.0);
            self.answer(tracer, worker, &queries, &mut flat);
            let mut flat = flat.iter();
            corrections.clear();
            for (eye, (visible, &mask)) in visible.iter_mut().zip(&wanted).enumerate() {
                *visible = 0;
                for (light, &answer) in bits(mask).zip(&mut flat) {
                    if answer == 1.0 {
                        *visible |= 1 << light;
                    } else if answer != 0.0 {
                        corrections.push(Correction {
                            eye: eye as u32,
                            light: light as u32,
                            amount: answer,
                        });
                    }
                }
            }
            asker.take(block, &visible, &corrections);
        }
    }

    /// Called before the first question of a picture: `lights` will be asked about by many eyes (perhaps none), and `scout` finds places
    /// along camera paths. Does nothing by default.
    fn prepare(&self, tracer: &T, lights: &[SharedLight], scout: &mut dyn Scout) {
        let _ = (tracer, lights, scout);
    }

    /// Called between passes, while nobody asks: a strategy that learns may change here what it knows. Does nothing by default.
    fn pass_done(&self, tracer: &T) {
        let _ = tracer;
    }

    /// Tells the strategy that something has moved since the last picture: it was in the balls `before`, is now in the balls `now`, and
    /// `tracer` is about the present. For strategies that keep what has not changed. Does nothing by default.
    fn moved(&self, tracer: &T, before: &[Ball], now: &[Ball]) {
        let _ = (tracer, before, now);
    }

    /// Tells the strategy that a picture of a sequence is done, and that the next questions belong to another one. What it
    /// remembers stays valid: the tracer's geometry stands still. Workers of the last picture are done for. Does nothing by default.
    fn next_picture(&mut self) {}

    /// Makes the strategy forget: the tracer's geometry is about to change. Does nothing by default.
    fn forget(&mut self) {}

    /// The counters of a worker.
    fn stats(&self, worker: &Self::Worker) -> VisibilityStats;

    /// The most bytes that the strategy's memory has held at one time, all workers together.
    fn bytes(&self) -> u64 {
        0
    }

    /// The strategy itself, if it is the one that keeps [records](crate::records).
    fn records(&self) -> Option<&Records> {
        None
    }
}
