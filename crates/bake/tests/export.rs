//! What a bake writes: the scene with all that it had, and maps that say what is where.

use glam::{Vec2, Vec3};
use occlude_bake::atlas::{self, Atlas, AtlasSettings, density};
use occlude_bake::export::{self, Engine, ExportSettings, Exported, Light};
use occlude_bake::texel::Texels;
use occlude_image::Limits;
use occlude_render::geometry::WorldTriangle;
use occlude_render::job::Job;
use occlude_scene::procedural::{self, Name};
use occlude_scene::{Pose, Scene};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A texel's light is its place in the world, so that everything that moves it shows.
struct PlaceLight {
    of: Vec<[f32; 3]>,
}

impl Light for PlaceLight {
    fn irradiance(&self, texel: u32) -> [f32; 3] {
        self.of[texel as usize]
    }
}

/// Positions are made positive by this.
const LIFT: f32 = 40.0;

fn place_light(texels: &Texels) -> PlaceLight {
    let mut of = vec![[0.0; 3]; texels.atlas.texels() as usize];
    for (page, rows) in texels.bands(64) {
        let band = texels.band(page, rows);
        for i in 0..band.len() {
            let hit = texels.representative(&band, i);
            let world = WorldTriangle::new(texels.scene, texels.pose, hit.instance, hit.primitive);
            of[band.texel(i) as usize] = (world.point(hit.u, hit.v) + LIFT).to_array();
        }
    }
    PlaceLight { of }
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("occlude-export-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn baked(
    scene: &Scene,
    texels_per_metre: f32,
    settings: &AtlasSettings,
    out: &Path,
) -> (Atlas, Exported) {
    let pose = Pose::at(scene, 0.0);
    let densities = density::densities(scene, &pose, texels_per_metre);
    let built = atlas::build(scene, &pose, &densities, settings, &Job::new()).unwrap();
    let texels = Texels::new(scene, &pose, &built.atlas);
    let nodes = export::write_scene(out, &texels).unwrap();
    let settings = ExportSettings {
        engine: Engine::Bevy,
        dilate: 2,
        ..ExportSettings::default()
    };
    let exported = export::write(
        out,
        &texels,
        &place_light(&texels),
        None,
        &nodes,
        &settings,
        None,
        &Job::new(),
    )
    .unwrap();
    (built.atlas, exported)
}

/// Loads what was written and looks the light up as an engine would: it must be the place of each surface point.
fn check(out: &Path, exported: &Exported, tolerance: f32) -> Scene {
    let scene = Scene::load(&out.join("scene.glb"), None, None).unwrap();
    let pose = Pose::at(&scene, 0.0);
    let pages: Vec<_> = exported
        .manifest
        .pages
        .iter()
        .map(|p| {
            occlude_image::read(&out.join(&p.file), &Limits::default())
                .unwrap()
                .picture
        })
        .collect();
    let (mut checked, mut wrong) = (0, 0);
    let entries: BTreeMap<_, _> = (exported.manifest.nodes.iter())
        .map(|n| ((n.node, n.instance.unwrap_or(0)), n))
        .collect();
    let mut places: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for (i, posed) in pose.instances.iter().enumerate() {
        let file_node = scene.contents.file_nodes[posed.node as usize];
        let place = places.entry((posed.node, posed.mesh)).or_default();
        let entry = entries.get(&(file_node, *place));
        *place += 1;
        let Some(entry) = entry else { continue };
        let mesh = &scene.meshes[posed.mesh as usize];
        assert_eq!(mesh.uv1.len(), mesh.positions.len(), "{}", mesh.name);
        let page = &pages[entry.page as usize];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let uv = corners.map(|v| mesh.uv1[v as usize]);
            let world = WorldTriangle::new(&scene, &pose, i as u32, t as u32);
            let middle =
                (uv[0] + uv[1] + uv[2]) / 3.0 * Vec2::from(entry.scale) + Vec2::from(entry.offset);
            let at = middle * Vec2::new(page.width as f32, page.height as f32) - 0.5;
            let low = at.floor().max(Vec2::ZERO);
            let f = at - low;
            let texel = |dx: u32, dy: u32| {
                Vec3::from(
                    page.get(
                        (low.x as u32 + dx).min(page.width - 1),
                        (low.y as u32 + dy).min(page.height - 1),
                    )
                    .unwrap(),
                )
            };
            let value = texel(0, 0) * (1.0 - f.x) * (1.0 - f.y)
                + texel(1, 0) * f.x * (1.0 - f.y)
                + texel(0, 1) * (1.0 - f.x) * f.y
                + texel(1, 1) * f.x * f.y;
            let found = value * std::f32::consts::PI - LIFT;
            checked += 1;
            wrong += u32::from(found.distance(world.point(1.0 / 3.0, 1.0 / 3.0)) > tolerance);
        }
    }
    assert!(checked > 0);
    // Half floats, and texels where a chart is curved, give some slack.
    assert!(
        f64::from(wrong) <= 0.02 * f64::from(checked),
        "{wrong} of {checked} triangles find another's light"
    );
    scene
}

#[test]
fn engines_find_the_light_of_each_point() {
    for (name, settings) in [
        (Name::Cornell, AtlasSettings::default()),
        (Name::Conference, AtlasSettings::default()),
        (
            Name::Conference,
            AtlasSettings {
                page_size: 256,
                padding: 2,
                ..AtlasSettings::default()
            },
        ),
        (Name::Courtyard, AtlasSettings::default()),
    ] {
        let scene = procedural::build(name, Some(2_000), 1);
        let density = if name == Name::Courtyard { 3.0 } else { 12.0 };
        let out = folder(name.as_str());
        // Procedural scenes are written anew; the file of the same scene is edited.
        let (_, exported) = baked(&scene, density, &settings, &out);
        // Three texels: triangles smaller than a texel share it with their neighbours.
        let tolerance = 3.0 / density;
        let direct = check(&out, &exported, tolerance);
        let file = out.join("source.glb");
        occlude_scene::write_glb(&scene, &mut std::fs::File::create(&file).unwrap()).unwrap();
        let loaded = Scene::load(&file, None, None).unwrap();
        let (_, exported) = baked(&loaded, density, &settings, &out);
        let edited = check(&out, &exported, tolerance);
        assert_eq!(direct.instances.len(), edited.instances.len());
        std::fs::remove_dir_all(out).unwrap();
    }
}
