//! The atlas: where on which page each triangle's texels are.
//!
//! Every mesh has one layout, its triangles laid out flat in the unit square without overlap. Every instance has a
//! rectangle of its own on some page, into which the layout of its mesh is scaled. Texel (x, y) of a page covers the square from
//! (x, y) to (x + 1, y + 1) in page coordinates, x to the right, y down, (0, 0) the top left corner.

use glam::Vec2;

/// One texture of the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Number of the page's first texel: texels of all pages are numbered through, row by row.
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

/// The flat layout of one mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// The corners of every triangle in the unit square.
    pub corners: Vec<[Vec2; 3]>,
}

/// Where an instance's layout lies: page coordinates are `uv * scale + offset`, in texels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Index into [`Atlas::pages`].
    pub page: u32,
    /// Width and height of the unit square, texels.
    pub scale: Vec2,
    /// Its top left corner, texels.
    pub offset: Vec2,
}

/// Where on which page each triangle's texels are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Atlas {
    /// The pages.
    pub pages: Vec<Page>,
    /// By mesh of the scene; empty where the mesh is not baked.
    pub layouts: Vec<Layout>,
    /// By instance of the scene; `None` if it is not baked.
    pub placements: Vec<Option<Placement>>,
}

impl Atlas {
    /// Texels of all pages, padding included.
    pub fn texels(&self) -> u32 {
        self.pages
            .last()
            .map_or(0, |page| page.first_texel + page.texels())
    }

    /// The page of a triangle and its corners there, in texels. `mesh` is the instance's. `None` if it is not baked.
    pub fn triangle(&self, instance: u32, mesh: u32, primitive: u32) -> Option<(u32, [Vec2; 3])> {
        let placement = (*self.placements.get(instance as usize)?)?;
        let corners = self
            .layouts
            .get(mesh as usize)?
            .corners
            .get(primitive as usize)?;
        Some((
            placement.page,
            corners.map(|uv| uv * placement.scale + placement.offset),
        ))
    }
}
