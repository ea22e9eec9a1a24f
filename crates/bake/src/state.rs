//! What has been gathered so far: as a checkpoint to go on from, as a part of a round to be merged, or as the rounds that a
//! part builds on.
//!
//! A file is a header (JSON with its length in front) and arrays whose lengths follow from the header and must agree with
//! the work at hand: nothing is allocated because a file claims a size. All numbers are little-endian.

use crate::store::Store;
use crate::sums::{Sums, SumsError, Unit};
use glam::Vec3;
use occlude_bvh::Buffer;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::ops::Range;

/// First bytes of a file; the last is the version of the layout.
const MAGIC: [u8; 8] = *b"occbake\x03";

/// Headers are small; more is no header.
const MAX_HEADER: u64 = 1 << 20;

/// Which work a state belongs to, and which part of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Fingerprint of scene, atlas, lights and every setting that changes the light maps.
    pub fingerprint: u64,
    /// Sides that sums are kept for.
    pub sides: u32,
    /// The round that is being gathered; rounds before it are done.
    pub round: u32,
    /// Rounds of the work.
    pub rounds: u32,
    /// Items of this round: samples or directions.
    pub total: u32,
    /// The items that this part gathers: all of `0..total` without shards.
    pub items: Range<u32>,
    /// Entries of [`State::done`].
    pub units: u32,
    /// There is light of a first round.
    pub has_direct: bool,
    /// There is a map of the round before.
    pub has_previous: bool,
    /// There is light of spots.
    pub has_spots: bool,
    /// Bits of [`Before::bound`], a float.
    pub bound: u32,
    /// Sides that have first moments: in the sums, and in those of the first round.
    pub moments: [u32; 2],
    /// What sums count, radiance and weight.
    pub unit: [f64; 2],
    /// What the writer wants to know again: the command's options, as JSON.
    pub notes: String,
}

/// Why a file is no state of this work.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateError {
    /// Reading failed, or the file ends too early.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// Not a file of this kind, or of another version.
    #[error("not a part or checkpoint of a bake by this version of the program")]
    Kind,
    /// Of another work.
    #[error("of another work: scene, settings, memory limit, seed or program version differ")]
    OtherWork,
}

impl From<SumsError> for StateError {
    fn from(error: SumsError) -> Self {
        match error {
            SumsError::Io(error) => Self::Io(error),
            _ => Self::OtherWork,
        }
    }
}

/// What the rounds before have found.
#[derive(Debug)]
pub struct Before {
    /// Irradiance by side that the first round has found, W/m²; empty before its end.
    pub direct: Buffer<Vec3>,
    /// Irradiance by side of the round before, W/m²; empty in the first rounds.
    pub previous: Buffer<Vec3>,
    /// First moments of the light that the first round has found, by texel; empty unless directions are wanted.
    pub direct_moments: Buffer<Vec3>,
    /// Irradiance by side from spots that reflect the direct light; empty if there are none.
    pub spots: Buffer<Vec3>,
    /// Radiance beyond which direct light that is reflected is that of spots, and not carried by bundles; infinite if there are none.
    pub bound: f32,
}

impl Default for Before {
    /// No round is done.
    fn default() -> Self {
        Self {
            direct: Buffer::default(),
            previous: Buffer::default(),
            direct_moments: Buffer::default(),
            spots: Buffer::default(),
            bound: f32::INFINITY,
        }
    }
}

impl Before {
    fn maps(&self) -> [&Buffer<Vec3>; 4] {
        [
            &self.direct,
            &self.previous,
            &self.direct_moments,
            &self.spots,
        ]
    }

    /// Lets maps on disk leave memory until they are touched again.
    pub fn release(&self) {
        self.maps().into_iter().for_each(Buffer::release);
    }
}

/// What has been gathered so far.
#[derive(Debug)]
pub struct State {
    /// Whose it is.
    pub header: Header,
    /// What the rounds before have found.
    pub before: Before,
    /// Items of this part that are in the sums, by unit of work; counted from `header.items.start`.
    pub done: Vec<u32>,
    /// Sums of this round.
    pub sums: Sums,
    /// Of how the noise is measured: see [`crate::noise`].
    pub noise: crate::noise::Noise,
}

/// Reads the header alone: enough to find out which work a file belongs to.
pub fn read_header(source: &mut impl Read) -> Result<Header, StateError> {
    let mut magic = [0; 8];
    source
        .read_exact(&mut magic)
        .map_err(|_| StateError::Kind)?;
    if magic != MAGIC {
        return Err(StateError::Kind);
    }
    let mut word = [0; 8];
    source.read_exact(&mut word)?;
    let length = u64::from_le_bytes(word);
    if length > MAX_HEADER {
        return Err(StateError::Kind);
    }
    let mut text = vec![0; length as usize];
    source.read_exact(&mut text)?;
    serde_json::from_slice(&text).map_err(|_| StateError::Kind)
}

impl State {
    /// Bytes of a state with all its arrays.
    pub fn bytes(sides: u32, units: u32) -> u64 {
        Sums::bytes(sides) + 2 * u64::from(sides) * size_of::<Vec3>() as u64 + 4 * u64::from(units)
    }

    /// Items of this part that are whole: in all units.
    pub fn min_done(&self) -> u32 {
        self.done.iter().copied().min().unwrap_or(0)
    }

    /// Whether all items of this part are in the sums.
    pub fn is_complete(&self) -> bool {
        self.min_done() as usize >= self.header.items.len()
    }

    /// Lets what is on disk leave memory until it is touched again.
    pub fn release(&self) {
        self.before.release();
        self.sums.release();
    }

    /// Writes the state.
    pub fn write(&self, out: &mut (impl Write + ?Sized)) -> std::io::Result<()> {
        let header = Header {
            has_direct: !self.before.direct.is_empty(),
            has_previous: !self.before.previous.is_empty(),
            has_spots: !self.before.spots.is_empty(),
            bound: self.before.bound.to_bits(),
            moments: [
                self.sums.moments().map_or(0, Sums::len),
                self.before.direct_moments.len() as u32,
            ],
            units: self.done.len() as u32,
            unit: [self.sums.unit().radiance, self.sums.unit().weight],
            ..self.header.clone()
        };
        let text = serde_json::to_vec(&header)?;
        out.write_all(&MAGIC)?;
        out.write_all(&(text.len() as u64).to_le_bytes())?;
        out.write_all(&text)?;
        for map in self.before.maps() {
            for chunk in map.chunks(CHUNK) {
                map.release();
                let numbers = chunk.iter().flat_map(|v| v.to_array());
                out.write_all(&numbers.flat_map(f32::to_le_bytes).collect::<Vec<u8>>())?;
            }
        }
        let words = self.done.iter().flat_map(|n| n.to_le_bytes());
        out.write_all(&words.collect::<Vec<u8>>())?;
        self.noise.write(&mut *out)?;
        self.sums.write(&mut &mut *out)
    }

    /// Reads a state of a work with this fingerprint and so many sides and units into `store`; what the header says must agree with that.
    pub fn read(
        source: &mut impl Read,
        store: &Store,
        fingerprint: u64,
        sides: u32,
        units_of: impl Fn(u32) -> u32,
    ) -> Result<Self, StateError> {
        let header = read_header(source)?;
        let sane = header.fingerprint == fingerprint
            && header.sides == sides
            && header.round < header.rounds.max(1)
            && header.units == units_of(header.round)
            && header.items.start <= header.items.end
            && header.items.end <= header.total
            && f32::from_bits(header.bound) > 0.0
            && header.moments.iter().all(|&len| len <= sides)
            && header
                .unit
                .iter()
                .all(|unit| unit.is_finite() && *unit > 0.0);
        if !sane {
            return Err(StateError::OtherWork);
        }
        let mut map = |has: bool, len: u32| read_map(source, store, if has { len } else { 0 });
        let before = Before {
            direct: map(header.has_direct, sides)?,
            previous: map(header.has_previous, sides)?,
            direct_moments: map(true, header.moments[1])?,
            spots: map(header.has_spots, sides)?,
            bound: f32::from_bits(header.bound),
        };
        let mut words = vec![0; 4 * header.units as usize];
        source.read_exact(&mut words)?;
        let done: Vec<u32> = words
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        if done.iter().any(|&n| n as usize > header.items.len()) {
            return Err(StateError::OtherWork);
        }
        let noise = crate::noise::Noise::read(source, sides)?;
        let [radiance, weight] = header.unit;
        let unit = Unit { radiance, weight };
        let mut sums = Sums::new_in(store, sides, unit, header.moments[0])?;
        sums.read(source)?;
        Ok(Self {
            header,
            before,
            done,
            sums,
            noise,
        })
    }
}

/// Values that are encoded together.
const CHUNK: usize = 1 << 14;

fn read_map(source: &mut impl Read, store: &Store, len: u32) -> std::io::Result<Buffer<Vec3>> {
    let mut map: Buffer<Vec3> = store.zeroed(len as usize)?;
    let mut bytes = vec![0; CHUNK * 12];
    let mut first = 0;
    while first < map.len() {
        map.release();
        let count = CHUNK.min(map.len() - first);
        source.read_exact(&mut bytes[..count * 12])?;
        let values = bytes[..count * 12].chunks_exact(12).map(|b| {
            let channel = |i: usize| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
            Vec3::new(channel(0), channel(4), channel(8))
        });
        for (to, value) in map[first..].iter_mut().zip(values) {
            *to = value;
        }
        first += count;
    }
    Ok(map)
}
