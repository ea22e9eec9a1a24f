//! From sample points to pixels: neighbours are found and weighed, the sky's lobes meet the surface's, lights without size are asked by rays.
//!
//! Wang et al. 2013, section 6: fields of the points around a pixel are interpolated by Eq. 8's weights, which here fall to 0 at a point's radius and are corrected to
//! the first order ([`Shading::balance`]), and the product of a lobe of the sky and one of the surface (Eq. 2) is visible to the share that a straight edge at the
//! interpolated distance leaves (Wang et al. 2009). Fresnel's term, shadowing and the cosine are in the lobes' albedo ([`super::gloss`]).
//!
//! Holds: weights of a pixel sum to 1; the same pixel has the same value whatever the threads; radiance is finite and not negative.
//!
//! Wrong tool where visibility changes within fewer pixels than lie between sample points (contact: rays of [`super::Field::contact`]), where what is seen through a slit or past a twig
//! matters (one edge stands for two), and for what does not leave the surface on the side of the light.

use super::batch::{ANCHORS, AT, Anchors, Batch, ITEMS, Predicted};
use super::cells::Cells;
use super::eyes::{Eye, Panes, Tile, look};
use super::gloss;
use super::lamps::{Distances, Lamps, Seen};
use super::lobe::in_lobe;
use super::points::{Contact, Near, Points, Reach};
use super::rest::Rest;
use super::sky::Sky;
use super::{Field, World};
use crate::bsdf::{Bsdf, Gloss};
use crate::camera::View;
use crate::film::Features;
use crate::geometry::Surface;
use crate::light::Lights;
use crate::sampling::{Sampler, SamplerKind};
use glam::{Vec2, Vec3};
use occlude_visibility::field::{Sites, weight};
use occlude_visibility::{Ray, Tracer, offset_along_normal};
use std::f32::consts::FRAC_1_PI;

/// Points that speak for a pixel, at most.
const MOST_NEAR: usize = 12;

/// What a frame's pixels are shaded with.
pub(super) struct Shading<'f, 'a> {
    pub(super) world: &'f World<'a>,
    pub(super) view: &'f View,
    pub(super) settings: &'f Field,
    pub(super) points: &'f Points,
    pub(super) reach: &'f Reach,
    pub(super) sky: &'f Sky,
    /// What the sky has beside its lobes.
    pub(super) rest: Option<&'f Rest>,
    /// Emissive surfaces as lobes, unless there are none or too many.
    pub(super) lamps: Option<&'f Lamps>,
    /// Suns of the scene, and emissive surfaces that are no lobes.
    pub(super) areas: Option<&'f Lights>,
    /// Points, spots and exact directions of the scene.
    pub(super) exact: Option<&'f Lights>,
    pub(super) seed: u64,
    /// How far contact rays go, metres; 0: there are none.
    pub(super) contact: f32,
    /// Points know of light from near by.
    pub(super) near: bool,
}

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Points that reach the surfaces at hand.
    ids: Vec<u32>,
    sites: Sites,
    distances: Vec<f32>,
    near: Vec<(u32, f32)>,
    seen: Vec<f32>,
    asked: Vec<Asked>,
    rays: Vec<Ray>,
    blocked: Vec<bool>,
    eyes: Vec<Option<Eye>>,
    panes: Vec<Panes>,
    lines: Vec<Ray>,
    spots: Vec<Spot>,
    anchors: Anchors,
    predicted: Vec<Option<Predicted>>,
    batch: Batch,
    /// Which pixels the batch is of.
    batched: Vec<u16>,
    cells: Cells,
    lamps: Vec<Seen>,
    contact: Contact,
    pub(super) counts: Counts,
}

/// Rays that shading traced.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub(super) primary: u64,
    pub(super) shadow: u64,
}

/// Light that arrives if its ray is free.
#[derive(Clone, Copy, Debug)]
struct Asked {
    pixel: u16,
    radiance: Vec3,
}

/// A shaded point of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shaded {
    pub(super) radiance: Vec3,
    pub(super) features: Features,
}

/// Where a shading point lies in its tile, and its random numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Pixels from the middle of the tile's first pixel.
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) seed: [u32; 2],
    pub(super) number: u32,
}

impl Shading<'_, '_> {
    /// Shades the middles of a tile's pixels.
    pub(super) fn tile(&self, tile: &Tile, scratch: &mut Scratch) -> Vec<Shaded> {
        let mut lines = std::mem::take(&mut scratch.lines);
        let mut spots = std::mem::take(&mut scratch.spots);
        lines.clear();
        spots.clear();
        for number in 0..tile.width * tile.height {
            let (x, y) = (number % tile.width, number / tile.width);
            lines.push(self.line(tile, x as f32, y as f32));
            spots.push(Spot {
                x: x as f32,
                y: y as f32,
                seed: [tile.x, tile.y],
                number,
            });
        }
        self.gather(tile.centre, tile.radius, scratch);
        let mut out = Vec::with_capacity(lines.len());
        self.shade(
            tile,
            &lines,
            &spots,
            &tile.eyes,
            &tile.panes,
            scratch,
            &mut out,
        );
        (scratch.lines, scratch.spots) = (lines, spots);
        out
    }

    /// Shades other points of a tile.
    pub(super) fn more(&self, tile: &Tile, spots: &[Spot], scratch: &mut Scratch) -> Vec<Shaded> {
        let mut lines = std::mem::take(&mut scratch.lines);
        let (mut eyes, mut panes) = (
            std::mem::take(&mut scratch.eyes),
            std::mem::take(&mut scratch.panes),
        );
        let mut out = Vec::with_capacity(spots.len());
        for spots in spots.chunks(ITEMS) {
            lines.clear();
            lines.extend(spots.iter().map(|spot| self.line(tile, spot.x, spot.y)));
            look(self.world.geometry, &lines, &mut eyes, &mut panes);
            scratch.counts.primary += lines.len() as u64;
            let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
            for eye in eyes.iter().flatten() {
                low = low.min(eye.position);
                high = high.max(eye.position);
            }
            if low.x <= high.x {
                self.gather((low + high) * 0.5, (high - low).length() * 0.5, scratch);
            }
            self.shade(tile, &lines, spots, &eyes, &panes, scratch, &mut out);
        }
        (scratch.lines, scratch.eyes, scratch.panes) = (lines, eyes, panes);
        out
    }

    /// The line of sight so many pixels from the middle of the tile's first pixel.
    fn line(&self, tile: &Tile, x: f32, y: f32) -> Ray {
        let corner = Vec2::new(tile.x as f32 + 0.5, tile.y as f32 + 0.5);
        self.view.ray(corner + Vec2::new(x, y)).ray
    }

    fn asks_points(&self) -> bool {
        self.sky.len() > 0 || self.near || self.lamps.is_some()
    }

    /// Collects the points that reach a ball.
    fn gather(&self, centre: Vec3, radius: f32, scratch: &mut Scratch) {
        self.reach.around(centre, radius.max(0.0), &mut scratch.ids);
        scratch.sites.clear();
        for &id in &scratch.ids {
            let spot = &self.points.list[id as usize].spot;
            scratch.sites.push(spot.position, spot.normal);
        }
    }

    /// What the tile's anchors say about shading points: nothing, where too few are as they predict.
    fn predict(&self, tile: &Tile, spots: &[Spot], eyes: &[Option<Eye>], scratch: &mut Scratch) {
        /// Nine anchors cost as much as so many points by themselves.
        const FEWEST: usize = 14;
        let Scratch {
            anchors, predicted, ..
        } = scratch;
        predicted.clear();
        let asks = self.settings.shared && !self.settings.cells && self.asks_points();
        if !asks || tile.is_empty() || spots.len() < FEWEST {
            predicted.resize(spots.len(), None);
            return;
        }
        let mut at = [None; ANCHORS];
        let mut toward_eye = [Vec3::ZERO; ANCHORS];
        for (k, (at, toward)) in at.iter_mut().zip(&mut toward_eye).enumerate() {
            let (x, y) = (AT[k % AT.len()], AT[k / AT.len()]);
            if x < tile.width && y < tile.height {
                *at = tile.eyes[(y * tile.width + x) as usize];
                *toward = -self.line(tile, x as f32, y as f32).direction;
            }
        }
        let (a, b) = (self.line(tile, 0.0, 0.0), self.line(tile, 1.0, 0.0));
        let pixel = [
            (b.direction - a.direction).length(),
            (b.origin - a.origin).length(),
        ];
        anchors.set(at, toward_eye, pixel);
        let found = spots.iter().zip(eyes).map(|(spot, eye)| {
            let eye = eye.as_ref()?;
            anchors.predict(eye, spot.x, spot.y)
        });
        predicted.extend(found);
        if predicted.iter().flatten().count() < FEWEST {
            predicted.fill(None);
            return;
        }
        let mut anchors = std::mem::take(anchors);
        for (k, at) in at.iter().enumerate() {
            if let Some(eye) = at {
                self.weigh(eye, scratch);
                anchors.speak(k, &scratch.near);
            }
        }
        anchors.look(self.points, self.sky);
        scratch.anchors = anchors;
    }

    #[allow(clippy::too_many_arguments)]
    fn shade(
        &self,
        tile: &Tile,
        lines: &[Ray],
        spots: &[Spot],
        eyes: &[Option<Eye>],
        panes: &[Panes],
        scratch: &mut Scratch,
        out: &mut Vec<Shaded>,
    ) {
        scratch.asked.clear();
        scratch.rays.clear();
        scratch.batch.clear();
        scratch.batched.clear();
        self.predict(tile, spots, eyes, scratch);
        let first = out.len();
        let lights = self.world.lights;
        for (i, ((line, eye), spot)) in lines.iter().zip(eyes).zip(spots).enumerate() {
            out.push(match eye {
                Some(eye) => self.surface(i as u16, line, eye, spot, scratch),
                None => {
                    let radiance = lights.environment(line.direction);
                    let albedo = radiance.clamp(Vec3::ZERO, Vec3::ONE);
                    Shaded {
                        radiance,
                        features: Features {
                            albedo,
                            ..Features::default()
                        },
                    }
                }
            });
        }
        let out = &mut out[first..];
        if !scratch.batch.is_empty() {
            let batch = &mut scratch.batch;
            batch.light(self.points, self.sky, &scratch.anchors);
            for (item, &pixel) in scratch.batched.iter().enumerate() {
                out[usize::from(pixel)].radiance += batch.radiance(item);
            }
        }
        for shaded in &mut *out {
            // What the sky has less than its lobes may be more than they bring.
            if shaded.radiance.min_element() < 0.0 {
                shaded.radiance = shaded.radiance.max(Vec3::ZERO);
            }
        }
        let geometry = self.world.geometry;
        scratch.blocked.clear();
        scratch.blocked.resize(scratch.rays.len(), false);
        geometry.occluded_batch(&scratch.rays, &mut scratch.blocked);
        scratch.counts.shadow += scratch.rays.len() as u64;
        for ((asked, blocked), ray) in
            (scratch.asked.iter().zip(&scratch.blocked)).zip(&scratch.rays)
        {
            if !blocked {
                let tint = geometry.pane_transmittance(ray);
                out[usize::from(asked.pixel)].radiance += asked.radiance * tint;
            }
        }
        for pane in panes {
            let line = &lines[usize::from(pane.index)];
            let shaded = &mut out[usize::from(pane.index)];
            shaded.radiance *= pane.tint;
            // What the first pane mirrors of the sky.
            if let Some(surface) = Surface::new(geometry, pane.first, -line.direction) {
                let wo = surface.world_from_local.transpose() * -line.direction;
                let bsdf = Bsdf::new(&surface.bsdf_parameters(geometry), wo);
                let gloss = bsdf.reflection().gloss;
                shaded.radiance +=
                    self.mirror(&surface, -line.direction, &gloss, &mut scratch.counts);
            }
        }
    }

    fn surface(
        &self,
        pixel: u16,
        line: &Ray,
        eye: &Eye,
        spot: &Spot,
        scratch: &mut Scratch,
    ) -> Shaded {
        let geometry = self.world.geometry;
        let toward_eye = -line.direction;
        let Some(surface) = Surface::new(geometry, eye.hit, toward_eye) else {
            return Shaded::default();
        };
        let mut radiance = surface.emission(geometry);
        let normal = surface.shading_normal();
        if surface.material().unlit {
            let albedo = radiance.min(Vec3::ONE);
            let features = Features {
                albedo,
                normal,
                depth: eye.hit.t,
            };
            return Shaded { radiance, features };
        }
        let local_from_world = surface.world_from_local.transpose();
        let wo = local_from_world * toward_eye;
        let bsdf = Bsdf::new(&surface.bsdf_parameters(geometry), wo);
        let reflection = bsdf.reflection();
        if self.asks_points() {
            let coat = reflection
                .coat
                .map(|(gloss, own)| (gloss, surface.world_from_local * own));
            let mut gloss = reflection.gloss;
            let count = self.settings.gloss_lobes as usize;
            let matt = gloss::matt_share(gloss.alpha, normal.dot(toward_eye), count);
            let cosine = reflection.cosine + gloss.albedo * matt;
            gloss.albedo *= 1.0 - matt;
            let glosses = [Some((gloss, normal)), coat];
            radiance += self.under_sky(pixel, eye, &surface, toward_eye, cosine, glosses, scratch);
        }
        let mirrors = [
            Some(&reflection.gloss),
            reflection.coat.as_ref().map(|(gloss, _)| gloss),
        ];
        for gloss in mirrors.into_iter().flatten() {
            if gloss.alpha == 0.0 {
                radiance += self.mirror(&surface, toward_eye, gloss, &mut scratch.counts);
            }
        }
        if !bsdf.is_delta() {
            self.ask_lights(pixel, &surface, &bsdf, wo, spot, scratch);
        }
        Shaded {
            radiance,
            features: Features {
                albedo: bsdf.albedo(),
                normal,
                depth: eye.hit.t,
            },
        }
    }

    /// What lobes of the sky bring to a pixel by itself; what can be had from the anchors goes to the batch.
    #[allow(clippy::too_many_arguments)]
    fn under_sky(
        &self,
        pixel: u16,
        eye: &Eye,
        surface: &Surface,
        toward_eye: Vec3,
        mut cosine: Vec3,
        glosses: [Option<(Gloss, Vec3)>; 2],
        scratch: &mut Scratch,
    ) -> Vec3 {
        let predicted = scratch.predicted[usize::from(pixel)];
        let normal = surface.shading_normal();
        let mut radiance = Vec3::ZERO;
        let mut weighed = false;
        let mut weigh = |scratch: &mut Scratch| {
            if !std::mem::replace(&mut weighed, true) {
                self.weigh(eye, scratch);
            }
        };
        if let Some(lamps) = self.lamps {
            let distances = match &predicted {
                Some(at) => scratch.anchors.lamps(at),
                None => {
                    weigh(scratch);
                    let mut sum = Distances::default();
                    for &(id, weight) in &scratch.near {
                        let own = &self.points.list[id as usize].lamps;
                        for (sum, distance) in sum.iter_mut().zip(own) {
                            *sum += distance * weight;
                        }
                    }
                    sum
                }
            };
            lamps.seen(surface.position, normal, &distances, &mut scratch.lamps);
            if cosine != Vec3::ZERO {
                let light = lamps.irradiance(surface.position, normal, &scratch.lamps);
                radiance += cosine * light * FRAC_1_PI;
            }
        }
        if self.near && cosine != Vec3::ZERO {
            let near = match &predicted {
                Some(at) => scratch.anchors.near(at),
                None => {
                    weigh(scratch);
                    let mut sum = Near::default();
                    for &(id, weight) in &scratch.near {
                        sum.add(&self.points.list[id as usize].near, weight);
                    }
                    sum
                }
            };
            radiance += cosine * (near.bounced + near.rest) * FRAC_1_PI;
            if self.contact > 0.0 {
                cosine *= self.in_contact(pixel, surface, &near, scratch);
            }
        }
        let mut item = None;
        if let Some(at) = &predicted {
            item = Some(scratch.batch.push(at, normal, cosine));
            scratch.batched.push(pixel);
        } else if self.settings.cells {
            weigh(scratch);
            let Scratch { cells, near, .. } = scratch;
            cells.set(self.points, normal, near);
            radiance += scratch.cells.irradiance(self.points, self.sky) * cosine * FRAC_1_PI;
        } else if cosine != Vec3::ZERO {
            weigh(scratch);
            self.interpolate_seen(scratch);
            let irradiance = self.sky.irradiance(normal, &scratch.seen);
            radiance += cosine * irradiance * FRAC_1_PI;
        }
        let count = self.settings.gloss_lobes as usize;
        for (number, (gloss, about)) in glosses.into_iter().flatten().enumerate() {
            let cos_o = about.dot(toward_eye);
            if gloss.albedo == Vec3::ZERO || gloss.alpha == 0.0 || cos_o <= 0.0 {
                continue;
            }
            let axis = 2.0 * cos_o * about - toward_eye;
            let lobes = gloss::lobes(gloss.alpha, cos_o, count);
            for (k, lobe) in lobes.iter().enumerate() {
                if lobe.amplitude <= 0.0 {
                    continue;
                }
                let amplitude = gloss.albedo * lobe.amplitude;
                let rest =
                    (self.rest).map_or(Vec3::ZERO, |rest| rest.in_lobe(axis, lobe.sharpness));
                if let Some(lamps) = self.lamps
                    && !scratch.lamps.is_empty()
                {
                    let (place, seen) = (surface.position, &scratch.lamps);
                    radiance +=
                        lamps.in_lobe(place, normal, seen, axis, lobe.sharpness) * amplitude;
                }
                match (item, &predicted) {
                    (Some(item), Some(at)) if at.leads_to(axis, lobe.sharpness) => {
                        let layer = number * count + k;
                        let batch = &mut scratch.batch;
                        batch.gloss(item, layer, axis, lobe.sharpness, [amplitude, rest]);
                    }
                    _ if self.settings.cells => {
                        let (cells, sharpness) = (&scratch.cells, lobe.sharpness);
                        let light = cells.in_lobe(self.points, self.sky, axis, sharpness, rest);
                        radiance += light * amplitude;
                    }
                    _ => {
                        weigh(scratch);
                        let light = in_lobe(self, axis, lobe.sharpness, rest, &scratch.near);
                        radiance += light * amplitude;
                    }
                }
            }
        }
        radiance
    }

    /// What contact leaves of light from afar: the share that is free close by, over that of the points around.
    fn in_contact(&self, pixel: u16, surface: &Surface, near: &Near, scratch: &mut Scratch) -> f32 {
        /// Where points see next to nothing, a ratio says nothing.
        const LEAST: f32 = 0.05;
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let (normal, count) = (surface.shading_normal(), self.settings.contact);
        scratch.counts.shadow += u64::from(count);
        let turn = f32::from(pixel) * 0.754_877_7;
        let geometry = self.world.geometry;
        let contact = &mut scratch.contact;
        let blocked = contact.blocked(geometry, origin, normal, self.contact, count, turn);
        ((1.0 - blocked) / (1.0 - near.blocked).max(LEAST)).min(2.0)
    }

    /// Finds the points that speak for a place; their weights sum to 1.
    fn weigh(&self, eye: &Eye, scratch: &mut Scratch) {
        let metric = self.points.metric;
        let near = &mut scratch.near;
        near.clear();
        metric.distances(
            eye.position,
            eye.normal,
            &scratch.sites,
            &mut scratch.distances,
        );
        for (&id, &distance) in scratch.ids.iter().zip(&scratch.distances) {
            let point = &self.points.list[id as usize];
            let w = weight(distance, point.radius) * point.strength;
            if w > 0.0 {
                near.push((id, w));
            }
        }
        if near.is_empty() {
            // Where no point reaches, the nearest ones must do.
            let mut nearest: Option<(f32, u32)> = None;
            for (id, point) in self.points.list.iter().enumerate() {
                if !point.needed {
                    continue;
                }
                let spot = &point.spot;
                let d = metric.distance(eye.position, eye.normal, spot.position, spot.normal);
                // Points that look away come last, by distance in space.
                let d = if d.is_finite() {
                    d
                } else {
                    1e3 + (spot.position - eye.position).length()
                };
                if nearest.is_none_or(|(least, _)| d < least) {
                    nearest = Some((d, id as u32));
                }
            }
            near.extend(nearest.map(|(_, id)| (id, 1.0)));
        }
        if near.len() > MOST_NEAR {
            near.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            near.truncate(MOST_NEAR);
        }
        self.balance(eye, near);
    }

    /// Makes weights sum to 1, and their points' middle lie at the eye as far as may be: what grows evenly along the surface is then interpolated
    /// exactly, where plain weights make steps around the points (moving least squares; Shepard 1968 beyond the first order).
    fn balance(&self, eye: &Eye, near: &mut [(u32, f32)]) {
        // Where all points lie on one side the middle is not to be had: the correction ends at this share of the weight.
        const LEAST: f32 = 0.25;
        let (s, t) = eye.normal.any_orthonormal_pair();
        let place = |id: u32| {
            let step = self.points.list[id as usize].spot.position - eye.position;
            Vec2::new(step.dot(s), step.dot(t))
        };
        let (mut sum, mut first) = (0.0_f32, Vec2::ZERO);
        let (mut xx, mut xy, mut yy) = (0.0_f32, 0.0_f32, 0.0_f32);
        for &(id, w) in near.iter() {
            let p = place(id);
            sum += w;
            first += p * w;
            (xx, xy, yy) = (xx + w * p.x * p.x, xy + w * p.x * p.y, yy + w * p.y * p.y);
        }
        let ridge = 0.05 * (xx + yy) + 1e-30;
        let (xx, yy) = (xx + ridge, yy + ridge);
        let det = xx * yy - xy * xy;
        let slope = -Vec2::new(yy * first.x - xy * first.y, xx * first.y - xy * first.x) / det;
        let taken = -slope.dot(first) / sum;
        // A lone point right here says nothing about slopes.
        let slope = if !taken.is_finite() {
            Vec2::ZERO
        } else if taken > 1.0 - LEAST {
            slope * ((1.0 - LEAST) / taken)
        } else {
            slope
        };
        let mut total = 0.0;
        for (id, w) in near.iter_mut() {
            *w *= 1.0 + slope.dot(place(*id));
            total += *w;
        }
        for (_, w) in near.iter_mut() {
            *w /= total;
        }
    }

    fn interpolate_seen(&self, scratch: &mut Scratch) {
        let count = self.sky.seen_len();
        scratch.seen.clear();
        scratch.seen.resize(count, 0.0);
        for &(id, w) in &scratch.near {
            let seen = &self.points.list[id as usize].seen;
            for (sum, value) in scratch.seen.iter_mut().zip(seen) {
                *sum += value * w;
            }
        }
    }

    /// What a mirror shows of the sky and of emissive surfaces: one ray.
    fn mirror(
        &self,
        surface: &Surface,
        toward_eye: Vec3,
        gloss: &Gloss,
        counts: &mut Counts,
    ) -> Vec3 {
        let geometry = self.world.geometry;
        let normal = surface.shading_normal();
        let direction = 2.0 * normal.dot(toward_eye) * normal - toward_eye;
        if gloss.albedo == Vec3::ZERO || direction.dot(surface.normal) <= 0.0 {
            return Vec3::ZERO;
        }
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let ray = Ray::new(origin, direction);
        let (mut eyes, mut panes) = (Vec::new(), Vec::new());
        look(geometry, &[ray], &mut eyes, &mut panes);
        counts.shadow += 1;
        let arrives = match eyes[0] {
            None => self.world.lights.environment(direction),
            Some(eye) => Surface::new(geometry, eye.hit, -direction)
                .map_or(Vec3::ZERO, |seen| seen.emission(geometry)),
        };
        let tint = panes.first().map_or(Vec3::ONE, |pane| pane.tint);
        arrives * tint * gloss.albedo
    }

    /// Asks lights that no map knows: of the scene those without extent, surfaces and suns by samples; suns that were taken out of the sky.
    fn ask_lights(
        &self,
        pixel: u16,
        surface: &Surface,
        bsdf: &Bsdf,
        wo: Vec3,
        spot: &Spot,
        scratch: &mut Scratch,
    ) {
        let geometry = self.world.geometry;
        let local_from_world = surface.world_from_local.transpose();
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let Scratch { asked, rays, .. } = scratch;
        let mut ask = |wi: Vec3, target: Option<Vec3>, arrives: Vec3| {
            if wi.dot(surface.normal) <= 0.0 {
                return;
            }
            let local = local_from_world * wi;
            if local.z <= 0.0 {
                return;
            }
            let (f_cos, _) = bsdf.eval(wo, local);
            let radiance = f_cos * arrives;
            if radiance != Vec3::ZERO && radiance.is_finite() {
                asked.push(Asked { pixel, radiance });
                rays.push(match target {
                    Some(target) => Ray::between(origin, target),
                    None => Ray::new(origin, wi),
                });
            }
        };
        if let Some(lights) = self.exact {
            for light in lights.deltas() {
                if let Some((wi, target, irradiance)) = light.at(surface.position) {
                    ask(wi, target, irradiance);
                }
            }
        }
        if self.sky.suns.is_empty() && self.areas.is_none() {
            return;
        }
        let rays_each = self.settings.light_samples.max(1);
        let normal = surface.shading_normal();
        for sample in 0..rays_each {
            let number = spot.number * rays_each + sample;
            let mut sampler = Sampler::new(SamplerKind::Sobol, self.seed, spot.seed, number);
            let [u, v, pick, _] = sampler.next();
            let share = 1.0 / rays_each as f32;
            for sun in &self.sky.suns {
                ask(super::towards_sun(sun, u, v), None, sun.irradiance * share);
            }
            let Some(areas) = self.areas else { continue };
            let found = areas.sample(
                geometry.scene,
                surface.position,
                normal,
                pick,
                Vec2::new(u, v),
            );
            if let Some(light) = found {
                ask(light.wi, light.target, light.radiance * (share / light.pdf));
            }
        }
    }
}
