//! Completers without learning: what a learned one must beat, and what stands in where no model can run.

use crate::completion::{Completion, complete, over_fill};
use crate::partial::{Completer, Partial, for_known, resized, roll};
use crate::{CompletionError, complete_harmonic};
use comgs_geom::{equirect, sh};
use comgs_image::Image;
use glam::{DVec3, Vec3};

/// The mean of what is known, everywhere.
#[derive(Clone, Copy, Debug, Default)]
pub struct Constant;

impl Completer for Constant {
    fn name(&self) -> String {
        "constant".into()
    }

    fn complete(&self, partial: &Partial, _seed: u64) -> Result<Image, CompletionError> {
        partial.check()?;
        let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
        for_known(partial, |_, w, rgb| {
            sum += w * Vec3::from(rgb).as_dvec3();
            weight += w;
        });
        if weight <= 0.0 {
            return Err(CompletionError::NothingSeen { largest: 0.0 });
        }
        over_fill(partial, &|_, _| sum / weight)
    }
}

/// The smoothest field of log radiance that agrees with what is known: [`complete_harmonic`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Harmonic;

impl Completer for Harmonic {
    fn name(&self) -> String {
        "harmonic".into()
    }

    fn complete(&self, partial: &Partial, _seed: u64) -> Result<Image, CompletionError> {
        partial.check()?;
        complete_harmonic(&partial.rgb, &partial.alpha)
    }
}

/// Black where nothing is known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Nothing;

impl Completer for Nothing {
    fn name(&self) -> String {
        "none".into()
    }

    fn complete(&self, partial: &Partial, _seed: u64) -> Result<Image, CompletionError> {
        partial.check()?;
        complete(&partial.rgb, &partial.alpha, Completion::None)
    }
}

/// Real spherical harmonics up to degree 3, fitted to the known radiance by least squares with a ridge that grows with
/// the degree: minimise `Σ ω (L − Σ cᵢ Yᵢ)² + λ Σ l²(l+1)² cᵢ²`, the smoothness energy of the sphere's Laplacian.
/// Values under zero become zero.
#[derive(Clone, Copy, Debug)]
pub struct SphericalHarmonics {
    /// λ, relative to the known solid angle.
    pub ridge: f64,
}

impl Default for SphericalHarmonics {
    fn default() -> Self {
        Self { ridge: 0.02 }
    }
}

/// Coefficients of degree 3.
const COEFFICIENTS: usize = 16;

impl Completer for SphericalHarmonics {
    fn name(&self) -> String {
        "spherical harmonics".into()
    }

    fn complete(&self, partial: &Partial, _seed: u64) -> Result<Image, CompletionError> {
        partial.check()?;
        let mut normal = [[0.0f64; COEFFICIENTS]; COEFFICIENTS];
        let mut right = [DVec3::ZERO; COEFFICIENTS];
        let mut weight = 0.0;
        for_known(partial, |d, w, rgb| {
            let y = basis(d);
            for i in 0..COEFFICIENTS {
                for j in 0..COEFFICIENTS {
                    normal[i][j] += w * y[i] * y[j];
                }
                right[i] += w * y[i] * Vec3::from(rgb).as_dvec3();
            }
            weight += w;
        });
        if weight <= 0.0 {
            return Err(CompletionError::NothingSeen { largest: 0.0 });
        }
        for (i, row) in normal.iter_mut().enumerate() {
            let degree = (i as f64).sqrt().floor();
            row[i] += self.ridge * weight * (degree * (degree + 1.0)).powi(2) / (4.0 * std::f64::consts::PI)
                + 1e-9 * weight;
        }
        let c = solve_symmetric(normal, right);
        let (width, height) = (partial.rgb.width, partial.rgb.height);
        over_fill(partial, &|x, y| {
            let y = basis(equirect::texel_direction(x, y, width, height));
            (0..COEFFICIENTS).map(|i| c[i] * y[i]).sum::<DVec3>().max(DVec3::ZERO)
        })
    }
}

fn basis(d: Vec3) -> [f64; COEFFICIENTS] {
    let mut out = [0.0; COEFFICIENTS];
    for (o, v) in out.iter_mut().zip(sh::basis(3, d)) {
        *o = f64::from(v);
    }
    out
}

/// Gaussian elimination with pivoting; the ridge keeps the matrix regular.
fn solve_symmetric(
    mut a: [[f64; COEFFICIENTS]; COEFFICIENTS],
    mut b: [DVec3; COEFFICIENTS],
) -> [DVec3; COEFFICIENTS] {
    for k in 0..COEFFICIENTS {
        let pivot = (k..COEFFICIENTS).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap_or(k);
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..COEFFICIENTS {
            let factor = a[i][k] / a[k][k];
            for j in k..COEFFICIENTS {
                a[i][j] -= factor * a[k][j];
            }
            let above = b[k];
            b[i] -= factor * above;
        }
    }
    for k in (0..COEFFICIENTS).rev() {
        for j in k + 1..COEFFICIENTS {
            let known = b[j];
            b[k] -= a[k][j] * known;
        }
        b[k] /= a[k][k];
    }
    b
}

/// The panorama of a bank that fits what is known best, at any of 16 turns and in its mirror image, with one factor a
/// channel fitted in log radiance.
#[derive(Clone, Debug, Default)]
pub struct Bank {
    maps: Vec<Image>,
}

/// Rows of a bank's maps.
const BANK_ROWS: usize = 32;
const BANK_TURNS: usize = 16;

impl Bank {
    /// A bank of panoramas, linear radiance, 3 channels, twice as wide as high.
    #[must_use]
    pub fn new<'a>(maps: impl IntoIterator<Item = &'a Image>) -> Self {
        let small = |m: &Image| {
            resized(m, 2 * BANK_ROWS, BANK_ROWS).map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 })
        };
        Self { maps: maps.into_iter().map(small).collect() }
    }
}

impl Completer for Bank {
    fn name(&self) -> String {
        format!("nearest of {}", self.maps.len())
    }

    fn complete(&self, partial: &Partial, _seed: u64) -> Result<Image, CompletionError> {
        partial.check()?;
        let (width, height) = (2 * BANK_ROWS, BANK_ROWS);
        let alpha = resized(&partial.alpha, width, height);
        let known = Partial { rgb: known_mean(partial, width, height), alpha, normal: None, clipped: None };
        let mut floor = 0.0f64;
        let mut weight = 0.0f64;
        for_known(&known, |_, w, rgb| {
            floor += w * f64::from(rgb[0] + rgb[1] + rgb[2]) / 3.0;
            weight += w;
        });
        if weight <= 0.0 {
            return Err(CompletionError::NothingSeen { largest: 0.0 });
        }
        let floor = (1e-3 * floor / weight).max(1e-12);
        let mut best: Option<(f64, Image)> = None;
        for map in &self.maps {
            for mirrored in [false, true] {
                let map = if mirrored { mirror(map) } else { map.clone() };
                for turn in 0..BANK_TURNS {
                    let map = roll(&map, turn * width / BANK_TURNS);
                    let (error, gain) = fit(&known, &map, floor);
                    if best.as_ref().is_none_or(|(e, _)| error < *e) {
                        let mut scaled = map;
                        for pixel in scaled.data.chunks_exact_mut(3) {
                            pixel.iter_mut().zip(gain).for_each(|(v, g)| *v *= g);
                        }
                        best = Some((error, scaled));
                    }
                }
            }
        }
        let Some((_, fill)) = best else { return Err(CompletionError::EmptyBank) };
        let fill = resized(&fill, partial.rgb.width, partial.rgb.height);
        over_fill(partial, &|x, y| Vec3::from(fill.rgb(x, y)).as_dvec3())
    }
}

/// Radiance at a smaller size as the alpha-weighted mean of what is known.
pub(crate) fn known_mean(partial: &Partial, width: usize, height: usize) -> Image {
    let mut weighted = partial.rgb.clone();
    for (pixel, &a) in weighted.data.chunks_exact_mut(3).zip(&partial.alpha.data) {
        let usable = a.is_finite() && pixel.iter().all(|v| v.is_finite());
        pixel.iter_mut().for_each(|v| *v = if usable { v.max(0.0) * a.clamp(0.0, 1.0) } else { 0.0 });
    }
    let (mut rgb, alpha) = (resized(&weighted, width, height), resized(&partial.alpha, width, height));
    for (pixel, &a) in rgb.data.chunks_exact_mut(3).zip(&alpha.data) {
        pixel.iter_mut().for_each(|v| *v = if a > 1e-6 { *v / a } else { 0.0 });
    }
    rgb
}

fn mirror(map: &Image) -> Image {
    let mut out = map.clone();
    for y in 0..map.height {
        for x in 0..map.width {
            out.pixel_mut(x, y).copy_from_slice(map.pixel(map.width - 1 - x, y));
        }
    }
    out
}

/// Weighted variance of the log ratio, and the gain that its mean stands for.
fn fit(known: &Partial, map: &Image, floor: f64) -> (f64, [f32; 3]) {
    let (mut n, mut sum, mut squares) = (0.0, DVec3::ZERO, DVec3::ZERO);
    let (width, height) = (map.width, map.height);
    for y in 0..height {
        let omega = f64::from(equirect::texel_solid_angle(y, width, height));
        for x in 0..width {
            let a = f64::from(known.alpha.data[y * width + x]);
            if a < 0.5 {
                continue;
            }
            let log = |c: [f32; 3]| Vec3::from(c).as_dvec3().max(DVec3::splat(floor)).map(f64::ln);
            let ratio = log(known.rgb.rgb(x, y)) - log(map.rgb(x, y));
            n += omega;
            sum += omega * ratio;
            squares += omega * ratio * ratio;
        }
    }
    if n <= 0.0 {
        return (f64::INFINITY, [1.0; 3]);
    }
    let mean = sum / n;
    let variance = (squares / n - mean * mean).element_sum();
    (variance, mean.map(f64::exp).to_array().map(|v| v as f32))
}
