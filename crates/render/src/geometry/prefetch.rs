//! Memory that shading will read, asked for in time.
//!
//! What a hit needs lies in a chain: the triangle's vertex numbers, its vertices, then the texels at their UVs. Scattered
//! rays find each link in main memory. Hits are shaded a few at a time; meanwhile the links of the next ones arrive.

use super::Geometry;
use super::alpha::uv;
use occlude_scene::{Mesh, prefetch};
use occlude_visibility::Hit;
use std::ops::Range;

/// Hits between one link of the chain and the next: their shading takes about as long as memory does.
const GROUP: usize = 8;

impl Geometry<'_> {
    /// To be called before hit `next` is shaded, hits being shaded in order: asks memory for what the following ones will read.
    #[inline]
    pub fn prefetch(&self, hits: &[Option<Hit>], next: usize) {
        if !next.is_multiple_of(GROUP) {
            return;
        }
        // The first call has everything before it to catch up with.
        let from = |group: usize| if next == 0 { 0 } else { next + group * GROUP };
        let part = |from: usize, group: usize| -> Range<usize> {
            let end = (next + (group + 1) * GROUP).min(hits.len());
            from.min(end)..end
        };
        for hit in hits[part(from(3), 3)].iter().flatten() {
            prefetch(&self.mesh(hit).triangles, hit.primitive as usize);
        }
        for hit in hits[part(from(2), 2)].iter().flatten() {
            self.prefetch_vertices(hit);
        }
        for hit in hits[part(from(1), 1)].iter().flatten() {
            self.prefetch_texels(hit);
        }
    }

    fn mesh(&self, hit: &Hit) -> &Mesh {
        let posed = &self.pose.instances[hit.instance as usize];
        &self.scene.meshes[posed.mesh as usize]
    }

    fn prefetch_vertices(&self, hit: &Hit) {
        let instance = hit.instance as usize;
        let mesh = self.mesh(hit);
        let positions = self.pose.positions(self.scene, instance);
        let normals = self.pose.normals(self.scene, instance);
        let tangents = self.pose.tangents(self.scene, instance);
        for vertex in mesh.triangles[hit.primitive as usize] {
            let vertex = vertex as usize;
            prefetch(positions, vertex);
            prefetch(normals, vertex);
            prefetch(tangents, vertex);
            prefetch(&mesh.uv0, vertex);
        }
    }

    /// The common textures; others are read too seldom to be worth the asking.
    fn prefetch_texels(&self, hit: &Hit) {
        let mesh = self.mesh(hit);
        let material = &self.scene.materials[mesh.material as usize];
        let normal = material.normal.as_ref().map(|map| &map.texture);
        let textures = [
            material.base_color_texture.as_ref(),
            material.metallic_roughness_texture.as_ref(),
            normal,
        ];
        for texture in textures.into_iter().flatten() {
            let at = uv(mesh, texture, hit.primitive, hit.u, hit.v);
            self.scene.textures[texture.texture as usize]
                .prefetch(&self.scene.images, at.to_array());
        }
    }
}
