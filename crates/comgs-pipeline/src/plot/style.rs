//! Colours and markers.

use super::svg::{P, Stroke, Svg};

pub(super) const GROUND: &str = "#ffffff";
pub(super) const INK: &str = "#1c1c1e";
pub(super) const SOFT: &str = "#5f5f66";
pub(super) const GRID: &str = "#e6e6e3";
pub(super) const FRAME: &str = "#a9a9a6";
pub(super) const FRONT: &str = "#1c1c1e";
pub(super) const WORTH: &str = "#f4f4f1";

/// Colours of marks and, darker, of their labels. The marks are those of Okabe and Ito (*Color Universal Design*, 2002),
/// which the common forms of colour blindness tell apart, without yellow (too pale on white) and black (the front); the
/// labels reach a contrast of 4.5:1 on white (WCAG 2.1, 1.4.3).
const COLORS: [(&str, &str); 6] = [
    ("#0072b2", "#005e93"),
    ("#d55e00", "#a84a00"),
    ("#009e73", "#00694d"),
    ("#cc79a7", "#8f3f6b"),
    ("#e69f00", "#835a00"),
    ("#56b4e9", "#1d6a97"),
];

#[derive(Clone, Copy)]
enum Marker {
    Circle,
    Square,
    Triangle,
    Diamond,
    Inverted,
    Cross,
    Pentagon,
}

/// Seven markers and six colours: 42 series before a pair comes again, and neighbours differ in both.
const MARKERS: [Marker; 7] = [
    Marker::Circle,
    Marker::Square,
    Marker::Triangle,
    Marker::Diamond,
    Marker::Inverted,
    Marker::Cross,
    Marker::Pentagon,
];

/// Looks of a series, by its place in the legend.
#[derive(Clone, Copy)]
pub(super) struct Style {
    pub color: &'static str,
    pub text: &'static str,
    marker: Marker,
}

impl Style {
    pub fn of(index: usize) -> Self {
        let (color, text) = COLORS[index % COLORS.len()];
        Self { color, text, marker: MARKERS[index % MARKERS.len()] }
    }

    /// Draws the marker; its parts stay within `radius` of `at`, by area alike.
    pub fn mark(self, svg: &mut Svg, at: P, radius: f64) {
        let rim = Some(Stroke { color: GROUND, width: 1.0, opacity: 1.0, dash: None });
        let polygon = |count: usize, turn: f64, r: f64| -> Vec<P> {
            (0..count)
                .map(|i| {
                    let angle = std::f64::consts::TAU * (i as f64 / count as f64 + turn);
                    (at.0 + r * angle.sin(), at.1 - r * angle.cos())
                })
                .collect()
        };
        match self.marker {
            Marker::Circle => svg.circle(at, 0.85 * radius, self.color, rim),
            Marker::Square => svg.path(&polygon(4, 0.125, 1.05 * radius), true, self.color, rim),
            Marker::Triangle => svg.path(&polygon(3, 0.0, 1.1 * radius), true, self.color, rim),
            Marker::Diamond => svg.path(&polygon(4, 0.0, 1.05 * radius), true, self.color, rim),
            Marker::Inverted => svg.path(&polygon(3, 0.5, 1.1 * radius), true, self.color, rim),
            Marker::Pentagon => svg.path(&polygon(5, 0.0, 0.95 * radius), true, self.color, rim),
            Marker::Cross => {
                let (arm, half) = (0.95 * radius, 0.32 * radius);
                let corners = [
                    (-half, -arm),
                    (half, -arm),
                    (half, -half),
                    (arm, -half),
                    (arm, half),
                    (half, half),
                    (half, arm),
                    (-half, arm),
                    (-half, half),
                    (-arm, half),
                    (-arm, -half),
                    (-half, -half),
                ];
                svg.path(&corners.map(|(x, y)| (at.0 + x, at.1 + y)), true, self.color, rim);
            }
        }
    }
}
