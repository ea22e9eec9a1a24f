//! What a place sees along a direction, and whether it sees another place: single questions, as paths ask them.
//!
//! Snapping takes the question to a record: a ray starts there, with its own direction; a segment starts there and ends where it ended.
//! With planes, the true ray is cut with the plane of what the record sees along its direction, if the record sees that plane where the ray
//! is cut, too.
//! Marching follows the true ray and asks the record about points on it: the first that lies behind what the record sees is a hit
//! (Ulbrich 2013, section 6).

use super::cache::{Cache, WHOLE_USE};
use super::map::{Map, Texel};
use super::neighbours::NOBODY;
use super::paraboloid::{SKY, UNKNOWN};
use super::ranking::Nearby;
use super::settings::{Lookup, Select};
use crate::Reason;
use glam::Vec3;

/// Points at which a marching ray is tested.
const MARCH: usize = 32;

/// Halvings of the step in which a marching ray goes behind something.
const BISECTIONS: usize = 5;

/// Half a texel's diagonal, in widths of a texel.
const HALF_DIAGONAL: f32 = 0.75;

/// Tolerances grow with the slant of what is seen, up to this.
const MOST_SLANT: f32 = 6.0;

/// Cosine of the slant up to which a surface's plane is taken to go on, and how much nearer or farther a ray may meet it than the
/// record's own. Else the record has nothing to say.
const FLATTEST: f32 = 0.05;
const STRETCH: std::ops::Range<f32> = 0.6..1.5;

/// Texels whose planes a ray is cut with before the record has nothing to say.
const LOOKS: usize = 3;

/// How far a plane leads astray because its normal is rounded, a unit of length.
const ROUNDED: f32 = 0.02;

/// How uneven a surface may be within a texel, in footprints: against shadows of surfaces on themselves.
const UNEVEN: f32 = 0.4;

/// A surface that a record sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CachedSurface {
    /// World-space position, as exact as the record's texels.
    pub position: Vec3,
    /// Unit normal on the side that is seen.
    pub normal: Vec3,
    /// Share of light that the surface reflects, by channel.
    pub albedo: Vec3,
    /// Width of the texel there: what `position` is uncertain by.
    pub footprint: f32,
}

/// The answer to "what does this place see along this direction?".
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RayAnswer {
    /// A surface.
    Surface(CachedSurface),
    /// Nothing: the ray leaves the scene.
    Sky,
    /// No record knows, or what is seen cannot be kept: trace the ray.
    Unknown(Reason),
}

/// Where a segment ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SegmentEnd {
    /// At a point.
    Point(Vec3),
    /// At a point on a surface with this normal.
    Surface(Vec3, Vec3),
    /// Infinitely far away, along this unit vector.
    Direction(Vec3),
}

/// What one worker keeps between questions: how often records were used.
#[derive(Clone, Debug, Default)]
pub struct RecordsReader {
    uses: Vec<u64>,
}

/// A ray question that knows its record and texel, but has not looked there yet. So that many look at once: memory answers late.
#[derive(Clone, Copy, Debug)]
pub struct Aim {
    id: u32,
    texel: u32,
}

/// The same for a segment.
#[derive(Clone, Copy, Debug)]
pub struct SegmentAim {
    /// Where to look.
    pub aim: Aim,
    from: Vec3,
    end: SegmentEnd,
}

impl Nearby {
    /// Nobody does.
    pub fn is_empty(&self) -> bool {
        self.ids[0] == NOBODY
    }

    /// Why none of them has a say.
    fn silent(&self) -> Reason {
        if self.is_empty() {
            Reason::NoRecord
        } else {
            Reason::BelowHorizon
        }
    }
}

impl Cache {
    /// Makes a reader ready to count: to be called before the first question after a pass.
    pub fn begin_reading(&self, reader: &mut RecordsReader) {
        reader.uses.resize(self.len(), 0);
    }

    /// Hands over what a reader has counted; adding up whole numbers, in any order.
    pub fn end_reading(&self, reader: &mut RecordsReader) {
        for (id, uses) in reader.uses.iter_mut().enumerate() {
            if *uses != 0 && id < self.len() {
                self.count(id as u32, *uses);
            }
        }
        reader.uses.clear();
    }

    /// The record that a ray question along a unit vector goes to: `random` (0 to 1) chooses among three. Its use counts `weight`.
    /// An error: nobody knows.
    pub fn aim(
        &self,
        reader: &mut RecordsReader,
        nearby: &Nearby,
        direction: Vec3,
        random: f32,
        weight: f32,
    ) -> Result<Aim, Reason> {
        // Directions below a record's horizon are not its business.
        let valid = |id: u32| self.stands[id as usize].site.normal.dot(direction) > 0.0;
        let id = pick(nearby, self.settings.select, random, valid).ok_or(nearby.silent())?;
        reader.uses[id as usize] += (weight * WHOLE_USE as f32) as u64;
        let d = self.stands[id as usize].local(direction);
        let texel = self.layout.texel(d.x, d.y, 1.0 + d.z);
        Ok(Aim { id, texel })
    }

    /// As [`Self::aim`], for the question whether a place at `from` sees an end.
    pub fn aim_segment(
        &self,
        reader: &mut RecordsReader,
        nearby: &Nearby,
        from: Vec3,
        end: SegmentEnd,
        random: f32,
        weight: f32,
    ) -> Result<SegmentAim, Reason> {
        let offset = |id: u32| match end {
            SegmentEnd::Direction(direction) => direction,
            SegmentEnd::Point(point) | SegmentEnd::Surface(point, _) => {
                point - self.stands[id as usize].site.position
            }
        };
        let valid = |id: u32| self.stands[id as usize].site.normal.dot(offset(id)) > 0.0;
        let id = pick(nearby, self.settings.select, random, valid).ok_or(nearby.silent())?;
        reader.uses[id as usize] += (weight * WHOLE_USE as f32) as u64;
        let p = self.stands[id as usize].local(offset(id));
        let texel = self.layout.texel(p.x, p.y, p.length() + p.z);
        let aim = Aim { id, texel };
        Ok(SegmentAim { aim, from, end })
    }

    /// The texel aimed at.
    #[inline]
    pub fn fetch(&self, aim: &Aim) -> u64 {
        match self.map(aim.id) {
            Map::Surfaces(texels) => texels[aim.texel as usize].0,
            Map::Distances(codes) => u64::from(codes[aim.texel as usize]),
        }
    }

    /// How far the record aimed at stands from `position`.
    pub fn parallax(&self, aim: &Aim, position: Vec3) -> f32 {
        self.stands[aim.id as usize]
            .site
            .position
            .distance(position)
    }

    /// What the ray from `position` along the unit vector `direction` meets, by the record and texel found before.
    pub fn look(&self, aim: &Aim, texel: u64, position: Vec3, direction: Vec3) -> RayAnswer {
        let stand = &self.stands[aim.id as usize];
        let texel = Texel(texel);
        if self.settings.lookup == Lookup::March {
            return match self.march(aim.id, position, direction) {
                Err(reason) => RayAnswer::Unknown(reason),
                Ok((_, SKY, _)) => RayAnswer::Sky,
                Ok((at, _, hit)) => match self.map(aim.id) {
                    Map::Surfaces(texels) => {
                        let distance = hit.distance(position);
                        self.surface(aim.id, texels[at as usize], hit, distance, direction)
                    }
                    Map::Distances(_) => RayAnswer::Unknown(Reason::Unknown),
                },
            };
        }
        match texel.code() {
            UNKNOWN => RayAnswer::Unknown(Reason::Unknown),
            SKY => RayAnswer::Sky,
            code => {
                let distance = self.layout.scale.decode(code);
                let contact = self.settings.contact;
                let parallax = stand.site.position.distance(position);
                let planes = self.settings.lookup == Lookup::Plane;
                let least = if planes { 0.125 } else { 0.25 } * contact * parallax;
                if distance < least {
                    return RayAnswer::Unknown(Reason::TooNear);
                }
                let found = planes.then(|| self.cut(aim, texel, position, direction));
                match found.flatten() {
                    Some((texel, along)) => {
                        let at = position + direction * along;
                        self.surface(aim.id, texel, at, along, direction)
                    }
                    None if planes && contact > 0.0 => RayAnswer::Unknown(Reason::Unknown),
                    None => {
                        let seen = stand.site.position + direction * distance;
                        self.surface(aim.id, texel, seen, distance, direction)
                    }
                }
            }
        }
    }

    /// What a texel keeps of a surface at `position`, seen at a distance along a unit vector.
    fn surface(
        &self,
        id: u32,
        texel: Texel,
        position: Vec3,
        distance: f32,
        direction: Vec3,
    ) -> RayAnswer {
        if texel.trace() {
            return RayAnswer::Unknown(Reason::Unknown);
        }
        let height = self.stands[id as usize].site.normal.dot(direction);
        let normal = texel.normal();
        RayAnswer::Surface(CachedSurface {
            position,
            // Rounded normals must not turn away from who sees them.
            normal: if normal.dot(direction) < -0.01 {
                normal
            } else {
                (normal - direction * (normal.dot(direction) + 0.02)).normalize()
            },
            albedo: texel.albedo(),
            footprint: self.layout.width() * distance * (1.0 + height.max(0.0)),
        })
    }

    /// Cuts a ray with the plane of what a texel sees, and looks at the record again, in the direction of the point found there: if the
    /// record sees that plane there, too, the ray meets it; else the plane of what it does see there is next. The texel seen last, and
    /// the distance along the ray; `None`: no plane is confirmed, or it is met far from where the record meets it.
    fn cut(
        &self,
        aim: &Aim,
        first: Texel,
        position: Vec3,
        direction: Vec3,
    ) -> Option<(Texel, f32)> {
        let Map::Surfaces(texels) = self.map(aim.id) else {
            return None;
        };
        let stand = &self.stands[aim.id as usize];
        // Of the plane that a texel sees: a point, how far away that is, and the normal.
        let plane = |at: u32, texel: Texel| {
            let distance = self.layout.scale.decode(texel.code());
            let middle = stand.world(self.layout.middle(at));
            let seen = stand.site.position + middle * distance;
            (seen, distance, texel.normal())
        };
        let (mut at, mut texel) = (aim.texel, first);
        for _ in 0..LOOKS {
            let (seen, distance, normal) = plane(at, texel);
            let facing = normal.dot(direction);
            let along = normal.dot(seen - position) / facing;
            if facing > -FLATTEST || !STRETCH.contains(&(along / distance)) {
                return None;
            }
            let found = position + direction * along;
            let p = stand.local(found - stand.site.position);
            if p.z <= 0.0 {
                return None;
            }
            let length = p.length();
            let next = self.layout.texel(p.x, p.y, length + p.z);
            if next == at {
                return Some((texel, along));
            }
            let other = texels[next as usize];
            if matches!(other.code(), UNKNOWN | SKY) {
                return None;
            }
            let (there, _, facing) = plane(next, other);
            let footprint = self.layout.width() * (length + p.z);
            let uneven = HALF_DIAGONAL * footprint + ROUNDED * found.distance(seen);
            if facing.dot(found - there).abs() <= uneven && facing.dot(direction) < 0.0 {
                return Some((other, along));
            }
            (at, texel) = (next, other);
        }
        None
    }

    /// Follows a ray: the texel where it goes behind what the record sees, its code, and the point of the ray there. The code is
    /// [`SKY`] if the ray leaves the scene; an error: it leaves what the record knows.
    fn march(&self, id: u32, position: Vec3, direction: Vec3) -> Result<(u32, u16, Vec3), Reason> {
        let stand = &self.stands[id as usize];
        let (start, d) = (
            stand.local(position - stand.site.position),
            stand.local(direction),
        );
        let scale = self.layout.scale;
        let texel = |p: Vec3| self.layout.texel(p.x, p.y, p.length() + p.z);
        let behind = |p: Vec3| {
            let length = p.length();
            let code = self.map(id).code(self.layout.texel(p.x, p.y, length + p.z));
            code != UNKNOWN && code != SKY && length > scale.decode(code)
        };
        let [low, high] = self.settings.scene;
        let far = (high - low).length();
        // Steps grow with the distance, as texels do.
        let first = start.length().max(1e-4 * far);
        let growth = (far / first).powf(1.0 / MARCH as f32).max(1.01);
        let mut from = 0.0;
        let mut reach = first * (growth - 1.0);
        for _ in 0..MARCH {
            let p = start + d * reach;
            if p.z <= 0.0 {
                return Err(Reason::BelowHorizon);
            }
            if behind(p) {
                let mut to = reach;
                for _ in 0..BISECTIONS {
                    let middle = 0.5 * (from + to);
                    if behind(start + d * middle) {
                        to = middle;
                    } else {
                        from = middle;
                    }
                }
                let at = texel(start + d * to);
                return Ok((at, self.map(id).code(at), position + direction * to));
            }
            from = reach;
            reach = (reach + first) * growth - first;
        }
        let at = texel(start + d * far);
        Ok((at, self.map(id).code(at), position + direction * far))
    }

    /// Whether a place at `from` sees the end of a segment, by its records together: from 0 to 1, `None` if nobody knows.
    pub fn segment(
        &self,
        reader: &mut RecordsReader,
        nearby: &Nearby,
        from: Vec3,
        end: SegmentEnd,
        weight: f32,
    ) -> Option<f32> {
        let (mut seen, mut sum) = (0.0, 0.0);
        for (&id, w) in nearby.ids.iter().zip(nearby.weights) {
            if id == NOBODY {
                break;
            }
            let Some(answer) = self.segment_by(id, from, end) else {
                continue;
            };
            reader.uses[id as usize] += (w * weight * WHOLE_USE as f32) as u64;
            sum += w;
            seen += if answer { w } else { 0.0 };
            if self.settings.select == Select::Nearest {
                break;
            }
        }
        (sum > 0.0).then(|| seen / sum)
    }

    /// Whether one record sees the end of a segment; `None` if it does not know.
    pub(super) fn segment_by(&self, id: u32, from: Vec3, end: SegmentEnd) -> Option<bool> {
        let stand = &self.stands[id as usize];
        let p = match end {
            SegmentEnd::Direction(direction) => stand.local(direction),
            SegmentEnd::Point(point) | SegmentEnd::Surface(point, _) => {
                stand.local(point - stand.site.position)
            }
        };
        let texel = self.layout.texel(p.x, p.y, p.length() + p.z);
        let aim = Aim { id, texel };
        let code = u64::from(self.map(id).code(texel));
        self.sees(&SegmentAim { aim, from, end }, code).ok()
    }

    /// Whether the segment's end is seen, by the record and texel found before; an error if the record does not know.
    pub fn sees(&self, segment: &SegmentAim, texel: u64) -> Result<bool, Reason> {
        let id = segment.aim.id;
        let code = Texel(texel).code();
        let stand = &self.stands[id as usize];
        let (point, normal) = match segment.end {
            SegmentEnd::Direction(direction) => {
                if stand.site.normal.dot(direction) <= 0.0 {
                    return Err(Reason::BelowHorizon);
                }
                return match code {
                    UNKNOWN => Err(Reason::Unknown),
                    code => Ok(code == SKY),
                };
            }
            SegmentEnd::Point(point) => (point, None),
            SegmentEnd::Surface(point, normal) => (point, Some(normal)),
        };
        if self.settings.lookup == Lookup::March {
            return self.march_to(id, segment.from, point);
        }
        let offset = point - stand.site.position;
        let z = stand.site.normal.dot(offset);
        let parallax = stand.site.position.distance(segment.from);
        if offset.length() < self.contact_reach(parallax) {
            return Err(Reason::TooNear);
        }
        if z <= 0.0 {
            return Err(Reason::BelowHorizon);
        }
        if code == UNKNOWN {
            return Err(Reason::Unknown);
        }
        let (length, width) = (offset.length(), self.layout.width());
        let held = self.layout.scale.decode(code);
        Ok(match normal {
            Some(normal) => {
                let (p, n) = (stand.local(offset), stand.local(normal));
                let (there, footprint) = self.layout.facing(segment.aim.texel, n, p);
                shows(held, length, n.dot(p), there, footprint)
            }
            None => held >= length - HALF_DIAGONAL * width * (length + z),
        })
    }

    /// Whether nothing that the record sees lies in front of points of a segment.
    fn march_to(&self, id: u32, from: Vec3, to: Vec3) -> Result<bool, Reason> {
        let stand = &self.stands[id as usize];
        let place = |p: Vec3| stand.local(p - stand.site.position);
        let (start, end) = (place(from), place(to));
        if end.z <= 0.0 {
            return Err(Reason::BelowHorizon);
        }
        let width = self.layout.width();
        for k in 1..=MARCH {
            let p = start.lerp(end, k as f32 / MARCH as f32);
            if p.z <= 0.0 {
                continue;
            }
            let length = p.length();
            let code = self.map(id).code(self.layout.texel(p.x, p.y, length + p.z));
            if code == UNKNOWN {
                return Err(Reason::Unknown);
            }
            // The slant of what lies there is not known.
            let least = length - 2.0 * HALF_DIAGONAL * width * (length + p.z);
            if self.layout.scale.decode(code) < least {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// Whether a texel that holds the distance `held` shows a point on a surface at distance `length`: what it holds must be no less than the
/// distance of the surface's plane along the direction of the texel's middle, since there the map was traced. A tolerance of half a
/// footprint instead, over the cosine, lets light through whatever lies that near in front of a slanted surface.
///
/// `here` is the dot product of the surface's normal and the vector to the point, `there` that with the direction of the middle, as a
/// fraction (see [`Layout::facing`](super::paraboloid::Layout::facing)).
/// Where the surface is not as flat as its plane: what is no nearer than the point itself is enough, and nothing nearer by more than that
/// tolerance is.
#[inline(always)]
pub(super) fn shows(held: f32, length: f32, here: f32, there: [f32; 2], footprint: f32) -> bool {
    let held = held + UNEVEN * footprint;
    let (steep, least) = (here.abs(), length * (1.0 / MOST_SLANT));
    let slope = if steep > least { steep } else { least };
    let within = (length - held) * slope <= HALF_DIAGONAL * footprint * length;
    // The plane's distance is the quotient, if it is positive: else it lies behind the record, or nowhere.
    let behind_plane = here * there[0] > 0.0 && held * there[0].abs() >= here.abs() * there[1];
    (held >= length) | (within & behind_plane)
}

/// One of three records, among those that are valid.
fn pick(choice: &Nearby, select: Select, random: f32, valid: impl Fn(u32) -> bool) -> Option<u32> {
    let mut weights = choice.weights;
    for (weight, &id) in weights.iter_mut().zip(&choice.ids) {
        if id == NOBODY || !valid(id) {
            *weight = 0.0;
        }
    }
    let sum = weights[0] + weights[1] + weights[2];
    if sum.is_nan() || sum <= 0.0 {
        return None;
    }
    let positive = (0..3).filter(|&k| weights[k] > 0.0);
    if select == Select::Nearest {
        return positive.map(|k| choice.ids[k]).next();
    }
    let mut rest = random * sum;
    let mut last = None;
    for k in positive {
        last = Some(choice.ids[k]);
        if rest < weights[k] {
            break;
        }
        rest -= weights[k];
    }
    last
}
