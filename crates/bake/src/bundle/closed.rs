//! Which meshes are closed: their inside is dark and seen by nobody.

use occlude_scene::Mesh;
use rayon::prelude::*;
use std::collections::HashMap;

/// Whether every edge is shared by two triangles that run along it in opposite ways, with all fronts outwards: vertices are the
/// same if they are at the same place. O(n log n).
pub(crate) fn is_closed(mesh: &Mesh) -> bool {
    // Numbers of places, not of vertices: seams of normals and UVs split vertices.
    let mut places: HashMap<[u32; 3], u32> = HashMap::with_capacity(mesh.positions.len());
    let place: Vec<u32> = mesh
        .positions
        .iter()
        .map(|p| {
            // Adding 0 makes -0 and 0 the same.
            let next = places.len() as u32;
            *places
                .entry(p.to_array().map(|c| (c + 0.0).to_bits()))
                .or_insert(next)
        })
        .collect();
    let mut edges = Vec::with_capacity(3 * mesh.triangles.len());
    let mut volume = 0.0_f64;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| place[v as usize]);
        if a == b || b == c || c == a {
            continue;
        }
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.push((from.min(to), from.max(to), from < to));
        }
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        volume += a.dot(b.cross(c));
    }
    edges.par_sort_unstable();
    volume > 0.0
        && edges.len() % 2 == 0
        && edges
            .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
            .all(|run| 2 * run.iter().filter(|edge| edge.2).count() == run.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn tetrahedron() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn closed_means_without_holes_and_fronts_outwards() {
        assert!(is_closed(&tetrahedron()));
        let mut open = tetrahedron();
        open.triangles.pop();
        assert!(!is_closed(&open));
        let mut inverted = tetrahedron();
        inverted.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert!(!is_closed(&inverted));
        let mut one_turned = tetrahedron();
        one_turned.triangles[0].swap(0, 1);
        assert!(!is_closed(&one_turned));
        let mut split = tetrahedron();
        split.positions.push(Vec3::X);
        split.triangles[1][1] = 4;
        assert!(is_closed(&split), "vertices at the same place are the same");
        assert!(!is_closed(&Mesh::default()));
    }
}
