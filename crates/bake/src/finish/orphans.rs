//! Charts of which nothing is known: they take the light of what is nearest in the world.
//!
//! Screws and slivers have charts of a single texel, which a bake of few directions may never meet, and things that stand inside of
//! others have charts without a valid texel. Black specks would be left. No paper: a k-d tree over the valid texels of the same instance,
//! in which those that look another way count as twice as far.
//!
//! Invariants: a chart with a single valid texel is left alone ([`Canvas::fill_invalid`] serves it); light comes from the same instance and page
//! only; the result does not depend on threads (ties go to the lower index).
//!
//! Class: biased, a guess. The wrong tool where the neighbourhood is lit otherwise (a crumb in the shadow of a table) and for charts of
//! more than a few texels, which it would paint flat: give those more directions.

use super::{Canvas, LEAST_VALIDITY};
use crate::texel::Texels;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Rows that are looked at together.
const ROWS: u32 = 64;

/// A texel in the world.
#[derive(Clone, Copy)]
struct Place {
    at: Vec3,
    normal: Vec3,
    index: usize,
}

/// Gives the texels of charts without a valid one the light of the nearest valid texel of the same instance that looks the same way,
/// roughly. Returns how many were filled. O(n), and O(n log n) for the instances that have some.
pub fn adopt(texels: &Texels, page: u32, canvas: &mut Canvas) -> u64 {
    let mut alive = vec![false; canvas.charts.iter().max().map_or(0, |&c| c as usize + 1)];
    for (&chart, &validity) in canvas.charts.iter().zip(&canvas.validity) {
        alive[chart as usize] |= validity >= LEAST_VALIDITY;
    }
    let is_orphan = |i: usize| canvas.charts[i] != 0 && !alive[canvas.charts[i] as usize];
    if !(0..canvas.charts.len()).into_par_iter().any(is_orphan) {
        return 0;
    }
    let size = texels.atlas.pages[page as usize];
    let bands = |of: &(dyn Fn(usize) -> bool + Sync), instances: Option<&BTreeSet<u32>>| {
        let found: Vec<Vec<(u32, Place)>> = (0..size.height.div_ceil(ROWS))
            .into_par_iter()
            .map(|k| {
                let band = texels.band(page, k * ROWS..((k + 1) * ROWS).min(size.height));
                let mut found = Vec::new();
                for i in 0..band.len() {
                    let index = (band.texel(i) - size.first_texel) as usize;
                    let instance = band.fragments(i)[0].instance;
                    if !of(index) || instances.is_some_and(|wanted| !wanted.contains(&instance)) {
                        continue;
                    }
                    let (at, normal) = texels.world_place(&band, i);
                    found.push((instance, Place { at, normal, index }));
                }
                found
            })
            .collect();
        let mut by_instance: BTreeMap<u32, Vec<Place>> = BTreeMap::new();
        for (instance, place) in found.into_iter().flatten() {
            by_instance.entry(instance).or_default().push(place);
        }
        by_instance
    };
    let orphans = bands(&is_orphan, None);
    let instances = orphans.keys().copied().collect();
    let is_known = |i: usize| canvas.charts[i] != 0 && canvas.validity[i] >= LEAST_VALIDITY;
    let known = bands(&is_known, Some(&instances));
    let adopted: Vec<(usize, usize)> = orphans
        .iter()
        .filter_map(|(instance, orphans)| Some((orphans, Nearest::new(known.get(instance)?))))
        .flat_map(|(orphans, tree)| {
            let pairs = (orphans.par_iter()).filter_map(|o| Some((o.index, tree.find(o)?)));
            pairs.collect::<Vec<_>>()
        })
        .collect();
    for &(orphan, parent) in &adopted {
        canvas.values[orphan] = canvas.values[parent];
    }
    adopted.len() as u64
}

/// A k-d tree without pointers: the middle place of a range splits it, by the axis that the range is longest in.
struct Nearest {
    places: Vec<Place>,
    axes: Vec<u8>,
}

impl Nearest {
    fn new(places: &[Place]) -> Self {
        let mut tree = Self {
            places: places.to_vec(),
            axes: vec![0; places.len()],
        };
        sort(&mut tree.places, &mut tree.axes);
        tree
    }

    /// Index of the texel that is nearest; those that look away count as twice as far.
    fn find(&self, from: &Place) -> Option<usize> {
        let mut best = (f32::INFINITY, usize::MAX);
        self.search(from, 0..self.places.len(), &mut best);
        (best.1 != usize::MAX).then_some(best.1)
    }

    fn search(&self, from: &Place, range: Range<usize>, best: &mut (f32, usize)) {
        if range.is_empty() {
            return;
        }
        let middle = range.start + range.len() / 2;
        let place = &self.places[middle];
        let away = if place.normal.dot(from.normal) > 0.3 {
            1.0
        } else {
            4.0
        };
        let cost = place.at.distance_squared(from.at) * away;
        if (cost, place.index) < *best {
            *best = (cost, place.index);
        }
        let axis = usize::from(self.axes[middle]);
        let beyond = from.at[axis] - place.at[axis];
        let (near, far) = if beyond < 0.0 {
            (range.start..middle, middle + 1..range.end)
        } else {
            (middle + 1..range.end, range.start..middle)
        };
        self.search(from, near, best);
        if beyond * beyond <= best.0 {
            self.search(from, far, best);
        }
    }
}

fn sort(places: &mut [Place], axes: &mut [u8]) {
    if places.len() < 2 {
        return;
    }
    let (low, high) = places
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
            (low.min(p.at), high.max(p.at))
        });
    let axis = (high - low).max_position();
    let middle = places.len() / 2;
    places.select_nth_unstable_by(middle, |a, b| {
        let order = a.at[axis].total_cmp(&b.at[axis]);
        order.then(a.index.cmp(&b.index))
    });
    axes[middle] = axis as u8;
    let (left, right) = places.split_at_mut(middle);
    let (left_axes, right_axes) = axes.split_at_mut(middle);
    sort(left, left_axes);
    sort(&mut right[1..], &mut right_axes[1..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_testkit::random::Random;

    #[test]
    fn the_nearest_is_found() {
        let mut random = Random(5);
        let mut unit = || (random.bits() >> 40) as f32 / (1 << 24) as f32;
        let mut place = |index| Place {
            at: Vec3::new(unit(), 0.2 * unit(), (4.0 * unit()).floor()),
            normal: if unit() < 0.5 { Vec3::X } else { Vec3::Y },
            index,
        };
        for count in [0, 1, 2, 3, 500] {
            let places: Vec<Place> = (0..count).map(&mut place).collect();
            let tree = Nearest::new(&places);
            for _ in 0..100 {
                let from = place(0);
                let cost = |p: &Place| {
                    let away = if p.normal == from.normal { 1.0 } else { 4.0 };
                    (p.at.distance_squared(from.at) * away, p.index)
                };
                let best = places.iter().map(cost).min_by(|a, b| a.0.total_cmp(&b.0));
                assert_eq!(tree.find(&from), best.map(|b| b.1));
            }
        }
    }
}
