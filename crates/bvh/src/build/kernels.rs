//! The builder's inner loops, compiled once for AVX2 and once for any processor from the same text.

use super::{EMPTY_HULL, Hull, Ref, half_area, union as portable_union};
use crate::node::LANES;
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

/// Most bins an axis.
pub(super) const BINS: usize = 16;
/// Ranges of at most so many references are swept exactly.
pub(super) const SMALL: usize = 8;

/// A range cut in two.
pub(super) struct Split {
    /// References on the left.
    pub at: usize,
    pub hulls: [Hull; 2],
    /// Hulls of the doubled centres; after a sweep left empty, since a swept range is only swept again.
    pub centres: [Hull; 2],
}

/// How centres are sorted into bins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    lower: [f32; 4],
    /// 0: all centres share this coordinate.
    scale: [f32; 4],
    bins: usize,
}

impl Grid {
    pub fn new(centres: &Hull, count: usize) -> Self {
        let bins = (4 + count / 8).min(BINS);
        let mut scale = [0.0; 4];
        for axis in 0..3 {
            let extent = -(centres[axis + 4] + centres[axis]);
            // A shade under the number of bins, so that rounding keeps the last centre inside.
            let s = bins as f32 * 0.9999 / extent;
            if extent > 0.0 && s.is_finite() {
                scale[axis] = s;
            }
        }
        Self {
            lower: [centres[0], centres[1], centres[2], 0.0],
            scale,
            bins,
        }
    }

    /// The bins of a reference, one an axis.
    #[inline(always)]
    fn bins_of(&self, hull: &Hull) -> [usize; 3] {
        let at: [f32; 4] =
            std::array::from_fn(|k| (hull[k] - hull[k + 4] - self.lower[k]) * self.scale[k]);
        // SAFETY: centres lie inside the hull of centres, so that the products are finite and from 0 up to the number of
        // bins; lane 3 is not converted.
        let index = |k: usize| unsafe { at[k].to_int_unchecked::<i32>() } as usize;
        let last = self.bins - 1;
        [index(0).min(last), index(1).min(last), index(2).min(last)]
    }

    #[inline(always)]
    fn bin_of(&self, hull: &Hull, axis: usize) -> usize {
        let at = (hull[axis] - hull[axis + 4] - self.lower[axis]) * self.scale[axis];
        // SAFETY: as in `bins_of`, with the same arithmetic.
        (unsafe { at.to_int_unchecked::<i32>() } as usize).min(self.bins - 1)
    }
}

/// What fell into each bin.
#[derive(Clone)]
pub(super) struct Bins {
    hulls: [[Hull; BINS]; 3],
    counts: [[u32; BINS]; 3],
}

impl Bins {
    pub const EMPTY: Self = Self {
        hulls: [[EMPTY_HULL; BINS]; 3],
        counts: [[0; BINS]; 3],
    };

    pub fn merge(mut self, other: &Self) -> Self {
        for axis in 0..3 {
            for bin in 0..BINS {
                self.hulls[axis][bin] =
                    portable_union(&self.hulls[axis][bin], &other.hulls[axis][bin]);
                self.counts[axis][bin] += other.counts[axis][bin];
            }
        }
        self
    }
}

/// The best plane between bins.
pub(super) struct Plane {
    pub axis: usize,
    /// First bin on the right.
    pub bin: usize,
    /// Sum of area times blocks.
    pub cost: f32,
    pub hulls: [Hull; 2],
}

/// The hull of twice the centre.
#[inline(always)]
pub(super) fn centre(h: &Hull) -> Hull {
    std::array::from_fn(|k| h[k] - h[(k + 4) % 8])
}

/// Blocks that hold so many triangles.
#[inline(always)]
pub(super) fn blocks(count: usize) -> f32 {
    count.div_ceil(LANES) as f32
}

/// What the inner loops do to single references. Every kind gives the same results.
pub(super) trait Arithmetic {
    fn union(a: &Hull, b: &Hull) -> Hull;
    /// The union, or `a` unless `condition`.
    fn union_if(condition: bool, a: &Hull, b: &Hull) -> Hull;
    fn bins_of(grid: &Grid, hull: &Hull) -> [usize; 3];
    fn centre(hull: &Hull) -> Hull;
}

/// The inner loops for one kind of processor.
///
/// # Safety
/// Every function asks that the processor has the features of the implementor.
pub(super) trait Kernels {
    unsafe fn bin(refs: &[Ref], grid: &Grid, bins: &mut Bins);
    unsafe fn choose(bins: &Bins, grid: &Grid) -> Option<Plane>;
    /// Leaves the left side in front and puts the right side into `scratch`.
    unsafe fn partition(refs: &mut [Ref], scratch: &mut [Ref], grid: &Grid, plane: &Plane)
    -> Split;
    unsafe fn sweep(refs: &mut [Ref]) -> Option<Split>;
}

#[inline(always)]
fn bin<A: Arithmetic>(refs: &[Ref], grid: &Grid, bins: &mut Bins) {
    for r in refs {
        let index = A::bins_of(grid, &r.hull);
        for (axis, bin) in index.into_iter().enumerate() {
            let bin = bin % BINS;
            let hull = &mut bins.hulls[axis][bin];
            *hull = A::union(hull, &r.hull);
            bins.counts[axis][bin] += 1;
        }
    }
}

#[inline(always)]
fn choose<A: Arithmetic>(bins: &Bins, grid: &Grid) -> Option<Plane> {
    let mut best = f32::INFINITY;
    let mut found = None;
    for axis in 0..3 {
        if grid.scale[axis] == 0.0 {
            continue;
        }
        let mut right_cost = [f32::INFINITY; BINS];
        let (mut hull, mut count) = (EMPTY_HULL, 0);
        for bin in (1..grid.bins).rev() {
            hull = A::union(&hull, &bins.hulls[axis][bin]);
            count += bins.counts[axis][bin] as usize;
            if count > 0 {
                right_cost[bin] = half_area(&hull) * blocks(count);
            }
        }
        let (mut hull, mut count) = (EMPTY_HULL, 0);
        for (bin, right_cost) in right_cost.iter().enumerate().take(grid.bins).skip(1) {
            hull = A::union(&hull, &bins.hulls[axis][bin - 1]);
            count += bins.counts[axis][bin - 1] as usize;
            if count > 0 {
                let cost = half_area(&hull) * blocks(count) + right_cost;
                if cost < best {
                    best = cost;
                    found = Some((axis, bin));
                }
            }
        }
    }
    found.map(|(axis, bin)| {
        let side = |range: std::ops::Range<usize>| {
            bins.hulls[axis][range]
                .iter()
                .fold(EMPTY_HULL, |a, b| portable_union(&a, b))
        };
        Plane {
            axis,
            bin,
            cost: best,
            hulls: [side(0..bin), side(bin..grid.bins)],
        }
    })
}

#[inline(always)]
fn partition<A: Arithmetic>(
    refs: &mut [Ref],
    scratch: &mut [Ref],
    grid: &Grid,
    plane: &Plane,
) -> Split {
    let mut centres = [EMPTY_HULL; 2];
    let (mut left, mut right) = (0, 0);
    let [left_centres, right_centres] = &mut centres;
    for i in 0..refs.len() {
        let r = refs[i];
        let goes_right = grid.bin_of(&r.hull, plane.axis) >= plane.bin;
        // Both places are written and one of them kept: no branch to mispredict.
        refs[left] = r;
        scratch[right] = r;
        left += usize::from(!goes_right);
        right += usize::from(goes_right);
        let c = A::centre(&r.hull);
        *left_centres = A::union_if(!goes_right, left_centres, &c);
        *right_centres = A::union_if(goes_right, right_centres, &c);
    }
    debug_assert_eq!(left + right, refs.len());
    Split {
        at: left,
        hulls: plane.hulls,
        centres,
    }
}

/// All splits along all axes of at most [`SMALL`] references; leaves them in the order of the best axis.
#[inline(always)]
fn sweep<A: Arithmetic>(refs: &mut [Ref]) -> Option<Split> {
    let n = refs.len();
    debug_assert!((2..=SMALL).contains(&n));
    if let [left, right] = refs {
        // There is one way only.
        return Some(Split {
            at: 1,
            hulls: [left.hull, right.hull],
            centres: [EMPTY_HULL; 2],
        });
    }
    let mut best = f32::INFINITY;
    let mut found = None;
    for axis in 0..3 {
        let mut keys = [f32::INFINITY; SMALL];
        for (key, r) in keys.iter_mut().zip(refs.iter()) {
            *key = r.hull[axis] - r.hull[axis + 4];
        }
        // Sorting by counting what comes before: nothing to mispredict.
        let mut before = [0u32; SMALL];
        for i in 0..SMALL {
            for j in 0..SMALL {
                let precedes = if i < j {
                    keys[i] <= keys[j]
                } else {
                    keys[i] < keys[j]
                };
                before[j] += u32::from(precedes);
            }
        }
        let mut order = [0u8; SMALL];
        for (i, before) in before.into_iter().enumerate() {
            order[before as usize % SMALL] = i as u8;
        }
        let mut right = [EMPTY_HULL; SMALL + 1];
        for i in (1..n).rev() {
            right[i] = A::union(&right[i + 1], &refs[order[i] as usize].hull);
        }
        let mut left = EMPTY_HULL;
        for i in 1..n {
            left = A::union(&left, &refs[order[i - 1] as usize].hull);
            let cost = half_area(&left) * blocks(i) + half_area(&right[i]) * blocks(n - i);
            if cost < best {
                best = cost;
                found = Some((order, i, [left, right[i]]));
            }
        }
    }
    let (order, at, hulls) = found?;
    let mut sorted = [refs[0]; SMALL];
    for i in 0..n {
        sorted[i] = refs[order[i] as usize];
    }
    refs.copy_from_slice(&sorted[..n]);
    Some(Split {
        at,
        hulls,
        centres: [EMPTY_HULL; 2],
    })
}

/// For any processor.
pub(super) struct Portable;

impl Arithmetic for Portable {
    #[inline(always)]
    fn union(a: &Hull, b: &Hull) -> Hull {
        portable_union(a, b)
    }
    #[inline(always)]
    fn union_if(condition: bool, a: &Hull, b: &Hull) -> Hull {
        portable_union(a, if condition { b } else { &EMPTY_HULL })
    }
    #[inline(always)]
    fn bins_of(grid: &Grid, hull: &Hull) -> [usize; 3] {
        grid.bins_of(hull)
    }
    #[inline(always)]
    fn centre(hull: &Hull) -> Hull {
        centre(hull)
    }
}

impl Kernels for Portable {
    unsafe fn bin(refs: &[Ref], grid: &Grid, bins: &mut Bins) {
        bin::<Self>(refs, grid, bins)
    }
    unsafe fn choose(bins: &Bins, grid: &Grid) -> Option<Plane> {
        choose::<Self>(bins, grid)
    }
    unsafe fn partition(
        refs: &mut [Ref],
        scratch: &mut [Ref],
        grid: &Grid,
        plane: &Plane,
    ) -> Split {
        partition::<Self>(refs, scratch, grid, plane)
    }
    unsafe fn sweep(refs: &mut [Ref]) -> Option<Split> {
        sweep::<Self>(refs)
    }
}

/// For processors with AVX2. No fused arithmetic: both kinds build the same tree.
#[cfg(target_arch = "x86_64")]
pub(super) struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Avx2 {
    #[inline(always)]
    fn load(hull: &Hull) -> __m256 {
        // SAFETY: a hull has eight floats; only the kernels below come here, and those have AVX2.
        unsafe { _mm256_loadu_ps(hull.as_ptr()) }
    }
    #[inline(always)]
    fn store(v: __m256) -> Hull {
        let mut hull = [0.0; 8];
        // SAFETY: as above.
        unsafe { _mm256_storeu_ps(hull.as_mut_ptr(), v) };
        hull
    }
}

// Written out, since the compiler turns the portable text into masked stores, which are slow.
#[cfg(target_arch = "x86_64")]
impl Arithmetic for Avx2 {
    #[inline(always)]
    fn union(a: &Hull, b: &Hull) -> Hull {
        // SAFETY: only the kernels below come here, and those have AVX2.
        Self::store(unsafe { _mm256_min_ps(Self::load(a), Self::load(b)) })
    }
    #[inline(always)]
    fn union_if(condition: bool, a: &Hull, b: &Hull) -> Hull {
        // SAFETY: as above.
        unsafe {
            let keep = _mm256_castsi256_ps(_mm256_set1_epi32(-i32::from(condition)));
            let infinity = _mm256_set1_ps(f32::INFINITY);
            let b = _mm256_blendv_ps(infinity, Self::load(b), keep);
            Self::store(_mm256_min_ps(Self::load(a), b))
        }
    }
    #[inline(always)]
    fn bins_of(grid: &Grid, hull: &Hull) -> [usize; 3] {
        // SAFETY: as above; hull and grid have the floats that are loaded.
        unsafe {
            let (low, high) = (
                _mm_loadu_ps(hull.as_ptr()),
                _mm_loadu_ps(hull.as_ptr().add(4)),
            );
            let from_lower = _mm_sub_ps(_mm_sub_ps(low, high), _mm_loadu_ps(grid.lower.as_ptr()));
            let at = _mm_cvttps_epi32(_mm_mul_ps(from_lower, _mm_loadu_ps(grid.scale.as_ptr())));
            let at = _mm_min_epi32(at, _mm_set1_epi32(grid.bins as i32 - 1));
            [
                _mm_extract_epi32::<0>(at) as usize,
                _mm_extract_epi32::<1>(at) as usize,
                _mm_extract_epi32::<2>(at) as usize,
            ]
        }
    }
    #[inline(always)]
    fn centre(hull: &Hull) -> Hull {
        let v = Self::load(hull);
        // SAFETY: as above.
        Self::store(unsafe { _mm256_sub_ps(v, _mm256_permute2f128_ps::<1>(v, v)) })
    }
}

#[cfg(target_arch = "x86_64")]
impl Kernels for Avx2 {
    #[target_feature(enable = "avx2")]
    unsafe fn bin(refs: &[Ref], grid: &Grid, bins: &mut Bins) {
        bin::<Self>(refs, grid, bins)
    }
    #[target_feature(enable = "avx2")]
    unsafe fn choose(bins: &Bins, grid: &Grid) -> Option<Plane> {
        choose::<Self>(bins, grid)
    }
    #[target_feature(enable = "avx2")]
    unsafe fn partition(
        refs: &mut [Ref],
        scratch: &mut [Ref],
        grid: &Grid,
        plane: &Plane,
    ) -> Split {
        partition::<Self>(refs, scratch, grid, plane)
    }
    #[target_feature(enable = "avx2")]
    unsafe fn sweep(refs: &mut [Ref]) -> Option<Split> {
        sweep::<Self>(refs)
    }
}
