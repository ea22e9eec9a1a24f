//! Numbers about a scene, for reports.

use crate::{Mesh, Pose, Scene, Texels};
use glam::Vec3;
use rayon::prelude::*;

impl Scene {
    /// Triangles of all meshes, each mesh counted once.
    pub fn unique_triangles(&self) -> u64 {
        self.meshes.iter().map(|m| m.triangles.len() as u64).sum()
    }

    /// Triangles of all instances: what a flat scene would hold.
    pub fn instanced_triangles(&self) -> u64 {
        let of = |mesh: u32| {
            self.meshes
                .get(mesh as usize)
                .map_or(0, |m| m.triangles.len() as u64)
        };
        self.instances.iter().map(|i| of(i.mesh)).sum()
    }

    /// Bytes that the large arrays take: geometry, images and animation.
    pub fn memory_bytes(&self) -> u64 {
        let meshes: u64 = self.meshes.iter().map(mesh_bytes).sum();
        let images: u64 = self
            .images
            .iter()
            .map(|image| match &image.texels {
                Texels::Rgba8(texels) => size_of_val(texels.as_slice()) as u64,
                Texels::Rgba16(texels) => size_of_val(texels.as_slice()) as u64,
            })
            .sum();
        let keys: u64 = self
            .motion
            .clips
            .iter()
            .flat_map(|clip| &clip.channels)
            .map(|c| 4 * (c.times.len() + c.values.len()) as u64)
            .sum();
        let lists = size_of_val(self.nodes.as_slice())
            + size_of_val(self.instances.as_slice())
            + size_of_val(self.materials.as_slice());
        meshes + images + keys + lists as u64
    }

    /// The box around all instances at one time, lowest and highest corner; `None` without geometry.
    pub fn bounds(&self, pose: &Pose) -> Option<[Vec3; 2]> {
        let of_instance = |i: usize| {
            let world_from_object = pose.instances[i].world_from_object;
            pose.positions(self, i)
                .par_chunks(16_384)
                .map(|chunk| {
                    chunk.iter().fold(EMPTY, |bounds, &p| {
                        let p = world_from_object.transform_point3(p);
                        if p.is_finite() {
                            union(bounds, [p, p])
                        } else {
                            bounds
                        }
                    })
                })
                .reduce(|| EMPTY, union)
        };
        let all = (0..pose.instances.len())
            .into_par_iter()
            .map(of_instance)
            .reduce(|| EMPTY, union);
        all[0].cmple(all[1]).all().then_some(all)
    }
}

const EMPTY: [Vec3; 2] = [Vec3::INFINITY, Vec3::NEG_INFINITY];

fn union(a: [Vec3; 2], b: [Vec3; 2]) -> [Vec3; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

fn mesh_bytes(mesh: &Mesh) -> u64 {
    let mut bytes = size_of_val(mesh.positions.as_slice())
        + size_of_val(mesh.normals.as_slice())
        + size_of_val(mesh.tangents.as_slice())
        + size_of_val(mesh.uv0.as_slice())
        + size_of_val(mesh.uv1.as_slice())
        + size_of_val(mesh.colors.as_slice())
        + size_of_val(mesh.triangles.as_slice());
    if let Some(skinning) = &mesh.skinning {
        bytes += size_of_val(skinning.joints.as_slice()) + size_of_val(skinning.weights.as_slice());
    }
    for target in &mesh.morph_targets {
        bytes += size_of_val(target.positions.as_slice())
            + size_of_val(target.normals.as_slice())
            + size_of_val(target.tangents.as_slice());
    }
    bytes as u64
}
