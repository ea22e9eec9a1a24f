//! Scenes with their atlas, as the baker has them.

use crate::common::Setting;
use glam::Vec3;
use occlude_bake::atlas::{Atlas, AtlasSettings, build};
use occlude_render::job::Job;
use occlude_scene::{Instance, Mesh, Node, Pose, Scene, procedural};

/// A posed scene of Lambert surfaces.
pub struct Subject {
    pub name: String,
    pub scene: Scene,
    pub pose: Pose,
}

/// Loads a scene by its name; procedural ones are built.
pub fn load(setting: &Setting, name: &str) -> Result<Subject, String> {
    let mut scene = if name == "city" {
        let triangles = (!setting.quick).then_some(3_800_000);
        let triangles = triangles.or(Some(300_000));
        split_by_distance(procedural::build(procedural::Name::City, triangles, 0))
    } else if name == "holes" {
        holes()
    } else {
        let path = setting.scenes.join(format!("{name}.glb"));
        if !path.exists() {
            return Err(format!("{} is not there", path.display()));
        }
        Scene::load(&path, None, None).map_err(|e| e.to_string())?
    };
    for material in &mut scene.materials {
        *material = material.diffuse_only();
    }
    let pose = Pose::at(&scene, 0.0);
    Ok(Subject {
        name: name.into(),
        scene,
        pose,
    })
}

/// Length, height and width of the hall of [`holes`], metres.
const HALL: Vec3 = Vec3::new(10.0, 3.0, 6.0);

/// Where its wall of holes stands.
const WALL: f32 = 5.0;

/// The paper's Fig. 7 (c): a hall that is cut in two by a wall with small holes; many lamps on one side, and on the other what comes through.
fn holes() -> Scene {
    let mut scene = Scene {
        materials: vec![occlude_scene::Material::default()],
        ..Scene::default()
    };
    let mut add = |name: &str, quads: &[[Vec3; 4]]| {
        let index = scene.meshes.len() as u32;
        let mut mesh = Mesh {
            name: name.into(),
            ..Mesh::default()
        };
        for (k, corners) in quads.iter().enumerate() {
            mesh.positions.extend(corners);
            let first = 4 * k as u32;
            mesh.triangles
                .extend([[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|v| v + first)));
        }
        scene.meshes.push(mesh);
        scene.nodes.push(Node {
            name: name.into(),
            parent: None,
            parent_from_node: glam::Affine3A::IDENTITY,
        });
        scene.instances.push(Instance {
            mesh: index,
            node: index,
            node_from_object: glam::Affine3A::IDENTITY,
            skin: None,
        });
    };
    // Fronts inwards.
    let (x, y, z) = (Vec3::X * HALL.x, Vec3::Y * HALL.y, Vec3::Z * HALL.z);
    let face = |at: Vec3, a: Vec3, b: Vec3| [at, at + a, at + a + b, at + b];
    add("floor", &[face(Vec3::ZERO, z, x)]);
    add("ceiling", &[face(y, x, z)]);
    add("ends", &[face(Vec3::ZERO, y, z), face(x, z, y)]);
    add("sides", &[face(Vec3::ZERO, x, y), face(z, y, x)]);
    // Every fifth cell of 5 cm is open; both sides of the wall are there.
    let cell = 0.05;
    let (rows, columns) = ((HALL.y / cell) as u32, (HALL.z / cell) as u32);
    let mut wall = Vec::new();
    for (row, column) in (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))) {
        if row % 5 == 2 && column % 5 == 2 {
            continue;
        }
        let at = Vec3::new(WALL, row as f32 * cell, column as f32 * cell);
        let (up, along) = (Vec3::Y * cell, Vec3::Z * cell);
        wall.push(face(at + Vec3::X * 0.01, up, along));
        wall.push(face(at - Vec3::X * 0.01, along, up));
    }
    add("wall", &wall);
    scene
}

/// The lamps of [`holes`].
pub fn hole_lamps() -> Vec<Vec3> {
    let place = |k: u32| {
        let (row, column) = ((k / 6) as f32, (k % 6) as f32);
        Vec3::new(0.7 + 1.1 * row, 2.7, 0.5 + column)
    };
    (0..24).map(place).collect()
}

/// Rings about the middle, metres, and how dense texels are there relative to the innermost.
const RINGS: [(f32, f32); 5] = [
    (40.0, 1.0),
    (200.0, 0.25),
    (600.0, 0.1),
    (1300.0, 0.05),
    (f32::INFINITY, 0.025),
];

fn ring(at: Vec3) -> usize {
    let far = at.x.hypot(at.z);
    RINGS
        .iter()
        .position(|r| far < r.0)
        .unwrap_or(RINGS.len() - 1)
}

/// The town's few large meshes in pieces by distance from the middle, so that texels can be dense where people are.
fn split_by_distance(mut scene: Scene) -> Scene {
    let pose = Pose::at(&scene, 0.0);
    let (mut meshes, mut instances, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
    for (number, posed) in pose.instances.iter().enumerate() {
        let mesh = &scene.meshes[posed.mesh as usize];
        let positions: Vec<Vec3> = (pose.positions(&scene, number).iter())
            .map(|&p| posed.world_from_object.transform_point3(p))
            .collect();
        for wanted in 0..RINGS.len() {
            let mut numbers = vec![u32::MAX; positions.len()];
            let mut piece = Mesh {
                name: format!("{} {wanted}", mesh.name),
                material: mesh.material,
                ..Mesh::default()
            };
            for triangle in &mesh.triangles {
                let corners = triangle.map(|v| positions[v as usize]);
                if ring((corners[0] + corners[1] + corners[2]) / 3.0) != wanted {
                    continue;
                }
                piece.triangles.push(triangle.map(|v| {
                    let number = &mut numbers[v as usize];
                    if *number == u32::MAX {
                        *number = piece.positions.len() as u32;
                        piece.positions.push(positions[v as usize]);
                    }
                    *number
                }));
            }
            if piece.triangles.is_empty() {
                continue;
            }
            let index = meshes.len() as u32;
            nodes.push(Node {
                name: piece.name.clone(),
                parent: None,
                parent_from_node: glam::Affine3A::IDENTITY,
            });
            instances.push(Instance {
                mesh: index,
                node: index,
                node_from_object: glam::Affine3A::IDENTITY,
                skin: None,
            });
            meshes.push(piece);
        }
    }
    scene = Scene {
        meshes,
        instances,
        nodes,
        lights: Vec::new(),
        cameras: Vec::new(),
        texel_densities: Vec::new(),
        ..scene
    };
    for material in &mut scene.materials {
        material.base_color_texture = None;
        material.emission_texture = None;
    }
    scene
}

impl Subject {
    /// The densities of instances, texels a metre, if the innermost have `inner`.
    fn densities(&self, inner: f32) -> Vec<Option<f32>> {
        let city = self.name == "city";
        (self.pose.instances.iter())
            .map(|posed| {
                let mesh = &self.scene.meshes[posed.mesh as usize];
                let share = if city {
                    let [a, b, c] = mesh.triangles[0].map(|v| mesh.positions[v as usize]);
                    RINGS[ring((a + b + c) / 3.0)].1
                } else {
                    1.0
                };
                (!mesh.triangles.is_empty()).then_some(inner * share)
            })
            .collect()
    }

    /// An atlas of about so many texels, and the texels a metre of the innermost.
    pub fn atlas(&self, texels: f64) -> Result<(Atlas, f32), String> {
        // Texels come with borders: two tries find the density.
        let mut inner = 8.0_f32;
        let mut best = None;
        for _ in 0..4 {
            let settings = AtlasSettings::default();
            let built = build(
                &self.scene,
                &self.pose,
                &self.densities(inner),
                &settings,
                &Job::new(),
            )
            .map_err(|e| e.to_string())?;
            let got = f64::from(built.atlas.texels());
            best = Some((built.atlas, inner));
            let ratio = texels / got;
            if (0.93..1.08).contains(&ratio) {
                break;
            }
            inner *= (ratio.sqrt() as f32).clamp(0.02, 50.0);
        }
        best.ok_or_else(|| "no atlas".into())
    }
}
