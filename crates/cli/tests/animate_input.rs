//! `occlude animate` on animations and skies that are not what they should be.

mod util;

use occlude_image::{Look, Picture};
use serde_json::{Value, json};
use util::Dir;

const FEW: &str = "--size 32x24 --cache off --threads 2 --quiet";

/// A file of numbers, and where each array lies in it.
#[derive(Default)]
struct Numbers {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Numbers {
    fn push(&mut self, bytes: &[u8], count: usize, component: u32, shape: &str) -> usize {
        let (offset, view) = (self.bytes.len(), self.views.len());
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views
            .push(json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}));
        let mut accessor =
            json!({"bufferView": view, "componentType": component, "count": count, "type": shape});
        if shape == "SCALAR" && component == 5126 {
            accessor["min"] = json!([0.0]);
            accessor["max"] = json!([1.0]);
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let shape = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][N];
        self.push(&bytes, values.len(), 5126, shape)
    }
}

/// A square that a node moves, written as `name` after `change` has changed the document.
fn write(dir: &Dir, name: &str, keys: &[f32], change: impl FnOnce(&mut Value, &mut Numbers)) {
    let mut numbers = Numbers::default();
    let corners = [
        [-1.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
        [1.0, 0.0, -1.0],
        [-1.0, 0.0, -1.0],
    ];
    let position = numbers.floats(&corners);
    numbers.accessors[position]["min"] = json!([-1.0, 0.0, -1.0]);
    numbers.accessors[position]["max"] = json!([1.0, 0.0, 1.0]);
    let indices = numbers.push(&[0, 1, 2, 0, 2, 3], 6, 5121, "SCALAR");
    let times: Vec<[f32; 1]> = keys.iter().map(|&key| [key]).collect();
    let input = numbers.floats(&times);
    let moves: Vec<[f32; 3]> = keys.iter().map(|&key| [0.0, key, 0.0]).collect();
    let output = numbers.floats(&moves);
    let mut document = json!({
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [{"attributes": {"POSITION": position}, "indices": indices}]}],
        "nodes": [{"mesh": 0, "name": "square"}, {"mesh": 0, "translation": [0.5, -1.0, 0.0]}],
        "scenes": [{"nodes": [0, 1]}],
        "scene": 0,
        "animations": [{
            "samplers": [{"input": input, "output": output}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
        }],
    });
    change(&mut document, &mut numbers);
    let file = format!("{name}.bin");
    document["buffers"] = json!([{"uri": file, "byteLength": numbers.bytes.len()}]);
    document["bufferViews"] = json!(numbers.views);
    document["accessors"] = json!(numbers.accessors);
    std::fs::write(dir.path(&file), &numbers.bytes).unwrap();
    dir.write(&format!("{name}.gltf"), &document.to_string());
}

/// Joints and weights for the square, and a skin of that many joints.
fn skin(document: &mut Value, numbers: &mut Numbers, joint: u8, matrices: Option<usize>) {
    let joints = numbers.push(&[joint, 0, 0, 0].repeat(4), 4, 5121, "VEC4");
    let weights = numbers.floats(&[[1.0, 0.0, 0.0, 0.0]; 4]);
    let attributes = &mut document["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
    document["nodes"] = json!([{"name": "joint"}, {"mesh": 0, "skin": 0}, {"name": "other"}]);
    document["scenes"] = json!([{"nodes": [0, 1, 2]}]);
    let mut skin = json!({"joints": [0, 2]});
    if let Some(count) = matrices {
        let one: Vec<u8> = (0..16)
            .flat_map(|k| if k % 5 == 0 { 1.0_f32 } else { 0.0 }.to_le_bytes())
            .collect();
        skin["inverseBindMatrices"] = json!(numbers.push(&one.repeat(count), count, 5126, "MAT4"));
    }
    document["skins"] = json!([skin]);
}

/// A sky of one brightness.
fn sky(dir: &Dir, name: &str, [width, height]: [u32; 2], pixel: [u8; 4]) {
    let head = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n");
    let mut bytes = head.into_bytes();
    bytes.extend(pixel.repeat((width * height) as usize));
    std::fs::write(dir.path(name), bytes).unwrap();
}

/// A folder with a sky of one pixel.
fn folder() -> Dir {
    let dir = Dir::new();
    sky(&dir, "one.hdr", [1, 1], [128, 128, 128, 129]);
    dir
}

/// The pixels of a picture, all of which must be finite.
fn pixels(dir: &Dir, name: &str) -> Vec<[f32; 3]> {
    let opened = occlude_image::read(&dir.path(name), &occlude_image::Limits::default()).unwrap();
    assert_eq!(opened.repaired, 0, "{name}");
    opened.picture.pixels
}

fn animate(name: &str) -> String {
    format!("animate {name}.gltf --environment one.hdr --frames 0..1 {FEW} -o {name}_#.exr")
}

#[test]
fn animations_that_are_none() {
    let dir = folder();
    write(&dir, "empty", &[0.0, 1.0], |document, _| {
        document["animations"] = json!([{"samplers": [], "channels": []}]);
    });
    dir.refuses(
        &animate("empty"),
        &["animation without keyframes", "empty.gltf"],
    );
    write(&dir, "short", &[0.0], |_, _| ());
    let run = dir.must(&animate("short").replace(" --quiet", ""));
    assert!(run.stderr.contains("0 s long"), "{}", run.stderr);
    // Nothing moves, and nothing changes.
    assert!(pixels(&dir, "short_0.exr") == pixels(&dir, "short_1.exr"));
    write(&dir, "good", &[0.0, 1.0], |_, _| ());
    dir.must(&animate("good"));
    assert!(pixels(&dir, "good_0.exr") != pixels(&dir, "good_1.exr"));
}

#[test]
fn skins_and_shapes_that_do_not_fit() {
    let dir = folder();
    write(&dir, "beyond", &[0.0, 1.0], |d, n| skin(d, n, 7, None));
    dir.refuses(&animate("beyond"), &["joint 7", "out of range"]);
    write(&dir, "few", &[0.0, 1.0], |d, n| skin(d, n, 1, Some(1)));
    dir.refuses(&animate("few"), &["1 matrices for 2 joints"]);
    // Without bind matrices joints start where the mesh is, as the format says.
    write(&dir, "unbound", &[0.0, 1.0], |d, n| skin(d, n, 0, None));
    write(&dir, "bound", &[0.0, 1.0], |d, n| skin(d, n, 0, Some(2)));
    dir.must(&animate("unbound"));
    dir.must(&animate("bound"));
    assert!(pixels(&dir, "bound_1.exr") == pixels(&dir, "unbound_1.exr"));
    // A shape with other vertices than the mesh.
    write(&dir, "shape", &[0.0, 1.0], |document, numbers| {
        let target = numbers.floats(&[[0.0, 1.0, 0.0]; 3]);
        document["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": target}]);
        document["meshes"][0]["weights"] = json!([0.5]);
    });
    dir.refuses(&animate("shape"), &["shape.gltf", "POSITION"]);
}

/// A sky of one pixel, and one as bright as numbers get: pictures stay finite.
#[test]
fn skies_of_one_pixel_and_without_bounds() {
    let dir = folder();
    write(&dir, "good", &[0.0, 1.0], |_, _| ());
    sky(&dir, "huge.hdr", [4, 2], [255, 255, 255, 235]);
    for name in ["one", "huge"] {
        dir.must(&animate("good").replace("one.hdr", &format!("{name}.hdr")));
        let picture = pixels(&dir, "good_1.exr");
        if name == "one" {
            // White enough to be seen: the square reflects some of the sky.
            let bright = picture.iter().flatten().filter(|v| **v > 0.1).count();
            assert!(bright > 100, "{bright}");
        }
    }
}

/// Pixels of a sky that are no finite numbers count as black, and that is said; the picture is that of the sky without them.
#[test]
fn skies_with_an_infinity() {
    let dir = folder();
    write(&dir, "good", &[0.0, 1.0], |_, _| ());
    let mut sky = Picture {
        width: 8,
        height: 4,
        pixels: vec![[0.5, 0.6, 0.7]; 32],
    };
    let mut shot = |hole: [f32; 3]| {
        sky.pixels[9] = hole;
        occlude_image::write(&dir.path("sky.exr"), &sky, Look::default()).unwrap();
        let command = animate("good").replace("one.hdr", "sky.exr");
        let run = dir.must(&command.replace(" --quiet", ""));
        (run.stderr, pixels(&dir, "good_1.exr"))
    };
    let (said, black) = shot([0.0; 3]);
    assert!(!said.contains("finite"), "{said}");
    let (said, holed) = shot([f32::INFINITY, f32::NAN, f32::NEG_INFINITY]);
    assert!(
        said.contains("1 pixels were not finite and count as black: sky.exr"),
        "{said}"
    );
    assert!(holed.iter().flatten().all(|v| v.is_finite()));
    assert!(holed == black);
}

#[test]
fn views_show_points_and_fields() {
    let dir = Dir::new();
    dir.must("scene balls-in-dish --triangles 3000 -o b.glb");
    dir.must(
        "render b.glb --integrator field --size 64x48 --cache off -o a.png --field-views v --pick 32,24",
    );
    for what in ["points", "lobes", "map", "field"] {
        assert!(
            dir.read(&format!("v-{what}.png")).starts_with(b"\x89PNG"),
            "{what}"
        );
    }
    dir.refuses(
        "render b.glb --integrator field -o a.png --field-views v --pick 32",
        &["--pick", "X,Y"],
    );
    dir.refuses(
        "render b.glb --integrator field -o a.png --pick 3,4",
        &["--field-views"],
    );
}
