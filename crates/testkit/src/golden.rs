//! Pictures to look at when a test fails.

use crate::picture::Picture;
use std::path::PathBuf;

/// Where evidence is written: `CARGO_TARGET_TMPDIR` of the test where cargo sets it at run time, else the system's folder
/// for temporary files.
fn folder() -> PathBuf {
    std::env::var_os("CARGO_TARGET_TMPDIR")
        .map_or_else(std::env::temp_dir, PathBuf::from)
        .join("occlude-evidence")
}

/// Writes found, expected and their difference in standard deviations side by side, and says where (or why not).
pub fn write_evidence(name: &str, found: &Picture, expected: &Picture) -> String {
    let path = folder().join(name).with_extension("png");
    let save = || -> Result<(), Box<dyn std::error::Error>> {
        std::fs::create_dir_all(folder())?;
        side_by_side(found, expected).save(&path)?;
        Ok(())
    };
    match save() {
        Ok(()) => format!("see {}", path.display()),
        Err(error) => format!("no evidence written to {}: {error}", path.display()),
    }
}

fn side_by_side(found: &Picture, expected: &Picture) -> image::RgbImage {
    let (width, height, channels) = found.size();
    // One exposure for both: the brightest percent of the expected picture may clip.
    let mut values: Vec<f64> = expected
        .pixels()
        .iter()
        .map(|e| e.mean)
        .filter(|m| m.is_finite())
        .collect();
    values.sort_by(f64::total_cmp);
    let white = values
        .get(values.len() * 99 / 100)
        .copied()
        .unwrap_or(1.0)
        .max(f64::MIN_POSITIVE);
    let tone = |value: f64| ((value / white).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
    let deviation = |i: usize| {
        let (a, b) = (found.pixels()[i], expected.pixels()[i]);
        let difference = a.mean - b.mean;
        if difference == 0.0 {
            0.0
        } else {
            difference / (a.variance + b.variance).sqrt()
        }
    };
    image::RgbImage::from_fn(3 * width as u32, height as u32, |x, y| {
        let (panel, x) = (x as usize / width, x as usize % width);
        let first = (y as usize * width + x) * channels;
        let channel = |c: usize| first + c.min(channels - 1);
        image::Rgb(match panel {
            0 => [0, 1, 2].map(|c| tone(found.pixels()[channel(c)].mean)),
            1 => [0, 1, 2].map(|c| tone(expected.pixels()[channel(c)].mean)),
            _ => {
                let worst = (first..first + channels)
                    .map(deviation)
                    .max_by(|a, b| a.abs().total_cmp(&b.abs()));
                let strength = worst.map_or(0.0, |z| (z / 5.0).clamp(-1.0, 1.0));
                let faded = (128.0 * (1.0 - strength.abs())) as u8;
                match strength {
                    s if s.is_nan() => [255, 0, 255],
                    s if s >= 0.0 => [128 + (127.0 * s) as u8, faded, faded],
                    s => [faded, faded, 128 + (-127.0 * s) as u8],
                }
            }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_shows_what_differs() {
        let expected = Picture::from_variance(2, 1, 1, &[1.0, 1.0], &[0.01, 0.01], 9.0);
        let found = Picture::from_variance(2, 1, 1, &[1.0, 3.0], &[0.01, 0.01], 9.0);
        let picture = side_by_side(&found, &expected);
        assert_eq!(picture.dimensions(), (6, 1));
        assert_eq!(picture.get_pixel(4, 0).0, [128, 128, 128]);
        assert_eq!(picture.get_pixel(5, 0).0, [255, 0, 0]);
        let said = write_evidence("golden-test", &found, &expected);
        assert!(said.starts_with("see "), "{said}");
    }
}
