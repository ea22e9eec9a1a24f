//! The sky in two parts: what is small and bright is left to rays that are aimed at it, the even rest to bundles.
//!
//! A sun that one of a thousand directions meets would be an error of the whole map at once. What is brighter than
//! `CLIP` times the mean is therefore cut off and becomes a light of its own; their sum is the sky as it was.

use glam::Vec3;
use occlude_image::Picture;
use occlude_render::light::Environment;

/// The even part has no direction brighter than so many times the mean luminance.
const CLIP: f32 = 4.0;

/// Both parts; `None` is black.
#[derive(Debug)]
pub struct SplitSky {
    /// For rays.
    pub bright: Option<Environment>,
    /// For bundles, and its largest channel.
    pub even: Option<(Environment, f32)>,
}

/// A constant sky: all of it is even.
pub fn constant(radiance: Vec3) -> SplitSky {
    SplitSky {
        bright: None,
        even: (radiance.max_element() > 0.0)
            .then(|| (Environment::constant(radiance), radiance.max_element())),
    }
}

/// Splits a latitude-longitude picture, turned by `rotation` radians and scaled.
pub fn split(picture: &Picture, rotation: f32, scale: f32) -> SplitSky {
    let limit = CLIP * mean_luminance(picture);
    // Colours keep their hue: both parts have the whole's.
    let share = |c: [f32; 3]| {
        let luminance = luminance(c);
        if luminance > limit {
            limit / luminance
        } else {
            1.0
        }
    };
    let even = picture.map(|c| c.map(|v| v.max(0.0) * share(c)));
    let bright = picture.map(|c| c.map(|v| v.max(0.0) * (1.0 - share(c))));
    let brightest = even.pixels.iter().flatten().copied().fold(0.0, f32::max) * scale;
    let as_light = |part: &Picture| {
        let lit = part.pixels.iter().flatten().any(|&v| v > 0.0);
        lit.then(|| Environment::from_picture(part, rotation, scale))
    };
    SplitSky {
        bright: as_light(&bright),
        even: as_light(&even).map(|sky| (sky, brightest)),
    }
}

fn luminance(c: [f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

/// Over the sphere: rows near the poles are short.
fn mean_luminance(picture: &Picture) -> f32 {
    let (mut sum, mut weight) = (0.0_f64, 0.0_f64);
    for (y, row) in picture
        .pixels
        .chunks(picture.width.max(1) as usize)
        .enumerate()
    {
        let polar = (y as f64 + 0.5) / f64::from(picture.height.max(1)) * std::f64::consts::PI;
        let area = polar.sin();
        for &c in row {
            sum += area * f64::from(luminance(c).max(0.0));
            weight += area;
        }
    }
    (sum / weight.max(1e-30)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_and_the_sun_is_cut_out() {
        let mut picture = Picture::new(64, 32);
        picture.pixels.fill([0.5, 1.0, 2.0]);
        picture.pixels[10 * 64 + 20] = [9000.0, 8000.0, 5000.0];
        let sky = split(&picture, 0.0, 2.0);
        let (bright, (even, brightest)) = (sky.bright.unwrap(), sky.even.unwrap());
        let whole = Environment::from_picture(&picture, 0.0, 2.0);
        for k in 0..500 {
            let z = 1.0 - (k as f32 + 0.5) / 250.0;
            let (sin, cos) = (k as f32 * 2.4).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let wi = Vec3::new(r * cos, z, r * sin);
            let sum = bright.radiance(wi) + even.radiance(wi);
            let error = (sum - whole.radiance(wi)).abs().max_element();
            assert!(error <= 1e-4 * whole.radiance(wi).max_element(), "{wi}");
            assert!(even.radiance(wi).max_element() <= brightest * 1.0001);
        }
        assert!(bright.integral().x > 10.0 * even.integral().x * 0.01);
        assert!(constant(Vec3::ZERO).even.is_none());
        let dull = split(
            &Picture::from_pixels(2, 1, vec![[1.0; 3]; 2]).unwrap(),
            0.0,
            1.0,
        );
        assert!(dull.bright.is_none() && dull.even.is_some());
    }
}
