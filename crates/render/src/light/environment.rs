//! The sky: constant, or a lat-long map that is sampled by its brightness.
//!
//! A map is looked up bilinearly and sampled by a distribution that is constant over cells of the size of a texel (of a few
//! texels in very large maps): a cell's mass is the mean luminance of the bilinear function over it times its solid angle.
//! A place in a cell is then picked uniformly in solid angle, so that the poles need no special case. The density is exact,
//! and it is positive wherever the map is.
//!
//! Row 0 is +Y; the column in the middle of the image lies along +X, columns grow towards +Z.

use super::distribution::{Distribution, fill, mass, pick, place, probability};
use super::luminance;
use glam::{Vec2, Vec3};
use occlude_image::Picture;
use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::sync::Arc;

/// A sky: constant, or a lat-long map that is sampled by its brightness.
#[derive(Clone, Debug)]
pub struct Environment {
    pub(super) kind: Kind,
}

#[derive(Clone, Debug)]
pub(super) enum Kind {
    Constant(Vec3),
    Map(Arc<Map>),
}

/// Columns of the sampling distribution at most; larger maps put several texels into one cell.
const MOST_COLUMNS: usize = 4096;

#[derive(Clone, Debug)]
pub(super) struct Map {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) pixels: Vec<[f32; 3]>,
    pub(super) rotation_sin: f32,
    pub(super) rotation_cos: f32,
    /// Texels along the side of a cell.
    cell: usize,
    columns: usize,
    /// Which row of cells.
    rows: Distribution,
    /// Which cell of a row: cumulative masses and guide table of [`Distribution`], row after row.
    before: Vec<u32>,
    guide: Vec<u32>,
    /// By row of cells: the density per steradian of a cell is this times its mass within the row.
    row_density: Vec<f32>,
    /// Cosines of the polar angles between rows of cells, from 1 to -1. Near the poles single precision would not do.
    row_edges: Vec<f64>,
    /// Integral of the radiance over all directions.
    pub(super) integral: Vec3,
}

impl Environment {
    /// The same radiance from everywhere. Components that are negative or not finite count as zero.
    pub fn constant(radiance: Vec3) -> Self {
        let clean = Vec3::from_array(
            radiance
                .to_array()
                .map(|c| if c.is_finite() { c.max(0.0) } else { 0.0 }),
        );
        Self {
            kind: Kind::Constant(clean),
        }
    }

    /// A lat-long map of linear radiance: the top row is +Y, the middle of a row lies along +X, and columns grow towards
    /// +Z. `rotation` turns the sky about +Y, counterclockwise seen from above, in radians; radiance is multiplied by `scale`.
    ///
    /// Values that are negative or no number count as 0, infinite ones as the largest finite one. A picture without
    /// pixels, or with fewer than it says, is black.
    pub fn from_picture(picture: &Picture, rotation: f32, scale: f32) -> Self {
        let rotation = if rotation.is_finite() { rotation } else { 0.0 };
        let (width, height) = (picture.width as usize, picture.height as usize);
        let count = width
            .checked_mul(height)
            .filter(|&n| n > 0 && n <= picture.pixels.len());
        let map = count
            .and_then(|n| Map::new(width, height, clean(&picture.pixels[..n], scale), rotation));
        match map {
            Some(map) => Self {
                kind: Kind::Map(Arc::new(map)),
            },
            None => Self::constant(Vec3::ZERO),
        }
    }

    /// Radiance seen along the unit vector `wi`.
    pub fn radiance(&self, wi: Vec3) -> Vec3 {
        match &self.kind {
            Kind::Constant(radiance) => *radiance,
            Kind::Map(map) => map.radiance(wi),
        }
    }

    /// Whether no light comes from it.
    pub fn is_black(&self) -> bool {
        self.integral() == Vec3::ZERO
    }

    /// The integral of the radiance over all directions.
    pub fn integral(&self) -> Vec3 {
        match &self.kind {
            Kind::Constant(radiance) => *radiance * (4.0 * PI),
            Kind::Map(map) => map.integral,
        }
    }

    /// A direction, in proportion to what arrives from there: of a constant sky by the cosine with `normal`, if that is
    /// not zero. `None` if the sky is black.
    pub fn sample(&self, normal: Vec3, u: Vec2) -> Option<Vec3> {
        match &self.kind {
            Kind::Constant(radiance) if *radiance == Vec3::ZERO => None,
            Kind::Constant(_) if normal == Vec3::ZERO => Some(uniform_sphere(u)),
            Kind::Constant(_) => {
                // A point on the unit sphere around the tip of the normal, seen from the tail, is distributed by the cosine.
                let wi = (normal + uniform_sphere(u)).normalize_or_zero();
                (wi != Vec3::ZERO).then_some(wi)
            }
            Kind::Map(map) => Some(map.sample(u)),
        }
    }

    /// Density of [`Environment::sample`] per steradian.
    pub fn pdf(&self, normal: Vec3, wi: Vec3) -> f32 {
        match &self.kind {
            Kind::Constant(radiance) if *radiance == Vec3::ZERO => 0.0,
            Kind::Constant(_) if normal == Vec3::ZERO => 0.25 * FRAC_1_PI,
            Kind::Constant(_) => normal.dot(wi).max(0.0) * FRAC_1_PI,
            Kind::Map(map) => map.pdf(wi),
        }
    }
}

fn uniform_sphere(u: Vec2) -> Vec3 {
    let y = 1.0 - 2.0 * u.x;
    let radius = (4.0 * u.x * (1.0 - u.x)).max(0.0).sqrt();
    let (sin, cos) = (TAU * u.y).sin_cos();
    Vec3::new(radius * cos, y, radius * sin)
}

fn clean(pixels: &[[f32; 3]], scale: f32) -> Vec<[f32; 3]> {
    let scaled = |c: &f32| c * scale;
    let largest = pixels
        .iter()
        .flatten()
        .map(scaled)
        .filter(|c| c.is_finite())
        .fold(0.0, f32::max);
    let one = |c: &f32| {
        let c = scaled(c);
        if c.is_nan() {
            0.0
        } else {
            c.clamp(0.0, largest)
        }
    };
    pixels
        .iter()
        .map(|p| [one(&p[0]), one(&p[1]), one(&p[2])])
        .collect()
}

/// Cosine of the polar angle of the upper edge of a row of texels.
pub(super) fn cos_edge(row: usize, height: usize) -> f64 {
    (std::f64::consts::PI * (0.5 - row as f64 / height as f64)).sin()
}

impl Map {
    /// `None` if the map is black.
    fn new(width: usize, height: usize, pixels: Vec<[f32; 3]>, rotation: f32) -> Option<Self> {
        let cell = width
            .div_ceil(MOST_COLUMNS)
            .max(height.div_ceil(MOST_COLUMNS));
        let (columns, row_count) = (width.div_ceil(cell), height.div_ceil(cell));
        let (rotation_sin, rotation_cos) = rotation.sin_cos();
        let mut map = Self {
            width,
            height,
            pixels,
            rotation_sin,
            rotation_cos,
            cell,
            columns,
            rows: Distribution::default(),
            before: vec![0; columns * row_count],
            guide: vec![0; columns * row_count],
            row_density: vec![0.0; row_count],
            row_edges: (0..=row_count)
                .map(|row| cos_edge(height.min(row * cell), height))
                .collect(),
            integral: Vec3::ZERO,
        };
        let mut integral = [0.0_f64; 3];
        let mut row_weights = vec![0.0; row_count];
        let mut weights = vec![0.0; columns];
        for (row, row_weight) in row_weights.iter_mut().enumerate() {
            weights.fill(0.0);
            for y in row * cell..height.min((row + 1) * cell) {
                let solid_angle =
                    (cos_edge(y, height) - cos_edge(y + 1, height)) * f64::from(TAU) / width as f64;
                for x in 0..width {
                    let mean = map.mean_over_texel(x, y);
                    weights[x / cell] += (f64::from(luminance(mean)) * solid_angle) as f32;
                    for (sum, c) in integral.iter_mut().zip(mean.to_array()) {
                        *sum += f64::from(c) * solid_angle;
                    }
                }
            }
            let cells = row * columns..(row + 1) * columns;
            if fill(
                &weights,
                &mut map.before[cells.clone()],
                &mut map.guide[cells],
            ) {
                *row_weight = weights.iter().map(|&w| f64::from(w)).sum::<f64>() as f32;
            }
        }
        map.rows = Distribution::new(&row_weights)?;
        map.integral = Vec3::from_array(integral.map(|c| c as f32));
        for row in 0..row_count {
            // Full cells; the last one of a row may be narrower, see `pdf`.
            let cell_width = f64::from(TAU) * cell as f64 / width as f64;
            let solid_angle = (map.row_edges[row] - map.row_edges[row + 1]) * cell_width;
            map.row_density[row] =
                (f64::from(map.rows.pmf(row) * probability(1)) / solid_angle) as f32;
        }
        Some(map)
    }

    fn texel(&self, x: usize, y: usize) -> Vec3 {
        Vec3::from_array(self.pixels[y * self.width + x])
    }

    /// The mean of the bilinear function over a texel: weights 1/8, 6/8, 1/8 in either direction.
    fn mean_over_texel(&self, x: usize, y: usize) -> Vec3 {
        let (left, right) = ((x + self.width - 1) % self.width, (x + 1) % self.width);
        let (up, down) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
        let row =
            |y| (self.texel(left, y) + self.texel(right, y)) * 0.125 + self.texel(x, y) * 0.75;
        (row(up) + row(down)) * 0.125 + row(y) * 0.75
    }

    /// Image coordinates of a direction, in `[0, 1]`.
    fn uv(&self, wi: Vec3) -> Vec2 {
        // The sky is turned by the rotation, so the direction is turned back.
        let x = self.rotation_cos * wi.x - self.rotation_sin * wi.z;
        let z = self.rotation_sin * wi.x + self.rotation_cos * wi.z;
        let u = 0.5 + z.atan2(x) / TAU;
        // Not the arc cosine: it has no precision left near the poles.
        let v = x.hypot(z).atan2(wi.y) * FRAC_1_PI;
        Vec2::new(u.clamp(0.0, 1.0), v.clamp(0.0, 1.0))
    }

    fn radiance(&self, wi: Vec3) -> Vec3 {
        self.lookup(self.uv(wi))
    }

    /// Radiance at image coordinates, in `[0, 1]`.
    pub(super) fn lookup(&self, uv: Vec2) -> Vec3 {
        let (x, y) = (
            uv.x * self.width as f32 - 0.5,
            uv.y * self.height as f32 - 0.5,
        );
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let last = self.height as i64 - 1;
        let wrap = |x: i64| x.rem_euclid(self.width as i64) as usize;
        let clamp = |y: i64| y.clamp(0, last) as usize;
        let (x, y) = (x.floor() as i64, y.floor() as i64);
        let row = |y| self.texel(wrap(x), y) * (1.0 - fx) + self.texel(wrap(x + 1), y) * fx;
        row(clamp(y)) * (1.0 - fy) + row(clamp(y + 1)) * fy
    }

    fn sample(&self, u: Vec2) -> Vec3 {
        let (row, down) = self.rows.pick_inside(place(u.y));
        let cells = row * self.columns..(row + 1) * self.columns;
        let (column, right) = pick(&self.before[cells.clone()], &self.guide[cells], place(u.x));
        let texels = (self.width - column * self.cell).min(self.cell) as f32;
        let azimuth = ((column * self.cell) as f32 + right * texels) / self.width as f32 * TAU - PI;
        let y =
            self.row_edges[row] + (self.row_edges[row + 1] - self.row_edges[row]) * f64::from(down);
        let radius = ((1.0 - y) * (1.0 + y)).max(0.0).sqrt() as f32;
        let (sin, cos) = azimuth.sin_cos();
        let (x, z) = (radius * cos, radius * sin);
        Vec3::new(
            self.rotation_cos * x + self.rotation_sin * z,
            y as f32,
            self.rotation_cos * z - self.rotation_sin * x,
        )
    }

    fn pdf(&self, wi: Vec3) -> f32 {
        let uv = self.uv(wi);
        let column = ((uv.x * self.width as f32) as usize).min(self.width - 1) / self.cell;
        let row = ((uv.y * self.height as f32) as usize).min(self.height - 1) / self.cell;
        let cells = row * self.columns..(row + 1) * self.columns;
        let in_row = mass(&self.before[cells], column) as f32;
        let texels = (self.width - column * self.cell).min(self.cell);
        in_row * self.row_density[row] * self.cell as f32 / texels as f32
    }
}
