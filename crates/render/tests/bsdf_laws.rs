//! Laws that every material obeys: reciprocity, no gain, finite results for all input.

use glam::{Vec2, Vec3};
use occlude_render::bsdf::{Bsdf, BsdfParameters};
use occlude_render::sampling::{Sampler, SamplerKind, warp};

/// Numbers of test case `i`.
fn numbers(i: u32) -> impl FnMut() -> f32 {
    let mut sampler = Sampler::new(SamplerKind::Independent, 99, [0, 0], i);
    let mut batch = sampler.next();
    let mut used = 0;
    move || {
        if used == 4 {
            batch = sampler.next();
            used = 0;
        }
        used += 1;
        batch[used - 1]
    }
}

/// A unit vector: often z, else up to a right angle and a half off it.
fn coat_normal(next: &mut impl FnMut() -> f32) -> Vec3 {
    if next() < 0.4 {
        return Vec3::Z;
    }
    let slope = Vec2::new(next() - 0.5, next() - 0.5) * 3.0;
    slope.extend(1.2 * next() - 0.2).normalize()
}

/// A random material; a third of its parameters are at an end of their range.
fn material(next: &mut impl FnMut() -> f32) -> BsdfParameters {
    let mut ends = || {
        let (kind, x) = (next(), next());
        if kind < 1.0 / 6.0 {
            0.0
        } else if kind < 2.0 / 6.0 {
            1.0
        } else {
            x
        }
    };
    BsdfParameters {
        base_color: Vec3::new(ends(), ends(), ends()),
        metallic: ends(),
        roughness: ends(),
        ior: 1.0 + 2.0 * ends(),
        specular: ends(),
        specular_color: Vec3::new(ends(), ends(), ends()),
        transmission: ends(),
        thin: ends() < 0.5,
        entering: ends() < 0.5,
        clearcoat: ends(),
        clearcoat_roughness: ends(),
        sheen_color: Vec3::new(ends(), ends(), ends()),
        sheen_roughness: ends(),
        coat_normal: coat_normal(next),
    }
}

#[test]
fn reflection_and_transmission_are_reciprocal() {
    let mut compared = 0;
    for i in 0..40_000 {
        let mut next = numbers(i);
        let p = material(&mut next);
        let wo = warp::uniform_hemisphere(Vec2::new(next(), next()));
        let wi = warp::uniform_sphere(Vec2::new(next(), next()));
        if wo.z < 1e-3 || wi.z.abs() < 1e-3 {
            continue;
        }
        // From below the coat's horizon the coat is seen with a bent normal: another surface.
        let (coat_o, coat_i) = (p.coat_normal.dot(wo), p.coat_normal.dot(wi));
        if coat_o < 1e-3 || coat_i * wi.z.signum() < 1e-3 {
            continue;
        }
        // Seen from the other side the surface is turned over, and so is the question of what is inside.
        let turn = if wi.z < 0.0 {
            Vec3::new(1.0, 1.0, -1.0)
        } else {
            Vec3::ONE
        };
        let turned = BsdfParameters {
            entering: if wi.z < 0.0 { !p.entering } else { p.entering },
            coat_normal: p.coat_normal * turn * turn.z,
            ..p
        };
        // A tilted coat's lobe holds the cosine to its own normal: looked at alone, and taken from the rest.
        let coat_alone = |p: BsdfParameters| BsdfParameters {
            base_color: Vec3::ZERO,
            metallic: 0.0,
            specular: 0.0,
            transmission: 0.0,
            sheen_color: Vec3::ZERO,
            ..p
        };
        let both = |p: BsdfParameters, wo: Vec3, wi: Vec3| {
            let (all, _) = Bsdf::new(&p, wo).eval(wo, wi);
            if p.coat_normal == Vec3::Z {
                return (all, 0.0);
            }
            // From within a body the coat is on the far side.
            let body = !p.thin && p.ior >= 1.001 && p.transmission > 0.0 && p.metallic < 1.0;
            let coated = wi.z > 0.0 && (p.entering || !body);
            let coat = if coated {
                Bsdf::new(&coat_alone(p), wo).eval(wo, wi).0.x
            } else {
                0.0
            };
            (all - coat, coat)
        };
        let (a, coat_a) = both(p, wo, wi);
        let (b, coat_b) = both(turned, wi * turn, wo * turn);
        let (coat_a, coat_b) = (coat_a / coat_i.abs(), coat_b / coat_o);
        assert!(
            (coat_a - coat_b).abs() <= 5e-3 * coat_a.max(coat_b),
            "case {i}: {coat_a} {coat_b}"
        );
        // Radiance over squared index is what is reciprocal.
        let eta2 = if wi.z < 0.0 && !p.thin {
            if p.entering {
                p.ior * p.ior
            } else {
                1.0 / (p.ior * p.ior)
            }
        } else {
            1.0
        };
        let (a, b) = (a / wi.z.abs() * eta2, b / wo.z);
        // Next to total reflection a facet transmits next to nothing, of which rounding takes part or all.
        let largest = a.max_element().max(b.max_element());
        if largest > 1e-4_f32.max(1e-2 * coat_a) {
            compared += 1;
            assert!(
                (a - b).abs().max_element() < 5e-3 * largest,
                "case {i}: {a} and {b} for {wo} {wi} {p:?}"
            );
        }
    }
    assert!(compared > 10_000, "{compared} pairs");
}

#[test]
fn nothing_gains_and_everything_is_finite() {
    let mut heaviest = 0.0_f32;
    for i in 0..1000 {
        let mut next = numbers(i);
        let p = material(&mut next);
        let wo = warp::uniform_hemisphere(Vec2::new(next(), next()));
        let bsdf = Bsdf::new(&p, wo);
        assert!(
            bsdf.albedo().is_finite() && bsdf.albedo().max_element() < 1.02,
            "case {i}: {} {p:?}",
            bsdf.albedo()
        );
        let n = 2048;
        let mut sum = glam::DVec3::ZERO;
        let mut squares = glam::DVec3::ZERO;
        for k in 0..n {
            let [x, y, lobe, _] = Sampler::new(SamplerKind::Sobol, 1, [i, 0], k).next();
            if let Some(s) = bsdf.sample(wo, lobe, Vec2::new(x, y)) {
                assert!(
                    s.weight.is_finite()
                        && s.weight.min_element() >= 0.0
                        && s.pdf > 0.0
                        && s.wi.is_finite(),
                    "case {i}: {s:?} {p:?}"
                );
                let w = (s.weight * s.eta2).as_dvec3();
                heaviest = heaviest.max(w.max_element() as f32);
                sum += w;
                squares += w * w;
            }
        }
        let mean = sum / f64::from(n);
        let deviation = ((squares / f64::from(n) - mean * mean) / f64::from(n))
            .max(glam::DVec3::ZERO)
            .to_array()
            .map(f64::sqrt);
        for (m, d) in mean.to_array().into_iter().zip(deviation) {
            // Five standard deviations of independent numbers, which Sobol points stay far below.
            assert!(
                m < 1.01 + 5.0 * d,
                "case {i} reflects {m} +- {d}: {p:?} {wo}"
            );
        }
    }
    println!("heaviest sample {heaviest}");
}

#[test]
fn hostile_input_gives_finite_output() {
    let wild = [
        0.0,
        -1.0,
        1.0,
        0.5,
        1e-30,
        1e30,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e-3,
        0.031,
        2.0,
    ];
    for i in 0..100_000 {
        let mut next = numbers(i);
        let mut pick = || wild[(next() * wild.len() as f32) as usize];
        let p = BsdfParameters {
            base_color: Vec3::new(pick(), pick(), pick()),
            metallic: pick(),
            roughness: pick(),
            ior: pick(),
            specular: pick(),
            specular_color: Vec3::new(pick(), pick(), pick()),
            transmission: pick(),
            thin: pick() > 0.4,
            entering: pick() > 0.4,
            clearcoat: pick(),
            clearcoat_roughness: pick(),
            coat_normal: Vec3::new(pick(), pick(), pick()),
            sheen_color: Vec3::new(pick(), pick(), pick()),
            sheen_roughness: pick(),
        };
        let height = [1e-38, 1e-20, 1e-8, 1e-4, 0.5, 1.0][(next() * 6.0) as usize];
        let wo = Vec3::new((1.0_f32 - height * height).sqrt(), 0.0, height);
        let wi = [
            warp::uniform_sphere(Vec2::new(next(), next())),
            Vec3::X,
            -Vec3::X,
            -wo,
            Vec3::new(-wo.x, 0.0, wo.z),
            Vec3::new(-wo.x, 0.0, -wo.z),
        ][(next() * 6.0) as usize];
        let bsdf = Bsdf::new(&p, wo);
        let (value, pdf) = bsdf.eval(wo, wi);
        assert!(
            value.is_finite() && pdf.is_finite() && value.min_element() >= 0.0 && pdf >= 0.0,
            "case {i}: {value} {pdf} {p:?} {wo} {wi}"
        );
        if let Some(s) = bsdf.sample(wo, next(), Vec2::new(next(), next())) {
            assert!(
                s.weight.is_finite() && s.wi.is_finite() && s.pdf.is_finite() && s.pdf > 0.0,
                "case {i}: {s:?} {p:?} {wo}"
            );
        }
        assert!(bsdf.albedo().is_finite(), "case {i}: {p:?}");
    }
    let p = BsdfParameters::default();
    for wo in [Vec3::ZERO, -Vec3::Z, Vec3::NAN, Vec3::X] {
        assert_eq!(Bsdf::new(&p, wo).sample(wo, 0.5, Vec2::splat(0.5)), None);
        assert_eq!(Bsdf::new(&p, wo).eval(wo, Vec3::Z), (Vec3::ZERO, 0.0));
    }
}

#[test]
fn lambert_reflects_base_color_over_pi() {
    let base_color = Vec3::new(0.8, 0.5, 0.25);
    let p = BsdfParameters {
        base_color,
        specular: 0.0,
        ..Default::default()
    };
    for cos in [0.01, 0.5, 1.0] {
        let wi = Vec3::new(0.6, 0.0, 0.8);
        let wo = Vec3::new((1.0_f32 - cos * cos).sqrt(), 0.0, cos);
        let (value, pdf) = Bsdf::new(&p, wo).eval(wo, wi);
        assert!(
            (value - base_color * wi.z / std::f32::consts::PI)
                .abs()
                .max_element()
                < 1e-7
        );
        assert!((pdf - wi.z / std::f32::consts::PI).abs() < 1e-7);
    }
}
