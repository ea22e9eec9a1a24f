//! Animation, written and read back; the procedural scenes that move.

use glam::Vec3;
use occlude_scene::procedural::{Name, build};
use occlude_scene::{Pose, Scene, moving_instances, write_glb};
use std::path::{Path, PathBuf};

fn reloaded(scene: &Scene, file: &str) -> Scene {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(file);
    let mut bytes = Vec::new();
    write_glb(scene, &mut bytes).unwrap();
    std::fs::write(&path, bytes).unwrap();
    let scene = Scene::load(&path, None, None).unwrap();
    std::fs::remove_file(path).unwrap();
    scene
}

/// World-space corners of all instances, in an order that does not depend on how nodes and instances are numbered.
fn corners(scene: &Scene, time: f32) -> Vec<(String, usize, Vec<Vec3>)> {
    let pose = Pose::at(scene, time);
    let mut all: Vec<_> = (pose.instances.iter().enumerate())
        .map(|(i, posed)| {
            let mesh = &scene.meshes[posed.mesh as usize];
            let positions = pose.positions(scene, i);
            let world = (mesh.triangles.as_flattened().iter())
                .map(|&v| {
                    posed
                        .world_from_object
                        .transform_point3(positions[v as usize])
                })
                .collect();
            let material = &scene.materials[mesh.material as usize].name;
            (material.clone(), mesh.triangles.len(), world)
        })
        .collect();
    all.sort_by(|a, b| (&a.0, a.1).cmp(&(&b.0, b.1)));
    all
}

fn same_motion(scene: &Scene, name: &str) {
    let file = format!("motion-{}.glb", name.replace(['/', '.'], "-"));
    let back = reloaded(scene, &file);
    let channels = |scene: &Scene| -> usize {
        scene
            .motion
            .clips
            .iter()
            .map(|clip| clip.channels.len())
            .sum()
    };
    assert!(channels(scene) > 0, "{name}: nothing moves");
    assert_eq!(channels(&back), channels(scene), "{name}");
    let lengths = |scene: &Scene| -> Vec<(String, f32)> {
        let clips = scene.motion.clips.iter();
        clips.map(|clip| (clip.name.clone(), clip.length)).collect()
    };
    assert_eq!(lengths(&back), lengths(scene), "{name}");
    let mut last = Vec::new();
    for time in [0.0, 0.37, 1.1, 1.9] {
        let (a, b) = (corners(scene, time), corners(&back, time));
        assert_eq!(a.len(), b.len(), "{name}");
        for (a, b) in a.iter().zip(&b) {
            assert_eq!((&a.0, a.1), (&b.0, b.1), "{name}");
            let size =
                a.2.iter()
                    .map(|p| p.abs().max_element())
                    .fold(0.0, f32::max);
            for (p, q) in a.2.iter().zip(&b.2) {
                // Node transforms lose a few bits on the way through quaternions.
                assert!(p.distance(*q) <= 2e-5 * size, "{name} {}: {p} {q}", a.0);
            }
        }
        assert!(last != a, "{name}: stands still");
        last = a;
    }
}

#[test]
fn own_motion_is_written_and_read_back() {
    for name in [Name::HatOnCloth, Name::BallsInDish, Name::WalkingHat] {
        same_motion(&build(name, Some(6_000), 0), name.as_str());
    }
}

#[test]
fn motion_of_others_is_written_and_read_back() {
    let folder = std::env::var_os("OCCLUDE_SCENES").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"),
        PathBuf::from,
    );
    for name in [
        "animated/CesiumMan.glb",
        "animated/RiggedFigure.glb",
        "animated/CesiumMilkTruck.glb",
        "animated/AnimatedMorphSphere.glb",
        "animated/MorphStressTest.gltf",
        "animated/dynamic_room.glb",
        "conformance/animation_interpolations.gltf",
        "conformance/khr_AnimatedMorphCube.glb",
        "conformance/khr_SimpleMorph.gltf",
        "conformance/khr_SimpleSkin.gltf",
        "conformance/khr_RiggedSimple.glb",
    ] {
        let path = folder.join(name);
        if !path.exists() {
            eprintln!("SKIPPED: no {}", path.display());
            continue;
        }
        same_motion(&Scene::load(&path, None, None).unwrap(), name);
    }
}

#[test]
fn scenes_have_the_sizes_of_the_paper() {
    for (name, vertices) in [
        (Name::HatOnCloth, 21_000),
        (Name::BallsInDish, 30_000),
        (Name::WalkingHat, 32_000),
    ] {
        let scene = build(name, None, 0).validate().unwrap();
        let count: usize = scene.meshes.iter().map(|mesh| mesh.positions.len()).sum();
        let ratio = count as f64 / f64::from(vertices);
        assert!((0.97..1.03).contains(&ratio), "{name}: {count}");
        let times = (0..96).map(|frame| frame as f32 / 24.0);
        let moving = moving_instances(&scene, times);
        let still = moving.iter().filter(|moving| !**moving).count();
        let expected = match name {
            Name::HatOnCloth => 0,
            Name::BallsInDish => 2,
            _ => 1,
        };
        assert_eq!(still, expected, "{name}");
        assert!(
            scene
                .materials
                .iter()
                .any(|m| m.metallic_roughness_texture.is_some())
        );
        let fine = |pose: Pose| {
            pose.deformed
                .iter()
                .all(|d| d.positions.iter().all(|p| p.is_finite()))
        };
        assert!(
            (0..48).all(|k| fine(Pose::at(&scene, k as f32 / 11.0))),
            "{name}"
        );
    }
}

/// Nothing that rolls, stands or lies goes through what is below it.
#[test]
fn things_stay_apart() {
    let scene = build(Name::BallsInDish, None, 0);
    let mut apart = f32::INFINITY;
    for frame in 0..=120 {
        let pose = Pose::at(&scene, frame as f32 / 24.0);
        let ball = |name: &str| {
            let node = scene
                .nodes
                .iter()
                .position(|node| node.name == name)
                .unwrap();
            Vec3::from(pose.world_from_node[node].translation)
        };
        let (a, b) = (ball("ball 0"), ball("ball 1"));
        apart = apart.min(a.distance(b));
        for place in [a, b] {
            // The hollow is a part of a sphere of radius 2, and balls stay inside of its rim.
            let depth = place.distance(Vec3::new(0.0, 2.06, 0.0));
            assert!((depth - 1.82).abs() < 1e-3, "{frame}: {depth}");
            assert!(place.x.hypot(place.z) < 0.85, "{frame}: {place}");
        }
    }
    assert!((0.355..0.40).contains(&apart), "they meet: {apart}");

    let scene = build(Name::WalkingHat, None, 0);
    for frame in 0..=96 {
        let pose = Pose::at(&scene, frame as f32 / 24.0);
        let skinned = pose.deformed.iter().flat_map(|d| &d.positions);
        let lowest = skinned.map(|p| p.y).fold(f32::INFINITY, f32::min);
        assert!((-0.05..0.06).contains(&lowest), "{frame}: {lowest}");
    }
}
