//! Images and how they are sampled.

use glam::Vec4;
use std::sync::LazyLock;

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
        let Some(image) = images.get(self.image as usize) else {
            return Vec4::ZERO;
        };
        let (width, height) = (image.width as usize, image.height as usize);
        match &image.texels {
            Texels::Rgba8(texels) if self.srgb => {
                let lut = &*SRGB8;
                let decode = |[r, g, b, a]: [u8; 4]| {
                    let linear = |c: u8| lut[usize::from(c)];
                    Vec4::new(
                        linear(r),
                        linear(g),
                        linear(b),
                        f32::from(a) * (1.0 / 255.0),
                    )
                };
                self.filtered(texels, width, height, uv, decode)
            }
            Texels::Rgba8(texels) => {
                let decode = |c: [u8; 4]| Vec4::from(c.map(f32::from)) * (1.0 / 255.0);
                self.filtered(texels, width, height, uv, decode)
            }
            Texels::Rgba16(texels) => {
                let decode = |c: [u16; 4]| {
                    let [r, g, b, a] = c.map(|c| f32::from(c) * (1.0 / 65535.0));
                    match self.srgb {
                        true => {
                            Vec4::new(srgb_to_linear(r), srgb_to_linear(g), srgb_to_linear(b), a)
                        }
                        false => Vec4::new(r, g, b, a),
                    }
                };
                self.filtered(texels, width, height, uv, decode)
            }
        }
    }

    #[inline]
    fn filtered<T: Copy>(
        &self,
        texels: &[T],
        width: usize,
        height: usize,
        uv: [f32; 2],
        decode: impl Fn(T) -> Vec4,
    ) -> Vec4 {
        let texel =
            |x: usize, y: usize| texels.get(y * width + x).map_or(Vec4::ZERO, |&t| decode(t));
        let Sampler {
            wrap_u,
            wrap_v,
            filter,
        } = self.sampler;
        let (u, v) = (wrap_u.fold(uv[0]), wrap_v.fold(uv[1]));
        if filter == Filter::Nearest {
            // Truncation is the floor here, for folded coordinates are not negative.
            let x = ((u * width as f32) as usize).min(width - 1);
            let y = ((v * height as f32) as usize).min(height - 1);
            return texel(x, y);
        }
        let (x0, x1, fx) = wrap_u.neighbours(u, width);
        let (y0, y1, fy) = wrap_v.neighbours(v, height);
        let top = texel(x0, y0) * (1.0 - fx) + texel(x1, y0) * fx;
        let bottom = texel(x0, y1) * (1.0 - fx) + texel(x1, y1) * fx;
        top * (1.0 - fy) + bottom * fy
    }
}

impl Wrap {
    /// Brings a coordinate into `[0, 1]`.
    #[inline]
    fn fold(self, u: f32) -> f32 {
        if !u.is_finite() {
            return 0.0;
        }
        match self {
            Self::Repeat => u - u.floor(),
            Self::Mirror => {
                let twice = u - 2.0 * (0.5 * u).floor();
                1.0 - (1.0 - twice).abs()
            }
            Self::Clamp => u.clamp(0.0, 1.0),
        }
    }

    /// The two texels beside a folded coordinate and the weight of the second.
    #[inline]
    fn neighbours(self, u: f32, size: usize) -> (usize, usize, f32) {
        let x = u * size as f32 - 0.5;
        let floor = x.floor();
        // From -1 to size - 1, as the coordinate is in [0, 1].
        let low = floor as i64;
        let last = size as i64 - 1;
        let (a, b) = match self {
            Self::Repeat => (
                if low < 0 { last } else { low },
                if low >= last { 0 } else { low + 1 },
            ),
            // The texel over a mirrored edge is the one before it: the same as holding it.
            Self::Mirror | Self::Clamp => (low.max(0), (low + 1).min(last)),
        };
        (a.min(last) as usize, b as usize, x - floor)
    }
}

/// IEC 61966-2-1: the linear value of an sRGB-encoded one.
fn srgb_to_linear(c: f32) -> f32 {
    if c <= 0.04045 {
        c / 12.92
    } else {
        ((c + 0.055) / 1.055).powf(2.4)
    }
}

/// [`srgb_to_linear`] of `i / 255`.
static SRGB8: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let c = i as f64 / 255.0;
        let linear = if c <= 0.04045 {
            c / 12.92
        } else {
            ((c + 0.055) / 1.055).powf(2.4)
        };
        linear as f32
    })
});
