//! From triangles and placed instances to a [`Tree`].
//!
//! Three passes: references with boxes ([`Ref`]), a binary tree over them by binned SAH ([`sah`]) that cuts triangles where
//! that pays ([`spatial`]), and the collapse of that into 8-wide nodes ([`collapse`]). Each is a pure function of its input: threads only share the work.

pub(crate) mod collapse;
mod kernels;
mod sah;
mod spatial;

use crate::buffer::Buffer;
use crate::input::BuildOptions;
use crate::node::{Block, Bounds, MAX_TRIANGLES, Tree};
use glam::Vec3;

/// Bit of [`Ref::instance`]: the reference is a placed instance, not a triangle.
const PLACED: u32 = 1 << 31;

/// A box as lower and negated upper bounds, so that one lane-wise minimum is a union.
///
/// Lanes 3 and 7 are free for numbers; a union leaves garbage there.
pub(crate) type Hull = [f32; 8];

pub(crate) const EMPTY_HULL: Hull = [f32::INFINITY; 8];

/// Something to be put into the tree, and its box. 32 bytes, since the builder streams over arrays of these.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
pub(crate) struct Ref {
    hull: Hull,
}

impl Ref {
    pub fn triangle(bounds: &Bounds, primitive: u32, instance: u32) -> Self {
        Self::new(bounds, primitive, instance)
    }

    pub fn placed(bounds: &Bounds, placed: u32) -> Self {
        Self::new(bounds, placed, PLACED)
    }

    fn new(bounds: &Bounds, a: u32, b: u32) -> Self {
        let (l, u) = (bounds.lower, bounds.upper);
        Self {
            hull: [
                l.x,
                l.y,
                l.z,
                f32::from_bits(a),
                -u.x,
                -u.y,
                -u.z,
                f32::from_bits(b),
            ],
        }
    }

    /// Triangle inside its mesh, or number of the placed instance.
    pub fn primitive(&self) -> u32 {
        self.hull[3].to_bits()
    }

    /// Instance that the triangle belongs to.
    pub fn instance(&self) -> u32 {
        self.hull[7].to_bits()
    }

    pub fn is_placed(&self) -> bool {
        self.instance() == PLACED
    }
}

#[inline(always)]
pub(crate) fn union(a: &Hull, b: &Hull) -> Hull {
    std::array::from_fn(|k| if a[k] < b[k] { a[k] } else { b[k] })
}

/// Half the surface area; negative nonsense if empty.
#[inline(always)]
pub(crate) fn half_area(h: &Hull) -> f32 {
    let (x, y, z) = (-(h[0] + h[4]), -(h[1] + h[5]), -(h[2] + h[6]));
    x * y + y * z + z * x
}

fn bounds_of(h: &Hull) -> Bounds {
    Bounds {
        lower: Vec3::new(h[0], h[1], h[2]),
        upper: -Vec3::new(h[4], h[5], h[6]),
    }
}

/// Where the vertices of a reference are found again when its block is written.
pub(crate) trait Triangles: Sync {
    /// The vertices in the space of the tree, and the id to report.
    fn triangle(&self, reference: &Ref) -> ([Vec3; 3], u32);
}

/// Extra references for cut triangles, at most, by the number of triangles. Few scenes use half of it.
const ROOM: f32 = 0.2;

/// Builds a tree. Costs are in units of one node visit.
pub(crate) fn build(refs: Vec<Ref>, triangles: &impl Triangles, options: &BuildOptions) -> Tree {
    let mut tree = Tree {
        nodes: Buffer::zeroed(0),
        blocks: Buffer::zeroed(0),
        bounds: Bounds::EMPTY,
        triangles: refs.iter().filter(|r| !r.is_placed()).count(),
        depth: 0,
        built_cost: 0.0,
    };
    if refs.is_empty() {
        return tree;
    }
    let count = refs.len();
    let mut room = count;
    if !options.whole_triangles {
        room +=
            ((count as f32 * ROOM) as usize).min((MAX_TRIANGLES as usize).saturating_sub(count));
    }
    let mut all = Buffer::zeroed(room);
    all[..count].copy_from_slice(&refs);
    drop(refs);
    let binary = sah::build(all, count, triangles);
    collapse::collapse(&binary, triangles, options.watertight, &mut tree);
    tree
}

/// Puts the vertices of a run of references into blocks.
fn write_blocks(
    refs: &[Ref],
    triangles: &impl Triangles,
    watertight: bool,
    blocks: &mut Vec<Block>,
) {
    for chunk in refs.chunks(crate::node::LANES) {
        let mut block = Block::EMPTY;
        for (lane, reference) in chunk.iter().enumerate() {
            let (vertices, id) = triangles.triangle(reference);
            block.set(lane, &vertices, watertight, id);
        }
        blocks.push(block);
    }
}
