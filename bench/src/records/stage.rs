//! Scenes, and what every topic needs of them.

use super::Plan;
use crate::quantized::shot::Stage;
use crate::quantized::subject::{Change, Source, Subject, subject};
use glam::{Vec2, Vec3};
use occlude_render::geometry::Geometry;
use occlude_scene::procedural::Name;
use occlude_visibility::records::{Cache, DistanceTracer, PathSite, RecordSettings, Scout, Site};
use occlude_visibility::{Ray, Tracer};

/// A scene, the topics that use it, and bars on secondary rays (times exact ones) and on instant radiosity.
pub struct Measured {
    pub subject: Subject,
    pub topics: &'static [&'static str],
    pub rays_bar: Option<f64>,
    pub instant_bar: Option<f64>,
    pub fill_bar: Option<f64>,
    pub quick: bool,
}

const fn measured(name: &'static str, source: Source) -> Measured {
    Measured {
        subject: subject(name, source, [None, None], &[]),
        topics: &[],
        rays_bar: None,
        instant_bar: None,
        fill_bar: None,
        quick: false,
    }
}

/// All scenes.
pub const SUBJECTS: &[Measured] = &[
    Measured {
        topics: &["fill", "rays", "instant", "refinement", "modes", "views"],
        rays_bar: Some(3.0),
        quick: true,
        ..measured("apartment", Source::Procedural(Name::Apartment))
    },
    Measured {
        topics: &["fill", "rays", "instant", "refinement", "modes", "views"],
        rays_bar: Some(3.0),
        fill_bar: Some(2.0),
        ..measured("sponza", Source::File("sponza.glb", None))
    },
    Measured {
        topics: &["rays", "views"],
        rays_bar: Some(3.0),
        ..measured("bedroom", Source::File("bedroom.glb", None))
    },
    Measured {
        topics: &["fill", "rays"],
        rays_bar: Some(5.0),
        fill_bar: Some(4.0),
        ..measured("pine_forest", Source::File("pine_forest.glb", None))
    },
    Measured {
        topics: &["fill", "rays", "instant", "modes"],
        rays_bar: Some(5.0),
        instant_bar: Some(4.0),
        fill_bar: Some(4.0),
        ..measured("sintel_hair", Source::File("sintel_hair.glb", None))
    },
    Measured {
        topics: &["fill"],
        fill_bar: Some(4.0),
        ..measured("victorian_house", Source::File("victorian_house.glb", None))
    },
    Measured {
        topics: &["instant"],
        instant_bar: Some(4.0),
        ..measured("courtyard", Source::Procedural(Name::Courtyard))
    },
    Measured {
        subject: Subject {
            change: Change::ThreePoints,
            ..subject(
                "sibenik",
                Source::File("sibenik/sibenik.obj", None),
                [None, None],
                &[],
            )
        },
        topics: &["instant"],
        instant_bar: Some(4.0),
        ..measured("", Source::Procedural(Name::Cornell))
    },
];

/// Random numbers: SplitMix64.
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Around a normal, by the cosine.
    pub fn cosine(&mut self, normal: Vec3) -> Vec3 {
        let (z, turn) = (2.0 * self.unit() - 1.0, std::f32::consts::TAU * self.unit());
        let r = (1.0 - z * z).sqrt();
        (normal * 1.0001 + Vec3::new(r * turn.cos(), r * turn.sin(), z)).normalize()
    }
}

/// Vertices of diffuse paths from the camera.
pub struct Walks<'s, 'a> {
    pub stage: &'s Stage<'a>,
    pub size: [u32; 2],
    pub random: Random,
    pub vertices: u32,
    /// How far the camera has moved; it stays where something stands in its way.
    pub shift: Vec3,
}

impl Scout for Walks<'_, '_> {
    fn draw(&mut self, count: usize, sites: &mut Vec<PathSite>) {
        let view = (self.stage.view)(self.size);
        let paths = count.div_ceil(self.vertices as usize);
        let mut rays: Vec<Ray> = (0..paths)
            .map(|_| {
                let at = Vec2::new(self.random.unit(), self.random.unit());
                view.ray(at * Vec2::new(self.size[0] as f32, self.size[1] as f32))
                    .ray
            })
            .collect();
        if self.shift != Vec3::ZERO {
            for ray in &mut rays {
                let there = ray.origin + self.shift;
                if !self
                    .stage
                    .geometry
                    .occluded(&Ray::between(ray.origin, there))
                {
                    ray.origin = there;
                }
            }
        }
        for depth in 1..=self.vertices {
            let mut met = vec![None; rays.len()];
            self.stage.geometry.sites(&rays, &mut met);
            rays.clear();
            for site in met.into_iter().flatten() {
                sites.push(PathSite {
                    site,
                    weight: 1.0 / depth as f32,
                });
                rays.push(Ray::new(site.origin, self.random.cosine(site.normal)));
            }
        }
    }
}

/// Places as far from each other as may be: farthest-point sampling (Eldar et al. 1997) of the vertices of many paths. Sides of a thin wall do not
/// know of each other, as for records.
pub struct BlueNoise(Vec<PathSite>);

impl BlueNoise {
    pub fn new(scout: &mut dyn Scout, count: usize) -> Self {
        let mut pool = Vec::new();
        scout.draw(16 * count, &mut pool);
        let mut free = vec![f32::INFINITY; pool.len()];
        let mut chosen = Vec::new();
        let mut next = (!pool.is_empty()).then_some(0);
        while let Some(k) = next.filter(|_| chosen.len() < count) {
            let place = pool[k];
            chosen.push(place);
            let mut best = 0.0;
            next = None;
            for (other, (site, free)) in pool.iter().zip(&mut free).enumerate() {
                if site.site.normal.dot(place.site.normal) > 0.5 {
                    *free = free.min(site.site.position.distance(place.site.position));
                }
                if *free > best {
                    (next, best) = (Some(other), *free);
                }
            }
        }
        Self(chosen)
    }
}

impl Scout for BlueNoise {
    fn draw(&mut self, _: usize, sites: &mut Vec<PathSite>) {
        sites.extend(&self.0);
    }
}

/// Bounce rays: places and directions behind one and two scattering events.
pub fn bounces(stage: &Stage, plan: &Plan, count: usize) -> Vec<(Site, Vec3)> {
    let mut sites = Vec::new();
    Walks {
        stage,
        size: plan.size,
        random: Random(5),
        vertices: 2,
        shift: Vec3::ZERO,
    }
    .draw(count, &mut sites);
    let mut random = Random(6);
    sites.truncate(count);
    (sites.iter())
        .map(|place| (place.site, random.cosine(place.site.normal)))
        .collect()
}

/// Settings for a stage.
pub fn settings(stage: &Stage, plan: &Plan, surfaces: bool) -> RecordSettings {
    let (centre, radius) = (stage.bounds.centre, Vec3::splat(stage.bounds.radius));
    RecordSettings {
        capacity: plan.count,
        surfaces,
        scene: [centre - radius, centre + radius],
        threads: rayon::current_num_threads(),
        seed: plan.seed,
        ..RecordSettings::default()
    }
}

/// A cache with its initial distribution.
pub fn placed(stage: &Stage, plan: &Plan, settings: RecordSettings) -> Cache {
    let mut cache = Cache::new(settings).expect("legal settings");
    let mut walks = walks(stage, plan);
    cache.place_initial(geometry(stage), &mut walks);
    cache
}

pub fn walks<'s, 'a>(stage: &'s Stage<'a>, plan: &Plan) -> Walks<'s, 'a> {
    Walks {
        stage,
        size: plan.size,
        random: Random(plan.seed),
        vertices: 4,
        shift: Vec3::ZERO,
    }
}

pub fn geometry<'s>(stage: &'s Stage) -> &'s Geometry<'s> {
    stage.geometry
}
