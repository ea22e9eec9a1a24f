//! Charts that were made before, kept in a folder by what they were made of.
//!
//! The name of a file is a hash of everything that the charts depend on, and the hash of its content stands at its end: what is damaged, cut
//! short or of another version is made again. Worth it for [`Conformal`](super::Conformal), which takes a minute where
//! [`Projection`](super::Projection) takes no longer than reading a file.

use super::{Charts, Surface, Unwrap, UnwrapError};
use glam::Vec2;
use occlude_image::write_atomically;
use std::path::{Path, PathBuf};

/// Changes with the way charts are made or written.
const MAGIC: &[u8; 16] = b"occlude charts 1";

/// A way to unwrap that remembers.
pub struct Kept<'a, U> {
    /// Makes what is not known.
    pub inner: U,
    /// Where charts are kept; it is made when it is needed.
    pub folder: &'a Path,
}

impl<U: Unwrap + std::fmt::Debug> Unwrap for Kept<'_, U> {
    fn charts(&self, surface: &Surface) -> Result<Charts, UnwrapError> {
        let path = self.path(surface);
        let known = std::fs::read(&path).ok();
        if let Some(charts) = known.and_then(|bytes| decode(&bytes, surface.triangles.len())) {
            return Ok(charts);
        }
        let charts = self.inner.charts(surface)?;
        // Whoever cannot keep them makes them again next time.
        let _ = std::fs::create_dir_all(self.folder);
        let _ = write_atomically(&path, |out| out.write_all(&encode(&charts)));
        Ok(charts)
    }
}

impl<U: std::fmt::Debug> Kept<'_, U> {
    fn path(&self, surface: &Surface) -> PathBuf {
        let mut bytes = format!("{:?}", self.inner).into_bytes();
        bytes.extend_from_slice(bytemuck::cast_slice(surface.positions));
        bytes.extend_from_slice(bytemuck::cast_slice(surface.triangles));
        bytes.extend_from_slice(&surface.texels_per_metre.to_le_bytes());
        let name = format!("{:016x}{:016x}.charts", hash(1, &bytes), hash(2, &bytes));
        self.folder.join(name)
    }
}

/// FNV-1a over words, after a seed: tells surfaces apart, not forgers.
fn hash(seed: u64, bytes: &[u8]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325 ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for word in bytes.chunks(8) {
        let mut eight = [0; 8];
        eight[..word.len()].copy_from_slice(word);
        hash = (hash ^ u64::from_le_bytes(eight)).wrapping_mul(0x0100_0000_01b3);
        hash ^= hash >> 29;
    }
    hash ^ bytes.len() as u64
}

fn encode(charts: &Charts) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(charts.count.to_le_bytes());
    bytes.extend(charts.of.iter().flat_map(|of| of.to_le_bytes()));
    let numbers = charts.corners.iter().flatten().flat_map(|c| c.to_array());
    bytes.extend(numbers.flat_map(f32::to_le_bytes));
    let end = hash(3, &bytes);
    bytes.extend(end.to_le_bytes());
    bytes
}

/// `None` unless it is what [`encode`] made of so many triangles.
fn decode(bytes: &[u8], triangles: usize) -> Option<Charts> {
    let (content, end) = bytes.split_last_chunk::<8>()?;
    let rest = content.strip_prefix(MAGIC)?;
    let whole = rest.len() == 4 + triangles * 28 && hash(3, content) == u64::from_le_bytes(*end);
    let (count, rest) = rest.split_first_chunk::<4>().filter(|_| whole)?;
    let (of, corners) = rest.split_at(4 * triangles);
    let number = |b: &[u8; 4]| f32::from_le_bytes(*b);
    Some(Charts {
        of: of
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| u32::from_le_bytes(*b))
            .collect(),
        corners: (corners.as_chunks::<24>().0.iter())
            .map(|six| {
                let n = six.as_chunks::<4>().0;
                [0, 2, 4].map(|k| Vec2::new(number(&n[k]), number(&n[k + 1])))
            })
            .collect(),
        count: u32::from_le_bytes(*count),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::unwrap::Projection;
    use glam::Vec3;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    #[derive(Debug)]
    struct Counted<'a>(&'a AtomicU32);

    impl Unwrap for Counted<'_> {
        fn charts(&self, surface: &Surface) -> Result<Charts, UnwrapError> {
            self.0.fetch_add(1, Relaxed);
            Projection.charts(surface)
        }
    }

    #[test]
    fn charts_are_made_once_and_again_when_damaged() {
        let folder = std::env::temp_dir().join(format!("occlude-charts-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let surface = Surface {
            positions: &positions,
            triangles: &[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            texels_per_metre: 8.0,
        };
        let made = AtomicU32::new(0);
        // The counter is part of the name: it starts at 0 every time.
        let charts = |surface: &Surface| {
            made.store(0, Relaxed);
            let kept = Kept {
                inner: Counted(&made),
                folder: &folder,
            };
            let charts = kept.charts(surface).unwrap();
            (charts, made.load(Relaxed))
        };
        let (first, made_first) = charts(&surface);
        assert_eq!(
            (made_first, &first),
            (1, &Projection.charts(&surface).unwrap())
        );
        assert_eq!(charts(&surface), (first.clone(), 0));
        let denser = Surface {
            texels_per_metre: 9.0,
            ..surface
        };
        assert_eq!(charts(&denser).1, 1, "another density is another surface");
        for damage in [0, 16, 40, 200] {
            for file in std::fs::read_dir(&folder).unwrap() {
                let path = file.unwrap().path();
                let mut bytes = std::fs::read(&path).unwrap();
                if damage == 200 {
                    bytes.truncate(30);
                } else {
                    bytes[damage] ^= 4;
                }
                std::fs::write(&path, bytes).unwrap();
            }
            assert_eq!(charts(&surface), (first.clone(), 1), "{damage}");
        }
        let _ = std::fs::remove_dir_all(&folder);
    }
}
