//! Which light to ask: selection with an exact probability mass function.

use super::LightSelection;
use super::distribution::{Distribution, place};
use glam::{Vec2, Vec3};

/// How a light is picked; made once for all lights of a scene.
#[derive(Debug)]
pub(super) enum Selector {
    /// No light at all.
    Nothing,
    Uniform {
        lights: u32,
    },
    Power(Distribution),
}

/// A random place of 32 bits from a pick in `[0, 1)`, which has 24 bits only: too coarse to choose among a million lights.
/// The rest comes from a hash of the numbers that choose the point on the light, which are independent of the pick.
fn fine_place(pick: f32, u: Vec2) -> u32 {
    let mut hash = u.x.to_bits() ^ u.y.to_bits().rotate_left(16);
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x7feb_352d);
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x846c_a68b);
    (place(pick) & !0xff) | (hash >> 24)
}

impl Selector {
    /// `powers` are finite and positive, one for each light.
    pub(super) fn new(selection: LightSelection, powers: &[f32]) -> Self {
        if powers.is_empty() {
            return Self::Nothing;
        }
        match selection {
            LightSelection::Uniform => Self::Uniform {
                lights: powers.len() as u32,
            },
            LightSelection::Power | LightSelection::Tree => match Distribution::new(powers) {
                Some(distribution) => Self::Power(distribution),
                None => Self::Nothing,
            },
        }
    }

    /// A light and the probability of picking it.
    pub(super) fn pick(
        &self,
        position: Vec3,
        normal: Vec3,
        pick: f32,
        u: Vec2,
    ) -> Option<(usize, f32)> {
        let _ = (position, normal);
        let place = fine_place(pick, u);
        match self {
            Self::Nothing => None,
            Self::Uniform { lights } => {
                let light = (u64::from(place) * u64::from(*lights)) >> 32;
                Some((light as usize, 1.0 / *lights as f32))
            }
            Self::Power(distribution) => {
                let light = distribution.pick(place);
                Some((light, distribution.pmf(light)))
            }
        }
    }

    /// The probability of picking a light.
    pub(super) fn pmf(&self, position: Vec3, normal: Vec3, light: usize) -> f32 {
        let _ = (position, normal);
        match self {
            Self::Nothing => 0.0,
            Self::Uniform { lights } => 1.0 / *lights as f32,
            Self::Power(distribution) => distribution.pmf(light),
        }
    }
}
