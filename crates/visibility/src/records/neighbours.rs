//! Which records belong together: Eq. 2, and the search for the nearest.
//!
//! Two corrections to the print (Ulbrich 2013, appendix A). The angle is that between the normals themselves: `|n.n'|` would
//! link opposite walls, against the text. And the spatial term as printed, `1 - x / (1 + 5 x)`, only falls to 5/6 at `d_max`; see
//! [`Falloff`].
//!
//! `d_max` is not given in the paper: here it is the distance of the farthest of the records that were looked at.

use super::map::Stand;
use super::settings::Falloff;
use glam::{IVec3, Vec3};
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Records that are looked at in search of a record's neighbours.
const LOOKED_AT: usize = 24;

/// Neighbours of a record (section 5).
pub(super) const NEIGHBOURS: usize = 4;

/// Records that are remembered of a cell.
const REMEMBERED: usize = 16;

/// The nearest of them to a place, whose weights are compared.
const COMPARED: usize = 6;

/// No record.
pub(super) const NOBODY: u32 = u32::MAX;

/// The same in 16 bits; a cache holds fewer records.
const NOBODY_16: u16 = u16::MAX;

/// `acos`, up to 7e-5 (Abramowitz & Stegun 4.4.45); the same bits on every machine.
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
#[inline]
pub(super) fn weight(falloff: Falloff, normal: Vec3, other: Vec3, offset: Vec3, d_max: f32) -> f32 {
    let angular = 1.0 - acos(normal.dot(other)) * std::f32::consts::FRAC_1_PI;
    let distance = offset.length();
    let x = if d_max > 0.0 { distance / d_max } else { 0.0 };
    let spatial = match falloff {
        Falloff::Printed => 1.0 - x / (1.0 + 5.0 * x),
        Falloff::ToZero => (1.0 - 6.0 * x / (1.0 + 5.0 * x)).max(0.0),
    };
    let sine = if distance > 0.0 {
        (1.0 - (normal.dot(offset) / distance).abs()).max(0.0)
    } else {
        1.0
    };
    angular * spatial * sine.sqrt()
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

    /// Records from the nearest on: number and distance.
    pub(super) fn nearest(&self, position: Vec3) -> impl Iterator<Item = (u32, f32)> + '_ {
        let point = position.to_array();
        let tree = self.tree.nearest_neighbor_iter(point);
        tree.map(move |leaf| {
            let there = Vec3::from_array(*leaf.geom());
            (leaf.data, there.distance(position))
        })
    }

    /// Whether a record stands within `radius` of a place and looks to the same side.
    pub(super) fn is_near(&self, stands: &[Stand], place: &Stand, radius: f32) -> bool {
        let near = self.nearest(place.site.position);
        near.take_while(|&(_, distance)| distance < radius)
            .any(|(id, _)| stands[id as usize].site.normal.dot(place.site.normal) > 0.5)
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

/// What a worker remembers of the records near a cell of space and a side of surfaces.
#[derive(Clone, Copy, Debug)]
struct Near {
    key: (IVec3, u32),
    ids: [u16; REMEMBERED],
    /// Farthest of them from the cell's middle; infinite if there are no more.
    reach: f32,
}

/// Finds the records of many places that lie near each other: what is known of a cell is a pure function of the cell and of the
/// records, so that it does not matter who asked for it before.
#[derive(Clone, Debug, Default)]
pub(super) struct Finder {
    near: Vec<Near>,
    version: u64,
}

/// Cells that a [`Finder`] remembers.
const CELLS: usize = 1 << 16;

/// Records that are visited in search of those of a cell.
const VISITED: usize = 64;

/// A change of the records.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    pub(super) id: u32,
    /// Where a record has been taken away.
    pub(super) removed: bool,
    /// Where one has been added.
    pub(super) added: Option<Vec3>,
}

fn hash(key: (IVec3, u32)) -> usize {
    let mut h = u64::from(key.1);
    for c in key.0.to_array() {
        h = (h ^ u64::from(c.cast_unsigned())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 29;
    }
    (h >> 20) as usize % CELLS
}

/// The axis that a normal is nearest to.
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

impl Finder {
    /// Takes note of what has changed since the last question. `history` holds the latest changes; `version` counts them all.
    pub(super) fn follow(&mut self, version: u64, history: &[Change], cell: f32) {
        if self.near.is_empty() {
            let nothing = Near {
                key: (IVec3::ZERO, NOBODY),
                ids: [NOBODY_16; REMEMBERED],
                reach: 0.0,
            };
            self.near = vec![nothing; CELLS];
        } else if self.version != version {
            let new = (version - self.version) as usize;
            if new > history.len() || new > 256 {
                self.near.iter_mut().for_each(|near| near.key.1 = NOBODY);
            } else {
                for near in &mut self.near {
                    let middle = (near.key.0.as_vec3() + 0.5) * cell;
                    let changed = |change: &Change| {
                        change.removed && near.ids.contains(&(change.id as u16))
                            || (change.added).is_some_and(|p| p.distance(middle) <= near.reach)
                    };
                    if history[history.len() - new..].iter().any(changed) {
                        near.key.1 = NOBODY;
                    }
                }
            }
        }
        self.version = version;
    }

    /// The records that answer for a place.
    pub(super) fn choose(
        &mut self,
        index: &Index,
        stands: &[Stand],
        falloff: Falloff,
        cell: f32,
        position: Vec3,
        normal: Vec3,
    ) -> Choice {
        let key = ((position / cell).floor().as_ivec3(), side(normal));
        let slot = &mut self.near[hash(key)];
        if slot.key != key {
            *slot = look_around(index, stands, cell, key);
        }
        let near = *slot;
        let d_max = if near.reach.is_finite() {
            near.reach + cell
        } else {
            let far = |&id: &u16| stands[usize::from(id)].site.position.distance(position);
            let known = near.ids.iter().filter(|&&id| id != NOBODY_16);
            1.25 * known.map(far).fold(cell, f32::max)
        };
        let mut nearest = [(NOBODY, f32::INFINITY); COMPARED];
        for &id in &near.ids {
            if id == NOBODY_16 {
                break;
            }
            let there = &stands[usize::from(id)].site;
            let distance2 = there.position.distance_squared(position);
            if there.normal.dot(normal) <= 0.0 || distance2 >= nearest[COMPARED - 1].1 {
                continue;
            }
            let mut k = COMPARED - 1;
            while k > 0 && nearest[k - 1].1 > distance2 {
                nearest[k] = nearest[k - 1];
                k -= 1;
            }
            nearest[k] = (u32::from(id), distance2);
        }
        let mut best = [(NOBODY, 0.0); 3];
        for &(id, _) in nearest.iter().take_while(|near| near.0 != NOBODY) {
            let there = &stands[id as usize].site;
            let offset = there.position - position;
            let w = weight(falloff, normal, there.normal, offset, d_max);
            enter(&mut best, (id, w));
        }
        let sum = best[0].1 + best[1].1 + best[2].1;
        if sum.is_nan() || sum <= 0.0 {
            return Choice::NONE;
        }
        Choice {
            ids: best.map(|(id, _)| id),
            weights: best.map(|(_, w)| w / sum),
        }
    }
}

/// The records near the middle of a cell that look to its side.
fn look_around(index: &Index, stands: &[Stand], cell: f32, key: (IVec3, u32)) -> Near {
    let middle = (key.0.as_vec3() + 0.5) * cell;
    let mut near = Near {
        key,
        ids: [NOBODY_16; REMEMBERED],
        reach: f32::INFINITY,
    };
    let mut count = 0;
    for (visited, (id, distance)) in index.nearest(middle).enumerate() {
        if serves(key.1, stands[id as usize].site.normal) {
            near.ids[count] = id as u16;
            count += 1;
        }
        if count == REMEMBERED || visited + 1 == VISITED {
            near.reach = distance;
            break;
        }
    }
    near
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
