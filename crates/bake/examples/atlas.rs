//! Builds the atlas of a scene, says what it is like and draws its charts: `atlas SCENE TEXELS_PER_METRE OUT.png [conformal]`.

use glam::Vec3;
use occlude_bake::atlas::{self, AtlasSettings, Layout, UnwrapKind, density};
use occlude_bake::texel::Texels;
use occlude_image::{Look, Picture, ToneMap};
use occlude_render::job::Job;
use occlude_scene::{Pose, Scene, procedural};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, path, texels_per_metre, out, rest @ ..] = arguments.as_slice() else {
        return Err(
            "usage: atlas SCENE|NAME TEXELS_PER_METRE OUT.png [conformal] [page size] [padding]"
                .into(),
        );
    };
    let scene = match path.parse::<procedural::Name>() {
        Ok(name) => procedural::build(name, None, 0),
        Err(_) => Scene::load(path.as_ref(), None, None)?,
    };
    let pose = Pose::at(&scene, 0.0);
    let mut settings = AtlasSettings::default();
    if rest.first().is_some_and(|kind| kind == "conformal") {
        settings.unwrap = UnwrapKind::Conformal;
    }
    if let Some(size) = rest.get(1) {
        settings.page_size = size.parse()?;
    }
    if let Some(padding) = rest.get(2) {
        settings.padding = padding.parse()?;
    }
    let densities = density::densities(&scene, &pose, texels_per_metre.parse()?);
    let start = Instant::now();
    let built = atlas::build(&scene, &pose, &densities, &settings, &Job::new())?;
    let seconds = start.elapsed().as_secs_f64();
    let atlas = &built.atlas;
    for problem in &built.problems {
        println!("{}: {}", problem.mesh, problem.what);
    }
    let charts = |l: &Layout| {
        l.charts
            .iter()
            .filter(|c| **c != Layout::NO_CHART)
            .max()
            .map_or(0, |c| c + 1)
    };
    let (mut count, mut slivers) = (0_u64, 0_u64);
    for layout in &atlas.layouts {
        let charts = charts(layout);
        count += u64::from(charts);
        let mut triangles = vec![0_u32; charts as usize];
        layout
            .charts
            .iter()
            .filter(|c| **c != Layout::NO_CHART)
            .for_each(|&c| triangles[c as usize] += 1);
        slivers += triangles.iter().filter(|&&t| t == 1).count() as u64;
    }
    let start = Instant::now();
    let texels = Texels::new(&scene, &pose, atlas);
    let (mut covered, mut fragments) = (0_u64, 0_u64);
    let mut pictures: Vec<Picture> = atlas
        .pages
        .iter()
        .map(|p| Picture::new(p.width, p.height))
        .collect();
    for (page, rows) in texels.bands(64) {
        let band = texels.band(page, rows);
        covered += band.len() as u64;
        for i in 0..band.len() {
            fragments += band.fragments(i).len() as u64;
            let f = band.fragments(i)[0];
            let layout = &atlas.layouts
                [atlas.placements[f.instance as usize].map_or(0, |p| p.layout) as usize];
            let chart = layout.charts[f.primitive as usize];
            let hue = (chart.wrapping_mul(2_654_435_769) >> 8) as f32 / 16_777_216.0
                + f.instance as f32 * 0.37;
            let color = Vec3::new(0.0, 0.33, 0.67) + hue;
            let color = (color.fract() * 6.0 - 3.0).abs() - 1.0;
            let local = band.texel(i) - atlas.pages[page as usize].first_texel;
            pictures[page as usize].pixels[local as usize] =
                (color.clamp(Vec3::ZERO, Vec3::ONE) * 0.8 + 0.1).to_array();
        }
    }
    println!(
        "{} triangles, {} layouts, {count} charts ({slivers} of one triangle), {} pages, {} texels, {:.1} % covered, {:.2} fragments each; \
         unwrapped and packed in {seconds:.2} s, rasterized in {:.2} s; {} MB of layouts",
        scene
            .meshes
            .iter()
            .map(|m| m.triangles.len())
            .sum::<usize>(),
        atlas.layouts.len(),
        atlas.pages.len(),
        atlas.texels(),
        100.0 * covered as f64 / f64::from(atlas.texels()),
        fragments as f64 / covered.max(1) as f64,
        start.elapsed().as_secs_f64(),
        atlas.bytes() / 1_000_000,
    );
    for (i, picture) in pictures.iter().enumerate() {
        let path = out.replace(".png", &format!("_{i}.png"));
        occlude_image::write(
            path.as_ref(),
            picture,
            Look {
                tone_map: ToneMap::None,
                exposure_ev: 0.0,
            },
        )?;
    }
    Ok(())
}
