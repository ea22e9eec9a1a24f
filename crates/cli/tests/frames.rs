//! `occlude render --frames` and `--camera-path` from outside.

mod util;
#[cfg(unix)]
use util::finish;
use util::{Dir, scenes};

const PATH: &str = r#"[{"frame": 0, "eye": [0, 0.275, 1.0], "target": [0, 0.275, 0], "fov": 40},
                       {"frame": 8, "eye": [0.08, 0.3, 0.92], "target": [0, 0.275, 0], "fov": 40}]"#;

fn cornell() -> Dir {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    dir.write("p.json", PATH);
    dir
}

/// A floor, a post, a lamp, and a board that slides over the floor within a second.
fn sliding() -> Dir {
    let dir = Dir::new();
    let mut floats: Vec<f32> = Vec::new();
    let square = |at: f32, half: f32| {
        [
            [-half, at, -half],
            [-half, at, half],
            [half, at, half],
            [-half, at, -half],
            [half, at, half],
            [half, at, -half],
        ]
    };
    floats.extend(square(0.0, 2.0).concat());
    floats.extend(square(0.7, 0.3).concat());
    floats.extend([0.0, 1.0]);
    floats.extend([-1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    let bytes: Vec<u8> = floats.iter().flat_map(|x| x.to_le_bytes()).collect();
    std::fs::write(dir.path("b.bin"), &bytes).unwrap();
    let accessor = |view: u32, count: u32, kind: &str, most: &str| {
        format!(
            r#"{{"bufferView": {view}, "componentType": 5126, "count": {count}, "type": "{kind}"{most}}}"#
        )
    };
    let json = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0, 1, 2, 3]}}],
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "point", "intensity": 20}}]}}}},
        "nodes": [{{"mesh": 0}}, {{"mesh": 1}},
            {{"translation": [0, 3, 0], "extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}},
            {{"mesh": 1, "translation": [0, -0.4, 1.2]}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}, {{"primitives": [{{"attributes": {{"POSITION": 1}}}}]}}],
        "animations": [{{"channels": [{{"sampler": 0, "target": {{"node": 1, "path": "translation"}}}}],
            "samplers": [{{"input": 2, "output": 3}}]}}],
        "accessors": [{}, {}, {}, {}],
        "bufferViews": [{{"buffer": 0, "byteOffset": 0, "byteLength": 72}}, {{"buffer": 0, "byteOffset": 72, "byteLength": 72}},
            {{"buffer": 0, "byteOffset": 144, "byteLength": 8}}, {{"buffer": 0, "byteOffset": 152, "byteLength": 24}}],
        "buffers": [{{"uri": "b.bin", "byteLength": {}}}]}}"#,
        accessor(0, 6, "VEC3", r#", "min": [-2, 0, -2], "max": [2, 0, 2]"#),
        accessor(
            1,
            6,
            "VEC3",
            r#", "min": [-0.3, 0.7, -0.3], "max": [0.3, 0.7, 0.3]"#
        ),
        accessor(2, 2, "SCALAR", r#", "min": [0], "max": [1]"#),
        accessor(3, 2, "VEC3", ""),
        bytes.len()
    );
    dir.write("s.gltf", &json);
    dir
}

fn numbers(value: &serde_json::Value, key: &str) -> Vec<u64> {
    let frames = value["frames"].as_array().unwrap();
    frames
        .iter()
        .map(|frame| frame[key].as_u64().unwrap())
        .collect()
}

#[test]
fn a_frame_is_the_picture_rendered_alone() {
    let dir = cornell();
    let base = "render c.glb --size 40x30 --samples 2";
    for integrator in [
        "path --max-depth 3",
        "instant-radiosity --vpls 64",
        "bidirectional",
    ] {
        let work = format!("{base} --integrator {integrator}");
        let run = dir.must(&format!(
            "{work} --camera-path p.json --frames 0..4 -o f_####.exr -o f##.png"
        ));
        assert!(run.stdout.is_empty() && run.stderr.is_empty());
        dir.must(&format!(
            "{work} --camera-path p.json --frames 4..4 -o alone.exr"
        ));
        assert!(
            dir.read("f_0004.exr") == dir.read("alone.exr"),
            "{integrator}"
        );
        dir.must(&format!(
            "{work} --camera-look 0,0.275,1,0,0.275,0 --fov 40 -o first.exr"
        ));
        assert!(
            dir.read("f_0000.exr") == dir.read("first.exr"),
            "{integrator}"
        );
        assert!(dir.read("f_0000.exr") != dir.read("f_0004.exr"));
        assert!(dir.path("f03.png").exists() && !dir.path("f_####.exr.checkpoint").exists());
    }
}

#[test]
fn animated_frames_are_those_of_their_times() {
    let dir = sliding();
    let base =
        "render s.gltf --camera-look 0,3,4,0,0,0 --size 40x30 --samples 2 --integrator direct";
    for strategy in ["exact", "occluder"] {
        dir.must(&format!(
            "{base} --frames 4..8 --fps 8 --visibility {strategy} -o f#.exr"
        ));
        for frame in 4..=8 {
            dir.must(&format!(
                "{base} --time {} -o alone.exr",
                f64::from(frame) / 8.0
            ));
            assert!(
                dir.read(&format!("f{frame}.exr")) == dir.read("alone.exr"),
                "{strategy} {frame}"
            );
        }
    }
}

/// What moves is traced in every frame: with no error allowed, or where the cache holds nothing that blocks, the picture is exact.
#[test]
fn no_shadow_stays_behind() {
    let dir = sliding();
    let base = "render s.gltf --camera-look 0,3,4,0,0,0 --size 96x72 --samples 1 --integrator instant-radiosity --max-depth 1 --fps 8 --frames 0..8";
    dir.must(&format!("{base} -o exact#.exr"));
    dir.must(&format!(
        "{base} --visibility quantized:error=0 -o zero#.exr"
    ));
    dir.must(&format!(
        "{base} --visibility quantized --threads 1 -o one#.exr --stats s.json"
    ));
    dir.must(&format!(
        "{base} --visibility quantized --threads 2 -o two#.exr"
    ));
    let value = |a: &str, b: &str, key: &str| {
        let run = dir.must(&format!("compare {a} {b} --json"));
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        json[key].as_f64().unwrap()
    };
    for frame in 0..=8 {
        let name = |kind: &str| format!("{kind}{frame}.exr");
        assert!(
            dir.read(&name("zero")) == dir.read(&name("exact")),
            "frame {frame}"
        );
        assert!(
            dir.read(&name("one")) == dir.read(&name("two")),
            "threads show in frame {frame}"
        );
        // A shadow that stayed behind would err as much as the board's shadow moves.
        let change = value(&name("one"), &name("exact"), "energy_change");
        assert!(change < 0.01, "frame {frame}: {change}");
        if frame > 0 {
            let moved = value(
                &name("exact"),
                &format!("exact{}.exr", frame - 1),
                "energy_change",
            );
            assert!(
                moved > 3.0 * change && moved > 0.01,
                "frame {frame}: {moved} against {change}"
            );
        }
    }
    let stats = dir.json("s.json");
    assert!(
        stats["visibility"]["traced"].as_u64().unwrap() * 2
            < stats["visibility"]["queries"].as_u64().unwrap()
    );
}

#[test]
fn memory_lives_as_long_as_geometry_stands_still() {
    let dir = cornell();
    let base = "render c.glb --size 160x120 --samples 1 --integrator instant-radiosity --vpls 256 --camera-path p.json --visibility quantized";
    dir.must(&format!("{base} -o a#.exr --stats a.json --threads 1"));
    dir.must(&format!("{base} -o b#.exr --stats b.json --threads 2"));
    for frame in 0..=8 {
        assert!(
            dir.read(&format!("a{frame}.exr")) == dir.read(&format!("b{frame}.exr")),
            "threads show in frame {frame}"
        );
    }
    let stats = dir.json("a.json");
    assert_eq!(numbers(&stats, "frame"), (0..=8).collect::<Vec<_>>());
    let (queries, traced) = (numbers(&stats, "queries"), numbers(&stats, "traced"));
    assert_eq!(stats["visibility"]["queries"], queries.iter().sum::<u64>());
    assert_eq!(stats["visibility"]["traced"], traced.iter().sum::<u64>());
    assert_eq!(stats["rays"]["shadow"], traced.iter().sum::<u64>());
    assert_eq!(stats["rays"]["primary"], 9 * 160 * 120);
    let seconds = stats["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["seconds"].as_f64().unwrap())
        .sum::<f64>();
    assert!(seconds <= stats["seconds"]["total"].as_f64().unwrap());
    let renewed = numbers(&stats, "vpls_renewed");
    assert!(
        renewed[0] > 100 && renewed[1..].iter().all(|&n| n < renewed[0] / 3),
        "{renewed:?}"
    );
    assert!(renewed[1..].iter().sum::<u64>() > 0, "{renewed:?}");
    // Fresh memory for the same lights.
    dir.must(&format!("{base}:share=tile -o c#.exr --stats c.json"));
    let fresh = numbers(&dir.json("c.json"), "traced");
    assert!(traced[8] * 2 < fresh[8], "{traced:?} against {fresh:?}");
    for frame in [0, 8] {
        dir.must(&format!(
            "{} --renew-vpls 1 -o e#.exr --frames 0..{frame}",
            base.replace("quantized", "exact")
        ));
        let run = dir.must(&format!("compare a{frame}.exr e{frame}.exr --json"));
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        assert!(
            json["energy_change"].as_f64().unwrap() < 0.03,
            "frame {frame}: {json}"
        );
    }
    // The light as a whole does not drift when lights are renewed.
    let mean = |name: &str| {
        let run = dir.must(&format!("compare {name} e8.exr --json"));
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        json["mean_a"][1].as_f64().unwrap()
    };
    dir.must(
        "render c.glb --size 160x120 --samples 16 --camera-path p.json --frames 8 -o truth.exr",
    );
    let (kept, truth) = (mean("e8.exr"), mean("truth.exr"));
    assert!((kept / truth - 1.0).abs() < 0.15, "{kept} against {truth}");
}

#[test]
fn mistakes_are_found_before_any_work() {
    let dir = cornell();
    dir.refuses(
        "render c.glb --frames 0..3 -o a.exr",
        &["4 frames", "a.exr", "####"],
    );
    dir.refuses("render c.glb --frames 0..3 -o a#b#.exr", &["a#b#.exr"]);
    dir.refuses(
        "render c.glb --frames 3..0 -o a#.exr",
        &["--frames", "backwards"],
    );
    dir.refuses(
        "render c.glb --frames 0..9999999 -o a#.exr",
        &["--frames", "at most"],
    );
    dir.refuses("render c.glb --frames x -o a#.exr", &["--frames"]);
    dir.refuses("render c.glb --frames 0..1 --fps 0 -o a#.exr", &["--fps"]);
    dir.refuses("render c.glb --frames 0..1 --time 2 -o a#.exr", &["--time"]);
    dir.refuses(
        "render c.glb --camera-path none.json -o a#.exr",
        &["none.json", "no such file"],
    );
    dir.refuses(
        "render c.glb --camera-path c.glb -o a#.exr",
        &["c.glb", "JSON"],
    );
    dir.refuses(
        "render c.glb --fov 50 -o a.exr",
        &["--fov", "--camera-path"],
    );
    dir.refuses("render c.glb --camera-path p.json -o a.exr", &["9 frames"]);
    dir.refuses(
        "render c.glb --camera-path p.json --renew-vpls some -o a#.exr",
        &["--renew-vpls"],
    );
    dir.write(
        "bad.json",
        r#"[{"frame": 0, "eye": [0, 1], "target": [0, 0, 0]}]"#,
    );
    dir.refuses(
        "render c.glb --camera-path bad.json -o a#.exr",
        &["bad.json: [0].eye", "three numbers"],
    );
    dir.write(
        "same.json",
        &PATH.replace("[0.08, 0.3, 0.92]", "[0, 0.275, 0]"),
    );
    dir.refuses(
        "render c.glb --camera-path same.json -o a#.exr",
        &["same.json", "frame 8"],
    );
    dir.refuses(
        "render c.glb --frames 0..3 --visibility quantized --shard 0/2 -o a#.exr",
        &["--shard"],
    );
    assert_eq!(dir.names(), ["bad.json", "c.glb", "p.json", "same.json"]);
    dir.must("render c.glb --frames 7 --size 8x8 --samples 1");
    assert!(dir.path("c_0007.png").exists(), "{:?}", dir.names());
}

#[test]
fn machines_share_frames() {
    let dir = cornell();
    let base = "render c.glb --size 16x16 --samples 1 --camera-path p.json";
    dir.must(&format!("{base} -o whole#.exr"));
    for shard in 0..3 {
        dir.must(&format!(
            "{base} --shard {shard}/3 -o part#.exr --stats {shard}.json"
        ));
        assert_eq!(
            numbers(&dir.json(&format!("{shard}.json")), "frame").len(),
            3
        );
    }
    for frame in 0..=8 {
        assert!(dir.read(&format!("whole{frame}.exr")) == dir.read(&format!("part{frame}.exr")));
    }
}

#[cfg(unix)]
#[test]
fn an_interruption_loses_one_frame_at_most() {
    let dir = cornell();
    let base = "render c.glb --size 96x96 --camera-path p.json --frames 0..8";
    let mut samples = 8;
    loop {
        let work = format!("{base} --samples {samples} -o f#.exr");
        let child = dir.command(&work).spawn().unwrap();
        let began = std::time::Instant::now();
        while !dir.path("f2.exr").exists() && began.elapsed().as_secs() < 60 {
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
        let kill = std::process::Command::new("kill")
            .args(["-INT", &child.id().to_string()])
            .status();
        assert!(kill.is_ok());
        let run = finish(child);
        if run.code == Some(0) {
            // Too fast to be interrupted.
            (0..=8).for_each(|frame| {
                std::fs::remove_file(dir.path(&format!("f{frame}.exr"))).unwrap()
            });
            samples *= 4;
            continue;
        }
        assert_eq!(run.code, Some(130), "{}", run.stderr);
        assert!(
            run.stderr.starts_with("cancelled: ") && run.stderr.contains("--resume"),
            "{}",
            run.stderr
        );
        break;
    }
    assert!(dir.path("f#.exr.checkpoint").exists() && !dir.path("f8.exr").exists());
    let work = format!("{base} --samples {samples}");
    dir.refuses(
        &format!("{work} -o f#.exr --resume --seed 3"),
        &["f#.exr.checkpoint", "another work"],
    );
    let before = std::fs::metadata(dir.path("f1.exr"))
        .unwrap()
        .modified()
        .unwrap();
    dir.must(&format!("{work} -o f#.exr --resume --stats s.json"));
    let after = std::fs::metadata(dir.path("f1.exr"))
        .unwrap()
        .modified()
        .unwrap();
    assert_eq!(before, after, "a whole frame was rendered again");
    assert!(numbers(&dir.json("s.json"), "frame")[0] >= 2);
    assert!(!dir.path("f#.exr.checkpoint").exists());
    dir.must(&format!("{work} -o whole#.exr"));
    for frame in 0..=8 {
        assert!(
            dir.read(&format!("f{frame}.exr")) == dir.read(&format!("whole{frame}.exr")),
            "frame {frame}"
        );
    }
}

/// Skins, morph targets and a sweeping spot light.
#[test]
fn a_room_where_much_moves() {
    let Some(scenes) = scenes() else {
        return;
    };
    let dir = Dir::new();
    let room = scenes.join("animated/dynamic_room.glb");
    let base = format!(
        "render {} --size 96x72 --samples 1 --fps 4 --frames 8..12",
        room.display()
    );
    dir.must(&format!("{base} --integrator direct -o f##.exr"));
    dir.must(&format!(
        "render {} --size 96x72 --samples 1 --time 3 --integrator direct -o alone.exr",
        room.display()
    ));
    assert!(dir.read("f12.exr") == dir.read("alone.exr"));
    let work = format!("{base} --integrator instant-radiosity --vpls 128");
    dir.must(&format!("{work} -o exact##.exr"));
    dir.must(&format!("{work} --visibility quantized -o kept##.exr"));
    let alone = work.replace("8..12", "12..12");
    dir.must(&format!("{alone} --visibility quantized -o fresh##.exr"));
    let flip = |name: &str| {
        let run = dir.must(&format!("compare {name} exact12.exr --json"));
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        json["flip"].as_f64().unwrap()
    };
    let (kept, fresh) = (flip("kept12.exr"), flip("fresh12.exr"));
    println!("FLIP {kept}, fresh {fresh}");
    assert!(kept < 1.3 * fresh + 0.002, "{kept} against {fresh}");
}
