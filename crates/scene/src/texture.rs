//! Images and how they are sampled.

use crate::prefetch;
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

    /// Asks memory for the texels that [`Texture::sample`] will read at `uv`.
    pub fn prefetch(&self, images: &[Image], uv: [f32; 2]) {
        let Some(image) = images.get(self.image as usize) else {
            return;
        };
        let (width, height) = (image.width as usize, image.height as usize);
        let Sampler { wrap_u, wrap_v, .. } = self.sampler;
        let (x, ..) = wrap_u.neighbours(wrap_u.fold(uv[0]), width);
        let (above, below, _) = wrap_v.neighbours(wrap_v.fold(uv[1]), height);
        for y in [above, below] {
            match &image.texels {
                Texels::Rgba8(texels) => prefetch(texels, y * width + x),
                Texels::Rgba16(texels) => prefetch(texels, y * width + x),
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
            Self::Repeat => u - floor(u),
            Self::Mirror => {
                let twice = u - 2.0 * floor(0.5 * u);
                1.0 - (1.0 - twice).abs()
            }
            Self::Clamp => u.clamp(0.0, 1.0),
        }
    }

    /// The two texels beside a folded coordinate and the weight of the second.
    #[inline]
    fn neighbours(self, u: f32, size: usize) -> (usize, usize, f32) {
        let x = u * size as f32 - 0.5;
        let floor = floor(x);
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

/// [`f32::floor`] without a call, on processors that have no instruction for it.
#[inline]
fn floor(x: f32) -> f32 {
    /// From here on every number is whole.
    const WHOLE: f32 = 8_388_608.0;
    if x.abs() >= WHOLE {
        return x;
    }
    let truncated = x as i32 as f32;
    if truncated > x {
        truncated - 1.0
    } else {
        truncated
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

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, texels: Vec<[u8; 4]>) -> Vec<Image> {
        vec![Image {
            name: String::new(),
            width,
            height,
            texels: Texels::Rgba8(texels),
        }]
    }

    fn texture(wrap: Wrap, filter: Filter, srgb: bool) -> Texture {
        Texture {
            image: 0,
            sampler: Sampler {
                wrap_u: wrap,
                wrap_v: wrap,
                filter,
            },
            srgb,
        }
    }

    #[test]
    fn srgb_is_decoded_before_filtering() {
        let images = image(2, 1, vec![[0, 0, 0, 0], [255, 188, 255, 255]]);
        let srgb = texture(Wrap::Clamp, Filter::Linear, true).sample(&images, [0.5, 0.5]);
        // Half of linear 1, not the linear value of half-way grey (0.214); alpha is never sRGB.
        assert!((srgb.x - 0.5).abs() < 1e-6);
        assert!((srgb.y - 0.5 * 0.502_886).abs() < 1e-4);
        assert!((srgb.w - 0.5).abs() < 1e-6);
        let plain = texture(Wrap::Clamp, Filter::Linear, false).sample(&images, [0.5, 0.5]);
        assert!((plain.y - 0.5 * 188.0 / 255.0).abs() < 1e-6);
    }

    #[test]
    fn centres_are_exact_and_between_is_linear() {
        // Not a power of two, and both directions differ.
        let texels: Vec<[u8; 4]> = (0..15).map(|i| [i * 10, i * 3, 0, 255]).collect();
        let images = image(5, 3, texels.clone());
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            let t = texture(wrap, Filter::Linear, false);
            for (i, texel) in texels.iter().enumerate() {
                let uv = [(i % 5) as f32 / 5.0 + 0.1, (i / 5) as f32 / 3.0 + 1.0 / 6.0];
                let wanted = Vec4::from(texel.map(f32::from)) / 255.0;
                assert!(
                    t.sample(&images, uv).distance(wanted) < 1e-5,
                    "{wrap:?} {i}"
                );
            }
            let quarter = t.sample(&images, [0.1 + 0.2 * 0.25, 1.0 / 6.0]);
            assert!((quarter.x - 2.5 / 255.0).abs() < 1e-6);
        }
    }

    #[test]
    fn edges_wrap_as_they_should() {
        let images = image(2, 1, vec![[0, 0, 0, 255], [200, 0, 0, 255]]);
        let red = |wrap, u: f32| {
            texture(wrap, Filter::Linear, false)
                .sample(&images, [u, 0.5])
                .x
                * 255.0
        };
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-3, "{a} is not {b}");
        // At the edge itself: both neighbours alike when repeated, the edge alone otherwise.
        close(red(Wrap::Repeat, 0.0), 100.0);
        close(red(Wrap::Repeat, 1.0), 100.0);
        close(red(Wrap::Repeat, -0.25), 200.0);
        close(red(Wrap::Repeat, 7.25), 0.0);
        close(red(Wrap::Mirror, 0.0), 0.0);
        close(red(Wrap::Mirror, 1.25), 200.0);
        close(red(Wrap::Mirror, 1.75), 0.0);
        close(red(Wrap::Mirror, -0.75), 200.0);
        close(red(Wrap::Clamp, -3.0), 0.0);
        close(red(Wrap::Clamp, 3.0), 200.0);
        let nearest = texture(Wrap::Repeat, Filter::Nearest, false);
        for (u, wanted) in [
            (0.0, 0.0),
            (0.499, 0.0),
            (0.5, 200.0),
            (0.999, 200.0),
            (-0.001, 200.0),
        ] {
            close(nearest.sample(&images, [u, 0.5]).x * 255.0, wanted);
        }
    }

    #[test]
    fn odd_coordinates_do_no_harm() {
        let images = image(3, 3, vec![[255; 4]; 9]);
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for filter in [Filter::Nearest, Filter::Linear] {
                let t = texture(wrap, filter, true);
                for u in [
                    f32::NAN,
                    f32::INFINITY,
                    -f32::INFINITY,
                    1e30,
                    -1e30,
                    1e-30,
                    -1e-30,
                    16_777_216.5,
                    -1e-8,
                ] {
                    for uv in [[u, 0.3], [0.3, u], [u, u]] {
                        assert!(
                            t.sample(&images, uv).distance(Vec4::ONE) < 1e-5,
                            "{wrap:?} {uv:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn sixteen_bits_are_kept() {
        let texels = Texels::Rgba16(vec![[1, 32768, 65535, 65535]]);
        let images = vec![Image {
            name: String::new(),
            width: 1,
            height: 1,
            texels,
        }];
        let c = texture(Wrap::Repeat, Filter::Linear, false).sample(&images, [0.2, 0.9]);
        assert!((c.x - 1.0 / 65535.0).abs() < 1e-9 && (c.y - 32768.0 / 65535.0).abs() < 1e-6);
        let c = texture(Wrap::Repeat, Filter::Linear, true).sample(&images, [0.2, 0.9]);
        assert!((c.y - srgb_to_linear(32768.0 / 65535.0)).abs() < 1e-6);
    }
}
