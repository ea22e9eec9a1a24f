//! Light for many pixels of a tile at once.
//!
//! Distances are made to be interpolated: between sample points, as in Wang et al. 2013, and just as well between pixels. So the fields are read
//! at nine **anchors** of a tile alone, for the directions that matter there. Pixels between them take their distances from the four around
//! ([`Anchors`]), and everything else (products of lobes, shares, albedos) is theirs alone, so that textures stay as sharp as they are.
//!
//! A product of a lobe of the sky and one of the surface lies on the arc between them, nearer to the narrower. Where roughness differs within the tile, distances
//! are read at several places of the arc. Of broad products not distances are read but harmonics of what points see ([`BroadShare`]), which cost next to nothing.
//!
//! Distances change by no more than the direction does, and weights of sample points slowly, so that the error is bounded by how far a pixel is
//! from what its anchors predict: its place, its normal, and the axis of its reflection in widths of the lobe. Pixels that are not as
//! predicted (edges, bumps) are shaded one by one: that is the slow twin, which tests compare with.
//!
//! The wrong tool where hardly any pixel is as predicted (hair, foliage): anchors then only add to the work.

use super::eyes::Eye;
use super::lamps::Distances;
use super::math::{asin, exp, wide};
use super::points::{Near, Points};
use super::sky::{Sky, WIDE, bend};
use glam::Vec3;
use occlude_visibility::field::{BroadShare, Harmonics, VisibleShare, bands_at_eight};

/// Pixels of a batch.
pub(super) const ITEMS: usize = 64;
const CHUNKS: usize = ITEMS / WIDE;

/// Anchors along a side of a tile, in all, and their pixels.
const SIDE: usize = 3;
pub(super) const ANCHORS: usize = SIDE * SIDE;
pub(super) const AT: [u32; SIDE] = [0, 4, 7];

/// What brings less than this share of a pixel's light is left out.
const NEGLIGIBLE: f32 = 2e-3;
/// Places on an arc at most, and how far apart they are, in widths of the product.
const MOST_NODES: usize = 4;
const NODE_STEP: f32 = 0.6;
/// How far from its prediction the axis of a reflection may be, in widths of the lobe.
const AXIS_OFF: f32 = 0.15;

/// A number a pixel.
type Column = [f32; ITEMS];

/// Glossy lobes, one a pixel.
#[derive(Clone, Debug)]
struct Layer {
    axis: [Column; 3],
    sharpness: Column,
    /// Amplitude times albedo, by colour; black where a pixel has no such lobe, or is shaded by itself.
    amplitude: [Column; 3],
    /// What the sky beside its lobes brings, were nothing in the way.
    rest: [Column; 3],
    weight: Column,
    /// Of the product with every lobe of the sky: sharpness and integral.
    length: Vec<Column>,
    value: Vec<Column>,
}

impl Default for Layer {
    fn default() -> Self {
        Self {
            axis: [[0.0; ITEMS], [1.0; ITEMS], [0.0; ITEMS]],
            sharpness: [1.0; ITEMS],
            amplitude: [[0.0; ITEMS]; 3],
            rest: [[0.0; ITEMS]; 3],
            weight: [0.0; ITEMS],
            length: Vec::new(),
            value: Vec::new(),
        }
    }
}

/// A tile's anchors.
#[derive(Clone, Debug, Default)]
pub(super) struct Anchors {
    eyes: [Option<Eye>; ANCHORS],
    /// Mirrored lines of sight.
    axis: [Vec3; ANCHORS],
    /// Points that speak for an anchor.
    near: [Vec<(u32, f32)>; ANCHORS],
    /// What of every lobe of the sky is seen, see [`Sky::seen_from`].
    seen: Vec<[f32; ANCHORS]>,
    light: [Near; ANCHORS],
    lamps: [Distances; ANCHORS],
    harmonics: [Harmonics; ANCHORS],
    /// Width of a pixel at a distance of 1, and at 0.
    pixel: [f32; 2],
}

/// What pixels of a tile ask for.
#[derive(Clone, Debug)]
pub(super) struct Batch {
    len: usize,
    /// Weights of anchors' columns and rows.
    across: [Column; SIDE],
    down: [Column; SIDE],
    normal: [Column; 3],
    /// Albedo of the cosine lobe.
    cosine: [Column; 3],
    layers: Vec<Layer>,
    used: usize,
    slots: Vec<Slot>,
    /// Distances by slot and anchor.
    distances: Vec<[f32; ANCHORS]>,
    /// Directions that harmonics are asked for, and what their bands say by anchor.
    broad_slots: Vec<Slot>,
    bands: Vec<[[f32; ANCHORS]; 4]>,
    plans: Vec<Plan>,
    radiance: [Column; 3],
}

/// A direction that fields are asked for: on the arc from the anchor's axis to a lobe of the sky.
#[derive(Clone, Copy, Debug)]
struct Slot {
    lobe: usize,
    /// 0 at the axis, 1 at the lobe: weights of the two.
    along: f32,
}

/// The product of a layer and a lobe of the sky, or the layer and what the sky has beside its lobes.
#[derive(Clone, Copy, Debug)]
struct Plan {
    layer: usize,
    lobe: Option<usize>,
    /// First of the slots, where some products are narrow enough for distances.
    slot: Option<usize>,
    /// First of the broad slots, where some are broad enough for harmonics.
    broad: Option<usize>,
    nodes: usize,
    first: f32,
    /// Nodes an `along`.
    per: f32,
}

impl Default for Batch {
    fn default() -> Self {
        Self {
            len: 0,
            across: [[0.0; ITEMS]; SIDE],
            down: [[0.0; ITEMS]; SIDE],
            normal: [[0.0; ITEMS]; 3],
            cosine: [[0.0; ITEMS]; 3],
            layers: Vec::new(),
            used: 0,
            slots: Vec::new(),
            distances: Vec::new(),
            broad_slots: Vec::new(),
            bands: Vec::new(),
            plans: Vec::new(),
            radiance: [[0.0; ITEMS]; 3],
        }
    }
}

fn set(columns: &mut [Column; 3], item: usize, value: Vec3) {
    for (column, value) in columns.iter_mut().zip(value.to_array()) {
        column[item] = value;
    }
}

/// Weights of three anchors along an axis at a pixel of the tile.
fn hats(x: f32) -> [f32; SIDE] {
    let [a, b, c] = AT.map(|at| at as f32);
    if x < b {
        let t = ((x - a) / (b - a)).max(-0.25);
        [1.0 - t, t, 0.0]
    } else {
        let t = ((x - b) / (c - b)).min(1.25);
        [0.0, 1.0 - t, t]
    }
}

impl Anchors {
    /// `eyes` and mirrored lines of sight of the nine pixels, row after row; width of a pixel at distances of 1 and 0.
    pub(super) fn set(
        &mut self,
        eyes: [Option<Eye>; ANCHORS],
        toward_eye: [Vec3; ANCHORS],
        pixel: [f32; 2],
    ) {
        self.eyes = eyes;
        self.pixel = pixel;
        for ((axis, eye), o) in self.axis.iter_mut().zip(&self.eyes).zip(toward_eye) {
            *axis = eye.map_or(Vec3::Y, |eye| 2.0 * eye.normal.dot(o) * eye.normal - o);
        }
    }

    /// The points that speak for an anchor.
    pub(super) fn speak(&mut self, anchor: usize, near: &[(u32, f32)]) {
        self.near[anchor].clear();
        self.near[anchor].extend_from_slice(near);
    }

    /// Interpolates what is seen at the anchors.
    pub(super) fn look(&mut self, points: &Points, sky: &Sky) {
        self.seen.clear();
        self.seen.resize(sky.seen_len(), [0.0; ANCHORS]);
        self.light = Default::default();
        self.lamps = Default::default();
        self.harmonics = Default::default();
        for (anchor, near) in self.near.iter().enumerate() {
            if self.eyes[anchor].is_none() {
                continue;
            }
            for &(id, weight) in near {
                let point = &points.list[id as usize];
                self.light[anchor].add(&point.near, weight);
                for (sum, distance) in self.lamps[anchor].iter_mut().zip(&point.lamps) {
                    *sum += distance * weight;
                }
                for (sum, c) in self.harmonics[anchor].iter_mut().zip(&point.harmonics) {
                    *sum += c * weight;
                }
                for (sum, value) in self.seen.iter_mut().zip(&point.seen) {
                    sum[anchor] += value * weight;
                }
            }
        }
    }

    /// Light from near by at a pixel.
    pub(super) fn near(&self, at: &Predicted) -> Near {
        let mut sum = Near::default();
        for (anchor, near) in self.light.iter().enumerate() {
            sum.add(near, at.across[anchor % SIDE] * at.down[anchor / SIDE]);
        }
        sum
    }

    /// How far edges of visibility are from the middles of lamps, at a pixel.
    pub(super) fn lamps(&self, at: &Predicted) -> Distances {
        let mut sum = Distances::default();
        for (anchor, distances) in self.lamps.iter().enumerate() {
            let weight = at.across[anchor % SIDE] * at.down[anchor / SIDE];
            for (sum, distance) in sum.iter_mut().zip(distances) {
                *sum += distance * weight;
            }
        }
        sum
    }

    /// Weights of the anchors at a pixel of the tile (fractional, from 0 to 7), and the mirrored line of sight that they predict; `None` if what is seen there is not
    /// what they predict.
    pub(super) fn predict(&self, eye: &Eye, x: f32, y: f32) -> Option<Predicted> {
        /// Off the surface, in pixels.
        const OFF: f32 = 0.5;
        /// Along the surface, as a part of the distance between anchors.
        const SLIP: f32 = 0.2;
        const TURN: f32 = 0.1;
        let (across, down) = (hats(x), hats(y));
        let (mut position, mut normal, mut axis) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
        let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        for (row, v) in down.into_iter().enumerate() {
            for (column, u) in across.into_iter().enumerate() {
                let weight = u * v;
                if weight != 0.0 {
                    let anchor = row * SIDE + column;
                    let at = self.eyes[anchor].as_ref()?;
                    position += at.position * weight;
                    normal += at.normal * weight;
                    axis += self.axis[anchor] * weight;
                    low = low.min(at.position);
                    high = high.max(at.position);
                }
            }
        }
        let pixel = self.pixel[0] * eye.hit.t + self.pixel[1];
        let off = eye.position - position;
        let fits = off.dot(eye.normal).abs() <= OFF * pixel
            && off.length() <= SLIP * (high - low).length() + OFF * pixel
            && (eye.normal - normal).length_squared() <= TURN * TURN;
        fits.then_some(Predicted { across, down, axis })
    }
}

/// What anchors say about a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Predicted {
    across: [f32; SIDE],
    down: [f32; SIDE],
    axis: Vec3,
}

impl Predicted {
    /// Whether the axis of a reflection is near enough to the predicted one.
    pub(super) fn leads_to(&self, axis: Vec3, sharpness: f32) -> bool {
        (axis - self.axis).length_squared() * sharpness <= AXIS_OFF * AXIS_OFF
    }
}

impl Batch {
    pub(super) fn clear(&mut self) {
        self.len = 0;
        self.used = 0;
        self.across = [[0.0; ITEMS]; SIDE];
        self.down = [[0.0; ITEMS]; SIDE];
        self.cosine = [[0.0; ITEMS]; 3];
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds a pixel with its shading normal and the albedo of its cosine lobe. Returns its number; there is room for [`ITEMS`].
    pub(super) fn push(&mut self, at: &Predicted, normal: Vec3, cosine: Vec3) -> usize {
        let item = self.len;
        self.len += 1;
        for k in 0..SIDE {
            self.across[k][item] = at.across[k];
            self.down[k][item] = at.down[k];
        }
        set(&mut self.normal, item, normal);
        set(&mut self.cosine, item, cosine);
        item
    }

    /// Adds a glossy lobe of a pixel: its `layer`-th. `rest` is what a lobe of amplitude 1 would see of the sky beside its lobes, were nothing in the way.
    pub(super) fn gloss(
        &mut self,
        item: usize,
        layer: usize,
        axis: Vec3,
        sharpness: f32,
        [amplitude, rest]: [Vec3; 2],
    ) {
        while self.used <= layer {
            if self.layers.len() == self.used {
                self.layers.push(Layer::default());
            } else {
                let layer = &mut self.layers[self.used];
                (layer.amplitude, layer.rest) = ([[0.0; ITEMS]; 3], [[0.0; ITEMS]; 3]);
            }
            self.used += 1;
        }
        let layer = &mut self.layers[layer];
        set(&mut layer.axis, item, axis);
        layer.sharpness[item] = sharpness;
        set(&mut layer.amplitude, item, amplitude);
        set(&mut layer.rest, item, rest * amplitude);
    }

    /// Radiance towards the eye of every pixel.
    pub(super) fn light(&mut self, points: &Points, sky: &Sky, anchors: &Anchors) {
        matt(self, sky, anchors);
        let layers = &mut self.layers[..self.used];
        let mut light: Column = [0.0; ITEMS];
        for (item, light) in light.iter_mut().enumerate() {
            *light = self.radiance.iter().map(|column| column[item]).sum();
        }
        for layer in &mut *layers {
            products(layer, sky, self.len, &mut light);
        }
        let mut plans = Plans {
            plans: &mut self.plans,
            slots: &mut self.slots,
            broad_slots: &mut self.broad_slots,
        };
        plans.clear();
        for (number, layer) in layers.iter_mut().enumerate() {
            plans.rest(number, layer, &light[..self.len]);
            for (item, weight) in layer.weight.iter_mut().enumerate() {
                *weight = if *weight > 0.0 {
                    *weight / light[item]
                } else {
                    0.0
                };
            }
            plans.products(number, layer, sky, anchors, self.len);
        }
        read(self, points, sky, anchors);
        for index in 0..self.plans.len() {
            shine(self, sky, index);
        }
    }

    pub(super) fn radiance(&self, item: usize) -> Vec3 {
        Vec3::from_array(self.radiance.each_ref().map(|column| column[item]))
    }
}

#[inline(always)]
fn lanes(column: &Column, start: usize) -> [f32; WIDE] {
    std::array::from_fn(|k| column[start + k])
}

/// What the anchors say, interpolated for eight pixels.
#[inline(always)]
fn between(
    across: &[[f32; WIDE]; SIDE],
    down: &[[f32; WIDE]; SIDE],
    at: &[f32; ANCHORS],
) -> [f32; WIDE] {
    let mut sum = [0.0; WIDE];
    for row in 0..SIDE {
        let [a, b, c] = [at[row * SIDE], at[row * SIDE + 1], at[row * SIDE + 2]];
        for k in 0..WIDE {
            sum[k] += down[row][k] * (across[0][k] * a + across[1][k] * b + across[2][k] * c);
        }
    }
    sum
}

wide! {
/// Light in the cosine lobes; sets the radiance.
fn matt(batch: &mut Batch, sky: &Sky, anchors: &Anchors) {
    let share = VisibleShare::new();
    let chunks = batch.len.div_ceil(WIDE);
    batch.radiance = [[0.0; ITEMS]; 3];
    let matt = batch.cosine.iter().any(|column| column.iter().any(|&albedo| albedo > 0.0));
    if !matt {
        return;
    }
    for chunk in 0..chunks {
        let start = chunk * WIDE;
        let across = batch.across.each_ref().map(|column| lanes(column, start));
        let down = batch.down.each_ref().map(|column| lanes(column, start));
        let [x, y, z] = batch.normal.each_ref().map(|column| lanes(column, start));
        let mut sums = [[0.0_f32; WIDE]; 3];
        for lobe in 0..sky.len() {
            let colour = sky.amplitude.each_ref().map(|column| column[lobe]);
            if colour == [0.0; 3] {
                continue;
            }
            let [a, b, c] = sky.axis.each_ref().map(|column| column[lobe]);
            let (slope, bias, width) = (sky.slope[lobe], sky.bias[lobe], sky.width[lobe]);
            let mut seen = between(&across, &down, &anchors.seen[lobe]);
            let mut cos = [0.0; WIDE];
            for k in 0..WIDE {
                cos[k] = x[k] * a + y[k] * b + z[k] * c;
            }
            if lobe >= sky.broad {
                let sharpness = sky.sharpness[lobe];
                let missed = between(&across, &down, &anchors.seen[sky.missed_at(lobe)]);
                let (mut horizon, mut nearest) = ([0.0; WIDE], [0.0; WIDE]);
                for k in 0..WIDE {
                    horizon[k] = asin(cos[k]);
                    nearest[k] = if seen[k] < horizon[k] { seen[k] } else { horizon[k] };
                }
                let free = share.at_eight(&horizon, &[sharpness; WIDE]);
                let left = share.at_eight(&nearest, &[sharpness; WIDE]);
                for k in 0..WIDE {
                    let part = left[k] / (free[k] + 1e-9);
                    let part = missed[k] + if free[k] > 1e-3 { part } else { 0.0 };
                    seen[k] = part.clamp(0.0, 1.0);
                }
            }
            for k in 0..WIDE {
                let whole = slope * bend(cos[k], width) + bias;
                let whole = (if whole > 0.0 { whole } else { 0.0 }) * seen[k];
                sums[0][k] += whole * colour[0];
                sums[1][k] += whole * colour[1];
                sums[2][k] += whole * colour[2];
            }
        }
        for ((sum, albedo), radiance) in
            sums.iter().zip(&batch.cosine).zip(&mut batch.radiance)
        {
            let (albedo, mut light) = (lanes(albedo, start), [0.0; WIDE]);
            for k in 0..WIDE {
                light[k] = sum[k] * albedo[k] * std::f32::consts::FRAC_1_PI;
            }
            radiance[start..start + WIDE].copy_from_slice(&light);
        }
    }
}
}

wide! {
/// The products of a layer with the lobes of the sky; adds what they bring, were nothing in the way, to `light`.
fn products(layer: &mut Layer, sky: &Sky, len: usize, light: &mut Column) {
    let chunks = len.div_ceil(WIDE);
    layer.length.resize(sky.len(), [1.0; ITEMS]);
    layer.value.resize(sky.len(), [0.0; ITEMS]);
    for chunk in 0..CHUNKS {
        let start = chunk * WIDE;
        let colours = layer.amplitude.each_ref().map(|column| lanes(column, start));
        let mut weight = [0.0; WIDE];
        for k in 0..WIDE {
            weight[k] = colours[0][k] + colours[1][k] + colours[2][k];
        }
        if chunk >= chunks {
            weight = [0.0; WIDE];
        }
        layer.weight[start..start + WIDE].copy_from_slice(&weight);
        if weight.iter().all(|&w| w == 0.0) {
            continue;
        }
        let [x, y, z] = layer.axis.each_ref().map(|column| lanes(column, start));
        let own = lanes(&layer.sharpness, start);
        let mut total = [0.0; WIDE];
        for lobe in 0..sky.len() {
            let [a, b, c] = sky.axis.each_ref().map(|column| column[lobe]);
            let other = sky.sharpness[lobe];
            let bright: f32 = sky.amplitude.iter().map(|column| column[lobe]).sum();
            // Arrays of their own, not parts of columns: those might overlap for all that the compiler knows, and it would go pixel by pixel.
            let (mut length, mut value) = ([0.0; WIDE], [0.0; WIDE]);
            for k in 0..WIDE {
                // SphericalGaussian::product; the exponent without the difference of large numbers.
                let cos = x[k] * a + y[k] * b + z[k] * c;
                let sum = own[k] + other;
                let twice = 2.0 * own[k] * other * (1.0 - cos);
                let square = sum * sum - twice;
                let root = (if square > 1e-12 { square } else { 1e-12 }).sqrt();
                length[k] = root;
                value[k] = -twice / (root + sum);
            }
            for k in 0..WIDE {
                let whole = std::f32::consts::TAU * (1.0 - exp(-2.0 * length[k])) / length[k];
                value[k] = exp(value[k]) * whole;
                total[k] += value[k] * bright;
            }
            layer.length[lobe][start..start + WIDE].copy_from_slice(&length);
            layer.value[lobe][start..start + WIDE].copy_from_slice(&value);
        }
        for k in 0..WIDE {
            light[start + k] += total[k] * weight[k];
        }
    }
}
}

/// What is to be added, and where visibility is asked about for it.
struct Plans<'a> {
    plans: &'a mut Vec<Plan>,
    slots: &'a mut Vec<Slot>,
    broad_slots: &'a mut Vec<Slot>,
}

impl Plans<'_> {
    fn clear(&mut self) {
        self.plans.clear();
        self.slots.clear();
        self.broad_slots.clear();
    }

    /// Plans what the sky has beside its lobes, if it matters in a layer.
    fn rest(&mut self, number: usize, layer: &Layer, light: &[f32]) {
        let mut ends = [f32::INFINITY, 0.0];
        for (item, light) in light.iter().enumerate() {
            let rest: f32 = layer.rest.iter().map(|column| column[item].abs()).sum();
            if rest > NEGLIGIBLE * light {
                ends = [
                    ends[0].min(layer.sharpness[item]),
                    ends[1].max(layer.sharpness[item]),
                ];
            }
        }
        self.add(number, None, ends, (0.0, 0.0), 1);
    }

    /// Decides which products of a layer matter, and where on their arcs visibility is read.
    fn products(&mut self, number: usize, layer: &Layer, sky: &Sky, anchors: &Anchors, len: usize) {
        let Some(middle) = (0..ANCHORS).find(|&anchor| anchors.eyes[anchor].is_some()) else {
            return;
        };
        for lobe in 0..sky.len() {
            let bright: f32 = sky.amplitude.iter().map(|column| column[lobe]).sum();
            if bright == 0.0 {
                continue;
            }
            let other = sky.sharpness[lobe];
            let (mut least, mut most) = (f32::INFINITY, 0.0_f32);
            let mut ends = [f32::INFINITY, 0.0];
            for item in 0..len {
                if layer.value[lobe][item] * bright * layer.weight[item] > NEGLIGIBLE {
                    let (own, length) = (layer.sharpness[item], layer.length[lobe][item]);
                    (least, most) = (least.min(own), most.max(own));
                    ends = [ends[0].min(length), ends[1].max(length)];
                }
            }
            if least > most {
                continue;
            }
            let (first, last) = (other / (most + other), other / (least + other));
            let towards = sky.lobe(lobe).axis;
            let turn = anchors.axis[middle].dot(towards).clamp(-1.0, 1.0).acos();
            let widths = turn * (last - first) * (0.5 * (least + most) + other).sqrt();
            let nodes = if widths < 0.25 * NODE_STEP {
                1
            } else {
                (2 + (widths / NODE_STEP) as usize).min(MOST_NODES)
            };
            self.add(number, Some(lobe), ends, (first, last), nodes);
        }
    }

    /// Adds a plan for products between two sharpnesses (none if they are in the wrong order), on an arc between two places.
    fn add(
        &mut self,
        layer: usize,
        lobe: Option<usize>,
        [broadest, sharpest]: [f32; 2],
        (first, last): (f32, f32),
        nodes: usize,
    ) {
        if broadest > sharpest {
            return;
        }
        let slots = (0..nodes).map(|node| Slot {
            lobe: lobe.unwrap_or(0),
            along: match nodes {
                1 => 0.5 * (first + last),
                _ => first + (last - first) * node as f32 / (nodes - 1) as f32,
            },
        });
        let place = |wanted: bool, list: &mut Vec<Slot>| {
            wanted.then(|| {
                list.extend(slots.clone());
                list.len() - nodes
            })
        };
        let slot = place(BroadShare::trust(sharpest) < 1.0, self.slots);
        let broad = place(BroadShare::trust(broadest) > 0.0, self.broad_slots);
        self.plans.push(Plan {
            layer,
            lobe,
            slot,
            broad,
            nodes,
            first,
            per: (nodes - 1) as f32 / (last - first).max(1e-6),
        });
    }
}

/// Directions of some slots at an anchor, by component.
#[inline(always)]
fn directions(slots: &[Slot], sky: &Sky, axis: Vec3) -> [[f32; WIDE]; 3] {
    let (mut x, mut y, mut z) = ([0.0; WIDE], [1.0; WIDE], [0.0; WIDE]);
    let mut along = [0.0; WIDE];
    for (lane, slot) in slots.iter().enumerate() {
        x[lane] = sky.axis[0][slot.lobe];
        y[lane] = sky.axis[1][slot.lobe];
        z[lane] = sky.axis[2][slot.lobe];
        along[lane] = slot.along;
    }
    let mut w = [[0.0; WIDE]; 3];
    for k in 0..WIDE {
        let (t, rest) = (along[k], 1.0 - along[k]);
        let (a, b, c) = (
            axis.x * rest + x[k] * t,
            axis.y * rest + y[k] * t,
            axis.z * rest + z[k] * t,
        );
        let scale = 1.0 / (a * a + b * b + c * c + 1e-20).sqrt();
        (w[0][k], w[1][k], w[2][k]) = (a * scale, b * scale, c * scale);
    }
    w
}

wide! {
/// Reads the fields: the distances of all slots at all anchors; and what bands of harmonics say at the broad ones.
fn read(batch: &mut Batch, points: &Points, sky: &Sky, anchors: &Anchors) {
    let Batch { slots, distances, broad_slots, bands, .. } = batch;
    distances.clear();
    distances.resize(slots.len(), [0.0; ANCHORS]);
    bands.clear();
    bands.resize(broad_slots.len(), [[0.0; ANCHORS]; 4]);
    for anchor in 0..ANCHORS {
        if anchors.eyes[anchor].is_none() {
            continue;
        }
        let axis = anchors.axis[anchor];
        for (slots, out) in slots.chunks(WIDE).zip(distances.chunks_mut(WIDE)) {
            let w = directions(slots, sky, axis);
            let mut sum = [0.0; WIDE];
            for &(id, weight) in &anchors.near[anchor] {
                let point = &points.list[id as usize];
                let found = point.field.at_eight(&point.hemisphere, &w);
                for k in 0..WIDE {
                    sum[k] += found[k] * weight;
                }
            }
            for (lane, out) in out.iter_mut().enumerate() {
                out[anchor] = sum[lane];
            }
        }
        for (slots, out) in broad_slots.chunks(WIDE).zip(bands.chunks_mut(WIDE)) {
            let found = bands_at_eight(&anchors.harmonics[anchor], &directions(slots, sky, axis));
            for (lane, out) in out.iter_mut().enumerate() {
                for (band, found) in out.iter_mut().zip(&found) {
                    band[anchor] = found[lane];
                }
            }
        }
    }
}
}

wide! {
/// Adds what a product brings.
fn shine(batch: &mut Batch, sky: &Sky, index: usize) {
    let (nearest, bands_share) = (VisibleShare::new(), BroadShare::new());
    let plan = batch.plans[index];
    let layer = &batch.layers[plan.layer];
    for chunk in 0..batch.len.div_ceil(WIDE) {
        let start = chunk * WIDE;
        let weight = lanes(&layer.weight, start);
        if weight.iter().all(|&w| w == 0.0) {
            continue;
        }
        let across = batch.across.each_ref().map(|column| lanes(column, start));
        let down = batch.down.each_ref().map(|column| lanes(column, start));
        // What each node of the arc counts.
        let mut parts = [[0.0; WIDE]; MOST_NODES];
        parts[0] = [1.0; WIDE];
        let length = match plan.lobe {
            Some(lobe) => lanes(&layer.length[lobe], start),
            None => lanes(&layer.sharpness, start),
        };
        if let (Some(lobe), 2..) = (plan.lobe, plan.nodes) {
            let (own, other) = (lanes(&layer.sharpness, start), sky.sharpness[lobe]);
            for k in 0..WIDE {
                let x = (other / (own[k] + other) - plan.first) * plan.per;
                let x = x.clamp(0.0, (plan.nodes - 1) as f32);
                for (node, part) in parts[..plan.nodes].iter_mut().enumerate() {
                    let off = (x - node as f32).abs();
                    part[k] = if off < 1.0 { 1.0 - off } else { 0.0 };
                }
            }
        }
        let mut visible = [0.0; WIDE];
        if let Some(slot) = plan.slot {
            let mut distance = [0.0; WIDE];
            for (at, part) in batch.distances[slot..slot + plan.nodes].iter().zip(&parts) {
                let found = between(&across, &down, at);
                for k in 0..WIDE {
                    distance[k] += found[k] * part[k];
                }
            }
            visible = nearest.at_eight(&distance, &length);
        }
        if let Some(slot) = plan.broad {
            let mut bands = [[0.0; WIDE]; 4];
            for (at, part) in batch.bands[slot..slot + plan.nodes].iter().zip(&parts) {
                for (band, at) in bands.iter_mut().zip(at) {
                    let found = between(&across, &down, at);
                    for k in 0..WIDE {
                        band[k] += found[k] * part[k];
                    }
                }
            }
            let broad = bands_share.at_eight(&bands, &length);
            for k in 0..WIDE {
                let trust = BroadShare::trust(length[k]);
                visible[k] += (broad[k] - visible[k]) * trust;
            }
        }
        for axis in 0..3 {
            let mut sum = lanes(&batch.radiance[axis], start);
            match plan.lobe {
                Some(lobe) => {
                    let value = lanes(&layer.value[lobe], start);
                    let albedo = lanes(&layer.amplitude[axis], start);
                    let colour = sky.amplitude[axis][lobe];
                    for k in 0..WIDE {
                        sum[k] += value[k] * visible[k] * colour * albedo[k];
                    }
                }
                None => {
                    let rest = lanes(&layer.rest[axis], start);
                    for k in 0..WIDE {
                        sum[k] += rest[k] * visible[k];
                    }
                }
            }
            batch.radiance[axis][start..start + WIDE].copy_from_slice(&sum);
        }
    }
}
}
