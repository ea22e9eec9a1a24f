//! Pictures against path-traced direct light of the same lobes.

use super::super::{Integrator, PathLimits, RenderSettings, Sequence, World};
use super::*;
use crate::camera::PixelFilter;
use crate::geometry::Geometry;
use crate::light::{Environment, LightSelection};
use crate::sampling::SamplerKind;
use glam::{Affine3A, Quat};
use occlude_bvh::BuildOptions;
use occlude_image::Picture;
use occlude_scene::{
    AlphaMode, Image, Instance, Material, Mesh, Node, Pose, Scene, Texels, Texture, TextureRef,
};
use occlude_visibility::Exact;
use occlude_visibility::field::SphericalGaussian;

fn lobe(axis: [f32; 3], sharpness: f32, amplitude: [f32; 3]) -> SphericalGaussian {
    SphericalGaussian {
        axis: Vec3::from(axis).normalize(),
        sharpness,
        amplitude: Vec3::from(amplitude),
    }
}

fn sky(lobes: &[SphericalGaussian]) -> SkyLobes {
    SkyLobes {
        lobes: lobes.to_vec(),
        ..SkyLobes::default()
    }
}

/// The lobes as a map.
fn environment(sky: &SkyLobes) -> Environment {
    let (width, height) = (256, 128);
    let pixel = |i: u32| {
        let theta = std::f32::consts::PI * ((i / width) as f32 + 0.5) / height as f32;
        let phi = std::f32::consts::TAU * (((i % width) as f32 + 0.5) / width as f32 - 0.5);
        let w = Vec3::new(
            theta.sin() * phi.cos(),
            theta.cos(),
            theta.sin() * phi.sin(),
        );
        sky.lobes
            .iter()
            .map(|lobe| lobe.at(w))
            .sum::<Vec3>()
            .to_array()
    };
    let picture = Picture {
        width,
        height,
        pixels: (0..width * height).map(pixel).collect(),
    };
    Environment::from_picture(&picture, 0.0, 1.0)
}

fn ball(radius: f32, columns: u32) -> Mesh {
    let rows = columns / 2;
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..columns {
            let theta = std::f32::consts::PI * row as f32 / rows as f32;
            let phi = std::f32::consts::TAU * column as f32 / columns as f32;
            let n = Vec3::new(
                theta.sin() * phi.cos(),
                theta.cos(),
                theta.sin() * phi.sin(),
            );
            mesh.positions.push(n * radius);
            mesh.normals.push(n);
        }
    }
    for row in 0..rows {
        for c in 0..columns {
            let (a, b) = (row * columns + c, row * columns + (c + 1) % columns);
            mesh.triangles
                .extend([[a, b, a + columns], [b, b + columns, a + columns]]);
        }
    }
    mesh
}

fn floor(half: f32) -> Mesh {
    Mesh {
        positions: [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
            .map(|[x, z]| Vec3::new(x * half, 0.0, z * half))
            .to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

fn add(scene: &mut Scene, mesh: Mesh, at: Vec3, material: Material) {
    let index = scene.meshes.len() as u32;
    scene.nodes.push(Node {
        name: String::new(),
        parent: None,
        parent_from_node: Affine3A::from_translation(at),
    });
    scene.materials.push(material);
    scene.meshes.push(Mesh {
        material: index,
        ..mesh
    });
    scene.instances.push(Instance {
        mesh: index,
        node: index,
        node_from_object: Affine3A::IDENTITY,
        skin: None,
    });
}

fn material(color: [f32; 3], roughness: f32, metallic: f32) -> Material {
    Material {
        base_color: Vec3::from(color).extend(1.0),
        roughness,
        metallic,
        ..Material::default()
    }
}

/// Two balls on a floor.
fn still_life(roughness: f32) -> Scene {
    let mut scene = Scene::default();
    let grey = material([0.5, 0.45, 0.4], 0.6, 0.0);
    add(&mut scene, floor(2.0), Vec3::ZERO, grey);
    let red = material([0.8, 0.3, 0.2], 1.0, 0.0);
    add(&mut scene, ball(0.4, 48), Vec3::new(-0.6, 0.4, 0.0), red);
    let metal = material([0.9, 0.8, 0.6], roughness, 1.0);
    add(&mut scene, ball(0.3, 48), Vec3::new(0.4, 0.3, 0.4), metal);
    scene
}

fn view(width: u32, height: u32) -> View {
    let (eye, target) = (Vec3::new(0.4, 1.5, 2.6), Vec3::new(0.0, 0.25, 0.0));
    View::look_at(eye, target, 0.7, width, height).unwrap()
}

struct Shot {
    pixels: Vec<[f32; 3]>,
    report: RenderReport,
}

fn settings(integrator: Integrator, samples: u32) -> RenderSettings {
    RenderSettings {
        integrator,
        sampler: SamplerKind::Sobol,
        filter: PixelFilter::Box,
        seed: 0,
        samples: 0..samples,
        time_limit: None,
        noise: None,
    }
}

fn shoot(
    sequence: &mut Sequence,
    scene: &Scene,
    pose: &Pose,
    sky: &SkyLobes,
    view: &View,
    settings: &RenderSettings,
) -> Shot {
    let geometry = Geometry::new(scene, pose, &BuildOptions::default()).unwrap();
    let lights = Lights::new(scene, pose, Some(environment(sky)), LightSelection::Tree);
    let world = World {
        geometry: &geometry,
        lights: &lights,
    };
    let mut film = Film::new(view.width(), view.height(), false);
    let job = Job::new();
    sequence.set_sky(sky.clone());
    let report = sequence.render(&world, view, &Exact, settings, &mut film, &job, &mut |_| ());
    Shot {
        pixels: film.develop().radiance,
        report,
    }
}

fn field(scene: &Scene, sky: &SkyLobes, view: &View, field: Field) -> Shot {
    let settings = settings(Integrator::Field(field), 1);
    shoot(
        &mut Sequence::default(),
        scene,
        &Pose::at(scene, 0.0),
        sky,
        view,
        &settings,
    )
}

fn path(scene: &Scene, sky: &SkyLobes, view: &View, samples: u32) -> Shot {
    let settings = settings(Integrator::Path(PathLimits::new(1)), samples);
    shoot(
        &mut Sequence::default(),
        scene,
        &Pose::at(scene, 0.0),
        sky,
        view,
        &settings,
    )
}

/// Sums, and the mean squared difference relative to the reference's mean squared value.
fn compare(a: &Shot, b: &Shot) -> (f32, f32) {
    let flat = |shot: &Shot| -> Vec<f32> { shot.pixels.iter().flatten().copied().collect() };
    let (a, b) = (flat(a), flat(b));
    let energy = a.iter().sum::<f32>() / b.iter().sum::<f32>() - 1.0;
    let wrong: f32 = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum();
    (energy, wrong / b.iter().map(|b| b * b).sum::<f32>())
}

#[test]
fn pictures_are_those_of_path_tracing() {
    let soft = sky(&[
        lobe([0.0, 1.0, 0.0], 0.8, [0.25, 0.3, 0.4]),
        lobe([1.0, 0.7, 0.3], 8.0, [2.0, 1.6, 1.2]),
        lobe([-0.6, 0.5, 0.6], 12.0, [0.5, 0.8, 1.3]),
    ]);
    let hard = sky(&[
        lobe([0.0, 1.0, 0.0], 0.8, [0.25, 0.3, 0.4]),
        lobe([1.0, 0.7, 0.3], 60.0, [8.0, 7.0, 5.0]),
        lobe([-0.3, 0.8, -0.6], 200.0, [12.0, 12.0, 14.0]),
    ]);
    let view = view(80, 60);
    for (name, sky, roughness) in [("soft", soft, 0.5), ("hard", hard, 0.35)] {
        let scene = still_life(roughness);
        let ours = field(&scene, &sky, &view, Field::default());
        let theirs = path(&scene, &sky, &view, 256);
        let (energy, wrong) = compare(&ours, &theirs);
        let report = ours.report.field.unwrap();
        println!("{name}: energy {energy:+.4}, relative squares {wrong:.5}, {report:?}");
        assert!(energy.abs() < 0.02, "{name}: energy {energy:+.4}");
        // Edges of pixels and 5 pixels between points at this size, the hemisphere approximation, and some noise of the reference.
        assert!(wrong < 0.006, "{name}: {wrong}");
        assert!(report.rays < report.points * 128 * 128 / 4);
    }
}

/// Distances that pixels share make the picture that each pixel's own make.
#[test]
fn pixels_share_distances() {
    let sky = sky(&[
        lobe([0.0, 1.0, 0.0], 0.8, [0.25, 0.3, 0.4]),
        lobe([1.0, 0.7, 0.3], 60.0, [8.0, 7.0, 5.0]),
        lobe([-0.3, 0.8, -0.6], 200.0, [12.0, 12.0, 14.0]),
    ]);
    let view = view(160, 120);
    for roughness in [0.2, 0.35, 0.6] {
        let scene = still_life(roughness);
        let shared = field(&scene, &sky, &view, Field::default());
        let alone = Field {
            shared: false,
            ..Field::default()
        };
        let (energy, wrong) = compare(&shared, &field(&scene, &sky, &view, alone));
        println!("{roughness}: energy {energy:+.5}, relative squares {wrong:.6}");
        assert!(energy.abs() < 0.002 && wrong < 2e-4, "{energy} {wrong}");
        assert!(wrong > 0.0, "nothing was shared");
    }
}

fn hard_sky() -> SkyLobes {
    sky(&[
        lobe([0.0, 1.0, 0.0], 0.8, [0.25, 0.3, 0.4]),
        lobe([1.0, 0.7, 0.3], 60.0, [8.0, 7.0, 5.0]),
        lobe([-0.3, 0.8, -0.6], 200.0, [12.0, 12.0, 14.0]),
    ])
}

/// Integrals over cells of the fields need no hemisphere approximation: at least as near to path tracing.
#[test]
fn cells_are_no_worse_than_their_approximation() {
    let (scene, sky, view) = (still_life(0.35), hard_sky(), view(32, 24));
    let reference = path(&scene, &sky, &view, 256);
    let cells = Field {
        cells: true,
        ..Field::default()
    };
    let (_, rough) = compare(&field(&scene, &sky, &view, Field::default()), &reference);
    let (energy, wrong) = compare(&field(&scene, &sky, &view, cells), &reference);
    println!("energy {energy:+.4}, relative squares {wrong:.5}, by approximation {rough:.5}");
    assert!(
        energy.abs() < 0.02 && wrong < 1.1 * rough,
        "{energy} {wrong} {rough}"
    );
}

/// Packed fields take less than 8 KiB a point with their maps, and hardly show.
#[test]
fn packed_fields_hardly_show() {
    let (scene, sky, view) = (still_life(0.35), hard_sky(), view(80, 60));
    let packed = Field {
        packed: true,
        ..Field::default()
    };
    let ours = field(&scene, &sky, &view, packed);
    let (energy, wrong) = compare(&ours, &field(&scene, &sky, &view, Field::default()));
    println!("energy {energy:+.5}, relative squares {wrong:.6}");
    assert!(energy.abs() < 0.003 && wrong < 1e-3, "{energy} {wrong}");
    let report = ours.report.field.unwrap();
    assert!(report.bytes > 0 && report.bytes <= report.all_points * 8192);
}

/// One bounce of diffuse light is what path tracing adds with its second event.
#[test]
fn a_bounce_is_the_second_event() {
    let mut scene = still_life(1.0);
    for material in &mut scene.materials {
        (material.metallic, material.specular, material.roughness) = (0.0, 0.0, 1.0);
    }
    let sky = sky(&[lobe([0.3, 1.0, 0.2], 2.0, [1.0; 3])]);
    let view = view(48, 36);
    let bounce = Field {
        bounce: 512,
        ..Field::default()
    };
    let ours = field(&scene, &sky, &view, bounce);
    let limits = settings(Integrator::Path(PathLimits::new(2)), 512);
    let pose = Pose::at(&scene, 0.0);
    let theirs = shoot(
        &mut Sequence::default(),
        &scene,
        &pose,
        &sky,
        &view,
        &limits,
    );
    let (without, _) = compare(&field(&scene, &sky, &view, Field::default()), &theirs);
    let (energy, wrong) = compare(&ours, &theirs);
    println!("energy {energy:+.4} (without {without:+.4}), relative squares {wrong:.5}");
    assert!(
        without < -0.03,
        "the scene has no light to bounce: {without}"
    );
    assert!(energy.abs() < 0.015 && wrong < 0.006, "{energy} {wrong}");
}

/// Contact rays bring back what few points do not see.
#[test]
fn contact_rays_find_what_points_miss() {
    let (scene, view) = (still_life(1.0), view(64, 48));
    let sky = sky(&[lobe([0.0, 1.0, 0.0], 1.0, [1.0; 3])]);
    let few = Field {
        most_points: 64,
        ..Field::default()
    };
    let touching = Field { contact: 64, ..few };
    let reference = path(&scene, &sky, &view, 256);
    let (_, without) = compare(&field(&scene, &sky, &view, few), &reference);
    let (_, with) = compare(&field(&scene, &sky, &view, touching), &reference);
    println!("relative squares {without:.5} without, {with:.5} with");
    assert!(with < 0.8 * without, "{with} {without}");
}

/// A lamp as lobes behind maps of its own casts the shadows of path tracing, and is no occluder itself.
#[test]
fn lamps_cast_shadows() {
    let mut scene = still_life(0.4);
    let mut panel = floor(0.35);
    panel.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let lamp = Material {
        emission: Vec3::new(20.0, 18.0, 15.0),
        ..material([0.0; 3], 1.0, 0.0)
    };
    add(&mut scene, panel, Vec3::new(0.2, 1.8, 0.1), lamp);
    // A ceiling close above it, which is behind the lamp for all below.
    let ceiling = material([0.5; 3], 1.0, 0.0);
    add(&mut scene, floor(3.0), Vec3::new(0.0, 1.85, 0.0), ceiling);
    let sky = sky(&[lobe([0.0, 0.2, 1.0], 2.0, [0.2; 3])]);
    let view = view(80, 60);
    let reference = path(&scene, &sky, &view, 1024);
    let (energy, wrong) = compare(&field(&scene, &sky, &view, Field::default()), &reference);
    let rays = Field {
        lamps: false,
        light_samples: 64,
        ..Field::default()
    };
    let (by_rays, limit) = compare(&field(&scene, &sky, &view, rays), &reference);
    println!(
        "energy {energy:+.4} ({by_rays:+.4} by rays), relative squares {wrong:.5} ({limit:.5} by rays)"
    );
    // Where surfaces gloss a lamp is a round lobe without edges: 0.0142 where 64 rays a pixel leave 0.0030.
    assert!(energy.abs() < 0.03 && wrong < 0.016, "{energy} {wrong}");
    for material in &mut scene.materials {
        (material.metallic, material.specular, material.roughness) = (0.0, 0.0, 1.0);
    }
    let reference = path(&scene, &sky, &view, 1024);
    let (energy, wrong) = compare(&field(&scene, &sky, &view, Field::default()), &reference);
    println!("matt: energy {energy:+.4}, relative squares {wrong:.5}");
    // One straight edge stands for the balls' outlines: 0.0066, and 1 % too dark.
    assert!(energy.abs() < 0.015 && wrong < 0.008, "{energy} {wrong}");
}

/// What a mask cuts out blocks nothing: a picture of leaves' shadows is that of path tracing.
#[test]
fn masks_let_light_pass() {
    let mut scene = still_life(1.0);
    let mut leaf = floor(1.2);
    leaf.uv0 = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]
        .map(Vec2::from_array)
        .to_vec();
    let texels = (0..32 * 32_u32).map(|i| {
        let hole = (i % 32 / 8 + i / 32 / 8).is_multiple_of(2);
        [90, 140, 60, if hole { 0 } else { 255 }]
    });
    scene.images.push(Image {
        name: String::new(),
        width: 32,
        height: 32,
        texels: Texels::Rgba8(texels.collect()),
    });
    scene.textures.push(Texture {
        image: 0,
        sampler: occlude_scene::Sampler::default(),
        srgb: true,
    });
    let masked = Material {
        base_color_texture: Some(TextureRef {
            texture: 0,
            uv_set: 0,
            transform: glam::Affine2::IDENTITY,
        }),
        alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
        double_sided: true,
        ..material([1.0; 3], 1.0, 0.0)
    };
    let place = Vec3::new(0.2, 0.9, 0.1);
    add(&mut scene, leaf, place, masked);
    let sky = sky(&[lobe([0.2, 1.0, 0.1], 30.0, [4.0; 3])]);
    let view = view(80, 60);
    let reference = path(&scene, &sky, &view, 256);
    let (energy, wrong) = compare(&field(&scene, &sky, &view, Field::default()), &reference);
    println!("energy {energy:+.4}, relative squares {wrong:.5}");
    for material in &mut scene.materials {
        material.alpha_mode = AlphaMode::Opaque;
    }
    let (opaque, _) = compare(&field(&scene, &sky, &view, Field::default()), &reference);
    assert!(energy.abs() < 0.03 && wrong < 0.03, "{energy} {wrong}");
    assert!(opaque < -0.1, "the holes make no difference: {opaque}");
}

/// Where nothing is in the way, the picture is that of unshadowed lobes: a white floor in an even sky is as bright as the sky.
#[test]
fn nothing_is_lost_where_nothing_is_in_the_way() {
    let even = sky(&[lobe([0.0, 1.0, 0.0], 1e-3, [1.0; 3])]);
    for (roughness, metallic) in [(1.0, 0.0), (0.3, 1.0), (0.7, 1.0), (0.4, 0.0)] {
        let mut scene = Scene::default();
        let white = material([1.0; 3], roughness, metallic);
        add(&mut scene, floor(2.0), Vec3::ZERO, white);
        let shot = field(&scene, &even, &view(24, 16), Field::default());
        for pixel in shot.pixels {
            let error = (Vec3::from(pixel) - Vec3::ONE).abs().max_element();
            assert!(error < 0.02, "roughness {roughness}: {pixel:?}");
        }
    }
}

/// A lone glossy lobe on a surface half of whose sky is walled off, against path tracing.
#[test]
fn shadows_fall_into_reflections() {
    let mut scene = Scene::default();
    let glossy = material([0.9; 3], 0.4, 1.0);
    add(&mut scene, floor(2.0), Vec3::ZERO, glossy);
    let mut wall = floor(1.0);
    let up = Quat::from_rotation_x(std::f32::consts::FRAC_PI_2);
    wall.positions.iter_mut().for_each(|p| *p = up * *p);
    let black = Material {
        specular: 0.0,
        ..material([0.0; 3], 1.0, 0.0)
    };
    add(&mut scene, wall, Vec3::new(0.0, 0.2, -0.5), black);
    let sky = sky(&[lobe([0.0, 0.5, -1.0], 15.0, [1.0, 0.9, 0.8])]);
    let view = view(60, 40);
    let ours = field(&scene, &sky, &view, Field::default());
    let (energy, wrong) = compare(&ours, &path(&scene, &sky, &view, 256));
    println!("energy {energy:+.4}, relative squares {wrong:.5}");
    assert!(energy.abs() < 0.06 && wrong < 0.02, "{energy} {wrong}");
}

#[test]
fn threads_leave_no_trace() {
    let scene = still_life(0.4);
    let sky = sky(&[
        lobe([0.0, 1.0, 0.0], 0.8, [0.3; 3]),
        lobe([1.0, 0.7, 0.3], 60.0, [8.0, 7.0, 5.0]),
    ]);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| {
            let mut sequence = Sequence::default();
            let settings = settings(Integrator::Field(Field::default()), 1);
            let pose = Pose::at(&scene, 0.0);
            (0..3)
                .map(|_| shoot(&mut sequence, &scene, &pose, &sky, &view(40, 30), &settings).pixels)
                .collect::<Vec<_>>()
        })
    };
    assert!(on(1) == on(3));
}

/// While nothing moves, pictures stay nearly as they are, whatever happens to points.
#[test]
fn still_pictures_do_not_flicker() {
    let scene = still_life(0.5);
    let sky = sky(&[
        lobe([0.0, 1.0, 0.0], 0.8, [0.3; 3]),
        lobe([1.0, 0.7, 0.3], 40.0, [6.0, 5.0, 4.0]),
    ]);
    let mut sequence = Sequence::default();
    let settings = settings(Integrator::Field(Field::default()), 1);
    let pose = Pose::at(&scene, 0.0);
    let mut last: Option<Shot> = None;
    let (mut inserted, mut erased) = (0, 0);
    for _ in 0..12 {
        let shot = shoot(&mut sequence, &scene, &pose, &sky, &view(64, 48), &settings);
        let report = shot.report.field.unwrap();
        inserted += report.inserted;
        erased += report.erased;
        if let Some(last) = &last {
            let (energy, wrong) = compare(&shot, last);
            assert!(energy.abs() < 0.005 && wrong < 1e-3, "{energy} {wrong}");
        }
        last = Some(shot);
    }
    println!("{inserted} inserted, {erased} erased");
}

#[test]
fn a_dark_sky_and_an_empty_picture_are_no_trouble() {
    let scene = still_life(0.5);
    let away = View::look_at(Vec3::Y, Vec3::Y * 2.0, 0.7, 16, 16).unwrap();
    for sky in [sky(&[]), sky(&[lobe([0.0, 1.0, 0.0], 1e6, [0.0; 3])])] {
        for view in [view(16, 12), away] {
            let shot = field(&scene, &sky, &view, Field::default());
            assert!(shot.pixels.iter().flatten().all(|&v| v == 0.0));
        }
    }
}

/// No more points than allowed, and none at all without room for one.
#[test]
fn memory_is_bounded() {
    let scene = still_life(0.5);
    let sky = sky(&[lobe([1.0, 0.7, 0.3], 60.0, [8.0, 7.0, 5.0])]);
    let few = Field {
        most_points: 100,
        ..Field::default()
    };
    let report = field(&scene, &sky, &view(64, 48), few)
        .report
        .field
        .unwrap();
    assert!(report.all_points <= 100);
    assert!(report.bytes <= report.all_points * 34 * 1024);
}

/// Of what is matt in GGX reflections: nothing of narrow ones, most of the roughest, and lobes with it are nearer to the truth than without.
#[test]
fn rough_reflections_are_partly_matt() {
    assert_eq!(gloss::matt_share(0.05, 0.7, 2), 0.0);
    for (alpha, cos, expected) in [(0.36, 0.3, 0.41), (0.5, 0.6, 0.23), (1.0, 0.6, 0.69)] {
        let found = gloss::matt_share(alpha, cos, 2);
        assert!((found - expected).abs() < 0.08, "{alpha} {cos}: {found}");
    }
}

/// Lobes of a reflection add up to its albedo over the hemisphere, and lie where path tracing finds the light.
#[test]
fn gloss_residuals_fall_with_lobes() {
    for alpha in [0.02, 0.1, 0.25, 0.5, 1.0] {
        let of = |gloss_lobes| {
            let field = Field {
                gloss_lobes,
                ..Field::default()
            };
            field.gloss_residual(alpha)
        };
        println!("alpha {alpha}: {:.3} {:.3} {:.3}", of(1), of(2), of(3));
        assert!(of(1) < 0.3 && of(2) <= of(1) + 1e-3 && of(3) <= of(2) + 1e-3);
        assert!(of(3) < 0.06);
    }
}
