//! Every metric against its definition, written out slowly; FLIP also against numbers of the authors' program.

use std::f64::consts::PI;

use super::*;
use crate::tests::{Random, sample_picture};

/// A picture that Python computes equally: integers modulo a prime, divided by a power of two.
fn pattern(width: u32, height: u32, seed: u64, stops: f32) -> Picture {
    let mut picture = Picture::new(width, height);
    for (i, pixel) in picture.pixels.iter_mut().enumerate() {
        let (x, y) = (i as u64 % u64::from(width), i as u64 / u64::from(width));
        // A gradient, stripes and a hash.
        let hash = (x * 7919 + y * 104_729 + seed * 1_299_709 + x * y * 31) % 8191;
        let base = (x + 2 * y + 1) as f32 / (width + 2 * height) as f32;
        let stripes = if (x / 5 + y / 3) % 2 == 0 { 0.25 } else { 1.0 };
        for (c, v) in pixel.iter_mut().enumerate() {
            let noise = ((hash + c as u64 * 977) % 8191) as f32 / 8192.0;
            let value = 0.5 * base * stripes + 0.5 * noise * base;
            *v = value * (stops * (base - 0.5)).exp2();
        }
    }
    picture
}

#[test]
fn simple_numbers_by_hand() {
    let a = Picture::from_pixels(2, 1, vec![[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]).unwrap();
    let b = Picture::from_pixels(2, 1, vec![[1.0, 1.0, 1.0], [2.0, 1.0, 0.0]]).unwrap();
    // Differences 0 1 2 -2 -1 0; sum of b is 6, its mean 1.
    assert!((mse(&a, &b).unwrap() - 10.0 / 6.0).abs() < 1e-12);
    assert!((energy_change(&a, &b).unwrap() - 1.0).abs() < 1e-12);
    let expected = (1.0 / 1.01 + 4.0 / 1.01 + 4.0 / 4.01 + 1.0 / 1.01) / 6.0;
    assert!((relmse(&a, &b).unwrap() - expected).abs() < 1e-12);
    assert!((psnr(0.01, 1.0) - 20.0).abs() < 1e-12 && psnr(0.0, 1.0) == f64::INFINITY);
    // Exposure does not matter.
    let doubled = |p: &Picture| p.map(|c| c.map(|v| v * 2.0));
    assert!((relmse(&doubled(&a), &doubled(&b)).unwrap() - expected).abs() < 1e-12);
}

#[test]
fn equal_pictures_have_no_error_and_sizes_must_agree() {
    for (width, height) in [(1, 1), (2, 1), (1, 7), (11, 11), (40, 23)] {
        let picture = sample_picture(width, height, 1);
        for encoding in [Encoding::Display, Encoding::SceneLinear] {
            let n = compare(&picture, &picture, encoding).unwrap().numbers;
            assert_eq!(
                (n.mse, n.relmse, n.flip, n.energy_change),
                (0.0, 0.0, 0.0, 0.0),
                "{width}x{height}"
            );
            assert!((n.ssim - 1.0).abs() < 1e-12);
        }
        let other = sample_picture(width + 1, height, 1);
        assert!(matches!(
            compare(&picture, &other, Encoding::Display),
            Err(ImageError::SizeMismatch { .. })
        ));
    }
    assert!(compare(&Picture::default(), &Picture::default(), Encoding::Display).is_err());
}

#[test]
fn black_and_constant_pictures_have_numbers() {
    let black = Picture::new(13, 12);
    let grey = black.map(|_| [0.3; 3]);
    let both = compare(&black, &black, Encoding::SceneLinear)
        .unwrap()
        .numbers;
    assert_eq!((both.flip, both.energy_change, both.mse), (0.0, 0.0, 0.0));
    for (a, b) in [(&grey, &black), (&black, &grey), (&grey, &grey)] {
        let n = compare(a, b, Encoding::SceneLinear).unwrap().numbers;
        assert!(n.flip.is_finite() && (n.flip > 0.5) == (a != b), "{n:?}");
        assert!(n.ssim.is_finite() && n.mse.is_finite() && n.relmse.is_finite());
    }
    let json = serde_json::to_string(
        &compare(&grey, &black, Encoding::SceneLinear)
            .unwrap()
            .numbers,
    )
    .unwrap();
    assert!(json.contains("\"energy_change\":null"), "{json}");
}

#[test]
fn json_has_the_promised_keys_in_order() {
    let a = sample_picture(5, 4, 1);
    let json = serde_json::to_string(&compare(&a, &a, Encoding::Display).unwrap().numbers).unwrap();
    let keys = [
        "mse",
        "relmse",
        "psnr",
        "ssim",
        "flip",
        "energy_change",
        "mean_a",
        "mean_b",
        "width",
        "height",
    ];
    let places: Vec<_> = keys
        .iter()
        .map(|k| json.find(&format!("\"{k}\":")).unwrap())
        .collect();
    assert!(places.is_sorted(), "{json}");
    assert_eq!(json.matches("\":").count(), keys.len());
}

/// SSIM with explicit 11x11 windows, weights normalised within the picture.
fn slow_ssim(a: &[f64], b: &[f64], width: usize, height: usize) -> f64 {
    let (mut total, mut count) = (0.0, 0);
    let inside = |at: usize, n: usize| n <= 10 || (at >= 5 && at + 5 < n);
    for y in (0..height).filter(|&y| inside(y, height)) {
        for x in (0..width).filter(|&x| inside(x, width)) {
            let mut taps = Vec::new();
            for (i, (va, vb)) in a.iter().zip(b).enumerate() {
                let (dx, dy) = ((i % width).abs_diff(x), (i / width).abs_diff(y));
                if dx <= 5 && dy <= 5 {
                    taps.push(((-((dx * dx + dy * dy) as f64) / 4.5).exp(), *va, *vb));
                }
            }
            let weights: f64 = taps.iter().map(|t| t.0).sum();
            let expect = |f: &dyn Fn(f64, f64) -> f64| {
                taps.iter().map(|t| t.0 * f(t.1, t.2)).sum::<f64>() / weights
            };
            let (ma, mb) = (expect(&|a, _| a), expect(&|_, b| b));
            let (va, vb) = (
                expect(&|a, _| (a - ma).powi(2)),
                expect(&|_, b| (b - mb).powi(2)),
            );
            let cov = expect(&|a, b| (a - ma) * (b - mb));
            total += (2.0 * ma * mb + 1e-4) * (2.0 * cov + 9e-4)
                / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
            count += 1;
        }
    }
    total / f64::from(count)
}

#[test]
fn ssim_equals_the_explicit_window_sum() {
    let mut random = Random(5);
    for (width, height) in [(1, 1), (3, 30), (11, 11), (10, 12), (25, 19)] {
        let a: Vec<f64> = (0..width * height)
            .map(|_| f64::from(random.float()))
            .collect();
        let b: Vec<f64> = a
            .iter()
            .map(|v| (0.7 * v + 0.3 * f64::from(random.float())).min(1.0))
            .collect();
        let (fast, slow) = (
            ssim(&a, &b, width, height),
            slow_ssim(&a, &b, width, height),
        );
        assert!(
            (fast - slow).abs() < 1e-10,
            "{width}x{height}: {fast} against {slow}"
        );
        assert!(fast < 0.99);
    }
}

/// LDR-FLIP in f64 with full 2D kernels, straight from the 2020 paper.
fn slow_ldr_flip(test: &Picture, reference: &Picture, ppd: f64) -> Vec<f64> {
    type Plane = Vec<[f64; 3]>;
    const M: [[f64; 3]; 3] = [
        [
            10135552. / 24577794.,
            8788810. / 24577794.,
            4435075. / 24577794.,
        ],
        [
            2613072. / 12288897.,
            8788810. / 12288897.,
            887015. / 12288897.,
        ],
        [
            1425312. / 73733382.,
            8788810. / 73733382.,
            70074185. / 73733382.,
        ],
    ];
    let relative =
        |c: [f64; 3]| M.map(|r| (r[0] * c[0] + r[1] * c[1] + r[2] * c[2]) / (r[0] + r[1] + r[2]));
    // Solves relative(c) = v by Cramer's rule.
    let inverse = |v: [f64; 3]| -> [f64; 3] {
        let n = M.map(|r| r.map(|x| x / (r[0] + r[1] + r[2])));
        let det = |m: [[f64; 3]; 3]| {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
                - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        };
        std::array::from_fn(|c| {
            let mut m = n;
            for r in 0..3 {
                m[r][c] = v[r];
            }
            det(m) / det(n)
        })
    };
    let lab = |c: [f64; 3]| -> [f64; 3] {
        let d: f64 = 6.0 / 29.0;
        let [x, y, z] = relative(c).map(|t| {
            if t > d.powi(3) {
                t.cbrt()
            } else {
                t / (3.0 * d * d) + 4.0 / 29.0
            }
        });
        let l = 116.0 * y - 16.0;
        [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
    };
    let hyab = |a: [f64; 3], b: [f64; 3]| {
        (a[0] - b[0]).abs() + ((a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
    };
    let (width, height) = (reference.width as i64, reference.height as i64);
    let convolve =
        |p: &dyn Fn(i64, i64) -> f64, radius: i64, k: &dyn Fn(i64, i64) -> f64, x: i64, y: i64| {
            let mut sum = 0.0;
            for dy in -radius..=radius {
                for dx in -radius..=radius {
                    sum +=
                        k(dx, dy) * p((x + dx).clamp(0, width - 1), (y + dy).clamp(0, height - 1));
                }
            }
            sum
        };
    let radius = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * ppd).ceil() as i64;
    let sigma = 0.5 * 0.082 * ppd;
    let feature_radius = (3.0 * sigma).ceil() as i64;
    let evaluate = |picture: &Picture| -> (Plane, Vec<[f64; 2]>) {
        let opponent: Plane = picture
            .pixels
            .iter()
            .map(|c| {
                let [x, y, z] = relative(c.map(|v| f64::from(v.clamp(0.0, 1.0))));
                [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
            })
            .collect();
        let at = |c: usize| {
            let opponent = &opponent;
            move |x: i64, y: i64| opponent[(y * width + x) as usize][c]
        };
        let sensitivity = [
            [1.0, 0.0047, 0.0, 1e-5],
            [1.0, 0.0053, 0.0, 1e-5],
            [34.1, 0.04, 13.5, 0.025],
        ];
        let csf = |c: usize| {
            move |dx: i64, dy: i64| {
                let [a1, b1, a2, b2] = sensitivity[c];
                let d2 = (dx * dx + dy * dy) as f64 / (ppd * ppd);
                a1 * (PI / b1).sqrt() * (-PI * PI * d2 / b1).exp()
                    + a2 * (PI / b2).sqrt() * (-PI * PI * d2 / b2).exp()
            }
        };
        let g = |dx: i64, dy: i64| (-((dx * dx + dy * dy) as f64) / (2.0 * sigma * sigma)).exp();
        let edge = |d: i64, dx: i64, dy: i64| -(d as f64) * g(dx, dy);
        let point = |d: i64, dx: i64, dy: i64| ((d * d) as f64 / (sigma * sigma) - 1.0) * g(dx, dy);
        // Sums of the positive and of the negative weights of a kernel.
        let parts = |radius: i64, k: &dyn Fn(i64, i64) -> f64| {
            let all: Vec<f64> = (-radius..=radius)
                .flat_map(|y| (-radius..=radius).map(move |x| (x, y)))
                .map(|(x, y)| k(x, y))
                .collect();
            (
                all.iter().filter(|v| **v > 0.0).sum::<f64>(),
                -all.iter().filter(|v| **v < 0.0).sum::<f64>(),
            )
        };
        let totals: [f64; 3] = std::array::from_fn(|c| parts(radius, &csf(c)).0);
        let mut colors = Plane::new();
        let mut features = Vec::new();
        let grey = |x: i64, y: i64| (at(0)(x, y) + 16.0) / 116.0;
        let balance = |(p, n): (f64, f64), v: f64| if v > 0.0 { v / p } else { v / n };
        let (edges, points) = (
            parts(feature_radius, &|x, y| edge(x, x, y)),
            parts(feature_radius, &|x, y| point(x, x, y)),
        );
        for y in 0..height {
            for x in 0..width {
                let [l, cx, cz] =
                    std::array::from_fn(|c| convolve(&at(c), radius, &csf(c), x, y) / totals[c]);
                let l = (l + 16.0) / 116.0;
                colors.push(lab(
                    inverse([l + cx / 500.0, l, l - cz / 200.0]).map(|v| v.clamp(0.0, 1.0))
                ));
                let run = |k: &dyn Fn(i64, i64) -> f64| convolve(&grey, feature_radius, k, x, y);
                let e = run(&|dx, dy| balance(edges, edge(dx, dx, dy)))
                    .hypot(run(&|dx, dy| balance(edges, edge(dy, dx, dy))));
                let p = run(&|dx, dy| balance(points, point(dx, dx, dy)))
                    .hypot(run(&|dx, dy| balance(points, point(dy, dx, dy))));
                features.push([e, p]);
            }
        }
        (colors, features)
    };
    let (t, r) = (evaluate(test), evaluate(reference));
    let largest = hyab(lab([0.0, 1.0, 0.0]), lab([0.0, 0.0, 1.0])).powf(0.7);
    (0..t.0.len())
        .map(|i| {
            let d = hyab(t.0[i], r.0[i]).powf(0.7);
            let knee = 0.4 * largest;
            let color = if d < knee {
                0.95 / knee * d
            } else {
                0.95 + (d - knee) / (largest - knee) * 0.05
            };
            let feature = (t.1[i][0] - r.1[i][0])
                .abs()
                .max((t.1[i][1] - r.1[i][1]).abs());
            color.powf(1.0 - (feature / 2f64.sqrt()).sqrt())
        })
        .collect()
}

#[test]
fn flip_equals_the_paper_with_full_kernels() {
    for (width, height, ppd) in [(1, 1, 67.0), (23, 17, 67.020_645), (9, 31, 30.0)] {
        let (a, b) = (
            pattern(width, height, 1, 0.0),
            pattern(width, height, 2, 0.5),
        );
        let fast = flip::ldr(&a, &b, ppd as f32).unwrap();
        let slow = slow_ldr_flip(&a, &b, f64::from(ppd as f32));
        for (f, s) in fast.iter().zip(&slow) {
            // f32 against f64 through the square root of small feature differences.
            assert!(
                (f64::from(*f) - s).abs() < 2e-3,
                "{width}x{height}: {f} against {s}"
            );
        }
        let means = (mean(&fast), slow.iter().sum::<f64>() / slow.len() as f64);
        assert!((means.0 - means.1).abs() < 1e-4, "{means:?}");
        assert!(means.0 > 0.01);
    }
}

#[test]
fn flip_agrees_with_the_authors_program() {
    // Means of flip-evaluator 1.7 (Python), `evaluate(reference, test, kind, inputsRGB=False)` with its defaults, on
    // the same patterns: width, height, stops of test and reference.
    let cases = [
        (64, 48, 0.0, 0.0, Encoding::Display, 0.2939201),
        (37, 101, 0.0, 0.5, Encoding::Display, 0.1867745),
        (1, 9, 0.0, 1.0, Encoding::Display, 0.4298423),
        (64, 48, 8.0, 8.0, Encoding::SceneLinear, 0.3288152),
        (53, 29, 10.0, 9.5, Encoding::SceneLinear, 0.3537417),
        (200, 150, 14.0, 14.0, Encoding::SceneLinear, 0.1561912),
        (5, 3, 4.0, 5.0, Encoding::SceneLinear, 0.5641005),
    ];
    for (width, height, stops_a, stops_b, encoding, expected) in cases {
        let (test, reference) = (
            pattern(width, height, 1, stops_a),
            pattern(width, height, 2, stops_b),
        );
        let flip = compare(&test, &reference, encoding).unwrap().numbers.flip;
        assert!(
            (flip - expected).abs() < 1e-4,
            "{width}x{height} {encoding:?}: {flip}, not {expected}"
        );
    }
}

#[test]
fn hdr_flip_does_not_depend_on_exposure_but_on_the_error() {
    let (a, b) = (pattern(40, 30, 1, 6.0), pattern(40, 30, 2, 6.0));
    let mean_of = |a: &Picture, b: &Picture| mean(&flip::hdr(a, b, flip::DEFAULT_PPD).unwrap());
    let scaled = |p: &Picture| p.map(|c| c.map(|v| v * 64.0));
    assert!((mean_of(&a, &b) - mean_of(&scaled(&a), &scaled(&b))).abs() < 1e-3);
    // Halfway to the reference there is less to see.
    let mut near = b.clone();
    for (n, a) in near.pixels.iter_mut().zip(&a.pixels) {
        *n = std::array::from_fn(|c| 0.5 * (n[c] + a[c]));
    }
    assert!(mean_of(&near, &b) < 0.9 * mean_of(&a, &b));
}
