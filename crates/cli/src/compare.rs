//! `occlude compare`: how two pictures differ.

use crate::context::Context;
use crate::error::CliError;
use crate::output;
use clap::{Args, ValueEnum};
use occlude_image::metrics::{self, Comparison};
use occlude_image::{Encoding, Format, Limits, Named, Opened, read, write_map, write_report};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `occlude compare`.
#[derive(Debug, Args)]
#[command(
    after_help = "FLIP is HDR-FLIP for EXR and HDR, LDR-FLIP if either picture is a PNG. All else is measured in linear light.\n\
                  In JSON, null stands for what has no finite value, such as the PSNR of equal pictures."
)]
pub struct CompareArgs {
    /// First picture: .exr, .hdr or .png
    pub a: PathBuf,

    /// Second picture, of the same size
    pub b: PathBuf,

    /// Which of the two is the truth
    #[arg(long, value_enum, ignore_case = true, default_value_t = Side::B, value_name = "A|B")]
    pub reference_is: Side,

    /// Print JSON
    #[arg(long)]
    pub json: bool,

    /// Write a picture of where they differ: .png for FLIP in colours, .exr for the signed difference
    #[arg(long, value_name = "DIFF.png")]
    pub map: Option<PathBuf>,

    /// Write a page with both pictures, the difference and the numbers
    #[arg(long, value_name = "OUT.html")]
    pub report: Option<PathBuf>,
}

/// One of the two pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Side {
    /// The first
    A,
    /// The second
    B,
}

/// Runs `occlude compare`.
pub fn run(args: &CompareArgs, context: &mut Context) -> Result<(), CliError> {
    let outputs: Vec<_> = [&args.map, &args.report]
        .into_iter()
        .flatten()
        .map(PathBuf::as_path)
        .collect();
    if let Some(map) = &args.map
        && output::check_picture(map)? == Format::Hdr
    {
        return Err(CliError::input(
            "a difference may be negative, which HDR cannot hold",
            map.display(),
            "end the name in .png or .exr",
        ));
    }
    if let Some(report) = &args.report {
        output::check(report)?;
    }
    output::check_distinct(&outputs, &[&args.a, &args.b])?;
    // From here on, "a" is what is measured and "b" is the truth.
    let (path_a, path_b) = match args.reference_is {
        Side::A => (&args.b, &args.a),
        Side::B => (&args.a, &args.b),
    };
    let (a, b) = context.phase("load", |context| {
        Ok::<_, CliError>((open(path_a, context)?, open(path_b, context)?))
    })?;
    let encoding = match (a.encoding, b.encoding) {
        (Encoding::SceneLinear, Encoding::SceneLinear) => Encoding::SceneLinear,
        _ => Encoding::Display,
    };
    let compared = context.phase("work", |_| {
        metrics::compare(&a.picture, &b.picture, encoding)
    })?;
    context.phase("write", |_| {
        if let Some(path) = &args.map {
            write_map(path, &a.picture, &b.picture, &compared)?;
        }
        if let Some(path) = &args.report {
            let (name_a, name_b) = (file_name(path_a), file_name(path_b));
            let (a, b) = (
                Named {
                    name: &name_a,
                    picture: &a.picture,
                },
                Named {
                    name: &name_b,
                    picture: &b.picture,
                },
            );
            write_report(path, a, b, encoding, &compared)?;
        }
        Ok::<_, CliError>(())
    })?;
    let mut numbers = compared.numbers;
    if args.reference_is == Side::A {
        // Means keep the letters of the command line.
        std::mem::swap(&mut numbers.mean_a, &mut numbers.mean_b);
    }
    print(&text(&numbers, encoding, args.json))
}

fn open(path: &Path, context: &Context) -> Result<Opened, CliError> {
    let limits = match context.common.memory {
        Some(max_bytes) => Limits { max_bytes },
        None => Limits::default(),
    };
    let opened = read(path, &limits)?;
    if opened.repaired > 0 {
        context.warn(format_args!(
            "{} {} NaN or infinity, which counts as 0: {}",
            opened.repaired,
            if opened.repaired == 1 {
                "pixel holds"
            } else {
                "pixels hold"
            },
            path.display()
        ));
    }
    Ok(opened)
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

fn text(numbers: &Comparison, encoding: Encoding, json: bool) -> String {
    if json {
        // Plain numbers, no maps: this cannot fail.
        return serde_json::to_string(numbers).unwrap_or_default();
    }
    let kind = match encoding {
        Encoding::SceneLinear => "HDR",
        Encoding::Display => "LDR",
    };
    let mean = |c: [f64; 3]| format!("{:.6} {:.6} {:.6}", c[0], c[1], c[2]);
    [
        ("size", format!("{}x{}", numbers.width, numbers.height)),
        ("FLIP", format!("{:.6} ({kind})", numbers.flip)),
        ("relMSE", format!("{:.6e}", numbers.relmse)),
        ("MSE", format!("{:.6e}", numbers.mse)),
        ("PSNR", format!("{:.3} dB", numbers.psnr)),
        ("SSIM", format!("{:.6}", numbers.ssim)),
        ("energy change", format!("{:.6}", numbers.energy_change)),
        ("mean A", mean(numbers.mean_a)),
        ("mean B", mean(numbers.mean_b)),
    ]
    .map(|(name, value)| format!("{name:<14}{value}"))
    .join("\n")
}

/// Prints a result. A reader that went away (`| head`) is no failure.
fn print(text: &str) -> Result<(), CliError> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(CliError::failed("cannot write", "stdout", error))
        }
        _ => Ok(()),
    }
}
