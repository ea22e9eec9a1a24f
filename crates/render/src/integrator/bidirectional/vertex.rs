//! Vertices of subpaths.

use super::weight::Partial;
use crate::bsdf::{Bsdf, BsdfParameters};
use crate::geometry::Surface;
use crate::light::{Lights, Origin};
use glam::Vec3;
use occlude_visibility::{Endpoint, offset_along_normal};

/// No vertex.
pub(super) const NONE: u32 = u32::MAX;

/// A surface point as it is seen from one direction.
///
/// Values are always those of radiance that leaves towards the camera, and densities those of the sampler on the side in
/// question, whichever way a subpath runs. Shading normals are bent towards the viewer, so the frame depends on who looks:
/// turning a point asks the same functions that a path from there would have asked, and weights sum to one to the last bit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Facing<'a> {
    pub(super) surface: Surface<'a>,
    pub(super) bsdf: Bsdf,
    /// Unit vector to the viewer, world space.
    pub(super) viewer: Vec3,
    /// The same in the local frame.
    pub(super) wo: Vec3,
}

impl<'a> Facing<'a> {
    pub(super) fn new(surface: Surface<'a>, parameters: &BsdfParameters, viewer: Vec3) -> Self {
        let wo = surface.world_from_local.transpose() * viewer;
        let parameters = BsdfParameters {
            entering: surface.front,
            coat_normal: surface.coat_normal(),
            ..*parameters
        };
        Self {
            surface,
            bsdf: Bsdf::new(&parameters, wo),
            viewer,
            wo,
        }
    }

    /// `(f |cos|, pdf)` of light that arrives along `wi` (world space) and leaves to the viewer, exact lobes left out.
    pub(super) fn eval(&self, wi: Vec3) -> (Vec3, f32) {
        let local = self.surface.world_from_local.transpose() * wi;
        if self.bsdf.connects(local, wi.dot(self.surface.normal) > 0.0) {
            self.bsdf.eval(self.wo, local)
        } else {
            (Vec3::ZERO, 0.0)
        }
    }

    /// What light sampling is told about the surface: its shading normal, or zero if light from below counts too.
    pub(super) fn light_normal(&self, parameters: &BsdfParameters) -> Vec3 {
        if parameters.reaches_below() {
            Vec3::ZERO
        } else {
            self.surface.shading_normal()
        }
    }

    /// Unit geometric normal on the side of `direction`.
    pub(super) fn normal_towards(&self, direction: Vec3) -> Vec3 {
        self.surface.normal * direction.dot(self.surface.normal).signum()
    }

    /// Where a ray along `direction` starts.
    pub(super) fn leave(&self, direction: Vec3) -> Vec3 {
        let Surface {
            position, extent, ..
        } = self.surface;
        offset_along_normal(position, self.normal_towards(direction), extent)
    }
}

/// How the light's point at the start of a subpath was found, kept at the vertex after it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub(super) origin: Origin,
    /// Density of the origin by emission.
    pub(super) density: f32,
}

/// A surface point at which a subpath scatters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex<'a> {
    /// As the vertex before sees it.
    pub(super) facing: Facing<'a>,
    pub(super) parameters: BsdfParameters,
    /// Radiance (flux, from the light) that arrives over what the subpath carries.
    pub(super) throughput: Vec3,
    /// Samples per square metre, for caches.
    pub(super) density: f32,
    /// Scattering events before this vertex.
    pub(super) depth: u32,
    pub(super) partial: Partial,
    /// Absorption per metre of what the subpath came through.
    pub(super) absorption: Vec3,
    /// The first vertex of a path from a light.
    pub(super) start: Option<Start>,
    /// The vertex that its path made before it, panes included: the list of all.
    pub(super) link: u32,
}

impl<'a> Vertex<'a> {
    /// The vertex as it is seen from elsewhere.
    pub(super) fn turned(&self, viewer: Vec3) -> Facing<'a> {
        let surface = self.facing.surface.turned(viewer);
        Facing::new(surface, &self.parameters, viewer)
    }

    /// [`Partial::adjacent`] of the vertex if a path from the camera ends there seen as `turned`: light sampling looks at the shading normal.
    pub(super) fn adjacent(&self, lights: &Lights, turned: &Facing) -> f64 {
        let Some(start) = self.start else {
            return self.partial.adjacent;
        };
        let normal = turned.light_normal(&self.parameters);
        if normal == self.facing.light_normal(&self.parameters) {
            return self.partial.adjacent;
        }
        start.adjacent(lights, turned.surface.position, normal)
    }

    /// The vertex as the end of a visibility question.
    pub(super) fn endpoint(&self, direction: Vec3) -> Endpoint {
        let normal = self.facing.normal_towards(direction);
        Endpoint::new(self.facing.surface.position, normal, self.density)
    }

    /// Absorption per metre of what lies beyond the vertex along `direction`.
    pub(super) fn absorption_along(&self, direction: Vec3) -> Vec3 {
        let surface = &self.facing.surface;
        if direction.dot(surface.normal) >= 0.0 {
            return self.absorption;
        }
        let Some(volume) = surface.material().volume else {
            return self.absorption;
        };
        if surface.front && volume.attenuation_distance.is_finite() {
            let color = volume.attenuation_color.max(Vec3::splat(f32::MIN_POSITIVE));
            -color.map(f32::ln) / volume.attenuation_distance
        } else {
            Vec3::ZERO
        }
    }
}

impl Start {
    /// Squared density of the origin by light sampling from a place over that by emission.
    pub(super) fn adjacent(&self, lights: &Lights, position: Vec3, normal: Vec3) -> f64 {
        let density = lights.connection_density(position, normal, self.origin);
        super::weight::square(density / self.density)
    }
}
