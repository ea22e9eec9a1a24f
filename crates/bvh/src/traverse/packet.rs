//! Eight rays at a time.
//!
//! All rays of a packet that met a node test it one after the other. Their tests do not wait for each other, so that the
//! processor overlaps them, and a node is fetched and a branch mispredicted once for all instead of once a ray. The sets of
//! rays that meet each of eight children are the bytes of one 64-bit word. A ray that is alone with a subtree goes on by
//! itself, as the single rays do: rays that diverge cost little more than those.
//!
//! Fuetterling, Lojewski, Pfreundt, Ebert 2015, "Efficient ray tracing kernels for modern CPU architectures", trace larger
//! streams in this way. For closest hits the children are visited by where the first ray of the set enters
//! them, and rays that start at one point (a *fan*) test most nodes with the interval of their directions, once for all: the wrong tool where
//! rays do not run alike, and each wants an order of its own.

use super::{Edges, Found, Isa, Query, Reciprocal, Scope, Slabs, entry, is_valid, keep, walk};
use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Child, NO_TRIANGLE, Node, STACK, WIDTH};
use occlude_visibility::{Hit, Ray};
use std::mem::MaybeUninit;

/// Rays of a packet: as many as a byte has bits.
const PACKET: usize = 8;
const _: () = assert!(WIDTH == 8, "a byte a child in one word");

/// [`Isa::occluded_batch`], to be compiled under the features of `I`.
///
/// # Safety
/// As for [`Isa`].
#[inline(always)]
pub(super) unsafe fn occluded_batch<I: Isa, F: HitFilter>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    occluded: &mut [bool],
) {
    for (rays, occluded) in rays.chunks(PACKET).zip(occluded.chunks_mut(PACKET)) {
        // SAFETY: as promised by the caller.
        unsafe {
            match (accel.has_placed(), accel.is_watertight()) {
                (false, false) => I::packet::<F, false, false>(accel, rays, filter, occluded),
                (false, true) => I::packet::<F, false, true>(accel, rays, filter, occluded),
                (true, false) => I::packet::<F, true, false>(accel, rays, filter, occluded),
                (true, true) => I::packet::<F, true, true>(accel, rays, filter, occluded),
            }
        }
    }
}

/// [`Isa::packet`], to be compiled under the features of `I`.
///
/// # Safety
/// As for [`Isa`].
#[inline(always)]
pub(super) unsafe fn packet<I: Isa, F: HitFilter, const TOP: bool, const WATERTIGHT: bool>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    occluded: &mut [bool],
) {
    // SAFETY: as promised by the caller.
    unsafe {
        if WATERTIGHT {
            trace::<I, I::Tight, F, TOP, true>(accel, rays, filter, occluded);
        } else {
            trace::<I, I::Thin, F, TOP, false>(accel, rays, filter, occluded);
        }
    }
}

/// Bit `k` of `mask` into the lowest bit of byte `k`.
#[inline(always)]
fn spread(mask: u32) -> u64 {
    // Bit k of byte k remains; a byte that is not zero then carries into its top bit, and none carries further.
    let bits = (u64::from(mask) * 0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
    ((bits + 0x7f7f_7f7f_7f7f_7f7f) >> 7) & 0x0101_0101_0101_0101
}

/// A child that waits, and which rays met it.
#[derive(Clone, Copy)]
struct Waiting {
    child: Child,
    rays: u32,
}

/// Takes the lowest bit out.
#[inline(always)]
fn take(rays: &mut u32) -> usize {
    let k = rays.trailing_zeros() as usize;
    *rays &= *rays - 1;
    k % PACKET
}

#[inline(always)]
unsafe fn trace<
    I: Isa,
    E: Edges<WATERTIGHT>,
    F: HitFilter,
    const TOP: bool,
    const WATERTIGHT: bool,
>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    occluded: &mut [bool],
) {
    let tree = accel.top();
    let mut slabs = [const { MaybeUninit::<I::Slabs>::uninit() }; PACKET];
    let mut edges = [const { MaybeUninit::<E>::uninit() }; PACKET];
    let mut ends = [0.0; PACKET];
    let mut alive = 0;
    occluded.fill(false);
    if tree.nodes.is_empty() {
        return;
    }
    for (k, ray) in rays.iter().enumerate().take(PACKET) {
        if is_valid(ray) {
            // SAFETY: as promised by the caller.
            unsafe {
                slabs[k].write(I::Slabs::new(ray));
                edges[k].write(E::new(ray));
            }
            ends[k] = Found::nothing(ray).t;
            alive |= 1u32 << k;
        }
    }
    let mut stack = [const { MaybeUninit::<Waiting>::uninit() }; STACK];
    let mut waiting = 0;
    let mut now = Waiting {
        child: Child::node(0),
        rays: alive,
    };
    // SAFETY: the tree is valid: a child that is met names a node, blocks or an instance that exist, and no way down is
    // longer than MAX_DEPTH, so that STACK suffices; entries below `waiting` were written. A ray in a set is valid, so that
    // its slabs and edges were written, and there are as many answers as rays.
    unsafe {
        while alive != 0 {
            let mut left = now.rays;
            if left & left.wrapping_sub(1) == 0 {
                if left != 0 {
                    let k = take(&mut left);
                    let ray = rays.get_unchecked(k);
                    let query = Query { accel, ray, filter };
                    let scope = Scope::top(&query);
                    let mut found = Found::nothing(ray);
                    let (slabs, edges) = (slabs[k].assume_init_ref(), edges[k].assume_init_ref());
                    if walk::<I, E, F, true, TOP, WATERTIGHT>(
                        &query, &scope, slabs, edges, now.child, &mut found,
                    ) {
                        *occluded.get_unchecked_mut(k) = true;
                        alive &= !(1 << k);
                    }
                }
            } else if !now.child.is_leaf() {
                let node = tree.nodes.get_unchecked(now.child.index());
                let mut met = 0;
                while left != 0 {
                    let k = take(&mut left);
                    let (mask, _) = slabs[k].assume_init_ref().test(node, ends[k]);
                    met |= spread(mask) << k;
                }
                // From the highest lane down, so that the lowest comes first.
                while met != 0 {
                    let lane = (63 - met.leading_zeros() as usize) / 8;
                    let rays = (met >> (8 * lane)) as u32 & 0xff;
                    met &= !(0xff << (8 * lane));
                    let child = *node.children.get_unchecked(lane);
                    I::prefetch(tree, child);
                    stack
                        .get_unchecked_mut(waiting)
                        .write(Waiting { child, rays });
                    waiting += 1;
                }
            } else {
                while left != 0 {
                    let k = take(&mut left);
                    let ray = rays.get_unchecked(k);
                    let query = Query { accel, ray, filter };
                    let mut found = Found::nothing(ray);
                    let mut hit = false;
                    if now.child.is_instance() {
                        hit = TOP
                            && I::enter::<F, true>(&query, now.child.index() as u32, &mut found);
                    } else {
                        let scope = Scope::top(&query);
                        let first = now.child.index();
                        for index in first..first + now.child.block_count() {
                            let block = tree.blocks.get_unchecked(index);
                            let lanes = edges[k].assume_init_ref().test(block, ends[k]);
                            if lanes.mask != 0
                                && keep::<F, true>(
                                    &query,
                                    &scope,
                                    block,
                                    index as u32,
                                    &lanes,
                                    &mut found,
                                )
                            {
                                hit = true;
                                break;
                            }
                        }
                    }
                    if hit {
                        *occluded.get_unchecked_mut(k) = true;
                        alive &= !(1 << k);
                    }
                }
            }
            loop {
                if waiting == 0 {
                    return;
                }
                waiting -= 1;
                now = stack.get_unchecked(waiting).assume_init();
                now.rays &= alive;
                if now.rays != 0 {
                    break;
                }
            }
        }
    }
}

/// [`Isa::closest_coherent`], to be compiled under the features of `I`.
///
/// # Safety
/// As for [`Isa`].
#[inline(always)]
pub(super) unsafe fn closest_coherent<I: Isa, F: HitFilter>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    hits: &mut [Option<Hit>],
) {
    for (rays, hits) in rays.chunks(PACKET).zip(hits.chunks_mut(PACKET)) {
        // SAFETY: as promised by the caller.
        unsafe {
            match (accel.has_placed(), accel.is_watertight()) {
                (false, false) => I::nearest_packet::<F, false, false>(accel, rays, filter, hits),
                (false, true) => I::nearest_packet::<F, false, true>(accel, rays, filter, hits),
                (true, false) => I::nearest_packet::<F, true, false>(accel, rays, filter, hits),
                (true, true) => I::nearest_packet::<F, true, true>(accel, rays, filter, hits),
            }
        }
    }
}

/// [`Isa::nearest_packet`], to be compiled under the features of `I`.
///
/// # Safety
/// As for [`Isa`].
#[inline(always)]
pub(super) unsafe fn nearest_packet<
    I: Isa,
    F: HitFilter,
    const TOP: bool,
    const WATERTIGHT: bool,
>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    hits: &mut [Option<Hit>],
) {
    // SAFETY: as promised by the caller.
    unsafe {
        if WATERTIGHT {
            nearest::<I, I::Tight, F, TOP, true>(accel, rays, filter, hits);
        } else {
            nearest::<I, I::Thin, F, TOP, false>(accel, rays, filter, hits);
        }
    }
}

/// Rays from one point into one octant, taken together: what they meet lies within their hull.
struct Fan {
    origin: [f32; 3],
    /// Least and largest reciprocal of the directions, by axis: to enter by, and to leave by.
    near: [[f32; 2]; 3],
    far: [[f32; 2]; 3],
    negative: [bool; 3],
    t_min: f32,
}

impl Fan {
    /// `None` if the rays do not start at one point, or run into several octants.
    #[inline(always)]
    fn around(rays: &[Ray], valid: u32) -> Option<Self> {
        let mut some = (0..rays.len()).filter(|k| valid >> k & 1 != 0);
        let first = &rays[some.next()?];
        let reciprocal = Reciprocal::new(first);
        let mut fan = Self {
            origin: first.origin.to_array(),
            near: reciprocal.near.map(|x| [x, x]),
            far: reciprocal.far.map(|x| [x, x]),
            negative: reciprocal.negative,
            t_min: reciprocal.t_min,
        };
        for k in some {
            let ray = &rays[k];
            let reciprocal = Reciprocal::new(ray);
            if ray.origin != first.origin || reciprocal.negative != fan.negative {
                return None;
            }
            for axis in 0..3 {
                let (near, far) = (reciprocal.near[axis], reciprocal.far[axis]);
                fan.near[axis] = [fan.near[axis][0].min(near), fan.near[axis][1].max(near)];
                fan.far[axis] = [fan.far[axis][0].min(far), fan.far[axis][1].max(far)];
            }
            fan.t_min = fan.t_min.min(reciprocal.t_min);
        }
        // Products with an infinite reciprocal may be unknown; such rays go one by one.
        let finite = |x: &[[f32; 2]; 3]| x.iter().flatten().all(|x| x.is_finite());
        (finite(&fan.near) && finite(&fan.far)).then_some(fan)
    }

    /// Children that some ray may meet before `t_max`, as bits, and where the first may enter them.
    #[inline(always)]
    fn test(&self, node: &Node, t_max: f32) -> (u32, [f32; WIDTH]) {
        let min = |a: f32, b: f32| if a < b { a } else { b };
        let max = |a: f32, b: f32| if a > b { a } else { b };
        let mut enter = [self.t_min; WIDTH];
        let mut leave = [t_max; WIDTH];
        for axis in 0..3 {
            let side = usize::from(self.negative[axis]);
            let (first, last) = (&node.planes[axis][side], &node.planes[axis][1 - side]);
            let ([n0, n1], [f0, f1]) = (self.near[axis], self.far[axis]);
            for lane in 0..WIDTH {
                let to_enter = first[lane] - self.origin[axis];
                let to_leave = last[lane] - self.origin[axis];
                enter[lane] = max(min(to_enter * n0, to_enter * n1), enter[lane]);
                leave[lane] = min(max(to_leave * f0, to_leave * f1), leave[lane]);
            }
        }
        let mut mask = 0;
        for lane in 0..WIDTH {
            mask |= u32::from(enter[lane] <= leave[lane]) << lane;
        }
        (mask, enter)
    }
}

/// A child that waits, where the first ray enters it (an [`entry`]), and which rays met it.
#[derive(Clone, Copy)]
struct Ordered {
    entry: u64,
    rays: u32,
}

#[inline(always)]
unsafe fn nearest<
    I: Isa,
    E: Edges<WATERTIGHT>,
    F: HitFilter,
    const TOP: bool,
    const WATERTIGHT: bool,
>(
    accel: &Accel,
    rays: &[Ray],
    filter: &F,
    hits: &mut [Option<Hit>],
) {
    let tree = accel.top();
    let mut slabs = [const { MaybeUninit::<I::Slabs>::uninit() }; PACKET];
    let mut edges = [const { MaybeUninit::<E>::uninit() }; PACKET];
    let mut found = [const { MaybeUninit::<Found>::uninit() }; PACKET];
    // Where each ray stops so far: kept apart, so that all are compared at once.
    let mut ends = [f32::NEG_INFINITY; PACKET];
    hits.fill(None);
    if tree.nodes.is_empty() {
        return;
    }
    let mut valid = 0;
    for (k, ray) in rays.iter().enumerate().take(PACKET) {
        if is_valid(ray) {
            // SAFETY: as promised by the caller.
            unsafe {
                slabs[k].write(I::Slabs::new(ray));
                edges[k].write(E::new(ray));
            }
            ends[k] = found[k].write(Found::nothing(ray)).t;
            valid |= 1u32 << k;
        }
    }
    let fan = Fan::around(rays, valid);
    let mut stack = [const { MaybeUninit::<Ordered>::uninit() }; STACK];
    let mut waiting = 0;
    let mut now = Child::node(0);
    let mut left = valid;
    // SAFETY: the tree is valid: a child that is met names a node, blocks or an instance that exist, and no way down is
    // longer than MAX_DEPTH, so that STACK suffices; entries below `waiting` were written. A ray in a set is valid, so that
    // its slabs, edges and hit were written, and there are as many answers as rays.
    unsafe {
        'visit: loop {
            if left & left.wrapping_sub(1) == 0 {
                if left != 0 {
                    let k = take(&mut left);
                    let query = Query {
                        accel,
                        ray: rays.get_unchecked(k),
                        filter,
                    };
                    let scope = Scope::top(&query);
                    let found = found[k].assume_init_mut();
                    let (slabs, edges) = (slabs[k].assume_init_ref(), edges[k].assume_init_ref());
                    walk::<I, E, F, false, TOP, WATERTIGHT>(
                        &query, &scope, slabs, edges, now, found,
                    );
                    ends[k] = found.t;
                }
            } else if !now.is_leaf() {
                let node = tree.nodes.get_unchecked(now.index());
                let mut met = 0;
                let mut distances = [f32::INFINITY; WIDTH];
                if let Some(fan) = &fan {
                    let end = ends.iter().fold(f32::NEG_INFINITY, |end, &e| end.max(e));
                    let (mask, near) = fan.test(node, end);
                    let mut rest = mask;
                    let mut leaves = false;
                    while rest != 0 {
                        let lane = rest.trailing_zeros() as usize % WIDTH;
                        rest &= rest - 1;
                        leaves |= node.children.get_unchecked(lane).is_leaf();
                    }
                    if !leaves {
                        // Nodes alone: which of the rays meet them is found out further down.
                        distances = near;
                        let mut rest = mask;
                        while rest != 0 {
                            met |= u64::from(left) << (8 * (rest.trailing_zeros() % 8));
                            rest &= rest - 1;
                        }
                        left = 0;
                    }
                }
                while left != 0 {
                    let k = take(&mut left);
                    let (mask, near) = slabs[k].assume_init_ref().test(node, ends[k]);
                    met |= spread(mask) << k;
                    I::Slabs::lower(&mut distances, near, mask);
                }
                let base = waiting;
                while met != 0 {
                    let lane = met.trailing_zeros() as usize / 8 % WIDTH;
                    let rays = (met >> (8 * lane)) as u32 & 0xff;
                    met &= !(0xff << (8 * lane));
                    let child = *node.children.get_unchecked(lane);
                    let new = Ordered {
                        entry: entry(distances[lane], child),
                        rays,
                    };
                    let mut at = waiting;
                    while at > base {
                        let below = stack.get_unchecked(at - 1).assume_init();
                        if below.entry >= new.entry {
                            break;
                        }
                        stack.get_unchecked_mut(at).write(below);
                        at -= 1;
                    }
                    stack.get_unchecked_mut(at).write(new);
                    waiting += 1;
                }
                if waiting > base + 1 {
                    let second = stack.get_unchecked(waiting - 2).assume_init();
                    I::prefetch(tree, Child(second.entry as u32));
                }
            } else {
                while left != 0 {
                    let k = take(&mut left);
                    let query = Query {
                        accel,
                        ray: rays.get_unchecked(k),
                        filter,
                    };
                    let found = found[k].assume_init_mut();
                    if now.is_instance() {
                        if TOP {
                            I::enter::<F, false>(&query, now.index() as u32, found);
                        }
                    } else {
                        let scope = Scope::top(&query);
                        let first = now.index();
                        for index in first..first + now.block_count() {
                            let block = tree.blocks.get_unchecked(index);
                            let lanes = edges[k].assume_init_ref().test(block, found.t);
                            if lanes.mask != 0 {
                                keep::<F, false>(
                                    &query,
                                    &scope,
                                    block,
                                    index as u32,
                                    &lanes,
                                    found,
                                );
                            }
                        }
                    }
                    ends[k] = found.t;
                }
            }
            loop {
                if waiting == 0 {
                    break 'visit;
                }
                waiting -= 1;
                let next = stack.get_unchecked(waiting).assume_init();
                let distance = f32::from_bits((next.entry >> 32) as u32);
                let mut near = 0;
                for (k, &end) in ends.iter().enumerate() {
                    near |= u32::from(distance <= end) << k;
                }
                left = next.rays & near;
                now = Child(next.entry as u32);
                if left != 0 {
                    break;
                }
            }
        }
        while valid != 0 {
            let k = take(&mut valid);
            let found = found[k].assume_init_ref();
            if found.id != NO_TRIANGLE {
                *hits.get_unchecked_mut(k) = Some(accel.hit(found));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::spread;

    #[test]
    fn bits_spread_to_bytes() {
        for mask in 0..256u32 {
            let expected = (0..8).map(|k| u64::from(mask >> k & 1) << (8 * k)).sum();
            assert_eq!(spread(mask), expected);
        }
    }
}
