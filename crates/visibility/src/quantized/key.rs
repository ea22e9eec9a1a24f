//! Cluster keys: which cell of which virtual grid an end lies in.
//!
//! Popov 2013, sections 3.3 to 3.5, with these corrections:
//!
//! * Eq. 4 rounds down and gives a `d_z` that is no unit vector. Here a normal's component is rounded to the nearest of
//!   `C_N + 1` values with `C_N` even, and `d_z` is normalised: a wall along an axis keeps that axis exactly, and noise of
//!   1e-6 in its normal does not split it into four orientations.
//! * Every grid is shifted by a hash of its orientation and resolution, so that planes at round coordinates do not lie on
//!   the faces of voxels.
//! * Light patches, and the thinning of eyes by picking one of many lights, are rounded to powers of two, not of `C_R`: a light
//!   sampled by solid angle has another density from every eye, and fine steps would give neighbouring eyes different keys.
//! * Eq. 9: the printed resolution is too small by 4 pi, see [`sky_resolution`].

use super::digest::{fold, mix};
use crate::LightEnd;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_2_PI, PI};

/// A ball around everything: the unit of resolution. Keep it the same over an animation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingSphere {
    /// Centre, world space.
    pub centre: Vec3,
    /// Radius, metres.
    pub radius: f32,
}

impl BoundingSphere {
    /// The ball around a box.
    pub fn around(min: Vec3, max: Vec3) -> Self {
        Self {
            centre: 0.5 * min + 0.5 * max,
            radius: (0.5 * max - 0.5 * min).length(),
        }
    }
}

/// The cell of a surface point: seven integers, fixed by position, normal and resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cell {
    /// Number of the grid's orientation.
    pub orientation: u32,
    /// Voxels along the diameter of the bounding sphere.
    pub resolution: u32,
    /// Voxel coordinates; `z` counts along the normal.
    pub voxel: [i64; 3],
}

impl Cell {
    /// The four voxels beside this one along the surface.
    pub fn neighbours(self) -> [Self; 4] {
        [(1, 0), (0, 1), (-1, 0), (0, -1)].map(|(x, y)| {
            let [a, b, c] = self.voxel;
            Self {
                voxel: [a.wrapping_add(x), b.wrapping_add(y), c],
                ..self
            }
        })
    }

    /// The voxels above and below.
    pub fn above_and_below(self) -> [Self; 2] {
        [1, -1].map(|up| {
            let [x, y, z] = self.voxel;
            Self {
                voxel: [x, y, z.wrapping_add(up)],
                ..self
            }
        })
    }

    /// The hash of all seven integers: one half of a separable key. All bits depend on all integers.
    pub fn half(self) -> u64 {
        let grid = u64::from(self.orientation) << 32 | u64::from(self.resolution);
        let [x, y, z] = self.voxel.map(|v| v as u64);
        mix(fold(fold(grid, z), x), y)
    }

    /// The integers one by one, as the paper's digests take them.
    pub fn words(self) -> [u32; 7] {
        let [x, y, z] = self.voxel.map(|v| v as u32);
        let o = self.orientation;
        [o & 0xff, o >> 8 & 0xff, o >> 16, x, y, z, self.resolution]
    }
}

/// The light half of a key: one of the four kinds of light end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LightKey {
    Point([u32; 3]),
    Direction([u32; 3]),
    Surface(Cell),
    SolidAngle { cell: [u32; 2], resolution: u32 },
}

impl LightKey {
    /// The hash of the light half.
    pub fn half(self) -> u64 {
        let three = |kind: u64, [x, y, z]: [u32; 3]| {
            mix(fold(kind, u64::from(z)), u64::from(x) << 32 | u64::from(y))
        };
        match self {
            Self::Point(bits) => three(0, bits),
            Self::Direction(bits) => three(1, bits),
            Self::Surface(cell) => mix(2, cell.half()),
            Self::SolidAngle {
                cell: [x, y],
                resolution,
            } => three(3, [x, y, resolution]),
        }
    }

    /// The kind and the integers, as the paper's digests take them; how many depends on the kind.
    pub fn words(self) -> ([u32; 8], usize) {
        let mut words = [0; 8];
        let count = match self {
            Self::Point(bits) | Self::Direction(bits) => {
                words[0] = u32::from(matches!(self, Self::Direction(_)));
                words[1..4].copy_from_slice(&bits);
                4
            }
            Self::Surface(cell) => {
                words[0] = 2;
                words[1..8].copy_from_slice(&cell.words());
                8
            }
            Self::SolidAngle { cell, resolution } => {
                words[..4].copy_from_slice(&[3, cell[0], cell[1], resolution]);
                4
            }
        };
        (words, count)
    }
}

/// The name of a light that many eyes ask about: its exact place. `None` if it has none.
///
/// Unlike the ends of single questions, which never come back, such a light needs no patch to be asked about often. And it must have none: by
/// Eq. 9 a sky of 256 samples has patches of 13 degrees, where a window's light falls elsewhere for every direction.
pub(super) fn light_name(end: &LightEnd) -> Option<u64> {
    let three = |kind: u64, at: Vec3| {
        let [x, y, z] = at.to_array().map(|v| u64::from(v.to_bits()));
        at.is_finite().then(|| mix(fold(kind, z), x << 32 | y))
    };
    match end {
        LightEnd::Point(position) => three(0, *position),
        LightEnd::Direction(direction) => three(1, *direction),
        LightEnd::Surface(end) => Some(mix(three(2, end.position)?, three(2, end.normal)?)),
        LightEnd::SolidAngle { direction, .. } => three(3, *direction),
    }
}

/// The virtual grids of one scene.
#[derive(Clone, Debug)]
pub(super) struct Grids {
    centre: Vec3,
    diameter: f32,
    /// Finer voxels than this would be noise of floating point.
    finest: f32,
    normals: u32,
    slab: f32,
    steps: Steps,
    /// Axes of each orientation: X, Y and `d_z`.
    frames: Vec<[Vec3; 3]>,
}

impl Grids {
    /// Grids with `normals` (`C_N`, even) orientations along each axis and voxels `slab` (`C_Z`) times finer along the
    /// normal, of resolutions that are powers of `step` (`C_R`).
    pub fn new(bounds: BoundingSphere, normals: u32, slab: f32, step: f32) -> Self {
        let diameter = (2.0 * bounds.radius).max(f32::MIN_POSITIVE);
        let farthest = bounds.centre.abs().max_element() + bounds.radius;
        // A voxel's height, diameter / (slab * R), spans at least 8 roundings of a coordinate.
        let finest = (diameter / (slab * farthest * 8.0 * f32::EPSILON)).clamp(1.0, 1e7);
        let side = normals + 1;
        let frames = (0..side * side * side)
            .map(|code| {
                let q = Vec3::new(
                    (code % side) as f32,
                    (code / side % side) as f32,
                    (code / side / side) as f32,
                );
                let z = (2.0 / normals as f32 * q - 1.0).normalize_or(Vec3::Z);
                let (x, y) = z.any_orthonormal_pair();
                [x, y, z]
            })
            .collect();
        Self {
            centre: bounds.centre,
            diameter,
            finest,
            normals,
            slab,
            steps: Steps::new(step, finest),
            frames,
        }
    }

    /// Number of the orientation nearest to a unit normal (Eq. 4, corrected), `None` if the normal is none.
    pub fn orientation(&self, normal: Vec3) -> Option<u32> {
        let length = normal.length_squared();
        if !(0.5..2.0).contains(&length) {
            return None;
        }
        let q = ((normal + 1.0) * (0.5 * self.normals as f32) + 0.5)
            .clamp(Vec3::ZERO, Vec3::splat(self.normals as f32))
            .as_uvec3();
        let side = self.normals + 1;
        Some(q.x + side * (q.y + side * q.z))
    }

    /// Resolution of patches that hold `1 / density` square metres (Eqs. 5 and 7): the patch is one voxel wide.
    pub fn resolution(&self, density: f32) -> f32 {
        self.diameter * density.sqrt()
    }

    /// Resolution of both patches of a pair (Eq. 6, with the fourth root that the exponent means): `|A|^2` is
    /// `1 / density`, with `density` the product of both ends' densities, connections counted.
    pub fn pair_resolution(&self, density: f32) -> f32 {
        self.diameter * density.sqrt().sqrt()
    }

    /// Eq. 8: the nearest whole power of `C_R`, rounded down to whole voxels; at least 1 and no finer than floats are.
    pub fn quantize(&self, resolution: f32) -> u32 {
        self.steps.nearest(resolution.clamp(1.0, self.finest))
    }

    /// The same for light patches, in powers of two.
    pub fn quantize_light(&self, resolution: f32) -> u32 {
        nearest_power_of_two(resolution.clamp(1.0, self.finest)).min(self.finest) as u32
    }

    /// The cell of a surface point in the grid of an orientation and a quantized resolution.
    pub fn cell(&self, position: Vec3, orientation: u32, resolution: u32) -> Cell {
        let [x, y, z] = self.frames[orientation as usize];
        let shift = Shift::of(orientation, resolution);
        let from_centre = position - self.centre;
        let scale = resolution as f32 / self.diameter;
        let voxel = [
            floor(from_centre.dot(x) * scale + shift.along(0)),
            floor(from_centre.dot(y) * scale + shift.along(16)),
            floor(from_centre.dot(z) * scale * self.slab + shift.along(32)),
        ];
        Cell {
            orientation,
            resolution,
            voxel,
        }
    }

    /// The middle of a cell, world space.
    pub fn middle(&self, cell: &Cell) -> Vec3 {
        let [x, y, z] = self.frames[cell.orientation as usize];
        let shift = Shift::of(cell.orientation, cell.resolution);
        let along = |axis: usize, bits: u32| cell.voxel[axis] as f32 + 0.5 - shift.along(bits);
        let size = self.diameter / cell.resolution as f32;
        let flat = x * along(0, 0) + y * along(1, 16);
        self.centre + (flat + z * (along(2, 32) / self.slab)) * size
    }

    /// The resolutions beside a quantized one: the coarser, and the finer.
    pub fn beside(&self, resolution: u32) -> [u32; 2] {
        self.steps.beside(resolution)
    }

    /// The key of a direction sampled with `density` per steradian times connections: the cell of an equal-area map of the
    /// sphere.
    pub fn solid_angle(&self, direction: Vec3, density: f32) -> LightKey {
        let resolution = self.quantize_light(sky_resolution(density));
        let last = resolution - 1;
        let place = equal_area_square(direction) * resolution as f32;
        LightKey::SolidAngle {
            cell: [(place.x as u32).min(last), (place.y as u32).min(last)],
            resolution,
        }
    }
}

/// By how much a grid is shifted against its centre, voxels along each axis.
struct Shift(u64);

impl Shift {
    fn of(orientation: u32, resolution: u32) -> Self {
        Self(mix(
            u64::from(orientation) << 32 | u64::from(resolution),
            0x243f_6a88_85a3_08d3,
        ))
    }

    /// The axis is given by its bits: 0, 16 or 32.
    fn along(&self, bits: u32) -> f32 {
        (self.0 >> bits & 0xffff) as f32 * (1.0 / 65536.0)
    }
}

/// The whole number below, without a call on processors that have no instruction for it.
fn floor(x: f32) -> i64 {
    let truncated = x as i64;
    truncated - i64::from(truncated as f32 > x)
}

/// The whole powers of `C_R`, and which of them is nearest: Eq. 8 without logarithms.
#[derive(Clone, Debug)]
struct Steps {
    /// The powers, rounded down to whole voxels.
    resolutions: Vec<u32>,
    /// Below which resolution each power is the nearest by ratio; infinite for the last.
    ends: Vec<f32>,
    /// The power nearest to the smallest number of each bin; bins are numbers alike in their upper bits.
    first: Vec<u16>,
}

impl Steps {
    /// Bits of a float that tell no bins apart: each spans 1/32 of its octave.
    const LOWER: u32 = 18;

    /// All powers of `step` from 1 to `finest`, at least 1.
    fn new(step: f32, finest: f32) -> Self {
        let step = f64::from(step).ln();
        let last = (f64::from(finest).ln() / step).round() as usize;
        let power = |k: usize| (k as f64 * step).exp().clamp(1.0, f64::from(finest)) as u32;
        let end = |k: usize| ((k as f64 + 0.5) * step).exp() as f32;
        let ends = (0..last).map(end).chain([f32::INFINITY]);
        let mut steps = Self {
            resolutions: (0..=last).map(power).collect(),
            ends: ends.collect(),
            first: Vec::new(),
        };
        let mut nearest = 0;
        for bin in Self::bin(1.0)..=Self::bin(finest) {
            let smallest = f32::from_bits(bin << Self::LOWER);
            while smallest >= steps.ends[nearest] {
                nearest += 1;
            }
            steps.first.push(nearest as u16);
        }
        steps
    }

    fn bin(x: f32) -> u32 {
        x.to_bits() >> Self::LOWER
    }

    /// The powers below and above one of them, or itself at the ends.
    fn beside(&self, resolution: u32) -> [u32; 2] {
        let below = self
            .resolutions
            .partition_point(|&other| other < resolution);
        let above = self
            .resolutions
            .partition_point(|&other| other <= resolution);
        let power = |k: usize| self.resolutions.get(k).copied().unwrap_or(resolution);
        [power(below.wrapping_sub(1)), power(above)]
    }

    /// The power nearest to a resolution from 1 to the finest.
    fn nearest(&self, resolution: f32) -> u32 {
        let bin = Self::bin(resolution).wrapping_sub(Self::bin(1.0));
        let Some(&first) = self.first.get(bin as usize) else {
            // Not in the range: no number.
            return 1;
        };
        let mut power = usize::from(first);
        while resolution >= self.ends[power] {
            power += 1;
        }
        self.resolutions[power]
    }
}

/// `x` rounded to a power of two.
pub(super) fn nearest_power_of_two(x: f32) -> f32 {
    x.log2().round().exp2()
}

/// Eq. 9, corrected: a cell of an R x R equal-area map of the sphere covers `4 pi / R^2` steradians, and it must hold one
/// sample of a technique with `density` samples per steradian (`P(w) N_P / N_S`), so `R = sqrt(4 pi density)`.
fn sky_resolution(density: f32) -> f32 {
    (4.0 * PI * density).sqrt()
}

/// The equal-area octahedral map of unit vectors to the unit square (Clarberg 2008, "Fast equal-area mapping of the
/// (hemi)sphere using SIMD"): the plain octahedral map's cells differ by a factor of five.
pub(super) fn equal_area_square(direction: Vec3) -> Vec2 {
    let d = direction.abs();
    let r = (1.0 - d.z).max(0.0).sqrt();
    let phi = if d.x + d.y > 0.0 {
        d.y.atan2(d.x) * FRAC_2_PI
    } else {
        0.0
    };
    let v = phi * r;
    let u = r - v;
    let (u, v) = if direction.z < 0.0 {
        (1.0 - v, 1.0 - u)
    } else {
        (u, v)
    };
    Vec2::new(u.copysign(direction.x), v.copysign(direction.y)) * 0.5 + 0.5
}
