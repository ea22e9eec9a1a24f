//! A [`Bsdf`] in the few numbers that renderers with lobes of light need: a cosine lobe, a glossy lobe, a clear coat.

use super::{Bsdf, Cover};
use glam::Vec3;

/// What an opaque surface reflects towards one `wo`. Light from several bounces and sheen count as cosine lobes; what is
/// transmitted is left out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reflection {
    /// Albedo of the cosine lobe.
    pub(crate) cosine: Vec3,
    /// The base's glossy lobe, about z.
    pub(crate) gloss: Gloss,
    /// The coat's glossy lobe and its normal in the local frame.
    pub(crate) coat: Option<(Gloss, Vec3)>,
}

/// A GGX reflection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gloss {
    /// What it reflects of even light, by colour; black if there is none.
    pub(crate) albedo: Vec3,
    /// GGX alpha; 0 stands for a mirror.
    pub(crate) alpha: f32,
}

impl Bsdf {
    /// The closed form of what is reflected.
    pub(crate) fn reflection(&self) -> Reflection {
        let none = Gloss {
            albedo: Vec3::ZERO,
            alpha: 1.0,
        };
        if self.lambert {
            return Reflection {
                cosine: self.diffuse,
                gloss: none,
                coat: None,
            };
        }
        let (e, mean) = (self.row.at(self.cos_o), self.row.mean());
        let mut under = self.through[0] + self.through[1] * mean.a + self.through[2] * mean.b;
        let mut lost = mean.lost();
        let mut dim = 1.0;
        let mut coat = None;
        let mut sheen = Vec3::ZERO;
        if let (Some(layers), Cover::Near) = (&self.layers, self.cover) {
            let (dim_under, dim_lost) = self.mean_dimming(self.row, layers);
            under *= dim_under;
            lost *= dim_lost;
            dim = layers.through_o;
            sheen = layers.sheen_color_albedo(self.cos_o);
            let albedo = layers.coat_albedo_o();
            coat = (albedo > 0.0).then(|| {
                let gloss = Gloss {
                    albedo: Vec3::splat(albedo),
                    alpha: if layers.coat_delta {
                        0.0
                    } else {
                        layers.coat_alpha
                    },
                };
                (gloss, layers.coat_normal())
            });
        }
        Reflection {
            cosine: self.diffuse * under + self.multiple * lost + sheen,
            gloss: Gloss {
                albedo: (self.f0 * e.a + Vec3::splat(self.f90) * e.b) * dim,
                alpha: if self.delta { 0.0 } else { self.alpha },
            },
            coat,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::BsdfParameters;
    use super::*;

    /// The lobes together reflect what the whole does.
    #[test]
    fn nothing_is_lost_or_won() {
        for roughness in [0.0, 0.3, 0.7, 1.0] {
            for (metallic, clearcoat, sheen) in [
                (0.0, 0.0, 0.0),
                (1.0, 0.0, 0.0),
                (0.4, 0.7, 0.0),
                (0.2, 0.0, 0.5),
            ] {
                let parameters = BsdfParameters {
                    base_color: Vec3::new(0.8, 0.4, 0.1),
                    metallic,
                    roughness,
                    clearcoat,
                    clearcoat_roughness: 0.2,
                    sheen_color: Vec3::splat(sheen),
                    sheen_roughness: 0.6,
                    ..BsdfParameters::default()
                };
                for mu in [0.1_f32, 0.5, 0.95] {
                    let bsdf = Bsdf::new(&parameters, Vec3::new((1.0 - mu * mu).sqrt(), 0.0, mu));
                    let r = bsdf.reflection();
                    let coat = r.coat.map_or(Vec3::ZERO, |(gloss, _)| gloss.albedo);
                    let sum = r.cosine + r.gloss.albedo + coat;
                    let error = (sum - bsdf.albedo()).abs().max_element();
                    assert!(error < 0.01, "{parameters:?} {mu}: {sum} {}", bsdf.albedo());
                }
            }
        }
    }
}
