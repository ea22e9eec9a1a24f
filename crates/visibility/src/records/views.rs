//! Looking at the cache: for pictures, plots and tests.

use super::cache::Cache;
use super::map::{self, DistanceTracer, Site, Stand};
use super::neighbours::{self, NOBODY};
use super::paraboloid::{SKY, UNKNOWN};
use glam::Vec3;

/// What a record is worth, for views and plots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordView {
    /// Where it stands.
    pub site: Site,
    /// Average correlation with its neighbours, 0 to 1.
    pub correlation: f32,
    /// Use relative to the most used record, 0 to 1.
    pub utility: f32,
    /// Eq. 1.
    pub importance: f32,
}

impl Cache {
    /// What every record is worth.
    pub fn views(&self) -> Vec<RecordView> {
        let most = self.most_used();
        let pairs = self.stands.iter().zip(&self.slots);
        pairs
            .map(|(stand, slot)| RecordView {
                site: stand.site,
                correlation: slot.correlation(),
                utility: if most > 0.0 { slot.utility / most } else { 0.0 },
                importance: self.importance(slot, most),
            })
            .collect()
    }

    /// The record of the highest weight at a place, as [`Self::views`] numbers them.
    pub fn nearest(&self, position: Vec3, normal: Vec3) -> Option<u32> {
        let stand = Stand::new(Site {
            position,
            normal,
            origin: position,
        });
        let falloff = self.settings.falloff;
        let (links, _) = neighbours::links(&self.index, &self.stands, falloff, &stand, NOBODY);
        (links[0].0 != NOBODY).then_some(links[0].0)
    }

    /// Measured correlations of neighbours and the weights that predict them by `falloff`: pairs `(weight, correlation)`.
    pub fn predictions(&self, falloff: super::Falloff) -> Vec<(f32, f32)> {
        let pairs = self.stands.iter().zip(&self.slots);
        pairs
            .flat_map(|(stand, slot)| {
                let links = slot.links.iter().zip(slot.agreement);
                links
                    .filter(|((id, _), _)| *id != NOBODY)
                    .map(move |(&(id, _), agreement)| {
                        let there = &self.stands[id as usize].site;
                        let offset = there.position - stand.site.position;
                        let normal = stand.site.normal;
                        let w =
                            neighbours::weight(falloff, normal, there.normal, offset, slot.d_max);
                        (w, agreement)
                    })
            })
            .collect()
    }

    /// Mean and variance of the importance.
    pub fn importance_spread(&self) -> (f64, f64) {
        let views = self.views();
        let count = views.len().max(1) as f64;
        let values = || views.iter().map(|view| f64::from(view.importance));
        let mean = values().sum::<f64>() / count;
        let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        (mean, variance)
    }

    /// The hemisphere that a record sees, by direction: for tests and views. `None` below the horizon and where nothing is known.
    pub fn distance_seen(&self, id: u32, direction: Vec3) -> Option<f32> {
        let d = self.stands[id as usize].local(direction.normalize());
        if d.z <= 0.0 {
            return None;
        }
        let code = self.map(id).code(self.layout.texel(d.x, d.y, 1.0 + d.z));
        match code {
            UNKNOWN => None,
            SKY => Some(f32::INFINITY),
            _ => Some(self.layout.scale.decode(code)),
        }
    }

    /// Fills a map as for a record at `site`, and forgets it: for measurements. Returns how far it sees in the mean, the sky left out.
    pub fn measure_fill<T: DistanceTracer>(&self, tracer: &T, site: Site) -> f32 {
        let stand = Stand::new(site);
        let map = map::fill(tracer, &self.layout, &stand, self.settings.surfaces, 1);
        let codes = self.layout.texels.iter().map(|&texel| map.code(texel));
        let known = codes.filter(|&code| code != SKY);
        let (sum, count) = known.fold((0.0, 0.0f32), |(sum, count), code| {
            (sum + self.layout.scale.decode(code), count + 1.0)
        });
        sum / count.max(1.0)
    }

    /// Rays that fill one map.
    pub fn rays_per_fill(&self) -> usize {
        self.layout.texels.len()
    }
}
