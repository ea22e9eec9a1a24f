//! Outputs that are whole or absent.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::{Format, ImageError};

/// Writes a file so that its name holds either the old content or the whole new one.
///
/// `fill` writes into a temporary file in the same folder, which is flushed to the disk and then renamed. If anything
/// fails (a full disk, say) the temporary file is removed and the old file stays. A symbolic link stays a link: the
/// file that it points to is replaced. What is not a regular file (`/dev/stdout`, a named pipe) is written directly.
///
/// # Errors
/// [`ImageError::Write`] with the cause.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), ImageError> {
    let failed = |source| ImageError::Write {
        path: path.to_owned(),
        source,
    };
    match fs::metadata(path) {
        Ok(meta) if meta.is_dir() => return Err(failed(io::ErrorKind::IsADirectory.into())),
        Ok(meta) if !meta.is_file() => {
            let mut out =
                BufWriter::new(OpenOptions::new().write(true).open(path).map_err(failed)?);
            return fill(&mut out).and_then(|()| out.flush()).map_err(failed);
        }
        _ => {}
    }
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let (temporary, file) = create_beside(&target).map_err(failed)?;
    let done = fill_and_sync(file, fill).and_then(|()| fs::rename(&temporary, &target));
    if let Err(source) = done {
        // The first failure is the one to report; a leftover is all that a second one could mean.
        let _ = fs::remove_file(&temporary);
        return Err(failed(source));
    }
    sync_folder(&target);
    Ok(())
}

/// [`write_atomically`] for formats that come back to what they have written. What is not a regular file cannot be written so.
pub(crate) fn write_seekable(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), ImageError> {
    let failed = |source| ImageError::Write {
        path: path.to_owned(),
        source,
    };
    if fs::metadata(path).is_ok_and(|meta| !meta.is_file()) {
        return Err(failed(io::Error::other("not a regular file")));
    }
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let (temporary, file) = create_beside(&target).map_err(failed)?;
    let mut out = BufWriter::with_capacity(1 << 16, file);
    let done = fill(&mut out)
        .and_then(|()| out.into_inner().map_err(|e| e.into_error())?.sync_all())
        .and_then(|()| fs::rename(&temporary, &target));
    if let Err(source) = done {
        let _ = fs::remove_file(&temporary);
        return Err(failed(source));
    }
    sync_folder(&target);
    Ok(())
}

fn fill_and_sync(
    file: File,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 16, file);
    fill(&mut out)?;
    out.into_inner().map_err(|e| e.into_error())?.sync_all()
}

/// Makes the rename survive a power cut, where the system can. The content is whole either way.
fn sync_folder(target: &Path) {
    #[cfg(unix)]
    if let Ok(folder) = File::open(folder_of(target)) {
        let _ = folder.sync_all();
    }
    #[cfg(not(unix))]
    let _ = target;
}

fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// A new, hidden file in the same folder, whose name no other process and no other thread uses.
fn create_beside(target: &Path) -> io::Result<(PathBuf, File)> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let name = target
        .file_name()
        .ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
    loop {
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(format!(
            ".{}-{}.tmp",
            std::process::id(),
            COUNT.fetch_add(1, Ordering::Relaxed)
        ));
        let temporary = target.with_file_name(hidden);
        match OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&temporary)
        {
            Ok(file) => return Ok((temporary, file)),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
            Err(e) => return Err(e),
        }
    }
}

/// Finds out before any work whether a picture can be written there: the extension is known, the folder exists, and a
/// file can be made in it. Leaves nothing behind.
///
/// # Errors
/// [`ImageError::Destination`] that says what to do, [`ImageError::Write`] if the system refuses.
pub fn check_writable(path: &Path) -> Result<Format, ImageError> {
    let unsuitable = |what: &str, cure| ImageError::Destination {
        path: path.to_owned(),
        what: what.to_owned(),
        cure,
    };
    let format = Format::from_extension(path).ok_or_else(|| {
        unsuitable(
            "unknown picture format",
            "use the extension .exr, .hdr or .png",
        )
    })?;
    check_place(path)?;
    Ok(format)
}

/// [`check_writable`] for files of any kind.
///
/// # Errors
/// As [`check_writable`].
pub fn check_place(path: &Path) -> Result<(), ImageError> {
    let unsuitable = |what: &str, cure| ImageError::Destination {
        path: path.to_owned(),
        what: what.to_owned(),
        cure,
    };
    match fs::metadata(path) {
        Ok(meta) if meta.is_dir() => {
            return Err(unsuitable("the output is a folder", "name a file in it"));
        }
        Ok(meta) if !meta.is_file() => return Ok(()),
        _ => {}
    }
    if !folder_of(path).is_dir() {
        return Err(unsuitable(
            "the output's folder does not exist",
            "create it or choose another place",
        ));
    }
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let (temporary, _) = create_beside(&target).map_err(|source| ImageError::Write {
        path: path.to_owned(),
        source,
    })?;
    let _ = fs::remove_file(temporary);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("occlude-atomic-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn names(folder: &Path) -> Vec<OsString> {
        fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect()
    }

    #[test]
    fn a_failure_keeps_the_old_file_and_leaves_no_other() {
        let folder = folder("keep");
        let path = folder.join("a.png");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |out| {
            out.write_all(&[7; 200_000])?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert!(
            matches!(&failed, Err(ImageError::Write { source, .. }) if source.kind() == io::ErrorKind::StorageFull)
        );
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(&folder), ["a.png"]);
        write_atomically(&path, |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn places_are_checked_before_any_work() {
        let folder = folder("check");
        assert_eq!(check_writable(&folder.join("a.EXR")).unwrap(), Format::Exr);
        assert!(names(&folder).is_empty(), "the check leaves nothing behind");
        for bad in [
            folder.join("a.tga9"),
            folder.join("none"),
            folder.join("missing/a.exr"),
            "/proc/nowhere/x.exr".into(),
        ] {
            let text = check_writable(&bad).unwrap_err().to_string();
            assert!(
                text.lines().count() == 1 && text.contains(&*bad.to_string_lossy()),
                "{text}"
            );
        }
        let sub = folder.join("folder.png");
        fs::create_dir(&sub).unwrap();
        assert!(check_writable(&sub).is_err());
        assert!(write_atomically(&sub, |_| Ok(())).is_err());
        fs::remove_dir_all(folder).unwrap();
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_are_written_directly() {
        let full = write_atomically(Path::new("/dev/full"), |out| out.write_all(&[0; 10]));
        assert!(
            matches!(&full, Err(ImageError::Write { source, .. }) if source.kind() == io::ErrorKind::StorageFull)
        );
        write_atomically(Path::new("/dev/null"), |out| out.write_all(b"x")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link() {
        let folder = folder("link");
        let (target, link) = (folder.join("real.exr"), folder.join("link.exr"));
        fs::write(&target, b"old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write_atomically(&link, |out| out.write_all(b"new")).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&target).unwrap(), b"new");
        fs::remove_dir_all(folder).unwrap();
    }
}
