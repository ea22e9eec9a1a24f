//! Signed angular distances over a hemisphere.

use super::gaussian::truncate;
use super::hemisphere::{Hemisphere, angles};
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};

/// For each direction above a surface point the angle to the nearest edge of visibility: positive where the direction is free.
///
/// Angles are stored in 16 bits, evenly over `[-pi, pi]`: a step is 1e-4 rad everywhere, where a half float's would be 1e-3 at 1 rad, and
/// reading takes one multiplication on any processor. [`packed`](Self::packed), the field of 128 texels takes 4 KiB instead of 32.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DistanceField {
    side: u32,
    values: Values,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Values {
    /// In steps of [`STEP`].
    Whole(Vec<i16>),
    /// Signed roots: fine near 0, where shadows have their edges.
    Packed(Vec<i8>),
}

impl Default for Values {
    fn default() -> Self {
        Self::Whole(Vec::new())
    }
}

/// Radians of a step.
const STEP: f32 = PI / i16::MAX as f32;
/// Radians of a root of 1.
const ROOT_STEP: f32 = PI / (i8::MAX as f32 * i8::MAX as f32);

#[inline(always)]
fn unpack(value: i8) -> f32 {
    let root = f32::from(value);
    root * root.abs() * ROOT_STEP
}

impl DistanceField {
    #[inline(always)]
    pub(super) fn encode(distance: f32) -> i16 {
        // Adding a large number rounds and leaves the whole number in the lowest bits: no conversion that checks its range.
        const MAGIC: f32 = 12_582_912.0;
        (distance * (1.0 / STEP) + MAGIC).to_bits() as i16
    }

    /// Its numbers, row after row, once it has `side` texels along a side and is not packed.
    pub(super) fn values_mut(&mut self, side: u32) -> &mut [i16] {
        self.side = side;
        if let Values::Packed(_) = self.values {
            self.values = Values::default();
        }
        let Values::Whole(values) = &mut self.values else {
            return &mut [];
        };
        values.resize(side as usize * side as usize, 0);
        values
    }

    /// An eighth of the bytes: half as many texels along a side, each the mean of four, as roots of eight bits. Distances are less than a texel of
    /// the whole field off but where a texel's four neighbours have different nearest edges. A packed field is returned as it is.
    pub fn packed(&self) -> Self {
        let Values::Whole(_) = self.values else {
            return self.clone();
        };
        let half = self.side as usize / 2;
        let pack = |i: usize| {
            let (row, column) = (i / half * 2, i % half * 2);
            let sum = self.get(row, column)
                + self.get(row, column + 1)
                + self.get(row + 1, column)
                + self.get(row + 1, column + 1);
            let root = (0.25 * sum.abs() / ROOT_STEP).sqrt().copysign(sum);
            root.round().clamp(-127.0, 127.0) as i8
        };
        Self {
            side: half as u32,
            values: Values::Packed((0..half * half).map(pack).collect()),
        }
    }

    /// Texels along a side.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// Bytes that the distances take.
    pub fn bytes(&self) -> usize {
        match &self.values {
            Values::Whole(values) => size_of_val(&values[..]),
            Values::Packed(values) => values.len(),
        }
    }

    /// The distance at a texel's centre, radians.
    ///
    /// # Panics
    /// If it lies outside.
    #[inline]
    pub fn get(&self, row: usize, column: usize) -> f32 {
        let at = row * self.side as usize + column;
        match &self.values {
            Values::Whole(values) => f32::from(values[at]) * STEP,
            Values::Packed(values) => unpack(values[at]),
        }
    }

    /// The distance in a world-space direction, bilinear between texel centres.
    ///
    /// Below the horizon, where no light comes from, it goes on falling: by the angle to the horizon, below what the rim says.
    pub fn at(&self, hemisphere: &Hemisphere, w: Vec3) -> f32 {
        let local = hemisphere.to_local(w);
        if local.y < 0.0 {
            let below = local.y.max(-1.0).asin();
            let level = Vec3::new(local.x, 0.0, local.z);
            let rim = level.try_normalize().unwrap_or(Vec3::X);
            return self.inside(rim).min(0.0) + below;
        }
        self.inside(local)
    }

    /// [`at`](Self::at) for eight directions, given by component.
    #[inline(always)]
    pub fn at_eight(&self, hemisphere: &Hemisphere, w: &[[f32; 8]; 3]) -> [f32; 8] {
        let side = self.side as usize;
        let (scale, last) = (side as f32 / PI, (side - 1) as f32 - 1e-3);
        let along = |axis: Vec3| -> [f32; 8] {
            std::array::from_fn(|k| axis.x * w[0][k] + axis.y * w[1][k] + axis.z * w[2][k])
        };
        let (x, y, z) = (
            along(hemisphere.side),
            along(hemisphere.normal),
            along(hemisphere.pole),
        );
        let (mut rows, mut columns, mut below) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        for k in 0..8 {
            // Below the horizon the rim under the direction speaks. Without branches: vector units take eight at a time.
            let level = if y[k] > 0.0 { y[k] } else { 0.0 };
            let flat = x[k] * x[k] + level * level;
            let theta = roughly_acos(z[k] / (flat + z[k] * z[k] + 1e-24).sqrt());
            let phi = roughly_acos(x[k] / (flat + 1e-24).sqrt());
            below[k] = FRAC_PI_2 - roughly_acos(if y[k] < 0.0 { y[k] } else { 0.0 });
            let place = |angle: f32| {
                let x = angle * scale - 0.5;
                let x = if x > 0.0 { x } else { 0.0 };
                if x < last { x } else { last }
            };
            (rows[k], columns[k]) = (place(theta), place(phi));
        }
        let (mut at, mut u, mut v) = ([0_u32; 8], [0.0; 8], [0.0; 8]);
        for k in 0..8 {
            let (row, column) = (truncate(rows[k]), truncate(columns[k]));
            (v[k], u[k]) = (rows[k] - row as f32, columns[k] - column as f32);
            at[k] = row * self.side + column;
        }
        let side = side as u32;
        let corners = [
            at,
            at.map(|at| at + 1),
            at.map(|at| at + side),
            at.map(|at| at + side + 1),
        ];
        let corners = match &self.values {
            Values::Whole(values) => corners.map(|at| read(values, &at, |v| f32::from(v) * STEP)),
            Values::Packed(values) => corners.map(|at| read(values, &at, unpack)),
        };
        let mut out = [0.0; 8];
        for k in 0..8 {
            let upper = corners[0][k] + (corners[1][k] - corners[0][k]) * u[k];
            let lower = corners[2][k] + (corners[3][k] - corners[2][k]) * u[k];
            let inside = upper + (lower - upper) * v[k];
            let most = if below[k] < 0.0 { 0.0 } else { PI };
            let inside = if inside < most { inside } else { most };
            out[k] = inside + below[k];
        }
        out
    }

    fn inside(&self, local: Vec3) -> f32 {
        let side = self.side as usize;
        let (theta, phi) = angles(local);
        let scale = side as f32 / PI;
        let place = |angle: f32| {
            let x = (angle * scale - 0.5).clamp(0.0, (side - 1) as f32);
            let i = (x as usize).min(side - 2);
            (i, x - i as f32)
        };
        let ((row, y), (column, x)) = (place(theta), place(phi));
        let along = |row: usize| {
            let a = self.get(row, column);
            a + (self.get(row, column + 1) - a) * x
        };
        let (upper, lower) = (along(row), along(row + 1));
        upper + (lower - upper) * y
    }

    /// The distance of a direction at a height (sine of elevation) over an empty surface: the angle to the horizon.
    #[inline]
    pub fn of_horizon(height: f32) -> f32 {
        if height.abs() < 1.0 {
            height.asin()
        } else {
            FRAC_PI_2.copysign(height)
        }
    }
}

/// The numbers at these places.
#[inline(always)]
fn read<T: Copy>(values: &[T], at: &[u32; 8], decode: impl Fn(T) -> f32) -> [f32; 8] {
    // One test for all eight.
    let largest = at.iter().fold(0, |a, &b| if a > b { a } else { b });
    assert!((largest as usize) < values.len());
    // SAFETY: no place lies behind the largest.
    at.map(|at| decode(unsafe { *values.get_unchecked(at as usize) }))
}

/// The arc cosine of a number in `[-1, 1]`, wrong by less than 7e-5, half a step of the numbers that are read with it (Abramowitz & Stegun 1964,
/// 4.4.45).
#[inline(always)]
fn roughly_acos(x: f32) -> f32 {
    let a = x.abs();
    let a = if a < 1.0 { a } else { 1.0 };
    let p = ((-0.018_729_3 * a + 0.074_261) * a - 0.212_114_4) * a + 1.570_728_8;
    let r = (1.0 - a).sqrt() * p;
    FRAC_PI_2 - (FRAC_PI_2 - r).copysign(x)
}

#[cfg(test)]
mod tests {
    use super::super::{DistanceTransform, VisibilityMap};
    use super::*;

    #[test]
    fn eight_at_once_are_eight() {
        let h = Hemisphere::new(Vec3::new(0.5, 0.7, -0.2).normalize(), Vec3::X);
        let map = VisibilityMap::from_fn(64, |w| (w.x * 5.0).sin() + w.z > 0.2);
        let field = DistanceTransform::default().transform(&map);
        for i in 0..400 {
            let w: [Vec3; 8] = std::array::from_fn(|k| {
                let a = (i * 8 + k) as f32;
                let z = 1.0 - 2.0 * ((a + 0.5) / 3200.0);
                let r = (1.0 - z * z).sqrt();
                Vec3::new(r * (a * 2.4).cos(), r * (a * 2.4).sin(), z)
            });
            let columns = [w.map(|w| w.x), w.map(|w| w.y), w.map(|w| w.z)];
            let eight = field.at_eight(&h, &columns);
            for (w, got) in w.iter().zip(eight) {
                let one = field.at(&h, *w);
                assert!((one - got).abs() < 2e-4, "{w}: {one} {got}");
            }
        }
    }

    /// Packed, distances are off by less than a texel on the whole, and by little near the edges, where shadows are.
    #[test]
    fn packed_fields_are_nearly_whole() {
        let h = Hemisphere::new(Vec3::new(0.5, 0.7, -0.2).normalize(), Vec3::X);
        let map = VisibilityMap::from_fn(128, |w| (w.x * 5.0).sin() + w.z > 0.2);
        let whole = DistanceTransform::default().transform(&map);
        let packed = whole.packed();
        assert_eq!((packed.bytes(), packed.side()), (4096, 64));
        assert_eq!(packed.packed(), packed);
        let (mut all, mut near, mut count) = (0.0, 0.0, 0.0);
        for i in 0..4000 {
            let y = (i as f32 + 0.5) / 4000.0;
            let r = (1.0 - y * y).sqrt();
            let local = Vec3::new(r * (i as f32 * 2.4).cos(), y, r * (i as f32 * 2.4).sin());
            let w = h.to_world(local);
            let (a, b) = (whole.at(&h, w), packed.at(&h, w));
            let columns = w.to_array().map(|v| [v; 8]);
            assert!((packed.at_eight(&h, &columns)[3] - b).abs() < 3e-4);
            all += (a - b).powi(2);
            if a.abs() < 0.1 {
                near += (a - b).powi(2);
                count += 1.0;
            }
        }
        let (all, near) = ((all / 4000.0).sqrt(), (near / count).sqrt());
        assert!(all < PI / 128.0 && near < 0.4 * PI / 128.0, "{all} {near}");
    }

    #[test]
    fn angles_survive_sixteen_bits() {
        for i in -1000..=1000 {
            let d = i as f32 * PI / 1000.0;
            assert!((f32::from(DistanceField::encode(d)) * STEP - d).abs() <= 0.51 * STEP);
        }
    }

    /// An empty hemisphere in a tilted frame: the angle to the horizon, above and below.
    #[test]
    fn of_an_empty_hemisphere_it_is_the_elevation() {
        let h = Hemisphere::new(Vec3::new(0.5, 0.7, -0.2).normalize(), Vec3::X);
        let field = DistanceTransform::default().transform(&VisibilityMap::new(64, true));
        for i in 0..500 {
            let a = i as f32 * 0.618_034;
            let z = 1.0 - 2.0 * ((i as f32 + 0.5) / 500.0);
            let r = (1.0 - z * z).sqrt();
            let w = Vec3::new(r * (a * 9.0).cos(), r * (a * 9.0).sin(), z);
            let error = field.at(&h, w) - DistanceField::of_horizon(h.normal.dot(w));
            // Half a texel at the rim, where there is no centre to interpolate from.
            assert!(error.abs() < 0.04, "{w}: {error}");
        }
    }
}
