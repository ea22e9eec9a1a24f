//! Vertices that have several UVs become several.

use glam::Vec2;

/// Vertices of a primitive after the split.
pub(crate) struct Split {
    /// The old vertex behind each.
    pub vertices: Vec<u32>,
    pub uv: Vec<Vec2>,
    pub triangles: Vec<[u32; 3]>,
}

/// Gives every corner its UV; vertices of several UVs become several.
pub(crate) fn split(triangles: &[[u32; 3]], uv_of: &dyn Fn(u32) -> Option<[Vec2; 3]>) -> Split {
    const NONE: u32 = u32::MAX;
    let old = triangles
        .as_flattened()
        .iter()
        .max()
        .map_or(0, |&v| v as usize + 1);
    // A chain of the copies of each vertex.
    let mut first = vec![NONE; old];
    let mut next: Vec<u32> = Vec::new();
    let mut split = Split {
        vertices: Vec::new(),
        uv: Vec::new(),
        triangles: Vec::with_capacity(triangles.len()),
    };
    for (t, corners) in triangles.iter().enumerate() {
        let Some(uv) = uv_of(t as u32) else { continue };
        let mut triangle = [0; 3];
        for k in 0..3 {
            let vertex = corners[k];
            let mut copy = first[vertex as usize];
            while copy != NONE
                && split.uv[copy as usize].to_array().map(f32::to_bits)
                    != uv[k].to_array().map(f32::to_bits)
            {
                copy = next[copy as usize];
            }
            if copy == NONE {
                copy = split.vertices.len() as u32;
                split.vertices.push(vertex);
                split.uv.push(uv[k]);
                next.push(first[vertex as usize]);
                first[vertex as usize] = copy;
            }
            triangle[k] = copy;
        }
        split.triangles.push(triangle);
    }
    split
}
