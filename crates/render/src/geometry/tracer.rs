//! A posed scene that rays can meet.

use super::alpha;
use super::shaft::Boxes;
use crate::bsdf::{self, Bsdf};
use glam::{Mat3, Vec3};
use occlude_bvh::{Accel, Blocker, BuildOptions, HitFilter, InstanceInput, MeshInput};
use occlude_scene::{AlphaMode, Material, Mesh, Pose, Scene};
use occlude_visibility::two_part::{Ball, TwoPartTracer};
use occlude_visibility::{Hit, Ray, Tracer};
use std::sync::Arc;

/// Why a scene cannot be traced.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GeometryError {
    /// There is nothing to see.
    #[error("the scene has no triangles")]
    Empty,
    /// Building the hierarchy failed.
    #[error(transparent)]
    Build(#[from] occlude_bvh::BuildError),
}

/// A posed scene with its bounding volume hierarchies: the exact [`Tracer`] of every integrator.
///
/// Clear panes (thin, smooth glass) are kept apart from everything that blocks light: a shadow ray asks the blockers
/// whether it passes at all, and the panes for the colour that it then has. So visibility stays a yes or no that caches
/// can keep.
#[derive(Debug)]
pub struct Geometry<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Where everything is.
    pub pose: &'a Pose,
    /// What stands still in a sequence of pictures; of a single picture, everything.
    still: Part,
    moving: Option<Moving>,
    normal_from_object: Vec<Mat3>,
    /// Boxes that hold the panes of all parts.
    pane_boxes: Boxes,
}

/// The hierarchies over some of the instances.
#[derive(Clone, Debug)]
struct Part {
    blockers: Arc<Accel>,
    panes: Option<Arc<Accel>>,
}

/// What moves in a sequence of pictures.
#[derive(Debug)]
struct Moving {
    part: Part,
    /// Balls that hold it all.
    balls: Vec<Ball>,
}

/// The hierarchies over what stands still in a sequence of pictures: built once, shared by the [`Geometry`] of every picture.
#[derive(Clone, Debug)]
pub struct Still(Part);

/// Whether light passes the material straight through, as through a window pane.
pub(crate) fn is_pane(material: &Material) -> bool {
    material.transmission > 0.0
        && material.metallic < 1.0
        && material.volume.is_none_or(|volume| volume.thickness == 0.0)
        && material.alpha_mode == AlphaMode::Opaque
        && bsdf::is_smooth(material.roughness)
        && (material.metallic_roughness_texture.is_none() || material.roughness == 0.0)
        && !material.unlit
}

/// A ball around each of the instances.
fn balls(scene: &Scene, pose: &Pose, takes_part: impl Fn(usize) -> bool) -> Vec<Ball> {
    let instances = (0..pose.instances.len()).filter(|&number| takes_part(number));
    instances
        .filter_map(|number| {
            let world_from_object = pose.instances[number].world_from_object;
            let corners = (pose.positions(scene, number).iter())
                .map(|&position| world_from_object.transform_point3(position));
            Ball::around(corners)
        })
        .collect()
}

struct AlphaFilter<'a> {
    scene: &'a Scene,
    pose: &'a Pose,
}

impl HitFilter for AlphaFilter<'_> {
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool {
        let mesh = &self.scene.meshes[self.pose.instances[hit.instance as usize].mesh as usize];
        alpha::accepts(self.scene, mesh, ray, hit)
    }
}

/// What hierarchies are built from.
struct Inputs<'a> {
    scene: &'a Scene,
    meshes: Vec<(&'a Mesh, &'a [Vec3])>,
    instances: Vec<InstanceInput>,
    /// The mesh without triangles.
    nothing: Option<usize>,
}

impl<'a> Inputs<'a> {
    fn new(scene: &'a Scene, pose: &'a Pose, takes_part: impl Fn(usize) -> bool) -> Self {
        let plain = scene
            .meshes
            .iter()
            .map(|mesh| (mesh, mesh.positions.as_slice()));
        let mut meshes: Vec<(&Mesh, &[Vec3])> = plain.collect();
        let mut instances = Vec::with_capacity(pose.instances.len());
        // Who takes no part is there without triangles, so that indices agree.
        let mut nothing = None;
        for (number, posed) in pose.instances.iter().enumerate() {
            let mesh = &scene.meshes[posed.mesh as usize];
            let index = match posed.deformed {
                _ if !takes_part(number) => *nothing.get_or_insert_with(|| {
                    meshes.push((mesh, &[]));
                    meshes.len() - 1
                }),
                Some(deformed) => {
                    meshes.push((mesh, &pose.deformed[deformed as usize].positions));
                    meshes.len() - 1
                }
                None => posed.mesh as usize,
            };
            instances.push(InstanceInput {
                mesh: index as u32,
                world_from_object: posed.world_from_object,
            });
        }
        Self {
            scene,
            meshes,
            instances,
            nothing,
        }
    }

    /// The meshes of the blockers, or of the panes. A mesh that belongs to the other hierarchy takes part without triangles, too.
    fn meshes(&self, pane: bool) -> Vec<MeshInput<'a>> {
        let meshes = self.meshes.iter().enumerate();
        meshes
            .map(|(index, &(mesh, positions))| {
                let here = Some(index) != self.nothing
                    && is_pane(&self.scene.materials[mesh.material as usize]) == pane;
                MeshInput {
                    positions,
                    triangles: if here { &mesh.triangles } else { &[] },
                    filtered: alpha::is_filtered(self.scene, mesh),
                }
            })
            .collect()
    }
}

impl Part {
    /// Builds the hierarchies over the instances that `takes_part` names.
    fn build(
        scene: &Scene,
        pose: &Pose,
        takes_part: impl Fn(usize) -> bool,
        options: &BuildOptions,
    ) -> Result<Self, GeometryError> {
        let inputs = Inputs::new(scene, pose, &takes_part);
        let accel = |pane: bool| {
            Accel::build(&inputs.meshes(pane), &inputs.instances, options).map(Arc::new)
        };
        let has_panes = pose.instances.iter().enumerate().any(|(number, posed)| {
            let mesh = &scene.meshes[posed.mesh as usize];
            takes_part(number) && is_pane(&scene.materials[mesh.material as usize])
        });
        Ok(Self {
            blockers: accel(false)?,
            panes: if has_panes { Some(accel(true)?) } else { None },
        })
    }

    /// Takes over another pose of all instances; false if that was not possible, or has made the hierarchies so much worse that building anew pays.
    fn refit(&mut self, scene: &Scene, pose: &Pose, worn: f32) -> bool {
        let inputs = Inputs::new(scene, pose, |_| true);
        let again = |accel: &mut Arc<Accel>, pane: bool| {
            Arc::get_mut(accel).is_some_and(|accel| {
                let done = accel.refit(&inputs.meshes(pane), &inputs.instances);
                let stats = accel.stats();
                done.is_ok() && stats.cost <= worn * stats.built_cost
            })
        };
        again(&mut self.blockers, false)
            && self.panes.as_mut().is_none_or(|panes| again(panes, true))
    }

    fn bytes(&self) -> u64 {
        self.blockers.stats().bytes + self.panes.as_ref().map_or(0, |panes| panes.stats().bytes)
    }
}

/// The hierarchies of a picture, to be refitted for the next one of a sequence.
#[derive(Clone, Debug)]
pub struct Hierarchies(Part);

/// Hierarchies are built anew once refits have raised their expected cost a ray to this, relative: with a few hundred thousand rays a frame, a fifth more
/// time for rays is what a build takes.
const WORN: f32 = 1.2;

impl Still {
    /// Builds the hierarchies over the instances that are not `moving` (by number, as
    /// [`moving_instances`](occlude_scene::moving_instances) finds them).
    pub fn new(
        scene: &Scene,
        pose: &Pose,
        moving: &[bool],
        options: &BuildOptions,
    ) -> Result<Self, GeometryError> {
        let moves = |number: usize| moving.get(number).is_some_and(|moves| *moves);
        Part::build(scene, pose, |number| !moves(number), options).map(Self)
    }
}

impl<'a> Geometry<'a> {
    /// Builds the hierarchies. Takes about half a microsecond a triangle and core.
    pub fn new(
        scene: &'a Scene,
        pose: &'a Pose,
        options: &BuildOptions,
    ) -> Result<Self, GeometryError> {
        let still = Part::build(scene, pose, |_| true, options)?;
        Self::of_parts(scene, pose, still, None)
    }

    /// The next picture of a sequence: refits the hierarchies of the one before, which is much faster than building, and builds anew if there are none, if other
    /// instances or triangles are there, or if too much has moved since the last build.
    pub fn after(
        before: Option<Hierarchies>,
        scene: &'a Scene,
        pose: &'a Pose,
    ) -> Result<Self, GeometryError> {
        if let Some(Hierarchies(mut part)) = before
            && part.refit(scene, pose, WORN)
        {
            return Self::of_parts(scene, pose, part, None);
        }
        let options = BuildOptions {
            whole_triangles: true,
            keep_degenerate: true,
            ..BuildOptions::default()
        };
        Self::new(scene, pose, &options)
    }

    /// [`after`](Self::after) without a limit to how worn hierarchies may be: for measuring what refits cost.
    pub fn refitted(
        before: Option<Hierarchies>,
        scene: &'a Scene,
        pose: &'a Pose,
    ) -> Result<Self, GeometryError> {
        if let Some(Hierarchies(mut part)) = before
            && part.refit(scene, pose, f32::INFINITY)
        {
            return Self::of_parts(scene, pose, part, None);
        }
        Self::after(None, scene, pose)
    }

    /// Ends a picture: what [`after`](Self::after) starts the next one with.
    pub fn into_hierarchies(self) -> Hierarchies {
        Hierarchies(self.still)
    }

    /// One picture of a sequence: builds hierarchies over what is `moving` alone, and takes the others from `still`, which
    /// must have been built from the same scene with the same instances moving.
    pub fn in_sequence(
        scene: &'a Scene,
        pose: &'a Pose,
        still: &Still,
        moving: &[bool],
        options: &BuildOptions,
    ) -> Result<Self, GeometryError> {
        let moves = |number: usize| moving.get(number).is_some_and(|moves| *moves);
        let part = if moving.contains(&true) {
            Some(Moving {
                part: Part::build(scene, pose, moves, options)?,
                balls: balls(scene, pose, moves),
            })
        } else {
            None
        };
        Self::of_parts(scene, pose, still.0.clone(), part)
    }

    fn of_parts(
        scene: &'a Scene,
        pose: &'a Pose,
        still: Part,
        moving: Option<Moving>,
    ) -> Result<Self, GeometryError> {
        if !pose
            .instances
            .iter()
            .any(|posed| !scene.meshes[posed.mesh as usize].triangles.is_empty())
        {
            return Err(GeometryError::Empty);
        }
        let normal_from_object = pose.instances.iter().map(|posed| {
            let world_from_object = Mat3::from(posed.world_from_object.matrix3);
            let inverse = world_from_object.inverse();
            // A flat (singular) transform has no inverse; its triangles then use their geometric normal.
            if inverse.is_finite() {
                inverse.transpose()
            } else {
                Mat3::ZERO
            }
        });
        let mut geometry = Self {
            scene,
            pose,
            still,
            moving,
            normal_from_object: normal_from_object.collect(),
            pane_boxes: Boxes::default(),
        };
        let parts = geometry.panes().count().max(1);
        let boxes = geometry
            .panes()
            .flat_map(|panes| panes.boxes(Boxes::MOST / parts));
        geometry.pane_boxes = Boxes::new(boxes);
        Ok(geometry)
    }

    fn parts(&self) -> impl Iterator<Item = &Part> {
        [&self.still]
            .into_iter()
            .chain(self.moving.as_ref().map(|moving| &moving.part))
    }

    fn panes(&self) -> impl Iterator<Item = &Accel> {
        self.parts().filter_map(|part| part.panes.as_deref())
    }

    fn filter(&self) -> AlphaFilter<'a> {
        AlphaFilter {
            scene: self.scene,
            pose: self.pose,
        }
    }

    /// World-space normals of an instance from those of its object, up to length.
    pub(super) fn normal_from_object(&self, instance: u32) -> Mat3 {
        self.normal_from_object[instance as usize]
    }

    /// Bytes of the hierarchies.
    pub fn bytes(&self) -> u64 {
        self.parts().map(Part::bytes).sum()
    }

    /// The nearest surface along each ray, panes included.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_batch(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        assert_eq!(rays.len(), hits.len());
        self.still
            .blockers
            .closest_batch(rays, hits, &self.filter());
        self.nearer(rays, hits);
    }

    /// [`Self::closest_batch`] for rays of which neighbours run alike, such as those through neighbouring pixels.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_coherent(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        assert_eq!(rays.len(), hits.len());
        self.still
            .blockers
            .closest_coherent(rays, hits, &self.filter());
        self.nearer(rays, hits);
    }

    /// What panes and moving parts have before the hits that are known.
    fn nearer(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        for panes in self.panes() {
            for (ray, hit) in rays.iter().zip(&mut *hits) {
                let before = Ray {
                    t_max: hit.map_or(ray.t_max, |hit| hit.t),
                    ..*ray
                };
                if let Some(near) = panes.closest(&before, &self.filter()) {
                    *hit = Some(near);
                }
            }
        }
        self.nearer_moving(rays, hits);
    }

    /// What moving parts have before the hits that are known.
    fn nearer_moving(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        let Some(moving) = &self.moving else { return };
        let before = rays.iter().zip(&*hits).map(|(ray, hit)| Ray {
            t_max: hit.map_or(ray.t_max, |hit| hit.t),
            ..*ray
        });
        let before: Vec<Ray> = before.collect();
        let mut near = vec![None; rays.len()];
        let blockers = &moving.part.blockers;
        blockers.closest_coherent(&before, &mut near, &self.filter());
        for (hit, near) in hits.iter_mut().zip(near) {
            *hit = near.or(*hit);
        }
    }

    /// The nearest blocker along each ray, panes left out; neighbours run alike.
    pub(super) fn closest_blockers(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        let filter = self.filter();
        self.still.blockers.closest_coherent(rays, hits, &filter);
        self.nearer_moving(rays, hits);
    }

    /// Whether some panes tint shadow rays.
    pub fn has_panes(&self) -> bool {
        self.panes().next().is_some()
    }

    /// Boxes that hold all panes.
    pub(crate) fn pane_boxes(&self) -> &Boxes {
        &self.pane_boxes
    }

    /// [`Self::pane_transmittance`] for many rays that run alike: most cross no pane, which is cheaper to find out together.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn pane_transmittance_batch(&self, rays: &[Ray], transmittance: &mut [Vec3]) {
        let mut crosses = [false; 64];
        let size = crosses.len();
        assert_eq!(rays.len(), transmittance.len());
        transmittance.fill(Vec3::ONE);
        for panes in self.panes() {
            for (rays, transmittance) in rays.chunks(size).zip(transmittance.chunks_mut(size)) {
                let crosses = &mut crosses[..rays.len()];
                crosses.fill(false);
                panes.occluded_batch(rays, crosses, &self.filter());
                for ((ray, colour), _) in rays
                    .iter()
                    .zip(transmittance)
                    .zip(crosses)
                    .filter(|(_, crosses)| **crosses)
                {
                    *colour = self.pane_transmittance(ray);
                }
            }
        }
    }

    /// Share of light, by colour, that the panes along a ray let pass; blockers are not asked.
    pub fn pane_transmittance(&self, ray: &Ray) -> Vec3 {
        /// More panes than this in a row are as good as a wall.
        const MOST_PANES: usize = 64;
        let mut transmittance = Vec3::ONE;
        if !self.has_panes() {
            return transmittance;
        }
        let mut rest = *ray;
        let toward_origin = -ray.direction.normalize_or_zero();
        for _ in 0..MOST_PANES {
            let mut nearest: Option<Hit> = None;
            for panes in self.panes() {
                let before = Ray {
                    t_max: nearest.map_or(rest.t_max, |hit| hit.t),
                    ..rest
                };
                nearest = panes.closest(&before, &self.filter()).or(nearest);
            }
            let Some(hit) = nearest else {
                return transmittance;
            };
            if let Some(surface) = super::Surface::new(self, hit, toward_origin) {
                let parameters = surface.bsdf_parameters(self);
                let wo = surface.world_from_local.transpose() * toward_origin;
                transmittance *= Bsdf::new(&parameters, wo).straight_transmittance(wo);
            }
            rest.t_min = hit.t;
        }
        Vec3::ZERO
    }
}

impl Tracer for Geometry<'_> {
    /// A blocker, and whether it moves.
    type Blocker = (bool, Blocker);

    fn blocker(&self, ray: &Ray) -> Option<Self::Blocker> {
        let of_part = |moves: bool, part: &Part| {
            let blocker = part.blockers.blocker(ray, &self.filter())?;
            Some((moves, blocker))
        };
        of_part(false, &self.still).or_else(|| of_part(true, &self.moving.as_ref()?.part))
    }

    fn blocks(&self, (moves, blocker): Self::Blocker, ray: &Ray) -> bool {
        let part = match (&self.moving, moves) {
            (Some(moving), true) => &moving.part,
            (None, true) => return false,
            (_, false) => &self.still,
        };
        part.blockers.blocks(blocker, ray, &self.filter())
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.parts()
            .any(|part| part.blockers.occluded(ray, &self.filter()))
    }

    fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.still
            .blockers
            .occluded_batch(rays, occluded, &self.filter());
        if let Some(moving) = &self.moving {
            for (ray, occluded) in rays.iter().zip(occluded) {
                *occluded |= self.is_met(moving, ray);
            }
        }
    }
}

impl TwoPartTracer for Geometry<'_> {
    fn occluded_by_still(&self, rays: &[Ray], occluded: &mut [bool]) {
        let filter = self.filter();
        self.still.blockers.occluded_batch(rays, occluded, &filter);
    }

    fn occluded_by_moving(&self, ray: &Ray) -> bool {
        (self.moving.as_ref()).is_some_and(|moving| self.is_met(moving, ray))
    }

    fn moving(&self) -> &[Ball] {
        self.moving.as_ref().map_or(&[], |moving| &moving.balls)
    }
}

impl Geometry<'_> {
    fn is_met(&self, moving: &Moving, ray: &Ray) -> bool {
        moving.part.blockers.occluded(ray, &self.filter())
    }
}
