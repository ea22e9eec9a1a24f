//! Exact rays: an 8-wide bounding volume hierarchy for triangles and instances.
//!
//! [`Accel`] answers closest-hit and any-hit questions about triangle meshes, one ray at a time or in batches. It is built
//! by binned SAH (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies") down to single triangles,
//! cutting triangles where boxes overlap much (Stich et al. 2009, "Spatial splits in bounding volume hierarchies"), and
//! then collapsed into 8-wide nodes by dynamic programming over the same cost (Ylitie et al. 2017, section 3.1), with leaves
//! of blocks of four triangles. Meshes that are used many times keep a tree of their own below the top tree.
//!
//! What holds, by construction and by test:
//!
//! * **No absolute epsilon.** A ray is the open interval `t_min < t < t_max`; nothing else keeps a hit away. Boxes are
//!   tested conservatively: each slab distance is moved outwards by a bound on its own rounding error (Ize 2013).
//! * **Any input is safe.** Triangles with vertices that are not finite, or so large that their arithmetic overflows, are
//!   dropped and counted, and so are triangles without an area. A ray with a NaN hits nothing.
//! * **Deterministic.** The structure and every answer depend on the input alone, not on the number of threads.
//! * **One binary.** AVX2 with FMA is chosen when the processor has it, NEON on aarch64, portable code elsewhere.
//!
//! It is the wrong tool for geometry other than triangles, for a scene that is traced by a few rays only (building costs
//! about as much as tracing one ray a triangle), and on a GPU.

mod accel;
mod boxes;
mod buffer;
mod build;
mod filter;
mod input;
mod node;
mod refit;
mod traverse;
mod validate;

pub use accel::{Accel, Blocker, Stats};
pub use buffer::{Buffer, nameless_file};
pub use filter::{HitFilter, NoFilter};
pub use input::{BuildError, BuildOptions, Flatten, InstanceInput, MeshInput, RefitError};
pub use traverse::Simd;
