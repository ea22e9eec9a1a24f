//! A posed scene that rays can meet.

use super::alpha;
use crate::bsdf::{self, Bsdf};
use glam::{Mat3, Vec3};
use occlude_bvh::{Accel, Blocker, BuildOptions, HitFilter, InstanceInput, MeshInput};
use occlude_scene::{AlphaMode, Material, Pose, Scene};
use occlude_visibility::{Hit, Ray, Tracer};

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
    blockers: Accel,
    panes: Option<Accel>,
    normal_from_object: Vec<Mat3>,
}

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

impl<'a> Geometry<'a> {
    /// Builds the hierarchies. Takes about half a microsecond a triangle and core.
    pub fn new(
        scene: &'a Scene,
        pose: &'a Pose,
        options: &BuildOptions,
    ) -> Result<Self, GeometryError> {
        let plain = scene
            .meshes
            .iter()
            .map(|mesh| (mesh, mesh.positions.as_slice()));
        let mut meshes: Vec<_> = plain.collect();
        let mut instances = Vec::with_capacity(pose.instances.len());
        for posed in &pose.instances {
            let mesh = &scene.meshes[posed.mesh as usize];
            let index = match posed.deformed {
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
        let accel = |pane: bool| {
            // A mesh that belongs to the other hierarchy takes part without triangles, so that indices agree.
            let inputs: Vec<_> = meshes
                .iter()
                .map(|(mesh, positions)| {
                    let here = is_pane(&scene.materials[mesh.material as usize]) == pane;
                    MeshInput {
                        positions,
                        triangles: if here { &mesh.triangles } else { &[] },
                        filtered: alpha::is_filtered(scene, mesh),
                    }
                })
                .collect();
            Accel::build(&inputs, &instances, options)
        };
        if !pose
            .instances
            .iter()
            .any(|posed| !scene.meshes[posed.mesh as usize].triangles.is_empty())
        {
            return Err(GeometryError::Empty);
        }
        let has_panes = pose.instances.iter().any(|posed| {
            let mesh = &scene.meshes[posed.mesh as usize];
            is_pane(&scene.materials[mesh.material as usize])
        });
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
        Ok(Self {
            scene,
            pose,
            blockers: accel(false)?,
            panes: if has_panes { Some(accel(true)?) } else { None },
            normal_from_object: normal_from_object.collect(),
        })
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
        self.blockers.stats().bytes + self.panes.as_ref().map_or(0, |panes| panes.stats().bytes)
    }

    /// The nearest surface along each ray, panes included.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_batch(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        assert_eq!(rays.len(), hits.len());
        self.blockers.closest_batch(rays, hits, &self.filter());
        if let Some(panes) = &self.panes {
            for (ray, hit) in rays.iter().zip(hits) {
                let before = Ray {
                    t_max: hit.map_or(ray.t_max, |hit| hit.t),
                    ..*ray
                };
                if let Some(pane) = panes.closest(&before, &self.filter()) {
                    *hit = Some(pane);
                }
            }
        }
    }

    /// Whether some panes tint shadow rays.
    pub fn has_panes(&self) -> bool {
        self.panes.is_some()
    }

    /// Share of light, by colour, that the panes along a ray let pass; blockers are not asked.
    pub fn pane_transmittance(&self, ray: &Ray) -> Vec3 {
        /// More panes than this in a row are as good as a wall.
        const MOST_PANES: usize = 64;
        let mut transmittance = Vec3::ONE;
        let Some(panes) = &self.panes else {
            return transmittance;
        };
        let mut rest = *ray;
        let toward_origin = -ray.direction.normalize_or_zero();
        for _ in 0..MOST_PANES {
            let Some(hit) = panes.closest(&rest, &self.filter()) else {
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
    type Blocker = Blocker;

    fn blocker(&self, ray: &Ray) -> Option<Blocker> {
        self.blockers.blocker(ray, &self.filter())
    }

    fn blocks(&self, blocker: Blocker, ray: &Ray) -> bool {
        self.blockers.blocks(blocker, ray, &self.filter())
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.blockers.occluded(ray, &self.filter())
    }

    fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.blockers.occluded_batch(rays, occluded, &self.filter());
    }
}
