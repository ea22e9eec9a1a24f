//! A corpus fuzzer that runs on stable Rust: damaged copies of small files of every format that we read must give an
//! error or a scene, without a panic, a hang or an allocation that the file's size does not justify.
//!
//! The normal run takes seconds and is seeded. `OCCLUDE_FUZZ=1000000` sets the number of cases, `OCCLUDE_FUZZ_SEED` the
//! seed, `OCCLUDE_FUZZ_SEEDS=DIR` adds files of at most 64 KiB from a folder. A case that fails is kept, and named.

use base64::Engine;
use glam::{Affine3A, Mat4, Vec3, Vec4};
use occlude_image::{Depth, Layers, Picture};
use occlude_scene::procedural::{self, Name};
use occlude_scene::{
    AlphaMode, Instance, MorphTarget, NormalMap, Pose, Scene, Skin, Skinning, Volume, write_glb,
};
use occlude_testkit::random::Random;
use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Counts bytes in use.
struct Counting;

static USED: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn grow(bytes: usize) {
    PEAK.fetch_max(USED.fetch_add(bytes, Relaxed) + bytes, Relaxed);
}

// SAFETY: every call is handed on to the system's allocator unchanged; the counters touch no memory of the caller.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        USED.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        grow(size);
        USED.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// No damaged file of a few kilobytes may take more.
const MOST_BYTES: usize = 256 << 20;
const LONGEST: Duration = Duration::from_secs(10);

/// A file to damage, and its kind.
struct Seed {
    extension: String,
    bytes: Vec<u8>,
}

fn glb(scene: &Scene) -> Vec<u8> {
    let mut out = Vec::new();
    write_glb(scene, &mut out).unwrap();
    out
}

/// A scene that uses every feature of the writer.
fn rich() -> Scene {
    let mut scene = procedural::build(Name::Cornell, None, 0);
    let texture = {
        let mut b = procedural::build(Name::Courtyard, Some(20_000), 0);
        let mut image = b.images.swap_remove(0);
        image.width = 8;
        image.height = 8;
        image.texels =
            occlude_scene::Texels::Rgba8((0..64).map(|i| [i, 255 - i, 9, i * 4]).collect());
        scene.images.push(image);
        scene.textures.push(occlude_scene::Texture {
            image: 0,
            ..b.textures[0]
        });
        occlude_scene::TextureRef {
            texture: 0,
            uv_set: 0,
            transform: glam::Affine2::from_scale_angle_translation(
                glam::Vec2::new(2.0, 3.0),
                0.5,
                glam::Vec2::ONE,
            ),
        }
    };
    let m = &mut scene.materials[0];
    m.base_color_texture = Some(texture);
    m.normal = Some(NormalMap {
        texture,
        scale: 0.5,
    });
    m.alpha_mode = AlphaMode::Mask { cutoff: 0.3 };
    m.clearcoat = 0.5;
    m.sheen_color = Vec3::ONE;
    m.transmission = 0.5;
    m.volume = Some(Volume {
        thickness: 1.0,
        attenuation_distance: 2.0,
        attenuation_color: Vec3::ONE,
    });
    let mesh = &mut scene.meshes[0];
    let n = mesh.positions.len();
    mesh.uv0 = vec![glam::Vec2::splat(0.25); n];
    mesh.colors = vec![Vec4::ONE; n];
    mesh.morph_targets = vec![MorphTarget {
        positions: vec![Vec3::X; n],
        ..MorphTarget::default()
    }];
    let skinned = &mut scene.meshes[1];
    let n = skinned.positions.len();
    skinned.skinning = Some(Skinning {
        joints: vec![[0, 1, 0, 0]; n],
        weights: vec![Vec4::new(0.5, 0.5, 0.0, 0.0); n],
    });
    scene.skins.push(Skin {
        joints: vec![0, 1],
        joint_from_object: vec![Mat4::IDENTITY; 2],
    });
    scene.instances[1].skin = Some(0);
    for k in 0..4 {
        scene.instances.push(Instance {
            mesh: 3,
            node: 3,
            node_from_object: Affine3A::from_translation(Vec3::splat(k as f32)),
            skin: None,
        });
    }
    scene
}

/// A `.gltf` with data URIs of a GLB.
fn as_gltf(glb: &[u8]) -> Vec<u8> {
    let json = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let text = std::str::from_utf8(&glb[20..20 + json]).unwrap();
    let data = base64::engine::general_purpose::STANDARD.encode(&glb[28 + json..]);
    let uri = format!("\"buffers\":[{{\"uri\":\"data:application/octet-stream;base64,{data}\",");
    text.trim_end()
        .replacen("\"buffers\":[{", &uri, 1)
        .into_bytes()
}

const OBJ: &str = "mtllib a.mtl\no first object\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 1.6 0\nvt 0 0\nvt 1 0 0\n\
vt 1 1\nvn 0 0 1\nusemtl mat a\nf 1/1/1 2/2/1 \\\n 3/3/1 4/1/1\r\ns off\rf 4 3 5\ng grp\nusemtl b\nf -3//1 -2//1 -1//1\n\
l 1 2\nf 1 2 3 4 5\nf 5 4 3 2 1 3 4\n";
const MTL: &str = "newmtl mat a\nKd 0.8 0.2 0.2\nKe 2 2 2\nmap_Kd -s 2 2 1 -o 0.5 0 0 -clamp on a.png\nbump -bm 3 a.png\n\
map_d a.png\nnewmtl b\nKd 0.2 0.2 0.8\nKs 0.5 0.5 0.5\nNs 80\nd 0.5\nTr 0.5\nillum 7\nNi 1.5\nTf 0.5 1 1\nPr 0.2\nPm 1\n";

/// The files to damage, our own sound ones first, and how many those are.
fn seeds() -> (Vec<Seed>, usize) {
    let rich = glb(&rich());
    let plain = glb(&procedural::build(Name::Furnace, None, 0));
    let mut all = vec![
        Seed {
            extension: "gltf".into(),
            bytes: as_gltf(&rich),
        },
        Seed {
            extension: "glb".into(),
            bytes: rich,
        },
        Seed {
            extension: "gltf".into(),
            bytes: as_gltf(&plain),
        },
        Seed {
            extension: "glb".into(),
            bytes: plain,
        },
        Seed {
            extension: "obj".into(),
            bytes: OBJ.into(),
        },
        Seed {
            extension: "mtl".into(),
            bytes: MTL.into(),
        },
        Seed {
            extension: "png".into(),
            bytes: png(),
        },
    ];
    let picture = Picture::from_pixels(
        16,
        8,
        (0..128)
            .map(|i| {
                [
                    i as f32 / 9.0,
                    (i % 7) as f32,
                    if i < 64 { 0.5 } else { 1e4 },
                ]
            })
            .collect(),
    )
    .unwrap();
    let folder = scratch();
    for name in ["seed.hdr", "seed.exr"] {
        let path = folder.join(name);
        if name.ends_with("exr") {
            let mut layers = Layers::from_picture(&picture, Depth::Half);
            layers.push("depth.Z", Depth::Float, vec![1.5; 128]);
            occlude_image::write_layers(&path, &layers, occlude_image::Look::default()).unwrap();
        } else {
            occlude_image::write(&path, &picture, occlude_image::Look::default()).unwrap();
        }
        all.push(Seed {
            extension: name[5..].into(),
            bytes: std::fs::read(&path).unwrap(),
        });
        std::fs::remove_file(path).unwrap();
    }
    let own = all.len();
    if let Some(folder) = std::env::var_os("OCCLUDE_FUZZ_SEEDS") {
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        for path in files {
            let extension = path
                .extension()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let known =
                ["gltf", "glb", "obj", "mtl", "hdr", "exr", "png"].contains(&extension.as_str());
            if known && std::fs::metadata(&path).is_ok_and(|m| m.is_file() && m.len() <= 65_536) {
                all.push(Seed {
                    extension,
                    bytes: std::fs::read(path).unwrap(),
                });
            }
        }
    }
    (all, own)
}

fn png() -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_fn(5, 3, |x, y| {
        image::Rgba([x as u8 * 50, y as u8 * 80, 7, 200])
    })
    .write_to(&mut out, image::ImageFormat::Png)
    .unwrap();
    out.into_inner()
}

/// Numbers that break things.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "1",
    "3",
    "255",
    "65535",
    "65536",
    "2147483648",
    "4294967295",
    "4294967296",
    "99999999999999999999",
    "1e30",
    "-1e39",
    "0.5",
];

fn mutate(rng: &mut Random, seeds: &[Seed], which: usize) -> Vec<u8> {
    let mut b = seeds[which].bytes.clone();
    let times = [1, 1, 2, 4, 24][rng.below(5)];
    for _ in 0..times {
        if b.is_empty() {
            b.push(b' ');
        }
        let at = rng.below(b.len());
        match rng.below(12) {
            0..=2 => b[at] ^= 1 << rng.below(8),
            3 => b[at] = rng.bits() as u8,
            4 => {
                let value =
                    [0, u32::MAX, 1 << 31, 0x7fff_ffff, 0x7f80_0000, 0xffc0_0000][rng.below(6)];
                let end = (at + 4).min(b.len());
                b[at..end].copy_from_slice(&u32::to_le_bytes(value)[..end - at]);
            }
            5 => b.truncate(at),
            // A number becomes another.
            6..=8 => {
                let digit = |c: &u8| c.is_ascii_digit();
                if let Some(start) = b[at..].iter().position(digit).map(|i| at + i) {
                    let end = b[start..]
                        .iter()
                        .position(|c| !digit(c))
                        .map_or(b.len(), |i| start + i);
                    b.splice(start..end, NUMBERS[rng.below(NUMBERS.len())].bytes());
                }
            }
            // A piece goes missing, comes twice, or comes from another file.
            9 => {
                let end = (at + 1 + rng.below(64)).min(b.len());
                b.drain(at..end);
            }
            10 => {
                let end = (at + 1 + rng.below(256)).min(b.len());
                let piece = b[at..end].to_vec();
                let to = rng.below(b.len());
                b.splice(to..to, piece);
            }
            _ => {
                let other = &seeds[rng.below(seeds.len())].bytes;
                let from = rng.below(other.len());
                let end = (from + 1 + rng.below(256)).min(other.len());
                let stop = (at + rng.below(64)).min(b.len());
                b.splice(at..stop, other[from..end].iter().copied());
            }
        }
    }
    // Half of the damaged GLB files get sound lengths again, so that the damage reaches what is inside.
    if seeds[which].extension == "glb" && b.len() > 20 && rng.below(2) == 0 {
        let total = b.len() as u32;
        b[8..12].copy_from_slice(&total.to_le_bytes());
    }
    b
}

/// A folder of our own, in memory where there is one.
fn scratch() -> PathBuf {
    let shm = Path::new("/dev/shm");
    let root = if shm.is_dir() {
        shm.to_path_buf()
    } else {
        std::env::temp_dir()
    };
    let folder = root.join(format!("occlude-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Loads a damaged file the way the program does; returns whether it was accepted.
fn load(folder: &Path, extension: &str, bytes: &[u8], limit: Option<u64>) -> bool {
    let path = match extension {
        "hdr" | "exr" => {
            let limits = occlude_image::Limits::default();
            let path = folder.join(format!("a.{extension}"));
            return occlude_image::decode(bytes, &path, &limits).is_ok();
        }
        "mtl" | "png" => {
            std::fs::write(folder.join(format!("a.{extension}")), bytes).unwrap();
            folder.join("a.obj")
        }
        _ => {
            let path = folder.join(format!("case.{extension}"));
            std::fs::write(&path, bytes).unwrap();
            path
        }
    };
    let Ok(scene) = Scene::load(&path, None, limit) else {
        return false;
    };
    let scene = scene
        .validate()
        .expect("a loader made a scene with a stray index");
    let pose = Pose::at(&scene, 0.7);
    for i in 0..pose.instances.len() {
        assert!(
            pose.positions(&scene, i).len()
                == scene.meshes[pose.instances[i].mesh as usize]
                    .positions
                    .len()
        );
    }
    for texture in &scene.textures {
        assert!(texture.sample(&scene.images, [0.3, f32::NAN]).is_finite());
    }
    true
}

#[test]
fn damaged_files() {
    let cases: u64 = std::env::var("OCCLUDE_FUZZ").map_or(3000, |n| n.parse().unwrap());
    let first: u64 = std::env::var("OCCLUDE_FUZZ_SEED").map_or(1, |n| n.parse().unwrap());
    let folder = scratch();
    let (seeds, own) = seeds();
    let restore = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
    restore("a.obj", OBJ.as_bytes());
    restore("a.mtl", MTL.as_bytes());
    restore("a.png", &png());
    for seed in &seeds[..own] {
        assert!(
            load(&folder, &seed.extension, &seed.bytes, None),
            "a sound {} is refused",
            seed.extension
        );
    }
    // A hang cannot be caught from inside: a second thread ends the test and says where.
    static NOW: Mutex<Option<(u64, Instant)>> = Mutex::new(None);
    std::thread::spawn(|| {
        loop {
            std::thread::sleep(Duration::from_secs(1));
            if let Some((case, since)) = *NOW.lock().unwrap()
                && since.elapsed() > 3 * LONGEST
            {
                eprintln!("case {case} hangs: OCCLUDE_FUZZ_SEED={case} OCCLUDE_FUZZ=1 repeats it");
                std::process::abort();
            }
        }
    });
    std::panic::set_hook(Box::new(|_| {}));
    let (mut accepted, mut failures) = (0u64, Vec::new());
    let (mut worst_time, mut worst_bytes) = (Duration::ZERO, 0);
    let start = Instant::now();
    for case in first..first + cases {
        let mut rng = Random(case.wrapping_mul(0xd6e8_feb8_6659_fd93));
        let which = rng.below(seeds.len());
        let extension = &seeds[which].extension;
        let bytes = mutate(&mut rng, &seeds, which);
        let limit = (rng.below(2) == 0).then_some(64 << 20);
        let before = USED.load(Relaxed);
        PEAK.store(before, Relaxed);
        let since = Instant::now();
        *NOW.lock().unwrap() = Some((case, since));
        let outcome = std::panic::catch_unwind(|| load(&folder, extension, &bytes, limit));
        let (time, peak) = (since.elapsed(), PEAK.load(Relaxed).saturating_sub(before));
        if extension == "mtl" {
            restore("a.mtl", MTL.as_bytes());
        } else if extension == "png" {
            restore("a.png", &png());
        }
        worst_time = worst_time.max(time);
        worst_bytes = worst_bytes.max(peak);
        let fault = match outcome {
            Err(payload) => {
                let text = payload.downcast_ref::<String>().cloned();
                let text = text.or(payload.downcast_ref::<&str>().map(|s| s.to_string()));
                Some(format!("panic: {}", text.unwrap_or_default()))
            }
            Ok(_) if peak > MOST_BYTES => Some(format!("{} MiB allocated", peak >> 20)),
            Ok(_) if time > LONGEST => Some(format!("{time:?}")),
            Ok(ok) => {
                accepted += u64::from(ok);
                None
            }
        };
        if let Some(fault) = fault {
            let kept =
                Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{case}.{extension}"));
            std::fs::write(&kept, &bytes).unwrap();
            failures.push(format!("case {case} ({}): {fault}", kept.display()));
            if failures.len() >= 20 {
                break;
            }
        }
    }
    *NOW.lock().unwrap() = None;
    let _ = std::panic::take_hook();
    std::fs::remove_dir_all(&folder).unwrap();
    eprintln!(
        "{cases} cases from {} files in {:.1} s: {accepted} accepted, {} failed; at most {:.0} ms and {:.1} MiB a case",
        seeds.len(),
        start.elapsed().as_secs_f64(),
        failures.len(),
        worst_time.as_secs_f64() * 1e3,
        worst_bytes as f64 / f64::from(1 << 20),
    );
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    // Damage that nothing survives, or that changes nothing, would test nothing.
    assert!(
        accepted * 50 > cases && accepted * 50 < cases * 49,
        "{accepted} of {cases} accepted"
    );
}
