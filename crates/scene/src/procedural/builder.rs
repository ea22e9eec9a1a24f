//! Puts shapes, lights and cameras into a scene.

use super::math::{Place, sin_cos};
use super::shape::Shape;
use crate::{
    Camera, Image, Instance, Light, LightKind, Material, Mesh, Node, Projection, Sampler, Scene,
    Texels, Texture, TextureRef,
};
use glam::{Affine2, Affine3A, Mat3, Vec3};

pub(super) struct Builder {
    pub scene: Scene,
}

/// Exactly Lambert.
pub(super) fn lambert(name: &str, color: [f32; 3]) -> Material {
    Material {
        name: name.into(),
        base_color: Vec3::from(color).extend(1.0),
        metallic: 0.0,
        roughness: 1.0,
        specular: 0.0,
        ..Material::default()
    }
}

/// A dielectric with a base colour: paint, plastic, varnished wood.
pub(super) fn glossy(name: &str, color: [f32; 3], roughness: f32) -> Material {
    Material {
        specular: 1.0,
        roughness,
        ..lambert(name, color)
    }
}

/// A metal.
pub(super) fn metal(name: &str, color: [f32; 3], roughness: f32) -> Material {
    Material {
        metallic: 1.0,
        ..glossy(name, color, roughness)
    }
}

/// Emits, and reflects a little.
pub(super) fn emitter(name: &str, radiance: [f32; 3]) -> Material {
    Material {
        emission: radiance.into(),
        ..lambert(name, [0.5; 3])
    }
}

impl Builder {
    pub fn new(name: &str) -> Self {
        Self {
            scene: Scene {
                name: name.into(),
                ..Scene::default()
            },
        }
    }

    pub fn material(&mut self, material: Material) -> u32 {
        self.scene.materials.push(material);
        self.scene.materials.len() as u32 - 1
    }

    pub fn mesh(&mut self, name: &str, shape: Shape, material: u32) -> u32 {
        let m = &self.scene.materials[material as usize];
        let textured = m.base_color_texture.is_some()
            || m.emission_texture.is_some()
            || m.metallic_roughness_texture.is_some();
        self.scene.meshes.push(Mesh {
            name: name.into(),
            positions: shape.positions,
            normals: shape.normals,
            uv0: if textured { shape.uv } else { Vec::new() },
            triangles: shape.triangles,
            material,
            ..Mesh::default()
        });
        self.scene.meshes.len() as u32 - 1
    }

    pub fn node(&mut self, name: &str, place: Affine3A) -> u32 {
        self.scene.nodes.push(Node {
            name: name.into(),
            parent: None,
            parent_from_node: place,
        });
        self.scene.nodes.len() as u32 - 1
    }

    /// A node that moves with another.
    pub fn node_below(&mut self, name: &str, parent: u32, place: Affine3A) -> u32 {
        let node = self.node(name, place);
        self.scene.nodes[node as usize].parent = Some(parent);
        node
    }

    /// One mesh on a node.
    pub fn place_on(&mut self, mesh: u32, node: u32) {
        self.instance(mesh, node, Affine3A::IDENTITY);
    }

    /// One mesh that the joints of a skin move.
    pub fn place_skinned(&mut self, mesh: u32, node: u32, skin: u32) {
        self.scene.instances.push(Instance {
            mesh,
            node,
            node_from_object: Affine3A::IDENTITY,
            skin: Some(skin),
        });
    }

    /// One mesh at one place in the world.
    pub fn put(&mut self, name: &str, mesh: u32, place: Place) {
        let node = self.node(name, place.affine());
        self.instance(mesh, node, Affine3A::IDENTITY);
    }

    /// A shape whose vertices are in world space already.
    pub fn add(&mut self, name: &str, shape: Shape, material: u32) {
        if !shape.triangles.is_empty() {
            let mesh = self.mesh(name, shape, material);
            self.put(name, mesh, Place::HERE);
        }
    }

    /// The meshes of a thing made of several materials.
    pub fn model(&mut self, name: &str, parts: Vec<(u32, Shape)>) -> Vec<u32> {
        parts
            .into_iter()
            .filter(|(_, shape)| !shape.triangles.is_empty())
            .map(|(material, shape)| self.mesh(name, shape, material))
            .collect()
    }

    /// A thing at a place in the world.
    pub fn place(&mut self, name: &str, meshes: &[u32], place: Place) {
        let node = self.node(name, place.affine());
        for &mesh in meshes {
            self.instance(mesh, node, Affine3A::IDENTITY);
        }
    }

    /// A repeating picture: an sRGB texture of `side` times `side` texels.
    pub fn picture(
        &mut self,
        name: &str,
        side: u32,
        texel: impl Fn(u32, u32) -> [u8; 3],
    ) -> TextureRef {
        self.texture(name, side, true, texel)
    }

    /// A repeating texture of numbers, such as roughness.
    pub fn data_picture(
        &mut self,
        name: &str,
        side: u32,
        texel: impl Fn(u32, u32) -> [u8; 3],
    ) -> TextureRef {
        self.texture(name, side, false, texel)
    }

    fn texture(
        &mut self,
        name: &str,
        side: u32,
        srgb: bool,
        texel: impl Fn(u32, u32) -> [u8; 3],
    ) -> TextureRef {
        let texels = (0..side * side)
            .map(|i| {
                let [r, g, b] = texel(i % side, i / side);
                [r, g, b, 255]
            })
            .collect();
        let image = self.scene.images.len() as u32;
        self.scene.images.push(Image {
            name: name.into(),
            width: side,
            height: side,
            texels: Texels::Rgba8(texels),
        });
        let sampler = Sampler::default();
        self.scene.textures.push(Texture {
            image,
            sampler,
            srgb,
        });
        let texture = self.scene.textures.len() as u32 - 1;
        TextureRef {
            texture,
            uv_set: 0,
            transform: Affine2::IDENTITY,
        }
    }

    /// Many instances of some meshes under one node.
    pub fn scatter(&mut self, name: &str, meshes: &[u32], places: &[Place]) {
        let node = self.node(name, Affine3A::IDENTITY);
        for &mesh in meshes {
            for place in places {
                self.instance(mesh, node, place.affine());
            }
        }
    }

    fn instance(&mut self, mesh: u32, node: u32, node_from_object: Affine3A) {
        self.scene.instances.push(Instance {
            mesh,
            node,
            node_from_object,
            skin: None,
        });
    }

    /// A camera that looks at a point; vertical field of view in degrees.
    pub fn camera(&mut self, name: &str, eye: Vec3, target: Vec3, fov: f32) {
        let node = self.node(name, facing(eye, target));
        let yfov = fov * (std::f32::consts::PI / 180.0);
        self.scene.cameras.push(Camera {
            name: name.into(),
            node,
            projection: Projection::Perspective { yfov },
        });
    }

    pub fn point_light(&mut self, name: &str, position: Vec3, intensity: Vec3) {
        let node = self.node(name, Affine3A::from_translation(position));
        self.scene.lights.push(Light {
            name: name.into(),
            node,
            intensity,
            kind: LightKind::Point,
        });
    }

    /// A sun of half a degree. Azimuth in turns from +X towards +Z, elevation in turns above the horizon.
    pub fn sun(&mut self, azimuth: f32, elevation: f32, irradiance: Vec3) {
        let ((sa, ca), (se, ce)) = (sin_cos(azimuth), sin_cos(elevation));
        let towards = Vec3::new(ca * ce, se, sa * ce);
        let node = self.node("sun", facing(Vec3::ZERO, -towards));
        self.scene.lights.push(Light {
            name: "sun".into(),
            node,
            intensity: irradiance,
            kind: LightKind::Directional {
                angular_diameter: 0.00925,
            },
        });
    }

    /// Triangles, every instance counted.
    pub fn triangles(&self) -> u64 {
        let meshes = &self.scene.meshes;
        self.scene
            .instances
            .iter()
            .map(|i| meshes[i.mesh as usize].triangles.len() as u64)
            .sum()
    }
}

/// Stands at `eye` and has -Z towards `target`.
fn facing(eye: Vec3, target: Vec3) -> Affine3A {
    let back = (eye - target).normalize_or(Vec3::Z);
    let up = if back.y.abs() > 0.999 {
        Vec3::NEG_Z
    } else {
        Vec3::Y
    };
    let right = up.cross(back).normalize_or(Vec3::X);
    Affine3A::from_mat3_translation(Mat3::from_cols(right, back.cross(right), back), eye)
}
