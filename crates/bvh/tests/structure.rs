//! Degenerate input, threads, filters, batches, refits and leaks.

mod common;

use common::*;
use glam::{Affine3A, Vec3, Vec3A};
use occlude_bvh::{
    Accel, BuildError, BuildOptions, InstanceInput, MeshInput, NoFilter, RefitError,
};
use occlude_visibility::{Hit, Ray};

const PLAIN: BuildOptions = BuildOptions {
    flatten: occlude_bvh::Flatten::Auto,
    watertight: false,
    keep_degenerate: false,
    whole_triangles: false,
};

#[test]
fn bad_triangles_are_dropped_and_counted() {
    let mut random = Random(11);
    let clean = Soup::random(&mut random, 400, 1.0);
    let mut soup = clean.clone();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -3e38] {
        for corner in 0..3 {
            let mut corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
            corners[corner].y = value;
            soup.push(corners);
        }
    }
    soup.push([Vec3::ONE; 3]);
    soup.push([Vec3::ZERO, Vec3::ONE, Vec3::splat(2.0)]);
    soup.push([Vec3::X, Vec3::X, Vec3::Y]);
    let accel = soup.accel(&PLAIN);
    let stats = accel.stats();
    assert_eq!(
        (
            stats.triangles,
            stats.dropped_invalid,
            stats.dropped_degenerate
        ),
        (400, 15, 3)
    );
    let reference = clean.accel(&PLAIN);
    for ray in rays(&mut random, 500) {
        assert_eq!(
            accel.closest(&ray, &NoFilter),
            reference.closest(&ray, &NoFilter)
        );
    }
    let keep = BuildOptions {
        keep_degenerate: true,
        ..PLAIN
    };
    assert_eq!(soup.accel(&keep).stats().triangles, 403);
}

#[test]
fn a_million_coincident_triangles() {
    let soup = Soup {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
        triangles: vec![[0, 1, 2]; 1_000_000],
        filtered: false,
    };
    let accel = soup.accel(&PLAIN);
    let ray = Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z);
    assert_eq!(accel.closest(&ray, &NoFilter).map(|h| h.t), Some(1.0));
    assert!(accel.occluded(&ray, &NoFilter));
    assert!(
        !accel.occluded(&Ray { t_max: 1.0, ..ray }, &NoFilter),
        "the end is open"
    );
    assert!(
        !accel.occluded(&Ray { t_min: 1.0, ..ray }, &NoFilter),
        "the start is open"
    );
}

#[test]
fn sizes_that_halve_do_not_make_the_tree_too_deep() {
    let mut soup = Soup::default();
    for k in 0..1000 {
        // Nested triangles: each split peels off one.
        let s = 0.5f32.powi(k % 120) * (1.0 + k as f32 * 1e-4);
        soup.push([
            Vec3::new(s, 0.0, s),
            Vec3::new(2.0 * s, s, 0.0),
            Vec3::new(s, s, s),
        ]);
    }
    let accel = soup.accel(&PLAIN);
    assert!(accel.stats().depth <= 96);
    assert!(accel.occluded(&Ray::new(Vec3::new(1.3, 0.6, 9.0), Vec3::NEG_Z), &NoFilter));
}

#[test]
fn wrong_indices_are_errors() {
    let positions = [Vec3::ZERO; 3];
    let mesh = MeshInput {
        positions: &positions,
        triangles: &[[0, 1, 3]],
        filtered: false,
    };
    let error = Accel::build(&[mesh], &[identity()], &PLAIN).unwrap_err();
    assert!(matches!(
        error,
        BuildError::NoSuchVertex {
            mesh: 0,
            triangle: 0,
            vertex: 3,
            vertices: 3
        }
    ));
    let error = Accel::build(&[], &[identity()], &PLAIN).unwrap_err();
    assert!(matches!(
        error,
        BuildError::NoSuchMesh {
            instance: 0,
            mesh: 0,
            meshes: 0
        }
    ));
}

#[test]
fn one_thread_and_many_build_the_same() {
    let mut random = Random(12);
    let soup = Soup::random(&mut random, 200_000, 0.3);
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| soup.accel(&PLAIN))
    };
    let (one, many) = (build(1), build(5));
    assert_eq!(one.digest(), many.digest());
    let mut other = soup.clone();
    other.positions[0].x += 1e-3;
    assert_ne!(one.digest(), other.accel(&PLAIN).digest());
}

#[test]
fn filters_decide_for_filtered_meshes_alone() {
    let mut random = Random(13);
    let mut soups = [
        Soup::random(&mut random, 300, 1.0),
        Soup::random(&mut random, 300, 1.0),
    ];
    soups[1].filtered = true;
    let inputs: Vec<_> = soups.iter().map(Soup::input).collect();
    let instances = [0, 1].map(|mesh| InstanceInput {
        mesh,
        world_from_object: Affine3A::IDENTITY,
    });
    let odd = |_: &Ray, hit: &Hit| {
        assert_eq!(hit.instance, 1, "only filtered meshes are asked about");
        hit.primitive % 2 == 1
    };
    for flatten in [occlude_bvh::Flatten::Always, occlude_bvh::Flatten::Never] {
        let options = BuildOptions { flatten, ..PLAIN };
        let accel = Accel::build(&inputs, &instances, &options).unwrap();
        // What is left after the filter, as a scene of its own.
        let mut left = soups[0].clone();
        for k in (1..300).step_by(2) {
            left.push(soups[1].corners(k));
        }
        let reference = left.accel(&PLAIN);
        for accel in each_simd(&accel) {
            for ray in rays(&mut random, 800) {
                let (a, b) = (
                    accel.closest(&ray, &odd),
                    reference.closest(&ray, &NoFilter),
                );
                assert_eq!(a.is_some(), b.is_some(), "{ray:?}");
                if let (Some(a), Some(b)) = (a, b) {
                    assert!((a.t - b.t).abs() <= 1e-5 * b.t, "{a:?} {b:?}");
                }
                assert_eq!(accel.occluded(&ray, &odd), b.is_some());
                if let Some(blocker) = accel.blocker(&ray, &odd) {
                    assert!(accel.blocks(blocker, &ray, &odd));
                }
            }
        }
    }
}

#[test]
fn batches_answer_as_single_rays() {
    let mut random = Random(14);
    let accel = Soup::random(&mut random, 2000, 0.5).accel(&PLAIN);
    let light = Vec3::new(0.5, 2.0, 0.3);
    for accel in each_simd(&accel) {
        for count in [0, 1, 7, 16, 1001] {
            let mut rays = rays(&mut random, count);
            rays.extend((0..count).map(|_| Ray::between(random.point(), light)));
            let (mut occluded, mut hits) = (vec![false; rays.len()], vec![None; rays.len()]);
            accel.occluded_batch(&rays, &mut occluded, &NoFilter);
            accel.closest_batch(&rays, &mut hits, &NoFilter);
            for (k, ray) in rays.iter().enumerate() {
                assert_eq!(occluded[k], accel.occluded(ray, &NoFilter));
                assert_eq!(hits[k], accel.closest(ray, &NoFilter));
            }
        }
    }
}

#[test]
fn a_refit_answers_as_a_new_build() {
    let mut random = Random(15);
    let soup = Soup::random(&mut random, 2000, 0.5);
    let instances: Vec<InstanceInput> = (0..3)
        .map(|_| InstanceInput {
            mesh: 0,
            world_from_object: transform(&mut random),
        })
        .collect();
    let moved = soup
        .clone()
        .map(|p| p + Vec3::new(p.y * 0.7, (3.0 * p.x).sin() * 0.4, -p.z));
    let later: Vec<InstanceInput> = (0..3)
        .map(|_| InstanceInput {
            mesh: 0,
            world_from_object: transform(&mut random),
        })
        .collect();
    for flatten in [occlude_bvh::Flatten::Always, occlude_bvh::Flatten::Never] {
        for (watertight, whole_triangles) in
            [(false, false), (true, false), (false, true), (true, true)]
        {
            let options = BuildOptions {
                flatten,
                watertight,
                whole_triangles,
                ..PLAIN
            };
            let mut refitted = Accel::build(&[soup.input()], &instances, &options).unwrap();
            let before = refitted.digest();
            refitted.refit(&[moved.input()], &later).unwrap();
            refitted.validate().unwrap();
            let built = Accel::build(&[moved.input()], &later, &options).unwrap();
            let mut hits = 0;
            let mut all = rays(&mut random, 700);
            for instance in &later {
                let place = |p: Vec3| instance.world_from_object.transform_point3(p);
                all.extend(aimed(&mut random, &moved.clone().map(place), 100));
            }
            for ray in all {
                let (a, b) = (
                    refitted.closest(&ray, &NoFilter),
                    built.closest(&ray, &NoFilter),
                );
                // Of two triangles within the rounding of a distance, trees of different shapes may find either.
                match (a, b) {
                    (Some(a), Some(b)) => {
                        assert!((a.t - b.t).abs() <= 1e-6 * b.t, "{ray:?} {a:?} {b:?}")
                    }
                    (a, b) => assert_eq!(a, b, "{ray:?}"),
                }
                hits += usize::from(a.is_some());
            }
            assert!(hits > 100);
            assert!(refitted.stats().cost >= built.stats().cost * 0.99);
            refitted.refit(&[soup.input()], &instances).unwrap();
            refitted.validate().unwrap();
            if whole_triangles {
                assert_eq!(refitted.digest(), before, "there and back");
            }
            let before = refitted.digest();
            let other = Soup::random(&mut random, 1999, 0.5);
            let error = refitted.refit(&[other.input()], &instances).unwrap_err();
            assert!(matches!(error, RefitError::Topology { .. }));
            assert_eq!(refitted.digest(), before, "an error changes nothing");
        }
    }
}

#[test]
fn the_watertight_test_has_no_leaks() {
    let mut random = Random(16);
    for scale in [1e-4f32, 1.0, 1e4] {
        let soup = Soup::sphere(24, 32).map(|p| p * scale);
        let accel = soup.accel(&watertight());
        for accel in each_simd(&accel) {
            for k in 0..20_000 {
                // From inside, exactly at vertices and edges as well as anywhere.
                let origin = random.point() * (0.3 * scale);
                let [a, b, _] = soup.corners(random.below(soup.triangles.len()));
                let target = match k % 3 {
                    0 => a,
                    1 => a + (b - a) * random.unit(),
                    _ => random.direction() * scale,
                };
                let ray = Ray::new(origin, target - origin);
                assert!(accel.closest(&ray, &NoFilter).is_some(), "{ray:?}");
                assert!(accel.occluded(&ray, &NoFilter), "{ray:?}");
            }
        }
    }
}

/// Long diagonal slivers, whose boxes are mostly empty, among small triangles.
fn grass(random: &mut Random, count: usize) -> Soup {
    let mut soup = Soup::random(random, count - count / 50, 0.05);
    for _ in 0..count / 50 {
        let (a, d) = (random.point(), random.direction());
        soup.push([a, a + d, a + d * 0.5 + random.point() * 0.02]);
    }
    soup
}

#[test]
fn cut_triangles_answer_as_whole_ones() {
    let mut random = Random(18);
    for watertight in [false, true] {
        let cut = BuildOptions {
            watertight,
            ..PLAIN
        };
        let whole = BuildOptions {
            whole_triangles: true,
            ..cut
        };
        for scale in [1e-5f32, 1.0, 1e5] {
            let offset = Vec3::new(3.0, -7.0, 0.1) * scale;
            let soup = grass(&mut random, 3000).map(|p| p * scale + offset);
            let (cut, mut whole) = (soup.accel(&cut), soup.accel(&whole));
            let (a, b) = (cut.stats(), whole.stats());
            assert_eq!((a.triangles, b.triangles, b.references), (3000, 3000, 3000));
            assert!(a.references > 3030 && a.references <= 3600, "{a:?}");
            assert!(a.cost < 0.99 * b.cost, "{a:?} {b:?}");
            let (mut hits, mut differ) = (0, 0);
            for cut in each_simd(&cut) {
                assert!(whole.set_simd(cut.simd()));
                let mut all = rays(&mut random, 600);
                for ray in &mut all {
                    ray.origin = ray.origin * scale + offset;
                    ray.direction *= scale;
                }
                all.extend(aimed(&mut random, &soup, 600));
                for ray in all {
                    let (a, b) = (cut.closest(&ray, &NoFilter), whole.closest(&ray, &NoFilter));
                    hits += usize::from(a.is_some());
                    differ += usize::from(a.map(|h| h.t) != b.map(|h| h.t));
                    assert_eq!(cut.occluded(&ray, &NoFilter), a.is_some());
                }
            }
            assert!(hits > 300 && differ == 0, "{hits} hits, {differ} differ");
        }
    }
}

#[test]
fn another_tracer_agrees() {
    use obvhs::{BvhBuildParams, ray::Ray as OtherRay, triangle::Triangle};
    let mut random = Random(17);
    let soup = Soup::random(&mut random, 3000, 0.7);
    let triangles: Vec<Triangle> = (0..soup.triangles.len())
        .map(|k| {
            let [v0, v1, v2] = soup.corners(k).map(Vec3A::from);
            Triangle { v0, v1, v2 }
        })
        .collect();
    let params = BvhBuildParams::medium_build();
    let other =
        obvhs::bvh2::builder::build_bvh2_from_tris(&triangles, params, &mut Default::default());
    let accel = soup.accel(&PLAIN);
    let (mut hits, mut differ) = (0, 0);
    for _ in 0..4000 {
        let ray = Ray::new(random.point() * 2.0, random.direction());
        let other_ray = OtherRay::new_inf(ray.origin.into(), ray.direction.into());
        let mut nearest = f32::INFINITY;
        let mut hit = obvhs::ray::RayHit::none();
        other.ray_traverse(other_ray, &mut hit, |r, id| {
            let t = triangles[other.primitive_indices[id] as usize].intersect(r);
            nearest = nearest.min(t);
            t
        });
        match accel.closest(&ray, &NoFilter) {
            Some(h) if (h.t - nearest).abs() <= 1e-4 * h.t => hits += 1,
            None if nearest == f32::INFINITY => {}
            _ => differ += 1,
        }
    }
    assert!(hits > 500 && differ <= 2, "{hits} hits, {differ} differ");
}

#[test]
fn boxes_hold_everything_and_get_smaller() {
    let mut random = Random(21);
    let soup = Soup::random(&mut random, 3000, 0.1);
    let placed = InstanceInput {
        mesh: 0,
        world_from_object: transform(&mut random),
    };
    let apart = BuildOptions {
        flatten: occlude_bvh::Flatten::Never,
        ..PLAIN
    };
    for (instance, options) in [(identity(), PLAIN), (placed, apart)] {
        let accel = Accel::build(&[soup.input()], &[instance], &options).unwrap();
        let mut before = f32::INFINITY;
        for most in [0, 1, 8, 64, 100_000] {
            let boxes = accel.boxes(most);
            assert!((1..=most.max(1)).contains(&boxes.len()), "{most}");
            for &position in &soup.positions {
                let p = instance.world_from_object.transform_point3(position);
                let slack = 1e-5 * p.abs().max_element();
                let holds = |&(lower, upper): &(Vec3, Vec3)| {
                    p.cmpge(lower - slack).all() && p.cmple(upper + slack).all()
                };
                assert!(boxes.iter().any(holds), "{most}: {p} in no box");
            }
            let volume: f32 = (boxes.iter())
                .map(|(lower, upper)| (*upper - *lower).element_product())
                .sum();
            assert!(volume <= before * 1.5, "{most}: {volume} after {before}");
            before = volume;
        }
    }
    assert!(Soup::default().accel(&PLAIN).boxes(8).is_empty());
}
