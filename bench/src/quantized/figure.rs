//! Pictures in the manner of Popov 2013, Fig. 5: exact above the diagonal and cached below it, the difference of the
//! luminance sixteen times brighter, and close-ups where the two differ most.

use super::quality::{BLOCK, Quality};
use super::shot::Shot;
use crate::common::{Report, Setting};
use occlude_image::metrics::middle_grey_exposure;
use occlude_image::{Look, Picture, ToneMap};

/// How much brighter differences are shown.
const AMPLIFIED: f32 = 16.0;
/// Screen pixels of a pixel in close-ups.
const ZOOM: u32 = 6;

/// Writes the three pictures of a scene, and shows them in the report.
pub fn show(
    setting: &Setting,
    report: &mut Report,
    (name, samples): (&str, u32),
    exact: &Shot,
    cached: &Shot,
    quality: &Quality,
) -> Result<(), String> {
    let (e, c) = (&exact.picture, &cached.picture);
    let exposure_ev = middle_grey_exposure(e);
    let look = Look {
        exposure_ev,
        ..Look::default()
    };
    let plain = Look {
        tone_map: ToneMap::None,
        exposure_ev: 0.0,
    };
    std::fs::create_dir_all(&setting.out).map_err(|e| e.to_string())?;
    let write = |what: &str, picture: &Picture, look: Look| -> Result<String, String> {
        let file = format!("{name}-{what}.png");
        occlude_image::write(&setting.out.join(&file), picture, look).map_err(|e| e.to_string())?;
        Ok(format!("<img src=\"{file}\" alt=\"{name}, {what}\"> "))
    };
    let html = [
        write("diagonal", &diagonal(e, c), look)?,
        write("difference", &difference(e, c, exposure_ev), plain)?,
        write("close-ups", &close_ups(e, c, &quality.worst), look)?,
    ];
    report.figure(
        &format!(
            "{name}, {} samples a pixel: exact above the diagonal ({:.1} s), cached below ({:.1} s, {:.1} times fewer rays); luminance \
             error x {AMPLIFIED}; close-ups of the two blocks that differ most, exact on the left, cached on the right",
            samples,
            exact.seconds,
            cached.seconds,
            cached.reduction()
        ),
        html.concat(),
    );
    Ok(())
}

fn diagonal(exact: &Picture, cached: &Picture) -> Picture {
    let (width, height) = (exact.width, exact.height);
    let mut both = exact.clone();
    for (i, pixel) in both.pixels.iter_mut().enumerate() {
        let (x, y) = (i as u32 % width, i as u32 / width);
        // From the lower left corner to the upper right one.
        let below = f64::from(x) / f64::from(width) + f64::from(y) / f64::from(height) - 1.0;
        if below > 0.0 {
            *pixel = cached.pixels[i];
        }
        if below.abs() * f64::from(width) < 1.0 {
            *pixel = [1e3; 3];
        }
    }
    both
}

fn difference(exact: &Picture, cached: &Picture, exposure_ev: f32) -> Picture {
    let scale = AMPLIFIED * exposure_ev.exp2();
    let mut map = exact.clone();
    for (pixel, cached) in map.pixels.iter_mut().zip(&cached.pixels) {
        let luminance = |c: &[f32; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
        *pixel = [((luminance(pixel) - luminance(cached)) * scale).abs(); 3];
    }
    map
}

fn close_ups(exact: &Picture, cached: &Picture, corners: &[[u32; 2]]) -> Picture {
    let (side, gap) = (BLOCK * ZOOM, ZOOM);
    let mut sheet = Picture::new(2 * side + gap, corners.len() as u32 * (side + gap) - gap);
    for (row, &[left, top]) in corners.iter().enumerate() {
        for (column, picture) in [exact, cached].into_iter().enumerate() {
            for y in 0..side {
                for x in 0..side {
                    let to_x = column as u32 * (side + gap) + x;
                    let to_y = row as u32 * (side + gap) + y;
                    let from = picture.get(left + x / ZOOM, top + y / ZOOM);
                    sheet.pixels[(to_y * sheet.width + to_x) as usize] = from.unwrap_or_default();
                }
            }
        }
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_is_above_the_diagonal() {
        let exact = Picture::from_pixels(80, 50, vec![[0.1; 3]; 4000]).unwrap();
        let cached = Picture::from_pixels(80, 50, vec![[0.2; 3]; 4000]).unwrap();
        let both = diagonal(&exact, &cached);
        assert_eq!(both.get(2, 2), Some([0.1; 3]));
        assert_eq!(both.get(77, 47), Some([0.2; 3]));
        let map = difference(&exact, &cached, 0.0);
        assert!((map.pixels[0][0] - 1.6).abs() < 1e-5);
        let sheet = close_ups(&exact, &cached, &[[0, 0], [64, 32]]);
        assert_eq!(sheet.get(5, 5), Some([0.1; 3]));
        assert_eq!(sheet.get(BLOCK * ZOOM + ZOOM + 5, 5), Some([0.2; 3]));
        // Beyond the picture it is black.
        assert_eq!(sheet.get(100, sheet.height - 1), Some([0.0; 3]));
    }
}
