//! Least squares: lobes placed one after the other where most is missing, then moved together.
//!
//! The error of radiance is weighted by solid angle over (radiance near by + a share of the mean), as for numbers that were counted: plain squares see
//! nothing but lamps, and the dim rest of a sky sends as much light. Amplitudes are the non-negative solution of a linear problem, in the end with
//! unshadowed irradiance among its equations; axes and sharpness follow by Levenberg-Marquardt (Marquardt 1963). All that a step needs are sums over cells of products of a lobe, its three derivatives and the
//! map: `(4 n)^2` numbers, summed in an order that does not depend on threads.

use super::super::environment::Map;
use super::{SkyResidual, direction, solid_angle};
use glam::{DVec3, Vec2, Vec3};
use occlude_visibility::field::SphericalGaussian;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of cells that the map is reduced to; twice as many columns.
pub(super) const ROWS: usize = 64;
/// One in so many cells, those with the strongest contrasts, is split into [`SPLIT`] x [`SPLIT`].
const SPLIT_ONE_IN: usize = 32;
const SPLIT: usize = 4;
/// Sharpness that lobes may have: from all but constant to the width of a part of a cell.
pub(super) const SHARPNESS: Range<f32> = 1e-3..4000.0;
/// Sharpness that new lobes are tried with.
const TRIED: [f64; 8] = [0.3, 1.0, 3.0, 10.0, 35.0, 120.0, 400.0, 1500.0];
/// Share of the mean radiance in the weights.
const FLOOR: f64 = 0.25;
/// What the error of irradiance counts in the end, against that of radiance.
const IRRADIANCE: f64 = 1000.0;
/// Cells that are summed by one thread at a time; part of the result, by rounding.
const CHUNK: usize = 512;
/// Exponents below this give nothing.
const NEGLIGIBLE: f64 = -20.0;

/// The map at few places.
#[derive(Clone)]
pub(super) struct Cells {
    directions: Vec<DVec3>,
    radiance: Vec<[f64; 3]>,
    solid_angles: Vec<f64>,
    /// Mean of the channels over the neighbourhood.
    around: Vec<f64>,
}

impl Cells {
    /// Means of the map over `rows` x `2 rows` cells, the liveliest of them split.
    pub(super) fn new(map: &Map, rows: usize) -> Self {
        let columns = 2 * rows;
        let parts = rows * SPLIT;
        // Of a large map no texel is left out.
        let inside = map
            .width
            .div_ceil(2 * parts)
            .max(map.height.div_ceil(parts));
        let fine: Vec<Vec<[f64; 3]>> = (0..parts)
            .into_par_iter()
            .map(|row| means_of_row(map, row, parts, inside))
            .collect();
        let area = |row: usize| solid_angle(row, 2 * parts, parts);
        // Sums over the parts of a cell.
        let places: Vec<(usize, usize)> = (0..rows)
            .flat_map(|row| (0..columns).map(move |column| (row, column)))
            .collect();
        let parts_of = |(row, column): (usize, usize)| {
            (row * SPLIT..(row + 1) * SPLIT)
                .flat_map(move |y| (column * SPLIT..(column + 1) * SPLIT).map(move |x| (y, x)))
        };
        let mut means = Vec::with_capacity(places.len());
        let mut lively = Vec::with_capacity(places.len());
        for &place in &places {
            let (mut sum, mut weight) = ([0.0; 3], 0.0);
            for (y, x) in parts_of(place) {
                weight += area(y);
                for (sum, value) in sum.iter_mut().zip(fine[y][x]) {
                    *sum += value * area(y);
                }
            }
            let mean = sum.map(|s| s / weight);
            let deviation: f64 = (parts_of(place))
                .map(|(y, x)| (grey(&fine[y][x]) - grey(&mean)).abs() * area(y))
                .sum();
            lively.push(deviation);
            means.push(mean);
        }
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by(|&a, &b| lively[b].total_cmp(&lively[a]));
        let mut split = vec![false; places.len()];
        for &index in &order[..places.len() / SPLIT_ONE_IN] {
            split[index] = lively[index] > 0.0;
        }
        let mut cells = Self {
            directions: Vec::new(),
            radiance: Vec::new(),
            solid_angles: Vec::new(),
            around: Vec::new(),
        };
        for (index, &(row, column)) in places.iter().enumerate() {
            let around = mean_around(&means, row, column, rows);
            if split[index] {
                for (y, x) in parts_of((row, column)) {
                    cells.push((y, x), parts, fine[y][x], around);
                }
            } else {
                cells.push((row, column), rows, means[index], around);
            }
        }
        cells
    }

    /// Adds a cell of a grid of `rows`.
    fn push(
        &mut self,
        (row, column): (usize, usize),
        rows: usize,
        radiance: [f64; 3],
        around: f64,
    ) {
        let at = |i: usize, n: usize| (i as f64 + 0.5) / n as f64;
        self.directions
            .push(direction(at(column, 2 * rows), at(row, rows)));
        self.solid_angles.push(solid_angle(row, 2 * rows, rows));
        self.around.push(around.max(grey(&radiance)));
        self.radiance.push(radiance);
    }

    pub(super) fn scaled(&self, factor: f64) -> Self {
        Self {
            radiance: (self.radiance.iter())
                .map(|pixel| pixel.map(|value| value * factor))
                .collect(),
            around: self.around.iter().map(|value| value * factor).collect(),
            ..self.clone()
        }
    }

    /// The integral over all directions, by colour.
    pub(super) fn energy(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (pixel, area) in self.radiance.iter().zip(&self.solid_angles) {
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += value * area;
            }
        }
        sum
    }

    /// What a cell counts, if the mean radiance is 1.
    fn weight(&self, cell: usize) -> f64 {
        self.solid_angles[cell] / (self.around[cell] + FLOOR)
    }

    /// What lobes lose of these cells.
    pub(super) fn residual(&self, lobes: &[SphericalGaussian]) -> SkyResidual {
        let fitted: Vec<[f64; 3]> = (self.directions.par_iter())
            .map(|w| {
                let w = w.as_vec3();
                let sum: Vec3 = lobes.iter().map(|lobe| lobe.at(w)).sum();
                sum.to_array().map(f64::from)
            })
            .collect();
        let pairs = || self.radiance.iter().zip(&fitted).zip(&self.solid_angles);
        let (mut squares, mut sum, mut area) = (0.0, 0.0, 0.0);
        for ((truth, fit), solid_angle) in pairs() {
            for c in 0..3 {
                squares += (fit[c] - truth[c]).powi(2) * solid_angle;
                sum += truth[c] * solid_angle;
                area += solid_angle;
            }
        }
        let mean = sum / area;
        let errors: Vec<(f64, f64)> = (0..NORMALS)
            .into_par_iter()
            .map(|i| {
                let normal = normal(i);
                let (mut squares, mut worst) = (0.0, 0.0_f64);
                for c in 0..3 {
                    let error: f64 = (pairs().zip(&self.directions))
                        .map(|(((truth, fit), area), w)| {
                            (fit[c] - truth[c]) * area * normal.dot(*w).max(0.0)
                        })
                        .sum();
                    squares += error * error / 3.0;
                    worst = worst.max(error.abs());
                }
                (squares, worst)
            })
            .collect();
        let mean_irradiance = mean * std::f64::consts::PI;
        let mean_square = errors.iter().map(|e| e.0).sum::<f64>() / NORMALS as f64;
        let worst = errors.iter().map(|e| e.1).fold(0.0, f64::max);
        SkyResidual {
            radiance: ((squares / area).sqrt() / mean) as f32,
            irradiance: (mean_square.sqrt() / mean_irradiance) as f32,
            irradiance_worst: (worst / mean_irradiance) as f32,
            energy: 0.0,
        }
    }
}

fn grey(radiance: &[f64; 3]) -> f64 {
    radiance.iter().sum::<f64>() / 3.0
}

/// Means over `inside` x `inside` places in each part of a row.
fn means_of_row(map: &Map, row: usize, rows: usize, inside: usize) -> Vec<[f64; 3]> {
    let columns = 2 * rows;
    let mut sums = vec![[0.0_f64; 3]; columns];
    let mut weight = 0.0;
    for y in 0..inside {
        let v = ((row * inside + y) as f64 + 0.5) / (rows * inside) as f64;
        let area = (v * std::f64::consts::PI).sin();
        weight += area * inside as f64;
        for (column, sum) in sums.iter_mut().enumerate() {
            for x in 0..inside {
                let u = ((column * inside + x) as f64 + 0.5) / (columns * inside) as f64;
                let value = map.lookup(Vec2::new(u as f32, v as f32)).to_array();
                for (sum, value) in sum.iter_mut().zip(value) {
                    *sum += f64::from(value) * area;
                }
            }
        }
    }
    sums.into_iter()
        .map(|sum| sum.map(|s| s / weight))
        .collect()
}

/// Mean over the 5 x 5 cells around one.
fn mean_around(means: &[[f64; 3]], row: usize, column: usize, rows: usize) -> f64 {
    const REACH: usize = 2;
    let columns = 2 * rows;
    let (mut sum, mut count) = (0.0, 0.0);
    for y in row.saturating_sub(REACH)..(row + REACH + 1).min(rows) {
        for x in column + columns - REACH..=column + columns + REACH {
            sum += grey(&means[y * columns + x % columns]);
            count += 1.0;
        }
    }
    sum / count
}

/// Normals that irradiance is compared at.
const NORMALS: usize = 256;

/// One of them: a spiral over the sphere.
fn normal(i: usize) -> DVec3 {
    let y = 1.0 - 2.0 * (i as f64 + 0.5) / NORMALS as f64;
    let azimuth = i as f64 * 2.399_963_229_728_653;
    let radius = (1.0 - y * y).sqrt();
    DVec3::new(radius * azimuth.cos(), y, radius * azimuth.sin())
}

#[derive(Clone, Copy)]
struct Lobe {
    axis: DVec3,
    log_sharpness: f64,
    amplitude: [f64; 3],
}

impl Lobe {
    /// Its value with amplitude 1.
    fn value(&self, w: DVec3) -> f64 {
        let exponent = self.log_sharpness.exp() * (self.axis.dot(w) - 1.0);
        if exponent < NEGLIGIBLE {
            0.0
        } else {
            exponent.exp()
        }
    }

    /// Its value with amplitude 1, and the derivatives by two turns of the axis and by the logarithm of the sharpness.
    fn basis(&self, turns: (DVec3, DVec3), w: DVec3) -> [f64; 4] {
        let sharpness = self.log_sharpness.exp();
        let exponent = sharpness * (self.axis.dot(w) - 1.0);
        if exponent < NEGLIGIBLE {
            return [0.0; 4];
        }
        let value = exponent.exp();
        [
            value,
            value * sharpness * turns.0.dot(w),
            value * sharpness * turns.1.dot(w),
            value * exponent,
        ]
    }

    fn stepped(&self, step: &[f64]) -> Self {
        let (s, t) = self.axis.any_orthonormal_pair();
        // A turn of more than a width, or a sharpness changed more than e-fold, has left what the derivatives know.
        let most = 1.0 / self.log_sharpness.exp().max(1.0).sqrt();
        let turn = (s * step[0] + t * step[1]).clamp_length_max(most);
        let range = f64::from(SHARPNESS.start).ln()..f64::from(SHARPNESS.end).ln();
        Self {
            axis: (self.axis + turn).normalize(),
            log_sharpness: (self.log_sharpness + step[2].clamp(-1.0, 1.0))
                .clamp(range.start, range.end),
            amplitude: std::array::from_fn(|c| (self.amplitude[c] + step[3 + c]).max(0.0)),
        }
    }
}

/// Weighted sums over cells.
struct Moments {
    /// Of products of basis functions, row by row.
    gram: Vec<f64>,
    /// Of products of basis functions with the map.
    target: Vec<[f64; 3]>,
    /// Of squares of the map.
    norm: f64,
}

impl Moments {
    fn new(cells: &Cells, lobes: &[Lobe]) -> Self {
        let size = 4 * lobes.len();
        let turns: Vec<_> = (lobes.iter())
            .map(|lobe| lobe.axis.any_orthonormal_pair())
            .collect();
        let count = cells.directions.len();
        let parts: Vec<Self> = (0..count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut part = Self::zero(size);
                let mut basis = vec![0.0; size];
                for cell in chunk * CHUNK..count.min((chunk + 1) * CHUNK) {
                    let w = cells.directions[cell];
                    for ((lobe, turns), basis) in
                        lobes.iter().zip(&turns).zip(basis.chunks_exact_mut(4))
                    {
                        basis.copy_from_slice(&lobe.basis(*turns, w));
                    }
                    part.add_cell(&basis, cells.weight(cell), &cells.radiance[cell]);
                }
                part
            })
            .collect();
        let mut sum = Self::zero(size);
        for part in parts {
            sum.add(&part);
        }
        for row in 0..size {
            for column in 0..row {
                sum.gram[row * size + column] = sum.gram[column * size + row];
            }
        }
        sum
    }

    fn zero(size: usize) -> Self {
        Self {
            gram: vec![0.0; size * size],
            target: vec![[0.0; 3]; size],
            norm: 0.0,
        }
    }

    /// The upper half alone.
    fn add_cell(&mut self, basis: &[f64], weight: f64, radiance: &[f64; 3]) {
        let size = basis.len();
        for (row, &value) in basis.iter().enumerate() {
            if value == 0.0 {
                continue;
            }
            let value = value * weight;
            let sums = &mut self.gram[row * size + row..(row + 1) * size];
            for (sum, other) in sums.iter_mut().zip(&basis[row..]) {
                *sum += value * other;
            }
            for (sum, radiance) in self.target[row].iter_mut().zip(radiance) {
                *sum += value * radiance;
            }
        }
        self.norm += weight * radiance.iter().map(|r| r * r).sum::<f64>();
    }

    fn add(&mut self, other: &Self) {
        for (sum, value) in self.gram.iter_mut().zip(&other.gram) {
            *sum += value;
        }
        for (sum, value) in self
            .target
            .iter_mut()
            .flatten()
            .zip(other.target.iter().flatten())
        {
            *sum += value;
        }
        self.norm += other.norm;
    }

    fn size(&self) -> usize {
        self.target.len()
    }

    fn at(&self, row: usize, column: usize) -> f64 {
        self.gram[row * self.size() + column]
    }

    /// What basis function `row` still finds in the map with the lobes taken off.
    fn missing(&self, lobes: &[Lobe], row: usize) -> [f64; 3] {
        std::array::from_fn(|c| {
            let taken = lobes.iter().enumerate();
            let taken: f64 = taken
                .map(|(k, l)| self.at(row, 4 * k) * l.amplitude[c])
                .sum();
            self.target[row][c] - taken
        })
    }

    fn error(&self, lobes: &[Lobe]) -> f64 {
        let mut error = self.norm;
        for (k, lobe) in lobes.iter().enumerate() {
            let missing = self.missing(lobes, 4 * k);
            for ((amplitude, target), missing) in
                lobe.amplitude.iter().zip(&self.target[4 * k]).zip(missing)
            {
                // |L - f|^2 = |L|^2 - <f, L> - <f, L - f>.
                error -= amplitude * (target + missing);
            }
        }
        error
    }

    /// Non-negative least squares over amplitudes, by coordinate descent from where they are, at most `sweeps` times through all.
    fn solve_amplitudes(&self, lobes: &mut [Lobe], sweeps: usize) {
        for _ in 0..sweeps {
            let mut moved = 0.0_f64;
            for k in 0..lobes.len() {
                let missing = self.missing(lobes, 4 * k);
                let own = self.at(4 * k, 4 * k);
                for (amplitude, missing) in lobes[k].amplitude.iter_mut().zip(missing) {
                    let old = *amplitude;
                    *amplitude = (old + missing / own.max(f64::MIN_POSITIVE)).max(0.0);
                    moved = moved.max((*amplitude - old).abs() / (*amplitude + 1e-3));
                }
            }
            if moved < 1e-6 {
                break;
            }
        }
    }

    /// Adds the squares of the error of irradiance, in units of what a radiance of 1 gives, to the error.
    fn add_irradiance(&mut self, cells: &Cells, lobes: &[Lobe], factor: f64) {
        let lit: Vec<(Vec<f64>, [f64; 3])> = (0..NORMALS)
            .into_par_iter()
            .map(|i| {
                let normal = normal(i);
                let mut of_lobes = vec![0.0; lobes.len()];
                let mut of_map = [0.0; 3];
                for (cell, &w) in cells.directions.iter().enumerate() {
                    let cosine = normal.dot(w);
                    if cosine <= 0.0 {
                        continue;
                    }
                    let share = cosine * cells.solid_angles[cell] / std::f64::consts::PI;
                    for (sum, lobe) in of_lobes.iter_mut().zip(lobes) {
                        *sum += share * lobe.value(w);
                    }
                    for (sum, value) in of_map.iter_mut().zip(&cells.radiance[cell]) {
                        *sum += share * value;
                    }
                }
                (of_lobes, of_map)
            })
            .collect();
        let size = self.size();
        let factor = factor / NORMALS as f64;
        for (of_lobes, of_map) in &lit {
            for (k, a) in of_lobes.iter().enumerate() {
                for (j, b) in of_lobes.iter().enumerate() {
                    self.gram[4 * k * size + 4 * j] += factor * a * b;
                }
                for (sum, value) in self.target[4 * k].iter_mut().zip(of_map) {
                    *sum += factor * a * value;
                }
            }
            self.norm += factor * of_map.iter().map(|v| v * v).sum::<f64>();
        }
    }

    /// The step of all parameters (six a lobe) that the linearised problem asks for. `None` if it has no solution in numbers.
    fn step(&self, lobes: &[Lobe], damping: f64) -> Option<Vec<f64>> {
        let size = 6 * lobes.len();
        let mut matrix = vec![0.0; size * size];
        let mut right = vec![0.0; size];
        for (k, a) in lobes.iter().enumerate() {
            for (j, b) in lobes.iter().enumerate() {
                let shared: f64 = (0..3).map(|c| a.amplitude[c] * b.amplitude[c]).sum();
                for p in 0..6 {
                    for q in 0..6 {
                        matrix[(6 * k + p) * size + 6 * j + q] = match (p < 3, q < 3) {
                            (true, true) => shared * self.at(4 * k + 1 + p, 4 * j + 1 + q),
                            (true, false) => a.amplitude[q - 3] * self.at(4 * k + 1 + p, 4 * j),
                            (false, true) => b.amplitude[p - 3] * self.at(4 * k, 4 * j + 1 + q),
                            (false, false) if p == q => self.at(4 * k, 4 * j),
                            (false, false) => 0.0,
                        };
                    }
                }
            }
            let value = self.missing(lobes, 4 * k);
            for p in 0..3 {
                let slope = self.missing(lobes, 4 * k + 1 + p);
                right[6 * k + p] = (0..3).map(|c| a.amplitude[c] * slope[c]).sum();
                right[6 * k + 3 + p] = value[p];
            }
        }
        let largest = (0..size).map(|i| matrix[i * size + i]).fold(0.0, f64::max);
        for i in 0..size {
            matrix[i * size + i] += damping * matrix[i * size + i] + 1e-12 * largest;
        }
        solve(&mut matrix, right)
    }
}

/// A symmetric positive definite system, by Cholesky's factors.
fn solve(matrix: &mut [f64], mut right: Vec<f64>) -> Option<Vec<f64>> {
    let size = right.len();
    for row in 0..size {
        for column in 0..=row {
            let (before, own) = matrix.split_at_mut(row * size);
            let product: f64 = if column == row {
                own[..column].iter().map(|v| v * v).sum()
            } else {
                let other = &before[column * size..column * size + column];
                own[..column].iter().zip(other).map(|(a, b)| a * b).sum()
            };
            let rest = own[column] - product;
            own[column] = if column == row {
                (rest > 0.0).then(|| rest.sqrt())?
            } else {
                rest / before[column * size + column]
            };
        }
    }
    for row in 0..size {
        let done: f64 = (0..row).map(|i| matrix[row * size + i] * right[i]).sum();
        right[row] = (right[row] - done) / matrix[row * size + row];
    }
    for row in (0..size).rev() {
        let done: f64 = (row + 1..size)
            .map(|i| matrix[i * size + row] * right[i])
            .sum();
        right[row] = (right[row] - done) / matrix[row * size + row];
    }
    right.iter().all(|v| v.is_finite()).then_some(right)
}

/// Sweeps over the amplitudes in every step.
const SWEEPS: usize = 60;

/// Moves all lobes together until nothing is gained, at most `steps` times.
fn improve(cells: &Cells, lobes: &mut Vec<Lobe>, steps: usize) {
    let mut moments = Moments::new(cells, lobes);
    moments.solve_amplitudes(lobes, SWEEPS);
    let mut error = moments.error(lobes);
    let mut damping = 1e-2;
    for _ in 0..steps {
        let Some(step) = moments.step(lobes, damping) else {
            damping *= 8.0;
            continue;
        };
        let mut tried: Vec<Lobe> = (lobes.iter().zip(step.chunks_exact(6)))
            .map(|(lobe, step)| lobe.stepped(step))
            .collect();
        let tried_moments = Moments::new(cells, &tried);
        tried_moments.solve_amplitudes(&mut tried, SWEEPS);
        let tried_error = tried_moments.error(&tried);
        if tried_error < error {
            let gain = (error - tried_error) / error.max(f64::MIN_POSITIVE);
            (*lobes, moments, error) = (tried, tried_moments, tried_error);
            damping = (damping * 0.3).max(1e-7);
            if gain < 1e-4 {
                break;
            }
        } else {
            damping *= 6.0;
            if damping > 1e6 {
                break;
            }
        }
    }
}

/// The lobe that would take most off the error, among few axes and widths.
fn place(cells: &Cells, lobes: &[Lobe]) -> Option<Lobe> {
    let missing: Vec<[f64; 3]> = (cells.directions.par_iter().enumerate())
        .map(|(cell, &w)| {
            let weight = cells.weight(cell);
            let mut rest = cells.radiance[cell];
            for lobe in lobes {
                let value = lobe.value(w);
                for (rest, amplitude) in rest.iter_mut().zip(&lobe.amplitude) {
                    *rest -= amplitude * value;
                }
            }
            rest.map(|r| r * weight)
        })
        .collect();
    // Every third cell as an axis.
    let axes: Vec<DVec3> = cells.directions.iter().step_by(3).copied().collect();
    let best = (axes.par_iter())
        .map(|&axis| {
            let mut best = (0.0, None);
            for sharpness in TRIED {
                let (mut square, mut found) = (0.0, [0.0; 3]);
                for (cell, (w, missing)) in cells.directions.iter().zip(&missing).enumerate() {
                    let exponent = sharpness * (axis.dot(*w) - 1.0);
                    if exponent > -8.0 {
                        let value = exponent.exp();
                        square += value * value * cells.weight(cell);
                        for (found, missing) in found.iter_mut().zip(missing) {
                            *found += value * missing;
                        }
                    }
                }
                let amplitude = found.map(|f: f64| (f / square.max(f64::MIN_POSITIVE)).max(0.0));
                let gain: f64 = amplitude.iter().map(|a| a * a * square).sum();
                if gain > best.0 {
                    let lobe = Lobe {
                        axis,
                        log_sharpness: sharpness.ln(),
                        amplitude,
                    };
                    best = (gain, Some(lobe));
                }
            }
            best
        })
        .collect::<Vec<_>>();
    let best = best
        .into_iter()
        .reduce(|a, b| if b.0 > a.0 { b } else { a });
    best.and_then(|best| best.1)
}

/// At most `count` lobes for the map, given at two resolutions with mean radiance 1.
pub(super) fn fit(cells: &Cells, coarse: &Cells, count: usize) -> Vec<SphericalGaussian> {
    const STEPS_A_LOBE: usize = 4;
    const STEPS: usize = 60;
    let mut lobes = Vec::new();
    // A lobe that turns out to be of no use has had its turn.
    for _ in 0..count {
        let Some(lobe) = place(coarse, &lobes) else {
            break;
        };
        lobes.push(lobe);
        improve(coarse, &mut lobes, STEPS_A_LOBE);
        lobes.retain(|lobe| lobe.amplitude != [0.0; 3]);
        if lobes.is_empty() {
            break;
        }
    }
    if lobes.is_empty() {
        return Vec::new();
    }
    improve(cells, &mut lobes, STEPS);
    let mut moments = Moments::new(cells, &lobes);
    // Where a peak is out of reach of any lobe its error must not drown the rest.
    let error = moments.error(&lobes);
    moments.add_irradiance(cells, &lobes, IRRADIANCE * error.max(1.0));
    moments.solve_amplitudes(&mut lobes, 100 * SWEEPS);
    (lobes.iter())
        .filter(|lobe| lobe.amplitude != [0.0; 3])
        .map(|lobe| SphericalGaussian {
            axis: lobe.axis.as_vec3().normalize(),
            sharpness: (lobe.log_sharpness.exp() as f32).clamp(SHARPNESS.start, SHARPNESS.end),
            amplitude: DVec3::from_array(lobe.amplitude).as_vec3(),
        })
        .collect()
}
