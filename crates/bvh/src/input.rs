//! What a structure is built from.

use glam::{Affine3A, Vec3};

/// The triangles of one mesh, in object space.
#[derive(Clone, Copy, Debug)]
pub struct MeshInput<'a> {
    /// Vertex positions.
    pub positions: &'a [Vec3],
    /// Vertex indices of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// Whether hits must pass the [`HitFilter`](crate::HitFilter) of the query.
    pub filtered: bool,
}

/// A mesh somewhere in the world.
#[derive(Clone, Copy, Debug)]
pub struct InstanceInput {
    /// Index of the mesh.
    pub mesh: u32,
    /// Its place.
    pub world_from_object: Affine3A,
}

/// Which instances are copied into the one world-space tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Flatten {
    /// Copy meshes that are used once or are small, and everything if that at most doubles the triangles or makes fewer
    /// than a million; other meshes keep a tree of their own.
    #[default]
    Auto,
    /// Copy everything: the fastest rays, the most memory.
    Always,
    /// Copy only what cannot have a tree of its own: instances whose transform has no inverse.
    Never,
}

/// How to build.
#[derive(Clone, Copy, Debug, Default)]
pub struct BuildOptions {
    /// Which instances are copied into the world-space tree. Default: [`Flatten::Auto`].
    pub flatten: Flatten,
    /// Use the watertight triangle test (Woop et al. 2013): a ray never slips between triangles that share vertices.
    /// Slower by the factor in the crate's benchmark. Default: off, when about one ray in 10^5 may slip through an edge.
    pub watertight: bool,
    /// Keep finite triangles without an area, since a later [`refit`](crate::Accel::refit) may give them one.
    /// Default: off, they are dropped.
    pub keep_degenerate: bool,
    /// Keep each triangle in one leaf. Builds in half to two thirds of the time, and is the better choice for a structure
    /// that is refitted, since a [`refit`](crate::Accel::refit) enlarges the boxes of cut triangles to whole ones.
    /// Default: off, large triangles are cut where that saves rays more than it costs, with at most a fifth more
    /// references.
    pub whole_triangles: bool,
}

/// Why nothing was built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// An instance names a mesh that does not exist.
    #[error("instance {instance} refers to mesh {mesh}, but there are {meshes} meshes")]
    NoSuchMesh {
        /// The instance.
        instance: usize,
        /// The mesh it names.
        mesh: u32,
        /// How many meshes there are.
        meshes: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error(
        "triangle {triangle} of mesh {mesh} refers to vertex {vertex}, but there are {vertices} vertices"
    )]
    NoSuchVertex {
        /// The mesh.
        mesh: usize,
        /// The triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// How many vertices the mesh has.
        vertices: usize,
    },
    /// More triangles than the structure can number.
    #[error("{triangles} triangles in one tree, but at most {limit} are possible")]
    TooManyTriangles {
        /// How many there are.
        triangles: u64,
        /// How many there may be.
        limit: u64,
    },
}

/// Why a structure was not refitted; it is unchanged then.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RefitError {
    /// The meshes and instances are not those of the build (only positions and transforms may change).
    #[error("refit with other topology: {what}")]
    Topology {
        /// What differs.
        what: &'static str,
    },
    /// The transform of an instance with a tree of its own has no inverse: build anew.
    #[error("refit: the transform of instance {instance} has no inverse")]
    Singular {
        /// The instance.
        instance: usize,
    },
}
