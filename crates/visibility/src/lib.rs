//! Who sees whom: answers to visibility questions, asked once and remembered.
//!
//! Three nouns carry the crate:
//!
//! * a [`Query`] asks whether an eye [`Endpoint`] and a [`LightEnd`] see each other;
//! * a [`Tracer`] is whoever can answer exactly, by rays. It is the one trait that an embedder implements, and a closure
//!   `Fn(&Ray) -> bool` is one already;
//! * a [`Visibility`] is a strategy that answers batches of queries. Strategies are rivals with one interface:
//!
//! | strategy | [`Class`] | idea |
//! |---|---|---|
//! | [`Exact`] | exact | trace every question |
//! | [`Occluder`] | exact | test the last blocker first |
//! | [`Quantized`](quantized::Quantized) | bounded, unbiased or consistent | one ray for each pair of patches |
//! | [`Records`](records::Records) | biased or unbiased | distance maps near the lights answer |
//! | [`TwoPart`](two_part::TwoPart) | as `Quantized` | remembers what stands still, traces what moves |
//!
//! Answers are `f32` estimates, not booleans: weighted averages lie in `[0, 1]`, unbiased estimators may leave it.
//!
//! # Example
//!
//! A ray tracer that knows one sphere, asked for the shadow of a point light:
//!
//! ```
//! use glam::Vec3;
//! use occlude_visibility::{Endpoint, Exact, LightEnd, Query, Ray, Session};
//!
//! // Does the unit sphere at the origin block the segment?
//! let tracer = |ray: &Ray| {
//!     let nearest = (-ray.origin.dot(ray.direction) / ray.direction.length_squared()).clamp(ray.t_min, ray.t_max);
//!     ray.at(nearest).length() < 1.0
//! };
//! let light = Vec3::new(0.0, 5.0, 0.0);
//! let ask = |x: f32| {
//!     let position = Vec3::new(x, -2.0, 0.0);
//!     let eye = Endpoint::new(position, Vec3::Y, 1.0);
//!     Query::new(eye, LightEnd::Point(light), Ray::between(position, light))
//! };
//!
//! let mut session = Session::new(&tracer, &Exact);
//! let mut answers = [0.0; 2];
//! session.answer(&[ask(0.0), ask(3.0)], &mut answers);
//! assert_eq!(answers, [0.0, 1.0]); // in the shadow, and beside it
//! ```
//!
//! `docs/integrating.md` in the repository goes through the steps of an integration.

mod exact;
pub mod field;
mod many;
mod occluder;
pub mod order;
pub mod quantized;
mod query;
pub mod records;
mod session;
mod stats;
mod tracer;
pub mod two_part;
mod wide;

pub use exact::{Exact, ExactWorker};
pub use many::{BLOCK, Correction, EveryLight, EyeSample, ManyLights, SharedLight};
pub use occluder::{Occluder, OccluderWorker};
pub use query::{Class, Endpoint, Epoch, LightEnd, Query, Visibility};
pub use session::Session;
pub use stats::{Reason, Unanswered, VisibilityStats};
pub use tracer::{Hit, Ray, Tracer, offset_along_normal};
