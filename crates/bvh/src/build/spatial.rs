//! Spatial splits: where triangles of a range overlap much, a plane may cut the triangles themselves.
//!
//! Stich, Friedrich, Dietrich 2009, "Spatial splits in bounding volume hierarchies": the bins are slabs of space, each
//! triangle is clipped to the slabs that it meets, and a triangle on both sides of the chosen plane is referenced on both,
//! unless (section 4.4) it costs less to leave it whole on one side. References hold the clipped boxes; the number of extra
//! references is bounded by the room that the range was given.
//!
//! The wrong tool where memory or the time of the build matters more than rays, and where positions change later: a refit
//! only knows whole triangles.

use super::kernels::{BINS, Plane, Split, blocks, centre};
use super::{EMPTY_HULL, Hull, Ref, Triangles, half_area, union};
use glam::Vec3A;
use rayon::prelude::*;

/// Ranges above this size are binned by several threads, in chunks of a fixed size.
const PARALLEL: usize = 1 << 15;
const CHUNK: usize = 1 << 13;
/// A bound on the rounding of a point where an edge meets a plane, relative to the ends of the edge: four times the errors
/// of two differences, a quotient, a product and a sum.
const CLIP_ERROR: f32 = 8.0 / (1 << 23) as f32;

/// Slabs of equal width along each axis.
struct Slabs {
    lower: [f32; 3],
    width: [f32; 3],
    /// 0: no extent to cut.
    scale: [f32; 3],
}

impl Slabs {
    fn new(hull: &Hull) -> Self {
        let mut slabs = Self {
            lower: [hull[0], hull[1], hull[2]],
            width: [0.0; 3],
            scale: [0.0; 3],
        };
        for axis in 0..3 {
            let extent = -(hull[axis] + hull[axis + 4]);
            let scale = BINS as f32 * 0.9999 / extent;
            if extent > 0.0 && scale.is_finite() {
                slabs.scale[axis] = scale;
                slabs.width[axis] = extent / (BINS as f32 * 0.9999);
            }
        }
        slabs
    }

    #[inline(always)]
    fn slab(&self, axis: usize, x: f32) -> usize {
        // The conversion saturates.
        (((x - self.lower[axis]) * self.scale[axis]) as usize).min(BINS - 1)
    }

    /// First and last slab of a reference.
    #[inline(always)]
    fn slabs(&self, axis: usize, r: &Ref) -> (usize, usize) {
        let (low, high) = (r.hull[axis], -r.hull[axis + 4]);
        if r.is_placed() {
            let middle = self.slab(axis, 0.5 * (low + high));
            return (middle, middle);
        }
        (self.slab(axis, low), self.slab(axis, high))
    }

    /// Where a slab begins.
    #[inline(always)]
    fn plane(&self, axis: usize, slab: usize) -> f32 {
        self.lower[axis] + self.width[axis] * slab as f32
    }
}

/// What lies in each slab.
#[derive(Clone)]
struct Content {
    hulls: [[Hull; BINS]; 3],
    begin: [[u32; BINS]; 3],
    end: [[u32; BINS]; 3],
}

impl Content {
    const EMPTY: Self = Self {
        hulls: [[EMPTY_HULL; BINS]; 3],
        begin: [[0; BINS]; 3],
        end: [[0; BINS]; 3],
    };

    fn of(refs: &[Ref], slabs: &Slabs, triangles: &impl Triangles) -> Self {
        let mut all = Self::EMPTY;
        for r in refs {
            let mut corners = None;
            for axis in 0..3 {
                if slabs.scale[axis] == 0.0 {
                    continue;
                }
                let (first, last) = slabs.slabs(axis, r);
                all.begin[axis][first] += 1;
                all.end[axis][last] += 1;
                let hulls = &mut all.hulls[axis];
                let mut rest = r.hull;
                if first != last {
                    let corners = corners.get_or_insert_with(|| corners_of(r, triangles));
                    for (slab, hull) in hulls.iter_mut().enumerate().take(last).skip(first) {
                        let plane = slabs.plane(axis, slab + 1);
                        let (below, above) = clip(corners, &rest, axis, plane);
                        if !is_empty(&below) {
                            *hull = union(hull, &below);
                        }
                        rest = above;
                    }
                }
                if !is_empty(&rest) {
                    hulls[last] = union(&hulls[last], &rest);
                }
            }
        }
        all
    }

    fn merge(mut self, other: &Self) -> Self {
        for axis in 0..3 {
            for slab in 0..BINS {
                self.hulls[axis][slab] = union(&self.hulls[axis][slab], &other.hulls[axis][slab]);
                self.begin[axis][slab] += other.begin[axis][slab];
                self.end[axis][slab] += other.end[axis][slab];
            }
        }
        self
    }
}

fn corners_of(r: &Ref, triangles: &impl Triangles) -> [Vec3A; 3] {
    triangles.triangle(r).0.map(Vec3A::from)
}

#[inline(always)]
fn is_empty(hull: &Hull) -> bool {
    hull[0] > -hull[4] || hull[1] > -hull[5] || hull[2] > -hull[6]
}

/// Boxes around what of a triangle lies in `hull`, below and above a plane; possibly empty. No point is lost: new points
/// are enlarged by a bound on their rounding. Numbers in the hull's free lanes go along.
#[inline(always)]
fn clip(corners: &[Vec3A; 3], hull: &Hull, axis: usize, plane: f32) -> (Hull, Hull) {
    let mut below = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    let mut above = below;
    for k in 0..3 {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let (x, y) = (a[axis], b[axis]);
        if x <= plane {
            below = (below.0.min(a), below.1.max(a));
        }
        if x >= plane {
            above = (above.0.min(a), above.1.max(a));
        }
        if (x < plane && plane < y) || (y < plane && plane < x) {
            let at = a + (b - a) * ((plane - x) / (y - x));
            let error = a.abs().max(b.abs()) * CLIP_ERROR;
            let low = (at - error).max(a.min(b));
            let high = (at + error).min(a.max(b));
            below = (below.0.min(low), below.1.max(high));
            above = (above.0.min(low), above.1.max(high));
        }
    }
    below.1[axis] = below.1[axis].min(plane);
    above.0[axis] = above.0[axis].max(plane);
    let inside = |(low, high): (Vec3A, Vec3A)| {
        let low = low.max(Vec3A::new(hull[0], hull[1], hull[2]));
        let high = (-high).max(Vec3A::new(hull[4], hull[5], hull[6]));
        [
            low.x, low.y, low.z, hull[3], high.x, high.y, high.z, hull[7],
        ]
    };
    (inside(below), inside(above))
}

/// The best plane between slabs.
pub(super) struct Cut {
    slabs: Slabs,
    axis: usize,
    /// First slab above.
    slab: usize,
    pub cost: f32,
    hulls: [Hull; 2],
    counts: [usize; 2],
}

/// How much the two sides of an object split must share for cutting to be tried: in parts of the range's own area, and of
/// the whole tree's. Below these, cuts cost references and time and gain next to nothing (measured on four scenes).
const OVERLAP: f32 = 0.01;
const OVERLAP_OF_ROOT: f32 = 1e-3;

/// Do the sides of an object split overlap so much that cutting may pay? `root_area` is half the area of the whole tree's
/// box.
pub(super) fn is_worth_trying(plane: Option<&Plane>, hull: &Hull, root_area: f32) -> bool {
    let least = (OVERLAP * half_area(hull)).max(OVERLAP_OF_ROOT * root_area);
    if half_area(hull) < least {
        return false;
    }
    // All centres coincide: so do the triangles, as a rule.
    let Some(plane) = plane else { return false };
    let [l, r] = &plane.hulls;
    let shared: Hull = std::array::from_fn(|k| l[k].max(r[k]));
    !is_empty(&shared) && half_area(&shared) > least
}

/// The best cut that needs at most `room` references.
pub(super) fn find(
    refs: &[Ref],
    hull: &Hull,
    room: usize,
    triangles: &impl Triangles,
) -> Option<Cut> {
    let slabs = Slabs::new(hull);
    let content = if refs.len() > PARALLEL {
        refs.par_chunks(CHUNK)
            .map(|chunk| Content::of(chunk, &slabs, triangles))
            .reduce(|| Content::EMPTY, |a, b| a.merge(&b))
    } else {
        Content::of(refs, &slabs, triangles)
    };
    let mut best = f32::INFINITY;
    let mut found = None;
    for axis in 0..3 {
        if slabs.scale[axis] == 0.0 {
            continue;
        }
        let mut right = [(EMPTY_HULL, 0); BINS];
        let (mut hull, mut count) = (EMPTY_HULL, 0);
        for slab in (1..BINS).rev() {
            hull = union(&hull, &content.hulls[axis][slab]);
            count += content.end[axis][slab] as usize;
            right[slab] = (hull, count);
        }
        let (mut hull, mut count) = (EMPTY_HULL, 0);
        for (slab, &(right_hull, right_count)) in right.iter().enumerate().skip(1) {
            hull = union(&hull, &content.hulls[axis][slab - 1]);
            count += content.begin[axis][slab - 1] as usize;
            if count == 0 || right_count == 0 || count + right_count > room {
                continue;
            }
            let cost =
                half_area(&hull) * blocks(count) + half_area(&right_hull) * blocks(right_count);
            if cost < best {
                best = cost;
                found = Some((axis, slab, [hull, right_hull], [count, right_count]));
            }
        }
    }
    let (axis, slab, hulls, counts) = found?;
    Some(Cut {
        slabs,
        axis,
        slab,
        cost: best,
        hulls,
        counts,
    })
}

/// Cuts the first `count` of `refs`: those below stay in front, those above end up in `scratch`. Returns the split and the
/// number above; one side may have got nothing.
pub(super) fn partition(
    refs: &mut [Ref],
    scratch: &mut [Ref],
    count: usize,
    cut: &Cut,
    triangles: &impl Triangles,
) -> (Split, usize) {
    let axis = cut.axis;
    let plane = cut.slabs.plane(axis, cut.slab);
    let areas = cut.hulls.map(|h| half_area(&h));
    let [below, above] = cut.counts.map(|n| n as f32);
    // References that must be cut; if all of a side's must be, none may leave it.
    let crossing = cut.counts[0] + cut.counts[1] - count;
    let may_unsplit = cut.counts[0] > crossing && cut.counts[1] > crossing;
    let cut_cost = areas[0] * below + areas[1] * above;
    let mut hulls = [EMPTY_HULL; 2];
    let mut centres = [EMPTY_HULL; 2];
    let mut add = |side: usize, r: &Ref| {
        hulls[side] = union(&hulls[side], &r.hull);
        centres[side] = union(&centres[side], &centre(&r.hull));
    };
    let (mut left, mut right) = (0, 0);
    for k in 0..count {
        let r = refs[k];
        let (first, last) = cut.slabs.slabs(axis, &r);
        let mut whole_below = last < cut.slab;
        if !whole_below && first < cut.slab {
            let mut whole_above = false;
            if may_unsplit {
                let all_below =
                    half_area(&union(&cut.hulls[0], &r.hull)) * below + areas[1] * (above - 1.0);
                let all_above =
                    areas[0] * (below - 1.0) + half_area(&union(&cut.hulls[1], &r.hull)) * above;
                whole_below = all_below < cut_cost && all_below <= all_above;
                whole_above = all_above < cut_cost && !whole_below;
            }
            if !whole_below && !whole_above {
                let corners = corners_of(&r, triangles);
                let (l, u) = clip(&corners, &r.hull, axis, plane);
                whole_below = is_empty(&u);
                if !whole_below && !is_empty(&l) {
                    let (l, u) = (Ref { hull: l }, Ref { hull: u });
                    add(0, &l);
                    add(1, &u);
                    refs[left] = l;
                    scratch[right] = u;
                    left += 1;
                    right += 1;
                    continue;
                }
            }
        }
        if whole_below {
            add(0, &r);
            refs[left] = r;
            left += 1;
        } else {
            add(1, &r);
            scratch[right] = r;
            right += 1;
        }
    }
    (
        Split {
            at: left,
            hulls,
            centres,
        },
        right,
    )
}
