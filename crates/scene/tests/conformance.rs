//! Every file of the conformance set: what it holds when it loads, and that damaged ones are refused in one line.
//!
//! The files lie outside of this repository; without them the tests say so and pass.

use glam::Vec3;
use occlude_scene::{AlphaMode, LightKind, Pose, Projection, Scene, Texels, Wrap};
use std::path::PathBuf;

/// The folder of test scenes.
fn folder() -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/scenes");
    let folder =
        std::env::var_os("OCCLUDE_SCENES").map_or_else(|| PathBuf::from(default), PathBuf::from);
    if folder.join("conformance").is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no test scenes in {}", folder.display());
    None
}

fn load(file: &str) -> Scene {
    let path = folder().unwrap().join(file);
    Scene::load(&path, None, None).unwrap_or_else(|e| panic!("{file}: {e}"))
}

fn bounds(scene: &Scene, time: f32) -> [Vec3; 2] {
    scene.bounds(&Pose::at(scene, time)).unwrap()
}

/// Name, triangles of all instances, instances, warnings.
const COUNTS: [(&str, u64, usize, usize); 35] = [
    ("CesiumMan_meshopt.glb", 4672, 1, 0),
    ("CesiumMilkTruck_draco.glb", 3624, 5, 0),
    ("CesiumMilkTruck_quantized.glb", 3624, 5, 0),
    ("CesiumMilkTruck_webp.glb", 3624, 5, 0),
    ("alpha_modes.gltf", 8, 4, 0),
    ("animation_interpolations.gltf", 48, 4, 0),
    ("deep_hierarchy_1500.gltf", 12, 1, 0),
    // Two of 16 name a vertex twice.
    ("degenerate.gltf", 14, 1, 0),
    ("emissive_strength.gltf", 2112, 4, 0),
    ("indexed_no_normals_u8_indices.gltf", 12, 1, 0),
    ("khr_AnimatedMorphCube.glb", 12, 1, 0),
    ("khr_AnimatedTriangle.gltf", 1, 1, 0),
    ("khr_BoxInterleaved.glb", 12, 1, 0),
    ("khr_BoxTexturedNonPowerOfTwo.glb", 12, 1, 0),
    ("khr_Cameras.gltf", 2, 1, 0),
    ("khr_RiggedSimple.glb", 188, 1, 0),
    ("khr_SimpleMeshes.gltf", 2, 2, 0),
    ("khr_SimpleMorph.gltf", 1, 1, 0),
    ("khr_SimpleSkin.gltf", 8, 1, 0),
    ("khr_SimpleSparseAccessor.gltf", 12, 1, 0),
    ("khr_TextureCoordinateTest.gltf", 10, 5, 0),
    ("khr_TextureSettingsTest.glb", 72, 10, 0),
    ("khr_TriangleWithoutIndices.gltf", 1, 1, 0),
    ("lights_punctual_all.gltf", 14, 2, 0),
    ("negative_scale.gltf", 36, 3, 0),
    ("no_normals_no_indices_no_material.gltf", 12, 1, 0),
    // Points, lines, line loop and line strip.
    ("primitive_modes.gltf", 18, 3, 4),
    ("sparse_accessors_morph.gltf", 12, 1, 0),
    ("texture_transform.gltf", 12, 6, 0),
    ("two_scenes_default_1.gltf", 24, 2, 0),
    ("two_uv_sets_u16.gltf", 12, 1, 0),
    ("unknown_extension_optional.gltf", 12, 1, 1),
    ("uri with spaces.gltf", 12, 1, 0),
    ("vertex_colors.gltf", 36, 3, 0),
    ("malformed/nan_positions.gltf", 11, 1, 1),
];

#[test]
fn all_files_hold_what_they_should() {
    let Some(folder) = folder() else { return };
    for (name, triangles, instances, warnings) in COUNTS {
        let scene = load(&format!("conformance/{name}"));
        let found = (
            scene.instanced_triangles(),
            scene.instances.len(),
            scene.warnings.len(),
        );
        assert_eq!(
            found,
            (triangles, instances, warnings),
            "{name}: {:?}",
            scene.warnings
        );
        let [low, high] = bounds(&scene, 0.7);
        assert!(low.is_finite() && high.is_finite(), "{name}");
    }
    for entry in std::fs::read_dir(folder.join("conformance")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let ours = name.ends_with(".gltf") || name.ends_with(".glb");
        assert!(
            !ours || COUNTS.iter().any(|c| c.0 == name),
            "{name} is not in the list"
        );
    }
}

#[test]
fn malformed_files_are_refused_in_one_line() {
    let Some(folder) = folder() else { return };
    for entry in std::fs::read_dir(folder.join("conformance/malformed")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if !(name.ends_with(".gltf") || name.ends_with(".glb")) || name == "nan_positions.gltf" {
            continue;
        }
        let error = Scene::load(&path, None, None).expect_err(&name).to_string();
        assert!(
            !error.contains('\n') && error.len() < 390,
            "{name}: {error}"
        );
    }
}

#[test]
fn encodings_of_one_model_agree() {
    if folder().is_none() {
        return;
    }
    let close = |a: &str, b: &str, time: f32, tolerance: f32| {
        let (a, b) = (load(a), load(b));
        let (ends_a, ends_b) = (bounds(&a, time), bounds(&b, time));
        for (a, b) in ends_a.iter().zip(ends_b) {
            assert!(a.distance(b) < tolerance, "{a} is not {b}");
        }
        // Not the box alone: the mean corner too.
        let mean = |scene: &Scene| {
            let pose = Pose::at(scene, time);
            let corner = |i: usize, v: u32| {
                pose.instances[i]
                    .world_from_object
                    .transform_point3(pose.positions(scene, i)[v as usize])
            };
            let mut sum = Vec3::ZERO;
            for (i, instance) in scene.instances.iter().enumerate() {
                let triangles = &scene.meshes[instance.mesh as usize].triangles;
                sum += triangles
                    .as_flattened()
                    .iter()
                    .map(|&v| corner(i, v))
                    .sum::<Vec3>();
            }
            sum / (3 * scene.instanced_triangles()) as f32
        };
        assert!(mean(&a).distance(mean(&b)) < tolerance);
    };
    for time in [0.0, 0.7] {
        close(
            "conformance/CesiumMan_meshopt.glb",
            "animated/CesiumMan.glb",
            time,
            2e-3,
        );
        for kind in ["draco", "quantized", "webp"] {
            let other = format!("conformance/CesiumMilkTruck_{kind}.glb");
            close(&other, "animated/CesiumMilkTruck.glb", time, 2e-3);
        }
    }
}

#[test]
fn lights_cameras_and_materials_are_as_described() {
    if folder().is_none() {
        return;
    }
    let scene = load("conformance/lights_punctual_all.gltf");
    let kinds =
        |wanted: fn(&LightKind) -> bool| scene.lights.iter().filter(|l| wanted(&l.kind)).count();
    assert!(kinds(|k| matches!(k, LightKind::Directional { .. })) >= 1);
    assert!(kinds(|k| matches!(k, LightKind::Point)) >= 1);
    assert!(kinds(|k| matches!(k, LightKind::Spot { .. })) >= 1);
    for light in Pose::at(&scene, 0.0).lights {
        assert!((light.direction.length() - 1.0).abs() < 1e-6);
    }

    let scene = load("conformance/khr_Cameras.gltf");
    assert!(matches!(
        scene.cameras[0].projection,
        Projection::Perspective { .. }
    ));
    assert!(matches!(
        scene.cameras[1].projection,
        Projection::Orthographic { .. }
    ));

    let scene = load("conformance/emissive_strength.gltf");
    let mut strengths: Vec<f32> = scene
        .materials
        .iter()
        .map(|m| m.emission.max_element())
        .collect();
    strengths.sort_by(f32::total_cmp);
    assert_eq!(strengths[0], 0.0);
    assert!(
        (strengths[3] / strengths[1] - 1000.0).abs() < 1.0,
        "{strengths:?}"
    );

    let scene = load("conformance/alpha_modes.gltf");
    let modes: Vec<AlphaMode> = scene.materials.iter().map(|m| m.alpha_mode).collect();
    assert_eq!(
        modes
            .iter()
            .filter(|m| matches!(m, AlphaMode::Mask { .. }))
            .count(),
        2
    );
    assert!(modes.contains(&AlphaMode::Blend) && modes.contains(&AlphaMode::Opaque));

    let scene = load("conformance/vertex_colors.gltf");
    for mesh in &scene.meshes {
        assert_eq!(mesh.colors.len(), mesh.positions.len());
        assert!(
            mesh.colors
                .iter()
                .all(|c| c.max_element() <= 1.0 && c.min_element() >= 0.0)
        );
    }

    let scene = load("conformance/khr_TextureSettingsTest.glb");
    let wraps: Vec<Wrap> = scene.textures.iter().map(|t| t.sampler.wrap_u).collect();
    assert!(
        [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp]
            .iter()
            .all(|w| wraps.contains(w))
    );

    // Real pictures, not the magenta of failure.
    for name in [
        "uri with spaces.gltf",
        "CesiumMilkTruck_webp.glb",
        "khr_BoxTexturedNonPowerOfTwo.glb",
    ] {
        let scene = load(&format!("conformance/{name}"));
        assert!(scene.images[0].width > 1, "{name}");
        assert!(!matches!(&scene.images[0].texels, Texels::Rgba8(t) if t[0] == [255, 0, 255, 255]));
    }
}

#[test]
fn real_scenes_load_whole() {
    if folder().is_none() {
        return;
    }
    for (name, triangles, lights, cameras) in [
        ("sponza.glb", 262_267, 1, 2),
        ("apartment.glb", 177_950, 3, 3),
        ("pine_forest.glb", 989_072, 1, 2),
        ("sintel_hair.glb", 1_033_558, 1, 2),
        ("svbrdf_still_life.glb", 99_240, 0, 1),
        ("animated/dynamic_room.glb", 10_216, 1, 1),
    ] {
        let scene = load(name);
        let found = (
            scene.instanced_triangles(),
            scene.lights.len(),
            scene.cameras.len(),
        );
        assert_eq!(found, (triangles, lights, cameras), "{name}");
        assert_eq!(scene.warnings, [], "{name}");
    }
    let file = folder().unwrap().join("apartment.glb");
    let many = Scene::load(&file, Some("many_lights"), None).unwrap();
    assert_eq!(many.lights.len(), 99);
}

/// A copy of a GLB whose JSON has one word replaced by another of the same length.
fn without_tangents(file: &str) -> Scene {
    let mut bytes = std::fs::read(folder().unwrap().join(file)).unwrap();
    let text = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    for at in 20..20 + text {
        if bytes[at..].starts_with(b"\"TANGENT\"") {
            bytes[at..at + 9].copy_from_slice(b"\"_ANGENT\"");
        }
    }
    let path = std::env::temp_dir().join(format!("occlude-tangents-{}.glb", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    let scene = Scene::load(&path, None, None).unwrap();
    std::fs::remove_file(path).unwrap();
    scene
}

/// The tangents that the makers of models computed are our oracle.
#[test]
fn computed_tangents_agree_with_those_of_files() {
    if folder().is_none() {
        return;
    }
    for (name, share) in [("svbrdf_still_life.glb", 0.97)] {
        let (theirs, ours) = (load(name), without_tangents(name));
        let (mut corners, mut agreeing) = (0, 0);
        for (a, b) in theirs
            .meshes
            .iter()
            .zip(&ours.meshes)
            .filter(|(a, _)| !a.tangents.is_empty())
        {
            assert_eq!(b.tangents.len(), b.positions.len());
            for (i, j) in a
                .triangles
                .as_flattened()
                .iter()
                .zip(b.triangles.as_flattened())
            {
                let (a, b) = (a.tangents[*i as usize], b.tangents[*j as usize]);
                corners += 1;
                // Within 10 degrees and of the same hand.
                agreeing += usize::from(a.w == b.w && a.truncate().dot(b.truncate()) > 0.985);
            }
        }
        let found = agreeing as f64 / corners as f64;
        assert!(
            corners > 1000 && found > share,
            "{name}: {found} of {corners} corners agree"
        );
    }
}
