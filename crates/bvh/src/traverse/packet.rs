//! Any-hit for eight rays at a time.
//!
//! All rays of a packet that met a node test it one after the other. Their tests do not wait for each other, so that the
//! processor overlaps them, and a node is fetched and a branch mispredicted once for all instead of once a ray. The sets of
//! rays that meet each of eight children are the bytes of one 64-bit word. A ray that is alone with a subtree goes on by
//! itself, as the single rays do: rays that diverge cost little more than those.
//!
//! Fuetterling, Lojewski, Pfreundt, Ebert 2015, "Efficient ray tracing kernels for modern CPU architectures", trace larger
//! streams in this way. The wrong tool for closest hits, where each ray wants an order of its own.

use super::{Edges, Found, Isa, Query, Scope, Slabs, is_valid, keep, walk};
use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Child, STACK, WIDTH};
use occlude_visibility::Ray;
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
