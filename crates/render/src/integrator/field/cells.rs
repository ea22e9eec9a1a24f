//! What of a lobe a pixel sees, by cells of its field (Wang et al. 2013, Eq. 5): no hemisphere approximation, and no hurry.
//!
//! The wrong tool for frames: every cell of the field is visited for every product of lobes. It is there to be compared with (`--cells`).

use super::points::Points;
use super::sky::Sky;
use glam::Vec3;
use occlude_visibility::field::{
    Distances, Hemisphere, SphericalGaussian, Weight, visible_integral,
};
use std::cell::RefCell;

/// The field of a pixel: that of the points around it, read where it is needed.
#[derive(Debug, Default)]
pub(super) struct Cells {
    side: u32,
    hemisphere: Option<Hemisphere>,
    near: Vec<(u32, f32)>,
    /// Distances that are known; NaN: not yet.
    known: RefCell<Vec<f32>>,
}

/// [`Cells`] with the points that it reads from.
struct Reading<'a> {
    cells: &'a Cells,
    hemisphere: &'a Hemisphere,
    points: &'a Points,
}

impl Distances for Reading<'_> {
    fn side(&self) -> u32 {
        self.cells.side
    }

    fn get(&self, row: usize, column: usize) -> f32 {
        let at = row * self.cells.side as usize + column;
        let known = self.cells.known.borrow()[at];
        if !known.is_nan() {
            return known;
        }
        let w = self
            .hemisphere
            .to_world(Hemisphere::texel(self.cells.side, row, column));
        let read = |&(id, weight): &(u32, f32)| {
            let point = &self.points.list[id as usize];
            point.field.at(&point.hemisphere, w) * weight
        };
        let distance = self.cells.near.iter().map(read).sum();
        self.cells.known.borrow_mut()[at] = distance;
        distance
    }
}

impl Cells {
    /// Begins a pixel with its unit normal and the points that speak for it.
    pub(super) fn set(&mut self, points: &Points, normal: Vec3, near: &[(u32, f32)]) {
        self.near.clear();
        self.near.extend_from_slice(near);
        let side = near
            .iter()
            .map(|&(id, _)| points.list[id as usize].field.side());
        self.side = side.max().unwrap_or(0);
        self.hemisphere = Some(Hemisphere::new(normal, normal.any_orthonormal_vector()));
        let known = self.known.get_mut();
        known.clear();
        known.resize((self.side * self.side) as usize, f32::NAN);
    }

    fn integrate(&self, points: &Points, axis: Vec3, sharpness: f32, weight: Weight) -> f32 {
        match &self.hemisphere {
            Some(hemisphere) if self.side > 0 => {
                let reading = Reading {
                    cells: self,
                    hemisphere,
                    points,
                };
                visible_integral(&reading, hemisphere, axis, sharpness, weight)
            }
            _ => 0.0,
        }
    }

    /// Irradiance from the sky's lobes.
    pub(super) fn irradiance(&self, points: &Points, sky: &Sky) -> Vec3 {
        let lobes = (0..sky.len()).map(|k| sky.lobe(k));
        let lit = lobes.filter(|lobe| lobe.amplitude != Vec3::ZERO);
        lit.map(|lobe| {
            lobe.amplitude * self.integrate(points, lobe.axis, lobe.sharpness, Weight::Cosine)
        })
        .sum()
    }

    /// The integral of the sky's lobes times a lobe of amplitude 1; and `rest`, the same of what the sky has beside them were nothing in the way, times
    /// the share of the lobe that is visible.
    pub(super) fn in_lobe(
        &self,
        points: &Points,
        sky: &Sky,
        axis: Vec3,
        sharpness: f32,
        rest: Vec3,
    ) -> Vec3 {
        /// What brings less than this share is left out.
        const NEGLIGIBLE: f32 = 1e-3;
        let own = SphericalGaussian {
            axis,
            sharpness,
            amplitude: Vec3::ONE,
        };
        let products: Vec<SphericalGaussian> =
            (0..sky.len()).map(|k| sky.lobe(k).product(&own)).collect();
        let whole: f32 = products.iter().map(|p| p.integral().element_sum()).sum();
        let matter = |p: &&SphericalGaussian| p.integral().element_sum() > NEGLIGIBLE * whole;
        let seen = products.iter().filter(matter).map(|product| {
            product.amplitude * self.integrate(points, product.axis, product.sharpness, Weight::One)
        });
        let mut sum: Vec3 = seen.sum();
        if rest != Vec3::ZERO {
            let free = self.integrate(points, axis, sharpness, Weight::One);
            sum += rest * (free / SphericalGaussian::unit_integral(sharpness));
        }
        sum
    }
}
