//! Agreement of silhouettes.

use crate::{MetricError, check};
use comgs_image::Image;
use serde::Serialize;

/// Agreement of two coverages.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Intersection over union of the two thresholded at ½; 1 when both are empty.
    pub iou: f64,
    /// `Σ min(a, b) / Σ max(a, b)` of the fractional coverages: also sees the antialiased edge; 1 when both
    /// are empty.
    pub soft_iou: f64,
    /// Mean absolute difference of the fractional coverages over the image.
    pub mean_abs: f64,
}

/// Compares two coverage maps (one channel, values clipped to [0, 1]). Symmetric.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples or empty images.
pub fn coverage_iou(coverage: &Image, truth: &Image) -> Result<Coverage, MetricError> {
    check::plane("coverage", coverage, truth)?;
    check::plane("ground-truth coverage", truth, truth)?;
    if truth.pixels() == 0 {
        return Err(MetricError::NothingToMeasure { metric: "coverage" });
    }
    let (mut both, mut either, mut low, mut high) = (0usize, 0usize, 0.0, 0.0);
    for (&a, &b) in coverage.data.iter().zip(&truth.data) {
        let (a, b) = (f64::from(a).clamp(0.0, 1.0), f64::from(b).clamp(0.0, 1.0));
        both += usize::from(a >= 0.5 && b >= 0.5);
        either += usize::from(a >= 0.5 || b >= 0.5);
        low += a.min(b);
        high += a.max(b);
    }
    Ok(Coverage {
        iou: if either > 0 { both as f64 / either as f64 } else { 1.0 },
        soft_iou: if high > 0.0 { low / high } else { 1.0 },
        mean_abs: (high - low) / truth.pixels() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: overlap of two intervals by hand, both empty is agreement, symmetric.
    #[test]
    fn overlap_by_hand() {
        let a = Image::from_data(4, 1, 1, vec![1.0, 1.0, 0.25, 0.0]);
        let b = Image::from_data(4, 1, 1, vec![0.0, 1.0, 0.75, 0.0]);
        let c = coverage_iou(&a, &b).unwrap();
        assert!((c.iou - 1.0 / 3.0).abs() < 1e-12);
        assert!((c.soft_iou - 1.25 / 2.75).abs() < 1e-12);
        assert!((c.mean_abs - 1.5 / 4.0).abs() < 1e-12);
        assert_eq!(c, coverage_iou(&b, &a).unwrap());
        let empty = Image::zeros(4, 1, 1);
        assert_eq!(coverage_iou(&empty, &empty).unwrap().iou, 1.0);
        assert_eq!(coverage_iou(&a, &empty).unwrap().soft_iou, 0.0);
    }
}
