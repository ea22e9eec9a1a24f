//! Lights: where light comes from, and which one to ask.

use glam::{Vec2, Vec3};
use occlude_scene::{Pose, Scene};
use occlude_visibility::LightEnd;

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
    /// Unit vector towards the light.
    pub wi: Vec3,
    /// Radiance that arrives from there if nothing blocks it; for delta lights the irradiance on a facing surface.
    pub radiance: Vec3,
    /// Density per steradian, the probability of having picked this light included; for delta lights that probability alone.
    pub pdf: f32,
    /// A point, spot or exact directional light: no other way of sampling finds it.
    pub delta: bool,
    /// The light's end of the visibility question.
    pub end: LightEnd,
    /// Where the shadow ray ends: a point moved off the emitter, or `None` for infinitely far away.
    pub target: Option<Vec3>,
}

/// All lights of a posed scene together: they behave as one light.
#[derive(Debug)]
pub struct Lights {}

impl Lights {
    /// Collects punctual lights, emissive triangles and the environment.
    pub fn new(
        scene: &Scene,
        pose: &Pose,
        environment: Option<Environment>,
        selection: LightSelection,
    ) -> Self {
        let _ = (scene, pose, environment, selection);
        todo!()
    }

    /// Number of lights (emissive triangles counted one by one, the environment as one).
    pub fn len(&self) -> usize {
        todo!()
    }

    /// Whether there is no light at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Samples light arriving at a point. `normal` is the shading normal, or zero where light from all sides counts.
    pub fn sample(
        &self,
        scene: &Scene,
        position: Vec3,
        normal: Vec3,
        pick: f32,
        u: Vec2,
    ) -> Option<LightSample> {
        let _ = (scene, position, normal, pick, u);
        todo!()
    }

    /// Density per steradian with which [`Lights::sample`] at `position` finds the point `hit` of an emissive triangle.
    pub fn pdf_surface(
        &self,
        position: Vec3,
        normal: Vec3,
        instance: u32,
        primitive: u32,
        hit: Vec3,
    ) -> f32 {
        let _ = (position, normal, instance, primitive, hit);
        todo!()
    }

    /// Density per steradian with which [`Lights::sample`] finds the environment in unit direction `wi`.
    pub fn pdf_environment(&self, position: Vec3, normal: Vec3, wi: Vec3) -> f32 {
        let _ = (position, normal, wi);
        todo!()
    }

    /// Radiance of the environment (and of suns with an extent) seen along unit direction `wi`.
    pub fn environment(&self, wi: Vec3) -> Vec3 {
        let _ = wi;
        todo!()
    }
}

/// A sky: constant, or a lat-long map that is sampled by its brightness.
#[derive(Clone, Debug)]
pub struct Environment {}
