//! One panel, from its ground to its labels.

use super::axis::{Axis, Scale};
use super::font::width;
use super::place::{Placed, Rect, Wanted, place};
use super::style::{FRAME, FRONT, GRID, GROUND, INK, SOFT, Style, WORTH};
use super::svg::{Anchor, P, Stroke, Svg, Text};
use super::{Better, Panel, pareto_front};

pub(super) const BODY: f64 = 12.5;
pub(super) const SMALL: f64 = 11.5;
pub(super) const MARK: f64 = 5.5;
pub(super) const RING: f64 = 9.0;
const HEADING: f64 = 13.0;
const TICK: f64 = 12.0;
const LABEL: f64 = 12.0;
/// Above the plot: the heading. Below: tick labels and the name of the axis.
const ABOVE: f64 = 30.0;
const BELOW: f64 = 46.0;
/// Room for tick labels of five characters, so that panels one above the other start at the same place.
const LEAST_MARGIN: f64 = 36.0;

pub(super) fn thin(color: &str) -> Stroke<'_> {
    Stroke { color, width: 1.0, opacity: 1.0, dash: None }
}

pub(super) fn look(size: f64, fill: &str, anchor: Anchor) -> Text<'_> {
    Text { size, bold: false, anchor, fill, halo: None }
}

pub(super) fn front_stroke() -> Stroke<'static> {
    Stroke { color: FRONT, width: 1.6, opacity: 1.0, dash: None }
}

pub(super) fn ring(svg: &mut Svg, at: P, radius: f64) {
    svg.circle(at, radius, "none", Some(Stroke { color: INK, width: 1.4, opacity: 1.0, dash: None }));
}

/// A point with all that drawing it needs.
struct Spot<'a> {
    value: (f64, f64),
    at: P,
    /// Place of the series in the legend.
    series: usize,
    label: &'a str,
    is_default: bool,
}

/// Where values are, and the front as steps.
struct Ground {
    plot: Rect,
    x: Axis,
    y: Axis,
    /// Indices of the spots on the front.
    front: Vec<usize>,
    /// Corners of the steps.
    steps: Vec<P>,
}

/// Draws one panel into `full` and returns what had to be left out, in words.
pub(super) fn draw_panel(
    svg: &mut Svg,
    (x_title, x_scale): (&str, Scale),
    panel: &Panel,
    names: &[&str],
    full: Rect,
) -> Vec<String> {
    heading(svg, panel, full);
    let mut notes = Vec::new();
    let mut missing = Vec::new();
    let mut spots: Vec<Spot> = Vec::new();
    for series in &panel.series {
        let index = names.iter().position(|n| *n == series.name).unwrap_or(0);
        for p in &series.points {
            if x_scale.shows(p.x) && p.y.is_finite() {
                let (value, label) = ((p.x, p.y), p.label.as_str());
                spots.push(Spot { value, at: (0.0, 0.0), series: index, label, is_default: p.is_default });
            } else {
                missing.push(format!("{} {}", series.name, p.label));
            }
        }
    }
    if !missing.is_empty() {
        notes.push(format!("Not drawn in “{}”, no usable value: {}.", panel.y_title, missing.join(", ")));
    }
    if spots.is_empty() {
        let middle = (full.x + 0.5 * full.w, full.y + 0.5 * full.h);
        svg.text(middle, "no values to draw", look(BODY, SOFT, Anchor::Middle));
        return notes;
    }

    let ground = draw_ground(svg, (x_title, x_scale), panel.better, &spots, full);
    for spot in &mut spots {
        spot.at = (ground.x.pixel(spot.value.0), ground.y.pixel(spot.value.1));
    }
    let segments = draw_lines(svg, panel, &spots, &ground);
    for spot in spots.iter().filter(|s| s.is_default) {
        ring(svg, spot.at, RING);
    }
    for (i, spot) in spots.iter().enumerate() {
        if has_twin(&spots, i) {
            svg.circle(spot.at, 0.8 * MARK, INK, None);
        } else {
            Style::of(spot.series).mark(svg, spot.at, MARK);
        }
    }
    let unplaced = draw_labels(svg, &spots, &segments, &ground);
    if !unplaced.is_empty() {
        let (names, panel) = (unplaced.join(", "), &panel.y_title);
        notes.push(format!("No room for the labels of {names} in “{panel}”."));
    }
    notes
}

fn heading(svg: &mut Svg, panel: &Panel, full: Rect) {
    let hint = match panel.better {
        Better::Up => "↑ higher is better",
        Better::Down => "↓ lower is better",
    };
    let (title, y) = (&panel.y_title, full.y + 14.0);
    svg.text((full.x, y), title, Text { bold: true, ..look(HEADING, INK, Anchor::Start) });
    let x = full.x + width(title, HEADING, true) + 12.0;
    svg.text((x, y), hint, look(SMALL, SOFT, Anchor::Start));
}

/// Ground, grid, ticks and the name of the time axis.
fn draw_ground(
    svg: &mut Svg,
    (x_title, x_scale): (&str, Scale),
    better: Better,
    spots: &[Spot],
    full: Rect,
) -> Ground {
    let values: Vec<(f64, f64)> = spots.iter().map(|s| s.value).collect();
    let (xs, ys): (Vec<f64>, Vec<f64>) = values.iter().copied().unzip();
    let (mut x, mut y) =
        (Axis::around(&xs, x_scale, 0.07, true), Axis::around(&ys, Scale::Linear, 0.12, false));
    let (top, bottom) = (full.y + ABOVE, full.y + full.h - BELOW);
    let y_ticks = y.ticks(((bottom - top) / 42.0) as usize);
    let margin = y_ticks.labels.iter().map(|l| width(l, TICK, false)).fold(LEAST_MARGIN, f64::max) + 9.0;
    let plot = Rect { x: full.x + margin, y: top, w: full.w - margin, h: bottom - top };
    let right = plot.x + plot.w;
    x.pixels = (plot.x, right);
    y.pixels = (bottom, top);
    let x_ticks = x.ticks((plot.w / 62.0) as usize);

    let worst = if better == Better::Up { bottom } else { top };
    let front = pareto_front(&values, better);
    let mut steps: Vec<P> = Vec::new();
    for &index in &front {
        let at = (x.pixel(values[index].0), y.pixel(values[index].1));
        steps.extend([(at.0, steps.last().map_or(worst, |p| p.1)), at]);
    }
    steps.extend(steps.last().copied().map(|last| (right, last.1)));

    // What some setting is at least as good and as fast as.
    let mut area = steps.clone();
    area.push((right, worst));
    svg.path(&area, true, WORTH, None);
    for (value, label) in y_ticks.values.iter().zip(&y_ticks.labels) {
        let at = y.pixel(*value);
        svg.line((plot.x, at), (right, at), thin(GRID));
        svg.text((plot.x - 7.0, at + 4.2), label, look(TICK, SOFT, Anchor::End));
    }
    for (value, label) in x_ticks.values.iter().zip(&x_ticks.labels) {
        let at = x.pixel(*value);
        svg.line((at, top), (at, bottom), thin(GRID));
        svg.line((at, bottom), (at, bottom + 4.0), thin(FRAME));
        svg.text((at, bottom + 17.0), label, look(TICK, SOFT, Anchor::Middle));
    }
    svg.path(&[(plot.x, top), (plot.x, bottom), (right, bottom)], false, "none", Some(thin(FRAME)));
    let name = match x_scale {
        Scale::Linear => x_title.to_owned(),
        Scale::Log => format!("{x_title}, logarithmic"),
    };
    svg.text((plot.x + 0.5 * plot.w, bottom + 36.0), &name, look(TICK, INK, Anchor::Middle));
    Ground { plot, x, y, front, steps }
}

/// The series' lines and the front; returns all their segments.
fn draw_lines(svg: &mut Svg, panel: &Panel, spots: &[Spot], ground: &Ground) -> Vec<(P, P)> {
    let segments_of = |path: &[P]| path.windows(2).map(|w| (w[0], w[1])).collect::<Vec<_>>();
    svg.path(&ground.steps, false, "none", Some(front_stroke()));
    let mut segments = segments_of(&ground.steps);
    for group in spots.chunk_by(|a, b| a.series == b.series) {
        let path: Vec<P> = group.iter().map(|s| s.at).collect();
        if path.len() > 1 && panel.joined {
            let color = Style::of(group[0].series).color;
            svg.path(&path, false, "none", Some(Stroke { color, width: 1.5, opacity: 0.75, dash: None }));
            segments.extend(segments_of(&path));
        }
    }
    segments
}

fn near(a: P, b: P) -> bool {
    (a.0 - b.0).hypot(a.1 - b.1) <= RING
}

/// Whether a default point lies on another: they are drawn as one, of no series, and share a label.
fn has_twin(spots: &[Spot], index: usize) -> bool {
    let spot = &spots[index];
    let twin = |(i, other): (usize, &Spot)| i != index && other.is_default && near(spot.at, other.at);
    spot.is_default && spots.iter().enumerate().any(twin)
}

/// Labels: defaults first, then the front, then the rest. Defaults that lie on one another share the label “default”.
/// Returns the labels that found no place.
fn draw_labels(svg: &mut Svg, spots: &[Spot], segments: &[(P, P)], ground: &Ground) -> Vec<String> {
    let mut named: Vec<(usize, &str)> = Vec::new();
    let mut shared: Vec<usize> = Vec::new();
    for (i, spot) in spots.iter().enumerate().filter(|(_, s)| s.is_default) {
        if !has_twin(spots, i) {
            named.push((i, spot.label));
        } else if !shared.iter().any(|&j| near(spots[j].at, spot.at)) {
            shared.push(i);
            named.push((i, "default"));
        }
    }
    let (on, off): (Vec<usize>, Vec<usize>) =
        (0..spots.len()).filter(|&i| !spots[i].is_default).partition(|i| ground.front.contains(i));
    named.extend(on.into_iter().chain(off).map(|i| (i, spots[i].label)));

    let radius = |spot: &Spot| if spot.is_default { RING } else { MARK };
    let wanted: Vec<Wanted> = named
        .iter()
        .map(|&(i, label)| {
            let (spot, bold) = (&spots[i], spots[i].is_default);
            Wanted { at: spot.at, radius: radius(spot), size: (width(label, LABEL, bold) + 4.0, LABEL + 1.0) }
        })
        .collect();
    let markers: Vec<Rect> = spots.iter().map(|s| Rect::around(s.at, radius(s), radius(s))).collect();
    let mut unplaced = Vec::new();
    for ((i, label), placed) in named.iter().zip(place(&wanted, &markers, segments, ground.plot)) {
        let spot = &spots[*i];
        let Some(Placed { rect, leader }) = placed else {
            unplaced.push((*label).to_owned());
            continue;
        };
        if let Some((from, to)) = leader {
            svg.line(from, to, Stroke { color: SOFT, width: 0.8, opacity: 0.8, dash: None });
        }
        let fill = if spot.is_default && *label == "default" { INK } else { Style::of(spot.series).text };
        let at = (rect.x + 0.5 * rect.w, rect.y + rect.h - 2.3);
        let look = Text { bold: spot.is_default, halo: Some(GROUND), ..look(LABEL, fill, Anchor::Middle) };
        svg.text(at, label, look);
    }
    unplaced
}
