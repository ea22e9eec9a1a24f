//! Virtual lights: many eyes ask about each, and three records near it answer (Ulbrich 2013, section 4.1).
//!
//! Eight eyes at a time, record after record; compiled for AVX2, too, with the same results to the bit.

use super::cache::{Cache, WHOLE_USE};
use super::map::{Map, Stand};
use super::neighbours::{Choice, NOBODY};
use super::paraboloid::{Scale, UNKNOWN};
use super::rays::{RecordsReader, SegmentEnd, least_distance};
use super::settings::{Lookup, RecordGuarantee, Select};
use crate::{
    BLOCK, Correction, EyeSample, LightEnd, ManyLights, Ray, SharedLight, Tracer, VisibilityStats,
};
use glam::Vec3;

/// Eyes that are answered together.
const WIDE: usize = 8;

type Row = [f32; WIDE];

/// One answer in `2^CHECKED` is checked by a ray ([`RecordGuarantee::Unbiased`]).
const CHECKED: u32 = 5;

/// Eight eyes.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
struct Pack {
    position: [Row; 3],
    normal: [Row; 3],
}

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    packs: Vec<Pack>,
    wanted: Vec<u16>,
    visible: Vec<u16>,
    corrections: Vec<Correction>,
    /// The lights asked about last, and who answers for them.
    lights: Vec<SharedLight>,
    choices: Vec<Choice>,
    version: Option<u64>,
    rays: Vec<Ray>,
    occluded: Vec<bool>,
    askers: Vec<u32>,
    guesses: Vec<f32>,
}

/// A record as the loop sees it.
struct Eye3<'a> {
    origin: Vec3,
    frame: [Vec3; 3],
    codes: &'a [u16],
    scale: Scale,
    /// Half the width of a map, texels.
    half: f32,
    last: f32,
    columns: u32,
    width: f32,
}

/// Which of eight eyes a record can judge, and which it sees, as bits.
#[inline(always)]
fn judge(record: &Eye3, pack: &Pack) -> (u32, u32) {
    let mut x = [0.0; WIDE];
    let mut y = [0.0; WIDE];
    let mut z = [0.0; WIDE];
    let mut length = [0.0; WIDE];
    let mut normal = [[0.0; 3]; WIDE];
    let mut least = [0.0; WIDE];
    let mut at = [0u32; WIDE];
    for k in 0..WIDE {
        let dx = pack.position[0][k] - record.origin.x;
        let dy = pack.position[1][k] - record.origin.y;
        let dz = pack.position[2][k] - record.origin.z;
        let along = |axis: Vec3| axis.x * dx + axis.y * dy + axis.z * dz;
        x[k] = along(record.frame[0]);
        y[k] = along(record.frame[1]);
        z[k] = along(record.frame[2]);
        length[k] = (x[k] * x[k] + y[k] * y[k] + z[k] * z[k]).sqrt();
        let [nx, ny, nz] = [pack.normal[0][k], pack.normal[1][k], pack.normal[2][k]];
        normal[k] = (record.frame).map(|axis| axis.x * nx + axis.y * ny + axis.z * nz);
    }
    for k in 0..WIDE {
        let scale = record.half / (length[k] + z[k]);
        let clamp = |v: f32| v.max(0.0).min(record.last);
        // SAFETY-free conversion: values lie between 0 and the last texel.
        let column = clamp(x[k] * scale + record.half) as u32;
        let row = clamp(y[k] * scale + record.half) as u32;
        at[k] = row * record.columns + column;
        let middle = [column, row].map(|i| (i as f32 + 0.5) * record.width - 1.0);
        least[k] = least_distance(
            [x[k], y[k], z[k]],
            length[k],
            normal[k],
            middle,
            record.width,
        );
    }
    let mut code = [0u16; WIDE];
    for k in 0..WIDE {
        code[k] = record.codes[at[k] as usize];
    }
    let (mut valid, mut seen) = (0, 0);
    for k in 0..WIDE {
        let known = z[k] > 0.0 && code[k] != UNKNOWN;
        let sees = record.scale.decode(code[k]) >= least[k];
        valid |= u32::from(known) << k;
        seen |= u32::from(known && sees) << k;
    }
    (valid, seen)
}

/// [`judge`] for many packs; those that nobody wants are left out.
#[inline(always)]
fn judge_all_here(record: &Eye3, packs: &[Pack], asked: &[u8], out: &mut [[u8; 2]]) {
    for ((pack, &asked), out) in packs.iter().zip(asked).zip(out) {
        if asked != 0 {
            let (valid, seen) = judge(record, pack);
            *out = [valid as u8, seen as u8];
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2")]
fn judge_all_avx2(record: &Eye3, packs: &[Pack], asked: &[u8], out: &mut [[u8; 2]]) {
    judge_all_here(record, packs, asked, out);
}

fn judge_all(record: &Eye3, packs: &[Pack], asked: &[u8], out: &mut [[u8; 2]]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2")
        && std::arch::is_x86_feature_detected!("bmi1")
        && std::arch::is_x86_feature_detected!("bmi2")
    {
        // SAFETY: the machine has the instructions.
        return unsafe { judge_all_avx2(record, packs, asked, out) };
    }
    judge_all_here(record, packs, asked, out);
}

/// A number from the bits of a question, for checks.
fn chance(eye: &EyeSample, light: &SharedLight, salt: u64) -> f32 {
    let mut h = salt;
    let target = light.target.unwrap_or_default();
    for word in eye.origin.to_array().into_iter().chain(target.to_array()) {
        h = (h ^ u64::from(word.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 32;
    }
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((h ^ (h >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// Answers about lights on surfaces; `epoch` tells checks apart.
pub(super) fn answer<T: Tracer>(
    cache: &Cache,
    tracer: &T,
    reader: &mut RecordsReader,
    scratch: &mut Scratch,
    stats: &mut VisibilityStats,
    eyes: &[EyeSample],
    lights: &[SharedLight],
    asker: &mut dyn ManyLights,
    epoch: u64,
) {
    scratch.packs.clear();
    for eyes in eyes.chunks(WIDE) {
        let mut pack = Pack::default();
        for k in 0..WIDE {
            let end = &eyes[k.min(eyes.len() - 1)].end;
            for c in 0..3 {
                pack.position[c][k] = end.position[c];
                pack.normal[c][k] = end.normal[c];
            }
        }
        scratch.packs.push(pack);
    }
    // Tiles ask about the same lights one after the other.
    if scratch.version != Some(cache.version()) || scratch.lights != lights {
        scratch.version = Some(cache.version());
        scratch.lights = lights.to_vec();
        let choose = |light: &SharedLight| match light.end {
            LightEnd::Surface(end) => {
                let mut choice = cache.choose(&mut reader.finder, end.position, end.normal);
                if cache.settings.select == Select::Nearest {
                    choice.ids[1..].fill(NOBODY);
                    choice.weights = [1.0, 0.0, 0.0];
                }
                choice
            }
            _ => Choice::NONE,
        };
        scratch.choices = lights.iter().map(choose).collect();
    }

    let packs = scratch.packs.len();
    let mut asked = vec![0u8; packs];
    let mut judged = [
        vec![[0u8; 2]; packs],
        vec![[0u8; 2]; packs],
        vec![[0u8; 2]; packs],
    ];
    scratch.visible.clear();
    scratch.visible.resize(eyes.len(), 0);
    for (block, lights) in lights.chunks(BLOCK).enumerate() {
        scratch.wanted.clear();
        scratch.wanted.resize(eyes.len(), 0);
        asker.wanted(block, &mut scratch.wanted);
        scratch.visible.fill(0);
        scratch.corrections.clear();
        for (l, light) in lights.iter().enumerate() {
            let mut count = 0;
            for (asked, wanted) in asked.iter_mut().zip(scratch.wanted.chunks(WIDE)) {
                let mut bits = 0;
                for (k, wanted) in wanted.iter().enumerate() {
                    bits |= ((wanted >> l & 1) as u8) << k;
                }
                *asked = bits;
                count += bits.count_ones();
            }
            if count == 0 {
                continue;
            }
            stats.queries += u64::from(count);
            let choice = scratch.choices[block * BLOCK + l];
            for (k, &id) in choice.ids.iter().enumerate() {
                if id == NOBODY {
                    judged[k].iter_mut().for_each(|bits| *bits = [0; 2]);
                    continue;
                }
                by_record(
                    cache,
                    id,
                    light,
                    &scratch.packs,
                    &asked,
                    eyes,
                    &mut judged[k],
                );
                let valid = judged[k].iter().zip(&asked);
                let uses: u32 = valid
                    .map(|(bits, asked)| (bits[0] & asked).count_ones())
                    .sum();
                let weight = (choice.weights[k] * WHOLE_USE as f32) as u64;
                cache.count(id, u64::from(uses) * weight);
            }
            let w = choice.weights;
            let place = light.target.unwrap_or_default();
            let reach2 = contact_reach(cache, &choice, place).powi(2);
            scratch.rays.clear();
            scratch.askers.clear();
            scratch.guesses.clear();
            let near = cache.settings.near;
            let unbiased = cache.settings.guarantee == RecordGuarantee::Unbiased;
            for (p, &asked) in asked.iter().enumerate() {
                if asked == 0 {
                    continue;
                }
                let at = |k: usize| judged[k][p].map(|bits| bits & asked);
                let ([v0, s0], [v1, s1], [v2, s2]) = (at(0), at(1), at(2));
                let known = (v0 | v1 | v2) & !near_to(&scratch.packs[p], place, reach2);
                let (some, all) = (s0 | s1 | s2, (s0 | !v0) & (s1 | !v1) & (s2 | !v2) & known);
                let first = p * WIDE;
                // Those whose records agree that they see it.
                let mut free = all;
                if near == 0.0 && !unbiased {
                    while free != 0 {
                        let k = free.trailing_zeros() as usize;
                        free &= free - 1;
                        scratch.visible[first + k] |= 1 << l;
                    }
                }
                // Everybody else who needs a number of their own.
                let mut rest = match (near == 0.0, unbiased) {
                    (_, true) => asked,
                    (true, false) => (some & known & !all) | (asked & !known),
                    (false, false) => (some & known) | (asked & !known),
                };
                while rest != 0 {
                    let k = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let bit = |bits: u8| f32::from(bits & known & (1 << k) != 0);
                    let sum = w[0] * bit(v0) + w[1] * bit(v1) + w[2] * bit(v2);
                    let seen = w[0] * bit(s0) + w[1] * bit(s1) + w[2] * bit(s2);
                    scratch.askers.push((first + k) as u32);
                    scratch
                        .guesses
                        .push(if sum > 0.0 { seen / sum } else { -1.0 });
                }
            }
            settle(
                cache, tracer, scratch, stats, eyes, light, l as u32, &choice, epoch,
            );
        }
        asker.take(block, &scratch.visible, &scratch.corrections);
    }
}

/// How near to a light its records have nothing to say.
fn contact_reach(cache: &Cache, choice: &Choice, light: Vec3) -> f32 {
    let mut parallax = 0.0;
    for (&id, weight) in choice.ids.iter().zip(choice.weights) {
        if id != NOBODY {
            parallax += weight * cache.stands[id as usize].site.position.distance(light);
        }
    }
    cache.contact_reach(parallax)
}

/// Which of eight eyes are nearer to a place than the root of `reach2`, as bits.
#[inline(always)]
fn near_to(pack: &Pack, place: Vec3, reach2: f32) -> u8 {
    let mut near = 0;
    for k in 0..WIDE {
        let d = [
            pack.position[0][k] - place.x,
            pack.position[1][k] - place.y,
            pack.position[2][k] - place.z,
        ];
        near |= u8::from(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] < reach2) << k;
    }
    near
}

fn by_record(
    cache: &Cache,
    id: u32,
    light: &SharedLight,
    packs: &[Pack],
    asked: &[u8],
    eyes: &[EyeSample],
    judged: &mut [[u8; 2]],
) {
    let stand: &Stand = &cache.stands[id as usize];
    let layout = &cache.layout;
    match cache.map(id) {
        Map::Distances(codes) if cache.settings.lookup == Lookup::Snap => {
            let record = Eye3 {
                origin: stand.site.position,
                frame: [stand.frame.x_axis, stand.frame.y_axis, stand.frame.z_axis],
                codes,
                scale: layout.scale,
                half: 0.5 * layout.resolution as f32,
                last: (layout.resolution - 1) as f32,
                columns: layout.resolution,
                width: layout.width(),
            };
            judge_all(&record, packs, asked, judged);
        }
        _ => {
            let from = light.target.unwrap_or_default();
            for (p, (judged, &asked)) in judged.iter_mut().zip(asked).enumerate() {
                let mut rest = asked;
                *judged = [0; 2];
                while rest != 0 {
                    let k = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let end = &eyes[p * WIDE + k].end;
                    let end = SegmentEnd::Surface(end.position, end.normal);
                    if let Some(seen) = cache.segment_by(id, from, end) {
                        judged[0] |= 1 << k;
                        judged[1] |= u8::from(seen) << k;
                    }
                }
            }
        }
    }
}

/// Answers that are not simply yes or no: averages, unknown ones, checks, and what a near blocker hides.
fn settle<T: Tracer>(
    cache: &Cache,
    tracer: &T,
    scratch: &mut Scratch,
    stats: &mut VisibilityStats,
    eyes: &[EyeSample],
    light: &SharedLight,
    l: u32,
    choice: &Choice,
    epoch: u64,
) {
    let near = cache.settings.near;
    let unbiased = cache.settings.guarantee == RecordGuarantee::Unbiased;
    // What becomes of an answer: the probability of a check.
    let check = |guess: f32, chance: f32| {
        if guess < 0.0 || guess > 0.0 && guess < 1.0 {
            Some(1.0)
        } else {
            let p = 1.0 / (1 << CHECKED) as f32;
            (chance < p).then_some(p)
        }
    };
    let checked = |guess: f32, e: u32| match unbiased {
        true => check(guess, chance(&eyes[e as usize], light, epoch)),
        false => (guess < 0.0).then_some(1.0),
    };
    scratch.rays.clear();
    for (&e, &guess) in scratch.askers.iter().zip(&scratch.guesses) {
        let ray = light.ray_from(eyes[e as usize].origin);
        if checked(guess, e).is_some() {
            scratch.rays.push(ray);
        } else if near > 0.0 && !unbiased && guess > 0.0 {
            // A stretch at each end, as long as the answer is uncertain there.
            let length = ray.direction.length();
            let footprint = cache.layout.width() * length;
            let record = &cache.stands[choice.ids[0] as usize].site;
            let parallax = light.target.map_or(0.0, |t| t.distance(record.position));
            let at_eye = (near * footprint / length).min(0.5);
            let at_light = (near * parallax.max(footprint) / length).min(0.5);
            scratch.rays.push(Ray {
                t_max: at_eye,
                ..ray
            });
            scratch.rays.push(Ray {
                t_min: 1.0 - at_light,
                ..ray
            });
        }
    }
    scratch.occluded.clear();
    scratch.occluded.resize(scratch.rays.len(), false);
    tracer.occluded_batch(&scratch.rays, &mut scratch.occluded);
    stats.traced += scratch.rays.len() as u64;
    let mut occluded = scratch.occluded.iter();
    let mut next = || occluded.next().is_some_and(|&occluded| occluded);
    for (&e, &guess) in scratch.askers.iter().zip(&scratch.guesses) {
        let mut answer = guess.max(0.0);
        if let Some(p) = checked(guess, e) {
            let truth = if next() { 0.0 } else { 1.0 };
            answer += (truth - answer) / p;
        } else if near > 0.0 && !unbiased && guess > 0.0 {
            let (at_eye, at_light) = (next(), next());
            if at_eye || at_light {
                answer = 0.0;
            }
        }
        if answer == 1.0 {
            scratch.visible[e as usize] |= 1 << l;
        } else if answer != 0.0 {
            scratch.corrections.push(Correction {
                eye: e,
                light: l,
                amount: answer,
            });
        }
    }
}
