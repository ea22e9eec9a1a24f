//! Arithmetic that gives the same bits on every machine: only operations that IEEE 754 rounds exactly, in a fixed order.

use glam::{Affine3A, Mat3, Vec3};
use std::f64::consts::TAU;

/// Sine and cosine of an angle in turns (1 is the full circle), within 2 units in the last place of an `f32`.
///
/// The standard library's differ between platforms. Here: exact reduction to an eighth of a turn, then Taylor's series.
pub(super) fn sin_cos(turns: f32) -> (f32, f32) {
    let eighths = (f64::from(turns) * 4.0).round();
    let x = (f64::from(turns) - eighths / 4.0) * TAU;
    let q = x * x;
    let sin = x
        * (1.0
            - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0 * (1.0 - q / 110.0)))));
    let cos =
        1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0 * (1.0 - q / 90.0))));
    let (sin, cos) = match eighths.rem_euclid(4.0) as u8 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    };
    (sin as f32, cos as f32)
}

/// Random numbers: SplitMix64 (Steele, Lea, Flood 2014).
#[derive(Clone)]
pub(super) struct Rng(u64);

impl Rng {
    /// Streams of different `stream` share nothing, so that parts of a scene can change independently.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut rng = Self(seed ^ stream.wrapping_mul(0xd6e8_feb8_6659_fd93));
        rng.next();
        rng
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u32 << 24) as f32
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next()) * n as u128) >> 64) as usize
    }

    /// Uniform on the unit sphere (Archimedes).
    pub fn direction(&mut self) -> Vec3 {
        let z = self.range(-1.0, 1.0);
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (s, c) = sin_cos(self.unit());
        Vec3::new(r * c, r * s, z)
    }
}

/// An affine transform in scalar arithmetic (glam's own uses vector instructions, which differ between machines).
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub linear: Mat3,
    pub offset: Vec3,
}

impl Place {
    pub const HERE: Self = Self {
        linear: Mat3::IDENTITY,
        offset: Vec3::ZERO,
    };

    pub fn at(x: f32, y: f32, z: f32) -> Self {
        Self {
            offset: Vec3::new(x, y, z),
            ..Self::HERE
        }
    }

    /// Turned about +Y, counterclockwise seen from above, before everything else.
    pub fn turned_y(self, turns: f32) -> Self {
        let (s, c) = sin_cos(turns);
        self.after(Mat3::from_cols(
            Vec3::new(c, 0.0, -s),
            Vec3::Y,
            Vec3::new(s, 0.0, c),
        ))
    }

    /// Turned about +X before everything else.
    pub fn turned_x(self, turns: f32) -> Self {
        let (s, c) = sin_cos(turns);
        self.after(Mat3::from_cols(
            Vec3::X,
            Vec3::new(0.0, c, s),
            Vec3::new(0.0, -s, c),
        ))
    }

    /// Scaled before everything else.
    pub fn scaled(self, scale: Vec3) -> Self {
        self.after(Mat3::from_diagonal(scale))
    }

    fn after(self, first: Mat3) -> Self {
        Self {
            linear: self.linear * first,
            ..self
        }
    }

    pub fn point(&self, p: Vec3) -> Vec3 {
        self.linear * p + self.offset
    }

    pub fn affine(&self) -> Affine3A {
        Affine3A::from_mat3_translation(self.linear, self.offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_right() {
        for i in -4000..4000 {
            let turns = i as f32 / 999.0;
            let (s, c) = sin_cos(turns);
            let (sin, cos) = (f64::from(turns) * TAU).sin_cos();
            assert!((f64::from(s) - sin).abs() < 1.3e-7, "{turns}: {s} {sin}");
            assert!((f64::from(c) - cos).abs() < 1.3e-7, "{turns}: {c} {cos}");
        }
        assert_eq!(sin_cos(0.25), (1.0, 0.0));
        assert_eq!(sin_cos(-0.5).1, -1.0);
    }

    #[test]
    fn turns_go_the_right_way() {
        let p = Place::HERE.turned_y(0.25).point(Vec3::X);
        assert!(
            p.distance(Vec3::NEG_Z) < 1e-6,
            "counterclockwise from above: {p}"
        );
        let p = Place::HERE.turned_x(0.25).point(Vec3::Y);
        assert!(p.distance(Vec3::Z) < 1e-6);
    }

    #[test]
    fn random_numbers_never_change() {
        let mut rng = Rng::new(1, 2);
        let first = [rng.next(), rng.next()];
        assert_eq!(first, [rng_reference(1, 2, 1), rng_reference(1, 2, 2)]);
        let mean = (0..10_000).map(|_| f64::from(rng.unit())).sum::<f64>() / 1e4;
        assert!((mean - 0.5).abs() < 0.0116, "4 sigma: {mean}");
    }

    /// The definition again, jumping instead of stepping.
    fn rng_reference(seed: u64, stream: u64, index: u64) -> u64 {
        let state = (seed ^ stream.wrapping_mul(0xd6e8_feb8_6659_fd93))
            .wrapping_add(0x9e37_79b9_7f4a_7c15u64.wrapping_mul(index + 1));
        let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}
