//! Fits against the maps that they are made of, by quadrature that shares no code with them.

use super::super::Environment;
use super::*;
use occlude_image::{Limits, Picture};
use occlude_testkit::random::Random;
use std::f32::consts::PI;
use std::path::PathBuf;

/// Irradiance of the map, texel by texel, and of its lobes and suns together.
fn irradiance(map: &Picture, fit: &SkyLobes, normal: Vec3) -> (Vec3, Vec3) {
    let (mut truth, mut fitted) = (Vec3::ZERO, Vec3::ZERO);
    for (i, pixel) in map.pixels.iter().enumerate() {
        let (w, area) = texel(map, i);
        let cosine = normal.dot(w).max(0.0);
        if cosine > 0.0 {
            truth += Vec3::from_array(*pixel) * cosine * area;
            fitted += fit.radiance(w) * cosine * area;
        }
    }
    for sun in &fit.suns {
        fitted += sun.irradiance * normal.dot(sun.towards).max(0.0);
    }
    (truth, fitted)
}

/// Direction and solid angle.
fn texel(map: &Picture, index: usize) -> (Vec3, f32) {
    let (width, height) = (map.width as usize, map.height as usize);
    let at = |i: usize, n: usize| (i as f64 + 0.5) / n as f64;
    let w = direction(at(index % width, width), at(index / width, height));
    let side = std::f64::consts::PI / height as f64;
    let area = 2.0 * (0.5 * side).sin() * side * (1.0 - w.y * w.y).sqrt();
    (w.as_vec3(), area as f32)
}

fn check_irradiance(map: &Picture, fit: &SkyLobes, most: f32, what: &str) {
    let energy: Vec3 = (map.pixels.iter().enumerate())
        .map(|(i, pixel)| Vec3::from_array(*pixel) * texel(map, i).1)
        .sum();
    let mut random = Random(7);
    for _ in 0..6 {
        let normal = random.direction();
        let (truth, fitted) = irradiance(map, fit, normal);
        let error = (truth - fitted).abs().max_element() / (energy.element_sum() / 12.0);
        // What the residual says is what happens: the normals differ, so a little more.
        let said = fit.residual.irradiance_worst;
        assert!(
            error < 1.2 * said + 2e-3,
            "{what}: {normal}: {truth} {fitted}: {error} {said}"
        );
    }
    assert!(fit.residual.irradiance < most, "{what}: {:?}", fit.residual);
    let lobes: Vec3 = fit.lobes.iter().map(|lobe| lobe.integral()).sum();
    let sum = lobes + fit.suns.iter().map(|sun| sun.irradiance).sum::<Vec3>();
    let error = (sum - energy).abs().max_element() / energy.max_element();
    assert!(error < 5e-3, "{what}: energy {energy} {sum}");
    for lobe in &fit.lobes {
        assert!(lobe.amplitude.min_element() >= 0.0 && lobe.amplitude.is_finite());
        assert!((lobe.axis.length() - 1.0).abs() < 1e-5);
    }
}

/// A gradient, a lamp ten degrees wide and a sun: texel by texel from their formulas.
fn procedural(width: u32, sun: Option<(Vec3, f32)>) -> Picture {
    let height = width / 2;
    let mut picture = Picture::new(width, height);
    let lamp = Vec3::new(-0.6, 0.64, 0.48);
    // Spread by the lens, so that the texels hold its energy.
    let deviation = 0.7 * PI / height as f32;
    for i in 0..picture.pixels.len() {
        let w = texel(&picture, i).0;
        let up = 0.5 + 0.5 * w.y;
        let mut value = Vec3::new(0.3, 0.35, 0.4) + Vec3::new(0.1, 0.3, 0.8) * up;
        if w.angle_between(lamp) < 0.09 {
            value += Vec3::new(20.0, 18.0, 12.0);
        }
        if let Some((towards, irradiance)) = sun {
            let square = (w.angle_between(towards) / deviation).powi(2);
            value += irradiance / (2.0 * PI * deviation * deviation) * (-0.5 * square).exp();
        }
        picture.pixels[i] = value.to_array();
    }
    picture
}

fn few() -> SkyFit {
    SkyFit { lobes: 8, suns: 1 }
}

#[test]
fn lobes_light_as_the_sky_does() {
    let sun = Vec3::new(0.48, 0.36, -0.8);
    let map = procedural(1024, Some((sun, 6.0)));
    let sky = Environment::from_picture(&map, 0.0, 1.0);
    let fit = sky.lobes(&few());
    let [found] = fit.suns[..] else {
        panic!("{:?}", fit.suns)
    };
    assert!(found.towards.angle_between(sun) < 2e-3, "{found:?}");
    assert!(
        (found.irradiance / 6.0 - 1.0).abs().max_element() < 0.05,
        "{found:?}"
    );
    assert!((0.002..0.012).contains(&found.angular_radius), "{found:?}");
    check_irradiance(&map, &fit, 0.015, "procedural");
    // The lamp is ten degrees wide: it is no sun.
    let lamp = Vec3::new(-0.6, 0.64, 0.48);
    let there = fit.radiance(lamp).x / 20.0;
    assert!((0.6..1.6).contains(&there), "{:?}", fit.lobes);
    // Without suns to be had, the sun is a lobe, too wide and at the cost of the others: that is why suns are taken out.
    let fit = sky.lobes(&SkyFit { lobes: 8, suns: 0 });
    assert!(fit.suns.is_empty());
    check_irradiance(&map, &fit, 0.08, "procedural without suns");
}

#[test]
fn more_lobes_lose_less() {
    let sky = Environment::from_picture(&procedural(256, None), 0.0, 1.0);
    let errors = [1, 3, 8].map(|lobes| sky.lobes(&SkyFit { lobes, suns: 0 }).residual.radiance);
    assert!(errors[0] > errors[1] && errors[1] > errors[2], "{errors:?}");
}

#[test]
fn a_lobe_is_found_again() {
    let truth = [
        (Vec3::new(0.6, 0.0, 0.8), 60.0, Vec3::new(3.0, 1.0, 0.2)),
        (Vec3::new(-0.8, 0.6, 0.0), 9.0, Vec3::new(0.2, 0.7, 1.0)),
    ]
    .map(|(axis, sharpness, amplitude)| SphericalGaussian {
        axis,
        sharpness,
        amplitude,
    });
    let mut picture = Picture::new(512, 256);
    for i in 0..picture.pixels.len() {
        let w = texel(&picture, i).0;
        picture.pixels[i] = (truth[0].at(w) + truth[1].at(w)).to_array();
    }
    let sky = Environment::from_picture(&picture, 0.0, 1.0);
    let fit = sky.lobes(&SkyFit { lobes: 2, suns: 0 });
    for lobe in &truth {
        let near = |l: &&SphericalGaussian| l.axis.angle_between(lobe.axis) < 0.01;
        let found = fit.lobes.iter().find(near).expect("a lobe there");
        assert!(
            (found.sharpness / lobe.sharpness - 1.0).abs() < 0.05,
            "{found:?}"
        );
        assert!((found.amplitude - lobe.amplitude).abs().max_element() < 0.1);
    }
}

#[test]
fn skies_that_are_no_maps() {
    let constant = SkyLobes::constant(Vec3::new(1.0, 2.0, 3.0));
    let mut random = Random(1);
    for _ in 0..100 {
        let w = random.direction();
        let error = constant.radiance(w) - Vec3::new(1.0, 2.0, 3.0);
        assert!(error.abs().max_element() < 0.01, "{w} {error}");
    }
    let picture = |width, height, pixel: Vec<[f32; 3]>| {
        Environment::from_picture(
            &Picture {
                width,
                height,
                pixels: pixel,
            },
            0.0,
            1.0,
        )
    };
    let one = picture(1, 1, vec![[2.0, 1.0, 0.5]]).lobes(&few());
    assert_eq!(one, SkyLobes::constant(Vec3::new(2.0, 1.0, 0.5)));
    assert!(
        Environment::constant(Vec3::ZERO)
            .lobes(&few())
            .lobes
            .is_empty()
    );
    assert!(
        picture(2, 2, vec![[f32::NAN; 3]; 4])
            .lobes(&few())
            .lobes
            .is_empty()
    );
    // Infinite texels count as the largest finite ones.
    let sky = picture(2, 1, vec![[f32::INFINITY; 3], [2.0; 3]]);
    assert_eq!(sky.lobes(&few()), SkyLobes::constant(Vec3::splat(2.0)));
    let mut hot = procedural(64, None);
    hot.pixels[700] = [f32::INFINITY, f32::NAN, -3.0];
    hot.pixels[5] = [1e30; 3];
    for picture in [hot, procedural(4, None)] {
        let fit = Environment::from_picture(&picture, 1.0, 2.0).lobes(&few());
        let sum: Vec3 = fit.lobes.iter().map(|lobe| lobe.integral()).sum();
        let suns: Vec3 = fit.suns.iter().map(|sun| sun.irradiance).sum();
        assert!(
            (sum + suns).is_finite() && (sum + suns).min_element() > 0.0,
            "{fit:?}"
        );
    }
    // A single lit texel at a pole.
    let mut pole = Picture::new(32, 16);
    pole.pixels[3] = [1.0; 3];
    let sky = Environment::from_picture(&pole, 0.0, 1.0);
    let fit = sky.lobes(&few());
    let energy: Vec3 = fit.lobes.iter().map(|lobe| lobe.integral()).sum::<Vec3>()
        + fit.suns.iter().map(|sun| sun.irradiance).sum::<Vec3>();
    assert!((energy.x / sky.integral().x - 1.0).abs() < 0.15, "{fit:?}");
}

#[test]
fn fits_turn_with_the_sky_and_ignore_threads() {
    let picture = procedural(512, Some((Vec3::new(0.6, 0.8, 0.0), 20.0)));
    let straight = Environment::from_picture(&picture, 0.0, 1.0);
    let turned = Environment::from_picture(&picture, 0.5, 1.0);
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let fit = one.install(|| straight.lobes(&few()));
    let three = rayon::ThreadPoolBuilder::new()
        .num_threads(3)
        .build()
        .unwrap();
    assert_eq!(fit, three.install(|| straight.lobes(&few())));
    let turn = glam::Quat::from_rotation_y(0.5);
    let other = turned.lobes(&few());
    assert_eq!(fit.residual, other.residual);
    for (a, b) in fit.lobes.iter().zip(&other.lobes) {
        assert!((turn * a.axis - b.axis).length() < 1e-5);
    }
    assert!((turn * fit.suns[0].towards - other.suns[0].towards).length() < 1e-5);
    let w = Vec3::new(0.0, 0.6, 0.8);
    let radiance = turned.radiance(turn * w) - straight.radiance(w);
    assert!(radiance.length() < 1e-3);
}

#[test]
fn fits_are_kept() {
    let folder = std::env::temp_dir().join(format!("occlude-lobes-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    let settings = SkyFit { lobes: 2, suns: 1 };
    let sky = Environment::from_picture(&procedural(64, None), 0.3, 1.0);
    let fit = sky.lobes_kept(&settings, Some(&folder));
    assert_eq!(fit, sky.lobes(&settings));
    let files = || -> Vec<PathBuf> {
        let entries = std::fs::read_dir(&folder).unwrap();
        entries.map(|entry| entry.unwrap().path()).collect()
    };
    let [file] = &files()[..] else { panic!() };
    // What is read is what was written, and it is read: a mark in the file shows.
    assert_eq!(fit, sky.lobes_kept(&settings, Some(&folder)));
    let text = std::fs::read_to_string(file).unwrap();
    let marked = text.replace("\"residual\":[", "\"residual\":[77.0,");
    std::fs::write(
        file,
        marked.replacen(&format!(",{}]", fit.residual.energy), "]", 1),
    )
    .unwrap();
    assert_eq!(
        sky.lobes_kept(&settings, Some(&folder)).residual.radiance,
        77.0
    );
    // Damage is repaired.
    for damage in [
        "",
        "{",
        "[1, 2]",
        &text.replace("\"version\":1", "\"version\":0"),
    ] {
        std::fs::write(file, damage).unwrap();
        assert_eq!(fit, sky.lobes_kept(&settings, Some(&folder)));
        assert_eq!(text, std::fs::read_to_string(file).unwrap());
    }
    // Another map or other settings have other names; the rotation has not.
    Environment::from_picture(&procedural(64, None), 1.3, 1.0).lobes_kept(&settings, Some(&folder));
    assert_eq!(files().len(), 1);
    sky.lobes_kept(&SkyFit { lobes: 1, suns: 1 }, Some(&folder));
    Environment::from_picture(&procedural(64, None), 0.3, 2.0).lobes_kept(&settings, Some(&folder));
    assert_eq!(files().len(), 3);
    // A folder that cannot be is no error.
    assert_eq!(
        fit,
        sky.lobes_kept(&settings, Some(&file.join("below a file")))
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn captured_skies() {
    let folder = std::env::var_os("OCCLUDE_SCENES").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"),
        PathBuf::from,
    );
    for (name, suns) in [
        ("kiara_1_dawn_1k", 0),
        ("potsdamer_platz_1k", 0),
        ("studio_small_03_1k", 0),
        ("venice_sunset_1k", 1),
    ] {
        let path = folder.join(format!("env/{name}.hdr"));
        if !path.exists() {
            eprintln!("SKIPPED: no {}", path.display());
            continue;
        }
        let picture = occlude_image::read(&path, &Limits::default())
            .unwrap()
            .picture;
        let sky = Environment::from_picture(&picture, 0.0, 1.0);
        let fit = sky.lobes(&SkyFit { lobes: 10, suns: 2 });
        eprintln!("{name}: {:?}", fit.residual);
        assert_eq!(fit.suns.len(), suns, "{name}");
        assert!(
            fit.residual.irradiance < 0.025,
            "{name}: {:?}",
            fit.residual
        );
        check_irradiance(&picture, &fit, 0.08, name);
    }
}
