//! A rectangle of colours.

use crate::ImageError;

/// A picture: scene-linear Rec. 709 radiance unless said otherwise, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` colours.
    pub pixels: Vec<[f32; 3]>,
}

impl Picture {
    /// A black picture.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            pixels: vec![[0.0; 3]; width as usize * height as usize],
        }
    }

    /// A picture of the given colours.
    ///
    /// # Errors
    /// [`ImageError::Inconsistent`] if there are not exactly `width * height` of them.
    pub fn from_pixels(width: u32, height: u32, pixels: Vec<[f32; 3]>) -> Result<Self, ImageError> {
        if pixels.len() as u64 != u64::from(width) * u64::from(height) {
            return Err(ImageError::Inconsistent(format!(
                "{} pixels for {width}x{height}",
                pixels.len()
            )));
        }
        Ok(Self {
            width,
            height,
            pixels,
        })
    }

    /// The colour at column `x`, row `y`; `None` outside.
    pub fn get(&self, x: u32, y: u32) -> Option<[f32; 3]> {
        if x >= self.width {
            return None;
        }
        self.pixels
            .get(y as usize * self.width as usize + x as usize)
            .copied()
    }

    /// The mean of each channel, summed in f64; zero for an empty picture.
    pub fn mean(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for p in &self.pixels {
            for c in 0..3 {
                sum[c] += f64::from(p[c]);
            }
        }
        sum.map(|s| s / self.pixels.len().max(1) as f64)
    }

    /// Replaces what is not a finite number by 0 and returns how many pixels that touched.
    pub fn repair(&mut self) -> u64 {
        let mut repaired = 0;
        for p in &mut self.pixels {
            if p.iter().any(|v| !v.is_finite()) {
                repaired += 1;
                *p = p.map(|v| if v.is_finite() { v } else { 0.0 });
            }
        }
        repaired
    }

    /// Every channel through `f`.
    pub fn map(&self, f: impl Fn([f32; 3]) -> [f32; 3]) -> Self {
        Self {
            width: self.width,
            height: self.height,
            pixels: self.pixels.iter().map(|&p| f(p)).collect(),
        }
    }

    /// Errs unless `other` has this picture's size.
    pub(crate) fn same_size(&self, other: &Picture) -> Result<(), ImageError> {
        for p in [self, other] {
            if p.pixels.len() as u64 != u64::from(p.width) * u64::from(p.height) {
                return Err(ImageError::Inconsistent(format!(
                    "{} pixels for {}x{}",
                    p.pixels.len(),
                    p.width,
                    p.height
                )));
            }
        }
        if (self.width, self.height) != (other.width, other.height) {
            return Err(ImageError::SizeMismatch {
                a: (self.width, self.height),
                b: (other.width, other.height),
            });
        }
        Ok(())
    }
}

/// The luminance of linear Rec. 709 (Rec. ITU-R BT.709-6, item 3.2).
pub(crate) fn luminance(c: [f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}
