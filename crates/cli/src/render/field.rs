//! Options of `--integrator field`.

use crate::cache::{self, Cache};
use crate::context::Context;
use crate::error::CliError;
use crate::sky::SkyArgs;
use crate::stats;
use crate::values::{Pixel, Thresholds};
use clap::Args;
use occlude_image::{Look, Picture, ToneMap};
use occlude_render::camera::View;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{Field, Sequence};
use occlude_render::light::{Environment, SkyFit, SkyLobes};
use occlude_scene::Scene;
use std::path::{Path, PathBuf};

/// What fields of visibility know their points by.
#[derive(Debug, Clone, Args)]
pub struct FieldArgs {
    /// Fields: insert points where visibility is missed by more than MAX, erase those that their neighbours make up for to MIN
    #[arg(
        long,
        value_name = "MAX,MIN",
        default_value = "10%,5%",
        help_heading = "Work"
    )]
    pub threshold: Thresholds,

    /// Fields: texels along a side of a visibility map, a power of two
    #[arg(long, value_name = "N", default_value_t = 128, help_heading = "Work")]
    pub resolution: u32,

    /// Fields: folder in which lobes fitted to skies are kept for later runs, or off [default: occlude in the user's cache folder]
    #[arg(long, value_name = "DIR|off", value_parser = cache::parse, help_heading = "Work")]
    pub cache: Option<Cache>,

    /// Fields: an eighth of their bytes, for slightly blunter shadows
    #[arg(long, help_heading = "Work")]
    pub packed: bool,

    /// Fields: integrate lobes over cells of the fields (Eq. 5) instead of taking the distance at their centres: a slow check
    #[arg(long, help_heading = "Work")]
    pub cells: bool,

    /// Fields: ask emissive surfaces by exact rays, where they would be lobes behind maps of their own
    #[arg(long, help_heading = "Work")]
    pub exact_lamps: bool,

    /// Fields: lobes that a glossy reflection is made of, 1 to 3: more have longer tails and take longer
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=3), help_heading = "Work")]
    pub gloss_lobes: u32,

    /// Fields: one bounce of diffuse light by N virtual lights, gathered at the sample points
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=65_536), help_heading = "Work")]
    pub bounce: u32,

    /// Fields: N short rays a pixel for what is too close and small for the points around it
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=1024), help_heading = "Work")]
    pub contact: u32,

    /// Fields: write PREFIX-points.png (sample points by error) and PREFIX-lobes.png (the sky), and of the point next to --pick PREFIX-map.png and PREFIX-field.png
    #[arg(long, value_name = "PREFIX", help_heading = "Output")]
    pub field_views: Option<PathBuf>,

    /// Fields: the pixel whose point --field-views shows
    #[arg(
        long,
        value_name = "X,Y",
        requires = "field_views",
        help_heading = "Output"
    )]
    pub pick: Option<Pixel>,

    /// Points that fit into --memory.
    #[arg(skip)]
    pub most_points: Option<u32>,
}

/// Fewer points than this make no picture.
const FEWEST_POINTS: u64 = 256;

impl FieldArgs {
    /// Refuses what cannot be a map, or fits into no memory.
    pub fn check(&mut self, memory: Option<u64>) -> Result<(), CliError> {
        if !self.resolution.is_power_of_two() || !(16..=1024).contains(&self.resolution) {
            return Err(CliError::input(
                format_args!("{} texels along a side", self.resolution),
                "--resolution",
                "use 16, 32, 64, 128, 256, 512 or 1024",
            ));
        }
        if let Some(limit) = memory {
            // A bit and a 16-bit distance a texel, or a packed one for four.
            let texels = u64::from(self.resolution).pow(2);
            let bytes = texels / 8 + if self.packed { texels / 4 } else { texels * 2 };
            let fit = limit / bytes;
            if fit < FEWEST_POINTS {
                return Err(CliError::input(
                    format_args!(
                        "fields of {FEWEST_POINTS} points take {} bytes at {} texels a side, the limit is {limit}",
                        FEWEST_POINTS * bytes,
                        self.resolution
                    ),
                    "--resolution",
                    format_args!(
                        "raise --memory, add --packed, or use --resolution {}",
                        (self.resolution / 2).max(16)
                    ),
                ));
            }
            self.most_points = u32::try_from(fit).ok();
        }
        Ok(())
    }

    /// The integrator's settings.
    pub fn settings(&self) -> Field {
        let usual = Field::default();
        let fit = self.most_points.unwrap_or(u32::MAX);
        Field {
            insert_above: self.threshold.insert_above,
            erase_below: self.threshold.erase_below,
            resolution: self.resolution,
            most_points: usual.most_points.min(fit),
            packed: self.packed,
            cells: self.cells,
            lamps: !self.exact_lamps,
            gloss_lobes: self.gloss_lobes,
            bounce: self.bounce,
            contact: self.contact,
            ..usual
        }
    }

    /// Writes the pictures of `--field-views`; `rename` puts a frame's number into names.
    pub fn write_views(
        &self,
        rename: impl Fn(&Path) -> PathBuf,
        sequence: &Sequence,
        geometry: &Geometry,
        view: &View,
    ) -> Result<(), CliError> {
        let Some(prefix) = &self.field_views else {
            return Ok(());
        };
        let look = Look {
            tone_map: ToneMap::None,
            exposure_ev: 0.0,
        };
        let pick = self.pick.map(|Pixel { x, y }| [x, y]);
        let prefix = rename(prefix);
        for (what, picture) in sequence.field_views(geometry, view, &self.settings(), pick) {
            let mut name = prefix.as_os_str().to_owned();
            name.push(format!("-{what}.png"));
            occlude_image::write(Path::new(&name), &picture, look)?;
        }
        Ok(())
    }

    /// The sky's lobes, from the cache if they are known; tells what they lose.
    pub fn sky(
        &self,
        args: &SkyArgs,
        picture: Option<&Picture>,
        scene: &Scene,
        context: &mut Context,
    ) -> SkyLobes {
        let environment = args.environment(picture);
        let environment = environment.unwrap_or_else(|| Environment::constant(scene.sky));
        let folder = match &self.cache {
            Some(Cache(folder)) => folder.clone(),
            None => cache::default_folder(),
        };
        let lobes = context.phase("sky", |_| {
            environment.lobes_kept(&SkyFit::default(), folder.as_deref())
        });
        let (lost, suns) = (lobes.residual, lobes.suns.len());
        context.progress.note(&format!(
            "sky: {} lobes and {suns} suns; irradiance is off by {:.2} % of its mean, {:.2} % at most",
            lobes.lobes.len(),
            100.0 * lost.irradiance,
            100.0 * lost.irradiance_worst
        ));
        context.stats.sky = Some(stats::Sky {
            lobes: lobes.lobes.len(),
            suns,
            radiance_error: lost.radiance,
            irradiance_error: lost.irradiance,
            irradiance_error_worst: lost.irradiance_worst,
        });
        lobes
    }
}
