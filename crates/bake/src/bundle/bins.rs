//! Which triangles may meet which lines: lists by bin, a rectangle of at most 64 x 64 lines of one tile.
//!
//! A bin's fragments fit the nearest caches, and bins are what threads share out. Bins are those of all tiles of a direction at once: a triangle
//! is moved into the window once and entered wherever it covers a line or may do so. Sixteen triangles go together: usually one tile
//! holds them all, and those that fall between the lines drop out without being looked at one by one.

use super::frame::Frame;
use super::radiance::hash;
use super::raster::{Isa, high, low, multiversion};
use super::tile::{Place, Tile, Tiling};
use super::triangles::{LANES, Triangles};
use rayon::prelude::*;
use std::ops::Range;

/// Lines along a side of a bin at most.
pub(super) const BIN: u32 = 64;

/// A rectangle of lines of one tile.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bin {
    /// Index into the tiling's tiles.
    pub tile: u32,
    /// First column and row of lines.
    pub x: u32,
    pub y: u32,
    /// Columns and rows.
    pub width: u32,
    pub height: u32,
}

/// From the window to the lines of a tile: line (i, j) is at `(i, j)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    scale: f32,
    x: f32,
    y: f32,
    shift: [f32; 2],
}

impl Grid {
    fn new(tile: &Tile, key: u32) -> Self {
        // By place, not by number: what tile there is elsewhere does not matter.
        let random = hash(tile.x.to_bits() ^ hash(tile.y.to_bits() ^ hash(key)));
        let unit = |bits: u32| (bits & 0xffff) as f32 / 65536.0;
        Self {
            scale: tile.lines as f32 / tile.width,
            x: tile.x,
            y: tile.y,
            shift: [unit(random), unit(random >> 16)],
        }
    }

    #[inline(always)]
    pub fn column(&self, x: f32) -> f32 {
        (x - self.x) * self.scale - self.shift[0]
    }

    #[inline(always)]
    pub fn row(&self, y: f32) -> f32 {
        (y - self.y) * self.scale - self.shift[1]
    }
}

/// How a tile is cut into bins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    pub grid: Grid,
    pub lines: u32,
    /// Its first bin; rows of bins follow each other.
    pub first: u32,
    /// Bins along a side, and lines along a bin's.
    pub bins: u32,
    pub size: u32,
    per_size: f32,
}

/// The bins of a direction with their triangles.
#[derive(Debug, Default)]
pub(super) struct Bins {
    pub bins: Vec<Bin>,
    pub cuts: Vec<Cut>,
    lists: Vec<Lists>,
    first: u32,
}

/// What one share of the triangles entered.
#[derive(Debug, Default)]
struct Lists {
    /// Bin and triangle, as they came.
    pairs: Vec<[u32; 2]>,
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Lists {
    /// Sorts by bin, keeping the order of triangles.
    fn sort(&mut self, first: u32, bins: usize) {
        self.starts.clear();
        self.starts.resize(bins + 1, 0);
        for [bin, _] in &self.pairs {
            self.starts[(bin - first) as usize] += 1;
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        self.triangles.clear();
        self.triangles.resize(self.pairs.len(), 0);
        // From behind: what were ends become starts.
        for [bin, triangle] in self.pairs.iter().rev() {
            let place = &mut self.starts[(bin - first) as usize];
            *place -= 1;
            self.triangles[*place as usize] = *triangle;
        }
    }
}

impl Bins {
    /// Bytes for each triangle that is entered somewhere: as a pair, in a vector that doubles, and in a list.
    pub const ENTRY_BYTES: u64 = 20;

    /// Cuts the tiles into bins. `key`: random bits of the direction.
    pub fn cut(&mut self, tiling: &Tiling, key: u32) {
        self.bins.clear();
        self.cuts.clear();
        for (number, tile) in tiling.tiles.iter().enumerate() {
            let size = tile.lines.div_ceil(tile.lines.div_ceil(BIN));
            let bins = tile.lines.div_ceil(size);
            self.cuts.push(Cut {
                grid: Grid::new(tile, key),
                lines: tile.lines,
                first: self.bins.len() as u32,
                bins,
                size,
                per_size: 1.0 / size as f32,
            });
            for (row, column) in (0..bins).flat_map(|row| (0..bins).map(move |c| (row, c))) {
                let (x, y) = (column * size, row * size);
                self.bins.push(Bin {
                    tile: number as u32,
                    x,
                    y,
                    width: size.min(tile.lines - x),
                    height: size.min(tile.lines - y),
                });
            }
        }
    }

    /// The bins of some tiles.
    pub fn of_tiles(&self, tiles: &Range<u32>) -> Range<u32> {
        let first = |tile: u32| {
            let cut = self.cuts.get(tile as usize);
            cut.map_or(self.bins.len() as u32, |cut| cut.first)
        };
        first(tiles.start)..first(tiles.end)
    }

    /// Lists the triangles of the bins of some tiles. False, and nothing is listed, if more than `room` entries would come.
    pub fn fill(
        &mut self,
        isa: Isa,
        triangles: &Triangles,
        frame: &Frame,
        tiling: &Tiling,
        tiles: Range<u32>,
        room: usize,
    ) -> bool {
        let shares = rayon::current_num_threads();
        let mut lists = std::mem::take(&mut self.lists);
        lists.resize_with(shares, Lists::default);
        let blocks = triangles.blocks().len();
        let bins = self.of_tiles(&tiles);
        let this = &*self;
        let fits = lists
            .par_iter_mut()
            .with_max_len(1)
            .enumerate()
            .map(|(share, lists)| {
                let range = blocks * share / shares..blocks * (share + 1) / shares;
                lists.pairs.clear();
                let fits = enter(
                    isa,
                    this,
                    triangles,
                    frame,
                    tiling,
                    &tiles,
                    range,
                    room / shares,
                    &mut lists.pairs,
                );
                if fits {
                    lists.sort(bins.start, bins.len());
                }
                fits
            })
            .reduce(|| true, |a, b| a && b);
        self.lists = lists;
        self.first = bins.start;
        fits
    }

    /// The triangles of a bin, in order, in some pieces.
    pub fn lists(&self, bin: u32) -> impl Iterator<Item = &[u32]> {
        let bin = (bin - self.first) as usize;
        self.lists
            .iter()
            .map(move |lists| {
                &lists.triangles[lists.starts[bin] as usize..lists.starts[bin + 1] as usize]
            })
            .filter(|list| !list.is_empty())
    }

    /// Whether no triangle is in a bin.
    pub fn is_empty(&self, bin: u32) -> bool {
        self.lists(bin).next().is_none()
    }
}

multiversion! {
    /// Enters a range of blocks into the bins of some tiles; false if that takes more than `room` entries.
    fn enter(
        bins: &Bins,
        triangles: &Triangles,
        frame: &Frame,
        tiling: &Tiling,
        tiles: &Range<u32>,
        blocks: Range<usize>,
        room: usize,
        pairs: &mut Vec<[u32; 2]>,
    ) -> bool = enter_lanes
}

/// Sixteen triangles in the window, and the box of each.
struct Window {
    corners: [[f32; LANES]; 6],
    low: [[f32; LANES]; 2],
    high: [[f32; LANES]; 2],
}

/// A place, its corner and width, and which triangles reach it.
type Below = (Place, [f32; 2], f32, u32);

#[inline(always)]
fn enter_lanes(
    bins: &Bins,
    triangles: &Triangles,
    frame: &Frame,
    tiling: &Tiling,
    tiles: &Range<u32>,
    blocks: Range<usize>,
    room: usize,
    pairs: &mut Vec<[u32; 2]>,
) -> bool {
    let mut stack = Vec::new();
    for number in blocks {
        if pairs.len() > room {
            return false;
        }
        let corners = frame.window(&triangles.blocks()[number]);
        let mut window = Window {
            corners,
            low: [[0.0; LANES]; 2],
            high: [[0.0; LANES]; 2],
        };
        let (mut box_low, mut box_high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for axis in 0..2 {
            let [a, b, c] = [3 * axis, 3 * axis + 1, 3 * axis + 2];
            for lane in 0..LANES {
                let (a, b, c) = (corners[a][lane], corners[b][lane], corners[c][lane]);
                window.low[axis][lane] = low(a, low(b, c));
                window.high[axis][lane] = high(a, high(b, c));
            }
            // In halves, so that lanes are compared together.
            let (mut lows, mut highs) = (window.low[axis], window.high[axis]);
            for half in [8, 4, 2, 1] {
                for lane in 0..half {
                    lows[lane] = low(lows[lane], lows[lane + half]);
                    highs[lane] = high(highs[lane], highs[lane + half]);
                }
            }
            (box_low[axis], box_high[axis]) = (lows[0], highs[0]);
        }
        let first = number * LANES;
        let count = LANES.min(triangles.len() - first);
        match tiling.holding(box_low, box_high).0 {
            Place::Nothing => {}
            Place::Tile(tile) if tiles.contains(&tile) => {
                bins.enter_tile(tile, &window, first as u32, (1 << count) - 1, pairs);
            }
            Place::Tile(_) => {}
            Place::Split(_) => {
                let whole = tiling.holding(box_low, box_high);
                bins.enter_tiles(
                    tiling,
                    tiles,
                    &window,
                    whole,
                    (1 << count) - 1,
                    first as u32,
                    &mut stack,
                    pairs,
                );
            }
        }
    }
    true
}

impl Bins {
    /// Enters those of sixteen triangles that `mask` names wherever below a place they may meet lines.
    #[inline(always)]
    fn enter_tiles(
        &self,
        tiling: &Tiling,
        tiles: &Range<u32>,
        window: &Window,
        (place, corner, width): (Place, [f32; 2], f32),
        mask: u32,
        first: u32,
        stack: &mut Vec<Below>,
        pairs: &mut Vec<[u32; 2]>,
    ) {
        stack.clear();
        stack.push((place, corner, width, mask));
        while let Some((place, corner, width, mask)) = stack.pop() {
            match place {
                Place::Tile(tile) if tiles.contains(&tile) => {
                    self.enter_tile(tile, window, first, mask, pairs);
                }
                Place::Nothing | Place::Tile(_) => {}
                Place::Split(split) => {
                    let half = 0.5 * width;
                    for (k, quarter) in tiling.splits[split as usize].iter().enumerate() {
                        if *quarter == Place::Nothing {
                            continue;
                        }
                        let (x, y) = (
                            corner[0] + half * (k & 1) as f32,
                            corner[1] + half * (k >> 1) as f32,
                        );
                        let mut overlap = [0u32; LANES];
                        for lane in 0..LANES {
                            let overlaps = (window.low[0][lane] <= x + half)
                                & (window.high[0][lane] >= x)
                                & (window.low[1][lane] <= y + half)
                                & (window.high[1][lane] >= y);
                            overlap[lane] = u32::from(overlaps) << lane;
                        }
                        let mask = mask & overlap.iter().fold(0, |a, b| a | b);
                        if mask != 0 {
                            stack.push((*quarter, [x, y], half, mask));
                        }
                    }
                }
            }
        }
    }

    /// Enters those of sixteen triangles that `mask` names into the bins of one tile.
    #[inline(always)]
    fn enter_tile(
        &self,
        tile: u32,
        window: &Window,
        first: u32,
        mask: u32,
        pairs: &mut Vec<[u32; 2]>,
    ) {
        let cut = &self.cuts[tile as usize];
        let last = cut.lines as f32 - 1.0;
        // The lines within the box; none is the usual case of small triangles.
        let [mut x0, mut x1, mut y0, mut y1] = [[0.0; LANES]; 4];
        let mut meets = [0u32; LANES];
        for lane in 0..LANES {
            x0[lane] = high(cut.grid.column(window.low[0][lane]).ceil(), 0.0);
            x1[lane] = low(cut.grid.column(window.high[0][lane]).floor(), last);
            y0[lane] = high(cut.grid.row(window.low[1][lane]).ceil(), 0.0);
            y1[lane] = low(cut.grid.row(window.high[1][lane]).floor(), last);
            let some = (x0[lane] <= x1[lane]) & (y0[lane] <= y1[lane]);
            meets[lane] = u32::from(some) << lane;
        }
        let mut mask = mask & meets.iter().fold(0, |a, b| a | b);
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            // Half a line into the bin: no rounding can lead out of it.
            let bin = |x: f32| ((x + 0.5) * cut.per_size) as u32;
            let columns = [bin(x0[lane]), bin(x1[lane])];
            let rows = [bin(y0[lane]), bin(y1[lane])];
            let many = (columns[1] - columns[0]).max(rows[1] - rows[0]) > 1;
            for row in rows[0]..=rows[1] {
                for column in columns[0]..=columns[1] {
                    if many && misses(window, lane, cut, column, row) {
                        continue;
                    }
                    let bin = cut.first + row * cut.bins + column;
                    pairs.push([bin, first + lane as u32]);
                }
            }
        }
    }
}

/// Whether some edge has a whole bin on its outer side, with a line to spare.
fn misses(window: &Window, lane: usize, cut: &Cut, column: u32, row: u32) -> bool {
    let x = [0, 1, 2].map(|k| cut.grid.column(window.corners[k][lane]));
    let y = [3, 4, 5].map(|k| cut.grid.row(window.corners[k][lane]));
    let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
    let half = 0.5 * cut.size as f32;
    let middle = [column, row].map(|c| c as f32 * cut.size as f32 + half);
    (0..3).any(|k| {
        let j = (k + 1) % 3;
        let (nx, ny) = (y[k] - y[j], x[j] - x[k]);
        let (nx, ny) = if area < 0.0 { (-nx, -ny) } else { (nx, ny) };
        let distance = nx * (middle[0] - x[k]) + ny * (middle[1] - y[k]);
        distance < -(nx.abs() + ny.abs()) * (half + 1.0)
    })
}
