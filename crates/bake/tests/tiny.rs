//! Rays for the texels of tiny charts against lines for all.

use occlude_bake::atlas::{AtlasSettings, build, density};
use occlude_bake::bundle::{self, Triangles};
use occlude_bake::gather::Part;
use occlude_bake::rounds::{Bake, GatherKind, Report, Settings, Stop, Subject};
use occlude_bake::texel::Texels;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{Pose, procedural};

#[test]
fn rays_bring_tiny_texels_what_lines_would() {
    let mut scene = procedural::build(procedural::Name::Cornell, None, 0);
    for material in &mut scene.materials {
        *material = material.diffuse_only();
    }
    let pose = Pose::at(&scene, 0.0);
    // A texel on two metres: all charts are denser than that.
    let densities = density::densities(&scene, &pose, 0.5);
    let built = build(
        &scene,
        &pose,
        &densities,
        &AtlasSettings::default(),
        &Job::new(),
    )
    .unwrap();
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let run = |most_share: f32, seed: u64| {
        let mut triangles = Triangles::with_lines_for(&scene, &pose, &built.atlas, most_share);
        triangles.find_backs(0, &bundle::Settings::default(), &Job::new());
        let subject = Subject {
            world: World {
                geometry: &geometry,
                lights: &lights,
            },
            texels: &texels,
            triangles: Some(&triangles),
            sky: None,
            luminous: true,
        };
        let settings = Settings {
            gather: GatherKind::Bundles,
            part: Part::Indirect,
            bounces: 1,
            directions: 2048,
            reach: f32::INFINITY,
            seed,
            directional: false,
            bundles: bundle::Settings {
                analysis: 64,
                ..bundle::Settings::default()
            },
        };
        let bake = Bake::new(subject, settings, 0, String::new());
        let mut report = Report::default();
        let mut state = bake.begin(0, (0, 1), Vec::new(), Vec::new(), Vec::new());
        loop {
            bake.run_round(
                &mut state,
                Stop::default(),
                &Job::new(),
                &mut report,
                &mut |_| (),
            );
            if bake.is_last(&state) {
                break;
            }
            state = bake.next_round(state, (0, 1));
        }
        let light: Vec<f32> = (0..built.atlas.texels())
            .map(|texel| bake.irradiance(&state, texel).map_or(0.0, |e| e.y))
            .collect();
        (light, report.secondary, report.bundles.fragments)
    };
    // Direct light is random, too, and much of what is compared: the same seed makes it the same.
    let (by_lines, of_direct, fragments) = run(f32::INFINITY, 5);
    let (by_rays, rays, fewer) = run(4.0, 5);
    assert!(rays > of_direct + 1000, "{of_direct} {rays}");
    assert!(fewer < fragments, "{fewer} {fragments}");
    let sum = |light: &[f32]| light.iter().sum::<f32>();
    let (a, b) = (sum(&by_lines), sum(&by_rays));
    assert!((b / a - 1.0).abs() < 0.03, "all: {b} {a}");
    let mean = a / by_lines.iter().filter(|&&e| e > 0.0).count() as f32;
    // A texel of 1000 rays or lines is off by some 4 % of the mean.
    for (texel, (a, b)) in by_lines.iter().zip(&by_rays).enumerate() {
        assert!((a - b).abs() < 0.25 * mean, "{texel}: {b} {a}, mean {mean}");
    }
}
