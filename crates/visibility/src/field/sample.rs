//! Visibility maps by rays, few of them: a coarse grid, then the boundaries alone, finer and finer.
//!
//! Wang et al. 2013, section 4.2: each level has twice the texels of the one before along a side, takes over what that one found, and
//! traces where neighbours differ. Two things go beyond the paper. A level is not one pass: where a ray contradicts what was
//! taken over, its neighbours are traced too, until **every two neighbours that differ have both been traced**. So the band
//! of traced texels is two wide instead of four, and a boundary that was guessed wrong is followed to where it is. And
//! the boundaries of other maps (neighbouring points', or the same point's in the frame before) are traced at the last level.
//!
//! What no ray of the coarse grid, no boundary and no other map has met is missed: specks smaller than a texel of the first level.

use super::hemisphere::{Grid, Hemisphere};
use super::map::VisibilityMap;
use crate::{Ray, Tracer};
use glam::Vec3;

/// How a map is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapSampling {
    /// Texels along a side of the first level, all of them traced: 16 or 32 in the paper.
    pub start: u32,
    /// Texels along a side of the map.
    pub resolution: u32,
}

impl Default for MapSampling {
    fn default() -> Self {
        Self {
            start: 16,
            resolution: 128,
        }
    }
}

/// Another map that says where boundaries may be.
#[derive(Clone, Copy, Debug)]
pub struct Hint<'a> {
    /// The map.
    pub map: &'a VisibilityMap,
    /// Its axes.
    pub hemisphere: Hemisphere,
}

/// What is known of a texel.
mod texel {
    pub(super) const FREE: u8 = 1;
    pub(super) const TRACED: u8 = 2;
    pub(super) const WAITING: u8 = 4;
}

/// Samples maps; keeps its scratch space from one to the next.
#[derive(Debug, Default)]
pub struct MapSampler {
    cells: Vec<u8>,
    finer: Vec<u8>,
    queue: Vec<(u16, u16)>,
    next: Vec<(u16, u16)>,
    rays: Vec<Ray>,
    answers: Vec<bool>,
    traced: u64,
}

/// Side of the square blocks that rays are grouped by: neighbours in a batch run alike.
const BLOCK: usize = 8;

impl MapSampler {
    /// Rays traced so far.
    pub fn traced(&self) -> u64 {
        self.traced
    }

    /// Samples the map of a point. `origin` is off the surface already.
    ///
    /// # Panics
    /// If the numbers of texels are no powers of two from 16 to 1024, or the last is smaller than the first.
    pub fn sample(
        &mut self,
        tracer: &impl Tracer,
        origin: Vec3,
        hemisphere: &Hemisphere,
        sampling: MapSampling,
        hints: &[Hint],
    ) -> VisibilityMap {
        let MapSampling { start, resolution } = sampling;
        assert!(start.is_power_of_two() && start <= resolution);
        let mut map = VisibilityMap::new(resolution, false);
        let mut side = start as usize;
        self.cells.clear();
        self.cells.resize(side * side, 0);
        self.queue_all(side);
        self.trace(tracer, origin, hemisphere, side);
        while side < resolution as usize {
            self.refine(side);
            side *= 2;
            self.queue_boundaries(side);
            if side == resolution as usize {
                self.queue_hints(side, hemisphere, hints);
            }
            while !self.queue.is_empty() {
                self.trace(tracer, origin, hemisphere, side);
                self.queue_neighbours(side);
            }
        }
        for (row, cells) in self.cells.chunks_exact(side).enumerate() {
            for (column, cell) in cells.iter().enumerate() {
                if cell & texel::FREE != 0 {
                    map.set(row, column, true);
                }
            }
        }
        map
    }

    fn queue_all(&mut self, side: usize) {
        // Eight rays at a time from patches of 4 by 2 texels.
        self.queue.clear();
        for row in (0..side).step_by(2) {
            for column in (0..side).step_by(4) {
                for k in 0..8 {
                    self.queue
                        .push(((row + k / 4) as u16, (column + k % 4) as u16));
                }
            }
        }
    }

    /// Traces the queue.
    fn trace(&mut self, tracer: &impl Tracer, origin: Vec3, hemisphere: &Hemisphere, side: usize) {
        let grid = Grid::of(side as u32);
        let ray = |&(row, column): &(u16, u16)| {
            let local = grid.direction(row.into(), column.into());
            Ray::new(origin, hemisphere.to_world(local))
        };
        self.rays.clear();
        self.rays.extend(self.queue.iter().map(ray));
        self.answers.clear();
        self.answers.resize(self.rays.len(), false);
        tracer.occluded_batch(&self.rays, &mut self.answers);
        self.traced += self.rays.len() as u64;
        for (&(row, column), &blocked) in self.queue.iter().zip(&self.answers) {
            let free = if blocked { 0 } else { texel::FREE };
            self.cells[usize::from(row) * side + usize::from(column)] = texel::TRACED | free;
        }
    }

    /// Every texel becomes four.
    fn refine(&mut self, side: usize) {
        self.finer.clear();
        for row in self.cells.chunks_exact(side) {
            for _ in 0..2 {
                let free = row.iter().map(|cell| cell & texel::FREE);
                self.finer.extend(free.flat_map(|free| [free, free]));
            }
        }
        std::mem::swap(&mut self.cells, &mut self.finer);
    }

    /// Queues the texels that differ from a neighbour, block by block.
    fn queue_boundaries(&mut self, side: usize) {
        self.queue.clear();
        let cells = &mut self.cells;
        for top in (0..side).step_by(BLOCK) {
            for left in (0..side).step_by(BLOCK) {
                if is_plain(cells, side, top, left) {
                    continue;
                }
                for row in top..top + BLOCK {
                    for column in left..left + BLOCK {
                        let here = cells[row * side + column] & texel::FREE;
                        let unlike = neighbours(side, row, column)
                            .any(|index| cells[index] & texel::FREE != here);
                        if unlike {
                            cells[row * side + column] |= texel::WAITING;
                            self.queue.push((row as u16, column as u16));
                        }
                    }
                }
            }
        }
    }

    /// Queues the texels that the boundaries of other maps fall into.
    fn queue_hints(&mut self, side: usize, hemisphere: &Hemisphere, hints: &[Hint]) {
        let grid = Grid::of(side as u32);
        let (cells, queue) = (&mut self.cells, &mut self.queue);
        for hint in hints {
            let same = hint.hemisphere == *hemisphere && hint.map.side() as usize == side;
            let from = Grid::of(hint.map.side());
            hint.map.boundary(|row, column| {
                let (row, column) = if same {
                    (row, column)
                } else {
                    let world = hint.hemisphere.to_world(from.direction(row, column));
                    let local = hemisphere.to_local(world);
                    if local.y <= 0.0 {
                        return;
                    }
                    grid.texel(local)
                };
                let cell = &mut cells[row * side + column];
                if *cell & texel::WAITING == 0 {
                    *cell |= texel::WAITING;
                    queue.push((row as u16, column as u16));
                }
            });
        }
    }

    /// After tracing: queues what has not been traced and differs from a neighbour that has.
    fn queue_neighbours(&mut self, side: usize) {
        self.next.clear();
        for &(row, column) in &self.queue {
            let (row, column) = (usize::from(row), usize::from(column));
            let here = self.cells[row * side + column] & texel::FREE;
            for index in neighbours(side, row, column) {
                let cell = &mut self.cells[index];
                let known = texel::TRACED | texel::WAITING;
                if *cell & texel::FREE != here && *cell & known == 0 {
                    *cell |= texel::WAITING;
                    self.next
                        .push(((index / side) as u16, (index % side) as u16));
                }
            }
        }
        std::mem::swap(&mut self.queue, &mut self.next);
    }
}

/// The eight neighbours of a texel, those outside left out.
#[inline]
fn neighbours(side: usize, row: usize, column: usize) -> impl Iterator<Item = usize> {
    let rows = row.saturating_sub(1)..(row + 2).min(side);
    let columns = column.saturating_sub(1)..(column + 2).min(side);
    rows.flat_map(move |r| columns.clone().map(move |c| r * side + c))
}

/// Whether a block and the texels around it are all alike, by rows of eight.
fn is_plain(cells: &[u8], side: usize, top: usize, left: usize) -> bool {
    let first = cells[top * side + left];
    let rows = top.saturating_sub(1)..(top + BLOCK + 1).min(side);
    let columns = left.saturating_sub(1)..(left + BLOCK + 1).min(side);
    rows.into_iter().all(|row| {
        let cells = &cells[row * side + columns.start..row * side + columns.end];
        cells
            .iter()
            .fold(0, |differs, cell| differs | (cell ^ first))
            & texel::FREE
            == 0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ray against spheres, as a tracer.
    fn spheres(spheres: Vec<(Vec3, f32)>) -> impl Tracer {
        move |ray: &Ray| {
            spheres.iter().any(|&(centre, radius)| {
                let to = centre - ray.origin;
                let along = to.dot(ray.direction);
                along > 0.0 && to.length_squared() - along * along < radius * radius
            })
        }
    }

    fn brute(tracer: &impl Tracer, hemisphere: &Hemisphere, side: u32) -> VisibilityMap {
        VisibilityMap::from_fn(side, |local| {
            !tracer.occluded(&Ray::new(Vec3::ZERO, hemisphere.to_world(local)))
        })
    }

    fn some_spheres(seed: u64, count: usize, largest: f32) -> Vec<(Vec3, f32)> {
        let mut state = seed;
        let mut unit = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..count)
            .map(|_| {
                let centre = Vec3::new(unit() - 0.5, unit() * 0.5, unit() - 0.5) * 8.0;
                (centre, 0.2 + unit() * largest)
            })
            .collect()
    }

    #[test]
    fn few_rays_find_the_map_of_many() {
        let hemisphere = Hemisphere::new(Vec3::new(0.1, 1.0, -0.2).normalize(), Vec3::X);
        for (seed, count) in [(1, 1), (2, 3), (3, 6), (4, 10)] {
            let tracer = spheres(some_spheres(seed, count, 1.2));
            let sampling = MapSampling::default();
            let mut sampler = MapSampler::default();
            let map = sampler.sample(&tracer, Vec3::ZERO, &hemisphere, sampling, &[]);
            let wrong = map.difference(&brute(&tracer, &hemisphere, 128));
            let share = sampler.traced() as f32 / (128.0 * 128.0);
            assert!(wrong < 0.005, "{count} spheres: {wrong} wrong");
            assert!(share < 0.25, "{count} spheres: {share} of the rays");
        }
    }

    /// Wherever two neighbours differ, both are what rays say.
    #[test]
    fn boundaries_are_exact() {
        let hemisphere = Hemisphere::new(Vec3::Y, Vec3::Z);
        let tracer = spheres(some_spheres(7, 8, 0.8));
        let full = brute(&tracer, &hemisphere, 64);
        let sampling = MapSampling {
            start: 16,
            resolution: 64,
        };
        let map = MapSampler::default().sample(&tracer, Vec3::ZERO, &hemisphere, sampling, &[]);
        let mut boundary = 0;
        map.boundary(|row, column| {
            boundary += 1;
            assert_eq!(map.get(row, column), full.get(row, column));
        });
        assert!(boundary > 100);
    }

    /// A pole of a third of a degree slips through the first level; the map of a neighbour that saw it brings it in whole.
    #[test]
    fn hints_find_slim_occluders() {
        let here = Hemisphere::new(Vec3::Y, Vec3::Z);
        let pole = |ray: &Ray| {
            let d = ray.direction;
            (d.x - 0.2).abs() < 0.02 * d.length() && d.y > 0.1 && d.z > 0.1
        };
        let sampling = MapSampling::default();
        let full = brute(&pole, &here, 128);
        let mut blind = None;
        // Some start grid misses it: the coarsest that can be had.
        let coarse = MapSampler::default().sample(&pole, Vec3::ZERO, &here, sampling, &[]);
        if coarse.difference(&full) > 0.0 {
            blind = Some(coarse);
        }
        let there = Hemisphere::new(Vec3::new(0.2, 1.0, 0.1).normalize(), Vec3::X);
        let seen = brute(&pole, &there, 128);
        let hint = Hint {
            map: &seen,
            hemisphere: there,
        };
        let helped = MapSampler::default().sample(&pole, Vec3::ZERO, &here, sampling, &[hint]);
        assert!(helped.difference(&full) < 1e-4);
        assert!(blind.is_none_or(|blind| helped.difference(&full) < blind.difference(&full)));
    }

    #[test]
    fn a_map_that_is_its_own_start_is_traced_whole() {
        let sampling = MapSampling {
            start: 32,
            resolution: 32,
        };
        let tracer = spheres(some_spheres(5, 20, 0.3));
        let hemisphere = Hemisphere::new(Vec3::Y, Vec3::Z);
        let mut sampler = MapSampler::default();
        let map = sampler.sample(&tracer, Vec3::ZERO, &hemisphere, sampling, &[]);
        assert_eq!(map, brute(&tracer, &hemisphere, 32));
        assert_eq!(sampler.traced(), 1024);
    }
}
