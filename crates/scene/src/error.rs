//! What can be wrong with a file.

use std::path::{Path, PathBuf};

/// Why a scene could not be loaded. The text is one line: what, where, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The file (or one that it refers to) cannot be read.
    #[error("cannot read: {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("{what}: {}{}: {cure}", path.display(), if place.is_empty() { String::new() } else { format!(", {place}") })]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Where in the file: node, mesh, accessor, line. May be empty.
        place: String,
        /// What is wrong.
        what: String,
        /// What the user can do about it.
        cure: String,
    },
    /// The file requires an extension that is not supported.
    #[error("extension {name} is required but not supported: {}: {cure}", path.display())]
    Extension {
        /// The file.
        path: PathBuf,
        /// The extension.
        name: String,
        /// What the user can do about it.
        cure: String,
    },
    /// Loading would take more memory than allowed.
    #[error("needs {needed} bytes, the limit is {limit}: {}: raise --memory or simplify the scene", path.display())]
    Memory {
        /// The file.
        path: PathBuf,
        /// Bytes needed, at least.
        needed: u64,
        /// Bytes allowed.
        limit: u64,
    },
}

/// Something in a file that was repaired or ignored; loading went on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Where: file, node, mesh, material. May be empty.
    pub place: String,
    /// What was found and what was done about it, one line.
    pub what: String,
}

impl SceneError {
    /// An [`SceneError::Invalid`] whose text stays on one line of bearable length whatever the file says.
    pub(crate) fn invalid(path: &Path, place: &str, what: &str, cure: &str) -> Self {
        Self::Invalid {
            path: path.to_path_buf(),
            place: one_line(place),
            what: one_line(what),
            cure: cure.to_string(),
        }
    }
}

impl Warning {
    /// A warning whose text stays on one line of bearable length whatever the file says.
    pub(crate) fn new(place: &str, what: &str) -> Self {
        Self {
            place: one_line(place),
            what: one_line(what),
        }
    }
}

/// Text from a file, fit for a message: no control characters, at most 120 characters.
pub(crate) fn one_line(text: &str) -> String {
    const LONGEST: usize = 120;
    let mut out: String = text
        .chars()
        .take(LONGEST)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if text.chars().nth(LONGEST).is_some() {
        out.push_str("...");
    }
    out
}
