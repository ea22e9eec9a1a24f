//! Records in a world of boxes, against rays.

use super::cache::Random;
use super::*;
use crate::{Endpoint, EveryLight, Ray, Reason, Session, Tracer};
use glam::Vec3;

/// Solid boxes.
struct Boxes(Vec<[Vec3; 2]>);

impl Boxes {
    /// A room with a table, a pillar and a thin wall with a gap.
    fn room() -> Self {
        let slab = |low: [f32; 3], high: [f32; 3]| [Vec3::from(low), Vec3::from(high)];
        Self(vec![
            slab([-4.1, -0.1, -4.1], [4.1, 0.0, 4.1]),
            slab([-4.1, 3.0, -4.1], [4.1, 3.1, 4.1]),
            slab([-4.1, -0.1, -4.1], [-4.0, 3.1, 4.1]),
            slab([4.0, -0.1, -4.1], [4.1, 3.1, 4.1]),
            slab([-4.1, -0.1, -4.1], [4.1, 3.1, -4.0]),
            slab([-4.1, -0.1, 4.0], [4.1, 3.1, 4.1]),
            slab([-1.0, 0.7, -2.5], [1.0, 0.8, -1.5]),
            slab([1.8, 0.0, 1.0], [2.2, 3.0, 1.4]),
            slab([-4.0, 0.0, 0.0], [1.0, 3.0, 0.02]),
        ])
    }

    fn nearest(&self, ray: &Ray) -> Option<(f32, Vec3)> {
        let mut best: Option<(f32, Vec3)> = None;
        for [low, high] in &self.0 {
            let (a, b) = (
                (*low - ray.origin) / ray.direction,
                (*high - ray.origin) / ray.direction,
            );
            let (near, far) = (a.min(b), a.max(b));
            let enter = near.max_element();
            if enter > ray.t_min.max(0.0) && enter <= far.min_element() && enter < ray.t_max {
                let axis = (0..3).max_by(|&i, &j| near[i].total_cmp(&near[j])).unwrap();
                let mut normal = Vec3::ZERO;
                normal[axis] = -ray.direction[axis].signum();
                if best.is_none_or(|(t, _)| enter < t) {
                    best = Some((enter, normal));
                }
            }
        }
        best
    }
}

impl Tracer for Boxes {
    type Blocker = ();
    fn blocker(&self, ray: &Ray) -> Option<()> {
        self.nearest(ray).map(|_| ())
    }
}

impl DistanceTracer for Boxes {
    fn distances(&self, rays: &[Ray], distances: &mut [f32]) {
        for (ray, distance) in rays.iter().zip(distances) {
            *distance = self.nearest(ray).map_or(f32::INFINITY, |(t, _)| t);
        }
    }

    fn surfaces(&self, rays: &[Ray], seen: &mut [Seen]) {
        for (ray, seen) in rays.iter().zip(seen) {
            *seen = self
                .nearest(ray)
                .map_or(Seen::NOTHING, |(distance, normal)| Seen {
                    distance,
                    normal,
                    albedo: Vec3::splat(0.5),
                    trace: false,
                });
        }
    }

    fn sites(&self, rays: &[Ray], sites: &mut [Option<Site>]) {
        for (ray, site) in rays.iter().zip(sites) {
            *site = self.nearest(ray).map(|(t, normal)| at(ray.at(t), normal));
        }
    }
}

fn at(position: Vec3, normal: Vec3) -> Site {
    Site {
        position,
        normal,
        origin: position + normal * 1e-4,
    }
}

/// Diffuse paths of three vertices from a point in the room.
struct Walks<'a>(&'a Boxes, Random);

fn diffuse(random: &mut Random, normal: Vec3) -> Vec3 {
    let (z, turn) = (
        2.0 * random.unit() - 1.0,
        std::f32::consts::TAU * random.unit(),
    );
    let r = (1.0 - z * z).sqrt();
    (normal * 1.001 + Vec3::new(r * turn.cos(), r * turn.sin(), z)).normalize()
}

impl Scout for Walks<'_> {
    fn draw(&mut self, count: usize, sites: &mut Vec<PathSite>) {
        for _ in 0..count / 3 {
            let mut ray = Ray::new(Vec3::new(0.0, 1.5, 3.0), diffuse(&mut self.1, Vec3::NEG_Z));
            for depth in 1..=3 {
                let Some((t, normal)) = self.0.nearest(&ray) else {
                    break;
                };
                let site = at(ray.at(t), normal);
                sites.push(PathSite {
                    site,
                    weight: 1.0 / depth as f32,
                });
                ray = Ray::new(site.origin, diffuse(&mut self.1, normal));
            }
        }
    }
}

fn settings(capacity: u32) -> RecordSettings {
    RecordSettings {
        capacity,
        resolution: 64,
        scene: [Vec3::new(-4.1, -0.1, -4.1), Vec3::new(4.1, 3.1, 4.1)],
        ..RecordSettings::default()
    }
}

fn placed(world: &Boxes, settings: RecordSettings) -> Cache {
    let mut cache = Cache::new(settings).unwrap();
    cache.place_initial(world, &mut Walks(world, Random(7)));
    cache
}

#[test]
fn a_record_sees_what_rays_see_from_its_place() {
    let world = Boxes::room();
    let cache = placed(&world, settings(20));
    assert_eq!(cache.len(), 20);
    let mut random = Random(3);
    let (mut wrong, mut far_off) = (0, 0);
    let count = 20_000;
    for k in 0..count {
        let id = k % 20;
        let site = cache.views()[id as usize].site;
        let direction = diffuse(&mut random, site.normal);
        let Some(seen) = cache.distance_seen(id, direction) else {
            continue;
        };
        let exact = world.nearest(&Ray::new(site.origin, direction)).unwrap().0;
        // Half a diagonal of a texel, on a surface seen at up to 80 degrees.
        let z = direction.dot(site.normal);
        let footprint = 2.0 / 64.0 * (1.0 + z) * exact;
        wrong += u32::from((seen - exact).abs() > 0.72 * footprint * 6.0);
        far_off += u32::from((seen - exact).abs() > 0.2 * exact);
    }
    // The rest are the silhouettes of the table, the pillar and the wall.
    assert!(wrong < count / 20, "{wrong}");
    assert!(far_off < count / 20, "{far_off}");
}

#[test]
fn segments_agree_with_rays_up_to_footprints() {
    let world = Boxes::room();
    let cache = placed(&world, settings(400));
    let mut reader = RecordsReader::default();
    cache.begin_reading(&mut reader);
    let mut random = Random(11);
    let mut sites = Vec::new();
    Walks(&world, Random(12)).draw(3000, &mut sites);
    let (mut error, mut count, mut unknown) = (0.0, 0.0, 0);
    for _ in 0..20_000 {
        let mut pick = || sites[random.next() as usize % sites.len()].site;
        let (a, b) = (pick(), pick());
        let way = b.position - a.position;
        if a.normal.dot(way) <= 0.0 || b.normal.dot(way) >= 0.0 {
            continue;
        }
        let exact = !world.occluded(&Ray::between(a.origin, b.origin));
        let end = SegmentEnd::Surface(b.position, b.normal);
        let nearby = cache.nearby(a.position, a.normal);
        match cache.segment(&mut reader, &nearby, a.position, end, 1.0) {
            Some(answer) => {
                error += (answer - f32::from(u8::from(exact))).abs();
                count += 1.0;
            }
            None => unknown += 1,
        }
    }
    assert!(count > 5000.0 && error / count < 0.065, "{}", error / count);
    // What is nearer than four spacings is left to rays.
    assert!((unknown as f32) < 0.09 * count, "{unknown}");
}

#[test]
fn rays_find_surfaces() {
    let world = Boxes::room();
    for (select, lookup, most) in [
        (Select::Nearest, Lookup::Snap, 0.14),
        (Select::Probable, Lookup::Snap, 0.24),
        (Select::Nearest, Lookup::March, 0.02),
        (Select::Nearest, Lookup::Plane, 0.02),
        (Select::Probable, Lookup::Plane, 0.03),
    ] {
        let cache = placed(
            &world,
            RecordSettings {
                surfaces: true,
                select,
                lookup,
                ..settings(600)
            },
        );
        let mut reader = RecordsReader::default();
        cache.begin_reading(&mut reader);
        let mut random = Random(21);
        let mut sites = Vec::new();
        Walks(&world, Random(22)).draw(9000, &mut sites);
        let (mut wrong, mut count) = (0.0, 0.0);
        for place in &sites {
            let site = place.site;
            let direction = diffuse(&mut random, site.normal);
            let u = random.unit();
            let exact = world.nearest(&Ray::new(site.origin, direction)).unwrap().0;
            let nearby = cache.nearby(site.position, site.normal);
            let aim = cache.aim(&mut reader, &nearby, direction, u, 1.0);
            let Ok(aim) = aim else { continue };
            let answer = cache.look(&aim, cache.fetch(&aim), site.position, direction);
            if let RayAnswer::Surface(surface) = answer {
                count += 1.0;
                let apart = surface.position.distance(site.position + direction * exact);
                wrong += f32::from(u8::from(apart > 0.2 + 0.15 * exact));
                assert!(surface.normal.dot(direction) < 0.0);
            }
        }
        println!("{select:?} {lookup:?}: {} of {count}", wrong / count);
        assert!(count > 0.7 * sites.len() as f32, "{count}");
        assert!(
            wrong / count < most,
            "{select:?} {lookup:?}: {}",
            wrong / count
        );
        cache.end_reading(&mut reader);
    }
}

#[test]
fn refinement_keeps_to_capacity_and_evens_out_importance() {
    let world = Boxes::room();
    let mut cache = placed(&world, settings(150));
    let mut scout = Walks(&world, Random(31));
    let mut sites = Vec::new();
    scout.draw(3000, &mut sites);
    cache.pilot(&sites);
    let (first_mean, first) = cache.importance_spread();
    for _ in 0..4 {
        cache.refine_before(&world, 150, &mut |sites| scout.draw(2000, sites));
        assert!(cache.len() <= 150);
        let report = cache.report();
        assert!(report.bytes <= 150 * cache.settings().record_bytes());
        assert!(report.peak_bytes <= 150 * cache.settings().record_bytes());
    }
    cache.pilot(&sites);
    let (last_mean, last) = cache.importance_spread();
    let report = cache.report();
    assert!(report.steps.placed > 500, "{report:?}");
    assert!(last < first, "{first_mean} {first} -> {last_mean} {last}");
    // What steps keep up to date equals what is computed anew.
    let before = cache.views();
    for id in 0..cache.len() as u32 {
        cache.slots[id as usize].agreement = [f32::NAN; 4];
        cache.correlate(id);
    }
    for (kept, new) in before.iter().zip(cache.views()) {
        assert_eq!(kept.correlation, new.correlation);
    }
}

#[test]
fn cells_know_what_the_tree_knows() {
    let world = Boxes::room();
    let mut cache = placed(&world, settings(100));
    let mut sites = Vec::new();
    Walks(&world, Random(41)).draw(3000, &mut sites);
    let choices = |cache: &Cache| -> Vec<_> {
        let choose = |place: &PathSite| cache.nearby(place.site.position, place.site.normal);
        sites.iter().map(choose).collect()
    };
    let mut placed = 0;
    for _ in 0..20 {
        choices(&cache);
        placed += u32::from(cache.refine(&world));
        // The table is not up to date: everything is looked up in the tree.
        let by_tree = choices(&cache);
        cache.freshen();
        assert_eq!(choices(&cache), by_tree);
    }
    assert!(placed > 10, "{placed}");
}

/// Lights are asked about, and they are not everywhere: records move to them, as Fig. 5 of the paper has it.
#[test]
fn a_still_camera_lowers_the_error() {
    let world = Boxes::room();
    let mut sites = Vec::new();
    Walks(&world, Random(52)).draw(6000, &mut sites);
    let mut lights = sites.clone();
    lights.retain(|light| light.site.position.x < 0.0 && light.site.position.y > 1.0);
    lights.truncate(100);
    let error = |cache: &Cache| {
        let mut reader = RecordsReader::default();
        cache.begin_reading(&mut reader);
        let mut random = Random(51);
        let (mut error, mut count) = (0.0, 0.0);
        for _ in 0..60_000 {
            let a = lights[random.next() as usize % lights.len()].site;
            let b = sites[random.next() as usize % sites.len()].site;
            let way = b.position - a.position;
            if a.normal.dot(way) > 0.0 && b.normal.dot(way) < 0.0 {
                let exact = !world.occluded(&Ray::between(a.origin, b.origin));
                let end = SegmentEnd::Surface(b.position, b.normal);
                let nearby = cache.nearby(a.position, a.normal);
                if let Some(answer) = cache.segment(&mut reader, &nearby, a.position, end, 1.0) {
                    error += f64::from((answer - f32::from(u8::from(exact))).powi(2));
                    count += 1.0;
                }
            }
        }
        error / count
    };
    let mut cache = placed(&world, settings(100));
    let before = error(&cache);
    cache.refine_before(&world, 600, &mut |pilots| pilots.extend(&lights));
    let after = error(&cache);
    assert!(after < 0.7 * before, "{before} -> {after}");
}

#[test]
fn threads_do_not_show() {
    let world = Boxes::room();
    let made = |threads| {
        let mut cache = placed(
            &world,
            RecordSettings {
                threads,
                ..settings(50)
            },
        );
        let mut scout = Walks(&world, Random(61));
        cache.refine_before(&world, 50, &mut |sites| scout.draw(900, sites));
        let maps: Vec<_> = (0..cache.len() as u32)
            .map(|id| cache.map(id).clone())
            .collect();
        (cache.views(), maps)
    };
    let one = made(1);
    for threads in [2, 5] {
        assert!(one == made(threads));
    }
}

#[test]
fn what_moves_is_seen_again() {
    let mut world = Boxes::room();
    let mut cache = placed(&world, settings(80));
    let ball = |low: Vec3, high: Vec3| crate::two_part::Ball {
        centre: 0.5 * (low + high),
        radius: 0.5 * (high - low).length(),
    };
    // The pillar moves.
    let before = ball(world.0[7][0], world.0[7][1]);
    world.0[7] = world.0[7].map(|corner| corner + Vec3::new(-1.0, 0.0, 1.0));
    let now = ball(world.0[7][0], world.0[7][1]);
    cache.moved(&world, &[before], &[now]);
    let refilled = cache.report().refilled;
    assert!(refilled > 0 && refilled < 80, "{refilled}");
    let fresh = |id: u32| {
        let stand = &cache.stands[id as usize];
        super::map::fill(&world, &cache.layout, stand, false, 1)
    };
    for id in 0..cache.len() as u32 {
        assert!(*cache.map(id) == fresh(id), "{id}");
    }
}

#[test]
fn bad_choices_are_refused() {
    let refused = |settings: RecordSettings| Cache::new(settings).unwrap_err().to_string();
    assert!(refused(settings(0)).contains("count=0"));
    assert!(refused(settings(70_000)).contains("count=70000"));
    for resolution in [0, 7, 100, 4096] {
        let settings = RecordSettings {
            resolution,
            ..settings(9)
        };
        assert!(refused(settings).contains("resolution"));
    }
    let limited = RecordSettings {
        memory: Some(100_000),
        ..settings(100)
    };
    let error = refused(limited.clone());
    assert!(error.contains("count=6 is the largest"), "{error}");
    assert!(
        Cache::new(RecordSettings {
            capacity: 6,
            ..limited
        })
        .is_ok()
    );
    for (alpha, near) in [
        (f32::NAN, 0.0),
        (-0.1, 0.0),
        (1.1, 0.0),
        (0.5, -1.0),
        (0.5, f32::NAN),
    ] {
        refused(RecordSettings {
            alpha,
            near,
            ..settings(9)
        });
    }
    refused(RecordSettings {
        scene: [Vec3::ONE, Vec3::ONE],
        ..settings(9)
    });
}

#[test]
fn nothing_to_see_and_nowhere_to_stand() {
    let nothing = Boxes(Vec::new());
    let mut cache = placed(&nothing, settings(9));
    assert!(cache.is_empty());
    assert!(!cache.refine(&nothing));
    let mut reader = RecordsReader::default();
    cache.begin_reading(&mut reader);
    let nearby = cache.nearby(Vec3::ZERO, Vec3::Y);
    assert!(nearby.is_empty());
    let aim = cache.aim(&mut reader, &nearby, Vec3::Y, 0.5, 1.0);
    assert_eq!(aim.unwrap_err(), Reason::NoRecord);
    let end = SegmentEnd::Point(Vec3::Y);
    assert_eq!(
        cache.segment(&mut reader, &nearby, Vec3::ZERO, end, 1.0),
        None
    );

    // A floor under an open sky.
    let floor = Boxes(vec![[
        Vec3::new(-9.0, -1.0, -9.0),
        Vec3::new(9.0, 0.0, 9.0),
    ]]);
    struct Grid(f32);
    impl Scout for Grid {
        fn draw(&mut self, count: usize, sites: &mut Vec<PathSite>) {
            for _ in 0..count {
                self.0 += 1.0;
                let x = Vec3::new((self.0 * 0.618).fract(), 0.0, (self.0 * 0.7548).fract());
                let site = at(
                    x * Vec3::new(8.0, 0.0, 8.0) - Vec3::new(4.0, 0.0, 4.0),
                    Vec3::Y,
                );
                sites.push(PathSite { site, weight: 1.0 });
            }
        }
    }
    let mut cache = Cache::new(settings(30)).unwrap();
    cache.place_initial(&floor, &mut Grid(0.0));
    assert_eq!(cache.len(), 30);
    assert!(cache.views().iter().all(|view| view.correlation == 1.0));
    cache.begin_reading(&mut reader);
    let up = SegmentEnd::Direction(Vec3::new(0.6, 0.8, 0.0));
    let nearby = cache.nearby(Vec3::ZERO, Vec3::Y);
    let seen = cache.segment(&mut reader, &nearby, Vec3::ZERO, up, 1.0);
    assert_eq!(seen, Some(1.0));
}

/// A cache that has been put away in the middle of a pass and taken out again answers and refines as the one that has not.
#[test]
fn what_is_restored_goes_on_as_if_nothing_had_happened() {
    let world = Boxes::room();
    for surfaces in [false, true] {
        let settings = RecordSettings {
            surfaces,
            ..settings(60)
        };
        let mut cache = placed(&world, settings.clone());
        let mut sites = Vec::new();
        Walks(&world, Random(71)).draw(3000, &mut sites);
        let (early, late) = sites.split_at(1500);
        let ask = |cache: &Cache, sites: &[PathSite]| -> Vec<_> {
            let mut reader = RecordsReader::default();
            cache.begin_reading(&mut reader);
            let answers = (sites.iter())
                .map(|place| {
                    let Site {
                        position, normal, ..
                    } = place.site;
                    let nearby = cache.nearby(position, normal);
                    let aim = cache.aim(&mut reader, &nearby, normal, 0.4, place.weight);
                    aim.map(|aim| cache.fetch(&aim))
                })
                .collect();
            cache.end_reading(&mut reader);
            answers
        };
        cache.refine_before(&world, 40, &mut |pilots| pilots.extend(early));
        ask(&cache, early);
        let state = cache.state();
        assert_eq!(state.len(), 32 + 60 * 104);
        let mut other = Cache::new(settings.clone()).unwrap();
        other.restore(&world, &state).unwrap();
        assert!(other.take_restored() && !other.take_restored());
        for _ in 0..3 {
            for cache in [&mut cache, &mut other] {
                ask(cache, late);
                cache.end_pass();
                cache.refine_after(&world, 15);
            }
            assert_eq!(cache.state(), other.state());
            assert_eq!(ask(&cache, &sites), ask(&other, &sites));
        }
        for id in 0..cache.len() as u32 {
            assert!(cache.map(id) == other.map(id), "{id}");
        }

        // Damage is an error, and leaves an empty cache.
        let fresh = || Cache::new(settings.clone()).unwrap();
        for cut in [0, 5, 31, 32, 60, state.len() - 1] {
            let mut cache = fresh();
            assert!(cache.restore(&world, &state[..cut]).is_err() && cache.is_empty());
        }
        for (place, what) in [
            (0, 0x55),
            (24, 0xff),
            (31, 0xff),
            (32 + 23, 0x41),
            (32 + 47, 1),
        ] {
            let mut damaged = state.clone();
            damaged[place] = what;
            assert!(fresh().restore(&world, &damaged).is_err(), "{place}");
        }
        let mut small = Cache::new(RecordSettings {
            capacity: 59,
            ..settings.clone()
        })
        .unwrap();
        assert!(small.restore(&world, &state).is_err());
    }
}

/// Lights where no camera path comes have no records near them at first; steps give them some.
#[test]
fn who_is_not_served_gets_a_record() {
    let world = Boxes::room();
    // Behind the thin wall, high up, and few places of the initial distribution: those near the camera.
    let mut near = Vec::new();
    Walks(&world, Random(81)).draw(6000, &mut near);
    near.retain(|place| place.site.position.z > 2.5 && place.site.position.y < 1.0);
    struct Near(Vec<PathSite>);
    impl Scout for Near {
        fn draw(&mut self, _: usize, sites: &mut Vec<PathSite>) {
            sites.extend(&self.0);
        }
    }
    let mut cache = Cache::new(settings(100)).unwrap();
    cache.place_initial(&world, &mut Near(near));
    assert_eq!(cache.len(), 100);
    let mut lights = Vec::new();
    Walks(&world, Random(82)).draw(9000, &mut lights);
    lights.retain(|place| place.site.position.z < -2.0);
    lights.truncate(200);
    let alone = |cache: &Cache| {
        let served = |light: &&PathSite| {
            let nearby = cache.nearby(light.site.position, light.site.normal);
            !nearby.is_empty()
        };
        lights.len() - lights.iter().filter(served).count()
    };
    assert!(
        lights.len() == 200 && alone(&cache) > 150,
        "{}",
        alone(&cache)
    );
    cache.refine_before(&world, 100, &mut |pilots| pilots.extend(&lights));
    assert!(alone(&cache) < 10, "{}", alone(&cache));
    assert!(cache.len() <= 100 && cache.unserved.is_empty());
}

/// Lights along walls, and points in the room that ask about them.
fn lights_and_eyes(world: &Boxes) -> (Vec<SharedLight>, Vec<EyeSample>) {
    let mut places = Vec::new();
    Walks(world, Random(21)).draw(700, &mut places);
    let end = |place: &PathSite| Endpoint::new(place.site.position, place.site.normal, 1.0);
    let lights = places.iter().take(60).map(|place| SharedLight {
        end: LightEnd::Surface(end(place)),
        target: Some(place.site.origin),
        connections: 64.0,
    });
    let eyes = places.iter().skip(60).map(|place| EyeSample {
        end: end(place),
        origin: place.site.origin,
    });
    (lights.collect(), eyes.collect())
}

/// What records say about all lights and eyes.
fn sights(
    world: &Boxes,
    records: &Records,
    (lights, eyes): &(Vec<SharedLight>, Vec<EyeSample>),
) -> (Vec<f32>, VisibilityStats) {
    let mut sight = vec![0.0; eyes.len() * lights.len()];
    let mut session = Session::new(world, records);
    let mut add = EveryLight(lights.len(), |eye, light, visible| {
        sight[eye * lights.len() + light] = visible;
    });
    session.answer_many(eyes, lights, &mut add);
    (sight, session.stats())
}

/// One record on each light: it is asked alone, nothing is traced, and it errs less often than the records along paths around it.
#[test]
fn records_stand_on_lights_while_there_are_enough() {
    let world = Boxes::room();
    let questions = lights_and_eyes(&world);
    let (lights, eyes) = &questions;
    let wrong = |placement, capacity, resolution, threads| {
        let records = Records::new(RecordSettings {
            placement,
            resolution,
            threads,
            contact: 0.0,
            ..settings(capacity)
        })
        .unwrap();
        records.prepare(&world, lights, &mut Walks(&world, Random(7)));
        let (sight, stats) = sights(&world, &records, &questions);
        let pairs = eyes
            .iter()
            .flat_map(|eye| lights.iter().map(move |light| (eye, light)));
        // Weighted by what light they bring.
        let (mut off, mut sum) = (0.0, 0.0);
        for ((eye, light), &sight) in pairs.zip(&sight) {
            let LightEnd::Surface(there) = light.end else {
                unreachable!("lights lie on surfaces");
            };
            let way = there.position - eye.end.position;
            let cosines = eye.end.normal.dot(way).max(0.0) * there.normal.dot(-way).max(0.0);
            let weight = cosines / way.length_squared();
            let exact = !world.occluded(&light.ray_from(eye.origin));
            off += weight * (sight - f32::from(exact)).abs();
            sum += weight;
        }
        let count = records.cache().len();
        (off / sum, stats, count, sight)
    };
    let (own, stats, count, sight) = wrong(Placement::Lights, 200, 64, 1);
    assert_eq!(count, lights.len());
    // Those alone that lie below a light's horizon.
    assert!(stats.unanswered.too_near == 0 && stats.unanswered.no_record == 0);
    let (along_paths, ..) = wrong(Placement::Paths, 60, 64, 1);
    let (fine, ..) = wrong(Placement::Lights, 200, 256, 1);
    assert!(own < 0.02 && own < 0.5 * along_paths, "{own} {along_paths}");
    // What is left is as wide as texels are.
    assert!(fine < 0.4 * own, "{fine} {own}");
    assert_eq!(wrong(Placement::Lights, 200, 64, 3).3, sight);
    // Too few for all: as if nobody had asked for it.
    let few = wrong(Placement::Lights, 40, 64, 1);
    assert_eq!(few.3, wrong(Placement::Paths, 40, 64, 1).3);
    assert!(few.2 <= 40);
}

/// Lights come and go from picture to picture: records follow, those of lights that stay do so, too, and steps leave them where they are.
#[test]
fn records_follow_lights() {
    let world = Boxes::room();
    let (mut lights, eyes) = lights_and_eyes(&world);
    let records = Records::new(RecordSettings {
        placement: Placement::Lights,
        ..settings(50)
    })
    .unwrap();
    let later = lights.split_off(40);
    let mut scout = Walks(&world, Random(7));
    records.prepare(&world, &lights, &mut scout);
    let filled = records.cache().report().fill_rays;
    records.prepare(&world, &lights, &mut scout);
    assert_eq!(records.cache().report().fill_rays, filled);
    lights.truncate(30);
    lights.extend(&later[..15]);
    // Twice the same light is one place.
    lights.push(lights[0]);
    records.prepare(&world, &lights, &mut scout);
    assert_eq!(records.cache().len(), 45);
    let each = filled / 40;
    assert_eq!(records.cache().report().fill_rays, filled + 15 * each);
    let anew = Records::new(records.cache().settings().clone()).unwrap();
    anew.prepare(&world, &lights, &mut scout);
    let questions = (lights, eyes);
    let (seen, _) = sights(&world, &records, &questions);
    assert_eq!(sights(&world, &anew, &questions).0, seen);
    Visibility::<Boxes>::pass_done(&records, &world);
    assert_eq!(records.cache().report().steps.steps, 0);
    assert_eq!(sights(&world, &records, &questions).0, seen);
    // More lights than records: along paths from then on, and steps go on.
    let many = [questions.0, later].concat();
    assert!(many.len() > 50);
    records.prepare(&world, &many, &mut scout);
    Visibility::<Boxes>::pass_done(&records, &world);
    assert_eq!(records.cache().report().steps.steps, 1);
    let stands_on_light = |light: &&SharedLight| match light.end {
        LightEnd::Surface(end) => records.cache().own(end.position, end.normal).is_some(),
        _ => false,
    };
    assert_eq!(many.iter().filter(stands_on_light).count(), 0);
}
