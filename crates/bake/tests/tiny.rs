//! Rays for the texels of tiny charts against lines for all.

use occlude_bake::atlas::{AtlasSettings, build, density};
use occlude_bake::bundle::{self, Triangles};
use occlude_bake::gather::Part;
use occlude_bake::rounds::{Bake, GatherKind, Report, Settings, Stop, Subject};
use occlude_bake::state::Before;
use occlude_bake::store::Store;
use occlude_bake::texel::Texels;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{Pose, procedural};
use occlude_testkit::estimate::Estimate;

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
    // Every chart is smaller than a texel; those that are only touched have had a line or none: not compared.
    let covered = texels.bands(64).flat_map(|(page, rows)| {
        let band = texels.band(page, rows);
        let of = |i: usize| {
            let share: f32 = band.fragments(i).iter().map(|f| f.area).sum();
            (share > 1e-3).then(|| (band.texel(i), texels.world_area(&band, i)))
        };
        (0..band.len()).filter_map(of).collect::<Vec<_>>()
    });
    let areas: Vec<(u32, f32)> = covered.collect();
    assert!(areas.len() > 10);
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
            directions: 256,
            reach: f32::INFINITY,
            seed,
            directional: false,
            spots: f32::INFINITY,
            bundles: bundle::Settings {
                analysis: 64,
                // A wall is a texel here: many lines for it cost nothing.
                factor: 16.0,
                ..bundle::Settings::default()
            },
        };
        let bake = Bake::new(subject, settings, Store::memory(), 0, String::new()).unwrap();
        let mut report = Report::default();
        let mut state = bake.begin(0, (0, 1), Before::default()).unwrap();
        loop {
            bake.run_round(
                &mut state,
                Stop::default(),
                &Job::new(),
                &mut report,
                &mut |_| (),
            )
            .unwrap();
            if bake.is_last(&state) {
                break;
            }
            state = bake.next_round(state, (0, 1)).unwrap();
        }
        let light: Vec<f32> = (areas.iter())
            .map(|&(texel, _)| bake.irradiance(&state, texel).map_or(0.0, |e| e.y))
            .collect();
        (light, report.secondary, report.bundles.fragments)
    };
    // Direct light is random, too, and much of what is compared: the same seed makes it the same, so differences are compared.
    let mut differences: Vec<Vec<f64>> = Vec::new();
    let mut sum = 0.0;
    for seed in 0..8 {
        let (by_lines, of_direct, fragments) = run(f32::INFINITY, seed);
        let (by_rays, rays, fewer) = run(4.0, seed);
        assert!(rays > of_direct + 1000, "{of_direct} {rays}");
        assert!(fewer < fragments, "{fewer} {fragments}");
        // Power: irradiance times area.
        let pairs = by_rays.iter().zip(&by_lines).zip(&areas);
        differences.push(pairs.map(|((b, a), t)| f64::from((b - a) * t.1)).collect());
        let pairs = by_lines.iter().zip(&areas);
        sum += pairs.map(|(e, t)| f64::from(e * t.1)).sum::<f64>();
    }
    let seeds = differences.len() as f64;
    let all = Estimate::of(differences.iter().map(|run| run.iter().sum()));
    let (off, error) = (all.mean * seeds / sum, all.variance.sqrt() * seeds / sum);
    println!("all: {off:.4} +- {error:.4} of the sum");
    // Texels share directions, so many of them do not help: one false alarm in a thousand runs, and a difference of a twentieth would be found.
    assert!(
        all.same(&Estimate::exact(0.0)) > 1e-3 && error < 0.01,
        "{off} +- {error}"
    );
    let ones = (0..areas.len()).map(|texel| Estimate::of(differences.iter().map(|run| run[texel])));
    let least = ones
        .map(|one| one.same(&Estimate::exact(0.0)))
        .fold(1.0, f64::min);
    println!("{} texels: least probability {least:.1e}", areas.len());
    assert!(least > 1e-3 / areas.len() as f64, "{least}");
}
