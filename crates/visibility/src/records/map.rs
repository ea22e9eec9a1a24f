//! One record: a place, and what it sees.

use super::paraboloid::{Layout, SKY, UNKNOWN};
use crate::{Ray, Tracer};
use glam::{Mat3, Vec3};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// A place on a surface where a record may stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// World-space position.
    pub position: Vec3,
    /// Unit geometric normal, on the side that the record looks to.
    pub normal: Vec3,
    /// Where rays start: the position, moved off its surface.
    pub origin: Vec3,
}

/// What a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Distance in units of the scene for a direction of unit length; infinite: nothing is met.
    pub distance: f32,
    /// Unit geometric normal on the side that is seen.
    pub normal: Vec3,
    /// Share of light that the surface reflects, by channel, 0 to 1.
    pub albedo: Vec3,
    /// What the surface does to light cannot be kept as an albedo (mirrors, glass): paths that arrive here are to be traced.
    pub trace: bool,
}

impl Seen {
    /// Nothing is met.
    pub const NOTHING: Self = Self {
        distance: f32::INFINITY,
        normal: Vec3::Z,
        albedo: Vec3::ZERO,
        trace: false,
    };
}

/// A [`Tracer`] that tells what rays meet, so that records can be filled.
///
/// Everything is asked in batches of which neighbours run alike; directions have unit length.
pub trait DistanceTracer: Tracer {
    /// Distance of the nearest blocker along each ray, infinite if there is none. It must be the nearest of what
    /// [`Tracer::occluded`] finds.
    fn distances(&self, rays: &[Ray], distances: &mut [f32]);

    /// The nearest blocker along each ray, and what it looks like.
    fn surfaces(&self, rays: &[Ray], seen: &mut [Seen]);

    /// The places that rays meet, as sites that look back at where the rays come from.
    fn sites(&self, rays: &[Ray], sites: &mut [Option<Site>]);
}

/// Where a record stands and how its map lies: a cache line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub(super) struct Stand {
    pub(super) site: Site,
    /// Of the local frame, whose z axis is the normal.
    tangents: [Vec3; 2],
}

const _: () = assert!(size_of::<Stand>() == 64);

impl Stand {
    pub(super) fn new(site: Site) -> Self {
        let (x, y) = site.normal.any_orthonormal_pair();
        Self {
            site,
            tangents: [x, y],
        }
    }

    /// Tangent, bitangent, normal.
    #[inline(always)]
    pub(super) fn axes(&self) -> [Vec3; 3] {
        [self.tangents[0], self.tangents[1], self.site.normal]
    }

    /// World from local.
    pub(super) fn frame(&self) -> Mat3 {
        let [x, y, z] = self.axes();
        Mat3::from_cols(x, y, z)
    }

    /// A vector of the record's frame in the world.
    #[inline(always)]
    pub(super) fn world(&self, v: Vec3) -> Vec3 {
        let [x, y, z] = self.axes();
        x * v.x + y * v.y + z * v.z
    }

    /// A vector in the record's frame.
    #[inline(always)]
    pub(super) fn local(&self, v: Vec3) -> Vec3 {
        Vec3::from_array(self.axes().map(|axis| axis.dot(v)))
    }
}

/// What a record sees, texel by texel.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Map {
    /// Codes of distances.
    Distances(Box<[u16]>),
    /// The same, with what is seen: see [`Texel`].
    Surfaces(Box<[Texel]>),
}

/// A texel with what is seen: 16 bits of distance, twice 8 of normal (octahedral), three times 8 of albedo (its root), 8 of flags.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Texel(pub(super) u64);

const TRACE: u64 = 1 << 56;

impl Texel {
    fn new(code: u16, seen: &Seen) -> Self {
        let n = seen.normal;
        let sum = n.x.abs() + n.y.abs() + n.z.abs();
        let (mut u, mut v) = (n.x / sum, n.y / sum);
        if n.z < 0.0 {
            let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
            (u, v) = ((1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v));
        }
        let byte = |x: f32| u64::from((x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
        let albedo = seen.albedo.max(Vec3::ZERO);
        Self(
            u64::from(code)
                | byte(0.5 * u + 0.5) << 16
                | byte(0.5 * v + 0.5) << 24
                | byte(albedo.x.sqrt()) << 32
                | byte(albedo.y.sqrt()) << 40
                | byte(albedo.z.sqrt()) << 48
                | if seen.trace { TRACE } else { 0 },
        )
    }

    #[inline(always)]
    pub(super) fn code(self) -> u16 {
        self.0 as u16
    }

    pub(super) fn trace(self) -> bool {
        self.0 & TRACE != 0
    }

    pub(super) fn normal(self) -> Vec3 {
        // 0.5 must come back as 0: the middle is 127.5.
        let signed = |shift: u32| ((self.0 >> shift & 0xff) as f32) * (2.0 / 255.0) - 1.0;
        let (u, v) = (signed(16), signed(24));
        let z = 1.0 - u.abs() - v.abs();
        let fold = (-z).max(0.0);
        let shift = |x: f32| if x >= 0.0 { x - fold } else { x + fold };
        Vec3::new(shift(u), shift(v), z).normalize()
    }

    pub(super) fn albedo(self) -> Vec3 {
        let root = |shift: u32| ((self.0 >> shift & 0xff) as f32) * (1.0 / 255.0);
        let root = Vec3::new(root(32), root(40), root(48));
        root * root
    }
}

impl Map {
    /// The code of a texel's distance.
    #[inline(always)]
    pub(super) fn code(&self, texel: u32) -> u16 {
        match self {
            Self::Distances(codes) => codes[texel as usize],
            Self::Surfaces(texels) => texels[texel as usize].code(),
        }
    }
}

/// Rays that are traced together.
const BATCH: usize = 256;

/// Fills the part `range` of the layout's texels.
fn trace_part<T: DistanceTracer>(
    tracer: &T,
    layout: &Layout,
    stand: &Stand,
    surfaces: bool,
    range: std::ops::Range<usize>,
    out: &mut [Texel],
) {
    let mut rays = Vec::with_capacity(BATCH);
    let mut distances = [0.0; BATCH];
    let mut seen = [Seen::NOTHING; BATCH];
    let directions = &layout.directions[range];
    for (directions, out) in directions.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        rays.clear();
        rays.extend(
            (directions.iter()).map(|&local| Ray::new(stand.site.origin, stand.world(local))),
        );
        if surfaces {
            let seen = &mut seen[..rays.len()];
            tracer.surfaces(&rays, seen);
            for (out, seen) in out.iter_mut().zip(seen) {
                *out = Texel::new(layout.scale.encode(seen.distance), seen);
            }
        } else {
            let distances = &mut distances[..rays.len()];
            tracer.distances(&rays, distances);
            for (out, &mut distance) in out.iter_mut().zip(distances) {
                *out = Texel(u64::from(layout.scale.encode(distance)));
            }
        }
    }
}

/// What a record at `stand` sees.
pub(super) fn fill<T: DistanceTracer>(
    tracer: &T,
    layout: &Layout,
    stand: &Stand,
    surfaces: bool,
    threads: usize,
) -> Map {
    let count = layout.texels.len();
    let mut traced = vec![Texel(u64::from(UNKNOWN)); count];
    let part = count.div_ceil(threads.max(1)).next_multiple_of(BATCH);
    if threads <= 1 {
        trace_part(tracer, layout, stand, surfaces, 0..count, &mut traced);
    } else {
        std::thread::scope(|scope| {
            for (k, out) in traced.chunks_mut(part).enumerate() {
                let range = k * part..k * part + out.len();
                scope.spawn(move || trace_part(tracer, layout, stand, surfaces, range, out));
            }
        });
    }
    let size = (layout.resolution * layout.resolution) as usize;
    let pairs = || layout.texels.iter().zip(&traced);
    if surfaces {
        let mut texels = vec![Texel::default(); size].into_boxed_slice();
        pairs().for_each(|(&at, &texel)| texels[at as usize] = texel);
        Map::Surfaces(texels)
    } else {
        let mut codes = vec![UNKNOWN; size].into_boxed_slice();
        pairs().for_each(|(&at, &texel)| codes[at as usize] = texel.code());
        Map::Distances(codes)
    }
}

/// Fills many records, each by one thread; the result does not depend on how many threads there are.
pub(super) fn fill_all<T: DistanceTracer>(
    tracer: &T,
    layout: &Layout,
    stands: &[Stand],
    surfaces: bool,
    threads: usize,
) -> Vec<Map> {
    if threads <= 1 || stands.len() <= 1 {
        let fill = |stand| fill(tracer, layout, stand, surfaces, threads);
        return stands.iter().map(fill).collect();
    }
    let next = AtomicUsize::new(0);
    let mut maps: Vec<Option<Map>> = vec![None; stands.len()];
    let parts: Vec<Vec<(usize, Map)>> = std::thread::scope(|scope| {
        let work = || {
            let mut done = Vec::new();
            loop {
                let k = next.fetch_add(1, Relaxed);
                let Some(stand) = stands.get(k) else {
                    return done;
                };
                done.push((k, fill(tracer, layout, stand, surfaces, 1)));
            }
        };
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        (threads.into_iter())
            .map(|thread| {
                thread
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
            .collect()
    });
    for (k, map) in parts.into_iter().flatten() {
        maps[k] = Some(map);
    }
    maps.into_iter().flatten().collect()
}

/// Whether a record sees hardly farther than `reach`: it stands inside something.
pub(super) fn is_blind(map: &Map, layout: &Layout, reach: f32) -> bool {
    let near = |&&texel: &&u32| {
        let code = map.code(texel);
        code != SKY && (code == UNKNOWN || layout.scale.decode(code) < reach)
    };
    let blocked = layout.texels.iter().filter(near).count();
    blocked * 20 > layout.texels.len() * 19
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_keep_what_is_seen() {
        for i in 0..1000_u32 {
            let turn = |k: f32| (i as f32 * k).fract() * 2.0 - 1.0;
            let normal = Vec3::new(turn(0.618), turn(0.7548), turn(0.5698)).normalize();
            let albedo = Vec3::new(0.02, 0.5, 0.5 + 0.5 * turn(0.819)).abs();
            let seen = Seen {
                distance: 1.0,
                normal,
                albedo,
                trace: i % 2 == 0,
            };
            let texel = Texel::new(1234, &seen);
            assert_eq!((texel.code(), texel.trace()), (1234, seen.trace));
            assert!(texel.normal().dot(normal) > 0.9995, "{normal}");
            assert!((texel.albedo() - albedo).abs().max_element() < 0.004);
        }
    }
}
