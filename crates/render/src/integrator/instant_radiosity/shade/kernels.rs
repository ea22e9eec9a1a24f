//! The loops: packs of eight eyes, light after light.
// The three channels of several arrays are indexed alike.
#![allow(clippy::needless_range_loop)]

use super::packs::{ClosedPack, Pack, Scatter};
use super::panes::lanes_with;
#[cfg(target_arch = "x86_64")]
use super::wide::Avx2;
use super::wide::{Plain, Row, WIDE, Wide};
use super::{Asker, Kind, LightBlock};
use crate::bsdf::COEFFICIENTS;
use glam::Vec3;
use occlude_visibility::{BLOCK, Correction};
use std::f32::consts::FRAC_1_PI;

const PATCH: u8 = 0;
const POINT: u8 = 1;
const DIRECTION: u8 = 2;

const LAMBERT: u8 = 0;
const CLOSED: u8 = 1;
const LAYERED: u8 = 2;

/// See [`ManyLights::wanted`](occlude_visibility::ManyLights::wanted).
pub(super) fn wanted(asker: &Asker, block: usize, masks: &mut [u16]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the machine has the instructions.
        return unsafe { wanted_avx2(asker, block, masks) };
    }
    wanted_by_kind::<Plain>(asker, block, masks);
}

/// See [`ManyLights::take`](occlude_visibility::ManyLights::take).
pub(super) fn take(asker: &mut Asker, block: usize, visible: &[u16], corrections: &[Correction]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the machine has the instructions.
        return unsafe { take_avx2(asker, block, visible, corrections) };
    }
    take_by_kind::<Plain>(asker, block, visible, corrections);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn wanted_avx2(asker: &Asker, block: usize, masks: &mut [u16]) {
    wanted_by_kind::<Avx2>(asker, block, masks);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn take_avx2(asker: &mut Asker, block: usize, visible: &[u16], corrections: &[Correction]) {
    take_by_kind::<Avx2>(asker, block, visible, corrections);
}

#[inline(always)]
pub(super) fn wanted_by_kind<W: Wide>(asker: &Asker, block: usize, masks: &mut [u16]) {
    let lights = &asker.lights.blocks[block];
    let packs = &asker.packs.packs;
    match asker.lights.kind {
        Kind::Patch => wanted_of::<W, PATCH>(packs, lights, masks),
        Kind::Point => wanted_of::<W, POINT>(packs, lights, masks),
        Kind::Direction => wanted_of::<W, DIRECTION>(packs, lights, masks),
    }
}

#[inline(always)]
pub(super) fn take_by_kind<W: Wide>(
    asker: &mut Asker,
    block: usize,
    visible: &[u16],
    corrections: &[Correction],
) {
    match asker.lights.kind {
        Kind::Patch => take_of::<W, PATCH>(asker, block, visible, corrections),
        Kind::Point => take_of::<W, POINT>(asker, block, visible, corrections),
        Kind::Direction => take_of::<W, DIRECTION>(asker, block, visible, corrections),
    }
}

/// A vector for each of eight eyes.
#[derive(Clone, Copy)]
struct Vectors<W>([W; 3]);

impl<W: Wide> Vectors<W> {
    #[inline(always)]
    fn load(rows: &[Row; 3]) -> Self {
        Self([W::load(&rows[0]), W::load(&rows[1]), W::load(&rows[2])])
    }

    /// The same vector for all: that of light `l`.
    #[inline(always)]
    fn splat(lanes: &[[f32; BLOCK]; 3], l: usize) -> Self {
        Self([
            W::splat(lanes[0][l]),
            W::splat(lanes[1][l]),
            W::splat(lanes[2][l]),
        ])
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0].sub(b[0]), a[1].sub(b[1]), a[2].sub(b[2])])
    }

    #[inline(always)]
    fn scale(self, by: W) -> Self {
        Self([self.0[0].mul(by), self.0[1].mul(by), self.0[2].mul(by)])
    }

    #[inline(always)]
    fn dot(self, other: Self) -> W {
        let (a, b) = (self.0, other.0);
        a[0].mul(b[0]).add(a[1].mul(b[1])).add(a[2].mul(b[2]))
    }
}

/// From eyes to light `l`: the vectors, not normalised unless the light is infinitely far away.
#[inline(always)]
fn way<W: Wide, const KIND: u8>(positions: Vectors<W>, block: &LightBlock, l: usize) -> Vectors<W> {
    let place = Vectors::splat(&block.place, l);
    if KIND == DIRECTION {
        place
    } else {
        place.sub(positions)
    }
}

/// Which lights could bring something: in front of the eye by both normals, the eye in front of them.
#[inline(always)]
fn wanted_of<W: Wide, const KIND: u8>(packs: &[Pack], block: &LightBlock, masks: &mut [u16]) {
    let zero = W::splat(0.0);
    for pack in packs {
        let positions = Vectors::<W>::load(&pack.position);
        let normals = Vectors::<W>::load(&pack.normal);
        let shading_normals = Vectors::<W>::load(&pack.shading_normal);
        let room = W::load(&pack.events_left).add(W::splat(0.5));
        let mut found = W::splat_bits(0);
        for l in 0..BLOCK {
            let way = way::<W, KIND>(positions, block, l);
            let mut least = normals.dot(way).min(shading_normals.dot(way));
            let mut bit = W::splat_bits(1 << l);
            if KIND != DIRECTION {
                let back = zero.sub(Vectors::splat(&block.axis, l).dot(way));
                if KIND == PATCH {
                    least = back.min(least);
                    bit = bit.and(room.greater(W::splat(block.events[l])));
                } else if block.scale[l] != 0.0 {
                    let ramp = W::splat(block.offset[l])
                        .mul(way.dot(way).sqrt())
                        .add(back.mul(W::splat(block.scale[l])));
                    least = ramp.min(least);
                }
            }
            found = found.or(least.greater(zero).and(bit));
        }
        let mut bits = [0; WIDE];
        found.store_bits(&mut bits);
        for (&eye, bits) in pack.eyes[..pack.count].iter().zip(bits) {
            masks[eye as usize] = bits as u16;
        }
    }
}

#[inline(always)]
fn falloff<W: Wide>(block: &LightBlock, l: usize, cosines: W) -> W {
    let ramp = W::splat(block.scale[l])
        .mul(cosines)
        .add(W::splat(block.offset[l]))
        .max(W::splat(0.0))
        .min(W::splat(1.0));
    ramp.mul(ramp)
}

/// The cosine at the eye times what light `l`, of unit colour, sends there; not bounded.
#[inline(always)]
fn lambert<W: Wide, const KIND: u8>(
    positions: Vectors<W>,
    shading_normals: Vectors<W>,
    block: &LightBlock,
    l: usize,
) -> W {
    let way = way::<W, KIND>(positions, block, l);
    let cosines = shading_normals.dot(way);
    if KIND == DIRECTION {
        return cosines;
    }
    let distance2 = way.dot(way);
    let back = W::splat(0.0).sub(Vectors::splat(&block.axis, l).dot(way));
    if KIND == PATCH {
        cosines.mul(back).div(distance2.mul(distance2))
    } else {
        let distance = distance2.sqrt();
        let mut terms = cosines.div(distance2.mul(distance));
        if block.scale[l] != 0.0 {
            terms = terms.mul(falloff(block, l, back.div(distance)));
        }
        terms
    }
}

#[inline(always)]
fn polynomial<W: Wide>(coefficients: &[Row; COEFFICIENTS], x: W) -> W {
    let mut sum = W::load(&coefficients[COEFFICIENTS - 1]);
    for row in coefficients[..COEFFICIENTS - 1].iter().rev() {
        sum = sum.mul(x).add(W::load(row));
    }
    sum
}

/// The same of closed forms, by channel: scattered light instead of the cosine, bounded; and where the bound bounds.
#[inline(always)]
fn closed<W: Wide, const KIND: u8>(
    positions: Vectors<W>,
    shading_normals: Vectors<W>,
    closed: &ClosedPack,
    block: &LightBlock,
    l: usize,
    clamp: W,
) -> ([W; 3], W) {
    let one = W::splat(1.0);
    let mut way = way::<W, KIND>(positions, block, l);
    let mut arriving = one;
    if KIND != DIRECTION {
        let per_distance = one.div(way.dot(way).sqrt());
        way = way.scale(per_distance);
        arriving = per_distance.mul(per_distance);
        if KIND == PATCH || block.scale[l] != 0.0 {
            let back = W::splat(0.0).sub(Vectors::splat(&block.axis, l).dot(way));
            arriving = arriving.mul(if KIND == PATCH {
                back
            } else {
                falloff(block, l, back)
            });
        }
    }
    // Lights below the horizon were not asked for; the numbers computed for them must only be finite.
    let cosines = shading_normals.dot(way).max(W::splat(1e-6));
    let mut over = W::splat_bits(0);
    if KIND == PATCH {
        over = cosines.mul(arriving).greater(clamp);
        if over.any() {
            arriving = arriving.min(clamp.div(cosines));
        }
    }
    let root = cosines.sqrt();
    let (a, b) = (polynomial(&closed.a, root), polynomial(&closed.b, root));
    // Heights of the half vector, see `microfacet::half_vector`.
    let (cos_o, alpha2) = (W::load(&closed.cos_o), W::load(&closed.alpha2));
    let two = W::splat(2.0);
    let length2 = two
        .add(two.mul(Vectors::load(&closed.wo).dot(way)))
        .max(W::splat(1e-12));
    let height = cos_o.add(cosines);
    let height2 = height.mul(height);
    let e = length2
        .sub(height2)
        .max(W::splat(0.0))
        .add(alpha2.mul(height2));
    let smith = alpha2.add(one.sub(alpha2).mul(cosines).mul(cosines)).sqrt();
    let shadowed = cos_o.mul(smith).add(cosines.mul(W::load(&closed.root_o)));
    let lobe = alpha2
        .mul(W::splat(FRAC_1_PI * 0.5))
        .mul(length2.mul(length2))
        .mul(cosines)
        .div(e.mul(e).mul(shadowed));
    let m = one
        .sub(W::splat(0.5).mul(length2.sqrt()))
        .max(W::splat(0.0));
    let m2 = m.mul(m);
    let weight = m2.mul(m2).mul(m);
    let facing = lobe.mul(one.sub(weight));
    let grazing = lobe.mul(weight).mul(W::load(&closed.f90));
    let mut terms = [grazing; 3];
    for c in 0..3 {
        let cosine_lobe = W::load(&closed.constant[c])
            .add(W::load(&closed.by_a[c]).mul(a))
            .add(W::load(&closed.by_b[c]).mul(b));
        terms[c] = cosine_lobe
            .mul(cosines)
            .add(W::load(&closed.f0[c]).mul(facing))
            .add(grazing)
            .mul(arriving);
    }
    (terms, over)
}

/// The same of layered materials, from bounded Lambert terms, for eyes whose mask has light `l` of a block.
#[inline(never)]
fn layered(
    asker: &Asker,
    pack: &Pack,
    block: &LightBlock,
    l: usize,
    masks: &[u32; WIDE],
    terms: &Row,
) -> [Row; 3] {
    let place = Vec3::from_array(block.place.map(|row| row[l]));
    let mut scattered = [[0.0; WIDE]; 3];
    for lane in lanes_with(masks, l) {
        let eye = &asker.eyes[pack.eyes[lane] as usize];
        let Scatter::Layered(index) = eye.scatter else {
            continue;
        };
        let way = match asker.lights.kind {
            Kind::Direction => place,
            Kind::Patch | Kind::Point => place - eye.position,
        };
        let layered = &asker.scatterers.layered[index as usize];
        let wi = (layered.local_from_world * way).normalize_or_zero();
        if wi.z > 0.0 {
            let (value, _) = layered.bsdf.eval(layered.wo, wi);
            for c in 0..3 {
                scattered[c][lane] = value[c] * (terms[lane] / wi.z);
            }
        }
    }
    scattered
}

/// What a pack's eyes get from the lights of block `index` that are in their masks, without [`Pack::weight`], and whether the bound
/// on the geometry term has bounded any of it.
#[inline(always)]
fn shine<W: Wide, const KIND: u8, const SHAPE: u8>(
    asker: &Asker,
    p: usize,
    index: usize,
    masks: &[u32; WIDE],
    clamp: f32,
) -> ([Row; 3], bool) {
    let pack = &asker.packs.packs[p];
    let block = &asker.lights.blocks[index];
    let clamp = W::splat(clamp);
    let positions = Vectors::<W>::load(&pack.position);
    let shading_normals = Vectors::<W>::load(&pack.shading_normal);
    let asked = W::load_bits(masks);
    let mut sums = [W::splat(0.0); 3];
    let mut bounded = W::splat_bits(0);
    let mut left = masks.iter().fold(0, |all, mask| all | mask);
    let panes = asker.panes.as_ref().and_then(|panes| {
        let among = panes.of_block(p, index);
        (among != 0).then_some((panes, among))
    });
    while left != 0 {
        let l = left.trailing_zeros() as usize % BLOCK;
        left &= left - 1;
        let seen = asked.has(W::splat_bits(1 << l));
        let mut terms;
        if SHAPE == CLOSED {
            let forms = &asker.packs.closed[p - asker.packs.lambert];
            let over;
            (terms, over) = closed::<W, KIND>(positions, shading_normals, forms, block, l, clamp);
            bounded = bounded.or(over.and(seen));
        } else {
            let mut term = lambert::<W, KIND>(positions, shading_normals, block, l);
            if KIND == PATCH {
                bounded = bounded.or(term.greater(clamp).and(seen));
                term = term.min(clamp);
            }
            terms = [term; 3];
            if SHAPE == LAYERED {
                let mut row = [0.0; WIDE];
                term.store(&mut row);
                let rows = layered(asker, pack, block, l, masks, &row);
                terms = Vectors::load(&rows).0;
            }
        }
        if let Some((panes, among)) = panes
            && let Some(tint) = panes.tint((p, pack), (index, l), masks, among)
        {
            for c in 0..3 {
                terms[c] = terms[c].mul(W::load(&tint[c]));
            }
        }
        for c in 0..3 {
            // Of lights that are not seen the term may be anything.
            let brought = terms[c].mul(W::splat(block.colour[c][l])).and(seen);
            sums[c] = sums[c].add(brought);
        }
    }
    let mut rows = [[0.0; WIDE]; 3];
    for c in 0..3 {
        sums[c].store(&mut rows[c]);
    }
    (rows, bounded.any())
}

#[inline(always)]
fn shine_by_shape<W: Wide, const KIND: u8>(
    asker: &Asker,
    p: usize,
    index: usize,
    masks: &[u32; WIDE],
    clamp: f32,
) -> ([Row; 3], bool) {
    let packs = &asker.packs;
    if p < packs.lambert {
        shine::<W, KIND, LAMBERT>(asker, p, index, masks, clamp)
    } else if p < packs.lambert + packs.closed.len() {
        shine::<W, KIND, CLOSED>(asker, p, index, masks, clamp)
    } else {
        shine::<W, KIND, LAYERED>(asker, p, index, masks, clamp)
    }
}

/// Adds `amount` of what the lights in `masks` bring to a pack.
#[inline(always)]
fn add<W: Wide, const KIND: u8>(
    asker: &mut Asker,
    p: usize,
    index: usize,
    masks: &[u32; WIDE],
    amount: f32,
) {
    let (rows, bounded) = shine_by_shape::<W, KIND>(asker, p, index, masks, asker.clamp);
    if KIND == PATCH && bounded {
        asker.clamped += f64::from(loss(asker, p, index, masks, &rows) * amount);
    }
    let brought = &mut asker.packs.packs[p].brought;
    for c in 0..3 {
        for lane in 0..WIDE {
            brought[c][lane] += rows[c][lane] * amount;
        }
    }
}

/// What the bound takes away from patches, all channels.
#[cold]
fn loss(asker: &Asker, p: usize, index: usize, masks: &[u32; WIDE], bounded: &[Row; 3]) -> f32 {
    let (whole, _) = shine_by_shape::<Plain, PATCH>(asker, p, index, masks, f32::INFINITY);
    let pack = &asker.packs.packs[p];
    let mut sum = 0.0;
    for c in 0..3 {
        for lane in 0..WIDE {
            sum += (whole[c][lane] - bounded[c][lane]) * pack.weight[c][lane];
        }
    }
    sum
}

#[inline(always)]
fn take_of<W: Wide, const KIND: u8>(
    asker: &mut Asker,
    index: usize,
    visible: &[u16],
    corrections: &[Correction],
) {
    for p in 0..asker.packs.packs.len() {
        let pack = &asker.packs.packs[p];
        let mut masks = [0; WIDE];
        for (mask, &eye) in masks.iter_mut().zip(&pack.eyes[..pack.count]) {
            *mask = u32::from(visible[eye as usize]);
        }
        if masks != [0; WIDE] {
            add::<W, KIND>(asker, p, index, &masks, 1.0);
        }
    }
    for correction in corrections {
        let slot = asker.packs.slots[correction.eye as usize] as usize;
        let mut masks = [0; WIDE];
        masks[slot % WIDE] = 1 << correction.light;
        add::<W, KIND>(asker, slot / WIDE, index, &masks, correction.amount);
    }
}
