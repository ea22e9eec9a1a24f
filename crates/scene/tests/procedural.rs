//! Procedural scenes, written and read back.

use glam::Vec3;
use occlude_scene::procedural::{Name, build};
use occlude_scene::{Material, Mesh, Pose, Scene, write_glb};
use std::collections::HashSet;

/// Small enough for tests.
fn small(name: Name) -> Scene {
    build(name, Some(60_000), 0).validate().unwrap()
}

fn reloaded(scene: &Scene, file: &str) -> Scene {
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(file);
    let mut bytes = Vec::new();
    write_glb(scene, &mut bytes).unwrap();
    std::fs::write(&path, bytes).unwrap();
    let scene = Scene::load(&path, None, None).unwrap();
    std::fs::remove_file(path).unwrap();
    scene
}

/// Every instance with its place, in an order that does not depend on how nodes are numbered.
fn placed(scene: &Scene) -> Vec<(String, Vec<u32>, usize)> {
    let pose = Pose::at(scene, 0.0);
    let mut all: Vec<_> = pose
        .instances
        .iter()
        .map(|i| {
            let mesh = &scene.meshes[i.mesh as usize];
            // A quaternion on the way costs a few bits.
            let place = i
                .world_from_object
                .to_cols_array()
                .map(|x| (x * 4096.0).round() as i32 as u32);
            (
                scene.materials[mesh.material as usize].name.clone(),
                place.to_vec(),
                mesh.triangles.len(),
            )
        })
        .collect();
    all.sort();
    all
}

/// The meshes that are somewhere: the loader drops what is not, and it has no place in the world.
fn used(scene: &Scene) -> Vec<&Mesh> {
    let mut indices: Vec<u32> = scene.instances.iter().map(|i| i.mesh).collect();
    indices.sort_unstable();
    indices.dedup();
    indices.iter().map(|&i| &scene.meshes[i as usize]).collect()
}

/// The materials of those meshes in order; each has its own name in these scenes.
fn materials(scene: &Scene) -> Vec<&Material> {
    let mut indices: Vec<u32> = used(scene).iter().map(|m| m.material).collect();
    indices.sort_unstable();
    indices.dedup();
    indices
        .iter()
        .map(|&i| &scene.materials[i as usize])
        .collect()
}

#[test]
fn written_and_read_back() {
    for &name in Name::ALL {
        let scene = small(name);
        let back = reloaded(&scene, &format!("{name}.glb"));
        assert!(back.warnings.is_empty(), "{name}: {:?}", back.warnings);
        assert!(
            materials(&back) == materials(&scene),
            "{name}: other materials"
        );
        for (a, b) in back.images.iter().zip(&scene.images) {
            assert_eq!(
                (a.width, a.height, &a.texels),
                (b.width, b.height, &b.texels),
                "{name}"
            );
        }
        assert_eq!(
            (back.sky, back.cameras.len()),
            (scene.sky, scene.cameras.len()),
            "{name}"
        );
        assert_eq!(back.lights.len(), scene.lights.len(), "{name}");
        for (a, b) in back.lights.iter().zip(&scene.lights) {
            assert_eq!(a.kind, b.kind, "{name}");
            assert!(
                a.intensity.distance(b.intensity) <= 1e-6 * b.intensity.length(),
                "{name}"
            );
        }
        for (a, b) in back.cameras.iter().zip(&scene.cameras) {
            assert_eq!((&a.name, a.projection), (&b.name, b.projection), "{name}");
        }
        assert_eq!(back.instances.len(), scene.instances.len(), "{name}");
        let (a, b) = (placed(&back), placed(&scene));
        for (a, b) in a.iter().zip(&b) {
            assert_eq!((&a.0, a.2), (&b.0, b.2), "{name}");
            let off =
                a.1.iter()
                    .zip(&b.1)
                    .map(|(a, b)| a.wrapping_sub(*b) as i32)
                    .map(i32::abs)
                    .max();
            assert!(off <= Some(8), "{name}: moved by {off:?} / 4096 m");
        }
        // Vertices that no triangle uses may go; what is drawn must be the same to the bit.
        let corners = |s: &Scene| {
            let mut all: Vec<[u32; 3]> = Vec::new();
            for mesh in used(s) {
                let positions = mesh.triangles.as_flattened().iter();
                all.extend(
                    positions.map(|&i| mesh.positions[i as usize].to_array().map(f32::to_bits)),
                );
            }
            all.sort_unstable();
            all
        };
        assert!(corners(&back) == corners(&scene), "{name}: other triangles");
    }
}

#[test]
fn the_same_every_time() {
    for &name in Name::ALL {
        let [a, b] = [0, 0].map(|seed| {
            let mut bytes = Vec::new();
            write_glb(&build(name, Some(30_000), seed), &mut bytes).unwrap();
            bytes
        });
        assert!(a == b, "{name}");
    }
    let [a, b] = [0, 1].map(|seed| build(Name::Courtyard, Some(30_000), seed).instances);
    assert_ne!(a, b, "the seed does something");
}

#[test]
fn as_many_triangles_as_asked_for() {
    for (name, wanted) in [
        (Name::Cornell, 20_000),
        (Name::Hairball, 60_000),
        (Name::Apartment, 200_000),
        (Name::Courtyard, 3_000_000),
        (Name::City, 2_000_000),
    ] {
        let got = build(name, Some(wanted), 0).instanced_triangles();
        let ratio = got as f64 / wanted as f64;
        assert!(
            (0.8..1.25).contains(&ratio),
            "{name}: {got} instead of {wanted}"
        );
    }
}

#[test]
fn fronts_agree_with_normals_and_nothing_coincides() {
    for &name in Name::ALL {
        let scene = small(name);
        let pose = Pose::at(&scene, 0.0);
        let (mut against, mut all, mut twins) = (0u64, 0u64, 0u64);
        let mut seen = HashSet::new();
        for instance in &pose.instances {
            let mesh = &scene.meshes[instance.mesh as usize];
            assert!(
                mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3),
                "{name}"
            );
            let world = |i: u32| {
                instance
                    .world_from_object
                    .transform_point3(mesh.positions[i as usize])
            };
            for t in &mesh.triangles {
                let p = t.map(|i| mesh.positions[i as usize]);
                let n = (p[1] - p[0]).cross(p[2] - p[0]);
                if !mesh.normals.is_empty() && n != Vec3::ZERO {
                    let mean: Vec3 = t.iter().map(|&i| mesh.normals[i as usize]).sum();
                    all += 1;
                    against += u64::from(n.dot(mean) < 0.0);
                }
                let mut key = t.map(|i| world(i).to_array().map(f32::to_bits));
                key.sort_unstable();
                twins += u64::from(n != Vec3::ZERO && !seen.insert(key));
            }
        }
        assert!(
            against * 1000 <= all,
            "{name}: {against} of {all} triangles face against their normals"
        );
        assert_eq!(twins, 0, "{name}: coinciding triangles");
    }
}

#[test]
fn the_furnace_is_closed_and_faces_inwards() {
    let scene = small(Name::Furnace);
    for mesh in &scene.meshes {
        let mut edges = HashSet::new();
        let mut volume = 0.0;
        for t in &mesh.triangles {
            let p = t.map(|i| mesh.positions[i as usize]);
            volume += p[0].dot(p[1].cross(p[2]));
            for k in 0..3 {
                let bits = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
                let (a, b) = (bits(p[k]), bits(p[(k + 1) % 3]));
                if a != b && !edges.remove(&(b, a)) {
                    assert!(edges.insert((a, b)), "an edge twice in one direction");
                }
            }
        }
        assert!(
            edges.is_empty(),
            "{}: {} open edges",
            mesh.name,
            edges.len()
        );
        assert_eq!(volume < 0.0, mesh.name == "room", "{}", mesh.name);
        let m = &scene.materials[mesh.material as usize];
        assert_eq!(
            (m.base_color.truncate(), m.emission),
            (Vec3::splat(0.5), Vec3::splat(0.5))
        );
        assert_eq!(
            (m.specular, m.metallic, m.roughness, m.double_sided),
            (0.0, 0.0, 1.0, false)
        );
        assert!(mesh.normals.is_empty(), "flat");
    }
}
