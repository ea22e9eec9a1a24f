//! Rays against brute force.

mod common;

use common::*;
use glam::{Affine3A, Vec3};
use occlude_bvh::{Accel, BuildOptions, Flatten, InstanceInput, NoFilter};
use occlude_visibility::Ray;

fn compare(soup: &Soup, options: &BuildOptions, rays: &[Ray]) {
    let accel = soup.accel(options);
    for accel in each_simd(&accel) {
        let mut hits = 0;
        for ray in rays {
            let hit = accel.closest(ray, &NoFilter);
            assert!(agrees(ray, soup, hit.as_ref()), "{ray:?} {hit:?}");
            hits += usize::from(hit.is_some());
            assert_eq!(accel.occluded(ray, &NoFilter), hit.is_some(), "{ray:?}");
            if let Some(hit) = hit {
                assert!(hit.t > ray.t_min && hit.t < ray.t_max);
                let blocker = accel.blocker(ray, &NoFilter).unwrap();
                assert!(accel.blocks(blocker, ray, &NoFilter));
            }
        }
        assert!(hits > rays.len() / 20, "{hits} hits only");
    }
}

#[test]
fn random_triangles_match_brute_force() {
    let mut random = Random(1);
    for count in [1, 2, 3, 4, 5, 8, 9, 33, 300, 3000] {
        let soup = Soup::random(&mut random, count, if count < 100 { 3.0 } else { 1.0 });
        let mut rays = rays(&mut random, 500);
        rays.extend(aimed(&mut random, &soup, 200));
        compare(&soup, &BuildOptions::default(), &rays);
        compare(&soup, &watertight(), &rays);
    }
}

#[test]
fn instances_match_flattened_and_brute_force() {
    let mut random = Random(2);
    let meshes: Vec<Soup> = (0..4)
        .map(|_| Soup::random(&mut random, 150, 1.0))
        .collect();
    let inputs: Vec<_> = meshes.iter().map(Soup::input).collect();
    let instances: Vec<InstanceInput> = (0..40)
        .map(|k| InstanceInput {
            mesh: k % 4,
            world_from_object: transform(&mut random),
        })
        .collect();
    let build = |flatten| {
        let options = BuildOptions {
            flatten,
            ..Default::default()
        };
        let accel = Accel::build(&inputs, &instances, &options).unwrap();
        accel.validate().unwrap();
        accel
    };
    let (own, flat) = (build(Flatten::Never), build(Flatten::Always));
    assert_eq!(own.stats().placed, 40);
    assert_eq!(flat.stats().flattened, 40);
    assert_eq!(own.stats().world_triangles, flat.stats().triangles);
    let mut differ = 0;
    let rays: Vec<Ray> = rays(&mut random, 4000)
        .into_iter()
        .map(|r| Ray {
            origin: r.origin * 3.0,
            ..r
        })
        .collect();
    for own in each_simd(&own) {
        for ray in &rays {
            let (a, b) = (own.closest(ray, &NoFilter), flat.closest(ray, &NoFilter));
            assert_eq!(own.occluded(ray, &NoFilter), a.is_some());
            if let Some(a) = a {
                let blocker = own.blocker(ray, &NoFilter).unwrap();
                assert!(own.blocks(blocker, ray, &NoFilter));
                let i = &instances[a.instance as usize];
                let v = meshes[i.mesh as usize]
                    .corners(a.primitive as usize)
                    .map(|p| i.world_from_object.transform_point3(p));
                let p = v[0] * (1.0 - a.u - a.v) + v[1] * a.u + v[2] * a.v;
                assert!((p - ray.at(a.t)).length() < 1e-4 * (1.0 + p.length()));
            }
            match (a, b) {
                (Some(a), Some(b)) if (a.t - b.t).abs() <= 1e-4 * (1.0 + a.t) => {}
                (None, None) => {}
                _ => differ += 1,
            }
        }
    }
    assert!(differ <= 4, "{differ} of {} rays differ", 2 * rays.len());
}

/// Rays through the texels of a hemisphere's map, row by row in packets of 4 x 2.
fn fan(origin: Vec3, size: usize) -> Vec<Ray> {
    let mut rays = Vec::new();
    for (y, x) in (0..size / 2).flat_map(|y| (0..size / 4).map(move |x| (2 * y, 4 * x))) {
        for k in 0..8 {
            let at = |i: usize| 2.0 * (i as f32 + 0.5) / size as f32 - 1.0;
            let (s, t) = (at(x + k % 4), at(y + k / 4));
            let z = 1.0 - s * s - t * t;
            rays.push(Ray::new(origin, Vec3::new(2.0 * s, 2.0 * t, z)));
        }
    }
    rays
}

/// Batches answer as single rays do.
fn together_as_alone(accel: &Accel, rays: &[Ray]) {
    let mut together = vec![None; rays.len()];
    accel.closest_coherent(rays, &mut together, &NoFilter);
    let mut occluded = vec![false; rays.len()];
    accel.occluded_batch(rays, &mut occluded, &NoFilter);
    for ((ray, hit), occluded) in rays.iter().zip(&together).zip(occluded) {
        let alone = accel.closest(ray, &NoFilter);
        assert_eq!(hit.map(|hit| hit.t), alone.map(|hit| hit.t), "{ray:?}");
        assert_eq!(occluded, alone.is_some(), "{ray:?}");
    }
}

#[test]
fn coherent_batches_find_the_same_distances_as_single_rays() {
    let mut random = Random(17);
    for (count, size) in [(1, 3.0), (9, 3.0), (300, 1.0), (3000, 0.5)] {
        let soup = Soup::random(&mut random, count, size);
        let mut rays = fan(Vec3::splat(0.05), 32);
        rays.extend(self::rays(&mut random, 501));
        rays[13].direction = Vec3::ZERO;
        rays[99].t_max = 0.2;
        for options in [BuildOptions::default(), watertight()] {
            let accel = soup.accel(&options);
            for accel in each_simd(&accel) {
                together_as_alone(&accel, &rays);
            }
        }
    }
}

#[test]
fn coherent_batches_enter_instances() {
    let mut random = Random(18);
    let mesh = Soup::random(&mut random, 150, 1.0);
    let instances: Vec<InstanceInput> = (0..40)
        .map(|_| InstanceInput {
            mesh: 0,
            world_from_object: transform(&mut random),
        })
        .collect();
    let options = BuildOptions {
        flatten: Flatten::Never,
        ..Default::default()
    };
    let accel = Accel::build(&[mesh.input()], &instances, &options).unwrap();
    for accel in each_simd(&accel) {
        let rays = fan(Vec3::splat(0.3), 64);
        together_as_alone(&accel, &rays);
    }
}

#[test]
fn nothing_is_hit_where_nothing_is() {
    let ray = Ray::new(Vec3::ZERO, Vec3::Z);
    let empty = Accel::build(&[], &[], &BuildOptions::default()).unwrap();
    empty.validate().unwrap();
    assert!(empty.closest(&ray, &NoFilter).is_none());
    assert!(empty.bounds().is_none());
    let mesh = Soup::default();
    let none = Accel::build(&[mesh.input()], &[identity()], &BuildOptions::default()).unwrap();
    none.validate().unwrap();
    assert!(!none.occluded(&ray, &NoFilter));
}

#[test]
fn bad_rays_hit_nothing() {
    let mut random = Random(3);
    let accel = Soup::random(&mut random, 1000, 1.0).accel(&BuildOptions::default());
    for accel in each_simd(&accel) {
        let good = Ray::new(Vec3::splat(0.1), Vec3::Z);
        let nan = f32::NAN;
        let mut bad = vec![
            Ray {
                direction: Vec3::ZERO,
                ..good
            },
            Ray { t_min: nan, ..good },
            Ray { t_max: nan, ..good },
            Ray {
                t_max: -1.0,
                ..good
            },
            Ray {
                t_min: f32::INFINITY,
                ..good
            },
            Ray {
                t_min: 1.0,
                t_max: 1.0,
                ..good
            },
        ];
        for value in [nan, f32::INFINITY, f32::NEG_INFINITY] {
            for axis in 0..3 {
                for direction in [Vec3::Z, Vec3::splat(0.5)] {
                    let mut ray = Ray { direction, ..good };
                    ray.origin[axis] = value;
                    bad.push(ray);
                    let mut ray = Ray { direction, ..good };
                    ray.direction[axis] = value;
                    bad.push(ray);
                }
            }
        }
        for ray in bad {
            assert!(accel.closest(&ray, &NoFilter).is_none(), "{ray:?}");
            assert!(!accel.occluded(&ray, &NoFilter), "{ray:?}");
        }
    }
}

#[test]
fn scale_and_offset_change_nothing() {
    let mut random = Random(4);
    let soup = Soup::random(&mut random, 500, 1.0);
    let base = rays(&mut random, 600);
    for scale in [1e-12f32, 1e-5, 1e-3, 1e3, 1e5, 1e10] {
        let scaled = soup.clone().map(|p| p * scale);
        let rays: Vec<Ray> = base
            .iter()
            .map(|r| Ray {
                origin: r.origin * scale,
                direction: r.direction * scale,
                ..*r
            })
            .collect();
        compare(&scaled, &BuildOptions::default(), &rays);
    }
    for offset in [Vec3::new(100.0, -50.0, 1000.0), Vec3::splat(3e4)] {
        let moved = soup.clone().map(|p| p + offset);
        let accel = moved.accel(&BuildOptions::default());
        for accel in each_simd(&accel) {
            for ray in &base {
                let ray = Ray {
                    origin: ray.origin + offset,
                    ..*ray
                };
                let hit = accel.closest(&ray, &NoFilter);
                agrees(&ray, &moved, hit.as_ref());
            }
        }
    }
}

#[test]
fn directions_of_any_length() {
    let mut random = Random(5);
    let soup = Soup::random(&mut random, 300, 1.0);
    let accel = soup.accel(&BuildOptions::default());
    for accel in each_simd(&accel) {
        for ray in rays(&mut random, 300) {
            let ray = Ray {
                t_min: 0.0,
                t_max: f32::INFINITY,
                ..ray
            };
            let reference = accel.closest(&ray, &NoFilter);
            for length in [1e-30f32, 1e-10, 1e10, 1e25] {
                let long = Ray {
                    direction: ray.direction * length,
                    ..ray
                };
                let hit = accel.closest(&long, &NoFilter);
                assert_eq!(hit.is_some(), reference.is_some(), "{long:?}");
                if let (Some(a), Some(b)) = (hit, reference) {
                    assert!(
                        (a.t * length - b.t).abs() <= 1e-3 * b.t.abs() + 1e-5,
                        "{a:?} {b:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn singular_transforms_are_flattened_and_dropped() {
    let mut random = Random(6);
    let soup = Soup::random(&mut random, 100, 1.0);
    let flat = InstanceInput {
        mesh: 0,
        world_from_object: Affine3A::from_scale(Vec3::new(1.0, 1.0, 0.0)),
    };
    let point = InstanceInput {
        mesh: 0,
        world_from_object: Affine3A::from_scale(Vec3::ZERO),
    };
    let nan = InstanceInput {
        mesh: 0,
        world_from_object: Affine3A::from_translation(Vec3::new(f32::NAN, 0.0, 0.0)),
    };
    let options = BuildOptions {
        flatten: Flatten::Never,
        ..Default::default()
    };
    let accel = Accel::build(&[soup.input()], &[flat, point, nan, identity()], &options).unwrap();
    accel.validate().unwrap();
    let stats = accel.stats();
    assert_eq!((stats.flattened, stats.placed), (3, 1));
    assert_eq!(
        (stats.dropped_degenerate, stats.dropped_invalid),
        (100, 100)
    );
    let hit = accel.closest(
        &Ray::new(Vec3::new(0.0, 0.0, 9.0), Vec3::new(0.01, 0.02, -1.0)),
        &NoFilter,
    );
    assert!(hit.is_some());
}
