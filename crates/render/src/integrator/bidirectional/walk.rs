//! Subpaths on their way, from the camera and from the lights.
//!
//! Both run the same steps. What differs is the quantity that is carried: paths from the camera carry the share of radiance that
//! reaches it, paths from lights flux. Refraction squeezes radiance, not flux (Veach 1997, section 5.2), and shading normals make
//! scattering non-symmetric: flux takes a factor of cosines (Veach 1997, section 5.3, eq. 5.19).

use super::super::path::arriving_density;
use super::vertex::{Facing, NONE, Start, Vertex};
use super::weight::Step;
use crate::bsdf::BsdfSample;
use crate::camera::CameraRay;
use crate::geometry::{Geometry, Surface, is_pane};
use crate::light::{Emitted, Lights};
use crate::sampling::Sampler;
use glam::{Vec2, Vec3};
use occlude_visibility::{Hit, Ray};

/// Panes that a subpath may pass beside its scattering events, before it is given up.
const MOST_PANES: u32 = 64;

/// Scattering events after which roulette may end a subpath.
const ROULETTE_AFTER: u32 = 2;

/// What a subpath carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Carries {
    /// From the camera.
    Radiance,
    /// From a light.
    Flux,
}

/// Density of the points that rays hit, as caches count it: unlike [`Step`] it follows rays through mirrors.
#[derive(Clone, Copy, Debug)]
struct Spread {
    density: f32,
    parallel: bool,
    /// Square metres that the points before the hits are spread over: see [`arriving_density`].
    region: f32,
    /// Length of the way since.
    travelled: f32,
}

/// What light sampling knows of the last scattering event.
#[derive(Clone, Copy, Debug)]
pub(super) struct Last {
    pub(super) position: Vec3,
    pub(super) light_normal: Vec3,
}

/// A subpath on its way to its next vertex.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    pub(super) ray: Ray,
    pub(super) throughput: Vec3,
    pub(super) sampler: Sampler,
    /// Scattering events so far.
    pub(super) depth: u32,
    /// Panes passed so far.
    pub(super) panes: u32,
    carries: Carries,
    pub(super) step: Step,
    /// Length of the way from the last vertex to the ray's origin, through panes.
    travelled: f32,
    spread: Spread,
    /// Samples that all paths of a pass make: what densities for caches are multiplied with.
    samples: f32,
    /// Absorption per metre of what the ray is in.
    absorption: Vec3,
    /// Largest component at the start, over what refraction took since only to give it back later.
    scale: f32,
    pub(super) last: Option<Last>,
    start: Option<Start>,
    /// The last vertex made, panes included.
    pub(super) link: u32,
}

impl Walk {
    /// A path from the camera, one of `samples` of a pass.
    pub(super) fn from_camera(camera: &CameraRay, sampler: Sampler, samples: f32) -> Self {
        let step = Step {
            density: camera.pixel_density / samples,
            parallel: camera.parallel,
            cosine: 1.0,
            adjacent: 1.0,
            // Light does not hit a camera without extent: no strategy beyond.
            rest: 0.0,
        };
        Self {
            carries: Carries::Radiance,
            samples,
            ..Self::new(camera.ray, Vec3::ONE, sampler, step)
        }
    }

    /// A path from a light.
    pub(super) fn from_light(emitted: &Emitted, sampler: Sampler) -> Self {
        let step = Step {
            density: emitted.density.spread,
            parallel: emitted.density.parallel,
            cosine: emitted.cosine,
            // Set where the path arrives: it depends on the place.
            adjacent: 0.0,
            rest: if emitted.origin.is_delta() {
                0.0
            } else {
                super::weight::square(1.0 / emitted.density.start)
            },
        };
        let from_a_point = Self::new(emitted.ray, emitted.flux, sampler, step);
        let has_area = !emitted.origin.is_delta() && !emitted.density.parallel;
        Self {
            start: Some(Start {
                origin: emitted.origin,
                density: emitted.density.start,
            }),
            scale: emitted.flux.max_element(),
            spread: Spread {
                region: if has_area {
                    1.0 / emitted.density.start
                } else {
                    0.0
                },
                ..from_a_point.spread
            },
            ..from_a_point
        }
    }

    fn new(ray: Ray, throughput: Vec3, sampler: Sampler, step: Step) -> Self {
        Self {
            ray,
            throughput,
            sampler,
            depth: 0,
            panes: 0,
            carries: Carries::Flux,
            step,
            travelled: 0.0,
            spread: Spread {
                density: step.density,
                parallel: step.parallel,
                region: 0.0,
                travelled: 0.0,
            },
            samples: 1.0,
            absorption: Vec3::ZERO,
            scale: 1.0,
            last: None,
            start: None,
            link: NONE,
        }
    }

    /// Length of the way from the last vertex to a hit.
    pub(super) fn distance(&self, hit: &Hit) -> f32 {
        self.travelled + hit.t
    }

    /// The surface at a hit, with the light that is absorbed on the way taken off.
    pub(super) fn arrive<'a>(&mut self, geometry: &Geometry<'a>, hit: Hit) -> Option<Surface<'a>> {
        let surface = Surface::new(geometry, hit, -self.ray.direction)?;
        if self.absorption != Vec3::ZERO {
            self.throughput *= (-self.absorption * hit.t).exp();
        }
        Some(surface)
    }

    /// The vertex at a surface where the subpath has arrived.
    pub(super) fn vertex<'a>(
        &self,
        geometry: &Geometry<'a>,
        lights: &Lights,
        surface: Surface<'a>,
    ) -> Option<Vertex<'a>> {
        let viewer = -self.ray.direction;
        let cosine = viewer.dot(surface.normal);
        let mut partial = self.step.arrive(self.distance(&surface.hit), cosine)?;
        let parameters = surface.bsdf_parameters(geometry);
        let facing = Facing::new(surface, &parameters, viewer);
        if let Some(start) = self.start {
            let normal = facing.light_normal(&parameters);
            partial.adjacent = start.adjacent(lights, surface.position, normal);
        }
        let travelled = self.spread.travelled + surface.hit.t;
        let spread = if self.spread.parallel {
            1.0
        } else {
            travelled * travelled
        };
        Some(Vertex {
            facing,
            parameters,
            throughput: self.throughput,
            density: self.samples
                * arriving_density(self.spread.density * cosine / spread, self.spread.region),
            depth: self.depth,
            partial,
            absorption: self.absorption,
            start: self.start,
            link: self.link,
        })
    }

    /// Goes on from a vertex in a sampled direction. `false`: the subpath ends.
    pub(super) fn depart(
        &mut self,
        lights: &Lights,
        vertex: &Vertex,
        max_depth: u32,
        numbers: [f32; 4],
    ) -> bool {
        let [u, v, lobe, roulette] = numbers;
        let facing = &vertex.facing;
        let surface = &facing.surface;
        let Some(sample) = facing.bsdf.sample(facing.wo, lobe, Vec2::new(u, v)) else {
            return false;
        };
        let direction = (surface.world_from_local * sample.wi).normalize();
        let side = direction.dot(surface.normal);
        if !facing.bsdf.connects(sample.wi, side > 0.0) {
            return false;
        }
        // What passes anything but a pane counts as an event, since shadow rays do not pass it.
        if sample.passed && is_pane(surface.material()) {
            self.panes += 1;
            if self.panes > MOST_PANES {
                return false;
            }
            self.travelled += surface.hit.t;
            self.throughput *= sample.weight;
            self.spread.travelled += surface.hit.t;
        } else {
            self.depth += 1;
            if self.depth > max_depth {
                return false;
            }
            let turned = vertex.turned(direction);
            if !sample.delta {
                self.scatter(lights, vertex, &turned, &sample, side.abs());
            } else if !self.scatter_exactly(vertex, &turned, &sample, side.abs()) {
                return false;
            }
            if !self.survives(roulette) {
                return false;
            }
            self.absorption = vertex.absorption_along(direction);
            self.travelled = 0.0;
            self.start = None;
            self.last = (!sample.delta).then(|| Last {
                position: surface.position,
                light_normal: facing.light_normal(&vertex.parameters),
            });
        }
        if self.throughput.max_element() <= 0.0 || !self.throughput.is_finite() {
            return false;
        }
        self.ray = Ray::new(facing.leave(direction), direction);
        true
    }

    /// A rough event.
    fn scatter(
        &mut self,
        lights: &Lights,
        vertex: &Vertex,
        turned: &Facing,
        sample: &BsdfSample,
        cosine: f32,
    ) {
        let viewer = vertex.facing.viewer;
        let (f_cos, reverse) = turned.eval(viewer);
        match self.carries {
            Carries::Radiance => {
                self.throughput *= sample.weight;
                self.scale /= sample.eta2;
            }
            Carries::Flux => {
                // The value is that of radiance the other way; the cosines turn it into that of flux.
                let arriving = viewer.dot(vertex.facing.surface.normal);
                self.throughput *= f_cos * (cosine / (arriving * sample.pdf));
            }
        }
        let adjacent = vertex.adjacent(lights, turned);
        self.step = Step::scattered(&vertex.partial, adjacent, sample.pdf, reverse, cosine);
        self.spread = Spread {
            density: sample.pdf,
            parallel: false,
            region: self.samples / vertex.density,
            travelled: 0.0,
        };
    }

    /// A mirror or clear glass. `false`: a path from the other side would have gone elsewhere.
    fn scatter_exactly(
        &mut self,
        vertex: &Vertex,
        turned: &Facing,
        sample: &BsdfSample,
        cosine: f32,
    ) -> bool {
        let facing = &vertex.facing;
        // A shading normal that is bent towards one viewer mirrors elsewhere than the one that the other side sees.
        let across = facing.surface.normal.dot(turned.surface.normal).signum();
        let same = facing.surface.mirrors_like(&turned.surface, across);
        let arriving = facing.viewer.dot(facing.surface.normal);
        let reverse = if same {
            arriving / (cosine * sample.eta2)
        } else {
            0.0
        };
        match self.carries {
            Carries::Radiance => {
                self.throughput *= sample.weight;
                self.scale /= sample.eta2;
            }
            Carries::Flux => {
                if !same {
                    return false;
                }
                // A mirror image has the cosine of its original, to whichever normal it is one.
                let shading = if across > 0.0 {
                    1.0
                } else {
                    facing.wo.z / turned.wo.z
                };
                self.throughput *= sample.weight * (sample.eta2 * shading * cosine / arriving);
            }
        }
        self.step = Step::exact(&vertex.partial, reverse, cosine);
        self.spread.travelled += facing.surface.hit.t;
        true
    }

    /// Roulette on what is left.
    fn survives(&mut self, roulette: f32) -> bool {
        if self.depth < ROULETTE_AFTER {
            return true;
        }
        let survival = (self.throughput.max_element() / self.scale).min(1.0);
        if roulette >= survival {
            return false;
        }
        self.throughput /= survival;
        self.spread.density *= survival;
        true
    }
}
