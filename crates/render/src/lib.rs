//! Light transport: from a scene and a pose to a picture.

pub mod bsdf;
pub mod camera;
pub mod film;
pub mod geometry;
pub mod integrator;
pub mod job;
pub mod light;
pub mod sampling;
pub mod views;
pub mod work;
