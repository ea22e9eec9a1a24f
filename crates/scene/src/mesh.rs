//! Triangle meshes: one material each, flat arrays.

use glam::{Vec2, Vec3, Vec4};

/// Indexed triangles with one material, in object space. All vertex arrays are empty or as long as `positions`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Name of the mesh (and number of the primitive, if it has several).
    pub name: String,
    /// Vertex positions, metres, all finite.
    pub positions: Vec<Vec3>,
    /// Unit normals; empty: shade flat.
    pub normals: Vec<Vec3>,
    /// Unit tangents and handedness; empty unless the material has a normal map.
    pub tangents: Vec<Vec4>,
    /// First UV set; empty if absent.
    pub uv0: Vec<Vec2>,
    /// Second UV set; empty if absent.
    pub uv1: Vec<Vec2>,
    /// Linear vertex colours, multiplied with base colour; empty if absent.
    pub colors: Vec<Vec4>,
    /// Vertex indices, counter-clockwise seen from the front, all in range.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`](crate::Scene::materials).
    pub material: u32,
    /// How joints move the vertices.
    pub skinning: Option<Skinning>,
    /// Displacements that are blended in by weights.
    pub morph_targets: Vec<MorphTarget>,
}

/// Up to four joints a vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skinning {
    /// Indices into the skin's joints, in range.
    pub joints: Vec<[u16; 4]>,
    /// Weights; they sum to 1.
    pub weights: Vec<Vec4>,
}

/// One morph target; arrays are empty or as long as the mesh's positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MorphTarget {
    /// Displacement of positions.
    pub positions: Vec<Vec3>,
    /// Displacement of normals.
    pub normals: Vec<Vec3>,
    /// Displacement of tangents.
    pub tangents: Vec<Vec3>,
}
