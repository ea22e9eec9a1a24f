//! `-o film.webp`: frames in one file, put together when all are done.
//!
//! Until then they lie as PNG files in a folder beside the film, so that a run that was cut off can go on.

use crate::error::CliError;
use crate::output;
use occlude_image::{FilmFormat, read_display_bytes, write_film};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Endings of videos, which an external program encodes.
const VIDEOS: [&str; 4] = ["mp4", "mkv", "webm", "mov"];

/// Films to make, and where their frames are kept until then.
#[derive(Debug, Default)]
pub struct Films {
    films: Vec<PathBuf>,
    folder: PathBuf,
}

fn extension(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default();
    extension.to_string_lossy().to_lowercase()
}

fn is_video(path: &Path) -> bool {
    VIDEOS.contains(&extension(path).as_str())
}

impl Films {
    /// Takes films out of the outputs, and puts their frames in. `several`: there is more than one frame, so that a PNG without a place for
    /// the frame's number is a film, too.
    pub fn take(outputs: &mut Vec<PathBuf>, several: bool) -> Result<Self, CliError> {
        let is_film = |path: &PathBuf| match extension(path).as_str() {
            "webp" | "gif" | "apng" => true,
            "png" => several && !path.to_string_lossy().contains('#'),
            _ => is_video(path),
        };
        let (films, pictures): (Vec<_>, Vec<_>) = outputs.drain(..).partition(is_film);
        *outputs = pictures;
        let Some(first) = films.first() else {
            return Ok(Self::default());
        };
        for film in &films {
            output::check(film)?;
            if is_video(film) {
                find_encoder(film)?;
            }
        }
        let mut name = first.file_name().unwrap_or_default().to_owned();
        name.push(".frames");
        let folder = first.with_file_name(name);
        fs::create_dir_all(&folder)
            .map_err(|error| CliError::input("cannot keep frames", folder.display(), error))?;
        // First in the list, so that what is known about the work lies there, too.
        outputs.insert(0, folder.join("frame_######.png"));
        Ok(Self { films, folder })
    }

    /// Whether there is nothing to make.
    pub fn is_empty(&self) -> bool {
        self.films.is_empty()
    }

    /// Makes the films of the frames' files and removes these.
    pub fn finish(self, frames: &[PathBuf], fps: f32) -> Result<(), CliError> {
        for film in &self.films {
            match FilmFormat::of(film) {
                Some(format) => write_film(film, format, frames, fps)?,
                None => video(film, frames, fps)?,
            }
        }
        self.discard(frames);
        Ok(())
    }

    /// After a failure: an empty folder goes, frames stay.
    pub fn abandon(self) {
        if !self.is_empty() {
            let _ = fs::remove_dir(&self.folder);
        }
    }

    fn discard(self, frames: &[PathBuf]) {
        for frame in frames {
            let _ = fs::remove_file(frame);
        }
        self.abandon();
    }
}

const ENCODER: &str = "ffmpeg";

fn find_encoder(film: &Path) -> Result<(), CliError> {
    let found = Command::new(ENCODER)
        .arg("-version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    match found {
        Ok(status) if status.success() => Ok(()),
        _ => Err(CliError::input(
            format_args!("videos need the program {ENCODER}, which is not there"),
            film.display(),
            "install it, or write .webp, .gif, .png (animated) or frame_####.png",
        )),
    }
}

/// Feeds pictures to the external encoder, which writes beside the name.
fn video(film: &Path, frames: &[PathBuf], fps: f32) -> Result<(), CliError> {
    let failed = |why: &dyn std::fmt::Display| {
        CliError::failed(
            "cannot encode the film",
            film.display(),
            format_args!("{why}; the frames are kept"),
        )
    };
    let Some(first) = frames.first() else {
        return Err(failed(&"there are no frames"));
    };
    let (width, height, _) = read_display_bytes(first)?;
    let mut name = std::ffi::OsString::from(".unfinished-");
    name.push(film.file_name().unwrap_or_default());
    let unfinished = film.with_file_name(name);
    let mut encoder = Command::new(ENCODER)
        .args([
            "-loglevel",
            "error",
            "-y",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
        ])
        .args([
            "-s",
            &format!("{width}x{height}"),
            "-r",
            &fps.to_string(),
            "-i",
            "-",
        ])
        // Most players want an even size and subsampled colours.
        .args([
            "-vf",
            "pad=ceil(iw/2)*2:ceil(ih/2)*2",
            "-pix_fmt",
            "yuv420p",
        ])
        .arg(&unfinished)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|error| failed(&error))?;
    let fed = encoder.stdin.take().map_or(Ok(()), |mut pipe| {
        frames.iter().try_for_each(|frame| {
            let (_, _, rgb) = read_display_bytes(frame)?;
            pipe.write_all(&rgb).map_err(|error| failed(&error))
        })
    });
    let ended = encoder.wait().map_err(|error| failed(&error))?;
    let done = match (fed, ended.success()) {
        (Err(error), _) => Err(error),
        (Ok(()), false) => Err(failed(&format_args!("{ENCODER} gave up ({ended})"))),
        (Ok(()), true) => fs::rename(&unfinished, film).map_err(|error| failed(&error)),
    };
    if done.is_err() {
        let _ = fs::remove_file(&unfinished);
    }
    done
}
