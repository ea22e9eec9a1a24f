//! `--visibility` and `--guarantee`: how visibility questions are answered.

use super::records::RecordsOptions;
use crate::values;
use clap::ValueEnum;
use occlude_visibility::quantized::{
    Digest, ErrorReach, Guarantee, QuantizedSettings, Refine, Share, Workload,
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

impl From<GuaranteeName> for Guarantee {
    fn from(name: GuaranteeName) -> Self {
        match name {
            GuaranteeName::Bounded => Self::Bounded,
            GuaranteeName::Unbiased => Self::Unbiased,
            GuaranteeName::Consistent => Self::Consistent,
        }
    }
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

    /// Settings for a piece of work: what the user has not said is as measured.
    pub fn settings(&self, work: &Workload) -> QuantizedSettings {
        let usual = work.settings();
        let reach = |kind: Option<f32>, usual: f32| kind.or(self.error).unwrap_or(usual);
        let share = self.share.unwrap_or(usual.share);
        QuantizedSettings {
            error: ErrorReach {
                point: reach(self.point, usual.error.point),
                direction: reach(self.direction, usual.error.direction),
                area: reach(self.area, usual.error.area),
                sky: reach(self.sky, usual.error.sky),
            },
            normals: self.normals.unwrap_or(usual.normals),
            slab: self.slab.unwrap_or(usual.slab),
            resolution_step: self.resolution_step.unwrap_or(usual.resolution_step),
            table_bytes: match self.table {
                Some(bytes) => usize::try_from(bytes).unwrap_or(usize::MAX),
                None => work.table_bytes(share),
            },
            refine: self.refine.unwrap_or(usual.refine),
            share,
            digest: self.digest.unwrap_or(usual.digest),
            ..usual
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_visibility::quantized::{Asks, Pairing};

    #[test]
    fn names_and_options() {
        assert_eq!(strategy("exact"), Ok(Strategy::Exact));
        assert_eq!(strategy("occluder"), Ok(Strategy::Occluder));
        let Ok(Strategy::Quantized(options)) = strategy(
            "quantized:error=12,error-point=3,table=64MiB,share=thread,refine=off,digest=lcg,normals=6,slab=4,resolution-step=1.5",
        ) else {
            panic!("a legal value is refused");
        };
        let settings = options.settings(&Workload {
            asks: Asks::Pairs,
            guarantee: Guarantee::Unbiased,
            sequence: false,
            samples_per_pixel: Some(9),
            pixels: 64,
            points: 1,
            directions: 0,
            virtual_lights: 0,
            seed: 7,
        });
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
