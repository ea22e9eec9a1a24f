//! What every command shares: global options, the clock, progress, statistics and the cancel flag.

use crate::error::{CliError, warn};
use crate::progress::Progress;
use crate::stats::Stats;
use crate::{output, signals, values};
use clap::Args;
use occlude_render::job::Job;
use occlude_scene::Warning;
use std::path::PathBuf;
use std::time::Instant;

/// Warnings about one file that are printed before the rest is only counted.
const MAX_WARNINGS: usize = 20;

/// Options of every command.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Machine")]
pub struct Common {
    /// Threads that work [default: all cores]; the result does not depend on it
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), allow_negative_numbers = true)]
    pub threads: Option<u16>,

    /// Memory that may be used, such as 4GiB or 512MiB [default: unlimited]; a scene that needs more is refused
    #[arg(long, global = true, value_name = "SIZE", value_parser = values::bytes)]
    pub memory: Option<u64>,

    /// Seed of everything random; same seed, same bytes
    #[arg(long, global = true, value_name = "N", default_value_t = 0)]
    pub seed: u64,

    /// Write times, counts and memory as JSON
    #[arg(long, global = true, value_name = "FILE.json")]
    pub stats: Option<PathBuf>,

    /// No progress, even on a terminal (errors and warnings stay)
    #[arg(long, short, global = true)]
    pub quiet: bool,
}

/// One run of one command.
pub struct Context {
    /// Global options.
    pub common: Common,
    /// The line on stderr.
    pub progress: Progress,
    /// What goes to `--stats`.
    pub stats: Stats,
    /// Watched by the progress line, cancelled by Ctrl-C and SIGTERM.
    pub job: Job,
    began: Instant,
}

impl Context {
    /// Checks the global options and prepares threads, signals and progress.
    pub fn new(command: &'static str, common: Common, began: Instant) -> Result<Self, CliError> {
        if let Some(path) = &common.stats {
            output::check(path)?;
        }
        let threads = common.threads.map_or(0, usize::from);
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .map_err(|error| CliError::failed("cannot start threads", "--threads", error))?;
        let mut job = Job::new();
        job.memory_limit = common.memory;
        signals::install(&job);
        let stats = Stats::new(
            command,
            common.seed,
            rayon::current_num_threads(),
            common.memory,
        );
        let progress = Progress::new(&job, common.quiet);
        Ok(Self {
            common,
            progress,
            stats,
            job,
            began,
        })
    }

    /// Runs a phase: shown on the terminal, timed into the statistics.
    pub fn phase<T>(&mut self, name: &'static str, work: impl FnOnce(&mut Self) -> T) -> T {
        self.job.start_phase(name, 0);
        let began = Instant::now();
        let result = work(self);
        let seconds = began.elapsed().as_secs_f64();
        let times = &mut self.stats.seconds;
        *times.phases.entry(name).or_default() += seconds;
        match name {
            "load" => times.load += seconds,
            "build" => times.build += seconds,
            "work" => times.work += seconds,
            "write" => times.write += seconds,
            _ => {}
        }
        result
    }

    /// When the program was started.
    pub fn began(&self) -> Instant {
        self.began
    }

    /// Prints a warning.
    pub fn warn(&self, text: impl std::fmt::Display) {
        self.progress.suspend(|| warn(text));
    }

    /// Prints the warnings of a loader, the first of them at least.
    pub fn warn_all(&self, warnings: &[Warning]) {
        for warning in warnings.iter().take(MAX_WARNINGS) {
            if warning.place.is_empty() {
                self.warn(&warning.what);
            } else {
                self.warn(format_args!("{}: {}", warning.what, warning.place));
            }
        }
        if warnings.len() > MAX_WARNINGS {
            self.warn(format_args!(
                "{} more warnings: see all with occlude inspect --json",
                warnings.len() - MAX_WARNINGS
            ));
        }
    }

    /// Ends the run: statistics are written also when the work was cancelled or failed.
    pub fn finish(mut self, result: Result<(), CliError>) -> Result<(), CliError> {
        self.progress.finish();
        let written = match &self.common.stats {
            Some(path) if !matches!(result, Err(CliError::Input(_))) => {
                self.stats.write(path, self.began)
            }
            _ => Ok(()),
        };
        result.and(written)
    }
}
