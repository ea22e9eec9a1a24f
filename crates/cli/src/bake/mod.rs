//! `occlude bake`: a scene becomes the same scene with light maps. `occlude plan`: what that would take.
//!
//! [`setup`] lays a scene out and chooses how to gather, by [`settings`] from [`args`] and the [`subject`] that the files hold; this module
//! then gathers round by round, saving [`checkpoint`]s; [`export`] writes what became of it; [`parts`] are of many machines.

mod args;
mod checkpoint;
mod export;
mod parts;
mod plan;
mod settings;
mod setup;
mod subject;

pub use args::{BakeArgs, PlanArgs};
pub use parts::{command_line_of, merge_parts};
pub use plan::plan;

use crate::context::Context;
use crate::error::CliError;
use crate::{output, signals, stats};
use args::WorkArgs;
use checkpoint::{Saver, start};
use occlude_bake::rounds::{Bake, Ended, Report, RoundKind, Stop};
use occlude_bake::state::State;
use serde_json::json;
use setup::{Setup, prepared, too_little_memory};
use std::path::PathBuf;
use std::time::Instant;

/// Runs `occlude bake`.
pub fn run(args: &BakeArgs, context: &mut Context) -> Result<(), CliError> {
    args.check()?;
    bake(args, context, &[])
}

/// Bakes; goes on from the finished `parts` of a round, if there are any.
pub fn bake(args: &BakeArgs, context: &mut Context, parts: &[PathBuf]) -> Result<(), CliError> {
    prepared(&args.work, context, false, |setup, bake, context| {
        if let Some(limit) = context.common.memory
            && setup.floor > limit
        {
            return Err(too_little_memory(
                setup.floor,
                limit,
                &args.work,
                setup.loaded,
                &setup.built.atlas,
            ));
        }
        gather(args, setup, bake, context, parts)
    })
}

/// Gathers what is left to gather, and writes what became of it.
fn gather(
    args: &BakeArgs,
    setup: &Setup,
    bake: &Bake,
    context: &mut Context,
    parts: &[PathBuf],
) -> Result<(), CliError> {
    let checkpoint = args.checkpoint_path();
    if parts.is_empty() && args.shard.is_none() && export::is_up_to_date(args, setup) {
        context.progress.note(&format!(
            "{}: nothing has changed since it was baked",
            args.output.display()
        ));
        context.stats.bake = Some(stats::Bake::unchanged(&setup.built.atlas));
        return Ok(());
    }
    let state = if parts.is_empty() {
        start(args, bake, setup.fingerprint, context)?
    } else {
        parts::merge(&args.work, bake, parts, setup.fingerprint)?
    };
    let mut report = Report::default();
    let mut saver = Saver::new(&checkpoint, &state);
    context.progress.expect(args.work.time_limit);
    signals::graceful();
    let (state, ended) = context.phase("work", |context| {
        rounds(
            args,
            bake,
            state,
            !parts.is_empty(),
            context,
            &mut report,
            &mut saver,
        )
    })?;
    context.progress.finish();
    let atlas = &setup.built.atlas;
    context.stats.bake = Some(stats::Bake::new(atlas, &report, &state, ended.name()));
    if ended == Ended::Cancel {
        saver.save(&state)?;
        return Err(CliError::Cancelled(format!(
            "round {} of {} is not finished: {}: go on with the same command and --resume",
            state.header.round + 1,
            state.header.rounds,
            checkpoint.display()
        )));
    }
    let whole =
        args.shard.is_none() && bake.is_last(&state) && (parts.is_empty() || state.is_complete());
    let (round, rounds) = (state.header.round, state.header.rounds);
    if whole {
        context.phase("write", |context| {
            export::write(args, setup, bake, &state, context)
        })?;
    } else {
        context.phase("write", |_| {
            output::write(&args.output, |out| state.write(out))
        })?;
    }
    if !parts.is_empty() {
        // After the last round there is none to do.
        let done = if whole { rounds } else { round };
        println!(
            "{}",
            json!({"finished": whole, "rounds_done": done, "rounds": rounds})
        );
    }
    let _ = std::fs::remove_file(&checkpoint);
    context.progress.note(&format!(
        "{}: {:.1} s of gathering",
        args.output.display(),
        context.stats.seconds.work
    ));
    let mut lost = setup.built.problems.iter().filter(|problem| problem.lost);
    match (lost.next(), lost.count()) {
        (Some(first), others) if whole => Err(CliError::failed(
            format_args!(
                "{} meshes have no light map, the others have theirs",
                others + 1
            ),
            &first.mesh,
            "give them a TEXCOORD_1, or repair them",
        )),
        _ => Ok(()),
    }
}

/// Gathers until the end, or the end of a shard's part of its round. `merged`: the state is a whole round made of parts.
fn rounds(
    args: &BakeArgs,
    bake: &Bake,
    mut state: State,
    merged: bool,
    context: &Context,
    report: &mut Report,
    saver: &mut Saver,
) -> Result<(State, Ended), CliError> {
    let failed = |error: std::io::Error| args.work.scratch_failed(&error);
    let share = args.share();
    if merged {
        if !bake.is_last(&state) {
            state = bake.next_round(state, share).map_err(failed)?;
        }
        return Ok((state, Ended::Samples));
    }
    let began = Instant::now();
    let mut stopped = Ended::Samples;
    loop {
        let stop = stop(&args.work, bake, &state, began);
        let mut at_rest = |state: &State| saver.rest(state);
        let ended = bake
            .run_round(&mut state, stop, &context.job, report, &mut at_rest)
            .map_err(failed)?;
        if ended != Ended::Samples {
            stopped = ended;
        }
        if ended == Ended::Cancel || args.shard.is_some() || bake.is_last(&state) {
            return Ok((state, stopped));
        }
        state = bake.next_round(state, share).map_err(failed)?;
        saver.rest(&state);
    }
}

/// When a round ends early. Of the time, earlier rounds take what the fixed numbers of items would give them.
fn stop(work: &WorkArgs, bake: &Bake, state: &State, began: Instant) -> Stop {
    let last = bake.is_last(state);
    let rest = bake.rounds().len() as u32 - state.header.round;
    let kind = bake.rounds()[state.header.round as usize].kind;
    let is_direct = matches!(kind, RoundKind::Direct | RoundKind::Spots);
    Stop {
        time_limit: work.time_limit.map(|limit| {
            let left = limit.saturating_sub(began.elapsed());
            if last {
                left
            } else if is_direct {
                left / 4
            } else {
                left / (rest + 1)
            }
        }),
        // Independent errors add up by their squares; earlier ones are averaged before they show.
        noise: work
            .noise
            .map(f64::from)
            .map(|noise| match (last, is_direct) {
                (true, true) => noise,
                (true, false) => 0.85 * noise,
                (false, true) => 0.5 * noise,
                (false, false) => noise,
            }),
    }
}
