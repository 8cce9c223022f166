//! Noise of photos by brightness.

use comgs_geom::Rng;
use comgs_image::Image;
use comgs_image::transfer::{linear_from_srgb, srgb_from_linear};
use rayon::prelude::*;
use serde::Serialize;

/// Bins of brightness.
const BINS: usize = 8;
/// Side of the blocks that are looked at.
const BLOCK: usize = 8;
/// Part of the blocks of a bin that is taken to be without texture.
const SMOOTH: f64 = 0.2;
/// Mean over variance of the second-difference residual of white noise at that quantile of the blocks: the residual of a
/// block has Σρ² = (70/36)² per sample, so 64 samples are worth 17 free ones, and χ²₁₇/17 has its quantile of 0.2 at 0.707
/// (Wilson and Hilferty 1931).
const AT_QUANTILE: f64 = 0.707;
/// Fewest blocks of a bin.
const LEAST: usize = 24;
/// Standard deviation below which 8 bit show nothing: half a code value.
const VISIBLE: f32 = 0.5 / 255.0;
/// Coded values beyond which noise is clipped.
const CLIPPED: (f32, f32) = (0.03, 0.97);

/// Standard deviation of sRGB-coded values, 1 is white, at eight brightnesses: the bins' middles (k + ½) / 8. Independent from
/// pixel to pixel and channel to channel, which noise of photos that were denoised or compressed is not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Noise {
    /// By coded value.
    pub sigma: [f32; BINS],
}

impl Noise {
    /// Of photos in linear RGB; `None` where it is below half a code value of 8 bit on average.
    ///
    /// Blocks of 8² pixels, every channel by itself: the variance of `(∂xx ∂yy I) / 6` (Immerkær 1996), which is that of the noise
    /// where the picture is smooth. In every bin of brightness the quantile of 0.2 of the blocks is taken, over what white noise has there:
    /// texture, which only adds, is passed over while a fifth of the blocks is smooth.
    #[must_use]
    pub fn estimate(photos: &[Image]) -> Option<Self> {
        let blocks: Vec<(usize, f64)> = photos.par_iter().flat_map_iter(blocks).collect();
        let mut bins: [Vec<f64>; BINS] = Default::default();
        for (bin, variance) in blocks {
            bins[bin].push(variance);
        }
        let mut sigma = [f32::NAN; BINS];
        for (sigma, variances) in sigma.iter_mut().zip(&mut bins) {
            if variances.len() >= LEAST {
                variances.sort_by(f64::total_cmp);
                let at = (SMOOTH * variances.len() as f64) as usize;
                *sigma = (variances[at] / AT_QUANTILE).sqrt() as f32;
            }
        }
        let known: Vec<usize> = (0..BINS).filter(|&k| sigma[k].is_finite()).collect();
        let mean = known.iter().map(|&k| sigma[k]).sum::<f32>() / known.len().max(1) as f32;
        if known.is_empty() || mean < VISIBLE {
            return None;
        }
        for k in 0..BINS {
            // A brightness that no smooth block has takes the nearest one's.
            let nearest = known.iter().min_by_key(|n| n.abs_diff(k)).copied().unwrap_or(k);
            sigma[k] = sigma[nearest];
        }
        Some(Self { sigma })
    }

    /// Standard deviation at a coded value, linear between the bins' middles.
    #[must_use]
    pub fn at(&self, coded: f32) -> f32 {
        let x = (coded.clamp(0.0, 1.0) * BINS as f32 - 0.5).clamp(0.0, (BINS - 1) as f32);
        let k = (x as usize).min(BINS - 2);
        let part = x - k as f32;
        self.sigma[k] * (1.0 - part) + self.sigma[k + 1] * part
    }

    /// Adds it to a picture in linear RGB, which stays within [0, ∞). The same seed and stream give the same noise at any thread count.
    pub fn add(&self, image: &mut Image, seed: u64, stream: u64) {
        let row = image.width * image.channels;
        image.data.par_chunks_mut(row.max(1)).enumerate().for_each(|(y, row)| {
            let mut rng = Rng::stream(seed, (stream << 20) ^ y as u64);
            for value in row {
                // What is brighter than white keeps its range: a photo would clip there, a layer must not.
                let coded = srgb_from_linear(value.max(0.0));
                let noise = self.at(coded) * gaussian(&mut rng);
                let noisy = (coded + noise).max(0.0);
                *value = if coded > 1.0 { value.max(0.0) } else { linear_from_srgb(noisy) };
            }
        });
    }
}

/// Box and Muller.
fn gaussian(rng: &mut Rng) -> f32 {
    let (u, v) = (rng.uniform(), rng.uniform());
    (-2.0 * (1.0 - u).max(1e-12).ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}

/// Bin and residual variance of every block of a photo that is not clipped.
fn blocks(photo: &Image) -> Vec<(usize, f64)> {
    let (w, h, n) = (photo.width, photo.height, photo.channels.min(3));
    let mut out = Vec::new();
    let coded: Vec<f32> = photo.data.iter().map(|&v| srgb_from_linear(v.clamp(0.0, 1.0))).collect();
    let value = |x: usize, y: usize, c: usize| f64::from(coded[(y * w + x) * photo.channels + c]);
    for by in 0..h.saturating_sub(2) / BLOCK {
        for bx in 0..w.saturating_sub(2) / BLOCK {
            for c in 0..n {
                let (mut mean, mut square) = (0.0, 0.0);
                let mut whole = true;
                for y in by * BLOCK + 1..=(by + 1) * BLOCK {
                    for x in bx * BLOCK + 1..=(bx + 1) * BLOCK {
                        let at = value(x, y, c);
                        whole &= at > f64::from(CLIPPED.0) && at < f64::from(CLIPPED.1);
                        mean += at;
                        let line = |y: usize| value(x - 1, y, c) - 2.0 * value(x, y, c) + value(x + 1, y, c);
                        let residual = (line(y - 1) - 2.0 * line(y) + line(y + 1)) / 6.0;
                        square += residual * residual;
                    }
                }
                let count = (BLOCK * BLOCK) as f64;
                if whole {
                    let bin = ((mean / count * BINS as f64) as usize).min(BINS - 1);
                    out.push((bin, square / count));
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall from dark to bright with stripes over a third of it.
    fn picture() -> Image {
        let mut image = Image::zeros(256, 192, 3);
        for y in 0..192 {
            for x in 0..256 {
                let stripe = if y % 64 < 20 && (x / 3) % 2 == 0 { 0.2 } else { 0.0 };
                let coded = 0.1 + 0.6 * x as f32 / 256.0 + stripe;
                image.pixel_mut(x, y).copy_from_slice(&[
                    linear_from_srgb(coded),
                    linear_from_srgb(0.9 * coded),
                    0.2,
                ]);
            }
        }
        image
    }

    /// Goal: noise that grows with brightness is found again to a tenth, texture beside it or not; what is added by the estimate is found
    /// once more; and a picture without noise has none, stripes or not.
    #[test]
    fn noise_is_found_again() {
        let truth = Noise { sigma: std::array::from_fn(|k| 0.01 + 0.02 * (k as f32 + 0.5) / 8.0) };
        let photos: Vec<Image> = (0..4)
            .map(|k| {
                let mut photo = picture();
                truth.add(&mut photo, 7, k);
                photo
            })
            .collect();
        let found = Noise::estimate(&photos).unwrap();
        for v in [0.2, 0.35, 0.5, 0.65] {
            let (got, expected) = (found.at(v), truth.at(v));
            assert!((got / expected - 1.0).abs() < 0.1, "at {v}: {got}, added {expected}");
        }
        let mut again = picture();
        found.add(&mut again, 1, 0);
        let second = Noise::estimate(&[again]).unwrap();
        assert!((second.at(0.4) / found.at(0.4) - 1.0).abs() < 0.15, "{} {}", second.at(0.4), found.at(0.4));
        assert_eq!(Noise::estimate(&[picture()]), None);
        assert_eq!(Noise::estimate(&[]), None);
    }

    /// Goal: noise has no bias beyond that of the clipping at black, the same seed the same noise, another stream another, and values above white are
    /// left alone.
    #[test]
    fn noise_is_even_and_repeatable() {
        let noise = Noise { sigma: [0.02; BINS] };
        let plain = Image::filled(64, 64, 3, linear_from_srgb(0.5));
        let (mut a, mut b, mut c) = (plain.clone(), plain.clone(), plain);
        noise.add(&mut a, 3, 1);
        noise.add(&mut b, 3, 1);
        noise.add(&mut c, 3, 2);
        assert!(a == b && a != c);
        let coded: Vec<f32> = a.data.iter().map(|&v| srgb_from_linear(v) - 0.5).collect();
        let mean = coded.iter().sum::<f32>() / coded.len() as f32;
        let sigma = (coded.iter().map(|v| v * v).sum::<f32>() / coded.len() as f32).sqrt();
        assert!(mean.abs() < 8e-4 && (sigma / 0.02 - 1.0).abs() < 0.03, "{mean} {sigma}");
        let mut bright = Image::filled(4, 4, 3, 7.0);
        noise.add(&mut bright, 0, 0);
        assert!(bright.data.iter().all(|&v| v == 7.0));
    }
}
