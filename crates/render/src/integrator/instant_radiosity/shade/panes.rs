//! Window panes between eyes and lights: what they tint, and the many connections that none of them can meet.
//!
//! Most connections pass no pane. So the boxes of the panes are tested against the hull of a pack's eyes and a block's lights
//! first, and what is left against the hull of the eyes and one light; rays are traced where a box is met. What is found does
//! not depend on it.

use super::packs::Pack;
use super::wide::{Row, WIDE};
use super::{LightList, Packs};
use crate::geometry::{Geometry, Span, Towards};
use glam::Vec3;
use occlude_visibility::{BLOCK, EyeSample, SharedLight};

/// The panes, as eyes and lights of a tile need them.
#[derive(Debug)]
pub(in super::super) struct Panes<'a> {
    geometry: &'a Geometry<'a>,
    ends: &'a [EyeSample],
    lights: &'a [SharedLight],
    /// Boxes around where the rays of packs start.
    packs: Vec<Span>,
    /// Boxes around where rays to the lights of a block end.
    blocks: Vec<Towards>,
}

impl<'a> Panes<'a> {
    /// `None` where no pane tints light.
    pub(in super::super) fn new(
        geometry: &'a Geometry<'a>,
        lights: &'a LightList,
        packs: &Packs,
        ends: &'a [EyeSample],
    ) -> Option<Self> {
        if !geometry.has_panes() {
            return None;
        }
        let origin = |&eye: &u32| ends[eye as usize].origin;
        let start = |pack: &Pack| Span::around(pack.eyes.iter().map(origin));
        Some(Self {
            geometry,
            ends,
            lights: &lights.shared,
            packs: packs.packs.iter().map(start).collect(),
            blocks: lights.shared.chunks(BLOCK).map(towards).collect(),
        })
    }

    /// The boxes that connections of pack `p` with lights of block `index` may meet.
    #[inline(always)]
    pub(super) fn of_block(&self, p: usize, index: usize) -> u64 {
        let boxes = self.geometry.pane_boxes();
        boxes.met(&self.packs[p], &self.blocks[index], u64::MAX)
    }

    /// What panes, whose boxes are `among`, let through from light `l` of block `index`, for eyes whose mask has it; `None` if
    /// nothing is tinted.
    #[inline(always)]
    pub(super) fn tint(
        &self,
        (p, pack): (usize, &Pack),
        (index, l): (usize, usize),
        masks: &[u32; WIDE],
        among: u64,
    ) -> Option<[Row; 3]> {
        let light = std::slice::from_ref(&self.lights[index * BLOCK + l]);
        let boxes = self.geometry.pane_boxes();
        if boxes.met(&self.packs[p], &towards(light), among) == 0 {
            return None;
        }
        self.trace(pack, &light[0], l, masks)
    }

    #[inline(never)]
    fn trace(
        &self,
        pack: &Pack,
        light: &SharedLight,
        l: usize,
        masks: &[u32; WIDE],
    ) -> Option<[Row; 3]> {
        let ray = |eye: u32| light.ray_from(self.ends[eye as usize].origin);
        let mut rays = [ray(pack.eyes[0]); WIDE];
        let mut count = 0;
        for lane in lanes_with(masks, l) {
            rays[count] = ray(pack.eyes[lane]);
            count += 1;
        }
        let mut colours = [Vec3::ONE; WIDE];
        self.geometry
            .pane_transmittance_batch(&rays[..count], &mut colours[..count]);
        if colours == [Vec3::ONE; WIDE] {
            return None;
        }
        let mut tint = [[1.0; WIDE]; 3];
        for (lane, colour) in lanes_with(masks, l).zip(colours) {
            for c in 0..3 {
                tint[c][lane] = colour[c];
            }
        }
        Some(tint)
    }
}

/// Where rays to some lights end; all of them at points, or all infinitely far away.
fn towards(lights: &[SharedLight]) -> Towards {
    let rays = || lights.iter().map(|light| light.ray_from(Vec3::ZERO));
    let span = Span::around(rays().map(|ray| ray.direction));
    if rays().all(|ray| ray.t_max.is_finite()) {
        Towards::Points(span)
    } else {
        Towards::Directions(span)
    }
}

/// The eyes whose mask has light `l`.
pub(super) fn lanes_with(masks: &[u32; WIDE], l: usize) -> impl Iterator<Item = usize> + '_ {
    (0..WIDE).filter(move |&lane| masks[lane] >> l & 1 != 0)
}
