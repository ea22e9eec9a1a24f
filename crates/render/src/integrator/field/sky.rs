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
        for group in [sorted, sharp] {
            let count = group.len().next_multiple_of(WIDE);
            let missing = count - group.len();
            for lobe in group.into_iter().chain((0..missing).map(|_| black)) {
                sky.push(&lobe);
            }
            if sky.broad == 0 {
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

    /// What of each lobe a point sees: shares of broad lobes' irradiance, distances of sharp ones' centres.
    pub(super) fn seen_from(
        &self,
        hemisphere: &Hemisphere,
        blocks: &[MapBlock],
        distance: impl Fn(Vec3) -> f32,
        out: &mut Vec<f32>,
    ) {
        out.clear();
        out.resize(self.len(), 0.0);
        if self.broad > 0 {
            shares(self, hemisphere, blocks, &mut out[..self.broad]);
        }
        for (k, out) in out.iter_mut().enumerate().skip(self.broad) {
            *out = distance(self.lobe(k).axis);
        }
    }
}

wide! {
fn irradiance(sky: &Sky, normal: Vec3, seen: &[f32]) -> Vec3 {
    let share = VisibleShare::new();
    let mut sums = [[0.0_f32; WIDE]; 3];
    let count = sky.len();
    for start in (0..count).step_by(WIDE) {
        let lanes = |column: &Vec<f32>| -> [f32; WIDE] {
            std::array::from_fn(|k| column[start..start + WIDE][k])
        };
        let [x, y, z] = sky.axis.each_ref().map(lanes);
        let (slope, bias, width) = (lanes(&sky.slope), lanes(&sky.bias), lanes(&sky.width));
        let mut seen: [f32; WIDE] = std::array::from_fn(|k| seen[start..start + WIDE][k]);
        let mut cos = [0.0; WIDE];
        for k in 0..WIDE {
            cos[k] = normal.x * x[k] + normal.y * y[k] + normal.z * z[k];
        }
        if start >= sky.broad {
            let sharpness = lanes(&sky.sharpness);
            for k in 0..WIDE {
                // Of what an empty surface would see of the lobe, the share that the nearest edge leaves.
                let horizon = asin(cos[k]);
                let free = share.at(horizon, sharpness[k]);
                let left = share.at(seen[k].min(horizon), sharpness[k]);
                seen[k] = if free > 1e-3 { left / free } else { 0.0 };
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
    use occlude_visibility::field::VisibilityMap;

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
        assert!(seen.iter().all(|share| (share - 1.0).abs() < 1e-5));
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
}
