//! Curves as SVG, in the page or beside it.

use std::fmt::Write as _;

/// A curve.
pub struct Curve {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    /// Without anti-aliasing, say.
    pub dashed: bool,
}

/// A diagram.
pub struct Plot<'a> {
    pub title: &'a str,
    pub x: &'a str,
    pub log_x: bool,
    pub log_y: bool,
    pub curves: &'a [Curve],
}

const WIDTH: f64 = 520.0;
const HEIGHT: f64 = 340.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 150.0;
const TOP: f64 = 28.0;
const BOTTOM: f64 = 40.0;
/// Okabe & Ito's colours, which colour-blind people can tell apart.
const COLOURS: [&str; 8] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a7a00",
];

/// One axis: from values to places.
struct Axis {
    low: f64,
    high: f64,
    log: bool,
}

impl Axis {
    fn of(values: impl Iterator<Item = f64>, log: bool) -> Option<Self> {
        let values = values.filter(|v| v.is_finite() && (!log || *v > 0.0));
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        if low > high {
            return None;
        }
        Some(if log {
            let (low, high) = (low.log10(), high.log10());
            let margin = (0.05 * (high - low)).max(0.02);
            Self {
                low: low - margin,
                high: high + margin,
                log,
            }
        } else {
            let low = if low > 0.0 { 0.0 } else { low };
            Self {
                low,
                high: if high > low {
                    high + 0.05 * (high - low)
                } else {
                    low + 1.0
                },
                log,
            }
        })
    }

    /// From 0 to 1; `None` for what cannot be shown.
    fn place(&self, value: f64) -> Option<f64> {
        let value = if self.log { value.log10() } else { value };
        value
            .is_finite()
            .then(|| (value - self.low) / (self.high - self.low))
    }

    fn ticks(&self) -> Vec<f64> {
        if self.log {
            let decades = self.low.floor() as i32..=self.high.ceil() as i32;
            let narrow = self.high - self.low < 2.5;
            let steps: &[f64] = if narrow { &[1.0, 2.0, 5.0] } else { &[1.0] };
            let all = decades.flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d)));
            return all
                .filter(|t| (self.low..=self.high).contains(&t.log10()))
                .collect();
        }
        let raw = (self.high - self.low) / 6.0;
        let decade = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .map(|s| s * decade)
            .find(|&s| s >= raw)
            .unwrap_or(decade);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

fn number(value: f64) -> String {
    if value == 0.0 {
        "0".to_owned()
    } else if !(1e-3..1e5).contains(&value.abs()) {
        format!("{value:.0e}")
    } else {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

impl Plot<'_> {
    /// A whole SVG document; nothing to show is an empty diagram.
    pub fn svg(&self) -> String {
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" \
             font-family=\"sans-serif\" font-size=\"11\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\
             <text x=\"{LEFT}\" y=\"16\" font-size=\"13\">{}</text>",
            escaped(self.title)
        );
        let points = || self.curves.iter().flat_map(|curve| &curve.points);
        let axes = Axis::of(points().map(|p| p.0), self.log_x)
            .zip(Axis::of(points().map(|p| p.1), self.log_y));
        if let Some((x, y)) = axes {
            self.draw(&mut out, &x, &y);
        }
        out.push_str("</svg>\n");
        out
    }

    fn draw(&self, out: &mut String, x: &Axis, y: &Axis) {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        let across = |v: f64| x.place(v).map(|p| LEFT + p * (right - LEFT));
        let down = |v: f64| y.place(v).map(|p| bottom - p * (bottom - TOP));
        for tick in x.ticks() {
            if let Some(place) = across(tick) {
                let _ = write!(
                    out,
                    "<path d=\"M{place:.1} {TOP}V{bottom}\" stroke=\"#e4e4e4\"/>\
                     <text x=\"{place:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                    bottom + 15.0,
                    number(tick)
                );
            }
        }
        for tick in y.ticks() {
            if let Some(place) = down(tick) {
                let _ = write!(
                    out,
                    "<path d=\"M{LEFT} {place:.1}H{right}\" stroke=\"#e4e4e4\"/>\
                     <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                    LEFT - 6.0,
                    place + 4.0,
                    number(tick)
                );
            }
        }
        let _ = write!(
            out,
            "<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" fill=\"none\" stroke=\"#555\"/>\
             <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            0.5 * (LEFT + right),
            HEIGHT - 8.0,
            escaped(self.x)
        );
        // Solid and dashed curves of one name share a colour.
        let mut names: Vec<&str> = Vec::new();
        for curve in self.curves {
            if !names.contains(&curve.name.as_str()) {
                names.push(&curve.name);
            }
            let index = names.iter().position(|&name| name == curve.name);
            let colour = COLOURS[index.unwrap_or(0) % COLOURS.len()];
            let places: Vec<(f64, f64)> = curve
                .points
                .iter()
                .filter_map(|&(x, y)| across(x).zip(down(y)))
                .collect();
            let path: Vec<String> = places
                .iter()
                .map(|(x, y)| format!("{x:.1} {y:.1}"))
                .collect();
            if path.is_empty() {
                continue;
            }
            let dash = if curve.dashed {
                " stroke-dasharray=\"5 4\""
            } else {
                ""
            };
            let _ = write!(
                out,
                "<path d=\"M{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\"{dash}/>",
                path.join("L")
            );
            for (x, y) in places {
                let _ = write!(
                    out,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.4\" fill=\"{colour}\"/>"
                );
            }
        }
        for (i, name) in names.iter().enumerate() {
            let y = TOP + 16.0 * i as f64 + 6.0;
            let colour = COLOURS[i % COLOURS.len()];
            let _ = write!(
                out,
                "<path d=\"M{} {y}h18\" stroke=\"{colour}\" stroke-width=\"2\"/><text x=\"{}\" y=\"{}\">{}</text>",
                right + 10.0,
                right + 33.0,
                y + 4.0,
                escaped(name)
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_lie_inside() {
        let curves = [Curve {
            name: "a < b".into(),
            points: vec![(1.0, 0.001), (10.0, 0.1), (100.0, 0.0), (256.0, f64::NAN)],
            dashed: true,
        }];
        for (log_x, log_y) in [(true, true), (false, false), (true, false)] {
            let svg = Plot {
                title: "t",
                x: "x",
                log_x,
                log_y,
                curves: &curves,
            }
            .svg();
            // A logarithm of 0 is left out, as is what is no number.
            let shown = if log_y { 2 } else { 3 };
            assert_eq!(svg.matches("<circle").count(), shown);
            assert!(svg.contains("a &lt; b") && !svg.contains("NaN"));
        }
        let empty = Plot {
            title: "t",
            x: "x",
            log_x: false,
            log_y: false,
            curves: &[],
        };
        assert!(empty.svg().ends_with("</svg>\n"));
    }

    #[test]
    fn ticks_are_round() {
        let axis = Axis::of([3.0, 41.0].into_iter(), false).unwrap();
        assert_eq!(axis.ticks(), [0.0, 10.0, 20.0, 30.0, 40.0]);
        let log = Axis::of([1e-4, 1.0].into_iter(), true).unwrap();
        assert_eq!(log.ticks().len(), 5);
    }
}
