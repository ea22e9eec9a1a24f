//! Shading by blocks of 16 lights: what each light would bring to an eye sample, if nothing blocked it.
//!
//! Eight eyes at a time ([`packs`]), light after light ([`kernels`]), in vectors of eight numbers ([`wide`]), compiled for AVX2
//! and for any machine; which is chosen at run time does not show in the result.
//!
//! An eye sample is either Lambert, or has the closed form of [`Broad`](crate::bsdf::Broad), or (layered materials) asks its
//! [`Bsdf`](crate::bsdf::Bsdf) light by light.

mod kernels;
mod packs;
mod panes;
mod wide;

use glam::Vec3;
use occlude_visibility::{BLOCK, Correction, ManyLights, SharedLight};
pub(super) use packs::{Closed, Eye, Layered, Packs, Scatter, Scatterers};
pub(super) use panes::Panes;

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

    /// The virtual lights: where rays end, normal, and radiance times area.
    pub(super) fn patches(&self) -> impl Iterator<Item = (Vec3, Vec3, Vec3)> {
        let shared = self.shared.iter().enumerate();
        shared.map(|(index, shared)| {
            let (block, lane) = (&self.blocks[index / BLOCK], index % BLOCK);
            let vec = |lanes: &[Lanes; 3]| Vec3::from_array(lanes.map(|lanes| lanes[lane]));
            let place = vec(&block.place);
            (
                shared.target.unwrap_or(place),
                vec(&block.axis),
                vec(&block.colour),
            )
        })
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

    /// Fills up the last block with lights that shine on nobody.
    pub(super) fn fill_block(&mut self) {
        if let Some(&last) = self.shared.last() {
            self.shared
                .resize(self.shared.len().next_multiple_of(BLOCK), last);
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.shared.is_empty()
    }
}

/// Asks about the lights of a list for some eyes, and gathers what they bring.
pub(super) struct Asker<'a> {
    pub(super) lights: &'a LightList,
    pub(super) eyes: &'a [Eye],
    pub(super) scatterers: &'a Scatterers,
    /// Bound on the geometry term of patches.
    pub(super) clamp: f32,
    /// Where there are panes that tint light.
    pub(super) panes: Option<Panes<'a>>,
    /// The same eyes; gathers what the lights bring.
    pub(super) packs: &'a mut Packs,
    /// Sum of what the clamp took away, all channels.
    pub(super) clamped: f64,
}

impl ManyLights for Asker<'_> {
    fn wanted(&mut self, block: usize, wanted: &mut [u16]) {
        kernels::wanted(self, block, wanted);
        let rest = self.lights.len() - block * BLOCK;
        if rest < BLOCK {
            let there = (1 << rest) - 1;
            wanted.iter_mut().for_each(|mask| *mask &= there);
        }
    }

    fn take(&mut self, block: usize, visible: &[u16], corrections: &[Correction]) {
        kernels::take(self, block, visible, corrections);
    }
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
