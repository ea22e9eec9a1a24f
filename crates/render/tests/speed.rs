//! How long the hot calls take: `cargo test --release -p occlude-render --test speed -- --ignored --nocapture`.

use glam::{Vec2, Vec3};
use occlude_render::bsdf::{Bsdf, BsdfParameters};
use occlude_render::sampling::{Sampler, SamplerKind, warp};
use std::hint::black_box;
use std::time::Instant;

/// Nanoseconds a call: the fastest of several rounds, over 1000 prepared inputs.
fn nanoseconds<T, R>(inputs: &[T], mut call: impl FnMut(&T) -> R) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..100 {
        let start = Instant::now();
        for input in inputs {
            black_box(call(black_box(input)));
        }
        best = best.min(start.elapsed().as_secs_f64() * 1e9 / inputs.len() as f64);
    }
    best
}

#[test]
#[ignore = "a measurement"]
fn nanoseconds_a_call() {
    for kind in [SamplerKind::Sobol, SamplerKind::Independent] {
        let inputs: Vec<Sampler> = (0..1000)
            .map(|i| Sampler::new(kind, 0, [i, 7], i))
            .collect();
        println!(
            "sampler {kind:?}: {:.1} ns for four numbers",
            nanoseconds(&inputs, |s| { *s }.next())
        );
    }
    let base = BsdfParameters {
        base_color: Vec3::new(0.8, 0.5, 0.2),
        roughness: 0.4,
        ..Default::default()
    };
    let materials = [
        (
            "lambert",
            BsdfParameters {
                specular: 0.0,
                ..base
            },
        ),
        ("dielectric", base),
        (
            "metal",
            BsdfParameters {
                metallic: 1.0,
                ..base
            },
        ),
        (
            "mirror",
            BsdfParameters {
                metallic: 1.0,
                roughness: 0.0,
                ..base
            },
        ),
        (
            "thin clear glass",
            BsdfParameters {
                transmission: 1.0,
                roughness: 0.0,
                ..base
            },
        ),
        (
            "thick rough glass",
            BsdfParameters {
                transmission: 1.0,
                thin: false,
                ..base
            },
        ),
        (
            "coat over dielectric",
            BsdfParameters {
                clearcoat: 1.0,
                clearcoat_roughness: 0.1,
                ..base
            },
        ),
        (
            "sheen over dielectric",
            BsdfParameters {
                sheen_color: Vec3::ONE,
                sheen_roughness: 0.5,
                ..base
            },
        ),
    ];
    println!("Bsdf: {} bytes", size_of::<Bsdf>());
    for (name, parameters) in materials {
        let inputs: Vec<_> = (0..1000)
            .map(|i| {
                let [x, y, lobe, _] = Sampler::new(SamplerKind::Independent, 0, [0, 0], i).next();
                let mut other = Sampler::new(SamplerKind::Independent, 1, [0, 0], i);
                let [a, b, c, d] = other.next();
                let wo = warp::cosine_hemisphere(Vec2::new(a, b));
                let wi = warp::cosine_hemisphere(Vec2::new(c, d));
                (
                    parameters,
                    wo,
                    wi,
                    lobe,
                    Vec2::new(x, y),
                    Bsdf::new(&parameters, wo),
                )
            })
            .collect();
        let new = nanoseconds(&inputs, |(p, wo, ..)| Bsdf::new(p, *wo));
        let eval = nanoseconds(&inputs, |(_, wo, wi, _, _, bsdf)| bsdf.eval(*wo, *wi));
        let sample = nanoseconds(&inputs, |(_, wo, _, lobe, u, bsdf)| {
            bsdf.sample(*wo, *lobe, *u)
        });
        println!("{name}: new {new:.1} ns, eval {eval:.1} ns, sample {sample:.1} ns");
    }
}
