//! The plain data of a tree: nodes, blocks of triangles, and how one names the other.

use crate::buffer::Buffer;
use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Children of a node.
pub(crate) const WIDTH: usize = 8;
/// Triangles of a block.
pub(crate) const LANES: usize = 4;
/// Most blocks in one leaf.
pub(crate) const MAX_LEAF_BLOCKS: usize = 8;
/// Deepest tree: the builder switches to splitting in the middle early enough.
pub(crate) const MAX_DEPTH: usize = 96;
/// Entries of a traversal's stack: each level leaves at most seven siblings; one at the bottom, and room to write eight at
/// once.
pub(crate) const STACK: usize = (WIDTH - 1) * MAX_DEPTH + 2 * WIDTH;
/// Set in a triangle's id if its hits must pass the filter.
pub(crate) const FILTERED: u32 = 1 << 31;
/// The id of an unused lane.
pub(crate) const NO_TRIANGLE: u32 = u32::MAX;
/// Most triangles in one tree, so that an id leaves room for the flag.
pub(crate) const MAX_TRIANGLES: u64 = (1 << 27) - 1;

/// An inner node: the boxes of eight children as planes, and what they are. Four cache lines.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct Node {
    /// `planes[axis][0]` are lower, `planes[axis][1]` upper bounds. An unused child has +inf and -inf.
    pub planes: [[[f32; WIDTH]; 2]; 3],
    /// See [`Child`].
    pub children: [Child; WIDTH],
    /// Fills the last line.
    pub unused: [u32; WIDTH],
}

impl Node {
    pub const EMPTY: Self = Self {
        planes: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3],
        children: [Child::NONE; WIDTH],
        unused: [0; WIDTH],
    };

    pub fn set(&mut self, lane: usize, bounds: &Bounds, child: Child) {
        for axis in 0..3 {
            self.planes[axis][0][lane] = bounds.lower[axis];
            self.planes[axis][1][lane] = bounds.upper[axis];
        }
        self.children[lane] = child;
    }

    pub fn bounds(&self, lane: usize) -> Bounds {
        Bounds {
            lower: Vec3::from_array(std::array::from_fn(|axis| self.planes[axis][0][lane])),
            upper: Vec3::from_array(std::array::from_fn(|axis| self.planes[axis][1][lane])),
        }
    }
}

/// What a child is: a node, a run of triangle blocks, a placed instance or nothing.
///
/// Bit 31: leaf; bit 30: instance. Blocks: bits 27-29 count less one, bits 0-26 first block.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(crate) struct Child(pub u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const INSTANCE: u32 = 1 << 30;
    const COUNT_SHIFT: u32 = 27;
    const FIRST: u32 = (1 << Self::COUNT_SHIFT) - 1;
    /// An unused child. Its box is empty, so no traversal reads it.
    pub const NONE: Self = Self(u32::MAX);

    pub fn node(index: usize) -> Self {
        debug_assert!(index <= Self::FIRST as usize);
        Self(index as u32)
    }

    pub fn blocks(first: usize, count: usize) -> Self {
        debug_assert!(first <= Self::FIRST as usize && (1..=MAX_LEAF_BLOCKS).contains(&count));
        Self(Self::LEAF | ((count as u32 - 1) << Self::COUNT_SHIFT) | first as u32)
    }

    pub fn instance(index: usize) -> Self {
        debug_assert!(index <= Self::FIRST as usize);
        Self(Self::LEAF | Self::INSTANCE | index as u32)
    }

    #[inline(always)]
    pub fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    #[inline(always)]
    pub fn is_instance(self) -> bool {
        self.0 & Self::INSTANCE != 0
    }

    /// The node, the first block or the instance.
    #[inline(always)]
    pub fn index(self) -> usize {
        (self.0 & Self::FIRST) as usize
    }

    #[inline(always)]
    pub fn block_count(self) -> usize {
        ((self.0 >> Self::COUNT_SHIFT) & 7) as usize + 1
    }

    /// The same child when the arrays that it points into are appended to others.
    pub fn shifted(self, nodes: usize, blocks: usize) -> Self {
        if self == Self::NONE || self.is_leaf() && self.is_instance() {
            self
        } else if self.is_leaf() {
            Self(self.0 + blocks as u32)
        } else {
            Self(self.0 + nodes as u32)
        }
    }
}

/// Four triangles, one a lane.
///
/// For the fast test `corners` holds the first vertex, first minus second, third minus first; for the watertight test
/// the three vertices. Unused lanes are zero: a triangle without an area is never hit.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct Block {
    /// `[corner][axis][lane]`.
    pub corners: [[[f32; LANES]; 3]; 3],
    /// The triangle's number and the flag [`FILTERED`].
    pub ids: [u32; LANES],
}

impl Block {
    pub const EMPTY: Self = Self {
        corners: [[[0.0; LANES]; 3]; 3],
        ids: [NO_TRIANGLE; LANES],
    };

    pub fn set(&mut self, lane: usize, vertices: &[Vec3; 3], watertight: bool, id: u32) {
        let [a, b, c] = *vertices;
        let corners = if watertight {
            [a, b, c]
        } else {
            [a, a - b, c - a]
        };
        for (corner, value) in corners.iter().enumerate() {
            for axis in 0..3 {
                self.corners[corner][axis][lane] = value[axis];
            }
        }
        self.ids[lane] = id;
    }
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub lower: Vec3,
    pub upper: Vec3,
}

impl Bounds {
    pub const EMPTY: Self = Self {
        lower: Vec3::INFINITY,
        upper: Vec3::NEG_INFINITY,
    };

    pub fn grow(&mut self, point: Vec3) {
        self.lower = self.lower.min(point);
        self.upper = self.upper.max(point);
    }

    pub fn merge(&mut self, other: &Self) {
        self.lower = self.lower.min(other.lower);
        self.upper = self.upper.max(other.upper);
    }

    pub fn is_empty(&self) -> bool {
        self.lower.x > self.upper.x
    }

    pub fn contains(&self, other: &Self) -> bool {
        other.lower.cmpge(self.lower).all() && other.upper.cmple(self.upper).all()
    }

    /// Half the surface area; 0 if empty.
    pub fn half_area(&self) -> f32 {
        if self.is_empty() {
            return 0.0;
        }
        let d = self.upper - self.lower;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// A tree over triangles, and in the top tree over instances too.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    /// Node 0 is the root; no nodes: an empty tree.
    pub nodes: Buffer<Node>,
    pub blocks: Buffer<Block>,
    pub bounds: Bounds,
    /// Triangles, each counted once however many leaves it is in.
    pub triangles: usize,
    /// Nodes on the longest way down.
    pub depth: usize,
    /// Expected cost of a ray that meets the box, at the time of the build.
    pub built_cost: f32,
}

impl Tree {
    pub fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.blocks[..])
    }
}
