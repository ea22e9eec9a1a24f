//! `occlude animate` from outside.

mod util;
use util::Dir;
#[cfg(unix)]
use util::finish;

fn balls() -> Dir {
    let dir = Dir::new();
    dir.must("scene balls-in-dish --triangles 3000 -o b.glb");
    dir
}

const FEW: &str = "--size 64x48 --cache off --threads 2";

#[test]
fn frames_and_films() {
    let dir = balls();
    dir.must(&format!(
        "animate b.glb --frames 0..2 {FEW} -o f_##.exr -o film.webp -o film.gif -o film.png --stats s.json"
    ));
    for name in ["f_00.exr", "f_02.exr", "film.webp", "film.gif", "film.png"] {
        assert!(!dir.read(name).is_empty(), "{name}");
    }
    assert!(
        dir.names().iter().all(|name| !name.contains("frames")),
        "{:?}",
        dir.names()
    );
    assert!(dir.read("film.webp").starts_with(b"RIFF"));
    assert!(dir.read("film.png").windows(4).any(|w| w == b"acTL"));
    let stats = dir.json("s.json");
    assert_eq!(stats["command"], "animate");
    let frames = stats["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 3);
    for key in [
        "frame",
        "seconds",
        "t_update",
        "t_visibility",
        "t_transform",
        "t_integration",
        "sample_points",
        "rays",
    ] {
        assert!(frames[2][key].is_number(), "{key}");
    }
    assert!(frames[2]["sample_points"].as_u64() > Some(10));
    assert_eq!(stats["visibility"]["strategy"], "field");
    // Things move.
    assert!(dir.read("f_00.exr") != dir.read("f_02.exr"));
}

#[test]
fn one_frame_by_paths() {
    let dir = balls();
    dir.must(&format!(
        "animate b.glb --integrator path --max-depth 1 --samples 4 --frames 6..6 {FEW} -o p.exr --stats s.json"
    ));
    dir.must(&format!(
        "render b.glb --max-depth 1 --samples 4 --time 0.25 {FEW} -o r.exr"
    ));
    assert!(dir.read("p.exr") == dir.read("r.exr"));
    let frame = &dir.json("s.json")["frames"][0];
    assert_eq!(frame["sample_points"], 0);
    assert!(frame["rays"].as_u64() > Some(64 * 48));
}

#[test]
fn the_whole_animation_is_the_default() {
    let dir = balls();
    let size = "--size 8x8 --integrator ao --samples 1";
    dir.must(&format!("animate b.glb --fps 2 {size} -o f_##.png"));
    let frames = dir
        .names()
        .iter()
        .filter(|name| name.starts_with("f_"))
        .count();
    assert_eq!(frames, 11, "5 s, both ends");
}

/// The film's frames lie beside it until it is whole; fields go through those that are done again.
#[cfg(unix)]
#[test]
fn an_interrupted_film_ends_in_the_same_bytes() {
    let dir = balls();
    let mut width = 96;
    let work = loop {
        let work = format!(
            "animate b.glb --frames 0..7 --fps 6 --cache off --size {width}x{}",
            width * 3 / 4
        );
        let child = dir
            .command(&format!("{work} -o film.webp"))
            .spawn()
            .unwrap();
        let began = std::time::Instant::now();
        let second = dir.path("film.webp.frames").join("frame_000001.png");
        while !second.exists() && began.elapsed().as_secs() < 60 {
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        let kill = std::process::Command::new("kill")
            .args(["-INT", &child.id().to_string()])
            .status();
        assert!(kill.is_ok());
        let run = finish(child);
        if run.code == Some(130) {
            assert!(run.stderr.contains("--resume"), "{}", run.stderr);
            break work;
        }
        // Too fast to be interrupted.
        std::fs::remove_file(dir.path("film.webp")).unwrap();
        width *= 2;
    };
    assert!(!dir.path("film.webp").exists());
    dir.must(&format!("{work} -o film.webp --resume --stats s.json"));
    let resumed = dir.json("s.json")["frames"].as_array().unwrap().len();
    assert!((1..7).contains(&resumed), "{resumed}");
    assert!(!dir.path("film.webp.frames").exists());
    dir.must(&format!("{work} -o whole.webp --threads 1"));
    assert!(dir.read("film.webp") == dir.read("whole.webp"));
}

#[test]
fn what_cannot_be_animated_is_refused() {
    let dir = balls();
    dir.must("scene cornell -o still.glb");
    for (options, words) in [
        (
            "still.glb -o a_#.png",
            &["no animation", "--camera-path"][..],
        ),
        (
            "b.glb -o film.webp --shard 0/2 --integrator path",
            &["a film needs all frames", "--shard"],
        ),
        ("b.glb -o a_#.png --shard 0/2", &["--shard"]),
        (
            "b.glb -o a_#.png --threshold 5%,10%",
            &["--threshold", "MAX comes first"],
        ),
        (
            "b.glb -o a_#.png --memory 20MiB --resolution 512",
            &["bytes", "--resolution 256"],
        ),
        ("b.glb -o a.exr --frames 0..3", &["one name", "####"]),
        ("b.glb -o a_#.png --cache=", &["--cache"]),
    ] {
        dir.refuses(&format!("animate {options} --size 16x16"), words);
    }
    assert!(
        !dir.names().iter().any(|name| name.ends_with(".frames")),
        "{:?}",
        dir.names()
    );
}
