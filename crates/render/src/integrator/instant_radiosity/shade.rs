//! Shading by blocks of 16 lights: what each light would bring to an eye sample, if nothing blocked it.
//!
//! Plain loops over arrays of 16 numbers, which compilers make vector code of, compiled once more for AVX2 and chosen at run time. (Small
//! types for a register's numbers, each operation a loop of its own, came out three times slower.) They use no fused
//! operations and add up in a fixed order, so that every machine computes the same bytes.
//!
//! An eye sample is either Lambert, or has the closed form of [`Broad`], or (layered materials) asks its [`Bsdf`] light by light.
// Loops that index several arrays alike are what becomes vector code.
#![allow(clippy::needless_range_loop)]

use crate::bsdf::{Broad, Bsdf};
use crate::geometry::Geometry;
use glam::{Mat3, Vec3};
use occlude_visibility::{BLOCK, BlockAnswers, EyeSample, ManyLights, SharedLight};
use std::f32::consts::FRAC_1_PI;

/// A number for each light of a block.
type Lanes = [f32; BLOCK];

/// What the lights of a list are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Lambert emitters: virtual lights.
    Patch,
    /// Points and spots.
    Point,
    /// Infinitely far away.
    Direction,
}

const PATCH: u8 = 0;
const POINT: u8 = 1;
const DIRECTION: u8 = 2;

/// 16 lights of one kind, array by array. Lights that are not there have no colour, and an axis of zero length.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(super) struct LightBlock {
    /// Position, or the unit vector towards a light infinitely far away.
    place: [Lanes; 3],
    /// Normal of a patch, axis of a spot.
    axis: [Lanes; 3],
    /// Of points and spots: the falloff is `clamp(scale * cos + offset, 0, 1)^2`.
    scale: Lanes,
    offset: Lanes,
    /// Scattering events of the path that made the light.
    events: Lanes,
    /// Radiance times area, radiant intensity, or irradiance.
    colour: [Lanes; 3],
}

impl LightBlock {
    fn set(&mut self, lane: usize, place: Vec3, axis: Vec3, colour: Vec3) {
        for c in 0..3 {
            self.place[c][lane] = place[c];
            self.axis[c][lane] = axis[c];
            self.colour[c][lane] = colour[c];
        }
    }
}

/// Lights of one kind that all eye samples share: for shading, and as the visibility strategy sees them.
#[derive(Clone, Debug)]
pub(super) struct LightList {
    pub(super) kind: Kind,
    blocks: Vec<LightBlock>,
    pub(super) shared: Vec<SharedLight>,
}

impl LightList {
    pub(super) fn new(kind: Kind) -> Self {
        Self {
            kind,
            blocks: Vec::new(),
            shared: Vec::new(),
        }
    }

    fn push(&mut self, shared: SharedLight) -> (&mut LightBlock, usize) {
        let lane = self.shared.len() % BLOCK;
        self.shared.push(shared);
        if lane == 0 {
            self.blocks.push(LightBlock::default());
        }
        let last = self.blocks.len() - 1;
        (&mut self.blocks[last], lane)
    }

    /// Adds a virtual light that sends `colour` (radiance times area) to its front, made by `events` scattering events.
    pub(super) fn push_patch(
        &mut self,
        shared: SharedLight,
        position: Vec3,
        normal: Vec3,
        colour: Vec3,
        events: u32,
    ) {
        let (block, lane) = self.push(shared);
        block.set(lane, position, normal, colour);
        block.events[lane] = events as f32;
    }

    /// Adds a point or a spot.
    pub(super) fn push_point(
        &mut self,
        shared: SharedLight,
        position: Vec3,
        intensity: Vec3,
        cone: Option<(Vec3, f32, f32)>,
    ) {
        let (axis, scale, offset) = cone.unwrap_or((Vec3::ZERO, 0.0, 1.0));
        let (block, lane) = self.push(shared);
        block.set(lane, position, axis, intensity);
        block.scale[lane] = scale;
        block.offset[lane] = offset;
    }

    /// Adds a light infinitely far away, which gives `irradiance` to a surface that faces it.
    pub(super) fn push_direction(&mut self, shared: SharedLight, towards: Vec3, irradiance: Vec3) {
        let (block, lane) = self.push(shared);
        block.set(lane, towards, Vec3::ZERO, irradiance);
    }

    pub(super) fn len(&self) -> usize {
        self.shared.len()
    }

    /// Where the lights are (of those infinitely far away, their directions).
    pub(super) fn positions(&self) -> Vec<Vec3> {
        (0..self.len())
            .map(|i| {
                let place = &self.blocks[i / BLOCK].place;
                Vec3::from_array([0, 1, 2].map(|c| place[c][i % BLOCK]))
            })
            .collect()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.shared.is_empty()
    }
}

/// How an eye sample scatters.
#[derive(Clone, Copy, Debug)]
pub(super) enum Scatter {
    /// Lambert; the colour is in [`Eye::weight`].
    Lambert,
    /// A [`Closed`] form, by number.
    Closed(u32),
    /// A [`Layered`] material, by number.
    Layered(u32),
}

/// What shading needs to know about an eye sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eye {
    pub(super) position: Vec3,
    /// Geometric and shading normal, both on the side that is seen.
    pub(super) normal: Vec3,
    pub(super) shading_normal: Vec3,
    /// Share of the light leaving towards the viewer that arrives at the film; of Lambert surfaces times base colour / π.
    pub(super) weight: Vec3,
    /// Scattering events that a light path may have, so that the whole path keeps to the largest depth.
    pub(super) events_left: f32,
    pub(super) scatter: Scatter,
    /// The camera sample that it belongs to.
    pub(super) sample: u32,
}

/// An unlayered surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Closed {
    pub(super) broad: Broad,
    /// Unit vector towards the viewer.
    pub(super) wo: Vec3,
    pub(super) cos_o: f32,
}

/// A surface with coat or sheen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layered {
    pub(super) bsdf: Bsdf,
    pub(super) local_from_world: Mat3,
    pub(super) wo: Vec3,
}

/// Surfaces that are more than Lambert, by the numbers in [`Scatter`].
#[derive(Clone, Debug, Default)]
pub(super) struct Scatterers {
    pub(super) closed: Vec<Closed>,
    pub(super) layered: Vec<Layered>,
}

/// Asks about the lights of a list for some eyes, and gathers what they bring.
pub(super) struct Asker<'a> {
    pub(super) lights: &'a LightList,
    pub(super) eyes: &'a [Eye],
    pub(super) ends: &'a [EyeSample],
    pub(super) scatterers: &'a Scatterers,
    /// Bound on the geometry term of patches.
    pub(super) clamp: f32,
    /// Where there are panes that tint light.
    pub(super) panes: Option<&'a Geometry<'a>>,
    /// By camera sample.
    pub(super) radiance: &'a mut [Vec3],
    /// Sum of what the clamp took away, all channels.
    pub(super) clamped: f64,
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn wanted_avx2<const KIND: u8>(asker: &Asker, block: &LightBlock, masks: &mut [u16]) {
    wanted::<KIND>(asker, block, masks);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn take_avx2<const KIND: u8>(
    asker: &mut Asker,
    block: usize,
    wanted: &[u16],
    answers: &[BlockAnswers],
) {
    take::<KIND>(asker, block, wanted, answers);
}

fn wanted_by_kind<const KIND: u8>(asker: &Asker, block: &LightBlock, masks: &mut [u16]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the machine has the instructions.
        return unsafe { wanted_avx2::<KIND>(asker, block, masks) };
    }
    wanted::<KIND>(asker, block, masks);
}

fn take_by_kind<const KIND: u8>(
    asker: &mut Asker,
    block: usize,
    wanted: &[u16],
    answers: &[BlockAnswers],
) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the machine has the instructions.
        return unsafe { take_avx2::<KIND>(asker, block, wanted, answers) };
    }
    take::<KIND>(asker, block, wanted, answers);
}

impl ManyLights for Asker<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        let lights = &self.lights.blocks[block];
        match self.lights.kind {
            Kind::Patch => wanted_by_kind::<PATCH>(self, lights, wanted),
            Kind::Point => wanted_by_kind::<POINT>(self, lights, wanted),
            Kind::Direction => wanted_by_kind::<DIRECTION>(self, lights, wanted),
        }
        let rest = self.lights.len() - block * BLOCK;
        if rest < BLOCK {
            let there = (1 << rest) - 1;
            wanted.iter_mut().for_each(|mask| *mask &= there);
        }
    }

    fn take(&mut self, block: usize, wanted: &[u16], answers: &[BlockAnswers]) {
        match self.lights.kind {
            Kind::Patch => take_by_kind::<PATCH>(self, block, wanted, answers),
            Kind::Point => take_by_kind::<POINT>(self, block, wanted, answers),
            Kind::Direction => take_by_kind::<DIRECTION>(self, block, wanted, answers),
        }
    }
}

/// From an eye to light `i`: the vector, not normalised unless the light is infinitely far away.
#[inline(always)]
fn way<const KIND: u8>(eye: &Eye, block: &LightBlock, i: usize) -> (f32, f32, f32) {
    let [x, y, z] = [block.place[0][i], block.place[1][i], block.place[2][i]];
    if KIND == DIRECTION {
        (x, y, z)
    } else {
        (x - eye.position.x, y - eye.position.y, z - eye.position.z)
    }
}

/// Which lights could bring something: in front of the eye by both normals, the eye in front of them.
#[inline(always)]
fn wanted<const KIND: u8>(asker: &Asker, block: &LightBlock, masks: &mut [u16]) {
    for (eye, mask) in asker.eyes.iter().zip(masks) {
        let (n, s) = (eye.normal, eye.shading_normal);
        let mut least = [0.0; BLOCK];
        for i in 0..BLOCK {
            let (x, y, z) = way::<KIND>(eye, block, i);
            let above = n.x * x + n.y * y + n.z * z;
            let shaded = s.x * x + s.y * y + s.z * z;
            let mut smaller = if above < shaded { above } else { shaded };
            let along = block.axis[0][i] * x + block.axis[1][i] * y + block.axis[2][i] * z;
            if KIND == PATCH {
                smaller = if -along < smaller { -along } else { smaller };
                smaller = if block.events[i] <= eye.events_left {
                    smaller
                } else {
                    0.0
                };
            }
            if KIND == POINT {
                let ramp =
                    block.offset[i] * (x * x + y * y + z * z).sqrt() - along * block.scale[i];
                smaller = if ramp < smaller { ramp } else { smaller };
            }
            least[i] = smaller;
        }
        let mut bits = 0;
        for (i, least) in least.iter().enumerate() {
            bits |= u32::from(*least > 0.0) << i;
        }
        *mask = bits as u16;
    }
}

#[inline(always)]
fn sum(mut lanes: Lanes) -> f32 {
    let mut width = BLOCK / 2;
    while width > 0 {
        for i in 0..width {
            lanes[i] += lanes[i + width];
        }
        width /= 2;
    }
    lanes[0]
}

/// Per light: the cosine at the eye times what a light of unit colour sends there, the geometry term clamped.
#[inline(always)]
fn lambert<const KIND: u8>(eye: &Eye, block: &LightBlock, clamp: f32) -> Lanes {
    let s = eye.shading_normal;
    let mut terms = [0.0; BLOCK];
    for i in 0..BLOCK {
        let (x, y, z) = way::<KIND>(eye, block, i);
        let cosine = s.x * x + s.y * y + s.z * z;
        let distance2 = x * x + y * y + z * z;
        let along = block.axis[0][i] * x + block.axis[1][i] * y + block.axis[2][i] * z;
        terms[i] = match KIND {
            PATCH => {
                let term = -(cosine * along) / (distance2 * distance2);
                if term < clamp { term } else { clamp }
            }
            POINT => {
                let distance = distance2.sqrt();
                falloff(block, i, -along / distance) * cosine / (distance2 * distance)
            }
            _ => cosine,
        };
    }
    terms
}

#[inline(always)]
fn falloff(block: &LightBlock, i: usize, cosine: f32) -> f32 {
    let ramp = block.scale[i] * cosine + block.offset[i];
    let ramp = if ramp < 0.0 { 0.0 } else { ramp };
    let ramp = if ramp > 1.0 { 1.0 } else { ramp };
    ramp * ramp
}

/// The same of a closed form, by channel: scattered light instead of the cosine.
#[inline(always)]
fn closed<const KIND: u8>(
    eye: &Eye,
    closed: &Closed,
    block: &LightBlock,
    clamp: f32,
) -> [Lanes; 3] {
    let s = eye.shading_normal;
    let (broad, wo) = (&closed.broad, closed.wo);
    let mut terms = [[0.0; BLOCK]; 3];
    for i in 0..BLOCK {
        let (x, y, z) = way::<KIND>(eye, block, i);
        let (mut x, mut y, mut z) = (x, y, z);
        let mut arriving = 1.0;
        if KIND != DIRECTION {
            let distance2 = x * x + y * y + z * z;
            let per_distance = 1.0 / distance2.sqrt();
            (x, y, z) = (x * per_distance, y * per_distance, z * per_distance);
            let along = block.axis[0][i] * x + block.axis[1][i] * y + block.axis[2][i] * z;
            arriving = per_distance
                * per_distance
                * if KIND == PATCH {
                    -along
                } else {
                    falloff(block, i, -along)
                };
        }
        let cosine = s.x * x + s.y * y + s.z * z;
        // Lights below the horizon were not asked for; the numbers computed for them must only be finite.
        let cosine = if cosine > 1e-6 { cosine } else { 1e-6 };
        if KIND == PATCH {
            let term = cosine * arriving;
            arriving = if term < clamp {
                arriving
            } else {
                clamp / cosine
            };
        }
        let [a, b] = broad.albedo.at(cosine.sqrt());
        // Heights of the half vector, see `microfacet::half_vector`.
        let length2 = 2.0 + 2.0 * (wo.x * x + wo.y * y + wo.z * z);
        let length2 = if length2 > 1e-12 { length2 } else { 1e-12 };
        let height = closed.cos_o + cosine;
        let e = length2 - height * height;
        let e = if e > 0.0 { e } else { 0.0 } + broad.alpha2 * height * height;
        let ratio = length2 / e;
        let root = (broad.alpha2 + (1.0 - broad.alpha2) * cosine * cosine).sqrt();
        let lobe = broad.alpha2 * FRAC_1_PI * ratio * ratio * 0.5 * cosine
            / (closed.cos_o * root + cosine * broad.root_o);
        let cos_half = 0.5 * length2.sqrt();
        let m = if cos_half < 1.0 { 1.0 - cos_half } else { 0.0 };
        let weight = m * m * m * m * m;
        let (facing, grazing) = (lobe * (1.0 - weight), lobe * weight * broad.f90);
        for c in 0..3 {
            let cosine_lobe = broad.constant[c] + broad.by_a[c] * a + broad.by_b[c] * b;
            terms[c][i] = (cosine_lobe * cosine + broad.f0[c] * facing + grazing) * arriving;
        }
    }
    terms
}

/// The same of a layered material, light by light.
#[inline(never)]
fn layered<const KIND: u8>(
    eye: &Eye,
    layered: &Layered,
    block: &LightBlock,
    clamp: f32,
    wanted: u16,
) -> [Lanes; 3] {
    let lambert = lambert::<KIND>(eye, block, clamp);
    let mut terms = [[0.0; BLOCK]; 3];
    for i in (0..BLOCK).filter(|i| wanted >> i & 1 != 0) {
        let (x, y, z) = way::<KIND>(eye, block, i);
        let wi = (layered.local_from_world * Vec3::new(x, y, z)).normalize_or_zero();
        if wi.z > 0.0 {
            let (value, _) = layered.bsdf.eval(layered.wo, wi);
            for c in 0..3 {
                terms[c][i] = value[c] * (lambert[i] / wi.z);
            }
        }
    }
    terms
}

/// Visibility times colour times shading, summed over a block.
#[inline(always)]
fn gather<const KIND: u8>(
    asker: &Asker,
    eye: &Eye,
    block: &LightBlock,
    clamp: f32,
    wanted: u16,
    plain: &Lanes,
    visible: [&Lanes; 3],
) -> Vec3 {
    let mut total = [0.0; 3];
    match eye.scatter {
        Scatter::Lambert => {
            let mut terms = *plain;
            if KIND == PATCH {
                for term in &mut terms {
                    *term = if *term < clamp { *term } else { clamp };
                }
            }
            for c in 0..3 {
                let mut lanes = [0.0; BLOCK];
                for i in 0..BLOCK {
                    // Of lights that were not asked for the term may be anything.
                    let seen = visible[c][i] * (terms[i] * block.colour[c][i]);
                    lanes[i] = if wanted >> i & 1 != 0 { seen } else { 0.0 };
                }
                total[c] = sum(lanes);
            }
        }
        Scatter::Closed(_) | Scatter::Layered(_) => {
            let terms = match eye.scatter {
                Scatter::Closed(index) => {
                    closed::<KIND>(eye, &asker.scatterers.closed[index as usize], block, clamp)
                }
                Scatter::Layered(index) => layered::<KIND>(
                    eye,
                    &asker.scatterers.layered[index as usize],
                    block,
                    clamp,
                    wanted,
                ),
                Scatter::Lambert => [[0.0; BLOCK]; 3],
            };
            for c in 0..3 {
                let mut lanes = [0.0; BLOCK];
                for i in 0..BLOCK {
                    let seen = visible[c][i] * (terms[c][i] * block.colour[c][i]);
                    lanes[i] = if wanted >> i & 1 != 0 { seen } else { 0.0 };
                }
                total[c] = sum(lanes);
            }
        }
    }
    eye.weight * Vec3::from_array(total)
}

/// What the bound takes away, all channels.
#[cold]
fn loss(
    asker: &Asker,
    eye: &Eye,
    block: &LightBlock,
    wanted: u16,
    plain: &Lanes,
    visible: [&Lanes; 3],
    bounded: Vec3,
) -> f32 {
    let unbounded = f32::INFINITY;
    let whole = gather::<PATCH>(asker, eye, block, unbounded, wanted, plain, visible);
    (whole - bounded).element_sum()
}

#[inline(always)]
fn take<const KIND: u8>(asker: &mut Asker, index: usize, wanted: &[u16], answers: &[BlockAnswers]) {
    let lights = asker.lights;
    let block = &lights.blocks[index];
    for (e, (&mask, answers)) in wanted.iter().zip(answers).enumerate() {
        if mask == 0 {
            continue;
        }
        let eye = &asker.eyes[e];
        let tinted = asker.panes.map(|geometry| {
            let shared = &lights.shared[index * BLOCK..];
            tint(geometry, &asker.ends[e], shared, answers)
        });
        let visible = match &tinted {
            Some([r, g, b]) => [r, g, b],
            None => [answers; 3],
        };
        let plain = lambert::<KIND>(eye, block, f32::INFINITY);
        let brought = gather::<KIND>(asker, eye, block, asker.clamp, mask, &plain, visible);
        let sample = eye.sample as usize;
        if KIND == PATCH {
            let mut excess = [0.0; BLOCK];
            for i in 0..BLOCK {
                let seen = answers[i].abs();
                excess[i] = if plain[i] > asker.clamp { seen } else { 0.0 };
            }
            if sum(excess) > 0.0 {
                let lost = loss(asker, eye, block, mask, &plain, visible, brought);
                asker.clamped += f64::from(lost);
            }
        }
        asker.radiance[sample] += brought;
    }
}

/// Visibility by colour, behind panes.
#[cold]
fn tint(
    geometry: &Geometry,
    eye: &EyeSample,
    lights: &[SharedLight],
    answers: &Lanes,
) -> [Lanes; 3] {
    let mut tinted = [[0.0; BLOCK]; 3];
    for (i, (light, &answer)) in lights.iter().zip(answers).enumerate() {
        if answer != 0.0 {
            let colour = geometry.pane_transmittance(&light.ray_from(eye.origin)) * answer;
            for c in 0..3 {
                tinted[c][i] = colour[c];
            }
        }
    }
    tinted
}

/// What light `light` of a list would bring to a Lambert eye, unblocked, and whether it is asked for at all: the plain form that
/// the loops above are tested against, and that the choice of virtual lights uses.
pub(super) fn patch_on_lambert(
    eye: &Eye,
    position: Vec3,
    normal: Vec3,
    colour: Vec3,
    events: u32,
    clamp: f32,
) -> Vec3 {
    let way = position - eye.position;
    let (above, cosine, along) = (
        eye.normal.dot(way),
        eye.shading_normal.dot(way),
        -normal.dot(way),
    );
    if above <= 0.0 || cosine <= 0.0 || along <= 0.0 || events as f32 > eye.events_left {
        return Vec3::ZERO;
    }
    let distance2 = way.length_squared();
    eye.weight * colour * (cosine * along / (distance2 * distance2)).min(clamp)
}

#[cfg(test)]
mod tests;
