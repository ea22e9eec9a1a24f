//! Weights against their definition: the density of a whole path under each strategy, one by one.

use super::vertex::Facing;
use super::*;
use crate::light::{LightSelection, Lights, Origin};
use crate::sampling::{Sampler, SamplerKind};
use occlude_bvh::BuildOptions;
use occlude_scene::{Light, LightKind, Material, Pose, Scene, Volume, procedural};
use occlude_visibility::LightEnd;

/// The Cornell box with a mirror, a glass and a varnished wall, frosted glass, rough metal, a spot, a sun and a sky.
fn scene() -> Scene {
    let mut scene = procedural::build(procedural::Name::Cornell, None, 0);
    let glass = |roughness| Material {
        metallic: 0.0,
        roughness,
        transmission: 1.0,
        volume: Some(Volume {
            thickness: 1.0,
            attenuation_distance: f32::INFINITY,
            attenuation_color: glam::Vec3::ONE,
        }),
        ..Material::default()
    };
    let coat = Material {
        metallic: 0.0,
        clearcoat: 1.0,
        ..Material::default()
    };
    let metal = |roughness| Material {
        roughness,
        ..Material::default()
    };
    let shiny = [metal(0.4), coat, glass(0.5), glass(0.0), metal(0.0)];
    // One mesh keeps its Lambert surface between two that do not.
    let meshes = scene.meshes.len();
    let mut shiny = shiny.into_iter();
    for mesh in (0..meshes).step_by(2) {
        let lit = scene.materials[scene.meshes[mesh].material as usize].emission != Vec3::ZERO;
        if let (false, Some(material)) = (lit, shiny.next()) {
            scene.meshes[mesh].material = scene.materials.len() as u32;
            scene.materials.push(material);
        }
    }
    let node = scene.cameras[0].node;
    for kind in [
        LightKind::Spot {
            inner_angle: 0.3,
            outer_angle: 0.9,
        },
        LightKind::Directional {
            angular_diameter: 0.0,
        },
        LightKind::Directional {
            angular_diameter: 0.2,
        },
    ] {
        scene.lights.push(Light {
            name: String::new(),
            node,
            intensity: Vec3::ONE,
            kind,
        });
    }
    scene.sky = Vec3::splat(0.2);
    scene
}

/// A scattering event of a path.
#[derive(Clone, Copy)]
struct Event<'a> {
    vertex: Vertex<'a>,
    exact: bool,
}

/// A path: events from the camera on, and where its light starts.
struct Whole<'a> {
    events: Vec<Event<'a>>,
    origin: Origin,
}

impl<'a> Whole<'a> {
    fn position(&self, i: usize) -> Vec3 {
        self.events[i].vertex.facing.surface.position
    }

    /// Unit vector and squared distance (1 if infinite) from event `i` towards the light.
    fn onwards(&self, i: usize) -> (Vec3, f32) {
        let to = match self.events.get(i + 1) {
            Some(next) => next.vertex.facing.surface.position - self.position(i),
            None => match self.origin {
                Origin::Surface { position, .. } => position - self.position(i),
                Origin::Sky(towards) => return (towards, 1.0),
                Origin::Point(_) | Origin::Direction(_) => unreachable!("set by the caller"),
            },
        };
        (to.normalize(), to.length_squared())
    }

    /// The densities of all strategies, by number of vertices from the light. 0 where a strategy cannot make the path.
    fn densities(&self, stage: &Stage, towards_end: (Vec3, f32)) -> Vec<f64> {
        let n = self.events.len();
        let lights = stage.world.lights;
        let onwards = |i: usize| {
            if i + 1 == n {
                towards_end
            } else {
                self.onwards(i)
            }
        };
        let seen: Vec<_> = self
            .events
            .iter()
            .map(|e| {
                stage
                    .view
                    .project(e.vertex.facing.surface.position)
                    .unwrap()
            })
            .collect();
        let back = |i: usize| {
            if i == 0 {
                seen[0].toward_camera
            } else {
                -onwards(i - 1).0
            }
        };
        // Each event as the camera's side and as the light's side see it.
        let turned = |i: usize, viewer| self.events[i].vertex.turned(viewer);
        let near: Vec<Facing> = (0..n).map(|i| turned(i, back(i))).collect();
        let far: Vec<Facing> = (0..n).map(|i| turned(i, onwards(i).0)).collect();
        let cosine = |i: usize, direction: Vec3| direction.dot(near[i].surface.normal).abs();
        // Density per steradian of going on from event i, to the light and to the camera.
        let to_light = |i: usize| match self.events[i].exact {
            true => 1.0,
            false => near[i].eval(onwards(i).0).1,
        };
        let to_camera = |i: usize| {
            if !self.events[i].exact {
                return far[i].eval(back(i)).1;
            }
            let crossed = onwards(i).0.dot(near[i].surface.normal) < 0.0;
            let side = if crossed { -1.0 } else { 1.0 };
            if far[i].surface.shading_normal() != near[i].surface.shading_normal() * side {
                return 0.0;
            }
            let material = near[i].surface.material();
            let eta = match (crossed, near[i].surface.front) {
                (false, _) => 1.0,
                (true, true) => material.ior,
                (true, false) => 1.0 / material.ior,
            };
            cosine(i, back(i)) / (cosine(i, onwards(i).0) * eta * eta)
        };
        // Per square metre, from either side.
        let first = f64::from(seen[0].density * cosine(0, back(0)) / stage.samples);
        let further = (0..n).map(|i| {
            let (direction, across) = onwards(i);
            let arriving = match self.events.get(i + 1) {
                Some(_) => cosine(i + 1, direction),
                None => end_cosine(lights, self.origin, direction),
            };
            f64::from(to_light(i) * arriving / across)
        });
        let from_camera: Vec<f64> = std::iter::once(first).chain(further).collect();
        let emitted = stage
            .emission
            .density(lights, self.origin, -onwards(n - 1).0);
        let from_light = (0..n).map(|i| {
            let (direction, across) = onwards(i);
            let density = if i + 1 == n {
                emitted.spread
            } else {
                to_camera(i + 1)
            };
            f64::from(density * cosine(i, direction) / across)
        });
        let from_light: Vec<f64> = from_light.collect();
        let rough = |i: usize| !self.events[i].exact;
        let normal = near[n - 1].light_normal(&self.events[n - 1].vertex.parameters);
        let sampled = lights.connection_density(self.position(n - 1), normal, self.origin);
        (0..=n + 1)
            .map(|s| {
                let camera: f64 = from_camera[..n.min(n + 1 - s)].iter().product();
                let light: f64 = from_light[n + 1 - s.max(1)..].iter().product();
                match s {
                    0 if self.origin.is_delta() => 0.0,
                    0 => camera * from_camera[n],
                    1 if !rough(n - 1) => 0.0,
                    1 => camera * f64::from(sampled),
                    // The edge between events n - s and n + 1 - s is the connection; event -1 is the camera.
                    s if !rough(n + 1 - s) || (s <= n && !rough(n - s)) => 0.0,
                    _ => camera * light * f64::from(emitted.start),
                }
            })
            .collect()
    }
}

/// Cosine of the light's surface, if it has one.
fn end_cosine(lights: &Lights, origin: Origin, direction: Vec3) -> f32 {
    match origin {
        Origin::Surface { light, .. } => lights.front_of(light).dot(direction).abs(),
        _ => 1.0,
    }
}

/// One subpath with all its vertices; emitters that it hits and the sky are given to `hit`.
fn subpath<'a>(
    stage: &Stage<'_, 'a>,
    mut walk: Walk,
    first_set: u32,
    mut hit: impl FnMut(&Walk, Option<&crate::geometry::Surface<'a>>, &[Event<'a>]),
) -> Vec<Event<'a>> {
    let (geometry, lights) = (stage.world.geometry, stage.world.lights);
    let mut events: Vec<Event> = Vec::new();
    loop {
        let mut found = [None];
        geometry.closest_batch(&[walk.ray], &mut found);
        let Some(at) = found[0] else {
            hit(&walk, None, &events);
            return events;
        };
        let Some(surface) = walk.arrive(geometry, at) else {
            return events;
        };
        hit(&walk, Some(&surface), &events);
        let Some(vertex) = walk.vertex(geometry, lights, surface) else {
            return events;
        };
        walk.sampler.jump(first_set + walk.depth);
        let numbers = walk.sampler.next();
        events.push(Event {
            vertex,
            exact: false,
        });
        if !walk.depart(lights, &vertex, 5, numbers) {
            return events;
        }
        let last = events.len() - 1;
        events[last].exact = walk.last.is_none();
    }
}

/// What the comparison has seen.
#[derive(Default)]
struct Seen {
    worst: f64,
    compared: [[u32; 8]; 8],
    with_exact_event: u32,
}

impl Seen {
    fn compare(
        &mut self,
        stage: &Stage,
        whole: &Whole,
        end: (Vec3, f32),
        light_vertices: usize,
        weight: f32,
    ) {
        // Rays start a few millionths of the scene off their surface, which the definition does not: of edges as short as that
        // would have to be to matter, it is the less exact.
        const SHORTEST: f32 = 0.03;
        let edges = (0..whole.events.len() - 1).map(|i| whole.onwards(i).1);
        let shortest = edges.fold(end.1, f32::min);
        if shortest < SHORTEST * SHORTEST {
            return;
        }
        let densities = whole.densities(stage, end);
        let scale = densities[light_vertices];
        let sum: f64 = densities.iter().map(|p| (p / scale).powi(2)).sum();
        assert!(
            scale > 0.0 && sum.is_finite(),
            "{densities:?} {light_vertices}"
        );
        let difference = (f64::from(weight) - 1.0 / sum).abs();
        assert!(
            difference < 2e-3,
            "s {light_vertices}: {weight}, by definition {}, densities {densities:?}",
            1.0 / sum
        );
        self.worst = self.worst.max(difference);
        self.compared[light_vertices][whole.events.len() + 2 - light_vertices] += 1;
        self.with_exact_event += u32::from(whole.events.iter().any(|event| event.exact));
    }
}

/// The weight in a connection: what all strategies together make of it over what it is alone.
fn ratio(weighted: Option<Connection>, alone: Option<Connection>) -> Option<f32> {
    let alone = alone?.contribution;
    Some(weighted.map_or(0.0, |c| c.contribution.max_element()) / alone.max_element())
}

#[test]
fn recursive_weights_are_those_of_the_definition() {
    let scene = scene();
    let pose = Pose::at(&scene, 0.0);
    let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let view = View::of_camera(&scene, &pose, 0, 16, 16);
    let emission = Emission::new(&lights, &scene, &pose);
    let stage = |techniques| Stage {
        world: &world,
        view: &view,
        filter: PixelFilter::Box,
        emission: &emission,
        samples: 256.0,
        max_depth: 5,
        techniques,
    };
    let all = stage(Techniques::All);
    let only = |light: u32, camera: u32| stage(Techniques::Only { light, camera });
    let mut seen = Seen::default();
    for number in 0..3000u32 {
        let mut sampler = Sampler::new(SamplerKind::Independent, 1, [0, 0], number);
        let [x, y, ..] = sampler.next();
        let camera = view.ray(Vec2::new(x, y) * 16.0);
        let walk = Walk::from_camera(&camera, sampler, all.samples);
        let mut hits = Vec::new();
        let eyes = subpath(&all, walk, 1, |walk, surface, events| {
            if events.is_empty() {
                return;
            }
            let (origin, weight, across) = match surface {
                None => (Origin::Sky(walk.ray.direction), all.hit_sky(walk), 1.0),
                Some(surface) => {
                    let hit = surface.hit;
                    let origin = lights.origin_on(hit.instance, hit.primitive, surface.position);
                    match origin {
                        Some(origin) if surface.front => {
                            (origin, all.hit_surface(walk, surface), hit.t * hit.t)
                        }
                        _ => return,
                    }
                }
            };
            let whole = Whole {
                events: events.to_vec(),
                origin,
            };
            hits.push((whole, (walk.ray.direction, across), weight));
        });
        for (whole, end, weight) in hits {
            seen.compare(&all, &whole, end, 0, weight);
        }

        let mut own = Sampler::new(SamplerKind::Independent, 2, [0, 0], number);
        let [a, b, pick, c] = own.next();
        let [d, u, v, light_pick] = own.next();
        for (i, eye) in eyes.iter().enumerate() {
            let vertex = &eye.vertex;
            let (u, t) = (Vec2::new(u, v), i as u32 + 2);
            let connection = all.next_event(vertex, light_pick, u);
            let weight = ratio(connection, only(1, t).next_event(vertex, light_pick, u));
            let Some(weight) = weight.filter(|_| !vertex.facing.bsdf.is_delta()) else {
                continue;
            };
            let (position, normal) = (
                vertex.facing.surface.position,
                vertex.facing.light_normal(&vertex.parameters),
            );
            let sample = lights
                .sample(&scene, position, normal, light_pick, u)
                .unwrap();
            let across = match sample.end {
                LightEnd::Point(end) => (end - position).length_squared(),
                LightEnd::Surface(end) => (end.position - position).length_squared(),
                _ => 1.0,
            };
            let mut whole = Whole {
                events: eyes[..=i].to_vec(),
                origin: Origin::of_sample(&sample),
            };
            whole.events[i].exact = false;
            seen.compare(&all, &whole, (sample.wi, across), 1, weight);
        }

        let emitted = emission.sample(&lights, &scene, pick, Vec2::new(a, b), Vec2::new(c, d));
        let Some(emitted) = emitted else { continue };
        let mut start = None;
        let walk = Walk::from_light(&emitted, own);
        let ends = subpath(&all, walk, 100, |walk, surface, events| {
            if let (true, Some(surface)) = (events.is_empty(), surface) {
                let across = if emitted.density.parallel {
                    1.0
                } else {
                    walk.distance(&surface.hit).powi(2)
                };
                start = Some((-walk.ray.direction, across));
            }
        });
        for (j, light) in ends.iter().enumerate() {
            let s = j + 2;
            let mut compare = |eye_events: &[Event], weight: Option<f32>| {
                let Some(weight) = weight else { return };
                let mut events = eye_events.to_vec();
                if let Some(last) = events.last_mut() {
                    last.exact = false;
                }
                events.push(Event {
                    exact: false,
                    ..*light
                });
                events.extend(ends[..j].iter().rev());
                let whole = Whole {
                    events,
                    origin: emitted.origin,
                };
                seen.compare(&all, &whole, start.unwrap(), s, weight);
            };
            if light.vertex.facing.bsdf.is_delta() {
                continue;
            }
            let seen_by = |stage: &Stage| stage.show(&light.vertex).map(|(_, c)| c);
            compare(&[], ratio(seen_by(&all), seen_by(&only(s as u32, 1))));
            for (i, eye) in eyes.iter().enumerate().take(3) {
                if !eye.vertex.facing.bsdf.is_delta() && i + s < 6 {
                    let one = only(s as u32, i as u32 + 2);
                    let weight = ratio(
                        all.join(&eye.vertex, &light.vertex),
                        one.join(&eye.vertex, &light.vertex),
                    );
                    compare(&eyes[..=i], weight);
                }
            }
        }
    }
    eprintln!(
        "worst {:.1e}, {:?}, exact {}",
        seen.worst, seen.compared, seen.with_exact_event
    );
    for (s, t) in [
        (0, 3),
        (0, 5),
        (1, 2),
        (1, 4),
        (2, 1),
        (3, 1),
        (2, 2),
        (3, 2),
        (2, 3),
        (4, 2),
    ] {
        assert!(
            seen.compared[s][t] > 100,
            "s {s}, t {t}: {:?}",
            seen.compared
        );
    }
    assert!(seen.with_exact_event > 500);
}
