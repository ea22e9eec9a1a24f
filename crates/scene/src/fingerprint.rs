//! A number that changes when a scene does.

use crate::{Pose, Scene, Texels};

/// A running 64-bit hash: for telling works apart, not against forgers.
struct Fingerprint(u64);

impl Fingerprint {
    fn word(&mut self, word: u64) {
        // Folded multiplication, as in wyhash (Wang Yi 2019).
        let product = u128::from(self.0 ^ word) * 0x9e37_79b9_7f4a_7c15;
        self.0 = ((product as u64) ^ ((product >> 64) as u64)).wrapping_add(0xf39c_c060_5ced_c835);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.word(bytes.len() as u64);
        let chunks = bytes.chunks_exact(8);
        let mut last = [0; 8];
        last[..chunks.remainder().len()].copy_from_slice(chunks.remainder());
        for chunk in chunks {
            let mut word = [0; 8];
            word.copy_from_slice(chunk);
            self.word(u64::from_le_bytes(word));
        }
        self.word(u64::from_le_bytes(last));
    }

    fn array<T: bytemuck::NoUninit>(&mut self, values: &[T]) {
        self.bytes(bytemuck::cast_slice(values));
    }

    fn text(&mut self, value: &impl std::fmt::Debug) {
        self.bytes(format!("{value:?}").as_bytes());
    }
}

/// A number for everything that a picture of the scene at this pose depends on (other than the camera that is chosen).
/// Equal scenes give equal numbers on every machine; takes about a second a gigabyte.
pub fn fingerprint(scene: &Scene, pose: &Pose) -> u64 {
    let mut hash = Fingerprint(0x6f63_636c_7564_6521);
    for mesh in &scene.meshes {
        hash.array(&mesh.positions);
        hash.array(&mesh.normals);
        hash.array(&mesh.tangents);
        hash.array(&mesh.uv0);
        hash.array(&mesh.uv1);
        hash.array(&mesh.colors);
        hash.array(&mesh.triangles);
        hash.word(u64::from(mesh.material));
    }
    for image in &scene.images {
        hash.word(u64::from(image.width) << 32 | u64::from(image.height));
        match &image.texels {
            Texels::Rgba8(texels) => hash.array(texels),
            Texels::Rgba16(texels) => hash.array(texels),
        }
    }
    hash.text(&scene.textures);
    hash.text(&scene.materials);
    hash.text(&scene.cameras);
    hash.text(&scene.sky);
    hash.text(&pose.lights);
    for posed in &pose.instances {
        hash.word(u64::from(posed.mesh));
        hash.array(&posed.world_from_object.to_cols_array());
    }
    for deformed in &pose.deformed {
        hash.array(&deformed.positions);
        hash.array(&deformed.normals);
        hash.array(&deformed.tangents);
    }
    hash.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, Mesh};
    use glam::Vec3;

    #[test]
    fn any_change_shows() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO; 3],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let scene = Scene {
            meshes: vec![mesh],
            materials: vec![Material::default()],
            ..Scene::default()
        };
        let pose = Pose::default();
        let plain = fingerprint(&scene, &pose);
        assert_eq!(plain, fingerprint(&scene.clone(), &pose));
        let mut moved = scene.clone();
        moved.meshes[0].positions[2].z = 1e-30;
        let mut rougher = scene.clone();
        rougher.materials[0].roughness = 0.999;
        assert!(plain != fingerprint(&moved, &pose) && plain != fingerprint(&rougher, &pose));
    }
}
