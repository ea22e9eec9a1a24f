//! Directions of bundles, and the grids of lines along them.
//!
//! Light goes both ways along a line, so directions are spread over a hemisphere: Owen-scrambled Sobol points, any range of which is a
//! share of the work. Each bundle's grid is turned by a random angle about the direction; the lines of every tile are shifted by
//! a random part of their distance, so that each point of a surface is met with the same probability.

use super::radiance::hash;
use super::triangles::{Block, LANES, Triangles};
use glam::{Vec2, Vec3};
use occlude_render::sampling::{Sampler, SamplerKind, warp};

/// The directions of one round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Directions {
    /// Seed of the whole work.
    pub seed: u64,
    /// Number of the round: every round has directions of its own.
    pub round: u32,
}

/// One direction of a round.
#[derive(Clone, Copy, Debug)]
pub(super) struct Direction {
    /// Unit vectors: across the lines, across, along; right-handed.
    pub axes: [Vec3; 3],
    /// Random bits of the direction.
    pub key: u32,
}

impl Directions {
    /// Unit vector along the lines of bundle `index`; light goes both ways.
    pub fn along(&self, index: u32) -> Vec3 {
        self.direction(index).axes[2]
    }

    pub(super) fn direction(&self, index: u32) -> Direction {
        let mut sampler = Sampler::new(
            SamplerKind::Sobol,
            self.seed,
            [self.round, 0x6275_6e64],
            index,
        );
        let [u, v, turn, rest] = sampler.next();
        let along = warp::uniform_hemisphere(Vec2::new(u, v));
        let (x, y) = warp::basis(along);
        let (sin, cos) = warp::sin_cos_turns(turn);
        let key = hash(rest.to_bits() ^ hash(index) ^ hash(self.seed as u32 ^ self.round << 24));
        Direction {
            axes: [x * cos + y * sin, y * cos - x * sin, along],
            key,
        }
    }
}

/// From the world to the window that a bundle is analysed in: x and y in analysis pixels, z along the lines, metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    x: Vec3,
    y: Vec3,
    z: Vec3,
    offset: Vec2,
    /// Side of an analysis pixel, metres.
    pub pixel: f32,
}

impl Frame {
    /// A square window of `size` pixels around everything.
    pub fn new(direction: &Direction, triangles: &Triangles, size: u32) -> Self {
        let (low, high) = triangles.bounds();
        let half = (high - low) * 0.5;
        let [x, y, z] = direction.axes;
        // The middle of the box is the origin.
        let reach = half.dot(x.abs()).max(half.dot(y.abs()));
        // A margin for rounding, and so that nothing lies on the rim.
        let side = 2.0 * reach * (1.0 + 1e-4) + f32::MIN_POSITIVE * 1e9;
        let scale = size as f32 / side;
        Self {
            x: x * scale,
            y: y * scale,
            z,
            offset: Vec2::splat(size as f32 * 0.5),
            pixel: side / size as f32,
        }
    }

    /// Sixteen triangles in the window: x of the three corners, then y. (No fused operations: every processor gives the same bits.)
    #[inline(always)]
    pub fn window(&self, block: &Block) -> [[f32; LANES]; 6] {
        let mut out = [[0.0; LANES]; 6];
        for k in 0..3 {
            for lane in 0..LANES {
                let (px, py, pz) = (
                    block[3 * k][lane],
                    block[3 * k + 1][lane],
                    block[3 * k + 2][lane],
                );
                out[k][lane] = self.x.x * px + self.x.y * py + self.x.z * pz + self.offset.x;
                out[3 + k][lane] = self.y.x * px + self.y.y * py + self.y.z * pz + self.offset.y;
            }
        }
        out
    }

    /// Depths of the three corners of sixteen triangles, metres along the lines.
    #[inline(always)]
    pub fn depths(&self, block: &Block) -> [[f32; LANES]; 3] {
        let mut out = [[0.0; LANES]; 3];
        for k in 0..3 {
            for lane in 0..LANES {
                let (px, py, pz) = (
                    block[3 * k][lane],
                    block[3 * k + 1][lane],
                    block[3 * k + 2][lane],
                );
                out[k][lane] = self.z.x * px + self.z.y * py + self.z.z * pz;
            }
        }
        out
    }
}
