//! A look inside: which patches a question falls into. For statistics of digests and for pictures of patches in false
//! colours; answering questions never comes this way.

use super::Quantized;
use crate::{Epoch, Query};

/// The pair of patches that a question falls into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PatchPair {
    /// All integers of the key: the light's patch (8, unused ones 0), then the eye's (7). Equal exactly for equal pairs.
    pub integers: [u32; 15],
    /// The digest that tables know the pair by; its upper 32 bits choose the place, its lower ones tell pairs apart there.
    pub digest: u64,
}

impl Quantized {
    /// The patches that a question falls into after `level` halvings (0: none); `None` if it is traced exactly.
    pub fn patches(&self, query: &Query, epoch: Epoch, level: u32) -> Option<PatchPair> {
        let clustered = self.cluster(query, epoch)?;
        let eye = self.eye_cell(&clustered, level);
        let mut integers = [0; 15];
        integers[..8].copy_from_slice(&clustered.light.words().0);
        integers[8..].copy_from_slice(&eye.words());
        Some(PatchPair {
            integers,
            digest: self.digest(&eye, &clustered, 0),
        })
    }
}
