//! NEON of aarch64: a node in two halves of four boxes, a block in one pass. Rounds where AVX2 with FMA
//! rounds. Tested under an emulator only, never timed.

use super::{Edges, Found, Isa, Lanes, Query, Reciprocal, Scope, Slabs, entry_points, portable};
use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Block, Child, LANES, Node, Tree, WIDTH};
use occlude_visibility::{Hit, Ray};
use std::arch::aarch64::*;

pub(crate) struct Neon;

impl Isa for Neon {
    type Slabs = NeonSlabs;
    type Thin = ThinEdges;
    type Tight = TightEdges;

    // Stable Rust has no intrinsic for it.
    unsafe fn prefetch(_: &Tree, _: Child) {}

    entry_points!("neon");
}

/// Eight lanes that are all ones or all zero, as bits.
#[inline(always)]
unsafe fn bits(lanes: [uint32x4_t; 2]) -> u32 {
    // SAFETY: the processor has NEON, as promised by the caller; the arrays have four integers.
    unsafe {
        vaddvq_u32(vorrq_u32(
            vandq_u32(lanes[0], vld1q_u32([1, 2, 4, 8].as_ptr())),
            vandq_u32(lanes[1], vld1q_u32([16, 32, 64, 128].as_ptr())),
        ))
    }
}

/// Each half of a node shares the ray's lanes.
pub(crate) struct NeonSlabs {
    origin: [float32x4_t; 3],
    near_scale: [float32x4_t; 3],
    far_scale: [float32x4_t; 3],
    t_min: float32x4_t,
    /// Per axis 0 or 1, the side to enter by.
    entering: [usize; 3],
}

impl Slabs for NeonSlabs {
    type Near = [float32x4_t; 2];

    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        let reciprocal = Reciprocal::new(ray);
        // SAFETY: the processor has NEON, as promised by the caller.
        unsafe {
            Self {
                origin: ray.origin.to_array().map(|x| vdupq_n_f32(x)),
                near_scale: reciprocal.near.map(|x| vdupq_n_f32(x)),
                far_scale: reciprocal.far.map(|x| vdupq_n_f32(x)),
                t_min: vdupq_n_f32(reciprocal.t_min),
                entering: reciprocal.negative.map(usize::from),
            }
        }
    }

    #[inline(always)]
    unsafe fn test(&self, node: &Node, t_max: f32) -> (u32, [float32x4_t; 2]) {
        // SAFETY: the processor has NEON, as promised by the caller; sides are 0 or 1, and eight floats a side have two
        // halves.
        unsafe {
            let half = |half: usize| {
                let distance = |axis: usize, side: usize, scale: float32x4_t| {
                    let planes = node.planes[axis].get_unchecked(side).as_ptr();
                    let planes = vld1q_f32(planes.add(LANES * half));
                    vmulq_f32(vsubq_f32(planes, self.origin[axis]), scale)
                };
                let near = |axis| distance(axis, self.entering[axis], self.near_scale[axis]);
                let far = |axis| distance(axis, self.entering[axis] ^ 1, self.far_scale[axis]);
                // Of a NaN and a number these take the number: unknown distances drop out.
                let enter = vmaxnmq_f32(
                    vmaxnmq_f32(near(0), near(1)),
                    vmaxnmq_f32(near(2), self.t_min),
                );
                let end = vdupq_n_f32(t_max);
                let leave = vminnmq_f32(vminnmq_f32(far(0), far(1)), vminnmq_f32(far(2), end));
                (enter, vcleq_f32(enter, leave))
            };
            let ((enter0, met0), (enter1, met1)) = (half(0), half(1));
            (bits([met0, met1]), [enter0, enter1])
        }
    }

    #[inline(always)]
    unsafe fn distances(near: [float32x4_t; 2]) -> [f32; WIDTH] {
        let mut distances = [0.0; WIDTH];
        // SAFETY: the array has eight floats.
        unsafe {
            vst1q_f32(distances.as_mut_ptr(), near[0]);
            vst1q_f32(distances.as_mut_ptr().add(LANES), near[1]);
        }
        distances
    }
}

#[derive(Clone, Copy)]
struct V3([float32x4_t; 3]);

impl V3 {
    #[inline(always)]
    unsafe fn splat(v: [f32; 3]) -> Self {
        // SAFETY: the processor has NEON, as promised by the caller.
        Self(v.map(|x| unsafe { vdupq_n_f32(x) }))
    }
    #[inline(always)]
    unsafe fn load(corner: &[[f32; LANES]; 3]) -> Self {
        // SAFETY: each row has four floats.
        Self([0, 1, 2].map(|axis| unsafe { vld1q_f32(corner[axis].as_ptr()) }))
    }
    #[inline(always)]
    unsafe fn minus(self, o: Self) -> Self {
        // SAFETY: the processor has NEON, as promised by the caller.
        Self([0, 1, 2].map(|i| unsafe { vsubq_f32(self.0[i], o.0[i]) }))
    }
    #[inline(always)]
    unsafe fn cross(self, o: Self) -> Self {
        let row = |i: usize, j: usize| {
            // SAFETY: the processor has NEON, as promised by the caller.
            unsafe { vfmsq_f32(vmulq_f32(self.0[i], o.0[j]), self.0[j], o.0[i]) }
        };
        Self([row(1, 2), row(2, 0), row(0, 1)])
    }
    #[inline(always)]
    unsafe fn dot(self, o: Self) -> float32x4_t {
        // SAFETY: the processor has NEON, as promised by the caller.
        unsafe {
            let xy = vfmaq_f32(vmulq_f32(self.0[0], o.0[0]), self.0[1], o.0[1]);
            vfmaq_f32(xy, self.0[2], o.0[2])
        }
    }
}

const NO_LANES: Lanes = Lanes {
    mask: 0,
    t: [0.0; LANES],
    u: [0.0; LANES],
    v: [0.0; LANES],
};

/// Fills the lanes that pass.
#[inline(always)]
unsafe fn lanes(
    inside: uint32x4_t,
    t: float32x4_t,
    u: float32x4_t,
    v: float32x4_t,
    det: float32x4_t,
    t_min: float32x4_t,
    t_max: f32,
) -> Lanes {
    let mut lanes = NO_LANES;
    // SAFETY: the processor has NEON, as promised by the caller; the arrays have four floats.
    unsafe {
        let t = vdivq_f32(t, det);
        let between = vandq_u32(vcgtq_f32(t, t_min), vcltq_f32(t, vdupq_n_f32(t_max)));
        lanes.mask = bits([vandq_u32(inside, between), vdupq_n_u32(0)]);
        vst1q_f32(lanes.t.as_mut_ptr(), t);
        vst1q_f32(lanes.u.as_mut_ptr(), vdivq_f32(u, det));
        vst1q_f32(lanes.v.as_mut_ptr(), vdivq_f32(v, det));
    }
    lanes
}

/// The test of [`portable::ThinEdges`], four lanes at a time.
pub(crate) struct ThinEdges {
    origin: V3,
    direction: V3,
    t_min: float32x4_t,
}

impl Edges<false> for ThinEdges {
    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        // SAFETY: the processor has NEON, as promised by the caller.
        unsafe {
            Self {
                origin: V3::splat(ray.origin.to_array()),
                direction: V3::splat(ray.direction.to_array()),
                t_min: vdupq_n_f32(ray.t_min),
            }
        }
    }

    #[inline(always)]
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes {
        // SAFETY: the processor has NEON, as promised by the caller.
        unsafe {
            let (e1, e2) = (V3::load(&block.corners[1]), V3::load(&block.corners[2]));
            let c = V3::load(&block.corners[0]).minus(self.origin);
            // Both the other way round than elsewhere, where the fused operation subtracts from the exact product. The
            // signs cancel, and all is rounded as with AVX2.
            let normal = e1.cross(e2);
            let r = self.direction.cross(c);
            let det = normal.dot(self.direction);
            let sign = vandq_u32(vreinterpretq_u32_f32(det), vdupq_n_u32(1 << 31));
            let signed = |x| vreinterpretq_f32_u32(veorq_u32(vreinterpretq_u32_f32(x), sign));
            let det_abs = vabsq_f32(det);
            let u = signed(r.dot(e2));
            let v = signed(r.dot(e1));
            let w = vsubq_f32(vsubq_f32(det_abs, u), v);
            let inside = vandq_u32(
                vandq_u32(vcgezq_f32(u), vcgezq_f32(v)),
                vandq_u32(vcgezq_f32(w), vcgtzq_f32(det_abs)),
            );
            if vmaxvq_u32(inside) == 0 {
                return NO_LANES;
            }
            lanes(
                inside,
                signed(normal.dot(c)),
                u,
                v,
                det_abs,
                self.t_min,
                t_max,
            )
        }
    }
}

/// The test of [`portable::TightEdges`], four lanes at a time. Edge functions use no fused operations: seen from the
/// triangle on the other side, an edge must have exactly the opposite sign.
pub(crate) struct TightEdges {
    origin: V3,
    axes: [usize; 3],
    shear: V3,
    t_min: float32x4_t,
}

impl Edges<true> for TightEdges {
    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        let (axes, shear) = portable::shear(ray);
        let o = ray.origin.to_array();
        // SAFETY: the processor has NEON, as promised by the caller.
        unsafe {
            Self {
                origin: V3::splat(axes.map(|a| o[a])),
                axes,
                shear: V3::splat(shear),
                t_min: vdupq_n_f32(ray.t_min),
            }
        }
    }

    #[inline(always)]
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes {
        // SAFETY: the processor has NEON, as promised by the caller; `axes` are 0, 1, 2 in some order.
        unsafe {
            let corner = |k: usize| {
                let load = |i: usize| {
                    let row = block.corners[k].get_unchecked(self.axes[i]);
                    vsubq_f32(vld1q_f32(row.as_ptr()), self.origin.0[i])
                };
                let z = load(2);
                (
                    vfmsq_f32(load(0), self.shear.0[0], z),
                    vfmsq_f32(load(1), self.shear.0[1], z),
                    z,
                )
            };
            let ((ax, ay, az), (bx, by, bz), (cx, cy, cz)) = (corner(0), corner(1), corner(2));
            let edge = |px, py, qx, qy| vsubq_f32(vmulq_f32(px, qy), vmulq_f32(py, qx));
            let (u, v, w) = (
                edge(cx, cy, bx, by),
                edge(ax, ay, cx, cy),
                edge(bx, by, ax, ay),
            );
            let low = vminq_f32(vminq_f32(u, v), w);
            let high = vmaxq_f32(vmaxq_f32(u, v), w);
            let det = vaddq_f32(vaddq_f32(u, v), w);
            let inside = vbicq_u32(
                vorrq_u32(vcgezq_f32(low), vclezq_f32(high)),
                vceqzq_f32(det),
            );
            if vmaxvq_u32(inside) == 0 {
                return NO_LANES;
            }
            let t = vfmaq_f32(vfmaq_f32(vmulq_f32(u, az), v, bz), w, cz);
            lanes(
                inside,
                vmulq_f32(t, self.shear.0[2]),
                v,
                w,
                det,
                self.t_min,
                t_max,
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::Bounds;
    use crate::traverse::Portable;
    use glam::Vec3;

    /// The children of a node that a ray meets, as bits, and where it enters them.
    fn meet<I: Isa>(node: &Node, ray: &Ray) -> (u32, Vec<f32>) {
        let t_max = Found::nothing(ray).t;
        // SAFETY: this processor has NEON.
        let (mask, distances) = unsafe {
            let (mask, near) = I::Slabs::new(ray).test(node, t_max);
            (mask, I::Slabs::distances(near))
        };
        let met = (0..WIDTH).filter(|lane| mask >> lane & 1 != 0);
        (mask, met.map(|lane| distances[lane]).collect())
    }

    #[test]
    fn boxes_are_met_as_by_portable_code() {
        // Coordinates of few values: rays lie in planes, and distances coincide.
        let mut state = 1u64;
        let mut next = |count: u64| {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) % count
        };
        let mut met = 0;
        for _ in 0..20_000 {
            let mut point = |scale: f32| {
                Vec3::from_array(std::array::from_fn(|_| (next(9) as f32 - 4.0) * scale))
            };
            let ray = Ray {
                t_min: 0.0,
                t_max: f32::INFINITY,
                ..Ray::new(point(1.0), point(0.37))
            };
            let mut node = Node::EMPTY;
            for lane in 0..WIDTH {
                let (a, b) = (point(1.0), point(1.0));
                if a.x != 4.0 {
                    let bounds = Bounds {
                        lower: a.min(b),
                        upper: a.max(b),
                    };
                    node.set(lane, &bounds, Child::node(lane));
                }
            }
            let found = meet::<Neon>(&node, &ray);
            met += found.1.len();
            assert_eq!(found, meet::<Portable>(&node, &ray), "{ray:?} {node:?}");
        }
        assert!(met > 10_000, "{met} met only");
    }
}
