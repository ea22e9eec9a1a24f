//! Tangents for normal maps, where the file brings none.
//!
//! As MikkTSpace (Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited") defines them: at every corner the tangents
//! of the faces around it are projected into the plane of the normal, normalised and summed by angle; corners are the
//! same where position, normal and UV are, and faces with mirrored UV do not mix with the others. Not taken over is that
//! two fans which touch in nothing but a vertex keep apart.

use crate::{Mesh, MorphTarget};
use glam::{Vec2, Vec3};
use std::collections::HashMap;

/// Fills in the tangents of a mesh for one of its UV sets; vertices with mirrored UV on one side are split. Without UV
/// there are none.
pub(super) fn generate(mesh: &mut Mesh, uv_set: u32) {
    let has_uv = if uv_set == 0 {
        !mesh.uv0.is_empty()
    } else {
        !mesh.uv1.is_empty()
    };
    if !has_uv {
        return;
    }
    if mesh.normals.is_empty() {
        make_flat(mesh);
    }
    let faces = faces(mesh, uv_set);
    split_mirrored(mesh, &faces);
    let same = same_corners(mesh, uv_set);

    // By mirrored or not.
    let mut sums = vec![[Vec3::ZERO; 2]; mesh.positions.len()];
    for (triangle, face) in mesh.triangles.iter().zip(&faces) {
        let Some(face) = face else { continue };
        for (k, &vertex) in triangle.iter().enumerate() {
            let normal = mesh.normals[vertex as usize];
            let flat = |v: Vec3| (v - normal * normal.dot(v)).normalize_or_zero();
            let position = |k: usize| mesh.positions[triangle[k % 3] as usize];
            let [a, b] = [k + 1, k + 2].map(|other| flat(position(other) - position(k)));
            let angle = a.dot(b).clamp(-1.0, 1.0).acos();
            sums[same[vertex as usize] as usize][usize::from(face.mirrored)] +=
                flat(face.tangent) * angle;
        }
    }

    let mut tangents = vec![None; mesh.positions.len()];
    for (triangle, face) in mesh.triangles.iter().zip(&faces) {
        let Some(face) = face else { continue };
        for &vertex in triangle {
            let sum = sums[same[vertex as usize] as usize][usize::from(face.mirrored)];
            tangents[vertex as usize] = sum
                .try_normalize()
                .map(|t| t.extend(if face.mirrored { -1.0 } else { 1.0 }));
        }
    }
    let any = |normal: &Vec3| normal.any_orthonormal_vector().extend(1.0);
    mesh.tangents = tangents
        .into_iter()
        .zip(&mesh.normals)
        .map(|(t, n)| t.unwrap_or_else(|| any(n)))
        .collect();
}

struct Face {
    /// Direction in which u grows.
    tangent: Vec3,
    /// UV runs the other way round: the bitangent is the negative of normal x tangent.
    mirrored: bool,
}

/// `None`: the face has no area in UV.
fn faces(mesh: &Mesh, uv_set: u32) -> Vec<Option<Face>> {
    let uvs = if uv_set == 0 { &mesh.uv0 } else { &mesh.uv1 };
    let face = |&triangle: &[u32; 3]| {
        let [p0, p1, p2] = triangle.map(|i| mesh.positions[i as usize]);
        let [t0, t1, t2] = triangle.map(|i| uvs[i as usize]);
        let (e1, e2) = (p1 - p0, p2 - p0);
        let (d1, d2): (Vec2, Vec2) = (t1 - t0, t2 - t0);
        let area = d1.perp_dot(d2);
        let tangent = ((e1 * d2.y - e2 * d1.y) * area.signum()).try_normalize()?;
        // v points down in glTF, the y axis of normal maps up.
        (area != 0.0 && area.is_finite()).then_some(Face {
            tangent,
            mirrored: area > 0.0,
        })
    };
    mesh.triangles.iter().map(face).collect()
}

/// Gives vertices that mirrored and other faces share a copy for the mirrored ones.
fn split_mirrored(mesh: &mut Mesh, faces: &[Option<Face>]) {
    let mut seen = vec![[false; 2]; mesh.positions.len()];
    for (triangle, face) in mesh.triangles.iter().zip(faces) {
        let Some(face) = face else { continue };
        triangle
            .iter()
            .for_each(|&v| seen[v as usize][usize::from(face.mirrored)] = true);
    }
    let mut behind: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let mut copy = vec![None; mesh.positions.len()];
    for (vertex, _) in seen
        .iter()
        .enumerate()
        .filter(|(_, seen)| **seen == [true; 2])
    {
        copy[vertex] = Some(behind.len() as u32);
        behind.push(vertex as u32);
    }
    if behind.len() == mesh.positions.len() {
        return;
    }
    for (triangle, face) in mesh.triangles.iter_mut().zip(faces) {
        if face.as_ref().is_some_and(|f| f.mirrored) {
            for v in triangle {
                *v = copy[*v as usize].unwrap_or(*v);
            }
        }
    }
    rearrange(mesh, &behind);
}

/// For every vertex the first one with the same position, normal and UV.
fn same_corners(mesh: &Mesh, uv_set: u32) -> Vec<u32> {
    let uvs = if uv_set == 0 { &mesh.uv0 } else { &mesh.uv1 };
    let mut first: HashMap<[u32; 8], u32> = HashMap::with_capacity(mesh.positions.len());
    (0..mesh.positions.len())
        .map(|i| {
            let (p, n, t) = (mesh.positions[i], mesh.normals[i], uvs[i]);
            // Adding 0 makes both zeros one.
            let key = [p.x, p.y, p.z, n.x, n.y, n.z, t.x, t.y].map(|v| (v + 0.0).to_bits());
            *first.entry(key).or_insert(i as u32)
        })
        .collect()
}

/// Gives every corner its own vertex and the normal of its face.
fn make_flat(mesh: &mut Mesh) {
    let behind: Vec<u32> = mesh.triangles.as_flattened().to_vec();
    let count = mesh.triangles.len() as u32;
    mesh.triangles = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    rearrange(mesh, &behind);
    let (corners, _) = mesh.positions.as_chunks::<3>();
    let normal = |&[a, b, c]: &[Vec3; 3]| (b - a).cross(c - a).try_normalize().unwrap_or(Vec3::Z);
    mesh.normals = corners.iter().flat_map(|c| [normal(c); 3]).collect();
}

/// Lets each vertex be what vertex `behind` was.
fn rearrange(mesh: &mut Mesh, behind: &[u32]) {
    fn pick<T: Copy>(array: &mut Vec<T>, behind: &[u32]) {
        if !array.is_empty() {
            *array = behind.iter().map(|&i| array[i as usize]).collect();
        }
    }
    pick(&mut mesh.positions, behind);
    pick(&mut mesh.normals, behind);
    pick(&mut mesh.uv0, behind);
    pick(&mut mesh.uv1, behind);
    pick(&mut mesh.colors, behind);
    if let Some(skinning) = &mut mesh.skinning {
        pick(&mut skinning.joints, behind);
        pick(&mut skinning.weights, behind);
    }
    for MorphTarget {
        positions,
        normals,
        tangents,
    } in &mut mesh.morph_targets
    {
        pick(positions, behind);
        pick(normals, behind);
        pick(tangents, behind);
    }
}
