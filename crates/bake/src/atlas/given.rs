//! Light map UVs that the scene brings along (`TEXCOORD_1`): whether they are fit, and the layout that they give.

use super::unwrap::{Surface, cross, overlap_of};
use super::{Layout, arrange::TooLarge};
use crate::texel::cover;
use glam::{UVec2, Vec2, Vec3};
use std::collections::BTreeMap;

/// What is wrong with given UVs.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unfit {
    /// Coordinates outside of the unit square.
    #[error("{triangles} triangles lie outside of the unit square")]
    OutOfBounds {
        /// How many.
        triangles: usize,
    },
    /// Triangles that are points or lines in the UVs and not in the world.
    #[error("{triangles} triangles have no area in it")]
    NoArea {
        /// How many.
        triangles: usize,
    },
    /// Surfaces on top of each other.
    #[error("surfaces overlap in it (triangle {triangle} lies on another)")]
    Overlap {
        /// One of them.
        triangle: usize,
    },
    /// Islands in one texel.
    #[error("islands are less than a texel apart at {texels_per_metre} texels a metre")]
    TooClose {
        /// At this density.
        texels_per_metre: f32,
    },
}

/// A fit layout, and what is still to be said about it.
#[derive(Debug)]
pub(super) struct Given {
    pub layout: Layout,
    /// Islands keep less distance than asked for.
    pub narrow: bool,
}

/// The layout of a mesh by its own UVs, which must be as long as its positions.
pub(super) fn layout(
    mesh: u32,
    surface: &Surface,
    uv: &[Vec2],
    padding: u32,
    page_size: u32,
) -> Result<Result<Given, Unfit>, TooLarge> {
    const SLACK: f32 = 1e-4;
    let corners = |t: &[u32; 3]| t.map(|i| uv[i as usize]);
    let inside =
        |c: &Vec2| c.is_finite() && c.min_element() >= -SLACK && c.max_element() <= 1.0 + SLACK;
    let outside = surface
        .triangles
        .iter()
        .filter(|t| !corners(t).iter().all(inside))
        .count();
    if outside > 0 {
        return Ok(Err(Unfit::OutOfBounds { triangles: outside }));
    }
    let (mut world, mut flat, mut without) = (0.0_f64, 0.0_f64, 0);
    for t in surface.triangles {
        let metres = 0.5 * cross(surface.positions, *t).length();
        let [a, b, c] = corners(t);
        let area = 0.5 * (b - a).perp_dot(c - a).abs();
        world += f64::from(metres);
        flat += f64::from(area);
        without += usize::from(metres > 0.0 && area <= 1e-12);
    }
    if without > 0 {
        return Ok(Err(Unfit::NoArea { triangles: without }));
    }
    if let Some(triangle) = overlap_of(surface.triangles.iter().map(corners), 2048.0) {
        return Ok(Err(Unfit::Overlap { triangle }));
    }
    // As many texels as the surface is worth.
    let side = (f64::from(surface.texels_per_metre) * (world / flat).sqrt())
        .round()
        .max(1.0) as f32;
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for t in surface.triangles {
        for c in corners(t) {
            (low, high) = (low.min(c), high.max(c));
        }
    }
    let origin = (low * side).floor().max(Vec2::ZERO);
    let size = ((high * side).ceil() - origin).max(Vec2::ONE);
    if size.max_element() > page_size as f32 {
        return Err(TooLarge {
            shrink: (page_size - 1) as f32 / size.max_element(),
        });
    }
    let size = size.as_uvec2();
    let (charts, count) = islands(surface, uv);
    let limit = size.as_vec2();
    let mut layout = Layout {
        mesh,
        corners: surface
            .triangles
            .iter()
            .map(|t| corners(t).map(|c| (c * side - origin).clamp(Vec2::ZERO, limit)))
            .collect(),
        charts,
        pieces: vec![size],
        chart_count: count,
        ..Layout::default()
    };
    let distance = distance(&layout, size, padding);
    if distance == 0 && count > 1 {
        return Ok(Err(Unfit::TooClose {
            texels_per_metre: surface.texels_per_metre,
        }));
    }
    layout.index_rows();
    Ok(Ok(Given {
        layout,
        narrow: distance < padding,
    }))
}

/// Triangles that hang together by vertices with the same UV and place.
fn islands(surface: &Surface, uv: &[Vec2]) -> (Vec<u32>, u32) {
    let mut first: BTreeMap<[u32; 5], u32> = BTreeMap::new();
    let mut parent: Vec<u32> = (0..uv.len() as u32).collect();
    for (i, (p, uv)) in surface.positions.iter().zip(uv).enumerate() {
        let key = |p: Vec3, uv: Vec2| [p.x, p.y, p.z, uv.x, uv.y].map(|x| (x + 0.0).to_bits());
        parent[i] = *first.entry(key(*p, *uv)).or_insert(i as u32);
    }
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    for [a, b, c] in surface.triangles {
        for other in [b, c] {
            let (x, y) = (root(&mut parent, *a), root(&mut parent, *other));
            parent[x.max(y) as usize] = x.min(y);
        }
    }
    let mut number: BTreeMap<u32, u32> = BTreeMap::new();
    let charts = surface
        .triangles
        .iter()
        .map(|t| {
            if cross(surface.positions, *t) == Vec3::ZERO {
                return Layout::NO_CHART;
            }
            let next = number.len() as u32;
            *number.entry(root(&mut parent, t[0])).or_insert(next)
        })
        .collect();
    (charts, number.len() as u32)
}

/// The least number of free texels between two islands, up to `enough`.
fn distance(layout: &Layout, size: UVec2, enough: u32) -> u32 {
    let (width, height) = (size.x as usize, size.y as usize);
    let mut owner = vec![0_u32; width * height];
    let mut shared = false;
    for (corners, &chart) in layout.corners.iter().zip(&layout.charts) {
        if chart == Layout::NO_CHART {
            continue;
        }
        cover(*corners, 0..size.y, |x, y, area| {
            // Borders may run into a texel by a hair.
            if area < 0.02 {
                return;
            }
            let slot = &mut owner[y as usize * width + (x as usize).min(width - 1)];
            shared |= *slot != 0 && *slot != chart + 1;
            *slot = chart + 1;
        });
    }
    if shared {
        return 0;
    }
    let mut least = enough + 1;
    for y in 0..height {
        for x in 0..width {
            let own = owner[y * width + x];
            if own == 0 {
                continue;
            }
            for d in 1..least as usize {
                let right = (x + d < width).then(|| owner[y * width + x + d]);
                let below = (y + d < height).then(|| owner[(y + d) * width + x]);
                if [right, below]
                    .into_iter()
                    .flatten()
                    .any(|o| o != 0 && o != own)
                {
                    least = d as u32;
                    break;
                }
            }
        }
    }
    // Neighbours are a distance of 1 apart, with nothing between.
    least - 1
}
