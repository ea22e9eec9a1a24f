//! Counters, kept where the events happen.

/// What a visibility strategy did. Ray reduction is `queries / traced`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibilityStats {
    /// Questions asked.
    pub queries: u64,
    /// Questions answered without tracing a full ray.
    pub answered: u64,
    /// Rays traced for the rest, refinement and duplicate misses included.
    pub traced: u64,
    /// Questions refined, by level.
    pub refined: Vec<u64>,
    /// Rays that filled records.
    pub fill: u64,
}

impl VisibilityStats {
    /// Adds the counters of another worker.
    pub fn add(&mut self, other: &Self) {
        self.queries += other.queries;
        self.answered += other.answered;
        self.traced += other.traced;
        self.fill += other.fill;
        if self.refined.len() < other.refined.len() {
            self.refined.resize(other.refined.len(), 0);
        }
        for (sum, n) in self.refined.iter_mut().zip(&other.refined) {
            *sum += n;
        }
    }
}
