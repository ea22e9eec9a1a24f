//! Looking at visibility records: their cells on what the camera sees, in false colours (Ulbrich 2013, Fig. 4).

use crate::camera::View;
use crate::geometry::{Geometry, Surface};
use glam::{Vec2, Vec3};
use occlude_image::Picture;
use occlude_visibility::Ray;
use occlude_visibility::Tracer;
use occlude_visibility::records::{Cache, RecordView};
use rayon::prelude::*;

/// What the colour of a record's cell says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordColour {
    /// How much the record matters (Eq. 1).
    Importance,
    /// How often it is used.
    Utility,
    /// How much its neighbours see what it sees.
    Correlation,
    /// Nothing: a colour of its own for each, and where the record stands.
    Positions,
}

impl RecordColour {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Importance,
        Self::Utility,
        Self::Correlation,
        Self::Positions,
    ];

    /// A word for file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Importance => "importance",
            Self::Utility => "utility",
            Self::Correlation => "correlation",
            Self::Positions => "positions",
        }
    }

    fn of(self, id: u32, record: &RecordView) -> Vec3 {
        match self {
            Self::Importance => heat(record.importance),
            Self::Utility => heat(record.utility),
            Self::Correlation => heat(record.correlation),
            Self::Positions => {
                let part = |k: f32| 0.25 + 0.5 * (id as f32 * k).fract();
                Vec3::new(part(0.618_034), part(0.754_878), part(0.569_84))
            }
        }
    }
}

/// Blue is 0, red is 1.
fn heat(value: f32) -> Vec3 {
    let x = 4.0 * value.clamp(0.0, 1.0);
    let ramp = |centre: f32| (2.0 - (x - centre).abs()).clamp(0.0, 1.0);
    Vec3::new(ramp(4.0), ramp(2.0), ramp(0.0))
}

/// Half the side of the dot that marks a record, pixels.
const DOT: f32 = 1.0;

/// Draws the cells of the records: what the camera sees is coloured by the record that answers for it, a little darker where it is seen
/// at a slant; dots are records that the camera sees. Black: the sky, and what has no record. The colours are display colours, to be
/// written without a tone map.
pub fn draw(cache: &Cache, geometry: &Geometry, view: &View, colour: RecordColour) -> Picture {
    let (width, height) = (view.width(), view.height());
    let records = cache.views();
    let rows: Vec<Vec<[f32; 3]>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let at = |x: u32| Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let rays: Vec<Ray> = (0..width).map(|x| view.ray(at(x)).ray).collect();
            let mut hits = vec![None; rays.len()];
            geometry.closest_batch(&rays, &mut hits);
            let shade = |(ray, hit): (&Ray, Option<_>)| {
                let surface = Surface::new(geometry, hit?, -ray.direction)?;
                let id = cache.nearest(surface.position, surface.normal)?;
                let facing = surface.normal.dot(-ray.direction).abs();
                let cell = colour.of(id, &records[id as usize]) * (0.55 + 0.45 * facing);
                // Linear values that look like these on a display.
                Some(cell.map(|c| c.powf(2.2)).to_array())
            };
            (rays.iter().zip(hits))
                .map(|pair| shade(pair).unwrap_or_default())
                .collect()
        })
        .collect();
    let mut picture = Picture {
        width,
        height,
        pixels: rows.into_iter().flatten().collect(),
    };
    for record in &records {
        let Some(seen) = view.project(record.site.position) else {
            continue;
        };
        if record.site.normal.dot(seen.toward_camera) <= 0.0
            || geometry.occluded(&Ray::between(record.site.origin, seen.eye))
        {
            continue;
        }
        let (low, high) = (seen.point - DOT, seen.point + DOT);
        for y in low.y.max(0.0) as u32..(high.y.max(0.0) as u32).min(height) {
            for x in low.x.max(0.0) as u32..(high.x.max(0.0) as u32).min(width) {
                let black = if colour == RecordColour::Positions {
                    1.0
                } else {
                    0.0
                };
                picture.pixels[(y * width + x) as usize] = [black; 3];
            }
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_runs_from_blue_to_red() {
        assert_eq!(heat(0.0), Vec3::Z);
        assert_eq!(heat(1.0), Vec3::X);
        assert_eq!(heat(0.5), Vec3::Y);
    }
}
