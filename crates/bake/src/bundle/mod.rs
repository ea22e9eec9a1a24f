//! Ray bundles: all pairs of surfaces that see each other along one direction, found in one pass (Tokuyoshi et al. 2013).
//!
//! Along a direction the whole scene is rasterized orthographically, keeping every surface on every line. Neighbours on a line see
//! each other, so light is exchanged both ways along each segment, and the sky comes in at the open ends. Where texels are dense, lines
//! must be dense: the window is analysed first and cut into tiles with resolutions of their own.
//!
//! * [`Triangles`]: the scene flattened, and the sides of all surfaces numbered ([`Sides`]);
//! * [`Radiance`]: what every side sends out; [`Sums`]: what arrives;
//! * [`gather`]: a range of directions of one round. Bounces go in rounds, each reading the map of the round before: feeding a running
//!   mean back converges like `k^-(1 - albedo)`, far too slowly.
//!
//! A line of a tile stands for the line area `a` of *its tile*; the estimate `E = pi sum(a L) / sum(a)` over the lines that hit a texel
//! is that of its uniformly chosen points and cosine-distributed directions. A texel gets about `cos(theta)` lines a direction at
//! factor 1, so most directions miss it or hit it once.
//!
//! Everything is exact in the order of terms: the same bytes at any number of threads and for any way of sharing directions out. Sums
//! depend on the tiles, and these on W, N and the analysis: those settings are part of a work.
//!
//! Wrong tool for scenes with far more triangles than texels (every direction transforms every triangle) and for glossy reflection.

// The lanes of several arrays are indexed alike.
#![allow(clippy::needless_range_loop)]

mod analysis;
mod backs;
mod bins;
mod closed;
mod fragments;
mod frame;
mod radiance;
mod raster;
mod tile;
mod transport;
mod triangles;
mod work;

pub use analysis::Counting;
pub(crate) use backs::{DIRECTIONS as BACKS_DIRECTIONS, FACTOR as BACKS_FACTOR};
pub(crate) use closed::is_closed;
pub use frame::Directions;
pub use radiance::Radiance;
pub use triangles::{MOST_SHARE, Sides, Triangles};

use crate::sums::{Sums, Unit};
use analysis::Maps;
use bins::Bins;
use fragments::{LinkedList, ScanScatter};
use glam::Vec3;
use occlude_render::job::Job;
use std::ops::{AddAssign, Range};
use transport::Exchange;
use work::{Bundle, Setting};

/// How fragments are kept until a tile is whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// Bin by bin: counted, scanned, scattered. The faster one, and the one that needs least memory.
    #[default]
    ScanScatter,
    /// A tile at a time in linked lists with a fixed buffer of nodes: the paper's.
    LinkedList,
}

/// Which tiles there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cutting {
    /// By importance and predicted memory: the paper's.
    #[default]
    Adaptive,
    /// `4^n` tiles of W x W lines, whatever is in them; 0: no tiling. What the paper is compared with, for measurements alone.
    Uniform(u32),
}

/// How bundles are cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Analysis pixels along a side of the window at most, a power of two; fewer where there are few texels. More: tiles follow the texels more closely, at more time a direction.
    pub analysis: u32,
    /// Lines along a side of a tile at most: the paper's W. More: fewer tiles, more lines where texels are sparse.
    pub lines: u32,
    /// Nodes of a tile at most: the paper's N.
    pub nodes: u32,
    /// Share of the nodes that a prediction may use: the paper's alpha.
    pub alpha: f32,
    /// Lines per texel and direction, seen along the normal. More: less noise a direction, at more time.
    pub factor: f32,
    /// How the analysis counts.
    pub counting: Counting,
    /// Which tiles there are.
    pub cutting: Cutting,
    /// How fragments are kept.
    pub layout: Layout,
    /// Split what overflows and do it again; otherwise drop what finds no room, as the paper does, which is for measurements alone.
    pub recover: bool,
    /// Entries of triangles in bins at a time, at most; does not change results. More: fewer passes over the triangles of large scenes.
    pub entries: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            analysis: 1024,
            lines: 1024,
            nodes: 5_000_000,
            alpha: 0.9,
            factor: 1.0,
            counting: Counting::default(),
            cutting: Cutting::default(),
            layout: Layout::default(),
            recover: true,
            entries: 1 << 26,
        }
    }
}

impl Settings {
    /// Bytes that gathering holds at most, beside triangles, radiance and sums, on so many threads.
    pub fn bytes(&self, triangles: u64, threads: u64) -> u64 {
        let entries = u64::from(self.entries).min(4 * triangles + u64::from(LEAST_ENTRIES));
        self.bytes_without_entries(threads) + Bins::ENTRY_BYTES * entries
    }

    fn bytes_without_entries(&self, threads: u64) -> u64 {
        let (lines, nodes) = (u64::from(self.lines).pow(2), u64::from(self.nodes));
        let fragments = match self.layout {
            Layout::ScanScatter => threads * ScanScatter::bytes(nodes / threads.max(1), BIN_LINES),
            Layout::LinkedList => threads * LinkedList::bytes(nodes, lines),
        };
        Maps::bytes(self.analysis, threads) + fragments + threads * Exchange::BYTES + TILING_BYTES
    }

    /// The settings for a process that may hold `limit` bytes in all. Whatever else it holds, the nodes take a sixteenth and the analysis
    /// a thirty-second of it, so that the same limit cuts the same tiles on any machine and with any number of threads. Entries
    /// change no results: [`Settings::entries_within`] says how many fit.
    pub fn for_limit(limit: u64) -> Self {
        let mut settings = Self::default();
        let nodes = (limit / 16 / ScanScatter::NODE_BYTES).min(u64::from(settings.nodes)) as u32;
        settings.nodes = nodes.max(LEAST_NODES);
        while settings.analysis > LEAST_ANALYSIS && Maps::bytes(settings.analysis, 1) > limit / 32 {
            settings.analysis /= 2;
        }
        settings.entries = LEAST_ENTRIES;
        settings
    }

    /// How many entries fit if gathering may hold `bytes` bytes.
    pub fn entries_within(&self, bytes: u64, threads: u64) -> u32 {
        let left = bytes.saturating_sub(self.bytes_without_entries(threads)) / Bins::ENTRY_BYTES;
        left.clamp(u64::from(LEAST_ENTRIES), u64::from(Self::default().entries)) as u32
    }
}

/// With fewer, most of the time goes into doing things again.
const LEAST_ENTRIES: u32 = 1 << 16;
const LEAST_NODES: u32 = 1 << 15;
const LEAST_ANALYSIS: u32 = 256;
/// Tiles, their bins, and the grid that finds them.
const TILING_BYTES: u64 = 4 << 20;
/// Lines of a bin.
const BIN_LINES: u64 = (bins::BIN * bins::BIN) as u64;

/// What a range of directions did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stats {
    /// Directions that were gathered whole.
    pub directions: u64,
    /// Lines.
    pub lines: u64,
    /// Surfaces on lines.
    pub fragments: u64,
    /// Segments whose ends are fronts that look at each other.
    pub pairs: u64,
    /// Values that baked fronts got from fronts: at most two a pair.
    pub exchanges: u64,
    /// Tiles.
    pub tiles: u64,
    /// Tiles that were split because more than the buffers hold was expected.
    pub splits: u64,
    /// Splits of tiles that would have had at most W x W lines and, as far as the fragments that were found tell, would have fitted.
    pub false_alarms: u64,
    /// Rectangles of lines whose fragments found no room.
    pub overflow_detected: u64,
    /// Fragments that found no room at first.
    pub nodes_dropped: u64,
    /// Fragments that are missing in the result: 0 unless [`Settings::recover`] is off.
    pub overflow_left: u64,
    /// Wall-clock seconds by phase.
    pub seconds: Seconds,
}

/// Wall-clock seconds by phase.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// Rendering the maps of importance and of fragments.
    pub analysis: f64,
    /// Their mipmaps.
    pub mipmaps: f64,
    /// Cutting tiles.
    pub tiling: f64,
    /// Listing triangles and rasterizing fragments.
    pub creation: f64,
    /// Of the creation, moving triangles and entering them into lists: their set-up.
    pub listing: f64,
    /// Of the creation, what overflowed and was done again.
    pub redone: f64,
    /// Sorting, exchange and sums.
    pub update: f64,
}

impl AddAssign for Stats {
    fn add_assign(&mut self, other: Self) {
        self.directions += other.directions;
        self.lines += other.lines;
        self.fragments += other.fragments;
        self.pairs += other.pairs;
        self.exchanges += other.exchanges;
        self.tiles += other.tiles;
        self.splits += other.splits;
        self.false_alarms += other.false_alarms;
        self.overflow_detected += other.overflow_detected;
        self.nodes_dropped += other.nodes_dropped;
        self.overflow_left += other.overflow_left;
        let (sum, term) = (&mut self.seconds, other.seconds);
        sum.analysis += term.analysis;
        sum.mipmaps += term.mipmaps;
        sum.tiling += term.tiling;
        sum.creation += term.creation;
        sum.listing += term.listing;
        sum.redone += term.redone;
        sum.update += term.update;
    }
}

impl Stats {
    /// Seconds of all phases.
    pub fn total_seconds(&self) -> f64 {
        let s = self.seconds;
        s.analysis + s.mipmaps + s.tiling + s.creation + s.update
    }

    /// Share of the time that was lost to overflow.
    pub fn redo_share(&self) -> f64 {
        self.seconds.redone / self.total_seconds().max(1e-12)
    }
}

/// Radiance of the sky along a unit vector.
pub type Sky<'a> = &'a (dyn Fn(Vec3) -> Vec3 + Sync);

/// The unit of sums that hold up to `directions` directions, if nothing is brighter than `brightest` (sky included).
pub fn unit(brightest: f32, directions: u32) -> Unit {
    // A line's weight is relative to the largest area that one side stands for, and a side gets lines for its projected area; overlapping surfaces
    // and chance may double that twice.
    Unit::new(brightest, 4.0 * directions.max(1) as f32)
}

/// Gathers the light of a range of directions of one round into `sums`, all of whose sides are [`Triangles::sides`]; first moments, too, if
/// the sums have some.
///
/// The sky arrives at the open ends of lines. The job's progress advances by one a direction; when it is cancelled, the direction at hand
/// is finished first: the number of directions that are in the sums is in the statistics. Of sums on disk see [`Sums::check`] afterwards.
///
/// # Panics
/// If `radiance` or `sums` are of another number of sides.
pub fn gather(
    triangles: &Triangles,
    radiance: &Radiance,
    sky: Option<Sky>,
    directions: &Directions,
    range: Range<u32>,
    settings: &Settings,
    job: &Job,
    sums: &Sums,
) -> Stats {
    assert_eq!(radiance.len(), triangles.sides().count());
    assert_eq!(sums.len(), triangles.sides().count());
    let mut stats = Stats::default();
    let mut bundle = Bundle::new(triangles, settings);
    for index in range {
        if job.is_cancelled() {
            break;
        }
        let direction = directions.direction(index);
        let along = direction.axes[2];
        let end = |towards: Vec3, salt: u32| {
            sky.map_or(0, |sky| {
                radiance.pack(sky(towards), radiance::hash(direction.key ^ salt))
            })
        };
        let sky = [end(-along, 1), end(along, 2)];
        let setting = Setting {
            triangles,
            direction,
            settings,
        };
        let exchange = || Exchange::new(triangles.sides(), radiance, sky, along, sums);
        stats += bundle.run(&setting, &exchange);
        if transport::wants_to_settle(sums) {
            transport::settle(sums);
        }
        job.advance(1, 0);
    }
    transport::settle(sums);
    stats
}
