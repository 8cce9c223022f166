//! An environment map as a light: lookup, and importance sampling by luminance and solid angle.

use comgs_geom::equirect;
use comgs_image::Image;
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Radiance from infinitely far, bilinear between texel centres; wraps around in azimuth, ends at the poles.
#[derive(Clone, Debug)]
pub struct Environment {
    map: Image,
    /// Running sums of the rows' weights, ending with 1.
    rows: Vec<f32>,
    /// Running sums inside each row, each ending with 1.
    columns: Vec<f32>,
    /// Density per steradian in each texel.
    density: Vec<f32>,
    /// `∫ luminance dω`.
    power: f32,
}

/// A direction chosen by [`Environment::sample`].
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentSample {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// Radiance from there.
    pub radiance: Vec3,
    /// Density per steradian.
    pub pdf: f32,
}

/// Share of the samples that goes to all directions alike, so that none is impossible.
const UNIFORM_SHARE: f32 = 0.02;

fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

impl Environment {
    /// From an equirectangular map of linear radiance, 3 channels. Negative and non-finite texels count as 0.
    ///
    /// # Panics
    /// When the map is empty or has another number of channels.
    #[must_use]
    pub fn new(map: Image) -> Self {
        assert!(map.channels == 3 && map.pixels() > 0, "an environment map has three channels");
        let map = map.map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        let (width, height) = (map.width, map.height);
        let texel = |x: usize, y: usize| luminance(Vec3::from(map.rgb(x, y)));
        // The mean of the bilinear interpolant over a texel is a (1, 6, 1)/8 mean of its neighbourhood.
        let wide = |x: usize, y: usize| {
            (texel((x + width - 1) % width, y) + 6.0 * texel(x, y) + texel((x + 1) % width, y)) / 8.0
        };
        let (mut weights, mut power) = (vec![0.0f64; width * height], 0.0);
        for y in 0..height {
            let solid = f64::from(equirect::texel_solid_angle(y, width, height));
            for x in 0..width {
                let mean =
                    (wide(x, y.saturating_sub(1)) + 6.0 * wide(x, y) + wide(x, (y + 1).min(height - 1)))
                        / 8.0;
                weights[y * width + x] = f64::from(mean) * solid;
                power += f64::from(mean) * solid;
            }
        }
        let (mut rows, mut columns) = (Vec::with_capacity(height), Vec::with_capacity(width * height));
        let mut density = Vec::with_capacity(width * height);
        let mut total = 0.0;
        for y in 0..height {
            let solid = f64::from(equirect::texel_solid_angle(y, width, height));
            let uniform = f64::from(UNIFORM_SHARE) * solid / (4.0 * std::f64::consts::PI);
            let row = &weights[y * width..(y + 1) * width];
            let chance = |w: f64| {
                if power > 0.0 {
                    (1.0 - f64::from(UNIFORM_SHARE)) * w / power + uniform
                } else {
                    solid / (4.0 * std::f64::consts::PI)
                }
            };
            let sum: f64 = row.iter().map(|&w| chance(w)).sum();
            let mut running = 0.0;
            for &w in row {
                running += chance(w);
                columns.push((running / sum) as f32);
                density.push((chance(w) / solid) as f32);
            }
            columns[(y + 1) * width - 1] = 1.0;
            total += sum;
            rows.push(total as f32);
        }
        rows[height - 1] = 1.0;
        Self { map, rows, columns, density, power: power as f32 }
    }

    /// The map.
    #[must_use]
    pub fn map(&self) -> &Image {
        &self.map
    }

    /// `∫ luminance dω` over the sphere.
    #[must_use]
    pub fn power(&self) -> f32 {
        self.power
    }

    /// Radiance from a unit direction.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (width, height) = (self.map.width, self.map.height);
        let (u, v) = equirect::uv_from_direction(direction);
        let x = u * width as f32 - 0.5;
        let y = (v * height as f32 - 0.5).clamp(0.0, (height - 1) as f32);
        let (fx, y0) = (x.floor(), y as usize);
        let (tx, ty) = (x - fx, y - y0 as f32);
        let x0 = (fx as i64).rem_euclid(width as i64) as usize;
        let (x1, y1) = ((x0 + 1) % width, (y0 + 1).min(height - 1));
        let texel = |x, y| Vec3::from(self.map.rgb(x, y));
        texel(x0, y0).lerp(texel(x1, y0), tx).lerp(texel(x0, y1).lerp(texel(x1, y1), tx), ty)
    }

    /// Density per steradian with which [`Environment::sample`] chooses a unit direction.
    #[must_use]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let (width, height) = (self.map.width, self.map.height);
        let (u, v) = equirect::uv_from_direction(direction);
        let x = ((u * width as f32) as usize).min(width - 1);
        let y = ((v * height as f32) as usize).min(height - 1);
        self.density[y * width + x]
    }

    /// Chooses a direction by the light that comes from it.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> EnvironmentSample {
        let (width, height) = (self.map.width, self.map.height);
        let (row, v) = choose(&self.rows, u[1]);
        let (column, t) = choose(&self.columns[row * width..(row + 1) * width], u[0]);
        // Inside the texel: uniform in azimuth and in the cosine of the polar angle, that is, in solid angle.
        let (top, bottom) =
            ((PI * row as f32 / height as f32).cos(), (PI * (row + 1) as f32 / height as f32).cos());
        let z = top + (bottom - top) * v;
        let azimuth = PI - TAU * (column as f32 + t) / width as f32;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let direction = Vec3::new(r * azimuth.cos(), r * azimuth.sin(), z);
        EnvironmentSample {
            direction,
            radiance: self.radiance(direction),
            pdf: self.density[row * width + column],
        }
    }
}

/// The entry of a running sum into which `u` falls, and where inside it.
fn choose(running: &[f32], u: f32) -> (usize, f32) {
    let i = running.partition_point(|&c| c <= u).min(running.len() - 1);
    let low = if i == 0 { 0.0 } else { running[i - 1] };
    let width = running[i] - low;
    (i, if width > 0.0 { ((u - low) / width).clamp(0.0, 1.0) } else { 0.5 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::{Rng, sampling};

    fn hot() -> Environment {
        let mut map = Image::filled(32, 16, 3, 0.05);
        map.pixel_mut(7, 4).copy_from_slice(&[900.0, 700.0, 500.0]);
        map.pixel_mut(31, 9).copy_from_slice(&[3.0, 40.0, 3.0]);
        Environment::new(map)
    }

    /// Goal: importance sampling is unbiased: the irradiance of a tilted surface agrees with a fine quadrature, and with
    /// uniform sampling within that estimate's own (much larger) error.
    #[test]
    fn importance_agrees_with_quadrature_and_uniform() {
        let environment = hot();
        let normal = Vec3::new(0.3, 0.5, 0.8).normalize();
        let integrand = |d: Vec3| f64::from(environment.radiance(d).x * d.dot(normal).max(0.0));
        let (mut exact, n) = (0.0, 1024);
        for y in 0..n {
            for x in 0..2 * n {
                let solid = f64::from(equirect::texel_solid_angle(y, 2 * n, n));
                exact += integrand(equirect::texel_direction(x, y, 2 * n, n)) * solid;
            }
        }
        let mut rng = Rng::new(2);
        let (mut sum, mut square) = (0.0, 0.0);
        let samples = 40_000;
        for _ in 0..samples {
            let s = environment.sample([rng.uniform(), rng.uniform()]);
            let v = integrand(s.direction) / f64::from(s.pdf);
            sum += v;
            square += v * v;
        }
        let mean = sum / f64::from(samples);
        let error = ((square / f64::from(samples) - mean * mean) / f64::from(samples)).sqrt();
        assert!((mean - exact).abs() < 4.0 * error + 1e-3 * exact, "{mean} ± {error}, exact {exact}");
        assert!(error < 0.01 * exact, "importance sampling is noisy: {error} of {exact}");
        let (mut sum_uniform, mut square_uniform) = (0.0, 0.0);
        for _ in 0..samples {
            let d = sampling::uniform_sphere(glam::Vec2::new(rng.uniform(), rng.uniform()));
            let v = integrand(d) * 4.0 * std::f64::consts::PI;
            sum_uniform += v;
            square_uniform += v * v;
        }
        let uniform = sum_uniform / f64::from(samples);
        let error_uniform =
            ((square_uniform / f64::from(samples) - uniform * uniform) / f64::from(samples)).sqrt();
        assert!((uniform - exact).abs() < 4.0 * error_uniform);
        assert!(
            error_uniform > 5.0 * error,
            "the importance table does nothing: {error_uniform} against {error}"
        );
    }

    /// Goal: the density integrates to 1, is that of the samples, and is never 0, also for a black map.
    #[test]
    fn density_is_a_density() {
        for environment in [hot(), Environment::new(Image::zeros(8, 4, 3))] {
            let (w, h) = (environment.map.width, environment.map.height);
            let mut total = 0.0;
            for y in 0..h {
                for x in 0..w {
                    let pdf = environment.pdf(equirect::texel_direction(x, y, w, h));
                    assert!(pdf > 0.0);
                    total += f64::from(pdf * equirect::texel_solid_angle(y, w, h));
                }
            }
            assert!((total - 1.0).abs() < 1e-4, "{total}");
            let mut rng = Rng::new(8);
            for _ in 0..1000 {
                let s = environment.sample([rng.uniform(), rng.uniform()]);
                assert!((s.direction.length() - 1.0).abs() < 1e-5);
                // A sample on a texel's border may be read as its neighbour's: look a little inside.
                let (u, v) = equirect::uv_from_direction(s.direction);
                let inside = |t: f32| (0.01..0.99).contains(&t.fract());
                if inside(u * w as f32) && inside(v * h as f32) {
                    assert_eq!(environment.pdf(s.direction), s.pdf);
                }
            }
        }
    }

    /// Goal: a texel's centre gives the texel, and the seam at −x is continuous.
    #[test]
    fn lookup_hits_texels_and_wraps() {
        let environment = hot();
        let d = equirect::texel_direction(7, 4, 32, 16);
        assert!((environment.radiance(d).x - 900.0).abs() < 0.5);
        let just = |u: f32| environment.radiance(equirect::direction(u, 9.5 / 16.0)).y;
        assert!((just(1.0 - 1e-5) - just(1e-5)).abs() < 0.1);
        assert!(just(0.0) > 15.0 && just(0.0) < 25.0);
    }
}
