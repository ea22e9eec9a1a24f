//! Rounds of samples: paths, direct light, or light of spots, from every texel and every stand-in.

use super::spots::Spots;
use super::{Bake, Ended, MOST_COUNTED, Patch, Report, Round, RoundKind, Until};
use crate::gather::{Gatherer, Part, PathSettings, SurfaceSample, placement};
use crate::state::{Before, State};
use crate::store::STRETCH;
use crate::sums::{Sums, Unit};
use glam::{Vec2, Vec3};
use occlude_render::job::Job;
use occlude_render::sampling::warp;
use occlude_visibility::Hit;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Samples of a texel that a pass takes.
const SAMPLES_TOGETHER: u32 = 16;

/// Samples between two times at rest, about: some seconds.
const SAMPLES_BETWEEN_RESTS: u64 = 4 << 20;

/// Samples that are traced together.
const BATCH: usize = 2048;

/// Units that the first look at brightness takes.
const PILOT_UNITS: usize = 64;

/// Single samples may be this much brighter than the brightest of the first look; what is beyond is cut.
const HEADROOM: f32 = 1024.0;

impl Bake<'_> {
    /// Texels of a patch, covered or not; stand-ins count as one each.
    pub(crate) fn texels_of(&self, patch: &Patch) -> u64 {
        match patch {
            Patch::Rows { page, rows } => {
                let width = self.subject.texels.atlas.pages[*page as usize].width;
                u64::from(width) * rows.len() as u64
            }
            Patch::StandIns(range) => range.len() as u64,
        }
    }

    pub(crate) fn path_settings(&self, round: Round) -> PathSettings {
        let (part, bounces) = match round.kind {
            RoundKind::Direct | RoundKind::Spots => (Part::Direct, 0),
            _ if self.settings.part == Part::Direct => (Part::Direct, 0),
            _ => (self.settings.part, self.settings.bounces),
        };
        PathSettings {
            part,
            bounces,
            luminous: self.subject.luminous,
            reach: self.settings.reach,
            seed: self.settings.seed,
            directional: self.settings.directional,
        }
    }

    /// Takes samples of all units.
    pub(super) fn sample(
        &self,
        round: Round,
        state: &mut State,
        until: Until,
        job: &Job,
        report: &mut Report,
        at_rest: &mut dyn FnMut(&State),
    ) -> Ended {
        let first = state.header.items.start;
        let target = state.header.items.len() as u32;
        let all: u64 = self.patches.iter().map(|patch| self.texels_of(patch)).sum();
        let already = self.patches.iter().zip(&state.done);
        let already: u64 = already
            .map(|(unit, &done)| self.texels_of(unit) * u64::from(done))
            .sum();
        job.start_phase(round.name, all.saturating_mul(u64::from(target)));
        job.advance(already, 0);
        let spots = (round.kind == RoundKind::Spots).then(|| self.spots(&state.before));
        if spots.as_ref().is_some_and(Spots::is_empty) {
            state.done.fill(target);
            return Ended::Samples;
        }
        let gatherers: Mutex<Vec<Gatherer>> = Mutex::default();
        let brightest = brightest_counted(state.sums.unit(), round.total);

        // Sums on disk come to memory as they are touched.
        let most = if self.store.is_on_disk() {
            u64::from(STRETCH)
        } else {
            u64::MAX
        };
        let mut ended = Ended::Samples;
        while state.min_done() < target {
            let end = (state.min_done() / SAMPLES_TOGETHER + 1) * SAMPLES_TOGETHER;
            let end = end.min(target);
            let todo: Vec<usize> = (0..self.patches.len())
                .filter(|&unit| state.done[unit] < end)
                .collect();
            let mut slice_start = 0;
            while slice_start < todo.len() {
                let (mut slice_end, mut samples, mut texels) = (slice_start, 0, 0);
                while slice_end < todo.len() && samples < SAMPLES_BETWEEN_RESTS && texels < most {
                    let unit = todo[slice_end];
                    let count = self.texels_of(&self.patches[unit]);
                    samples += count * u64::from(end - state.done[unit]);
                    texels += count;
                    slice_end += 1;
                }
                let done = &state.done;
                let sums = &state.sums;
                let finished: Vec<bool> = todo[slice_start..slice_end]
                    .par_iter()
                    .map(|&unit| {
                        if job.is_cancelled() {
                            return false;
                        }
                        let mut gatherer = lock(&gatherers).pop().unwrap_or_default();
                        let before = gatherer.secondary + gatherer.shadow;
                        let items = first + done[unit]..first + end;
                        let finished = self.sample_unit(
                            &self.patches[unit],
                            items,
                            (round, spots.as_ref()),
                            brightest,
                            &mut gatherer,
                            job,
                            sums,
                        );
                        if finished {
                            let rays = gatherer.secondary + gatherer.shadow - before;
                            let samples =
                                self.texels_of(&self.patches[unit]) * u64::from(end - done[unit]);
                            job.advance(samples, rays);
                        }
                        lock(&gatherers).push(gatherer);
                        finished
                    })
                    .collect();
                for (&unit, finished) in todo[slice_start..slice_end].iter().zip(finished) {
                    if finished {
                        state.done[unit] = end;
                    }
                }
                if job.is_cancelled() {
                    ended = Ended::Cancel;
                    break;
                }
                slice_start = slice_end;
                state.sums.release();
                // The pass's last rest comes after its noise is known.
                if slice_start < todo.len() {
                    at_rest(state);
                }
            }
            if ended == Ended::Cancel {
                break;
            }
            if let Some(end) = until.end_batch(state, at_rest) {
                ended = end;
                break;
            }
        }
        for gatherer in gatherers
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
        {
            report.secondary += gatherer.secondary;
            report.shadow += gatherer.shadow;
        }
        ended
    }

    /// Takes samples `items` of a unit; `false`: cancelled, and nothing was added.
    fn sample_unit(
        &self,
        patch: &Patch,
        items: Range<u32>,
        (round, spots): (Round, Option<&Spots>),
        brightest: f32,
        gatherer: &mut Gatherer,
        job: &Job,
        sums: &Sums,
    ) -> bool {
        let settings = &self.path_settings(round);
        let mut samples = Vec::new();
        self.place(patch, &items, settings, &mut samples);
        let mut irradiance = vec![Vec3::ZERO; samples.len()];
        let mut moments = Vec::new();
        for (samples, irradiance) in samples.chunks(BATCH).zip(irradiance.chunks_mut(BATCH)) {
            if job.is_cancelled() {
                return false;
            }
            match spots {
                None => {
                    gatherer.gather(&self.subject.world, settings, samples, irradiance);
                    moments.extend_from_slice(gatherer.moments());
                }
                Some(spots) => {
                    gatherer.shadow +=
                        self.gather_spots(round, spots, samples, irradiance, &mut moments);
                }
            }
        }
        if let Some(sums) = sums.moments() {
            add_moments(&samples, &irradiance, &moments, brightest, sums);
        }
        let mut start = 0;
        while start < samples.len() {
            let run = sums.run_of(samples[start].side);
            let mut locked = sums.lock(run);
            while start < samples.len() && sums.run_of(samples[start].side) == run {
                let radiance = irradiance[start] * FRAC_1_PI;
                if radiance.is_finite() {
                    locked.add(
                        samples[start].side,
                        1.0,
                        radiance.min(Vec3::splat(brightest)),
                    );
                }
                start += 1;
            }
        }
        true
    }

    /// The samples of a unit, side by side.
    pub(crate) fn place(
        &self,
        patch: &Patch,
        items: &Range<u32>,
        settings: &PathSettings,
        samples: &mut Vec<SurfaceSample>,
    ) {
        let texels = self.subject.texels;
        let sides = self.subject.sides();
        let is_turned = |point: Hit| texels.atlas.is_turned(point.instance, point.primitive);
        let mut push = |front: u32, point: &dyn Fn(Vec2) -> Hit| {
            for number in items.clone() {
                let point = point(placement(settings.seed, front, number));
                samples.push(SurfaceSample {
                    point,
                    side: front,
                    number,
                    back: is_turned(point),
                });
            }
            let Some(back) = sides.and_then(|sides| sides.back_of(front)) else {
                return;
            };
            for number in items.clone() {
                let point = point(placement(settings.seed, back, number));
                samples.push(SurfaceSample {
                    point,
                    side: back,
                    number,
                    back: !is_turned(point),
                });
            }
        };
        match patch {
            Patch::Rows { page, rows } => {
                let band = texels.band(*page, rows.clone());
                for i in 0..band.len() {
                    push(band.texel(i), &|at| texels.sample(&band, i, at));
                }
            }
            Patch::StandIns(range) => {
                let Some(sides) = sides else { return };
                for stand_in in range.clone() {
                    let [instance, primitive] = sides.stand_ins()[stand_in as usize];
                    push(sides.texels() + stand_in, &|at| {
                        let at = warp::triangle(at);
                        Hit {
                            t: 0.0,
                            u: at.x,
                            v: at.y,
                            instance,
                            primitive,
                        }
                    });
                }
            }
        }
    }

    /// The unit of sums of samples: found from a few of them.
    pub(super) fn path_unit(&self, round: u32, before: &Before) -> Unit {
        let round = self.rounds[round as usize];
        let settings = self.path_settings(round);
        let spots = (round.kind == RoundKind::Spots).then(|| self.spots(before));
        let step = self.patches.len().div_ceil(PILOT_UNITS).max(1);
        let brightest = self
            .patches
            .par_iter()
            .step_by(step)
            .map(|patch| {
                let mut samples = Vec::new();
                self.place(patch, &(u32::MAX - 1..u32::MAX), &settings, &mut samples);
                let every = samples.len().div_ceil(BATCH).max(1);
                let samples: Vec<_> = samples.into_iter().step_by(every).collect();
                let mut irradiance = vec![Vec3::ZERO; samples.len()];
                match &spots {
                    None => Gatherer::default().gather(
                        &self.subject.world,
                        &settings,
                        &samples,
                        &mut irradiance,
                    ),
                    Some(spots) => {
                        let moments = &mut Vec::new();
                        self.gather_spots(round, spots, &samples, &mut irradiance, moments);
                    }
                }
                let radiance = irradiance.iter().map(|e| e.max_element() * FRAC_1_PI);
                radiance.filter(|r| r.is_finite()).fold(0.0, f32::max)
            })
            .reduce(|| 0.0, f32::max);
        Unit::new(
            (brightest * HEADROOM).max(f32::MIN_POSITIVE * 1e20),
            round.total.min(MOST_COUNTED) as f32,
        )
    }
}

/// Adds first moments of texels; what is cut off the light is cut off its moment.
fn add_moments(
    samples: &[SurfaceSample],
    irradiance: &[Vec3],
    moments: &[Vec3],
    brightest: f32,
    sums: &Sums,
) {
    for ((sample, light), moment) in samples.iter().zip(irradiance).zip(moments) {
        if sample.side >= sums.len() {
            continue;
        }
        let (light, moment) = (*light * FRAC_1_PI, *moment * FRAC_1_PI);
        let cut = brightest / light.max_element().max(brightest);
        if light.is_finite() && moment.is_finite() {
            sums.add(sample.side, 1.0, moment * cut);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The largest radiance of which sums in this unit hold so many terms.
fn brightest_counted(unit: Unit, terms: u32) -> f32 {
    (2f64.powi(62) / (unit.radiance * f64::from(terms.min(MOST_COUNTED)))) as f32
}
