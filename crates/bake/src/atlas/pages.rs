//! What hangs on a node becomes a block, blocks go onto pages.

use super::{Block, Page, Rectangle, skyline};
use glam::UVec2;
use std::collections::BTreeMap;

/// Objects begin at multiples of this, so that no block of a compressed texture is shared by two.
pub(super) const BLOCK: u32 = 4;

/// The layouts of one node at one place: they are kept together, so that an engine needs one page and one rectangle for them.
pub(super) struct Group {
    pub node: u32,
    /// Which of the node's places it is.
    pub occurrence: u32,
    /// Indices into the layouts, in the order of instances.
    pub layouts: Vec<u32>,
}

/// Pages, the blocks on them, and a rectangle for every piece of every layout of every group, in that order.
#[derive(Default)]
pub(super) struct Packed {
    pub pages: Vec<Page>,
    pub blocks: Vec<Block>,
    pub rectangles: Vec<Rectangle>,
}

/// How the pieces of a group lie in its blocks.
#[derive(Clone)]
struct Arrangement {
    /// Block and offset of every piece.
    pieces: Vec<skyline::Place>,
    blocks: Vec<UVec2>,
}

/// Packs the groups' pieces, whose sizes `pieces` gives by layout, `padding` texels apart, onto as few pages as they need. Pages are at most
/// `page_size` (a multiple of 4) wide and high, and the last one no larger than need be. Every piece fits a page.
pub(super) fn pack(
    groups: &[Group],
    pieces: impl Fn(u32) -> Vec<UVec2>,
    padding: u32,
    page_size: u32,
) -> Packed {
    let most = page_size / BLOCK;
    let mut known: BTreeMap<&[u32], Arrangement> = BTreeMap::new();
    let mut packed = Packed::default();
    for group in groups {
        let arrangement = known.entry(&group.layouts).or_insert_with(|| {
            let sizes: Vec<UVec2> = group.layouts.iter().flat_map(|&l| pieces(l)).collect();
            arrange(&sizes, padding, page_size)
        });
        let first = packed.blocks.len() as u32;
        packed
            .rectangles
            .extend(arrangement.pieces.iter().map(|&(block, at)| Rectangle {
                page: 0,
                offset: at,
                block: first + block,
            }));
        packed
            .blocks
            .extend(arrangement.blocks.iter().map(|&size| Block {
                node: group.node,
                occurrence: group.occurrence,
                page: 0,
                offset: UVec2::ZERO,
                size,
            }));
    }
    // What is as wide as a page has no neighbour to keep away from.
    let cells = |b: &Block| (b.size + padding).map(|s| s.div_ceil(BLOCK).min(most));
    let (order, sizes) = tall_first(packed.blocks.iter().map(cells));
    let mut used: Vec<UVec2> = Vec::new();
    for (&i, &(page, at)) in order.iter().zip(&skyline::pack(&sizes, most)) {
        let block = &mut packed.blocks[i as usize];
        (block.page, block.offset) = (page, at * BLOCK);
        grow(&mut used, page, block.offset + block.size);
    }
    for rectangle in &mut packed.rectangles {
        let block = &packed.blocks[rectangle.block as usize];
        rectangle.page = block.page;
        rectangle.offset += block.offset;
    }
    let mut first_texel = 0;
    for size in used {
        let size = size.map(|s| s.next_multiple_of(BLOCK));
        let page = Page {
            width: size.x,
            height: size.y,
            first_texel,
        };
        first_texel += page.texels();
        packed.pages.push(page);
    }
    packed
}

fn arrange(sizes: &[UVec2], padding: u32, page_size: u32) -> Arrangement {
    let (order, padded) = tall_first(sizes.iter().map(|&s| s + padding));
    let mut pieces = vec![(0, UVec2::ZERO); sizes.len()];
    let mut blocks = Vec::new();
    for (&i, &(block, at)) in order
        .iter()
        .zip(&skyline::pack(&padded, page_size + padding))
    {
        pieces[i as usize] = (block, at);
        grow(&mut blocks, block, at + sizes[i as usize]);
    }
    Arrangement { pieces, blocks }
}

fn grow(sizes: &mut Vec<UVec2>, bin: u32, to: UVec2) {
    if sizes.len() <= bin as usize {
        sizes.resize(bin as usize + 1, UVec2::ZERO);
    }
    let size = &mut sizes[bin as usize];
    *size = size.max(to);
}

/// The order in which rectangles pack best, and the rectangles in that order.
fn tall_first(sizes: impl Iterator<Item = UVec2>) -> (Vec<u32>, Vec<UVec2>) {
    let mut sorted: Vec<(u32, UVec2)> = (0..).zip(sizes).collect();
    sorted.sort_unstable_by_key(|&(i, s)| (std::cmp::Reverse((s.y, s.x)), i));
    sorted.into_iter().unzip()
}
