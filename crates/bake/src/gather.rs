//! Light that arrives at surface points, by path tracing: the oracle for bundles, and how direct light is always found.
//!
//! A sample estimates the irradiance at one point, on one side of its triangle. At every vertex of its path one light is
//! sampled and one cosine-distributed direction; what both could find is weighted by the power heuristic (Veach 1997,
//! section 9.2). Materials must be Lambert ([`occlude_scene::Material::diffuse_only`]).
//!
//! A sample is a pure function of (seed, side, sample number): batches, threads and shards do not show.
//!
//! The wrong tool for many indirect samples of many texels in a scene that rasterizes quickly: there bundles find the
//! same light with less work.

use glam::{Mat3, Vec2, Vec3};
use occlude_render::geometry::{Geometry, Surface, WorldTriangle};
use occlude_render::integrator::World;
use occlude_render::sampling::{Sampler, SamplerKind, warp};
use occlude_visibility::{Hit, Ray, Tracer, offset_along_normal};
use std::f32::consts::{FRAC_1_PI, PI};

/// Which light is gathered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Part {
    /// All of it.
    #[default]
    All,
    /// Light that comes straight from lights, emissive surfaces and the sky.
    Direct,
    /// Light that has been reflected at least once.
    Indirect,
    /// Ambient occlusion: radiance 1 from wherever nothing is in the way. Irradiance is then pi times the open share.
    Occlusion,
}

/// How a path is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSettings {
    /// Which light counts.
    pub part: Part,
    /// Reflections on the way from the light to the point at most; 0: direct light alone.
    pub bounces: u32,
    /// Rays that are not aimed at lights may meet light. If not, none are sent from a path's last vertex.
    pub luminous: bool,
    /// Reach of [`Part::Occlusion`], metres.
    pub reach: f32,
    /// Seed of all random decisions.
    pub seed: u64,
    /// Where light comes from is wanted, too: [`Gatherer::moments`].
    pub directional: bool,
}

/// A sample to take: a point on the surface, and the numbers that make it unlike the others.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceSample {
    /// The point; `t` does not matter.
    pub point: Hit,
    /// Number of the side that it stands for.
    pub side: u32,
    /// Number of the sample of that side.
    pub number: u32,
    /// The light on the triangle's back is wanted.
    pub back: bool,
}

/// The random numbers of a sample; its first set places the point in the texel ([`placement`]), the others belong to the path.
fn sampler(seed: u64, side: u32, number: u32) -> Sampler {
    Sampler::new(SamplerKind::Sobol, seed, [side, 0x6261_6b65], number)
}

/// Where in its texel sample `number` of a side lies, in `[0, 1)^2`.
pub fn placement(seed: u64, side: u32, number: u32) -> Vec2 {
    let [u, v, ..] = sampler(seed, side, number).next();
    Vec2::new(u, v)
}

/// Dimension sets of one vertex: a light, a direction.
const SETS_PER_VERTEX: u32 = 2;

/// Reflections after which roulette may end a path.
const ROULETTE_AFTER: u32 = 2;

/// A path on its way.
#[derive(Clone, Copy, Debug)]
struct Path {
    ray: Ray,
    /// What radiance that arrives along the ray counts for in the irradiance.
    throughput: Vec3,
    /// The last vertex: place, shading normal, density of the ray's direction per steradian.
    position: Vec3,
    normal: Vec3,
    pdf: f32,
    /// Direction in which the path left its first point.
    first: Vec3,
    sampler: Sampler,
    /// Reflections so far.
    reflections: u32,
    sample: u32,
}

/// A light sample whose visibility is asked.
#[derive(Clone, Copy, Debug)]
struct Pending {
    sample: u32,
    /// From the path's first point, where this light comes from.
    first: Vec3,
    contribution: Vec3,
}

/// Buffers that a worker keeps from batch to batch.
#[derive(Debug, Default)]
pub struct Gatherer {
    paths: Vec<Path>,
    arrived: Vec<Path>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    shadow_rays: Vec<Ray>,
    pending: Vec<Pending>,
    occluded: Vec<bool>,
    moments: Vec<Vec3>,
    /// Rays traced so far, shadow rays apart.
    pub secondary: u64,
    /// Shadow rays so far.
    pub shadow: u64,
}

/// The tangent frame of a shading normal.
fn frame(normal: Vec3) -> Mat3 {
    let (x, y) = warp::basis(normal);
    Mat3::from_cols(x, y, normal)
}

/// Luminance of a linear colour (Rec. 709).
#[inline]
pub fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Weight of a technique with density `a` against another with density `b`.
fn power_heuristic(a: f32, b: f32) -> f32 {
    if a.is_infinite() {
        return 1.0;
    }
    let ratio = b / a;
    1.0 / (1.0 + ratio * ratio)
}

/// A point as somebody sees it who looks straight at its front, or at its back. `None` if the triangle has no area.
pub fn surface_at<'a>(geometry: &Geometry<'a>, point: Hit, back: bool) -> Option<Surface<'a>> {
    let triangle = WorldTriangle::new(
        geometry.scene,
        geometry.pose,
        point.instance,
        point.primitive,
    );
    let front = triangle.front_cross().try_normalize()?;
    Surface::new(geometry, point, if back { -front } else { front })
}

impl Gatherer {
    /// Estimates the irradiance at every sample's point; `irradiance[i]` belongs to `samples[i]`. Points on triangles without area
    /// receive nothing.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn gather(
        &mut self,
        world: &World,
        settings: &PathSettings,
        samples: &[SurfaceSample],
        irradiance: &mut [Vec3],
    ) {
        assert_eq!(samples.len(), irradiance.len());
        irradiance.fill(Vec3::ZERO);
        self.moments.clear();
        if settings.directional {
            self.moments.resize(samples.len(), Vec3::ZERO);
        }
        self.paths.clear();
        self.start_shadows();
        for (number, sample) in samples.iter().enumerate() {
            let Some(surface) = surface_at(world.geometry, sample.point, sample.back) else {
                continue;
            };
            let sampler = sampler(settings.seed, sample.side, sample.number);
            // A perfectly reflecting Lambert surface sends out irradiance / pi.
            let start = Vertex {
                surface: &surface,
                throughput: Vec3::splat(PI),
                first: Vec3::ZERO,
                reflections: 0,
                sample: number as u32,
            };
            self.leave(world, settings, start, sampler);
        }
        self.answer(world.geometry, irradiance);
        while !self.paths.is_empty() {
            self.extend(world, settings, irradiance);
        }
    }

    /// Of the last call, by sample, if [`PathSettings::directional`]: the first moment of the light, that is the sum over directions of
    /// luminance times cosine times the unit vector to where it comes from. (Luminance times cosine alone adds up to the irradiance.)
    pub fn moments(&self) -> &[Vec3] {
        &self.moments
    }

    /// Light that arrives at a sample's point from direction `first`.
    #[inline]
    fn add(&mut self, sample: u32, first: Vec3, light: Vec3, irradiance: &mut [Vec3]) {
        irradiance[sample as usize] += light;
        if let Some(moment) = self.moments.get_mut(sample as usize) {
            *moment += first * luminance(light);
        }
    }

    fn start_shadows(&mut self) {
        self.shadow_rays.clear();
        self.pending.clear();
    }

    /// Follows every path to its next vertex.
    fn extend(&mut self, world: &World, settings: &PathSettings, irradiance: &mut [Vec3]) {
        self.rays.clear();
        self.rays.extend(self.paths.iter().map(|path| path.ray));
        self.secondary += self.rays.len() as u64;
        if settings.part == Part::Occlusion {
            self.occluded.clear();
            self.occluded.resize(self.rays.len(), false);
            world
                .geometry
                .occluded_batch(&self.rays, &mut self.occluded);
            for k in 0..self.paths.len() {
                let path = self.paths[k];
                if !self.occluded[k] {
                    self.add(path.sample, path.first, path.throughput, irradiance);
                }
            }
            self.paths.clear();
            return;
        }
        self.hits.clear();
        self.hits.resize(self.rays.len(), None);
        world.geometry.closest_batch(&self.rays, &mut self.hits);
        self.start_shadows();
        std::mem::swap(&mut self.paths, &mut self.arrived);
        self.paths.clear();
        let arrived = std::mem::take(&mut self.arrived);
        for (k, path) in arrived.iter().enumerate() {
            world.geometry.prefetch(&self.hits, k);
            match self.hits[k] {
                None => {
                    if settings.part != Part::Indirect || path.reflections > 0 {
                        let radiance = world.lights.environment(path.ray.direction);
                        if radiance != Vec3::ZERO {
                            let pdf = world.lights.pdf_environment(
                                path.position,
                                path.normal,
                                path.ray.direction,
                            );
                            let weight = power_heuristic(path.pdf, pdf);
                            let light = path.throughput * radiance * weight;
                            self.add(path.sample, path.first, light, irradiance);
                        }
                    }
                }
                Some(hit) => self.arrive(world, settings, path, hit, irradiance),
            }
        }
        self.arrived = arrived;
        self.answer(world.geometry, irradiance);
    }

    /// Adds what the surface emits, and goes on from it.
    fn arrive(
        &mut self,
        world: &World,
        settings: &PathSettings,
        path: &Path,
        hit: Hit,
        irradiance: &mut [Vec3],
    ) {
        let Some(surface) = Surface::new(world.geometry, hit, -path.ray.direction) else {
            return;
        };
        if settings.part != Part::Indirect || path.reflections > 0 {
            let emission = surface.emission(world.geometry);
            if emission != Vec3::ZERO {
                let pdf = world.lights.pdf_surface(
                    path.position,
                    path.normal,
                    hit.instance,
                    hit.primitive,
                    surface.position,
                );
                let weight = power_heuristic(path.pdf, pdf);
                let light = path.throughput * emission * weight;
                self.add(path.sample, path.first, light, irradiance);
            }
        }
        if path.reflections >= settings.bounces || surface.material().unlit {
            return;
        }
        let albedo = surface
            .bsdf_parameters(world.geometry)
            .base_color
            .clamp(Vec3::ZERO, Vec3::ONE);
        let mut throughput = path.throughput * albedo;
        let reflections = path.reflections + 1;
        let mut sampler = path.sampler;
        if reflections >= ROULETTE_AFTER {
            sampler.jump(1 + reflections * SETS_PER_VERTEX);
            let [.., roulette] = sampler.next();
            let survival = (throughput.max_element() * FRAC_1_PI).min(1.0).sqrt();
            if roulette >= survival {
                return;
            }
            throughput /= survival;
        }
        if throughput.max_element() <= 0.0 || !throughput.is_finite() {
            return;
        }
        let vertex = Vertex {
            surface: &surface,
            throughput,
            first: path.first,
            reflections,
            sample: path.sample,
        };
        self.leave(world, settings, vertex, sampler);
    }

    /// Samples a light and a direction at a vertex.
    fn leave(
        &mut self,
        world: &World,
        settings: &PathSettings,
        vertex: Vertex,
        mut sampler: Sampler,
    ) {
        let Vertex {
            surface,
            throughput,
            first,
            reflections,
            sample,
        } = vertex;
        let first = |direction| if reflections == 0 { direction } else { first };
        sampler.jump(1 + reflections * SETS_PER_VERTEX);
        let [u, v, pick, _] = sampler.next();
        let normal = surface.shading_normal();
        let origin = offset_along_normal(surface.position, surface.normal, surface.extent);
        let is_end = !settings.luminous
            && settings.part != Part::Occlusion
            && reflections >= settings.bounces;
        let direct = match settings.part {
            Part::Occlusion => false,
            Part::Indirect => reflections > 0,
            Part::All | Part::Direct => true,
        };
        if direct
            && let Some(light) = world.lights.sample(
                world.geometry.scene,
                surface.position,
                normal,
                pick,
                Vec2::new(u, v),
            )
            && light.wi.dot(surface.normal) > 0.0
        {
            let cos = normal.dot(light.wi).max(0.0);
            let weight = if light.delta || is_end {
                1.0
            } else {
                power_heuristic(light.pdf, cos * FRAC_1_PI)
            };
            let contribution = throughput * light.radiance * (cos * FRAC_1_PI * weight / light.pdf);
            if contribution != Vec3::ZERO && contribution.is_finite() {
                self.shadow_rays.push(match light.target {
                    Some(target) => Ray::between(origin, target),
                    None => Ray::new(origin, light.wi),
                });
                self.pending.push(Pending {
                    sample,
                    first: first(light.wi),
                    contribution,
                });
            }
        }
        if is_end {
            return;
        }
        let [u, v, ..] = sampler.next();
        let local = warp::cosine_hemisphere(Vec2::new(u, v));
        let direction = (frame(normal) * local).normalize();
        if local.z <= 0.0 || direction.dot(surface.normal) <= 0.0 {
            return;
        }
        let mut ray = Ray::new(origin, direction);
        if settings.part == Part::Occlusion {
            ray.t_max = settings.reach;
        }
        self.paths.push(Path {
            ray,
            throughput,
            position: surface.position,
            normal,
            pdf: warp::cosine_hemisphere_pdf(local.z),
            first: first(direction),
            sampler,
            reflections,
            sample,
        });
    }

    /// Adds the light samples that nothing blocks.
    fn answer(&mut self, geometry: &Geometry, irradiance: &mut [Vec3]) {
        self.shadow += self.shadow_rays.len() as u64;
        self.occluded.clear();
        self.occluded.resize(self.shadow_rays.len(), false);
        geometry.occluded_batch(&self.shadow_rays, &mut self.occluded);
        for k in 0..self.pending.len() {
            let pending = self.pending[k];
            if self.occluded[k] {
                continue;
            }
            let tint = if geometry.has_panes() {
                geometry.pane_transmittance(&self.shadow_rays[k])
            } else {
                Vec3::ONE
            };
            let light = pending.contribution * tint;
            self.add(pending.sample, pending.first, light, irradiance);
        }
    }
}

/// A point that a path has reached.
struct Vertex<'v, 'a> {
    surface: &'v Surface<'a>,
    throughput: Vec3,
    first: Vec3,
    reflections: u32,
    sample: u32,
}
