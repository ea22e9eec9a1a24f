//! The tree against looking at every light, and against itself.

use super::*;
use crate::light::tests::{Random, irradiance, punctual, scene_of};
use crate::light::{LightSelection, Lights};
use glam::{Vec2, Vec3};
use occlude_scene::{LightKind, Pose, Scene};

/// Points, spots, small, large and double-sided triangles in clusters of very different power.
fn many_lights(count: usize, seed: u64) -> (Scene, Pose) {
    let mut random = Random(seed);
    let place = |random: &mut Random| {
        let cluster = (random.unit() * 5.0).floor();
        Vec3::new(cluster * 4.0, random.unit(), (cluster * 1.7).sin() * 3.0)
            + random.direction() * random.unit()
    };
    let mut meshes = Vec::new();
    for i in 0..3 {
        let triangles = (0..count / 5)
            .map(|_| {
                let center = place(&mut random);
                let size = 0.02 + random.unit().powi(8);
                std::array::from_fn(|_| center + random.direction() * size)
            })
            .collect();
        meshes.push((triangles, Vec3::splat(10.0_f32.powi(i - 1)), i == 1));
    }
    let (scene, mut pose) = scene_of(meshes);
    for i in 0..count - count / 5 * 3 {
        let kind = match i % 3 {
            0 => LightKind::Spot {
                inner_angle: 0.1,
                outer_angle: 0.4 + random.unit(),
            },
            _ => LightKind::Point,
        };
        let intensity = Vec3::splat(random.unit().powi(6) * 3.0 + 0.01);
        pose.lights.push(punctual(
            kind,
            intensity,
            place(&mut random),
            random.direction(),
        ));
    }
    (scene, pose)
}

fn tree_of(lights: &Lights) -> Tree {
    Tree::new(&lights.bounds())
}

/// Every light's own promise, in one flat list: the oracle of the tree.
struct Exhaustive {
    of_light: Vec<f32>,
}

impl Exhaustive {
    fn new(bounds: &[Bounds], position: Vec3, normal: Vec3) -> Self {
        let of_light = bounds
            .iter()
            .map(|light| {
                Tree::new(std::slice::from_ref(light))
                    .promise(position, normal)
                    .sum
            })
            .collect();
        Self { of_light }
    }

    fn pmf(&self, light: usize) -> f32 {
        self.of_light[light] / self.of_light.iter().sum::<f32>()
    }
}

#[test]
fn one_node_is_the_exhaustive_choice() {
    let (scene, pose) = many_lights(WIDTH, 3);
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let (bounds, tree) = (lights.bounds(), tree_of(&lights));
    let mut random = Random(1);
    for _ in 0..100 {
        let (position, normal) = (random.direction() * 10.0, random.direction());
        let exhaustive = Exhaustive::new(&bounds, position, normal);
        if tree.promise(position, normal).sum > 0.0 {
            for light in 0..bounds.len() {
                let (a, b) = (tree.pmf(position, normal, light), exhaustive.pmf(light));
                assert!((a - b).abs() <= 1e-6 * b, "{a} {b}");
            }
        }
    }
}

#[test]
fn picks_follow_the_pmf() {
    for count in [1, 2, 9, 70, 700] {
        let (scene, pose) = many_lights(count, count as u64);
        let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
        let tree = tree_of(&lights);
        let mut random = Random(11);
        for round in 0..8 {
            let position = Vec3::new(
                random.unit() * 16.0,
                random.unit() * 3.0 - 1.0,
                random.unit() * 4.0 - 2.0,
            );
            let normal = if round % 2 == 0 {
                random.direction()
            } else {
                Vec3::ZERO
            };
            let root = tree.promise(position, normal);
            let n = 100_000;
            let mut counts = vec![0.0_f64; lights.len() + 1];
            for i in 0..n {
                let x = (f64::from(i) + f64::from(random.unit())) / f64::from(n);
                match tree.pick(position, normal, &root, x) {
                    Some((light, pmf)) => {
                        let again = tree.pmf(position, normal, light);
                        assert!((again / pmf - 1.0).abs() < 1e-5, "{again} {pmf}");
                        counts[light] += 1.0;
                    }
                    None => counts[lights.len()] += 1.0,
                }
            }
            let pmfs: Vec<f64> = (0..lights.len())
                .map(|l| f64::from(tree.pmf(position, normal, l)))
                .collect();
            let sum: f64 = pmfs.iter().sum();
            let nothing = counts[lights.len()] / f64::from(n);
            // Stratified: each boundary between lights moves a count by 1 at most.
            assert!(
                (sum + nothing - 1.0).abs() < 2.0 * lights.len() as f64 / f64::from(n) + 1e-5,
                "{sum} {nothing}"
            );
            for (light, pmf) in pmfs.iter().enumerate() {
                let expected = pmf * f64::from(n);
                assert!(
                    (counts[light] - expected).abs() < 2.5 + 1e-3 * expected,
                    "{} {expected}",
                    counts[light]
                );
            }
            // The sum of 1/p over picks counts lights: those that are picked often enough to tell.
            let likely: Vec<usize> = (0..lights.len())
                .filter(|&l| pmfs[l] * f64::from(n) > 10.0)
                .collect();
            let counted: f64 = likely
                .iter()
                .map(|&l| counts[l] / (pmfs[l] * f64::from(n)))
                .sum();
            assert!(
                (counted - likely.len() as f64).abs() <= 0.1 * likely.len() as f64,
                "{counted} {}",
                likely.len()
            );
        }
    }
}

#[test]
fn no_light_that_gives_something_is_left_out() {
    let (scene, pose) = many_lights(400, 21);
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let tree = tree_of(&lights);
    let mut random = Random(2);
    let mut given = 0;
    for _ in 0..300 {
        let position = Vec3::new(
            random.unit() * 16.0,
            random.unit() * 2.0,
            random.unit() * 4.0 - 2.0,
        );
        let normal = random.direction();
        for light in 0..lights.points.len() {
            let point = &lights.points[light];
            let to = (point.position - position).normalize();
            if normal.dot(to) > 0.0 && point.intensity_along(-to) != Vec3::ZERO {
                given += 1;
                assert!(tree.pmf(position, normal, light) > 0.0, "point {light}");
            }
        }
        for (index, emissive) in lights.emitters.triangles.iter().enumerate() {
            for _ in 0..3 {
                let sample = emissive.sample(position, Vec3::ZERO, random.pair());
                if sample.is_some_and(|s| normal.dot(s.wi) > 0.0) {
                    given += 1;
                    assert!(
                        tree.pmf(position, normal, lights.points.len() + index) > 0.0,
                        "triangle {index}"
                    );
                }
            }
        }
    }
    assert!(given > 50_000, "{given}");
}

#[test]
fn all_selections_agree_and_the_tree_is_least_noisy() {
    let (scene, pose) = many_lights(600, 5);
    let of = |selection| Lights::new(&scene, &pose, None, selection);
    let (uniform, power, tree) = (
        of(LightSelection::Uniform),
        of(LightSelection::Power),
        of(LightSelection::Tree),
    );
    let mut ratios = 1.0_f64;
    for i in 0..6 {
        let position = Vec3::new(i as f32 * 3.0, -0.5, 0.3 * i as f32 - 1.0);
        let found = [&uniform, &power, &tree]
            .map(|lights| irradiance(lights, &scene, position, Vec3::Y, 40 + i));
        for other in &found[..2] {
            let sigma = (other.1.powi(2) + found[2].1.powi(2)).sqrt();
            assert!((other.0 - found[2].0).abs() < 4.5 * sigma, "{found:?}");
        }
        ratios *= found[2].1 / found[1].1;
    }
    // Geometric mean of the ratios of standard errors; 0.5 means a quarter of the samples for equal noise.
    let ratio = ratios.powf(1.0 / 6.0);
    assert!(ratio < 0.5, "{ratio}");
}

/// How much worse than looking at every light: variance of the estimate of the sum of promises, which the exhaustive choice
/// makes without any.
#[test]
fn the_tree_is_close_to_the_exhaustive_choice() {
    let (scene, pose) = many_lights(600, 8);
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let (bounds, tree) = (lights.bounds(), tree_of(&lights));
    let mut random = Random(6);
    let mut total = 0.0;
    let rounds = 60;
    for _ in 0..rounds {
        let position = Vec3::new(random.unit() * 16.0, -0.5, random.unit() * 4.0 - 2.0);
        let exhaustive = Exhaustive::new(&bounds, position, Vec3::Y);
        let sum: f64 = exhaustive.of_light.iter().map(|&p| f64::from(p)).sum();
        let squares: f64 = (0..bounds.len())
            .filter(|&light| exhaustive.of_light[light] > 0.0)
            .map(|light| {
                f64::from(exhaustive.of_light[light]).powi(2)
                    / f64::from(tree.pmf(position, Vec3::Y, light))
            })
            .sum();
        total += squares / (sum * sum) - 1.0;
    }
    let relative_variance = total / f64::from(rounds);
    assert!(relative_variance < 1.0, "{relative_variance}");
}

#[test]
fn threads_do_not_matter() {
    let (scene, pose) = many_lights(20_000, 4);
    let lights = Lights::new(&scene, &pose, None, LightSelection::Uniform);
    let bounds = lights.bounds();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let tree = pool.install(|| Tree::new(&bounds));
        bytemuck::cast_slice::<Node, u8>(&tree.nodes).to_vec()
    };
    assert!(with(1) == with(3));
    let tree = Tree::new(&bounds);
    let per_light = tree.bytes() as f64 / bounds.len() as f64;
    assert!(per_light < 112.0, "{per_light} bytes a light");
}

#[test]
fn coincident_and_extreme_lights_are_safe() {
    let mut pose = Pose::default();
    let scene = Scene::default();
    for i in 0..5000 {
        pose.lights
            .push(punctual(LightKind::Point, Vec3::ONE, Vec3::ONE, Vec3::Z));
        if i % 50 == 0 {
            let far = Vec3::splat(if i % 100 == 0 { 1e30 } else { -1e30 });
            pose.lights
                .push(punctual(LightKind::Point, Vec3::splat(1e30), far, Vec3::Z));
            pose.lights.push(punctual(
                LightKind::Point,
                Vec3::splat(1e-30),
                Vec3::splat(1e-30),
                Vec3::Z,
            ));
        }
    }
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let mut random = Random(1);
    let mut found = 0;
    for position in [
        Vec3::ZERO,
        Vec3::ONE,
        Vec3::splat(1e30),
        Vec3::splat(1e20),
        Vec3::splat(f32::NAN),
    ] {
        for _ in 0..1000 {
            let pick = random.unit();
            if let Some(s) = lights.sample(&scene, position, Vec3::ZERO, pick, random.pair()) {
                assert!(s.pdf > 0.0 && s.pdf <= 1.0 && s.radiance.is_finite());
                found += 1;
            }
        }
    }
    assert!(found >= 1000, "{found}");
    // Five thousand lights in one place, alike: all of them are picked.
    pose.lights.truncate(1);
    pose.lights = vec![pose.lights[0]; 5000];
    let lights = Lights::new(&scene, &pose, None, LightSelection::Tree);
    let s = lights
        .sample(&scene, Vec3::ZERO, Vec3::ZERO, 0.3, Vec2::ZERO)
        .unwrap();
    assert!(s.pdf > 1e-5 && s.pdf < 1e-2);
}
