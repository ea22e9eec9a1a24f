//! Benchmarks: programs that write tables, plots and pictures.
//!
//! `cargo run --release -p bench -- SUITE [--quick] [--scenes DIR] [--out DIR]`; see `bench/README.md`.

mod bake;
mod common;
mod dynamic;
mod pictures;
mod quantized;
mod rays;
mod records;

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
    /// Only these parts (comma-separated; the suite `quantized` has some).
    #[arg(long, value_delimiter = ',')]
    topics: Vec<String>,
    /// Size of pictures, such as 640x400 (the suite `quantized`).
    #[arg(long, value_parser = size)]
    size: Option<[u32; 2]>,
    /// Samples a pixel (comma-separated; the suite `quantized`).
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=65536))]
    samples: Vec<u32>,
    /// Repetitions of what is timed (the suite `quantized`).
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repetitions: Option<u32>,
}

/// Reads `WIDTHxHEIGHT`.
fn size(text: &str) -> Result<[u32; 2], String> {
    let number = |text: &str| text.parse().ok().filter(|n| (8..=16384).contains(n));
    text.split_once('x')
        .and_then(|(width, height)| Some([number(width)?, number(height)?]))
        .ok_or_else(|| "write WIDTHxHEIGHT, 8 to 16384 each".to_owned())
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Suite {
    /// Rays per second, build time and memory against Embree.
    Rays,
    /// Error of the path tracer over time.
    Pictures,
    /// Ways of choosing among many lights, at equal time.
    ManyLights,
    /// Quantized visibility against exact rays: time, rays, error.
    Quantized,
    /// Fields of visibility on moving scenes: rays, times, errors.
    Dynamic,
    /// Ray bundles against rays: exchanges, set-up, tables of the paper, a town of 45 million texels.
    Bake,
    /// Visibility records against exact rays: fills, rates, time, error.
    Records,
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
        topics: arguments.topics,
        size: arguments.size,
        samples: arguments.samples,
        repetitions: arguments.repetitions.map(|n| n as usize),
        out: arguments.out.clone(),
    };
    let report = match arguments.suite {
        Suite::Rays => rays::run(&setting),
        Suite::Pictures => pictures::run(&setting),
        Suite::ManyLights => pictures::many_lights::run(&setting),
        Suite::Quantized => quantized::run(&setting),
        Suite::Dynamic => dynamic::run(&setting),
        Suite::Bake => bake::run(&setting),
        Suite::Records => records::run(&setting),
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
