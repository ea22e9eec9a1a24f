//! Light along the lines: every two neighbours on a line look at each other and exchange what they send out.

use super::fragments::{Fragment, front};
use super::radiance::{MANTISSA_BITS, Radiance};
use super::triangles::{NO_SIDE, Sides};
use crate::sums::{Run, Sums};

/// Terms that wait for the lock of their run of sums, for each run.
const WAITING: usize = 512;

/// A term on its way: the side that it belongs to, and the packed radiance. The side [`NO_SIDE`] says that the weight changes: its
/// bits follow.
type Term = [u32; 2];

/// Collects the terms of one thread by runs of sums.
#[derive(Debug)]
pub(super) struct Terms<'a> {
    sums: &'a Sums,
    /// Radiance of mantissa 1 at exponent 0.
    least: f32,
    waiting: Vec<Waiting>,
    weight: f32,
}

#[derive(Clone, Debug, Default)]
struct Waiting {
    terms: Vec<Term>,
    /// Weight of the last term.
    weight: f32,
}

impl<'a> Terms<'a> {
    pub fn new(sums: &'a Sums, radiance: &Radiance) -> Self {
        Self {
            sums,
            least: radiance.scale().least(),
            waiting: vec![Waiting::default(); sums.runs()],
            weight: 0.0,
        }
    }

    /// All terms from now on have this weight.
    pub fn set_weight(&mut self, weight: f32) {
        self.weight = weight;
    }

    #[inline(always)]
    fn add(&mut self, side: u32, packed: u32) {
        let run = self.sums.run_of(side);
        let waiting = &mut self.waiting[run];
        if waiting.weight != self.weight || waiting.terms.is_empty() {
            waiting.weight = self.weight;
            waiting.terms.push([NO_SIDE, self.weight.to_bits()]);
        }
        waiting.terms.push([side, packed]);
        if waiting.terms.len() >= WAITING {
            enter(
                &waiting.terms,
                &mut self.sums.lock(run),
                self.sums,
                self.least,
            );
            waiting.terms.clear();
        }
    }

    /// Enters everything that waits.
    pub fn flush(&mut self) {
        for (run, waiting) in self.waiting.iter_mut().enumerate() {
            if !waiting.terms.is_empty() {
                enter(
                    &waiting.terms,
                    &mut self.sums.lock(run),
                    self.sums,
                    self.least,
                );
                waiting.terms.clear();
            }
        }
    }
}

/// Adds terms to a run.
fn enter(terms: &[Term], run: &mut Run, sums: &Sums, least: f32) {
    let first = run.first();
    let mut scales = [0.0; 32];
    let mut weight = 0;
    let unit = sums.unit();
    let sums = run.sums();
    for &[side, packed] in terms {
        if side == NO_SIDE {
            let a = f64::from(f32::from_bits(packed));
            weight = (a * unit.weight) as i64;
            for (exponent, scale) in scales.iter_mut().enumerate() {
                *scale = a * f64::from(least) * 2f64.powi(exponent as i32) * unit.radiance;
            }
            continue;
        }
        let scale = scales[(packed >> (3 * MANTISSA_BITS)) as usize];
        let mask = (1 << MANTISSA_BITS) - 1;
        let sum = &mut sums[(side - first) as usize];
        for (channel, sum) in sum.iter_mut().take(3).enumerate() {
            let mantissa = packed >> (MANTISSA_BITS * channel as u32) & mask;
            *sum = sum.wrapping_add((f64::from(mantissa) * scale) as i64);
        }
        sum[3] = sum[3].wrapping_add(weight);
    }
}

/// What the lines of a bundle exchange.
pub(super) struct Exchange<'a> {
    pub radiance: &'a [u32],
    pub sides: &'a Sides,
    /// Packed radiance of the sky that arrives at the lower and at the upper open end.
    pub sky: [u32; 2],
}

/// What happened on some lines.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    /// Segments whose ends are fronts.
    pub pairs: u64,
    /// Terms that a baked front got from a front.
    pub exchanges: u64,
}

impl Exchange<'_> {
    /// The light on one line, whose fragments are sorted.
    #[inline(always)]
    pub fn line(&self, fragments: &[Fragment], terms: &mut Terms, counts: &mut Counts) {
        let fronts = self.sides.fronts_count();
        let texels = self.sides.texels();
        // What looks up from below the segment at hand, and what it sends.
        let mut below = NO_SIDE;
        let mut from_below = self.sky[0];
        for &fragment in fragments {
            let (front, along) = front(fragment);
            let back = self.back(front);
            let (down, up) = if along { (back, front) } else { (front, back) };
            let from_above = self.sent(down);
            if below != NO_SIDE {
                terms.add(below, from_above);
            }
            if down != NO_SIDE {
                terms.add(down, from_below);
            }
            if below < fronts && down < fronts {
                counts.pairs += 1;
                counts.exchanges += u64::from(below < texels) + u64::from(down < texels);
            }
            below = up;
            from_below = self.sent(up);
        }
        if below != NO_SIDE {
            terms.add(below, self.sky[1]);
        }
    }

    #[inline(always)]
    fn back(&self, front: u32) -> u32 {
        let first = self.sides.backs()[(front / 64) as usize];
        if first == NO_SIDE {
            NO_SIDE
        } else {
            first + front % 64
        }
    }

    #[inline(always)]
    fn sent(&self, side: u32) -> u32 {
        if side == NO_SIDE {
            0
        } else {
            self.radiance[side as usize]
        }
    }
}
