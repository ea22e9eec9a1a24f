//! Cameras.

/// A camera; it looks along -Z of its node, +Y up.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name of the camera or of its node; may be empty.
    pub name: String,
    /// The node that carries it.
    pub node: u32,
    /// How it projects.
    pub projection: Projection,
}

/// How a camera projects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole; the vertical field of view holds at any image size.
    Perspective {
        /// Vertical field of view, radians, in `(0, pi)`.
        yfov: f32,
    },
    /// Parallel; half of the height seen, in metres. The width follows the aspect of the image.
    Orthographic {
        /// Half height, metres.
        ymag: f32,
    },
}
