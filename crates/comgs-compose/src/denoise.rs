//! Smoothing of a traced shadow: an edge-avoiding à-trous filter guided by geometry and by the trace's own
//! variance, so that noise goes and shadow edges stay.

use crate::receivers::Receivers;
use crate::shadow::TracedShadow;
use comgs_image::Image;
use rayon::prelude::*;

/// How a traced ratio is smoothed.
#[derive(Clone, Debug, PartialEq)]
pub enum Denoise {
    /// Not at all.
    Off,
    /// Edge-avoiding à-trous wavelets (Dammertz et al. 2010) with the variance guide of SVGF (Schied et al.
    /// 2017).
    Atrous(AtrousConfig),
}

impl Default for Denoise {
    fn default() -> Self {
        Self::Atrous(AtrousConfig::default())
    }
}

/// Knobs of [`Denoise::Atrous`].
#[derive(Clone, Debug, PartialEq)]
pub struct AtrousConfig {
    /// Number of passes; pass `k` steps by 2ᵏ pixels, so three passes reach 14 pixels.
    pub passes: u32,
    /// Distance from the receiver's tangent plane that is still the same surface, in units of the spacing of
    /// neighbouring receivers.
    pub plane_sigma: f32,
    /// Exponent of the cosine between normals.
    pub normal_power: f32,
    /// Difference of ratios that is still noise, in standard deviations.
    pub value_sigma: f32,
}

impl Default for AtrousConfig {
    fn default() -> Self {
        Self { passes: 3, plane_sigma: 1.0, normal_power: 16.0, value_sigma: 3.0 }
    }
}

/// Binomial kernel of the à-trous wavelet.
const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

/// Smooths a traced ratio.
///
/// Weights are symmetric products of the kernel, the distance from the tangent plane, the angle between normals
/// and the difference of ratios against their standard deviation. A pixel without variance whose neighbours agree
/// with it stays exactly what it is, so unshadowed surroundings remain exactly 1. Values stay within the range of
/// their neighbourhood. Deterministic.
#[must_use]
pub fn denoise(shadow: &TracedShadow, receivers: &Receivers, method: &Denoise) -> Image {
    let Denoise::Atrous(config) = method else { return shadow.ratio.clone() };
    let mut ratio = shadow.ratio.clone();
    let mut variance = shadow.variance.clone();
    for pass in 0..config.passes {
        (ratio, variance) = atrous_pass(&ratio, &variance, receivers, config, 1 << pass);
    }
    ratio
}

fn atrous_pass(
    ratio: &Image,
    variance: &Image,
    receivers: &Receivers,
    config: &AtrousConfig,
    step: i64,
) -> (Image, Image) {
    let width = ratio.width;
    let local = local_variance(variance, receivers);
    let mut out = ratio.clone();
    let mut out_variance = variance.clone();
    out.data
        .par_chunks_exact_mut(width * 3)
        .zip(out_variance.data.par_chunks_exact_mut(width))
        .enumerate()
        .for_each(|(y, (row, row_variance))| {
            for x in 0..width {
                let i = y * width + x;
                if !receivers.is_surface(i) {
                    continue;
                }
                let (sum, squares, total) = gather(ratio, variance, &local, receivers, config, step, x, y);
                if let Some(mean) = sum {
                    row[x * 3..x * 3 + 3].copy_from_slice(&mean);
                    row_variance[x] = squares / (total * total);
                }
            }
        });
    (out, out_variance)
}

/// Weighted mean of the neighbourhood (`None` when every neighbour equals the centre), `Σ w² var` and `Σ w`.
fn gather(
    ratio: &Image,
    variance: &Image,
    local: &[f32],
    receivers: &Receivers,
    config: &AtrousConfig,
    step: i64,
    x: usize,
    y: usize,
) -> (Option<[f32; 3]>, f32, f32) {
    let (width, height) = (ratio.width, ratio.height);
    let i = y * width + x;
    let (point, normal) = (receivers.points[i], receivers.normals[i]);
    let centre: [f32; 3] = ratio.pixel(x, y).try_into().unwrap_or([1.0; 3]);
    let mut mean = [0.0f32; 3];
    let (mut total, mut squares) = (0.0f32, 0.0f32);
    let mut differs = false;
    for (dy, ky) in (-2i64..=2).zip(KERNEL) {
        for (dx, kx) in (-2i64..=2).zip(KERNEL) {
            let (qx, qy) = (x as i64 + dx * step, y as i64 + dy * step);
            if qx < 0 || qy < 0 || qx >= width as i64 || qy >= height as i64 {
                continue;
            }
            let (qx, qy) = (qx as usize, qy as usize);
            let j = qy * width + qx;
            if !receivers.is_surface(j) {
                continue;
            }
            let value = ratio.pixel(qx, qy);
            let mut w = kx * ky;
            if j != i {
                let offset = receivers.points[j] - point;
                let spacing = offset.length().max(1e-12);
                // Out of plane relative to the distance: scale-free, and a flat floor seen at a grazing angle is
                // still flat.
                let plane = normal.dot(offset).abs() / (config.plane_sigma * spacing);
                let cosine = normal.dot(receivers.normals[j]).max(0.0);
                let difference = (0..3).map(|c| (value[c] - centre[c]).abs()).fold(0.0f32, f32::max);
                let sigma = config.value_sigma * (local[i].max(local[j]).sqrt() + 1e-4);
                w *= (-4.0 * plane * plane).exp()
                    * cosine.powf(config.normal_power)
                    * (-difference / sigma).exp();
            }
            differs |= value != centre;
            for c in 0..3 {
                mean[c] += w * value[c];
            }
            total += w;
            squares += w * w * variance.pixel(qx, qy)[0];
        }
    }
    if differs && total > 0.0 {
        (Some(mean.map(|v| (v / total).min(1.0))), squares, total)
    } else {
        (None, 0.0, 1.0)
    }
}

/// Mean variance over 3×3 receivers: a single pixel's own estimate is itself noisy.
fn local_variance(variance: &Image, receivers: &Receivers) -> Vec<f32> {
    let (width, height) = (variance.width, variance.height);
    (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let (mut sum, mut count) = (0.0f32, 0.0f32);
            for qy in y.saturating_sub(1)..(y + 2).min(height) {
                for qx in x.saturating_sub(1)..(x + 2).min(width) {
                    if receivers.is_surface(qy * width + qx) {
                        sum += variance.pixel(qx, qy)[0];
                        count += 1.0;
                    }
                }
            }
            if count > 0.0 { sum / count } else { 0.0 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;
    use glam::Vec3;

    fn flat(width: usize, height: usize) -> Receivers {
        let points =
            (0..width * height).map(|i| Vec3::new((i % width) as f32, (i / width) as f32, 0.0)).collect();
        Receivers { width, height, points, normals: vec![Vec3::Z; width * height] }
    }

    fn noisy_step(width: usize, height: usize, sigma: f32) -> TracedShadow {
        let mut rng = Rng::new(5);
        let mut ratio = Image::filled(width, height, 3, 1.0);
        for y in 0..height {
            for x in 0..width {
                let mean = if x < width / 2 { 0.3 } else { 0.9 };
                let v = mean + sigma * rng.normal();
                ratio.pixel_mut(x, y).fill(v.clamp(0.0, 1.0));
            }
        }
        TracedShadow { ratio, variance: Image::filled(width, height, 1, sigma * sigma), rays_traced: 0 }
    }

    /// Goal: noise on a flat floor falls to less than a third while a shadow edge keeps its contrast.
    #[test]
    fn noise_goes_and_edges_stay() {
        let shadow = noisy_step(48, 32, 0.04);
        let out = denoise(&shadow, &flat(48, 32), &Denoise::default());
        let error = |image: &Image, range: std::ops::Range<usize>, mean: f32| {
            let mut sum = 0.0;
            for y in 8..24 {
                for x in range.clone() {
                    sum += (image.pixel(x, y)[0] - mean).powi(2);
                }
            }
            (sum / (16.0 * range.len() as f32)).sqrt()
        };
        assert!(error(&out, 4..20, 0.3) < error(&shadow.ratio, 4..20, 0.3) / 3.0);
        // The two columns at the edge keep their sides.
        assert!(error(&out, 23..24, 0.3) < 0.03 && error(&out, 24..25, 0.9) < 0.03);
    }

    /// Goal: surroundings that are exactly 1 stay exactly 1, and surfaces at an angle do not mix.
    #[test]
    fn exact_ones_and_corners() {
        let mut shadow = noisy_step(20, 20, 0.0);
        shadow.ratio = Image::filled(20, 20, 3, 1.0);
        assert_eq!(denoise(&shadow, &flat(20, 20), &Denoise::default()).data, shadow.ratio.data);

        let mut corner = flat(20, 20);
        let mut shadow = noisy_step(20, 20, 0.0);
        shadow.variance = Image::filled(20, 20, 1, 1.0);
        for i in 0..400 {
            if i % 20 >= 10 {
                corner.normals[i] = Vec3::X;
            }
        }
        let out = denoise(&shadow, &corner, &Denoise::default());
        assert!((out.pixel(9, 10)[0] - 0.3).abs() < 1e-5 && (out.pixel(10, 10)[0] - 0.9).abs() < 1e-5);
        assert_eq!(denoise(&shadow, &corner, &Denoise::Off), shadow.ratio);
    }
}
