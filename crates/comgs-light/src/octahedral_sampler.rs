//! Importance sampling of an octahedral light.

use crate::cumulative::Cumulative;
use crate::{EnvSample, OctahedralLight, luminance};
use comgs_geom::{octahedral, sampling};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// The density that directions of an octahedral light are drawn with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Importance {
    /// The stated density is the true one, and the light is the interpolated one ([`OctahedralLight::radiance`]). The
    /// density is `q(u, v) / (∫ q du dv · dω/(du dv))`, where q interpolates luminance times
    /// [`octahedral::jacobian`] between texel centres.
    #[default]
    Exact,
    /// ComGS Eq. 18, `pdf = H W I / 4π`, with I the texel's share of the luminance and the light taken as constant in a
    /// texel. It supposes that texels are equally large. They are not (from 4 to 20.8 in units of the map's area, where
    /// it says 12.6), so that an estimator takes light near the axes of the world for up to 3.1 times, and light in the
    /// middle between them for 0.6 times what it is. Here to compare with the paper.
    EqualArea,
}

/// Draws directions of an [`OctahedralLight`] by its luminance; a light without any is sampled uniformly.
///
/// A row of texels is drawn, a texel in the row, and a place in the texel, each by inverting a cumulative distribution
/// in f64, so that a low-discrepancy set stays one. With [`Importance::Exact`] the luminance of `radiance / pdf` is
/// the light's integral, but for the change of solid angle per area between neighbouring texels: never more than
/// `(1 + 8.5/size)⁶` times it, however hot a texel is (5 % more on a map of 256, `tests/hard_cases.rs`).
#[derive(Clone, Debug)]
pub struct OctahedralSampler {
    light: OctahedralLight,
    importance: Importance,
    black: bool,
    /// q at texel centres (luminance, for [`Importance::EqualArea`]), scaled to an integral of 1 over the map.
    density: Vec<f32>,
    /// The rows' shares, one table.
    rows: Cumulative,
    /// The shares of the texels of a row, a table for each.
    columns: Cumulative,
}

impl OctahedralSampler {
    /// Builds the tables: O(texels).
    #[must_use]
    pub fn new(light: &OctahedralLight, importance: Importance) -> Self {
        let size = light.size();
        let density: Vec<f64> = (0..size * size)
            .map(|t| {
                let direction = octahedral::texel_direction(t % size, t / size, size);
                let area = match importance {
                    Importance::Exact => octahedral::jacobian(direction),
                    Importance::EqualArea => 1.0,
                };
                f64::from(luminance(light.texel(t))) * f64::from(area)
            })
            .collect();
        let masses: Vec<f64> = (0..size * size)
            .map(|t| match importance {
                Importance::Exact => mean(across(&around(&density, t % size, t / size, size))),
                Importance::EqualArea => density[t],
            })
            .collect();
        let (columns, rows) = Cumulative::new(&masses, size);
        let (rows, total) = Cumulative::new(&rows, size);
        let total = total[0] / (size * size) as f64;
        let density = density.iter().map(|q| if total > 0.0 { (q / total) as f32 } else { 1.0 }).collect();
        Self { light: light.clone(), importance, black: !(total > 0.0), density, rows, columns }
    }

    /// The light that is sampled.
    #[must_use]
    pub fn light(&self) -> &OctahedralLight {
        &self.light
    }

    /// Whether the light is black: samples are then uniform over the sphere.
    #[must_use]
    pub fn is_black(&self) -> bool {
        self.black
    }

    /// Direction for two random numbers in [0, 1). Inverse in distribution: [`OctahedralSampler::pdf`]. `radiance` is
    /// what [`OctahedralSampler::evaluate`] says; `pdf` is never 0.
    #[must_use]
    pub fn sample(&self, u: Vec2) -> EnvSample {
        if self.black {
            let direction = sampling::uniform_sphere(u);
            return EnvSample { direction, radiance: Vec3::ZERO, pdf: 1.0 / (4.0 * PI) };
        }
        let size = self.light.size();
        let (row, mut y) = self.rows.invert(0, u.y);
        let (column, mut x) = self.columns.invert(row, u.x);
        if self.importance == Importance::Exact {
            let q = around(&self.density, column, row, size);
            x = invert_hat(across(&q), x);
            y = invert_hat(q.map(|line| interpolated(line, x)), y);
        }
        let uv = Vec2::new((column as f64 + x) as f32, (row as f64 + y) as f32) / size as f32;
        let direction = octahedral::direction(uv);
        let (radiance, pdf) = self.evaluate(direction);
        EnvSample { direction, radiance, pdf: pdf.max(f32::MIN_POSITIVE) }
    }

    /// Density per steradian of [`OctahedralSampler::sample`] in a direction of any length (for
    /// [`Importance::EqualArea`], as the paper states it).
    #[inline]
    #[must_use]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        if self.black {
            return 1.0 / (4.0 * PI);
        }
        let size = self.light.size();
        match self.importance {
            Importance::Exact => {
                let density = octahedral::footprint(direction, size).gather(&self.density);
                density / octahedral::jacobian(direction)
            }
            Importance::EqualArea => self.density[octahedral::texel_of(direction, size)] / (4.0 * PI),
        }
    }

    /// Radiance and density of a direction of any length, for the price of one look-up: the interpolated radiance, or
    /// the texel's for [`Importance::EqualArea`].
    #[inline]
    #[must_use]
    pub fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        if self.black {
            return (Vec3::ZERO, 1.0 / (4.0 * PI));
        }
        let size = self.light.size();
        match self.importance {
            Importance::Exact => {
                let footprint = octahedral::footprint(direction, size);
                let density = footprint.gather(&self.density) / octahedral::jacobian(direction);
                (footprint.gather_rgb(self.light.texels()), density)
            }
            Importance::EqualArea => {
                let texel = octahedral::texel_of(direction, size);
                (self.light.texel(texel), self.density[texel] / (4.0 * PI))
            }
        }
    }
}

/// A texel and its neighbours, rows from above; past the edge they are those that the map continues with.
#[inline]
fn around<T: Copy + Into<f64>>(map: &[T], column: usize, row: usize, size: usize) -> [[f64; 3]; 3] {
    let inner = 1..size.saturating_sub(1);
    if inner.contains(&column) && inner.contains(&row) {
        return [row - 1, row, row + 1].map(|row| {
            let line = &map[row * size + column - 1..row * size + column + 2];
            [line[0].into(), line[1].into(), line[2].into()]
        });
    }
    let (column, row) = (column as isize, row as isize);
    [-1, 0, 1].map(|y| [-1, 0, 1].map(|x| map[octahedral::neighbour(column + x, row + y, size)].into()))
}

/// Mean over a texel of what interpolates linearly from the centre of the texel before to that of the texel after.
fn mean([before, here, after]: [f64; 3]) -> f64 {
    (before + 6.0 * here + after) / 8.0
}

/// Means along the columns.
fn across(q: &[[f64; 3]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| mean([q[0][i], q[1][i], q[2][i]]))
}

/// Value at `x` in [0, 1] of a texel.
fn interpolated([before, here, after]: [f64; 3], x: f64) -> f64 {
    let (other, t) = if x < 0.5 { (before, 0.5 - x) } else { (after, x - 0.5) };
    here + (other - here) * t
}

/// Place in a texel below which the share `u` of the interpolated values lies.
fn invert_hat([before, here, after]: [f64; 3], u: f64) -> f64 {
    let (left, right) = (0.5 * (before + here), 0.5 * (here + after));
    let (first, second) = (0.25 * (left + here), 0.25 * (here + right));
    let target = u * (first + second);
    // On half a texel, a x + (b − a) x² = target.
    let (a, b, target, start) =
        if target < first { (left, here, target, 0.0) } else { (here, right, target - first, 0.5) };
    let root = (a * a + 4.0 * (b - a) * target).max(0.0).sqrt();
    let x = if a + root > 0.0 { 2.0 * target / (a + root) } else { 0.25 };
    start + x.clamp(0.0, 0.5)
}
