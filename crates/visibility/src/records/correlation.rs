//! How much of what one record sees another one sees, too (Ulbrich 2013, section 3.2, with the 1024 directions of section 5).
//!
//! What `p` sees is seen again by `p'` if the record of `p'` holds about that distance in the point's direction: up to [`SAME_WITHIN`] texels.
//! Sky agrees with sky; a point below the other's horizon is not seen.
//!
//! All directions go through one step after the other, so that the steps are vectors of numbers and the reads of the maps wait for each other's
//! arrival together: several times as fast as direction by direction.
//!
//! The wrong tool to compare two maps texel by texel: of 128x128 it looks at a twelfth.

use super::map::{Map, Stand};
use super::paraboloid::{Layout, PROBES, SKY, UNKNOWN};
use crate::wide::{Machine, wide};
use glam::{Mat3, Vec3};

/// Points that two records see are the same if they are nearer to each other than this many texels.
const SAME_WITHIN: f32 = 1.5;

/// Directions that go through a step together.
const WIDE: usize = 16;

/// Numbers of [`WIDE`] directions.
type Row = [f32; WIDE];

const _: () = assert!(PROBES.is_multiple_of(WIDE));

/// Two records: the frame of the other, seen from the first, and where the first stands in it.
struct Pair<'a> {
    layout: &'a Layout,
    turn: Mat3,
    offset: Vec3,
    map: &'a Map,
    other: &'a Map,
}

/// Share of directions in which the first record sees what the second sees, too.
pub(super) fn agreement(
    machine: Machine,
    layout: &Layout,
    (here, map): (&Stand, &Map),
    (there, other): (&Stand, &Map),
) -> f32 {
    let pair = Pair {
        layout,
        turn: there.frame().transpose() * here.frame(),
        offset: there.local(here.site.origin - there.site.origin),
        map,
        other,
    };
    count(machine, &pair) as f32 / PROBES as f32
}

wide! {
    /// Directions in which the second record sees what the first sees.
    fn count(pair: &Pair) -> u32 {
        let Layout { scale, probes, .. } = pair.layout;
        let mut held = [0u16; PROBES];
        for (held, &texel) in held.iter_mut().zip(&probes.texels) {
            *held = pair.map.code(texel);
        }
        // How far the point is from the other record, how exactly both know it, and the texel in which it would be.
        let mut length = [0.0; PROBES];
        let mut within = [0.0; PROBES];
        let mut at = [0i32; PROBES];
        let mut above = [false; PROBES];
        let (held_rows, _) = held.as_chunks::<WIDE>();
        let (length_rows, _) = length.as_chunks_mut::<WIDE>();
        let (within_rows, _) = within.as_chunks_mut::<WIDE>();
        let (at_rows, _) = at.as_chunks_mut::<WIDE>();
        let (above_rows, _) = above.as_chunks_mut::<WIDE>();
        let [x, y, z] = probes
            .directions
            .each_ref()
            .map(|c| c.as_chunks::<WIDE>().0);
        for (k, held) in held_rows.iter().enumerate() {
            locate(
                pair,
                [&x[k], &y[k], &z[k]],
                held,
                (&mut length_rows[k], &mut within_rows[k]),
                (&mut at_rows[k], &mut above_rows[k]),
            );
        }
        let mut theirs = [0u16; PROBES];
        for (theirs, &at) in theirs.iter_mut().zip(&at) {
            *theirs = pair.other.code(at as u32);
        }
        let mut agree = 0;
        for k in 0..PROBES {
            let apart = (scale.decode(theirs[k]) - length[k]).abs();
            let skies = held[k] == SKY || theirs[k] == SKY;
            let same = if skies {
                held[k] == theirs[k]
            } else {
                apart < within[k]
            };
            agree += u32::from(above[k] & (held[k] != UNKNOWN) & same);
        }
        agree
    }
}

/// Where the other record would find what the first one sees.
#[inline(always)]
fn locate(
    pair: &Pair,
    [x, y, z]: [&Row; 3],
    held: &[u16; WIDE],
    (length, within): (&mut Row, &mut Row),
    (at, above): (&mut [i32; WIDE], &mut [bool; WIDE]),
) {
    let Layout {
        scale, resolution, ..
    } = *pair.layout;
    let width = pair.layout.width();
    let half = 0.5 * resolution as f32;
    let last = (resolution - 1) as f32;
    for k in 0..WIDE {
        let d = pair.turn * Vec3::new(x[k], y[k], z[k]);
        // The sky has a direction, not a place.
        let sky = held[k] == SKY;
        let distance = if sky { 1.0 } else { scale.decode(held[k]) };
        let start = if sky { 0.0 } else { 1.0 };
        let point = pair.offset * start + d * distance;
        let far = (point.x * point.x + point.y * point.y + point.z * point.z).sqrt();
        let denominator = far + point.z;
        let mine = distance * width * (1.0 + z[k]);
        let theirs = width * denominator;
        within[k] = SAME_WITHIN * if mine > theirs { mine } else { theirs };
        length[k] = far;
        above[k] = point.z > 0.0;
        let to_texel = half / denominator;
        // The comparisons also take care of NaN.
        let clamp = |v: f32| {
            let v = if v > 0.0 { v } else { 0.0 };
            if v < last { v } else { last }
        };
        let column = clamp(point.x * to_texel + half);
        let row = clamp(point.y * to_texel + half);
        // SAFETY: both lie between 0 and the last texel.
        let (column, row): (i32, i32) =
            unsafe { (column.to_int_unchecked(), row.to_int_unchecked()) };
        at[k] = row * resolution as i32 + column;
    }
}

#[cfg(test)]
mod tests {
    use super::super::cache::Random;
    use super::super::map::Site;
    use super::*;

    /// All machines say the same, and the same as direction by direction.
    #[test]
    fn steps_together_count_as_one_by_one_does() {
        let layout = Layout::new(32, 10.0);
        let mut random = Random(9);
        let mut whole = 0;
        for round in 0..40 {
            let mut unit = || random.unit();
            let mut stand = |spread: f32| {
                let around = Vec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5);
                let position = around * spread;
                Stand::new(Site {
                    position,
                    normal: (Vec3::Z + around).normalize(),
                    origin: position,
                })
            };
            let (here, there) = (stand(0.2), stand(0.2));
            let map = |random: &mut Random| {
                let codes = (0..32 * 32).map(|k| match k % 9 {
                    0 => UNKNOWN,
                    1 | 2 => SKY,
                    _ => layout.scale.encode(2.0 + 0.6 * random.unit()),
                });
                Map::Distances(codes.collect())
            };
            let (map, other) = (map(&mut random), map(&mut random));
            let mut agree = 0;
            let (texels, [x, y, z]) = (&layout.probes.texels, &layout.probes.directions);
            for k in 0..PROBES {
                let direction = Vec3::new(x[k], y[k], z[k]);
                let code = map.code(texels[k]);
                let (point, footprint) = if code == SKY {
                    (there.local(here.world(direction)), 0.0)
                } else {
                    let distance = layout.scale.decode(code);
                    let seen = here.site.origin + here.world(direction) * distance;
                    let footprint = distance * layout.width() * (1.0 + direction.z);
                    (there.local(seen - there.site.origin), footprint)
                };
                if code == UNKNOWN || point.z <= 0.0 {
                    continue;
                }
                let length = point.length();
                let seen = other.code(layout.texel(point.x, point.y, length + point.z));
                let theirs = layout.width() * (length + point.z);
                let apart = (layout.scale.decode(seen) - length).abs();
                agree += if code == SKY || seen == SKY {
                    u32::from(code == seen)
                } else {
                    u32::from(apart < SAME_WITHIN * footprint.max(theirs))
                };
            }
            let by = |machine| agreement(machine, &layout, (&here, &map), (&there, &other));
            let machines = Machine::all();
            let plain = by(machines[0]);
            for &machine in &machines[1..] {
                assert_eq!(by(machine), plain, "{machine:?}");
            }
            // Rounding decides on the edge alone.
            let apart = (plain * PROBES as f32) as i32 - agree as i32;
            assert!(apart.abs() <= 3, "{round}: {plain} {agree}");
            whole += agree;
        }
        let mean = whole as f32 / (40 * PROBES) as f32;
        assert!((0.05..0.95).contains(&mean), "{mean}");
    }
}
