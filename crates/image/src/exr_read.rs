//! Reading EXR: scan lines and tiles, half, float and uint, uncompressed, RLE, ZIP, PIZ, PXR24 and
//! B44.
//!
//! The `exr` crate decodes headers and single blocks; this module decides what is allocated. Sizes are checked
//! against the limit and against what the file's length can hold before any block is read. Deep and subsampled
//! channels are refused, and DWA: that decoder allocates what a block claims (an abort that nothing can contain).
//!
//! That crate's decoders contain assertions and unchecked indices that a damaged file could reach, so all calls into
//! it run under `catch_unwind` ([`contained`]); nothing it owns outlives a panic.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::block::reader::{ChunksReader, Reader};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::MetaData;
use exr::meta::attribute::{AttributeValue, SampleType};
use exr::meta::header::Header;
use half::f16;
use rayon::prelude::*;

use crate::Picture;
use crate::codec::Limits;
use crate::error::Fault;
use crate::layers::{Attribute, Channel, Depth, Layers};
use crate::png::one_line;

/// Bytes of blocks that are decompressed at a time, and how many blocks: enough for every core, little memory.
const BATCH_BYTES: usize = 64 << 20;
const BATCH_BLOCKS: usize = 64;

/// R, G, B of the first part that has them.
pub(crate) fn read_color(bytes: &[u8], limits: &Limits) -> Result<Picture, Fault> {
    let (layers, names) = contained(|| {
        let reader = open(bytes)?;
        let found = reader
            .headers()
            .iter()
            .enumerate()
            .find_map(|(i, h)| Some((i, color_names(h)?)));
        let (part, names) = found.ok_or_else(|| {
            Fault::unsupported(
                "the EXR file has no channels R, G, B",
                "export it with an RGB layer",
            )
        })?;
        Ok((
            read_part(reader, part, bytes.len(), limits, |name| {
                names.iter().any(|n| n == name)
            })?,
            names,
        ))
    })?;
    let values = |c: usize| {
        layers
            .channel(&names[c])
            .map(|c| &c.values[..])
            .unwrap_or_default()
    };
    let (r, g, b) = (values(0), values(1), values(2));
    let pixels = r
        .iter()
        .zip(g)
        .zip(b)
        .map(|((&r, &g), &b)| [r, g, b])
        .collect();
    Picture::from_pixels(layers.width, layers.height, pixels)
        .map_err(|_| Fault::damaged("EXR channels are missing"))
}

/// Every channel of the first part.
pub(crate) fn read_all(bytes: &[u8], limits: &Limits) -> Result<Layers, Fault> {
    contained(|| {
        let reader = open(bytes)?;
        let header = &reader.headers()[0];
        let metadata = metadata(header);
        let mut layers = read_part(reader, 0, bytes.len(), limits, |_| true)?;
        layers.metadata = metadata;
        Ok(layers)
    })
}

/// Runs `decode`; a panic inside of the `exr` crate becomes damage of the file.
fn contained<T>(decode: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err(Fault::damaged("the EXR file contradicts itself")))
}

fn fault(e: exr::error::Error) -> Fault {
    Fault::damaged(format!("EXR: {}", one_line(&e.to_string())))
}

fn open(bytes: &[u8]) -> Result<Reader<Cursor<&[u8]>>, Fault> {
    let reader = exr::block::read(Cursor::new(bytes), false).map_err(fault)?;
    if reader.headers().is_empty() {
        return Err(Fault::damaged("the EXR file has no part"));
    }
    Ok(reader)
}

/// The names of red, green and blue: `R`, `G`, `B`, or the first `NAME.R`..., or `Y` three times.
fn color_names(header: &Header) -> Option<[String; 3]> {
    let names: Vec<String> = header
        .channels
        .list
        .iter()
        .map(|c| c.name.to_string())
        .collect();
    let has = |name: &String| names.contains(name);
    let prefixes = std::iter::once("").chain(
        names
            .iter()
            .filter_map(|n| n.strip_suffix('R'))
            .filter(|p| p.ends_with('.')),
    );
    for prefix in prefixes {
        let triple = ["R", "G", "B"].map(|c| format!("{prefix}{c}"));
        if triple.iter().all(has) {
            return Some(triple);
        }
    }
    has(&"Y".to_owned()).then(|| ["Y"; 3].map(str::to_owned))
}

/// Checks that the part is supported, within the limit, and no larger than the file can hold.
fn check(header: &Header, file_bytes: usize, limits: &Limits) -> Result<(), Fault> {
    if header.deep {
        return Err(Fault::unsupported(
            "the EXR file holds deep pixels",
            "flatten it first",
        ));
    }
    if header
        .channels
        .list
        .iter()
        .any(|c| c.sampling != Vec2(1, 1))
    {
        return Err(Fault::unsupported(
            "the EXR file has subsampled channels",
            "export it as RGB",
        ));
    }
    if matches!(
        header.compression,
        Compression::DWAA(_) | Compression::DWAB(_)
    ) {
        return Err(Fault::unsupported(
            "the EXR file is compressed with DWA",
            "save it with ZIP or PIZ compression",
        ));
    }
    let (width, height) = (
        header.layer_size.width() as u64,
        header.layer_size.height() as u64,
    );
    let stored: u64 = header
        .channels
        .list
        .iter()
        .map(|c| c.sample_type.bytes_per_sample() as u64)
        .sum();
    let in_memory = 4 * header.channels.list.len() as u64;
    let needed = width
        .saturating_mul(height)
        .saturating_mul(in_memory.max(stored));
    if width == 0 || height == 0 || width > i32::MAX as u64 || height > i32::MAX as u64 {
        return Err(Fault::damaged(format!("an EXR part of {width}x{height}")));
    }
    if needed > limits.max_bytes {
        return Err(Fault::TooLarge {
            width,
            height,
            needed,
            limit: limits.max_bytes,
        });
    }
    // Each block has 8 bytes in the offset table and 8 of its own; no compression shrinks 2048 times.
    const RATIO: u64 = 2048;
    let file_bytes = file_bytes as u64;
    if (header.chunk_count as u64).saturating_mul(16) > file_bytes || needed / RATIO > file_bytes {
        return Err(Fault::damaged(format!(
            "the EXR file is too short for {width}x{height} pixels"
        )));
    }
    Ok(())
}

fn read_part(
    reader: Reader<Cursor<&[u8]>>,
    part: usize,
    file_bytes: usize,
    limits: &Limits,
    wanted: impl Fn(&str) -> bool,
) -> Result<Layers, Fault> {
    // Every part's offset table is read, so every part must be sound.
    for header in reader.headers() {
        if (header.chunk_count as u64).saturating_mul(16) > file_bytes as u64 {
            return Err(Fault::damaged("the EXR file is too short for its blocks"));
        }
    }
    let header = reader.headers()[part].clone();
    check(&header, file_bytes, limits)?;
    let (width, height) = (header.layer_size.width(), header.layer_size.height());
    let mut layers = Layers::new(width as u32, height as u32);
    // For every channel of the file, in its order: where its values go.
    let mut slots = Vec::new();
    for channel in &header.channels.list {
        let name = channel.name.to_string();
        let depth = if channel.sample_type == SampleType::F16 {
            Depth::Half
        } else {
            Depth::Float
        };
        slots.push(wanted(&name).then(|| {
            layers.channels.push(Channel {
                name,
                depth,
                values: vec![0.0; width * height],
            });
            layers.channels.len() - 1
        }));
    }

    let largest = Vec2(0, 0);
    let mut chunks = reader
        .filter_chunks(false, |_, tile, block| {
            block.layer == part && tile.level_index == largest
        })
        .map_err(fault)?;
    let meta = chunks.meta_data().clone();
    let batch_blocks = (BATCH_BYTES / header.max_block_byte_size().max(1)).clamp(1, BATCH_BLOCKS);
    let mut filled = Vec::new();
    loop {
        let batch: Vec<Chunk> = chunks
            .by_ref()
            .take(batch_blocks)
            .collect::<Result<_, _>>()
            .map_err(fault)?;
        if batch.is_empty() {
            break;
        }
        // Before decompressing: only this part was checked.
        if batch.iter().any(|chunk| chunk.layer_index != part) {
            return Err(astray());
        }
        let blocks: Vec<UncompressedBlock> = batch
            .into_par_iter()
            .map(|chunk| UncompressedBlock::decompress_chunk(chunk, &meta, false))
            .collect::<Result<_, _>>()
            .map_err(fault)?;
        for block in blocks {
            if block.index.level != largest {
                return Err(astray());
            }
            let Vec2(x, y) = block.index.pixel_position;
            filled.push((y, x, block.index.pixel_size.area()));
            scatter(&meta, &block, &slots, &mut layers);
        }
    }
    // Two offsets may lead to one block: then another one is missing.
    filled.sort_unstable();
    filled.dedup();
    if filled.iter().map(|f| f.2).sum::<usize>() != width * height {
        return Err(Fault::damaged("blocks of the EXR file are missing"));
    }
    Ok(layers)
}

fn astray() -> Fault {
    Fault::damaged("the EXR file's offset table leads astray")
}

/// Copies a block's lines to where they belong.
fn scatter(
    meta: &MetaData,
    block: &UncompressedBlock,
    slots: &[Option<usize>],
    layers: &mut Layers,
) {
    let channels = &meta.headers[block.index.layer].channels;
    let width = layers.width as usize;
    for line in block.lines(channels) {
        let Some(slot) = slots[line.location.channel] else {
            continue;
        };
        let Vec2(x, y) = line.location.position;
        let start = y * width + x;
        let values = &mut layers.channels[slot].values[start..start + line.location.sample_count];
        // Uncompressed blocks hold samples in this machine's byte order.
        match channels.list[line.location.channel].sample_type {
            SampleType::F16 => {
                for (v, b) in values.iter_mut().zip(line.value.as_chunks::<2>().0) {
                    *v = f16::from_ne_bytes(*b).to_f32();
                }
            }
            SampleType::F32 => {
                for (v, b) in values.iter_mut().zip(line.value.as_chunks::<4>().0) {
                    *v = f32::from_ne_bytes(*b);
                }
            }
            SampleType::U32 => {
                for (v, b) in values.iter_mut().zip(line.value.as_chunks::<4>().0) {
                    *v = u32::from_ne_bytes(*b) as f32;
                }
            }
        }
    }
}

/// The attributes that have a counterpart here, by name.
fn metadata(header: &Header) -> Vec<(String, Attribute)> {
    let own = header.own_attributes.other.iter();
    let mut found: Vec<_> = own
        .chain(&header.shared_attributes.other)
        .filter_map(|(name, value)| {
            let value = match value {
                AttributeValue::Text(v) => Attribute::Text(v.to_string()),
                AttributeValue::I32(v) => Attribute::Int(*v),
                AttributeValue::F32(v) => Attribute::Float(*v),
                AttributeValue::F64(v) => Attribute::Double(*v),
                _ => return None,
            };
            Some((name.to_string(), value))
        })
        .collect();
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}
