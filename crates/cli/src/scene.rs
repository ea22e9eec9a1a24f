//! `occlude scene`: procedural scenes as glTF.

use crate::context::Context;
use crate::error::CliError;
use crate::inspect::counts;
use crate::output;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use occlude_scene::procedural::{self, Name};
use occlude_scene::{WriteError, write_glb};
use std::io;
use std::path::PathBuf;

/// Options of `occlude scene`.
#[derive(Debug, Args)]
#[command(
    after_help = "The same name, --triangles and --seed give the same bytes on every machine."
)]
pub struct SceneArgs {
    /// Which scene
    #[arg(value_parser = names())]
    pub name: Name,

    /// About how many triangles, every instance counted [default: the scene's own number]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000_000), allow_negative_numbers = true)]
    pub triangles: Option<u64>,

    /// File to write
    #[arg(short, long = "output", value_name = "FILE.glb")]
    pub output: PathBuf,
}

fn names() -> impl TypedValueParser<Value = Name> {
    let values = Name::ALL
        .iter()
        .map(|name| PossibleValue::new(name.as_str()).help(name.about()));
    PossibleValuesParser::new(values).try_map(|text| text.parse::<Name>())
}

/// Runs `occlude scene`.
pub fn run(args: &SceneArgs, context: &mut Context) -> Result<(), CliError> {
    if args
        .output
        .extension()
        .is_none_or(|e| !e.eq_ignore_ascii_case("glb"))
    {
        return Err(CliError::input(
            "not a GLB file name",
            args.output.display(),
            "end the name in .glb",
        ));
    }
    output::check(&args.output)?;
    let seed = context.common.seed;
    let scene = context.phase("build", |_| {
        procedural::build(args.name, args.triangles, seed)
    });
    context.stats.scene = Some(args.name.to_string());
    context.stats.scene_counts = Some(counts(&scene));
    context.phase("write", |_| {
        output::write(&args.output, |mut out| {
            write_glb(&scene, &mut out).map_err(|error| match error {
                WriteError::Io(error) => error,
                other => io::Error::other(other.to_string()),
            })
        })
    })
}
