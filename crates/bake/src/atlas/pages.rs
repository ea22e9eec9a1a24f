//! Rectangles of all instances onto pages.

use super::{Page, Rectangle, skyline};
use glam::UVec2;

/// Objects begin at multiples of this, so that no block of a compressed texture is shared by two.
pub(super) const BLOCK: u32 = 4;

/// Packs rectangles of these sizes, `padding` texels apart, onto as few pages as they need. Pages are at most `page_size` (a multiple of 4) wide and
/// high, and the last one no larger than need be. Every rectangle fits a page.
pub(super) fn pack(sizes: &[UVec2], padding: u32, page_size: u32) -> (Vec<Page>, Vec<Rectangle>) {
    let most = page_size / BLOCK;
    // What is as wide as a page has no neighbour to keep away from.
    let blocks = |i: u32| (sizes[i as usize] + padding).map(|s| s.div_ceil(BLOCK).min(most));
    let mut order: Vec<u32> = (0..sizes.len() as u32).collect();
    order.sort_unstable_by_key(|&i| (std::cmp::Reverse((blocks(i).y, blocks(i).x)), i));
    let packed: Vec<UVec2> = order.iter().map(|&i| blocks(i)).collect();
    let places = skyline::pack(&packed, most);
    let mut rectangles = vec![
        Rectangle {
            page: 0,
            offset: UVec2::ZERO
        };
        sizes.len()
    ];
    let mut used: Vec<UVec2> = Vec::new();
    for (&i, &(page, at)) in order.iter().zip(&places) {
        let offset = at * BLOCK;
        rectangles[i as usize] = Rectangle { page, offset };
        if used.len() <= page as usize {
            used.resize(page as usize + 1, UVec2::ZERO);
        }
        used[page as usize] = used[page as usize].max(offset + sizes[i as usize]);
    }
    let mut first_texel = 0;
    let pages = used.into_iter().map(|size| {
        let size = size.map(|s| s.next_multiple_of(BLOCK));
        let page = Page {
            width: size.x,
            height: size.y,
            first_texel,
        };
        first_texel += page.texels();
        page
    });
    (pages.collect(), rectangles)
}
