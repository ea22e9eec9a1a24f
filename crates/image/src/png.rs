//! PNG: written as 8-bit sRGB with its look in text chunks; read as display colours decoded to linear light.

use std::io::{self, Cursor, Write};

use crate::codec::Limits;
use crate::error::Fault;
use crate::{Picture, srgb_decode};

/// Writes bytes RGBRGB... with text chunks (keyword, text; reduced to Latin-1, keywords at most 79 characters).
pub(crate) fn write(
    width: u32,
    height: u32,
    rgb: &[u8],
    text: &[(String, String)],
    out: &mut (impl Write + ?Sized),
) -> io::Result<()> {
    write_rows(width, height, text, out, |out| out.write_all(rgb))
}

/// [`write`] for bytes that `fill` writes piece by piece.
pub(crate) fn write_rows(
    width: u32,
    height: u32,
    text: &[(String, String)],
    out: &mut (impl Write + ?Sized),
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    for (keyword, value) in text {
        let latin = |text: &str| {
            text.chars()
                .map(|c| {
                    if ('\u{20}'..='\u{7e}').contains(&c) {
                        c
                    } else {
                        '?'
                    }
                })
                .collect::<String>()
        };
        let keyword: String = latin(keyword).chars().take(79).collect();
        encoder
            .add_text_chunk(keyword, latin(value))
            .map_err(io::Error::other)?;
    }
    let into_io = |e| match e {
        png::EncodingError::IoError(e) => e,
        e => io::Error::other(e),
    };
    let mut writer = encoder.write_header().map_err(into_io)?;
    let mut stream = writer.stream_writer().map_err(into_io)?;
    fill(&mut stream)?;
    stream.finish().map_err(into_io)?;
    writer.finish().map_err(into_io)
}

/// Reads a picture: grey, palette and RGB in any depth, sRGB decoded to linear light; alpha is dropped. Of an animation, the first image.
pub(crate) fn read(bytes: &[u8], limits: &Limits) -> Result<Picture, Fault> {
    let damaged =
        |e: png::DecodingError| Fault::damaged(format!("PNG: {}", one_line(&e.to_string())));
    let budget = usize::try_from(limits.max_bytes).unwrap_or(usize::MAX);
    let mut decoder =
        png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: budget });
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (width, height) = (reader.info().width, reader.info().height);
    let (color, depth) = reader.output_color_type();
    let (w, h) = (u64::from(width), u64::from(height));
    let stored = w
        * (color.samples()
            * if depth == png::BitDepth::Sixteen {
                2
            } else {
                1
            }) as u64;
    let needed = w
        .saturating_mul(h)
        .saturating_mul(size_of::<[f32; 3]>() as u64);
    if needed > limits.max_bytes {
        return Err(Fault::TooLarge {
            width: w,
            height: h,
            needed,
            limit: limits.max_bytes,
        });
    }
    // deflate shrinks 1032 times at most; the smallest depth has 8 pixels a byte where `stored` counts one each.
    if stored.saturating_mul(h) / 8 > (bytes.len() as u64).saturating_mul(1032) {
        return Err(Fault::damaged(format!(
            "the PNG file is too short for {width}x{height} pixels"
        )));
    }
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| Fault::damaged("PNG of an absurd size"))?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(damaged)?;
    let samples = color.samples();
    let row_bytes = info.line_size;
    let decode: Vec<f32> = (0..=255u8)
        .map(|b| srgb_decode(f32::from(b) / 255.0))
        .collect();
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    for row in buffer.chunks_exact(row_bytes).take(height as usize) {
        let value = |i: usize| match depth {
            png::BitDepth::Sixteen => {
                srgb_decode(f32::from(u16::from_be_bytes([row[2 * i], row[2 * i + 1]])) / 65535.0)
            }
            _ => decode[usize::from(row[i])],
        };
        pixels.extend((0..width as usize).map(|x| match samples {
            1 | 2 => [value(x * samples); 3],
            _ => [
                value(x * samples),
                value(x * samples + 1),
                value(x * samples + 2),
            ],
        }));
    }
    Picture::from_pixels(width, height, pixels).map_err(|_| Fault::damaged("PNG rows are missing"))
}

/// Messages of other crates, made fit for one line.
pub(crate) fn one_line(text: &str) -> String {
    text.split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
        .chars()
        .take(160)
        .collect()
}
