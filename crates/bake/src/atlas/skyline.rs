//! Packing rectangles by their skyline (bottom-left; Jylanki 2010, "A Thousand Ways to Pack the Bin", section 2.4).

use glam::UVec2;

/// A strip of fixed width and height that fills from the top.
#[derive(Clone, Debug)]
pub(super) struct Skyline {
    size: UVec2,
    /// Left end and height of each step, from the left.
    steps: Vec<UVec2>,
    /// Rows in use.
    pub used: u32,
    /// The last rectangle, where it lies, and the step on its right.
    last: Option<(UVec2, u32, usize)>,
}

impl Skyline {
    pub fn new(size: UVec2) -> Self {
        Self {
            size,
            steps: vec![UVec2::ZERO],
            used: 0,
            last: None,
        }
    }

    /// Finds the place where the rectangle ends highest (then leftmost), and takes it. `None`: it does not fit.
    pub fn place(&mut self, rectangle: UVec2) -> Option<UVec2> {
        let (y, i) = self.beside_last(rectangle).or_else(|| self.lowest(rectangle))?;
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
        self.steps.splice(i..i + covered, new[..count].iter().copied());
        // Neighbours of one height are one step.
        let mut k = i.saturating_sub(1);
        while k + 1 < self.steps.len() && k <= i + 1 {
            if self.steps[k].y == self.steps[k + 1].y {
                self.steps.remove(k + 1);
            } else {
                k += 1;
            }
        }
        self.used = self.used.max(y + rectangle.y);
        let next = self.steps[i.saturating_sub(1)..].iter().position(|s| s.x >= right);
        self.last = next.map(|n| (rectangle, y, i.saturating_sub(1) + n));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_testkit::Random;

    #[test]
    fn rectangles_never_overlap_and_fill_well() {
        let mut random = Random(5);
        let size = UVec2::new(97, 400);
        let mut taken = vec![false; (size.x * size.y) as usize];
        let mut skyline = Skyline::new(size);
        let mut area = 0;
        for _ in 0..400 {
            let r = UVec2::new(1 + random.below(12) as u32, 1 + random.below(9) as u32);
            let at = skyline.place(r).unwrap();
            for y in at.y..at.y + r.y {
                for x in at.x..at.x + r.x {
                    let cell = &mut taken[(y * size.x + x) as usize];
                    assert!(!*cell);
                    *cell = true;
                }
            }
            area += r.x * r.y;
        }
        assert!(f64::from(area) > 0.75 * f64::from(skyline.used * size.x));
        assert!(skyline.place(UVec2::new(98, 1)).is_none());
        assert!(skyline.place(UVec2::new(1, 401)).is_none());
    }
}
