//! From the binary tree to 8-wide nodes and leaves of triangle blocks, at the least cost that the binary tree allows.
//!
//! Ylitie, Karras, Laine 2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs", section 3.1:
//! with `C(n, i)` the least cost of representing the subtree `n` by at most `i` children of some wide node,
//!
//! ```text
//! C(n, 1) = min(leaf(n), area(n) * NODE_COST + distribute(n, 8))
//! C(n, i) = min(distribute(n, i), C(n, i - 1))
//! distribute(n, i) = min over 0 < k < i of C(left, k) + C(right, i - k)
//! ```

use super::sah::{Binary, Node2};
use super::{Triangles, bounds_of, half_area, write_blocks};
use crate::buffer::Buffer;
use crate::node::{Block, Child, LANES, MAX_DEPTH, MAX_LEAF_BLOCKS, Node, Tree, WIDTH};
use rayon::prelude::*;

/// Cost of visiting a node.
const NODE_COST: f32 = 1.0;
/// Cost of testing a block of four triangles.
const BLOCK_COST: f32 = 0.7;
/// Cost of visiting a placed instance, on top of what its tree costs.
const INSTANCE_COST: f32 = 3.0;
/// Most triangles that are considered for one leaf.
const MAX_LEAF: usize = 2 * LANES;
const _: () = assert!(MAX_LEAF <= LANES * MAX_LEAF_BLOCKS);
/// Subtrees with more references, and more than a sixteenth of all, are written by several threads.
const PARALLEL: usize = 1 << 15;

/// Decisions of one binary node.
///
/// `[0]`: 0 means that as one child it is a leaf, 1 a node. `[i - 1]` for `i` from 2 to 7: how many of `i` children go to
/// the left; 0 means use one child less. `[7]`: how many of eight go to the left when it becomes a node.
type Choice = [u8; WIDTH];
/// `C(n, i)` at `[i - 1]`, for `i` up to 7.
type Costs = [f32; WIDTH - 1];

/// Turns the binary tree into a wide one.
pub(super) fn collapse(
    binary: &Binary,
    triangles: &impl Triangles,
    watertight: bool,
    tree: &mut Tree,
) {
    let collapser = Collapser {
        binary,
        choices: choose(binary),
        triangles,
        watertight,
    };
    let out = collapser.write(0);
    tree.nodes = Buffer::from_slice(&out.nodes);
    tree.blocks = Buffer::from_slice(&out.blocks);
    tree.bounds = bounds_of(&binary.nodes[0].hull);
    tree.depth = out.depth;
    assert!(tree.depth <= MAX_DEPTH, "the binary tree bounds the depth");
    tree.built_cost = cost(tree);
}

/// Expected node visits and weighted block tests of a ray that meets the tree's box.
pub(crate) fn cost(tree: &Tree) -> f32 {
    let root = tree.bounds.half_area();
    if root <= 0.0 {
        return 0.0;
    }
    let below: f64 = tree
        .nodes
        .par_chunks(4096)
        .map(|nodes| {
            let mut sum = 0.0f64;
            for node in nodes {
                for lane in 0..WIDTH {
                    let child = node.children[lane];
                    let weight = match child {
                        Child::NONE => continue,
                        c if !c.is_leaf() => NODE_COST,
                        c if c.is_instance() => INSTANCE_COST,
                        c => BLOCK_COST * c.block_count() as f32,
                    };
                    sum += f64::from(weight * node.bounds(lane).half_area());
                }
            }
            sum
        })
        .collect::<Vec<_>>()
        .iter()
        .sum();
    NODE_COST + (below / f64::from(root)) as f32
}

/// What is known of a binary node when its parent is looked at.
#[derive(Clone, Copy)]
struct Known {
    costs: Costs,
    /// Is a placed instance among the references below?
    placed: bool,
}

/// Least costs from the leaves up, backwards over pairs of siblings. Pairs stand after their parents, and all below a left
/// child before all below its sibling: so what a pair needs lies on top of a stack, the left child's pair first.
fn choose(binary: &Binary) -> Buffer<Choice> {
    let nodes = &binary.nodes;
    let mut choices = Buffer::<Choice>::zeroed(nodes.len());
    let mut waiting: Vec<[Known; 2]> = Vec::new();
    let mut know = |n: usize, waiting: &mut Vec<[Known; 2]>| {
        let node = &nodes[n];
        if node.count() == 1 {
            let placed = binary.refs[node.link()].is_placed();
            let weight = if placed { INSTANCE_COST } else { BLOCK_COST };
            let costs = [half_area(&node.hull) * weight; WIDTH - 1];
            return Known { costs, placed };
        }
        let below = waiting.pop().expect("a pair is below every inner node");
        choose_one(node, &below, &mut choices[n])
    };
    for left in (1..nodes.len()).step_by(2).rev() {
        if nodes[left].count() == 0 {
            continue;
        }
        let l = know(left, &mut waiting);
        let r = know(left + 1, &mut waiting);
        waiting.push([l, r]);
    }
    know(0, &mut waiting);
    choices
}

/// The choice of an inner node.
#[inline(always)]
fn choose_one(node: &Node2, below: &[Known; 2], choice: &mut Choice) -> Known {
    let area = half_area(&node.hull);
    let count = node.count();
    let [l, r] = below;
    let placed = l.placed || r.placed;
    let (l, r) = (&l.costs, &r.costs);
    let distribute = |children: usize| {
        let (mut best, mut to_left) = (f32::INFINITY, 0);
        for k in 1..children {
            let c = l[k.min(WIDTH - 1) - 1] + r[(children - k).min(WIDTH - 1) - 1];
            if c < best {
                (best, to_left) = (c, k as u8);
            }
        }
        (best, to_left)
    };
    let (cost_below, to_left) = distribute(WIDTH);
    choice[WIDTH - 1] = to_left;
    let as_node = area * NODE_COST + cost_below;
    // Placed instances share no leaf.
    let leaf_allowed = count <= MAX_LEAF && !placed;
    let as_leaf = if leaf_allowed {
        area * BLOCK_COST * count.div_ceil(LANES) as f32
    } else {
        f32::INFINITY
    };
    let mut costs = [0.0; WIDTH - 1];
    choice[0] = u8::from(as_node < as_leaf || !leaf_allowed);
    costs[0] = if choice[0] == 1 { as_node } else { as_leaf };
    for i in 2..WIDTH {
        let (c, to_left) = distribute(i);
        if c < costs[i - 2] {
            costs[i - 1] = c;
            choice[i - 1] = to_left;
        } else {
            costs[i - 1] = costs[i - 2];
        }
    }
    Known { costs, placed }
}

struct Collapser<'a, T> {
    binary: &'a Binary,
    choices: Buffer<Choice>,
    triangles: &'a T,
    watertight: bool,
}

/// A subtree, numbered from its own root.
struct Written {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    depth: usize,
}

/// A child of a wide node: a binary node, and whether it becomes a leaf.
#[derive(Clone, Copy)]
struct Pick {
    binary: usize,
    leaf: bool,
}

impl<T: Triangles> Collapser<'_, T> {
    /// The children of the wide node made of binary node `n`, the most populous first.
    fn picks(&self, n: usize) -> Vec<Pick> {
        let mut picks = Vec::with_capacity(WIDTH);
        let node = &self.binary.nodes[n];
        if node.count() == 1 {
            picks.push(Pick {
                binary: n,
                leaf: true,
            });
            return picks;
        }
        let to_left = usize::from(self.choices[n][WIDTH - 1]);
        self.pick(node.link(), to_left, &mut picks);
        self.pick(node.link() + 1, WIDTH - to_left, &mut picks);
        picks.sort_by_key(|p| self.binary.nodes[p.binary].count());
        picks
    }

    fn pick(&self, n: usize, children: usize, picks: &mut Vec<Pick>) {
        let node = &self.binary.nodes[n];
        if node.count() == 1 {
            picks.push(Pick {
                binary: n,
                leaf: true,
            });
            return;
        }
        let mut children = children.min(WIDTH - 1);
        while children > 1 && self.choices[n][children - 1] == 0 {
            children -= 1;
        }
        if children == 1 {
            picks.push(Pick {
                binary: n,
                leaf: self.choices[n][0] == 0,
            });
            return;
        }
        let to_left = usize::from(self.choices[n][children - 1]);
        self.pick(node.link(), to_left, picks);
        self.pick(node.link() + 1, children - to_left, picks);
    }

    fn write(&self, n: usize) -> Written {
        let mut out = Written {
            nodes: Vec::new(),
            blocks: Vec::new(),
            depth: 0,
        };
        let count = self.binary.nodes[n].count();
        if count <= PARALLEL.max(self.binary.nodes[0].count() / 16) {
            // About what full nodes and nearly full blocks need.
            out.nodes.reserve(count / 20);
            out.blocks.reserve(count / 3);
            self.write_here(n, 1, &mut out);
            return out;
        }
        let picks = self.picks(n);
        let parts: Vec<Option<Written>> = picks
            .par_iter()
            .map(|p| (!p.leaf).then(|| self.write(p.binary)))
            .collect();
        let below = |f: fn(&Written) -> usize| parts.iter().flatten().map(f).sum::<usize>();
        out.nodes.reserve_exact(1 + below(|w| w.nodes.len()));
        out.blocks
            .reserve_exact(below(|w| w.blocks.len()) + WIDTH * MAX_LEAF_BLOCKS);
        out.nodes.push(Node::EMPTY);
        out.depth = 1;
        for (lane, (pick, part)) in picks.iter().zip(parts).enumerate() {
            let child = match part {
                None => self.write_leaf(pick.binary, &mut out),
                Some(part) => {
                    let (nodes, blocks) = (out.nodes.len(), out.blocks.len());
                    out.nodes.extend(part.nodes.into_iter().map(|mut node| {
                        node.children = node.children.map(|c| c.shifted(nodes, blocks));
                        node
                    }));
                    out.blocks.extend_from_slice(&part.blocks);
                    out.depth = out.depth.max(1 + part.depth);
                    Child::node(nodes)
                }
            };
            out.nodes[0].set(
                lane,
                &bounds_of(&self.binary.nodes[pick.binary].hull),
                child,
            );
        }
        out
    }

    fn write_here(&self, n: usize, depth: usize, out: &mut Written) -> Child {
        let at = out.nodes.len();
        out.nodes.push(Node::EMPTY);
        out.depth = out.depth.max(depth);
        for (lane, pick) in self.picks(n).into_iter().enumerate() {
            let child = if pick.leaf {
                self.write_leaf(pick.binary, out)
            } else {
                self.write_here(pick.binary, depth + 1, out)
            };
            out.nodes[at].set(
                lane,
                &bounds_of(&self.binary.nodes[pick.binary].hull),
                child,
            );
        }
        Child::node(at)
    }

    fn write_leaf(&self, n: usize, out: &mut Written) -> Child {
        let nodes = &self.binary.nodes;
        let mut first = n;
        while nodes[first].count() > 1 {
            first = nodes[first].link();
        }
        let first = nodes[first].link();
        let refs = &self.binary.refs[first..first + nodes[n].count()];
        if refs[0].is_placed() {
            return Child::instance(refs[0].primitive() as usize);
        }
        let at = out.blocks.len();
        write_blocks(refs, self.triangles, self.watertight, &mut out.blocks);
        Child::blocks(at, out.blocks.len() - at)
    }
}
