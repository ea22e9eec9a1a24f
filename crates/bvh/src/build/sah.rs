//! The binary tree: top-down, each range split where binned SAH is least, down to single references.
//!
//! Cost of a split: area times the number of four-triangle blocks on either side (Wald 2007, with the leaves' real cost).
//! Ranges of a few references are swept exactly instead of binned. Where the sides of a split overlap much, triangles may be
//! cut ([`super::spatial`]): each range has room for a share of the extra references.

use super::kernels::{Bins, Grid, Kernels, Portable, SMALL, Split};
use super::{EMPTY_HULL, Hull, Ref, Triangles, spatial, union};
use crate::buffer::Buffer;
use crate::node::MAX_DEPTH;
use rayon::prelude::*;

/// A binary node: its hull, with `link` in lane 3 and the number of references in lane 7.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
pub(crate) struct Node2 {
    pub hull: Hull,
}

impl Node2 {
    fn new(mut hull: Hull, link: usize, count: usize) -> Self {
        hull[3] = f32::from_bits(link as u32);
        hull[7] = f32::from_bits(count as u32);
        Self { hull }
    }

    /// Leaf: the reference. Otherwise: the left child; the right one is next to it.
    pub fn link(&self) -> usize {
        self.hull[3].to_bits() as usize
    }

    /// References below. 1: a leaf; 0: unused, where a range had more room than it needed.
    pub fn count(&self) -> usize {
        self.hull[7].to_bits() as usize
    }
}

/// A binary tree over references. Children come after their parents, all below a left child before all below its sibling;
/// the references below a node are neighbours if they are few enough for [`SMALL`].
pub(crate) struct Binary {
    pub nodes: Buffer<Node2>,
    pub refs: Buffer<Ref>,
}

/// Levels after which ranges are split in the middle, so that no input makes a tree deeper than [`MAX_DEPTH`].
const MIDDLE_SPLIT_DEPTH: usize = MAX_DEPTH - 32;
/// Ranges above this size are worked on by several threads.
const PARALLEL: usize = 8192;
/// Ranges above this size are binned by several threads.
const PARALLEL_BINNING: usize = 1 << 17;
const BINNING_CHUNK: usize = 1 << 15;
/// After so many vain attempts at cutting one below the other, the triangles below are left whole.
const PATIENCE: u32 = 2;

/// One range of references on its way into the tree.
struct Range<'a> {
    /// The references, then room for more.
    refs: &'a mut [Ref],
    /// How many references there are.
    count: usize,
    /// As long as `refs`.
    scratch: &'a mut [Ref],
    /// Room for the `2 * (refs.len() - 1)` nodes below this one.
    nodes: &'a mut [Node2],
    first_ref: usize,
    first_node: usize,
    hull: Hull,
    /// Hull of the doubled centres.
    centres: Hull,
    depth: usize,
    /// Half the area of the whole tree's box.
    root_area: f32,
    /// How often in a row no cut was better than leaving triangles whole, on the way down to here.
    failures: u32,
}

/// Builds over the first `count` of `refs`; the rest is room for cut triangles.
pub(crate) fn build(mut refs: Buffer<Ref>, count: usize, triangles: &impl Triangles) -> Binary {
    let room = refs.len();
    let mut nodes = Buffer::<Node2>::zeroed(2 * room - 1);
    let mut scratch = Buffer::zeroed(room);
    let (hull, centres) = hulls(&refs[..count]);
    let (root, below) = nodes.split_at_mut(1);
    let range = Range {
        refs: &mut refs,
        count,
        scratch: &mut scratch,
        nodes: below,
        first_ref: 0,
        first_node: 1,
        hull,
        centres,
        depth: 1,
        root_area: super::half_area(&hull),
        failures: 0,
    };
    root[0] = root_of(range, triangles);
    Binary { nodes, refs }
}

/// Chooses the kernels once for the whole tree.
fn root_of(range: Range, triangles: &impl Triangles) -> Node2 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { subtree::<super::kernels::Avx2, _>(range, triangles) };
    }
    // SAFETY: portable kernels ask nothing of the processor.
    unsafe { subtree::<Portable, _>(range, triangles) }
}

fn hulls(refs: &[Ref]) -> (Hull, Hull) {
    let (mut hull, mut centres) = (EMPTY_HULL, EMPTY_HULL);
    for r in refs {
        hull = union(&hull, &r.hull);
        centres = union(&centres, &super::kernels::centre(&r.hull));
    }
    (hull, centres)
}

/// # Safety
/// The processor has what `K` asks for.
unsafe fn subtree<K: Kernels, T: Triangles>(mut range: Range, triangles: &T) -> Node2 {
    let count = range.count;
    if count == 1 {
        return Node2::new(range.hull, range.first_ref, 1);
    }
    let middle = range.depth >= MIDDLE_SPLIT_DEPTH;
    let split = if middle {
        None
    } else if count <= SMALL {
        // SAFETY: as promised by the caller.
        let split = unsafe { K::sweep(&mut range.refs[..count]) };
        split.map(|split| (split, None))
    } else {
        // SAFETY: as promised by the caller.
        unsafe { find_split::<K, T>(&mut range, triangles) }
    };
    let (split, above) = split.unwrap_or_else(|| {
        let (left, right) = range.refs[..count].split_at(count / 2);
        let ((left, left_centres), (right, right_centres)) = (hulls(left), hulls(right));
        let split = Split {
            at: count / 2,
            hulls: [left, right],
            centres: [left_centres, right_centres],
        };
        (split, None)
    });
    let Range {
        refs,
        scratch,
        nodes,
        first_ref,
        first_node,
        hull,
        depth,
        root_area,
        failures,
        ..
    } = range;
    // Without a number above, all references are in `refs` one after the other.
    let counts = [split.at, above.unwrap_or(count - split.at)];
    let spare = refs.len() - counts[0] - counts[1];
    let below_room = if counts[0] + counts[1] <= SMALL {
        counts[0]
    } else {
        counts[0] + (spare as u64 * counts[0] as u64 / (counts[0] + counts[1]) as u64) as usize
    };
    if above.is_some() {
        refs[below_room..below_room + counts[1]].copy_from_slice(&scratch[..counts[1]]);
    } else if below_room != counts[0] {
        refs.copy_within(counts[0]..counts[0] + counts[1], below_room);
    }
    let (pair, below) = nodes.split_at_mut(2);
    let (left_refs, right_refs) = refs.split_at_mut(below_room);
    let (left_scratch, right_scratch) = scratch.split_at_mut(below_room);
    let (left_nodes, right_nodes) = below.split_at_mut(2 * (below_room - 1));
    let left = Range {
        refs: left_refs,
        count: counts[0],
        scratch: left_scratch,
        nodes: left_nodes,
        first_ref,
        first_node: first_node + 2,
        hull: split.hulls[0],
        centres: split.centres[0],
        depth: depth + 1,
        root_area,
        failures,
    };
    let right = Range {
        refs: right_refs,
        count: counts[1],
        scratch: right_scratch,
        nodes: right_nodes,
        first_ref: first_ref + below_room,
        first_node: first_node + 2 + 2 * (below_room - 1),
        hull: split.hulls[1],
        centres: split.centres[1],
        depth: depth + 1,
        root_area,
        failures,
    };
    // SAFETY: as promised by the caller.
    let (l, r) = unsafe {
        if count > PARALLEL {
            rayon::join(
                || subtree::<K, T>(left, triangles),
                || subtree::<K, T>(right, triangles),
            )
        } else {
            (
                subtree::<K, T>(left, triangles),
                subtree::<K, T>(right, triangles),
            )
        }
    };
    pair[0] = l;
    pair[1] = r;
    Node2::new(hull, first_node, l.count() + r.count())
}

/// Splits a range at the best plane between bins, or cuts it; `None` if all centres coincide. With the split comes the number
/// of references above it, which are in the scratch space.
///
/// # Safety
/// The processor has what `K` asks for.
unsafe fn find_split<K: Kernels, T: Triangles>(
    range: &mut Range,
    triangles: &T,
) -> Option<(Split, Option<usize>)> {
    let count = range.count;
    let refs = &mut range.refs[..count];
    let grid = Grid::new(&range.centres, count);
    let mut bins;
    if count > PARALLEL_BINNING {
        // Chunks of a fixed size: the result does not depend on the number of threads.
        bins = refs
            .par_chunks(BINNING_CHUNK)
            .map(|chunk| {
                let mut bins = Bins::EMPTY;
                // SAFETY: as promised by the caller.
                unsafe { K::bin(chunk, &grid, &mut bins) };
                bins
            })
            .reduce(|| Bins::EMPTY, |a, b| a.merge(&b));
    } else {
        bins = Bins::EMPTY;
        // SAFETY: as promised by the caller.
        unsafe { K::bin(refs, &grid, &mut bins) };
    }
    // SAFETY: as promised by the caller.
    let plane = unsafe { K::choose(&bins, &grid) };
    let room = range.refs.len();
    if room > count
        && range.failures < PATIENCE
        && spatial::is_worth_trying(plane.as_ref(), &range.hull, range.root_area)
    {
        let cut = spatial::find(&range.refs[..count], &range.hull, room, triangles);
        let cut = cut.filter(|cut| plane.as_ref().is_none_or(|plane| cut.cost < plane.cost));
        if let Some(cut) = cut {
            let (split, above) =
                spatial::partition(range.refs, range.scratch, count, &cut, triangles);
            range.failures = 0;
            if split.at > 0 && above > 0 {
                return Some((split, Some(above)));
            }
            // Rounding left nothing on one side; the references are whole, but may have moved.
            if split.at == 0 {
                range.refs[..above].copy_from_slice(&range.scratch[..above]);
            }
            return None;
        }
        range.failures += 1;
    }
    let plane = plane?;
    // SAFETY: as promised by the caller.
    let split = unsafe { K::partition(&mut range.refs[..count], range.scratch, &grid, &plane) };
    let above = count - split.at;
    Some((split, Some(above)))
}
