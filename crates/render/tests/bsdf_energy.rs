//! Energy: white furnaces and sums of reflectance and transmittance, by many stratified samples.

use glam::{Vec2, Vec3};
use occlude_render::bsdf::{Bsdf, BsdfParameters};

fn direction(cos: f32) -> Vec3 {
    Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
}

/// Share of unit radiance from everywhere that leaves towards `wo`, with the squeeze of refraction taken out.
fn furnace(parameters: &BsdfParameters, wo: Vec3) -> Vec3 {
    let bsdf = Bsdf::new(parameters, wo);
    let n = 28;
    let mut sum = glam::DVec3::ZERO;
    for k in 0..n {
        for i in 0..n {
            for j in 0..n {
                let jitter = |a: u32, m: u32| {
                    ((k * 7919 + i * 104_729 + j * 1_299_709 + a).wrapping_mul(m) >> 8) as f32
                        / 16_777_216.0
                };
                let lobe = (k as f32 + jitter(1, 2_654_435_761)) / n as f32;
                let u = Vec2::new(
                    (i as f32 + jitter(2, 2_246_822_519)) / n as f32,
                    (j as f32 + jitter(3, 3_266_489_917)) / n as f32,
                );
                if let Some(s) = bsdf.sample(wo, lobe, u) {
                    assert!(
                        s.weight.is_finite() && s.wi.is_finite() && s.pdf.is_finite(),
                        "{s:?} {parameters:?}"
                    );
                    sum += (s.weight * s.eta2).as_dvec3();
                }
            }
        }
    }
    (sum / f64::from(n * n * n)).as_vec3()
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
