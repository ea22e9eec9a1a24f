//! Which light to ask: selection with an exact probability mass function.

use super::distribution::{Distribution, place};
use super::tree::{Bounds, Tree};
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
    Tree {
        /// Over the lights at finite places, if there are any.
        tree: Option<Tree>,
        /// Their number.
        finite: usize,
    },
}

/// A random place of 32 bits from a pick in `[0, 1)`, which has 24 bits only: too coarse to choose among a million lights.
/// The rest comes from a hash of the numbers that choose the point on the light, which are independent of the pick.
pub(super) fn fine_place(pick: f32, u: Vec2) -> u32 {
    let mut hash = u.x.to_bits() ^ u.y.to_bits().rotate_left(16);
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x7feb_352d);
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x846c_a68b);
    (place(pick) & !0xff) | (hash >> 24)
}

impl Selector {
    /// `powers` are finite and positive, one for each light.
    pub(super) fn by_power(powers: &[f32]) -> Self {
        Distribution::new(powers).map_or(Self::Nothing, Self::Power)
    }

    pub(super) fn uniform(lights: usize) -> Self {
        if lights == 0 {
            Self::Nothing
        } else {
            Self::Uniform {
                lights: lights as u32,
            }
        }
    }

    /// The first lights, those at finite places, by a tree; all others by what they give at most.
    pub(super) fn by_tree(finite: &[Bounds]) -> Self {
        Self::Tree {
            tree: (!finite.is_empty()).then(|| Tree::new(finite)),
            finite: finite.len(),
        }
    }

    /// A light and the probability of picking it. `infinite` are bounds on the irradiance from the lights behind those at
    /// finite places.
    pub(super) fn pick<I>(
        &self,
        position: Vec3,
        normal: Vec3,
        pick: f32,
        u: Vec2,
        infinite: I,
    ) -> Option<(usize, f32)>
    where
        I: Iterator<Item = f32> + Clone,
    {
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
            Self::Tree { tree, finite } => {
                let root = tree.as_ref().map(|tree| tree.promise(position, normal));
                let split = Split::new(root.map_or(0.0, |root| root.sum), infinite.clone());
                let x = f64::from(place) / (1_u64 << 32) as f64;
                let share = f64::from(split.finite);
                if x < share {
                    let (light, pmf) = tree.as_ref()?.pick(position, normal, &root?, x / share)?;
                    return Some((light, pmf * split.finite));
                }
                let mut left = (x - share) as f32;
                let mut picked = None;
                for (i, irradiance) in infinite
                    .enumerate()
                    .filter(|(_, irradiance)| *irradiance > 0.0)
                {
                    let pmf = split.pmf(irradiance);
                    picked = Some((finite + i, pmf));
                    left -= pmf;
                    if left < 0.0 {
                        break;
                    }
                }
                picked
            }
        }
    }

    /// The probability of picking a light.
    pub(super) fn pmf<I>(&self, position: Vec3, normal: Vec3, light: usize, mut infinite: I) -> f32
    where
        I: Iterator<Item = f32> + Clone,
    {
        match self {
            Self::Nothing => 0.0,
            Self::Uniform { lights } => 1.0 / *lights as f32,
            Self::Power(distribution) => distribution.pmf(light),
            Self::Tree { tree, finite } => {
                let root = tree
                    .as_ref()
                    .map_or(0.0, |tree| tree.promise(position, normal).sum);
                let split = Split::new(root, infinite.clone());
                match tree {
                    Some(tree) if light < *finite => {
                        tree.pmf(position, normal, light) * split.finite
                    }
                    _ => infinite
                        .nth(light - finite)
                        .map_or(0.0, |irradiance| split.pmf(irradiance)),
                }
            }
        }
    }
}

/// How picks are shared between the tree and the lights infinitely far away.
///
/// Nothing is known of what blocks them (the sun does not shine into the cellar), so half of the probability is shared evenly
/// and half in proportion to the irradiance without blockers.
struct Split {
    /// Probability of the tree.
    finite: f32,
    /// Of an infinite light: this, and what its irradiance is multiplied by.
    even: f32,
    per_irradiance: f32,
}

impl Split {
    fn new(finite: f32, infinite: impl Iterator<Item = f32>) -> Self {
        let (mut sum, mut count) = (0.0, 0.0);
        for irradiance in infinite.filter(|irradiance| *irradiance > 0.0) {
            sum += irradiance;
            count += 1.0;
        }
        let share = match (finite > 0.0, sum > 0.0) {
            (true, true) => 0.25 + 0.5 * (sum / (sum + finite)),
            (false, true) => 1.0,
            _ => 0.0,
        };
        let divide = |a: f32, b: f32| if b > 0.0 { a / b } else { 0.0 };
        Self {
            finite: 1.0 - share,
            even: divide(0.5 * share, count),
            per_irradiance: divide(0.5 * share, sum),
        }
    }

    fn pmf(&self, irradiance: f32) -> f32 {
        if irradiance > 0.0 {
            self.even + self.per_irradiance * irradiance
        } else {
            0.0
        }
    }
}
