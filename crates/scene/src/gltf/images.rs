//! Textures and the images behind them.
//!
//! Only what a material uses is decoded, in parallel. An image that cannot be decoded becomes one magenta texel and a
//! warning, for a scene with a wrong texture is still worth seeing.

use super::document::{TextureInfo, TextureTransform};
use super::source::Source;
use crate::input::Budget;
use crate::{
    Filter, Image, Sampler, SceneError, Texels, Texture, TextureRef, Warning, Wrap, image_file,
};
use glam::{Affine2, Vec2};
use image::ImageReader;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;

const KTX2_MAGIC: &[u8] = b"\xabKTX 20\xbb\r\n\x1a\n";

/// Collects the textures that materials ask for.
pub(super) struct Textures<'a> {
    source: &'a Source,
    /// The file's image behind each of ours; `None`: the texture names none.
    images: Vec<Option<u32>>,
    /// Ours, by the file's texture and whether it is sRGB.
    known: BTreeMap<(u32, bool), u32>,
    textures: Vec<Texture>,
    pub warnings: Vec<Warning>,
}

/// All textures and their decoded images.
pub(super) struct Pictures {
    pub textures: Vec<Texture>,
    pub images: Vec<Image>,
    pub warnings: Vec<Warning>,
}

impl<'a> Textures<'a> {
    pub fn new(source: &'a Source) -> Self {
        Self {
            source,
            images: Vec::new(),
            known: BTreeMap::new(),
            textures: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Our name for a texture that a material uses.
    pub fn reference(
        &mut self,
        info: Option<&TextureInfo>,
        srgb: bool,
        place: &str,
    ) -> Result<Option<TextureRef>, SceneError> {
        let Some(info) = info else {
            return Ok(None);
        };
        let texture = match self.known.get(&(info.index, srgb)) {
            Some(&known) => known,
            None => {
                let texture = self.texture(info.index, srgb, place)?;
                self.textures.push(texture);
                let index = self.textures.len() as u32 - 1;
                self.known.insert((info.index, srgb), index);
                index
            }
        };
        let transform = info.extensions.transform.as_ref();
        let mut uv_set = transform
            .and_then(|t| t.tex_coord)
            .unwrap_or(info.tex_coord);
        if uv_set > 1 {
            let what =
                format!("uses TEXCOORD_{uv_set}; two UV sets are supported, the first is used");
            self.warnings.push(Warning::new(place, &what));
            uv_set = 0;
        }
        let transform = transform.map_or(Affine2::IDENTITY, uv_transform);
        Ok(Some(TextureRef {
            texture,
            uv_set,
            transform,
        }))
    }

    fn texture(&mut self, index: u32, srgb: bool, place: &str) -> Result<Texture, SceneError> {
        let missing = |what: String| Err(self.source.fault(place, &what, "export the file again"));
        let document = &self.source.document;
        let Some(entry) = document.textures.get(index as usize) else {
            return missing(format!("refers to texture {index}, which does not exist"));
        };
        let sampler = match entry.sampler {
            None => Sampler::default(),
            Some(s) => match document.samplers.get(s as usize) {
                Some(sampler) => Sampler {
                    wrap_u: wrap(sampler.wrap_s),
                    wrap_v: wrap(sampler.wrap_t),
                    filter: if sampler.mag_filter == Some(9728) {
                        Filter::Nearest
                    } else {
                        Filter::Linear
                    },
                },
                None => {
                    return missing(format!(
                        "texture {index} refers to sampler {s}, which does not exist"
                    ));
                }
            },
        };
        let extensions = &entry.extensions;
        let image = extensions.webp.as_ref().map(|w| w.source).or(entry.source);
        let image = image.or(extensions.basisu.as_ref().map(|b| b.source));
        if let Some(i) = image.filter(|&i| i as usize >= document.images.len()) {
            return missing(format!(
                "texture {index} refers to image {i}, which does not exist"
            ));
        }
        let ours = match self.images.iter().position(|&known| known == image) {
            Some(ours) => ours,
            None => {
                self.images.push(image);
                self.images.len() - 1
            }
        };
        Ok(Texture {
            image: ours as u32,
            sampler,
            srgb,
        })
    }

    /// Decodes all images that were asked for.
    pub fn decode(mut self, budget: &mut Budget) -> Result<Pictures, SceneError> {
        let mut encoded = Vec::with_capacity(self.images.len());
        for &image in &self.images {
            encoded.push(fetch(self.source, image, budget)?);
        }
        let decoded: Vec<_> = encoded
            .into_par_iter()
            .map(|(name, bytes)| (bytes.and_then(|bytes| decode(&name, &bytes)), name))
            .collect();
        let mut images = Vec::with_capacity(decoded.len());
        for (image, name) in decoded {
            images.push(image.unwrap_or_else(|why| {
                let what = format!("texture cannot be used, magenta stands in: {why}");
                self.warnings.push(Warning::new(&name, &what));
                Image {
                    name,
                    width: 1,
                    height: 1,
                    texels: Texels::Rgba8(vec![[255, 0, 255, 255]]),
                }
            }));
        }
        Ok(Pictures {
            textures: self.textures,
            images,
            warnings: self.warnings,
        })
    }
}

/// `KHR_texture_transform`: scale, then turn counter-clockwise as seen with v downwards, then move.
fn uv_transform(t: &TextureTransform) -> Affine2 {
    Affine2::from_scale_angle_translation(Vec2::from(t.scale), -t.rotation, Vec2::from(t.offset))
}

fn wrap(code: Option<u32>) -> Wrap {
    match code {
        Some(33071) => Wrap::Clamp,
        Some(33648) => Wrap::Mirror,
        _ => Wrap::Repeat,
    }
}

type Encoded<'a> = (String, Result<Cow<'a, [u8]>, String>);

/// Name and bytes of an image; takes its decoded size from the budget.
fn fetch<'a>(
    source: &'a Source,
    image: Option<u32>,
    budget: &mut Budget,
) -> Result<Encoded<'a>, SceneError> {
    let Some(index) = image else {
        return Ok((
            "texture without an image".to_string(),
            Err("it names no image".to_string()),
        ));
    };
    let entry = &source.document.images[index as usize];
    let file = entry.uri.as_deref().filter(|uri| !uri.starts_with("data:"));
    let name = match (entry.name.as_str(), file) {
        ("", Some(file)) => file.to_string(),
        ("", None) => format!("image {index}"),
        (name, _) => name.to_string(),
    };
    let bytes = match (&entry.uri, entry.buffer_view) {
        (Some(uri), _) => source.read_uri(uri, &name, budget),
        (None, Some(view)) => source.view(view, &name).map(|v| Cow::Borrowed(v.bytes)),
        (None, None) => return Ok((name, Err("it has no data".to_string()))),
    };
    let bytes = match bytes {
        Ok(bytes) => bytes,
        Err(memory @ SceneError::Memory { .. }) => return Err(memory),
        Err(other) => return Ok((name, Err(other.to_string()))),
    };
    if let Ok((width, height)) = size(&bytes) {
        budget.reserve(u64::from(width) * u64::from(height) * 4)?;
    }
    Ok((name, Ok(bytes)))
}

fn size(bytes: &[u8]) -> Result<(u32, u32), String> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let reader = reader.map_err(|e| e.to_string())?;
    reader.into_dimensions().map_err(|e| e.to_string())
}

fn decode(name: &str, bytes: &[u8]) -> Result<Image, String> {
    if bytes.starts_with(KTX2_MAGIC) {
        let what = "KTX2 (KHR_texture_basisu) is not supported: export PNG, JPEG or WebP";
        return Err(what.to_string());
    }
    image_file::decode(bytes, name)
}
