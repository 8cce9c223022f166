//! The composite (DiPIR Eq. 6), from radiance and shadow ratios by row to an image, and its gradient.

use crate::tone::{CurveGradient, Curves};
use crate::transport::{Foreground, Shadow};
use comgs_image::Image;
use serde::{Deserialize, Serialize};

/// A part of an image in pixels: `x0 ≤ x < x1`, `y0 ≤ y < y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::LightMap;
    use crate::reference;
    use crate::tone::{PARAMETERS, Response, Tone};
    use crate::transport::Matrix;
    use comgs_geom::Rng;

    /// A 3×2 photo; the object covers pixel 1 in part and pixel 4 wholly, the ground of pixels 0, 1 and 5 may be shaded.
    fn scene(rng: &mut Rng) -> (Image, Foreground, Shadow) {
        let photo = Image::from_data(3, 2, 3, (0..18).map(|_| rng.range(0.1, 0.9)).collect());
        let matrix = |rows| Matrix::build(rows, 2, 1, |_, _, _| {}, |_| true).unwrap();
        let mut coverage = Image::zeros(3, 2, 1);
        (coverage.data[1], coverage.data[4]) = (0.3, 1.0);
        let none = |channels| Image::zeros(3, 2, channels);
        let (albedo, normal, depth) = (none(3), none(3), none(1));
        let foreground =
            Foreground { pixels: vec![1, 4], coverage, albedo, normal, depth, matrix: matrix(2) };
        let ground = vec![0.0; LightMap::zeros(2).texels()];
        (photo, foreground, Shadow { pixels: vec![0, 1, 5], matrix: matrix(3), ground })
    }

    /// Goal: the composite is Eq. 6 written again in f64, and its gradient with respect to radiance, shadow ratios and all 64
    /// parameters of the four curves agrees with finite differences; what the crop leaves out has no part in it.
    #[test]
    fn gradient_by_finite_differences() {
        let mut rng = Rng::new(31);
        let (photo, foreground, shadow) = scene(&mut rng);
        let mut tone = Tone::identity(Response::Reinhard);
        tone.foreground
            .iter_mut()
            .chain(tone.shadow.iter_mut().flatten())
            .for_each(|p| *p = 0.4 * rng.normal());
        let curves = tone.curves();
        let radiance: Vec<[f32; 3]> = (0..2).map(|_| std::array::from_fn(|_| rng.range(0.1, 3.0))).collect();
        let beta: Vec<[f32; 3]> = (0..3).map(|_| std::array::from_fn(|_| rng.range(0.1, 0.9))).collect();
        // Pixel 5 lies outside.
        let crop = Crop { x0: 0, y0: 0, x1: 2, y1: 2 };
        let grad = Image::from_data(3, 2, 3, (0..18).map(|_| rng.normal()).collect());
        let x: Vec<f64> = radiance
            .iter()
            .chain(&beta)
            .flatten()
            .chain(&tone.foreground)
            .chain(tone.shadow.iter().flatten())
            .map(|&v| f64::from(v))
            .collect();
        let equation = |x: &[f64]| -> Vec<f64> {
            let (radiance, rest) = x.split_at(6);
            let (beta, curves) = rest.split_at(9);
            let curve =
                |k: usize, v: f64| reference::spline(&curves[k * PARAMETERS..(k + 1) * PARAMETERS], v);
            let mut out: Vec<f64> = photo.data.iter().map(|&v| f64::from(v)).collect();
            for c in 0..3 {
                out[c] *= curve(1 + c, beta[c]);
                let lit = |row: usize| curve(0, radiance[3 * row + c] / (1.0 + radiance[3 * row + c]));
                let v = f64::from(foreground.coverage.data[1]);
                out[3 + c] = (1.0 - v) * out[3 + c] * curve(1 + c, beta[3 + c]) + v * lit(0);
                out[12 + c] = lit(1);
            }
            out
        };
        let image = composite(&photo, &foreground, &shadow, &radiance, &beta, &curves, crop);
        for (ours, truth) in image.data.iter().zip(equation(&x)) {
            assert!((f64::from(*ours) - truth).abs() < 1e-5, "{ours} {truth}");
        }
        let (by_radiance, by_beta, by_curves) =
            composite_vjp(&photo, &foreground, &shadow, &radiance, &beta, &curves, crop, &grad);
        assert_eq!(by_beta[2], [0.0; 3]);
        let gradient: Vec<f32> =
            by_radiance.iter().chain(&by_beta).flatten().copied().chain(by_curves.flat(&curves)).collect();
        let loss =
            |x: &[f64]| equation(x).iter().zip(&grad.data).map(|(v, g)| v * f64::from(*g)).sum::<f64>();
        reference::assert_gradient(&x, &gradient, loss, 2e-3);
    }
}
