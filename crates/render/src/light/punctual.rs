//! Lights without extent: point, spot and exact directional lights (`KHR_lights_punctual`).

use glam::Vec3;

/// A point light; a spot if its cone is narrower than everything.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointLight {
    pub(super) position: Vec3,
    /// Radiant intensity in the brightest direction.
    pub(super) intensity: Vec3,
    pub(super) cone: Option<Cone>,
}

/// The cone of a spot light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cone {
    /// Unit vector along which the light shines.
    pub(super) axis: Vec3,
    pub(super) inner_angle: f32,
    pub(super) outer_angle: f32,
    scale: f32,
    offset: f32,
}

impl Cone {
    pub(super) fn new(axis: Vec3, inner_angle: f32, outer_angle: f32) -> Self {
        let outer_angle = outer_angle.clamp(0.0, std::f32::consts::PI);
        let inner_angle = inner_angle.clamp(0.0, outer_angle);
        // KHR_lights_punctual, "Inner and Outer Cone Angles": the reference implementation's two numbers.
        let scale = 1.0 / (inner_angle.cos() - outer_angle.cos()).max(0.001);
        Self {
            axis,
            inner_angle,
            outer_angle,
            scale,
            offset: -outer_angle.cos() * scale,
        }
    }

    /// Axis, scale and offset of the falloff, `clamp(scale * cos + offset, 0, 1)^2`.
    pub(super) fn ramp(&self) -> (Vec3, f32, f32) {
        (self.axis, self.scale, self.offset)
    }

    /// The part of the full intensity that leaves along the unit vector `direction`.
    pub(super) fn falloff(&self, direction: Vec3) -> f32 {
        let linear = (self.axis.dot(direction) * self.scale + self.offset).clamp(0.0, 1.0);
        linear * linear
    }

    /// 1 minus the cosine of the outer angle, without cancellation.
    pub(super) fn height(&self) -> f32 {
        2.0 * (0.5 * self.outer_angle).sin().powi(2)
    }

    /// The integral of the falloff over all directions, steradians.
    fn solid_angle(&self) -> f32 {
        // 2 pi times the integral over cos: 1 inside, a squared ramp of width 1 / scale outside. The ramp is 0 at the outer
        // angle, and where the cone is narrower than the ramp, it is cut off at cos = 1.
        let top = (1.0 - self.outer_angle.cos()).max(0.0);
        let ramp = top.min(1.0 / self.scale);
        std::f32::consts::TAU * (top - ramp + (ramp * self.scale).powi(2) * ramp / 3.0)
    }
}

impl PointLight {
    /// Radiant intensity along the unit vector `direction`, away from the light.
    pub(super) fn intensity_along(&self, direction: Vec3) -> Vec3 {
        match &self.cone {
            None => self.intensity,
            Some(cone) => self.intensity * cone.falloff(direction),
        }
    }

    /// Emitted power, all colours together.
    pub(super) fn power(&self) -> f32 {
        let solid_angle = self
            .cone
            .map_or(2.0 * std::f32::consts::TAU, |c| c.solid_angle());
        super::luminance(self.intensity) * solid_angle
    }
}

/// A light infinitely far away in one exact direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExactDirection {
    /// Unit vector towards the light.
    pub(super) towards: Vec3,
    /// Irradiance on a facing surface.
    pub(super) irradiance: Vec3,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falloff_follows_the_extension() {
        let cone = Cone::new(Vec3::NEG_Z, 0.3, 0.7);
        let at = |angle: f32| cone.falloff(Vec3::new(angle.sin(), 0.0, -angle.cos()));
        assert_eq!(at(0.0), 1.0);
        assert!((at(0.3) - 1.0).abs() < 1e-5);
        assert!(at(0.7) < 1e-10);
        assert_eq!(at(0.71), 0.0);
        let half = (0.5_f32.cos() - 0.7_f32.cos()) / (0.3_f32.cos() - 0.7_f32.cos());
        assert!((at(0.5) - half * half).abs() < 1e-5);
    }

    #[test]
    fn power_is_the_integral_of_the_falloff() {
        for (inner, outer) in [(0.0, 0.01), (0.3, 0.7), (0.5, 0.5), (0.0, 1.5), (1.0, 3.0)] {
            let cone = Cone::new(Vec3::Z, inner, outer);
            let n = 2_000_000;
            let sum: f64 = (0..n)
                .map(|i| {
                    let cos = -1.0 + 2.0 * (f64::from(i) + 0.5) / f64::from(n);
                    f64::from(cone.falloff(Vec3::new(
                        (1.0 - cos * cos).sqrt() as f32,
                        0.0,
                        cos as f32,
                    )))
                })
                .sum();
            let integral = sum * 2.0 / f64::from(n) * std::f64::consts::TAU;
            assert!(
                (f64::from(cone.solid_angle()) / integral - 1.0).abs() < 0.01,
                "{inner} {outer}: {integral}"
            );
        }
    }
}
