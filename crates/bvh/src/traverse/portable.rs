//! Plain Rust, for any processor. The compiler vectorises what it can.

use super::{Edges, Found, Isa, Lanes, Query, Reciprocal, Scope, Slabs, entry_points};
use crate::accel::Accel;
use crate::filter::HitFilter;
use crate::node::{Block, Child, LANES, Node, Tree, WIDTH};
use glam::Vec3;
use occlude_visibility::{Hit, Ray};

pub(crate) struct Portable;

impl Isa for Portable {
    type Slabs = PortableSlabs;
    type Thin = ThinEdges;
    type Tight = TightEdges;

    unsafe fn prefetch(_: &Tree, _: Child) {}

    entry_points!();
}

/// `max` and `min` as SSE has them: of a NaN and a number the second argument. Numbers that are not known drop out.
#[inline(always)]
fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
#[inline(always)]
fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

pub(crate) struct PortableSlabs {
    origin: [f32; 3],
    reciprocal: Reciprocal,
}

impl Slabs for PortableSlabs {
    type Near = [f32; WIDTH];

    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        Self {
            origin: ray.origin.to_array(),
            reciprocal: Reciprocal::new(ray),
        }
    }

    #[inline(always)]
    unsafe fn test(&self, node: &Node, t_max: f32) -> (u32, [f32; WIDTH]) {
        let mut far = [t_max; WIDTH];
        let mut near = [self.reciprocal.t_min; WIDTH];
        for axis in 0..3 {
            let negative = usize::from(self.reciprocal.negative[axis]);
            let (enter, leave) = (
                &node.planes[axis][negative],
                &node.planes[axis][1 - negative],
            );
            for lane in 0..WIDTH {
                let (to_enter, to_leave) = (
                    enter[lane] - self.origin[axis],
                    leave[lane] - self.origin[axis],
                );
                near[lane] = max(to_enter * self.reciprocal.near[axis], near[lane]);
                far[lane] = min(to_leave * self.reciprocal.far[axis], far[lane]);
            }
        }
        let mut mask = 0;
        for lane in 0..WIDTH {
            mask |= u32::from(near[lane] <= far[lane]) << lane;
        }
        (mask, near)
    }

    #[inline(always)]
    unsafe fn distances(near: [f32; WIDTH]) -> [f32; WIDTH] {
        near
    }
}

/// Möller and Trumbore 1997, in the form that reuses the edges' cross product.
pub(crate) struct ThinEdges {
    origin: Vec3,
    direction: Vec3,
    t_min: f32,
}

impl Edges<false> for ThinEdges {
    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        Self {
            origin: ray.origin,
            direction: ray.direction,
            t_min: ray.t_min,
        }
    }

    #[inline(always)]
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes {
        let mut lanes = Lanes {
            mask: 0,
            t: [0.0; LANES],
            u: [0.0; LANES],
            v: [0.0; LANES],
        };
        for lane in 0..LANES {
            let corner = |k: usize| {
                Vec3::from_array(std::array::from_fn(|axis| block.corners[k][axis][lane]))
            };
            let (e1, e2) = (corner(1), corner(2));
            let c = corner(0) - self.origin;
            let normal = e2.cross(e1);
            let r = c.cross(self.direction);
            let det = normal.dot(self.direction);
            let sign = 1.0f32.copysign(det);
            let det_abs = det.abs();
            let u = r.dot(e2) * sign;
            let v = r.dot(e1) * sign;
            if u >= 0.0 && v >= 0.0 && det_abs - u - v >= 0.0 && det_abs > 0.0 {
                let t = normal.dot(c) * sign / det_abs;
                if t > self.t_min && t < t_max {
                    lanes.mask |= 1 << lane;
                    lanes.t[lane] = t;
                    lanes.u[lane] = u / det_abs;
                    lanes.v[lane] = v / det_abs;
                }
            }
        }
        lanes
    }
}

/// Woop, Benthin, Wald 2013, "Watertight ray/triangle intersection". Zero counts as inside on either side of an edge, so
/// that the double precision of the paper is not needed to keep edges closed.
pub(crate) struct TightEdges {
    origin: [f32; 3],
    axes: [usize; 3],
    shear: [f32; 3],
    t_min: f32,
}

/// Axes in the order x, y, z of the sheared space, and the shear (the paper's S_x, S_y, S_z).
pub(super) fn shear(ray: &Ray) -> ([usize; 3], [f32; 3]) {
    let d = ray.direction.to_array();
    let a = ray.direction.abs();
    let z = if a.x > a.y {
        if a.x > a.z { 0 } else { 2 }
    } else if a.y > a.z {
        1
    } else {
        2
    };
    let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
    if d[z] < 0.0 {
        std::mem::swap(&mut x, &mut y);
    }
    ([x, y, z], [d[x] / d[z], d[y] / d[z], 1.0 / d[z]])
}

impl Edges<true> for TightEdges {
    #[inline(always)]
    unsafe fn new(ray: &Ray) -> Self {
        let (axes, shear) = shear(ray);
        Self {
            origin: ray.origin.to_array(),
            axes,
            shear,
            t_min: ray.t_min,
        }
    }

    #[inline(always)]
    unsafe fn test(&self, block: &Block, t_max: f32) -> Lanes {
        let mut lanes = Lanes {
            mask: 0,
            t: [0.0; LANES],
            u: [0.0; LANES],
            v: [0.0; LANES],
        };
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        for lane in 0..LANES {
            let corner = |k: usize| {
                let p = |axis: usize| block.corners[k][axis][lane] - self.origin[axis];
                let z = p(kz);
                (p(kx) - sx * z, p(ky) - sy * z, z)
            };
            let ((ax, ay, az), (bx, by, bz), (cx, cy, cz)) = (corner(0), corner(1), corner(2));
            let u = cx * by - cy * bx;
            let v = ax * cy - ay * cx;
            let w = bx * ay - by * ax;
            let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
            let det = u + v + w;
            if inside && det != 0.0 {
                let t = (u * az + v * bz + w * cz) * sz / det;
                if t > self.t_min && t < t_max {
                    lanes.mask |= 1 << lane;
                    lanes.t[lane] = t;
                    lanes.u[lane] = v / det;
                    lanes.v[lane] = w / det;
                }
            }
        }
        lanes
    }
}
