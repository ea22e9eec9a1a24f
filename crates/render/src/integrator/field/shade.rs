//! From sample points to pixels: neighbours are found and weighed, the sky's lobes meet the surface's, lights without size are asked by rays.

use super::eyes::{Eye, Panes, Tile, look};
use super::gloss;
use super::math::{exp, wide};
use super::points::{Points, Reach};
use super::sky::{Sky, WIDE};
use super::{Field, World};
use crate::bsdf::{Bsdf, Gloss};
use crate::camera::View;
use crate::film::Features;
use crate::geometry::Surface;
use crate::light::Lights;
use crate::sampling::{Sampler, SamplerKind};
use glam::{Vec2, Vec3};
use occlude_visibility::field::{Sites, VisibleShare, weight};
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
    /// Emissive surfaces and suns of the scene.
    pub(super) areas: Option<&'f Lights>,
    /// Points, spots and exact directions of the scene.
    pub(super) exact: Option<&'f Lights>,
    pub(super) seed: u64,
}

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Points that reach a ball: its centre and radius.
    ids: Vec<u32>,
    ball: Option<(Vec3, f32)>,
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

impl Shading<'_, '_> {
    /// Shades the middles of a tile's pixels.
    pub(super) fn tile(&self, tile: &Tile, scratch: &mut Scratch) -> Vec<Shaded> {
        scratch.lines.clear();
        let points = (0..tile.width * tile.height).map(|i| {
            let (x, y) = (tile.x + i % tile.width, tile.y + i / tile.width);
            Vec2::new(x as f32 + 0.5, y as f32 + 0.5)
        });
        scratch
            .lines
            .extend(points.map(|point| self.view.ray(point).ray));
        let lines = std::mem::take(&mut scratch.lines);
        self.gather(tile.centre, tile.radius, scratch);
        let out = self.shade(&lines, &tile.eyes, &tile.panes, [tile.x, tile.y], scratch);
        scratch.lines = lines;
        out
    }

    /// Shades other points of the picture, near each other.
    pub(super) fn more(&self, points: &[Vec2], scratch: &mut Scratch) -> Vec<Shaded> {
        let lines: Vec<Ray> = points.iter().map(|p| self.view.ray(*p).ray).collect();
        let (mut eyes, mut panes) = (
            std::mem::take(&mut scratch.eyes),
            std::mem::take(&mut scratch.panes),
        );
        look(self.world.geometry, &lines, &mut eyes, &mut panes);
        scratch.counts.primary += lines.len() as u64;
        let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        for eye in eyes.iter().flatten() {
            low = low.min(eye.position);
            high = high.max(eye.position);
        }
        if low.x <= high.x {
            let (centre, radius) = ((low + high) * 0.5, (high - low).length() * 0.5);
            let known = (scratch.ball)
                .is_some_and(|(ball, reach)| (centre - ball).length() + radius <= reach);
            if !known {
                // Other pixels of the tile will ask about the surroundings.
                self.gather(centre, 4.0 * radius, scratch);
            }
        }
        let seed = points.first().map_or([0; 2], |p| [p.x as u32, p.y as u32]);
        let out = self.shade(&lines, &eyes, &panes, seed, scratch);
        (scratch.eyes, scratch.panes) = (eyes, panes);
        out
    }

    /// Collects the points that reach a ball.
    fn gather(&self, centre: Vec3, radius: f32, scratch: &mut Scratch) {
        self.reach.around(centre, radius.max(0.0), &mut scratch.ids);
        scratch.ball = Some((centre, radius));
        scratch.sites.clear();
        for &id in &scratch.ids {
            let spot = &self.points.list[id as usize].spot;
            scratch.sites.push(spot.position, spot.normal);
        }
    }

    fn shade(
        &self,
        lines: &[Ray],
        eyes: &[Option<Eye>],
        panes: &[Panes],
        seed: [u32; 2],
        scratch: &mut Scratch,
    ) -> Vec<Shaded> {
        scratch.asked.clear();
        scratch.rays.clear();
        let lights = self.world.lights;
        let mut out: Vec<Shaded> = (lines.iter().zip(eyes).enumerate())
            .map(|(i, (line, eye))| match eye {
                Some(eye) => self.surface(i as u16, line, eye, seed, scratch),
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
            })
            .collect();
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
        out
    }

    fn surface(
        &self,
        pixel: u16,
        line: &Ray,
        eye: &Eye,
        seed: [u32; 2],
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
        if self.sky.len() > 0 {
            self.weigh(eye, scratch);
            if reflection.cosine != Vec3::ZERO {
                self.interpolate_seen(scratch);
                let irradiance = self.sky.irradiance(normal, &scratch.seen);
                radiance += reflection.cosine * irradiance * FRAC_1_PI;
            }
        }
        let coat = reflection
            .coat
            .map(|(gloss, own)| (gloss, surface.world_from_local * own));
        for (gloss, about) in [Some((reflection.gloss, normal)), coat]
            .into_iter()
            .flatten()
        {
            if gloss.albedo == Vec3::ZERO {
                continue;
            }
            if gloss.alpha == 0.0 {
                radiance += self.mirror(&surface, toward_eye, &gloss, &mut scratch.counts);
            } else if self.sky.len() > 0 {
                radiance += self.glossy(about, toward_eye, &gloss, scratch);
            }
        }
        if !bsdf.is_delta() {
            self.ask_lights(pixel, &surface, &bsdf, wo, seed, scratch);
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
        let count = self.sky.len();
        scratch.seen.clear();
        scratch.seen.resize(count, 0.0);
        for &(id, w) in &scratch.near {
            let seen = &self.points.list[id as usize].seen;
            for (sum, value) in scratch.seen.iter_mut().zip(seen) {
                *sum += value * w;
            }
        }
    }

    /// The sky in a glossy reflection about a normal.
    fn glossy(&self, normal: Vec3, toward_eye: Vec3, gloss: &Gloss, scratch: &Scratch) -> Vec3 {
        let cos_o = normal.dot(toward_eye);
        if cos_o <= 0.0 {
            return Vec3::ZERO;
        }
        let axis = 2.0 * cos_o * normal - toward_eye;
        let lobes = gloss::lobes(gloss.alpha, cos_o, self.settings.gloss_lobes as usize);
        let mut sum = Vec3::ZERO;
        for lobe in lobes.iter().filter(|lobe| lobe.amplitude > 0.0) {
            let arrives = in_lobe(self, axis, lobe.sharpness, &scratch.near);
            sum += arrives * lobe.amplitude;
        }
        sum * gloss.albedo
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
        seed: [u32; 2],
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
            let number = u32::from(pixel) * rays_each + sample;
            let mut sampler = Sampler::new(SamplerKind::Sobol, self.seed, seed, number);
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

wide! {
/// The integral of the sky's lobes times a lobe of amplitude 1 over the free directions.
fn in_lobe(shading: &Shading<'_, '_>, axis: Vec3, sharpness: f32, near: &[(u32, f32)]) -> Vec3 {
    // What brings less than this share of the sum is not asked about.
    const NEGLIGIBLE: f32 = 2e-3;
    const MOST: usize = 128;
    let sky = shading.sky;
    let share = VisibleShare::new();
    let count = sky.len().min(MOST);
    let (mut lengths, mut values) = ([0.0_f32; MOST], [0.0_f32; MOST]);
    let mut brightness = [0.0_f32; MOST];
    let mut total = [0.0_f32; WIDE];
    for start in (0..count).step_by(WIDE) {
        let lanes = |column: &Vec<f32>| -> [f32; WIDE] {
            std::array::from_fn(|k| column[start..start + WIDE][k])
        };
        let [x, y, z] = sky.axis.each_ref().map(lanes);
        let [r, g, b] = sky.amplitude.each_ref().map(lanes);
        let other = lanes(&sky.sharpness);
        for k in 0..WIDE {
            // The product of two lobes: SphericalGaussian::product.
            let cos = axis.x * x[k] + axis.y * y[k] + axis.z * z[k];
            let square = sharpness * sharpness + other[k] * other[k]
                + 2.0 * sharpness * other[k] * cos;
            let length = square.max(1e-12).sqrt();
            let whole = std::f32::consts::TAU * (1.0 - exp(-2.0 * length)) / length;
            let value = exp(length - sharpness - other[k]) * whole;
            let bright = value * (r[k] + g[k] + b[k]);
            lengths[start + k] = length;
            values[start + k] = value;
            brightness[start + k] = bright;
            total[k] += bright;
        }
    }
    let least = NEGLIGIBLE * total.iter().sum::<f32>();
    let mut sum = Vec3::ZERO;
    let mut waiting = [0usize; WIDE];
    let mut filled = 0;
    let mut k = 0;
    loop {
        while k < count && filled < WIDE {
            if brightness[k] > least {
                waiting[filled] = k;
                filled += 1;
            }
            k += 1;
        }
        if filled == 0 {
            break;
        }
        let mut w = [[0.0_f32; WIDE]; 3];
        let mut length = [1.0_f32; WIDE];
        for (lane, &k) in waiting[..filled].iter().enumerate() {
            length[lane] = lengths[k];
            let other = sky.sharpness[k];
            w[0][lane] = (axis.x * sharpness + sky.axis[0][k] * other) / lengths[k];
            w[1][lane] = (axis.y * sharpness + sky.axis[1][k] * other) / lengths[k];
            w[2][lane] = (axis.z * sharpness + sky.axis[2][k] * other) / lengths[k];
        }
        let mut distance = [0.0_f32; WIDE];
        for &(id, weight) in near {
            let point = &shading.points.list[id as usize];
            let found = point.field.at_eight(&point.hemisphere, &w);
            for lane in 0..WIDE {
                distance[lane] += found[lane] * weight;
            }
        }
        let visible = share.at_eight(&distance, &length);
        for (lane, &k) in waiting[..filled].iter().enumerate() {
            let value = values[k] * visible[lane];
            sum.x += value * sky.amplitude[0][k];
            sum.y += value * sky.amplitude[1][k];
            sum.z += value * sky.amplitude[2][k];
        }
        filled = 0;
        if k >= count {
            break;
        }
    }
    sum
}
}
