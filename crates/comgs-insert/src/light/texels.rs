//! A light of free texels.

use super::LightMap;
use glam::Vec3;

/// One radiance a texel, as its logarithm: positive whatever the optimiser does, and a step is a ratio.
#[derive(Clone, Debug, PartialEq)]
pub struct Texels {
    /// Rows of the map.
    pub height: usize,
    /// Logarithms in the order of [`LightMap::data`].
    pub log_radiance: Vec<f32>,
}

/// Least radiance that is told from black.
const DARKEST: f32 = 1e-6;

impl Texels {
    /// The same radiance from everywhere.
    #[must_use]
    pub fn uniform(height: usize, radiance: Vec3) -> Self {
        Self::from_map(&LightMap::constant(height, radiance))
    }

    /// A map as it is.
    #[must_use]
    pub fn from_map(map: &LightMap) -> Self {
        Self { height: map.height, log_radiance: map.data.iter().map(|v| v.max(DARKEST).ln()).collect() }
    }

    /// The map. Gradient: [`Texels::rasterise_vjp`].
    #[must_use]
    pub fn rasterise(&self) -> LightMap {
        LightMap { height: self.height, data: self.log_radiance.iter().map(|v| v.exp()).collect() }
    }

    /// Gradient with respect to the logarithms.
    #[must_use]
    pub fn rasterise_vjp(map: &LightMap, grad: &LightMap) -> Vec<f32> {
        map.data.iter().zip(&grad.data).map(|(l, g)| l * g).collect()
    }

    /// `weight/2 · ∫ |∇x|² dω` of the logarithm x of radiance, by differences between neighbouring texels; azimuth wraps.
    /// With square texels in azimuth and polar angle, an edge between columns weighs `1/sin φ` and one between rows
    /// `sin φ` at the edge. Adds its gradient to `grad`.
    pub fn smoothness(&self, weight: f32, grad: &mut [f32]) -> f32 {
        let (h, w) = (self.height, 2 * self.height);
        let sine = |row: f32| (std::f32::consts::PI * row / h as f32).sin();
        let mut sum = 0.0f64;
        for c in 0..3 {
            let base = c * w * h;
            let x = &self.log_radiance[base..base + w * h];
            let mut edge = |i: usize, j: usize, k: f32| {
                let d = x[i] - x[j];
                sum += f64::from(0.5 * weight * k * d * d);
                grad[base + i] += weight * k * d;
                grad[base + j] -= weight * k * d;
            };
            for row in 0..h {
                let across = 1.0 / sine(row as f32 + 0.5);
                for column in 0..w {
                    edge(row * w + column, row * w + (column + 1) % w, across);
                    if row + 1 < h {
                        edge(row * w + column, (row + 1) * w + column, sine(row as f32 + 1.0));
                    }
                }
            }
        }
        sum as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use comgs_geom::Rng;

    /// Goal: the gradients of the map and of the prior agree with finite differences, and a constant light has no prior.
    #[test]
    fn gradients_by_finite_differences() {
        let mut rng = Rng::new(5);
        let mut light = Texels::uniform(4, Vec3::ONE);
        let mut none = vec![0.0; light.log_radiance.len()];
        assert_eq!(light.smoothness(1.0, &mut none), 0.0);
        light.log_radiance.iter_mut().for_each(|v| *v = 0.5 * rng.normal());
        let mut grad = LightMap::zeros(4);
        grad.data.iter_mut().for_each(|g| *g = rng.normal());
        let mut vjp = Texels::rasterise_vjp(&light.rasterise(), &grad);
        light.smoothness(0.7, &mut vjp);
        let x: Vec<f64> = light.log_radiance.iter().map(|&v| f64::from(v)).collect();
        let loss = |x: &[f64]| {
            let map: f64 = x.iter().zip(&grad.data).map(|(v, g)| v.exp() * f64::from(*g)).sum();
            map + reference::dirichlet(x, 4, 0.7)
        };
        reference::assert_gradient(&x, &vjp, loss, 1e-3);
    }

    /// Goal: the prior is the integral: for x = z the gradient's square is sin² φ and integrates to 8π/3.
    #[test]
    fn the_prior_is_the_integral() {
        let mut light = Texels::uniform(64, Vec3::ONE);
        let map = LightMap::zeros(64);
        let n = map.texels();
        for i in 0..n {
            light.log_radiance[i] = map.direction(i).z;
        }
        let value = light.smoothness(2.0, &mut vec![0.0; 3 * n]);
        let paper = 8.0 * std::f32::consts::PI / 3.0;
        assert!((value - paper).abs() < 0.01 * paper, "{value} {paper}");
    }
}
