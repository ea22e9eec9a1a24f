//! Which triangles may meet which lines: lists by bin, a rectangle of at most 64 x 64 lines of one tile.
//!
//! A bin's fragments fit the nearest caches, and bins are what threads share out. Bins and tiles are all of one direction at once: a triangle
//! is moved into the window once and entered wherever it covers a line or may do so. Lists are in the order of triangles, whatever
//! the number of threads.

use super::frame::Frame;
use super::radiance::hash;
use super::tile::{Place, Tile, Tiling};
use super::triangles::{LANES, Triangles};
use rayon::prelude::*;

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
    pub scale: f32,
    pub x: f32,
    pub y: f32,
    pub shift: [f32; 2],
}

impl Grid {
    pub fn new(tile: &Tile, key: u32) -> Self {
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
struct Cut {
    grid: Grid,
    lines: u32,
    first: u32,
    /// Bins along a side, and lines along a bin's.
    bins: u32,
    size: u32,
}

/// The bins of a direction with their triangles.
#[derive(Debug, Default)]
pub(super) struct Bins {
    pub bins: Vec<Bin>,
    cuts: Vec<Cut>,
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Bins {
    /// Cuts the tiles into bins and lists the triangles of each.
    pub fn fill(&mut self, triangles: &Triangles, frame: &Frame, tiling: &Tiling, key: u32) {
        self.bins.clear();
        self.cuts.clear();
        for (number, tile) in tiling.tiles.iter().enumerate() {
            let bins = tile.lines.div_ceil(BIN);
            let size = tile.lines.div_ceil(bins);
            self.cuts.push(Cut {
                grid: Grid::new(tile, key),
                lines: tile.lines,
                first: self.bins.len() as u32,
                bins,
                size,
            });
            for (row, column) in (0..bins).flat_map(|row| (0..bins).map(move |c| (row, c))) {
                let (x, y) = (column * size, row * size);
                self.bins.push(Bin {
                    tile: number as u32,
                    x,
                    y,
                    width: size.min(tile.lines.saturating_sub(x)),
                    height: size.min(tile.lines.saturating_sub(y)),
                });
            }
        }

        let this = &*self;
        let blocks = triangles.blocks();
        let share = blocks
            .len()
            .div_ceil(4 * rayon::current_num_threads())
            .max(64);
        let lists: Vec<Vec<[u32; 2]>> = blocks
            .par_chunks(share)
            .enumerate()
            .map(|(chunk, blocks)| {
                let mut pairs = Vec::new();
                for (number, block) in blocks.iter().enumerate() {
                    let first = (chunk * share + number) * LANES;
                    let count = LANES.min(triangles.len() - first);
                    let window = frame.window(block);
                    for lane in 0..count {
                        let triangle = Window {
                            x: [window[0][lane], window[1][lane], window[2][lane]],
                            y: [window[3][lane], window[4][lane], window[5][lane]],
                        };
                        this.enter(tiling, &triangle, (first + lane) as u32, &mut pairs);
                    }
                }
                pairs
            })
            .collect();

        self.starts.clear();
        self.starts.resize(self.bins.len() + 1, 0);
        for [bin, _] in lists.iter().flatten() {
            self.starts[*bin as usize + 1] += 1;
        }
        for bin in 0..self.bins.len() {
            self.starts[bin + 1] += self.starts[bin];
        }
        self.triangles.clear();
        self.triangles.resize(lists.iter().map(Vec::len).sum(), 0);
        let mut next = self.starts.clone();
        for [bin, triangle] in lists.into_iter().flatten() {
            let place = &mut next[bin as usize];
            self.triangles[*place as usize] = triangle;
            *place += 1;
        }
    }

    /// The triangles of a bin, in order.
    pub fn list(&self, bin: usize) -> &[u32] {
        &self.triangles[self.starts[bin] as usize..self.starts[bin + 1] as usize]
    }

    /// Where the lines of a tile are.
    pub fn grid(&self, tile: u32) -> &Grid {
        &self.cuts[tile as usize].grid
    }

    fn enter(&self, tiling: &Tiling, triangle: &Window, number: u32, pairs: &mut Vec<[u32; 2]>) {
        let [x, y] = [triangle.x, triangle.y];
        let low = [x[0].min(x[1]).min(x[2]), y[0].min(y[1]).min(y[2])];
        let high = [x[0].max(x[1]).max(x[2]), y[0].max(y[1]).max(y[2])];
        let mut stack = [(Place::Nothing, [0.0, 0.0], 0.0); 128];
        let Some(root) = tiling.root else { return };
        stack[0] = (root, [0.0, 0.0], tiling.size);
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (place, corner, width) = stack[top];
            match place {
                Place::Nothing => {}
                Place::Tile(tile) => {
                    self.enter_tile(tile, triangle, low, high, number, pairs);
                }
                Place::Split(split) => {
                    let half = 0.5 * width;
                    for (k, quarter) in tiling.splits[split as usize].iter().enumerate().rev() {
                        let corner = [
                            corner[0] + half * (k & 1) as f32,
                            corner[1] + half * (k >> 1) as f32,
                        ];
                        let overlaps =
                            (0..2).all(|a| low[a] <= corner[a] + half && high[a] >= corner[a]);
                        if overlaps && *quarter != Place::Nothing {
                            stack[top] = (*quarter, corner, half);
                            top += 1;
                        }
                    }
                }
            }
        }
    }

    fn enter_tile(
        &self,
        tile: u32,
        triangle: &Window,
        low: [f32; 2],
        high: [f32; 2],
        number: u32,
        pairs: &mut Vec<[u32; 2]>,
    ) {
        let cut = &self.cuts[tile as usize];
        let last = cut.lines as f32 - 1.0;
        // The lines within the box; none is the usual case of small triangles.
        let x0 = cut.grid.column(low[0]).ceil().max(0.0);
        let x1 = cut.grid.column(high[0]).floor().min(last);
        let y0 = cut.grid.row(low[1]).ceil().max(0.0);
        let y1 = cut.grid.row(high[1]).floor().min(last);
        if !(x0 <= x1 && y0 <= y1) {
            return;
        }
        let columns = [x0 as u32 / cut.size, x1 as u32 / cut.size];
        let rows = [y0 as u32 / cut.size, y1 as u32 / cut.size];
        let many = (columns[1] - columns[0]).max(rows[1] - rows[0]) > 1;
        for row in rows[0]..=rows[1] {
            for column in columns[0]..=columns[1] {
                if many && triangle.misses(cut, column, row) {
                    continue;
                }
                pairs.push([cut.first + row * cut.bins + column, number]);
            }
        }
    }
}

/// A triangle in the window.
struct Window {
    x: [f32; 3],
    y: [f32; 3],
}

impl Window {
    /// Whether some edge has the whole bin on its outer side, with a line to spare.
    fn misses(&self, cut: &Cut, column: u32, row: u32) -> bool {
        let x = self.x.map(|x| cut.grid.column(x));
        let y = self.y.map(|y| cut.grid.row(y));
        let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
        let half = 0.5 * cut.size as f32;
        let middle = [
            column as f32 * cut.size as f32 + half,
            row as f32 * cut.size as f32 + half,
        ];
        (0..3).any(|k| {
            let j = (k + 1) % 3;
            let (nx, ny) = (y[k] - y[j], x[j] - x[k]);
            let (nx, ny) = if area < 0.0 { (-nx, -ny) } else { (nx, ny) };
            let distance = nx * (middle[0] - x[k]) + ny * (middle[1] - y[k]);
            distance < -(nx.abs() + ny.abs()) * (half + 1.0)
        })
    }
}
