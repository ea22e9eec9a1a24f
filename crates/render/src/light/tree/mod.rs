//! A tree over lights: picks a light in about proportion to what it gives to a point, among a million as among four.
//!
//! Conty Estevez & Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018): every node knows a sphere
//! that holds its lights, a cone of directions into which they shine, and their intensity. Descending, a child is picked in
//! proportion to an upper bound (of cosines; not of distances) on what it could give. Nodes have eight children here and not
//! two, so that one pass of vector arithmetic decides three levels, and so that each decision compares eight bounds of equal
//! tightness.
//!
//! The probability of a light is the product of the decisions that lead to it, recomputed by climbing from the light. A child
//! with a bound of 0 gives nothing to the point, so that it is never picked; where all children of a node that looked promising
//! turn out like that, nothing is picked.
//!
//! Wrong tool where blockers decide (it knows nothing of visibility), and for lights infinitely far away.

mod build;

pub(super) use build::Bounds;

use glam::Vec3;

/// Children of a node.
const WIDTH: usize = 8;

/// In [`Node::child`]: the rest of the bits number a light, not a node.
const LEAF: u32 = 1 << 31;

/// Bounds of up to eight children, one array for each number.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct Node {
    center_x: [f32; WIDTH],
    center_y: [f32; WIDTH],
    center_z: [f32; WIDTH],
    /// Radius of the sphere that holds the lights.
    radius: [f32; WIDTH],
    /// One over its square; may be infinite.
    per_radius2: [f32; WIDTH],
    axis_x: [f32; WIDTH],
    axis_y: [f32; WIDTH],
    axis_z: [f32; WIDTH],
    /// Cosine of the spread of the lights' own axes around the axis.
    cos_spread: [f32; WIDTH],
    sin_spread: [f32; WIDTH],
    /// Cosine of the angle from its own axis up to which a light shines.
    cos_emission: [f32; WIDTH],
    /// Sum of the lights' intensities along their axes; negative if some of them shine backwards too, 0 for no child.
    intensity: [f32; WIDTH],
    /// A node, or [`LEAF`] and a light.
    child: [u32; WIDTH],
}

/// The tree.
#[derive(Debug)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// By node: which slot (node times [`WIDTH`] plus child) leads to it. Not defined for the root, node 0.
    slot_of_node: Vec<u32>,
    /// By light: which slot leads to it.
    slot_of_light: Vec<u32>,
}

/// What the children of a node could give to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Promise {
    of_child: [f32; WIDTH],
    /// Their sum: a rough irradiance.
    pub(super) sum: f32,
}

impl Tree {
    /// Bytes for each light at most: nodes are at least half full.
    pub(super) const BYTES_PER_LIGHT: usize = (size_of::<Node>() + 4) / 4 + 4;

    /// Bytes held.
    #[cfg(test)]
    pub(super) fn bytes(&self) -> usize {
        self.nodes.len() * (size_of::<Node>() + 4) + self.slot_of_light.len() * 4
    }

    /// What the root's children could give to a point. `normal` may be zero: light from all sides counts.
    pub(super) fn promise(&self, position: Vec3, normal: Vec3) -> Promise {
        self.nodes[0].promise(position, normal)
    }

    /// Picks a light, given the promise of the root: the light and its probability. `x` is in `[0, 1)`.
    pub(super) fn pick(
        &self,
        position: Vec3,
        normal: Vec3,
        root: &Promise,
        mut x: f64,
    ) -> Option<(usize, f32)> {
        let mut promise = *root;
        let mut node = 0;
        let mut pmf = 1.0;
        loop {
            let (child, rest) = promise.pick(x)?;
            x = rest;
            pmf *= promise.of_child[child] / promise.sum;
            let to = self.nodes[node].child[child];
            if to & LEAF != 0 {
                return Some(((to & !LEAF) as usize, pmf));
            }
            node = to as usize;
            promise = self.nodes[node].promise(position, normal);
        }
    }

    /// The probability of picking a light.
    pub(super) fn pmf(&self, position: Vec3, normal: Vec3, light: usize) -> f32 {
        let mut slot = self.slot_of_light[light] as usize;
        let mut pmf = 1.0;
        loop {
            let (node, child) = (slot / WIDTH, slot % WIDTH);
            let promise = self.nodes[node].promise(position, normal);
            if promise.of_child[child] == 0.0 {
                return 0.0;
            }
            pmf *= promise.of_child[child] / promise.sum;
            if node == 0 {
                return pmf;
            }
            slot = self.slot_of_node[node] as usize;
        }
    }
}

impl Promise {
    /// The child at `x` in `[0, 1)`, and how far into it `x` lies.
    fn pick(&self, x: f64) -> Option<(usize, f64)> {
        if self.sum <= 0.0 {
            return None;
        }
        let target = x * f64::from(self.sum);
        let mut after = 0.0_f64;
        let mut picked = 0;
        for (child, &promise) in self.of_child.iter().enumerate() {
            if promise > 0.0 {
                picked = child;
                after += f64::from(promise);
                if target < after {
                    break;
                }
            }
        }
        let left = (after - target) / f64::from(self.of_child[picked]);
        Some((picked, (1.0 - left).clamp(0.0, 1.0 - f64::EPSILON)))
    }
}

/// `cos(max(0, a - b))` for angles in `[0, pi]`, by their sines and cosines.
#[inline(always)]
fn cos_of_excess(sin_a: f32, cos_a: f32, sin_b: f32, cos_b: f32) -> f32 {
    if cos_a > cos_b {
        1.0
    } else {
        cos_a * cos_b + sin_a * sin_b
    }
}

/// The sine of an angle in `[0, pi]` by its cosine.
#[inline(always)]
fn sin_of(cos: f32) -> f32 {
    larger(1.0 - cos * cos, 0.0).sqrt()
}

/// As one instruction: unlike `f32::max` this does not look for NaN.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

impl Node {
    /// What each child could give.
    #[inline]
    fn promise(&self, position: Vec3, normal: Vec3) -> Promise {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { self.promise_avx2(position, normal) };
        }
        self.promise_portable(position, normal)
    }

    /// The same operations in vectors of eight: the same results.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn promise_avx2(&self, position: Vec3, normal: Vec3) -> Promise {
        self.promise_portable(position, normal)
    }

    /// Section 4 of the paper, for all children; the loop has no branches and becomes vector code.
    #[inline(always)]
    fn promise_portable(&self, position: Vec3, normal: Vec3) -> Promise {
        // So that eight of them can be added up.
        const MOST: f32 = f32::MAX / 16.0;
        let every_side = if normal == Vec3::ZERO { 1.0 } else { 0.0 };
        let mut of_child = [0.0; WIDTH];
        for (i, promise) in of_child.iter_mut().enumerate() {
            let x = self.center_x[i] - position.x;
            let y = self.center_y[i] - position.y;
            let z = self.center_z[i] - position.z;
            let distance2 = x * x + y * y + z * z;
            let per_distance = 1.0 / distance2.sqrt();
            // Half of the angle under which the sphere is seen.
            let sin_half = self.radius[i] * per_distance;
            let outside = sin_half < 1.0;
            let cos_half = sin_of(sin_half);
            // The angle at the light, less the spread of axes, less the half angle: the least that any of the lights may have.
            let facing =
                -(self.axis_x[i] * x + self.axis_y[i] * y + self.axis_z[i] * z) * per_distance;
            let backwards = if self.intensity[i] < 0.0 {
                facing.abs()
            } else {
                facing
            };
            let cos_axis = smaller(larger(backwards, -1.0), 1.0);
            let sin_axis = sin_of(cos_axis);
            let (cos_spread, sin_spread) = (self.cos_spread[i], self.sin_spread[i]);
            let within = cos_axis > cos_spread;
            let cos_beyond = if within {
                1.0
            } else {
                cos_axis * cos_spread + sin_axis * sin_spread
            };
            let sin_beyond = if within {
                0.0
            } else {
                sin_axis * cos_spread - cos_axis * sin_spread
            };
            let cos_least = cos_of_excess(sin_beyond, cos_beyond, sin_half, cos_half);
            let shines = if cos_least > self.cos_emission[i] {
                cos_least
            } else {
                0.0
            };
            let emitted = if outside { shines } else { 1.0 };
            // The same at the receiver.
            let cos_receiver = smaller(
                larger(
                    (normal.x * x + normal.y * y + normal.z * z) * per_distance,
                    -1.0,
                ),
                1.0,
            );
            let cos_least = cos_of_excess(sin_of(cos_receiver), cos_receiver, sin_half, cos_half);
            let received = if outside {
                larger(cos_least, every_side)
            } else {
                1.0
            };
            let received = larger(received, 0.0);
            // A light at the very point gives nothing that could be computed with.
            let nearest = smaller(per_distance * per_distance, self.per_radius2[i]);
            let nearness = if nearest < f32::INFINITY {
                nearest
            } else {
                0.0
            };
            *promise = smaller(
                self.intensity[i].abs() * emitted * received * nearness,
                MOST,
            );
        }
        let sum = of_child.iter().sum();
        Promise { of_child, sum }
    }
}

#[cfg(test)]
mod tests;
