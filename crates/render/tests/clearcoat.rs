//! Clear coats with a normal of their own, from the material's texture to the picture.

mod support;

use glam::{Affine2, DVec3, Vec2, Vec3, Vec4};
use occlude_render::integrator::{BidirectionalLimits, Integrator, PathLimits};
use occlude_scene::{
    Filter, Image, LightKind, Material, Mesh, NormalMap, Projection, Sampler, Scene, Texels,
    Texture, TextureRef,
};
use support::scenes::{Build, lamp, matt};
use support::{Setup, film, picture};

/// Probability that one of these tests fails although the program is right, each.
const FALSE_ALARM: f64 = 1e-4;

/// A normal map of `side * side` texels as the next image and texture of a scene.
fn normal_map(scene: &mut Scene, texels: Vec<[u8; 3]>, scale: f32) -> NormalMap {
    let side = texels.len().isqrt() as u32;
    scene.images.push(Image {
        name: String::new(),
        width: side,
        height: side,
        texels: Texels::Rgba8(texels.into_iter().map(|[r, g, b]| [r, g, b, 255]).collect()),
    });
    scene.textures.push(Texture {
        image: scene.images.len() as u32 - 1,
        sampler: Sampler {
            filter: Filter::Nearest,
            ..Sampler::default()
        },
        srgb: false,
    });
    NormalMap {
        texture: TextureRef {
            texture: scene.textures.len() as u32 - 1,
            uv_set: 0,
            transform: Affine2::IDENTITY,
        },
        scale,
    }
}

/// A floor whose texture space is the world's: u along +X, v along +Z, so that green leans to -Z.
fn floor(build: &mut Build, half: f32, material: Material) {
    let corners =
        [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)].map(|(x, z)| Vec2::new(x, z));
    build.mesh(
        Mesh {
            positions: corners.map(|c| Vec3::new(c.x, 0.0, c.y) * half).to_vec(),
            normals: vec![Vec3::Y; 4],
            tangents: vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 4],
            uv0: corners.map(|c| (c + Vec2::ONE) * 0.5).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        },
        material,
    );
}

/// The world-space normal that a texel means on [`floor`].
fn normal_of([r, g, b]: [u8; 3], scale: f64) -> DVec3 {
    let value = |c: u8| f64::from(c) / 255.0 * 2.0 - 1.0;
    DVec3::new(value(r) * scale, value(b), -value(g) * scale).normalize()
}

fn fresnel(cos: f64) -> f64 {
    0.04 + 0.96 * (1.0 - cos).powi(5)
}

/// GGX times Schlick at F0 0.04, times the cosine of `wi`: the textbook's formulas (Walter et al. 2007; Heitz 2014, eq. 99).
fn coat(alpha: f64, normal: DVec3, wo: DVec3, wi: DVec3) -> f64 {
    let h = (wo + wi).normalize();
    let (o, i, c) = (normal.dot(wo), normal.dot(wi), normal.dot(h));
    if o <= 0.0 || i <= 0.0 {
        return 0.0;
    }
    let a2 = alpha * alpha;
    let d = a2 / (std::f64::consts::PI * (c * c * (a2 - 1.0) + 1.0).powi(2));
    let lambda = |x: f64| 0.5 * ((1.0 + a2 * (1.0 / (x * x) - 1.0)).sqrt() - 1.0);
    let shadowing = 1.0 / (1.0 + lambda(o) + lambda(i));
    fresnel(wo.dot(h)) * d * shadowing / (4.0 * o * i) * i
}

const TEXEL: [u8; 3] = [200, 90, 210];
const OTHER: [u8; 3] = [40, 170, 180];

/// Black below a coat, so that a picture shows the coat alone; a parallel camera that looks down at `wo`.
fn coated(wo: Vec3, coat_map: bool, base_map: bool, roughness: f32) -> Build {
    let mut build = Build::new(wo * 4.0, Vec3::ZERO, Projection::Orthographic { ymag: 0.2 });
    let scene = &mut build.0;
    let clearcoat_normal = coat_map.then(|| normal_map(scene, vec![TEXEL], 0.8));
    let normal = base_map.then(|| normal_map(scene, vec![OTHER], 1.0));
    let material = Material {
        clearcoat: 1.0,
        clearcoat_roughness: roughness,
        clearcoat_normal,
        normal,
        ..matt([0.0; 3])
    };
    floor(&mut build, 1.0, material);
    build
}

/// Of [`value`], relative.
fn tolerance(integrator: Integrator) -> f64 {
    match integrator {
        Integrator::Path(_) => 1e-4,
        _ => 0.02,
    }
}

fn integrators() -> [Integrator; 2] {
    [
        Integrator::Path(PathLimits::new(2)),
        Integrator::Bidirectional(BidirectionalLimits::new(2)),
    ]
}

/// What all pixels of a rendering show. Paths from the camera show one value alone, whatever their random numbers.
fn value(build: &Build, integrator: Integrator) -> f64 {
    let setup = Setup {
        integrator,
        size: (4, 4),
        samples: 64,
        ..Setup::default()
    };
    let (film, _) = film(&build.0, &setup);
    let values = film.develop().radiance.concat();
    let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64;
    if let Integrator::Path(_) = integrator {
        for &v in &values {
            assert!((f64::from(v) - mean).abs() <= 1e-4 * mean, "{values:?}");
        }
    }
    mean
}

/// A sun on a rough coat: the picture is the textbook's GGX about the normal that is expected, whatever the base's normal.
#[test]
fn rough_coat_under_a_sun_is_the_textbooks_lobe() {
    let wo = Vec3::new(0.5, 0.7, 0.4).normalize();
    let wi = Vec3::new(0.3, 0.8, -0.6).normalize();
    let mut seen = Vec::new();
    for (coat_map, base_map) in [(false, false), (false, true), (true, false), (true, true)] {
        for integrator in integrators() {
            let roughness = 0.5;
            let mut build = coated(wo, coat_map, base_map, roughness);
            let kind = LightKind::Directional {
                angular_diameter: 0.0,
            };
            build.light(kind, Vec3::splat(2.0), wi, Vec3::ZERO);
            let normal = if coat_map {
                normal_of(TEXEL, f64::from(0.8_f32))
            } else {
                DVec3::Y
            };
            let alpha = f64::from(roughness * roughness);
            let expected = 2.0 * coat(alpha, normal, wo.as_dvec3(), wi.as_dvec3());
            let found = value(&build, integrator);
            assert!(
                (found - expected).abs() < tolerance(integrator) * expected,
                "coat map {coat_map}, base map {base_map}: {found}, not {expected}"
            );
            seen.push(found);
        }
    }
    let (without, with) = (seen[0], seen[7]);
    assert!((without - with).abs() > 0.2 * with, "{without} {with}");
}

/// A smooth coat mirrors the lamp about its own normal, also where the mirror image is below the base's horizon.
#[test]
fn smooth_coat_mirrors_about_its_own_normal() {
    for (wo, base_map) in [
        (Vec3::new(-0.1, 0.9, 0.5).normalize(), false),
        (Vec3::new(-0.1, 0.9, 0.5).normalize(), true),
    ] {
        let normal = normal_of(TEXEL, f64::from(0.8_f32));
        let eye = wo.as_dvec3();
        let mirrored = (2.0 * normal.dot(eye) * normal - eye).as_vec3();
        if base_map {
            let base = normal_of(OTHER, 1.0).as_vec3();
            assert!(base.dot(mirrored) < -0.05 && base.dot(wo) > 0.0 && mirrored.y > 0.05);
        }
        for integrator in integrators() {
            let mut build = coated(wo, true, base_map, 0.0);
            let (a, b) = mirrored.any_orthonormal_pair();
            let lamp = Material {
                double_sided: true,
                ..lamp(3.0)
            };
            build.rectangle(mirrored * 2.0, a * 0.7, b * 0.7, lamp);
            let expected = 3.0 * fresnel(normal.dot(eye));
            let found = value(&build, integrator);
            assert!(
                (found - expected).abs() < tolerance(integrator) * expected,
                "{wo} {base_map}: {found}, not {expected}"
            );
        }
    }
}

/// Base and coat with maps of several texels, light by way of both: paths from the light see the same surface as paths from the camera.
#[test]
fn both_directions_see_the_same_coat() {
    for roughness in [0.0, 0.4] {
        let projection = Projection::Perspective { yfov: 0.7 };
        let mut build = Build::new(Vec3::new(0.2, 1.5, 2.5), Vec3::ZERO, projection);
        let texels = |seed: u32| {
            let number = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
            (0..16)
                .map(|i| [number(3 * i + seed), number(3 * i + 1 + seed), 255])
                .collect()
        };
        let clearcoat_normal = Some(normal_map(&mut build.0, texels(1), 0.5));
        let normal = Some(normal_map(&mut build.0, texels(77), 0.6));
        floor(
            &mut build,
            1.2,
            Material {
                base_color: Vec4::new(0.7, 0.4, 0.2, 1.0),
                metallic: 0.3,
                roughness: 0.5,
                clearcoat: 1.0,
                clearcoat_roughness: roughness,
                clearcoat_normal,
                normal,
                ..Material::default()
            },
        );
        build.rectangle(
            Vec3::new(0.0, 1.0, -1.2),
            Vec3::X * 1.2,
            Vec3::Y,
            matt([0.8; 3]),
        );
        build.rectangle(
            Vec3::new(0.3, 1.6, -0.3),
            Vec3::X * 0.5,
            Vec3::Z * 0.5,
            lamp(4.0),
        );
        let render = |integrator| {
            let setup = Setup {
                integrator,
                samples: 256,
                ..Setup::default()
            };
            picture(&build.0, &setup, 12)
        };
        let path = render(Integrator::Path(PathLimits::new(4)));
        let both = render(Integrator::Bidirectional(BidirectionalLimits::new(4)));
        both.assert_same(&path, FALSE_ALARM, &format!("coat-{roughness}"));
        let mean = format!("coat-{roughness}-mean");
        both.blocks(16)
            .assert_same(&path.blocks(16), FALSE_ALARM, &mean);
    }
}
