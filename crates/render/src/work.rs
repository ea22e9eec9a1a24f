//! One work in parts: checkpoints that go on, shards that merge.

use crate::film::{Film, FilmError};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::ops::Range;

/// What a film belongs to, and which samples of the work it holds once it is finished.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Work {
    /// Fingerprint of scene, pose, camera, lights and every setting that changes the picture.
    pub fingerprint: u64,
    /// Samples a pixel of the whole work.
    pub total: u32,
    /// The sample numbers of this part: all of `0..total` on one machine.
    pub samples: Range<u32>,
    /// What the writer wants to know again when the picture is written (scene name, seed, look).
    pub notes: Vec<(String, String)>,
}

/// Why parts do not make a whole.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// Nothing to merge.
    #[error("no parts given")]
    NoParts,
    /// A part belongs to another work: scene, camera, size, seed or settings differ.
    #[error(
        "part {part} belongs to another work than part 0: other scene, camera, size, seed or settings"
    )]
    OtherWork {
        /// Index of the part.
        part: usize,
    },
    /// A part was cut off before it was finished.
    #[error("part {part} is not finished: it has {done} of {wanted} samples a pixel")]
    Unfinished {
        /// Index of the part.
        part: usize,
        /// Samples that it has.
        done: u32,
        /// Samples that it should have.
        wanted: u32,
    },
    /// Some samples are in no part, or in two.
    #[error("samples {} to {} are in {}", range.start, range.end, if *missing { "no part" } else { "two parts" })]
    Coverage {
        /// The samples.
        range: Range<u32>,
        /// In no part (otherwise in two).
        missing: bool,
    },
}

/// The sample numbers of shard `index` of `count`: balanced to one sample, disjoint, together `0..total`.
///
/// # Panics
/// If `index >= count`.
pub fn shard_samples(total: u32, index: u32, count: u32) -> Range<u32> {
    assert!(index < count);
    let bound = |i: u32| (u64::from(total) * u64::from(i) / u64::from(count)) as u32;
    bound(index)..bound(index + 1)
}

impl Work {
    /// Writes a part.
    pub fn write(&self, film: &Film, out: &mut impl Write) -> std::io::Result<()> {
        self.write_checkpoint(film, &[], out)
    }

    /// Writes a checkpoint: the film so far, and the state of whatever else goes on (see [`records_state`](crate::integrator::records_state)).
    pub fn write_checkpoint(
        &self,
        film: &Film,
        state: &[u8],
        out: &mut impl Write,
    ) -> std::io::Result<()> {
        film.write(self, state, out)
    }

    /// Reads a part of `available` bytes, or a checkpoint without its state.
    pub fn read(source: &mut impl Read, available: u64) -> Result<(Film, Self), FilmError> {
        Self::read_checkpoint(source, available).map(|(film, work, _)| (film, work))
    }

    /// Reads a checkpoint of `available` bytes, and the state in it.
    pub fn read_checkpoint(
        source: &mut impl Read,
        available: u64,
    ) -> Result<(Film, Self, Vec<u8>), FilmError> {
        Film::read(source, available)
    }

    /// Puts finished parts of one work together, in any order: the film is byte for byte that of a run without shards.
    pub fn merge(mut parts: Vec<(Film, Self)>) -> Result<(Film, Self), MergeError> {
        for (part, (film, work)) in parts.iter().enumerate() {
            let (first_film, first) = &parts[0];
            let kind = |film: &Film| {
                let layers = (film.has_features(), film.has_splats());
                (film.width(), film.height(), layers)
            };
            if kind(film) != kind(first_film)
                || (work.fingerprint, work.total) != (first.fingerprint, first.total)
            {
                return Err(MergeError::OtherWork { part });
            }
            let (done, wanted) = (film.min_samples(), work.samples.len() as u32);
            if done != wanted {
                return Err(MergeError::Unfinished { part, done, wanted });
            }
        }
        parts.retain(|(_, work)| !work.samples.is_empty());
        parts.sort_by_key(|(_, work)| work.samples.start);
        let mut parts = parts.into_iter();
        let Some((mut film, mut work)) = parts.next() else {
            return Err(MergeError::NoParts);
        };
        if work.samples.start > 0 {
            return Err(MergeError::Coverage {
                range: 0..work.samples.start,
                missing: true,
            });
        }
        for (part, next) in parts {
            let (end, start) = (work.samples.end, next.samples.start);
            if start != end {
                let missing = start > end;
                return Err(MergeError::Coverage {
                    range: start.min(end)..start.max(end),
                    missing,
                });
            }
            film.merge(&part);
            work.samples.end = next.samples.end;
        }
        if work.samples.end != work.total {
            return Err(MergeError::Coverage {
                range: work.samples.end..work.total,
                missing: true,
            });
        }
        Ok((film, work))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn part(samples: Range<u32>, fingerprint: u64) -> (Film, Work) {
        let mut film = Film::new(1, 1, false);
        samples
            .clone()
            .for_each(|s| film.add(0, 0, Vec3::splat(0.1 + s as f32), None));
        (
            film,
            Work {
                fingerprint,
                total: 7,
                samples,
                notes: vec![],
            },
        )
    }

    #[test]
    fn shards_are_disjoint_and_complete() {
        for (total, count) in [(7, 3), (2, 5), (64, 4), (u32::MAX, 7)] {
            let mut next = 0;
            for i in 0..count {
                let shard = shard_samples(total, i, count);
                assert_eq!(shard.start, next);
                assert!(shard.len() as u32 - total / count <= 1);
                next = shard.end;
            }
            assert_eq!(next, total);
        }
    }

    #[test]
    fn parts_in_any_order_make_the_whole() {
        let whole = part(0..7, 1);
        let merged = Work::merge(vec![part(4..7, 1), part(0..0, 1), part(0..4, 1)]).unwrap();
        assert_eq!(merged, whole);
    }

    #[test]
    fn gaps_doubles_and_strangers_are_refused() {
        let refuse = |parts| Work::merge(parts).unwrap_err();
        assert!(matches!(refuse(vec![]), MergeError::NoParts));
        assert!(matches!(
            refuse(vec![part(0..3, 1), part(4..7, 1)]),
            MergeError::Coverage { missing: true, .. }
        ));
        assert!(matches!(
            refuse(vec![part(0..5, 1), part(4..7, 1)]),
            MergeError::Coverage { missing: false, .. }
        ));
        assert!(matches!(
            refuse(vec![part(0..4, 1), part(4..6, 1)]),
            MergeError::Coverage { missing: true, .. }
        ));
        assert!(matches!(
            refuse(vec![part(0..4, 1), part(4..7, 2)]),
            MergeError::OtherWork { part: 1 }
        ));
        let mut cut = part(4..7, 1);
        cut.1.samples = 3..7;
        assert!(matches!(
            refuse(vec![part(0..3, 1), cut]),
            MergeError::Unfinished {
                part: 1,
                done: 3,
                wanted: 4
            }
        ));
    }
}
