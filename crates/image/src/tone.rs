//! From scene-linear radiance to what a display shows.
//!
//! Exposure first (a factor of `2^EV`), then the tone map to linear display light in `[0, 1]`, then the sRGB curve
//! (IEC 61966-2-1). Only PNG passes through here; EXR and HDR stay linear.
//!
//! | name | formula |
//! |---|---|
//! | `neutral` (default) | Khronos PBR Neutral Tone Mapper, specification of 2024 (github.com/KhronosGroup/ToneMapping) |
//! | `agx` | AgX base look of T. Sobotka, in Rec. 2020 with the polynomial of B. Wrensch (iolite-engine.com), constants as in Filament and three.js |
//! | `aces` | K. Narkowicz, "ACES Filmic Tone Mapping Curve", 2015, a curve on each channel |
//! | `reinhard` | Reinhard et al., "Photographic Tone Reproduction", 2002, eq. 3, on luminance |
//! | `none` | clipped at 1 |
//!
//! `neutral` is the default because it leaves colours below 0.76 as they are but for a small offset: what an artist put into a base colour
//! under white light of strength 1 is what the display shows, and highlights still fade to white.

use std::str::FromStr;

use crate::picture::luminance;

/// How radiance becomes display light. See the module's table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ToneMap {
    /// Khronos PBR Neutral.
    #[default]
    Neutral,
    /// AgX, base look.
    Agx,
    /// A fitted ACES curve.
    Aces,
    /// Reinhard's global operator.
    Reinhard,
    /// Values above 1 are cut.
    None,
}

impl ToneMap {
    /// Every tone map, the default first.
    pub const ALL: [ToneMap; 5] = [
        ToneMap::Neutral,
        ToneMap::Agx,
        ToneMap::Aces,
        ToneMap::Reinhard,
        ToneMap::None,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            ToneMap::Neutral => "neutral",
            ToneMap::Agx => "agx",
            ToneMap::Aces => "aces",
            ToneMap::Reinhard => "reinhard",
            ToneMap::None => "none",
        }
    }

    /// The name for people, as in the PNG's text chunk.
    pub fn title(self) -> &'static str {
        match self {
            ToneMap::Neutral => "Khronos PBR Neutral",
            ToneMap::Agx => "AgX base",
            ToneMap::Aces => "ACES (Narkowicz fit)",
            ToneMap::Reinhard => "Reinhard 2002, global, on luminance",
            ToneMap::None => "none (clipped)",
        }
    }

    /// Linear display light in `[0, 1]` of exposed scene-linear radiance. Negative and non-finite input counts as 0,
    /// positive infinity as the largest number.
    pub fn apply(self, radiance: [f32; 3]) -> [f32; 3] {
        // The comparison drops NaN. The ceiling keeps squares finite; every curve is flat long before it.
        let c = radiance.map(|v| if v > 0.0 { v.min(1e18) } else { 0.0 });
        let mapped = match self {
            ToneMap::Neutral => neutral(c),
            ToneMap::Agx => agx(c),
            ToneMap::Aces => c.map(|x| (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)),
            ToneMap::Reinhard => {
                let scale = 1.0 / (1.0 + luminance(c));
                c.map(|x| x * scale)
            }
            ToneMap::None => c,
        };
        mapped.map(|v| v.clamp(0.0, 1.0))
    }

    /// The three display bytes of a pixel: exposure by `exposure_ev` stops, tone map, sRGB curve, rounded.
    pub fn encode(self, radiance: [f32; 3], exposure_ev: f32) -> [u8; 3] {
        let scale = exposure_ev.exp2();
        self.apply(radiance.map(|v| v * scale))
            .map(|v| (srgb_encode(v) * 255.0).round() as u8)
    }
}

impl FromStr for ToneMap {
    type Err = String;

    /// # Errors
    /// A line with the known names.
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|t| t.name() == s)
            .ok_or_else(|| {
                let names: Vec<_> = Self::ALL.iter().map(|t| t.name()).collect();
                format!("unknown tone map {s:?}; known are {}", names.join(", "))
            })
    }
}

/// The sRGB curve: linear light in `[0, 1]` to code value (IEC 61966-2-1).
pub fn srgb_encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// The inverse of [`srgb_encode`].
pub fn srgb_decode(code: f32) -> f32 {
    if code <= 0.040_45 {
        code / 12.92
    } else {
        ((code + 0.055) / 1.055).powf(2.4)
    }
}

/// Khronos PBR Neutral: an offset that undoes the Fresnel reflection of 0.04, a hyperbolic shoulder on the largest
/// channel from 0.76 on, and a fade to white above it.
fn neutral(mut c: [f32; 3]) -> [f32; 3] {
    const F90: f32 = 0.04;
    const START: f32 = 0.8 - F90;
    const DESATURATION: f32 = 0.15;
    let low = c[0].min(c[1]).min(c[2]);
    let offset = if low < 2.0 * F90 {
        low - low * low / (4.0 * F90)
    } else {
        F90
    };
    c = c.map(|v| v - offset);
    let peak = c[0].max(c[1]).max(c[2]);
    if peak < START {
        return c;
    }
    const D: f32 = 1.0 - START;
    let compressed = 1.0 - D * D / (peak + D - START);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - compressed) + 1.0);
    c.map(|v| v * (compressed / peak) * (1.0 - white) + compressed * white)
}

/// Rows of a matrix times a column.
fn product(m: [[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// AgX: an inset of Rec. 2020, a logarithm over 16.5 stops around middle grey, a sigmoid, the outset.
fn agx(c: [f32; 3]) -> [f32; 3] {
    const REC2020_FROM_REC709: [[f32; 3]; 3] = [
        [0.6274, 0.3293, 0.0433],
        [0.0691, 0.9195, 0.0113],
        [0.0164, 0.0880, 0.8956],
    ];
    const REC709_FROM_REC2020: [[f32; 3]; 3] = [
        [1.6605, -0.5876, -0.0728],
        [-0.1246, 1.1329, -0.0083],
        [-0.0182, -0.1006, 1.1187],
    ];
    const INSET: [[f32; 3]; 3] = [
        [0.856_627_15, 0.095_121_24, 0.048_251_606],
        [0.137_318_97, 0.761_242, 0.101_439_04],
        [0.111_898_21, 0.076_799_42, 0.811_302_37],
    ];
    const OUTSET: [[f32; 3]; 3] = [
        [1.127_100_6, -0.110_606_64, -0.016_493_939],
        [-0.141_329_76, 1.157_823_7, -0.016_493_939],
        [-0.141_329_76, -0.110_606_64, 1.251_936_4],
    ];
    const MIN_EV: f32 = -12.473_93;
    const MAX_EV: f32 = 4.026_069;
    let sigmoid = |x: f32| {
        let x2 = x * x;
        let x4 = x2 * x2;
        15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x
            - 0.002_32
    };
    let inset = product(INSET, product(REC2020_FROM_REC709, c));
    let curved = inset
        .map(|v| sigmoid(((v.max(1e-10).log2() - MIN_EV) / (MAX_EV - MIN_EV)).clamp(0.0, 1.0)));
    product(
        REC709_FROM_REC2020,
        product(OUTSET, curved).map(|v| v.max(0.0).powf(2.2)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_curve_round_trips_every_byte() {
        for byte in 0..=255u8 {
            let code = f32::from(byte) / 255.0;
            assert_eq!((srgb_encode(srgb_decode(code)) * 255.0).round() as u8, byte);
        }
        assert!((srgb_decode(0.5) - 0.214_041_14).abs() < 1e-6);
    }

    #[test]
    fn every_map_is_monotone_on_grey_bounded_and_keeps_grey() {
        for map in ToneMap::ALL {
            let mut before = -1.0;
            for step in -200..=200 {
                let grey = (step as f32 / 10.0).exp2();
                let [r, g, b] = map.apply([grey; 3]);
                assert!((0.0..=1.0).contains(&r), "{map:?} of {grey}: {r}");
                assert!(
                    (r - g).abs() < 2e-3 && (g - b).abs() < 2e-3,
                    "{map:?} tints grey {grey}: {r} {g} {b}"
                );
                assert!(
                    g >= before - 1e-3,
                    "{map:?} falls at {grey}: {g} after {before}"
                );
                before = g;
            }
            assert!(before > 0.97, "{map:?} does not reach white: {before}");
            assert!(map.apply([0.0; 3])[1] < 1e-3);
            for odd in [f32::NAN, f32::INFINITY, -1.0, f32::MAX] {
                assert!(
                    map.apply([odd; 3]).iter().all(|v| v.is_finite()),
                    "{map:?} of {odd}"
                );
            }
            assert_eq!(map.name().parse(), Ok(map));
        }
        assert!("gamma".parse::<ToneMap>().is_err());
    }

    #[test]
    fn neutral_follows_its_specification() {
        // Below the shoulder: minus 0.04 where the smallest channel is at least 0.08.
        let [r, g, b] = ToneMap::Neutral.apply([0.5, 0.3, 0.1]);
        assert!((r - 0.46).abs() < 1e-6 && (g - 0.26).abs() < 1e-6 && (b - 0.06).abs() < 1e-6);
        // A black channel has no offset.
        assert_eq!(ToneMap::Neutral.apply([0.5, 0.3, 0.0]), [0.5, 0.3, 0.0]);
        // The shoulder by hand for grey 2: peak 1.96, compressed 1 - 0.0576 / 1.44 = 0.96.
        assert!((ToneMap::Neutral.apply([2.0; 3])[0] - 0.96).abs() < 1e-6);
    }

    #[test]
    fn exposure_is_in_stops() {
        assert_eq!(
            ToneMap::None.encode([0.25; 3], 1.0),
            ToneMap::None.encode([0.5; 3], 0.0)
        );
        assert_eq!(ToneMap::None.encode([0.25; 3], -60.0), [0; 3]);
    }
}
