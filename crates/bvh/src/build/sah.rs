//! The binary tree: top-down, each range split where binned SAH is least, down to single references.
//!
//! Cost of a split: area times the number of four-triangle blocks on either side (Wald 2007, with the leaves' real cost).
//! Ranges of a few references are swept exactly instead of binned.

use super::kernels::{Bins, Grid, Kernels, Portable, SMALL, Split};
use super::{EMPTY_HULL, Hull, Ref, union};
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

    /// References below. 1: a leaf.
    pub fn count(&self) -> usize {
        self.hull[7].to_bits() as usize
    }
}

/// A binary tree over references; the references below a node are neighbours. Children come after their parents.
pub(crate) struct Binary {
    pub nodes: Buffer<Node2>,
    pub refs: Vec<Ref>,
}

/// Levels after which ranges are split in the middle, so that no input makes a tree deeper than [`MAX_DEPTH`].
const MIDDLE_SPLIT_DEPTH: usize = MAX_DEPTH - 32;
/// Ranges above this size are worked on by several threads.
const PARALLEL: usize = 8192;
/// Ranges above this size are binned by several threads.
const PARALLEL_BINNING: usize = 1 << 17;
const BINNING_CHUNK: usize = 1 << 15;

/// One range of references on its way into the tree.
struct Range<'a> {
    refs: &'a mut [Ref],
    /// As long as `refs`.
    scratch: &'a mut [Ref],
    /// The `2 * (refs.len() - 1)` nodes below this one.
    nodes: &'a mut [Node2],
    first_ref: usize,
    first_node: usize,
    hull: Hull,
    /// Hull of the doubled centres.
    centres: Hull,
    depth: usize,
}

pub(crate) fn build(mut refs: Vec<Ref>) -> Binary {
    let count = refs.len();
    let mut nodes = Buffer::<Node2>::zeroed(2 * count - 1);
    let mut scratch = Buffer::zeroed(count);
    let (hull, centres) = hulls(&refs);
    let (root, below) = nodes.split_at_mut(1);
    let range = Range {
        refs: &mut refs,
        scratch: &mut scratch,
        nodes: below,
        first_ref: 0,
        first_node: 1,
        hull,
        centres,
        depth: 1,
    };
    root[0] = root_of(range);
    Binary { nodes, refs }
}

/// Chooses the kernels once for the whole tree.
fn root_of(range: Range) -> Node2 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { subtree::<super::kernels::Avx2>(range) };
    }
    // SAFETY: portable kernels ask nothing of the processor.
    unsafe { subtree::<Portable>(range) }
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
unsafe fn subtree<K: Kernels>(mut range: Range) -> Node2 {
    let count = range.refs.len();
    if count == 1 {
        return Node2::new(range.hull, range.first_ref, 1);
    }
    let middle = range.depth >= MIDDLE_SPLIT_DEPTH;
    let split = if middle {
        None
    } else if count <= SMALL {
        // SAFETY: as promised by the caller.
        unsafe { K::sweep(range.refs) }
    } else {
        // SAFETY: as promised by the caller.
        unsafe { find_split::<K>(&mut range) }
    };
    let split = split.unwrap_or_else(|| {
        let (left, right) = range.refs.split_at(count / 2);
        let ((left, left_centres), (right, right_centres)) = (hulls(left), hulls(right));
        Split {
            at: count / 2,
            hulls: [left, right],
            centres: [left_centres, right_centres],
        }
    });
    let Range {
        refs,
        scratch,
        nodes,
        first_ref,
        first_node,
        hull,
        depth,
        ..
    } = range;
    let (pair, below) = nodes.split_at_mut(2);
    let (left_refs, right_refs) = refs.split_at_mut(split.at);
    let (left_scratch, right_scratch) = scratch.split_at_mut(split.at);
    let (left_nodes, right_nodes) = below.split_at_mut(2 * (split.at - 1));
    let left = Range {
        refs: left_refs,
        scratch: left_scratch,
        nodes: left_nodes,
        first_ref,
        first_node: first_node + 2,
        hull: split.hulls[0],
        centres: split.centres[0],
        depth: depth + 1,
    };
    let right = Range {
        refs: right_refs,
        scratch: right_scratch,
        nodes: right_nodes,
        first_ref: first_ref + split.at,
        first_node: first_node + 2 + 2 * (split.at - 1),
        hull: split.hulls[1],
        centres: split.centres[1],
        depth: depth + 1,
    };
    // SAFETY: as promised by the caller.
    let (l, r) = unsafe {
        if count > PARALLEL {
            rayon::join(|| subtree::<K>(left), || subtree::<K>(right))
        } else {
            (subtree::<K>(left), subtree::<K>(right))
        }
    };
    pair[0] = l;
    pair[1] = r;
    Node2::new(hull, first_node, count)
}

/// Cuts a range at the best plane between bins; `None` if all centres coincide.
///
/// # Safety
/// The processor has what `K` asks for.
unsafe fn find_split<K: Kernels>(range: &mut Range) -> Option<Split> {
    let count = range.refs.len();
    let grid = Grid::new(&range.centres, count);
    let mut bins;
    if count > PARALLEL_BINNING {
        // Chunks of a fixed size: the result does not depend on the number of threads.
        bins = range
            .refs
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
        unsafe { K::bin(range.refs, &grid, &mut bins) };
    }
    // SAFETY: as promised by the caller.
    unsafe {
        let plane = K::choose(&bins, &grid)?;
        Some(K::partition(range.refs, range.scratch, &grid, &plane))
    }
}
