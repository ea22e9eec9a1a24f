//! From material parameters to lobes: what each lobe reflects towards one `wo`, and how often it is sampled.

use super::albedo::{Row, Split};
use super::boundary::{Bounced, Boundary, Side};
use super::layers::Layers;
use super::microfacet::{ALPHA_DELTA, GRAZING, g1_over_2cos, schlick_weight, smith_root};
use super::{Bsdf, BsdfParameters, Cover, Pick, Wall, unit, unit_color};
use glam::Vec3;

/// A grey Schlick reflectance with what several bounces on the microsurface add to it.
struct Layer {
    f0: f32,
    f90: f32,
    multiple: f32,
}

/// Kulla & Conty 2017: share of the light lost to the single bounce that leaves after all.
/// `mean` is the cosine mean of the lobe's albedo, `average` that of the Fresnel reflectance (1/21 = mean of `(1-c)^5`).
fn multiple_bounces(f0: f32, f90: f32, mean: Split) -> f32 {
    let average = f0 + (f90 - f0) * (1.0 / 21.0);
    let kept = mean.a + mean.b;
    average * average * kept / (1.0 - average * (1.0 - kept)).max(f32::MIN_POSITIVE)
}

fn multiple_bounces_colored(f0: Vec3, f90: f32, mean: Split) -> Vec3 {
    Vec3::from_array(f0.to_array().map(|f0| multiple_bounces(f0, f90, mean)))
}

impl Layer {
    fn new(f0: f32, f90: f32, mean: Split) -> Self {
        Self {
            f0,
            f90,
            multiple: multiple_bounces(f0, f90, mean),
        }
    }

    /// Directional albedo.
    fn albedo(&self, e: Split) -> f32 {
        self.f0 * e.a + self.f90 * e.b + self.multiple * e.lost()
    }

    /// [`multiple_bounces_colored`] of a layer of which this is the strongest channel.
    fn colored_like(&self, f0: Vec3, mean: Split) -> Vec3 {
        if f0 == Vec3::splat(self.f0) {
            Vec3::splat(self.multiple)
        } else {
            multiple_bounces_colored(f0, self.f90, mean)
        }
    }
}

/// Below this mean loss the lobe needs no compensation.
const NEGLIGIBLE_LOSS: f32 = 1e-5;

/// A body whose index is closer to 1 than this neither reflects nor bends light: it passes straight through, as through a thin wall.
const INDEX_MATCHED: f32 = 1.001;

/// Below this product of alpha and index step (about the spread of refracted light in radians) refraction is treated as exact: the
/// half vector `wo + eta wi` has too few digits left.
const REFRACTION_DELTA: f32 = 1e-4;

impl Bsdf {
    const BLACK: Self = Self {
        lambert: false,
        delta: true,
        wall: Wall::Opaque,
        diffuse: Vec3::ZERO,
        multiple: Vec3::ZERO,
        below: Vec3::ZERO,
        through: [1.0, 0.0, 0.0],
        row: Row::MIRROR,
        alpha: 1.0,
        cos_o: 0.0,
        root_o: 1.0,
        half_visible: 0.0,
        f0: Vec3::ZERO,
        f90: 0.0,
        tint: Vec3::ZERO,
        sheet: [0.0; 2],
        bounced: None,
        pass: Vec3::ZERO,
        glass: [Vec3::ZERO; 2],
        glass_scale: 0.0,
        eta: 1.0,
        layers: None,
        cover: Cover::Near,
        pick: Pick {
            cosine: 0.0,
            specular: 0.0,
            below: 0.0,
            pass: 0.0,
            coat: 0.0,
            sheen: 0.0,
        },
        albedo: Vec3::ZERO,
    };

    /// Sets up the lobes. Parameters out of range are brought into it; a `wo` that is not above the surface scatters nothing.
    pub fn new(parameters: &BsdfParameters, wo: Vec3) -> Self {
        if !(wo.z >= GRAZING && wo.is_finite()) {
            return Self::BLACK;
        }
        let base = unit_color(parameters.base_color);
        let metallic = unit(parameters.metallic);
        let specular = unit(parameters.specular);
        let transmission = unit(parameters.transmission);
        let layers = Layers::new(parameters, wo);
        if metallic == 0.0 && specular == 0.0 && transmission == 0.0 && layers.is_none() {
            return Self {
                lambert: base.max_element() > 0.0,
                diffuse: base,
                albedo: base,
                ..Self::BLACK
            };
        }

        // KHR_materials_ior, KHR_materials_specular. An index of 0 stands for an infinite one.
        let ior = if parameters.ior > 0.0 {
            parameters.ior.max(1.0)
        } else {
            f32::INFINITY
        };
        let ratio = if ior.is_finite() {
            (ior - 1.0) / (ior + 1.0)
        } else {
            1.0
        };
        let color = parameters.specular_color.max(Vec3::ZERO);
        let f0 = (color * (ratio * ratio)).min(Vec3::ONE) * specular;
        let opaque_share = (1.0 - metallic) * (1.0 - transmission);
        let glass_share = (1.0 - metallic) * transmission;
        let thick = glass_share > 0.0 && !parameters.thin && ior >= INDEX_MATCHED;

        let roughness = unit(parameters.roughness);
        let alpha = roughness * roughness;
        let delta = alpha < ALPHA_DELTA || (thick && alpha * (ior - 1.0) < REFRACTION_DELTA);
        let row = if delta {
            Row::MIRROR
        } else {
            Row::new(roughness)
        };
        let (e, mean) = (row.at(wo.z), row.mean());
        let lost_mean = mean.lost();

        let root_o = smith_root(alpha, wo.z);
        let half_visible = 0.5 * g1_over_2cos(wo.z, root_o);
        let mut bsdf = Self {
            delta,
            row,
            alpha,
            cos_o: wo.z,
            root_o,
            half_visible,
            layers,
            ..Self::BLACK
        };
        let mut multiple = Vec3::ZERO;
        let mut under = 0.0;
        if opaque_share > 0.0 {
            let barrier = Layer::new(f0.max_element(), specular, mean);
            bsdf.f0 = f0 * opaque_share;
            bsdf.f90 = specular * opaque_share;
            multiple = barrier.colored_like(f0, mean) * opaque_share;
            // Lambert's part below the dielectric layer, in the reciprocal form (1 - E(wo)) (1 - E(wi)) / (1 - mean E) (Kulla & Conty).
            under = 1.0 - barrier.albedo(mean);
            if under > 0.0 {
                bsdf.through = [
                    1.0 - barrier.multiple,
                    barrier.multiple - barrier.f0,
                    barrier.multiple - barrier.f90,
                ];
                bsdf.diffuse = base * (opaque_share * (1.0 - barrier.albedo(e)).max(0.0) / under);
            }
        }
        if metallic > 0.0 {
            bsdf.f0 += base * metallic;
            bsdf.f90 += metallic;
            multiple += multiple_bounces_colored(base, 1.0, mean) * metallic;
        }
        let mut transmitted = Vec3::ZERO;
        let mut glass_reflected = Vec3::ZERO;

        if glass_share > 0.0 && parameters.thin {
            // Two boundaries: R + T R T + ... = 2 R / (1 + R).
            let sheet = |r: Vec3| 2.0 * r / (Vec3::ONE + r);
            let f0 = sheet(f0);
            let f90 = 2.0 * specular / (1.0 + specular);
            bsdf.wall = Wall::Thin;
            bsdf.f0 += f0 * glass_share;
            bsdf.f90 += f90 * glass_share;
            multiple += multiple_bounces_colored(f0, f90, mean) * glass_share;
            bsdf.sheet = [f0.max_element(), f90];
            bsdf.tint = base * glass_share;
            let reflected = bsdf.sheet[0] * e.a + f90 * e.b;
            transmitted = bsdf.tint * (e.a + e.b - reflected);
            // What neither the single bounce nor the layer's several bounces reflect crosses the wall instead.
            if !delta && lost_mean > NEGLIGIBLE_LOSS {
                let barrier = multiple_bounces(bsdf.sheet[0], f90, mean);
                bsdf.below = bsdf.tint * ((1.0 - barrier) * e.lost() / lost_mean);
            }
        } else if thick {
            bsdf.wall = Wall::Thick;
            let color = (color * specular).min(Vec3::ONE);
            // Nothing refracts into an infinite index; a huge finite one says the same without infinities.
            let ior = ior.min(1e6);
            bsdf.eta = if parameters.entering { ior } else { 1.0 / ior };
            bsdf.glass = [color * glass_share, Vec3::splat(glass_share)];
            bsdf.glass_scale = color.max_element();
            bsdf.tint = base * glass_share;
            let facet = bsdf.facet(wo.z);
            transmitted = facet.transmit;
            glass_reflected = facet.reflect
                - (bsdf.f0 + (Vec3::splat(bsdf.f90) - bsdf.f0) * schlick_weight(wo.z));
            if !delta {
                let boundary = Boundary::new(ior, roughness, bsdf.glass_scale);
                let side = if parameters.entering {
                    Side::Outside
                } else {
                    Side::Inside
                };
                let kept = 1.0 - boundary.lost(side, wo.z);
                transmitted *= kept;
                glass_reflected *= kept;
                bsdf.bounced = Bounced::new(boundary, ior, side, wo.z, color, base, glass_share);
            }
        } else if glass_share > 0.0 {
            bsdf.pass = base * glass_share;
        }

        if !delta && lost_mean > NEGLIGIBLE_LOSS {
            bsdf.multiple = multiple * (e.lost() / lost_mean);
        }

        let mut cosine = bsdf.diffuse * under + bsdf.multiple * lost_mean;
        let mut specular =
            bsdf.f0 * e.a + Vec3::splat(bsdf.f90) * e.b + glass_reflected + transmitted;
        let dim = layers.as_ref().map_or(1.0, |l| l.through_o);
        let mut below = bsdf.below * (lost_mean * dim);
        if let Some(bounced) = &bsdf.bounced {
            cosine += bounced.reflected_albedo;
            below += bounced.transmitted_albedo * dim;
        }
        let pass = bsdf.pass * dim;
        let (mut coat, mut sheen) = (0.0, Vec3::ZERO);
        if let Some(layers) = &layers {
            if bsdf.wall == Wall::Thick && !parameters.entering {
                bsdf.cover = Cover::Far;
            } else {
                // The cosine lobe's dimming is normalised, so that the light kept by it is exactly what `wo` gets through.
                let (under, lost) = bsdf.mean_dimming(row, layers);
                bsdf.diffuse *= layers.through_o / under;
                bsdf.multiple *= layers.through_o / lost;
                cosine *= layers.through_o;
                specular *= layers.through_o;
                coat = layers.coat_albedo_o();
                sheen = layers.sheen_color_albedo(wo.z);
            }
        }
        bsdf.albedo = cosine + specular + below + pass + coat + sheen;
        let picks =
            [cosine, specular, below, pass, Vec3::splat(coat), sheen].map(Vec3::max_element);
        let total: f32 = picks.iter().sum();
        if total > 0.0 {
            let [cosine, specular, below, pass, coat, sheen] = picks.map(|p| p / total);
            bsdf.pick = Pick {
                cosine,
                specular,
                below,
                pass,
                coat,
                sheen,
            };
        }
        bsdf
    }
}
