//! From a posed scene to an atlas.

use super::arrange::{TooLarge, arrange};
use super::unwrap::{Conformal, Kept, Projection, Surface, Unwrap, UnwrapError};
use super::{Atlas, Layout, Placement, given, pages};
use glam::{Mat3, UVec2, Vec3};
use occlude_render::job::Job;
use occlude_scene::{Pose, Scene};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// How charts are made where the scene has no UVs of its own for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnwrapKind {
    /// [`Projection`].
    #[default]
    Projection,
    /// [`Conformal`].
    Conformal,
}

/// What an atlas is to be like.
#[derive(Clone, Debug, PartialEq)]
pub struct AtlasSettings {
    /// Width and height of pages at most, texels: rounded down to a multiple of 4, at least 16, at most 16384. Default 4096.
    pub page_size: u32,
    /// Texels between charts. Higher: more room for filters and mip maps, more texels. Default 2.
    pub padding: u32,
    /// How charts are made.
    pub unwrap: UnwrapKind,
    /// Folder in which conformal charts are kept, by a hash of their mesh.
    pub kept: Option<PathBuf>,
    /// Use `TEXCOORD_1` of the file where it is fit for a light map.
    pub use_given: bool,
}

impl Default for AtlasSettings {
    fn default() -> Self {
        Self {
            page_size: 4096,
            padding: 2,
            unwrap: UnwrapKind::default(),
            kept: None,
            use_given: true,
        }
    }
}

/// Why there is no atlas.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AtlasError {
    /// No instance has a density.
    #[error("nothing to bake: no instance has texels")]
    Nothing,
    /// A flat part of an object is larger than a page.
    #[error(
        "{object} needs more than a page of {page_size} texels at {texels_per_metre} texels a metre; at most {fits} fit"
    )]
    LargerThanPage {
        /// Name of the object to blame.
        object: String,
        /// Width and height of a page.
        page_size: u32,
        /// Density that was asked for.
        texels_per_metre: f32,
        /// Largest density of that object that fits.
        fits: f32,
    },
    /// More texels than numbers for them.
    #[error(
        "the atlas needs {texels} texels, {object} alone {of_object}; at most {fits} of the density fits"
    )]
    TooManyTexels {
        /// Texels needed.
        texels: u64,
        /// The object with most of them.
        object: String,
        /// Its texels.
        of_object: u64,
        /// Share of the density that fits.
        fits: f32,
    },
    /// The job was cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// An object that is not as it should be; the others are.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Name of the mesh.
    pub mesh: String,
    /// What is wrong.
    pub what: String,
    /// The mesh is not baked. Otherwise only its own UVs were refused.
    pub lost: bool,
}

/// An atlas and what went wrong on the way.
#[derive(Clone, Debug, Default)]
pub struct Built {
    /// The atlas.
    pub atlas: Atlas,
    /// In the order of meshes.
    pub problems: Vec<Problem>,
}

/// Densities this close share a layout, made for the highest.
const SAME_DENSITY: f32 = 1.25;

/// Instances that share a layout.
struct Class {
    mesh: u32,
    /// A rotation of the world away from `world_from_object`, of unit size.
    shape: Mat3,
    /// Texels a unit of `shape`.
    density: f32,
    /// The density that was asked for there, texels a metre.
    texels_per_metre: f32,
    instances: Vec<u32>,
}

/// Builds the atlas. `densities` are those of the instances in texels a metre, as [`density::densities`](super::density::densities)
/// gives them. Takes about a second for a million triangles; progress counts triangles.
///
/// # Errors
/// [`AtlasError`].
pub fn build(
    scene: &Scene,
    pose: &Pose,
    densities: &[Option<f32>],
    settings: &AtlasSettings,
    job: &Job,
) -> Result<Built, AtlasError> {
    let settings = &AtlasSettings {
        page_size: settings.page_size.clamp(16, 16_384) / pages::BLOCK * pages::BLOCK,
        padding: settings.padding.min(64),
        ..settings.clone()
    };
    let classes = classes(scene, pose, densities);
    let triangles = |class: &Class| scene.meshes[class.mesh as usize].triangles.len() as u64;
    job.start_phase("unwrap", classes.iter().map(triangles).sum());
    let laid: Vec<_> = classes
        .par_iter()
        .map(|class| {
            if job.is_cancelled() {
                return Err(AtlasError::Cancelled);
            }
            let laid = lay_out(scene, class, settings);
            job.advance(triangles(class), 0);
            laid
        })
        .collect();
    // The worst object is named, not the first.
    let too_large = |e: &AtlasError| match e {
        AtlasError::LargerThanPage {
            texels_per_metre,
            fits,
            ..
        } => fits / texels_per_metre,
        _ => 0.0,
    };
    let worst = laid
        .iter()
        .filter_map(|l| l.as_ref().err())
        .min_by(|a, b| too_large(a).total_cmp(&too_large(b)));
    if let Some(error) = worst {
        return Err(error.clone());
    }

    let mut built = Built::default();
    let atlas = &mut built.atlas;
    atlas.placements = vec![None; pose.instances.len()];
    let mut texels_of = vec![0_u64; classes.len()];
    for (c, (class, laid)) in classes.iter().zip(laid).enumerate() {
        let (layout, problem) = laid?;
        built.problems.extend(problem);
        let Some(mut layout) = layout else { continue };
        layout.texels_per_metre = class.texels_per_metre;
        for &instance in &class.instances {
            atlas.placements[instance as usize] = Some(Placement {
                layout: atlas.layouts.len() as u32,
                first_rectangle: 0,
            });
        }
        let texels = |p: &UVec2| u64::from(p.x) * u64::from(p.y);
        let of_one: u64 = layout.pieces.iter().map(texels).sum();
        texels_of[c] = of_one * class.instances.len() as u64;
        atlas.layouts.push(layout);
    }
    if atlas.layouts.is_empty() {
        return if built.problems.is_empty() {
            Err(AtlasError::Nothing)
        } else {
            Ok(built)
        };
    }
    // Padding and gaps between objects take some more, never as much again.
    let texels: u64 = texels_of.iter().sum();
    let most = u64::from(u32::MAX) / 2;
    if texels > most {
        let worst = (0..classes.len())
            .max_by_key(|&c| texels_of[c])
            .unwrap_or(0);
        return Err(AtlasError::TooManyTexels {
            texels,
            object: object_name(scene, &classes[worst]),
            of_object: texels_of[worst],
            fits: (most as f64 / texels as f64).sqrt() as f32,
        });
    }
    let groups = groups(pose, atlas);
    let pieces = |layout: u32| atlas.layouts[layout as usize].pieces.clone();
    let packed = pages::pack(&groups, pieces, settings.padding, settings.page_size);
    (atlas.pages, atlas.blocks, atlas.rectangles) =
        (packed.pages, packed.blocks, packed.rectangles);
    Ok(built)
}

/// Baked instances by node and place. Also notes where each instance's rectangles will begin.
fn groups(pose: &Pose, atlas: &mut Atlas) -> Vec<pages::Group> {
    let mut places: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut members: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
    for (i, posed) in pose.instances.iter().enumerate() {
        // The k-th time that a node shows a mesh is its k-th place.
        let next = places.entry((posed.node, posed.mesh)).or_default();
        if atlas.placements[i].is_some() {
            members
                .entry((posed.node, *next))
                .or_default()
                .push(i as u32);
        }
        *next += 1;
    }
    let mut rectangles = 0;
    let mut groups = Vec::with_capacity(members.len());
    for ((node, occurrence), instances) in members {
        let mut layouts = Vec::with_capacity(instances.len());
        for i in instances {
            let Some(placement) = &mut atlas.placements[i as usize] else {
                continue;
            };
            placement.first_rectangle = rectangles;
            rectangles += atlas.layouts[placement.layout as usize].pieces.len() as u32;
            layouts.push(placement.layout);
        }
        groups.push(pages::Group {
            node,
            occurrence,
            layouts,
        });
    }
    groups
}

fn object_name(scene: &Scene, class: &Class) -> String {
    let mesh = &scene.meshes[class.mesh as usize].name;
    let node = class
        .instances
        .first()
        .map(|&i| &scene.nodes[scene.instances[i as usize].node as usize].name);
    match (node.map_or("", |n| n.as_str()), mesh.as_str()) {
        ("", "") => format!("mesh {}", class.mesh),
        ("", name) | (name, "") => name.to_string(),
        (node, mesh) if node == mesh => node.to_string(),
        (node, mesh) => format!("{node} ({mesh})"),
    }
}

/// An instance on its way into a class.
struct Candidate {
    density: f32,
    texels_per_metre: f32,
    shape: Mat3,
    instance: u32,
}

/// Instances by mesh, shape of their transform, and density.
fn classes(scene: &Scene, pose: &Pose, densities: &[Option<f32>]) -> Vec<Class> {
    let mut shapes: BTreeMap<(u32, [i32; 9]), Vec<Candidate>> = BTreeMap::new();
    for (i, posed) in pose.instances.iter().enumerate() {
        let Some(density) = densities.get(i).copied().flatten() else {
            continue;
        };
        let Some((shape, size)) = shape_of(Mat3::from(posed.world_from_object.matrix3)) else {
            continue;
        };
        let key = shape.to_cols_array().map(|x| (x * 1024.0).round() as i32);
        let of_shape = shapes.entry((posed.mesh, key)).or_default();
        of_shape.push(Candidate {
            density: density * size,
            texels_per_metre: density,
            shape,
            instance: i as u32,
        });
    }
    let mut classes = Vec::new();
    for ((mesh, _), mut instances) in shapes {
        instances.sort_by(|a, b| {
            let by_density = b.density.total_cmp(&a.density);
            by_density.then(a.instance.cmp(&b.instance))
        });
        let mut rest = instances.as_slice();
        while let Some(&Candidate {
            density,
            texels_per_metre,
            shape,
            ..
        }) = rest.first()
        {
            let alike = rest
                .partition_point(|i| i.density * SAME_DENSITY >= density)
                .max(1);
            let (alike, others) = rest.split_at(alike);
            rest = others;
            let mut numbers: Vec<u32> = alike.iter().map(|i| i.instance).collect();
            numbers.sort_unstable();
            classes.push(Class {
                mesh,
                shape,
                density,
                texels_per_metre,
                instances: numbers,
            });
        }
    }
    debug_assert!(
        classes
            .iter()
            .all(|c| (c.mesh as usize) < scene.meshes.len())
    );
    classes
}

/// A transform without its rotation, as the upper triangular matrix of its QR decomposition, and its size (the longest column): lengths
/// and angles are those of the transform. `None` if it makes everything a point.
fn shape_of(m: Mat3) -> Option<(Mat3, f32)> {
    let size = m
        .x_axis
        .length()
        .max(m.y_axis.length())
        .max(m.z_axis.length());
    if !(size > 0.0 && size.is_finite()) {
        return None;
    }
    let m = Mat3::from_cols(m.x_axis / size, m.y_axis / size, m.z_axis / size);
    let x = m.x_axis.normalize_or_zero();
    let xy = x.dot(m.y_axis);
    let y = (m.y_axis - x * xy).normalize_or_zero();
    let (xz, yz) = (x.dot(m.z_axis), y.dot(m.z_axis));
    let z = (m.z_axis - x * xz - y * yz).length();
    let shape = Mat3::from_cols(
        Vec3::new(m.x_axis.length(), 0.0, 0.0),
        Vec3::new(xy, y.dot(m.y_axis), 0.0),
        Vec3::new(xz, yz, z),
    );
    // Rotations and uniform scales are to be recognised in spite of rounding.
    let round = shape.abs_diff_eq(Mat3::IDENTITY, 1e-4);
    Some((if round { Mat3::IDENTITY } else { shape }, size))
}

type Laid = (Option<Layout>, Option<Problem>);

fn lay_out(scene: &Scene, class: &Class, settings: &AtlasSettings) -> Result<Laid, AtlasError> {
    let mesh = &scene.meshes[class.mesh as usize];
    let moved: Vec<Vec3>;
    let positions = if class.shape == Mat3::IDENTITY {
        &mesh.positions
    } else {
        moved = mesh.positions.iter().map(|&p| class.shape * p).collect();
        &moved
    };
    let surface = Surface {
        positions,
        triangles: &mesh.triangles,
        texels_per_metre: class.density,
    };
    let problem = |what: String, lost| Problem {
        mesh: object_name(scene, class),
        what,
        lost,
    };
    let mut refused = None;
    if settings.use_given && !mesh.uv1.is_empty() {
        match given::layout(
            class.mesh,
            &surface,
            &mesh.uv1,
            settings.padding,
            settings.page_size,
        ) {
            Ok(Ok(given)) => {
                let note = given.narrow.then(|| {
                    let what = format!("TEXCOORD_1 is used, but its islands are less than {} texels apart: light may bleed", settings.padding);
                    problem(what, false)
                });
                return Ok((Some(given.layout), note));
            }
            Ok(Err(unfit)) => {
                refused = Some(problem(
                    format!("TEXCOORD_1 is not used, new UVs are made: {unfit}"),
                    false,
                ))
            }
            // What is laid out anew may be divided among pages.
            Err(TooLarge { .. }) => {
                refused = Some(problem(
                    "TEXCOORD_1 is not used, new UVs are made: it needs more than a page".into(),
                    false,
                ))
            }
        }
    }
    let charts = match (settings.unwrap, &settings.kept) {
        (UnwrapKind::Projection, _) => Projection.charts(&surface),
        (UnwrapKind::Conformal, None) => Conformal.charts(&surface),
        (UnwrapKind::Conformal, Some(folder)) => Kept {
            inner: Conformal,
            folder,
        }
        .charts(&surface),
    };
    let charts = match charts {
        Ok(charts) => charts,
        Err(error @ (UnwrapError::NoArea | UnwrapError::Library(_))) => {
            return Ok((
                None,
                Some(problem(format!("cannot be unwrapped: {error}"), true)),
            ));
        }
    };
    match arrange(
        class.mesh,
        charts,
        class.density,
        settings.padding,
        settings.page_size,
    ) {
        Ok(layout) => Ok((Some(layout), refused)),
        Err(TooLarge { shrink }) => Err(AtlasError::LargerThanPage {
            object: object_name(scene, class),
            page_size: settings.page_size,
            texels_per_metre: class.texels_per_metre,
            fits: round_down(class.texels_per_metre * shrink),
        }),
    }
}

/// Three digits are enough to be typed in.
fn round_down(x: f32) -> f32 {
    let mut unit = 1.0_f32;
    while unit * 1000.0 <= x {
        unit *= 10.0;
    }
    while unit * 100.0 > x && unit > 1e-20 {
        unit /= 10.0;
    }
    (x / unit).floor() * unit
}
