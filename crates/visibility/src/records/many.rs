//! Virtual lights: many eyes ask about each, and three records near it answer (Ulbrich 2013, section 4.1).
//!
//! Sixteen eyes at a time, record after record (`kernel`).

use super::cache::{Cache, WHOLE_USE};
use super::kernel::{Agreement, Pack, Record, Verdict, WIDE, agree_all, judge_all, transpose};
use super::map::{Map, Stand};
use super::neighbours::NOBODY;
use super::ranking::Nearby;
use super::rays::SegmentEnd;
use super::settings::{Lookup, RecordGuarantee, Select};
use crate::wide::Machine;
use crate::{
    BLOCK, Correction, EyeSample, LightEnd, ManyLights, Ray, Reason, SharedLight, Tracer,
    VisibilityStats,
};
use glam::Vec3;

const _: () = assert!(BLOCK == WIDE, "sets of lights and of eyes are transposed");

/// One answer in `2^CHECKED` is checked by a ray ([`RecordGuarantee::Unbiased`]).
const CHECKED: u32 = 5;

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    packs: Vec<Pack>,
    wanted: Vec<u16>,
    visible: Vec<u16>,
    /// Sets of eyes, pack by pack, of the lights of a block: who asks, and who sees.
    asked: Vec<Vec<u16>>,
    seen: Vec<Vec<u16>>,
    verdicts: [Vec<Verdict>; 3],
    agreements: Vec<Agreement>,
    corrections: Vec<Correction>,
    /// The lights asked about last, and who answers for them.
    lights: Vec<SharedLight>,
    choices: Vec<Nearby>,
    version: Option<u64>,
    rays: Vec<Ray>,
    occluded: Vec<bool>,
    askers: Vec<u32>,
    guesses: Vec<f32>,
}

/// A number from the bits of a question, for checks: the same whichever pass of whichever part of the work asks.
fn chance(eye: &EyeSample, light: &SharedLight) -> f32 {
    let mut h = 0u64;
    let target = light.target.unwrap_or_default();
    for word in eye.origin.to_array().into_iter().chain(target.to_array()) {
        h = (h ^ u64::from(word.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 32;
    }
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((h ^ (h >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// Answers about lights on surfaces.
pub(super) fn answer<T: Tracer>(
    cache: &Cache,
    tracer: &T,
    scratch: &mut Scratch,
    stats: &mut VisibilityStats,
    eyes: &[EyeSample],
    lights: &[SharedLight],
    asker: &mut dyn ManyLights,
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
                if let Some(own) = cache.own(end.position, end.normal) {
                    return Nearby::alone(own);
                }
                let mut choice = cache.nearby(end.position, end.normal);
                if cache.settings.select == Select::Nearest {
                    choice.ids[1..].fill(NOBODY);
                    choice.weights = [1.0, 0.0, 0.0];
                }
                choice
            }
            _ => Nearby::NOBODY,
        };
        scratch.choices = lights.iter().map(choose).collect();
    }

    let packs = scratch.packs.len();
    let machine = Machine::detect();
    let near = cache.settings.near;
    let unbiased = cache.settings.guarantee == RecordGuarantee::Unbiased;
    for verdicts in &mut scratch.verdicts {
        verdicts.resize(packs, Verdict::default());
    }
    scratch.agreements.resize(packs, Agreement::default());
    for sets in [&mut scratch.asked, &mut scratch.seen] {
        sets.resize(BLOCK, Vec::new());
        sets.iter_mut().for_each(|set| set.resize(packs, 0));
    }
    for (block, lights) in lights.chunks(BLOCK).enumerate() {
        scratch.wanted.clear();
        scratch.wanted.resize(packs * WIDE, 0);
        asker.wanted(block, &mut scratch.wanted[..eyes.len()]);
        for (p, wanted) in scratch.wanted.as_chunks::<WIDE>().0.iter().enumerate() {
            let mut sets = *wanted;
            transpose(&mut sets);
            for (asked, set) in scratch.asked.iter_mut().zip(sets) {
                asked[p] = set;
            }
        }
        scratch.corrections.clear();
        for (l, light) in lights.iter().enumerate() {
            let asked = &scratch.asked[l];
            let seen = &mut scratch.seen[l];
            let count: u32 = asked.iter().map(|asked| asked.count_ones()).sum();
            if count == 0 {
                seen.fill(0);
                continue;
            }
            stats.queries += u64::from(count);
            let choice = scratch.choices[block * BLOCK + l];
            for ((&id, w), verdicts) in
                (choice.ids.iter().zip(choice.weights)).zip(&mut scratch.verdicts)
            {
                if id == NOBODY {
                    verdicts.fill(Verdict::default());
                    continue;
                }
                by_record(
                    cache,
                    machine,
                    id,
                    light,
                    &scratch.packs,
                    asked,
                    eyes,
                    verdicts,
                );
                let known = verdicts.iter().zip(asked);
                let uses: u32 = known
                    .map(|(verdict, asked)| (verdict.known & asked).count_ones())
                    .sum();
                let weight = (w * WHOLE_USE as f32) as u64;
                cache.count(id, u64::from(uses) * weight);
            }
            let place = light.target.unwrap_or_default();
            let reach2 = contact_reach(cache, &choice, place).powi(2);
            agree_all(
                machine,
                &scratch.packs,
                asked,
                &scratch.verdicts,
                (place, reach2),
                &mut scratch.agreements,
            );
            scratch.askers.clear();
            scratch.guesses.clear();
            for (p, (&asked, agreement)) in asked.iter().zip(&scratch.agreements).enumerate() {
                let Agreement { known, all, some } = *agreement;
                // Those whose records agree that they see it.
                let free = near == 0.0 && !unbiased;
                seen[p] = if free { all } else { 0 };
                // Everybody else who needs a number of their own.
                let mut rest = match (near == 0.0, unbiased) {
                    (_, true) => asked,
                    (true, false) => (some & !all) | (asked & !known),
                    (false, false) => some | (asked & !known),
                };
                while rest != 0 {
                    let k = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let (mut sum, mut sight) = (0.0, 0.0);
                    if known & 1 << k == 0 {
                        let eye = eyes[p * WIDE + k].end.position;
                        let reason = silent(cache, &choice, (place, reach2), eye);
                        stats.unanswered.count(reason);
                    } else {
                        for (verdicts, w) in scratch.verdicts.iter().zip(choice.weights) {
                            let bit = |set: u16| f32::from(set >> k & 1);
                            sum += w * bit(verdicts[p].known);
                            sight += w * bit(verdicts[p].seen);
                        }
                    }
                    scratch.askers.push((p * WIDE + k) as u32);
                    scratch
                        .guesses
                        .push(if sum > 0.0 { sight / sum } else { -1.0 });
                }
            }
            settle(
                cache, tracer, scratch, stats, eyes, light, l as u32, &choice,
            );
        }
        for seen in &mut scratch.seen[lights.len()..] {
            seen.fill(0);
        }
        scratch.visible.clear();
        for p in 0..packs {
            let mut sets: [u16; WIDE] = std::array::from_fn(|l| scratch.seen[l][p]);
            transpose(&mut sets);
            scratch.visible.extend(sets);
        }
        asker.take(block, &scratch.visible[..eyes.len()], &scratch.corrections);
    }
}

/// How near to a light its records have nothing to say; one that stands on it sees what the light sees.
fn contact_reach(cache: &Cache, choice: &Nearby, light: Vec3) -> f32 {
    let own = |&id: &u32| id != NOBODY && cache.stands[id as usize].site.origin == light;
    if choice.ids[1] == NOBODY && own(&choice.ids[0]) {
        return 0.0;
    }
    let mut parallax = 0.0;
    for (&id, weight) in choice.ids.iter().zip(choice.weights) {
        if id != NOBODY {
            parallax += weight * cache.stands[id as usize].site.position.distance(light);
        }
    }
    cache.contact_reach(parallax)
}

/// Why the records of a light do not know whether an eye sees it: the light's place, and the square of how near to it they have nothing to
/// say.
fn silent(cache: &Cache, choice: &Nearby, (light, reach2): (Vec3, f32), eye: Vec3) -> Reason {
    let records = || choice.ids.iter().filter(|&&id| id != NOBODY);
    let above = |&id: &u32| {
        let stand = &cache.stands[id as usize];
        stand.site.normal.dot(eye - stand.site.position) > 0.0
    };
    if records().next().is_none() {
        Reason::NoRecord
    } else if eye.distance_squared(light) < reach2 {
        Reason::TooNear
    } else if records().any(above) {
        Reason::Unknown
    } else {
        Reason::BelowHorizon
    }
}

/// What a record says about the eyes that ask.
fn by_record(
    cache: &Cache,
    machine: Machine,
    id: u32,
    light: &SharedLight,
    packs: &[Pack],
    asked: &[u16],
    eyes: &[EyeSample],
    verdicts: &mut [Verdict],
) {
    let stand: &Stand = &cache.stands[id as usize];
    match cache.map(id) {
        Map::Distances(codes) if cache.settings.lookup != Lookup::March => {
            let record = Record {
                origin: stand.site.position,
                frame: stand.axes(),
                codes,
                scale: cache.layout.scale,
                resolution: cache.layout.resolution,
            };
            judge_all(machine, &record, packs, asked, verdicts);
        }
        _ => {
            let from = light.target.unwrap_or_default();
            for (p, (verdict, &asked)) in verdicts.iter_mut().zip(asked).enumerate() {
                let mut rest = asked;
                *verdict = Verdict::default();
                while rest != 0 {
                    let k = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let end = &eyes[p * WIDE + k].end;
                    let end = SegmentEnd::Surface(end.position, end.normal);
                    if let Some(seen) = cache.segment_by(id, from, end) {
                        verdict.known |= 1 << k;
                        verdict.seen |= u16::from(seen) << k;
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
    choice: &Nearby,
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
        true => check(guess, chance(&eyes[e as usize], light)),
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
            scratch.seen[l as usize][e as usize / WIDE] |= 1 << (e as usize % WIDE);
        } else if answer != 0.0 {
            scratch.corrections.push(Correction {
                eye: e,
                light: l,
                amount: answer,
            });
        }
    }
}
