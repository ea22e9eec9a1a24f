//! Bad usage is refused in one line with exit code 2, before any work.

mod util;
use util::Dir;

#[test]
fn without_arguments_there_is_help() {
    let run = Dir::new().run("");
    assert_eq!(run.code, Some(2));
    assert!(
        run.stdout.is_empty() && run.stderr.contains("Usage: occlude"),
        "{}",
        run.stderr
    );
}

#[test]
fn help_and_version_are_results() {
    let dir = Dir::new();
    for arguments in [
        "--help",
        "help render",
        "render --help",
        "render -h",
        "compare --help",
        "scene --help",
        "--version",
    ] {
        let run = dir.must(arguments);
        assert!(
            run.stderr.is_empty() && !run.stdout.is_empty(),
            "{arguments}"
        );
    }
    let version = dir.must("--version").stdout;
    assert!(
        version.starts_with("occlude ") && version.contains('(') && version.lines().count() == 1,
        "{version}"
    );
    let help = dir.must("render --help").stdout;
    for word in [
        "--denoise",
        "--tonemap",
        "neutral",
        "Khronos PBR Neutral",
        "degrees",
        "metres",
        "--resume",
        "[default: 1280x720]",
    ] {
        assert!(help.contains(word), "no {word} in the help of render");
    }
}

#[test]
fn impossible_options_are_refused() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    for (options, words) in [
        ("--size 0x0", &["0x0", "--size"][..]),
        (
            "--integrator field --threshold 5%,10%",
            &["--threshold", "MAX comes first"],
        ),
        (
            "--integrator field --resolution 100",
            &["--resolution", "128"],
        ),
        ("--integrator field --shard 0/2", &["--shard"]),
        ("--size 100000x100000", &["too large"]),
        ("--size 12", &["--size"]),
        ("--samples 0", &["--samples"]),
        ("--samples -3", &["--samples"]),
        ("--samples many", &["--samples"]),
        ("--threads -1", &["--threads"]),
        ("--threads 0", &["--threads"]),
        ("--max-depth -1", &["--max-depth"]),
        ("--time-limit 0s", &["--time-limit"]),
        ("--time-limit soon", &["--time-limit", "30s"]),
        ("--noise -1", &["--noise"]),
        ("--noise nan", &["--noise"]),
        ("--memory 0", &["--memory"]),
        ("--memory lots", &["--memory", "4GiB"]),
        ("--shard 4/4", &["--shard", "0/4"]),
        ("--shard 1/2 --time-limit 3s", &["--samples"]),
        ("--shard 1/2 -o p.exr", &["exactly one"]),
        ("--camera nobody", &["nobody", "has"]),
        ("--camera 99", &["99"]),
        ("--camera-look 1,2,3", &["six numbers"]),
        ("--camera-look 1,2,3,1,2,3", &["same point"]),
        ("--camera-look 1,2,3,4,5,6 --fov 180", &["--fov"]),
        ("--fov 50", &["--camera-look"]),
        ("--sun up", &["--sun"]),
        ("--sun 0,91", &["elevation"]),
        ("--time inf", &["--time"]),
        ("--environment-scale -1", &["--environment-scale"]),
        (
            "--environment nothing.hdr",
            &["nothing.hdr", "no such file"],
        ),
        ("--integrator magic", &["path", "ao"]),
        ("--visibility magic", &["exact", "occluder", "quantized"]),
        (
            "--visibility quantized:colour=red",
            &["colour", "error-sky"],
        ),
        ("--visibility quantized:normals=7", &["even number"]),
        (
            "--visibility quantized --memory 128MiB",
            &["table", "--memory"],
        ),
        ("--visibility quantized --shard 0/2", &["--shard", "exact"]),
        ("--guarantee unbiased", &["--guarantee", "quantized"]),
        ("--tonemap magic", &["neutral"]),
        ("--aov magic", &["albedo"]),
        ("--aov albedo", &["--aov", ".exr"]),
        ("--denoise", &["--denoise", "not built in yet"]),
        ("--gltf-scene nobody", &["nobody"]),
        (
            "--stats /proc/nowhere/s.json",
            &["/proc/nowhere/s.json", "folder does not exist"],
        ),
        ("--nonsense", &["--nonsense", "occlude render --help"]),
    ] {
        dir.refuses(
            &format!("render c.glb -o out.png --seed 1 {options}"),
            words,
        );
    }
    assert_eq!(dir.names(), ["c.glb"], "nothing was written");
}

#[test]
fn impossible_outputs_are_refused() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let scene = dir.read("c.glb");
    for (output, word) in [
        ("/proc/nowhere/x.exr", "/proc/nowhere/x.exr"),
        ("missing/x.exr", "missing/x.exr"),
        ("x.tga9", ".exr"),
        ("x", ".exr"),
        (".", "."),
        ("a.png -o a.png", "a.png"),
    ] {
        dir.refuses(&format!("render c.glb -o {output}"), &[word]);
    }
    dir.refuses("scene cornell -o c.gltf", &[".glb"]);
    dir.refuses("scene nowhere -o n.glb", &["nowhere", "cornell"]);
    dir.refuses("scene cornell --triangles 0 -o n.glb", &["--triangles"]);
    dir.refuses("scene cornell", &["--output"]);
    assert_eq!(dir.names(), ["c.glb"]);
    assert_eq!(dir.read("c.glb"), scene);
}

#[test]
fn missing_and_unsuitable_inputs_are_refused() {
    let dir = Dir::new();
    std::fs::create_dir(dir.path("folder.glb")).unwrap();
    dir.write("empty.glb", "");
    dir.write("text.txt", "hello");
    dir.write("empty.exr", "");
    for command in [
        "render nothing.glb",
        "inspect nothing.glb",
        "render folder.glb",
        "inspect folder.glb",
        "render empty.glb",
        "inspect empty.glb",
        "inspect text.txt",
    ] {
        let file = command.split(' ').next_back().unwrap();
        dir.refuses(command, &[file]);
    }
    dir.refuses("compare nothing.exr nothing.exr", &["nothing.exr"]);
    dir.refuses("compare empty.exr empty.exr", &["empty.exr"]);
    dir.refuses("merge nothing.exr -o x.exr", &["nothing.exr"]);
    dir.refuses("merge empty.exr -o x.exr", &["empty.exr"]);
    dir.refuses("merge text.txt text.txt -o x.exr", &["text.txt"]);
    dir.refuses("merge -o x.exr", &["PARTS"]);
}

#[cfg(unix)]
#[test]
fn a_closed_pipe_is_no_error() {
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    let mut child = dir.command("inspect c.glb --json").spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(!String::from_utf8_lossy(&output.stderr).contains("panicked"));
}
