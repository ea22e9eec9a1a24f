//! Which of some boxes any segment between two sets of points can meet, found for all such segments at once.
//!
//! All segments from a box A to a box B lie, at parameter t, in the box `(1 - t) A + t B`; and every point of it is on such a
//! segment. So the hull of both ends meets a box C exactly if for some t in [0, 1] the moving box overlaps C: along each axis two
//! inequalities that are linear in t, as in the slab test of a ray, with other origins and speeds for lower and upper
//! faces. (Haines & Wallace 1994, "Shaft culling", test planes through edges of the two boxes instead.)

use glam::Vec3;

/// Boxes that are tested together.
const WIDE: usize = 8;

/// How far a ray's meeting with a triangle may lie from where it is in exact numbers, in parts of the largest coordinate:
/// 128 times the rounding of a coordinate.
const SLACK: f32 = 128.0 * f32::EPSILON;

/// A set of boxes, at most [`Boxes::MOST`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Boxes {
    rows: Vec<Row>,
    /// Largest coordinate.
    largest: f32,
}

/// Lower and upper corners of eight boxes, axis by axis.
#[derive(Clone, Copy, Debug)]
struct Row {
    lower: [[f32; WIDE]; 3],
    upper: [[f32; WIDE]; 3],
}

/// An axis-aligned box around some points, or around some directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    pub(crate) lower: Vec3,
    pub(crate) upper: Vec3,
}

/// Where segments end.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Towards {
    /// In a box.
    Points(Span),
    /// Infinitely far away, along one of these directions.
    Directions(Span),
}

impl Span {
    /// The box around points; inside out, if there are none.
    pub(crate) fn around(points: impl IntoIterator<Item = Vec3>) -> Self {
        let nothing = Self {
            lower: Vec3::INFINITY,
            upper: Vec3::NEG_INFINITY,
        };
        points.into_iter().fold(nothing, |span, point| Self {
            lower: span.lower.min(point),
            upper: span.upper.max(point),
        })
    }

    #[inline(always)]
    fn largest(&self) -> f32 {
        self.lower.abs().max(self.upper.abs()).max_element()
    }
}

impl Boxes {
    /// As many as a set of bits has.
    pub(crate) const MOST: usize = u64::BITS as usize;

    /// Boxes by lower and upper corners; those beyond the most are merged into the last.
    pub(crate) fn new(boxes: impl IntoIterator<Item = (Vec3, Vec3)>) -> Self {
        let mut all = Self::default();
        for (number, (lower, upper)) in boxes.into_iter().enumerate() {
            let number = number.min(Self::MOST - 1);
            if number / WIDE == all.rows.len() {
                all.rows.push(Row {
                    lower: [[f32::INFINITY; WIDE]; 3],
                    upper: [[f32::NEG_INFINITY; WIDE]; 3],
                });
            }
            let row = &mut all.rows[number / WIDE];
            for axis in 0..3 {
                let lane = number % WIDE;
                row.lower[axis][lane] = row.lower[axis][lane].min(lower[axis]);
                row.upper[axis][lane] = row.upper[axis][lane].max(upper[axis]);
            }
            all.largest = all.largest.max(Span { lower, upper }.largest());
        }
        all
    }

    /// Which of the boxes `among` (bits) some segment from a point of `start` may meet; boxes missed by less than rounding are
    /// among them.
    #[inline(always)]
    pub(crate) fn met(&self, start: &Span, end: &Towards, among: u64) -> u64 {
        let (lower_speed, upper_speed, last, farthest) = match end {
            Towards::Points(end) => (
                end.lower - start.lower,
                end.upper - start.upper,
                1.0,
                end.largest(),
            ),
            Towards::Directions(end) => (end.lower, end.upper, f32::MAX, 0.0),
        };
        let slack = SLACK * start.largest().max(farthest).max(self.largest);
        let (lower, upper) = (start.lower - slack, start.upper + slack);
        let mut met = 0;
        for (number, row) in self.rows.iter().enumerate() {
            let shift = number * WIDE;
            if among >> shift & 0xff == 0 {
                continue;
            }
            // A minimum or maximum with what is no number leaves the other: such a face culls nothing.
            let (mut enter, mut exit) = ([0.0f32; WIDE], [last; WIDE]);
            for axis in 0..3 {
                let per_speed = 1.0 / moving(lower_speed[axis]);
                let times = row.upper[axis].map(|face| (face - lower[axis]) * per_speed);
                if per_speed > 0.0 {
                    exit = std::array::from_fn(|i| exit[i].min(times[i]));
                } else {
                    enter = std::array::from_fn(|i| enter[i].max(times[i]));
                }
                let per_speed = 1.0 / moving(upper_speed[axis]);
                let times = row.lower[axis].map(|face| (face - upper[axis]) * per_speed);
                if per_speed > 0.0 {
                    enter = std::array::from_fn(|i| enter[i].max(times[i]));
                } else {
                    exit = std::array::from_fn(|i| exit[i].min(times[i]));
                }
            }
            for lane in 0..WIDE {
                let missed = enter[lane] > exit[lane];
                met |= u64::from(!missed) << (shift + lane);
            }
        }
        met & among
    }
}

/// A speed that can be divided by: what stands still moves unnoticeably.
#[inline(always)]
fn moving(speed: f32) -> f32 {
    if speed.abs() < f32::MIN_POSITIVE {
        f32::MIN_POSITIVE
    } else {
        speed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(11);
            (self.0 >> 40) as f32 / (1 << 24) as f32
        }

        /// Often on a lattice, so that faces touch.
        fn point(&mut self, scale: f32) -> Vec3 {
            let place = Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0;
            if self.next() < 0.5 {
                (place * 4.0).round() * 0.25 * scale
            } else {
                place * scale
            }
        }

        fn span(&mut self, scale: f32) -> Span {
            let count = 1 + (3.0 * self.next()) as usize;
            let centre = self.point(scale);
            let size = scale * self.next();
            Span::around((0..count).map(|_| centre + self.point(size)))
        }

        fn inside(&mut self, span: &Span) -> Vec3 {
            let at = Vec3::new(self.next(), self.next(), self.next());
            let at = if self.next() < 0.3 { at.round() } else { at };
            span.lower + (span.upper - span.lower) * at
        }
    }

    /// Whether a segment meets a box, in exact enough numbers.
    fn meets(start: DVec3, way: DVec3, last: f64, span: &Span) -> bool {
        let (mut enter, mut exit) = (0.0f64, last);
        for axis in 0..3 {
            let to = [span.lower, span.upper].map(|corner| f64::from(corner[axis]) - start[axis]);
            if way[axis] == 0.0 {
                if to[0] > 0.0 || to[1] < 0.0 {
                    return false;
                }
            } else {
                let times = to.map(|to| to / way[axis]);
                enter = enter.max(times[0].min(times[1]));
                exit = exit.min(times[0].max(times[1]));
            }
        }
        enter <= exit
    }

    #[test]
    fn no_segment_meets_a_box_that_is_culled() {
        let mut random = Random(5);
        let (mut met, mut culled, mut really) = (0, 0, 0);
        for case in 0..4000 {
            let scale = [1.0, 1e-3, 1e5, 1e12][case % 4];
            let boxes: Vec<Span> = (0..11).map(|_| random.span(scale)).collect();
            let set = Boxes::new(boxes.iter().map(|b| (b.lower, b.upper)));
            let start = random.span(scale);
            let distant = case % 3 == 0;
            let end = if distant {
                random.span(1.0)
            } else {
                random.span(scale)
            };
            let found = if distant {
                set.met(&start, &Towards::Directions(end), u64::MAX)
            } else {
                set.met(&start, &Towards::Points(end), u64::MAX)
            };
            assert_eq!(found >> boxes.len(), 0, "boxes that are not there");
            for _ in 0..20 {
                let from = random.inside(&start).as_dvec3();
                let to = random.inside(&end).as_dvec3();
                let (way, last) = if distant {
                    (to, 1e30)
                } else {
                    (to - from, 1.0)
                };
                for (number, span) in boxes.iter().enumerate() {
                    let found = found >> number & 1 != 0;
                    let meets = meets(from, way, last, span);
                    assert!(found || !meets, "case {case}");
                    really += u32::from(meets);
                    met += u32::from(found);
                    culled += u32::from(!found);
                }
            }
        }
        assert!(
            really > 10_000 && culled > 400_000,
            "{really} of {met}, {culled}"
        );
    }

    /// The test is exact: a single ray's answer is the slab test's, but for the slack.
    #[test]
    fn a_single_segment_meets_what_it_meets() {
        let mut random = Random(9);
        let mut wrong = 0;
        for _ in 0..20_000 {
            let span = random.span(1.0);
            let point = |p: Vec3| Span { lower: p, upper: p };
            let (a, b) = (random.point(1.0), random.point(1.0));
            let set = Boxes::new([(span.lower, span.upper)]);
            let found = set.met(&point(a), &Towards::Points(point(b)), 1) != 0;
            let (start, way) = (a.as_dvec3(), (b - a).as_dvec3());
            let larger = Span {
                lower: span.lower - 1e-4,
                upper: span.upper + 1e-4,
            };
            assert!(found || !meets(start, way, 1.0, &span));
            assert!(!found || meets(start, way, 1.0, &larger));
            wrong += u32::from(found != meets(start, way, 1.0, &span));
        }
        assert!(wrong < 200, "{wrong}");
    }

    #[test]
    fn too_many_boxes_are_merged() {
        let place = |i: usize| Vec3::new(i as f32, 0.0, 0.0);
        let set = Boxes::new((0..100).map(|i| (place(i), place(i) + 0.5)));
        let at = |x: f32| {
            let p = Vec3::new(x, 0.25, 0.25);
            let span = Span { lower: p, upper: p };
            set.met(&span, &Towards::Points(span), u64::MAX)
        };
        assert_eq!(at(3.25), 1 << 3);
        assert_eq!(at(3.75), 0);
        assert_eq!(at(80.25), 1 << 63);
        assert_eq!(
            Boxes::default().met(
                &Span::around([Vec3::ZERO]),
                &Towards::Points(Span::around([Vec3::ONE])),
                u64::MAX
            ),
            0
        );
    }
}
