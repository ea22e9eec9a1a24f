//! Random numbers and the warps that turn them into directions and points.

/// Where sample points come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SamplerKind {
    /// Owen-scrambled Sobol points, padded by dimension sets.
    #[default]
    Sobol,
    /// Independent numbers.
    Independent,
}

/// The sample points of one path: a pure function of seed, pixel, sample index and dimension.
///
/// Small and `Copy`, so that a batch of paths can keep one each.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    kind: SamplerKind,
    pixel_seed: u32,
    sample: u32,
    dimension: u32,
}

impl Sampler {
    /// The points of sample number `sample` of a pixel.
    pub fn new(kind: SamplerKind, seed: u64, pixel: [u32; 2], sample: u32) -> Self {
        let _ = (seed, pixel);
        Self {
            kind,
            pixel_seed: 0,
            sample,
            dimension: 0,
        }
    }

    /// Goes to a dimension set, so that the n-th decision of every path uses the same dimensions.
    pub fn jump(&mut self, dimension_set: u32) {
        self.dimension = dimension_set;
    }

    /// The next four numbers in `[0, 1)`: one dimension set.
    pub fn next(&mut self) -> [f32; 4] {
        let _ = (self.kind, self.pixel_seed, self.sample);
        todo!()
    }
}
