//! What the picture tests share: scenes, one-line rendering, and a brute-force path tracer to compare with.
#![allow(dead_code)] // every test file uses a part of it

pub mod brute;
pub mod scenes;

use glam::Vec3;
use occlude_bvh::BuildOptions;
use occlude_render::camera::{PixelFilter, View};
use occlude_render::film::Film;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{
    AtRest, Integrator, PathLimits, RenderReport, RenderSettings, World, render,
};
use occlude_render::job::Job;
use occlude_render::light::{LightSelection, Lights};
use occlude_render::sampling::SamplerKind;
use occlude_scene::{Pose, Scene, procedural};
use occlude_testkit::picture::Picture;
use occlude_visibility::{Exact, Occluder};

/// Everything that a picture depends on.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    pub size: (u32, u32),
    pub samples: u32,
    /// The first sample number: not 0 in a shard.
    pub first: u32,
    pub seed: u64,
    pub integrator: Integrator,
    pub sampler: SamplerKind,
    pub filter: PixelFilter,
    pub selection: LightSelection,
    pub occluder: bool,
    pub threads: usize,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            size: (16, 16),
            samples: 16,
            first: 0,
            seed: 0,
            integrator: Integrator::Path(PathLimits::new(64)),
            sampler: SamplerKind::Sobol,
            filter: PixelFilter::Box,
            selection: LightSelection::Tree,
            occluder: false,
            threads: 2,
        }
    }
}

/// Renders the scene's first camera.
pub fn film(scene: &Scene, setup: &Setup) -> (Film, RenderReport) {
    let pose = Pose::at(scene, 0.0);
    let geometry = Geometry::new(scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(scene, &pose, None, setup.selection);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let (width, height) = setup.size;
    let view = View::of_camera(scene, &pose, 0, width, height);
    let settings = RenderSettings {
        integrator: setup.integrator,
        sampler: setup.sampler,
        filter: setup.filter,
        seed: setup.seed,
        samples: setup.first..setup.samples,
        time_limit: None,
        noise: None,
    };
    let mut film = Film::new(width, height, false);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(setup.threads)
        .build()
        .unwrap();
    let report = pool.install(|| {
        let (film, job, done) = (&mut film, Job::new(), &mut |_: &AtRest| {});
        if setup.occluder {
            render(
                &world,
                &view,
                &Occluder::default(),
                &settings,
                film,
                &job,
                done,
            )
        } else {
            render(&world, &view, &Exact, &settings, film, &job, done)
        }
    });
    (film, report)
}

/// Mean and uncertainty of `runs` renderings with different seeds.
pub fn picture(scene: &Scene, setup: &Setup, runs: u64) -> Picture {
    let run = |i| {
        let (film, _) = film(
            scene,
            &Setup {
                seed: setup.seed + i,
                ..*setup
            },
        );
        film.develop().radiance.concat()
    };
    let (width, height) = setup.size;
    Picture::from_runs(
        width as usize,
        height as usize,
        3,
        &(0..runs).map(run).collect::<Vec<_>>(),
    )
}

/// A closed room: base colour 0.5 and emission 0.5 everywhere.
pub fn furnace() -> Scene {
    procedural::build(procedural::Name::Furnace, None, 0)
}

/// The Cornell box with its lamp.
pub fn cornell() -> Scene {
    procedural::build(procedural::Name::Cornell, None, 0)
}

/// The Cornell box made white and lampless, open to the front, under a white sky: radiance is 1 everywhere.
pub fn white_box_in_white_sky() -> Scene {
    let mut scene = cornell();
    for material in &mut scene.materials {
        material.base_color = glam::Vec4::ONE;
        material.emission = Vec3::ZERO;
    }
    scene.sky = Vec3::ONE;
    scene
}
