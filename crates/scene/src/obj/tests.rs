use super::*;
use crate::{AlphaMode, Texels};
use glam::{Vec2, Vec3, Vec4};

/// A folder of files that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str, files: &[(&str, &[u8])]) -> Self {
        let folder =
            std::env::temp_dir().join(format!("occlude-obj-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
        Self(folder)
    }

    fn load(&self) -> Scene {
        load(&self.0.join("a.obj"), None).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn parse(name: &str, obj: &str, mtl: &str) -> Scene {
    Folder::new(
        name,
        &[("a.obj", obj.as_bytes()), ("a.mtl", mtl.as_bytes())],
    )
    .load()
}

fn texts(scene: &Scene) -> String {
    scene
        .warnings
        .iter()
        .map(|w| format!("{}: {}\n", w.place, w.what))
        .collect()
}

fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("OCCLUDE_SCENES").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"),
        PathBuf::from,
    );
    let path = root.join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("SKIPPED: {} is not there", path.display());
    None
}

#[test]
fn diffuse_only_is_exactly_lambert() {
    let s = parse(
        "lambert",
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n",
        "newmtl m\nNs 10\nNi 1.5\nillum 2\nKd 0.63 0.065 0.05\nKs 0 0 0\nKe 17 12 4\n",
    );
    assert!(s.warnings.is_empty(), "{}", texts(&s));
    let m = &s.materials[0];
    assert_eq!(m.base_color, Vec4::new(0.63, 0.065, 0.05, 1.0));
    assert_eq!(
        (m.metallic, m.roughness, m.specular, m.transmission),
        (0.0, 1.0, 0.0, 0.0)
    );
    assert_eq!(
        (m.clearcoat, m.sheen_color, m.alpha_mode),
        (0.0, Vec3::ZERO, AlphaMode::Opaque)
    );
    assert_eq!(
        (m.emission, m.double_sided),
        (Vec3::new(17.0, 12.0, 4.0), false)
    );
    assert!(s.meshes[0].normals.is_empty(), "no normals: flat");
}

#[test]
fn coverage_mirrors_and_glass() {
    let tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    let face = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n";
    let obj = format!(
        "mtllib a.mtl\nusemtl glass\n{tetrahedron}usemtl pane\n{face}usemtl mirror\n{face}usemtl veil\n{face}\
         usemtl coat\n{face}"
    );
    let s = parse(
        "kinds",
        &obj,
        "newmtl glass\nillum 4\nTf 0.25 1 1\nNi 1.4\nKs 0.3 0.3 0.3\n\
         newmtl pane\nillum 7\nd 0.25\nKd 1 0 0\n\
         newmtl mirror\nillum 5\nKd 0.01 0.01 0.01\nKs 0.95 0.95 0.95\nNs 1000\n\
         newmtl veil\nillum 2\nKd 1 1 1\nd 0.25\nTr 0.9\n\
         newmtl coat\nillum 2\nKd 0.5 0.5 0.5\nKs 0.04 0.04 0.04\nNs 198\nNi 1.5\n",
    );
    assert!(s.warnings.is_empty(), "{}", texts(&s));
    let [glass, pane, mirror, veil, coat] = &s.materials[..] else {
        panic!("{}", s.materials.len())
    };
    assert_eq!((glass.transmission, glass.ior), (1.0, 1.4));
    assert!(glass.volume.is_some(), "closed: refracts");
    assert_eq!(
        glass.base_color,
        Vec4::new(0.5, 1.0, 1.0, 1.0),
        "twice through"
    );
    assert_eq!((pane.transmission, pane.volume), (0.75, None));
    assert_eq!((mirror.metallic, mirror.roughness), (1.0, 0.0));
    assert_eq!(mirror.base_color.truncate(), Vec3::splat(0.95));
    assert_eq!(
        (veil.alpha_mode, veil.base_color.w),
        (AlphaMode::Blend, 0.25),
        "d wins over Tr"
    );
    assert!(
        (coat.specular_color - Vec3::ONE).abs().max_element() < 1e-5,
        "{}",
        coat.specular_color
    );
    assert!(
        (coat.roughness - 0.1f32.sqrt()).abs() < 1e-6,
        "alpha = sqrt(2 / 200)"
    );
}

#[test]
fn damage_is_counted_not_fatal() {
    let s = parse(
        "damage",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 1 2\nf 1 2 9\nf 1 2\nf a b c\nf 0 1 2\nf -1 -2 -7\nf 1 2 4\n\
         usemtl nothing\nmtllib missing.mtl\nf 1//9 2//9 3//9\nf 1 2 3\nf 3 1 2\nf 99999999999999999999 1 2\n\
         mtllib ../../etc/passwd\nf 1/2/3/4 2 3\n",
        "",
    );
    assert_eq!(s.meshes.len(), 1);
    assert_eq!(s.meshes[0].triangles, [[0, 1, 2]]);
    let texts = texts(&s);
    for part in [
        "index that is no vertex, dropped (7 times, first in line 5)",
        "fewer than three",
        "three finite numbers",
        "coincides with an earlier one of its mesh, dropped (line 15)",
        "missing.mtl: material file ignored",
        "outside of the folder",
        "material nothing is not defined",
    ] {
        assert!(texts.contains(part), "{part:?} not in\n{texts}");
    }
}

#[test]
fn pictures_become_what_gltf_wants() {
    let png = |texels: &[[u8; 4]]| {
        let mut out = std::io::Cursor::new(Vec::new());
        image::RgbaImage::from_raw(texels.len() as u32, 1, texels.as_flattened().to_vec())
            .unwrap()
            .write_to(&mut out, image::ImageFormat::Png)
            .unwrap();
        out.into_inner()
    };
    let color = png(&[[10, 20, 30, 255], [40, 50, 60, 255]]);
    let cut = png(&[[0, 0, 0, 255], [255, 255, 255, 255]]);
    let height = png(&[
        [0, 0, 0, 255],
        [0, 0, 0, 255],
        [255, 255, 255, 255],
        [0, 0, 0, 255],
    ]);
    let s = Folder::new(
        "maps",
        &[
            ("a.obj", b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25 0.25\nusemtl m\nf 1/1 2/1 3/1\n"),
            (
                "a.mtl",
                b"newmtl m\nmap_Kd -s 2 3 -o 0.5 0.25 c o.png\nmap_d cut.png\nmap_bump -bm 2 h.png\nmap_Ke no.png\n",
            ),
            ("c o.png", &color),
            ("cut.png", &cut),
            ("h.png", &height),
        ],
    )
    .load();
    assert_eq!(s.warnings.len(), 1, "{}", texts(&s));
    assert!(texts(&s).starts_with("texture no.png: cannot be used, replaced by magenta"));
    let m = &s.materials[0];
    assert_eq!(m.alpha_mode, AlphaMode::Mask { cutoff: 0.5 });
    let image = |t: crate::TextureRef| &s.images[s.textures[t.texture as usize].image as usize];
    let base = m.base_color_texture.unwrap();
    assert_eq!(
        image(base).texels,
        Texels::Rgba8(vec![[10, 20, 30, 0], [40, 50, 60, 255]])
    );
    // OBJ (0.25, 0.25) reads the picture at (2 * 0.25 + 0.5, 3 * 0.25 + 0.25), v up.
    let uv = base.transform.transform_point2(s.meshes[0].uv0[0]);
    assert_eq!(uv, Vec2::new(1.0, 1.0 - 1.0));
    let normal = m.normal.unwrap().texture;
    assert!(!s.textures[normal.texture as usize].srgb);
    let Texels::Rgba8(n) = &image(normal).texels else {
        panic!()
    };
    // Rising to the right by 255 in two texels, twice as high: n = (-1, 0, 1) / sqrt(2).
    assert_eq!(n[1], [37, 128, 218, 255]);
    assert_eq!(
        image(m.emission_texture.unwrap()).texels,
        Texels::Rgba8(vec![[255, 0, 255, 255]])
    );
}

#[test]
fn tricky_file() {
    let Some(path) = shared("conformance/tricky.obj") else {
        return;
    };
    let s = load(&path, None).unwrap();
    let names: Vec<_> = s.materials.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["mat_a", "mat b with spaces"]);
    assert_eq!(s.materials[1].transmission, 0.5);
    let triangles: usize = s.meshes.iter().map(|m| m.triangles.len()).sum();
    assert_eq!(triangles, 2 + 1 + 1 + 3);
    assert_eq!(s.nodes[0].name, "first object with spaces");
    assert_eq!(s.meshes[0].colors[0], Vec4::new(1.0, 0.0, 0.0, 1.0));
    assert_eq!(s.meshes[0].normals, vec![Vec3::Z; 4]);
    assert!(s.materials[0].base_color_texture.is_some());
    assert_eq!(
        s.warnings.len(),
        2,
        "lines and points; a face without vt: {}",
        texts(&s)
    );
}

#[test]
fn real_files() {
    for (name, triangles, materials) in [
        ("cornell/CornellBox-Original.obj", 32, 8),
        ("cornell/CornellBox-Sphere.obj", 2188, 8),
        ("sibenik/sibenik.obj", 75_284, 15),
    ] {
        let Some(path) = shared(name) else { continue };
        let s = load(&path, None).unwrap();
        let dropped = texts(&s).contains("coincides");
        let count: usize = s.meshes.iter().map(|m| m.triangles.len()).sum();
        assert!(
            count == triangles || dropped && count < triangles,
            "{name}: {count}\n{}",
            texts(&s)
        );
        assert_eq!(s.materials.len(), materials, "{name}");
        assert!(matches!(
            load(&path, Some(1000)),
            Err(SceneError::Memory { .. })
        ));
        eprintln!("{name}: {} meshes\n{}", s.meshes.len(), texts(&s));
    }
}
