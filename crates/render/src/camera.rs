//! From pixels to rays.

use glam::{Affine3A, Vec2, Vec3, Vec3A};
use occlude_scene::{Pose, Projection, Scene};
use occlude_visibility::Ray;

/// How samples spread around a pixel's centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelFilter {
    /// Evenly over the pixel's square.
    #[default]
    Box,
    /// Tent of one pixel's radius: softer edges, less aliasing.
    Tent,
    /// Gaussian with a standard deviation of half a pixel, cut at 1.5 pixels.
    Gaussian,
}

impl PixelFilter {
    const GAUSSIAN_SIGMA: f32 = 0.5;
    const GAUSSIAN_RADIUS: f32 = 1.5;

    /// Maps a uniform point of the unit square to an offset from the pixel's centre, in pixels (filter importance
    /// sampling: the samples carry equal weights).
    pub fn offset(self, u: Vec2) -> Vec2 {
        match self {
            Self::Box => u - 0.5,
            Self::Tent => {
                let tent = |x: f32| {
                    if x < 0.5 {
                        (2.0 * x).sqrt() - 1.0
                    } else {
                        1.0 - (2.0 - 2.0 * x).sqrt()
                    }
                };
                Vec2::new(tent(u.x), tent(u.y))
            }
            Self::Gaussian => {
                const SIGMA: f32 = PixelFilter::GAUSSIAN_SIGMA;
                const RADIUS: f32 = PixelFilter::GAUSSIAN_RADIUS;
                // Box-Muller with the radius cut so that it never exceeds RADIUS.
                let kept = 1.0 - (-RADIUS * RADIUS / (2.0 * SIGMA * SIGMA)).exp();
                let radius = SIGMA * (-2.0 * (1.0 - u.x * kept).ln()).sqrt();
                radius * Vec2::from_angle(std::f32::consts::TAU * u.y)
            }
        }
    }
}

impl PixelFilter {
    /// How far from a pixel's centre samples spread at most, in pixels along each axis.
    pub fn radius(self) -> f32 {
        match self {
            Self::Box => 0.5,
            Self::Tent => 1.0,
            Self::Gaussian => Self::GAUSSIAN_RADIUS,
        }
    }

    /// Density of [`PixelFilter::offset`] per square pixel. The box holds its lower edges only, so that every point of the
    /// picture lies in one pixel.
    pub fn density(self, offset: Vec2) -> f32 {
        match self {
            Self::Box => {
                let inside = |x: f32| (-0.5..0.5).contains(&x);
                f32::from(u8::from(inside(offset.x) && inside(offset.y)))
            }
            Self::Tent => {
                let tent = |x: f32| (1.0 - x.abs()).max(0.0);
                tent(offset.x) * tent(offset.y)
            }
            Self::Gaussian => {
                let variance = Self::GAUSSIAN_SIGMA * Self::GAUSSIAN_SIGMA;
                let inside = |r2: f32| (-r2 / (2.0 * variance)).exp();
                let edge = Self::GAUSSIAN_RADIUS * Self::GAUSSIAN_RADIUS;
                let r2 = offset.length_squared();
                if r2 > edge {
                    return 0.0;
                }
                inside(r2) / (std::f32::consts::TAU * variance * (1.0 - inside(edge)))
            }
        }
    }
}

/// A camera in the world, with the size of its picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    world_from_camera: Affine3A,
    projection: Projection,
    width: u32,
    height: u32,
}

/// A camera ray, and what its pixel covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraRay {
    /// The ray; its direction has unit length.
    pub ray: Ray,
    /// Pixels per steradian around the ray (perspective), or per square metre across it (orthographic, `parallel`).
    pub pixel_density: f32,
    /// The projection is orthographic.
    pub parallel: bool,
}

impl CameraRay {
    /// Pixels per square metre on a surface with unit `normal` that the ray hits at distance `t`.
    pub fn density_at(&self, t: f32, normal: Vec3) -> f32 {
        let across = if self.parallel { 1.0 } else { t * t };
        self.pixel_density * self.ray.direction.dot(normal).abs() / across
    }
}

/// Where the camera sees a point, if nothing is in the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected {
    /// The point of the picture in pixels, as [`View::ray`] takes it. It may lie outside of the picture.
    pub point: Vec2,
    /// Unit vector from the point to the camera.
    pub toward_camera: Vec3,
    /// The end of the line of sight.
    pub eye: Vec3,
    /// Pixels per square metre of a surface there that faces the camera.
    pub density: f32,
}

impl View {
    /// A camera of the scene at a pose.
    ///
    /// # Panics
    /// If `camera` is out of range.
    pub fn of_camera(scene: &Scene, pose: &Pose, camera: usize, width: u32, height: u32) -> Self {
        let camera = &scene.cameras[camera];
        // Scale of the hierarchy above does not scale a camera (glTF 2.0, section 3.10).
        let (_, rotation, translation) =
            pose.world_from_node[camera.node as usize].to_scale_rotation_translation();
        let world_from_camera = Affine3A::from_rotation_translation(rotation, translation);
        Self {
            world_from_camera,
            projection: camera.projection,
            width,
            height,
        }
    }

    /// A perspective camera at `eye` that looks at `target`, with the vertical field of view `yfov` in radians.
    /// `None` if the two coincide or something is not finite.
    pub fn look_at(eye: Vec3, target: Vec3, yfov: f32, width: u32, height: u32) -> Option<Self> {
        let back = (eye - target).try_normalize()?;
        let up = if back.y.abs() > 0.999 {
            Vec3::NEG_Z * back.y.signum()
        } else {
            Vec3::Y
        };
        Self::look_at_with_up(eye, target, up, yfov, width, height)
    }

    /// As [`View::look_at`], with `up` shown upwards. `None` also if `up` lies along the view.
    pub fn look_at_with_up(
        eye: Vec3,
        target: Vec3,
        up: Vec3,
        yfov: f32,
        width: u32,
        height: u32,
    ) -> Option<Self> {
        let back = (eye - target).try_normalize()?;
        let right = up.cross(back).try_normalize()?;
        let world_from_camera = Affine3A::from_cols(
            right.into(),
            back.cross(right).into(),
            back.into(),
            eye.into(),
        );
        let view = Self {
            world_from_camera,
            projection: Projection::Perspective { yfov },
            width,
            height,
        };
        (world_from_camera.is_finite() && yfov > 0.0 && yfov < std::f32::consts::PI).then_some(view)
    }

    /// For files without a camera: 40 degrees, looking along -Z, the front of the bounding box just filling the view.
    pub fn framing(min: Vec3, max: Vec3, width: u32, height: u32) -> Self {
        let yfov = 40f32.to_radians();
        let (centre, extent) = ((min + max) * 0.5, max - min);
        let distance = extent.z * 0.5 + extent.x.max(extent.y) * 0.5 / (yfov * 0.5).tan();
        let world_from_camera = Affine3A::from_translation(centre + Vec3::Z * distance);
        Self {
            world_from_camera,
            projection: Projection::Perspective { yfov },
            width,
            height,
        }
    }

    /// Pixels a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// World-space position of the camera.
    pub fn eye(&self) -> Vec3 {
        self.world_from_camera.translation.into()
    }

    /// The ray through a point of the picture in pixels: (0, 0) is the top left corner.
    pub fn ray(&self, point: Vec2) -> CameraRay {
        let (width, height) = (self.width as f32, self.height as f32);
        // Offset from the middle, in half heights, +y up.
        let x = (point.x * 2.0 - width) / height;
        let y = 1.0 - point.y * 2.0 / height;
        let (origin, direction, pixel_density, parallel) = match self.projection {
            Projection::Perspective { yfov } => {
                let half = (yfov * 0.5).tan();
                let direction = Vec3A::new(x * half, y * half, -1.0);
                let length = direction.length();
                // A pixel is (2 half / height)^2 on the plane at distance 1; it is seen from `length` under cos = 1/length.
                let pixel_area = (2.0 * half / height).powi(2);
                (
                    Vec3A::ZERO,
                    direction / length,
                    length.powi(3) / pixel_area,
                    false,
                )
            }
            Projection::Orthographic { ymag } => (
                Vec3A::new(x * ymag, y * ymag, 0.0),
                Vec3A::NEG_Z,
                (height / (2.0 * ymag)).powi(2),
                true,
            ),
        };
        let origin = self.world_from_camera.transform_point3a(origin).into();
        let direction = self.world_from_camera.transform_vector3a(direction).into();
        CameraRay {
            ray: Ray::new(origin, direction),
            pixel_density,
            parallel,
        }
    }

    /// Where the camera sees a point: the inverse of [`View::ray`]. `None` behind the camera.
    pub fn project(&self, point: Vec3) -> Option<Projected> {
        // A camera's frame is a rotation, so the inverse is the transpose.
        let to = Vec3A::from(point) - self.world_from_camera.translation;
        let local = self.world_from_camera.matrix3.transpose() * to;
        let depth = -local.z;
        if depth.is_nan() || depth <= 0.0 {
            return None;
        }
        let (width, height) = (self.width as f32, self.height as f32);
        let (x, y) = match self.projection {
            Projection::Perspective { yfov } => {
                let half = (yfov * 0.5).tan() * depth;
                (local.x / half, local.y / half)
            }
            Projection::Orthographic { ymag } => (local.x / ymag, local.y / ymag),
        };
        let seen = Vec2::new((x * height + width) * 0.5, (1.0 - y) * height * 0.5);
        if !seen.is_finite() {
            return None;
        }
        let camera = self.ray(seen);
        let (toward_camera, across) = if camera.parallel {
            (-camera.ray.direction, 1.0)
        } else {
            (Vec3::from(-to).normalize_or_zero(), to.length_squared())
        };
        Some(Projected {
            point: seen,
            toward_camera,
            eye: camera.ray.origin,
            density: camera.pixel_density / across,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_and_middle() {
        let view = View::look_at(
            Vec3::new(0.0, 0.0, 5.0),
            Vec3::ZERO,
            90f32.to_radians(),
            200,
            100,
        )
        .unwrap();
        let middle = view.ray(Vec2::new(100.0, 50.0)).ray.direction;
        assert!((middle - Vec3::NEG_Z).length() < 1e-6);
        let top_left = view.ray(Vec2::ZERO).ray.direction;
        assert!((top_left - Vec3::new(-2.0, 1.0, -1.0).normalize()).length() < 1e-6);
    }

    #[test]
    fn pixel_densities_integrate_to_the_field_of_view() {
        // The solid angle of a 90 degree square view is 4 pi / 6.
        let view = View::look_at(Vec3::ZERO, Vec3::X, 90f32.to_radians(), 64, 64).unwrap();
        let pixels = (0..64 * 64).map(|i| Vec2::new((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5));
        let angle: f64 = pixels
            .map(|p| 1.0 / f64::from(view.ray(p).pixel_density))
            .sum();
        assert!((angle - 4.0 * std::f64::consts::PI / 6.0).abs() < 1e-3);
    }

    #[test]
    fn projection_inverts_rays() {
        let eye = Vec3::new(3.0, 1.0, -2.0);
        let mut view = View::look_at(eye, Vec3::new(0.5, 0.2, 0.1), 0.8, 64, 40).unwrap();
        for projection in [view.projection, Projection::Orthographic { ymag: 1.5 }] {
            view.projection = projection;
            for i in 0..200u32 {
                let point = Vec2::new((i % 13) as f32 * 6.0 - 4.0, (i % 17) as f32 * 3.0 - 3.0);
                let camera = view.ray(point);
                let t = 0.3 + i as f32 * 0.1;
                let seen = view.project(camera.ray.at(t)).unwrap();
                assert!((seen.point - point).length() < 2e-3, "{seen:?} {point}");
                assert!((seen.toward_camera + camera.ray.direction).length() < 1e-5);
                assert!((seen.eye - camera.ray.origin).length() < 1e-4);
                let facing = camera.density_at(t, camera.ray.direction);
                assert!((seen.density / facing - 1.0).abs() < 1e-3);
                assert!(view.project(camera.ray.at(-t)).is_none());
            }
        }
    }

    /// Shares of offsets against the density's integral over cells.
    #[test]
    fn filter_densities_are_those_of_the_offsets() {
        for filter in [PixelFilter::Box, PixelFilter::Tent, PixelFilter::Gaussian] {
            let (cells, fine, n) = (12, 16, 400u32);
            let side = 2.0 * filter.radius() / cells as f32;
            let cell = |x: f32| (((x + filter.radius()) / side) as usize).min(cells - 1);
            let mut found = vec![0.0; cells * cells];
            for i in 0..n * n {
                let u = Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) / n as f32;
                let offset = filter.offset(u);
                found[cell(offset.y) * cells + cell(offset.x)] += 1.0 / f64::from(n * n);
            }
            for (i, found) in found.iter().enumerate() {
                let corner =
                    Vec2::new((i % cells) as f32, (i / cells) as f32) * side - filter.radius();
                let expected: f64 = (0..fine * fine)
                    .map(|k| {
                        let inner = Vec2::new((k % fine) as f32 + 0.5, (k / fine) as f32 + 0.5);
                        let at = corner + inner * (side / fine as f32);
                        f64::from(filter.density(at) * side * side)
                            / f64::from((fine * fine) as u32)
                    })
                    .sum();
                assert!(
                    (found - expected).abs() < 0.001,
                    "{filter:?} cell {i}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn filters_are_centred() {
        for filter in [PixelFilter::Box, PixelFilter::Tent, PixelFilter::Gaussian] {
            let n = 64;
            let grid = (0..n * n)
                .map(|i| Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) / n as f32);
            let mean = grid.map(|u| filter.offset(u)).sum::<Vec2>() / (n * n) as f32;
            assert!(mean.length() < 0.02, "{filter:?} {mean}");
        }
    }

    #[test]
    fn straight_down_is_a_view_too() {
        let view = View::look_at(Vec3::Y, Vec3::ZERO, 1.0, 10, 10).unwrap();
        assert!((view.ray(Vec2::splat(5.0)).ray.direction - Vec3::NEG_Y).length() < 1e-6);
    }
}
