//! What accuracy costs in time: a sweep over knobs as CSV, Markdown table and plot.
//!
//! A command that varies settings (`comgs ablate`, `comgs tradeoff`) fills a [`Sweep`], one [`Row`] a run, and
//! [`Sweep::write`] makes the files that the page shows. A row belongs to a knob (`group`) and has a value on it
//! (`label`); the default value is a row of every knob, also where all these rows are one and the same run.
//!
//! A measure that was not taken, or has no finite value, is empty in the CSV, a dash in the table, absent from the plot
//! and named in its caption.

use crate::PipelineError;
use crate::plot::{Chart, PNG_SCALE, Panel, Point, Scale, Series, number};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use crate::plot::Better;

pub(crate) mod drive;

/// Something measured of every run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Metric {
    /// Key in [`Row::values`] and column of the CSV (`albedo_psnr`).
    pub key: String,
    /// Name in the table and over the plot (`albedo PSNR`).
    pub label: String,
    /// Unit (`dB`, `°`, `MB`); empty where there is none.
    pub unit: String,
    /// Which way is good.
    pub better: Better,
    /// Decimals in the table.
    pub digits: usize,
}

impl Metric {
    /// A metric of these fields.
    #[must_use]
    pub fn new(key: &str, label: &str, unit: &str, better: Better, digits: usize) -> Self {
        Self { key: key.into(), label: label.into(), unit: unit.into(), better, digits }
    }

    /// `label (unit)`.
    #[must_use]
    pub fn title(&self) -> String {
        if self.unit.is_empty() { self.label.clone() } else { format!("{} ({})", self.label, self.unit) }
    }
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The knob that was turned (`probes`).
    pub group: String,
    /// Its value (`5k`, `16²`).
    pub label: String,
    /// Whether this is the knob's default value.
    pub is_default: bool,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Measures by [`Metric::key`].
    pub values: BTreeMap<String, f64>,
}

impl Row {
    fn value(&self, metric: &Metric) -> f64 {
        self.values.get(&metric.key).copied().unwrap_or(f64::NAN)
    }
}

/// Runs that differ in one knob each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// Heading.
    pub title: String,
    /// The command that makes these figures.
    pub command: String,
    /// What it ran on ([`machine`]).
    pub machine: String,
    /// Measures, in the order of columns and panels.
    pub metrics: Vec<Metric>,
    /// Runs, in the order of the table. Rows of a group need not be neighbours.
    pub rows: Vec<Row>,
}

/// The longest run of a sweep over the shortest from which on time is drawn on a logarithmic axis.
const LOG_FROM: f64 = 6.0;

impl Sweep {
    /// Whether there is something to show.
    ///
    /// # Errors
    /// [`PipelineError::Input`] without rows, without metrics, with two metrics of one key, with a value under a key that
    /// no metric has, with negative seconds, or when no row has both finite seconds and a finite measure.
    pub fn check(&self) -> Result<(), PipelineError> {
        let fault = |expected: &str, got: String| Err(PipelineError::input(&self.title, expected, got));
        if self.rows.is_empty() {
            return fault("at least one run", "none".to_owned());
        }
        if self.metrics.is_empty() {
            return fault("at least one metric", "none".to_owned());
        }
        for (i, metric) in self.metrics.iter().enumerate() {
            if self.metrics[..i].iter().any(|m| m.key == metric.key) {
                return fault("metrics with different keys", format!("{} twice", metric.key));
            }
        }
        for row in &self.rows {
            if row.seconds < 0.0 {
                return fault("seconds of at least zero", format!("{} for {}", row.seconds, name(row)));
            }
            if let Some(key) = row.values.keys().find(|k| self.metrics.iter().all(|m| m.key != **k)) {
                return fault("values of the metrics only", format!("“{key}” in {}", name(row)));
            }
        }
        let shows =
            |row: &Row| row.seconds.is_finite() && self.metrics.iter().any(|m| row.value(m).is_finite());
        if !self.rows.iter().any(shows) {
            return fault(
                "a run with finite seconds and a finite measure",
                format!("{} without", self.rows.len()),
            );
        }
        Ok(())
    }

    /// Groups in order of appearance, each with its rows in order.
    fn groups(&self) -> Vec<(&str, Vec<&Row>)> {
        let mut groups: Vec<(&str, Vec<&Row>)> = Vec::new();
        for row in &self.rows {
            match groups.iter_mut().find(|(name, _)| *name == row.group) {
                Some((_, rows)) => rows.push(row),
                None => groups.push((&row.group, vec![row])),
            }
        }
        groups
    }

    /// Comma-separated values (RFC 4180, UTF-8, LF) with full precision: `group,label,default,seconds` and the metrics'
    /// keys; `default` is `true` or `false`, a value that is not finite is empty.
    ///
    /// # Errors
    /// Those of [`Sweep::check`].
    pub fn to_csv(&self) -> Result<String, PipelineError> {
        self.check()?;
        let keys = self.metrics.iter().map(|m| m.key.as_str());
        let header: Vec<String> =
            ["group", "label", "default", "seconds"].into_iter().chain(keys).map(csv).collect();
        let mut text = header.join(",") + "\n";
        let plain = |v: f64| if v.is_finite() { v.to_string() } else { String::new() };
        for row in &self.rows {
            let mut cells =
                vec![csv(&row.group), csv(&row.label), row.is_default.to_string(), plain(row.seconds)];
            cells.extend(self.metrics.iter().map(|m| plain(row.value(m))));
            text.push_str(&(cells.join(",") + "\n"));
        }
        Ok(text)
    }

    /// A heading, a table grouped by knob with the default values in bold, the command and the machine. An arrow at a
    /// column says which way is good.
    ///
    /// # Errors
    /// Those of [`Sweep::check`].
    pub fn to_markdown(&self) -> Result<String, PipelineError> {
        self.check()?;
        let mut text = format!("## {}\n\n| knob | value | seconds ↓ |", cell(&self.title));
        for metric in &self.metrics {
            let arrow = if metric.better == Better::Up { '↑' } else { '↓' };
            text.push_str(&format!(" {} {arrow} |", cell(&metric.title())));
        }
        text.push_str(&format!("\n|---|---|{}\n", "---:|".repeat(1 + self.metrics.len())));
        for (group, rows) in self.groups() {
            for (i, row) in rows.into_iter().enumerate() {
                let knob = if i == 0 { cell(group) } else { String::new() };
                let label = cell(&row.label);
                let label = if row.is_default { format!("**{label}** (default)") } else { label };
                text.push_str(&format!("| {knob} | {label} | {} |", seconds(row.seconds)));
                for metric in &self.metrics {
                    text.push_str(&format!(" {} |", finite(row.value(metric), metric.digits)));
                }
                text.push('\n');
            }
        }
        text.push_str(&format!("\nCommand: {}\n\nMachine: {}.\n", code(&self.command), self.machine));
        Ok(text)
    }

    /// One panel a metric over seconds, one series a knob; time is logarithmic where it spans a factor of six or more.
    ///
    /// # Errors
    /// Those of [`Sweep::check`].
    pub fn to_chart(&self) -> Result<Chart, PipelineError> {
        self.check()?;
        let times = || self.rows.iter().map(|r| r.seconds).filter(|s| s.is_finite());
        let (shortest, longest) = (times().fold(f64::INFINITY, f64::min), times().fold(0.0, f64::max));
        let x_scale =
            if shortest > 0.0 && longest >= LOG_FROM * shortest { Scale::Log } else { Scale::Linear };
        let series_of = |metric: &Metric| -> Vec<Series> {
            let point = |row: &Row| Point {
                x: row.seconds,
                y: row.value(metric),
                label: row.label.clone(),
                is_default: row.is_default,
            };
            let series = |(group, rows): (&str, Vec<&Row>)| Series {
                name: group.to_owned(),
                points: rows.into_iter().map(point).collect(),
            };
            self.groups().into_iter().map(series).collect()
        };
        let panel = |metric: &Metric| Panel {
            y_title: metric.title(),
            better: metric.better,
            joined: true,
            series: series_of(metric),
        };
        Ok(Chart {
            title: self.title.clone(),
            caption: vec![format!("Command: {}", self.command), format!("Machine: {}.", self.machine)],
            x_title: "time (s)".to_owned(),
            x_scale,
            panels: self.metrics.iter().map(panel).collect(),
        })
    }

    /// Writes `<stem>.csv`, `<stem>.md` (the table, then the SVG as a picture), `<stem>.svg` and `<stem>.png` into
    /// `folder`, which is created; returns their paths in this order. All four are made before the first is written and
    /// all are written before the first old one is replaced.
    ///
    /// # Errors
    /// Those of [`Sweep::check`]; [`PipelineError::Internal`] when the plot cannot be drawn; [`PipelineError::Io`] when
    /// a file cannot be written.
    pub fn write(&self, folder: &Path, stem: &str) -> Result<[PathBuf; 4], PipelineError> {
        let chart = self.to_chart()?;
        let picture = format!("\n![{}](<{stem}.svg>)\n", cell(&self.title));
        let files = [
            ("csv", self.to_csv()?.into_bytes()),
            ("md", (self.to_markdown()? + &picture).into_bytes()),
            ("svg", chart.to_svg().into_bytes()),
            ("png", chart.to_png(PNG_SCALE)?),
        ];
        let paths = files.each_ref().map(|(extension, _)| folder.join(format!("{stem}.{extension}")));
        let mut staged = Vec::new();
        for (path, (_, bytes)) in paths.iter().zip(&files) {
            let file = comgs_image::atomic::stage_file(path, |w| w.write_all(bytes));
            staged.push((path, file.map_err(|e| PipelineError::io(path, e))?));
        }
        for (path, file) in staged {
            file.commit().map_err(|e| PipelineError::io(path, e))?;
        }
        Ok(paths)
    }
}

/// Seconds that all threads of this program have spent on a processor so far, where the system tells (Linux): on a machine that
/// others use too, differences of it are steadier than the clock.
#[must_use]
pub fn cpu_seconds() -> Option<f64> {
    let threads = std::fs::read_dir("/proc/self/task").ok()?;
    let of = |entry: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(entry.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    };
    // A thread may end while the list is read.
    let nanoseconds: Vec<f64> = threads.flatten().filter_map(of).collect();
    (!nanoseconds.is_empty()).then(|| nanoseconds.iter().sum::<f64>() * 1e-9)
}

/// What a run was timed on: the processor's name, how many of its cores the program uses, and that others may have used
/// them too. Never the name of the machine.
#[must_use]
pub fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    describe_machine(&info, rayon::current_num_threads(), cores)
}

/// [`machine`] from the text of `/proc/cpuinfo` (empty where there is none) and the numbers of threads and cores.
#[must_use]
pub fn describe_machine(cpuinfo: &str, threads: usize, cores: usize) -> String {
    let field = |line: &str, key: &str| {
        let (name, value) = line.split_once(':')?;
        let value = value.split_whitespace().collect::<Vec<_>>().join(" ");
        (name.trim() == key && !value.is_empty()).then_some(value)
    };
    let model = cpuinfo.lines().find_map(|line| field(line, "model name"));
    let model = model.unwrap_or_else(|| format!("{} processor", std::env::consts::ARCH));
    let s = if threads == 1 { "" } else { "s" };
    format!("{model}, {threads} thread{s} on {cores} logical cores, which other programs may share")
}

fn name(row: &Row) -> String {
    format!("{} {}", row.group, row.label)
}

/// Three significant digits, down to milliseconds.
fn seconds(value: f64) -> String {
    let digits = match value {
        v if v < 0.9995 => 3,
        v if v < 9.995 => 2,
        v if v < 99.95 => 1,
        _ => 0,
    };
    finite(value, digits)
}

fn finite(value: f64, digits: usize) -> String {
    if value.is_finite() { number(value, digits) } else { "–".to_owned() }
}

/// A field of a CSV record.
fn csv(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// Text within a table's cell or a heading: one line, no markup of its own.
fn cell(text: &str) -> String {
    let mut out = String::new();
    for c in text.split_whitespace().collect::<Vec<_>>().join(" ").chars() {
        if matches!(c, '|' | '*' | '_' | '`' | '<' | '>' | '[' | ']' | '\\') {
            out.push('\\');
        }
        out.push(c);
    }
    out
}

/// An inline code span (CommonMark §6.1): fenced by more backticks than it has in a row.
fn code(text: &str) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let longest = text.split(|c| c != '`').map(str::len).max().unwrap_or(0);
    let fence = "`".repeat(longest + 1);
    if longest == 0 { format!("{fence}{text}{fence}") } else { format!("{fence} {text} {fence}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the processor's seconds grow with work and not with sleep.
    #[test]
    fn processor_seconds_count_work_alone() {
        let Some(before) = cpu_seconds() else { return };
        let start = std::time::Instant::now();
        let mut x = 1.0f64;
        while start.elapsed().as_millis() < 60 {
            x = std::hint::black_box(x * 1.000_001 + 1e-9);
        }
        let worked = cpu_seconds().unwrap() - before;
        // Beside other programs less than the clock, but never nothing.
        assert!(worked > 1e-3, "{worked} {x}");
    }
}
