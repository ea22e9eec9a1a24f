//! Many eyes that ask about the same lights.
//!
//! Instant radiosity, sky samples and scenes with a few lights ask about *all* lights at *every* eye. Written down one by
//! one, such questions take more time than their answers. So eyes and lights are given once, and a strategy asks back block
//! by block of [`BLOCK`] lights: which of them matter to which eye, and what to do with the answers.

use crate::{Endpoint, LightEnd, Query, Ray};
use glam::Vec3;

/// Lights that are answered together: the bits of a `u16`.
pub const BLOCK: usize = 16;

/// What to add to an answer that has been given as a bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Number of the eye.
    pub eye: u32,
    /// Number of the light within its block, below [`BLOCK`].
    pub light: u32,
    /// To be added to the visibility that the bit says, 0 or 1; the sum may lie outside `[0, 1]`.
    pub amount: f32,
}

/// An eye that asks about many lights.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeSample {
    /// The eye end; its normal is on the side that all connections leave.
    pub end: Endpoint,
    /// Where rays start: the position, moved off its surface.
    pub origin: Vec3,
}

impl EyeSample {
    /// A place that no ray leaves into its own surface, among `density` samples per square unit.
    pub fn new(position: Vec3, normal: Vec3, density: f32) -> Self {
        Self {
            end: Endpoint::new(position, normal, density),
            origin: position,
        }
    }
}

/// A light that many eyes ask about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedLight {
    /// The light end.
    pub end: LightEnd,
    /// Where rays end: a point moved off the light's surface, or `None` for a light infinitely far away.
    pub target: Option<Vec3>,
    /// See [`Query::connections`]: the number of lights of this technique, for ends with a density.
    pub connections: f32,
}

impl SharedLight {
    /// A point light that every eye asks about.
    pub fn point(position: Vec3) -> Self {
        Self {
            end: LightEnd::Point(position),
            target: Some(position),
            connections: 1.0,
        }
    }

    /// The ray that answers an eye's question about the light.
    pub fn ray_from(&self, origin: Vec3) -> Ray {
        match (self.target, self.end) {
            (Some(target), _) => Ray::between(origin, target),
            (None, LightEnd::Point(position)) => Ray::between(origin, position),
            (None, LightEnd::Surface(end)) => Ray::between(origin, end.position),
            (None, LightEnd::Direction(direction) | LightEnd::SolidAngle { direction, .. }) => {
                Ray::new(origin, direction)
            }
        }
    }

    /// The question that one eye asks about the light.
    pub fn query(&self, eye: &EyeSample) -> Query {
        Query {
            connections: self.connections,
            ..Query::new(eye.end, self.end, self.ray_from(eye.origin))
        }
    }
}

/// Whoever asks about many lights; called back by [`Visibility::answer_many`](crate::Visibility::answer_many) once for every
/// block of lights, first [`wanted`](Self::wanted), then [`take`](Self::take).
pub trait ManyLights {
    /// Says which lights of block `block` (lights `block * BLOCK` and on) matter to which eye: bit `l` of `wanted[e]` is
    /// set if eye `e` asks about the block's light `l`. Bits beyond the last light must be 0. `wanted` comes zeroed.
    fn wanted(&mut self, block: usize, wanted: &mut [u16]);

    /// Takes the answers about block `block`: bit `l` of `visible[e]` is set if light `l` is seen from eye `e`, and never where
    /// it was not wanted. Strategies that estimate ([`Class::Unbiased`](crate::Class::Unbiased)) add `corrections` to some of the answers.
    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]);
}

/// Every eye asks about every light: `(number of lights, what to do)`. What to do is called with the numbers of an eye and a light and the
/// light's visibility, for all pairs that are not 0, some perhaps in several parts that add up.
#[derive(Clone, Copy, Debug)]
pub struct EveryLight<F: FnMut(usize, usize, f32)>(pub usize, pub F);

impl<F: FnMut(usize, usize, f32)> ManyLights for EveryLight<F> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        let rest = self.0.saturating_sub(block * BLOCK).min(BLOCK);
        wanted.fill(((1u32 << rest) - 1) as u16);
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        for (eye, &visible) in visible.iter().enumerate() {
            for light in bits(visible) {
                self.1(eye, block * BLOCK + light, 1.0);
            }
        }
        for &Correction { eye, light, amount } in corrections {
            self.1(eye as usize, block * BLOCK + light as usize, amount);
        }
    }
}

/// The numbers of the bits that are set.
pub(crate) fn bits(mut mask: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = mask.trailing_zeros() as usize;
        mask &= mask.wrapping_sub(1);
        (bit < BLOCK).then_some(bit)
    })
}
