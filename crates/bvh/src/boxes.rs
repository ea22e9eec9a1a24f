//! Boxes around what a structure holds, coarser than its leaves.

use crate::accel::Accel;
use crate::node::{Bounds, Child, WIDTH};
use glam::Vec3;

impl Accel {
    /// At most `most` boxes (but one at least, if there is anything to hit) that together hold all triangles, in world space,
    /// lower and upper corners: the largest boxes of the tree are opened first.
    pub fn boxes(&self, most: usize) -> Vec<(Vec3, Vec3)> {
        let nodes = &self.top().nodes;
        let Some((lower, upper)) = self.bounds().filter(|_| !nodes.is_empty()) else {
            return Vec::new();
        };
        let mut boxes = vec![(Bounds { lower, upper }, Child::node(0))];
        // Boxes that stay closed: leaves, and nodes with more children than there is room for.
        let mut closed = vec![false];
        loop {
            let open = (0..boxes.len()).filter(|&i| !closed[i]);
            let area = |i: &usize| boxes[*i].0.half_area();
            let Some(largest) = open.max_by(|a, b| area(a).total_cmp(&area(b))) else {
                break;
            };
            let child = boxes[largest].1;
            let children: Vec<(Bounds, Child)> = if child.is_leaf() {
                Vec::new()
            } else {
                let node = &nodes[child.index()];
                (0..WIDTH)
                    .filter(|&lane| node.children[lane] != Child::NONE)
                    .map(|lane| (node.bounds(lane), node.children[lane]))
                    .collect()
            };
            if children.is_empty() || boxes.len() + children.len() - 1 > most {
                closed[largest] = true;
                continue;
            }
            boxes.swap_remove(largest);
            closed.swap_remove(largest);
            closed.resize(closed.len() + children.len(), false);
            boxes.extend(children);
        }
        let corners = |(bounds, _): (Bounds, Child)| (bounds.lower, bounds.upper);
        boxes.into_iter().map(corners).collect()
    }
}
