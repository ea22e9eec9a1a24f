//! Baking: the light that falls on every surface of a scene, stored in textures.
//!
//! * [`atlas`] gives every triangle a place of its own on a page of texels;
//! * [`texel`] says which part of which surfaces a texel is;
//! * [`gather`] finds the light at points by path tracing;
//! * [`bundle`] gathers light along many directions, for all texels at once, into [`sums`].

pub mod atlas;
pub mod bundle;
pub mod gather;
pub mod sums;
pub mod texel;
