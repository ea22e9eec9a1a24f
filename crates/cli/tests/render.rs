//! `occlude render` and `merge` from outside: pictures, statistics, same bytes, interruption, full disks.

mod util;
#[cfg(unix)]
use util::signal;
use util::{Dir, finish};

/// A folder with a Cornell box in it.
fn cornell() -> Dir {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    dir
}

/// Fields of visibility say what they took, and threads leave no trace in their pictures.
#[test]
fn fields_report_and_repeat() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let command =
        "render c.glb --integrator field --size 64x48 --threshold 20%,10% --resolution 64";
    dir.must(&format!("{command} --threads 1 -o a.exr --stats s.json"));
    dir.must(&format!("{command} --threads 3 -o b.exr"));
    assert!(dir.read("a.exr") == dir.read("b.exr"));
    let stats = dir.json("s.json");
    assert_eq!(stats["visibility"]["strategy"], "field");
    assert_eq!(stats["visibility"]["class"], "biased");
    for key in ["t_update", "t_visibility", "t_transform", "t_integration"] {
        assert!(stats["field"][key].as_f64().unwrap() > 0.0, "{key}");
    }
    let points = stats["field"]["sample_points"].as_u64().unwrap();
    assert!(points > 0 && stats["field"]["rays"].as_u64().unwrap() < points * 64 * 64);
    assert!(stats["visibility"]["queries"].as_u64().unwrap() >= points * 64 * 64);
}

#[test]
fn every_format_and_layer_is_written() {
    let dir = cornell();
    let run = dir.must("render c.glb --size 48x32 --samples 4 -o a.exr -o a.png -o a.hdr --aov albedo,normal,depth,variance");
    assert!(
        run.stdout.is_empty() && run.stderr.is_empty(),
        "{} {}",
        run.stdout,
        run.stderr
    );
    assert_eq!(dir.names(), ["a.exr", "a.hdr", "a.png", "c.glb"]);
    let png = dir.read("a.png");
    assert_eq!(&png[..4], b"\x89PNG");
    assert_eq!(png[16..24], [0, 0, 0, 48, 0, 0, 0, 32]);
    let text = String::from_utf8_lossy(&png).into_owned();
    assert!(
        text.contains("Khronos PBR Neutral"),
        "the look is named in the file"
    );
    let exr = String::from_utf8_lossy(&dir.read("a.exr")[..4096.min(dir.read("a.exr").len())])
        .into_owned();
    for channel in ["albedo.R", "normal.X", "depth.Z", "variance.Y"] {
        assert!(exr.contains(channel), "{channel}");
    }
}

#[test]
fn without_an_output_the_picture_has_the_name_of_the_scene() {
    let dir = cornell();
    dir.must("render c.glb --size 8x8 --samples 1");
    assert_eq!(dir.names(), ["c.glb", "c.png"]);
}

#[test]
fn statistics_agree_with_the_system() {
    let dir = cornell();
    let run = dir.must("render c.glb --size 400x300 --samples 16 --threads 2 --seed 9 --memory 4GiB -o a.exr --stats s.json");
    let stats = dir.json("s.json");
    assert_eq!(stats["schema"], 1);
    assert_eq!(stats["command"], "render");
    assert_eq!(stats["scene"], "c.glb");
    assert_eq!(stats["seed"], 9);
    assert_eq!(stats["machine"]["threads"], 2);
    assert_eq!(stats["samples_per_pixel"], 16);
    assert_eq!(stats["stopped_by"], "samples");
    assert_eq!(stats["rays"]["primary"], 400 * 300 * 16);
    assert_eq!(stats["memory"]["limit_bytes"], 4u64 << 30);
    let visibility = &stats["visibility"];
    assert_eq!(
        (&visibility["strategy"], &visibility["class"]),
        (&"exact".into(), &"exact".into())
    );
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    assert_eq!(
        number(&visibility["queries"]),
        number(&visibility["answered"]) + number(&visibility["traced"])
    );
    let seconds = &stats["seconds"];
    let total = number(&seconds["total"]);
    assert!(
        total <= run.seconds && total > run.seconds - 0.25,
        "says {total}, took {}",
        run.seconds
    );
    let parts: f64 = ["load", "build", "work", "write"]
        .iter()
        .map(|name| number(&seconds[*name]))
        .sum();
    assert!(parts <= total && parts > 0.5 * total, "{seconds}");
    if cfg!(target_os = "linux") {
        let ratio = number(&stats["memory"]["peak_bytes"]) / run.peak_bytes as f64;
        assert!(
            (0.9..1.1).contains(&ratio),
            "peak memory is {ratio} of what the system says"
        );
    }
}

#[test]
fn threads_strategies_and_shards_leave_no_trace() {
    let dir = cornell();
    let base = "render c.glb --size 64x48 --samples 10 --aov albedo,variance";
    dir.must(&format!("{base} -o one.exr --threads 1"));
    dir.must(&format!("{base} -o two.exr --threads 2"));
    dir.must(&format!(
        "{base} -o occluder.exr --threads 2 --visibility occluder"
    ));
    dir.must(&format!("{base} -o other.exr --seed 1"));
    let one = dir.read("one.exr");
    assert!(one == dir.read("two.exr"), "threads show");
    assert!(one == dir.read("occluder.exr"), "occluder is not exact");
    assert!(one != dir.read("other.exr"), "the seed does nothing");
    for shard in 0..4 {
        dir.must(&format!(
            "{base} -o part{shard}.exr --shard {shard}/4 --threads {}",
            1 + shard % 2
        ));
    }
    dir.must("merge part3.exr part0.exr part2.exr part1.exr -o merged.exr -o merged.png");
    assert!(one == dir.read("merged.exr"), "shards show");
    dir.must(&format!("{base} -o one.exr -o one.png"));
    assert!(
        dir.read("one.png") == dir.read("merged.png"),
        "shards show in the PNG"
    );

    dir.refuses("merge part0.exr part1.exr part3.exr -o m.exr", &["no part"]);
    dir.refuses(
        "merge part0.exr part1.exr part1.exr part2.exr part3.exr -o m.exr",
        &["two parts"],
    );
    dir.must(&format!("{base} -o stranger.exr --shard 3/4 --seed 1"));
    dir.refuses(
        "merge part0.exr part1.exr part2.exr stranger.exr -o m.exr",
        &["stranger.exr", "another work"],
    );
    dir.refuses("merge one.exr -o m.exr", &["one.exr"]);
    dir.refuses("merge part0.exr -o part0.exr", &["part0.exr"]);
    assert!(!dir.path("m.exr").exists());
}

#[test]
fn time_and_noise_stop_the_work() {
    let dir = cornell();
    let run = dir.must("render c.glb --size 64x64 --time-limit 300ms -o a.exr --stats s.json");
    assert_eq!(dir.json("s.json")["stopped_by"], "time");
    assert!(run.seconds < 5.0, "{}", run.seconds);
    dir.must("render c.glb --size 64x64 --noise 0.5 -o a.exr --stats s.json");
    let stats = dir.json("s.json");
    assert_eq!(stats["stopped_by"], "noise");
    assert!(stats["samples_per_pixel"].as_u64().unwrap() < 10_000);
    assert_eq!(
        dir.names(),
        ["a.exr", "c.glb", "s.json"],
        "no checkpoint is left"
    );
}

#[test]
fn scenes_without_light_camera_or_triangles() {
    let dir = Dir::new();
    dir.write("dark.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    dir.write("empty.obj", "v 0 0 0\n");
    dir.refuses(
        "render dark.obj -o a.png",
        &["no light", "--environment", "--sun"],
    );
    dir.refuses("render empty.obj -o a.png", &["no triangles"]);
    // Framed: light falls on the triangle from the front, and the picture is not black.
    dir.must("render dark.obj --sun 90,30 --size 32x32 --samples 4 -o sun.hdr");
    dir.must("render dark.obj --integrator ao --size 32x32 --samples 4 -o ao.png");
    let hdr = dir.read("sun.hdr");
    assert!(hdr.iter().rev().take(3000).any(|&byte| byte > 100), "black");
}

#[test]
fn environment_files_light_a_scene() {
    let dir = Dir::new();
    dir.write("t.obj", "v -1 0 -1\nv 1 0 -1\nv 0 0 1\nf 1 3 2\n");
    // A flat (not run-length encoded) Radiance file, 8x4, grey 0.5.
    let mut sky = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
    sky.extend([128, 128, 128, 128].repeat(32));
    std::fs::write(dir.path("sky.hdr"), &sky).unwrap();
    dir.must("render t.obj --environment sky.hdr --size 16x16 --samples 4 -o a.exr");
    std::fs::write(dir.path("cut.hdr"), &sky[..sky.len() - 7]).unwrap();
    dir.refuses(
        "render t.obj --environment cut.hdr --size 16x16 --samples 4 -o b.exr",
        &["cut.hdr"],
    );
}

#[cfg(unix)]
#[test]
fn after_ctrl_c_resume_ends_in_the_same_bytes() {
    for integrator in ["path", "bidirectional"] {
        interrupted_and_resumed(integrator);
    }
}

#[cfg(unix)]
fn interrupted_and_resumed(integrator: &str) {
    let dir = cornell();
    let base = |samples: u32| {
        format!(
            "render c.glb --integrator {integrator} --size 64x64 --samples {samples} --aov albedo"
        )
    };
    // Long enough to be interrupted: four times as many samples until it is.
    let mut samples = 64;
    let stopped = loop {
        let child = dir
            .command(&format!("{} -o cut.exr --stats s.json", base(samples)))
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(250));
        signal("INT", child.id());
        let began = std::time::Instant::now();
        let run = finish(child);
        if run.code == Some(0) {
            samples *= 4;
            continue;
        }
        assert_eq!(run.code, Some(130), "{}", run.stderr);
        assert!(
            began.elapsed().as_secs_f64() < 1.0,
            "{:?} to stop",
            began.elapsed()
        );
        break run;
    };
    assert!(
        stopped.stderr.starts_with("cancelled: ") && stopped.stderr.contains("--resume"),
        "{}",
        stopped.stderr
    );
    assert_eq!(stopped.stderr.lines().count(), 1);
    assert_eq!(
        dir.names(),
        ["c.glb", "cut.exr", "cut.exr.checkpoint", "s.json"]
    );
    assert_eq!(dir.json("s.json")["stopped_by"], "cancel");
    let done = dir.json("s.json")["samples_per_pixel"].as_u64().unwrap();

    dir.refuses(
        &format!("{} -o cut.exr --resume --seed 5", base(samples)),
        &["cut.exr.checkpoint", "another work"],
    );
    dir.refuses(
        &format!("{} -o cut.exr --resume --max-depth 3", base(samples)),
        &["another work"],
    );
    dir.must(&format!(
        "{} -o cut.exr --resume --threads 1 --stats s.json",
        base(samples)
    ));
    assert!(!dir.path("cut.exr.checkpoint").exists());
    let primary = dir.json("s.json")["rays"]["primary"].as_u64().unwrap();
    let all = 64 * 64 * u64::from(samples);
    assert!(primary <= all - done * 64 * 64, "resume began anew");
    dir.must(&format!("{} -o whole.exr", base(samples)));
    assert!(
        dir.read("cut.exr") == dir.read("whole.exr"),
        "the interruption shows"
    );
}

#[cfg(unix)]
#[test]
fn resume_without_a_checkpoint_begins_anew_and_damage_is_refused() {
    let dir = cornell();
    dir.must("render c.glb --size 16x16 --samples 2 -o a.exr --resume");
    dir.write("bad.checkpoint", "nonsense");
    dir.refuses(
        "render c.glb --size 16x16 --samples 2 -o a.exr --checkpoint bad.checkpoint --resume",
        &["bad.checkpoint"],
    );
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_keeps_the_old_file() {
    let dir = cornell();
    dir.write("a.exr", "old");
    // Files of this shell's children may hold 8 KiB: writing more fails as on a full disk.
    let binary = env!("CARGO_BIN_EXE_occlude");
    let script = format!(
        "trap '' XFSZ; ulimit -f 16; exec {binary} render c.glb --size 128x128 --samples 1 -o a.exr"
    );
    let mut shell = std::process::Command::new("sh");
    shell.current_dir(dir.path("")).args(["-c", &script]);
    shell
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped());
    let run = finish(shell.spawn().unwrap());
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    run.has_one_error_line("full disk");
    assert!(run.stderr.contains("a.exr"), "{}", run.stderr);
    assert_eq!(dir.read("a.exr"), b"old");
    assert_eq!(
        dir.names(),
        ["a.exr", "c.glb"],
        "no half-written file is left"
    );
    // A device that is always full.
    std::os::unix::fs::symlink("/dev/full", dir.path("full.exr")).unwrap();
    let run = dir.run("render c.glb --size 16x16 --samples 1 -o full.exr");
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    run.has_one_error_line("/dev/full");
    let run = dir.run("scene cornell -o d.glb --stats /dev/full");
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    run.has_one_error_line("statistics on /dev/full");
}

/// Remembered answers: class and counters are told, repeatable where each tile remembers for itself, exact where no error is
/// allowed.
#[test]
fn quantized_visibility_tells_what_it_saved() {
    let dir = cornell();
    let base =
        "render c.glb --size 64x48 --samples 4 --seed 3 --integrator instant-radiosity --vpls 64";
    dir.must(&format!("{base} -o exact.exr"));
    dir.must(&format!(
        "{base} -o zero.exr --visibility quantized:error=0"
    ));
    assert_eq!(dir.read("zero.exr"), dir.read("exact.exr"));
    for (guarantee, class) in [
        ("bounded", "bounded"),
        ("unbiased", "unbiased"),
        ("consistent", "consistent"),
    ] {
        let options = format!("{base} --visibility quantized:share=tile --guarantee {guarantee}");
        dir.must(&format!("{options} -o one.exr --threads 1 --stats s.json"));
        dir.must(&format!("{options} -o two.exr --threads 2"));
        assert_eq!(dir.read("one.exr"), dir.read("two.exr"), "{guarantee}");
        let visibility = &dir.json("s.json")["visibility"];
        assert_eq!(visibility["strategy"], "quantized");
        assert_eq!(visibility["class"], class);
        let number = |name: &str| visibility[name].as_f64().unwrap();
        assert_eq!(number("queries"), number("answered") + number("traced"));
        assert!(number("traced") * 3.0 < number("queries"), "{visibility}");
    }
}
