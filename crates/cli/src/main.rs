//! The `occlude` command: renders glTF and OBJ scenes, compares pictures, looks into files.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 the work failed or ended incomplete, 2 bad usage
//! or bad input, 130 cancelled by Ctrl-C or SIGTERM.

mod bake;
mod cache;
mod compare;
mod context;
mod error;
mod inspect;
mod merge;
mod output;
mod picture;
mod progress;
mod render;
mod scene;
mod signals;
mod sky;
mod stats;
mod values;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use context::{Common, Context};
use error::CliError;
use std::io::Write;
use std::process::ExitCode;
use std::time::Instant;

/// Package version and commit.
const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("OCCLUDE_COMMIT"), ")");

/// Renders glTF and OBJ scenes by path tracing.
///
/// Results go to stdout, messages to stderr. Exit codes: 0 done, 1 failed or incomplete, 2 bad usage or input, 130 cancelled.
#[derive(Debug, Parser)]
#[command(name = "occlude", version = VERSION, arg_required_else_help = true, args_override_self = true, max_term_width = 110)]
#[command(after_help = "Start with: occlude render SCENE.glb -o picture.png")]
struct Cli {
    #[command(subcommand)]
    command: Command,

    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Render a scene to a picture (EXR, PNG, HDR)
    Render(Box<render::RenderArgs>),
    /// Bake the light that falls on surfaces into light maps beside a copy of the scene
    Bake(Box<bake::BakeArgs>),
    /// Tell what a bake would take: texels, memory, time
    Plan(Box<bake::PlanArgs>),
    /// Play a scene's animation into pictures or a film, lit by fields of visibility
    #[command(mut_arg("integrator", |argument| argument.default_value("field")))]
    #[command(after_help = "Examples:
  occlude animate walk.glb --environment sky.hdr -o walk_####.png
  occlude animate walk.glb --environment sky.hdr --frames 0..47 --size 640x480 -o walk.webp
  occlude animate walk.glb --environment sky.hdr --integrator path --max-depth 1 --frames 6..6 -o frame6.exr")]
    Animate(Box<render::RenderArgs>),
    /// Tell what is in a scene, with warnings
    Inspect(inspect::InspectArgs),
    /// Measure how two pictures differ
    Compare(compare::CompareArgs),
    /// Write one of the built-in procedural scenes as glTF
    Scene(scene::SceneArgs),
    /// Merge the shards of one work into its picture
    Merge(merge::MergeArgs),
}

fn main() -> ExitCode {
    let began = Instant::now();
    std::panic::set_hook(Box::new(report_panic));
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let result = std::panic::catch_unwind(|| run(cli, began));
    match result {
        Ok(Ok(())) => ExitCode::SUCCESS,
        Ok(Err(error)) => {
            eprintln!("{}", error.line());
            ExitCode::from(error.exit_code())
        }
        Err(_) => ExitCode::FAILURE, // The hook has told about it.
    }
}

fn run(cli: Cli, began: Instant) -> Result<(), CliError> {
    let name = match &cli.command {
        Command::Render(_) => "render",
        Command::Animate(_) => "animate",
        Command::Bake(_) => "bake",
        Command::Plan(_) => "plan",
        Command::Inspect(_) => "inspect",
        Command::Compare(_) => "compare",
        Command::Scene(_) => "scene",
        Command::Merge(_) => "merge",
    };
    let mut context = Context::new(name, cli.common, began)?;
    let result = match cli.command {
        Command::Render(args) => render::run(*args, &mut context),
        Command::Animate(args) => render::animate(*args, &mut context),
        Command::Bake(args) => bake::run(&args, &mut context),
        Command::Plan(args) => bake::plan(&args, &mut context),
        Command::Inspect(args) => inspect::run(&args, &mut context),
        Command::Compare(args) => compare::run(&args, &mut context),
        Command::Scene(args) => scene::run(&args, &mut context),
        Command::Merge(args) => merge::run(&args, &mut context),
    };
    context.finish(result)
}

/// A command line of `occlude bake`, as parts remember it.
fn bake_command(line: Vec<String>) -> Option<(bake::BakeArgs, Common)> {
    let cli = Cli::try_parse_from(line).ok()?;
    match cli.command {
        Command::Bake(args) => Some((*args, cli.common)),
        _ => None,
    }
}

/// Help and version go to stdout; anything else becomes one line.
fn usage(error: &clap::Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            let _ = error.print();
            ExitCode::SUCCESS
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            ExitCode::from(2)
        }
        _ => {
            let error = CliError::Input(usage_line(&error.render().to_string()));
            eprintln!("{}", error.line());
            ExitCode::from(error.exit_code())
        }
    }
}

/// Joins the paragraphs of clap's message up to the usage, and ends it with what to do.
fn usage_line(text: &str) -> String {
    let message = text.split("\n\nUsage:").next().unwrap_or(text);
    let message = message
        .split("\n\nFor more information")
        .next()
        .unwrap_or(message);
    let words: Vec<&str> = message.split_whitespace().collect();
    let message = words.join(" ");
    let message = message
        .strip_prefix("error: ")
        .unwrap_or(&message)
        .trim_end_matches('.');
    let command = std::env::args().nth(1).filter(|arg| !arg.starts_with('-'));
    let help = match command {
        Some(command)
            if [
                "render", "animate", "bake", "plan", "inspect", "compare", "scene", "merge",
            ]
            .contains(&command.as_str()) =>
        {
            format!("occlude {command} --help")
        }
        _ => "occlude --help".to_owned(),
    };
    format!("{message}: see {help}")
}

/// A panic is a bug of this program: one line that helps to report it.
fn report_panic(info: &std::panic::PanicHookInfo<'_>) {
    let place = info
        .location()
        .map(|l| format!("{}:{}", l.file(), l.line()))
        .unwrap_or_default();
    let payload = info.payload();
    let message = (payload.downcast_ref::<&str>().copied())
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    let text = format!(
        "bug in occlude {VERSION}, panicked: {place}: {message}: please report it together with the command and the scene"
    );
    let _ = writeln!(std::io::stderr(), "{}", error::one_line("error: ", &text));
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_option_is_explained() {
        for command in Cli::command().get_subcommands() {
            for argument in command.get_arguments() {
                assert!(
                    argument.get_help().is_some(),
                    "{} {}",
                    command.get_name(),
                    argument.get_id()
                );
            }
        }
    }

    #[test]
    fn of_a_repeated_option_the_last_counts_but_outputs_add_up() {
        let line =
            "occlude render a.glb --seed 7 --seed 8 --samples 2 --samples 3 -o a.exr -o b.png";
        let cli = Cli::try_parse_from(line.split(' ')).unwrap();
        let Command::Render(args) = cli.command else {
            panic!("not render");
        };
        assert_eq!((cli.common.seed, args.samples), (8, Some(3)));
        assert_eq!(args.output.len(), 2);
    }

    #[test]
    fn clap_messages_become_one_line() {
        let error = Cli::try_parse_from(["occlude", "render"]).unwrap_err();
        let line = usage_line(&error.render().to_string());
        assert!(
            line.starts_with("the following required arguments were not provided: <SCENE>: see "),
            "{line}"
        );
    }
}
