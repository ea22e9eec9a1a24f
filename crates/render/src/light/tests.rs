//! All kinds of lights together, through the public interface.

use super::*;
use glam::{Affine3A, DVec3, Mat3};
use occlude_image::Picture;
use occlude_scene::{
    AlphaMode, Image, Instance, Material, Mesh, Node, PosedInstance, Texels, Texture, TextureRef,
};
pub(super) use occlude_testkit::random::Random;
use std::f32::consts::PI;

/// A scene of emissive meshes, one instance each: triangles, emission, double-sided.
pub(super) fn scene_of(meshes: Vec<(Vec<[Vec3; 3]>, Vec3, bool)>) -> (Scene, Pose) {
    let mut scene = Scene::default();
    let mut pose = Pose::default();
    scene.nodes.push(Node {
        name: String::new(),
        parent: None,
        parent_from_node: Affine3A::IDENTITY,
    });
    pose.world_from_node.push(Affine3A::IDENTITY);
    for (triangles, emission, double_sided) in meshes {
        let index = scene.meshes.len() as u32;
        scene.materials.push(Material {
            emission,
            double_sided,
            ..Material::default()
        });
        scene.meshes.push(Mesh {
            positions: triangles.iter().flatten().copied().collect(),
            triangles: (0..triangles.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
            material: index,
            ..Mesh::default()
        });
        scene.instances.push(Instance {
            mesh: index,
            node: 0,
            node_from_object: Affine3A::IDENTITY,
            skin: None,
        });
        pose.instances.push(PosedInstance {
            mesh: index,
            node: 0,
            world_from_object: Affine3A::IDENTITY,
            deformed: None,
        });
    }
    (scene, pose)
}

/// A square of two triangles around `center`, facing `normal`.
pub(super) fn square(center: Vec3, normal: Vec3, half: f32) -> Vec<[Vec3; 3]> {
    let (s, t) = normal.any_orthonormal_pair();
    let (s, t) = if s.cross(t).dot(normal) > 0.0 {
        (s * half, t * half)
    } else {
        (t * half, s * half)
    };
    let [a, b, c, d] = [
        center - s - t,
        center + s - t,
        center + s + t,
        center - s + t,
    ];
    vec![[a, b, c], [a, c, d]]
}

pub(super) fn punctual(
    kind: LightKind,
    intensity: Vec3,
    position: Vec3,
    direction: Vec3,
) -> PosedLight {
    PosedLight {
        position,
        direction,
        intensity,
        kind,
    }
}

const SELECTIONS: [LightSelection; 3] = [
    LightSelection::Uniform,
    LightSelection::Power,
    LightSelection::Tree,
];

/// Mean and standard error of the irradiance at a point by sampling lights, nothing in the way.
pub(super) fn irradiance(
    lights: &Lights,
    scene: &Scene,
    position: Vec3,
    normal: Vec3,
    seed: u64,
) -> (f64, f64) {
    let mut random = Random(seed);
    let n = 100_000;
    let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
    for _ in 0..n {
        let pick = random.unit();
        if let Some(s) = lights.sample(scene, position, normal, pick, random.pair()) {
            let value = f64::from(s.radiance.x * normal.dot(s.wi).max(0.0) / s.pdf);
            sum += value;
            squares += value * value;
        }
    }
    let mean = sum / f64::from(n);
    let variance = (squares / f64::from(n) - mean * mean).max(0.0) / f64::from(n);
    (mean, variance.sqrt())
}

/// Within four standard errors, or the rounding of single precision where there is no noise.
fn assert_near((mean, sigma): (f64, f64), expected: f64, what: &str) {
    let tolerance = 4.0 * sigma + 2e-5 * expected.abs();
    assert!(
        (mean - expected).abs() <= tolerance,
        "{what}: {mean} +- {sigma}, expected {expected}"
    );
}

/// Irradiance of a polygon of radiance 1 (Lambert 1760): half the sum over edges of the angle times the cosine of the edge's
/// plane with the normal. Holds where all of it is above the horizon.
fn polygon_irradiance(position: Vec3, normal: Vec3, corners: &[Vec3]) -> f64 {
    let unit: Vec<DVec3> = corners
        .iter()
        .map(|c| (c.as_dvec3() - position.as_dvec3()).normalize())
        .collect();
    let sum: f64 = (0..unit.len())
        .map(|i| {
            let (a, b) = (unit[i], unit[(i + 1) % unit.len()]);
            a.angle_between(b) * a.cross(b).normalize().dot(normal.as_dvec3())
        })
        .sum();
    (0.5 * sum).abs()
}

#[test]
fn irradiance_of_an_emissive_square_is_lamberts() {
    // From far, near, very near, beside, and at other scales; the light looks down.
    for scale in [1e-5_f32, 1.0, 1e5] {
        for (position, half) in [
            (Vec3::new(0.0, -10.0, 0.0), 0.5),
            (Vec3::new(0.3, -1.0, 0.2), 0.5),
            (Vec3::new(0.3, -0.05, 0.2), 0.5),
            (Vec3::new(3.0, -0.3, 0.0), 0.5),
            (Vec3::new(0.2, -0.1, 0.1), 20.0),
        ] {
            let triangles = square(Vec3::ZERO, Vec3::NEG_Y, half * scale);
            let (scene, pose) = scene_of(vec![(triangles.clone(), Vec3::ONE, false)]);
            for selection in SELECTIONS {
                let lights = Lights::new(&scene, &pose, None, selection);
                assert_eq!(lights.len(), 2);
                let found = irradiance(&lights, &scene, position * scale, Vec3::Y, 1);
                let expected: f64 = triangles
                    .iter()
                    .map(|t| polygon_irradiance(position * scale, Vec3::Y, t))
                    .sum();
                assert_near(
                    found,
                    expected,
                    &format!("{position} {half} {scale} {selection:?}"),
                );
                // Behind the light there is nothing.
                assert_eq!(
                    irradiance(&lights, &scene, -position * scale, Vec3::NEG_Y, 2).0,
                    0.0
                );
            }
        }
    }
    let (scene, pose) = scene_of(vec![(
        square(Vec3::ZERO, Vec3::NEG_Y, 0.5),
        Vec3::ONE,
        true,
    )]);
    let lights = Lights::new(&scene, &pose, None, LightSelection::Power);
    let expected: f64 = square(Vec3::ZERO, Vec3::NEG_Y, 0.5)
        .iter()
        .map(|t| polygon_irradiance(Vec3::Y, Vec3::NEG_Y, t))
        .sum();
    assert_near(
        irradiance(&lights, &scene, Vec3::Y, Vec3::NEG_Y, 3),
        expected,
        "back of a double-sided light",
    );
}

#[test]
fn mirrored_instances_emit_from_their_front() {
    let (scene, mut pose) = scene_of(vec![(
        square(Vec3::ZERO, Vec3::NEG_Y, 0.5),
        Vec3::ONE,
        false,
    )]);
    pose.instances[0].world_from_object = Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let lights = Lights::new(&scene, &pose, None, LightSelection::Power);
    assert!(irradiance(&lights, &scene, Vec3::NEG_Y, Vec3::Y, 1).0 > 0.1);
    assert_eq!(irradiance(&lights, &scene, Vec3::Y, Vec3::NEG_Y, 1).0, 0.0);
}

/// A square lit through a texture of 16 x 1 texels: only the first quarter shines, or is there at all.
fn textured(alpha_mode: AlphaMode) -> (Scene, Pose) {
    let (mut scene, pose) = scene_of(vec![(
        square(Vec3::ZERO, Vec3::NEG_Y, 1.0),
        Vec3::splat(3.0),
        false,
    )]);
    let texels = (0..16)
        .map(|i| if i < 4 { [255; 4] } else { [0; 4] })
        .collect();
    scene.images.push(Image {
        name: String::new(),
        width: 16,
        height: 1,
        texels: Texels::Rgba8(texels),
    });
    let sampler = occlude_scene::Sampler {
        filter: occlude_scene::Filter::Nearest,
        ..Default::default()
    };
    scene.textures.push(Texture {
        image: 0,
        sampler,
        srgb: true,
    });
    let corners = square(Vec3::ZERO, Vec3::NEG_Y, 1.0);
    let (origin, across) = (corners[0][0], (corners[0][1] - corners[0][0]) / 4.0);
    let uv = |p: &Vec3| Vec2::new((*p - origin).dot(across), 0.5);
    scene.meshes[0].uv0 = corners.iter().flatten().map(uv).collect();
    let reference = TextureRef {
        texture: 0,
        uv_set: 0,
        transform: glam::Affine2::IDENTITY,
    };
    let material = &mut scene.materials[0];
    material.alpha_mode = alpha_mode;
    match alpha_mode {
        AlphaMode::Opaque => material.emission_texture = Some(reference),
        _ => material.base_color_texture = Some(reference),
    }
    (scene, pose)
}

#[test]
fn textures_and_alpha_shape_emission() {
    // The strip of the square that shines, as a polygon of its own.
    let corners = square(Vec3::ZERO, Vec3::NEG_Y, 1.0);
    let [a, b, d] = [corners[0][0], corners[0][1], corners[1][2]];
    let quarter = (b - a) * 0.25;
    let position = Vec3::new(0.2, -0.7, 0.1);
    let expected = 3.0 * polygon_irradiance(position, Vec3::Y, &[a, a + quarter, d + quarter, d]);
    for mode in [
        AlphaMode::Opaque,
        AlphaMode::Mask { cutoff: 0.5 },
        AlphaMode::Blend,
    ] {
        let (scene, pose) = textured(mode);
        for selection in SELECTIONS {
            let lights = Lights::new(&scene, &pose, None, selection);
            let found = irradiance(&lights, &scene, position, Vec3::Y, 12);
            assert_near(found, expected, &format!("{mode:?} {selection:?}"));
            assert_eq!(lights.len(), 2);
            for emissive in &lights.emitters.triangles {
                // One triangle of the square has 7/16 of its area in the strip, the other 1/16.
                let share = emissive.mean_radiance.x / 3.0;
                assert!(
                    (share - 7.0 / 16.0).abs() < 0.06 || (share - 1.0 / 16.0).abs() < 0.06,
                    "{share}"
                );
            }
        }
    }
    // What shows only its base colour lights nothing.
    let (mut scene, pose) = textured(AlphaMode::Opaque);
    scene.materials[0].unlit = true;
    assert!(Lights::new(&scene, &pose, None, LightSelection::Tree).is_empty());
}

#[test]
fn punctual_lights_follow_the_contract() {
    let (scene, mut pose) = scene_of(vec![(square(Vec3::ZERO, Vec3::Y, 5.0), Vec3::ZERO, false)]);
    let tilt = Vec3::new(0.6, -0.8, 0.0);
    let sun = |angular_diameter| {
        punctual(
            LightKind::Directional { angular_diameter },
            Vec3::splat(3.0),
            Vec3::ZERO,
            tilt,
        )
    };
    let cases: Vec<(PosedLight, f64)> = vec![
        (
            punctual(
                LightKind::Point,
                Vec3::splat(7.0),
                Vec3::new(3.0, 4.0, 0.0),
                Vec3::NEG_Z,
            ),
            7.0 / 25.0 * 0.8,
        ),
        (sun(0.0), 3.0 * 0.8),
        (sun(0.0093), 3.0 * 0.8),
        (sun(1.0), 3.0 * 0.8),
        (
            punctual(
                LightKind::Spot {
                    inner_angle: 0.2,
                    outer_angle: 0.5,
                },
                Vec3::splat(9.0),
                Vec3::new(0.0, 3.0, 0.0),
                Vec3::NEG_Y,
            ),
            1.0,
        ),
    ];
    for selection in SELECTIONS {
        for (light, expected) in &cases {
            pose.lights = vec![*light];
            let lights = Lights::new(&scene, &pose, None, selection);
            assert_near(
                irradiance(&lights, &scene, Vec3::ZERO, Vec3::Y, 5),
                *expected,
                &format!("{light:?}"),
            );
        }
        pose.lights = cases.iter().map(|c| c.0).collect();
        let lights = Lights::new(
            &scene,
            &pose,
            Some(Environment::constant(Vec3::splat(2.0))),
            selection,
        );
        assert_eq!(lights.len(), 6);
        let expected = cases.iter().map(|c| c.1).sum::<f64>() + 2.0 * f64::from(PI);
        assert_near(
            irradiance(&lights, &scene, Vec3::ZERO, Vec3::Y, 6),
            expected,
            "all together",
        );
    }
}

#[test]
fn degenerate_lights_are_harmless() {
    let flat = vec![
        [Vec3::ZERO, Vec3::X, Vec3::X * 2.0],
        [Vec3::NAN, Vec3::X, Vec3::Y],
    ];
    let (dark, mut dark_pose) = scene_of(vec![
        (flat, Vec3::ONE, false),
        (
            square(Vec3::ZERO, Vec3::Y, 1.0),
            Vec3::new(f32::NAN, 1.0, 1.0),
            false,
        ),
    ]);
    dark_pose.lights = vec![
        punctual(LightKind::Point, Vec3::ZERO, Vec3::ZERO, Vec3::NEG_Z),
        punctual(LightKind::Point, Vec3::ONE, Vec3::NAN, Vec3::NEG_Z),
        punctual(LightKind::Point, Vec3::INFINITY, Vec3::ZERO, Vec3::NEG_Z),
        punctual(
            LightKind::Directional {
                angular_diameter: 0.0,
            },
            Vec3::ONE,
            Vec3::ZERO,
            Vec3::ZERO,
        ),
    ];
    for selection in SELECTIONS {
        let lights = Lights::new(
            &dark,
            &dark_pose,
            Some(Environment::constant(Vec3::NAN)),
            selection,
        );
        assert!(lights.is_empty(), "{lights:?}");
        assert!(
            lights
                .sample(&dark, Vec3::ZERO, Vec3::Y, 0.5, Vec2::splat(0.5))
                .is_none()
        );
        // A point light exactly where the shading point is, and a triangle's own surface.
        let (scene, mut pose) = scene_of(vec![(square(Vec3::ZERO, Vec3::Y, 1.0), Vec3::ONE, true)]);
        pose.lights = vec![punctual(
            LightKind::Point,
            Vec3::ONE,
            Vec3::ZERO,
            Vec3::NEG_Z,
        )];
        let lights = Lights::new(&scene, &pose, None, selection);
        let mut random = Random(9);
        let corner = square(Vec3::ZERO, Vec3::Y, 1.0)[0][1];
        for position in [
            Vec3::ZERO,
            corner,
            Vec3::new(0.3, 0.0, 0.1),
            Vec3::splat(f32::NAN),
            Vec3::splat(1e30),
        ] {
            for _ in 0..1000 {
                let pick = random.unit();
                if let Some(s) = lights.sample(&scene, position, Vec3::ZERO, pick, random.pair()) {
                    assert!(
                        s.pdf > 0.0
                            && s.pdf.is_finite()
                            && s.radiance.is_finite()
                            && s.wi.is_normalized()
                    );
                }
            }
        }
    }
}

/// Where a ray from `position` meets the plane of a triangle, in double precision, with barycentric weights; `None` clearly
/// outside of the triangle.
fn hit(position: Vec3, wi: Vec3, corners: &[Vec3; 3]) -> Option<(Vec3, [f64; 2])> {
    let [a, b, c] = corners.map(|c| c.as_dvec3());
    let d = wi.as_dvec3();
    let (e1, e2, t) = (b - a, c - a, position.as_dvec3() - a);
    let p = d.cross(e2);
    let det = e1.dot(p);
    let u = t.dot(p) / det;
    let q = t.cross(e1);
    let v = d.dot(q) / det;
    let distance = e2.dot(q) / det;
    let slack = 1e-3;
    (distance > 0.0 && u > -slack && v > -slack && u + v < 1.0 + slack)
        .then(|| ((a + e1 * u + e2 * v).as_vec3(), [u, v]))
}

/// Pearson's statistic over the cells with enough expected counts, against its mean plus five standard deviations.
fn assert_chi_square(counts: &[f64], expected: &[f64], what: &str) {
    let (mut chi2, mut cells) = (0.0, 0.0);
    for (count, expected) in counts.iter().zip(expected).filter(|(_, e)| **e > 10.0) {
        chi2 += (count - expected).powi(2) / expected;
        cells += 1.0;
    }
    assert!(cells >= 2.0, "{what}: nothing to compare");
    assert!(
        chi2 < cells + 5.0 * (2.0_f64 * cells).sqrt() + 5.0,
        "{what}: {chi2} of {cells}"
    );
}

/// Samples of a triangle fall into its parts as `pdf_surface` says: chi-square over 8 x 8 parts.
#[test]
fn triangle_samples_follow_pdf_surface() {
    const CELLS: usize = 8;
    const FINE: usize = 48;
    let mut random = Random(77);
    let mut compared = 0;
    for case in 0..60 {
        let scale = 10.0_f32.powi(case % 11 - 5);
        let spread = [0.05, 0.4, 3.0][case as usize % 3];
        let center = random.direction() * scale;
        let corners: [Vec3; 3] =
            std::array::from_fn(|_| center + random.direction() * spread * scale);
        let (scene, pose) = scene_of(vec![(vec![corners], Vec3::ONE, true)]);
        let lights = Lights::new(&scene, &pose, None, LightSelection::Power);
        let normal = if case % 2 == 0 {
            Vec3::ZERO
        } else {
            center.normalize()
        };
        let what = format!("case {case}, spread {spread}");
        let n = 20_000;
        let mut counts = vec![0.0_f64; CELLS * CELLS];
        let mut drawn = 0;
        for _ in 0..n {
            let Some(s) = lights.sample(&scene, Vec3::ZERO, normal, 0.5, random.pair()) else {
                continue;
            };
            drawn += 1;
            let (point, [u, v]) =
                hit(Vec3::ZERO, s.wi, &corners).expect("the sample lies in the triangle");
            let again = lights.pdf_surface(Vec3::ZERO, normal, 0, 0, point);
            assert!(
                (again / s.pdf - 1.0).abs() < 2e-3,
                "{what}: {again} {}",
                s.pdf
            );
            // The end of the visibility question says the same per area.
            let LightEnd::Surface(end) = s.end else {
                panic!("not on a surface")
            };
            let per_area = s.pdf * end.normal.dot(-s.wi) / end.position.length_squared();
            assert!(
                (end.density / per_area - 1.0).abs() < 2e-3,
                "{what}: {} {per_area}",
                end.density
            );
            // Parts: strips parallel to the side opposite of the first vertex, cut by rays from there.
            let sum = (u + v).clamp(1e-12, 1.0);
            let cell = |x: f64| ((x * CELLS as f64) as usize).min(CELLS - 1);
            counts[cell(sum) * CELLS + cell((v / sum).clamp(0.0, 1.0))] += 1.0;
        }
        // Expected: the density per area, integrated over each part.
        let (a, e1, e2) = (corners[0], corners[1] - corners[0], corners[2] - corners[0]);
        let cross = e1.as_dvec3().cross(e2.as_dvec3());
        let side = CELLS * FINE;
        let mut expected = vec![0.0_f64; CELLS * CELLS];
        for i in 0..side {
            for j in 0..side {
                let sum = (i as f64 + 0.5) / side as f64;
                let v = sum * (j as f64 + 0.5) / side as f64;
                let point = a + e1 * (sum - v) as f32 + e2 * v as f32;
                if normal == Vec3::ZERO || normal.dot(point) > 0.0 {
                    let to = point.as_dvec3();
                    let solid_angle =
                        cross.dot(to).abs() / to.length().powi(3) * sum / (side * side) as f64;
                    let pdf = f64::from(lights.pdf_surface(Vec3::ZERO, normal, 0, 0, point));
                    expected[i / FINE * CELLS + j / FINE] += pdf * solid_angle * f64::from(n);
                }
            }
        }
        let total: f64 = expected.iter().sum();
        assert!(
            (f64::from(drawn) - total).abs() < 0.01 * f64::from(n),
            "{what}: {drawn} of {total}"
        );
        if total > 0.0 {
            compared += 1;
            assert_chi_square(&counts, &expected, &what);
        }
    }
    // The others lie below the horizon.
    assert!(compared > 50, "{compared}");
}

/// Chi-square of sampled directions against `pdf_environment` over a lat-long grid of 32 x 16 bins.
fn check_environment(lights: &Lights, scene: &Scene, normal: Vec3, what: &str) {
    const COLUMNS: usize = 32;
    const ROWS: usize = 16;
    const FINE: usize = 32;
    let mut expected = vec![0.0_f64; COLUMNS * ROWS];
    let n = 200_000;
    for i in 0..ROWS * FINE {
        for j in 0..COLUMNS * FINE {
            let theta = (i as f64 + 0.5) / (ROWS * FINE) as f64 * std::f64::consts::PI;
            let phi = ((j as f64 + 0.5) / (COLUMNS * FINE) as f64 - 0.5) * std::f64::consts::TAU;
            let wi = DVec3::new(
                theta.sin() * phi.cos(),
                theta.cos(),
                theta.sin() * phi.sin(),
            )
            .as_vec3();
            let area = theta.sin() * (std::f64::consts::PI / (ROWS * FINE) as f64).powi(2);
            if normal == Vec3::ZERO || normal.dot(wi) > 0.0 {
                expected[i / FINE * COLUMNS + j / FINE] +=
                    f64::from(lights.pdf_environment(Vec3::ZERO, normal, wi)) * area * f64::from(n);
            }
        }
    }
    let mut random = Random(4242);
    let mut counts = vec![0.0_f64; COLUMNS * ROWS];
    for _ in 0..n {
        let pick = random.unit();
        let Some(s) = lights.sample(scene, Vec3::ZERO, normal, pick, random.pair()) else {
            continue;
        };
        assert_eq!(
            s.pdf,
            lights.pdf_environment(Vec3::ZERO, normal, s.wi),
            "{what}"
        );
        assert_eq!(s.radiance, lights.environment(s.wi), "{what}");
        let column = ((0.5 + s.wi.z.atan2(s.wi.x) / (2.0 * PI)) * COLUMNS as f32) as usize;
        let row = (s.wi.y.clamp(-1.0, 1.0).acos() / PI * ROWS as f32) as usize;
        counts[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)] += 1.0;
    }
    assert_chi_square(&counts, &expected, what);
    // Hardly anything (slivers of bins at the horizon) is sampled where the density is 0.
    let outside: f64 = counts
        .iter()
        .zip(&expected)
        .filter(|(_, e)| **e == 0.0)
        .map(|(c, _)| c)
        .sum();
    assert!(outside < 1e-4 * f64::from(n), "{what}: {outside}");
}

fn picture(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Picture {
    Picture {
        width: width as u32,
        height: height as u32,
        pixels,
    }
}

fn noise_map(width: usize, height: usize) -> Picture {
    let mut random = Random(5);
    let pixels = (0..width * height)
        .map(|_| [random.unit().powi(6) * 50.0, random.unit(), random.unit()])
        .collect();
    picture(width, height, pixels)
}

#[test]
fn environment_samples_follow_pdf_environment() {
    let (scene, pose) = scene_of(vec![(square(Vec3::ZERO, Vec3::Y, 5.0), Vec3::ZERO, false)]);
    let map = Environment::from_picture(&noise_map(32, 16), 0.0, 2.0);
    // A rotation by whole bins, so that the quadrature above stays exact.
    let rotated = Environment::from_picture(&noise_map(32, 16), 7.0 * PI / 16.0, 2.0);
    for normal in [Vec3::ZERO, Vec3::new(0.6, 0.8, 0.0)] {
        for (environment, what) in [
            (Environment::constant(Vec3::ONE), "constant"),
            (map.clone(), "map"),
            (rotated.clone(), "rotated map"),
        ] {
            let lights = Lights::new(&scene, &pose, Some(environment), LightSelection::Tree);
            check_environment(&lights, &scene, normal, what);
        }
    }
}

#[test]
fn suns_and_sky_overlap() {
    let (scene, mut pose) = scene_of(vec![(square(Vec3::ZERO, Vec3::Y, 5.0), Vec3::ZERO, false)]);
    let sun = |angular_diameter, direction| {
        punctual(
            LightKind::Directional { angular_diameter },
            Vec3::splat(3.0),
            Vec3::ZERO,
            direction,
        )
    };
    // Two suns that overlap each other and a bright sky.
    pose.lights = vec![
        sun(0.6, Vec3::NEG_Y),
        sun(0.5, Vec3::new(0.1, -1.0, 0.0).normalize()),
    ];
    for selection in SELECTIONS {
        let environment = Environment::constant(Vec3::splat(0.7));
        let lights = Lights::new(&scene, &pose, Some(environment), selection);
        let cosine = f64::from(-pose.lights[1].direction.y);
        let expected = 3.0 + 3.0 * cosine + 0.7 * std::f64::consts::PI;
        assert_near(
            irradiance(&lights, &scene, Vec3::ZERO, Vec3::Y, 8),
            expected,
            "two suns and a sky",
        );
    }
}

#[test]
fn maps_are_oriented_as_the_contract_says() {
    // 64 x 32, one bright block at the place of each axis.
    let (w, h) = (64_usize, 32_usize);
    let places: [(Vec3, usize, usize); 6] = [
        (Vec3::X, w / 2, h / 2),
        (Vec3::Z, 3 * w / 4, h / 2),
        (Vec3::NEG_X, 0, h / 2),
        (Vec3::NEG_Z, w / 4, h / 2),
        (Vec3::Y, w / 2, 0),
        (Vec3::NEG_Y, w / 2, h - 1),
    ];
    for (axis, column, row) in places {
        let mut pixels = vec![[0.0; 3]; w * h];
        for y in row.saturating_sub(2)..(row + 3).min(h) {
            for x in 0..w {
                let distance = (x as i64 - column as i64).rem_euclid(w as i64);
                if row == 0 || row == h - 1 || distance.min(w as i64 - distance) <= 2 {
                    pixels[y * w + x] = [1.0; 3];
                }
            }
        }
        let map = picture(w, h, pixels);
        let sky = Environment::from_picture(&map, 0.0, 3.0);
        assert_eq!(sky.radiance(axis), Vec3::splat(3.0), "{axis}");
        for (other, ..) in places.iter().filter(|p| p.0 != axis) {
            assert_eq!(sky.radiance(*other), Vec3::ZERO, "{axis} {other}");
        }
        // Counterclockwise seen from above is the right-handed rotation about +Y.
        for degrees in [90.0_f32, 30.0, 200.0] {
            let turned = Environment::from_picture(&map, degrees.to_radians(), 3.0);
            let expected = Mat3::from_rotation_y(degrees.to_radians()) * axis;
            assert!(
                (turned.radiance(expected) - 3.0).abs().max_element() < 1e-5,
                "{axis} {degrees}"
            );
            let mut random = Random(1);
            for _ in 0..100 {
                let wi = turned.sample(Vec3::ZERO, random.pair()).unwrap();
                assert!(wi.dot(expected) > 0.8, "{axis} {degrees}: {wi}");
            }
        }
    }
    assert!((Mat3::from_rotation_y(PI / 2.0) * Vec3::X - Vec3::NEG_Z).length() < 1e-6);
}

#[test]
fn a_sun_in_the_map_is_found() {
    let (w, h) = (256, 128);
    let mut pixels = vec![[0.1; 3]; w * h];
    pixels[30 * w + 17] = [60_000.0; 3];
    pixels[0] = [f32::NAN, 1.0, -3.0];
    let (scene, pose) = scene_of(vec![(square(Vec3::ZERO, Vec3::Y, 5.0), Vec3::ZERO, false)]);
    let sky = Environment::from_picture(&picture(w, h, pixels), 1.0, 0.5);
    let integral = f64::from(sky.integral().x);
    let lights = Lights::new(&scene, &pose, Some(sky), LightSelection::Power);
    let mut random = Random(3);
    let (mut sum, mut squares, n) = (0.0, 0.0, 20_000);
    for _ in 0..n {
        let s = lights
            .sample(&scene, Vec3::ZERO, Vec3::ZERO, 0.5, random.pair())
            .unwrap();
        let value = f64::from(s.radiance.x / s.pdf);
        sum += value / f64::from(n);
        squares += value * value / f64::from(n);
    }
    let sigma = ((squares - sum * sum) / f64::from(n)).sqrt();
    // Without importance sampling, one sample in 20 000 would carry nearly everything.
    assert!(sigma < 0.02 * sum, "{sigma} of {sum}");
    assert!(
        (sum - integral).abs() < 4.0 * sigma,
        "{sum} +- {sigma}: {integral}"
    );
}

#[test]
fn odd_maps_are_safe() {
    let u = Vec2::new(0.3, 0.6);
    let one = Environment::from_picture(&picture(1, 1, vec![[2.0, 1.0, 0.5]]), 0.0, 1.0);
    assert_eq!(one.radiance(Vec3::X), Vec3::new(2.0, 1.0, 0.5));
    assert!((one.pdf(Vec3::ZERO, one.sample(Vec3::ZERO, u).unwrap()) - 0.25 / PI).abs() < 1e-6);
    assert!((one.integral().x - 8.0 * PI).abs() < 1e-4);
    let infinite =
        Environment::from_picture(&picture(2, 1, vec![[f32::INFINITY; 3], [2.0; 3]]), 0.0, 1.0);
    assert_eq!(infinite.radiance(Vec3::NEG_Z), Vec3::splat(2.0));
    for black in [
        Environment::from_picture(&picture(2, 2, vec![[0.0; 3]; 4]), 0.0, 1.0),
        Environment::from_picture(&picture(2, 2, vec![[f32::NAN; 3]; 4]), 0.0, 1.0),
        Environment::from_picture(&picture(2, 2, vec![[f32::NEG_INFINITY; 3]; 4]), 0.0, 1.0),
        Environment::from_picture(&picture(2, 2, vec![[1.0; 3]; 4]), 0.0, f32::NAN),
        Environment::from_picture(&picture(0, 5, vec![]), 0.0, 1.0),
        Environment::from_picture(&picture(5, 5, vec![[1.0; 3]; 4]), 0.0, 1.0),
    ] {
        assert!(black.is_black());
        assert!(black.sample(Vec3::ZERO, u).is_none());
        assert_eq!(black.pdf(Vec3::ZERO, Vec3::X), 0.0);
        assert_eq!(black.radiance(Vec3::X), Vec3::ZERO);
    }
    let hot = Environment::from_picture(&picture(3, 2, vec![[1e38; 3]; 6]), f32::NAN, 1.0);
    if let Some(wi) = hot.sample(Vec3::ZERO, u) {
        assert!(hot.pdf(Vec3::ZERO, wi).is_finite() && hot.radiance(wi).is_finite());
    }
}
