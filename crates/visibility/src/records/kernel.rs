//! Sixteen eyes at a time: what one record knows about them, and what three records together say.
//!
//! Ulbrich et al. 2013, section 4.1: a virtual light is judged by the three records near it, by the distance that each holds in the eye's direction. The
//! wrong tool for few eyes or many lights an eye, where packs stay empty: there a ray costs less.
//!
//! No divisions but one: [`shows`] has them multiplied out.

use super::paraboloid::{Scale, UNKNOWN};
use super::rays::shows;
use crate::wide::wide;
use glam::Vec3;

/// Eyes that are answered together; a set of them is 16 bits.
pub(super) const WIDE: usize = 16;

type Row = [f32; WIDE];

/// Sixteen eyes.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(super) struct Pack {
    pub(super) position: [Row; 3],
    pub(super) normal: [Row; 3],
}

/// What a record knows of a pack: whom it can judge, and whom of them it sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Verdict {
    pub(super) known: u16,
    pub(super) seen: u16,
}

/// A record as the loop sees it.
pub(super) struct Record<'a> {
    pub(super) origin: Vec3,
    /// Tangent, bitangent, normal.
    pub(super) frame: [Vec3; 3],
    /// Square of texels.
    pub(super) codes: &'a [u16],
    pub(super) scale: Scale,
    pub(super) resolution: u32,
}

#[inline(always)]
fn bits(flags: [bool; WIDE]) -> u16 {
    let mut set = [0u16; WIDE];
    for k in 0..WIDE {
        set[k] = u16::from(flags[k]) << k;
    }
    set.iter().fold(0, |all, &bit| all | bit)
}

#[inline(always)]
fn judge(record: &Record, pack: &Pack) -> Verdict {
    let half = 0.5 * record.resolution as f32;
    let last = (record.resolution - 1) as f32;
    let width = 2.0 / record.resolution as f32;
    let [x_axis, y_axis, z_axis] = record.frame;
    let mut at = [0i32; WIDE];
    let (mut z, mut length) = ([0.0; WIDE], [0.0; WIDE]);
    let (mut here, mut there, mut r2) = ([0.0; WIDE], [0.0; WIDE], [0.0; WIDE]);
    for k in 0..WIDE {
        let d = Vec3::new(
            pack.position[0][k] - record.origin.x,
            pack.position[1][k] - record.origin.y,
            pack.position[2][k] - record.origin.z,
        );
        let n = Vec3::new(pack.normal[0][k], pack.normal[1][k], pack.normal[2][k]);
        let (x, y) = (x_axis.dot(d), y_axis.dot(d));
        z[k] = z_axis.dot(d);
        length[k] = (x * x + y * y + z[k] * z[k]).sqrt();
        let scale = half / (length[k] + z[k]);
        // The comparisons also take care of NaN.
        let clamp = |v: f32| {
            let v = if v > 0.0 { v } else { 0.0 };
            if v < last { v } else { last }
        };
        let (column, row) = (clamp(x * scale + half), clamp(y * scale + half));
        // SAFETY: both lie between 0 and the last texel.
        let (column, row): (i32, i32) =
            unsafe { (column.to_int_unchecked(), row.to_int_unchecked()) };
        at[k] = row * record.resolution as i32 + column;
        let middle = |i: i32| (i as f32 + 0.5) * width - 1.0;
        let (s, t) = (middle(column), middle(row));
        r2[k] = s * s + t * t;
        here[k] = n.dot(d);
        let across = 2.0 * (s * x_axis.dot(n) + t * y_axis.dot(n));
        there[k] = across + z_axis.dot(n) * (1.0 - r2[k]);
    }
    let mut code = [0u16; WIDE];
    for k in 0..WIDE {
        code[k] = record.codes[at[k] as usize];
    }
    let (mut known, mut seen) = ([false; WIDE], [false; WIDE]);
    for k in 0..WIDE {
        known[k] = z[k] > 0.0 && code[k] != UNKNOWN;
        seen[k] = shows(
            record.scale.decode(code[k]),
            length[k],
            here[k],
            [there[k], 1.0 + r2[k]],
            width * (length[k] + z[k]),
        );
    }
    let known = bits(known);
    Verdict {
        known,
        seen: known & bits(seen),
    }
}

/// The sets of asked eyes that three records know, that see with certainty, and of which some record says so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Agreement {
    pub(super) known: u16,
    pub(super) all: u16,
    pub(super) some: u16,
}

/// What records together say about eyes that are not too near to the light.
#[inline(always)]
fn agree(pack: &Pack, asked: u16, verdicts: [Verdict; 3], light: Vec3, reach2: f32) -> Agreement {
    let near = std::array::from_fn(|k| {
        let d = [
            pack.position[0][k] - light.x,
            pack.position[1][k] - light.y,
            pack.position[2][k] - light.z,
        ];
        d[0] * d[0] + d[1] * d[1] + d[2] * d[2] < reach2
    });
    let [a, b, c] = verdicts;
    let known = (a.known | b.known | c.known) & asked & !bits(near);
    Agreement {
        known,
        all: (a.seen | !a.known) & (b.seen | !b.known) & (c.seen | !c.known) & known,
        some: (a.seen | b.seen | c.seen) & known,
    }
}

wide! {
    /// What a record knows about packs of eyes; those of which nobody is asked about are left as they are.
    pub(super) fn judge_all(record: &Record, packs: &[Pack], asked: &[u16], out: &mut [Verdict]) {
        for ((pack, &asked), out) in packs.iter().zip(asked).zip(out) {
            if asked != 0 {
                *out = judge(record, pack);
            }
        }
    }
}

wide! {
    /// What three records together say about the eyes that are asked about; nothing about those nearer to the light than the root of
    /// `near`'s second.
    pub(super) fn agree_all(
        packs: &[Pack],
        asked: &[u16],
        verdicts: &[Vec<Verdict>; 3],
        near: (Vec3, f32),
        out: &mut [Agreement],
    ) {
        let [a, b, c] = verdicts;
        let verdicts = a.iter().zip(b).zip(c);
        let packs = packs.iter().zip(asked);
        for (((pack, &asked), ((&a, &b), &c)), out) in packs.zip(verdicts).zip(out) {
            *out = if asked == 0 {
                Agreement::default()
            } else {
                agree(pack, asked, [a, b, c], near.0, near.1)
            };
        }
    }
}

/// Turns sixteen sets of lights, one an eye, into sixteen sets of eyes, one a light, and back.
#[inline]
pub(super) fn transpose(rows: &mut [u16; WIDE]) {
    let (mut j, mut mask) = (8, 0x00ff_u16);
    while j != 0 {
        for k in (0..WIDE).filter(|k| k & j == 0) {
            let swap = ((rows[k] >> j) ^ rows[k | j]) & mask;
            rows[k | j] ^= swap;
            rows[k] ^= swap << j;
        }
        j >>= 1;
        mask ^= mask << j;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wide::Machine;

    #[test]
    fn rows_become_columns() {
        let mut rows: [u16; WIDE] =
            std::array::from_fn(|k| (k as u16 + 3).wrapping_mul(0x9e37) ^ 0x5a5a);
        let before = rows;
        transpose(&mut rows);
        for (k, row) in before.iter().enumerate() {
            for (l, column) in rows.iter().enumerate() {
                assert_eq!(row >> l & 1, column >> k & 1);
            }
        }
        transpose(&mut rows);
        assert_eq!(rows, before);
    }

    /// All machines say the same; so does the single question.
    #[test]
    fn sixteen_eyes_are_judged_as_one_is() {
        use super::super::cache::Random;
        use super::super::map::{Site, Stand};
        use super::super::paraboloid::Layout;
        let layout = Layout::new(32, 10.0);
        let mut random = Random(5);
        let mut unit = || random.unit();
        let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
        let site = Site {
            position: Vec3::new(0.1, 0.2, 0.3),
            normal,
            origin: Vec3::new(0.1, 0.2, 0.3),
        };
        let stand = Stand::new(site);
        let codes: Vec<u16> = (0..32 * 32)
            .map(|k| match k % 7 {
                0 => UNKNOWN,
                1 => super::super::paraboloid::SKY,
                _ => layout.scale.encode(4.0 * unit()),
            })
            .collect();
        let record = Record {
            origin: site.position,
            frame: stand.axes(),
            codes: &codes,
            scale: layout.scale,
            resolution: 32,
        };
        let mut packs = vec![Pack::default(); 200];
        for pack in &mut packs {
            for k in 0..WIDE {
                let n = Vec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5).normalize();
                for c in 0..3 {
                    pack.position[c][k] = 6.0 * unit() - 3.0;
                    pack.normal[c][k] = n[c];
                }
            }
        }
        // Damaged eyes make no difference to others.
        packs[0].position[0][0] = f32::NAN;
        packs[1].position[1][3] = f32::INFINITY;
        packs[2].normal[1][3] = f32::NAN;
        let asked = vec![u16::MAX; packs.len()];
        let judged = |machine| {
            let mut out = vec![Verdict::default(); packs.len()];
            judge_all(machine, &record, &packs, &asked, &mut out);
            out
        };
        let machines = Machine::all();
        let plain = judged(machines[0]);
        for &machine in &machines[1..] {
            assert_eq!(judged(machine), plain, "{machine:?}");
        }
        let seen: u32 = plain.iter().map(|v| v.seen.count_ones()).sum();
        let known: u32 = plain.iter().map(|v| v.known.count_ones()).sum();
        assert!(
            known > 1000 && seen > 300 && known - seen > 300,
            "{known} {seen}"
        );
        for (pack, verdict) in packs.iter().zip(&plain) {
            for k in 0..WIDE {
                let take = |rows: &[Row; 3]| Vec3::from_array(std::array::from_fn(|c| rows[c][k]));
                let p = stand.local(take(&pack.position) - site.position);
                let n = stand.local(take(&pack.normal));
                if !p.is_finite() || !n.is_finite() {
                    continue;
                }
                let texel = layout.texel(p.x, p.y, p.length() + p.z);
                let code = codes[texel as usize];
                let known = p.z > 0.0 && code != UNKNOWN;
                assert_eq!(known, verdict.known >> k & 1 != 0);
                let (there, footprint) = layout.facing(texel, n, p);
                let held = layout.scale.decode(code);
                let sees = known && shows(held, p.length(), n.dot(p), there, footprint);
                // Rounding may decide on the edge alone.
                let edge = [0.9999, 1.0001]
                    .map(|f| known && shows(held * f, p.length(), n.dot(p), there, footprint));
                assert!(sees == (verdict.seen >> k & 1 != 0) || edge[0] != edge[1]);
            }
        }
    }
}
