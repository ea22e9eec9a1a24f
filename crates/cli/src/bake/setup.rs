//! A scene laid out for baking: loaded, unwrapped, its hierarchy built, its way of gathering chosen, within the memory there is.

use super::args::{GatherName, LightPart, SidesName, WorkArgs};
use super::parts::notes;
use super::settings::{bundle_settings, fingerprint, settings};
use super::subject::{self, Loaded};
use crate::context::Context;
use crate::error::CliError;
use crate::stats;
use occlude_bake::atlas::{Atlas, Built};
use occlude_bake::bundle::{self, Triangles};
use occlude_bake::gather::{Part, PathSettings};
use occlude_bake::orient;
use occlude_bake::plan::Estimate;
use occlude_bake::rounds::{Bake, GatherKind, Subject};
use occlude_bake::texel::Texels;
use occlude_bvh::BuildOptions;
use occlude_render::geometry::Geometry;
use occlude_render::integrator::World;
use occlude_render::light::{LightSelection, Lights};
use occlude_scene::{Material, Pose};

/// A scene and everything that gathering needs.
pub struct Setup<'a> {
    pub loaded: &'a Loaded,
    /// Materials as they were.
    pub originals: &'a [Material],
    pub pose: &'a Pose,
    pub built: &'a Built,
    pub texels: &'a Texels<'a>,
    pub geometry: &'a Geometry<'a>,
    pub gather: GatherKind,
    pub fingerprint: u64,
    /// What it will take, if that has been asked for.
    pub estimate: Option<Estimate>,
    /// Bytes of the whole process: at least, and with the buffers as they are set.
    pub floor: u64,
    pub peak: u64,
}

impl Setup<'_> {
    /// The scene's file is glTF: it is edited, not written anew.
    pub fn is_gltf(&self) -> bool {
        let ending = self.loaded.scene.path.extension().unwrap_or_default();
        ["gltf", "glb"].contains(&ending.to_string_lossy().to_lowercase().as_str())
    }
}

/// Loads and lays out a scene, and hands it over. `estimated`: with an estimate of the time.
pub fn prepared<T>(
    work: &WorkArgs,
    context: &mut Context,
    estimated: bool,
    then: impl FnOnce(&Setup, &Bake, &mut Context) -> Result<T, CliError>,
) -> Result<T, CliError> {
    let mut loaded = context.phase("load", |context| Loaded::load(work, context))?;
    let originals = loaded.make_lambert();
    let pose = Pose::at(&loaded.scene, work.time);
    let mut built = context.phase("unwrap", |context| {
        subject::atlas(work, &loaded, &pose, context)
    })?;
    if let Some(limit) = context.common.memory {
        // What is sure to be too much is refused before hierarchies are built.
        let triangles = crate::inspect::counts(&loaded.scene).triangles;
        let kind = match work.gather {
            GatherName::Bundles => GatherKind::Bundles,
            GatherName::Auto | GatherName::Path => GatherKind::Path,
        };
        let least = stats::resident_memory()
            + triangles * LEAST_BYTES_PER_TRIANGLE
            + u64::from(built.atlas.texels()) * Bake::least_bytes_per_texel(kind, &work.store());
        if least.max(stats::peak_memory()) > limit {
            return Err(too_little_memory(
                least.max(stats::peak_memory()),
                limit,
                work,
                &loaded,
                &built.atlas,
            ));
        }
    }
    let limit = context.common.memory;
    // The buffers of bundles while not all is there: half of what is left.
    let entries = |settings: &bundle::Settings| match limit {
        Some(limit) => {
            let left = limit.saturating_sub(stats::resident_memory()) / 2;
            settings.entries_within(left, rayon::current_num_threads() as u64)
        }
        None => settings.entries,
    };
    let geometry = context.phase("build", |context| {
        let geometry = Geometry::new(&loaded.scene, &pose, &BuildOptions::default())
            .map_err(|error| CliError::input("cannot trace", work.scene.display(), error))?;
        if work.sides == SidesName::Auto {
            turn_over(work, &loaded, &pose, &geometry, &mut built.atlas, context);
        }
        Ok::<_, CliError>(geometry)
    })?;
    let built = built;
    let texels = Texels::new(&loaded.scene, &pose, &built.atlas);
    let seed = context.common.seed;
    let failed = |error: std::io::Error| work.scratch_failed(&error);
    // By bundles, and by paths if that is cheaper or wanted.
    let mut triangles = (work.gather != GatherName::Path && work.light != LightPart::Ao)
        .then(|| Triangles::new(&loaded.scene, &pose, &built.atlas));
    if triangles.is_some() && work.gather == GatherName::Auto {
        // Before backs are found, which paths do not need.
        let price = |gather: GatherKind, context: &Context| {
            let sky = loaded.sky(work, gather);
            let lights = Lights::new(&loaded.scene, &pose, sky.asked, LightSelection::Tree);
            let subject = Subject {
                world: World {
                    geometry: &geometry,
                    lights: &lights,
                },
                texels: &texels,
                triangles: triangles.as_ref().filter(|_| gather == GatherKind::Bundles),
                sky: sky.even.as_ref().map(|(sky, brightest)| (sky, *brightest)),
                luminous: sky.luminous,
            };
            let mut settings = settings(work, &built.atlas, gather, seed, limit);
            settings.bundles.entries = entries(&settings.bundles);
            Bake::new(subject, settings, work.store(), 0, String::new())?.price(&context.job)
        };
        let [bundles, paths] = context.phase("choose", |context| {
            [GatherKind::Bundles, GatherKind::Path].map(|gather| price(gather, context))
        });
        if paths.map_err(failed)? < bundles.map_err(failed)? {
            triangles = None;
        }
    }
    if let Some(triangles) = &mut triangles {
        let mut settings = bundle_settings(&built.atlas, limit);
        settings.entries = entries(&settings);
        context.phase("build", |context| {
            triangles.find_backs(seed, &settings, &context.job)
        });
    }
    let gather = match triangles {
        Some(_) => GatherKind::Bundles,
        None => GatherKind::Path,
    };
    let sky = loaded.sky(work, gather);
    let lights = Lights::new(&loaded.scene, &pose, sky.asked, LightSelection::Tree);
    context.stats.scene_counts = Some({
        let mut counts = crate::inspect::counts(&loaded.scene);
        counts.lights = lights.len() as u64;
        counts
    });
    if lights.is_empty() && sky.even.is_none() && work.light != LightPart::Ao {
        return Err(CliError::input(
            "no light",
            work.scene.display(),
            "add --environment FILE or --sun AZ,EL (such as --sun 45,45), or use --light ao",
        ));
    }
    let fingerprint = fingerprint(work, &loaded, &pose, &built.atlas, gather, context);
    let mut bake = Bake::new(
        Subject {
            world: World {
                geometry: &geometry,
                lights: &lights,
            },
            texels: &texels,
            triangles: triangles.as_ref(),
            sky: sky.even.as_ref().map(|(sky, brightest)| (sky, *brightest)),
            luminous: sky.luminous,
        },
        settings(work, &built.atlas, gather, seed, limit),
        work.store(),
        fingerprint,
        notes()?,
    )
    .map_err(failed)?;
    let (now, so_far) = (stats::resident_memory(), stats::peak_memory());
    let memory = bake.memory(std::fs::metadata(&work.scene).map_or(0, |data| data.len()));
    let with = |more: u64| so_far.max(now + more + more / 16 + SLACK_BYTES);
    if let Some(limit) = limit {
        let left = limit.saturating_sub(now + memory.gathering + SLACK_BYTES);
        let settings = bundle_settings(&built.atlas, Some(limit));
        let entries = settings.entries_within(left / 17 * 16, rayon::current_num_threads() as u64);
        bake.limit_entries(entries);
    }
    let estimate = if estimated {
        let job = context.job.clone();
        let tried = context.phase("plan", |_| bake.estimate(&job));
        Some(tried.map_err(failed)?)
    } else {
        None
    };
    let setup = Setup {
        loaded: &loaded,
        originals: &originals,
        pose: &pose,
        built: &built,
        texels: &texels,
        geometry: &geometry,
        gather,
        fingerprint,
        estimate,
        floor: bake.floor(&memory, with),
        peak: with(memory.peak()),
    };
    then(&setup, &bake, context)
}

/// Bakes the backs of two-sided surfaces whose fronts nobody sees.
fn turn_over(
    work: &WorkArgs,
    loaded: &Loaded,
    pose: &Pose,
    geometry: &Geometry,
    atlas: &mut Atlas,
    context: &Context,
) {
    /// Light that has been reflected more often than that decides nothing.
    const BOUNCES: u32 = 2;
    let sky = loaded.sky(work, GatherKind::Path);
    let lights = Lights::new(&loaded.scene, pose, sky.asked, LightSelection::Tree);
    let world = World {
        geometry,
        lights: &lights,
    };
    let settings = PathSettings {
        part: match work.light {
            LightPart::Ao => Part::Occlusion,
            _ => Part::All,
        },
        bounces: BOUNCES,
        luminous: sky.luminous,
        reach: f32::INFINITY,
        seed: context.common.seed,
        directional: false,
    };
    let turned = orient::turn_over(atlas, &world, &settings, &context.job);
    if turned > 0 {
        context.progress.note(&format!(
            "{turned} charts of two-sided surfaces show their back: that is baked (--sides front: not)"
        ));
    }
}

/// Hierarchy and flattened scene, a triangle.
const LEAST_BYTES_PER_TRIANGLE: u64 = 120;

/// Refuses work that needs at least `needed` bytes; says what density would fit, and who has most of the texels.
pub fn too_little_memory(
    needed: u64,
    limit: u64,
    work: &WorkArgs,
    loaded: &Loaded,
    atlas: &Atlas,
) -> CliError {
    // Texels go with the square of the density; the rest stays. Some more than what is missing: small charts do not shrink.
    let of_texels =
        u64::from(atlas.texels()) * Bake::least_bytes_per_texel(GatherKind::Bundles, &work.store());
    let left = of_texels.saturating_sub(needed.saturating_sub(limit) * 5 / 4);
    let fits = work.texels_per_metre * (left as f32 / of_texels.max(1) as f32).sqrt();
    let largest = subject::objects(loaded, atlas).into_iter().next();
    let largest = largest.map_or(String::new(), |(name, texels)| {
        let share = 100.0 * texels as f64 / f64::from(atlas.texels().max(1));
        format!(" ({name} has {share:.0} % of the texels)")
    });
    let cure = if fits > 0.1 * work.texels_per_metre {
        format!("raise it, or lower --texels-per-metre to {fits:.2}{largest}")
    } else {
        format!("raise it: the scene itself takes most of that{largest}")
    };
    let cure = match work.scratch {
        None => format!("{cure}; or keep light maps on disk with --scratch DIR"),
        Some(_) => cure,
    };
    let needed = needed.div_ceil(1 << 20);
    CliError::input(
        format_args!("the work needs at least {needed} MiB"),
        "--memory",
        cure,
    )
}

/// What the process takes that nobody counts: stacks, buffers of files, gaps between allocations.
const SLACK_BYTES: u64 = 8 << 20;
