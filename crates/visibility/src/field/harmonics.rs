//! Sixteen numbers that say roughly what a point sees: spherical harmonics of a map, in world space so that points with other normals compare.

use super::hemisphere::{Grid, Hemisphere};
use super::map::VisibilityMap;
use glam::Vec3;
use std::f32::consts::PI;

/// Coefficients of bands 0 to 3.
pub type Harmonics = [f32; 16];

/// Blocks of texels along a side: visibility is averaged over each first.
const BLOCKS: usize = 16;

/// The sum of absolute coefficients over a free hemisphere is about this.
const SUM_OF_FREE: f32 = 4.0;

/// Real orthonormal spherical harmonics of bands 0 to 3.
#[inline(always)]
pub(super) fn basis(w: Vec3) -> Harmonics {
    let Vec3 { x, y, z } = w;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        0.488_602_52 * y,
        0.488_602_52 * z,
        0.488_602_52 * x,
        1.092_548_5 * x * y,
        1.092_548_5 * y * z,
        0.315_391_57 * (3.0 * zz - 1.0),
        1.092_548_5 * x * z,
        0.546_274_24 * (xx - yy),
        0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        0.457_045_8 * y * (5.0 * zz - 1.0),
        0.373_176_34 * z * (5.0 * zz - 3.0),
        0.457_045_8 * x * (5.0 * zz - 1.0),
        1.445_305_7 * z * (xx - yy),
        0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}

/// Projects a map. Exact up to what the harmonics change within a sixteenth of the hemisphere's width.
pub fn harmonics(map: &VisibilityMap, hemisphere: &Hemisphere) -> Harmonics {
    let grid = Grid::of(map.side());
    let coarse = Grid::of(BLOCKS as u32);
    let size = grid.side / BLOCKS;
    let mask = (1u64 << size) - 1;
    let spacing = PI / grid.side as f32;
    let mut sum = Harmonics::default();
    for block_row in 0..BLOCKS {
        let mut shares = [0.0; BLOCKS];
        for row in block_row * size..(block_row + 1) * size {
            let weight = grid.sin[row] * spacing * spacing;
            let words = map.row(row);
            for (block, share) in shares.iter_mut().enumerate() {
                let column = block * size;
                let bits = words[column / 64] >> (column % 64) & mask;
                *share += bits.count_ones() as f32 * weight;
            }
        }
        for (block, &share) in shares.iter().enumerate() {
            if share > 0.0 {
                let values = basis(hemisphere.to_world(coarse.direction(block_row, block)));
                for (sum, value) in sum.iter_mut().zip(values) {
                    *sum += share * value;
                }
            }
        }
    }
    sum
}

/// How differently two points see (Eq. 7), relative to what the first sees.
///
/// The printed denominator is the error of a point against itself, which is 0: taken instead is the sum of absolute coefficients, or a
/// tenth of a free hemisphere's where a point sees almost nothing.
pub fn visibility_error(at: &Harmonics, other: &Harmonics) -> f32 {
    let error: f32 = at.iter().zip(other).map(|(a, b)| (a - b).abs()).sum();
    let size: f32 = at.iter().map(|a| a.abs()).sum();
    error / size.max(0.1 * SUM_OF_FREE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The slow twin: every texel by itself, in double precision.
    fn brute(map: &VisibilityMap, hemisphere: &Hemisphere) -> Harmonics {
        let grid = Grid::of(map.side());
        let spacing = f64::from(PI) / grid.side as f64;
        let mut sum = [0.0_f64; 16];
        for row in 0..grid.side {
            for column in 0..grid.side {
                if map.get(row, column) {
                    let values = basis(hemisphere.to_world(grid.direction(row, column)));
                    for (sum, value) in sum.iter_mut().zip(values) {
                        *sum += f64::from(value * grid.sin[row]) * spacing * spacing;
                    }
                }
            }
        }
        sum.map(|s| s as f32)
    }

    #[test]
    fn the_basis_is_orthonormal() {
        let n = 20_000;
        let mut gram = [[0.0_f64; 16]; 16];
        for i in 0..n {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n);
            let a = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            let b = basis(Vec3::new(
                (r * a.cos()) as f32,
                (r * a.sin()) as f32,
                z as f32,
            ));
            for (row, x) in gram.iter_mut().zip(b) {
                for (cell, y) in row.iter_mut().zip(b) {
                    *cell += f64::from(x * y) * 4.0 * std::f64::consts::PI / f64::from(n);
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (k, &cell) in row.iter().enumerate() {
                let expected = f64::from(u8::from(i == k));
                assert!((cell - expected).abs() < 0.01, "{i} {k}: {cell}");
            }
        }
    }

    #[test]
    fn blocks_are_as_good_as_texels() {
        let hemisphere = Hemisphere::new(Vec3::new(-0.3, 0.6, 0.4).normalize(), Vec3::Y);
        for side in [64, 128] {
            for map in [
                VisibilityMap::new(side, true),
                VisibilityMap::from_fn(side, |w| w.x * 3.0 + w.y > 1.0),
                VisibilityMap::from_fn(side, |w| (w.x * 9.0).sin() + (w.z * 7.0).cos() > 0.3),
            ] {
                let (fast, slow) = (harmonics(&map, &hemisphere), brute(&map, &hemisphere));
                for (a, b) in fast.iter().zip(slow) {
                    assert!((a - b).abs() < 0.02, "{a} {b}");
                }
            }
        }
    }

    /// What is free in the world stays the same when the frame turns.
    #[test]
    fn frames_do_not_show() {
        let of = |along: Vec3| {
            let h = Hemisphere::new(Vec3::Y, along);
            let map = VisibilityMap::from_fn(128, |local| {
                h.to_world(local).dot(Vec3::new(0.6, 0.64, 0.48)) > 0.5
            });
            harmonics(&map, &h)
        };
        let (a, b) = (of(Vec3::X), of(Vec3::new(0.5, 0.0, 0.8)));
        assert!(visibility_error(&a, &b) < 0.02);
        assert!(visibility_error(&a, &[0.0; 16]) > 0.99);
    }

    #[test]
    fn blocked_points_compare_without_division_by_zero() {
        let dark = [0.0; 16];
        assert_eq!(visibility_error(&dark, &dark), 0.0);
        let free = harmonics(
            &VisibilityMap::new(64, true),
            &Hemisphere::new(Vec3::Z, Vec3::X),
        );
        let sum: f32 = free.iter().map(|c| c.abs()).sum();
        assert!((sum / SUM_OF_FREE - 1.0).abs() < 0.3, "{sum}");
        assert!(visibility_error(&dark, &free).is_finite());
    }
}
