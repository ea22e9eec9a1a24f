//! Deciding whether a hit counts.

use occlude_visibility::{Hit, Ray};

/// Decides whether a hit on a triangle of a mesh marked [`filtered`](crate::MeshInput::filtered) counts: the alpha test.
///
/// The decision must be a pure function of the ray and the hit: a traversal may ask in any order, more than once, or not
/// at all.
pub trait HitFilter {
    /// True if every hit counts, so that asking can be compiled away.
    const ACCEPTS_ALL: bool = false;

    /// Does this hit count? `ray` is the ray in world space.
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool;
}

/// Every hit counts; costs nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFilter;

impl HitFilter for NoFilter {
    const ACCEPTS_ALL: bool = true;

    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}

impl<F: Fn(&Ray, &Hit) -> bool> HitFilter for F {
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool {
        self(ray, hit)
    }
}
