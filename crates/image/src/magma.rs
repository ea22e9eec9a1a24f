//! The colour map `magma` by N. Smith and S. van der Walt (released under CC0 with matplotlib): black, violet, orange,
//! pale yellow, of even perceptual steps.

/// The map at 33 even steps, 0xRRGGBB; linear between them it is within 1.3 of 255 of the original.
const STEPS: [u32; 33] = [
    0x000004, 0x030311, 0x0a0822, 0x130d33, 0x1d1146, 0x28115a, 0x36106a, 0x430f76, 0x50127c,
    0x5d177f, 0x691c81, 0x762181, 0x822681, 0x8f2a81, 0x9c2e7f, 0xa9327d, 0xb63779, 0xc33b75,
    0xcf4170, 0xdb486a, 0xe65163, 0xee5c5e, 0xf5695c, 0xf9785d, 0xfb8761, 0xfd9668, 0xfea571,
    0xfeb47b, 0xfec387, 0xfed194, 0xfde0a2, 0xfceeb0, 0xfcfdbf,
];

/// sRGB bytes of a value in `[0, 1]`; what lies outside is clamped, NaN is black.
pub(crate) fn magma(value: f32) -> [u8; 3] {
    let place = value.clamp(0.0, 1.0) * 32.0;
    let step = (place as usize).min(31);
    let part = if place.is_nan() {
        0.0
    } else {
        place - step as f32
    };
    let channel = |step: usize, shift: u32| (STEPS[step] >> shift & 0xff) as f32;
    [16, 8, 0].map(|shift| {
        let (low, high) = (channel(step, shift), channel(step + 1, shift));
        (low + (high - low) * part).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::magma;

    #[test]
    fn ends_and_order() {
        assert_eq!((magma(0.0), magma(1.0)), ([0, 0, 4], [252, 253, 191]));
        assert_eq!(
            (magma(-1.0), magma(2.0), magma(f32::NAN)),
            (magma(0.0), magma(1.0), magma(0.0))
        );
        let sum = |v: f32| magma(v).iter().map(|&b| u32::from(b)).sum::<u32>();
        assert!(
            (0..100).all(|i| sum(i as f32 / 100.0) <= sum((i + 1) as f32 / 100.0)),
            "brightness must not fall"
        );
    }
}
