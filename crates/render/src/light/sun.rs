//! A directional light that is seen under an angle: a uniformly bright disk at infinity.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI};

/// A disk of uniform radiance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sun {
    /// Unit vector towards its centre.
    pub(super) towards: Vec3,
    pub(super) radiance: Vec3,
    /// Irradiance on a facing surface.
    pub(super) irradiance: Vec3,
    /// Half of the angular diameter, radians.
    pub(super) radius: f32,
    /// Squared chord from the centre to the rim of the disk on the unit sphere, `4 sin^2(radius / 2) = 2 (1 - cos radius)`:
    /// precise where the cosine is not.
    chord2: f32,
}

impl Sun {
    /// Smaller than this, a direction in single precision cannot say whether it lies inside of the disk.
    pub(super) const SMALLEST_DIAMETER: f32 = 1e-5;

    pub(super) fn new(towards: Vec3, irradiance: Vec3, angular_diameter: f32) -> Self {
        let radius = (0.5 * angular_diameter).min(FRAC_PI_2);
        let half = (0.5 * radius).sin();
        // A disk of radiance L overhead gives the irradiance L pi sin^2(radius).
        let radiance = irradiance / (PI * radius.sin().powi(2));
        Self {
            towards,
            radiance,
            irradiance,
            radius,
            chord2: 4.0 * half * half,
        }
    }

    pub(super) fn contains(&self, wi: Vec3) -> bool {
        (wi - self.towards).length_squared() <= self.chord2
    }

    /// A uniform direction inside of the disk.
    pub(super) fn sample(&self, u: Vec2) -> Vec3 {
        // 1 - cos is uniform on a spherical cap. A hair less than 1 keeps the rim inside after rounding.
        let m = 0.5 * self.chord2 * u.x * (1.0 - 1e-6);
        let sin = (m * (2.0 - m)).max(0.0).sqrt();
        let (s, t) = self.towards.any_orthonormal_pair();
        let (sin_phi, cos_phi) = (2.0 * PI * u.y).sin_cos();
        (self.towards * (1.0 - m) + (s * cos_phi + t * sin_phi) * sin).normalize()
    }

    /// An upper bound of the irradiance on a surface; `normal` may be zero: light from all sides counts.
    pub(super) fn irradiance_bound(&self, normal: Vec3) -> f32 {
        let lowest = if normal == Vec3::ZERO {
            1.0
        } else {
            // The highest point of the disk above the horizon; a hair more, for rounding.
            let angle = normal.dot(self.towards).clamp(-1.0, 1.0).acos() - self.radius - 1e-3;
            angle.max(0.0).cos().max(0.0)
        };
        super::luminance(self.irradiance) * lowest
    }

    /// Density of [`Sun::sample`] inside of the disk, per steradian.
    pub(super) fn density(&self) -> f32 {
        1.0 / (PI * self.chord2)
    }
}
