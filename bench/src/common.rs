//! What all suites share: the machine, the clock, results and the report.

use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What was asked for on the command line.
pub struct Setting {
    pub quick: bool,
    pub scenes: PathBuf,
    pub only: Vec<String>,
    /// Parts of a suite that are wanted; empty: all.
    pub topics: Vec<String>,
    /// Size of pictures, if not the suite's own.
    pub size: Option<[u32; 2]>,
    /// Samples a pixel, if not the suite's own.
    pub samples: Vec<u32>,
    /// Repetitions, if not the suite's own.
    pub repetitions: Option<usize>,
    /// Where results are written.
    pub out: PathBuf,
}

impl Setting {
    /// Is this scene wanted?
    pub fn wants(&self, scene: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|name| name == scene)
    }

    /// Is this part of the suite wanted?
    pub fn wants_topic(&self, topic: &str) -> bool {
        self.topics.is_empty() || self.topics.iter().any(|name| name == topic)
    }
}

/// One measured number.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub name: String,
    pub scene: String,
    pub value: f64,
    pub unit: String,
    /// The other side's number; `null` without one.
    pub baseline: Option<f64>,
    /// Ours against the baseline, above 1 is better for rates, below 1 for costs.
    pub ratio: Option<f64>,
    /// (Largest - smallest) / median over the repetitions.
    pub spread: Option<f64>,
    /// What was to be reached, in words such as `>= 1.15`.
    pub bar: Option<String>,
    /// Was it?
    pub holds: Option<bool>,
}

/// Numbers side by side, for a reader.
struct Table {
    title: String,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// Everything that a suite found out.
pub struct Report {
    title: String,
    rows: Vec<Row>,
    tables: Vec<Table>,
    figures: Vec<(String, String)>,
    notes: Vec<String>,
    csv: String,
    live: Option<PathBuf>,
}

impl Report {
    pub fn new(title: &str, csv_header: &str) -> Self {
        Self {
            title: title.into(),
            rows: Vec::new(),
            tables: Vec::new(),
            figures: Vec::new(),
            notes: Vec::new(),
            csv: format!("{csv_header}\n"),
            live: None,
        }
    }

    /// From now on [`Report::save`] writes what there is to this folder.
    pub fn live(&mut self, folder: &Path) {
        if let Err(error) = std::fs::create_dir_all(folder) {
            eprintln!("{}: {error}", folder.display());
        }
        self.live = Some(folder.to_owned());
    }

    /// Writes what there is, so that a run which is cut off leaves it.
    pub fn save(&self) {
        if let Some(folder) = &self.live
            && let Err(error) = self.write(folder)
        {
            eprintln!("{}: {error}", folder.display());
        }
    }

    /// Adds a row to the table of that title, which is made if it is not there; shown at once too.
    pub fn table(&mut self, title: &str, header: &[&str], cells: Vec<String>) {
        let index = match self.tables.iter().position(|table| table.title == title) {
            Some(index) => index,
            None => {
                self.tables.push(Table {
                    title: title.into(),
                    header: header.iter().map(|&name| name.into()).collect(),
                    rows: Vec::new(),
                });
                self.tables.len() - 1
            }
        };
        let table = &mut self.tables[index];
        let pairs = table.header.iter().zip(&cells);
        let line: Vec<String> = pairs.map(|(name, cell)| format!("{name} {cell}")).collect();
        eprintln!("{title}: {}", line.join(", "));
        table.rows.push(cells);
        self.save();
    }

    /// A figure: what it shows, and its HTML (inline SVG, or pictures beside the report). One of the same caption is replaced.
    pub fn figure(&mut self, caption: &str, html: String) {
        self.figures.retain(|(other, _)| other != caption);
        self.figures.push((caption.into(), html));
        self.save();
    }

    /// The tables as Markdown.
    fn markdown(&self) -> String {
        let mut out = String::new();
        for table in &self.tables {
            let _ = writeln!(
                out,
                "## {}\n\n| {} |",
                table.title,
                table.header.join(" | ")
            );
            let _ = writeln!(out, "|{}", "-|".repeat(table.header.len()));
            for row in &table.rows {
                let _ = writeln!(out, "| {} |", row.join(" | "));
            }
            out.push('\n');
        }
        out
    }

    pub fn row(&mut self, row: Row) {
        self.rows.push(row);
    }

    /// A remark for the reader, shown at once too.
    /// Notes which of the topics that were asked for the suite does not have.
    pub fn unknown_topics(&mut self, setting: &Setting, topics: &[&str]) {
        for topic in &setting.topics {
            if !topics.contains(&topic.as_str()) {
                self.note(format!(
                    "no topic {topic:?}: there are {}",
                    topics.join(", ")
                ));
            }
        }
    }

    pub fn note(&mut self, text: impl Into<String>) {
        let text = text.into();
        eprintln!("{text}");
        self.notes.push(text);
    }

    pub fn raw(&mut self, line: &str) {
        self.csv.push_str(line);
        self.csv.push('\n');
    }

    pub fn text(&self) -> String {
        let mut out = String::new();
        for row in &self.rows {
            let _ = write!(
                out,
                "{:<34} {:<16} {:>10.4} {:<14}",
                row.name, row.scene, row.value, row.unit
            );
            if let (Some(baseline), Some(ratio)) = (row.baseline, row.ratio) {
                let _ = write!(out, " against {baseline:>9.4}: {ratio:.3}");
            }
            if let Some(spread) = row.spread {
                let _ = write!(out, " (spread {spread:.2})");
            }
            if let (Some(bar), Some(holds)) = (&row.bar, row.holds) {
                let _ = write!(out, "  {bar} {}", if holds { "HOLDS" } else { "MISSED" });
            }
            out.push('\n');
        }
        out
    }

    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        std::fs::create_dir_all(folder)?;
        let json = serde_json::to_string_pretty(&self.rows).map_err(std::io::Error::other)?;
        std::fs::write(folder.join("results.json"), json + "\n")?;
        std::fs::write(folder.join("raw.csv"), &self.csv)?;
        if !self.tables.is_empty() {
            std::fs::write(folder.join("tables.md"), self.markdown())?;
        }
        std::fs::write(folder.join("report.html"), self.html())
    }

    fn html(&self) -> String {
        let mut out = format!(
            "<!doctype html><meta charset=utf-8><title>{0}</title>\
             <style>body{{font:15px sans-serif;margin:2em;max-width:75em}}td,th{{padding:.2em .8em;text-align:right}}\
             td:nth-child(-n+2),th:nth-child(-n+2){{text-align:left}}tr:nth-child(even){{background:#f3f3f3}}\
             .yes{{color:#070}}.no{{color:#b00;font-weight:bold}}pre{{white-space:pre-wrap}}\
             table{{border-collapse:collapse;font-variant-numeric:tabular-nums}}figure{{margin:1.5em 0}}img{{max-width:100%;image-rendering:pixelated}}</style><h1>{0}</h1><pre>{1}</pre>",
            escape(&self.title),
            escape(&machine()),
        );
        out.push_str("<table><tr><th>what<th>scene<th>value<th>unit<th>baseline<th>ratio<th>spread<th>bar<th>holds</tr>\n");
        let number = |x: Option<f64>| x.map_or_else(String::new, |x| format!("{x:.4}"));
        for row in &self.rows {
            let holds = match row.holds {
                Some(true) => "<span class=yes>yes</span>",
                Some(false) => "<span class=no>no</span>",
                None => "",
            };
            let _ = writeln!(
                out,
                "<tr><td>{}<td>{}<td>{:.4}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{holds}</tr>",
                escape(&row.name),
                escape(&row.scene),
                row.value,
                escape(&row.unit),
                number(row.baseline),
                number(row.ratio),
                number(row.spread),
                escape(row.bar.as_deref().unwrap_or_default()),
            );
        }
        out.push_str("</table>\n");
        for table in &self.tables {
            let _ = writeln!(out, "<h2>{}</h2><table><tr>", escape(&table.title));
            for name in &table.header {
                let _ = write!(out, "<th>{}", escape(name));
            }
            for row in &table.rows {
                out.push_str("</tr>\n<tr>");
                for cell in row {
                    let _ = write!(out, "<td>{}", escape(cell));
                }
            }
            out.push_str("</tr></table>\n");
        }
        for (caption, html) in &self.figures {
            let _ = writeln!(
                out,
                "<figure><figcaption>{}</figcaption>{html}</figure>",
                escape(caption)
            );
        }
        out.push_str("<ul>");
        for note in &self.notes {
            let _ = writeln!(out, "<li>{}", escape(note));
        }
        out.push_str("</ul>\n");
        out
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn first_line(command: &str, arguments: &[&str]) -> String {
    Command::new(command)
        .args(arguments)
        .output()
        .ok()
        .and_then(|o| {
            Some(
                String::from_utf8_lossy(&o.stdout)
                    .lines()
                    .next()?
                    .to_owned(),
            )
        })
        .unwrap_or_else(|| "unknown".into())
}

/// Processor, cores, memory, system, compiler and commit.
pub fn machine() -> String {
    let read = |path: &str, key: &str| {
        std::fs::read_to_string(path)
            .ok()
            .and_then(|text| {
                let line = text.lines().find(|l| l.starts_with(key))?;
                Some(line.split_once(':')?.1.trim().to_owned())
            })
            .unwrap_or_else(|| "unknown".into())
    };
    format!(
        "processor: {} (family {}, model {}), {} threads\nmemory: {}\nsystem: {}\ncompiler: {}\ncommit: {}\n",
        read("/proc/cpuinfo", "model name"),
        read("/proc/cpuinfo", "cpu family"),
        read("/proc/cpuinfo", "model\t"),
        std::thread::available_parallelism().map_or(0, usize::from),
        read("/proc/meminfo", "MemTotal"),
        first_line("uname", &["-sr"]),
        first_line("rustc", &["--version"]),
        first_line("git", &["describe", "--always", "--dirty"]),
    )
}

fn clock(which: libc::clockid_t) -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a valid place to write to; both clocks exist on every system that this crate builds for.
    unsafe { libc::clock_gettime(which, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Processor seconds of this thread: what other programs take away does not count.
pub fn thread_seconds() -> f64 {
    clock(libc::CLOCK_THREAD_CPUTIME_ID)
}

/// Processor seconds of all threads of this process.
pub fn process_seconds() -> f64 {
    clock(libc::CLOCK_PROCESS_CPUTIME_ID)
}

/// The middle value and the spread (largest - smallest) / median.
pub fn median(values: &[f64]) -> (f64, f64) {
    let mut v = values.to_vec();
    v.sort_by(f64::total_cmp);
    let n = v.len();
    let middle = if n % 2 == 1 {
        v[n / 2]
    } else {
        0.5 * (v[n / 2 - 1] + v[n / 2])
    };
    (middle, (v[n - 1] - v[0]) / middle)
}

/// The geometric mean.
pub fn geometric_mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0);
    for v in values {
        sum += v.ln();
        n += 1;
    }
    (sum / f64::from(n.max(1))).exp()
}
