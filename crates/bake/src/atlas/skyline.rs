//! Packing rectangles by their skyline (bottom-left; Jylanki 2010, "A Thousand Ways to Pack the Bin", section 2.4).

use glam::UVec2;

/// A strip of fixed width and height that fills from the top.
#[derive(Clone, Debug)]
struct Skyline {
    size: UVec2,
    /// Left end and height of each step, from the left.
    steps: Vec<UVec2>,
    /// The last rectangle, where it lies, and the step on its right.
    last: Option<(UVec2, u32, usize)>,
}

impl Skyline {
    fn new(size: UVec2) -> Self {
        Self {
            size,
            steps: vec![UVec2::ZERO],
            last: None,
        }
    }

    /// Finds the place where the rectangle ends highest (then leftmost), and takes it. `None`: it does not fit.
    fn place(&mut self, rectangle: UVec2) -> Option<UVec2> {
        let (y, i) = self
            .beside_last(rectangle)
            .or_else(|| self.lowest(rectangle))?;
        let at = UVec2::new(self.steps[i].x, y);
        self.take(i, at, rectangle);
        Some(at)
    }

    /// Rectangles often come in rows of equals. What is as low as the last place, which was the lowest then, is the lowest now.
    fn beside_last(&self, rectangle: UVec2) -> Option<(u32, usize)> {
        let (last, y, next) = self.last?;
        let alike = last.x == rectangle.x && rectangle.y <= last.y;
        (alike && self.height(next, rectangle, y) == Some(y)).then_some((y, next))
    }

    fn lowest(&self, rectangle: UVec2) -> Option<(u32, usize)> {
        let mut best: Option<(u32, usize)> = None;
        for i in 0..self.steps.len() {
            let limit = best.map_or(u32::MAX, |(y, _)| y - 1);
            if let Some(y) = self.height(i, rectangle, limit) {
                best = Some((y, i));
                if y == 0 {
                    break;
                }
            }
        }
        best
    }

    /// Where a rectangle comes to lie whose left end is that of step `i`; `None` if that is below `limit`, or outside.
    fn height(&self, i: usize, rectangle: UVec2, limit: u32) -> Option<u32> {
        let step = self.steps.get(i)?;
        let right = step.x + rectangle.x;
        let limit = limit.min(self.size.y.checked_sub(rectangle.y)?);
        if right > self.size.x {
            return None;
        }
        let mut y = step.y;
        for later in &self.steps[i + 1..] {
            if y > limit || later.x >= right {
                break;
            }
            y = y.max(later.y);
        }
        (y <= limit).then_some(y)
    }

    fn take(&mut self, i: usize, at: UVec2, rectangle: UVec2) {
        let (y, right) = (at.y, at.x + rectangle.x);
        // The last step that begins left of the new right end goes on from there.
        let covered = self.steps[i..].iter().take_while(|s| s.x < right).count();
        let rest = UVec2::new(right, self.steps[i + covered - 1].y);
        let next = self.steps.get(i + covered).map_or(self.size.x, |s| s.x);
        let new = [UVec2::new(at.x, y + rectangle.y), rest];
        let count = if right < next { 2 } else { 1 };
        self.steps
            .splice(i..i + covered, new[..count].iter().copied());
        // Neighbours of one height are one step.
        let mut k = i.saturating_sub(1);
        while k + 1 < self.steps.len() && k <= i + 1 {
            if self.steps[k].y == self.steps[k + 1].y {
                self.steps.remove(k + 1);
            } else {
                k += 1;
            }
        }
        let next = self.steps[i.saturating_sub(1)..]
            .iter()
            .position(|s| s.x >= right);
        self.last = next.map(|n| (rectangle, y, i.saturating_sub(1) + n));
    }
}

/// The bin of a rectangle and its place there.
pub(super) type Place = (u32, UVec2);

/// Bins, texels of the last one, its longer side.
type Cost = (usize, u64, u32);

/// Rectangles, those in front first, into one strip or several (`most` wide and high at most), whose width is chosen so that they
/// take little space. Returns the bin and the place of each; bins are filled one after the other.
pub(super) fn pack(rectangles: &[UVec2], most: u32) -> Vec<Place> {
    /// Lists longer than this fill any width well.
    const FEW: usize = 3000;
    let area: u64 = rectangles
        .iter()
        .map(|r| u64::from(r.x) * u64::from(r.y))
        .sum();
    let widest = rectangles.iter().map(|r| r.x).max().unwrap_or(1);
    let side = ((area as f64).sqrt() as u32 + 1).max(1);
    let widths: Vec<u32> = if side >= most {
        vec![most]
    } else if rectangles.len() > FEW {
        vec![side + side / 50]
    } else {
        (0..14)
            .map(|k| (f64::from(side) * (0.8 + 0.08 * f64::from(k))) as u32 + 1)
            .collect()
    };
    let mut best: Option<(Cost, Vec<Place>)> = None;
    for width in widths {
        let width = width.clamp(widest.min(most), most);
        let (places, bins) = fill(rectangles, width, most);
        // As few bins as possible, then as small as possible, then as square as possible.
        let size = used(rectangles, &places, bins - 1);
        let cost = (
            bins,
            u64::from(size.x) * u64::from(size.y),
            size.max_element(),
        );
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, places));
        }
    }
    best.map_or_else(Vec::new, |(_, places)| places)
}

/// Width and height in use of a bin.
fn used(rectangles: &[UVec2], places: &[Place], bin: usize) -> UVec2 {
    let of_bin = rectangles
        .iter()
        .zip(places)
        .filter(|(_, p)| p.0 as usize == bin);
    of_bin.fold(UVec2::ZERO, |size, (&r, &(_, at))| size.max(at + r))
}

fn fill(rectangles: &[UVec2], width: u32, height: u32) -> (Vec<Place>, usize) {
    let new = || Skyline::new(UVec2::new(width, height));
    let mut open = vec![new()];
    let places = rectangles.iter().map(|&rectangle| {
        // Earlier bins are full but for gaps; only the last two are worth asking.
        let found = (open.len().saturating_sub(2)..open.len())
            .find_map(|p| open[p].place(rectangle).map(|at| (p as u32, at)));
        found.unwrap_or_else(|| {
            open.push(new());
            let bin = open.len() - 1;
            // An empty bin takes every rectangle that is no larger than a bin.
            (
                bin as u32,
                open[bin].place(rectangle).unwrap_or(UVec2::ZERO),
            )
        })
    });
    let places = places.collect();
    (places, open.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_testkit::random::Random;

    #[test]
    fn rectangles_never_overlap_and_fill_well() {
        let mut random = Random(5);
        let rectangles: Vec<UVec2> = (0..400)
            .map(|_| UVec2::new(1 + random.below(12) as u32, 1 + random.below(9) as u32))
            .collect();
        for most in [400, 60] {
            let places = pack(&rectangles, most);
            let bins = places.iter().map(|p| p.0).max().unwrap() as usize + 1;
            let mut taken = vec![false; bins * (most * most) as usize];
            for (r, (bin, at)) in rectangles.iter().zip(&places) {
                assert!((at + r).max_element() <= most);
                for y in at.y..at.y + r.y {
                    for x in at.x..at.x + r.x {
                        let cell = &mut taken[((bin * most + y) * most + x) as usize];
                        assert!(!*cell);
                        *cell = true;
                    }
                }
            }
            let area: u32 = rectangles.iter().map(|r| r.x * r.y).sum();
            let spent: u32 = (0..bins)
                .map(|b| used(&rectangles, &places, b).element_product())
                .sum();
            assert!(
                f64::from(area) > 0.85 * f64::from(spent),
                "{area} of {spent}"
            );
        }
    }
}
