//! What can be wrong with a picture file.

use std::path::{Path, PathBuf};

/// Why a picture could not be read, written or compared. The text is one line: what, where, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The file cannot be read.
    #[error("cannot read: {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write: {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The place for an output is unsuitable; found before any work.
    #[error("{what}: {}: {cure}", path.display())]
    Destination {
        /// The file that was to be written.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What the user can do about it.
        cure: &'static str,
    },
    /// The file is not a picture of a known kind.
    #[error("not a picture that can be read: {}: give an EXR, Radiance HDR or PNG file", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The file is damaged, or uses what is not supported.
    #[error("{what}: {}: {cure}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What the user can do about it.
        cure: &'static str,
    },
    /// The picture is larger than allowed.
    #[error("picture of {width}x{height} needs {needed} bytes, the limit is {limit}: {}: scale it down or raise --memory", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Claimed pixels a row.
        width: u64,
        /// Claimed rows.
        height: u64,
        /// Bytes needed, at least.
        needed: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// Two pictures that must agree in size do not.
    #[error("pictures differ in size: {}x{} against {}x{}: render both at one size", a.0, a.1, b.0, b.1)]
    SizeMismatch {
        /// Width and height of the first.
        a: (u32, u32),
        /// Width and height of the second.
        b: (u32, u32),
    },
    /// Numbers of pixels and of values disagree, or a name is used twice: a mistake of the calling program.
    #[error("inconsistent picture: {0}")]
    Inconsistent(String),
}

/// What is wrong inside of a file, before its path is known.
#[derive(Debug)]
pub(crate) enum Fault {
    /// Damaged or unsupported.
    Invalid { what: String, cure: &'static str },
    /// Larger than the limit.
    TooLarge {
        width: u64,
        height: u64,
        needed: u64,
        limit: u64,
    },
}

impl Fault {
    /// Damage: the usual cure is another copy.
    pub fn damaged(what: impl Into<String>) -> Self {
        Fault::Invalid {
            what: what.into(),
            cure: "the file is damaged; copy or export it again",
        }
    }

    /// Something that is valid but not supported.
    pub fn unsupported(what: impl Into<String>, cure: &'static str) -> Self {
        Fault::Invalid {
            what: what.into(),
            cure,
        }
    }

    /// Puts the path on.
    pub fn at(self, path: &Path) -> ImageError {
        let path = path.to_owned();
        match self {
            Fault::Invalid { what, cure } => ImageError::Invalid { path, what, cure },
            Fault::TooLarge {
                width,
                height,
                needed,
                limit,
            } => ImageError::TooLarge {
                path,
                width,
                height,
                needed,
                limit,
            },
        }
    }
}
