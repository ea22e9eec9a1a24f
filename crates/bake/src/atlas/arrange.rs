//! Charts become a layout: turned, fitted to texels and packed into pieces.
//!
//! A chart's bounding rectangle of least area lies level, its longer side across. Sides of a texel or more become whole numbers of
//! texels, and begin and end in texel centres: a bilinear lookup on the chart then reads the chart's texels alone, and two charts that
//! meet along a straight edge have their texels at the same places along it.

use super::unwrap::Charts;
use super::{Layout, skyline};
use glam::{DVec2, UVec2, Vec2};

/// A chart that does not fit a page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TooLarge {
    /// The density that would fit over the one asked for.
    pub shrink: f32,
}

/// How a chart is brought onto texels.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    /// Direction of the texel rows.
    along: DVec2,
    /// Lower left corner in turned coordinates.
    low: DVec2,
    scale: DVec2,
    start: DVec2,
    pub cells: UVec2,
}

/// Lays charts out at `density` texels a metre.
pub(super) fn arrange(
    mesh: u32,
    charts: Charts,
    density: f32,
    padding: u32,
    page_size: u32,
) -> Result<Layout, TooLarge> {
    let count = charts.count as usize;
    let mut first = vec![0_u32; count + 1];
    let charted = || {
        charts
            .of
            .iter()
            .enumerate()
            .filter(|&(_, &c)| c != Layout::NO_CHART)
    };
    for (_, &c) in charted() {
        first[c as usize + 1] += 1;
    }
    for c in 0..count {
        first[c + 1] += first[c];
    }
    let mut members = vec![0_u32; first[count] as usize];
    let mut fill = first.clone();
    for (t, &c) in charted() {
        members[fill[c as usize] as usize] = t as u32;
        fill[c as usize] += 1;
    }
    drop(fill);

    let mut points = Vec::new();
    let mut fits = Vec::with_capacity(count);
    let mut shrink = 1.0_f32;
    for ends in first.windows(2) {
        let members = &members[ends[0] as usize..ends[1] as usize];
        points.clear();
        points.extend(
            members
                .iter()
                .flat_map(|&t| charts.corners[t as usize])
                .map(Vec2::as_dvec2),
        );
        let fit = fit(&mut points, f64::from(density));
        if fit.cells.max_element() > page_size {
            shrink = shrink.min((page_size - 1) as f32 / fit.cells.max_element() as f32);
        }
        fits.push(fit);
    }
    if shrink < 1.0 {
        return Err(TooLarge { shrink });
    }
    let (places, pieces) = pack(&fits, padding, page_size);
    let mut layout = Layout {
        mesh,
        pieces,
        chart_count: charts.count,
        ..Layout::default()
    };
    if layout.pieces.len() > 1 {
        layout.piece_of = vec![0; charts.of.len()];
    }
    layout.corners = charts.corners;
    for (chart, ends) in first.windows(2).enumerate() {
        let (fit, (piece, at)) = (fits[chart], places[chart]);
        let limit = fit.cells.as_dvec2();
        for &t in &members[ends[0] as usize..ends[1] as usize] {
            let corners = &mut layout.corners[t as usize];
            *corners = corners.map(|c| {
                let turned = turn(fit.along, c.as_dvec2()) - fit.low;
                let local = (fit.start + turned * fit.scale).clamp(DVec2::ZERO, limit);
                (at.as_dvec2() + local).as_vec2()
            });
            if let Some(slot) = layout.piece_of.get_mut(t as usize) {
                *slot = piece as u16;
            }
        }
    }
    // Triangles without a chart are points in the middle of the first texel.
    for (corners, _) in layout
        .corners
        .iter_mut()
        .zip(&charts.of)
        .filter(|(_, c)| **c == Layout::NO_CHART)
    {
        *corners = [Vec2::splat(0.5); 3];
    }
    layout.charts = charts.of;
    layout.index_rows();
    Ok(layout)
}

fn turn(along: DVec2, p: DVec2) -> DVec2 {
    DVec2::new(along.dot(p), along.perp_dot(p))
}

/// Turns a chart so that its bounding rectangle is smallest, longer side across, and fits it to texels.
pub(super) fn fit(points: &mut Vec<DVec2>, density: f64) -> Fit {
    let hull = hull(points);
    let bounds = |along: DVec2| {
        let turned = hull.iter().map(|&p| turn(along, p));
        turned.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| {
            (low.min(p), high.max(p))
        })
    };
    let mut best = (f64::INFINITY, DVec2::X);
    for k in 0..hull.len() {
        let edge = hull[(k + 1) % hull.len()] - hull[k];
        let Some(along) = edge.try_normalize() else {
            continue;
        };
        let (low, high) = bounds(along);
        let size = high - low;
        // Of rectangles that are as good, the one along the longest edge.
        let cost = size.x * size.y * (1.0 + 1e-6) - 1e-6 * edge.length_squared();
        if cost < best.0 {
            best = (cost, along);
        }
    }
    let mut along = best.1;
    let (mut low, mut high) = bounds(along);
    if high.y - low.y > high.x - low.x {
        along = along.perp();
        (low, high) = bounds(along);
    }
    let size = high - low;
    let (x, y) = (align(size.x, density), align(size.y, density));
    Fit {
        along,
        low,
        scale: DVec2::new(x.scale, y.scale),
        start: DVec2::new(x.start, y.start),
        cells: UVec2::new(x.cells, y.cells),
    }
}

struct Aligned {
    scale: f64,
    start: f64,
    cells: u32,
}

/// Texels for a side of `length` metres.
fn align(length: f64, density: f64) -> Aligned {
    /// Shorter sides stay within one texel.
    const ONE_TEXEL: f64 = 0.75;
    /// What is thinner is drawn this thick: a triangle needs some area.
    const THINNEST: f64 = 0.25;
    let texels = length * density;
    if texels < ONE_TEXEL {
        let span = texels.max(THINNEST);
        let scale = if length > 0.0 { span / length } else { 0.0 };
        return Aligned {
            scale,
            start: 0.5 - 0.5 * span,
            cells: 1,
        };
    }
    let span = texels.round().clamp(1.0, f64::from(u32::MAX / 2));
    Aligned {
        scale: span / length,
        start: 0.5,
        cells: span as u32 + 1,
    }
}

/// The convex hull (Andrew 1979), counter-clockwise. Sorts the points.
fn hull(points: &mut Vec<DVec2>) -> Vec<DVec2> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points.clone();
    }
    let mut hull: Vec<DVec2> = Vec::new();
    let mut half = |points: &mut dyn Iterator<Item = DVec2>| {
        let start = hull.len();
        for p in points {
            while hull.len() >= start + 2 {
                let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
                if (b - a).perp_dot(p - a) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
    };
    half(&mut points.iter().copied());
    half(&mut points.iter().rev().copied());
    hull
}

/// Packs the charts' rectangles, tall ones first, into pieces: the piece and the place of each chart, and the sizes of the pieces.
fn pack(fits: &[Fit], padding: u32, page_size: u32) -> (Vec<(u32, UVec2)>, Vec<UVec2>) {
    let mut order: Vec<u32> = (0..fits.len() as u32).collect();
    let cells = |c: u32| fits[c as usize].cells;
    order.sort_unstable_by_key(|&c| (std::cmp::Reverse((cells(c).y, cells(c).x)), c));
    let padded: Vec<UVec2> = order.iter().map(|&c| cells(c) + padding).collect();
    let places = skyline::pack(&padded, page_size + padding);
    let mut of = vec![(0, UVec2::ZERO); fits.len()];
    let mut pieces = Vec::new();
    for (&c, &(piece, at)) in order.iter().zip(&places) {
        of[c as usize] = (piece, at);
        if pieces.len() <= piece as usize {
            pieces.resize(piece as usize + 1, UVec2::ZERO);
        }
        let size: &mut UVec2 = &mut pieces[piece as usize];
        *size = size.max(at + cells(c));
    }
    (of, pieces)
}
