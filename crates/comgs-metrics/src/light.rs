//! Errors of estimated light, on panoramas or on renders of spheres under it.

use crate::{MetricError, check, color, geometry};
use comgs_image::Image;
use serde::Serialize;

/// What weight a pixel has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum PixelWeights {
    /// Every pixel the same: renders.
    #[default]
    Uniform,
    /// The solid angle of the pixel's row: equirectangular panoramas, whose poles are stretched.
    SolidAngle,
}

impl PixelWeights {
    fn of_row(self, row: usize, height: usize) -> f64 {
        use std::f64::consts::PI;
        match self {
            Self::Uniform => 1.0,
            Self::SolidAngle => {
                (PI * row as f64 / height as f64).cos() - (PI * (row + 1) as f64 / height as f64).cos()
            }
        }
    }
}

/// Weighted sums over samples: (Σw, Σw·a², Σw·ab, Σw·b²).
fn sums(
    image: &Image,
    truth: &Image,
    weights: PixelWeights,
    mask: Option<&Image>,
    metric: &'static str,
) -> Result<[f64; 4], MetricError> {
    check::colors(image, truth, metric)?;
    check::mask(mask, truth)?;
    let channels = truth.channels;
    let mut s = [0.0; 4];
    for i in 0..truth.pixels() {
        if !check::counts(mask, i) {
            continue;
        }
        let w = weights.of_row(i / truth.width, truth.height);
        for c in 0..channels {
            let (a, b) = (f64::from(image.data[i * channels + c]), f64::from(truth.data[i * channels + c]));
            for (s, v) in s.iter_mut().zip([1.0, a * a, a * b, b * b]) {
                *s += w * v;
            }
        }
    }
    if s[0] > 0.0 { Ok(s) } else { Err(MetricError::NothingToMeasure { metric }) }
}

/// Root mean squared error of linear radiance, in its unit.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples or an empty mask.
pub fn rmse(
    image: &Image,
    truth: &Image,
    weights: PixelWeights,
    mask: Option<&Image>,
) -> Result<f64, MetricError> {
    let [n, aa, ab, bb] = sums(image, truth, weights, mask, "RMSE")?;
    Ok(((aa - 2.0 * ab + bb).max(0.0) / n).sqrt())
}

/// Scale-invariant RMSE (Grosse et al. 2009): the RMSE after the one factor `α = Σab / Σa²` on the estimate
/// that makes it least. Invariant to the estimate's exposure, not to the truth's: not symmetric.
///
/// # Errors
/// As [`rmse`].
pub fn si_rmse(
    image: &Image,
    truth: &Image,
    weights: PixelWeights,
    mask: Option<&Image>,
) -> Result<f64, MetricError> {
    let [n, aa, ab, bb] = sums(image, truth, weights, mask, "si-RMSE")?;
    // A black estimate has no scale to adjust: its error is the truth itself.
    let explained = if aa > 0.0 { ab * ab / aa } else { 0.0 };
    Ok(((bb - explained).max(0.0) / n).sqrt())
}

/// RMSE after both images were mapped linearly so that their 0.1 and 99.9 percentiles become 0 and 1, the
/// normalised RMSE of light-estimation papers (Marnerides et al. 2018). An image whose percentiles coincide
/// is only shifted.
///
/// # Errors
/// As [`rmse`].
pub fn normalized_rmse(
    image: &Image,
    truth: &Image,
    weights: PixelWeights,
    mask: Option<&Image>,
) -> Result<f64, MetricError> {
    check::colors(image, truth, "normalised RMSE")?;
    check::mask(mask, truth)?;
    let normalised = |im: &Image| {
        let mut values: Vec<f64> = (0..im.pixels())
            .filter(|&i| check::counts(mask, i))
            .flat_map(|i| im.data[i * im.channels..(i + 1) * im.channels].iter().map(|&v| f64::from(v)))
            .collect();
        if values.is_empty() {
            return Err(MetricError::NothingToMeasure { metric: "normalised RMSE" });
        }
        values.sort_by(f64::total_cmp);
        let (low, high) = (percentile(&values, 0.001), percentile(&values, 0.999));
        let range = if high > low { high - low } else { 1.0 };
        Ok(im.map(|v| ((f64::from(v) - low) / range) as f32))
    };
    rmse(&normalised(image)?, &normalised(truth)?, weights, mask)
}

/// Linearly interpolated percentile of sorted values.
fn percentile(sorted: &[f64], p: f64) -> f64 {
    let x = p * (sorted.len() - 1) as f64;
    let (i, t) = (x.floor() as usize, x.fract());
    let next = sorted[(i + 1).min(sorted.len() - 1)];
    sorted[i] + (next - sorted[i]) * t
}

/// Angular error of colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AngularRgbError {
    /// Weighted mean angle between RGB vectors in degrees.
    pub mean_deg: f64,
    /// Pixels measured.
    pub pixels: usize,
    /// Pixels left out because one of the two colours is black and has no direction.
    pub black: usize,
}

/// Mean angle between the RGB vectors of two images (LeGendre et al. 2019): a colour error that no exposure
/// hides. Pixels where either is black are left out and counted.
///
/// # Errors
/// As [`rmse`], and when every pixel is black.
pub fn angular_rgb_error(
    image: &Image,
    truth: &Image,
    weights: PixelWeights,
    mask: Option<&Image>,
) -> Result<AngularRgbError, MetricError> {
    check::colors(image, truth, "angular RGB error")?;
    check::mask(mask, truth)?;
    let (mut sum, mut total, mut pixels, mut black) = (0.0, 0.0, 0, 0);
    for i in 0..truth.pixels() {
        if !check::counts(mask, i) {
            continue;
        }
        let (a, b) = (color::rgb(image, i), color::rgb(truth, i));
        if a == [0.0; 3] || b == [0.0; 3] {
            black += 1;
            continue;
        }
        let w = weights.of_row(i / truth.width, truth.height);
        sum += w * geometry::angle_deg(a, b);
        total += w;
        pixels += 1;
    }
    if pixels == 0 {
        return Err(MetricError::NothingToMeasure { metric: "angular RGB error" });
    }
    Ok(AngularRgbError { mean_deg: sum / total, pixels, black })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(offset: f32) -> Image {
        Image::from_data(8, 4, 3, (0..96).map(|i| offset + (i % 11) as f32 * 0.1).collect())
    }

    /// Goal: si-RMSE does not see exposure; RMSE of a constant difference is that difference.
    #[test]
    fn scale_invariance() {
        let truth = ramp(0.2);
        for weights in [PixelWeights::Uniform, PixelWeights::SolidAngle] {
            assert!(si_rmse(&truth.map(|v| 3.7 * v), &truth, weights, None).unwrap() < 1e-6);
            let shifted = truth.map(|v| v + 0.25);
            assert!((rmse(&shifted, &truth, weights, None).unwrap() - 0.25).abs() < 1e-6);
            assert!(si_rmse(&shifted, &truth, weights, None).unwrap() > 0.01);
            assert!(normalized_rmse(&truth.map(|v| 2.0 * v + 0.5), &truth, weights, None).unwrap() < 1e-6);
        }
    }

    /// Goal: si-RMSE of two pixels by hand: a = (1, 0), b = (1, 1) gives α = 1 and √½; a black estimate
    /// gives the truth's own root mean square.
    #[test]
    fn si_rmse_by_hand() {
        let a = Image::from_data(2, 1, 1, vec![1.0, 0.0]);
        let b = Image::from_data(2, 1, 1, vec![1.0, 1.0]);
        assert!((si_rmse(&a, &b, PixelWeights::Uniform, None).unwrap() - 0.5f64.sqrt()).abs() < 1e-9);
        let black = Image::zeros(2, 1, 1);
        assert!((si_rmse(&black, &b, PixelWeights::Uniform, None).unwrap() - 1.0).abs() < 1e-9);
    }

    /// Goal: red against green is 90°, red against grey is acos(1/√3), exposure changes nothing, black is counted.
    #[test]
    fn angular_on_paper() {
        let a = Image::from_data(3, 1, 3, vec![1.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let b = Image::from_data(3, 1, 3, vec![0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        let e = angular_rgb_error(&a, &b, PixelWeights::Uniform, None).unwrap();
        let expected = (90.0 + (1.0 / 3f64.sqrt()).acos().to_degrees()) / 2.0;
        assert!((e.mean_deg - expected).abs() < 1e-9);
        assert_eq!((e.pixels, e.black), (2, 1));
        assert!(angular_rgb_error(&Image::zeros(3, 1, 3), &b, PixelWeights::Uniform, None).is_err());
    }

    /// Goal: the weights of a panorama's rows are solid angles: they sum to 2 over the column (4π / 2π).
    #[test]
    fn rows_weigh_their_solid_angle() {
        let sum: f64 = (0..9).map(|r| PixelWeights::SolidAngle.of_row(r, 9)).sum();
        assert!((sum - 2.0).abs() < 1e-12);
    }
}
