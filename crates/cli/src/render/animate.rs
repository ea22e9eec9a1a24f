//! `occlude animate`: the animation of a scene, frame by frame, lit by fields of visibility unless said otherwise.

use super::film::Films;
use super::{RenderArgs, sequence};
use crate::context::Context;
use crate::error::CliError;

/// Runs `occlude animate`. What is more than `render --frames`: the whole animation by default, and films.
pub fn run(mut args: RenderArgs, context: &mut Context) -> Result<(), CliError> {
    args.animate = true;
    let several = args.frames.is_none_or(|frames| frames.count() > 1);
    let films = Films::take(&mut args.output, several)?;
    let result = prepared(args, &films, context);
    match result {
        Ok(done) if films.is_empty() => drop(done),
        Ok(done) => {
            context.phase("write", |_| films.finish(&done.pictures, done.fps))?;
        }
        Err(error) => {
            films.abandon();
            return Err(error);
        }
    }
    Ok(())
}

fn prepared(
    mut args: RenderArgs,
    films: &Films,
    context: &mut Context,
) -> Result<sequence::Done, CliError> {
    if !films.is_empty() && args.shard.is_some() {
        return Err(CliError::input(
            "a film needs all frames",
            "--shard",
            "write frame_####.png, and the film when all parts are there",
        ));
    }
    args.check(context.common.memory)?;
    sequence::run(args, context)
}
