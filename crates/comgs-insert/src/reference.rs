//! The crate's formulas again, in scalar f64 and as they are written in the paper; compiled for tests.

use std::f64::consts::PI;

/// DiPIR Eq. 2–3: planar radiance of a sum of lobes given by seven numbers each (see [`crate::light::Gaussians`]).
pub fn rasterise(parameters: &[f64], height: usize) -> Vec<f64> {
    let width = 2 * height;
    let mut out = vec![0.0; 3 * width * height];
    let least = 0.5 * PI / height as f64;
    for row in 0..height {
        for column in 0..width {
            let theta = PI - 2.0 * PI * (column as f64 + 0.5) / width as f64;
            let phi = PI * (row as f64 + 0.5) / height as f64;
            let v = [phi.sin() * theta.cos(), phi.sin() * theta.sin(), phi.cos()];
            for p in parameters.chunks_exact(7) {
                let length = (p[3] * p[3] + p[4] * p[4] + p[5] * p[5]).sqrt();
                let cosine = (v[0] * p[3] + v[1] * p[4] + v[2] * p[5]) / length;
                let sigma = least + p[6].exp();
                let g = (-(1.0 - cosine) / (sigma * sigma)).exp();
                for c in 0..3 {
                    out[c * width * height + row * width + column] += p[c].exp() * g;
                }
            }
        }
    }
    out
}

/// `weight/2 ∫ |∇x|² dω` by differences of neighbouring texels.
pub fn dirichlet(x: &[f64], height: usize, weight: f64) -> f64 {
    let width = 2 * height;
    let mut sum = 0.0;
    for c in 0..3 {
        for row in 0..height {
            for column in 0..width {
                let at = |r: usize, k: usize| x[c * width * height + r * width + k % width];
                let across = at(row, column) - at(row, column + 1);
                sum += across * across / (PI * (row as f64 + 0.5) / height as f64).sin();
                if row + 1 < height {
                    let down = at(row, column) - at(row + 1, column);
                    sum += down * down * (PI * (row as f64 + 1.0) / height as f64).sin();
                }
            }
        }
    }
    0.5 * weight * sum
}

/// Compares a gradient with central differences of `loss` in f64; it must not be zero everywhere.
///
/// # Panics
/// Where they differ by more than `tolerance` of the largest entry.
pub fn assert_gradient(x: &[f64], gradient: &[f32], loss: impl Fn(&[f64]) -> f64, tolerance: f64) {
    assert_eq!(x.len(), gradient.len());
    let largest = gradient.iter().map(|g| f64::from(g.abs())).fold(0.0, f64::max);
    assert!(largest > 0.0 && largest.is_finite(), "the gradient is zero or not finite everywhere");
    let mut moved = x.to_vec();
    for i in 0..x.len() {
        let step = 1e-5 * x[i].abs().max(1.0);
        moved[i] = x[i] + step;
        let up = loss(&moved);
        moved[i] = x[i] - step;
        let down = loss(&moved);
        moved[i] = x[i];
        let difference = (up - down) / (2.0 * step);
        assert!(
            (difference - f64::from(gradient[i])).abs() <= tolerance * largest,
            "parameter {i}: {} by the gradient, {difference} by differences (largest {largest})",
            gradient[i]
        );
    }
}

/// The rational-quadratic spline from its 16 parameters (see [`crate::tone::Spline`]).
pub fn spline(p: &[f64], x: f64) -> f64 {
    const K: usize = 5;
    let shares = |raw: &[f64]| -> Vec<f64> {
        let sum: f64 = raw.iter().map(|r| r.exp()).sum();
        raw.iter().map(|r| 0.01 + (1.0 - 0.01 * K as f64) * r.exp() / sum).collect()
    };
    let (widths, heights) = (shares(&p[..K]), shares(&p[K..2 * K]));
    let (mut x0, mut y0) = (0.0, 0.0);
    for k in 0..K {
        let (w, h) = (widths[k], heights[k]);
        if x <= x0 + w || k == K - 1 {
            let (d0, d1, s) = (p[2 * K + k].exp(), p[2 * K + k + 1].exp(), h / w);
            let xi = (x - x0) / w;
            let b = xi * (1.0 - xi);
            return y0 + h * (s * xi * xi + d0 * b) / (s + (d1 + d0 - 2.0 * s) * b);
        }
        x0 += w;
        y0 += h;
    }
    unreachable!()
}

fn luminance(map: &[f64], i: usize) -> f64 {
    let n = map.len() / 3;
    0.2126 * map[i] + 0.7152 * map[n + i] + 0.0722 * map[2 * n + i]
}

/// DiPIR Eq. 12–14 as printed.
pub fn fuse(foreground: &[f64], shadow: &[f64]) -> Vec<f64> {
    let n = foreground.len() / 3;
    let most = (0..n).map(|i| luminance(foreground, i)).fold(0.0, f64::max);
    let mut out = vec![0.0; 3 * n];
    for i in 0..n {
        let (a, b) = (luminance(foreground, i), luminance(shadow, i));
        let r = a / most * (b / (a + b));
        let fused = (1.0 - r) * a + r * b;
        for c in 0..3 {
            out[c * n + i] = foreground[c * n + i] * (fused / a);
        }
    }
    out
}

/// DiPIR Eq. 10 with luminances normalised to integrate to 1.
pub fn consistency(foreground: &[f64], shadow: &[f64], omega: &[f64]) -> f64 {
    let normalised = |map: &[f64]| -> Vec<f64> {
        let sum: f64 = omega.iter().enumerate().map(|(i, w)| luminance(map, i) * w).sum();
        (0..omega.len()).map(|i| luminance(map, i) / sum).collect()
    };
    let (p, q) = (normalised(foreground), normalised(shadow));
    -(0..omega.len()).map(|i| q[i] * p[i].ln() * omega[i]).sum::<f64>()
}

/// A row of a part's radiance from its material (colour, place between roughnesses, metalness, emission) followed by the five
/// lobes (see [`crate::material`]).
pub fn part_row(x: &[f64], share: f64, tint: [f64; 3], metallic: f64, rest: [f64; 3]) -> [f64; 3] {
    let (tau, m, lobes) = (x[3], x[4] * metallic, &x[8..]);
    std::array::from_fn(|c| {
        let a = x[c] * tint[c];
        let f0 = 0.04 * (1.0 - m) + m * a;
        let at = |lobe: usize| lobes[3 * lobe + c];
        let highlight = |low: usize, high: usize| (1.0 - tau) * at(low) + tau * at(high);
        (1.0 - m) * a * at(0) + f0 * highlight(1, 3) + highlight(2, 4) + share * x[5 + c] + rest[c]
    })
}
