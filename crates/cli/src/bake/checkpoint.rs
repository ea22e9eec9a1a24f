//! Unfinished work: saved now and then, and gone on with.

use super::args::{BakeArgs, WorkArgs};
use crate::context::Context;
use crate::error::CliError;
use crate::output;
use occlude_bake::rounds::Bake;
use occlude_bake::state::{Before, State, StateError};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::time::{Duration, Instant};

/// Unfinished work is saved this long after the last time at the earliest.
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(1);

/// Saving takes at most one part in so many of the time.
const CHECKPOINT_SHARE: u32 = 30;

/// What a disk is taken to write in a second before the first checkpoint has shown it, bytes.
const DISK_SPEED: f64 = 2e8;

/// The state to begin with: the checkpoint's, that of the rounds before, or an empty one.
pub fn start(
    args: &BakeArgs,
    bake: &Bake,
    fingerprint: u64,
    context: &Context,
) -> Result<State, CliError> {
    let share = args.share();
    let checkpoint = args.checkpoint_path();
    if args.resume && checkpoint.exists() {
        let state = read(&args.work, bake, &checkpoint, fingerprint)?;
        let items = occlude_render::work::shard_samples(state.header.total, share.0, share.1);
        if state.header.items != items {
            return Err(CliError::input(
                "the checkpoint belongs to another shard",
                checkpoint.display(),
                "repeat its command line, or leave out --resume to start anew",
            ));
        }
        context.progress.note(&format!(
            "going on from {}: round {} of {}",
            checkpoint.display(),
            state.header.round + 1,
            state.header.rounds
        ));
        return Ok(state);
    }
    if let Some(after) = &args.after {
        let state = read(&args.work, bake, after, fingerprint)?;
        if state.done.iter().any(|&done| done > 0) {
            return Err(CliError::input(
                "this is a part of a round, not what was made of all its parts",
                after.display(),
                "give what occlude merge wrote",
            ));
        }
        let State { header, before, .. } = state;
        let begun = bake.begin(header.round, share, before);
        return begun.map_err(|error| args.work.scratch_failed(&error));
    }
    let begun = bake.begin(0, share, Before::default());
    begun.map_err(|error| args.work.scratch_failed(&error))
}

/// Reads a state that must belong to this work.
pub fn read(
    work: &WorkArgs,
    bake: &Bake,
    path: &Path,
    fingerprint: u64,
) -> Result<State, CliError> {
    let unreadable = |error: std::io::Error| CliError::read(path, &error);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    State::read(
        &mut file,
        &work.store(),
        fingerprint,
        bake.sides(),
        |round| bake.units_of(round),
    )
    .map_err(|error| {
        let cure = match error {
            StateError::OtherWork => "repeat its command line, or start anew",
            _ => "it may be damaged: start anew",
        };
        CliError::input(error, path.display(), cure)
    })
}

/// Saves unfinished work now and then.
pub struct Saver<'a> {
    path: &'a Path,
    saved: Instant,
    period: Duration,
}

impl<'a> Saver<'a> {
    pub fn new(path: &'a Path, state: &State) -> Self {
        let bytes = State::bytes(state.header.sides, state.header.units);
        let takes = Duration::from_secs_f64(bytes as f64 / DISK_SPEED);
        Self {
            path,
            saved: Instant::now(),
            period: CHECKPOINT_PERIOD.max(takes * CHECKPOINT_SHARE),
        }
    }

    pub fn save(&self, state: &State) -> Result<(), CliError> {
        output::write(self.path, |out| state.write(out))
    }

    /// A checkpoint that cannot be written now is tried again later.
    pub fn rest(&mut self, state: &State) {
        if self.saved.elapsed() < self.period {
            return;
        }
        let began = Instant::now();
        let _ = self.save(state);
        self.saved = Instant::now();
        self.period = CHECKPOINT_PERIOD.max(began.elapsed() * CHECKPOINT_SHARE);
    }
}
