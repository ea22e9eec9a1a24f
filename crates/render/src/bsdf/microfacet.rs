//! The GGX microfacet distribution with Smith's shadowing, and Fresnel's equations.
//!
//! Walter et al. 2007 (distribution, refraction), Heitz 2014 (height-correlated masking), Dupuy & Benyoub 2023 (sampling of visible
//! normals by spherical caps). All directions are in the frame whose z axis is the macroscopic normal; `alpha` is isotropic.

use crate::sampling::warp::sin_cos_turns;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

/// Below this alpha a lobe is treated as an exact mirror: `h = wi + wo` is known to about 6e-8, so the slope `h.xy / alpha` in which
/// the distribution is written would have lost more than 1e-4 of its value, and the lobe is narrower than 0.1 degrees.
pub(super) const ALPHA_DELTA: f32 = 1e-3;

/// Directions with a smaller cosine scatter nothing: quotients of smaller ones leave the range of floats, and no light is lost that could be seen.
pub(super) const GRAZING: f32 = 1e-6;

/// Density of microfacet normals `h`, per steradian and projected area (Walter 2007, eq. 33), written in slopes: no cancellation near the pole.
#[inline]
pub(super) fn ggx_d(alpha: f32, h: Vec3) -> f32 {
    let a2 = alpha * alpha;
    let e = (h.x * h.x + h.y * h.y) + a2 * (h.z * h.z);
    a2 / (PI * e * e)
}

/// `sqrt(alpha² + (1 - alpha²) cos²)`: the root that all of Smith's terms for GGX share.
#[inline]
pub(super) fn smith_root(alpha: f32, cos: f32) -> f32 {
    let a2 = alpha * alpha;
    (a2 + (1.0 - a2) * cos * cos).sqrt()
}

/// `G1(w) / (2 |cos w|)`, finite at grazing angles (Heitz 2014, eq. 72).
#[inline]
pub(super) fn g1_over_2cos(cos: f32, root: f32) -> f32 {
    1.0 / (cos + root)
}

/// `G2(wo, wi) / (4 cos(wo))`, height-correlated (Heitz 2014, eq. 99), finite at grazing angles.
#[inline]
pub(super) fn g2_over_4cos_o(cos_o: f32, root_o: f32, cos_i: f32, root_i: f32) -> f32 {
    0.5 * cos_i / (cos_o * root_i + cos_i * root_o)
}

/// Cosine at the microfacet that reflects `wi` into `wo`, and [`ggx_d`] there, from the sum `wo + wi` without normalising it.
#[inline]
pub(super) fn half_vector(alpha: f32, sum: Vec3) -> (f32, f32) {
    half_vector_from(alpha, sum, sum.x * sum.x + sum.y * sum.y, sum.z)
}

/// [`half_vector`] of a lobe about the unit vector `normal` in place of z.
#[inline]
pub(super) fn half_vector_about(normal: Vec3, alpha: f32, sum: Vec3) -> (f32, f32) {
    half_vector_from(
        alpha,
        sum,
        normal.cross(sum).length_squared(),
        normal.dot(sum),
    )
}

/// `level2` is the squared length of the part of `sum` that lies in the plane of the surface.
#[inline]
fn half_vector_from(alpha: f32, sum: Vec3, level2: f32, height: f32) -> (f32, f32) {
    let a2 = alpha * alpha;
    let length2 = sum.length_squared().max(f32::MIN_POSITIVE);
    let e = level2 + a2 * (height * height);
    let ratio = length2 / e.max(f32::MIN_POSITIVE);
    (
        (0.5 * length2.sqrt()).min(1.0),
        a2 * FRAC_1_PI * ratio * ratio,
    )
}

/// A microfacet normal in proportion to its projected area as seen from `wo` (`wo.z >= 0`).
///
/// Its density is `G1(wo) max(0, wo·h) D(h) / wo.z`.
#[inline]
pub(super) fn sample_visible_normal(alpha: f32, wo: Vec3, u: Vec2) -> Vec3 {
    let standard = Vec3::new(wo.x * alpha, wo.y * alpha, wo.z).normalize();
    let (sin_phi, cos_phi) = sin_cos_turns(u.x);
    let z = (1.0 - u.y) * (1.0 + standard.z) - standard.z;
    // 1 - z² without cancellation: 1 - z = u (1 + s).
    let one_minus_z = u.y * (1.0 + standard.z);
    let sin = (one_minus_z * (2.0 - one_minus_z)).max(0.0).sqrt();
    let cap = Vec3::new(sin * cos_phi, sin * sin_phi, z);
    let h = cap + standard;
    // `h.z` is at least 0 in exact arithmetic; the floor keeps the vector from vanishing.
    Vec3::new(h.x * alpha, h.y * alpha, h.z.max(1e-30)).normalize()
}

/// `(1 - cos)^5`, Schlick's weight of the grazing reflectance.
#[inline]
pub(super) fn schlick_weight(cos: f32) -> f32 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// Unpolarised Fresnel reflectance of a smooth dielectric boundary, and the cosine of the refracted direction (0 in total reflection).
///
/// `eta` is the index on the far side over the index on the near side, `cos >= 0` the incident cosine.
#[inline]
pub(super) fn fresnel_dielectric(cos: f32, eta: f32) -> (f32, f32) {
    let cos = cos.clamp(0.0, 1.0);
    let sin2_t = (1.0 - cos * cos) / (eta * eta);
    if sin2_t >= 1.0 {
        return (1.0, 0.0);
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let s = (cos - eta * cos_t) / (cos + eta * cos_t);
    let p = (eta * cos - cos_t) / (eta * cos + cos_t);
    (0.5 * (s * s + p * p), cos_t)
}

/// Mirror image of `wo` about the unit vector `h`.
#[inline]
pub(super) fn reflect(wo: Vec3, h: Vec3) -> Vec3 {
    2.0 * wo.dot(h) * h - wo
}

/// The direction behind the boundary with normal `h` that refracts into `wo`. `cos = wo·h`, `cos_t` from [`fresnel_dielectric`].
#[inline]
pub(super) fn refract(wo: Vec3, h: Vec3, cos: f32, cos_t: f32, eta: f32) -> Vec3 {
    h * (cos / eta - cos_t) - wo / eta
}
