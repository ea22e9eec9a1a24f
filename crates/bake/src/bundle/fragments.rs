//! The surfaces that each line meets.
//!
//! A fragment is one word, so that sorting by it is sorting by depth, ties by side: the depth's ordered bits above, below them the
//! side of the light map that the surface's front is (31 bits), and whether the front faces along the line.

/// One surface on one line.
pub(super) type Fragment = u64;

/// The front faces along the line (towards growing depth).
pub(super) const ALONG: u32 = 1 << 31;

/// Makes a fragment. `front` is below 2^31.
#[inline(always)]
pub(super) fn fragment(depth: f32, front: u32) -> Fragment {
    let bits = depth.to_bits();
    // Negative floats are ordered backwards.
    let ordered = bits ^ ((bits as i32 >> 31) as u32 | 1 << 31);
    u64::from(ordered) << 32 | u64::from(front)
}

/// The front's side, and whether it faces along the line.
#[inline(always)]
pub(super) fn front(fragment: Fragment) -> (u32, bool) {
    let low = fragment as u32;
    (low & !ALONG, low & ALONG != 0)
}

/// Keeps the fragments of a rectangle of lines until all are there.
pub(super) trait Fragments {
    /// Starts anew for so many lines.
    fn begin(&mut self, lines: usize);
    /// Puts one in.
    fn put(&mut self, line: usize, fragment: Fragment);
    /// Hands out the fragments of every line that has some, in any order of depth.
    fn lists(&mut self, list: impl FnMut(usize, &mut [Fragment]));
}

/// Counts the fragments of every line while they come, then moves each to its place: memory is exact, nothing overflows.
#[derive(Debug, Default)]
pub(super) struct ScanScatter {
    came: Vec<(u32, Fragment)>,
    counts: Vec<u32>,
    placed: Vec<Fragment>,
}

impl Fragments for ScanScatter {
    fn begin(&mut self, lines: usize) {
        self.came.clear();
        self.counts.clear();
        self.counts.resize(lines, 0);
    }

    #[inline(always)]
    fn put(&mut self, line: usize, fragment: Fragment) {
        self.counts[line] += 1;
        self.came.push((line as u32, fragment));
    }

    fn lists(&mut self, mut list: impl FnMut(usize, &mut [Fragment])) {
        let mut end = 0;
        for count in &mut self.counts {
            let start = end;
            end += *count;
            *count = start;
        }
        self.placed.clear();
        self.placed.resize(self.came.len(), 0);
        for &(line, fragment) in &self.came {
            let place = &mut self.counts[line as usize];
            self.placed[*place as usize] = fragment;
            *place += 1;
        }
        let mut start = 0;
        for (line, &end) in self.counts.iter().enumerate() {
            let fragments = &mut self.placed[start..end as usize];
            start = end as usize;
            if !fragments.is_empty() {
                list(line, fragments);
            }
        }
    }
}
