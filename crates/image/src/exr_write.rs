//! Writing EXR: one part, scan lines, ZIP blocks of 16 lines.
//!
//! The file layout and the ZIP predictor follow "OpenEXR File Layout" and `ImfZip` of the Academy Software Foundation
//! (openexr.com/en/latest/OpenEXRFileLayout.html). Own code because the order of attributes must not depend on a hash
//! map: equal layers give equal bytes, at any thread count.

use std::io::{self, Write};

use half::f16;
use rayon::prelude::*;

use crate::layers::{Attribute, Channel, Depth, Layers};

/// Attributes that readers interpret; metadata cannot use these names.
pub(crate) const OWN_NAMES: [&str; 15] = [
    "channels",
    "chromaticities",
    "chunkCount",
    "compression",
    "dataWindow",
    "displayWindow",
    "lineOrder",
    "name",
    "pixelAspectRatio",
    "screenWindowCenter",
    "screenWindowWidth",
    "tiles",
    "type",
    "version",
    "view",
];

/// Lines in a ZIP block.
pub(crate) const BLOCK_LINES: usize = 16;
/// The middle of zlib's levels: beyond it, noise costs time and saves nothing.
const ZLIB_LEVEL: u8 = 5;
/// x, y of red, green, blue and white of Rec. ITU-R BT.709-6.
const REC_709: [f32; 8] = [0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290];

/// Writes the file. The layers were checked.
pub(crate) fn write(layers: &Layers, out: &mut impl Write) -> io::Result<()> {
    let channels: Vec<&Channel> = (order(&layers.channels).into_iter())
        .map(|i| &layers.channels[i])
        .collect();
    let header = header(layers, &channels);
    let (width, height) = (layers.width as usize, layers.height as usize);

    let blocks: Vec<Vec<u8>> = (0..height.div_ceil(BLOCK_LINES))
        .into_par_iter()
        .map(|block| compress(&gather(&channels, width, height, block)))
        .collect();

    out.write_all(&header)?;
    let mut offset = (header.len() + 8 * blocks.len()) as u64;
    for block in &blocks {
        out.write_all(&offset.to_le_bytes())?;
        offset += 8 + block.len() as u64;
    }
    for (i, block) in blocks.iter().enumerate() {
        out.write_all(&((i * BLOCK_LINES) as i32).to_le_bytes())?;
        out.write_all(&(block.len() as i32).to_le_bytes())?;
        out.write_all(block)?;
    }
    Ok(())
}

/// The order of channels in the file: by name.
pub(crate) fn order(channels: &[Channel]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..channels.len()).collect();
    order.sort_by(|&a, &b| channels[a].name.cmp(&channels[b].name));
    order
}

pub(crate) fn header(layers: &Layers, channels: &[&Channel]) -> Vec<u8> {
    let names = channels
        .iter()
        .map(|c| &c.name)
        .chain(layers.metadata.iter().map(|(n, _)| n));
    let long_names = if names.into_iter().any(|n| n.len() > 31) {
        0x400
    } else {
        0
    };
    let mut out = vec![0x76, 0x2f, 0x31, 0x01];
    out.extend((2u32 | long_names).to_le_bytes());

    let window = bytes_of(
        &[0, 0, layers.width as i32 - 1, layers.height as i32 - 1].map(|v: i32| v.to_le_bytes()),
    );
    let mut list = Vec::new();
    for c in channels {
        list.extend(c.name.as_bytes());
        list.push(0);
        let kind: i32 = if c.depth == Depth::Half { 1 } else { 2 };
        // Pixel type, "perceptually linear" and padding, sampling of 1 in both directions.
        list.extend(bytes_of(&[kind, 0, 1, 1].map(|v| v.to_le_bytes())));
    }
    list.push(0);

    const ZIP: u8 = 3;
    const INCREASING_Y: u8 = 0;
    attribute(&mut out, "channels", "chlist", &list);
    attribute(
        &mut out,
        "chromaticities",
        "chromaticities",
        &bytes_of(&REC_709.map(f32::to_le_bytes)),
    );
    attribute(&mut out, "compression", "compression", &[ZIP]);
    attribute(&mut out, "dataWindow", "box2i", &window);
    attribute(&mut out, "displayWindow", "box2i", &window);
    attribute(&mut out, "lineOrder", "lineOrder", &[INCREASING_Y]);
    attribute(&mut out, "pixelAspectRatio", "float", &1f32.to_le_bytes());
    attribute(&mut out, "screenWindowCenter", "v2f", &[0; 8]);
    attribute(&mut out, "screenWindowWidth", "float", &1f32.to_le_bytes());
    let mut metadata: Vec<_> = layers.metadata.iter().collect();
    metadata.sort_by(|a, b| a.0.cmp(&b.0));
    for (name, value) in metadata {
        match value {
            Attribute::Text(v) => attribute(&mut out, name, "string", v.as_bytes()),
            Attribute::Int(v) => attribute(&mut out, name, "int", &v.to_le_bytes()),
            Attribute::Float(v) => attribute(&mut out, name, "float", &v.to_le_bytes()),
            Attribute::Double(v) => attribute(&mut out, name, "double", &v.to_le_bytes()),
        }
    }
    out.push(0);
    out
}

fn bytes_of(words: &[[u8; 4]]) -> Vec<u8> {
    words.concat()
}

fn attribute(out: &mut Vec<u8>, name: &str, kind: &str, value: &[u8]) {
    out.extend(name.as_bytes());
    out.push(0);
    out.extend(kind.as_bytes());
    out.push(0);
    out.extend((value.len() as i32).to_le_bytes());
    out.extend(value);
}

/// One block's samples as they lie uncompressed.
fn gather(channels: &[&Channel], width: usize, height: usize, block: usize) -> Vec<u8> {
    let first = block * BLOCK_LINES;
    let lines = first..(first + BLOCK_LINES).min(height);
    let values: Vec<&[f32]> = channels
        .iter()
        .map(|c| &c.values[lines.start * width..lines.end * width])
        .collect();
    interleave(channels, &values, width, lines.len())
}

/// Samples line by line, channel by channel.
pub(crate) fn interleave(
    channels: &[&Channel],
    values: &[&[f32]],
    width: usize,
    lines: usize,
) -> Vec<u8> {
    let bytes_a_pixel: usize = channels
        .iter()
        .map(|c| if c.depth == Depth::Half { 2 } else { 4 })
        .sum();
    let mut raw = Vec::with_capacity(lines * width * bytes_a_pixel);
    for y in 0..lines {
        for (c, values) in channels.iter().zip(values) {
            let line = &values[y * width..(y + 1) * width];
            match c.depth {
                Depth::Half => line
                    .iter()
                    .for_each(|&v| raw.extend(half_of(v).to_le_bytes())),
                Depth::Float => line.iter().for_each(|&v| raw.extend(v.to_le_bytes())),
            }
        }
    }
    raw
}

/// A finite value stays finite.
fn half_of(v: f32) -> f16 {
    let half = f16::from_f32(v);
    if half.is_infinite() && v.is_finite() {
        f16::MAX.copysign(half)
    } else {
        half
    }
}

/// Even bytes first, then odd bytes, each as the difference to its predecessor plus 128, through zlib. What does not
/// shrink is stored as it is: readers know it by its size.
pub(crate) fn compress(raw: &[u8]) -> Vec<u8> {
    let mut split: Vec<u8> = Vec::with_capacity(raw.len());
    split.extend(raw.iter().step_by(2));
    split.extend(raw.iter().skip(1).step_by(2));
    let mut previous = split[0];
    for byte in &mut split[1..] {
        let delta = byte.wrapping_sub(previous).wrapping_add(128);
        previous = std::mem::replace(byte, delta);
    }
    let packed = miniz_oxide::deflate::compress_to_vec_zlib(&split, ZLIB_LEVEL);
    if packed.len() < raw.len() {
        packed
    } else {
        raw.to_vec()
    }
}
