//! Light along the lines: every two neighbours on a line look at each other and exchange what they send out.

use super::fragments::{Fragment, front};
use super::radiance::{MANTISSA_BITS, Radiance, unpack};
use super::raster::{Isa, multiversion};
use super::triangles::{BACK_RUN, NO_SIDE, Sides};
use crate::gather::luminance;
use crate::store::Tag;
use crate::sums::{Run, Sum, Sums, Unit};
use glam::Vec3;

/// Whoever looks at lines with all their surfaces, in order of depth.
pub(super) trait Lines {
    /// All lines from now on stand for this area (relative to the largest that a side has).
    fn set_weight(&mut self, weight: f32);
    /// Some more surfaces of the line at hand, all beyond those before.
    fn surfaces(&mut self, fragments: &[Fragment]);
    /// The line ends.
    fn end_line(&mut self);
    /// No line comes any more.
    fn finish(&mut self);
    /// What was counted.
    fn counts(&self) -> Counts;
}

/// What happened on some lines.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    /// Segments whose ends are fronts.
    pub pairs: u64,
    /// Terms that a baked front got from a front.
    pub exchanges: u64,
}

/// Terms that wait for the lock of their run of sums, for each run. All of them together stay in the second cache.
const WAITING: usize = 64;

/// What [`Sums::runs`] may be.
const RUNS_AT_MOST: usize = 512;

/// A term on its way: the side that it belongs to above, the packed radiance below. The side [`NO_SIDE`] says that the weight changes: its
/// bits are below.
type Term = u64;

/// Collects the terms of one thread by runs of sums.
struct Terms<'a> {
    isa: Isa,
    /// Of moments: the direction along the lines. Terms then hold luminance, negative if it comes from below.
    along: Option<Vec3>,
    sums: &'a Sums,
    /// Radiance of mantissa 1 at exponent 0.
    least: f32,
    weight: f32,
    /// By run: how many wait, and the weight of the last.
    heads: Vec<(u32, f32)>,
    /// By run, [`WAITING`] each.
    terms: Vec<Term>,
}

impl<'a> Terms<'a> {
    fn new(sums: &'a Sums, radiance: &Radiance, along: Option<Vec3>) -> Self {
        Self {
            isa: Isa::detect(),
            along,
            sums,
            least: radiance.scale().least(),
            weight: 0.0,
            heads: vec![(0, 0.0); sums.runs()],
            terms: vec![0; sums.runs() * WAITING],
        }
    }

    #[inline(always)]
    fn add(&mut self, side: u32, packed: u32) {
        let run = self.sums.run_of(side);
        let (count, weight) = &mut self.heads[run];
        let terms = &mut self.terms[run * WAITING..(run + 1) * WAITING];
        if *weight != self.weight {
            *weight = self.weight;
            terms[*count as usize] = term(NO_SIDE, self.weight.to_bits());
            *count += 1;
        }
        terms[*count as usize] = term(side, packed);
        *count += 1;
        // Room for a change of weight and a term.
        if *count as usize > WAITING - 2 {
            let count = std::mem::replace(&mut self.heads[run], (0, 0.0)).0;
            self.send(run, count);
        }
    }

    /// Sends everything that waits.
    fn flush(&mut self) {
        for run in 0..self.heads.len() {
            let count = std::mem::replace(&mut self.heads[run], (0, 0.0)).0;
            if count > 0 {
                self.send(run, count);
            }
        }
    }

    /// Sends the first so many terms of a run to their sums, or to where they wait for those.
    fn send(&self, run: usize, count: u32) {
        let terms = &self.terms[run * WAITING..][..count as usize];
        match (self.sums.spill(), self.along) {
            (None, None) => enter(
                self.isa,
                terms,
                &mut self.sums.lock(run),
                self.sums.unit(),
                self.least,
            ),
            (None, Some(along)) => enter_moments(terms, &mut self.sums.lock(run), along),
            (Some(spill), along) => {
                let along = along.unwrap_or_default();
                spill.push(run, [self.least, along.x, along.y, along.z], terms);
            }
        }
    }
}

/// Brings terms that wait to their sums; then all sums may leave memory.
pub(super) fn settle(sums: &Sums) {
    let isa = Isa::detect();
    if let Some(spill) = sums.spill() {
        let enter = |run: usize, tag: Tag, terms: &[Term]| {
            enter(isa, terms, &mut sums.lock(run), sums.unit(), tag[0]);
        };
        spill.settle(&enter, &|| sums.release());
    }
    if let Some(sums) = sums.moments()
        && let Some(spill) = sums.spill()
    {
        let enter = |run: usize, [_, x, y, z]: Tag, terms: &[Term]| {
            enter_moments(terms, &mut sums.lock(run), Vec3::new(x, y, z));
        };
        spill.settle(&enter, &|| sums.release());
    }
}

/// Whether so many terms wait that it is time to settle: moving all sums then takes a fraction of what their terms do.
pub(super) fn wants_to_settle(sums: &Sums) -> bool {
    const TERMS_TO_SUMS: u64 = 4;
    [Some(sums), sums.moments()]
        .into_iter()
        .flatten()
        .any(|sums| {
            let most = TERMS_TO_SUMS * Sums::bytes(sums.len());
            sums.spill().is_some_and(|spill| spill.bytes() > most)
        })
}

#[inline(always)]
fn term(side: u32, low: u32) -> Term {
    u64::from(side) << 32 | u64::from(low)
}

multiversion! {
    /// Adds terms to a run of sums.
    fn enter(terms: &[Term], run: &mut Run, unit: Unit, least: f32) = enter_lanes
}

/// Terms ahead whose sums are asked for in time.
const AHEAD: usize = 12;

#[inline(always)]
fn enter_lanes(terms: &[Term], run: &mut Run, unit: Unit, least: f32) {
    const MASK: u32 = (1 << MANTISSA_BITS) - 1;
    let first = run.first();
    // By exponent: what mantissas of red, green and blue count, and what the weight does.
    let mut scales = [[0.0; 4]; 32];
    let sums = run.sums();
    for (k, &term) in terms.iter().enumerate() {
        if let Some(ahead) = terms.get(k + AHEAD) {
            let place = ((ahead >> 32) as u32).wrapping_sub(first) as usize;
            prefetch(sums, place);
        }
        let (side, packed) = ((term >> 32) as u32, term as u32);
        if side == NO_SIDE {
            let a = f64::from(f32::from_bits(packed));
            let weight = a * unit.weight;
            for (exponent, scale) in scales.iter_mut().enumerate() {
                let step = a * f64::from(least) * (1u64 << exponent) as f64 * unit.radiance;
                *scale = [step, step, step, weight];
            }
            continue;
        }
        let scale = &scales[(packed >> (3 * MANTISSA_BITS)) as usize];
        let mantissas = [
            packed & MASK,
            packed >> MANTISSA_BITS & MASK,
            packed >> (2 * MANTISSA_BITS) & MASK,
            1,
        ];
        let sum = &mut sums[(side - first) as usize];
        for channel in 0..4 {
            let fixed = f64::from(mantissas[channel] as i32) * scale[channel];
            // SAFETY: the unit is chosen so that even the sums of all terms stay below 2^63.
            sum[channel] = sum[channel].wrapping_add(unsafe { fixed.to_int_unchecked::<i64>() });
        }
    }
}

/// Adds terms of moments to a run of sums.
fn enter_moments(terms: &[Term], run: &mut Run, along: Vec3) {
    let mut weight = 0.0;
    for &term in terms {
        let (side, value) = ((term >> 32) as u32, f32::from_bits(term as u32));
        if side == NO_SIDE {
            weight = value;
        } else {
            run.add(side, weight, along * value);
        }
    }
}

/// Asks for a sum that is needed soon.
#[inline(always)]
fn prefetch(sums: &[Sum], place: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let address = sums.as_ptr().wrapping_add(place).cast::<i8>();
        // SAFETY: a prefetch touches no memory that the program could observe, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (sums, place);
}

/// Exchanges light along the lines.
pub(super) struct Exchange<'a> {
    radiance: &'a [u32],
    backs: &'a [u32],
    fronts: u32,
    texels: u32,
    /// Packed radiance of the sky that arrives at the lower and at the upper open end.
    sky: [u32; 2],
    terms: Terms<'a>,
    /// Where light comes from, if that is wanted.
    moments: Option<Terms<'a>>,
    counts: Counts,
    /// What looks up at the end of the line so far, and what it sends.
    below: u32,
    from_below: u32,
}

impl<'a> Exchange<'a> {
    /// Bytes of a thread at most.
    pub const BYTES: u64 = 2 * (RUNS_AT_MOST * WAITING * 8) as u64;

    pub fn new(
        sides: &'a Sides,
        radiance: &'a Radiance,
        sky: [u32; 2],
        along: Vec3,
        sums: &'a Sums,
    ) -> Self {
        Self {
            radiance: radiance.packed(),
            backs: sides.backs(),
            fronts: sides.fronts_count(),
            texels: sides.texels(),
            sky,
            terms: Terms::new(sums, radiance, None),
            moments: (sums.moments()).map(|sums| Terms::new(sums, radiance, Some(along))),
            counts: Counts::default(),
            below: NO_SIDE,
            from_below: sky[0],
        }
    }

    #[inline(always)]
    fn back(&self, front: u32) -> u32 {
        let first = self.backs[(front / BACK_RUN) as usize];
        if first == NO_SIDE {
            NO_SIDE
        } else {
            first + front % BACK_RUN
        }
    }

    /// Packed radiance arrives at a side, from above or from below.
    #[inline(always)]
    fn arrive(&mut self, side: u32, packed: u32, from_above: bool) {
        self.terms.add(side, packed);
        if let Some(moments) = &mut self.moments
            && side < self.texels
        {
            let luminance = luminance(unpack(packed, moments.least));
            let signed = if from_above { luminance } else { -luminance };
            moments.add(side, signed.to_bits());
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

impl Lines for Exchange<'_> {
    fn set_weight(&mut self, weight: f32) {
        self.terms.weight = weight;
        if let Some(moments) = &mut self.moments {
            moments.weight = weight;
        }
    }

    #[inline(always)]
    fn surfaces(&mut self, fragments: &[Fragment]) {
        let (mut below, mut from_below) = (self.below, self.from_below);
        for &fragment in fragments {
            let (front, along) = front(fragment);
            let back = self.back(front);
            let (down, up) = if along { (back, front) } else { (front, back) };
            if below != NO_SIDE {
                let from_above = self.sent(down);
                self.arrive(below, from_above, true);
            }
            if down != NO_SIDE {
                self.arrive(down, from_below, false);
            }
            // Backs and no side are beyond all fronts.
            if below < self.fronts && down < self.fronts {
                self.counts.pairs += 1;
                self.counts.exchanges +=
                    u64::from(below < self.texels) + u64::from(down < self.texels);
            }
            below = up;
            from_below = self.sent(up);
        }
        (self.below, self.from_below) = (below, from_below);
    }

    #[inline(always)]
    fn end_line(&mut self) {
        if self.below != NO_SIDE {
            self.arrive(self.below, self.sky[1], true);
        }
        (self.below, self.from_below) = (NO_SIDE, self.sky[0]);
    }

    fn finish(&mut self) {
        self.terms.flush();
        if let Some(moments) = &mut self.moments {
            moments.flush();
        }
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}
