//! The scenes of the suite, and what is rendered of each.

use super::shot::{Stage, instant_radiosity};
use crate::common::{Report, Setting};
use glam::{Affine3A, Vec3};
use occlude_bvh::BuildOptions;
use occlude_image::Picture;
use occlude_render::camera::View;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::{Integrator, PathLimits};
use occlude_render::light::{Environment, LightSelection, Lights};
use occlude_scene::{Light, LightKind, Node, Pose, Scene, procedural};
use occlude_visibility::quantized::BoundingSphere;

/// Where a scene comes from.
#[derive(Clone, Copy)]
pub enum Source {
    /// A file of the scenes folder, and the scene in it.
    File(&'static str, Option<&'static str>),
    /// Made in memory.
    Procedural(procedural::Name),
}

/// What is changed in a scene before it is rendered.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Change {
    None,
    /// Points and exact directions alone: suns lose their width, skies and lamps of some size go out.
    DeltaLights,
    /// A sky in soft blue with a bright side.
    Sky,
    /// Three points and a view, which the file lacks (sibenik; values from the scenes' README).
    ThreePoints,
}

/// A scene and how instant radiosity lights it.
pub struct Subject {
    pub name: &'static str,
    pub source: Source,
    pub change: Change,
    pub max_depth: u32,
    pub vpls: u32,
    /// What the project wants to reach: times fewer rays, times faster.
    pub bars: [Option<f64>; 2],
    /// Parts of the suite that use it, when all is measured.
    pub topics: &'static [&'static str],
    /// The same for `--quick`, with this many virtual lights.
    pub quick: (&'static [&'static str], u32),
}

/// A subject with the usual choices.
pub const fn subject(
    name: &'static str,
    source: Source,
    bars: [Option<f64>; 2],
    topics: &'static [&'static str],
) -> Subject {
    Subject {
        name,
        source,
        change: Change::None,
        max_depth: 8,
        vpls: 1024,
        bars,
        topics,
        quick: (&[], 0),
    }
}

const CURVED: &[&str] = &["reduction", "pictures", "curves"];

/// All subjects.
pub const SUBJECTS: &[Subject] = &[
    // What the paper measured, on stand-ins.
    Subject {
        quick: (
            &[
                "cost",
                "reduction",
                "pictures",
                "curves",
                "collisions",
                "sweeps",
            ],
            64,
        ),
        ..subject(
            "apartment",
            Source::Procedural(procedural::Name::Apartment),
            [Some(50.0), Some(5.0)],
            &[
                "cost",
                "reduction",
                "pictures",
                "curves",
                "collisions",
                "sweeps",
            ],
        )
    },
    Subject {
        change: Change::DeltaLights,
        max_depth: 1,
        quick: (&["reduction", "shadow-maps"], 0),
        ..subject(
            "apartment_delta",
            Source::Procedural(procedural::Name::Apartment),
            [None, None],
            &["reduction", "pictures", "curves", "shadow-maps"],
        )
    },
    Subject {
        max_depth: 1,
        ..subject(
            "conference",
            Source::Procedural(procedural::Name::Conference),
            [None, None],
            &["reduction", "pictures", "curves", "bidirectional"],
        )
    },
    subject(
        "courtyard",
        Source::Procedural(procedural::Name::Courtyard),
        [Some(50.0), Some(10.0)],
        CURVED,
    ),
    Subject {
        vpls: 256,
        ..subject(
            "hairball",
            Source::Procedural(procedural::Name::Hairball),
            [Some(10.0), Some(4.0)],
            CURVED,
        )
    },
    // A box, where no gain is expected.
    Subject {
        quick: (
            &["reduction", "bidirectional", "unbiased", "consistent"],
            64,
        ),
        ..subject(
            "cornell",
            Source::Procedural(procedural::Name::Cornell),
            [None, None],
            &["reduction", "bidirectional"],
        )
    },
    // Files.
    Subject {
        max_depth: 1,
        ..subject(
            "many_lights",
            Source::File("apartment.glb", Some("many_lights")),
            [Some(50.0), Some(5.0)],
            CURVED,
        )
    },
    Subject {
        change: Change::Sky,
        ..subject(
            "many_lights_gi",
            Source::File("apartment.glb", Some("many_lights")),
            [Some(50.0), Some(5.0)],
            &["cost", "reduction", "pictures"],
        )
    },
    subject(
        "dream_house",
        Source::File("apartment.glb", None),
        [Some(50.0), Some(5.0)],
        &["reduction", "bidirectional", "unbiased"],
    ),
    subject(
        "bedroom",
        Source::File("bedroom.glb", None),
        [Some(50.0), Some(5.0)],
        &["cost", "reduction", "pictures", "curves"],
    ),
    subject(
        "sponza",
        Source::File("sponza.glb", None),
        [None, Some(10.0)],
        &[
            "cost",
            "reduction",
            "pictures",
            "curves",
            "collisions",
            "sweeps",
            "walkthrough",
        ],
    ),
    subject(
        "victorian_house",
        Source::File("victorian_house.glb", None),
        [None, Some(10.0)],
        CURVED,
    ),
    Subject {
        vpls: 256,
        ..subject(
            "sintel_hair",
            Source::File("sintel_hair.glb", None),
            [Some(10.0), Some(4.0)],
            &["cost", "reduction", "pictures"],
        )
    },
    subject(
        "white_room",
        Source::File("white_room.glb", None),
        [None, None],
        &["reduction", "pictures", "curves", "consistent"],
    ),
    Subject {
        change: Change::ThreePoints,
        ..subject(
            "sibenik",
            Source::File("sibenik/sibenik.obj", None),
            [None, None],
            CURVED,
        )
    },
];

impl Subject {
    /// The parts of the suite that this run wants of it.
    pub fn wanted(&self, setting: &Setting) -> Vec<&'static str> {
        let topics = if setting.quick {
            self.quick.0
        } else {
            self.topics
        };
        let topics = topics.iter().filter(|topic| setting.wants_topic(topic));
        topics.copied().collect()
    }

    /// How it is rendered where both sides are compared.
    pub fn integrator(&self, setting: &Setting) -> Integrator {
        if self.name == "conference" {
            // Lamps with extent: each eye sample asks about one point of one lamp.
            Integrator::Path(PathLimits::new(self.max_depth))
        } else {
            instant_radiosity(self.max_depth, self.vpls(setting))
        }
    }

    pub fn vpls(&self, setting: &Setting) -> u32 {
        if setting.quick {
            self.quick.1
        } else {
            self.vpls
        }
    }

    /// Loads, builds and hands over; scenes that are not there are skipped loudly.
    pub fn with_stage(
        &self,
        setting: &Setting,
        report: &mut Report,
        work: impl FnOnce(&Stage, &mut Report),
    ) {
        eprintln!("== {}", self.name);
        let mut scene = match self.load(setting) {
            Ok(scene) => scene,
            Err(why) => return report.note(format!("SKIPPED {}: {why}", self.name)),
        };
        self.change(&mut scene);
        let pose = Pose::at(&scene, 0.0);
        let geometry = match Geometry::new(&scene, &pose, &BuildOptions::default()) {
            Ok(geometry) => geometry,
            Err(error) => return report.note(format!("SKIPPED {}: {error}", self.name)),
        };
        let environment = (self.change == Change::Sky).then(soft_sky);
        let lights = Lights::new(&scene, &pose, environment, LightSelection::Tree);
        let (min, max) = bounds(&scene, &pose);
        let change = self.change;
        let directions = (scene.lights.iter())
            .filter(|light| matches!(light.kind, LightKind::Directional { .. }))
            .count();
        let stage = Stage {
            geometry: &geometry,
            lights: &lights,
            view: &|[width, height]| view(&scene, &pose, change, (min, max), width, height),
            bounds: BoundingSphere::around(min, max),
            points: scene.lights.len() - directions,
            directions,
        };
        work(&stage, report);
        report.save();
    }

    fn load(&self, setting: &Setting) -> Result<Scene, String> {
        match self.source {
            Source::Procedural(name) => Ok(procedural::build(name, None, 0)),
            Source::File(file, scene) => {
                let path = setting.scenes.join(file);
                if !path.exists() {
                    return Err(format!("{} is not there", path.display()));
                }
                Scene::load(&path, scene, None).map_err(|error| error.to_string())
            }
        }
    }

    fn change(&self, scene: &mut Scene) {
        match self.change {
            Change::None | Change::Sky => {}
            Change::DeltaLights => {
                scene.sky = Vec3::ZERO;
                for light in &mut scene.lights {
                    if let LightKind::Directional { angular_diameter } = &mut light.kind {
                        *angular_diameter = 0.0;
                    }
                }
                for material in &mut scene.materials {
                    material.emission = Vec3::ZERO;
                }
            }
            Change::ThreePoints => {
                for place in [[-12.0, -4.0, 0.0], [0.0, -4.0, 0.0], [12.0, 2.0, 0.0]] {
                    let node = scene.nodes.len() as u32;
                    scene.nodes.push(Node {
                        name: "lamp".to_owned(),
                        parent: None,
                        parent_from_node: Affine3A::from_translation(place.into()),
                    });
                    scene.lights.push(Light {
                        name: "lamp".to_owned(),
                        node,
                        intensity: Vec3::new(60.0, 50.0, 40.0),
                        kind: LightKind::Point,
                    });
                }
            }
        }
    }
}

/// The box around everything.
fn bounds(scene: &Scene, pose: &Pose) -> (Vec3, Vec3) {
    let mut bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for (index, instance) in pose.instances.iter().enumerate() {
        for &position in pose.positions(scene, index) {
            let point = instance.world_from_object.transform_point3(position);
            bounds = (bounds.0.min(point), bounds.1.max(point));
        }
    }
    bounds
}

fn view(
    scene: &Scene,
    pose: &Pose,
    change: Change,
    (min, max): (Vec3, Vec3),
    width: u32,
    height: u32,
) -> View {
    let own = match change {
        Change::ThreePoints => View::look_at(
            Vec3::new(-14.0, -11.5, 0.0),
            Vec3::new(5.0, -9.0, 0.0),
            65f32.to_radians(),
            width,
            height,
        ),
        _ => None,
    };
    match own {
        Some(view) => view,
        None if scene.cameras.is_empty() => View::framing(min, max, width, height),
        None => View::of_camera(scene, pose, 0, width, height),
    }
}

/// Blue above, brown below, brighter towards +X.
fn soft_sky() -> Environment {
    let (width, height) = (64, 32);
    let mut sky = Picture::new(width, height);
    for (i, pixel) in sky.pixels.iter_mut().enumerate() {
        let up = 1.0 - (i as u32 / width) as f32 / (height - 1) as f32;
        let along = (i as u32 % width) as f32 / width as f32 - 0.5;
        let glow = 4.0 * (-40.0 * (along * along + (up - 0.65) * (up - 0.65))).exp();
        *pixel = if up > 0.5 {
            [0.9 + glow, 1.2 + glow, 1.8 + 0.8 * glow]
        } else {
            [0.2, 0.16, 0.12]
        };
    }
    Environment::from_picture(&sky, 0.0, 1.0)
}
