//! Flicker: what changes from picture to picture of a sequence and does not change in the reference.
//!
//! FLIP between successive pictures says how visible a change is. Motion is such a change, and is in both sequences: what counts is where the
//! test changes more. Wrong tool where the reference is noisy: its noise changes, too, and hides flicker (say how noisy it is beside the number).

use super::flip::{DEFAULT_PPD, ldr};
use crate::{ImageError, Picture};

/// Visible change from picture to picture: means over pixels and over pairs of successive pictures, in `[0, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flicker {
    /// Mean FLIP between successive pictures of the test.
    pub test: f64,
    /// Of the reference.
    pub reference: f64,
    /// Mean of the test's change above the reference's, pixel by pixel.
    pub excess: f64,
    /// Largest mean excess of one pair: a picture in which something pops.
    pub worst: f64,
}

/// Compares two sequences of display pictures (linear light, tone mapped) frame by frame. Takes two FLIPs a pair.
///
/// # Errors
/// [`ImageError::Inconsistent`] if the sequences have different lengths, [`ImageError::SizeMismatch`] if pictures differ in size.
pub fn flicker(test: &[Picture], reference: &[Picture]) -> Result<Flicker, ImageError> {
    if test.len() != reference.len() {
        return Err(ImageError::Inconsistent(format!(
            "{} pictures against {}",
            test.len(),
            reference.len()
        )));
    }
    let mut flicker = Flicker::default();
    let pairs = test.windows(2).zip(reference.windows(2));
    for (test, reference) in pairs {
        test[0].same_size(&reference[0])?;
        let test = ldr(&test[1], &test[0], DEFAULT_PPD)?;
        let reference = ldr(&reference[1], &reference[0], DEFAULT_PPD)?;
        let mean = |sum: f64| sum / test.len().max(1) as f64;
        let excess = test.iter().zip(&reference);
        let excess = mean(excess.map(|(t, r)| f64::from((t - r).max(0.0))).sum());
        flicker.test += mean(test.iter().map(|&t| f64::from(t)).sum());
        flicker.reference += mean(reference.iter().map(|&r| f64::from(r)).sum());
        flicker.excess += excess;
        flicker.worst = flicker.worst.max(excess);
    }
    let pairs = test.len().saturating_sub(1).max(1) as f64;
    flicker.test /= pairs;
    flicker.reference /= pairs;
    flicker.excess /= pairs;
    Ok(flicker)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright square that moves over a gradient; `blink`: one corner is brighter in every second picture.
    fn sequence(blink: f32) -> Vec<Picture> {
        (0..5)
            .map(|frame| {
                let mut picture = Picture::new(48, 40);
                for (i, pixel) in picture.pixels.iter_mut().enumerate() {
                    let (x, y) = (i % 48, i / 48);
                    let inside =
                        (10..20).contains(&y) && (2 * frame + 8..2 * frame + 18).contains(&x);
                    let corner = if x > 36 && y > 28 && frame % 2 == 1 {
                        blink
                    } else {
                        0.0
                    };
                    let value = if inside { 0.8 } else { 0.1 + x as f32 / 200.0 };
                    *pixel = [value + corner; 3];
                }
                picture
            })
            .collect()
    }

    #[test]
    fn motion_is_no_flicker_and_blinking_is() {
        let still = flicker(&sequence(0.0), &sequence(0.0)).unwrap();
        assert!(still.test > 0.01 && still.test == still.reference);
        assert_eq!((still.excess, still.worst), (0.0, 0.0));
        let faint = flicker(&sequence(0.03), &sequence(0.0)).unwrap();
        let strong = flicker(&sequence(0.3), &sequence(0.0)).unwrap();
        assert!(0.0 < faint.excess && faint.excess < strong.excess);
        assert!(strong.worst >= strong.excess && strong.test > strong.reference);
        // The other way round nothing flickers that should not.
        // (But for rounding in the filters.)
        let reversed = flicker(&sequence(0.0), &sequence(0.3)).unwrap();
        assert!(reversed.excess < 1e-7 && reversed.worst < 1e-7);
    }

    #[test]
    fn sequences_that_cannot_be_compared() {
        let mut short = sequence(0.0);
        short.pop();
        assert!(flicker(&short, &sequence(0.0)).is_err());
        short.push(Picture::new(3, 3));
        assert!(flicker(&short, &sequence(0.0)).is_err());
        assert_eq!(flicker(&[], &[]).unwrap(), Flicker::default());
    }
}
