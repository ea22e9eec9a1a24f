//! Structural similarity: Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment: From Error Visibility to
//! Structural Similarity", 2004, eq. 13, with its Gaussian window of 11x11 and standard deviation 1.5.

use rayon::prelude::*;

/// Half the window's size, rounded down.
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
/// Section III-C: stabilisers for a dynamic range of 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Mean SSIM of two planes of values in `[0, 1]`: over the pixels whose window lies inside, as in the authors' own
/// program; in pictures too small for that, over all pixels, windows cut at the border.
///
/// Values beyond the shorter plane or beyond `width * height` are ignored; an empty plane gives 1.
pub fn ssim(a: &[f64], b: &[f64], width: usize, height: usize) -> f64 {
    let count = width.saturating_mul(height);
    if count == 0 || a.len() < count || b.len() < count {
        return 1.0;
    }
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<_>>();
    let planes = [
        a[..count].to_vec(),
        b[..count].to_vec(),
        product(a, a),
        product(b, b),
        product(a, b),
    ];
    let blurred: Vec<Vec<f64>> = planes
        .iter()
        .map(|p| blur(&p[..count], width, height))
        .collect();
    let inside = |n: usize| {
        if n > 2 * RADIUS {
            RADIUS..n - RADIUS
        } else {
            0..n
        }
    };
    let (columns, rows) = (inside(width), inside(height));
    let mut sum = 0.0;
    for y in rows.clone() {
        for x in columns.clone() {
            let [mean_a, mean_b, aa, bb, ab] = std::array::from_fn(|p| blurred[p][y * width + x]);
            let (var_a, var_b, covariance) = (
                aa - mean_a * mean_a,
                bb - mean_b * mean_b,
                ab - mean_a * mean_b,
            );
            sum += (2.0 * mean_a * mean_b + C1) * (2.0 * covariance + C2)
                / ((mean_a * mean_a + mean_b * mean_b + C1) * (var_a + var_b + C2));
        }
    }
    sum / (columns.len() * rows.len()) as f64
}

/// Gaussian means, windows cut at the border and their weights made to sum to 1.
fn blur(plane: &[f64], width: usize, height: usize) -> Vec<f64> {
    let weight: [f64; RADIUS + 1] =
        std::array::from_fn(|d| (-0.5 * (d * d) as f64 / (SIGMA * SIGMA)).exp());
    let along = |n: usize, at: usize, value: &dyn Fn(usize) -> f64| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for i in at.saturating_sub(RADIUS)..(at + RADIUS + 1).min(n) {
            sum += weight[i.abs_diff(at)] * value(i);
            weights += weight[i.abs_diff(at)];
        }
        sum / weights
    };
    let mut across = vec![0.0; plane.len()];
    across
        .par_chunks_mut(width)
        .zip(plane.par_chunks(width))
        .for_each(|(out, row)| {
            for (x, v) in out.iter_mut().enumerate() {
                *v = along(width, x, &|i| row[i]);
            }
        });
    let mut done = vec![0.0; plane.len()];
    done.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (x, v) in out.iter_mut().enumerate() {
            *v = along(height, y, &|i| across[i * width + x]);
        }
    });
    done
}
