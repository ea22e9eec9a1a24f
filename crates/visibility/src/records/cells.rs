//! Who answers for a place: cells of space that know the records near them.
//!
//! All threads share the cells. What a cell knows is a pure function of the cell and of the records, so it does not matter who asked first;
//! a cell is filled once, by the tree of records, and forgotten when a record near it comes or goes. A place takes, of the
//! [`REMEMBERED`] records nearest to the middle of its cell, the [`COMPARED`] nearest to itself, and of these the best by Eq. 2: all at
//! once (compiled for AVX2, too, with the same results to the bit).
//!
//! The wrong tool where records stand far closer together than cells are wide: a cell then knows those around its middle alone.

use super::map::Stand;
use super::neighbours::{Index, NOBODY, weight};
use super::settings::Falloff;
use glam::{IVec3, Vec3};
use std::sync::OnceLock;

/// Records that are remembered of a cell.
const REMEMBERED: usize = 16;

/// The nearest of them to a place, whose weights are compared.
const COMPARED: u32 = 6;

/// Records that are visited in search of them.
const VISITED: usize = 64;

/// Places in the table where a cell may lie.
const PROBES: usize = 8;

/// Cells in the table, for every record that there may be, and at most.
const CELLS_A_RECORD: usize = 48;
const MOST_CELLS: usize = 1 << 18;

/// No record; a cache holds fewer than can be numbered.
const NOBODY_16: u16 = u16::MAX;

/// Bytes of cells for every record that there may be.
pub(super) const BYTES_A_RECORD: u64 = 2 * (CELLS_A_RECORD * size_of::<Slot>()) as u64;

/// Up to three records that answer for a place, the best first; weights add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub(super) ids: [u32; 3],
    pub(super) weights: [f32; 3],
}

impl Choice {
    pub(super) const NONE: Self = Self {
        ids: [NOBODY; 3],
        weights: [0.0; 3],
    };
}

/// A cell of space and a side of surfaces.
type Key = (IVec3, u32);

/// What is known of a cell.
#[derive(Clone, Copy, Debug)]
struct Near {
    key: Key,
    ids: [u16; REMEMBERED],
    /// Farthest from the cell's middle of those that were looked at; infinite if there are no more. What is farther away makes no
    /// difference to the cell.
    reach: f32,
    /// `d_max` of Eq. 2.
    d_max: f32,
}

/// A cell in the table: one cache line.
#[derive(Debug, Default)]
#[repr(align(64))]
struct Slot(OnceLock<Near>);

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
    slots: Vec<Slot>,
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
            slots: (0..count).map(|_| Slot::default()).collect(),
            width: 1.0,
            pending: Vec::new(),
        }
    }

    /// Forgets everything; cells are `width` wide from now on.
    pub(super) fn clear(&mut self, width: f32) {
        self.width = width;
        self.pending.clear();
        for slot in &mut self.slots {
            slot.0.take();
        }
    }

    /// Takes note of a change; the table serves nobody until [`Self::freshen`] has been called.
    pub(super) fn changed(&mut self, change: Change) {
        self.pending.push(change);
    }

    /// Forgets the cells that noted changes concern.
    pub(super) fn freshen(&mut self) {
        if self.pending.is_empty() {
            return;
        }
        for slot in &mut self.slots {
            let Some(near) = slot.0.get() else {
                continue;
            };
            let middle = (near.key.0.as_vec3() + 0.5) * self.width;
            let mut places = (self.pending.iter()).flat_map(|c| c.removed.iter().chain(&c.added));
            if places.any(|place| place.distance(middle) <= near.reach) {
                slot.0.take();
            }
        }
        self.pending.clear();
    }

    /// The records that answer for a place.
    #[inline]
    pub(super) fn choose(
        &self,
        index: &Index,
        stands: &[Stand],
        falloff: Falloff,
        position: Vec3,
        normal: Vec3,
    ) -> Choice {
        let key = ((position / self.width).floor().as_ivec3(), side(normal));
        let found;
        let near = match self.find(index, stands, key) {
            Some(near) => near,
            None => {
                found = look_around(index, stands, self.width, key);
                &found
            }
        };
        best_of(near, stands, falloff, position, normal)
    }

    /// A cell in the table, filled if need be; `None`: there is no room, or the table is not up to date.
    #[inline]
    fn find(&self, index: &Index, stands: &[Stand], key: Key) -> Option<&Near> {
        if !self.pending.is_empty() {
            return None;
        }
        let first = hash(key) as usize;
        for k in 0..PROBES {
            let slot = &self.slots[(first + k) & (self.slots.len() - 1)].0;
            // Another thread may fill the slot first, for another cell.
            let near = slot.get_or_init(|| look_around(index, stands, self.width, key));
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
        ids: [NOBODY_16; REMEMBERED],
        reach: f32::INFINITY,
        d_max: 0.0,
    };
    let mut count = 0;
    let (mut farthest, mut looked_at) = (0.0, 0.0f32);
    for (visited, (id, distance)) in index.nearest(middle).enumerate() {
        looked_at = looked_at.max(distance);
        if serves(key.1, stands[id as usize].site.normal) {
            near.ids[count] = id as u16;
            farthest = distance;
            count += 1;
        }
        if count == REMEMBERED || visited + 1 == VISITED {
            near.reach = looked_at;
            break;
        }
    }
    near.d_max = if near.reach.is_finite() {
        near.reach + width
    } else {
        1.25 * farthest + width
    };
    near
}

/// The weights of a cell's records at a place, as whole numbers: the bits of the weight but for the last four, and those count
/// down with the rank in the cell. 0: has no say.
#[inline(always)]
fn weigh_here(
    near: &Near,
    stands: &[Stand],
    falloff: Falloff,
    position: Vec3,
    normal: Vec3,
) -> [u32; REMEMBERED] {
    let mut offset = [[0.0; REMEMBERED]; 3];
    let mut other = [[0.0; REMEMBERED]; 3];
    for k in 0..REMEMBERED {
        // Without a record: as if it looked away.
        let id = near.ids[k];
        let (there, facing) = match stands.get(usize::from(id)) {
            Some(stand) => (stand.site.position, stand.site.normal),
            None => (position, -normal),
        };
        for c in 0..3 {
            offset[c][k] = there[c] - position[c];
            other[c][k] = facing[c];
        }
    }
    // How far those are that look to the place's side, and how many of them are nearer.
    let mut apart = [f32::INFINITY; REMEMBERED];
    for k in 0..REMEMBERED {
        let distance2: f32 = (0..3).map(|c| offset[c][k] * offset[c][k]).sum();
        let cosine: f32 = (0..3).map(|c| other[c][k] * normal[c]).sum();
        apart[k] = if cosine > 0.0 {
            distance2
        } else {
            f32::INFINITY
        };
    }
    let mut nearer = [0u32; REMEMBERED];
    for other in apart {
        for k in 0..REMEMBERED {
            nearer[k] += u32::from(other < apart[k]);
        }
    }
    let mut keys = [0; REMEMBERED];
    for k in 0..REMEMBERED {
        let offset = Vec3::new(offset[0][k], offset[1][k], offset[2][k]);
        let other = Vec3::new(other[0][k], other[1][k], other[2][k]);
        let w = weight(falloff, normal, other, offset, near.d_max);
        let counts = apart[k] < f32::INFINITY && nearer[k] < COMPARED && w > 0.0;
        let bits = (w.to_bits() & !15) | (REMEMBERED - 1 - k) as u32;
        keys[k] = if counts { bits } else { 0 };
    }
    keys
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2")]
fn best_of_avx2(
    near: &Near,
    stands: &[Stand],
    falloff: Falloff,
    position: Vec3,
    normal: Vec3,
) -> Choice {
    best_of_here(near, stands, falloff, position, normal)
}

#[inline(always)]
fn best_of_here(
    near: &Near,
    stands: &[Stand],
    falloff: Falloff,
    position: Vec3,
    normal: Vec3,
) -> Choice {
    let mut keys = weigh_here(near, stands, falloff, position, normal);
    let mut choice = Choice::NONE;
    for (id, weight) in choice.ids.iter_mut().zip(&mut choice.weights) {
        let best = keys.iter().fold(0, |a, &b| a.max(b));
        if best == 0 {
            break;
        }
        for key in &mut keys {
            *key = if *key == best { 0 } else { *key };
        }
        *id = u32::from(near.ids[REMEMBERED - 1 - (best & 15) as usize]);
        *weight = f32::from_bits(best & !15);
    }
    let sum = choice.weights[0] + choice.weights[1] + choice.weights[2];
    if sum.is_nan() || sum <= 0.0 {
        return Choice::NONE;
    }
    choice.weights = choice.weights.map(|w| w / sum);
    choice
}

/// The best three of a cell's records for a place.
#[inline]
fn best_of(
    near: &Near,
    stands: &[Stand],
    falloff: Falloff,
    position: Vec3,
    normal: Vec3,
) -> Choice {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2")
        && std::arch::is_x86_feature_detected!("bmi1")
        && std::arch::is_x86_feature_detected!("bmi2")
    {
        // SAFETY: the machine has the instructions.
        return unsafe { best_of_avx2(near, stands, falloff, position, normal) };
    }
    best_of_here(near, stands, falloff, position, normal)
}
