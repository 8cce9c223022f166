//! Text as pixels: widths for the layout, and the picture itself.
//!
//! The font is DejaVu Sans (Bitstream Vera licence: free to embed and pass on; the crate `dejavu` ships it as bytes), so
//! that a machine without fonts draws the same picture. It is the widest of the families the SVG names: a viewer
//! without it falls back to text that is no longer than what the layout made room for.

use crate::PipelineError;
use resvg::usvg::fontdb;
use resvg::{tiny_skia, usvg};
use skrifa::instance::{LocationRef, Size};
use skrifa::{FontRef, MetadataProvider};
use std::sync::Arc;

fn bytes(bold: bool) -> &'static [u8] {
    if bold { dejavu::sans::bold() } else { dejavu::sans::regular() }
}

/// Width in pixels of a line of text at a font size of `size` pixels, without kerning. A character the font does not
/// have counts as one `size`.
pub(super) fn width(text: &str, size: f64, bold: bool) -> f64 {
    let Ok(font) = FontRef::new(bytes(bold)) else { return text.chars().count() as f64 * size };
    let metrics = font.glyph_metrics(Size::new(size as f32), LocationRef::default());
    let charmap = font.charmap();
    let advance =
        |c: char| charmap.map(c).and_then(|glyph| metrics.advance_width(glyph)).map_or(size, f64::from);
    text.chars().map(advance).sum()
}

/// Breaks text into lines of at most `most` pixels, at spaces where there are any.
pub(super) fn wrap(text: &str, size: f64, most: f64) -> Vec<String> {
    let fits = |line: &str| width(line, size, false) <= most;
    let mut lines: Vec<String> = Vec::new();
    let mut line = String::new();
    for word in text.split_whitespace() {
        let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
        if fits(&longer) {
            line = longer;
            continue;
        }
        if !line.is_empty() {
            lines.push(std::mem::take(&mut line));
        }
        for c in word.chars() {
            line.push(c);
            if !fits(&line) && line.chars().count() > 1 {
                line.pop();
                lines.push(std::mem::replace(&mut line, c.to_string()));
            }
        }
    }
    if !line.is_empty() {
        lines.push(line);
    }
    lines
}

/// Draws an SVG, `scale` pixels for each of its units, as an opaque 8-bit RGB PNG.
pub(super) fn rasterise(svg: &str, scale: f64) -> Result<Vec<u8>, PipelineError> {
    let fault = |what: String| PipelineError::Internal(format!("a plot cannot be drawn: {what}"));
    let mut fonts = fontdb::Database::new();
    for bold in [false, true] {
        fonts.load_font_source(fontdb::Source::Binary(Arc::new(bytes(bold))));
    }
    let options = usvg::Options { fontdb: Arc::new(fonts), ..usvg::Options::default() };
    let tree = usvg::Tree::from_str(svg, &options).map_err(|e| fault(e.to_string()))?;
    let size = |side: f32| (f64::from(side) * scale).round().max(1.0) as u32;
    let (width, height) = (size(tree.size().width()), size(tree.size().height()));
    let mut pixels = tiny_skia::Pixmap::new(width, height)
        .ok_or_else(|| fault(format!("{width}×{height} pixels are too many")))?;
    let transform = tiny_skia::Transform::from_scale(scale as f32, scale as f32);
    resvg::render(&tree, transform, &mut pixels.as_mut());
    let rgb: Vec<u8> = pixels.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new_with_quality(
        &mut png,
        image::codecs::png::CompressionType::Best,
        image::codecs::png::FilterType::NoFilter,
    );
    image::ImageEncoder::write_image(encoder, &rgb, width, height, image::ExtendedColorType::Rgb8)
        .map_err(|e| fault(e.to_string()))?;
    Ok(png)
}
