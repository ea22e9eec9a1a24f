//! Pictures: how soon the path tracer's error is small.
//!
//! Efficiency is `1 / (relMSE x seconds)`: with independent samples it does not depend on their number, and the ratio of two
//! efficiencies is the inverse ratio of the times to equal error. The squared error is estimated as `(t - a) (t - b)` with
//! two independent references `a` and `b`: its expectation is `(t - truth)^2`, whatever noise the references have left.

pub mod many_lights;

use crate::common::{Report, Row, Setting, median};
use occlude_bvh::BuildOptions;
use occlude_image::metrics::compare;
use occlude_image::{Encoding, Look, Named, Picture, write_report};
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{Integrator, PathLimits, RenderSettings, World, render};
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_render::sampling::SamplerKind;
use occlude_scene::{Pose, Scene};
use occlude_visibility::Exact;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const SCENES: [&str; 4] = ["sponza", "white_room", "bedroom", "apartment"];

/// Seeds of the references: far from those of the pictures that are judged, which count from 1.
const REFERENCE_SEEDS: [u64; 2] = [1_000_001, 1_000_002];

/// When a rendering stops.
#[derive(Clone, Copy)]
enum Until {
    Samples(u32),
    Time(Duration),
}

/// What one rendering gave and took.
struct Shot {
    picture: Picture,
    seconds: f64,
    samples: u32,
}

/// A scene ready to be rendered.
struct Stage<'a> {
    geometry: &'a Geometry<'a>,
    view: View,
}

impl Stage<'_> {
    fn shoot(&self, lights: &Lights, max_depth: u32, until: Until, seed: u64) -> Shot {
        let world = World {
            geometry: self.geometry,
            lights,
        };
        let (samples, time_limit) = match until {
            Until::Samples(n) => (n, None),
            Until::Time(limit) => (1 << 16, Some(limit)),
        };
        let settings = RenderSettings {
            integrator: Integrator::Path(PathLimits::new(max_depth)),
            sampler: SamplerKind::default(),
            filter: PixelFilter::Box,
            seed,
            samples: 0..samples,
            time_limit,
            noise: None,
        };
        let mut film = Film::new(self.view.width(), self.view.height(), false);
        let start = Instant::now();
        render(
            &world,
            &self.view,
            &Exact,
            &settings,
            &mut film,
            &Job::new(),
            &mut |_| (),
        );
        let seconds = start.elapsed().as_secs_f64();
        Shot {
            samples: film.min_samples(),
            picture: Picture {
                width: film.width(),
                height: film.height(),
                pixels: film.develop().radiance,
            },
            seconds,
        }
    }

    fn references(&self, lights: &Lights, max_depth: u32, samples: u32) -> [Picture; 2] {
        REFERENCE_SEEDS.map(|seed| {
            let until = Until::Samples(samples);
            self.shoot(lights, max_depth, until, seed).picture
        })
    }
}

/// Relative squared error of `t`, free of the references' noise; and the same without the worst 0.1 % of the pixels, which
/// says how much of it a few bright ones make.
fn relative_error(t: &Picture, [a, b]: &[Picture; 2]) -> (f64, f64) {
    let channels = |p: &Picture| -> Vec<f64> {
        let flat = p.pixels.as_flattened();
        flat.iter().map(|&v| f64::from(v)).collect()
    };
    let (t, a, b) = (channels(t), channels(a), channels(b));
    let mean = a.iter().chain(&b).sum::<f64>() / (2 * a.len()) as f64;
    let mut errors: Vec<f64> = Vec::with_capacity(t.len() / 3);
    for ((t, a), b) in t.chunks(3).zip(a.chunks(3)).zip(b.chunks(3)) {
        let of = |c: usize| {
            let reference = 0.5 * (a[c] + b[c]) / mean;
            (t[c] - a[c]) * (t[c] - b[c]) / (mean * mean) / (reference * reference + 0.01)
        };
        errors.push((of(0) + of(1) + of(2)) / 3.0);
    }
    let n = errors.len() as f64;
    let all = errors.iter().sum::<f64>() / n;
    errors.sort_by(f64::total_cmp);
    let kept = &errors[..errors.len() - (errors.len() / 1000).max(1)];
    (all, kept.iter().sum::<f64>() / kept.len() as f64)
}

fn average([a, b]: &[Picture; 2]) -> Picture {
    let mut mean = a.clone();
    for (m, b) in mean.pixels.iter_mut().zip(&b.pixels) {
        *m = std::array::from_fn(|c| 0.5 * (m[c] + b[c]));
    }
    mean
}

/// Writes `NAME.html` (both pictures, their difference, FLIP) and `NAME.png`.
fn show(out: &Path, name: &str, t: &Picture, reference: &Picture) -> Result<(), String> {
    std::fs::create_dir_all(out).map_err(|e| format!("{}: {e}", out.display()))?;
    let compared = compare(t, reference, Encoding::SceneLinear).map_err(|e| e.to_string())?;
    let page = out.join(format!("{name}.html"));
    let (t, reference) = (
        Named { name, picture: t },
        Named {
            name: "two references, averaged",
            picture: reference,
        },
    );
    write_report(&page, t, reference, Encoding::SceneLinear, &compared)
        .map_err(|e| e.to_string())?;
    let look = Look {
        exposure_ev: occlude_image::metrics::middle_grey_exposure(reference.picture),
        ..Look::default()
    };
    occlude_image::write(&out.join(format!("{name}.png")), t.picture, look)
        .map_err(|e| e.to_string())
}

/// The files of a suite: its own scenes by name, or those that `--only` names by path.
fn files(setting: &Setting) -> Vec<(String, PathBuf)> {
    let own = SCENES
        .iter()
        .filter(|name| setting.wants(name))
        .map(|name| {
            (
                (*name).to_owned(),
                setting.scenes.join(format!("{name}.glb")),
            )
        });
    let given = setting.only.iter().map(PathBuf::from);
    let given = given.filter(|path| path.extension().is_some()).map(|path| {
        let stem = path.file_stem().unwrap_or_default();
        (stem.to_string_lossy().into_owned(), path)
    });
    own.chain(given).collect()
}

/// Measures and reports.
pub fn run(setting: &Setting) -> Report {
    let mut report = Report::new(
        "Pictures: time to equal error",
        "scene,repetition,samples,seconds,relmse,trimmed",
    );
    for (name, path) in files(setting) {
        if let Err(why) = measure(setting, &mut report, &name, &path) {
            report.note(format!("SKIPPED {name}: {why}"));
        }
    }
    report
}

fn measure(setting: &Setting, report: &mut Report, name: &str, path: &Path) -> Result<(), String> {
    const MAX_DEPTH: u32 = 7;
    let (size, repetitions, samples, reference_samples) = if setting.quick {
        (128, 3, 8, 32)
    } else {
        (512, 5, 16, 64)
    };
    if !path.exists() {
        return Err(format!("{} is not there", path.display()));
    }
    let start = Instant::now();
    let scene = Scene::load(path, None, None).map_err(|e| e.to_string())?;
    let pose = Pose::at(&scene, 0.0);
    let load = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let geometry =
        Geometry::new(&scene, &pose, &BuildOptions::default()).map_err(|e| e.to_string())?;
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let build = start.elapsed().as_secs_f64();
    if scene.cameras.is_empty() {
        return Err("it has no camera".into());
    }
    let stage = Stage {
        geometry: &geometry,
        view: View::of_camera(&scene, &pose, 0, size, size),
    };
    let references = stage.references(&lights, MAX_DEPTH, reference_samples);

    let mut last = None;
    let (mut seconds, mut errors, mut trimmed) = (Vec::new(), Vec::new(), Vec::new());
    for repetition in 1..=repetitions {
        let until = Until::Samples(samples);
        let shot = stage.shoot(&lights, MAX_DEPTH, until, repetition);
        let (error, rest) = relative_error(&shot.picture, &references);
        let time = build + shot.seconds;
        report.raw(&format!(
            "{name},{repetition},{},{time:.4},{error:.6},{rest:.6}",
            shot.samples
        ));
        seconds.push(time);
        errors.push(error);
        trimmed.push(rest);
        last = Some(shot.picture);
    }
    let efficiency = |errors: &[f64]| -> Vec<f64> {
        let each = errors.iter().zip(&seconds);
        each.map(|(error, seconds)| 1.0 / (error * seconds))
            .collect()
    };
    let mut row = |what: &str, values: &[f64], unit: &str| {
        let (value, spread) = median(values);
        report.row(Row {
            name: what.into(),
            scene: name.into(),
            value,
            unit: unit.into(),
            baseline: None,
            ratio: None,
            spread: Some(spread),
            bar: None,
            holds: None,
        });
    };
    row("efficiency", &efficiency(&errors), "1/(relMSE s)");
    row(
        "efficiency but for 0.1 % of pixels",
        &efficiency(&trimmed),
        "1/(relMSE s)",
    );
    row("relMSE", &errors, &format!("{samples} spp"));
    row("build and render", &seconds, "s");
    row("of which build", &[build], "s");
    row("load, not counted", &[load], "s");
    if let Some(picture) = last {
        show(&setting.out, name, &picture, &average(&references))?;
        report.note(format!("{name}: picture and differences in {name}.html"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_of_the_references_cancels() {
        // A truth of 1 with noise of variance 1/12 in every picture.
        let mut state = 1_u64;
        let mut noisy = |sigma: f32| {
            let mut next = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                1.0 + sigma * ((state >> 40) as f32 / (1_u64 << 24) as f32 - 0.5)
            };
            let pixels = (0..64 * 64).map(|_| [next(), next(), next()]).collect();
            Picture::from_pixels(64, 64, pixels).unwrap()
        };
        let references = [noisy(0.5), noisy(0.5)];
        let (error, trimmed) = relative_error(&noisy(1.0), &references);
        assert!((error - 1.0 / 12.0).abs() < 0.01, "{error}");
        assert!(trimmed < error);
        let (none, _) = relative_error(&noisy(0.0), &references);
        assert!(none.abs() < 0.005, "{none}");
    }
}
