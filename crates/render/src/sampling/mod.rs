//! Random numbers and the warps that turn them into directions and points.
//!
//! [`Sampler`] hands out the numbers of one path, four at a time; [`warp`] bends them into shapes.

mod sampler;
pub mod warp;

pub use sampler::{Sampler, SamplerKind};
