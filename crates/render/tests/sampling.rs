//! The sampler's promises, and every warp against its density.
//!
//! False-alarm rate of each chi-square test here: 0.1 %.

use glam::{Vec2, Vec3};
use occlude_render::sampling::{Sampler, SamplerKind, warp};
use occlude_testkit::chi2::{SphereGrid, chi2_test};

fn points(
    kind: SamplerKind,
    seed: u64,
    pixel: [u32; 2],
    set: u32,
    start: u32,
    count: u32,
) -> Vec<[f32; 4]> {
    (start..start + count)
        .map(|i| {
            let mut sampler = Sampler::new(kind, seed, pixel, i);
            sampler.jump(set);
            sampler.next()
        })
        .collect()
}

/// Whether each of the `2^m` points has an elementary interval of every shape to itself.
fn is_net(points: &[[f32; 4]], [x, y]: [usize; 2]) -> bool {
    let m = points.len().ilog2();
    (0..=m).all(|k| {
        let (columns, rows) = (1_usize << k, 1_usize << (m - k));
        let mut hit = vec![false; points.len()];
        for p in points {
            let cell = (p[x] * columns as f32) as usize * rows + (p[y] * rows as f32) as usize;
            hit[cell] = true;
        }
        hit.into_iter().all(|h| h)
    })
}

#[test]
fn sobol_points_are_stratified() {
    for (pixel, set) in [
        ([0, 0], 0),
        ([17, 3], 1),
        ([1000, 999], 77),
        ([5, 5], 100_000),
    ] {
        for m in 0..=10 {
            for block in [0, 1, 5, 1 << (16 - m)] {
                let p = points(SamplerKind::Sobol, 7, pixel, set, block << m, 1 << m);
                assert!(
                    is_net(&p, [0, 1]),
                    "pixel {pixel:?}, set {set}: block {block} of 2^{m} is no (0,m,2)-net"
                );
                for (d, width) in (0..4).map(|d| (d, p.len())) {
                    let mut hit = vec![false; width];
                    p.iter()
                        .for_each(|p| hit[(p[d] * width as f32) as usize] = true);
                    assert!(
                        hit.into_iter().all(|h| h),
                        "number {d} of a block of 2^{m} is not stratified"
                    );
                }
            }
        }
    }
    assert!(!is_net(
        &points(SamplerKind::Independent, 7, [0, 0], 0, 0, 256),
        [0, 1]
    ));
}

#[test]
fn numbers_are_uniform_and_sets_independent() {
    // Squares of (number of this set, number of the next set, or of the next pixel, or of the next block of samples).
    let bins = 16;
    for kind in [SamplerKind::Sobol, SamplerKind::Independent] {
        let n = 1 << 16;
        let here = points(kind, 1, [3, 4], 0, 0, n);
        let others = [
            points(kind, 1, [3, 4], 1, 0, n),
            points(kind, 1, [4, 4], 0, 0, n),
            points(kind, 1, [3, 5], 0, 0, n),
            points(kind, 2, [3, 4], 0, 0, n),
            points(kind, 1, [3, 4], 0, 1 << 16, n),
        ];
        for (k, other) in others.iter().enumerate() {
            for (a, b) in [(0, 0), (0, 1), (1, 2), (3, 3)] {
                let mut count = vec![0.0; bins * bins];
                for (p, q) in here.iter().zip(other) {
                    count[(p[a] * bins as f32) as usize * bins + (q[b] * bins as f32) as usize] +=
                        1.0;
                }
                let expected = vec![f64::from(n) / (bins * bins) as f64; bins * bins];
                let result = chi2_test(&count, &expected);
                assert!(
                    result.p > 0.001 / 20.0,
                    "{kind:?}, other {k}, numbers {a} and {b}: {result:?}"
                );
            }
        }
        for p in here.iter().flatten() {
            assert!((0.0..1.0).contains(p));
        }
    }
}

#[test]
fn a_sampler_is_a_pure_function_of_its_arguments() {
    for kind in [SamplerKind::Sobol, SamplerKind::Independent] {
        let mut a = Sampler::new(kind, 9, [1, 2], 70_000);
        let first = [a.next(), a.next(), a.next()];
        let mut b = Sampler::new(kind, 9, [1, 2], 70_000);
        b.jump(2);
        assert_eq!(b.next(), first[2]);
        b.jump(0);
        assert_eq!(b.next(), first[0]);
        assert_ne!(first[0], first[1]);
        assert_ne!(Sampler::new(kind, 9, [2, 1], 70_000).next(), first[0]);
        assert_ne!(
            Sampler::new(kind, 9 + (1 << 40), [1, 2], 70_000).next(),
            first[0]
        );
        assert_ne!(
            Sampler::new(kind, 9, [1, 2], 70_000 + (1 << 16)).next(),
            first[0]
        );
    }
    assert!(size_of::<Sampler>() <= 16);
}

/// Mean squared error of an estimate of `f`'s mean over the unit square, with `n` samples, over 256 pixels.
fn error(kind: SamplerKind, n: u32, mean: f64, f: impl Fn([f32; 4], [f32; 4]) -> f64) -> f64 {
    let pixels = 256;
    let mut sum = 0.0;
    for pixel in 0..pixels {
        let mut estimate = 0.0;
        for i in 0..n {
            let mut sampler = Sampler::new(kind, 0, [pixel, 0], i);
            let (a, b) = (sampler.next(), sampler.next());
            estimate += f(a, b);
        }
        sum += (estimate / f64::from(n) - mean).powi(2);
    }
    sum / f64::from(pixels)
}

#[test]
fn sobol_converges_faster_than_independent_numbers() {
    use std::f64::consts::{E, PI};
    type Integrand = fn([f32; 4], [f32; 4]) -> f64;
    // (name, integrand, mean, least gain in mean squared error at 64 samples)
    let cases: [(&str, Integrand, f64, f64); 5] = [
        (
            "smooth, one pair",
            |a, _| f64::from(a[0] + a[1]).exp(),
            (E - 1.0).powi(2),
            100.0,
        ),
        (
            "a disk's edge",
            |a, _| f64::from(u8::from(a[0] * a[0] + a[1] * a[1] < 1.0)),
            PI / 4.0,
            3.0,
        ),
        (
            "smooth, other pair",
            |a, _| f64::from(a[2] + a[3]).exp(),
            (E - 1.0).powi(2),
            30.0,
        ),
        (
            "sum over two sets",
            |a, b| f64::from(a[0] * a[1] + b[0] * b[1]),
            0.5,
            30.0,
        ),
        (
            "product of two sets",
            |a, b| f64::from(a[0] + b[1]).exp(),
            (E - 1.0).powi(2),
            2.0,
        ),
    ];
    for (name, f, mean, least) in cases {
        let gain =
            error(SamplerKind::Independent, 64, mean, f) / error(SamplerKind::Sobol, 64, mean, f);
        println!("{name}: {gain:.1} times less squared error than independent numbers");
        assert!(gain > least, "{name}: {gain}");
    }
}

#[test]
fn directions_follow_their_densities() {
    type Warp = (&'static str, [f64; 3], fn(Vec2) -> Vec3, fn(f32) -> f32);
    let z = [0.0, 0.0, 1.0];
    let warps: [Warp; 5] = [
        (
            "cosine",
            z,
            warp::cosine_hemisphere,
            warp::cosine_hemisphere_pdf,
        ),
        ("sphere", z, warp::uniform_sphere, |_| {
            warp::UNIFORM_SPHERE_PDF
        }),
        ("hemisphere", z, warp::uniform_hemisphere, |c| {
            if c > 0.0 {
                warp::UNIFORM_HEMISPHERE_PDF
            } else {
                0.0
            }
        }),
        (
            "cone",
            z,
            |u| warp::uniform_cone(0.3, u),
            |c| {
                if c > 0.7 {
                    warp::uniform_cone_pdf(0.3)
                } else {
                    0.0
                }
            },
        ),
        (
            "cosine, tilted grid",
            [0.6, 0.0, 0.8],
            warp::cosine_hemisphere,
            warp::cosine_hemisphere_pdf,
        ),
    ];
    for (name, pole, sample, pdf) in warps {
        // 20 rings of equal area: the edges of cone (0.15) and hemisphere (0.5) are edges of rings.
        let grid = SphereGrid {
            pole,
            rings: 20,
            ..Default::default()
        };
        let result = grid.test(
            200_000,
            &mut |i| {
                let [x, y, ..] =
                    Sampler::new(SamplerKind::Independent, 11, [0, 0], i as u32).next();
                let d = sample(Vec2::new(x, y));
                assert!((d.length() - 1.0).abs() < 1e-6, "{name}: {d}");
                Some(d.as_dvec3().to_array())
            },
            &mut |d| f64::from(pdf(d[2] as f32)),
        );
        assert!(result.p > 0.001 / 5.0, "{name}: {result:?}");
    }
}

#[test]
fn areas_are_kept() {
    // Counts of disk and triangle over small squares of equal area.
    let n = 1 << 18;
    let mut disk = vec![0.0; 32 * 32];
    let mut triangle = vec![0.0; 32 * 32];
    for i in 0..n {
        let [x, y, ..] = Sampler::new(SamplerKind::Independent, 5, [0, 0], i).next();
        let d = warp::disk(Vec2::new(x, y));
        assert!(d.length() <= 1.000_001);
        // Rings of equal area by sectors.
        let ring = ((d.length_squared() * 32.0) as usize).min(31);
        let turn = d.y.atan2(d.x) / std::f32::consts::TAU + 0.5;
        disk[ring * 32 + ((turn * 32.0) as usize).min(31)] += 1.0;
        let b = warp::triangle(Vec2::new(x, y));
        assert!(b.x >= 0.0 && b.y >= 0.0 && b.x + b.y <= 1.000_001, "{b}");
        // Folding the triangle's b2 about its conditional range makes a uniform square.
        let s = ((1.0 - b.x) * (1.0 - b.x)).clamp(0.0, 1.0);
        let t = if b.x < 1.0 { b.y / (1.0 - b.x) } else { 0.0 };
        triangle[((s * 32.0) as usize).min(31) * 32 + ((t * 32.0) as usize).min(31)] += 1.0;
    }
    let expected = vec![f64::from(n) / 1024.0; 1024];
    for (name, counts) in [("disk", disk), ("triangle", triangle)] {
        let result = chi2_test(&counts, &expected);
        assert!(result.p > 0.001 / 2.0, "{name}: {result:?}");
    }
}

#[test]
fn frames_and_angles_are_exact() {
    for i in 0..10_000 {
        let [x, y, t, _] = Sampler::new(SamplerKind::Independent, 5, [1, 0], i).next();
        let z = if i == 0 {
            -Vec3::Z
        } else {
            warp::uniform_sphere(Vec2::new(x, y))
        };
        let (a, b) = warp::basis(z);
        for error in [
            a.dot(b),
            a.dot(z),
            b.dot(z),
            a.length() - 1.0,
            b.length() - 1.0,
        ] {
            assert!(error.abs() < 2e-6, "{z}");
        }
        assert!((a.cross(b) - z).length() < 2e-6, "{z}");
        let (sin, cos) = warp::sin_cos_turns(t);
        let (s, c) = (f64::from(t) * std::f64::consts::TAU).sin_cos();
        assert!(
            (f64::from(sin) - s).abs() < 4e-7 && (f64::from(cos) - c).abs() < 4e-7,
            "{t}"
        );
    }
}
