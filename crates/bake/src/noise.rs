//! How noisy a gather is: the mean relative standard error, estimated on a few sides by the spread of batches.
//!
//! A standard error for every texel would double the memory of a bake. Every `EVERY`th side is watched instead: at the end of every batch
//! (items that are gathered one after the other) the mean of the batch is compared with the mean of all. Batches are
//! independent of each other; texels are not, so this says how far a typical texel is off, not how errors lie together.

use crate::sums::{Sum, Sums};
use std::io::{Read, Write};

/// One side in so many is watched.
const EVERY: u32 = 61;

/// Fewer batches say nothing about their spread.
const LEAST_BATCHES: u32 = 4;

/// Sides that are looked at between two times that sums on disk may leave memory.
const WATCHED_TOGETHER: usize = 1 << 11;

/// What is known of one side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Watched {
    /// Luminance-weighted sums and weight up to the last batch, in the integers of [`Sums`].
    light: i64,
    weight: i64,
    /// Of the batches: sum of squared weight, of weight times light, and of light squared.
    ww: f64,
    wl: f64,
    ll: f64,
}

/// Spread of batches on a few sides.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Noise {
    watched: Vec<Watched>,
    batches: u32,
}

/// Green stands for luminance in integers: twice green and once each of the others, without overflow of what has room for 62 bits.
fn light(sum: Sum) -> i64 {
    (sum[0] / 4) + (sum[1] / 2) + (sum[2] / 4)
}

impl Noise {
    /// Watches some of so many sides.
    pub fn new(sides: u32) -> Self {
        Self {
            watched: vec![Watched::default(); sides.div_ceil(EVERY) as usize],
            batches: 0,
        }
    }

    /// Bytes for so many sides.
    pub fn bytes(sides: u32) -> u64 {
        u64::from(sides.div_ceil(EVERY)) * size_of::<Watched>() as u64
    }

    /// Takes note of a batch: what has been added to the sums since the last call.
    pub fn end_batch(&mut self, sums: &Sums) {
        for (k, watched) in self.watched.iter_mut().enumerate() {
            let side = k as u32 * EVERY;
            if k % WATCHED_TOGETHER == 0 {
                sums.release();
            }
            let mut run = sums.lock(sums.run_of(side));
            let index = (side - run.first()) as usize;
            let sum = run.sums()[index];
            let (l, w) = (
                (light(sum) - watched.light) as f64,
                (sum[3] - watched.weight) as f64,
            );
            watched.light = light(sum);
            watched.weight = sum[3];
            watched.ww += w * w;
            watched.wl += w * l;
            watched.ll += l * l;
        }
        sums.release();
        self.batches += 1;
    }

    /// The mean relative standard error of the irradiance, estimated; infinite as long as there are too few batches.
    ///
    /// The variance of a ratio of sums, by batches: sum (l - m w)^2 / W^2. Relative to the side's own value plus a hundredth of the
    /// mean, so that dark sides do not decide.
    pub fn relative_error(&self) -> f64 {
        let lit: Vec<&Watched> = self.watched.iter().filter(|w| w.weight > 0).collect();
        if self.batches < LEAST_BATCHES || lit.is_empty() {
            return f64::INFINITY;
        }
        let mean_of = |w: &Watched| w.light as f64 / w.weight as f64;
        let overall = lit.iter().map(|w| mean_of(w)).sum::<f64>() / lit.len() as f64;
        if overall <= 0.0 {
            return 0.0;
        }
        let n = f64::from(self.batches);
        let total: f64 = lit
            .iter()
            .map(|w| {
                let mean = mean_of(w);
                let spread = (w.ll - 2.0 * mean * w.wl + mean * mean * w.ww).max(0.0);
                let error = (spread * n / (n - 1.0)).sqrt() / w.weight as f64;
                error / (mean + 0.01 * overall)
            })
            .sum();
        total / lit.len() as f64
    }

    /// Writes what is known.
    pub fn write(&self, out: &mut (impl Write + ?Sized)) -> std::io::Result<()> {
        out.write_all(&self.batches.to_le_bytes())?;
        out.write_all(&(self.watched.len() as u32).to_le_bytes())?;
        let mut bytes = Vec::with_capacity(self.watched.len() * 40);
        for w in &self.watched {
            bytes.extend(w.light.to_le_bytes());
            bytes.extend(w.weight.to_le_bytes());
            for number in [w.ww, w.wl, w.ll] {
                bytes.extend(number.to_le_bytes());
            }
        }
        out.write_all(&bytes)
    }

    /// Reads what was written about so many sides, or about none.
    pub fn read(source: &mut impl Read, sides: u32) -> std::io::Result<Self> {
        let mut word = [0; 4];
        source.read_exact(&mut word)?;
        let batches = u32::from_le_bytes(word);
        source.read_exact(&mut word)?;
        let len = u32::from_le_bytes(word);
        if len != sides.div_ceil(EVERY) {
            return Err(std::io::ErrorKind::InvalidData.into());
        }
        let mut bytes = vec![0; len as usize * 40];
        source.read_exact(&mut bytes)?;
        let watched = bytes
            .chunks_exact(40)
            .map(|b| {
                let word = |k: usize| {
                    let mut word = [0; 8];
                    word.copy_from_slice(&b[8 * k..8 * k + 8]);
                    word
                };
                Watched {
                    light: i64::from_le_bytes(word(0)),
                    weight: i64::from_le_bytes(word(1)),
                    ww: f64::from_le_bytes(word(2)),
                    wl: f64::from_le_bytes(word(3)),
                    ll: f64::from_le_bytes(word(4)),
                }
            })
            .collect();
        Ok(Self { watched, batches })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sums::Unit;
    use glam::Vec3;

    fn uniform(i: u32) -> f32 {
        let mut x = i.wrapping_mul(0x9e37_79b9) ^ 0x5bd1_e995;
        x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
        x = (x ^ (x >> 12)).wrapping_mul(0x297a_2d39);
        (x ^ (x >> 15)) as f32 / u32::MAX as f32
    }

    #[test]
    fn error_is_that_of_independent_terms() {
        let (sides, batches, terms) = (6100, 32, 16);
        let sums = Sums::new(sides, Unit::new(4.0, 1e4));
        let mut noise = Noise::new(sides);
        for batch in 0..batches {
            for side in (0..sides).step_by(EVERY as usize) {
                for term in 0..terms {
                    let u = uniform((batch * terms + term) * sides + side);
                    sums.add(side, 1.0, Vec3::splat(2.0 * u));
                }
            }
            noise.end_batch(&sums);
        }
        // Uniform on 0..2: mean 1, variance 1/3.
        let expected = (1.0 / 3.0 / f64::from(batches * terms)).sqrt() / 1.01;
        let got = noise.relative_error();
        assert!((got / expected - 1.0).abs() < 0.05, "{got} {expected}");
        let mut bytes = Vec::new();
        noise.write(&mut bytes).unwrap();
        assert_eq!(Noise::read(&mut &bytes[..], sides).unwrap(), noise);
        assert!(Noise::read(&mut &bytes[..bytes.len() - 1], sides).is_err());
        assert!(Noise::read(&mut &bytes[..], sides + 100).is_err());
    }

    #[test]
    fn few_batches_say_nothing() {
        let sums = Sums::new(100, Unit::new(1.0, 10.0));
        let mut noise = Noise::new(100);
        sums.add(0, 1.0, Vec3::ONE);
        noise.end_batch(&sums);
        assert_eq!(noise.relative_error(), f64::INFINITY);
    }
}
