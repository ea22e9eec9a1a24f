//! A bake, round by round.
//!
//! By paths there is one round: all light that arrives, by path tracing from every texel. By bundles there are several. The first
//! finds direct light by exact rays (small and bright lights are what few parallel rays would miss); each further one gathers what
//! surfaces reflect of all light that the rounds before have brought them, and the sky's even part. The last round's is the
//! result: earlier ones are averaged over a hemisphere before they show, so they take half as many directions.
//!
//! With `B` bounces in a closed box of albedo `a` and emission `e` the irradiance is `pi e (1 - a^(B+1)) / (1 - a)`.
//!
//! Every round is a number of *items* (samples a texel or directions), each a pure function of seed, round and number; sums are
//! integers. So threads, shards, interruptions and the order of work do not show in the result.

use crate::bundle::{self, Directions, Radiance, Sides, Sky, Triangles};
use crate::gather::{Gatherer, Part, PathSettings, SurfaceSample, placement};
use crate::noise::Noise;
use crate::state::{Header, State};
use crate::sums::{Sums, Unit};
use crate::texel::{Band, Texels};
use glam::{Vec2, Vec3};
use half::f16;
use occlude_render::geometry::diffuse_albedo;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::Environment;
use occlude_render::sampling::warp;
use occlude_visibility::Hit;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How light between surfaces is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GatherKind {
    /// Paths from every texel.
    Path,
    /// Parallel rays through the whole scene.
    Bundles,
}

/// What is gathered, and how well.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// How.
    pub gather: GatherKind,
    /// Which light.
    pub part: Part,
    /// Reflections between a light and a texel at most.
    pub bounces: u32,
    /// Paths a texel, or directions of the last round.
    pub directions: u32,
    /// Reach of ambient occlusion, metres.
    pub reach: f32,
    /// Seed of all random decisions.
    pub seed: u64,
    /// How bundles are cut into tiles.
    pub bundles: bundle::Settings,
}

/// What is baked.
pub struct Subject<'a> {
    /// Surfaces, all of them Lambert, and the lights that rays ask.
    pub world: World<'a>,
    /// Places on surfaces.
    pub texels: &'a Texels<'a>,
    /// For bundles: the scene flattened.
    pub triangles: Option<&'a Triangles<'a>>,
    /// For bundles: the sky that comes in at open ends, which is not among the lights of `world`, and its largest channel.
    pub sky: Option<(&'a Environment, f32)>,
    /// Rays that are not aimed at lights may meet light: surfaces emit, or there is a sky among the lights (suns apart).
    pub luminous: bool,
}

/// What one round does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoundKind {
    /// Paths from every texel bring all that is wanted.
    Paths,
    /// Direct light by exact rays, for bundles to go on with.
    Direct,
    /// Bundles of the sky alone, before anything is reflected.
    Sky,
    /// Bundles of sky and reflected light.
    Reflected,
}

/// One round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Round {
    /// What it does.
    pub kind: RoundKind,
    /// Samples a texel or directions.
    pub total: u32,
    /// For people.
    pub name: &'static str,
}

/// Direct light takes one sample for so many directions: its shadow rays are aimed at lights.
const DIRECTIONS_PER_DIRECT_SAMPLE: u32 = 4;

/// Fewer samples of direct light are too few whatever the rest.
const LEAST_DIRECT_SAMPLES: u32 = 4;

/// The rounds of a bake. `sky`: there is a sky for bundles.
pub fn rounds(settings: &Settings, sky: bool) -> Vec<Round> {
    let all = settings.directions;
    let paths = Round {
        kind: RoundKind::Paths,
        total: all,
        name: "paths",
    };
    let by_bundles = settings.gather == GatherKind::Bundles;
    if !by_bundles || settings.part == Part::Occlusion || settings.part == Part::Direct && !sky {
        return vec![paths];
    }
    let mut rounds = vec![Round {
        kind: RoundKind::Direct,
        total: (all / DIRECTIONS_PER_DIRECT_SAMPLE).max(LEAST_DIRECT_SAMPLES),
        name: "direct light",
    }];
    if sky {
        rounds.push(Round {
            kind: RoundKind::Sky,
            total: all.div_ceil(2),
            name: "sky",
        });
    }
    let bounces = if settings.part == Part::Direct {
        0
    } else {
        settings.bounces
    };
    const NAMES: [&str; 6] = [
        "bounce 1", "bounce 2", "bounce 3", "bounce 4", "bounce 5", "bounce 6",
    ];
    rounds.extend((0..bounces).map(|bounce| Round {
        kind: RoundKind::Reflected,
        total: all.div_ceil(2),
        name: NAMES.get(bounce as usize).copied().unwrap_or("late bounce"),
    }));
    if let Some(last) = rounds
        .last_mut()
        .filter(|last| last.kind != RoundKind::Direct)
    {
        last.total = all;
    }
    rounds
}

/// When gathering ends before all items are done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stop {
    /// After this time of all rounds together.
    pub time_limit: Option<Duration>,
    /// Once the mean relative standard error is at most this.
    pub noise: Option<f64>,
}

/// Why gathering ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// All items are done.
    Samples,
    /// The time is over.
    Time,
    /// The noise is low enough.
    Noise,
    /// Somebody cancelled the job: the state can be gone on with.
    Cancel,
}

impl Ended {
    /// The name used in statistics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Time => "time",
            Self::Noise => "noise",
            Self::Cancel => "cancel",
        }
    }
}

/// What was done in this run.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Of bundles.
    pub bundles: bundle::Stats,
    /// Rays from surfaces in search of the next one.
    pub secondary: u64,
    /// Shadow rays.
    pub shadow: u64,
    /// Wall-clock seconds by round.
    pub seconds: Vec<(&'static str, f64)>,
    /// Mean relative standard error of the last round, if it is known.
    pub noise: Option<f64>,
}

/// Texels of a unit of work, about.
const UNIT_TEXELS: u32 = 4096;

/// Samples of a texel that a pass takes.
const SAMPLES_TOGETHER: u32 = 16;

/// Samples between two times at rest, about: some seconds.
const SAMPLES_BETWEEN_RESTS: u64 = 4 << 20;

/// Samples that are traced together.
const BATCH: usize = 2048;

/// Stand-ins of a unit of work.
const UNIT_STAND_INS: u32 = 1024;

/// Directions between two looks at the clock and the noise.
const DIRECTIONS_TOGETHER: u32 = 16;

/// A part of all sides that is sampled together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Patch {
    Rows { page: u32, rows: Range<u32> },
    StandIns(Range<u32>),
}

/// A bake in progress.
pub struct Bake<'a> {
    pub(crate) subject: Subject<'a>,
    pub(crate) settings: Settings,
    rounds: Vec<Round>,
    pub(crate) patches: Vec<Patch>,
    fingerprint: u64,
    notes: String,
    /// Lambert albedo by front; for bundles.
    albedo: Vec<[f16; 3]>,
}

impl<'a> Bake<'a> {
    /// Prepares. `fingerprint` tells this work from others; `notes` travel with its files.
    pub fn new(subject: Subject<'a>, settings: Settings, fingerprint: u64, notes: String) -> Self {
        let rounds = rounds(&settings, subject.sky.is_some());
        let mut patches = Vec::new();
        for (page, size) in subject.texels.atlas.pages.iter().enumerate() {
            let rows = (UNIT_TEXELS / size.width.max(1)).max(1);
            for y in (0..size.height).step_by(rows as usize) {
                patches.push(Patch::Rows {
                    page: page as u32,
                    rows: y..(y + rows).min(size.height),
                });
            }
        }
        if let Some(sides) = subject.sides() {
            let count = sides.stand_ins().len() as u32;
            for first in (0..count).step_by(UNIT_STAND_INS as usize) {
                patches.push(Patch::StandIns(first..(first + UNIT_STAND_INS).min(count)));
            }
        }
        let albedo = if rounds.iter().any(|r| r.kind == RoundKind::Reflected) {
            albedo(&subject)
        } else {
            Vec::new()
        };
        Self {
            subject,
            settings,
            rounds,
            patches,
            fingerprint,
            notes,
            albedo,
        }
    }

    /// The rounds.
    pub fn rounds(&self) -> &[Round] {
        &self.rounds
    }

    /// Number of sides that sums are kept for.
    pub fn sides(&self) -> u32 {
        match self.subject.sides() {
            Some(sides) => sides.count(),
            None => self.subject.texels.atlas.texels(),
        }
    }

    /// Entries of [`State::done`] in a round.
    pub fn units_of(&self, round: u32) -> u32 {
        match self.rounds.get(round as usize).map(|r| r.kind) {
            Some(RoundKind::Paths | RoundKind::Direct) => self.patches.len() as u32,
            _ => 1,
        }
    }

    /// The beginning of a round; `share` of its items are wanted, `(0, 1)` is all. The maps are those of the rounds before.
    pub fn begin(
        &self,
        round: u32,
        (index, count): (u32, u32),
        direct: Vec<Vec3>,
        previous: Vec<Vec3>,
    ) -> State {
        let total = self.rounds[round as usize].total;
        let unit = match self.rounds[round as usize].kind {
            RoundKind::Paths | RoundKind::Direct => self.path_unit(round),
            RoundKind::Sky | RoundKind::Reflected => {
                let brightest = self.brightest(&direct, &previous);
                bundle::unit(brightest, total.min(MOST_COUNTED))
            }
        };
        State {
            header: Header {
                fingerprint: self.fingerprint,
                sides: self.sides(),
                round,
                rounds: self.rounds.len() as u32,
                total,
                items: occlude_render::work::shard_samples(total, index, count),
                units: self.units_of(round),
                has_direct: !direct.is_empty(),
                has_previous: !previous.is_empty(),
                unit: [unit.radiance, unit.weight],
                notes: self.notes.clone(),
            },
            direct,
            previous,
            done: vec![0; self.units_of(round) as usize],
            sums: Sums::new(self.sides(), unit),
            noise: Noise::new(self.sides()),
        }
    }

    /// Whether a state's round is the last.
    pub fn is_last(&self, state: &State) -> bool {
        state.header.round + 1 >= state.header.rounds
    }

    /// From a round that is done to the next one.
    pub fn next_round(&self, state: State, share: (u32, u32)) -> State {
        let round = state.header.round;
        let sides = state.header.sides;
        let State {
            mut direct,
            mut previous,
            sums,
            ..
        } = state;
        if self.rounds[round as usize].kind == RoundKind::Direct {
            direct = vec![Vec3::ZERO; sides as usize];
            develop(&sums, &mut direct);
            previous = Vec::new();
        } else {
            previous.resize(sides as usize, Vec3::ZERO);
            develop(&sums, &mut previous);
            let pairs = previous.par_iter_mut().zip(&direct);
            pairs.for_each(|(all, direct)| *all += *direct);
        }
        drop(sums);
        self.begin(round + 1, share, direct, previous)
    }

    /// Goes on with a state until its part of its round is done, or `stop` or the job say stop. `at_rest` is called now and then with a
    /// state that can be written.
    pub fn run_round(
        &self,
        state: &mut State,
        stop: Stop,
        job: &Job,
        report: &mut Report,
        at_rest: &mut dyn FnMut(&State),
    ) -> Ended {
        let round = self.rounds[state.header.round as usize];
        let began = Instant::now();
        let deadline = stop.time_limit.map(|limit| began + limit);
        let ended = match round.kind {
            RoundKind::Paths | RoundKind::Direct => {
                self.sample(round, state, deadline, stop.noise, job, report, at_rest)
            }
            RoundKind::Sky | RoundKind::Reflected => {
                self.bundle(round, state, deadline, stop.noise, job, report, at_rest)
            }
        };
        report
            .seconds
            .push((round.name, began.elapsed().as_secs_f64()));
        let error = state.noise.relative_error();
        report.noise = error.is_finite().then_some(error);
        ended
    }

    /// Irradiance of a texel when the last round is done, W/m². `None`: nothing is known about it.
    pub fn irradiance(&self, state: &State, texel: u32) -> Option<Vec3> {
        let gathered = state.sums.irradiance(texel);
        let direct = state.direct.get(texel as usize);
        let last = self.rounds.last().map(|round| round.kind);
        match (last, self.settings.part) {
            (Some(RoundKind::Direct), Part::Indirect) => gathered.map(|_| Vec3::ZERO),
            (_, Part::Indirect) => gathered,
            _ => gathered.map(|light| light + direct.copied().unwrap_or(Vec3::ZERO)),
        }
    }

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
            RoundKind::Direct => (Part::Direct, 0),
            _ if self.settings.part == Part::Direct => (Part::Direct, 0),
            _ => (self.settings.part, self.settings.bounces),
        };
        PathSettings {
            part,
            bounces,
            luminous: self.subject.luminous,
            reach: self.settings.reach,
            seed: self.settings.seed,
        }
    }

    /// Takes samples of all units.
    fn sample(
        &self,
        round: Round,
        state: &mut State,
        deadline: Option<Instant>,
        noise: Option<f64>,
        job: &Job,
        report: &mut Report,
        at_rest: &mut dyn FnMut(&State),
    ) -> Ended {
        let settings = self.path_settings(round);
        let first = state.header.items.start;
        let target = state.header.items.len() as u32;
        let all: u64 = self.patches.iter().map(|patch| self.texels_of(patch)).sum();
        let already = self.patches.iter().zip(&state.done);
        let already: u64 = already
            .map(|(unit, &done)| self.texels_of(unit) * u64::from(done))
            .sum();
        job.start_phase(round.name, all.saturating_mul(u64::from(target)));
        job.advance(already, 0);
        let gatherers: Mutex<Vec<Gatherer>> = Mutex::default();
        let brightest = brightest_counted(state.sums.unit(), round.total);

        let mut ended = Ended::Samples;
        let mut passes = 0;
        while state.min_done() < target {
            let end = (state.min_done() / SAMPLES_TOGETHER + 1) * SAMPLES_TOGETHER;
            let end = end.min(target);
            let todo: Vec<usize> = (0..self.patches.len())
                .filter(|&unit| state.done[unit] < end)
                .collect();
            let mut slice_start = 0;
            while slice_start < todo.len() {
                let (mut slice_end, mut samples) = (slice_start, 0);
                while slice_end < todo.len() && samples < SAMPLES_BETWEEN_RESTS {
                    let unit = todo[slice_end];
                    samples +=
                        self.texels_of(&self.patches[unit]) * u64::from(end - state.done[unit]);
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
                            &settings,
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
                // The pass's last rest comes after its noise is known.
                if slice_start < todo.len() {
                    at_rest(state);
                }
            }
            if ended == Ended::Cancel {
                break;
            }
            state.noise.end_batch(&state.sums);
            at_rest(state);
            passes += 1;
            if end < target {
                if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                    ended = Ended::Time;
                    break;
                }
                if passes >= 4 && noise.is_some_and(|limit| state.noise.relative_error() <= limit) {
                    ended = Ended::Noise;
                    break;
                }
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
        settings: &PathSettings,
        brightest: f32,
        gatherer: &mut Gatherer,
        job: &Job,
        sums: &Sums,
    ) -> bool {
        let mut samples = Vec::new();
        self.place(patch, &items, settings, &mut samples);
        let mut irradiance = vec![Vec3::ZERO; samples.len()];
        for (samples, irradiance) in samples.chunks(BATCH).zip(irradiance.chunks_mut(BATCH)) {
            if job.is_cancelled() {
                return false;
            }
            gatherer.gather(&self.subject.world, settings, samples, irradiance);
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
        let mut push = |front: u32, point: &dyn Fn(Vec2) -> Hit| {
            for number in items.clone() {
                samples.push(SurfaceSample {
                    point: point(placement(settings.seed, front, number)),
                    side: front,
                    number,
                    back: false,
                });
            }
            let Some(back) = sides.and_then(|sides| sides.back_of(front)) else {
                return;
            };
            for number in items.clone() {
                samples.push(SurfaceSample {
                    point: point(placement(settings.seed, back, number)),
                    side: back,
                    number,
                    back: true,
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

    /// Gathers directions by bundles.
    fn bundle(
        &self,
        round: Round,
        state: &mut State,
        deadline: Option<Instant>,
        noise: Option<f64>,
        job: &Job,
        report: &mut Report,
        at_rest: &mut dyn FnMut(&State),
    ) -> Ended {
        let Some(triangles) = self.subject.triangles else {
            return Ended::Samples;
        };
        let target = state.header.items.len() as u32;
        job.start_phase(round.name, u64::from(target));
        job.advance(u64::from(state.done[0]), 0);
        let radiance = self.radiance(round, state);
        let environment = |towards: Vec3| {
            self.subject
                .sky
                .map_or(Vec3::ZERO, |(sky, _)| sky.radiance(towards))
        };
        // Reflected light alone is wanted: the last round leaves the sky out.
        let no_sky = self.settings.part == Part::Indirect && self.is_last(state);
        let sky: Option<Sky> = match self.subject.sky {
            Some(_) if !no_sky => Some(&environment),
            _ => None,
        };
        let directions = Directions {
            seed: self.settings.seed,
            round: state.header.round,
        };
        let first = state.header.items.start;
        while state.done[0] < target {
            let end = (state.done[0] / DIRECTIONS_TOGETHER + 1) * DIRECTIONS_TOGETHER;
            let range = first + state.done[0]..first + end.min(target);
            let stats = bundle::gather(
                triangles,
                &radiance,
                sky,
                &directions,
                range,
                &self.settings.bundles,
                job,
                &state.sums,
            );
            state.done[0] += stats.directions as u32;
            report.bundles += stats;
            if job.is_cancelled() {
                return Ended::Cancel;
            }
            state.noise.end_batch(&state.sums);
            at_rest(state);
            if state.done[0] < target {
                if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                    return Ended::Time;
                }
                if noise.is_some_and(|limit| state.noise.relative_error() <= limit) {
                    return Ended::Noise;
                }
            }
        }
        Ended::Samples
    }

    /// What every side sends out in a round of bundles.
    fn radiance(&self, round: Round, state: &State) -> Radiance {
        let brightest = self.brightest(&state.direct, &state.previous);
        Radiance::new(state.header.sides, brightest, |side| match round.kind {
            RoundKind::Reflected => self.reflected(&state.direct, &state.previous, side),
            _ => Vec3::ZERO,
        })
    }

    /// Radiance that a side reflects of what the rounds before have brought.
    fn reflected(&self, direct: &[Vec3], previous: &[Vec3], side: u32) -> Vec3 {
        let arrived = if previous.is_empty() {
            direct
        } else {
            previous
        };
        let front = self
            .subject
            .sides()
            .map_or(side, |sides| sides.front_of(side));
        let albedo = self.albedo.get(front as usize).copied().unwrap_or_default();
        let albedo = Vec3::from_array(albedo.map(f16::to_f32));
        albedo * arrived.get(side as usize).copied().unwrap_or(Vec3::ZERO) * FRAC_1_PI
    }

    /// The brightest radiance that bundles meet.
    fn brightest(&self, direct: &[Vec3], previous: &[Vec3]) -> f32 {
        let surfaces = if self.albedo.is_empty() {
            0.0
        } else {
            (0..self.sides())
                .into_par_iter()
                .map(|side| self.reflected(direct, previous, side).max_element())
                .reduce(|| 0.0, f32::max)
        };
        let sky = self.subject.sky.map_or(0.0, |(_, brightest)| brightest);
        surfaces.max(sky).max(f32::MIN_POSITIVE * 1e20)
    }

    /// The unit of sums of samples: found from a few of them.
    fn path_unit(&self, round: u32) -> Unit {
        let round = self.rounds[round as usize];
        let settings = self.path_settings(round);
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
                let mut gatherer = Gatherer::default();
                gatherer.gather(&self.subject.world, &settings, &samples, &mut irradiance);
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

/// Units that the first look at brightness takes.
const PILOT_UNITS: usize = 64;

/// Single samples may be this much brighter than the brightest of the first look; what is beyond is cut.
const HEADROOM: f32 = 1024.0;

/// Sums have room for this many items; work without a fixed number ends before.
pub const MOST_COUNTED: u32 = 1 << 18;

impl<'a> Subject<'a> {
    fn sides(&self) -> Option<&'a Sides> {
        self.triangles.map(Triangles::sides)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The largest radiance of which sums in this unit hold so many terms.
fn brightest_counted(unit: Unit, terms: u32) -> f32 {
    (2f64.powi(62) / (unit.radiance * f64::from(terms.min(MOST_COUNTED)))) as f32
}

/// The irradiance of all sides; 0 where nothing is known.
fn develop(sums: &Sums, map: &mut [Vec3]) {
    let mut rest = map;
    for run in 0..sums.runs() {
        let mut locked = sums.lock(run);
        let (here, after) = rest.split_at_mut(locked.sums().len());
        for (value, sum) in here.iter_mut().zip(locked.sums()) {
            *value = sums.develop(*sum).unwrap_or(Vec3::ZERO);
        }
        rest = after;
    }
}

/// Lambert albedo of every front.
fn albedo(subject: &Subject) -> Vec<[f16; 3]> {
    let Some(sides) = subject.sides() else {
        return Vec::new();
    };
    let pack = |albedo: Vec3| {
        albedo
            .clamp(Vec3::ZERO, Vec3::ONE)
            .to_array()
            .map(f16::from_f32)
    };
    let mut fronts = vec![[f16::ZERO; 3]; sides.fronts_count() as usize];
    let (texels, stand_ins) = fronts.split_at_mut(sides.texels() as usize);
    let atlas = subject.texels.atlas;
    let mut rest = texels;
    for (page, size) in atlas.pages.iter().enumerate() {
        let (here, after) = rest.split_at_mut(size.texels() as usize);
        rest = after;
        let rows = here.par_chunks_mut(size.width.max(1) as usize).enumerate();
        rows.for_each(|(y, row)| {
            let band: Band = subject.texels.band(page as u32, y as u32..y as u32 + 1);
            let first = size.texel(0, y as u32);
            for i in 0..band.len() {
                let reflection = subject.texels.reflection(&band, i);
                row[(band.texel(i) - first) as usize] = pack(reflection.albedo);
            }
        });
    }
    let geometry = subject.world.geometry;
    stand_ins
        .par_iter_mut()
        .zip(sides.stand_ins())
        .for_each(|(value, &[instance, primitive])| {
            let mesh = geometry.pose.instances[instance as usize].mesh;
            let mesh = &geometry.scene.meshes[mesh as usize];
            let third = 1.0 / 3.0;
            *value = pack(diffuse_albedo(
                geometry.scene,
                mesh,
                primitive,
                third,
                third,
            ));
        });
    fronts
}
