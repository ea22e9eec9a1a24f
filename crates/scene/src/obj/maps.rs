//! Pictures that materials refer to: read once, and turned into what glTF's material model wants.

use super::mtl::Map;
use super::read_beside;
use crate::input::Budget;
use crate::{
    Filter, Image, Sampler, SceneError, Texels, Texture, TextureRef, Warning, Wrap, image_file,
};
use glam::{Affine2, Mat2, Vec2, Vec3};
use std::collections::BTreeMap;
use std::path::Path;

/// How a picture is used.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Treatment {
    /// As it is.
    Plain,
    /// Heights become normals; the bits of the factor on heights.
    Heights(u32),
    /// Takes its alpha from another file.
    Alpha(String),
    /// White, with its grey or alpha as alpha.
    OnlyAlpha,
}

/// The scene's images and textures while materials are made.
pub(super) struct Maps<'a> {
    folder: &'a Path,
    pub images: Vec<Image>,
    pub textures: Vec<Texture>,
    known: BTreeMap<(String, Treatment), u32>,
    pub warnings: Vec<Warning>,
    budget: &'a mut Budget,
}

impl<'a> Maps<'a> {
    pub fn new(folder: &'a Path, budget: &'a mut Budget) -> Self {
        Self {
            folder,
            images: Vec::new(),
            textures: Vec::new(),
            known: BTreeMap::new(),
            warnings: Vec::new(),
            budget,
        }
    }

    /// A picture as it is.
    pub fn plain(&mut self, map: &Map, srgb: bool) -> Result<TextureRef, SceneError> {
        let image = self.image(&map.file, Treatment::Plain)?;
        Ok(self.texture(image, map, srgb))
    }

    /// A bump map as a normal map. A picture that is bluish throughout is taken for a normal map already.
    pub fn normals(&mut self, map: &Map) -> Result<TextureRef, SceneError> {
        let image = self.image(&map.file, Treatment::Heights(map.bump.to_bits()))?;
        Ok(self.texture(image, map, false))
    }

    /// Base colour with the alpha of another picture, and whether that alpha is (nearly) all or nothing.
    pub fn with_alpha(
        &mut self,
        color: Option<&Map>,
        alpha: &Map,
    ) -> Result<(TextureRef, bool), SceneError> {
        let image = match color {
            Some(color) => self.image(&color.file, Treatment::Alpha(alpha.file.clone()))?,
            None => self.image(&alpha.file, Treatment::OnlyAlpha)?,
        };
        let texels = self.images[image as usize].texels.clone();
        let binary = match texels {
            Texels::Rgba8(t) => is_binary(t.iter().map(|t| f32::from(t[3]) / 255.0)),
            Texels::Rgba16(t) => is_binary(t.iter().map(|t| f32::from(t[3]) / 65535.0)),
        };
        Ok((self.texture(image, color.unwrap_or(alpha), true), binary))
    }

    fn texture(&mut self, image: u32, map: &Map, srgb: bool) -> TextureRef {
        let wrap = if map.clamp { Wrap::Clamp } else { Wrap::Repeat };
        let sampler = Sampler {
            wrap_u: wrap,
            wrap_v: wrap,
            filter: Filter::Linear,
        };
        let texture = Texture {
            image,
            sampler,
            srgb,
        };
        let known = self.textures.iter().position(|t| *t == texture);
        let index = known.unwrap_or_else(|| {
            self.textures.push(texture);
            self.textures.len() - 1
        });
        // MTL scales and shifts coordinates whose v grows upwards: 1 - v' = s (1 - v) + o.
        let (scale, offset) = (Vec2::from(map.scale), Vec2::from(map.offset));
        let transform = Affine2::from_mat2_translation(
            Mat2::from_diagonal(scale),
            Vec2::new(offset.x, 1.0 - scale.y - offset.y),
        );
        let transform = if transform.is_finite() {
            transform
        } else {
            Affine2::IDENTITY
        };
        TextureRef {
            texture: index as u32,
            uv_set: 0,
            transform,
        }
    }

    fn image(&mut self, file: &str, treatment: Treatment) -> Result<u32, SceneError> {
        let key = (file.to_owned(), treatment);
        if let Some(&known) = self.known.get(&key) {
            return Ok(known);
        }
        let picture = self.decode(file)?;
        let picture = match &key.1 {
            Treatment::Plain => picture,
            Treatment::Heights(factor) => normals_of(picture, f32::from_bits(*factor)),
            Treatment::OnlyAlpha => {
                let alpha = alpha_of(&picture);
                masked(&white(&picture), &alpha)
            }
            Treatment::Alpha(file) => {
                let alpha = alpha_of(&self.decode(file)?);
                masked(&picture, &alpha)
            }
        };
        self.images.push(picture);
        let index = self.images.len() as u32 - 1;
        self.known.insert(key, index);
        Ok(index)
    }

    /// Reads a picture. One that cannot be read is named and becomes magenta, so that it is seen.
    fn decode(&mut self, file: &str) -> Result<Image, SceneError> {
        let decoded = read_beside(self.folder, file, self.budget)?.and_then(|bytes| {
            let left = self.budget.left().unwrap_or(image_file::MAX_BYTES);
            image_file::decode_within(&bytes, file, left)
        });
        match decoded {
            Ok(image) => {
                self.budget
                    .reserve(u64::from(image.width) * u64::from(image.height) * 4)?;
                Ok(image)
            }
            Err(why) => {
                let what = format!("cannot be used, replaced by magenta: {why}");
                self.warnings
                    .push(super::warning(&format!("texture {file}"), &what));
                Ok(Image {
                    name: file.to_owned(),
                    width: 1,
                    height: 1,
                    texels: Texels::Rgba8(vec![[255, 0, 255, 255]]),
                })
            }
        }
    }
}

/// Whether nearly all values are 0 or 1.
fn is_binary(alphas: impl Iterator<Item = f32>) -> bool {
    let (mut all, mut between) = (0u64, 0u64);
    for a in alphas {
        all += 1;
        between += u64::from((0.1..=0.9).contains(&a));
    }
    between * 10 <= all
}

/// 8-bit RGBA of any picture.
fn bytes(image: &Image) -> Vec<[u8; 4]> {
    match &image.texels {
        Texels::Rgba8(t) => t.clone(),
        Texels::Rgba16(t) => t.iter().map(|t| t.map(|c| (c >> 8) as u8)).collect(),
    }
}

fn white(image: &Image) -> Image {
    let count = image.width as usize * image.height as usize;
    Image {
        texels: Texels::Rgba8(vec![[255; 4]; count]),
        ..image.clone()
    }
}

/// A picture's opacity: its alpha channel if it says anything, otherwise its grey. In the red channel.
fn alpha_of(image: &Image) -> Image {
    let texels = bytes(image);
    let has_alpha = texels.iter().any(|t| t[3] != 255);
    let texels = texels
        .iter()
        .map(|t| if has_alpha { [t[3]; 4] } else { [t[0]; 4] })
        .collect();
    Image {
        texels: Texels::Rgba8(texels),
        ..image.clone()
    }
}

/// `color` with `alpha`'s values as its alpha, both at the larger size.
fn masked(color: &Image, alpha: &Image) -> Image {
    let (width, height) = if u64::from(color.width) * u64::from(color.height)
        >= u64::from(alpha.width) * u64::from(alpha.height)
    {
        (color.width, color.height)
    } else {
        (alpha.width, alpha.height)
    };
    let (color_texels, alpha_texels) = (bytes(color), bytes(alpha));
    let at = |image: &Image, x: u32, y: u32| {
        let near =
            |i: u32, size: u32, of: u32| (u64::from(i) * u64::from(of) / u64::from(size)) as usize;
        near(y, height, image.height) * image.width as usize + near(x, width, image.width)
    };
    let mut texels = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height {
        for x in 0..width {
            let [r, g, b, _] = color_texels[at(color, x, y)];
            texels.push([r, g, b, alpha_texels[at(alpha, x, y)][0]]);
        }
    }
    Image {
        name: color.name.clone(),
        width,
        height,
        texels: Texels::Rgba8(texels),
    }
}

/// Normals of a height field: black to white is `factor` texels high, borders repeat.
fn normals_of(image: Image, factor: f32) -> Image {
    let texels = bytes(&image);
    let count = texels.len().max(1) as u64;
    let sum = |channel: usize| texels.iter().map(|t| u64::from(t[channel])).sum::<u64>() / count;
    if sum(2) > 180 && sum(2) > sum(0) + 50 {
        return image;
    }
    let (width, height) = (image.width as usize, image.height as usize);
    let h = |x: usize, y: usize| f32::from(texels[y % height * width + x % width][0]) / 255.0;
    let mut normals = Vec::with_capacity(texels.len());
    for y in 0..height {
        for x in 0..width {
            let across = h(x + 1, y) - h(x + width - 1, y);
            let down = h(x, y + 1) - h(x, y + height - 1);
            // glTF's green points up in the picture.
            let n =
                Vec3::new(-across * factor / 2.0, down * factor / 2.0, 1.0).normalize_or(Vec3::Z);
            let [r, g, b] = ((n * 0.5 + 0.5) * 255.0)
                .round()
                .to_array()
                .map(|c| c as u8);
            normals.push([r, g, b, 255]);
        }
    }
    Image {
        texels: Texels::Rgba8(normals),
        ..image
    }
}
