//! Integrators: from a world and a visibility strategy to a film.
//!
//! Work proceeds in tiles of pixels and a few samples at a time: about a thousand paths that advance together, one
//! scattering event a pass (extend all rays, shade all hits, ask all visibility questions, go on). Caches see questions
//! in batches, and vector units and GPUs can take the same passes.
//!
//! A sample is a pure function of seed, pixel and sample number, and the film's sums do not depend on their order: so the
//! number of threads, shards, cancelling and resuming leave no trace in the picture.

mod ambient_occlusion;
mod bidirectional;
mod field;
mod image_space;
mod instant_radiosity;
mod path;
mod scout;

pub use bidirectional::{BidirectionalLimits, Techniques};
pub use field::{Field, FieldReport};
pub use image_space::{ImageSpaceReport, Secondary, SecondaryRays};
pub use instant_radiosity::{InstantRadiosity, InstantRadiosityReport};

use crate::camera::{PixelFilter, View};
use crate::film::Film;
use crate::geometry::Geometry;
use crate::job::Job;
use crate::light::{Emission, Lights, SkyLobes};
use crate::sampling::{Sampler, SamplerKind};
use glam::Vec2;
use occlude_image::Picture;
use occlude_visibility::records::{Cache, StateError};
use occlude_visibility::{Epoch, Visibility, VisibilityStats};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Width and height of a tile, pixels.
const TILE: u32 = 16;

/// Samples a pixel that a tile advances together.
const SAMPLES_TOGETHER: u32 = 4;

/// How light is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Integrator {
    /// Unidirectional path tracing with next-event estimation and multiple importance sampling (Kajiya 1986; Veach 1997).
    Path(PathLimits),
    /// Bidirectional path tracing with multiple importance sampling (Veach 1997, chapter 10).
    Bidirectional(BidirectionalLimits),
    /// Share of the cosine-weighted hemisphere that nothing blocks within a distance.
    AmbientOcclusion {
        /// The distance, metres; may be infinite.
        distance: f32,
    },
    /// Many virtual lights that all eye samples share (Keller 1997; Segovia et al. 2006).
    InstantRadiosity(InstantRadiosity),
    /// Direct light by fields of visibility at sample points (Wang et al. 2013).
    Field(Field),
}

/// What a path may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathLimits {
    /// Most scattering events on a path: 0 sees emitters only, 1 adds direct light.
    pub max_depth: u32,
    /// Blurs glossy surfaces and clear bodies that are seen by way of a rough one (path regularization in the manner of
    /// Kaplanyan & Dachsbacher 2013): far fewer fireflies, caustics too soft. Off: unbiased.
    pub regularize: bool,
}

impl PathLimits {
    /// Unbiased paths of at most `max_depth` scattering events.
    pub fn new(max_depth: u32) -> Self {
        Self {
            max_depth,
            regularize: false,
        }
    }
}

/// What is rendered, and when it is good enough.
#[derive(Clone, Debug)]
pub struct RenderSettings {
    /// How light is found.
    pub integrator: Integrator,
    /// Where sample points come from.
    pub sampler: SamplerKind,
    /// How samples spread around pixel centres.
    pub filter: PixelFilter,
    /// Seed of all random decisions.
    pub seed: u64,
    /// The sample numbers to take: `0..n` on one machine, a part of it in a shard.
    pub samples: Range<u32>,
    /// Stop after this time, with at least one sample a pixel.
    pub time_limit: Option<Duration>,
    /// Stop once [`Film::noise`] is at most this.
    pub noise: Option<f64>,
}

/// Everything that light meets.
#[derive(Clone, Copy, Debug)]
pub struct World<'a> {
    /// Surfaces.
    pub geometry: &'a Geometry<'a>,
    /// Emitters.
    pub lights: &'a Lights,
}

/// Why rendering ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoppedBy {
    /// All samples are taken.
    Samples,
    /// The time is over.
    Time,
    /// The noise is low enough.
    Noise,
    /// Somebody cancelled the job.
    Cancel,
}

impl StoppedBy {
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

/// Rays by purpose, visibility questions apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// From the camera.
    pub primary: u64,
    /// From surfaces on.
    pub secondary: u64,
}

/// What a rendering did.
#[derive(Clone, Debug)]
pub struct RenderReport {
    /// Why it ended.
    pub stopped_by: StoppedBy,
    /// Rays by purpose.
    pub rays: RayCounts,
    /// Visibility questions and what became of them.
    pub visibility: VisibilityStats,
    /// Of [`Integrator::InstantRadiosity`].
    pub instant_radiosity: Option<InstantRadiosityReport>,
    /// Of [`Integrator::Field`].
    pub field: Option<FieldReport>,
    /// Rays that records were asked about, see [`Sequence::secondary`].
    pub secondary: SecondaryRays,
}

/// Scratch space and counters of one worker.
struct Worker<'a, W> {
    visibility: W,
    path: path::Scratch,
    bidirectional: bidirectional::Scratch<'a>,
    instant_radiosity: instant_radiosity::Scratch,
    image_space: image_space::Scratch,
    rays: RayCounts,
}

/// How the picture is cut into units.
#[derive(Clone, Copy, Debug)]
struct Layout {
    /// Width and height of a tile, pixels.
    tile: u32,
    /// Samples a pixel of the first pass, and of the others.
    first: u32,
    together: u32,
}

impl Layout {
    fn of(settings: &RenderSettings) -> Self {
        match settings.integrator {
            // Passes are as large as may be: questions asked together answer each other. Not so large that a limit on time or
            // noise would be overrun.
            Integrator::InstantRadiosity(_) => {
                let together = match (settings.time_limit, settings.noise) {
                    (Some(_), _) => 1,
                    (None, Some(_)) => SAMPLES_TOGETHER,
                    (None, None) => instant_radiosity::SAMPLES_TOGETHER,
                };
                Self {
                    tile: instant_radiosity::TILE,
                    first: together,
                    together,
                }
            }
            // The first sample alone: something to look at soon.
            _ => Self {
                tile: TILE,
                first: 1,
                together: SAMPLES_TOGETHER,
            },
        }
    }
}

impl Layout {
    /// The number of passes that a film holds, if it is what a finished pass left.
    fn finished_passes(&self, film: &Film) -> Option<u64> {
        let done = film.min_samples();
        let ends = done == self.first || done > 0 && done.is_multiple_of(self.together);
        let mut rows = 0..film.height();
        let even = rows.all(|y| (0..film.width()).all(|x| film.samples_at(x, y) == done));
        (ends && even).then(|| u64::from(1 + done / self.together - self.first / self.together))
    }
}

/// The state of the records, those of `visibility` or those that show paths the way: between passes, or after an interrupted one. Empty
/// without records. For [`Sequence::restore_records`].
pub fn records_state<'a, V: Visibility<Geometry<'a>>>(
    visibility: &V,
    secondary: Option<&Secondary>,
) -> Vec<u8> {
    let shared = visibility.records().map(|records| records.cache());
    let own = secondary.and_then(Secondary::cache);
    own.or(shared.as_deref())
        .map_or_else(Vec::new, Cache::state)
}

/// A rectangle of pixels and the samples that it takes next.
struct Unit {
    /// Number of the tile in the picture.
    index: u32,
    x: u32,
    y: u32,
    width: u32,
    height: u32,
    samples: Range<u32>,
}

/// What there is while no sample is half done.
#[derive(Clone, Copy, Debug)]
pub struct AtRest<'r> {
    /// All samples so far.
    pub film: &'r Film,
    /// Records that show paths the way, before they learn from the last pass.
    pub secondary: Option<&'r Secondary>,
}

/// Renders until `settings` say stop, adding to what the film already holds: a picture of its own, see [`Sequence::render`].
///
/// # Panics
/// If film and view differ in size.
pub fn render<'a, V: Visibility<Geometry<'a>>>(
    world: &World<'a>,
    view: &View,
    visibility: &V,
    settings: &RenderSettings,
    film: &mut Film,
    job: &Job,
    at_rest: &mut dyn FnMut(&AtRest),
) -> RenderReport {
    let mut alone = Sequence::default();
    alone.render(world, view, visibility, settings, film, job, at_rest)
}

/// Pictures one after the other, and what of the work for one serves the next.
///
/// By default that is nothing: each picture is the one that [`render`] makes.
#[derive(Debug, Default)]
pub struct Sequence {
    /// Blocks of 16 virtual lights that are drawn anew from picture to picture; `None`: all.
    renew: Option<u32>,
    virtual_lights: Option<instant_radiosity::Pool>,
    fields: field::Fields,
    /// Records that find where the paths of [`Integrator::Path`] go on; `None`: rays do. They stay from picture to picture.
    pub secondary: Option<Secondary>,
}

impl Sequence {
    /// The sky as [`Integrator::Field`] sees it, from now on. Without it the lobes are fitted to the lights' environment when they are first needed.
    pub fn set_sky(&mut self, lobes: SkyLobes) {
        self.fields.set_sky(lobes);
    }

    /// Pictures of how the last frame of [`Integrator::Field`] came about, by name: its sample points coloured by their errors, the sky's lobes, and, of the sample point
    /// next to a picked pixel, what it sees and its field of distances.
    pub fn field_views(
        &self,
        geometry: &Geometry,
        view: &View,
        field: &Field,
        pick: Option<[u32; 2]>,
    ) -> Vec<(&'static str, Picture)> {
        self.fields.views(geometry, view, field, pick)
    }

    /// A sequence whose virtual lights stay, but for `blocks` blocks of 16 that are drawn anew for every picture: less flicker,
    /// and questions that a strategy has heard before. A picture then depends on those before it.
    pub fn renewing(blocks: u32) -> Self {
        Self {
            renew: Some(blocks),
            ..Self::default()
        }
    }

    /// A sequence whose paths `secondary` shows the way.
    pub fn with_secondary(secondary: Secondary) -> Self {
        Self {
            secondary: Some(secondary),
            ..Self::default()
        }
    }

    /// Makes records, those of `visibility` or those that show paths the way, what they were when [`records_state`] was taken beside `film`: with the same
    /// settings in the same world the picture ends in the same bytes as if nothing had happened. To be called before [`Self::render`],
    /// with new records.
    pub fn restore_records<'a, V: Visibility<Geometry<'a>>>(
        &mut self,
        world: &World<'a>,
        visibility: &V,
        settings: &RenderSettings,
        film: &Film,
        state: &[u8],
    ) -> Result<(), StateError> {
        let mut shared = visibility.records().map(|records| records.cache_mut());
        let own = self.secondary.as_mut().and_then(Secondary::cache_mut);
        let Some(cache) = own.or(shared.as_deref_mut()) else {
            return if state.is_empty() {
                Ok(())
            } else {
                Err(StateError)
            };
        };
        cache.restore(world.geometry, state)?;
        // What the last finished pass has asked may not have been taken over yet: that depends on the moment of the interruption.
        let finished = Layout::of(settings).finished_passes(film);
        if finished.is_some_and(|finished| cache.passes() < finished) {
            cache.pass_done(world.geometry);
        }
        Ok(())
    }

    /// To be called when surfaces or lights have moved since the last picture.
    pub fn world_moved(&mut self) {
        self.virtual_lights = None;
    }

    /// Renders until `settings` say stop, adding to what the film already holds.
    ///
    /// The film must be empty or the result of an earlier, interrupted call with the same settings. `at_rest` is called now and
    /// then while no sample is half done, for checkpoints and previews.
    ///
    /// # Panics
    /// If film and view differ in size.
    pub fn render<'a, V: Visibility<Geometry<'a>>>(
        &mut self,
        world: &World<'a>,
        view: &View,
        visibility: &V,
        settings: &RenderSettings,
        film: &mut Film,
        job: &Job,
        at_rest: &mut dyn FnMut(&AtRest),
    ) -> RenderReport {
        assert_eq!((view.width(), view.height()), (film.width(), film.height()));
        let Geometry { scene, pose, .. } = *world.geometry;
        if let Integrator::Field(field) = &settings.integrator {
            let bounce = (field.bounce > 0).then(|| {
                let wanted = InstantRadiosity {
                    max_depth: 2,
                    vpls: field.bounce,
                    clamp: None,
                    compensate: false,
                };
                instant_radiosity::Prepared::new(world, view, settings, wanted, self)
            });
            let bounce = bounce.as_ref();
            return self
                .fields
                .render(world, view, field, settings, bounce, film, job);
        }
        let emission = match settings.integrator {
            Integrator::Bidirectional(_) => {
                film.enable_splats();
                Emission::new(world.lights, scene, pose)
            }
            _ => Emission::none(),
        };
        let deadline = settings.time_limit.map(|limit| Instant::now() + limit);
        let workers: Mutex<Vec<Worker<'a, V::Worker>>> = Mutex::new(Vec::new());
        let pixels = u64::from(film.width()) * u64::from(film.height());
        let target = settings.samples.end - settings.samples.start;
        let already: u64 = (0..film.height())
            .flat_map(|y| (0..film.width()).map(move |x| (x, y)))
            .map(|(x, y)| u64::from(film.samples_at(x, y)))
            .sum();
        job.start_phase("render", pixels * u64::from(target));
        job.advance(already, 0);

        let layout = Layout::of(settings);
        let prepared = match settings.integrator {
            Integrator::InstantRadiosity(wanted) => Some(instant_radiosity::Prepared::new(
                world, view, settings, wanted, self,
            )),
            _ => None,
        };
        let mut scout = scout::CameraPaths::new(world, view, settings);
        let lights = prepared
            .as_ref()
            .map_or(&[][..], |prepared| prepared.virtual_lights());
        visibility.prepare(world.geometry, lights, &mut scout);
        if let Some(secondary) = &mut self.secondary {
            secondary.prepare(world.geometry, &mut scout);
        }
        let mut stopped_by = StoppedBy::Samples;
        let mut round_end = 0;
        let mut first_round = true;
        while round_end < target {
            round_end = if round_end == 0 {
                layout.first
            } else {
                (round_end / layout.together + 1) * layout.together
            }
            .min(target);
            let units = units_until(film, round_end, layout.tile);
            // Rounds of an earlier run are learnt from already.
            let is_new = !units.is_empty();
            let secondary = self.secondary.as_ref();
            let shared_film = Mutex::new(&mut *film);
            let stop = |first_round: bool| {
                job.is_cancelled()
                    || (!first_round && deadline.is_some_and(|deadline| Instant::now() >= deadline))
            };
            units.into_par_iter().for_each(|unit| {
                if stop(first_round) {
                    return;
                }
                let mut worker = lock(&workers).pop().unwrap_or_else(|| Worker {
                    visibility: visibility.worker(),
                    path: path::Scratch::default(),
                    bidirectional: bidirectional::Scratch::default(),
                    instant_radiosity: instant_radiosity::Scratch::default(),
                    image_space: image_space::Scratch::default(),
                    rays: RayCounts::default(),
                });
                let before = worker.rays.primary
                    + worker.rays.secondary
                    + visibility.stats(&worker.visibility).traced;
                let mut tile = lock(&shared_film).tile(unit.x, unit.y, unit.width, unit.height);
                match settings.integrator {
                    Integrator::Path(limits) => {
                        path::render_unit(
                            world,
                            view,
                            visibility,
                            settings,
                            limits,
                            secondary,
                            &unit,
                            &mut worker,
                            &mut tile,
                        );
                    }
                    Integrator::Bidirectional(limits) => {
                        bidirectional::render_unit(
                            world,
                            view,
                            visibility,
                            settings,
                            (limits, &emission),
                            &unit,
                            &mut worker,
                            &mut tile,
                        );
                    }
                    Integrator::AmbientOcclusion { distance } => {
                        ambient_occlusion::render_unit(
                            world,
                            view,
                            visibility,
                            settings,
                            distance,
                            &unit,
                            &mut worker,
                            &mut tile,
                        );
                    }
                    Integrator::InstantRadiosity(_) => {
                        if let Some(prepared) = &prepared {
                            instant_radiosity::render_unit(
                                world,
                                view,
                                visibility,
                                settings,
                                prepared,
                                &unit,
                                &mut worker,
                                &mut tile,
                            );
                        }
                    }
                    // Rendered above, not by units.
                    Integrator::Field(_) => {}
                }
                {
                    let mut film = lock(&shared_film);
                    film.add_tile(&tile);
                    for splat in worker.bidirectional.splats.drain(..) {
                        film.splat(&splat);
                    }
                }
                let after = worker.rays.primary
                    + worker.rays.secondary
                    + visibility.stats(&worker.visibility).traced;
                job.advance(
                    u64::from(unit.width * unit.height) * unit.samples.len() as u64,
                    after - before,
                );
                lock(&workers).push(worker);
            });
            if job.is_cancelled() {
                stopped_by = StoppedBy::Cancel;
                break;
            }
            if is_new {
                at_rest(&AtRest {
                    film,
                    secondary: self.secondary.as_ref(),
                });
                visibility.pass_done(world.geometry);
                if let Some(secondary) = &mut self.secondary {
                    secondary.pass_done(world.geometry);
                }
            }
            first_round = false;
            if stop(false) && round_end < target {
                stopped_by = if job.is_cancelled() {
                    StoppedBy::Cancel
                } else {
                    StoppedBy::Time
                };
                break;
            }
            let checkpoint = round_end.is_power_of_two() || round_end % 16 == 0;
            if checkpoint
                && round_end >= 4
                && settings.noise.is_some_and(|limit| film.noise() <= limit)
                && round_end < target
            {
                stopped_by = StoppedBy::Noise;
                break;
            }
        }

        let mut rays = RayCounts {
            primary: 0,
            secondary: prepared.as_ref().map_or(0, |prepared| prepared.rays),
        };
        let mut stats = VisibilityStats::default();
        let mut asked = SecondaryRays::default();
        for worker in workers.into_inner().unwrap_or_else(PoisonError::into_inner) {
            rays.primary += worker.rays.primary;
            rays.secondary += worker.rays.secondary;
            stats.add(&visibility.stats(&worker.visibility));
            stats.add(&worker.image_space.stats());
            asked.add(&worker.image_space.counts);
        }
        RenderReport {
            stopped_by,
            rays,
            visibility: stats,
            instant_radiosity: prepared.map(|prepared| prepared.report()),
            field: None,
            secondary: asked,
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The work that brings every pixel of the film to `samples` samples.
fn units_until(film: &Film, samples: u32, tile: u32) -> Vec<Unit> {
    let corners = (0..film.height()).step_by(tile as usize).flat_map(|y| {
        (0..film.width())
            .step_by(tile as usize)
            .map(move |x| (x, y))
    });
    corners
        .filter_map(|(x, y)| {
            let done = film.samples_at(x, y);
            (done < samples).then(|| Unit {
                index: y / tile * film.width().div_ceil(tile) + x / tile,
                x,
                y,
                width: tile.min(film.width() - x),
                height: tile.min(film.height() - y),
                samples: done..samples,
            })
        })
        .collect()
}

/// The start of a sample: its pixel, its sampler and its point on the picture.
struct Start {
    x: u32,
    y: u32,
    sampler: Sampler,
    point: Vec2,
}

impl Unit {
    /// The unit's questions, as visibility strategies know them.
    fn epoch(&self) -> Epoch {
        Epoch {
            pass: self.samples.start,
            samples: self.samples.len() as u32,
            tile: self.index,
        }
    }

    /// The samples of the unit, pixel by pixel.
    fn starts<'a>(&'a self, settings: &'a RenderSettings) -> impl Iterator<Item = Start> + 'a {
        let together = self.samples.len() as u32;
        (0..self.width * self.height * together).map(move |i| {
            let (pixel, sample) = (i / together, self.samples.start + i % together);
            let (x, y) = (self.x + pixel % self.width, self.y + pixel / self.width);
            let number = settings.samples.start + sample;
            let mut sampler = Sampler::new(settings.sampler, settings.seed, [x, y], number);
            let [u, v, ..] = sampler.next();
            let point =
                Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + settings.filter.offset(Vec2::new(u, v));
            Start {
                x,
                y,
                sampler,
                point,
            }
        })
    }
}
