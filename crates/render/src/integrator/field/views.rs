//! Pictures for who wonders: where sample points are and how well their neighbours make up for them, what one of them sees, and the sky as lobes.
//!
//! The wrong tool for numbers: colours end where scales do; `--stats` and [`super::FieldReport`] have them. What is drawn is of the last frame alone.

use super::eyes::Eyes;
use super::points::Point;
use super::{Field, Fields};
use crate::camera::View;
use crate::geometry::Geometry;
use glam::{Vec2, Vec3};
use occlude_image::Picture;
use occlude_visibility::field::Hemisphere;

/// Picture pixels a texel, and radius of a point's dot.
const ZOOM: u32 = 4;
const DOT: i32 = 2;
/// Width of the picture of the sky.
const SKY: u32 = 512;

impl Fields {
    /// Pictures of the last frame, by name.
    pub(in crate::integrator) fn views(
        &self,
        geometry: &Geometry,
        view: &View,
        field: &Field,
        pick: Option<[u32; 2]>,
    ) -> Vec<(&'static str, Picture)> {
        let mut pictures = vec![("lobes", self.picture_of_sky())];
        let Some(points) = &self.points else {
            return pictures;
        };
        let eyes = Eyes::trace(geometry, view);
        pictures.push(("points", dots(&points.list, &eyes, view, field)));
        let picked = pick.and_then(|[x, y]| {
            let eye = eyes.at(Vec2::new(x as f32 + 0.5, y as f32 + 0.5))?;
            let known = points.list.iter().filter(|point| point.field.side() > 0);
            known.min_by(|a, b| {
                let far = |point: &Point| {
                    let spot = &point.spot;
                    let metric = points.metric;
                    metric.distance(eye.position, eye.normal, spot.position, spot.normal)
                };
                far(a).total_cmp(&far(b))
            })
        });
        if let Some(point) = picked {
            pictures.push((
                "map",
                squares(point.map.side(), |row, column| {
                    Vec3::splat(if point.map.get(row, column) {
                        0.9
                    } else {
                        0.02
                    })
                }),
            ));
            let side = point.field.side();
            pictures.push((
                "field",
                squares(side, |row, column| shade(point.field.get(row, column))),
            ));
        }
        pictures
    }

    fn picture_of_sky(&self) -> Picture {
        let pixel = |x: u32, y: u32| {
            let theta = std::f32::consts::PI * (y as f32 + 0.5) / (SKY / 2) as f32;
            let phi = std::f32::consts::TAU * ((x as f32 + 0.5) / SKY as f32 - 0.5);
            let (sin, cos) = theta.sin_cos();
            let w = Vec3::new(sin * phi.cos(), cos, sin * phi.sin());
            self.lobes
                .as_ref()
                .map_or(Vec3::ZERO, |lobes| lobes.radiance(w))
        };
        paint(SKY, SKY / 2, pixel)
    }
}

fn paint(width: u32, height: u32, pixel: impl Fn(u32, u32) -> Vec3) -> Picture {
    Picture {
        width,
        height,
        pixels: (0..width * height)
            .map(|i| pixel(i % width, i / width).to_array())
            .collect(),
    }
}

/// A map's square, `theta` downwards and `phi` to the right; the middle is the surface's normal.
fn squares(side: u32, colour: impl Fn(usize, usize) -> Vec3) -> Picture {
    paint(side * ZOOM, side * ZOOM, |x, y| {
        let (row, column) = ((y / ZOOM) as usize, (x / ZOOM) as usize);
        // The horizon's corners are the two poles: darker towards them, as their texels are smaller.
        let height = Hemisphere::texel(side, row, column).y;
        colour(row, column) * (0.6 + 0.4 * height)
    })
}

/// Distances as colours: free is blue, blocked is red, a line every tenth of a radian, white at the edges of visibility.
fn shade(distance: f32) -> Vec3 {
    if distance.abs() < 0.02 {
        return Vec3::ONE;
    }
    let far = (distance.abs() / 1.2).min(1.0);
    let band = if (distance.abs() * 10.0).fract() < 0.12 {
        0.6
    } else {
        1.0
    };
    let colour = if distance > 0.0 {
        Vec3::new(0.55, 0.75, 1.0).lerp(Vec3::new(0.02, 0.08, 0.5), far)
    } else {
        Vec3::new(1.0, 0.7, 0.5).lerp(Vec3::new(0.4, 0.02, 0.02), far)
    };
    colour * band
}

/// Blue for a point that its neighbours make up for, green in between, red where new ones are wanted.
fn heat(error: f32, insert_above: f32) -> Vec3 {
    let x = error / insert_above.max(1e-6);
    if x >= 1.0 {
        Vec3::new(1.0, 0.06, 0.03)
    } else if x < 0.5 {
        Vec3::new(0.05, 0.2, 1.0).lerp(Vec3::new(0.1, 0.9, 0.2), 2.0 * x)
    } else {
        Vec3::new(0.1, 0.9, 0.2).lerp(Vec3::new(1.0, 0.8, 0.05), 2.0 * x - 1.0)
    }
}

/// Surfaces in grey, and the points on them that are seen.
fn dots(points: &[Point], eyes: &Eyes, view: &View, field: &Field) -> Picture {
    let (width, height) = (view.width(), view.height());
    let mut picture = paint(width, height, |x, y| {
        let place = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        let grey = eyes.at(place).map_or(0.0, |eye| {
            0.25 * eye.normal.dot(-view.ray(place).ray.direction).abs()
        });
        Vec3::splat(grey)
    });
    for point in points.iter().filter(|point| point.needed) {
        let Some(seen) = view.project(point.spot.position) else {
            continue;
        };
        let in_sight = eyes.at(seen.point).is_some_and(|eye| {
            let pixel = 1.0 / seen.density.sqrt();
            (eye.position - point.spot.position).length() < 4.0 * pixel
        });
        if !in_sight {
            continue;
        }
        let colour = heat(point.error, field.insert_above).to_array();
        let (x, y) = (seen.point.x as i32, seen.point.y as i32);
        for dy in -DOT..=DOT {
            for dx in -DOT..=DOT {
                let (px, py) = (x + dx, y + dy);
                let inside = px >= 0 && py >= 0 && px < width as i32 && py < height as i32;
                if inside && dx * dx + dy * dy <= DOT * DOT {
                    picture.pixels[(py as u32 * width + px as u32) as usize] = colour;
                }
            }
        }
    }
    picture
}
