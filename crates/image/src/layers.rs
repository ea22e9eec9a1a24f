//! Named channels: a picture with its AOVs (albedo, normal, depth, variance) and metadata.

use crate::{ImageError, Picture};

/// How many bits a channel's values have in the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Depth {
    /// 16-bit float. Finite values beyond its range become the largest half, 65504.
    Half,
    /// 32-bit float.
    #[default]
    Float,
}

/// One channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Its name in the file, with its layer: `R`, `albedo.G`, `depth.Z`.
    pub name: String,
    /// Bits in the file.
    pub depth: Depth,
    /// One value a pixel, row by row from the top left.
    pub values: Vec<f32>,
}

/// A piece of metadata.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Attribute {
    /// Text.
    Text(String),
    /// A 32-bit integer. (EXR has no larger one: write larger ones as text.)
    Int(i32),
    /// A 32-bit float.
    Float(f32),
    /// A 64-bit float.
    Double(f64),
}

/// Channels of one size, with metadata. Stored as EXR.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layers {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The channels, in any order; names are unique.
    pub channels: Vec<Channel>,
    /// Names and values, in any order; names are unique. EXR's own names (`compression`, `dataWindow`...) are taken.
    pub metadata: Vec<(String, Attribute)>,
}

impl Layers {
    /// No channels yet.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            ..Self::default()
        }
    }

    /// The picture as `R`, `G`, `B`.
    pub fn from_picture(picture: &Picture, depth: Depth) -> Self {
        let mut layers = Self::new(picture.width, picture.height);
        layers.push_vectors(&["R", "G", "B"], depth, &picture.pixels);
        layers
    }

    /// Adds a colour layer: `albedo` gives `albedo.R`, `albedo.G`, `albedo.B`.
    pub fn push_colors(&mut self, layer: &str, depth: Depth, values: &[[f32; 3]]) {
        self.push_vectors(
            &[
                &format!("{layer}.R"),
                &format!("{layer}.G"),
                &format!("{layer}.B"),
            ],
            depth,
            values,
        );
    }

    /// Adds a layer of directions or positions: `normal` gives `normal.X`, `normal.Y`, `normal.Z`.
    pub fn push_xyz(&mut self, layer: &str, depth: Depth, values: &[[f32; 3]]) {
        self.push_vectors(
            &[
                &format!("{layer}.X"),
                &format!("{layer}.Y"),
                &format!("{layer}.Z"),
            ],
            depth,
            values,
        );
    }

    /// Adds one channel under its full name: `depth.Z`.
    pub fn push(&mut self, name: &str, depth: Depth, values: Vec<f32>) {
        self.channels.push(Channel {
            name: name.to_owned(),
            depth,
            values,
        });
    }

    /// Adds a piece of metadata.
    pub fn describe(&mut self, name: &str, value: Attribute) {
        self.metadata.push((name.to_owned(), value));
    }

    fn push_vectors(&mut self, names: &[&str; 3], depth: Depth, values: &[[f32; 3]]) {
        for (c, name) in names.iter().enumerate() {
            self.push(name, depth, values.iter().map(|v| v[c]).collect());
        }
    }

    /// The channel of that full name.
    pub fn channel(&self, name: &str) -> Option<&Channel> {
        self.channels.iter().find(|c| c.name == name)
    }

    /// The metadata of that name.
    pub fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.metadata
            .iter()
            .find(|(n, _)| n == name)
            .map(|(_, v)| v)
    }

    /// Three channels as a picture: `""` gives `R`, `G`, `B`; `"albedo"` gives `albedo.R`... `None` if one is missing.
    pub fn picture(&self, layer: &str) -> Option<Picture> {
        let dot = if layer.is_empty() { "" } else { "." };
        let of = |c: &str| self.channel(&format!("{layer}{dot}{c}")).map(|c| &c.values);
        let (r, g, b) = (of("R")?, of("G")?, of("B")?);
        let pixels = r
            .iter()
            .zip(g)
            .zip(b)
            .map(|((&r, &g), &b)| [r, g, b])
            .collect();
        Picture::from_pixels(self.width, self.height, pixels).ok()
    }

    /// Errs unless every channel has one value a pixel, names are legal and nothing is named twice.
    pub(crate) fn check(&self) -> Result<(), ImageError> {
        let pixels = u64::from(self.width) * u64::from(self.height);
        for channel in &self.channels {
            if channel.values.len() as u64 != pixels {
                return Err(ImageError::Inconsistent(format!(
                    "channel {} has {} values for {pixels} pixels",
                    channel.name,
                    channel.values.len()
                )));
            }
        }
        self.check_names()
    }

    /// The same, whatever values there are.
    pub(crate) fn check_names(&self) -> Result<(), ImageError> {
        let wrong = |text: String| Err(ImageError::Inconsistent(text));
        let pixels = u64::from(self.width) * u64::from(self.height);
        if pixels == 0 || self.width > i32::MAX as u32 || self.height > i32::MAX as u32 {
            return wrong(format!(
                "an EXR file cannot be {}x{}",
                self.width, self.height
            ));
        }
        if self.channels.is_empty() {
            return wrong("an EXR file needs a channel".to_owned());
        }
        let of_channels = self.channels.iter().map(|c| c.name.as_str());
        let of_metadata = self.metadata.iter().map(|(n, _)| n.as_str());
        for mut names in [
            of_channels.collect::<Vec<_>>(),
            of_metadata.chain(crate::exr_write::OWN_NAMES).collect(),
        ] {
            if let Some(bad) = names
                .iter()
                .find(|n| n.is_empty() || n.len() > 255 || n.contains('\0'))
            {
                return wrong(format!("{bad:?} cannot be a name in an EXR file"));
            }
            names.sort_unstable();
            if let Some(twice) = names.windows(2).find(|w| w[0] == w[1]) {
                return wrong(format!("{} is there twice", twice[0]));
            }
        }
        Ok(())
    }
}
