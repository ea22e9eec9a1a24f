//! Small scenes for tests of light transport, each for one thing that is easily wrong.

use glam::{Affine3A, Mat3, Quat, Vec3, Vec4};
use occlude_scene::{
    AlphaMode, Camera, Instance, Light, LightKind, Material, Mesh, Node, Projection, Scene, Volume,
};

/// A scene that is put together piece by piece.
pub struct Build(pub Scene);

/// A Lambert surface.
pub fn matt(color: [f32; 3]) -> Material {
    Material {
        base_color: Vec3::from(color).extend(1.0),
        metallic: 0.0,
        specular: 0.0,
        ..Material::default()
    }
}

pub fn metal(roughness: f32) -> Material {
    Material {
        base_color: Vec4::new(0.9, 0.8, 0.7, 1.0),
        roughness,
        ..Material::default()
    }
}

/// A body of glass; `None` is clear, a number is frosted.
pub fn glass(roughness: Option<f32>) -> Material {
    Material {
        metallic: 0.0,
        roughness: roughness.unwrap_or(0.0),
        transmission: 1.0,
        volume: Some(Volume {
            thickness: 1.0,
            attenuation_distance: 1.0,
            attenuation_color: Vec3::new(0.9, 0.6, 0.4),
        }),
        ..Material::default()
    }
}

pub fn lamp(radiance: f32) -> Material {
    Material {
        emission: Vec3::splat(radiance),
        ..matt([0.0; 3])
    }
}

impl Build {
    /// A camera at `eye` that looks at `target`.
    pub fn new(eye: Vec3, target: Vec3, projection: Projection) -> Self {
        let mut build = Self(Scene::default());
        let back = (eye - target).normalize();
        let right = Vec3::Y.cross(back).normalize();
        let turn = Mat3::from_cols(right, back.cross(right), back);
        let node = build.node(Affine3A::from_mat3_translation(turn, eye));
        build.0.cameras.push(Camera {
            name: String::new(),
            node,
            projection,
        });
        build
    }

    fn node(&mut self, parent_from_node: Affine3A) -> u32 {
        self.0.nodes.push(Node {
            name: String::new(),
            parent: None,
            parent_from_node,
        });
        self.0.nodes.len() as u32 - 1
    }

    pub fn mesh(&mut self, mesh: Mesh, material: Material) {
        let index = self.0.meshes.len() as u32;
        let node = self.node(Affine3A::IDENTITY);
        self.0.materials.push(material);
        self.0.meshes.push(Mesh {
            material: index,
            ..mesh
        });
        self.0.instances.push(Instance {
            mesh: index,
            node,
            node_from_object: Affine3A::IDENTITY,
            skin: None,
        });
    }

    /// A rectangle around `center` with half sides `a` and `b`; its front is on the side of `a x b`.
    pub fn rectangle(&mut self, center: Vec3, a: Vec3, b: Vec3, material: Material) {
        let mesh = Mesh {
            positions: vec![
                center - a - b,
                center + a - b,
                center + a + b,
                center - a + b,
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        self.mesh(mesh, material);
    }

    /// A floor that faces up.
    pub fn floor(&mut self, y: f32, half: f32, material: Material) {
        self.rectangle(Vec3::Y * y, Vec3::Z * half, Vec3::X * half, material);
    }

    /// A sphere of few triangles with smooth normals: shading and geometric normals are far apart.
    pub fn sphere(&mut self, center: Vec3, radius: f32, segments: u32, material: Material) {
        let mut mesh = Mesh::default();
        let (columns, rows) = (segments, segments / 2);
        for row in 0..=rows {
            for column in 0..columns {
                let theta = std::f32::consts::PI * row as f32 / rows as f32;
                let phi = std::f32::consts::TAU * column as f32 / columns as f32;
                let normal = Vec3::new(
                    theta.sin() * phi.cos(),
                    theta.cos(),
                    theta.sin() * phi.sin(),
                );
                mesh.normals.push(normal);
                mesh.positions.push(center + normal * radius);
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let next = (column + 1) % columns;
                let [a, b] = [column, next].map(|c| row * columns + c);
                let [d, c] = [column, next].map(|c| (row + 1) * columns + c);
                if row > 0 {
                    mesh.triangles.push([a, b, c]);
                }
                if row + 1 < rows {
                    mesh.triangles.push([a, c, d]);
                }
            }
        }
        self.mesh(mesh, material);
    }

    /// A light that shines from `position` to `target`.
    pub fn light(&mut self, kind: LightKind, intensity: Vec3, position: Vec3, target: Vec3) {
        let turn = Quat::from_rotation_arc(Vec3::NEG_Z, (target - position).normalize());
        let node = self.node(Affine3A::from_rotation_translation(turn, position));
        self.0.lights.push(Light {
            name: String::new(),
            node,
            intensity,
            kind,
        });
    }
}

fn table(projection: Projection) -> Build {
    let mut build = Build::new(
        Vec3::new(0.3, 2.4, 4.0),
        Vec3::new(0.0, 0.4, 0.0),
        projection,
    );
    build.floor(0.0, 2.5, matt([0.7, 0.6, 0.5]));
    build
}

const NEAR: Projection = Projection::Perspective { yfov: 0.7 };

/// Clear glass, a mirror and frosted glass under a lamp that is large enough for a path tracer.
pub fn caustics() -> Scene {
    let mut build = table(NEAR);
    build.sphere(Vec3::new(-0.7, 0.6, 0.2), 0.5, 24, glass(None));
    build.sphere(Vec3::new(0.7, 0.6, 0.4), 0.4, 12, glass(Some(0.4)));
    build.rectangle(
        Vec3::new(0.2, 0.7, -1.0),
        Vec3::X * 0.7,
        Vec3::new(0.0, 0.6, -0.2),
        metal(0.0),
    );
    build.rectangle(Vec3::new(-0.5, 3.5, 0.0), Vec3::X, Vec3::Z, lamp(4.0));
    build.0
}

/// All kinds of lights at once over rough things. `projection` is the camera's.
pub fn lights(projection: Projection) -> Scene {
    let mut build = table(projection);
    build.sphere(Vec3::new(-0.8, 0.6, 0.0), 0.5, 8, matt([0.8, 0.3, 0.2]));
    build.sphere(Vec3::new(0.7, 0.5, 0.3), 0.4, 10, metal(0.5));
    build.rectangle(
        Vec3::new(0.0, 0.9, -1.3),
        Vec3::X,
        Vec3::Y * 0.7,
        Material {
            metallic: 0.0,
            roughness: 0.5,
            clearcoat: 1.0,
            clearcoat_roughness: 0.3,
            sheen_color: Vec3::splat(0.5),
            sheen_roughness: 0.6,
            ..Material::default()
        },
    );
    build.light(
        LightKind::Point,
        Vec3::new(2.0, 1.0, 0.5),
        Vec3::new(1.5, 1.8, 1.0),
        Vec3::ZERO,
    );
    build.light(
        LightKind::Spot {
            inner_angle: 0.2,
            outer_angle: 0.5,
        },
        Vec3::splat(6.0),
        Vec3::new(-1.0, 3.0, 1.5),
        Vec3::new(-0.3, 0.0, 0.3),
    );
    for (angular_diameter, x) in [(0.0, 1.0), (0.3, -1.0)] {
        build.light(
            LightKind::Directional { angular_diameter },
            Vec3::splat(0.6),
            Vec3::new(x, 2.0, 0.5),
            Vec3::ZERO,
        );
    }
    build.rectangle(
        Vec3::new(0.5, 1.5, -0.6),
        Vec3::X * 0.3,
        Vec3::Y * 0.2,
        Material {
            double_sided: true,
            ..lamp(2.0)
        },
    );
    build.0.sky = Vec3::new(0.2, 0.3, 0.5);
    build.0
}

/// Clear tinted panes, one below the lamp and one before the camera, half-transparent cloth, a varnished board.
pub fn windows() -> Scene {
    let mut build = table(NEAR);
    let pane = |color: [f32; 3]| Material {
        roughness: 0.0,
        specular: 1.0,
        transmission: 1.0,
        ..matt(color)
    };
    build.rectangle(
        Vec3::new(-0.5, 2.0, 0.0),
        Vec3::X * 1.5,
        Vec3::Z * 1.5,
        pane([0.9, 0.7, 0.5]),
    );
    build.rectangle(
        Vec3::new(0.8, 1.0, 1.5),
        Vec3::X * 0.5,
        Vec3::Y * 0.5,
        pane([0.5, 0.8, 0.9]),
    );
    let mut cloth = matt([0.3, 0.8, 0.3]);
    cloth.base_color.w = 0.6;
    cloth.alpha_mode = AlphaMode::Blend;
    build.rectangle(
        Vec3::new(-0.8, 0.8, 0.4),
        Vec3::new(0.4, 0.1, 0.1),
        Vec3::new(0.0, 0.3, -0.5),
        cloth,
    );
    build.rectangle(
        Vec3::new(0.0, 0.8, -1.2),
        Vec3::X,
        Vec3::Y * 0.6,
        Material {
            clearcoat: 1.0,
            ..matt([0.8, 0.5, 0.3])
        },
    );
    build.rectangle(Vec3::new(-0.5, 3.5, 0.0), Vec3::X, Vec3::Z, lamp(4.0));
    build.0
}

/// Rectangles that do not touch under a lamp: no connection of two vertices gets so short that its variance is infinite.
pub fn apart() -> Scene {
    let mut build = table(NEAR);
    for x in [-1.0f32, 1.0] {
        build.rectangle(
            Vec3::new(x, 1.2, -0.5),
            Vec3::new(0.6, -0.3 * x, 0.0),
            Vec3::Z * 0.8,
            matt([0.8, 0.8, 0.5]),
        );
    }
    build.rectangle(Vec3::new(0.0, 2.8, 0.0), Vec3::X, Vec3::Z, lamp(3.0));
    build.0
}
