//! What the camera sees: one surface point a pixel, in tiles.
//!
//! What Wang et al. 2013, section 6, rasterize into frame buffers (position, frame, material) is found by a ray through the middle of every pixel here, tile by tile as coherent
//! packets; of the hit all else follows. Lines of sight pass clear panes, which tint them.
//!
//! Holds: a pixel's answer is its own, whatever tile it lies in. Wrong tool for what is smaller than a pixel (edges get more samples later, found by comparing neighbours:
//! a speck between the middles of pixels is never seen), for depth of field and for motion blur: one point stands for the pixel.

use crate::camera::View;
use crate::geometry::{Geometry, Place, is_pane};
use glam::{Vec2, Vec3};
use occlude_visibility::{Hit, Ray};
use rayon::prelude::*;

/// Width and height of a tile, pixels.
pub(super) const TILE: u32 = 8;

/// Panes that a line of sight may pass.
const MOST_PANES: u32 = 16;

/// A surface point that a pixel shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eye {
    pub(super) hit: Hit,
    pub(super) position: Vec3,
    /// Smooth normal on the side that is seen.
    pub(super) normal: Vec3,
}

/// A line of sight through panes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Panes {
    /// Which of the tile's lines of sight.
    pub(super) index: u16,
    /// What passes them, by colour.
    pub(super) tint: Vec3,
    /// First of them, which also mirrors the sky.
    pub(super) first: Hit,
}

/// A rectangle of pixels and what they see, row after row.
#[derive(Clone, Debug, Default)]
pub(super) struct Tile {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) eyes: Vec<Option<Eye>>,
    pub(super) panes: Vec<Panes>,
    /// A ball that holds what is seen.
    pub(super) centre: Vec3,
    pub(super) radius: f32,
}

impl Tile {
    /// Whether nothing but sky is seen.
    pub(super) fn is_empty(&self) -> bool {
        self.radius < 0.0
    }
}

/// What the camera sees of a frame.
#[derive(Debug)]
pub(super) struct Eyes {
    pub(super) tiles: Vec<Tile>,
    across: u32,
    /// Pixels that see a surface.
    pub(super) covered: u32,
    pub(super) rays: u64,
}

impl Eyes {
    /// One line of sight through the middle of every pixel.
    pub(super) fn trace(geometry: &Geometry, view: &View) -> Self {
        let (width, height) = (view.width(), view.height());
        let (across, down) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let tiles: Vec<Tile> = (0..across * down)
            .into_par_iter()
            .map(|index| {
                let (x, y) = (index % across * TILE, index / across * TILE);
                let (w, h) = (TILE.min(width - x), TILE.min(height - y));
                let points = (0..w * h)
                    .map(|i| Vec2::new((x + i % w) as f32 + 0.5, (y + i / w) as f32 + 0.5));
                let rays: Vec<Ray> = points.map(|point| view.ray(point).ray).collect();
                let mut tile = Tile {
                    x,
                    y,
                    width: w,
                    height: h,
                    ..Tile::default()
                };
                look(geometry, &rays, &mut tile.eyes, &mut tile.panes);
                bound(&mut tile);
                tile
            })
            .collect();
        let covered = tiles.iter().map(|t| t.eyes.iter().flatten().count() as u32);
        Self {
            across,
            covered: covered.sum(),
            rays: u64::from(width) * u64::from(height),
            tiles,
        }
    }

    /// What is seen at a point of the picture, pixels.
    pub(super) fn at(&self, point: Vec2) -> Option<&Eye> {
        let (x, y) = (point.x.floor(), point.y.floor());
        let last = self.tiles.last()?;
        if x < 0.0
            || y < 0.0
            || x >= (last.x + last.width) as f32
            || y >= (last.y + last.height) as f32
        {
            return None;
        }
        let (x, y) = (x as u32, y as u32);
        let tile = &self.tiles[(y / TILE * self.across + x / TILE) as usize];
        tile.eyes[((y - tile.y) * tile.width + x - tile.x) as usize].as_ref()
    }
}

/// The first surface along each ray that is no pane.
pub(super) fn look(
    geometry: &Geometry,
    rays: &[Ray],
    eyes: &mut Vec<Option<Eye>>,
    panes: &mut Vec<Panes>,
) {
    let mut hits = vec![None; rays.len()];
    geometry.closest_coherent(rays, &mut hits);
    eyes.clear();
    panes.clear();
    let glass = geometry.has_panes();
    for (index, (ray, hit)) in rays.iter().zip(hits).enumerate() {
        let hit = if glass {
            behind_panes(geometry, ray, hit, index as u16, panes)
        } else {
            hit
        };
        eyes.push(hit.and_then(|hit| {
            let (_, spot) = Place::of_hit(geometry, &hit, -ray.direction)?;
            Some(Eye {
                hit,
                position: spot.position,
                normal: spot.normal,
            })
        }));
    }
}

fn is_pane_hit(geometry: &Geometry, hit: &Hit) -> bool {
    let mesh = geometry.pose.instances[hit.instance as usize].mesh;
    let material = geometry.scene.meshes[mesh as usize].material;
    is_pane(&geometry.scene.materials[material as usize])
}

fn behind_panes(
    geometry: &Geometry,
    ray: &Ray,
    first: Option<Hit>,
    index: u16,
    panes: &mut Vec<Panes>,
) -> Option<Hit> {
    let mut hit = first?;
    if !is_pane_hit(geometry, &hit) {
        return first;
    }
    let pane = hit;
    let mut rest = *ray;
    let mut seen = None;
    for _ in 0..MOST_PANES {
        rest.t_min = hit.t;
        let mut next = [None];
        geometry.closest_batch(&[rest], &mut next);
        match next[0] {
            Some(behind) if is_pane_hit(geometry, &behind) => hit = behind,
            other => {
                seen = other;
                break;
            }
        }
    }
    let upto = Ray {
        t_max: seen.map_or(f32::INFINITY, |hit| hit.t),
        ..*ray
    };
    panes.push(Panes {
        index,
        tint: geometry.pane_transmittance(&upto),
        first: pane,
    });
    seen
}

fn bound(tile: &mut Tile) {
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for eye in tile.eyes.iter().flatten() {
        low = low.min(eye.position);
        high = high.max(eye.position);
    }
    tile.centre = (low + high) * 0.5;
    tile.radius = if low.x <= high.x {
        (high - low).length() * 0.5
    } else {
        tile.centre = Vec3::ZERO;
        -1.0
    };
}
