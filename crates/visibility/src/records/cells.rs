//! Who answers for a place: cells of space that know the records near them.
//!
//! All threads share the cells. What a cell knows is a pure function of the cell and of the records, so it does not matter who asked first;
//! a cell is filled once, by the tree of records, and forgotten when a record near it comes or goes. A place takes, of the
//! [`RANKED`] records nearest to the middle of its cell, those that are best by Eq. 2 (`ranking`). Many places go together, so that their cells come
//! from memory at the same time.
//!
//! The wrong tool where records stand far closer together than cells are wide: a cell then knows those around its middle alone.

use super::map::Stand;
use super::neighbours::Index;
use super::ranking::{Candidates, Nearby, RANKED, TOGETHER, best_of_all};
use super::settings::Falloff;
use crate::wide::{Machine, wide};
use glam::{IVec3, Vec3};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Records that are visited in search of them.
const VISITED: usize = 64;

/// Places in the table where a cell may lie.
const PROBES: usize = 8;

/// Cells in the table, for every record that there may be, and at most.
const CELLS_A_RECORD: usize = 48;
const MOST_CELLS: usize = 1 << 18;

/// Bytes of cells for every record that there may be.
pub(super) const BYTES_A_RECORD: u64 = 2 * (CELLS_A_RECORD * size_of::<Slot>()) as u64;

/// A cell of space and a side of surfaces.
type Key = (IVec3, u32);

/// What is known of a cell.
#[derive(Clone, Copy, Debug)]
struct Near {
    key: Key,
    candidates: Candidates,
    /// Farthest from the cell's middle of those that were looked at; infinite if there are no more. What is farther away makes no
    /// difference to the cell.
    reach: f32,
}

/// A cell in the table: one cache line.
#[derive(Debug, Default)]
#[repr(align(64))]
struct Slot(OnceLock<Near>);

const _: () = assert!(size_of::<Slot>() == 64);

/// A change of the records.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    /// Where a record has been taken away.
    pub(super) removed: Option<Vec3>,
    /// Where one has been added.
    pub(super) added: Option<Vec3>,
}

/// The cells that have been asked about.
#[derive(Debug)]
pub(super) struct Cells {
    machine: Machine,
    slots: Vec<Slot>,
    /// A bit for every slot that has been filled: far fewer than there are.
    filled: Vec<AtomicU64>,
    width: f32,
    /// Changes that the table does not know of yet.
    pending: Vec<Change>,
}

impl Cells {
    /// For so many records at most.
    pub(super) fn new(capacity: u32) -> Self {
        let wanted = (capacity as usize * CELLS_A_RECORD).next_power_of_two();
        let count = wanted.min(MOST_CELLS);
        Self {
            machine: Machine::detect(),
            slots: (0..count).map(|_| Slot::default()).collect(),
            filled: (0..count.div_ceil(64)).map(|_| AtomicU64::new(0)).collect(),
            width: 1.0,
            pending: Vec::new(),
        }
    }

    /// Forgets everything; cells are `width` wide from now on.
    pub(super) fn clear(&mut self, width: f32) {
        self.width = width;
        self.pending.clear();
        self.forget(|_| true);
    }

    /// Forgets some of the cells.
    fn forget(&mut self, mut stale: impl FnMut(&Near) -> bool) {
        for (word, slots) in self.filled.iter_mut().zip(self.slots.chunks_mut(64)) {
            let word = word.get_mut();
            let mut rest = *word;
            while rest != 0 {
                let k = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                if slots[k].0.get().is_none_or(&mut stale) {
                    slots[k].0.take();
                    *word &= !(1 << k);
                }
            }
        }
    }

    /// Takes note of a change; the table serves nobody until [`Self::freshen`] has been called.
    pub(super) fn changed(&mut self, change: Change) {
        self.pending.push(change);
    }

    /// Forgets the cells that noted changes concern.
    pub(super) fn freshen(&mut self) {
        let pending = std::mem::take(&mut self.pending);
        if pending.is_empty() {
            return;
        }
        let width = self.width;
        self.forget(|near| {
            let middle = (near.key.0.as_vec3() + 0.5) * width;
            let mut places = pending
                .iter()
                .flat_map(|c| c.removed.iter().chain(&c.added));
            places.any(|place| place.distance(middle) <= near.reach)
        });
    }

    /// The records that answer for places with normals.
    pub(super) fn choose(
        &self,
        index: &Index,
        stands: &[Stand],
        falloff: Falloff,
        places: &[(Vec3, Vec3)],
        choices: &mut [Nearby],
    ) {
        let mut keys = [(IVec3::ZERO, 0); TOGETHER];
        let mut candidates = [Candidates::NONE; TOGETHER];
        for (places, choices) in places.chunks(TOGETHER).zip(choices.chunks_mut(TOGETHER)) {
            find_keys(self.machine, 1.0 / self.width, places, &mut keys);
            for &key in &keys[..places.len()] {
                self.fetch(key);
            }
            let candidates = &mut candidates[..places.len()];
            for (candidates, &key) in candidates.iter_mut().zip(&keys) {
                *candidates = match self.find(index, stands, key) {
                    Some(near) => near.candidates,
                    None => look_around(index, stands, self.width, key).candidates,
                };
            }
            best_of_all(self.machine, candidates, stands, falloff, places, choices);
        }
    }

    /// Asks memory for the place in the table where a cell most probably lies.
    #[inline]
    fn fetch(&self, key: Key) {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let slot = &self.slots[hash(key) as usize & (self.slots.len() - 1)];
            // SAFETY: SSE is part of x86-64, and a prefetch touches no memory that the program could observe.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(slot).cast()) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = key;
    }

    /// A cell in the table, filled if need be; `None`: there is no room, or the table is not up to date.
    #[inline]
    fn find(&self, index: &Index, stands: &[Stand], key: Key) -> Option<&Near> {
        if !self.pending.is_empty() {
            return None;
        }
        let first = hash(key) as usize;
        for k in 0..PROBES {
            let at = (first + k) & (self.slots.len() - 1);
            // Another thread may fill the slot first, for another cell.
            let near = self.slots[at].0.get_or_init(|| {
                self.filled[at / 64].fetch_or(1 << (at % 64), Relaxed);
                look_around(index, stands, self.width, key)
            });
            if near.key == key {
                return Some(near);
            }
        }
        None
    }
}

fn hash(key: Key) -> u64 {
    let mut h = u64::from(key.1);
    for c in key.0.to_array() {
        h = (h ^ u64::from(c.cast_unsigned())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 29;
    }
    (h.wrapping_mul(0xbf58_476d_1ce4_e5b9)) >> 40
}

/// The axis that a normal is nearest to.
#[inline(always)]
fn side(normal: Vec3) -> u32 {
    let a = normal.abs();
    let axis = if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    };
    2 * axis as u32 + u32::from(normal[axis] < 0.0)
}

/// Whether a record with this normal may serve a side.
fn serves(side: u32, normal: Vec3) -> bool {
    let along = normal[(side / 2) as usize];
    (if side % 2 == 1 { -along } else { along }) > -0.25
}

/// The records near the middle of a cell that look to its side.
#[cold]
fn look_around(index: &Index, stands: &[Stand], width: f32, key: Key) -> Near {
    let middle = (key.0.as_vec3() + 0.5) * width;
    let mut near = Near {
        key,
        candidates: Candidates::NONE,
        reach: f32::INFINITY,
    };
    let mut count = 0;
    let (mut farthest, mut looked_at) = (0.0, 0.0f32);
    for (visited, (id, distance)) in index.nearest(middle).enumerate() {
        looked_at = looked_at.max(distance);
        if serves(key.1, stands[id as usize].site.normal) {
            near.candidates.ids[count] = id as u16;
            farthest = distance;
            count += 1;
        }
        if count == RANKED || visited + 1 == VISITED {
            near.reach = looked_at;
            break;
        }
    }
    near.candidates.d_max = if near.reach.is_finite() {
        near.reach + width
    } else {
        1.25 * farthest + width
    };
    near
}

wide! {
    /// The cells that places lie in.
    fn find_keys(per_width: f32, places: &[(Vec3, Vec3)], keys: &mut [Key]) {
        for (&(position, normal), key) in places.iter().zip(keys) {
            // A large number leaves no room for fractions: the nearest whole number to what is half a cell lower. Beyond, and for what is no
            // number, all is one cell.
            let floor = |x: f32| {
                const LARGE: f32 = 12_582_912.0;
                const MOST: f32 = 4e6;
                let x = if x > -MOST { x } else { -MOST };
                let x = if x < MOST { x } else { MOST };
                ((x - 0.5) + LARGE).to_bits().cast_signed() - LARGE.to_bits().cast_signed()
            };
            let p = position * per_width;
            *key = (IVec3::new(floor(p.x), floor(p.y), floor(p.z)), side(normal));
        }
    }
}
