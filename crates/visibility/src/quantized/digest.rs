//! From the integers of a key to 64 bits: the upper 32 place a word in a table, the lower 31 tell it from others there.
//!
//! The paper's two digests (Popov 2013, section 4.1, Eq. 10) run over all integers of the pair. Ours is separable: each end
//! is hashed once, and a pair costs one multiplication. With n live words of b digest bits, a look-up that should find
//! nothing finds a stranger with probability `load * 2^-31`, and two of n keys share all 63 bits with about `n^2 / 2^64`
//! (the birthday bound); the tests compare the collisions of every digest against it.

use super::key::{Cell, LightKey};

/// How the integers of a key become 64 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Digest {
    /// Two linear congruential generators (Eq. 10): the paper's choice for the CPU.
    Lcg,
    /// A linear congruential generator and a xor-shift generator in turn: the paper's choice for the GPU.
    LcgXorshift,
    /// Both halves hashed apart and mixed (ours): the fastest where one end asks about many others.
    #[default]
    Separable,
}

impl Digest {
    /// The digest of a pair; `salt` tells epochs apart.
    pub(super) fn pair(self, eye: &Cell, light: &LightKey, salt: u64) -> u64 {
        match self {
            Self::Lcg => lcg_pair(eye, light, salt),
            Self::LcgXorshift => lcg_xorshift(eye, light, salt),
            Self::Separable => mix(eye.half(), light.half() ^ salt),
        }
    }
}

/// Folds a product of 128 bits: every bit of either word reaches every other.
pub(super) fn mix(a: u64, b: u64) -> u64 {
    fold(a ^ 0x9e37_79b9_7f4a_7c15, b ^ 0xd6e8_feb8_6659_fd93)
}

/// The same without the constants, for words that are hashed again.
pub(super) fn fold(a: u64, b: u64) -> u64 {
    // An odd constant keeps a zero word from wiping out the other one.
    let product = u128::from(a ^ 0xa076_1d64_78bd_642f) * u128::from(b ^ 0xe703_7ed1_a0b4_28db);
    product as u64 ^ (product >> 64) as u64
}

/// The integers of a pair, the kind of the light end first.
fn words(eye: &Cell, light: &LightKey, salt: u64) -> impl Iterator<Item = u32> {
    let (light, count) = light.words();
    [salt as u32, (salt >> 32) as u32]
        .into_iter()
        .chain(light.into_iter().take(count))
        .chain(eye.words())
}

/// Eq. 10, with the generators of Numerical Recipes (Press et al. 2007, section 7.1).
fn lcg_pair(eye: &Cell, light: &LightKey, salt: u64) -> u64 {
    let first = |x: u32| x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let second = |x: u32| x.wrapping_mul(22_695_477).wrapping_add(1);
    let (mut kappa, mut check) = (0u32, 0u32);
    for word in words(eye, light, salt) {
        kappa = first(kappa) ^ word;
        check = second(check).wrapping_add(word);
    }
    u64::from(first(kappa)) << 32 | u64::from(second(check))
}

/// The paper's second digest: `d_(n+1) = A(C(d_n)) xor j(n)`.
fn lcg_xorshift(eye: &Cell, light: &LightKey, salt: u64) -> u64 {
    let step = |x: u64| {
        let mut x = x
            .wrapping_mul(2_862_933_555_777_941_757)
            .wrapping_add(7_046_029_254_386_353_087);
        x ^= x >> 21;
        x ^= x << 35;
        x ^ x >> 4
    };
    let digest = words(eye, light, salt).fold(0, |digest, word| step(digest) ^ u64::from(word));
    step(digest)
}
