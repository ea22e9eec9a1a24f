//! `--visibility records` and `--secondary records` from outside.

mod util;
use util::Dir;
#[cfg(unix)]
use util::{finish, signal};

const INSTANT: &str =
    "render c.glb --size 48x32 --samples 2 --integrator instant-radiosity --vpls 64";
const PATH: &str = "render c.glb --size 48x32 --samples 6";
const FEW: &str = "count=60,resolution=32,steps=20";

fn cornell() -> Dir {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    dir
}

#[test]
fn threads_do_not_show_and_statistics_add_up() {
    let dir = cornell();
    for (name, command) in [
        ("i", format!("{INSTANT} --visibility records:{FEW}")),
        (
            "u",
            format!("{INSTANT} --guarantee unbiased --visibility records:{FEW}"),
        ),
        ("p", format!("{PATH} --secondary records:from=1,{FEW}")),
        (
            "m",
            format!("{PATH} --secondary records:from=2,lookup=march,near=on,{FEW}"),
        ),
    ] {
        dir.must(&format!(
            "{command} --threads 1 -o {name}1.exr --stats {name}.json"
        ));
        dir.must(&format!("{command} --threads 3 -o {name}3.exr"));
        assert!(
            dir.read(&format!("{name}1.exr")) == dir.read(&format!("{name}3.exr")),
            "{name}: threads show"
        );
        let stats = dir.json(&format!("{name}.json"));
        let records = &stats["records"];
        let reasons = |key: &str| -> u64 {
            let counts = records[key].as_object();
            counts.map_or(0, |counts| {
                counts.values().map(|n| n.as_u64().unwrap()).sum()
            })
        };
        match name {
            // Every ray but those to lamps.
            "i" => {
                let traced = stats["visibility"]["traced"].as_u64().unwrap();
                assert!(reasons("unanswered") > 0 && reasons("unanswered") <= traced);
            }
            "p" => assert_eq!(
                reasons("rays_unanswered"),
                records["rays_traced"].as_u64().unwrap()
            ),
            _ => assert!(reasons("unanswered") > 0),
        }
        assert_eq!(records["count"], 60);
        assert_eq!(records["capacity"], 60);
        assert!(records["bytes"].as_u64().unwrap() <= 60 * 32 * 32 * 16);
        assert!(records["refinements"].as_u64().unwrap() > 5);
        assert!(stats["rays"]["fill"].as_u64().unwrap() > 60 * 32 * 32 * 3 / 4);
        let seen = &stats["visibility"];
        let count = |key: &str| seen[key].as_u64().unwrap();
        // Exact rays at either end of every question leave none without a ray.
        if name != "m" {
            assert!(count("answered") > 0, "{name}");
            assert!(count("traced") < count("queries"), "{name}");
        }
        let class = if name == "u" { "unbiased" } else { "biased" };
        assert_eq!(seen["class"], class);
    }
}

/// Parts of a work with records that stay make the whole; each part has placed and refined the same records by itself.
#[test]
fn shards_of_fixed_records_make_the_whole() {
    let dir = cornell();
    let instant = INSTANT.replace("--samples 2", "--samples 5");
    for (name, command) in [
        ("i", format!("{instant} --visibility records:{FEW},pace=0")),
        (
            "u",
            format!("{instant} --guarantee unbiased --visibility records:{FEW},pace=0"),
        ),
        (
            "p",
            format!("{PATH} --secondary records:from=1,{FEW},pace=0"),
        ),
    ] {
        dir.must(&format!("{command} -o {name}.exr"));
        for shard in 0..2 {
            dir.must(&format!("{command} --shard {shard}/2 -o {name}{shard}.exr"));
        }
        dir.must(&format!("merge {name}1.exr {name}0.exr -o {name}m.exr"));
        assert!(
            dir.read(&format!("{name}.exr")) == dir.read(&format!("{name}m.exr")),
            "{name}: parts show"
        );
        // Records did answer.
        dir.must(&format!("{command} -o {name}.exr --stats {name}.json"));
        let stats = dir.json(&format!("{name}.json"));
        assert!(stats["records"]["refinements"].as_u64().unwrap() > 5);
        assert!(stats["visibility"]["answered"].as_u64().unwrap() > 0);
    }
}

/// Without a word about paths, records stand on the virtual lights: they stay there, so parts make the whole.
#[test]
fn records_stand_on_virtual_lights() {
    let dir = cornell();
    let command = format!("{INSTANT} --visibility records:resolution=32");
    dir.must(&format!("{command} --samples 4 -o w.exr --stats w.json"));
    let stats = dir.json("w.json");
    let lights = &stats["vpls"];
    assert!(lights.as_u64().unwrap() > 10);
    assert_eq!(&stats["records"]["count"], lights);
    assert_eq!(stats["records"]["refinements"], 0);
    assert_eq!(stats["records"]["unanswered"]["too_near"], 0);
    for shard in 0..2 {
        dir.must(&format!(
            "{command} --samples 4 --shard {shard}/2 -o w{shard}.exr"
        ));
    }
    dir.must("merge w1.exr w0.exr -o m.exr");
    assert!(dir.read("w.exr") == dir.read("m.exr"), "parts show");
    // Fewer records than lights, or a word about paths: near the lights.
    for option in ["count=8", "steps=3", "place=paths"] {
        dir.must(&format!(
            "{INSTANT} --visibility records:resolution=32,{option} -o p.exr --stats p.json"
        ));
        let records = &dir.json("p.json")["records"];
        assert!(records["refinements"].as_u64().unwrap() > 0, "{option}");
    }
}

/// Interrupted, and gone on with: the cache is what it was.
#[cfg(unix)]
#[test]
fn resume_goes_on_with_the_same_records() {
    for command in [
        "render c.glb --size 64x64 --secondary records:count=60,resolution=32,steps=20,pace=3",
        "render c.glb --size 64x64 --integrator instant-radiosity --vpls 64 --visibility records:count=60,resolution=32,steps=20,pace=3",
    ] {
        let dir = cornell();
        let (mut samples, mut wait) = (128, std::time::Duration::from_millis(300));
        loop {
            let child = dir
                .command(&format!(
                    "{command} --samples {samples} -o cut.exr --stats s.json"
                ))
                .spawn()
                .unwrap();
            std::thread::sleep(wait);
            signal("INT", child.id());
            let run = finish(child);
            // Done before, or not begun: in the middle next time.
            if run.code == Some(0) {
                samples *= 4;
                assert!(samples < 1 << 20, "never in the middle");
                continue;
            }
            if dir.json("s.json")["samples_per_pixel"] == 0 {
                wait *= 2;
                assert!(wait.as_secs() < 60, "never in the middle");
                continue;
            }
            assert_eq!(run.code, Some(130), "{}", run.stderr);
            break;
        }
        dir.refuses(
            &format!("{command},alpha=0.1 --samples {samples} -o cut.exr --resume"),
            &["cut.exr.checkpoint", "another work"],
        );
        let checkpoint = dir.read("cut.exr.checkpoint");
        dir.must(&format!(
            "{command} --samples {samples} -o cut.exr --resume --threads 3 --stats s.json"
        ));
        let stats = dir.json("s.json");
        let primary = stats["rays"]["primary"].as_u64().unwrap();
        assert!(primary < 64 * 64 * samples, "resume began anew");
        dir.must(&format!("{command} --samples {samples} -o whole.exr"));
        assert!(
            dir.read("cut.exr") == dir.read("whole.exr"),
            "the interruption shows: {command}"
        );
        // Damaged records are an error.
        let mut damaged = checkpoint;
        let last = damaged.len() - 60 * 104 - 32;
        assert_eq!(&damaged[last..last + 8], b"OCCREC02");
        damaged[last] ^= 1;
        std::fs::write(dir.path("cut.exr.checkpoint"), damaged).unwrap();
        dir.refuses(
            &format!("{command} --samples {samples} -o cut.exr --resume"),
            &["cut.exr.checkpoint", "records", "--resume"],
        );
    }
}

#[test]
fn pictures_are_near_exact_ones() {
    let dir = cornell();
    let energy = |name: &str, exact: &str| {
        let run = dir.must(&format!("compare {name}.exr {exact}.exr --json"));
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        let mean = |key: &str| json[key][0].as_f64().unwrap() + json[key][1].as_f64().unwrap();
        (
            mean("mean_a") / mean("mean_b") - 1.0,
            json["flip"].as_f64().unwrap(),
        )
    };
    dir.must(&format!("{INSTANT} -o e.exr"));
    dir.must(&format!(
        "{INSTANT} -o r.exr --visibility records:count=200,steps=50"
    ));
    let (change, flip) = energy("r", "e");
    assert!(change.abs() < 0.03 && flip < 0.06, "{change} {flip}");
    // Paths are noisy: records must differ less from exact rays than these do from themselves with other random numbers.
    let path = "render c.glb --size 48x32 --samples 32";
    dir.must(&format!("{path} -o pe.exr"));
    dir.must(&format!("{path} --seed 9 -o po.exr"));
    dir.must(&format!(
        "{path} -o pr.exr --secondary records:count=200,steps=50"
    ));
    let (_, noise) = energy("po", "pe");
    let (change, flip) = energy("pr", "pe");
    assert!(
        change.abs() < 0.03 && flip < noise,
        "{change} {flip} {noise}"
    );
}

#[test]
fn frames_keep_records_and_views_are_written() {
    let dir = cornell();
    dir.write(
        "t.json",
        r#"[{"frame": 0, "eye": [0, 0.275, 1.0], "target": [0, 0.275, 0], "fov": 40},
            {"frame": 2, "eye": [0.08, 0.3, 0.92], "target": [0, 0.275, 0], "fov": 40}]"#,
    );
    dir.must(&format!(
        "{INSTANT} --visibility records:{FEW} --camera-path t.json -o f_##.exr --record-views v_## --stats s.json"
    ));
    for frame in 0..3 {
        for what in ["importance", "utility", "correlation", "positions"] {
            assert!(!dir.read(&format!("v_0{frame}-{what}.png")).is_empty());
        }
    }
    let stats = dir.json("s.json");
    assert_eq!(stats["records"]["count"], 60);
    // Twenty steps before the first frame, and 32 before each other.
    let steps = stats["records"]["refinements"].as_u64().unwrap();
    assert!((40..=90).contains(&steps), "{steps}");
}

/// What records take by the system's account, not by our own.
#[cfg(target_os = "linux")]
#[test]
fn records_take_the_memory_that_they_tell_of() {
    let dir = cornell();
    let render = |options: &str| dir.must(&format!("{INSTANT} -o a.exr {options}"));
    let without = render("").peak_bytes;
    let records = "--visibility records:place=paths,count=2000,steps=40 --stats a.json";
    let with = render(records).peak_bytes - without;
    let told = dir.json("a.json")["records"]["bytes"].as_u64().unwrap();
    assert!(told >= 2000 * 128 * 128 * 2);
    assert!(with <= told, "{with} of {told}");
    // And they are there.
    assert!(with >= told / 2, "{with} of {told}");
}

#[test]
fn wrong_choices_are_refused() {
    let dir = cornell();
    let instant = |options: &str| format!("{INSTANT} -o a.exr --visibility records:{options}");
    dir.refuses(&instant("count=0"), &["count=0"]);
    dir.refuses(&instant("count=70000"), &["65534"]);
    dir.refuses(&instant("resolution=100"), &["resolution=100"]);
    dir.refuses(&instant("alpha=2"), &["alpha=2"]);
    dir.refuses(
        &format!("{} --memory 64MiB", instant("count=4000")),
        &["largest that fits", "--memory"],
    );
    dir.refuses(
        &format!("{PATH} -o a.exr --visibility records"),
        &["--integrator instant-radiosity", "--secondary"],
    );
    dir.refuses(
        &format!("{INSTANT} -o a.exr --secondary records"),
        &["--secondary", "--integrator path"],
    );
    dir.refuses(
        &format!("{PATH} -o a.exr --secondary records --guarantee unbiased"),
        &["--guarantee", "biased"],
    );
    dir.refuses(
        &format!("{} --guarantee bounded", instant("")),
        &["--guarantee", "unbiased"],
    );
    dir.refuses(
        &format!("{PATH} -o a.exr --record-views v"),
        &["--record-views"],
    );
    dir.refuses(
        &format!("{} --shard 0/2", instant("steps=3")),
        &["--shard", "pace=0"],
    );
    dir.refuses(
        &format!("{PATH} -o a.exr --secondary records:pace=1 --shard 0/2"),
        &["--shard", "pace=0"],
    );
    for bad in [
        "from=1",
        "place=here",
        "select=best",
        "lookup=guess",
        "near=-1",
        "colour=red",
        "count",
    ] {
        let run = dir.run(&instant(bad));
        assert_eq!(run.code, Some(2), "{bad}: {}", run.stderr);
    }
}

#[test]
fn a_camera_that_sees_nothing_is_warned_of() {
    let dir = cornell();
    let run = dir.must(&format!(
        "{INSTANT} -o a.exr --visibility records:place=paths --camera-look 0,0.2,9,0,0.2,20"
    ));
    assert!(
        run.stderr.contains("warning: no place for records"),
        "{}",
        run.stderr
    );
}
