//! AVX2 and FMA: a node in six fused multiply-adds, a block in one pass.

use super::{Edges, Found, Isa, Lanes, Query, Reciprocal, Scope, Slabs, entry_points, portable};
use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Block, Child, LANES, Node, Tree, WIDTH};
use occlude_visibility::{Hit, Ray};
use std::arch::x86_64::*;

pub(crate) struct Avx2;

impl Isa for Avx2 {
    type Slabs = Avx2Slabs;
    type Thin = ThinEdges;
    type Tight = TightEdges;

    #[inline(always)]
    unsafe fn prefetch(tree: &Tree, child: Child) {
        let node = tree.nodes.as_ptr().wrapping_add(child.index()).cast::<i8>();
        let block = tree
            .blocks
            .as_ptr()
            .wrapping_add(child.index())
            .cast::<i8>();
        let start = std::hint::select_unpredictable(child.is_leaf(), block, node);
        for line in 0..4 {
            // SAFETY: a prefetch touches no memory that the program could observe, whatever the address.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(64 * line)) };
        }
    }

    entry_points!("avx2,fma,bmi1,bmi2,lzcnt,popcnt");
}

/// Offsets of the entering planes from the node's start, in floats; the leaving planes are 8 further or nearer.
#[inline(always)]
fn entering(negative: [bool; 3]) -> [usize; 3] {
    let offset = |axis: usize| 2 * WIDTH * axis + WIDTH * usize::from(negative[axis]);
    [offset(0), offset(1), offset(2)]
}

/// Eight planes at an offset from [`entering`].
#[inline(always)]
unsafe fn planes(node: &Node, offset: usize) -> __m256 {
    // SAFETY: offsets are multiples of 8 below 48, so that the load stays in the node's planes and is aligned.
    unsafe { _mm256_load_ps((&raw const node.planes).cast::<f32>().add(offset)) }
}

/// `(origin - plane) * -reciprocal`: on this side so that the plane can be an operand in memory.
pub(crate) struct Avx2Slabs {
    origin: [__m256; 3],
    near_scale: [__m256; 3],
    far_scale: [__m256; 3],
    t_min: __m256,
    entering: [usize; 3],
}

impl Slabs for Avx2Slabs {
    type Near = __m256;

    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        let reciprocal = Reciprocal::new(ray);
        // SAFETY: the processor has AVX2, as promised by the caller.
        let splat = |x: [f32; 3]| unsafe {
            [
                _mm256_set1_ps(x[0]),
                _mm256_set1_ps(x[1]),
                _mm256_set1_ps(x[2]),
            ]
        };
        Self {
            origin: splat(ray.origin.to_array()),
            near_scale: splat([
                -reciprocal.near[0],
                -reciprocal.near[1],
                -reciprocal.near[2],
            ]),
            far_scale: splat([-reciprocal.far[0], -reciprocal.far[1], -reciprocal.far[2]]),
            // SAFETY: as above.
            t_min: unsafe { _mm256_set1_ps(reciprocal.t_min) },
            entering: entering(reciprocal.negative),
        }
    }

    #[inline(always)]
    unsafe fn test(&self, node: &Node, t_max: f32) -> (u32, __m256) {
        // SAFETY: the processor has AVX2, as promised by the caller.
        unsafe {
            // Which child is next is known only after the test: its line must not be asked for as late as that.
            _mm_prefetch::<_MM_HINT_T0>(node.children.as_ptr().cast());
            let near = |axis: usize| {
                let planes = planes(node, self.entering[axis]);
                _mm256_mul_ps(
                    _mm256_sub_ps(self.origin[axis], planes),
                    self.near_scale[axis],
                )
            };
            let far = |axis: usize| {
                let planes = planes(node, self.entering[axis] ^ WIDTH);
                _mm256_mul_ps(
                    _mm256_sub_ps(self.origin[axis], planes),
                    self.far_scale[axis],
                )
            };
            // Of a NaN and a number these take the second operand: unknown distances drop out.
            let enter = _mm256_max_ps(
                near(0),
                _mm256_max_ps(near(1), _mm256_max_ps(near(2), self.t_min)),
            );
            let end = _mm256_set1_ps(t_max);
            let leave = _mm256_min_ps(far(0), _mm256_min_ps(far(1), _mm256_min_ps(far(2), end)));
            let met = _mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave);
            (_mm256_movemask_ps(met) as u32, enter)
        }
    }

    #[inline(always)]
    unsafe fn distances(near: __m256) -> [f32; WIDTH] {
        let mut distances = [0.0; WIDTH];
        // SAFETY: the array has eight floats.
        unsafe { _mm256_storeu_ps(distances.as_mut_ptr(), near) };
        distances
    }

    #[inline(always)]
    unsafe fn lower(nearest: &mut [f32; WIDTH], near: __m256, mask: u32) {
        // SAFETY: the processor has AVX2, as promised by the caller; the array has eight floats.
        unsafe {
            let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let mask = _mm256_and_si256(_mm256_set1_epi32(mask.cast_signed()), lanes);
            let met = _mm256_castsi256_ps(_mm256_cmpeq_epi32(mask, lanes));
            let before = _mm256_loadu_ps(nearest.as_ptr());
            let lower = _mm256_blendv_ps(before, _mm256_min_ps(before, near), met);
            _mm256_storeu_ps(nearest.as_mut_ptr(), lower);
        }
    }
}

#[derive(Clone, Copy)]
struct V3([__m128; 3]);

impl V3 {
    #[inline(always)]
    unsafe fn splat(v: glam::Vec3) -> Self {
        // SAFETY: the processor has AVX2, as promised by the caller.
        Self(unsafe { [_mm_set1_ps(v.x), _mm_set1_ps(v.y), _mm_set1_ps(v.z)] })
    }
    #[inline(always)]
    unsafe fn load(corner: &[[f32; LANES]; 3]) -> Self {
        // SAFETY: each row has four floats.
        Self(unsafe {
            [
                _mm_loadu_ps(corner[0].as_ptr()),
                _mm_loadu_ps(corner[1].as_ptr()),
                _mm_loadu_ps(corner[2].as_ptr()),
            ]
        })
    }
    #[inline(always)]
    unsafe fn minus(self, o: Self) -> Self {
        // SAFETY: the processor has AVX2, as promised by the caller.
        Self(unsafe {
            [
                _mm_sub_ps(self.0[0], o.0[0]),
                _mm_sub_ps(self.0[1], o.0[1]),
                _mm_sub_ps(self.0[2], o.0[2]),
            ]
        })
    }
    #[inline(always)]
    unsafe fn cross(self, o: Self) -> Self {
        let row = |i: usize, j: usize| {
            // SAFETY: the processor has FMA, as promised by the caller.
            unsafe { _mm_fmsub_ps(self.0[i], o.0[j], _mm_mul_ps(self.0[j], o.0[i])) }
        };
        Self([row(1, 2), row(2, 0), row(0, 1)])
    }
    #[inline(always)]
    unsafe fn dot(self, o: Self) -> __m128 {
        // SAFETY: the processor has FMA, as promised by the caller.
        unsafe {
            let xy = _mm_fmadd_ps(self.0[1], o.0[1], _mm_mul_ps(self.0[0], o.0[0]));
            _mm_fmadd_ps(self.0[2], o.0[2], xy)
        }
    }
}

/// Fills the lanes that pass.
#[inline(always)]
unsafe fn lanes(
    inside: __m128,
    t: __m128,
    u: __m128,
    v: __m128,
    det: __m128,
    t_min: __m128,
    t_max: f32,
) -> Lanes {
    let mut lanes = NO_LANES;
    // SAFETY: the processor has AVX2, as promised by the caller; the arrays have four floats.
    unsafe {
        let t = _mm_div_ps(t, det);
        let between = _mm_and_ps(_mm_cmpgt_ps(t, t_min), _mm_cmplt_ps(t, _mm_set1_ps(t_max)));
        lanes.mask = _mm_movemask_ps(_mm_and_ps(inside, between)) as u32;
        _mm_storeu_ps(lanes.t.as_mut_ptr(), t);
        _mm_storeu_ps(lanes.u.as_mut_ptr(), _mm_div_ps(u, det));
        _mm_storeu_ps(lanes.v.as_mut_ptr(), _mm_div_ps(v, det));
    }
    lanes
}

const NO_LANES: Lanes = Lanes {
    mask: 0,
    t: [0.0; LANES],
    u: [0.0; LANES],
    v: [0.0; LANES],
};

/// The test of [`portable::ThinEdges`], four lanes at a time.
pub(crate) struct ThinEdges {
    origin: V3,
    direction: V3,
    t_min: __m128,
}

impl Edges<false> for ThinEdges {
    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        // SAFETY: the processor has AVX2, as promised by the caller.
        unsafe {
            Self {
                origin: V3::splat(ray.origin),
                direction: V3::splat(ray.direction),
                t_min: _mm_set1_ps(ray.t_min),
            }
        }
    }

    #[inline(always)]
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes {
        // SAFETY: the processor has AVX2 and FMA, as promised by the caller.
        unsafe {
            let (e1, e2) = (V3::load(&block.corners[1]), V3::load(&block.corners[2]));
            let c = V3::load(&block.corners[0]).minus(self.origin);
            let normal = e2.cross(e1);
            let r = c.cross(self.direction);
            let det = normal.dot(self.direction);
            let minus_zero = _mm_set1_ps(-0.0);
            let sign = _mm_and_ps(det, minus_zero);
            let det_abs = _mm_andnot_ps(minus_zero, det);
            let u = _mm_xor_ps(r.dot(e2), sign);
            let v = _mm_xor_ps(r.dot(e1), sign);
            let w = _mm_sub_ps(_mm_sub_ps(det_abs, u), v);
            let zero = _mm_setzero_ps();
            let inside = _mm_and_ps(
                _mm_and_ps(_mm_cmpge_ps(u, zero), _mm_cmpge_ps(v, zero)),
                _mm_and_ps(_mm_cmpge_ps(w, zero), _mm_cmpgt_ps(det_abs, zero)),
            );
            if _mm_movemask_ps(inside) == 0 {
                return NO_LANES;
            }
            let t = _mm_xor_ps(normal.dot(c), sign);
            lanes(inside, t, u, v, det_abs, self.t_min, t_max)
        }
    }
}

/// The test of [`portable::TightEdges`], four lanes at a time. Edge functions use no fused operations: seen from the
/// triangle on the other side, an edge must have exactly the opposite sign.
pub(crate) struct TightEdges {
    origin: V3,
    axes: [usize; 3],
    shear: V3,
    t_min: __m128,
}

impl Edges<true> for TightEdges {
    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        let (axes, shear) = portable::shear(ray);
        let o = ray.origin.to_array();
        // SAFETY: the processor has AVX2, as promised by the caller.
        unsafe {
            Self {
                origin: V3::splat(glam::Vec3::from_array(axes.map(|a| o[a]))),
                axes,
                shear: V3::splat(glam::Vec3::from_array(shear)),
                t_min: _mm_set1_ps(ray.t_min),
            }
        }
    }

    #[inline(always)]
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes {
        // SAFETY: the processor has AVX2 and FMA, as promised by the caller; `axes` are 0, 1, 2 in some order.
        unsafe {
            let corner = |k: usize| {
                let load = |i: usize| {
                    let row = block.corners[k].get_unchecked(self.axes[i]);
                    _mm_sub_ps(_mm_loadu_ps(row.as_ptr()), self.origin.0[i])
                };
                let z = load(2);
                (
                    _mm_fnmadd_ps(self.shear.0[0], z, load(0)),
                    _mm_fnmadd_ps(self.shear.0[1], z, load(1)),
                    z,
                )
            };
            let ((ax, ay, az), (bx, by, bz), (cx, cy, cz)) = (corner(0), corner(1), corner(2));
            let edge = |px, py, qx, qy| _mm_sub_ps(_mm_mul_ps(px, qy), _mm_mul_ps(py, qx));
            let (u, v, w) = (
                edge(cx, cy, bx, by),
                edge(ax, ay, cx, cy),
                edge(bx, by, ax, ay),
            );
            let zero = _mm_setzero_ps();
            let low = _mm_min_ps(_mm_min_ps(u, v), w);
            let high = _mm_max_ps(_mm_max_ps(u, v), w);
            let det = _mm_add_ps(_mm_add_ps(u, v), w);
            let inside = _mm_and_ps(
                _mm_or_ps(_mm_cmpge_ps(low, zero), _mm_cmple_ps(high, zero)),
                _mm_cmpneq_ps(det, zero),
            );
            if _mm_movemask_ps(inside) == 0 {
                return NO_LANES;
            }
            let t = _mm_fmadd_ps(w, cz, _mm_fmadd_ps(v, bz, _mm_mul_ps(u, az)));
            lanes(
                inside,
                _mm_mul_ps(t, self.shear.0[2]),
                v,
                w,
                det,
                self.t_min,
                t_max,
            )
        }
    }
}
