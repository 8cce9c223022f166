//! Peak signal-to-noise ratio.

use crate::{MetricError, check, color};
use comgs_image::Image;
use serde::Serialize;

/// A peak signal-to-noise ratio and what it was computed from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Psnr {
    /// `10 · log₁₀(peak² / mse)` in decibel; infinite where the images are equal.
    pub db: f64,
    /// Mean squared error over pixels and channels.
    pub mse: f64,
    /// Number of pixels measured.
    pub pixels: usize,
}

fn from_samples(
    image: &Image,
    truth: &Image,
    mask: Option<&Image>,
    peak: f64,
    encode: impl Fn(f64) -> f64,
) -> Result<Psnr, MetricError> {
    check::colors(image, truth, "PSNR")?;
    check::mask(mask, truth)?;
    let channels = truth.channels;
    let (mut sum, mut pixels) = (0.0, 0usize);
    for (i, (a, b)) in image.data.chunks_exact(channels).zip(truth.data.chunks_exact(channels)).enumerate() {
        if check::counts(mask, i) {
            pixels += 1;
            sum += a
                .iter()
                .zip(b)
                .map(|(&a, &b)| (encode(f64::from(a)) - encode(f64::from(b))).powi(2))
                .sum::<f64>();
        }
    }
    if pixels == 0 {
        return Err(MetricError::NothingToMeasure { metric: "PSNR" });
    }
    let mse = sum / (pixels * channels) as f64;
    Ok(Psnr { db: 10.0 * (peak * peak / mse).log10(), mse, pixels })
}

/// PSNR of what a viewer sees: both images are sRGB-encoded and clipped to [0, 1], peak 1. This is the figure
/// that papers on novel-view synthesis report. Symmetric in the two images.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples or an empty mask.
pub fn psnr_srgb(image: &Image, truth: &Image, mask: Option<&Image>) -> Result<Psnr, MetricError> {
    from_samples(image, truth, mask, 1.0, color::srgb_clipped)
}

/// PSNR of linear radiance, not clipped, with the given peak (> 0, in the images' unit).
///
/// # Errors
/// As [`psnr_srgb`], and when the peak is not a positive number.
pub fn psnr_linear(
    image: &Image,
    truth: &Image,
    peak: f64,
    mask: Option<&Image>,
) -> Result<Psnr, MetricError> {
    if !(peak > 0.0 && peak.is_finite()) {
        return Err(MetricError::Parameter {
            parameter: "peak",
            expected: "a finite number above 0",
            got: peak,
        });
    }
    from_samples(image, truth, mask, peak, |v| v)
}

/// PSNR of linear radiance clipped to [0, 1], peak 1.
///
/// # Errors
/// As [`psnr_srgb`].
pub fn psnr_linear_clipped(image: &Image, truth: &Image, mask: Option<&Image>) -> Result<Psnr, MetricError> {
    from_samples(image, truth, mask, 1.0, |v| v.clamp(0.0, 1.0))
}

/// A colour with straight alpha over a plain background, linearly: `c·α + b·(1 − α)`. Objects are compared
/// so, over black and over white, because their colour outside the silhouette means nothing.
///
/// # Errors
/// [`MetricError`] when alpha is not one channel of the colour's size, or samples are not finite.
pub fn composite_over(color: &Image, alpha: &Image, background: f32) -> Result<Image, MetricError> {
    check::plane("alpha", alpha, color)?;
    check::finite("image", color)?;
    let mut out = color.clone();
    for (pixel, &a) in out.data.chunks_exact_mut(color.channels).zip(&alpha.data) {
        for v in pixel {
            *v = *v * a + background * (1.0 - a);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: PSNR of a constant difference is known on paper: 0.1 → 20 dB linear; sRGB codes 0.2 and 0.3 → 20 dB.
    #[test]
    fn constant_difference() {
        let a = Image::filled(7, 5, 3, 0.4);
        let b = Image::filled(7, 5, 3, 0.5);
        assert!((psnr_linear(&a, &b, 1.0, None).unwrap().db - 20.0).abs() < 1e-5);
        assert!((psnr_linear(&a, &b, 10.0, None).unwrap().db - 40.0).abs() < 1e-5);
        assert!((psnr_linear_clipped(&a, &b, None).unwrap().db - 20.0).abs() < 1e-5);
        // (0.2 + 0.055)/1.055 to the power 2.4, by hand.
        let code = |c: f64| ((c + 0.055) / 1.055).powf(2.4) as f32;
        let (a, b) = (Image::filled(3, 3, 3, code(0.2)), Image::filled(3, 3, 3, code(0.3)));
        assert!((psnr_srgb(&a, &b, None).unwrap().db - 20.0).abs() < 1e-4);
    }

    /// Goal: equal images give infinity, values above 1 are clipped in the sRGB variant only.
    #[test]
    fn identity_and_clipping() {
        let a = Image::filled(4, 4, 3, 1.5);
        let b = Image::filled(4, 4, 3, 2.5);
        assert_eq!(psnr_srgb(&a, &a, None).unwrap().db, f64::INFINITY);
        assert_eq!(psnr_srgb(&a, &b, None).unwrap().db, f64::INFINITY);
        assert!(psnr_linear(&a, &b, 1.0, None).unwrap().db.abs() < 1e-6);
    }

    /// Goal: a mask selects pixels; the error elsewhere has no weight.
    #[test]
    fn mask_selects() {
        let truth = Image::zeros(4, 1, 1);
        let image = Image::from_data(4, 1, 1, vec![0.0, 0.1, 0.9, 0.1]);
        let mask = Image::from_data(4, 1, 1, vec![0.0, 1.0, 0.4, 1.0]);
        let scored = psnr_linear(&image, &truth, 1.0, Some(&mask)).unwrap();
        assert_eq!(scored.pixels, 2);
        assert!((scored.db - 20.0).abs() < 1e-5);
        assert!(matches!(
            psnr_srgb(&image, &truth, Some(&Image::zeros(4, 1, 1))),
            Err(MetricError::NothingToMeasure { .. })
        ));
    }

    /// Goal: what cannot be compared is refused by name (hard case: silent corruption has no excuse).
    #[test]
    fn refusals() {
        let a = Image::zeros(4, 4, 3);
        assert!(matches!(psnr_srgb(&a, &Image::zeros(4, 5, 3), None), Err(MetricError::Size { .. })));
        assert!(matches!(psnr_srgb(&a, &Image::zeros(4, 4, 1), None), Err(MetricError::Channels { .. })));
        assert!(matches!(psnr_srgb(&a, &Image::zeros(4, 4, 2), None), Err(MetricError::Channels { .. })));
        assert!(matches!(psnr_srgb(&a, &a, Some(&Image::zeros(3, 4, 1))), Err(MetricError::Size { .. })));
        let mut bad = a.clone();
        bad.data[5] = f32::NAN;
        bad.data[6] = f32::INFINITY;
        let error = psnr_srgb(&bad, &a, None).unwrap_err();
        assert_eq!(error, MetricError::NonFinite { what: "image", count: 2 });
        assert!(psnr_linear(&a, &a, 0.0, None).is_err());
        assert!(psnr_srgb(&Image::zeros(0, 0, 3), &Image::zeros(0, 0, 3), None).is_err());
    }

    /// Goal: compositing is linear in alpha.
    #[test]
    fn composite() {
        let over = composite_over(&Image::filled(1, 1, 3, 0.8), &Image::filled(1, 1, 1, 0.25), 1.0).unwrap();
        assert!((over.data[0] - 0.95).abs() < 1e-6);
    }
}
