//! What surfaces reflect and emit, for transport between texels: every surface is Lambert.

use super::{Band, Texels};
use glam::{Vec2, Vec3};
use occlude_render::geometry::{diffuse_albedo, front_emission};
use occlude_scene::Scene;
use occlude_visibility::Hit;

/// Share of light that a surface reflects and the radiance that its front side emits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reflection {
    /// Lambert albedo.
    pub albedo: Vec3,
    /// Radiance; the back emits the same if the material is double-sided or unlit.
    pub emission: Vec3,
}

/// At a point of a surface (`instance`, `primitive`, `u` and `v` of the hit count).
pub fn reflection(scene: &Scene, mesh: u32, hit: Hit) -> Reflection {
    let mesh = &scene.meshes[mesh as usize];
    Reflection {
        albedo: diffuse_albedo(scene, mesh, hit.primitive, hit.u, hit.v),
        emission: front_emission(scene, mesh, hit.primitive, hit.u, hit.v),
    }
}

/// Points of a texel that are looked at where a texture varies.
const POINTS: usize = 8;

impl Texels<'_> {
    /// The mean of the covered part of the `i`-th texel of a band.
    pub fn reflection(&self, band: &Band, i: usize) -> Reflection {
        let fragments = band.fragments(i);
        let mesh_of = |instance: u32| self.pose.instances[instance as usize].mesh;
        let constant = |instance: u32| {
            let mesh = &self.scene.meshes[mesh_of(instance) as usize];
            let m = &self.scene.materials[mesh.material as usize];
            m.base_color_texture.is_none() && m.emission_texture.is_none() && mesh.colors.is_empty()
        };
        let one = fragments
            .iter()
            .all(|f| f.instance == fragments[0].instance);
        if one && constant(fragments[0].instance) {
            let f = fragments[0];
            let hit = Hit {
                t: 0.0,
                u: 0.0,
                v: 0.0,
                instance: f.instance,
                primitive: f.primitive,
            };
            return reflection(self.scene, mesh_of(f.instance), hit);
        }
        let mut mean = Reflection::default();
        for k in 0..POINTS {
            // The R2 sequence (Roberts 2018): even in any number of points.
            let at = Vec2::new(0.5 + k as f32 * 0.754_877_7, 0.5 + k as f32 * 0.569_840_3).fract();
            let hit = self.sample(band, i, at);
            let r = reflection(self.scene, mesh_of(hit.instance), hit);
            mean.albedo += r.albedo / POINTS as f32;
            mean.emission += r.emission / POINTS as f32;
        }
        mean
    }
}
