//! Where how many lines are needed, in pieces that fit the buffers (section 4.3 and appendix A of the paper).
//!
//! A tile of level i is 2^i analysis pixels wide. It needs `C_I = A I` lines (Eq. 1: area times importance); the buffers hold
//! `C_max = min(W^2, min over j >= i of alpha N / F(j))` (Eq. 3: heads, and nodes by the estimate of this and all coarser levels, since
//! the fine ones are noisy and the coarse ones biased). A tile that needs more is split; one that needs none is dropped.
//!
//! Program 1 of the paper as printed forgets what coarser levels said (`C_max = min(C_I, ..)` instead of `min(C_max, ..)`), so that
//! `C_I < C_max` could never hold; and at the finest level it caps the lines, which undersamples silently. Here tiles below
//! the analysis pixel are split further, with the pixel's own values. The GPU's one thread a pixel that descends by itself is a plain
//! descent here: the same tiles, each looked at once.

use super::analysis::Maps;

/// A square of lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tile {
    /// Corner, analysis pixels.
    pub x: f32,
    pub y: f32,
    /// Side, analysis pixels.
    pub width: f32,
    /// Lines along a side.
    pub lines: u32,
}

/// What the descent is bounded by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    /// Lines along a side at most: W.
    pub lines: u32,
    /// Nodes that the fragment buffer has: N.
    pub nodes: u32,
    /// Share of them that a prediction may use: alpha.
    pub alpha: f32,
    /// Lines per texel: importance is multiplied by it.
    pub factor: f32,
}

/// What is where in the window: an index into [`Tiling::tiles`], [`Tiling::splits`] or nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Place {
    #[default]
    Nothing,
    Tile(u32),
    Split(u32),
}

/// The tiles of a direction and how to find them.
#[derive(Debug, Default)]
pub(super) struct Tiling {
    pub tiles: Vec<Tile>,
    /// Four quarters: x then y.
    pub splits: Vec<[Place; 4]>,
    /// By split: lines along a side that the whole would have had, and what its empty quarters add to its mean number of fragments a
    /// line.
    wholes: Vec<(u32, f32)>,
    /// What covers the window.
    pub root: Option<Place>,
    /// Side of the window, analysis pixels.
    pub size: f32,
    /// What covers each cell of a coarse grid, row by row: a shorter way down than from the root.
    cells: Vec<Place>,
}

/// Cells along a side of the window.
const CELLS: u32 = 256;

/// A node of the descent.
#[derive(Clone, Copy)]
struct Node {
    level: usize,
    column: u32,
    row: u32,
    most: f32,
}

impl Tiling {
    /// Descends the maps. `pixel` is the side of an analysis pixel, metres.
    pub fn descend(&mut self, maps: &Maps, pixel: f32, bounds: &Bounds) {
        self.clear();
        let top = maps.importance.len() - 1;
        let node = Node {
            level: top,
            column: 0,
            row: 0,
            most: (f64::from(bounds.lines) * f64::from(bounds.lines)) as f32,
        };
        let root = self.node(maps, pixel, bounds, node);
        self.set_root(root, (1u32 << top) as f32);
    }

    /// `4^levels` tiles with `lines` lines along a side of each; the window is `size` analysis pixels wide.
    pub fn uniform(&mut self, size: f32, levels: u32, lines: u32) {
        self.clear();
        let root = self.even([0.0; 2], size, levels, lines);
        self.set_root(root, size);
    }

    fn even(&mut self, [x, y]: [f32; 2], width: f32, levels: u32, lines: u32) -> Place {
        if levels == 0 {
            return self.tile([x, y], width, lines);
        }
        let half = 0.5 * width;
        let quarters = [0, 1, 2, 3].map(|k| {
            let corner = [x + half * (k & 1) as f32, y + half * (k >> 1) as f32];
            self.even(corner, half, levels - 1, lines)
        });
        // More lines than a tile may have: no false alarm.
        self.split(quarters, f32::MAX, 0.0)
    }

    fn clear(&mut self) {
        self.tiles.clear();
        self.splits.clear();
        self.wholes.clear();
    }

    fn set_root(&mut self, root: Place, size: f32) {
        (self.root, self.size) = (Some(root), size);
        self.cells.resize((CELLS * CELLS) as usize, Place::Nothing);
        self.spread(root, 0, 0, CELLS);
    }

    /// Splits that the lines did not ask for and, going by the fragments that were found in every tile, the nodes did not
    /// either: false alarms (section 6 of the paper).
    pub fn false_alarms(&self, found: impl Fn(u32) -> u64, bounds: &Bounds) -> u64 {
        // Quarters come before their split.
        let mut means: Vec<f64> = Vec::with_capacity(self.splits.len());
        let mut alarms = 0;
        for (quarters, &(lines, empty)) in self.splits.iter().zip(&self.wholes) {
            let mean = |place: &Place| match *place {
                Place::Nothing => 0.0,
                Place::Tile(tile) => {
                    found(tile) as f64 / f64::from(self.tiles[tile as usize].lines).powi(2)
                }
                Place::Split(split) => means[split as usize],
            };
            let mean = f64::from(empty) + 0.25 * quarters.iter().map(mean).sum::<f64>();
            let fragments = mean * f64::from(lines).powi(2);
            alarms += u64::from(lines <= bounds.lines && fragments <= f64::from(bounds.nodes));
            means.push(mean);
        }
        alarms
    }

    /// With this root, for tests.
    #[cfg(test)]
    pub fn rooted(mut self, root: Place, size: f32) -> Self {
        self.set_root(root, size);
        self
    }

    /// Enters a place into the cells that it covers; what is smaller than a cell stays a split.
    fn spread(&mut self, place: Place, column: u32, row: u32, width: u32) {
        match place {
            Place::Split(split) if width > 1 => {
                let half = width / 2;
                for (k, quarter) in self.splits[split as usize].into_iter().enumerate() {
                    let k = k as u32;
                    self.spread(
                        quarter,
                        column + half * (k & 1),
                        row + half * (k >> 1),
                        half,
                    );
                }
            }
            place => {
                for row in row..row + width {
                    let start = (row * CELLS + column) as usize;
                    self.cells[start..start + width as usize].fill(place);
                }
            }
        }
    }

    /// The smallest place that holds a whole box, its corner and its width.
    #[inline(always)]
    pub fn holding(&self, low: [f32; 2], high: [f32; 2]) -> (Place, [f32; 2], f32) {
        let per_cell = CELLS as f32 / self.size;
        let cell = |x: f32| ((x * per_cell) as u32).min(CELLS - 1);
        let (column, row) = (cell(low[0]), cell(low[1]));
        let same = column == cell(high[0]) && row == cell(high[1]);
        let (mut place, mut corner, mut width) = if same {
            let width = self.size / CELLS as f32;
            let place = self.cells[(row * CELLS + column) as usize];
            (place, [column as f32 * width, row as f32 * width], width)
        } else {
            (self.root.unwrap_or(Place::Nothing), [0.0; 2], self.size)
        };
        while let Place::Split(split) = place {
            let half = 0.5 * width;
            let middle = [corner[0] + half, corner[1] + half];
            let (right, below) = (low[0] > middle[0], low[1] > middle[1]);
            if (!right && high[0] >= middle[0]) || (!below && high[1] >= middle[1]) {
                break;
            }
            place = self.splits[split as usize][usize::from(right) + 2 * usize::from(below)];
            corner[0] += if right { half } else { 0.0 };
            corner[1] += if below { half } else { 0.0 };
            width = half;
        }
        (place, corner, width)
    }

    fn node(&mut self, maps: &Maps, pixel: f32, bounds: &Bounds, node: Node) -> Place {
        let width = (1u32 << node.level) as f32;
        let index = (node.row << (maps.importance.len() - 1 - node.level)) + node.column;
        let importance = maps.importance[node.level][index as usize] * bounds.factor;
        if importance == 0.0 {
            return Place::Nothing;
        }
        let fragments = maps.fragments[node.level][index as usize];
        let most = node
            .most
            .min(bounds.alpha * bounds.nodes as f32 / fragments.max(1e-6));
        let area = (width * pixel) * (width * pixel);
        let needed = area * importance;
        let corner = [node.column as f32 * width, node.row as f32 * width];
        if let Some(lines) = fitting(needed, most) {
            return self.tile(corner, width, lines);
        }
        if node.level == 0 {
            return self.below(corner, width, needed, most);
        }
        let quarter = |tiling: &mut Self, k: u32| {
            let node = Node {
                level: node.level - 1,
                column: 2 * node.column + (k & 1),
                row: 2 * node.row + (k >> 1),
                most,
            };
            tiling.node(maps, pixel, bounds, node)
        };
        let quarters = [0, 1, 2, 3].map(|k| quarter(self, k));
        let size = 1u32 << (maps.importance.len() - 1 - (node.level - 1));
        let empty = |k: u32| {
            let index = (2 * node.row + (k >> 1)) * size + 2 * node.column + (k & 1);
            match quarters[k as usize] {
                Place::Nothing => 0.25 * maps.fragments[node.level - 1][index as usize],
                _ => 0.0,
            }
        };
        self.split(quarters, needed, (0..4).map(empty).sum())
    }

    /// Splits below the analysis pixel until the lines fit.
    fn below(&mut self, [x, y]: [f32; 2], width: f32, needed: f32, most: f32) -> Place {
        if let Some(lines) = fitting(needed, most) {
            return self.tile([x, y], width, lines);
        }
        let half = 0.5 * width;
        let quarters = [0, 1, 2, 3].map(|k| {
            let corner = [x + half * (k & 1) as f32, y + half * (k >> 1) as f32];
            self.below(corner, half, 0.25 * needed, most)
        });
        self.split(quarters, needed, 0.0)
    }

    fn tile(&mut self, [x, y]: [f32; 2], width: f32, lines: u32) -> Place {
        self.tiles.push(Tile { x, y, width, lines });
        Place::Tile(self.tiles.len() as u32 - 1)
    }

    fn split(&mut self, quarters: [Place; 4], needed: f32, empty: f32) -> Place {
        if quarters == [Place::Nothing; 4] {
            return Place::Nothing;
        }
        self.splits.push(quarters);
        self.wholes.push((needed.sqrt().ceil() as u32, empty));
        Place::Split(self.splits.len() as u32 - 1)
    }
}

/// Lines along a side, if their square is within `most`. A single line always fits: depth ranges serve those that meet too much.
fn fitting(needed: f32, most: f32) -> Option<u32> {
    // Rounded up; far beyond any buffer the float would not fit into an integer.
    let lines = needed.sqrt().ceil().max(1.0);
    (lines * lines <= most || needed <= 1.0).then_some(lines as u32)
}
