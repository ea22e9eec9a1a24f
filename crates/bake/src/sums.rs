//! Sums over the sides of all texels that do not depend on the order of their terms.
//!
//! A side's irradiance is `E = pi sum(a L) / sum(a)`: of ray bundles `a` is the area that a line stands for, times the weight of its
//! direction; of paths it is 1. Floating-point addition is not associative, so sums are in fixed point: 64-bit integers
//! whose unit is chosen from the brightest radiance and the largest weight that can come together ([`Unit`]). Threads, shards and
//! interruptions then leave no trace in the result, as in a film.
//!
//! Whoever adds locks a run of neighbouring sides and adds many terms at once: bundles collect terms by run first, which costs a
//! few nanoseconds a term; locked additions to single words would cost four times as much.

use crate::store::{Spill, Store};
use glam::Vec3;
use occlude_bvh::Buffer;
use std::io::{Read, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What the integers of [`Sums`] count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// A weighted radiance of 1 in integers; a power of two.
    pub radiance: f64,
    /// A weight of 1 in integers; a power of two.
    pub weight: f64,
}

impl Unit {
    /// The finest unit in which no sum overflows: terms have radiance up to `brightest`, and the weights of one side
    /// add up to at most `weight`.
    pub fn new(brightest: f32, weight: f32) -> Self {
        // 62 bits: one is the sign, one is to spare for rounding up.
        let finest = |largest: f64| 2f64.powi(62 - largest.max(1e-30).log2().ceil() as i32);
        Self {
            radiance: finest(f64::from(brightest) * f64::from(weight)),
            weight: finest(f64::from(weight)),
        }
    }
}

/// The sums of one side: red, green, blue of weight times radiance, and the weight.
pub type Sum = [i64; 4];

/// Sums over the sides of all texels.
#[derive(Debug)]
pub struct Sums {
    /// Each for one run of `sums`.
    locks: Vec<Mutex<()>>,
    /// On huge pages: terms come to them at random.
    sums: Buffer<Sum>,
    shift: u32,
    len: u32,
    unit: Unit,
    /// Of the first so many sides, first moments in the place of colours.
    moments: Option<Box<Self>>,
    /// Of sums on disk: terms of bundles on their way to them.
    spill: Option<Spill>,
}

/// Why sums cannot be read or merged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SumsError {
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The bytes are no sums, or sums of something else.
    #[error("sums of other texels, another scene or other settings")]
    Other,
}

/// A locked run of neighbouring sides.
pub struct Run<'a> {
    sums: &'a mut [Sum],
    _lock: MutexGuard<'a, ()>,
    first: u32,
    unit: Unit,
}

impl Run<'_> {
    /// Adds one term to a side of this run; `radiance` may be a moment with negative parts.
    ///
    /// # Panics
    /// If the side is not in this run.
    #[inline]
    pub fn add(&mut self, side: u32, weight: f32, radiance: Vec3) {
        let weight = f64::from(weight);
        let scale = weight * self.unit.radiance;
        let fixed = |channel: f32| (f64::from(channel) * scale) as i64;
        let sum = &mut self.sums[(side - self.first) as usize];
        sum[0] = sum[0].wrapping_add(fixed(radiance.x));
        sum[1] = sum[1].wrapping_add(fixed(radiance.y));
        sum[2] = sum[2].wrapping_add(fixed(radiance.z));
        sum[3] = sum[3].wrapping_add((weight * self.unit.weight) as i64);
    }

    /// The sums of the run; number 0 is side [`Run::first`].
    pub fn sums(&mut self) -> &mut [Sum] {
        self.sums
    }

    /// The first side of the run.
    pub fn first(&self) -> u32 {
        self.first
    }
}

/// Runs that one lock covers, about; more make locks rarer to meet, and buffers of terms smaller.
const RUNS: u32 = 512;

impl Sums {
    /// Bytes of sums over `sides` sides.
    pub fn bytes(sides: u32) -> u64 {
        u64::from(sides) * size_of::<Sum>() as u64
    }

    /// Sums without terms.
    pub fn new(sides: u32, unit: Unit) -> Self {
        Self::over(Buffer::zeroed(sides as usize), unit)
    }

    /// The same with sums of first moments (luminance times direction) over the first so many sides; 0: without.
    pub fn with_moments(mut self, sides: u32) -> Self {
        self.moments = (sides > 0).then(|| Box::new(Self::new(sides, self.unit)));
        self
    }

    /// Sums without terms, and of first moments over the first `moments` sides, that live in `store`.
    ///
    /// # Errors
    /// There is no room.
    pub fn new_in(store: &Store, sides: u32, unit: Unit, moments: u32) -> std::io::Result<Self> {
        let mut sums = Self::over(store.zeroed(sides as usize)?, unit);
        sums.spill = store.spill(sums.runs())?;
        if moments > 0 {
            sums.moments = Some(Box::new(Self::new_in(store, moments, unit, 0)?));
        }
        Ok(sums)
    }

    fn over(sums: Buffer<Sum>, unit: Unit) -> Self {
        let len = sums.len() as u32;
        let shift = (len.div_ceil(RUNS).max(64)).next_power_of_two().ilog2();
        let count = len.div_ceil(1 << shift);
        Self {
            locks: (0..count).map(|_| Mutex::new(())).collect(),
            sums,
            shift,
            len,
            unit,
            moments: None,
            spill: None,
        }
    }

    /// Lets sums on disk leave memory until they are touched again.
    pub fn release(&self) {
        self.sums.release();
        if let Some(moments) = &self.moments {
            moments.release();
        }
    }

    /// Where terms of bundles wait, if sums are on disk.
    pub(crate) fn spill(&self) -> Option<&Spill> {
        self.spill.as_ref()
    }

    /// Whether all terms have come: terms for sums on disk wait in a file of their own.
    ///
    /// # Errors
    /// That file could not be written or read; the sums are then worth nothing.
    pub fn check(&self) -> std::io::Result<()> {
        self.spill.as_ref().map_or(Ok(()), Spill::check)?;
        self.moments.as_ref().map_or(Ok(()), |sums| sums.check())
    }

    /// Sums of first moments.
    pub fn moments(&self) -> Option<&Self> {
        self.moments.as_deref()
    }

    /// Number of sides.
    pub fn len(&self) -> u32 {
        self.len
    }

    /// Whether there are no sides.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// What the integers count.
    pub fn unit(&self) -> Unit {
        self.unit
    }

    /// Number of runs, each with a lock of its own.
    pub fn runs(&self) -> usize {
        self.locks.len()
    }

    /// The run of a side.
    #[inline]
    pub fn run_of(&self, side: u32) -> usize {
        (side >> self.shift) as usize
    }

    /// Locks a run.
    pub fn lock(&self, run: usize) -> Run<'_> {
        let lock = self.locks[run]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let first = run << self.shift;
        let count = (self.sums.len() - first).min(1 << self.shift);
        // SAFETY: the run lies within the sums. Whoever shares them (`&self`) touches a run only while it holds the run's lock, which lives as
        // long as the slice.
        let sums = unsafe { std::slice::from_raw_parts_mut(self.sums.as_ptr().add(first), count) };
        Run {
            sums,
            _lock: lock,
            first: (run as u32) << self.shift,
            unit: self.unit,
        }
    }

    /// Adds one term; [`Sums::lock`] is faster for many.
    pub fn add(&self, side: u32, weight: f32, radiance: Vec3) {
        self.lock(self.run_of(side)).add(side, weight, radiance);
    }

    /// Adds all terms of other sums.
    pub fn merge(&mut self, other: &Self) -> Result<(), SumsError> {
        let alike = |a: Option<&Self>, b: Option<&Self>| a.map(Self::len) == b.map(Self::len);
        if self.len != other.len
            || self.unit != other.unit
            || !alike(self.moments(), other.moments())
        {
            return Err(SumsError::Other);
        }
        if let (Some(mine), Some(other)) = (&mut self.moments, &other.moments) {
            mine.merge(other)?;
        }
        for run in 0..other.runs() {
            let mut theirs = other.lock(run);
            let first = theirs.first() as usize;
            for (sum, term) in self.sums[first..].iter_mut().zip(theirs.sums()) {
                for (sum, term) in sum.iter_mut().zip(term) {
                    *sum = sum.wrapping_add(*term);
                }
            }
            drop(theirs);
            self.release();
            other.release();
        }
        Ok(())
    }

    /// Forgets all terms.
    pub fn clear(&mut self) {
        self.sums.fill([0; 4]);
        if let Some(moments) = &mut self.moments {
            moments.clear();
        }
    }

    /// Irradiance of a side, W/m². `None` if it has no terms.
    pub fn irradiance(&self, side: u32) -> Option<Vec3> {
        let mut run = self.lock(self.run_of(side));
        let first = run.first();
        self.develop(run.sums()[(side - first) as usize])
    }

    /// Weight of a side's terms.
    pub fn weight(&self, side: u32) -> f64 {
        let mut run = self.lock(self.run_of(side));
        let first = run.first();
        run.sums()[(side - first) as usize][3] as f64 / self.unit.weight
    }

    /// The irradiance that belongs to sums, W/m². `None` without terms.
    pub fn develop(&self, sum: Sum) -> Option<Vec3> {
        let weight = sum[3] as f64 / self.unit.weight;
        let scale = std::f64::consts::PI / (weight * self.unit.radiance);
        (weight > 0.0).then(|| Vec3::from_array([0, 1, 2].map(|k| (sum[k] as f64 * scale) as f32)))
    }

    /// Writes all sums.
    pub fn write(&self, out: &mut impl Write) -> std::io::Result<()> {
        out.write_all(&self.len.to_le_bytes())?;
        out.write_all(&self.unit.radiance.to_le_bytes())?;
        out.write_all(&self.unit.weight.to_le_bytes())?;
        let mut bytes = Vec::new();
        for run in 0..self.locks.len() {
            bytes.clear();
            let mut run = self.lock(run);
            bytes.extend(run.sums().iter().flatten().flat_map(|n| n.to_le_bytes()));
            out.write_all(&bytes)?;
            drop(run);
            self.sums.release();
        }
        if let Some(moments) = &self.moments {
            moments.write(out)?;
        }
        Ok(())
    }

    /// Adds the terms of written sums, which must be of the same sides and unit. What is read before an error stays added.
    pub fn read(&mut self, source: &mut impl Read) -> Result<(), SumsError> {
        let mut word = [0; 8];
        source.read_exact(&mut word[..4])?;
        let len = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        source.read_exact(&mut word)?;
        let radiance = f64::from_le_bytes(word);
        source.read_exact(&mut word)?;
        let weight = f64::from_le_bytes(word);
        if len != self.len || (Unit { radiance, weight }) != self.unit {
            return Err(SumsError::Other);
        }
        for first in (0..self.len as usize).step_by(1 << self.shift) {
            self.sums.release();
            let end = self.sums.len().min(first + (1 << self.shift));
            let run = &mut self.sums[first..end];
            let mut bytes = vec![0; size_of_val(run)];
            source.read_exact(&mut bytes)?;
            for (sum, bytes) in run.iter_mut().flatten().zip(bytes.chunks_exact(8)) {
                word.copy_from_slice(bytes);
                *sum = sum.wrapping_add(i64::from_le_bytes(word));
            }
        }
        if let Some(moments) = &mut self.moments {
            moments.read(source)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terms() -> impl Iterator<Item = (u32, f32, Vec3)> {
        (0..5000_u32).map(|i| {
            let x = (i as f32 * 0.618).fract();
            (i * 7919 % 1000, 0.01 + x, Vec3::new(x, 3.0 * x * x, 7.0))
        })
    }

    fn sums(terms: impl Iterator<Item = (u32, f32, Vec3)>) -> Sums {
        let sums = Sums::new(1000, Unit::new(7.0, 20.0));
        terms.for_each(|(side, weight, radiance)| sums.add(side, weight, radiance));
        sums
    }

    fn bytes(sums: &Sums) -> Vec<u8> {
        let mut bytes = Vec::new();
        sums.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn order_and_parts_leave_no_trace() {
        let whole = sums(terms());
        let mut backwards: Vec<_> = terms().collect();
        backwards.reverse();
        assert_eq!(bytes(&whole), bytes(&sums(backwards.into_iter())));
        let mut merged = sums(terms().skip(2000));
        merged.merge(&sums(terms().take(2000))).unwrap();
        assert_eq!(bytes(&whole), bytes(&merged));
        let mut read = sums(terms().take(2000));
        read.read(&mut bytes(&sums(terms().skip(2000))).as_slice())
            .unwrap();
        assert_eq!(bytes(&whole), bytes(&read));
    }

    #[test]
    fn irradiance_is_pi_times_the_weighted_mean() {
        let sums = sums(terms());
        let (mut weight, mut light) = (0.0, glam::DVec3::ZERO);
        for (_, a, radiance) in terms().filter(|t| t.0 == 17) {
            weight += f64::from(a);
            light += radiance.as_dvec3() * f64::from(a);
        }
        let expected = (light / weight * std::f64::consts::PI).as_vec3();
        assert!((sums.irradiance(17).unwrap() - expected).length() < 1e-5 * expected.length());
        assert!((sums.weight(17) - weight).abs() < 1e-6);
        assert_eq!(
            Sums::new(3, Unit::new(1.0, 1.0)).irradiance(2),
            None,
            "no terms, no value"
        );
    }

    #[test]
    fn other_sums_are_refused() {
        let mut one = sums(terms());
        assert!(one.merge(&Sums::new(999, one.unit())).is_err());
        assert!(
            one.merge(&Sums::new(1000, Unit::new(8000.0, 20.0)))
                .is_err()
        );
        let written = bytes(&one);
        for cut in [0, 3, 11, 500, written.len() - 1] {
            assert!(one.read(&mut &written[..cut]).is_err(), "{cut}");
        }
    }
}
