//! The structure and the questions that it answers.

use crate::build::{self, Ref, Triangles};
use crate::filter::HitFilter;
use crate::input::{BuildError, BuildOptions, Flatten, InstanceInput, MeshInput};
use crate::node::{Bounds, FILTERED, MAX_TRIANGLES, NO_TRIANGLE, Tree};
#[cfg(target_arch = "x86_64")]
use crate::traverse::Avx2;
#[cfg(target_arch = "aarch64")]
use crate::traverse::Neon;
use crate::traverse::{BY_ID, Found, Isa, Portable, Query, Scope, Simd};
use glam::{Affine3A, Vec3};
use occlude_visibility::{Hit, Ray};
use rayon::prelude::*;

/// Coordinates beyond this overflow the triangle test: cubes of them must stay below the largest float.
const MAX_COORDINATE: f32 = (1u64 << 40) as f32;

/// Instances with at most so many triangles are always copied into the world-space tree.
const SMALL_MESH: usize = 64;
/// [`Flatten::Auto`] copies everything up to this many triangles.
const FEW_TRIANGLES: u64 = 1_000_000;

/// An instance with a tree of its own.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub object_from_world: Affine3A,
    pub instance: u32,
    pub mesh: u32,
}

/// Which instance and triangle an id of the world-space tree stands for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ids {
    /// First id of each instance, and the number of ids.
    starts: Vec<u32>,
    /// For every 2^[`Self::SHIFT`]-th id the instance that it belongs to, to start the search from.
    hints: Vec<u32>,
}

impl Ids {
    const SHIFT: u32 = 8;

    fn new(counts: impl Iterator<Item = usize>) -> Self {
        let mut starts = vec![0];
        let mut end = 0;
        for count in counts {
            end += count as u32;
            starts.push(end);
        }
        let mut instance = 0;
        let hints = (0..=end >> Self::SHIFT)
            .map(|k| {
                while instance + 2 < starts.len() && starts[instance + 1] <= k << Self::SHIFT {
                    instance += 1;
                }
                instance as u32
            })
            .collect();
        Self { starts, hints }
    }

    pub fn first(&self, instance: usize) -> u32 {
        self.starts[instance]
    }

    pub fn name(&self, id: u32) -> (u32, u32) {
        let slot = (id >> Self::SHIFT) as usize;
        let from = self.hints[slot] as usize;
        let to = self
            .hints
            .get(slot + 1)
            .map_or(self.starts.len() - 1, |&h| h as usize + 1);
        let instance = from + self.starts[from + 1..to].partition_point(|&start| start <= id);
        (instance as u32, id - self.starts[instance])
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.starts[..]) + size_of_val(&self.hints[..])
    }
}

/// Names some triangles of one block that blocked a ray, so that they can be tried first against the next ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blocker {
    placed: u32,
    block: u32,
}

/// What a structure holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stats {
    /// Triangles in the trees; those of a mesh with a tree of its own count once.
    pub triangles: u64,
    /// Triangles in the leaves of all trees: a cut triangle is in several.
    pub references: u64,
    /// Triangles as seen in the world: those of every instance.
    pub world_triangles: u64,
    /// Instances that were copied into the world-space tree.
    pub flattened: u64,
    /// Instances whose mesh has a tree of its own.
    pub placed: u64,
    /// Triangles dropped because a vertex is not finite, or too large to compute with.
    pub dropped_invalid: u64,
    /// Triangles dropped because they have no area.
    pub dropped_degenerate: u64,
    /// Nodes of all trees.
    pub nodes: u64,
    /// Blocks of four triangles of all trees.
    pub blocks: u64,
    /// Memory held, in bytes.
    pub bytes: u64,
    /// Nodes on the longest way down through one tree.
    pub depth: u32,
    /// SAH cost of the world-space tree: expected node visits and weighted block tests of a ray that meets its box.
    pub cost: f32,
    /// The same at the time of the build. After a refit, build anew when `cost` has grown well beyond it.
    pub built_cost: f32,
}

/// A bounding volume hierarchy over triangles and instances. See the crate's documentation.
#[derive(Clone, Debug)]
pub struct Accel {
    simd: Simd,
    pub(crate) options: BuildOptions,
    pub(crate) top: Tree,
    /// By mesh; empty for meshes without a tree of their own.
    pub(crate) trees: Vec<Tree>,
    pub(crate) placed: Vec<Placed>,
    pub(crate) ids: Ids,
    /// By instance: is it in the world-space tree?
    pub(crate) flattened: Vec<bool>,
    /// By mesh: how many triangles, and are they filtered?
    pub(crate) meshes: Vec<(u32, bool)>,
    /// By instance: which mesh.
    pub(crate) instances: Vec<u32>,
    pub(crate) dropped_invalid: u64,
    pub(crate) dropped_degenerate: u64,
}

/// The vertices of a triangle.
pub(crate) fn vertices(mesh: &MeshInput, primitive: u32) -> [Vec3; 3] {
    mesh.triangles[primitive as usize].map(|v| mesh.positions[v as usize])
}

/// The vertices of a triangle in the world.
pub(crate) fn world_vertices(
    mesh: &MeshInput,
    primitive: u32,
    world_from_object: &Affine3A,
) -> [Vec3; 3] {
    let v = vertices(mesh, primitive);
    if *world_from_object == Affine3A::IDENTITY {
        v
    } else {
        v.map(|p| world_from_object.transform_point3(p))
    }
}

/// Is this a place to compute with? A NaN is not.
pub(crate) fn in_range(p: Vec3) -> bool {
    p.abs().cmple(Vec3::splat(MAX_COORDINATE)).all()
}

/// What is wrong with a triangle.
enum Flaw {
    Invalid,
    Degenerate,
}

fn check(v: &[Vec3; 3], keep_degenerate: bool) -> Result<Bounds, Flaw> {
    let mut bounds = Bounds::EMPTY;
    for &p in v {
        if !in_range(p) {
            return Err(Flaw::Invalid);
        }
        bounds.grow(p);
    }
    if !keep_degenerate {
        let [a, b, c] = v.map(|p| p.as_dvec3());
        // Products of edges are exact in double precision unless the coordinates differ by more than 2^26: then a sliver
        // that is called flat is thinner than the rounding of its vertices.
        if (b - a).cross(c - a) == glam::DVec3::ZERO {
            return Err(Flaw::Degenerate);
        }
    }
    Ok(bounds)
}

/// References of one mesh or instance, in the order of its triangles, and how many were dropped.
#[derive(Default)]
struct Refs {
    refs: Vec<Ref>,
    invalid: u64,
    degenerate: u64,
}

impl Refs {
    fn gather(
        count: usize,
        instance: u32,
        keep_degenerate: bool,
        corners: impl Fn(u32) -> [Vec3; 3] + Sync,
    ) -> Self {
        const CHUNK: usize = 1 << 14;
        let chunk = |from: usize| {
            let mut out = Self::default();
            let to = count.min(from + CHUNK);
            out.refs.reserve_exact(to - from);
            for primitive in from as u32..to as u32 {
                match check(&corners(primitive), keep_degenerate) {
                    Ok(bounds) => out.refs.push(Ref::triangle(&bounds, primitive, instance)),
                    Err(Flaw::Invalid) => out.invalid += 1,
                    Err(Flaw::Degenerate) => out.degenerate += 1,
                }
            }
            out
        };
        if count <= CHUNK {
            return chunk(0);
        }
        let parts: Vec<Self> = (0..count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|k| chunk(k * CHUNK))
            .collect();
        Self::join(parts)
    }

    fn join(mut parts: Vec<Self>) -> Self {
        if parts.len() == 1 {
            return parts.pop().unwrap_or_default();
        }
        let mut all = Self::default();
        all.refs
            .reserve_exact(parts.iter().map(|p| p.refs.len()).sum::<usize>());
        for part in parts {
            all.refs.extend_from_slice(&part.refs);
            all.invalid += part.invalid;
            all.degenerate += part.degenerate;
        }
        all
    }
}

struct OwnTriangles<'a>(&'a MeshInput<'a>);

impl Triangles for OwnTriangles<'_> {
    fn triangle(&self, reference: &Ref) -> ([Vec3; 3], u32) {
        let primitive = reference.primitive();
        let flag = if self.0.filtered { FILTERED } else { 0 };
        (vertices(self.0, primitive), primitive | flag)
    }
}

struct WorldTriangles<'a> {
    meshes: &'a [MeshInput<'a>],
    instances: &'a [InstanceInput],
    ids: &'a Ids,
}

impl Triangles for WorldTriangles<'_> {
    fn triangle(&self, reference: &Ref) -> ([Vec3; 3], u32) {
        let (instance, primitive) = (reference.instance() as usize, reference.primitive());
        let placed = &self.instances[instance];
        let mesh = &self.meshes[placed.mesh as usize];
        let flag = if mesh.filtered { FILTERED } else { 0 };
        let id = self.ids.first(instance) + primitive;
        (
            world_vertices(mesh, primitive, &placed.world_from_object),
            id | flag,
        )
    }
}

/// The inverse, if it is good for anything.
pub(crate) fn inverse(world_from_object: &Affine3A) -> Option<Affine3A> {
    let inverse = world_from_object.inverse();
    (inverse.is_finite()
        && world_from_object.is_finite()
        && world_from_object.matrix3.determinant() != 0.0)
        .then_some(inverse)
}

/// World-space bounds of a placed tree, from the boxes of its root's children (tighter than the root's own).
pub(crate) fn placed_bounds(tree: &Tree, world_from_object: &Affine3A) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    let Some(root) = tree.nodes.first() else {
        return bounds;
    };
    let boxes = (0..crate::node::WIDTH).map(|lane| root.bounds(lane));
    for b in boxes.filter(|b| !b.is_empty()) {
        for corner in 0..8 {
            let pick = |axis: usize| {
                if corner >> axis & 1 == 0 {
                    b.lower[axis]
                } else {
                    b.upper[axis]
                }
            };
            bounds.grow(world_from_object.transform_point3(Vec3::new(pick(0), pick(1), pick(2))));
        }
    }
    // The ray is transformed into the tree's space with rounding, relative to what is added up there.
    let reach = tree.bounds.lower.abs().max(tree.bounds.upper.abs());
    let m = &world_from_object.matrix3;
    let sums = Vec3::from(m.x_axis.abs()) * reach.x
        + Vec3::from(m.y_axis.abs()) * reach.y
        + Vec3::from(m.z_axis.abs()) * reach.z
        + Vec3::from(world_from_object.translation).abs();
    let pad = sums * (16.0 / (1 << 24) as f32);
    bounds.lower -= pad;
    bounds.upper += pad;
    bounds
}

fn validate_input(meshes: &[MeshInput], instances: &[InstanceInput]) -> Result<(), BuildError> {
    for (instance, input) in instances.iter().enumerate() {
        if input.mesh as usize >= meshes.len() {
            return Err(BuildError::NoSuchMesh {
                instance,
                mesh: input.mesh,
                meshes: meshes.len(),
            });
        }
    }
    for (mesh, input) in meshes.iter().enumerate() {
        let vertices = input.positions.len();
        let bad = input
            .triangles
            .par_iter()
            .position_first(|t| t.iter().any(|&v| v as usize >= vertices));
        if let Some(triangle) = bad {
            let vertex = input.triangles[triangle]
                .into_iter()
                .find(|&v| v as usize >= vertices);
            return Err(BuildError::NoSuchVertex {
                mesh,
                triangle,
                vertex: vertex.unwrap_or_default(),
                vertices,
            });
        }
        too_many(input.triangles.len() as u64)?;
    }
    Ok(())
}

fn too_many(triangles: u64) -> Result<(), BuildError> {
    if triangles > MAX_TRIANGLES {
        return Err(BuildError::TooManyTriangles {
            triangles,
            limit: MAX_TRIANGLES,
        });
    }
    Ok(())
}

/// By instance: copy it into the world-space tree?
fn flattened(meshes: &[MeshInput], instances: &[InstanceInput], flatten: Flatten) -> Vec<bool> {
    let mut uses = vec![0u32; meshes.len()];
    for i in instances {
        uses[i.mesh as usize] += 1;
    }
    let size = |i: &InstanceInput| meshes[i.mesh as usize].triangles.len();
    let flat: u64 = instances.iter().map(|i| size(i) as u64).sum();
    let unique: u64 = meshes.iter().map(|m| m.triangles.len() as u64).sum();
    let all = match flatten {
        Flatten::Always => true,
        Flatten::Auto => flat <= (2 * unique).max(FEW_TRIANGLES),
        Flatten::Never => false,
    };
    instances
        .iter()
        .map(|i| {
            let worth =
                flatten == Flatten::Auto && (uses[i.mesh as usize] == 1 || size(i) <= SMALL_MESH);
            all || worth || inverse(&i.world_from_object).is_none()
        })
        .collect()
}

impl Accel {
    /// Builds the structure, with the threads of the current rayon pool.
    ///
    /// Hits name instances by their index in `instances` and triangles by their index in the mesh.
    pub fn build(
        meshes: &[MeshInput],
        instances: &[InstanceInput],
        options: &BuildOptions,
    ) -> Result<Self, BuildError> {
        validate_input(meshes, instances)?;
        let flattened = flattened(meshes, instances, options.flatten);
        let flat_count = |(i, flat): (&InstanceInput, &bool)| {
            if *flat {
                meshes[i.mesh as usize].triangles.len()
            } else {
                0
            }
        };
        too_many(
            instances
                .iter()
                .zip(&flattened)
                .map(|p| flat_count(p) as u64)
                .sum::<u64>()
                + instances.len() as u64,
        )?;
        let ids = Ids::new(instances.iter().zip(&flattened).map(flat_count));
        let keep = options.keep_degenerate;

        let mut has_tree = vec![false; meshes.len()];
        for (i, _) in instances.iter().zip(&flattened).filter(|&(_, &flat)| !flat) {
            has_tree[i.mesh as usize] = true;
        }
        let own: Vec<(Tree, u64, u64)> = meshes
            .par_iter()
            .zip(&has_tree)
            .map(|(mesh, &has_tree)| {
                let count = if has_tree { mesh.triangles.len() } else { 0 };
                let refs = Refs::gather(count, 0, keep, |p| vertices(mesh, p));
                let tree = build::build(refs.refs, &OwnTriangles(mesh), options);
                (tree, refs.invalid, refs.degenerate)
            })
            .collect();
        let (mut dropped_invalid, mut dropped_degenerate) = (0, 0);
        let mut trees = Vec::with_capacity(own.len());
        for (tree, invalid, degenerate) in own {
            trees.push(tree);
            dropped_invalid += invalid;
            dropped_degenerate += degenerate;
        }

        let parts: Vec<Refs> = instances
            .par_iter()
            .zip(&flattened)
            .enumerate()
            .filter(|&(_, (_, &flat))| flat)
            .map(|(index, (instance, _))| {
                let mesh = &meshes[instance.mesh as usize];
                Refs::gather(mesh.triangles.len(), index as u32, keep, |p| {
                    world_vertices(mesh, p, &instance.world_from_object)
                })
            })
            .collect();
        let mut refs = Refs::join(parts);
        let mut placed = Vec::new();
        for (index, (instance, _)) in instances
            .iter()
            .zip(&flattened)
            .enumerate()
            .filter(|&(_, (_, &flat))| !flat)
        {
            let tree = &trees[instance.mesh as usize];
            let Some(object_from_world) = inverse(&instance.world_from_object) else {
                continue;
            };
            let bounds = placed_bounds(tree, &instance.world_from_object);
            let in_range = in_range(bounds.lower) && in_range(bounds.upper);
            if in_range && !tree.nodes.is_empty() {
                refs.refs.push(Ref::placed(&bounds, placed.len() as u32));
            } else if !in_range {
                refs.invalid += meshes[instance.mesh as usize].triangles.len() as u64;
            }
            placed.push(Placed {
                object_from_world,
                instance: index as u32,
                mesh: instance.mesh,
            });
        }
        dropped_invalid += refs.invalid;
        dropped_degenerate += refs.degenerate;
        let world = WorldTriangles {
            meshes,
            instances,
            ids: &ids,
        };
        let top = build::build(refs.refs, &world, options);
        Ok(Self {
            simd: Simd::detect(),
            options: *options,
            top,
            trees,
            placed,
            ids,
            flattened,
            meshes: meshes
                .iter()
                .map(|m| (m.triangles.len() as u32, m.filtered))
                .collect(),
            instances: instances.iter().map(|i| i.mesh).collect(),
            dropped_invalid,
            dropped_degenerate,
        })
    }

    /// Traces with other instructions than the best that the processor has; `false` if it does not have them.
    pub fn set_simd(&mut self, simd: Simd) -> bool {
        let possible = simd == Simd::Portable || simd == Simd::detect();
        if possible {
            self.simd = simd;
        }
        possible
    }

    /// The instructions that rays are traced with.
    pub fn simd(&self) -> Simd {
        self.simd
    }

    /// World-space bounds, lower and upper; `None` if there is nothing to hit.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        (!self.top.bounds.is_empty()).then_some((self.top.bounds.lower, self.top.bounds.upper))
    }

    /// Each kind of structure has a function of its own: loops of several kinds in one function share registers badly.
    #[inline(always)]
    fn trace<F: HitFilter, const ANY: bool>(&self, query: &Query<F>, found: &mut Found) -> bool {
        macro_rules! by_kind {
            ($isa:ty) => {
                match (self.has_placed(), self.is_watertight()) {
                    (false, false) => <$isa>::trace::<F, ANY, false, false>(query, found),
                    (false, true) => <$isa>::trace::<F, ANY, false, true>(query, found),
                    (true, false) => <$isa>::trace::<F, ANY, true, false>(query, found),
                    (true, true) => <$isa>::trace::<F, ANY, true, true>(query, found),
                }
            };
        }
        // SAFETY: `simd` is only ever what `Simd::detect` found or the portable code; the trees were built by this crate,
        // and the constants say what the structure holds.
        unsafe {
            match self.simd {
                #[cfg(target_arch = "x86_64")]
                Simd::Avx2 => by_kind!(Avx2),
                #[cfg(target_arch = "aarch64")]
                Simd::Neon => by_kind!(Neon),
                _ => by_kind!(Portable),
            }
        }
    }

    /// The nearest hit with `t_min < t < t_max`.
    #[inline]
    pub fn closest(&self, ray: &Ray, filter: &impl HitFilter) -> Option<Hit> {
        let query = Query {
            accel: self,
            ray,
            filter,
        };
        let mut found = Found::nothing(ray);
        let any = self.trace::<_, false>(&query, &mut found);
        any.then(|| self.hit(&found))
    }

    /// Some blocker of the ray (any one, not the nearest), or `None` if nothing lies at `t_min < t < t_max`.
    #[inline]
    pub fn blocker(&self, ray: &Ray, filter: &impl HitFilter) -> Option<Blocker> {
        let query = Query {
            accel: self,
            ray,
            filter,
        };
        let mut found = Found::nothing(ray);
        let any = self.trace::<_, true>(&query, &mut found);
        any.then_some(Blocker {
            placed: found.placed,
            block: found.block,
        })
    }

    /// Does anything lie at `t_min < t < t_max`?
    #[inline]
    pub fn occluded(&self, ray: &Ray, filter: &impl HitFilter) -> bool {
        self.blocker(ray, filter).is_some()
    }

    /// Does this blocker block the ray? Says yes only if [`Self::occluded`] would. `false` for a blocker of another
    /// structure, unless it happens to block too.
    pub fn blocks(&self, blocker: Blocker, ray: &Ray, filter: &impl HitFilter) -> bool {
        let query = Query {
            accel: self,
            ray,
            filter,
        };
        let object_ray;
        let scope = if blocker.placed == BY_ID {
            Scope {
                tree: &self.top,
                ray,
                placed: BY_ID,
            }
        } else if (blocker.placed as usize) < self.placed.len() {
            let (tree, r) = self.placed_ray(blocker.placed, ray);
            object_ray = r;
            Scope {
                tree,
                ray: &object_ray,
                placed: blocker.placed,
            }
        } else {
            return false;
        };
        // SAFETY: as in `trace`.
        unsafe {
            match self.simd {
                #[cfg(target_arch = "x86_64")]
                Simd::Avx2 => Avx2::block(&query, &scope, blocker.block),
                #[cfg(target_arch = "aarch64")]
                Simd::Neon => Neon::block(&query, &scope, blocker.block),
                _ => Portable::block(&query, &scope, blocker.block),
            }
        }
    }

    /// [`Self::occluded`] for many rays; fastest if neighbours in the batch run alike (towards one light, say).
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool], filter: &impl HitFilter) {
        assert_eq!(rays.len(), occluded.len());
        // SAFETY: as in `trace`.
        unsafe {
            match self.simd {
                #[cfg(target_arch = "x86_64")]
                Simd::Avx2 => Avx2::occluded_batch(self, rays, filter, occluded),
                #[cfg(target_arch = "aarch64")]
                Simd::Neon => Neon::occluded_batch(self, rays, filter, occluded),
                _ => Portable::occluded_batch(self, rays, filter, occluded),
            }
        }
    }

    /// [`Self::closest`] for many rays.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_batch(&self, rays: &[Ray], hits: &mut [Option<Hit>], filter: &impl HitFilter) {
        assert_eq!(rays.len(), hits.len());
        // SAFETY: as in `trace`.
        unsafe {
            match self.simd {
                #[cfg(target_arch = "x86_64")]
                Simd::Avx2 => Avx2::closest_batch(self, rays, filter, hits),
                #[cfg(target_arch = "aarch64")]
                Simd::Neon => Neon::closest_batch(self, rays, filter, hits),
                _ => Portable::closest_batch(self, rays, filter, hits),
            }
        }
    }

    /// [`Self::closest`] for many rays of which neighbours run alike: from one point through neighbouring pixels, say. Finds
    /// the same distances as [`Self::closest_batch`]; of surfaces at the same distance perhaps another. Rays that do not run
    /// alike cost somewhat more than there.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_coherent(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>],
        filter: &impl HitFilter,
    ) {
        assert_eq!(rays.len(), hits.len());
        // SAFETY: as in `trace`.
        unsafe {
            match self.simd {
                #[cfg(target_arch = "x86_64")]
                Simd::Avx2 => Avx2::closest_coherent(self, rays, filter, hits),
                #[cfg(target_arch = "aarch64")]
                Simd::Neon => Neon::closest_coherent(self, rays, filter, hits),
                _ => Portable::closest_coherent(self, rays, filter, hits),
            }
        }
    }

    /// What the structure holds.
    pub fn stats(&self) -> Stats {
        let trees = || std::iter::once(&self.top).chain(&self.trees);
        let used = |tree: &Tree| {
            tree.blocks
                .par_iter()
                .map(|b| b.ids.iter().filter(|&&id| id != NO_TRIANGLE).count() as u64)
                .sum::<u64>()
        };
        let own = |mesh: u32| self.trees[mesh as usize].triangles as u64;
        let bytes = trees().map(Tree::bytes).sum::<usize>()
            + self.ids.bytes()
            + size_of_val(&self.placed[..])
            + size_of_val(&self.flattened[..])
            + size_of_val(&self.meshes[..])
            + size_of_val(&self.instances[..])
            + size_of_val(&self.trees[..]);
        Stats {
            triangles: trees().map(|t| t.triangles as u64).sum(),
            references: trees().map(used).sum(),
            world_triangles: self.top.triangles as u64
                + self.placed.iter().map(|p| own(p.mesh)).sum::<u64>(),
            flattened: self.flattened.iter().filter(|&&f| f).count() as u64,
            placed: self.placed.len() as u64,
            dropped_invalid: self.dropped_invalid,
            dropped_degenerate: self.dropped_degenerate,
            nodes: trees().map(|t| t.nodes.len() as u64).sum(),
            blocks: trees().map(|t| t.blocks.len() as u64).sum(),
            bytes: bytes as u64,
            depth: trees().map(|t| t.depth as u32).max().unwrap_or(0),
            cost: build::collapse::cost(&self.top),
            built_cost: self.top.built_cost,
        }
    }

    pub(crate) fn top(&self) -> &Tree {
        &self.top
    }

    pub(crate) fn has_placed(&self) -> bool {
        !self.placed.is_empty()
    }

    pub(crate) fn is_watertight(&self) -> bool {
        self.options.watertight
    }

    /// The tree of a placed instance and a world-space ray in its space. Parameters along the ray stay the same.
    pub(crate) fn placed_ray(&self, placed: u32, ray: &Ray) -> (&Tree, Ray) {
        let placed = &self.placed[placed as usize];
        let object_ray = Ray {
            origin: placed.object_from_world.transform_point3(ray.origin),
            direction: placed.object_from_world.transform_vector3(ray.direction),
            ..*ray
        };
        (&self.trees[placed.mesh as usize], object_ray)
    }

    /// Instance and triangle of an id.
    pub(crate) fn name(&self, placed: u32, id: u32) -> (u32, u32) {
        let id = id & !FILTERED;
        if placed == BY_ID {
            self.ids.name(id)
        } else {
            (self.placed[placed as usize].instance, id)
        }
    }

    pub(crate) fn hit(&self, found: &Found) -> Hit {
        let (instance, primitive) = self.name(found.placed, found.id);
        Hit {
            t: found.t,
            u: found.u,
            v: found.v,
            instance,
            primitive,
        }
    }
}
