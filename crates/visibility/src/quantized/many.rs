//! Many lights: Algorithm 2 for blocks of 16 lights at once, on arrays instead of a hash table.
//!
//! The eyes of a tile fall into few cells, and each cell is asked about every light. So the cells of all eyes are numbered
//! once (by hashing, with the numbers of their four neighbours), and for each block of lights a small array holds one word
//! a cell: which of the 16 answers are known, and the answers. A look-up of 16 lights is then one load, and "do the
//! neighbours agree?" is five loads and a few bit operations for all 16: far below a nanosecond a question, whatever the
//! number of lights, since one block's array fits the nearest cache.
//!
//! Eyes are taken in the segments of [`order`](crate::order): within a segment all unknown clusters are traced together,
//! light by light, then the answers serve everybody else.
//!
//! With a table shared by threads ([`Share`](super::Share)) the words of cells are fetched from and stored to a hash table
//! keyed by cell and block: once a cell and block, not once a question. In a sequence of pictures the words come from what
//! [earlier pictures](super::past) knew.

use super::key::{Cell, Grids, light_name, nearest_power_of_two};
use super::past::{self, Learnt, Note, Past};
use super::table::{BlockTable, BlockWord};
use super::{Decisions, Guarantee, Quantized, QuantizedWorker, known, mix};
use crate::many::bits;
use crate::order::segments;
use crate::{
    BLOCK, Correction, Epoch, EyeSample, LightEnd, ManyLights, Ray, SharedLight, Tracer,
    VisibilityStats,
};

/// Where memory has no reason for doubt, one answer in `2^CHECKED` is checked by a ray ([`Guarantee::Unbiased`]).
const CHECKED: u32 = 5;
/// The same for answers that had to be refined.
const CHECKED_AT_EDGES: u32 = 2;

/// No cell: a neighbour that no eye lies in.
const NONE: u32 = u32::MAX;

/// Buffers of one worker.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    wanted: Vec<u16>,
    /// Answers to what was wanted.
    visible: Vec<u16>,
    corrections: Vec<Correction>,
    /// The cells of the eyes, for each error reach that lights have asked for.
    reaches: Vec<Reach>,
    rays: Vec<Ray>,
    occluded: Vec<bool>,
    active: Vec<Active>,
    next: Vec<Active>,
    claims: [Vec<Claim>; BLOCK],
    touched: Vec<u32>,
    /// Calls since the epoch began.
    pub(super) calls: u32,
    /// For later pictures, by block of lights.
    learnt: Vec<(u64, Vec<Learnt>)>,
}

/// The cells of all eyes at one error reach, level by level.
#[derive(Debug, Default)]
struct Reach {
    /// What the cells were made for; `None` if for other eyes.
    extent: Option<Extent>,
    levels: Vec<Level>,
}

/// The cells of one level.
#[derive(Debug, Default)]
struct Level {
    /// The cell of each eye; [`NONE`] for eyes that have no cells.
    cell_of: Vec<u32>,
    cells: Vec<Cell>,
    hashes: Vec<u64>,
    numbering: Numbering,
    /// Sought when a cell is first compared with them: few of the finest are.
    neighbours: Vec<Option<[u32; 4]>>,
    /// What is known about the current block.
    words: Vec<Word>,
    /// The words hold what earlier pictures knew.
    recalled: bool,
    /// Cells that have learnt something about the current block, some more than once.
    learning: Vec<u32>,
    /// The cells' rows in the memory of earlier pictures.
    rows: Vec<u32>,
}

/// What is known about a block from one cell.
#[derive(Clone, Copy, Debug, Default)]
struct Word {
    answers: BlockWord,
    /// Answers that differ from those of a neighbour, in the segment `compared`.
    differs: u16,
    /// Number of a segment, from 1; 0 for none.
    compared: u8,
    /// The table behind has been asked.
    fetched: bool,
}

/// An eye and the lights that it still asks about.
#[derive(Clone, Copy, Debug)]
struct Active {
    eye: u32,
    lights: u16,
}

/// A ray to trace, and whom its answer is for.
#[derive(Clone, Copy, Debug)]
struct Claim {
    eye: u32,
    /// The cell that the answer stands for, or [`NONE`].
    cell: u32,
    /// Of a check (`V' = Vc + (V - Vc) / p`): the answer `Vc` that it corrects, and `1 / p`. The weight 1 makes the ray the answer.
    cached: bool,
    weight: f32,
}

/// Answers all blocks.
pub(super) fn answer<T: Tracer>(
    strategy: &Quantized,
    tracer: &T,
    worker: &mut QuantizedWorker,
    eyes: &[EyeSample],
    lights: &[SharedLight],
    asker: &mut dyn ManyLights,
) {
    let QuantizedWorker {
        own,
        epoch,
        decisions,
        many: scratch,
        stats,
        held,
        ..
    } = worker;
    let behind = strategy.blocks(own, held);
    let past = strategy.past();
    // What other tiles and pictures are to find has a name of its own in no epoch.
    let salt = past.map_or(decisions.salt, |_| 0);
    scratch.calls += 1;
    let (eye_passes, _) = strategy.passes(*epoch);
    let count = eyes.len();
    for reach in &mut scratch.reaches {
        reach.extent = None;
    }
    scratch.wanted.resize(count, 0);
    scratch.visible.resize(count, 0);
    for (block, lights) in lights.chunks(BLOCK).enumerate() {
        scratch.wanted[..count].fill(0);
        asker.wanted(block, &mut scratch.wanted[..count]);
        scratch.visible[..count].fill(0);
        scratch.corrections.clear();
        // Lights of one error reach are answered together; most blocks have one.
        let mut left = u16::MAX >> (BLOCK - lights.len());
        while left != 0 {
            let extent = Extent::of(
                strategy,
                &lights[left.trailing_zeros() as usize],
                eye_passes,
            );
            let alike = bits(left)
                .filter(|&l| Extent::of(strategy, &lights[l], eye_passes) == extent)
                .fold(0u16, |mask, l| mask | 1 << l);
            left &= !alike;
            let group = Group::new(lights, alike, salt);
            let traced = stats.traced;
            let asked = if extent.error > 0.0 && group.clustered {
                let reach = scratch.reach(strategy, eyes, extent, eye_passes);
                scratch.answer_group(
                    strategy, tracer, eyes, lights, &group, reach, behind, decisions, stats,
                )
            } else {
                scratch.trace_exactly(tracer, eyes, lights, alike, stats);
                stats.traced - traced
            };
            stats.queries += asked;
            stats.answered += asked - (stats.traced - traced);
        }
        asker.take(block, &scratch.visible[..count], &scratch.corrections);
    }
    if let Some(past) = past {
        scratch.note(past, *epoch);
    }
}

/// How large the eyes' cells for a light are, and how often they may be halved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Extent {
    /// The error reach, samples; larger for delta lights that are rarely picked, since fewer eyes ask about them.
    error: f32,
    levels: u32,
}

impl Extent {
    fn of(strategy: &Quantized, light: &SharedLight, eye_passes: f32) -> Self {
        let error = strategy.error(&light.end);
        let picked = match light.end {
            LightEnd::Point(_) | LightEnd::Direction(_) => {
                nearest_power_of_two(known(light.connections).unwrap_or(1.0).sqrt())
            }
            LightEnd::Surface(_) | LightEnd::SolidAngle { .. } => 1.0,
        };
        Self {
            error: error / picked,
            levels: strategy.settings.levels(error, eye_passes),
        }
    }
}

/// Lights of one block that share an error reach.
struct Group {
    /// The lights of the group.
    lights: u16,
    /// All lights have names.
    clustered: bool,
    /// Identifies the lights, so that others never read these answers.
    hash: u64,
}

impl Group {
    fn new(lights: &[SharedLight], members: u16, salt: u64) -> Self {
        let mut hash = mix(salt, u64::from(members));
        let mut clustered = true;
        for l in bits(members) {
            let name = light_name(&lights[l].end);
            clustered &= name.is_some();
            hash = mix(hash, name.unwrap_or(0));
        }
        Self {
            lights: members,
            clustered,
            hash,
        }
    }
}

impl Scratch {
    /// The index of the cells for an error reach, made if they are not there.
    fn reach(
        &mut self,
        strategy: &Quantized,
        eyes: &[EyeSample],
        extent: Extent,
        eye_passes: f32,
    ) -> usize {
        let made = |reach: &Reach| reach.extent == Some(extent);
        if let Some(index) = self.reaches.iter().position(made) {
            return index;
        }
        let index = match self.reaches.iter().position(|reach| reach.extent.is_none()) {
            Some(index) => index,
            None => {
                self.reaches.push(Reach::default());
                self.reaches.len() - 1
            }
        };
        let reach = &mut self.reaches[index];
        reach.extent = Some(extent);
        reach
            .levels
            .resize_with(extent.levels as usize, Level::default);
        for (depth, level) in reach.levels.iter_mut().enumerate() {
            let error = extent.error / (1u32 << depth.min(31)) as f32;
            level.number_cells(strategy, eyes, error, eye_passes);
            if let Some(past) = strategy.past() {
                past.rows(&level.hashes, &mut level.rows);
            }
        }
        index
    }

    /// Notes down for later pictures what this call has learnt.
    fn note(&mut self, past: &Past, epoch: Epoch) {
        if !self.learnt.is_empty() {
            past.note(Note {
                order: (epoch.pass, epoch.tile, self.calls),
                blocks: std::mem::take(&mut self.learnt),
            });
        }
    }

    /// Answers a group of lights for all eyes; returns how many questions that were.
    fn answer_group<T: Tracer>(
        &mut self,
        strategy: &Quantized,
        tracer: &T,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        group: &Group,
        index: usize,
        behind: Option<&BlockTable>,
        decisions: &mut Decisions,
        stats: &mut VisibilityStats,
    ) -> u64 {
        let unbiased = strategy.settings.guarantee == Guarantee::Unbiased;
        let mut reach = std::mem::take(&mut self.reaches[index]);
        for level in &mut reach.levels {
            level.words.clear();
            level.words.resize(level.hashes.len(), Word::default());
            level.recalled = false;
            level.learning.clear();
        }
        let past = strategy.past();
        let column = past.map_or(past::NONE, |past| past.column(group.hash));
        let mut asked = 0;
        let error = reach.extent.map_or(1.0, |extent| extent.error);
        let first = eyes.len() as f32 / (error * error);
        for (segment, range) in (1u8..).zip(segments(eyes.len(), first)) {
            self.active.clear();
            for eye in range {
                let wanted = self.wanted[eye] & group.lights;
                asked += u64::from(wanted.count_ones());
                if wanted != 0 {
                    self.active.push(Active {
                        eye: eye as u32,
                        lights: wanted,
                    });
                }
            }
            let levels = reach.levels.len();
            for depth in 0..levels {
                let level = &mut reach.levels[depth];
                if let (Some(past), false) = (past, level.recalled) {
                    level.recall(past, column);
                }
                self.claim(level, group, behind);
                self.trace(tracer, eyes, lights, Some(level), stats);
                self.store(level, group, behind, stats);
                let last = depth + 1 == levels;
                self.refine(strategy, level, segment, depth, last, decisions);
                if unbiased {
                    self.trace(tracer, eyes, lights, None, stats);
                }
                let refined: u64 = self
                    .next
                    .iter()
                    .map(|active| u64::from(active.lights.count_ones()))
                    .sum();
                if refined > 0 {
                    if stats.refined.len() <= depth {
                        stats.refined.resize(depth + 1, 0);
                    }
                    stats.refined[depth] += refined;
                }
                std::mem::swap(&mut self.active, &mut self.next);
                if self.active.is_empty() {
                    break;
                }
            }
        }
        if past.is_some() {
            let learnt: Vec<Learnt> = reach.levels.iter().flat_map(Level::learnt).collect();
            if !learnt.is_empty() {
                self.learnt.push((group.hash, learnt));
            }
        }
        self.reaches[index] = reach;
        asked
    }

    /// Whoever first asks about an unknown cluster claims it: traces its own ray, which then stands for the cluster.
    fn claim(&mut self, level: &mut Level, group: &Group, behind: Option<&BlockTable>) {
        self.touched.clear();
        for active in &mut self.active {
            let cell = level.cell_of[active.eye as usize];
            if cell == NONE {
                for l in bits(active.lights) {
                    self.claims[l].push(Claim::exact(active.eye));
                }
                active.lights = 0;
                continue;
            }
            let word = &mut level.words[cell as usize];
            let mut unknown = active.lights & !word.answers.known;
            if unknown == 0 {
                continue;
            }
            if let (false, Some(table)) = (word.fetched, behind) {
                word.fetched = true;
                word.answers = table.get(mix(level.hashes[cell as usize], group.hash));
                unknown &= !word.answers.known;
                if unknown == 0 {
                    continue;
                }
            }
            for l in bits(unknown) {
                self.claims[l].push(Claim {
                    cell,
                    ..Claim::exact(active.eye)
                });
            }
            word.answers.known |= unknown;
            level.learning.push(cell);
            active.lights &= !unknown;
            if behind.is_some() {
                self.touched.push(cell);
            }
        }
    }

    /// Traces all claims, light by light, and notes the answers.
    fn trace<T: Tracer>(
        &mut self,
        tracer: &T,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        mut clusters: Option<&mut Level>,
        stats: &mut VisibilityStats,
    ) {
        for (l, claims) in self.claims.iter_mut().enumerate() {
            if claims.is_empty() {
                continue;
            }
            self.rays.clear();
            self.rays.extend(
                claims
                    .iter()
                    .map(|claim| lights[l].ray_from(eyes[claim.eye as usize].origin)),
            );
            self.occluded.clear();
            self.occluded.resize(self.rays.len(), false);
            tracer.occluded_batch(&self.rays, &mut self.occluded);
            stats.traced += self.rays.len() as u64;
            for (claim, &occluded) in claims.iter().zip(&self.occluded) {
                if claim.weight == 1.0 {
                    let bit = 1 << l;
                    let visible = &mut self.visible[claim.eye as usize];
                    *visible = if occluded {
                        *visible & !bit
                    } else {
                        *visible | bit
                    };
                } else if claim.cached == occluded {
                    let amount = if occluded {
                        -claim.weight
                    } else {
                        claim.weight
                    };
                    self.corrections.push(Correction {
                        eye: claim.eye,
                        light: l as u32,
                        amount,
                    });
                }
                if let (Some(level), false, true) = (&mut clusters, occluded, claim.cell != NONE) {
                    level.words[claim.cell as usize].answers.visible |= 1 << l;
                }
            }
            claims.clear();
        }
    }

    /// Hands new answers to the table behind.
    fn store(
        &mut self,
        level: &Level,
        group: &Group,
        behind: Option<&BlockTable>,
        stats: &mut VisibilityStats,
    ) {
        let Some(table) = behind else {
            return;
        };
        for &cell in &self.touched {
            let digest = mix(level.hashes[cell as usize], group.hash);
            let answers = level.words[cell as usize].answers;
            stats.overwritten += u64::from(table.put(digest, answers));
        }
    }

    /// Answers from the clusters; questions whose neighbours disagree go to the next level.
    fn refine(
        &mut self,
        strategy: &Quantized,
        level: &mut Level,
        segment: u8,
        depth: usize,
        last: bool,
        decisions: &mut Decisions,
    ) {
        let unbiased = strategy.settings.guarantee == Guarantee::Unbiased;
        self.next.clear();
        for active in &self.active {
            if active.lights == 0 {
                continue;
            }
            let cell = level.cell_of[active.eye as usize] as usize;
            let visible = level.words[cell].answers.visible;
            let disagree = if last && !unbiased {
                0
            } else {
                active.lights & level.differs(&strategy.grids, cell, segment)
            };
            let mut settled = active.lights & !disagree;
            if last {
                settled = active.lights;
            } else if disagree != 0 {
                self.next.push(Active {
                    eye: active.eye,
                    lights: disagree,
                });
            }
            self.visible[active.eye as usize] |= settled & visible;
            if unbiased {
                let halvings = if depth == 0 {
                    CHECKED
                } else {
                    CHECKED_AT_EDGES
                };
                // Each bit survives with probability 2^-halvings.
                let chosen =
                    (0..halvings).fold(u16::MAX, |mask, _| mask & decisions.random() as u16);
                let weight = (1u32 << halvings) as f32;
                for l in bits(settled & (chosen | disagree)) {
                    let weight = if disagree >> l & 1 != 0 { 1.0 } else { weight };
                    self.claims[l].push(Claim {
                        eye: active.eye,
                        cell: NONE,
                        cached: visible >> l & 1 != 0,
                        weight,
                    });
                }
            }
        }
    }

    /// Traces all questions about some lights of a block.
    fn trace_exactly<T: Tracer>(
        &mut self,
        tracer: &T,
        eyes: &[EyeSample],
        lights: &[SharedLight],
        members: u16,
        stats: &mut VisibilityStats,
    ) {
        for eye in 0..eyes.len() {
            for l in bits(self.wanted[eye] & members) {
                self.claims[l].push(Claim::exact(eye as u32));
            }
        }
        self.trace(tracer, eyes, lights, None, stats);
    }
}

impl Claim {
    fn exact(eye: u32) -> Self {
        Self {
            eye,
            cell: NONE,
            cached: false,
            weight: 1.0,
        }
    }
}

impl Level {
    /// Fetches what earlier pictures knew about the block of a column.
    fn recall(&mut self, past: &Past, column: u32) {
        self.recalled = true;
        if column == past::NONE {
            return;
        }
        for (word, &row) in self.words.iter_mut().zip(&self.rows) {
            if row != past::NONE {
                word.answers = past.word(row, column);
            }
        }
    }

    /// What later pictures may know.
    fn learnt(&self) -> impl Iterator<Item = Learnt> {
        self.learning.iter().map(|&cell| {
            let cell = cell as usize;
            Learnt {
                hash: self.hashes[cell],
                row: self.rows.get(cell).copied().unwrap_or(past::NONE),
                answers: self.words[cell].answers,
            }
        })
    }

    /// Bits of known answers that differ from those of a known neighbour, found once a cell and segment: nothing new becomes
    /// known while the eyes of a segment are answered.
    #[inline]
    fn differs(&mut self, grids: &Grids, cell: usize, segment: u8) -> u16 {
        if self.words[cell].compared != segment {
            self.compare(grids, cell);
            self.words[cell].compared = segment;
        }
        self.words[cell].differs
    }

    fn compare(&mut self, grids: &Grids, cell: usize) {
        let own = self.words[cell].answers;
        let neighbours = *self.neighbours[cell].get_or_insert_with(|| {
            let beside = |neighbour| self.numbering.beside(grids, neighbour).unwrap_or(NONE);
            self.cells[cell].neighbours().map(beside)
        });
        let differing = neighbours
            .iter()
            .filter(|&&neighbour| neighbour != NONE)
            .map(|&neighbour| {
                let other = self.words[neighbour as usize].answers;
                other.known & (other.visible ^ own.visible)
            })
            .fold(0, |mask, differing| mask | differing);
        self.words[cell].differs = differing & own.known;
    }

    /// Finds the cell of each eye.
    fn number_cells(
        &mut self,
        strategy: &Quantized,
        eyes: &[EyeSample],
        error: f32,
        eye_passes: f32,
    ) {
        let grids = &strategy.grids;
        self.cell_of.clear();
        self.cells.clear();
        self.hashes.clear();
        self.numbering.clear(eyes.len());
        for eye in eyes {
            let cell = known(eye.end.density)
                .zip(grids.orientation(eye.end.normal))
                .map(|(density, orientation)| {
                    let resolution = grids.resolution(density * eye_passes) / error;
                    grids.cell(eye.end.position, orientation, grids.quantize(resolution))
                });
            self.cell_of.push(match cell {
                None => NONE,
                Some(cell) => {
                    let hash = cell.half();
                    let number = self
                        .numbering
                        .find_or_insert(hash, self.hashes.len() as u32);
                    if number as usize == self.hashes.len() {
                        self.hashes.push(hash);
                        self.cells.push(cell);
                    }
                    number
                }
            });
        }
        self.neighbours.clear();
        self.neighbours.resize(self.cells.len(), None);
    }
}

/// Numbers for hashes: open addressing, at most half full. Hashes of 64 bits stand for the cells themselves: among n cells
/// two share one with probability `n^2 / 2^65`.
#[derive(Debug, Default)]
struct Numbering {
    slots: Vec<(u64, u32)>,
}

impl Numbering {
    fn clear(&mut self, count: usize) {
        self.slots.clear();
        self.slots
            .resize((2 * count).next_power_of_two(), (0, NONE));
    }

    fn place(&self, hash: u64) -> usize {
        let mask = self.slots.len() - 1;
        let mut place = hash as usize & mask;
        while self.slots[place].1 != NONE && self.slots[place].0 != hash {
            place = (place + 1) & mask;
        }
        place
    }

    /// The number of a cell, or of one that goes on where it would be. The paper looks for the cell itself alone; but a surface that
    /// is not quite along its grid passes on to the voxel above or below, and one that comes nearer to other resolutions: an edge of
    /// a shadow there would have nobody to differ from.
    fn beside(&self, grids: &Grids, cell: Cell) -> Option<u32> {
        let layers = |cell: Cell| {
            self.find(cell.half()).or_else(|| {
                let others = cell.above_and_below();
                others.into_iter().find_map(|other| self.find(other.half()))
            })
        };
        layers(cell).or_else(|| {
            let middle = grids.middle(&cell);
            let others = grids.beside(cell.resolution);
            others
                .into_iter()
                .find_map(|resolution| layers(grids.cell(middle, cell.orientation, resolution)))
        })
    }

    fn find(&self, hash: u64) -> Option<u32> {
        let (_, number) = self.slots[self.place(hash)];
        (number != NONE).then_some(number)
    }

    /// The hash's number; a new hash gets `next`.
    fn find_or_insert(&mut self, hash: u64, next: u32) -> u32 {
        let place = self.place(hash);
        let slot = &mut self.slots[place];
        if slot.1 == NONE {
            *slot = (hash, next);
        }
        slot.1
    }
}
