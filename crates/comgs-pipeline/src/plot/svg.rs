//! A small writer of SVG: the few elements a plot needs, every attribute a number or escaped text.

use std::fmt::Write;

/// Families in order: the one that measures and rasterises text here, then others at most as wide, then any.
const FAMILIES: &str = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif";

/// A point in pixels from the upper left corner.
pub(super) type P = (f64, f64);

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// How a text looks.
#[derive(Clone, Copy)]
pub(super) struct Text<'a> {
    pub size: f64,
    pub bold: bool,
    pub anchor: Anchor,
    pub fill: &'a str,
    /// A rim in the colour of the ground, so that a line behind the text does not cross it.
    pub halo: Option<&'a str>,
}

/// A line's looks.
#[derive(Clone, Copy)]
pub(super) struct Stroke<'a> {
    pub color: &'a str,
    pub width: f64,
    pub opacity: f64,
    pub dash: Option<&'a str>,
}

/// Text that cannot be taken for markup; characters that XML 1.0 cannot hold become U+FFFD.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\t' | '\n' | '\r' => out.push(' '),
            c if c < ' ' || ('\u{7f}'..='\u{9f}').contains(&c) || matches!(c, '\u{fffe}' | '\u{ffff}') => {
                out.push('\u{fffd}');
            }
            c => out.push(c),
        }
    }
    out
}

/// Two decimals at most, without trailing zeros, never `-0`.
pub(super) fn n(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Elements in the order they are drawn.
#[derive(Default)]
pub(super) struct Svg {
    out: String,
}

impl Svg {
    /// The elements on a page of one colour, whole.
    pub fn page(self, width: f64, height: f64, title: &str, description: &str, ground: &str) -> String {
        let (w, h) = (n(width), n(height));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             role=\"img\" font-family=\"{FAMILIES}\">\n<title>{}</title>\n<desc>{}</desc>\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"{ground}\"/>\n{}</svg>\n",
            escape(title),
            escape(description),
            self.out
        )
    }

    pub fn line(&mut self, from: P, to: P, stroke: Stroke) {
        self.path(&[from, to], false, "none", Some(stroke));
    }

    /// A polyline, or a polygon when `closed`.
    pub fn path(&mut self, points: &[P], closed: bool, fill: &str, stroke: Option<Stroke>) {
        let mut d = String::new();
        for (i, p) in points.iter().enumerate() {
            let _ = write!(d, "{}{} {}", if i == 0 { "M" } else { "L" }, n(p.0), n(p.1));
        }
        if closed {
            d.push('Z');
        }
        let _ = writeln!(self.out, "<path d=\"{d}\" fill=\"{fill}\"{}/>", stroke_attributes(stroke));
    }

    pub fn circle(&mut self, at: P, radius: f64, fill: &str, stroke: Option<Stroke>) {
        let _ = writeln!(
            self.out,
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" fill=\"{fill}\"{}/>",
            n(at.0),
            n(at.1),
            n(radius),
            stroke_attributes(stroke)
        );
    }

    /// Text with its baseline at `at`.
    pub fn text(&mut self, at: P, content: &str, look: Text) {
        let mut extra = String::new();
        if look.bold {
            extra.push_str(" font-weight=\"bold\"");
        }
        match look.anchor {
            Anchor::Start => {}
            Anchor::Middle => extra.push_str(" text-anchor=\"middle\""),
            Anchor::End => extra.push_str(" text-anchor=\"end\""),
        }
        if let Some(halo) = look.halo {
            let _ = write!(
                extra,
                " paint-order=\"stroke\" stroke=\"{halo}\" stroke-width=\"3\" stroke-linejoin=\"round\""
            );
        }
        let _ = writeln!(
            self.out,
            "<text x=\"{}\" y=\"{}\" font-size=\"{}\" fill=\"{}\"{extra}>{}</text>",
            n(at.0),
            n(at.1),
            n(look.size),
            look.fill,
            escape(content)
        );
    }
}

fn stroke_attributes(stroke: Option<Stroke>) -> String {
    let Some(stroke) = stroke else { return String::new() };
    let mut text = format!(
        " stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"",
        stroke.color,
        n(stroke.width)
    );
    if stroke.opacity < 1.0 {
        let _ = write!(text, " stroke-opacity=\"{}\"", n(stroke.opacity));
    }
    if let Some(dash) = stroke.dash {
        let _ = write!(text, " stroke-dasharray=\"{dash}\"");
    }
    text
}
