//! Building the tree: top-down, binned, with the paper's cost of intensity, extent and orientation.

use super::{LEAF, Node, Tree, WIDTH};
use crate::light::emitter::EmissiveTriangle;
use crate::light::luminance;
use crate::light::patches::Patch;
use crate::light::punctual::PointLight;
use bytemuck::Zeroable;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// Where one light is, where it shines, and how much.
#[derive(Clone, Copy, Debug)]
pub(in crate::light) struct Bounds {
    center: Vec3,
    radius: f32,
    axis: Vec3,
    /// Directions up to this angle from the axis are axes too, radians.
    spread: f32,
    /// Up to this angle from an axis there is light, radians.
    emission: f32,
    /// Along the axis; finite and positive.
    intensity: f32,
    backwards: bool,
}

/// Rounding of angles, radians. Bounds that are too wide by this much cost nothing.
const SLACK: f32 = 1e-4;

impl Bounds {
    pub(in crate::light) fn of_point(light: &PointLight) -> Self {
        let (axis, spread, emission) = match &light.cone {
            None => (Vec3::Z, PI, FRAC_PI_2),
            // Full intensity up to the inner angle, then falling. A wide ramp counts as full: the cosine would be negative.
            Some(cone) if cone.outer_angle - cone.inner_angle < 1.4 => (
                cone.axis,
                cone.inner_angle,
                cone.outer_angle - cone.inner_angle + SLACK,
            ),
            Some(cone) => (cone.axis, cone.outer_angle, SLACK),
        };
        Self {
            center: light.position,
            radius: 0.0,
            axis,
            spread,
            emission,
            intensity: luminance(light.intensity).clamp(f32::MIN_POSITIVE, f32::MAX),
            backwards: false,
        }
    }

    pub(in crate::light) fn of_triangle(light: &EmissiveTriangle) -> Self {
        let facet = &light.facet;
        let [a, b, c] = [
            facet.origin,
            facet.origin + facet.edge1,
            facet.origin + facet.edge2,
        ];
        let center = (a.min(b).min(c) + a.max(b).max(c)) * 0.5;
        let radius = center
            .distance(a)
            .max(center.distance(b))
            .max(center.distance(c));
        Self {
            center,
            radius,
            axis: facet.front,
            spread: SLACK,
            emission: FRAC_PI_2,
            intensity: (luminance(light.mean_radiance) * facet.area)
                .clamp(f32::MIN_POSITIVE, f32::MAX),
            backwards: light.double_sided,
        }
    }

    pub(in crate::light) fn of_patch(patch: &Patch) -> Self {
        Self {
            center: patch.center,
            radius: patch.radius,
            axis: patch.normal,
            spread: patch.spread + SLACK,
            emission: FRAC_PI_2,
            intensity: patch.intensity.clamp(f32::MIN_POSITIVE, f32::MAX),
            backwards: false,
        }
    }

    /// Bounds of several lights together.
    fn of_all(children: &[Self]) -> Self {
        let mut low = Vec3::INFINITY;
        let mut high = Vec3::NEG_INFINITY;
        let mut axes = Vec3::ZERO;
        let mut intensity = 0.0_f32;
        let strongest = children.iter().map(|c| c.intensity).fold(0.0, f32::max);
        for child in children {
            low = low.min(child.center - child.radius);
            high = high.max(child.center + child.radius);
            axes += child.axis * (child.intensity / strongest);
            intensity += child.intensity;
        }
        let center = low * 0.5 + high * 0.5;
        let axis = axes.normalize_or(Vec3::Z);
        let mut whole = Self {
            center,
            radius: 0.0,
            axis,
            spread: 0.0,
            emission: 0.0,
            intensity: intensity.min(f32::MAX),
            backwards: false,
        };
        for child in children {
            whole.radius = whole
                .radius
                .max(center.distance(child.center) + child.radius);
            // By the chord, which is precise for small angles.
            let angle = 2.0 * (0.5 * axis.distance(child.axis)).min(1.0).asin();
            whole.spread = whole.spread.max(angle + child.spread + SLACK).min(PI);
            whole.emission = whole.emission.max(child.emission);
            whole.backwards |= child.backwards;
        }
        whole.radius *= 1.0 + 1e-6;
        whole
    }
}

impl Node {
    fn set(&mut self, slot: usize, bounds: &Bounds, child: u32) {
        self.center_x[slot] = bounds.center.x;
        self.center_y[slot] = bounds.center.y;
        self.center_z[slot] = bounds.center.z;
        self.radius[slot] = bounds.radius;
        self.per_radius2[slot] = 1.0 / (bounds.radius * bounds.radius);
        self.axis_x[slot] = bounds.axis.x;
        self.axis_y[slot] = bounds.axis.y;
        self.axis_z[slot] = bounds.axis.z;
        (self.sin_spread[slot], self.cos_spread[slot]) = bounds.spread.sin_cos();
        // Beyond a quarter turn there is no light from a surface: exactly 0, not the rounded cosine.
        self.cos_emission[slot] = if bounds.emission == FRAC_PI_2 {
            0.0
        } else {
            bounds.emission.cos()
        };
        self.intensity[slot] = if bounds.backwards {
            -bounds.intensity
        } else {
            bounds.intensity
        };
        self.child[slot] = child;
    }

    /// The slots in use and what they lead to.
    fn children(&self) -> impl Iterator<Item = (usize, u32)> {
        (0..WIDTH)
            .filter(|&slot| self.intensity[slot] != 0.0)
            .map(|slot| (slot, self.child[slot]))
    }

    /// The same node with nodes (not lights) numbered from `base` on.
    fn renumbered(mut self, base: u32) -> Self {
        for child in self.child.iter_mut().filter(|child| **child & LEAF == 0) {
            *child += base;
        }
        self
    }
}

/// What building needs to know of a light, packed for the passes over all of them.
#[derive(Clone, Copy)]
struct Item {
    center: Vec3,
    light: u32,
    /// Axis times intensity; zero for lights that shine everywhere.
    aim: Vec3,
    intensity: f32,
}

/// Sums over some items.
#[derive(Clone, Copy)]
struct Sums {
    low: Vec3,
    high: Vec3,
    aim: Vec3,
    intensity: f32,
    count: usize,
}

impl Sums {
    const NONE: Self = Self {
        low: Vec3::INFINITY,
        high: Vec3::NEG_INFINITY,
        aim: Vec3::ZERO,
        intensity: 0.0,
        count: 0,
    };

    fn add(&mut self, item: &Item) {
        self.low = self.low.min(item.center);
        self.high = self.high.max(item.center);
        self.aim += item.aim;
        self.intensity += item.intensity;
        self.count += 1;
    }

    fn join(&self, other: &Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            aim: self.aim + other.aim,
            intensity: self.intensity + other.intensity,
            count: self.count + other.count,
        }
    }

    /// The paper's eq. 1, with the squared diagonal in place of the surface (lights in a row, or in a plane, have none) and
    /// the spread of directions by the length of their mean (1 aligned, 0 all around) in place of a bounding cone: from the
    /// solid angle pi of one surface to 4 pi.
    fn cost(&self) -> f32 {
        if self.count == 0 || self.intensity <= 0.0 {
            return 0.0;
        }
        let aligned = (self.aim / self.intensity).length().min(1.0);
        self.intensity * (self.high - self.low).length_squared() * (4.0 - 3.0 * aligned)
    }
}

impl Tree {
    /// Builds a tree over at least one light and fewer than 2^31.
    pub(in crate::light) fn new(lights: &[Bounds]) -> Self {
        // Intensities relative to their sum: nothing overflows on the way.
        let total: f64 = lights.iter().map(|l| f64::from(l.intensity)).sum();
        let mut items: Vec<Item> = lights
            .iter()
            .enumerate()
            .map(|(light, bounds)| {
                let intensity = (f64::from(bounds.intensity) / total) as f32;
                let aimed = !bounds.backwards && bounds.spread < FRAC_PI_2;
                Item {
                    center: bounds.center,
                    light: light as u32,
                    aim: if aimed {
                        bounds.axis * intensity
                    } else {
                        Vec3::ZERO
                    },
                    intensity,
                }
            })
            .collect();
        let mut nodes = Vec::new();
        build(&mut items, lights, &mut nodes);
        let mut slot_of_node = vec![0; nodes.len()];
        let mut slot_of_light = vec![0; lights.len()];
        for (index, node) in nodes.iter().enumerate() {
            for (slot, child) in node.children() {
                let place = (index * WIDTH + slot) as u32;
                if child & LEAF == 0 {
                    slot_of_node[child as usize] = place;
                } else {
                    slot_of_light[(child & !LEAF) as usize] = place;
                }
            }
        }
        Self {
            nodes,
            slot_of_node,
            slot_of_light,
        }
    }
}

/// Appends a subtree over some items, its root first, and returns its bounds. The result does not depend on the number of
/// threads.
fn build(items: &mut [Item], lights: &[Bounds], nodes: &mut Vec<Node>) -> Bounds {
    /// Below this many lights another thread is not worth its while.
    const SHARE: usize = 4096;
    let root = nodes.len();
    nodes.push(Node::zeroed());
    let count = items.len();
    let mut children = Vec::with_capacity(WIDTH);
    let mut add = |nodes: &mut Vec<Node>, bounds: Bounds, child: u32| {
        nodes[root].set(children.len(), &bounds, child);
        children.push(bounds);
    };
    let parts = if count <= WIDTH {
        items.chunks_mut(1).collect()
    } else {
        split_into_parts(items)
    };
    if count <= SHARE {
        for part in parts {
            if let [item] = part {
                add(nodes, lights[item.light as usize], LEAF | item.light);
            } else {
                let child = nodes.len() as u32;
                let bounds = build(part, lights, nodes);
                add(nodes, bounds, child);
            }
        }
    } else {
        let subtrees: Vec<(Vec<Node>, Bounds, Option<u32>)> = parts
            .into_par_iter()
            .map(|part| {
                if let [item] = part {
                    return (Vec::new(), lights[item.light as usize], Some(item.light));
                }
                let mut nodes = Vec::new();
                let bounds = build(part, lights, &mut nodes);
                (nodes, bounds, None)
            })
            .collect();
        for (subtree, bounds, light) in subtrees {
            let base = nodes.len() as u32;
            add(nodes, bounds, light.map_or(base, |light| LEAF | light));
            nodes.extend(subtree.into_iter().map(|node| node.renumbered(base)));
        }
    }
    Bounds::of_all(&children)
}

/// Splits more than [`WIDTH`] items into at most [`WIDTH`] parts, none of them empty.
fn split_into_parts(items: &mut [Item]) -> Vec<&mut [Item]> {
    /// Up to this many, parts are only made as small as one node can hold, so that nodes are well filled.
    const FEW: usize = WIDTH * WIDTH;
    let few = items.len() <= FEW;
    let cost = |part: &[Item]| {
        if few {
            part.len() as f32
        } else {
            sums(part).cost()
        }
    };
    let mut parts: Vec<(f32, &mut [Item])> = vec![(f32::INFINITY, items)];
    while parts.len() < WIDTH {
        let splittable = |part: &[Item]| part.len() > if few { WIDTH } else { 1 };
        let candidates = parts
            .iter()
            .enumerate()
            .filter(|(_, (_, part))| splittable(part));
        let Some(worst) = candidates
            .max_by(|(_, a), (_, b)| a.0.total_cmp(&b.0))
            .map(|(i, _)| i)
        else {
            break;
        };
        let (_, part) = parts.swap_remove(worst);
        let middle = partition(part);
        let (left, right) = part.split_at_mut(middle);
        parts.push((cost(left), left));
        parts.push((cost(right), right));
    }
    parts.into_iter().map(|(_, part)| part).collect()
}

fn sums(items: &[Item]) -> Sums {
    let mut sums = Sums::NONE;
    items.iter().for_each(|item| sums.add(item));
    sums
}

/// Reorders at least two items into two parts that are not empty, and returns where the second starts: the cheapest of the
/// planes between bins along the three axes.
fn partition(items: &mut [Item]) -> usize {
    const BINS: usize = 16;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for item in items.iter() {
        low = low.min(item.center);
        high = high.max(item.center);
    }
    let extent = high - low;
    let per_length = Vec3::splat(BINS as f32) / extent;
    // No extent gives no number, and that counts as bin 0.
    let bin_of = |item: &Item, axis: usize| {
        (((item.center[axis] - low[axis]) * per_length[axis]) as usize).min(BINS - 1)
    };
    let mut bins = [[Sums::NONE; BINS]; 3];
    for item in items.iter() {
        for (axis, bins) in bins.iter_mut().enumerate() {
            bins[bin_of(item, axis)].add(item);
        }
    }
    let mut best: Option<(f32, usize, usize)> = None;
    for (axis, bins) in bins.iter().enumerate() {
        // Thin boxes are not made thinner: the paper's K_r.
        let thinness = extent.max_element() / extent[axis];
        let mut right_costs = [0.0; BINS];
        let mut right = Sums::NONE;
        for bin in (1..BINS).rev() {
            right = right.join(&bins[bin]);
            right_costs[bin] = right.cost();
        }
        let mut left = Sums::NONE;
        for bin in 1..BINS {
            left = left.join(&bins[bin - 1]);
            let cost = thinness * (left.cost() + right_costs[bin]);
            let separates = left.count > 0 && left.count < items.len();
            if separates && cost.is_finite() && best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, bin));
            }
        }
    }
    let Some((_, axis, bin)) = best else {
        return items.len() / 2;
    };
    let mut middle = 0;
    for i in 0..items.len() {
        if bin_of(&items[i], axis) < bin {
            items.swap(i, middle);
            middle += 1;
        }
    }
    middle
}
