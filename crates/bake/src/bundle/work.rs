//! One direction from its analysis to its lines, shared by threads; tiles that overflow are split and done again.
//!
//! Nothing is known to fit before it is there: a rectangle of lines whose fragments find no room is halved and both halves are done anew,
//! down to a single line, which is then taken in depth ranges. Lines are handed on only when all their fragments are known, so
//! that nothing counts twice and nothing is lost.

use super::analysis::Maps;
use super::bins::Bins;
use super::fragments::{Fragments, LinkedList, Peel, ScanScatter, sort};
use super::frame::{Direction, Frame};
use super::raster::{Clip, Isa, Scratch, Source, Target, rasterize};
use super::tile::{Bounds, Tiling};
use super::transport::Lines;
use super::triangles::Triangles;
use super::{Cutting, Layout, Seconds, Settings, Stats};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Instant;

/// What a direction is made of.
pub(super) struct Setting<'a> {
    pub triangles: &'a Triangles<'a>,
    pub direction: Direction,
    pub settings: &'a Settings,
}

/// What is kept from direction to direction.
pub(super) struct Bundle {
    isa: Isa,
    maps: Maps,
    tiling: Tiling,
    bins: Bins,
    /// Fragments of every tile.
    found: Vec<AtomicU64>,
}

/// Wall-clock time since the last look.
struct Laps(Instant);

impl Laps {
    fn lap(&mut self) -> f64 {
        std::mem::replace(&mut self.0, Instant::now())
            .elapsed()
            .as_secs_f64()
    }
}

impl Bundle {
    pub fn new(triangles: &Triangles, settings: &Settings) -> Self {
        // A few pixels a bin: finer ones would cost more than they tell.
        let texels = f64::from(settings.factor) * triangles.needed_texels();
        let useful = (texels.sqrt() / 4.0).min(8192.0) as u32;
        let size = settings.analysis.min(useful).next_power_of_two();
        Self {
            isa: Isa::detect(),
            maps: Maps::new(size.clamp(256, 8192), rayon::current_num_threads()),
            tiling: Tiling::default(),
            bins: Bins::default(),
            found: Vec::new(),
        }
    }

    /// Makes the lines of one direction; every thread hands its own to a looker of its own.
    pub fn run<L: Lines>(&mut self, setting: &Setting, looker: &(impl Fn() -> L + Sync)) -> Stats {
        let Setting {
            triangles,
            direction,
            settings,
        } = setting;
        let mut stats = Stats {
            directions: 1,
            ..Stats::default()
        };
        let mut laps = Laps(Instant::now());
        let frame = Frame::new(direction, triangles, self.maps.size());
        self.maps
            .render(self.isa, triangles, &frame, settings.counting);
        stats.seconds.analysis = laps.lap();
        self.maps.reduce();
        stats.seconds.mipmaps = laps.lap();
        let bounds = Bounds {
            lines: settings.lines.max(1),
            nodes: settings.nodes.max(1),
            alpha: settings.alpha,
            factor: settings.factor,
        };
        match settings.cutting {
            Cutting::Adaptive => self.tiling.descend(&self.maps, frame.pixel, &bounds),
            Cutting::Uniform(levels) => {
                let size = self.maps.size() as f32;
                self.tiling.uniform(size, levels, bounds.lines);
            }
        }
        self.bins.cut(&self.tiling, direction.key);
        stats.seconds.tiling = laps.lap();
        stats.tiles = self.tiling.tiles.len() as u64;
        stats.splits = self.tiling.splits.len() as u64;
        stats.lines = (self.tiling.tiles.iter())
            .map(|tile| u64::from(tile.lines).pow(2))
            .sum();

        self.found.clear();
        self.found
            .resize_with(self.tiling.tiles.len(), AtomicU64::default);
        let all = 0..self.tiling.tiles.len() as u32;
        let mut ranges = vec![all];
        while let Some(tiles) = ranges.pop() {
            // One tile alone is done however long its lists are.
            let room = if tiles.len() > 1 {
                settings.entries as usize
            } else {
                usize::MAX
            };
            let fits = self.bins.fill(
                self.isa,
                triangles,
                &frame,
                &self.tiling,
                tiles.clone(),
                room,
            );
            let listed = laps.lap();
            stats.seconds.listing += listed;
            stats.seconds.creation += listed;
            if !fits {
                let middle = tiles.start + tiles.len() as u32 / 2;
                ranges.push(middle..tiles.end);
                ranges.push(tiles.start..middle);
                continue;
            }
            let work = Work {
                isa: self.isa,
                triangles,
                frame: &frame,
                tiling: &self.tiling,
                bins: &self.bins,
                found: &self.found,
                key: direction.key,
                settings,
            };
            stats += work.tiles(tiles, looker);
            laps.lap();
        }
        let found = |tile: u32| self.found[tile as usize].load(Relaxed);
        stats.false_alarms = self.tiling.false_alarms(found, &bounds);
        stats
    }
}

/// The lines of some tiles.
struct Work<'a> {
    isa: Isa,
    triangles: &'a Triangles<'a>,
    frame: &'a Frame,
    tiling: &'a Tiling,
    bins: &'a Bins,
    found: &'a [AtomicU64],
    key: u32,
    settings: &'a Settings,
}

/// A rectangle of lines of a tile: from column and row, up to but without column and row.
#[derive(Clone, Copy, Debug)]
struct Region {
    tile: u32,
    x: [u32; 2],
    y: [u32; 2],
}

impl Region {
    fn lines(&self) -> usize {
        ((self.x[1] - self.x[0]) * (self.y[1] - self.y[0])) as usize
    }

    /// Both halves, cut across the longer side.
    fn halves(&self) -> [Self; 2] {
        let (mut low, mut high) = (*self, *self);
        if self.x[1] - self.x[0] >= self.y[1] - self.y[0] {
            let middle = (self.x[0] + self.x[1]) / 2;
            (low.x[1], high.x[0]) = (middle, middle);
        } else {
            let middle = (self.y[0] + self.y[1]) / 2;
            (low.y[1], high.y[0]) = (middle, middle);
        }
        [low, high]
    }
}

/// One thread's part.
struct Worker<'a, L, F> {
    work: &'a Work<'a>,
    lines: L,
    fragments: F,
    scratch: Scratch,
    stats: Stats,
    /// Seconds that went into what overflowed.
    redone: f64,
}

impl Work<'_> {
    fn tiles<L: Lines>(&self, tiles: Range<u32>, looker: &(impl Fn() -> L + Sync)) -> Stats {
        let clock = Instant::now();
        let threads = rayon::current_num_threads();
        let room = self.settings.nodes as usize;
        let parts: Vec<Stats> = match self.settings.layout {
            Layout::ScanScatter => {
                let bins = self.bins.of_tiles(&tiles);
                let next = AtomicU32::new(bins.start);
                self.threads(
                    looker,
                    || ScanScatter::new((room / threads).max(1)),
                    |worker| {
                        loop {
                            // A few at a time: neighbours share texels.
                            let first = next.fetch_add(4, Relaxed);
                            if first >= bins.end {
                                break;
                            }
                            (first..bins.end.min(first + 4)).for_each(|bin| worker.bin(bin));
                        }
                    },
                )
            }
            Layout::LinkedList => {
                let next = AtomicU32::new(tiles.start);
                self.threads(
                    looker,
                    || LinkedList::new(room),
                    |worker| {
                        loop {
                            let tile = next.fetch_add(1, Relaxed);
                            if tile >= tiles.end {
                                break;
                            }
                            worker.tile(tile);
                        }
                    },
                )
            }
        };
        let mut sum = Stats::default();
        parts.into_iter().for_each(|part| sum += part);
        // What the threads clocked, as shares of the time that passed.
        let seconds = clock.elapsed().as_secs_f64();
        let clocked = (sum.seconds.creation + sum.seconds.update).max(1e-12);
        sum.seconds = Seconds {
            creation: seconds * sum.seconds.creation / clocked,
            update: seconds * sum.seconds.update / clocked,
            redone: seconds * sum.seconds.redone / clocked,
            ..Seconds::default()
        };
        sum
    }

    fn threads<L: Lines, F: Fragments>(
        &self,
        looker: &(impl Fn() -> L + Sync),
        fragments: impl Fn() -> F + Sync,
        run: impl Fn(&mut Worker<L, F>) + Sync,
    ) -> Vec<Stats> {
        (0..rayon::current_num_threads())
            .into_par_iter()
            .with_max_len(1)
            .map(|_| {
                let mut worker = Worker {
                    work: self,
                    lines: looker(),
                    fragments: fragments(),
                    scratch: Scratch::default(),
                    stats: Stats::default(),
                    redone: 0.0,
                };
                run(&mut worker);
                let clock = Instant::now();
                worker.lines.finish();
                let mut stats = worker.stats;
                stats.seconds.update += clock.elapsed().as_secs_f64();
                stats.seconds.redone = worker.redone;
                let counts = worker.lines.counts();
                stats.pairs += counts.pairs;
                stats.exchanges += counts.exchanges;
                stats
            })
            .collect()
    }
}

impl<L: Lines, F: Fragments> Worker<'_, L, F> {
    fn bin(&mut self, number: u32) {
        if self.work.bins.is_empty(number) {
            return;
        }
        let bin = self.work.bins.bins[number as usize];
        self.whole(Region {
            tile: bin.tile,
            x: [bin.x, bin.x + bin.width],
            y: [bin.y, bin.y + bin.height],
        });
    }

    fn tile(&mut self, tile: u32) {
        let lines = self.work.tiling.tiles[tile as usize].lines;
        self.whole(Region {
            tile,
            x: [0, lines],
            y: [0, lines],
        });
    }

    /// A bin or a tile.
    fn whole(&mut self, region: Region) {
        let tile = &self.work.tiling.tiles[region.tile as usize];
        let spacing = tile.width * self.work.frame.pixel / tile.lines as f32;
        let area = spacing * spacing;
        self.lines
            .set_weight(area / self.work.triangles.largest_area());
        self.region(region);
    }

    fn region(&mut self, region: Region) {
        let clock = Instant::now();
        self.fragments.begin(region.lines());
        self.work
            .rasterize(&region, &mut self.scratch, &mut self.fragments);
        let created = clock.elapsed().as_secs_f64();
        self.stats.seconds.creation += created;
        let dropped = self.fragments.dropped();
        if dropped > 0 {
            self.stats.overflow_detected += 1;
            self.stats.nodes_dropped += dropped;
            if self.work.settings.recover {
                self.redone += created;
                return self.again(region);
            }
            self.stats.overflow_left += dropped;
        }
        let came = self.fragments.came();
        self.work.found[region.tile as usize].fetch_add(came, Relaxed);
        self.stats.fragments += came - dropped;
        let lines = &mut self.lines;
        self.fragments.lists(|list| {
            sort(list);
            lines.surfaces(list);
            lines.end_line();
        });
        self.stats.seconds.update += clock.elapsed().as_secs_f64() - created;
    }

    /// In halves, or a single line in depth ranges.
    #[cold]
    fn again(&mut self, region: Region) {
        if region.lines() > 1 {
            return region
                .halves()
                .into_iter()
                .for_each(|half| self.region(half));
        }
        let clock = Instant::now();
        let mut peel = Peel::new((self.work.settings.nodes as usize).min(1 << 16));
        loop {
            peel.begin(1);
            self.work.rasterize(&region, &mut self.scratch, &mut peel);
            self.stats.fragments += peel.came();
            let lines = &mut self.lines;
            peel.lists(|list| lines.surfaces(list));
            if !peel.more() {
                break;
            }
        }
        self.lines.end_line();
        self.stats.seconds.creation += clock.elapsed().as_secs_f64();
    }
}

impl Work<'_> {
    fn rasterize(&self, region: &Region, scratch: &mut Scratch, fragments: &mut impl Fragments) {
        let cut = &self.bins.cuts[region.tile as usize];
        let pitch = (region.x[1] - region.x[0]) as usize;
        let of = |range: [u32; 2]| range[0] / cut.size..range[1].div_ceil(cut.size);
        for row in of(region.y) {
            for column in of(region.x) {
                let number = cut.first + row * cut.bins + column;
                let bin = &self.bins.bins[number as usize];
                // Coordinates are the bin's, whatever part of it is wanted: the same bits each time.
                let within = |range: [u32; 2], first: u32, size: u32| {
                    [0, 1].map(|k: usize| range[k].clamp(first, first + size) - first)
                };
                let clip = Clip {
                    x: within(region.x, bin.x, bin.width),
                    y: within(region.y, bin.y, bin.height),
                };
                let row = bin.y as isize - region.y[0] as isize;
                let target = Target {
                    origin: row * pitch as isize + bin.x as isize - region.x[0] as isize,
                    pitch,
                };
                let source = Source {
                    triangles: self.triangles,
                    frame: self.frame,
                    grid: &cut.grid,
                    bin,
                    key: self.key,
                };
                for list in self.bins.lists(number) {
                    rasterize(self.isa, &source, list, clip, target, scratch, fragments);
                }
            }
        }
    }
}
