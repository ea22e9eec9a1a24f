//! Spots that are gathered by aimed rays, against lines for all light, and against paths.

mod support;

use glam::Vec3;
use occlude_bake::atlas::{AtlasSettings, build as build_atlas};
use occlude_bake::bundle::{self, Triangles};
use occlude_bake::gather::Part;
use occlude_bake::rounds::{Bake, GatherKind, Report, SPOTS, Settings, Stop, Subject};
use occlude_bake::state::Before;
use occlude_bake::store::Store;
use occlude_bake::texel::Texels;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{LightKind, Pose, PosedLight};
use occlude_testkit::estimate::Estimate;
use support::{Build, matt};

/// A room with two lamps a few centimetres below the ceiling, and a leaf that is seen from both sides.
#[test]
fn spots_bring_the_same_light_with_less_noise() {
    let mut build = Build::default();
    build.room(
        Vec3::ZERO,
        Vec3::new(3.0, 2.4, 2.5),
        [[1; 2]; 6],
        &matt(0.6),
    );
    build.rectangle(
        Vec3::new(1.8, 0.9, 1.2),
        Vec3::new(0.3, 0.0, 0.3),
        Vec3::Y * 0.5,
        None,
        matt(0.7),
    );
    let scene = &build.scene;
    let mut pose = Pose::at(scene, 0.0);
    // Of the ceiling texels of 6 cm: as small as what the lamps light.
    let densities: Vec<_> = (0..7)
        .map(|k| Some(if k == 3 { 16.0 } else { 4.0 }))
        .collect();
    let atlas_settings = AtlasSettings::default();
    let built = build_atlas(scene, &pose, &densities, &atlas_settings, &Job::new()).unwrap();
    let atlas = built.atlas;
    for (position, intensity) in [
        (Vec3::new(0.8, 2.34, 1.1), Vec3::new(2.0, 1.0, 0.5)),
        (Vec3::new(2.2, 2.35, 1.9), Vec3::new(0.5, 1.0, 2.0)),
    ] {
        pose.lights.push(PosedLight {
            position,
            direction: -Vec3::Y,
            intensity,
            kind: LightKind::Point,
        });
    }
    let geometry = Geometry::new(scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(scene, &pose, None, LightSelection::Tree);
    let fitted = Texels::new(scene, &pose, &atlas);
    let bundle_settings = bundle::Settings {
        analysis: 64,
        ..bundle::Settings::default()
    };
    let mut triangles = Triangles::new(scene, &pose, &atlas);
    triangles.find_backs(0, &bundle_settings, &Job::new());
    let covered: Vec<u32> = (fitted.bands(64))
        .flat_map(|(page, rows)| {
            let band = fitted.band(page, rows);
            (0..band.len()).map(|i| band.texel(i)).collect::<Vec<_>>()
        })
        .collect();
    let run = |gather: GatherKind, spots: f32, directions: u32, seed: u64| {
        let subject = Subject {
            world: World {
                geometry: &geometry,
                lights: &lights,
            },
            texels: &fitted,
            triangles: (gather == GatherKind::Bundles).then_some(&triangles),
            sky: None,
            luminous: false,
        };
        let settings = Settings {
            gather,
            part: Part::Indirect,
            bounces: 2,
            directions,
            reach: f32::INFINITY,
            seed,
            directional: true,
            spots,
            bundles: bundle_settings,
        };
        let bake = Bake::new(subject, settings, Store::memory(), 0, String::new()).unwrap();
        let mut state = bake.begin(0, (0, 1), Before::default()).unwrap();
        let (job, mut report) = (Job::new(), Report::default());
        loop {
            let rest = &mut |_: &_| ();
            bake.run_round(&mut state, Stop::default(), &job, &mut report, rest)
                .unwrap();
            if bake.is_last(&state) {
                break;
            }
            state = bake.next_round(state, (0, 1)).unwrap();
        }
        assert_eq!(
            state.before.bound.is_finite(),
            gather == GatherKind::Bundles && spots.is_finite()
        );
        covered
            .iter()
            .map(|&texel| {
                let light = bake.irradiance(&state, texel).unwrap_or_default();
                (light.y, bake.moment(&state, texel).y)
            })
            .collect::<Vec<_>>()
    };
    let seeds = 8;
    let of = |gather, spots, directions| -> Vec<Vec<(f32, f32)>> {
        (0..seeds)
            .map(|seed| run(gather, spots, directions, seed))
            .collect()
    };
    let aimed = of(GatherKind::Bundles, SPOTS, 96);
    let lines = of(GatherKind::Bundles, f32::INFINITY, 96);
    let paths = of(GatherKind::Path, f32::INFINITY, 128);
    // Blocks of texels: light, and moments.
    let block = |runs: &[Vec<(f32, f32)>], block: usize, moments: bool| {
        Estimate::of(runs.iter().map(|run| {
            let part = run[32 * block..].iter().take(32);
            part.map(|&(light, moment)| f64::from(if moments { moment } else { light }))
                .sum::<f64>()
        }))
    };
    let blocks = aimed[0].len().div_ceil(32);
    let mut least = 1.0_f64;
    for k in 0..blocks {
        for moments in [false, true] {
            let same = block(&aimed, k, moments).same(&block(&paths, k, moments));
            least = least.min(same);
        }
    }
    println!("{blocks} blocks: least probability {least:.1e}");
    assert!(least > 1e-4 / (2 * blocks) as f64, "{least}");
    // And all of them together.
    let total = |runs: &[Vec<(f32, f32)>]| {
        Estimate::of(
            runs.iter()
                .map(|run| run.iter().map(|t| f64::from(t.0)).sum::<f64>()),
        )
    };
    let totals = [&aimed, &lines, &paths].map(|runs| total(runs));
    for one in totals {
        println!("{:.3} +- {:.3}", one.mean, one.variance.sqrt());
    }
    assert!(totals[0].same(&totals[2]) > 1e-3, "{totals:?}");
    // The variance of single texels.
    let variance = |runs: &[Vec<(f32, f32)>]| -> f64 {
        let texels = (0..aimed[0].len()).map(|texel| {
            let one = Estimate::of(runs.iter().map(|run| f64::from(run[texel].0)));
            one.variance / (one.mean * one.mean).max(1e-12)
        });
        texels.sum()
    };
    let (with, without) = (variance(&aimed), variance(&lines));
    println!("variance with spots {with:.3}, without {without:.3}");
    assert!(with < 0.25 * without, "{with} {without}");
}
