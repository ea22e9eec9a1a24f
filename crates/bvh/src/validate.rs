//! Checking a structure against its own rules: for tests, and after a refit that one does not trust.

use crate::accel::Accel;
use crate::node::{Block, Bounds, Child, LANES, MAX_DEPTH, NO_TRIANGLE, Tree, WIDTH};
use glam::Vec3;

impl Accel {
    /// Checks everything that traversal takes for granted, and that no triangle is lost. Slow: visits all of it.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn validate(&self) -> Result<(), String> {
        let mut placed_seen = vec![0u32; self.placed.len()];
        self.check_tree(&self.top, &mut placed_seen)
            .map_err(|e| format!("top tree: {e}"))?;
        for (mesh, tree) in self.trees.iter().enumerate() {
            self.check_tree(tree, &mut [])
                .map_err(|e| format!("tree of mesh {mesh}: {e}"))?;
        }
        if let Some(k) = placed_seen.iter().position(|&n| n > 1) {
            return Err(format!(
                "placed instance {k} is in the top tree {} times",
                placed_seen[k]
            ));
        }
        Ok(())
    }

    /// A number that depends on every node and triangle: equal for equal structures.
    pub fn digest(&self) -> u64 {
        // FNV-1a over words.
        let mut digest = 0xcbf2_9ce4_8422_2325u64;
        let mut eat = |bytes: &[u8]| {
            for word in bytes.chunks_exact(4) {
                let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
                digest = (digest ^ u64::from(word)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        };
        for tree in std::iter::once(&self.top).chain(&self.trees) {
            eat(bytemuck::cast_slice(&tree.nodes));
            eat(bytemuck::cast_slice(&tree.blocks));
        }
        digest
    }

    fn check_tree(&self, tree: &Tree, placed_seen: &mut [u32]) -> Result<(), String> {
        if tree.nodes.is_empty() {
            return if tree.blocks.is_empty() {
                Ok(())
            } else {
                Err("blocks without nodes".into())
            };
        }
        let mut node_seen = vec![false; tree.nodes.len()];
        let mut block_seen = vec![false; tree.blocks.len()];
        let mut found = Vec::with_capacity(LANES * tree.blocks.len());
        let mut waiting = vec![(0, tree.bounds, 1)];
        while let Some((index, bounds, depth)) = waiting.pop() {
            if std::mem::replace(&mut node_seen[index], true) {
                return Err(format!("node {index} is reached twice"));
            }
            if depth > tree.depth || depth > MAX_DEPTH {
                return Err(format!("node {index} at depth {depth} of {}", tree.depth));
            }
            for lane in 0..WIDTH {
                let (inside, child) = (
                    tree.nodes[index].bounds(lane),
                    tree.nodes[index].children[lane],
                );
                if child == Child::NONE {
                    if inside.lower != Vec3::INFINITY || inside.upper != Vec3::NEG_INFINITY {
                        return Err(format!("unused child {lane} of node {index} has a box"));
                    }
                    continue;
                }
                if !(bounds.contains(&inside) || inside.is_empty()) {
                    return Err(format!(
                        "child {lane} of node {index} leaves the node's box"
                    ));
                }
                if !child.is_leaf() {
                    if child.index() >= tree.nodes.len() {
                        return Err(format!("child {lane} of node {index} is no node"));
                    }
                    waiting.push((child.index(), inside, depth + 1));
                } else if child.is_instance() {
                    *placed_seen
                        .get_mut(child.index())
                        .ok_or("an instance that does not exist")? += 1;
                } else {
                    let run = child.index()..child.index() + child.block_count();
                    let blocks = tree.blocks.get(run.clone());
                    for (b, block) in run.zip(blocks.ok_or("blocks that do not exist")?) {
                        if std::mem::replace(&mut block_seen[b], true) {
                            return Err(format!("block {b} is reached twice"));
                        }
                        self.check_block(block, &inside, &mut found)
                            .map_err(|e| format!("block {b}: {e}"))?;
                    }
                }
            }
        }
        if node_seen.contains(&false) || block_seen.contains(&false) {
            return Err("a node or block is not reached".into());
        }
        found.sort_unstable();
        let mut triangles = 0;
        for leaves in found.chunk_by(|a, b| a.0 == b.0) {
            triangles += 1;
            if self.options.whole_triangles && leaves.len() > 1 {
                return Err(format!("triangle {} is there twice", leaves[0].0));
            }
            // Each corner lies in the box of some leaf that has the triangle.
            if leaves.iter().fold(0, |all, leaf| all | leaf.1) != self.all_corners() {
                return Err(format!("triangle {} leaves its leaves' boxes", leaves[0].0));
            }
        }
        if triangles != tree.triangles {
            return Err(format!("{triangles} triangles of {}", tree.triangles));
        }
        Ok(())
    }

    /// A bit for each corner that a block holds exactly: the edges of the fast test round.
    fn all_corners(&self) -> u8 {
        if self.is_watertight() { 0b111 } else { 0b1 }
    }

    /// Adds the block's triangles, and which of their corners lie in the leaf's box.
    fn check_block(
        &self,
        block: &Block,
        bounds: &Bounds,
        found: &mut Vec<(u32, u8)>,
    ) -> Result<(), String> {
        for lane in 0..LANES {
            if block.ids[lane] == NO_TRIANGLE {
                if block.corners.iter().flatten().any(|row| row[lane] != 0.0) {
                    return Err(format!("unused lane {lane} is not zero"));
                }
                continue;
            }
            let mut inside = 0;
            for corner in 0..3 {
                let p = Vec3::from_array(std::array::from_fn(|axis| {
                    block.corners[corner][axis][lane]
                }));
                inside |= u8::from(bounds.contains(&Bounds { lower: p, upper: p })) << corner;
            }
            // A triangle that is not finite since a refit is not there to be hit.
            if block.corners.iter().flatten().all(|row| row[lane] == 0.0) {
                inside = self.all_corners();
            }
            found.push((block.ids[lane], inside & self.all_corners()));
        }
        Ok(())
    }
}
