//! Odd surfaces: UVs that scenes bring along, meshes that cannot be laid flat, walls that stand in floors, floors made of tiles.

use glam::{Affine3A, Vec2, Vec3, vec2, vec3};
use occlude_bake::atlas::{self, AtlasError, AtlasSettings, Built, density};
use occlude_bake::export::{self, ExportSettings, Insides, Light};
use occlude_bake::finish::orphans::adopt;
use occlude_bake::finish::seams::stitch;
use occlude_bake::finish::{Canvas, LEAST_VALIDITY};
use occlude_bake::texel::Texels;
use occlude_bake::texel::validity::{Solids, validity};
use occlude_bvh::BuildOptions;
use occlude_render::geometry::{Geometry, WorldTriangle};
use occlude_render::job::Job;
use occlude_scene::{Instance, Material, Mesh, Node, Pose, Scene};

/// A scene of Lambert meshes, each at its place.
fn scene(parts: Vec<(&str, Mesh, Vec3)>) -> Scene {
    let mut scene = Scene {
        materials: vec![Material::default().diffuse_only()],
        ..Scene::default()
    };
    for (name, mesh, place) in parts {
        scene.instances.push(Instance {
            mesh: scene.meshes.len() as u32,
            node: scene.nodes.len() as u32,
            node_from_object: Affine3A::IDENTITY,
            skin: None,
        });
        scene.nodes.push(Node {
            name: name.into(),
            parent: None,
            parent_from_node: Affine3A::from_translation(place),
        });
        scene.meshes.push(Mesh {
            name: name.into(),
            ..mesh
        });
    }
    scene
}

/// A square on the ground of side `side`, facing up, with these UVs for light maps.
fn square(side: f32, uv1: &[[f32; 2]]) -> Mesh {
    Mesh {
        positions: vec![
            Vec3::ZERO,
            vec3(0.0, 0.0, side),
            vec3(side, 0.0, side),
            vec3(side, 0.0, 0.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        uv1: uv1.iter().map(|&uv| Vec2::from(uv)).collect(),
        ..Mesh::default()
    }
}

/// A closed box.
fn block(low: Vec3, high: Vec3) -> Mesh {
    let positions = (0..8).map(|k| {
        Vec3::new(
            if k & 1 == 0 { low.x } else { high.x },
            if k & 2 == 0 { low.y } else { high.y },
            if k & 4 == 0 { low.z } else { high.z },
        )
    });
    let faces = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let triangles = faces
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    Mesh {
        positions: positions.collect(),
        triangles: triangles.collect(),
        ..Mesh::default()
    }
}

fn build(
    scene: &Scene,
    texels_per_metre: f32,
    page_size: u32,
) -> Result<(Pose, Built), AtlasError> {
    let pose = Pose::at(scene, 0.0);
    let densities = density::densities(scene, &pose, texels_per_metre);
    let settings = AtlasSettings {
        page_size,
        ..AtlasSettings::default()
    };
    let built = atlas::build(scene, &pose, &densities, &settings, &Job::new())?;
    Ok((pose, built))
}

#[test]
fn given_uvs_are_used_when_they_are_fit() {
    let whole = [[0.1, 0.1], [0.1, 0.9], [0.9, 0.9], [0.9, 0.1]];
    let (_, built) = build(
        &scene(vec![("floor", square(2.0, &whole), Vec3::ZERO)]),
        10.0,
        4096,
    )
    .unwrap();
    assert!(built.problems.is_empty(), "{:?}", built.problems);
    let (_, corners) = built.atlas.triangle(0, 0).unwrap();
    // 2 m at 10 texels a metre, in the order of the given UVs.
    assert!(
        (corners[1] - corners[0]).distance(vec2(0.0, 20.0)) < 0.5,
        "{corners:?}"
    );

    let outside = [[0.1, 0.1], [0.1, 0.9], [1.9, 0.9], [1.9, 0.1]];
    let folded = [[0.1, 0.1], [0.1, 0.9], [0.9, 0.9], [0.2, 0.8]];
    let point = [[0.1, 0.1], [0.1, 0.9], [0.1, 0.9], [0.9, 0.1]];
    for (uv, complaint) in [
        (outside, "outside"),
        (folded, "overlap"),
        (point, "no area"),
    ] {
        let (_, built) = build(
            &scene(vec![("floor", square(2.0, &uv), Vec3::ZERO)]),
            10.0,
            4096,
        )
        .unwrap();
        let [problem] = built.problems.as_slice() else {
            panic!("{:?}", built.problems)
        };
        assert!(
            problem.mesh == "floor" && problem.what.contains(complaint) && !problem.lost,
            "{problem:?}"
        );
        assert!(built.atlas.triangle(0, 0).is_some(), "new UVs are made");
    }

    // Two squares side by side in the UVs, a hundredth apart: good at many texels, bad at few.
    let mut two = square(1.0, &[[0.0, 0.0], [0.0, 0.49], [0.49, 0.49], [0.49, 0.0]]);
    let other = square(1.0, &[[0.5, 0.0], [0.5, 0.49], [0.99, 0.49], [0.99, 0.0]]);
    two.positions
        .extend(other.positions.iter().map(|p| *p + Vec3::Y));
    two.uv1.extend(&other.uv1);
    two.triangles
        .extend(other.triangles.iter().map(|t| t.map(|i| i + 4)));
    let of = |density| {
        build(
            &scene(vec![("two", two.clone(), Vec3::ZERO)]),
            density,
            4096,
        )
        .unwrap()
        .1
        .problems
    };
    let (coarse, middling, fine) = (of(10.0), of(75.0), of(300.0));
    assert!(
        coarse[0].what.contains("less than a texel apart"),
        "{coarse:?}"
    );
    assert!(middling[0].what.contains("may bleed"), "{middling:?}");
    assert!(fine.is_empty(), "{fine:?}");
}

#[test]
fn what_cannot_be_laid_flat_is_named_and_the_rest_goes_on() {
    let mut lines = square(1.0, &[]);
    lines.positions = vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::X * 3.0];
    let mut mixed = square(1.0, &[]);
    mixed.positions.push(vec3(0.5, 0.0, 0.5));
    mixed.positions.push(vec3(1e30, 1e30, 1e30));
    // A point, a line along the diagonal, one of absurd size, and the same triangle twice.
    mixed.triangles.extend([[0, 0, 0], [0, 4, 2], [0, 1, 2]]);
    let scene = scene(vec![
        ("lines", lines, Vec3::ZERO),
        ("mixed", mixed, Vec3::Y),
        ("floor", square(1.0, &[]), Vec3::ZERO),
    ]);
    let (pose, built) = build(&scene, 16.0, 4096).unwrap();
    let [problem] = built.problems.as_slice() else {
        panic!("{:?}", built.problems)
    };
    assert!(problem.mesh == "lines" && problem.lost, "{problem:?}");
    assert!(built.atlas.triangle(0, 0).is_none() && built.atlas.triangle(2, 1).is_some());
    assert!(
        built.atlas.triangle(1, 2).is_none(),
        "a triangle without area has no texels"
    );
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let covered: usize = texels
        .bands(16)
        .map(|(page, rows)| texels.band(page, rows).len())
        .sum();
    assert!(covered > 2 * 16 * 16);
    // Nothing at all.
    let nothing = Scene {
        materials: vec![Material::default()],
        ..Scene::default()
    };
    assert_eq!(
        build(&nothing, 16.0, 4096).unwrap_err(),
        AtlasError::Nothing
    );
}

#[test]
fn too_large_objects_are_blamed_with_what_would_fit() {
    let parts = || {
        scene(vec![
            ("field", square(1000.0, &[]), Vec3::ZERO),
            ("hut", square(50.0, &[]), Vec3::Y),
        ])
    };
    let error = build(&parts(), 8.0, 1024).unwrap_err();
    let AtlasError::LargerThanPage { object, fits, .. } = &error else {
        panic!("{error:?}")
    };
    assert!(object == "field" && (0.9..1.024).contains(fits), "{error}");
    assert!(build(&parts(), *fits, 1024).is_ok());
}

#[test]
fn seams_between_tiles_close() {
    let tile = || square(2.0, &[]);
    let scene = scene(
        (0..4)
            .map(|i| {
                (
                    "tile",
                    tile(),
                    vec3(2.0 * (i % 2) as f32, 0.0, 2.0 * (i / 2) as f32),
                )
            })
            .collect(),
    );
    let (pose, built) = build(&scene, 8.0, 4096).unwrap();
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let mut canvas = Canvas::new(&texels, 0);
    for (page, rows) in texels.bands(16) {
        let band = texels.band(page, rows);
        for i in 0..band.len() {
            // A gradient, and an error of each tile's own.
            let hit = texels.representative(&band, i);
            let p =
                WorldTriangle::new(&scene, &pose, hit.instance, hit.primitive).point(hit.u, hit.v);
            let value = 2.0 + 0.3 * p.x + 0.1 * hit.instance as f32;
            canvas.values[band.texel(i) as usize] = [value, 0.5 * value, 1.0];
        }
    }
    canvas.dilate(2);
    let mean = |c: &Canvas| {
        c.values
            .iter()
            .zip(&c.charts)
            .filter(|(_, c)| **c != 0)
            .map(|(v, _)| f64::from(v[0]))
            .sum::<f64>()
    };
    let before = mean(&canvas);
    let mut canvases = vec![(0, canvas)];
    let stitched = stitch(&texels, &mut canvases, None);
    // Four inner edges of 16 texels.
    assert!((60..=80).contains(&stitched.points), "{stitched:?}");
    assert!(
        stitched.before > 0.05 && stitched.after < 0.06 * stitched.before,
        "{stitched:?}"
    );
    assert!(
        (mean(&canvases[0].1) / before - 1.0).abs() < 1e-3,
        "energy is kept"
    );
    assert!(
        canvases[0]
            .1
            .values
            .iter()
            .zip(&canvases[0].1.charts)
            .all(|(v, c)| *c == 0 || (v[2] - 1.0).abs() < 1e-5),
        "what agrees stays"
    );
}

#[test]
fn seams_below_a_thin_wall_stay_open() {
    // Two floor tiles that meet below a wall of a millimetre; it ends halfway along.
    let tile = || square(2.0, &[]);
    let wall = block(vec3(1.9995, -0.1, -1.0), vec3(2.0005, 1.0, 1.0));
    let scene = scene(vec![
        ("left", tile(), Vec3::ZERO),
        ("right", tile(), Vec3::X * 2.0),
        ("wall", wall, Vec3::ZERO),
    ]);
    let (pose, built) = build(&scene, 8.0, 4096).unwrap();
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
    let covered = covered(&scene, &pose, &texels);
    let mut canvas = Canvas::new(&texels, 0);
    // Bright on the left, dark on the right.
    for (value, covered) in canvas.values.iter_mut().zip(&covered) {
        *value = [f32::from(u8::from(covered.is_some_and(|c| c.1 == 0))); 3];
    }
    let mut canvases = vec![(0, canvas)];
    let stitched = stitch(&texels, &mut canvases, Some(&geometry));
    // 16 texels of seam, and half of them stand free.
    assert!((7..=9).contains(&stitched.points), "{stitched:?}");
    let (mut behind, mut beyond) = (0.0_f32, 0.0_f32);
    for (value, covered) in canvases[0].1.values.iter().zip(&covered) {
        if let Some((_, 1, place)) = covered {
            let light = if place.z < 0.8 {
                &mut behind
            } else {
                &mut beyond
            };
            *light = light.max(value[0]);
        }
    }
    assert!(behind < 0.02 && beyond > 0.3, "{behind} {beyond}");
}

/// Light is 1 outside of a box that stands in the floor, and 0 inside.
struct OutsideLight(Vec<f32>);

impl Light for OutsideLight {
    fn irradiance(&self, texel: u32) -> [f32; 3] {
        [self.0[texel as usize]; 3]
    }
}

#[test]
fn sunken_walls_leave_no_dark_rim() {
    // The box ends between texel borders.
    let (low, high) = (vec3(1.03, -0.5, 1.21), vec3(2.17, 2.0, 2.66));
    let scene = scene(vec![
        ("floor", square(4.0, &[]), Vec3::ZERO),
        ("wall", block(low, high), Vec3::ZERO),
    ]);
    let (pose, built) = build(&scene, 8.0, 4096).unwrap();
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let geometry = Geometry::new(&scene, &pose, &BuildOptions::default()).unwrap();
    let solids = Solids::of(&scene);
    let shares = validity(&geometry, &texels, &solids, 0);
    let inside = |p: Vec3| p.cmpgt(low).all() && p.cmplt(high).all();
    let mut light = vec![0.0; built.atlas.texels() as usize];
    let (mut partly, mut worst) = (0, 0.0_f32);
    for (page, rows) in texels.bands(16) {
        let band = texels.band(page, rows);
        for i in 0..band.len() {
            let points = 400;
            let outside = (0..points).filter(|k| {
                let hit = texels.sample(
                    &band,
                    i,
                    vec2(
                        (*k as f32 + 0.5) / points as f32,
                        (*k as f32 * 0.618_034).fract(),
                    ),
                );
                let p = WorldTriangle::new(&scene, &pose, hit.instance, hit.primitive)
                    .point(hit.u, hit.v);
                hit.instance != 0 || !inside(p)
            });
            let exact = outside.count() as f32 / points as f32;
            light[band.texel(i) as usize] = exact;
            let found = shares[band.texel(i) as usize];
            partly += u32::from(found > 0.0 && found < 1.0);
            // The two first points may miss what is less than a third of a texel.
            if exact < 0.6 {
                worst = worst.max((found - exact).abs());
            }
        }
    }
    assert!(
        partly > 20 && worst < 0.12,
        "{partly} texels are partly inside; {worst}"
    );
    let out = std::env::temp_dir().join(format!("occlude-sunken-{}", std::process::id()));
    std::fs::create_dir_all(&out).unwrap();
    let insides = Insides {
        geometry: &geometry,
        solids: &solids,
    };
    let settings = ExportSettings {
        dilate: 2,
        ..ExportSettings::default()
    };
    export::write(
        &out,
        &texels,
        &OutsideLight(light),
        Some(insides),
        &[],
        &settings,
        None,
        &Job::new(),
    )
    .unwrap();
    let page = occlude_image::read(&out.join("lightmap_000.exr"), &Default::default())
        .unwrap()
        .picture;
    let canvas = Canvas::new(&texels, 0);
    let darkest = page
        .pixels
        .iter()
        .zip(&canvas.charts)
        .filter(|(_, c)| **c != 0)
        .map(|(v, _)| v[0])
        .fold(1.0, f32::min);
    assert!(darkest > 0.6, "{darkest}");
    std::fs::remove_dir_all(out).unwrap();
}

/// By texel of the first page: the share of its square that is covered, and the point that stands for it.
fn covered(scene: &Scene, pose: &Pose, texels: &Texels) -> Vec<Option<(f32, u32, Vec3)>> {
    let mut all = vec![None; texels.atlas.pages[0].texels() as usize];
    for (page, rows) in texels.bands(16) {
        let band = texels.band(page, rows);
        for i in 0..band.len() {
            let share = band.fragments(i).iter().map(|f| f.area).sum();
            let hit = texels.representative(&band, i);
            let world = WorldTriangle::new(scene, pose, hit.instance, hit.primitive);
            let place = world.point(hit.u, hit.v);
            all[band.texel(i) as usize] = Some((share, hit.instance, place));
        }
    }
    all
}

#[test]
fn rims_that_are_hardly_covered_take_the_values_beside_them() {
    // A wedge: its long side cuts texels into all kinds of rests.
    let wedge = Mesh {
        positions: vec![Vec3::ZERO, vec3(0.0, 0.0, 7.3), vec3(23.0, 0.0, 0.0)],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    };
    let scene = scene(vec![("wedge", wedge, Vec3::ZERO)]);
    let (pose, built) = build(&scene, 1.0, 64).unwrap();
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let covered = covered(&scene, &pose, &texels);
    let covered = &covered;
    let share = move |i: usize| covered[i].map_or(0.0, |c| c.0);
    // Below this a texel is distrusted if a neighbour has four times as much.
    let finished = |least: f32| {
        let mut canvas = Canvas::new(&texels, 0);
        for i in 0..covered.len() {
            canvas.values[i] = [if share(i) < least { 100.0 } else { 1.0 }; 3];
        }
        canvas.distrust_rims(&texels, 0, least);
        let filled = canvas.fill_invalid();
        let invalid = canvas.validity.iter().filter(|&&v| v < LEAST_VALIDITY);
        assert_eq!(filled, invalid.count() as u64);
        let bright =
            (0..covered.len()).filter(|&i| covered[i].is_some() && canvas.values[i][0] > 1.0);
        (filled, bright.count())
    };
    let width = built.atlas.pages[0].width as i64;
    let thin = |least: f32| {
        let around = move |i: usize| {
            let all = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
            all.map(move |(dx, dy)| (i as i64 + dy * width + dx) as usize)
        };
        // The wedge ends before the page does, so rows do not run into each other.
        (0..covered.len())
            .filter(move |&i| covered[i].is_some() && share(i) < least)
            .filter(move |&i| {
                around(i).any(|n| n < covered.len() && share(n) >= (4.0 * share(i)).max(least))
            })
            .count() as u64
    };
    let all = (0..covered.len()).filter(|&i| covered[i].is_some() && share(i) < 0.2);
    let (all, count) = (all.count() as u64, thin(0.2));
    assert!(count >= 6, "{count} rims");
    assert_eq!(finished(0.2), (count, (all - count) as usize));
    assert_eq!(finished(1e-6), (0, 0));

    // A strip of which no texel has much has nobody to ask.
    let mut strip = square(1.0, &[]);
    strip
        .positions
        .iter_mut()
        .for_each(|p| *p *= vec3(6.0, 1.0, 0.03));
    let strip = self::scene(vec![("strip", strip, Vec3::ZERO)]);
    let (pose, built) = build(&strip, 1.0, 64).unwrap();
    let texels = Texels::new(&strip, &pose, &built.atlas);
    let mut canvas = Canvas::new(&texels, 0);
    canvas.distrust_rims(&texels, 0, 0.25);
    let inner = self::covered(&strip, &pose, &texels);
    let inner = inner.iter().flatten().filter(|c| c.0 > 0.02).count();
    let valid =
        (canvas.charts.iter().zip(&canvas.validity)).filter(|(c, v)| **c != 0 && **v == 1.0);
    assert!(inner >= 4 && valid.count() >= inner, "{inner}");
}

#[test]
fn charts_that_no_line_met_take_the_light_of_what_is_near() {
    // One mesh of two floors and a crumb above the second, near its edge; another mesh is nearer to the crumb still.
    let mut mesh = Mesh::default();
    let parts = [
        (4.0, Vec3::ZERO),
        (4.0, Vec3::X * 10.0),
        (0.2, vec3(10.1, 0.1, 2.0)),
    ];
    for (side, place) in parts {
        let first = mesh.positions.len() as u32;
        let part = square(side, &[]);
        mesh.positions
            .extend(part.positions.iter().map(|p| *p + place));
        mesh.triangles
            .extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    let scene = scene(vec![
        ("floors", mesh, Vec3::ZERO),
        ("other", square(0.3, &[]), vec3(10.1, 0.12, 2.0)),
    ]);
    let (pose, built) = build(&scene, 2.0, 64).unwrap();
    let texels = Texels::new(&scene, &pose, &built.atlas);
    let covered = covered(&scene, &pose, &texels);
    let mut canvas = Canvas::new(&texels, 0);
    for (i, value) in canvas.values.iter_mut().enumerate() {
        *value = [i as f32; 3];
    }
    let before = canvas.clone();
    assert_eq!(adopt(&texels, 0, &mut canvas), 0);
    assert_eq!(canvas, before, "all charts have valid texels");

    let is_crumb = |c: &(f32, u32, Vec3)| c.1 == 0 && (c.2.y - 0.1).abs() < 1e-3;
    let crumbs: Vec<usize> = (0..covered.len())
        .filter(|&i| covered[i].as_ref().is_some_and(is_crumb))
        .collect();
    assert!(!crumbs.is_empty());
    crumbs.iter().for_each(|&i| canvas.validity[i] = 0.0);
    assert_eq!(canvas.fill_invalid(), 0, "nobody of their chart knows");
    assert_eq!(adopt(&texels, 0, &mut canvas), crumbs.len() as u64);
    for &crumb in &crumbs {
        let parent = canvas.values[crumb][0] as usize;
        let away = |i: usize| covered[i].unwrap().2.distance(covered[crumb].unwrap().2);
        let known = (0..covered.len())
            .filter(|&i| covered[i].is_some_and(|c| c.1 == 0) && !crumbs.contains(&i));
        let nearest = known.map(away).fold(f32::INFINITY, f32::min);
        assert!(covered[parent].unwrap().1 == 0 && !crumbs.contains(&parent));
        assert!((away(parent) - nearest).abs() < 1e-6, "{parent} of {crumb}");
    }

    // Where nothing of an instance is known, all stays as it is.
    let mut lost = before.clone();
    for (i, validity) in lost.validity.iter_mut().enumerate() {
        if covered[i].is_some_and(|c| c.1 == 0) {
            *validity = 0.0;
        }
    }
    assert_eq!(adopt(&texels, 0, &mut lost), 0);
    assert_eq!(lost.values, before.values);
}
