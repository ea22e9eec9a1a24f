//! Multiple importance sampling over all ways to cut a path in two, in constant time for each connection.
//!
//! A path with `k` vertices can be made by up to `k` strategies: `s` vertices from the light, `t = k - s` from the camera. With the power
//! heuristic (Veach 1997, section 9.2 and 10.2) strategy `s` weighs `p_s^2 / sum_i p_i^2 = 1 / (sum_i (p_i / p_s)^2)`, where `p_i` is the
//! density of the whole path under strategy `i`. Number the vertices of one subpath `v_0 .. v_i`, let `p(v_i)` be the density per square
//! metre with which it was sampled, and `q(v_i)` that with which the other side would have sampled it. Cutting one edge earlier
//! replaces `p(v_i)` by `q(v_i)`, so the terms of the sum that cut this subpath are
//!
//! ```text
//! S_i = (q(v_i) / p(v_i))^2 (c_i + S_(i-1)),   S_0 as the end demands
//! ```
//!
//! with `c_i` = 1 if the edge between `v_(i-1)` and `v_i` can be a connection (neither end scattered exactly), else 0. `q(v_(i-1))` is a
//! density per steradian at `v_i`, known once the direction beyond `v_i` is known, times a cosine and `1/d^2` that are known earlier.
//! So each vertex keeps three numbers ([`Partial`]), and the sum for any continuation costs one multiplication and addition each.
//! The idea is van Antwerpen's ("Recursive MIS computation for streaming BDPT on the GPU", 2011) and Georgiev's ("Implementing vertex
//! connection and merging", 2012); the quantities here are arranged so that `S` can be read off.
//!
//! Roulette and the probabilities of passing panes are left out of all densities: weights need only sum to one over the
//! strategies that can make a path, and any function of the path may stand for the densities. Likewise an exact (delta) scattering
//! event has density 1 in one direction and, in the other, the ratio that conserves étendue; only their quotient enters.

/// A density squared: the power heuristic's exponent. Double precision: squares of densities leave the range of single.
pub(super) fn square(density: f32) -> f64 {
    let density = f64::from(density);
    density * density
}

/// What a vertex remembers of the strategies that would have made its subpath otherwise. All squared.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Partial {
    /// `1 / p(v_i)`.
    pub(super) inverse: f64,
    /// 1 if the vertex before can be the end of a connection, else 0. At the first vertex after a light: density of the light's
    /// point by light sampling over that by emission.
    pub(super) adjacent: f64,
    /// What `S_(i-1)` is over the density per steradian towards the vertex before.
    pub(super) rest: f64,
}

impl Partial {
    /// `S_i`: all strategies that cut the subpath before this vertex, which is the end of a connection. `q` is its density per
    /// square metre from the other side, `toward_previous` the density per steradian, from there, of going on to the vertex before.
    pub(super) fn sum(&self, q: f32, toward_previous: f32) -> f64 {
        square(q) * self.inverse * (self.adjacent + square(toward_previous) * self.rest)
    }
}

/// A subpath on its way from one vertex to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Density of the direction, per steradian (per square metre across it, if `parallel`).
    pub(super) density: f32,
    /// The rays do not spread: they come from infinity or from an orthographic camera.
    pub(super) parallel: bool,
    /// Cosine at the vertex that was left; 1 where there is no surface.
    pub(super) cosine: f32,
    /// See [`Partial::adjacent`].
    pub(super) adjacent: f64,
    /// [`Partial::rest`] of the next vertex, over cosine and squared distance of the vertex that was left.
    pub(super) rest: f64,
}

impl Step {
    /// The partial sums of the vertex that is met at `distance` under `cosine`. `None` where the density is no number to divide by.
    pub(super) fn arrive(&self, distance: f32, cosine: f32) -> Option<Partial> {
        let spread = if self.parallel {
            1.0
        } else {
            distance * distance
        };
        let inverse = square(spread / (self.density * cosine));
        let rest = self.rest * square(self.cosine / spread);
        let partial = Partial {
            inverse,
            adjacent: self.adjacent,
            rest,
        };
        (inverse.is_finite() && inverse > 0.0 && rest.is_finite()).then_some(partial)
    }

    /// The step after scattering with density `pdf`; `reverse` is the density of coming the other way, `cosine` that of the new direction.
    pub(super) fn scattered(
        from: &Partial,
        adjacent: f64,
        pdf: f32,
        reverse: f32,
        cosine: f32,
    ) -> Self {
        Self {
            density: pdf,
            parallel: false,
            cosine,
            adjacent: 1.0,
            rest: from.inverse * (adjacent + square(reverse) * from.rest),
        }
    }

    /// The step after exact scattering (mirror, clear glass); `reverse` as the module says, 0 if the other side would not find it.
    pub(super) fn exact(from: &Partial, reverse: f32, cosine: f32) -> Self {
        Self {
            density: 1.0,
            parallel: false,
            cosine,
            adjacent: 0.0,
            rest: from.inverse * square(reverse) * from.rest,
        }
    }
}
