//! `--visibility` and `--guarantee`: how visibility questions are answered.

use super::records::RecordsOptions;
use crate::values;
use clap::ValueEnum;
use occlude_visibility::quantized::{
    Digest, ErrorReach, Guarantee, Pairing, QuantizedSettings, Refine, Share,
};

/// What `--visibility` names, with the options that follow it.
#[derive(Debug, Clone, PartialEq)]
pub enum Strategy {
    /// A ray for every question.
    Exact,
    /// The last blocker first, then a ray: same answers.
    Occluder,
    /// One ray for each pair of patches.
    Quantized(QuantizedOptions),
    /// Distance maps near virtual lights.
    Records(RecordsOptions),
}

/// What a user has said about quantized visibility; the rest depends on the integrator.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct QuantizedOptions {
    error: Option<f32>,
    point: Option<f32>,
    direction: Option<f32>,
    area: Option<f32>,
    sky: Option<f32>,
    normals: Option<u32>,
    slab: Option<f32>,
    resolution_step: Option<f32>,
    table: Option<u64>,
    refine: Option<Refine>,
    share: Option<Share>,
    digest: Option<Digest>,
}

/// Words of a table of single questions for each eye sample: patches hold several questions, but a path asks at each of its vertices.
const WORDS_PER_SAMPLE: u64 = 1;

/// From how many point lights on errors of each may reach farther.
const MANY_POINTS: usize = 16;

/// `--guarantee`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GuaranteeName {
    /// Errors reach no farther than `error` samples
    Bounded,
    /// Right on average
    Unbiased,
    /// Converges to the exact picture as samples are added
    Consistent,
}

/// How many questions one light end is asked: what the defaults depend on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asks {
    /// One light a vertex, picked at random.
    Single,
    /// Pairs of path vertices.
    Pairs,
    /// The same lights by every eye.
    Many,
}

/// Reads the value of `--visibility`.
pub fn strategy(text: &str) -> Result<Strategy, String> {
    let (name, options) = text.split_once(':').unwrap_or((text, ""));
    match (name, options) {
        ("exact", "") => Ok(Strategy::Exact),
        ("occluder", "") => Ok(Strategy::Occluder),
        ("quantized", options) => QuantizedOptions::parse(options).map(Strategy::Quantized),
        ("records", options) => RecordsOptions::parse(options, false).map(Strategy::Records),
        ("exact" | "occluder", _) => Err(format!("{name} takes no options")),
        _ => Err(format!(
            "no strategy {name:?}: there are exact, occluder, quantized and records"
        )),
    }
}

impl QuantizedOptions {
    fn parse(text: &str) -> Result<Self, String> {
        let mut options = Self::default();
        for option in text.split(',').filter(|option| !option.is_empty()) {
            let (name, value) = option
                .split_once('=')
                .ok_or_else(|| format!("{option:?}: write NAME=VALUE"))?;
            options
                .set(name, value)
                .map_err(|error| format!("{name}: {error}"))?;
        }
        Ok(options)
    }

    fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        let count = || {
            value
                .parse::<u32>()
                .map_err(|_| format!("{value:?} is no whole number"))
        };
        match name {
            "error" => self.error = Some(values::not_negative(value)?),
            "error-point" => self.point = Some(values::not_negative(value)?),
            "error-direction" => self.direction = Some(values::not_negative(value)?),
            "error-area" => self.area = Some(values::not_negative(value)?),
            "error-sky" => self.sky = Some(values::not_negative(value)?),
            "normals" => self.normals = Some(count()?),
            "slab" => self.slab = Some(values::positive(value)?),
            "resolution-step" => self.resolution_step = Some(values::positive(value)?),
            "table" => self.table = Some(values::bytes(value)?),
            "refine" => {
                self.refine = Some(match value {
                    "auto" => Refine::Auto,
                    "off" => Refine::Levels(1),
                    _ => Refine::Levels(count()?),
                });
            }
            "share" => {
                self.share = Some(match value {
                    "tile" => Share::Tile,
                    "thread" => Share::Thread,
                    "all" => Share::All,
                    "frames" => Share::Frames,
                    _ => return Err(format!("{value:?}: there are tile, thread, all and frames")),
                });
            }
            "digest" => {
                self.digest = Some(match value {
                    "separable" => Digest::Separable,
                    "lcg" => Digest::Lcg,
                    "lcg-xorshift" => Digest::LcgXorshift,
                    _ => {
                        return Err(format!(
                            "{value:?}: there are separable, lcg and lcg-xorshift"
                        ));
                    }
                });
            }
            _ => {
                return Err(
                    "no such option: there are error, error-point, error-direction, error-area, error-sky, normals, \
                     slab, resolution-step, table, refine, share and digest"
                        .to_owned(),
                );
            }
        }
        Ok(())
    }

    /// Settings for an integrator that asks in this way; `frames`: for several pictures; samples a pixel and of all `pixels` of the whole
    /// work, if they are known; `points`: point and spot lights of the scene.
    pub fn settings(
        &self,
        asks: Asks,
        guarantee: GuaranteeName,
        frames: bool,
        samples_per_pixel: Option<u32>,
        pixels: u64,
        points: usize,
        seed: u64,
    ) -> QuantizedSettings {
        let usual = QuantizedSettings::default();
        let reach = |kind: Option<f32>, usual: f32| kind.or(self.error).unwrap_or(usual);
        let guarantee = match guarantee {
            GuaranteeName::Bounded => Guarantee::Bounded,
            GuaranteeName::Unbiased => Guarantee::Unbiased,
            GuaranteeName::Consistent => Guarantee::Consistent,
        };
        // Where checks mend errors on average, larger patches cost less than they err.
        let usual_error = match (asks, guarantee) {
            (Asks::Single, Guarantee::Unbiased) => ErrorReach {
                point: 14.0,
                direction: 14.0,
                area: 40.0,
                sky: 40.0,
            },
            // A hard shadow shows every error, but of many each brings little: about four pixels then.
            (Asks::Many, _) if points >= MANY_POINTS => {
                let together = samples_per_pixel.unwrap_or(1).min(16) as f32;
                ErrorReach {
                    point: (usual.error.point * together.sqrt()).min(usual.error.area),
                    ..usual.error
                }
            }
            _ => usual.error,
        };
        // What path vertices see of each other is met once and blurred by all that follows: rough patches share more.
        let (normals, slab, step) = match asks {
            Asks::Pairs => (2, 2.0, 2.0),
            Asks::Single | Asks::Many => (usual.normals, usual.slab, usual.resolution_step),
        };
        // Tiles remember enough for themselves where they ask about the same lights in every pixel.
        let (share, table) = match (asks, guarantee) {
            (Asks::Many, Guarantee::Bounded | Guarantee::Unbiased) if frames => {
                (Share::Frames, 256 << 20)
            }
            (Asks::Many, Guarantee::Bounded | Guarantee::Unbiased) => (Share::Tile, 4 << 20),
            _ => (Share::All, 256 << 20),
        };
        let share = self.share.unwrap_or(share);
        let table = match share {
            // A table that is larger than what it has to hold is far from the processor for nothing.
            Share::All if asks != Asks::Many => {
                let samples = u64::from(samples_per_pixel.unwrap_or(1024));
                let words = samples
                    .saturating_mul(pixels)
                    .saturating_mul(WORDS_PER_SAMPLE);
                words
                    .next_power_of_two()
                    .saturating_mul(4)
                    .clamp(4 << 20, 256 << 20) as usize
            }
            Share::All | Share::Frames => 256 << 20,
            Share::Tile | Share::Thread => table.min(4 << 20),
        };
        QuantizedSettings {
            error: ErrorReach {
                point: reach(self.point, usual_error.point),
                direction: reach(self.direction, usual_error.direction),
                area: reach(self.area, usual_error.area),
                sky: reach(self.sky, usual_error.sky),
            },
            normals: self.normals.unwrap_or(normals),
            slab: self.slab.unwrap_or(slab),
            resolution_step: self.resolution_step.unwrap_or(step),
            table_bytes: self
                .table
                .map_or(table, |bytes| usize::try_from(bytes).unwrap_or(usize::MAX)),
            refine: self.refine.unwrap_or_default(),
            share,
            digest: self.digest.unwrap_or_default(),
            guarantee,
            pairing: if asks == Asks::Pairs {
                Pairing::Both
            } else {
                Pairing::Eye
            },
            samples_per_pixel: samples_per_pixel.unwrap_or(1),
            seed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_options() {
        assert_eq!(strategy("exact"), Ok(Strategy::Exact));
        assert_eq!(strategy("occluder"), Ok(Strategy::Occluder));
        let Ok(Strategy::Quantized(options)) = strategy(
            "quantized:error=12,error-point=3,table=64MiB,share=thread,refine=off,digest=lcg,normals=6,slab=4,resolution-step=1.5",
        ) else {
            panic!("a legal value is refused");
        };
        let settings = options.settings(
            Asks::Pairs,
            GuaranteeName::Unbiased,
            false,
            Some(9),
            64,
            1,
            7,
        );
        assert_eq!(
            settings,
            QuantizedSettings {
                error: ErrorReach {
                    point: 3.0,
                    ..ErrorReach::all(12.0)
                },
                normals: 6,
                slab: 4.0,
                resolution_step: 1.5,
                table_bytes: 64 << 20,
                refine: Refine::Levels(1),
                share: Share::Thread,
                digest: Digest::Lcg,
                guarantee: Guarantee::Unbiased,
                pairing: Pairing::Both,
                samples_per_pixel: 9,
                seed: 7,
            }
        );
    }

    #[test]
    fn wrong_values_are_named() {
        for (text, wanted) in [
            ("", "no strategy"),
            ("quantised", "no strategy"),
            ("exact:error=3", "takes no options"),
            ("quantized:error", "NAME=VALUE"),
            ("quantized:error=-1", "error:"),
            ("quantized:error=nan", "error:"),
            ("quantized:normals=2.5", "normals:"),
            ("quantized:table=lots", "table:"),
            ("quantized:share=none", "share:"),
            ("quantized:digest=md5", "digest:"),
            ("quantized:colour=red", "colour: no such option"),
        ] {
            let error = strategy(text).expect_err(text);
            assert!(error.contains(wanted), "{text}: {error}");
        }
    }
}
