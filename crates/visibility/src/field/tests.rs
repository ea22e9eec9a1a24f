//! The transform against brute force and against closed forms.

use super::hemisphere::Grid;
use super::*;
use glam::Vec3;
use std::f64::consts::PI;

/// The boundary's midpoints, in double precision.
fn midpoints(map: &VisibilityMap) -> Vec<[f64; 3]> {
    let side = map.side() as usize;
    let spacing = PI / side as f64;
    let mut all = Vec::new();
    let mut push = |row: f64, column: f64| {
        let (t, p) = ((row + 0.5) * spacing, (column + 0.5) * spacing);
        all.push([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()]);
    };
    for row in 0..side {
        for column in 0..side {
            let here = map.get(row, column);
            if column + 1 < side && map.get(row, column + 1) != here {
                push(row as f64, column as f64 + 0.5);
            }
            if row + 1 < side && map.get(row + 1, column) != here {
                push(row as f64 + 0.5, column as f64);
            }
        }
    }
    all
}

/// The slow twin of the transform.
fn brute(map: &VisibilityMap) -> Vec<f64> {
    let side = map.side() as usize;
    let spacing = PI / side as f64;
    let sites = midpoints(map);
    let mut out = Vec::new();
    for row in 0..side {
        for column in 0..side {
            let (t, p) = (
                (row as f64 + 0.5) * spacing,
                (column as f64 + 0.5) * spacing,
            );
            let w = [t.sin() * p.cos(), t.sin() * p.sin(), t.cos()];
            let nearest = sites
                .iter()
                .map(|s| s[0] * w[0] + s[1] * w[1] + s[2] * w[2])
                .fold(-1.0, f64::max);
            let nearest = nearest.clamp(-1.0, 1.0).acos();
            out.push(if map.get(row, column) {
                nearest.min(w[1].asin())
            } else {
                -nearest
            });
        }
    }
    out
}

struct Numbers(u64);

impl Numbers {
    fn unit(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let p = Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0;
            if (0.01..1.0).contains(&p.length_squared()) {
                return p.normalize();
            }
        }
    }

    /// Caps, specks and noise over each other.
    fn map(&mut self, side: u32) -> VisibilityMap {
        let mut map = VisibilityMap::new(side, self.unit() < 0.5);
        for _ in 0..(self.unit() * 6.0) as u32 {
            let (axis, cos, free) = (self.direction(), self.unit(), self.unit() < 0.5);
            let cap = VisibilityMap::from_fn(side, |w| w.dot(axis) > cos);
            for row in 0..side as usize {
                for column in 0..side as usize {
                    if cap.get(row, column) {
                        map.set(row, column, free);
                    }
                }
            }
        }
        for _ in 0..(self.unit() * 8.0) as u32 {
            let at = |unit: f32| ((unit * side as f32) as usize).min(side as usize - 1);
            let (row, column) = (at(self.unit()), at(self.unit()));
            let flipped = !map.get(row, column);
            map.set(row, column, flipped);
        }
        map
    }
}

fn compare(map: &VisibilityMap) {
    let field = DistanceTransform::default().transform(map);
    let side = map.side() as usize;
    for (index, expected) in brute(map).into_iter().enumerate() {
        let found = f64::from(field.get(index / side, index % side));
        // Sixteen bits; and cosines in single precision, which know small angles to eps / angle.
        let tolerance = 1.2e-4 + 3e-7 / expected.abs().max(1e-4);
        assert!(
            (found - expected).abs() < tolerance,
            "side {side}, row {}, column {}: {found}, not {expected}",
            index / side,
            index % side
        );
    }
}

#[test]
fn the_transform_is_exact() {
    let mut numbers = Numbers(11);
    for side in [16, 32, 64] {
        for _ in 0..60 {
            compare(&numbers.map(side));
        }
    }
    for _ in 0..4 {
        compare(&numbers.map(128));
    }
}

#[test]
fn noise_is_transformed_exactly_too() {
    let mut numbers = Numbers(5);
    for share in [0.5, 0.02, 0.98] {
        let map = VisibilityMap::from_fn(64, |_| numbers.unit() < share);
        compare(&map);
    }
}

#[test]
fn without_boundaries_it_is_the_horizon_or_half_a_turn() {
    let mut transform = DistanceTransform::default();
    let dark = transform.transform(&VisibilityMap::new(32, false));
    assert!((dark.get(3, 7) + std::f32::consts::PI).abs() < 1e-3);
    let free = transform.transform(&VisibilityMap::new(32, true));
    let centre = Grid::of(32).direction(15, 15);
    assert!((free.get(15, 15) - centre.y.asin()).abs() < 1e-3);
}

/// Analytic oracle: half of the hemisphere behind a plane through the point. The distance is the angle to the great circle,
/// wrong by no more than the boundary's texels are off it; and what follows for the visible share of lobes.
#[test]
fn half_planes_are_what_geometry_says() {
    let mut numbers = Numbers(23);
    let side = 128;
    let texel = std::f32::consts::PI / side as f32;
    let lobes = [20.0, 200.0, 2000.0];
    let share = VisibleShare::new();
    let mut squares = [0.0_f64; 3];
    let mut weights = 0.0;
    for _ in 0..12 {
        let plane = numbers.direction();
        let map = VisibilityMap::from_fn(side, |w| w.dot(plane) > 0.0);
        let field = DistanceTransform::default().transform(&map);
        let grid = Grid::of(side);
        for row in 0..side as usize {
            for column in 0..side as usize {
                let w = grid.direction(row, column);
                let edge = w.dot(plane).asin();
                // The nearest point of the great circle may lie below the horizon: leave those out.
                let foot = w - plane * w.dot(plane);
                if foot.y < 0.05 || edge > w.y.asin() {
                    continue;
                }
                let found = field.get(row, column);
                assert!(
                    (found - edge).abs() < 1.2 * texel,
                    "{found} at {w}, not {edge}"
                );
                // Over the lobes that the edge cuts.
                if edge.abs() < 0.2 {
                    weights += f64::from(grid.sin[row]);
                    for (sum, lobe) in squares.iter_mut().zip(&lobes) {
                        let error = share.at(found, *lobe) - share.at(edge, *lobe);
                        *sum += f64::from(error * error * grid.sin[row]);
                    }
                }
            }
        }
    }
    let rms = squares.map(|sum| (sum / weights).sqrt());
    println!("rms error of the visible share at sharpness 20, 200, 2000: {rms:.4?}");
    for (rms, bar) in rms.into_iter().zip([0.012, 0.035, 0.09]) {
        assert!(rms < bar, "{rms}, bar {bar}");
    }
}

#[test]
fn one_transform_serves_many_maps() {
    let mut numbers = Numbers(77);
    let mut transform = DistanceTransform::default();
    for side in [64, 16, 128, 32] {
        let map = numbers.map(side);
        assert_eq!(
            transform.transform(&map),
            DistanceTransform::default().transform(&map)
        );
    }
}

/// Prints how long maps take: `cargo test --release -p occlude-visibility -- --ignored --nocapture times`.
#[test]
#[ignore = "measures"]
fn times() {
    let mut numbers = Numbers(3);
    for side in [64, 128, 256, 512, 1024] {
        let maps: Vec<VisibilityMap> = (0..32).map(|_| numbers.map(side)).collect();
        let mut transform = DistanceTransform::default();
        let mut field = DistanceField::default();
        for map in &maps {
            transform.transform_into(map, &mut field);
        }
        let rounds = (40_000_000 / (32 * side * side)).max(1);
        let start = std::time::Instant::now();
        for _ in 0..rounds {
            for map in &maps {
                transform.transform_into(map, std::hint::black_box(&mut field));
            }
        }
        let each = start.elapsed().as_secs_f64() / f64::from(rounds * 32);
        let texels = f64::from(side * side);
        println!(
            "{side}: {:.1} us a map, {:.2} ns a texel",
            each * 1e6,
            each * 1e9 / texels
        );
    }
}
