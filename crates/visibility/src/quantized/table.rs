//! Lossy tables: a newcomer overwrites whoever stands in its place.
//!
//! All words are atomics that are read and written whole and without order: a race costs a ray, never a wrong answer.
//! Nothing is ever cleared: the epoch is part of the digest.

use bytemuck::allocation::{try_zeroed_slice_box, zeroed_slice_box};
use std::hint::black_box;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

/// Whether the system would give that much. It does not touch what it gives, so asking costs nothing; but a compiler that sees memory
/// unused would not ask.
pub(super) fn is_there_memory(bytes: usize) -> bool {
    black_box(try_zeroed_slice_box::<u8>(bytes)).is_ok()
}

/// One answer a word: 30 bits of digest, the answer, and whether a check has found it wrong somewhere (Popov 2013, section
/// 4.1, has 31 bits and no checks). 0 is empty.
#[derive(Debug)]
pub(super) struct WordTable {
    words: Box<[AtomicU32]>,
}

/// What is remembered about a pair of patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Memory {
    pub visible: bool,
    /// Some ends of these patches see each other and some do not.
    pub contested: bool,
}

impl WordTable {
    /// A table of at most `bytes`, a power of two of words; at least one.
    pub fn new(bytes: usize) -> Self {
        let count = power_of_two(bytes / size_of::<AtomicU32>());
        Self {
            words: zeroed_slice_box(count),
        }
    }

    pub fn bytes(&self) -> usize {
        self.words.len() * size_of::<AtomicU32>()
    }

    fn word(&self, digest: u64) -> &AtomicU32 {
        &self.words[(digest >> 32) as usize & (self.words.len() - 1)]
    }

    pub fn get(&self, digest: u64) -> Option<Memory> {
        let word = self.word(digest).load(Relaxed);
        (word & !3 == tag(digest)).then_some(Memory {
            visible: word & 1 != 0,
            contested: word & 2 != 0,
        })
    }

    /// Stores an answer; returns whether another one had to go.
    pub fn put(&self, digest: u64, memory: Memory) -> bool {
        let word = self.word(digest);
        let before = word.load(Relaxed);
        let bits = u32::from(memory.visible) | u32::from(memory.contested) << 1;
        word.store(tag(digest) | bits, Relaxed);
        before != 0 && before & !3 != tag(digest)
    }

    /// Share of words that hold something.
    pub fn load(&self) -> f64 {
        let live = self.words.iter().filter(|w| w.load(Relaxed) != 0).count();
        live as f64 / self.words.len() as f64
    }
}

/// The upper 30 bits of a word; never 0, which means empty.
fn tag(digest: u64) -> u32 {
    ((digest as u32) << 2).max(4)
}

/// The answers of an eye cluster about a block of 16 lights in one word: 32 bits of digest, 16 that say which answers are
/// known, and 16 answers.
#[derive(Debug)]
pub(super) struct BlockTable {
    words: Box<[AtomicU64]>,
}

/// Answers about the 16 lights of a block. Bits of `visible` are 0 where `known`'s are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct BlockWord {
    pub known: u16,
    pub visible: u16,
}

impl BlockTable {
    /// A table of at most `bytes`, a power of two of words; at least one.
    pub fn new(bytes: usize) -> Self {
        let count = power_of_two(bytes / size_of::<AtomicU64>());
        Self {
            words: zeroed_slice_box(count),
        }
    }

    pub fn bytes(&self) -> usize {
        self.words.len() * size_of::<AtomicU64>()
    }

    fn word(&self, digest: u64) -> &AtomicU64 {
        &self.words[(digest >> 32) as usize & (self.words.len() - 1)]
    }

    pub fn get(&self, digest: u64) -> BlockWord {
        let word = self.word(digest).load(Relaxed);
        if word >> 32 == digest & 0xffff_ffff {
            BlockWord {
                known: (word >> 16) as u16,
                visible: word as u16,
            }
        } else {
            BlockWord::default()
        }
    }

    /// Stores what is known; returns whether another block's answers had to go.
    pub fn put(&self, digest: u64, answers: BlockWord) -> bool {
        let word = self.word(digest);
        let before = word.load(Relaxed);
        let tag = digest & 0xffff_ffff;
        let new = tag << 32 | u64::from(answers.known) << 16 | u64::from(answers.visible);
        word.store(new, Relaxed);
        before != 0 && before >> 32 != tag
    }

    /// Share of words that hold something.
    pub fn load(&self) -> f64 {
        let live = self.words.iter().filter(|w| w.load(Relaxed) != 0).count();
        live as f64 / self.words.len() as f64
    }
}

/// The largest power of two that is at most `n`, or 1.
fn power_of_two(n: usize) -> usize {
    n.checked_ilog2().map_or(1, |log| 1 << log)
}
