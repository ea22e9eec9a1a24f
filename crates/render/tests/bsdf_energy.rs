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
                    assert!(e < 1.003);
                    if roughness == 0.0 {
                        assert!((e - 1.0).abs() < 1e-4);
                    }
                }
            }
        }
    }
}
