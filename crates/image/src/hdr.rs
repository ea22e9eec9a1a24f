//! Radiance HDR (RGBE): G. Ward, "Real Pixels", Graphics Gems II, 1991, and the Radiance file format notes
//! (radsite.lbl.gov/radiance/refer/filefmts.pdf, "Picture File Format").
//!
//! A value is `mantissa * 2^(exponent - 136)`, without the half step that Radiance itself adds: three.js, Mitsuba and
//! stb read it so, and what is written here is rounded to match. `EXPOSURE` and `COLORCORR` lines are divided out.
//! All eight orientations, both run-length encodings and flat pixels are read. XYZE is refused.

use std::io::{self, Write};

use crate::Picture;
use crate::codec::Limits;
use crate::error::Fault;

/// Widths that the newer run-length encoding can express.
const NEW_RLE_WIDTHS: std::ops::RangeInclusive<usize> = 8..=0x7fff;

/// What the header says.
struct Header {
    /// Pixels in a stored scan line, number of scan lines.
    line: usize,
    lines: usize,
    /// Whether scan lines are columns of the picture.
    columns: bool,
    /// Whether the picture's x (y) grows against the stored order.
    flip_x: bool,
    flip_y: bool,
    /// Stored value = radiance * this.
    scale: [f32; 3],
}

/// A byte source that ends.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], Fault> {
        let (head, tail) = self
            .0
            .split_at_checked(n)
            .ok_or_else(|| Fault::damaged("the HDR file ends early"))?;
        self.0 = tail;
        Ok(head)
    }

    fn rgbe(&mut self) -> Result<[u8; 4], Fault> {
        let b = self.take(4)?;
        Ok([b[0], b[1], b[2], b[3]])
    }

    /// The next line without its end; headers are text, so absurd lengths are damage.
    fn text_line(&mut self) -> Result<&'a [u8], Fault> {
        let end = self.0.iter().take(4096).position(|&b| b == b'\n');
        let line = self.take(end.ok_or_else(|| Fault::damaged("the HDR header has no end"))?)?;
        self.take(1)?;
        Ok(line.strip_suffix(b"\r").unwrap_or(line))
    }
}

/// Reads a picture.
pub(crate) fn read(bytes: &[u8], limits: &Limits) -> Result<Picture, Fault> {
    let mut source = Bytes(bytes);
    let header = read_header(&mut source)?;
    let (w, h) = (header.line as u64, header.lines as u64);
    let needed = w
        .saturating_mul(h)
        .saturating_mul(size_of::<[f32; 3]>() as u64);
    if needed > limits.max_bytes {
        return Err(Fault::TooLarge {
            width: w,
            height: h,
            needed,
            limit: limits.max_bytes,
        });
    }
    if h.saturating_mul(4) > source.0.len() as u64 {
        return Err(Fault::damaged(format!(
            "the HDR file is too short for {w}x{h} pixels"
        )));
    }

    // Grows scan line by scan line: a header's claim alone allocates one line.
    let mut stored = Vec::new();
    let mut scan = vec![[0u8; 4]; header.line];
    for _ in 0..header.lines {
        read_scan(&mut source, &mut scan)?;
        stored.extend(scan.iter().map(|&rgbe| {
            let color = decode(rgbe);
            std::array::from_fn(|c| color[c] / header.scale[c])
        }));
    }
    Ok(upright(stored, &header))
}

/// Puts stored scan lines into rows from the top left.
fn upright(stored: Vec<[f32; 3]>, header: &Header) -> Picture {
    let (width, height) = if header.columns {
        (header.lines, header.line)
    } else {
        (header.line, header.lines)
    };
    if !(header.columns || header.flip_x || header.flip_y) {
        return Picture {
            width: width as u32,
            height: height as u32,
            pixels: stored,
        };
    }
    let mut picture = Picture::new(width as u32, height as u32);
    for (n, &color) in stored.iter().enumerate() {
        let (j, i) = (n / header.line, n % header.line);
        let (x, y) = if header.columns { (j, i) } else { (i, j) };
        let x = if header.flip_x { width - 1 - x } else { x };
        let y = if header.flip_y { height - 1 - y } else { y };
        picture.pixels[y * width + x] = color;
    }
    picture
}

fn read_header(source: &mut Bytes) -> Result<Header, Fault> {
    if !source.text_line()?.starts_with(b"#?") {
        return Err(Fault::damaged("no HDR header"));
    }
    let mut scale = [1f32; 3];
    loop {
        let line = String::from_utf8_lossy(source.text_line()?);
        let line = line.trim();
        if line.is_empty() {
            break;
        }
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        match key.trim() {
            "FORMAT" => match value.trim() {
                "32-bit_rle_rgbe" => {}
                "32-bit_rle_xyze" => {
                    return Err(Fault::unsupported(
                        "HDR pixels in XYZE",
                        "convert with `ra_xyze -r`",
                    ));
                }
                other => {
                    let other: String = other.chars().take(40).collect();
                    return Err(Fault::unsupported(
                        format!("HDR pixel format {other:?}"),
                        "export as 32-bit_rle_rgbe",
                    ));
                }
            },
            "EXPOSURE" => {
                if let Some(factor) = factor(value) {
                    scale = scale.map(|s| s * factor);
                }
            }
            "COLORCORR" => {
                let factors: Vec<_> = value.split_whitespace().filter_map(factor).collect();
                if let [r, g, b] = factors[..] {
                    scale = [scale[0] * r, scale[1] * g, scale[2] * b];
                }
            }
            _ => {}
        }
    }
    if !scale.iter().all(|s| s.is_normal()) {
        return Err(Fault::damaged(
            "the HDR file's EXPOSURE lines multiply to nothing usable",
        ));
    }
    let resolution = String::from_utf8_lossy(source.text_line()?);
    read_resolution(&resolution, scale).ok_or_else(|| {
        Fault::damaged(format!(
            "no HDR resolution line but {:?}",
            resolution.chars().take(40).collect::<String>()
        ))
    })
}

/// A usable factor: positive and finite. Others are ignored, as Radiance's own tools write none.
fn factor(text: &str) -> Option<f32> {
    text.trim()
        .parse::<f32>()
        .ok()
        .filter(|f| f.is_normal() && *f > 0.0)
}

/// `-Y 4 +X 8`: the first axis is the slow one; `-Y` is top to bottom, `+X` left to right.
fn read_resolution(text: &str, scale: [f32; 3]) -> Option<Header> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let [slow, lines, fast, line] = words[..] else {
        return None;
    };
    let columns = match (slow, fast) {
        ("-Y" | "+Y", "-X" | "+X") => false,
        ("-X" | "+X", "-Y" | "+Y") => true,
        _ => return None,
    };
    let size = |text: &str| {
        text.parse::<u32>()
            .ok()
            .filter(|&n| (1..=i32::MAX as u32).contains(&n))
            .map(|n| n as usize)
    };
    let either = |axis| slow == axis || fast == axis;
    Some(Header {
        line: size(line)?,
        lines: size(lines)?,
        columns,
        flip_x: either("-X"),
        flip_y: either("+Y"),
        scale,
    })
}

fn read_scan(source: &mut Bytes, scan: &mut [[u8; 4]]) -> Result<(), Fault> {
    let first = source.rgbe()?;
    let claimed = usize::from(first[2]) << 8 | usize::from(first[3]);
    if NEW_RLE_WIDTHS.contains(&scan.len()) && first[..2] == [2, 2] && first[2] < 128 {
        if claimed != scan.len() {
            return Err(Fault::damaged(format!(
                "an HDR scan line of {claimed} pixels, not {}",
                scan.len()
            )));
        }
        return read_new_rle(source, scan);
    }
    read_old_rle(source, first, scan)
}

/// Each channel by itself: counts above 128 repeat one byte, others announce bytes as they are.
fn read_new_rle(source: &mut Bytes, scan: &mut [[u8; 4]]) -> Result<(), Fault> {
    for channel in 0..4 {
        let mut x = 0;
        while x < scan.len() {
            let code = usize::from(source.take(1)?[0]);
            let (count, repeats) = if code > 128 {
                (code - 128, true)
            } else {
                (code, false)
            };
            let run = scan[x..].get_mut(..count).filter(|r| !r.is_empty());
            let run = run.ok_or_else(|| Fault::damaged("an HDR run leaves its scan line"))?;
            let values = source.take(if repeats { 1 } else { count })?;
            for (i, pixel) in run.iter_mut().enumerate() {
                pixel[channel] = values[if repeats { 0 } else { i }];
            }
            x += count;
        }
    }
    Ok(())
}

/// Whole pixels; (1, 1, 1, n) repeats the one before n times, and consecutive ones are the digits of a number in base
/// 256, lowest first. A flat file is one without repeats.
fn read_old_rle(source: &mut Bytes, first: [u8; 4], scan: &mut [[u8; 4]]) -> Result<(), Fault> {
    let (mut x, mut shift, mut next) = (0, 0u32, Some(first));
    while x < scan.len() {
        let pixel = match next.take() {
            Some(pixel) => pixel,
            None => source.rgbe()?,
        };
        if pixel[..3] == [1, 1, 1] {
            let count = usize::from(pixel[3])
                .checked_shl(shift)
                .unwrap_or(usize::MAX);
            if x == 0 || shift > 24 || count > scan.len() - x {
                return Err(Fault::damaged("an HDR run leaves its scan line"));
            }
            let before = scan[x - 1];
            scan[x..x + count].fill(before);
            x += count;
            shift += 8;
        } else {
            scan[x] = pixel;
            x += 1;
            shift = 0;
        }
    }
    Ok(())
}

fn decode([r, g, b, e]: [u8; 4]) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    // In f64 because 2^(1 - 136) is below the smallest normal f32.
    let scale = f64::from(i32::from(e) - 136).exp2();
    [r, g, b].map(|m| (f64::from(m) * scale) as f32)
}

/// The nearest RGBE; negative and NaN become 0, the largest expressible value stands for all beyond.
fn encode(color: [f32; 3]) -> [u8; 4] {
    const LARGEST: f64 = 255.0 * (1u128 << 119) as f64;
    let c = color.map(|v| f64::from(v.max(0.0)).min(LARGEST));
    let peak = c[0].max(c[1]).max(c[2]);
    if peak < f64::from(-129f32).exp2() {
        return [0; 4];
    }
    let mut exponent = peak.log2().floor() as i32 + 1;
    // Rounding must not carry the largest mantissa to 256, whatever log2 did near a power of two.
    if (peak * f64::from(8 - exponent).exp2()).round() > 255.0 {
        exponent += 1;
    }
    let exponent = exponent.clamp(-127, 127);
    let scale = f64::from(8 - exponent).exp2();
    let m = c.map(|v| (v * scale).round().min(255.0) as u8);
    [m[0], m[1], m[2], (exponent + 128) as u8]
}

/// Writes a picture, run-length encoded where the width allows.
pub(crate) fn write(
    picture: &Picture,
    comments: &[(String, String)],
    out: &mut (impl Write + ?Sized),
) -> io::Result<()> {
    out.write_all(b"#?RADIANCE\n")?;
    for (name, value) in comments {
        // One line each, and never something that a reader would take for a header variable.
        let text: String = format!("# {name}: {value}")
            .chars()
            .map(|c| if c.is_control() || c == '=' { ' ' } else { c })
            .collect();
        writeln!(out, "{text}")?;
    }
    writeln!(
        out,
        "FORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}",
        picture.height, picture.width
    )?;
    let width = picture.width as usize;
    let mut packed = Vec::new();
    for row in picture.pixels.chunks(width.max(1)) {
        let scan: Vec<[u8; 4]> = row.iter().map(|&c| encode(c)).collect();
        packed.clear();
        if NEW_RLE_WIDTHS.contains(&width) {
            packed.extend([2, 2, (width >> 8) as u8, width as u8]);
            for channel in 0..4 {
                pack_channel(
                    &scan.iter().map(|p| p[channel]).collect::<Vec<_>>(),
                    &mut packed,
                );
            }
        } else {
            // A flat pixel cannot be mistaken for a repeat, (1, 1, 1, n): the largest mantissa is at least 64.
            packed.extend(scan.as_flattened());
        }
        out.write_all(&packed)?;
    }
    Ok(())
}

/// Runs of four and more as runs, the rest as it is.
fn pack_channel(values: &[u8], out: &mut Vec<u8>) {
    const SHORTEST: usize = 4;
    let run_at = |i: usize| {
        values[i..]
            .iter()
            .take(127)
            .take_while(|&&v| v == values[i])
            .count()
    };
    let mut x = 0;
    while x < values.len() {
        let run = run_at(x);
        if run >= SHORTEST {
            out.extend([128 + run as u8, values[x]]);
            x += run;
            continue;
        }
        let start = x;
        while x < values.len() && x - start < 128 && run_at(x) < SHORTEST {
            x += 1;
        }
        out.push((x - start) as u8);
        out.extend(&values[start..x]);
    }
}
