//! Visibility over a hemisphere, one bit a texel.

use super::hemisphere::{Grid, Hemisphere, SIDES};
use glam::Vec3;

/// Which directions above a surface point are free: `side * side` bits, row after row of equal `theta`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibilityMap {
    side: u32,
    words: Vec<u64>,
}

/// Some neighbouring texels of a [`VisibilityMap`] together.
#[derive(Clone, Copy, Debug)]
pub struct MapBlock {
    /// Their middle, in the axes side, normal, pole.
    pub direction: Vec3,
    /// Their solid angle times the cosine to the normal.
    pub weight: f32,
    /// The share of them that is free.
    pub free: f32,
}

/// Words that a row takes.
pub(super) fn words_a_row(side: u32) -> usize {
    side.div_ceil(64) as usize
}

impl VisibilityMap {
    /// A map in which everything is free, or nothing. `side` is a power of two from 16 to 1024.
    ///
    /// # Panics
    /// If `side` is another number.
    pub fn new(side: u32, free: bool) -> Self {
        assert!(side.is_power_of_two() && SIDES.contains(&side));
        let last = if side < 64 { (1 << side) - 1 } else { u64::MAX };
        let word = if free { last } else { 0 };
        Self {
            side,
            words: vec![word; words_a_row(side) * side as usize],
        }
    }

    /// Fills a map by a function of the local direction (axes side, normal, pole) of each texel's centre.
    ///
    /// # Panics
    /// If `side` is not a power of two from 16 to 1024.
    pub fn from_fn(side: u32, mut free: impl FnMut(Vec3) -> bool) -> Self {
        let mut map = Self::new(side, false);
        let grid = Grid::of(side);
        for row in 0..side as usize {
            for column in 0..side as usize {
                map.set(row, column, free(grid.direction(row, column)));
            }
        }
        map
    }

    /// Texels along a side.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// Bytes that the bits take.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.words[..])
    }

    /// The bits, row after row, the lowest column in the lowest bit; rows start at whole words.
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// A map from its [`words`](Self::words); `None` if `side` is none of a map or the number of words does not fit.
    pub fn from_words(side: u32, words: Vec<u64>) -> Option<Self> {
        let known = side.is_power_of_two() && SIDES.contains(&side);
        let fits = known && words.len() == words_a_row(side) * side as usize;
        fits.then_some(Self { side, words })
    }

    /// The words of a row.
    #[inline]
    pub(super) fn row(&self, row: usize) -> &[u64] {
        let words = words_a_row(self.side);
        &self.words[row * words..(row + 1) * words]
    }

    /// Whether a texel is free.
    ///
    /// # Panics
    /// If it lies outside.
    #[inline]
    pub fn get(&self, row: usize, column: usize) -> bool {
        self.words[row * words_a_row(self.side) + column / 64] >> (column % 64) & 1 != 0
    }

    /// Sets a texel.
    ///
    /// # Panics
    /// If it lies outside.
    #[inline]
    pub fn set(&mut self, row: usize, column: usize, free: bool) {
        let word = &mut self.words[row * words_a_row(self.side) + column / 64];
        let bit = 1 << (column % 64);
        if free {
            *word |= bit;
        } else {
            *word &= !bit;
        }
    }

    /// Whether a world-space direction is free; below the horizon nothing is.
    pub fn is_free(&self, hemisphere: &Hemisphere, w: Vec3) -> bool {
        let local = hemisphere.to_local(w);
        if local.y <= 0.0 {
            return false;
        }
        let (row, column) = Grid::of(self.side).texel(local);
        self.get(row, column)
    }

    /// The map in 32 by 32 blocks (of its own texels, if it has fewer): for integrals of what is smooth.
    pub fn blocks(&self) -> Vec<MapBlock> {
        const BLOCKS: usize = 32;
        let grid = Grid::of(self.side);
        let blocks = grid.side.min(BLOCKS);
        let coarse = Grid::of(blocks as u32);
        let size = grid.side / blocks;
        let mask = (1u64 << size) - 1;
        let area = (std::f32::consts::PI / blocks as f32).powi(2);
        let mut out = Vec::with_capacity(blocks * blocks);
        for row in 0..blocks {
            let mut free = [0u32; BLOCKS];
            for fine in row * size..(row + 1) * size {
                let words = self.row(fine);
                for (block, free) in free[..blocks].iter_mut().enumerate() {
                    let column = block * size;
                    *free += (words[column / 64] >> (column % 64) & mask).count_ones();
                }
            }
            for (column, free) in free[..blocks].iter().enumerate() {
                let direction = coarse.direction(row, column);
                out.push(MapBlock {
                    direction,
                    weight: coarse.sin[row] * area * direction.y,
                    free: *free as f32 / (size * size) as f32,
                });
            }
        }
        out
    }

    /// Share of the hemisphere's solid angle that differs from another map of the same size.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn difference(&self, other: &Self) -> f32 {
        assert_eq!(self.side, other.side);
        let grid = Grid::of(self.side);
        let wrong = |row: usize| -> u32 {
            let pairs = self.row(row).iter().zip(other.row(row));
            pairs.map(|(a, b)| (a ^ b).count_ones()).sum()
        };
        let sum: f32 = (0..self.side as usize)
            .map(|row| wrong(row) as f32 * grid.sin[row])
            .sum();
        sum / (grid.sin.iter().sum::<f32>() * self.side as f32)
    }

    /// Calls `each` with the texels that differ from one of their eight neighbours, row after row.
    pub(super) fn boundary(&self, mut each: impl FnMut(usize, usize)) {
        let side = self.side as usize;
        let words = words_a_row(self.side);
        for row in 0..side {
            let (up, down) = (row.saturating_sub(1), (row + 1).min(side - 1));
            for word in 0..words {
                let mut differs = self.unlike_neighbours(row, word, [up, row, down]);
                while differs != 0 {
                    let column = word * 64 + differs.trailing_zeros() as usize;
                    differs &= differs - 1;
                    each(row, column);
                }
            }
        }
    }

    /// The texels of a word that differ from a neighbour in one of the rows.
    fn unlike_neighbours(&self, row: usize, word: usize, rows: [usize; 3]) -> u64 {
        let here = self.row(row)[word];
        let last_bits = (self.side as usize - word * 64).min(64);
        let used = if last_bits < 64 {
            (1 << last_bits) - 1
        } else {
            u64::MAX
        };
        let mut differs = 0;
        for other in rows {
            let bits = self.row(other);
            let there = bits[word];
            // What has no neighbour counts itself as one.
            let before = match word {
                0 => there << 1 | (here & 1),
                _ => there << 1 | bits[word - 1] >> 63,
            };
            let top = 1 << (last_bits - 1);
            let after = match bits.get(word + 1) {
                Some(next) => there >> 1 | next << 63,
                None => (there >> 1 & !top) | (here & top),
            };
            differs |= (here ^ there) | (here ^ before) | (here ^ after);
        }
        differs & used
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scrambled(side: u32, seed: u64, one_in: u64) -> VisibilityMap {
        let mut state = seed;
        VisibilityMap::from_fn(side, |_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33).is_multiple_of(one_in)
        })
    }

    #[test]
    fn boundaries_are_those_of_the_eight_neighbours() {
        for side in [16, 32, 64, 128] {
            for one_in in [2, 9, 400] {
                let map = scrambled(side, u64::from(side) + one_in, one_in);
                let mut found = Vec::new();
                map.boundary(|row, column| found.push((row, column)));
                let n = side as i64;
                let mut expected = Vec::new();
                for row in 0..n {
                    for column in 0..n {
                        let unlike = (-1..=1).any(|y: i64| {
                            (-1..=1).any(|x: i64| {
                                let (r, c) = (row + y, column + x);
                                let inside = (0..n).contains(&r) && (0..n).contains(&c);
                                inside
                                    && map.get(r as usize, c as usize)
                                        != map.get(row as usize, column as usize)
                            })
                        });
                        if unlike {
                            expected.push((row as usize, column as usize));
                        }
                    }
                }
                assert_eq!(found, expected, "side {side}, one in {one_in}");
            }
        }
    }

    #[test]
    fn differences_are_shares_of_the_solid_angle() {
        let free = VisibilityMap::new(64, true);
        assert_eq!(free.difference(&free), 0.0);
        assert!((free.difference(&VisibilityMap::new(64, false)) - 1.0).abs() < 1e-5);
        // A cap of 60 degrees about the normal has half of the hemisphere.
        let cap = VisibilityMap::from_fn(64, |w| w.y > 0.5);
        assert!((free.difference(&cap) - 0.5).abs() < 0.01);
    }

    #[test]
    fn words_come_back_and_others_are_refused() {
        let map = scrambled(128, 3, 2);
        assert_eq!(
            VisibilityMap::from_words(128, map.words().to_vec()),
            Some(map.clone())
        );
        assert_eq!(map.bytes(), 2048);
        assert_eq!(VisibilityMap::from_words(128, vec![0; 3]), None);
        assert_eq!(VisibilityMap::from_words(100, vec![0; 200]), None);
    }

    #[test]
    fn nothing_is_free_below_the_horizon() {
        let h = Hemisphere::new(Vec3::Y, Vec3::Z);
        let map = VisibilityMap::new(32, true);
        assert!(map.is_free(&h, Vec3::new(0.6, 0.01, 0.79)));
        assert!(!map.is_free(&h, Vec3::new(0.6, -0.01, 0.79)));
    }
}
