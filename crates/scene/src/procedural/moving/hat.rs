//! A hat with a wide brim: a shell with an inside.

use super::super::shape::Shape;
use super::{bump, deform, smooth};
use glam::Vec3;

/// Where the brim begins and ends, metres from the axis.
const BRIM: (f32, f32) = (0.30, 0.62);
const THICKNESS: f32 = 0.012;

/// Stands on `y = 0`; the sides of its brim curl up and its front and back bend down by `0.06`.
pub(super) fn hat(segments: u32, rows: u32) -> Shape {
    // Radius and height along the outline: under the crown, down its wall, out below the brim, back above it, up the crown.
    let crown = [
        (0.0, 0.34),
        (0.10, 0.345),
        (0.20, 0.335),
        (0.245, 0.29),
        (0.265, 0.18),
        (0.285, 0.05),
        (BRIM.0 + 0.03, 0.0),
        (BRIM.1, 0.0),
    ];
    let mut outline: Vec<(f32, f32)> = crown
        .iter()
        .map(|&(r, y)| ((r - 0.5 * THICKNESS).max(0.0), y - 0.5 * THICKNESS))
        .collect();
    outline[0].0 = 0.0;
    outline.push((BRIM.1 + THICKNESS, 0.0));
    outline.extend(crown.iter().rev().map(|&(r, y)| {
        let r = if r > 0.0 { r + 0.5 * THICKNESS } else { 0.0 };
        (r, y + 0.5 * THICKNESS)
    }));
    let mut shape = Shape::default();
    shape.lathe(&resampled(&outline, rows), segments, true);
    deform(&mut shape, |p| {
        let dent = bump(p.x / 0.14) * bump(p.z / 0.26) * smooth(0.2, 0.33, p.y);
        let curl = 0.06 * brim(p) * two_fold(p);
        Vec3::new(0.86 * p.x, p.y + curl - 0.09 * dent, p.z)
    });
    shape
}

/// How far out on the brim a place is, squared: 0 on the crown, 1 at the edge.
pub(super) fn brim(p: Vec3) -> f32 {
    let radius = (p.x * p.x + p.z * p.z).sqrt();
    let out = ((radius - BRIM.0) / (BRIM.1 - BRIM.0)).max(0.0);
    out * out
}

/// 1 towards the sides, -1 towards front and back.
pub(super) fn two_fold(p: Vec3) -> f32 {
    let square = p.x * p.x + p.z * p.z;
    if square > 0.0 {
        (p.x * p.x - p.z * p.z) / square
    } else {
        0.0
    }
}

/// Three waves around.
pub(super) fn three_fold(p: Vec3) -> f32 {
    let radius = (p.x * p.x + p.z * p.z).sqrt();
    if radius > 0.0 {
        (3.0 * p.z * p.z - p.x * p.x) * p.x / (radius * radius * radius)
    } else {
        0.0
    }
}

/// `rows + 1` points evenly along an outline, its corners rounded by twice cutting them.
fn resampled(outline: &[(f32, f32)], rows: u32) -> Vec<(f32, f32)> {
    let mut fine = outline.to_vec();
    for _ in 0..2 {
        // Chaikin 1974.
        let mix =
            |a: (f32, f32), b: (f32, f32), t: f32| (a.0 + (b.0 - a.0) * t, a.1 + (b.1 - a.1) * t);
        let cut = fine
            .windows(2)
            .flat_map(|w| [mix(w[0], w[1], 0.25), mix(w[0], w[1], 0.75)]);
        let mut next = vec![fine[0]];
        next.extend(cut);
        next.push(fine[fine.len() - 1]);
        fine = next;
    }
    let length = |a: (f32, f32), b: (f32, f32)| {
        let (x, y) = (b.0 - a.0, b.1 - a.1);
        (x * x + y * y).sqrt()
    };
    let total: f32 = fine.windows(2).map(|w| length(w[0], w[1])).sum();
    let mut points = vec![fine[0]];
    let (mut piece, mut before) = (0, 0.0);
    for row in 1..rows {
        let wanted = total * row as f32 / rows as f32;
        while piece + 2 < fine.len() && before + length(fine[piece], fine[piece + 1]) < wanted {
            before += length(fine[piece], fine[piece + 1]);
            piece += 1;
        }
        let (a, b) = (fine[piece], fine[piece + 1]);
        let t = ((wanted - before) / length(a, b).max(1e-6)).clamp(0.0, 1.0);
        // Only the ends lie on the axis.
        points.push(((a.0 + (b.0 - a.0) * t).max(1e-4), a.1 + (b.1 - a.1) * t));
    }
    points.push(fine[fine.len() - 1]);
    points
}
