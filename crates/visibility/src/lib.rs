//! Who sees whom: answers to visibility questions, asked once and remembered.
//!
//! Three nouns carry the crate:
//!
//! * a [`Query`] asks whether an eye [`Endpoint`] and a [`LightEnd`] see each other;
//! * a [`Tracer`] is whoever can answer exactly, by rays. It is the one trait that an embedder implements;
//! * a [`Visibility`] is a strategy that answers batches of queries: [`Exact`] traces every one.
//!
//! Answers are `f32` estimates, not booleans: weighted averages lie in `[0, 1]`, unbiased estimators may leave it.

mod exact;
mod query;
mod stats;
mod tracer;

pub use exact::Exact;
pub use query::{Class, Endpoint, LightEnd, Query, Visibility};
pub use stats::VisibilityStats;
pub use tracer::{Hit, Ray, Tracer, offset_along_normal};
