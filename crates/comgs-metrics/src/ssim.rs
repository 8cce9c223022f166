//! Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004).

use crate::{Map, MetricError, check, color};
use comgs_image::Image;
use serde::Serialize;

/// What happens where the window leaves the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum Border {
    /// Only positions where the whole 11×11 window lies inside count, as in Wang's own code. The default.
    #[default]
    Valid,
    /// The image continues as zeros and every pixel counts, as in the convolution that Gaussian-splatting papers
    /// report with. Differs from `Valid` in the third decimal on ordinary images.
    ZeroPadded,
}

/// A structural similarity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ssim {
    /// Mean over the measured pixels, 1 for equal images, at most 1.
    pub mean: f64,
    /// Number of pixels measured.
    pub pixels: usize,
}

/// The SSIM of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct SsimMap {
    /// One value a pixel, the mean of the channels; meaningless within [`SsimMap::inset`] of the border.
    pub map: Map,
    /// Width in pixels of the border that does not count: 5 for [`Border::Valid`], else 0.
    pub inset: usize,
}

const WINDOW: usize = 11;
const RADIUS: usize = WINDOW / 2;
const SIGMA_PX: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// The normalised 11-tap Gaussian, σ = 1.5 pixels.
fn window() -> [f64; WINDOW] {
    let mut taps = [0.0; WINDOW];
    for (i, t) in taps.iter_mut().enumerate() {
        let d = i as f64 - RADIUS as f64;
        *t = (-d * d / (2.0 * SIGMA_PX * SIGMA_PX)).exp();
    }
    let sum: f64 = taps.iter().sum();
    taps.map(|t| t / sum)
}

/// Gaussian mean of `values` at every pixel, zeros outside. Inside the valid region this is the plain window.
fn blur(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    let taps = window();
    let pass = |source: &[f64], length: usize, step: usize, lines: usize, line_step: usize| {
        let mut out = vec![0.0; source.len()];
        for line in 0..lines {
            for i in 0..length {
                let mut sum = 0.0;
                for (k, t) in taps.iter().enumerate() {
                    if let Some(j) = (i + k).checked_sub(RADIUS).filter(|&j| j < length) {
                        sum += t * source[line * line_step + j * step];
                    }
                }
                out[line * line_step + i * step] = sum;
            }
        }
        out
    };
    let rows = pass(values, width, 1, height, width);
    pass(&rows, height, width, width, 1)
}

/// SSIM at every pixel: both images sRGB-encoded and clipped to [0, 1] (dynamic range 1, K₁ = 0.01, K₂ = 0.03),
/// 11×11 Gaussian window with σ = 1.5, biased (co)variances as in the original, mean over the channels.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples, or, with [`Border::Valid`], images under 11×11.
pub fn ssim_map(image: &Image, truth: &Image, border: Border) -> Result<SsimMap, MetricError> {
    check::colors(image, truth, "SSIM")?;
    let (width, height) = (truth.width, truth.height);
    if border == Border::Valid && width.min(height) < WINDOW {
        return Err(MetricError::TooSmall { metric: "SSIM", window: WINDOW, got: (width, height) });
    }
    let mut values = vec![0.0; width * height];
    for channel in 0..truth.channels {
        let x = color::srgb_channel(image, channel);
        let y = color::srgb_channel(truth, channel);
        let product = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
        let mean_x = blur(&x, width, height);
        let mean_y = blur(&y, width, height);
        let xx = blur(&product(&x, &x), width, height);
        let yy = blur(&product(&y, &y), width, height);
        let xy = blur(&product(&x, &y), width, height);
        for (i, v) in values.iter_mut().enumerate() {
            let (mx, my) = (mean_x[i], mean_y[i]);
            let (var_x, var_y, cov) = (xx[i] - mx * mx, yy[i] - my * my, xy[i] - mx * my);
            // Wang et al. 2004, Eq. 13.
            *v += ((2.0 * mx * my + C1) * (2.0 * cov + C2))
                / ((mx * mx + my * my + C1) * (var_x + var_y + C2))
                / truth.channels as f64;
        }
    }
    Ok(SsimMap {
        map: Map { width, height, values },
        inset: if border == Border::Valid { RADIUS } else { 0 },
    })
}

impl SsimMap {
    /// Mean over the pixels that lie inside the inset and under the mask; `None` where there are none.
    #[must_use]
    pub fn mean(&self, mask: Option<&Image>) -> Option<Ssim> {
        let (mut sum, mut pixels) = (0.0, 0);
        for y in self.inset..self.map.height.saturating_sub(self.inset) {
            for x in self.inset..self.map.width.saturating_sub(self.inset) {
                let i = y * self.map.width + x;
                if check::counts(mask, i) {
                    sum += self.map.values[i];
                    pixels += 1;
                }
            }
        }
        (pixels > 0).then(|| Ssim { mean: sum / pixels as f64, pixels })
    }
}

/// Mean SSIM, see [`ssim_map`]; with a mask, the mean of the map over the masked pixels (windows still see their
/// surroundings). Symmetric in the two images.
///
/// # Errors
/// As [`ssim_map`], and when no pixel is left under the mask.
pub fn ssim(image: &Image, truth: &Image, border: Border, mask: Option<&Image>) -> Result<Ssim, MetricError> {
    check::mask(mask, truth)?;
    ssim_map(image, truth, border)?.mean(mask).ok_or(MetricError::NothingToMeasure { metric: "SSIM" })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(width: usize, height: usize, channels: usize, k: f32) -> Image {
        let n = width * height * channels;
        Image::from_data(
            width,
            height,
            channels,
            (0..n).map(|i| 0.5 + 0.4 * (i as f32 * 0.37 + k).sin() * (i as f32 * 0.011).cos()).collect(),
        )
    }

    /// The definition with four nested loops: weights from the two-dimensional Gaussian, sums over the window.
    fn brute_force(a: &Image, b: &Image, border: Border) -> f64 {
        let (w, h) = (a.width as i64, a.height as i64);
        let inset = if border == Border::Valid { 5 } else { 0 };
        let (mut total, mut count) = (0.0, 0.0);
        for c in 0..a.channels {
            for y in inset..h - inset {
                for x in inset..w - inset {
                    let (mut norm, mut s) = (0.0f64, [0.0f64; 5]);
                    for dy in -5i64..=5 {
                        for dx in -5i64..=5 {
                            let g = (-((dx * dx + dy * dy) as f64) / 4.5).exp();
                            norm += g;
                            if x + dx < 0 || y + dy < 0 || x + dx >= w || y + dy >= h {
                                continue;
                            }
                            let at = |im: &Image| {
                                let v = f64::from(im.pixel((x + dx) as usize, (y + dy) as usize)[c]);
                                if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
                            };
                            let (p, q) = (at(a), at(b));
                            for (s, v) in s.iter_mut().zip([p, q, p * p, q * q, p * q]) {
                                *s += g * v;
                            }
                        }
                    }
                    let [mx, my, xx, yy, xy] = s.map(|v| v / norm);
                    let l = (2.0 * mx * my + 1e-4) / (mx * mx + my * my + 1e-4);
                    let cs = (2.0 * (xy - mx * my) + 9e-4) / (xx - mx * mx + yy - my * my + 9e-4);
                    total += l * cs;
                    count += 1.0;
                }
            }
        }
        total / count
    }

    /// Goal: the separable code is the definition, for both borders, colour and grey.
    #[test]
    fn matches_the_definition() {
        for channels in [1, 3] {
            let (a, b) = (pattern(17, 13, channels, 0.0), pattern(17, 13, channels, 0.6));
            for border in [Border::Valid, Border::ZeroPadded] {
                let got = ssim(&a, &b, border, None).unwrap();
                assert!((got.mean - brute_force(&a, &b, border)).abs() < 1e-12);
                assert!(got.mean < 0.999 && got.mean > -1.0);
            }
        }
    }

    /// Goal: on constant images only the luminance term is left: (2ab + C₁)/(a² + b² + C₁) with a = 0, b = 1.
    #[test]
    fn constants_on_paper() {
        let (black, white) = (Image::zeros(12, 12, 3), Image::filled(12, 12, 3, 1.0));
        let got = ssim(&black, &white, Border::Valid, None).unwrap();
        assert!((got.mean - 1e-4 / (1.0 + 1e-4)).abs() < 1e-9);
        assert_eq!(got.pixels, 4);
    }

    /// Goal: 1 for equal images, symmetric, and falling as noise grows.
    #[test]
    fn identity_symmetry_monotone() {
        let truth = pattern(24, 20, 3, 0.0);
        assert!((ssim(&truth, &truth, Border::Valid, None).unwrap().mean - 1.0).abs() < 1e-12);
        let mut last = 1.0;
        for amplitude in [0.02f32, 0.05, 0.1, 0.3] {
            let mut noisy = truth.clone();
            for (i, v) in noisy.data.iter_mut().enumerate() {
                *v += amplitude * (i as f32 * 12.9898).sin();
            }
            let score = ssim(&noisy, &truth, Border::Valid, None).unwrap().mean;
            assert!(score < last);
            assert!((ssim(&truth, &noisy, Border::Valid, None).unwrap().mean - score).abs() < 1e-12);
            last = score;
        }
    }

    /// Goal: an image smaller than the window is refused, unless padded.
    #[test]
    fn small_images() {
        let a = Image::zeros(10, 30, 3);
        assert!(matches!(ssim(&a, &a, Border::Valid, None), Err(MetricError::TooSmall { .. })));
        assert!(ssim(&a, &a, Border::ZeroPadded, None).is_ok());
        let b = Image::zeros(20, 20, 3);
        let corner = {
            let mut m = Image::zeros(20, 20, 1);
            m.data[0] = 1.0;
            m
        };
        assert!(matches!(
            ssim(&b, &b, Border::Valid, Some(&corner)),
            Err(MetricError::NothingToMeasure { .. })
        ));
    }
}
