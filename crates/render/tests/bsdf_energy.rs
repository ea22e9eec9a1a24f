//! Energy: white furnaces and sums of reflectance and transmittance, by many stratified samples.

use glam::{Vec2, Vec3};
use occlude_render::bsdf::{Bsdf, BsdfParameters};
use occlude_render::sampling::{Sampler, SamplerKind};

fn direction(cos: f32) -> Vec3 {
    Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
}

/// Share of unit radiance from everywhere that leaves towards `wo`, with the squeeze of refraction taken out.
fn furnace(parameters: &BsdfParameters, wo: Vec3) -> Vec3 {
    let bsdf = Bsdf::new(parameters, wo);
    let samples = 1 << 16;
    let mut sum = glam::DVec3::ZERO;
    for i in 0..samples {
        let [x, y, lobe, _] = Sampler::new(SamplerKind::Sobol, 0, [0, 0], i).next();
        if let Some(s) = bsdf.sample(wo, lobe, Vec2::new(x, y)) {
            assert!(
                s.weight.is_finite() && s.wi.is_finite() && s.pdf.is_finite(),
                "{s:?} {parameters:?}"
            );
            sum += (s.weight * s.eta2).as_dvec3();
        }
    }
    (sum / f64::from(samples)).as_vec3()
}

#[test]
fn white_furnace_of_opaque_materials() {
    for metallic in [0.0, 0.5, 1.0] {
        for ior in [1.0, 1.5, 3.0] {
            for roughness in [0.0, 0.1, 0.2, 0.4, 0.7, 1.0] {
                for cos in [0.02, 0.1, 0.4, 0.8, 1.0] {
                    let p = BsdfParameters {
                        metallic,
                        roughness,
                        ior,
                        ..Default::default()
                    };
                    let e = furnace(&p, direction(cos));
                    println!("metallic {metallic} ior {ior} roughness {roughness} cos {cos}: {e}");
                    assert!(
                        (e - Vec3::ONE).abs().max_element() < 0.01,
                        "metallic {metallic} ior {ior} roughness {roughness} cos {cos}: {e}"
                    );
                }
            }
        }
    }
}

#[test]
fn glass_splits_light_without_loss() {
    for (thin, entering) in [(true, true), (false, true), (false, false)] {
        for ior in [1.0, 1.5, 3.0] {
            for roughness in [0.0, 0.2, 0.5, 1.0] {
                for cos in [0.05, 0.2, 0.6, 1.0] {
                    let p = BsdfParameters {
                        transmission: 1.0,
                        thin,
                        entering,
                        roughness,
                        ior,
                        ..Default::default()
                    };
                    let e = furnace(&p, direction(cos)).x;
                    println!(
                        "thin {thin} entering {entering} ior {ior} roughness {roughness} cos {cos}: {e}"
                    );
                    // Rough boundaries of bodies have a test of their own.
                    let exact = thin || roughness == 0.0 || ior == 1.0;
                    assert!(
                        !exact || (e > 0.99 && e < 1.003),
                        "thin {thin} entering {entering} ior {ior} roughness {roughness} cos {cos}: {e}"
                    );
                }
            }
        }
    }
}

#[test]
fn layers_over_white_keep_what_they_do_not_reflect() {
    let mut worst = (1.0_f32, String::new());
    for coat_roughness in [0.0, 0.2, 0.6, 1.0] {
        for (sheen, sheen_roughness) in [(0.0, 0.5), (0.6, 0.3), (1.0, 0.8)] {
            for (specular, metallic) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)] {
                for cos in [0.05, 0.3, 0.7, 1.0] {
                    let p = BsdfParameters {
                        specular,
                        metallic,
                        roughness: 0.3,
                        clearcoat: 1.0,
                        clearcoat_roughness: coat_roughness,
                        sheen_color: Vec3::splat(sheen),
                        sheen_roughness,
                        ..Default::default()
                    };
                    let e = furnace(&p, direction(cos)).x;
                    let what = format!(
                        "coat {coat_roughness} sheen {sheen} specular {specular} metallic {metallic} cos {cos}: {e}"
                    );
                    assert!(e < 1.005, "{what}");
                    // The minimum over both directions costs layered metals some light.
                    assert!(sheen > 0.0 || metallic > 0.0 || e > 0.985, "{what}");
                    if e < worst.0 {
                        worst = (e, what);
                    }
                }
            }
        }
    }
    println!("darkest: {}", worst.1);
    assert!(worst.0 > 0.8, "{}", worst.1);
}

/// Coats with a normal of their own: what the coat does not reflect reaches the base and comes back, but for light that the
/// coat's horizon hides.
#[test]
fn tilted_coats_gain_nothing_and_lose_little() {
    let mut darkest = (1.0_f32, String::new());
    for degrees in [5.0_f32, 20.0, 45.0] {
        for azimuth in [0.0_f32, 2.0, 3.1] {
            for roughness in [0.0, 0.2, 0.6, 1.0] {
                for (specular, metallic) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)] {
                    for cos in [0.05, 0.3, 0.7, 1.0] {
                        let tilt = degrees.to_radians();
                        let level = glam::Vec2::from_angle(azimuth) * tilt.sin();
                        let p = BsdfParameters {
                            specular,
                            metallic,
                            roughness: 0.3,
                            clearcoat: 1.0,
                            clearcoat_roughness: roughness,
                            coat_normal: level.extend(tilt.cos()).normalize(),
                            ..Default::default()
                        };
                        let wo = direction(cos);
                        let e = furnace(&p, wo).x;
                        let what = format!(
                            "tilt {degrees} azimuth {azimuth} coat {roughness} specular {specular} metallic {metallic} cos {cos}: {e}"
                        );
                        assert!(e < 1.005, "{what}");
                        if e < darkest.0 {
                            darkest = (e, what.clone());
                        }
                        // Lambert's lobe is normalised over what the tilted coat lets in; a mirror image below the coat's horizon is lost.
                        if specular == 0.0 {
                            assert!(e > 0.97, "{what}");
                            assert!((e - Bsdf::new(&p, wo).albedo().x).abs() < 0.03, "{what}");
                        }
                    }
                }
            }
        }
    }
    println!("darkest: {}", darkest.1);
    // A mirror whose image lies along the horizon of a coat that is tilted by 45 degrees.
    assert!(darkest.0 > 0.45, "{}", darkest.1);
}

/// Boundaries of bodies read what a single bounce loses from a table: all of it comes back, from both sides.
#[test]
fn rough_bodies_split_light_without_loss() {
    let (mut darkest, mut brightest) = (1.0_f32, 1.0_f32);
    for entering in [true, false] {
        for ior in [1.1, 1.3, 1.5, 1.7, 2.0, 3.0] {
            for roughness in [0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0] {
                for cos in [0.02, 0.05, 0.2, 0.6, 1.0] {
                    let p = BsdfParameters {
                        transmission: 1.0,
                        thin: false,
                        entering,
                        roughness,
                        ior,
                        ..Default::default()
                    };
                    let e = furnace(&p, direction(cos)).x;
                    let albedo = Bsdf::new(&p, direction(cos)).albedo().x;
                    let what = format!(
                        "entering {entering} ior {ior} roughness {roughness} cos {cos}: {e}, estimate {albedo}"
                    );
                    let bound = if cos < 0.04 { 0.02 } else { 0.01 };
                    assert!((e - 1.0).abs() < bound, "{what}");
                    assert!((e - albedo).abs() < 0.02, "{what}");
                    (darkest, brightest) = (darkest.min(e), brightest.max(e));
                }
            }
        }
    }
    println!("from {darkest} to {brightest}");
}

/// A weakened or coloured reflection takes light away from some channels and gives none more than there is.
#[test]
fn rough_bodies_with_weak_reflection_gain_nothing() {
    for entering in [true, false] {
        for (specular, color) in [
            (0.0, Vec3::ONE),
            (0.5, Vec3::new(1.0, 0.5, 0.0)),
            (1.0, Vec3::X),
        ] {
            for roughness in [0.3, 0.6, 1.0] {
                for cos in [0.05, 0.3, 0.8] {
                    let p = BsdfParameters {
                        transmission: 1.0,
                        thin: false,
                        entering,
                        roughness,
                        specular,
                        specular_color: color,
                        ..Default::default()
                    };
                    let e = furnace(&p, direction(cos));
                    let what = format!(
                        "entering {entering} specular {specular} {color} roughness {roughness} cos {cos}: {e}"
                    );
                    assert!(
                        (e.x - 1.0).abs() < 0.012 && e.max_element() < 1.012,
                        "{what}"
                    );
                }
            }
        }
    }
}
