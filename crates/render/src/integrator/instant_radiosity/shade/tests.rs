//! The loops over packs against eye by eye and light by light in plain form.

use super::*;
use crate::bsdf::{Bsdf, BsdfParameters};
use crate::geometry::Geometry;
use crate::sampling::{Sampler, SamplerKind, warp};
use glam::{Mat3, Vec2};
use occlude_bvh::BuildOptions;
use occlude_scene::{Material, Mesh, Pose, procedural};
use occlude_visibility::{Endpoint, EyeSample, LightEnd};
use std::f32::consts::FRAC_1_PI;

fn numbers(seed: u64) -> impl FnMut() -> [f32; 4] {
    let mut sampler = Sampler::new(SamplerKind::Independent, seed, [0, 0], 0);
    move || sampler.next()
}

fn shared(position: Vec3) -> SharedLight {
    SharedLight {
        end: LightEnd::Point(position),
        target: Some(position),
        connections: 1.0,
    }
}

/// Lights of a kind, and each as `(vector to it, radiance per unit of f cos)` from an eye.
fn lights(
    kind: Kind,
    count: usize,
    next: &mut impl FnMut() -> [f32; 4],
) -> (LightList, Vec<(Vec3, Vec3, Vec3)>) {
    let mut list = LightList::new(kind);
    let mut plain = Vec::new();
    for _ in 0..count {
        let [x, y, z, w] = next();
        let [u, v, r, g] = next();
        let position = Vec3::new(x, y, z) * 4.0 - 2.0;
        let axis = warp::uniform_sphere(Vec2::new(u, v));
        let colour = Vec3::new(r, g, w);
        match kind {
            Kind::Patch => {
                list.push_patch(shared(position), position, axis, colour, (4.0 * r) as u32);
            }
            Kind::Point => {
                list.push_point(shared(position), position, colour, Some((axis, 2.0, 0.3)))
            }
            Kind::Direction => list.push_direction(shared(axis), axis, colour),
        }
        plain.push((position, axis, colour));
    }
    (list, plain)
}

/// What a light sends to an eye per unit of `f cos`, and where from.
fn arriving(kind: Kind, light: &(Vec3, Vec3, Vec3), eye: Vec3) -> (Vec3, Vec3) {
    let &(position, axis, colour) = light;
    if kind == Kind::Direction {
        return (axis, colour);
    }
    let way = position - eye;
    let wi = way.normalize();
    let factor = match kind {
        Kind::Patch => (-axis.dot(wi)).max(0.0),
        _ => (0.3 - 2.0 * axis.dot(wi)).clamp(0.0, 1.0).powi(2),
    };
    (wi, colour * (factor / way.length_squared()))
}

struct Scene {
    eyes: Vec<Eye>,
    ends: Vec<EyeSample>,
    scatterers: Scatterers,
    /// Of each eye: its scattering, and local from world.
    bsdfs: Vec<(Bsdf, Mat3, Vec3)>,
}

fn eyes(parameters: &BsdfParameters, next: &mut impl FnMut() -> [f32; 4]) -> Scene {
    let mut scene = Scene {
        eyes: vec![],
        ends: vec![],
        scatterers: Scatterers::default(),
        bsdfs: vec![],
    };
    for sample in 0..40 {
        let [x, y, z, w] = next();
        let [u, v, s, t] = next();
        let position = Vec3::new(x, y, z) * 4.0 - 2.0;
        let shading_normal = warp::uniform_sphere(Vec2::new(u, v));
        let (a, b) = warp::basis(shading_normal);
        let normal = (shading_normal + a * (0.3 * w) + b * (0.2 * t)).normalize();
        let wo = warp::uniform_hemisphere(Vec2::new(s, t));
        let world_from_local = Mat3::from_cols(a, b, shading_normal);
        let bsdf = Bsdf::new(parameters, wo).split().broad.unwrap();
        let weight = Vec3::new(1.0, 0.7, 0.4);
        let (scatter, weight) = match (bsdf.lambert(), bsdf.broad()) {
            (Some(colour), _) => (Scatter::Lambert, weight * colour * FRAC_1_PI),
            (None, Some(broad)) => {
                scene.scatterers.closed.push(Closed {
                    broad,
                    wo: world_from_local * wo,
                    cos_o: wo.z,
                });
                (Scatter::Closed(sample), weight)
            }
            (None, None) => {
                scene.scatterers.layered.push(Layered {
                    bsdf,
                    local_from_world: world_from_local.transpose(),
                    wo,
                });
                (Scatter::Layered(sample), weight)
            }
        };
        let end = Endpoint::new(position, normal, 1.0);
        scene.eyes.push(Eye {
            position,
            normal,
            shading_normal,
            weight,
            events_left: (4.0 * s).floor(),
            scatter,
            sample,
        });
        scene.ends.push(EyeSample {
            end,
            origin: position,
        });
        scene.bsdfs.push((bsdf, world_from_local.transpose(), wo));
    }
    scene
}

/// Asks about a list with everything visible: what each eye gets, which lights were wanted by block and eye, and what the bound took.
fn shine(list: &LightList, scene: &Scene, clamp: f32) -> (Vec<Vec3>, Vec<Vec<u16>>, f64) {
    ask(list, scene, clamp, |asker| {
        let mut masks = Vec::new();
        for block in 0..list.len().div_ceil(BLOCK) {
            let mut wanted = vec![0; scene.eyes.len()];
            asker.wanted(block, &mut wanted);
            asker.take(block, &wanted, &[]);
            masks.push(wanted);
        }
        masks
    })
}

fn ask<R>(
    list: &LightList,
    scene: &Scene,
    clamp: f32,
    f: impl FnOnce(&mut Asker) -> R,
) -> (Vec<Vec3>, R, f64) {
    let mut packs = Packs::default();
    packs.gather(&scene.eyes, &scene.scatterers);
    let mut asker = Asker {
        lights: list,
        eyes: &scene.eyes,
        scatterers: &scene.scatterers,
        clamp,
        panes: None,
        packs: &mut packs,
        clamped: 0.0,
    };
    let result = f(&mut asker);
    let clamped = asker.clamped;
    let mut radiance = vec![Vec3::ZERO; scene.eyes.len()];
    packs.settle(&scene.eyes, &mut radiance);
    (radiance, result, clamped)
}

#[test]
fn blocks_equal_one_by_one() {
    let lambert = BsdfParameters {
        base_color: Vec3::new(0.8, 0.5, 0.2),
        specular: 0.0,
        ..BsdfParameters::default()
    };
    let closed = BsdfParameters {
        specular: 1.0,
        roughness: 0.6,
        metallic: 0.5,
        ..lambert
    };
    let layered = BsdfParameters {
        clearcoat: 0.8,
        clearcoat_roughness: 0.7,
        ..closed
    };
    for (parameters, tolerance) in [(lambert, 1e-5), (closed, 0.02), (layered, 1e-4)] {
        for kind in [Kind::Patch, Kind::Point, Kind::Direction] {
            let mut next = numbers(7);
            let (list, plain) = lights(kind, 45, &mut next);
            let scene = eyes(&parameters, &mut next);
            let (found, masks, clamped) = shine(&list, &scene, f32::INFINITY);
            assert_eq!(clamped, 0.0);
            for (e, eye) in scene.eyes.iter().enumerate() {
                let (bsdf, local_from_world, wo) = &scene.bsdfs[e];
                let mut sum = Vec3::ZERO;
                for (l, light) in plain.iter().enumerate() {
                    let (wi, arriving) = arriving(kind, light, eye.position);
                    let in_front = wi.dot(eye.normal) > 0.0 && wi.dot(eye.shading_normal) > 0.0;
                    let short_enough =
                        kind != Kind::Patch || ((4.0 * light.2.x) as u32) as f32 <= eye.events_left;
                    let wanted = in_front && short_enough && arriving != Vec3::ZERO;
                    let asked = masks[l / BLOCK][e] >> (l % BLOCK) & 1 != 0;
                    assert_eq!(asked, wanted, "{kind:?}, eye {e}, light {l}");
                    if wanted {
                        sum += bsdf.eval(*wo, *local_from_world * wi).0 * arriving;
                    }
                }
                let sum = sum * Vec3::new(1.0, 0.7, 0.4);
                let error = (found[e] - sum).abs().max_element();
                assert!(
                    error <= tolerance * sum.max_element() + 1e-6,
                    "{kind:?}, eye {e}: {}, not {sum}",
                    found[e]
                );
            }
        }
    }
}

/// The bound takes away what it says, from Lambert and other surfaces alike.
#[test]
fn the_clamp_is_measured() {
    for specular in [0.0, 1.0] {
        let parameters = BsdfParameters {
            specular,
            ..BsdfParameters::default()
        };
        let mut next = numbers(3);
        let (list, plain) = lights(Kind::Patch, 33, &mut next);
        let scene = eyes(&parameters, &mut next);
        let (whole, ..) = shine(&list, &scene, f32::INFINITY);
        let (rest, _, clamped) = shine(&list, &scene, 0.05);
        let sum = |all: &[Vec3]| all.iter().map(|v| f64::from(v.element_sum())).sum::<f64>();
        assert!(clamped > 0.1 * sum(&whole));
        assert!((sum(&whole) - sum(&rest) - clamped).abs() < 1e-5 * sum(&whole));
        if specular == 0.0 {
            for (eye, found) in scene.eyes.iter().zip(&rest) {
                let one = |l: &(Vec3, Vec3, Vec3)| {
                    patch_on_lambert(eye, l.0, l.1, l.2, (4.0 * l.2.x) as u32, 0.05)
                };
                let sum: Vec3 = plain.iter().map(one).sum();
                assert!((sum - *found).abs().max_element() < 1e-5 * (1.0 + sum.max_element()));
            }
        }
    }
}

/// Instruction sets do not show in the result.
#[test]
#[cfg(target_arch = "x86_64")]
fn instruction_sets_agree_to_the_bit() {
    use super::kernels::{take_by_kind, wanted_by_kind};
    use super::wide::Plain;
    let parameters = BsdfParameters {
        roughness: 0.5,
        ..BsdfParameters::default()
    };
    let mut next = numbers(11);
    let (list, _) = lights(Kind::Patch, 32, &mut next);
    let scene = eyes(&parameters, &mut next);
    let (best, ..) = shine(&list, &scene, 0.2);
    let (plain, ..) = ask(&list, &scene, 0.2, |asker| {
        for block in 0..2 {
            let mut masks = vec![0; scene.eyes.len()];
            wanted_by_kind::<Plain>(asker, block, &mut masks);
            take_by_kind::<Plain>(asker, block, &masks, &[]);
        }
    });
    assert_eq!(best, plain);
}

/// A correction adds a light's whole contribution times an amount.
#[test]
fn corrections_add_single_lights() {
    let parameters = BsdfParameters {
        roughness: 0.5,
        ..BsdfParameters::default()
    };
    let mut next = numbers(13);
    let (list, _) = lights(Kind::Patch, 16, &mut next);
    let scene = eyes(&parameters, &mut next);
    let (whole, masks, lost) = shine(&list, &scene, 0.2);
    let (added, (), lost_again) = ask(&list, &scene, 0.2, |asker| {
        // Half of what is seen as a bit and a half as corrections, then twice the rest.
        let wanted = &masks[0];
        let seen: Vec<u16> = wanted.iter().map(|mask| mask & 0x5555).collect();
        let corrections: Vec<Correction> = (0..scene.eyes.len() as u32)
            .flat_map(|eye| (0..16).map(move |light| (eye, light)))
            .filter(|&(eye, light)| wanted[eye as usize] >> light & 1 != 0)
            .map(|(eye, light)| Correction {
                eye,
                light,
                amount: if light % 2 == 0 { 1.0 } else { 2.0 },
            })
            .collect();
        asker.take(0, &seen, &corrections);
    });
    assert!((lost_again - 2.0 * lost).abs() < 1e-4 * lost);
    for (whole, added) in whole.iter().zip(&added) {
        assert!((*added - *whole * 2.0).abs().max_element() <= 1e-4 * whole.max_element());
    }
}

/// Panes that are culled by boxes tint nothing, and what is left is tinted as ray by ray.
#[test]
fn panes_tint_as_ray_by_ray() {
    let mut next = numbers(17);
    let parameters = BsdfParameters::default();
    let eyes = eyes(&parameters, &mut next);
    let mut packs = Packs::default();
    packs.gather(&eyes.eyes, &eyes.scatterers);
    let mut scene = procedural::build(procedural::Name::Cornell, None, 0);
    let first = scene.instances[0].mesh as usize;
    scene.materials.push(Material {
        base_color: glam::Vec4::new(0.9, 0.7, 0.5, 1.0),
        metallic: 0.0,
        roughness: 0.0,
        transmission: 1.0,
        ..Material::default()
    });
    for (triangles, size) in [(1, 1.0), (6, 0.5), (300, 0.1)] {
        let mut mesh = Mesh {
            material: scene.materials.len() as u32 - 1,
            ..Mesh::default()
        };
        for triangle in 0..triangles {
            let corner = Vec3::from_slice(&next()) * 4.0 - 2.0;
            for _ in 0..3 {
                let off = Vec3::from_slice(&next()) * 2.0 - 1.0;
                mesh.positions.push(corner + off * size);
            }
            mesh.triangles.push([0, 1, 2].map(|i| 3 * triangle + i));
        }
        scene.meshes[first] = mesh;
        let pose = Pose::at(&scene, 0.0);
        let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
        assert!(geometry.has_panes());
        for kind in [Kind::Point, Kind::Direction] {
            let (mut list, _) = lights(kind, 70, &mut next);
            if kind == Kind::Direction {
                list.shared.iter_mut().for_each(|light| light.target = None);
                for light in &mut list.shared {
                    if let LightEnd::Point(direction) = light.end {
                        light.end = LightEnd::Direction(direction);
                    }
                }
            }
            let panes = Panes::new(&geometry, &list, &packs, &eyes.ends).unwrap();
            let (mut tinted, mut culled) = (0, 0);
            for (p, pack) in packs.packs.iter().enumerate() {
                for (number, light) in list.shared.iter().enumerate() {
                    let (index, l) = (number / BLOCK, number % BLOCK);
                    let among = panes.of_block(p, index);
                    let masks = [1 << l; wide::WIDE];
                    let found = (among != 0)
                        .then(|| panes.tint((p, pack), (index, l), &masks, among))
                        .flatten();
                    culled += u32::from(found.is_none());
                    for (lane, &eye) in pack.eyes.iter().enumerate() {
                        let ray = light.ray_from(eyes.ends[eye as usize].origin);
                        let wanted = geometry.pane_transmittance(&ray);
                        let found =
                            found.map_or(Vec3::ONE, |rows| Vec3::from_array(rows.map(|r| r[lane])));
                        assert_eq!(found, wanted, "{kind:?}, eye {eye}, light {number}");
                        tinted += u32::from(wanted != Vec3::ONE);
                    }
                }
            }
            assert!(tinted > 5, "{kind:?}, {triangles}: {tinted}");
            assert!(culled > 20 || size < 1.0, "{kind:?}, {triangles}: {culled}");
        }
    }
}

/// Prints the cost of shading: `cargo test --release -p occlude-render --lib cost_of_shading -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn cost_of_shading() {
    for (name, specular) in [("Lambert", 0.0), ("closed form", 1.0)] {
        let parameters = BsdfParameters {
            specular,
            roughness: 0.6,
            ..BsdfParameters::default()
        };
        let mut next = numbers(5);
        let (list, _) = lights(Kind::Patch, 1024, &mut next);
        let few = eyes(&parameters, &mut next);
        let mut scene = eyes(&parameters, &mut next);
        for i in 0..9216 {
            scene.eyes.push(Eye {
                sample: i as u32,
                events_left: 9.0,
                ..few.eyes[i % few.eyes.len()]
            });
            scene.ends.push(few.ends[i % few.ends.len()]);
        }
        let count = scene.eyes.len();
        let (mut to_ask, mut to_take, mut asked) = (0.0, 0.0, 0u64);
        ask(&list, &scene, 100.0, |asker| {
            for block in 0..64 {
                let mut masks = vec![0; count];
                let before = std::time::Instant::now();
                asker.wanted(block, &mut masks);
                to_ask += before.elapsed().as_secs_f64();
                asked += masks.iter().map(|m| u64::from(m.count_ones())).sum::<u64>();
                let before = std::time::Instant::now();
                asker.take(block, &masks, &[]);
                to_take += before.elapsed().as_secs_f64();
            }
        });
        let each = 1e9 / (count as f64 * 1024.0);
        println!(
            "{name}: to ask {:.2} ns a light, to shade {:.2} ns a light ({:.0} % asked for)",
            to_ask * each,
            to_take * each,
            asked as f64 / (count as f64 * 10.24)
        );
    }
}
