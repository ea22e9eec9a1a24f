//! What every side of every texel sends out, packed: the map that bundles read.
//!
//! A side takes 32 bits: three mantissas of 9 bits and an exponent that they share, relative to the brightest value (as the texture
//! format RGB9E5, whose range of 2^40 lets a lamp and a cellar stand in one map). The map is what bundles read at random,
//! so its size counts. Mantissas are rounded up or down by chance, a hash of the side, so that means are kept: the error is below
//! 0.2 % of the largest channel, and independent from side to side.

use glam::Vec3;
use occlude_bvh::Buffer;
use rayon::prelude::*;
use std::ops::Range;

/// Mantissas of 9 bits.
pub(super) const MANTISSA_BITS: u32 = 9;

/// The radiance of all sides.
#[derive(Clone, Debug)]
pub struct Radiance {
    /// On huge pages: they are read at random.
    packed: Buffer<u32>,
    scale: Scale,
}

/// What packed numbers are relative to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    /// The value of mantissa 1 at exponent 0.
    least: f32,
    brightest: f32,
}

impl Scale {
    fn new(brightest: f32) -> Self {
        let brightest = brightest.clamp(f32::MIN_POSITIVE * 1e20, f32::MAX);
        let top = (1 << MANTISSA_BITS) - 1;
        Self {
            least: brightest / top as f32 / 2f32.powi(31),
            brightest,
        }
    }

    /// Packs a radiance; `chance` (32 random bits) rounds.
    fn pack(&self, radiance: Vec3, chance: u32) -> u32 {
        // NaN becomes 0, too.
        let radiance = radiance.max(Vec3::ZERO).min(Vec3::splat(self.brightest));
        let largest = radiance.max_element();
        if largest < self.least {
            return 0;
        }
        let steps = largest / self.least;
        let exponent =
            (steps.log2().floor() as i32 - (MANTISSA_BITS as i32 - 1)).clamp(0, 31) as u32;
        // The largest mantissa may round up to 512: then the next exponent takes it.
        let exponent = if steps * 2f32.powi(-(exponent as i32)) > 510.999 && exponent < 31 {
            exponent + 1
        } else {
            exponent
        };
        let per_step = 1.0 / (self.least * 2f32.powi(exponent as i32));
        let mantissa = |channel: usize| {
            let chance = (chance >> (8 * channel) & 0xff) as f32 / 256.0 + 1.0 / 512.0;
            ((radiance[channel] * per_step + chance) as u32).min(511)
        };
        mantissa(0) | mantissa(1) << 9 | mantissa(2) << 18 | exponent << 27
    }

    /// The value of mantissa 1 at exponent 0.
    pub(super) fn least(&self) -> f32 {
        self.least
    }
}

/// A packed radiance; `least` is the value of mantissa 1 at exponent 0.
#[inline]
pub(super) fn unpack(packed: u32, least: f32) -> Vec3 {
    let step = least * (1u64 << (packed >> 27)) as f32;
    let mantissa = |shift: u32| (packed >> shift & 511) as f32 * step;
    Vec3::new(mantissa(0), mantissa(9), mantissa(18))
}

impl Radiance {
    /// Bytes of a map of `sides` sides.
    pub fn bytes(sides: u32) -> u64 {
        u64::from(sides) * 4
    }

    /// Packs what `radiance` says of each side, W/(m² sr). Values above `brightest` are cut off; negative ones and such that
    /// are no number count as 0.
    pub fn new(sides: u32, brightest: f32, radiance: impl Fn(u32) -> Vec3 + Sync) -> Self {
        let mut map = Self::black(sides, brightest);
        map.fill(0..sides, radiance);
        map
    }

    /// A map of nothing, with room for values up to `brightest`.
    pub fn black(sides: u32, brightest: f32) -> Self {
        Self {
            packed: Buffer::zeroed(sides as usize),
            scale: Scale::new(brightest),
        }
    }

    /// Packs what `radiance` says of some sides, as [`Radiance::new`] does.
    ///
    /// # Panics
    /// If there are no such sides.
    pub fn fill(&mut self, sides: Range<u32>, radiance: impl Fn(u32) -> Vec3 + Sync) {
        let scale = self.scale;
        self.packed[sides.start as usize..sides.end as usize]
            .par_iter_mut()
            .with_min_len(4096)
            .zip(sides)
            .for_each(|(packed, side)| *packed = scale.pack(radiance(side), hash(side)));
    }

    /// The radiance of a side, as rounded.
    pub fn get(&self, side: u32) -> Vec3 {
        unpack(self.packed[side as usize], self.scale.least)
    }

    /// Number of sides.
    pub fn len(&self) -> u32 {
        self.packed.len() as u32
    }

    /// Whether there are no sides.
    pub fn is_empty(&self) -> bool {
        self.packed.is_empty()
    }

    /// Values above this are cut off.
    pub fn brightest(&self) -> f32 {
        self.scale.brightest
    }

    /// One more value in the map's format; `chance` (32 random bits) rounds.
    pub(super) fn pack(&self, radiance: Vec3, chance: u32) -> u32 {
        self.scale.pack(radiance, chance)
    }

    pub(super) fn packed(&self) -> &[u32] {
        &self.packed
    }

    pub(super) fn scale(&self) -> Scale {
        self.scale
    }
}

/// A mixer of 32 bits (Wellons' lowbias32).
#[inline]
pub(super) fn hash(value: u32) -> u32 {
    let mut x = value.wrapping_add(0x9e37_79b9);
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_any_size_come_back() {
        for exponent in -30..=0 {
            for k in 0..50 {
                let value = Vec3::new(0.3, 1.0, 0.01)
                    * (1.0 + k as f32 * 0.02)
                    * 2f32.powi(exponent)
                    * 40.0;
                let map = Radiance::new(256, 100.0, |_| value);
                let mut mean = Vec3::ZERO;
                for side in 0..256 {
                    let error = (map.get(side) - value).abs().max_element();
                    assert!(error < value.max_element() / 250.0, "{value}");
                    mean += map.get(side) / 256.0;
                }
                assert!((mean - value).abs().max_element() < value.max_element() / 2500.0);
            }
        }
    }

    #[test]
    fn odd_values_do_no_harm() {
        let map = Radiance::new(4, 2.0, |side| {
            [
                Vec3::splat(f32::NAN),
                Vec3::splat(-1.0),
                Vec3::splat(9.0),
                Vec3::splat(f32::INFINITY),
            ][side as usize]
        });
        assert_eq!(map.get(0), Vec3::ZERO);
        assert_eq!(map.get(1), Vec3::ZERO);
        assert!((map.get(2) - Vec3::splat(2.0)).abs().max_element() < 0.01);
        assert!((map.get(3) - Vec3::splat(2.0)).abs().max_element() < 0.01);
        let black = Radiance::new(1, 0.0, |_| Vec3::ZERO);
        assert_eq!(black.get(0), Vec3::ZERO);
    }
}
