//! Walking the trees with one ray.
//!
//! [`walk`] is written once over what a processor offers ([`Isa`]): the test of eight boxes and the test of four triangles.
//! Each processor's module compiles it under its own features behind the functions of [`Isa`] that take a [`Query`], so that
//! the choice costs one predictable branch a ray or a batch.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod portable;

use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Block, Child, FILTERED, LANES, NO_TRIANGLE, Node, STACK, Tree, WIDTH};
use occlude_visibility::{Hit, Ray};
use std::mem::MaybeUninit;

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;
pub(crate) use portable::Portable;

/// The instructions that rays are traced with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Simd {
    /// No instructions beyond the target's baseline.
    Portable,
    /// AVX2 and FMA of x86-64.
    Avx2,
    /// NEON of aarch64.
    Neon,
}

impl Simd {
    /// The best that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("fma")
            && std::arch::is_x86_feature_detected!("bmi1")
            && std::arch::is_x86_feature_detected!("bmi2")
        {
            return Self::Avx2;
        }
        Self::Portable
    }

    /// Its name, as in statistics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Neon => "neon",
        }
    }
}

/// The instance of hits in the world-space tree, where the id alone tells the instance.
pub(crate) const BY_ID: u32 = u32::MAX;

/// The best hit so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    /// Where to stop: the ray's end, then the nearest hit.
    pub t: f32,
    pub u: f32,
    pub v: f32,
    /// As in the block.
    pub id: u32,
    /// Number of the placed instance, or [`BY_ID`].
    pub placed: u32,
    pub block: u32,
}

impl Found {
    pub fn nothing(ray: &Ray) -> Self {
        Self {
            t: ray.t_max,
            u: 0.0,
            v: 0.0,
            id: NO_TRIANGLE,
            placed: BY_ID,
            block: 0,
        }
    }
}

/// What does not change during one traversal.
pub(crate) struct Query<'a, F> {
    pub accel: &'a Accel,
    /// In world space.
    pub ray: &'a Ray,
    pub filter: &'a F,
}

/// One of the trees, and the ray in its space.
pub(crate) struct Scope<'a> {
    pub tree: &'a Tree,
    pub ray: &'a Ray,
    /// Number of the placed instance that the tree belongs to, or [`BY_ID`].
    pub placed: u32,
}

/// Lanes of a block that the ray hits between its ends, and where.
#[derive(Clone, Copy)]
pub(crate) struct Lanes {
    pub mask: u32,
    pub t: [f32; LANES],
    pub u: [f32; LANES],
    pub v: [f32; LANES],
}

/// A ray prepared for testing eight boxes at a time.
pub(crate) trait Slabs: Sized {
    /// `None` if this kind of test cannot take the ray.
    ///
    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn new(ray: &Ray) -> Option<Self>;

    /// Which children the ray meets before `t_max`, and where it enters each.
    ///
    /// Conservative: no box is missed through rounding.
    ///
    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn test(&self, node: &Node, t_max: f32, near: &mut [f32; WIDTH]) -> u32;
}

/// A ray prepared for testing four triangles at a time.
pub(crate) trait Edges<const WATERTIGHT: bool>: Sized {
    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn new(ray: &Ray) -> Self;

    /// Which triangles the ray hits with `t_min < t < t_max`.
    ///
    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes;
}

/// What traversal needs from a processor.
///
/// # Safety
/// Every function asks that the processor has the features of the implementor, and that the trees of the query are valid.
pub(crate) trait Isa {
    /// For rays whose reciprocal direction is harmless: nearly all.
    type Fast: Slabs;
    /// For any valid ray.
    type Careful: Slabs;
    type Thin: Edges<false>;
    type Tight: Edges<true>;

    /// Asks the memory for a child that waits.
    unsafe fn prefetch(tree: &Tree, child: Child);

    /// Traces through the top tree and what it holds.
    unsafe fn trace<F: HitFilter, const ANY: bool>(query: &Query<F>, found: &mut Found) -> bool;
    /// Traces through a placed instance.
    unsafe fn enter<F: HitFilter, const ANY: bool>(
        query: &Query<F>,
        placed: u32,
        found: &mut Found,
    ) -> bool;
    /// Traces a ray that [`Isa::Fast`] does not take.
    unsafe fn careful<F: HitFilter, const ANY: bool>(
        query: &Query<F>,
        scope: &Scope,
        found: &mut Found,
    ) -> bool;
    /// Tests one block.
    unsafe fn block<F: HitFilter>(query: &Query<F>, scope: &Scope, block: u32) -> bool;
    /// Any-hit for many rays.
    unsafe fn occluded_batch<F: HitFilter>(
        accel: &Accel,
        rays: &[Ray],
        filter: &F,
        occluded: &mut [bool],
    );
    /// Closest-hit for many rays.
    unsafe fn closest_batch<F: HitFilter>(
        accel: &Accel,
        rays: &[Ray],
        filter: &F,
        hits: &mut [Option<Hit>],
    );
}

/// Can the ray hit anything at all? False for rays with NaN, without a direction, or with an infinite origin.
fn is_valid(ray: &Ray) -> bool {
    ray.origin.is_finite()
        && ray.direction.is_finite()
        && ray.direction != glam::Vec3::ZERO
        && ray.t_min < ray.t_max
}

/// [`Isa::trace`], to be compiled under the features of `I`.
#[inline(always)]
unsafe fn trace<I: Isa, F: HitFilter, const ANY: bool>(
    query: &Query<F>,
    found: &mut Found,
) -> bool {
    let scope = Scope {
        tree: query.accel.top(),
        ray: query.ray,
        placed: BY_ID,
    };
    // SAFETY: as promised by the caller.
    unsafe {
        if query.accel.has_placed() {
            start::<I, F, ANY, true>(query, &scope, found)
        } else {
            start::<I, F, ANY, false>(query, &scope, found)
        }
    }
}

/// [`Isa::enter`], to be compiled under the features of `I`.
#[inline(always)]
unsafe fn enter<I: Isa, F: HitFilter, const ANY: bool>(
    query: &Query<F>,
    placed: u32,
    found: &mut Found,
) -> bool {
    let (tree, ray) = query.accel.placed_ray(placed, query.ray);
    let scope = Scope {
        tree,
        ray: &ray,
        placed,
    };
    // SAFETY: as promised by the caller.
    unsafe { start::<I, F, ANY, false>(query, &scope, found) }
}

#[inline(always)]
unsafe fn start<I: Isa, F: HitFilter, const ANY: bool, const TOP: bool>(
    query: &Query<F>,
    scope: &Scope,
    found: &mut Found,
) -> bool {
    if scope.tree.nodes.is_empty() {
        return false;
    }
    // SAFETY: as promised by the caller.
    unsafe {
        match I::Fast::new(scope.ray) {
            Some(slabs) if query.accel.is_watertight() => {
                let edges = I::Tight::new(scope.ray);
                walk::<I, _, _, F, ANY, TOP, true>(query, scope, &slabs, &edges, found)
            }
            Some(slabs) => {
                let edges = I::Thin::new(scope.ray);
                walk::<I, _, _, F, ANY, TOP, false>(query, scope, &slabs, &edges, found)
            }
            None => I::careful::<F, ANY>(query, scope, found),
        }
    }
}

/// [`Isa::careful`], to be compiled under the features of `I`.
#[inline(always)]
unsafe fn careful<I: Isa, F: HitFilter, const ANY: bool>(
    query: &Query<F>,
    scope: &Scope,
    found: &mut Found,
) -> bool {
    if !is_valid(scope.ray) {
        return false;
    }
    // SAFETY: as promised by the caller.
    unsafe {
        let Some(slabs) = I::Careful::new(scope.ray) else {
            return false;
        };
        if query.accel.is_watertight() {
            let edges = I::Tight::new(scope.ray);
            walk::<I, _, _, F, ANY, true, true>(query, scope, &slabs, &edges, found)
        } else {
            let edges = I::Thin::new(scope.ray);
            walk::<I, _, _, F, ANY, true, false>(query, scope, &slabs, &edges, found)
        }
    }
}

/// A child that waits, and where the ray enters its box. Ordered by the entry, which is never negative.
#[inline(always)]
fn entry(near: f32, child: Child) -> u64 {
    u64::from(near.to_bits()) << 32 | u64::from(child.0)
}

/// Nearest child first, with the others on a stack. Returns whether something was hit; with `ANY` at the first such.
#[inline(always)]
unsafe fn walk<
    I: Isa,
    S: Slabs,
    E: Edges<WATERTIGHT>,
    F: HitFilter,
    const ANY: bool,
    const TOP: bool,
    const WATERTIGHT: bool,
>(
    query: &Query<F>,
    scope: &Scope,
    slabs: &S,
    edges: &E,
    found: &mut Found,
) -> bool {
    let tree = scope.tree;
    let (nodes, blocks) = (tree.nodes.as_ptr(), tree.blocks.as_ptr());
    let mut stack = MaybeUninit::<[u64; STACK]>::uninit();
    let stack = stack.as_mut_ptr().cast::<u64>();
    let mut waiting = 0;
    let mut current = Child::node(0);
    let mut any = false;
    // SAFETY: the tree is valid: a child that is met names a node, blocks or an instance that exist, and no way down is
    // longer than MAX_DEPTH, so that at most STACK children wait. An unused child is never met: its box is empty.
    unsafe {
        loop {
            while !current.is_leaf() {
                let node = &*nodes.add(current.0 as usize);
                let mut near = [0.0; WIDTH];
                let mut met = slabs.test(node, found.t, &mut near);
                if met == 0 {
                    match pop(stack, &mut waiting, found.t) {
                        Some(next) => current = next,
                        None => return any,
                    }
                    continue;
                }
                let take = |met: &mut u32| {
                    let lane = met.trailing_zeros() as usize;
                    *met &= *met - 1;
                    entry(
                        *near.get_unchecked(lane),
                        *node.children.get_unchecked(lane),
                    )
                };
                let a = take(&mut met);
                if met == 0 {
                    current = Child(a as u32);
                    continue;
                }
                let b = take(&mut met);
                let (close, far) = if a < b { (a, b) } else { (b, a) };
                if met == 0 {
                    *stack.add(waiting) = far;
                    waiting += 1;
                    I::prefetch(tree, Child(far as u32));
                    current = Child(close as u32);
                    continue;
                }
                // Three or more: insertion sort on the stack, the nearest on top.
                let base = waiting;
                *stack.add(waiting) = far;
                *stack.add(waiting + 1) = close;
                waiting += 2;
                while met != 0 {
                    let next = take(&mut met);
                    let mut at = waiting;
                    while at > base && *stack.add(at - 1) < next {
                        *stack.add(at) = *stack.add(at - 1);
                        at -= 1;
                    }
                    *stack.add(at) = next;
                    waiting += 1;
                }
                waiting -= 1;
                current = Child(*stack.add(waiting) as u32);
                I::prefetch(tree, Child(*stack.add(waiting - 1) as u32));
            }
            if TOP && current.is_instance() {
                if I::enter::<F, ANY>(query, current.index() as u32, found) {
                    any = true;
                    if ANY {
                        return true;
                    }
                }
            } else {
                let first = current.index();
                for index in first..first + current.block_count() {
                    let block = &*blocks.add(index);
                    let lanes = edges.test(block, found.t);
                    if lanes.mask != 0
                        && keep::<F, ANY>(query, scope, block, index as u32, &lanes, found)
                    {
                        any = true;
                        if ANY {
                            return true;
                        }
                    }
                }
            }
            match pop(stack, &mut waiting, found.t) {
                Some(next) => current = next,
                None => return any,
            }
        }
    }
}

/// The nearest waiting child that begins before `t_max`.
#[inline(always)]
unsafe fn pop(stack: *mut u64, waiting: &mut usize, t_max: f32) -> Option<Child> {
    loop {
        if *waiting == 0 {
            return None;
        }
        *waiting -= 1;
        // SAFETY: entries below `waiting` were written.
        let entry = unsafe { *stack.add(*waiting) };
        if f32::from_bits((entry >> 32) as u32) <= t_max {
            return Some(Child(entry as u32));
        }
    }
}

/// Takes over the nearest hit of a block that counts.
#[inline(always)]
fn keep<F: HitFilter, const ANY: bool>(
    query: &Query<F>,
    scope: &Scope,
    block: &Block,
    index: u32,
    lanes: &Lanes,
    found: &mut Found,
) -> bool {
    let mut any = false;
    let mut mask = lanes.mask;
    while mask != 0 {
        let lane = mask.trailing_zeros() as usize & (LANES - 1);
        mask &= mask - 1;
        // Against another lane that was kept; all are before the end of the ray.
        if any && lanes.t[lane] >= found.t {
            continue;
        }
        let id = block.ids[lane];
        if !F::ACCEPTS_ALL && id & FILTERED != 0 {
            let (instance, primitive) = query.accel.name(scope.placed, id);
            let hit = Hit {
                t: lanes.t[lane],
                u: lanes.u[lane],
                v: lanes.v[lane],
                instance,
                primitive,
            };
            if !query.filter.accept(query.ray, &hit) {
                continue;
            }
        }
        any = true;
        found.placed = scope.placed;
        found.block = index;
        if ANY {
            return true;
        }
        found.t = lanes.t[lane];
        found.u = lanes.u[lane];
        found.v = lanes.v[lane];
        found.id = id;
    }
    any
}

/// [`Isa::block`], to be compiled under the features of `I`.
#[inline(always)]
unsafe fn block<I: Isa, F: HitFilter>(query: &Query<F>, scope: &Scope, index: u32) -> bool {
    let Some(block) = scope.tree.blocks.get(index as usize) else {
        return false;
    };
    if !is_valid(scope.ray) {
        return false;
    }
    let mut found = Found::nothing(scope.ray);
    // SAFETY: as promised by the caller.
    let lanes = unsafe {
        if query.accel.is_watertight() {
            I::Tight::new(scope.ray).test(block, found.t)
        } else {
            I::Thin::new(scope.ray).test(block, found.t)
        }
    };
    keep::<F, true>(query, scope, block, index, &lanes, &mut found)
}

/// [`Isa::occluded_batch`], to be compiled under the features of `I`.
#[inline(always)]
unsafe fn occluded_batch<I: Isa, F: HitFilter>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    occluded: &mut [bool],
) {
    for (ray, answer) in rays.iter().zip(occluded) {
        let query = Query { accel, ray, filter };
        // SAFETY: as promised by the caller.
        *answer = unsafe { trace::<I, F, true>(&query, &mut Found::nothing(ray)) };
    }
}

/// [`Isa::closest_batch`], to be compiled under the features of `I`.
#[inline(always)]
unsafe fn closest_batch<I: Isa, F: HitFilter>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    hits: &mut [Option<Hit>],
) {
    for (ray, answer) in rays.iter().zip(hits) {
        let query = Query { accel, ray, filter };
        let mut found = Found::nothing(ray);
        // SAFETY: as promised by the caller.
        *answer = unsafe { trace::<I, F, false>(&query, &mut found) }.then(|| accel.hit(&found));
    }
}

/// Implements the functions of [`Isa`] that take queries: the generic ones above, compiled under given features.
macro_rules! entry_points {
    ($($feature:literal)?) => {
        $(#[target_feature(enable = $feature)])?
        unsafe fn trace<F: HitFilter, const ANY: bool>(query: &Query<F>, found: &mut Found) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::trace::<Self, F, ANY>(query, found) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn enter<F: HitFilter, const ANY: bool>(query: &Query<F>, placed: u32, found: &mut Found) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::enter::<Self, F, ANY>(query, placed, found) }
        }
        #[cold]
        $(#[target_feature(enable = $feature)])?
        unsafe fn careful<F: HitFilter, const ANY: bool>(query: &Query<F>, scope: &Scope, found: &mut Found) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::careful::<Self, F, ANY>(query, scope, found) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn block<F: HitFilter>(query: &Query<F>, scope: &Scope, block: u32) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::block::<Self, F>(query, scope, block) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn occluded_batch<F: HitFilter>(accel: &Accel, rays: &[Ray], filter: &F, occluded: &mut [bool]) {
            // SAFETY: as promised by the caller.
            unsafe { super::occluded_batch::<Self, F>(accel, rays, filter, occluded) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn closest_batch<F: HitFilter>(accel: &Accel, rays: &[Ray], filter: &F, hits: &mut [Option<Hit>]) {
            // SAFETY: as promised by the caller.
            unsafe { super::closest_batch::<Self, F>(accel, rays, filter, hits) }
        }
    };
}
pub(crate) use entry_points;

/// Relative bound on the rounding errors of a slab distance, with room to spare: eight units in the last place.
const SLACK: f32 = 4.0 / (1 << 23) as f32;
/// Reciprocal directions between its reciprocal and this are harmless.
const HARMLESS: f32 = 1.0e30;

/// Can [`Isa::Fast`] take this ray? `inverse` is its reciprocal direction.
#[inline(always)]
fn is_harmless(ray: &Ray, inverse: [f32; 3]) -> bool {
    let harmless = |x: f32| x.abs() <= HARMLESS;
    let in_range = |x: f32| harmless(x) && x.abs() >= 1.0 / HARMLESS;
    in_range(inverse[0])
        && in_range(inverse[1])
        && in_range(inverse[2])
        && harmless(ray.origin.x * inverse[0])
        && harmless(ray.origin.y * inverse[1])
        && harmless(ray.origin.z * inverse[2])
        && ray.t_min >= 0.0
        && ray.t_min < ray.t_max
}
