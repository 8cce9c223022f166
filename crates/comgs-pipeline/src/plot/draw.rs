//! The page: title, legend, panels, caption.

use super::font::{width, wrap};
use super::panel::{BODY, MARK, RING, SMALL, draw_panel, front_stroke, look, ring, thin};
use super::place::Rect;
use super::style::{GRID, GROUND, INK, SOFT, Style};
use super::svg::{Anchor, Svg, Text};
use super::{Chart, Panel, WIDTH};

const MARGIN: f64 = 24.0;
const GUTTER: f64 = 32.0;
const TITLE: f64 = 19.0;
/// Panels with more points than this take the whole width: their labels would not find room in half of it.
const MOST_IN_HALF: usize = 9;
/// Heights of panels: the only one, one of several of full width, one of two in a row.
const HEIGHT_ALONE: f64 = 470.0;
const HEIGHT_WIDE: f64 = 370.0;
const HEIGHT_HALF: f64 = 320.0;

/// The whole picture. What cannot be drawn is named in the caption.
pub(super) fn draw(chart: &Chart) -> String {
    let names = chart.series_names();
    let halves = chart.panels.len() > 1 && chart.panels.iter().all(|p| p.points().count() <= MOST_IN_HALF);
    let (columns, height) = match (halves, chart.panels.len()) {
        (true, _) => (2, HEIGHT_HALF),
        (false, 1) => (1, HEIGHT_ALONE),
        (false, _) => (1, HEIGHT_WIDE),
    };
    let inner = WIDTH - 2.0 * MARGIN;

    let mut svg = Svg::default();
    let mut y = MARGIN - 5.0;
    // Lines are broken by the width of regular text; bold is up to an eighth wider.
    for line in wrap(&chart.title, TITLE * 1.125, inner) {
        y += TITLE + 5.0;
        svg.text((MARGIN, y), &line, Text { bold: true, ..look(TITLE, INK, Anchor::Start) });
    }
    y = legend(&mut svg, chart, &names, y + 12.0);

    let mut notes = chart.caption.clone();
    for panels in chart.panels.chunks(columns) {
        y += 18.0;
        let count = panels.len() as f64;
        let span = (inner - GUTTER * (count - 1.0)) / count;
        for (i, panel) in panels.iter().enumerate() {
            let full = Rect { x: MARGIN + i as f64 * (span + GUTTER), y, w: span, h: height };
            notes.extend(draw_panel(&mut svg, chart.x(), panel, &names, full));
        }
        y += height;
    }

    y += 14.0;
    svg.line((MARGIN, y), (WIDTH - MARGIN, y), thin(GRID));
    y += 6.0;
    for line in notes.iter().flat_map(|note| wrap(note, SMALL, inner)) {
        y += SMALL + 4.5;
        svg.text((MARGIN, y), &line, look(SMALL, SOFT, Anchor::Start));
    }
    svg.page(WIDTH, y + MARGIN - 4.0, &chart.title, &chart.caption.join(" "), GROUND)
}

/// A series' name with the label of its default point, where there are others.
fn entry(chart: &Chart, name: &str) -> String {
    let all = || chart.panels.iter().flat_map(|p| &p.series).filter(|s| s.name == name);
    let default = all().filter(|s| s.points.len() > 1).flat_map(|s| &s.points).find(|p| p.is_default);
    default.map_or_else(|| name.to_owned(), |p| format!("{name} (default {})", p.label))
}

/// Names of the series, of the front and of the ring, in as many lines as they need. Returns the lower end.
fn legend(svg: &mut Svg, chart: &Chart, names: &[&str], top: f64) -> f64 {
    const LINE: f64 = 21.0;
    const SAMPLE: f64 = 24.0;
    const GAP: f64 = 22.0;
    const FRONT: &str = "front: nothing is better in less time";
    let has_default = chart.panels.iter().flat_map(Panel::points).any(|p| p.is_default);
    let mut entries: Vec<String> = names.iter().map(|name| entry(chart, name)).collect();
    entries.push(FRONT.to_owned());
    entries.extend(has_default.then(|| "default".to_owned()));
    let (mut x, mut y) = (MARGIN, top + 0.5 * LINE);
    for (i, name) in entries.into_iter().enumerate() {
        let length = SAMPLE + width(&name, BODY, false);
        if x > MARGIN && x + length > WIDTH - MARGIN {
            (x, y) = (MARGIN, y + LINE);
        }
        match i.checked_sub(names.len()) {
            None => Style::of(i).mark(svg, (x + 8.0, y), MARK),
            Some(0) => {
                let steps = [(0.0, 6.0), (0.0, 2.0), (9.0, 2.0), (9.0, -4.0), (18.0, -4.0)];
                svg.path(&steps.map(|(dx, dy)| (x + dx, y + dy)), false, "none", Some(front_stroke()));
            }
            Some(_) => ring(svg, (x + 8.0, y), RING - 1.5),
        }
        svg.text((x + SAMPLE, y + 4.5), &name, look(BODY, INK, Anchor::Start));
        x += length + GAP;
    }
    y + 0.5 * LINE
}
