//! Pictures of a sequence: memory that stays, and what moves.

mod common;
use common::{Random, Spheres};
use glam::Vec3;
use occlude_visibility::quantized::{
    BoundingSphere, ErrorReach, Guarantee, Quantized, QuantizedSettings, Share,
};
use occlude_visibility::two_part::{Ball, TwoPart, TwoPartTracer};
use occlude_visibility::{
    Correction, Endpoint, Epoch, Exact, EyeSample, LightEnd, ManyLights, Ray, SharedLight, Tracer,
    Visibility, VisibilityStats, order,
};

const SIDE: u32 = 64;

/// Spheres of which the last ones move.
struct Moving {
    still: Spheres,
    moving: Spheres,
    balls: Vec<Ball>,
}

impl Moving {
    fn new(still: &[(Vec3, f32)], moving: &[(Vec3, f32)]) -> Self {
        let world = |spheres: &[(Vec3, f32)]| Spheres {
            spheres: spheres.to_vec(),
            lazy: false,
        };
        let ball = |&(centre, radius): &(Vec3, f32)| Ball { centre, radius };
        Self {
            still: world(still),
            moving: world(moving),
            balls: moving.iter().map(ball).collect(),
        }
    }
}

impl Tracer for Moving {
    type Blocker = u32;

    fn blocker(&self, ray: &Ray) -> Option<u32> {
        self.still.blocker(ray).or_else(|| self.moving.blocker(ray))
    }
}

impl TwoPartTracer for Moving {
    fn occluded_by_still(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.still.occluded_batch(rays, occluded);
    }

    fn occluded_by_moving(&self, ray: &Ray) -> bool {
        self.moving.occluded(ray)
    }

    fn moving(&self) -> &[Ball] {
        &self.balls
    }
}

/// Wants all, keeps the answers.
struct Everything {
    lights: usize,
    answers: Vec<Vec<f32>>,
}

impl ManyLights for Everything {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        let left = (self.lights - 16 * block).min(16);
        wanted.fill(u16::MAX >> (16 - left));
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        for (answers, visible) in self.answers.iter_mut().zip(visible) {
            for l in 0..(self.lights - 16 * block).min(16) {
                answers[16 * block + l] = f32::from(visible >> l & 1);
            }
        }
        for one in corrections {
            self.answers[one.eye as usize][16 * block + one.light as usize] += one.amount;
        }
    }
}

/// Four tiles of a floor at `y`, seen by a camera that has walked `x` metres on; samples a square metre as asked.
fn tiles(x: f32, y: f32, density: f32) -> Vec<Vec<EyeSample>> {
    (0..4)
        .map(|tile| {
            let side = (density.sqrt()).recip();
            let corner = Vec3::new(x + (tile % 2) as f32, y, (tile / 2) as f32);
            order::progressive(SIDE, SIDE, 20.0)
                .iter()
                .map(|&[a, b]| {
                    let position = corner + Vec3::new(a as f32 + 0.5, 0.0, b as f32 + 0.5) * side
                        - Vec3::ONE.with_y(0.0);
                    EyeSample {
                        end: Endpoint::new(position, Vec3::Y, density),
                        origin: position,
                    }
                })
                .collect()
        })
        .collect()
}

fn lights(count: usize, random: &mut Random) -> Vec<SharedLight> {
    (0..count)
        .map(|_| {
            let at = random.vector() * 0.8 + 1.4 * Vec3::Y;
            SharedLight {
                end: LightEnd::Surface(Endpoint::new(at, Vec3::NEG_Y, 5.0)),
                target: Some(at),
                connections: count as f32,
            }
        })
        .collect()
}

fn settings() -> QuantizedSettings {
    QuantizedSettings {
        error: ErrorReach::all(8.0),
        share: Share::Frames,
        table_bytes: 64 << 20,
        ..Default::default()
    }
}

fn cache(settings: QuantizedSettings) -> Quantized {
    let bounds = BoundingSphere {
        centre: Vec3::ZERO,
        radius: 3.0,
    };
    Quantized::new(settings, bounds).unwrap()
}

/// One picture: the answers tile by tile, asked in the order `order`, and the counters.
fn picture<T: Tracer, V: Visibility<T>>(
    strategy: &V,
    world: &T,
    tiles: &[Vec<EyeSample>],
    lights: &[SharedLight],
    order: &[usize],
) -> (Vec<Vec<Vec<f32>>>, VisibilityStats) {
    let mut worker = strategy.worker();
    let mut answers = vec![Vec::new(); tiles.len()];
    for &tile in order {
        let epoch = Epoch {
            tile: tile as u32,
            ..Epoch::default()
        };
        strategy.begin(&mut worker, epoch);
        let mut asker = Everything {
            lights: lights.len(),
            answers: vec![vec![f32::NAN; lights.len()]; tiles[tile].len()],
        };
        strategy.answer_many(world, &mut worker, &tiles[tile], lights, &mut asker);
        answers[tile] = asker.answers;
    }
    (answers, strategy.stats(&worker))
}

/// Share of answers that differ.
fn wrong(a: &[Vec<Vec<f32>>], b: &[Vec<Vec<f32>>]) -> f64 {
    let flat = |x: &[Vec<Vec<f32>>]| x.iter().flatten().flatten().copied().collect::<Vec<_>>();
    let (a, b) = (flat(a), flat(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).filter(|(a, b)| a != b).count() as f64 / a.len() as f64
}

const FORWARD: [usize; 4] = [0, 1, 2, 3];

#[test]
fn later_pictures_know_what_earlier_ones_learnt() {
    let mut random = Random(21);
    let world = random.world(14, 0.3, 1.0);
    let lights = lights(40, &mut random);
    let density = f32::from(SIDE as u16).powi(2);
    let mut strategy = cache(settings());
    let exact = |tiles: &[_]| picture(&Exact, &world, tiles, &lights, &FORWARD).0;
    let here = tiles(0.0, -1.0, density);
    let (first, fresh) = picture(&strategy, &world, &here, &lights, &FORWARD);
    Visibility::<Spheres>::next_picture(&mut strategy);
    let (again, known) = picture(&strategy, &world, &here, &lights, &FORWARD);
    // Tiles meet at their borders: there a cell may have been answered twice. And who now knows more neighbours than at first
    // differs from one more often, and is refined: a few rays in a hundred.
    assert!(
        known.traced * 30 < fresh.traced,
        "{} then {}",
        fresh.traced,
        known.traced
    );
    let [first, again] = [first, again].map(|answers| wrong(&answers, &exact(&here)));
    println!("{:.2} % wrong, then {:.2} %", 100.0 * first, 100.0 * again);
    assert!(again < 1.35 * first + 0.002, "{first} then {again}");

    // The camera walks; the floor stays.
    let mut worst = again;
    for step in 1..12 {
        Visibility::<Spheres>::next_picture(&mut strategy);
        let there = tiles(0.02 * step as f32, -1.0, density);
        let (answers, stats) = picture(&strategy, &world, &there, &lights, &FORWARD);
        assert!(
            stats.traced * 4 < fresh.traced,
            "{step}: {} of {}",
            stats.traced,
            fresh.traced
        );
        worst = wrong(&answers, &exact(&there)).max(worst);
    }
    assert!(worst < 1.5 * first + 0.002, "{first}, at worst {worst}");
}

/// The order of tiles, and with it the number of threads, leaves no trace in any picture.
#[test]
fn the_order_of_tiles_does_not_show() {
    let mut random = Random(22);
    let world = random.world(14, 0.3, 1.0);
    let lights = lights(40, &mut random);
    for guarantee in [Guarantee::Bounded, Guarantee::Unbiased] {
        let run = |order: [usize; 4]| -> Vec<_> {
            let mut strategy = cache(QuantizedSettings {
                guarantee,
                ..settings()
            });
            (0..4)
                .map(|step| {
                    let tiles = tiles(0.05 * step as f32, -1.0, 4000.0);
                    let (answers, stats) = picture(&strategy, &world, &tiles, &lights, &order);
                    Visibility::<Spheres>::next_picture(&mut strategy);
                    (answers, stats.traced)
                })
                .collect()
        };
        assert!(run(FORWARD) == run([2, 0, 3, 1]), "{guarantee:?}");
    }
}

/// Some lights are replaced by others: whoever is new knows nothing, the rest stays known.
#[test]
fn new_lights_never_read_old_answers() {
    let mut random = Random(23);
    let world = random.world(14, 0.35, 1.0);
    let mut lights = lights(64, &mut random);
    let here = tiles(0.0, -1.0, 4000.0);
    let mut strategy = cache(settings());
    let (_, fresh) = picture(&strategy, &world, &here, &lights, &FORWARD);
    for block in 0..4 {
        Visibility::<Spheres>::next_picture(&mut strategy);
        for light in &mut lights[16 * block..16 * (block + 1)] {
            let at = random.vector() * 0.8 + 1.4 * Vec3::Y;
            light.end = LightEnd::Surface(Endpoint::new(at, Vec3::NEG_Y, 5.0));
            light.target = Some(at);
        }
        let (answers, stats) = picture(&strategy, &world, &here, &lights, &FORWARD);
        let share = stats.traced as f64 / fresh.traced as f64;
        assert!((0.1..0.45).contains(&share), "block {block}: {share}");
        let (alone, _) = picture(&cache(settings()), &world, &here, &lights, &FORWARD);
        let (exact, _) = picture(&Exact, &world, &here, &lights, &FORWARD);
        let [now, alone] = [answers, alone].map(|answers| wrong(&answers, &exact));
        assert!(
            now < 1.35 * alone + 0.002,
            "block {block}: {now}, fresh {alone}"
        );
    }
}

/// A table far too small for the sequence: more rays, the same quality.
#[test]
fn a_small_memory_forgets_and_stays_right() {
    let mut random = Random(24);
    let world = random.world(14, 0.3, 1.0);
    let lights = lights(40, &mut random);
    let mut strategy = cache(QuantizedSettings {
        table_bytes: 64 << 10,
        ..settings()
    });
    for step in 0..6 {
        let tiles = tiles(0.3 * step as f32, -1.0, 4000.0);
        let (answers, _) = picture(&strategy, &world, &tiles, &lights, &FORWARD);
        let (exact, _) = picture(&Exact, &world, &tiles, &lights, &FORWARD);
        let (alone, _) = picture(&cache(settings()), &world, &tiles, &lights, &FORWARD);
        let [now, alone] = [answers, alone].map(|answers| wrong(&answers, &exact));
        assert!(
            now < 1.35 * alone + 0.002,
            "step {step}: {now}, fresh {alone}"
        );
        Visibility::<Spheres>::next_picture(&mut strategy);
    }
    assert!(Visibility::<Spheres>::bytes(&strategy) < 1 << 20);
    Visibility::<Spheres>::forget(&mut strategy);
    let (_, stats) = picture(
        &strategy,
        &world,
        &tiles(0.0, -1.0, 4000.0),
        &lights,
        &FORWARD,
    );
    assert!(stats.traced > 0);
}

/// Unbiased answers stay right on average when memory is of an earlier picture.
#[test]
fn unbiased_in_later_pictures_too() {
    let mut random = Random(25);
    let world = random.world(10, 0.4, 1.0);
    let lights = lights(16, &mut random);
    let here = tiles(0.0, -1.0, 4000.0);
    let (exact, _) = picture(&Exact, &world, &here, &lights, &FORWARD);
    let mean = |answers: &[Vec<Vec<f32>>]| {
        let flat = answers.iter().flatten().flatten();
        flat.clone().map(|&x| f64::from(x)).sum::<f64>() / flat.count() as f64
    };
    let runs = 24;
    let errors: Vec<f64> = (0..runs)
        .map(|seed| {
            let mut strategy = cache(QuantizedSettings {
                guarantee: Guarantee::Unbiased,
                seed,
                ..settings()
            });
            picture(
                &strategy,
                &world,
                &tiles(0.013, -1.0, 4000.0),
                &lights,
                &FORWARD,
            );
            Visibility::<Spheres>::next_picture(&mut strategy);
            mean(&picture(&strategy, &world, &here, &lights, &FORWARD).0) - mean(&exact)
        })
        .collect();
    let n = runs as f64;
    let bias = errors.iter().sum::<f64>() / n;
    let variance = errors.iter().map(|e| (e - bias).powi(2)).sum::<f64>() / (n - 1.0);
    // Student's t with 23 degrees of freedom: 4.4 is one in ten thousand.
    let t = bias / (variance / n).sqrt();
    println!("bias {bias:.2e}, t {t:.2}");
    assert!(t.abs() < 4.4, "bias {bias}, t {t}");
}

/// With nothing that stands still, memory holds nothing but "free": every answer of every picture is the exact one, so no
/// shadow of a place where something was can remain.
#[test]
fn what_moves_is_exact_and_leaves_no_shadow() {
    let mut random = Random(26);
    let lights = lights(40, &mut random);
    for guarantee in [Guarantee::Bounded, Guarantee::Unbiased] {
        let mut strategy = TwoPart(cache(QuantizedSettings {
            guarantee,
            ..settings()
        }));
        let mut blocked = 0;
        for step in 0..8 {
            let at = Vec3::new(0.2 * step as f32 - 0.8, -0.4, 0.1);
            let world = Moving::new(&[], &[(at, 0.25), (at * 0.5 + 0.4 * Vec3::Z, 0.1)]);
            let tiles = tiles(0.0, -1.0, 4000.0);
            let (answers, stats) = picture(&strategy, &world, &tiles, &lights, &FORWARD);
            let (exact, all) = picture(&Exact, &world, &tiles, &lights, &FORWARD);
            assert!(answers == exact, "{guarantee:?}, picture {step}");
            assert!(
                stats.traced * 2 < all.traced,
                "{} of {}",
                stats.traced,
                all.traced
            );
            blocked += exact
                .iter()
                .flatten()
                .flatten()
                .filter(|&&seen| seen == 0.0)
                .count();
            Visibility::<Moving>::next_picture(&mut strategy);
        }
        assert!(
            blocked > 10_000,
            "the spheres hid {blocked} connections only"
        );
    }
}

/// Still and moving spheres: no worse than a fresh memory of the same kind, picture after picture; with no error allowed, exact.
#[test]
fn a_sequence_is_as_right_as_fresh_memory() {
    let mut random = Random(27);
    let still = random.world(10, 0.3, 1.0).spheres;
    let lights = lights(40, &mut random);
    let mut strategy = TwoPart(cache(settings()));
    let none = TwoPart(cache(QuantizedSettings {
        error: ErrorReach::all(0.0),
        ..settings()
    }));
    for step in 0..8 {
        let at = Vec3::new(0.2 * step as f32 - 0.8, -0.5, 0.1);
        let world = Moving::new(&still, &[(at, 0.25)]);
        // The camera walks, too, and part of the eyes ride on the moving sphere's level.
        let mut tiles = tiles(0.02 * step as f32, -1.0, 4000.0);
        for eye in &mut tiles[3] {
            eye.end.position.y = at.y + 0.3 + 0.01 * step as f32;
            eye.origin = eye.end.position;
        }
        let (exact, _) = picture(&Exact, &world, &tiles, &lights, &FORWARD);
        let (kept, _) = picture(&strategy, &world, &tiles, &lights, &FORWARD);
        let fresh = TwoPart(cache(settings()));
        let (alone, _) = picture(&fresh, &world, &tiles, &lights, &FORWARD);
        let [kept, alone] = [kept, alone].map(|answers| wrong(&answers, &exact));
        println!(
            "picture {step}: {:.2} % wrong, fresh {:.2} %",
            100.0 * kept,
            100.0 * alone
        );
        assert!(
            kept < 1.35 * alone + 0.002,
            "picture {step}: {kept}, fresh {alone}"
        );
        assert!(picture(&none, &world, &tiles, &lights, &FORWARD).0 == exact);
        Visibility::<Moving>::next_picture(&mut strategy);
    }
}
