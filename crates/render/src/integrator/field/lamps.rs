//! Emissive surfaces as lobes behind bounded maps.
//!
//! A map of the whole hemisphere cannot tell what is before a lamp from what is behind it. So every sample point looks at each lamp through a small map
//! of its own: rays to a square about the lamp's centre, in the plane of the lamp, which end just before it. The lamp itself and all
//! that is behind it block nothing. Kept is one number, the distance from the lamp's centre to the nearest edge of visibility in radii of the lamp
//! (of the disk with the area that is seen), negative where the centre is blocked. Pixels interpolate distances as they do those of the sky, so
//! that shadows have penumbrae and edges that move; a disk that a straight edge cuts at the interpolated distance is what is visible ([`free_share`]).
//!
//! Unshadowed light is that of the lamps' triangles ([`polygon`]); only in lobes much broader than a lamp the lamp is a spherical Gaussian with its radiance and its solid
//! angle. Large lamps are cut into parts. Wrong tool for many lamps: then there are none here, and exact rays are used.

use super::math::exp;
use super::polygon;
use crate::geometry::Geometry;
use crate::light::EmissivePart;
use glam::Vec3;
use occlude_visibility::{Ray, Tracer};
use std::f32::consts::{FRAC_1_PI, TAU};

/// Lamps at most, and triangles that they may have.
pub(super) const MOST: usize = 8;
const MOST_TRIANGLES: usize = 16;
/// Parts that one lamp is cut into.
const PARTS: usize = 4;
/// Pieces that parts are made of, at least.
const PIECES: usize = 64;

/// Texels along a side of a map, odd; steps of the first level; and half its width in radii of the lamp.
const SIDE: usize = 17;
const STEP: usize = 4;
const REACH: f32 = 2.0;

/// What an edge of visibility may be away from the centre of a lamp, by lamp.
pub(super) type Distances = [f32; MOST];

/// A part of the emissive surfaces.
#[derive(Clone, Copy, Debug)]
struct Lamp {
    centre: Vec3,
    /// Sum of areas times normals, square metres.
    facing: Vec3,
    area: f32,
    /// Mean over the area.
    radiance: Vec3,
    double_sided: bool,
    /// Of a ball that holds it.
    radius: f32,
}

/// Emissive surfaces, cut into parts.
#[derive(Clone, Debug, Default)]
pub(super) struct Lamps {
    list: Vec<Lamp>,
    triangles: Vec<EmissivePart>,
}

/// A lamp as a pixel sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Unit vector to its centre.
    axis: Vec3,
    sharpness: f32,
    radiance: Vec3,
    /// Its share in the irradiance of all, were nothing in the way; not normalised.
    weight: f32,
    /// What is visible of it, and what is above the horizon.
    free: f32,
    above: f32,
}

impl Lamp {
    /// The area that is seen from a direction (unit vector towards the viewer).
    fn projected(&self, toward: Vec3) -> f32 {
        let flat = self.facing.length();
        let closed = (self.area - flat).max(0.0);
        let cos = self.facing.dot(toward);
        let front = if self.double_sided {
            cos.abs()
        } else {
            cos.max(0.0)
        };
        // Of what faces all ways a quarter is seen.
        front + 0.25 * closed
    }
}

/// The share of a disk that an edge leaves, which is so many radii away from its centre.
#[inline(always)]
fn free_share(distance: f32) -> f32 {
    let d = distance.clamp(-1.0, 1.0);
    0.5 + (d * (1.0 - d * d).sqrt() + super::math::asin(d)) * FRAC_1_PI
}

impl Lamps {
    /// `None` if there are too many emissive triangles.
    pub(super) fn new(triangles: Vec<EmissivePart>) -> Option<Self> {
        if triangles.len() > MOST_TRIANGLES {
            return None;
        }
        if triangles.is_empty() {
            return Some(Self::default());
        }
        let one = triangles.iter().all(|t| t.mesh == triangles[0].mesh);
        let mut pieces = triangles.clone();
        while pieces.len() < PIECES {
            pieces = pieces.iter().flat_map(halves).collect();
        }
        let list = parts(&pieces, if one { PARTS } else { MOST });
        Some(Self { list, triangles })
    }

    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    /// Distances of edges of visibility from the lamps' centres, as a point sees them. Returns the rays.
    pub(super) fn look(
        &self,
        geometry: &Geometry,
        origin: Vec3,
        normal: Vec3,
        window: &mut Window,
        out: &mut Distances,
    ) -> u64 {
        let mut rays = 0;
        for (lamp, out) in self.list.iter().zip(out.iter_mut()) {
            let to = lamp.centre - origin;
            let distance = to.length();
            let toward = -to / distance.max(1e-20);
            let seen = lamp.projected(toward);
            // Not lit whatever is in the way.
            if seen <= 0.0 || to.dot(normal) < -lamp.radius || distance <= 1e-20 {
                *out = REACH;
                continue;
            }
            let radius = (seen * FRAC_1_PI).sqrt();
            let found = window.nearest_edge(geometry, origin, lamp, toward, radius);
            *out = found.0;
            rays += found.1;
        }
        rays
    }

    /// The lamps as a pixel sees them.
    pub(super) fn seen(
        &self,
        position: Vec3,
        normal: Vec3,
        distances: &Distances,
        out: &mut Vec<Seen>,
    ) {
        out.clear();
        for (lamp, distance) in self.list.iter().zip(distances) {
            let to = lamp.centre - position;
            let square = to.length_squared().max(1e-12);
            let axis = to / square.sqrt();
            let projected = lamp.projected(-axis);
            if projected <= 0.0 {
                continue;
            }
            // The solid angle of a disk with that area, which faces the pixel.
            let ratio = projected * FRAC_1_PI / square;
            let solid = TAU * (1.0 - 1.0 / (1.0 + ratio).sqrt());
            // What of it is above the horizon.
            let cos = normal.dot(axis);
            let above = free_share(cos / ratio.sqrt().max(1e-6));
            if above <= 0.0 {
                continue;
            }
            out.push(Seen {
                axis,
                sharpness: TAU / solid.max(1e-6),
                radiance: lamp.radiance,
                weight: projected / square * (cos.max(0.0) + 0.05 * ratio.sqrt()),
                free: free_share(*distance),
                above,
            });
        }
    }

    /// Irradiance of all lamps.
    pub(super) fn irradiance(&self, position: Vec3, normal: Vec3, seen: &[Seen]) -> Vec3 {
        let (mut free, mut all) = (0.0, 0.0);
        for lamp in seen {
            free += lamp.weight * lamp.free;
            all += lamp.weight;
        }
        if free <= 0.0 {
            return Vec3::ZERO;
        }
        let lit = self.facing(position).map(|triangle| {
            let corners = triangle.corners.map(|p| p - position);
            triangle.radiance * polygon::irradiance(corners, normal)
        });
        lit.sum::<Vec3>() * (free / all)
    }

    /// The triangles that shine towards a place.
    fn facing(&self, position: Vec3) -> impl Iterator<Item = &EmissivePart> {
        self.triangles.iter().filter(move |triangle| {
            let [a, b, c] = triangle.corners;
            triangle.double_sided || (b - a).cross(c - a).dot(position - a) > 0.0
        })
    }

    /// The integral of all lamps times a lobe of amplitude 1. In a narrow lobe lamps have the outlines that they have; what is seen of them is that of the parts
    /// that the lobe sees.
    pub(super) fn in_lobe(
        &self,
        position: Vec3,
        normal: Vec3,
        seen: &[Seen],
        axis: Vec3,
        sharpness: f32,
    ) -> Vec3 {
        /// Solid angles of a part, in those of the lobe, up to which it may as well be a lobe.
        const ROUND: f32 = 0.02;
        /// What fills less of a lobe is not looked at closely.
        const NEGLIGIBLE: f32 = 1e-4;
        let (mut sum, mut free, mut all, mut widest) = (Vec3::ZERO, 0.0, 0.0, 0.0_f32);
        for lamp in seen {
            let whole = lamp.in_lobe(axis, sharpness);
            let light = lamp.radiance * whole;
            sum += light * lamp.free;
            free += light.element_sum() * lamp.free;
            all += light.element_sum();
            if whole * sharpness > NEGLIGIBLE {
                widest = widest.max(sharpness / lamp.sharpness);
            }
        }
        if widest < ROUND || free <= 0.0 {
            return sum;
        }
        let lit = self.facing(position).map(|triangle| {
            let corners = triangle.corners.map(|p| p - position);
            triangle.radiance * polygon::in_lobe(corners, normal, axis, sharpness)
        });
        lit.sum::<Vec3>() * (free / all)
    }
}

impl Seen {
    /// The integral of a lobe for the lamp and a lobe of amplitude 1, nothing in the way.
    fn in_lobe(&self, axis: Vec3, sharpness: f32) -> f32 {
        let (own, cos) = (self.sharpness, axis.dot(self.axis));
        let sum = own + sharpness;
        let twice = 2.0 * own * sharpness * (1.0 - cos);
        let length = (sum * sum - twice).max(1e-12).sqrt();
        let whole = TAU * (1.0 - exp(-2.0 * length)) / length;
        exp(-twice / (length + sum)) * whole * self.above
    }
}

/// A triangle cut through the middle of its longest edge.
fn halves(part: &EmissivePart) -> [EmissivePart; 2] {
    let [a, b, c] = part.corners;
    let sides = [(b - a).length(), (c - b).length(), (a - c).length()];
    let turned = if sides[0] >= sides[1] && sides[0] >= sides[2] {
        [a, b, c]
    } else if sides[1] >= sides[2] {
        [b, c, a]
    } else {
        [c, a, b]
    };
    let [a, b, c] = turned;
    let middle = (a + b) * 0.5;
    [[a, middle, c], [middle, b, c]].map(|corners| EmissivePart { corners, ..*part })
}

/// At most `count` parts, each of pieces that are near each other.
fn parts(pieces: &[EmissivePart], count: usize) -> Vec<Lamp> {
    let places: Vec<Vec3> = (pieces.iter())
        .map(|piece| piece.corners.iter().sum::<Vec3>() / 3.0)
        .collect();
    // Each centre as far from those before as may be; then some rounds of k-means.
    let mut centres = vec![places[0]];
    while centres.len() < count {
        let far = |p: &Vec3| {
            let nearest = centres.iter().map(|c| c.distance_squared(*p));
            nearest.fold(f32::INFINITY, f32::min)
        };
        let Some(next) = places.iter().max_by(|a, b| far(a).total_cmp(&far(b))) else {
            break;
        };
        centres.push(*next);
    }
    let mut owner = vec![0; places.len()];
    for _ in 0..8 {
        for (owner, place) in owner.iter_mut().zip(&places) {
            let near = |k: &usize| centres[*k].distance_squared(*place);
            let nearest = (0..centres.len()).min_by(|a, b| near(a).total_cmp(&near(b)));
            *owner = nearest.unwrap_or(0);
        }
        for (k, centre) in centres.iter_mut().enumerate() {
            let own = places.iter().zip(&owner).filter(|(_, owner)| **owner == k);
            let (sum, number) = own.fold((Vec3::ZERO, 0.0), |(s, n), (p, _)| (s + *p, n + 1.0));
            if number > 0.0 {
                *centre = sum / number;
            }
        }
    }
    let lamp = |k: usize| {
        let own = || (0..pieces.len()).filter(|&i| owner[i] == k);
        let mut lamp = Lamp {
            centre: Vec3::ZERO,
            facing: Vec3::ZERO,
            area: 0.0,
            radiance: Vec3::ZERO,
            double_sided: false,
            radius: 0.0,
        };
        for i in own() {
            let [a, b, c] = pieces[i].corners;
            let facing = (b - a).cross(c - a) * 0.5;
            let area = facing.length();
            lamp.centre += places[i] * area;
            lamp.facing += facing;
            lamp.area += area;
            lamp.radiance += pieces[i].radiance * area;
            lamp.double_sided |= pieces[i].double_sided;
        }
        if lamp.area <= 0.0 {
            return None;
        }
        (lamp.centre, lamp.radiance) = (lamp.centre / lamp.area, lamp.radiance / lamp.area);
        for i in own() {
            for corner in pieces[i].corners {
                lamp.radius = lamp.radius.max(corner.distance(lamp.centre));
            }
        }
        (lamp.radiance != Vec3::ZERO).then_some(lamp)
    };
    (0..centres.len()).filter_map(lamp).collect()
}

/// The map through which a point looks at a lamp.
#[derive(Debug)]
pub(super) struct Window {
    free: [[bool; SIDE]; SIDE],
    known: [[bool; SIDE]; SIDE],
    wanted: Vec<(u8, u8)>,
    rays: Vec<Ray>,
    blocked: Vec<bool>,
}

impl Default for Window {
    fn default() -> Self {
        Self {
            free: [[false; SIDE]; SIDE],
            known: [[false; SIDE]; SIDE],
            wanted: Vec::new(),
            rays: Vec::new(),
            blocked: Vec::new(),
        }
    }
}

impl Window {
    /// The distance to the nearest edge, and rays.
    fn nearest_edge(
        &mut self,
        geometry: &Geometry,
        origin: Vec3,
        lamp: &Lamp,
        toward: Vec3,
        radius: f32,
    ) -> (f32, u64) {
        let texel = 2.0 * REACH / (SIDE - 1) as f32;
        let place = |k: usize| k as f32 * texel - REACH;
        self.known = [[false; SIDE]; SIDE];
        self.wanted.clear();
        for row in (0..SIDE).step_by(STEP) {
            for column in (0..SIDE).step_by(STEP) {
                self.wanted.push((row as u8, column as u8));
            }
        }
        let mut traced = self.trace(geometry, origin, lamp, toward, radius);
        // Blocks whose corners differ are traced whole; the others are as their corners.
        for row in (0..SIDE - 1).step_by(STEP) {
            for column in (0..SIDE - 1).step_by(STEP) {
                let corner = self.free[row][column];
                let alike = [(0, STEP), (STEP, 0), (STEP, STEP)]
                    .iter()
                    .all(|&(down, right)| self.free[row + down][column + right] == corner);
                for r in row..=row + STEP {
                    for c in column..=column + STEP {
                        if self.known[r][c] {
                            continue;
                        }
                        if alike {
                            self.free[r][c] = corner;
                        } else {
                            self.wanted.push((r as u8, c as u8));
                            self.known[r][c] = true;
                        }
                    }
                }
            }
        }
        traced += self.trace(geometry, origin, lamp, toward, radius);
        let centre = self.free[SIDE / 2][SIDE / 2];
        let mut nearest = REACH;
        for row in 0..SIDE {
            for column in 0..SIDE {
                let own = self.free[row][column];
                let (x, y) = (place(column), place(row));
                if column + 1 < SIDE && self.free[row][column + 1] != own {
                    nearest = nearest.min((x + 0.5 * texel).hypot(y));
                }
                if row + 1 < SIDE && self.free[row + 1][column] != own {
                    nearest = nearest.min(x.hypot(y + 0.5 * texel));
                }
            }
        }
        (if centre { nearest } else { -nearest }, traced)
    }

    /// Traces what is wanted.
    fn trace(
        &mut self,
        geometry: &Geometry,
        origin: Vec3,
        lamp: &Lamp,
        toward: Vec3,
        radius: f32,
    ) -> u64 {
        /// Rays end so far before the lamp, relative.
        const BEFORE: f32 = 1e-3;
        let (s, t) = toward.any_orthonormal_pair();
        let texel = 2.0 * REACH * radius / (SIDE - 1) as f32;
        let half = (SIDE / 2) as f32;
        let flat = lamp.facing.length() > 0.99 * lamp.area;
        let to = lamp.centre - origin;
        self.rays.clear();
        for &(row, column) in &self.wanted {
            let offset =
                s * ((f32::from(column) - half) * texel) + t * ((f32::from(row) - half) * texel);
            let step = to + offset;
            // Where the line meets the lamp's plane; of what is no plane, where it comes near.
            let end = if flat {
                let along = step.dot(lamp.facing);
                (to.dot(lamp.facing) / along).clamp(0.2, 4.0)
            } else {
                (1.0 - lamp.radius / to.length().max(1e-20)).max(0.1)
            };
            let end = if end.is_finite() { end } else { 1.0 };
            let mut ray = Ray::new(origin, step);
            ray.t_max = end * (1.0 - BEFORE);
            self.rays.push(ray);
        }
        self.blocked.clear();
        self.blocked.resize(self.rays.len(), false);
        geometry.occluded_batch(&self.rays, &mut self.blocked);
        for (&(row, column), blocked) in self.wanted.iter().zip(&self.blocked) {
            self.free[usize::from(row)][usize::from(column)] = !blocked;
            self.known[usize::from(row)][usize::from(column)] = true;
        }
        self.wanted.clear();
        self.rays.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(half: f32, height: f32) -> Vec<EmissivePart> {
        let corner = |x: f32, z: f32| Vec3::new(x * half, height, z * half);
        let [a, b, c, d] = [
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ];
        // Facing down.
        [[a, b, c], [a, c, d]]
            .map(|corners| EmissivePart {
                corners,
                radiance: Vec3::new(3.0, 2.0, 1.0),
                double_sided: false,
                mesh: 0,
            })
            .to_vec()
    }

    #[test]
    fn parts_are_the_whole() {
        let lamps = Lamps::new(square(0.6, 2.0)).unwrap();
        assert_eq!(lamps.len(), PARTS);
        let area: f32 = lamps.list.iter().map(|lamp| lamp.area).sum();
        assert!((area - 1.44).abs() < 1e-4);
        for lamp in &lamps.list {
            assert!(lamp.facing.y < 0.0 && lamp.radius < 0.6, "{lamp:?}");
            assert!((lamp.area - 0.36).abs() < 0.05, "{lamp:?}");
        }
        assert!(Lamps::new(vec![square(1.0, 1.0)[0]; 17]).is_none());
        assert_eq!(Lamps::new(Vec::new()).unwrap().len(), 0);
    }

    /// Unshadowed irradiance against a sum over small squares, the horizon in the way or not.
    #[test]
    fn irradiance_is_what_quadrature_says() {
        let lamps = Lamps::new(square(0.6, 2.0)).unwrap();
        for (position, normal) in [
            (Vec3::ZERO, Vec3::Y),
            (Vec3::new(1.0, 0.3, -0.5), Vec3::new(0.3, 0.9, 0.2)),
            (Vec3::new(0.5, 1.2, 0.0), Vec3::X),
        ] {
            let normal = normal.normalize();
            let n = 400;
            let mut expected = 0.0_f64;
            for i in 0..n * n {
                let cell = |k: i32| -0.6 + 1.2 * (k as f32 + 0.5) / n as f32;
                let to = Vec3::new(cell(i % n), 2.0, cell(i / n)) - position;
                let square = to.length_squared();
                let cosines = (to.dot(normal) * to.y).max(0.0) / square;
                expected += f64::from(cosines / square) * (1.2 / f64::from(n)).powi(2);
            }
            let mut seen = Vec::new();
            lamps.seen(position, normal, &[REACH; MOST], &mut seen);
            seen.iter_mut().for_each(|lamp| lamp.free = 1.0);
            let found = f64::from(lamps.irradiance(position, normal, &seen).x) / 3.0;
            assert!(
                (found - expected).abs() < 2e-3 * expected,
                "{found} {expected}"
            );
        }
    }

    /// A narrow glossy lobe that shows the lamp's middle sees its radiance, a wide one its part of the sphere.
    #[test]
    fn lobes_see_lamps() {
        let lamps = Lamps::new(square(0.1, 2.0)).unwrap();
        let mut seen = Vec::new();
        lamps.seen(Vec3::ZERO, Vec3::Y, &[REACH; MOST], &mut seen);
        let look = |axis, sharpness| lamps.in_lobe(Vec3::ZERO, Vec3::Y, &seen, axis, sharpness);
        let wide = look(Vec3::Y, 1.0);
        let solid = 0.04 / 4.0;
        assert!((wide.x / (3.0 * solid) - 1.0).abs() < 0.02, "{wide}");
        assert!(look(Vec3::X, 200.0).x < 1e-6);
        let narrow = look(Vec3::Y, 20_000.0).x * 20_000.0 / TAU;
        assert!((narrow / 3.0 - 1.0).abs() < 0.01, "{narrow}");
        // Whether a part is a lobe or its outline must not show: where that changes both say the same.
        for cos in [1.0_f32, 0.98, 0.95] {
            let axis = Vec3::new((1.0 - cos * cos).sqrt(), cos, 0.0);
            let round: f32 = seen.iter().map(|lamp| lamp.in_lobe(axis, 52.0)).sum();
            let outlined = look(axis, 52.0).x / 3.0;
            assert!(
                (round / outlined - 1.0).abs() < 0.02,
                "{cos}: {round} {outlined}"
            );
        }
    }

    #[test]
    fn half_of_a_disk_is_half() {
        assert_eq!(free_share(-1.5), 0.0);
        assert!((free_share(0.0) - 0.5).abs() < 1e-6);
        assert!((free_share(2.0) - 1.0).abs() < 1e-6);
        assert!((free_share(0.5) - 0.804_5).abs() < 1e-3);
    }
}
