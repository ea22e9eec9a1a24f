//! Random numbers for test cases and benchmarks: small, seeded, the same everywhere.
//!
//! SplitMix64 (Steele, Lea & Flood 2014). Not the renderer's: a test that shares the generator of what it tests shares its faults.

use glam::{Vec2, Vec3};

/// The generator; its field is the seed.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// An index below `n` (0 if `n` is 0), all but equally likely.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
    }

    /// Uniform in the unit square.
    pub fn pair(&mut self) -> Vec2 {
        Vec2::new(self.unit(), self.unit())
    }

    /// Uniform in the cube from -1 to 1.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }

    /// A uniform unit vector.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let p = self.point();
            if (0.01..1.0).contains(&p.length_squared()) {
                return p.normalize();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_the_published_ones() {
        // First numbers of Vigna's splitmix64.c from seed 1234567.
        let mut random = Random(1_234_567);
        let bits: [u64; 3] = std::array::from_fn(|_| random.bits());
        assert_eq!(
            bits,
            [
                6_457_827_717_110_365_317,
                3_203_168_211_198_807_973,
                9_817_491_932_198_370_423
            ]
        );
    }

    #[test]
    fn numbers_are_in_their_ranges() {
        let mut random = Random(1);
        assert_eq!(random.below(0), 0);
        let mut mean = Vec3::ZERO;
        for _ in 0..10_000 {
            assert!((0.0..1.0).contains(&random.unit()) && random.below(3) < 3);
            let d = random.direction();
            assert!(d.is_normalized());
            mean += d / 10_000.0;
        }
        assert!(mean.length() < 0.04, "{mean}");
    }
}
