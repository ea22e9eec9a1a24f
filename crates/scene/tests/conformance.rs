//! Every file of the conformance set: what it holds when it loads, and that damaged ones are refused in one line.
//!
//! The files lie outside of this repository; without them the tests say so and pass.

use occlude_scene::{Pose, Scene};
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

#[test]
fn all_load() {
    let Some(folder) = folder() else { return };
    let mut seen = 0;
    for kind in ["conformance", "animated", "."] {
        for entry in std::fs::read_dir(folder.join(kind)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if !name.ends_with(".gltf") && !name.ends_with(".glb") {
                continue;
            }
            let start = std::time::Instant::now();
            match Scene::load(&path, None, None) {
                Ok(scene) => {
                    let pose = Pose::at(&scene, 0.7);
                    println!(
                        "{name}: {} tri {} inst {} unique, {:?} {:.3}s {:?}",
                        scene.instanced_triangles(),
                        scene.instances.len(),
                        scene.unique_triangles(),
                        scene.bounds(&pose),
                        start.elapsed().as_secs_f64(),
                        scene.warnings
                    );
                }
                Err(e) => println!("{name}: {e}"),
            }
            seen += 1;
        }
    }
    assert!(seen > 40);
    for entry in std::fs::read_dir(folder.join("conformance/malformed")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.ends_with(".gltf") || name.ends_with(".glb") {
            match Scene::load(&path, None, None) {
                Ok(scene) => println!("{name}: {:?}", scene.warnings),
                Err(e) => println!("{name}: {e}"),
            }
        }
    }
}
