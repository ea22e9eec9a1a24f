//! Baking: the light that falls on every surface of a scene, stored in textures.
//!
//! * [`atlas`] gives every triangle a place of its own on a page of texels;
//! * [`orient`] finds out which side of two-sided surfaces is baked;
//! * [`texel`] says which part of which surfaces a texel is;
//! * [`gather`] finds the light at points by path tracing;
//! * [`bundle`] gathers light along many directions, for all texels at once, into [`sums`];
//! * [`rounds`] bakes: round by round into a [`state`] that can be stopped, written, merged and gone on with;
//! * [`store`] keeps what is larger than memory on disk meanwhile;
//! * [`plan`] says beforehand what that will take;
//! * [`baked`] shows surfaces in the light of their maps;
//! * [`finish`] repairs, smooths and joins what was gathered;
//! * [`export`] writes light maps, the scene with its second UV set, and the manifest.

pub mod atlas;
pub mod baked;
pub mod bundle;
pub mod export;
pub mod finish;
pub mod gather;
pub mod noise;
pub mod orient;
pub mod plan;
pub mod rounds;
pub mod sky;
pub mod state;
pub mod store;
pub mod sums;
pub mod texel;
