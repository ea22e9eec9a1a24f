//! `occlude plan`: what a bake would take.

use super::PlanArgs;
use super::setup::prepared;
use super::subject;
use crate::context::Context;
use crate::error::CliError;
use occlude_bake::rounds::GatherKind;
use serde_json::json;

/// Runs `occlude plan`.
pub fn plan(args: &PlanArgs, context: &mut Context) -> Result<(), CliError> {
    args.work.check()?;
    prepared(&args.work, context, true, |setup, bake, context| {
        let planned = setup.estimate.clone().unwrap_or_default();
        let tried = context
            .stats
            .seconds
            .phases
            .get("plan")
            .copied()
            .unwrap_or(0.0);
        let so_far = context.began().elapsed().as_secs_f64() - tried;
        let atlas = &setup.built.atlas;
        let texels = u64::from(atlas.texels());
        let writing = texels as f64 * SECONDS_PER_TEXEL_WRITTEN;
        let per_texel = bake.memory(0).gathering / u64::from(bake.sides().max(1));
        let objects = subject::objects(setup.loaded, atlas);
        let gather = match setup.gather {
            GatherKind::Path => "path",
            GatherKind::Bundles => "bundles",
        };
        let seconds = so_far + planned.seconds() + writing;
        let directions = bake.rounds().last().map_or(0, |round| round.total);
        if args.json {
            let objects: Vec<_> = objects
                .iter()
                .map(|(name, texels)| json!({"node": name, "texels": texels, "bytes": texels * per_texel}))
                .collect();
            let rounds: Vec<_> = bake
                .rounds()
                .iter()
                .zip(&planned.rounds)
                .map(|(round, seconds)| json!({"name": round.name, "items": round.total, "seconds": seconds}))
                .collect();
            let plan = json!({
                "texels": texels, "pages": atlas.pages.len(), "directions": directions, "gather": gather,
                "floor_bytes": setup.floor, "peak_bytes": setup.peak, "seconds": seconds, "rays": planned.rays,
                "rounds": rounds, "objects": objects,
            });
            println!("{plan:#}");
            return Ok(());
        }
        let mib = |bytes: u64| bytes.div_ceil(1 << 20);
        println!("texels      {texels} on {} pages", atlas.pages.len());
        println!("gather      {gather}, {directions} directions");
        println!(
            "memory      {} MiB; at least {} MiB",
            mib(setup.peak),
            mib(setup.floor)
        );
        println!("time        {seconds:.0} s on this machine");
        for (round, seconds) in bake.rounds().iter().zip(&planned.rounds) {
            println!("  {:<14}{} items, {seconds:.1} s", round.name, round.total);
        }
        println!("largest objects");
        for (name, texels) in objects.iter().take(LISTED_OBJECTS) {
            println!("  {texels:>10} texels  {name}");
        }
        Ok(())
    })
}

/// Finishing and encoding a texel.
const SECONDS_PER_TEXEL_WRITTEN: f64 = 0.5e-6;

/// Objects that `plan` lists for people.
const LISTED_OBJECTS: usize = 10;
