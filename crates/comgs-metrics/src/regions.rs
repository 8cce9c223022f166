//! Scores of a composed frame, region by region: whole frame, object, its shadow, elsewhere.

use crate::{Border, FlipConfig, Map, MetricError, check, color, flip, psnr_srgb, ssim_map};
use comgs_image::Image;
use serde::Serialize;

/// How the shadow region is read off the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ShadowRule {
    /// Least relative loss of luminance that counts as shadow, in (0, 1).
    pub least_loss: f64,
    /// Least loss of brightness as a viewer sees it, in sRGB code values of 8 bit: in dark corners the relative
    /// noise of a path-traced truth is large although nobody sees it.
    pub least_loss_255: f64,
    /// Radius in pixels of the box over which luminance is averaged first, so that render noise is not taken
    /// for shadow.
    pub smoothing_px: usize,
    /// Luminance (linear) below which the empty frame is too dark for a ratio to mean anything.
    pub dark: f64,
}

impl Default for ShadowRule {
    /// 5 % and 4 code values after a 5×5 mean, above 1/1000. Ground truth at 16 samples a pixel differs from itself
    /// by 1 to 2 code values on average.
    fn default() -> Self {
        Self { least_loss: 0.05, least_loss_255: 4.0, smoothing_px: 2, dark: 1e-3 }
    }
}

/// A partition of a frame; each is a one-channel mask of zeros and ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Regions {
    /// Every pixel that the object covers, however little.
    pub object: Image,
    /// Pixels outside the object that its presence darkens.
    pub shadow: Image,
    /// All others.
    pub elsewhere: Image,
}

impl Regions {
    /// From ground truth: linear frames with and without the object, and the object's antialiased coverage.
    ///
    /// A pixel is object where its coverage reaches half a code value of 8 bit, and shadow where the mean
    /// luminance of its surroundings (object pixels left out) is below that of the empty frame by
    /// `rule.least_loss` and, sRGB-encoded, by `rule.least_loss_255`.
    ///
    /// # Errors
    /// [`MetricError`] on different shapes or non-finite samples.
    pub fn from_truth(
        with_object: &Image,
        empty: &Image,
        coverage: &Image,
        rule: &ShadowRule,
    ) -> Result<Self, MetricError> {
        check::colors(with_object, empty, "regions")?;
        check::plane("object coverage", coverage, empty)?;
        let (width, height) = (empty.width, empty.height);
        let object: Vec<bool> = coverage.data.iter().map(|&m| m >= 0.5 / 255.0).collect();
        let luminance = |image: &Image| -> Vec<f64> {
            (0..image.pixels())
                .map(|i| if object[i] { 0.0 } else { color::luminance(color::rgb(image, i)) })
                .collect()
        };
        let r = rule.smoothing_px;
        // Both sums run over the same pixels, so their ratio is the ratio of the means.
        let after = box_sum(&luminance(with_object), width, height, r);
        let before = box_sum(&luminance(empty), width, height, r);
        let outside: Vec<f64> = object.iter().map(|&o| f64::from(u8::from(!o))).collect();
        let counted = box_sum(&outside, width, height, r);
        let mut regions = Self {
            object: Image::zeros(width, height, 1),
            shadow: Image::zeros(width, height, 1),
            elsewhere: Image::zeros(width, height, 1),
        };
        for i in 0..object.len() {
            let code = |sum: f64| 255.0 * color::srgb_clipped(sum / counted[i].max(1.0));
            let shaded = before[i] > rule.dark * counted[i]
                && after[i] < (1.0 - rule.least_loss) * before[i]
                && code(before[i]) - code(after[i]) >= rule.least_loss_255;
            let region = if object[i] {
                &mut regions.object
            } else if shaded {
                &mut regions.shadow
            } else {
                &mut regions.elsewhere
            };
            region.data[i] = 1.0;
        }
        Ok(regions)
    }
}

/// Sum over the (2r+1)² box around every pixel, cut at the border.
fn box_sum(values: &[f64], width: usize, height: usize, r: usize) -> Vec<f64> {
    let mut rows = vec![0.0; values.len()];
    for y in 0..height {
        for x in 0..width {
            let line = &values[y * width..(y + 1) * width];
            rows[y * width + x] = line[x.saturating_sub(r)..(x + r + 1).min(width)].iter().sum();
        }
    }
    let mut out = vec![0.0; values.len()];
    for y in 0..height {
        for source in y.saturating_sub(r)..(y + r + 1).min(height) {
            for x in 0..width {
                out[y * width + x] += rows[source * width + x];
            }
        }
    }
    out
}

/// The scores of one frame or of one region of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// PSNR in decibel of sRGB-encoded clipped values ([`psnr_srgb`]); infinite (`null` in JSON) where equal.
    pub psnr_db: f64,
    /// Mean SSIM over the region's pixels whose window lies inside the frame; `None` where there are none.
    pub ssim: Option<f64>,
    /// Mean ꟻLIP, default viewing conditions; 0 is equal.
    pub flip: f64,
    /// Mean absolute difference of sRGB-encoded clipped values in code values of 8 bit (0 to 255).
    pub mean_abs_255: f64,
    /// Pixels measured.
    pub pixels: usize,
}

/// Scores by region; `None` where a region has no pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RegionScores {
    /// The whole frame.
    pub whole: Scores,
    /// Where the object is.
    pub object: Option<Scores>,
    /// Where its shadow falls.
    pub shadow: Option<Scores>,
    /// The rest.
    pub elsewhere: Option<Scores>,
}

struct Maps {
    ssim: Option<crate::SsimMap>,
    flip: Map,
    absolute: Map,
}

impl Maps {
    fn of(frame: &Image, truth: &Image) -> Result<Self, MetricError> {
        let flip = flip::flip(frame, truth, &FlipConfig::default())?;
        // A frame under 11×11 has no SSIM; the other scores stand.
        let ssim = match ssim_map(frame, truth, Border::Valid) {
            Ok(map) => Some(map),
            Err(MetricError::TooSmall { .. }) => None,
            Err(e) => return Err(e),
        };
        let channels = truth.channels;
        let values = frame
            .data
            .chunks_exact(channels)
            .zip(truth.data.chunks_exact(channels))
            .map(|(a, b)| {
                a.iter()
                    .zip(b)
                    .map(|(&a, &b)| {
                        (color::srgb_clipped(f64::from(a)) - color::srgb_clipped(f64::from(b))).abs()
                    })
                    .sum::<f64>()
                    * (255.0 / channels as f64)
            })
            .collect();
        Ok(Self { ssim, flip, absolute: Map { width: truth.width, height: truth.height, values } })
    }

    /// `None` where the mask is empty.
    fn score(
        &self,
        frame: &Image,
        truth: &Image,
        mask: Option<&Image>,
    ) -> Result<Option<Scores>, MetricError> {
        let (Some((flip, pixels)), Some((mean_abs_255, _))) =
            (self.flip.mean(mask), self.absolute.mean(mask))
        else {
            return Ok(None);
        };
        let psnr_db = psnr_srgb(frame, truth, mask)?.db;
        let ssim = self.ssim.as_ref().and_then(|s| s.mean(mask)).map(|s| s.mean);
        Ok(Some(Scores { psnr_db, ssim, flip, mean_abs_255, pixels }))
    }
}

/// PSNR, SSIM, ꟻLIP and mean absolute difference of a frame (linear radiance) against ground truth.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples or an empty mask.
pub fn score(frame: &Image, truth: &Image, mask: Option<&Image>) -> Result<Scores, MetricError> {
    check::colors(frame, truth, "scores")?;
    check::mask(mask, truth)?;
    Maps::of(frame, truth)?
        .score(frame, truth, mask)?
        .ok_or(MetricError::NothingToMeasure { metric: "scores" })
}

/// [`score`] for the whole frame and each region. Maps are computed once on the whole frame, so a window at a
/// region's rim sees what lies beyond it.
///
/// # Errors
/// As [`score`].
pub fn score_regions(frame: &Image, truth: &Image, regions: &Regions) -> Result<RegionScores, MetricError> {
    check::colors(frame, truth, "scores")?;
    for mask in [&regions.object, &regions.shadow, &regions.elsewhere] {
        check::mask(Some(mask), truth)?;
    }
    let maps = Maps::of(frame, truth)?;
    let whole = maps.score(frame, truth, None)?.ok_or(MetricError::NothingToMeasure { metric: "scores" })?;
    Ok(RegionScores {
        whole,
        object: maps.score(frame, truth, Some(&regions.object))?,
        shadow: maps.score(frame, truth, Some(&regions.shadow))?,
        elsewhere: maps.score(frame, truth, Some(&regions.elsewhere))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey frame with an object in columns 2..8 and a half-dark shadow in columns 8..16.
    fn scene() -> (Image, Image, Image) {
        let empty = Image::filled(32, 16, 3, 0.4);
        let (mut with, mut mask) = (empty.clone(), Image::zeros(32, 16, 1));
        for y in 0..16 {
            for x in 2..8 {
                with.pixel_mut(x, y).fill(0.9);
                mask.pixel_mut(x, y)[0] = 1.0;
            }
            mask.pixel_mut(8, y)[0] = 0.1;
            for x in 8..16 {
                with.pixel_mut(x, y).fill(0.2);
            }
        }
        (with, empty, mask)
    }

    /// Goal: the three regions are a partition, with the shadow where it was painted; the smoothing moves its rim
    /// by no more than its radius.
    #[test]
    fn regions_partition_the_frame() {
        let (with, empty, mask) = scene();
        let rule = ShadowRule::default();
        let regions = Regions::from_truth(&with, &empty, &mask, &rule).unwrap();
        for i in 0..32 * 16 {
            let sum = regions.object.data[i] + regions.shadow.data[i] + regions.elsewhere.data[i];
            assert_eq!(sum, 1.0);
        }
        for x in 0..32 {
            let region =
                [&regions.object, &regions.shadow, &regions.elsewhere].map(|r| r.pixel(x, 8)[0] == 1.0);
            match x {
                0 | 1 | 18.. => assert!(region[2], "{x}"),
                2..=8 => assert!(region[0], "{x}"),
                9..=15 => assert!(region[1], "{x}"),
                _ => {}
            }
        }
        let exact = ShadowRule { smoothing_px: 0, ..rule };
        let regions = Regions::from_truth(&with, &empty, &mask, &exact).unwrap();
        assert_eq!(regions.shadow.data.iter().sum::<f32>(), 7.0 * 16.0);
        // A black empty frame has no shadow: the ratio means nothing there.
        let black = Image::zeros(32, 16, 3);
        let regions = Regions::from_truth(&black, &black, &mask, &rule).unwrap();
        assert_eq!(regions.shadow.data.iter().sum::<f32>(), 0.0);
    }

    /// Goal: an error in one region is seen in that region and in the whole, and nowhere else.
    #[test]
    fn errors_stay_in_their_region() {
        let (truth, empty, mask) = scene();
        let regions = Regions::from_truth(&truth, &empty, &mask, &ShadowRule::default()).unwrap();
        let mut frame = truth.clone();
        for y in 0..16 {
            for x in 9..16 {
                frame.pixel_mut(x, y).copy_from_slice(empty.pixel(x, y));
            }
        }
        let scores = score_regions(&frame, &truth, &regions).unwrap();
        assert_eq!(scores.object.unwrap().psnr_db, f64::INFINITY);
        assert_eq!(scores.elsewhere.unwrap().mean_abs_255, 0.0);
        let shadow = scores.shadow.unwrap();
        assert!(shadow.psnr_db < scores.whole.psnr_db && scores.whole.psnr_db < 40.0);
        assert!(shadow.flip > scores.whole.flip && shadow.ssim.unwrap() < scores.whole.ssim.unwrap());
        // sRGB codes of 0.4 and 0.2 by hand: 0.66519 and 0.48453; 7 of the region's 9 columns or so are wrong.
        let expected = 255.0 * (0.66519 - 0.48453) * (7.0 * 16.0) / shadow.pixels as f64;
        assert!((shadow.mean_abs_255 - expected).abs() < 0.05, "{shadow:?}");
    }

    /// Goal: a region without pixels is `None`, a tiny frame has scores but no SSIM.
    #[test]
    fn empty_regions_and_tiny_frames() {
        let frame = Image::filled(6, 6, 3, 0.5);
        let regions =
            Regions::from_truth(&frame, &frame, &Image::zeros(6, 6, 1), &ShadowRule::default()).unwrap();
        let scores = score_regions(&frame, &frame, &regions).unwrap();
        assert!(scores.object.is_none() && scores.shadow.is_none());
        assert!(scores.whole.ssim.is_none() && scores.whole.flip == 0.0);
        assert!(score(&frame, &frame, Some(&Image::zeros(6, 6, 1))).is_err());
    }
}
