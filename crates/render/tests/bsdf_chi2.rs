//! Chi-square tests of every lobe's `sample` against `eval`'s density, and the consistency of weights.
//!
//! False-alarm rate of the file: 1 % over all materials together.

use glam::{Vec2, Vec3};
use occlude_render::bsdf::{Bsdf, BsdfParameters};
use occlude_render::sampling::{Sampler, SamplerKind};
use occlude_testkit::chi2::SphereGrid;
use occlude_testkit::distribution::sidak;

fn direction(cos: f32) -> Vec3 {
    Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
}

fn materials() -> Vec<(&'static str, BsdfParameters)> {
    let base = BsdfParameters {
        base_color: Vec3::new(0.8, 0.5, 0.2),
        ..Default::default()
    };
    let mut list = vec![(
        "lambert",
        BsdfParameters {
            specular: 0.0,
            ..base
        },
    )];
    for roughness in [0.1, 0.3, 0.6, 1.0] {
        list.push(("dielectric", BsdfParameters { roughness, ..base }));
        list.push((
            "metal",
            BsdfParameters {
                roughness,
                metallic: 1.0,
                ..base
            },
        ));
        let glass = BsdfParameters {
            roughness,
            transmission: 1.0,
            ..base
        };
        list.push(("thin glass", glass));
        for ior in [1.1, 1.5, 3.0] {
            list.push((
                "thick glass, outside",
                BsdfParameters {
                    thin: false,
                    ior,
                    ..glass
                },
            ));
            list.push((
                "thick glass, inside",
                BsdfParameters {
                    thin: false,
                    entering: false,
                    ior,
                    ..glass
                },
            ));
        }
        list.push((
            "coated",
            BsdfParameters {
                roughness: 1.0,
                clearcoat: 1.0,
                clearcoat_roughness: roughness,
                ..base
            },
        ));
        for coat_normal in [Vec3::new(0.5, -0.3, 0.8), Vec3::new(-0.04, 0.6, 0.8)] {
            let tilted = BsdfParameters {
                roughness: 0.4,
                clearcoat: 1.0,
                clearcoat_roughness: roughness,
                coat_normal: coat_normal.normalize(),
                ..base
            };
            list.push(("tilted coat", tilted));
            list.push((
                "tilted coat over glass",
                BsdfParameters {
                    transmission: 0.7,
                    thin: false,
                    sheen_color: Vec3::splat(0.3),
                    sheen_roughness: 0.5,
                    ..tilted
                },
            ));
        }
        list.push((
            "sheen",
            BsdfParameters {
                sheen_color: Vec3::new(1.0, 0.2, 0.1),
                sheen_roughness: roughness,
                ..base
            },
        ));
        list.push((
            "everything",
            BsdfParameters {
                metallic: 0.3,
                transmission: 0.5,
                thin: false,
                roughness,
                clearcoat: 0.7,
                clearcoat_roughness: 0.3,
                sheen_color: Vec3::splat(0.5),
                sheen_roughness: 0.4,
                ..base
            },
        ));
    }
    list.push((
        "smooth coat over rough",
        BsdfParameters {
            clearcoat: 1.0,
            ..base
        },
    ));
    list
}

/// The direction about which the lobes on one side of the surface peak.
fn peak(parameters: &BsdfParameters, wo: Vec3, above: bool) -> glam::DVec3 {
    if above && parameters.coat_normal != Vec3::Z && parameters.coat_normal.dot(wo) > 0.0 {
        let n = parameters.coat_normal.as_dvec3();
        let wo = wo.as_dvec3();
        return (2.0 * n.dot(wo) * n - wo).normalize();
    }
    if above {
        return glam::DVec3::new(-f64::from(wo.x), 0.0, f64::from(wo.z)).normalize();
    }
    let eta = match (parameters.thin, parameters.entering) {
        (true, _) => 1.0,
        (false, true) => parameters.ior,
        (false, false) => 1.0 / parameters.ior,
    };
    let x = (-f64::from(wo.x) / f64::from(eta)).max(-1.0);
    glam::DVec3::new(x, 0.0, -(1.0 - x * x).sqrt()).normalize()
}

#[test]
fn samples_follow_the_density() {
    let materials = materials();
    let cosines = [0.05, 0.5, 0.98];
    let tests = materials.len() * cosines.len() * 2;
    let level = sidak(0.01, tests);
    let mut failures = 0;
    for (name, parameters) in &materials {
        for (cos, above) in cosines.into_iter().flat_map(|c| [(c, true), (c, false)]) {
            if !above && !parameters.reaches_below() {
                continue;
            }
            let wo = direction(cos);
            let bsdf = Bsdf::new(parameters, wo);
            let sharp = parameters.roughness < 0.5 || parameters.clearcoat > 0.0;
            let grid = SphereGrid {
                pole: peak(parameters, wo, above).to_array(),
                concentration: if sharp { 4 } else { 2 },
                ..Default::default()
            };
            let result = grid.test(
                40_000,
                &mut |i| {
                    let [x, y, lobe, _] =
                        Sampler::new(SamplerKind::Independent, 3, [0, 0], i as u32).next();
                    let s = bsdf.sample(wo, lobe, Vec2::new(x, y))?;
                    (!s.delta && (s.wi.z > 0.0) == above).then(|| s.wi.as_dvec3().to_array())
                },
                &mut |wi| {
                    let side = (wi[2] > 0.0) == above;
                    if side {
                        f64::from(bsdf.eval(wo, glam::DVec3::from_array(wi).as_vec3()).1)
                    } else {
                        0.0
                    }
                },
            );
            if result.p < level {
                failures += 1;
                eprintln!("{name}, cos {cos}, above {above}, {parameters:?}: {result:?}");
            }
        }
    }
    assert_eq!(
        failures, 0,
        "{failures} of at most {tests} densities do not fit their samples"
    );
}

#[test]
fn weight_is_value_over_density() {
    for (name, parameters) in &materials() {
        for cos in [0.01, 0.3, 1.0] {
            let wo = direction(cos);
            let bsdf = Bsdf::new(parameters, wo);
            for i in 0..2000 {
                let [x, y, lobe, _] = Sampler::new(SamplerKind::Sobol, 5, [1, 2], i).next();
                let Some(s) = bsdf.sample(wo, lobe, Vec2::new(x, y)) else {
                    continue;
                };
                assert!((s.wi.length() - 1.0).abs() < 1e-5, "{name}: {s:?}");
                if s.delta {
                    continue;
                }
                let (value, pdf) = bsdf.eval(wo, s.wi);
                assert!((pdf / s.pdf - 1.0).abs() < 1e-4, "{name}: {s:?}, pdf {pdf}");
                assert!(
                    (value / pdf - s.weight).abs().max_element() <= 1e-4 * s.weight.max_element(),
                    "{name}: {s:?}, {value}"
                );
            }
        }
    }
}
