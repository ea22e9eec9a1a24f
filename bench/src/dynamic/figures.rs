//! Pictures beside a reference, setting after setting: Figs. 4 to 6 of the paper on our scenes, and the causes of error one by one.

use super::frames::{errors, save};
use super::stage::{Reel, Shot, Stage, as_environment};
use super::studies::{of_paper, row, size};
use crate::common::{Report, Setting};
use glam::{Vec2, Vec3};
use occlude_bvh::BuildOptions;
use occlude_image::Picture;
use occlude_image::metrics::relmse;
use occlude_render::geometry::{Geometry, Surface};
use occlude_render::integrator::{Field, Integrator};
use occlude_render::light::SkyLobes;
use occlude_scene::AlphaMode;
use occlude_visibility::field::{Hemisphere, MapSampler, MapSampling, SphericalGaussian};
use occlude_visibility::offset_along_normal;
use rayon::prelude::*;

/// The frame that is shown.
const FRAME: u32 = 30;

/// A scene under some lobes, what its picture should be, and a table of how far others are from it.
struct Beside<'a> {
    setting: &'a Setting,
    report: &'a mut Report,
    title: &'a str,
    /// The first columns, which say what was set.
    set: &'a [&'a str],
    stage: &'a Stage,
    size: [u32; 2],
    light: &'a SkyLobes,
    reference: Picture,
}

impl Beside<'_> {
    /// Renders by fields and adds a row; its name also names the picture.
    fn shoot(&mut self, name: &str, set: Vec<String>, field: Field) {
        let sky = as_environment(self.light);
        let work = (Integrator::Field(field), 1, 0);
        let shot: Shot =
            (self.stage).shoot(FRAME, self.size, &sky, &mut Reel::under(self.light), work);
        let known = shot.report.field.unwrap_or_default();
        let (flip, energy) = errors(&shot.picture, &self.reference);
        let error = relmse(&shot.picture, &self.reference).unwrap_or(f64::NAN);
        let squares = relative_squares(&shot.picture, &self.reference);
        let measures = [
            "points",
            "MB",
            "FLIP",
            "relative squares",
            "relMSE",
            "energy",
        ];
        let header: Vec<&str> = (["scene"].iter().chain(self.set).chain(&measures))
            .copied()
            .collect();
        let mut cells = vec![self.stage.name.to_owned()];
        cells.extend(set);
        cells.extend([
            known.points.to_string(),
            format!("{:.1}", known.bytes as f64 / 1e6),
            format!("{flip:.4}"),
            format!("{squares:.5}"),
            format!("{error:.5}"),
            format!("{:+.2} %", energy * 100.0),
        ]);
        self.report.table(self.title, &header, cells);
        row(
            self.report,
            format!("FLIP, {name}"),
            self.stage.name,
            flip,
            "",
            None,
        );
        self.keep(name, &shot.picture);
    }

    fn keep(&self, name: &str, picture: &Picture) {
        let name = format!("{}_{}.png", self.stage.name, name.replace(' ', "_"));
        save(self.setting, &name, picture);
    }
}

/// The sum of squared differences over that of the reference's squares: unlike relMSE not governed by what is nearly black.
fn relative_squares(picture: &Picture, reference: &Picture) -> f64 {
    let pairs = (picture.pixels.iter().flatten()).zip(reference.pixels.iter().flatten());
    let (wrong, all) = pairs.fold((0.0, 0.0), |(wrong, all), (&a, &b)| {
        let (a, b) = (f64::from(a), f64::from(b));
        (wrong + (a - b) * (a - b), all + b * b)
    });
    wrong / all
}

/// Figs. 4 and 5: points and error after every pass of insertion.
pub fn passes(setting: &Setting, report: &mut Report) {
    for stage in of_paper(setting) {
        let (size, light) = (size(setting), stage.lobes());
        let samples = if setting.quick { 64 } else { 512 };
        let mut beside = Beside {
            setting,
            report,
            title: "Error by passes of insertion (Figs. 4 and 5), frame 30",
            set: &["passes"],
            stage: &stage,
            size,
            light: &light,
            reference: stage.traced(FRAME, size, &light, samples),
        };
        for passes in 0..=6 {
            let field = Field {
                rounds: [passes, 1],
                ..Field::default()
            };
            beside.shoot(&format!("passes {passes}"), vec![passes.to_string()], field);
        }
    }
}

/// Fig. 6: thresholds and resolutions on matt grey surfaces under one light, against a map of 256 by 256 texels for every pixel.
pub fn grid(setting: &Setting, report: &mut Report) {
    for mut stage in of_paper(setting) {
        for material in &mut stage.scene.materials {
            (material.metallic, material.specular, material.roughness) = (0.0, 0.0, 1.0);
            material.base_color = Vec3::splat(GREY).extend(1.0);
            material.base_color_texture = None;
            material.metallic_roughness_texture = None;
            material.normal = None;
            material.alpha_mode = AlphaMode::Opaque;
        }
        let lobe = SphericalGaussian {
            axis: Vec3::new(0.5, 0.8, 0.3).normalize(),
            sharpness: 60.0,
            amplitude: Vec3::splat(12.0),
        };
        let light = SkyLobes {
            lobes: vec![lobe],
            ..SkyLobes::default()
        };
        let size = size(setting);
        let mut beside = Beside {
            setting,
            report,
            title: "Thresholds and resolutions (Fig. 6): matt surfaces, one lobe of light, frame 30, against a map of 256x256 for every pixel",
            set: &["E_v,max", "texels"],
            stage: &stage,
            size,
            light: &light,
            reference: a_map_a_pixel(&stage, size, &lobe),
        };
        beside.keep("grid_reference", &beside.reference);
        for threshold in [0.4, 0.2, 0.1, 0.05] {
            for resolution in [64, 128, 256] {
                let field = Field {
                    insert_above: threshold,
                    erase_below: 0.5 * threshold,
                    resolution,
                    // As the reference: the middle of every pixel.
                    edge_samples: 0,
                    ..Field::default()
                };
                let percent = format!("{:.0}", threshold * 100.0);
                let set = vec![format!("{percent} %"), resolution.to_string()];
                beside.shoot(&format!("grid {percent} {resolution}"), set, field);
            }
        }
    }
}

/// Base colour of all surfaces of [`grid`].
const GREY: f32 = 0.6;

/// What matt grey surfaces look like under a lobe in the middles of pixels, each by a map of its own and a sum over its texels: no field, no
/// interpolation, no approximation of visibility but the map's 0.7 degrees.
fn a_map_a_pixel(stage: &Stage, size: [u32; 2], lobe: &SphericalGaussian) -> Picture {
    const SIDE: u32 = 256;
    /// The lobe ends where it has fallen to exp(-9).
    const EXPONENT: f32 = 9.0;
    let sampling = MapSampling {
        start: 32,
        resolution: SIDE,
    };
    let step = std::f32::consts::PI / SIDE as f32;
    // Directions of texels, and their solid angles times the cosine to the normal.
    let texels: Vec<(Vec3, f32)> = (0..SIDE * SIDE)
        .map(|i| {
            let w = Hemisphere::texel(SIDE, (i / SIDE) as usize, (i % SIDE) as usize);
            (w, (1.0 - w.z * w.z).max(0.0).sqrt() * step * step * w.y)
        })
        .collect();
    let pose = stage.pose(FRAME);
    let options = BuildOptions::default();
    let geometry = Geometry::new(&stage.scene, &pose, &options).expect("a scene with triangles");
    let view = stage.view(&pose, size);
    let light = |sampler: &mut MapSampler, index: u32| {
        let place = Vec2::new((index % size[0]) as f32, (index / size[0]) as f32) + 0.5;
        let ray = view.ray(place).ray;
        let mut hit = [None];
        geometry.closest_batch(&[ray], &mut hit);
        let seen = hit[0].and_then(|hit| Surface::new(&geometry, hit, -ray.direction));
        let Some(surface) = seen else {
            return lobe.at(ray.direction);
        };
        let normal = surface.shading_normal();
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let hemisphere = Hemisphere::new(normal, normal.any_orthonormal_vector());
        let map = sampler.sample(&geometry, origin, &hemisphere, sampling, &[]);
        let axis = hemisphere.to_local(lobe.axis);
        let mut sum = 0.0;
        for (index, (w, weight)) in texels.iter().enumerate() {
            let exponent = lobe.sharpness * (axis.dot(*w) - 1.0);
            let (row, column) = (index / SIDE as usize, index % SIDE as usize);
            if exponent > -EXPONENT && map.get(row, column) {
                sum += exponent.exp() * weight;
            }
        }
        lobe.amplitude * (sum * GREY * std::f32::consts::FRAC_1_PI)
    };
    let pixels = (0..size[0] * size[1])
        .into_par_iter()
        .map_init(MapSampler::default, |sampler, index| {
            light(sampler, index).to_array()
        });
    Picture {
        width: size[0],
        height: size[1],
        pixels: pixels.collect(),
    }
}

/// Where the error comes from: one cause after the other is switched off.
pub fn causes(setting: &Setting, report: &mut Report) {
    let usual = Field::default();
    let finer = Field {
        insert_above: 0.025,
        erase_below: 0.0125,
        rounds: [10, 1],
        most_points: 32_768,
        ..usual
    };
    let ways = [
        ("defaults", usual),
        (
            "maps of 256",
            Field {
                resolution: 256,
                ..usual
            },
        ),
        (
            "three lobes a reflection",
            Field {
                gloss_lobes: 3,
                ..usual
            },
        ),
        ("a quarter of the threshold", finer),
        (
            "pixels by themselves",
            Field {
                shared: false,
                ..usual
            },
        ),
        (
            "sixteen samples at edges",
            Field {
                edge_samples: 16,
                ..usual
            },
        ),
        (
            "cells instead of half-spaces",
            Field {
                cells: true,
                ..usual
            },
        ),
        (
            "all of these",
            Field {
                resolution: 256,
                gloss_lobes: 3,
                edge_samples: 16,
                cells: true,
                ..finer
            },
        ),
    ];
    let size = setting.size.unwrap_or([80, 60]);
    for stage in of_paper(setting) {
        let light = stage.lobes();
        let samples = if setting.quick { 256 } else { 2048 };
        let mut beside = Beside {
            setting,
            report,
            title: "Causes of error against paths under the same lobes (frame 30)",
            set: &["with"],
            stage: &stage,
            size,
            light: &light,
            reference: stage.traced(FRAME, size, &light, samples),
        };
        for (name, field) in ways {
            beside.shoot(name, vec![name.to_owned()], field);
        }
    }
}
