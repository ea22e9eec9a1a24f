//! Warps from the unit square to directions and points, each beside its density.
//!
//! All of them are continuous almost everywhere and keep areas in proportion, so that stratified input stays stratified. Directions
//! are in a local frame whose z axis is the pole; [`basis`] builds such a frame. Densities are per steradian unless said otherwise.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, PI};

/// `(sin, cos)` of an angle of `-1/2..=1/2` quarter turns, by Taylor polynomials: below 4e-8 off, without a call into libm.
#[inline]
fn sin_cos_eighth(quarter_turns: f32) -> (f32, f32) {
    let a = quarter_turns * FRAC_PI_2;
    let s = a * a;
    let sin = a
        * (1.0
            + s * (-1.0 / 6.0 + s * (1.0 / 120.0 + s * (-1.0 / 5040.0 + s * (1.0 / 362_880.0)))));
    let cos = 1.0 + s * (-0.5 + s * (1.0 / 24.0 + s * (-1.0 / 720.0 + s * (1.0 / 40_320.0))));
    (sin, cos)
}

/// `(sin, cos)` of `turns` full turns, for turns in `[0, 1]`.
#[inline]
pub fn sin_cos_turns(turns: f32) -> (f32, f32) {
    let x = turns * 4.0;
    let quadrant = (x + 0.5) as u32;
    let (sin, cos) = sin_cos_eighth(x - quadrant as f32);
    // Odd quadrants swap the two, the signs follow the bits of the quadrant: no branch that chance would mislead.
    let (sin, cos) = if quadrant & 1 == 0 {
        (sin, cos)
    } else {
        (cos, sin)
    };
    let flip = |x: f32, bit: u32| f32::from_bits(x.to_bits() ^ (bit << 31));
    (
        flip(sin, quadrant >> 1 & 1),
        flip(cos, (quadrant + 1) >> 1 & 1),
    )
}

/// Two unit vectors that make a right-handed frame with the unit vector `z`: `x × y = z`. (Duff et al., JCGT 2017.)
#[inline]
pub fn basis(z: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(z.z);
    let a = -1.0 / (sign + z.z);
    let b = z.x * z.y * a;
    (
        Vec3::new(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x),
        Vec3::new(b, sign + z.y * z.y * a, -z.y),
    )
}

/// A point of the unit disk, uniform in area (density 1/π): the concentric map of Shirley & Chiu 1997.
#[inline]
pub fn disk(u: Vec2) -> Vec2 {
    let a = 2.0 * u.x - 1.0;
    let b = 2.0 * u.y - 1.0;
    // The longer coordinate is the radius; selections instead of branches, which chance would mislead.
    let swap = b.abs() > a.abs();
    let (radius, other) = if swap { (b, a) } else { (a, b) };
    let quotient = if radius == 0.0 { 0.0 } else { other / radius };
    let (sin, cos) = sin_cos_eighth(0.5 * quotient);
    let (x, y) = if swap { (sin, cos) } else { (cos, sin) };
    Vec2::new(radius * x, radius * y)
}

/// A direction about +z, in proportion to its cosine (Malley's method over [`disk`]). `z` may be 0 by rounding.
#[inline]
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let d = disk(u);
    d.extend((1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Density of [`cosine_hemisphere`].
#[inline]
pub fn cosine_hemisphere_pdf(cos: f32) -> f32 {
    cos.max(0.0) * FRAC_1_PI
}

/// A direction of the hemisphere about +z, uniform in solid angle: density 1/(2π).
#[inline]
pub fn uniform_hemisphere(u: Vec2) -> Vec3 {
    uniform_cone(1.0, u)
}

/// A direction of the whole sphere, uniform in solid angle: density [`UNIFORM_SPHERE_PDF`].
#[inline]
pub fn uniform_sphere(u: Vec2) -> Vec3 {
    uniform_cone(2.0, u)
}

/// Density of [`uniform_sphere`].
pub const UNIFORM_SPHERE_PDF: f32 = 0.25 * FRAC_1_PI;

/// Density of [`uniform_hemisphere`].
pub const UNIFORM_HEMISPHERE_PDF: f32 = 0.5 * FRAC_1_PI;

/// A direction of the cone about +z whose directions have `cos >= 1 - height`, uniform in solid angle.
///
/// The cone is given by `height = 1 - cos(half angle) = 2 sin²(half angle / 2)` because the cosine of a small angle (the sun's) loses all its digits.
#[inline]
pub fn uniform_cone(height: f32, u: Vec2) -> Vec3 {
    // Concentric: area on the disk maps to area on the cap (Lambert's azimuthal projection).
    let d = disk(u);
    let r2 = d.length_squared().min(1.0);
    let below_pole = height * r2;
    (d * (height * (2.0 - below_pole)).max(0.0).sqrt()).extend(1.0 - below_pole)
}

/// Density of [`uniform_cone`] inside of the cone.
#[inline]
pub fn uniform_cone_pdf(height: f32) -> f32 {
    1.0 / (2.0 * PI * height)
}

/// Barycentric coordinates `(b1, b2)` of a point of a triangle, uniform in area, `point = (1 - b1 - b2) a + b1 b + b2 c`.
///
/// The low-distortion map of Heitz 2019: no square root, and stratification survives.
#[inline]
pub fn triangle(u: Vec2) -> Vec2 {
    let (x, y) = (u.x, u.y);
    if y > x {
        let half = 0.5 * x;
        Vec2::new(half, y - half)
    } else {
        let half = 0.5 * y;
        Vec2::new(x - half, half)
    }
}
