//! What earlier pictures of a sequence have learnt about many lights ([`Share::Frames`](super::Share)).
//!
//! Cells are places in the world, not on the screen, so while geometry stands still their answers stay right when the camera
//! moves. They are kept as a table with a row for every cell and a column for every block of lights: a tile looks up a row
//! once a cell, by one hash, and then reads the words of all its blocks one after the other.
//!
//! Within a picture nothing is written: tiles read what earlier pictures knew, and note down what they learn. Between pictures
//! the notes are entered in the order of passes and tiles. So the bytes of a sequence do not depend on the number of threads.
//!
//! Not in the paper, whose table is for one picture. The wrong tool for a single picture (nothing is read that was not noted before) and
//! for lights that are drawn anew each time.

use super::table::BlockWord;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// No row, no column.
pub(super) const NONE: u32 = u32::MAX;

/// Columns are added in steps of this many: 16 words are a cache line.
const COLUMNS: usize = 16;

/// The memory of a sequence.
#[derive(Debug, Default)]
pub(super) struct Past {
    /// Hash and row of each cell: open addressing, at most half full. Row [`NONE`]: empty.
    slots: Vec<(u64, u32)>,
    /// The picture that last had an eye in each row's cell.
    seen: Vec<AtomicU32>,
    /// The cell of each row.
    hashes: Vec<u64>,
    /// `width` words a row: known answers in the upper half, answers in the lower.
    words: Vec<u32>,
    width: usize,
    columns: Vec<Column>,
    /// Column by hash: looked up, never iterated.
    column_of: HashMap<u64, u32>,
    picture: u32,
    notes: Mutex<Vec<Note>>,
}

/// A block of lights, by the hash of its patches; 0 is free.
#[derive(Debug, Default)]
struct Column {
    hash: u64,
    /// Asked for in this picture.
    used: AtomicBool,
}

/// What a tile has learnt.
#[derive(Debug)]
pub(super) struct Note {
    /// Pass, tile, and number of the call: notes are entered in this order.
    pub order: (u32, u32, u32),
    /// By block of lights.
    pub blocks: Vec<(u64, Vec<Learnt>)>,
}

/// What is known about a block of lights from a cell, now that something has been traced.
#[derive(Clone, Copy, Debug)]
pub(super) struct Learnt {
    pub hash: u64,
    /// The cell's row, if it has one already.
    pub row: u32,
    pub answers: BlockWord,
}

impl Past {
    /// The column of a block of lights.
    pub fn column(&self, hash: u64) -> u32 {
        let Some(&column) = self.column_of.get(&hash) else {
            return NONE;
        };
        self.columns[column as usize].used.store(true, Relaxed);
        column
    }

    /// The rows of cells, [`NONE`] for new ones.
    pub fn rows(&self, hashes: &[u64], rows: &mut Vec<u32>) {
        rows.clear();
        rows.extend(hashes.iter().map(|&hash| {
            let row = self.row(hash);
            if row != NONE {
                self.seen[row as usize].store(self.picture, Relaxed);
            }
            row
        }));
    }

    fn row(&self, hash: u64) -> u32 {
        if self.slots.is_empty() {
            return NONE;
        }
        self.slots[self.place(hash)].1
    }

    fn place(&self, hash: u64) -> usize {
        let mask = self.slots.len() - 1;
        let mut place = hash as usize & mask;
        while self.slots[place].1 != NONE && self.slots[place].0 != hash {
            place = (place + 1) & mask;
        }
        place
    }

    /// What is known about a column's block from a row's cell.
    pub fn word(&self, row: u32, column: u32) -> BlockWord {
        let word = self.words[row as usize * self.width + column as usize];
        BlockWord {
            known: (word >> 16) as u16,
            visible: word as u16,
        }
    }

    /// Keeps a note until the picture is done.
    pub fn note(&self, note: Note) {
        let mut notes = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
        notes.push(note);
    }

    /// Enters the notes of the picture that is done, in at most about `limit` bytes.
    pub fn turn(&mut self, limit: usize) {
        let mut notes =
            std::mem::take(self.notes.get_mut().unwrap_or_else(PoisonError::into_inner));
        notes.sort_unstable_by_key(|note| note.order);
        self.turn_columns(&notes);
        let row_bytes = self.width * 4 + 8 + 4 + 4 * size_of::<(u64, u32)>();
        let limit = (limit / row_bytes).max(1);
        for note in &notes {
            for (block, learnt) in &note.blocks {
                if let Some(&column) = self.column_of.get(block) {
                    self.enter(column, learnt, limit);
                }
            }
        }
        self.forget_rows(limit);
        self.picture += 1;
    }

    /// Gives the columns of lights that nobody asks about any more to new lights.
    fn turn_columns(&mut self, notes: &[Note]) {
        let mut free = Vec::new();
        for (index, column) in self.columns.iter_mut().enumerate() {
            if !std::mem::take(column.used.get_mut()) {
                self.column_of.remove(&column.hash);
                column.hash = 0;
                free.push(index);
            }
        }
        let mut cleared = Vec::new();
        let mut free = free.into_iter();
        for (hash, _) in notes.iter().flat_map(|note| &note.blocks) {
            if self.column_of.contains_key(hash) {
                continue;
            }
            let index = match free.next() {
                Some(index) => {
                    cleared.push(index);
                    index
                }
                None => {
                    self.columns.push(Column::default());
                    self.columns.len() - 1
                }
            };
            self.columns[index].hash = *hash;
            self.column_of.insert(*hash, index as u32);
        }
        let width = self.columns.len().next_multiple_of(COLUMNS);
        if width > self.width {
            let mut words = vec![0; width * self.hashes.len()];
            if self.width > 0 {
                let rows = self.words.chunks_exact(self.width);
                for (new, old) in words.chunks_exact_mut(width).zip(rows) {
                    new[..old.len()].copy_from_slice(old);
                }
            }
            (self.words, self.width) = (words, width);
        }
        for row in self.words.chunks_exact_mut(self.width.max(1)) {
            cleared.iter().for_each(|&column| row[column] = 0);
        }
    }

    /// Where there are more than three quarters of `limit` rows, keeps those that were seen last, half of the limit at most.
    fn forget_rows(&mut self, limit: usize) {
        let count = self.hashes.len();
        if count <= limit / 4 * 3 {
            return;
        }
        let mut seen: Vec<u32> = self.seen.iter_mut().map(|seen| *seen.get_mut()).collect();
        let mut sorted = seen.clone();
        sorted.sort_unstable();
        let room = (limit / 2).clamp(1, count);
        // Rows of this picture find room in part.
        let oldest = sorted[count - room];
        let mut of_oldest = room - (count - sorted.partition_point(|&seen| seen <= oldest));
        let mut kept = 0;
        for row in 0..count {
            if seen[row] < oldest || (seen[row] == oldest && of_oldest == 0) {
                continue;
            }
            of_oldest -= usize::from(seen[row] == oldest);
            self.hashes[kept] = self.hashes[row];
            seen[kept] = seen[row];
            let (from, to) = (row * self.width, kept * self.width);
            self.words.copy_within(from..from + self.width, to);
            kept += 1;
        }
        self.hashes.truncate(kept);
        self.words.truncate(kept * self.width);
        seen.truncate(kept);
        self.seen = seen.into_iter().map(AtomicU32::new).collect();
        self.index();
    }

    /// Builds the hash table anew, a quarter full.
    fn index(&mut self) {
        let size = (4 * self.hashes.len()).next_power_of_two().max(64);
        self.slots.clear();
        self.slots.resize(size, (0, NONE));
        for row in 0..self.hashes.len() {
            let place = self.place(self.hashes[row]);
            self.slots[place] = (self.hashes[row], row as u32);
        }
    }

    /// Enters words of cells; what is known already stays.
    fn enter(&mut self, column: u32, learnt: &[Learnt], limit: usize) {
        for new in learnt {
            let row = match new.row {
                NONE => self.row_for(new.hash, limit),
                row => row,
            };
            if row == NONE {
                continue;
            }
            let word = &mut self.words[row as usize * self.width + column as usize];
            let fresh = new.answers.known & !(*word >> 16) as u16;
            *word |= u32::from(fresh) << 16 | u32::from(new.answers.visible & fresh);
        }
    }

    /// The row of a cell, a new one if need be; [`NONE`] if there is no room.
    fn row_for(&mut self, hash: u64, limit: usize) -> u32 {
        if self.slots.len() < 2 * (self.hashes.len() + 1) {
            self.index();
        }
        let place = self.place(hash);
        if self.slots[place].1 == NONE {
            if self.hashes.len() >= limit {
                return NONE;
            }
            self.slots[place] = (hash, self.hashes.len() as u32);
            self.hashes.push(hash);
            self.seen.push(AtomicU32::new(self.picture));
            self.words.resize(self.words.len() + self.width, 0);
        }
        self.slots[place].1
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let rows =
            self.hashes.capacity() * 8 + self.seen.capacity() * 4 + self.words.capacity() * 4;
        rows + self.slots.capacity() * size_of::<(u64, u32)>()
    }
}
