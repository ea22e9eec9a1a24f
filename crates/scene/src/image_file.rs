//! Decodes the images that materials refer to: PNG, JPEG and WebP.
//!
//! What the file claims is believed only as far as its length supports it: a PNG cannot unpack to more than about 1032
//! times its size (deflate), a JPEG spends at least one bit on a block of 64 pixels. So a tiny file that announces
//! gigapixels is refused before anything is allocated. WebP can code a single colour in almost nothing; there a fixed
//! number of pixels is allowed on top.

use crate::{Image, Texels};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// No image has more pixels a side.
const MAX_SIDE: u32 = 1 << 16;
/// Bytes that one image may take if nothing else was said.
pub(crate) const MAX_BYTES: u64 = 1 << 30;

/// Decodes an image file held in memory; 16-bit files keep their 16 bits, grey and RGB become RGBA.
pub(crate) fn decode(bytes: &[u8], name: &str) -> Result<Image, String> {
    decode_within(bytes, name, MAX_BYTES)
}

/// As [`decode`], with a limit on the bytes of the decoded picture.
pub(crate) fn decode_within(bytes: &[u8], name: &str, max_bytes: u64) -> Result<Image, String> {
    let reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| e.to_string())?;
    let format = reader
        .format()
        .ok_or("not a PNG, JPEG or WebP file".to_string())?;
    let (width, height) = reader.into_dimensions().map_err(|e| e.to_string())?;
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 {
        return Err("an image without pixels".into());
    }
    let plausible = plausible_pixels(format, bytes.len() as u64);
    if pixels > plausible || pixels.saturating_mul(4) > max_bytes {
        return Err(format!(
            "claims {width} x {height} pixels, which {} bytes of file cannot hold or the memory limit forbids",
            bytes.len()
        ));
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    // Decoders may need a copy and tables beside the picture itself, at up to 8 bytes a pixel.
    limits.max_alloc = Some(max_bytes.min(pixels.saturating_mul(24).saturating_add(1 << 24)));
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| e.to_string())?;
    Ok(Image {
        name: name.to_owned(),
        width: decoded.width(),
        height: decoded.height(),
        texels: texels(decoded),
    })
}

/// The most pixels that a file of this many bytes can really hold.
fn plausible_pixels(format: ImageFormat, bytes: u64) -> u64 {
    match format {
        // 1032 unpacked bytes a byte, and down to 1 bit a pixel.
        ImageFormat::Png => bytes.saturating_mul(1032 * 8),
        // At least one bit for a block of 8 x 8; chroma may be sampled 4 x 4 times more coarsely, luma never is.
        ImageFormat::Jpeg => bytes.saturating_mul(64 * 8 * 2),
        _ => bytes.saturating_mul(2048).saturating_add(1 << 24),
    }
}

fn texels(decoded: DynamicImage) -> Texels {
    match decoded {
        DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_) => {
            let raw = decoded.into_rgba16().into_raw();
            Texels::Rgba16(raw.as_chunks::<4>().0.to_vec())
        }
        _ => {
            let raw = decoded.into_rgba8().into_raw();
            Texels::Rgba8(raw.as_chunks::<4>().0.to_vec())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(width: u32, height: u32) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        image::RgbaImage::from_fn(width, height, |x, y| {
            image::Rgba([x as u8, y as u8, 7, 200])
        })
        .write_to(&mut out, ImageFormat::Png)
        .unwrap();
        out.into_inner()
    }

    #[test]
    fn png_keeps_its_pixels() {
        let image = decode(&png(3, 2), "a").unwrap();
        assert_eq!((image.width, image.height), (3, 2));
        assert_eq!(
            image.texels,
            Texels::Rgba8(vec![
                [0, 0, 7, 200],
                [1, 0, 7, 200],
                [2, 0, 7, 200],
                [0, 1, 7, 200],
                [1, 1, 7, 200],
                [2, 1, 7, 200]
            ])
        );
    }

    #[test]
    fn sixteen_bits_stay() {
        let mut out = Cursor::new(Vec::new());
        let grey = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(1, 1, vec![0x1234]).unwrap();
        DynamicImage::ImageLuma16(grey)
            .write_to(&mut out, ImageFormat::Png)
            .unwrap();
        let image = decode(&out.into_inner(), "").unwrap();
        assert_eq!(
            image.texels,
            Texels::Rgba16(vec![[0x1234, 0x1234, 0x1234, 0xffff]])
        );
    }

    #[test]
    fn a_lying_header_is_refused() {
        let mut bytes = png(3, 2);
        bytes[16..20].copy_from_slice(&60_000u32.to_be_bytes());
        bytes[20..24].copy_from_slice(&60_000u32.to_be_bytes());
        // The header's checksum must fit, or the file would be refused for that alone.
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        let error = decode(&bytes, "").unwrap_err();
        assert!(error.contains("60000 x 60000"), "{error}");
    }

    #[test]
    fn garbage_is_an_error() {
        assert!(decode(b"", "").is_err());
        assert!(decode(b"not an image at all", "").is_err());
        let whole = png(16, 16);
        assert!(decode(&whole[..whole.len() / 2], "").is_err());
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0u32, |mut crc, &b| {
            crc ^= u32::from(b);
            for _ in 0..8 {
                crc = (crc >> 1) ^ (0xedb8_8320 * (crc & 1));
            }
            crc
        })
    }
}
