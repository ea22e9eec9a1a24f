//! Where the arrays over all sides live: in memory, or in files for light maps that are larger than memory.
//!
//! Light maps go out of core by the oldest means: what is read in order lives in mapped files and is let go of after each
//! stretch ([`Buffer::release`]); what is written at random is sorted first. Terms of bundles (`Spill`) are kept in a file, by windows of neighbouring
//! sums, and after some directions each window is brought to memory once and takes all of its terms. One map
//! stays in memory: the packed radiance that bundles read at random, 4 bytes a side, a third of a light map of floats.
//!
//! Sums are integers, so the order of their terms does not show: the same bytes as in memory.
//!
//! Wrong tool where memory suffices: every term is written and read once more. No paper; external distribution as in
//! Aggarwal and Vitter 1988.

use bytemuck::{Zeroable, cast_slice, cast_slice_mut};
use occlude_bvh::{Buffer, nameless_file};
use rayon::prelude::*;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Where arrays live.
#[derive(Clone, Debug, Default)]
pub struct Store {
    folder: Option<PathBuf>,
}

impl Store {
    /// In memory.
    pub fn memory() -> Self {
        Self::default()
    }

    /// In files without names in this folder: they are gone when the process ends.
    pub fn folder(folder: PathBuf) -> Self {
        Self {
            folder: Some(folder),
        }
    }

    /// Whether arrays are in files.
    pub fn is_on_disk(&self) -> bool {
        self.folder.is_some()
    }

    /// So many zeros.
    ///
    /// # Errors
    /// The file cannot be made, or has no room.
    pub fn zeroed<T: Zeroable + Copy>(&self, len: usize) -> io::Result<Buffer<T>> {
        match &self.folder {
            None => Ok(Buffer::zeroed(len)),
            Some(folder) => Buffer::in_folder(folder, len),
        }
    }

    /// Where terms for so many runs of sums wait; none for sums in memory.
    pub(crate) fn spill(&self, runs: usize) -> io::Result<Option<Spill>> {
        let of = |folder| Spill::new(nameless_file(folder)?, runs);
        self.folder.as_deref().map(of).transpose()
    }
}

/// Sides that are worked at between two releases, where all are read in order.
pub(crate) const STRETCH: u32 = 1 << 18;

/// Windows that sums are divided into at most.
pub(crate) const WINDOWS: usize = 64;

/// Words that are written and read together.
const EXTENT: usize = 1 << 14;

/// Words of the head of a block of terms.
const HEAD: usize = 3;

/// Terms on their way to sums on disk, in blocks for one run of sums each.
#[derive(Debug)]
pub(crate) struct Spill {
    file: Mutex<File>,
    /// Words of the file that are taken.
    end: AtomicU64,
    windows: Vec<Mutex<Window>>,
    runs_a_window: usize,
    failed: Mutex<Option<io::Error>>,
}

/// Neighbouring runs.
#[derive(Debug, Default)]
struct Window {
    /// Blocks that wait to be written: heads and terms.
    words: Vec<u64>,
    /// First words of extents in the file.
    extents: Vec<u64>,
}

/// What a block says about its terms.
pub(crate) type Tag = [f32; 4];

impl Spill {
    /// Bytes that wait in memory at most.
    pub const BYTES: u64 = (WINDOWS * EXTENT * size_of::<u64>()) as u64;

    fn new(file: File, runs: usize) -> io::Result<Self> {
        let runs_a_window = runs.div_ceil(WINDOWS).max(1);
        Ok(Self {
            file: Mutex::new(file),
            end: AtomicU64::new(0),
            windows: (0..runs.div_ceil(runs_a_window))
                .map(|_| Mutex::default())
                .collect(),
            runs_a_window,
            failed: Mutex::default(),
        })
    }

    /// Bytes in the file.
    pub fn bytes(&self) -> u64 {
        self.end.load(Relaxed) * size_of::<u64>() as u64
    }

    /// Keeps a block of terms for a run of sums. Of errors the first is kept, for [`Spill::check`].
    ///
    /// # Panics
    /// If there are more terms than an extent holds.
    pub fn push(&self, run: usize, tag: Tag, terms: &[u64]) {
        if terms.is_empty() {
            return;
        }
        assert!(HEAD + terms.len() <= EXTENT);
        let mut window = lock(&self.windows[run / self.runs_a_window]);
        if window.words.len() + HEAD + terms.len() > EXTENT {
            self.write(&mut window);
        }
        let bits = tag.map(|value| u64::from(value.to_bits()));
        let head = [
            (run as u64) << 32 | terms.len() as u64,
            bits[0] << 32 | bits[1],
            bits[2] << 32 | bits[3],
        ];
        window.words.extend(head);
        window.words.extend(terms);
    }

    fn write(&self, window: &mut Window) {
        // A head of no terms ends an extent.
        window.words.resize(EXTENT, 0);
        let first = self.end.fetch_add(EXTENT as u64, Relaxed);
        let mut file = lock(&self.file);
        let written = file
            .seek(SeekFrom::Start(first * size_of::<u64>() as u64))
            .and_then(|_| file.write_all(cast_slice(&window.words)));
        drop(file);
        match written {
            Ok(()) => window.extents.push(first),
            Err(error) => self.fail(error),
        }
        window.words.clear();
    }

    /// Hands on all blocks, window by window, those of a run one after the other; `rest` is called after each window. Nothing waits
    /// afterwards. Nobody may push meanwhile.
    pub fn settle(&self, enter: &(dyn Fn(usize, Tag, &[u64]) + Sync), rest: &dyn Fn()) {
        let mut words = vec![0_u64; EXTENT];
        for window in &self.windows {
            let mut window = lock(window);
            let extents = std::mem::take(&mut window.extents);
            let last = std::mem::take(&mut window.words);
            for first in extents {
                let mut file = lock(&self.file);
                let read = file
                    .seek(SeekFrom::Start(first * size_of::<u64>() as u64))
                    .and_then(|_| file.read_exact(cast_slice_mut(&mut words)));
                drop(file);
                match read {
                    Ok(()) => hand_on(&words, enter),
                    Err(error) => self.fail(error),
                }
            }
            hand_on(&last, enter);
            rest();
        }
        self.end.store(0, Relaxed);
    }

    fn fail(&self, error: io::Error) {
        lock(&self.failed).get_or_insert(error);
    }

    /// The first error so far.
    pub fn check(&self) -> io::Result<()> {
        match &*lock(&self.failed) {
            None => Ok(()),
            Some(error) => Err(io::Error::new(error.kind(), error.to_string())),
        }
    }
}

/// The blocks in `words`, by threads that have a run each.
fn hand_on(words: &[u64], enter: &(dyn Fn(usize, Tag, &[u64]) + Sync)) {
    let mut blocks = Vec::new();
    let mut rest = words;
    while let Some((&[head, low, high], after)) = rest.split_first_chunk::<HEAD>() {
        let (run, count) = ((head >> 32) as usize, head as u32 as usize);
        if count == 0 {
            break;
        }
        let (terms, after) = after.split_at(count);
        let half = |word: u64, shift: u32| f32::from_bits((word >> shift) as u32);
        let tag = [half(low, 32), half(low, 0), half(high, 32), half(high, 0)];
        blocks.push((run, tag, terms));
        rest = after;
    }
    blocks.sort_by_key(|&(run, ..)| run);
    let runs: Vec<_> = blocks.chunk_by(|a, b| a.0 == b.0).collect();
    runs.into_par_iter().with_max_len(1).for_each(|blocks| {
        for &(run, tag, terms) in blocks {
            enter(run, tag, terms);
        }
    });
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn every_term_comes_once() {
        let store = Store::folder(std::env::temp_dir());
        for runs in [1, 3, 200] {
            let spill = store.spill(runs).unwrap().unwrap();
            for _ in 0..2 {
                let mut expected = vec![(0_u64, 0_u64); runs];
                for number in 0..9000_u64 {
                    let run = (number * 7919 % runs as u64) as usize;
                    let terms: Vec<u64> = (0..number % 63).map(|k| number * 64 + k).collect();
                    spill.push(run, [run as f32, -0.5, 7e9, number as f32], &terms);
                    expected[run].0 += terms.len() as u64;
                    expected[run].1 += terms.iter().sum::<u64>();
                }
                assert!(spill.bytes() > 0 || runs == 200, "nothing reached the file");
                let found: Vec<Mutex<(u64, u64)>> = (0..runs).map(|_| Mutex::default()).collect();
                spill.settle(
                    &|run, tag, terms| {
                        assert_eq!(tag[..3], [run as f32, -0.5, 7e9]);
                        assert_eq!(tag[3], (terms[0] / 64) as f32);
                        let mut found = lock(&found[run]);
                        found.0 += terms.len() as u64;
                        found.1 += terms.iter().sum::<u64>();
                    },
                    &|| (),
                );
                spill.check().unwrap();
                let found: Vec<_> = found.iter().map(|found| *lock(found)).collect();
                assert_eq!(found, expected);
                spill.settle(&|_, _, _| panic!("they have been"), &|| ());
            }
        }
        assert!(Store::memory().spill(5).unwrap().is_none());
    }

    #[test]
    fn a_file_that_fails_is_told() {
        // Opened for reading alone: every write fails.
        let file = File::open("/dev/null").unwrap();
        let spill = Spill::new(file, 1).unwrap();
        let terms = vec![1; 100];
        for _ in 0..EXTENT / 100 + 1 {
            spill.push(0, [0.0; 4], &terms);
        }
        assert!(spill.check().is_err());
    }
}
