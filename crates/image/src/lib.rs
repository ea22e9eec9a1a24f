//! Pictures of the renderer: reading and writing EXR, Radiance HDR and PNG, tone mapping, error metrics and comparison
//! reports.
//!
//! A [`Picture`] holds scene-linear Rec. 709 radiance. EXR and HDR files store exactly that; exposure and a [`ToneMap`]
//! apply to PNG alone. [`Layers`] is the general case: any named channels with metadata, stored as EXR.
//!
//! Files are read defensively: what a header claims is never allocated before the file's own length supports it, and
//! every failure is an [`ImageError`] whose text is one line. Files are written beside their name and renamed when
//! whole ([`write_atomically`]); equal content gives equal bytes.
//!
//! Not for textures: 8-bit material images with alpha belong to the scene's loader.

mod atomic;
mod codec;
mod error;
mod exr_read;
mod exr_write;
mod film;
mod hdr;
mod layers;
mod magma;
pub mod metrics;
mod picture;
mod png;
mod report;
mod rows;
mod tone;

pub use atomic::{check_place, check_writable, write_atomically};
pub use codec::{
    Encoding, Format, Limits, Look, Opened, decode, read, read_layers, write, write_layers,
};
pub use error::ImageError;
pub use film::{FilmFormat, read_display_bytes, write_film};
pub use layers::{Attribute, Channel, Depth, Layers};
pub use picture::Picture;
pub use report::{Named, write_map, write_report};
pub use rows::{write_exr_rows, write_png_rows};
pub use tone::{ToneMap, srgb_decode, srgb_encode};

#[cfg(test)]
mod tests;
