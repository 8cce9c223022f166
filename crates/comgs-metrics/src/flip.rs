//! ꟻLIP for low-dynamic-range images: the difference that a viewer notices when flipping between two pictures.
//!
//! Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild: "ꟻLIP: A Difference Evaluator for
//! Alternating Images", HPG 2020. Section numbers below are of that paper. Written from the paper in f64,
//! because the only crate is a binding that needs a C++ compiler; the tests hold it to figures of
//! the authors' own tool.

use crate::{Map, MetricError, check};
use comgs_image::Image;
use serde::Serialize;

/// How the pictures are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FlipConfig {
    /// Pixels per degree of visual angle, > 0.
    pub pixels_per_degree: f64,
}

impl Default for FlipConfig {
    /// The paper's default: a 0.7 m wide monitor of 3840 pixels seen from 0.7 m, 67.02 pixels per degree.
    fn default() -> Self {
        Self::viewing(0.7, 0.7, 3840.0)
    }
}

impl FlipConfig {
    /// From the viewing distance and monitor width in metres and the monitor's width in pixels (Eq. 2).
    #[must_use]
    pub fn viewing(distance_m: f64, monitor_width_m: f64, monitor_width_px: f64) -> Self {
        Self {
            pixels_per_degree: distance_m * (monitor_width_px / monitor_width_m) * std::f64::consts::PI
                / 180.0,
        }
    }

    /// # Errors
    /// When the value is not a positive number, or so large (a filter over 1000 pixels) that it is surely wrong.
    pub fn check(&self) -> Result<(), MetricError> {
        if self.pixels_per_degree > 0.0 && self.pixels_per_degree <= 5000.0 {
            return Ok(());
        }
        Err(MetricError::Parameter {
            parameter: "pixels_per_degree",
            expected: "a number above 0 and at most 5000",
            got: self.pixels_per_degree,
        })
    }
}

// Constants of the paper, sections 4.1.3 and 4.2.
const Q_C: f64 = 0.7;
const P_C: f64 = 0.4;
const P_T: f64 = 0.95;
const W: f64 = 0.082;
const Q_F: f64 = 0.5;

/// CSF parameters (a₁, b₁, a₂, b₂) of the achromatic, red-green and blue-yellow channels (Table 1).
const CSF: [[f64; 4]; 3] = [[1.0, 0.0047, 0.0, 1e-5], [1.0, 0.0053, 0.0, 1e-5], [34.1, 0.04, 13.5, 0.025]];

/// ꟻLIP error of every pixel in [0, 1] (0 = no visible difference). Input is linear radiance, clipped to [0, 1];
/// grey images count as grey RGB. Symmetric in the two images.
///
/// # Errors
/// [`MetricError`] on different shapes, non-finite samples or a bad configuration.
pub fn flip(image: &Image, truth: &Image, config: &FlipConfig) -> Result<Map, MetricError> {
    check::colors(image, truth, "ꟻLIP")?;
    config.check()?;
    let (width, height) = (truth.width, truth.height);
    let a = Opponent::of(image);
    let b = Opponent::of(truth);
    let color = color_difference(&a, &b, width, height, config.pixels_per_degree);
    let feature = feature_difference(&a.0[0], &b.0[0], width, height, config.pixels_per_degree);
    // Eq. 16.
    let values = color.iter().zip(&feature).map(|(c, f)| c.powf(1.0 - f)).collect();
    Ok(Map { width, height, values })
}

/// The YCxCz opponent space (section 4.1.1): CIELAB without its non-linearity, so that filtering is linear.
struct Opponent([Vec<f64>; 3]);

impl Opponent {
    fn of(image: &Image) -> Self {
        let mut planes: [Vec<f64>; 3] = Default::default();
        for i in 0..image.pixels() {
            let rgb = crate::color::rgb(image, i).map(|v| v.clamp(0.0, 1.0));
            let [x, y, z] = relative_xyz(rgb);
            planes[0].push(116.0 * y - 16.0);
            planes[1].push(500.0 * (x - y));
            planes[2].push(200.0 * (y - z));
        }
        Self(planes)
    }
}

/// sRGB primaries to XYZ (D65), as exact rationals of the primaries' definition.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];

/// XYZ relative to the white point (white is 1, 1, 1).
fn relative_xyz(rgb: [f64; 3]) -> [f64; 3] {
    XYZ_FROM_RGB.map(|row| (row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2]) / (row[0] + row[1] + row[2]))
}

/// Inverse of [`relative_xyz`], by Cramer's rule.
fn rgb_from_relative_xyz(xyz: [f64; 3]) -> [f64; 3] {
    let m = XYZ_FROM_RGB.map(|row| {
        let white: f64 = row.iter().sum();
        row.map(|v| v / white)
    });
    let det = |c: [[f64; 3]; 3]| {
        c[0][0] * (c[1][1] * c[2][2] - c[1][2] * c[2][1]) - c[0][1] * (c[1][0] * c[2][2] - c[1][2] * c[2][0])
            + c[0][2] * (c[1][0] * c[2][1] - c[1][1] * c[2][0])
    };
    let d = det(m);
    std::array::from_fn(|k| {
        let mut replaced = m;
        for row in 0..3 {
            replaced[row][k] = xyz[row];
        }
        det(replaced) / d
    })
}

/// CIELAB of linear RGB in [0, 1].
fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let delta: f64 = 6.0 / 29.0;
    let f = |t: f64| {
        if t > delta.powi(3) { t.cbrt() } else { t / (3.0 * delta * delta) + 4.0 / 29.0 }
    };
    let [x, y, z] = relative_xyz(rgb).map(f);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Hunt adjustment: colourfulness grows with luminance (section 4.1.2).
fn hunt([l, a, b]: [f64; 3]) -> [f64; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// The HyAB distance (Abasi et al. 2020).
fn hyab(p: [f64; 3], q: [f64; 3]) -> f64 {
    (p[0] - q[0]).abs() + ((p[1] - q[1]).powi(2) + (p[2] - q[2]).powi(2)).sqrt()
}

/// The colour pipeline (section 4.1): contrast-sensitivity filter, Hunt-adjusted HyAB distance, redistribution.
fn color_difference(a: &Opponent, b: &Opponent, width: usize, height: usize, ppd: f64) -> Vec<f64> {
    let a = filtered_lab(a, width, height, ppd);
    let b = filtered_lab(b, width, height, ppd);
    let (green, blue) = (hunt(lab([0.0, 1.0, 0.0])), hunt(lab([0.0, 0.0, 1.0])));
    let maximum = hyab(green, blue).powf(Q_C);
    let limit = P_C * maximum;
    a.iter()
        .zip(&b)
        .map(|(&p, &q)| {
            let d = hyab(p, q).powf(Q_C);
            // Eq. 8: differences up to 0.4 of the largest take [0, 0.95], the rest is compressed above.
            let e =
                if d < limit { P_T / limit * d } else { P_T + (d - limit) / (maximum - limit) * (1.0 - P_T) };
            e.clamp(0.0, 1.0)
        })
        .collect()
}

fn filtered_lab(opponent: &Opponent, width: usize, height: usize, ppd: f64) -> Vec<[f64; 3]> {
    use std::f64::consts::PI;
    let widest = CSF.iter().flat_map(|c| [c[1], c[3]]).fold(0.0, f64::max);
    let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * ppd).ceil() as usize;
    let planes: Vec<Vec<f64>> = CSF
        .iter()
        .zip(&opponent.0)
        .map(|(&[a1, b1, a2, b2], plane)| {
            // Each Gaussian of the sum separates; the sum is normalised as a whole (Eq. 4, 5).
            let gaussian = |b: f64| -> Vec<f64> {
                (0..=2 * radius)
                    .map(|i| {
                        let d = (i as f64 - radius as f64) / ppd;
                        (-PI * PI * d * d / b).exp()
                    })
                    .collect()
            };
            let parts: Vec<(f64, Vec<f64>)> = [(a1, b1), (a2, b2)]
                .into_iter()
                .filter(|&(a, _)| a != 0.0)
                .map(|(a, b)| (a * (PI / b).sqrt(), gaussian(b)))
                .collect();
            let total: f64 = parts.iter().map(|(k, g)| k * g.iter().sum::<f64>().powi(2)).sum();
            let mut out = vec![0.0; plane.len()];
            for (k, taps) in &parts {
                for (o, v) in out.iter_mut().zip(separable(plane, width, height, taps, taps)) {
                    *o += k / total * v;
                }
            }
            out
        })
        .collect();
    (0..width * height)
        .map(|i| {
            let y = (planes[0][i] + 16.0) / 116.0;
            let (x, z) = (y + planes[1][i] / 500.0, y - planes[2][i] / 200.0);
            hunt(lab(rgb_from_relative_xyz([x, y, z]).map(|v| v.clamp(0.0, 1.0))))
        })
        .collect()
}

/// The feature pipeline (section 4.2): the difference of edge and point content of the achromatic channel.
fn feature_difference(a: &[f64], b: &[f64], width: usize, height: usize, ppd: f64) -> Vec<f64> {
    let sigma = 0.5 * W * ppd;
    let radius = (3.0 * sigma).ceil() as usize;
    let offset = |i: usize| i as f64 - radius as f64;
    let gaussian: Vec<f64> =
        (0..=2 * radius).map(|i| (-offset(i).powi(2) / (2.0 * sigma * sigma)).exp()).collect();
    let sum: f64 = gaussian.iter().sum();
    let smooth: Vec<f64> = gaussian.iter().map(|g| g / sum).collect();
    // Positive weights sum to 1 and negative ones to −1.
    let balanced = |mut taps: Vec<f64>| {
        let positive: f64 = taps.iter().filter(|t| **t > 0.0).sum();
        let negative: f64 = -taps.iter().filter(|t| **t < 0.0).sum::<f64>();
        for t in &mut taps {
            *t /= if *t > 0.0 { positive } else { negative };
        }
        taps
    };
    let edge = balanced(gaussian.iter().enumerate().map(|(i, g)| -offset(i) * g).collect());
    let point = balanced(
        gaussian.iter().enumerate().map(|(i, g)| (offset(i).powi(2) / (sigma * sigma) - 1.0) * g).collect(),
    );
    let content = |plane: &[f64], taps: &[f64]| -> Vec<f64> {
        let normalised: Vec<f64> = plane.iter().map(|y| (y + 16.0) / 116.0).collect();
        let x = separable(&normalised, width, height, taps, &smooth);
        let y = separable(&normalised, width, height, &smooth, taps);
        x.iter().zip(&y).map(|(x, y)| x.hypot(*y)).collect()
    };
    let (edge_a, edge_b) = (content(a, &edge), content(b, &edge));
    let (point_a, point_b) = (content(a, &point), content(b, &point));
    (0..a.len())
        .map(|i| {
            // Eq. 15.
            let d = (edge_a[i] - edge_b[i]).abs().max((point_a[i] - point_b[i]).abs());
            (d / 2f64.sqrt()).powf(Q_F).min(1.0)
        })
        .collect()
}

/// Correlation with `horizontal ⊗ vertical`, the border pixels repeated outwards.
fn separable(plane: &[f64], width: usize, height: usize, horizontal: &[f64], vertical: &[f64]) -> Vec<f64> {
    let radius = horizontal.len() / 2;
    let inside = |i: usize, length: usize| i.saturating_sub(radius).min(length - 1);
    let mut rows = vec![0.0; plane.len()];
    for y in 0..height {
        let line = &plane[y * width..(y + 1) * width];
        for x in 0..width {
            rows[y * width + x] =
                horizontal.iter().enumerate().map(|(k, t)| t * line[inside(x + k, width)]).sum();
        }
    }
    let mut out = vec![0.0; plane.len()];
    for y in 0..height {
        for (k, t) in vertical.iter().enumerate() {
            let source = &rows[inside(y + k, height) * width..][..width];
            for (o, v) in out[y * width..(y + 1) * width].iter_mut().zip(source) {
                *o += t * v;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pair of pictures on a closed formula, so that the authors' tool could be given the same ones.
    fn picture(k: f64) -> Image {
        let mut image = Image::zeros(40, 30, 3);
        for yi in 0..30usize {
            for xi in 0..40usize {
                let (x, y) = (xi as f64, yi as f64);
                let r = 0.5 + 0.45 * (0.31 * x + 0.17 * y + 0.3 * k).sin();
                let g = 0.5 + 0.45 * (0.23 * x - 0.41 * y).cos() * (1.0 - 0.2 * k);
                let b = 0.5 + 0.45 * (0.11 * x * (1.0 + 0.1 * k) + 0.29 * y + 1.0).sin();
                let patch = k > 0.0 && (8..14).contains(&yi) && (10..20).contains(&xi);
                let rgb = if patch { [0.9, 0.1, 0.2] } else { [r, g, b] };
                image.pixel_mut(xi, yi).copy_from_slice(&rgb.map(|v| v as f32));
            }
        }
        image
    }

    /// Goal: figures of the authors' own tool (flip-evaluator 1.7, LDR, default viewing) on the same pair of
    /// pictures, mean and single pixels, corners included. That tool works in f32, hence the tolerance.
    #[test]
    fn matches_the_authors_tool() {
        const TOLERANCE: f64 = 2e-5;
        let map = flip(&picture(1.0), &picture(0.0), &FlipConfig::default()).unwrap();
        let (mean, _) = map.mean(None).unwrap();
        assert!((mean - 0.403_570_294).abs() < TOLERANCE, "{mean}");
        for ((x, y), expected) in [
            ((0, 0), 0.383_201_96),
            ((15, 10), 0.976_610_4),
            ((20, 11), 0.748_283_27),
            ((39, 29), 0.446_269_3),
            ((5, 20), 0.321_336_3),
            ((10, 8), 0.950_912_24),
        ] {
            let got = map.values[y * 40 + x];
            assert!((got - expected).abs() < TOLERANCE, "({x}, {y}): {got} instead of {expected}");
        }
    }

    /// Goal: 0 for equal images, 1 for green against blue (the paper's largest difference), 0.9674 for black
    /// against white (the authors' tool), whatever the size.
    #[test]
    fn known_extremes() {
        let plain = |rgb: [f32; 3], n: usize| Image::from_data(n, n, 3, rgb.repeat(n * n));
        let config = FlipConfig::default();
        for n in [1, 12] {
            let mean = |a, b| flip(&plain(a, n), &plain(b, n), &config).unwrap().mean(None).unwrap().0;
            assert_eq!(mean([0.3, 0.6, 0.1], [0.3, 0.6, 0.1]), 0.0);
            assert!((mean([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]) - 1.0).abs() < 1e-9);
            assert!((mean([0.0; 3], [1.0; 3]) - 0.967_396_86).abs() < 2e-5);
        }
    }

    /// Goal: symmetric, and growing with the amount of noise.
    #[test]
    fn symmetric_and_monotone() {
        let truth = picture(0.0);
        let config = FlipConfig::default();
        let mut last = 0.0;
        for amplitude in [0.02f32, 0.05, 0.15, 0.4] {
            let mut noisy = truth.clone();
            for (i, v) in noisy.data.iter_mut().enumerate() {
                *v += amplitude * (i as f32 * 12.9898).sin();
            }
            let ab = flip(&noisy, &truth, &config).unwrap().mean(None).unwrap().0;
            let ba = flip(&truth, &noisy, &config).unwrap().mean(None).unwrap().0;
            assert!((ab - ba).abs() < 1e-12 && ab > last && ab <= 1.0);
            last = ab;
        }
    }

    /// Goal: the conversion to XYZ inverts itself; the viewing default is the paper's 67.02.
    #[test]
    fn conversions() {
        for rgb in [[0.2, 0.7, 0.1], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]] {
            let back = rgb_from_relative_xyz(relative_xyz(rgb));
            assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        assert!((FlipConfig::default().pixels_per_degree - 67.020_643).abs() < 1e-5);
        assert!(FlipConfig { pixels_per_degree: f64::NAN }.check().is_err());
    }
}
