//! Small flat patches that shine to one side, such as bright texels of a light map: which one to ask.
//!
//! A [`Tree`] over what the patches send out, without the lights of a scene around it. Wrong tool for patches that are large from
//! where they are seen: the tree knows spheres.

use super::select::fine_place;
use super::tree::{Bounds, Tree};
use glam::{Vec2, Vec3};

/// A patch.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Middle of a sphere that holds it, metres.
    pub center: Vec3,
    /// Radius of that sphere, metres.
    pub radius: f32,
    /// Unit vector to where it shines.
    pub normal: Vec3,
    /// Parts of it may face up to this angle away from that, radians.
    pub spread: f32,
    /// Luminance times area, W/sr; positive.
    pub intensity: f32,
}

/// Patches that are picked by what they could give to a point.
#[derive(Debug)]
pub struct Patches {
    tree: Option<Tree>,
}

impl Patches {
    /// Bytes that a patch takes at most.
    pub const BYTES: usize = Tree::BYTES_PER_LIGHT;

    /// Sorts patches, fewer than 2^31, into a tree. O(n log n).
    pub fn new(patches: &[Patch]) -> Self {
        let bounds: Vec<_> = patches.iter().map(Bounds::of_patch).collect();
        Self {
            tree: (!bounds.is_empty()).then(|| Tree::new(&bounds)),
        }
    }

    /// Picks one for a point on a surface with this unit normal: its number and the probability of that. `pick` is in `[0, 1)`, as is `u`, which
    /// may choose the point on the patch afterwards. `None`: nothing shines there, or so it turned out on the way down.
    pub fn pick(&self, position: Vec3, normal: Vec3, pick: f32, u: Vec2) -> Option<(usize, f32)> {
        let tree = self.tree.as_ref()?;
        let root = tree.promise(position, normal);
        let x = f64::from(fine_place(pick, u)) / (1_u64 << 32) as f64;
        tree.pick(position, normal, &root, x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use occlude_testkit::random::Random;

    #[test]
    fn picks_have_the_probability_that_is_said() {
        let mut random = Random(3);
        let mut unit = || random.unit();
        let patches: Vec<Patch> = (0..40)
            .map(|_| Patch {
                center: Vec3::new(4.0 * unit(), 4.0 * unit(), 2.0),
                radius: 0.05,
                normal: -Vec3::Z,
                spread: 0.0,
                intensity: 0.1 + unit(),
            })
            .collect();
        let all = Patches::new(&patches);
        let place = Vec3::new(1.0, 1.0, 0.0);
        // The expectation of 1 / probability over picks of a patch is the number of times that it can be picked: once.
        let picks = 40_000;
        let mut counts = vec![0.0; patches.len()];
        for _ in 0..picks {
            let u = Vec2::new(unit(), unit());
            let (patch, pmf) = all.pick(place, Vec3::Z, unit(), u).unwrap();
            counts[patch] += 1.0 / (f64::from(pmf) * f64::from(picks));
        }
        for (patch, count) in counts.iter().enumerate() {
            // The rarest is picked some hundred times: six standard errors.
            assert!((count - 1.0).abs() < 0.5, "{patch}: {count}");
        }
        assert!(
            all.pick(place, -Vec3::Z, 0.5, Vec2::ZERO).is_none(),
            "behind"
        );
        assert!(
            Patches::new(&[])
                .pick(place, Vec3::Z, 0.5, Vec2::ZERO)
                .is_none()
        );
    }
}
