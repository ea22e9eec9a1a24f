//! Light as it leaves: rays from all lights, for paths that start there.
//!
//! A light is picked by its power (those infinitely far away together no more often than all others together, since nothing
//! is known of how much of the sun comes in), then a point on it and a direction (at infinity: a direction, then a point of the disk that
//! covers the scene from there; Pharr et al. 2016, section 16.1). [`Emission::density`] says with which density a ray that was found
//! otherwise would have been sampled, so that both ways can be combined.
//!
//! Wrong tool where the lights that matter are a small part of all power: a candle in a house of floodlights.

use super::distribution::Distribution;
use super::select::fine_place;
use super::{LightSample, Lights, Which, bounding_sphere};
use crate::sampling::warp;
use glam::{Vec2, Vec3};
use occlude_scene::{Pose, Scene};
use occlude_visibility::{LightEnd, Ray, offset_along_normal};
use std::f32::consts::{FRAC_1_PI, PI};

/// Where on the lights light starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Origin {
    /// A point light or spot, by number.
    Point(usize),
    /// A point of an emissive triangle.
    Surface {
        /// Number of the light.
        light: usize,
        /// World-space position.
        position: Vec3,
    },
    /// An exact direction, by number.
    Direction(usize),
    /// A direction of sky and suns: the unit vector towards it.
    Sky(Vec3),
}

impl Origin {
    /// No other way of sampling than picking it finds the light.
    pub(crate) fn is_delta(self) -> bool {
        matches!(self, Self::Point(_) | Self::Direction(_))
    }

    /// The origin of a sample of arriving light.
    pub(crate) fn of_sample(sample: &LightSample) -> Self {
        match sample.end {
            LightEnd::Point(_) => Self::Point(sample.light),
            LightEnd::Direction(_) => Self::Direction(sample.light),
            LightEnd::Surface(end) => Self::Surface {
                light: sample.light,
                position: end.position,
            },
            LightEnd::SolidAngle { direction, .. } => Self::Sky(direction),
        }
    }
}

/// Density of leaving light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EmissionDensity {
    /// Of the origin: per square metre of an emissive triangle, per steradian of the sky, else a probability.
    pub(crate) start: f32,
    /// Of the ray from there: per steradian, or per square metre across it, if `parallel`.
    pub(crate) spread: f32,
    /// The light is infinitely far away.
    pub(crate) parallel: bool,
}

/// A ray of leaving light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Emitted {
    pub(crate) ray: Ray,
    pub(crate) origin: Origin,
    pub(crate) density: EmissionDensity,
    /// Cosine of the ray with the emitter's normal; 1 for lights without one.
    pub(crate) cosine: f32,
    /// Emitted radiance, or intensity, or irradiance, times cosine, over all densities: the flux that the ray stands for.
    pub(crate) flux: Vec3,
}

/// Samples rays that leave the lights.
#[derive(Debug)]
pub(crate) struct Emission {
    picks: Option<Distribution>,
    centre: Vec3,
    /// Of a sphere around the scene.
    radius: f32,
}

impl Emission {
    pub(crate) fn new(lights: &Lights, scene: &Scene, pose: &Pose) -> Self {
        // A hair more, so that rounding leaves nothing outside.
        const MARGIN: f32 = 1.0001;
        let (centre, radius) = bounding_sphere(scene, pose);
        let sane = centre.is_finite() && radius > 0.0 && (radius * radius).is_finite();
        let mut powers = lights.powers(scene, pose);
        let (near, far) = powers.split_at_mut(lights.first_direction());
        if !sane {
            far.fill(0.0);
        }
        let [near, shining] = [&*near, &*far].map(|part| part.iter().sum::<f32>());
        if near > 0.0 && shining > near {
            far.iter_mut().for_each(|power| *power *= near / shining);
        }
        Self {
            picks: Distribution::new(&powers),
            centre,
            radius: radius * MARGIN,
        }
    }

    /// For who traces no light paths.
    pub(crate) fn none() -> Self {
        Self {
            picks: None,
            centre: Vec3::ZERO,
            radius: 0.0,
        }
    }

    fn pmf(&self, light: usize) -> f32 {
        self.picks.as_ref().map_or(0.0, |picks| picks.pmf(light))
    }

    /// Density per square metre across a ray from infinity.
    fn disk_density(&self) -> f32 {
        1.0 / (PI * self.radius * self.radius)
    }

    /// Density per steradian of a direction of sky and suns.
    fn sky_density(&self, lights: &Lights, towards: Vec3) -> f32 {
        let first = lights.first_sun();
        let suns = lights.suns.iter().enumerate();
        let mut density: f32 = suns
            .filter(|(_, sun)| sun.contains(towards))
            .map(|(i, sun)| sun.density() * self.pmf(first + i))
            .sum();
        if let Some(environment) = &lights.environment {
            density += environment.pdf(Vec3::ZERO, towards) * self.pmf(first + lights.suns.len());
        }
        density
    }

    /// Samples a ray. `pick` chooses the light, `place` the point on it and `turn` the direction.
    pub(crate) fn sample(
        &self,
        lights: &Lights,
        scene: &Scene,
        pick: f32,
        place: Vec2,
        turn: Vec2,
    ) -> Option<Emitted> {
        let picks = self.picks.as_ref()?;
        let light = picks.pick(fine_place(pick, place));
        match lights.which(light) {
            Which::Point(i) => {
                let point = &lights.points[i];
                let direction = match &point.cone {
                    None => warp::uniform_sphere(turn),
                    Some(cone) => about(cone.axis, warp::uniform_cone(cone.height(), turn)),
                };
                let ray = Ray::new(point.position, direction);
                self.emit(lights, ray, Origin::Point(light), 1.0, |density| {
                    point.intensity_along(direction) / (density.start * density.spread)
                })
            }
            Which::Triangle(i) => {
                let emissive = &lights.emitters.triangles[i];
                let facet = &emissive.facet;
                let barycentric = warp::triangle(place);
                // Double-sided emitters flip a coin that the direction's number holds.
                let (side, turn) = match emissive.double_sided {
                    true if turn.x < 0.5 => (-1.0, Vec2::new(2.0 * turn.x, turn.y)),
                    true => (1.0, Vec2::new(2.0 * turn.x - 1.0, turn.y)),
                    false => (1.0, turn),
                };
                let normal = facet.front * side;
                let local = warp::cosine_hemisphere(turn);
                let position = facet.at(barycentric.x, barycentric.y);
                let from = offset_along_normal(position, normal, facet.extent());
                let ray = Ray::new(from, about(normal, local));
                let origin = Origin::Surface { light, position };
                let radiance = emissive.radiance(scene, barycentric);
                let cosine = ray.direction.dot(normal);
                self.emit(lights, ray, origin, cosine, |density| {
                    radiance * (cosine / (density.start * density.spread))
                })
            }
            Which::Direction(i) => {
                let direction = &lights.directions[i];
                let ray = self.ray_towards_scene(direction.towards, place);
                self.emit(lights, ray, Origin::Direction(light), 1.0, |density| {
                    direction.irradiance / (density.start * density.spread)
                })
            }
            Which::Infinite(i) => {
                let towards = match lights.suns.get(i) {
                    Some(sun) => sun.sample(turn),
                    None => lights.environment.as_ref()?.sample(Vec3::ZERO, turn)?,
                };
                let ray = self.ray_towards_scene(towards, place);
                self.emit(lights, ray, Origin::Sky(towards), 1.0, |density| {
                    lights.environment(towards) / (density.start * density.spread)
                })
            }
        }
    }

    fn emit(
        &self,
        lights: &Lights,
        ray: Ray,
        origin: Origin,
        cosine: f32,
        flux: impl FnOnce(EmissionDensity) -> Vec3,
    ) -> Option<Emitted> {
        let density = self.density(lights, origin, ray.direction);
        if density.start <= 0.0 || density.spread <= 0.0 {
            return None;
        }
        let flux = flux(density);
        let useful = flux.is_finite() && flux.max_element() > 0.0;
        useful.then_some(Emitted {
            ray,
            origin,
            density,
            cosine,
            flux,
        })
    }

    fn ray_towards_scene(&self, towards: Vec3, place: Vec2) -> Ray {
        let disk = warp::disk(place) * self.radius;
        let (s, t) = warp::basis(towards);
        let from = self.centre + towards * self.radius + s * disk.x + t * disk.y;
        Ray::new(from, -towards)
    }

    /// Density with which [`Emission::sample`] finds the ray that leaves `origin` along the unit vector `direction`.
    pub(crate) fn density(
        &self,
        lights: &Lights,
        origin: Origin,
        direction: Vec3,
    ) -> EmissionDensity {
        let at_infinity = |start| EmissionDensity {
            start,
            spread: self.disk_density(),
            parallel: true,
        };
        let near = |start, spread| EmissionDensity {
            start,
            spread,
            parallel: false,
        };
        match origin {
            Origin::Point(light) => {
                let spread = match &lights.points[light].cone {
                    None => warp::UNIFORM_SPHERE_PDF,
                    Some(cone) if cone.falloff(direction) > 0.0 => {
                        warp::uniform_cone_pdf(cone.height())
                    }
                    Some(_) => 0.0,
                };
                near(self.pmf(light), spread)
            }
            Origin::Surface { light, .. } => {
                let emissive = &lights.emitters.triangles[light - lights.points.len()];
                let cosine = emissive.facet.front.dot(direction);
                let spread = if emissive.double_sided {
                    0.5 * cosine.abs()
                } else {
                    cosine.max(0.0)
                };
                near(self.pmf(light) / emissive.facet.area, spread * FRAC_1_PI)
            }
            Origin::Direction(light) => at_infinity(self.pmf(light)),
            Origin::Sky(towards) => at_infinity(self.sky_density(lights, towards)),
        }
    }
}

/// A direction about +z, turned to be about `axis`.
fn about(axis: Vec3, local: Vec3) -> Vec3 {
    let (s, t) = warp::basis(axis);
    (s * local.x + t * local.y + axis * local.z).normalize()
}

impl Lights {
    /// The origin of light that a point of a triangle emits, if it is a light.
    pub(crate) fn origin_on(
        &self,
        instance: u32,
        primitive: u32,
        position: Vec3,
    ) -> Option<Origin> {
        let index = self.emitters.find(instance, primitive)?;
        Some(Origin::Surface {
            light: self.points.len() + index,
            position,
        })
    }

    /// Unit normal of the front of an emissive triangle.
    #[cfg(test)]
    pub(crate) fn front_of(&self, light: usize) -> Vec3 {
        self.emitters.triangles[light - self.points.len()]
            .facet
            .front
    }

    /// Density with which [`Lights::sample`] at `position` finds `origin`, in the unit of [`EmissionDensity::start`].
    pub(crate) fn connection_density(&self, position: Vec3, normal: Vec3, origin: Origin) -> f32 {
        match origin {
            Origin::Point(light) | Origin::Direction(light) => self.pmf(position, normal, light),
            Origin::Surface {
                light,
                position: point,
            } => {
                let emissive = &self.emitters.triangles[light - self.points.len()];
                let pdf = emissive.pdf(position, normal, point);
                if pdf == 0.0 {
                    return 0.0;
                }
                let to = point - position;
                let across = to.length_squared();
                let cosine = emissive.facet.front.dot(to).abs() / across.sqrt();
                pdf * cosine / across * self.pmf(position, normal, light)
            }
            Origin::Sky(towards) => self.pdf_environment(position, normal, towards),
        }
    }
}

#[cfg(test)]
mod tests;
