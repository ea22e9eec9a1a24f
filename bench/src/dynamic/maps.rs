//! Maps and transforms: rays, errors and times, point by point.

use super::stage::Stage;
use crate::common::{Report, Row, Setting, median};
use glam::Vec3;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_visibility::field::{
    DistanceField, DistanceTransform, Hemisphere, Hint, MapSampler, MapSampling, VisibilityMap,
};
use occlude_visibility::{Ray, Tracer};
use std::time::Instant;

const SKY: &str = "kiara_1_dawn_1k.hdr";

/// Scenes with simple, many and slim occluders.
fn stages(setting: &Setting) -> impl Iterator<Item = Stage> + '_ {
    [
        ("dynamic_room", "animated/dynamic_room.glb"),
        ("CesiumMan", "animated/CesiumMan.glb"),
        ("svbrdf_still_life", "svbrdf_still_life.glb"),
        ("sintel_hair", "sintel_hair.glb"),
    ]
    .into_iter()
    .filter_map(|(name, file)| Stage::load(setting, name, file, SKY))
}

/// Microseconds a map, by resolution, on one core.
pub fn transforms(setting: &Setting, report: &mut Report) {
    let title = "Distance transform, one core";
    let header = [
        "scene",
        "texels",
        "us a map",
        "spread",
        "ns a texel",
        "paper's GPU",
        "bar",
    ];
    for stage in stages(setting) {
        let pose = stage.pose(24);
        let Ok(geometry) = Geometry::new(&stage.scene, &pose, &BuildOptions::default()) else {
            continue;
        };
        let points = stage.points(&geometry, &pose, if setting.quick { 8 } else { 32 });
        for side in [64, 128, 256, 512, 1024] {
            let mut sampler = MapSampler::default();
            let sampling = MapSampling {
                start: 16,
                resolution: side,
            };
            let maps: Vec<VisibilityMap> = (points.iter())
                .map(|&(place, normal)| {
                    let hemisphere = Hemisphere::new(normal, Vec3::X);
                    sampler.sample(&geometry, place, &hemisphere, sampling, &[])
                })
                .collect();
            let mut transform = DistanceTransform::default();
            let mut field = DistanceField::default();
            let rounds = (4_000_000 / (side * side * maps.len() as u32)).max(1);
            let times: Vec<f64> = (0..9)
                .map(|_| {
                    let start = Instant::now();
                    for map in (0..rounds).flat_map(|_| &maps) {
                        transform.transform_into(map, std::hint::black_box(&mut field));
                    }
                    start.elapsed().as_secs_f64() * 1e6 / f64::from(rounds) / maps.len() as f64
                })
                .collect();
            let (time, spread) = median(&times);
            let bar = (side == 128).then(|| "<= 60".to_owned());
            report.table(
                title,
                &header,
                vec![
                    stage.name.into(),
                    format!("{side}x{side}"),
                    format!("{time:.1}"),
                    format!("{:.0} %", spread * 100.0),
                    format!("{:.2}", time * 1e3 / f64::from(side * side)),
                    if side == 128 {
                        "21.8".into()
                    } else {
                        String::new()
                    },
                    bar.clone().unwrap_or_default(),
                ],
            );
            report.row(Row {
                name: format!("transform {side}"),
                scene: stage.name.into(),
                value: time,
                unit: "us".into(),
                baseline: None,
                ratio: None,
                spread: Some(spread),
                holds: bar.as_ref().map(|_| time <= 60.0),
                bar,
            });
        }
    }
}

/// Rays and wrong texels of adaptive maps against all rays.
pub fn adaptive(setting: &Setting, report: &mut Report) {
    let title = "Adaptive maps of 128x128 against all rays";
    let header = [
        "scene",
        "start",
        "boundaries of",
        "rays",
        "wrong texels",
        "worst",
        "bar",
    ];
    for stage in stages(setting) {
        let pose = stage.pose(24);
        let Ok(geometry) = Geometry::new(&stage.scene, &pose, &BuildOptions::default()) else {
            continue;
        };
        let points = stage.points(&geometry, &pose, if setting.quick { 16 } else { 96 });
        let side = 128;
        let known: Vec<(Vec3, Hemisphere, VisibilityMap)> = (points.iter())
            .map(|&(place, normal)| {
                let axes = Hemisphere::new(normal, Vec3::X);
                let all = VisibilityMap::from_fn(side, |local| {
                    !geometry.occluded(&Ray::new(place, axes.to_world(local)))
                });
                (place, axes, all)
            })
            .collect();
        for start in [16, 32] {
            let sampling = MapSampling {
                start,
                resolution: side,
            };
            for neighbours in [0, 2] {
                let mut sampler = MapSampler::default();
                let mut alone: Vec<VisibilityMap> = Vec::new();
                for (place, axes, _) in &known {
                    alone.push(sampler.sample(&geometry, *place, axes, sampling, &[]));
                }
                let mut rays = sampler.traced();
                let mut maps = alone.clone();
                if neighbours > 0 {
                    // The nearest points that look the same way, as the integrator has them; their own maps come from above.
                    let mut again = MapSampler::default();
                    for (i, (place, axes, _)) in known.iter().enumerate() {
                        let mut near: Vec<(f32, usize)> = (0..known.len())
                            .filter(|k| *k != i && known[*k].1.normal.dot(axes.normal) > 0.5)
                            .map(|k| ((known[k].0 - *place).length(), k))
                            .collect();
                        near.sort_by(|a, b| a.0.total_cmp(&b.0));
                        let hints: Vec<Hint> = (near.iter().take(neighbours))
                            .map(|&(_, k)| Hint {
                                map: &alone[k],
                                hemisphere: known[k].1,
                            })
                            .collect();
                        maps[i] = again.sample(&geometry, *place, axes, sampling, &hints);
                    }
                    rays = again.traced();
                }
                let wrong: Vec<f32> = (maps.iter().zip(&known))
                    .map(|(map, (_, _, all))| map.difference(all))
                    .collect();
                let mean = wrong.iter().sum::<f32>() / wrong.len().max(1) as f32;
                let worst = wrong.iter().copied().fold(0.0, f32::max);
                let share = rays as f64 / (f64::from(side * side) * known.len().max(1) as f64);
                let holds = share <= 0.25 && mean < 0.005;
                report.table(
                    title,
                    &header,
                    vec![
                        stage.name.into(),
                        format!("{start}x{start}"),
                        if neighbours > 0 {
                            "own, neighbours".into()
                        } else {
                            "own".into()
                        },
                        format!("{:.1} %", share * 100.0),
                        format!("{:.3} %", mean * 100.0),
                        format!("{:.2} %", worst * 100.0),
                        format!(
                            "<= 25 % at < 0.5 %: {}",
                            if holds { "holds" } else { "missed" }
                        ),
                    ],
                );
                report.row(Row {
                    name: format!("rays start {start} neighbours {neighbours}"),
                    scene: stage.name.into(),
                    value: share,
                    unit: "of all".into(),
                    baseline: Some(f64::from(mean)),
                    ratio: None,
                    spread: None,
                    bar: Some("<= 0.25 at under 0.005 wrong".into()),
                    holds: Some(holds),
                });
            }
        }
    }
}
