//! From material parameters to lobes: what each lobe reflects towards one `wo`, and how often it is sampled.

use super::albedo::{Row, Split};
use super::layers::Layers;
use super::microfacet::{ALPHA_DELTA, schlick_weight, smith_root};
use super::{Bsdf, BsdfParameters, Cover, Pick, Wall, unit, unit_color};
use glam::Vec3;

/// A Schlick reflectance with what several bounces on the microsurface add to it.
struct Layer<T> {
    f0: T,
    f90: f32,
    multiple: T,
}

/// Kulla & Conty 2017: share of the light lost to the single bounce that leaves after all.
/// `mean` is the cosine mean of the lobe's albedo, `average` that of the Fresnel reflectance (1/21 = mean of `(1-c)^5`).
fn multiple_bounces(f0: f32, f90: f32, mean: Split) -> f32 {
    let average = f0 + (f90 - f0) * (1.0 / 21.0);
    let kept = mean.a + mean.b;
    average * average * kept / (1.0 - average * (1.0 - kept)).max(f32::MIN_POSITIVE)
}

impl Layer<f32> {
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
}

impl Layer<Vec3> {
    fn colored(f0: Vec3, f90: f32, mean: Split) -> Self {
        let multiple = Vec3::from_array(f0.to_array().map(|f0| multiple_bounces(f0, f90, mean)));
        Self { f0, f90, multiple }
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
        row: Row::ZERO,
        alpha: 1.0,
        root_o: 1.0,
        f0: Vec3::ZERO,
        f90: 0.0,
        tint: Vec3::ZERO,
        sheet: [0.0; 2],
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
        if !(wo.z > 0.0 && wo.is_finite()) {
            return Self::BLACK;
        }
        let base = unit_color(parameters.base_color);
        let metallic = unit(parameters.metallic);
        let specular = unit(parameters.specular);
        let transmission = unit(parameters.transmission);
        let layers = Layers::new(parameters, wo.z);
        if metallic == 0.0 && specular == 0.0 && transmission == 0.0 && layers.is_none() {
            return Self {
                lambert: base.max_element() > 0.0,
                diffuse: base,
                albedo: base,
                ..Self::BLACK
            };
        }

        let roughness = unit(parameters.roughness);
        let alpha = roughness * roughness;
        let delta = alpha < ALPHA_DELTA;
        let row = Row::new(if delta { 0.0 } else { roughness });
        let mean = row.mean();
        let e = if delta {
            Split::mirror(wo.z)
        } else {
            row.at(wo.z)
        };

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
        let dielectric = Layer::colored(f0, specular, mean);
        let barrier = Layer::new(f0.max_element(), specular, mean);
        let metal = Layer::colored(base, 1.0, mean);

        let mut bsdf = Self {
            delta,
            row,
            alpha,
            root_o: smith_root(alpha, wo.z),
            layers,
            ..Self::BLACK
        };
        bsdf.f0 = dielectric.f0 * opaque_share + metal.f0 * metallic;
        bsdf.f90 = dielectric.f90 * opaque_share + metal.f90 * metallic;
        let lost_mean = mean.lost();
        let mut multiple = dielectric.multiple * opaque_share + metal.multiple * metallic;
        let mut transmitted = Vec3::ZERO;
        let mut glass_reflected = Vec3::ZERO;

        if glass_share > 0.0 && parameters.thin {
            // Two boundaries: R + T R T + ... = 2 R / (1 + R).
            let sheet = |r: Vec3| 2.0 * r / (Vec3::ONE + r);
            let f0 = sheet(f0);
            let f90 = 2.0 * specular / (1.0 + specular);
            let layer = Layer::colored(f0, f90, mean);
            bsdf.wall = Wall::Thin;
            bsdf.f0 += f0 * glass_share;
            bsdf.f90 += f90 * glass_share;
            multiple += layer.multiple * glass_share;
            bsdf.sheet = [f0.max_element(), f90];
            bsdf.tint = base * glass_share;
            let reflected = bsdf.sheet[0] * e.a + f90 * e.b;
            transmitted = bsdf.tint * (e.a + e.b - reflected);
            // What neither the single bounce nor the layer's several bounces reflect crosses the wall instead.
            if !delta && lost_mean > NEGLIGIBLE_LOSS {
                let barrier = multiple_bounces(bsdf.sheet[0], f90, mean);
                bsdf.below = bsdf.tint * ((1.0 - barrier) * e.lost() / lost_mean);
            }
        } else if glass_share > 0.0 && ior < INDEX_MATCHED {
            bsdf.pass = base * glass_share;
        } else if glass_share > 0.0 {
            bsdf.wall = Wall::Thick;
            bsdf.delta |= alpha * (ior - 1.0) < REFRACTION_DELTA;
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
        }

        // Lambert's part below the dielectric layer, in the reciprocal form (1 - E(wo)) (1 - E(wi)) / (1 - mean E) (Kulla & Conty).
        let under = 1.0 - barrier.albedo(mean);
        if under > 0.0 && opaque_share > 0.0 {
            bsdf.through = [
                1.0 - barrier.multiple,
                barrier.multiple - barrier.f0,
                barrier.multiple - barrier.f90,
            ];
            bsdf.diffuse = base * (opaque_share * (1.0 - barrier.albedo(e)).max(0.0) / under);
        }
        if !delta && lost_mean > NEGLIGIBLE_LOSS {
            bsdf.multiple = multiple * (e.lost() / lost_mean);
        }

        let mut cosine = bsdf.diffuse * under + bsdf.multiple * lost_mean;
        let mut specular =
            bsdf.f0 * e.a + Vec3::splat(bsdf.f90) * e.b + glass_reflected + transmitted;
        let below = bsdf.below * lost_mean;
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
                coat = layers.coat_albedo(wo.z);
                sheen = layers.sheen_color_albedo(wo.z);
            }
        }
        bsdf.albedo = cosine + specular + below + bsdf.pass + coat + sheen;
        let picks =
            [cosine, specular, below, bsdf.pass, Vec3::splat(coat), sheen].map(Vec3::max_element);
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
