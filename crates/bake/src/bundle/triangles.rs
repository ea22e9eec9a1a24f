//! What bundles are rasterized from: all triangles of a posed scene in one list, each with its place in the light map.
//!
//! Instances are flattened: whoever has a place of its own in the light map costs more in sums than in vertices. Coordinates are relative
//! to the middle of the scene, sixteen triangles to a block, so that a block is transformed without gathering anything.
//!
//! Every surface blocks and reflects on both sides, and radiance leaves from *sides*:
//! * the front of a texel of the atlas; that is what is baked;
//! * the front of a *stand-in*: a triangle that has no texels still blocks and reflects, with one value for all of it;
//! * the back of either, where it matters: [`Triangles::find_backs`] looks which backs are seen by something that is seen.

use super::radiance::hash;
use crate::atlas::Atlas;
use glam::{Vec2, Vec3};
use occlude_render::geometry::{WorldTriangle, covers, is_filtered};
use occlude_scene::{Pose, Scene};

/// Triangles of a block.
pub(super) const LANES: usize = 16;

/// Sixteen triangles: the x of all first corners, then the y, the z, then those of the second corners, then the third.
pub(super) type Block = [[f32; LANES]; 9];

/// Stand-ins are laid out in rows of this many.
const STAND_IN_ROW: u32 = 4096;

/// Sides of this many neighbouring texels have their backs together, or none has.
pub(super) const BACK_RUN: u32 = 64;

/// No side is there.
pub(super) const NO_SIDE: u32 = u32::MAX;

/// The sides of all surfaces, numbered: texels of the atlas, stand-ins, backs.
#[derive(Clone, Debug, Default)]
pub struct Sides {
    texels: u32,
    /// Instance and primitive of every stand-in.
    stand_ins: Vec<[u32; 2]>,
    /// By run of fronts: the first back of the run, or [`NO_SIDE`].
    backs: Vec<u32>,
    /// By run of backs: the first front.
    fronts: Vec<u32>,
}

impl Sides {
    /// Number of all sides.
    pub fn count(&self) -> u32 {
        self.fronts_count() + self.fronts.len() as u32 * BACK_RUN
    }

    /// Texels of the atlas: their fronts are sides `0..texels`.
    pub fn texels(&self) -> u32 {
        self.texels
    }

    /// The stand-ins: instance and primitive of sides `texels..`.
    pub fn stand_ins(&self) -> &[[u32; 2]] {
        &self.stand_ins
    }

    /// Number of fronts: texels and stand-ins.
    pub fn fronts_count(&self) -> u32 {
        self.texels + self.stand_ins.len() as u32
    }

    /// The back of a front, if it matters.
    pub fn back_of(&self, front: u32) -> Option<u32> {
        let first = *self.backs.get((front / BACK_RUN) as usize)?;
        (first != NO_SIDE).then(|| first + front % BACK_RUN)
    }

    /// The front of any side; a front is its own. Numbers from [`Sides::fronts_count`] on are of nothing: backs come in runs.
    pub fn front_of(&self, side: u32) -> u32 {
        match side.checked_sub(self.fronts_count()) {
            None => side,
            Some(back) => self.fronts[(back / BACK_RUN) as usize] + back % BACK_RUN,
        }
    }

    /// Whether some backs matter, as far as is known.
    pub(crate) fn has_backs(&self) -> bool {
        !self.fronts.is_empty()
    }

    /// Whether a side is a back.
    pub fn is_back(&self, side: u32) -> bool {
        side >= self.fronts_count()
    }

    pub(super) fn backs(&self) -> &[u32] {
        &self.backs
    }
}

/// Where the texels of a triangle are numbered: number = first + row * stride + column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lot {
    pub first: u32,
    pub stride: u32,
}

/// Some triangles let light pass: cut-outs and blended materials.
const FILTERED: u32 = 1 << 31;
/// The second and third corners are swapped, so that the side that is baked runs counterclockwise in the world.
const MIRRORED: u32 = 1 << 30;

/// Its chart is so much denser than the instance's that lines cannot serve it.
const TINY: u32 = 1 << 29;

/// Charts with more texels per m² than so many times what was asked for are tiny: a ray each costs less than lines for all.
pub const MOST_SHARE: f32 = 4.0;

/// All triangles of a posed scene with their places in the light map.
#[derive(Debug)]
pub struct Triangles<'a> {
    scene: &'a Scene,
    pose: &'a Pose,
    sides: Sides,
    blocks: Vec<Block>,
    charts: Vec<[Vec2; 3]>,
    /// Index into `lots`, and flags.
    notes: Vec<u32>,
    lots: Vec<Lot>,
    importance: Vec<f32>,
    /// First triangle of every instance, and the number of all.
    firsts: Vec<u32>,
    center: Vec3,
    low: Vec3,
    high: Vec3,
    largest_area: f32,
    area: f64,
    needed: f64,
    has_tiny: bool,
    most_share: f32,
}

impl<'a> Triangles<'a> {
    /// Bytes a triangle takes.
    pub const BYTES: u64 = (size_of::<Block>() / LANES + size_of::<[Vec2; 3]>() + 4 + 4) as u64;

    /// Flattens a posed scene. O(triangles). No back has a number yet: see [`Triangles::find_backs`].
    pub fn new(scene: &'a Scene, pose: &'a Pose, atlas: &Atlas) -> Self {
        Self::with_lines_for(scene, pose, atlas, MOST_SHARE)
    }

    /// The same with lines for charts that are at most `most_share` times as dense, in texels per m², as their instance's density asks for; infinity: for
    /// all.
    pub fn with_lines_for(
        scene: &'a Scene,
        pose: &'a Pose,
        atlas: &Atlas,
        most_share: f32,
    ) -> Self {
        let mut firsts = vec![0];
        for posed in &pose.instances {
            let count = scene.meshes[posed.mesh as usize].triangles.len() as u32;
            firsts.push(firsts.last().copied().unwrap_or(0) + count);
        }
        let count = firsts.last().copied().unwrap_or(0) as usize;

        let mut lots: Vec<Lot> = atlas
            .pages
            .iter()
            .map(|page| Lot {
                first: page.first_texel,
                stride: page.width,
            })
            .collect();
        let texels = atlas.texels();
        let stand_in_lot = lots.len() as u32;
        lots.push(Lot {
            first: texels,
            stride: STAND_IN_ROW,
        });

        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (number, posed) in pose.instances.iter().enumerate() {
            for &position in pose.positions(scene, number) {
                let position = posed.world_from_object.transform_point3(position);
                if position.is_finite() {
                    (low, high) = (low.min(position), high.max(position));
                }
            }
        }
        if !(low.is_finite() && high.is_finite()) {
            (low, high) = (Vec3::ZERO, Vec3::ZERO);
        }
        let center = (low + high) * 0.5;

        let mut triangles = Self {
            scene,
            pose,
            sides: Sides {
                texels,
                ..Sides::default()
            },
            blocks: vec![[[0.0; LANES]; 9]; count.div_ceil(LANES)],
            charts: Vec::with_capacity(count),
            notes: Vec::with_capacity(count),
            lots,
            importance: Vec::with_capacity(count),
            firsts,
            center,
            low: low - center,
            high: high - center,
            largest_area: 0.0,
            area: 0.0,
            needed: 0.0,
            has_tiny: false,
            most_share,
        };
        for (number, posed) in pose.instances.iter().enumerate() {
            let mesh = &scene.meshes[posed.mesh as usize];
            let filtered = if is_filtered(scene, mesh) {
                FILTERED
            } else {
                0
            };
            for primitive in 0..mesh.triangles.len() as u32 {
                let world = WorldTriangle::new(scene, pose, number as u32, primitive);
                let place = atlas.triangle(number as u32, primitive);
                let turned = atlas.is_turned(number as u32, primitive);
                triangles.push(
                    number as u32,
                    primitive,
                    (&world, turned),
                    place,
                    filtered,
                    stand_in_lot,
                );
            }
            let placement = atlas.placements.get(number).copied().flatten();
            let density =
                placement.map_or(0.0, |p| atlas.layouts[p.layout as usize].texels_per_metre);
            triangles.bound_importance(number, density);
        }
        let runs = triangles.sides.fronts_count().div_ceil(BACK_RUN);
        triangles.number_backs((0..runs).map(|_| false));
        triangles
    }

    fn push(
        &mut self,
        instance: u32,
        primitive: u32,
        (world, turned): (&WorldTriangle, bool),
        place: Option<(u32, [Vec2; 3])>,
        filtered: u32,
        stand_in_lot: u32,
    ) {
        let mut corners = world.corners;
        let mut note = filtered;
        let area = 0.5 * world.front_cross().length();
        let (lot, mut chart, importance) = match place {
            Some((page, chart)) => {
                let [a, b, c] = chart;
                let texels = 0.5 * (b - a).perp_dot(c - a).abs();
                (page, chart, texels / area)
            }
            None => {
                let number = self.sides.stand_ins.len() as u32;
                self.sides.stand_ins.push([instance, primitive]);
                let middle = Vec2::new(
                    (number % STAND_IN_ROW) as f32 + 0.5,
                    (number / STAND_IN_ROW) as f32 + 0.5,
                );
                (stand_in_lot, [middle; 3], 0.0)
            }
        };
        if world.mirrored != turned {
            corners.swap(1, 2);
            chart.swap(1, 2);
            note |= MIRRORED;
        }
        let index = self.charts.len();
        for (k, corner) in corners.iter().enumerate() {
            let corner = if corner.is_finite() {
                *corner - self.center
            } else {
                Vec3::ZERO
            };
            for axis in 0..3 {
                self.blocks[index / LANES][3 * k + axis][index % LANES] = corner[axis];
            }
        }
        self.charts.push(chart);
        self.notes.push(lot | note);
        let sound = importance.is_finite() && area > 0.0;
        self.importance.push(if sound { importance } else { 0.0 });
        if area.is_finite() {
            self.area += f64::from(area);
            if place.is_none() {
                self.largest_area = self.largest_area.max(area);
            }
        }
    }

    /// Bounds the importance of an instance's triangles around what its density asks for.
    ///
    /// From below: slivers whose chart has collapsed need lines as their neighbours do, and no single one may stretch the range of
    /// weights. From above: no chart has less than a texel, so those of screws and slivers are thousands of times denser than was asked
    /// for, and a line through any of them is a line through everything else behind. They are marked as tiny: rays of their own serve them
    /// better.
    fn bound_importance(&mut self, instance: usize, texels_per_metre: f32) {
        const LEAST_SHARE: f32 = 1.0 / 16.0;
        let range = self.firsts[instance] as usize..self.firsts[instance + 1] as usize;
        let area = |number: usize| {
            let block = &self.blocks[number / LANES];
            let corner =
                |k: usize| Vec3::from_array([0, 1, 2].map(|a| block[3 * k + a][number % LANES]));
            let (a, b, c) = (corner(0), corner(1), corner(2));
            f64::from(0.5 * (b - a).cross(c - a).length())
        };
        let areas: Vec<f64> = range.clone().map(area).collect();
        let sum = |importance: &[f32]| -> f64 {
            let terms = areas.iter().zip(importance);
            terms.map(|(area, &i)| area * f64::from(i)).sum()
        };
        let usual = if texels_per_metre > 0.0 {
            texels_per_metre * texels_per_metre
        } else {
            (sum(&self.importance[range.clone()]) / areas.iter().sum::<f64>()) as f32
        };
        if !(usual.is_finite() && usual > 0.0) {
            return;
        }
        let least = usual * LEAST_SHARE;
        let most = usual * self.most_share;
        let notes = self.notes[range.clone()].iter_mut();
        for (importance, note) in self.importance[range.clone()].iter_mut().zip(notes) {
            if *importance > most {
                *note |= TINY;
                self.has_tiny = true;
            }
            *importance = importance.clamp(least, most);
        }
        self.needed += sum(&self.importance[range]);
        self.largest_area = self.largest_area.max(1.0 / least);
    }

    /// Numbers the backs of these runs of fronts.
    pub(super) fn number_backs(&mut self, seen: impl Iterator<Item = bool>) {
        let mut next = self.sides.fronts_count();
        self.sides.fronts.clear();
        self.sides.backs.clear();
        for (run, seen) in seen.enumerate() {
            self.sides.backs.push(if seen { next } else { NO_SIDE });
            if seen {
                next += BACK_RUN;
                self.sides.fronts.push(run as u32 * BACK_RUN);
            }
        }
    }

    /// How sides are numbered.
    pub fn sides(&self) -> &Sides {
        &self.sides
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.charts.len()
    }

    /// Whether there are no triangles.
    pub fn is_empty(&self) -> bool {
        self.charts.is_empty()
    }

    /// The largest area that a single side stands for, m²: what weights are relative to.
    pub fn largest_area(&self) -> f32 {
        self.largest_area.max(f32::MIN_POSITIVE)
    }

    /// Area of all triangles, m².
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Texels that need lines: area times importance.
    pub(super) fn needed_texels(&self) -> f64 {
        self.needed
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> u64 {
        self.len() as u64 * Self::BYTES
            + (self.sides.backs.len() + self.sides.fronts.len() + self.firsts.len()) as u64 * 4
            + self.sides.stand_ins.len() as u64 * 8
    }

    /// Whether some charts are tiny.
    pub(crate) fn has_tiny(&self) -> bool {
        self.has_tiny
    }

    /// Whether a triangle's chart is tiny.
    pub(crate) fn is_tiny(&self, instance: u32, primitive: u32) -> bool {
        let triangle = self.firsts[instance as usize] + primitive;
        self.notes[triangle as usize] & TINY != 0
    }

    /// The front at a point of a triangle; `u` and `v` weigh the second and the third corner.
    pub(crate) fn front_at(&self, instance: u32, primitive: u32, u: f32, v: f32) -> u32 {
        let triangle = self.firsts[instance as usize] + primitive;
        let [a, b, c] = self.charts[triangle as usize];
        let mirrored = self.notes[triangle as usize] & MIRRORED != 0;
        let (u, v) = if mirrored { (v, u) } else { (u, v) };
        let at = a + (b - a) * u + (c - a) * v;
        let lot = self.lot(triangle);
        let front = lot.first + at.y as u32 * lot.stride + (at.x as u32).min(lot.stride - 1);
        front.min(self.sides.fronts_count() - 1)
    }

    /// Instance and primitive of a triangle.
    pub(super) fn origin(&self, triangle: u32) -> (u32, u32) {
        let instance = self.firsts.partition_point(|&first| first <= triangle) - 1;
        (instance as u32, triangle - self.firsts[instance])
    }

    pub(super) fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    pub(super) fn importance(&self) -> &[f32] {
        &self.importance
    }

    pub(super) fn chart(&self, triangle: u32) -> &[Vec2; 3] {
        &self.charts[triangle as usize]
    }

    pub(super) fn lot(&self, triangle: u32) -> Lot {
        self.lots[(self.notes[triangle as usize] & !(FILTERED | MIRRORED | TINY)) as usize]
    }

    pub(super) fn is_filtered(&self, triangle: u32) -> bool {
        self.notes[triangle as usize] & FILTERED != 0
    }

    /// Where light passes a filtered triangle.
    pub(super) fn coverage(&self, triangle: u32) -> Coverage<'_> {
        let (instance, primitive) = self.origin(triangle);
        Coverage {
            scene: self.scene,
            pose: self.pose,
            instance,
            primitive,
            mirrored: self.notes[triangle as usize] & MIRRORED != 0,
            key: hash(triangle),
        }
    }

    /// The scene's box, relative to its middle.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        (self.low, self.high)
    }
}

/// Which points of a cut-out or blended triangle are there.
pub(super) struct Coverage<'a> {
    scene: &'a Scene,
    pose: &'a Pose,
    instance: u32,
    primitive: u32,
    mirrored: bool,
    key: u32,
}

impl Coverage<'_> {
    /// Weights `u` and `v` of the second and third corner; `line` and `key` make chance, where the material is blended.
    pub fn covers(&self, u: f32, v: f32, line: [u32; 2], key: u32) -> bool {
        let (u, v) = if self.mirrored { (v, u) } else { (u, v) };
        let chance = hash(line[0] ^ hash(line[1] ^ hash(key ^ self.key)));
        let chance = (chance >> 8) as f32 / (1 << 24) as f32;
        covers(
            self.scene,
            self.pose,
            self.instance,
            self.primitive,
            u,
            v,
            chance,
        )
    }
}
