//! Where the light of a texel comes from, for surfaces with normal maps.
//!
//! What is gathered is the first moment `M`, the sum over directions of luminance times cosine times the unit vector to where it comes from,
//! in the axes of the world. From it and the irradiance `E` come four numbers a texel:
//!
//! * [`Directional::Sh1`]: `E(n') = E (W + XYZ . n')` for any normal `n'`; for the surface's own it is `E`. Radiance is taken as
//!   linear in the direction, `L0 + L1 . w`, the least squares fit weighted by the cosine, which has the closed form of [`sh1`].
//!   Light from a single direction is more than linear: it is bounded to `|XYZ| = 2 W`, which is its own projection to spherical harmonics.
//! * [`Directional::Dominant`]: `XYZ = M / |M|`, the direction that most light comes from, and `W = |M| / E`, 1 if all comes from there, 2/3 for
//!   an even sky.
//!
//! Colours are not told apart: all channels come from where the luminance does.

use super::{ExportSettings, Light};
use crate::finish::orphans::adopt;
use crate::finish::{Canvas, LEAST_VALIDITY};
use crate::gather::luminance;
use crate::texel::Texels;
use glam::Vec3;
use std::f32::consts::PI;

/// What is told about directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Directional {
    /// Nothing.
    #[default]
    None,
    /// Irradiance as a linear function of the normal.
    Sh1,
    /// The direction that most light comes from.
    Dominant,
}

impl Directional {
    /// The name of the layer: its channels are `name.X` to `name.W`.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Sh1 => "sh1",
            Self::Dominant => "dominant",
        }
    }
}

/// `XYZ` and `W` of irradiance as a linear function of the normal; `moment` is relative to the irradiance.
///
/// With radiance `L0 + L1 . w` over the hemisphere, `E = pi L0 + (2 pi / 3) L1n` along the normal; the moment is `(2 pi / 3) L0 + (pi / 2) L1n` along it
/// and `(pi / 4) L1t` across. Solved for `E = 1`; then `E(n') = pi L0 + (2 pi / 3) L1 . n'`.
pub fn sh1(moment: Vec3, normal: Vec3) -> (Vec3, f32) {
    let along = moment.dot(normal);
    let across = moment - normal * along;
    let l1 = across * (4.0 / PI) + normal * ((PI * along - 2.0 * PI / 3.0) * 18.0 / (PI * PI));
    let slope = l1 * (2.0 * PI / 3.0);
    let most = slope.length() + 2.0 * slope.dot(normal);
    let slope = slope * if most > 2.0 { 2.0 / most } else { 1.0 };
    (slope, 1.0 - slope.dot(normal))
}

/// The most light comes from the first three numbers' direction; the fourth is how much of it does.
fn dominant(moment: Vec3, normal: Vec3) -> (Vec3, f32) {
    let length = moment.length();
    (moment.try_normalize().unwrap_or(normal), length.min(1.0))
}

/// Four numbers for every texel of a finished page. Texels without a value of their own, and those around charts, take those of their neighbours as the light does.
pub(super) fn directions(
    texels: &Texels,
    light: &impl Light,
    page: u32,
    canvas: &Canvas,
    settings: &ExportSettings,
) -> Vec<[f32; 4]> {
    let size = texels.atlas.pages[page as usize];
    // The canvases carry charts and validity; only their values differ.
    let mut vectors = canvas.clone();
    vectors.values.fill([0.0; 3]);
    let mut scalars = vectors.clone();
    for (_, rows) in texels.bands(64).filter(|(of, _)| *of == page) {
        let band = texels.band(page, rows);
        for i in 0..band.len() {
            let texel = band.texel(i);
            let index = (texel - size.first_texel) as usize;
            if canvas.charts[index] == 0 || canvas.validity[index] < LEAST_VALIDITY {
                continue;
            }
            let (_, normal) = texels.world_place(&band, i);
            let all = luminance(Vec3::from(light.irradiance(texel)));
            let moment = Vec3::from(light.moment(texel)) / all;
            // Where there is no light it comes from everywhere.
            let moment = if moment.is_finite() {
                moment
            } else {
                normal * (2.0 / 3.0)
            };
            let (vector, scalar) = match settings.directional {
                Directional::Sh1 => sh1(moment, normal),
                Directional::Dominant | Directional::None => dominant(moment, normal),
            };
            vectors.values[index] = vector.to_array();
            scalars.values[index] = [scalar, 0.0, 0.0];
        }
    }
    for canvas in [&mut vectors, &mut scalars] {
        canvas.fill_invalid();
        adopt(texels, page, canvas);
        canvas.dilate(settings.dilate);
    }
    let pairs = vectors.values.iter().zip(&scalars.values);
    let four = |(v, s): (&[f32; 3], &[f32; 3])| [v[0], v[1], v[2], s[0]];
    pairs.map(four).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Irradiance and first moment of a radiance, by quadrature.
    fn integrate(normal: Vec3, radiance: impl Fn(Vec3) -> f32) -> (f32, Vec3) {
        let (mut all, mut moment) = (0.0_f64, glam::DVec3::ZERO);
        let (x, y) = occlude_render::sampling::warp::basis(normal);
        let n = 400;
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let u = glam::Vec2::new((i as f32 + 0.5) / n as f32, (j as f32 + 0.5) / n as f32);
            let d = occlude_render::sampling::warp::cosine_hemisphere(u);
            let w = x * d.x + y * d.y + normal * d.z;
            let light = f64::from(PI * radiance(w)) / f64::from(n * n);
            all += light;
            moment += w.as_dvec3() * light;
        }
        (all as f32, moment.as_vec3())
    }

    #[test]
    fn linear_radiance_is_found_again() {
        let normal = Vec3::new(0.3, 0.8, -0.5).normalize();
        let (l0, l1) = (1.0, Vec3::new(0.2, -0.3, 0.4));
        let (all, moment) = integrate(normal, |w| l0 + l1.dot(w));
        let (vector, scalar) = sh1(moment / all, normal);
        let expected = l1 * (2.0 * PI / 3.0) / all;
        assert!((vector - expected).length() < 0.01, "{vector} {expected}");
        assert!((scalar - PI * l0 / all).abs() < 0.01, "{scalar}");
        assert!((scalar + vector.dot(normal) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_single_direction_is_bounded_to_its_harmonics() {
        let sun = Vec3::new(0.6, 0.8, 0.0);
        for normal in [Vec3::Y, sun, Vec3::X] {
            let (vector, scalar) = sh1(sun, normal);
            assert!(vector.length() <= 2.0 * scalar + 1e-4, "{vector} {scalar}");
            assert!((scalar + vector.dot(normal) - 1.0).abs() < 1e-5);
            // A grazing light is badly told from one that is more so.
            let aligned = if normal == Vec3::X { 0.5 } else { 0.9 };
            assert!(vector.dot(sun) > aligned * vector.length(), "{vector}");
            assert_eq!(dominant(sun, normal), (sun, 1.0));
        }
    }
}
