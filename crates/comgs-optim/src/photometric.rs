//! The image loss of training, ComGS Eq. 2: L1 + 0.2 (1 − SSIM).

use crate::ssim::ssim_plane;
use comgs_image::Image;
use comgs_image::transfer::{srgb_from_linear, srgb_slope};
use rayon::prelude::*;

/// Where the L1 term compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// In sRGB code values: for 8-bit photos. Where the photo is clipped (a code of 254.5/255 or more), brighter
    /// renderings are as good as equal ones, because the photo only says "at least this bright".
    Srgb,
    /// In linear radiance: for HDR captures. SSIM is still taken on sRGB values.
    Linear,
    /// In sRGB code values, continued above 1, for HDR captures whose few brightest pixels must not outweigh the rest: an
    /// error of a mirrored lamp counts by its code, as the eye would take it.
    Coded,
}

/// A target image, prepared once.
#[derive(Clone, Debug)]
pub struct Target {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Where L1 compares.
    pub comparison: Comparison,
    encoded: Vec<f32>,
    linear: Vec<f32>,
    valid: Option<Vec<f32>>,
    /// Pixels that count.
    count: usize,
}

/// Value of the loss and what a progress bar shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhotometricValue {
    /// Mean absolute difference over the valid pixels (in the target's comparison space).
    pub l1: f32,
    /// Sum of 1 − SSIM over the number of valid pixels. Pixels that are not valid are taken as equal to the target, so a
    /// window that holds only such adds nothing.
    pub dssim: f32,
    /// Mean squared difference over the valid pixels of sRGB values clipped to [0, 1], for a PSNR.
    pub mse_srgb: f32,
}

impl PhotometricValue {
    /// Eq. 2.
    #[must_use]
    pub fn loss(&self, ssim_weight: f32) -> f32 {
        self.l1 + ssim_weight * self.dssim
    }

    /// PSNR in dB of clipped sRGB values.
    #[must_use]
    pub fn psnr_db(&self) -> f32 {
        -10.0 * self.mse_srgb.max(1e-12).log10()
    }
}

/// Code value from which an 8-bit photo counts as clipped.
const CLIPPED: f32 = 254.5 / 255.0;

impl Target {
    /// From linear radiance, 3 channels; `valid` (1 channel) marks pixels that count with values above ½.
    ///
    /// # Panics
    /// When the image does not have 3 channels or the mask differs in size.
    #[must_use]
    pub fn new(linear: &Image, valid: Option<&Image>, comparison: Comparison) -> Self {
        assert_eq!(linear.channels, 3);
        let n = linear.pixels();
        let mut planar = vec![0.0; 3 * n];
        for (i, p) in linear.data.chunks_exact(3).enumerate() {
            for c in 0..3 {
                planar[c * n + i] = p[c];
            }
        }
        let valid = valid.map(|v| {
            assert_eq!((v.width, v.height), (linear.width, linear.height));
            v.data.clone()
        });
        let counts = |v: &Vec<f32>| v.iter().filter(|v| **v > 0.5).count();
        Self {
            width: linear.width,
            height: linear.height,
            comparison,
            count: valid.as_ref().map_or(n, counts),
            encoded: planar.iter().map(|&v| srgb_from_linear(v)).collect(),
            linear: if comparison == Comparison::Linear { planar } else { Vec::new() },
            valid,
        }
    }
}

/// Buffers of the loss; reuse across iterations.
#[derive(Debug, Default)]
pub struct Photometric {
    encoded: Vec<f32>,
    slope: Vec<f32>,
    l1_gradient: Vec<f32>,
    ssim_gradient: Vec<f32>,
}

impl Photometric {
    /// Value of Eq. 2 for a linear rendering, its gradient with respect to the rendering (added to `gradient`), and
    /// the absolute sRGB error a pixel (mean over channels, written to `error`).
    ///
    /// All three terms are over the valid pixels only. L1 has a kink at equality (gradient 0 there); everything else is
    /// smooth. Without a valid pixel value and gradient are 0.
    ///
    /// # Panics
    /// When sizes differ.
    pub fn evaluate(
        &mut self,
        rendering: &Image,
        target: &Target,
        ssim_weight: f32,
        gradient: &mut Image,
        error: &mut Image,
    ) -> PhotometricValue {
        assert_eq!((rendering.width, rendering.height, rendering.channels), (target.width, target.height, 3));
        let n = rendering.pixels();
        for buffer in [&mut self.encoded, &mut self.slope, &mut self.l1_gradient, &mut self.ssim_gradient] {
            buffer.clear();
            buffer.resize(3 * n, 0.0);
        }
        let scale = 1.0 / (3 * target.count.max(1)) as f32;
        // SSIM comes as a mean over all pixels.
        let ssim_scale = if target.count == 0 { 0.0 } else { n as f32 / target.count as f32 };
        // One pass a channel: encode, compare, and keep the slope of the encoding.
        let sums: Vec<[f64; 2]> = self
            .encoded
            .par_chunks_mut(n)
            .zip(self.slope.par_chunks_mut(n))
            .zip(self.l1_gradient.par_chunks_mut(n))
            .enumerate()
            .map(|(c, ((encoded, slope), l1_gradient))| {
                let goal = &target.encoded[c * n..(c + 1) * n];
                let mut sums = [0.0f64; 2];
                for i in 0..n {
                    let x = rendering.data[i * 3 + c];
                    let e = srgb_from_linear(x);
                    let t = goal[i];
                    let invalid = target.valid.as_ref().is_some_and(|v| v[i] <= 0.5);
                    if !invalid {
                        let clip = |v: f32| v.clamp(0.0, 1.0);
                        sums[1] += f64::from((clip(e) - clip(t)).powi(2));
                    }
                    if invalid || (target.comparison == Comparison::Srgb && t >= CLIPPED && e > t) {
                        encoded[i] = t;
                        continue;
                    }
                    encoded[i] = e;
                    slope[i] = srgb_slope(x);
                    let (difference, chain) = match target.comparison {
                        Comparison::Srgb | Comparison::Coded => (e - t, slope[i]),
                        Comparison::Linear => (x - target.linear[c * n + i], 1.0),
                    };
                    sums[0] += f64::from(difference.abs());
                    let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
                    l1_gradient[i] = scale * sign * chain;
                }
                sums
            })
            .collect();
        let mut ssim = 0.0;
        if ssim_weight != 0.0 {
            for c in 0..3 {
                let range = c * n..(c + 1) * n;
                ssim += ssim_plane(
                    &self.encoded[range.clone()],
                    &target.encoded[range.clone()],
                    target.width,
                    target.height,
                    &mut self.ssim_gradient[range],
                ) / 3.0;
            }
        } else {
            ssim = 1.0;
        }
        let (encoded, slope, l1, ssim_gradient) =
            (&self.encoded, &self.slope, &self.l1_gradient, &self.ssim_gradient);
        let weight = ssim_weight * ssim_scale / 3.0;
        gradient
            .data
            .par_chunks_mut(3 * target.width)
            .zip(error.data.par_chunks_mut(target.width))
            .enumerate()
            .for_each(|(y, (gradient, error))| {
                for x in 0..target.width {
                    let i = y * target.width + x;
                    let mut sum = 0.0;
                    for c in 0..3 {
                        let k = c * n + i;
                        gradient[x * 3 + c] += l1[k] - weight * ssim_gradient[k] * slope[k];
                        sum += (encoded[k] - target.encoded[k]).abs();
                    }
                    error[x] = sum / 3.0;
                }
            });
        let l1: f64 = sums.iter().map(|s| s[0]).sum();
        let mse: f64 = sums.iter().map(|s| s[1]).sum();
        let samples = (3 * target.count.max(1)) as f64;
        PhotometricValue {
            l1: (l1 / samples) as f32,
            dssim: (1.0 - ssim) * ssim_scale,
            mse_srgb: (mse / samples) as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;

    fn random(width: usize, height: usize, seed: u64, scale: f32) -> Image {
        let mut rng = Rng::new(seed);
        Image::from_data(width, height, 3, (0..3 * width * height).map(|_| scale * rng.uniform()).collect())
    }

    /// The left half of a 14 × 12 picture.
    fn half_valid() -> Image {
        Image::from_data(14, 12, 1, (0..14 * 12).map(|i| f32::from(u8::from(i % 14 < 7))).collect())
    }

    /// Goal: the gradient is the derivative of the value, for both comparisons and with a part of the picture that does
    /// not count, by central differences.
    #[test]
    fn gradient_matches_differences() {
        let half = half_valid();
        for (comparison, valid) in [
            (Comparison::Srgb, None),
            (Comparison::Linear, None),
            (Comparison::Coded, None),
            (Comparison::Srgb, Some(&half)),
            (Comparison::Linear, Some(&half)),
        ] {
            let target = Target::new(&random(14, 12, 1, 0.9), valid, comparison);
            let rendering = random(14, 12, 2, 0.9).map(|v| v + 0.02);
            let mut loss = Photometric::default();
            let mut gradient = Image::zeros(14, 12, 3);
            let mut error = Image::zeros(14, 12, 1);
            loss.evaluate(&rendering, &target, 0.2, &mut gradient, &mut error);
            let mut value = |r: &Image| {
                let mut scratch = Image::zeros(14, 12, 3);
                let mut error = Image::zeros(14, 12, 1);
                f64::from(loss.evaluate(r, &target, 0.2, &mut scratch, &mut error).loss(0.2))
            };
            // One direction that all entries take part in: single entries of a mean are below f32's resolution.
            let direction = random(14, 12, 3, 1.0).map(|v| v - 0.5);
            let h = 1e-3f32;
            let shifted = |s: f32| {
                let mut r = rendering.clone();
                r.data.iter_mut().zip(&direction.data).for_each(|(r, d)| *r += s * d);
                r
            };
            let numeric = (value(&shifted(h)) - value(&shifted(-h))) / f64::from(2.0 * h);
            let analytic: f64 =
                gradient.data.iter().zip(&direction.data).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
            assert!((numeric - analytic).abs() < 0.02 * numeric.abs().max(0.01), "{numeric} {analytic}");
        }
    }

    /// Goal: pixels that do not count change neither value nor gradient, and all means are over those that do: half a
    /// picture that is off by 0.1 everywhere has the same L1 and MSE as a whole one.
    #[test]
    fn means_are_over_valid_pixels() {
        let half = half_valid();
        let evaluate = |rendering: &Image, valid: Option<&Image>| {
            let target = Target::new(&Image::filled(14, 12, 3, 0.3), valid, Comparison::Linear);
            let (mut gradient, mut error) = (Image::zeros(14, 12, 3), Image::zeros(14, 12, 1));
            let value = Photometric::default().evaluate(rendering, &target, 0.2, &mut gradient, &mut error);
            (value, gradient)
        };
        let off = Image::filled(14, 12, 3, 0.4);
        let mut wild = off.clone();
        for i in (0..14 * 12).filter(|i| i % 14 >= 7) {
            wild.data[3 * i..3 * i + 3].fill(7.0);
        }
        let (whole, _) = evaluate(&off, None);
        let (left, gradient) = evaluate(&off, Some(&half));
        // f32 sums of equal numbers.
        assert!((left.l1 - whole.l1).abs() < 1e-6 && (left.l1 - 0.1).abs() < 1e-6, "{left:?} {whole:?}");
        assert!((left.mse_srgb - whole.mse_srgb).abs() < 1e-7, "{left:?} {whole:?}");
        assert_eq!((left, gradient), evaluate(&wild, Some(&half)));
        let (none, gradient) = evaluate(&wild, Some(&Image::zeros(14, 12, 1)));
        assert_eq!((none.l1, none.dssim, none.mse_srgb), (0.0, 0.0, 0.0));
        assert!(gradient.data.iter().all(|g| *g == 0.0));
    }

    /// Goal: clipped photo pixels do not punish brighter renderings, invalid pixels have no gradient.
    #[test]
    fn clipped_and_invalid_pixels() {
        let target_image = Image::filled(4, 4, 3, 1.0);
        let mut valid = Image::filled(4, 4, 1, 1.0);
        valid.data[5] = 0.0;
        let target = Target::new(&target_image, Some(&valid), Comparison::Srgb);
        let mut rendering = Image::filled(4, 4, 3, 5.0);
        rendering.data[5 * 3] = 0.2;
        rendering.data[6 * 3] = 0.2;
        let mut gradient = Image::zeros(4, 4, 3);
        let mut error = Image::zeros(4, 4, 1);
        Photometric::default().evaluate(&rendering, &target, 0.0, &mut gradient, &mut error);
        assert!(gradient.data[6 * 3] < 0.0);
        assert_eq!(gradient.data.iter().filter(|g| **g != 0.0).count(), 1);
    }
}
