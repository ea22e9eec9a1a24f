//! `occlude merge`: shards become the result of the one-machine run.

use crate::bake;
use crate::context::Context;
use crate::error::CliError;
use crate::output;
use crate::picture::Finish;
use clap::Args;
use occlude_render::film::Film;
use occlude_render::work::{MergeError, Work};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Options of `occlude merge`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  occlude render big.glb --samples 256 --shard 0/2 -o part0.exr     (on one machine)
  occlude render big.glb --samples 256 --shard 1/2 -o part1.exr     (on another)
  occlude merge part0.exr part1.exr -o big.exr -o big.png")]
pub struct MergeArgs {
    /// All parts of one work, in any order (written by --shard)
    #[arg(required = true)]
    pub parts: Vec<PathBuf>,

    /// Picture to write: .exr, .png or .hdr; may be given several times. Layers and look are those that the parts were
    /// rendered with. Of a bake: the folder, or before the last round the file for --after
    #[arg(short, long = "output", value_name = "FILE", required = true)]
    pub output: Vec<PathBuf>,
}

/// Runs `occlude merge`.
pub fn run(args: &MergeArgs, context: &mut Context) -> Result<(), CliError> {
    if let Some(line) = bake::command_line_of(&args.parts[0]) {
        let [output] = &args.output[..] else {
            return Err(CliError::input(
                "parts of a bake become one folder or file",
                "--output",
                "give exactly one",
            ));
        };
        return bake::merge_parts(line, &args.parts, output, context);
    }
    for path in &args.output {
        output::check_picture(path)?;
    }
    let outputs: Vec<&Path> = args.output.iter().map(PathBuf::as_path).collect();
    let inputs: Vec<&Path> = args.parts.iter().map(PathBuf::as_path).collect();
    output::check_distinct(&outputs, &inputs)?;
    let parts = context.phase("load", |_| {
        args.parts
            .iter()
            .map(|path| read(path))
            .collect::<Result<Vec<_>, _>>()
    })?;
    let (film, work) = context
        .phase("work", |_| Work::merge(parts))
        .map_err(|error| {
            let (place, cure) = match &error {
                MergeError::OtherWork { part } => (*part, "merge parts of one command line"),
                MergeError::Unfinished { part, .. } => (*part, "finish it with --resume first"),
                MergeError::Coverage { missing: false, .. } => (0, "give each part once"),
                _ => (0, "give all parts I/N of the work"),
            };
            CliError::input(
                error,
                args.parts.get(place).unwrap_or(&args.parts[0]).display(),
                cure,
            )
        })?;
    let finish = Finish::from_notes(&work.notes).ok_or_else(|| {
        CliError::input(
            "not a part of a render",
            args.parts[0].display(),
            "give files written by --shard",
        )
    })?;
    context.phase("write", |_| finish.write(&film, &args.output))
}

/// Reads a part.
fn read(path: &Path) -> Result<(Film, Work), CliError> {
    read_checkpoint(path).map(|(film, work, _)| (film, work))
}

/// Reads a part or a checkpoint, and the state that a checkpoint holds beside its film.
pub fn read_checkpoint(path: &Path) -> Result<(Film, Work, Vec<u8>), CliError> {
    let unreadable = |error: std::io::Error| CliError::read(path, &error);
    let file = File::open(path).map_err(unreadable)?;
    let bytes = file.metadata().map_err(unreadable)?.len();
    Work::read_checkpoint(&mut BufReader::new(file), bytes).map_err(|error| {
        CliError::input(
            format_args!("not a part of a render ({error})"),
            path.display(),
            "give files written by --shard",
        )
    })
}
