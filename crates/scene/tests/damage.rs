//! Damaged files: flipped bytes, cut ends, stretched numbers. Anything may be refused; nothing may panic, and nothing may
//! allocate much more than the file holds.

mod common;

use common::{Document, U8};
use occlude_scene::{Pose, Scene};
use occlude_testkit::random::Random;
use serde_json::json;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts bytes in use and the most there ever were.
struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system allocator unchanged; only counters are kept beside it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(now, Ordering::Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A document that uses everything that has an index or a length.
fn everything() -> Document {
    let mut d = Document::new();
    let position = d.floats(&[
        [0.0f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 1.0, 0.0],
    ]);
    let normal = d.floats(&[[0.0f32, 0.0, 1.0]; 4]);
    let uv = d.floats(&[[0.0f32, 1.0], [1.0, 1.0], [0.0, 0.0], [1.0, 0.0]]);
    let joints = d.accessor(
        &[0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0],
        U8,
        "VEC4",
        4,
    );
    let weights = d.floats(&[[0.5f32, 0.5, 0.0, 0.0]; 4]);
    let indices = d.indices(&[0, 1, 2, 2, 1, 3]);
    let up = d.floats(&[[0.0f32, 0.0, 1.0]; 4]);
    let sparse_indices = d.view(&[1, 3]);
    let sparse_values = d.view(&[0; 24]);
    d.json["accessors"][up]["sparse"] = json!({"count": 2,
        "indices": {"bufferView": sparse_indices, "componentType": U8}, "values": {"bufferView": sparse_values}});
    let mut picture = std::io::Cursor::new(Vec::new());
    let pixels = image::RgbaImage::from_fn(8, 8, |x, y| image::Rgba([x as u8, y as u8, 9, 200]));
    pixels
        .write_to(&mut picture, image::ImageFormat::Png)
        .unwrap();
    let view = d.view(picture.get_ref());
    d.push("images", json!({"bufferView": view}));
    d.push("samplers", json!({"wrapS": 33071}));
    d.push("textures", json!({"source": 0, "sampler": 0}));
    d.push("materials", json!({"normalTexture": {"index": 0}, "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    let attributes = json!({"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv, "JOINTS_0": joints, "WEIGHTS_0": weights});
    let mesh = d.mesh(json!({"attributes": attributes, "indices": indices, "material": 0, "targets": [{"POSITION": up}]}));
    let strip = d.mesh(json!({"attributes": {"POSITION": position}, "mode": 5, "material": 0}));
    let joint = d.push("nodes", json!({"translation": [0, 1, 0]}));
    let root = d.node(json!({"children": [joint], "scale": [1, 2, 1]}));
    d.node(json!({"mesh": mesh, "skin": 0, "weights": [0.5]}));
    let translation = d.floats(&[[1.0f32, 0.0, 0.0], [0.0, 2.0, 0.0]]);
    d.node(
        json!({"mesh": strip, "camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0},
        "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": translation}}}}),
    );
    d.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "spot"}]}});
    d.push("cameras", json!({"perspective": {"yfov": 0.5}}));
    let identity = [
        1.0f32, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
    ];
    let matrices = d.floats(&[identity; 2]);
    d.push(
        "skins",
        json!({"joints": [root, joint], "inverseBindMatrices": matrices}),
    );
    let input = d.floats(&[[0.0f32], [1.0]]);
    let output = d.floats(&[[0.0f32, 0.0, 0.0, 1.0]; 6]);
    d.push(
        "animations",
        json!({"channels": [{"sampler": 0, "target": {"node": joint, "path": "rotation"}}],
        "samplers": [{"input": input, "output": output, "interpolation": "CUBICSPLINE"}]}),
    );
    d
}

/// The same bytes behind a meshopt-compressed view.
fn compressed() -> Document {
    let mut d = Document::new();
    let vertices: Vec<[u8; 12]> = (0..300u32)
        .map(|i| {
            let p = [i as f32, (i % 7) as f32, 0.0].map(f32::to_le_bytes);
            std::array::from_fn(|k| p[k / 4][k % 4])
        })
        .collect();
    let bound = meshopt_rs::vertex::buffer::encode_vertex_buffer_bound(vertices.len(), 12);
    let mut bytes = vec![0; bound];
    let version = meshopt_rs::vertex::VertexEncodingVersion::V0;
    let length =
        meshopt_rs::vertex::buffer::encode_vertex_buffer(&mut bytes, &vertices, version).unwrap();
    let indices: Vec<u32> = (0..298).flat_map(|i| [i, i + 1, i + 2]).collect();
    let bound = meshopt_rs::index::buffer::encode_index_buffer_bound(indices.len(), vertices.len());
    let mut codes = vec![0; bound];
    let version = meshopt_rs::index::IndexEncodingVersion::V1;
    let codes_length =
        meshopt_rs::index::buffer::encode_index_buffer(&mut codes, &indices, version).unwrap();
    let mut view = |bytes: &[u8], stride: usize, count: usize, mode: &str| {
        let view = d.view(bytes);
        let entry = &mut d.json["bufferViews"][view];
        let offset = entry["byteOffset"].clone();
        entry["extensions"] = json!({"EXT_meshopt_compression": {"buffer": 0, "byteOffset": offset,
            "byteLength": bytes.len(), "byteStride": stride, "count": count, "mode": mode}});
        entry["byteLength"] = (stride * count).into();
        view
    };
    let vertex_view = view(&bytes[..length], 12, vertices.len(), "ATTRIBUTES");
    let index_view = view(&codes[..codes_length], 4, indices.len(), "TRIANGLES");
    let position = d.push(
        "accessors",
        json!({"bufferView": vertex_view, "componentType": 5126, "type": "VEC3", "count": 300}),
    );
    let index = d.push("accessors", json!({"bufferView": index_view, "componentType": 5125, "type": "SCALAR", "count": indices.len()}));
    let mesh = d.mesh(json!({"attributes": {"POSITION": position}, "indices": index}));
    d.node(json!({"mesh": mesh}));
    d
}

fn damage(bytes: &mut Vec<u8>, random: &mut Random) {
    match random.below(10) {
        0..6 => {
            let at = random.below(bytes.len());
            bytes[at] = random.below(256) as u8;
        }
        6 => bytes.truncate(random.below(bytes.len())),
        7 if bytes.len() > 40 => {
            // A whole word, as counts and lengths are.
            let at = random.below(bytes.len() - 4);
            let word = [u32::MAX, 0x7fff_ffff, 0, 1 << 24][random.below(4)];
            bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        }
        _ => stretch_number(bytes, random),
    }
}

/// Replaces a number of the JSON text by an absurd one, chunk lengths set right again.
fn stretch_number(bytes: &mut Vec<u8>, random: &mut Random) {
    let start = random.below(bytes.len());
    let Some(first) = bytes[start..]
        .iter()
        .position(u8::is_ascii_digit)
        .map(|p| p + start)
    else {
        return;
    };
    let length = bytes[first..]
        .iter()
        .take_while(|b| b.is_ascii_digit())
        .count();
    let absurd = [
        "4294967295",
        "-1",
        "1e30",
        "99999999999999999999",
        "0",
        "1000000",
        "3",
    ];
    let absurd = absurd[random.below(absurd.len())].as_bytes();
    let grown = absurd.len() as i64 - length as i64;
    bytes.splice(first..first + length, absurd.iter().copied());
    if bytes.starts_with(b"glTF") && bytes.len() > 16 {
        let text = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]);
        let text = (i64::from(text) + grown).clamp(0, i64::from(u32::MAX)) as u32;
        bytes[12..16].copy_from_slice(&text.to_le_bytes());
    }
}

/// Loads damaged copies; gives how many still loaded.
fn survive(whole: &[u8], cases: usize, seed: u64, most_bytes: usize) -> usize {
    let mut loaded = 0;
    for case in 0..cases {
        let mut random = Random(seed + case as u64 * 7919);
        let mut bytes = whole.to_vec();
        for _ in 0..[1, 1, 3, 30][random.below(4)] {
            damage(&mut bytes, &mut random);
            if bytes.is_empty() {
                break;
            }
        }
        let file = common::Temporary::new(&bytes, "glb");
        MOST.store(NOW.load(Ordering::Relaxed), Ordering::Relaxed);
        let before = NOW.load(Ordering::Relaxed);
        match Scene::load(&file.0, None, None) {
            Ok(scene) => {
                loaded += 1;
                let pose = Pose::at(&scene, 0.5);
                scene.bounds(&pose);
            }
            Err(error) => {
                let text = error.to_string();
                assert!(
                    !text.contains('\n') && text.len() < 400,
                    "case {case}: {text}"
                );
            }
        }
        let peak = MOST.load(Ordering::Relaxed).saturating_sub(before);
        assert!(
            peak < most_bytes,
            "case {case}: {peak} bytes for a file of {}",
            bytes.len()
        );
    }
    loaded
}

// One test function: the counters are common to the whole program.
#[test]
fn damaged_files_do_no_harm() {
    let whole = everything();
    assert_eq!(whole.load().unwrap().warnings, []);
    let loaded = survive(&whole.glb(), 4000, 1, 8 << 20);
    assert!(
        loaded > 400 && loaded < 3600,
        "{loaded} of 4000 loaded: the damage is too great or too small"
    );

    let whole = compressed();
    assert_eq!(whole.load().unwrap().instanced_triangles(), 298);
    let loaded = survive(&whole.glb(), 2000, 2, 8 << 20);
    assert!(loaded > 100 && loaded < 1900, "{loaded} of 2000 loaded");

    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/scenes");
    let folder = std::env::var_os("OCCLUDE_SCENES").unwrap_or(default.into());
    let file = std::path::Path::new(&folder).join("conformance/CesiumMilkTruck_draco.glb");
    match std::fs::read(&file) {
        Ok(bytes) => {
            survive(&bytes, 60, 3, 256 << 20);
        }
        Err(_) => eprintln!("SKIPPED: no {}", file.display()),
    }
}
