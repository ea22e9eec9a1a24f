//! Walking the trees with one ray.
//!
//! [`walk`] is written once over what a processor offers ([`Isa`]): the test of eight boxes and the test of four triangles.
//! Each processor's module compiles it under its own features behind the functions of [`Isa`] that take a [`Query`], so that
//! the choice costs one predictable branch a ray or a batch.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod neon;
mod packet;
mod portable;

use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Block, Child, FILTERED, LANES, NO_TRIANGLE, Node, STACK, Tree, WIDTH};
use occlude_visibility::{Hit, Ray};
use std::mem::MaybeUninit;

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;
#[cfg(target_arch = "aarch64")]
pub(crate) use neon::Neon;
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
        #[cfg(target_arch = "aarch64")]
        if cfg!(target_endian = "little") && std::arch::is_aarch64_feature_detected!("neon") {
            return Self::Neon;
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
            // An infinite end would meet boxes that a ray along an axis enters at infinity: never.
            t: ray.t_max.min(f32::MAX),
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

impl<'a> Scope<'a> {
    /// The world-space tree.
    #[inline(always)]
    fn top<F>(query: &Query<'a, F>) -> Self {
        Self {
            tree: query.accel.top(),
            ray: query.ray,
            placed: BY_ID,
        }
    }
}

/// Lanes of a block that the ray hits between its ends, and where.
#[derive(Clone, Copy)]
pub(crate) struct Lanes {
    pub mask: u32,
    pub t: [f32; LANES],
    pub u: [f32; LANES],
    pub v: [f32; LANES],
}

/// Children that wait, the next on top.
///
/// An entry is the bits of the distance where the ray enters the box, above the child: entries order as distances do. At the
/// bottom lies [`Child::NONE`] at distance 0: popping it ends the walk.
pub(crate) struct Stack {
    entries: [MaybeUninit<u64>; STACK],
    /// Entries in use above the bottom.
    waiting: usize,
}

/// An entry of a [`Stack`]; the distance is not negative.
#[inline(always)]
fn entry(near: f32, child: Child) -> u64 {
    u64::from(near.to_bits()) << 32 | u64::from(child.0)
}

impl Stack {
    /// Puts the bottom in; in place, since a stack is too large to be moved for every ray.
    #[inline(always)]
    fn start(stack: &mut MaybeUninit<Self>) -> &mut Self {
        let start = stack.as_mut_ptr();
        // SAFETY: `waiting` is all that must be initialised before the stack is borrowed; entries may be uninitialised.
        let stack = unsafe {
            (&raw mut (*start).waiting).write(0);
            &mut *start
        };
        stack.entries[0].write(entry(0.0, Child::NONE));
        stack
    }

    /// The nearest waiting child that begins before `t_max`.
    ///
    /// # Safety
    /// Something waits, or the walk ends with the child that is returned.
    #[inline(always)]
    unsafe fn pop(&mut self, t_max: f32) -> Child {
        loop {
            // SAFETY: entries up to `waiting` were written, and the one at the bottom is never rejected.
            let entry = unsafe { self.entries.get_unchecked(self.waiting).assume_init() };
            self.waiting = self.waiting.wrapping_sub(1);
            if f32::from_bits((entry >> 32) as u32) <= t_max {
                return Child(entry as u32);
            }
        }
    }

    /// The next child, when distances are not kept.
    ///
    /// # Safety
    /// As for [`Self::pop`].
    #[inline(always)]
    unsafe fn pop_any(&mut self) -> Child {
        // SAFETY: entries up to `waiting` were written.
        let entry = unsafe { self.entries.get_unchecked(self.waiting).assume_init() };
        self.waiting = self.waiting.wrapping_sub(1);
        Child(entry as u32)
    }

    /// What waits on top.
    ///
    /// # Safety
    /// The walk has not ended.
    #[inline(always)]
    unsafe fn top(&self) -> Child {
        // SAFETY: entries up to `waiting` were written.
        Child(unsafe { self.entries.get_unchecked(self.waiting).assume_init() } as u32)
    }

    /// # Safety
    /// There is room.
    #[inline(always)]
    unsafe fn push(&mut self, entry: u64) {
        self.waiting += 1;
        // SAFETY: as promised by the caller.
        unsafe { self.entries.get_unchecked_mut(self.waiting).write(entry) };
    }

    /// Adds an entry below those above `base` that are nearer.
    ///
    /// # Safety
    /// There is room; entries above `base` are in order.
    #[inline(always)]
    unsafe fn insert(&mut self, base: usize, entry: u64) {
        self.waiting += 1;
        let mut at = self.waiting;
        // SAFETY: as promised by the caller; entries up to the old top were written.
        unsafe {
            while at > base + 1 {
                let below = self.entries.get_unchecked(at - 1).assume_init();
                if below >= entry {
                    break;
                }
                self.entries.get_unchecked_mut(at).write(below);
                at -= 1;
            }
            self.entries.get_unchecked_mut(at).write(entry);
        }
    }
}

/// A ray prepared for testing eight boxes at a time.
///
/// Subtracts, then multiplies: exact where the ray starts near a plane, whatever the direction; the leaving distances are
/// enlarged by more than the rounding of the rest (Ize 2013, "Robust BVH ray traversal"). So no box is missed.
pub(crate) trait Slabs: Sized {
    /// Where the ray enters each box.
    type Near: Copy;

    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn new(ray: &Ray) -> Self;

    /// Which children the ray meets before `t_max`, as bits, and where it enters them.
    ///
    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn test(&self, node: &Node, t_max: f32) -> (u32, Self::Near);

    /// Distances by child.
    ///
    /// # Safety
    /// The processor has the features of the [`Isa`].
    unsafe fn distances(near: Self::Near) -> [f32; WIDTH];

    /// Lowers `nearest`, by child, to where a ray enters the children in `mask`.
    ///
    /// # Safety
    /// The processor has the features of the [`Isa`].
    #[inline(always)]
    unsafe fn lower(nearest: &mut [f32; WIDTH], near: Self::Near, mask: u32) {
        // SAFETY: as promised by the caller.
        let distances = unsafe { Self::distances(near) };
        for (lane, (nearest, distance)) in nearest.iter_mut().zip(distances).enumerate() {
            if mask >> lane & 1 != 0 {
                *nearest = nearest.min(distance);
            }
        }
    }
}

/// The nearest child that the ray meets before `t_max`, the others go on the stack, the farthest first. If there is
/// none, the next from the stack.
///
/// # Safety
/// The processor has the features of the [`Isa`]; the stack has room for all children.
#[inline(always)]
unsafe fn nearest<I: Isa>(
    slabs: &I::Slabs,
    tree: &Tree,
    node: &Node,
    t_max: f32,
    stack: &mut Stack,
) -> Child {
    // SAFETY: as promised by the caller; lanes are below 8, and entries above `base` are inserted here.
    unsafe {
        let (mut mask, near) = slabs.test(node, t_max);
        if mask == 0 {
            return stack.pop(t_max);
        }
        let first = mask.trailing_zeros() as usize;
        mask &= mask - 1;
        if mask == 0 {
            return *node.children.get_unchecked(first);
        }
        let distances = I::Slabs::distances(near);
        let entry = |lane: usize| {
            entry(
                *distances.get_unchecked(lane),
                *node.children.get_unchecked(lane),
            )
        };
        let a = entry(first);
        let b = entry(mask.trailing_zeros() as usize);
        mask &= mask - 1;
        let (nearest, other) = (a.min(b), a.max(b));
        if mask == 0 {
            stack.push(other);
            I::prefetch(tree, Child(other as u32));
            return Child(nearest as u32);
        }
        let base = stack.waiting;
        stack.push(other);
        stack.push(nearest);
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            stack.insert(base, entry(lane));
        }
        let next = stack.pop_any();
        I::prefetch(tree, stack.top());
        next
    }
}

/// Some child that the ray meets before `t_max`, the others go on the stack. If there is none, the next from the
/// stack. Distances are not kept.
///
/// # Safety
/// The processor has the features of the [`Isa`]; the stack has room for all children.
#[inline(always)]
unsafe fn any<I: Isa>(
    slabs: &I::Slabs,
    tree: &Tree,
    node: &Node,
    t_max: f32,
    stack: &mut Stack,
) -> Child {
    // SAFETY: as promised by the caller; lanes are below 8.
    unsafe {
        let (mut mask, _) = slabs.test(node, t_max);
        if mask == 0 {
            return stack.pop_any();
        }
        let next = *node.children.get_unchecked(mask.trailing_zeros() as usize);
        mask &= mask - 1;
        // From the highest lane down, so that the lowest comes first.
        while mask != 0 {
            let lane = 31 - mask.leading_zeros();
            mask ^= 1 << lane;
            let child = *node.children.get_unchecked(lane as usize);
            stack.push(u64::from(child.0));
            I::prefetch(tree, child);
        }
        next
    }
}

/// What [`Slabs`] need to know of a ray.
struct Reciprocal {
    /// Per axis, to enter by.
    near: [f32; 3],
    /// Per axis, to leave by.
    far: [f32; 3],
    negative: [bool; 3],
    t_min: f32,
}

impl Reciprocal {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        let d = ray.direction;
        // A reciprocal that overflows is too large to enter by; that of zero is right to be infinite.
        let near = |d: f32| {
            if d == 0.0 {
                1.0 / d
            } else {
                (1.0 / d).clamp(f32::MIN, f32::MAX)
            }
        };
        let far = |d: f32| 1.0 / d * (1.0 + SLACK);
        Self {
            near: [near(d.x), near(d.y), near(d.z)],
            far: [far(d.x), far(d.y), far(d.z)],
            negative: [
                d.x.is_sign_negative(),
                d.y.is_sign_negative(),
                d.z.is_sign_negative(),
            ],
            // Never minus zero: bits of distances are compared as integers.
            t_min: ray.t_min.max(0.0) + 0.0,
        }
    }
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
    type Slabs: Slabs;
    type Thin: Edges<false>;
    type Tight: Edges<true>;

    /// Asks the memory for a child that waits.
    unsafe fn prefetch(tree: &Tree, child: Child);

    /// Traces through the top tree and what it holds: with `TOP` placed instances too, with `WATERTIGHT` blocks for the
    /// watertight test.
    unsafe fn trace<F: HitFilter, const ANY: bool, const TOP: bool, const WATERTIGHT: bool>(
        query: &Query<F>,
        found: &mut Found,
    ) -> bool;
    /// Traces through a placed instance.
    unsafe fn enter<F: HitFilter, const ANY: bool>(
        query: &Query<F>,
        placed: u32,
        found: &mut Found,
    ) -> bool;
    /// Tests one block.
    unsafe fn block<F: HitFilter>(query: &Query<F>, scope: &Scope, block: u32) -> bool;
    /// Any-hit for eight rays at most, together; the constants as for [`Self::trace`].
    unsafe fn packet<F: HitFilter, const TOP: bool, const WATERTIGHT: bool>(
        accel: &Accel,
        rays: &[Ray],
        filter: &F,
        occluded: &mut [bool],
    );
    /// Closest-hit for eight rays at most, together.
    unsafe fn nearest_packet<F: HitFilter, const TOP: bool, const WATERTIGHT: bool>(
        accel: &Accel,
        rays: &[Ray],
        filter: &F,
        hits: &mut [Option<Hit>],
    );
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
    /// Closest-hit for many rays, neighbours together.
    unsafe fn closest_coherent<F: HitFilter>(
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
unsafe fn trace<I: Isa, F: HitFilter, const ANY: bool, const TOP: bool, const WATERTIGHT: bool>(
    query: &Query<F>,
    found: &mut Found,
) -> bool {
    // SAFETY: as promised by the caller.
    unsafe { start::<I, F, ANY, TOP, WATERTIGHT>(query, &Scope::top(query), found) }
}

/// [`trace`] with whatever the structure holds.
#[inline(always)]
unsafe fn trace_any_kind<I: Isa, F: HitFilter, const ANY: bool>(
    query: &Query<F>,
    found: &mut Found,
) -> bool {
    // SAFETY: as promised by the caller.
    unsafe {
        match (query.accel.has_placed(), query.accel.is_watertight()) {
            (false, false) => trace::<I, F, ANY, false, false>(query, found),
            (false, true) => trace::<I, F, ANY, false, true>(query, found),
            (true, false) => trace::<I, F, ANY, true, false>(query, found),
            (true, true) => trace::<I, F, ANY, true, true>(query, found),
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
    unsafe {
        if query.accel.is_watertight() {
            start::<I, F, ANY, false, true>(query, &scope, found)
        } else {
            start::<I, F, ANY, false, false>(query, &scope, found)
        }
    }
}

#[inline(always)]
unsafe fn start<I: Isa, F: HitFilter, const ANY: bool, const TOP: bool, const WATERTIGHT: bool>(
    query: &Query<F>,
    scope: &Scope,
    found: &mut Found,
) -> bool {
    if scope.tree.nodes.is_empty() || !is_valid(scope.ray) {
        return false;
    }
    // SAFETY: as promised by the caller.
    unsafe {
        let slabs = I::Slabs::new(scope.ray);
        if WATERTIGHT {
            let edges = I::Tight::new(scope.ray);
            walk::<I, _, F, ANY, TOP, true>(query, scope, &slabs, &edges, Child::node(0), found)
        } else {
            let edges = I::Thin::new(scope.ray);
            walk::<I, _, F, ANY, TOP, false>(query, scope, &slabs, &edges, Child::node(0), found)
        }
    }
}

/// Visits what is below `from` until nothing waits. Returns whether something was hit; with `ANY` at the first such.
#[inline(always)]
unsafe fn walk<
    I: Isa,
    E: Edges<WATERTIGHT>,
    F: HitFilter,
    const ANY: bool,
    const TOP: bool,
    const WATERTIGHT: bool,
>(
    query: &Query<F>,
    scope: &Scope,
    slabs: &I::Slabs,
    edges: &E,
    from: Child,
    found: &mut Found,
) -> bool {
    let tree = scope.tree;
    let (nodes, blocks) = (tree.nodes.as_ptr(), tree.blocks.as_ptr());
    let mut stack = MaybeUninit::uninit();
    let stack = Stack::start(&mut stack);
    let mut current = from;
    let mut any = false;
    // SAFETY: the tree is valid: a child that is met names a node, blocks or an instance that exist, and no way down is
    // longer than MAX_DEPTH, so that STACK suffices. An unused child is never met: its box is empty.
    unsafe {
        loop {
            while !current.is_leaf() {
                let node = &*nodes.add(current.0 as usize);
                current = if ANY {
                    self::any::<I>(slabs, tree, node, found.t, stack)
                } else {
                    nearest::<I>(slabs, tree, node, found.t, stack)
                };
            }
            if current.is_instance() {
                if current == Child::NONE {
                    return any;
                }
                if TOP && I::enter::<F, ANY>(query, current.index() as u32, found) {
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
            current = if ANY {
                stack.pop_any()
            } else {
                stack.pop(found.t)
            };
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
        *answer =
            unsafe { trace_any_kind::<I, F, false>(&query, &mut found) }.then(|| accel.hit(&found));
    }
}

/// Implements the functions of [`Isa`] that take queries: the generic ones above, compiled under given features.
macro_rules! entry_points {
    ($($feature:literal)?) => {
        $(#[target_feature(enable = $feature)])?
        unsafe fn trace<F: HitFilter, const ANY: bool, const TOP: bool, const WATERTIGHT: bool>(
            query: &Query<F>,
            found: &mut Found,
        ) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::trace::<Self, F, ANY, TOP, WATERTIGHT>(query, found) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn enter<F: HitFilter, const ANY: bool>(query: &Query<F>, placed: u32, found: &mut Found) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::enter::<Self, F, ANY>(query, placed, found) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn block<F: HitFilter>(query: &Query<F>, scope: &Scope, block: u32) -> bool {
            // SAFETY: as promised by the caller.
            unsafe { super::block::<Self, F>(query, scope, block) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn packet<F: HitFilter, const TOP: bool, const WATERTIGHT: bool>(
            accel: &Accel,
            rays: &[Ray],
            filter: &F,
            occluded: &mut [bool],
        ) {
            // SAFETY: as promised by the caller.
            unsafe { super::packet::packet::<Self, F, TOP, WATERTIGHT>(accel, rays, filter, occluded) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn occluded_batch<F: HitFilter>(accel: &Accel, rays: &[Ray], filter: &F, occluded: &mut [bool]) {
            // SAFETY: as promised by the caller.
            unsafe { super::packet::occluded_batch::<Self, F>(accel, rays, filter, occluded) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn closest_batch<F: HitFilter>(accel: &Accel, rays: &[Ray], filter: &F, hits: &mut [Option<Hit>]) {
            // SAFETY: as promised by the caller.
            unsafe { super::closest_batch::<Self, F>(accel, rays, filter, hits) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn nearest_packet<F: HitFilter, const TOP: bool, const WATERTIGHT: bool>(
            accel: &Accel,
            rays: &[Ray],
            filter: &F,
            hits: &mut [Option<Hit>],
        ) {
            // SAFETY: as promised by the caller.
            unsafe { super::packet::nearest_packet::<Self, F, TOP, WATERTIGHT>(accel, rays, filter, hits) }
        }
        $(#[target_feature(enable = $feature)])?
        unsafe fn closest_coherent<F: HitFilter>(accel: &Accel, rays: &[Ray], filter: &F, hits: &mut [Option<Hit>]) {
            // SAFETY: as promised by the caller.
            unsafe { super::packet::closest_coherent::<Self, F>(accel, rays, filter, hits) }
        }
    };
}
pub(crate) use entry_points;

/// Relative bound on the rounding errors of a slab distance, with room to spare: eight units in the last place.
const SLACK: f32 = 4.0 / (1 << 23) as f32;
