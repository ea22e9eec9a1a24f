//! Keys, digests and the law of cluster answers.

use super::digest::{Digest, mix};
use super::key::{BoundingSphere, Cell, Grids, LightKey, equal_area_square};
use super::table::{BlockTable, BlockWord, Memory, WordTable};
use super::{Decisions, ErrorReach, Quantized, QuantizedSettings, Refine};
use crate::{Endpoint, Epoch, LightEnd, Query, Ray, Visibility};
use glam::{Vec2, Vec3};
use std::collections::{HashMap, HashSet};

fn grids() -> Grids {
    let bounds = BoundingSphere {
        centre: Vec3::new(1.0, 2.0, 3.0),
        radius: 10.0,
    };
    Grids::new(bounds, 8, 8.0, 1.2)
}

struct Random(Decisions);

impl Random {
    fn new(state: u64) -> Self {
        Self(Decisions { salt: 0, state })
    }

    /// Uniform in [0, 1).
    fn next(&mut self) -> f32 {
        (self.0.random() >> 40) as f32 / (1 << 24) as f32
    }

    fn unit(&mut self) -> Vec3 {
        let z = 2.0 * self.next() - 1.0;
        let (sin, cos) = (std::f32::consts::TAU * self.next()).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vec3::new(r * cos, r * sin, z)
    }
}

/// Eq. 4, corrected: walls along an axis keep that axis, noise in their normals does not split them, and every normal is
/// near its grid's axis.
#[test]
fn orientations_follow_normals() {
    let grids = grids();
    let mut random = Random::new(1);
    for axis in [
        Vec3::X,
        Vec3::Y,
        Vec3::Z,
        Vec3::NEG_X,
        Vec3::NEG_Y,
        Vec3::NEG_Z,
    ] {
        let orientation = grids.orientation(axis).unwrap();
        for _ in 0..100 {
            let noisy = (axis + random.unit() * 1e-6).normalize();
            assert_eq!(grids.orientation(noisy), Some(orientation));
        }
        // Moving along the wall never changes the voxel's height.
        let heights: HashSet<i64> = (0..1000)
            .map(|_| {
                let along = random.unit() * 5.0;
                let on_wall = along - axis * along.dot(axis);
                grids.cell(on_wall, orientation, 500).voxel[2]
            })
            .collect();
        assert_eq!(heights.len(), 1);
    }
    for _ in 0..10_000 {
        let normal = random.unit();
        let orientation = grids.orientation(normal).unwrap();
        // Half a step on each axis: 1/8 * sqrt(3), before normalising.
        let cell = grids.cell(grids_centre() + normal, orientation, 1 << 20);
        let height = cell.voxel[2] as f32 / 8.0 / (1 << 20) as f32 * 20.0;
        assert!(height > 0.96, "{height}");
    }
    for broken in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e-3)] {
        assert_eq!(grids.orientation(broken), None);
    }
}

fn grids_centre() -> Vec3 {
    Vec3::new(1.0, 2.0, 3.0)
}

/// Voxels have the size that the resolution says, and their faces are not the round coordinates.
#[test]
fn voxels_have_their_size() {
    let grids = grids();
    let up = grids.orientation(Vec3::Y).unwrap();
    let resolution = grids.quantize(100.0);
    assert!((90..=110).contains(&resolution));
    let voxels: HashSet<[i64; 3]> = (0..400 * 400)
        .map(|i| {
            let place = Vec3::new((i % 400) as f32, 0.0, (i / 400) as f32) * 0.01;
            grids.cell(place, up, resolution).voxel
        })
        .collect();
    let side = 4.0 * resolution as f32 / 20.0;
    let expected = side * side;
    assert!((voxels.len() as f32) < 1.15 * expected && voxels.len() as f32 > 0.95 * expected);
    // A floor at a round height with rounding noise lies in one layer.
    let layers: HashSet<i64> = [-1e-6, 0.0, 1e-6]
        .iter()
        .flat_map(|noise| (0..50).map(move |r| (noise, r)))
        .map(|(noise, r)| {
            let resolution = grids.quantize(1.2f32.powi(r));
            let a = grids.cell(Vec3::new(0.3, 2.0, 0.1), up, resolution).voxel[2];
            let b = grids
                .cell(Vec3::new(0.3, 2.0 + noise, 0.1), up, resolution)
                .voxel[2];
            a - b
        })
        .collect();
    assert_eq!(layers, HashSet::from([0]));
}

/// The middle of a cell lies in it, and a resolution's neighbours are one step away.
#[test]
fn middles_lie_in_their_cells() {
    let grids = grids();
    let mut random = Random::new(8);
    for _ in 0..1000 {
        let orientation = grids.orientation(random.unit()).unwrap();
        let resolution = grids.quantize(8.0 * 100f32.powf(random.next()));
        let cell = grids.cell(random.unit() * 5.0, orientation, resolution);
        let middle = grids.middle(&cell);
        assert_eq!(grids.cell(middle, orientation, resolution), cell);
        let [coarser, finer] = grids.beside(resolution);
        assert!(coarser < resolution && resolution < finer, "{resolution}");
        for ratio in [
            resolution as f32 / coarser as f32,
            finer as f32 / resolution as f32,
        ] {
            assert!((1.05..1.4).contains(&ratio), "{resolution}");
        }
    }
}

/// Eq. 8: few resolutions, each within its step; extremes end at the ends.
#[test]
fn resolutions_are_powers() {
    let grids = grids();
    let mut random = Random::new(2);
    let mut seen = HashSet::new();
    for _ in 0..10_000 {
        let resolution = 8.0 * 1000f32.powf(random.next());
        let quantized = grids.quantize(resolution);
        seen.insert(quantized);
        let ratio = quantized as f32 / resolution;
        assert!((0.8..1.1).contains(&ratio), "{resolution} to {quantized}");
    }
    assert!(seen.len() <= 40);
    assert_eq!(grids.quantize(0.0), 1);
    assert_eq!(grids.quantize(1e-20), 1);
    assert!(grids.quantize(1e30) <= 10_000_000);
}

/// The map of directions: cells of equal size (chi-square), neighbours stay neighbours, poles and axes are safe.
#[test]
fn sky_cells_are_of_equal_size() {
    const SIDE: usize = 16;
    let mut random = Random::new(3);
    let mut counts = vec![0.0; SIDE * SIDE];
    let n = 400_000;
    for _ in 0..n {
        let place = equal_area_square(random.unit());
        assert!(place.cmpge(Vec2::ZERO).all() && place.cmple(Vec2::ONE).all());
        let cell = (place * SIDE as f32)
            .min(Vec2::splat(SIDE as f32 - 1.0))
            .as_uvec2();
        counts[cell.y as usize * SIDE + cell.x as usize] += 1.0;
    }
    let expected = n as f64 / (SIDE * SIDE) as f64;
    let chi2: f64 = counts
        .iter()
        .map(|c: &f64| (c - expected).powi(2) / expected)
        .sum();
    // 255 degrees of freedom: mean 255, deviation 22.6; five deviations.
    assert!(chi2 < 368.0, "{chi2}");
    for axis in [
        Vec3::X,
        Vec3::Y,
        Vec3::Z,
        Vec3::NEG_X,
        Vec3::NEG_Y,
        Vec3::NEG_Z,
    ] {
        assert!(equal_area_square(axis).is_finite());
    }
}

/// Eq. 9, corrected: of `n` uniform directions one falls into a cell on average.
#[test]
fn a_sky_cell_holds_one_sample() {
    let grids = grids();
    let mut random = Random::new(4);
    for n in [64, 256, 4096] {
        let density = n as f32 / (4.0 * std::f32::consts::PI);
        let cells: HashSet<_> = (0..n)
            .map(|_| grids.solid_angle(random.unit(), density).half())
            .collect();
        // n balls in n urns leave 1/e of them empty.
        let share = cells.len() as f32 / n as f32;
        assert!((0.5..0.75).contains(&share), "{n}: {share}");
    }
}

/// Realistic keys: voxels of one surface seen from many places, against lights that differ in few bits.
fn keys(count: usize) -> impl Iterator<Item = (Cell, LightKey)> {
    (0..count).map(|i| {
        let cell = Cell {
            orientation: 400 + (i >> 16 & 1) as u32,
            resolution: 310,
            voxel: [
                (i & 63) as i64 - 32,
                (i >> 6 & 63) as i64 - 32,
                (i >> 12 & 15) as i64 - 8,
            ],
        };
        let light = ((i >> 17) as f32 * 0.125 + 1.0).to_bits();
        (cell, LightKey::Point([light, 2f32.to_bits(), 0]))
    })
}

/// Keys never collide whole; either half of the digest collides as often as random numbers do. The paper's first digest is
/// known to collide more: its places are checked against a loose bound.
#[test]
fn digests_meet_the_birthday_bound() {
    const COUNT: usize = 1 << 20;
    for digest in [Digest::Separable, Digest::LcgXorshift, Digest::Lcg] {
        let all: Vec<u64> = keys(COUNT)
            .map(|(eye, light)| digest.pair(&eye, &light, 5))
            .collect();
        let collisions = |part: &dyn Fn(u64) -> u64| {
            let distinct: HashSet<u64> = all.iter().map(|&digest| part(digest)).collect();
            COUNT - distinct.len()
        };
        let whole = collisions(&|d| d);
        let [place, tag] = [collisions(&|d| d >> 32), collisions(&|d| d & 0x7fff_ffff)];
        println!("{digest:?}: {whole} whole, {place} places, {tag} tags");
        // n^2 / 2^33 = 128 and n^2 / 2^32 = 256 on average, five deviations above.
        if digest == Digest::Lcg {
            assert!(place < COUNT / 8, "{place}");
        } else {
            assert_eq!(whole, 0);
            assert!(place < 128 + 57 && tag < 256 + 80, "{place} {tag}");
        }
    }
}

/// Other kinds of end, epochs and single integers all change the digest.
#[test]
fn digests_tell_kinds_and_epochs_apart() {
    let grids = grids();
    let orientation = grids.orientation(Vec3::Y).unwrap();
    let eye = grids.cell(Vec3::ZERO, orientation, 100);
    let bits = [0, 0, 0];
    let lights = [
        LightKey::Point(bits),
        LightKey::Direction(bits),
        LightKey::Surface(eye),
        LightKey::SolidAngle {
            cell: [0, 0],
            resolution: 0,
        },
    ];
    for digest in [Digest::Separable, Digest::LcgXorshift, Digest::Lcg] {
        let mut seen = HashSet::new();
        for light in &lights {
            for salt in 0..4 {
                for neighbour in eye.neighbours() {
                    assert!(
                        seen.insert(digest.pair(&neighbour, light, salt)),
                        "{digest:?}"
                    );
                }
            }
        }
    }
    // The halves of mirrored voxels differ: signs are part of the key.
    let mut halves = HashSet::new();
    for x in -40..40 {
        for y in -40..40 {
            for z in -2..2 {
                let voxel = [x, y, z];
                assert!(halves.insert(Cell { voxel, ..eye }.half()));
            }
        }
    }
}

/// Eq. 12: without refinement and asked in random order, a cluster answers 1 as often as its pairs see each other. z-tests
/// of some 60 clusters, false alarm once in 10,000 runs.
#[test]
fn clusters_answer_with_their_mean_visibility() {
    const RUNS: usize = 400;
    let tracer = |ray: &Ray| ray.at(0.5).x > 0.013;
    let light = Vec3::new(0.0, 1.0, 0.0);
    let settings = QuantizedSettings {
        error: ErrorReach::all(9.0),
        refine: Refine::Levels(1),
        ..Default::default()
    };
    let bounds = BoundingSphere {
        centre: Vec3::ZERO,
        radius: 1.5,
    };
    let strategy = Quantized::new(settings, bounds).unwrap();
    let mut queries: Vec<Query> = (0..64 * 64)
        .map(|i| {
            let eye = Vec3::new(
                (i % 64) as f32 / 32.0 - 1.0,
                -1.0,
                (i / 64) as f32 / 32.0 - 1.0,
            );
            let end = Endpoint::new(eye, Vec3::Y, 1024.0);
            Query::new(end, LightEnd::Point(light), Ray::between(eye, light))
        })
        .collect();
    let cluster = |query: &Query| {
        let clustered = strategy.cluster(query, Epoch::default()).unwrap();
        strategy.eye_cell(&clustered, 0).half()
    };
    // Cluster: pairs, pairs that see each other, runs that answered 1.
    let mut clusters: HashMap<u64, [u32; 3]> = HashMap::new();
    for query in &queries {
        let counts = clusters.entry(cluster(query)).or_default();
        counts[0] += 1;
        counts[1] += u32::from(!tracer(&query.ray));
    }
    let mut random = Random::new(9);
    for run in 0..RUNS {
        for i in (1..queries.len()).rev() {
            queries.swap(i, (random.next() * (i + 1) as f32) as usize);
        }
        let mut worker = Visibility::<fn(&Ray) -> bool>::worker(&strategy);
        let epoch = Epoch {
            pass: run as u32,
            ..Epoch::default()
        };
        Visibility::<fn(&Ray) -> bool>::begin(&strategy, &mut worker, epoch);
        let mut answers = vec![0.0; queries.len()];
        strategy.answer(&tracer, &mut worker, &queries, &mut answers);
        let mut answered: HashMap<u64, f32> = HashMap::new();
        for (query, &answer) in queries.iter().zip(&answers) {
            let first = *answered.entry(cluster(query)).or_insert(answer);
            assert_eq!(first, answer, "a cluster has one answer");
        }
        for (key, answer) in answered {
            clusters.get_mut(&key).unwrap()[2] += answer as u32;
        }
    }
    let mut mixed = 0;
    for [pairs, seen, answered] in clusters.into_values() {
        let mean = f64::from(seen) / f64::from(pairs);
        let found = f64::from(answered) / RUNS as f64;
        let deviation = (mean * (1.0 - mean) / RUNS as f64).sqrt();
        mixed += u32::from(deviation > 0.0);
        assert!(
            (found - mean).abs() <= 4.8 * deviation,
            "{found} instead of {mean}"
        );
    }
    assert!(mixed > 4, "{mixed}");
}

/// What is shown of a question's patches: neighbours share them, refinement splits them, and equal digests are equal pairs.
#[test]
fn patches_can_be_looked_at() {
    let strategy = Quantized::new(
        QuantizedSettings::default(),
        BoundingSphere {
            centre: Vec3::ZERO,
            radius: 2.0,
        },
    )
    .unwrap();
    let light = Vec3::new(0.0, 1.0, 0.0);
    let distinct = |level: u32| {
        let pairs: HashSet<_> = (0..64 * 64)
            .map(|i| {
                let eye = Vec3::new((i % 64) as f32, -32.0, (i / 64) as f32) / 32.0 - Vec3::X;
                let end = Endpoint::new(eye, Vec3::Y, 1024.0);
                let query = Query::new(end, LightEnd::Point(light), Ray::between(eye, light));
                strategy.patches(&query, Epoch::default(), level).unwrap()
            })
            .collect();
        let digests: HashSet<u64> = pairs.iter().map(|pair| pair.digest).collect();
        assert_eq!(digests.len(), pairs.len());
        pairs.len()
    };
    // 4096 samples, C_E = 4: about 16 of them a patch, then about 4.
    let (coarse, fine) = (distinct(0), distinct(1));
    assert!((150..500).contains(&coarse), "{coarse}");
    assert!((600..2000).contains(&fine), "{fine}");
    let end = Endpoint::new(Vec3::ZERO, Vec3::Y, f32::INFINITY);
    let query = Query::new(end, LightEnd::Point(light), Ray::between(Vec3::ZERO, light));
    assert_eq!(strategy.patches(&query, Epoch::default(), 0), None);
}

/// Many threads that overwrite each other in a tiny table: whoever finds an answer finds the right one, as if words could not tear and
/// tags never lied. (Loads and stores of whole words without order are all that tables do.)
#[test]
fn racing_threads_never_read_wrong_answers() {
    const PAIRS: u64 = 2000;
    const WORDS: usize = 256;
    let digest = |pair: u64| mix(1, pair);
    let visible = |pair: u64| mix(2, pair) & 1 != 0;
    let block = |pair: u64| {
        let known = mix(3, pair) as u16;
        BlockWord {
            known,
            visible: known & mix(4, pair) as u16,
        }
    };
    // No two of these pairs share a place and a tag, so nothing excuses a wrong answer.
    let name = |pair| ((digest(pair) >> 32) % WORDS as u64) | (digest(pair) & 0x3fff_ffff) << 8;
    let mut names: Vec<u64> = (0..PAIRS).map(name).collect();
    names.sort_unstable();
    assert!(names.windows(2).all(|two| two[0] != two[1]));

    let words = WordTable::new(4 * WORDS);
    let blocks = BlockTable::new(8 * WORDS);
    let found: u64 = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..8u64)
            .map(|thread| {
                let (words, blocks) = (&words, &blocks);
                scope.spawn(move || {
                    let mut found = 0;
                    for step in 0..200_000 {
                        let random = mix(thread + 5, step);
                        let pair = random % PAIRS;
                        if random >> 32 & 1 == 0 {
                            let memory = Memory {
                                visible: visible(pair),
                                contested: false,
                            };
                            words.put(digest(pair), memory);
                            blocks.put(digest(pair), block(pair));
                            continue;
                        }
                        if let Some(memory) = words.get(digest(pair)) {
                            assert_eq!(memory.visible, visible(pair));
                            found += 1;
                        }
                        let answers = blocks.get(digest(pair));
                        assert!(answers == block(pair) || answers == BlockWord::default());
                    }
                    found
                })
            })
            .collect();
        threads.into_iter().map(|t| t.join().unwrap()).sum()
    });
    // An eighth of the pairs fits; half of the steps look.
    assert!(found > 20_000, "{found}");
}
