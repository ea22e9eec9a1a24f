//! Options of `--integrator field`.

use crate::error::CliError;
use crate::values::Thresholds;
use clap::Args;
use occlude_render::integrator::Field;

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
}

impl FieldArgs {
    /// Refuses what cannot be a map.
    pub fn check(&self) -> Result<(), CliError> {
        if !self.resolution.is_power_of_two() || !(16..=1024).contains(&self.resolution) {
            return Err(CliError::input(
                format_args!("{} texels along a side", self.resolution),
                "--resolution",
                "use 16, 32, 64, 128, 256, 512 or 1024",
            ));
        }
        Ok(())
    }

    /// The integrator's settings.
    pub fn settings(&self) -> Field {
        Field {
            insert_above: self.threshold.insert_above,
            erase_below: self.threshold.erase_below,
            resolution: self.resolution,
            ..Field::default()
        }
    }
}
