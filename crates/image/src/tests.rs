//! Files through the codecs: round trips, foreign files, damage.

use std::path::{Path, PathBuf};

use crate::*;

/// A small, fast generator; the tests need variety, not quality.
pub(crate) struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let x = self.0 ^ (self.0 >> 33);
        x.wrapping_mul(0xff51_afd7_ed55_8ccd) >> 16
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    pub fn float(&mut self) -> f32 {
        (self.bits() & 0xff_ffff) as f32 / (1 << 24) as f32
    }
}

/// Noise over a gradient over 16 stops, with runs of black.
pub(crate) fn sample_picture(width: u32, height: u32, seed: u64) -> Picture {
    let mut random = Random(seed);
    let mut picture = Picture::new(width, height);
    for (i, pixel) in picture.pixels.iter_mut().enumerate() {
        if (i / 37) % 3 != 0 {
            let scale = (random.float() * 16.0 - 8.0).exp2();
            *pixel = [
                random.float() * scale,
                random.float() * scale,
                random.float() * scale,
            ];
        }
    }
    picture
}

fn scratch(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("occlude-image-{}-{name}", std::process::id()))
}

/// The bytes that `write_layers` puts into a file of that extension.
fn bytes_of(layers: &Layers, extension: &str) -> Vec<u8> {
    use std::sync::atomic::{AtomicU32, Ordering};
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let path = scratch(&format!(
        "{}.{extension}",
        COUNT.fetch_add(1, Ordering::Relaxed)
    ));
    write_layers(&path, layers, Look::default()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(path).unwrap();
    bytes
}

fn rich_layers(width: u32, height: u32) -> Layers {
    let picture = sample_picture(width, height, 3);
    let mut layers = Layers::from_picture(&picture, Depth::Float);
    layers.push_colors(
        "albedo",
        Depth::Half,
        &sample_picture(width, height, 4).pixels,
    );
    layers.push_xyz(
        "normal",
        Depth::Half,
        &sample_picture(width, height, 5).pixels,
    );
    layers.push(
        "depth.Z",
        Depth::Float,
        picture.pixels.iter().map(|p| p[0] * 100.0).collect(),
    );
    layers.push_colors(
        "variance",
        Depth::Float,
        &sample_picture(width, height, 6).pixels,
    );
    layers.describe("seed", Attribute::Text("18446744073709551615".into()));
    layers.describe("samples", Attribute::Int(64));
    layers.describe("exposure_ev", Attribute::Float(-1.5));
    layers.describe("seconds", Attribute::Double(1.25));
    layers.describe(
        "a name that is longer than thirty-one bytes",
        Attribute::Text("x".into()),
    );
    layers
}

#[test]
fn exr_round_trips_with_layers_and_metadata() {
    for (width, height) in [(1, 1), (3, 17), (64, 48), (200, 5), (1, 100)] {
        let layers = rich_layers(width, height);
        let path = scratch(&format!("round-{width}x{height}.exr"));
        write_layers(&path, &layers, Look::default()).unwrap();
        let back = read_layers(&path, &Limits::default()).unwrap();
        assert_eq!((back.width, back.height), (width, height));
        assert_eq!(back.channels.len(), layers.channels.len());
        for channel in &layers.channels {
            let read = back.channel(&channel.name).unwrap();
            assert_eq!(read.depth, channel.depth);
            for (a, b) in channel.values.iter().zip(&read.values) {
                match channel.depth {
                    Depth::Float => assert_eq!(a, b),
                    Depth::Half => assert_eq!(half::f16::from_f32(*a).to_f32(), *b),
                }
            }
        }
        for (name, value) in &layers.metadata {
            assert_eq!(back.attribute(name), Some(value));
        }
        let opened = read(&path, &Limits::default()).unwrap();
        assert_eq!(Some(opened.picture), layers.picture(""));
        assert_eq!(
            (opened.encoding, opened.repaired),
            (Encoding::SceneLinear, 0)
        );
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn equal_layers_give_equal_bytes_in_any_order_and_at_any_thread_count() {
    let layers = rich_layers(100, 70);
    let mut turned = layers.clone();
    turned.channels.reverse();
    turned.metadata.reverse();
    for extension in ["exr", "hdr", "png"] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let one = pool.install(|| bytes_of(&layers, extension));
        assert_eq!(one, bytes_of(&turned, extension), "{extension}");
    }
}

#[test]
fn half_keeps_finite_values_finite() {
    let mut layers = Layers::new(3, 1);
    layers.push("R", Depth::Half, vec![1e30, -1e30, f32::INFINITY]);
    let path = scratch("half.exr");
    write_layers(&path, &layers, Look::default()).unwrap();
    let back = read_layers(&path, &Limits::default()).unwrap();
    assert_eq!(
        back.channel("R").unwrap().values,
        [65504.0, -65504.0, f32::INFINITY]
    );
    std::fs::remove_file(path).unwrap();
}

#[test]
fn pixels_that_are_not_numbers_are_replaced_and_counted() {
    let mut picture = sample_picture(8, 8, 1);
    picture.pixels[3] = [f32::NAN, 2.0, 3.0];
    picture.pixels[9] = [1.0, f32::INFINITY, f32::NEG_INFINITY];
    let bytes = bytes_of(&Layers::from_picture(&picture, Depth::Float), "exr");
    let opened = decode(&bytes, Path::new("x.exr"), &Limits::default()).unwrap();
    assert_eq!(opened.repaired, 2);
    assert_eq!(opened.picture.pixels[3], [0.0, 2.0, 3.0]);
    assert_eq!(opened.picture.pixels[9], [1.0, 0.0, 0.0]);
}

#[test]
fn hdr_round_trips_within_half_a_mantissa_step() {
    // Widths below 8 are stored flat, 300 has a size of two bytes, 40000 is beyond the newer run-length encoding.
    for (width, height) in [(1, 1), (7, 3), (8, 2), (300, 20), (40000, 1)] {
        let mut picture = sample_picture(width, height, 9);
        picture.pixels[0] = [-1.0, f32::NAN, 1e-38];
        let bytes = bytes_of(&Layers::from_picture(&picture, Depth::Float), "hdr");
        let back = decode(&bytes, Path::new("x.hdr"), &Limits::default())
            .unwrap()
            .picture;
        for (a, b) in picture.pixels.iter().zip(&back.pixels).skip(1) {
            let step = a.iter().fold(0f32, |m, &v| m.max(v)) / 128.0;
            for c in 0..3 {
                assert!((a[c] - b[c]).abs() <= 0.5001 * step, "{a:?} became {b:?}");
            }
        }
        // What was read is representable: a second round trip changes nothing.
        let again = bytes_of(&Layers::from_picture(&back, Depth::Float), "hdr");
        assert_eq!(
            decode(&again, Path::new("x.hdr"), &Limits::default())
                .unwrap()
                .picture,
            back
        );
    }
}

fn hdr(header: &str, data: &[u8]) -> Result<Picture, ImageError> {
    let bytes = [header.as_bytes(), data].concat();
    decode(&bytes, Path::new("x.hdr"), &Limits::default()).map(|o| o.picture)
}

#[test]
fn hdr_headers_orientations_and_run_lengths() {
    let (a, b) = ([128, 0, 0, 129], [0, 128, 0, 130]);
    let (red, green) = ([1.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    let data = [a, b].concat();
    let of = |resolution: &str| {
        hdr(
            &format!("#?RGBE\r\n# x\nFORMAT=32-bit_rle_rgbe\n\n{resolution}\n"),
            &data,
        )
        .unwrap()
    };
    assert_eq!(of("-Y 1 +X 2").pixels, [red, green]);
    assert_eq!(of("-Y 1 -X 2").pixels, [green, red]);
    assert_eq!(of("+Y 2 +X 1").pixels, [green, red]);
    assert_eq!(of("-Y 2 +X 1").pixels, [red, green]);
    assert_eq!(of("+X 2 -Y 1").pixels, [red, green]);
    assert_eq!(of("-X 2 -Y 1").pixels, [green, red]);
    assert_eq!(of("+X 1 +Y 2").pixels, [green, red]);
    // Exposures multiply, colour correction too; both are divided out.
    let exposed = hdr(
        "#?RADIANCE\nEXPOSURE=2\nEXPOSURE= 4\nCOLORCORR=1 0.5 1\n\n-Y 1 +X 2\n",
        &data,
    )
    .unwrap();
    assert_eq!(exposed.pixels, [[0.125, 0.0, 0.0], [0.0, 0.5, 0.0]]);
    // Old run-length encoding: once, then 2 times, then 256 times.
    let runs = [&a[..], &[1, 1, 1, 2], &[1, 1, 1, 1], &b].concat();
    let long = hdr("#?RADIANCE\n\n-Y 1 +X 260\n", &runs).unwrap();
    assert!(long.pixels[..259].iter().all(|&p| p == red) && long.pixels[259] == green);
    // New: each channel for itself.
    let scan = [
        2, 2, 0, 8, 136, 128, 4, 1, 2, 3, 4, 132, 0, 136, 0, 136, 129,
    ];
    let new = hdr("#?RADIANCE\n\n-Y 1 +X 8\n", &scan).unwrap();
    assert_eq!(new.pixels[1], [1.0, 2.0 / 128.0, 0.0]);
    for (header, data) in [
        (
            "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 2\n",
            &data[..],
        ),
        ("#?RADIANCE\n\n-Y 1 -Y 2\n", &data),
        ("#?RADIANCE\n\n-Y 1 +X 0\n", &data),
        ("#?RADIANCE\n\n-Y 1 +X -2\n", &data),
        ("#?RADIANCE\n\n-Y 1 +X 3\n", &data),
        ("#?RADIANCE\n\n-Y 99999999 +X 99999999\n", &data),
        ("#?RADIANCE\n\n-Y 1 +X 9\n", &scan),
        ("#?RADIANCE\n\n-Y 1 +X 8\n", &scan[..16]),
        ("#?RADIANCE\n\n-Y 1 +X 8\n", &[2, 2, 0, 8, 137, 128]),
        ("#?RADIANCE\n\n-Y 1 +X 8\n", &[2, 2, 0, 8, 0, 0]),
        ("#?RADIANCE\n\n-Y 1 +X 2\n", &[1, 1, 1, 1, 9, 9, 9, 9]),
        (
            "#?RADIANCE\nEXPOSURE=1e-30\nEXPOSURE=1e-30\n\n-Y 1 +X 2\n",
            &data,
        ),
        ("#?RADIANCE\n", &[]),
    ] {
        let text = hdr(header, data).unwrap_err().to_string();
        assert!(!text.contains('\n') && text.contains("x.hdr"), "{text}");
    }
}

#[test]
fn png_says_its_look_and_reads_back() {
    let picture = sample_picture(33, 9, 2);
    let mut layers = Layers::from_picture(&picture, Depth::Float);
    layers.describe("seed", Attribute::Text("7 \u{e4}\n".into()));
    let path = scratch("look.png");
    let look = Look {
        tone_map: ToneMap::Agx,
        exposure_ev: -1.0,
    };
    write_layers(&path, &layers, look).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    assert!(
        text.contains("agx (AgX base)") && text.contains("-1 EV") && text.contains("occlude"),
        "text chunks are missing"
    );
    let opened = read(&path, &Limits::default()).unwrap();
    assert_eq!(opened.encoding, Encoding::Display);
    for (a, b) in picture.pixels.iter().zip(&opened.picture.pixels) {
        let bytes = ToneMap::Agx.encode(*a, -1.0);
        assert_eq!(bytes, b.map(|v| (srgb_encode(v) * 255.0).round() as u8));
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn png_of_every_colour_type_and_depth() {
    use ::png::{BitDepth, ColorType};
    let encode = |color, depth, palette: Option<&[u8]>, data: &[u8], width, height| {
        let mut bytes = Vec::new();
        let mut encoder = ::png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if let Some(palette) = palette {
            encoder.set_palette(palette.to_vec());
        }
        encoder
            .write_header()
            .unwrap()
            .write_image_data(data)
            .unwrap();
        decode(&bytes, Path::new("x.png"), &Limits::default())
            .unwrap()
            .picture
            .pixels
    };
    let grey = |v: f32| [srgb_decode(v); 3];
    assert_eq!(
        encode(
            ColorType::Grayscale,
            BitDepth::One,
            None,
            &[0b0100_0000, 0b1000_0000],
            2,
            2
        ),
        [grey(0.0), grey(1.0), grey(1.0), grey(0.0)]
    );
    assert_eq!(
        encode(
            ColorType::GrayscaleAlpha,
            BitDepth::Eight,
            None,
            &[51, 0],
            1,
            1
        ),
        [grey(0.2)]
    );
    assert_eq!(
        encode(
            ColorType::Grayscale,
            BitDepth::Sixteen,
            None,
            &[0x33, 0x33],
            1,
            1
        ),
        [grey(0.2)]
    );
    assert_eq!(
        encode(
            ColorType::Rgba,
            BitDepth::Eight,
            None,
            &[255, 0, 255, 9],
            1,
            1
        ),
        [[1.0, 0.0, 1.0]]
    );
    assert_eq!(
        encode(
            ColorType::Rgb,
            BitDepth::Sixteen,
            None,
            &[255, 255, 0, 0, 0, 0],
            1,
            1
        ),
        [[1.0, 0.0, 0.0]]
    );
    assert_eq!(
        encode(
            ColorType::Indexed,
            BitDepth::Two,
            Some(&[0, 0, 0, 0, 255, 0]),
            &[0b0100_0000],
            2,
            1
        ),
        [[0.0, 1.0, 0.0], [0.0; 3]]
    );
}

#[test]
fn layers_that_do_not_fit_are_refused() {
    let path = scratch("refused.exr");
    let mut short = Layers::new(2, 2);
    short.push("R", Depth::Half, vec![0.0; 3]);
    let mut twice = Layers::from_picture(&Picture::new(2, 2), Depth::Half);
    twice.push("R", Depth::Half, vec![0.0; 4]);
    let mut taken = Layers::from_picture(&Picture::new(2, 2), Depth::Half);
    taken.describe("compression", Attribute::Int(0));
    for layers in [
        Layers::new(2, 2),
        Layers::from_picture(&Picture::new(0, 2), Depth::Half),
        short,
        twice,
        taken,
    ] {
        assert!(matches!(
            write_layers(&path, &layers, Look::default()),
            Err(ImageError::Inconsistent(_))
        ));
    }
    assert!(!path.exists());
    assert!(Picture::from_pixels(2, 2, vec![[0.0; 3]; 5]).is_err());
}

/// Scenes of the project, if they are there.
fn scenes() -> Option<PathBuf> {
    let folder = std::env::var_os("OCCLUDE_SCENES").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"),
        PathBuf::from,
    );
    let found = folder.is_dir().then_some(folder);
    if found.is_none() {
        eprintln!("SKIPPED: no scenes; set OCCLUDE_SCENES");
    }
    found
}

#[test]
fn environments_of_others_are_read() {
    let Some(scenes) = scenes() else { return };
    let open = |name: &str| {
        read(&scenes.join(name), &Limits::default())
            .unwrap()
            .picture
    };
    let radiance = open("env/kiara_1_dawn_1k.hdr");
    assert_eq!((radiance.width, radiance.height), (1024, 512));
    let none = open("env/kiara_1_dawn_128_float_none.exr");
    let piz = open("env/kiara_1_dawn_128_float_piz.exr");
    assert_eq!(none, piz);
    let zip = open("env/kiara_1_dawn_512_half_zip.exr");
    // One picture at three sizes and in three encodings: one mean.
    for other in [&none, &zip] {
        for c in 0..3 {
            let ratio = other.mean()[c] / radiance.mean()[c];
            assert!((ratio - 1.0).abs() < 0.01, "channel {c}: {ratio}");
        }
    }
    let flat = open("conformance/flat_not_rle_8x4.hdr");
    assert_eq!(
        (flat.width, flat.height, flat.pixels[31]),
        (
            8,
            4,
            [100.0 / 128.0, 50.0 / 128.0, 25.0 / 128.0].map(|v: f32| v * 2f32.powi(129 - 129))
        )
    );
    for bad in ["huge_dims.hdr", "truncated.hdr"] {
        assert!(
            read(
                &scenes.join("conformance/malformed").join(bad),
                &Limits::default()
            )
            .is_err()
        );
    }
}

#[test]
fn limits_hold_and_missing_files_are_errors() {
    let bytes = bytes_of(
        &Layers::from_picture(&sample_picture(64, 64, 1), Depth::Half),
        "exr",
    );
    let small = Limits {
        max_bytes: 64 * 64 * 12 - 1,
    };
    assert!(matches!(
        decode(&bytes, Path::new("x"), &small),
        Err(ImageError::TooLarge {
            width: 64,
            height: 64,
            ..
        })
    ));
    let enough = Limits {
        max_bytes: 64 * 64 * 12,
    };
    assert!(decode(&bytes, Path::new("x"), &enough).is_ok());
    assert!(matches!(
        read(Path::new("/nowhere/x.exr"), &enough),
        Err(ImageError::Read { .. })
    ));
    assert!(matches!(
        read(&std::env::temp_dir(), &enough),
        Err(ImageError::Read { .. })
    ));
    assert!(matches!(
        decode(b"BM....", Path::new("x.bmp"), &enough),
        Err(ImageError::UnknownFormat { .. })
    ));
    assert!(matches!(
        decode(b"", Path::new("x.exr"), &enough),
        Err(ImageError::UnknownFormat { .. })
    ));
}

/// Small files of every kind that other programs write, too: uncompressed, RLE, PIZ, PXR24, B44, tiles.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let mut files = vec![
        ("own.exr", bytes_of(&rich_layers(37, 33), "exr")),
        ("own.hdr", bytes_of(&rich_layers(37, 33), "hdr")),
        ("flat.hdr", bytes_of(&rich_layers(5, 33), "hdr")),
        ("own.png", bytes_of(&rich_layers(37, 33), "png")),
    ];
    use exr::prelude::*;
    let of = |compression, blocks| {
        let picture = sample_picture(37, 33, 8);
        let color = |at: Vec2<usize>| {
            let [r, g, b] = picture.pixels[at.y() * 37 + at.x()];
            (f16::from_f32(r), g, b)
        };
        let channels = SpecificChannels::rgb(color);
        let encoding = Encoding {
            compression,
            blocks,
            line_order: LineOrder::Increasing,
        };
        let layer = Layer::new((37, 33), LayerAttributes::named("main"), encoding, channels);
        let mut bytes = std::io::Cursor::new(Vec::new());
        Image::from_layer(layer)
            .write()
            .to_buffered(&mut bytes)
            .unwrap();
        bytes.into_inner()
    };
    let (lines, tiles) = (Blocks::ScanLines, Blocks::Tiles(Vec2(16, 8)));
    files.push(("none.exr", of(Compression::Uncompressed, lines)));
    files.push(("rle.exr", of(Compression::RLE, lines)));
    files.push(("zips.exr", of(Compression::ZIP1, lines)));
    files.push(("zip tiles.exr", of(Compression::ZIP16, tiles)));
    files.push(("piz.exr", of(Compression::PIZ, lines)));
    files.push(("piz tiles.exr", of(Compression::PIZ, tiles)));
    files.push(("pxr24.exr", of(Compression::PXR24, lines)));
    files.push(("b44.exr", of(Compression::B44, lines)));
    files.push(("dwaa.exr", of(Compression::DWAA(None), lines)));
    files
}

#[test]
fn every_compression_and_block_form_is_read() {
    let expected = sample_picture(37, 33, 8);
    let refused = samples()
        .into_iter()
        .find(|(n, _)| *n == "dwaa.exr")
        .unwrap();
    let error = decode(&refused.1, Path::new("dwaa.exr"), &Limits::default()).unwrap_err();
    assert!(error.to_string().contains("DWA"), "{error}");
    for (name, bytes) in samples()
        .iter()
        .filter(|(n, _)| n.ends_with("exr") && !n.starts_with("own") && *n != "dwaa.exr")
    {
        let read = decode(bytes, Path::new(name), &Limits::default())
            .unwrap()
            .picture;
        let lossy = ["b44.exr", "pxr24.exr"].contains(name);
        for (e, r) in expected.pixels.iter().zip(&read.pixels) {
            let e = [half::f16::from_f32(e[0]).to_f32(), e[1], e[2]];
            if lossy {
                // B44 loses, PXR24 rounds: only that the values are in the right place is checked.
                let scale = e.iter().fold(0.05f32, |m, &v| m.max(v));
                assert!(
                    (0..3).all(|c| (e[c] - r[c]).abs() < 0.5 * scale),
                    "{name}: {e:?} became {r:?}"
                );
            } else {
                assert_eq!(&e, r, "{name}");
            }
        }
    }
}

#[test]
fn damaged_files_are_errors_or_pictures_and_never_panics() {
    // A long run: OCCLUDE_FUZZ_ROUNDS=100000 cargo test --release -p occlude-image damaged -- --nocapture
    let rounds = std::env::var("OCCLUDE_FUZZ_ROUNDS")
        .ok()
        .and_then(|r| r.parse().ok())
        .unwrap_or(400);
    let mut random = Random(11);
    // What a file of these sizes may reasonably need, many times over.
    let limits = Limits {
        max_bytes: 64 << 20,
    };
    let (mut errors, mut pictures) = (0, 0);
    for (name, bytes) in samples() {
        for round in 0..rounds {
            let mut bad = bytes.clone();
            match round % 4 {
                0 => bad.truncate(random.below(bytes.len())),
                1 => bad.extend((0..random.below(64)).map(|i| i as u8)),
                _ => {}
            }
            // Headers are where lies matter most.
            let reach = if round % 2 == 0 {
                bad.len()
            } else {
                bad.len().min(400)
            };
            for _ in 0..[1, 1, 3, 20][random.below(4)] {
                if reach > 0 {
                    let at = random.below(reach);
                    bad[at] = [random.bits() as u8, 0, 0xff, bad[at] ^ 1 << random.below(8)]
                        [random.below(4)];
                }
            }
            match decode(&bad, Path::new(name), &limits) {
                Ok(opened) => {
                    pictures += 1;
                    let p = opened.picture;
                    assert_eq!(p.pixels.len(), p.width as usize * p.height as usize);
                    assert!(p.pixels.iter().flatten().all(|v| v.is_finite()));
                }
                Err(error) => {
                    errors += 1;
                    let text = error.to_string();
                    assert!(!text.contains('\n') && text.len() < 400, "{text}");
                }
            }
        }
    }
    assert!(
        errors > 1000 && pictures > 300,
        "{errors} errors, {pictures} pictures: the damage is not varied"
    );
    println!("{errors} errors, {pictures} pictures");
}

#[test]
fn every_truncation_of_a_small_file_is_an_error() {
    for (name, bytes) in samples() {
        for length in 0..bytes.len() {
            let cut = decode(&bytes[..length], Path::new(name), &Limits::default());
            // The last bytes of a PNG say only that it ends.
            assert!(
                cut.is_err() || (name.ends_with("png") && length + 16 > bytes.len()),
                "{name} cut to {length}"
            );
        }
    }
}
