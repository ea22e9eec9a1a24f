//! Triangle soups with smooth or flat normals: the parts that scenes are made of. Fronts face outwards.

use super::math::{Place, sin_cos};
use glam::{Vec2, Vec3};

/// Triangles with normals and texture coordinates at every vertex.
#[derive(Clone, Default)]
pub(super) struct Shape {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub uv: Vec<Vec2>,
    pub triangles: Vec<[u32; 3]>,
}

/// A hole in a wall: (from, to) along the wall and (bottom, top).
type Hole = ([f32; 2], [f32; 2]);

impl Shape {
    fn vertex(&mut self, position: Vec3, normal: Vec3, uv: Vec2) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.uv.push(uv);
        self.positions.len() as u32 - 1
    }

    /// Joins a grid of vertices, `columns + 1` a row, that starts at vertex `first`; rows times columns points outwards.
    fn weave(&mut self, first: u32, columns: u32, rows: u32) {
        for j in 0..rows {
            for i in 0..columns {
                let a = first + j * (columns + 1) + i;
                let (b, c, d) = (a + 1, a + columns + 2, a + columns + 1);
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    /// Adds an axis-aligned rectangle of `n` times `n` cells at coordinate `at` of an axis; its front faces up that axis or
    /// down. The other two axes follow in cyclic order. Corners are the given numbers, so that neighbours meet exactly.
    pub fn rect(&mut self, axis: usize, up: bool, at: f32, a: [f32; 2], b: [f32; 2], n: u32) {
        let first = self.positions.len() as u32;
        let step = |range: [f32; 2], i: u32| {
            if i == n {
                range[1]
            } else {
                range[0] + (range[1] - range[0]) * (i as f32 / n as f32)
            }
        };
        let mut normal = Vec3::ZERO;
        normal[axis] = if up { 1.0 } else { -1.0 };
        for j in 0..=n {
            for i in 0..=n {
                // Facing down, the two axes change places.
                let (along, across) = if up { (i, j) } else { (j, i) };
                let mut p = Vec3::ZERO;
                p[axis] = at;
                p[(axis + 1) % 3] = step(a, along);
                p[(axis + 2) % 3] = step(b, across);
                self.vertex(p, normal, Vec2::new(i as f32, (n - j) as f32) / n as f32);
            }
        }
        self.weave(first, n, n);
    }

    /// Adds an axis-aligned box; each face has `n` times `n` cells.
    pub fn block(&mut self, low: Vec3, high: Vec3, n: u32) {
        for axis in 0..3 {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let (a, b) = ([low[a], high[a]], [low[b], high[b]]);
            self.rect(axis, false, low[axis], a, b, n);
            self.rect(axis, true, high[axis], a, b, n);
        }
    }

    /// Adds an upright wall, the box from `low` to `high`, with rectangular holes through it. It runs along X or along Z.
    /// Holes are (from, to) along the wall and (bottom, top); all faces share the corners of one grid.
    pub fn wall(&mut self, low: Vec3, high: Vec3, along_x: bool, holes: &[Hole]) {
        let u = if along_x { 0 } else { 2 };
        let w = 2 - u;
        let lines = |axis: usize, of: fn(&Hole) -> [f32; 2]| {
            let mut all = vec![low[axis], high[axis]];
            all.extend(
                holes
                    .iter()
                    .flat_map(of)
                    .filter(|&x| x > low[axis] && x < high[axis]),
            );
            all.sort_by(f32::total_cmp);
            all.dedup();
            all
        };
        let (xs, ys) = (lines(u, |h| h.0), lines(1, |h| h.1));
        let inside = |range: [f32; 2], a: f32, b: f32| range[0] <= a && b <= range[1];
        let solid = |i: isize, j: isize| {
            let (Ok(i), Ok(j)) = (usize::try_from(i), usize::try_from(j)) else {
                return false;
            };
            i + 1 < xs.len()
                && j + 1 < ys.len()
                && !holes
                    .iter()
                    .any(|h| inside(h.0, xs[i], xs[i + 1]) && inside(h.1, ys[j], ys[j + 1]))
        };
        for i in 0..xs.len() - 1 {
            for j in 0..ys.len() - 1 {
                let (si, sj) = (i as isize, j as isize);
                if !solid(si, sj) {
                    continue;
                }
                let mut bounds = [[0.0; 2]; 3];
                bounds[u] = [xs[i], xs[i + 1]];
                bounds[1] = [ys[j], ys[j + 1]];
                bounds[w] = [low[w], high[w]];
                let mut face = |axis: usize, up: bool| {
                    let (a, b) = (bounds[(axis + 1) % 3], bounds[(axis + 2) % 3]);
                    self.rect(axis, up, bounds[axis][usize::from(up)], a, b, 1);
                };
                face(w, false);
                face(w, true);
                for (axis, up, open) in [
                    (u, false, !solid(si - 1, sj)),
                    (u, true, !solid(si + 1, sj)),
                    (1, false, !solid(si, sj - 1)),
                    (1, true, !solid(si, sj + 1)),
                ] {
                    if open {
                        face(axis, up);
                    }
                }
            }
        }
    }

    /// Adds a flat convex polygon, counterclockwise seen from its front.
    pub fn flat_polygon(&mut self, corners: &[Vec3]) {
        let normal = corners
            .windows(2)
            .map(|w| (w[0] - corners[0]).cross(w[1] - corners[0]))
            .sum::<Vec3>()
            .normalize_or(Vec3::Y);
        let first = self.positions.len() as u32;
        for &corner in corners {
            self.vertex(corner, normal, Vec2::ZERO);
        }
        self.triangles
            .extend((2..corners.len() as u32).map(|k| [first, first + k - 1, first + k]));
    }

    /// Adds another shape at a place. Mirroring places turn the triangles around, so fronts stay outside.
    pub fn add(&mut self, other: &Shape, place: &Place) {
        let first = self.positions.len() as u32;
        let normal_matrix = place.linear.inverse().transpose();
        let mirrored = place.linear.determinant() < 0.0;
        self.positions
            .extend(other.positions.iter().map(|&p| place.point(p)));
        self.normals.extend(
            other
                .normals
                .iter()
                .map(|&n| (normal_matrix * n).normalize_or(Vec3::Y)),
        );
        self.uv.extend(&other.uv);
        self.triangles
            .extend(other.triangles.iter().map(|&[a, b, c]| {
                let [a, b, c] = [first + a, first + b, first + c];
                if mirrored { [a, c, b] } else { [a, b, c] }
            }));
    }

    /// The shape turned inside out.
    pub fn inverted(mut self) -> Self {
        for t in &mut self.triangles {
            t.swap(1, 2);
        }
        for n in &mut self.normals {
            *n = -*n;
        }
        self
    }

    /// Adds a surface of revolution about +Y through `(radius, height)` points, from the bottom up for fronts that face
    /// outwards. Smooth around; along the profile smooth or creased at every point.
    pub fn lathe(&mut self, profile: &[(f32, f32)], segments: u32, smooth: bool) {
        let slope =
            |a: (f32, f32), b: (f32, f32)| Vec2::new(b.1 - a.1, a.0 - b.0).normalize_or_zero();
        let pieces = profile.len() - 1;
        let ring = |shape: &mut Self, (radius, height): (f32, f32), n: Vec2, t: f32| {
            for i in 0..=segments {
                let (s, c) = sin_cos((i % segments) as f32 / segments as f32);
                let position = Vec3::new(radius * s, height, radius * c);
                let normal = Vec3::new(n.x * s, n.y, n.x * c);
                shape.vertex(position, normal, Vec2::new(i as f32 / segments as f32, t));
            }
        };
        let first = self.positions.len() as u32;
        let t = |k: usize| 1.0 - k as f32 / pieces as f32;
        for k in 0..pieces {
            let here = slope(profile[k], profile[k + 1]);
            if smooth {
                let before = if k > 0 {
                    slope(profile[k - 1], profile[k])
                } else {
                    here
                };
                ring(self, profile[k], (here + before).normalize_or(here), t(k));
                if k + 1 == pieces {
                    ring(self, profile[k + 1], here, t(k + 1));
                }
            } else {
                ring(self, profile[k], here, t(k));
                ring(self, profile[k + 1], here, t(k + 1));
            }
        }
        let row = segments + 1;
        for k in 0..pieces as u32 {
            let (low, high) = if smooth {
                (k, k + 1)
            } else {
                (2 * k, 2 * k + 1)
            };
            let (touches_low, touches_high) = (
                profile[k as usize].0 == 0.0,
                profile[k as usize + 1].0 == 0.0,
            );
            for i in 0..segments {
                let (a, b) = (first + low * row + i, first + low * row + i + 1);
                let (d, c) = (first + high * row + i, first + high * row + i + 1);
                if !touches_low {
                    self.triangles
                        .push([a, b, if touches_high { d } else { c }]);
                }
                if !touches_high {
                    self.triangles.push([a, c, d]);
                }
            }
        }
    }

    /// Adds a sphere.
    pub fn sphere(&mut self, radius: f32, segments: u32) {
        let rings = (segments / 2).max(2);
        let profile: Vec<(f32, f32)> = (0..=rings)
            .map(|k| {
                let (s, c) = sin_cos(k as f32 / rings as f32 * 0.5);
                let pole = k == 0 || k == rings;
                (if pole { 0.0 } else { radius * s }, -radius * c)
            })
            .collect();
        let first = self.positions.len();
        self.lathe(&profile, segments, true);
        for (n, p) in self.normals[first..]
            .iter_mut()
            .zip(&self.positions[first..])
        {
            *n = p.normalize_or(Vec3::Y);
        }
    }

    /// Adds an upright closed cylinder that stands on `y = 0`.
    pub fn cylinder(&mut self, radius: f32, height: f32, segments: u32) {
        let profile = [(0.0, 0.0), (radius, 0.0), (radius, height), (0.0, height)];
        self.lathe(&profile, segments, false);
    }

    /// Adds a box around the origin whose edges and corners are rounded in `n` steps an eighth of a turn.
    pub fn rounded_box(&mut self, half: Vec3, radius: f32, n: u32) {
        let radius = radius.min(half.min_element());
        let inner = half - Vec3::splat(radius);
        // Tangents of the angles from the middle of a face to its edge, once for each sign: the flat middle part lies
        // between the two zeros.
        let steps: Vec<(f32, f32)> = (0..=2 * n + 1)
            .map(|i| {
                let (sign, k) = if i <= n {
                    (-1.0, n - i)
                } else {
                    (1.0, i - n - 1)
                };
                let tangent = if k == n {
                    1.0
                } else {
                    let (s, c) = sin_cos(k as f32 / n as f32 / 8.0);
                    s / c
                };
                (sign, sign * tangent)
            })
            .collect();
        for axis in 0..3 {
            for side in [-1.0f32, 1.0] {
                let first = self.positions.len() as u32;
                for (j, &(sign_v, v)) in steps.iter().enumerate() {
                    for (i, &(sign_u, u)) in steps.iter().enumerate() {
                        let mut direction = Vec3::ZERO;
                        let mut signs = Vec3::ZERO;
                        // (axis, u, v) is right-handed; on the far side u runs backwards, so that fronts stay outside.
                        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                        direction[axis] = side;
                        signs[axis] = side;
                        direction[a] = u * side;
                        signs[a] = sign_u * side;
                        direction[b] = v;
                        signs[b] = sign_v;
                        let normal = direction.normalize();
                        let uv = Vec2::new(i as f32, j as f32) / (2 * n + 1) as f32;
                        self.vertex(signs * inner + normal * radius, normal, uv);
                    }
                }
                self.weave(first, 2 * n + 1, 2 * n + 1);
            }
        }
    }

    /// Adds a tube along a path; `radii` has one entry a point. A radius of 0 makes a tip; ends stay open otherwise.
    pub fn tube(&mut self, path: &[Vec3], radii: &[f32], sides: u32) {
        let Some((&start, &second)) = path.first().zip(path.get(1)) else {
            return;
        };
        let mut tangent = (second - start).normalize_or(Vec3::Y);
        let mut across = tangent.any_orthonormal_vector();
        let first = self.positions.len() as u32;
        for (k, (&p, &radius)) in path.iter().zip(radii).enumerate() {
            let ahead = path.get(k + 1).copied().unwrap_or(p);
            let behind = if k > 0 { path[k - 1] } else { p };
            tangent = (ahead - behind).normalize_or(tangent);
            // Parallel transport: the frame turns no more than the path does.
            across = (across - tangent * across.dot(tangent)).normalize_or(across);
            let up = tangent.cross(across);
            for i in 0..=sides {
                let (s, c) = sin_cos((i % sides) as f32 / sides as f32);
                let normal = across * c + up * s;
                let t = k as f32 / (path.len() - 1) as f32;
                self.vertex(
                    p + normal * radius,
                    normal,
                    Vec2::new(i as f32 / sides as f32, t),
                );
            }
        }
        let row = sides + 1;
        for k in 0..path.len() as u32 - 1 {
            for i in 0..sides {
                let (a, b) = (first + k * row + i, first + k * row + i + 1);
                let (d, c) = (a + row, b + row);
                self.triangles
                    .push([a, b, if radii[k as usize + 1] == 0.0 { d } else { c }]);
                if radii[k as usize + 1] != 0.0 {
                    self.triangles.push([a, c, d]);
                }
            }
        }
    }
}
