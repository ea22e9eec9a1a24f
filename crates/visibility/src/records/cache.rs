//! The cache: records, what they are worth, and how they move.

use super::cells::{Cells, Change};
use super::map::{self, DistanceTracer, Map, Site, Stand};
use super::neighbours::{self, Index, Links, NEIGHBOURS, NOBODY};
use super::paraboloid::{Layout, UNKNOWN};
use super::ranking::Nearby;
use super::refine::StepTimes;
use super::settings::{RecordSettings, RecordsError};
use crate::two_part::Ball;
use crate::{LightEnd, SharedLight};
use glam::Vec3;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// How far from a place a record may stand that answers for it, in distances between initial records.
const REACH: f32 = 3.0;

/// Units of use that a whole weight of 1 counts.
pub const WHOLE_USE: u32 = 1 << 16;

/// Random numbers: SplitMix64.
#[derive(Clone, Debug)]
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(super) fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// A place where a record was asked for, and how much it counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSite {
    /// The place.
    pub site: Site,
    /// Its weight: `1 / d` for a vertex behind `d` scattering events (section 4.2).
    pub weight: f32,
}

impl PathSite {
    /// The places of lights that lie on surfaces, virtual lights above all; each is asked about as often as every other.
    pub fn on_lights(lights: &[SharedLight]) -> Vec<Self> {
        let sites = lights.iter().filter_map(|light| match light.end {
            LightEnd::Surface(end) => Some(Self {
                site: Site {
                    position: end.position,
                    normal: end.normal,
                    origin: light.target.unwrap_or(end.position),
                },
                weight: 1.0,
            }),
            _ => None,
        });
        sites.collect()
    }

    fn is_sound(&self) -> bool {
        self.site.position.is_finite() && self.site.normal.is_normalized()
    }
}

/// Draws places along paths from the camera, where questions will come from.
pub trait Scout {
    /// Appends about `count` places to `sites`, other ones at every call; fewer, or none, if the camera sees nothing.
    fn draw(&mut self, count: usize, sites: &mut Vec<PathSite>);

    /// Appends places that are known to be asked about, wherever paths from the camera come. None by default.
    fn asked(&mut self, sites: &mut Vec<PathSite>) {
        let _ = sites;
    }
}

/// What a cache holds and has done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecordsReport {
    /// Records.
    pub count: u32,
    /// Records at most.
    pub capacity: u32,
    /// Bytes held now.
    pub bytes: u64,
    /// Bytes held at most so far.
    pub peak_bytes: u64,
    /// Times of the refinement steps.
    pub steps: StepTimes,
    /// Rays that filled maps.
    pub fill_rays: u64,
    /// Rays that looked for places.
    pub place_rays: u64,
    /// Time of the initial distribution.
    pub initial: Duration,
    /// Time between passes: what was used is taken over, steps are taken, cells forget.
    pub upkeep: Duration,
    /// Records thrown away because they stood inside something.
    pub blind: u64,
    /// Records traced again because something moved in front of them.
    pub refilled: u64,
}

/// What is known of a record, beside its stand.
#[derive(Clone, Debug)]
pub(super) struct Slot {
    pub(super) map: Map,
    pub(super) links: Links,
    /// Distance of the farthest record that was looked at for the links.
    pub(super) d_max: f32,
    /// Correlation along each link; NaN: not known yet.
    pub(super) agreement: [f32; NEIGHBOURS],
    pub(super) utility: f32,
    /// Passes for which the utility is a guess yet.
    pub(super) fresh: u8,
}

impl Slot {
    /// Of a record whose neighbours are not known yet.
    pub(super) fn new(map: Map, utility: f32) -> Self {
        Self {
            map,
            links: [(NOBODY, 0.0); NEIGHBOURS],
            d_max: 0.0,
            agreement: [f32::NAN; NEIGHBOURS],
            utility,
            fresh: 2,
        }
    }

    pub(super) fn correlation(&self) -> f32 {
        let mut sum = 0.0;
        let mut count = 0.0;
        for (&(id, _), agreement) in self.links.iter().zip(self.agreement) {
            if id != NOBODY {
                sum += agreement;
                count += 1.0;
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// A bounded number of records, and where they stand. See the [module's description](super).
#[derive(Debug)]
pub struct Cache {
    pub(super) settings: RecordSettings,
    pub(super) layout: Layout,
    pub(super) stands: Vec<Stand>,
    pub(super) slots: Vec<Slot>,
    /// Uses in this pass, in parts of [`WHOLE_USE`].
    pub(super) uses: Vec<AtomicU64>,
    pub(super) index: Index,
    /// Distance that initial records keep from each other.
    pub(super) spacing: f32,
    /// Places of the last pilot batch that no record answers for; forgotten when the steps before a pass are done.
    pub(super) unserved: Vec<Site>,
    cells: Cells,
    version: u64,
    /// Records stand on the lights that are asked about, each for itself: no steps.
    on_lights: bool,
    /// The records are those of an earlier run ([`Self::restore`]), and nobody has asked yet.
    pub(super) restored: bool,
    pub(super) random: Random,
    /// Passes that have been learnt from.
    pub(super) passes: u64,
    pub(super) report: RecordsReport,
}

impl Cache {
    /// A cache without records.
    pub fn new(settings: RecordSettings) -> Result<Self, RecordsError> {
        settings.check()?;
        let [low, high] = settings.scene;
        let diameter = (high - low).length();
        Ok(Self {
            layout: Layout::new(settings.resolution, diameter),
            stands: Vec::new(),
            slots: Vec::new(),
            uses: Vec::new(),
            index: Index::default(),
            spacing: diameter,
            unserved: Vec::new(),
            cells: Cells::new(settings.capacity),
            version: 0,
            on_lights: false,
            restored: false,
            passes: 0,
            random: Random(settings.seed ^ 0x7265_636f_7264_7321),
            report: RecordsReport {
                capacity: settings.capacity,
                ..RecordsReport::default()
            },
            settings,
        })
    }

    /// What was chosen.
    pub fn settings(&self) -> &RecordSettings {
        &self.settings
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.stands.len()
    }

    /// Whether there are no records: nothing can be answered.
    pub fn is_empty(&self) -> bool {
        self.stands.is_empty()
    }

    /// What the cache holds and has done.
    pub fn report(&self) -> RecordsReport {
        let bytes = self.len() as u64 * self.settings.record_bytes();
        RecordsReport {
            count: self.len() as u32,
            bytes,
            peak_bytes: self.report.peak_bytes.max(bytes),
            ..self.report
        }
    }

    /// Passes that the records have learnt from ([`Self::pass_done`]), in all pictures.
    pub fn passes(&self) -> u64 {
        self.passes
    }

    /// Whether the records are those of an earlier run ([`Self::restore`]), ready for questions; true once alone.
    pub fn take_restored(&mut self) -> bool {
        std::mem::take(&mut self.restored)
    }

    pub(super) fn map(&self, id: u32) -> &Map {
        &self.slots[id as usize].map
    }

    /// Counts the changes of the records.
    pub(super) fn version(&self) -> u64 {
        self.version
    }

    /// Side of the cells that places are looked up by. Steps gather records where they are used: a cell much larger than their
    /// distance there knows the records around its middle alone.
    fn cell(&self) -> f32 {
        0.5 * self.spacing
    }

    /// Records farther than this from a place do not answer for it.
    fn reach(&self) -> f32 {
        REACH * self.spacing
    }

    /// How near to a place records have nothing to say, if they stand `parallax` away from it. What stands right in front of a place
    /// hides it from what is near, however close to the place the records have moved: hence at least their spacing.
    pub(super) fn contact_reach(&self, parallax: f32) -> f32 {
        self.settings.contact * parallax.max(self.spacing)
    }

    /// The records that answer for a place with a unit normal.
    pub fn nearby(&self, position: Vec3, normal: Vec3) -> Nearby {
        let mut found = [Nearby::NOBODY];
        self.nearby_many(&[(position, normal)], &mut found);
        found[0]
    }

    /// The records that answer for places, each told by its position and unit normal, in as many elements of `found`. About twice as fast as
    /// one by one: all wait for memory together.
    pub fn nearby_many(&self, places: &[(Vec3, Vec3)], found: &mut [Nearby]) {
        if self.is_empty() {
            return found.fill(Nearby::NOBODY);
        }
        let falloff = self.settings.falloff;
        (self.cells).choose(&self.index, &self.stands, falloff, places, found);
        let reach2 = self.reach().powi(2);
        for ((position, _), found) in places.iter().zip(found) {
            let id = found.ids[0];
            let apart2 = |id: u32| {
                let there = self.stands[id as usize].site.position;
                there.distance_squared(*position)
            };
            let near = id != NOBODY && apart2(id) < reach2;
            if !near {
                *found = Nearby::NOBODY;
            }
        }
    }

    /// Counts uses of a record, in parts of [`WHOLE_USE`].
    pub(super) fn count(&self, id: u32, uses: u64) {
        self.uses[id as usize].fetch_add(uses, Relaxed);
    }

    pub(super) fn changed(&mut self, removed: Option<Vec3>, added: Option<Vec3>) {
        self.version += 1;
        self.cells.changed(Change { removed, added });
    }

    /// Forgets what cells know of records that have gone. Else finding records takes far longer.
    pub(super) fn freshen(&mut self) {
        self.cells.freshen();
    }

    pub(super) fn changed_altogether(&mut self) {
        self.version += 1;
        self.cells.clear(self.cell());
    }

    /// The initial distribution (section 3.1): records at the vertices of camera paths, those too near to others left out. The
    /// distance to keep is found on the way: it starts large and shrinks while too few places pass. Beyond the paper, places that are
    /// asked about ([`Scout::asked`]) and would have no record near them get one.
    pub fn place_initial<T: DistanceTracer>(&mut self, tracer: &T, scout: &mut dyn Scout) {
        const DRAWN: usize = 4096;
        const SHRINK: f32 = 0.8;
        let began = Instant::now();
        let wanted = self.settings.capacity.min(self.settings.initial) as usize;
        let [low, high] = self.settings.scene;
        let mut spacing = (high - low).length() / (wanted as f32).sqrt();
        let mut sites = Vec::new();
        let mut stands: Vec<Stand> = self.stands.clone();
        let first = stands.len();
        let mut vain = 0;
        while stands.len() < wanted && vain < 60 {
            sites.clear();
            scout.draw(DRAWN, &mut sites);
            if sites.is_empty() {
                break;
            }
            self.report.place_rays += sites.len() as u64;
            let before = stands.len();
            for place in &sites {
                let stand = Stand::new(place.site);
                if stands.len() < wanted
                    && place.is_sound()
                    && !self.index.is_near(&stands, &stand, spacing, 0.5)
                {
                    self.index.insert(stands.len() as u32, place.site.position);
                    stands.push(stand);
                }
            }
            let enough = (wanted / 16).clamp(1, sites.len() / 8);
            if stands.len() < wanted && stands.len() - before < enough {
                spacing *= SHRINK;
                vain += 1;
            }
        }
        sites.clear();
        // A camera that sees nothing has no questions.
        if !stands.is_empty() {
            scout.asked(&mut sites);
        }
        // Those that came last give way: they stand where there are many already.
        let mut spare = (stands.len() - first) / 4;
        for place in &sites {
            let stand = Stand::new(place.site);
            if !place.is_sound() || self.index.is_near(&stands, &stand, REACH * spacing, 0.0) {
                continue;
            }
            if stands.len() < wanted {
                self.index.insert(stands.len() as u32, place.site.position);
                stands.push(stand);
            } else if spare > 0 {
                let id = stands.len() - (stands.len() - first) / 4 + spare - 1;
                spare -= 1;
                self.index.remove(id as u32, stands[id].site.position);
                self.index.insert(id as u32, place.site.position);
                stands[id] = stand;
            }
        }
        self.spacing = spacing;
        let threads = self.settings.threads;
        let surfaces = self.settings.surfaces;
        let new = &stands[first..];
        let maps = map::fill_all(tracer, &self.layout, new, surfaces, threads);
        self.report.fill_rays += (new.len() * self.layout.texels.len()) as u64;
        // Numbers change if some are thrown away, so the tree is made anew.
        self.index = Index::default();
        for (id, stand) in self.stands.iter().enumerate() {
            self.index.insert(id as u32, stand.site.position);
        }
        for (&stand, map) in new.iter().zip(maps) {
            if map::is_blind(&map, &self.layout, self.blind_within()) {
                self.report.blind += 1;
                continue;
            }
            self.push(stand, Slot::new(map, 1.0));
        }
        self.changed_altogether();
        for id in 0..self.len() as u32 {
            self.link(id);
        }
        for id in 0..self.len() as u32 {
            self.correlate_all(id);
        }
        self.report.initial += began.elapsed();
    }

    /// A record on each of these places, and nowhere else; those that stand there already stay. No more places than records are possible.
    pub(super) fn stand_on<T: DistanceTracer>(&mut self, tracer: &T, places: &[PathSite]) {
        let began = Instant::now();
        let [low, high] = self.settings.scene;
        self.spacing = (high - low).length() / (places.len().max(1) as f32).sqrt();
        self.on_lights = true;
        let key = |site: &Site| {
            (
                site.position.to_array().map(f32::to_bits),
                site.normal.to_array().map(f32::to_bits),
            )
        };
        let mut wanted = std::collections::HashSet::new();
        let places: Vec<&PathSite> = (places.iter())
            .filter(|place| place.is_sound() && wanted.insert(key(&place.site)))
            .collect();
        let before = self.len();
        let mut id = 0;
        while id < self.len() {
            // Asked for already: the place needs no other.
            if wanted.remove(&key(&self.stands[id].site)) {
                id += 1;
            } else {
                self.take_out(id as u32);
            }
        }
        let new: Vec<Stand> = (places.iter())
            .filter(|place| wanted.contains(&key(&place.site)))
            .map(|place| Stand::new(place.site))
            .collect();
        if new.is_empty() && self.len() == before {
            return;
        }
        let (surfaces, threads) = (self.settings.surfaces, self.settings.threads);
        let maps = map::fill_all(tracer, &self.layout, &new, surfaces, threads);
        self.report.fill_rays += (new.len() * self.layout.texels.len()) as u64;
        for (stand, map) in new.into_iter().zip(maps) {
            self.push(stand, Slot::new(map, 1.0));
        }
        self.changed_altogether();
        self.report.initial += began.elapsed();
    }

    /// No records any more, if they stood on lights: for more lights than there may be records they stand elsewhere.
    pub(super) fn leave_lights(&mut self) {
        if std::mem::take(&mut self.on_lights) {
            while let Some(last) = self.len().checked_sub(1) {
                self.take_out(last as u32);
            }
            self.changed_altogether();
        }
    }

    /// The record that stands on a light, if records stand on lights.
    pub(super) fn own(&self, position: Vec3, normal: Vec3) -> Option<u32> {
        let here = |&(id, distance): &(u32, f32)| {
            distance == 0.0 && self.stands[id as usize].site.normal == normal
        };
        let nearest = || self.index.nearest(position);
        (self.on_lights)
            .then(|| nearest().take_while(|found| found.1 == 0.0).find(here))?
            .map(|found| found.0)
    }

    /// Whether steps make records better.
    pub(super) fn can_improve(&self) -> bool {
        !self.is_empty() && !self.on_lights
    }

    /// Who sees no farther than this stands inside something.
    pub(super) fn blind_within(&self) -> f32 {
        0.02 * self.spacing
    }

    pub(super) fn push(&mut self, stand: Stand, slot: Slot) {
        let id = self.len() as u32;
        self.index.insert(id, stand.site.position);
        self.stands.push(stand);
        self.slots.push(slot);
        self.uses.push(AtomicU64::new(0));
        let bytes = self.len() as u64 * self.settings.record_bytes();
        self.report.peak_bytes = self.report.peak_bytes.max(bytes);
    }

    /// Finds the neighbours of a record; correlations along links that stay are kept.
    pub(super) fn link(&mut self, id: u32) {
        let stand = &self.stands[id as usize];
        let (links, d_max) =
            neighbours::links(&self.index, &self.stands, self.settings.falloff, stand, id);
        let slot = &mut self.slots[id as usize];
        let before = std::mem::replace(&mut slot.links, links);
        let old = std::mem::replace(&mut slot.agreement, [f32::NAN; NEIGHBOURS]);
        for (link, agreement) in slot.links.iter().zip(&mut slot.agreement) {
            if let Some(k) = before.iter().position(|other| other.0 == link.0) {
                *agreement = old[k];
            }
        }
        slot.d_max = d_max;
    }

    /// Computes correlations along the links of a record that have none yet.
    pub(super) fn correlate(&mut self, id: u32) {
        for k in 0..NEIGHBOURS {
            let slot = &self.slots[id as usize];
            let other = slot.links[k].0;
            if other != NOBODY && slot.agreement[k].is_nan() {
                let agreement = self.agreement(id, other);
                self.slots[id as usize].agreement[k] = agreement;
            }
        }
    }

    fn correlate_all(&mut self, id: u32) {
        self.slots[id as usize].agreement = [f32::NAN; NEIGHBOURS];
        self.correlate(id);
    }

    /// Takes over what has been used since the last call.
    pub fn end_pass(&mut self) {
        let used = |uses: &AtomicU64| uses.load(Relaxed);
        if self.uses.iter().all(|uses| used(uses) == 0) {
            return;
        }
        for (slot, uses) in self.slots.iter_mut().zip(&self.uses) {
            let count = uses.swap(0, Relaxed);
            if count > 0 || slot.fresh == 0 {
                slot.utility = (count as f64 / f64::from(WHOLE_USE)) as f32;
                slot.fresh = 0;
            } else {
                // A guess that nobody has confirmed yet.
                slot.fresh -= 1;
            }
        }
    }

    /// Use by places that stand for the questions to come.
    pub fn pilot(&mut self, sites: &[PathSite]) {
        self.freshen();
        self.unserved.clear();
        for place in sites {
            let choice = self.nearby(place.site.position, place.site.normal);
            if choice.ids[0] == NOBODY {
                self.unserved.push(place.site);
            }
            for (&id, weight) in choice.ids.iter().zip(choice.weights) {
                if id != NOBODY {
                    let uses = place.weight * weight * WHOLE_USE as f32;
                    self.count(id, uses as u64);
                }
            }
        }
        self.end_pass();
    }

    /// To be called when something has moved: `before` and `now` hold what moves, in the picture before and in this one, and
    /// `tracer` is about this one. Records that stood on it go; those that see where it was or is are traced again.
    pub fn moved<T: DistanceTracer>(&mut self, tracer: &T, before: &[Ball], now: &[Ball]) {
        let inside = |stand: &Stand, balls: &[Ball]| {
            let near = |ball: &Ball| ball.centre.distance(stand.site.position) <= ball.radius;
            balls.iter().any(near)
        };
        let mut id = 0;
        while id < self.len() {
            if inside(&self.stands[id], before) || inside(&self.stands[id], now) {
                self.take_out(id as u32);
            } else {
                id += 1;
            }
        }
        let sees = |id: &usize| {
            let balls = before.iter().chain(now);
            balls.clone().any(|ball| self.sees_ball(*id as u32, ball))
        };
        let stale: Vec<usize> = (0..self.len()).filter(sees).collect();
        let stands: Vec<Stand> = stale.iter().map(|&id| self.stands[id]).collect();
        let (surfaces, threads) = (self.settings.surfaces, self.settings.threads);
        let maps = map::fill_all(tracer, &self.layout, &stands, surfaces, threads);
        self.report.fill_rays += (stale.len() * self.layout.texels.len()) as u64;
        self.report.refilled += stale.len() as u64;
        for (&id, map) in stale.iter().zip(maps) {
            self.slots[id].map = map;
        }
        self.changed_altogether();
        if self.on_lights {
            return;
        }
        for id in 0..self.len() as u32 {
            self.link(id);
        }
        for id in 0..self.len() as u32 {
            let links = self.slots[id as usize].links;
            let stale = |id: u32| stale.binary_search(&(id as usize)).is_ok();
            for (k, link) in links.iter().enumerate() {
                if stale(id) || link.0 != NOBODY && stale(link.0) {
                    self.slots[id as usize].agreement[k] = f32::NAN;
                }
            }
            self.correlate(id);
        }
    }

    /// Removes a record; the last takes its number.
    fn take_out(&mut self, id: u32) {
        let last = self.len() as u32 - 1;
        let position = |cache: &Self, id: u32| cache.stands[id as usize].site.position;
        self.index.remove(id, position(self, id));
        if id != last {
            self.index.remove(last, position(self, last));
            self.index.insert(id, position(self, last));
        }
        self.stands.swap_remove(id as usize);
        self.slots.swap_remove(id as usize);
        self.uses.swap_remove(id as usize);
        for slot in &mut self.slots {
            for (link, agreement) in slot.links.iter_mut().zip(&mut slot.agreement) {
                if link.0 == id {
                    (link.0, *agreement) = (NOBODY, f32::NAN);
                } else if link.0 == last {
                    link.0 = id;
                }
            }
        }
    }

    /// Whether something in the ball could be, or hide, what a record sees.
    fn sees_ball(&self, id: u32, ball: &Ball) -> bool {
        let stand = &self.stands[id as usize];
        let centre = stand.local(ball.centre - stand.site.origin);
        let distance = centre.length();
        if distance <= ball.radius {
            return true;
        }
        if centre.z <= -ball.radius {
            return false;
        }
        let toward = centre / distance;
        // A texel more on every side.
        let angle = (ball.radius / distance).min(1.0).asin() + 3.0 * self.layout.width();
        let cos = angle.min(std::f32::consts::PI).cos();
        let nearest = (distance - ball.radius) * 0.99;
        let texels = self.layout.texels.iter().zip(&self.layout.directions);
        texels
            .filter(|(_, direction)| direction.dot(toward) >= cos)
            .any(|(&texel, _)| {
                let code = self.map(id).code(texel);
                code == UNKNOWN || self.layout.scale.decode(code) >= nearest
            })
    }
}
