//! The order in which a picture's places should ask: coherent, yet spread everywhere from the start.
//!
//! Popov 2013, section 4.3. A cluster's first asker decides for all; asked in scan-line order, shadows shift towards the
//! bottom right and refinement finds its neighbours on one side only. So places are visited in the order of a Halton
//! sequence with bases 2 and 3, of which every prefix is well spread, cut into segments, each [`GROWTH`]^2 times denser than
//! what came before; inside a segment places follow the Morton curve, so that neighbours ask soon after each other.

use std::ops::Range;

/// By how much finer than the former a segment's places lie along each axis (`C_PG`).
pub const GROWTH: f32 = 3.7;

/// Cuts `count` places into segments with the boundaries 0, `first`, `first * GROWTH^2`, ... `first` is the number of
/// clusters that the places fill (`C_PI`, the number of places over `C_E^2`); at least 1 is taken.
pub fn segments(count: usize, first: f32) -> impl Iterator<Item = Range<usize>> {
    let mut boundary = f64::from(first.max(1.0));
    let mut start = 0;
    std::iter::from_fn(move || {
        if start >= count {
            return None;
        }
        let end = (boundary as usize).clamp(start + 1, count);
        boundary *= f64::from(GROWTH * GROWTH);
        let segment = start..end;
        start = end;
        Some(segment)
    })
}

/// All places `[x, y]` of a `width` x `height` lattice, each once, in asking order, for segments that start with `first`
/// places (see [`segments`]). Takes O(n log n) time, and 6/5 to 36 times `n` steps to enumerate the sequence.
///
/// # Panics
/// If a side is above 65536.
pub fn progressive(width: u32, height: u32, first: f32) -> Vec<[u32; 2]> {
    assert!(width <= 1 << 16 && height <= 1 << 16);
    let (mut columns, mut rows) = (1u64, 1u64);
    while columns < u64::from(width) {
        columns *= 2;
    }
    while rows < u64::from(height) {
        rows *= 3;
    }
    let mut places = Vec::with_capacity(width as usize * height as usize);
    for i in 0..columns * rows {
        // The first digits of the two radical inverses, as whole numbers: a bijection by the Chinese remainder theorem.
        let x = radical_inverse(i % columns, 2, columns);
        let y = radical_inverse(i % rows, 3, rows);
        if x < u64::from(width) && y < u64::from(height) {
            places.push([x as u32, y as u32]);
        }
    }
    for segment in segments(places.len(), first) {
        places[segment].sort_unstable_by_key(|&[x, y]| spread(x) | spread(y) << 1);
    }
    places
}

/// The digits of `i` in base `base` mirrored, below `limit`, a power of the base.
fn radical_inverse(mut i: u64, base: u64, limit: u64) -> u64 {
    let (mut inverse, mut weight) = (0, limit);
    while weight > 1 {
        weight /= base;
        inverse += i % base * weight;
        i /= base;
    }
    inverse
}

/// A zero between any two bits: half of a Morton code (Morton 1966).
fn spread(x: u32) -> u64 {
    let mut x = u64::from(x);
    x = (x | x << 16) & 0x0000_ffff_0000_ffff;
    x = (x | x << 8) & 0x00ff_00ff_00ff_00ff;
    x = (x | x << 4) & 0x0f0f_0f0f_0f0f_0f0f;
    x = (x | x << 2) & 0x3333_3333_3333_3333;
    (x | x << 1) & 0x5555_5555_5555_5555
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_place_once() {
        for (width, height) in [
            (1, 1),
            (1, 7),
            (7, 1),
            (32, 32),
            (33, 17),
            (81, 64),
            (100, 3),
        ] {
            let mut places = progressive(width, height, 5.0);
            assert_eq!(places.len(), (width * height) as usize);
            places.sort_unstable();
            places.dedup();
            assert_eq!(places.len(), (width * height) as usize);
            assert!(places.iter().all(|&[x, y]| x < width && y < height));
        }
    }

    #[test]
    fn segments_cover_without_overlap() {
        for (count, first) in [(1, 0.0), (10, 100.0), (1000, 7.5), (1 << 20, 64.0)] {
            let all: Vec<_> = segments(count, first).collect();
            assert_eq!(all[0].start, 0);
            assert_eq!(all.last().map(|s| s.end), Some(count));
            assert!(
                all.windows(2)
                    .all(|pair| pair[0].end == pair[1].start && !pair[1].is_empty())
            );
        }
    }

    /// Star discrepancy over boxes with corners at places: every segment boundary ends a prefix that covers all parts of the
    /// picture alike, far better than random points would (about 1 / sqrt(n)).
    #[test]
    fn prefixes_are_well_spread() {
        let (width, height, first) = (128, 81, 50.0);
        let places = progressive(width, height, first);
        for segment in segments(places.len(), first) {
            let prefix = &places[..segment.end];
            let n = prefix.len() as f64;
            let mut worst = 0.0f64;
            for x in (4..=width).step_by(4) {
                for y in (3..=height).step_by(3) {
                    let inside = prefix.iter().filter(|p| p[0] < x && p[1] < y).count() as f64;
                    let area = f64::from(x * y) / f64::from(width * height);
                    worst = worst.max((inside / n - area).abs());
                }
            }
            let random = 1.0 / n.sqrt();
            assert!(
                worst < 0.7 * random || n == places.len() as f64,
                "{worst} of {n} places"
            );
            // And better than that: like log(n)^2 / n.
            assert!(worst < n.ln() * n.ln() / n, "{worst} of {n} places");
        }
    }
}
