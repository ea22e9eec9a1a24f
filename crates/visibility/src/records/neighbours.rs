//! Which records belong together: Eq. 2, and the search for the nearest.
//!
//! Two corrections to the print (Ulbrich 2013, appendix A). The angle is that between the normals themselves: `|n.n'|` would
//! link opposite walls, against the text. And the spatial term as printed, `1 - x / (1 + 5 x)`, only falls to 5/6 at `d_max`; see
//! [`Falloff`].
//!
//! `d_max` is not given in the paper: here it is the distance of the farthest of the records that were looked at.

use super::map::Stand;
use super::settings::Falloff;
use glam::Vec3;
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Records that are looked at in search of a record's neighbours.
const LOOKED_AT: usize = 24;

/// Neighbours of a record (section 5).
pub(super) const NEIGHBOURS: usize = 4;

/// No record.
pub(super) const NOBODY: u32 = u32::MAX;

/// `acos`, up to 7e-5 (Abramowitz & Stegun 4.4.45); the same bits on every machine.
#[inline(always)]
fn acos(x: f32) -> f32 {
    let a = x.abs().min(1.0);
    let root = (1.0 - a).sqrt();
    let angle = root * (1.570_728_8 + a * (-0.212_114_4 + a * (0.074_261 - a * 0.018_729_3)));
    if x < 0.0 {
        std::f32::consts::PI - angle
    } else {
        angle
    }
}

/// Eq. 2 for a place with normal `normal` and a record at `offset` from it whose normal is `other`.
#[inline(always)]
pub(super) fn weight(falloff: Falloff, normal: Vec3, other: Vec3, offset: Vec3, d_max: f32) -> f32 {
    let per_d_max = if d_max > 0.0 { 1.0 / d_max } else { 0.0 };
    let (cosine, height) = (normal.dot(other), normal.dot(offset));
    weight_of(falloff, cosine, height, offset.length_squared(), per_d_max)
}

/// Eq. 2 for a place and a record, told by the cosine between their normals, the record's height over the place's plane, and the square of their
/// distance. One division for all.
#[inline(always)]
pub(super) fn weight_of(
    falloff: Falloff,
    cosine: f32,
    height: f32,
    distance2: f32,
    per_d_max: f32,
) -> f32 {
    let angular = 1.0 - acos(cosine) * std::f32::consts::FRAC_1_PI;
    let distance = distance2.sqrt();
    let x = distance * per_d_max;
    let q = 1.0 + 5.0 * x;
    // 1 - x / q, and 1 - 6 x / q where that is positive.
    let spatial = match falloff {
        Falloff::Printed => q - x,
        Falloff::ToZero => {
            if x < 1.0 {
                1.0 - x
            } else {
                0.0
            }
        }
    };
    // In place there is no height.
    let length = if distance > 0.0 { distance } else { 1.0 };
    let per_both = 1.0 / (q * length);
    let sine = 1.0 - height.abs() * (per_both * q);
    let sine = if sine > 0.0 { sine } else { 0.0 };
    angular * (spatial * (per_both * length)) * sine.sqrt()
}

/// A record's position and number, as the tree of records holds it.
type Leaf = GeomWithData<[f32; 3], u32>;

/// Finds records near a place.
#[derive(Clone, Debug, Default)]
pub(super) struct Index {
    tree: RTree<Leaf>,
}

impl Index {
    pub(super) fn insert(&mut self, id: u32, position: Vec3) {
        self.tree.insert(Leaf::new(position.to_array(), id));
    }

    pub(super) fn remove(&mut self, id: u32, position: Vec3) {
        self.tree.remove(&Leaf::new(position.to_array(), id));
    }

    /// Records from the nearest on: number and distance. Those at the same distance come in the order of their numbers: so nothing depends
    /// on the order in which they entered the tree.
    pub(super) fn nearest(&self, position: Vec3) -> impl Iterator<Item = (u32, f32)> + '_ {
        let found = self
            .tree
            .nearest_neighbor_iter_with_distance_2(position.to_array());
        let mut found = found.peekable();
        let entry = move |leaf: &Leaf| {
            let there = Vec3::from_array(*leaf.geom());
            (leaf.data, there.distance(position))
        };
        // The last number first.
        let mut alike: Vec<(u32, f32)> = Vec::new();
        std::iter::from_fn(move || {
            if let Some(next) = alike.pop() {
                return Some(next);
            }
            let (first, distance2) = found.next()?;
            let first = entry(first);
            if found.peek().is_none_or(|next| next.1 != distance2) {
                return Some(first);
            }
            alike.push(first);
            while let Some((leaf, _)) = found.next_if(|next| next.1 == distance2) {
                alike.push(entry(leaf));
            }
            alike.sort_unstable_by_key(|entry| std::cmp::Reverse(entry.0));
            alike.pop()
        })
    }

    /// Whether a record stands within `radius` of a place and its normal is turned away by less than the angle of this cosine.
    pub(super) fn is_near(
        &self,
        stands: &[Stand],
        place: &Stand,
        radius: f32,
        cosine: f32,
    ) -> bool {
        let near = self.nearest(place.site.position);
        near.take_while(|&(_, distance)| distance < radius)
            .any(|(id, _)| stands[id as usize].site.normal.dot(place.site.normal) > cosine)
    }
}

/// Neighbours of a place: numbers and weights, the best first.
pub(super) type Links = [(u32, f32); NEIGHBOURS];

/// Puts `new` among `links` if it is better than the worst; returns whether it is.
pub(super) fn enter<const N: usize>(links: &mut [(u32, f32); N], new: (u32, f32)) -> bool {
    let better =
        |a: (u32, f32), b: (u32, f32)| b.0 == NOBODY || a.1 > b.1 || a.1 == b.1 && a.0 < b.0;
    let Some(last) = links.last_mut() else {
        return false;
    };
    if new.1 <= 0.0 || !better(new, *last) {
        return false;
    }
    *last = new;
    let mut k = N - 1;
    while k > 0 && better(links[k], links[k - 1]) {
        links.swap(k, k - 1);
        k -= 1;
    }
    true
}

/// The neighbours of a place among the records, and `d_max`. `except`: a record that does not count.
pub(super) fn links(
    index: &Index,
    stands: &[Stand],
    falloff: Falloff,
    place: &Stand,
    except: u32,
) -> (Links, f32) {
    let mut looked_at = [(NOBODY, 0.0); LOOKED_AT];
    let mut count = 0;
    let near = index.nearest(place.site.position);
    for found in near.filter(|&(id, _)| id != except).take(LOOKED_AT) {
        looked_at[count] = found;
        count += 1;
    }
    let d_max = count.checked_sub(1).map_or(0.0, |last| looked_at[last].1);
    let mut links = [(NOBODY, 0.0); NEIGHBOURS];
    for &(id, _) in &looked_at[..count] {
        let there = &stands[id as usize].site;
        let offset = there.position - place.site.position;
        let w = weight(falloff, place.site.normal, there.normal, offset, d_max);
        enter(&mut links, (id, w));
    }
    (links, d_max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_prefer_what_is_alike() {
        for falloff in [Falloff::Printed, Falloff::ToZero] {
            let w = |other: Vec3, offset: Vec3| weight(falloff, Vec3::Y, other, offset, 1.0);
            let here = w(Vec3::Y, Vec3::ZERO);
            assert!((here - 1.0).abs() < 1e-4);
            assert!(w(Vec3::Y, Vec3::X * 0.1) < here);
            assert!(w(Vec3::Y, Vec3::X * 0.5) < w(Vec3::Y, Vec3::X * 0.1));
            // The opposite wall is no neighbour, whatever the print says.
            assert!(w(-Vec3::Y, Vec3::X * 0.1) < 1e-4);
            // Nor is who stands straight above.
            assert_eq!(w(Vec3::Y, Vec3::Y * 0.1), 0.0);
        }
        let far = |falloff| weight(falloff, Vec3::Y, Vec3::Y, Vec3::X, 1.0);
        assert!((far(Falloff::Printed) - 5.0 / 6.0).abs() < 1e-4);
        assert_eq!(far(Falloff::ToZero), 0.0);
    }

    #[test]
    fn arc_cosine() {
        for i in -100..=100 {
            let x = i as f32 / 100.0;
            assert!((acos(x) - x.acos()).abs() < 1e-4, "{x}");
        }
    }

    #[test]
    fn the_best_stay() {
        let mut links = [(NOBODY, 0.0); 3];
        for (id, w) in [(1, 0.5), (2, 0.1), (3, 0.9), (4, 0.3), (5, 0.05), (6, 0.0)] {
            enter(&mut links, (id, w));
        }
        assert_eq!(links, [(3, 0.9), (1, 0.5), (4, 0.3)]);
    }
}
