//! Eye samples, by eights that scatter alike.

use super::wide::{Row, WIDE};
use crate::bsdf::{Broad, Bsdf, COEFFICIENTS};
use glam::{Mat3, Vec3};

/// How an eye sample scatters.
#[derive(Clone, Copy, Debug)]
pub(in super::super) enum Scatter {
    /// Lambert; the colour is in [`Eye::weight`].
    Lambert,
    /// A [`Closed`] form, by number.
    Closed(u32),
    /// A [`Layered`] material, by number.
    Layered(u32),
}

/// What shading needs to know about an eye sample.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Eye {
    pub(in super::super) position: Vec3,
    /// Geometric and shading normal, both on the side that is seen.
    pub(in super::super) normal: Vec3,
    pub(in super::super) shading_normal: Vec3,
    /// Share of the light leaving towards the viewer that arrives at the film; of Lambert surfaces times base colour / π.
    pub(in super::super) weight: Vec3,
    /// Scattering events that a light path may have, so that the whole path keeps to the largest depth.
    pub(in super::super) events_left: f32,
    pub(in super::super) scatter: Scatter,
    /// The camera sample that it belongs to.
    pub(in super::super) sample: u32,
}

/// An unlayered surface.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Closed {
    pub(in super::super) broad: Broad,
    /// Unit vector towards the viewer.
    pub(in super::super) wo: Vec3,
    pub(in super::super) cos_o: f32,
}

/// A surface with coat or sheen.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Layered {
    pub(in super::super) bsdf: Bsdf,
    pub(in super::super) local_from_world: Mat3,
    pub(in super::super) wo: Vec3,
}

/// Surfaces that are more than Lambert, by the numbers in [`Scatter`].
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Scatterers {
    pub(in super::super) closed: Vec<Closed>,
    pub(in super::super) layered: Vec<Layered>,
}

/// Eight eyes that scatter alike. Eyes that are not there repeat the first, and are never written to.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub(super) struct Pack {
    pub(super) position: [Row; 3],
    pub(super) normal: [Row; 3],
    pub(super) shading_normal: [Row; 3],
    pub(super) events_left: Row,
    pub(super) weight: [Row; 3],
    /// What lights brought so far, without `weight`.
    pub(super) brought: [Row; 3],
    pub(super) eyes: [u32; WIDE],
    pub(super) count: usize,
}

/// The closed forms of a pack.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub(super) struct ClosedPack {
    pub(super) constant: [Row; 3],
    pub(super) by_a: [Row; 3],
    pub(super) by_b: [Row; 3],
    pub(super) a: [Row; COEFFICIENTS],
    pub(super) b: [Row; COEFFICIENTS],
    pub(super) f0: [Row; 3],
    pub(super) f90: Row,
    pub(super) alpha2: Row,
    pub(super) root_o: Row,
    pub(super) wo: [Row; 3],
    pub(super) cos_o: Row,
}

/// All eyes: Lambert surfaces first, then closed forms, then layered materials.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Packs {
    pub(super) packs: Vec<Pack>,
    /// How many packs are Lambert.
    pub(super) lambert: usize,
    /// Of the packs after those.
    pub(super) closed: Vec<ClosedPack>,
    /// Where each eye is: 8 times its pack, plus its place there.
    pub(super) slots: Vec<u32>,
    chosen: Vec<u32>,
}

fn set(rows: &mut [Row; 3], lane: usize, value: Vec3) {
    for (row, value) in rows.iter_mut().zip(value.to_array()) {
        row[lane] = value;
    }
}

impl Packs {
    /// Packs `eyes`, in their order: neighbours see the same lights.
    pub(in super::super) fn gather(&mut self, eyes: &[Eye], scatterers: &Scatterers) {
        self.packs.clear();
        self.closed.clear();
        self.slots.clear();
        self.slots.resize(eyes.len(), 0);
        self.choose(eyes, |scatter| matches!(scatter, Scatter::Lambert));
        self.lambert = self.packs.len();
        self.choose(eyes, |scatter| matches!(scatter, Scatter::Closed(_)));
        for pack in &self.packs[self.lambert..] {
            let mut closed = ClosedPack::default();
            for (lane, &eye) in pack.eyes.iter().enumerate() {
                if let Scatter::Closed(index) = eyes[eye as usize].scatter {
                    closed.set(lane, &scatterers.closed[index as usize]);
                }
            }
            self.closed.push(closed);
        }
        self.choose(eyes, |scatter| matches!(scatter, Scatter::Layered(_)));
    }

    fn choose(&mut self, eyes: &[Eye], alike: impl Fn(Scatter) -> bool) {
        self.chosen.clear();
        let numbers = 0..eyes.len() as u32;
        self.chosen
            .extend(numbers.filter(|&e| alike(eyes[e as usize].scatter)));
        for members in self.chosen.chunks(WIDE) {
            let mut pack = Pack {
                eyes: [members[0]; WIDE],
                count: members.len(),
                ..Pack::default()
            };
            pack.eyes[..members.len()].copy_from_slice(members);
            for (lane, &e) in pack.eyes.iter().enumerate() {
                let eye = &eyes[e as usize];
                set(&mut pack.position, lane, eye.position);
                set(&mut pack.normal, lane, eye.normal);
                set(&mut pack.shading_normal, lane, eye.shading_normal);
                set(&mut pack.weight, lane, eye.weight);
                pack.events_left[lane] = eye.events_left;
            }
            for (lane, &e) in members.iter().enumerate() {
                self.slots[e as usize] = (self.packs.len() * WIDE + lane) as u32;
            }
            self.packs.push(pack);
        }
    }

    /// Adds what lights brought to `radiance`, by camera sample.
    pub(in super::super) fn settle(&self, eyes: &[Eye], radiance: &mut [Vec3]) {
        for pack in &self.packs {
            for (lane, &eye) in pack.eyes[..pack.count].iter().enumerate() {
                let eye = &eyes[eye as usize];
                let brought = Vec3::from_array(pack.brought.map(|row| row[lane]));
                radiance[eye.sample as usize] += eye.weight * brought;
            }
        }
    }
}

impl ClosedPack {
    fn set(&mut self, lane: usize, closed: &Closed) {
        let Closed { broad, wo, cos_o } = closed;
        set(&mut self.constant, lane, broad.constant);
        set(&mut self.by_a, lane, broad.by_a);
        set(&mut self.by_b, lane, broad.by_b);
        set(&mut self.f0, lane, broad.f0);
        set(&mut self.wo, lane, *wo);
        for i in 0..COEFFICIENTS {
            self.a[i][lane] = broad.albedo.a[i];
            self.b[i][lane] = broad.albedo.b[i];
        }
        self.f90[lane] = broad.f90;
        self.alpha2[lane] = broad.alpha2;
        self.root_o[lane] = broad.root_o;
        self.cos_o[lane] = *cos_o;
    }
}
