//! `--visibility records` and `--secondary records`: what users say about visibility records.

use super::strategy::GuaranteeName;
use crate::context::Context;
use crate::error::CliError;
use crate::inspect::bounds;
use crate::stats;
use crate::values;
use occlude_image::{Look, ToneMap};
use occlude_render::camera::View;
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{Secondary, SecondaryRays};
use occlude_render::views::{RecordColour, draw};
use occlude_scene::{Pose, Scene};
use occlude_visibility::VisibilityStats;
use occlude_visibility::records::{
    Cache, Lookup, Placement, RecordGuarantee, RecordSettings, Records, RecordsError,
    RecordsReport, Select,
};
use std::path::Path;

/// Refinement steps before the first pass, for every initial record.
const STEPS_PER_RECORD: f32 = 0.25;

/// Questions that cost as much to trace as a record to fill, and the share of all that may be spent on filling before the first pass.
const RAYS_A_RECORD: f64 = 4e3;
const SHADOW_RAYS_A_RECORD: f64 = 1e5;
const SHARE: f64 = 0.1;

/// Records that are placed at least.
const LEAST: f64 = 128.0;

/// Texels along the side of maps for paths: what they keep of surfaces takes four times as long to find as distances alone, and at their
/// distances from each other records are no worse for it.
const PATH_RESOLUTION: u32 = 64;

/// Length of near-field rays where the user says `near=on`, in units of what records are uncertain by.
const NEAR: f32 = 1.0;

/// Options behind `records:`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RecordsOptions {
    count: Option<u32>,
    initial: Option<u32>,
    resolution: Option<u32>,
    alpha: Option<f32>,
    steps: Option<u32>,
    pace: Option<u32>,
    steps_per_frame: Option<u32>,
    placement: Option<Placement>,
    select: Option<Select>,
    lookup: Option<Lookup>,
    near: Option<f32>,
    contact: Option<f32>,
    from: Option<u32>,
}

/// Reads the value of `--secondary`.
pub fn secondary(text: &str) -> Result<RecordsOptions, String> {
    let (name, options) = text.split_once(':').unwrap_or((text, ""));
    if name != "records" {
        return Err(format!("no such answer {name:?}: there are records"));
    }
    RecordsOptions::parse(options, true)
}

/// How much is to be rendered with the records.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    /// Of a picture, pixels.
    pub size: [u32; 2],
    /// A pixel, if it is known.
    pub samples: Option<u32>,
    /// Pictures.
    pub pictures: u32,
    /// Virtual lights.
    pub vpls: u32,
}

impl Extent {
    fn samples(&self) -> f64 {
        let pixels = f64::from(self.size[0]) * f64::from(self.size[1]);
        pixels * f64::from(self.samples.unwrap_or(64)) * f64::from(self.pictures)
    }

    fn film_bytes(&self) -> u64 {
        Film::bytes(self.size[0], self.size[1], false)
    }
}

impl RecordsOptions {
    /// Reads what stands behind `records:`; `from` is for `--secondary` alone.
    pub fn parse(text: &str, secondary: bool) -> Result<Self, String> {
        let mut options = Self::default();
        for option in text.split(',').filter(|option| !option.is_empty()) {
            let (name, value) = option
                .split_once('=')
                .ok_or_else(|| format!("{option:?}: write NAME=VALUE"))?;
            options
                .set(name, value, secondary)
                .map_err(|error| format!("{name}: {error}"))?;
        }
        Ok(options)
    }

    /// Where records stand that answer for virtual lights. Who says how they are placed or refined along paths wants them there.
    fn placement(&self) -> Placement {
        let along_paths = [self.initial, self.steps, self.pace, self.steps_per_frame];
        let said = along_paths.iter().any(Option::is_some) || self.alpha.is_some();
        let usual = if said {
            Placement::Paths
        } else {
            Placement::Lights
        };
        self.placement.unwrap_or(usual)
    }

    /// Whether the records stay what they are before the first pass: then they follow from the scene and the options alone; else passes
    /// that ask other questions make other records. `vpls`: the virtual lights that they answer for, if they do.
    pub fn are_fixed(&self, vpls: Option<u32>) -> bool {
        let capacity = self.count.unwrap_or(RecordSettings::default().capacity);
        let fit = vpls.is_some_and(|vpls| vpls <= capacity);
        self.pace == Some(0) || fit && self.placement() == Placement::Lights
    }

    fn set(&mut self, name: &str, value: &str, secondary: bool) -> Result<(), String> {
        let count = || {
            value
                .parse::<u32>()
                .map_err(|_| format!("{value:?} is no whole number"))
        };
        match name {
            "count" => self.count = Some(count()?),
            "initial" => self.initial = Some(count()?),
            "resolution" => self.resolution = Some(count()?),
            "alpha" => self.alpha = Some(values::not_negative(value)?),
            "steps" if value == "auto" => self.steps = None,
            "steps" => self.steps = Some(count()?),
            "pace" => self.pace = Some(count()?),
            "frame-steps" => self.steps_per_frame = Some(count()?),
            "place" if !secondary => {
                self.placement = match value {
                    "auto" => None,
                    "lights" => Some(Placement::Lights),
                    "paths" => Some(Placement::Paths),
                    _ => return Err(format!("{value:?}: there are auto, lights and paths")),
                };
            }
            "select" => {
                self.select = Some(match value {
                    "nearest" => Select::Nearest,
                    "probable" => Select::Probable,
                    _ => return Err(format!("{value:?}: there are nearest and probable")),
                });
            }
            "lookup" => {
                self.lookup = Some(match value {
                    "snap" => Lookup::Snap,
                    "plane" => Lookup::Plane,
                    "march" => Lookup::March,
                    _ => return Err(format!("{value:?}: there are snap, plane and march")),
                });
            }
            "near" => {
                (self.near, self.contact) = match value {
                    "auto" => (None, None),
                    "off" => (None, Some(0.0)),
                    "on" => (Some(NEAR), None),
                    _ => (Some(values::not_negative(value)?), None),
                };
            }
            "from" if secondary => match count()? {
                from @ 1..=2 => self.from = Some(from),
                _ => return Err(format!("{value:?}: there are 1 and 2")),
            },
            _ => {
                let first = if secondary { "from" } else { "place" };
                return Err(format!(
                    "no such option: there are {first}, count, initial, resolution, alpha, steps, pace, frame-steps, select, lookup and near"
                ));
            }
        }
        Ok(())
    }

    fn settings(
        &self,
        context: &Context,
        scene: &Scene,
        pose: &Pose,
        film_bytes: u64,
        worth: f64,
    ) -> RecordSettings {
        let usual = RecordSettings::default();
        let capacity = self.count.unwrap_or(usual.capacity);
        // Who says how many records there are wants them now; else as many as the work is worth.
        let initial = (self.initial.or(self.count)).unwrap_or(worth.clamp(LEAST, 1e6) as u32);
        let initial = initial.min(capacity);
        let (low, high) = bounds(scene, pose).unwrap_or_default();
        RecordSettings {
            capacity,
            initial,
            resolution: self.resolution.unwrap_or(usual.resolution),
            alpha: self.alpha.unwrap_or(usual.alpha),
            steps: (self.steps).unwrap_or((initial as f32 * STEPS_PER_RECORD) as u32),
            pace: self.pace.unwrap_or(usual.pace),
            steps_per_picture: self.steps_per_frame.unwrap_or(usual.steps_per_picture),
            select: self.select.unwrap_or(usual.select),
            lookup: self.lookup.unwrap_or(usual.lookup),
            near: self.near.unwrap_or(usual.near),
            contact: self.contact.unwrap_or(usual.contact),
            memory: (context.common.memory).map(|limit| limit.saturating_sub(film_bytes)),
            scene: [low, high],
            threads: rayon::current_num_threads(),
            seed: context.common.seed,
            ..usual
        }
    }

    /// The strategy of `--visibility records`.
    pub fn strategy(
        &self,
        guarantee: Option<GuaranteeName>,
        context: &Context,
        scene: &Scene,
        pose: &Pose,
        work: &Extent,
    ) -> Result<Records, CliError> {
        let questions = work.samples() * f64::from(work.vpls) * SHARE;
        let settings = RecordSettings {
            guarantee: match guarantee {
                Some(GuaranteeName::Unbiased) => RecordGuarantee::Unbiased,
                _ => RecordGuarantee::Biased,
            },
            placement: self.placement(),
            ..self.settings(
                context,
                scene,
                pose,
                work.film_bytes(),
                questions / SHADOW_RAYS_A_RECORD,
            )
        };
        Records::new(settings).map_err(|error| refused(&error, "--visibility records"))
    }

    /// The records of `--secondary`.
    pub fn secondary(
        &self,
        context: &Context,
        scene: &Scene,
        pose: &Pose,
        work: &Extent,
    ) -> Result<Secondary, CliError> {
        // About two rays a path.
        let worth = 2.0 * work.samples() * SHARE / RAYS_A_RECORD;
        let settings = RecordSettings {
            resolution: self.resolution.unwrap_or(PATH_RESOLUTION),
            ..self.settings(context, scene, pose, work.film_bytes(), worth)
        };
        Secondary::new(settings, self.from.unwrap_or(1))
            .map_err(|error| refused(&error, "--secondary records"))
    }
}

fn refused(error: &RecordsError, option: &str) -> CliError {
    let cure = match error {
        RecordsError::Memory { .. } => "lower count or resolution, or raise --memory",
        _ => "see occlude render --help",
    };
    CliError::input(error, option, cure)
}

/// Writes what the records look like, one PNG a colour.
pub fn write_views(
    prefix: &Path,
    cache: &Cache,
    geometry: &Geometry,
    view: &View,
) -> Result<(), CliError> {
    let look = Look {
        tone_map: ToneMap::None,
        exposure_ev: 0.0,
    };
    for colour in RecordColour::ALL {
        let mut name = prefix.as_os_str().to_owned();
        name.push(format!("-{}.png", colour.name()));
        let picture = draw(cache, geometry, view, colour);
        occlude_image::write(Path::new(&name), &picture, look)?;
    }
    Ok(())
}

/// The `records` object of the statistics.
pub fn statistics(
    report: &RecordsReport,
    rays: Option<SecondaryRays>,
    visibility: &VisibilityStats,
) -> stats::Records {
    let steps = &report.steps;
    let per_step = steps.total().as_secs_f64() * 1e3 / steps.steps.max(1) as f64;
    stats::Records {
        count: report.count,
        capacity: report.capacity,
        bytes: report.peak_bytes,
        refinements: steps.placed,
        milliseconds_per_refinement: per_step,
        initial_seconds: report.initial.as_secs_f64(),
        upkeep_seconds: report.upkeep.as_secs_f64(),
        refilled: report.refilled,
        rays_asked: rays.map(|rays| rays.asked),
        rays_traced: rays.map(|rays| rays.traced),
        rays_unanswered: rays.map(|rays| rays.unanswered.into()),
        unanswered: visibility.unanswered.into(),
    }
}
