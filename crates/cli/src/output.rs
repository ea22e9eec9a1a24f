//! Files that the program writes: checked before any work, whole or absent afterwards.

use crate::error::CliError;
use occlude_image::{Format, ImageError, check_place, check_writable, write_atomically};
use std::fs;
use std::io::{self, Write};
use std::path::Path;

/// Finds out whether a file can be written, without touching what is there.
pub fn check(path: &Path) -> Result<(), CliError> {
    check_place(path).map_err(refused)
}

/// [`check`] for pictures: the name's ending must be a known format.
pub fn check_picture(path: &Path) -> Result<Format, CliError> {
    check_writable(path).map_err(refused)
}

/// Nothing has been done yet: bad usage, whatever the cause.
fn refused(error: ImageError) -> CliError {
    match error {
        ImageError::Write { path, source } => {
            CliError::input("cannot write", path.display(), source)
        }
        other => CliError::Input(other.to_string()),
    }
}

/// Refuses outputs that are inputs, too, or that are named twice.
pub fn check_distinct(outputs: &[&Path], inputs: &[&Path]) -> Result<(), CliError> {
    for (index, output) in outputs.iter().enumerate() {
        if inputs.iter().any(|input| is_same_file(input, output)) {
            return Err(CliError::input(
                "output is also an input",
                output.display(),
                "name another file",
            ));
        }
        if outputs[..index].contains(output) {
            return Err(CliError::input(
                "output named twice",
                output.display(),
                "name each file once",
            ));
        }
    }
    Ok(())
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    match (fs::canonicalize(a), fs::canonicalize(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Writes the whole file or leaves the old one as it was. Exit code 1 if it cannot: the disk is full, say.
pub fn write(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), CliError> {
    Ok(write_atomically(path, fill)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_and_outputs_are_told_apart() {
        let here = Path::new("Cargo.toml");
        let same = Path::new("./src/../Cargo.toml");
        assert!(check_distinct(&[here], &[same]).is_err());
        assert!(check_distinct(&[here, here], &[]).is_err());
        assert!(check_distinct(&[here, Path::new("b")], &[Path::new("c"), Path::new("b")]).is_ok());
    }
}
