//! Geometry as light sees it: triangles in the world, with their sides.

mod triangle;

pub use triangle::WorldTriangle;
