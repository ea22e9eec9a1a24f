//! `occlude inspect` tells what is in a file.

mod util;
use util::{Dir, scenes};

#[test]
fn a_procedural_scene_is_described() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let run = dir.must("inspect c.glb --json --stats s.json");
    let facts: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(facts["schema"], 1);
    assert!(facts["triangles"].as_u64().unwrap() > 10);
    assert_eq!(facts["triangles"], facts["unique_triangles"]);
    assert!(facts["emissive_triangles"].as_u64().unwrap() > 0);
    assert!(!facts["cameras"].as_array().unwrap().is_empty());
    let stats = dir.json("s.json");
    assert_eq!(stats["schema"], 1);
    assert_eq!(stats["command"], "inspect");
    assert_eq!(stats["scene_counts"]["triangles"], facts["triangles"]);
    let text = dir.must("inspect c.glb").stdout;
    for word in [
        "meshes",
        "instances",
        "materials",
        "textures",
        "lights",
        "cameras",
        "animations",
        "bounds",
        "memory",
        "warnings",
    ] {
        assert!(
            text.lines().any(|line| line.starts_with(word)),
            "no {word} in {text}"
        );
    }
}

#[test]
fn a_triangle_written_by_hand_is_counted() {
    let dir = Dir::new();
    dir.write("t.obj", "v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n");
    let facts: serde_json::Value =
        serde_json::from_str(&dir.must("inspect t.obj --json").stdout).unwrap();
    assert_eq!(facts["triangles"], 1);
    assert_eq!(facts["bounds"]["min"], serde_json::json!([0.0, 0.0, 0.0]));
    assert_eq!(facts["bounds"]["max"], serde_json::json!([1.0, 2.0, 0.0]));
}

#[test]
fn conformance_files_load_and_damaged_ones_do_not_pass_silently() {
    let Some(scenes) = scenes() else { return };
    let dir = Dir::new();
    let (mut good, mut bad) = (0, 0);
    let is_scene = |path: &std::path::Path| {
        path.extension().is_some_and(|e| {
            ["gltf", "glb", "obj"]
                .iter()
                .any(|x| e.eq_ignore_ascii_case(x))
        })
    };
    for (folder, damaged) in [
        (scenes.join("conformance"), false),
        (scenes.join("conformance/malformed"), true),
    ] {
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().path())
            .filter(|p| is_scene(p))
            .collect();
        files.sort();
        for file in files {
            let mut command = dir.command("inspect");
            let run = util::finish(command.arg(&file).spawn().unwrap());
            assert!(
                !run.stderr.contains("panicked"),
                "{}: {}",
                file.display(),
                run.stderr
            );
            assert!(
                run.peak_bytes < 1 << 30,
                "{}: {} bytes",
                file.display(),
                run.peak_bytes
            );
            if run.code != Some(0) {
                assert_eq!(run.code, Some(2), "{}: {}", file.display(), run.stderr);
                run.has_one_error_line(&file.display().to_string());
            }
            if damaged {
                assert!(
                    run.code == Some(2) || run.stderr.contains("warning: "),
                    "{} passed silently",
                    file.display()
                );
                bad += 1;
            } else {
                let extension = run.stderr.contains("KHR_draco_mesh_compression")
                    || run.stderr.contains("EXT_texture_webp");
                assert!(
                    run.code == Some(0) || extension,
                    "{}: {}",
                    file.display(),
                    run.stderr
                );
                good += 1;
            }
        }
    }
    assert!(good > 20 && bad > 10, "{good} {bad}");
}
