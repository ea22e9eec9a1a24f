//! Files that the program writes: checked before any work, written beside their name and renamed when whole.

use crate::error::CliError;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Picture formats, known by the file's extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Scene-linear, half or float channels, may carry AOVs.
    Exr,
    /// 8 bits, exposed and tone mapped.
    Png,
    /// Scene-linear RGBE.
    Hdr,
}

impl Format {
    /// The format that the extension names.
    pub fn of(path: &Path) -> Result<Self, CliError> {
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("exr") => Ok(Self::Exr),
            Some("png") => Ok(Self::Png),
            Some("hdr") => Ok(Self::Hdr),
            _ => Err(CliError::input(
                "unknown picture format",
                path.display(),
                "end the name in .exr, .png or .hdr",
            )),
        }
    }
}

/// Finds out whether `path` can be written, without touching what is there. Exit code 2 if not: nothing has been done yet.
pub fn check(path: &Path) -> Result<(), CliError> {
    let target = Target::of(path)?;
    let probe = match &target {
        Target::Direct(path) => OpenOptions::new().write(true).open(path).map(drop),
        Target::Renamed(path) => {
            let temporary = beside(path);
            File::create(&temporary)
                .map(drop)
                .and_then(|()| fs::remove_file(&temporary))
        }
    };
    probe.map_err(|error| {
        let cure = match error.kind() {
            io::ErrorKind::NotFound => "no such folder: create it first".to_owned(),
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
                "no permission: name another place".to_owned()
            }
            _ => error.to_string(),
        };
        CliError::input("cannot write", path.display(), cure)
    })
}

/// Checks several outputs, also that no name is given twice and none is an input.
pub fn check_all(outputs: &[&Path], inputs: &[&Path]) -> Result<(), CliError> {
    for (index, output) in outputs.iter().enumerate() {
        if inputs.iter().any(|input| same_file(input, output)) {
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
        check(output)?;
    }
    Ok(())
}

fn same_file(a: &Path, b: &Path) -> bool {
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
    let result = match Target::of(path)? {
        Target::Direct(path) => OpenOptions::new()
            .write(true)
            .open(path)
            .and_then(|mut file| fill(&mut file)),
        Target::Renamed(path) => write_and_rename(&path, fill),
    };
    result.map_err(|error| {
        CliError::failed(
            "cannot write",
            path.display(),
            format!("{error}; a file that was there is unchanged"),
        )
    })
}

fn write_and_rename(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let temporary = beside(path);
    let result = (|| {
        let mut out = BufWriter::new(File::create(&temporary)?);
        fill(&mut out)?;
        out.into_inner()?.sync_all()?;
        fs::rename(&temporary, path)
    })();
    if result.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    result
}

/// How a name is written to.
enum Target {
    /// A device or a pipe: nothing to keep, nothing to rename.
    Direct(PathBuf),
    /// A file (links followed, so that the link stays a link), or nothing yet.
    Renamed(PathBuf),
}

impl Target {
    fn of(path: &Path) -> Result<Self, CliError> {
        match fs::metadata(path) {
            Ok(data) if data.is_dir() => Err(CliError::input(
                "cannot write",
                path.display(),
                "it is a folder: name a file in it",
            )),
            Ok(data) if data.is_file() => Ok(Self::Renamed(
                fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()),
            )),
            Ok(_) => Ok(Self::Direct(path.to_owned())),
            Err(_) => Ok(Self::Renamed(path.to_owned())),
        }
    }
}

/// A name in the same folder, so that renaming never crosses file systems; hidden, and not two processes' at once.
fn beside(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}.part", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_go_by_extension() {
        assert_eq!(Format::of(Path::new("a.EXR")).unwrap(), Format::Exr);
        assert_eq!(Format::of(Path::new("b/a.png")).unwrap(), Format::Png);
        assert_eq!(Format::of(Path::new("a.hdr")).unwrap(), Format::Hdr);
        for bad in ["a", "a.tga9", "exr", ".exr", ""] {
            assert!(Format::of(Path::new(bad)).is_err(), "{bad}");
        }
    }
}
