//! Errors as the user sees them: one line, `error: WHAT: WHERE: what to do`, and an exit code.

use occlude_image::ImageError;
use occlude_scene::SceneError;
use std::fmt::Display;
use std::path::Path;

/// Longest line that is printed; longer ones lose their middle.
const MAX_CHARS: usize = 360;

/// Why a command ended early.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CliError {
    /// Bad usage or bad input: exit code 2.
    Input(String),
    /// The work failed or ended incomplete: exit code 1.
    Failed(String),
    /// Ctrl-C or SIGTERM: exit code 130. What was done has been written; the text says where.
    Cancelled(String),
}

impl CliError {
    /// Bad usage or bad input: what is wrong, where, and what the user can do.
    pub fn input(what: impl Display, place: impl Display, cure: impl Display) -> Self {
        Self::Input(format!("{what}: {place}: {cure}"))
    }

    /// The work failed: what went wrong, where, and what the user can do.
    pub fn failed(what: impl Display, place: impl Display, cure: impl Display) -> Self {
        Self::Failed(format!("{what}: {place}: {cure}"))
    }

    /// A file that the user named cannot be read.
    pub fn read(path: &Path, source: &std::io::Error) -> Self {
        let cure = match source.kind() {
            std::io::ErrorKind::NotFound => "no such file: check the name",
            std::io::ErrorKind::PermissionDenied => "permission denied: check who may read it",
            std::io::ErrorKind::IsADirectory => "it is a folder: name a file in it",
            _ => return Self::input("cannot read", path.display(), source),
        };
        Self::input("cannot read", path.display(), cure)
    }

    /// The exit code of the contract.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 2,
            Self::Failed(_) => 1,
            Self::Cancelled(_) => 130,
        }
    }

    /// The line for stderr.
    pub fn line(&self) -> String {
        match self {
            Self::Input(text) | Self::Failed(text) => one_line("error: ", text),
            Self::Cancelled(text) => one_line("cancelled: ", text),
        }
    }
}

impl From<SceneError> for CliError {
    fn from(error: SceneError) -> Self {
        match &error {
            SceneError::Read { path, source } => Self::read(path, source),
            _ => Self::Input(error.to_string()),
        }
    }
}

impl From<ImageError> for CliError {
    fn from(error: ImageError) -> Self {
        match &error {
            ImageError::Read { path, source } => Self::read(path, source),
            ImageError::Write { path, source } => Self::failed(
                "cannot write",
                path.display(),
                format!("{source}; a file that was there is unchanged"),
            ),
            _ => Self::Input(error.to_string()),
        }
    }
}

/// Prints a warning: one line on stderr.
pub fn warn(text: impl Display) {
    eprintln!("{}", one_line("warning: ", &text.to_string()));
}

/// One printable line of bounded length: control characters (file names and file contents may hold any) become spaces.
pub fn one_line(prefix: &str, text: &str) -> String {
    let clean: Vec<char> = text
        .trim()
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    let mut line = prefix.to_owned();
    if clean.len() <= MAX_CHARS {
        line.extend(clean);
    } else {
        let half = MAX_CHARS / 2;
        line.extend(&clean[..half]);
        line.push_str(" ... ");
        line.extend(&clean[clean.len() - half..]);
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn codes_are_those_of_the_contract() {
        assert_eq!(CliError::input("a", "b", "c").exit_code(), 2);
        assert_eq!(CliError::failed("a", "b", "c").exit_code(), 1);
        assert_eq!(CliError::Cancelled(String::new()).exit_code(), 130);
        assert_eq!(
            CliError::input("bad size", "--size", "try 640x480").line(),
            "error: bad size: --size: try 640x480"
        );
    }

    proptest! {
        #[test]
        fn any_text_becomes_one_short_line(text in any::<String>()) {
            let line = one_line("error: ", &text.repeat(20));
            prop_assert!(!line.contains(|c: char| c.is_control()));
            prop_assert!(line.starts_with("error: "));
            prop_assert!(line.chars().count() <= 400);
        }
    }
}
