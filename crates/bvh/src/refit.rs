//! New positions for the same triangles: boxes and blocks are recomputed, the shape of the trees stays.

use crate::accel::{Accel, in_range, inverse, placed_bounds, vertices, world_vertices};
use crate::input::{InstanceInput, MeshInput, RefitError};
use crate::node::{Block, Bounds, Child, FILTERED, LANES, NO_TRIANGLE, Tree, WIDTH};
use glam::{Affine3A, Vec3};
use rayon::prelude::*;

impl Accel {
    /// Takes over new vertex positions and transforms. The numbers of meshes, triangles and instances, which mesh an
    /// instance shows, and what is filtered must be those of the build.
    ///
    /// Much faster than building, but rays slow down as the triangles move away from where they were: compare
    /// [`Stats::cost`](crate::Stats::cost) with [`Stats::built_cost`](crate::Stats::built_cost). Triangles that the build cut
    /// are whole afterwards in each of their leaves: right, but slower than if they had never been cut (see
    /// [`whole_triangles`](crate::BuildOptions::whole_triangles)). Triangles that the build
    /// dropped stay dropped (see [`keep_degenerate`](crate::BuildOptions::keep_degenerate)); a triangle that is not finite
    /// now is not hit until the next refit.
    ///
    /// # Errors
    /// If something other than positions and transforms differs; nothing has changed then.
    pub fn refit(
        &mut self,
        meshes: &[MeshInput],
        instances: &[InstanceInput],
    ) -> Result<(), RefitError> {
        self.check_topology(meshes, instances)?;
        let mut inverses = Vec::with_capacity(self.placed.len());
        for placed in &self.placed {
            let instance = placed.instance as usize;
            let object_from_world = inverse(&instances[instance].world_from_object);
            inverses.push(object_from_world.ok_or(RefitError::Singular { instance })?);
        }
        for (placed, object_from_world) in self.placed.iter_mut().zip(inverses) {
            placed.object_from_world = object_from_world;
        }
        let watertight = self.options.watertight;
        self.trees
            .par_iter_mut()
            .zip(meshes)
            .for_each(|(tree, mesh)| {
                refit(tree, watertight, |id| vertices(mesh, id), |_| Bounds::EMPTY);
            });
        let (ids, trees, placed) = (&self.ids, &self.trees, &self.placed);
        refit(
            &mut self.top,
            watertight,
            |id| {
                let (instance, primitive) = ids.name(id);
                let i = &instances[instance as usize];
                world_vertices(&meshes[i.mesh as usize], primitive, &i.world_from_object)
            },
            |index| {
                let p = &placed[index];
                let world_from_object: &Affine3A =
                    &instances[p.instance as usize].world_from_object;
                placed_bounds(&trees[p.mesh as usize], world_from_object)
            },
        );
        Ok(())
    }

    fn check_topology(
        &self,
        meshes: &[MeshInput],
        instances: &[InstanceInput],
    ) -> Result<(), RefitError> {
        let topology = |what| Err(RefitError::Topology { what });
        if meshes.len() != self.meshes.len() {
            return topology("number of meshes");
        }
        if instances.len() != self.instances.len() {
            return topology("number of instances");
        }
        for (input, &(triangles, filtered)) in meshes.iter().zip(&self.meshes) {
            if input.triangles.len() != triangles as usize {
                return topology("number of triangles");
            }
            if input.filtered != filtered {
                return topology("which meshes are filtered");
            }
            let vertices = input.positions.len();
            if input
                .triangles
                .par_iter()
                .flatten()
                .any(|&v| v as usize >= vertices)
            {
                return topology("number of vertices");
            }
        }
        if instances
            .iter()
            .zip(&self.instances)
            .any(|(i, &mesh)| i.mesh != mesh)
        {
            return topology("the mesh of an instance");
        }
        Ok(())
    }
}

/// Blocks first, then boxes from the leaves up. `corners` takes a triangle's id, `placed` a placed instance.
fn refit(
    tree: &mut Tree,
    watertight: bool,
    corners: impl Fn(u32) -> [Vec3; 3] + Sync,
    placed: impl Fn(usize) -> Bounds,
) {
    if tree.nodes.is_empty() {
        return;
    }
    let block_bounds: Vec<Bounds> = tree
        .blocks
        .par_iter_mut()
        .map(|block| {
            let mut bounds = Bounds::EMPTY;
            let old = std::mem::replace(block, Block::EMPTY);
            for lane in 0..LANES {
                let id = old.ids[lane];
                if id == NO_TRIANGLE {
                    continue;
                }
                let v = corners(id & !FILTERED);
                if v.iter().all(|&p| in_range(p)) {
                    v.iter().for_each(|&p| bounds.grow(p));
                    block.set(lane, &v, watertight, id);
                } else {
                    block.ids[lane] = id;
                }
            }
            bounds
        })
        .collect();
    // A node's children come after it, so that backwards is from the leaves up.
    let mut node_bounds = vec![Bounds::EMPTY; tree.nodes.len()];
    for index in (0..tree.nodes.len()).rev() {
        let mut all = Bounds::EMPTY;
        for lane in 0..WIDTH {
            let child = tree.nodes[index].children[lane];
            let mut bounds = Bounds::EMPTY;
            if child == Child::NONE {
                continue;
            } else if !child.is_leaf() {
                bounds = node_bounds[child.index()];
            } else if child.is_instance() {
                bounds = placed(child.index());
            } else {
                let blocks = child.index()..child.index() + child.block_count();
                block_bounds[blocks].iter().for_each(|b| bounds.merge(b));
            }
            tree.nodes[index].set(lane, &bounds, child);
            all.merge(&bounds);
        }
        node_bounds[index] = all;
    }
    tree.bounds = node_bounds[0];
}
