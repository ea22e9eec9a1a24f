//! Ray bundles: all pairs of surfaces that see each other along one direction, found in one pass (Tokuyoshi et al. 2013).
//!
//! Along a direction the whole scene is rasterized orthographically, keeping every surface on every line. Neighbours on a line see
//! each other, so light is exchanged both ways along each segment, and the sky comes in at the open ends. Where texels are dense, lines
//! must be dense: the window is analysed first and cut into tiles with resolutions of their own.
//!
//! * [`Triangles`]: the scene flattened, and the sides of all surfaces numbered ([`Sides`]);
//! * [`Radiance`]: what every side sends out; [`Sums`](crate::sums::Sums): what arrives;
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
mod bins;
mod closed;
mod fragments;
mod frame;
mod radiance;
mod raster;
mod tile;
mod transport;
mod triangles;

pub use analysis::Counting;
pub(crate) use closed::is_closed;
pub use frame::Directions;
pub use radiance::Radiance;
pub use triangles::{Sides, Triangles};

use crate::sums::{Sums, Unit};
use analysis::Maps;
use bins::Bins;
use fragments::{Fragments, ScanScatter};
use frame::Frame;
use glam::{Vec2, Vec3};
use occlude_render::geometry::covers;
use occlude_render::job::Job;
use raster::Projected;
use rayon::prelude::*;
use std::ops::{AddAssign, Range};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Instant;
use tile::{Bounds, Tiling};
use transport::{Counts, Exchange, Terms};

/// How bundles are cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Analysis pixels along a side of the window, a power of two. More: tiles follow the texels more closely, at more time a direction.
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
        }
    }
}

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
        let (sum, term) = (&mut self.seconds, other.seconds);
        sum.analysis += term.analysis;
        sum.mipmaps += term.mipmaps;
        sum.tiling += term.tiling;
        sum.creation += term.creation;
        sum.update += term.update;
    }
}

impl Stats {
    /// Seconds of all phases.
    pub fn total_seconds(&self) -> f64 {
        let s = self.seconds;
        s.analysis + s.mipmaps + s.tiling + s.creation + s.update
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

/// Gathers the light of a range of directions of one round into `sums`, all of whose sides are [`Triangles::sides`].
///
/// The sky arrives at the open ends of lines. The job's progress advances by one a direction; when it is cancelled, the direction at hand
/// is finished first: the number of directions that are in the sums is in the statistics.
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
    let mut bundle = Bundle {
        maps: Maps::new(settings.analysis),
        tiling: Tiling::default(),
        bins: Bins::default(),
    };
    for index in range {
        if job.is_cancelled() {
            break;
        }
        stats += bundle.gather(triangles, radiance, sky, directions, index, settings, sums);
        job.advance(1, 0);
    }
    stats
}

/// What is kept from direction to direction.
struct Bundle {
    maps: Maps,
    tiling: Tiling,
    bins: Bins,
}

impl Bundle {
    fn gather(
        &mut self,
        triangles: &Triangles,
        radiance: &Radiance,
        sky: Option<Sky>,
        directions: &Directions,
        index: u32,
        settings: &Settings,
        sums: &Sums,
    ) -> Stats {
        let mut stats = Stats {
            directions: 1,
            ..Stats::default()
        };
        let direction = directions.direction(index);
        let frame = Frame::new(&direction, triangles, settings.analysis);
        let mut clock = Instant::now();
        let mut lap = || {
            std::mem::replace(&mut clock, Instant::now())
                .elapsed()
                .as_secs_f64()
        };
        self.maps.render(triangles, &frame, settings.counting);
        stats.seconds.analysis = lap();
        self.maps.reduce();
        stats.seconds.mipmaps = lap();
        let bounds = Bounds {
            lines: settings.lines,
            nodes: settings.nodes,
            alpha: settings.alpha,
            factor: settings.factor,
        };
        self.tiling.descend(&self.maps, frame.pixel, &bounds);
        stats.seconds.tiling = lap();
        self.bins
            .fill(triangles, &frame, &self.tiling, direction.key);
        let along = direction.axes[2];
        let end = |towards: Vec3, salt: u32| {
            sky.map_or(0, |sky| {
                let chance = radiance::hash(direction.key ^ salt);
                radiance.pack(sky(towards), chance)
            })
        };
        let work = Work {
            triangles,
            frame: &frame,
            tiling: &self.tiling,
            bins: &self.bins,
            key: direction.key,
            exchange: Exchange {
                radiance: radiance.packed(),
                sides: triangles.sides(),
                sky: [end(-along, 1), end(along, 2)],
            },
        };
        stats.seconds.creation = lap();

        let next = AtomicUsize::new(0);
        let threads = rayon::current_num_threads();
        let parts: Vec<Stats> = (0..threads)
            .into_par_iter()
            .with_max_len(1)
            .map(|_| work.bins(&next, radiance, sums))
            .collect();
        let seconds = lap();
        stats.tiles = self.tiling.tiles.len() as u64;
        stats.lines = self
            .tiling
            .tiles
            .iter()
            .map(|t| u64::from(t.lines).pow(2))
            .sum();
        let mut sum = Stats::default();
        for part in parts {
            sum += part;
        }
        // What the threads clocked, as shares of the time that passed.
        let clocked = (sum.seconds.creation + sum.seconds.update).max(1e-12);
        stats.seconds.creation += seconds * sum.seconds.creation / clocked;
        stats.seconds.update += seconds * sum.seconds.update / clocked;
        sum.seconds = Seconds::default();
        stats += sum;
        stats
    }
}

/// One direction, shared by threads.
struct Work<'a> {
    triangles: &'a Triangles<'a>,
    frame: &'a Frame,
    tiling: &'a Tiling,
    bins: &'a Bins,
    key: u32,
    exchange: Exchange<'a>,
}

impl Work<'_> {
    /// Takes bins until none is left.
    fn bins(&self, next: &AtomicUsize, radiance: &Radiance, sums: &Sums) -> Stats {
        let mut terms = Terms::new(sums, radiance);
        let mut fragments = ScanScatter::default();
        let mut stats = Stats::default();
        loop {
            let number = next.fetch_add(1, Relaxed);
            let Some(bin) = self.bins.bins.get(number) else {
                break;
            };
            let list = self.bins.list(number);
            if list.is_empty() {
                continue;
            }
            let clock = Instant::now();
            let tile = &self.tiling.tiles[bin.tile as usize];
            fragments.begin((bin.width * bin.height) as usize);
            self.rasterize(bin, list, &mut fragments);
            let created = clock.elapsed().as_secs_f64();

            let spacing = tile.width * self.frame.pixel / tile.lines as f32;
            terms.set_weight(spacing * spacing / self.triangles.largest_area());
            let mut counts = Counts::default();
            let mut count = 0;
            fragments.lists(|_, list| {
                raster::sort(list);
                self.exchange.line(list, &mut terms, &mut counts);
                count += list.len() as u64;
            });
            stats.fragments += count;
            stats.pairs += counts.pairs;
            stats.exchanges += counts.exchanges;
            stats.seconds.creation += created;
            stats.seconds.update += clock.elapsed().as_secs_f64() - created;
        }
        let clock = Instant::now();
        terms.flush();
        stats.seconds.update += clock.elapsed().as_secs_f64();
        stats
    }

    fn rasterize(&self, bin: &bins::Bin, list: &[u32], fragments: &mut impl Fragments) {
        let grid = self.bins.grid(bin.tile);
        let size = [bin.width, bin.height];
        for &number in list {
            let block = &self.triangles.blocks()[number as usize / triangles::LANES];
            let corners = self
                .frame
                .corners(block, number as usize % triangles::LANES)
                .map(|c| {
                    Vec3::new(
                        grid.column(c.x) - bin.x as f32,
                        grid.row(c.y) - bin.y as f32,
                        c.z,
                    )
                });
            let triangle = Projected {
                corners,
                chart: *self.triangles.chart(number),
                lot: self.triangles.lot(number),
            };
            if self.triangles.is_filtered(number) {
                self.rasterize_filtered(&triangle, number, size, fragments);
            } else {
                raster::scan(&triangle, size, fragments, |_, _, _| true);
            }
        }
    }

    /// Cut-outs and blended materials: each fragment is asked whether it is there.
    fn rasterize_filtered(
        &self,
        triangle: &Projected,
        number: u32,
        size: [u32; 2],
        fragments: &mut impl Fragments,
    ) {
        let (instance, primitive) = self.triangles.origin(number);
        let [a, b, c] = triangle.corners;
        let (d1, d2) = (b - a, c - a);
        let per_area = 1.0 / (d1.x * d2.y - d2.x * d1.y);
        let mirrored = self.triangles.is_mirrored(number);
        raster::scan(triangle, size, fragments, |x, y, z| {
            let p = Vec2::new(x - a.x, y - a.y);
            let u = ((p.x * d2.y - p.y * d2.x) * per_area).clamp(0.0, 1.0);
            let v = ((d1.x * p.y - d1.y * p.x) * per_area).clamp(0.0, 1.0 - u);
            let (u, v) = if mirrored { (v, u) } else { (u, v) };
            let place = radiance::hash(z.to_bits() ^ radiance::hash(number ^ self.key));
            let chance = radiance::hash(place ^ x.to_bits() ^ y.to_bits().rotate_left(13));
            let chance = (chance >> 8) as f32 / (1 << 24) as f32;
            covers(
                self.triangles.scene,
                self.triangles.pose,
                instance,
                primitive,
                u,
                v,
                chance,
            )
        });
    }
}
