//! `occlude bake`, `plan` and the parts of a bake in `merge`, from outside: closed forms, same bytes, interruption, refusals.

mod util;
use occlude_image::{Limits, read};
use occlude_testkit::estimate::Estimate;
use occlude_testkit::random::Random;
use std::f64::consts::PI;
use std::path::Path;
use std::time::Duration;
use util::{Dir, finish};

/// Names and bytes of the light maps and their description in an output folder.
fn maps(dir: &Dir, folder: &str) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = std::fs::read_dir(dir.path(folder))
        .unwrap_or_else(|error| panic!("{folder}: {error}"))
        .map(|entry| entry.unwrap().path())
        .map(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            (name, std::fs::read(&path).unwrap())
        })
        .collect();
    files.sort();
    files
}

/// The lit values of a page, in no order.
fn lit(path: &Path) -> Vec<f64> {
    let page = read(path, &Limits::default()).unwrap().picture;
    let values = page
        .pixels
        .iter()
        .map(|p| f64::from(p[0] + p[1] + p[2]) / 3.0);
    values.filter(|&v| v > 0.0).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn a_closed_room_has_the_irradiance_of_the_closed_form() {
    let dir = Dir::new();
    dir.must("scene furnace -o f.glb");
    // Albedo and emission are one half: pi e (1 - a^(B+1)) / (1 - a).
    for (gather, bounces) in [("path", 0), ("path", 2), ("bundles", 0), ("bundles", 2)] {
        dir.must(&format!(
            "bake f.glb -o out --gather {gather} --bounces {bounces} --directions 64 --texels-per-metre 40 --stats s.json"
        ));
        let values = lit(&dir.path("out/lightmap_000.exr"));
        let expected = PI * 0.5 * (1.0 - 0.5f64.powi(bounces + 1)) / 0.5;
        // Where the boxes stand it is dark: the median does not see that.
        let got = median(values);
        assert!(
            (got / expected - 1.0).abs() < 5e-3,
            "{gather}, {bounces} bounces: {got} instead of {expected}"
        );
        let stats = dir.json("s.json");
        assert_eq!(stats["command"], "bake");
        assert_eq!(stats["bundles"]["overflow_left"], 0);
        assert_eq!(
            stats["bundles"]["fragments"].as_u64() > Some(0),
            gather == "bundles" && bounces > 0
        );
    }
}

#[test]
fn a_plane_under_a_sun_reads_what_the_engine_wants() {
    let dir = Dir::new();
    let plane = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, 0, -1], "max": [1, 0, 1]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "buffers": [{"byteLength": 60, "uri": "plane.bin"}]}"#;
    dir.write("plane.gltf", plane);
    let mut bytes = Vec::new();
    for corner in [
        [-1.0_f32, 0.0, -1.0],
        [1.0, 0.0, -1.0],
        [1.0, 0.0, 1.0],
        [-1.0, 0.0, 1.0],
    ] {
        corner.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    for index in [0_u16, 2, 1, 0, 3, 2] {
        bytes.extend(index.to_le_bytes());
    }
    std::fs::write(dir.path("plane.bin"), bytes).unwrap();
    for (engine, expected) in [
        ("three", 1.0),
        ("bevy", 1.0 / PI),
        ("godot", 1.0 / PI),
        ("blender", 1.0 / PI),
    ] {
        dir.must(&format!(
            "bake plane.gltf -o out --sun 0,90,1 --directions 16 --engine {engine}"
        ));
        let got = mean(&lit(&dir.path("out/lightmap_000.exr")));
        assert!((got / expected - 1.0).abs() < 2e-3, "{engine}: {got}");
        let manifest = dir.json("out/manifest.json");
        let quantity = if engine == "three" {
            "irradiance"
        } else {
            "irradiance/pi"
        };
        assert_eq!(manifest["quantity"], quantity);
        assert_eq!(manifest["engine"], engine);
    }
}

/// The median of a channel over texels with light.
fn channel(path: &Path, name: &str) -> f64 {
    let layers = occlude_image::read_layers(path, &Limits::default()).unwrap();
    let all = |name: &str| layers.channel(name).unwrap().values.clone();
    let (values, light) = (all(name), all("raw.G"));
    let lit = values.iter().zip(light).filter(|(_, light)| *light > 0.0);
    median(lit.map(|(value, _)| f64::from(*value)).collect())
}

#[test]
fn directions_are_those_of_the_light() {
    let dir = Dir::new();
    // The same radiance everywhere but below the boxes: irradiance does not depend on the normal.
    dir.must("scene furnace -o f.glb");
    for gather in ["path", "bundles"] {
        // Texels share directions: only other seeds are independent.
        let runs: Vec<[f64; 2]> = (0..6)
            .map(|seed| {
                dir.must(&format!(
                    "bake f.glb -o out --gather {gather} --bounces 1 --directions 128 --texels-per-metre 6 --directional sh1 --seed {seed}"
                ));
                let page = dir.path("out/lightmap_000.exr");
                ["sh1.W", "sh1.X"].map(|name| channel(&page, name))
            })
            .collect();
        for (k, expected) in [1.0, 0.0].into_iter().enumerate() {
            let got = Estimate::of(runs.iter().map(|run| run[k]));
            let p = got.same(&Estimate::exact(expected));
            // Student's t, one false alarm in a thousand runs of this test; a difference of 0.08 would be found.
            assert!(
                p > 1e-3 / 4.0 && got.variance.sqrt() < 8e-3,
                "{gather} {k}: {got:?}, expected {expected}"
            );
        }
        assert_eq!(dir.json("out/manifest.json")["directional"], "sh1");
    }
}

#[test]
fn threads_shards_and_rounds_leave_no_trace() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    for gather in ["path", "bundles"] {
        let base = format!(
            "bake c.glb --gather {gather} --directions 24 --bounces 2 --texels-per-metre 6 --seed 3 --directional dominant"
        );
        dir.must(&format!("{base} -o one --threads 1"));
        let whole = maps(&dir, "one");
        dir.must(&format!("{base} -o two --threads 2"));
        assert_eq!(whole, maps(&dir, "two"), "{gather}: threads");
        let mut after = String::new();
        let mut rounds = 0;
        loop {
            for part in 0..3 {
                dir.must(&format!("{base} -o part{part} --shard {part}/3{after}"));
            }
            let told = dir.must("merge part2 part0 part1 -o merged").stdout;
            let told: serde_json::Value = serde_json::from_str(&told).unwrap();
            rounds += 1;
            assert_eq!(told["rounds_done"], rounds);
            if told["finished"] == true {
                break;
            }
            std::fs::rename(dir.path("merged"), dir.path("before")).unwrap();
            after = " --after before".to_owned();
        }
        assert_eq!(rounds, if gather == "path" { 1 } else { 4 });
        assert_eq!(whole, maps(&dir, "merged"), "{gather}: shards");
        std::fs::remove_dir_all(dir.path("merged")).unwrap();
        dir.refuses("merge part0 part1 -o m", &["missing"]);
        dir.refuses("merge part0 part1 part1 part2 -o m", &["twice"]);
    }
}

#[test]
fn killed_or_cancelled_and_resumed_it_ends_in_the_same_bytes() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let mut random = Random(7);
    for (gather, directions, cuts) in [("path", 192, 4), ("bundles", 2000, 11)] {
        let base = format!(
            "bake c.glb --gather {gather} --directions {directions} --bounces 2 --texels-per-metre 16 --directional sh1"
        );
        let seconds = dir.must(&format!("{base} -o whole")).seconds;
        let mut resumed = 0;
        for k in 0..cuts {
            // A checkpoint that is left is gone on from; the last cut is a polite one.
            resumed += u32::from(dir.path("cut.checkpoint").exists());
            let mut child = dir
                .command(&format!("{base} -o cut --resume"))
                .spawn()
                .unwrap();
            let moment = seconds * f64::from(0.1 + 0.5 * random.unit());
            std::thread::sleep(Duration::from_secs_f64(moment));
            if cfg!(unix) && k + 1 == cuts {
                let killed = std::process::Command::new("kill")
                    .args(["-INT", &child.id().to_string()])
                    .status();
                assert!(killed.unwrap().success());
                let run = finish(child);
                // It may have been done already.
                assert!(matches!(run.code, Some(130 | 0)), "{run:?}");
            } else {
                let _ = child.kill();
                let _ = child.wait();
            }
        }
        println!("{gather}: {seconds:.1} s, {resumed} of {cuts} went on from a checkpoint");
        assert!(gather == "path" || resumed > 0, "too fast for a checkpoint");
        dir.must(&format!("{base} -o cut --resume"));
        assert_eq!(maps(&dir, "whole"), maps(&dir, "cut"), "{gather}");
        assert!(!dir.path("cut.checkpoint").exists());
        std::fs::remove_dir_all(dir.path("cut")).unwrap();
    }
}

#[test]
fn what_has_not_changed_is_not_baked_again() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let base = "bake c.glb -o out --gather path --directions 8 --texels-per-metre 4";
    dir.must(base);
    let first = maps(&dir, "out");
    let written = |dir: &Dir| {
        let data = std::fs::metadata(dir.path("out/lightmap_000.exr")).unwrap();
        data.modified().unwrap()
    };
    let before = written(&dir);
    dir.must(&format!("{base} --stats s.json"));
    assert_eq!(before, written(&dir));
    let stats = dir.json("s.json");
    assert_eq!(stats["stopped_by"], "unchanged");
    assert!(stats["texels"].as_u64().unwrap() > 0 && stats["pages"] == 1);
    dir.must(&format!("{base} --engine godot"));
    assert!(before != written(&dir) && first != maps(&dir, "out"));
}

#[test]
fn checkpoints_of_other_works_and_damaged_ones_are_refused() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    dir.must("bake c.glb -o part --shard 0/2 --directions 8 --texels-per-metre 4 --gather path");
    let part = dir.read("part");
    std::fs::write(dir.path("out.checkpoint"), &part).unwrap();
    dir.refuses(
        "bake c.glb -o out --resume --directions 8 --texels-per-metre 5 --gather path",
        &["of another work"],
    );
    dir.refuses(
        "bake c.glb -o out --resume --directions 8 --texels-per-metre 4 --gather path",
        &["another shard"],
    );
    for cut in [0, 7, 9, 40, part.len() / 2, part.len() - 1] {
        std::fs::write(dir.path("out.checkpoint"), &part[..cut]).unwrap();
        dir.refuses(
            "bake c.glb -o out --resume --directions 8 --texels-per-metre 4 --gather path",
            &["out.checkpoint"],
        );
    }
    for at in (8..part.len()).step_by(part.len() / 23) {
        let mut bent = part.clone();
        bent[at] ^= 0x55;
        std::fs::write(dir.path("bent"), bent).unwrap();
        let run = dir.run("merge bent part -o m");
        assert!(matches!(run.code, Some(0..=2)), "{at}: {run:?}");
        assert!(!run.stderr.contains("panicked"), "{}", run.stderr);
    }
}

#[test]
fn plan_says_what_bake_does() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let options = "--texels-per-metre 12 --directions 32 --bounces 1 --gather path";
    let plan = dir.must(&format!("plan c.glb {options} --json")).stdout;
    let plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
    dir.must(&format!("bake c.glb -o out {options} --stats s.json"));
    let stats = dir.json("s.json");
    assert_eq!(plan["texels"], stats["texels"]);
    assert_eq!(plan["pages"], stats["pages"]);
    assert_eq!(plan["directions"], 32);
    let floor = plan["floor_bytes"].as_u64().unwrap();
    let half = floor / 2;
    dir.refuses(
        &format!("bake c.glb -o no {options} --memory {half}"),
        &["--memory"],
    );
    assert!(!dir.path("no").exists());
    let limit = floor + floor / 5;
    let run = dir.must(&format!("bake c.glb -o yes {options} --memory {limit}"));
    assert!(run.peak_bytes <= limit, "{} > {limit}", run.peak_bytes);
    assert!(
        plan["objects"]
            .as_array()
            .is_some_and(|objects| !objects.is_empty())
    );
    assert!(
        dir.must(&format!("plan c.glb {options}"))
            .stdout
            .contains("texels")
    );
}

#[cfg(unix)]
#[test]
fn light_maps_on_disk_have_the_same_bytes_in_less_memory() {
    let dir = Dir::new();
    dir.must("scene conference -o c.glb");
    std::fs::create_dir(dir.path("scratch")).unwrap();
    let base = "bake c.glb --directions 4 --bounces 2 --texels-per-metre 2 --pages-max 64 --seed 5";
    for gather in ["path", "bundles"] {
        let base = format!("{base} --gather {gather} --directional sh1");
        dir.must(&format!("{base} -o memory"));
        dir.must(&format!("{base} -o disk --scratch scratch"));
        assert_eq!(maps(&dir, "memory"), maps(&dir, "disk"), "{gather}");
        // Parts, of which some are on disk.
        let mut after = String::new();
        loop {
            dir.must(&format!("{base} -o part0 --shard 0/2{after}"));
            dir.must(&format!(
                "{base} -o part1 --shard 1/2{after} --scratch scratch"
            ));
            let told = dir.must("merge part1 part0 -o merged").stdout;
            if told.contains("\"finished\":true") {
                break;
            }
            std::fs::rename(dir.path("merged"), dir.path("before")).unwrap();
            after = " --after before".to_owned();
        }
        assert_eq!(
            maps(&dir, "memory"),
            maps(&dir, "merged"),
            "{gather}: parts"
        );
        for folder in ["memory", "disk", "merged"] {
            std::fs::remove_dir_all(dir.path(folder)).unwrap();
        }
    }
    // Many more texels: what fits on disk does not fit in memory.
    let many =
        "c.glb --gather path --light direct --directions 1 --texels-per-metre 28 --pages-max 400";
    let floor = |options: &str| {
        let plan = dir.must(&format!("plan {many} --json{options}")).stdout;
        let plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
        plan["floor_bytes"].as_u64().unwrap()
    };
    let (in_memory, on_disk) = (floor(""), floor(" --scratch scratch"));
    assert!(on_disk < in_memory, "{on_disk} {in_memory}");
    let limit = on_disk + (in_memory - on_disk) / 8;
    let bake = format!("bake {many} -o out --memory {limit}");
    dir.refuses(&bake, &["--memory", "--scratch"]);
    let run = dir.must(&format!("{bake} --scratch scratch"));
    assert!(run.peak_bytes <= limit, "{} > {limit}", run.peak_bytes);
    dir.refuses(&format!("{bake} --scratch nowhere"), &["nowhere"]);
    assert_eq!(std::fs::read_dir(dir.path("scratch")).unwrap().count(), 0);
}

#[test]
fn what_cannot_be_baked_is_said_before_any_work() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    dir.write("file", "");
    dir.refuses("bake c.glb -o file", &["a file is in the way"]);
    dir.refuses("bake c.glb -o no/such/place", &["does not exist"]);
    dir.refuses("bake c.glb -o out --select nobody", &["no node", "nobody"]);
    dir.refuses("bake c.glb -o out --shard 0/2 --noise 0.1", &["--shard"]);
    dir.refuses(
        "bake c.glb -o out --pages-max 16 --texels-per-metre 2000",
        &["--texels-per-metre"],
    );
    dir.refuses("bake nothing.glb -o out", &["nothing.glb"]);
    assert_eq!(dir.names(), ["c.glb", "file"]);
}

#[test]
fn meshes_that_get_no_map_are_named_and_the_others_get_theirs() {
    let dir = Dir::new();
    // A square, and a mesh whose triangles have no area.
    let scene = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "name": "floor"}, {"mesh": 1, "name": "wire"}],
        "meshes": [{"name": "floor", "primitives": [{"attributes": {"POSITION": 0}, "indices": 2}]},
            {"name": "wire", "primitives": [{"attributes": {"POSITION": 1}, "indices": 2}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, 0, -1], "max": [1, 0, 1]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 1, 0], "max": [3, 1, 0]},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 48},
            {"buffer": 0, "byteOffset": 96, "byteLength": 12}],
        "buffers": [{"byteLength": 108, "uri": "two.bin"}]}"#;
    dir.write("two.gltf", scene);
    let floor = [-1, 0, -1, 1, 0, -1, 1, 0, 1, -1, 0, 1];
    let wire = [0, 1, 0, 1, 1, 0, 2, 1, 0, 3, 1, 0];
    let numbers = floor.into_iter().chain(wire).map(|x| x as f32);
    let mut bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
    bytes.extend([0_u16, 2, 1, 0, 3, 2].iter().flat_map(|i| i.to_le_bytes()));
    std::fs::write(dir.path("two.bin"), bytes).unwrap();
    let run = dir.run("bake two.gltf -o out --sun 0,90,1 --directions 16");
    assert_eq!(run.code, Some(1), "{run:?}");
    run.has_one_error_line("bake");
    assert!(
        run.stderr.contains("no light map") && run.stderr.contains("wire"),
        "{}",
        run.stderr
    );
    let got = mean(&lit(&dir.path("out/lightmap_000.exr")));
    assert!((got - 1.0).abs() < 2e-3, "the floor has its light: {got}");
    let manifest = dir.json("out/manifest.json");
    assert_eq!(manifest["nodes"].as_array().map(Vec::len), Some(1));
}

#[test]
fn direct_and_indirect_add_up_and_time_and_noise_stop() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let base = "bake c.glb --gather path --directions 256 --texels-per-metre 4 --bounces 2";
    let mut means = Vec::new();
    for light in ["all", "direct", "indirect"] {
        dir.must(&format!("{base} -o {light} --light {light}"));
        let page = read(
            &dir.path(&format!("{light}/lightmap_000.exr")),
            &Limits::default(),
        );
        means.push(page.unwrap().picture.mean()[1]);
    }
    let sum = means[1] + means[2];
    assert!((sum / means[0] - 1.0).abs() < 0.02, "{means:?}");
    dir.must(&format!("{base} -o ao --light ao"));
    let open = lit(&dir.path("ao/lightmap_000.exr"));
    assert!(open.iter().all(|&e| e <= PI * 1.01) && mean(&open) > 0.2);
    for gather in ["path", "bundles"] {
        dir.must(&format!(
            "bake c.glb -o n --gather {gather} --noise 0.1 --texels-per-metre 4 --stats s.json"
        ));
        let stats = dir.json("s.json");
        assert_eq!(stats["stopped_by"], "noise");
        assert!(stats["noise"].as_f64().unwrap() <= 0.1);
        dir.must(&format!(
            "bake c.glb -o n --gather {gather} --time-limit 1s --texels-per-metre 4 --stats s.json"
        ));
        assert_eq!(dir.json("s.json")["stopped_by"], "time");
    }
}

/// `docs/examples/bake_dask.py` with a local cluster; `$OCCLUDE_PYTHON` names a Python that has `dask.distributed`.
#[test]
fn the_dask_script_gives_the_bytes_of_one_machine() {
    let python = std::env::var("OCCLUDE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_dask = std::process::Command::new(&python)
        .args(["-c", "import dask.distributed"])
        .output();
    if !has_dask.is_ok_and(|output| output.status.success()) {
        eprintln!("SKIPPED: {python} has no dask.distributed: the example script is not tested");
        return;
    }
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let options = [
        "--gather",
        "bundles",
        "--directions",
        "16",
        "--bounces",
        "1",
        "--texels-per-metre",
        "6",
    ];
    dir.must(&format!("bake c.glb -o one {}", options.join(" ")));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples/bake_dask.py");
    let run = std::process::Command::new(&python)
        .current_dir(dir.path("."))
        .arg(script)
        .args([
            "c.glb",
            "many",
            "--parts",
            "4",
            "--occlude",
            env!("CARGO_BIN_EXE_occlude"),
            "--",
        ])
        .args(options)
        .output()
        .unwrap();
    let log = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success(), "{log}");
    assert_eq!(maps(&dir, "one"), maps(&dir, "many"));
}
