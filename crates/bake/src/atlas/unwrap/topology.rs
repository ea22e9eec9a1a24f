//! Which triangles share an edge.

use glam::Vec3;
use rayon::prelude::*;

/// There is no triangle.
pub(crate) const NONE: u32 = u32::MAX;

/// For every triangle the neighbours across its edges (from corner k to corner k + 1). Vertices at the same place are one. Edges of
/// more than two triangles, and those where the winding turns over, connect nothing.
pub(crate) fn neighbours(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let place = weld(positions);
    let corner = |t: usize, k: usize| place[triangles[t][k % 3] as usize];
    // Half edges, by the smaller of their vertices.
    let mut first = vec![0_u32; positions.len() + 1];
    for t in 0..triangles.len() {
        for k in 0..3 {
            first[corner(t, k).min(corner(t, k + 1)) as usize + 1] += 1;
        }
    }
    for i in 1..first.len() {
        first[i] += first[i - 1];
    }
    let mut edges = vec![0_u32; 3 * triangles.len()];
    let mut fill = first.clone();
    for t in 0..triangles.len() {
        for k in 0..3 {
            let slot = &mut fill[corner(t, k).min(corner(t, k + 1)) as usize];
            edges[*slot as usize] = (3 * t + k) as u32;
            *slot += 1;
        }
    }
    drop(fill);
    let mut out = vec![[NONE; 3]; triangles.len()];
    let other = |edge: u32| {
        let (t, k) = (edge as usize / 3, edge as usize % 3);
        corner(t, k).max(corner(t, k + 1))
    };
    for ends in first.windows(2) {
        let edges = &mut edges[ends[0] as usize..ends[1] as usize];
        edges.sort_unstable_by_key(|&e| (other(e), e));
        for run in edges.chunk_by(|&a, &b| other(a) == other(b)) {
            let &[a, b] = run else { continue };
            let [(s, i), (t, j)] = [a, b].map(|e| (e as usize / 3, e as usize % 3));
            if corner(s, i) == corner(t, j + 1) && s != t {
                out[s][i] = t as u32;
                out[t][j] = s as u32;
            }
        }
    }
    out
}

/// For every vertex the first one at its place.
fn weld(positions: &[Vec3]) -> Vec<u32> {
    // Adding 0 makes -0 a 0.
    let key = |i: u32| {
        positions[i as usize]
            .to_array()
            .map(|x| (x + 0.0).to_bits())
    };
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&i| (key(i), i));
    let mut place = vec![0; positions.len()];
    for run in order.chunk_by(|&a, &b| key(a) == key(b)) {
        for &i in run {
            place[i as usize] = run[0];
        }
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::vec3;

    #[test]
    fn neighbours_share_places_not_vertices() {
        let p = [
            vec3(0., 0., 0.),
            vec3(1., 0., 0.),
            vec3(0., 1., 0.),
            vec3(1., 0., -0.),
            vec3(1., 1., 0.),
            vec3(0., 1., 0.),
        ];
        let found = neighbours(&p, &[[0, 1, 2], [3, 4, 5]]);
        assert_eq!(found, [[NONE, 1, NONE], [NONE, NONE, 0]]);
        // The same winding along the edge: turned over. A third triangle at it: not a surface.
        assert_eq!(neighbours(&p, &[[0, 1, 2], [3, 5, 4]])[0], [NONE; 3]);
        assert_eq!(
            neighbours(&p, &[[0, 1, 2], [3, 4, 5], [3, 0, 5]])[0][1],
            NONE
        );
    }
}
