//! A cache as bytes, so that interrupted work goes on as if it had not been interrupted.
//!
//! Kept is what later answers and steps depend on: places, neighbours, importance, uses that no pass has taken over yet, and random numbers.
//! Maps are not: they are what the same rays find in the same scene, and are traced again. So a record takes a hundred bytes. The
//! wrong tool where the scene has changed in between: maps would be those of another scene than agreements between neighbours.

use super::cache::{Cache, Random, Slot};
use super::map::{self, DistanceTracer, Site, Stand};
use super::neighbours::{NEIGHBOURS, NOBODY};
use glam::Vec3;
use std::sync::atomic::Ordering::Relaxed;

const MAGIC: u64 = u64::from_le_bytes(*b"OCCREC02");

/// In front of the records.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Head {
    magic: u64,
    random: u64,
    passes: u64,
    count: u32,
    spacing: f32,
}

/// A record.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Kept {
    uses: u64,
    position: Vec3,
    normal: Vec3,
    origin: Vec3,
    neighbours: [u32; NEIGHBOURS],
    weights: [f32; NEIGHBOURS],
    agreement: [f32; NEIGHBOURS],
    d_max: f32,
    utility: f32,
    fresh: u32,
}

/// Bytes that are not those of a cache with these settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateError;

impl std::fmt::Display for StateError {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(
            f,
            "the state of the records is damaged or of other settings"
        )
    }
}

impl std::error::Error for StateError {}

impl Kept {
    fn is_sound(&self, count: u32) -> bool {
        let number = |&id: &u32| id < count || id == NOBODY;
        let values = [self.d_max, self.utility];
        let mut values = self.weights.iter().chain(&values);
        let mut agreement = self.neighbours.iter().zip(self.agreement);
        self.position.is_finite()
            && self.origin.is_finite()
            && self.normal.is_normalized()
            && self.neighbours.iter().all(number)
            && values.all(|value| value.is_finite() && *value >= 0.0)
            && agreement.all(|(&id, share)| id == NOBODY || (0.0..=1.0).contains(&share))
            && self.fresh <= u32::from(u8::MAX)
    }
}

impl Cache {
    /// The cache's state, little-endian, for [`Self::restore`]: between passes, or in the middle of one while nobody asks.
    pub fn state(&self) -> Vec<u8> {
        let head = Head {
            magic: MAGIC,
            random: self.random.0,
            passes: self.passes,
            count: self.len() as u32,
            spacing: self.spacing,
        };
        let mut bytes = bytemuck::bytes_of(&head).to_vec();
        let records = self.stands.iter().zip(&self.slots).zip(&self.uses);
        for ((stand, slot), uses) in records {
            let kept = Kept {
                uses: uses.load(Relaxed),
                position: stand.site.position,
                normal: stand.site.normal,
                origin: stand.site.origin,
                neighbours: slot.links.map(|link| link.0),
                weights: slot.links.map(|link| link.1),
                agreement: slot.agreement,
                d_max: slot.d_max,
                utility: slot.utility,
                fresh: u32::from(slot.fresh),
            };
            bytes.extend_from_slice(bytemuck::bytes_of(&kept));
        }
        bytes
    }

    /// Makes a new cache what the one was that [`Self::state`] was called of, with the same settings (threads and memory apart) and the
    /// same scene: from then on it answers and refines alike, to the bit. The next preparation for a picture finds its work done. Traces
    /// the maps of all records.
    pub fn restore<T: DistanceTracer>(
        &mut self,
        tracer: &T,
        state: &[u8],
    ) -> Result<(), StateError> {
        let (head, records) = state
            .split_at_checked(size_of::<Head>())
            .ok_or(StateError)?;
        let head: Head = bytemuck::try_pod_read_unaligned(head).map_err(|_| StateError)?;
        let (records, rest) = records.as_chunks::<{ size_of::<Kept>() }>();
        let records: Vec<Kept> = (records.iter())
            .map(|bytes| bytemuck::pod_read_unaligned(bytes))
            .collect();
        let sound = head.magic == MAGIC
            && rest.is_empty()
            && records.len() == head.count as usize
            && head.count <= self.settings.capacity
            && head.spacing.is_finite()
            && head.spacing > 0.0
            && records.iter().all(|kept| kept.is_sound(head.count))
            && self.is_empty();
        if !sound {
            return Err(StateError);
        }
        let stands: Vec<Stand> = (records.iter())
            .map(|kept| {
                Stand::new(Site {
                    position: kept.position,
                    normal: kept.normal,
                    origin: kept.origin,
                })
            })
            .collect();
        let (surfaces, threads) = (self.settings.surfaces, self.settings.threads);
        let maps = map::fill_all(tracer, &self.layout, &stands, surfaces, threads);
        self.report.fill_rays += (stands.len() * self.layout.texels.len()) as u64;
        self.random = Random(head.random);
        self.passes = head.passes;
        self.spacing = head.spacing;
        for ((kept, stand), map) in records.iter().zip(stands).zip(maps) {
            let slot = Slot {
                map,
                links: std::array::from_fn(|k| (kept.neighbours[k], kept.weights[k])),
                d_max: kept.d_max,
                agreement: kept.agreement,
                utility: kept.utility,
                fresh: kept.fresh as u8,
            };
            self.push(stand, slot);
            self.count(self.len() as u32 - 1, kept.uses);
        }
        self.changed_altogether();
        self.restored = true;
        Ok(())
    }
}
