//! Comparisons for people: a map of where two pictures differ, and a page that needs no other file.

use std::io;
use std::path::Path;

use base64::Engine as _;
use rayon::prelude::*;

use crate::magma::magma;
use crate::metrics::{Compared, middle_grey_exposure};
use crate::{
    Depth, Encoding, Format, ImageError, Layers, Look, Picture, ToneMap, png, write_atomically,
    write_layers,
};

/// Writes where `a` differs from the reference `b`.
///
/// PNG: FLIP in the colours of magma, black for 0, pale yellow for 1. EXR: the signed difference `a - b` as R, G, B, and
/// FLIP as `flip.Y`.
///
/// # Errors
/// [`ImageError::Destination`] for other extensions, [`ImageError::SizeMismatch`], [`ImageError::Write`].
pub fn write_map(
    path: &Path,
    a: &Picture,
    b: &Picture,
    compared: &Compared,
) -> Result<(), ImageError> {
    a.same_size(b)?;
    check_map_size(a, compared)?;
    match Format::from_extension(path) {
        Some(Format::Png) => {
            let text = [
                ("Software".to_owned(), crate::codec::SOFTWARE.to_owned()),
                (
                    "Description".to_owned(),
                    "FLIP error in magma colours: black 0, pale yellow 1".to_owned(),
                ),
            ];
            let rgb = flip_colors(compared);
            write_atomically(path, |out| {
                png::write(a.width, a.height, rgb.as_flattened(), &text, out)
            })
        }
        Some(Format::Exr) => {
            let mut difference = a.clone();
            for (d, b) in difference.pixels.iter_mut().zip(&b.pixels) {
                *d = std::array::from_fn(|c| d[c] - b[c]);
            }
            let mut layers = Layers::from_picture(&difference, Depth::Float);
            layers.push("flip.Y", Depth::Float, compared.flip_map.clone());
            write_layers(path, &layers, Look::default())
        }
        _ => Err(ImageError::Destination {
            path: path.to_owned(),
            what: "unknown format of a difference map".to_owned(),
            cure: "use the extension .png or .exr",
        }),
    }
}

fn check_map_size(picture: &Picture, compared: &Compared) -> Result<(), ImageError> {
    if compared.flip_map.len() != picture.pixels.len() {
        return Err(ImageError::Inconsistent(
            "the FLIP map is of other pictures".to_owned(),
        ));
    }
    Ok(())
}

fn flip_colors(compared: &Compared) -> Vec<[u8; 3]> {
    compared.flip_map.par_iter().map(|&v| magma(v)).collect()
}

/// A picture with the name that people know it by.
#[derive(Clone, Copy, Debug)]
pub struct Named<'a> {
    /// A file name, say.
    pub name: &'a str,
    /// The picture.
    pub picture: &'a Picture,
}

/// Writes a self-contained HTML page: the numbers, both pictures under a slider, the amplified difference, and FLIP.
///
/// Scene-linear pictures are shown with the default tone map at the exposure that brings the reference's mean to middle
/// grey; the page says so.
///
/// # Errors
/// [`ImageError::SizeMismatch`], [`ImageError::Write`].
pub fn write_report(
    path: &Path,
    a: Named,
    b: Named,
    encoding: Encoding,
    compared: &Compared,
) -> Result<(), ImageError> {
    a.picture.same_size(b.picture)?;
    check_map_size(a.picture, compared)?;
    let page = page(a, b, encoding, compared).map_err(|source| ImageError::Write {
        path: path.to_owned(),
        source,
    })?;
    write_atomically(path, |out| out.write_all(page.as_bytes()))
}

fn page(a: Named, b: Named, encoding: Encoding, compared: &Compared) -> io::Result<String> {
    let look = match encoding {
        Encoding::Display => Look {
            tone_map: ToneMap::None,
            exposure_ev: 0.0,
        },
        Encoding::SceneLinear => Look {
            tone_map: ToneMap::default(),
            exposure_ev: middle_grey_exposure(b.picture),
        },
    };
    let shown = match encoding {
        Encoding::Display => "shown as they are".to_owned(),
        Encoding::SceneLinear => format!(
            "shown at {:+.2} EV with the tone map {}",
            look.exposure_ev,
            look.tone_map.title()
        ),
    };
    let seen = |p: &Picture| {
        p.pixels
            .par_iter()
            .map(|&c| look.tone_map.encode(c, look.exposure_ev))
            .collect::<Vec<_>>()
    };
    let (times, difference) = amplified_difference(a.picture, b.picture, look.exposure_ev);
    let (width, height) = (a.picture.width, a.picture.height);
    let image = |rgb: Vec<[u8; 3]>| -> io::Result<String> {
        let mut bytes = Vec::new();
        png::write(width, height, rgb.as_flattened(), &[], &mut bytes)?;
        Ok(format!(
            "data:image/png;base64,{}",
            base64::engine::general_purpose::STANDARD.encode(bytes)
        ))
    };
    let (name_a, name_b) = (escaped(a.name), escaped(b.name));
    let n = &compared.numbers;
    let flip_kind = if encoding == Encoding::Display {
        "LDR-FLIP"
    } else {
        "HDR-FLIP"
    };
    let rows: String = [
        (
            flip_kind,
            number(n.flip),
            "what a viewer sees when the two are alternated, 0 to 1",
        ),
        (
            "relMSE",
            number(n.relmse),
            "squared error relative to the reference, exposure-free",
        ),
        ("MSE", number(n.mse), "mean squared error, linear light"),
        (
            "PSNR",
            format!("{} dB", number(n.psnr)),
            "peak signal to noise",
        ),
        ("SSIM", number(n.ssim), "structural similarity, 1 for equal"),
        (
            "energy change",
            number(n.energy_change),
            "sum of absolute differences over sum of reference",
        ),
        ("mean of A", triple(n.mean_a), "red, green, blue"),
        ("mean of B", triple(n.mean_b), "red, green, blue"),
    ]
    .iter()
    .map(|(name, value, meaning)| {
        format!("<tr><th>{name}</th><td>{value}</td><td>{meaning}</td></tr>\n")
    })
    .collect();
    let times = if times >= 1.0 {
        format!("{times}")
    } else {
        format!("1/{}", 1.0 / times)
    };
    Ok(format!(
        r##"<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{name_a} against {name_b}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1600px; padding: 0 1rem; background: #1c1c1e; color: #e6e6e6; }}
h1 {{ font-size: 1.3rem; }} h2 {{ font-size: 1.05rem; margin: 1.5rem 0 .4rem; }} p, caption {{ color: #a8a8ad; }}
table {{ border-collapse: collapse; }} th, td {{ text-align: left; padding: .15rem 1.2rem .15rem 0; border-bottom: 1px solid #333; font-variant-numeric: tabular-nums; }}
img {{ display: block; width: 100%; image-rendering: {rendering}; }}
.pair {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); gap: 1rem; }}
.slide {{ position: relative; }} .slide img + img {{ position: absolute; inset: 0; clip-path: inset(0 0 0 var(--at, 50%)); }}
.slide span {{ position: absolute; top: .4rem; padding: 0 .5rem; background: #000a; border-radius: .3rem; }}
input {{ width: 100%; }} .scale {{ height: .8rem; background: linear-gradient(to right, {gradient}); }}
.ends {{ display: flex; justify-content: space-between; }}
</style></head><body>
<h1>A: {name_a} &nbsp; B, the reference: {name_b}</h1>
<p>{width} x {height} pixels; {shown}.</p>
<table>
{rows}</table>
<h2>A on the left, B on the right of the slider</h2>
<div class="slide"><img alt="A" src="{seen_a}"><img alt="B" src="{seen_b}"><span style="left:.4rem">A</span><span style="right:.4rem">B</span></div>
<input type="range" min="0" max="100" value="50" step="0.1" aria-label="border between A and B"
 oninput="this.previousElementSibling.style.setProperty('--at', this.value + '%')">
<div class="pair">
<div><h2>Difference: |A - B| x {times}</h2><img alt="difference" src="{difference}">
<p>Of exposed linear light, each channel by itself.</p></div>
<div><h2>{flip_kind}, mean {flip}</h2><img alt="FLIP" src="{flip_map}">
<div class="scale"></div><div class="ends"><span>0</span><span>0.5</span><span>1</span></div></div>
</div>
</body></html>
"##,
        rendering = if width.max(height) < 700 {
            "pixelated"
        } else {
            "auto"
        },
        gradient = (0..=16)
            .map(|i| color_text(magma(i as f32 / 16.0)))
            .collect::<Vec<_>>()
            .join(", "),
        seen_a = image(seen(a.picture))?,
        seen_b = image(seen(b.picture))?,
        difference = image(difference)?,
        flip_map = image(flip_colors(compared))?,
        flip = number(n.flip),
    ))
}

/// The factor, a power of two that brings the 99th percentile to between 1/4 and 1/2, and the coded bytes.
fn amplified_difference(a: &Picture, b: &Picture, exposure_ev: f32) -> (f32, Vec<[u8; 3]>) {
    let scale = exposure_ev.exp2();
    let difference: Vec<[f32; 3]> = a
        .pixels
        .iter()
        .zip(&b.pixels)
        .map(|(a, b)| std::array::from_fn(|c| ((a[c] - b[c]) * scale).abs()))
        .collect();
    let mut largest: Vec<f32> = difference
        .iter()
        .map(|d| d[0].max(d[1]).max(d[2]))
        .collect();
    let rank = (largest.len().saturating_sub(1)) * 99 / 100;
    let high = if largest.is_empty() {
        0.0
    } else {
        *largest.select_nth_unstable_by(rank, f32::total_cmp).1
    };
    let times = if high > 0.0 {
        (0.5 / high).log2().floor().clamp(-10.0, 10.0).exp2()
    } else {
        1.0
    };
    (
        times,
        difference
            .par_iter()
            .map(|d| ToneMap::None.encode(d.map(|v| v * times), 0.0))
            .collect(),
    )
}

fn color_text([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Four significant digits.
fn number(value: f64) -> String {
    if !value.is_finite() {
        return "none".to_owned();
    }
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.3e}");
    }
    let whole = if value == 0.0 {
        1
    } else {
        value.abs().log10().floor() as i32 + 1
    };
    format!("{value:.*}", (4 - whole).clamp(0, 6) as usize)
}

fn triple(values: [f64; 3]) -> String {
    values.map(number).join(" ")
}

/// Text that HTML cannot mistake.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::compare;
    use crate::tests::sample_picture;
    use crate::{Limits, read, read_layers};

    #[test]
    fn the_page_holds_everything_itself() {
        let (a, b) = (sample_picture(30, 20, 1), sample_picture(30, 20, 2));
        for encoding in [Encoding::SceneLinear, Encoding::Display] {
            let compared = compare(&a, &b, encoding).unwrap();
            let (a, b) = (
                Named {
                    name: "<a>&\"",
                    picture: &a,
                },
                Named {
                    name: "b.exr",
                    picture: &b,
                },
            );
            let page = page(a, b, encoding, &compared).unwrap();
            assert_eq!(page.matches("data:image/png;base64,").count(), 4);
            assert!(!page.contains("<a>") && page.contains("&lt;a&gt;&amp;&quot;"));
            assert!(!page.contains("http") && !page.contains("{}"));
            assert!(page.contains(&number(compared.numbers.flip)));
        }
    }

    #[test]
    fn maps_say_where() {
        let b = sample_picture(40, 30, 2);
        let mut a = b.clone();
        // Where the reference is visible; a square of 6x6.
        for (i, pixel) in a.pixels.iter_mut().enumerate() {
            if (10..16).contains(&(i % 40)) && (10..16).contains(&(i / 40)) {
                *pixel = [40.0, 0.0, 40.0];
            }
        }
        let compared = compare(&a, &b, Encoding::SceneLinear).unwrap();
        let path = std::env::temp_dir().join(format!("occlude-map-{}.png", std::process::id()));
        write_map(&path, &a, &b, &compared).unwrap();
        let map = read(&path, &Limits::default()).unwrap().picture;
        let bright = |x, y| map.get(x, y).unwrap()[0];
        assert!(
            bright(12, 12) > 0.3 && bright(35, 25) < 0.05,
            "{} {}",
            bright(12, 12),
            bright(35, 25)
        );
        std::fs::remove_file(&path).unwrap();
        let path = path.with_extension("exr");
        write_map(&path, &a, &b, &compared).unwrap();
        let layers = read_layers(&path, &Limits::default()).unwrap();
        assert_eq!(layers.channel("flip.Y").unwrap().values, compared.flip_map);
        assert_eq!(
            layers.picture("").unwrap().get(12, 12).unwrap()[1],
            0.0 - b.get(12, 12).unwrap()[1]
        );
        std::fs::remove_file(&path).unwrap();
        assert!(write_map(&path.with_extension("hdr"), &a, &b, &compared).is_err());
    }

    #[test]
    fn numbers_are_short() {
        let all = [
            0.0,
            1.0,
            12.345678,
            99999.4,
            1e7,
            0.00123456,
            1e-9,
            f64::INFINITY,
        ]
        .map(number);
        assert_eq!(
            all,
            [
                "0.000", "1.000", "12.35", "99999", "1.000e7", "0.001235", "1.000e-9", "none"
            ]
        );
    }
}
