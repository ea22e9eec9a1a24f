//! Which lines a triangle covers, and at what depth and texel.
//!
//! Rows of lines are cut with the edges. An edge is always reckoned from its lower end, so that the two triangles that
//! share it find the same crossing to the bit: a line that passes a closed surface meets it exactly once, and nothing leaks. A line on an
//! edge belongs to the triangle on its right, a row through a corner to the triangle above.
//!
//! Sixteen triangles are set up together, and a row of a triangle is filled eight lines at a time; the loops are written over lanes, and compiled
//! for each instruction set ([`Isa`]). No operation is fused, so all of them give the same bits.

use super::bins::{Bin, Grid};
use super::fragments::{ALONG, Fragment, Fragments};
use super::frame::Frame;
use super::triangles::{LANES, Triangles};

/// Lines of a row that are filled together.
pub(super) const SPAN: usize = 8;

/// Instruction sets that the loops are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Isa {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Isa {
    /// The best that this processor has.
    pub fn detect() -> Self {
        *Self::all().last().unwrap_or(&Self::Plain)
    }

    /// All that this processor has, the best last.
    pub fn all() -> Vec<Self> {
        #[cfg_attr(not(target_arch = "x86_64"), allow(unused_mut))]
        let mut all = vec![Self::Plain];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2");
            if avx2 {
                all.push(Self::Avx2);
            }
            if avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
            {
                all.push(Self::Avx512);
            }
        }
        all
    }
}

/// Makes `name(isa, args..)` of a function whose body is inlined: compiled once for every instruction set.
macro_rules! multiversion {
    ($(#[$meta:meta])* $vis:vis fn $name:ident $(<$generic:ident: $bound:path>)? ($($arg:ident: $type:ty),* $(,)?) $(-> $result:ty)? = $body:path) => {
        $(#[$meta])*
        $vis fn $name $(<$generic: $bound>)? (isa: $crate::bundle::raster::Isa, $($arg: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2 $(<$generic: $bound>)? ($($arg: $type),*) $(-> $result)? {
                    $body($($arg),*)
                }
                #[target_feature(enable = "avx2,avx512f,avx512vl,avx512dq,avx512bw")]
                fn avx512 $(<$generic: $bound>)? ($($arg: $type),*) $(-> $result)? {
                    $body($($arg),*)
                }
                match isa {
                    // SAFETY: `Isa` has only values that the processor was seen to have.
                    $crate::bundle::raster::Isa::Avx2 => return unsafe { avx2($($arg),*) },
                    // SAFETY: as above.
                    $crate::bundle::raster::Isa::Avx512 => return unsafe { avx512($($arg),*) },
                    $crate::bundle::raster::Isa::Plain => {}
                }
            }
            #[cfg(not(target_arch = "x86_64"))]
            let _ = isa;
            $body($($arg),*)
        }
    };
}
pub(super) use multiversion;

/// The smaller; the second if one is no number. Unlike [`f32::min`] a single instruction.
#[inline(always)]
pub(super) fn low(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger; the second if one is no number.
#[inline(always)]
pub(super) fn high(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

type Lanes = [f32; LANES];

/// What varies linearly over sixteen triangles.
struct Planes {
    at: Lanes,
    x: Lanes,
    y: Lanes,
    low: Lanes,
    high: Lanes,
}

impl Planes {
    const NONE: Self = Self {
        at: [0.0; LANES],
        x: [0.0; LANES],
        y: [0.0; LANES],
        low: [0.0; LANES],
        high: [0.0; LANES],
    };

    /// Through the values at the corners; the determinant is twice the area.
    #[inline(always)]
    fn set(&mut self, x: &[Lanes; 3], y: &[Lanes; 3], values: &[Lanes; 3], per_area: &Lanes) {
        for k in 0..LANES {
            let (d1, d2) = (values[1][k] - values[0][k], values[2][k] - values[0][k]);
            let dx = (d1 * (y[2][k] - y[0][k]) - d2 * (y[1][k] - y[0][k])) * per_area[k];
            let dy = (d2 * (x[1][k] - x[0][k]) - d1 * (x[2][k] - x[0][k])) * per_area[k];
            self.x[k] = dx;
            self.y[k] = dy;
            self.at[k] = values[0][k] - dx * x[0][k] - dy * y[0][k];
            self.low[k] = low(values[0][k], low(values[1][k], values[2][k]));
            self.high[k] = high(values[0][k], high(values[1][k], values[2][k]));
        }
    }

    /// The values of one triangle along a row.
    #[inline(always)]
    fn row(&self, lane: usize, y: f32) -> Row {
        Row {
            at: self.at[lane] + self.y[lane] * y,
            x: self.x[lane],
            low: self.low[lane],
            high: self.high[lane],
        }
    }
}

/// What varies linearly along a row.
struct Row {
    at: f32,
    x: f32,
    low: f32,
    high: f32,
}

impl Row {
    /// Slivers extrapolate wildly between their corners: the value stays within those of the corners.
    #[inline(always)]
    fn value(&self, x: f32) -> f32 {
        high(low(self.at + self.x * x, self.high), self.low)
    }
}

/// Sixteen triangles among the lines of a bin: line (i, j) is at (i, j).
struct Setup {
    x: [Lanes; 3],
    y: [Lanes; 3],
    z: [Lanes; 3],
    u: [Lanes; 3],
    v: [Lanes; 3],
    first_texel: [u32; LANES],
    stride: [u32; LANES],
    /// The corners from the lowest row to the highest: the first two, and slopes (columns a row) of the edges.
    a: [Lanes; 2],
    b: [Lanes; 2],
    long: Lanes,
    lower: Lanes,
    upper: Lanes,
    /// The middle corner is left of the long edge.
    left: [bool; LANES],
    /// Rows.
    first: [i32; LANES],
    end: [i32; LANES],
    along: [u32; LANES],
    depth: Planes,
    column: Planes,
    row: Planes,
    last_column: [i32; LANES],
    last_row: [i32; LANES],
}

/// Working memory.
pub(super) struct Scratch(Box<Setup>);

impl Default for Scratch {
    fn default() -> Self {
        let zero = [0.0; LANES];
        Self(Box::new(Setup {
            x: [zero; 3],
            y: [zero; 3],
            z: [zero; 3],
            u: [zero; 3],
            v: [zero; 3],
            first_texel: [0; LANES],
            stride: [0; LANES],
            a: [zero; 2],
            b: [zero; 2],
            long: zero,
            lower: zero,
            upper: zero,
            left: [false; LANES],
            first: [0; LANES],
            end: [0; LANES],
            along: [0; LANES],
            depth: Planes::NONE,
            column: Planes::NONE,
            row: Planes::NONE,
            last_column: [0; LANES],
            last_row: [0; LANES],
        }))
    }
}

/// A rectangle of a bin's lines: from column and row, up to but without column and row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clip {
    pub x: [u32; 2],
    pub y: [u32; 2],
}

/// Where fragments go: line (i, j) of the bin is number `origin + j * pitch + i` of the fragments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    pub origin: isize,
    pub pitch: usize,
}

/// What a bin is rasterized from.
pub(super) struct Source<'a> {
    pub triangles: &'a Triangles<'a>,
    pub frame: &'a Frame,
    pub grid: &'a Grid,
    pub bin: &'a Bin,
    /// Random bits of the direction.
    pub key: u32,
}

multiversion! {
    /// Puts the fragments of a list of triangles on the lines of a bin.
    pub(super) fn rasterize<F: Fragments>(
        source: &Source,
        list: &[u32],
        clip: Clip,
        target: Target,
        scratch: &mut Scratch,
        fragments: &mut F,
    ) = rasterize_lanes
}

#[inline(always)]
fn rasterize_lanes<F: Fragments>(
    source: &Source,
    list: &[u32],
    clip: Clip,
    target: Target,
    scratch: &mut Scratch,
    fragments: &mut F,
) {
    let setup = &mut *scratch.0;
    for list in list.chunks(LANES) {
        setup.fetch(source, list);
        setup.prepare(clip);
        for (lane, &number) in list.iter().enumerate() {
            if source.triangles.is_filtered(number) {
                setup.fill_filtered(lane, number, source, clip, target, fragments);
            } else {
                setup.fill(lane, clip, target, fragments);
            }
        }
    }
}

impl Setup {
    /// Moves the triangles among the lines.
    #[inline(always)]
    fn fetch(&mut self, source: &Source, list: &[u32]) {
        let triangles = source.triangles;
        let mut block = [[0.0; LANES]; 9];
        for (lane, &number) in list.iter().enumerate() {
            let from = &triangles.blocks()[number as usize / LANES];
            let column = number as usize % LANES;
            for k in 0..9 {
                block[k][lane] = from[k][column];
            }
            let chart = triangles.chart(number);
            for k in 0..3 {
                self.u[k][lane] = chart[k].x;
                self.v[k][lane] = chart[k].y;
            }
            let lot = triangles.lot(number);
            self.first_texel[lane] = lot.first;
            self.stride[lane] = lot.stride;
        }
        let window = source.frame.window(&block);
        self.z = source.frame.depths(&block);
        let (left, top) = (source.bin.x as f32, source.bin.y as f32);
        for k in 0..3 {
            for lane in 0..LANES {
                self.x[k][lane] = source.grid.column(window[k][lane]) - left;
                self.y[k][lane] = source.grid.row(window[3 + k][lane]) - top;
            }
        }
    }

    #[inline(always)]
    fn prepare(&mut self, clip: Clip) {
        let (x, y) = (&self.x, &self.y);
        let mut per_area = [0.0; LANES];
        let (clip_low, clip_high) = (clip.y[0] as f32, clip.y[1] as f32);
        for k in 0..LANES {
            let area = (x[1][k] - x[0][k]) * (y[2][k] - y[0][k])
                - (x[2][k] - x[0][k]) * (y[1][k] - y[0][k]);
            per_area[k] = 1.0 / area;
            self.along[k] = if area > 0.0 { ALONG } else { 0 };

            // From the lowest row to the highest. Which of two in the same row is first does not matter: no row cuts their edge.
            let (mut ax, mut ay, mut bx, mut by) = (x[0][k], y[0][k], x[1][k], y[1][k]);
            let (mut cx, mut cy) = (x[2][k], y[2][k]);
            let swap = ay > by;
            (ax, bx) = if swap { (bx, ax) } else { (ax, bx) };
            (ay, by) = if swap { (by, ay) } else { (ay, by) };
            let swap = by > cy;
            (bx, cx) = if swap { (cx, bx) } else { (bx, cx) };
            (by, cy) = if swap { (cy, by) } else { (by, cy) };
            let swap = ay > by;
            (ax, bx) = if swap { (bx, ax) } else { (ax, bx) };
            (ay, by) = if swap { (by, ay) } else { (ay, by) };
            self.a[0][k] = ax;
            self.a[1][k] = ay;
            self.b[0][k] = bx;
            self.b[1][k] = by;
            self.long[k] = (cx - ax) / (cy - ay);
            self.lower[k] = (bx - ax) / (by - ay);
            self.upper[k] = (cx - bx) / (cy - by);
            self.left[k] = (bx - ax) * (cy - ay) < (cx - ax) * (by - ay);
            let first = low(high(ay.ceil(), clip_low), clip_high);
            let end = low(high(cy.ceil(), clip_low), clip_high);
            // Nothing of what has no area, or corners that are no numbers.
            let end = if area.abs() > 0.0 && area.abs() < f32::INFINITY {
                end
            } else {
                0.0
            };
            // SAFETY: both are within the clip's rows.
            self.first[k] = unsafe { first.to_int_unchecked() };
            // SAFETY: as above.
            self.end[k] = unsafe { end.to_int_unchecked() };
        }
        self.depth.set(x, y, &self.z, &per_area);
        self.column.set(x, y, &self.u, &per_area);
        self.row.set(x, y, &self.v, &per_area);
        for k in 0..LANES {
            // A corner on a texel's far border belongs to the texel before it.
            let last = |plane: &Planes| {
                let last = high(plane.high[k].ceil() - 1.0, plane.low[k].floor());
                low(high(last, 0.0), 1e9)
            };
            // SAFETY: within 0 and 1e9.
            self.last_column[k] = unsafe { last(&self.column).to_int_unchecked() };
            // SAFETY: as above.
            self.last_row[k] = unsafe { last(&self.row).to_int_unchecked() };
            for plane in [&mut self.column, &mut self.row] {
                plane.low[k] = low(high(plane.low[k], 0.0), 1e9);
                plane.high[k] = low(high(plane.high[k], 0.0), 1e9);
            }
        }
    }

    /// First and end column of a row.
    #[inline(always)]
    fn span(&self, lane: usize, y: f32, clip: Clip) -> (i32, i32) {
        let far = self.a[0][lane] + self.long[lane] * (y - self.a[1][lane]);
        let near = if y < self.b[1][lane] {
            self.a[0][lane] + self.lower[lane] * (y - self.a[1][lane])
        } else {
            self.b[0][lane] + self.upper[lane] * (y - self.b[1][lane])
        };
        let (start, end) = if self.left[lane] {
            (near, far)
        } else {
            (far, near)
        };
        let (left, right) = (clip.x[0] as f32, clip.x[1] as f32);
        let inside = |x: f32| {
            let x = low(high(x.ceil(), left), right);
            // SAFETY: within the clip's columns.
            unsafe { x.to_int_unchecked::<i32>() }
        };
        (inside(start), inside(end))
    }

    /// The fragments of eight neighbouring lines.
    #[inline(always)]
    fn eight(&self, lane: usize, column: i32, rows: &[Row; 3]) -> [Fragment; SPAN] {
        let mut out = [0; SPAN];
        let (first, stride) = (self.first_texel[lane], self.stride[lane]);
        let (last_column, last_row) = (self.last_column[lane], self.last_row[lane]);
        let along = self.along[lane];
        for (k, out) in out.iter_mut().enumerate() {
            let x = (column + k as i32) as f32;
            let z = rows[0].value(x);
            // SAFETY: planes of the chart are within 0 and 1e9.
            let u: i32 = unsafe { rows[1].value(x).to_int_unchecked() };
            // SAFETY: as above.
            let v: i32 = unsafe { rows[2].value(x).to_int_unchecked() };
            let u = if u < last_column { u } else { last_column };
            let v = if v < last_row { v } else { last_row };
            let front = (v as u32)
                .wrapping_mul(stride)
                .wrapping_add(first + u as u32);
            let bits = z.to_bits();
            let ordered = bits ^ ((bits as i32 >> 31) as u32 | 1 << 31);
            *out = u64::from(ordered) << 32 | u64::from(front | along);
        }
        out
    }

    #[inline(always)]
    fn rows(&self, lane: usize, y: f32) -> [Row; 3] {
        [
            self.depth.row(lane, y),
            self.column.row(lane, y),
            self.row.row(lane, y),
        ]
    }

    #[inline(always)]
    fn fill(&self, lane: usize, clip: Clip, target: Target, fragments: &mut impl Fragments) {
        for row in self.first[lane]..self.end[lane] {
            let y = row as f32;
            let (start, end) = self.span(lane, y, clip);
            if start >= end {
                continue;
            }
            let rows = self.rows(lane, y);
            let line = target.origin + row as isize * target.pitch as isize;
            let mut column = start;
            while column < end {
                let eight = self.eight(lane, column, &rows);
                let count = (end - column).min(SPAN as i32);
                fragments.put((line + column as isize) as usize, &eight, count as usize);
                column += SPAN as i32;
            }
        }
    }

    /// Cut-outs and blended materials: each fragment is asked whether it is there.
    #[inline(never)]
    fn fill_filtered(
        &self,
        lane: usize,
        number: u32,
        source: &Source,
        clip: Clip,
        target: Target,
        fragments: &mut impl Fragments,
    ) {
        let (x, y): ([f32; 3], [f32; 3]) = (self.x.map(|x| x[lane]), self.y.map(|y| y[lane]));
        let (d1, d2) = ([x[1] - x[0], y[1] - y[0]], [x[2] - x[0], y[2] - y[0]]);
        let per_area = 1.0 / (d1[0] * d2[1] - d2[0] * d1[1]);
        let coverage = source.triangles.coverage(number);
        for row in self.first[lane]..self.end[lane] {
            let (start, end) = self.span(lane, row as f32, clip);
            let rows = self.rows(lane, row as f32);
            let line = target.origin + row as isize * target.pitch as isize;
            for column in start..end {
                let (px, py) = (column as f32 - x[0], row as f32 - y[0]);
                let u = ((px * d2[1] - py * d2[0]) * per_area).clamp(0.0, 1.0);
                let v = ((d1[0] * py - d1[1] * px) * per_area).clamp(0.0, 1.0 - u);
                let place = [
                    (source.bin.x as i32 + column) as u32,
                    (source.bin.y as i32 + row) as u32,
                ];
                if coverage.covers(u, v, place, source.bin.tile ^ source.key) {
                    let eight = self.eight(lane, column, &rows);
                    fragments.put((line + column as isize) as usize, &eight, 1);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
