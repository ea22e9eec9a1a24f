//! `occlude compare` from outside: numbers, files, refusals.

mod util;

use occlude_image::{Limits, Look, Picture, read, write};
use util::Dir;

/// A gradient with a square whose brightness is `square`.
fn picture(width: u32, height: u32, square: f32) -> Picture {
    let mut picture = Picture::new(width, height);
    for (i, pixel) in picture.pixels.iter_mut().enumerate() {
        let (x, y) = (i as u32 % width, i as u32 / width);
        let inside = (4..8).contains(&x) && (4..8).contains(&y);
        *pixel = if inside {
            [square; 3]
        } else {
            [x as f32 / width as f32, 0.5, y as f32 / height as f32]
        };
    }
    picture
}

/// Two pictures in every format.
fn folder() -> Dir {
    let dir = Dir::new();
    for (name, square) in [("a", 3.0), ("b", 1.0)] {
        for extension in ["exr", "hdr", "png"] {
            let path = dir.path(&format!("{name}.{extension}"));
            write(&path, &picture(40, 20, square), Look::default()).unwrap();
        }
    }
    dir
}

#[test]
fn json_holds_what_the_contract_says() {
    let dir = folder();
    let run = dir.must("compare a.exr b.exr --json");
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    let keys: Vec<_> = json.as_object().unwrap().keys().cloned().collect();
    let mut wanted = vec![
        "mse",
        "relmse",
        "psnr",
        "ssim",
        "flip",
        "energy_change",
        "mean_a",
        "mean_b",
        "width",
        "height",
    ];
    wanted.sort_unstable();
    let mut sorted = keys;
    sorted.sort_unstable();
    assert_eq!(sorted, wanted);
    assert_eq!(
        (json["width"].as_u64(), json["height"].as_u64()),
        (Some(40), Some(20))
    );
    // 16 of 800 pixels differ by 2 in every channel.
    assert!((json["mse"].as_f64().unwrap() - 0.08).abs() < 1e-6);
    // With the other one as reference the means keep their letters.
    let swapped = dir.must("compare a.exr b.exr --json --reference-is A");
    let swapped: serde_json::Value = serde_json::from_str(&swapped.stdout).unwrap();
    assert_eq!(swapped["mean_a"], json["mean_a"]);
    assert_eq!(swapped["mse"], json["mse"]);
    assert_ne!(swapped["energy_change"], json["energy_change"]);
    // Equal pictures: no error, and no number for the PSNR.
    let same = dir.must("compare b.exr b.exr --json");
    let same: serde_json::Value = serde_json::from_str(&same.stdout).unwrap();
    assert!(same["psnr"].is_null() && same["flip"] == 0.0 && same["ssim"] == 1.0);
}

#[test]
fn formats_mix_and_png_is_compared_as_display_colours() {
    let dir = folder();
    assert!(dir.must("compare a.exr b.hdr").stdout.contains("(HDR)"));
    assert!(dir.must("compare a.png b.png").stdout.contains("(LDR)"));
    assert!(dir.must("compare a.png b.exr").stdout.contains("(LDR)"));
}

#[test]
fn map_and_report_are_written() {
    let dir = folder();
    let run = dir.must("compare a.exr b.exr --map d.png --report r.html");
    assert!(run.stderr.is_empty(), "{}", run.stderr);
    let map = read(&dir.path("d.png"), &Limits::default())
        .unwrap()
        .picture;
    assert_eq!((map.width, map.height), (40, 20));
    let page = String::from_utf8(dir.read("r.html")).unwrap();
    assert!(page.contains("a.exr") && page.matches("data:image/png").count() == 4);
    dir.must("compare a.exr b.exr --map d.exr");
    let difference = read(&dir.path("d.exr"), &Limits::default())
        .unwrap()
        .picture;
    assert_eq!(difference.get(5, 5), Some([2.0; 3]));
    assert_eq!(difference.get(0, 0), Some([0.0; 3]));
}

#[test]
fn bad_input_is_refused_before_anything_is_written() {
    let dir = folder();
    write(&dir.path("small.exr"), &picture(9, 9, 1.0), Look::default()).unwrap();
    dir.write("text.exr", "no picture");
    let whole = dir.read("a.exr");
    std::fs::write(dir.path("cut.exr"), &whole[..whole.len() / 2]).unwrap();
    let before = dir.names();
    for (command, named) in [
        ("compare missing.exr b.exr --map d.png", "missing.exr"),
        ("compare a.exr missing.exr", "missing.exr"),
        ("compare a.exr small.exr --map d.png", "40x20"),
        ("compare text.exr b.exr", "text.exr"),
        ("compare cut.exr b.exr", "cut.exr"),
        ("compare . b.exr", "folder"),
        ("compare a.exr b.exr --map d.tga9", "d.tga9"),
        ("compare a.exr b.exr --map d.hdr", "d.hdr"),
        ("compare a.exr b.exr --map a.exr", "a.exr"),
        ("compare a.exr b.exr --report nowhere/r.html", "nowhere"),
    ] {
        dir.refuses(command, &[named]);
    }
    assert_eq!(dir.names(), before);
    assert_eq!(dir.read("a.exr"), whole);
}

#[test]
fn pixels_that_are_not_numbers_are_a_warning() {
    let dir = folder();
    let mut broken = picture(40, 20, 1.0);
    broken.pixels[3] = [f32::NAN, 0.0, 0.0];
    write(&dir.path("nan.exr"), &broken, Look::default()).unwrap();
    let run = dir.must("compare nan.exr b.exr --json");
    assert!(run.stderr.starts_with("warning: 1 pixel"), "{}", run.stderr);
}
