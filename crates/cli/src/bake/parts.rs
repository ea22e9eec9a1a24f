//! Parts of a round from many machines: the command line that they remember, and what they add up to.

use super::args::WorkArgs;
use super::bake;
use super::checkpoint::read;
use crate::context::Context;
use crate::error::CliError;
use occlude_bake::rounds::Bake;
use occlude_bake::state::{State, read_header};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// All parts of a round together.
pub fn merge(
    work: &WorkArgs,
    bake: &Bake,
    parts: &[PathBuf],
    fingerprint: u64,
) -> Result<State, CliError> {
    let mut states = Vec::new();
    for path in parts {
        let state = read(work, bake, path, fingerprint)?;
        states.push((path, state));
    }
    let first = states.first().map(|(_, state)| state.header.clone());
    states.sort_by_key(|(_, state)| (state.header.items.start, state.header.items.end));
    let mut whole: Option<State> = None;
    for (path, state) in states {
        let refuse = |what: &str, cure: &str| Err(CliError::input(what, path.display(), cure));
        if first.as_ref().is_some_and(|first| {
            (first.round, first.total) != (state.header.round, state.header.total)
        }) {
            return refuse("a part of another round", "merge the parts of one round");
        }
        if !state.is_complete() {
            return refuse("an unfinished part", "finish it with --resume first");
        }
        let end = whole.as_ref().map_or(0, |whole| whole.header.items.end);
        if state.header.items.start < end {
            return refuse("a part that is given twice", "give each part once");
        }
        if state.header.items.start > end {
            return refuse(
                "the part before this one is missing",
                "give all parts I/N of the round",
            );
        }
        match &mut whole {
            None => whole = Some(state),
            Some(whole) => {
                whole.header.items.end = state.header.items.end;
                if whole.sums.merge(&state.sums).is_err() {
                    return refuse("a part of another work", "merge parts of one command line");
                }
            }
        }
    }
    let mut whole = whole.ok_or_else(|| CliError::input("no parts", "PARTS", "name some"))?;
    if whole.header.items.end != whole.header.total {
        return Err(CliError::input(
            "the last part is missing",
            "PARTS",
            "give all parts I/N of the round",
        ));
    }
    let total = whole.header.total;
    whole.done.fill(total);
    Ok(whole)
}

/// Merges the parts of a round into the rounds so far, or, after the last round, into what one machine would have written.
pub fn merge_parts(
    line: Vec<String>,
    parts: &[PathBuf],
    output: &Path,
    context: &mut Context,
) -> Result<(), CliError> {
    let Some((mut args, common)) = crate::bake_command(line) else {
        return Err(CliError::input(
            "not a part of a bake by this version of the program",
            parts[0].display(),
            "give files written by occlude bake --shard",
        ));
    };
    (context.common.seed, context.common.memory) = (common.seed, common.memory);
    args.output = output.to_path_buf();
    (args.shard, args.after, args.checkpoint, args.resume) = (None, None, None, false);
    // Whether a file or a folder is written is known when the parts have been read.
    args.work.check()?;
    bake(&args, context, parts)
}

/// The command line that a part was made with, if the file is a part of a bake.
pub fn command_line_of(part: &Path) -> Option<Vec<String>> {
    let mut file = BufReader::new(File::open(part).ok()?);
    let header = read_header(&mut file).ok()?;
    serde_json::from_str(&header.notes).ok()
}

/// This command line, to travel with parts.
pub fn notes() -> Result<String, CliError> {
    let line: Vec<String> = std::env::args_os()
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect();
    serde_json::to_string(&line)
        .map_err(|error| CliError::failed("cannot encode the command line", "bake", error))
}
