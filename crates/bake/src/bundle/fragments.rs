//! The surfaces that each line meets.
//!
//! A fragment is one word, so that sorting by it is sorting by depth, ties by side: the depth's ordered bits above, below them the
//! side of the light map that the surface's front is (31 bits), and whether the front faces along the line.
//!
//! Two layouts hold them, with one interface: [`LinkedList`] is the paper's, [`ScanScatter`] wastes no memory and is
//! the faster one on a CPU. Both have room for a fixed number of fragments; what finds no room is counted, and
//! whoever fills them must then ask again for fewer lines.

use super::raster::SPAN;

/// One surface on one line.
pub(super) type Fragment = u64;

/// The front faces along the line (towards growing depth).
pub(super) const ALONG: u32 = 1 << 31;

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
    /// Puts in the first `count` of eight fragments of neighbouring lines.
    fn put(&mut self, line: usize, eight: &[Fragment; SPAN], count: usize);
    /// Fragments that came.
    fn came(&self) -> u64;
    /// Fragments that found no room.
    fn dropped(&self) -> u64;
    /// Hands out the fragments of every line that has some, in no order of depth.
    fn lists(&mut self, list: impl FnMut(&mut [Fragment]));
}

/// Counts the fragments of every line while they come, then moves each to its place (count, scan, scatter).
#[derive(Debug)]
pub(super) struct ScanScatter {
    room: usize,
    count: usize,
    dropped: u64,
    /// As they came, and the line of each.
    fragments: Vec<Fragment>,
    lines: Vec<u32>,
    counts: Vec<u32>,
    placed: Vec<Fragment>,
}

impl ScanScatter {
    /// Bytes of a fragment: as it came, its line, and in its place.
    pub const NODE_BYTES: u64 = 20;

    /// Bytes for `room` fragments and `lines` lines.
    pub fn bytes(room: u64, lines: u64) -> u64 {
        room * Self::NODE_BYTES + lines * 4 + 1024
    }

    /// Room for so many fragments; memory is taken as they come.
    pub fn new(room: usize) -> Self {
        Self {
            room,
            count: 0,
            dropped: 0,
            fragments: Vec::new(),
            lines: Vec::new(),
            counts: Vec::new(),
            placed: Vec::new(),
        }
    }

    /// More memory, or none is left.
    #[cold]
    fn grow(&mut self) -> bool {
        let most = self.room + SPAN;
        if self.fragments.len() >= most {
            return false;
        }
        let len = (2 * self.fragments.len()).max(1 << 12).min(most);
        // Exactly so much: doubling by the vector itself would pass the limit.
        self.fragments.reserve_exact(len - self.fragments.len());
        self.fragments.resize(len, 0);
        self.lines.reserve_exact(len - self.lines.len());
        self.lines.resize(len, 0);
        self.count + SPAN <= len
    }
}

impl Fragments for ScanScatter {
    fn begin(&mut self, lines: usize) {
        self.count = 0;
        self.dropped = 0;
        self.counts.clear();
        self.counts.resize(lines + SPAN, 0);
    }

    #[inline(always)]
    fn put(&mut self, line: usize, eight: &[Fragment; SPAN], count: usize) {
        if self.count + SPAN > self.fragments.len() && !self.grow() {
            self.dropped += count as u64;
            return;
        }
        self.fragments[self.count..self.count + SPAN].copy_from_slice(eight);
        let lines = &mut self.lines[self.count..self.count + SPAN];
        let counts = &mut self.counts[line..line + SPAN];
        for k in 0..SPAN {
            lines[k] = (line + k) as u32;
            counts[k] += u32::from(k < count);
        }
        self.count += count;
    }

    fn came(&self) -> u64 {
        self.count as u64 + self.dropped
    }

    fn dropped(&self) -> u64 {
        self.dropped
    }

    fn lists(&mut self, mut list: impl FnMut(&mut [Fragment])) {
        let mut end = 0;
        for count in &mut self.counts {
            let start = end;
            end += *count;
            *count = start;
        }
        if self.placed.len() < self.count {
            self.placed.reserve_exact(self.count - self.placed.len());
            self.placed.resize(self.count, 0);
        }
        for (&line, &fragment) in self.lines[..self.count].iter().zip(&self.fragments) {
            let place = &mut self.counts[line as usize];
            self.placed[*place as usize] = fragment;
            *place += 1;
        }
        let mut start = 0;
        for &end in &self.counts {
            let fragments = &mut self.placed[start..end as usize];
            start = end as usize;
            if !fragments.is_empty() {
                list(fragments);
            }
        }
    }
}

/// A head for every line, and nodes that point to the next: the paper's layout (Carpenter 1984; Yang et al. 2010).
#[derive(Debug)]
pub(super) struct LinkedList {
    room: usize,
    dropped: u64,
    heads: Vec<u32>,
    nodes: Vec<Fragment>,
    next: Vec<u32>,
    line: Vec<Fragment>,
}

/// The end of a list.
const END: u32 = u32::MAX;

impl LinkedList {
    /// Bytes for `room` nodes and `lines` lines.
    pub fn bytes(room: u64, lines: u64) -> u64 {
        room * 12 + lines * 4 + 1024
    }

    /// A buffer of so many nodes.
    pub fn new(room: usize) -> Self {
        Self {
            room,
            dropped: 0,
            heads: Vec::new(),
            nodes: Vec::with_capacity(room),
            next: Vec::with_capacity(room),
            line: Vec::new(),
        }
    }
}

impl Fragments for LinkedList {
    fn begin(&mut self, lines: usize) {
        self.dropped = 0;
        self.nodes.clear();
        self.next.clear();
        self.heads.clear();
        self.heads.resize(lines, END);
    }

    #[inline(always)]
    fn put(&mut self, line: usize, eight: &[Fragment; SPAN], count: usize) {
        for (head, &fragment) in self.heads[line..line + count].iter_mut().zip(eight) {
            if self.nodes.len() == self.room {
                self.dropped += 1;
                continue;
            }
            self.next.push(*head);
            *head = self.nodes.len() as u32;
            self.nodes.push(fragment);
        }
    }

    fn came(&self) -> u64 {
        self.nodes.len() as u64 + self.dropped
    }

    fn dropped(&self) -> u64 {
        self.dropped
    }

    fn lists(&mut self, mut list: impl FnMut(&mut [Fragment])) {
        for &head in &self.heads {
            if head == END {
                continue;
            }
            self.line.clear();
            let mut node = head;
            while node != END {
                self.line.push(self.nodes[node as usize]);
                node = self.next[node as usize];
            }
            list(&mut self.line);
        }
    }
}

/// The nearest fragments of a single line beyond those that were seen: so a line that meets more than any buffer holds is taken in
/// depth ranges.
#[derive(Debug)]
pub(super) struct Peel {
    room: usize,
    /// The last that was seen, and how many equal to it.
    seen: Option<(Fragment, usize)>,
    skip: usize,
    nearest: std::collections::BinaryHeap<Fragment>,
    more: bool,
}

impl Peel {
    /// Ranges of at most `room` fragments.
    pub fn new(room: usize) -> Self {
        Self {
            room: room.max(1),
            seen: None,
            skip: 0,
            nearest: std::collections::BinaryHeap::new(),
            more: false,
        }
    }

    /// Whether some were left for the next range.
    pub fn more(&self) -> bool {
        self.more
    }
}

impl Fragments for Peel {
    fn begin(&mut self, _: usize) {
        self.nearest.clear();
        self.more = false;
        self.skip = self.seen.map_or(0, |seen| seen.1);
    }

    fn put(&mut self, _: usize, eight: &[Fragment; SPAN], count: usize) {
        for &fragment in &eight[..count] {
            if let Some((last, _)) = self.seen {
                if fragment < last {
                    continue;
                }
                if fragment == last && self.skip > 0 {
                    self.skip -= 1;
                    continue;
                }
            }
            self.nearest.push(fragment);
            if self.nearest.len() > self.room {
                self.nearest.pop();
                self.more = true;
            }
        }
    }

    fn came(&self) -> u64 {
        self.nearest.len() as u64
    }

    fn dropped(&self) -> u64 {
        0
    }

    fn lists(&mut self, mut list: impl FnMut(&mut [Fragment])) {
        let mut fragments = std::mem::take(&mut self.nearest).into_sorted_vec();
        if let Some(&last) = fragments.last() {
            let equal = fragments.iter().filter(|&&f| f == last).count();
            let before = self
                .seen
                .filter(|seen| seen.0 == last)
                .map_or(0, |seen| seen.1);
            self.seen = Some((last, before + equal));
            list(&mut fragments);
        }
    }
}

/// Sorts by depth. Most lines meet few surfaces: those are sorted by networks, whose comparisons nobody has to predict (Knuth, The Art
/// of Computer Programming 3, section 5.3.4).
#[inline(always)]
pub(super) fn sort(f: &mut [Fragment]) {
    /// Puts the smaller of two first, for each pair.
    #[inline(always)]
    fn network<const N: usize>(f: &mut [Fragment], pairs: &[(usize, usize)]) {
        let Some(f) = f.first_chunk_mut::<N>() else {
            return;
        };
        for &(i, j) in pairs {
            let (a, b) = (f[i], f[j]);
            (f[i], f[j]) = (a.min(b), a.max(b));
        }
    }
    match f.len() {
        0 | 1 => {}
        2 => network::<2>(f, &[(0, 1)]),
        3 => network::<3>(f, &[(0, 2), (0, 1), (1, 2)]),
        4 => network::<4>(f, &[(0, 2), (1, 3), (0, 1), (2, 3), (1, 2)]),
        5 => network::<5>(
            f,
            &[
                (0, 3),
                (1, 4),
                (0, 2),
                (1, 3),
                (0, 1),
                (2, 4),
                (1, 2),
                (3, 4),
                (2, 3),
            ],
        ),
        6 => network::<6>(
            f,
            &[
                (0, 5),
                (1, 3),
                (2, 4),
                (1, 2),
                (3, 4),
                (0, 3),
                (2, 5),
                (0, 1),
                (2, 3),
                (4, 5),
                (1, 2),
                (3, 4),
            ],
        ),
        7 => network::<7>(
            f,
            &[
                (0, 6),
                (2, 3),
                (4, 5),
                (0, 2),
                (1, 4),
                (3, 6),
                (0, 1),
                (2, 5),
                (3, 4),
                (1, 2),
                (4, 6),
                (2, 3),
                (4, 5),
                (1, 2),
                (3, 4),
                (5, 6),
            ],
        ),
        8 => network::<8>(
            f,
            &[
                (0, 2),
                (1, 3),
                (4, 6),
                (5, 7),
                (0, 4),
                (1, 5),
                (2, 6),
                (3, 7),
                (0, 1),
                (2, 3),
                (4, 5),
                (6, 7),
                (2, 4),
                (3, 5),
                (1, 4),
                (3, 6),
                (1, 2),
                (3, 4),
                (5, 6),
            ],
        ),
        9..=24 => {
            for i in 1..f.len() {
                let fragment = f[i];
                let mut j = i;
                while j > 0 && f[j - 1] > fragment {
                    f[j] = f[j - 1];
                    j -= 1;
                }
                f[j] = fragment;
            }
        }
        _ => f.sort_unstable(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_testkit::random::Random;

    #[test]
    fn all_lengths_are_sorted() {
        let mut random = Random(3);
        for length in 0..40 {
            // Zeros and ones tell whether a network sorts everything (Knuth's 0-1 principle); then others.
            for k in 0..4096_u64 {
                let mut f: Vec<Fragment> = (0..length)
                    .map(|i| match length {
                        0..=12 => k >> i & 1,
                        _ => random.bits() % 50,
                    })
                    .collect();
                let mut expected = f.clone();
                expected.sort_unstable();
                sort(&mut f);
                assert_eq!(f, expected);
            }
        }
    }
}
