//! A second UV set for light maps: everything else stays as it was, whatever the file is made of.
//!
//! Public files lie outside of this repository; without them the tests say so and pass.

use glam::{Vec2, vec2};
use occlude_scene::{LitNode, Pose, Scene, Unfolding, WrittenNode, write_lit_glb};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Every triangle has a place of its own.
fn uv(t: u32) -> [Vec2; 3] {
    let low = vec2((t % 256) as f32, (t / 256) as f32) / 256.0;
    [low, low + vec2(0.003, 0.0), low + vec2(0.0, 0.003)]
}

/// Writes a scene with a UV set for everything in it.
fn lit(scene: &Scene, out: &Path) -> Vec<WrittenNode> {
    let unfoldings: Vec<Unfolding> = (0..scene.meshes.len() as u32)
        .map(|mesh| Unfolding {
            mesh,
            uv: Box::new(|t| Some(uv(t))),
        })
        .collect();
    let mut places: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut nodes: BTreeMap<(u32, u32), LitNode> = BTreeMap::new();
    for instance in &scene.instances {
        let place = places.entry((instance.node, instance.mesh)).or_default();
        let node = nodes
            .entry((instance.node, *place))
            .or_insert_with(|| LitNode {
                node: instance.node,
                occurrence: *place,
                unfoldings: Vec::new(),
                rectangle: [0.0, 1.0, 1.0, 0.0, 0.0],
                extras: json!({"page": 0}),
            });
        node.unfoldings.push(instance.mesh);
        *place += 1;
    }
    let nodes: Vec<LitNode> = nodes.into_values().collect();
    let mut file = std::io::BufWriter::new(std::fs::File::create(out).unwrap());
    write_lit_glb(scene, &unfoldings, &nodes, &mut file).unwrap()
}

fn scenes() -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/scenes");
    let folder =
        std::env::var_os("OCCLUDE_SCENES").map_or_else(|| PathBuf::from(default), PathBuf::from);
    if folder.join("conformance").is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no test scenes in {}", folder.display());
    None
}

fn out(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("occlude-lit-{}-{name}.glb", std::process::id()))
}

/// What a triangle's corners are, seen from outside.
fn corners<T: Copy>(values: &[T], triangle: [u32; 3]) -> Option<[T; 3]> {
    (!values.is_empty()).then(|| triangle.map(|i| values[i as usize]))
}

/// The same triangles with the same attributes, at rest and in motion; the new UVs on each.
fn same(name: &str, old: &Scene, new: &Scene) {
    assert_eq!(old.instances.len(), new.instances.len(), "{name}");
    assert_eq!(old.textures, new.textures, "{name}");
    assert_eq!(old.cameras, new.cameras, "{name}");
    assert_eq!(old.lights, new.lights, "{name}");
    assert_eq!(old.contents.animations, new.contents.animations, "{name}");
    for time in [0.0, 0.37] {
        let (was, is) = (Pose::at(old, time), Pose::at(new, time));
        for i in 0..old.instances.len() {
            let (a, b) = (
                &old.meshes[was.instances[i].mesh as usize],
                &new.meshes[is.instances[i].mesh as usize],
            );
            assert_eq!(
                was.instances[i].world_from_object, is.instances[i].world_from_object,
                "{name}"
            );
            assert_eq!(a.triangles.len(), b.triangles.len(), "{name}: {}", a.name);
            for (t, (x, y)) in a.triangles.iter().zip(&b.triangles).enumerate() {
                let (p, q) = (was.positions(old, i), is.positions(new, i));
                assert_eq!(
                    corners(p, *x),
                    corners(q, *y),
                    "{name}: {} at {time} s",
                    a.name
                );
                assert_eq!(
                    corners(was.normals(old, i), *x),
                    corners(is.normals(new, i), *y),
                    "{name}: {}",
                    a.name
                );
                assert_eq!(
                    corners(&a.uv0, *x),
                    corners(&b.uv0, *y),
                    "{name}: {}",
                    a.name
                );
                assert_eq!(
                    corners(&a.colors, *x),
                    corners(&b.colors, *y),
                    "{name}: {}",
                    a.name
                );
                assert_eq!(
                    corners(&b.uv1, *y),
                    Some(uv(t as u32)),
                    "{name}: {}",
                    a.name
                );
            }
        }
    }
}

#[test]
fn every_public_file_keeps_what_it_has() {
    let Some(folder) = scenes() else { return };
    let mut files = Vec::new();
    for sub in ["conformance", "animated"] {
        files.extend(
            std::fs::read_dir(folder.join(sub))
                .unwrap()
                .map(|f| f.unwrap().path()),
        );
    }
    files.push(folder.join("apartment.glb"));
    files.sort();
    let mut tried = 0;
    for path in files {
        let extension = path
            .extension()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if extension != "gltf" && extension != "glb" {
            continue;
        }
        let scene = Scene::load(&path, None, None).unwrap();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let target = out(&name);
        lit(&scene, &target);
        let chosen = scene.contents.scene.to_string();
        let new = Scene::load(
            &target,
            (!scene.contents.scenes.is_empty()).then_some(chosen.as_str()),
            None,
        )
        .unwrap();
        // A texture of the second set was moved to a third, which the loader does not read.
        let moved = scene.meshes.iter().any(|m| !m.uv1.is_empty());
        if !moved {
            assert_eq!(scene.materials, new.materials, "{name}");
        }
        same(&name, &scene, &new);
        std::fs::remove_file(target).unwrap();
        tried += 1;
    }
    assert!(tried > 30, "{tried} files");
}

/// A quad with attributes, extras and an extension of the user's own, read from a data URI.
fn custom() -> (Value, Vec<u8>) {
    let mut bytes: Vec<u8> = Vec::new();
    for x in [
        0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0,
    ] {
        bytes.extend(x.to_le_bytes());
    }
    for i in [0_u16, 1, 2, 0, 2, 3] {
        bytes.extend(i.to_le_bytes());
    }
    // A byte triple for each vertex: 4 bytes apart in the file, as vertex data must be.
    for v in 0..4_u8 {
        bytes.extend([10 * v, 10 * v + 1, 10 * v + 2, 0]);
    }
    for uv in [0.0_f32, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0] {
        bytes.extend(uv.to_le_bytes());
    }
    let document = json!({
        "asset": {"version": "2.0", "copyright": "somebody"},
        "extensionsUsed": ["VENDOR_thing"],
        "extensions": {"VENDOR_thing": {"kept": true}},
        "scene": 0,
        "scenes": [{"nodes": [0, 1], "extras": {"mood": "calm"}}],
        "nodes": [
            {"mesh": 0, "name": "one", "extras": {"tag": 7, "texelsPerMetre": 3.5}},
            {"mesh": 0, "name": "two", "translation": [2, 0, 0], "extras": "words"},
        ],
        "meshes": [{"name": "quad", "extras": {"made by": "hand"}, "primitives": [{
            "attributes": {"POSITION": 0, "_TEMPERATURE": 2, "TEXCOORD_0": 3, "TEXCOORD_1": 3},
            "indices": 1, "material": 0, "extras": {"p": 1},
        }]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}, "extras": {"texCoord": 1}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5121, "count": 4, "type": "VEC3", "normalized": true},
            {"bufferView": 3, "componentType": 5126, "count": 4, "type": "VEC2"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12},
            {"buffer": 0, "byteOffset": 60, "byteLength": 16, "byteStride": 4}, {"buffer": 0, "byteOffset": 76, "byteLength": 32},
        ],
        "buffers": [{"byteLength": 108, "uri": "quad.bin"}],
    });
    (document, bytes)
}

fn read_json(path: &Path) -> (Value, Vec<u8>) {
    let bytes = std::fs::read(path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (
        serde_json::from_slice(&bytes[20..20 + length]).unwrap(),
        bytes[28 + length..].to_vec(),
    )
}

#[test]
fn what_the_loader_does_not_know_survives() {
    let folder = std::env::temp_dir().join(format!("occlude-lit-custom-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for vendor in [true, false] {
        let (mut document, binary) = custom();
        if !vendor {
            document.as_object_mut().unwrap().remove("extensionsUsed");
            document.as_object_mut().unwrap().remove("extensions");
        }
        std::fs::write(folder.join("quad.bin"), &binary).unwrap();
        std::fs::write(folder.join("quad.gltf"), document.to_string()).unwrap();
        let scene = Scene::load(&folder.join("quad.gltf"), None, None).unwrap();
        assert_eq!(scene.texel_densities, [(0, 3.5)]);
        let target = folder.join("lit.glb");
        let written = lit(&scene, &target);
        assert_eq!(written.iter().map(|w| w.node).collect::<Vec<_>>(), [0, 1]);
        let (new, bytes) = read_json(&target);

        assert_eq!(new["asset"], document["asset"]);
        assert_eq!(new["extensions"], document["extensions"]);
        assert_eq!(new["scenes"], document["scenes"]);
        assert_eq!(
            new["nodes"][0]["extras"],
            json!({"tag": 7, "texelsPerMetre": 3.5, "lightmap": {"page": 0}})
        );
        assert_eq!(
            new["nodes"][1]["extras"],
            json!({"extras": "words", "lightmap": {"page": 0}})
        );
        let mesh = &new["meshes"][new["nodes"][0]["mesh"].as_u64().unwrap() as usize];
        assert_eq!(mesh["extras"], json!({"made by": "hand"}));
        let primitive = &mesh["primitives"][0];
        assert_eq!(primitive["extras"], json!({"p": 1}));
        // The old second set is the third now, and the material reads it there; its own extras are left alone.
        let attributes = primitive["attributes"].as_object().unwrap();
        assert_eq!(
            attributes.keys().collect::<Vec<_>>(),
            [
                "POSITION",
                "TEXCOORD_0",
                "TEXCOORD_1",
                "TEXCOORD_2",
                "_TEMPERATURE"
            ]
        );
        let material = &new["materials"][primitive["material"].as_u64().unwrap() as usize];
        assert_eq!(
            material["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"],
            2
        );
        assert_eq!(material["extras"]["texCoord"], 1);
        assert!(
            new["images"][0].get("uri").is_none() && new["images"][0]["mimeType"] == "image/png"
        );
        assert!(new["buffers"][0].get("uri").is_none());

        // Bytes of the user's attribute, corner by corner.
        let elements = |accessor: &Value, size: usize| -> Vec<Vec<u8>> {
            let a = &new["accessors"][accessor.as_u64().unwrap() as usize];
            let v = &new["bufferViews"][a["bufferView"].as_u64().unwrap() as usize];
            let start = v["byteOffset"].as_u64().unwrap_or(0) as usize;
            let stride = v["byteStride"].as_u64().unwrap_or(size as u64) as usize;
            (0..a["count"].as_u64().unwrap() as usize)
                .map(|i| bytes[start + i * stride..][..size].to_vec())
                .collect()
        };
        let index = elements(&primitive["indices"], 2);
        let temperature = elements(&attributes["_TEMPERATURE"], 3);
        assert_eq!(
            new["accessors"][attributes["_TEMPERATURE"].as_u64().unwrap() as usize]["normalized"],
            true
        );
        let corner = |k: usize| {
            temperature[usize::from(u16::from_le_bytes([index[k][0], index[k][1]]))].clone()
        };
        let first: Vec<u8> = (0..6).map(|k| corner(k)[0]).collect();
        assert_eq!(first, [0, 10, 20, 0, 20, 30]);
        // Without a vendor's references, what is replaced is gone; with them everything keeps its number.
        let meshes = new["meshes"].as_array().unwrap().len();
        assert_eq!(meshes, if vendor { 2 } else { 1 });
    }
    std::fs::remove_dir_all(folder).unwrap();
}
