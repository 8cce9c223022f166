//! The composite (DiPIR Eq. 6), from radiance and shadow ratios by row to an image, and its gradient.

use crate::tone::{CurveGradient, Curves};
use crate::transport::{Foreground, Shadow};
use comgs_image::Image;

/// A part of an image in pixels: `x0 ≤ x < x1`, `y0 ≤ y < y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Beyond the last column.
    pub x1: usize,
    /// Beyond the last row.
    pub y1: usize,
}

impl Crop {
    /// The whole of an image.
    #[must_use]
    pub fn whole(image: &Image) -> Self {
        Self { x0: 0, y0: 0, x1: image.width, y1: image.height }
    }

    /// Whether a pixel (row-major index into an image `width` wide) lies inside.
    #[must_use]
    pub fn contains(&self, pixel: usize, width: usize) -> bool {
        let (x, y) = (pixel % width, pixel / width);
        (self.x0..self.x1).contains(&x) && (self.y0..self.y1).contains(&y)
    }

    /// Pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        (self.x1 - self.x0) * (self.y1 - self.y0)
    }
}

/// `(1 − V) · β̂ · I_bg + V · Î_fg`, all linear; outside `crop` the photo.
///
/// * `photo`: I_bg, linear, three channels
/// * `radiance`: of the object by row of `foreground`, before tone
/// * `beta`: shadow ratios by row of `shadow`, before tone
///
/// Gradient: [`composite_vjp`].
#[must_use]
pub fn composite(
    photo: &Image,
    foreground: &Foreground,
    shadow: &Shadow,
    radiance: &[[f32; 3]],
    beta: &[[f32; 3]],
    curves: &Curves,
    crop: Crop,
) -> Image {
    let mut out = photo.clone();
    let width = photo.width;
    for (&pixel, beta) in shadow.pixels.iter().zip(beta) {
        let p = pixel as usize;
        if crop.contains(p, width) {
            for c in 0..3 {
                out.data[3 * p + c] *= curves.ratio(c, beta[c]);
            }
        }
    }
    for (&pixel, radiance) in foreground.pixels.iter().zip(radiance) {
        let p = pixel as usize;
        if crop.contains(p, width) {
            let v = foreground.coverage.data[p];
            for c in 0..3 {
                let under = out.data[3 * p + c];
                out.data[3 * p + c] = (1.0 - v) * under + v * curves.object(radiance[c]);
            }
        }
    }
    out
}

/// Gradients of [`composite`] for `grad` with respect to it: by row with respect to radiance and β, and sums with respect to
/// the curves. Rows outside `crop` are 0.
#[must_use]
pub fn composite_vjp(
    photo: &Image,
    foreground: &Foreground,
    shadow: &Shadow,
    radiance: &[[f32; 3]],
    beta: &[[f32; 3]],
    curves: &Curves,
    crop: Crop,
    grad: &Image,
) -> (Vec<[f32; 3]>, Vec<[f32; 3]>, CurveGradient) {
    let width = photo.width;
    let mut by_curves = CurveGradient::default();
    let mut by_beta = vec![[0.0f32; 3]; beta.len()];
    for (row, &pixel) in shadow.pixels.iter().enumerate() {
        let p = pixel as usize;
        if !crop.contains(p, width) {
            continue;
        }
        let rest = 1.0 - foreground.coverage.data[p];
        for c in 0..3 {
            let g = grad.data[3 * p + c] * rest * photo.data[3 * p + c];
            by_beta[row][c] = curves.shadow[c].vjp(beta[row][c], g, &mut by_curves.shadow[c]);
        }
    }
    let mut by_radiance = vec![[0.0f32; 3]; radiance.len()];
    for (row, &pixel) in foreground.pixels.iter().enumerate() {
        let p = pixel as usize;
        if !crop.contains(p, width) {
            continue;
        }
        for c in 0..3 {
            let g = grad.data[3 * p + c] * foreground.coverage.data[p];
            by_radiance[row][c] = curves.object_vjp(radiance[row][c], g, &mut by_curves.foreground);
        }
    }
    (by_radiance, by_beta, by_curves)
}
