//! Rounds of bundles: what surfaces and sky send along parallel lines.

use super::{Bake, Ended, Light, Report, Round, RoundKind, Subject, Until};
use crate::bundle::{self, Directions, Radiance, Sky};
use crate::gather::Part;
use crate::state::{Before, State};
use crate::store::{STRETCH, Store};
use crate::texel::Band;
use glam::Vec3;
use half::f16;
use occlude_bvh::Buffer;
use occlude_render::geometry::diffuse_albedo;
use occlude_render::job::Job;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::io;
use std::ops::Range;

/// Directions between two looks at the clock and the noise.
const DIRECTIONS_TOGETHER: u32 = 16;

impl Bake<'_> {
    /// Gathers directions by bundles.
    pub(super) fn bundle(
        &self,
        round: Round,
        state: &mut State,
        until: Until,
        job: &Job,
        report: &mut Report,
        at_rest: &mut dyn FnMut(&State),
    ) -> io::Result<Ended> {
        let Some(triangles) = self.subject.triangles else {
            return Ok(Ended::Samples);
        };
        let target = state.header.items.len() as u32;
        job.start_phase(round.name, u64::from(target));
        job.advance(u64::from(state.done[0]), 0);
        let radiance = self.radiance(round, state);
        let environment = |towards: Vec3| {
            self.subject
                .sky
                .map_or(Vec3::ZERO, |(sky, _)| sky.radiance(towards))
        };
        // Reflected light alone is wanted: the last round leaves the sky out.
        let no_sky = self.settings.part == Part::Indirect && self.is_last(state);
        let sky: Option<Sky> = match self.subject.sky {
            Some(_) if !no_sky => Some(&environment),
            _ => None,
        };
        let directions = Directions {
            seed: self.settings.seed,
            round: state.header.round,
        };
        let light = Light {
            triangles,
            radiance: &radiance,
            sky,
        };
        let first = state.header.items.start;
        while state.done[0] < target {
            let end = (state.done[0] / DIRECTIONS_TOGETHER + 1) * DIRECTIONS_TOGETHER;
            let range = first + state.done[0]..first + end.min(target);
            let stats = bundle::gather(
                triangles,
                &radiance,
                sky,
                &directions,
                range.clone(),
                &self.settings.bundles,
                job,
                &state.sums,
            );
            let done = stats.directions as u32;
            let gathered = range.start..range.start + done;
            report.secondary += self.gather_tiny(&light, state.header.round, gathered, &state.sums);
            state.sums.check()?;
            state.done[0] += done;
            report.bundles += stats;
            if job.is_cancelled() {
                return Ok(Ended::Cancel);
            }
            if let Some(ended) = until.end_batch(state, at_rest) {
                return Ok(ended);
            }
        }
        Ok(Ended::Samples)
    }

    /// What every side sends out in a round of bundles.
    fn radiance(&self, round: Round, state: &State) -> Radiance {
        let mut radiance = Radiance::black(state.header.sides, self.brightest(&state.before));
        if round.kind == RoundKind::Reflected {
            for range in self.stretches() {
                radiance.fill(range, |side| self.reflected(&state.before, side));
                state.before.release();
                self.albedo.release();
            }
        }
        radiance
    }

    /// All sides, part by part.
    pub(super) fn stretches(&self) -> impl Iterator<Item = Range<u32>> {
        let sides = self.sides();
        (0..sides)
            .step_by(STRETCH as usize)
            .map(move |first| first..sides.min(first.saturating_add(STRETCH)))
    }

    /// Radiance that a side reflects of what the rounds before have brought, spots apart.
    fn reflected(&self, before: &Before, side: u32) -> Vec3 {
        let arrived = if before.previous.is_empty() {
            &before.direct
        } else {
            &before.previous
        };
        (self.reflection(arrived, side) - self.beyond(before, side)).max(Vec3::ZERO)
    }

    /// Radiance that a side reflects of the direct light.
    pub(super) fn of_direct(&self, before: &Before, side: u32) -> Vec3 {
        self.reflection(&before.direct, side)
    }

    /// Radiance that a side reflects of what has arrived.
    fn reflection(&self, arrived: &[Vec3], side: u32) -> Vec3 {
        let front = self
            .subject
            .sides()
            .map_or(side, |sides| sides.front_of(side));
        let albedo = self.albedo.get(front as usize).copied().unwrap_or_default();
        let albedo = Vec3::from_array(albedo.map(f16::to_f32));
        albedo * arrived.get(side as usize).copied().unwrap_or(Vec3::ZERO) * FRAC_1_PI
    }

    /// The brightest radiance that bundles meet.
    pub(super) fn brightest(&self, before: &Before) -> f32 {
        let mut surfaces = 0.0_f32;
        for range in self.stretches().take_while(|_| !self.albedo.is_empty()) {
            let here = range
                .into_par_iter()
                .map(|side| self.reflected(before, side).max_element())
                .reduce(|| 0.0, f32::max);
            surfaces = surfaces.max(here);
            before.release();
            self.albedo.release();
        }
        let sky = self.subject.sky.map_or(0.0, |(_, brightest)| brightest);
        surfaces.max(sky).max(f32::MIN_POSITIVE * 1e20)
    }
}

/// Lambert albedo of every front.
pub(super) fn albedo(subject: &Subject, store: &Store) -> io::Result<Buffer<[f16; 3]>> {
    let Some(sides) = subject.sides() else {
        return Ok(Buffer::default());
    };
    let pack = |albedo: Vec3| {
        albedo
            .clamp(Vec3::ZERO, Vec3::ONE)
            .to_array()
            .map(f16::from_f32)
    };
    let mut fronts: Buffer<[f16; 3]> = store.zeroed(sides.fronts_count() as usize)?;
    for (page, size) in subject.texels.atlas.pages.iter().enumerate() {
        let width = size.width.max(1);
        for top in (0..size.height).step_by((STRETCH / width).max(1) as usize) {
            let bottom = size.height.min(top + (STRETCH / width).max(1));
            let rows = size.texel(0, top) as usize..size.texel(0, bottom) as usize;
            let rows = fronts[rows].par_chunks_mut(width as usize);
            rows.zip(top..bottom).for_each(|(row, y)| {
                let band: Band = subject.texels.band(page as u32, y..y + 1);
                let first = size.texel(0, y);
                for i in 0..band.len() {
                    let reflection = subject.texels.reflection(&band, i);
                    row[(band.texel(i) - first) as usize] = pack(reflection.albedo);
                }
            });
            fronts.release();
        }
    }
    let geometry = subject.world.geometry;
    fronts[sides.texels() as usize..]
        .par_iter_mut()
        .zip(sides.stand_ins())
        .for_each(|(value, &[instance, primitive])| {
            let mesh = geometry.pose.instances[instance as usize].mesh;
            let mesh = &geometry.scene.meshes[mesh as usize];
            let third = 1.0 / 3.0;
            *value = pack(diffuse_albedo(
                geometry.scene,
                mesh,
                primitive,
                third,
                third,
            ));
        });
    fronts.release();
    Ok(fronts)
}
