//! Atlases of whole scenes: nothing overlaps, everything has texels, areas are kept.

use occlude_bake::atlas::{self, AtlasSettings, Built, Layout, UnwrapKind, density};
use occlude_bake::texel::Texels;
use occlude_render::geometry::WorldTriangle;
use occlude_render::job::Job;
use occlude_scene::procedural::{self, Name};
use occlude_scene::{Pose, Scene};

fn built(scene: &Scene, texels_per_metre: f32, settings: &AtlasSettings) -> (Pose, Built) {
    let pose = Pose::at(scene, 0.0);
    let densities = density::densities(scene, &pose, texels_per_metre);
    let built = atlas::build(scene, &pose, &densities, settings, &Job::new()).unwrap();
    (pose, built)
}

/// Every texel belongs to one chart of one instance, charts keep their distance, and the texels' areas sum to the scene's.
fn check(scene: &Scene, texels_per_metre: f32, settings: &AtlasSettings) -> f64 {
    let (pose, built) = built(scene, texels_per_metre, settings);
    assert!(built.problems.is_empty(), "{:?}", built.problems);
    let atlas = built.atlas;
    let texels = Texels::new(scene, &pose, &atlas);
    let mut owner: Vec<Option<(u32, u32)>> = vec![None; atlas.texels() as usize];
    let (mut area, mut covered) = (0.0, 0_u64);
    for (page, rows) in texels.bands(37) {
        let band = texels.band(page, rows);
        for i in 0..band.len() {
            covered += 1;
            area += f64::from(texels.world_area(&band, i));
            let texel = band.texel(i);
            for f in band.fragments(i) {
                let layout = atlas.placements[f.instance as usize].unwrap().layout;
                let chart = (
                    f.instance,
                    atlas.layouts[layout as usize].charts[f.primitive as usize],
                );
                let known = owner[texel as usize].get_or_insert(chart);
                assert_eq!(*known, chart, "two charts in a texel");
            }
            let hit = texels.representative(&band, i);
            assert_eq!(
                atlas.texel(hit.instance, hit.primitive, hit.u, hit.v),
                Some(texel)
            );
        }
    }
    for page in &atlas.pages {
        assert!(page.width.max(page.height) <= settings.page_size);
        let gap = settings.padding;
        let of = |x: u32, y: u32| owner[page.texel(x, y) as usize];
        for y in 0..page.height {
            for x in 0..page.width {
                let Some(one) = of(x, y) else { continue };
                for d in 1..=gap {
                    let right = (x + d < page.width).then(|| of(x + d, y)).flatten();
                    let below = (y + d < page.height).then(|| of(x, y + d)).flatten();
                    assert!(
                        right.is_none_or(|o| o == one) && below.is_none_or(|o| o == one),
                        "charts are too close"
                    );
                }
            }
        }
    }
    let mut wanted = 0.0;
    for (i, posed) in pose.instances.iter().enumerate() {
        for t in 0..scene.meshes[posed.mesh as usize].triangles.len() as u32 {
            if atlas.placements[i].is_some() && atlas.triangle(i as u32, t).is_some() {
                wanted += 0.5
                    * f64::from(
                        WorldTriangle::new(scene, &pose, i as u32, t)
                            .front_cross()
                            .length(),
                    );
            }
        }
    }
    assert!(
        (area / wanted - 1.0).abs() < 1e-3,
        "{area} m² in texels, {wanted} m² in triangles"
    );
    covered as f64 / f64::from(atlas.texels())
}

#[test]
fn texels_of_whole_scenes_are_right() {
    for (name, density) in [
        (Name::Cornell, 40.0),
        (Name::Furnace, 16.0),
        (Name::Conference, 16.0),
    ] {
        let scene = procedural::build(name, Some(3_000), 1);
        let filled = check(&scene, density, &AtlasSettings::default());
        println!("{name:?}: {filled:.2} of the pages is used");
        assert!(filled > 0.5, "{name:?}: {filled} of the pages is used");
    }
}

#[test]
fn the_library_unwraps_too() {
    let scene = procedural::build(Name::Cornell, None, 1);
    check(
        &scene,
        30.0,
        &AtlasSettings {
            unwrap: UnwrapKind::Conformal,
            ..AtlasSettings::default()
        },
    );
}

#[test]
fn large_meshes_take_several_pages() {
    let scene = procedural::build(Name::Conference, Some(3_000), 1);
    let settings = AtlasSettings {
        page_size: 256,
        padding: 1,
        ..AtlasSettings::default()
    };
    let pages = built(&scene, 16.0, &settings).1.atlas.pages.len();
    assert!(pages > 2, "{pages} pages");
    check(&scene, 16.0, &settings);
}

#[test]
fn threads_do_not_show() {
    let scene = procedural::build(Name::Conference, Some(3_000), 1);
    let settings = AtlasSettings::default();
    let many = built(&scene, 16.0, &settings).1.atlas;
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(one.install(|| built(&scene, 16.0, &settings).1.atlas), many);
    assert!(
        many.layouts
            .iter()
            .all(|l: &Layout| l.charts.len() == l.corners.len())
    );
}
