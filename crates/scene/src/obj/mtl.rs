//! MTL statements, as they stand in the file; what they mean is decided in `surface`.

use super::Counted;
use super::text::{lines, numbers, split, triple};
use glam::Vec3;
use std::collections::BTreeMap;

/// A texture statement.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Map {
    pub file: String,
    /// `-s`: factor on texture coordinates.
    pub scale: [f32; 2],
    /// `-o`: added to texture coordinates.
    pub offset: [f32; 2],
    /// `-bm`.
    pub bump: f32,
    /// `-clamp on`.
    pub clamp: bool,
}

/// One `newmtl`.
#[derive(Clone, Debug, Default)]
pub(super) struct Entry {
    pub diffuse: Option<Vec3>,
    pub specular: Option<Vec3>,
    pub emission: Option<Vec3>,
    pub filter: Option<Vec3>,
    pub exponent: Option<f32>,
    pub ior: Option<f32>,
    pub dissolve: Option<f32>,
    pub transparency: Option<f32>,
    pub illum: Option<u32>,
    /// `Pr`, of the PBR extension that Blender writes.
    pub roughness: Option<f32>,
    /// `Pm`.
    pub metallic: Option<f32>,
    /// `Pc`.
    pub clearcoat: Option<f32>,
    /// `Pcr`.
    pub clearcoat_roughness: Option<f32>,
    pub map_diffuse: Option<Map>,
    pub map_emission: Option<Map>,
    pub map_alpha: Option<Map>,
    pub map_bump: Option<Map>,
    pub map_normal: Option<Map>,
}

/// Names of the materials in file order, and what they say. A name that is defined twice keeps its first place and its
/// last meaning.
#[derive(Default)]
pub(super) struct Library {
    pub names: Vec<String>,
    pub entries: BTreeMap<String, Entry>,
}

impl Library {
    pub fn read(&mut self, bytes: &[u8], warn: &mut Counted) {
        let mut name: Option<String> = None;
        for (line, text) in lines(bytes) {
            let (key, rest) = split(&text);
            if key == "newmtl" {
                if self
                    .entries
                    .insert(rest.to_owned(), Entry::default())
                    .is_none()
                {
                    self.names.push(rest.to_owned());
                }
                name = Some(rest.to_owned());
                continue;
            }
            let Some(entry) = name.as_ref().and_then(|name| self.entries.get_mut(name)) else {
                warn.add("MTL statement before any newmtl, ignored", line);
                continue;
            };
            if !entry.set(key, rest) {
                warn.add(&format!("MTL statement {} ignored", shorten(key)), line);
            }
        }
    }
}

fn shorten(key: &str) -> String {
    key.chars().take(24).collect()
}

impl Entry {
    /// Takes a statement; false if it is not understood.
    fn set(&mut self, key: &str, rest: &str) -> bool {
        let number = || numbers(rest).next().filter(|x| x.is_finite());
        let color = || triple(rest).map(Vec3::from);
        match key.to_ascii_lowercase().as_str() {
            "kd" => self.diffuse = color(),
            "ks" => self.specular = color(),
            "ke" => self.emission = color(),
            "tf" => self.filter = color(),
            "ns" => self.exponent = number(),
            "ni" => self.ior = number(),
            // `d -halo 0.5` fades towards the silhouette; the number is what matters.
            "d" => self.dissolve = numbers(rest.trim_start_matches("-halo")).next(),
            "tr" => self.transparency = number(),
            "illum" => self.illum = rest.split_whitespace().next().and_then(|w| w.parse().ok()),
            "pr" => self.roughness = number(),
            "pm" => self.metallic = number(),
            "pc" => self.clearcoat = number(),
            "pcr" => self.clearcoat_roughness = number(),
            "map_kd" => self.map_diffuse = map(rest),
            "map_ke" => self.map_emission = map(rest),
            "map_d" => self.map_alpha = map(rest),
            "map_bump" | "bump" => self.map_bump = map(rest),
            "norm" | "map_kn" => self.map_normal = map(rest),
            // Ambient light does not exist here.
            "ka" | "map_ka" | "sharpness" | "map_aat" => {}
            _ => return false,
        }
        true
    }
}

/// Options, then a file name that may contain spaces.
fn map(mut rest: &str) -> Option<Map> {
    let mut map = Map {
        file: String::new(),
        scale: [1.0; 2],
        offset: [0.0; 2],
        bump: 1.0,
        clamp: false,
    };
    while let Some(option) = rest.strip_prefix('-') {
        let (name, after) = split(option);
        rest = after;
        let mut words = |most: usize| {
            let mut values = Vec::new();
            while values.len() < most {
                let (word, after) = split(rest);
                let Ok(x) = word.parse::<f32>() else { break };
                values.push(if x.is_finite() { x } else { 0.0 });
                rest = after;
            }
            values
        };
        match name {
            "s" | "o" | "t" => {
                let target = match name {
                    "s" => &mut map.scale,
                    "o" => &mut map.offset,
                    // Turbulence: nothing draws it.
                    _ => &mut [0.0; 2],
                };
                for (slot, value) in target.iter_mut().zip(words(3)) {
                    *slot = value;
                }
            }
            "bm" => map.bump = words(1).first().copied().unwrap_or(1.0),
            "mm" => drop(words(2)),
            "boost" | "texres" => drop(words(1)),
            _ => {
                let (word, after) = split(rest);
                map.clamp |= name == "clamp" && word == "on";
                rest = after;
            }
        }
    }
    map.file = rest.trim_matches('"').to_owned();
    (!map.file.is_empty()).then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_and_names_with_spaces() {
        let got = map("-s 2 2 1 -o 0.5 0 0 -clamp on -bm 3 a texture with spaces.png").unwrap();
        let want = Map {
            file: "a texture with spaces.png".into(),
            scale: [2.0; 2],
            offset: [0.5, 0.0],
            bump: 3.0,
            clamp: true,
        };
        assert_eq!(got, want);
        assert_eq!(map("-s 2 a.png").unwrap().scale, [2.0, 1.0]);
        assert_eq!(map("-s 1 1"), None);
        assert_eq!(map(""), None);
        assert_eq!(map("-"), None);
    }
}
