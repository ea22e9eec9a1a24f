//! Directions of a hemisphere as texels, and distances as 16 bits.
//!
//! A direction `(x, y, z)` with `z >= 0` lies at `(x, y) / (1 + z)` in the unit disk (Heidrich & Seidel 1998; it is the stereographic
//! projection). A texel of width `h` covers about the angle `h (1 + z)`: twice as wide, in angle, in the middle as at the rim.
//!
//! Distances are kept without sign, with 5 bits of exponent and 11 of mantissa, relative to the size of the scene: rounding moves them by
//! 2^-12 of themselves at most, a hundredth of a texel's footprint at 128 texels. Two codes are taken out: [`UNKNOWN`] and [`SKY`].

use glam::Vec3;

/// The code of a direction about which nothing is known.
pub(super) const UNKNOWN: u16 = 0;

/// The code of a direction in which nothing is hit: decodes to more than any distance in the scene.
pub(super) const SKY: u16 = u16::MAX;

/// Directions that correlation is estimated with (Ulbrich 2013, section 5).
pub(super) const PROBES: usize = 1024;

/// How distances become 16 bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// Exponent of the smallest code, as in the bits of an `f32`.
    base: u32,
    /// The same in front of the mantissa.
    bits: u32,
}

impl Scale {
    /// For distances up to `diameter`, which is positive and finite.
    pub(super) fn new(diameter: f32) -> Self {
        // The largest code decodes to twice the power of two that is at least `diameter`.
        let above = diameter.to_bits().div_ceil(1 << 23).clamp(32, 253);
        let base = above - 31;
        Self {
            base,
            bits: base << 23,
        }
    }

    pub(super) fn encode(self, distance: f32) -> u16 {
        if distance == f32::INFINITY {
            return SKY;
        }
        if distance.is_nan() || distance <= 0.0 {
            return UNKNOWN;
        }
        let rounded = (distance.to_bits() + (1 << 11)) >> 12;
        rounded
            .saturating_sub(self.base << 11)
            .clamp(u32::from(UNKNOWN) + 1, u32::from(SKY) - 1) as u16
    }

    #[inline(always)]
    pub(super) fn decode(self, code: u16) -> f32 {
        f32::from_bits((u32::from(code) << 12) + self.bits)
    }
}

/// A map's texels, the same for all records.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) resolution: u32,
    pub(super) scale: Scale,
    /// The texels that see something, in squares of 16x16 and in these eight neighbours together, and their directions.
    pub(super) texels: Vec<u32>,
    pub(super) directions: Vec<Vec3>,
    pub(super) probes: Box<Probes>,
}

/// Texels spread evenly over the hemisphere, in the order in which they lie in memory, and the x, y and z of their directions.
#[derive(Clone, Debug)]
pub(super) struct Probes {
    pub(super) texels: [u32; PROBES],
    pub(super) directions: [[f32; PROBES]; 3],
}

/// The direction of a place in the disk.
fn direction(s: f32, t: f32) -> Vec3 {
    let r2 = s * s + t * t;
    Vec3::new(2.0 * s, 2.0 * t, 1.0 - r2) / (1.0 + r2)
}

impl Layout {
    pub(super) fn new(resolution: u32, diameter: f32) -> Self {
        let size = resolution as f32;
        let mut layout = Self {
            resolution,
            scale: Scale::new(diameter),
            texels: Vec::new(),
            directions: Vec::new(),
            probes: Box::new(Probes {
                texels: [0; PROBES],
                directions: [[0.0; PROBES]; 3],
            }),
        };
        // Rays of a square run alike: it meets the same nodes and triangles.
        let blocks = (0..resolution / 2).flat_map(|y| (0..resolution / 4).map(move |x| (x, y)));
        let mut blocks: Vec<(u32, u32)> = blocks.collect();
        blocks.sort_by_key(|(x, y)| (y / 8, x / 4, y % 8 / 4, x % 4 / 2, y % 4 / 2, x % 2, y % 2));
        for (block_x, block_y) in blocks {
            for k in 0..8 {
                let (x, y) = (4 * block_x + k % 4, 2 * block_y + k / 4);
                let at = |i: u32| 2.0 * (i as f32 + 0.5) / size - 1.0;
                let (s, t) = (at(x), at(y));
                let radius = (s * s + t * t).sqrt();
                // Texels that the rim cuts look just above the horizon.
                let most = 1.0 - 0.5 / size;
                if radius < 1.0 + 2.0f32.sqrt() / size {
                    let inward = (most / radius).min(1.0);
                    layout.texels.push(y * resolution + x);
                    layout.directions.push(direction(s * inward, t * inward));
                }
            }
        }
        // A spiral with heights at equal steps: even in solid angle.
        let golden = std::f32::consts::PI * (3.0 - 5.0f32.sqrt());
        let wanted = (0..PROBES).map(|i| {
            let z = (i as f32 + 0.5) / PROBES as f32;
            let r = (1.0 - z * z).sqrt();
            let (sin, cos) = (i as f32 * golden).sin_cos();
            layout.texel(r * cos, r * sin, 1.0 + z)
        });
        let mut texels: Vec<u32> = wanted.collect();
        texels.sort_unstable();
        for (k, &texel) in texels.iter().enumerate() {
            layout.probes.texels[k] = texel;
            for (c, of) in layout.middle(texel).to_array().into_iter().enumerate() {
                layout.probes.directions[c][k] = of;
            }
        }
        layout
    }

    /// The texel of the direction `(x, y, z)` of any length, `denominator` = length + z.
    #[inline(always)]
    pub(super) fn texel(&self, x: f32, y: f32, denominator: f32) -> u32 {
        let half = 0.5 * self.resolution as f32;
        let scale = half / denominator;
        let last = (self.resolution - 1) as f32;
        // The comparisons also take care of NaN.
        let column = (x * scale + half).max(0.0).min(last) as u32;
        let row = (y * scale + half).max(0.0).min(last) as u32;
        row * self.resolution + column
    }

    /// The direction that the map has traced for a texel: of its middle, or just above the horizon.
    pub(super) fn middle(&self, texel: u32) -> Vec3 {
        let size = self.resolution as f32;
        let at = |i: u32| 2.0 * (i as f32 + 0.5) / size - 1.0;
        let (s, t) = (at(texel % self.resolution), at(texel / self.resolution));
        let inward = ((1.0 - 0.5 / size) / (s * s + t * t).sqrt()).min(1.0);
        direction(s * inward, t * inward)
    }

    /// How much a surface at `p` with this normal, both in the record's frame, faces the direction of a texel's middle: a dot product, as
    /// numerator and denominator; and the texel's footprint at `p`.
    #[inline(always)]
    pub(super) fn facing(&self, texel: u32, normal: Vec3, p: Vec3) -> ([f32; 2], f32) {
        let at = |i: u32| (i as f32 + 0.5) * self.width() - 1.0;
        let (s, t) = (at(texel % self.resolution), at(texel / self.resolution));
        let r2 = s * s + t * t;
        let there = 2.0 * (s * normal.x + t * normal.y) + normal.z * (1.0 - r2);
        ([there, 1.0 + r2], self.width() * (p.length() + p.z))
    }

    /// Width of a texel in the disk.
    #[inline(always)]
    pub(super) fn width(&self) -> f32 {
        2.0 / self.resolution as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_survive_16_bits() {
        for diameter in [1e-3, 0.7, 1.0, 30.0, 1e6] {
            let scale = Scale::new(diameter);
            for i in 1..10_000 {
                let distance = diameter * i as f32 / 10_000.0;
                let back = scale.decode(scale.encode(distance));
                assert!(
                    (back / distance - 1.0).abs() <= 1.0 / 4096.0,
                    "{distance} {back}"
                );
            }
            assert!(scale.decode(SKY) > diameter);
            assert_eq!(scale.encode(f32::INFINITY), SKY);
            for bad in [f32::NAN, -1.0, 0.0, f32::NEG_INFINITY] {
                assert_eq!(scale.encode(bad), UNKNOWN);
            }
            assert_ne!(scale.encode(f32::MIN_POSITIVE), UNKNOWN);
            assert_ne!(scale.encode(f32::MAX), SKY);
        }
    }

    #[test]
    fn texels_hold_their_directions() {
        let layout = Layout::new(64, 1.0);
        let share = layout.texels.len() as f32 / (64.0 * 64.0);
        assert!(
            (share - std::f32::consts::FRAC_PI_4).abs() < 0.05,
            "{share}"
        );
        for (&texel, &d) in layout.texels.iter().zip(&layout.directions) {
            assert!(d.z > 0.0 && d.is_normalized());
            let found = layout.texel(d.x, d.y, 1.0 + d.z);
            let apart =
                |a: u32, b: u32| (a % 64).abs_diff(b % 64) <= 1 && (a / 64).abs_diff(b / 64) <= 1;
            assert!(found == texel || d.z < 0.05 && apart(found, texel));
        }
        let probes = &layout.probes.texels;
        assert!(probes.iter().all(|texel| layout.texels.contains(texel)));
    }
}
