//! What subpaths bring: each way to cut a path, its value and its weight.

use super::Techniques;
use super::vertex::Vertex;
use super::walk::Walk;
use super::weight::square;
use crate::camera::{PixelFilter, View};
use crate::geometry::Surface;
use crate::integrator::World;
use crate::light::{Emission, Origin};
use glam::{Vec2, Vec3};
use occlude_visibility::{Endpoint, Hit, LightEnd, Query, Ray};

/// Questions of one sample about the camera, as caches count them. There is one, but what it decides is seen at full sharpness:
/// so many more keep a cache's patches as small as one sample, where it lets errors at point lights reach four.
const FINER: f32 = 16.0;

/// All that is the same for every path of a pass.
#[derive(Clone, Copy)]
pub(super) struct Stage<'s, 'a> {
    pub(super) world: &'s World<'a>,
    pub(super) view: &'s View,
    pub(super) filter: PixelFilter,
    pub(super) emission: &'s Emission,
    /// Paths from the camera in one pass over the picture, and as many from lights.
    pub(super) samples: f32,
    pub(super) max_depth: u32,
    pub(super) techniques: Techniques,
}

/// What a connection brings if nothing is in the way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Connection {
    pub(super) query: Query,
    /// Weighted.
    pub(super) contribution: Vec3,
}

impl Connection {
    fn new(query: Query, value: Vec3, weight: f32) -> Option<Self> {
        let contribution = value * weight;
        let useful = contribution != Vec3::ZERO && contribution.is_finite();
        useful.then_some(Self {
            query: Query {
                importance: contribution.element_sum(),
                ..query
            },
            contribution,
        })
    }
}

/// The weight of a strategy, from the sums over all others.
fn weight(others: f64) -> f32 {
    (1.0 / (1.0 + others)) as f32
}

impl Stage<'_, '_> {
    /// `s = 0`: weight of a path from the camera that has hit an emitter.
    pub(super) fn hit_surface(&self, walk: &Walk, surface: &Surface) -> f32 {
        self.techniques.weigh(0, walk.depth + 2, || {
            if walk.depth == 0 {
                return 1.0;
            }
            let Hit {
                instance,
                primitive,
                ..
            } = surface.hit;
            let lights = self.world.lights;
            // What emits but is no light (unlit surfaces) is found in no other way.
            let Some(origin) = lights.origin_on(instance, primitive, surface.position) else {
                return 1.0;
            };
            let cosine = surface.normal.dot(-walk.ray.direction);
            let Some(partial) = walk.step.arrive(walk.distance(&surface.hit), cosine) else {
                return 0.0;
            };
            weight(partial.inverse * self.without_hit(walk, origin, partial.rest))
        })
    }

    /// `s = 0` too: weight of a path that leaves the scene.
    pub(super) fn hit_sky(&self, walk: &Walk) -> f32 {
        self.techniques.weigh(0, walk.depth + 2, || {
            if walk.depth == 0 {
                return 1.0;
            }
            let rest = walk.step.rest * square(walk.step.cosine);
            let others = self.without_hit(walk, Origin::Sky(walk.ray.direction), rest);
            weight(others / square(walk.step.density))
        })
    }

    /// Squared densities of an origin by light sampling, and by emission with all that follows from it.
    fn without_hit(&self, walk: &Walk, origin: Origin, rest: f64) -> f64 {
        let lights = self.world.lights;
        let sampled = walk.last.map_or(0.0, |last| {
            lights.connection_density(last.position, last.light_normal, origin)
        });
        let emitted = self.emission.density(lights, origin, -walk.ray.direction);
        square(sampled) + square(emitted.start) * square(emitted.spread) * rest
    }

    /// `s = 1`: a vertex of a path from the camera asks a light.
    pub(super) fn next_event(&self, eye: &Vertex, pick: f32, u: Vec2) -> Option<Connection> {
        let (world, facing) = (self.world, &eye.facing);
        let position = facing.surface.position;
        let normal = facing.light_normal(&eye.parameters);
        let light = world
            .lights
            .sample(world.geometry.scene, position, normal, pick, u)?;
        let (f_cos, pdf) = facing.eval(light.wi);
        if f_cos == Vec3::ZERO {
            return None;
        }
        let weight = self.techniques.weigh(1, eye.depth + 2, || {
            let hit = if light.delta {
                0.0
            } else {
                square(pdf / light.pdf)
            };
            let origin = Origin::of_sample(&light);
            let emitted = self.emission.density(world.lights, origin, -light.wi);
            let (sampled, across) = match light.end {
                LightEnd::Surface(end) => (end.density, (end.position - position).length_squared()),
                LightEnd::Point(point) => (light.pdf, (point - position).length_squared()),
                LightEnd::Direction(_) | LightEnd::SolidAngle { .. } => (light.pdf, 1.0),
            };
            let cosine = light.wi.dot(facing.surface.normal).abs();
            let arrives = emitted.start / sampled * (emitted.spread * cosine / across);
            let (_, reverse) = eye.turned(light.wi).eval(facing.viewer);
            weight(hit + eye.partial.sum(arrives, reverse))
        });
        let (origin, ray_end) = (facing.leave(light.wi), light.target);
        let ray = match ray_end {
            Some(target) => Ray::between(origin, target),
            None => Ray::new(origin, light.wi),
        };
        let mut value = eye.throughput * f_cos * light.radiance / light.pdf;
        if let Some(target) = ray_end {
            value *= transmitted(eye, light.wi, target.distance(position));
        }
        // The densities of other ends hold the probability of the pick; exact ends have none to hold it.
        let connections = if light.delta { light.pdf } else { 1.0 };
        let query = Query {
            connections,
            ..Query::new(eye.endpoint(light.wi), light.end, ray)
        };
        Connection::new(query, value, weight)
    }

    /// `s, t >= 2`: a vertex of a path from the camera and one from a light.
    pub(super) fn join(&self, eye: &Vertex, light: &Vertex) -> Option<Connection> {
        let (from, to) = (&eye.facing, &light.facing);
        let way = to.surface.position - from.surface.position;
        let across = way.length_squared();
        let direction = way / across.sqrt();
        if !direction.is_finite() {
            return None;
        }
        let (eye_f, eye_pdf) = from.eval(direction);
        if eye_f == Vec3::ZERO {
            return None;
        }
        let light_turned = light.turned(-direction);
        let (light_f, light_reverse) = light_turned.eval(to.viewer);
        if light_f == Vec3::ZERO {
            return None;
        }
        let eye_cosine = direction.dot(from.surface.normal).abs();
        let light_cosine = direction.dot(to.surface.normal).abs();
        let weight = self.techniques.weigh(light.depth + 2, eye.depth + 2, || {
            let (_, light_pdf) = to.eval(-direction);
            let (_, eye_reverse) = eye.turned(direction).eval(from.viewer);
            let from_eye = light.sum_seen(
                self.world.lights,
                &light_turned,
                eye_pdf * light_cosine / across,
                light_reverse,
            );
            let from_light = eye
                .partial
                .sum(light_pdf * eye_cosine / across, eye_reverse);
            weight(from_eye + from_light)
        });
        let arriving = to.viewer.dot(to.surface.normal);
        let value = eye.throughput
            * eye_f
            * light_f
            * light.throughput
            * (light_cosine / (across * arriving))
            * transmitted(eye, direction, across.sqrt());
        let ray = Ray::between(from.leave(direction), to.leave(-direction));
        let end = LightEnd::Surface(light.endpoint(-direction));
        Connection::new(Query::new(eye.endpoint(direction), end, ray), value, weight)
    }

    /// `t = 1`: a vertex of a path from a light and the camera. Also the point of the picture; the contribution is the radiance
    /// there, in a picture of one light path a pixel, without the filter.
    pub(super) fn show(&self, light: &Vertex) -> Option<(Vec2, Connection)> {
        let to = &light.facing;
        let position = to.surface.position;
        let seen = self.view.project(position)?;
        let reach = self.filter.radius() - 0.5;
        let size = Vec2::new(self.view.width() as f32, self.view.height() as f32);
        let inside =
            seen.point.cmpge(Vec2::splat(-reach)).all() && seen.point.cmplt(size + reach).all();
        if !inside {
            return None;
        }
        let turned = light.turned(seen.toward_camera);
        let (f_cos, reverse) = turned.eval(to.viewer);
        if f_cos == Vec3::ZERO {
            return None;
        }
        let density = seen.density * seen.toward_camera.dot(to.surface.normal).abs();
        let weight = self.techniques.weigh(light.depth + 2, 1, || {
            weight(light.sum_seen(self.world.lights, &turned, density / self.samples, reverse))
        });
        let arriving = to.viewer.dot(to.surface.normal);
        let value = light.throughput
            * f_cos
            * (density / (arriving * self.samples))
            * transmitted(light, seen.toward_camera, seen.eye.distance(position));
        // The camera is the point that many ask about; what asks are the samples that it would have put there.
        let normal = to.normal_towards(seen.toward_camera);
        let end = Endpoint::new(position, normal, density);
        let ray = Ray::between(to.leave(seen.toward_camera), seen.eye);
        let query = Query {
            connections: FINER,
            ..Query::new(end, LightEnd::Point(seen.eye), ray)
        };
        Connection::new(query, value, weight).map(|connection| (seen.point, connection))
    }
}

impl Vertex<'_> {
    /// [`super::weight::Partial::sum`] of a vertex of a light path that the camera's side sees as `turned`.
    fn sum_seen(
        &self,
        lights: &crate::light::Lights,
        turned: &super::vertex::Facing,
        q: f32,
        toward_previous: f32,
    ) -> f64 {
        let mut partial = self.partial;
        partial.adjacent = self.adjacent(lights, turned);
        partial.sum(q, toward_previous)
    }
}

/// What absorption leaves of light on the way from a vertex.
fn transmitted(from: &Vertex, direction: Vec3, distance: f32) -> Vec3 {
    let absorption = from.absorption_along(direction);
    if absorption == Vec3::ZERO {
        Vec3::ONE
    } else {
        (-absorption * distance).exp()
    }
}
