//! Plots of accuracy against time: a [`Chart`] becomes SVG, and that SVG becomes PNG.
//!
//! A chart is a page of panels with one time axis in common. Every panel shows one measure of accuracy: points in
//! series (a series is one knob), the front of what is worth its time ([`pareto_front`]) as a step line, labels beside
//! the points (greedy, never on one another). Series keep colour and marker over all panels; the palette is that of
//! Okabe and Ito, the markers differ as well. The page is 900 units wide on white.
//!
//! The SVG is written here, without timestamps or randomness: equal charts are equal bytes. The PNG is that same SVG,
//! rendered by `resvg` with an embedded font, so that both are one picture on any machine.
//!
//! What `resvg` 0.49 (text only, no system fonts, no raster formats), `skrifa` (a part of it) and the font cost to build:
//! 40 CPU-seconds, once (`time cargo build --release -p resvg -p dejavu -p skrifa`, user + system, on an AMD EPYC with two
//! shared cores). At full optimisation it would be 85: five of its crates are compiled at level 0 (root `Cargo.toml`; 17
//! CPU-seconds for these instead of 62), which a plot does not notice. A chart of 900×1350 at [`PNG_SCALE`] takes half a
//! second to render.

mod axis;
mod draw;
mod font;
mod front;
mod panel;
mod place;
mod style;
mod svg;

pub use axis::{Scale, Ticks, number, ticks};
pub use front::pareto_front;

use crate::PipelineError;
use serde::{Deserialize, Serialize};

/// Width of a chart in SVG units (CSS pixels).
pub const WIDTH: f64 = 900.0;

/// Pixels of the PNG for each SVG unit: sharp on screens of double density, and when scaled down to a page.
pub const PNG_SCALE: f64 = 2.0;

/// Which end of a measure is the good one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// More is better (PSNR, SSIM).
    Up,
    /// Less is better (angles, errors, memory).
    Down,
}

impl Better {
    /// +1 or −1: `sign() · value` grows with quality.
    #[must_use]
    pub fn sign(self) -> f64 {
        match self {
            Self::Up => 1.0,
            Self::Down => -1.0,
        }
    }
}

/// One measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Seconds, or what else the chart's horizontal axis is.
    pub x: f64,
    /// The panel's measure.
    pub y: f64,
    /// Short text beside the point (`5k`, `16²`).
    pub label: String,
    /// Drawn with a ring. Default points that lie on one another share the label “default”.
    pub is_default: bool,
}

/// Points that belong together, in the order of the knob.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend; the same name is the same colour and marker in every panel.
    pub name: String,
    /// Points. One with a coordinate that is not finite, or not positive on a logarithmic axis, is left out and named
    /// in the caption.
    pub points: Vec<Point>,
}

/// One plot of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Name of the measure with its unit (`albedo PSNR (dB)`).
    pub y_title: String,
    /// Which way is good.
    pub better: Better,
    /// Whether the points of a series are joined by lines.
    pub joined: bool,
    /// Series.
    pub series: Vec<Series>,
}

impl Panel {
    fn points(&self) -> impl Iterator<Item = &Point> {
        self.series.iter().flat_map(|s| &s.points)
    }
}

/// A page of panels over one kind of time axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// Paragraphs under the panels: the command, the machine.
    pub caption: Vec<String>,
    /// Name of the horizontal axis with its unit (`time (s)`).
    pub x_title: String,
    /// Division of the horizontal axis.
    pub x_scale: Scale,
    /// Panels, from the top; two in a row where all have few points.
    pub panels: Vec<Panel>,
}

impl Chart {
    /// The picture as SVG 1.1, [`WIDTH`] units wide and as high as it needs. A panel without a drawable point says so.
    #[must_use]
    pub fn to_svg(&self) -> String {
        draw::draw(self)
    }

    /// The same picture as an opaque RGB PNG with `scale` pixels for each SVG unit ([`PNG_SCALE`] is a good choice).
    ///
    /// # Errors
    /// [`PipelineError::Internal`] when the picture cannot be rendered: more pixels than there is memory for.
    pub fn to_png(&self, scale: f64) -> Result<Vec<u8>, PipelineError> {
        font::rasterise(&self.to_svg(), scale)
    }

    /// Names of all series, each once, in order of appearance.
    fn series_names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for series in self.panels.iter().flat_map(|p| &p.series) {
            if !names.contains(&series.name.as_str()) {
                names.push(&series.name);
            }
        }
        names
    }

    fn x(&self) -> (&str, Scale) {
        (&self.x_title, self.x_scale)
    }
}
