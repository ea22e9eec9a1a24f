//! Films: pictures one after the other in one file, put together from PNG files.
//!
//! WebP is lossless and small, APNG lossless and understood by everything that shows PNG, GIF has 256 colours a picture. Frames are read one by one, so
//! a film needs the memory of one picture and, as WebP, of the file.
//!
//! Wrong tool for long films: none of these formats predicts a picture from the one before. Use a video encoder on the single pictures.

use crate::{ImageError, write_atomically};
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};

/// Kinds of films.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilmFormat {
    /// Animated WebP, lossless.
    WebP,
    /// Animated PNG.
    Apng,
    /// Animated GIF: 256 colours a picture, times in hundredths of a second.
    Gif,
}

impl FilmFormat {
    /// By the name's ending: `.webp`, `.gif`, `.png` or `.apng`.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        match extension.as_str() {
            "webp" => Some(Self::WebP),
            "png" | "apng" => Some(Self::Apng),
            "gif" => Some(Self::Gif),
            _ => None,
        }
    }

    /// Largest side of a picture.
    pub fn largest_side(self) -> u32 {
        match self {
            Self::WebP => 1 << 14,
            Self::Apng => u32::MAX >> 1,
            Self::Gif => u16::MAX.into(),
        }
    }
}

/// Colours as displayed, 8 bits a channel.
struct Still {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

/// Puts PNG files (8 bits, RGB: as this crate writes them) together, `fps` of them a second, for ever repeated.
///
/// # Errors
/// [`ImageError::Read`] and [`ImageError::Invalid`] if a picture is missing, is no such PNG or has another size than the first;
/// [`ImageError::Write`] if the film cannot be written; the old file stays then.
pub fn write_film(
    path: &Path,
    format: FilmFormat,
    pictures: &[PathBuf],
    fps: f32,
) -> Result<(), ImageError> {
    let Some(first) = pictures.first() else {
        return Err(ImageError::Inconsistent("a film of no pictures".into()));
    };
    let first = read_display(first)?;
    let (width, height) = (first.width, first.height);
    let most = format.largest_side();
    if width.max(height) > most {
        return Err(invalid(
            path,
            format!("{width}x{height} pixels, and the format holds {most} a side at most"),
            "choose another format or a smaller size",
        ));
    }
    let mut failed = None;
    let mut read = |index: usize| -> io::Result<Vec<u8>> {
        let still = read_display(&pictures[index]).and_then(|still| {
            if (still.width, still.height) == (width, height) {
                Ok(still)
            } else {
                Err(invalid(
                    &pictures[index],
                    format!("not {width}x{height} pixels as the first"),
                    "render all frames at one size",
                ))
            }
        });
        still.map(|still| still.rgb).map_err(|error| {
            failed = Some(error);
            io::Error::other("a picture cannot be read")
        })
    };
    let film = Film {
        width,
        height,
        count: pictures.len(),
        fps,
    };
    let written = write_atomically(path, |out| match format {
        FilmFormat::WebP => film.webp(&mut read, out),
        FilmFormat::Apng => film.apng(&mut read, out),
        FilmFormat::Gif => film.gif(&mut read, out),
    });
    match failed {
        Some(error) => Err(error),
        None => written,
    }
}

/// A picture as it is displayed, 8 bits a channel, row by row: width, height and bytes RGBRGB...
///
/// # Errors
/// [`ImageError::Read`] if there is no such file, [`ImageError::Invalid`] if it is no PNG of this kind.
pub fn read_display_bytes(path: &Path) -> Result<(u32, u32, Vec<u8>), ImageError> {
    read_display(path).map(|still| (still.width, still.height, still.rgb))
}

fn invalid(path: &Path, what: String, cure: &'static str) -> ImageError {
    ImageError::Invalid {
        path: path.to_owned(),
        what,
        cure,
    }
}

fn read_display(path: &Path) -> Result<Still, ImageError> {
    let file = File::open(path).map_err(|source| ImageError::Read {
        path: path.to_owned(),
        source,
    })?;
    let damaged = |what: String| invalid(path, what, "render the frame again");
    let decoding = |error: png::DecodingError| damaged(format!("PNG: {error}"));
    let mut reader = png::Decoder::new(BufReader::new(file))
        .read_info()
        .map_err(decoding)?;
    if reader.output_color_type() != (png::ColorType::Rgb, png::BitDepth::Eight) {
        return Err(damaged("not RGB with 8 bits a channel".into()));
    }
    let (width, height) = (reader.info().width, reader.info().height);
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| damaged("too large".into()))?;
    let mut rgb = vec![0; size];
    reader.next_frame(&mut rgb).map_err(decoding)?;
    Ok(Still { width, height, rgb })
}

struct Film {
    width: u32,
    height: u32,
    count: usize,
    fps: f32,
}

type Read<'r> = &'r mut dyn FnMut(usize) -> io::Result<Vec<u8>>;

impl Film {
    /// How long a picture is shown, in `unit`s a second: rounded so that the film as a whole keeps its speed.
    fn duration(&self, index: usize, unit: f64) -> u32 {
        let at = |index: usize| (index as f64 * unit / f64::from(self.fps)).round();
        (at(index + 1) - at(index)).max(1.0) as u32
    }

    /// RIFF with the chunks VP8X, ANIM and an ANMF for every picture (WebP container specification), each a lossless picture.
    fn webp(&self, read: Read, out: &mut dyn Write) -> io::Result<()> {
        let u24 = |value: u32| {
            let [a, b, c, _] = value.to_le_bytes();
            [a, b, c]
        };
        let mut body = b"WEBP".to_vec();
        let mut chunk = |name: &[u8; 4], parts: &[&[u8]]| {
            let length: usize = parts.iter().map(|part| part.len()).sum();
            body.extend(name);
            body.extend((length as u32).to_le_bytes());
            parts.iter().for_each(|part| body.extend(*part));
            body.resize(body.len().next_multiple_of(2), 0);
        };
        let (width, height) = (u24(self.width - 1), u24(self.height - 1));
        const ANIMATED: [u8; 4] = [2, 0, 0, 0];
        chunk(b"VP8X", &[&ANIMATED, &width, &height]);
        // No background, repeated for ever.
        chunk(b"ANIM", &[&[0; 6]]);
        for index in 0..self.count {
            let rgb = read(index)?;
            let mut still = Vec::new();
            image_webp::WebPEncoder::new(&mut still)
                .encode(&rgb, self.width, self.height, image_webp::ColorType::Rgb8)
                .map_err(io::Error::other)?;
            // Behind RIFF, size and WEBP there are the picture's own chunks.
            let picture = still.get(12..).unwrap_or_default();
            let duration = u24(self.duration(index, 1000.0));
            const REPLACE: [u8; 1] = [2];
            let place = [0; 6];
            chunk(
                b"ANMF",
                &[&place, &width, &height, &duration, &REPLACE, picture],
            );
        }
        let length = u32::try_from(body.len())
            .map_err(|_| io::Error::other("WebP holds at most 4 GiB: use single pictures"))?;
        out.write_all(b"RIFF")?;
        out.write_all(&length.to_le_bytes())?;
        out.write_all(&body)
    }

    fn apng(&self, read: Read, out: &mut dyn Write) -> io::Result<()> {
        let into_io = |error| match error {
            png::EncodingError::IoError(error) => error,
            error => io::Error::other(error),
        };
        let mut encoder = png::Encoder::new(out, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder
            .set_animated(self.count as u32, 0)
            .map_err(into_io)?;
        encoder
            .set_frame_delay(self.duration(0, 1000.0).min(u16::MAX.into()) as u16, 1000)
            .map_err(into_io)?;
        let mut writer = encoder.write_header().map_err(into_io)?;
        for index in 0..self.count {
            let delay = self.duration(index, 1000.0).min(u16::MAX.into()) as u16;
            writer.set_frame_delay(delay, 1000).map_err(into_io)?;
            writer.write_image_data(&read(index)?).map_err(into_io)?;
        }
        writer.finish().map_err(into_io)
    }

    fn gif(&self, read: Read, out: &mut dyn Write) -> io::Result<()> {
        /// Of the palette's search: 1 is best and slow, 30 the fastest.
        const SPEED: i32 = 10;
        let into_io = |error| match error {
            gif::EncodingError::Io(error) => error,
            error => io::Error::other(error),
        };
        let (width, height) = (self.width as u16, self.height as u16);
        let mut encoder = gif::Encoder::new(out, width, height, &[]).map_err(into_io)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(into_io)?;
        for index in 0..self.count {
            let rgb = read(index)?;
            let mut frame = gif::Frame::from_rgb_speed(width, height, &rgb, SPEED);
            frame.delay = self.duration(index, 100.0).min(u16::MAX.into()) as u16;
            encoder.write_frame(&frame).map_err(into_io)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Picture;

    /// A square that walks.
    fn pictures(folder: &Path, count: u32) -> Vec<PathBuf> {
        (0..count)
            .map(|frame| {
                let mut picture = Picture::new(24, 17);
                for y in 4..9 {
                    for x in 0..5 {
                        picture.pixels[(y * 24 + x + 3 * frame) as usize] = [1.0, 0.2, 0.05];
                    }
                }
                let path = folder.join(format!("{frame}.png"));
                crate::write(&path, &picture, crate::Look::default()).unwrap();
                path
            })
            .collect()
    }

    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("occlude-film-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn films_hold_their_pictures() {
        let folder = folder("hold");
        let parts = pictures(&folder, 5);
        let stills: Vec<Vec<u8>> = (parts.iter())
            .map(|part| read_display(part).unwrap().rgb)
            .collect();

        let path = folder.join("film.png");
        write_film(&path, FilmFormat::Apng, &parts, 24.0).unwrap();
        let file = BufReader::new(File::open(&path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let control = reader.info().animation_control().unwrap();
        assert_eq!((control.num_frames, control.num_plays), (5, 0));
        let mut milliseconds = 0;
        for still in &stills {
            let mut rgb = vec![0; still.len()];
            reader.next_frame(&mut rgb).unwrap();
            assert!(rgb == *still);
            let frame = reader.info().frame_control().unwrap();
            assert_eq!(frame.delay_den, 1000);
            milliseconds += frame.delay_num;
        }
        assert_eq!(milliseconds, 208, "5/24 s");

        let path = folder.join("film.webp");
        write_film(&path, FilmFormat::WebP, &parts, 24.0).unwrap();
        let file = BufReader::new(File::open(&path).unwrap());
        let mut reader = image_webp::WebPDecoder::new(file).unwrap();
        assert!(reader.is_animated());
        assert_eq!((reader.num_frames(), reader.dimensions()), (5, (24, 17)));
        let mut milliseconds = 0;
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        for still in &stills {
            milliseconds += reader.read_frame(&mut rgb).unwrap();
            // Decoders may add alpha.
            let samples = rgb.len() / (24 * 17);
            let rgb: Vec<u8> = rgb.chunks(samples).flat_map(|p| &p[..3]).copied().collect();
            assert!(rgb == *still);
        }
        assert_eq!(milliseconds, 208);

        let path = folder.join("film.gif");
        write_film(&path, FilmFormat::Gif, &parts, 25.0).unwrap();
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut reader = options.read_info(File::open(&path).unwrap()).unwrap();
        for still in &stills {
            let frame = reader.read_next_frame().unwrap().unwrap();
            assert_eq!(frame.delay, 4);
            // Two colours fit into the palette, nearly.
            let far = frame.buffer.chunks(4).zip(still.chunks(3));
            let far = far.map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c])).max());
            assert!(far.max().flatten() < Some(8));
        }
        assert!(reader.read_next_frame().unwrap().is_none());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn films_that_cannot_be() {
        let folder = folder("refused");
        let mut parts = pictures(&folder, 2);
        let path = folder.join("film.webp");
        let write = |parts: &[PathBuf]| write_film(&path, FilmFormat::WebP, parts, 24.0);
        assert!(write(&[]).is_err());
        let small = folder.join("small.png");
        crate::write(&small, &Picture::new(3, 3), crate::Look::default()).unwrap();
        parts.push(small);
        assert!(matches!(write(&parts), Err(ImageError::Invalid { .. })));
        parts[2] = folder.join("missing.png");
        assert!(matches!(write(&parts), Err(ImageError::Read { .. })));
        std::fs::write(&parts[2], b"\x89PNG\r\n\x1a\nno").unwrap();
        assert!(matches!(write(&parts), Err(ImageError::Invalid { .. })));
        assert!(!path.exists());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
