//! Geometry as light sees it: exact rays against a posed scene, and the surfaces that they meet.

mod alpha;
mod place;
mod prefetch;
mod records;
mod shaft;
mod surface;
mod tracer;
mod triangle;

pub use alpha::{covers, diffuse_albedo, front_emission, is_filtered};
pub(crate) use place::{Place, Spot};
pub(crate) use records::site_of;
pub(crate) use shaft::{Span, Towards};
pub use surface::Surface;
pub(crate) use tracer::is_pane;
pub use tracer::{Geometry, GeometryError, Hierarchies, Still};
pub use triangle::WorldTriangle;
