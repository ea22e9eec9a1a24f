//! Pictures that never lie in memory as a whole: EXR and PNG written row by row.

use crate::exr_write::{self, BLOCK_LINES};
use crate::layers::Layers;
use crate::{ImageError, atomic, png};
use rayon::prelude::*;
use std::io::{Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

/// Writes an EXR file whose rows are made when they are due. `layers` says size, channels (without values) and metadata; `rows` gives, for a
/// range of rows, the values of every channel in the order of `layers.channels`. Up to 16 rows a thread are held at a time. The bytes are
/// those of [`write_layers`](crate::write_layers) with the same values.
///
/// # Errors
/// [`ImageError::Inconsistent`] for sizes and names that cannot be, [`ImageError::Write`].
pub fn write_exr_rows(
    path: &Path,
    layers: &Layers,
    rows: impl Fn(Range<u32>) -> Vec<Vec<f32>> + Sync,
) -> Result<(), ImageError> {
    layers.check_names()?;
    let order = exr_write::order(&layers.channels);
    let channels: Vec<_> = order.iter().map(|&i| &layers.channels[i]).collect();
    let header = exr_write::header(layers, &channels);
    let lines = BLOCK_LINES as u32;
    let blocks = layers.height.div_ceil(lines);
    let block = |b: u32| {
        let range = b * lines..((b + 1) * lines).min(layers.height);
        let values = rows(range.clone());
        let sorted: Vec<&[f32]> = order.iter().map(|&i| values[i].as_slice()).collect();
        exr_write::compress(&exr_write::interleave(
            &channels,
            &sorted,
            layers.width as usize,
            range.len(),
        ))
    };
    atomic::write_seekable(path, |out| {
        out.write_all(&header)?;
        out.write_all(&vec![0; 8 * blocks as usize])?;
        let mut offset = (header.len() + 8 * blocks as usize) as u64;
        let mut offsets = Vec::with_capacity(8 * blocks as usize);
        let at_once = rayon::current_num_threads() as u32 * 2;
        for first in (0..blocks).step_by(at_once as usize) {
            let made: Vec<Vec<u8>> = (first..(first + at_once).min(blocks))
                .into_par_iter()
                .map(block)
                .collect();
            for (i, bytes) in made.iter().enumerate() {
                offsets.extend(offset.to_le_bytes());
                out.write_all(&((first as i32 + i as i32) * BLOCK_LINES as i32).to_le_bytes())?;
                out.write_all(&(bytes.len() as i32).to_le_bytes())?;
                out.write_all(bytes)?;
                offset += 8 + bytes.len() as u64;
            }
        }
        out.seek(SeekFrom::Start(header.len() as u64))?;
        out.write_all(&offsets)
    })
}

/// Writes an 8-bit RGB PNG whose rows (3 bytes a pixel) are made when they are due. `text` becomes text chunks.
///
/// # Errors
/// [`ImageError::Write`].
pub fn write_png_rows(
    path: &Path,
    width: u32,
    height: u32,
    text: &[(String, String)],
    rows: impl Fn(Range<u32>) -> Vec<u8> + Sync,
) -> Result<(), ImageError> {
    atomic::write_atomically(path, |out| {
        png::write_rows(width, height, text, out, |out| {
            const LINES: u32 = 16;
            let blocks = height.div_ceil(LINES);
            let at_once = rayon::current_num_threads() as u32 * 2;
            for first in (0..blocks).step_by(at_once as usize) {
                let made: Vec<Vec<u8>> = (first..(first + at_once).min(blocks))
                    .into_par_iter()
                    .map(|b| rows(b * LINES..((b + 1) * LINES).min(height)))
                    .collect();
                for bytes in made {
                    out.write_all(&bytes)?;
                }
            }
            Ok(())
        })
    })
}
