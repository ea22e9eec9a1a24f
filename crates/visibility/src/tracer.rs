//! The exact side: rays, hits and the one trait that an embedder implements.

use glam::Vec3;

/// A ray segment: the points `origin + t * direction` with `t_min < t < t_max`.
///
/// The direction need not be of unit length: for a segment between two points it is their difference and
/// `t_max` is 1. Lengths are in the units of the scene.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Ray {
    /// Start of the ray, world space.
    pub origin: Vec3,
    /// Hits at or before this parameter are ignored. At least 0.
    pub t_min: f32,
    /// Direction, world space, of any non-zero length.
    pub direction: Vec3,
    /// Hits at or beyond this parameter are ignored. May be infinite.
    pub t_max: f32,
}

impl Ray {
    /// A ray from `origin` along `direction` without an end.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self {
            origin,
            t_min: 0.0,
            direction,
            t_max: f32::INFINITY,
        }
    }

    /// The open segment between two points; `t` runs from 0 at `from` to 1 at `to`.
    pub fn between(from: Vec3, to: Vec3) -> Self {
        Self {
            origin: from,
            t_min: 0.0,
            direction: to - from,
            t_max: 1.0,
        }
    }

    /// The point at parameter `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// Where a ray met a triangle.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter of the hit.
    pub t: f32,
    /// Barycentric weight of the triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of the triangle's third vertex.
    pub v: f32,
    /// Index of the instance that was hit, as the tracer numbers them.
    pub instance: u32,
    /// Index of the triangle inside that instance's mesh.
    pub primitive: u32,
}

/// Whoever can answer visibility exactly: by tracing rays.
///
/// An answer must be a pure function of the ray: asked twice, a tracer says the same (surfaces that let light pass with
/// some probability decide by a hash of the ray, not by a running random number). All methods must agree on every ray,
/// single or in a batch. Closures `Fn(&Ray) -> bool` that return whether something blocks the ray are tracers too.
pub trait Tracer: Sync {
    /// Names one blocker, so that a memory of blockers can ask about it again. Use `()` if there is nothing to name.
    type Blocker: Copy + Send + Sync + PartialEq + std::fmt::Debug;

    /// Does anything block the ray? Returns some blocker (any one), or `None` if the ray is free.
    fn blocker(&self, ray: &Ray) -> Option<Self::Blocker>;

    /// Does this one blocker block the ray? `false` is always a legal answer (it only costs a full ray).
    ///
    /// `true` promises that [`Tracer::blocker`] finds something too: use the very same intersection test, and make the
    /// traversal conservative (no box may cull a triangle that the test would hit).
    fn blocks(&self, blocker: Self::Blocker, ray: &Ray) -> bool {
        let _ = (blocker, ray);
        false
    }

    /// Does anything block the ray?
    fn occluded(&self, ray: &Ray) -> bool {
        self.blocker(ray).is_some()
    }

    /// Finds a blocker for each of many rays; `blockers[i]` belongs to `rays[i]`. Implementations may exploit coherence of
    /// neighbours.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn blocker_batch(&self, rays: &[Ray], blockers: &mut [Option<Self::Blocker>]) {
        assert_eq!(rays.len(), blockers.len());
        for (ray, answer) in rays.iter().zip(blockers) {
            *answer = self.blocker(ray);
        }
    }

    /// Answers many rays; `occluded[i]` belongs to `rays[i]`. Implementations may exploit coherence of neighbours.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        assert_eq!(rays.len(), occluded.len());
        for (ray, answer) in rays.iter().zip(occluded) {
            *answer = self.occluded(ray);
        }
    }
}

impl<F: Fn(&Ray) -> bool + Sync> Tracer for F {
    type Blocker = ();

    fn blocker(&self, ray: &Ray) -> Option<()> {
        self(ray).then_some(())
    }
}

/// Moves a surface point off its surface, so that a ray from there does not meet the surface itself again.
///
/// `normal` is the unit geometric normal of the side that the ray leaves on; `extent` is the largest absolute coordinate
/// that took part in computing `position` (of the triangle's vertices, say). The distance is relative to it: rounding of
/// a point with coordinates up to `extent` moves it by a few times `extent * 2^-24`. There is no absolute epsilon, so the
/// same scene at another scale gives the same picture.
pub fn offset_along_normal(position: Vec3, normal: Vec3, extent: f32) -> Vec3 {
    const ROUNDINGS: f32 = 64.0 / (1 << 24) as f32;
    position + normal * (extent * ROUNDINGS)
}
