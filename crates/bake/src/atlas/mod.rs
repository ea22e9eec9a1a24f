//! The atlas: where on which page each triangle's texels are.
//!
//! [`build`] cuts every mesh into charts ([`unwrap`]), lays them flat beside each other in a [`Layout`] (one for each mesh, size and
//! density that occurs), and packs one rectangle for every instance onto [`Page`]s. A layout that is larger than a page comes in
//! several *pieces*, each within a page.
//!
//! Texel (x, y) of a page covers the square from (x, y) to (x + 1, y + 1) in page coordinates, x to the right, y down, (0, 0) the top
//! left corner. Texels of all pages are numbered through, row by row.
//!
//! Invariants: triangles of one page do not overlap, up to a part of a texel; charts are at least [`AtlasSettings::padding`] texels
//! apart; straight borders of charts run through texel centres, so bilinear lookups on a chart read nothing outside of it; the same
//! scene and settings give the same atlas on any machine and any number of threads. Wrong for surfaces that are never lit from
//! texels, such as hair: every strand costs charts.

mod arrange;
mod build;
pub mod density;
pub mod given;
mod pages;
mod skyline;
pub mod unwrap;

pub use build::{AtlasError, AtlasSettings, Built, Problem, UnwrapKind, build};

use glam::{UVec2, Vec2};

/// One texture of the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Number of the page's first texel.
    pub first_texel: u32,
}

impl Page {
    /// Number of the texel at column `x`, row `y`.
    pub fn texel(&self, x: u32, y: u32) -> u32 {
        self.first_texel + y * self.width + x
    }

    /// Texels of the page.
    pub fn texels(&self) -> u32 {
        self.width * self.height
    }
}

/// Rows that share an entry of a layout's index by rows.
const BUCKET_ROWS: u32 = 16;

/// Triangles of a mesh laid out flat, in texels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// The mesh whose triangles these are.
    pub mesh: u32,
    /// The corners of every triangle, texels from the top left corner of its piece. Triangles without area, and those that could not be
    /// laid out, are points.
    pub corners: Vec<[Vec2; 3]>,
    /// The chart of every triangle, counted through the layout; [`Layout::NO_CHART`] if it has none.
    pub charts: Vec<u32>,
    /// By chart: its texels are those of the side from which vertices run clockwise; empty: none is turned. See [`crate::orient`].
    pub turned: Vec<bool>,
    /// Width and height of every piece, texels; never empty.
    pub pieces: Vec<UVec2>,
    /// The piece of every triangle; empty if there is only one.
    pub piece_of: Vec<u16>,
    /// Triangles with a chart, by piece and by bucket of rows in which they begin.
    order: Vec<u32>,
    /// For every piece the first entry of each bucket in `order`, and one past the last bucket's last.
    buckets: Vec<Vec<u32>>,
    /// The tallest triangle of every piece, rows.
    tallest: Vec<u32>,
    chart_count: u32,
    /// The density that was asked for, texels a metre of the world; 0: unknown. Small charts are denser: none has less than a texel.
    pub texels_per_metre: f32,
}

impl Layout {
    /// Marks a triangle without a chart.
    pub const NO_CHART: u32 = u32::MAX;

    /// Number of charts.
    pub fn chart_count(&self) -> u32 {
        self.chart_count
    }

    /// The piece that a triangle lies on.
    pub fn piece(&self, primitive: u32) -> u32 {
        self.piece_of
            .get(primitive as usize)
            .map_or(0, |&p| u32::from(p))
    }

    /// Triangles of a piece that may touch rows `rows` of it, in an order that never changes.
    pub fn in_rows(&self, piece: u32, rows: std::ops::Range<u32>) -> &[u32] {
        let (Some(buckets), Some(&tallest)) = (
            self.buckets.get(piece as usize),
            self.tallest.get(piece as usize),
        ) else {
            return &[];
        };
        let last = buckets.len() - 1;
        let from = (rows.start.saturating_sub(tallest) / BUCKET_ROWS) as usize;
        let to = rows.end.div_ceil(BUCKET_ROWS) as usize;
        &self.order[buckets[from.min(last)] as usize..buckets[to.min(last)] as usize]
    }

    /// Bytes that the layout holds.
    pub fn bytes(&self) -> u64 {
        let held = self.corners.capacity() * size_of::<[Vec2; 3]>()
            + self.charts.capacity() * 4
            + self.turned.capacity()
            + self.piece_of.capacity() * 2
            + self.order.capacity() * 4
            + self.buckets.iter().map(|b| b.capacity() * 4).sum::<usize>();
        held as u64
    }

    /// Sorts triangles by rows. Everything else is set.
    fn index_rows(&mut self) {
        let top =
            |corners: &[Vec2; 3]| corners.iter().fold(f32::MAX, |y, c| y.min(c.y)).max(0.0) as u32;
        let bottom = |corners: &[Vec2; 3]| corners.iter().fold(0.0_f32, |y, c| y.max(c.y)) as u32;
        let mut keyed: Vec<(u32, u32, u32)> = Vec::with_capacity(self.corners.len());
        self.tallest = vec![0; self.pieces.len()];
        for (t, corners) in self.corners.iter().enumerate() {
            if self.charts[t] != Self::NO_CHART {
                let piece = self.piece(t as u32);
                let first = top(corners);
                let rows = bottom(corners) - first + 1;
                let tallest = &mut self.tallest[piece as usize];
                *tallest = rows.max(*tallest);
                keyed.push((piece, first / BUCKET_ROWS, t as u32));
            }
        }
        keyed.sort_unstable();
        let mut at = 0;
        self.buckets = self
            .pieces
            .iter()
            .enumerate()
            .map(|(piece, size)| {
                let mut starts = Vec::with_capacity(size.y.div_ceil(BUCKET_ROWS) as usize + 1);
                for bucket in 0..size.y.div_ceil(BUCKET_ROWS) {
                    starts.push(at as u32);
                    while keyed
                        .get(at)
                        .is_some_and(|k| (k.0, k.1) == (piece as u32, bucket))
                    {
                        at += 1;
                    }
                }
                starts.push(at as u32);
                starts
            })
            .collect();
        self.order = keyed.into_iter().map(|(.., t)| t).collect();
    }
}

/// Where the pieces of an instance's layout lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// Index into [`Atlas::layouts`].
    pub layout: u32,
    /// Index into [`Atlas::rectangles`] of its first piece; the others follow.
    pub first_rectangle: u32,
}

/// Where a piece lies on a page. It is never scaled: its texels are the page's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rectangle {
    /// Index into [`Atlas::pages`].
    pub page: u32,
    /// Its top left corner, texels.
    pub offset: UVec2,
    /// Index into [`Atlas::blocks`].
    pub block: u32,
}

/// A rectangle that holds the pieces of everything that hangs on a node at one place: what an engine needs to know. A node whose pieces fill
/// more than a page has several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Index into the scene's nodes.
    pub node: u32,
    /// Which of the node's places it is (`EXT_mesh_gpu_instancing`); otherwise 0.
    pub occurrence: u32,
    /// Index into [`Atlas::pages`].
    pub page: u32,
    /// Its top left corner, texels.
    pub offset: UVec2,
    /// Its width and height, texels.
    pub size: UVec2,
}

/// Where on which page each triangle's texels are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Atlas {
    /// The pages.
    pub pages: Vec<Page>,
    /// Layouts; several instances may share one.
    pub layouts: Vec<Layout>,
    /// By instance of the scene; `None` if it is not baked.
    pub placements: Vec<Option<Placement>>,
    /// Where pieces lie.
    pub rectangles: Vec<Rectangle>,
    /// Where nodes lie.
    pub blocks: Vec<Block>,
}

impl Atlas {
    /// Texels of all pages, padding included.
    pub fn texels(&self) -> u32 {
        self.pages
            .last()
            .map_or(0, |page| page.first_texel + page.texels())
    }

    /// The page of a triangle and its corners there, in texels. `None` if it has no texels.
    #[inline]
    pub fn triangle(&self, instance: u32, primitive: u32) -> Option<(u32, [Vec2; 3])> {
        let placement = (*self.placements.get(instance as usize)?)?;
        let layout = self.layouts.get(placement.layout as usize)?;
        let corners = layout.corners.get(primitive as usize)?;
        if layout.charts[primitive as usize] == Layout::NO_CHART {
            return None;
        }
        let rectangle =
            self.rectangles[(placement.first_rectangle + layout.piece(primitive)) as usize];
        let offset = rectangle.offset.as_vec2();
        Some((rectangle.page, corners.map(|corner| corner + offset)))
    }

    /// Whether the texels of a triangle are those of its back: see [`Layout::turned`].
    #[inline]
    pub fn is_turned(&self, instance: u32, primitive: u32) -> bool {
        let placement = self.placements.get(instance as usize).copied().flatten();
        let layout = placement.and_then(|placement| self.layouts.get(placement.layout as usize));
        layout.is_some_and(|layout| {
            let chart = layout.charts[primitive as usize];
            layout.turned.get(chart as usize).copied().unwrap_or(false)
        })
    }

    /// The texel at a point of a triangle (`u` and `v` weigh the second and the third corner). `None` if the triangle has none.
    #[inline]
    pub fn texel(&self, instance: u32, primitive: u32, u: f32, v: f32) -> Option<u32> {
        let (page, [a, b, c]) = self.triangle(instance, primitive)?;
        let page = self.pages[page as usize];
        let at = a + (b - a) * u + (c - a) * v;
        let x = (at.x as u32).min(page.width - 1);
        let y = (at.y as u32).min(page.height - 1);
        Some(page.texel(x, y))
    }

    /// Bytes that the atlas holds.
    pub fn bytes(&self) -> u64 {
        let lists = self.pages.capacity() * size_of::<Page>()
            + self.placements.capacity() * size_of::<Option<Placement>>()
            + self.blocks.capacity() * size_of::<Block>()
            + self.rectangles.capacity() * size_of::<Rectangle>();
        self.layouts.iter().map(Layout::bytes).sum::<u64>() + lists as u64
    }
}
