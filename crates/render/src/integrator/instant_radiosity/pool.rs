//! Virtual lights that stay from picture to picture of a sequence.
//!
//! Drawn anew for every picture, they would make indirect light flicker, and caches could not recognise them. So the Morton
//! curve is cut into stretches with a block of lights each, and in every picture only a few stretches are drawn anew, in turns:
//! two neighbours at a time, with new light paths, judged by what they bring to the present view. Each stretch stands for the
//! virtual lights of its own part of the world, whenever it was drawn, so the expected picture is that of lights that are all
//! new; the inner border of the two moves to where both halves have a block's worth of lights, and the number of lights follows
//! what the stretch brings now.
//!
//! All of this holds while surfaces and lights stand still. When they move, or the view jumps so that the old lights have little to do
//! with it, all lights are drawn anew. The lights are those of `vpl` (Keller 1997, chosen as by Segovia et al. 2006); that they stay is ours. The
//! wrong tool for pictures that must not depend on the ones before.

use super::Prepared;
use super::shade::{Kind, LightList};
use super::vpl::{self, Candidate, Curve, Drawn};
use crate::camera::View;
use crate::integrator::{RenderSettings, World};
use occlude_visibility::BLOCK;
use std::ops::Range;

/// Eye samples by which lights are judged between pictures.
const PILOTS: usize = 64;

/// Of the candidates outside of a stretch, one in this many is judged, to find the share of the stretch.
const OTHERS: usize = 8;

/// Light paths are this much fewer than for a whole set.
const FEWER_PATHS: usize = 4;

/// All lights are drawn anew when they serve the view this much worse than at first.
const JUMP: f64 = 4.0;

/// Virtual lights of a sequence.
#[derive(Clone, Debug)]
pub(in crate::integrator) struct Pool {
    curve: Curve,
    stretches: Vec<Stretch>,
    clamp: f32,
    paths: usize,
    /// Numbers of light paths that are used up.
    stream: u32,
    /// The stretch to be drawn anew next, and the one that the next round starts with.
    next: usize,
    start: usize,
    /// Blocks that should have been drawn anew by now.
    due: u32,
    /// How well the lights served the view when all were new, see [`Pool::service`].
    service: f64,
}

/// A part of the Morton curve up to the next one, with at most a block of lights.
#[derive(Clone, Debug)]
struct Stretch {
    first: u64,
    lights: Vec<Drawn>,
}

/// The lights of one picture.
pub(super) struct Lights {
    pub(super) list: LightList,
    /// Lights in it that shine.
    pub(super) count: u32,
    pub(super) clamp: f32,
    /// Lights that the picture before did not have.
    pub(super) renewed: u32,
    /// Rays traced.
    pub(super) rays: u64,
}

/// The lights of a sequence's next picture. `renew` blocks are drawn anew; all of them, if it is `None`.
pub(super) fn next(
    pool: &mut Option<Pool>,
    renew: Option<u32>,
    world: &World,
    view: &View,
    settings: &RenderSettings,
    prepared: &Prepared,
) -> Lights {
    let mut rays = 0;
    let mut stream = 0;
    if let (Some(old), Some(renew)) = (&mut *pool, renew) {
        let (service, judged) = old.service(world, view, settings, prepared);
        rays += judged;
        if service * JUMP >= old.service {
            let (renewed, traced) = old.renew(renew, world, view, settings, prepared);
            let list = old.list(prepared);
            return Lights {
                list,
                count: old.lights().len() as u32,
                clamp: old.clamp,
                renewed,
                rays: rays + traced,
            };
        }
        stream = old.stream;
    }
    let made = vpl::make(world, view, settings, prepared, stream);
    rays += made.rays;
    let chunks = made.drawn.chunks(BLOCK).enumerate();
    let mut new = Pool {
        stretches: chunks
            .map(|(i, lights)| Stretch {
                first: if i == 0 { 0 } else { lights[0].code },
                lights: lights.to_vec(),
            })
            .collect(),
        curve: made.curve,
        clamp: made.clamp,
        paths: (made.paths / FEWER_PATHS).max(prepared.settings.vpls as usize),
        stream: stream + 2,
        next: 0,
        start: 0,
        due: 0,
        service: 0.0,
    };
    let lights = Lights {
        list: new.list(prepared),
        count: made.drawn.len() as u32,
        clamp: made.clamp,
        renewed: made.drawn.len() as u32,
        rays,
    };
    if renew.is_some() && !new.stretches.is_empty() {
        (new.service, _) = new.service(world, view, settings, prepared);
        *pool = Some(new);
    } else {
        *pool = None;
    }
    lights
}

impl Pool {
    fn lights(&self) -> Vec<Candidate> {
        let lights = self.stretches.iter().flat_map(|stretch| &stretch.lights);
        lights.map(|drawn| drawn.light).collect()
    }

    fn list(&self, prepared: &Prepared) -> LightList {
        let mut list = LightList::new(Kind::Patch);
        for (i, stretch) in self.stretches.iter().enumerate() {
            for drawn in &stretch.lights {
                vpl::push(&mut list, &drawn.light, prepared.settings.vpls);
            }
            // A block belongs to one stretch, so that it stays the same while the stretch does.
            if i + 1 < self.stretches.len() {
                list.fill_block();
            }
        }
        list
    }

    /// How evenly the lights bring light to the view: the share of them that would do as well if all brought alike.
    fn service(
        &self,
        world: &World,
        view: &View,
        settings: &RenderSettings,
        prepared: &Prepared,
    ) -> (f64, u64) {
        let (pilots, walked) = vpl::pilots(world, view, settings, prepared, PILOTS);
        let lights = self.lights();
        let (brought, traced) = vpl::judge(world, &lights, &pilots, self.clamp);
        let sum: f64 = brought.iter().sum();
        let squares: f64 = brought.iter().map(|b| b * b).sum();
        let even = if squares > 0.0 {
            sum * sum / squares / lights.len() as f64
        } else {
            0.0
        };
        (even, walked + traced)
    }

    /// Draws `blocks` stretches anew, on average; returns the number of new lights, and of rays.
    fn renew(
        &mut self,
        blocks: u32,
        world: &World,
        view: &View,
        settings: &RenderSettings,
        prepared: &Prepared,
    ) -> (u32, u64) {
        self.due = self.due.saturating_add(blocks);
        if self.due < 2 {
            return (0, 0);
        }
        let wanted = &prepared.settings;
        let stream = self.stream;
        self.stream += 1;
        let (candidates, mut rays) = vpl::candidates(world, settings, wanted, self.paths, stream);
        let order = self.curve.order(&candidates);
        let (pilots, walked) = vpl::pilots(world, view, settings, prepared, PILOTS);
        rays += walked;
        let some: Vec<Candidate> = candidates.iter().step_by(OTHERS).copied().collect();
        let (brought, traced) = vpl::judge(world, &some, &pilots, self.clamp);
        rays += traced;
        let all_brought = OTHERS as f64 * brought.iter().sum::<f64>();
        let offset = vpl::offset(settings, stream);
        let (mut renewed, mut turns) = (0, self.stretches.len());
        while self.due >= 2 && turns > 0 {
            self.due -= 2;
            turns = turns.saturating_sub(2);
            let pair = self.pair();
            let (first, end) = (
                self.stretches[pair.start].first,
                self.stretches.get(pair.end).map(|next| next.first),
            );
            let inside: Vec<(u64, u32)> = (order.iter().copied())
                .filter(|&(code, _)| code >= first && end.is_none_or(|end| code < end))
                .collect();
            let some: Vec<Candidate> = inside
                .iter()
                .map(|&(_, i)| candidates[i as usize])
                .collect();
            let (brought, traced) = vpl::judge(world, &some, &pilots, self.clamp);
            rays += traced;
            let share = if all_brought > 0.0 {
                brought.iter().sum::<f64>() / all_brought
            } else {
                0.0
            };
            let before: usize = self.stretches[pair.clone()]
                .iter()
                .map(|s| s.lights.len())
                .sum();
            let count = (share * f64::from(wanted.vpls))
                .clamp(BLOCK as f64 / 2.0, 2.0 * (before + BLOCK) as f64);
            let inside: Vec<(u64, u32)> = inside
                .iter()
                .enumerate()
                .map(|(i, &(code, _))| (code, i as u32))
                .collect();
            let all = f64::from(wanted.vpls);
            let drawn = vpl::choose(&some, &brought, &inside, count as u32, all, offset);
            renewed += drawn.len() as u32;
            self.replace(pair, first, &drawn);
        }
        (renewed, rays)
    }

    /// The stretches whose turn it is.
    fn pair(&mut self) -> Range<usize> {
        let count = self.stretches.len();
        if self.next + 1 >= count {
            // Rounds start at the first and at the second stretch by turns, so that all borders move.
            self.start = usize::from(self.start == 0 && count > 2);
            self.next = self.start;
        }
        self.next..(self.next + 2).min(count)
    }

    /// Puts new lights, in blocks of about one size, in the place of stretches.
    fn replace(&mut self, old: Range<usize>, first: u64, drawn: &[Drawn]) {
        let blocks = drawn.len().div_ceil(BLOCK).max(1);
        let mut new: Vec<Stretch> = Vec::with_capacity(blocks);
        for block in 0..blocks {
            let range = drawn.len() * block / blocks..drawn.len() * (block + 1) / blocks;
            let lights = drawn[range].to_vec();
            let first = match (block, lights.first()) {
                (0, _) | (_, None) => first,
                (_, Some(drawn)) => drawn.code,
            };
            new.push(Stretch { first, lights });
        }
        self.next = old.start + blocks;
        self.stretches.splice(old, new);
    }
}
