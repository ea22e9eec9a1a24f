//! Scenes with a view and a sky, posed frame by frame.

use crate::common::Setting;
use glam::{Vec2, Vec3};
use occlude_bvh::BuildOptions;
use occlude_image::{Limits, Picture};
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::{Geometry, Hierarchies, WorldTriangle};
use occlude_render::integrator::{
    Integrator, PathLimits, RenderReport, RenderSettings, Sequence, World,
};
use occlude_render::job::Job;
use occlude_render::light::{Environment, LightSelection, Lights, SkyFit, SkyLobes};
use occlude_render::sampling::SamplerKind;
use occlude_scene::procedural::{Name, build};
use occlude_scene::{Pose, Scene};
use occlude_visibility::{Exact, Ray};
use std::time::Instant;

/// Frames a second of the animation.
const FPS: f32 = 24.0;

/// A scene that is measured.
pub struct Stage {
    pub name: &'static str,
    pub scene: Scene,
    pub sky: Environment,
}

/// What lives from frame to frame.
#[derive(Default)]
pub struct Reel {
    pub sequence: Sequence,
    before: Option<Hierarchies>,
}

impl Reel {
    pub fn under(sky: &SkyLobes) -> Self {
        let mut reel = Self::default();
        reel.sequence.set_sky(sky.clone());
        reel
    }
}

/// A picture and what it took.
pub struct Shot {
    pub picture: Picture,
    pub report: RenderReport,
    /// Seconds for pose, hierarchies and lights; and for all together.
    pub prepared: f64,
    pub seconds: f64,
}

impl Stage {
    /// One of our own moving scenes, under a sky of the public set; `None` (said aloud) if that is missing.
    pub fn procedural(setting: &Setting, name: Name, sky: &str) -> Option<Self> {
        if !setting.wants(name.as_str()) {
            return None;
        }
        match Self::read_sky(setting, sky) {
            Some(sky) => Some(Self {
                name: name.as_str(),
                scene: build(name, None, 0),
                sky,
            }),
            None => {
                eprintln!("SKIPPED {}: its sky is missing", name.as_str());
                None
            }
        }
    }

    fn read_sky(setting: &Setting, sky: &str) -> Option<Environment> {
        let file = setting.scenes.join("env").join(sky);
        let image = occlude_image::read(&file, &Limits::default()).ok()?;
        Some(Environment::from_picture(&image.picture, 0.0, 1.0))
    }

    /// The picture of 4:3 in which about so many pixels see a surface, in the pose of a frame.
    pub fn size_for(&self, frame: u32, covered: u32) -> [u32; 2] {
        let pose = self.pose(frame);
        let options = BuildOptions::default();
        let geometry = Geometry::new(&self.scene, &pose, &options).expect("a scene with triangles");
        let (width, height) = (160, 120);
        let view = self.view(&pose, [width, height]);
        let pixels = (0..width * height)
            .map(|i| Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5));
        let rays: Vec<Ray> = pixels.map(|pixel| view.ray(pixel).ray).collect();
        let mut hits = vec![None; rays.len()];
        geometry.closest_batch(&rays, &mut hits);
        let seen = hits.iter().flatten().count().max(1) as f32;
        let scale = (covered as f32 / seen).sqrt();
        [width, height].map(|side| (side as f32 * scale).round() as u32)
    }

    /// Loads a scene of the public set with one of its skies; `None` (said aloud) if either is missing.
    pub fn load(setting: &Setting, name: &'static str, file: &str, sky: &str) -> Option<Self> {
        if !setting.wants(name) {
            return None;
        }
        let sky = Self::read_sky(setting, sky);
        match (Scene::load(&setting.scenes.join(file), None, None), sky) {
            (Ok(scene), Some(sky)) => Some(Self { name, scene, sky }),
            _ => {
                eprintln!("SKIPPED {name}: {file} or its sky is missing");
                None
            }
        }
    }

    pub fn vertices(&self) -> usize {
        let meshes = &self.scene.meshes;
        let instances = self.scene.instances.iter();
        instances
            .map(|i| meshes[i.mesh as usize].positions.len())
            .sum()
    }

    pub fn pose(&self, frame: u32) -> Pose {
        Pose::at(&self.scene, frame as f32 / FPS)
    }

    pub fn view(&self, pose: &Pose, [width, height]: [u32; 2]) -> View {
        if !self.scene.cameras.is_empty() {
            return View::of_camera(&self.scene, pose, 0, width, height);
        }
        let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        for (number, instance) in pose.instances.iter().enumerate() {
            for &position in pose.positions(&self.scene, number) {
                let place = instance.world_from_object.transform_point3(position);
                (low, high) = (low.min(place), high.max(place));
            }
        }
        View::framing(low, high, width, height)
    }

    /// Renders a frame, its preparation included in the time.
    pub fn shoot(
        &self,
        frame: u32,
        size: [u32; 2],
        sky: &Environment,
        reel: &mut Reel,
        (integrator, samples, seed): (Integrator, u32, u64),
    ) -> Shot {
        let start = Instant::now();
        let pose = self.pose(frame);
        let geometry = Geometry::after(reel.before.take(), &self.scene, &pose)
            .expect("a scene with triangles");
        let lights = Lights::new(&self.scene, &pose, Some(sky.clone()), LightSelection::Tree);
        let prepared = start.elapsed().as_secs_f64();
        let world = World {
            geometry: &geometry,
            lights: &lights,
        };
        let view = self.view(&pose, size);
        let settings = RenderSettings {
            integrator,
            sampler: SamplerKind::Sobol,
            filter: PixelFilter::Box,
            seed,
            samples: 0..samples,
            time_limit: None,
            noise: None,
        };
        let mut film = Film::new(size[0], size[1], false);
        let job = Job::new();
        let report = reel.sequence.render(
            &world,
            &view,
            &Exact,
            &settings,
            &mut film,
            &job,
            &mut |_| (),
        );
        let seconds = start.elapsed().as_secs_f64();
        reel.before = Some(geometry.into_hierarchies());
        Shot {
            seconds,
            prepared,
            report,
            picture: Picture {
                width: size[0],
                height: size[1],
                pixels: film.develop().radiance,
            },
        }
    }

    /// The lobes of the sky without suns.
    pub fn lobes(&self) -> SkyLobes {
        let mut lobes = self.sky.lobes(&SkyFit::default());
        lobes.suns.clear();
        lobes
    }

    /// Direct light by path tracing under some lobes.
    pub fn traced(&self, frame: u32, size: [u32; 2], lobes: &SkyLobes, samples: u32) -> Picture {
        let sky = as_environment(lobes);
        let work = (Integrator::Path(PathLimits::new(1)), samples, 7);
        self.shoot(frame, size, &sky, &mut Reel::default(), work)
            .picture
    }

    /// Surface points that the camera sees: place off the surface and normal.
    pub fn points(&self, geometry: &Geometry, pose: &Pose, count: u32) -> Vec<(Vec3, Vec3)> {
        let view = self.view(pose, [640, 480]);
        let mut found = Vec::new();
        let mut number = 0;
        while found.len() < count as usize && number < 64 * count {
            number += 1;
            let u = Vec2::new(0.754_877_7, 0.569_840_3) * number as f32;
            let ray = view.ray(u.fract() * Vec2::new(640.0, 480.0)).ray;
            let mut hit = [None];
            geometry.closest_batch(&[ray], &mut hit);
            let Some(hit) = hit[0] else { continue };
            let triangle = WorldTriangle::new(&self.scene, pose, hit.instance, hit.primitive);
            let Some(normal) = triangle.front_cross().try_normalize() else {
                continue;
            };
            let normal = normal * -normal.dot(ray.direction).signum();
            let place = triangle.point(hit.u, hit.v);
            found.push((
                occlude_visibility::offset_along_normal(place, normal, triangle.extent()),
                normal,
            ));
        }
        found
    }
}

/// Lobes as a map, so that a path tracer sees the same sky.
pub fn as_environment(sky: &SkyLobes) -> Environment {
    let (width, height) = (512, 256);
    let pixel = |i: u32| {
        let theta = std::f32::consts::PI * ((i / width) as f32 + 0.5) / height as f32;
        let phi = std::f32::consts::TAU * (((i % width) as f32 + 0.5) / width as f32 - 0.5);
        let w = Vec3::new(
            theta.sin() * phi.cos(),
            theta.cos(),
            theta.sin() * phi.sin(),
        );
        let lobes: Vec3 = sky.lobes.iter().map(|lobe| lobe.at(w)).sum();
        lobes.to_array()
    };
    let pixels = (0..width * height).map(pixel).collect();
    let picture = Picture {
        width,
        height,
        pixels,
    };
    Environment::from_picture(&picture, 0.0, 1.0)
}
