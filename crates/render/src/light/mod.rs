//! Lights: where light comes from, and which one to ask.
//!
//! Units are radiometric: a directional light's intensity is the irradiance on a facing surface, a point or spot light's is
//! radiant intensity with falloff 1/d^2, emission and environments are radiance. [`Lights`] makes one light of all of them:
//! it samples a direction, and says with which density it would have sampled a direction that was found otherwise, so that
//! both can be combined (Veach & Guibas 1995, multiple importance sampling).
//!
//! Wrong tool for light that arrives by way of mirrors or glass (caustics), and for what unlit surfaces show: those are seen
//! by hitting them alone, and [`Lights::pdf_surface`] is 0 there.

mod distribution;
mod emission;
mod emitter;
mod environment;
mod facet;
mod lobes;
mod parts;
mod patches;
mod punctual;
mod select;
mod spherical;
mod sun;
mod tree;

pub(crate) use emission::{Emission, Emitted, Origin};
pub use environment::Environment;
pub use lobes::{SkyFit, SkyLobes, SkyResidual, SkySun};
pub(crate) use parts::{DeltaLight, EmissivePart};
pub use patches::{Patch, Patches};

use emitter::{EmissiveTriangle, Emitters};
use glam::{Vec2, Vec3};
use occlude_scene::{LightKind, Pose, PosedLight, Scene};
use occlude_visibility::{Endpoint, LightEnd, offset_along_normal};
use punctual::{Cone, ExactDirection, PointLight};
use select::Selector;
use std::sync::Arc;
use sun::Sun;

/// How a light is picked for a shading point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightSelection {
    /// All lights alike.
    Uniform,
    /// In proportion to emitted power.
    Power,
    /// By a tree over bounds on position, orientation and power (Conty & Kulla 2018).
    #[default]
    Tree,
}

/// One sample of the light that arrives at a point.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Number of the light.
    pub light: usize,
    /// Unit vector towards the light.
    pub wi: Vec3,
    /// Radiance that arrives from there if nothing blocks it; for delta lights the irradiance on a facing surface.
    pub radiance: Vec3,
    /// Density per steradian, the probability of having picked this light included; for delta lights that probability alone.
    pub pdf: f32,
    /// A point, spot or exact directional light: no other way of sampling finds it.
    pub delta: bool,
    /// The light's end of the visibility question. Densities in it (per area or per steradian) include the probability of
    /// having picked the light: of `n` samples that all lights share, `n * density` fall on a unit of area.
    pub end: LightEnd,
    /// Where the shadow ray ends: a point moved off the emitter, or `None` for infinitely far away.
    pub target: Option<Vec3>,
}

/// All lights of a posed scene together: they behave as one light.
///
/// They are numbered: points and spots, emissive triangles, exact directions, suns, environment.
#[derive(Debug)]
pub struct Lights {
    points: Vec<PointLight>,
    emitters: Arc<Emitters>,
    directions: Vec<ExactDirection>,
    suns: Vec<Sun>,
    environment: Option<Environment>,
    selection: LightSelection,
    selector: Selector,
}

/// The kinds that the number of a light stands for.
enum Which {
    Point(usize),
    Triangle(usize),
    Direction(usize),
    Infinite(usize),
}

/// Luminance of linear Rec. 709, for probabilities only. Never 0 for a colour that is not black.
fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

impl Lights {
    /// Collects punctual lights, emissive triangles and the environment; without one, the scene's own constant sky.
    ///
    /// Lights that emit nothing, or stand at no finite place, are left out.
    pub fn new(
        scene: &Scene,
        pose: &Pose,
        environment: Option<Environment>,
        selection: LightSelection,
    ) -> Self {
        let mut points = Vec::new();
        let mut directions = Vec::new();
        let mut suns = Vec::new();
        for light in pose.lights.iter().filter(|l| is_sane(l)) {
            match light.kind {
                LightKind::Directional { angular_diameter }
                    if angular_diameter >= Sun::SMALLEST_DIAMETER =>
                {
                    suns.push(Sun::new(
                        -light.direction,
                        light.intensity,
                        angular_diameter,
                    ));
                }
                LightKind::Directional { .. } => {
                    directions.push(ExactDirection {
                        towards: -light.direction,
                        irradiance: light.intensity,
                    });
                }
                LightKind::Point => {
                    points.push(PointLight {
                        position: light.position,
                        intensity: light.intensity,
                        cone: None,
                    });
                }
                LightKind::Spot {
                    inner_angle,
                    outer_angle,
                } => {
                    let cone = Some(Cone::new(light.direction, inner_angle, outer_angle));
                    points.push(PointLight {
                        position: light.position,
                        intensity: light.intensity,
                        cone,
                    });
                }
            }
        }
        points.retain(|p| p.power() > 0.0);
        let emitters = Arc::new(Emitters::new(scene, pose));
        let environment = Some(environment.unwrap_or_else(|| Environment::constant(scene.sky)))
            .filter(|e| !e.is_black());

        let mut lights = Self {
            points,
            emitters,
            directions,
            suns,
            environment,
            selection,
            selector: Selector::Nothing,
        };
        lights.select(scene, pose);
        lights
    }

    /// Makes the tables that pick lights.
    fn select(&mut self, scene: &Scene, pose: &Pose) {
        self.selector = match self.selection {
            LightSelection::Uniform => Selector::uniform(self.len()),
            LightSelection::Power => Selector::by_power(&self.powers(scene, pose)),
            LightSelection::Tree => Selector::by_tree(&self.bounds()),
        };
    }

    /// Emitted power of each light; of those infinitely far away, what falls on the scene.
    fn powers(&self, scene: &Scene, pose: &Pose) -> Vec<f32> {
        let at_infinity = self.len() > self.first_direction();
        let cross_section = if at_infinity {
            cross_section(scene, pose)
        } else {
            0.0
        };
        let points = self.points.iter().map(PointLight::power);
        let triangles = self.emitters.triangles.iter().map(EmissiveTriangle::power);
        let directions = self
            .directions
            .iter()
            .map(|d| luminance(d.irradiance) * cross_section);
        let suns = self
            .suns
            .iter()
            .map(|s| luminance(s.irradiance) * cross_section);
        let environment = self
            .environment
            .iter()
            .map(|e| luminance(e.integral()) * cross_section);
        let powers = points
            .chain(triangles)
            .chain(directions)
            .chain(suns)
            .chain(environment);
        powers
            .map(|power| power.clamp(f32::MIN_POSITIVE, f32::MAX))
            .collect()
    }

    /// Bounds of the lights at finite places.
    fn bounds(&self) -> Vec<tree::Bounds> {
        let points = self.points.iter().map(tree::Bounds::of_point);
        points
            .chain(
                self.emitters
                    .triangles
                    .iter()
                    .map(tree::Bounds::of_triangle),
            )
            .collect()
    }

    /// Bounds on the irradiance from each light infinitely far away: exact directions, suns, environment.
    fn irradiance_bounds(&self, normal: Vec3) -> impl Iterator<Item = f32> + Clone {
        let directions = self.directions.iter().map(move |d| {
            let cosine = if normal == Vec3::ZERO {
                1.0
            } else {
                normal.dot(d.towards).max(0.0)
            };
            luminance(d.irradiance) * cosine
        });
        let suns = self.suns.iter().map(move |s| s.irradiance_bound(normal));
        // No bound, but what a surface receives on average over the ways that it can face. Never 0.
        let environment = self
            .environment
            .iter()
            .map(|e| (0.25 * luminance(e.integral())).max(f32::MIN_POSITIVE));
        directions.chain(suns).chain(environment)
    }

    fn pmf(&self, position: Vec3, normal: Vec3, light: usize) -> f32 {
        self.selector
            .pmf(position, normal, light, self.irradiance_bounds(normal))
    }

    /// Number of lights (emissive triangles counted one by one, the environment as one).
    pub fn len(&self) -> usize {
        self.first_sun() + self.suns.len() + usize::from(self.environment.is_some())
    }

    /// Whether there is no light at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn first_direction(&self) -> usize {
        self.points.len() + self.emitters.triangles.len()
    }

    fn first_sun(&self) -> usize {
        self.first_direction() + self.directions.len()
    }

    fn which(&self, light: usize) -> Which {
        if light < self.points.len() {
            Which::Point(light)
        } else if light < self.first_direction() {
            Which::Triangle(light - self.points.len())
        } else if light < self.first_sun() {
            Which::Direction(light - self.first_direction())
        } else {
            Which::Infinite(light - self.first_sun())
        }
    }

    /// Samples light arriving at a point. `normal` is the shading normal, or zero where light from all sides counts.
    ///
    /// `pick` chooses the light and `u` the point on it; all in `[0, 1)`. `None`: no light arrives this way, and the sample
    /// counts as one of value 0.
    pub fn sample(
        &self,
        scene: &Scene,
        position: Vec3,
        normal: Vec3,
        pick: f32,
        u: Vec2,
    ) -> Option<LightSample> {
        let (light, pmf) =
            self.selector
                .pick(position, normal, pick, u, self.irradiance_bounds(normal))?;
        let sample = match self.which(light) {
            Which::Point(i) => sample_point(&self.points[i], i, position, pmf),
            Which::Triangle(i) => self.sample_triangle(scene, i, position, normal, pmf, u),
            Which::Direction(i) => {
                let light = &self.directions[i];
                Some(LightSample {
                    light: self.first_direction() + i,
                    wi: light.towards,
                    radiance: light.irradiance,
                    pdf: pmf,
                    delta: true,
                    end: LightEnd::Direction(light.towards),
                    target: None,
                })
            }
            Which::Infinite(i) => self.sample_infinite(i, position, normal, u),
        };
        sample.filter(|s| {
            s.radiance != Vec3::ZERO && (normal == Vec3::ZERO || normal.dot(s.wi) > 0.0)
        })
    }

    fn sample_triangle(
        &self,
        scene: &Scene,
        index: usize,
        position: Vec3,
        normal: Vec3,
        pmf: f32,
        u: Vec2,
    ) -> Option<LightSample> {
        let emissive = &self.emitters.triangles[index];
        let sample = emissive.sample(position, normal, u)?;
        let facet = &emissive.facet;
        let point = facet.at(sample.barycentric.x, sample.barycentric.y);
        let end = Endpoint {
            position: point,
            density: sample.area_density * pmf,
            normal: sample.normal,
            reserved: 0,
        };
        Some(LightSample {
            light: self.points.len() + index,
            wi: sample.wi,
            radiance: emissive.radiance(scene, sample.barycentric),
            pdf: sample.pdf * pmf,
            delta: false,
            end: LightEnd::Surface(end),
            target: Some(offset_along_normal(point, sample.normal, facet.extent())),
        })
    }

    /// Suns and environment overlap: whichever of them was picked, the direction carries the radiance and density of all.
    fn sample_infinite(
        &self,
        index: usize,
        position: Vec3,
        normal: Vec3,
        u: Vec2,
    ) -> Option<LightSample> {
        let wi = match self.suns.get(index) {
            Some(sun) => sun.sample(u),
            None => self.environment.as_ref()?.sample(normal, u)?,
        };
        let pdf = self.pdf_environment(position, normal, wi);
        (pdf > 0.0 && pdf.is_finite()).then(|| LightSample {
            light: self.first_sun() + index,
            wi,
            radiance: self.environment(wi),
            pdf,
            delta: false,
            end: LightEnd::SolidAngle {
                direction: wi,
                density: pdf,
            },
            target: None,
        })
    }

    /// Density per steradian with which [`Lights::sample`] at `position` finds the point `hit` of an emissive triangle.
    ///
    /// 0 for triangles that are no lights, and on the side that does not emit.
    pub fn pdf_surface(
        &self,
        position: Vec3,
        normal: Vec3,
        instance: u32,
        primitive: u32,
        hit: Vec3,
    ) -> f32 {
        let Some(index) = self.emitters.find(instance, primitive) else {
            return 0.0;
        };
        let pdf = self.emitters.triangles[index].pdf(position, normal, hit);
        if pdf == 0.0 {
            return 0.0;
        }
        pdf * self.pmf(position, normal, self.points.len() + index)
    }

    /// Density per steradian with which [`Lights::sample`] finds the environment in unit direction `wi`.
    pub fn pdf_environment(&self, position: Vec3, normal: Vec3, wi: Vec3) -> f32 {
        let mut pdf = 0.0;
        for (i, sun) in self.suns.iter().enumerate() {
            if sun.contains(wi) {
                pdf += sun.density() * self.pmf(position, normal, self.first_sun() + i);
            }
        }
        if let Some(environment) = &self.environment {
            let pmf = self.pmf(position, normal, self.first_sun() + self.suns.len());
            pdf += environment.pdf(normal, wi) * pmf;
        }
        pdf
    }

    /// Radiance of the environment (and of suns with an extent) seen along unit direction `wi`.
    pub fn environment(&self, wi: Vec3) -> Vec3 {
        let mut radiance = self
            .environment
            .as_ref()
            .map_or(Vec3::ZERO, |e| e.radiance(wi));
        for sun in &self.suns {
            if sun.contains(wi) {
                radiance += sun.radiance;
            }
        }
        radiance
    }
}

/// Further away than this, squared distances overflow and no light would arrive anyway.
const FARTHEST: f32 = 1e18;

fn is_sane(light: &PosedLight) -> bool {
    light.position.abs().max_element() < FARTHEST
        && light.position.is_finite()
        && light.direction.is_normalized()
        && light.intensity.is_finite()
        && light.intensity.min_element() >= 0.0
        && light.intensity.max_element() > 0.0
}

fn sample_point(light: &PointLight, index: usize, position: Vec3, pmf: f32) -> Option<LightSample> {
    let to = light.position - position;
    let distance = to.length();
    let wi = to / distance;
    let radiance = light.intensity_along(-wi) / (distance * distance);
    (distance > 0.0 && radiance.is_finite()).then_some(LightSample {
        light: index,
        wi,
        radiance,
        pdf: pmf,
        delta: true,
        end: LightEnd::Point(light.position),
        target: Some(light.position),
    })
}

/// Area of a disk that covers the scene from every side: turns irradiance from infinitely far into power.
fn cross_section(scene: &Scene, pose: &Pose) -> f32 {
    let (_, radius) = bounding_sphere(scene, pose);
    let area = std::f32::consts::PI * radius * radius;
    if area.is_finite() { area } else { 1.0 }
}

/// Centre and radius of a sphere around all that has a finite place.
pub(crate) fn bounding_sphere(scene: &Scene, pose: &Pose) -> (Vec3, f32) {
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for (index, instance) in pose.instances.iter().enumerate() {
        let positions = pose.positions(scene, index);
        let (mut inner_low, mut inner_high) =
            (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        for &p in positions.iter().filter(|p| p.is_finite()) {
            inner_low = inner_low.min(p);
            inner_high = inner_high.max(p);
        }
        for corner in 0..8 {
            let pick = glam::BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
            let p = instance
                .world_from_object
                .transform_point3(Vec3::select(pick, inner_high, inner_low));
            if p.is_finite() {
                low = low.min(p);
                high = high.max(p);
            }
        }
    }
    ((low + high) * 0.5, 0.5 * (high - low).length())
}

#[cfg(test)]
mod tests;
