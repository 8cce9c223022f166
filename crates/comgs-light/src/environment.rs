//! The environment map.

use comgs_geom::equirect;
use comgs_image::Image;
use glam::{DVec3, Vec3};
use std::f32::consts::{PI, TAU};
use std::fmt;
use thiserror::Error;

/// Why an image is not an environment map.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum EnvError {
    /// No pixels.
    #[error("the environment image is empty ({width}×{height})")]
    Empty {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// Not a full sphere in equirectangular projection.
    #[error("the environment image is {width}×{height}; an equirectangular map is twice as wide as high")]
    Aspect {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// Neither grey nor RGB.
    #[error("the environment image has {0} channels, expected 1 (grey) or 3 (RGB)")]
    Channels(usize),
    /// Values that are no radiance, where none are accepted.
    #[error("the environment image has unusable samples: {0}")]
    Samples(EnvReport),
}

/// Samples of a map that are no radiance, and that were repaired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EnvReport {
    /// NaN samples; repaired with the mean of the finite neighbours (0 where there are none).
    pub nan: usize,
    /// Samples of +∞; repaired with the largest finite sample of the map.
    pub infinite: usize,
    /// Negative samples, −∞ included; repaired with 0.
    pub negative: usize,
}

impl EnvReport {
    /// Whether nothing was wrong.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        *self == Self::default()
    }
}

impl fmt::Display for EnvReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} NaN, {} infinite, {} negative", self.nan, self.infinite, self.negative)
    }
}

/// Radiance that arrives from every direction, from infinitely far away. Equirectangular, z up
/// ([`comgs_geom::equirect`]), linear Rec.709, finite and not negative.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    /// Three channels, twice as wide as high.
    image: Image,
    /// Turn about +z, as a fraction of a full turn in [0, 1).
    turn: f32,
}

impl EnvironmentMap {
    /// A map from an image of 1 or 3 channels, twice as wide as high.
    ///
    /// # Errors
    /// [`EnvError`]: another shape, or any sample that is NaN, infinite or negative. To accept such images, see
    /// [`EnvironmentMap::from_image_repaired`].
    pub fn from_image(image: &Image) -> Result<Self, EnvError> {
        let (map, report) = Self::from_image_repaired(image)?;
        if report.is_clean() { Ok(map) } else { Err(EnvError::Samples(report)) }
    }

    /// As [`EnvironmentMap::from_image`], with samples that are no radiance repaired as [`EnvReport`] says.
    ///
    /// # Errors
    /// [`EnvError`] for images of another shape.
    pub fn from_image_repaired(image: &Image) -> Result<(Self, EnvReport), EnvError> {
        let (width, height) = (image.width, image.height);
        if width == 0 || height == 0 {
            return Err(EnvError::Empty { width, height });
        }
        if width != 2 * height {
            return Err(EnvError::Aspect { width, height });
        }
        let (image, report) = match image.channels {
            1 | 3 => repaired(image.clone()),
            n => return Err(EnvError::Channels(n)),
        };
        let image = if image.channels == 1 { image.select(&[0, 0, 0]) } else { image };
        Ok((Self { image, turn: 0.0 }, report))
    }

    /// The same radiance from everywhere; negative and non-finite components are taken as 0.
    #[must_use]
    pub fn constant(radiance: Vec3) -> Self {
        let rgb = radiance.to_array().map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        Self { image: Image::from_data(2, 1, 3, [rgb, rgb].concat()), turn: 0.0 }
    }

    /// The map turned about +z by `angle` radians, counter-clockwise seen from above: what came from direction d now
    /// comes from `Rz(angle) d`. Exact: no texel is resampled.
    #[must_use]
    pub fn turned(&self, angle: f32) -> Self {
        let turn = (self.turn + angle / TAU).rem_euclid(1.0);
        Self { turn: if turn < 1.0 { turn } else { 0.0 }, image: self.image.clone() }
    }

    /// The map with its radiance multiplied by `factor` ≥ 0.
    #[must_use]
    pub fn scaled(&self, factor: f32) -> Self {
        Self { image: self.image.map(|v| v * factor.max(0.0)), turn: self.turn }
    }

    /// The map at another resolution, `2 height × height`, averaged by solid angle: the integral is conserved when
    /// heights divide, and nearly so otherwise.
    #[must_use]
    pub fn resized(&self, height: usize) -> Self {
        let height = height.max(1);
        let (w, h) = (self.width(), self.height());
        let mut weighted = self.image.clone();
        let mut weights = Image::zeros(w, h, 1);
        for y in 0..h {
            let omega = equirect::texel_solid_angle(y, w, h);
            weighted.data[y * w * 3..(y + 1) * w * 3].iter_mut().for_each(|v| *v *= omega);
            weights.data[y * w..(y + 1) * w].fill(omega);
        }
        let mut image = weighted.resized(2 * height, height);
        let weights = weights.resized(2 * height, height);
        for (pixel, weight) in image.data.chunks_exact_mut(3).zip(&weights.data) {
            pixel.iter_mut().for_each(|v| *v /= weight);
        }
        Self { image, turn: self.turn }
    }

    /// Width in texels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.image.width
    }

    /// Height in texels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.image.height
    }

    /// The texels as stored, before the turn.
    #[must_use]
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Turn about +z in radians, in [0, 2π).
    #[must_use]
    pub fn turn(&self) -> f32 {
        self.turn * TAU
    }

    /// Whether no light comes from anywhere.
    #[must_use]
    pub fn is_black(&self) -> bool {
        self.image.data.iter().all(|&v| v == 0.0)
    }

    /// Radiance of a texel.
    #[must_use]
    pub fn texel(&self, column: usize, row: usize) -> Vec3 {
        Vec3::from_array(self.image.rgb(column, row))
    }

    /// Sets the radiance of a texel; components that are no radiance are taken as 0.
    pub(crate) fn set_texel(&mut self, column: usize, row: usize, radiance: Vec3) {
        let sound = radiance.to_array().map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        self.image.pixel_mut(column, row).copy_from_slice(&sound);
    }

    /// Texel that a direction (of any length) falls into, column and row.
    #[must_use]
    pub fn texel_of(&self, direction: Vec3) -> (usize, usize) {
        let (u, v) = self.uv(direction);
        let column = ((u * self.width() as f32) as usize).min(self.width() - 1);
        (column, ((v * self.height() as f32) as usize).min(self.height() - 1))
    }

    /// World direction of a point of the map, `(u, v)` in `[0, 1]²`.
    #[must_use]
    pub fn direction(&self, u: f32, v: f32) -> Vec3 {
        // Azimuth falls with u, so a turn by +angle moves texels to lower u.
        equirect::direction(u - self.turn, v)
    }

    /// Radiance from a direction of any length: the value of its texel. This is the light that is integrated and
    /// sampled.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (column, row) = self.texel_of(direction);
        self.texel(column, row)
    }

    /// Radiance from a direction, bilinear between texel centres: continuous across the azimuth's seam, and held
    /// constant from the last row's centre to the pole. For looking at; see the crate's note on the difference.
    #[must_use]
    pub fn lookup(&self, direction: Vec3) -> Vec3 {
        let (u, v) = self.uv(direction);
        let (w, h) = (self.width(), self.height());
        let x = u * w as f32 - 0.5;
        let y = (v * h as f32 - 0.5).clamp(0.0, (h - 1) as f32);
        let (left, top) = (x.floor(), y.floor());
        let (tx, ty) = (x - left, y - top);
        let x0 = (left as isize).rem_euclid(w as isize) as usize;
        let x1 = (x0 + 1) % w;
        let (y0, y1) = (top as usize, (top as usize + 1).min(h - 1));
        let upper = self.texel(x0, y0).lerp(self.texel(x1, y0), tx);
        let lower = self.texel(x0, y1).lerp(self.texel(x1, y1), tx);
        upper.lerp(lower, ty)
    }

    /// ∫ L dω over the sphere, by the texels' exact solid angles.
    #[must_use]
    pub fn integral(&self) -> Vec3 {
        let mut sum = DVec3::ZERO;
        for row in 0..self.height() {
            let omega = f64::from(equirect::texel_solid_angle(row, self.width(), self.height()));
            for column in 0..self.width() {
                sum += omega * self.texel(column, row).as_dvec3();
            }
        }
        sum.as_vec3()
    }

    /// Mean radiance over the sphere, by solid angle.
    #[must_use]
    pub fn mean(&self) -> Vec3 {
        self.integral() / (4.0 * PI)
    }

    /// Irradiance of a surface with unit `normal`: ∫ L max(0, n · ω) dω. A reference by brute force in f64: every
    /// texel is cut into equal parts, fine enough that there are at least 512 × 256 of them over the sphere.
    #[must_use]
    pub fn irradiance(&self, normal: Vec3) -> Vec3 {
        let (w, h) = (self.width(), self.height());
        let parts = 256usize.div_ceil(h);
        let (rows, columns) = (h * parts, w * parts);
        // The normal is turned back instead of every direction forth.
        let normal = normal.as_dvec3();
        let (sin, cos) = (-f64::from(self.turn) * std::f64::consts::TAU).sin_cos();
        let normal = DVec3::new(cos * normal.x - sin * normal.y, sin * normal.x + cos * normal.y, normal.z);
        let mut sum = DVec3::ZERO;
        for row in 0..rows {
            let (top, bottom) = (row as f64 / rows as f64, (row + 1) as f64 / rows as f64);
            let (z0, z1) = ((std::f64::consts::PI * top).cos(), (std::f64::consts::PI * bottom).cos());
            let omega = std::f64::consts::TAU / columns as f64 * (z0 - z1);
            let z = 0.5 * (z0 + z1);
            let r = (1.0 - z * z).sqrt();
            for column in 0..columns {
                let azimuth = std::f64::consts::PI * (1.0 - 2.0 * (column as f64 + 0.5) / columns as f64);
                let cosine = normal.dot(DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z));
                if cosine > 0.0 {
                    sum += cosine * omega * self.texel(column / parts, row / parts).as_dvec3();
                }
            }
        }
        sum.as_vec3()
    }

    /// `(u, v)` of a world direction in the stored image, `[0, 1) × [0, 1]`.
    fn uv(&self, direction: Vec3) -> (f32, f32) {
        let (u, v) = equirect::uv_from_direction(direction);
        let u = (u + self.turn).rem_euclid(1.0);
        (if u < 1.0 { u } else { 0.0 }, v)
    }
}

/// Samples that are no radiance, replaced as [`EnvReport`] says.
fn repaired(mut image: Image) -> (Image, EnvReport) {
    let mut report = EnvReport::default();
    let sound = |v: f32| v.is_finite() && v >= 0.0;
    if image.data.iter().all(|&v| sound(v)) {
        return (image, report);
    }
    let source = image.clone();
    let (w, h) = (source.width as isize, source.height as isize);
    let largest = source.data.iter().copied().filter(|&v| sound(v)).fold(0.0f32, f32::max);
    for y in 0..h {
        for x in 0..w {
            for c in 0..source.channels {
                let value = &mut image.pixel_mut(x as usize, y as usize)[c];
                if value.is_nan() {
                    report.nan += 1;
                    let (mut sum, mut count) = (0.0f32, 0.0f32);
                    for dy in -1..=1 {
                        for dx in -1..=1 {
                            let (nx, ny) =
                                ((x + dx).rem_euclid(w) as usize, (y + dy).clamp(0, h - 1) as usize);
                            let neighbour = source.pixel(nx, ny)[c];
                            if sound(neighbour) {
                                sum += neighbour;
                                count += 1.0;
                            }
                        }
                    }
                    *value = if count > 0.0 { sum / count } else { 0.0 };
                } else if *value == f32::INFINITY {
                    report.infinite += 1;
                    *value = largest;
                } else if *value < 0.0 {
                    report.negative += 1;
                    *value = 0.0;
                }
            }
        }
    }
    (image, report)
}
