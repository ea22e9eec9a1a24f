//! What moves: animation clips, and the rest state that they replace.

use glam::{Affine3A, Quat, Vec3, Vec4};

/// Everything in a scene that moves by itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motion {
    /// Clips; all of them play together, a later channel of the same target wins.
    pub clips: Vec<Clip>,
    /// Rest transforms of the nodes that a clip may move, ascending by node.
    pub rest: Vec<RestTransform>,
    /// Rest weights of the nodes whose mesh has morph targets, ascending by node.
    pub weights: Vec<RestWeights>,
}

/// Translation, rotation and scale of a node that nothing has moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestTransform {
    /// Index into [`Scene::nodes`](crate::Scene::nodes).
    pub node: u32,
    /// Translation, metres.
    pub translation: Vec3,
    /// Unit quaternion.
    pub rotation: Quat,
    /// Scale along the node's own axes.
    pub scale: Vec3,
}

impl RestTransform {
    /// The transform that the three make.
    pub fn parent_from_node(&self) -> Affine3A {
        Affine3A::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

/// Morph weights of a node that nothing has changed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestWeights {
    /// Index into [`Scene::nodes`](crate::Scene::nodes).
    pub node: u32,
    /// One weight for each morph target of the node's mesh.
    pub weights: Vec<f32>,
}

/// One animation of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clip {
    /// Name; may be empty.
    pub name: String,
    /// Time of the last key, seconds.
    pub length: f32,
    /// What it moves.
    pub channels: Vec<Channel>,
}

/// What a channel moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Translation, 3 numbers a key.
    Translation,
    /// Rotation as quaternion x, y, z, w, 4 numbers a key.
    Rotation,
    /// Scale, 3 numbers a key.
    Scale,
    /// Morph weights, one number a morph target.
    Weights,
}

/// How values between keys are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// The key before holds.
    Step,
    /// Linear; spherical for rotations.
    #[default]
    Linear,
    /// Cubic Hermite spline; a key has an in-tangent, a value and an out-tangent.
    CubicSpline,
}

/// The course of one property of one node.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Index into [`Scene::nodes`](crate::Scene::nodes).
    pub node: u32,
    /// What it moves.
    pub target: Target,
    /// How values between keys are found.
    pub interpolation: Interpolation,
    /// Times of the keys, seconds, ascending, at least one.
    pub times: Vec<f32>,
    /// `width` numbers a key; three times as many for splines.
    pub values: Vec<f32>,
    /// Numbers a value has.
    pub width: usize,
}

impl Channel {
    /// Writes the value at `time` into `out`, which has `width` places. Held before the first and after the last key.
    pub fn sample(&self, time: f32, out: &mut [f32]) {
        let (Some(&first), Some(&last)) = (self.times.first(), self.times.last()) else {
            return;
        };
        // A time that is no number counts as the beginning.
        let time = if time >= first { time.min(last) } else { first };
        let after = self.times.partition_point(|&t| t <= time);
        let from = after.saturating_sub(1);
        let to = after.min(self.times.len() - 1);
        let span = self.times[to] - self.times[from];
        let t = if span > 0.0 {
            (time - self.times[from]) / span
        } else {
            0.0
        };
        match self.interpolation {
            Interpolation::Step => out.copy_from_slice(self.key(from, 0)),
            Interpolation::Linear => self.linear(from, to, t, out),
            Interpolation::CubicSpline => self.spline(from, to, t, span, out),
        }
    }

    /// Part `part` (in-tangent, value, out-tangent) of a key.
    fn key(&self, index: usize, part: usize) -> &[f32] {
        let parts = if self.interpolation == Interpolation::CubicSpline {
            3
        } else {
            1
        };
        let start = (index * parts + part) * self.width;
        &self.values[start..start + self.width]
    }

    fn linear(&self, from: usize, to: usize, t: f32, out: &mut [f32]) {
        let (a, b) = (self.key(from, 0), self.key(to, 0));
        if self.target == Target::Rotation {
            let quat = |v: &[f32]| unit_quaternion(Vec4::from_slice(v));
            // `slerp` takes the shorter way round.
            out.copy_from_slice(&quat(a).slerp(quat(b), t).to_array());
        } else {
            for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                *out = a + (b - a) * t;
            }
        }
    }

    /// glTF 2.0, appendix C.4: cubic Hermite spline with tangents scaled by the span.
    fn spline(&self, from: usize, to: usize, t: f32, span: f32, out: &mut [f32]) {
        let (a, leave) = (self.key(from, 1), self.key(from, 2));
        let (b, arrive) = (self.key(to, 1), self.key(to, 0));
        let (t2, t3) = (t * t, t * t * t);
        for (i, out) in out.iter_mut().enumerate() {
            *out = (2.0 * t3 - 3.0 * t2 + 1.0) * a[i]
                + span * (t3 - 2.0 * t2 + t) * leave[i]
                + (-2.0 * t3 + 3.0 * t2) * b[i]
                + span * (t3 - t2) * arrive[i];
        }
    }
}

/// The rotation that four numbers mean; the identity if they mean none.
pub(crate) fn unit_quaternion(v: Vec4) -> Quat {
    match v.try_normalize() {
        Some(unit) => Quat::from_vec4(unit),
        None => Quat::IDENTITY,
    }
}
