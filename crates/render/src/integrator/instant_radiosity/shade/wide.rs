//! Eight numbers at once.
//!
//! Both forms round alike and use no fused operations, so that every machine computes the same bytes.

/// Eyes that are shaded together.
pub(super) const WIDE: usize = 8;

/// A number for each of eight eyes, in memory.
pub(super) type Row = [f32; WIDE];

/// A number for each of eight eyes, or a pattern of bits for each.
pub(super) trait Wide: Copy {
    fn splat(x: f32) -> Self;
    fn load(row: &Row) -> Self;
    fn store(self, row: &mut Row);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn sqrt(self) -> Self;
    /// The smaller; `other` if they cannot be compared.
    fn min(self, other: Self) -> Self;
    /// The larger; `other` if they cannot be compared.
    fn max(self, other: Self) -> Self;
    /// All bits where `self` is greater.
    fn greater(self, other: Self) -> Self;
    fn splat_bits(bits: u32) -> Self;
    fn load_bits(row: &[u32; WIDE]) -> Self;
    fn store_bits(self, row: &mut [u32; WIDE]);
    fn and(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;
    /// All bits where `self` has all of the bits of `other`.
    fn has(self, other: Self) -> Self;
    /// Whether any highest bit is set.
    fn any(self) -> bool;
}

/// The form of any machine.
#[derive(Clone, Copy)]
pub(super) struct Plain(Row);

impl Plain {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }

    #[inline(always)]
    fn zip_bits(self, other: Self, f: impl Fn(u32, u32) -> u32) -> Self {
        self.zip(other, |a, b| f32::from_bits(f(a.to_bits(), b.to_bits())))
    }
}

impl Wide for Plain {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; WIDE])
    }
    #[inline(always)]
    fn load(row: &Row) -> Self {
        Self(*row)
    }
    #[inline(always)]
    fn store(self, row: &mut Row) {
        *row = self.0;
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn greater(self, other: Self) -> Self {
        let all = |yes: bool| f32::from_bits(if yes { u32::MAX } else { 0 });
        self.zip(other, |a, b| all(a > b))
    }
    #[inline(always)]
    fn splat_bits(bits: u32) -> Self {
        Self::splat(f32::from_bits(bits))
    }
    #[inline(always)]
    fn load_bits(row: &[u32; WIDE]) -> Self {
        Self(row.map(f32::from_bits))
    }
    #[inline(always)]
    fn store_bits(self, row: &mut [u32; WIDE]) {
        *row = self.0.map(f32::to_bits);
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self.zip_bits(other, |a, b| a & b)
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self.zip_bits(other, |a, b| a | b)
    }
    #[inline(always)]
    fn has(self, other: Self) -> Self {
        self.zip_bits(other, |a, b| if a & b == b { u32::MAX } else { 0 })
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0.iter().any(|x| x.is_sign_negative())
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Row, WIDE, Wide};
    use std::arch::x86_64::*;

    /// The form of processors with AVX2. To be used only in functions that are compiled for it, which are entered only on such
    /// processors: that is the proof that every unsafe block below asks for. Rows may lie anywhere: loads and stores are
    /// the unaligned ones, of the whole row that the reference is to.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256);

    impl Avx2 {
        #[inline(always)]
        fn bits(self) -> __m256i {
            // SAFETY: see `Avx2`.
            unsafe { _mm256_castps_si256(self.0) }
        }
    }

    impl Wide for Avx2 {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_set1_ps(x) })
        }
        #[inline(always)]
        fn load(row: &Row) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_loadu_ps(row.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, row: &mut Row) {
            // SAFETY: see `Avx2`.
            unsafe { _mm256_storeu_ps(row.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_add_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_sub_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_mul_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_div_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn greater(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, other.0) })
        }
        #[inline(always)]
        fn splat_bits(bits: u32) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_castsi256_ps(_mm256_set1_epi32(bits.cast_signed())) })
        }
        #[inline(always)]
        fn load_bits(row: &[u32; WIDE]) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_castsi256_ps(_mm256_loadu_si256(row.as_ptr().cast())) })
        }
        #[inline(always)]
        fn store_bits(self, row: &mut [u32; WIDE]) {
            // SAFETY: see `Avx2`.
            unsafe { _mm256_storeu_si256(row.as_mut_ptr().cast(), self.bits()) }
        }
        #[inline(always)]
        fn and(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_and_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn or(self, other: Self) -> Self {
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_or_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn has(self, other: Self) -> Self {
            let (a, b) = (self.bits(), other.bits());
            // SAFETY: see `Avx2`.
            Self(unsafe { _mm256_castsi256_ps(_mm256_cmpeq_epi32(_mm256_and_si256(a, b), b)) })
        }
        #[inline(always)]
        fn any(self) -> bool {
            // SAFETY: see `Avx2`.
            unsafe { _mm256_movemask_ps(self.0) != 0 }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;
