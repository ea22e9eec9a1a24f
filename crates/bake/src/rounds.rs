//! A bake, round by round.
//!
//! By paths there is one round: all light that arrives, by path tracing from every texel. By bundles there are several. The first
//! finds direct light by exact rays (small and bright lights are what few parallel rays would miss); the next what spots reflect that are far
//! brighter than the rest, by rays that are aimed at those; each further one gathers what surfaces reflect of all light that the rounds before have brought them, and the sky's even part. The last round's is the
//! result: earlier ones are averaged over a hemisphere before they show, so they take half as many directions.
//!
//! With `B` bounces in a closed box of albedo `a` and emission `e` the irradiance is `pi e (1 - a^(B+1)) / (1 - a)`.
//!
//! Every round is a number of *items* (samples a texel or directions), each a pure function of seed, round and number; sums are
//! integers. So threads, shards, interruptions and the order of work do not show in the result.

mod bundles;
mod paths;
mod spots;
mod tiny;

use crate::bundle::{self, Sides, Triangles};
use crate::gather::Part;
use crate::noise::Noise;
use crate::state::{Before, Header, State};
use crate::store::Store;
use crate::sums::Sums;
use crate::texel::Texels;
use glam::Vec3;
use half::f16;
use occlude_bvh::Buffer;
use occlude_render::integrator::World;
use occlude_render::job::Job;
use occlude_render::light::Environment;
pub(crate) use spots::bytes as bytes_of_spots;
use std::io;
use std::ops::Range;
use std::time::{Duration, Instant};
pub(crate) use tiny::Light;
use tiny::TinyTexels;

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
    /// Where light comes from is gathered, too: [`Bake::moment`].
    pub directional: bool,
    /// What texels reflect of the direct light beyond so many times the mean (of roots, squared) is gathered by rays aimed at them instead of bundles ([`SPOTS`]);
    /// infinity: never.
    pub spots: f32,
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
    /// What the brightest spots reflect of that, by exact rays.
    Spots,
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

/// A good choice for [`Settings::spots`]: what lines carry then varies by at most that.
pub const SPOTS: f32 = 8.0;

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
    let bounces = if settings.part == Part::Direct {
        0
    } else {
        settings.bounces
    };
    let samples = (all / DIRECTIONS_PER_DIRECT_SAMPLE).max(LEAST_DIRECT_SAMPLES);
    let mut rounds = vec![Round {
        kind: RoundKind::Direct,
        total: samples,
        name: "direct light",
    }];
    if bounces > 0 && settings.spots.is_finite() {
        rounds.push(Round {
            kind: RoundKind::Spots,
            total: samples,
            name: "spots",
        });
    }
    if sky {
        rounds.push(Round {
            kind: RoundKind::Sky,
            total: all.div_ceil(2),
            name: "sky",
        });
    }
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

/// [`Stop`] for a round that has begun.
#[derive(Clone, Copy, Debug)]
struct Until {
    deadline: Option<Instant>,
    noise: Option<f64>,
}

impl Until {
    /// After a batch of items that all units have: looks at the noise, lets the state be written, and says whether this is the end.
    fn end_batch(self, state: &mut State, at_rest: &mut dyn FnMut(&State)) -> Option<Ended> {
        state.noise.end_batch(&state.sums);
        at_rest(state);
        if state.is_complete() {
            Some(Ended::Samples)
        } else if self.deadline.is_some_and(|end| Instant::now() >= end) {
            Some(Ended::Time)
        } else {
            let low = |limit| state.noise.relative_error() <= limit;
            self.noise.is_some_and(low).then_some(Ended::Noise)
        }
    }
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

/// Stand-ins of a unit of work.
const UNIT_STAND_INS: u32 = 1024;

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
    albedo: Buffer<[f16; 3]>,
    /// Where arrays over all sides are kept.
    pub(crate) store: Store,
    pub(crate) tiny: TinyTexels,
}

impl<'a> Bake<'a> {
    /// Prepares. `store`: where arrays over all sides are kept, which does not change results; `fingerprint` tells this work from others; `notes`
    /// travel with its files.
    ///
    /// # Errors
    /// The store has no room.
    pub fn new(
        subject: Subject<'a>,
        settings: Settings,
        store: Store,
        fingerprint: u64,
        notes: String,
    ) -> io::Result<Self> {
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
            bundles::albedo(&subject, &store)?
        } else {
            Buffer::default()
        };
        let by_bundles = |r: &Round| matches!(r.kind, RoundKind::Sky | RoundKind::Reflected);
        let tiny = if rounds.iter().any(by_bundles) {
            TinyTexels::find(&subject)
        } else {
            TinyTexels::default()
        };
        Ok(Self {
            tiny,
            subject,
            settings,
            rounds,
            patches,
            fingerprint,
            notes,
            albedo,
            store,
        })
    }

    /// Lists of triangles hold at most so many entries, which does not change results.
    pub fn limit_entries(&mut self, entries: u32) {
        self.settings.bundles.entries = entries;
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
            Some(RoundKind::Paths | RoundKind::Direct | RoundKind::Spots) => {
                self.patches.len() as u32
            }
            _ => 1,
        }
    }

    /// The beginning of a round; `share` of its items are wanted, `(0, 1)` is all.
    ///
    /// # Errors
    /// The store has no room.
    pub fn begin(
        &self,
        round: u32,
        (index, count): (u32, u32),
        before: Before,
    ) -> io::Result<State> {
        let total = self.rounds[round as usize].total;
        let unit = match self.rounds[round as usize].kind {
            RoundKind::Paths | RoundKind::Direct | RoundKind::Spots => {
                self.path_unit(round, &before)
            }
            RoundKind::Sky | RoundKind::Reflected => {
                let brightest = self.brightest(&before);
                bundle::unit(brightest, total.min(MOST_COUNTED))
            }
        };
        let moments = self.moments_of(round);
        Ok(State {
            header: Header {
                fingerprint: self.fingerprint,
                sides: self.sides(),
                round,
                rounds: self.rounds.len() as u32,
                total,
                items: occlude_render::work::shard_samples(total, index, count),
                units: self.units_of(round),
                has_direct: !before.direct.is_empty(),
                has_previous: !before.previous.is_empty(),
                has_spots: !before.spots.is_empty(),
                bound: before.bound.to_bits(),
                moments: [moments, before.direct_moments.len() as u32],
                unit: [unit.radiance, unit.weight],
                notes: self.notes.clone(),
            },
            before,
            done: vec![0; self.units_of(round) as usize],
            sums: Sums::new_in(&self.store, self.sides(), unit, moments)?,
            noise: Noise::new(self.sides()),
        })
    }

    /// Whether a state's round is the last.
    pub fn is_last(&self, state: &State) -> bool {
        state.header.round + 1 >= state.header.rounds
    }

    /// From a round that is done to the next one.
    ///
    /// # Errors
    /// The store has no room.
    pub fn next_round(&self, state: State, share: (u32, u32)) -> io::Result<State> {
        let round = state.header.round;
        let sides = state.header.sides as usize;
        let State {
            mut before, sums, ..
        } = state;
        let kind = self.rounds[round as usize].kind;
        if matches!(kind, RoundKind::Direct | RoundKind::Spots)
            && let Some(moments) = sums.moments()
        {
            let more = std::mem::take(&mut before.direct_moments);
            before.direct_moments = self.store.zeroed(moments.len() as usize)?;
            develop(moments, &[&more], &mut before.direct_moments);
        }
        match kind {
            RoundKind::Paths | RoundKind::Direct => {
                before.direct = self.store.zeroed(sides)?;
                develop(&sums, &[], &mut before.direct);
                before.bound = self.bound(&before);
            }
            RoundKind::Spots if before.bound == f32::INFINITY => {}
            RoundKind::Spots => {
                before.spots = self.store.zeroed(sides)?;
                develop(&sums, &[], &mut before.spots);
            }
            RoundKind::Sky | RoundKind::Reflected => {
                if before.previous.is_empty() {
                    before.previous = self.store.zeroed(sides)?;
                }
                // Of the sky's light nothing has been reflected yet.
                let spots = Some(&before.spots).filter(|_| kind == RoundKind::Reflected);
                let more: Vec<_> = std::iter::once(&before.direct).chain(spots).collect();
                develop(&sums, &more, &mut before.previous);
            }
        }
        drop(sums);
        self.begin(round + 1, share, before)
    }

    /// Goes on with a state until its part of its round is done, or `stop` or the job say stop. `at_rest` is called now and then with a
    /// state that can be written.
    ///
    /// # Errors
    /// The store could not be written or read: the state is worth nothing then.
    pub fn run_round(
        &self,
        state: &mut State,
        stop: Stop,
        job: &Job,
        report: &mut Report,
        at_rest: &mut dyn FnMut(&State),
    ) -> io::Result<Ended> {
        let round = self.rounds[state.header.round as usize];
        let began = Instant::now();
        let until = Until {
            deadline: stop.time_limit.map(|limit| began + limit),
            noise: stop.noise,
        };
        let ended = match round.kind {
            RoundKind::Paths | RoundKind::Direct | RoundKind::Spots => {
                self.sample(round, state, until, job, report, at_rest)
            }
            RoundKind::Sky | RoundKind::Reflected => {
                self.bundle(round, state, until, job, report, at_rest)?
            }
        };
        report
            .seconds
            .push((round.name, began.elapsed().as_secs_f64()));
        let error = state.noise.relative_error();
        report.noise = error.is_finite().then_some(error);
        Ok(ended)
    }

    /// Sides whose first moments a round gathers: all texels in those rounds that show in the result.
    pub(crate) fn moments_of(&self, round: u32) -> u32 {
        let kind = self.rounds[round as usize].kind;
        let shows = round as usize + 1 == self.rounds.len()
            || kind == RoundKind::Spots
            || kind == RoundKind::Direct && self.settings.part != Part::Indirect;
        if self.settings.directional && shows {
            self.subject.texels.atlas.texels()
        } else {
            0
        }
    }

    /// Texels of which less than this share is covered have had too few lines; 0 for paths, of which all texels have the same number.
    pub fn least_coverage(&self, state: &State) -> f32 {
        /// Lines along the normal; half as many in all.
        const ENOUGH: f32 = 32.0;
        match self.rounds.last().map(|round| round.kind) {
            Some(RoundKind::Sky | RoundKind::Reflected) => {
                let done = state.done.iter().copied().min().unwrap_or(0).max(1);
                (ENOUGH / done as f32).min(0.25)
            }
            _ => 0.0,
        }
    }

    /// First moment of the light at a texel when the last round is done: luminance times cosine times the unit vector to where it comes
    /// from, over all directions. 0 unless [`Settings::directional`].
    pub fn moment(&self, state: &State, texel: u32) -> Vec3 {
        let direct = state.before.direct_moments.get(texel as usize).copied();
        let gathered = state.sums.moments().and_then(|m| m.irradiance(texel));
        direct.unwrap_or_default() + gathered.unwrap_or_default()
    }

    /// Irradiance of a texel when the last round is done, W/m². `None`: nothing is known about it.
    pub fn irradiance(&self, state: &State, texel: u32) -> Option<Vec3> {
        let gathered = state.sums.irradiance(texel);
        let direct = state.before.direct.get(texel as usize);
        let spots = state.before.spots.get(texel as usize);
        let spots = spots.copied().unwrap_or(Vec3::ZERO);
        let last = self.rounds.last().map(|round| round.kind);
        match (last, self.settings.part) {
            (Some(RoundKind::Direct), Part::Indirect) => gathered.map(|_| Vec3::ZERO),
            (_, Part::Indirect) => gathered.map(|light| light + spots),
            _ => gathered.map(|light| light + spots + direct.copied().unwrap_or(Vec3::ZERO)),
        }
    }
}

/// Sums have room for this many items; work without a fixed number ends before.
pub const MOST_COUNTED: u32 = 1 << 18;

impl<'a> Subject<'a> {
    fn sides(&self) -> Option<&'a Sides> {
        self.triangles.map(Triangles::sides)
    }
}

/// The irradiance of all sides, 0 where nothing is known, and that of `more` maps; empty ones count as black.
fn develop(sums: &Sums, more: &[&Buffer<Vec3>], map: &mut Buffer<Vec3>) {
    for run in 0..sums.runs() {
        let mut locked = sums.lock(run);
        let first = locked.first() as usize;
        for (value, sum) in map[first..].iter_mut().zip(locked.sums()) {
            *value = sums.develop(*sum).unwrap_or(Vec3::ZERO);
        }
        for more in more.iter().filter(|more| !more.is_empty()) {
            let values = map[first..first + locked.sums().len()].iter_mut();
            values
                .zip(&more[first..])
                .for_each(|(all, more)| *all += *more);
            more.release();
        }
        drop(locked);
        sums.release();
        map.release();
    }
}
