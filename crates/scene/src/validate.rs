//! The one check that every maker of scenes ends with: after it, no index in a [`Scene`] can go astray.

use crate::{Material, Mesh, MorphTarget, Scene, SceneError, Skin, Target, Texels, TextureRef};
use rayon::prelude::*;

type Finding = Result<(), (String, String)>;

fn check(holds: bool, place: impl FnOnce() -> String, what: &str) -> Finding {
    if holds {
        Ok(())
    } else {
        Err((place(), what.to_string()))
    }
}

impl Scene {
    /// Checks every index and every array length of the scene, and that positions are finite.
    pub fn validate(self) -> Result<Self, SceneError> {
        match self.examine() {
            Ok(()) => Ok(self),
            Err((place, what)) => Err(SceneError::invalid(
                &self.path,
                &place,
                &what,
                "the maker of this scene is at fault",
            )),
        }
    }

    fn examine(&self) -> Finding {
        let nodes = self.nodes.len();
        for (i, node) in self.nodes.iter().enumerate() {
            let place = || format!("node {i}");
            check(
                node.parent.is_none_or(|p| (p as usize) < i),
                place,
                "parent after its child",
            )?;
            check(
                node.parent_from_node.is_finite(),
                place,
                "transform is not finite",
            )?;
        }
        self.meshes
            .par_iter()
            .enumerate()
            .map(|(i, mesh)| examine_mesh(mesh, i, self.materials.len()))
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Finding>()?;
        for (i, skin) in self.skins.iter().enumerate() {
            let Skin {
                joints,
                joint_from_object,
            } = skin;
            let place = || format!("skin {i}");
            check(
                joints.len() == joint_from_object.len(),
                place,
                "joints without matrix",
            )?;
            check(
                joints.iter().all(|&j| (j as usize) < nodes),
                place,
                "joint is no node",
            )?;
        }
        for (i, instance) in self.instances.iter().enumerate() {
            let place = || format!("instance {i}");
            let mesh = self.meshes.get(instance.mesh as usize);
            check(mesh.is_some(), place, "mesh does not exist")?;
            check(
                (instance.node as usize) < nodes,
                place,
                "node does not exist",
            )?;
            check(
                instance.node_from_object.is_finite(),
                place,
                "transform is not finite",
            )?;
            if let (Some(skin), Some(mesh)) = (instance.skin, mesh) {
                let joints = self.skins.get(skin as usize).map(|s| s.joints.len());
                check(joints.is_some(), place, "skin does not exist")?;
                let used = mesh
                    .skinning
                    .as_ref()
                    .map(|s| s.joints.as_flattened().iter().max());
                check(used.is_some(), place, "a skin, but its mesh has no joints")?;
                let highest = used.flatten().copied().map_or(0, |j| usize::from(j) + 1);
                check(
                    highest <= joints.unwrap_or(0),
                    place,
                    "joint index out of range",
                )?;
            }
        }
        self.examine_looks()?;
        let on_node = |node: u32| (node as usize) < nodes;
        for (i, light) in self.lights.iter().enumerate() {
            check(
                on_node(light.node),
                || format!("light {i}"),
                "node does not exist",
            )?;
        }
        for (i, camera) in self.cameras.iter().enumerate() {
            check(
                on_node(camera.node),
                || format!("camera {i}"),
                "node does not exist",
            )?;
        }
        self.examine_motion()
    }

    fn examine_looks(&self) -> Finding {
        for (i, image) in self.images.iter().enumerate() {
            let texels = match &image.texels {
                Texels::Rgba8(texels) => texels.len(),
                Texels::Rgba16(texels) => texels.len(),
            } as u64;
            let size = u64::from(image.width) * u64::from(image.height);
            check(
                size > 0 && texels == size,
                || format!("image {i}"),
                "size and texels disagree",
            )?;
        }
        for (i, texture) in self.textures.iter().enumerate() {
            let image = (texture.image as usize) < self.images.len();
            check(image, || format!("texture {i}"), "image does not exist")?;
        }
        for (i, material) in self.materials.iter().enumerate() {
            for texture in textures(material).into_iter().flatten() {
                let place = || format!("material {i}");
                let known = (texture.texture as usize) < self.textures.len();
                check(known, place, "texture does not exist")?;
                check(texture.uv_set < 2, place, "UV set above 1")?;
            }
        }
        Ok(())
    }

    fn examine_motion(&self) -> Finding {
        let motion = &self.motion;
        let nodes = self.nodes.len();
        let ascending = motion.rest.is_sorted_by(|a, b| a.node < b.node)
            && motion.weights.is_sorted_by(|a, b| a.node < b.node);
        let last = motion
            .rest
            .last()
            .map(|r| r.node)
            .max(motion.weights.last().map(|w| w.node));
        let known = ascending && last.is_none_or(|n| (n as usize) < nodes);
        check(
            known,
            || "motion".to_string(),
            "rest states not ascending by node",
        )?;
        for channel in motion.clips.iter().flat_map(|c| &c.channels) {
            let place = || format!("animation of node {}", channel.node);
            let parts = if channel.interpolation == crate::Interpolation::CubicSpline {
                3
            } else {
                1
            };
            let numbers = channel.times.len().checked_mul(parts * channel.width);
            check(
                numbers == Some(channel.values.len()),
                place,
                "keys and values disagree",
            )?;
            check(channel.times.is_sorted(), place, "times do not ascend")?;
            let width = match channel.target {
                Target::Translation | Target::Scale => 3,
                Target::Rotation => 4,
                Target::Weights => channel.width,
            };
            check(channel.width == width, place, "wrong number of components")?;
        }
        Ok(())
    }
}

fn examine_mesh(mesh: &Mesh, index: usize, materials: usize) -> Finding {
    let place = || format!("mesh {index} ({:?})", mesh.name);
    let count = mesh.positions.len();
    let fits = |length: usize| length == 0 || length == count;
    let arrays = fits(mesh.normals.len())
        && fits(mesh.tangents.len())
        && fits(mesh.uv0.len())
        && fits(mesh.uv1.len())
        && fits(mesh.colors.len());
    check(arrays, place, "vertex arrays differ in length")?;
    let skinning = mesh.skinning.as_ref();
    let skinned = skinning.is_none_or(|s| s.joints.len() == count && s.weights.len() == count);
    check(skinned, place, "skinning arrays differ in length")?;
    let target_fits = |t: &MorphTarget| {
        fits(t.positions.len()) && fits(t.normals.len()) && fits(t.tangents.len())
    };
    check(
        mesh.morph_targets.iter().all(target_fits),
        place,
        "morph target differs in length",
    )?;
    check(
        (mesh.material as usize) < materials,
        place,
        "material does not exist",
    )?;
    check(
        mesh.positions.iter().all(|p| p.is_finite()),
        place,
        "position is not finite",
    )?;
    let highest = mesh.triangles.as_flattened().iter().max();
    check(
        highest.is_none_or(|&i| (i as usize) < count),
        place,
        "vertex index out of range",
    )
}

fn textures(m: &Material) -> [Option<TextureRef>; 12] {
    [
        m.base_color_texture,
        m.metallic_roughness_texture,
        m.normal.map(|n| n.texture),
        m.emission_texture,
        m.transmission_texture,
        m.specular_texture,
        m.specular_color_texture,
        m.clearcoat_texture,
        m.clearcoat_roughness_texture,
        m.clearcoat_normal.map(|n| n.texture),
        m.sheen_color_texture,
        m.sheen_roughness_texture,
    ]
}
