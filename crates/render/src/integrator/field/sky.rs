//! The sky as lobes, in the order and layout that shading wants.

use super::math::{asin, exp, wide};
use crate::light::{SkyLobes, SkySun};
use glam::Vec3;
use occlude_visibility::field::{Hemisphere, MapBlock, SphericalGaussian, VisibleShare};

/// Lobes that are worked on together.
pub(super) const WIDE: usize = 8;

/// Lobes up to this sharpness (9 degrees wide) cast soft shadows: what of them arrives is integrated at every sample point and
/// interpolated. From sharper ones shadows have edges, which move from point to point: their distances are interpolated.
const BROADEST_SHARP: f32 = 40.0;

/// Lobes up to this sharpness (6 degrees wide) are not too narrow to be summed over the blocks of a map.
const NARROWEST_SUMMED: f32 = 100.0;

/// Lobes by component, sorted by sharpness, filled up with black ones to whole vectors.
#[derive(Clone, Debug, Default)]
pub(super) struct Sky {
    pub(super) axis: [Vec<f32>; 3],
    pub(super) sharpness: Vec<f32>,
    pub(super) amplitude: [Vec<f32>; 3],
    /// Irradiance of a lobe of amplitude 1 by the cosine `m` between normal and axis: `slope * bend(m, width) + bias`, at least 0.
    pub(super) slope: Vec<f32>,
    pub(super) bias: Vec<f32>,
    pub(super) width: Vec<f32>,
    /// Lobes that are broad: a number of whole vectors; and all.
    pub(super) broad: usize,
    pub(super) suns: Vec<SkySun>,
}

/// 0 far below 0, `m` far above, a parabola in between.
#[inline(always)]
pub(super) fn bend(m: f32, width: f32) -> f32 {
    let rise = m + width;
    let parabola = rise * rise / (4.0 * width);
    let above = if m > width { m } else { parabola };
    if m < -width { 0.0 } else { above }
}

impl Sky {
    pub(super) fn new(lobes: &SkyLobes) -> Self {
        let mut sorted: Vec<SphericalGaussian> = (lobes.lobes.iter().copied())
            .filter(|lobe| lobe.amplitude.max_element() > 0.0 && lobe.sharpness.is_finite())
            .collect();
        sorted.sort_by(|a, b| a.sharpness.total_cmp(&b.sharpness));
        let split = sorted.partition_point(|lobe| lobe.sharpness <= BROADEST_SHARP);
        let sharp = sorted.split_off(split);
        let black = SphericalGaussian {
            axis: Vec3::Y,
            sharpness: 1.0,
            amplitude: Vec3::ZERO,
        };
        let mut sky = Self {
            suns: lobes.suns.clone(),
            ..Self::default()
        };
        for (group, broad) in [(sorted, true), (sharp, false)] {
            let count = group.len().next_multiple_of(WIDE);
            let missing = count - group.len();
            for lobe in group.into_iter().chain((0..missing).map(|_| black)) {
                sky.push(&lobe);
            }
            if broad {
                sky.broad = count;
            }
        }
        sky
    }

    fn push(&mut self, lobe: &SphericalGaussian) {
        for axis in 0..3 {
            self.axis[axis].push(lobe.axis[axis]);
            self.amplitude[axis].push(lobe.amplitude[axis]);
        }
        let sharpness = lobe.sharpness.max(1e-3);
        self.sharpness.push(sharpness);
        let (slope, bias, width) = fit_irradiance(sharpness);
        self.slope.push(slope);
        self.bias.push(bias);
        self.width.push(width);
    }

    pub(super) fn len(&self) -> usize {
        self.sharpness.len()
    }

    pub(super) fn lobe(&self, k: usize) -> SphericalGaussian {
        let vec = |columns: &[Vec<f32>; 3]| Vec3::new(columns[0][k], columns[1][k], columns[2][k]);
        SphericalGaussian {
            axis: vec(&self.axis),
            sharpness: self.sharpness[k],
            amplitude: vec(&self.amplitude),
        }
    }

    /// Irradiance on a surface, each lobe multiplied with what of it is visible: `seen` as of [`Sky::seen_from`], interpolated.
    pub(super) fn irradiance(&self, normal: Vec3, seen: &[f32]) -> Vec3 {
        irradiance(self, normal, seen)
    }

    /// What of each lobe a point sees: shares of broad lobes' irradiance, distances of sharp ones' centres; then, for the sharp ones, what the nearest edge says too
    /// little about their shares at the point (behind a window far too much).
    pub(super) fn seen_from(
        &self,
        hemisphere: &Hemisphere,
        blocks: &[MapBlock],
        distance: impl Fn(Vec3) -> f32,
        out: &mut Vec<f32>,
    ) {
        let count = self.len();
        out.clear();
        out.resize(count, 0.0);
        shares(self, hemisphere, blocks, out);
        for k in self.broad..count {
            let (true_share, lobe) = (out[k], self.lobe(k));
            out[k] = distance(lobe.axis);
            let cos = hemisphere.normal.dot(lobe.axis);
            let missed = if lobe.sharpness <= NARROWEST_SUMMED {
                true_share - left_by_edge(VisibleShare::new(), cos, out[k], lobe.sharpness)
            } else {
                0.0
            };
            out.push(missed);
        }
    }

    /// How many numbers [`seen_from`](Self::seen_from) returns.
    pub(super) fn seen_len(&self) -> usize {
        2 * self.len() - self.broad
    }

    /// Where what a sharp lobe's nearest edge misses is among them.
    #[inline(always)]
    pub(super) fn missed_at(&self, lobe: usize) -> usize {
        self.len() + lobe - self.broad
    }
}

/// Of what an empty surface would see of a lobe, the share that the nearest edge leaves.
#[inline(always)]
fn left_by_edge(share: VisibleShare, cos: f32, distance: f32, sharpness: f32) -> f32 {
    let horizon = asin(cos);
    let free = share.at(horizon, sharpness);
    let left = share.at(distance.min(horizon), sharpness);
    if free > 1e-3 { left / free } else { 0.0 }
}

wide! {
fn irradiance(sky: &Sky, normal: Vec3, all: &[f32]) -> Vec3 {
    let share = VisibleShare::new();
    let mut sums = [[0.0_f32; WIDE]; 3];
    let count = sky.len();
    for start in (0..count).step_by(WIDE) {
        let lanes = |column: &Vec<f32>| -> [f32; WIDE] {
            std::array::from_fn(|k| column[start..start + WIDE][k])
        };
        let [x, y, z] = sky.axis.each_ref().map(lanes);
        let (slope, bias, width) = (lanes(&sky.slope), lanes(&sky.bias), lanes(&sky.width));
        let mut seen: [f32; WIDE] = std::array::from_fn(|k| all[start..start + WIDE][k]);
        let mut cos = [0.0; WIDE];
        for k in 0..WIDE {
            cos[k] = normal.x * x[k] + normal.y * y[k] + normal.z * z[k];
        }
        if start >= sky.broad {
            let sharpness = lanes(&sky.sharpness);
            for k in 0..WIDE {
                let left = left_by_edge(share, cos[k], seen[k], sharpness[k]);
                seen[k] = (left + all[sky.missed_at(start + k)]).clamp(0.0, 1.0);
            }
        }
        let colours = sky.amplitude.each_ref().map(lanes);
        for k in 0..WIDE {
            let whole = (slope[k] * bend(cos[k], width[k]) + bias[k]).max(0.0) * seen[k];
            sums[0][k] += whole * colours[0][k];
            sums[1][k] += whole * colours[1][k];
            sums[2][k] += whole * colours[2][k];
        }
    }
    Vec3::from_array(sums.map(|lanes| lanes.iter().sum()))
}
}

wide! {
/// Shares of the lobes' irradiance on the point's surface, by quadrature over blocks of the map.
fn shares(sky: &Sky, hemisphere: &Hemisphere, blocks: &[MapBlock], out: &mut [f32]) {
    for (start, out) in (0..out.len()).step_by(WIDE).zip(out.chunks_exact_mut(WIDE)) {
        let lanes = |column: &Vec<f32>| -> [f32; WIDE] {
            std::array::from_fn(|k| column[start..start + WIDE][k])
        };
        let [x, y, z] = sky.axis.each_ref().map(lanes);
        let sharpness = lanes(&sky.sharpness);
        let (mut free, mut all) = ([0.0_f32; WIDE], [0.0_f32; WIDE]);
        // The lobes turn into the map's frame once.
        let (mut a, mut b, mut c) = ([0.0; WIDE], [0.0; WIDE], [0.0; WIDE]);
        for k in 0..WIDE {
            let axis = Vec3::new(x[k], y[k], z[k]);
            a[k] = hemisphere.side.dot(axis) * sharpness[k];
            b[k] = hemisphere.normal.dot(axis) * sharpness[k];
            c[k] = hemisphere.pole.dot(axis) * sharpness[k];
        }
        for block in blocks.iter() {
            let w = block.direction;
            for k in 0..WIDE {
                let value = exp(a[k] * w.x + b[k] * w.y + c[k] * w.z - sharpness[k]) * block.weight;
                all[k] += value;
                free[k] += value * block.free;
            }
        }
        for k in 0..WIDE {
            out[k] = if all[k] > 1e-12 { free[k] / all[k] } else { 0.0 };
        }
    }
}
}

/// Slope, bias and width of the fit, see [`Sky`]. The reference is quadrature.
fn fit_irradiance(sharpness: f32) -> (f32, f32, f32) {
    const COSINES: usize = 41;
    let cosine = |i: usize| -1.0 + 2.0 * i as f64 / (COSINES - 1) as f64;
    let truth: Vec<f64> = (0..COSINES)
        .map(|i| irradiance_of(f64::from(sharpness), cosine(i)))
        .collect();
    let mut best = (f64::INFINITY, 0.0, 0.0, 1.0);
    for step in 0..40 {
        let width = 0.02 * 1.2_f64.powi(step);
        let value = |i: usize| f64::from(bend(cosine(i) as f32, width as f32));
        let (mut y, mut yy, mut t, mut ty) = (0.0, 0.0, 0.0, 0.0);
        for (i, truth) in truth.iter().enumerate() {
            let v = value(i);
            (y, yy, t, ty) = (y + v, yy + v * v, t + truth, ty + truth * v);
        }
        let n = COSINES as f64;
        let det = n * yy - y * y;
        let slope = (n * ty - y * t) / det;
        let bias = (t - slope * y) / n;
        let error: f64 = (truth.iter().enumerate())
            .map(|(i, truth)| ((slope * value(i) + bias).max(0.0) - truth).powi(2))
            .sum();
        if error < best.0 {
            best = (error, slope, bias, width);
        }
    }
    (best.1 as f32, best.2 as f32, best.3 as f32)
}

/// Irradiance on a surface from a lobe of amplitude 1, by a midpoint rule over directions in proportion to the lobe.
fn irradiance_of(sharpness: f64, cos: f64) -> f64 {
    const POINTS: u32 = 48;
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let floor = (-2.0 * sharpness).exp();
    let mass = f64::from(SphericalGaussian::unit_integral(sharpness as f32));
    let mut sum = 0.0;
    for i in 0..POINTS {
        let u = (f64::from(i) + 0.5) / f64::from(POINTS);
        let z = (1.0 + (1.0 - u + u * floor).ln() / sharpness).clamp(-1.0, 1.0);
        let r = (1.0 - z * z).sqrt();
        for j in 0..POINTS {
            let phi = std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(POINTS);
            sum += (cos * z + sin * r * phi.cos()).max(0.0);
        }
    }
    mass * sum / f64::from(POINTS * POINTS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_visibility::field::{DistanceTransform, VisibilityMap};

    #[test]
    fn irradiance_is_what_quadrature_says() {
        for sharpness in [0.001, 0.5, 2.0, 10.0, 80.0, 400.0] {
            let (slope, bias, width) = fit_irradiance(sharpness);
            let largest = irradiance_of(f64::from(sharpness), 1.0);
            for i in 0..=40 {
                let cos = -1.0 + f64::from(i) / 20.0;
                let fit = (slope * bend(cos as f32, width) + bias).max(0.0);
                let error = (f64::from(fit) - irradiance_of(f64::from(sharpness), cos)).abs();
                assert!(
                    error < 0.015 * largest,
                    "{sharpness} {cos}: {error} of {largest}"
                );
            }
        }
    }

    /// An open hemisphere leaves all of every lobe; a half-plane leaves what quadrature says.
    #[test]
    fn shares_are_what_quadrature_says() {
        let lobes: Vec<SphericalGaussian> = (0..8)
            .map(|k| SphericalGaussian {
                axis: Vec3::new((k as f32).sin(), 0.6, (k as f32 * 1.7).cos()).normalize(),
                sharpness: 0.3 * 1.6_f32.powi(k),
                amplitude: Vec3::ONE,
            })
            .collect();
        let sky = Sky::new(&SkyLobes {
            lobes,
            ..SkyLobes::default()
        });
        let h = Hemisphere::new(Vec3::new(0.2, 1.0, 0.1).normalize(), Vec3::X);
        let mut seen = Vec::new();
        let open = VisibilityMap::new(128, true).blocks();
        sky.seen_from(&h, &open, |_| 0.0, &mut seen);
        assert!(seen.iter().take(8).all(|share| (share - 1.0).abs() < 1e-5));
        let free = |local: Vec3| local.x > 0.2 * local.y;
        let half = VisibilityMap::from_fn(128, free).blocks();
        sky.seen_from(&h, &half, |_| 0.0, &mut seen);
        for (k, share) in seen.iter().enumerate() {
            let lobe = sky.lobe(k);
            let (mut part, mut all) = (0.0_f64, 0.0_f64);
            for i in 0..200_000_u32 {
                let y = (f64::from(i) + 0.5) / 200_000.0;
                let a = f64::from(i) * 2.399_963_229_728_653;
                let r = (1.0 - y * y).sqrt();
                let local = Vec3::new((r * a.cos()) as f32, y as f32, (r * a.sin()) as f32);
                let value = lobe.sharpness * (lobe.axis.dot(h.to_world(local)) - 1.0);
                let value = f64::from(value).exp() * y;
                all += value;
                part += if free(local) { value } else { 0.0 };
            }
            assert!(
                (f64::from(*share) - part / all).abs() < 5e-3,
                "{k}: {share} {}",
                part / all
            );
        }
    }

    /// At the point itself a sharp lobe behind a slit has the share of quadrature, which the nearest edge alone misses by far.
    #[test]
    fn slits_dim_sharp_lobes() {
        let lobe = SphericalGaussian {
            axis: Vec3::new(0.3, 0.8, 0.2).normalize(),
            sharpness: 60.0,
            amplitude: Vec3::ONE,
        };
        let sky = Sky::new(&SkyLobes {
            lobes: vec![lobe],
            ..SkyLobes::default()
        });
        let h = Hemisphere::new(Vec3::Y, Vec3::X);
        let across = lobe.axis.any_orthonormal_vector();
        let free = |w: Vec3| w.dot(across).abs() < 0.06;
        let map = VisibilityMap::from_fn(128, |local| free(h.to_world(local)));
        let field = DistanceTransform::default().transform(&map);
        let mut seen = Vec::new();
        sky.seen_from(&h, &map.blocks(), |w| field.at(&h, w), &mut seen);
        assert_eq!(seen.len(), sky.seen_len());
        let found = sky.irradiance(Vec3::Y, &seen).x;
        let mut edge_alone = seen;
        edge_alone[sky.len()..].fill(0.0);
        let edge_alone = sky.irradiance(Vec3::Y, &edge_alone).x;
        let n = 400_000;
        let mut expected = 0.0;
        for i in 0..n {
            let y = (i as f32 + 0.5) / n as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - y * y).sqrt();
            let w = Vec3::new(r * cos, y, r * sin);
            if free(w) {
                expected += f64::from(lobe.at(w).x * y);
            }
        }
        let expected = (expected * std::f64::consts::TAU / f64::from(n)) as f32;
        println!("{found} of {expected}, by the nearest edge {edge_alone}");
        assert!((found / expected - 1.0).abs() < 0.06);
        assert!((edge_alone / expected - 1.0).abs() > 0.3);
    }
}
