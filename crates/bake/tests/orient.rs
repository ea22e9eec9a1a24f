//! Two-sided surfaces whose front is not what one sees.

mod support;

use glam::Vec3;
use occlude_bake::gather::{Part, PathSettings};
use occlude_bake::orient::turn_over;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{Camera, Material, Pose, Projection};
use support::{Build, matt};

fn two_sided() -> Material {
    Material {
        double_sided: true,
        ..matt(0.6)
    }
}

/// A room with a lamp, all two-sided; `turned`: fronts look outwards.
fn room(turned: bool) -> Build {
    let mut build = Build::default();
    let texels = [[4, 4]; 6];
    build.room(Vec3::ZERO, Vec3::new(4.0, 3.0, 4.0), texels, &two_sided());
    if turned {
        for mesh in &mut build.scene.meshes {
            mesh.triangles = vec![[0, 2, 1], [0, 3, 2]];
        }
    }
    let lamp = Material {
        emission: Vec3::splat(4.0),
        ..matt(0.0)
    };
    let at = Vec3::new(2.0, 2.9, 2.0);
    build.rectangle(at, Vec3::X * 0.3, Vec3::Z * 0.3, None, lamp);
    build
}

/// Which instances are baked on their back.
fn turned(build: &Build) -> Vec<bool> {
    let mut atlas = build.atlas();
    let pose = Pose::at(&build.scene, 0.0);
    let geometry = Geometry::new(&build.scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(&build.scene, &pose, None, LightSelection::Tree);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let settings = PathSettings {
        part: Part::All,
        bounces: 2,
        luminous: true,
        reach: f32::INFINITY,
        seed: 1,
        directional: false,
    };
    let count = turn_over(&mut atlas, &world, &settings, &Job::new());
    let turned: Vec<bool> = (0..build.scene.instances.len() as u32)
        .map(|instance| atlas.is_turned(instance, 0))
        .collect();
    assert_eq!(turned.iter().filter(|&&t| t).count() as u64, count);
    turned
}

#[test]
fn walls_are_baked_on_the_side_of_the_room() {
    assert_eq!(turned(&room(false))[..6], [false; 6]);
    assert_eq!(turned(&room(true))[..6], [true; 6]);
    // One-sided surfaces are seen from their front alone.
    let mut one_sided = room(true);
    one_sided
        .scene
        .materials
        .iter_mut()
        .for_each(|m| m.double_sided = false);
    assert_eq!(turned(&one_sided)[..6], [false; 6]);
}

#[test]
fn sheets_in_the_open_stay_and_those_against_something_are_turned() {
    let mut build = room(false);
    // In the middle, darker below than above: both sides look into the room.
    let (x, z) = (Vec3::X * 0.5, Vec3::Z * 0.5);
    build.rectangle(Vec3::new(2.0, 1.0, 2.0), x, z, Some([4, 4]), two_sided());
    // A carpet a centimetre above the floor, whose front looks down.
    build.rectangle(Vec3::new(3.0, 0.01, 3.0), x, z, Some([4, 4]), two_sided());
    let found = turned(&build);
    assert_eq!(found[..8], [false; 8]);
    assert!(found[8]);
}

#[test]
fn what_cameras_see_decides() {
    let mut build = room(false);
    // A screen whose front looks at the lamp, and a camera behind it.
    build.rectangle(
        Vec3::new(2.0, 1.5, 2.5),
        Vec3::Y * 1.0,
        Vec3::X * 1.0,
        Some([4, 4]),
        two_sided(),
    );
    let screen = build.scene.instances.len() - 1;
    assert!(!turned(&build)[screen]);
    build.scene.nodes.push(occlude_scene::Node {
        name: "camera".into(),
        parent: None,
        parent_from_node: glam::Affine3A::from_translation(Vec3::new(2.0, 1.5, 3.9)),
    });
    build.scene.cameras.push(Camera {
        name: String::new(),
        node: build.scene.nodes.len() as u32 - 1,
        projection: Projection::Perspective { yfov: 1.0 },
    });
    let found = turned(&build);
    assert!(found[screen] && found[..6] == [false; 6]);
}
