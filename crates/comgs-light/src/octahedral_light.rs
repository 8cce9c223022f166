//! A learnable environment on an octahedral map.

use crate::{EnvReport, EnvironmentMap};
use comgs_geom::{equirect, octahedral};
use comgs_image::Image;
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;
use thiserror::Error;

/// Why texels are not an environment.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum OctahedralError {
    /// Not `size × size` texels of three channels.
    #[error("an octahedral map of {size}×{size} has {} values, got {got}", 3 * size * size)]
    Shape {
        /// Side of the map in texels.
        size: usize,
        /// Number of values.
        got: usize,
    },
    /// Values that are no radiance.
    #[error("the octahedral map has unusable samples: {0}")]
    Samples(EnvReport),
}

/// Radiance that arrives from every direction, from infinitely far away, on an octahedral map
/// ([`comgs_geom::octahedral`]), linear Rec.709, finite and not negative.
///
/// Unlike an [`EnvironmentMap`] it is bilinear between texel centres, for every purpose: it is what is optimised, and
/// a gradient of the direction needs it smooth. [`crate::OctahedralSampler`] samples exactly this interpolation, so
/// that a hot texel causes no fireflies around it.
#[derive(Clone, Debug, PartialEq)]
pub struct OctahedralLight {
    size: usize,
    /// `[texel][rgb]`.
    texels: Vec<f32>,
}

/// Rows of an equirectangular grid per texel of an octahedral map's side, where light is resampled: at least 5 samples
/// on the side of the smallest texel (2/size, in steps of π/8 size).
const SAMPLES: usize = 8;

/// Parts of the source map that are summed apart when light is resampled: fixed, so that sums are always in the same
/// order.
const PARTS: usize = 8;

impl OctahedralLight {
    /// Side of the environment that is optimised in the paper (ComGS Appendix: 256 × 256).
    pub const DEFAULT_SIZE: usize = 256;

    /// A map from its values, `size · size · 3`, `[texel][rgb]`.
    ///
    /// # Errors
    /// [`OctahedralError`]: another number of values, or any that is NaN, infinite or negative.
    pub fn from_texels(size: usize, texels: Vec<f32>) -> Result<Self, OctahedralError> {
        if size == 0 || texels.len() != 3 * size * size {
            return Err(OctahedralError::Shape { size, got: texels.len() });
        }
        let mut report = EnvReport::default();
        for &v in &texels {
            report.nan += usize::from(v.is_nan());
            report.infinite += usize::from(v == f32::INFINITY);
            report.negative += usize::from(v < 0.0);
        }
        if report.is_clean() { Ok(Self { size, texels }) } else { Err(OctahedralError::Samples(report)) }
    }

    /// The same radiance from everywhere; negative and non-finite components are taken as 0.
    #[must_use]
    pub fn constant(size: usize, radiance: Vec3) -> Self {
        let size = size.max(1);
        let rgb = radiance.to_array().map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        Self { size, texels: rgb.repeat(size * size) }
    }

    /// Values that are known to be radiance.
    pub(crate) fn from_sound(size: usize, texels: Vec<f32>) -> Self {
        debug_assert_eq!(texels.len(), 3 * size * size);
        Self { size, texels }
    }

    /// Side in texels.
    #[inline]
    #[must_use]
    pub fn size(&self) -> usize {
        self.size
    }

    /// Values, `[texel][rgb]`, texel `row · size + column`.
    #[inline]
    #[must_use]
    pub fn texels(&self) -> &[f32] {
        &self.texels
    }

    /// Radiance at the centre of a texel.
    #[inline]
    #[must_use]
    pub fn texel(&self, index: usize) -> Vec3 {
        Vec3::from_slice(&self.texels[3 * index..3 * index + 3])
    }

    /// Whether no light comes from anywhere.
    #[must_use]
    pub fn is_black(&self) -> bool {
        self.texels.iter().all(|&v| v == 0.0)
    }

    /// Radiance from a direction of any length, bilinear and continuous over the sphere. Gradients:
    /// [`OctahedralLight::radiance_vjp`] and [`OctahedralLight::direction_vjp`].
    #[inline]
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        octahedral::footprint(direction, self.size).gather_rgb(&self.texels)
    }

    /// Adds the gradient with respect to the texels, given that with respect to the radiance from a direction.
    #[inline]
    pub fn radiance_vjp(&self, direction: Vec3, grad: Vec3, grad_texels: &mut [f32]) {
        let footprint = octahedral::footprint(direction, self.size);
        for (texel, weight) in footprint.texels.into_iter().zip(footprint.weights) {
            let texel = &mut grad_texels[3 * texel as usize..3 * texel as usize + 3];
            texel[0] += weight * grad.x;
            texel[1] += weight * grad.y;
            texel[2] += weight * grad.z;
        }
    }

    /// Gradient with respect to the direction, given that with respect to the radiance from it; kinks as
    /// [`octahedral::footprint_vjp`] says.
    #[inline]
    #[must_use]
    pub fn direction_vjp(&self, direction: Vec3, grad: Vec3) -> Vec3 {
        let footprint = octahedral::footprint(direction, self.size);
        let grad_weights = footprint.texels.map(|t| self.texel(t as usize).dot(grad));
        octahedral::footprint_vjp(direction, self.size, grad_weights)
    }

    /// ∫ L dω over the sphere, of the interpolated radiance, to 10⁻⁴.
    #[must_use]
    pub fn integral(&self) -> Vec3 {
        let weights = interpolated_solid_angles(self.size);
        let mut sum = DVec3::ZERO;
        for (t, weight) in weights.iter().enumerate() {
            sum += *weight * self.texel(t).as_dvec3();
        }
        sum.as_vec3()
    }

    /// Mean radiance over the sphere, by solid angle.
    #[must_use]
    pub fn mean(&self) -> Vec3 {
        self.integral() / (4.0 * PI)
    }

    /// An environment map resampled. Every texel is the mean of the environment under its interpolation weight, so light
    /// stays where it was: a texel of the environment, however small and hot, is spread over the centres around it. What
    /// numerical integration loses (below 10⁻³) is made up by one factor per channel, so that the integrals agree to
    /// rounding. A constant stays constant.
    #[must_use]
    pub fn from_environment(map: &EnvironmentMap, size: usize) -> Self {
        let size = size.max(1);
        let (w, h) = (map.width(), map.height());
        let cuts = (SAMPLES * size).div_ceil(h);
        let (columns, rows) = (w * cuts, h * cuts);
        let horizon: Vec<Vec3> =
            (0..columns).map(|x| map.direction((x as f32 + 0.5) / columns as f32, 0.5)).collect();
        let part = |index: usize| {
            let mut sums = vec![[0.0f64; 4]; size * size];
            for row in index * rows / PARTS..(index + 1) * rows / PARTS {
                let omega = f64::from(equirect::texel_solid_angle(row, columns, rows));
                let (sin, cos) = polar(row, rows);
                for column in 0..columns {
                    let radiance = map.texel(column / cuts, row / cuts).as_dvec3();
                    let toward = horizon[column];
                    let toward = Vec3::new(toward.x * sin, toward.y * sin, cos);
                    let footprint = octahedral::footprint(toward, size);
                    for (texel, weight) in footprint.texels.into_iter().zip(footprint.weights) {
                        let weight = omega * f64::from(weight);
                        let sum = &mut sums[texel as usize];
                        sum[0] += weight * radiance.x;
                        sum[1] += weight * radiance.y;
                        sum[2] += weight * radiance.z;
                        sum[3] += weight;
                    }
                }
            }
            sums
        };
        let parts: Vec<_> = (0..PARTS).into_par_iter().map(part).collect();
        let mut texels = Vec::with_capacity(3 * size * size);
        for texel in 0..size * size {
            let sum = parts.iter().fold([0.0; 4], |a, p| [0, 1, 2, 3].map(|i| a[i] + p[texel][i]));
            texels.extend([0, 1, 2].map(|c| (sum[c] / sum[3]) as f32));
        }
        let light = Self { size, texels };
        let factor = ratio(map.integral(), light.integral());
        light.scaled(factor)
    }

    /// The light as an environment map, `2 height × height`: every texel is the mean over its solid angle. What numerical
    /// integration loses (below 10⁻³) is made up by one factor per channel, so that the integrals agree to rounding.
    #[must_use]
    pub fn to_environment(&self, height: usize) -> EnvironmentMap {
        let height = height.max(1);
        let width = 2 * height;
        let cuts = (SAMPLES * self.size).div_ceil(height).max(2);
        let (columns, rows) = (width * cuts, height * cuts);
        let horizon: Vec<Vec3> =
            (0..columns).map(|x| equirect::direction((x as f32 + 0.5) / columns as f32, 0.5)).collect();
        let mut image = Image::zeros(width, height, 3);
        image.data.par_chunks_mut(3 * width).enumerate().for_each(|(row, line)| {
            for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
                let (mut sum, mut weight) = (DVec3::ZERO, 0.0f64);
                for y in row * cuts..(row + 1) * cuts {
                    let (sin, cos) = polar(y, rows);
                    for toward in &horizon[column * cuts..(column + 1) * cuts] {
                        let toward = Vec3::new(toward.x * sin, toward.y * sin, cos);
                        sum += f64::from(sin) * self.radiance(toward).as_dvec3();
                        weight += f64::from(sin);
                    }
                }
                pixel.copy_from_slice(&(sum / weight).as_vec3().to_array());
            }
        });
        let integral = |image: &Image| {
            let mut sum = DVec3::ZERO;
            for (row, line) in image.data.chunks_exact(3 * width).enumerate() {
                let omega = f64::from(equirect::texel_solid_angle(row, width, height));
                sum += omega * line.chunks_exact(3).map(|p| Vec3::from_slice(p).as_dvec3()).sum::<DVec3>();
            }
            sum.as_vec3()
        };
        let factor = ratio(self.integral(), integral(&image)).to_array();
        image.data.chunks_exact_mut(3).for_each(|p| (0..3).for_each(|c| p[c] *= factor[c]));
        // Means of finite values that are not negative.
        EnvironmentMap::from_image_repaired(&image).expect("twice as wide as high, three channels").0
    }

    /// The light with its radiance multiplied by `factor` ≥ 0, a factor a channel.
    #[must_use]
    pub fn scaled(mut self, factor: Vec3) -> Self {
        let factor = factor.max(Vec3::ZERO).to_array();
        self.texels.chunks_exact_mut(3).for_each(|t| (0..3).for_each(|c| t[c] *= factor[c]));
        self
    }
}

/// Sine and cosine of the polar angle of a row's centre.
fn polar(row: usize, rows: usize) -> (f32, f32) {
    (PI * (row as f32 + 0.5) / rows as f32).sin_cos()
}

/// `wanted / got`, 1 where there is nothing to scale.
fn ratio(wanted: Vec3, got: Vec3) -> Vec3 {
    let ratio = |w: f32, g: f32| if g > 0.0 && (w / g).is_finite() { w / g } else { 1.0 };
    Vec3::new(ratio(wanted.x, got.x), ratio(wanted.y, got.y), ratio(wanted.z, got.z))
}

/// ∫ of the interpolation weight of every texel over the sphere: what a texel counts in an integral of the interpolated
/// map. Gauss's rule of two points on halves of texels, cut further on maps below 64 because the solid angle per area
/// has a kink along the folds; scaled to 4π.
fn interpolated_solid_angles(size: usize) -> Vec<f64> {
    let parts = size * 2 * 64usize.div_ceil(size);
    // The two points of a part, as fractions of it.
    let offset = 0.5 / 3f32.sqrt();
    let place = |i: usize| {
        let inside = if i.is_multiple_of(2) { 0.5 - offset } else { 0.5 + offset };
        ((i / 2) as f32 + inside) / parts as f32
    };
    let mut weights = vec![0.0f64; size * size];
    for y in 0..2 * parts {
        for x in 0..2 * parts {
            let direction = octahedral::direction(Vec2::new(place(x), place(y)));
            let area = f64::from(octahedral::jacobian(direction));
            let footprint = octahedral::footprint(direction, size);
            for (texel, weight) in footprint.texels.into_iter().zip(footprint.weights) {
                weights[texel as usize] += area * f64::from(weight);
            }
        }
    }
    let scale = 4.0 * std::f64::consts::PI / weights.iter().sum::<f64>();
    weights.iter_mut().for_each(|w| *w *= scale);
    weights
}
