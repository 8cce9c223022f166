//! The contact sheet.

use comgs_image::Image;

/// Pictures of a sheet are reduced to this width.
const SHEET_WIDTH: usize = 192;

/// One row a map: photo, reference, methods.
pub(super) fn contact_sheet(strips: &[Vec<Image>]) -> Image {
    let columns = strips.first().map_or(0, Vec::len);
    let Some(first) = strips.first().and_then(|s| s.first()) else { return Image::zeros(1, 1, 3) };
    let (w, h) = (SHEET_WIDTH, first.height * SHEET_WIDTH / first.width);
    let mut out = Image::zeros(columns * w, strips.len() * h, 3);
    for (row, strip) in strips.iter().enumerate() {
        for (column, image) in strip.iter().enumerate() {
            let small = image.resized(w, h);
            for y in 0..h {
                for x in 0..w {
                    let value = small.rgb(x, y);
                    out.pixel_mut(column * w + x, row * h + y).copy_from_slice(&value);
                }
            }
        }
    }
    out
}
