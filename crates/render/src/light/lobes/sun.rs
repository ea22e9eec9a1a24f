//! Suns: taken out of the map, since no field of visibility resolves them.

use super::super::environment::Map;
use super::super::luminance;
use super::{SkySun, direction, solid_angle};
use glam::{DVec3, Vec3};

/// A sun with its glare ends this far from its centre, radians: the sun is half a degree wide, lenses and map texels spread it.
const REACH: f64 = 0.035;
/// Around it, what counts as the sky behind it: as far as this.
const AROUND: f64 = 0.06;
/// The smallest share of the map's energy that is worth a ray.
const SHARE: f64 = 0.01;
/// A texel can be the middle of a sun if it is that much brighter than the mean of the map.
const CONTRAST: f64 = 20.0;

/// Finds at most `most` suns, and leaves the sky around them in their place; none in maps whose texels are far larger than a sun. Takes time
/// linear in texels.
pub(super) fn take_out(map: &mut Map, most: usize) -> Vec<SkySun> {
    if texel_size(map) > 2.0 * REACH {
        return Vec::new();
    }
    let total: f64 = map.integral.to_array().iter().map(|&e| f64::from(e)).sum();
    let mut suns = Vec::new();
    // A bright spot that is no sun must not hide one that is.
    let mut passed_over = Vec::new();
    while suns.len() < most && passed_over.len() < 8 {
        let Some(peak) = brightest(map, &passed_over) else {
            break;
        };
        match Source::around(map, peak) {
            Some(source) if source.energy() > SHARE * total => {
                suns.push(source.sun());
                source.remove(map);
            }
            _ => passed_over.push(peak),
        }
    }
    suns
}

/// The brightest texel's direction, if it stands out.
fn brightest(map: &Map, passed_over: &[DVec3]) -> Option<DVec3> {
    let mean = f64::from(luminance(map.integral)) / (4.0 * std::f64::consts::PI);
    let mut best = (CONTRAST * mean, None);
    for (index, pixel) in map.pixels.iter().enumerate() {
        let value = f64::from(luminance(Vec3::from_array(*pixel)));
        if value > best.0 {
            let w = texel(map, index % map.width, index / map.width);
            if passed_over.iter().all(|p| p.angle_between(w) > REACH) {
                best = (value, Some(w));
            }
        }
    }
    best.1
}

/// Angular size, radians.
fn texel_size(map: &Map) -> f64 {
    std::f64::consts::PI / map.height as f64
}

fn texel(map: &Map, x: usize, y: usize) -> DVec3 {
    direction(
        (x as f64 + 0.5) / map.width as f64,
        (y as f64 + 0.5) / map.height as f64,
    )
}

/// A bright spot above the sky around it.
struct Source {
    centre: DVec3,
    /// Radiance of the sky around it.
    behind: [f64; 3],
    irradiance: DVec3,
    /// Mean squared distance from the centre, radians squared.
    spread: f64,
    half_texel: f64,
}

impl Source {
    /// `None` if the spot is wider than a sun.
    fn around(map: &Map, peak: DVec3) -> Option<Self> {
        let behind = mean_in_ring(map, peak);
        let mut centre = peak;
        let mut source = None;
        // The brightest texel is not the middle of the spot: the mean direction is, found again around itself.
        for _ in 0..4 {
            let mut sum = DVec3::ZERO;
            let mut irradiance = DVec3::ZERO;
            let (mut weighted, mut weight) = (0.0, 0.0);
            for (x, y, angle) in near(map, centre, REACH) {
                let w = texel(map, x, y);
                let value = Vec3::from_array(map.pixels[y * map.width + x]).as_dvec3();
                let above = (value - DVec3::from_array(behind)).max(DVec3::ZERO);
                let part = above * solid_angle(y, map.width, map.height);
                irradiance += part * angle.cos();
                weighted += part.element_sum() * angle * angle;
                weight += part.element_sum();
                sum += w * part.element_sum();
            }
            if weight <= 0.0 {
                return None;
            }
            centre = sum.normalize_or(centre);
            source = Some(Self {
                centre,
                behind,
                irradiance,
                spread: weighted / weight,
                half_texel: 0.5 * texel_size(map),
            });
        }
        source.filter(|source| source.spread < (0.5 * REACH).powi(2))
    }

    fn energy(&self) -> f64 {
        self.irradiance.element_sum()
    }

    fn sun(&self) -> SkySun {
        // A uniform disk of radius r has the mean squared distance r^2 / 2. A texel cannot say more than its size.
        SkySun {
            towards: self.centre.as_vec3().normalize(),
            irradiance: self.irradiance.as_vec3(),
            angular_radius: (2.0 * self.spread).sqrt().max(self.half_texel) as f32,
        }
    }

    fn remove(&self, map: &mut Map) {
        let behind = self.behind.map(|b| b as f32);
        let spots: Vec<_> = near(map, self.centre, REACH).collect();
        for (x, y, _) in spots {
            let pixel = &mut map.pixels[y * map.width + x];
            *pixel = std::array::from_fn(|c| pixel[c].min(behind[c]));
        }
    }
}

/// Texels no further than `reach` from a direction, with the angle.
fn near(map: &Map, centre: DVec3, reach: f64) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
    let polar = centre.y.clamp(-1.0, 1.0).acos();
    let rows = map.height as f64 / std::f64::consts::PI;
    let first = ((polar - reach) * rows).floor().max(0.0) as usize;
    let last = (((polar + reach) * rows).ceil() as usize).min(map.height);
    (first..last).flat_map(move |y| {
        (0..map.width).filter_map(move |x| {
            let angle = texel(map, x, y).angle_between(centre);
            (angle <= reach).then_some((x, y, angle))
        })
    })
}

fn mean_in_ring(map: &Map, centre: DVec3) -> [f64; 3] {
    let (mut sum, mut weight) = ([0.0; 3], 0.0);
    for (x, y, angle) in near(map, centre, AROUND) {
        if angle > REACH {
            let area = solid_angle(y, map.width, map.height);
            let pixel = map.pixels[y * map.width + x];
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(value) * area;
            }
            weight += area;
        }
    }
    // Maps too coarse to have a ring: black, so that nothing is lost.
    sum.map(|s| if weight > 0.0 { s / weight } else { 0.0 })
}
