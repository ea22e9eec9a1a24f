//! What lies on top of the base material: clear coat (`KHR_materials_clearcoat`) over sheen (`KHR_materials_sheen`).
//!
//! The coat is a GGX lobe of index 1.5 about a normal of its own: what it reflects and lets through follows from cosines to that normal,
//! and light from below its horizon gets through as it would through the other slope of the bump. Over an opaque base the lobe reaches as far down as its own horizon, whatever the base's
//! normal; over a transmitting one it ends at the base's. The sheen is Estevez & Kulla's "Charlie" distribution (2017), `D = (2 + 1/a) sin^(1/a) / 2π`, with
//! Neubelt's visibility `1 / 4 (cos_i + cos_o - cos_i cos_o)`. Below a roughness of 0.45 that reflects more than arrives at grazing
//! angles, so it is divided by the larger of `E(wo)`, `E(wi)` and 1. Each layer takes its directional albedo `E` from what is below; a lobe
//! below is dimmed by the smaller of `1 - E(wo)` and `1 - E(wi)` (as the sheen extension proposes), which is reciprocal and never gains light. The
//! cosine lobe, where that would lose several per cent, takes the normalised product instead (see `setup`). Wrong tool for: coloured
//! coats, and light that bounces between coat and base.

use super::albedo::{Row, sheen_albedo};
use super::microfacet::{
    ALPHA_DELTA, GRAZING, g1_over_2cos, g2_over_4cos_o, half_vector_about, reflect,
    sample_visible_normal, schlick_weight, smith_root,
};
use super::{BsdfParameters, unit, unit_color};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Reflectance of the coat at normal incidence (index 1.5).
const COAT_F0: f32 = 0.04;

/// Sheen gets no smoother than this perceptual roughness: below, the lobe is a needle along the horizon that nothing here samples well.
pub(super) const SHEEN_ROUGHNESS_MIN: f32 = 0.1;

/// Coat and sheen over one surface point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layers {
    coat: f32,
    pub coat_alpha: f32,
    pub coat_delta: bool,
    coat_row: Row,
    /// Unit normal of the coat, on the side of `wo`; exactly z unless the coat has a normal of its own.
    coat_normal: Vec3,
    /// Cosine of `wo` to it.
    coat_cos_o: f32,
    pub sheen: Vec3,
    sheen_max: f32,
    sheen_roughness: f32,
    /// Light that gets through both layers, and through the coat alone, along `wo`.
    pub through_o: f32,
    coat_through_o: f32,
    /// Largest of 1 and the raw sheen's albedo along `wo`.
    sheen_excess_o: f32,
}

impl Layers {
    /// `None` when neither layer is there.
    pub fn new(parameters: &BsdfParameters, wo: Vec3) -> Option<Self> {
        let coat = unit(parameters.clearcoat);
        let sheen = unit_color(parameters.sheen_color);
        let sheen_max = sheen.max_element();
        if coat == 0.0 && sheen_max == 0.0 {
            return None;
        }
        let roughness = unit(parameters.clearcoat_roughness);
        let coat_alpha = roughness * roughness;
        let coat_delta = coat_alpha < ALPHA_DELTA;
        // A normal that is none, or that looks away from the viewer, gives way to the base's.
        let own = parameters.coat_normal;
        let seen = own.is_normalized() && own.dot(wo) >= GRAZING;
        let coat_normal = if seen { own } else { Vec3::Z };
        let mut layers = Self {
            coat,
            coat_alpha,
            coat_delta,
            coat_row: if coat_delta {
                Row::MIRROR
            } else {
                Row::new(roughness)
            },
            coat_normal,
            coat_cos_o: coat_normal.dot(wo),
            sheen,
            sheen_max,
            sheen_roughness: unit(parameters.sheen_roughness).max(SHEEN_ROUGHNESS_MIN),
            through_o: 1.0,
            coat_through_o: 1.0,
            sheen_excess_o: 1.0,
        };
        layers.coat_through_o = layers.coat_through(wo);
        layers.through_o = layers.through(wo);
        layers.sheen_excess_o = layers.sheen_excess(wo.z);
        Some(layers)
    }

    /// Directional albedo of the coat along `wo`.
    pub fn coat_albedo_o(&self) -> f32 {
        self.coat_albedo(self.coat_cos_o)
    }

    /// The coat's unit normal.
    pub fn coat_normal(&self) -> Vec3 {
        self.coat_normal
    }

    /// Whether the coat has a normal of its own.
    pub fn tilted(&self) -> bool {
        self.coat_normal != Vec3::Z
    }

    /// Directional albedo of the coat by the cosine to its normal.
    fn coat_albedo(&self, cos: f32) -> f32 {
        if self.coat == 0.0 {
            return 0.0;
        }
        let e = self.coat_row.at(cos);
        self.coat * (COAT_F0 * e.a + e.b)
    }

    fn coat_through(&self, w: Vec3) -> f32 {
        1.0 - self.coat_albedo(self.coat_normal.dot(w).abs())
    }

    /// Directional albedo of the sheen (of its strongest channel), the coat above it left out: an upper bound where it was scaled down.
    fn sheen_albedo(&self, cos: f32) -> f32 {
        if self.sheen_max == 0.0 {
            return 0.0;
        }
        self.sheen_max * sheen_albedo(self.sheen_roughness, cos).min(1.0)
    }

    fn sheen_excess(&self, cos: f32) -> f32 {
        if self.sheen_max == 0.0 {
            return 1.0;
        }
        sheen_albedo(self.sheen_roughness, cos).max(1.0)
    }

    /// What the sheen reflects towards `wo` through the coat, by channel.
    pub fn sheen_color_albedo(&self, cos_o: f32) -> Vec3 {
        if self.sheen_max == 0.0 {
            return Vec3::ZERO;
        }
        let e = sheen_albedo(self.sheen_roughness, cos_o).min(1.0);
        self.sheen * (self.coat_through_o * e)
    }

    /// Share of light that both layers leave to what is below, along a direction above the base.
    pub fn through(&self, w: Vec3) -> f32 {
        self.coat_through(w) * (1.0 - self.sheen_albedo(w.z))
    }

    /// [`Self::through`] averaged over the directions at one cosine to the base's normal.
    pub fn mean_through(&self, cos: f32) -> f32 {
        /// Cosines of the midpoints of four parts of the half circle; the other half mirrors it.
        const AZIMUTHS: [f32; 4] = [0.923_879_5, 0.382_683_43, -0.382_683_43, -0.923_879_5];
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        if !self.tilted() {
            return self.through(Vec3::new(sin, 0.0, cos));
        }
        let (level, upright) = (self.coat_normal.truncate().length(), self.coat_normal.z);
        let coat = AZIMUTHS.map(|a| self.coat_albedo((level * sin * a + upright * cos).abs()));
        (1.0 - 0.25 * coat.iter().sum::<f32>()) * (1.0 - self.sheen_albedo(cos))
    }

    /// The dimming of a lobe below.
    pub fn dim(&self, wi: Vec3) -> f32 {
        self.through_o.min(self.through(wi))
    }

    /// Whether `wi` is above the coat's own horizon.
    pub fn above_coat(&self, wi: Vec3) -> bool {
        self.coat_normal.dot(wi) >= GRAZING
    }

    /// A direction of the coat's lobe, `None` if it is below the coat's horizon.
    pub fn sample_coat(&self, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let z = self.coat_normal;
        if self.coat_delta {
            return Some(reflect(wo, z).normalize());
        }
        let (x, y) = z.any_orthonormal_pair();
        let local = Vec3::new(x.dot(wo), y.dot(wo), self.coat_cos_o);
        let h = sample_visible_normal(self.coat_alpha, local, u);
        let wi = reflect(wo, x * h.x + y * h.y + z * h.z);
        self.above_coat(wi).then_some(wi)
    }

    /// Reflectance of the smooth coat towards `wo`.
    pub fn coat_mirror(&self) -> f32 {
        self.coat_facet(self.coat_cos_o)
    }

    /// Reflectance of one facet of the coat.
    fn coat_facet(&self, cos: f32) -> f32 {
        self.coat * (COAT_F0 + (1.0 - COAT_F0) * schlick_weight(cos))
    }

    /// `(f cos, pdf of visible normals)` of the rough coat, the cosine that to its normal; black below its horizon.
    pub fn eval_coat(&self, wo: Vec3, wi: Vec3) -> (f32, f32) {
        let (cos_o, cos_i) = (self.coat_cos_o, self.coat_normal.dot(wi));
        if cos_i < GRAZING {
            return (0.0, 0.0);
        }
        let (cos_h, d) = half_vector_about(self.coat_normal, self.coat_alpha, wo + wi);
        let root_o = smith_root(self.coat_alpha, cos_o);
        let root_i = smith_root(self.coat_alpha, cos_i);
        let value = self.coat_facet(cos_h) * d * g2_over_4cos_o(cos_o, root_o, cos_i, root_i);
        (value, d * 0.5 * g1_over_2cos(cos_o, root_o))
    }

    /// `f cos` of the sheen, the coat's dimming included.
    pub fn eval_sheen(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        let h = (wo + wi).normalize_or_zero();
        let dim = self.coat_through_o.min(self.coat_through(wi))
            / self.sheen_excess_o.max(self.sheen_excess(wi.z));
        self.sheen * (dim * charlie(self.sheen_roughness, wo, wi, h) * wi.z)
    }
}

/// The sheen's BRDF for a white sheen.
pub(super) fn charlie(roughness: f32, wo: Vec3, wi: Vec3, h: Vec3) -> f32 {
    let inverse_alpha = 1.0 / (roughness * roughness);
    let sin2 = h.x * h.x + h.y * h.y;
    let d = (2.0 + inverse_alpha) * sin2.powf(0.5 * inverse_alpha) / (2.0 * PI);
    d / (4.0 * (wi.z + wo.z - wi.z * wo.z)).max(f32::MIN_POSITIVE)
}
