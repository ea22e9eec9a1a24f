//! Closing seams: what two charts say about the edge that they share is made to agree.
//!
//! Along every edge that is cut between charts, but smooth on the surface, points are looked up bilinearly from both sides, as an engine will do. The
//! squares of the differences, and of all changes weighted by a small number, are minimised by conjugate gradients (Iwanicki 2013, "Lighting
//! Technology of The Last of Us"). Seams between objects count as those inside of one: edges are matched by their place in the world.
//!
//! Edges that meet with a corner between (a T-junction), or with a crease, are left alone, and so are stretches where something stands on the seam:
//! floor tiles that meet below a thin wall have nothing to agree on, and light would leak through it.

use super::Canvas;
use crate::atlas::unwrap::neighbours;
use crate::texel::Texels;
use glam::{Vec2, Vec3};
use occlude_render::geometry::{Geometry, WorldTriangle};
use occlude_visibility::{Ray, Tracer};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Weight of a texel's change against that of a difference at a seam point.
const STAY: f32 = 0.02;
/// Normals of two sides of a smooth edge: 18 degrees at most.
const SMOOTH: f32 = 0.95;
/// Conjugate gradient steps at most.
const MOST_STEPS: u32 = 60;

/// An edge of a triangle: from corner `k` to corner `k + 1`.
#[derive(Clone, Copy, Debug)]
struct Side {
    instance: u32,
    primitive: u32,
    k: u32,
}

/// A triangle of a mesh and one of its edges.
type Edge = (u32, u32);

/// Both sides of a seam; the second runs the other way around.
type Seam = [Side; 2];

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stitched {
    /// Points on seams.
    pub points: u64,
    /// Root of the mean square difference over them before.
    pub before: f64,
    /// And after.
    pub after: f64,
}

/// Closes the seams whose two sides lie on the given pages. `canvases` are pages and their numbers, in ascending order. With `geometry` points of a seam
/// whose two sides do not see each other are left out.
pub fn stitch(
    texels: &Texels,
    canvases: &mut [(u32, Canvas)],
    geometry: Option<&Geometry>,
) -> Stitched {
    let mut starts = BTreeMap::new();
    let mut count = 0_usize;
    for (page, canvas) in canvases.iter() {
        starts.insert(*page, (count, canvas.width, canvas.height));
        count += canvas.values.len();
    }
    let seams = seams(texels);
    let rows: Vec<Row> = seams
        .par_iter()
        .flat_map_iter(|seam| rows(texels, &starts, seam, geometry))
        .collect();
    if rows.is_empty() {
        return Stitched::default();
    }
    System::new(rows).solve(canvases)
}

/// All smooth edges that are cut, in an order that never changes.
fn seams(texels: &Texels) -> Vec<Seam> {
    let (scene, atlas) = (texels.scene, texels.atlas);
    // Inside of meshes: the same for all instances of a layout.
    let per_layout: Vec<(Vec<[Edge; 2]>, Vec<Edge>)> = atlas
        .layouts
        .par_iter()
        .map(|layout| {
            let mesh = &scene.meshes[layout.mesh as usize];
            let around = neighbours(&mesh.positions, &mesh.triangles);
            let (mut cut, mut border) = (Vec::new(), Vec::new());
            for (t, around) in around.iter().enumerate() {
                if layout.charts[t] == crate::atlas::Layout::NO_CHART {
                    continue;
                }
                for (k, &n) in around.iter().enumerate() {
                    if n == u32::MAX {
                        border.push((t as u32, k as u32));
                    } else if (n as usize) > t && layout.charts[n as usize] != layout.charts[t] {
                        let back = around_index(
                            &neighbour_edges(mesh.triangles[n as usize], &mesh.positions),
                            mesh.triangles[t],
                            &mesh.positions,
                            k,
                        );
                        if let Some(j) = back {
                            cut.push([(t as u32, k as u32), (n, j)]);
                        }
                    }
                }
            }
            (cut, border)
        })
        .collect();
    let mut found = Vec::new();
    let mut borders: Vec<([u32; 6], Side)> = Vec::new();
    for (i, placement) in atlas.placements.iter().enumerate() {
        let Some(placement) = placement else { continue };
        let (cut, border) = &per_layout[placement.layout as usize];
        let side = |(primitive, k): (u32, u32)| Side {
            instance: i as u32,
            primitive,
            k,
        };
        found.extend(
            cut.iter()
                .map(|pair| pair.map(side))
                .filter(|seam| is_smooth(texels, seam)),
        );
        for &edge in border {
            let side = side(edge);
            let [a, b] = ends(texels, side);
            borders.push((place_of(a, b), side));
        }
    }
    borders.par_sort_unstable_by_key(|(place, s)| (*place, s.instance, s.primitive, s.k));
    for run in borders.chunk_by(|a, b| a.0 == b.0) {
        if let [(_, a), (_, b)] = run {
            let seam = [*a, *b];
            let opposite = ends(texels, *a)[0].distance(ends(texels, *b)[1])
                <= ends(texels, *a)[0].distance(ends(texels, *b)[0]);
            if a.instance != b.instance && opposite && is_smooth(texels, &seam) {
                found.push(seam);
            }
        }
    }
    found
}

/// The three edges of a triangle by the places of their ends.
fn neighbour_edges(triangle: [u32; 3], positions: &[Vec3]) -> [[Vec3; 2]; 3] {
    let p = triangle.map(|i| positions[i as usize]);
    [[p[0], p[1]], [p[1], p[2]], [p[2], p[0]]]
}

/// Which of `edges` is edge `k` of `triangle`, the other way around.
fn around_index(
    edges: &[[Vec3; 2]; 3],
    triangle: [u32; 3],
    positions: &[Vec3],
    k: usize,
) -> Option<u32> {
    let [a, b] = neighbour_edges(triangle, positions)[k];
    edges.iter().position(|e| *e == [b, a]).map(|j| j as u32)
}

/// World positions of an edge's ends.
fn ends(texels: &Texels, side: Side) -> [Vec3; 2] {
    let corners =
        WorldTriangle::new(texels.scene, texels.pose, side.instance, side.primitive).corners;
    [corners[side.k as usize], corners[(side.k as usize + 1) % 3]]
}

/// A key for an edge's place, whichever way it runs: its ends rounded to a few thousandths of its length.
fn place_of(a: Vec3, b: Vec3) -> [u32; 6] {
    let length = a.distance(b).max(1e-12);
    // A power of two, so that both sides round alike.
    let mut step = 1.0_f32;
    while step > length / 256.0 {
        step *= 0.5;
    }
    while step * 2.0 <= length / 256.0 {
        step *= 2.0;
    }
    let key = |p: Vec3| (p / step).round().to_array().map(|x| (x + 0.0).to_bits());
    let (a, b) = (key(a), key(b));
    let (a, b) = if a <= b { (a, b) } else { (b, a) };
    [a[0], a[1], a[2], b[0], b[1], b[2]]
}

/// Whether the surface goes on across a seam without a crease: vertex normals where there are any, else those of the triangles.
fn is_smooth(texels: &Texels, [a, b]: &Seam) -> bool {
    let normals = |side: &Side| {
        let triangle = WorldTriangle::new(texels.scene, texels.pose, side.instance, side.primitive);
        let front = texels.normal(&triangle, side.instance, side.primitive);
        let posed = &texels.pose.instances[side.instance as usize];
        let object = texels.pose.normals(texels.scene, side.instance as usize);
        let vertices = texels.scene.meshes[posed.mesh as usize].triangles[side.primitive as usize];
        [side.k, (side.k + 1) % 3].map(|k| {
            let Some(&n) = object.get(vertices[k as usize] as usize) else {
                return front;
            };
            let inverse = posed.world_from_object.matrix3.inverse();
            if !inverse.is_finite() {
                return front;
            }
            let n = (inverse.transpose() * n).normalize_or(front);
            if n.dot(front) < 0.0 { -n } else { n }
        })
    };
    let ([a0, a1], [b0, b1]) = (normals(a), normals(b));
    a0.dot(b1) > SMOOTH && a1.dot(b0) > SMOOTH
}

/// One seam point: texels and weights of which the weighted sum should vanish.
#[derive(Clone, Copy, Debug)]
struct Row {
    texels: [u32; 8],
    weights: [f32; 8],
}

/// Points along a seam, one a texel of its longer side.
fn rows(
    texels: &Texels,
    starts: &BTreeMap<u32, (usize, u32, u32)>,
    [a, b]: &Seam,
    geometry: Option<&Geometry>,
) -> Vec<Row> {
    let on_page = |side: &Side| {
        let (page, corners) = texels.atlas.triangle(side.instance, side.primitive)?;
        let start = starts.get(&page)?;
        Some((
            *start,
            corners[side.k as usize],
            corners[(side.k as usize + 1) % 3],
        ))
    };
    let (Some((start_a, a0, a1)), Some((start_b, b0, b1))) = (on_page(a), on_page(b)) else {
        return Vec::new();
    };
    let points = (a0.distance(a1).max(b0.distance(b1)).ceil() as u32).clamp(1, 1 << 14);
    let lookup = |(start, width, height): (usize, u32, u32), at: Vec2| {
        let at = (at - 0.5).clamp(
            Vec2::ZERO,
            Vec2::new(width as f32 - 1.0, height as f32 - 1.0),
        );
        let low = at.floor();
        let f = at - low;
        let (x, y) = (low.x as u32, low.y as u32);
        let (x1, y1) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
        let index = |x: u32, y: u32| (start + (y * width + x) as usize) as u32;
        (
            [index(x, y), index(x1, y), index(x, y1), index(x1, y1)],
            [
                (1.0 - f.x) * (1.0 - f.y),
                f.x * (1.0 - f.y),
                (1.0 - f.x) * f.y,
                f.x * f.y,
            ],
        )
    };
    let row = |i: u32| {
        let t = (i as f32 + 0.5) / points as f32;
        let (ta, wa) = lookup(start_a, a0 + (a1 - a0) * t);
        let (tb, wb) = lookup(start_b, b1 + (b0 - b1) * t);
        let mut row = Row {
            texels: [0; 8],
            weights: [0.0; 8],
        };
        row.texels[..4].copy_from_slice(&ta);
        row.texels[4..].copy_from_slice(&tb);
        row.weights[..4].copy_from_slice(&wa);
        row.weights[4..].copy_from_slice(&wb.map(|w| -w));
        row
    };
    let size = a0.distance(a1).max(1e-6);
    let [from, to] = [a, b].map(|side| Beside::new(texels, side, size));
    let is_free = |i: u32| {
        let t = (i as f32 + 0.5) / points as f32;
        geometry.is_none_or(|geometry| {
            let (from, to) = (from.at(t), to.at(1.0 - t));
            !geometry.occluded(&Ray::between(from, to))
        })
    };
    (0..points).filter(|&i| is_free(i)).map(row).collect()
}

/// Points half a texel beside an edge, a quarter of a texel above the surface.
struct Beside {
    start: Vec3,
    along: Vec3,
    off: Vec3,
}

impl Beside {
    /// `texels_long`: length of the edge in texels.
    fn new(texels: &Texels, side: &Side, texels_long: f32) -> Self {
        let triangle = WorldTriangle::new(texels.scene, texels.pose, side.instance, side.primitive);
        let [start, end] = ends(texels, *side);
        let along = end - start;
        let inwards = triangle.corners[(side.k as usize + 2) % 3] - start;
        let inwards = inwards - along * (inwards.dot(along) / along.length_squared().max(1e-30));
        let texel = along.length() / texels_long;
        let normal = texels.normal(&triangle, side.instance, side.primitive);
        // Not beyond the triangle.
        let beside = inwards.clamp_length_max(0.5 * texel);
        Self {
            start,
            along,
            off: beside + normal * (0.5 * beside.length()),
        }
    }

    fn at(&self, t: f32) -> Vec3 {
        self.start + self.along * t + self.off
    }
}

/// The least squares problem over the texels that seams touch.
struct System {
    rows: Vec<Row>,
    /// The texels, in ascending order; rows count through these.
    touched: Vec<u32>,
}

impl System {
    fn new(mut rows: Vec<Row>) -> Self {
        let mut touched: Vec<u32> = rows
            .iter()
            .flat_map(|r| r.texels.iter().zip(r.weights))
            .filter(|(_, w)| *w != 0.0)
            .map(|(t, _)| *t)
            .collect();
        touched.par_sort_unstable();
        touched.dedup();
        rows.par_iter_mut().for_each(|row| {
            for (t, w) in row.texels.iter_mut().zip(row.weights) {
                *t = if w == 0.0 {
                    0
                } else {
                    touched.partition_point(|x| *x < *t) as u32
                };
            }
        });
        Self { rows, touched }
    }

    /// Differences at the seam points.
    fn differences(&self, x: &[Vec3]) -> Vec<Vec3> {
        let of = |row: &Row| {
            row.texels
                .iter()
                .zip(row.weights)
                .map(|(&t, w)| x[t as usize] * w)
                .sum()
        };
        self.rows.par_iter().map(of).collect()
    }

    /// The transposed product, in the order of rows.
    fn spread(&self, d: &[Vec3], out: &mut [Vec3]) {
        for (row, &d) in self.rows.iter().zip(d) {
            for (&t, w) in row.texels.iter().zip(row.weights) {
                out[t as usize] += d * w;
            }
        }
    }

    /// Conjugate gradients on `(A^T A + STAY) dx = -A^T A x0` (Hestenes & Stiefel 1952), three channels at once.
    fn solve(&self, canvases: &mut [(u32, Canvas)]) -> Stitched {
        let mut x = self.gather(canvases);
        let rms = |d: &[Vec3]| {
            (d.iter().map(|d| f64::from(d.length_squared())).sum::<f64>()
                / (3.0 * d.len().max(1) as f64))
                .sqrt()
        };
        let first = self.differences(&x);
        let mut residual = vec![Vec3::ZERO; x.len()];
        self.spread(
            &first.iter().map(|d| -*d).collect::<Vec<_>>(),
            &mut residual,
        );
        let mut change = vec![Vec3::ZERO; x.len()];
        let mut direction = residual.clone();
        let dot = |a: &[Vec3], b: &[Vec3]| {
            a.iter()
                .zip(b)
                .fold(glam::DVec3::ZERO, |s, (a, b)| s + (*a * *b).as_dvec3())
        };
        let mut square = dot(&residual, &residual);
        let enough = square * 1e-8;
        for _ in 0..MOST_STEPS {
            let mut product: Vec<Vec3> = direction.iter().map(|d| *d * STAY).collect();
            self.spread(&self.differences(&direction), &mut product);
            let curvature = dot(&direction, &product);
            let step = divide(square, curvature);
            for i in 0..x.len() {
                change[i] += direction[i] * step;
                residual[i] -= product[i] * step;
            }
            let next = dot(&residual, &residual);
            if next.cmple(enough).all() {
                break;
            }
            let turn = divide(next, square);
            direction
                .iter_mut()
                .zip(&residual)
                .for_each(|(d, r)| *d = *r + *d * turn);
            square = next;
        }
        // Light is not negative.
        x.iter_mut()
            .zip(&change)
            .for_each(|(x, c)| *x = (*x + *c).max(Vec3::ZERO.min(*x)));
        let after = rms(&self.differences(&x));
        self.scatter(&x, canvases);
        Stitched {
            points: self.rows.len() as u64,
            before: rms(&first),
            after,
        }
    }

    fn each(&self, canvases: &mut [(u32, Canvas)], mut visit: impl FnMut(usize, &mut [f32; 3])) {
        let mut k = 0;
        let mut start = 0;
        for (_, canvas) in canvases {
            let end = start + canvas.values.len();
            while let Some(&t) = self.touched.get(k).filter(|&&t| (t as usize) < end) {
                visit(k, &mut canvas.values[t as usize - start]);
                k += 1;
            }
            start = end;
        }
    }

    fn gather(&self, canvases: &mut [(u32, Canvas)]) -> Vec<Vec3> {
        let mut x = Vec::with_capacity(self.touched.len());
        self.each(canvases, |_, value| x.push(Vec3::from(*value)));
        x
    }

    fn scatter(&self, x: &[Vec3], canvases: &mut [(u32, Canvas)]) {
        self.each(canvases, |k, value| *value = x[k].to_array());
    }
}

/// Zero where there is nothing to divide by: that channel is done.
fn divide(a: glam::DVec3, b: glam::DVec3) -> Vec3 {
    let part = |a: f64, b: f64| if b > 0.0 { (a / b) as f32 } else { 0.0 };
    Vec3::new(part(a.x, b.x), part(a.y, b.y), part(a.z, b.z))
}
