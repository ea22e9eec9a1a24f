//! Files in and out, whatever their format.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use rayon::prelude::*;

use crate::error::Fault;
use crate::{
    Attribute, ImageError, Layers, Picture, ToneMap, exr_read, exr_write, hdr, png,
    write_atomically,
};

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// OpenEXR: scene-linear, all layers and metadata.
    Exr,
    /// Radiance RGBE: scene-linear, R, G, B alone.
    Hdr,
    /// PNG: 8-bit sRGB after exposure and tone map.
    Png,
}

impl Format {
    /// What the extension says, in any case.
    pub fn from_extension(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "exr" => Some(Format::Exr),
            "hdr" => Some(Format::Hdr),
            "png" => Some(Format::Png),
            _ => None,
        }
    }

    /// What the first bytes say.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [0x76, 0x2f, 0x31, 0x01, ..] => Some(Format::Exr),
            [b'#', b'?', ..] => Some(Format::Hdr),
            [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n', ..] => Some(Format::Png),
            _ => None,
        }
    }
}

/// How much a file may make the reader allocate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of the file, and bytes of the decoded picture, each. Default 2 GiB.
    pub max_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_bytes: 2 << 30 }
    }
}

/// What the stored numbers meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Scene-linear radiance (EXR, HDR).
    SceneLinear,
    /// Display colours in `[0, 1]` (PNG), here decoded to linear light.
    Display,
}

/// A picture from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Opened {
    /// Linear values, all finite.
    pub picture: Picture,
    /// What they meant.
    pub encoding: Encoding,
    /// Pixels that held NaN or infinity and now hold 0 in those channels. Worth a warning if not 0.
    pub repaired: u64,
}

/// How a PNG looks. EXR and HDR ignore it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Look {
    /// The tone map.
    pub tone_map: ToneMap,
    /// Exposure in stops: radiance is multiplied by 2 to this power first.
    pub exposure_ev: f32,
}

/// Reads the R, G, B of a picture file; the format is told from the content. Of an EXR: the first part that has `R`,
/// `G` and `B` (or `NAME.R`..., or `Y` alone as grey), its data window, the largest resolution.
///
/// # Errors
/// [`ImageError::Read`], [`ImageError::UnknownFormat`], [`ImageError::Invalid`], [`ImageError::TooLarge`].
pub fn read(path: &Path, limits: &Limits) -> Result<Opened, ImageError> {
    decode(&load(path, limits)?, path, limits)
}

/// [`read`] for bytes that are in memory; `path` is for error texts alone.
///
/// # Errors
/// As [`read`].
pub fn decode(bytes: &[u8], path: &Path, limits: &Limits) -> Result<Opened, ImageError> {
    let format = Format::from_bytes(bytes).ok_or_else(|| ImageError::UnknownFormat {
        path: path.to_owned(),
    })?;
    let decoded = match format {
        Format::Exr => exr_read::read_color(bytes, limits),
        Format::Hdr => hdr::read(bytes, limits),
        Format::Png => png::read(bytes, limits),
    };
    let mut picture = decoded.map_err(|fault| fault.at(path))?;
    let repaired = picture.repair();
    let encoding = if format == Format::Png {
        Encoding::Display
    } else {
        Encoding::SceneLinear
    };
    Ok(Opened {
        picture,
        encoding,
        repaired,
    })
}

/// Reads every channel of an EXR's first part, values as stored (NaN and infinity too), and its plain metadata.
///
/// # Errors
/// As [`read`]; a file that is not EXR is an [`ImageError::UnknownFormat`].
pub fn read_layers(path: &Path, limits: &Limits) -> Result<Layers, ImageError> {
    let bytes = load(path, limits)?;
    if Format::from_bytes(&bytes) != Some(Format::Exr) {
        return Err(ImageError::UnknownFormat {
            path: path.to_owned(),
        });
    }
    exr_read::read_all(&bytes, limits).map_err(|fault| fault.at(path))
}

/// The file's bytes, no more of them than allowed: a device may never end.
fn load(path: &Path, limits: &Limits) -> Result<Vec<u8>, ImageError> {
    let failed = |source| ImageError::Read {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(limits.max_bytes.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(failed)?;
    if bytes.len() as u64 > limits.max_bytes {
        let needed = bytes.len() as u64;
        return Err(Fault::TooLarge {
            width: 0,
            height: 0,
            needed,
            limit: limits.max_bytes,
        }
        .at(path));
    }
    Ok(bytes)
}

/// Writes a picture in the format that the extension says, scene-linear for EXR (32-bit float) and HDR, with `look`
/// for PNG.
///
/// # Errors
/// [`ImageError::Destination`] for an unknown extension, [`ImageError::Write`].
pub fn write(path: &Path, picture: &Picture, look: Look) -> Result<(), ImageError> {
    write_layers(
        path,
        &Layers::from_picture(picture, crate::Depth::Float),
        look,
    )
}

/// Writes layers in the format that the extension says: EXR takes all channels and metadata; HDR and PNG take `R`,
/// `G`, `B`, and metadata as comments or text chunks. Atomic; equal layers give equal bytes.
///
/// # Errors
/// [`ImageError::Destination`] for an unknown extension, [`ImageError::Inconsistent`] for channels that do not fit
/// the size, double names, or no `R`, `G`, `B` where the format needs them, [`ImageError::Write`].
pub fn write_layers(path: &Path, layers: &Layers, look: Look) -> Result<(), ImageError> {
    let format = Format::from_extension(path).ok_or_else(|| ImageError::Destination {
        path: path.to_owned(),
        what: "unknown picture format".to_owned(),
        cure: "use the extension .exr, .hdr or .png",
    })?;
    layers.check()?;
    let picture = || {
        layers
            .picture("")
            .ok_or_else(|| ImageError::Inconsistent("HDR and PNG need channels R, G, B".to_owned()))
    };
    match format {
        Format::Exr => write_atomically(path, |mut out| exr_write::write(layers, &mut out)),
        Format::Hdr => {
            let picture = picture()?;
            let mut comments = vec![("Software".to_owned(), SOFTWARE.to_owned())];
            comments.extend(metadata_as_text(layers));
            write_atomically(path, |out| hdr::write(&picture, &comments, out))
        }
        Format::Png => {
            let picture = picture()?;
            let rgb: Vec<[u8; 3]> = picture
                .pixels
                .par_iter()
                .map(|&p| look.tone_map.encode(p, look.exposure_ev))
                .collect();
            let mut text = vec![
                ("Software".to_owned(), SOFTWARE.to_owned()),
                (
                    "Tone map".to_owned(),
                    format!("{} ({})", look.tone_map.name(), look.tone_map.title()),
                ),
                ("Exposure".to_owned(), format!("{} EV", look.exposure_ev)),
            ];
            text.extend(metadata_as_text(layers));
            write_atomically(path, |out| {
                png::write(
                    picture.width,
                    picture.height,
                    rgb.as_flattened(),
                    &text,
                    out,
                )
            })
        }
    }
}

pub(crate) const SOFTWARE: &str = concat!("occlude ", env!("CARGO_PKG_VERSION"));

fn metadata_as_text(layers: &Layers) -> Vec<(String, String)> {
    let mut text: Vec<_> = layers
        .metadata
        .iter()
        .map(|(name, value)| {
            let value = match value {
                Attribute::Text(v) => v.clone(),
                Attribute::Int(v) => v.to_string(),
                Attribute::Float(v) => v.to_string(),
                Attribute::Double(v) => v.to_string(),
            };
            (name.clone(), value)
        })
        .collect();
    text.sort();
    text
}
