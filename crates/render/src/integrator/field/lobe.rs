//! One lobe of a surface under all lobes of the sky: what arrives of their products past the edges around (Wang et al. 2013, Eq. 2, section 6).
//!
//! Products of spherical Gaussians are spherical Gaussians; each is visible to the share that a straight edge at the interpolated distance leaves, or, where it is too broad
//! for one edge, to the share that the points' harmonics tell.
//!
//! Holds: eight products at once give what one at a time would. Wrong tool for mirrors (one ray each) and for lights that are no lobes.

use super::math::{exp, wide};
use super::shade::Shading;
use super::sky::WIDE;
use glam::Vec3;
use occlude_visibility::field::{BroadShare, Harmonics, VisibleShare, bands_at_eight};

wide! {
/// The integral of the sky's lobes times a lobe of amplitude 1 over the free directions; and `rest`, the same of what the sky has beside them were nothing
/// in the way, times the share of the lobe that is visible.
pub(super) fn in_lobe(shading: &Shading<'_, '_>, axis: Vec3, sharpness: f32, rest: Vec3, near: &[(u32, f32)]) -> Vec3 {
    // What brings less than this share of the sum is not asked about.
    const NEGLIGIBLE: f32 = 2e-3;
    const MOST: usize = 128;
    let sky = shading.sky;
    let share = VisibleShare::new();
    let count = sky.len().min(MOST);
    let (mut lengths, mut values) = ([0.0_f32; MOST], [0.0_f32; MOST]);
    let mut brightness = [0.0_f32; MOST];
    let mut total = [0.0_f32; WIDE];
    for start in (0..count).step_by(WIDE) {
        let lanes = |column: &Vec<f32>| -> [f32; WIDE] {
            std::array::from_fn(|k| column[start..start + WIDE][k])
        };
        let [x, y, z] = sky.axis.each_ref().map(lanes);
        let [r, g, b] = sky.amplitude.each_ref().map(lanes);
        let other = lanes(&sky.sharpness);
        for k in 0..WIDE {
            // The product of two lobes: SphericalGaussian::product.
            let cos = axis.x * x[k] + axis.y * y[k] + axis.z * z[k];
            let square = sharpness * sharpness + other[k] * other[k]
                + 2.0 * sharpness * other[k] * cos;
            let length = square.max(1e-12).sqrt();
            let whole = std::f32::consts::TAU * (1.0 - exp(-2.0 * length)) / length;
            let value = exp(length - sharpness - other[k]) * whole;
            let bright = value * (r[k] + g[k] + b[k]);
            lengths[start + k] = length;
            values[start + k] = value;
            brightness[start + k] = bright;
            total[k] += bright;
        }
    }
    let least = NEGLIGIBLE * total.iter().sum::<f32>();
    let mut sum = Vec3::ZERO;
    let mut harmonics = Harmonics::default();
    for &(id, weight) in near {
        for (sum, c) in harmonics.iter_mut().zip(&shading.points.list[id as usize].harmonics) {
            *sum += c * weight;
        }
    }
    let mut light = [Vec3::ZERO; WIDE];
    let mut w = [[0.0_f32; WIDE]; 3];
    let mut length = [1.0_f32; WIDE];
    let mut filled = 0;
    if rest.abs().element_sum() > least {
        (light[0], length[0]) = (rest, sharpness);
        [w[0][0], w[1][0], w[2][0]] = axis.to_array();
        filled = 1;
    }
    let mut k = 0;
    loop {
        while k < count && filled < WIDE {
            if brightness[k] > least {
                length[filled] = lengths[k];
                let other = sky.sharpness[k];
                w[0][filled] = (axis.x * sharpness + sky.axis[0][k] * other) / lengths[k];
                w[1][filled] = (axis.y * sharpness + sky.axis[1][k] * other) / lengths[k];
                w[2][filled] = (axis.z * sharpness + sky.axis[2][k] * other) / lengths[k];
                let [r, g, b] = sky.amplitude.each_ref().map(|column| column[k]);
                light[filled] = Vec3::new(r, g, b) * values[k];
                filled += 1;
            }
            k += 1;
        }
        if filled == 0 {
            break;
        }
        let mut trust = [0.0_f32; WIDE];
        for lane in 0..filled {
            trust[lane] = BroadShare::trust(length[lane]);
        }
        let mut visible = [0.0_f32; WIDE];
        if trust[..filled].iter().any(|&t| t < 1.0) {
            let mut distance = [0.0_f32; WIDE];
            for &(id, weight) in near {
                let point = &shading.points.list[id as usize];
                let found = point.field.at_eight(&point.hemisphere, &w);
                for lane in 0..WIDE {
                    distance[lane] += found[lane] * weight;
                }
            }
            visible = share.at_eight(&distance, &length);
        }
        if trust.iter().any(|&t| t > 0.0) {
            let broad = BroadShare::new().at_eight(&bands_at_eight(&harmonics, &w), &length);
            for lane in 0..WIDE {
                visible[lane] += (broad[lane] - visible[lane]) * trust[lane];
            }
        }
        for (light, visible) in light.iter().zip(visible).take(filled) {
            sum += *light * visible;
        }
        filled = 0;
        if k >= count {
            break;
        }
    }
    sum
}
}
