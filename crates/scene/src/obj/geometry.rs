//! Vertices and faces.

use super::Counted;
use super::polygon::triangulate;
use super::text::{lines, numbers, split};
use crate::input::Budget;
use crate::{Mesh, SceneError};
use glam::{Vec2, Vec3, Vec4};
use std::collections::{BTreeMap, HashMap, HashSet};

/// What an OBJ file holds.
#[derive(Default)]
pub(super) struct Geometry {
    /// One for each object, material and presence of normals, in order of first use.
    pub parts: Vec<Part>,
    /// The `mtllib` statements.
    pub libraries: Vec<String>,
}

/// Faces of one object with one material, all with normals or all without.
pub(super) struct Part {
    /// Name of the object or group; may be empty.
    pub object: String,
    /// Name of the material; `None` before any `usemtl`.
    pub material: Option<String>,
    pub mesh: Mesh,
    /// Vertices of the mesh by position, texture coordinate and normal.
    known: HashMap<[u32; 3], u32>,
    /// Corner positions of the triangles there are, sorted.
    seen: HashSet<[[u32; 3]; 3]>,
}

/// No texture coordinate or normal.
const NONE: u32 = u32::MAX;

struct Parser<'a> {
    positions: Vec<Vec3>,
    /// As long as `positions` from the first coloured vertex on.
    colors: Vec<Vec4>,
    uv: Vec<Vec2>,
    normals: Vec<Vec3>,
    object: String,
    group: String,
    material: Option<String>,
    out: Geometry,
    part_of: BTreeMap<(String, Option<String>, bool), usize>,
    /// The current part with normals and without, until something changes.
    current: [Option<usize>; 2],
    warn: &'a mut Counted,
    budget: &'a mut Budget,
    // Kept between faces.
    corners: Vec<[u32; 3]>,
    outline: Vec<Vec3>,
    triangles: Vec<[usize; 3]>,
}

/// Reads an OBJ file. Statements that make no sense are left out and counted.
pub(super) fn parse(
    bytes: &[u8],
    warn: &mut Counted,
    budget: &mut Budget,
) -> Result<Geometry, SceneError> {
    let mut p = Parser {
        positions: Vec::new(),
        colors: Vec::new(),
        uv: Vec::new(),
        normals: Vec::new(),
        object: String::new(),
        group: String::new(),
        material: None,
        out: Geometry::default(),
        part_of: BTreeMap::new(),
        current: [None; 2],
        warn,
        budget,
        corners: Vec::new(),
        outline: Vec::new(),
        triangles: Vec::new(),
    };
    for (line, text) in lines(bytes) {
        let (key, rest) = split(&text);
        match key {
            "v" => p.position(line, rest)?,
            "vt" => {
                let mut n = numbers(rest);
                let u = n.next().unwrap_or(f32::NAN);
                let v = n.next().unwrap_or(0.0);
                p.budget.reserve(8)?;
                // OBJ counts v from the bottom of the image, glTF from the top.
                p.uv.push(if u.is_finite() && v.is_finite() {
                    Vec2::new(u, 1.0 - v)
                } else {
                    p.warn
                        .add("texture coordinate that is not a number, taken as 0", line);
                    Vec2::ZERO
                });
            }
            "vn" => {
                let n: Vec<f32> = numbers(rest).take(3).collect();
                p.budget.reserve(12)?;
                p.normals.push(match n[..] {
                    [x, y, z] => Vec3::new(x, y, z).normalize_or_zero(),
                    _ => Vec3::ZERO,
                });
            }
            "f" | "fo" => p.face(line, rest)?,
            "usemtl" => {
                p.material = Some(rest.to_owned());
                p.current = [None; 2];
            }
            "mtllib" => p.out.libraries.push(rest.to_owned()),
            "o" => {
                p.object = rest.to_owned();
                p.group.clear();
                p.current = [None; 2];
            }
            "g" => {
                p.group = rest.to_owned();
                p.current = [None; 2];
            }
            "l" | "p" => p.warn.add("line or point, ignored", line),
            // Smoothing groups say nothing where there are normals, and without normals shading is flat.
            "s" | "lod" | "mg" | "bevel" | "c_interp" | "d_interp" => {}
            _ => p.warn.add("unknown statement, ignored", line),
        }
    }
    Ok(p.out)
}

impl Parser<'_> {
    fn position(&mut self, line: usize, rest: &str) -> Result<(), SceneError> {
        let mut n = [0.0f32; 7];
        let count = numbers(rest)
            .take(7)
            .zip(&mut n)
            .map(|(x, slot)| *slot = x)
            .count();
        let position = if count >= 3 {
            Vec3::new(n[0], n[1], n[2])
        } else {
            Vec3::NAN
        };
        if !position.is_finite() {
            self.warn.add(
                "vertex without three finite numbers, its faces are dropped",
                line,
            );
        }
        self.budget.reserve(12)?;
        self.positions.push(position);
        // x y z r g b; with seven numbers the fourth is a weight. A fourth alone is a weight too and means nothing here.
        let color = match count {
            6 => Some(Vec3::new(n[3], n[4], n[5])),
            7 => Some(Vec3::new(n[4], n[5], n[6])),
            _ => None,
        };
        if color.is_some() && self.colors.is_empty() {
            self.budget.reserve(16 * self.positions.len() as u64)?;
            self.colors.resize(self.positions.len() - 1, Vec4::ONE);
        }
        if color.is_some() || !self.colors.is_empty() {
            self.budget.reserve(16)?;
            let c = color.filter(|c| c.is_finite()).unwrap_or(Vec3::ONE);
            self.colors.push(c.clamp(Vec3::ZERO, Vec3::ONE).extend(1.0));
        }
        Ok(())
    }

    fn face(&mut self, line: usize, rest: &str) -> Result<(), SceneError> {
        self.corners.clear();
        for word in rest.split_whitespace() {
            if word.starts_with('#') {
                break;
            }
            let Some(corner) = self.corner(word) else {
                self.warn
                    .add("face with an index that is no vertex, dropped", line);
                return Ok(());
            };
            self.corners.push(corner);
        }
        // A corner that repeats its neighbour adds nothing.
        self.corners.dedup_by_key(|c| c[0]);
        if self.corners.len() > 1
            && self.corners.first().map(|c| c[0]) == self.corners.last().map(|c| c[0])
        {
            self.corners.pop();
        }
        if self.corners.len() < 3 {
            self.warn.add(
                "face with fewer than three different corners, dropped",
                line,
            );
            return Ok(());
        }
        self.outline.clear();
        for c in &self.corners {
            let position = self.positions[c[0] as usize];
            if !position.is_finite() {
                return Ok(());
            }
            self.outline.push(position);
        }
        let smooth = self.corners.iter().all(|c| {
            self.normals
                .get(c[2] as usize)
                .is_some_and(|n| *n != Vec3::ZERO)
        });
        if !smooth {
            for c in &mut self.corners {
                c[2] = NONE;
            }
        }
        triangulate(&self.outline, &mut self.triangles);
        let part = self.part(smooth);
        let Some(part) = self.out.parts.get_mut(part) else {
            return Ok(());
        };
        for &triangle in &self.triangles {
            let mut key =
                triangle.map(|i| (self.outline[i] + Vec3::ZERO).to_array().map(f32::to_bits));
            key.sort_unstable();
            self.budget.reserve(48)?;
            if !part.seen.insert(key) {
                self.warn.add(
                    "triangle that coincides with an earlier one of its mesh, dropped",
                    line,
                );
                continue;
            }
            let mut indices = [0; 3];
            for (slot, &i) in indices.iter_mut().zip(&triangle) {
                let corner = self.corners[i];
                *slot = match part.known.get(&corner) {
                    Some(&known) => known,
                    None => {
                        self.budget.reserve(72)?;
                        let new = part.mesh.positions.len() as u32;
                        part.known.insert(corner, new);
                        let [v, t, n] = corner.map(|i| i as usize);
                        part.mesh.positions.push(self.positions[v]);
                        part.mesh
                            .uv0
                            .push(self.uv.get(t).copied().unwrap_or(Vec2::ZERO));
                        part.mesh
                            .colors
                            .push(self.colors.get(v).copied().unwrap_or(Vec4::ONE));
                        if let Some(&normal) = self.normals.get(n) {
                            part.mesh.normals.push(normal);
                        }
                        new
                    }
                };
            }
            part.mesh.triangles.push(indices);
        }
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers count back from the latest.
    fn corner(&self, word: &str) -> Option<[u32; 3]> {
        let mut fields = word.split('/');
        let mut index = |count: usize, needed: bool| -> Option<u32> {
            let text = match fields.next() {
                Some(text) if !text.is_empty() => text,
                _ => return (!needed).then_some(NONE),
            };
            let i: i64 = text.parse().ok()?;
            let from_zero = if i < 0 { count as i64 + i } else { i - 1 };
            (0..count as i64)
                .contains(&from_zero)
                .then_some(from_zero as u32)
        };
        let corner = [
            index(self.positions.len(), true)?,
            index(self.uv.len(), false)?,
            index(self.normals.len(), false)?,
        ];
        fields.next().is_none().then_some(corner)
    }

    /// Index of the part that faces belong to now.
    fn part(&mut self, smooth: bool) -> usize {
        if let Some(part) = self.current[usize::from(smooth)] {
            return part;
        }
        let object = match (self.object.as_str(), self.group.as_str()) {
            (object, "" | "default") => object.to_owned(),
            ("", group) => group.to_owned(),
            (object, group) => format!("{object} {group}"),
        };
        let key = (object, self.material.clone(), smooth);
        let parts = &mut self.out.parts;
        let part = *self
            .part_of
            .entry(key)
            .or_insert_with_key(|(object, material, _)| {
                parts.push(Part {
                    object: object.clone(),
                    material: material.clone(),
                    mesh: Mesh::default(),
                    known: HashMap::new(),
                    seen: HashSet::new(),
                });
                parts.len() - 1
            });
        self.current[usize::from(smooth)] = Some(part);
        part
    }
}

impl Part {
    /// The finished mesh: arrays that say nothing are emptied.
    pub fn into_mesh(self) -> Mesh {
        let mut mesh = self.mesh;
        if mesh.uv0.iter().all(|&uv| uv == Vec2::ZERO) {
            mesh.uv0 = Vec::new();
        }
        if mesh.colors.iter().all(|&c| c == Vec4::ONE) {
            mesh.colors = Vec::new();
        }
        mesh
    }
}

/// Whether the triangles enclose a volume: every edge belongs to exactly two of them, once in each direction.
pub(super) fn is_closed(mesh: &Mesh) -> bool {
    let position = |i: u32| {
        (mesh.positions[i as usize] + Vec3::ZERO)
            .to_array()
            .map(f32::to_bits)
    };
    let mut open: HashSet<([u32; 3], [u32; 3])> = HashSet::new();
    for &[a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (from, to) = (position(from), position(to));
            if !open.remove(&(to, from)) && !open.insert((from, to)) {
                return false;
            }
        }
    }
    open.is_empty()
}
