//! Films become pictures.

use crate::error::CliError;
use clap::ValueEnum;
use occlude_image::{Attribute, Depth, Look, ToneMap, write_layers};
use occlude_render::film::{Aovs, Film};
use std::path::PathBuf;

/// Layers beside the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Aov {
    /// Colour of the first surface
    Albedo,
    /// World-space shading normal of the first surface
    Normal,
    /// Distance to the first surface, metres
    Depth,
    /// Variance of the pixel's mean luminance
    Variance,
}

/// The list as the film wants it.
pub fn aovs(list: &[Aov]) -> Aovs {
    let has = |aov| list.contains(&aov);
    Aovs {
        albedo: has(Aov::Albedo),
        normal: has(Aov::Normal),
        depth: has(Aov::Depth),
        variance: has(Aov::Variance),
    }
}

/// How a film becomes files. Travels with checkpoints and shards, so that `merge` writes what the one-machine run would have.
#[derive(Debug, Clone, PartialEq)]
pub struct Finish {
    /// Layers of EXR outputs.
    pub aov: Vec<Aov>,
    /// Bits of the picture's channels in EXR outputs.
    pub depth: Depth,
    /// Look of PNG outputs.
    pub look: Look,
    /// Metadata of every output.
    pub about: Vec<(String, String)>,
}

/// Prefix of the notes that are metadata.
const ABOUT: &str = "about.";

impl Finish {
    /// As notes in a film file.
    pub fn notes(&self) -> Vec<(String, String)> {
        let aov: Vec<&'static str> = Aov::value_variants()
            .iter()
            .zip(NAMES)
            .filter(|(a, _)| self.aov.contains(a))
            .map(|(_, n)| n)
            .collect();
        let mut notes = vec![
            ("aov".to_owned(), aov.join(",")),
            ("half".to_owned(), (self.depth == Depth::Half).to_string()),
            ("tonemap".to_owned(), self.look.tone_map.name().to_owned()),
            ("exposure".to_owned(), self.look.exposure_ev.to_string()),
        ];
        notes.extend(
            self.about
                .iter()
                .map(|(name, value)| (format!("{ABOUT}{name}"), value.clone())),
        );
        notes
    }

    /// From the notes of a film file; `None` if they are not ours.
    pub fn from_notes(notes: &[(String, String)]) -> Option<Self> {
        let note = |name: &str| {
            notes
                .iter()
                .find(|(n, _)| n == name)
                .map(|(_, value)| value.as_str())
        };
        let list = note("aov")?.split(',').filter(|name| !name.is_empty());
        let aov = list
            .map(|name| Aov::from_str(name, false).ok())
            .collect::<Option<Vec<_>>>()?;
        let tone_map: ToneMap = note("tonemap")?.parse().ok()?;
        let exposure_ev = note("exposure")?
            .parse()
            .ok()
            .filter(|ev: &f32| ev.is_finite())?;
        let about = notes.iter().filter_map(|(name, value)| {
            Some((name.strip_prefix(ABOUT)?.to_owned(), value.clone()))
        });
        Some(Self {
            aov,
            depth: if note("half")? == "true" {
                Depth::Half
            } else {
                Depth::Float
            },
            look: Look {
                tone_map,
                exposure_ev,
            },
            about: about.collect(),
        })
    }

    /// Develops the film and writes every output.
    pub fn write(&self, film: &Film, outputs: &[PathBuf]) -> Result<(), CliError> {
        let mut layers = film.develop().layers(aovs(&self.aov), self.depth);
        for (name, value) in &self.about {
            layers.describe(name, Attribute::Text(value.clone()));
        }
        layers.describe(
            "samplesPerPixel",
            Attribute::Text(film.min_samples().to_string()),
        );
        for output in outputs {
            write_layers(output, &layers, self.look)?;
        }
        Ok(())
    }
}

/// Names of [`Aov::value_variants`].
const NAMES: [&str; 4] = ["albedo", "normal", "depth", "variance"];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_come_back() {
        let finish = Finish {
            aov: vec![Aov::Albedo, Aov::Variance],
            depth: Depth::Half,
            look: Look {
                tone_map: ToneMap::Agx,
                exposure_ev: -1.25,
            },
            about: vec![("scene".into(), "a \"b\".glb".into())],
        };
        assert_eq!(Finish::from_notes(&finish.notes()), Some(finish));
        assert_eq!(Finish::from_notes(&[]), None);
    }

    #[test]
    fn names_are_those_of_the_command_line() {
        for (aov, name) in Aov::value_variants().iter().zip(NAMES) {
            assert_eq!(aov.to_possible_value().unwrap().get_name(), name);
        }
    }
}
