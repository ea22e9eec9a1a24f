//! Which backs matter: those that something sees that is seen.
//!
//! Walls have an inside, floors an underside: nobody looks at those, and light that arrives there goes nowhere. A back matters if
//! a front sees it, or another back that matters. A few bundles with sparse lines find out, for runs of texels at a time; what
//! they miss is seen so rarely that it does not count, and is black. Closed meshes need no rule of their own.

use super::fragments::{Fragment, front};
use super::transport::{Counts, Lines};
use super::triangles::{BACK_RUN, Triangles};
use super::work::{Bundle, Setting};
use super::{Directions, Settings, Stats};
use occlude_render::job::Job;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// Directions that look for backs, and lines per texel in each.
pub(crate) const DIRECTIONS: u32 = 48;
pub(crate) const FACTOR: f32 = 1.0 / 8.0;

impl Triangles<'_> {
    /// Finds the backs that matter and gives them numbers. Deterministic. Takes as long as about ten directions of [`gather`](super::gather).
    pub fn find_backs(&mut self, seed: u64, settings: &Settings, job: &Job) -> Stats {
        let runs = self.sides().fronts_count().div_ceil(BACK_RUN) as usize;
        let mut known = vec![false; runs];
        let found: Vec<AtomicBool> = (0..runs).map(|_| AtomicBool::new(false)).collect();
        let settings = Settings {
            factor: settings.factor * FACTOR,
            ..*settings
        };
        let directions = Directions {
            seed,
            round: u32::MAX,
        };
        let mut bundle = Bundle::new(self, &settings);
        let mut stats = Stats::default();
        for index in 0..DIRECTIONS {
            if job.is_cancelled() {
                break;
            }
            let setting = Setting {
                triangles: self,
                direction: directions.direction(index),
                settings: &settings,
            };
            let looker = || Looker {
                known: &known,
                found: &found,
                below: None,
            };
            stats += bundle.run(&setting, &looker);
            // Not while threads look: what they find must not depend on who was first.
            for (known, found) in known.iter_mut().zip(&found) {
                *known = found.load(Relaxed);
            }
        }
        self.number_backs(known.into_iter());
        stats
    }
}

/// Looks along lines for backs.
struct Looker<'a> {
    known: &'a [bool],
    found: &'a [AtomicBool],
    /// What looks up at the end of the line so far: its run, and whether it is a front.
    below: Option<(u32, bool)>,
}

impl Looker<'_> {
    fn matters(&self, (run, front): (u32, bool)) -> bool {
        front || self.known[run as usize]
    }

    /// `seen` is seen by `by`.
    fn look(&self, seen: (u32, bool), by: (u32, bool)) {
        if !seen.1 && self.matters(by) && !self.known[seen.0 as usize] {
            self.found[seen.0 as usize].store(true, Relaxed);
        }
    }
}

impl Lines for Looker<'_> {
    fn set_weight(&mut self, _: f32) {}

    fn surfaces(&mut self, fragments: &[Fragment]) {
        for &fragment in fragments {
            let (front, along) = front(fragment);
            let run = front / BACK_RUN;
            let down = (run, !along);
            if let Some(below) = self.below {
                self.look(down, below);
                self.look(below, down);
            }
            self.below = Some((run, along));
        }
    }

    fn end_line(&mut self) {
        self.below = None;
    }

    fn finish(&mut self) {}

    fn counts(&self) -> Counts {
        Counts::default()
    }
}
