//! Importance sampling of an environment map.

use crate::cumulative::Cumulative;
use crate::{EnvironmentMap, luminance};
use comgs_geom::{equirect, frame, sampling};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Resolution of a direction in f32, as a part of the map's width or height.
const EDGE: f64 = 1e-6;

/// A direction that light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvSample {
    /// Unit direction towards the light, world.
    pub direction: Vec3,
    /// Radiance of the texel it falls into ([`EnvironmentMap::radiance`]).
    pub radiance: Vec3,
    /// Density per steradian, > 0 (0 only where [`EnvironmentSampler::sample_defensive`] meets a density that
    /// vanishes: skip the sample).
    pub pdf: f32,
}

/// Draws directions with a density proportional to the texels' luminance.
///
/// A row is drawn by its share of luminance times solid angle, a texel in the row by its luminance, and a
/// direction in the texel uniformly by solid angle. `radiance / pdf` is therefore the same for all samples but for
/// the hue: its luminance is the map's integral. The two dimensions are drawn from the two random numbers apart,
/// each from a cumulative table in f64: in one table over all texels the dark ones of a map with a sun in it have
/// shares below the resolution of an f32 random number, and their light would be lost.
///
/// A map without any light is sampled uniformly.
#[derive(Clone, Debug)]
pub struct EnvironmentSampler {
    map: EnvironmentMap,
    /// One table, of the rows.
    rows: Cumulative,
    /// A table a row, of its texels.
    columns: Cumulative,
    black: bool,
}

impl EnvironmentSampler {
    /// Builds the tables: O(texels).
    #[must_use]
    pub fn new(map: &EnvironmentMap) -> Self {
        let (w, h) = (map.width(), map.height());
        let black = map.is_black();
        let mass = |i: usize| if black { 1.0 } else { f64::from(luminance(map.texel(i % w, i / w))) };
        let masses: Vec<f64> = (0..w * h).map(mass).collect();
        let (columns, mut sums) = Cumulative::new(&masses, w);
        for (row, sum) in sums.iter_mut().enumerate() {
            *sum *= f64::from(equirect::texel_solid_angle(row, w, h));
        }
        let (rows, _) = Cumulative::new(&sums, h);
        Self { map: map.clone(), rows, columns, black }
    }

    /// The map that is sampled.
    #[must_use]
    pub fn map(&self) -> &EnvironmentMap {
        &self.map
    }

    /// Whether the map is black: samples are then uniform over the sphere.
    #[must_use]
    pub fn is_black(&self) -> bool {
        self.black
    }

    /// Direction for two random numbers in [0, 1). Inverse in distribution: [`EnvironmentSampler::pdf`].
    #[must_use]
    pub fn sample(&self, u: Vec2) -> EnvSample {
        let (w, h) = (self.map.width(), self.map.height());
        let (row, inside_row) = self.rows.invert(0, u.y);
        let (column, inside_column) = self.columns.invert(row, u.x);
        // Uniform by solid angle: linear in the cosine of the polar angle.
        let polar = |edge: usize| (std::f64::consts::PI * edge as f64 / h as f64).cos();
        let z = polar(row) + inside_row * (polar(row + 1) - polar(row));
        // Kept off the texel's edges by what f32 directions resolve, so that a look-up finds the same texel.
        let inset = |x: f64, count: usize| {
            let edge = (EDGE * count as f64).min(0.1);
            edge + (1.0 - 2.0 * edge) * x.clamp(0.0, 1.0)
        };
        let down = z.clamp(-1.0, 1.0).acos() / std::f64::consts::PI * h as f64 - row as f64;
        let u = (column as f64 + inset(inside_column, w)) / w as f64;
        let v = (row as f64 + inset(down, h)) / h as f64;
        EnvSample {
            direction: self.map.direction(u as f32, v as f32),
            radiance: self.map.texel(column, row),
            pdf: self.texel_pdf(column, row),
        }
    }

    /// Density per steradian of [`EnvironmentSampler::sample`] in a direction of any length.
    #[must_use]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let (column, row) = self.map.texel_of(direction);
        self.texel_pdf(column, row)
    }

    /// [`EnvironmentMap::radiance`] and [`EnvironmentSampler::pdf`] of a direction of any length, for the price of one
    /// look-up.
    #[must_use]
    pub fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        let (column, row) = self.map.texel_of(direction);
        (self.map.texel(column, row), self.texel_pdf(column, row))
    }

    /// A direction for a surface with unit `normal`: with probability `cosine_share` from the cosine lobe about the
    /// normal, else from the map. The density is that of the mixture, so the estimator `radiance · f / pdf` never
    /// exceeds `π / cosine_share · radiance · f / cos θ`, whatever the map holds. `u.x` also makes the choice.
    #[must_use]
    pub fn sample_defensive(&self, normal: Vec3, cosine_share: f32, u: Vec2) -> EnvSample {
        let share = cosine_share.clamp(0.0, 1.0);
        let below_one = |x: f32| x.clamp(0.0, 1.0 - f32::EPSILON / 2.0);
        let (direction, radiance) = if u.x < share {
            let local = sampling::cosine_hemisphere(Vec2::new(below_one(u.x / share), u.y));
            let direction = frame::world_from_tangent(normal) * local;
            (direction, self.map.radiance(direction))
        } else {
            let sample = self.sample(Vec2::new(below_one((u.x - share) / (1.0 - share)), u.y));
            (sample.direction, sample.radiance)
        };
        EnvSample { direction, radiance, pdf: self.pdf_defensive(direction, normal, share) }
    }

    /// Density per steradian of [`EnvironmentSampler::sample_defensive`].
    #[must_use]
    pub fn pdf_defensive(&self, direction: Vec3, normal: Vec3, cosine_share: f32) -> f32 {
        let cosine = sampling::cosine_hemisphere_pdf(normal.dot(direction.normalize_or_zero()));
        cosine_share * cosine + (1.0 - cosine_share) * self.pdf(direction)
    }

    fn texel_pdf(&self, column: usize, row: usize) -> f32 {
        if self.black {
            return 1.0 / (4.0 * PI);
        }
        let share = self.rows.share(0, row) * self.columns.share(row, column);
        (share / f64::from(equirect::texel_solid_angle(row, self.map.width(), self.map.height()))) as f32
    }
}
