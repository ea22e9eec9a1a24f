//! Images and how they are sampled.

use glam::Vec4;

/// Decoded pixels, row by row from the top, RGBA.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// 8 bits a channel.
    Rgba8(Vec<[u8; 4]>),
    /// 16 bits a channel.
    Rgba16(Vec<[u16; 4]>),
}

/// A decoded image.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Name or file name; may be empty.
    pub name: String,
    /// Pixels a row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// The pixels.
    pub texels: Texels,
}

/// What happens to coordinates outside of `[0, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Repeats.
    #[default]
    Repeat,
    /// Repeats, every second copy mirrored.
    Mirror,
    /// The border pixel goes on.
    Clamp,
}

/// How values between texel centres are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// The nearest texel.
    Nearest,
    /// Bilinear, of values decoded to linear light first.
    #[default]
    Linear,
}

/// How a texture is sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sampler {
    /// Horizontal wrapping.
    pub wrap_u: Wrap,
    /// Vertical wrapping.
    pub wrap_v: Wrap,
    /// Magnification filter.
    pub filter: Filter,
}

/// An image and a sampler, and how its bytes are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Index into [`Scene::images`](crate::Scene::images).
    pub image: u32,
    /// Wrapping and filtering.
    pub sampler: Sampler,
    /// Whether the colour channels are sRGB-encoded (base colour, emission, sheen and specular colour) or plain numbers.
    pub srgb: bool,
}

impl Texture {
    /// The texture's value at `uv`: linear RGBA, each in `[0, 1]`.
    ///
    /// UV (0, 0) is the corner of the top left texel; texel centres are at `(i + 0.5) / size`. sRGB is decoded before
    /// filtering. Non-finite coordinates count as 0. No mip maps.
    pub fn sample(&self, images: &[Image], uv: [f32; 2]) -> Vec4 {
        let _ = (images, uv);
        todo!("loader helper implements this")
    }
}
