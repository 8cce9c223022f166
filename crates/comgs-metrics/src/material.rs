//! Errors of materials: albedo up to the factor that photographs cannot tell, roughness and metallic.
//!
//! A surface of albedo `a` under light `L` and one of `s·a` under `L / s` give the same (diffuse) photograph. Papers on
//! inverse rendering (NeRFactor, TensoIR, R3DG) therefore scale every channel of all estimated albedo images by
//! one factor a set before they compare; the figure without it says how well a method's prior for the factor works.
//! Both are computed here, and they are only honest side by side.

use crate::{MetricError, Psnr, check, color};
use comgs_image::Image;
use serde::Serialize;

const METRIC: &str = "albedo error";

/// Running sums of the least-squares scale, for sets of views that do not fit into memory together. The order of the
/// views changes the result by rounding of f64 only.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScaleFit {
    /// Σ e², a channel.
    estimate_square: [f64; 3],
    /// Σ e·t, a channel.
    product: [f64; 3],
    /// Pixels that counted.
    pixels: usize,
}

impl ScaleFit {
    /// Adds the pixels of a view that count under its mask. Both images are linear, 3 channels, and premultiplied alike
    /// (or neither): a pixel's weight in the fit is then its coverage.
    ///
    /// # Errors
    /// [`MetricError`] on different shapes and non-finite samples; a view without a counting pixel adds nothing.
    pub fn add(&mut self, estimate: &Image, truth: &Image, mask: Option<&Image>) -> Result<(), MetricError> {
        colors(estimate, truth)?;
        check::mask(mask, truth)?;
        for i in (0..truth.pixels()).filter(|&i| check::counts(mask, i)) {
            let (e, t) = (color::rgb(estimate, i), color::rgb(truth, i));
            for c in 0..3 {
                self.estimate_square[c] += e[c] * e[c];
                self.product[c] += e[c] * t[c];
            }
            self.pixels += 1;
        }
        Ok(())
    }

    /// The factors `s` on the estimate that make `Σ (s·e − t)²` least: `s_c = Σ e_c t_c / Σ e_c²` for each channel, or
    /// the one `s = Σ_c Σ e_c t_c / Σ_c Σ e_c²` three times. A channel in which every estimate is 0 has no scale: 1.
    ///
    /// # Errors
    /// [`MetricError::NothingToMeasure`] when no pixel counted.
    pub fn scale(&self, per_channel: bool) -> Result<[f64; 3], MetricError> {
        if self.pixels == 0 {
            return Err(MetricError::NothingToMeasure { metric: "albedo scale" });
        }
        let ratio = |product: f64, square: f64| if square > 0.0 { product / square } else { 1.0 };
        Ok(if per_channel {
            [0, 1, 2].map(|c| ratio(self.product[c], self.estimate_square[c]))
        } else {
            [ratio(self.product.iter().sum(), self.estimate_square.iter().sum()); 3]
        })
    }
}

/// The least-squares scale over all counting pixels of all views together, in linear space: [`ScaleFit`] of a set that
/// is in memory. `per_channel` is the protocol of the papers; one factor for all channels keeps an estimate's hue, and
/// its errors.
///
/// # Errors
/// [`MetricError`] when the lists differ in length, on different shapes, non-finite samples, or when no pixel counts.
pub fn align_scale(
    estimates: &[&Image],
    truths: &[&Image],
    masks: &[Option<&Image>],
    per_channel: bool,
) -> Result<[f64; 3], MetricError> {
    for (parameter, got) in [("number of ground truths", truths.len()), ("number of masks", masks.len())] {
        if got != estimates.len() {
            let expected = "the number of estimates";
            return Err(MetricError::Parameter { parameter, expected, got: got as f64 });
        }
    }
    let mut fit = ScaleFit::default();
    for ((estimate, truth), mask) in estimates.iter().zip(truths).zip(masks) {
        fit.add(estimate, truth, *mask)?;
    }
    fit.scale(per_channel)
}

/// PSNR of an albedo image, of sRGB-encoded values clipped to [0, 1], peak 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AlbedoPsnr {
    /// Over the whole frame: the background is black in both and counts as equal, as papers count it.
    pub frame: Psnr,
    /// Over the pixels that count under the mask; `None` without a mask and where none counts.
    pub in_mask: Option<Psnr>,
}

/// Error of an albedo image before and after alignment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MaterialError {
    /// The scale that was applied to the estimate.
    pub scale: [f64; 3],
    /// Of the estimate as it is.
    pub unaligned: AlbedoPsnr,
    /// Of `scale · estimate`.
    pub aligned: AlbedoPsnr,
}

/// Error of a view's albedo (3 channels, linear, over black: premultiplied by coverage, truth by its alpha), as it is and
/// scaled by `scale` (of [`align_scale`] over the whole set, not of this view alone).
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples, an empty image, or a scale that is not finite.
pub fn material_error(
    estimate: &Image,
    truth: &Image,
    mask: Option<&Image>,
    scale: [f64; 3],
) -> Result<MaterialError, MetricError> {
    colors(estimate, truth)?;
    check::mask(mask, truth)?;
    if let Some(&got) = scale.iter().find(|s| !s.is_finite()) {
        return Err(MetricError::Parameter { parameter: "albedo scale", expected: "finite factors", got });
    }
    let both = |scale| AlbedoPsnr {
        frame: psnr(estimate, truth, None, scale),
        in_mask: mask.map(|m| psnr(estimate, truth, Some(m), scale)).filter(|p| p.pixels > 0),
    };
    Ok(MaterialError { scale, unaligned: both([1.0; 3]), aligned: both(scale) })
}

/// PSNR of `scale · estimate`, encoded and clipped. The scale is applied in f64, so that an exact scale gives equality.
fn psnr(estimate: &Image, truth: &Image, mask: Option<&Image>, scale: [f64; 3]) -> Psnr {
    let (mut sum, mut pixels) = (0.0, 0);
    for i in (0..truth.pixels()).filter(|&i| check::counts(mask, i)) {
        let (e, t) = (color::rgb(estimate, i), color::rgb(truth, i));
        for c in 0..3 {
            sum += (color::srgb_clipped(scale[c] * e[c]) - color::srgb_clipped(t[c])).powi(2);
        }
        pixels += 1;
    }
    let mse = sum / (3 * pixels) as f64;
    Psnr { db: 10.0 * (1.0 / mse).log10(), mse, pixels }
}

fn colors(estimate: &Image, truth: &Image) -> Result<(), MetricError> {
    check::colors(estimate, truth, METRIC)?;
    if truth.channels != 3 {
        return Err(MetricError::Channels { what: "albedo", expected: "3", got: truth.channels });
    }
    Ok(())
}

/// Error of a plane of one bounded parameter (roughness, metallic), in its unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PlaneError {
    /// Mean absolute error.
    pub mae: f64,
    /// Root mean squared error.
    pub rmse: f64,
    /// Pixels measured: under the mask, with an estimate.
    pub pixels: usize,
    /// Pixels under the mask without an estimate. Not part of the averages: read this first.
    pub missing: usize,
}

/// Error of a plane (one channel each), over the pixels that count under the mask.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples, or when no pixel counts.
pub fn plane_error(values: &Image, truth: &Image, mask: Option<&Image>) -> Result<PlaneError, MetricError> {
    check::plane("plane", values, truth)?;
    sum_plane(truth, mask, |i| Some(f64::from(values.data[i])))
}

/// Error of the plane `V / W` of a splatted frame, where `V = Σ T α v` and `W = Σ T α`; pixels with `W < min_weight` have
/// no estimate and are counted as missing. The truth is not premultiplied.
///
/// # Errors
/// As [`plane_error`], and when no counting pixel has an estimate.
pub fn unbiased_plane_error(
    sum: &Image,
    weight: &Image,
    truth: &Image,
    min_weight: f64,
    mask: Option<&Image>,
) -> Result<PlaneError, MetricError> {
    check::plane("sum of the plane", sum, truth)?;
    check::plane("weight", weight, truth)?;
    sum_plane(truth, mask, |i| {
        let w = f64::from(weight.data[i]);
        (w > 0.0 && w >= min_weight).then(|| f64::from(sum.data[i]) / w)
    })
}

fn sum_plane(
    truth: &Image,
    mask: Option<&Image>,
    estimate: impl Fn(usize) -> Option<f64>,
) -> Result<PlaneError, MetricError> {
    check::plane("ground-truth plane", truth, truth)?;
    check::mask(mask, truth)?;
    let (mut absolute, mut square, mut pixels, mut missing) = (0.0, 0.0, 0usize, 0usize);
    for i in (0..truth.pixels()).filter(|&i| check::counts(mask, i)) {
        let Some(value) = estimate(i) else {
            missing += 1;
            continue;
        };
        let error = value - f64::from(truth.data[i]);
        absolute += error.abs();
        square += error * error;
        pixels += 1;
    }
    if pixels == 0 {
        return Err(MetricError::NothingToMeasure { metric: "plane error" });
    }
    let n = pixels as f64;
    Ok(PlaneError { mae: absolute / n, rmse: (square / n).sqrt(), pixels, missing })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of a few f32 products in f64: only rounding of f64 is left.
    const EXACT: f64 = 1e-12;

    fn row(pixels: &[[f32; 3]]) -> Image {
        Image::from_data(pixels.len(), 1, 3, pixels.concat())
    }

    /// The linear value of an sRGB code in [0.04, 1], by hand.
    fn linear(code: f64) -> f32 {
        ((code + 0.055) / 1.055).powf(2.4) as f32
    }

    /// Goal: the scale of two views by hand, per channel and for all channels: Σet / Σe² over both, not a mean of each
    /// view's own scale.
    #[test]
    fn scale_by_hand() {
        let estimates = [row(&[[1.0, 0.5, 0.25]]), row(&[[2.0, 0.5, 0.5], [9.0, 9.0, 9.0]])];
        let truths = [row(&[[2.0, 0.25, 1.0]]), row(&[[2.0, 0.25, 2.0], [0.0, 0.0, 0.0]])];
        let mask = Image::from_data(2, 1, 1, vec![1.0, 0.49]);
        let fit = |per_channel| {
            let (e, t) = ([&estimates[0], &estimates[1]], [&truths[0], &truths[1]]);
            align_scale(&e, &t, &[None, Some(&mask)], per_channel).unwrap()
        };
        // Red: (1·2 + 2·2) / (1 + 4); green: ½ everywhere; blue: 4 everywhere.
        for (got, expected) in fit(true).into_iter().zip([1.2, 0.5, 4.0]) {
            assert!((got - expected).abs() < EXACT, "{got} {expected}");
        }
        let one = (6.0 + 0.25 + 1.25) / (5.0 + 0.5 + 0.3125);
        assert!(fit(false).iter().all(|s| (s - one).abs() < EXACT), "{:?} {one}", fit(false));
    }

    /// Goal: the scale is a minimum: any other has a larger squared error. A channel without an estimate keeps 1, as does
    /// a black one.
    #[test]
    fn scale_is_the_least() {
        let estimate = row(&[[0.3, 0.0, 0.8], [0.1, 0.0, 0.2], [0.7, 0.0, 0.4]]);
        let truth = row(&[[0.2, 0.5, 0.9], [0.3, 0.2, 0.1], [0.5, 0.1, 0.6]]);
        let scale = align_scale(&[&estimate], &[&truth], &[None], true).unwrap();
        assert_eq!(scale[1], 1.0);
        let error = |s: f64, c: usize| -> f64 {
            (0..3)
                .map(|i| (s * f64::from(estimate.pixel(i, 0)[c]) - f64::from(truth.pixel(i, 0)[c])).powi(2))
                .sum()
        };
        for c in [0, 2] {
            for step in [-1e-3, 1e-3] {
                assert!(error(scale[c] + step, c) > error(scale[c], c));
            }
        }
        let black = Image::zeros(3, 1, 3);
        assert_eq!(align_scale(&[&black], &[&truth], &[None], false).unwrap(), [1.0; 3]);
    }

    /// Goal: an estimate that is off by one factor a channel is perfect after alignment and as wrong as computed on paper
    /// before: codes 0.2 against 0.3 are 20 dB in the mask, and a quarter of that error over a frame four times as large.
    #[test]
    fn alignment_removes_a_factor() {
        let mut truth = Image::zeros(4, 1, 3);
        let mut estimate = Image::zeros(4, 1, 3);
        let mask = Image::from_data(4, 1, 1, vec![0.0, 1.0, 0.0, 0.0]);
        for c in 0..3 {
            truth.data[3 + c] = linear(0.3);
            estimate.data[3 + c] = linear(0.2);
        }
        let scale = align_scale(&[&estimate], &[&truth], &[Some(&mask)], true).unwrap();
        let e = material_error(&estimate, &truth, Some(&mask), scale).unwrap();
        let (frame, masked) = (e.unaligned.frame, e.unaligned.in_mask.unwrap());
        // f32 holds a linear value to 6e-8 of itself.
        assert!((masked.db - 20.0).abs() < 1e-5 && masked.pixels == 1, "{masked:?}");
        assert!((frame.db - 20.0 - 10.0 * 4f64.log10()).abs() < 1e-5 && frame.pixels == 4, "{frame:?}");
        assert!(e.aligned.frame.db > 250.0 && e.aligned.in_mask.unwrap().db > 250.0, "{:?}", e.aligned);
        assert_eq!(e.scale, scale);

        // Halves are exact in f32: equality is infinite.
        let half = truth.map(|v| 0.5 * v);
        let scale = align_scale(&[&half], &[&truth], &[Some(&mask)], true).unwrap();
        assert_eq!(scale, [2.0; 3]);
        assert_eq!(material_error(&half, &truth, None, scale).unwrap().aligned.frame.db, f64::INFINITY);
    }

    /// Goal: a wrong hue is not hidden by one factor for all channels, and is by one a channel.
    #[test]
    fn one_factor_keeps_the_hue() {
        let truth = row(&[[0.4, 0.4, 0.4], [0.2, 0.2, 0.2]]);
        let estimate = row(&[[0.4, 0.2, 0.2], [0.2, 0.1, 0.1]]);
        let aligned = |per_channel| {
            let scale = align_scale(&[&estimate], &[&truth], &[None], per_channel).unwrap();
            material_error(&estimate, &truth, None, scale).unwrap().aligned.frame.db
        };
        assert_eq!(aligned(true), f64::INFINITY);
        assert!(aligned(false) < 25.0, "{}", aligned(false));
    }

    /// Goal: roughness by hand: errors 0.1 and 0.3 over two pixels; a masked pixel and one without weight do not count,
    /// and the latter is told. Half-covered pixels are divided by their weight.
    #[test]
    fn planes_by_hand() {
        let truth = Image::from_data(4, 1, 1, vec![0.5, 0.5, 0.5, 0.5]);
        let values = Image::from_data(4, 1, 1, vec![0.6, 0.2, 0.9, 0.5]);
        let mask = Image::from_data(4, 1, 1, vec![1.0, 1.0, 0.0, 0.0]);
        let e = plane_error(&values, &truth, Some(&mask)).unwrap();
        // f32 values against decimal ones.
        assert!((e.mae - 0.2).abs() < 1e-7 && (e.rmse - 0.05f64.sqrt()).abs() < 1e-7, "{e:?}");
        assert_eq!((e.pixels, e.missing), (2, 0));

        let weight = Image::from_data(4, 1, 1, vec![0.5, 1.0, 0.1, 0.0]);
        let sum = Image::from_data(4, 1, 1, vec![0.3, 0.2, 0.1, 0.0]);
        let e = unbiased_plane_error(&sum, &weight, &truth, 0.5, None).unwrap();
        assert!((e.mae - 0.2).abs() < 1e-7, "{e:?}");
        assert_eq!((e.pixels, e.missing), (2, 2));
        assert!(unbiased_plane_error(&sum, &Image::zeros(4, 1, 1), &truth, 0.0, None).is_err());
    }

    /// Goal: what cannot be compared is refused by name; a mask that counts nothing scores nothing.
    #[test]
    fn refusals() {
        let a = Image::filled(2, 2, 3, 0.5);
        let nothing = Image::zeros(2, 2, 1);
        let fit = |masks: &[Option<&Image>]| align_scale(&[&a], &[&a], masks, true);
        assert!(matches!(fit(&[]), Err(MetricError::Parameter { parameter: "number of masks", .. })));
        assert!(matches!(fit(&[Some(&nothing)]), Err(MetricError::NothingToMeasure { .. })));
        assert!(align_scale(&[], &[], &[], true).is_err());
        assert!(matches!(align_scale(&[&a], &[], &[None], true), Err(MetricError::Parameter { .. })));
        let grey = Image::zeros(2, 2, 1);
        assert!(matches!(
            material_error(&grey, &grey, None, [1.0; 3]),
            Err(MetricError::Channels { what: "albedo", .. })
        ));
        assert!(matches!(
            material_error(&a, &Image::zeros(2, 3, 3), None, [1.0; 3]),
            Err(MetricError::Size { .. })
        ));
        assert!(matches!(
            material_error(&a, &a, None, [1.0, f64::NAN, 1.0]),
            Err(MetricError::Parameter { .. })
        ));
        assert_eq!(material_error(&a, &a, Some(&nothing), [1.0; 3]).unwrap().aligned.in_mask, None);
        let bad = Image::filled(2, 2, 3, f32::NAN);
        assert!(matches!(material_error(&bad, &a, None, [1.0; 3]), Err(MetricError::NonFinite { .. })));
        assert!(matches!(plane_error(&a, &grey, None), Err(MetricError::Channels { .. })));
        assert!(matches!(
            plane_error(&grey, &grey, Some(&nothing)),
            Err(MetricError::NothingToMeasure { .. })
        ));
    }
}
