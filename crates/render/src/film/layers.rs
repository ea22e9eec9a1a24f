//! A finished film as named channels.

use super::Developed;
use occlude_image::{Depth, Layers, Picture};

/// What to write beside the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Aovs {
    /// Albedo of the first surface.
    pub albedo: bool,
    /// World-space shading normal of the first surface.
    pub normal: bool,
    /// Distance to the first surface, metres.
    pub depth: bool,
    /// Variance of the pixel's mean luminance.
    pub variance: bool,
}

impl Aovs {
    /// Whether the film must record features.
    pub fn needs_features(self) -> bool {
        self.albedo || self.normal || self.depth
    }
}

impl Developed {
    /// The picture alone: scene-linear Rec. 709 radiance.
    pub fn picture(&self) -> Picture {
        Picture {
            width: self.width,
            height: self.height,
            pixels: self.radiance.clone(),
        }
    }

    /// The picture with the layers asked for. Features that the film did not record are left out.
    pub fn layers(&self, aovs: Aovs, precision: Depth) -> Layers {
        let mut layers = Layers::from_picture(&self.picture(), precision);
        if let Some(features) = &self.features {
            if aovs.albedo {
                let albedo: Vec<_> = features.iter().map(|f| f.albedo.to_array()).collect();
                layers.push_colors("albedo", precision, &albedo);
            }
            if aovs.normal {
                let normal: Vec<_> = features.iter().map(|f| f.normal.to_array()).collect();
                layers.push_xyz("normal", precision, &normal);
            }
            if aovs.depth {
                layers.push(
                    "depth.Z",
                    Depth::Float,
                    features.iter().map(|f| f.depth).collect(),
                );
            }
        }
        if aovs.variance {
            layers.push("variance.Y", Depth::Float, self.variance.clone());
        }
        layers
    }
}
