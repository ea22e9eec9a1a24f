//! From options to the settings of a bake, and the number that tells works apart.

use super::args::{DirectionalName, LightPart, WorkArgs};
use super::subject::Loaded;
use crate::VERSION;
use crate::context::Context;
use occlude_bake::atlas::Atlas;
use occlude_bake::bundle;
use occlude_bake::gather::Part;
use occlude_bake::rounds::{GatherKind, MOST_COUNTED, SPOTS, Settings};
use occlude_scene::Pose;

pub fn settings(
    work: &WorkArgs,
    atlas: &Atlas,
    gather: GatherKind,
    seed: u64,
    limit: Option<u64>,
) -> Settings {
    Settings {
        gather,
        part: match work.light {
            LightPart::All => Part::All,
            LightPart::Direct => Part::Direct,
            LightPart::Indirect => Part::Indirect,
            LightPart::Ao => Part::Occlusion,
        },
        bounces: work.bounces,
        directions: work.total_directions().min(MOST_COUNTED),
        reach: work.ao_distance.unwrap_or(f32::INFINITY),
        seed,
        spots: SPOTS,
        directional: work.directional != DirectionalName::None,
        bundles: bundle_settings(atlas, limit),
    }
}

/// How bundles are cut into tiles: a matter of the texels and of the memory limit alone.
pub fn bundle_settings(atlas: &Atlas, limit: Option<u64>) -> bundle::Settings {
    let settings = limit.map_or_else(bundle::Settings::default, bundle::Settings::for_limit);
    // As many pixels as texels: a finer analysis costs more than what it knows is worth.
    let useful = (f64::from(atlas.texels()).sqrt() as u32).next_power_of_two();
    bundle::Settings {
        analysis: useful.max(LEAST_ANALYSIS).min(settings.analysis),
        ..settings
    }
}

/// Pixels along a side of the analysis of bundles at least.
const LEAST_ANALYSIS: u32 = 64;

/// A number for everything that the sums depend on.
pub fn fingerprint(
    work: &WorkArgs,
    loaded: &Loaded,
    pose: &Pose,
    atlas: &Atlas,
    gather: GatherKind,
    context: &Context,
) -> u64 {
    let text = format!(
        "{:?}",
        (
            VERSION,
            settings(
                work,
                atlas,
                gather,
                context.common.seed,
                context.common.memory
            ),
            work.texels_per_metre,
            (work.pages_max, work.padding, work.unwrap, work.sides),
            &work.select,
            work.sky.environment_rotation,
            work.sky.environment_scale,
        )
    );
    let mut hash = occlude_scene::fingerprint(&loaded.scene, pose);
    // FNV-1a: tells works apart, not forgers.
    let mut byte = |byte: u8| hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    text.bytes().for_each(&mut byte);
    if let Some(sky) = &loaded.picture {
        sky.pixels
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes())
            .for_each(&mut byte);
    }
    hash
}
