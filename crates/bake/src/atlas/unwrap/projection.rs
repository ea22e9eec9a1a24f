//! Charts that grow over triangles that face alike, projected along their mean normal.
//!
//! Seeds are taken by area; from a seed a chart grows over neighbours within a cone around the seed's normal, then anew within a cone
//! around the mean normal found so. Small left-overs join a neighbour whose direction they can be seen from. No triangle turns its
//! back in its chart, so what can still go wrong is a chart that winds over itself (a spiral stair): it is looked for in a raster, and the
//! chart is cut in two until nothing is found. Charts that leave most of their rectangle empty (the frame of a window) are cut, too.
//! Linear but for sorting.

use super::overlap::overlaps;
use super::topology::{NONE, neighbours};
use super::{Charts, Surface, Unwrap, UnwrapError, cross};
use crate::atlas::arrange::fit;
use glam::{DVec2, Vec2, Vec3};

/// Grows charts and projects them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Projection;

/// Cosine of the widest angle to the seed's normal: 37 degrees.
const SEED_CONE: f32 = 0.8;
/// Cosine of the widest angle to the mean normal: 46 degrees. A projection shrinks lengths by no more than this.
const MEAN_CONE: f32 = 0.7;
/// The same for small left-overs that join a neighbour: 70 degrees.
const JOIN_CONE: f32 = 0.342;
/// Charts of fewer texels look for a neighbour to join.
const SMALL_TEXELS: f32 = 64.0;
/// Charts that use less of their rectangle are cut, unless it is small.
const LEAST_FILL: f32 = 0.35;
/// Rectangles of fewer texels are small.
const SMALL_CELLS: u32 = 256;

impl Unwrap for Projection {
    fn charts(&self, surface: &Surface) -> Result<Charts, UnwrapError> {
        let mut work = Work::new(surface);
        work.grow()?;
        work.join_small();
        work.split_unfit();
        Ok(work.project())
    }
}

/// A chart under way: a linked list of triangles and the direction of its projection.
#[derive(Clone, Copy)]
struct Chart {
    head: u32,
    tail: u32,
    axis: Vec3,
    area: f32,
    /// Every triangle faces exactly along the axis.
    flat: bool,
}

struct Work<'a> {
    surface: &'a Surface<'a>,
    neighbours: Vec<[u32; 3]>,
    /// Unit normals; zero: no area.
    normals: Vec<Vec3>,
    of: Vec<u32>,
    /// The next triangle of the same chart.
    next: Vec<u32>,
    charts: Vec<Chart>,
}

impl<'a> Work<'a> {
    fn new(surface: &'a Surface<'a>) -> Self {
        let count = surface.triangles.len();
        let normal = |t: &[u32; 3]| cross(surface.positions, *t).normalize_or_zero();
        Self {
            surface,
            neighbours: neighbours(surface.positions, surface.triangles),
            normals: surface.triangles.iter().map(normal).collect(),
            of: vec![NONE; count],
            next: vec![NONE; count],
            charts: Vec::new(),
        }
    }

    fn area(&self, t: u32) -> f32 {
        0.5 * cross(self.surface.positions, self.surface.triangles[t as usize]).length()
    }

    fn grow(&mut self) -> Result<(), UnwrapError> {
        let mut seeds: Vec<(f32, u32)> = (0..self.normals.len() as u32)
            .filter(|&t| self.normals[t as usize] != Vec3::ZERO)
            .map(|t| (self.area(t), t))
            .collect();
        if seeds.is_empty() {
            return Err(UnwrapError::NoArea);
        }
        seeds.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let (mut found, mut seen) = (Vec::new(), vec![NONE; self.normals.len()]);
        let mut stamp = 0;
        for (_, seed) in seeds {
            if self.of[seed as usize] != NONE {
                continue;
            }
            let axis = self.normals[seed as usize];
            let sum = self.flood(seed, axis, SEED_CONE, stamp, &mut seen, &mut found);
            stamp += 1;
            let flat = |axis: Vec3, found: &[u32]| {
                found
                    .iter()
                    .all(|&t| self.normals[t as usize].dot(axis) > 0.999_99)
            };
            let mut axis = axis;
            if !flat(axis, &found) {
                axis = sum.normalize_or(axis);
                self.flood(seed, axis, MEAN_CONE, stamp, &mut seen, &mut found);
                stamp += 1;
            }
            let flat = flat(axis, &found);
            self.add_chart(&found, axis, flat);
        }
        Ok(())
    }

    /// Triangles without a chart that connect to `seed` within a cone, and the sum of their normals by area.
    fn flood(
        &self,
        seed: u32,
        axis: Vec3,
        cone: f32,
        stamp: u32,
        seen: &mut [u32],
        found: &mut Vec<u32>,
    ) -> Vec3 {
        found.clear();
        found.push(seed);
        seen[seed as usize] = stamp;
        let (mut at, mut sum) = (0, Vec3::ZERO);
        while let Some(&t) = found.get(at) {
            at += 1;
            sum += cross(self.surface.positions, self.surface.triangles[t as usize]);
            for n in self.neighbours[t as usize] {
                let fits = n != NONE
                    && seen[n as usize] != stamp
                    && self.of[n as usize] == NONE
                    && self.normals[n as usize].dot(axis) > cone;
                if fits {
                    seen[n as usize] = stamp;
                    found.push(n);
                }
            }
        }
        sum
    }

    fn add_chart(&mut self, triangles: &[u32], axis: Vec3, flat: bool) -> u32 {
        let chart = self.charts.len() as u32;
        for pair in triangles.windows(2) {
            self.next[pair[0] as usize] = pair[1];
        }
        let (head, tail) = (triangles[0], triangles[triangles.len() - 1]);
        self.next[tail as usize] = NONE;
        let mut area = 0.0;
        for &t in triangles {
            self.of[t as usize] = chart;
            area += self.area(t);
        }
        self.charts.push(Chart {
            head,
            tail,
            axis,
            area,
            flat,
        });
        chart
    }

    fn members(&self, chart: u32) -> impl Iterator<Item = u32> + Clone + '_ {
        let next = |t: &u32| Some(self.next[*t as usize]).filter(|&t| t != NONE);
        std::iter::successors(
            Some(self.charts[chart as usize].head).filter(|&t| t != NONE),
            next,
        )
    }

    /// Small charts, the smallest first, join the neighbour with which they share most of their border.
    fn join_small(&mut self) {
        let texel = 1.0 / self.surface.texels_per_metre;
        let small = SMALL_TEXELS * texel * texel;
        let mut order: Vec<u32> = (0..self.charts.len() as u32)
            .filter(|&c| self.charts[c as usize].area < small)
            .collect();
        order.sort_unstable_by(|&a, &b| {
            self.charts[a as usize]
                .area
                .total_cmp(&self.charts[b as usize].area)
                .then(a.cmp(&b))
        });
        let mut borders: Vec<(u32, f32)> = Vec::new();
        for chart in order {
            borders.clear();
            for t in self.members(chart) {
                for k in 0..3 {
                    let n = self.neighbours[t as usize][k];
                    let other = if n == NONE { NONE } else { self.of[n as usize] };
                    if other == NONE || other == chart {
                        continue;
                    }
                    let [a, b] = [k, (k + 1) % 3].map(|k| {
                        self.surface.positions[self.surface.triangles[t as usize][k] as usize]
                    });
                    match borders.iter_mut().find(|(c, _)| *c == other) {
                        Some((_, length)) => *length += a.distance(b),
                        None => borders.push((other, a.distance(b))),
                    }
                }
            }
            borders.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let fits = |into: u32| {
                let axis = self.charts[into as usize].axis;
                self.members(chart)
                    .all(|t| self.normals[t as usize].dot(axis) > JOIN_CONE)
            };
            if let Some(&(into, _)) = borders.iter().find(|&&(into, _)| fits(into)) {
                self.join(chart, into);
            }
        }
    }

    fn join(&mut self, chart: u32, into: u32) {
        let members: Vec<u32> = self.members(chart).collect();
        for t in members {
            self.of[t as usize] = into;
        }
        let from = self.charts[chart as usize];
        let tail = self.charts[into as usize].tail;
        self.next[tail as usize] = from.head;
        let into = &mut self.charts[into as usize];
        into.tail = from.tail;
        into.area += from.area;
        into.flat = false;
        self.charts[chart as usize].head = NONE;
    }

    /// Whether most of the chart's rectangle would be empty.
    fn is_sparse(&self, chart: u32, frame: &Frame, points: &mut Vec<DVec2>) -> bool {
        let density = self.surface.texels_per_metre;
        let texels = self.charts[chart as usize].area * density * density;
        points.clear();
        let mut border = 0.0;
        for t in self.members(chart) {
            let corners = frame.corners(self, t);
            points.extend(corners.map(Vec2::as_dvec2));
            for k in 0..3 {
                let n = self.neighbours[t as usize][k];
                if n == NONE || self.of[n as usize] != chart {
                    border += corners[k].distance(corners[(k + 1) % 3]);
                }
            }
        }
        let cells = fit(points, f64::from(density)).cells;
        let cells = u64::from(cells.x) * u64::from(cells.y);
        // Half a texel on either side of the border is used as well.
        let used = texels + 0.5 * border * density + 1.0;
        cells > u64::from(SMALL_CELLS) && used < LEAST_FILL * cells as f32
    }

    fn split_unfit(&mut self) {
        let mut chart = 0;
        let mut two = [Vec::new(), Vec::new()];
        let mut points = Vec::new();
        while chart < self.charts.len() as u32 {
            let known = self.charts[chart as usize];
            let frame = Frame::new(self, known);
            let whole = known.head == NONE || known.head == known.tail || {
                let folds = !known.flat
                    && overlaps(
                        self.members(chart).map(|t| frame.corners(self, t)),
                        2.0 * self.surface.texels_per_metre,
                    );
                !folds && !self.is_sparse(chart, &frame, &mut points)
            };
            if whole {
                chart += 1;
                continue;
            }
            self.halve(chart, &mut two);
            let axis = |work: &Self, part: &[u32]| {
                let sum: Vec3 = part
                    .iter()
                    .map(|&t| cross(work.surface.positions, work.surface.triangles[t as usize]))
                    .sum();
                let mean = sum.normalize_or(known.axis);
                let seen = |axis: Vec3| {
                    part.iter()
                        .all(|&t| work.normals[t as usize].dot(axis) > JOIN_CONE)
                };
                if seen(mean) { mean } else { known.axis }
            };
            let axes = [axis(self, &two[0]), axis(self, &two[1])];
            // The first half keeps the number and is looked at again; the second comes up at the end.
            let kept = self.add_chart(&two[0], axes[0], known.flat);
            self.charts[chart as usize] = self.charts[kept as usize];
            self.charts.pop();
            two[0].iter().for_each(|&t| self.of[t as usize] = chart);
            self.add_chart(&two[1], axes[1], known.flat);
        }
    }

    /// Divides a chart's triangles: breadth first from one of its ends, until half of them are reached; then the rest.
    fn halve(&self, chart: u32, two: &mut [Vec<u32>; 2]) {
        let members: Vec<u32> = self.members(chart).collect();
        let half = members.len() / 2;
        // What is reached last from anywhere is an end.
        let far = |from: u32, limit: usize, out: &mut Vec<u32>| {
            let mut seen = std::collections::BTreeSet::from([from]);
            out.clear();
            out.push(from);
            let mut at = 0;
            while at < out.len() && out.len() < limit {
                for n in self.neighbours[out[at] as usize] {
                    if n != NONE
                        && self.of[n as usize] == chart
                        && out.len() < limit
                        && seen.insert(n)
                    {
                        out.push(n);
                    }
                }
                at += 1;
            }
        };
        let [first, second] = two;
        far(members[0], members.len(), first);
        let end = first[first.len() - 1];
        far(end, half.max(1), first);
        let taken: std::collections::BTreeSet<u32> = first.iter().copied().collect();
        second.clear();
        second.extend(members.iter().filter(|t| !taken.contains(t)));
        debug_assert!(!second.is_empty());
    }

    fn project(self) -> Charts {
        let mut of = vec![NONE; self.of.len()];
        let mut corners = vec![[Vec2::ZERO; 3]; self.of.len()];
        let mut count = 0;
        for (c, chart) in self
            .charts
            .iter()
            .enumerate()
            .filter(|(_, chart)| chart.head != NONE)
        {
            let frame = Frame::new(&self, *chart);
            let mut flat = 0.0;
            for t in self.members(c as u32) {
                let [a, b, c] = frame.corners(&self, t);
                corners[t as usize] = [a, b, c];
                flat += 0.5 * (b - a).perp_dot(c - a).abs();
                of[t as usize] = count;
            }
            // As many texels as the surface's area is worth.
            let scale = if chart.flat || flat <= 0.0 {
                1.0
            } else {
                (chart.area / flat).sqrt()
            };
            if scale != 1.0 {
                for t in self.members(c as u32) {
                    corners[t as usize] = corners[t as usize].map(|c| c * scale);
                }
            }
            count += 1;
        }
        Charts { of, corners, count }
    }
}

/// The plane of a chart.
struct Frame {
    origin: Vec3,
    x: Vec3,
    y: Vec3,
}

impl Frame {
    fn new(work: &Work, chart: Chart) -> Self {
        let first = work
            .surface
            .triangles
            .get(chart.head as usize)
            .map_or(0, |t| t[0]);
        let (x, y) = chart.axis.any_orthonormal_pair();
        // Rows run down, so that charts are not mirrored in a picture of the page.
        Self {
            origin: work.surface.positions[first as usize],
            x,
            y: -y,
        }
    }

    fn corners(&self, work: &Work, t: u32) -> [Vec2; 3] {
        work.surface.triangles[t as usize].map(|i| {
            let p = work.surface.positions[i as usize] - self.origin;
            Vec2::new(p.dot(self.x), p.dot(self.y))
        })
    }
}
