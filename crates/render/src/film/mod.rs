//! The film: what the camera has gathered so far.
//!
//! Every pixel keeps order-independent sums ([`FixedSum`]) of radiance and of squared luminance, and its number of
//! samples. Films of disjoint samples merge into exactly the film that one run would have made; a checkpoint is a film.

mod file;
mod fixed;
mod layers;
mod splats;

pub use file::FilmError;
pub use fixed::FixedSum;
pub use layers::Aovs;
pub use splats::Splat;

use glam::Vec3;
use splats::SplatSums;

/// Weights of linear Rec. 709 red, green and blue in luminance.
pub const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// First-hit facts about one sample, for denoisers and compositing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Features {
    /// Albedo of the first surface, or the sky's radiance clamped to 1 where there is none.
    pub albedo: Vec3,
    /// World-space shading normal of the first surface, or zero.
    pub normal: Vec3,
    /// Distance to the first surface, metres, or 0.
    pub depth: f32,
}

/// Sums of one pixel's features: albedo, normal, depth.
type FeatureSums = [FixedSum; 7];

/// Accumulated samples of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    width: u32,
    height: u32,
    radiance: Vec<[FixedSum; 3]>,
    squares: Vec<FixedSum>,
    samples: Vec<u32>,
    features: Option<Vec<FeatureSums>>,
    splats: Option<Vec<SplatSums>>,
    dropped: u64,
}

/// The finished values of a film, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Developed {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Mean radiance.
    pub radiance: Vec<[f32; 3]>,
    /// Variance of the mean's luminance (0 with fewer than two samples).
    pub variance: Vec<f32>,
    /// Mean albedo, normal and depth, if they were recorded.
    pub features: Option<Vec<Features>>,
}

/// Samples of a rectangle of pixels, gathered by one worker before they go to the film.
#[derive(Debug)]
pub struct FilmTile {
    x: u32,
    y: u32,
    film: Film,
}

/// Some rows of a film.
#[derive(Debug)]
pub struct FilmBand<'a> {
    width: u32,
    /// The first row.
    first: u32,
    radiance: &'a mut [[FixedSum; 3]],
    squares: &'a mut [FixedSum],
    samples: &'a mut [u32],
    features: Option<&'a mut [FeatureSums]>,
}

impl Film {
    /// An empty film of `width` x `height` pixels, with feature sums if asked.
    pub fn new(width: u32, height: u32, features: bool) -> Self {
        let pixels = width as usize * height as usize;
        Self {
            width,
            height,
            radiance: vec![[FixedSum::default(); 3]; pixels],
            squares: vec![FixedSum::default(); pixels],
            samples: vec![0; pixels],
            features: features.then(|| vec![FeatureSums::default(); pixels]),
            splats: None,
            dropped: 0,
        }
    }

    /// Makes room for splats, if there is none yet.
    pub fn enable_splats(&mut self) {
        let pixels = self.samples.len();
        self.splats
            .get_or_insert_with(|| vec![SplatSums::default(); pixels]);
    }

    /// Whether there is room for splats.
    pub fn has_splats(&self) -> bool {
        self.splats.is_some()
    }

    /// Bytes that room for splats takes beside [`Film::bytes`].
    pub fn splat_bytes(width: u32, height: u32) -> u64 {
        u64::from(width) * u64::from(height) * size_of::<SplatSums>() as u64
    }

    /// Bytes that a film of this size takes.
    pub fn bytes(width: u32, height: u32, features: bool) -> u64 {
        let pixel = 4 * size_of::<FixedSum>()
            + 4
            + if features {
                size_of::<FeatureSums>()
            } else {
                0
            };
        u64::from(width) * u64::from(height) * pixel as u64
    }

    /// Pixels a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Whether albedo, normal and depth are recorded.
    pub fn has_features(&self) -> bool {
        self.features.is_some()
    }

    /// Samples that were not finite and count as black.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Samples that a pixel has.
    ///
    /// # Panics
    /// If the pixel is outside.
    pub fn samples_at(&self, x: u32, y: u32) -> u32 {
        self.samples[self.index(x, y)]
    }

    /// Samples of the pixel that has the fewest.
    pub fn min_samples(&self) -> u32 {
        self.samples.iter().copied().min().unwrap_or(0)
    }

    fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.width as usize + x as usize
    }

    /// Adds one sample. A sample that is not finite counts as black and is reported by [`Film::dropped`].
    ///
    /// # Panics
    /// If the pixel is outside.
    pub fn add(&mut self, x: u32, y: u32, radiance: Vec3, features: Option<&Features>) {
        let dropped = self.whole().add(x, y, radiance, features);
        self.dropped += u64::from(dropped);
    }

    fn whole(&mut self) -> FilmBand<'_> {
        FilmBand {
            width: self.width,
            first: 0,
            radiance: &mut self.radiance,
            squares: &mut self.squares,
            samples: &mut self.samples,
            features: self.features.as_deref_mut(),
        }
    }

    /// The film cut into bands of so many rows (the last may have fewer), from the top, for workers that add to one each.
    pub fn bands(&mut self, rows: u32) -> Vec<FilmBand<'_>> {
        let mut rest = self.whole();
        let mut bands = Vec::new();
        let size = rows.max(1) as usize * rest.width as usize;
        while rest.samples.len() > size {
            let (radiance, radiance_rest) = rest.radiance.split_at_mut(size);
            let (squares, squares_rest) = rest.squares.split_at_mut(size);
            let (samples, samples_rest) = rest.samples.split_at_mut(size);
            let (features, features_rest) = match rest.features {
                Some(features) => {
                    let (features, rest) = features.split_at_mut(size);
                    (Some(features), Some(rest))
                }
                None => (None, None),
            };
            bands.push(FilmBand {
                width: rest.width,
                first: rest.first,
                radiance,
                squares,
                samples,
                features,
            });
            rest = FilmBand {
                width: rest.width,
                first: rest.first + rows.max(1),
                radiance: radiance_rest,
                squares: squares_rest,
                samples: samples_rest,
                features: features_rest,
            };
        }
        bands.push(rest);
        bands
    }

    /// Counts samples of bands that were not finite.
    pub fn add_dropped(&mut self, samples: u64) {
        self.dropped += samples;
    }

    /// Adds a splat. Each sample of each pixel stands for one light path, whether it brought splats or not. A splat that is
    /// not finite counts as black and is reported by [`Film::dropped`].
    ///
    /// # Panics
    /// If the pixel is outside, or the film has no room for splats.
    pub fn splat(&mut self, splat: &Splat) {
        let i = self.index(splat.x, splat.y);
        if !splat.radiance.is_finite() {
            self.dropped += 1;
            return;
        }
        let splats = self.splats.as_mut().expect("splats were enabled");
        splats::add(&mut splats[i], splat.radiance);
    }

    /// What a sum of splats is multiplied with.
    fn splat_scale(&self) -> f64 {
        let paths: u64 = self.samples.iter().map(|&n| u64::from(n)).sum();
        self.samples.len() as f64 / paths.max(1) as f64
    }

    /// An empty tile whose top left pixel is (x, y) of this film.
    pub fn tile(&self, x: u32, y: u32, width: u32, height: u32) -> FilmTile {
        FilmTile {
            x,
            y,
            film: Film::new(width, height, self.has_features()),
        }
    }

    /// Adds the samples of a tile.
    ///
    /// # Panics
    /// If the tile lies outside.
    pub fn add_tile(&mut self, tile: &FilmTile) {
        let part = &tile.film;
        for row in 0..part.height {
            let from = part.index(0, row);
            let to = self.index(tile.x, tile.y + row);
            self.merge_run(part, from, to, part.width as usize);
        }
        self.dropped += part.dropped;
    }

    /// Adds the samples of a film of the same size and kind.
    ///
    /// # Panics
    /// If size or kind differ.
    pub fn merge(&mut self, other: &Self) {
        let kind = |film: &Self| {
            let (features, splats) = (film.has_features(), film.has_splats());
            (film.width, film.height, features, splats)
        };
        assert_eq!(kind(self), kind(other));
        self.merge_run(other, 0, 0, self.samples.len());
        if let (Some(sums), Some(parts)) = (&mut self.splats, &other.splats) {
            let parts = parts.iter().flatten();
            for (sum, part) in sums.iter_mut().flatten().zip(parts) {
                sum.merge(*part);
            }
        }
        self.dropped += other.dropped;
    }

    fn merge_run(&mut self, other: &Self, from: usize, to: usize, pixels: usize) {
        for (i, j) in (from..from + pixels).zip(to..) {
            for channel in 0..3 {
                self.radiance[j][channel].merge(other.radiance[i][channel]);
            }
            self.squares[j].merge(other.squares[i]);
            self.samples[j] += other.samples[i];
            if let (Some(sums), Some(parts)) = (&mut self.features, &other.features) {
                for (sum, part) in sums[j].iter_mut().zip(parts[i]) {
                    sum.merge(part);
                }
            }
        }
    }

    /// Variance of the mean luminance of pixel `i`, and that mean. `splat_scale` is that of the film.
    fn luminance_statistics(&self, i: usize, splat_scale: f64) -> (f64, f64) {
        let n = f64::from(self.samples[i].max(1));
        let luminance = |sums: &[FixedSum]| {
            (0..3)
                .map(|c| f64::from(LUMINANCE[c]) * sums[c].value())
                .sum::<f64>()
        };
        let mean = luminance(&self.radiance[i]) / n;
        let (splat_variance, splat_mean) = self.splats.as_ref().map_or((0.0, 0.0), |splats| {
            let sums = &splats[i];
            let variance = sums[3].value() * splat_scale * splat_scale;
            (variance, luminance(sums) * splat_scale)
        });
        if self.samples[i] < 2 {
            return (0.0, mean + splat_mean);
        }
        let variance = (self.squares[i].value() / n - mean * mean).max(0.0) / (n - 1.0);
        (variance + splat_variance, mean + splat_mean)
    }

    /// Mean over the pixels of standard error / (luminance + 1 % of the picture's mean luminance): what `--noise` means.
    pub fn noise(&self) -> f64 {
        let pixels = self.samples.len().max(1) as f64;
        let splat_scale = self.splat_scale();
        let statistics: Vec<(f64, f64)> = (0..self.samples.len())
            .map(|i| self.luminance_statistics(i, splat_scale))
            .collect();
        let mean = statistics.iter().map(|s| s.1).sum::<f64>() / pixels;
        let floor = 0.01 * mean.abs() + f64::MIN_POSITIVE;
        statistics
            .iter()
            .map(|(variance, mean)| variance.sqrt() / (mean.abs() + floor))
            .sum::<f64>()
            / pixels
    }

    /// Divides the sums by the numbers of samples. Pixels without samples are black.
    pub fn develop(&self) -> Developed {
        let scale = |i: usize| 1.0 / f64::from(self.samples[i].max(1));
        let splat_scale = self.splat_scale();
        let splat = |i: usize, channel: usize| {
            self.splats
                .as_ref()
                .map_or(0.0, |splats| splats[i][channel].value() * splat_scale)
        };
        Developed {
            width: self.width,
            height: self.height,
            radiance: (self.radiance.iter().enumerate())
                .map(|(i, sums)| {
                    std::array::from_fn(|c| (sums[c].value() * scale(i) + splat(i, c)) as f32)
                })
                .collect(),
            variance: (0..self.samples.len())
                .map(|i| self.luminance_statistics(i, splat_scale).0 as f32)
                .collect(),
            features: self.features.as_ref().map(|all| {
                let mean = |(i, sums): (usize, &FeatureSums)| {
                    let m = sums.map(|sum| (sum.value() * scale(i)) as f32);
                    Features {
                        albedo: Vec3::new(m[0], m[1], m[2]),
                        normal: Vec3::new(m[3], m[4], m[5]),
                        depth: m[6],
                    }
                };
                all.iter().enumerate().map(mean).collect()
            }),
        }
    }
}

impl FilmBand<'_> {
    /// Adds one sample; coordinates are those of the whole film. True if it is not finite: it counts as black then, and should be reported by
    /// [`Film::add_dropped`].
    ///
    /// # Panics
    /// If the pixel is outside of the band.
    #[must_use]
    pub fn add(&mut self, x: u32, y: u32, radiance: Vec3, features: Option<&Features>) -> bool {
        let i = (y - self.first) as usize * self.width as usize + x as usize;
        self.samples[i] += 1;
        if let (Some(sums), Some(f)) = (&mut self.features, features) {
            let values = [
                f.albedo.x, f.albedo.y, f.albedo.z, f.normal.x, f.normal.y, f.normal.z, f.depth,
            ];
            for (sum, value) in sums[i].iter_mut().zip(values) {
                if value.is_finite() {
                    sum.add(f64::from(value));
                }
            }
        }
        if !radiance.is_finite() {
            return true;
        }
        for (sum, value) in self.radiance[i].iter_mut().zip(radiance.to_array()) {
            sum.add(f64::from(value));
        }
        let luminance = f64::from(LUMINANCE.dot(radiance));
        self.squares[i].add(luminance * luminance);
        false
    }
}

impl FilmTile {
    /// Adds one sample; coordinates are those of the whole film.
    ///
    /// # Panics
    /// If the pixel is outside of the tile.
    pub fn add(&mut self, x: u32, y: u32, radiance: Vec3, features: Option<&Features>) {
        self.film.add(x - self.x, y - self.y, radiance, features);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_of_known_samples() {
        let mut film = Film::new(2, 1, false);
        for value in [1.0, 2.0, 3.0, 6.0] {
            film.add(1, 0, Vec3::splat(value), None);
        }
        let developed = film.develop();
        assert_eq!(developed.radiance, [[0.0; 3], [3.0; 3]]);
        // Sample variance 14/3, divided by 4 samples.
        assert!((developed.variance[1] - 14.0 / 12.0).abs() < 1e-5);
    }

    #[test]
    fn tiles_and_shards_give_the_bytes_of_one_film() {
        let samples: Vec<(u32, u32, Vec3)> = (0..600u32)
            .map(|i| {
                (
                    i % 5,
                    i / 5 % 4,
                    Vec3::new(i as f32 * 0.1, 1.0 / (i + 1) as f32, -0.3),
                )
            })
            .collect();
        let mut whole = Film::new(5, 4, false);
        samples
            .iter()
            .for_each(|&(x, y, l)| whole.add(x, y, l, None));
        let mut merged = Film::new(5, 4, false);
        for shard in samples.chunks(70).rev() {
            let mut film = Film::new(5, 4, false);
            let mut tile = film.tile(0, 0, 5, 4);
            shard.iter().for_each(|&(x, y, l)| tile.add(x, y, l, None));
            film.add_tile(&tile);
            merged.merge(&film);
        }
        assert_eq!(whole, merged);
    }

    /// Every other light path brings 2 to a pixel: with two pixels, 2 for every light path a pixel.
    #[test]
    fn splats_are_means_over_all_light_paths() {
        let mut film = Film::new(2, 1, false);
        film.enable_splats();
        let n = 10;
        for i in 0..2 * n {
            film.add(i % 2, 0, Vec3::ONE, None);
            if i % 2 == 0 {
                let splat = |radiance| Splat {
                    x: 1,
                    y: 0,
                    radiance,
                };
                film.splat(&splat(Vec3::splat(2.0)));
                film.splat(&splat(Vec3::splat(f32::NAN)));
            }
        }
        let developed = film.develop();
        assert_eq!(developed.radiance, [[1.0; 3], [3.0; 3]]);
        assert_eq!(film.dropped(), u64::from(n));
        assert!((developed.variance[1] - 4.0 / n as f32).abs() < 1e-6);
        // A tile that is ahead takes part in the number of light paths.
        for _ in 0..2 * n {
            film.add(0, 0, Vec3::ONE, None);
        }
        assert_eq!(film.develop().radiance[1], [2.0; 3]);
    }

    #[test]
    fn samples_that_are_not_finite_are_counted_and_black() {
        let mut film = Film::new(1, 1, false);
        film.add(0, 0, Vec3::new(f32::NAN, 1.0, 1.0), None);
        film.add(0, 0, Vec3::ONE, None);
        assert_eq!(film.dropped(), 1);
        assert_eq!(film.develop().radiance[0], [0.5; 3]);
    }
}
