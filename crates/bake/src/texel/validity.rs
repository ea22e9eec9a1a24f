//! Which part of a texel is inside of something solid, where no light comes and nobody looks: the floor below a wall that stands on it.
//!
//! A point is inside when a ray from it first meets the back of a closed, opaque, single-sided mesh. Such points gather no light, so the mean
//! over a texel that is partly inside is too dark by just the share that is outside: dividing by it repairs the texel. Texels that are
//! hardly outside at all are filled from their neighbours.
//!
//! Class: bounded; the share of texels on a border is known to a few hundredths. Two rays a texel where nothing is inside. Wrong for meshes with holes: they
//! count as open, and light in them is kept as it is.

use super::{Band, Texels};
use crate::bundle::is_closed;
use glam::{Vec2, Vec3};
use occlude_render::geometry::{Geometry, WorldTriangle};
use occlude_scene::{AlphaMode, Scene};
use occlude_visibility::{Hit, Ray, offset_along_normal};
use rayon::prelude::*;

/// Points that tell whether a texel is worth a closer look.
const FIRST_POINTS: usize = 2;
/// Points of the closer look.
const POINTS: usize = 32;
/// Rows that one task does.
const ROWS: u32 = 8;

/// Which meshes are solid: inside of them is nothing to see.
#[derive(Clone, Debug)]
pub struct Solids(Vec<bool>);

impl Solids {
    /// Looks at all meshes. O(n log n).
    pub fn of(scene: &Scene) -> Self {
        let solid = |mesh: &occlude_scene::Mesh| {
            let m = &scene.materials[mesh.material as usize];
            let opaque = m.alpha_mode == AlphaMode::Opaque && m.transmission == 0.0;
            opaque && !m.double_sided && is_closed(mesh)
        };
        Self(scene.meshes.par_iter().map(solid).collect())
    }

    /// No mesh is.
    pub fn is_empty(&self) -> bool {
        !self.0.contains(&true)
    }
}

/// For every texel of a page the share of its covered part that is outside of all solids; 1 where nothing is covered.
pub fn validity(geometry: &Geometry, texels: &Texels, solids: &Solids, page: u32) -> Vec<f32> {
    let size = texels.atlas.pages[page as usize];
    let mut coarse = vec![1.0; size.texels() as usize];
    if solids.is_empty() {
        return coarse;
    }
    let width = size.width as usize;
    let band = |k: usize| {
        let top = k as u32 * ROWS;
        texels.band(page, top..(top + ROWS).min(size.height))
    };
    coarse
        .par_chunks_mut(width * ROWS as usize)
        .enumerate()
        .for_each(|(k, out)| {
            let band = band(k);
            let all: Vec<u32> = (0..band.len() as u32).collect();
            let found = outside(geometry, texels, solids, &band, &all, FIRST_POINTS);
            let first = size.texel(0, k as u32 * ROWS);
            for (i, share) in found.into_iter().enumerate() {
                out[(band.texel(i) - first) as usize] = share;
            }
        });
    // A border may pass between the first points; then it shows beside them.
    let doubtful = |x: usize, y: usize| {
        let rows = y.saturating_sub(1)..(y + 2).min(size.height as usize);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        rows.into_iter().any(|y| {
            coarse[y * width..][columns.clone()]
                .iter()
                .any(|&s| s < 1.0)
        })
    };
    let mut fine = coarse.clone();
    fine.par_chunks_mut(width * ROWS as usize)
        .enumerate()
        .for_each(|(k, out)| {
            let top = k * ROWS as usize;
            let near: Vec<usize> = (0..out.len())
                .filter(|i| doubtful(i % width, top + i / width))
                .collect();
            if near.is_empty() {
                return;
            }
            let band = band(k);
            let first = size.texel(0, top as u32);
            let local = |i: u32| (band.texel(i as usize) - first) as usize;
            let wanted: Vec<u32> = (0..band.len() as u32)
                .filter(|&i| near.binary_search(&local(i)).is_ok())
                .collect();
            let found = outside(geometry, texels, solids, &band, &wanted, POINTS);
            for (&i, share) in wanted.iter().zip(found) {
                out[local(i)] = share;
            }
        });
    fine
}

/// The share of points outside, for some texels of a band.
fn outside(
    geometry: &Geometry,
    texels: &Texels,
    solids: &Solids,
    band: &Band,
    wanted: &[u32],
    points: usize,
) -> Vec<f32> {
    let mut rays = Vec::with_capacity(wanted.len() * points);
    for &i in wanted {
        for k in 0..points {
            // R2 (Roberts 2018).
            let at = Vec2::new(0.5 + k as f32 * 0.754_877_7, 0.5 + k as f32 * 0.569_840_3).fract();
            let hit = texels.sample(band, i as usize, at);
            rays.push(ray(texels, hit, k));
        }
    }
    let mut hits = vec![None; rays.len()];
    geometry.closest_batch(&rays, &mut hits);
    let inside = |(ray, hit): (&Ray, &Option<Hit>)| {
        let Some(hit) = hit else { return false };
        let mesh = texels.pose.instances[hit.instance as usize].mesh;
        let front = WorldTriangle::new(texels.scene, texels.pose, hit.instance, hit.primitive)
            .front_cross();
        solids.0[mesh as usize] && front.dot(ray.direction) > 0.0
    };
    rays.chunks(points)
        .zip(hits.chunks(points))
        .map(|(rays, hits)| {
            let count = rays.iter().zip(hits).filter(|&pair| inside(pair)).count();
            1.0 - count as f32 / points as f32
        })
        .collect()
}

/// A ray into the half space that a point sees: near the normal, turned a little so that no two meet the same edge.
fn ray(texels: &Texels, hit: Hit, k: usize) -> Ray {
    let triangle = WorldTriangle::new(texels.scene, texels.pose, hit.instance, hit.primitive);
    let normal = texels
        .normal(&triangle, hit.instance, hit.primitive)
        .normalize_or(Vec3::Y);
    let (x, y) = normal.any_orthonormal_pair();
    let turn = Vec2::from_angle(k as f32 * 2.399_963);
    let direction = normal + (x * turn.x + y * turn.y) * 0.37;
    Ray::new(
        offset_along_normal(triangle.point(hit.u, hit.v), normal, triangle.extent()),
        direction,
    )
}
