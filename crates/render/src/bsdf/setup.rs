//! From material parameters to lobes: what each lobe reflects towards one `wo`, and how often it is sampled.

use super::albedo::{Row, Split};
use super::microfacet::{ALPHA_DELTA, schlick_weight};
use super::{Bsdf, BsdfParameters, Wall};
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

/// Into `[0, 1]`; NaN becomes 0.
fn unit(x: f32) -> f32 {
    if x > 0.0 { x.min(1.0) } else { 0.0 }
}

fn unit_color(c: Vec3) -> Vec3 {
    Vec3::new(unit(c.x), unit(c.y), unit(c.z))
}

impl Bsdf {
    const BLACK: Self = Self {
        lambert: false,
        delta: true,
        wall: Wall::Opaque,
        diffuse: Vec3::ZERO,
        multiple: Vec3::ZERO,
        through: [1.0, 0.0, 0.0],
        row: Row::ZERO,
        alpha: 1.0,
        f0: Vec3::ZERO,
        f90: 0.0,
        tint: Vec3::ZERO,
        sheet: [0.0; 2],
        pass: Vec3::ZERO,
        glass: [Vec3::ZERO; 2],
        glass_scale: 0.0,
        eta: 1.0,
        pick_cosine: 0.0,
        pick_specular: 0.0,
        pick_pass: 0.0,
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
        if metallic == 0.0 && specular == 0.0 && transmission == 0.0 {
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
        let (e, mean) = if delta {
            let b = schlick_weight(wo.z);
            (Split { a: 1.0 - b, b }, row.mean())
        } else {
            (row.at(wo.z), row.mean())
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
            ..Self::BLACK
        };
        bsdf.f0 = dielectric.f0 * opaque_share + metal.f0 * metallic;
        bsdf.f90 = dielectric.f90 * opaque_share + metal.f90 * metallic;
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
        let lost_mean = mean.lost();
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

        let cosine = bsdf.diffuse * under + bsdf.multiple * lost_mean;
        let specular = bsdf.f0 * e.a + Vec3::splat(bsdf.f90) * e.b + glass_reflected + transmitted;
        bsdf.albedo = cosine + specular + bsdf.pass;
        let picks = [cosine, specular, bsdf.pass].map(Vec3::max_element);
        let total: f32 = picks.iter().sum();
        if total > 0.0 {
            [bsdf.pick_cosine, bsdf.pick_specular, bsdf.pick_pass] = picks.map(|p| p / total);
        }
        bsdf
    }
}
