//! The separable filters of FLIP: contrast sensitivity of the eye, and detectors of edges and points.
//!
//! A 2D Gaussian is a product of two 1D ones, so sums and derivatives of Gaussians need a few 1D passes (Andersson et
//! al., "FLIP: separable convolutions", technical report 2021). The border pixel goes on outside of the picture.

use rayon::prelude::*;
use std::f32::consts::PI;

/// A 1D kernel of odd length.
type Kernel = Vec<f32>;

fn kernel(radius: usize, f: impl Fn(f32) -> f32) -> Kernel {
    (0..=2 * radius)
        .map(|i| f(i as f32 - radius as f32))
        .collect()
}

fn scaled(mut kernel: Kernel, scale: f32) -> Kernel {
    kernel.iter_mut().for_each(|v| *v *= scale);
    kernel
}

fn sum(kernel: &[f32]) -> f32 {
    kernel.iter().sum()
}

/// Weighted sums along one axis: for every position, `N` numbers from the taps `(weight index, value)` around it.
///
/// `gather(acc, tap, value)` adds the value under tap `tap` of the kernels.
fn pass<A: Copy + Sync, B: Copy + Default + Send>(
    input: &[A],
    width: usize,
    radius: usize,
    vertical: bool,
    gather: impl Fn(&mut B, usize, A) + Sync,
) -> Vec<B> {
    let height = input.len() / width.max(1);
    let mut out = vec![B::default(); input.len()];
    out.par_chunks_mut(width.max(1))
        .enumerate()
        .for_each(|(y, row)| {
            if vertical {
                for tap in 0..=2 * radius {
                    let source = (y + tap).saturating_sub(radius).min(height - 1);
                    let values = &input[source * width..(source + 1) * width];
                    for (acc, &value) in row.iter_mut().zip(values) {
                        gather(acc, tap, value);
                    }
                }
            } else {
                let values = &input[y * width..(y + 1) * width];
                for (x, acc) in row.iter_mut().enumerate() {
                    for tap in 0..=2 * radius {
                        let source = (x + tap).saturating_sub(radius).min(width - 1);
                        gather(acc, tap, values[source]);
                    }
                }
            }
        });
    out
}

/// Contrast sensitivity: each opponent channel loses what the eye does not resolve (eq. 4 and table 1).
pub(super) struct Spatial {
    radius: usize,
    luminance: Kernel,
    red_green: Kernel,
    /// Blue-yellow is a sum of two Gaussians.
    blue_yellow: [Kernel; 2],
}

impl Spatial {
    pub(super) fn new(ppd: f32) -> Self {
        // Table 1: (a1, b1) of luminance, red-green, blue-yellow, and (a2, b2) of blue-yellow.
        const LUMINANCE_B: f32 = 0.0047;
        const RED_GREEN_B: f32 = 0.0053;
        const BLUE_YELLOW: [(f32, f32); 2] = [(34.1, 0.04), (13.5, 0.025)];
        // Three standard deviations of the widest; exp(-pi^2 x^2 / b) has variance b / (2 pi^2).
        let radius = (3.0 * (BLUE_YELLOW[0].1 / (2.0 * PI * PI)).sqrt() * ppd).ceil() as usize;
        let gauss = |b: f32| kernel(radius, |x| (-PI * PI * (x / ppd) * (x / ppd) / b).exp());
        let single = |b: f32| {
            let k = gauss(b);
            let s = sum(&k);
            scaled(k, 1.0 / s)
        };
        // The factor a sqrt(pi / b) of the 2D kernel goes in equal parts to both passes.
        let parts = BLUE_YELLOW.map(|(a, b)| scaled(gauss(b), (a * (PI / b).sqrt()).sqrt()));
        let total = (sum(&parts[0]).powi(2) + sum(&parts[1]).powi(2)).sqrt();
        Self {
            radius,
            luminance: single(LUMINANCE_B),
            red_green: single(RED_GREEN_B),
            blue_yellow: parts.map(|k| scaled(k, 1.0 / total)),
        }
    }

    /// Filters YCxCz.
    pub(super) fn apply(&self, picture: &[[f32; 3]], width: usize) -> Vec<[f32; 3]> {
        let [first, second] = &self.blue_yellow;
        let across = pass(
            picture,
            width,
            self.radius,
            false,
            |acc: &mut [f32; 4], tap, c| {
                acc[0] += self.luminance[tap] * c[0];
                acc[1] += self.red_green[tap] * c[1];
                acc[2] += first[tap] * c[2];
                acc[3] += second[tap] * c[2];
            },
        );
        pass(
            &across,
            width,
            self.radius,
            true,
            |acc: &mut [f32; 3], tap, c: [f32; 4]| {
                acc[0] += self.luminance[tap] * c[0];
                acc[1] += self.red_green[tap] * c[1];
                acc[2] += first[tap] * c[2] + second[tap] * c[3];
            },
        )
    }
}

/// Derivatives of a Gaussian that is as wide as the edges that the eye notices (section 4.2).
pub(super) struct Features {
    radius: usize,
    gauss: Kernel,
    /// First derivative: edges.
    edge: Kernel,
    /// Second derivative: points and lines.
    point: Kernel,
}

impl Features {
    pub(super) fn new(ppd: f32) -> Self {
        /// Width of the detector in degrees (w).
        const WIDTH: f32 = 0.082;
        let sigma = 0.5 * WIDTH * ppd;
        let radius = (3.0 * sigma).ceil() as usize;
        let g = |x: f32| (-x * x / (2.0 * sigma * sigma)).exp();
        let gauss = kernel(radius, g);
        let total = sum(&gauss);
        Self {
            radius,
            gauss: scaled(gauss, 1.0 / total),
            edge: balanced(kernel(radius, |x| -x * g(x))),
            point: balanced(kernel(radius, |x| (x * x / (sigma * sigma) - 1.0) * g(x))),
        }
    }

    /// Lengths of the edge and the point response of the luminance of YCxCz.
    pub(super) fn apply(&self, picture: &[[f32; 3]], width: usize) -> Vec<[f32; 2]> {
        let across = pass(
            picture,
            width,
            self.radius,
            false,
            |acc: &mut [f32; 3], tap, c: [f32; 3]| {
                let y = (c[0] + 16.0) / 116.0;
                acc[0] += self.gauss[tap] * y;
                acc[1] += self.edge[tap] * y;
                acc[2] += self.point[tap] * y;
            },
        );
        let both = pass(
            &across,
            width,
            self.radius,
            true,
            |acc: &mut [f32; 4], tap, c: [f32; 3]| {
                acc[0] += self.gauss[tap] * c[1];
                acc[1] += self.edge[tap] * c[0];
                acc[2] += self.gauss[tap] * c[2];
                acc[3] += self.point[tap] * c[0];
            },
        );
        both.into_par_iter()
            .map(|[ex, ey, px, py]| [ex.hypot(ey), px.hypot(py)])
            .collect()
    }
}

/// Scales so that the positive weights sum to 1 and the negative ones to -1.
fn balanced(mut kernel: Kernel) -> Kernel {
    let positive: f32 = kernel.iter().filter(|v| **v > 0.0).sum();
    let negative: f32 = -kernel.iter().filter(|v| **v < 0.0).sum::<f32>();
    for v in &mut kernel {
        *v /= if *v > 0.0 { positive } else { negative };
    }
    kernel
}
