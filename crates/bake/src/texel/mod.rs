//! Texels as parts of surfaces: which triangles a texel covers, where on them, and what they reflect.
//!
//! A texel covers every triangle that its square touches ([`Texels::band`], conservative rasterization): no line of texels is lost at the
//! border of a chart or on triangles smaller than a texel. What is known of a texel is a list of [`Fragment`]s, one for each triangle,
//! with the part of the square that the triangle takes. A light map value stands for the mean over that covered part.
//!
//! Nothing is kept for all pages at once: bands of rows are made when they are asked for, independently of each other, and always alike.

mod clip;
pub mod reflect;
pub mod validity;

use crate::atlas::{Atlas, Layout, Rectangle};
use glam::{UVec2, Vec2, Vec3};
use occlude_render::geometry::WorldTriangle;
use occlude_scene::{Pose, Scene};
use occlude_visibility::Hit;
use std::collections::BTreeMap;
use std::ops::Range;

pub use clip::Polygon;
pub(crate) use clip::cover;

/// What a triangle takes of a texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Number of the texel, counted through all pages.
    pub texel: u32,
    /// The instance.
    pub instance: u32,
    /// The triangle of its mesh.
    pub primitive: u32,
    /// Part of the texel's square that it covers, in (0, 1]; triangles without area in the layout count as a ten thousandth.
    pub area: f32,
}

/// Texels of some rows of a page.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Band {
    /// By texel, then by instance, then by triangle.
    fragments: Vec<Fragment>,
    /// First fragment of every covered texel, and one past the last.
    first: Vec<u32>,
}

impl Band {
    /// Number of texels that something covers.
    pub fn len(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    /// Nothing is covered.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Fragments of the `i`-th covered texel, at least one, and all of one texel. Texels come in ascending order.
    pub fn fragments(&self, i: usize) -> &[Fragment] {
        &self.fragments[self.first[i] as usize..self.first[i + 1] as usize]
    }

    /// Number of the `i`-th covered texel, counted through all pages.
    pub fn texel(&self, i: usize) -> u32 {
        self.fragments[self.first[i] as usize].texel
    }

    /// Those texels of whose fragments `keep` says so.
    pub(crate) fn filtered(&self, keep: impl Fn(&[Fragment]) -> bool) -> Self {
        let mut kept = Self::default();
        for fragments in (0..self.len()).map(|i| self.fragments(i)) {
            if keep(fragments) {
                kept.first.push(kept.fragments.len() as u32);
                kept.fragments.extend_from_slice(fragments);
            }
        }
        if !kept.first.is_empty() {
            kept.first.push(kept.fragments.len() as u32);
        }
        kept
    }

    /// Bytes that the band holds.
    pub fn bytes(&self) -> u64 {
        (self.fragments.capacity() * size_of::<Fragment>() + self.first.capacity() * 4) as u64
    }
}

/// A piece of a layout on a page.
#[derive(Clone, Copy, Debug)]
struct Piece {
    instance: u32,
    layout: u32,
    piece: u32,
    rectangle: Rectangle,
}

/// The texels of an atlas.
#[derive(Clone, Debug)]
pub struct Texels<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Where everything is.
    pub pose: &'a Pose,
    /// Where texels are.
    pub atlas: &'a Atlas,
    by_page: Vec<Vec<Piece>>,
}

/// Covered parts smaller than this, in texels, are rounding.
const LEAST_AREA: f32 = 1e-5;
/// What a triangle without area in the layout counts as.
const NO_AREA: f32 = 1e-4;

impl<'a> Texels<'a> {
    /// Sorts rectangles by page; cheap.
    pub fn new(scene: &'a Scene, pose: &'a Pose, atlas: &'a Atlas) -> Self {
        let mut by_page = vec![Vec::new(); atlas.pages.len()];
        for (instance, placement) in atlas.placements.iter().enumerate() {
            let Some(placement) = placement else { continue };
            for piece in 0..atlas.layouts[placement.layout as usize].pieces.len() as u32 {
                let rectangle = atlas.rectangles[(placement.first_rectangle + piece) as usize];
                by_page[rectangle.page as usize].push(Piece {
                    instance: instance as u32,
                    layout: placement.layout,
                    piece,
                    rectangle,
                });
            }
        }
        Self {
            scene,
            pose,
            atlas,
            by_page,
        }
    }

    /// All rows of all pages, `rows` at a time.
    pub fn bands(&self, rows: u32) -> impl Iterator<Item = (u32, Range<u32>)> + '_ {
        let step = rows.max(1);
        self.atlas
            .pages
            .iter()
            .enumerate()
            .flat_map(move |(page, size)| {
                let starts = (0..size.height).step_by(step as usize);
                starts.map(move |y| (page as u32, y..(y + step).min(size.height)))
            })
    }

    /// For every piece of an instance on a page (by instance and piece) the number of charts on the page before it.
    pub(crate) fn first_charts(&self, page: u32) -> BTreeMap<(u32, u32), u32> {
        let mut before = 0;
        let mut first = BTreeMap::new();
        for piece in &self.by_page[page as usize] {
            first.insert((piece.instance, piece.piece), before);
            // Charts are counted through all pieces of a layout; some numbers stay unused.
            before += self.atlas.layouts[piece.layout as usize].chart_count();
        }
        first
    }

    fn layout(&self, instance: u32) -> Option<&Layout> {
        let placement = (*self.atlas.placements.get(instance as usize)?)?;
        self.atlas.layouts.get(placement.layout as usize)
    }

    /// The chart of a triangle, counted through its layout.
    pub fn chart(&self, instance: u32, primitive: u32) -> Option<u32> {
        let chart = *self.layout(instance)?.charts.get(primitive as usize)?;
        (chart != Layout::NO_CHART).then_some(chart)
    }

    /// The piece of a layout that a triangle lies on.
    pub(crate) fn piece(&self, instance: u32, primitive: u32) -> u32 {
        self.layout(instance)
            .map_or(0, |layout| layout.piece(primitive))
    }

    /// The covered texels of some rows of a page.
    pub fn band(&self, page: u32, rows: Range<u32>) -> Band {
        let mut fragments = Vec::new();
        let size = self.atlas.pages[page as usize];
        for piece in &self.by_page[page as usize] {
            let layout = &self.atlas.layouts[piece.layout as usize];
            let UVec2 { x: left, y: top } = piece.rectangle.offset;
            let height = layout.pieces[piece.piece as usize].y;
            let local = rows.start.max(top)..rows.end.min(top + height);
            if local.is_empty() {
                continue;
            }
            let local = local.start - top..local.end - top;
            for &primitive in layout.in_rows(piece.piece, local.clone()) {
                let corners = layout.corners[primitive as usize];
                clip::cover(corners, local.clone(), |x, y, area| {
                    fragments.push(Fragment {
                        texel: size.texel((left + x).min(size.width - 1), top + y),
                        instance: piece.instance,
                        primitive,
                        area: if area > LEAST_AREA {
                            area.min(1.0)
                        } else {
                            NO_AREA
                        },
                    });
                });
            }
        }
        // Slivers that only touch a texel do not count where something covers it.
        fragments.sort_unstable_by_key(|f: &Fragment| (f.texel, f.instance, f.primitive));
        let mut first = Vec::new();
        for (i, f) in fragments.iter().enumerate() {
            if i == 0 || fragments[i - 1].texel != f.texel {
                first.push(i as u32);
            }
        }
        if !first.is_empty() {
            first.push(fragments.len() as u32);
        }
        Band { fragments, first }
    }

    /// The column and the row of a texel on its page, and the page.
    pub fn place(&self, texel: u32) -> (u32, UVec2) {
        let pages = &self.atlas.pages;
        let page = pages
            .partition_point(|p| p.first_texel <= texel)
            .saturating_sub(1);
        let local = texel - pages[page].first_texel;
        (
            page as u32,
            UVec2::new(local % pages[page].width, local / pages[page].width),
        )
    }

    /// A point uniformly in the covered part of the `i`-th texel of a band, from two numbers in `[0, 1)`.
    pub fn sample(&self, band: &Band, i: usize, random: Vec2) -> Hit {
        let fragments = band.fragments(i);
        let total: f32 = fragments.iter().map(|f| f.area).sum();
        let mut target = random.x * total;
        let mut chosen = fragments[fragments.len() - 1];
        for f in fragments {
            if target < f.area {
                chosen = *f;
                break;
            }
            target -= f.area;
        }
        let within = Vec2::new((target / chosen.area).clamp(0.0, 1.0), random.y);
        let (polygon, corners) = self.polygon(&chosen);
        let at = polygon.sample(within).unwrap_or(corners[0]);
        self.hit(&chosen, corners, at)
    }

    /// The point that stands for the `i`-th texel of a band: its centre, or the nearest that is covered, roughly.
    pub fn representative(&self, band: &Band, i: usize) -> Hit {
        let fragments = band.fragments(i);
        let (_, at) = self.place(fragments[0].texel);
        let centre = at.as_vec2() + 0.5;
        let mut best = (f32::MAX, fragments[0]);
        for f in fragments {
            let (polygon, _) = self.polygon(f);
            let distance = polygon
                .centroid()
                .unwrap_or(centre + 1.0)
                .distance_squared(centre)
                - f.area;
            if polygon.contains(centre) {
                best = (f32::MIN, *f);
                break;
            }
            if distance < best.0 {
                best = (distance, *f);
            }
        }
        let (polygon, corners) = self.polygon(&best.1);
        let at = if best.0 == f32::MIN {
            centre
        } else {
            polygon.centroid().unwrap_or(corners[0])
        };
        self.hit(&best.1, corners, at)
    }

    /// Where the point that stands for the `i`-th texel of a band is in the world, and the normal there.
    pub(crate) fn world_place(&self, band: &Band, i: usize) -> (Vec3, Vec3) {
        let hit = self.representative(band, i);
        let world = WorldTriangle::new(self.scene, self.pose, hit.instance, hit.primitive);
        (
            world.point(hit.u, hit.v),
            self.normal(&world, hit.instance, hit.primitive),
        )
    }

    /// The normal of a triangle on the side that is baked; zero without area.
    pub(crate) fn normal(&self, world: &WorldTriangle, instance: u32, primitive: u32) -> Vec3 {
        let front = world.front_cross().normalize_or_zero();
        if self.atlas.is_turned(instance, primitive) {
            -front
        } else {
            front
        }
    }

    /// Square metres of the world that the `i`-th texel of a band covers.
    pub fn world_area(&self, band: &Band, i: usize) -> f32 {
        let fragments = band.fragments(i).iter();
        fragments.map(|f| self.fragment_area(f)).sum()
    }

    /// Square metres of the world of which [`Texels::sample`] chooses a point as if that were all: one over its density at `hit`.
    pub(crate) fn sampled_area(&self, band: &Band, i: usize, hit: Hit) -> f32 {
        let fragments = band.fragments(i);
        let total: f32 = fragments.iter().map(|f| f.area).sum();
        let chosen = |f: &&Fragment| (f.instance, f.primitive) == (hit.instance, hit.primitive);
        let chosen = fragments.iter().find(chosen);
        chosen.map_or(0.0, |f| self.fragment_area(f) * total / f.area)
    }

    fn fragment_area(&self, f: &Fragment) -> f32 {
        let Some((_, [a, b, c])) = self.atlas.triangle(f.instance, f.primitive) else {
            return 0.0;
        };
        let world = WorldTriangle::new(self.scene, self.pose, f.instance, f.primitive);
        let texels = 0.5 * (b - a).perp_dot(c - a).abs();
        let metres = 0.5 * world.front_cross().length();
        if texels > LEAST_AREA {
            f.area * metres / texels
        } else {
            metres
        }
    }

    /// Where the parts of the `i`-th texel of a band have their corners in the world.
    pub(crate) fn world_corners(&self, band: &Band, i: usize) -> Vec<Vec3> {
        let mut found = Vec::new();
        for f in band.fragments(i) {
            let world = WorldTriangle::new(self.scene, self.pose, f.instance, f.primitive);
            let (polygon, corners) = self.polygon(f);
            if polygon.area() > LEAST_AREA {
                found.extend(polygon.points().iter().map(|&at| {
                    let hit = self.hit(f, corners, at);
                    world.point(hit.u, hit.v)
                }));
            } else {
                found.extend(world.corners);
            }
        }
        found
    }

    /// A fragment's shape, and its triangle's corners, on the page.
    fn polygon(&self, f: &Fragment) -> (Polygon, [Vec2; 3]) {
        let (_, at) = self.place(f.texel);
        let corners = self
            .atlas
            .triangle(f.instance, f.primitive)
            .map_or([Vec2::ZERO; 3], |(_, c)| c);
        (Polygon::of_texel(corners, at.x, at.y), corners)
    }

    fn hit(&self, f: &Fragment, [a, b, c]: [Vec2; 3], at: Vec2) -> Hit {
        let (e1, e2, p) = (b - a, c - a, at - a);
        let area = e1.perp_dot(e2);
        let (mut u, mut v) = (p.perp_dot(e2) / area, e1.perp_dot(p) / area);
        if !(u.is_finite() && v.is_finite()) {
            (u, v) = (1.0 / 3.0, 1.0 / 3.0);
        }
        (u, v) = (u.clamp(0.0, 1.0), v.clamp(0.0, 1.0));
        let beyond = (u + v).max(1.0);
        Hit {
            t: 0.0,
            u: u / beyond,
            v: v / beyond,
            instance: f.instance,
            primitive: f.primitive,
        }
    }
}
