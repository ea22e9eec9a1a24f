//! Light transport: from a scene and a pose to a picture.

pub mod bsdf;
pub mod geometry;
pub mod light;
pub mod sampling;
