//! The paper's Fig. 6 and Fig. 10: light that is reflected once, found without tiling, with uniform tiling and with adaptive tiling in equal
//! time, against a map of many more lines; and what overflow does to the map.
//!
//! Linked lists, and whatever finds no room is dropped, as in the paper; the last row does it again.

use super::subject::Subject;
use super::{Ready, ready_subject};
use crate::common::{Report, Setting};
use glam::Vec3;
use occlude_bake::atlas::Atlas;
use occlude_bake::bundle::{self, Cutting, Directions, Layout, MOST_SHARE, Radiance, Settings};
use occlude_bake::sums::Sums;
use occlude_bake::texel::Texels;
use occlude_bvh::BuildOptions;
use occlude_image::metrics::middle_grey_exposure;
use occlude_image::{Look, Picture};
use occlude_render::geometry::{Geometry, WorldTriangle};
use occlude_render::job::Job;
use occlude_visibility::{Ray, Tracer, offset_along_normal};
use rayon::prelude::*;
use std::time::Instant;

/// Where direct light comes from.
enum Lamps {
    /// From far away, towards this.
    Sun(Vec3),
    /// Small lamps.
    Points(Vec<Vec3>),
}

/// What is compared in one scene.
struct Case {
    name: &'static str,
    texels: f64,
    lamps: Lamps,
    /// Where one stands, and what one looks at.
    eye: Vec3,
    target: Vec3,
}

/// W and N: the paper's for a tenth of its texels.
const LINES: u32 = 320;
const NODES: u32 = 500_000;

/// Lines per texel of the reference.
const REFERENCE_FACTOR: f32 = 3.0;

pub fn run(setting: &Setting, report: &mut Report) {
    let quick = setting.quick;
    let cases = [
        Case {
            name: "city",
            texels: if quick { 5e5 } else { 4.5e6 },
            lamps: Lamps::Sun(Vec3::new(-0.5, -0.6, 0.35).normalize()),
            eye: Vec3::new(34.0, 22.0, 40.0),
            target: Vec3::new(0.0, 6.0, 0.0),
        },
        Case {
            name: "holes",
            texels: if quick { 2e5 } else { 2e6 },
            lamps: Lamps::Points(super::subject::hole_lamps()),
            eye: Vec3::new(9.3, 2.2, 5.2),
            target: Vec3::new(5.0, 1.2, 2.0),
        },
    ];
    let directions = setting
        .samples
        .first()
        .copied()
        .unwrap_or(if quick { 16 } else { 64 });
    for case in cases {
        let Some(subject) = ready_subject(setting, report, case.name) else {
            continue;
        };
        if let Err(error) = compare(setting, report, &case, &subject, directions) {
            report.note(format!("SKIPPED {}: {error}", case.name));
        }
    }
}

fn compare(
    setting: &Setting,
    report: &mut Report,
    case: &Case,
    subject: &Subject,
    directions: u32,
) -> Result<(), String> {
    let (atlas, _) = subject.atlas(case.texels)?;
    let geometry = Geometry::new(&subject.scene, &subject.pose, &BuildOptions::default())
        .map_err(|error| error.to_string())?;
    let direct = direct(subject, &atlas, &geometry, &case.lamps);
    let brightest = direct.iter().copied().fold(1e-6, f32::max);
    let mut ready = Ready::new(subject, &atlas, MOST_SHARE);
    let sides = ready.triangles.sides().count();
    ready.radiance = Radiance::new(sides, brightest, |side| {
        Vec3::splat(direct.get(side as usize).copied().unwrap_or(0.0))
    });
    let gather = |settings: &Settings, seed: u64, count: u32| {
        let sums = Sums::new(sides, bundle::unit(brightest, count));
        let clock = Instant::now();
        let stats = bundle::gather(
            &ready.triangles,
            &ready.radiance,
            None,
            &Directions { seed, round: 0 },
            0..count,
            settings,
            &Job::new(),
            &sums,
        );
        let seconds = clock.elapsed().as_secs_f64() / f64::from(count);
        let map: Vec<f32> = (0..atlas.texels())
            .map(|texel| sums.irradiance(texel).map_or(0.0, |e| e.x))
            .collect();
        let known = (0..atlas.texels()).filter(|&t| sums.weight(t) > 0.0);
        (map, stats, seconds, known.count())
    };
    let adaptive = Settings {
        lines: LINES,
        nodes: NODES,
        layout: Layout::LinkedList,
        recover: false,
        ..Settings::default()
    };
    let uniform = |levels: u32| Settings {
        cutting: Cutting::Uniform(levels),
        ..adaptive
    };
    gather(&adaptive, 0, 1);
    let budget = gather(&adaptive, 0, 4).2;
    // Tiles are counted in fours: the number whose time is nearest.
    let mut levels = (1, f64::INFINITY);
    for n in 1..=6 {
        let off = (gather(&uniform(n), 0, 2).2 / budget).ln().abs();
        if off > levels.1 {
            break;
        }
        levels = (n, off);
    }
    let finer = Settings {
        factor: REFERENCE_FACTOR,
        ..Settings::default()
    };
    let (reference, .., coverable) = gather(&finer, 1, 3 * directions);
    let square = |e: f32| f64::from(e) * f64::from(e);
    let lit = reference.iter().filter(|&&e| e > 0.0).count().max(1) as f64;
    let energy = reference.iter().map(|&e| square(e)).sum::<f64>() / lit;
    let recovered = Settings {
        recover: true,
        ..adaptive
    };
    let rows = [
        ("no tiling".to_owned(), uniform(0)),
        (
            format!("uniform, {} tiles", 4u32.pow(levels.0)),
            uniform(levels.0),
        ),
        ("adaptive".to_owned(), adaptive),
        ("adaptive, overflow done again".to_owned(), recovered),
    ];
    let mut pictures = Vec::new();
    let mut maps = Vec::new();
    for (what, settings) in rows {
        let (map, stats, seconds, known) = gather(&settings, 0, directions);
        let errors = map.iter().zip(&reference).map(|(a, b)| square(a - b));
        let error = errors.sum::<f64>() / lit / energy;
        let nodes = (stats.fragments + stats.overflow_left).max(1) as f64;
        report.table(
            "Figure 6: tilings, light reflected once",
            &[
                "scene",
                "texels",
                "tiling",
                "directions",
                "tiles",
                "M lines",
                "ms a direction",
                "overflow",
                "texels met",
                "MSE / mean square",
            ],
            vec![
                case.name.into(),
                atlas.texels().to_string(),
                what.clone(),
                directions.to_string(),
                (stats.tiles / stats.directions).to_string(),
                format!("{:.2}", stats.lines as f64 / stats.directions as f64 / 1e6),
                format!("{:.0}", seconds * 1e3),
                format!("{:.2e} %", 100.0 * stats.overflow_left as f64 / nodes),
                format!("{:.1} %", 100.0 * known as f64 / coverable as f64),
                format!("{error:.2e}"),
            ],
        );
        pictures.push(view(case, &geometry, &atlas, &map));
        maps.push(map);
    }
    let pairs = maps[2].iter().zip(&maps[3]);
    let off = pairs.map(|(a, b)| square(a - b)).sum::<f64>() / lit / energy;
    report.note(format!(
        "{}: Fig. 10: what overflow changes in the map of {directions} directions: {off:.2e} of the mean square",
        case.name
    ));
    pictures.push(view(case, &geometry, &atlas, &reference));
    let look = Look {
        exposure_ev: middle_grey_exposure(&pictures[4]),
        ..Look::default()
    };
    std::fs::create_dir_all(&setting.out).map_err(|error| error.to_string())?;
    let file = format!("tiling-{}.png", case.name);
    let all = beside(&pictures);
    occlude_image::write(&setting.out.join(&file), &all, look).map_err(|e| e.to_string())?;
    report.figure(
        &format!(
            "Fig. 6, {}: light reflected once, {directions} directions: no tiling, uniform, adaptive, adaptive with overflow done again, reference",
            case.name
        ),
        format!("<img src=\"{file}\" alt=\"tilings of {}\">", case.name),
    );
    Ok(())
}

/// Radiance of every texel's front in direct light, albedo 1 / pi.
fn direct(subject: &Subject, atlas: &Atlas, geometry: &Geometry, lamps: &Lamps) -> Vec<f32> {
    let texels = Texels::new(&subject.scene, &subject.pose, atlas);
    let bands: Vec<_> = texels.bands(32).collect();
    let found: Vec<Vec<(u32, f32)>> = bands
        .into_par_iter()
        .map(|(page, rows)| {
            let band = texels.band(page, rows);
            let light = |i: usize| {
                let hit = texels.representative(&band, i);
                let world =
                    WorldTriangle::new(&subject.scene, &subject.pose, hit.instance, hit.primitive);
                let normal = world.front_cross().normalize_or_zero();
                let at = offset_along_normal(world.point(hit.u, hit.v), normal, world.extent());
                let from = |ray: Ray, falloff: f32| {
                    let cosine = ray.direction.normalize().dot(normal);
                    if cosine > 0.0 && !geometry.occluded(&ray) {
                        cosine * falloff
                    } else {
                        0.0
                    }
                };
                match lamps {
                    Lamps::Sun(towards) => from(Ray::new(at, -*towards), 1.0),
                    Lamps::Points(lamps) => {
                        let one = |&lamp: &Vec3| {
                            let way = lamp - at;
                            let ray = Ray {
                                t_max: 0.999,
                                ..Ray::new(at, way)
                            };
                            from(ray, 1.0 / way.length_squared())
                        };
                        lamps.iter().map(one).sum()
                    }
                }
            };
            (0..band.len()).map(|i| (band.texel(i), light(i))).collect()
        })
        .collect();
    let mut all = vec![0.0; atlas.texels() as usize];
    for (texel, light) in found.into_iter().flatten() {
        all[texel as usize] = light;
    }
    all
}

/// The map as one sees it, texel by texel.
fn view(case: &Case, geometry: &Geometry, atlas: &Atlas, map: &[f32]) -> Picture {
    let mut picture = Picture::new(400, 400);
    let forward = (case.target - case.eye).normalize();
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let width = picture.width as usize;
    let rows = picture.pixels.par_chunks_mut(width).enumerate();
    rows.for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let mut sum = 0.0;
            for k in 0..4 {
                let (dx, dy) = (0.25 + 0.5 * (k % 2) as f32, 0.25 + 0.5 * (k / 2) as f32);
                let at = |p: usize, d: f32| (p as f32 + d) / width as f32 - 0.5;
                let direction = forward + right * at(x, dx) - up * at(y, dy);
                let mut hits = [None];
                geometry.closest_batch(&[Ray::new(case.eye, direction)], &mut hits);
                let texel =
                    hits[0].and_then(|hit| atlas.texel(hit.instance, hit.primitive, hit.u, hit.v));
                sum += texel.map_or(0.0, |texel| map[texel as usize]);
            }
            *pixel = [0.25 * sum; 3];
        }
    });
    picture
}

fn beside(pictures: &[Picture]) -> Picture {
    let (width, height) = (pictures[0].width, pictures[0].height);
    let mut all = Picture::new(width * pictures.len() as u32, height);
    for y in 0..height {
        for (k, picture) in pictures.iter().enumerate() {
            let row = &picture.pixels[(y * width) as usize..][..width as usize];
            let at = (y * all.width + k as u32 * width) as usize;
            all.pixels[at..at + width as usize].copy_from_slice(row);
        }
    }
    all
}
