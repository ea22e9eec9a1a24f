//! Films as files: checkpoints and shards.
//!
//! Layout, little-endian: 8 bytes magic, `u64` length of a JSON header, the header, then radiance, squares, samples,
//! features and splats as flat arrays, and what the caller keeps beside them. The header says which work the film belongs to (a fingerprint) and which samples it holds;
//! who reads a film for another work gets an error, not a wrong picture.

use super::splats::SplatSums;
use super::{FeatureSums, Film, FixedSum};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};

const MAGIC: [u8; 8] = *b"OCCFILM1";

/// Headers are small; a longer one is damage.
const MAX_HEADER: u64 = 1 << 20;

/// Why a film could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FilmError {
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// Not a film, or a damaged one.
    #[error("{0}")]
    Damaged(&'static str),
}

#[derive(Serialize, Deserialize)]
struct Header<M> {
    width: u32,
    height: u32,
    features: bool,
    #[serde(default)]
    splats: bool,
    dropped: u64,
    /// Bytes behind the arrays.
    #[serde(default)]
    beside: u64,
    meta: M,
}

impl Film {
    /// Writes the film with a header of the caller's, and `beside` behind it.
    pub fn write<M: Serialize>(
        &self,
        meta: &M,
        beside: &[u8],
        out: &mut impl Write,
    ) -> std::io::Result<()> {
        let header = Header {
            width: self.width,
            height: self.height,
            features: self.has_features(),
            splats: self.has_splats(),
            dropped: self.dropped,
            beside: beside.len() as u64,
            meta,
        };
        let header = serde_json::to_vec(&header)?;
        out.write_all(&MAGIC)?;
        out.write_all(&(header.len() as u64).to_le_bytes())?;
        out.write_all(&header)?;
        out.write_all(bytemuck::cast_slice(&self.radiance))?;
        out.write_all(bytemuck::cast_slice(&self.squares))?;
        out.write_all(bytemuck::cast_slice(&self.samples))?;
        if let Some(features) = &self.features {
            out.write_all(bytemuck::cast_slice(features))?;
        }
        if let Some(splats) = &self.splats {
            out.write_all(bytemuck::cast_slice(splats))?;
        }
        out.write_all(beside)
    }

    /// Reads a film, its header, and what was written beside it. `available` is the number of bytes that the source holds: nothing larger is allocated.
    pub fn read<M: for<'a> Deserialize<'a>>(
        source: &mut impl Read,
        available: u64,
    ) -> Result<(Self, M, Vec<u8>), FilmError> {
        let mut magic = [0; 8];
        source.read_exact(&mut magic)?;
        if magic != MAGIC {
            return Err(FilmError::Damaged("not a film file"));
        }
        let mut length = [0; 8];
        source.read_exact(&mut length)?;
        let length = u64::from_le_bytes(length);
        if length > MAX_HEADER.min(available) {
            return Err(FilmError::Damaged("film header is damaged"));
        }
        let mut header = vec![0; length as usize];
        source.read_exact(&mut header)?;
        let header: Header<M> = serde_json::from_slice(&header)
            .map_err(|_| FilmError::Damaged("film header is damaged or of another version"))?;
        let splat_bytes = if header.splats {
            Film::splat_bytes(header.width, header.height)
        } else {
            0
        };
        if Film::bytes(header.width, header.height, header.features)
            .saturating_add(splat_bytes)
            .saturating_add(header.beside)
            .saturating_add(length + 16)
            != available
        {
            return Err(FilmError::Damaged("film file is cut short or too long"));
        }
        let mut film = Film::new(header.width, header.height, header.features);
        film.dropped = header.dropped;
        source.read_exact(bytemuck::cast_slice_mut::<[FixedSum; 3], u8>(
            &mut film.radiance,
        ))?;
        source.read_exact(bytemuck::cast_slice_mut(&mut film.squares))?;
        source.read_exact(bytemuck::cast_slice_mut(&mut film.samples))?;
        if let Some(features) = &mut film.features {
            source.read_exact(bytemuck::cast_slice_mut::<FeatureSums, u8>(features))?;
        }
        if header.splats {
            film.enable_splats();
        }
        if let Some(splats) = &mut film.splats {
            source.read_exact(bytemuck::cast_slice_mut::<SplatSums, u8>(splats))?;
        }
        let mut beside = vec![0; header.beside as usize];
        source.read_exact(&mut beside)?;
        Ok((film, header.meta, beside))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_film_survives_a_file_and_damage_is_an_error() {
        let mut film = Film::new(3, 2, true);
        film.add(
            2,
            1,
            Vec3::new(0.1, 7.0, 3e5),
            Some(&super::super::Features::default()),
        );
        film.enable_splats();
        film.splat(&super::super::Splat {
            x: 1,
            y: 1,
            radiance: Vec3::new(2.0, 0.0, 1.5),
        });
        let mut bytes = Vec::new();
        film.write(&"meta".to_string(), b"beside", &mut bytes)
            .unwrap();
        let (read, meta, beside): (Film, String, Vec<u8>) =
            Film::read(&mut bytes.as_slice(), bytes.len() as u64).unwrap();
        assert_eq!((&read, meta.as_str()), (&film, "meta"));
        assert_eq!(beside, b"beside");
        for cut in 0..bytes.len() {
            assert!(Film::read::<String>(&mut &bytes[..cut], cut as u64).is_err());
        }
        for i in 0..40 {
            let mut damaged = bytes.clone();
            damaged[i] ^= 0x55;
            let _ = Film::read::<String>(&mut damaged.as_slice(), damaged.len() as u64);
        }
    }
}
