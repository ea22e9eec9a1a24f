//! The sky and the sun that the command line adds to a scene.

use crate::context::Context;
use crate::error::CliError;
use crate::values::{self, Sun};
use clap::Args;
use glam::{Affine3A, Quat, Vec3};
use occlude_image::{Encoding, Limits, Picture};
use occlude_render::light::Environment;
use occlude_scene::{Light, LightKind, Node, Scene};
use std::path::{Path, PathBuf};

/// How wide the sun is, seen from the earth.
const SUN_DIAMETER_DEGREES: f32 = 0.53;

/// Options about light from outside of the scene's file.
#[derive(Debug, Clone, Args)]
pub struct SkyArgs {
    /// Latitude-longitude sky (.hdr, .exr): row 0 is up, the middle column lies along +X
    #[arg(long, value_name = "FILE", help_heading = "Light")]
    pub environment: Option<PathBuf>,

    /// Turn the sky about +Y, degrees, counterclockwise seen from above
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = values::number, allow_hyphen_values = true, help_heading = "Light")]
    pub environment_rotation: f32,

    /// Factor on the sky's radiance
    #[arg(long, value_name = "X", default_value = "1", value_parser = values::not_negative, allow_negative_numbers = true, help_heading = "Light")]
    pub environment_scale: f32,

    /// Add a sun: azimuth (from +X towards +Z) and elevation in degrees, and its irradiance on a facing surface
    /// [default: pi, which a white surface shows as radiance 1]
    #[arg(
        long,
        value_name = "AZ,EL[,IRRADIANCE]",
        allow_hyphen_values = true,
        help_heading = "Light"
    )]
    pub sun: Option<Sun>,
}

impl SkyArgs {
    /// Reads the sky's picture, if there is one.
    pub fn load(&self, context: &Context) -> Result<Option<Picture>, CliError> {
        (self.environment.as_deref())
            .map(|path| load_sky(path, context))
            .transpose()
    }

    /// The sky's picture as a light.
    pub fn environment(&self, picture: Option<&Picture>) -> Option<Environment> {
        let rotation = self.environment_rotation.to_radians();
        picture.map(|sky| Environment::from_picture(sky, rotation, self.environment_scale))
    }

    /// Adds the sun, if there is one, as a directional light and the node that turns it.
    pub fn add_sun(&self, scene: &mut Scene) {
        if let Some(sun) = &self.sun {
            add_sun(scene, sun);
        }
    }
}

fn load_sky(path: &Path, context: &Context) -> Result<Picture, CliError> {
    let limits = context
        .common
        .memory
        .map_or_else(Limits::default, |max_bytes| Limits { max_bytes });
    let opened = occlude_image::read(path, &limits)?;
    if opened.repaired > 0 {
        context.warn(format_args!(
            "{} pixels were not finite and count as black: {}",
            opened.repaired,
            path.display()
        ));
    }
    if opened.encoding == Encoding::Display {
        context.warn(format_args!(
            "a PNG holds display colours, bright lights are lost: {}: better use .hdr or .exr",
            path.display()
        ));
    }
    Ok(opened.picture)
}

fn add_sun(scene: &mut Scene, sun: &Sun) {
    let node = scene.nodes.len() as u32;
    // Lights shine along -Z of their node, so its +Z points to the sun.
    let rotation = Quat::from_rotation_arc(Vec3::Z, sun.towards());
    scene.nodes.push(Node {
        name: "sun".to_owned(),
        parent: None,
        parent_from_node: Affine3A::from_quat(rotation),
    });
    scene.lights.push(Light {
        name: "sun".to_owned(),
        node,
        intensity: Vec3::splat(sun.irradiance),
        kind: LightKind::Directional {
            angular_diameter: SUN_DIAMETER_DEGREES.to_radians(),
        },
    });
}
