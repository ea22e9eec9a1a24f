//! How far a cached picture is from the exact one of the same samples.

use occlude_image::metrics::compare;
use occlude_image::{Encoding, Picture};

/// Side of the blocks that are looked at one by one: means over a picture hide jagged edges.
pub const BLOCK: u32 = 32;

/// Errors of one picture.
#[derive(Clone, Debug)]
pub struct Quality {
    /// FLIP: mean, 99th percentile of the pixels, mean of the worst block.
    pub flip: f64,
    pub flip_99: f64,
    pub flip_block: f64,
    /// Sum of the absolute differences over the sum of the exact picture (the paper's `L^INF`).
    pub energy: f64,
    pub relmse: f64,
    pub ssim: f64,
    /// Corners of the two blocks that differ most.
    pub worst: [[u32; 2]; 2],
}

/// Compares; both pictures are of one size.
pub fn quality(cached: &Picture, exact: &Picture) -> Result<Quality, String> {
    let compared = compare(cached, exact, Encoding::SceneLinear).map_err(|e| e.to_string())?;
    let mut sorted = compared.flip_map.clone();
    sorted.sort_by(f32::total_cmp);
    let flip_99 = f64::from(sorted[(sorted.len() - 1) * 99 / 100]);
    let mut blocks = blocks(&compared.flip_map, exact.width, exact.height);
    blocks.sort_by(|a, b| b.1.total_cmp(&a.1));
    let second = blocks.get(1).unwrap_or(&blocks[0]);
    Ok(Quality {
        flip: compared.numbers.flip,
        flip_99,
        flip_block: blocks[0].1,
        energy: compared.numbers.energy_change,
        relmse: compared.numbers.relmse,
        ssim: compared.numbers.ssim,
        worst: [blocks[0].0, second.0],
    })
}

/// Means over blocks, with the blocks' corners. Those cut off at the right and at the bottom count if a quarter is there.
pub fn blocks(values: &[f32], width: u32, height: u32) -> Vec<([u32; 2], f64)> {
    let mut means = Vec::new();
    for y in (0..height).step_by(BLOCK as usize) {
        for x in (0..width).step_by(BLOCK as usize) {
            let (w, h) = (BLOCK.min(width - x), BLOCK.min(height - y));
            if 4 * w * h < BLOCK * BLOCK && width >= BLOCK && height >= BLOCK {
                continue;
            }
            let rows = (y..y + h).map(|y| (y * width + x) as usize);
            let sum: f64 = rows
                .flat_map(|start| &values[start..start + w as usize])
                .map(|&v| f64::from(v))
                .sum();
            means.push(([x, y], sum / f64::from(w * h)));
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_block_is_found() {
        let exact = Picture::from_pixels(100, 70, vec![[0.5; 3]; 7000]).unwrap();
        let mut cached = exact.clone();
        for y in 33..60 {
            for x in 65..90 {
                cached.pixels[y * 100 + x] = [0.9, 0.1, 0.9];
            }
        }
        let found = quality(&cached, &exact).unwrap();
        assert_eq!(found.worst[0], [64, 32]);
        assert!(found.flip_block > 3.0 * found.flip && found.flip_99 > found.flip_block);
        let same = quality(&exact, &exact).unwrap();
        assert_eq!((same.flip, same.energy, same.relmse), (0.0, 0.0, 0.0));
    }

    #[test]
    fn slivers_are_no_blocks() {
        let means = blocks(&[1.0; 65 * 40], 65, 40);
        assert_eq!(means.len(), 4);
        assert_eq!(blocks(&[1.0; 64], 8, 8).len(), 1);
    }
}
