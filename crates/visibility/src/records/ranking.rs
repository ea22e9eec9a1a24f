//! Which of sixteen records answer for a place: of the [`COMPARED`] nearest that look to its side, the best three by Eq. 2.
//!
//! This runs for every question that a path asks, so it is written for many places after each other, without branches: as loops over sixteen records, and
//! once more with the instructions of AVX-512, which compilers do not find in those loops. Both give the same bits (tested).
//!
//! The wrong tool to search: the sixteen come from `cells`.

use super::map::Stand;
use super::neighbours::{NOBODY, weight_of};
use super::settings::Falloff;
use crate::wide::{Machine, wide};
use glam::Vec3;

/// Records that are compared with each other.
pub(super) const RANKED: usize = 16;

/// The nearest of them to a place, whose weights are compared.
pub(super) const COMPARED: u32 = 6;

/// Places that go through each loop together, at most.
pub(super) const TOGETHER: usize = 64;

/// No record; a cache holds fewer than can be numbered.
pub(super) const NOBODY_16: u16 = u16::MAX;

/// Up to three records that answer for a place, the best first; weights add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearby {
    pub(super) ids: [u32; 3],
    pub(super) weights: [f32; 3],
}

impl Nearby {
    /// No record stands near.
    pub const NOBODY: Self = Self {
        ids: [NOBODY; 3],
        weights: [0.0; 3],
    };

    /// One record.
    pub(super) fn alone(id: u32) -> Self {
        Self {
            ids: [id, NOBODY, NOBODY],
            weights: [1.0, 0.0, 0.0],
        }
    }
}

/// The records that a place may choose of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidates {
    /// [`NOBODY_16`] from some place on, if there are fewer.
    pub(super) ids: [u16; RANKED],
    /// `d_max` of Eq. 2.
    pub(super) d_max: f32,
}

impl Candidates {
    /// None at all.
    pub(super) const NONE: Self = Self {
        ids: [NOBODY_16; RANKED],
        d_max: 0.0,
    };
}

/// A number for every candidate.
type Row = [f32; RANKED];

/// The candidates' weights as whole numbers, for sorting: the bits of the weight but for the last four, and those count down with
/// the candidate's rank. 0: has no say.
type Keys = [u32; RANKED];

fn per_d_max(candidates: &Candidates) -> f32 {
    if candidates.d_max > 0.0 {
        1.0 / candidates.d_max
    } else {
        0.0
    }
}

#[inline(always)]
fn weigh(
    candidates: &Candidates,
    stands: &[Stand],
    falloff: Falloff,
    position: Vec3,
    normal: Vec3,
) -> Keys {
    let per_d_max = per_d_max(candidates);
    let last = stands.len() - 1;
    // How far those are that look to the place's side.
    let (mut apart, mut weights): (Row, Row) = ([0.0; RANKED], [0.0; RANKED]);
    for k in 0..RANKED {
        let site = &stands[usize::from(candidates.ids[k]).min(last)].site;
        let offset = site.position - position;
        let cosine = normal.dot(site.normal);
        let distance2 = offset.length_squared();
        weights[k] = weight_of(falloff, cosine, normal.dot(offset), distance2, per_d_max);
        apart[k] = if (candidates.ids[k] != NOBODY_16) & (cosine > 0.0) {
            distance2
        } else {
            f32::INFINITY
        };
    }
    let mut keys = [0; RANKED];
    for k in 0..RANKED {
        let nearer: u32 = apart.iter().map(|&other| u32::from(other < apart[k])).sum();
        let counts = (apart[k] < f32::INFINITY) & (nearer < COMPARED) & (weights[k] > 0.0);
        let bits = (weights[k].to_bits() & !15) | (RANKED - 1 - k) as u32;
        keys[k] = if counts { bits } else { 0 };
    }
    keys
}

/// The three largest keys.
#[inline(always)]
fn largest(mut keys: Keys) -> [u32; 3] {
    let mut best = [0; 3];
    for best in &mut best {
        *best = keys.iter().fold(0, |a, &b| a.max(b));
        for key in &mut keys {
            *key = if *key == *best { 0 } else { *key };
        }
    }
    best
}

/// The records that these keys stand for, the largest first.
#[inline(always)]
fn named(candidates: &Candidates, best: [u32; 3]) -> Nearby {
    let mut found = Nearby::NOBODY;
    for ((id, weight), best) in found.ids.iter_mut().zip(&mut found.weights).zip(best) {
        if best != 0 {
            *id = u32::from(candidates.ids[RANKED - 1 - (best & 15) as usize]);
            *weight = f32::from_bits(best & !15);
        }
    }
    let sum = found.weights[0] + found.weights[1] + found.weights[2];
    if sum > 0.0 {
        let scale = 1.0 / sum;
        found.weights = found.weights.map(|w| w * scale);
    }
    found
}

wide! {
    fn by_loops(
        candidates: &[Candidates],
        stands: &[Stand],
        falloff: Falloff,
        places: &[(Vec3, Vec3)],
        found: &mut [Nearby],
    ) {
        for ((candidates, &(position, normal)), found) in candidates.iter().zip(places).zip(found) {
            let keys = weigh(candidates, stands, falloff, position, normal);
            *found = named(candidates, largest(keys));
        }
    }
}

/// The best three for places with normals, of the candidates for each; [`TOGETHER`] places at most, and there is a record at least.
pub(super) fn best_of_all(
    machine: Machine,
    candidates: &[Candidates],
    stands: &[Stand],
    falloff: Falloff,
    places: &[(Vec3, Vec3)],
    found: &mut [Nearby],
) {
    assert!(candidates.len() <= TOGETHER && !stands.is_empty());
    #[cfg(target_arch = "x86_64")]
    if machine.has_avx512() {
        // SAFETY: the machine has the instructions.
        unsafe { avx512::best_of_all(candidates, stands, falloff, places, found) };
        return;
    }
    by_loops(machine, candidates, stands, falloff, places, found);
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{COMPARED, Candidates, Keys, NOBODY_16, Nearby, RANKED, Stand, TOGETHER};
    use crate::records::settings::Falloff;
    use glam::Vec3;
    use std::arch::x86_64::*;
    use std::mem::offset_of;

    /// Logarithm of the floats from one stand to the next, and the floats to its parts.
    const LINE: u32 = (size_of::<Stand>() / 4).ilog2();
    const POSITION: [usize; 3] = [
        offset_of!(Stand, site.position.x) / 4,
        offset_of!(Stand, site.position.y) / 4,
        offset_of!(Stand, site.position.z) / 4,
    ];
    const NORMAL: [usize; 3] = [
        offset_of!(Stand, site.normal.x) / 4,
        offset_of!(Stand, site.normal.y) / 4,
        offset_of!(Stand, site.normal.z) / 4,
    ];
    const _: () = assert!(size_of::<Stand>() == 4 << LINE);

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,bmi1,bmi2")]
    fn dot(a: [__m512; 3], b: [__m512; 3]) -> __m512 {
        let xy = _mm512_add_ps(_mm512_mul_ps(a[0], b[0]), _mm512_mul_ps(a[1], b[1]));
        _mm512_add_ps(xy, _mm512_mul_ps(a[2], b[2]))
    }

    /// [`weight_of`](super::weight_of), operation by operation.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,bmi1,bmi2")]
    fn weights(
        falloff: Falloff,
        cosine: __m512,
        height: __m512,
        distance2: __m512,
        per_d_max: f32,
    ) -> __m512 {
        let set = |x: f32| _mm512_set1_ps(x);
        let (one, zero) = (set(1.0), _mm512_setzero_ps());
        let a = _mm512_min_ps(_mm512_abs_ps(cosine), one);
        let root = _mm512_sqrt_ps(_mm512_sub_ps(one, a));
        let p = _mm512_sub_ps(set(0.074_261), _mm512_mul_ps(a, set(0.018_729_3)));
        let p = _mm512_add_ps(set(-0.212_114_4), _mm512_mul_ps(a, p));
        let p = _mm512_add_ps(set(1.570_728_8), _mm512_mul_ps(a, p));
        let angle = _mm512_mul_ps(root, p);
        let behind = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(cosine, zero);
        let angle = _mm512_mask_sub_ps(angle, behind, set(std::f32::consts::PI), angle);
        let angular = _mm512_sub_ps(one, _mm512_mul_ps(angle, set(std::f32::consts::FRAC_1_PI)));
        let distance = _mm512_sqrt_ps(distance2);
        let x = _mm512_mul_ps(distance, set(per_d_max));
        let q = _mm512_add_ps(one, _mm512_mul_ps(set(5.0), x));
        let spatial = match falloff {
            Falloff::Printed => _mm512_sub_ps(q, x),
            Falloff::ToZero => {
                let within = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(x, one);
                _mm512_maskz_sub_ps(within, one, x)
            }
        };
        let apart = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(distance, zero);
        let length = _mm512_mask_blend_ps(apart, one, distance);
        let per_both = _mm512_div_ps(one, _mm512_mul_ps(q, length));
        let along = _mm512_mul_ps(_mm512_abs_ps(height), _mm512_mul_ps(per_both, q));
        let sine = _mm512_sub_ps(one, along);
        let sine = _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(sine, zero), sine);
        let spatial = _mm512_mul_ps(spatial, _mm512_mul_ps(per_both, length));
        _mm512_mul_ps(_mm512_mul_ps(angular, spatial), _mm512_sqrt_ps(sine))
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,bmi1,bmi2")]
    fn weigh(
        candidates: &Candidates,
        stands: &[Stand],
        falloff: Falloff,
        position: Vec3,
        normal: Vec3,
    ) -> __m512i {
        // SAFETY: sixteen numbers of two bytes.
        let ids = unsafe { _mm256_loadu_si256(candidates.ids.as_ptr().cast()) };
        let present = _mm256_cmpneq_epi16_mask(ids, _mm256_set1_epi16(NOBODY_16.cast_signed()));
        let last = _mm512_set1_epi32(stands.len() as i32 - 1);
        let ids = _mm512_min_epi32(_mm512_cvtepu16_epi32(ids), last);
        let at = _mm512_slli_epi32::<LINE>(ids);
        let base: *const f32 = stands.as_ptr().cast();
        // SAFETY: parts of stands, of which the last is the last.
        let take = |part: usize| unsafe { _mm512_i32gather_ps::<4>(at, base.add(part)) };
        let normals = NORMAL.map(take);
        let positions = POSITION.map(take);
        let here = normal.to_array().map(|x| _mm512_set1_ps(x));
        let offset: [__m512; 3] = [
            _mm512_sub_ps(positions[0], _mm512_set1_ps(position.x)),
            _mm512_sub_ps(positions[1], _mm512_set1_ps(position.y)),
            _mm512_sub_ps(positions[2], _mm512_set1_ps(position.z)),
        ];
        let cosine = dot(here, normals);
        let distance2 = dot(offset, offset);
        let height = dot(here, offset);
        let weights = weights(
            falloff,
            cosine,
            height,
            distance2,
            super::per_d_max(candidates),
        );
        let zero = _mm512_setzero_ps();
        let aside = present & _mm512_cmp_ps_mask::<_CMP_GT_OQ>(cosine, zero);
        let infinity = _mm512_set1_ps(f32::INFINITY);
        let apart = _mm512_mask_blend_ps(aside, infinity, distance2);
        let mut nearer = _mm512_setzero_si512();
        let one = _mm512_set1_epi32(1);
        for k in 0..RANKED as i32 {
            let other = _mm512_permutexvar_ps(_mm512_set1_epi32(k), apart);
            let is_nearer = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(other, apart);
            nearer = _mm512_mask_add_epi32(nearer, is_nearer, nearer, one);
        }
        let counts = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(apart, infinity)
            & _mm512_cmplt_epu32_mask(nearer, _mm512_set1_epi32(COMPARED as i32))
            & _mm512_cmp_ps_mask::<_CMP_GT_OQ>(weights, zero);
        let ranks = _mm512_set_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
        let bits = _mm512_and_si512(_mm512_castps_si512(weights), _mm512_set1_epi32(!15));
        _mm512_maskz_or_epi32(counts, bits, ranks)
    }

    /// Of the keys, six at most are not 0.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,bmi1,bmi2")]
    fn largest(keys: &Keys) -> [u32; 3] {
        // SAFETY: sixteen numbers of four bytes.
        let keys = unsafe { _mm512_loadu_si512(keys.as_ptr().cast()) };
        let some = _mm512_test_epi32_mask(keys, keys);
        let mut rest = _mm512_castsi512_si256(_mm512_maskz_compress_epi32(some, keys));
        let mut best = [0; 3];
        for best in &mut best {
            let half = _mm256_extracti128_si256::<1>(rest);
            let most = _mm_max_epu32(_mm256_castsi256_si128(rest), half);
            let most = _mm_max_epu32(most, _mm_shuffle_epi32::<0b01_00_11_10>(most));
            let most = _mm_max_epu32(most, _mm_shuffle_epi32::<0b10_11_00_01>(most));
            *best = _mm_cvtsi128_si32(most).cast_unsigned();
            let others = _mm256_cmpneq_epi32_mask(rest, _mm256_broadcastd_epi32(most));
            rest = _mm256_maskz_mov_epi32(others, rest);
        }
        best
    }

    /// One loop after the other, so that places do not wait for each other.
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,bmi1,bmi2")]
    pub(super) fn best_of_all(
        candidates: &[Candidates],
        stands: &[Stand],
        falloff: Falloff,
        places: &[(Vec3, Vec3)],
        found: &mut [Nearby],
    ) {
        let mut keys = [[0; RANKED]; TOGETHER];
        for ((candidates, &(position, normal)), keys) in
            candidates.iter().zip(places).zip(&mut keys)
        {
            let weighed = weigh(candidates, stands, falloff, position, normal);
            // SAFETY: sixteen numbers of four bytes.
            unsafe { _mm512_storeu_si512(keys.as_mut_ptr().cast(), weighed) };
        }
        for ((candidates, keys), found) in candidates.iter().zip(&keys).zip(found) {
            *found = super::named(candidates, largest(keys));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::cache::Random;
    use crate::records::map::Site;

    /// All machines say the same, and what a search through all says.
    #[test]
    fn machines_agree_on_the_best_three() {
        let mut random = Random(11);
        let mut vector = || Vec3::from_array(std::array::from_fn(|_| random.unit() - 0.5));
        let stands: Vec<Stand> = (0..40)
            .map(|_| {
                let (position, normal) = (vector(), vector().normalize());
                Stand::new(Site {
                    position,
                    normal,
                    origin: position,
                })
            })
            .collect();
        let mut random = Random(12);
        let candidates: Vec<Candidates> = (0..3 * TOGETHER)
            .map(|k| {
                let mut ids: Vec<u16> = (0..40).collect();
                ids.sort_by_cached_key(|_| random.next());
                let mut ids: [u16; RANKED] = std::array::from_fn(|k| ids[k]);
                ids[RANKED - k % RANKED..].fill(NOBODY_16);
                let d_max = if k % 9 == 0 { 0.0 } else { random.unit() + 0.3 };
                Candidates { ids, d_max }
            })
            .collect();
        let mut places: Vec<(Vec3, Vec3)> = (0..candidates.len())
            .map(|_| (vector(), vector().normalize()))
            .collect();
        // In place of a record, and damaged.
        for k in 0..20 {
            let site = stands[usize::from(candidates[k].ids[0])].site;
            places[k] = (site.position, site.normal);
        }
        places[30].0.x = f32::NAN;
        places[31].0.y = f32::INFINITY;
        places[32].1.z = f32::NAN;
        for falloff in [Falloff::Printed, Falloff::ToZero] {
            let by = |machine: Machine| {
                let mut found = vec![Nearby::NOBODY; places.len()];
                for (k, found) in found.chunks_mut(TOGETHER).enumerate() {
                    let part = k * TOGETHER..k * TOGETHER + found.len();
                    let (candidates, places) = (&candidates[part.clone()], &places[part]);
                    best_of_all(machine, candidates, &stands, falloff, places, found);
                }
                found
            };
            let machines = Machine::all();
            let plain = by(machines[0]);
            for &machine in &machines[1..] {
                assert_eq!(by(machine), plain, "{machine:?}");
            }
            let mut three = 0;
            for (k, found) in plain.iter().enumerate() {
                let (position, normal) = places[k];
                if !position.is_finite() || !normal.is_finite() {
                    continue;
                }
                let ids = candidates[k].ids.iter().filter(|&&id| id != NOBODY_16);
                let mut aside: Vec<(f32, u16)> = ids
                    .map(|&id| {
                        let site = &stands[usize::from(id)].site;
                        (site.position.distance_squared(position), id)
                    })
                    .filter(|(_, id)| stands[usize::from(*id)].site.normal.dot(normal) > 0.0)
                    .collect();
                aside.sort_by(|a, b| a.0.total_cmp(&b.0));
                aside.truncate(COMPARED as usize);
                let mut weighed: Vec<(f32, u16)> = aside
                    .iter()
                    .map(|&(distance2, id)| {
                        let site = &stands[usize::from(id)].site;
                        let height = normal.dot(site.position - position);
                        let per_d_max = per_d_max(&candidates[k]);
                        let cosine = normal.dot(site.normal);
                        (weight_of(falloff, cosine, height, distance2, per_d_max), id)
                    })
                    .filter(|(weight, _)| *weight > 0.0)
                    .collect();
                weighed.sort_by(|a, b| b.0.total_cmp(&a.0));
                weighed.truncate(3);
                three += usize::from(weighed.len() == 3);
                let sum: f32 = weighed.iter().map(|(weight, _)| weight).sum();
                for (j, &(weight, id)) in weighed.iter().enumerate() {
                    assert_eq!(found.ids[j], u32::from(id), "{k}: {found:?} {weighed:?}");
                    assert!((found.weights[j] - weight / sum).abs() < 1e-5);
                }
                assert!(found.ids[weighed.len()..].iter().all(|&id| id == NOBODY));
            }
            assert!(three > 50, "{three}");
        }
    }
}
