//! Errors of surfaces: normals and depth.

use crate::{MetricError, check};
use comgs_image::Image;
use serde::Serialize;

/// Angular error of normals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NormalError {
    /// Mean angle in degrees.
    pub mean_deg: f64,
    /// Median angle in degrees.
    pub median_deg: f64,
    /// Share of the measured pixels below 11.25°, in [0, 1].
    pub within_11_25: f64,
    /// Number of pixels measured: under the mask, ground truth not zero.
    pub pixels: usize,
    /// Of these, pixels where the estimate is the zero vector; they count as 90°, the error of knowing nothing.
    pub missing: usize,
}

/// Angle between two normal maps (3 channels, any length, one space), over the pixels under the mask whose
/// ground truth is not the zero vector.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples, or when nothing is left to measure.
pub fn normal_error(
    normals: &Image,
    truth: &Image,
    mask: Option<&Image>,
) -> Result<NormalError, MetricError> {
    check::colors(normals, truth, "normal error")?;
    check::mask(mask, truth)?;
    if truth.channels != 3 {
        return Err(MetricError::Channels { what: "normals", expected: "3", got: truth.channels });
    }
    let mut angles = Vec::new();
    let mut missing = 0;
    for i in 0..truth.pixels() {
        let (a, b) = (vector(normals, i), vector(truth, i));
        if !check::counts(mask, i) || b == [0.0; 3] {
            continue;
        }
        if a == [0.0; 3] {
            missing += 1;
            angles.push(90.0);
        } else {
            angles.push(angle_deg(a, b));
        }
    }
    if angles.is_empty() {
        return Err(MetricError::NothingToMeasure { metric: "normal error" });
    }
    let pixels = angles.len();
    let mean_deg = angles.iter().sum::<f64>() / pixels as f64;
    let within = angles.iter().filter(|&&a| a < 11.25).count() as f64 / pixels as f64;
    Ok(NormalError { mean_deg, median_deg: median(&mut angles), within_11_25: within, pixels, missing })
}

pub(crate) fn vector(image: &Image, i: usize) -> [f64; 3] {
    let p = &image.data[i * 3..i * 3 + 3];
    [f64::from(p[0]), f64::from(p[1]), f64::from(p[2])]
}

/// The angle between two vectors by `atan2(|a × b|, a · b)`, which is exact near 0 and 180° where `acos` is not.
pub(crate) fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let sine = (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt();
    sine.atan2(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).to_degrees()
}

/// The median; the mean of the middle two for an even number. Not for empty slices.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}

/// Error of z-depth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthError {
    /// Mean of `|d − d*| / d*`.
    pub abs_rel: f64,
    /// Root mean squared error in the unit of depth.
    pub rmse: f64,
    /// Mean absolute error in the unit of depth.
    pub mae: f64,
    /// Median absolute error in the unit of depth: what edges do not dominate.
    pub median_abs: f64,
    /// Share of the pixels with `max(d/d*, d*/d) < 1.25`, in [0, 1].
    pub within_1_25: f64,
    /// Pixels measured: under the mask, ground truth above 0, estimate above 0.
    pub pixels: usize,
    /// Pixels under the mask with ground truth but without an estimate. Not part of the averages: read this first.
    pub missing: usize,
}

/// Error of a depth map against ground truth (one channel each, z-depth, 0 = nothing there).
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples, or when no pixel has both depths.
pub fn depth_error(depth: &Image, truth: &Image, mask: Option<&Image>) -> Result<DepthError, MetricError> {
    check::plane("depth", depth, truth)?;
    check::plane("ground-truth depth", truth, truth)?;
    check::mask(mask, truth)?;
    let (mut relative, mut square, mut close, mut missing) = (0.0, 0.0, 0usize, 0usize);
    let mut absolute = Vec::new();
    for (i, (&d, &t)) in depth.data.iter().zip(&truth.data).enumerate() {
        if !check::counts(mask, i) || t <= 0.0 {
            continue;
        }
        if d <= 0.0 {
            missing += 1;
            continue;
        }
        let (d, t) = (f64::from(d), f64::from(t));
        let error = (d - t).abs();
        relative += error / t;
        square += error * error;
        close += usize::from((d / t).max(t / d) < 1.25);
        absolute.push(error);
    }
    if absolute.is_empty() {
        return Err(MetricError::NothingToMeasure { metric: "depth error" });
    }
    let pixels = absolute.len();
    let n = pixels as f64;
    Ok(DepthError {
        abs_rel: relative / n,
        rmse: (square / n).sqrt(),
        mae: absolute.iter().sum::<f64>() / n,
        median_abs: median(&mut absolute),
        within_1_25: close as f64 / n,
        pixels,
        missing,
    })
}

/// Error of the unbiased depth `D / W` of a splatted frame, where `D = Σ T α z` and `W = Σ T α`; pixels with
/// `W < min_weight` have no estimate and are counted as missing.
///
/// # Errors
/// As [`depth_error`].
pub fn unbiased_depth_error(
    depth_sum: &Image,
    weight: &Image,
    truth: &Image,
    min_weight: f64,
    mask: Option<&Image>,
) -> Result<DepthError, MetricError> {
    check::plane("depth sum", depth_sum, truth)?;
    check::plane("weight", weight, truth)?;
    let unbiased = depth_sum
        .data
        .iter()
        .zip(&weight.data)
        .map(|(&d, &w)| if w > 0.0 && f64::from(w) >= min_weight { d / w } else { 0.0 })
        .collect();
    depth_error(&Image::from_data(truth.width, truth.height, 1, unbiased), truth, mask)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: angles known on paper (0, 30, 90, 180°), a missing estimate counts 90°, masked and empty truth do not.
    #[test]
    fn normal_angles_on_paper() {
        let h = 3f32.sqrt() / 2.0;
        let truth = Image::from_data(6, 1, 3, [[0.0, 0.0, 1.0]; 6].concat());
        let estimate = Image::from_data(
            6,
            1,
            3,
            [[0.0, 0.0, 2.0], [0.5, 0.0, h], [0.0, 3.0, 0.0], [0.0, 0.0, -1.0], [0.0; 3], [0.0, 1.0, 0.0]]
                .concat(),
        );
        let mask = Image::from_data(6, 1, 1, vec![1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        let e = normal_error(&estimate, &truth, Some(&mask)).unwrap();
        assert_eq!((e.pixels, e.missing), (5, 1));
        assert!((e.mean_deg - (0.0 + 30.0 + 90.0 + 180.0 + 90.0) / 5.0).abs() < 1e-5);
        assert!((e.median_deg - 90.0).abs() < 1e-9);
        assert!((e.within_11_25 - 0.2).abs() < 1e-12);
        let nothing = Image::zeros(6, 1, 3);
        assert!(matches!(normal_error(&truth, &nothing, None), Err(MetricError::NothingToMeasure { .. })));
    }

    /// Goal: tiny angles are not lost to rounding, as they are with acos.
    #[test]
    fn tiny_angles() {
        let angle = angle_deg([0.0, 0.0, 1.0], [1e-9, 0.0, 1.0]);
        assert!((angle / 1e-9f64.to_degrees() - 1.0).abs() < 1e-9);
    }

    /// Goal: depth errors of two pixels by hand; sky (truth 0) is ignored, a hole is counted.
    #[test]
    fn depth_by_hand() {
        let truth = Image::from_data(4, 1, 1, vec![2.0, 4.0, 0.0, 5.0]);
        let depth = Image::from_data(4, 1, 1, vec![3.0, 4.0, 7.0, 0.0]);
        let e = depth_error(&depth, &truth, None).unwrap();
        assert_eq!((e.pixels, e.missing), (2, 1));
        assert!((e.abs_rel - 0.25).abs() < 1e-12);
        assert!((e.rmse - 0.5f64.sqrt()).abs() < 1e-12);
        assert!((e.mae - 0.5).abs() < 1e-12 && (e.median_abs - 0.5).abs() < 1e-12);
        assert!((e.within_1_25 - 0.5).abs() < 1e-12);
    }

    /// Goal: half-covered pixels are divided by their weight; nearly empty ones are missing, not wrong.
    #[test]
    fn unbiased_depth_divides() {
        let truth = Image::filled(3, 1, 1, 4.0);
        let sum = Image::from_data(3, 1, 1, vec![4.0, 2.0, 0.001]);
        let weight = Image::from_data(3, 1, 1, vec![1.0, 0.5, 0.01]);
        let e = unbiased_depth_error(&sum, &weight, &truth, 0.1, None).unwrap();
        assert_eq!((e.pixels, e.missing), (2, 1));
        assert!(e.rmse < 1e-9);
    }
}
