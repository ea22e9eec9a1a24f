//! Values of options: sizes, durations, lists of numbers. Every parser says what it wanted.

use glam::Vec3;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Pixels a side and in all: more is a mistake, not a picture.
const MAX_SIDE: u32 = 65_536;
const MAX_PIXELS: u64 = 1 << 30;

/// Width and height of a picture, `WxH`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || format!("'{text}' is not WIDTHxHEIGHT in pixels, for example 1280x720");
        let (width, height) = text.split_once(['x', 'X']).ok_or_else(wanted)?;
        let size = Self {
            width: decimal(width).ok_or_else(wanted)?,
            height: decimal(height).ok_or_else(wanted)?,
        };
        if size.width == 0 || size.height == 0 {
            return Err(format!(
                "'{text}' has no pixels: both sides must be at least 1"
            ));
        }
        if size.width > MAX_SIDE
            || size.height > MAX_SIDE
            || u64::from(size.width) * u64::from(size.height) > MAX_PIXELS
        {
            return Err(format!(
                "'{text}' is too large: at most {MAX_SIDE} a side and {MAX_PIXELS} pixels in all"
            ));
        }
        Ok(size)
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Relative errors between which things stay as they are, `MAX,MIN`, such as `10%,5%`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thresholds {
    pub insert_above: f32,
    pub erase_below: f32,
}

/// A pixel, from the top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pixel {
    pub x: u32,
    pub y: u32,
}

impl FromStr for Pixel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text} is no pixel: give X,Y such as 320,240");
        let (x, y) = text.split_once(',').ok_or_else(wrong)?;
        let number = |part: &str| part.trim().parse().map_err(|_| wrong());
        Ok(Self {
            x: number(x)?,
            y: number(y)?,
        })
    }
}

impl FromStr for Thresholds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || format!("'{text}' is not MAX,MIN, for example 10%,5% or 0.1,0.05");
        let (max, min) = text.split_once(',').ok_or_else(wanted)?;
        let value = |part: &str| {
            let part = part.trim();
            let (number, scale) = match part.strip_suffix('%') {
                Some(number) => (number, 0.01),
                None => (part, 1.0),
            };
            let value = number.parse::<f32>().ok().filter(|v| v.is_finite())?;
            Some(value * scale)
        };
        let insert_above = value(max).ok_or_else(wanted)?;
        let erase_below = value(min).ok_or_else(wanted)?;
        if insert_above <= 0.0 || erase_below < 0.0 {
            return Err(format!("'{text}': MAX must be above 0 and MIN at least 0"));
        }
        if erase_below >= insert_above {
            return Err(format!(
                "'{text}': MAX comes first and must be above MIN, or points would come and go"
            ));
        }
        Ok(Self {
            insert_above,
            erase_below,
        })
    }
}

/// Frames at most: more is a mistake, not a film.
const MAX_FRAMES: u32 = 1_000_000;

/// Frames of a sequence, `A..B` with both, or one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frames {
    pub first: u32,
    pub last: u32,
}

impl Frames {
    /// From one frame to another, both included.
    pub fn new(first: u32, last: u32) -> Result<Self, String> {
        if last < first {
            return Err(format!("'{first}..{last}' runs backwards"));
        }
        if last - first >= MAX_FRAMES {
            return Err(format!("'{first}..{last}': at most {MAX_FRAMES} frames"));
        }
        Ok(Self { first, last })
    }

    pub fn count(self) -> u32 {
        self.last - self.first + 1
    }
}

impl FromStr for Frames {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || format!("'{text}' is not FIRST..LAST, for example 0..59");
        let (first, last) = text.split_once("..").unwrap_or((text, text));
        let first = decimal(first).ok_or_else(wanted)?;
        let last = decimal(last).ok_or_else(wanted)?;
        Self::new(first, last)
    }
}

/// Blocks of virtual lights that are drawn anew for every frame; `None`: all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Renewal(pub Option<u32>);

impl FromStr for Renewal {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self(None)),
            _ => (decimal(text).map(|blocks| Self(Some(blocks))))
                .ok_or_else(|| format!("'{text}' is neither a whole number nor all")),
        }
    }
}

/// A whole number written with digits alone (no sign, no spaces).
fn decimal<T: FromStr>(text: &str) -> Option<T> {
    (!text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())).then(|| text.parse().ok())?
}

/// A finite number.
pub fn number(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("'{text}' is not a finite number")),
    }
}

/// A finite number above 0.
pub fn positive(text: &str) -> Result<f32, String> {
    match number(text)? {
        value if value > 0.0 => Ok(value),
        _ => Err(format!("'{text}' must be above 0")),
    }
}

/// A number above 0, or `inf`.
pub fn bound(text: &str) -> Result<f32, String> {
    if text.trim().eq_ignore_ascii_case("inf") {
        return Ok(f32::INFINITY);
    }
    positive(text).map_err(|error| format!("{error}, or inf"))
}

/// A finite number that is not negative.
pub fn not_negative(text: &str) -> Result<f32, String> {
    match number(text)? {
        value if value >= 0.0 => Ok(value),
        _ => Err(format!("'{text}' must not be negative")),
    }
}

/// A vertical field of view in degrees.
pub fn field_of_view(text: &str) -> Result<f32, String> {
    match number(text)? {
        value if value > 0.0 && value < 180.0 => Ok(value),
        _ => Err(format!(
            "'{text}' is no field of view: above 0 and below 180 degrees"
        )),
    }
}

/// Bytes: `4GiB`, `512MiB`, `1.5G`, `1000000`. Binary prefixes count 1024, decimal ones (`kB`, `MB`, `GB`) 1000.
pub fn bytes(text: &str) -> Result<u64, String> {
    let wanted = || format!("'{text}' is not an amount of memory, for example 4GiB or 512MiB");
    let (value, unit) = split_unit(text).ok_or_else(wanted)?;
    let factor = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "ki" | "kib" => 1024.0,
        "m" | "mi" | "mib" => 1048576.0,
        "g" | "gi" | "gib" => 1073741824.0,
        "t" | "ti" | "tib" => 1099511627776.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        _ => return Err(wanted()),
    };
    let total = value * factor;
    if total < 1.0 {
        return Err(format!("'{text}' is no memory at all"));
    }
    if total >= 2f64.powi(63) {
        return Err(format!("'{text}' is more than any machine has"));
    }
    Ok(total as u64)
}

/// Durations: `30s`, `2m`, `1h`, `500ms`, `1.5m`; a bare number is seconds.
pub fn duration(text: &str) -> Result<Duration, String> {
    let wanted = || format!("'{text}' is not a duration, for example 30s, 2m or 1h");
    let (value, unit) = split_unit(text).ok_or_else(wanted)?;
    let factor = match unit {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(wanted()),
    };
    let seconds = value * factor;
    if seconds <= 0.0 {
        return Err(format!("'{text}' leaves no time"));
    }
    if seconds > 1e9 {
        return Err(format!("'{text}' is longer than thirty years"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Splits `1.5GiB` into a finite, non-negative number and a unit of letters.
fn split_unit(text: &str) -> Option<(f64, &str)> {
    let end = text
        .find(|c: char| c.is_ascii_alphabetic())
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let number = number.trim_end();
    if number.is_empty() || !number.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        return None;
    }
    number
        .parse::<f64>()
        .ok()
        .filter(|v| v.is_finite())
        .map(|v| (v, unit))
}

/// One part of a work: `I/N`, I from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    pub index: u32,
    pub count: u32,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || format!("'{text}' is not I/N with I from 0, for example 0/4");
        let (index, count) = text.split_once('/').ok_or_else(wanted)?;
        let shard = Self {
            index: decimal(index).ok_or_else(wanted)?,
            count: decimal(count).ok_or_else(wanted)?,
        };
        if shard.count == 0 || shard.count > 65_536 {
            return Err(format!(
                "'{text}': the number of shards must be between 1 and 65536"
            ));
        }
        if shard.index >= shard.count {
            return Err(format!(
                "'{text}': the first shard is 0/{0}, the last {1}/{0}",
                shard.count,
                shard.count - 1
            ));
        }
        Ok(shard)
    }
}

/// `AZ,EL` in degrees, optionally with a third number: the sun's irradiance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sun {
    pub azimuth: f32,
    pub elevation: f32,
    pub irradiance: f32,
}

impl Sun {
    /// A white surface that faces the sun then shows radiance 1.
    pub const DEFAULT_IRRADIANCE: f32 = std::f32::consts::PI;

    /// Unit vector from the scene to the sun: azimuth 0 lies along +X and grows towards +Z, as the columns of an environment.
    pub fn towards(&self) -> Vec3 {
        let (azimuth, elevation) = (self.azimuth.to_radians(), self.elevation.to_radians());
        Vec3::new(
            azimuth.cos() * elevation.cos(),
            elevation.sin(),
            azimuth.sin() * elevation.cos(),
        )
        .normalize()
    }
}

impl FromStr for Sun {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (azimuth, elevation, irradiance) = match *numbers(text)? {
            [azimuth, elevation] => (azimuth, elevation, Self::DEFAULT_IRRADIANCE),
            [azimuth, elevation, irradiance] => (azimuth, elevation, irradiance),
            _ => {
                return Err(format!(
                    "'{text}' is not AZIMUTH,ELEVATION in degrees, for example 45,60"
                ));
            }
        };
        if !(-90.0..=90.0).contains(&elevation) {
            return Err(format!(
                "'{text}': the elevation lies between -90 and 90 degrees"
            ));
        }
        if irradiance <= 0.0 {
            return Err(format!("'{text}': the irradiance must be above 0"));
        }
        Ok(Self {
            azimuth,
            elevation,
            irradiance,
        })
    }
}

/// Eye and target of a camera: `EX,EY,EZ,TX,TY,TZ`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    pub eye: Vec3,
    pub target: Vec3,
}

impl FromStr for Look {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let [ex, ey, ez, tx, ty, tz] = numbers(text)?[..] else {
            return Err(format!(
                "'{text}' is not six numbers EX,EY,EZ,TX,TY,TZ (eye and target, metres)"
            ));
        };
        let look = Self {
            eye: Vec3::new(ex, ey, ez),
            target: Vec3::new(tx, ty, tz),
        };
        if look.eye == look.target {
            return Err(format!("'{text}': eye and target are the same point"));
        }
        Ok(look)
    }
}

fn numbers(text: &str) -> Result<Vec<f32>, String> {
    text.split(',').map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sizes() {
        assert_eq!(
            "640x480".parse(),
            Ok(Size {
                width: 640,
                height: 480
            })
        );
        for bad in [
            "0x0",
            "0x5",
            "5x0",
            "",
            "x",
            "5",
            "5x",
            "-5x5",
            "5x5x5",
            "1e3x5",
            "99999999999x5",
            "70000x1",
            "65536x65536",
            "5 x5",
            "+5x5",
        ] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
    }

    #[test]
    fn memory() {
        assert_eq!(bytes("4GiB"), Ok(4 << 30));
        assert_eq!(bytes("512MiB"), Ok(512 << 20));
        assert_eq!(bytes("1.5k"), Ok(1536));
        assert_eq!(bytes("2GB"), Ok(2_000_000_000));
        assert_eq!(bytes("77"), Ok(77));
        for bad in [
            "",
            "GiB",
            "-1GiB",
            "0",
            "0.1",
            "4XiB",
            "1e9",
            "inf",
            "nan",
            "9999999999TiB",
            "4 4G",
        ] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn durations() {
        assert_eq!(duration("30s"), Ok(Duration::from_secs(30)));
        assert_eq!(duration("2m"), Ok(Duration::from_secs(120)));
        assert_eq!(duration("1.5"), Ok(Duration::from_millis(1500)));
        assert_eq!(duration("500ms"), Ok(Duration::from_millis(500)));
        for bad in [
            "",
            "s",
            "-3s",
            "0s",
            "3d",
            "1e9h",
            "99999999h",
            "infs",
            "3 s 4",
        ] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn shards() {
        assert_eq!("0/4".parse(), Ok(Shard { index: 0, count: 4 }));
        for bad in ["4/4", "0/0", "1", "-1/4", "0/65537", "a/b", "0/4/2"] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
    }

    #[test]
    fn suns_and_looks() {
        let sun: Sun = "90,0".parse().unwrap();
        assert!((sun.towards() - Vec3::Z).length() < 1e-6);
        assert!(("0,90".parse::<Sun>().unwrap().towards() - Vec3::Y).length() < 1e-6);
        assert_eq!("-90,-10,5".parse::<Sun>().unwrap().irradiance, 5.0);
        for bad in ["", "1", "1,91", "1,nan", "1,2,0", "1,2,3,4"] {
            assert!(bad.parse::<Sun>().is_err(), "{bad}");
        }
        assert_eq!(
            "-1,2,3,4,5,6".parse::<Look>().unwrap().eye,
            Vec3::new(-1.0, 2.0, 3.0)
        );
        for bad in ["1,2,3,1,2,3", "1,2,3", "1,2,3,4,5,inf", "a,b,c,d,e,f"] {
            assert!(bad.parse::<Look>().is_err(), "{bad}");
        }
    }

    #[test]
    fn plain_numbers() {
        assert!(positive("0").is_err() && positive("-1").is_err() && positive("nan").is_err());
        assert!(not_negative("0").is_ok() && not_negative("-0.1").is_err());
        assert!(
            field_of_view("0").is_err()
                && field_of_view("180").is_err()
                && field_of_view("60").is_ok()
        );
    }

    proptest! {
        #[test]
        fn no_text_panics(text in any::<String>()) {
            let _ = (text.parse::<Size>(), text.parse::<Shard>(), text.parse::<Sun>(), text.parse::<Look>());
            let _ = (bytes(&text), duration(&text), number(&text), field_of_view(&text));
        }

        #[test]
        fn near_misses_do_not_panic(text in "[-+0-9.,xX/eGiBkmsh ]{0,24}") {
            let _ = (text.parse::<Size>(), text.parse::<Shard>(), text.parse::<Sun>(), text.parse::<Look>());
            let _ = (bytes(&text), duration(&text));
        }

        #[test]
        fn sizes_come_back(width in 1u32..20_000, height in 1u32..20_000) {
            let size = Size { width, height };
            prop_assert_eq!(size.to_string().parse::<Size>(), Ok(size));
        }

        #[test]
        fn accepted_sizes_are_bounded(width in any::<u32>(), height in any::<u32>()) {
            if let Ok(size) = format!("{width}x{height}").parse::<Size>() {
                prop_assert!(size.width >= 1 && size.height >= 1 && u64::from(size.width) * u64::from(size.height) <= MAX_PIXELS);
            }
        }
    }
}
