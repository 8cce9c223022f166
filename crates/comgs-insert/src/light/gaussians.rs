//! Spherical Gaussian light.

use super::LightMap;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Parameters a lobe.
pub(super) const STRIDE: usize = 7;

/// Least width of a lobe in texels of the map: a narrower one falls between texel centres, and has no gradient there.
const LEAST_WIDTH_TEXELS: f32 = 0.5;

/// One lobe, `c · exp(−(1 − v·μ)/σ²)` (DiPIR Eq. 2): for small σ a Gaussian over the angle with standard deviation σ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    /// Radiance at the centre, linear Rec.709, > 0.
    pub radiance: Vec3,
    /// Unit direction of the centre, world.
    pub direction: Vec3,
    /// Width in radians.
    pub sigma: f32,
}

impl Gaussian {
    /// ∫ over the sphere in steradian for unit radiance: `2π σ² (1 − exp(−2/σ²))`.
    #[must_use]
    pub fn solid_angle(&self) -> f32 {
        let s2 = self.sigma * self.sigma;
        2.0 * PI * s2 * (1.0 - (-2.0 / s2).exp())
    }
}

/// N lobes, their sum rasterised (Eq. 3). Parameters are rows of seven numbers: the logarithm of the radiance (3), a
/// vector along the direction (3, unit after every step), and `ln(σ − σ₀)`, where σ₀ is half a texel.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussians {
    /// Rows of the map.
    pub height: usize,
    /// Seven numbers a lobe.
    pub parameters: Vec<f32>,
}

impl Gaussians {
    /// Lobes as given. Radiance below 1e-6 and widths below the least are raised to what the parameters can say.
    #[must_use]
    pub fn new(height: usize, lobes: &[Gaussian]) -> Self {
        let least = Self::least_sigma(height);
        let parameters = lobes
            .iter()
            .flat_map(|l| {
                let c = l.radiance.max(Vec3::splat(1e-6)).map(f32::ln);
                let mu = l.direction.normalize_or(Vec3::Z);
                [c.x, c.y, c.z, mu.x, mu.y, mu.z, (l.sigma - least).max(1e-3 * least).ln()]
            })
            .collect();
        Self { height, parameters }
    }

    /// `count` lobes spread evenly over the sphere (a Fibonacci spiral), as wide as they are apart, that sum to about
    /// `radiance` from everywhere.
    #[must_use]
    pub fn uniform(height: usize, count: usize, radiance: Vec3) -> Self {
        let golden = PI * (3.0 - 5.0f32.sqrt());
        let sigma = (2.0 / (count as f32).sqrt()).max(2.0 * Self::least_sigma(height));
        let mut lobe = Gaussian { radiance: Vec3::ONE, direction: Vec3::Z, sigma };
        lobe.radiance = radiance * (4.0 * PI / (count as f32 * lobe.solid_angle()));
        let lobes: Vec<Gaussian> = (0..count)
            .map(|k| {
                let z = 1.0 - (2.0 * k as f32 + 1.0) / count as f32;
                let (sin, cos) = (golden * k as f32).sin_cos();
                let r = (1.0 - z * z).max(0.0).sqrt();
                Gaussian { direction: Vec3::new(r * cos, r * sin, z), ..lobe }
            })
            .collect();
        Self::new(height, &lobes)
    }

    /// σ₀: the least width in radians.
    #[must_use]
    pub fn least_sigma(height: usize) -> f32 {
        LEAST_WIDTH_TEXELS * PI / height as f32
    }

    /// The lobes.
    #[must_use]
    pub fn lobes(&self) -> Vec<Gaussian> {
        let least = Self::least_sigma(self.height);
        self.parameters
            .chunks_exact(STRIDE)
            .map(|p| Gaussian {
                radiance: Vec3::new(p[0], p[1], p[2]).map(f32::exp),
                direction: Vec3::new(p[3], p[4], p[5]).normalize_or(Vec3::Z),
                sigma: least + p[6].exp(),
            })
            .collect()
    }

    /// The sum of all lobes at the texels' centres. Gradient: [`Gaussians::rasterise_vjp`].
    #[must_use]
    pub fn rasterise(&self) -> LightMap {
        let lobes = self.lobes();
        let mut map = LightMap::zeros(self.height);
        let n = map.texels();
        let values: Vec<Vec3> = (0..n)
            .into_par_iter()
            .map(|i| {
                let v = map.direction(i);
                lobes
                    .iter()
                    .map(|l| l.radiance * ((l.direction.dot(v) - 1.0) / (l.sigma * l.sigma)).exp())
                    .sum()
            })
            .collect();
        for (i, value) in values.iter().enumerate() {
            for c in 0..3 {
                map.data[c * n + i] = value[c];
            }
        }
        map
    }

    /// Gradient with respect to the parameters. Differentiable everywhere but at a direction of length 0.
    #[must_use]
    pub fn rasterise_vjp(&self, grad: &LightMap) -> Vec<f32> {
        let n = grad.texels();
        let directions: Vec<Vec3> = (0..n).map(|i| grad.direction(i)).collect();
        let lobes = self.lobes();
        lobes
            .par_iter()
            .zip(self.parameters.par_chunks_exact(STRIDE))
            .flat_map_iter(|(l, p)| {
                let inverse = 1.0 / (l.sigma * l.sigma);
                let (mut by_radiance, mut by_direction, mut by_sigma) = (Vec3::ZERO, Vec3::ZERO, 0.0f32);
                for (i, v) in directions.iter().enumerate() {
                    let below = l.direction.dot(*v) - 1.0;
                    let g = (below * inverse).exp();
                    let grad = grad.texel(i) * g;
                    by_radiance += grad;
                    let along = grad.dot(l.radiance) * inverse;
                    by_direction += *v * along;
                    // d/dσ of (v·μ − 1)/σ² is −2 (v·μ − 1)/σ³.
                    by_sigma -= along * 2.0 * below / l.sigma;
                }
                let by_log = by_radiance * l.radiance;
                // Through the normalisation: the part along μ has no effect.
                let raw = Vec3::new(p[3], p[4], p[5]);
                let tangent = by_direction - l.direction * by_direction.dot(l.direction);
                let tangent = tangent / raw.length().max(1e-12);
                [by_log.x, by_log.y, by_log.z, tangent.x, tangent.y, tangent.z, by_sigma * p[6].exp()]
            })
            .collect()
    }

    /// Directions to unit length, which changes no radiance and keeps the learning rate of angles what it says.
    pub(super) fn normalise(&mut self) {
        for p in self.parameters.chunks_exact_mut(STRIDE) {
            let unit = Vec3::new(p[3], p[4], p[5]).normalize_or(Vec3::Z);
            p[3..6].copy_from_slice(&unit.to_array());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use comgs_geom::Rng;

    fn lobes(rng: &mut Rng, count: usize) -> Vec<Gaussian> {
        (0..count)
            .map(|_| Gaussian {
                radiance: Vec3::new(rng.range(0.1, 3.0), rng.range(0.1, 3.0), rng.range(0.1, 3.0)),
                direction: Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize(),
                sigma: rng.range(0.25, 1.2),
            })
            .collect()
    }

    /// Goal: the map is the formula, in f64 and written again; and its integral by solid angles is the lobe's on paper.
    #[test]
    fn the_map_is_the_sum_of_lobes() {
        let mut rng = Rng::new(3);
        let light = Gaussians::new(16, &lobes(&mut rng, 5));
        let parameters: Vec<f64> = light.parameters.iter().map(|&p| f64::from(p)).collect();
        let truth = reference::rasterise(&parameters, 16);
        for (a, b) in light.rasterise().data.iter().zip(&truth) {
            assert!((f64::from(*a) - b).abs() < 1e-4 * b.abs().max(1.0), "{a} {b}");
        }
        let one = Gaussian {
            radiance: Vec3::new(2.0, 1.0, 0.5),
            direction: Vec3::new(0.3, -0.5, 0.6).normalize(),
            sigma: 0.3,
        };
        let map = Gaussians::new(64, &[one]).rasterise();
        let omega = map.solid_angles();
        for c in 0..3 {
            let sum: f32 = map.channel(c).iter().zip(&omega).map(|(l, w)| l * w).sum();
            let paper = one.radiance[c] * one.solid_angle();
            assert!((sum - paper).abs() < 2e-3 * paper, "{sum} {paper}");
        }
    }

    /// Goal: the gradient agrees with finite differences of the f64 reference in all seven parameters of every lobe.
    #[test]
    fn gradient_by_finite_differences() {
        let mut rng = Rng::new(4);
        let light = Gaussians::new(12, &lobes(&mut rng, 3));
        let mut grad = LightMap::zeros(12);
        grad.data.iter_mut().for_each(|g| *g = rng.normal());
        let vjp = light.rasterise_vjp(&grad);
        let loss = |p: &[f64]| -> f64 {
            reference::rasterise(p, 12).iter().zip(&grad.data).map(|(l, g)| l * f64::from(*g)).sum()
        };
        let parameters: Vec<f64> = light.parameters.iter().map(|&p| f64::from(p)).collect();
        reference::assert_gradient(&parameters, &vjp, loss, 2e-3);
    }

    /// Goal: even lobes give nearly even light, of the radiance asked for.
    #[test]
    fn uniform_is_uniform() {
        let map = Gaussians::uniform(32, 32, Vec3::new(1.0, 2.0, 3.0)).rasterise();
        for i in 0..map.texels() {
            let ratio = map.texel(i) / Vec3::new(1.0, 2.0, 3.0);
            assert!(ratio.min_element() > 0.75 && ratio.max_element() < 1.25, "{ratio}");
        }
    }
}
