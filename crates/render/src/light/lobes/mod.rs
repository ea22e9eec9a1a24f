//! The sky as a few lobes: what fields of visibility can be multiplied with.
//!
//! Wang et al. 2013, Eq. 2 (after Wang et al. 2009): radiance is approximated by a sum of spherical Gaussians, found by optimisation ([`fit`]). What is
//! narrower than any field of visibility resolves, such as the sun, is taken out first ([`sun`]): a direction with its irradiance, to be asked about
//! by exact rays. Lobes and suns together carry the energy of the map, colour by colour; amplitudes are never negative, so that no light
//! is taken away where a lobe is blocked.
//!
//! What is lost is said: [`SkyResidual`]. Fits are the same to the bit on one machine at any number of threads, and can be kept on disk ([`cache`]).
//!
//! Wrong tool for mirrors, which show the map itself, and for skies with more detail than lobes (a hundred lamps).

mod cache;
mod fit;
mod sun;

#[cfg(test)]
mod tests;

use super::environment::{Environment, Kind, Map, cos_edge};
use fit::Cells;
use glam::{DVec3, Vec3};
use occlude_visibility::field::SphericalGaussian;
use std::path::Path;

/// How a sky is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SkyFit {
    /// Lobes at most, 1 or more. The cost of shading grows with them.
    pub lobes: usize,
    /// Suns at most. Each takes an exact ray a shading point.
    pub suns: usize,
}

impl Default for SkyFit {
    fn default() -> Self {
        Self { lobes: 24, suns: 2 }
    }
}

/// A source of the sky that is narrower than fields of visibility resolve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkySun {
    /// Unit vector towards its centre.
    pub towards: Vec3,
    /// Irradiance on a facing surface, W/m^2.
    pub irradiance: Vec3,
    /// Radius of the uniform disk with the same spread, radians.
    pub angular_radius: f32,
}

/// What a fit loses, measured on the map without its suns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SkyResidual {
    /// Root mean square over directions of the error of radiance, in units of the mean radiance: what a mirror would show.
    pub radiance: f32,
    /// Root mean square over normals of the error of unshadowed irradiance, in units of the mean irradiance: what matt surfaces show.
    pub irradiance: f32,
    /// Largest error of unshadowed irradiance, in the same units.
    pub irradiance_worst: f32,
    /// Error of the energy before it was corrected by scaling, relative.
    pub energy: f32,
}

/// A sky as spherical Gaussians and suns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkyLobes {
    /// Their sum is the radiance of the sky without its suns. Sharpness is at least 0.001 (nearly constant), at most 500.
    pub lobes: Vec<SphericalGaussian>,
    /// Ordered by irradiance, the strongest first.
    pub suns: Vec<SkySun>,
    /// What the lobes lose.
    pub residual: SkyResidual,
}

impl Environment {
    /// Fits the sky by lobes. About a second at 24 lobes; a constant or black sky takes no time.
    pub fn lobes(&self, settings: &SkyFit) -> SkyLobes {
        self.lobes_kept(settings, None)
    }

    /// [`Environment::lobes`], kept in a folder (made if it is missing) under the hash of the map and the settings. A file that is damaged or
    /// of another version is fitted anew, and a folder that cannot be written is no error: the fit is returned all the same.
    pub fn lobes_kept(&self, settings: &SkyFit, folder: Option<&Path>) -> SkyLobes {
        let map = match &self.kind {
            Kind::Constant(radiance) => return SkyLobes::constant(*radiance),
            Kind::Map(map) => map,
        };
        if map.is_constant() {
            return SkyLobes::constant(map.lookup(glam::Vec2::splat(0.5)));
        }
        let name = cache::name(map, settings);
        let known = folder.and_then(|folder| cache::read(&folder.join(&name)));
        let found = known.unwrap_or_else(|| {
            let found = SkyLobes::fit(map, settings);
            if let Some(folder) = folder {
                cache::write(folder, &name, &found);
            }
            found
        });
        found.turned(map)
    }
}

impl SkyLobes {
    /// The same radiance from everywhere: one lobe without an edge.
    pub fn constant(radiance: Vec3) -> Self {
        if radiance == Vec3::ZERO {
            return Self::default();
        }
        let sharpness = fit::SHARPNESS.start;
        let share = 4.0 * std::f32::consts::PI / SphericalGaussian::unit_integral(sharpness);
        Self {
            lobes: vec![SphericalGaussian {
                axis: Vec3::Y,
                sharpness,
                amplitude: radiance * share,
            }],
            ..Self::default()
        }
    }

    /// Radiance of the lobes in a direction, suns left out.
    pub fn radiance(&self, wi: Vec3) -> Vec3 {
        self.lobes.iter().map(|lobe| lobe.at(wi)).sum()
    }

    /// In the frame of the map: not turned.
    fn fit(map: &Map, settings: &SkyFit) -> Self {
        let mut map = map.clone();
        let mut suns = sun::take_out(&mut map, settings.suns);
        suns.sort_by(|a, b| {
            let power = |sun: &SkySun| super::luminance(sun.irradiance);
            power(b).total_cmp(&power(a))
        });
        let cells = Cells::new(&map, fit::ROWS);
        let energy = cells.energy();
        // Radiance in units of its mean, so that the fit does not depend on the scale of the sky.
        let mean = energy.iter().sum::<f64>() / (12.0 * std::f64::consts::PI);
        if mean <= 0.0 {
            return Self {
                suns,
                ..Self::default()
            };
        }
        let scaled = cells.scaled(1.0 / mean);
        let coarse = Cells::new(&map, fit::ROWS / 2).scaled(1.0 / mean);
        let mut lobes: Vec<SphericalGaussian> = fit::fit(&scaled, &coarse, settings.lobes.max(1));
        // To the energy of the map, colour by colour.
        let wanted = energy.map(|e| e / mean);
        let got: Vec3 = lobes.iter().map(SphericalGaussian::integral).sum();
        let (mut lost, mut all) = (0.0, 0.0);
        let mut correction = Vec3::ONE;
        for channel in 0..3 {
            lost += (wanted[channel] - f64::from(got[channel])).abs();
            all += wanted[channel];
            if got[channel] > 0.0 {
                correction[channel] = (wanted[channel] / f64::from(got[channel])) as f32;
            }
        }
        for lobe in &mut lobes {
            lobe.amplitude *= correction;
        }
        let mut residual = scaled.residual(&lobes);
        residual.energy = (lost / all) as f32;
        for lobe in &mut lobes {
            lobe.amplitude *= mean as f32;
        }
        Self {
            lobes,
            suns,
            residual,
        }
    }

    /// From the frame of the map to the world.
    fn turned(mut self, map: &Map) -> Self {
        for lobe in &mut self.lobes {
            lobe.axis = map.to_world(lobe.axis);
        }
        for sun in &mut self.suns {
            sun.towards = map.to_world(sun.towards);
        }
        self
    }
}

impl Map {
    fn is_constant(&self) -> bool {
        self.pixels.iter().all(|pixel| *pixel == self.pixels[0])
    }

    /// Turns a direction of the map as the sky is turned.
    fn to_world(&self, w: Vec3) -> Vec3 {
        Vec3::new(
            self.rotation_cos * w.x + self.rotation_sin * w.z,
            w.y,
            self.rotation_cos * w.z - self.rotation_sin * w.x,
        )
    }
}

/// Direction of a place of the map, both coordinates in `[0, 1]`, in the frame of the map.
fn direction(u: f64, v: f64) -> DVec3 {
    let azimuth = (u - 0.5) * std::f64::consts::TAU;
    let (sin, cos) = (v * std::f64::consts::PI).sin_cos();
    DVec3::new(sin * azimuth.cos(), cos, sin * azimuth.sin())
}

/// Solid angle of a texel in one of `height` rows of `width`.
fn solid_angle(row: usize, width: usize, height: usize) -> f64 {
    (cos_edge(row, height) - cos_edge(row + 1, height)) * std::f64::consts::TAU / width as f64
}
