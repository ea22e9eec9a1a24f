//! `occlude merge`: shards become the result of the one-machine run.

use crate::context::Context;
use crate::error::CliError;
use crate::output::{self, Format};
use clap::Args;
use std::path::{Path, PathBuf};

/// Options of `occlude merge`.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// All parts of one work, in any order (written by --shard)
    #[arg(required = true)]
    pub parts: Vec<PathBuf>,

    /// Picture to write: .exr, .png or .hdr; may be given several times
    #[arg(short, long = "output", value_name = "FILE", required = true)]
    pub output: Vec<PathBuf>,
}

/// Runs `occlude merge`.
pub fn run(args: &MergeArgs, _context: &mut Context) -> Result<(), CliError> {
    for path in &args.output {
        Format::of(path)?;
    }
    let outputs: Vec<&Path> = args.output.iter().map(PathBuf::as_path).collect();
    let parts: Vec<&Path> = args.parts.iter().map(PathBuf::as_path).collect();
    output::check_all(&outputs, &parts)?;
    for path in &args.parts {
        std::fs::metadata(path).map_err(|error| CliError::read(path, &error))?;
    }
    Err(CliError::failed(
        "not built in yet",
        "occlude merge",
        "wait for films",
    ))
}
