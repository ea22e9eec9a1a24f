//! Visibility questions and the strategies that answer them.

use crate::{Ray, Tracer, VisibilityStats};
use glam::Vec3;

/// The eye end of a question: a surface point that wants to know who sees it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Endpoint {
    /// World-space position.
    pub position: Vec3,
    /// Area density of the sampling that put the point there, in samples per square unit (0: not known).
    pub density: f32,
    /// Unit geometric normal, on the side that the connection leaves.
    pub normal: Vec3,
    /// Padding, zero.
    pub reserved: u32,
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
        /// Density of the sampling, per steradian.
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
    /// The ray that answers the question exactly: already moved off the surfaces at either end.
    pub ray: Ray,
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

    /// Answers a batch: `answers[i]` estimates the visibility of `queries[i]`, 1 is visible, 0 is blocked.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn answer(&self, tracer: &T, worker: &mut Self::Worker, queries: &[Query], answers: &mut [f32]);

    /// The counters of a worker.
    fn stats(&self, worker: &Self::Worker) -> VisibilityStats;

    /// Bytes that the strategy holds now, all workers together.
    fn bytes(&self) -> u64 {
        0
    }
}
