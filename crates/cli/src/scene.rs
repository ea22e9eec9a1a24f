//! `occlude scene`: procedural scenes as glTF.

use crate::context::Context;
use crate::error::CliError;
use crate::output;
use clap::Args;
use std::path::PathBuf;

/// Options of `occlude scene`.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// cornell, furnace, apartment, conference, hairball, courtyard or city
    pub name: String,

    /// About how many triangles [default: the scene's own number]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000_000), allow_negative_numbers = true)]
    pub triangles: Option<u64>,

    /// File to write
    #[arg(short, long = "output", value_name = "FILE.glb")]
    pub output: PathBuf,
}

/// Runs `occlude scene`.
pub fn run(args: &SceneArgs, _context: &mut Context) -> Result<(), CliError> {
    output::check_all(&[&args.output], &[])?;
    Err(CliError::failed(
        "not built in yet",
        format_args!("occlude scene {}", args.name),
        "wait for the scenes",
    ))
}
