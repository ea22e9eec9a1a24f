//! Fits on disk.

use super::super::environment::Map;
use super::{SkyFit, SkyLobes, SkyResidual, SkySun};
use glam::Vec3;
use occlude_visibility::field::SphericalGaussian;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Changes when the method does.
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
struct Stored {
    version: u32,
    /// Axis, sharpness, amplitude.
    lobes: Vec<[f32; 7]>,
    /// Direction, irradiance, angular radius.
    suns: Vec<[f32; 7]>,
    /// Radiance, irradiance, worst irradiance, energy.
    residual: [f32; 4],
}

/// File name for a map and settings: FNV-1a over both, which tells maps apart, not forgers.
pub(super) fn name(map: &Map, settings: &SkyFit) -> String {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut byte = |byte: u8| hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    let numbers = [map.width, map.height, settings.lobes, settings.suns].map(|n| n as u64);
    numbers
        .iter()
        .flat_map(|n| n.to_le_bytes())
        .for_each(&mut byte);
    map.pixels
        .iter()
        .flatten()
        .flat_map(|value| value.to_le_bytes())
        .for_each(&mut byte);
    format!("sky-{VERSION}-{hash:016x}.json")
}

pub(super) fn read(path: &Path) -> Option<SkyLobes> {
    let stored: Stored = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    let numbers = stored.lobes.iter().chain(&stored.suns).flatten();
    let sane = numbers.chain(&stored.residual).all(|n| n.is_finite())
        && stored.lobes.iter().all(|lobe| lobe[3] > 0.0);
    if stored.version != VERSION || !sane {
        return None;
    }
    let vec = |v: &[f32]| Vec3::new(v[0], v[1], v[2]);
    let [radiance, irradiance, irradiance_worst, energy] = stored.residual;
    Some(SkyLobes {
        lobes: (stored.lobes.iter())
            .map(|lobe| SphericalGaussian {
                axis: vec(&lobe[..3]),
                sharpness: lobe[3],
                amplitude: vec(&lobe[4..]),
            })
            .collect(),
        suns: (stored.suns.iter())
            .map(|sun| SkySun {
                towards: vec(&sun[..3]),
                irradiance: vec(&sun[3..6]),
                angular_radius: sun[6],
            })
            .collect(),
        residual: SkyResidual {
            radiance,
            irradiance,
            irradiance_worst,
            energy,
        },
    })
}

/// Nothing is said about failures: the fit goes on without the file.
pub(super) fn write(folder: &Path, name: &str, found: &SkyLobes) {
    let join = |a: Vec3, b: f32, c: Vec3| [a.x, a.y, a.z, b, c.x, c.y, c.z];
    let residual = &found.residual;
    let stored = Stored {
        version: VERSION,
        lobes: (found.lobes.iter())
            .map(|lobe| join(lobe.axis, lobe.sharpness, lobe.amplitude))
            .collect(),
        suns: (found.suns.iter())
            .map(|sun| {
                let i = sun.irradiance;
                join(sun.towards, i.x, Vec3::new(i.y, i.z, sun.angular_radius))
            })
            .collect(),
        residual: [
            residual.radiance,
            residual.irradiance,
            residual.irradiance_worst,
            residual.energy,
        ],
    };
    if std::fs::create_dir_all(folder).is_err() {
        return;
    }
    let _ = occlude_image::write_atomically(&folder.join(name), |out| {
        serde_json::to_writer(out, &stored).map_err(std::io::Error::from)
    });
}
