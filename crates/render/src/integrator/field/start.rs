//! The first sample points: the visible surfaces in even parts, by k-means under the geometric distance (Wang et al. 2013, section 4.1).
//!
//! Candidates are what pixels show, since no others will be asked: surface points in proportion to the room that they take in the picture.

use super::eyes::{Eye, Eyes};
use super::points::place_of;
use crate::geometry::{Geometry, Place, Spot};
use glam::Vec3;
use occlude_visibility::field::{Metric, Sites};
use rayon::prelude::*;

/// Candidates at most.
const CANDIDATES: usize = 8192;
const ROUNDS: usize = 5;

/// Picks about `count` points.
pub(super) fn spread(
    geometry: &Geometry,
    eyes: &Eyes,
    metric: Metric,
    count: usize,
) -> Vec<(Place, Spot)> {
    let stride = (eyes.covered as usize).div_ceil(CANDIDATES).max(1);
    let all = eyes
        .tiles
        .iter()
        .flat_map(|tile| tile.eyes.iter().flatten());
    let candidates: Vec<&Eye> = all.step_by(stride).collect();
    if candidates.is_empty() {
        return Vec::new();
    }
    let step = candidates.len().div_ceil(count.max(1)).max(1);
    let mut centres: Vec<(Vec3, Vec3)> = (candidates.iter().step_by(step))
        .map(|eye| (eye.position, eye.normal))
        .collect();
    let mut owner: Vec<(u32, f32)> = Vec::new();
    for _ in 0..ROUNDS {
        let mut sites = Sites::default();
        centres.iter().for_each(|(p, n)| sites.push(*p, *n));
        owner = (candidates.par_iter())
            .with_min_len(64)
            .map_init(Vec::new, |distances, eye| {
                metric.distances(eye.position, eye.normal, &sites, distances);
                let least = |best: (u32, f32), (k, &d): (usize, &f32)| {
                    if d < best.1 { (k as u32, d) } else { best }
                };
                distances.iter().enumerate().fold((0, f32::INFINITY), least)
            })
            .collect();
        let mut sums = vec![(Vec3::ZERO, Vec3::ZERO, 0.0_f32); centres.len()];
        for (eye, &(k, _)) in candidates.iter().zip(&owner) {
            let sum = &mut sums[k as usize];
            *sum = (sum.0 + eye.position, sum.1 + eye.normal, sum.2 + 1.0);
        }
        for (centre, (position, normal, weight)) in centres.iter_mut().zip(sums) {
            if weight > 0.0 {
                let normal = normal.try_normalize().unwrap_or(centre.1);
                *centre = (position / weight, normal);
            }
        }
    }
    // Of each part the candidate next to its middle: points lie on surfaces.
    let mut best: Vec<Option<(f32, &Eye)>> = vec![None; centres.len()];
    for (eye, &(k, _)) in candidates.iter().zip(&owner) {
        let (position, normal) = centres[k as usize];
        let d = metric.distance(position, normal, eye.position, eye.normal);
        let place = &mut best[k as usize];
        if place.is_none_or(|(least, _)| d < least) {
            *place = Some((d, eye));
        }
    }
    (best.iter().flatten())
        .filter_map(|(_, eye)| place_of(geometry, eye))
        .collect()
}
