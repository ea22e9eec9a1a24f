//! Features of glTF, each on a document of a few bytes with a known answer.

mod common;

use common::{Document, F32, Temporary, U8, U16};
use glam::{Affine3A, Quat, Vec2, Vec3, Vec4};
use occlude_scene::{
    AlphaMode, Filter, LightKind, Pose, Projection, Scene, SceneError, Texels, Wrap,
};
use serde_json::json;

fn near(a: Vec3, b: Vec3) {
    assert!(a.distance(b) < 1e-5, "{a} is not {b}");
}

#[test]
fn quantized_positions_mean_what_the_extension_says() {
    let cases: [(u32, bool, Vec<u8>, f32); 8] = [
        (5120, false, vec![0x81], -127.0),
        (5120, true, vec![0x80], -1.0),
        (U8, false, vec![200], 200.0),
        (U8, true, vec![51], 0.2),
        (5122, false, (-1000i16).to_le_bytes().to_vec(), -1000.0),
        (
            5122,
            true,
            16384i16.to_le_bytes().to_vec(),
            16384.0 / 32767.0,
        ),
        (U16, false, 65535u16.to_le_bytes().to_vec(), 65535.0),
        (U16, true, 13107u16.to_le_bytes().to_vec(), 0.2),
    ];
    for (component, normalized, number, wanted) in cases {
        let mut d = Document::new();
        let size = number.len();
        let stride = (3 * size).next_multiple_of(4);
        // Three vertices: (w, 0, 0), (0, w, 0), (0, 0, w), interleaved with padding; the last one ends early.
        let mut bytes = vec![0; 2 * stride + 3 * size];
        for axis in 0..3 {
            let at = axis * stride + axis * size;
            bytes[at..at + size].copy_from_slice(&number);
        }
        let position = d.accessor(&bytes, component, "VEC3", 3);
        d.json["bufferViews"][0]["byteStride"] = stride.into();
        d.json["accessors"][0]["normalized"] = normalized.into();
        let mesh = d.mesh(json!({"attributes": {"POSITION": position}}));
        d.node(json!({"mesh": mesh}));
        let scene = d.load().unwrap();
        let wanted = [Vec3::X, Vec3::Y, Vec3::Z].map(|v| v * wanted);
        assert_eq!(
            scene.meshes[0].positions, wanted,
            "{component} {normalized}"
        );
    }
}

#[test]
fn strips_and_fans_keep_their_winding() {
    for (mode, wanted) in [
        (5, vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, vec![[1, 2, 0], [2, 3, 0], [3, 4, 0]]),
    ] {
        let mut d = Document::new();
        let corners: [[f32; 3]; 5] = std::array::from_fn(|i| [i as f32, (i % 2) as f32, 0.0]);
        let position = d.floats(&corners);
        let mesh = d.mesh(json!({"attributes": {"POSITION": position}, "mode": mode}));
        d.node(json!({"mesh": mesh}));
        assert_eq!(d.load().unwrap().meshes[0].triangles, wanted);
    }
}

#[test]
fn sparse_values_replace_the_base() {
    for with_base in [true, false] {
        let mut d = Document::new();
        let position = d.floats(&[[1.0f32, 1.0, 1.0]; 3]);
        let indices = d.view(&[1, 2]);
        let values: Vec<u8> = [5f32, 0.0, 0.0, 0.0, 7.0, 0.0]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let values = d.view(&values);
        d.json["accessors"][position]["sparse"] = json!({
            "count": 2,
            "indices": {"bufferView": indices, "componentType": U8},
            "values": {"bufferView": values},
        });
        if !with_base {
            d.json["accessors"][position]
                .as_object_mut()
                .unwrap()
                .remove("bufferView");
        }
        let mesh = d.mesh(json!({"attributes": {"POSITION": position}}));
        d.node(json!({"mesh": mesh}));
        let first = if with_base { Vec3::ONE } else { Vec3::ZERO };
        let wanted = [first, Vec3::X * 5.0, Vec3::Y * 7.0];
        assert_eq!(d.load().unwrap().meshes[0].positions, wanted);
    }
}

#[test]
fn unused_vertices_go_and_bad_ones_take_their_triangles_along() {
    let mut d = Document::new();
    let positions = [
        [9.0, 9.0, 9.0],
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [f32::NAN, 0.0, 0.0],
    ];
    let position = d.floats(&positions);
    let normal = d.floats(&[
        [0.0f32, 0.0, 2.0],
        [0.0, 0.0, 2.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0; 3],
    ]);
    let indices = d.indices(&[1, 2, 3, 1, 2, 4, 2, 2, 3]);
    let mesh =
        d.mesh(json!({"attributes": {"POSITION": position, "NORMAL": normal}, "indices": indices}));
    d.node(json!({"mesh": mesh}));
    let scene = d.load().unwrap();
    assert_eq!(scene.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    // The zero normal becomes that of the face.
    assert_eq!(scene.meshes[0].normals, [Vec3::Z; 3]);
    assert_eq!(scene.meshes[0].triangles, [[0, 1, 2]]);
    assert_eq!(scene.warnings.len(), 1);
    assert!(
        scene.warnings[0].what.starts_with("1 triangles"),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn gpu_instances_stand_below_their_node() {
    let mut d = Document::new();
    let mesh = d.triangle();
    let translation = d.floats(&[[1.0f32, 0.0, 0.0], [0.0, 2.0, 0.0]]);
    let scale = d.floats(&[[1.0f32; 3], [3.0; 3]]);
    d.node(
        json!({"mesh": mesh, "translation": [10, 0, 0], "extensions": {"EXT_mesh_gpu_instancing":
        {"attributes": {"TRANSLATION": translation, "SCALE": scale}}}}),
    );
    let scene = d.load().unwrap();
    let pose = Pose::at(&scene, 0.0);
    assert_eq!(scene.instanced_triangles(), 2);
    assert_eq!(scene.unique_triangles(), 1);
    near(
        pose.instances[0]
            .world_from_object
            .transform_point3(Vec3::X),
        Vec3::new(12.0, 0.0, 0.0),
    );
    near(
        pose.instances[1]
            .world_from_object
            .transform_point3(Vec3::X),
        Vec3::new(13.0, 2.0, 0.0),
    );
    assert_eq!(
        scene.bounds(&pose),
        Some([Vec3::new(10.0, 0.0, 0.0), Vec3::new(13.0, 5.0, 0.0)])
    );
}

fn png(pixel: [u8; 4]) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    let picture = image::RgbaImage::from_pixel(2, 1, image::Rgba(pixel));
    picture.write_to(&mut out, image::ImageFormat::Png).unwrap();
    out.into_inner()
}

#[test]
fn materials_bring_all_their_extensions() {
    let mut d = Document::new();
    let view = d.view(&png([188, 10, 20, 30]));
    d.push(
        "images",
        json!({"bufferView": view, "mimeType": "image/png"}),
    );
    d.push(
        "samplers",
        json!({"magFilter": 9728, "wrapS": 33071, "wrapT": 33648}),
    );
    d.push("textures", json!({"source": 0, "sampler": 0}));
    let t = |texture: u32| json!({"index": texture});
    d.push("materials", json!({
        "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.6,
            "baseColorTexture": {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform":
                {"offset": [0.5, 0.25], "rotation": std::f32::consts::FRAC_PI_2, "scale": [2, 4], "texCoord": 0}}},
            "metallicRoughnessTexture": t(0)},
        "emissiveFactor": [1, 0.5, 0], "alphaMode": "MASK", "alphaCutoff": 0.7, "doubleSided": true,
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 8},
            "KHR_materials_ior": {"ior": 1.33},
            "KHR_materials_transmission": {"transmissionFactor": 0.9},
            "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationColor": [0.5, 0.6, 0.7]},
            "KHR_materials_specular": {"specularFactor": 0.3, "specularColorFactor": [2, 1, 1], "specularTexture": t(0)},
            "KHR_materials_clearcoat": {"clearcoatFactor": 0.2, "clearcoatRoughnessFactor": 0.1, "clearcoatNormalTexture": {"index": 0, "scale": 0.5}},
            "KHR_materials_sheen": {"sheenColorFactor": [0.1, 0, 0], "sheenRoughnessFactor": 0.4},
            "KHR_materials_unlit": {},
        },
    }));
    d.json["extensionsUsed"] = json!(["KHR_materials_ior", "KHR_materials_anisotropy"]);
    let mesh = d.triangle();
    d.json["meshes"][mesh]["primitives"][0]["material"] = 0.into();
    d.node(json!({"mesh": mesh}));
    let scene = d.load().unwrap();
    let m = &scene.materials[0];
    assert_eq!(m.base_color, Vec4::new(0.1, 0.2, 0.3, 0.4));
    assert_eq!(
        (m.metallic, m.roughness, m.ior, m.transmission),
        (0.5, 0.6, 1.33, 0.9)
    );
    assert_eq!(m.emission, Vec3::new(8.0, 4.0, 0.0));
    assert_eq!(m.alpha_mode, AlphaMode::Mask { cutoff: 0.7 });
    assert!(m.double_sided && m.unlit);
    let volume = m.volume.unwrap();
    assert_eq!(
        (volume.thickness, volume.attenuation_distance),
        (0.1, f32::INFINITY)
    );
    assert_eq!(
        (m.specular, m.specular_color),
        (0.3, Vec3::new(2.0, 1.0, 1.0))
    );
    assert_eq!((m.clearcoat, m.clearcoat_roughness), (0.2, 0.1));
    assert_eq!(m.clearcoat_normal.unwrap().scale, 0.5);
    assert_eq!(
        (m.sheen_color, m.sheen_roughness),
        (Vec3::new(0.1, 0.0, 0.0), 0.4)
    );
    // Turned counter-clockwise with v downwards: (1, 0) goes to (0, -1).
    let base = m.base_color_texture.unwrap();
    assert_eq!(base.uv_set, 0);
    assert!(
        base.transform
            .transform_point2(Vec2::X)
            .distance(Vec2::new(0.5, 0.25 - 2.0))
            < 1e-6
    );
    assert!(
        base.transform
            .transform_point2(Vec2::Y)
            .distance(Vec2::new(0.5 + 4.0, 0.25))
            < 1e-5
    );
    // One image, used as colour and as numbers.
    assert_eq!((scene.images.len(), scene.textures.len()), (1, 2));
    let color = scene.textures[base.texture as usize];
    let plain = scene.textures[m.specular_texture.unwrap().texture as usize];
    assert!(color.srgb && !plain.srgb);
    assert_eq!(color.sampler.filter, Filter::Nearest);
    assert_eq!(
        (color.sampler.wrap_u, color.sampler.wrap_v),
        (Wrap::Clamp, Wrap::Mirror)
    );
    assert!((color.sample(&scene.images, [0.5, 0.5]).x - 0.502_886).abs() < 1e-4);
    assert!((plain.sample(&scene.images, [0.5, 0.5]).x - 188.0 / 255.0).abs() < 1e-6);
    assert_eq!(scene.contents.extensions_used, ["KHR_materials_ior"]);
    assert_eq!(
        scene.contents.extensions_ignored,
        ["KHR_materials_anisotropy"]
    );
}

#[test]
fn a_broken_picture_becomes_magenta_and_a_warning() {
    let mut d = Document::new();
    let whole = png([1, 2, 3, 4]);
    let view = d.view(&whole[..whole.len() / 2]);
    d.push("images", json!({"bufferView": view, "name": "torn"}));
    d.push("textures", json!({"source": 0}));
    d.push(
        "materials",
        json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}),
    );
    let mesh = d.triangle();
    d.json["meshes"][mesh]["primitives"][0]["material"] = 0.into();
    d.node(json!({"mesh": mesh}));
    let scene = d.load().unwrap();
    assert_eq!(
        scene.images[0].texels,
        Texels::Rgba8(vec![[255, 0, 255, 255]])
    );
    assert_eq!(scene.warnings[0].place, "torn");
}

#[test]
fn names_choose_the_scene() {
    let mut d = Document::new();
    let mesh = d.triangle();
    d.node(json!({"mesh": mesh}));
    d.push(
        "scenes",
        json!({"name": "empty", "extras": {"sky": [1, 2, 3]}}),
    );
    let file = Temporary::new(&d.glb(), "glb");
    let load = |scene: Option<&str>| Scene::load(&file.0, scene, None);
    assert_eq!(load(None).unwrap().instances.len(), 1);
    assert_eq!(load(Some("1")).unwrap().instances.len(), 0);
    assert_eq!(load(Some("empty")).unwrap().sky, Vec3::new(1.0, 2.0, 3.0));
    let error = load(Some("other")).unwrap_err().to_string();
    assert!(
        error.contains("no scene \"other\"") && error.contains("1 \"empty\""),
        "{error}"
    );
}

#[test]
fn memory_is_asked_for_before_it_is_taken() {
    let mut d = Document::new();
    let position = d.floats(&vec![[1.0f32, 2.0, 3.0]; 3000]);
    let mesh = d.mesh(json!({"attributes": {"POSITION": position}}));
    d.node(json!({"mesh": mesh}));
    let file = Temporary::new(&d.glb(), "glb");
    let error = Scene::load(&file.0, None, Some(60_000)).unwrap_err();
    assert!(matches!(error, SceneError::Memory { needed, limit: 60_000, .. } if needed > 60_000));
    let scene = Scene::load(&file.0, None, Some(1 << 20)).unwrap();
    // Positions and triangles, and little else.
    assert!((48_000..51_000).contains(&scene.memory_bytes()));
}

#[test]
fn lights_and_cameras_follow_their_nodes() {
    let mut d = Document::new();
    d.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "spot", "color": [1, 0.5, 0], "intensity": 4, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}},
        {"type": "directional"}]}});
    d.push(
        "cameras",
        json!({"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}),
    );
    d.push("cameras", json!({"type": "orthographic", "orthographic": {"xmag": 2, "ymag": 3, "znear": 0.1, "zfar": 9}}));
    let half = std::f32::consts::FRAC_1_SQRT_2;
    // A quarter turn about +Y: -Z becomes -X. Scale must not matter.
    let parent = d.node(
        json!({"rotation": [0, half, 0, half], "scale": [2, 2, 2], "translation": [0, 0, 1]}),
    );
    let child = d.push(
        "nodes",
        json!({"name": "lamp", "translation": [0, 0, 1], "camera": 0,
        "extensions": {"KHR_lights_punctual": {"light": 0}}}),
    );
    d.json["nodes"][parent]["children"] = json!([child]);
    d.node(json!({"camera": 1, "extensions": {"KHR_lights_punctual": {"light": 1}}}));
    let scene = d.load().unwrap();
    let pose = Pose::at(&scene, 0.0);
    near(pose.lights[0].position, Vec3::new(2.0, 0.0, 1.0));
    near(pose.lights[0].direction, Vec3::NEG_X);
    assert_eq!(pose.lights[0].intensity, Vec3::new(4.0, 2.0, 0.0));
    assert_eq!(
        pose.lights[0].kind,
        LightKind::Spot {
            inner_angle: 0.1,
            outer_angle: 0.2
        }
    );
    near(pose.lights[1].direction, Vec3::NEG_Z);
    assert_eq!(scene.cameras[0].name, "lamp");
    assert_eq!(
        scene.cameras[0].projection,
        Projection::Perspective { yfov: 0.5 }
    );
    assert_eq!(
        scene.cameras[1].projection,
        Projection::Orthographic { ymag: 3.0 }
    );
    let camera = pose.camera_world(&scene, 0);
    near(camera.transform_vector3(Vec3::NEG_Z), Vec3::NEG_X);
    near(camera.transform_vector3(Vec3::Y), Vec3::Y);
    near(camera.translation.into(), Vec3::new(2.0, 0.0, 1.0));
}

#[test]
fn children_may_stand_before_their_parents() {
    let mut d = Document::new();
    let mesh = d.triangle();
    let child = d.push(
        "nodes",
        json!({"mesh": mesh, "name": "child", "translation": [1, 0, 0]}),
    );
    d.node(json!({"children": [child], "scale": [-2, 2, 2]}));
    let scene = d.load().unwrap();
    assert_eq!(scene.contents.file_nodes, [1, 0]);
    assert_eq!(scene.nodes[1].parent, Some(0));
    let pose = Pose::at(&scene, 0.0);
    near(
        pose.instances[0]
            .world_from_object
            .transform_point3(Vec3::X),
        Vec3::new(-4.0, 0.0, 0.0),
    );
}

/// A node that one channel moves.
fn animated(
    path: &str,
    interpolation: &str,
    times: &[[f32; 1]],
    output: impl Fn(&mut Document) -> usize,
) -> Scene {
    let mut d = Document::new();
    let mesh = d.triangle();
    let node = d.node(json!({"mesh": mesh, "translation": [0, 0, 5]}));
    let input = d.floats(times);
    let output = output(&mut d);
    d.push(
        "animations",
        json!({"name": "clip",
        "channels": [{"sampler": 0, "target": {"node": node, "path": path}}],
        "samplers": [{"input": input, "output": output, "interpolation": interpolation}]}),
    );
    d.load().unwrap()
}

fn world(scene: &Scene, time: f32) -> Affine3A {
    Pose::at(scene, time).instances[0].world_from_object
}

#[test]
fn translations_step_and_glide() {
    let keys = |d: &mut Document| d.floats(&[[1.0f32, 0.0, 0.0], [3.0, 0.0, 4.0]]);
    let scene = animated("translation", "LINEAR", &[[1.0], [3.0]], keys);
    assert_eq!(scene.contents.animations, [("clip".to_string(), 3.0)]);
    for (time, wanted) in [
        (0.0, [1.0, 0.0, 0.0]),
        (1.5, [1.5, 0.0, 1.0]),
        (3.0, [3.0, 0.0, 4.0]),
        (9.0, [3.0, 0.0, 4.0]),
    ] {
        near(world(&scene, time).translation.into(), Vec3::from(wanted));
    }
    let scene = animated("translation", "STEP", &[[1.0], [3.0]], keys);
    near(world(&scene, 2.999).translation.into(), Vec3::X);
    near(
        world(&scene, 3.0).translation.into(),
        Vec3::new(3.0, 0.0, 4.0),
    );
    assert!(world(&scene, f32::NAN).is_finite());
}

#[test]
fn splines_are_cubic_hermite() {
    // In-tangent, value, out-tangent: from 0 with slope 1 to 4 with slope -2 within 2 s, along x.
    let keys =
        |d: &mut Document| d.floats(&[0.0, 0.0, 1.0, -2.0, 4.0, 0.0].map(|x: f32| [x, 0.0, 0.0]));
    let scene = animated("translation", "CUBICSPLINE", &[[0.0], [2.0]], keys);
    // At t = 1/2: p0/2 + span/8 m0 + p1/2 - span/8 m1.
    let wanted = 0.25 + 2.0 + 0.5;
    near(world(&scene, 1.0).translation.into(), Vec3::X * wanted);
    near(world(&scene, 2.0).translation.into(), Vec3::X * 4.0);
}

#[test]
fn rotations_turn_evenly_the_short_way() {
    let quarter = Quat::from_rotation_z(std::f32::consts::FRAC_PI_2);
    // The second key has the other sign: the same rotation, and the long way round if taken as it is.
    let float =
        move |d: &mut Document| d.floats(&[Quat::IDENTITY.to_array(), (-quarter).to_array()]);
    let packed = move |d: &mut Document| {
        let numbers =
            [Quat::IDENTITY, quarter].map(|q| q.to_array().map(|v| (v * 32767.0).round() as i16));
        let bytes: Vec<u8> = numbers
            .as_flattened()
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let accessor = d.accessor(&bytes, 5122, "VEC4", 2);
        d.json["accessors"][accessor]["normalized"] = true.into();
        accessor
    };
    let scenes = [
        animated("rotation", "LINEAR", &[[0.0], [1.0]], float),
        animated("rotation", "LINEAR", &[[0.0], [1.0]], packed),
    ];
    for (scene, tolerance) in scenes.iter().zip([1e-6, 1e-4]) {
        let eighth = world(scene, 0.5).transform_vector3(Vec3::X);
        let wanted = Vec3::new(1.0, 1.0, 0.0).normalize();
        assert!(eighth.distance(wanted) < tolerance, "{eighth}");
        // What is not animated stays: the node stands at z = 5.
        assert_eq!(world(scene, 0.5).translation.z, 5.0);
    }
}

#[test]
fn two_joints_bend_a_strip() {
    let mut d = Document::new();
    let position = d.floats(&[[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]);
    let normal = d.floats(&[[0.0f32, 0.0, 1.0]; 3]);
    let joints = d.accessor(&[0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0], U8, "VEC4", 3);
    // Weights that do not sum to 1: all of joint 0, half and half, all of joint 1.
    let weights = d.floats(&[
        [2.0f32, 0.0, 0.0, 0.0],
        [0.4, 0.4, 0.0, 0.0],
        [0.0, 3.0, 0.0, 0.0],
    ]);
    let mesh = d.mesh(json!({"attributes":
        {"POSITION": position, "NORMAL": normal, "JOINTS_0": joints, "WEIGHTS_0": weights}}));
    // The mesh's own node must not matter.
    let body = d.node(json!({"mesh": mesh, "skin": 0, "translation": [100, 0, 0]}));
    let still = d.node(json!({}));
    let turned = d.node(json!({"translation": [0, 1, 0]}));
    let up_one = |y: f32| {
        [
            1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, y, 0.0, 1.0,
        ]
    };
    let matrices = d.floats(&[up_one(0.0), up_one(-1.0)]);
    d.push(
        "skins",
        json!({"joints": [still, turned], "inverseBindMatrices": matrices}),
    );
    let input = d.floats(&[[0.0f32], [1.0]]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    // From rest to a quarter turn about +X: +Y becomes +Z.
    let output = d.floats(&[[0.0f32, 0.0, 0.0, 1.0], [half, 0.0, 0.0, half]]);
    d.push(
        "animations",
        json!({"channels": [{"sampler": 0, "target": {"node": turned, "path": "rotation"}}],
        "samplers": [{"input": input, "output": output}]}),
    );
    let scene = d.load().unwrap();
    assert_eq!(scene.instances[0].node, body as u32);
    let rest = Pose::at(&scene, 0.0);
    for (posed, wanted) in
        rest.positions(&scene, 0)
            .iter()
            .zip([Vec3::ZERO, Vec3::X, Vec3::Y * 2.0])
    {
        near(*posed, wanted);
    }
    let bent = Pose::at(&scene, 1.0);
    assert_eq!(bent.instances[0].world_from_object, Affine3A::IDENTITY);
    // Joint 1 stands at (0, 1, 0): (1, 0, 0) goes to (1, 1, -1), and half of it stays; (0, 2, 0) goes to (0, 1, 1).
    let wanted = [
        Vec3::ZERO,
        Vec3::new(1.0, 0.5, -0.5),
        Vec3::new(0.0, 1.0, 1.0),
    ];
    for (posed, wanted) in bent.positions(&scene, 0).iter().zip(wanted) {
        near(*posed, wanted);
    }
    near(bent.normals(&scene, 0)[0], Vec3::Z);
    near(
        bent.normals(&scene, 0)[1],
        Vec3::new(0.0, -1.0, 1.0).normalize(),
    );
    near(bent.normals(&scene, 0)[2], Vec3::NEG_Y);
}

#[test]
fn morph_weights_blend_targets() {
    let mut d = Document::new();
    let mesh = d.triangle();
    let up = d.floats(&[[0.0f32, 0.0, 2.0]; 3]);
    let aside = d.floats(&[[4.0f32, 0.0, 0.0]; 3]);
    d.json["meshes"][mesh]["primitives"][0]["targets"] =
        json!([{"POSITION": up}, {"POSITION": aside}]);
    d.json["meshes"][mesh]["weights"] = json!([0.5, 0]);
    let first = d.node(json!({"mesh": mesh}));
    d.node(json!({"mesh": mesh, "weights": [0, 0]}));
    let input = d.floats(&[[0.0f32], [1.0]]);
    let output = d.floats(&[[0.0f32], [0.0], [0.5], [0.25]]);
    d.push(
        "animations",
        json!({"channels": [{"sampler": 0, "target": {"node": first, "path": "weights"}}],
        "samplers": [{"input": input, "output": output}]}),
    );
    let scene = d.load().unwrap();
    let pose = Pose::at(&scene, 1.0);
    near(
        pose.positions(&scene, 0)[1],
        Vec3::new(1.0 + 0.25 * 4.0, 0.0, 0.5 * 2.0),
    );
    assert!(pose.instances[1].deformed.is_none());
    let pose = Pose::at(&scene, 0.5);
    near(pose.positions(&scene, 0)[1], Vec3::new(1.5, 0.0, 0.5));
    let mut still = scene.clone();
    still.motion.clips.clear();
    near(
        Pose::at(&still, 0.5).positions(&scene, 0)[1],
        Vec3::new(1.0, 0.0, 1.0),
    );
}

#[test]
fn tangents_follow_u() {
    let mut d = Document::new();
    let position = d.floats(&[
        [0.0f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
    ]);
    let normal = d.floats(&[[0.0f32, 0.0, 1.0]; 4]);
    // The left triangle is the mirror image of the right one, in UV too.
    let uv = d.floats(&[[0.0f32, 1.0], [1.0, 1.0], [0.0, 0.0], [1.0, 1.0]]);
    let indices = d.indices(&[0, 1, 2, 0, 2, 3]);
    let view = d.view(&png([128, 128, 255, 255]));
    d.push("images", json!({"bufferView": view}));
    d.push("textures", json!({"source": 0}));
    d.push("materials", json!({"normalTexture": {"index": 0}}));
    let mesh = d.mesh(
        json!({"attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv},
        "indices": indices, "material": 0}),
    );
    d.node(json!({"mesh": mesh}));
    let scene = d.load().unwrap();
    let mesh = &scene.meshes[0];
    // The two vertices on the seam are split.
    assert_eq!(mesh.positions.len(), 6);
    for (triangle, wanted) in mesh.triangles.iter().zip([
        Vec4::new(1.0, 0.0, 0.0, 1.0),
        Vec4::new(-1.0, 0.0, 0.0, -1.0),
    ]) {
        for &i in triangle {
            // Normal x tangent times handedness is up in the picture: +Y here.
            assert_eq!(mesh.tangents[i as usize], wanted);
        }
    }
    // Without normals every face stands alone.
    d.json["meshes"][0]["primitives"][0]["attributes"]
        .as_object_mut()
        .unwrap()
        .remove("NORMAL");
    let scene = d.load().unwrap();
    assert_eq!(scene.meshes[0].positions.len(), 6);
    assert_eq!(scene.meshes[0].normals, [Vec3::Z; 6]);
}

#[test]
fn joints_beyond_the_skin_are_refused() {
    let mut d = Document::new();
    let mesh = d.triangle();
    let joints = d.accessor(&[7u8; 12], U8, "VEC4", 3);
    let weights = d.floats(&[[1.0f32, 0.0, 0.0, 0.0]; 3]);
    let attributes = &mut d.json["meshes"][mesh]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = joints.into();
    attributes["WEIGHTS_0"] = weights.into();
    let node = d.node(json!({"mesh": mesh, "skin": 0, "name": "body"}));
    d.push("skins", json!({"joints": [node]}));
    let error = d.load().unwrap_err().to_string();
    assert!(
        error.contains("joint 7") && error.contains("body"),
        "{error}"
    );
}

#[test]
fn messages_stay_on_one_line() {
    let mut d = Document::new();
    let mesh = d.triangle();
    let name = format!("two\nlines {}", "x".repeat(500));
    d.json["meshes"][mesh]["name"] = name.clone().into();
    d.json["meshes"][mesh]["primitives"][0]["indices"] = 77.into();
    d.node(json!({"mesh": mesh}));
    let error = d.load().unwrap_err().to_string();
    assert!(!error.contains('\n') && error.len() < 390, "{error}");
    d.json["extensionsRequired"] = json!([name]);
    let error = d.load().unwrap_err().to_string();
    assert!(!error.contains('\n') && error.len() < 390, "{error}");
}

#[test]
fn wrong_types_are_refused() {
    for (key, value) in [
        ("type", json!("VEC2")),
        ("componentType", json!(5124)),
        ("count", json!(1e30)),
        ("count", json!(-1)),
    ] {
        let mut d = Document::new();
        let mesh = d.triangle();
        d.json["accessors"][0][key] = value;
        d.node(json!({"mesh": mesh}));
        assert!(d.load().is_err(), "{key}");
    }
    let mut d = Document::new();
    let mesh = d.triangle();
    let indices = d.accessor(&[0; 12], F32, "SCALAR", 3);
    d.json["meshes"][mesh]["primitives"][0]["indices"] = indices.into();
    d.node(json!({"mesh": mesh}));
    assert!(d.load().is_err());
}
