//! Lights by kind, for renderers that treat kinds apart.

use super::{Environment, Lights, Selector, emitter::Emitters};
use glam::Vec3;
use occlude_scene::{Pose, Scene};
use std::sync::Arc;

/// A light without extent.
#[derive(Clone, Copy, Debug)]
pub(crate) enum DeltaLight {
    /// A point or a spot.
    Point {
        position: Vec3,
        /// Radiant intensity in the brightest direction.
        intensity: Vec3,
        /// Of spots: axis, scale and offset of the falloff `clamp(scale * cos + offset, 0, 1)^2`.
        cone: Option<(Vec3, f32, f32)>,
    },
    /// Infinitely far away.
    Direction {
        /// Unit vector towards it.
        towards: Vec3,
        /// Irradiance on a facing surface.
        irradiance: Vec3,
    },
}

impl DeltaLight {
    /// Direction to the light from a place, its own place unless that is infinitely far away, and the irradiance on a facing surface.
    /// `None` where none arrives.
    pub(crate) fn at(&self, position: Vec3) -> Option<(Vec3, Option<Vec3>, Vec3)> {
        match *self {
            Self::Direction {
                towards,
                irradiance,
            } => Some((towards, None, irradiance)),
            Self::Point {
                position: own,
                intensity,
                cone,
            } => {
                let to = own - position;
                let distance = to.length();
                let wi = to / distance;
                let falloff = cone.map_or(1.0, |(axis, scale, offset)| {
                    (scale * axis.dot(-wi) + offset).clamp(0.0, 1.0).powi(2)
                });
                let irradiance = intensity * (falloff / (distance * distance));
                (irradiance.is_finite() && irradiance != Vec3::ZERO).then_some((
                    wi,
                    Some(own),
                    irradiance,
                ))
            }
        }
    }
}

/// An emissive triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmissivePart {
    /// Counter-clockwise as seen from the front.
    pub(crate) corners: [Vec3; 3],
    /// Mean over its area.
    pub(crate) radiance: Vec3,
    pub(crate) double_sided: bool,
    pub(crate) mesh: u32,
}

impl Lights {
    /// The lights without extent.
    pub(crate) fn deltas(&self) -> impl Iterator<Item = DeltaLight> {
        let points = self.points.iter().map(|light| DeltaLight::Point {
            position: light.position,
            intensity: light.intensity,
            cone: light.cone.as_ref().map(|cone| cone.ramp()),
        });
        let directions = self.directions.iter().map(|light| DeltaLight::Direction {
            towards: light.towards,
            irradiance: light.irradiance,
        });
        points.chain(directions)
    }

    /// The lights without extent alone.
    pub(crate) fn without_extent(&self, scene: &Scene, pose: &Pose) -> Self {
        self.part(
            scene,
            pose,
            Self {
                points: self.points.clone(),
                directions: self.directions.clone(),
                ..Self::none(self.selection)
            },
        )
    }

    /// Emissive surfaces and suns alone.
    pub(crate) fn areas(&self, scene: &Scene, pose: &Pose) -> Self {
        self.part(
            scene,
            pose,
            Self {
                emitters: Arc::clone(&self.emitters),
                suns: self.suns.clone(),
                ..Self::none(self.selection)
            },
        )
    }

    /// Suns of the scene alone.
    pub(crate) fn suns(&self, scene: &Scene, pose: &Pose) -> Self {
        self.part(
            scene,
            pose,
            Self {
                suns: self.suns.clone(),
                ..Self::none(self.selection)
            },
        )
    }

    /// The emissive triangles.
    pub(crate) fn emissive(&self) -> impl ExactSizeIterator<Item = EmissivePart> {
        self.emitters.triangles.iter().map(|triangle| {
            let facet = &triangle.facet;
            let [a, b, c] = [
                facet.origin,
                facet.origin + facet.edge1,
                facet.origin + facet.edge2,
            ];
            let front = facet.edge1.cross(facet.edge2).dot(facet.front) > 0.0;
            EmissivePart {
                corners: if front { [a, b, c] } else { [a, c, b] },
                radiance: triangle.mean_radiance,
                double_sided: triangle.double_sided,
                mesh: triangle.mesh,
            }
        })
    }

    /// The environment without suns, if it shines.
    pub(crate) fn sky(&self) -> Option<&Environment> {
        self.environment.as_ref()
    }

    fn none(selection: super::LightSelection) -> Self {
        Self {
            points: Vec::new(),
            emitters: Arc::new(Emitters::default()),
            directions: Vec::new(),
            suns: Vec::new(),
            environment: None,
            selection,
            selector: Selector::Nothing,
        }
    }

    fn part(&self, scene: &Scene, pose: &Pose, mut part: Self) -> Self {
        part.select(scene, pose);
        part
    }
}
