//! Meshes: one [`Mesh`] for each primitive of the file that draws triangles.

use super::accessor::{Accessor, Shape};
use super::document::Primitive;
use super::draco;
use super::source::Source;
use super::tangents;
use crate::{Material, Mesh, MorphTarget, SceneError, Skinning, Warning};
use glam::{Vec2, Vec3, Vec4};
use std::collections::BTreeMap;

const RE_EXPORT: &str = "export the file again";

/// Reads one primitive. `None`: it draws no triangle.
pub(super) fn primitive(
    source: &Source,
    entry: &Primitive,
    place: &str,
    name: String,
    material: u32,
    look: &Material,
) -> Result<(Option<Mesh>, Vec<Warning>), SceneError> {
    let mut warnings = Vec::new();
    let mode = entry.mode.unwrap_or(4);
    if mode < 4 {
        let kind = if mode == 0 { "points are" } else { "lines are" };
        warnings.push(Warning::new(place, &format!("{kind} not drawn")));
        return Ok((None, warnings));
    }
    let compressed = match &entry.extensions.draco {
        Some(draco) => Some(draco::decode(source, entry, draco, place)?),
        None => None,
    };
    let compressed = compressed.as_ref();
    let reader = Attributes {
        source,
        place,
        compressed,
    };
    let Some(&position) = entry.attributes.get("POSITION") else {
        warnings.push(Warning::new(
            place,
            "a primitive without POSITION is not drawn",
        ));
        return Ok((None, warnings));
    };
    let position = reader.accessor(position, "POSITION", &[Shape::Vec3])?;
    let mut positions = position.floats(Vec3::from_array);
    let mut triangles = triangles(&reader, entry, &positions, &mut warnings)?;
    if triangles.is_empty() {
        if warnings.is_empty() {
            warnings.push(Warning::new(
                place,
                "a primitive without triangles is not drawn",
            ));
        }
        return Ok((None, warnings));
    }

    let vertices = Vertices::compact(&mut triangles, positions.len());
    vertices.gather(&mut positions);
    let attributes = &entry.attributes;
    let mut mesh = Mesh {
        name,
        positions,
        triangles,
        material,
        ..Mesh::default()
    };
    mesh.normals = reader.read(attributes, "NORMAL", &vertices, &[Shape::Vec3], |a| {
        a.floats(Vec3::from_array)
    })?;
    mesh.uv0 = reader.uv(attributes, "TEXCOORD_0", &vertices)?;
    mesh.uv1 = reader.uv(attributes, "TEXCOORD_1", &vertices)?;
    mesh.colors = reader.read(
        attributes,
        "COLOR_0",
        &vertices,
        &[Shape::Vec3, Shape::Vec4],
        colors,
    )?;
    mesh.skinning = skinning(&reader, attributes, &vertices, &mut warnings)?;
    let wants_tangents = look.normal.is_some() || look.clearcoat_normal.is_some();
    if wants_tangents && !mesh.normals.is_empty() {
        mesh.tangents = reader.read(attributes, "TANGENT", &vertices, &[Shape::Vec4], |a| {
            a.floats(Vec4::from_array)
        })?;
    }
    for (i, target) in entry.targets.iter().enumerate() {
        let place = format!("{place}, morph target {i}");
        let reader = Attributes {
            source,
            place: &place,
            compressed: None,
        };
        mesh.morph_targets
            .push(morph_target(&reader, target, &vertices, &mesh)?);
    }
    repair_normals(&mut mesh);
    repair_tangents(&mut mesh);
    if let Some(map) = look.normal.as_ref().or(look.clearcoat_normal.as_ref())
        && mesh.tangents.is_empty()
    {
        tangents::generate(&mut mesh, map.texture.uv_set);
    }
    Ok((Some(mesh), warnings))
}

/// The triangles that [`primitive`] makes of an entry, before it drops vertices that none of them uses.
pub(super) fn kept_triangles(
    source: &Source,
    entry: &Primitive,
    compressed: Option<&draco::Decoded>,
    place: &str,
) -> Result<Vec<[u32; 3]>, SceneError> {
    let reader = Attributes {
        source,
        place,
        compressed,
    };
    let Some(&position) = entry.attributes.get("POSITION") else {
        return Ok(Vec::new());
    };
    let position = reader.accessor(position, "POSITION", &[Shape::Vec3])?;
    let positions = position.floats(Vec3::from_array);
    triangles(&reader, entry, &positions, &mut Vec::new())
}

/// The triangles of an entry that can be drawn.
fn triangles(
    reader: &Attributes,
    entry: &Primitive,
    positions: &[Vec3],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<[u32; 3]>, SceneError> {
    let (source, place) = (reader.source, reader.place);
    let mut triangles = match reader.compressed {
        Some(mesh) => mesh.triangles.clone(),
        None => {
            let corners = corners(source, entry, positions.len(), place)?;
            assemble(source, &corners, entry.mode.unwrap_or(4), place, warnings)?
        }
    };
    let highest = triangles.as_flattened().iter().copied().max();
    if let Some(i) = highest.filter(|&i| i as usize >= positions.len()) {
        let what = format!(
            "vertex index {i} is out of range, there are {} vertices",
            positions.len()
        );
        return Err(source.fault(place, &what, RE_EXPORT));
    }
    if positions.iter().any(|p| !p.is_finite()) {
        let before = triangles.len();
        triangles.retain(|t| t.iter().all(|&i| positions[i as usize].is_finite()));
        let lost = before - triangles.len();
        if lost > 0 {
            let what = format!("{lost} triangles with positions that are not finite were dropped");
            warnings.push(Warning::new(place, &what));
        }
    }
    triangles.retain(|&[a, b, c]| a != b && b != c && a != c);
    Ok(triangles)
}

/// The vertices that corners name, or all of them in their order.
fn corners(
    source: &Source,
    entry: &Primitive,
    vertices: usize,
    place: &str,
) -> Result<Vec<u32>, SceneError> {
    let Some(index) = entry.indices else {
        return Ok((0..vertices.min(u32::MAX as usize) as u32).collect());
    };
    let place = format!("{place}, indices");
    let accessor = source.accessor(index, &place, &[Shape::Scalar])?;
    let corners = accessor.integers(|[i]: [u32; 1]| i);
    corners.ok_or_else(|| source.fault(&place, "indices must be unsigned integers", RE_EXPORT))
}

/// Turns corners into triangles: glTF 2.0, section 3.7.2.1.
fn assemble(
    source: &Source,
    corners: &[u32],
    mode: u32,
    place: &str,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<[u32; 3]>, SceneError> {
    Ok(match mode {
        4 => {
            let (triangles, rest) = corners.as_chunks::<3>();
            if !rest.is_empty() {
                let what = format!(
                    "{} corners beyond the last whole triangle are ignored",
                    rest.len()
                );
                warnings.push(Warning::new(place, &what));
            }
            triangles.to_vec()
        }
        5 => corners
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                if i % 2 == 0 {
                    [w[0], w[1], w[2]]
                } else {
                    [w[0], w[2], w[1]]
                }
            })
            .collect(),
        6 => match corners.split_first() {
            Some((&hub, rim)) => rim.windows(2).map(|w| [w[0], w[1], hub]).collect(),
            None => Vec::new(),
        },
        other => {
            return Err(source.fault(
                place,
                &format!("primitive mode {other} is unknown"),
                RE_EXPORT,
            ));
        }
    })
}

/// Which of the file's vertices a mesh keeps.
struct Vertices {
    /// Number of vertices in the file.
    count: usize,
    /// The file's vertex behind each of ours; `None`: all are kept.
    kept: Option<Vec<u32>>,
}

impl Vertices {
    /// Drops vertices that no triangle uses: exporters often let many primitives share one large array.
    fn compact(triangles: &mut [[u32; 3]], count: usize) -> Self {
        const UNUSED: u32 = u32::MAX;
        let mut ours = vec![UNUSED; count];
        for &i in triangles.as_flattened() {
            ours[i as usize] = 0;
        }
        if !ours.contains(&UNUSED) {
            return Self { count, kept: None };
        }
        let mut kept = Vec::new();
        for (i, slot) in ours.iter_mut().enumerate() {
            if *slot != UNUSED {
                *slot = kept.len() as u32;
                kept.push(i as u32);
            }
        }
        for i in triangles.as_flattened_mut() {
            *i = ours[*i as usize];
        }
        Self {
            count,
            kept: Some(kept),
        }
    }

    fn gather<T: Copy>(&self, array: &mut Vec<T>) {
        if let Some(kept) = &self.kept {
            *array = kept.iter().map(|&i| array[i as usize]).collect();
        }
    }
}

/// Reads vertex attributes of one primitive.
struct Attributes<'a> {
    source: &'a Source,
    place: &'a str,
    /// What stands in for the accessors of a compressed primitive.
    compressed: Option<&'a draco::Decoded>,
}

impl<'a> Attributes<'a> {
    fn accessor(
        &self,
        index: u32,
        name: &str,
        shapes: &[Shape],
    ) -> Result<Accessor<'a>, SceneError> {
        match self.compressed.and_then(|c| c.accessor(name)) {
            Some(accessor) if shapes.contains(&accessor.shape) => Ok(accessor),
            _ => {
                let place = format!("{}, {name}", self.place);
                self.source.accessor(index, &place, shapes)
            }
        }
    }

    /// An attribute, as long as the mesh; empty if the primitive lacks it.
    fn read<T: Copy>(
        &self,
        attributes: &BTreeMap<String, u32>,
        name: &str,
        vertices: &Vertices,
        shapes: &[Shape],
        read: impl Fn(&Accessor) -> Vec<T>,
    ) -> Result<Vec<T>, SceneError> {
        let Some(&index) = attributes.get(name) else {
            return Ok(Vec::new());
        };
        let accessor = self.accessor(index, name, shapes)?;
        if accessor.count != vertices.count {
            let what = format!(
                "{} elements for {} vertices",
                accessor.count, vertices.count
            );
            let place = format!("{}, {name}", self.place);
            return Err(self.source.fault(&place, &what, RE_EXPORT));
        }
        let mut array = read(&accessor);
        vertices.gather(&mut array);
        Ok(array)
    }

    fn uv(
        &self,
        attributes: &BTreeMap<String, u32>,
        name: &str,
        vertices: &Vertices,
    ) -> Result<Vec<Vec2>, SceneError> {
        self.read(attributes, name, vertices, &[Shape::Vec2], |a| {
            a.floats(Vec2::from_array)
        })
    }

    fn displacement(
        &self,
        attributes: &BTreeMap<String, u32>,
        name: &str,
        vertices: &Vertices,
    ) -> Result<Vec<Vec3>, SceneError> {
        let finite = |v: [f32; 3]| {
            let v = Vec3::from_array(v);
            if v.is_finite() { v } else { Vec3::ZERO }
        };
        self.read(attributes, name, vertices, &[Shape::Vec3], |a| {
            a.floats(finite)
        })
    }
}

fn colors(accessor: &Accessor) -> Vec<Vec4> {
    let finite = |v: Vec4| {
        if v.is_finite() {
            v.max(Vec4::ZERO)
        } else {
            Vec4::ONE
        }
    };
    match accessor.shape {
        Shape::Vec3 => accessor.floats(|[r, g, b]| finite(Vec4::new(r, g, b, 1.0))),
        _ => accessor.floats(|c: [f32; 4]| finite(Vec4::from_array(c))),
    }
}

fn skinning(
    reader: &Attributes,
    attributes: &BTreeMap<String, u32>,
    vertices: &Vertices,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Skinning>, SceneError> {
    let wrong = std::cell::Cell::new(false);
    let joints = reader.read(attributes, "JOINTS_0", vertices, &[Shape::Vec4], |a| {
        let joints = a.integers(|j: [u32; 4]| j.map(|j| u16::try_from(j).unwrap_or(u16::MAX)));
        joints.unwrap_or_else(|| {
            wrong.set(true);
            vec![[0; 4]; a.count]
        })
    })?;
    if wrong.get() {
        let place = format!("{}, JOINTS_0", reader.place);
        return Err(reader
            .source
            .fault(&place, "joints must be unsigned integers", RE_EXPORT));
    }
    let mut weights = reader.read(attributes, "WEIGHTS_0", vertices, &[Shape::Vec4], |a| {
        a.floats(Vec4::from_array)
    })?;
    if joints.is_empty() || weights.is_empty() {
        return Ok(None);
    }
    if attributes.contains_key("JOINTS_1") {
        let what = "more than four joints a vertex: the first four are used";
        warnings.push(Warning::new(reader.place, what));
    }
    for w in &mut weights {
        *w = w.max(Vec4::ZERO);
        let sum = w.element_sum();
        *w = if sum > 0.0 && sum.is_finite() {
            *w / sum
        } else {
            Vec4::X
        };
    }
    Ok(Some(Skinning { joints, weights }))
}

fn morph_target(
    reader: &Attributes,
    target: &BTreeMap<String, u32>,
    vertices: &Vertices,
    mesh: &Mesh,
) -> Result<MorphTarget, SceneError> {
    let positions = reader.displacement(target, "POSITION", vertices)?;
    let mut morph = MorphTarget {
        positions,
        ..MorphTarget::default()
    };
    if !mesh.normals.is_empty() {
        morph.normals = reader.displacement(target, "NORMAL", vertices)?;
    }
    if !mesh.tangents.is_empty() {
        morph.tangents = reader.displacement(target, "TANGENT", vertices)?;
    }
    Ok(morph)
}

/// Makes normals unit vectors; those that point nowhere become the mean of the faces around them, by area.
fn repair_normals(mesh: &mut Mesh) {
    let mut lost = false;
    for n in &mut mesh.normals {
        *n = n.try_normalize().unwrap_or(Vec3::ZERO);
        lost |= *n == Vec3::ZERO;
    }
    if !lost {
        return;
    }
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for &t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        for i in t {
            sums[i as usize] += (b - a).cross(c - a);
        }
    }
    for (n, sum) in mesh.normals.iter_mut().zip(sums) {
        if *n == Vec3::ZERO {
            *n = sum.try_normalize().unwrap_or(Vec3::Z);
        }
    }
}

fn repair_tangents(mesh: &mut Mesh) {
    for (t, n) in mesh.tangents.iter_mut().zip(&mesh.normals) {
        let along = t
            .truncate()
            .try_normalize()
            .unwrap_or_else(|| n.any_orthonormal_vector());
        *t = along.extend(if t.w < 0.0 { -1.0 } else { 1.0 });
    }
}
