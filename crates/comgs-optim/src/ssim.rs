//! Structural similarity (Wang et al. 2004) with its gradient, fast enough to be in a training loop.

use fearless_simd::{Level, Simd, dispatch};
use rayon::prelude::*;

/// Width of the Gaussian window (σ = 1.5).
pub const WINDOW: usize = 11;
const HALF: usize = WINDOW / 2;
/// (0.01)² and (0.03)², for values in [0, 1].
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

fn weights() -> [f32; WINDOW] {
    let mut w: [f32; WINDOW] = std::array::from_fn(|i| {
        let d = i as f32 - HALF as f32;
        (-d * d / (2.0 * 1.5 * 1.5)).exp()
    });
    let sum: f32 = w.iter().sum();
    w.iter_mut().for_each(|v| *v /= sum);
    w
}

/// Mean SSIM of one channel and, in `gradient`, the derivative of that mean with respect to `x`.
///
/// * `x`, `y`: row-major planes of `width × height` values, nominally in [0, 1]
/// * the window is zero-padded at the border, as splatting trainers do (so that borders count a little less)
///
/// Differentiable everywhere. Reference: the tests' direct sums in f64.
pub fn ssim_plane(x: &[f32], y: &[f32], width: usize, height: usize, gradient: &mut [f32]) -> f32 {
    let n = width * height;
    if n == 0 {
        return 1.0;
    }
    let level = Level::new();
    let w = weights();
    let product = |a: &[f32], b: &[f32]| -> Vec<f32> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let blur = |image: &[f32]| blurred(level, image, width, height, &w);
    let (mu_x, mu_y) = (blur(x), blur(y));
    let (xx, yy, xy) = (blur(&product(x, x)), blur(&product(y, y)), blur(&product(x, y)));
    let mut d_mean = vec![0.0f32; n];
    let mut d_square = vec![0.0f32; n];
    let mut d_cross = vec![0.0f32; n];
    let mut sum = 0.0f64;
    for i in 0..n {
        let (mx, my) = (mu_x[i], mu_y[i]);
        let a1 = 2.0 * mx * my + C1;
        let a2 = 2.0 * (xy[i] - mx * my) + C2;
        let b1 = mx * mx + my * my + C1;
        let b2 = (xx[i] - mx * mx) + (yy[i] - my * my) + C2;
        let inverse = 1.0 / (b1 * b2);
        let s = a1 * a2 * inverse;
        sum += f64::from(s);
        let by_square = -s / b2;
        let by_cross = 2.0 * a1 * inverse;
        d_square[i] = by_square;
        d_cross[i] = by_cross;
        d_mean[i] = 2.0 * my * a2 * inverse - 2.0 * mx * s / b1 - 2.0 * mx * by_square - my * by_cross;
    }
    // The window is symmetric, so the adjoint of the blur is the blur.
    let (d_mean, d_square, d_cross) = (blur(&d_mean), blur(&d_square), blur(&d_cross));
    let scale = 1.0 / n as f32;
    for i in 0..n {
        gradient[i] = scale * (d_mean[i] + 2.0 * x[i] * d_square[i] + y[i] * d_cross[i]);
    }
    (sum / n as f64) as f32
}

/// Separable Gaussian blur with zero padding.
fn blurred(level: Level, image: &[f32], width: usize, height: usize, w: &[f32; WINDOW]) -> Vec<f32> {
    let mut out = vec![0.0f32; image.len()];
    // Bands of rows; each blurs the rows it needs horizontally first (HALF extra above and below).
    const BAND: usize = 48;
    out.par_chunks_mut(BAND * width).enumerate().for_each(|(band, out)| {
        let first = band * BAND;
        let rows = out.len() / width;
        let low = first.saturating_sub(HALF);
        let high = (first + rows + HALF).min(height);
        let source = &image[low * width..high * width];
        dispatch!(level, simd => blur_band(simd, source, width, first - low, rows, w, out));
    });
    out
}

#[inline(always)]
fn blur_band<S: Simd>(
    _simd: S,
    source: &[f32],
    width: usize,
    skip: usize,
    rows: usize,
    w: &[f32; WINDOW],
    out: &mut [f32],
) {
    let available = source.len() / width;
    let mut horizontal = vec![0.0f32; source.len()];
    let mut padded = vec![0.0f32; width + 2 * HALF];
    for (row, target) in source.chunks_exact(width).zip(horizontal.chunks_exact_mut(width)) {
        padded[HALF..HALF + width].copy_from_slice(row);
        for (x, t) in target.iter_mut().enumerate() {
            let taps: &[f32; WINDOW] = padded[x..x + WINDOW].try_into().expect("window");
            let mut sum = 0.0;
            for k in 0..WINDOW {
                sum += w[k] * taps[k];
            }
            *t = sum;
        }
    }
    for y in 0..rows {
        let target = &mut out[y * width..(y + 1) * width];
        target.fill(0.0);
        for k in 0..WINDOW {
            // Row y of the band is row y + skip of the source; tap k reads row y + skip + k − HALF.
            let Some(r) = (y + skip + k).checked_sub(HALF).filter(|r| *r < available) else { continue };
            let row = &horizontal[r * width..(r + 1) * width];
            for (t, s) in target.iter_mut().zip(row) {
                *t += w[k] * s;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;

    /// Mean SSIM by direct sums in f64, the definition.
    fn reference(x: &[f64], y: &[f64], width: usize, height: usize) -> f64 {
        let half = HALF as isize;
        let g = |d: isize| (-(d * d) as f64 / 4.5).exp();
        let norm: f64 = (-half..=half).map(g).sum();
        let mut total = 0.0;
        for row in 0..height as isize {
            for column in 0..width as isize {
                let mut m = [0.0f64; 5];
                for dy in -half..=half {
                    for dx in -half..=half {
                        let (r, c) = (row + dy, column + dx);
                        if r < 0 || c < 0 || r >= height as isize || c >= width as isize {
                            continue;
                        }
                        let w = g(dx) * g(dy) / (norm * norm);
                        let (a, b) = (x[r as usize * width + c as usize], y[r as usize * width + c as usize]);
                        for (m, v) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                            *m += w * v;
                        }
                    }
                }
                let [mx, my, xx, yy, xy] = m;
                total += (2.0 * mx * my + 1e-4) * (2.0 * (xy - mx * my) + 9e-4)
                    / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
            }
        }
        total / (width * height) as f64
    }

    /// Goal: value and every gradient entry match the f64 definition and its central differences, also on an image smaller
    /// than the window and across band borders.
    #[test]
    fn value_and_gradient_against_the_definition() {
        for (width, height) in [(23, 17), (5, 4), (3, 61)] {
            let mut rng = Rng::new(4);
            let x: Vec<f32> = (0..width * height).map(|_| rng.uniform()).collect();
            let y: Vec<f32> = x.iter().map(|v| (v * 0.7 + 0.3 * rng.uniform()).min(1.0)).collect();
            let mut gradient = vec![0.0; x.len()];
            let value = ssim_plane(&x, &y, width, height, &mut gradient);
            let wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
            let (mut a, b) = (wide(&x), wide(&y));
            assert!((f64::from(value) - reference(&a, &b, width, height)).abs() < 1e-5);
            for i in (0..x.len()).step_by(7) {
                let h = 1e-5;
                let original = a[i];
                a[i] = original + h;
                let plus = reference(&a, &b, width, height);
                a[i] = original - h;
                let minus = reference(&a, &b, width, height);
                a[i] = original;
                let numeric = (plus - minus) / (2.0 * h);
                assert!(
                    (numeric - f64::from(gradient[i])).abs() < 2e-3 * numeric.abs().max(1e-3),
                    "{i}: {numeric} {}",
                    gradient[i]
                );
            }
        }
    }

    /// Goal: identical images have similarity 1 and gradient 0.
    #[test]
    fn identity() {
        let x: Vec<f32> = (0..20 * 20).map(|i| (i % 7) as f32 / 7.0).collect();
        let mut gradient = vec![1.0; 400];
        assert!((ssim_plane(&x, &x, 20, 20, &mut gradient) - 1.0).abs() < 1e-5);
        assert!(gradient.iter().all(|g| g.abs() < 1e-6));
    }
}
