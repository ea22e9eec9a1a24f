//! Rectangles of all instances onto pages.

use super::skyline::Skyline;
use super::{Page, Rectangle};
use glam::UVec2;

/// Objects begin at multiples of this, so that no block of a compressed texture is shared by two.
const BLOCK: u32 = 4;

/// Packs rectangles of these sizes, `padding` texels apart, onto as few pages as they need; pages are at most `page_size` wide and high,
/// and the last ones no larger than need be. Every rectangle fits a page.
pub(super) fn pack(sizes: &[UVec2], padding: u32, page_size: u32) -> (Vec<Page>, Vec<Rectangle>) {
    let blocks = |size: UVec2| (size + padding).map(|s| s.div_ceil(BLOCK));
    let most = (page_size + padding).div_ceil(BLOCK);
    let mut order: Vec<u32> = (0..sizes.len() as u32).collect();
    let key = |i: u32| blocks(sizes[i as usize]);
    order.sort_unstable_by_key(|&i| (std::cmp::Reverse((key(i).y, key(i).x)), i));

    let mut rectangles = vec![Rectangle { page: 0, offset: UVec2::ZERO }; sizes.len()];
    let mut used: Vec<UVec2> = Vec::new();
    let mut rest = order;
    while !rest.is_empty() {
        let area = |list: &[u32]| list.iter().map(|&i| u64::from(key(i).x) * u64::from(key(i).y)).sum::<u64>();
        let widest = rest.iter().map(|&i| key(i).max_element()).max().unwrap_or(1);
        let wanted = ((area(&rest) as f64).sqrt() as u32).max(widest);
        // The smallest page that takes all that is left, or the largest there is.
        let mut side = wanted.min(most);
        loop {
            let mut page = Skyline::new(UVec2::splat(side));
            let mut left = Vec::new();
            for &i in &rest {
                match page.place(key(i)) {
                    Some(at) => {
                        rectangles[i as usize] = Rectangle { page: used.len() as u32, offset: at * BLOCK };
                    }
                    None => left.push(i),
                }
            }
            if left.is_empty() || side == most {
                rest = left;
                break;
            }
            side = (side + side / 24 + 1).min(most);
        }
        used.push(UVec2::ZERO);
    }
    for (rectangle, &size) in rectangles.iter().zip(sizes) {
        let page = &mut used[rectangle.page as usize];
        *page = page.max(rectangle.offset + size);
    }
    let mut first_texel = 0;
    let pages = used.into_iter().map(|size| {
        let size = size.map(|s| s.next_multiple_of(BLOCK).min(page_size.max(s)));
        let page = Page { width: size.x, height: size.y, first_texel };
        first_texel += page.texels();
        page
    });
    (pages.collect(), rectangles)
}
