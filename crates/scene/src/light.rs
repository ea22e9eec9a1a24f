//! Punctual lights of `KHR_lights_punctual`. Emissive surfaces are materials, not lights.

use glam::Vec3;

/// A light without extent; it shines along -Z of its node.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Name of the light or of its node; may be empty.
    pub name: String,
    /// The node that carries it.
    pub node: u32,
    /// Colour times intensity: irradiance on a facing surface for directional lights (W/m2), radiant intensity for point
    /// and spot lights (W/sr). Linear Rec. 709.
    pub intensity: Vec3,
    /// What kind it is.
    pub kind: LightKind,
}

/// Kinds of punctual lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Infinitely far away, seen under an angular diameter in radians (0: one exact direction).
    Directional {
        /// Angular diameter, radians.
        angular_diameter: f32,
    },
    /// Shines equally in all directions, falloff 1/d^2.
    Point,
    /// A point light with a cone; glTF's falloff between the two angles.
    Spot {
        /// Half angle of full intensity, radians.
        inner_angle: f32,
        /// Half angle beyond which there is no light, radians.
        outer_angle: f32,
    },
}
