//! `--camera-path`: cameras of the frames of a sequence.

use crate::error::CliError;
use crate::values::{Frames, Size};
use glam::Vec3;
use occlude_render::camera::View;
use serde_json::{Map, Value};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Keys at most, and bytes of the file: more is no camera path.
const MAX_KEYS: usize = 1_000_000;
const MAX_BYTES: u64 = 256 << 20;

/// Where the camera is at some frames, and how it goes from one to the next.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath {
    file: PathBuf,
    smooth: bool,
    /// Ascending by frame, at least one.
    keys: Vec<Key>,
}

/// The camera at one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key {
    frame: f64,
    camera: Camera,
}

/// Eye, target, vertical field of view (degrees) and direction upwards: ten numbers.
type Camera = [f64; 10];

impl CameraPath {
    /// Reads a file; `fov` (degrees) is for keys that name none.
    pub fn read(file: &Path, fov: f32) -> Result<Self, CliError> {
        let data = std::fs::metadata(file).map_err(|error| CliError::read(file, &error))?;
        if data.len() > MAX_BYTES {
            return Err(CliError::input(
                "too large for a camera path",
                file.display(),
                format_args!("at most {MAX_BYTES} bytes"),
            ));
        }
        let text = std::fs::read(file).map_err(|error| CliError::read(file, &error))?;
        let value = serde_json::from_slice(&text)
            .map_err(|error| CliError::input("not JSON", file.display(), error))?;
        Self::parse(file, &value, fov)
    }

    fn parse(file: &Path, value: &Value, fov: f32) -> Result<Self, CliError> {
        let wrong = |what: &dyn Display, place: &str, cure: &dyn Display| {
            CliError::input(what, format_args!("{}{place}", file.display()), cure)
        };
        let (keys, smooth, prefix) = match value {
            Value::Array(keys) => (keys, false, ": "),
            Value::Object(whole) => {
                only(whole, &["interpolation", "keys"])
                    .map_err(|key| wrong(&"unknown key", &format!(": {key}"), &KEYS_OF_FILE))?;
                let smooth = match whole.get("interpolation").map(Value::as_str) {
                    None | Some(Some("linear")) => false,
                    Some(Some("smooth")) => true,
                    Some(_) => {
                        let place = ": interpolation";
                        return Err(wrong(&"unknown interpolation", place, &"linear or smooth"));
                    }
                };
                let keys = (whole.get("keys").and_then(Value::as_array))
                    .ok_or_else(|| wrong(&"no list of keys", ": keys", &KEYS_OF_FILE))?;
                (keys, smooth, ": keys")
            }
            _ => return Err(wrong(&"no list of keys", "", &KEYS_OF_FILE)),
        };
        if keys.is_empty() || keys.len() > MAX_KEYS {
            let cure = format_args!("1 to {MAX_KEYS}");
            return Err(wrong(&format_args!("{} keys", keys.len()), "", &cure));
        }
        let mut path = Self {
            file: file.to_owned(),
            smooth,
            keys: Vec::with_capacity(keys.len()),
        };
        for (index, value) in keys.iter().enumerate() {
            let place = format!("{prefix}[{index}]");
            let key = key(value, fov).map_err(|(what, name)| {
                let dot = if name.is_empty() { "" } else { "." };
                wrong(&what, &format!("{place}{dot}{name}"), &KEYS_OF_KEY)
            })?;
            if path.keys.last().is_some_and(|last| key.frame <= last.frame) {
                let place = format!("{place}.frame");
                return Err(wrong(
                    &"not after the key before",
                    &place,
                    &"sort keys by frame",
                ));
            }
            path.keys.push(key);
        }
        Ok(path)
    }

    /// All frames from the first key to the last.
    pub fn frames(&self) -> Result<Frames, CliError> {
        let ends = [self.keys.first(), self.keys.last()];
        let [first, last] = ends.map(|key| key.map_or(0.0, |key| key.frame));
        let whole = first.ceil() <= last.floor() && last < f64::from(u32::MAX);
        let frames = if whole {
            Frames::new(first.ceil() as u32, last.floor() as u32)
        } else {
            Err("its keys hold no whole frame".to_owned())
        };
        frames
            .map_err(|what| CliError::input(what, self.file.display(), "add --frames FIRST..LAST"))
    }

    /// The camera of a frame.
    pub fn view(&self, frame: u32, size: Size) -> Result<View, CliError> {
        let [ex, ey, ez, tx, ty, tz, fov, ux, uy, uz] = self.at(f64::from(frame)).map(|x| x as f32);
        let (eye, target) = (Vec3::new(ex, ey, ez), Vec3::new(tx, ty, tz));
        let (up, yfov) = (Vec3::new(ux, uy, uz), fov.clamp(0.01, 179.0).to_radians());
        let view = if up == Vec3::Y {
            View::look_at(eye, target, yfov, size.width, size.height)
        } else {
            View::look_at_with_up(eye, target, up, yfov, size.width, size.height)
        };
        view.ok_or_else(|| {
            CliError::input(
                format_args!("no such view at frame {frame}"),
                self.file.display(),
                "eye and target must be apart, not too far from the origin, and up must not lie along the view",
            )
        })
    }

    fn at(&self, frame: f64) -> Camera {
        let after = self.keys.partition_point(|key| key.frame <= frame);
        let from = after.saturating_sub(1);
        let to = after.min(self.keys.len() - 1);
        let (a, b) = (&self.keys[from], &self.keys[to]);
        let span = b.frame - a.frame;
        if frame <= a.frame || span <= 0.0 {
            return a.camera;
        }
        let t = (frame - a.frame) / span;
        let (leave, arrive) = (self.slope(from), self.slope(to));
        std::array::from_fn(|i| {
            let (p, q) = (a.camera[i], b.camera[i]);
            if !self.smooth {
                return p + (q - p) * t;
            }
            // Cubic Hermite spline.
            let (t2, t3) = (t * t, t * t * t);
            (2.0 * t3 - 3.0 * t2 + 1.0) * p
                + (t3 - 2.0 * t2 + t) * span * leave[i]
                + (3.0 * t2 - 2.0 * t3) * q
                + (t3 - t2) * span * arrive[i]
        })
    }

    /// Change a frame at a key: that from the key before to the key after (Catmull & Rom 1974).
    fn slope(&self, index: usize) -> Camera {
        let (a, b) = (
            &self.keys[index.saturating_sub(1)],
            &self.keys[(index + 1).min(self.keys.len() - 1)],
        );
        let span = (b.frame - a.frame).max(f64::MIN_POSITIVE);
        std::array::from_fn(|i| (b.camera[i] - a.camera[i]) / span)
    }
}

const KEYS_OF_FILE: &str = "write [{\"frame\": 0, \"eye\": [0,1,4], \"target\": [0,1,0]}, ...], or {\"interpolation\": \"smooth\", \"keys\": [...]}";
const KEYS_OF_KEY: &str =
    "a key has \"frame\", \"eye\" and \"target\", and may have \"fov\" (degrees) and \"up\"";

/// Says which key is not one of these.
fn only<'a>(object: &'a Map<String, Value>, known: &[&str]) -> Result<(), &'a str> {
    match object.keys().find(|key| !known.contains(&key.as_str())) {
        Some(key) => Err(key),
        None => Ok(()),
    }
}

/// One key; otherwise what is wrong, and with which of its parts.
fn key(value: &Value, fov: f32) -> Result<Key, (&'static str, String)> {
    let object = (value.as_object()).ok_or_else(|| ("not an object", String::new()))?;
    only(object, &["frame", "eye", "target", "fov", "up"])
        .map_err(|name| ("unknown key", name.chars().take(40).collect()))?;
    let number = |value: &Value| value.as_f64().filter(|x| x.abs() < f64::from(f32::MAX));
    let named = |name: &str| name.to_owned();
    let three = |name: &str| -> Result<Option<[f64; 3]>, (&'static str, String)> {
        let Some(value) = object.get(name) else {
            return Ok(None);
        };
        let numbers: Option<Vec<f64>> =
            (value.as_array()).and_then(|list| list.iter().map(number).collect());
        let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
        numbers
            .map(Some)
            .ok_or_else(|| ("not three numbers", named(name)))
    };
    let missing = |name: &str| ("missing", named(name));
    let frame = object.get("frame").ok_or_else(|| missing("frame"))?;
    let frame = number(frame).ok_or_else(|| ("not a number", named("frame")))?;
    let [ex, ey, ez] = three("eye")?.ok_or_else(|| missing("eye"))?;
    let [tx, ty, tz] = three("target")?.ok_or_else(|| missing("target"))?;
    let [ux, uy, uz] = three("up")?.unwrap_or([0.0, 1.0, 0.0]);
    let fov = match object.get("fov") {
        Some(value) => number(value)
            .filter(|&fov| fov > 0.0 && fov < 180.0)
            .ok_or_else(|| ("not an angle above 0 and below 180 degrees", named("fov")))?,
        None => f64::from(fov),
    };
    Ok(Key {
        frame,
        camera: [ex, ey, ez, tx, ty, tz, fov, ux, uy, uz],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(text: &str) -> Result<CameraPath, CliError> {
        CameraPath::parse(
            Path::new("p.json"),
            &serde_json::from_str(text).unwrap(),
            40.0,
        )
    }

    #[test]
    fn linear_and_held() {
        let path = path(
            r#"[{"frame": 2, "eye": [0,0,4], "target": [0,0,0], "fov": 50},
                {"frame": 6, "eye": [8,0,4], "target": [0,2,0]}]"#,
        )
        .unwrap();
        assert_eq!(path.frames(), Ok(Frames { first: 2, last: 6 }));
        assert_eq!(path.at(0.0), path.at(2.0));
        assert_eq!(path.at(9.0), path.at(6.0));
        let [ex, _, _, _, ty, _, fov, ..] = path.at(3.0);
        assert_eq!([ex, ty, fov], [2.0, 0.5, 47.5]);
    }

    #[test]
    fn smooth_meets_keys_without_corners() {
        let path = path(
            r#"{"interpolation": "smooth", "keys": [
                {"frame": 0, "eye": [0,0,4], "target": [0,0,0]},
                {"frame": 10, "eye": [5,0,4], "target": [0,0,0]},
                {"frame": 40, "eye": [5,9,4], "target": [0,0,0]}]}"#,
        )
        .unwrap();
        for key in &path.keys {
            assert_eq!(path.at(key.frame), key.camera);
        }
        let step = 1e-4;
        for i in 0..10 {
            let at = |frame: f64| path.at(frame)[i];
            let before = (at(10.0) - at(10.0 - step)) / step;
            let after = (at(10.0 + step) - at(10.0)) / step;
            assert!((before - after).abs() < 1e-3, "{i}: {before} {after}");
        }
    }

    #[test]
    fn mistakes_are_placed() {
        let eye = r#""eye": [0,0,4], "target": [0,0,0]"#;
        for (text, words) in [
            ("3".to_owned(), "no list of keys"),
            ("[]".to_owned(), "0 keys"),
            ("[7]".to_owned(), "p.json: [0]: "),
            (format!("[{{{eye}}}]"), "missing: p.json: [0].frame"),
            (r#"[{"frame": 0, "eye": [0,0,4]}]"#.to_owned(), "[0].target"),
            (
                r#"[{"frame": 0, "eye": [0,0], "target": [0,0,0]}]"#.to_owned(),
                "[0].eye",
            ),
            (format!(r#"[{{"frame": 0, {eye}, "fov": 180}}]"#), "[0].fov"),
            (
                format!(r#"[{{"frame": 0, {eye}, "roll": 1}}]"#),
                "unknown key: p.json: [0].roll",
            ),
            (
                format!(r#"[{{"frame": 1, {eye}}}, {{"frame": 1, {eye}}}]"#),
                "[1].frame",
            ),
            (
                format!(r#"{{"keys": [{{"frame": 0, {eye}}}], "loop": true}}"#),
                "loop",
            ),
            (
                r#"{"interpolation": "cubic", "keys": []}"#.to_owned(),
                "interpolation",
            ),
        ] {
            let CliError::Input(line) = path(&text).expect_err(&text) else {
                panic!("{text}");
            };
            assert!(line.contains(words), "{text}: {line}");
        }
        let here = path(r#"[{"frame": 0, "eye": [1,1,1], "target": [1,1,1]}]"#).unwrap();
        let size = Size {
            width: 4,
            height: 4,
        };
        assert!(here.view(0, size).is_err());
    }
}
