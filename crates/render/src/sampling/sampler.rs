//! Where sample points come from: Owen-scrambled Sobol points or independent numbers.
//!
//! The Sobol points follow Burley, "Practical Hash-Based Owen Scrambling" (JCGT 2020): every group of four numbers (a *dimension
//! set*) is the same four-dimensional Sobol sequence, whose order is shuffled and whose digits are scrambled by a hash of (seed,
//! pixel, set). Within a set the points of one pixel are stratified; sets and pixels are independent of each other ("padding").
//! So an integrand that is a product of low-dimensional parts converges faster than with independent numbers, and no
//! two pixels share a pattern. Of each set, numbers 0 and 1 are the best stratified pair (a (0,2)-sequence): give them to the decision
//! that matters most (a direction, a point on a light) and the third to the choice (lobe, light).
//!
//! Stratification holds for runs of 2^k samples that start at a multiple of 2^k, up to 2^16; each block of 2^16
//! gets a scramble of its own. Wrong tool for: integrands in which single dimensions of *different* sets interact strongly
//! (it is then as good as independent numbers, no worse), and for error that should look like blue noise on the screen.

use sobol_burley::parts::{
    self, Int4, hash_int4, owen_scramble_int4_rev, owen_scramble_rev, sobol_rev,
};
use std::sync::LazyLock;

/// Where sample points come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SamplerKind {
    /// Owen-scrambled Sobol points, padded by dimension sets.
    #[default]
    Sobol,
    /// Independent numbers.
    Independent,
}

/// The sample points of one path: a pure function of seed, pixel, sample index and dimension.
///
/// Small and `Copy`, so that a batch of paths can keep one each.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    kind: SamplerKind,
    pixel_seed: u32,
    sample: u32,
    dimension: u32,
}

/// Bits of the sample index that the Sobol generator knows.
const SOBOL_INDEX_BITS: u32 = 16;

impl Sampler {
    /// The points of sample number `sample` of a pixel.
    #[inline]
    pub fn new(kind: SamplerKind, seed: u64, pixel: [u32; 2], sample: u32) -> Self {
        let [a, b, c, d] = pcg4d([pixel[0], pixel[1], seed as u32, (seed >> 32) as u32]);
        Self {
            kind,
            pixel_seed: a ^ b ^ c ^ d,
            sample,
            dimension: 0,
        }
    }

    /// Goes to a dimension set, so that the n-th decision of every path uses the same dimensions.
    #[inline]
    pub fn jump(&mut self, dimension_set: u32) {
        self.dimension = dimension_set;
    }

    /// The next four numbers in `[0, 1)`: one dimension set.
    #[allow(clippy::should_implement_trait)]
    #[inline]
    pub fn next(&mut self) -> [f32; 4] {
        let set = self.dimension;
        self.dimension = set.wrapping_add(1);
        match self.kind {
            SamplerKind::Sobol => {
                let block = self.sample >> SOBOL_INDEX_BITS;
                let seed = hash(self.pixel_seed ^ hash(set ^ block.wrapping_mul(0x9e37_79b9)));
                sobol_4d(self.sample & ((1 << SOBOL_INDEX_BITS) - 1), seed)
            }
            SamplerKind::Independent => {
                pcg4d([self.pixel_seed, self.sample, set, 0x243f_6a88]).map(unit_float)
            }
        }
    }
}

/// The first four Sobol dimensions of the upper and of the lower byte of a bit-reversed 16-bit index. The sequence is linear over
/// bits, so two look-ups replace a loop over bits that no branch predictor can follow.
static SOBOL_BYTES: LazyLock<Box<[[[u32; 4]; 256]; 2]>> = LazyLock::new(|| {
    let mut table = Box::new([[[0; 4]; 256]; 2]);
    for (part, shift) in [(0, 24), (1, 16)] {
        for (byte, entry) in (0_u32..).zip(&mut table[part]) {
            *entry = std::array::from_fn(|d| sobol_rev(byte << shift, d as u32));
        }
    }
    table
});

/// What `sobol_burley::sample_4d(index, 0, seed)` gives, to the bit.
#[inline]
fn sobol_4d(index: u32, seed: u32) -> [f32; 4] {
    let shuffled = owen_scramble_rev(index.reverse_bits(), parts::hash(seed ^ 0x79c6_8e4a));
    let [upper, lower] = &**SOBOL_BYTES;
    let point = Int4::from(upper[(shuffled >> 24) as usize])
        ^ Int4::from(lower[(shuffled >> 16 & 0xff) as usize]);
    let scramble = seed.wrapping_mul(0x9c8f_2d3b);
    let scramble = [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8].map(|d: u32| d ^ scramble);
    owen_scramble_int4_rev(point, hash_int4(scramble.into()))
        .reverse_bits()
        .to_f32_norm()
}

/// The upper 24 bits as a number in `[0, 1)`: exact, never 1.
#[inline]
fn unit_float(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A bijective mixer of 32 bits (Wellons' `lowbias32` constants, <https://nullprogram.com/blog/2018/07/31/>), offset so that 0 is no fixed point.
#[inline]
fn hash(value: u32) -> u32 {
    let mut x = value.wrapping_add(0x6a09_e667);
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Four words to four words: Jarzynski & Olano, "Hash Functions for GPU Rendering" (JCGT 2020), pcg4d.
#[inline]
fn pcg4d(words: [u32; 4]) -> [u32; 4] {
    let [mut x, mut y, mut z, mut w] =
        words.map(|v| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    for round in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        if round == 0 {
            [x, y, z, w] = [x, y, z, w].map(|v| v ^ (v >> 16));
        }
    }
    [x, y, z, w]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_holds_the_sequence() {
        for i in 0..70_000_u32 {
            let seed = hash(i);
            let index = i & 0xffff;
            assert_eq!(
                sobol_4d(index, seed),
                sobol_burley::sample_4d(index, 0, seed)
            );
        }
    }
}
