//! Loops over lobes, eight at a time, compiled for the widest vectors of the machine.
//!
//! Elementary functions as polynomials (`exp` by range reduction to a power of two, the arc sine by way of the arc cosine that fields use), which compilers turn into
//! vectors where calls into a maths library stay one by one.
//!
//! No fused operations and no sums in another order: every machine computes the same bytes. Wrong tool where more than six digits are wanted, and where a vector has other
//! than floats in it: [`wide`] only compiles a body twice, what does not vectorize stays as slow as it is.

use occlude_visibility::field::acos;
use std::f32::consts::LOG2_E;

/// Defines a function whose body is compiled twice, and picks at run time.
macro_rules! wide {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) $(-> $ret)? {
            #[inline(always)]
            fn body($($arg: $type),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2($($arg: $type),*) $(-> $ret)? {
                body($($arg),*)
            }

            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the machine has the instructions.
                return unsafe { avx2($($arg),*) };
            }
            body($($arg),*)
        }
    };
}
pub(super) use wide;

/// `exp(x)` for `x` up to 80; 0 below -86. Relative error below 4e-7 near 0, growing by 1.3e-7 a unit of `x` (its own rounding).
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    // 2^y = 2^i 2^f: adding a large number rounds to i and leaves it in the lowest bits.
    const MAGIC: f32 = 12_582_912.0;
    // The best polynomial of degree 5 for 2^f on [-1/2, 1/2] that is 1 at 0 (but for its slope there): relative error 2e-7.
    const C: [f32; 6] = [
        1.0,
        std::f32::consts::LN_2,
        0.240_222_42,
        0.055_507_337,
        0.009_671_513,
        0.001_326_472_7,
    ];
    let y = x.max(-87.0) * LOG2_E;
    let shifted = y + MAGIC;
    let f = y - (shifted - MAGIC);
    let mut p = C[5];
    for c in C[..5].iter().rev() {
        p = p * f + c;
    }
    let power = f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23));
    if x > -86.0 { power } else { 0.0 }
}

/// The arc sine of a number that is clamped to `[-1, 1]`, wrong by less than 1e-6.
#[inline(always)]
pub(super) fn asin(x: f32) -> f32 {
    std::f32::consts::FRAC_PI_2 - acos(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arc_sine_is_one() {
        for i in -10_100..=10_100 {
            let x = i as f32 * 1e-4;
            let error = f64::from(asin(x)) - f64::from(x.clamp(-1.0, 1.0)).asin();
            assert!(error.abs() < 1e-6, "{x}: {error}");
        }
    }

    #[test]
    fn the_exponential_is_one() {
        for i in -90_000..=60_000 {
            let x = i as f32 * 1e-3;
            let expected = f64::from(x).exp();
            let error = (f64::from(exp(x)) - expected).abs();
            assert!(
                error <= (4e-7 + 1.3e-7 * f64::from(x.abs())) * expected + 1e-37,
                "{x}: {} {expected}",
                exp(x)
            );
        }
    }
}
