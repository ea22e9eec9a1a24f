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
use super::map::{VisibilityMap, words_a_row};
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

/// Samples maps; keeps its scratch space from one to the next.
#[derive(Debug, Default)]
pub struct MapSampler {
    /// One bit a texel of the level at hand, rows in whole words: free, or taken over as free.
    free: Vec<u64>,
    /// A ray says so.
    traced: Vec<u64>,
    /// To be traced next.
    wanted: Vec<u64>,
    finer: Vec<u64>,
    queue: Vec<(u16, u16)>,
    rays: Vec<Ray>,
    answers: Vec<bool>,
    count: u64,
}

/// How the bits of a level lie in words.
#[derive(Clone, Copy, Debug)]
struct Layout {
    side: usize,
    words: usize,
    /// The bits of a row's last word that are texels.
    last: u64,
}

impl Layout {
    fn of(side: usize) -> Self {
        Self {
            side,
            words: words_a_row(side as u32),
            last: if side < 64 { (1 << side) - 1 } else { u64::MAX },
        }
    }

    fn len(&self) -> usize {
        self.side * self.words
    }
}

impl MapSampler {
    /// Rays traced so far.
    pub fn traced(&self) -> u64 {
        self.count
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
        let end = resolution as usize;
        let mut layout = Layout::of(start as usize);
        self.begin(layout);
        for row in self.wanted.chunks_exact_mut(layout.words) {
            row.fill(u64::MAX);
            row[layout.words - 1] = layout.last;
        }
        self.trace(tracer, origin, hemisphere, layout);
        while layout.side < end {
            self.refine(layout);
            layout = Layout::of(layout.side * 2);
            self.want_boundaries(layout, false);
            if layout.side == end {
                self.want_hints(layout, hemisphere, hints);
            }
            self.settle(tracer, origin, hemisphere, layout);
        }
        self.map(resolution)
    }

    /// Samples a map anew that is known from a moment ago: its boundaries are traced, those of the hints, and a grid of texels as coarse as
    /// `sampling.start`; where rays contradict it, boundaries are followed to where they are now.
    ///
    /// # Panics
    /// As [`sample`](Self::sample); and if `before` has another resolution.
    pub fn sample_again(
        &mut self,
        tracer: &impl Tracer,
        origin: Vec3,
        hemisphere: &Hemisphere,
        sampling: MapSampling,
        before: &VisibilityMap,
        hints: &[Hint],
    ) -> VisibilityMap {
        let MapSampling { start, resolution } = sampling;
        assert!(start.is_power_of_two() && start <= resolution);
        assert_eq!(before.side(), resolution);
        let layout = Layout::of(resolution as usize);
        self.begin(layout);
        self.free.copy_from_slice(before.words());
        self.want_boundaries(layout, false);
        let step = (resolution / start) as usize;
        for row in (step / 2..layout.side).step_by(step) {
            for column in (step / 2..layout.side).step_by(step) {
                self.wanted[row * layout.words + column / 64] |= 1 << (column % 64);
            }
        }
        self.want_hints(layout, hemisphere, hints);
        self.settle(tracer, origin, hemisphere, layout);
        self.map(resolution)
    }

    fn map(&self, resolution: u32) -> VisibilityMap {
        VisibilityMap::from_words(resolution, self.free.clone()).unwrap_or_default()
    }

    fn begin(&mut self, layout: Layout) {
        for bits in [&mut self.free, &mut self.traced, &mut self.wanted] {
            bits.clear();
            bits.resize(layout.len(), 0);
        }
    }

    /// Traces what is wanted, and then what differs from a traced neighbour, until all agree.
    fn settle(
        &mut self,
        tracer: &impl Tracer,
        origin: Vec3,
        hemisphere: &Hemisphere,
        layout: Layout,
    ) {
        while self.wanted.iter().any(|&bits| bits != 0) {
            self.trace(tracer, origin, hemisphere, layout);
            self.want_boundaries(layout, true);
        }
    }

    /// Traces what is wanted.
    fn trace(
        &mut self,
        tracer: &impl Tracer,
        origin: Vec3,
        hemisphere: &Hemisphere,
        layout: Layout,
    ) {
        self.queue_wanted(layout);
        let grid = Grid::of(layout.side as u32);
        self.rays.clear();
        self.rays.extend(self.queue.iter().map(|&(row, column)| {
            let local = grid.direction(row.into(), column.into());
            Ray::new(origin, hemisphere.to_world(local))
        }));
        self.answers.clear();
        self.answers.resize(self.rays.len(), false);
        tracer.occluded_batch(&self.rays, &mut self.answers);
        self.count += self.rays.len() as u64;
        for (traced, wanted) in self.traced.iter_mut().zip(&mut self.wanted) {
            *traced |= std::mem::take(wanted);
        }
        for (&(row, column), &blocked) in self.queue.iter().zip(&self.answers) {
            let column = usize::from(column);
            let word = &mut self.free[usize::from(row) * layout.words + column / 64];
            let bit = 1u64 << (column % 64);
            *word = if blocked { *word & !bit } else { *word | bit };
        }
    }

    /// Lists the wanted texels by blocks of eight by eight: rays that are traced together run alike.
    fn queue_wanted(&mut self, layout: Layout) {
        self.queue.clear();
        for top in (0..layout.side).step_by(BLOCK) {
            for word in 0..layout.words {
                let rows: [u64; BLOCK] =
                    std::array::from_fn(|k| self.wanted[(top + k) * layout.words + word]);
                let mut any = rows.iter().fold(0, |all, bits| all | bits);
                while any != 0 {
                    let byte = any.trailing_zeros() as usize / 8 * 8;
                    any &= !(0xff << byte);
                    for (k, bits) in rows.iter().enumerate() {
                        let mut bits = bits >> byte & 0xff;
                        while bits != 0 {
                            let column = word * 64 + byte + bits.trailing_zeros() as usize;
                            bits &= bits - 1;
                            self.queue.push(((top + k) as u16, column as u16));
                        }
                    }
                }
            }
        }
    }

    /// Every texel becomes four.
    fn refine(&mut self, from: Layout) {
        let to = Layout::of(from.side * 2);
        self.finer.clear();
        for row in self.free.chunks_exact(from.words) {
            for _ in 0..2 {
                for word in 0..to.words {
                    let half = row[word / 2] >> (32 * (word % 2)) & 0xffff_ffff;
                    self.finer.push(doubled(half));
                }
            }
        }
        std::mem::swap(&mut self.free, &mut self.finer);
        for bits in [&mut self.traced, &mut self.wanted] {
            bits.clear();
            bits.resize(to.len(), 0);
        }
    }

    /// Wants the texels that differ from one of their eight neighbours (from one that has been traced), unless they have been traced.
    fn want_boundaries(&mut self, layout: Layout, from_traced: bool) {
        let Layout { side, words, last } = layout;
        // A texel and its neighbours to either side, of the free and of the blocked ones.
        let spread = |row: usize, word: usize| -> [u64; 2] {
            let pick = |index: usize, blocked: bool| {
                let at = row * words + index;
                let bits = if blocked {
                    !self.free[at]
                } else {
                    self.free[at]
                };
                let bits = if from_traced {
                    bits & self.traced[at]
                } else {
                    bits
                };
                if index + 1 == words {
                    bits & last
                } else {
                    bits
                }
            };
            [false, true].map(|blocked| {
                let here = pick(word, blocked);
                let before = if word > 0 {
                    pick(word - 1, blocked) >> 63
                } else {
                    0
                };
                let after = if word + 1 < words {
                    pick(word + 1, blocked) << 63
                } else {
                    0
                };
                here | here << 1 | before | here >> 1 | after
            })
        };
        for word in 0..words {
            let used = if word + 1 == words { last } else { u64::MAX };
            let mut above = [0, 0];
            let mut here = spread(0, word);
            for row in 0..side {
                let below = if row + 1 < side {
                    spread(row + 1, word)
                } else {
                    [0, 0]
                };
                let near_free = above[0] | here[0] | below[0];
                let near_blocked = above[1] | here[1] | below[1];
                let at = row * words + word;
                let free = self.free[at];
                let unlike = (free & near_blocked) | (!free & near_free);
                self.wanted[at] |= unlike & used & !self.traced[at];
                (above, here) = (here, below);
            }
        }
    }

    /// Wants the texels that the boundaries of other maps fall into.
    fn want_hints(&mut self, layout: Layout, hemisphere: &Hemisphere, hints: &[Hint]) {
        let grid = Grid::of(layout.side as u32);
        for hint in hints {
            let same = hint.hemisphere == *hemisphere && hint.map.side() as usize == layout.side;
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
                self.wanted[row * layout.words + column / 64] |= 1 << (column % 64);
            });
        }
    }
}

/// Each of 32 bits twice.
fn doubled(bits: u64) -> u64 {
    let mut x = bits;
    for (shift, mask) in [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ] {
        x = (x | x << shift) & mask;
    }
    x | x << 1
}

/// Side of the square blocks that rays are grouped by: neighbours in a batch run alike.
const BLOCK: usize = 8;

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

    /// While an occluder moves by a texel or two, few rays follow it, and none of its old places stays.
    #[test]
    fn maps_are_followed_from_moment_to_moment() {
        let hemisphere = Hemisphere::new(Vec3::Y, Vec3::Z);
        let sampling = MapSampling::default();
        let mut sampler = MapSampler::default();
        let mut map = None;
        for step in 0..12 {
            let mut all = some_spheres(3, 4, 0.9);
            all[0].0.x += step as f32 * 0.06;
            all[1].0.z -= step as f32 * 0.09;
            let tracer = spheres(all);
            let before = sampler.traced();
            map = Some(match &map {
                None => sampler.sample(&tracer, Vec3::ZERO, &hemisphere, sampling, &[]),
                Some(map) => {
                    sampler.sample_again(&tracer, Vec3::ZERO, &hemisphere, sampling, map, &[])
                }
            });
            let found = map.as_ref().unwrap();
            let wrong = found.difference(&brute(&tracer, &hemisphere, 128));
            let share = (sampler.traced() - before) as f32 / (128.0 * 128.0);
            assert!(wrong < 0.002, "{step}: {wrong} wrong");
            assert!(share < 0.2, "{step}: {share} of the rays");
        }
    }

    #[test]
    fn bits_are_doubled() {
        assert_eq!(doubled(0b1011), 0b1100_1111);
        assert_eq!(doubled(0x8000_0001), 0xc000_0000_0000_0003);
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
