//! Benchmarks: programs that write tables, plots and pictures.
//!
//! `cargo run --release -p bench -- SUITE [--quick] [--scenes DIR] [--out DIR]`; see `bench/README.md`.

mod common;
mod pictures;
mod rays;

use clap::{Parser, ValueEnum};
use std::path::PathBuf;
use std::process::ExitCode;

/// Measures occlude and writes results.json, report.html and raw.csv.
#[derive(Debug, Parser)]
struct Arguments {
    /// What to measure.
    suite: Suite,
    /// Fewer rays, repetitions and scenes: ends within two minutes.
    #[arg(long)]
    quick: bool,
    /// Folder of the scenes. Default: $OCCLUDE_SCENES, then ../shared/scenes.
    #[arg(long)]
    scenes: Option<PathBuf>,
    /// Where results are written.
    #[arg(long, default_value = "target/bench")]
    out: PathBuf,
    /// Only these scenes (names, comma-separated; the suite `pictures` takes files too).
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Suite {
    /// Rays per second, build time and memory against Embree.
    Rays,
    /// Error of the path tracer over time.
    Pictures,
    /// Ways of choosing among many lights, at equal time.
    ManyLights,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let scenes = arguments.scenes.clone().unwrap_or_else(|| {
        std::env::var_os("OCCLUDE_SCENES").map_or_else(|| "../shared/scenes".into(), PathBuf::from)
    });
    let setting = common::Setting {
        quick: arguments.quick,
        scenes,
        only: arguments.only,
        out: arguments.out.clone(),
    };
    let report = match arguments.suite {
        Suite::Rays => rays::run(&setting),
        Suite::Pictures => pictures::run(&setting),
        Suite::ManyLights => pictures::many_lights::run(&setting),
    };
    match report.write(&arguments.out) {
        Ok(()) => {
            println!("{}", report.text());
            println!("written to {}", arguments.out.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {}: {error}", arguments.out.display());
            ExitCode::FAILURE
        }
    }
}
