//! Exact strategies answer alike, whatever was asked before, and their counters add up.

use glam::Vec3;
use occlude_visibility::{
    Class, Endpoint, Exact, LightEnd, Occluder, Query, Ray, Tracer, Visibility,
};

/// A world of spheres that names its blockers. `lazy` leaves out the test of single blockers, as closures do.
struct Spheres {
    spheres: Vec<(Vec3, f32)>,
    lazy: bool,
}

impl Spheres {
    fn hits(&self, i: u32, ray: &Ray) -> bool {
        let (centre, radius) = self.spheres[i as usize];
        let t = (centre - ray.origin).dot(ray.direction) / ray.direction.length_squared();
        ray.at(t.clamp(ray.t_min, ray.t_max)).distance(centre) < radius
    }
}

impl Tracer for Spheres {
    type Blocker = u32;

    fn blocker(&self, ray: &Ray) -> Option<u32> {
        (0..self.spheres.len() as u32).find(|&i| self.hits(i, ray))
    }

    fn blocks(&self, blocker: u32, ray: &Ray) -> bool {
        !self.lazy && self.hits(blocker, ray)
    }
}

/// Uniform numbers in [0, 1) (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 40) as f32 / (1 << 24) as f32
    }

    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }

    fn world(&mut self, spheres: usize, radius: f32, scale: f32) -> Spheres {
        Spheres {
            spheres: (0..spheres)
                .map(|_| (self.vector() * scale, self.next() * radius * scale))
                .collect(),
            lazy: false,
        }
    }

    /// Rows of neighbouring eyes on a floor, each asking about every kind of light end.
    fn questions(&mut self, scale: f32) -> Vec<Query> {
        let points: Vec<Vec3> = (0..3).map(|_| self.vector() * scale).collect();
        let suns: Vec<Vec3> = (0..2).map(|_| self.vector().normalize()).collect();
        let mut queries = Vec::new();
        for i in 0..64 * 64 {
            let position = Vec3::new(
                (i % 64) as f32 / 32.0 - 1.0,
                -1.0,
                (i / 64) as f32 / 32.0 - 1.0,
            ) * scale;
            let eye = Endpoint::new(position, Vec3::Y, 32.0 / scale);
            for &light in &points {
                queries.push(Query::new(
                    eye,
                    LightEnd::Point(light),
                    Ray::between(position, light),
                ));
            }
            for &sun in &suns {
                queries.push(Query::new(
                    eye,
                    LightEnd::Direction(sun),
                    Ray::new(position, sun),
                ));
            }
            let lamp = Vec3::new(self.next() * 0.3, 1.0, self.next() * 0.3) * scale;
            let end = LightEnd::Surface(Endpoint::new(lamp, -Vec3::Y, 11.0));
            queries.push(Query::new(eye, end, Ray::between(position, lamp)));
            let direction = (self.vector() + Vec3::Y).normalize();
            let end = LightEnd::SolidAngle {
                direction,
                density: 0.16,
            };
            queries.push(Query::new(eye, end, Ray::new(position, direction)));
        }
        queries
    }
}

fn ask<T: Tracer, V: Visibility<T>>(
    strategy: &V,
    tracer: &T,
    worker: &mut V::Worker,
    queries: &[Query],
) -> Vec<f32> {
    let mut answers = vec![f32::NAN; queries.len()];
    strategy.answer(tracer, worker, queries, &mut answers);
    answers
}

#[test]
fn occluder_equals_exact() {
    for seed in 0..6 {
        let mut random = Random(seed);
        let scale = [1.0, 1e-5, 1e5][seed as usize % 3];
        let world = random.world(20, 0.3, scale);
        let queries = random.questions(scale);
        let exact = ask(
            &Exact,
            &world,
            &mut Visibility::<Spheres>::worker(&Exact),
            &queries,
        );
        assert!(exact.contains(&0.0) && exact.contains(&1.0));
        for slots in [1, 64, 4096] {
            let strategy = Occluder::with_slots(slots);
            let mut worker = Visibility::<Spheres>::worker(&strategy);
            assert_eq!(
                ask(&strategy, &world, &mut worker, &queries),
                exact,
                "{slots} slots, scale {scale}"
            );
            let stats = Visibility::<Spheres>::stats(&strategy, &worker);
            assert_eq!(stats.queries, queries.len() as u64);
            assert_eq!(stats.queries, stats.answered + stats.traced);
        }
    }
}

/// Memory of one world, and of other batch sizes, does no harm in another.
#[test]
fn workers_may_be_reused() {
    let mut random = Random(7);
    let strategy = Occluder::default();
    let mut worker = Visibility::<Spheres>::worker(&strategy);
    for size in [1, 7, 64, 65, 100_000] {
        let world = random.world(30, 0.4, 1.0);
        let queries = random.questions(1.0);
        let exact = ask(
            &Exact,
            &world,
            &mut Visibility::<Spheres>::worker(&Exact),
            &queries,
        );
        let answers: Vec<f32> = queries
            .chunks(size)
            .flat_map(|chunk| ask(&strategy, &world, &mut worker, chunk))
            .collect();
        assert_eq!(answers, exact, "batches of {size}");
    }
}

/// Not only right but useful: most blocked rays of a big blocker are never traced, and none of a lit world is tested.
#[test]
fn memory_answers_most_blocked_questions() {
    let queries = Random(9).questions(1.0);
    let count = |world: &Spheres| {
        let strategy = Occluder::default();
        let mut worker = Visibility::<Spheres>::worker(&strategy);
        let answers = ask(&strategy, world, &mut worker, &queries);
        let blocked = answers.iter().filter(|&&a| a == 0.0).count() as f64;
        (
            blocked,
            Visibility::<Spheres>::stats(&strategy, &worker).answered as f64,
        )
    };
    let lid = Spheres {
        spheres: vec![(Vec3::ZERO, 0.99)],
        lazy: false,
    };
    let (blocked, answered) = count(&lid);
    assert!(
        blocked > 0.3 * queries.len() as f64 && answered > 0.7 * blocked,
        "{answered} of {blocked}"
    );
    let (blocked, answered) = count(&Spheres {
        spheres: vec![],
        lazy: false,
    });
    assert_eq!((blocked, answered), (0.0, 0.0));
    let (blocked, answered) = count(&Spheres { lazy: true, ..lid });
    assert!(blocked > 0.0 && answered == 0.0);
}

/// Positions and directions that are not finite, or zero, fall into some bin.
#[test]
fn odd_numbers_do_no_harm() {
    let world = Random(1).world(5, 0.5, 1.0);
    let odd = [
        0.0,
        -0.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN_POSITIVE,
    ];
    let mut queries = Vec::new();
    for x in odd {
        for y in odd {
            let (position, other) = (Vec3::new(x, y, 0.0), Vec3::new(y, 0.0, x));
            let eye = Endpoint::new(position, Vec3::Y, x);
            let solid_angle = LightEnd::SolidAngle {
                direction: other,
                density: y,
            };
            let surface = LightEnd::Surface(Endpoint::new(other, other, y));
            for light in [
                LightEnd::Point(other),
                LightEnd::Direction(other),
                surface,
                solid_angle,
            ] {
                queries.push(Query::new(eye, light, Ray::between(position, other)));
            }
        }
    }
    let strategy = Occluder::default();
    let mut worker = Visibility::<Spheres>::worker(&strategy);
    let exact = ask(
        &Exact,
        &world,
        &mut Visibility::<Spheres>::worker(&Exact),
        &queries,
    );
    assert_eq!(ask(&strategy, &world, &mut worker, &queries), exact);
}

#[test]
fn strategies_say_what_they_are() {
    let occluder = Occluder::with_slots(100);
    assert_eq!(Visibility::<Spheres>::name(&occluder), "occluder");
    assert_eq!(Visibility::<Spheres>::class(&occluder), Class::Exact);
    assert_eq!(Visibility::<Spheres>::class(&Exact).name(), "exact");
    assert_eq!(Visibility::<Spheres>::bytes(&occluder), 0);
    let workers: Vec<_> = (0..2)
        .map(|_| Visibility::<Spheres>::worker(&occluder))
        .collect();
    drop(workers);
    let bytes = Visibility::<Spheres>::bytes(&occluder);
    assert!((2 * 128 * 8..=2 * 128 * 32).contains(&bytes), "{bytes}");
}
